"""Angles, whole turns and what is made of them, of what a network has.

A sine is of half turns, so that its sum may lose whole ones; so does what is left of a division by a constant.
"""

from math import pi

import numpy as np

from greygate.errors import InputError
from greygate.models.importers import norms
from greygate.models.importers.builder import Builder, Value, constant


def sine(builder: Builder, x: Value, hint: str = "sine") -> Value:
    return builder.activated(x.times(1 / pi), "sine", hint)


def cosine(builder: Builder, x: Value, hint: str = "cosine") -> Value:
    return builder.activated(x.times(1 / pi).plus(constant(0.5)), "sine", hint)


def tangent(builder: Builder, x: Value, hint: str = "tangent") -> Value:
    return builder.product(sine(builder, x, hint), norms.inverse(builder, cosine(builder, x, hint), hint), hint)


def arctan(builder: Builder, x: Value, hint: str = "arctan") -> Value:
    return builder.activated(x, "arctan", hint).times(pi / 2)


def arctan2(builder: Builder, y: Value, x: Value, hint: str = "arctan2") -> Value:
    """The angle of (x, y), from that of the octant; at 0, 0 it is 0."""
    high, wide = (builder.rectified(v, -1.0, hint) for v in (y, x))
    flat = wide.plus(high.times(-1.0))  # 0 at 0, 0, where the angle is that of a flat one
    largest = builder.maximum(high, wide, hint)
    least = builder.minimum(high, wide, hint)
    part = arctan(builder, builder.product(least, norms.inverse(builder, largest, hint), hint), hint)
    found = builder.chosen(flat, part, part.times(-1.0).plus(constant(pi / 2)), hint)
    found = builder.chosen(x, found, found.times(-1.0).plus(constant(pi)), hint)
    return builder.chosen(y, found, found.times(-1.0), hint)


def arcsine(builder: Builder, x: Value, hint: str = "arcsine") -> Value:
    """Raises InputError for what may be beyond -1 and 1."""
    low, high = builder.ends(x)
    if (low < -1).any() or (high > 1).any():
        raise InputError("an angle of a signal that may be beyond -1 and 1; limit it (clamp)")
    rest = builder.power(x, 2, hint).times(-1.0).plus(constant(1.0))
    return arctan2(builder, x, norms.root(builder, builder.rectified(rest, 0.0, hint), hint), hint)


def arccosine(builder: Builder, x: Value, hint: str = "arccosine") -> Value:
    return arcsine(builder, x, hint).times(-1.0).plus(constant(pi / 2))


def sinh(builder: Builder, x: Value, hint: str = "sinh") -> Value:
    return norms.exp(builder, x, hint).plus(norms.exp(builder, x.times(-1.0), hint).times(-1.0)).times(0.5)


def cosh(builder: Builder, x: Value, hint: str = "cosh") -> Value:
    return norms.exp(builder, x, hint).plus(norms.exp(builder, x.times(-1.0), hint)).times(0.5)


def arsinh(builder: Builder, x: Value, hint: str = "arsinh") -> Value:
    size = builder.rectified(x, -1.0, hint)
    length = norms.root(builder, builder.power(x, 2, hint).plus(constant(1.0)), hint)
    found = norms.ln(builder, size.plus(length), hint)
    return builder.selected(x, found, found.times(-1.0), hint)


def remainder(builder: Builder, x: Value, period: np.ndarray, hint: str = "remainder") -> Value:
    """What is left of whole periods, from 0 to a positive period."""
    if not (period > 0).all():
        raise InputError("a period that is not positive")
    half = builder.activated(x.times(2 / period).plus(constant(-1.0)), "turn", hint)
    return half.plus(constant(1.0)).times(period / 2)


def floor(builder: Builder, x: Value, hint: str = "floor") -> Value:
    return x.plus(remainder(builder, x, np.ones(()), hint).times(-1.0))


def ceil(builder: Builder, x: Value, hint: str = "ceil") -> Value:
    return floor(builder, x.times(-1.0), hint).times(-1.0)


FUNCTIONS = {
    "sin": sine, "cos": cosine, "tan": tangent, "asin": arcsine, "acos": arccosine, "atan": arctan, "sinh": sinh,
    "cosh": cosh, "asinh": arsinh, "floor": floor, "ceil": ceil,
}  # fmt: skip
"""By their names in torch; ONNX begins them with a capital."""
