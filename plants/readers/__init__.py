"""Recordings of other tools: one file for each format, all of which give `Column`s to `columns.recording`."""
