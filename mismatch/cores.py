"""Simulations of one plant side by side: they hold no lock while they run, so threads take them to all cores."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar, copy_context
from dataclasses import dataclass
from functools import cache, partial, wraps
from itertools import chain
from time import perf_counter
from typing import Generic, ParamSpec, TypeVar

from greygate.cores import usable_cores
from greygate.models.cores import blas
from greygate.progress import OutOfTime, one_of, spend

FEW = 3  # items: fewer are done one after the other
WORTH = 2e-3  # s that the first item takes: below, handing items to threads costs more than it saves

Item = TypeVar("Item")
Found = TypeVar("Found")
Given = ParamSpec("Given")
CORES = usable_cores()

_inside = ContextVar("inside", default=False)


def each(function: Callable[[Item], Found], items: Iterable[Item]) -> list[Found]:
    """`function` of every item, in their order. What it finds of one must not depend on the others."""
    items = list(items)
    one = partial(_one, function, len(items))
    began = perf_counter()
    first = [one(item) for item in items[:1]]
    if _inside.get() or len(items) < FEW or CORES < 2 or perf_counter() - began < WORTH:
        return _together(chain(first, map(one, items[1:])))

    def inside(item: Item) -> _One[Found]:
        _inside.set(True)
        return one(item)

    running = [_pool().submit(copy_context().run, inside, item) for item in items[1:]]  # with numpy's error state
    return _together(chain(first, (done.result() for done in running)))


@dataclass(frozen=True)
class _One(Generic[Found]):
    """What was found of one item, and the work that it took; ended: where that was over, and then the work of all."""

    found: list[Found]
    work: int
    ended: OutOfTime | None = None


def _one(function: Callable[[Item], Found], alike: int, item: Item) -> _One[Found]:
    with one_of(alike) as work:
        try:
            return _One([function(item)], work())
        except OutOfTime as problem:
            return _One([], alike * work(), problem)


def _together(ones: Iterable[_One[Found]]) -> list[Found]:
    """What was found of all, and their work; it ends at the first whose time was over, whatever runs beside it."""
    out: list[Found] = []
    work = 0
    for one in ones:
        if one.ended:
            spend(one.work)
            raise one.ended
        out += one.found
        work += one.work
    spend(work)
    return out


def on_one_thread(function: Callable[Given, Found]) -> Callable[Given, Found]:
    """`function` with one thread of BLAS: more are slower on matrices this small, and `each` takes the cores."""

    @wraps(function)
    def limited(*args: Given.args, **named: Given.kwargs) -> Found:
        with blas().limit(limits=1, user_api="blas"):
            return function(*args, **named)

    return limited


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(CORES)
