"""The codes that each element of each signal can take: intervals, from the formats of inputs and states onwards."""

from collections.abc import Sequence

import numpy as np

from greygate.emulator.interpreter import lookup
from greygate.emulator.numbers import Fix, Overflow, Rounding
from greygate.emulator.program import Affine, Clamp, Lookup, Program, Select, Threshold

Interval = tuple[int, int]


def reachable(program: Program) -> dict[str, list[Interval]]:
    """Signal -> the interval of each element; inputs and states may hold any code of their formats."""
    found = {s.name: [(s.fix.lo, s.fix.hi)] * s.size for s in program.signals.values()}
    for o in program.operations:
        args = [found[a] for a in o.args]
        if isinstance(o, Affine):
            rows = accumulators(o, [interval for arg in args for interval in arg])
            shifts = [int(f) - o.out.fix.frac for f in o.frac]
            wraps = o.overflow is Overflow.WRAP
            found[o.out.name] = [_fitted(a, s, o.rounding, o.out.fix, wraps) for a, s in zip(rows, shifts, strict=True)]
        elif isinstance(o, Lookup):
            found[o.out.name] = [_answers(program, o, interval) for interval in args[0]]
        elif isinstance(o, Clamp):
            shift = program.signals[o.arg].fix.frac - o.out.fix.frac
            clamped = [(min(max(lo, o.lo), o.hi), min(max(hi, o.lo), o.hi)) for lo, hi in args[0]]
            found[o.out.name] = [_fitted(c, shift, o.rounding, o.out.fix) for c in clamped]
        elif isinstance(o, Threshold):
            both = [[o.below] * (lo < o.at) + [o.above] * (hi >= o.at) for lo, hi in args[0]]
            found[o.out.name] = [(min(b), max(b)) for b in both]
        elif isinstance(o, Select):
            found[o.out.name] = _selected(program, o, args)
    return found


def accumulators(o: Affine, columns: Sequence[Interval]) -> list[Interval]:
    """The exact range of bias + weights * codes of each row."""
    ends = np.array(columns, object).reshape(-1, 2)
    weights, bias = o.weights.astype(object), o.bias.astype(object)
    up, down = np.where(weights > 0, weights, 0), np.where(weights < 0, weights, 0)
    lo, hi = bias + up @ ends[:, 0] + down @ ends[:, 1], bias + up @ ends[:, 1] + down @ ends[:, 0]
    return [(int(a), int(b)) for a, b in zip(lo, hi, strict=True)]


def _answers(program: Program, o: Lookup, interval: Interval) -> Interval:
    """Of every code in the interval, in parts of a million."""
    lo, hi = interval
    part = 1 << 20
    found = [lookup(program.table[o.table], np.arange(a, min(a + part, hi + 1))) for a in range(lo, hi + 1, part)]
    return min(int(y.min()) for y in found), max(int(y.max()) for y in found)


def _fitted(interval: Interval, shift: int, rounding: Rounding, fix: Fix, wraps: bool = False) -> Interval:
    """The codes that numbers of the interval are requantized to; rounding and saturation keep their order."""
    lo, hi = (_round(v, shift, rounding) for v in interval)
    if fix.lo <= lo and hi <= fix.hi:
        return lo, hi
    return (fix.lo, fix.hi) if wraps else (min(max(lo, fix.lo), fix.hi), min(max(hi, fix.lo), fix.hi))


def _round(v: int, shift: int, rounding: Rounding) -> int:
    if shift <= 0:
        return v << -shift
    quotient, rest, half = v >> shift, v & ((1 << shift) - 1), 1 << (shift - 1)
    if rounding is Rounding.TRUNCATE:
        return quotient
    return quotient + (rest > half or (rest == half and (rounding is Rounding.HALF_UP or quotient & 1 == 1)))


def _selected(program: Program, o: Select, args: Sequence[Sequence[Interval]]) -> list[Interval]:
    found = []
    for (least, most), above, below in zip(*args, strict=True):
        taken = [(o.above, above)] * (most >= 0) + [(o.below, below)] * (least < 0)
        shifts = [program.signals[name].fix.frac - o.out.fix.frac for name, _ in taken]
        ends = [_fitted(i, s, o.rounding, o.out.fix) for (_, i), s in zip(taken, shifts, strict=True)]
        found.append((min(lo for lo, _ in ends), max(hi for _, hi in ends)))
    return found
