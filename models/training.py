"""Levenberg-Marquardt for any network, feedback included, with exact derivatives through time."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from time import monotonic

import numpy as np
import scipy.linalg
from threadpoolctl import threadpool_limits

from greygate.errors import InputError
from greygate.models.network import Network
from greygate.models.problem import Problem, Record


class Outcome(Enum):
    """How a training ended, as a sentence."""

    CONVERGED = "The loss no longer falls: converged."
    REACHED = "The loss that was asked for is reached."
    EPOCHS = "All epochs are used; the loss was still falling."
    TIME = "Out of time; these are the best weights so far."
    INTERRUPTED = "Interrupted; these are the best weights so far."
    STALLED = "No step lowers the loss: stalled at a point that may be no minimum."


@dataclass(frozen=True)
class Fit:
    """A trained network. history: loss J after each epoch, J = (1/2N) sum e^2 + (1/2N) theta' D theta, normalised."""

    network: Network
    outcome: Outcome
    history: tuple[float, ...]
    seconds: float


class _Whole:
    """A network on its records together with modules of it on records of their own, over one theta."""

    def __init__(self, network: Network, records: list[Record], teacher: bool, free: Mapping | None, rehearse: Mapping):
        if not records:
            raise InputError(f"network {network.name}: no records to train on")
        self.main = Problem(network, records, teacher, free)
        self.parts = []
        place = self.main.slices()
        position = np.full(len(self.main.theta), -1)
        position[self.main.free] = np.arange(len(self.main.free))
        for path, record in rehearse.items():
            part = Problem(_module(network, path), [record])
            index = np.concatenate([place[f"{path}.{n}"] for n in part.slices()])
            moving = np.flatnonzero(position[index[part.free]] >= 0)
            self.parts.append((part, index, moving, position[index[part.free]][moving]))

    def loss(self, theta: np.ndarray, decay: float) -> float:
        """J = (1/2N) (sum e^2 + rehearsal's weighted sum e^2 + decay theta' theta); inf where a run diverges."""
        squares = self.main.squares(theta) + sum(part.squares(theta[index]) for part, index, _, _ in self.parts)
        value = (squares + decay * float(np.sum(theta[self.main.free] ** 2))) / (2 * self.main.samples)
        return value if np.isfinite(value) else np.inf

    def normal_equations(self, theta: np.ndarray, decay: float) -> tuple[np.ndarray, np.ndarray]:
        hessian, gradient = self.main.normal_equations(theta)
        for part, index, moving, where in self.parts:
            h, g = part.normal_equations(theta[index])
            hessian[np.ix_(where, where)] += h[np.ix_(moving, moving)]
            gradient[where] += g[moving]
        hessian[np.diag_indices_from(hessian)] += decay
        return hessian, gradient + decay * theta[self.main.free]


def _module(network: Network, path: str) -> Network:
    for name in path.split("."):
        network = getattr(network, "modules", {}).get(name)
        if not isinstance(network, Network):
            raise InputError(f"cannot rehearse {path}: {name} is not a network with ports of its own")
    return network


def train(
    network: Network,
    records: list[Record],
    *,
    teacher: bool = False,
    epochs: int = 100,
    decay: float = 0.0,
    rehearse: Mapping[str, Record] | None = None,
    goal: float = 0.0,
    seconds: float = np.inf,
    tolerance: float = 1e-7,
    free: Mapping | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> Fit:
    """Levenberg-Marquardt (Marquardt 1963; Nielsen's damping). The trained network is flat.

    decay: D of the loss, one number for every free weight (biases included). goal: stop at this loss.
    rehearse: module path -> a record of its own ports, weighted by `Record.weight`: parts that were right stay right
    where `records` do not reach.
    tolerance: relative fall over ten epochs below which it has converged. progress: called with (epoch, loss).
    Ctrl-C keeps the best weights so far.
    """
    began = monotonic()
    with threadpool_limits(1, "blas"):  # two BLAS threads are slower than one on matrices this small
        whole = _Whole(network, records, teacher, free, rehearse or {})
        problem = whole.main
        theta = problem.theta.copy()
        loss = whole.loss(theta, decay)
        if not np.isfinite(loss):
            raise InputError(
                f"network {network.name}: diverges with its initial weights; start from a NARX fit or smaller weights"
            )
        history, damping, growth, outcome = [loss], 1e-3, 2.0, Outcome.EPOCHS
        best = theta.copy()
        try:
            for epoch in range(epochs):
                hessian, gradient = whole.normal_equations(theta, decay)
                scale = np.diag(hessian).copy() + 1e-12 * np.trace(hessian) / len(hessian) + 1e-300
                while True:
                    try:
                        factor = scipy.linalg.cho_factor(hessian + np.diag(damping * scale), check_finite=False)
                        step = -scipy.linalg.cho_solve(factor, gradient, check_finite=False)
                    except scipy.linalg.LinAlgError:
                        step = None
                    if step is not None and np.isfinite(step).all():
                        trial = theta.copy()
                        trial[problem.free] += step
                        value = whole.loss(trial, decay)
                        expected = 0.5 * float(step @ (damping * scale * step - gradient)) / problem.samples
                        ratio = (loss - value) / expected if expected > 0 else -1.0
                        if value < loss:
                            break
                    damping *= growth
                    growth *= 2
                    if damping > 1e12:
                        break
                if damping > 1e12:
                    outcome = (
                        Outcome.CONVERGED
                        if np.linalg.norm(gradient) < 1e-6 * np.sqrt(loss) * len(gradient)
                        else Outcome.STALLED
                    )
                    break
                theta, loss, growth = trial, value, 2.0
                best = theta
                damping = max(damping * max(1 / 3, 1 - (2 * ratio - 1) ** 3), 1e-15)
                history.append(loss)
                if progress:
                    progress(epoch + 1, loss)
                if loss <= goal:
                    outcome = Outcome.REACHED
                    break
                if len(history) > 10 and history[-11] - loss < tolerance * loss:
                    outcome = Outcome.CONVERGED
                    break
                if monotonic() - began > seconds:
                    outcome = Outcome.TIME
                    break
        except KeyboardInterrupt:
            outcome = Outcome.INTERRUPTED
        return Fit(problem.unpack(best), outcome, tuple(history), monotonic() - began)
