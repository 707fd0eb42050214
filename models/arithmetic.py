"""Float arithmetic that comes out the same, to the bit, on every processor.

A build must be a function of its inputs. Where floats decide integers on the way to it (the free run that every pass
sees, merged weights, ranges, means, tables) they come from here: IEEE 754 additions, multiplications and divisions in
an order that stands in the program, and what is exact by definition (floor, powers of two). Numpy's element-wise
operations and numba without `fastmath` keep to that: they neither reorder nor contract. What does not: BLAS and LAPACK
(`@`, `linalg`), whose kernels and threads each add in their own order, and exp, tanh, sin and pow of numpy and of the C
library, which differ in the last bit between AVX512, FMA and neither.
"""

from types import SimpleNamespace

import numba
import numpy as np

from greygate.models import scalars

_exp = numba.vectorize(nopython=True, cache=True)(scalars.exp.py_func)
_tanh = numba.vectorize(nopython=True, cache=True)(scalars.tanh.py_func)


def exp(x: np.ndarray) -> np.ndarray:
    """`scalars.exp` of every element."""
    with np.errstate(over="ignore", invalid="ignore"):  # what is infinite or NaN stays so, and is no news
        return _exp(x)


def tanh(n: np.ndarray) -> np.ndarray:
    """`scalars.tanh` of every element."""
    with np.errstate(over="ignore", invalid="ignore"):
        return _tanh(n)


xp = SimpleNamespace(exp=exp, tanh=tanh, where=np.where, clip=np.clip, ones_like=np.ones_like, zeros_like=np.zeros_like)
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
