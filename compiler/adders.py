"""Constant matrices as adder graphs: y = W x (+ constants) with shared two-operand additions and subtractions.

graph = solve(weights, widths, constants)
graph.adders, graph.depth, graph.adder_bits
"""

from collections.abc import Sequence

import numpy as np

from greygate.compiler.adders_graph import CONSTANT, Graph, Node, Output
from greygate.compiler.adders_search import best_sums
from greygate.compiler.adders_shape import shape

__all__ = ["CONSTANT", "Graph", "Node", "Output", "solve"]


def solve(
    weights: np.ndarray,
    widths: Sequence[int],
    constants: Sequence[int] | np.ndarray | None = None,
    ranges: Sequence[tuple[int, int]] | None = None,
    depth: int | None = None,
) -> Graph:
    """Find a graph with few adders for `weights` (rows, columns) of integers.

    widths: bits of each column's signed code. constants: a number added to each row (bias and rounding constant).
    ranges: (lo, hi) of each column where it is narrower than the width says.
    """
    table = np.asarray(weights)
    rows, columns = table.shape
    if ranges is None:
        ranges = [(-(1 << (w - 1)), (1 << (w - 1)) - 1) for w in widths]
    constants = [0] * rows if constants is None else [int(c) for c in constants]
    sums = [[(c, s, g) for c in range(columns) for s, g in signed_digits(int(table[r, c]))] for r in range(rows)]
    definitions, sums = best_sums(sums, columns)
    return shape(columns, definitions, sums, constants, ranges)


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
