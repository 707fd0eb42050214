"""The least and the greatest code that every element of a signal can take: exact intervals, operation by operation.

Inputs and states may hold any code of their format, so an interval holds after every reset and whatever the states
are set to.
"""

from collections.abc import Callable

from greygate.emulator.numbers import Fix, Overflow, Rounding
from greygate.emulator.program import Affine, Clamp, Lookup, Op, Product, Program, Select, Threshold

Interval = tuple[int, int]  # (lo, hi), both possible


def code_ranges(program: Program) -> dict[str, list[Interval]]:
    """Signal -> the interval of each of its elements."""
    found: dict[str, list[Interval]] = {}
    for s in program.signals.values():
        found[s.name] = [(s.fix.lo, s.fix.hi)] * s.size
    for o in program.operations:
        found[o.out.name] = _OF[o.op](program, o, [found[a] for a in o.args])
    return found


def rounding_constant(rounding: Rounding, shift: int) -> int:
    """What is added to an accumulator before `shift` bits are dropped; half_even adds as half_up, and mends ties."""
    return 1 << (shift - 1) if shift > 0 and rounding is not Rounding.TRUNCATE else 0


def rounded(interval: Interval, shift: int, rounding: Rounding) -> Interval:
    """The integers that an accumulator of that interval is rounded to, before saturation."""
    lo, hi = (v + rounding_constant(rounding, shift) for v in interval)
    lo, hi = (v >> shift if shift > 0 else v << -shift for v in (lo, hi))
    return (lo & ~1 if rounding is Rounding.HALF_EVEN and shift > 0 else lo), hi


def fitted(interval: Interval, fix: Fix, overflow: Overflow) -> Interval:
    """The codes that integers of that interval become."""
    lo, hi = interval
    if fix.lo <= lo and hi <= fix.hi:
        return interval
    if overflow is Overflow.WRAP:
        return fix.lo, fix.hi
    return min(max(lo, fix.lo), fix.hi), min(max(hi, fix.lo), fix.hi)


def _affine(program: Program, o: Affine, args: list[list[Interval]]) -> list[Interval]:
    columns = [interval for arg in args for interval in arg]
    found = []
    for weights, bias, frac in zip(o.weights.tolist(), o.bias.tolist(), o.frac.tolist(), strict=True):
        lo = hi = int(bias)
        for w, (least, most) in zip(weights, columns, strict=True):
            if w:
                lo += w * (least if w > 0 else most)
                hi += w * (most if w > 0 else least)
        found.append(fitted(rounded((lo, hi), frac - o.out.fix.frac, o.rounding), o.out.fix, o.overflow))
    return found


def _table(program: Program, o: Lookup, args: list[list[Interval]]) -> list[Interval]:
    return [program.table[o.table].extremes] * o.out.size


def _clamp(program: Program, o: Clamp, args: list[list[Interval]]) -> list[Interval]:
    shift = program.signals[o.arg].fix.frac - o.out.fix.frac
    found = []
    for lo, hi in args[0]:
        clamped = min(max(lo, o.lo), o.hi), min(max(hi, o.lo), o.hi)
        found.append(fitted(rounded(clamped, shift, o.rounding), o.out.fix, o.overflow))
    return found


def _threshold(program: Program, o: Threshold, args: list[list[Interval]]) -> list[Interval]:
    found = []
    for lo, hi in args[0]:
        answers = [o.below] * (lo < o.at) + [o.above] * (hi >= o.at)
        found.append((min(answers), max(answers)))
    return found


def _select(program: Program, o: Select, args: list[list[Interval]]) -> list[Interval]:
    shifts = [program.signals[a].fix.frac - o.out.fix.frac for a in (o.above, o.below)]
    found = []
    for (least, most), *values in zip(*args, strict=True):
        both = [
            fitted(rounded(value, shift, o.rounding), o.out.fix, o.overflow)
            for value, shift, possible in zip(values, shifts, (most >= 0, least < 0), strict=True)
            if possible
        ]
        found.append((min(lo for lo, _ in both), max(hi for _, hi in both)))
    return found


def _product(program: Program, o: Product, args: list[list[Interval]]) -> list[Interval]:
    shift = sum(program.signals[a].fix.frac for a in o.args) - o.out.fix.frac
    found = []
    for one, other in zip(*args, strict=True):
        ends = [a * b for a in one for b in other]
        found.append(fitted(rounded((min(ends), max(ends)), shift, o.rounding), o.out.fix, o.overflow))
    return found


_OF: dict[Op, Callable[..., list[Interval]]] = {
    Op.AFFINE: _affine,
    Op.TABLE: _table,
    Op.CLAMP: _clamp,
    Op.THRESHOLD: _threshold,
    Op.SELECT: _select,
    Op.PRODUCT: _product,
}
