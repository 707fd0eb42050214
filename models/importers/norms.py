"""Softmax, norms by an input's own spread, roots, divisions, powers and logarithms, made of what a network has.

ln(e^a + e^b) = max(a, b) + ln(1 + e^-|a - b|), so the logarithm of a sum of exponentials is a tree of limits and one
table, and softmax is e^-|x - it|: nothing overflows. A norm multiplies by 1 / sqrt(v), a table of what cannot be 0.
"""

from collections.abc import Sequence

import numpy as np

from greygate.errors import InputError
from greygate.models.importers.builder import Builder, Value, constant, joined, stacked

ROOTS = 3  # one of another
LARGEST = 16  # power: beyond, a format holds no two numbers that differ by an octave


def log_sum(builder: Builder, x: Value, axes: Sequence[int] = (), keep: bool = False, hint: str = "log_sum") -> Value:
    """ln of the sum of e^x along some axes, along all if none is named. keep: they stay, with one element."""

    def pair(a: Value, b: Value) -> Value:
        rest = builder.activated(a.plus(b.times(-1.0)), "softfall", hint)
        return builder.activated(builder.maximum(a, b, hint).plus(rest), "linear", hint)

    return builder.along(x, axes, keep, pair)


def softmax(builder: Builder, x: Value, axis: int = -1, hint: str = "softmax") -> Value:
    """e^x by its sum along an axis; 0 where x is -inf always, as a mask writes it."""
    if np.isneginf(x.bias).any():
        return _masked(builder, x, axis, hint)
    return builder.activated(log_softmax(builder, x, axis, hint), "negexp", hint)


def log_softmax(builder: Builder, x: Value, axis: int = -1, hint: str = "softmax") -> Value:
    return x.plus(log_sum(builder, x, [axis], True, hint).times(-1.0))


def _masked(builder: Builder, x: Value, axis: int, hint: str) -> Value:
    last = x.moved(lambda i: np.moveaxis(i, axis, -1))
    shape, rows = last.shape, []
    for places in np.arange(x.size).reshape(-1, shape[-1]):
        seen = np.isfinite(last.bias[places])
        part = last.rows(places[seen])
        found = softmax(builder, part, 0, hint) if seen.sum() > 1 else constant(np.ones(int(seen.sum())))
        spread = np.where(seen, np.cumsum(seen), 0)
        rows.append(joined([constant(np.zeros(1)), found], 0).rows(spread))
    return stacked(rows, 0).moved(lambda i: np.moveaxis(i.reshape(shape), -1, axis))


def exp(builder: Builder, x: Value, hint: str = "exp") -> Value:
    """e^x by tables: that of x below 0, times the fourth power of e^(x / 4) above, 1 by the root of e^(-x / 2)."""
    if (found := x.constant) is not None:
        return constant(np.exp(found))
    if (builder.ends(x)[1] <= 0).all():
        return builder.activated(x, "negexp", hint)
    above = builder.rectified(x, 0.0, hint)
    below = builder.activated(x.plus(above.times(-1.0)), "negexp", hint)
    fourth = builder.activated(builder.activated(above.times(0.5), "negexp", hint), "rsqrt", hint)
    return builder.positive(builder.product(below, builder.power(fourth, 4, hint), hint))


def attention(builder: Builder, q: Value, k: Value, v: Value, mask: Value, scale: float, hint: str) -> Value:
    """softmax(scale q k^T + mask) v, over the last two axes of each."""
    scores = builder.matmul(q, k.moved(lambda i: np.swapaxes(i, -1, -2)), hint).times(scale).plus(mask)
    return builder.matmul(softmax(builder, scores, -1, hint), v, hint)


def normalised(
    builder: Builder, x: Value, axes: Sequence[int], epsilon: float, hint: str = "norm", centred: bool = True
) -> Value:
    """x less its mean along some axes (centred: or x as it is), by the root of its mean square and epsilon."""
    if not epsilon > 0:
        raise InputError(f"its epsilon is {epsilon:g}, so it divides by 0 where all are equal; give it a positive one")
    own = builder.activated(x.plus(x.mean(axes, True).times(-1.0)), "linear", hint) if centred else x
    square = builder.power(own, 2, hint).mean(axes, True).plus(constant(epsilon))
    return builder.product(own, builder.activated(square, "rsqrt", hint), hint)


