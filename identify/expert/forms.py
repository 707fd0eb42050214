"""Weighted sums of signals, which an expression of a plant is where it is linear."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from greygate.plants.expressions import Call, Name, Node, Number, Operation, Signed
from greygate.plants.functions import FUNCTIONS


@dataclass(frozen=True)
class Form:
    """constant + sum of weights[signal] * signal.

    free: signal whose weight the data sheet leaves uncertain, "" for the constant -> its relative tolerance.
    """

    constant: float = 0.0
    weights: Mapping[str, float] = field(default_factory=dict)
    free: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_constant(self) -> bool:
        return not self.weights

    def __add__(self, other: "Form") -> "Form":
        weights = {n: self.weights.get(n, 0.0) + other.weights.get(n, 0.0) for n in {**self.weights, **other.weights}}
        free = {n: max(self.free.get(n, 0.0), other.free.get(n, 0.0)) for n in {**self.free, **other.free}}
        return Form(self.constant + other.constant, {n: w for n, w in weights.items() if w}, free)

    def times(self, factor: "Form") -> "Form":
        """The product with a constant."""
        k = factor.constant
        if k == 0.0:
            return Form()
        more = factor.free.get("", 0.0)
        free = {n: self.free.get(n, 0.0) + more for n in ({*self.weights, ""} if more else self.free)}
        return Form(self.constant * k, {n: w * k for n, w in self.weights.items()}, free)

    def over(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Its value, with the shape of the signals."""
        return np.asarray(self.constant + sum(w * values[n] for n, w in self.weights.items()))


Resolve = Callable[[str], Form]


def linear(node: Node, resolve: Resolve) -> Form | None:
    """The form of an expression; None where it is not linear in the signals that `resolve` makes of its names."""
    match node:
        case Number(value):
            return Form(float(value))
        case Name(symbol):
            return resolve(symbol)
        case Signed(sign, of):
            inner = linear(of, resolve)
            return inner and inner.times(Form(-1.0 if sign == "-" else 1.0))
        case Call("when", (condition, of)):
            acts = linear(condition, resolve)
            if acts is None or not acts.is_constant:
                return None
            return linear(of, resolve) if acts.constant else Form()
        case Call(function, given):
            return _constant(FUNCTIONS[function], [linear(part, resolve) for part in given])
        case Operation(sign, left, right):
            return _joined(sign, left, right, resolve)
    return None


def _joined(sign: str, left: Node, right: Node, resolve: Resolve) -> Form | None:
    a = linear(left, resolve)
    if sign in "*/" and a == Form():
        return a  # what nought is multiplied with need not be built
    b = linear(right, resolve)
    if sign == "*" and b == Form():
        return b
    if a is None or b is None:
        return None
    if sign in "+-":
        return a + (b if sign == "+" else b.times(Form(-1.0)))
    if sign == "*" and (a.is_constant or b.is_constant):
        return a.times(b) if b.is_constant else b.times(a)
    if sign == "/" and b.is_constant:
        return a.times(Form(1.0 / b.constant, free=b.free))
    return _constant(lambda x, y: x**y if sign == "**" else x * y, [a, b])


def _constant(function: Callable, forms: list[Form | None]) -> Form | None:
    known = [form for form in forms if form is not None and form.is_constant]
    if len(known) < len(forms):
        return None
    tolerance = sum(form.free.get("", 0.0) for form in known)
    value = float(function(*(form.constant for form in known)))
    return Form(value, free={"": tolerance} if tolerance else {})
