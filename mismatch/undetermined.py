"""How uncertain parameters are that a recording knows together only: mass, force and friction to a common factor.

The data sheet's errors need not be independent: where all of them come from one weighing, all are off by one factor. So
a number's deviation is the farthest it can go, the others moving with it, while no number leaves its own deviation on
the data sheet and the errors grow by no more than one unit of cost:

    maximise n_j,    n' H n <= 1,    |n_i| <= prior_i
"""

import numpy as np
from scipy.optimize import lsq_linear

DETERMINED = 25.0  # of information, in units of the priors': above it a prior moves no deviation by more than 2 %
HALVINGS = 12  # of the way between two deviations
RIDGE = 1e-12  # of the largest entry, added to a diagonal that may be singular


def deviations(information: np.ndarray, weight: np.ndarray, independent: np.ndarray) -> np.ndarray:
    """Standard deviations of numbers (k,) whose priors may err together; none is below `independent`.

    information: of the recording alone, without priors (k, k). weight: of each number's square in the cost, 0 where
    nothing is known beforehand (k,). independent: the deviations if the priors' errors are independent (k,).
    """
    if not weight.any() or _determined(information, weight):
        return independent
    box = np.divide(1.0, np.sqrt(weight), out=np.full(len(weight), np.inf), where=weight > 0)
    values, vectors = np.linalg.eigh(information)
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    most = np.minimum(independent * np.sqrt(len(weight)), box)
    return np.array([_farthest(root, box, j, *ends) for j, ends in enumerate(zip(independent, most, strict=True))])


def _determined(information: np.ndarray, weight: np.ndarray) -> bool:
    """Whether the recording knows all that has a prior much better than that."""
    known, free = weight > 0, weight == 0
    own, across, rest = (information[np.ix_(a, b)] for a, b in ((known, known), (known, free), (free, free)))
    own = own - across @ np.linalg.pinv(rest, hermitian=True) @ across.T
    scale = 1.0 / np.sqrt(weight[known])
    return bool(np.linalg.eigvalsh(own * np.outer(scale, scale)).min() > DETERMINED)


def _farthest(root: np.ndarray, box: np.ndarray, j: int, low: float, high: float) -> float:
    """The largest size in [low, high] of number j for which the others, in the box, keep |root n| within 1."""
    others = np.arange(len(box)) != j
    ridge = np.sqrt(RIDGE * np.abs(root).max() ** 2) * np.eye(others.sum())
    columns, limits = np.vstack([root[:, others], ridge]), box[others] * (1.0 + RIDGE)

    def possible(size: float) -> bool:
        moved = np.concatenate([root[:, j] * size, np.zeros(others.sum())])
        return not others.any() or 2.0 * lsq_linear(columns, -moved, (-limits, limits)).cost <= 1.0

    for _ in range(HALVINGS if high > low else 0):
        middle = (low + high) / 2
        low, high = (middle, high) if possible(middle) else (low, middle)
    return low
