"""Structured networks of single plants: what is known of the plant is in the wiring."""
