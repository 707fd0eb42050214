"""No accumulator of the folded architecture overflows, whatever the order in which its terms come."""

from collections.abc import Sequence

from greygate.compiler.folding.schedule import fold
from greygate.compiler.targets import Design
from greygate.emulator.numbers import Overflow, Rounding
from greygate.emulator.program import Affine, Program
from greygate.hardware.proofs.affine import signed_bits
from greygate.hardware.proofs.elaborated import Block
from greygate.hardware.proofs.proof import Proof, timed
from greygate.hardware.proofs.reach import reachable

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
