"""The fast engine: the interpreter's answer, bit for bit, from one numba kernel that walks the program as arrays.

Sums of products run in float64 where the program proves that an accumulator stays below 2^53: every partial sum is then
an integer that float64 holds exactly, in any order, and the processor has vector units for it. Wider accumulators run in
int64. Nothing else is ever a float.
"""

from functools import lru_cache
from typing import NamedTuple

import numba
import numpy as np
from greygate.emulator.interpreter import Run
from greygate.emulator.program import Affine, Clamp, Lookup, Overflow, Program, Rounding, Symmetry

EXACT_BITS = 53  # integers up to 2^53 are exact in float64
AFFINE, AFFINE_WIDE, TABLE, CLAMP, THRESHOLD = range(5)
_ROUNDING = list(Rounding)
_SYMMETRY = list(Symmetry)
LANES = 4  # rows are padded to whole vectors


class _Arrays(NamedTuple):
    """A program as arrays. `operations` columns depend on the kind: see `_tabulate`."""

    operations: np.ndarray  # (n, 10) int64
    blocks: np.ndarray  # (m, 3): first element of the argument, its size, offset of its weights (column after column)
    weights: np.ndarray  # float64
    weights_int: np.ndarray  # the same as int64
    bias: np.ndarray  # int64, per padded row
    shifts: np.ndarray  # int64, per padded row
    points: np.ndarray  # int64, all tables
    moves: np.ndarray  # (states, 2): element of the source, element of the state
    inputs: np.ndarray  # elements
    outputs: np.ndarray  # elements
    elements: int
    widest: int


@lru_cache(maxsize=64)
def _cached(program_id: int, holder: "_Holder") -> _Arrays:
    return _tabulate(holder.program)


class _Holder:
    """Lets a program, which is not hashable, be a cache key by identity."""

    def __init__(self, program: Program):
        self.program = program

    def __hash__(self) -> int:
        return id(self.program)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Holder) and self.program is other.program


