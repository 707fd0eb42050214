"""The machines: a folder each with its plant, its network and its study; the catalog of what is trained."""
