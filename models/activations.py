"""Activation functions: each is one entry, which says all that training, the compiler and the reports ask of it."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from inspect import signature
from typing import Any, Literal

import numpy as np

from greygate.errors import InputError, shown


@dataclass(frozen=True, kw_only=True)
class Activation:
    """y = f(n), element by element.

    value: f of (xp, n). slope: dy/dn of (xp, y); or of (xp, y, n) where y does not tell it, and n must be summed again.
    xp is numpy, torch, `models.arithmetic.xp` or, in compiled kernels, `models.scalars`; torch finds slopes by itself.
    So f may use arithmetic, abs, and of xp what all of them have: exp, tanh, sqrt, floor, clip, where, ones_like,
    zeros_like.
    image: least and greatest y. A function without symmetry, or with an odd one, rises monotonically unless it is
    periodic; an even function is monotone on either side of zero.
    lowered: the operation that computes it in the integer program (docs/integer-program.md). A threshold answers with
    the ends of the image, a clamp cuts n off at them, a wrap is a sum that loses what is left of the point.
    symmetry: how a table answers negative n from its half for n >= 0; complement is f(-n) = 1 - f(n).
    flat_from: where a table may end, of (decades, most): the n beyond which f is within exp(-decades) of its limit, or
    above `most`.
    rows: sums that one neuron forms. steep: its slope has no bound towards n = 0, from where the segments of its table
    grow.
    periodic: of period 2, so its sum may lose what is left of the point.
    """

    value: Callable[[Any, Any], Any]
    slope: Callable[..., Any]
    image: tuple[float, float]
    lowered: Literal["affine", "table", "clamp", "threshold", "select", "product", "wrap"]
    symmetry: Literal["odd", "even", "complement"] | None = None
    flat_from: Callable[[float, float], float] | None = None
    rows: int = 1
    steep: bool = False
    periodic: bool = False

    def __post_init__(self) -> None:
        if self.lowered == "table" and not (self.symmetry and self.flat_from):
            raise ValueError("an activation in a table needs `symmetry` and `flat_from`: half of it is kept")

    @property
    def is_bounded(self) -> bool:
        return math.isfinite(self.image[0]) and math.isfinite(self.image[1])

    @property
    def diverges(self) -> bool:
        """Whether it has no answer at 0, so that no code may stand for less."""
        return self.steep and abs(float(self.value(np, np.zeros(1))[0])) > 1.0

    @property
    def slope_reads_n(self) -> bool:
        return len(signature(self.slope).parameters) == 3

    @property
    def is_sigmoid(self) -> bool:
        """Whether it rises from one limit to another and bends all the way, as tansig does."""
        return self.lowered == "table" and self.symmetry in ("odd", "complement") and not self.periodic


def _select(xp, n):
    """Rows of n in three parts: where the first is not negative the second, else the third."""
    size = n.shape[-1] // 3
    return xp.where(n[..., :size] >= 0, n[..., size : 2 * size], n[..., 2 * size :])


def _product(xp, n):
    """Rows of n in two parts, one times the other."""
    size = n.shape[-1] // 2
    return n[..., :size] * n[..., size:]


_ATANH = tuple(1 / k for k in range(35, 0, -2))  # of atanh(s) / s in s^2, exact to a bit up to s = 1 / 3


def _softfall(xp, n):
    """ln(1 + exp(-|n|)) as 2 atanh(t / (2 + t)) of t = exp(-|n|)."""
    t = xp.exp(-abs(n))
    s = t / (2.0 + t)
    found = 0.0 * s
    for c in _ATANH:
        found = found * (s * s) + c
    return 2.0 * s * found


_ERFC = (  # Chebyshev's coefficients of ln(erfc(z) exp(z^2) / t) in 2 t - 1, t = 2 / (2 + z); the last one first
    1.210237189224279e-16, -9.457494571291233e-17, -1.5230282014571043e-15, 7.106097613609237e-15,
    3.810905255189232e-16, -1.1270822361367252e-13, 3.130921399342958e-13, 8.944879273090725e-13,
    -6.886027526497553e-12, 2.3940380830391146e-12, 9.646791102015527e-11, -2.273651222931836e-10,
    -9.91364156493033e-10, 5.059343495551469e-09, 6.5290544390988515e-09, -8.523809591492654e-08,
    1.5626441722066142e-08, 1.3036558355805232e-06, -1.6242900046470256e-06, -2.0278578112534242e-05,
    4.252332480690777e-05, 0.00036683949785276145, -0.0009465953444820369, -0.009561514786808632,
    0.019476473204185836, 0.6419697923564902,
)  # fmt: skip
_ERFC_0 = -0.6513268598908547  # the first of them


def _normal(xp, n):
    """The distribution function of the normal distribution, by erfc(z) = t exp(-z^2 + sum)."""
    z = xp.clip(abs(n), 0.0, 40.0) * math.sqrt(0.5)  # the tail beyond is 0
    t = 2.0 / (2.0 + z)
    y = 4.0 * t - 2.0
    d = 0.0 * t
    before = 0.0 * t
    for c in _ERFC:
        d, before = y * d - before + c, d
    tail = 0.5 * t * xp.exp(_ERFC_0 + 0.5 * y * d - before - z * z)
    return xp.where(n >= 0, 1.0 - tail, tail)


_SINE = tuple((-1.0) ** k * math.pi ** (2 * k + 1) / math.factorial(2 * k + 1) for k in range(10, -1, -1))


def _sine(xp, n):
    """sin(pi n) by its series, exact to a bit up to n = 1 / 2."""
    turned = n - 2.0 * xp.floor(0.5 * n + 0.5)
    rest = xp.where(abs(turned) > 0.5, xp.where(turned > 0, 1.0 - turned, -1.0 - turned), turned)
    found = 0.0 * rest
    for c in _SINE:
        found = found * (rest * rest) + c
    return found * rest


def _sine_slope(xp, y, n):
    """pi cos(pi n), as the sine of what is left to half a turn's half."""
    rest = 0.5 - abs(n - 2.0 * xp.floor(0.5 * n + 0.5))
    found = 0.0 * rest
    for c in _SINE:
        found = found * (rest * rest) + c
    return math.pi * found * rest


