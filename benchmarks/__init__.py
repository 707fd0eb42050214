"""Benchmarks of greygate: `python -m benchmarks` lists them. They are no part of the package."""
