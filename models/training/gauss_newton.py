"""Damped Gauss-Newton within bounds, for the training of networks and for the fit of a plant's parameters.

Both minimise a sum of squares. A step solves (J'J + damping D) step = -J'e; where it does not lower the cost, the
damping rises and a shorter step is tried. This search and the step within bounds are the same in both. What differs is
D, what a step costs, and therefore the rule by which the damping rises and falls.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

Trial = TypeVar("Trial")

LARGEST, SMALLEST = 1e12, 1e-15  # of Nielsen's damping: beyond them a step, or the damping in it, is lost in rounding
DECADE = 10.0
FIRST, LAST = 1e-2, 1e-3  # damping by decades: the first that shortens a step visibly, the last that does
IN_VAIN = 1e8  # damping by decades: a step so short gains no cost that is worth a simulation


class Damping(Protocol):
    """How much shorter than Gauss-Newton's a step is, and turned downhill: 0 is Gauss-Newton's own."""

    value: float

    def rise(self) -> bool:
        """After a step that does not lower the cost. False where a yet shorter one would be lost in rounding."""


@dataclass
class Nielsen:
    """Damping that follows how well the linear model predicts the cost (Nielsen 1999).

    For a model that is linearised anew at every step. The damping falls without jumps, and rises ever faster while no
    step lowers the cost.
    """

    value: float = 1e-3
    growth: float = 2.0

    def rise(self) -> bool:
        self.value *= self.growth
        self.growth *= 2
        return self.value <= LARGEST

    def fall(self, ratio: float) -> None:
        """After a step that lowers the cost, by `ratio` of what the linear model predicted."""
        self.value = max(self.value * max(1 / 3, 1 - (2 * ratio - 1) ** 3), SMALLEST)
        self.growth = 2.0


@dataclass
class Decades:
    """No damping at first, then by factors of ten (Marquardt 1963).

    For a model that is dear to linearise and keeps its linearisation while that serves: near the minimum every step is
    Gauss-Newton's own.
    """

    value: float = 0.0

    def rise(self) -> bool:
        self.value = max(self.value * DECADE, FIRST)
        return self.value < IN_VAIN

    def fall(self) -> None:
        """After a step that lowers the cost."""
        self.value = self.value / DECADE if self.value > LAST else 0.0


def search(attempt: Callable[[float], Trial | None], damping: Damping) -> Trial | None:
    """What the first attempt gives that is not None, with rising damping. None if the damping can rise no further."""
    while (found := attempt(damping.value)) is None:
        if not damping.rise():
            return None
    return found


def bounded(
    x: np.ndarray, gradient: np.ndarray, low: np.ndarray, high: np.ndarray, step: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """The point that a step leads to from x (n,) within bounds: a projected Newton step (Bertsekas 1982).

    A variable at a bound does not move if the cost falls beyond that bound. step: takes the indices of the variables
    that move and gives the step of each, the others fixed. What leads out of the bounds is cut off.
    """
    fixed = ((x <= low) & (gradient > 0)) | ((x >= high) & (gradient < 0))
    moving = np.flatnonzero(~fixed)
    end = x.copy()
    end[moving] += step(moving)
    return np.clip(end, low, high)
