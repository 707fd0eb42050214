"""How long work tells where it is: a callable that takes one line of text."""

import sys
from collections.abc import Callable

Progress = Callable[[str], None]


def silent(line: str) -> None:
    """Say nothing: the default of every `progress`."""


_SAID: set[str] = set()


def once(line: str) -> None:
    """Print a line on stderr, the first time that it comes: what was done to a recording that is read again."""
    if line not in _SAID:
        _SAID.add(line)
        print(line, file=sys.stderr)


def titled(progress: Progress, title: str) -> Progress:
    """`progress` with a title before each line: what the work is, where several are done in turn."""
    return lambda line: progress(f"{title}, {line}")
