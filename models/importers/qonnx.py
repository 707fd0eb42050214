"""QONNX: Quant nodes declare the formats of signals. Source: https://github.com/fastmachinelearning/qonnx, docs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, NoReturn

import numpy as np

from greygate.errors import InputError, shown
from greygate.models.importers.builder import Builder, Number, Value, constant
from greygate.models.network import Network, Port

ROUNDINGS: Mapping[str, tuple[str, Callable]] = {
    "ROUND": ("half_even", np.round),
    "HALF_EVEN": ("half_even", np.round),
    "FLOOR": ("truncate", np.floor),
}
"""rounding_mode of a Quant node -> the rounding of the integer program that is the same, and NumPy's."""
WIDEST = 24  # bits of a signal's Quant node: what float32, in which QONNX computes, holds
CONSTANT = 32  # of a constant's: Brevitas gives a bias so many


@dataclass(frozen=True)
class Format:
    """Two's complement of `width` bits with `frac` fraction bits, of which the codes lo to hi are used.

    rounding: of the integer program, by which a value becomes a code.
    """

    width: int
    frac: int
    lo: int
    hi: int
    rounding: str


class Step(NamedTuple):
    """A signal that is computed: its name, that of a layer of the network; what of; and the exact sum that it reads.

    kind: "quant", which has a format; "relu"; an activation of CURVES; "output".
    """

    name: str
    kind: str
    value: Value
    format: Format | None = None


class Quantized(NamedTuple):
    """A network without its rounding, and the signals that it has with it, in the order of computation.

    real: scales are any numbers: signals are codes in units of their scales, and weights have the bits of float32.
    """

    network: Network
    steps: tuple[Step, ...]
    real: bool = False


CURVES = ("tansig", "logsig", "hardlim", "hardlims")
"""Activations that are carried beside Quant nodes."""


class Declaring(Builder):
    """Builds the network of a QONNX model, and notes its signals."""

    def __init__(self, name: str, inputs: Sequence[Port | str], outputs: Sequence[Port | str]):
        super().__init__(name, inputs, outputs)
        self.steps: list[Step] = []
        self.real = False

    def quantized(self, value: Value, form: Format, hint: str) -> Value:
        """A layer that limits the value as the format does."""
        low, span = (codes * 2.0**-form.frac for codes in (form.lo, form.hi - form.lo))
        unit = value.plus(constant(-low)).times(1 / span)
        inside = super().activated(unit, "satlin", f"{hint}_limit").times(span).plus(constant(low))
        name = self._free(hint)
        self._layer(name, inside.bias, inside.weights, "linear")
        self.steps.append(Step(name, "quant", value, form))
        return Value(value.shape, np.zeros(value.size), {(name, 0): np.eye(value.size)})

    def rectified(self, value: Value, slope: Number = 0.0, hint: str = "relu") -> Value:
        found = self._noted("relu", value, super().selected(value, value, value.times(0.0), hint))
        return found.times(1.0 - slope).plus(value.times(slope)) if np.any(slope) else found

    def activated(self, value: Value, activation: str, hint: str) -> Value:
        if activation == "satlin":
            return self.clipped(value, 0.0, 1.0, hint)
        if activation not in CURVES:
            _cannot(hint)
        return self._noted(activation, value, super().activated(value, activation, hint))

    def selected(self, condition: Value, above: Value, below: Value, hint: str) -> Value:
        _cannot(hint)

    def maximum(self, a: Value, b: Value, hint: str) -> Value:
        return self.rectified(a.plus(b.times(-1.0)), hint=hint).plus(b)

    def minimum(self, a: Value, b: Value, hint: str) -> Value:
        return self.rectified(a.plus(b.times(-1.0)), hint=hint).times(-1.0).plus(a)

    def product(self, a: Value, b: Value, hint: str = "product") -> Value:
        if a.constant is None and b.constant is None:
            _cannot(hint)
        return super().product(a, b, hint)

    def clipped(self, value: Value, low: Number | None, high: Number | None, hint: str = "clip") -> Value:
        if (narrower := self._narrower(value, low, high, hint)) is not None:
            return narrower
        if low is not None:
            value = self.maximum(value, constant(np.asarray(low, float)), hint)
        return value if high is None else self.minimum(value, constant(np.asarray(high, float)), hint)

    def _narrower(self, value: Value, low: Number | None, high: Number | None, hint: str) -> Value | None:
        """The signal of a Quant node limited to fewer of its codes; None where a value is none, or an end no code."""
        forms = {step.name: step.format for step in self.steps if step.format}
        if len(value.weights) != 1 or (key := next(iter(value.weights)))[0] not in forms:
            return None
        form, factor, offset = forms[key[0]], value.weights[key][0, 0], value.bias[0]
        same = np.array_equal(value.weights[key], np.eye(value.size) * factor) and (value.bias == offset).all()
        if form is None or not same or factor <= 0:
            return None
        ends = [
            last if end is None else float(np.clip((end - offset) / factor * 2.0**form.frac, form.lo, form.hi))
            for end, last in ((low, form.lo), (high, form.hi))
        ]
        if any(end % 1 for end in ends) or ends[0] >= ends[1]:
            return None
        lo, hi = (int(end) for end in ends)
        limited = Format(_width(lo, hi), form.frac, lo, hi, form.rounding)
        plain = Value(value.shape, np.zeros(value.size), {key: np.eye(value.size)})
        return self.quantized(plain, limited, hint).times(factor).plus(constant(offset))

    def state(self, hint: str, initial: np.ndarray) -> tuple[str, Value]:
        _cannot(hint)

    def output(self, ports: Sequence[Port], value: Value) -> None:
        super().output(ports, value)
        made = {c.target: c.source for c in self.network.connections}
        parts = value.moved(np.ravel).parts([p.size for p in ports], 0)
        self.steps += [Step(made[p.name], "output", part) for p, part in zip(ports, parts, strict=True)]

    def _noted(self, kind: str, value: Value, result: Value) -> Value:
        ((name, _),) = result.weights
        self.steps.append(Step(name, kind, value))
        return result


