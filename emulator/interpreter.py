"""The interpreter: docs/integer-program.md in NumPy int64, step by step.

It is slow and simple, and it is the definition.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from greygate.emulator.numbers import ACCUMULATOR_BITS, Fix, Overflow, Rounding
from greygate.emulator.program import Affine, Clamp, Lookup, Op, Product, Program, Select, Signal, Threshold
from greygate.emulator.tables import Lines, Segments, Symmetry, Table


@dataclass(frozen=True)
class Run:
    """The result of a program over a sequence (or a batch of sequences, in the leading axes).

    outputs: int64 (..., N, output columns). states: int64 (..., N, state columns), *after* each step.
    saturations: events per signal. trace: every signal as int64 (..., N, size), if it was requested.
    """

    outputs: np.ndarray
    states: np.ndarray
    saturations: dict[str, int]
    trace: dict[str, np.ndarray] | None = None


def round_shift(a: np.ndarray, shift: np.ndarray, rounding: Rounding) -> np.ndarray:
    """a * 2^-shift, rounded to an integer; shift may be negative (then it is exact), or exceed the bits of an int64."""
    right = np.clip(shift, 0, ACCUMULATOR_BITS)  # no a has more bits, so a further shift gives the same result
    half = np.where(right > 0, np.int64(1) << np.maximum(right - 1, 0), 0)
    if rounding is Rounding.TRUNCATE:
        constant = np.zeros_like(a)
    elif rounding is Rounding.HALF_UP:
        constant = half + np.zeros_like(a)
    else:
        constant = np.where(right > 0, half - 1 + ((a >> right) & 1), 0)
    return ((a + constant) >> right) << np.maximum(-shift, 0)


def fit(a: np.ndarray, fix: Fix, overflow: Overflow) -> np.ndarray:
    """Bring integers into the format: clipped or wrapped."""
    if overflow is Overflow.SATURATE:
        return np.clip(a, fix.lo, fix.hi)
    return ((a - fix.lo) & ((1 << fix.width) - 1)) + fix.lo


def lookup(table: Table | Lines, x: np.ndarray) -> np.ndarray:
    """The table's answer to every code of x."""
    y = _nearest(table, x) if isinstance(table, Table) and not table.interpolated else _on_lines(table.segments, x)
    negative = {Symmetry.ODD: -y, Symmetry.EVEN: y, Symmetry.COMPLEMENT: (1 << table.out.frac) - y}
    return np.where(x < 0, negative[table.symmetry], y)


def _nearest(table: Table, x: np.ndarray) -> np.ndarray:
    """The point nearest to |x|."""
    points, last, half = np.array(table.points, np.int64), len(table.points) - 1, (1 << table.shift) >> 1
    a = np.abs(x)
    return points[np.where(a >> table.shift < last, np.minimum((a + half) >> table.shift, last), last)]


def _on_lines(s: Segments, x: np.ndarray) -> np.ndarray:
    """The line of the segment of |x| at the place of |x|."""
    begins = [min(left, 1 << ACCUMULATOR_BITS) for left in s.lefts]  # no code has so many bits
    lefts, firsts, shifts, drops = (np.array(part, np.int64) for part in (begins, s.firsts, s.shifts, s.drops))
    bases, slopes, last = np.array(s.bases, np.int64), np.array(s.slopes, np.int64), len(s.bases) - 1
    m = np.where(x < 0, ~x, x)
    o = np.searchsorted(lefts[1:], m, side="right")
    shift, drop, local = shifts[o], drops[o], m - lefts[o]
    i = firsts[o] + (local >> shift)
    place = ((local & ((1 << shift) - 1)) >> drop) + ((x < 0) & (drop == 0))
    place = np.where(i > last, 1 << (shift - drop), place)
    i = np.minimum(i, last)
    return s.at(bases[i], slopes[i], place)


# Each operation on the codes x of its arguments. It returns codes, or, to be requantized, an accumulator and its frac.


def _affine(program: Program, o: Affine, *x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return o.bias + np.concatenate(x, axis=-1) @ o.weights.T, o.frac


def _table(program: Program, o: Lookup, x: np.ndarray) -> np.ndarray:
    return lookup(program.table[o.table], x)


def _clamp(program: Program, o: Clamp, x: np.ndarray) -> tuple[np.ndarray, int]:
    return np.clip(x, o.lo, o.hi), program.signals[o.arg].fix.frac


def _threshold(program: Program, o: Threshold, x: np.ndarray) -> np.ndarray:
    return np.where(x >= o.at, np.int64(o.above), np.int64(o.below))


def _select(
    program: Program, o: Select, condition: np.ndarray, above: np.ndarray, below: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    first = condition >= 0
    frac = np.where(first, program.signals[o.above].fix.frac, program.signals[o.below].fix.frac)
    return np.where(first, above, below), frac


def _product(program: Program, o: Product, one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, int]:
    return one * other, sum(program.signals[a].fix.frac for a in o.args)


PERFORM: dict[Op, Callable] = {
    Op.AFFINE: _affine,
    Op.TABLE: _table,
    Op.CLAMP: _clamp,
    Op.THRESHOLD: _threshold,
    Op.SELECT: _select,
    Op.PRODUCT: _product,
}


def interpret(program: Program, inputs: np.ndarray, initial: np.ndarray | None = None, trace: bool = False) -> Run:
    """Run a program over input codes (..., N, input columns); `initial` are state codes (..., state columns)."""
    inputs = np.asarray(inputs, np.int64)
    batch, steps = inputs.shape[:-2], inputs.shape[-2]
    declared = np.concatenate([np.array(s.initial, np.int64) for s in program.states] or [np.zeros(0, np.int64)])
    now = np.broadcast_to(declared if initial is None else initial, (*batch, declared.size)).astype(np.int64)
    saturations = dict.fromkeys((o.out.name for o in program.operations if o.requantizes), 0)
    outputs, states = [], []
    traced: dict[str, list[np.ndarray]] = {name: [] for name in program.signals}

    def requantize(o, a, frac):
        a = round_shift(a, np.asarray(frac) - o.out.fix.frac, o.rounding)
        saturations[o.out.name] += int(np.count_nonzero((a < o.out.fix.lo) | (a > o.out.fix.hi)))
        return fit(a, o.out.fix, o.overflow)

    for k in range(steps):
        value = _split(inputs[..., k, :], [p.signal for p in program.inputs])
        value |= _split(now, [s.signal for s in program.states])
        for o in program.operations:
            result = PERFORM[o.op](program, o, *(value[a] for a in o.args))
            value[o.out.name] = requantize(o, *result) if o.requantizes else result
        outputs.append(np.concatenate([value[p.signal.name] for p in program.outputs], axis=-1))
        if program.states:
            now = np.concatenate([value[s.source] for s in program.states], axis=-1)
        states.append(now)
        if trace:
            for name, v in value.items():
                traced[name].append(v)
    return Run(
        np.stack(outputs, axis=-2),
        np.stack(states, axis=-2),
        saturations,
        {n: np.stack(v, axis=-2) for n, v in traced.items()} if trace else None,
    )


def _split(codes: np.ndarray, signals: Sequence[Signal]) -> dict[str, np.ndarray]:
    """Split columns (..., columns) into the signals side by side: each (..., size)."""
    ends = np.cumsum([s.size for s in signals], dtype=int).tolist()
    return {s.name: codes[..., end - s.size : end] for s, end in zip(signals, ends, strict=True)}
