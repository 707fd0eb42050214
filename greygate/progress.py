"""How long work tells where it is: a callable that takes one line of text."""

from collections.abc import Callable

Progress = Callable[[str], None]


def silent(line: str) -> None:
    """Say nothing: the default of every `progress`."""


def titled(progress: Progress, title: str) -> Progress:
    """`progress` with a title before each line: what the work is, where several are done in turn."""
    return lambda line: progress(f"{title}, {line}")
