"""Structured networks: what they are (network), what their signals are (ports), how they are judged (validation)."""
