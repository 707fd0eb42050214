"""What a fit promises that is linearised: the cost that further columns of slopes save, alone and together.

Columns (windows, rows, n) say how the errors move, the windows' shifts eliminated. They stand beside the unknowns that
a fit has, which may move along with them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from greygate.mismatch.fit import Fit
from greygate.mismatch.model import TINY

RIDGE = 1e-10  # of a unit diagonal: keeps a normal matrix regular whose columns depend on each other
BOUND_SLACK = 1e-9  # by which bounds are widened, for the solver needs a low bound below the high one


def index(fit: Fit, symbol: str) -> int:
    """The index of an unknown."""
    return [u.symbol for u in fit.unknowns].index(symbol)


def nothing(fit: Fit) -> np.ndarray:
    """No columns (windows, rows, 0)."""
    return np.zeros((*fit.projected.shape, 0))


def saving(fit: Fit) -> float:
    """The cost that the unknowns alone still save, within their bounds."""
    return solve(fit, nothing(fit), fit.room, fit.weight)[1]


@dataclass(frozen=True)
class Normal:
    """The normal matrix (k + n, k + n) and right side (k + n,) of the unknowns of a fit and of `columns`, no prior."""

    fit: Fit
    matrix: np.ndarray
    right: np.ndarray

    @classmethod
    def of(cls, fit: Fit, columns: np.ndarray) -> "Normal":
        k, n = len(fit.unknowns), columns.shape[2]
        flat, matrix = columns.reshape(fit.projected.size, n), np.empty((k + n, k + n))
        matrix[:k, :k], matrix[k:, k:], matrix[k:, :k] = fit.normal[0], flat.T @ flat, flat.T @ fit.flat
        matrix[:k, k:] = matrix[k:, :k].T
        return cls(fit, matrix, np.append(fit.normal[1], -(flat.T @ fit.projected.reshape(-1))))

    def weighed(self, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Matrix and right side with the prior of the unknowns."""
        k, matrix, right = len(weight), self.matrix.copy(), self.right.copy()
        matrix[np.diag_indices(k)] += weight
        right[:k] -= weight * self.fit.numbers
        return matrix, right


def pair_gains(normal: Normal, widths: Sequence[int]) -> np.ndarray:
    """The cost that every two of m blocks of columns save beside the unknowns, without bounds (m, m).

    widths: how many columns each block has.
    """
    matrix, right, place, own = _blocks(*_beyond(normal, normal.fit.weight)[:2], widths)
    alone = _saved(own, right)
    out = np.empty((len(widths), len(widths)))
    for i in range(len(widths)):
        across = matrix[place[:, :, None], place[i]]
        by = across @ np.linalg.inv(own[i])
        rest, pull = own - by @ np.swapaxes(across, 1, 2), right - by @ right[i]
        out[i] = alone[i] + _saved(rest, pull)
    return out


def released_gains(normal: Normal, widths: Sequence[int], released: int) -> np.ndarray:
    """The cost that each of m blocks saves together with an unknown freed of its prior, without bounds (m,).

    released: the index of that unknown. The gain is beyond what all unknowns save with their priors.
    """
    fit = normal.fit
    weight, prior = fit.weight.copy(), float(fit.weight[released] * fit.numbers[released] ** 2)
    with_prior = _beyond(normal, weight)[2]
    weight[released] = 0.0
    matrix, right, saved = _beyond(normal, weight)
    _, right, _, own = _blocks(matrix, right, widths)
    return _saved(own, right) + saved + prior - with_prior


def _beyond(normal: Normal, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """(normal matrix (n, n) and right side (n,) of the columns, the unknowns eliminated; what those save alone).

    Each column is of unit length.
    """
    k = len(weight)
    matrix, right = normal.weighed(weight)
    scale = np.sqrt(np.maximum(np.diag(matrix), TINY))
    matrix, right = matrix / np.outer(scale, scale), right / scale
    known = np.linalg.solve(matrix[:k, :k] + RIDGE * np.eye(k), np.column_stack([matrix[:k], right[:k]]))
    saved = float(right[:k] @ known[:, -1])
    return matrix[k:, k:] - matrix[k:, :k] @ known[:, k:-1], right[k:] - matrix[k:, :k] @ known[:, -1], saved


def _blocks(normal: np.ndarray, right: np.ndarray, widths: Sequence[int]) -> tuple[np.ndarray, ...]:
    """(normal matrix, right sides (m, w), place (m, w) of each block's columns there, own normal matrices (m, w, w)).

    w: columns of the widest block; a narrow one is filled up with zeros.
    """
    m, w = len(widths), max(widths)
    place = np.full((m, w), len(right))
    for i, (end, width) in enumerate(zip(np.cumsum(widths), widths, strict=True)):
        place[i, :width] = np.arange(end - width, end)
    normal, right = np.pad(normal, (0, 1)), np.pad(right, (0, 1))[place]
    return normal, right, place, normal[place[:, :, None], place[:, None, :]] + RIDGE * np.eye(w)


def _saved(own: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The cost that each block saves (m,), by its normal matrix (m, w, w) and right side (m, w)."""
    return np.einsum("mw,mw->m", right, np.linalg.solve(own, right[:, :, None])[:, :, 0])


def solve(fit: Fit, columns: np.ndarray, bounds: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, float]:
    """(step of the unknowns and of `columns`, cost that it saves): the linearised fit within `bounds` (k + n, 2)."""
    normal, right = Normal.of(fit, columns).weighed(weight)
    scale = np.sqrt(np.maximum(np.diag(normal), TINY))
    normal, right = normal / np.outer(scale, scale), right / scale
    root = np.linalg.cholesky(normal + RIDGE * np.eye(len(normal)))
    low, high = (bounds * scale[:, None]).T
    inner = np.linalg.solve(root, right)
    found = np.linalg.solve(root.T, inner)
    if not np.all((low <= found) & (found <= high)):
        found = lsq_linear(root.T, inner, (low - BOUND_SLACK, high + BOUND_SLACK)).x
    return found / scale, float(2 * right @ found - found @ normal @ found)
