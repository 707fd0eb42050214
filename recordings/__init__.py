"""Measured recordings, a folder each, with source, licence and columns in its SOURCE.md."""
