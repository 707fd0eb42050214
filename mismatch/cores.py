"""Simulations of one plant side by side: they hold no lock while they run, so threads take them to all cores."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar, copy_context
from functools import cache
from time import perf_counter
from typing import TypeVar

from greygate.models.cores import usable_cores

FEW = 3  # items: fewer are done one after the other
WORTH = 2e-3  # s that the first item takes: below, handing items to threads costs more than it saves

Item = TypeVar("Item")
Found = TypeVar("Found")
CORES = usable_cores()

_inside = ContextVar("inside", default=False)


def each(function: Callable[[Item], Found], items: Iterable[Item]) -> list[Found]:
    """`function` of every item, in their order. What it finds of one must not depend on the others."""
    items = list(items)
    began = perf_counter()
    first = [function(item) for item in items[:1]]
    if _inside.get() or len(items) < FEW or CORES < 2 or perf_counter() - began < WORTH:
        return first + [function(item) for item in items[1:]]

    def one(item: Item) -> Found:
        _inside.set(True)
        return function(item)

    running = [_pool().submit(copy_context().run, one, item) for item in items[1:]]  # with numpy's error state
    return first + [done.result() for done in running]


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(CORES)