_ATAN = tuple((-1.0) ** k / (2 * k + 1) for k in range(13, -1, -1))  # of atan(s) / s in s^2, exact to a bit below 0.2


def _arctan(xp, n):
    """2 / pi of the angle whose tangent is n, by that of an eighth of it."""
    s = xp.clip(n, -1e150, 1e150)
    for _ in range(3):
        s = s / (1.0 + xp.sqrt(1.0 + s * s))
    found = 0.0 * s
    for c in _ATAN:
        found = found * (s * s) + c
    return found * s * (16.0 / math.pi)


_LEAST = 1e-90  # of what a root is taken: the third power of its answer, in a slope, is still a float
_ROOTS = 10  # square roots after which what goes from _LEAST to 1 / _LEAST lies between 0.8 and 1.23


def _ln(xp, n):
    """ln|n| by that of its root, and one step of Newton's for what the roots have lost."""
    inside = xp.clip(abs(n), _LEAST, 1.0 / _LEAST)
    root = inside
    for _ in range(_ROOTS):
        root = xp.sqrt(root)
    s = (root - 1.0) / (root + 1.0)
    found = 0.0 * s
    for c in _ATANH:
        found = found * (s * s) + c
    rough = 2.0 ** (_ROOTS + 1) * s * found
    return rough + (inside * xp.exp(-rough) - 1.0)


