"""How long work tells where it is: a callable that takes one line of text."""

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from time import monotonic

Progress = Callable[[str], None]


def silent(line: str) -> None:
    """Say nothing: the default of every `progress`."""


class OutOfTime(Exception):
    """Work is left out, for its time is over."""


SEARCHED = 0.6  # of the time that is left, which a search may take: what it finds is to be tested, too


class Budget:
    """The time that work may take: what is `over` ends with the best that it has."""

    def __init__(self, seconds: float = math.inf):
        self.began = monotonic()
        self.ends, self.until = self.began + seconds, math.inf

    @property
    def over(self) -> bool:
        return monotonic() >= min(self.ends, self.until)

    def late(self, share: float) -> bool:
        """Whether so much more than the time is over."""
        return monotonic() >= self.ends + share * (self.ends - self.began)

    def stop(self) -> None:
        """The time is over now."""
        self.ends = monotonic()

    @contextmanager
    def searching(self) -> Iterator[None]:
        """Inside, the time is over, and what is in `cut` ends, where no more is left than to test what was found."""
        now = monotonic()
        self.until = now + SEARCHED * (self.ends - now)
        try:
            with _set(_SEARCHED, self):
                yield
        finally:
            self.until = math.inf

    @contextmanager
    def held(self, share: float) -> Iterator[None]:
        """Inside, `check` raises OutOfTime where so much more than the time is over; nothing is `cut`."""
        with _set(_SEARCHED, None), _set(_LATE, partial(self.late, share)):
            yield


_SEARCHED: ContextVar[Budget | None] = ContextVar("searched", default=None)
_LATE: ContextVar[Callable[[], bool] | None] = ContextVar("late", default=None)


@contextmanager
def _set(variable: ContextVar, value: object) -> Iterator[None]:
    token = variable.set(value)
    try:
        yield
    finally:
        variable.reset(token)


@contextmanager
def cut() -> Iterator[None]:
    """Inside, work ends at a `check` where the time of a search is over; what it has by then stays."""
    if (budget := _SEARCHED.get()) is None:
        yield
        return
    try:
        with _set(_LATE, lambda: budget.over):
            yield
    except OutOfTime:
        pass


def check() -> None:
    """Raise OutOfTime where the time is over within which this is to be done, if any."""
    if (late := _LATE.get()) is not None and late():
        raise OutOfTime


_SAID: set[str] = set()


def once(line: str) -> None:
    """Print a line on stderr, the first time that it comes: what was done to a recording that is read again."""
    if line not in _SAID:
        _SAID.add(line)
        print(line, file=sys.stderr)


def titled(progress: Progress, title: str) -> Progress:
    """`progress` with a title before each line: what the work is, where several are done in turn."""
    return lambda line: progress(f"{title}, {line}")
