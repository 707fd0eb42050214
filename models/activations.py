"""Activation functions: each is one entry, which says all that training, the compiler and the reports ask of it."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from inspect import signature
from typing import Any, Literal

from greygate.errors import InputError, shown


@dataclass(frozen=True, kw_only=True)
class Activation:
    """y = f(n), element by element.

    value: f of (xp, n). slope: dy/dn of (xp, y); or of (xp, y, n) where y does not tell it, and n must be summed again.
    xp is numpy, torch, `models.arithmetic.xp` or, in compiled kernels, `models.scalars`; torch finds slopes by itself.
    So f may use arithmetic, abs, and of xp what all of them have: exp, tanh, clip, where, ones_like and zeros_like.
    image: least and greatest y. A function without symmetry, or with an odd one, rises monotonically; an even function
    is monotone on either side of zero.
    lowered: the operation that computes it in the integer program (docs/integer-program.md). A threshold answers with
    the ends of the image, a clamp cuts n off at them.
    symmetry: how a table answers negative n from its half for n >= 0; complement is f(-n) = 1 - f(n).
    flat_from: where a table may end, of (decades, most): the n beyond which f is within exp(-decades) of its limit, or
    above `most`.
    rows: sums that one neuron forms.
    """

    value: Callable[[Any, Any], Any]
    slope: Callable[..., Any]
    image: tuple[float, float]
    lowered: Literal["affine", "table", "clamp", "threshold", "select"]
    symmetry: Literal["odd", "even", "complement"] | None = None
    flat_from: Callable[[float, float], float] | None = None
    rows: int = 1

    def __post_init__(self) -> None:
        if self.lowered == "table" and not (self.symmetry and self.flat_from):
            raise ValueError("an activation in a table needs `symmetry` and `flat_from`: half of it is kept")

    @property
    def is_bounded(self) -> bool:
        return math.isfinite(self.image[0]) and math.isfinite(self.image[1])

    @property
    def slope_reads_n(self) -> bool:
        return len(signature(self.slope).parameters) == 3

    @property
    def is_sigmoid(self) -> bool:
        """Whether it rises from one limit to another and bends all the way, as tansig does."""
        return self.lowered == "table" and self.symmetry in ("odd", "complement")


def _select(xp, n):
    """Rows of n in three parts: where the first is not negative the second, else the third."""
    size = n.shape[-1] // 3
    return xp.where(n[..., :size] >= 0, n[..., size : 2 * size], n[..., 2 * size :])


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
    "softsign": Activation(
        value=lambda xp, n: n / (1.0 + abs(n)),
        slope=lambda xp, y: (1.0 - abs(y)) ** 2,
        image=(-1.0, 1.0),
        lowered="table",
        symmetry="odd",
        flat_from=lambda decades, most: math.exp(decades) - 1.0,
    ),
}


def known(name: object, where: str) -> str:
    """An activation's name. Raises InputError, which begins with `where`, for one that does not exist."""
    if not isinstance(name, str) or name not in ACTIVATIONS:
        raise InputError(f"{where} unknown activation {shown(name)}; known: {', '.join(ACTIVATIONS)}")
    return name
