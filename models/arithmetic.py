"""Float arithmetic that comes out the same, to the bit, on every processor.

A build must be a function of its inputs alone. On the way to it floats decide integers: the free run that every pass
sees, merged weights, ranges, means, tables. These floats are computed here, by IEEE 754 additions, multiplications and
divisions in an order that the program fixes, and by operations that are exact by definition (floor, powers of two).
Numpy's element-wise operations and numba without `fastmath` neither reorder nor contract, so they may be used. BLAS and
LAPACK (`@`, `linalg`) may not: their kernels and threads add in orders of their own. Nor may exp, tanh, sin and pow of
numpy and the C library: their last bit depends on whether the processor has AVX512 or FMA.
"""

from types import SimpleNamespace

import numba
import numpy as np

from greygate.models import scalars

_exp = numba.vectorize(nopython=True, cache=True)(scalars.exp.py_func)
_tanh = numba.vectorize(nopython=True, cache=True)(scalars.tanh.py_func)


def exp(x: np.ndarray) -> np.ndarray:
    """`scalars.exp` of every element."""
    with np.errstate(over="ignore", invalid="ignore"):  # infinities and NaN pass through without a warning
        return _exp(x)


def tanh(n: np.ndarray) -> np.ndarray:
    """`scalars.tanh` of every element."""
    with np.errstate(over="ignore", invalid="ignore"):
        return _tanh(n)


xp = SimpleNamespace(
    exp=exp, tanh=tanh, sqrt=np.sqrt, floor=np.floor, where=np.where, clip=np.clip,
    ones_like=np.ones_like, zeros_like=np.zeros_like,
)  # fmt: skip
"""The namespace that activations take (`models.activations`)."""


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


@numba.njit(cache=True, nogil=True)
def gram(a):  # pragma: no cover - compiled
    """a.T @ a of a matrix (n, k): terms added one after the other, four rows at a time."""
    n, k = a.shape
    total = np.zeros((k, k))
    for r in range(0, n - 3, 4):
        for i in range(k):
            x0, x1, x2, x3 = a[r, i], a[r + 1, i], a[r + 2, i], a[r + 3, i]
            if x0 == 0.0 and x1 == 0.0 and x2 == 0.0 and x3 == 0.0:
                continue
            for j in range(i, k):
                total[i, j] += x0 * a[r, j] + x1 * a[r + 1, j] + x2 * a[r + 2, j] + x3 * a[r + 3, j]
    for r in range(n - n % 4, n):
        for i in range(k):
            for j in range(i, k):
                total[i, j] += a[r, i] * a[r, j]
    for i in range(k):
        for j in range(i):
            total[i, j] = total[j, i]
    return total


@numba.njit(cache=True, nogil=True)
def inverse(a):  # pragma: no cover - compiled
    """The inverse of a symmetric matrix (k, k) by Cholesky; all NaN if it is not positive definite."""
    k = len(a)
    low = np.zeros((k, k))  # L, then its inverse
    for j in range(k):
        for i in range(j, k):
            s = a[i, j]
            for m in range(j):
                s -= low[i, m] * low[j, m]
            if i == j:
                if not s > 0.0:
                    return np.full((k, k), np.nan)
                low[j, j] = np.sqrt(s)
            else:
                low[i, j] = s / low[j, j]
    turned = np.zeros((k, k))  # turned[j] is column j of the inverse of L
    for j in range(k):
        turned[j, j] = 1.0 / low[j, j]
        for i in range(j + 1, k):
            s = 0.0
            for m in range(j, i):
                s -= low[i, m] * turned[j, m]
            turned[j, i] = s / low[i, i]
    found = np.zeros((k, k))
    for i in range(k):
        for j in range(i + 1):
            s = 0.0
            for m in range(i, k):
                s += turned[i, m] * turned[j, m]
            found[i, j] = s
            found[j, i] = s
    return found
