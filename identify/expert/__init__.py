"""Builds a structured network from a plant's file and recordings (thesis figures 3.1 and 3.3); docs/procedure.md."""
