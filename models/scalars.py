"""The arithmetic of `models.arithmetic` on one number, for kernels that numba compiles.

The names are those of an array namespace, so that one expression of `xp` and `n` serves numpy, torch and a kernel.
"""

import math

import numba
import numpy as np

_LOG2_E = 1.4426950408889634
_LN2 = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # ln 2 in two parts; k times the first is exact
_LOWEST, _HIGHEST = -708.0, 709.0  # exp beyond: 0, and inf
_SERIES = tuple(1 / math.factorial(n) for n in range(13, 1, -1))  # of exp, exact to a bit up to half of ln 2
_ONE, _EXPONENT = 1023, 52  # how a float64 holds 2^k: k + 1023, above 52 bits of fraction

inlined = numba.njit(nogil=True, error_model="numpy", inline="always")


@inlined
def exp(x):  # pragma: no cover - compiled
    """exp(x) within 2.3e-16 of its size."""
    inside = x if _LOWEST <= x <= _HIGHEST else 0.0
    k = math.floor(inside * _LOG2_E + 0.5)
    r = (inside - k * _LN2[0]) - k * _LN2[1]
    s = _SERIES[0]
    for c in _SERIES[1:]:
        s = s * r + c
    found = (1.0 + (r + r * r * s)) * np.int64((np.int64(k) + _ONE) << _EXPONENT).view(np.float64)
    if x < _LOWEST:
        return 0.0
    return found if x <= _HIGHEST else x * math.inf


@inlined
def tanh(n):  # pragma: no cover - compiled
    """Within 3e-16 of tanh."""
    t = exp(-2.0 * abs(n))
    return math.copysign((1.0 - t) / (1.0 + t), n)


@inlined
def sqrt(n):  # pragma: no cover - compiled
    return math.sqrt(n)


@inlined
def floor(n):  # pragma: no cover - compiled
    return np.floor(n)


@inlined
def sign(n):  # pragma: no cover - compiled
    return np.sign(n)


@inlined
def clip(n, low, high):  # pragma: no cover - compiled
    return min(max(n, low), high)


@inlined
def where(condition, yes, no):  # pragma: no cover - compiled
    return yes if condition else no


@inlined
def ones_like(n):  # pragma: no cover - compiled
    return 1.0


@inlined
def zeros_like(n):  # pragma: no cover - compiled
    return 0.0
