"""No accumulator of the folded architecture overflows, whatever the order in which its terms come."""

from collections.abc import Sequence

import numpy as np

from greygate.compiler.folding.schedule import fold
from greygate.compiler.targets import Design
from greygate.emulator.interpreter import lookup
from greygate.emulator.numbers import Fix, Overflow, Rounding
from greygate.emulator.program import Affine, Clamp, Lookup, Product, Program, Select, Threshold
from greygate.hardware.proofs.affine import signed_bits
from greygate.hardware.proofs.elaborated import Block, Proof, timed

Interval = tuple[int, int]


def reachable(program: Program) -> dict[str, list[Interval]]:
    """Signal -> the interval of each element; inputs and states may hold any code of their formats."""
    found = {s.name: [(s.fix.lo, s.fix.hi)] * s.size for s in program.signals.values()}
    for o in program.operations:
        args = [found[a] for a in o.args]
        if isinstance(o, Affine):
            rows = _exact_rows(o, [interval for arg in args for interval in arg])
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
        elif isinstance(o, Product):
            found[o.out.name] = _multiplied(program, o, args)
    return found


def _exact_rows(o: Affine, columns: Sequence[Interval]) -> list[Interval]:
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


def _multiplied(program: Program, o: Product, args: Sequence[Sequence[Interval]]) -> list[Interval]:
    shift = sum(program.signals[a].fix.frac for a in o.args) - o.out.fix.frac
    corners = [[a * b for a in one for b in other] for one, other in zip(*args, strict=True)]
    return [_fitted((min(c), max(c)), shift, o.rounding, o.out.fix) for c in corners]


HOW = "interval arithmetic over all orders of the terms, with the widths of the emitted accumulator"


def accumulators(program: Program, design: Design, found: Sequence[Block]) -> list[Proof]:
    """A proof if the design has the accumulator and the drain of the folded architecture, with a row for each sum.

    The schedule says with which mode of the drain a row is taken, and so at which fraction it is summed. A weight or a
    code in two parts gives two terms, between which the accumulator may wrap; it is a two's complement, so that the sum
    behind them is right.
    """
    macs = [block for block in found if block.name == "greygate_mac"]
    drains = [block for block in found if block.name == "greygate_drain"]
    if not macs or not drains:
        return []
    what = "no accumulator overflows"
    with timed() as seconds:
        width = min(block.number("ACC_W") for block in macs)
        reach, rows, spares, why = reachable(program), [], [], None
        layers = fold(program, design.multipliers, design.factor).products.layers
        shifts = drains[0].field("SHIFTS", 8)
        for o in program.operations:
            if not isinstance(o, Affine):
                continue
            for r, (lo, hi) in enumerate(_sums(o, [interval for a in o.args for interval in reach[a]])):
                shift = int(o.frac[r]) - o.out.fix.frac
                mode = layers[o.out.name].modes[r]
                up = shifts[mode] - shift
                if up < 0 or _format(drains[0], mode) != (o.out.fix.width, o.overflow is Overflow.WRAP):
                    why = why or f"{o.out.name}[{r}]: mode {mode} of the drain does not give its format"
                    continue
                constant = 1 << (shift - 1) if shift > 0 and o.rounding is not Rounding.TRUNCATE else 0
                ends = lo + min(0, constant) << up, hi + constant << up
                spare = width - signed_bits(*ends)
                rows.append(
                    {"signal": f"{o.out.name}[{r}]", "lo": ends[0], "hi": ends[1], "width": width, "spare": spare}
                )
                spares.append(spare)
                if spare < 0 and why is None:
                    why = f"{o.out.name}[{r}] takes {ends[0]} to {ends[1]}, which {width} bits do not hold"
    figures = {"sums": len(rows), "least spare bits": min(spares, default=None)}
    return [Proof(what, HOW, why is None, seconds[0], why, figures, tuple(rows))]


def _sums(o: Affine, columns: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """The range of each row's sum and of every part of it that holds the bias."""
    found = []
    for weights, bias in zip(o.weights.tolist(), o.bias.tolist(), strict=True):
        ends = [sorted((w * lo, w * hi)) for w, (lo, hi) in zip(weights, columns, strict=True)]
        found.append((bias + sum(min(0, lo) for lo, _ in ends), bias + sum(max(0, hi) for _, hi in ends)))
    return found


def _format(drain: Block, mode: int) -> tuple[int, bool]:
    """Width of a mode's format, and whether it wraps."""
    widths, wraps = drain.field("WIDTHS", 8), drain.field("WRAPS", 1)
    return widths[mode], mode < len(wraps) and bool(wraps[mode])
