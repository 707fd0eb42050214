"""Measured curves in a plant: a table of points from a CSV file becomes terms of a definition.

Between its points a curve is straight, beyond its ends it stays as it is. It is written as a sum of hinges, so that it
is an expression like any other.
"""

import re
from pathlib import Path

import numpy as np

from greygate.errors import InputError
from greygate.plants.expressions import check_expression
from greygate.plants.table import read_table

HINGES = 20  # in a term, which then has some 2000 characters
CURVE = re.compile(r"curve_\d+")  # a term of a curve
MOST = 1000  # points: 50 terms, each compiled


def curve(of: str, x: np.ndarray, y: np.ndarray, where: str = "curve") -> dict[str, str]:
    """Terms whose sum goes through the points (x, y), both (points,). of: the expression that x stands for.

    Raises InputError for fewer than two points, or an x that does not rise.

    >>> curve("q", np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0, 2.0]))
    {'curve_1': '2.0 * min(max(q, 0.0), 3.0) - 2.0 * max(min(q, 3.0) - 1.0, 0.0)'}
    """
    check_expression(of, where)
    x, y = np.asarray(x, float), np.asarray(y, float)
    if x.shape != y.shape or x.ndim != 1 or not 2 <= len(x) <= MOST:
        raise InputError(f"{where}: {x.shape} and {y.shape} points; give 2 to {MOST} pairs")
    if not (np.diff(x) > 0).all():
        at = int(np.argmin(np.diff(x) > 0)) + 2
        raise InputError(f"{where}: its first column does not rise at point {at}; sort it")
    last = _written(x[-1])
    inside = f"min(max({of}, {_written(x[0])}), {last})"
    slopes = np.diff(y) / np.diff(x)
    bends = [(at, by) for at, by in zip(x[1:-1], np.diff(slopes), strict=True) if by]
    first = _added([_written(y[0] - slopes[0] * x[0])] if y[0] != slopes[0] * x[0] else [], slopes[0], inside)
    parts = [first or ["0.0"]]
    for k in range(0, len(bends), HINGES):
        sums = parts[0] if k == 0 else []
        for at, by in bends[k : k + HINGES]:
            _added(sums, by, f"max(min({of}, {last}) - {_written(at)}, 0.0)")
        if k:
            parts.append(sums)
    return {f"curve_{i + 1}": "".join(sums) for i, sums in enumerate(parts)}


def read_curve(path: Path, of: str) -> dict[str, str]:
    """The terms of a curve from a CSV file with a header and two columns. Raises InputError naming file and row."""
    table = read_table(path)
    if len(table.header) != 2:
        raise InputError(f"{path}: {len(table.header)} columns; give two, the argument and the value")
    return curve(of, table.values[:, 0], table.values[:, 1], str(path))


def _added(sums: list[str], factor: float, what: str) -> list[str]:
    """`sums` with `factor` times `what` at its end."""
    if factor:
        sign = ("-" if factor < 0 else "") if not sums else (" - " if factor < 0 else " + ")
        sums.append(f"{sign}{_written(abs(factor))} * {what}")
    return sums


def _written(value: float) -> str:
    return repr(float(value))
