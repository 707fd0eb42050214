"""Constant matrices as adder graphs: y = W x (+ constants) with shared two-operand additions and subtractions.

graph = solve(weights, widths, constants)
graph.adders, graph.depth, graph.adder_bits
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from greygate.compiler.adders.graph import CONSTANT, Graph, Node, Output
from greygate.compiler.adders.search import REWRITES, best_sums, looked
from greygate.compiler.adders.shape import shape
from greygate.errors import InputError

__all__ = ["CONSTANT", "Graph", "Node", "Output", "solve"]


WIDEST = 24  # places of a weight up to which the search tells sums apart by their values, of 61 bits
SHARED = 60  # places of a weight up to which patterns are shared
KEPT = 64  # graphs that a process remembers


def solve(
    weights: np.ndarray,
    widths: Sequence[int],
    constants: Sequence[int] | np.ndarray | None = None,
    ranges: Sequence[tuple[int, int]] | None = None,
    effort: float = 1.0,
) -> Graph:
    """Find a graph with few adders for `weights` (rows, columns) of integers. The same input gives the same graph.

    widths: bits of each column's signed code. constants: a number added to each row (bias and rounding constant).
    ranges: (lo, hi) of each column where it is narrower than the width says. effort: work of the search, as a multiple;
    0 shares pairs once.
    """
    table = np.asarray(weights)
    rows, columns = table.shape
    if ranges is None:
        ranges = [(-(1 << (w - 1)), (1 << (w - 1)) - 1) for w in widths]
    if len(ranges) != columns:
        raise InputError(f"adder graph: {len(ranges)} ranges for {columns} columns; give one a column")
    numbers = [0] * rows if constants is None else [int(c) for c in constants]
    if len(numbers) != rows:
        raise InputError(f"adder graph: {len(numbers)} constants for {rows} rows; give one a row")
    entries = tuple(tuple(int(w) for w in row) for row in table)
    bounds = tuple((int(lo), int(hi)) for lo, hi in ranges)
    return _solved(entries, columns, tuple(numbers), bounds, effort)


@lru_cache(maxsize=KEPT)
def _solved(
    entries: tuple[tuple[int, ...], ...],
    columns: int,
    constants: tuple[int, ...],
    ranges: tuple[tuple[int, int], ...],
    effort: float,
) -> Graph:
    """As `solve`. A program's clocks, registers and text are asked for one by one, and each needs the same graphs."""
    sums = [[(c, s, g) for c, w in enumerate(row) for s, g in signed_digits(w)] for row in entries]
    widest = max((shift for s in sums for _, shift, _ in s), default=0)
    rewrites = REWRITES if widest <= WIDEST else 0
    found = best_sums(sums, columns, effort, rewrites) if widest <= SHARED else [([], sums)]
    wanted = looked(columns, [], sums)
    right = [f for f in found if looked(columns, *f) == wanted]  # but for a search that took unequal sums for equal
    right = right or best_sums(sums, columns, 0, 0)
    graphs = [shape(columns, definitions, outs, constants, ranges) for definitions, outs in right]
    best = min(graphs, key=lambda g: (g.adders, g.adder_bits))
    assert best.matrix().tolist() == [list(row) for row in entries], "the adders are not the matrix"
    return best


def signed_digits(number: int) -> list[tuple[int, int]]:
    """The canonical signed digits of an integer: (shift, +1 or -1), lowest first, no two neighbours."""
    found = []
    shift = 0
    while number:
        if number & 1:
            digit = 2 - (number & 3)
            found.append((shift, digit))
            number -= digit
        number >>= 1
        shift += 1
    return found
