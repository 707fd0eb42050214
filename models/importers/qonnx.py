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
WIDEST = 24  # bits of a Quant node: what float32, in which QONNX computes, holds


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

    kind: "quant", which has a format; "relu", "tansig", "logsig"; "output".
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
        if np.any(slope):
            _cannot(hint)
        return self._noted("relu", value, super().rectified(value, 0.0, hint))

    def activated(self, value: Value, activation: str, hint: str) -> Value:
        if activation not in ("tansig", "logsig"):
            _cannot(hint)
        return self._noted(activation, value, super().activated(value, activation, hint))

    def product(self, a: Value, b: Value, hint: str = "product") -> Value:
        if a.constant is None and b.constant is None:
            _cannot(hint)
        return super().product(a, b, hint)

    def clipped(self, value: Value, low: Number | None, high: Number | None, hint: str = "clip") -> Value:
        _cannot(hint)

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
        f"{hint}: beside Quant nodes a network carries sums, products with constants, Relu, Tanh and Sigmoid; "
        "replace it by a Quant with its limits, or export without Quant nodes"
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
    if walk.fixed(zero, "the zero point").any():
        raise walk.refused("a zero point that is not 0; export with symmetric quantization")
    widths, steps = walk.fixed(bits, "the bit width").ravel(), walk.fixed(scale, "the scale")
    width = int(widths[0])
    least = 1 if x.constant is not None else 1 + signed
    if (widths != width).any() or not least <= width <= WIDEST:
        raise walk.refused(f"bit width {widths[0]:g}; give one whole number from {least} to {WIDEST}")
    lo, hi = _codes(width, signed, narrow)
    if hi <= lo and width > 1:
        raise walk.refused("one bit of a narrow range holds only 0; give it two")
    if not (steps > 0).all():
        raise walk.refused(f"its scale is {steps.min():g}; give it a positive one")
    real = not (np.frexp(steps)[0] == 0.5).all()  # np.frexp gives a mantissa from 0.5 to 1
    walk.builder.real |= real
    rounding, numpys = mode
    if (found := x.constant) is not None:
        if width == 1 and signed:  # Brevitas's 1 bit, as QONNX reads it
            return constant(_ones(found) * steps)
        return constant(numpys(np.clip(found / steps, lo, hi)) * steps)
    if (steps != steps.flat[0]).any():
        raise walk.refused("several scales for one signal, whose elements share a format; give it one scale")
    if real:
        form = Format(width + (not signed), 0, lo, hi, rounding)
        return walk.builder.quantized(x.times(1 / steps.flat[0]), form, walk.hint).times(steps.flat[0])
    form = Format(width + (not signed), 1 - int(np.frexp(steps.flat[0])[1]), lo, hi, rounding)
    return walk.builder.quantized(x, form, walk.hint)


def quantized_linear(walk: Any, x: Value, scale: Value, zero: Value | None = None, axis: int = 1, **_: Any) -> Value:
    """ONNX's own, of a signal: a format whose codes are those of the type less the zero point; it gives the codes."""
    step, point = walk.fixed(scale, "the scale"), 0.0 if zero is None else walk.fixed(zero, "the zero point")
    if step.size != 1 or np.size(point) != 1:
        raise walk.refused("several scales for one signal, whose elements share a format; quantize it per tensor")
    size, shift = float(step.reshape(())), float(np.reshape(point, ()))
    if not size > 0:
        raise walk.refused(f"its scale is {size:g}; give it a positive one")
    low, high = (int(v - shift) for v in _range(walk.node, walk.scope))
    width = 1 + max((~low if low < 0 else low).bit_length(), high.bit_length())
    if np.frexp(size)[0] == 0.5:
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
    lo, hi = _codes(int(np.ravel(rest[1])[0]), options.get("signed", 1), options.get("narrow", 0))
    codes = np.clip(x / steps, lo, hi)
    if rounds:
        codes = ROUNDINGS[options.get("rounding_mode", b"ROUND").decode().upper()][1](codes)
    return codes * steps


def _codes(width: int, signed: int, narrow: int) -> tuple[int, int]:
    """The least and the greatest code."""
    if signed:
        return narrow - (1 << width - 1), (1 << width - 1) - 1
    return 0, (1 << width) - 1 - narrow


def _bipolar(walk: Any, x: Value, scale: Value) -> Value:
    """Constants, such as 1-bit weights, become -1 and 1 times the scale."""
    if (found := x.constant) is not None:
        return constant(_ones(found) * walk.fixed(scale, "the scale"))
    raise walk.refused("-1 and 1 have no 0 between them; use a Quant of 2 bits with narrow = 1, which has -1, 0 and 1")


def _ones(values: np.ndarray) -> np.ndarray:
    return np.where(values >= 0, 1.0, -1.0)


def _trunc(walk: Any, *given: Value | None, **options: Any) -> Value:
    raise walk.refused("it drops bits of a sum; use a Quant with rounding_mode FLOOR")


LINEAR: Mapping[str, Callable] = {"QuantizeLinear": quantized_linear, "DequantizeLinear": dequantized_linear}
"""Operations of ONNX itself."""
QUANTIZERS: Mapping[str, Callable] = {"Quant": _quant, "IntQuant": _quant, "BipolarQuant": _bipolar, "Trunc": _trunc}
"""Operations of QONNX."""
