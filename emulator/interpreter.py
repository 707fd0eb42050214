"""The interpreter: docs/integer-program.md in NumPy int64, step by step. Slow and obvious; it is the definition."""

from dataclasses import dataclass

import numpy as np

from greygate.emulator.program import (
    ACCUMULATOR_BITS,
    ROUNDED,
    Affine,
    Clamp,
    Fix,
    Lookup,
    Overflow,
    Program,
    Rounding,
    Select,
    Symmetry,
    Table,
    Threshold,
)


@dataclass(frozen=True)
class Run:
    """What a program did over a sequence (or a batch of sequences, in the leading axes).

    outputs: int64 (..., N, output columns). states: int64 (..., N, state columns), as they stand *after* each step.
    saturations: events per signal. trace: every signal as int64 (..., N, size), if it was asked for.
    """

    outputs: np.ndarray
    states: np.ndarray
    saturations: dict[str, int]
    trace: dict[str, np.ndarray] | None = None


def round_shift(a: np.ndarray, shift: np.ndarray, rounding: Rounding) -> np.ndarray:
    """a * 2^-shift as an integer; shift may be negative (then it is exact), or beyond the bits of an int64."""
    right = np.clip(shift, 0, ACCUMULATOR_BITS)  # no a has more bits: shifted further, it gives the same
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


def lookup(table: Table, x: np.ndarray) -> np.ndarray:
    """The table's answer to every code of x."""
    points = np.array(table.points, np.int64)
    last = len(points) - 1
    half = (1 << table.shift) >> 1
    a = np.abs(x)
    i = np.minimum(a >> table.shift, last)
    if table.interpolated:
        step = points[np.minimum(i + 1, last)] - points[i]
        y = points[i] + ((step * (a & ((1 << table.shift) - 1)) + half) >> table.shift)
    else:
        y = np.where(i < last, points[np.minimum((a + half) >> table.shift, last)], points[last])
    negative = {Symmetry.ODD: -y, Symmetry.EVEN: y, Symmetry.COMPLEMENT: (1 << table.out.frac) - y}
    return np.where(x < 0, negative[table.symmetry], y)


def interpret(program: Program, inputs: np.ndarray, initial: np.ndarray | None = None, trace: bool = False) -> Run:
    """Run a program over input codes (..., N, input columns); `initial` are state codes (..., state columns)."""
    inputs = np.asarray(inputs, np.int64)
    batch, steps = inputs.shape[:-2], inputs.shape[-2]
    declared = np.concatenate([np.array(s.initial, np.int64) for s in program.states] or [np.zeros(0, np.int64)])
    now = np.broadcast_to(declared if initial is None else initial, (*batch, declared.size)).astype(np.int64)
    saturations = dict.fromkeys((o.out.name for o in program.operations if isinstance(o, ROUNDED)), 0)
    outputs, states, traced = [], [], {name: [] for name in program.signals}

    def requantize(o, a, frac, overflow):
        a = round_shift(a, np.asarray(frac) - o.out.fix.frac, o.rounding)
        saturations[o.out.name] += int(np.count_nonzero((a < o.out.fix.lo) | (a > o.out.fix.hi)))
        return fit(a, o.out.fix, overflow)

    for k in range(steps):
        value = {}
        start = 0
        for port in program.inputs:
            value[port.signal.name] = inputs[..., k, start : start + port.signal.size]
            start += port.signal.size
        start = 0
        for state in program.states:
            value[state.signal.name] = now[..., start : start + state.signal.size]
            start += state.signal.size
        for o in program.operations:
            if isinstance(o, Affine):
                x = np.concatenate([value[a] for a in o.args], axis=-1)
                result = requantize(o, o.bias + x @ o.weights.T, o.frac, o.overflow)
            elif isinstance(o, Lookup):
                result = lookup(program.table[o.table], value[o.arg])
            elif isinstance(o, Clamp):
                frac = program.signals[o.arg].fix.frac
                result = requantize(o, np.clip(value[o.arg], o.lo, o.hi), frac, Overflow.SATURATE)
            elif isinstance(o, Threshold):
                result = np.where(value[o.arg] >= o.at, np.int64(o.above), np.int64(o.below))
            elif isinstance(o, Select):
                first = value[o.condition] >= 0
                frac = np.where(first, program.signals[o.above].fix.frac, program.signals[o.below].fix.frac)
                result = requantize(o, np.where(first, value[o.above], value[o.below]), frac, Overflow.SATURATE)
            value[o.out.name] = result
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
