"""Constant matrices as adder graphs: y = W x (+ constants) with shared two-operand additions and subtractions.

graph = solve(weights, widths, constants)
graph.adders, graph.depth, graph.adder_bits
"""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from greygate.compiler.adders_graph import CONSTANT, Graph, Node, Output
from greygate.compiler.adders_shape import Term, shape

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
    definitions = _shared(sums, columns)
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


def _shared(sums: list[list[Term]], columns: int) -> list[list[Term]]:
    """Move the most frequent pair of terms into a definition until none occurs twice; the sums change in place."""
    definitions: list[list[Term]] = []
    useless: set[tuple[int, int, int, int]] = set()  # patterns whose occurrences overlap
    while True:
        counts: Counter[tuple[int, int, int, int]] = Counter()
        for terms in sums:
            counts.update(p for p in _patterns(terms) if p not in useless)
        best, count = min(counts.items(), key=lambda item: (-item[1], item[0]), default=(None, 0))
        if best is None or count < 2:
            return definitions
        a, b, distance, sign = best
        new = columns + len(definitions)
        before = [list(terms) for terms in sums]
        if sum(_replace(terms, best, new) for terms in sums) < 2:
            sums[:] = before
            useless.add(best)
        else:
            definitions.append([(a, 0, 1), (b, distance, sign)])


def _patterns(terms: list[Term]) -> list[tuple[int, int, int, int]]:
    ordered = sorted(terms)
    return [(a, b, t - s, g * h) for n, (a, s, g) in enumerate(ordered) for b, t, h in ordered[n + 1 :]]


def _replace(terms: list[Term], pattern: tuple[int, int, int, int], new: int) -> int:
    a, b, distance, sign = pattern
    present = set(terms)
    gained = 0
    for o, s, g in sorted(terms):
        other = (b, s + distance, g * sign)
        if o == a and (o, s, g) in present and other in present and (o, s, g) != other:
            present -= {(o, s, g), other}
            present.add((new, s, g))
            gained += 1
    terms[:] = sorted(present)
    return gained
