"""Mismatch: which physics a simulation leaves out of a recording. Rig, model, fit, search, selection, diagnosis."""
