"""Machines with only measured recordings: their networks, and the rules of a test run."""