def _cannot(hint: str) -> NoReturn:
    raise InputError(
        f"{hint}: beside Quant nodes a network carries sums, products with constants, limits, maxima, Relu, Tanh and "
        "Sigmoid; replace it by one of them, or export without Quant nodes"
    )


def _quant(
    walk: Any,
    x: Value,
    scale: Value,
    zero: Value,
    bits: Value,
    signed: int = 1,
    narrow: int = 0,
    rounding_mode: str = "ROUND",
) -> Value:
    """A constant is rounded here; a signal gets a format."""
    if (mode := ROUNDINGS.get(rounding_mode.upper())) is None:
        raise walk.refused(
            f"rounding_mode {shown(rounding_mode)}; the hardware has ROUND and FLOOR, choose one of them"
        )
    widths, steps, point = (
        walk.fixed(*v) for v in ((bits, "the bit width"), (scale, "the scale"), (zero, "the zero point"))
    )
    width, most = int(widths.ravel()[0]), CONSTANT if x.constant is not None else WIDEST
    if (widths != width).any() or not 1 <= width <= most:
        raise walk.refused(f"bit width {widths.ravel()[0]:g}; give one whole number from 1 to {most}")
    lo, hi = _codes(width, signed, narrow)
    if hi <= lo and width > 1:
        raise walk.refused("one bit of a narrow range holds only 0; give it two")
    if not (steps > 0).all():
        raise walk.refused(f"its scale is {steps.min():g}; give it a positive one")
    if (point % 1).any() or (x.constant is None and (point != point.flat[0]).any()):
        raise walk.refused(f"zero point {point.flat[0]:g}; give a signal one whole number")
    if width == 1 and signed:  # Brevitas's 1 bit, as QONNX reads it
        if point.any():
            raise walk.refused("a zero point of one bit, which is -1 or 1; give it 0")
        return _bipolar(walk, x, scale)
    several = x.constant is None and bool((steps != steps.flat[0]).any())  # of a signal, whose elements share a format
    real = several or not _powers(steps)
    walk.builder.real |= real
    rounding, numpys = mode
    if (found := x.constant) is not None:
        return constant((numpys(np.clip(found / steps + point, lo, hi)) - point) * steps)
    shift = int(point.flat[0])
    if shift % 2 and not real and rounding == "half_even":  # midway between codes it goes to those even with the point
        form = Format(_width(lo, hi), 0, lo, hi, rounding)
        codes = walk.builder.quantized(x.times(1 / steps).plus(constant(point)), form, walk.hint)
        return codes.plus(constant(-point)).times(steps)
    lo, hi = lo - shift, hi - shift
    if real:
        form = Format(_width(lo, hi), 0, lo, hi, rounding)
        return walk.builder.quantized(x.times(1 / steps), form, walk.hint).times(steps)
    form = Format(_width(lo, hi), 1 - int(np.frexp(steps.flat[0])[1]), lo, hi, rounding)
    return walk.builder.quantized(x, form, walk.hint)


def _width(lo: int, hi: int) -> int:
    """Bits of two's complement that hold both codes; two at least."""
    return max(2, 1 + max((~v if v < 0 else v).bit_length() for v in (lo, hi)))


