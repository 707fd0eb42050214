"""Simulations of one plant side by side: they hold no lock while they run, so threads take them to all cores."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar, copy_context
from functools import cache, wraps
from time import perf_counter
from typing import ParamSpec, TypeVar

from greygate.models.cores import blas, usable_cores

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
    began = perf_counter()
    first = [function(item) for item in items[:1]]
    if _inside.get() or len(items) < FEW or CORES < 2 or perf_counter() - began < WORTH:
        return first + [function(item) for item in items[1:]]

    def one(item: Item) -> Found:
        _inside.set(True)
        return function(item)

    running = [_pool().submit(copy_context().run, one, item) for item in items[1:]]  # with numpy's error state
    return first + [done.result() for done in running]


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
