"""The timing-belt drive (thesis chapter 4)."""
