"""Lookup tables: half of a symmetric function of one argument, interpolated, with the worst error over every code."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np

from greygate.emulator.interpreter import lookup
from greygate.emulator.program import Fix, Symmetry, Table
from greygate.models.activations import ACTIVATIONS
from greygate.models.arithmetic import xp

LARGEST_BITS = 12  # 4096 intervals
CHUNK = 1 << 20


def output_fix(width: int) -> Fix:
    """Format of a sigmoid's output: it holds [-1, 1), so that it represents 1 one LSB too small."""
    return Fix(width, width - 1)


def integer_bits(magnitude: float) -> int:
    """Bits left of the point, without the sign: |value| <= magnitude < 2^bits. Negative for small values."""
    return math.frexp(magnitude)[1]


def flat_from(function: str, out: Fix) -> float:
    """Argument beyond which the function is flat to half an LSB of `out`, or exceeds the range of `out`."""
    decades = (out.frac + 1) * math.log(2)  # of f's distance to its limit
    found = ACTIVATIONS[function].flat_from
    assert found, f"{function} is kept in a table, which has an end"
    return found(decades, _most(out))


def _most(out: Fix) -> float:
    """The end of a format's range, one LSB above the largest value that it holds."""
    return 2.0 ** (out.width - 1 - out.frac)


@lru_cache(maxsize=256)
def make_table(function: str, arg: Fix, out: Fix, budget: float = 1.25, interpolated: bool = True) -> Table:
    """The smallest table whose worst error over every code of `arg` is at most `budget` LSB of `out`.

    The error is that of the table, without rounding of the argument. Where f is 1, `out` is one LSB too small, and this
    counts. If no table of up to 4096 points meets the budget, it takes the largest, whose worst error shows this.
    """
    reach = min(arg.width - 1, integer_bits(flat_from(function, out)) + arg.frac)  # codes that differ: below 2^reach
    for bits in range(min(3, reach), min(reach, LARGEST_BITS) + 1):
        table = _table(function, arg, out, reach - bits, bits, interpolated)
        if _worst(table, _spread(reach)) <= budget * out.lsb:
            break
    return replace(table, worst_error=max(_worst(table, codes) for codes in _every(reach, arg)))


def _table(function: str, arg: Fix, out: Fix, shift: int, bits: int, interpolated: bool) -> Table:
    f = ACTIVATIONS[function]
    assert f.symmetry, f"{function} is kept in a table, which is half of it"
    exact = f.value(xp, np.arange((1 << bits) + 1) * 2.0**shift * arg.lsb)
    points = np.clip(np.floor(exact * 2.0**out.frac + 0.5), 0, out.hi).astype(int)
    name = f"{function}_{arg.width}_{arg.frac}_{out.width}" + (f"_{out.frac}" if out != output_fix(out.width) else "")
    return Table(name, function, Symmetry(f.symmetry), shift, tuple(points.tolist()), interpolated, arg, out, math.inf)


def _worst(table: Table, codes: np.ndarray) -> float:
    exact = np.minimum(ACTIVATIONS[table.function].value(xp, codes * table.arg.lsb), _most(table.out))
    return float(np.abs(lookup(table, codes) * table.out.lsb - exact).max())


def _spread(reach: int) -> np.ndarray:
    """About 2^16 codes over the curved part, by which a size is chosen."""
    return np.arange(0, (1 << reach) + 1, 1 << max(reach - 16, 0), dtype=np.int64)


def _every(reach: int, arg: Fix) -> Iterator[np.ndarray]:
    """Every code that can have an error of its own: the curved part and the ends of the flat part, where f is monotone.

    Negative codes repeat the error of their absolute value, by the symmetry of the lookup.
    """
    for start in range(0, 1 << reach, CHUNK):
        yield np.arange(start, min(start + CHUNK, 1 << reach), dtype=np.int64)
    yield np.array([min(1 << reach, arg.hi), arg.hi, arg.lo])