ACTIVATIONS: dict[str, Activation] = {
    "tansig": Activation(
        value=lambda xp, n: xp.tanh(n),
        slope=lambda xp, y: 1.0 - y * y,
        image=(-1.0, 1.0),
        lowered="table",
        symmetry="odd",
        flat_from=lambda decades, most: 0.5 * (decades + math.log(2)),
    ),
    "logsig": Activation(
        value=lambda xp, n: 0.5 + 0.5 * xp.tanh(0.5 * n),
        slope=lambda xp, y: y * (1.0 - y),
        image=(0.0, 1.0),
        lowered="table",
        symmetry="complement",
        flat_from=lambda decades, most: decades,
    ),
    "linear": Activation(
        value=lambda xp, n: n,
        slope=lambda xp, y: 1.0,
        image=(-math.inf, math.inf),
        lowered="affine",
    ),
    "hardlim": Activation(
        value=lambda xp, n: xp.where(n >= 0, xp.ones_like(n), xp.zeros_like(n)),
        slope=lambda xp, y: 0.0,
        image=(0.0, 1.0),
        lowered="threshold",
    ),
    "hardlims": Activation(
        value=lambda xp, n: xp.where(n >= 0, xp.ones_like(n), -xp.ones_like(n)),
        slope=lambda xp, y: 0.0,
        image=(-1.0, 1.0),
        lowered="threshold",
    ),
    "satlin": Activation(
        value=lambda xp, n: xp.clip(n, 0.0, 1.0),
        slope=lambda xp, y: 1.0 if 0.0 < y < 1.0 else 0.0,
        image=(0.0, 1.0),
        lowered="clamp",
    ),
    "radbas": Activation(
        value=lambda xp, n: xp.exp(-n * n),
        slope=lambda xp, y, n: -2.0 * n * y,
        image=(0.0, 1.0),
        lowered="table",
        symmetry="even",
        flat_from=lambda decades, most: math.sqrt(decades),
    ),
    "square": Activation(
        value=lambda xp, n: n * n,
        slope=lambda xp, y, n: 2.0 * n,
        image=(0.0, math.inf),
        lowered="table",
        symmetry="even",
        flat_from=lambda decades, most: math.sqrt(most),
    ),
    "negexp": Activation(
        value=lambda xp, n: xp.exp(-abs(n)),
        slope=lambda xp, y, n: -xp.sign(n) * y,
        image=(0.0, 1.0),
        lowered="table",
        symmetry="even",
        flat_from=lambda decades, most: decades,
    ),
    "select": Activation(  # a multiplexer: its rows are condition, value where that is >= 0, value else
        value=_select,
        slope=lambda xp, y: 1.0,  # by the row that acts
        image=(-math.inf, math.inf),
        lowered="select",
        rows=3,
    ),
    "product": Activation(  # two signals multiplied
        value=_product,
        slope=lambda xp, y: 1.0,  # by each row the sum of the other
        image=(-math.inf, math.inf),
        lowered="product",
        rows=2,
    ),
    "softsign": Activation(
        value=lambda xp, n: n / (1.0 + abs(n)),
        slope=lambda xp, y: (1.0 - abs(y)) ** 2,
        image=(-1.0, 1.0),
        lowered="table",
        symmetry="odd",
        flat_from=lambda decades, most: math.exp(decades) - 1.0,
    ),
    "softfall": Activation(
        value=_softfall,
        slope=lambda xp, y, n: -xp.sign(n) * xp.exp(-abs(n)) / (1.0 + xp.exp(-abs(n))),
        image=(0.0, math.log(2)),
        lowered="table",
        symmetry="even",
        flat_from=lambda decades, most: decades,
    ),
    "normal": Activation(
        value=_normal,
        slope=lambda xp, y, n: xp.exp(-0.5 * n * n) / math.sqrt(2 * math.pi),
        image=(0.0, 1.0),
        lowered="table",
        symmetry="complement",
        flat_from=lambda decades, most: math.sqrt(2 * decades),
    ),
    "rsqrt": Activation(  # of a positive sum
        value=lambda xp, n: 1.0 / xp.sqrt(xp.clip(abs(n), _LEAST, 1.0 / _LEAST)),
        slope=lambda xp, y, n: -0.5 * xp.sign(n) * y * y * y,
        image=(0.0, math.inf),
        lowered="table",
        symmetry="even",
        flat_from=lambda decades, most: math.exp(2.0 * decades),
        steep=True,
    ),
    "root": Activation(  # of a sum that is never negative
        value=lambda xp, n: xp.sqrt(abs(n)),
        slope=lambda xp, y, n: 0.5 * xp.sign(n) / xp.clip(y, math.sqrt(_LEAST), math.inf),
        image=(0.0, math.inf),
        lowered="table",
        symmetry="even",
        flat_from=lambda decades, most: most * most,
        steep=True,
    ),
    "sine": Activation(  # of half turns
        value=_sine,
        slope=_sine_slope,
        image=(-1.0, 1.0),
        lowered="table",
        symmetry="odd",
        flat_from=lambda decades, most: 2.0**62,  # beyond every format
        periodic=True,
    ),
    "turn": Activation(  # what is left of whole turns, in half turns
        value=lambda xp, n: n - 2.0 * xp.floor(0.5 * n + 0.5),
        slope=lambda xp, y: 1.0,
        image=(-1.0, 1.0),
        lowered="wrap",
        periodic=True,
    ),
    "arctan": Activation(
        value=_arctan,
        slope=lambda xp, y, n: (2.0 / math.pi) / (1.0 + n * n),
        image=(-1.0, 1.0),
        lowered="table",
        symmetry="odd",
        flat_from=lambda decades, most: math.exp(decades),
    ),
    "ln": Activation(  # of a positive sum
        value=_ln,
        slope=lambda xp, y, n: xp.sign(n) / xp.clip(abs(n), _LEAST, 1.0 / _LEAST),
        image=(-math.inf, math.inf),
        lowered="table",
        symmetry="even",
        flat_from=lambda decades, most: math.exp(min(most, 300.0)),
        steep=True,
    ),
}


def known(name: object, where: str) -> str:
    """An activation's name. Raises InputError, which begins with `where`, for one that does not exist."""
    if not isinstance(name, str) or name not in ACTIVATIONS:
        raise InputError(f"{where} unknown activation {shown(name)}; known: {', '.join(ACTIVATIONS)}")
    return name