def root(builder: Builder, x: Value, hint: str = "root") -> Value:
    """The square root. Raises InputError for what may be negative."""
    if (found := x.constant) is not None:
        return constant(np.sqrt(found))
    _at_least(builder, x, 0.0, "a root of a signal that may be negative")
    return builder.root(x, hint)


def inverse_root(builder: Builder, x: Value, hint: str = "root") -> Value:
    """1 / sqrt(x). Raises InputError for what may be negative; of 0 the model makes no number either."""
    if (found := x.constant) is not None:
        return constant(1 / np.sqrt(found))
    _at_least(builder, x, 0.0, "a root of a signal that may be negative, below a line")
    return builder.activated(x, "rsqrt", hint)


def inverse(builder: Builder, x: Value, hint: str = "inverse") -> Value:
    """1 / x, as the square of 1 / sqrt(|x|), with the sign of x."""
    if (found := x.constant) is not None:
        if not found.all():
            raise InputError("divides by 0")
        return constant(1 / found)
    low, high = builder.ends(x)
    if (low < 0).any() and (high > 0).any():
        size = inverse(builder, builder.rectified(x, -1.0, hint), hint)
        return builder.selected(x, size, size.times(-1.0), hint)
    turned = x.times(-1.0) if (low < 0).any() else x
    sign = -1.0 if (low < 0).any() else 1.0
    if (there := builder.inverse_of_root(turned)) is not None:
        return there.times(sign)
    return builder.power(builder.activated(turned, "rsqrt", hint), 2, hint).times(sign)


def power(builder: Builder, x: Value, exponent: float, hint: str = "power") -> Value:
    """x to a number up to LARGEST: products, roots of roots for its eighths, for others e^(exponent ln x).

    Raises InputError for a larger exponent, and for a broken one of what may be negative.
    """
    if not abs(exponent) <= LARGEST:
        raise InputError(f"the power {exponent:g}; up to {LARGEST} can be carried")
    if exponent == -0.5:
        return inverse_root(builder, x, hint)
    if exponent < 0:
        return inverse(builder, power(builder, x, -exponent, hint), hint)
    whole, eighths = divmod(exponent * 2**ROOTS, 2**ROOTS)
    if eighths % 1:
        return exp(builder, ln(builder, x, hint).times(exponent), hint)
    found = builder.power(x, int(whole), hint) if whole else None
    rooted = x
    for k in reversed(range(ROOTS)):
        if eighths % 2 ** (k + 1):
            rooted = root(builder, rooted, hint)
            if eighths >= 2**k:
                found, eighths = rooted if found is None else builder.product(found, rooted, hint), eighths - 2**k
    return constant(np.ones(x.shape)) if found is None else found


def ln(builder: Builder, x: Value, hint: str = "ln") -> Value:
    """Raises InputError for what may be negative."""
    if (found := x.constant) is not None:
        return constant(np.log(found))
    _at_least(builder, x, 0.0, "the logarithm of a signal that may be negative")
    return builder.activated(x, "ln", hint)


def powers(builder: Builder, x: Value, exponents: np.ndarray, hint: str = "power") -> Value:
    """Every element to its own exponent, with NumPy's broadcasting."""
    shape = np.broadcast_shapes(x.shape, exponents.shape)
    wide = x.moved(lambda i: np.broadcast_to(i, shape).ravel())
    each = np.broadcast_to(exponents, shape).ravel()
    places = [np.flatnonzero(each == k) for k in np.unique(each)]
    parts = [power(builder, wide.rows(at), float(each[at[0]]), hint) for at in places]
    return joined(parts, 0).rows(np.argsort(np.concatenate(places)).reshape(shape))


def _at_least(builder: Builder, x: Value, least: float, what: str) -> None:
    if (builder.ends(x)[0] < least).any():
        raise InputError(f"{what}; add a constant to a sum of squares or of sigmoids, or limit it from below (clamp)")
