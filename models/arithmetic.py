"""Float arithmetic that comes out the same, to the bit, on every processor.

A build must be a function of its inputs. Where floats decide integers on the way to it (the free run that every pass
sees, merged weights, ranges, means, tables) they come from here: IEEE 754 additions, multiplications and divisions in
an order that stands in the program, and what is exact by definition (floor, powers of two). Numpy's element-wise
operations and numba without `fastmath` keep to that: they neither reorder nor contract. What does not: BLAS and LAPACK
(`@`, `linalg`), whose kernels and threads each add in their own order, and exp, tanh, sin and pow of numpy and of the C
library, which differ in the last bit between AVX512, FMA and neither.
"""

import math
from types import SimpleNamespace

import numba
import numpy as np

_LOG2_E = 1.4426950408889634
_LN2 = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # ln 2 in two parts; k times the first is exact
_LOWEST, _HIGHEST = -708.0, 709.0  # exp beyond: 0, and inf
_SERIES = tuple(1 / math.factorial(n) for n in range(13, 1, -1))  # of exp, exact to a bit up to half of ln 2
_ONE, _EXPONENT = 1023, 52  # how a float64 holds 2^k: k + 1023, above 52 bits of fraction


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def scalar_exp(x):  # pragma: no cover - compiled
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


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def scalar_tanh(n):  # pragma: no cover - compiled
    """Within 3e-16 of tanh."""
    t = scalar_exp(-2.0 * abs(n))
    return math.copysign((1.0 - t) / (1.0 + t), n)


_exp = numba.vectorize(nopython=True, cache=True)(scalar_exp.py_func)
_tanh = numba.vectorize(nopython=True, cache=True)(lambda n: scalar_tanh(n))


def exp(x: np.ndarray) -> np.ndarray:
    """`scalar_exp` of every element."""
    with np.errstate(over="ignore", invalid="ignore"):  # what is infinite or NaN stays so, and is no news
        return _exp(x)


def tanh(n: np.ndarray) -> np.ndarray:
    """`scalar_tanh` of every element."""
    with np.errstate(over="ignore", invalid="ignore"):
        return _tanh(n)


xp = SimpleNamespace(exp=exp, tanh=tanh, where=np.where, clip=np.clip, ones_like=np.ones_like, zeros_like=np.zeros_like)
"""The namespace that `ACTIVATIONS` take."""


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a @ b of matrices, (n, k) and (k, m), or a vector (k,): terms added one after the other."""
    columns = np.atleast_2d(b.T).T
    total = np.zeros((len(a), columns.shape[1]))
    for k in range(len(columns)):
        total += a[:, k, None] * columns[k]
    return total.reshape(len(a), *b.shape[1:])


def mean(values: np.ndarray) -> np.ndarray:
    """Mean over the first axis, (N, ...) -> (...), added one after the other."""
    return _sums(np.ascontiguousarray(values).reshape(len(values), -1)).reshape(values.shape[1:]) / len(values)


@numba.njit(cache=True, nogil=True)
def _sums(values):  # pragma: no cover - compiled
    total = np.zeros(values.shape[1])
    for k in range(values.shape[0]):
        for j in range(values.shape[1]):
            total[j] += values[k, j]
    return total
