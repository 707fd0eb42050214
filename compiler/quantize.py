"""From the generic network to the integer program: formats, weights, tables.

A signal of largest value m gets floor(log2(margin m)) + 1 integer bits, the rest of the word as fraction. A linear
layer with the slowest pole a adds up its rounding for M = 1 / (1 - a^2) steps: x more fraction bits, 4^x >= M / 3, keep
its deviation sqrt(M / 12) 2^-x within half an LSB of the word. Its weights get log2 g more bits where its feedback,
weights W_d over d steps, amplifies an error by g = max_w |(I - sum_d W_d e^(-jwd))^-1|.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from greygate.compiler.limits import factors, limit
from greygate.compiler.ranges import Range, sums
from greygate.compiler.tables import Form, flat_from, integer_bits, make_table, output_fix
from greygate.emulator.numbers import ACCUMULATOR_BITS, Fix, Overflow, Rounding
from greygate.emulator.program import (
    Affine,
    Clamp,
    Lookup,
    Op,
    Operation,
    Product,
    Program,
    Select,
    Signal,
    State,
    Terminal,
    Threshold,
)
from greygate.emulator.tables import Lines, Table
from greygate.errors import InputError
from greygate.models.activations import ACTIVATIONS
from greygate.models.arithmetic import product
from greygate.models.network import Layer, Network

FINER = 6  # bits that a root's argument and answer have beyond the word: it halves the octaves of what it is taken of
LEAST_CODES = 8  # that the least number under a root must be: rounding changes it by a sixteenth
EXACT = 8  # fraction bits up to which a weight counts as exact
GUARD = 3  # bits by which a product may be finer than its sum
BETWEEN = 65  # angles at which a loop's gain is asked for, beside those of its poles, where sharp ones are
WRAP = "wrap"  # an activation that is a sum in a format of a turn
AGREED = 9  # decimals of a logarithm on which every LAPACK agrees; it only chooses a number of bits


@dataclass(frozen=True)
class Formats:
    """How numbers are kept. `width`: word of signals and significant bits of weights, 4 to 32.

    finer: bits that weights and the outputs of neurons have beyond the word. A network needs them if it integrates
    while its plant stands still, because then every step has the same rounding error and the errors add up. 16 + 2 bits
    are the width of an FPGA's multiplier.
    tables: how tables are kept. segments: the least of a table; a block RAM has room for many (1024 in Xilinx 7 and
    ECP5), and the shorter a segment, the less logic does its line take.
    margin: room above the observed range (1.25 = a quarter). wide: extra fraction bits of pre-activations.
    signals: formats that the user (or a search) fixes, by signal name. weights: significant bits of the weights of a
    sum instead of the word's, by the name of the sum's signal, which a search fixes. keep: significant bits in which a
    row of weights is kept as it is, if they say it exactly, though the word is shorter: of weights rounded before.

    >>> Formats(18).width
    18
    """

    width: int = 16
    finer: int = 0
    margin: float = 1.25
    wide: int = 2
    rounding: Rounding = Rounding.HALF_UP
    overflow: Overflow = Overflow.SATURATE
    interpolated: bool = True
    tables: Form = Form.POINTS
    table_budget: float = 1.25
    segments: int = 8
    horizon: int = 10_000
    signals: Mapping[str, Fix] = field(default_factory=dict)
    weights: Mapping[str, int] = field(default_factory=dict)
    keep: int = 0


def memory(loops: list[np.ndarray]) -> float:
    """Number of steps for which a linear layer remembers its rounding: 1/(1 - a^2) for the slowest pole a, inf at 1.

    loops: its weights on its own output 1, 2, ... steps before.
    """
    if not loops:
        return 1.0
    pole = float(np.abs(_poles(loops)).max())
    return 1 / (1 - pole**2) if pole < 1 else math.inf


def _poles(loops: list[np.ndarray]) -> np.ndarray:
    depth, n = len(loops), len(loops[0])
    companion = np.zeros((depth * n, depth * n))
    companion[:n] = np.hstack(loops)
    companion[n:, :-n] = np.eye((depth - 1) * n)
    return np.linalg.eigvals(companion)


def loop_gain(loops: list[np.ndarray]) -> float:
    """Factor by which feedback amplifies an error of a linear layer's sum at the worst frequency, at least 1.

    loops: as for `memory`. If the weights are short enough to be exact, the loop is as it was declared, and the gain
    is 1.
    """
    if all(_exact_bits(w, EXACT) < EXACT for w in loops):
        return 1.0
    size = len(loops[0])
    turns = np.exp(-1j * np.concatenate([np.linspace(0, np.pi, BETWEEN), np.abs(np.angle(_poles(loops)))]))
    returned = sum(w * turns[:, None, None] ** d for d, w in enumerate(loops, 1))
    return max(1.0, float(np.linalg.norm(np.linalg.inv(np.eye(size) - returned), 2, axis=(1, 2)).max()))


def quantize(
    network: Network, ranges: Mapping[str, Range], formats: Formats = Formats(), period: float = 1e-3
) -> Program:
    """Make the integer program of a flat network.

    The ranges (with margin) determine the integer bits, the width the fraction bits. A state that remembers its own
    rounding for many steps gets so many fraction bits that the accumulated rounding stays under half an LSB of the
    word. Raises InputError if a width cannot hold a range.
    """
    if not 4 <= formats.width <= 32:
        raise InputError(f"width {formats.width}: choose 4 to 32 bits")
    if not 0 <= formats.finer <= 32 - formats.width:
        raise InputError(f"finer {formats.finer}: choose 0 to {32 - formats.width} bits beyond the {formats.width}")
    return _Quantizer(network.flatten(), ranges, formats, period).program()


class _Quantizer:
    def __init__(self, flat: Network, ranges: Mapping[str, Range], formats: Formats, period: float):
        self.flat, self.ranges, self.formats, self.period = flat, ranges, formats, period
        self.layers, self.feeds = flat.layers(), flat.feeds()
        self.signals: dict[str, Signal] = {}
        self.states: dict[str, State] = {}
        self.operations: list[Operation] = []
        self.tables: dict[tuple, Table | Lines] = {}
        self.notes: dict[str, str] = {}

    def fix(self, name: str, width: int) -> Fix:
        """The format that holds the range of a signal in `width` bits."""
        if name in self.formats.signals:
            return self.formats.signals[name]
        r = self.ranges[name]
        bits = integer_bits(min(r.magnitude * self.formats.margin, max(map(abs, r.sound))))
        if bits > width - 1:
            raise InputError(
                f"signal {name}: reaches {r.magnitude:.4g}, which {width} bits cannot hold with any fraction; "
                "scale its port or give more bits"
            )
        return Fix(width, width - 1 - bits)

    def program(self) -> Program:
        inputs = []
        for p in self.flat.inputs:
            fix = self.fix(p.name, self.formats.width)
            if p.resolution and p.name not in self.formats.signals:
                frac = math.ceil(round(math.log2(abs(p.scale) / p.resolution), AGREED))
                fix = Fix(fix.width - fix.frac + frac, frac)
            self.signals[p.name] = Signal(p.name, p.size, fix)
            inputs.append(Terminal(p.name, self.signals[p.name], p.unit, p.scale, p.offset))
        order = self.flat.order()
        for name in order:
            self._declare(name)
        for name in order:
            self._layer(name)
        outputs = []
        for p in self.flat.outputs:
            outputs.append(Terminal(p.name, self.signals[self.feeds[p.name][0]], p.unit, p.scale, p.offset))
        return Program(
            self.flat.name,
            tuple(inputs),
            tuple(self.states.values()),
            tuple(self.operations),
            tuple(outputs),
            tuple(self.tables.values()),
            self.period,
            self.notes,
        ).check()

    def _reads(self, name: str, rows: slice = slice(None)) -> dict[tuple[str, int], np.ndarray]:
        """(source, delay) -> weights of some rows of a layer, unless they are all zero."""
        reads: dict[tuple[str, int], np.ndarray] = {}
        for port, w in self.layers[name].weights.items():
            feed = self.feeds[f"{name}.{port}"]
            reads[feed] = reads.get(feed, 0.0) + w[rows]
        return {feed: w for feed, w in reads.items() if w.any()}

    def _loops(self, name: str, rows: slice = slice(None)) -> list[np.ndarray]:
        """Weights of rows of a layer on its own past, from one step on, if they round anew in every step."""
        reads, size = self._reads(name, rows), self.layers[name].size
        own = {d: w for (s, d), w in reads.items() if s == name}
        if self._plain(name, rows) == (name, 1, 1.0, 0.0):
            return []  # it repeats its last value and rounds nothing
        return [own.get(d, np.zeros((size, size))) for d in range(1, max(own, default=0) + 1)]

    def _plain(self, name: str, rows: slice) -> tuple[str, int, float, float] | None:
        """(source, delay, weight, bias) of rows that are weight * source + bias, element by element, weight not 0."""
        reads, bias = self._reads(name, rows), self.layers[name].bias[rows]
        if len(reads) != 1 or (bias != bias[0]).any():
            return None
        (((source, delay), w),) = reads.items()
        if w.shape[0] != w.shape[1] or not np.array_equal(w, w[0, 0] * np.eye(len(w))):
            return None
        return source, delay, float(w[0, 0]), float(bias[0])

    def _declare(self, name: str) -> None:
        """Fix the format of a layer's output before any layer reads it, delayed reads included."""
        layer, width = self.layers[name], self.formats.width
        f = layer.function
        if f.lowered == Op.TABLE:
            if f.steep:
                holds = self.fix(name, width + self._octaves(name))
            else:
                holds = output_fix(width + self.formats.finer) if f.is_bounded else self._unbounded_fix(name)
            fix = self.formats.signals.get(name, holds)
        elif f.lowered == WRAP:
            fix = output_fix(width)
        elif f.lowered == Op.THRESHOLD:
            fix = Fix(2, 0)
        elif f.lowered in (Op.CLAMP, Op.PRODUCT):
            fix = self.fix(name, width + (FINER if self._under_root(name) else 0))
        else:
            fix = self.fix(name, width)
            exact = self._exact_frac(name)
            if exact is not None and fix.frac > exact and name not in self.formats.signals:
                fix = Fix(max(fix.width - (fix.frac - exact), 2), exact)
            steps = min(max(memory(self._loops(name, rows)) for rows in _values(layer)), self.formats.horizon)
            if steps > 4 and name not in self.formats.signals:
                extra = math.ceil(round(math.log2(steps / 3) / 2, AGREED))
                fix = Fix(fix.width + extra, fix.frac + extra)
                self.notes[name] = (
                    f"feeds back on itself and remembers its rounding for {steps:.0f} steps; {extra} more fraction "
                    f"bits keep the accumulated rounding under half an LSB of {width} bits"
                )
        self.signals[name] = Signal(name, layer.size, fix)

    def _octaves(self, name: str) -> int:
        """Bits more for a steep function, whose least answer is to have as many as others; at most FINER."""
        r = self.ranges[name]
        return min(FINER, max(0, integer_bits(r.magnitude) - integer_bits(r.low)))

    def _under_root(self, name: str) -> bool:
        """Whether a product is part of what a steep function is taken of, which must not be rounded to 0."""
        return any(
            source == name and self.layers[target.rpartition(".")[0]].function.steep
            for target, (source, _) in self.feeds.items()
            if "." in target
        )

    def _exact_frac(self, name: str) -> int | None:
        """Fraction bits that hold a sum of earlier signals with short weights (a difference) exactly; else inf."""
        layer, needed = self.layers[name], [0]
        for rows in _values(layer):
            if layer.bias[rows].any():
                return None
            for (source, _), w in self._reads(name, rows).items():
                if source not in self.signals:
                    return None
                bits = _exact_bits(w, self.formats.width)
                if bits >= self.formats.width:
                    return None
                needed.append(self.signals[source].fix.frac + bits)
        return max(needed)

    def _delayed(self, source: str, delay: int) -> Signal:
        """The state that holds a signal as it was `delay` steps ago."""
        if delay == 0:
            return self.signals[source]
        name = f"{source}.z{delay}"
        if name not in self.states:
            before = self._delayed(source, delay - 1)
            signal = Signal(name, before.size, before.fix)
            self.states[name] = State(signal, before.name, tuple(int(v) for v in self._initial(source, before.fix)))
            self.signals[name] = signal
        return self.signals[name]

    def _initial(self, source: str, fix: Fix) -> np.ndarray:
        codes = np.floor(self.flat.rest()[source] * 2.0**fix.frac + 0.5)
        if (codes < fix.lo - 1).any() or (codes > fix.hi + 1).any():
            raise InputError(
                f"signal {source}: its initial value does not fit {fix}; check the record it was ranged on"
            )
        return np.clip(codes, fix.lo, fix.hi).astype(np.int64)

    def _narrow(self, signal: Signal) -> Signal:
        """A wide state rounded to the word width, for multipliers that do not need all its bits."""
        word = self.formats.width
        if signal.fix.width <= word + 2:
            return signal
        name = f"{signal.name}.view"
        if name not in self.signals:
            fix = Fix(word, signal.fix.frac - (signal.fix.width - word))
            one = np.eye(signal.size, dtype=np.int64)
            zero = np.zeros(signal.size, np.int64)
            view = Signal(name, signal.size, fix)
            self.operations.append(
                Affine(
                    view,
                    (signal.name,),
                    one,
                    zero,
                    zero + signal.fix.frac,
                    self.formats.rounding,
                    self.formats.overflow,
                )
            )
            self.signals[name] = view
        return self.signals[name]

    def _layer(self, name: str) -> None:
        layer, f, out = self.layers[name], self.formats, self.signals[name]
        lowered, (low, high) = layer.function.lowered, layer.function.image
        if lowered == Op.SELECT:
            return self._select(name)
        if lowered == Op.PRODUCT:
            return self._product(name)
        sign_test = lowered == Op.THRESHOLD
        if sign_test and self._comparator(name):
            return None
        reads = []
        for port, w in layer.weights.items():
            source, delay = self.feeds[f"{name}.{port}"]
            signal = self._delayed(source, delay)
            fine = layer.function.steep or layer.function.periodic
            unrounded = source == name or lowered == Op.AFFINE or sign_test or fine
            reads.append((signal if unrounded else self._narrow(signal), w))
        if lowered == Op.AFFINE:
            gain = min(loop_gain(self._loops(name)), self.formats.horizon)
            finer = math.ceil(round(math.log2(gain), AGREED)) if gain > 1 else 0
            if finer:
                why = f"its feedback multiplies errors by up to {gain:.3g}: weights have {finer} bits more"
                self.notes[name] = "; ".join(filter(None, [self.notes.get(name), why]))
            return self._affine(out, layer.bias, reads, finer)
        pre = f"{name}.n"
        if lowered == WRAP:
            return self._affine(out, layer.bias, reads, max(0, self.fix_bits(pre)), overflow=Overflow.WRAP)
        if lowered == Op.TABLE:
            frac, reach = self._argument(layer.activation, name, out.fix)
            fix = self.formats.signals.get(pre, Fix(frac + reach + 1, frac))
            signal = Signal(pre, layer.size, fix)
            if layer.function.periodic:  # whole turns are left out, and weights tell them from their parts
                self._affine(signal, layer.bias, reads, max(0, self.fix_bits(pre)), overflow=Overflow.WRAP)
            else:
                self._affine(signal, layer.bias, reads)
            if layer.function.diverges and self.ranges[pre].low < LEAST_CODES * fix.lsb:
                raise InputError(self._too_wide(pre, fix))
            form = Form.OCTAVES if layer.function.steep else f.tables
            table = make_table(layer.activation, fix, out.fix, f.table_budget, f.interpolated, form, f.segments)
            key = (table.function, table.arg, table.out)
            self.tables.setdefault(key, table)
            self.operations.append(Lookup(out, pre, table.name))
        elif lowered == Op.CLAMP:
            signal = Signal(pre, layer.size, out.fix)
            self._affine(signal, layer.bias, reads, overflow=Overflow.SATURATE)
            self._clamp(out, signal, (low, high))
        else:
            self._signed(Signal(pre, layer.size, self._sign_fix(pre)), layer.bias, reads)
            self.operations.append(Threshold(out, pre, 0, int(low), int(high)))

    def _comparator(self, name: str) -> bool:
        """Lower a hard limit of one signal to an exact comparison of its codes with a constant (no multiplier).

        That of an input is rounded as the input is: what equals it stays equal.
        """
        plain, out = self._plain(name, slice(None)), self.signals[name]
        if plain is None:
            return False
        source, delay, weight, bias = plain
        signal = self._delayed(source, delay)
        low, high = self.layers[name].function.image
        answers = int(low), int(high)
        zero = -Fraction(bias) / Fraction(weight) * Fraction(2) ** signal.fix.frac  # where weight * code + bias is 0
        if any(p.name == source for p in self.flat.inputs):
            zero = Fraction(math.floor(zero + Fraction(1, 2)))
        if weight > 0:
            at = math.ceil(zero)
        else:  # code <= zero
            at, answers = math.floor(zero) + 1, answers[::-1]
        if at > signal.fix.hi:
            answers = (answers[0], answers[0])
        at = min(max(at, signal.fix.lo), signal.fix.hi)
        self.operations.append(Threshold(out, signal.name, at, *answers))
        return True

    def _select(self, name: str) -> None:
        """A multiplexer reads earlier signals directly where its rows are plain, and else sums of them, each once."""
        if self._limited(name):
            return
        out, parts, slopes = self.signals[name], sums(name, self.layers[name]), self._slopes(name)
        made: dict[str, Signal] = {}
        for part, rows in sorted(parts.items(), key=lambda p: bool(slopes) and not p[0].endswith(".above")):
            direct = self._direct(part, rows, out)
            made[part] = direct or self._part(part, rows, slopes.get(part), made.get(f"{name}.above"))
        condition, above, below = (made[part].name for part in parts)
        self.operations.append(Select(out, condition, above, below, self.formats.rounding))

    def _product(self, name: str) -> None:
        """Two signals multiplied: earlier ones where the rows are plain, and else sums; the wider one first."""
        factors = [self._factor(part, rows) for part, rows in sums(name, self.layers[name]).items()]
        one, other = sorted(factors, key=lambda s: -s.fix.width)
        self.operations.append(Product(self.signals[name], one.name, other.name, self.formats.rounding))

    def _factor(self, part: str, rows: slice) -> Signal:
        name = part.rpartition(".")[0]
        plain, layer = self._plain(name, rows), self.layers[name]
        if plain is not None and plain[2:] == (1.0, 0.0):
            signal = self._delayed(*plain[:2])
            return signal if self._steep(plain[0]) else self._narrow(signal)
        signal = Signal(part, layer.size, self.formats.signals.get(part, self.fix(part, self.formats.width)))
        self._affine(signal, layer.bias[rows], self._summed(name, rows))
        return signal

    def _steep(self, source: str) -> bool:
        return source in self.layers and self.layers[source].function.steep

    def _part(self, part: str, rows: slice, slope: np.ndarray | None, above: Signal | None) -> Signal:
        """A sum of a multiplexer. slope: by which it is the sum above, whose sign serves as a condition."""
        name, _, kind = part.rpartition(".")
        layer, is_condition = self.layers[name], kind == "condition"
        if slope is not None and above and is_condition:
            return above
        fix = self._sign_fix(part) if is_condition else self.formats.signals.get(part, self.signals[name].fix)
        signal = Signal(part, layer.size, fix)
        if is_condition:
            self._signed(signal, layer.bias[rows], self._summed(name, rows))
        elif slope is not None and above:
            self._affine(signal, np.zeros(layer.size), [(above, np.diag(slope))])
        else:
            self._affine(signal, layer.bias[rows], self._summed(name, rows))
        return signal

    def _summed(self, name: str, rows: slice) -> list[tuple[Signal, np.ndarray]]:
        return [(self._delayed(*feed), w) for feed, w in self._reads(name, rows).items()]

    def _slopes(self, name: str) -> dict[str, np.ndarray]:
        """The parts that need no sum of their own beside that of `above`, and by which factors they are it."""
        parts = sums(name, self.layers[name])
        condition, above, below = self._matrices(name)
        own, found = list(parts), {}
        if self._direct(own[1], parts[own[1]], self.signals[name]) is not None:
            return {}
        sign, slope = factors(condition, above), factors(below, above)
        if sign is not None and np.all(sign > 0):
            found[own[0]] = sign
        if slope is not None and np.all(np.abs(slope) <= 1):  # or it would enlarge the rounding
            found[own[2]] = slope
        return found

    def _direct(self, part: str, rows: slice, out: Signal) -> Signal | None:
        """The earlier signal that plain rows of a multiplexer are; None for a sum."""
        plain, is_condition = self._plain(part.rpartition(".")[0], rows), part.endswith(".condition")
        if plain is None or plain[3] != 0 or not (plain[2] > 0 if is_condition else plain[2] == 1):
            return None
        signal = self._delayed(*plain[:2])
        near = signal.fix.width <= 36 and abs(signal.fix.frac - out.fix.frac) <= 12  # or SELECT grows too wide
        return signal if is_condition or near else None

    def _matrices(self, name: str) -> list[np.ndarray]:
        """The sums of a multiplexer as `limits` takes them."""
        reads = self._reads(name)
        whole = np.hstack([*reads.values(), self.layers[name].bias[:, None]])
        return [whole[rows] for rows in sums(name, self.layers[name]).values()]

    def _limited(self, name: str) -> bool:
        """Lower a multiplexer that limits one of its sums to that sum, rounded and saturated once, and a CLAMP."""
        layer, out, found = self.layers[name], self.signals[name], limit(*self._matrices(name))
        if found is None:
            return False
        part, rows = list(sums(name, layer).items())[found.value]
        signal = self._direct(part, rows, out)
        if signal is None:
            signal = Signal(part, layer.size, self.formats.signals.get(part, out.fix))
            self._affine(signal, layer.bias[rows], self._summed(name, rows), overflow=Overflow.SATURATE)
        self._clamp(out, signal, (found.end, math.inf) if found.least else (-math.inf, found.end))
        return True

    def _clamp(self, out: Signal, arg: Signal, ends: tuple[float, float]) -> None:
        """Limit a signal to the codes nearest to the ends that its format has."""
        fix = arg.fix
        lo, hi = (min(max(end * 2.0**fix.frac, fix.lo), fix.hi) for end in ends)
        self.operations.append(Clamp(out, arg.name, math.floor(lo + 0.5), math.floor(hi + 0.5), self.formats.rounding))

    def _sign_fix(self, pre: str) -> Fix:
        width = self.formats.width + self.formats.wide
        return self.formats.signals.get(pre, Fix(width, width - 1 - self.fix_bits(pre)))

    def _signed(self, out: Signal, bias: np.ndarray, reads: list[tuple[Signal, np.ndarray]]) -> None:
        """A sum of which only the sign matters; truncated and saturated, it has the sign of the exact sum."""
        self._affine(out, bias, reads, rounding=Rounding.TRUNCATE, overflow=Overflow.SATURATE)

    def _argument(self, function: str, name: str, out: Fix) -> tuple[int, int]:
        """Fraction and integer bits of a sigmoid's argument; layers of equal fraction share a table, and so a width."""
        if ACTIVATIONS[function].periodic:
            return self.formats.width - 1 + self.formats.wide, 0
        word, flat = self.formats.width, integer_bits(flat_from(function, out))

        def frac(layer: str) -> int:
            finer = FINER if ACTIVATIONS[function].steep else 0
            return word - 1 - min(self.fix_bits(f"{layer}.n"), flat) + self.formats.wide + finer

        alike = [n for n, layer in self.layers.items() if layer.activation == function and frac(n) == frac(name)]
        return frac(name), max(self.fix_bits(f"{n}.n") for n in alike)

    def _too_wide(self, pre: str, fix: Fix) -> str:
        """Why a number by which a signal is divided has no codes."""
        r = self.ranges[pre]
        octaves = fix.width - integer_bits(LEAST_CODES)
        return (
            f"signal {pre}: something is divided by it or its root, or its logarithm is taken, and it goes from "
            f"{r.low:.2g} to {r.high:.2g}; {fix.width} bits hold {octaves} octaves. Limit it from below (of a norm, "
            "raise the epsilon) and train with that, give more bits, or leave those steps out"
        )

    def _unbounded_fix(self, name: str) -> Fix:
        """A format that ends at a power of four, so that a square reaches the end at a point of its table."""
        fix = self.fix(name, self.formats.width)
        return Fix(fix.width, fix.frac - (fix.width - 1 - fix.frac) % 2)

    def fix_bits(self, name: str) -> int:
        r = self.ranges[name]
        return integer_bits(r.magnitude * self.formats.margin)

    def _affine(
        self,
        out: Signal,
        bias: np.ndarray,
        reads: list[tuple[Signal, np.ndarray]],
        finer: int = 0,
        rounding: Rounding | None = None,
        overflow: Overflow | None = None,
    ) -> None:
        """Weights with `width + finer` significant bits per row and source, but not finer than the result can show.

        finer: further bits.
        """
        finer += self.formats.finer
        rows, word = out.size, self.formats.weights.get(out.name, self.formats.width) + finer
        if not reads:  # a constant: an operation must read a signal, so it reads one with weights of zero
            first = self.signals[self.flat.inputs[0].name]
            reads = [(first, np.zeros((rows, first.size)))]
        finest = np.zeros((rows, len(reads)), np.int64)
        for j, (signal, w) in enumerate(reads):
            reach = signal.fix.width - 1 - signal.fix.frac  # |x| <= 2^reach
            for r in range(rows):
                largest = float(np.abs(w[r]).max())
                shown = out.fix.frac + GUARD + finer + reach
                fine = min(word - 1 - integer_bits(largest), shown) if largest else 0
                kept = min(self.formats.keep - 1 - integer_bits(largest), shown) if largest else 0
                if kept > fine and (short := _exact_bits(w[r], kept)) < kept:
                    fine = short
                finest[r, j] = max(_exact_bits(w[r], fine), -signal.fix.frac)
        frac = np.max(finest + [s.fix.frac for s, _ in reads], axis=1)
        frac = np.maximum(frac, max(0, out.fix.frac))  # a bias is no coarser than the result
        columns, bias = [], bias.copy()
        for j, (signal, w) in enumerate(reads):
            own = finest[:, j : j + 1]
            codes = np.floor(np.ldexp(w, own) + 0.5)
            rounded = w - np.ldexp(codes, -own)
            bias += product(rounded, self.ranges[_origin(signal.name)].mean)  # the average error of the rounded weights
            columns.append(codes.astype(np.int64) << (frac[:, None] - signal.fix.frac - own))
        if (np.ldexp(np.abs(bias), frac) >= 2.0**ACCUMULATOR_BITS).any():
            raise InputError(
                f"signal {out.name}: its sum needs more than {ACCUMULATOR_BITS} bits; choose a smaller width"
            )
        bias = np.floor(np.ldexp(bias, frac) + 0.5).astype(np.int64)
        args, weights = tuple(s.name for s, _ in reads), np.concatenate(columns, axis=1)
        modes = rounding or self.formats.rounding, overflow or self.formats.overflow
        self.operations.append(Affine(out, args, weights, bias, frac, *modes))


def _values(layer: Layer) -> list[slice]:
    """Rows of a linear layer or a select that are rounded to its output's format."""
    return list(sums("", layer).values())[-2:]


def _origin(name: str) -> str:
    """The layer or input of which a state or a view is a copy."""
    return re.sub(r"(\.z\d+)?(\.view)?$", "", name)


def _exact_bits(w: np.ndarray, fine: int) -> int:
    """Fraction bits that represent every weight exactly, but at most `fine`."""
    for bits in range(-8, fine):
        codes = w * 2.0**bits
        if np.array_equal(codes, np.floor(codes)):
            return bits
    return fine
