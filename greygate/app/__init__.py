"""The page of a folder in a browser: what lies in it, every command as a form, and what runs (`greygate app`)."""
