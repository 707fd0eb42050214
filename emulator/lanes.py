"""Many scenarios at once, side by side in the vector units of the processor: bit for bit the interpreter's answer.

Signals are floats, LANES scenarios next to one another: float32 where every code and every line of a table fits its 24
bits, else float64. Sums and products are float64 in units of the result: weights are scaled by a power of two, which
loses nothing, and rounding is a floor. A program in which one of them needs more than 53 bits has no lanes.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from greygate.cores import usable_cores
from greygate.emulator.numbers import Overflow, Rounding
from greygate.emulator.program import Affine, Clamp, Lookup, Op, Product, Program, Select, Threshold
from greygate.emulator.tables import Symmetry, Table

LANES = 64  # fewer: loops too short to pay; more: signals that leave the nearest cache, and lanes without a scenario
ENOUGH = 16  # scenarios from which on lanes are faster than one scenario after another
SINGLE_BITS, EXACT_BITS = 24, 53  # integers of so many bits are exact in float32, in float64
ROWS = 4  # of a sum at once, which share what they read
TOGETHER = 16  # lanes of ROWS sums that the registers hold
SUM, LINES, CLAMP, THRESHOLD, SELECT, PRODUCT = range(6)
WHOLE, REAL, OCTAVE = 8, 9, 7  # columns, see `_Tabulator`
_L = np.uint64(LANES)
_ZERO, _ONE, _ROWS, _TOGETHER = (np.uint64(n) for n in (0, 1, ROWS, TOGETHER))


class Lanes(NamedTuple):
    """A program as arrays; its columns depend on the operation, see `_Tabulator`."""

    whole: np.ndarray  # (operations, WHOLE) int64
    real: np.ndarray  # (operations, REAL) float64
    reads: np.ndarray  # uint64: elements that sums read
    weights: np.ndarray  # float64, in units of the result; column after column of ROWS rows, or of one
    biases: np.ndarray  # float64, the constant of the rounding added
    words: np.ndarray  # complex64 or complex128, for float32 or float64 signals: base and slope of each segment
    lines: np.ndarray  # float32 or float64: `real`, for tables
    octaves: np.ndarray  # (all octaves, OCTAVE), the same
    moves: np.ndarray  # (states, 2): element of the source, element of the state
    inputs: np.ndarray
    outputs: np.ndarray
    elements: int
    most: int  # elements of the longest result, and of all states


class _Tabulator:
    """Makes two rows of numbers for each operation. Its first three whole numbers: kind, first element, elements."""

    def __init__(self, program: Program):
        self.program = program
        self.first, self.elements = {}, 0
        for name, signal in program.signals.items():
            self.first[name] = self.elements
            self.elements += signal.size
        self.reads: list[int] = []
        self.weights, self.biases = [np.zeros(0)], [np.zeros(0)]
        self.at, self.row = 0, 0
        self.words: list[complex] = []
        self.octaves: list[tuple] = []

    def places(self, names: Iterable[str]) -> list[int]:
        """The elements of these signals, one after another."""
        return [self.first[name] + i for name in names for i in range(self.program.signals[name].size)]

    @staticmethod
    def fit(o: Affine | Clamp | Select | Product) -> tuple:
        fix = o.out.fix
        wraps, even = o.overflow is Overflow.WRAP, o.rounding is Rounding.HALF_EVEN
        return fix.lo, fix.hi, 2.0**fix.width if wraps else 0, even

    @staticmethod
    def scale(o: Affine | Clamp | Select | Product, frac):
        """What brings an integer of these fraction bits to units of the result, and what is added before a floor."""
        shift = np.asarray(frac) - o.out.fix.frac
        return np.ldexp(1.0, -shift), 0.5 * ((shift > 0) & (o.rounding is Rounding.HALF_UP))

    def affine(self, o: Affine) -> tuple:
        columns, size = self.places(o.args), o.out.size
        padded = 1 if size == 1 else -(-size // ROWS) * ROWS
        scale, half = self.scale(o, o.frac)
        weights, biases = np.zeros((padded, len(columns))), np.zeros(padded)
        weights[:size], biases[:size] = o.weights * scale[:, None], o.bias * scale + half
        row = (SUM, len(self.reads), len(columns), self.at, self.row)
        self.reads += columns
        blocks = weights.reshape(-1, min(padded, ROWS), len(columns))
        self.weights.append(blocks.transpose(0, 2, 1).ravel())
        self.biases.append(biases)
        self.at, self.row = self.at + weights.size, self.row + padded
        return row, self.fit(o)

    def lookup(self, o: Lookup) -> tuple:
        t = self.program.table[o.table]
        flip = 1 if t.symmetry is Symmetry.EVEN else -1
        lift = 1 << t.out.frac if t.symmetry is Symmetry.COMPLEMENT else 0
        at, octave = len(self.words), len(self.octaves)
        if isinstance(t, Table) and not t.interpolated:
            self.words += [complex(p) for p in t.points]
            self.octaves.append((0, 0, 2.0**-t.shift, 0, 0, len(t.points), len(t.points) - 1))
            inverts, before, line = 0, (1 << t.shift) >> 1, (1.0, 0, 1.0, 0)
        else:
            s = t.segments
            self.words += [complex(*word) for word in zip(s.bases, s.slopes, strict=True)]
            sizes = np.diff([*s.firsts, len(s.bases)])
            for left, first, shift, drop, size in zip(s.lefts, s.firsts, s.shifts, s.drops, sizes, strict=True):
                self.octaves.append((left, first, 2.0**-shift, 2.0 ** (shift - drop), drop == 0, size, size - 1))
            lower, upper = s.halves
            inverts, before, line = 1, 0, (2.0**-s.below, lower, 2.0**-s.guard, upper)
        ends = (at, octave, len(self.octaves))
        return (LINES, self.first[o.arg], *ends), (inverts, before, *line, flip, lift)

    def clamp(self, o: Clamp) -> tuple:
        scale = self.scale(o, self.program.signals[o.arg].fix.frac)
        return (CLAMP, self.first[o.arg]), (*self.fit(o), o.lo, o.hi, *scale)

    def threshold(self, o: Threshold) -> tuple:
        return (THRESHOLD, self.first[o.arg]), (o.at, o.below, o.above)

    def select(self, o: Select) -> tuple:
        scales = (self.scale(o, self.program.signals[a].fix.frac) for a in (o.above, o.below))
        return (SELECT, *(self.first[a] for a in o.args)), (*self.fit(o), *(n for scale in scales for n in scale))

    def product(self, o: Product) -> tuple:
        scale = self.scale(o, sum(self.program.signals[a].fix.frac for a in o.args))
        return (PRODUCT, *(self.first[a] for a in o.args)), (*self.fit(o), *scale)


_TABULATE: dict[Op, Callable] = {
    Op.AFFINE: _Tabulator.affine,
    Op.TABLE: _Tabulator.lookup,
    Op.CLAMP: _Tabulator.clamp,
    Op.THRESHOLD: _Tabulator.threshold,
    Op.SELECT: _Tabulator.select,
    Op.PRODUCT: _Tabulator.product,
}


def _bits(program: Program) -> int:
    """The most bits that a sum or a product needs, rounded and, where its fraction is finer, shifted to the left."""
    signals, found = program.signals, [0]
    for o in program.operations:
        if isinstance(o, Affine):
            found.append(program.accumulator_width(o) + max(0, *(o.out.fix.frac - o.frac)))
        elif isinstance(o, Product):
            one, other = (signals[a].fix for a in o.args)
            found.append(1 + one.width + other.width + max(0, o.out.fix.frac - one.frac - other.frac))
        elif isinstance(o, Clamp | Select):
            args = [signals[a].fix for a in (o.args if isinstance(o, Clamp) else (o.above, o.below))]
            found += [1 + arg.width + max(0, o.out.fix.frac - arg.frac) for arg in args]
    return max(found)


def tabulate(program: Program) -> Lanes | None:
    """The program for `run`, or None: one of its sums, products or tables needs more bits than float64 has."""
    interpolated = [t.segments.width() for t in program.tables if t.interpolated]
    formats = [s.fix.width for s in program.signals.values()]
    if max(_bits(program), *interpolated, 0) >= EXACT_BITS:
        return None
    t = _Tabulator(program)
    whole, real = np.zeros((len(program.operations), WHOLE), np.int64), np.zeros((len(program.operations), REAL))
    for n, o in enumerate(program.operations):
        (kind, *places), numbers = _TABULATE[o.op](t, o)
        whole[n, : 3 + len(places)] = kind, t.first[o.out.name], o.out.size, *places
        real[n, : len(numbers)] = numbers
    moves = t.places(s.source for s in program.states), t.places(s.signal.name for s in program.states)
    single = max(formats + interpolated) <= SINGLE_BITS
    words, signal = (np.complex64, np.float32) if single else (np.complex128, np.float64)
    return Lanes(
        whole,
        real,
        np.array(t.reads, np.uint64),
        np.concatenate(t.weights),
        np.concatenate(t.biases),
        np.array(t.words, words),
        real.astype(signal),
        np.array(t.octaves, signal).reshape(-1, OCTAVE),
        np.ascontiguousarray(np.array(moves, np.int64).T),
        np.array(t.places(p.signal.name for p in program.inputs), np.int64),
        np.array(t.places(p.signal.name for p in program.outputs), np.int64),
        t.elements,
        max([len(moves[0]), *(ROWS + s.size for s in program.signals.values())]),
    )


def _sums(rows: int, together: int):
    """A function that writes some rows of a sum for some lanes, all of them in registers until the last column.

    Loops over lanes inside one over columns would keep them in memory: what a compiler makes of numba's loops.
    """

    @intrinsic
    def sums(context, sums, values, reads, weights, biases, out, read, count, weight, bias):
        given = (sums, values, reads, weights, biases, out, read, count, weight, bias)

        def write(context, b, signature, args):
            arrays = zip(signature.args[:5], args[:5], strict=True)
            out, value, reads, weights, biases = (context.make_array(t)(context, b, a).data for t, a in arrays)
            at, read, count, weight, bias = args[5:]
            word, double = ir.IntType(64), ir.DoubleType()
            vector = ir.VectorType(double, together)
            held = ir.VectorType(context.get_data_type(signature.args[1].dtype), together)

            def number(n):
                return ir.Constant(word, n)

            def spread(array, place):
                one = b.insert_element(ir.Constant(vector, ir.Undefined), b.load(b.gep(array, [place])), zero)
                return b.shuffle_vector(one, ir.Constant(vector, ir.Undefined), everywhere)

            def side_by_side(array, place, kind):
                return b.bitcast(b.gep(array, [place]), kind.as_pointer())

            zero = ir.Constant(ir.IntType(32), 0)
            everywhere = ir.Constant(ir.VectorType(ir.IntType(32), together), [0] * together)
            first = [spread(biases, b.add(bias, number(r))) for r in range(rows)]
            before, columns, after = b.block, b.append_basic_block("columns"), b.append_basic_block("after")
            b.branch(columns)  # an AFFINE has at least one
            b.position_at_end(columns)
            j, total = b.phi(word), [b.phi(vector) for _ in range(rows)]
            place = b.mul(b.load(b.gep(reads, [b.add(read, j)])), number(LANES))
            x = b.load(side_by_side(value, b.add(place, b.and_(at, number(LANES - 1))), held), align=4)
            x = x if held == vector else b.fpext(x, vector)
            w = b.add(weight, b.mul(j, number(rows)))
            terms = [b.fmul(x, spread(weights, b.add(w, number(r))), flags=["contract"]) for r in range(rows)]
            added = [b.fadd(term, so_far, flags=["contract"]) for term, so_far in zip(terms, total, strict=True)]
            following = b.add(j, number(1))
            for phi, start, later in zip([j, *total], [number(0), *first], [following, *added], strict=True):
                phi.add_incoming(start, before)
                phi.add_incoming(later, columns)
            b.cbranch(b.icmp_unsigned("<", following, count), columns, after)
            b.position_at_end(after)
            for r, a in enumerate(added):
                b.store(a, side_by_side(out, b.add(at, number(r * LANES)), vector), align=8)
            return context.get_dummy_value()

        return types.void(*given), write

    return sums


_several, _one = _sums(ROWS, TOGETHER), _sums(1, LANES)


_compiled = numba.njit(nogil=True, error_model="numpy", fastmath={"nnan", "nsz"})


@_compiled
def _fit(sums, values, out, cells, of, live):  # pragma: no cover - compiled
    """Round, clip or wrap; returns the saturations of the lanes that are in use."""
    lo, hi, span, even, count = of[0], of[1], of[2], of[3] != 0, 0
    for i in range(cells):
        y = np.rint(sums[i]) if even else np.floor(sums[i])
        z = min(max(y, lo), hi)
        count += (z != y) & ((i & (_L - _ONE)) < live)
        values[out + i] = z if span == 0 else y - np.floor((y - lo) / span) * span
    return count


@_compiled
def _sum(op, sums, values, reads, weights, biases):  # pragma: no cover - compiled
    size, read, count = np.uint64(op[2]), np.uint64(op[3]), np.uint64(op[4])
    weight, bias = np.uint64(op[5]), np.uint64(op[6])
    if size == _ONE:
        _one(sums, values, reads, weights, biases, _ZERO, read, count, weight, bias)
    else:
        for r in range(_ZERO, size, _ROWS):
            for lane in range(_ZERO, _L, _TOGETHER):
                _several(sums, values, reads, weights, biases, r * _L + lane, read, count, weight + r * count, bias + r)


@_compiled
def _look_up(op, of, values, index, place, word, words, octaves):  # pragma: no cover - compiled
    """Segment and place of every argument, then its word, then its line."""
    out, cells, arg, first = np.uint64(op[1]) * _L, np.uint64(op[2]) * _L, np.uint64(op[3]) * _L, np.uint64(op[4])
    inverts, before, nothing = of[0], of[1], of[8]
    for o in range(op[5], op[6]):
        left, base, scale = octaves[o, 0], octaves[o, 1], octaves[o, 2]
        places, inward, end, last = octaves[o, 3], octaves[o, 4], octaves[o, 5], octaves[o, 6]
        for i in range(cells):
            x = values[arg + i]
            m = (-x - inverts if x < 0 else x) + before
            if m >= left:
                within = min((m - left) * scale, end)
                segment = min(np.floor(within), last)
                index[i] = np.int32(base + segment)
                place[i] = np.floor((within - segment) * places) + (inward if x < 0 and within < end else nothing)
    for i in range(cells):  # a loop of its own: beside arithmetic, a compiler takes indices out of vectors
        word[i] = words[first + np.uint64(index[i])]
    below, lower, guard, upper, flip, lift = of[2], of[3], of[4], of[5], of[6], of[7]
    for i in range(cells):
        y = np.floor((word[i].imag * place[i] + lower) * below)
        y = np.floor((word[i].real + upper + y) * guard)
        values[out + i] = y * flip + lift if values[arg + i] < 0 else y


@_compiled
def _clamp(op, of, sums, values):  # pragma: no cover - compiled
    arg, least, most, scale, half = np.uint64(op[3]) * _L, of[4], of[5], of[6], of[7]
    for i in range(np.uint64(op[2]) * _L):
        sums[i] = min(max(np.float64(values[arg + i]), least), most) * scale + half


@_compiled
def _threshold(op, of, values):  # pragma: no cover - compiled
    out, arg, at, below, above = np.uint64(op[1]) * _L, np.uint64(op[3]) * _L, of[0], of[1], of[2]
    for i in range(np.uint64(op[2]) * _L):
        values[out + i] = above if values[arg + i] >= at else below


@_compiled
def _select(op, of, sums, values):  # pragma: no cover - compiled
    condition, above, below = np.uint64(op[3]) * _L, np.uint64(op[4]) * _L, np.uint64(op[5]) * _L
    for i in range(np.uint64(op[2]) * _L):
        chosen, other = values[above + i] * of[4] + of[5], values[below + i] * of[6] + of[7]
        sums[i] = chosen if values[condition + i] >= 0 else other


@_compiled
def _product(op, of, sums, values):  # pragma: no cover - compiled
    one, other = np.uint64(op[3]) * _L, np.uint64(op[4]) * _L
    for i in range(np.uint64(op[2]) * _L):
        sums[i] = np.float64(values[one + i]) * np.float64(values[other + i]) * of[4] + of[5]


@_compiled
def _move(moves, values, held):  # pragma: no cover - compiled
    for m in range(len(moves)):
        here, source = np.uint64(m) * _L, np.uint64(moves[m, 0]) * _L
        for lane in range(_L):
            held[here + lane] = values[source + lane]
    for m in range(len(moves)):
        here, state = np.uint64(m) * _L, np.uint64(moves[m, 1]) * _L
        for lane in range(_L):
            values[state + lane] = held[here + lane]


@_compiled
def _put(values, places, codes, scenario, step, live):  # pragma: no cover - compiled
    for n in range(len(places)):
        for lane in range(live):
            values[places[n] * LANES + lane] = codes[scenario + lane, step, n]


@_compiled
def _take(values, places, codes, scenario, step, live):  # pragma: no cover - compiled
    for n in range(len(places)):
        for lane in range(live):
            codes[scenario + lane, step, n] = np.int64(values[places[n] * LANES + lane])


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nnan", "nsz"})
def _run(
    whole, real, reads, weights, biases, words, lines, octaves, moves, ins, outs, elements, most,
    inputs, initial, outputs, states, saturations, trace
):  # fmt: skip  # pragma: no cover - compiled
    values, cells = np.zeros(elements * LANES, lines.dtype), most * LANES
    held, place, word = np.zeros(cells, lines.dtype), np.zeros(cells, lines.dtype), np.zeros(cells, words.dtype)
    sums, index = np.zeros(cells), np.zeros(cells, np.int32)
    everything = np.arange(elements)
    for scenario in range(0, len(inputs), LANES):
        live = min(LANES, len(inputs) - scenario)
        _put(values, moves[:, 1], initial, scenario, 0, live)
        for k in range(inputs.shape[1]):
            _put(values, ins, inputs, scenario, k, live)
            for n in range(len(whole)):
                op, of, kind = whole[n], real[n], whole[n, 0]
                if kind == SUM:
                    _sum(op, sums, values, reads, weights, biases)
                elif kind == LINES:
                    _look_up(op, lines[n], values, index, place, word, words, octaves)
                    continue
                elif kind == CLAMP:
                    _clamp(op, of, sums, values)
                elif kind == SELECT:
                    _select(op, of, sums, values)
                elif kind == PRODUCT:
                    _product(op, of, sums, values)
                else:
                    _threshold(op, of, values)
                    continue
                saturations[n] += _fit(sums, values, np.uint64(op[1]) * _L, np.uint64(op[2]) * _L, of, live)
            _take(values, outs, outputs, scenario, k, live)
            if trace.shape[1]:
                _take(values, everything, trace, scenario, k, live)
            _move(moves, values, held)
            if states.shape[1]:
                _take(values, moves[:, 1], states, scenario, k, live)


def run(*arrays: np.ndarray) -> None:
    """What `engine._run` does, of `Lanes` in place of its arrays: the scenarios are shared among the cores."""
    *program, inputs, initial, outputs, states, saturations, trace = arrays
    kernel: Callable[..., None] = _run
    blocks = -(-len(inputs) // LANES)
    shares = np.array_split(np.arange(blocks), min(blocks, usable_cores()))

    def work(share: np.ndarray) -> np.ndarray:
        part = slice(share[0] * LANES, (share[-1] + 1) * LANES)
        events = np.zeros_like(saturations)
        kernel(*program, inputs[part], initial[:, None][part], outputs[part], states[part], events, trace[part])
        return events

    with ThreadPoolExecutor(len(shares)) as pool:
        saturations += sum(pool.map(work, shares))
