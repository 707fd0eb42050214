"""From a network whose signals have declared formats, such as QONNX's, to the program that equals it in every bit.

Nothing is chosen here: every weight is kept exactly, every sum is exact, and a Quant rounds it once. A sum stays within
the 24 bits that float32 holds exactly, so a tool that computes in float32 gets the same, in whatever order it adds. Of
a model whose numbers no such program has, weights and sums keep 24 bits, and near a tie a code may be the next one.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from greygate.compiler.tables import LARGEST_BITS, flat_from, integer_bits, make_table, output_fix
from greygate.emulator.numbers import ACCUMULATOR_BITS, FRACTIONS, Fix, Overflow, Rounding, signed_width
from greygate.emulator.program import Affine, Clamp, Lookup, Operation, Program, Signal, Terminal, Threshold
from greygate.emulator.tables import Lines, Symmetry, Table
from greygate.errors import InputError
from greygate.models.activations import ACTIVATIONS
from greygate.models.arithmetic import xp
from greygate.models.importers.builder import Value
from greygate.models.importers.qonnx import Format, Quantized, Step
from greygate.models.network import Port
from greygate.progress import once

FLOAT32 = 24  # bits of its significand: integers up to 2^24, and their sums, are exact
REAL = ACCUMULATOR_BITS - 2  # bits of a sum of such weights, beside its sign and a bit of rounding
FINE = 16  # bits of a tanh or a sigmoid before a Quant whose scale is no power of two: 8 more than most have
INPUT_BITS = range(8, 17)  # of an input that no Quant reads
DOUBT = 2.0**-21  # error that a tanh or a sigmoid in float32 may have: eight units in the last place of 1


class Inexact(InputError):
    """No program equals the model in every bit."""


class Bounded(NamedTuple):
    """A signal and the codes that it can take."""

    signal: Signal
    lo: int
    hi: int


class Sums(NamedTuple):
    """Exact sums of signals: integers as in AFFINE, and the largest magnitude of one in units of the finest row."""

    args: tuple[str, ...]
    weights: np.ndarray
    bias: np.ndarray
    frac: int
    reach: int


def declared_program(
    quantized: Quantized, period: float = 1e-3, reach: Mapping[str, float] = MappingProxyType({})
) -> Program:
    """The program of a network with declared formats. period: s, of a step.

    reach: input -> its largest magnitude. One that no Quant reads gets a format that holds it, of the most bits with
    which every sum is exact; a line says so. Where nothing is exact, because scales are no powers of two or a sum has
    more bits than float32, in which the model computes, weights have its bits; a line says why. Raises InputError for
    an input without either, and for what no program carries, with what to do.
    """
    units: dict[str, float] = {}
    why = "its scales are no powers of two"
    if not quantized.real:
        try:
            return _fitted(quantized, period, reach, units)
        except Inexact as error:
            quantized, why = quantized._replace(real=True), str(error)
    quantized, units = _in_codes(quantized)
    found = _fitted(quantized, period, reach, units)
    once(
        f"{quantized.network.name}: no program equals it in every bit ({why}); weights and sums have {FLOAT32} bits, "
        f"curves {FINE}: near a tie a code may be the next one"
    )
    return found


def _fitted(quantized: Quantized, period: float, reach: Mapping[str, float], units: Mapping[str, float]) -> Program:
    """The program in which inputs that no Quant reads have the most bits that it allows."""
    network = quantized.network
    guessed = [p.name for p in network.inputs if p.name in reach and not _format(quantized, p.name)]
    for width in reversed(INPUT_BITS):
        forms = {n: _covering(reach[n], width) for n in guessed}
        try:
            program = _Declared(quantized, forms, units).program(period)
        except Inexact:
            if not guessed or width == INPUT_BITS.start:
                raise
            continue
        for n, form in forms.items():
            once(f"input {n}: no Quant reads it; Fix({form.width}, {form.frac}) by the recording")
        break
    return program


def _in_codes(quantized: Quantized) -> tuple[Quantized, dict[str, float]]:
    """Inputs in units of the scale of the Quants that alone read them: (the same with such inputs, their scales)."""
    units = {}
    for port in quantized.network.inputs:
        read = [s.value.weights[port.name, 0] for s in quantized.steps if (port.name, 0) in s.value.weights]
        factors = np.unique(np.concatenate([w[w != 0] for w in read])) if read else np.ones(1)
        if len(factors) == 1 and factors[0] > 0:
            units[port.name] = 1 / float(factors[0])

    def turned(value: Value) -> Value:
        weights = {s: (w != 0) * 1.0 if s[0] in units else w for s, w in value.weights.items()}
        return Value(value.shape, value.bias, weights)

    steps = tuple(s._replace(value=turned(s.value)) for s in quantized.steps)
    return quantized._replace(steps=steps), units


def _format(quantized: Quantized, name: str) -> Format | None:
    """The format of the Quants that alone read an input; None where there is none, or more than one."""
    readers = [s for s in quantized.steps if (name, 0) in s.value.weights]
    forms = {s.format for s in readers if s.format and _picks(s.value)}
    if len(forms) != 1 or any(s.format not in forms or not _picks(s.value) for s in readers):
        return None
    return forms.pop()


def _covering(reach: float, width: int) -> Format:
    """The finest format of that width that holds the values up to a magnitude."""
    frac = width - 1 - int(np.ceil(np.log2(reach or 1.0)))
    return Format(width, frac, -(1 << width - 1), (1 << width - 1) - 1, Rounding.HALF_EVEN.value)


class _Declared:
    """given: formats of inputs that no Quant reads. units: of inputs, 1 if not named."""

    def __init__(self, quantized: Quantized, given: Mapping[str, Format], units: Mapping[str, float]):
        self.quantized, self.given, self.units = quantized, given, units
        self.network, self.steps, self.real = quantized
        self.shown: dict[str, tuple[float, float]] = {}  # an output -> its scale and its offset
        self.known: dict[str, Bounded] = {}
        self.curves: dict[str, Step] = {}  # a tanh or a sigmoid, until the Quant that reads it gives its format
        self.rough: set[str] = set()  # a tanh or a sigmoid that is interpolated
        self.tables: dict[str, Table | Lines] = {}
        self.operations: list[Operation] = []

    def program(self, period: float) -> Program:
        inputs = [self._input(p) for p in self.network.inputs]
        shown = [getattr(self, f"_{KINDS.get(step.kind, step.kind)}")(step) for step in self.steps]
        ends = [s for s, step in zip(shown, self.steps, strict=True) if step.kind == "output"]
        scales = [self.shown[step.name] for step in self.steps if step.kind == "output"]
        ports = zip(self.network.outputs, ends, scales, strict=True)
        outputs = [Terminal(p.name, s, p.unit, *scale) for p, s, scale in ports]
        parts = tuple(inputs), (), tuple(self.operations), tuple(outputs), tuple(self.tables.values())
        return Program(self.network.name, *parts, period).check()

    def _input(self, port: Port) -> Terminal:
        """An input in the format of the Quant that reads it; the host rounds to the nearest code."""
        form = _format(self.quantized, port.name) or self.given.get(port.name)
        if form is None:
            raise InputError(f"input {port.name}: its format would be a guess; put one Quant directly behind it")
        if form.rounding == Rounding.TRUNCATE:
            raise InputError(f"input {port.name}: is rounded to the nearest code; give its Quant rounding_mode ROUND")
        signal = Signal(port.name, port.size, Fix(form.width, form.frac))
        self.known[port.name] = Bounded(signal, signal.fix.lo, signal.fix.hi)
        return Terminal(port.name, signal, port.unit, self.units.get(port.name, 1.0), 0.0)

    def _quant(self, step: Step) -> Signal:
        form = step.format
        assert form is not None, "a Quant has a format"
        for name, w in ((s, w) for (s, _), w in step.value.weights.items() if s in self.rough):
            if float(np.abs(w).sum(1).max()) * self.known[name].signal.fix.lsb > 2.0**-form.frac:
                raise InputError(f"{step.name}: its codes are finer than the {FINE} bits of {name}; give it fewer bits")
        if (source := _copied(step.value)) in self.curves:
            self._curve(self.curves[source], form)
        out = Signal(step.name, step.value.size, Fix(form.width, form.frac))
        full = (form.lo, form.hi) == (out.fix.lo, out.fix.hi)
        if source and self.known[source].signal.fix.frac >= form.frac:
            return self._clamped(out, source, form)
        first = out if full else Signal(f"{step.name}.n", out.size, out.fix)
        self._affine(first, step.value, Rounding(form.rounding))
        return self._define(out, form.lo, form.hi) if full else self._clamped(out, first.name, form)

    def _clamped(self, out: Signal, source: str, form: Format) -> Signal:
        """A signal that is as fine as the format, or finer, limited and rounded to it."""
        arg, lo, hi = self.known[source]
        finer = arg.fix.frac - form.frac
        low, high = (min(max(code << finer, arg.fix.lo), arg.fix.hi) for code in (form.lo, form.hi))
        self.operations.append(Clamp(out, source, low, high, Rounding(form.rounding)))
        return self._define(out, max(form.lo, lo >> finer), min(form.hi, -(-hi >> finer)))

    def _relu(self, step: Step) -> Signal:
        source = self._exact(f"{step.name}.n", step.value)
        signal, _, hi = self.known[source]
        out = Signal(step.name, signal.size, signal.fix)
        self.operations.append(Clamp(out, source, 0, max(hi, 0)))
        return self._define(out, 0, max(hi, 0))

    def _later(self, step: Step) -> Signal:
        """A tanh or a sigmoid: its argument now, its table when its format is known."""
        if self.real:
            return self._interpolated(step)
        arg = self.known[self._exact(f"{step.name}.n", step.value)].signal
        if arg.fix.width > LARGEST_BITS + 1:
            raise Inexact(
                f"{step.name}: its argument has {arg.fix.width} bits, a table at most {LARGEST_BITS + 1}; "
                "put a Quant of fewer bits in front of it"
            )
        self.curves[step.name] = step
        return arg

    def _interpolated(self, step: Step) -> Signal:
        """A table of a sum that is on no grid, finer than the code that a Quant makes of it."""
        fix = output_fix(FINE)
        whole = integer_bits(flat_from(step.kind, fix))
        arg = Signal(f"{step.name}.n", step.value.size, Fix(whole + FINE + 1, FINE))
        self._affine(arg, step.value, Rounding.HALF_EVEN)
        table = make_table(step.kind, arg.fix, fix)
        self.tables[table.name] = table
        out = Signal(step.name, arg.size, fix)
        self.operations.append(Lookup(out, arg.name, table.name))
        self.rough.add(step.name)
        return self._define(out, *table.extremes)

    def _curve(self, step: Step, form: Format) -> None:
        """A table with a point for every code, before the Quant limits it."""
        arg = self.known[self._exact(f"{step.name}.n", step.value)].signal
        if form.frac < 1 or form.rounding != Rounding.HALF_EVEN:
            raise Inexact(f"{step.name}: give the Quant behind it ROUND and a scale of 1/2 or less")
        f, fix = ACTIVATIONS[step.kind], Fix(form.frac + 2, form.frac)
        assert f.symmetry, "a table holds half of a symmetric function"
        exact = f.value(xp, np.arange(-arg.fix.lo + 1) * arg.fix.lsb)
        scaled = exact * 2.0**form.frac
        doubtful = np.abs(scaled - np.floor(scaled) - 0.5) < DOUBT * 2.0**form.frac
        if doubtful.any():
            raise Inexact(
                f"{step.name}: of {np.argmax(doubtful) * arg.fix.lsb:g} it lies between two codes, where float32 does "
                "not say which; give the Quant before or behind it one bit less"
            )
        points = np.round(scaled)
        worst = float(np.abs(points * fix.lsb - exact).max())
        name = f"{step.kind}_{arg.fix.width}_{arg.fix.frac}_{fix.width}_each"
        codes = tuple(int(p) for p in points)
        table = Table(name, step.kind, Symmetry(f.symmetry), 0, codes, False, arg.fix, fix, worst)
        self.tables[name] = table
        out = Signal(step.name, arg.size, fix)
        self.operations.append(Lookup(out, arg.name, name))
        self._define(out, *table.extremes)

    def _output(self, step: Step) -> Signal:
        """Codes, and beside them the scale and the offset that they have in common, if they are on no grid."""
        value, scale, offset = step.value, 1.0, 0.0
        factors = (
            np.unique(np.concatenate([w[w != 0] for w in value.weights.values()])) if value.weights else np.ones(1)
        )
        alike = len(factors) == 1 and factors[0] > 0 and (value.bias == value.bias[0]).all()
        if self.real and alike and all(((w != 0).sum(1) <= 1).all() for w in value.weights.values()):
            scale, offset = float(factors[0]), float(value.bias[0])
            picks = {s: (w != 0) * 1.0 for s, w in value.weights.items()}
            value = Value(value.shape, np.zeros(value.size), picks)
        self.shown[step.name] = scale, offset
        return self.known[self._exact(step.name, value)].signal

    def _define(self, signal: Signal, lo: int, hi: int) -> Signal:
        self.known[signal.name] = Bounded(signal, lo, hi)
        return signal

    def _sign(self, step: Step) -> Signal:
        arg = self._exact(f"{step.name}.n", step.value, Rounding.TRUNCATE)  # which keeps the sign
        out, (low, high) = Signal(step.name, step.value.size, Fix(2, 0)), ACTIVATIONS[step.kind].image
        self.operations.append(Threshold(out, arg, 0, int(low), int(high)))
        return self._define(out, int(low), int(high))

    def _exact(self, name: str, value: Value, rounding: Rounding = Rounding.HALF_EVEN) -> str:
        """The signal that holds a value as it is: an earlier one, or a sum in a format that holds every bit of it.

        rounding: of the bits of a sum beyond those of float32, where nothing is exact.
        """
        if name in self.known:
            return name
        source = _copied(value)
        if source in self.known:
            return source
        sums = self._sums(name, value)
        width = max(2, signed_width(sums.reach))
        less = max(0, width - FLOAT32 - 1)  # of a sum of such weights as float32 does not hold, either
        out = Signal(name, value.size, Fix(width - less, sums.frac - less))
        self._affine(out, value, rounding if less else Rounding.TRUNCATE)
        if less:
            return name
        self._define(out, -sums.reach, sums.reach)
        return name

    def _affine(self, out: Signal, value: Value, rounding: Rounding) -> None:
        sums = self._sums(out.name, value)
        frac = np.full(out.size, sums.frac, np.int64)
        self.operations.append(Affine(out, sums.args, sums.weights, sums.bias, frac, rounding, Overflow.SATURATE))
        self._define(out, out.fix.lo, out.fix.hi)

    def _sums(self, name: str, value: Value) -> Sums:
        for source, _ in value.weights:
            if source in self.curves and source not in self.known:
                raise Inexact(f"{source}: {name} reads it as it is; put a Quant directly behind it")
        read = [self.known[source] for source, _ in value.weights] or list(self.known.values())[:1]
        matrices = list(value.weights.values()) or [np.zeros((value.size, read[0].signal.size))]
        bits = self._rounded if self.real else _bits
        fracs = [bits(name, w) + r.signal.fix.frac for w, r in zip(matrices, read, strict=True)]
        finest = bits(name, value.bias)
        if self.real:  # no finer than a sum is in float32, and a guard bit
            most = sum(
                np.abs(w).sum(1) * max(-r.lo, r.hi) * r.signal.fix.lsb for w, r in zip(matrices, read, strict=True)
            )
            finest = min(finest, FLOAT32 + 1 - int(np.frexp((most + np.abs(value.bias)).max())[1]))
        frac = max(*fracs, finest, FRACTIONS.start)
        bias = np.round(np.ldexp(value.bias, frac))
        codes = [np.round(np.ldexp(w, frac - r.signal.fix.frac)) for w, r in zip(matrices, read, strict=True)]
        reach = np.abs(bias) + sum(np.abs(w).sum(1) * max(-r.lo, r.hi) for w, r in zip(codes, read, strict=True))
        if (most := float(reach.max())) > 2.0 ** (REAL if self.real else FLOAT32):
            raise Inexact(
                f"{name}: its sum needs {int(np.ceil(np.log2(most)))} bits, more than the {FLOAT32} that float32 holds "
                "exactly; give the Quants of its weights, its bias or its inputs fewer bits"
            )
        weights = np.concatenate(codes, axis=1).astype(np.int64)
        return Sums(tuple(r.signal.name for r in read), weights, bias.astype(np.int64), frac, int(most))

    @staticmethod
    def _rounded(name: str, numbers: np.ndarray) -> int:
        """Fraction bits with which the largest number has as many bits as in float32; fewer if they say all exactly."""
        if not numbers.any():
            return 0
        most = FLOAT32 - int(np.frexp(np.abs(numbers).max())[1])
        exact = [bits for bits in range(min(0, most), most) if not (np.ldexp(numbers, bits) % 1).any()]
        return exact[0] if exact else most


KINDS = {"tansig": "later", "logsig": "later", "hardlim": "sign", "hardlims": "sign"}
"""Kind of a step -> the method that declares it, if it has another name."""


def _bits(name: str, numbers: np.ndarray) -> int:
    """Fraction bits that hold every number exactly. Raises InputError if there are none."""
    for bits in FRACTIONS:
        codes = np.ldexp(numbers, bits)
        if np.array_equal(codes, np.floor(codes)):
            return bits
    raise Inexact(f"{name}: a weight or a bias is on no grid; put a Quant behind each constant")


def _picks(value: Value) -> bool:
    """Whether each element is one element of a signal, as it is."""
    rows = np.concatenate(list(value.weights.values()), axis=1)
    return not value.bias.any() and bool((((rows == 0) | (rows == 1)).all(1) & (rows.sum(1) == 1)).all())


def _copied(value: Value) -> str:
    """The signal that a value is, element by element; "" if it is none."""
    if len(value.weights) != 1 or value.bias.any():
        return ""
    (((source, _), w),) = value.weights.items()
    return source if np.array_equal(w, np.eye(value.size)) else ""
