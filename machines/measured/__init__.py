"""Machines of which there are measured recordings alone: the networks, and the rules of a test run."""
