"""Experiments: which effects a recording could tell apart, and the excitation that would."""