def _tabulate(program: Program) -> _Arrays:
    first, at = {}, 0
    for name, signal in program.signals.items():
        first[name] = at
        at += signal.size
    operations, blocks, weights, bias, shifts, points, tables = [], [], [], [], [], [], {}
    for table in program.tables:
        tables[table.name] = len(points)
        points += list(table.points)
    weight_at, row_at, widest = 0, 0, LANES
    for o in program.operations:
        out, size, fix = first[o.out.name], o.out.size, o.out.fix
        if isinstance(o, Affine):
            padded = -(-size // LANES) * LANES
            widest = max(widest, padded)
            kind = AFFINE if program.accumulator_width(o) < EXACT_BITS else AFFINE_WIDE
            wrap = o.overflow is Overflow.WRAP
            operations.append(
                (
                    kind,
                    out,
                    size,
                    len(blocks),
                    len(o.args),
                    row_at,
                    fix.width,
                    _ROUNDING.index(o.rounding),
                    wrap,
                    padded,
                )
            )
            column = 0
            for arg in o.args:
                n = program.signals[arg].size
                part = np.zeros((n, padded), np.int64)
                part[:, :size] = o.weights[:, column : column + n].T
                blocks.append((first[arg], n, weight_at))
                weights.append(part.ravel())
                weight_at += part.size
                column += n
            pad = np.zeros(padded - size, np.int64)
            bias.append(np.concatenate([o.bias, pad]))
            shifts.append(np.concatenate([o.frac - fix.frac, pad]))
            row_at += padded
        elif isinstance(o, Lookup):
            t = program.table[o.table]
            operations.append(
                (TABLE, out, size, first[o.arg], tables[o.table], len(t.points) - 1, t.shift, t.interpolated,
                 _SYMMETRY.index(t.symmetry), 1 << max(t.out.frac, 0))
            )  # fmt: skip
        elif isinstance(o, Clamp):
            shift = program.signals[o.arg].fix.frac - fix.frac
            operations.append(
                (CLAMP, out, size, first[o.arg], o.lo, o.hi, fix.width, _ROUNDING.index(o.rounding), shift, 0)
            )
        else:
            operations.append((THRESHOLD, out, size, first[o.arg], o.at, o.below, o.above, 0, 0, 0))
    moves = [(first[s.source] + i, first[s.signal.name] + i) for s in program.states for i in range(s.signal.size)]
    joined = np.concatenate(weights) if weights else np.zeros(0, np.int64)
    return _Arrays(
        np.array(operations, np.int64).reshape(-1, 10),
        np.array(blocks, np.int64).reshape(-1, 3),
        joined.astype(np.float64),
        joined,
        np.concatenate(bias) if bias else np.zeros(0, np.int64),
        np.concatenate(shifts) if shifts else np.zeros(0, np.int64),
        np.array(points, np.int64),
        np.array(moves, np.int64).reshape(-1, 2),
        np.array([first[p.signal.name] + i for p in program.inputs for i in range(p.signal.size)], np.int64),
        np.array([first[p.signal.name] + i for p in program.outputs for i in range(p.signal.size)], np.int64),
        at,
        max(widest, len(moves)),
    )


@numba.njit(inline="always")
def _round(a, shift, rounding):  # pragma: no cover - compiled
    if shift <= 0:
        return a << -shift
    if rounding == 0:
        return a >> shift
    half = np.int64(1) << (shift - 1)
    if rounding == 1:
        return (a + half) >> shift
    return (a + half - 1 + ((a >> shift) & 1)) >> shift


@numba.njit(cache=True, nogil=True, boundscheck=False, fastmath={"reassoc", "contract"})
def _run(
    operations, blocks, weights, weights_int, bias, shifts, points, moves, ins, outs, elements, widest,
    inputs, initial, outputs, states, saturations, trace
):  # fmt: skip  # pragma: no cover - compiled
    value = np.zeros(elements, np.int64)
    exact = np.zeros(elements, np.float64)  # the same, for the vector units
    acc = np.zeros(widest, np.float64)
    acc_int = np.zeros(widest, np.int64)
    for sequence in range(len(inputs)):
        for m in range(len(moves)):
            value[moves[m, 1]] = initial[sequence, m]
            exact[moves[m, 1]] = initial[sequence, m]
        for k in range(inputs.shape[1]):
            for i in range(len(ins)):
                value[ins[i]] = inputs[sequence, k, i]
                exact[ins[i]] = inputs[sequence, k, i]
            for n in range(len(operations)):
                kind, out, size = operations[n, 0], operations[n, 1], operations[n, 2]
                if kind <= AFFINE_WIDE:
                    block, count, row = operations[n, 3], operations[n, 4], operations[n, 5]
                    width, rounding, wrap, padded = operations[n, 6], operations[n, 7], operations[n, 8], operations[n, 9]
                    if kind == AFFINE:
                        for r in range(padded):
                            acc[r] = 0.0
                        for b in range(block, block + count):
                            source, w = blocks[b, 0], blocks[b, 2]
                            for i in range(blocks[b, 1]):
                                x = exact[source + i]
                                for r in range(padded):
                                    acc[r] += weights[w + r] * x
                                w += padded
                        for r in range(padded):
                            acc_int[r] = bias[row + r] + np.int64(acc[r])
                    else:
                        for r in range(padded):
                            acc_int[r] = bias[row + r]
                        for b in range(block, block + count):
                            source, w = blocks[b, 0], blocks[b, 2]
                            for i in range(blocks[b, 1]):
                                xi = value[source + i]
                                for r in range(padded):
                                    acc_int[r] += weights_int[w + r] * xi
                                w += padded
                    hi = (np.int64(1) << (width - 1)) - 1
                    for r in range(size):
                        shift = shifts[row + r]
                        y = acc_int[r]
                        if rounding == 1 and shift > 0:
                            y = (y + (np.int64(1) << (shift - 1))) >> shift
                        else:
                            y = _round(y, shift, rounding)
                        if y > hi or y < -hi - 1:
                            saturations[n] += 1
                            if wrap:
                                y = ((y + hi + 1) & (2 * hi + 1)) - hi - 1
                            else:
                                y = hi if y > hi else -hi - 1
                        value[out + r] = y
                        exact[out + r] = y
                elif kind == TABLE:
                    source, base, last, shift = operations[n, 3], operations[n, 4], operations[n, 5], operations[n, 6]
                    interpolated, symmetry, one = operations[n, 7], operations[n, 8], operations[n, 9]
                    half = (np.int64(1) << shift) >> 1
                    end = last << shift
                    if interpolated and symmetry == 0:
                        for r in range(size):
                            x = value[source + r]
                            a = min(abs(x), end)
                            i = min(a >> shift, last - 1)
                            y = points[base + i]
                            y += ((points[base + i + 1] - y) * (a - (i << shift)) + half) >> shift
                            y = -y if x < 0 else y
                            value[out + r] = y
                            exact[out + r] = y
                    else:
                        for r in range(size):
                            x = value[source + r]
                            a = min(abs(x), end)
                            if interpolated:
                                i = min(a >> shift, last - 1)
                                y = points[base + i]
                                y += ((points[base + i + 1] - y) * (a - (i << shift)) + half) >> shift
                            else:
                                y = points[base + min((a + half) >> shift, last)]
                            if x < 0:
                                y = -y if symmetry == 0 else (y if symmetry == 1 else one - y)
                            value[out + r] = y
                            exact[out + r] = y
                elif kind == CLAMP:
                    source, lo, hi_in, width = operations[n, 3], operations[n, 4], operations[n, 5], operations[n, 6]
                    hi = (np.int64(1) << (width - 1)) - 1
                    for r in range(size):
                        y = _round(min(max(value[source + r], lo), hi_in), operations[n, 8], operations[n, 7])
                        if y > hi or y < -hi - 1:
                            saturations[n] += 1
                            y = hi if y > hi else -hi - 1
                        value[out + r] = y
                        exact[out + r] = y
                else:
                    for r in range(size):
                        above = value[operations[n, 3] + r] >= operations[n, 4]
                        y = operations[n, 6] if above else operations[n, 5]
                        value[out + r] = y
                        exact[out + r] = y
            for j in range(len(outs)):
                outputs[sequence, k, j] = value[outs[j]]
            if trace.shape[1]:
                for e in range(elements):
                    trace[sequence, k, e] = value[e]
            for m in range(len(moves)):
                acc_int[m] = value[moves[m, 0]]
            for m in range(len(moves)):
                value[moves[m, 1]] = acc_int[m]
                exact[moves[m, 1]] = acc_int[m]
            if states.shape[1]:
                for m in range(len(moves)):
                    states[sequence, k, m] = acc_int[m]


def run(
    program: Program,
    inputs: np.ndarray,
    initial: np.ndarray | None = None,
    trace: bool = False,
    states: bool = True,
) -> Run:
    """As `interpreter.interpret`, fast. inputs: codes (..., N, columns); initial: (..., state columns).

    states=False leaves the states out of the answer (an empty array), for speed.
    """
    arrays = _cached(id(program), _Holder(program))
    inputs = np.ascontiguousarray(inputs, np.int64)
    batch, (steps, columns) = inputs.shape[:-2], inputs.shape[-2:]
    flat = inputs.reshape(-1, steps, columns)
    count = len(arrays.moves)
    declared = np.array([v for s in program.states for v in s.initial], np.int64)
    start = np.broadcast_to(declared if initial is None else initial, (*batch, count)).reshape(-1, count)
    outputs = np.empty((len(flat), steps, len(arrays.outputs)), np.int64)
    after = np.empty((len(flat), steps if states else 0, count), np.int64)
    traced = np.empty((len(flat), steps if trace else 0, arrays.elements), np.int64)
    saturations = np.zeros(len(program.operations), np.int64)
    _run(*arrays, flat, np.ascontiguousarray(start, np.int64), outputs, after, saturations, traced)
    counted = {
        o.out.name: int(n)
        for o, n in zip(program.operations, saturations, strict=True)
        if isinstance(o, Affine | Clamp)
    }
    everything = None
    if trace:
        ends = np.cumsum([s.size for s in program.signals.values()])[:-1]
        parts = np.split(traced.reshape(*batch, steps, arrays.elements), ends, axis=-1)
        everything = dict(zip(program.signals, parts, strict=True))
    shape = (*batch, after.shape[1], count)
    return Run(outputs.reshape(*batch, steps, -1), after.reshape(shape), counted, everything)
