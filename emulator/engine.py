"""The fast engine: it gives the interpreter's answer, bit for bit, by one numba kernel for programs as arrays.

Many scenarios run in the lanes of the vector units (lanes.py); few, or those of a wide program, one after another here.

Sums of products run in float64 if the program proves that an accumulator stays below 2^53. Every partial sum is then an
integer that float64 holds exactly, in any order, and the processor has vector units for float64. Wider accumulators
run in int64. No other value is a float.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numba
import numpy as np

from greygate.emulator import lanes
from greygate.emulator.interpreter import Run
from greygate.emulator.numbers import ACCUMULATOR_BITS, Overflow, Rounding
from greygate.emulator.program import Affine, Clamp, Lookup, Op, Product, Program, Select, Threshold
from greygate.emulator.tables import Lines, Symmetry, Table

EXACT_BITS = 53  # integers up to 2^53 are exact in float64
AFFINE, AFFINE_WIDE, TABLE, CLAMP, THRESHOLD, SELECT, LINES, PRODUCT = range(8)
COLUMNS = 13  # kind, first element of the result, its size, and the numbers that the kind needs
# unsigned, so that numba omits its check for negative indices and the loops become vector code
ZERO, ONE, TWO, THREE, FOUR = (np.uint64(n) for n in range(5))
_ROUNDING = list(Rounding)
_ARRAYS: "WeakKeyDictionary[Program, _Arrays]" = WeakKeyDictionary()
_LANES: "WeakKeyDictionary[Program, lanes.Lanes | None]" = WeakKeyDictionary()


class _Arrays(NamedTuple):
    """A program as arrays. Several rows of an affine operation are padded to a multiple of four."""

    operations: np.ndarray  # (n, COLUMNS) int64; columns depend on the kind, see `_Tabulator`
    reads: np.ndarray  # uint64: element that each column of each affine operation reads
    weights: np.ndarray  # float64, column after column
    weights_int: np.ndarray  # the same as int64
    bias: np.ndarray  # int64, per padded row
    shifts: np.ndarray  # int64, per padded row
    points: np.ndarray  # int64, all tables; of lines: see `_Tabulator.lines`
    moves: np.ndarray  # (states, 2): element of the source, element of the state
    inputs: np.ndarray  # elements
    outputs: np.ndarray  # elements
    elements: int
    widest: int


class _Tabulator:
    """Makes a row of whole numbers for each operation, and collects the weights to which affine operations refer.

    first: the first element of each signal. tables: the first point of each table.
    """

    def __init__(self, program: Program):
        self.program = program
        self.first, self.elements = {}, 0
        for name, signal in program.signals.items():
            self.first[name] = self.elements
            self.elements += signal.size
        self.tables = {}
        self.points: list[int] = []
        for table in program.tables:
            self.tables[table.name] = len(self.points)
            self.points += table.points if isinstance(table, Table) else self.lines(table)
        self.reads: list[int] = []
        self.weights, self.bias, self.shifts = ([np.zeros(0, np.int64)] for _ in range(3))
        self.weight_at, self.row_at = 0, 0
        self.widest = sum(s.signal.size for s in program.states)

    def places(self, names: Iterable[str]) -> list[int]:
        """The elements of these signals, one after another."""
        return [self.first[name] + i for name in names for i in range(self.program.signals[name].size)]

    def drop(self, name: str, o: Clamp | Select) -> int:
        """Fraction bits that are lost, at most ACCUMULATOR_BITS: more give the same result."""
        return min(self.program.signals[name].fix.frac - o.out.fix.frac, ACCUMULATOR_BITS)

    def affine(self, o: Affine) -> tuple:
        kind = AFFINE if self.program.accumulator_width(o) < EXACT_BITS else AFFINE_WIDE
        columns = self.places(o.args)
        padded = 1 if o.out.size == 1 else -(-o.out.size // 4) * 4
        modes = (_ROUNDING.index(o.rounding), o.overflow is Overflow.WRAP)
        row = (kind, len(self.reads), len(columns), self.weight_at, self.row_at, o.out.fix.width, *modes, padded)
        part = np.zeros((len(columns), padded), np.int64)
        part[:, : o.out.size] = o.weights.T
        pad = np.zeros(padded - o.out.size, np.int64)
        self.reads += columns
        self.weights.append(part.ravel())
        self.bias.append(np.r_[o.bias, pad])
        self.shifts.append(np.r_[o.frac - o.out.fix.frac, pad])
        self.weight_at, self.row_at = self.weight_at + part.size, self.row_at + padded
        self.widest = max(self.widest, padded, len(columns))
        return row

    @staticmethod
    def lines(table: Lines) -> list[int]:
        """Four numbers of each octave: least code, first segment, shift, drop; then base and slope of each segment."""
        s = table.segments
        lefts = [min(left, 1 << ACCUMULATOR_BITS) for left in s.lefts]  # no code has so many bits
        octaves = zip(lefts, s.firsts, s.shifts, s.drops, strict=True)
        words = zip(s.bases, s.slopes, strict=True)
        return [n for part in (octaves, words) for row in part for n in row]

    def lookup(self, o: Lookup) -> tuple:
        t = self.program.table[o.table]
        flip = 0 if t.symmetry is Symmetry.EVEN else -1
        lift = 1 << t.out.frac if t.symmetry is Symmetry.COMPLEMENT else 0
        if isinstance(t, Lines):
            s = t.segments
            fractions = (*s.halves, s.below, s.guard)
            ends = (self.first[o.arg], self.tables[o.table], len(s.shifts), len(s.bases) - 1)
            return (LINES, *ends, flip, lift, *fractions)
        last = len(t.points) - 1
        end = min(last << t.shift, 1 << t.arg.width)  # the argument of the last point, or beyond all arguments
        return (TABLE, self.first[o.arg], self.tables[o.table], last, t.shift, t.interpolated, flip, lift, end)

    def clamp(self, o: Clamp) -> tuple:
        rounding = _ROUNDING.index(o.rounding)
        return (CLAMP, self.first[o.arg], o.lo, o.hi, o.out.fix.width, rounding, self.drop(o.arg, o))

    def threshold(self, o: Threshold) -> tuple:
        return (THRESHOLD, self.first[o.arg], o.at, o.below, o.above)

    def select(self, o: Select) -> tuple:
        places, modes = (self.first[a] for a in o.args), (o.out.fix.width, _ROUNDING.index(o.rounding))
        return (SELECT, *places, *modes, self.drop(o.above, o), self.drop(o.below, o))

    def product(self, o: Product) -> tuple:
        shift = min(sum(self.program.signals[a].fix.frac for a in o.args) - o.out.fix.frac, ACCUMULATOR_BITS)
        return (PRODUCT, *(self.first[a] for a in o.args), o.out.fix.width, _ROUNDING.index(o.rounding), shift)


_TABULATE: dict[Op, Callable] = {
    Op.AFFINE: _Tabulator.affine,
    Op.TABLE: _Tabulator.lookup,
    Op.CLAMP: _Tabulator.clamp,
    Op.THRESHOLD: _Tabulator.threshold,
    Op.SELECT: _Tabulator.select,
    Op.PRODUCT: _Tabulator.product,
}


def _tabulate(program: Program) -> _Arrays:
    t = _Tabulator(program)
    operations = np.zeros((len(program.operations), COLUMNS), np.int64)
    for row, o in zip(operations, program.operations, strict=True):
        kind, *rest = _TABULATE[o.op](t, o)
        row[: 3 + len(rest)] = kind, t.first[o.out.name], o.out.size, *rest
    weights = np.concatenate(t.weights)
    moves = t.places(s.source for s in program.states), t.places(s.signal.name for s in program.states)
    return _Arrays(
        operations,
        np.array(t.reads, np.uint64),
        weights.astype(np.float64),
        weights,
        np.concatenate(t.bias),
        np.concatenate(t.shifts),
        np.array(t.points, np.int64),
        np.ascontiguousarray(np.array(moves, np.int64).T),
        np.array(t.places(p.signal.name for p in program.inputs), np.int64),
        np.array(t.places(p.signal.name for p in program.outputs), np.int64),
        t.elements,
        t.widest,
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


@numba.njit(inline="always")
def _look_up(points, base, last, end, shift, half, interpolated, flip, lift, x):  # pragma: no cover - compiled
    sign = x >> 63
    a = min((x ^ sign) - sign, end)
    if interpolated:  # beyond the end, this is the right edge of the last interval: the last point
        i = min(a >> shift, last - 1)
        left, right = points[np.uint64(base + i)], points[np.uint64(base + i + 1)]
        y = left + (((right - left) * (a - (i << shift)) + half) >> shift)
    else:
        y = points[np.uint64(base + min((a + half) >> shift, last))]
    return (y ^ (sign & flip)) - (sign & flip) + (sign & lift)  # for a negative x: minus y, and what the symmetry adds


@numba.njit(inline="always")
def _on_line(words, at, octaves, last, flip, lift, lower, upper, below, guard, x):  # pragma: no cover - compiled
    sign = x >> 63
    m, o = x ^ sign, 0
    while o + 1 < octaves and m >= words[at + 4 * o + 4]:
        o += 1
    left, first, shift, drop = words[at + 4 * o], words[at + 4 * o + 1], words[at + 4 * o + 2], words[at + 4 * o + 3]
    i = first + ((m - left) >> shift)
    place = ((m - left) & ((np.int64(1) << shift) - 1)) >> drop
    if drop == 0:
        place -= sign
    if i > last:
        i, place = last, np.int64(1) << (shift - drop)
    word = at + 4 * octaves + 2 * i
    y = (words[word] + upper + ((words[word + 1] * place + lower) >> below)) >> guard
    return (y ^ (sign & flip)) - (sign & flip) + (sign & lift)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _run(
    operations, reads, weights, weights_int, bias, shifts, points, moves, ins, outs, elements, widest,
    inputs, initial, outputs, states, saturations, trace
):  # fmt: skip  # pragma: no cover - compiled
    value = np.zeros(elements, np.float64)  # all of them integers of at most 48 bits
    gathered = np.zeros(widest, np.float64)
    acc = np.zeros(widest, np.int64)
    for sequence in range(len(inputs)):
        for m in range(len(moves)):
            value[moves[m, 1]] = initial[sequence, m]
        for k in range(inputs.shape[1]):
            for i in range(len(ins)):
                value[ins[i]] = inputs[sequence, k, i]
            for n in range(len(operations)):
                op = operations[n]
                kind, out, size = op[0], np.uint64(op[1]), np.uint64(op[2])
                if kind <= AFFINE_WIDE:
                    read, count, first, row = np.uint64(op[3]), np.uint64(op[4]), np.uint64(op[5]), np.uint64(op[6])
                    rounding, wrap, padded = op[8], op[9], np.uint64(op[10])
                    if kind == AFFINE:
                        for j in range(count):
                            gathered[j] = value[reads[read + j]]
                        if padded == ONE:
                            a0 = 0.0
                            for j in range(count):
                                a0 += weights[first + j] * gathered[j]
                            acc[ZERO] = np.int64(a0) + bias[row]
                        for r in range(ZERO, padded & ~THREE, FOUR):
                            a0 = a1 = a2 = a3 = 0.0
                            w = first + r
                            for j in range(count):
                                x = gathered[j]
                                a0 += weights[w] * x
                                a1 += weights[w + ONE] * x
                                a2 += weights[w + TWO] * x
                                a3 += weights[w + THREE] * x
                                w += padded
                            acc[r] = np.int64(a0) + bias[row + r]
                            acc[r + ONE] = np.int64(a1) + bias[row + r + ONE]
                            acc[r + TWO] = np.int64(a2) + bias[row + r + TWO]
                            acc[r + THREE] = np.int64(a3) + bias[row + r + THREE]
                    else:
                        for r in range(size):
                            acc[r] = bias[row + r]
                        for j in range(count):
                            xi = np.int64(value[reads[read + j]])
                            for r in range(size):
                                acc[r] += weights_int[first + j * padded + r] * xi
                    hi = (np.int64(1) << (op[7] - 1)) - 1
                    for r in range(size):
                        shift = shifts[row + r]
                        if rounding == 1 and shift > 0:
                            y = (acc[r] + (np.int64(1) << (shift - 1))) >> shift
                        else:
                            y = _round(acc[r], shift, rounding)
                        if y > hi or y < -hi - 1:
                            saturations[n] += 1
                            if wrap:
                                y = ((y + hi + 1) & (2 * hi + 1)) - hi - 1
                            else:
                                y = hi if y > hi else -hi - 1
                        value[out + r] = y
                elif kind == TABLE:
                    source, base, last, shift, end = np.uint64(op[3]), op[4], op[5], op[6], op[10]
                    flip, lift, half = op[8], op[9], (np.int64(1) << op[6]) >> 1
                    if op[7]:
                        for r in range(size):
                            x = np.int64(value[source + r])
                            value[out + r] = _look_up(points, base, last, end, shift, half, True, flip, lift, x)
                    else:
                        for r in range(size):
                            x = np.int64(value[source + r])
                            value[out + r] = _look_up(points, base, last, end, shift, half, False, flip, lift, x)
                elif kind == LINES:
                    source = np.uint64(op[3])
                    for r in range(size):
                        x = np.int64(value[source + r])
                        value[out + r] = _on_line(
                            points, op[4], op[5], op[6], op[7], op[8], op[9], op[10], op[11], op[12], x
                        )
                elif kind == CLAMP:
                    source, lo, top = np.uint64(op[3]), op[4], op[5]
                    hi = (np.int64(1) << (op[6] - 1)) - 1
                    for r in range(size):
                        y = _round(min(max(np.int64(value[source + r]), lo), top), op[8], op[7])
                        if y > hi or y < -hi - 1:
                            saturations[n] += 1
                            y = hi if y > hi else -hi - 1
                        value[out + r] = y
                elif kind == SELECT:
                    condition, above, below = np.uint64(op[3]), np.uint64(op[4]), np.uint64(op[5])
                    hi = (np.int64(1) << (op[6] - 1)) - 1
                    for r in range(size):
                        if value[condition + r] >= 0:
                            y = _round(np.int64(value[above + r]), op[8], op[7])
                        else:
                            y = _round(np.int64(value[below + r]), op[9], op[7])
                        if y > hi or y < -hi - 1:
                            saturations[n] += 1
                            y = hi if y > hi else -hi - 1
                        value[out + r] = y
                elif kind == PRODUCT:
                    one, other = np.uint64(op[3]), np.uint64(op[4])
                    hi = (np.int64(1) << (op[5] - 1)) - 1
                    for r in range(size):
                        y = _round(np.int64(value[one + r]) * np.int64(value[other + r]), op[7], op[6])
                        if y > hi or y < -hi - 1:
                            saturations[n] += 1
                            y = hi if y > hi else -hi - 1
                        value[out + r] = y
                else:
                    for r in range(size):
                        value[out + r] = op[6] if value[np.uint64(op[3]) + r] >= op[4] else op[5]
            for j in range(len(outs)):
                outputs[sequence, k, j] = np.int64(value[outs[j]])
            if trace.shape[1]:
                for e in range(elements):
                    trace[sequence, k, e] = np.int64(value[e])
            for m in range(len(moves)):
                gathered[m] = value[moves[m, 0]]
            for m in range(len(moves)):
                value[moves[m, 1]] = gathered[m]
            if states.shape[1]:
                for m in range(len(moves)):
                    states[sequence, k, m] = np.int64(gathered[m])


def _kept(kept: WeakKeyDictionary, program: Program, make: Callable):
    if program not in kept:
        kept[program] = make(program)
    return kept[program]


def run(
    program: Program, inputs: np.ndarray, initial: np.ndarray | None = None, trace: bool = False, states: bool = True
) -> Run:
    """Fast `interpreter.interpret`. inputs: codes (..., N, columns); initial: (..., state columns).

    states=False omits the states from the answer (an empty array), for speed.
    """
    inputs = np.require(inputs, np.int64, ["C", "W"])  # always the same kind of array: numba compiles for each kind
    batch, (steps, columns) = inputs.shape[:-2], inputs.shape[-2:]
    flat = inputs.reshape(-1, steps, columns)
    declared = np.array([v for s in program.states for v in s.initial], np.int64)
    start = np.broadcast_to(declared if initial is None else initial, (*batch, len(declared)))
    start = np.array(start, np.int64).reshape(len(flat), len(declared))
    sizes = [s.size for s in program.signals.values()]
    outputs = np.empty((len(flat), steps, sum(p.signal.size for p in program.outputs)), np.int64)
    after = np.empty((len(flat), steps if states else 0, len(declared)), np.int64)
    traced = np.empty((len(flat), steps if trace else 0, sum(sizes)), np.int64)
    events = np.zeros(len(program.operations), np.int64)
    beside = _kept(_LANES, program, lanes.tabulate) if len(flat) >= lanes.ENOUGH else None
    kernel: Callable[..., None] = lanes.run if beside else _run
    kernel(*(beside or _kept(_ARRAYS, program, _tabulate)), flat, start, outputs, after, events, traced)
    saturations = {o.out.name: int(n) for o, n in zip(program.operations, events, strict=True) if o.requantizes}
    everything = None
    if trace:
        parts = np.split(traced.reshape(*batch, steps, -1), np.cumsum(sizes)[:-1], axis=-1)
        everything = dict(zip(program.signals, parts, strict=True))
    return Run(
        outputs.reshape(*batch, *outputs.shape[1:]), after.reshape(*batch, *after.shape[1:]), saturations, everything
    )
