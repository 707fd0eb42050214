"""Lookup tables of the sigmoids: half of a symmetric function, interpolated, with the worst error over every code."""

import math
from functools import lru_cache

import numpy as np

from greygate.emulator.interpreter import lookup
from greygate.emulator.program import Fix, Symmetry, Table

FUNCTIONS = {
    "tansig": (np.tanh, Symmetry.ODD),
    "logsig": (lambda n: 0.5 + 0.5 * np.tanh(0.5 * n), Symmetry.COMPLEMENT),
    "radbas": (lambda n: np.exp(-n * n), Symmetry.EVEN),
}
LARGEST = 4096  # points of one table


def output_fix(width: int) -> Fix:
    """Format of a sigmoid's output: all of [-1, 1), so plus one is one LSB short."""
    return Fix(width, width - 1)


def integer_bits(magnitude: float) -> int:
    """Bits left of the point, the sign not counted: |value| <= magnitude < 2^bits. Negative for small values."""
    return math.floor(math.log2(magnitude)) + 1 if magnitude > 0 else 0


def flat_from(function: str, out: Fix) -> float:
    """Argument beyond which the function is flat to half an LSB of `out`."""
    decades = (out.frac + 1) * math.log(2)  # of f's distance to its limit
    return {"tansig": 0.5 * (decades + math.log(2)), "logsig": decades, "radbas": math.sqrt(decades)}[function]


@lru_cache
def make_table(function: str, arg: Fix, out: Fix, budget: float = 1.25, interpolated: bool = True) -> Table:
    """The smallest table whose worst error over every code of `arg` is at most `budget` LSB of `out`.

    The error counted is that of the table, not of rounding the argument; plus one itself costs the LSB that `out`
    lacks. When no table up to 4096 points meets the budget the largest is taken: its worst error says so.
    """
    f, symmetry = FUNCTIONS[function]
    codes = np.arange(arg.lo, arg.hi + 1, dtype=np.int64) if arg.width <= 20 else _sample(arg)
    exact = f(codes * arg.lsb)
    reach = min(arg.width - 1, integer_bits(flat_from(function, out)) + arg.frac)  # codes that differ: below 2^reach
    end = (1 << reach) * arg.lsb
    for bits in range(3, int(math.log2(LARGEST)) + 1):
        shift = reach - bits
        if shift < 0:
            break
        points = np.clip(np.floor(f(np.arange((1 << bits) + 1) * end / (1 << bits)) * 2.0**out.frac + 0.5), 0, out.hi)
        table = Table(
            f"{function}_{arg.width}_{arg.frac}_{out.width}", function, symmetry, shift, tuple(int(p) for p in points),
            interpolated, arg, out, 0.0,
        )  # fmt: skip
        worst = float(np.abs(lookup(table, codes) * out.lsb - exact).max())
        found = Table(**{**table.__dict__, "worst_error": worst})
        if worst <= budget * out.lsb:
            break
    return found


def _sample(arg: Fix) -> np.ndarray:
    """Codes of a format too wide to try them all: a million spread evenly, and the ends."""
    return np.unique(np.r_[np.linspace(arg.lo, arg.hi, 1 << 20).astype(np.int64), arg.lo, arg.hi])
