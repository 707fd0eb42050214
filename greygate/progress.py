"""How long work tells where it is: a callable that takes one line of text."""

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial, wraps
from time import monotonic
from typing import Any

Progress = Callable[[str], None]


WIDE = 100  # letters of a line that the next one replaces


def silent(line: str) -> None:
    """Say nothing: the default of every `progress`."""


class OutOfTime(Exception):
    """Work is left out, for its time is over."""


SEARCHED = 0.6  # of the time that is left, which a search may take: what it finds is to be tested, too


_WORK: ContextVar[tuple[int, int]] = ContextVar("work", default=(0, 1))


def worked() -> int:
    """The work that is done, in what `spend` counts: unlike seconds, the same on every computer."""
    return _WORK.get()[0]


def spend(work: int) -> None:
    """Count work."""
    done, times = _WORK.get()
    _WORK.set((done + times * work, times))


@contextmanager
def one_of(alike: int) -> Iterator[Callable[[], int]]:
    """Inside, the work of one of so many things that are alike: each is counted as if the others had taken as much.

    So none of them sees how far the others are, which may run beside it. Gives what tells the work of this one.
    """
    done, times = _WORK.get()
    with _set(_WORK, (done, times * alike)):
        yield lambda: (worked() - done) // (times * alike)


@dataclass
class Limit:
    """A span of a clock. until: an end before its own, if any."""

    clock: Callable[[], float]
    span: float
    until: float = math.inf

    def __post_init__(self):
        self.began = self.clock()
        self.ends = self.began + self.span

    def over(self, late: float = 0.0) -> bool:
        """Whether it is past, or by so much of what it was until its end."""
        end = self.ends + late * (self.ends - self.began) if late else min(self.ends, self.until)
        return self.clock() >= end

    def search(self) -> None:
        """End where no more is left than to test what was found."""
        now = self.clock()
        self.until = now + SEARCHED * (self.ends - now)


class Budget:
    """The time or the work that something may take: what is `over` ends with the best that it has."""

    def __init__(self, seconds: float = math.inf, work: float = math.inf):
        self.limits = Limit(lambda: monotonic(), seconds), Limit(worked, work)

    @property
    def over(self) -> bool:
        return any(limit.over() for limit in self.limits)

    def late(self, share: float) -> bool:
        """Whether so much more than what there is was taken."""
        return any(limit.over(share) for limit in self.limits)

    def stop(self) -> None:
        """The time is over now."""
        time, _ = self.limits
        time.ends = time.clock()

    @contextmanager
    def searching(self) -> Iterator[None]:
        """Inside, it is over, and what is in `cut` ends, where no more is left than to test what was found."""
        for limit in self.limits:
            limit.search()
        try:
            with _set(_SEARCHED, self):
                yield
        finally:
            for limit in self.limits:
                limit.until = math.inf

    @contextmanager
    def held(self, share: float) -> Iterator[None]:
        """Inside, `check` raises OutOfTime where so much more than what there is was taken; nothing is `cut`."""
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


def told(work: Callable) -> Callable:
    """Work whose `progress` is one line of the screen, unless it is given another."""

    @wraps(work)
    def tells(*arguments: Any, **options: Any) -> Any:
        if "progress" in options:
            return work(*arguments, **options)
        try:
            return work(*arguments, **options, progress=lambda line: print(f"\r{line[:WIDE]:{WIDE}}", end=""))
        finally:
            print(f"\r{'':{WIDE}}", end="\r")

    return tells


def titled(progress: Progress, title: str) -> Progress:
    """`progress` with a title before each line: what the work is, where several are done in turn."""
    return lambda line: progress(f"{title}, {line}")
