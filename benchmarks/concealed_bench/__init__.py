"""A blind benchmark of missing physics: cases to make, any tool to run on them, and its answers to score.

It shares no code with the diagnosis, which enters it as every other tool does, by a command and files.
"""
