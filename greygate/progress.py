"""How long work tells where it is: a callable that takes one line of text."""

import math
import sys
import time
from collections.abc import Callable

Progress = Callable[[str], None]


def silent(line: str) -> None:
    """Say nothing: the default of every `progress`."""


class Budget:
    """The time that work may take: what is `over` ends with the best that it has."""

    def __init__(self, seconds: float = math.inf):
        self.ends = time.monotonic() + seconds

    @property
    def over(self) -> bool:
        return time.monotonic() > self.ends

    def stop(self) -> None:
        """The time is over now."""
        self.ends = -math.inf


_SAID: set[str] = set()


def once(line: str) -> None:
    """Print a line on stderr, the first time that it comes: what was done to a recording that is read again."""
    if line not in _SAID:
        _SAID.add(line)
        print(line, file=sys.stderr)


def titled(progress: Progress, title: str) -> Progress:
    """`progress` with a title before each line: what the work is, where several are done in turn."""
    return lambda line: progress(f"{title}, {line}")