def quantized_linear(walk: Any, x: Value, scale: Value, zero: Value | None = None, axis: int = 1, **_: Any) -> Value:
    """ONNX's own, of a signal: a format whose codes are those of the type less the zero point; it gives the codes."""
    step, point = walk.fixed(scale, "the scale"), 0.0 if zero is None else walk.fixed(zero, "the zero point")
    if step.size != 1 or np.size(point) != 1:
        raise walk.refused("several scales for one signal, whose elements share a format; quantize it per tensor")
    size, shift = float(step.reshape(())), float(np.reshape(point, ()))
    if not size > 0:
        raise walk.refused(f"its scale is {size:g}; give it a positive one")
    low, high = (int(v - shift) for v in _range(walk.node, walk.scope))
    width = _width(low, high)
    if _powers(step):
        form = Format(width, 1 - int(np.frexp(size)[1]), low, high, "half_even")
        return walk.builder.quantized(x, form, walk.hint).times(1 / size).plus(constant(shift))
    walk.builder.real = True
    form = Format(width, 0, low, high, "half_even")
    return walk.builder.quantized(x.times(1 / size), form, walk.hint).plus(constant(shift))


def dequantized_linear(walk: Any, x: Value, scale: Value, zero: Value | None = None, **_: Any) -> Value:
    shift = np.zeros(1) if zero is None else walk.fixed(zero, "the zero point")
    return x.plus(constant(-shift)).times(walk.fixed(scale, "the scale"))


def _range(node: Any, values: Mapping[str, Any]) -> tuple[int, int]:
    """The least and the greatest code of the type of a QuantizeLinear's zero point; without one it is UINT8."""
    found = np.iinfo(values[node.input[2]].dtype if len(node.input) > 2 and node.input[2] else np.uint8)
    return int(found.min), int(found.max)


def quantized(node: Any, values: Mapping[str, np.ndarray], rounds: bool) -> np.ndarray:
    """What a node that quantizes makes of an array, of which it takes the codes if it rounds, else the limits alone."""
    from onnx import helper

    x, scale, *rest = (values[n] for n in node.input if n)
    steps = scale.astype(float)
    if node.op_type in LINEAR:
        zero = rest[0].astype(float) if rest else 0.0
        if node.op_type == "DequantizeLinear":
            return (x - zero) * steps
        return np.clip((np.round(x / steps) if rounds else x / steps) + zero, *_range(node, values))
    options = {a.name: helper.get_attribute_value(a) for a in node.attribute}
    if node.op_type == "BipolarQuant" or (int(np.ravel(rest[1])[0]), options.get("signed", 1)) == (1, 1):
        return _ones(x) * steps
    lo, hi = _codes(int(np.ravel(rest[1])[0]), options.get("signed", 1), options.get("narrow", 0))
    codes = np.clip(x / steps + rest[0], lo, hi)
    if rounds:
        codes = ROUNDINGS[options.get("rounding_mode", b"ROUND").decode().upper()][1](codes)
    return (codes - rest[0]) * steps


def _codes(width: int, signed: int, narrow: int) -> tuple[int, int]:
    """The least and the greatest code."""
    if signed:
        return narrow - (1 << width - 1), (1 << width - 1) - 1
    return 0, (1 << width) - 1 - narrow


def _bipolar(walk: Any, x: Value, scale: Value) -> Value:
    """-1 where it is negative, else 1, times the scale."""
    steps = walk.fixed(scale, "the scale")
    walk.builder.real |= not _powers(steps)
    if (found := x.constant) is not None:
        return constant(_ones(found) * steps)
    return walk.builder.activated(x, "hardlims", walk.hint).times(steps)


def _powers(steps: np.ndarray) -> bool:
    """Whether all are powers of two, whatever their sign."""
    return bool((np.abs(np.frexp(steps)[0]) == 0.5).all())  # np.frexp gives a mantissa from 0.5 to 1


def _ones(values: np.ndarray) -> np.ndarray:
    return np.where(values >= 0, 1.0, -1.0)


def _trunc(walk: Any, *given: Value | None, **options: Any) -> Value:
    raise walk.refused("it drops bits of a sum; use a Quant with rounding_mode FLOOR")


LINEAR: Mapping[str, Callable] = {"QuantizeLinear": quantized_linear, "DequantizeLinear": dequantized_linear}
"""Operations of ONNX itself."""
QUANTIZERS: Mapping[str, Callable] = {"Quant": _quant, "IntQuant": _quant, "BipolarQuant": _bipolar, "Trunc": _trunc}
"""Operations of QONNX."""
