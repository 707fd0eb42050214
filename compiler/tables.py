"""Lookup tables: half of a symmetric function of one argument, interpolated, with the worst error over every code.

compiler/lines.py fits the tables of free lines.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from enum import StrEnum
from functools import lru_cache

import numpy as np

from greygate.compiler.lines import Goal, affordable, fit_lines
from greygate.emulator.interpreter import lookup
from greygate.emulator.numbers import Fix
from greygate.emulator.tables import Lines, Symmetry, Table
from greygate.errors import InputError
from greygate.models.activations import ACTIVATIONS, Activation
from greygate.models.arithmetic import xp

LARGEST_BITS = 12  # 4096 intervals
MOST = 30  # bits of a table's argument: minutes to check
CHUNK = 1 << 20
ATTEMPTS = 6  # at lines that meet a budget for every code


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


def _held(f: Activation, n: np.ndarray, out: Fix) -> np.ndarray:
    """f within the range of a format, and 1 LSB above it, where f is 1."""
    return np.clip(f.value(xp, n), -_most(out), _most(out))


class Form(StrEnum):
    """How a table is kept; docs/integer-program.md, "Lookup"."""

    POINTS = "points"  # values at equal distances, and a line between two
    LINES = "lines"  # free lines over segments of equal length
    OCTAVES = "octaves"  # free lines over segments that may be longer from octave to octave


@lru_cache(maxsize=256)
def make_table(
    function: str,
    arg: Fix,
    out: Fix,
    budget: float = 1.25,
    interpolated: bool = True,
    form: Form = Form.POINTS,
    segments: int = 8,
) -> Table | Lines:
    """The smallest table whose worst error over every code of `arg` is at most `budget` LSB of `out`.

    segments: the least between points, unless the argument has fewer codes; a power of two.
    The error is that of the table, without rounding of the argument. Where f is 1, `out` is one LSB too small, and this
    counts. If no table of up to 4096 points meets the budget, it takes the largest, whose worst error shows this.
    Raises InputError for an argument of more than MOST bits.
    """
    reach = min(arg.width - 1, integer_bits(flat_from(function, out)) + arg.frac)  # codes that differ: below 2^reach
    if reach > MOST:
        raise InputError(
            f"a table of {function} would answer 2^{reach} arguments, and each is checked: at most 2^{MOST} are; give "
            "a smaller --width"
        )
    if form is not Form.POINTS and interpolated:
        return _lines(function, arg, out, budget, form, reach)
    least = segments.bit_length() - 1
    for bits in range(min(least, reach), min(reach, LARGEST_BITS) + 1):
        table = _table(function, arg, out, reach - bits, bits, interpolated)
        if _worst(table, _spread(reach)) <= budget * out.lsb:
            break
    return replace(table, worst_error=_worst_of_all(table, reach))


def _lines(function: str, arg: Fix, out: Fix, budget: float, form: Form, reach: int) -> Lines:
    """The same of free lines. They are chosen by samples; if a code between them errs more, they are chosen again."""
    f = ACTIVATIONS[function]
    assert f.symmetry, f"{function} is kept in a table, which is half of it"
    name = f"{_name(function, arg, out)}_{form}"
    goal = Goal(lambda codes: _held(f, codes * arg.lsb, out) * 2.0**out.frac, arg, out, reach)
    if form is Form.OCTAVES:
        budget = affordable(goal, Symmetry(f.symmetry), budget, LARGEST_BITS)
    limit, aim, found = budget, budget, []
    for _ in range(ATTEMPTS):
        fitted = fit_lines(goal, Symmetry(f.symmetry), limit, aim, LARGEST_BITS, several=form is Form.OCTAVES)
        table = Lines(name, function, Symmetry(f.symmetry), *fitted, arg, out, math.inf)
        seen = _worst(table, _spread(reach), avoidable=True) / out.lsb  # where some codes err too much, so do all
        excess = (seen if seen > budget else _worst_of_all(table, reach, avoidable=True) / out.lsb) - budget
        found.append((max(0.0, excess), table))
        if excess <= 0:
            break
        aim -= excess
        if len(found) % 2 == 0:  # rounding the lines better was not enough
            limit, aim = limit - excess, budget
    table = min(found, key=lambda pair: pair[0])[1]
    return replace(table, worst_error=_worst_of_all(table, reach))


def _worst_of_all(table: Table | Lines, reach: int, avoidable: bool = False) -> float:
    both = isinstance(table, Lines) and not ACTIVATIONS[table.function].steep  # which is of positive sums
    return max(_worst(table, codes, avoidable) for codes in _every(reach, table.arg, both))


def _name(function: str, arg: Fix, out: Fix) -> str:
    return f"{function}_{arg.width}_{arg.frac}_{out.width}" + (f"_{out.frac}" if out != output_fix(out.width) else "")


def _table(function: str, arg: Fix, out: Fix, shift: int, bits: int, interpolated: bool) -> Table:
    f = ACTIVATIONS[function]
    assert f.symmetry, f"{function} is kept in a table, which is half of it"
    exact = f.value(xp, np.arange((1 << bits) + 1) * 2.0**shift * arg.lsb)
    points = np.clip(np.floor(exact * 2.0**out.frac + 0.5), 0, out.hi).astype(int)
    return Table(
        _name(function, arg, out),
        function,
        Symmetry(f.symmetry),
        shift,
        tuple(points.tolist()),
        interpolated,
        arg,
        out,
        math.inf,
    )


def _worst(table: Table | Lines, codes: np.ndarray, avoidable: bool = False) -> float:
    """The largest error, or the largest that another answer to the same code could avoid."""
    f = ACTIVATIONS[table.function]
    exact = _held(f, np.abs(codes) * table.arg.lsb, table.out)
    answers = lookup(table, codes)
    if f.symmetry != "even":  # the answer to |x| is what an answer to x means
        answers = np.where(codes < 0, (f.symmetry == "complement") * (1 << table.out.frac) - answers, answers)
    error = np.abs(answers * table.out.lsb - exact)
    return float(
        error.max(where=(answers < table.out.hi) | (exact < answers * table.out.lsb) | (not avoidable), initial=0)
    )


def _spread(reach: int) -> np.ndarray:
    """About 2^16 codes over the curved part, by which a size is chosen."""
    return np.arange(0, (1 << reach) + 1, 1 << max(reach - 16, 0), dtype=np.int64)


def _every(reach: int, arg: Fix, both: bool = False) -> Iterator[np.ndarray]:
    """Every code that can have an error of its own: the curved part and the ends of the flat part, where f is monotone.

    Negative codes repeat the error of their absolute value, by the symmetry of the lookup, unless `both`: a place that
    leaves out bits of a code leaves out others of its negative.
    """
    for start in range(0, 1 << reach, CHUNK):
        codes = np.arange(start, min(start + CHUNK, 1 << reach), dtype=np.int64)
        yield codes
        if both:
            yield ~codes
    yield np.array([min(1 << reach, arg.hi), arg.hi, arg.lo])
