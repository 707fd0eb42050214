"""The thesis's two benchmark systems (3.6)."""
