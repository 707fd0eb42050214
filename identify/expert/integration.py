"""How a sample of a plant becomes layers: exact for what is linear in its states, in stages for the rest.

Over a substep of h seconds the states obey s' = A s + n. With n held, s moves by its exponential, which is exact;
in the second order, the change of n over the substep counts too (exponential Runge-Kutta methods ETD1 and ETD2RK; Cox
and Matthews, Journal of Computational Physics 176, 2002, section 2).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm, matrix_balance

ROUNDING = 1e-13  # of the largest entry of an exponential, below which one is the rounding of 0, or of 1
UNSTABLE = 2.0  # turns of the fastest term in a substep, from which an explicit step grows


@dataclass(frozen=True)
class Scheme:
    """substeps of a sample; second: of second order, which evaluates what is not linear twice in each."""

    substeps: int = 1
    second: bool = False

    @property
    def evaluations(self) -> int:
        return self.substeps * (2 if self.second else 1)

    def __str__(self) -> str:
        steps = "one step" if self.substeps == 1 else f"{self.substeps} substeps"
        return f"{steps} a sample, of {'second' if self.second else 'first'} order"


SCHEMES = tuple(
    sorted(
        (Scheme(n, second) for n in (1, 2, 3, 4, 6, 8, 12, 16) for second in (False, True) if not (second and n > 8)),
        key=lambda scheme: scheme.evaluations,
    )
)
"""Cheapest first."""


@dataclass(frozen=True)
class Step:
    """Of a substep: s + own s, by held n: first n, by its change: second (n' - n). Each (n, n)."""

    own: np.ndarray
    first: np.ndarray
    second: np.ndarray


def step(a: np.ndarray, h: float) -> Step:
    """own = exp(A h), first = h phi_1(A h), second = h phi_2(A h). a: (n, n), in 1/s; h: s."""
    n = len(a)
    alike, (size, _) = matrix_balance(a, permute=False, separate=True)  # else a pascal rounds what a metre does
    whole = np.zeros((3 * n, 3 * n))
    whole[:n, :n], whole[:n, n : 2 * n], whole[n : 2 * n, 2 * n :] = alike * h, np.eye(n), np.eye(n)
    moved, units = expm(whole), size[:, None] / size
    own, first, second = (_clean(moved[:n, i * n : (i + 1) * n]) * units for i in range(3))
    return Step(own, first * h, second * h)


def _clean(matrix: np.ndarray) -> np.ndarray:
    """The matrix without the rounding of what is 0 or 1: a state that only adds up must not leak."""
    small = ROUNDING * np.abs(matrix).max()
    matrix = np.where(np.abs(matrix) < small, 0.0, matrix)
    return np.where(np.abs(matrix - 1.0) < small, 1.0, matrix)
