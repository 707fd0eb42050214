"""Networks of other tools: one file for each tool, all of which build with `builder`."""
