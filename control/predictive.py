"""Nonlinear model predictive control in real-time iteration (Diehl, Bock, Schlöder 2005).

At every sample one Gauss-Newton step of

    min  sum_i ((y_i - r_i) / tolerance)^2 + smooth sum_m (change of the input between knots / rate)^2 + slack
    with u within its limits, its rate within its own, y within soft limits

by a quadratic program (OSQP), over all outputs that track and all inputs. Then the plan moves on by a sample. Limits of
the input are hard, those of outputs are soft: the program always has a solution.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from greygate.errors import InputError, brought_by
from greygate.models.network import Port

EXACT = 1.0  # times the most that tracking gains by a violation: there is none where none is needed
TINY = 1e-300  # keeps a ratio finite where an output does not depend on the input
SOFT = 1.0  # weight of the square of a violation, over that of the tracking error that the same input makes


@dataclass(frozen=True)
class Limits:
    """low, high: of the input, in its unit. rate: its largest change between samples. resolution: of the actuator.

    Each is a number, or (inputs,) where there are several. outputs: port -> (low, high), kept where that is possible.
    Raises InputError for an empty range.
    """

    low: Any
    high: Any
    rate: Any = np.inf
    resolution: Any = 0.0
    outputs: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, (low, high) in {"input": (self.low, self.high), **self.outputs}.items():
            if not np.all(np.less(low, high)):
                raise InputError(f"limits of {name}: {low} to {high}; give a lower limit below the upper one")
        if not np.all(np.greater(self.rate, 0)):
            raise InputError(f"rate {self.rate}: give a change between samples above 0")

    def kept(self, wanted: Any, before: Any) -> Any:
        """What the actuator makes of the input, or of the inputs (inputs,), those before being known."""
        kept = np.clip(wanted, np.maximum(self.low, before - self.rate), np.minimum(self.high, before + self.rate))
        return kept if np.ndim(kept) else float(kept)


@dataclass(frozen=True)
class Aim:
    """output: the port that tracks. tolerance: its error that counts as one, in its unit. smooth: what a change of the
    input by its rate, over the horizon, counts in the same measure."""

    output: str
    tolerance: float
    smooth: float


class Predicting(Protocol):
    """What outputs will be for a plan of the inputs. basis: (steps, knots). A plan is (inputs * knots,), normalised."""

    name: str
    drives: list[Port]
    outputs: list[Port]
    basis: np.ndarray

    def start(self, state: Any) -> None:
        """Begin from a state."""

    def run(self, plan: np.ndarray) -> np.ndarray:
        """(steps, outputs), normalised; NaN from where they are no longer finite."""

    def derivatives(self) -> np.ndarray:
        """(steps, outputs, inputs * knots) of the last run."""


def solver() -> Any:
    """The package OSQP. Raises InputError where it is not installed."""
    with brought_by("control", "osqp"):
        import osqp
    return osqp


class Predictive:
    """The controller. `plan` holds the inputs at the knots, normalised; `solved` whether the last program was.

    Raises InputError where OSQP is not installed, or a port is not an output of the model.
    """

    def __init__(self, prediction: Predicting, aim: Aim | Sequence[Aim], limits: Limits, every: int = 1):
        """aim: several where several outputs track. every: of how many steps one is held to the limits of outputs."""
        osqp = solver()
        self.prediction, self.limits = prediction, limits
        self.aims = [aim] if isinstance(aim, Aim) else list(aim)
        ports = {p.name: (i, p) for i, p in enumerate(prediction.outputs)}
        for name in (*(a.output for a in self.aims), *limits.outputs):
            if name not in ports:
                raise InputError(f"{name} is no output of network {prediction.name}; it has {', '.join(ports)}")
        self._tracked = [ports[a.output] for a in self.aims]
        self._bounded = [ports[name] for name in limits.outputs]
        basis, self._single = prediction.basis, np.ndim(limits.low) == 0
        self._rows = np.arange(every - 1, len(basis), every)
        moved_on = np.linalg.lstsq(basis, np.vstack([basis[1:], basis[-1:]]), rcond=None)[0]
        self._moved_on = np.kron(np.eye(len(prediction.drives)), moved_on)
        self._assemble(osqp)
        self.reset()

    def reset(self) -> None:
        self.before = np.array([p.rest for p in self.prediction.drives])
        self.plan = np.repeat(self.before, self.prediction.basis.shape[1])
        self.solved = True

    # ---- the quadratic program: variables are the step of the plan and one violation for each limited output

    def _assemble(self, osqp: Any) -> None:
        steps, drives = self.prediction.basis.shape[1], self.prediction.drives
        knots, of = steps * len(drives), np.arange(len(drives)).repeat(steps)
        gaps = np.diff([-1, *np.argmax(self.prediction.basis, axis=0)]).astype(float)
        self._first = np.arange(len(drives)) * steps  # the first knot of each input
        self._difference = np.kron(np.eye(len(drives)), np.eye(steps) - np.eye(steps, k=-1))
        scale, offset = (np.array([getattr(p, n) for p in drives]) for n in ("scale", "offset"))
        ends = np.sort([(v - offset) / scale for v in (self.limits.low, self.limits.high)], axis=0)
        self._low, self._high = ends[0][of], ends[1][of]
        rate = np.broadcast_to(self.limits.rate / np.abs(scale), len(drives))[of]
        self._most = rate * np.tile(gaps, len(drives))
        self._steps = [a.tolerance / abs(p.scale) for a, (_, p) in zip(self.aims, self._tracked, strict=True)]
        finite = np.where(np.isfinite(rate), rate, self._high - self._low)
        change = self._difference / (finite * np.sqrt(np.tile(gaps, len(drives))))[:, None]
        self._smooth = self.aims[0].smooth * change.T @ change
        self._pulled = (self.aims[0].smooth * change / (finite * np.sqrt(np.tile(gaps, len(drives))))[:, None])[
            self._first
        ]
        self._size = knots + len(self._bounded)
        self._solver: Any = None
        self._osqp = osqp

    def __call__(self, state: Any, reference: np.ndarray) -> Any:
        """The input now [its unit]; (inputs,) where there are several.

        state: of the model. reference: (steps,) or (steps, outputs that track) [their units] of the next steps.
        """
        p = self.prediction
        p.start(state)
        outputs = p.run(self.plan)
        if not np.isfinite(outputs).all():
            self.plan = np.repeat(self.before, p.basis.shape[1])
            outputs = p.run(self.plan)
        columns = np.reshape(reference, (len(reference), -1)).T
        self._solve(
            outputs, p.derivatives(), [q.normalised(r) for (_, q), r in zip(self._tracked, columns, strict=True)]
        )
        now = [float(p.basis[0] @ part) for part in np.split(self.plan, len(p.drives))]
        wanted = [v * q.scale + q.offset for q, v in zip(p.drives, now, strict=True)]
        self.plan = self._moved_on @ self.plan
        return wanted[0] if self._single else np.array(wanted)

    def applied(self, value: Any) -> None:
        """Tell what the actuators made of the inputs [their units]."""
        self.before = np.array(
            [p.normalised(v) for p, v in zip(self.prediction.drives, np.atleast_1d(value), strict=True)]
        )

    def _solve(self, outputs: np.ndarray, slopes: np.ndarray, references: Sequence[np.ndarray]) -> None:
        knots, violations = len(self.plan), len(self._bounded)
        hessian, gradient = np.zeros((self._size, self._size)), np.zeros(self._size)
        for (column, _), one, reference in zip(self._tracked, self._steps, references, strict=True):
            j, error, weight = slopes[:, column], outputs[:, column] - reference, 1.0 / one**2
            hessian[:knots, :knots] += weight * j.T @ j
            gradient[:knots] += weight * j.T @ error
            for i, (limited, _) in enumerate(self._bounded, knots):
                ratio = np.abs(j).max() / max(np.abs(slopes[:, limited]).max(), TINY)
                gradient[i] += EXACT * weight * ratio * (np.abs(error).sum() + one)
                hessian[i, i] += SOFT * weight * ratio**2
        hessian[:knots, :knots] += self._smooth
        gradient[:knots] += self._smooth @ self.plan
        gradient[:knots] -= self.before @ self._pulled
        rows, low, high = [np.eye(knots), self._difference], [self._low - self.plan], [self._high - self.plan]
        change = self._difference @ self.plan
        change[self._first] -= self.before
        low.append(-self._most - change)
        high.append(self._most - change)
        matrix = [np.hstack([np.vstack(rows), np.zeros((2 * knots, violations))])]
        for i, (limited, port) in enumerate(self._bounded):
            bounds = sorted(port.normalised(v) for v in self.limits.outputs[port.name])
            now, slope = outputs[self._rows, limited], slopes[self._rows, limited]
            slack = np.zeros((len(now), violations))
            slack[:, i] = 1.0
            matrix += [np.hstack([slope, slack]), np.hstack([slope, -slack])]
            low += [bounds[0] - now, np.full(len(now), -np.inf)]
            high += [np.full(len(now), np.inf), bounds[1] - now]
        if violations:
            matrix.append(np.hstack([np.zeros((violations, knots)), np.eye(violations)]))
            low.append(np.zeros(violations))
            high.append(np.full(violations, np.inf))
        step = self._minimum(hessian, gradient, np.vstack(matrix), np.concatenate(low), np.concatenate(high))
        self.plan = np.clip(self.plan + step[:knots], self._low, self._high)

    def _minimum(self, hessian, gradient, matrix, low, high) -> np.ndarray:
        from scipy import sparse

        if not all(np.isfinite(part).all() for part in (hessian, gradient, matrix)):  # of which OSQP prints to stdout
            self.solved = False
            return np.zeros(self._size)
        scale = 1.0 / max(float(np.abs(hessian).max()), 1.0)
        if self._solver is None:
            full = np.ones_like(matrix)
            self._solver = self._osqp.OSQP()
            shape = sparse.csc_matrix(np.triu(np.ones_like(hessian)))
            shape.data = self._column_major(scale * hessian)
            constraint = sparse.csc_matrix(full)
            constraint.data = matrix.ravel(order="F").copy()
            self._solver.setup(
                shape, scale * gradient, constraint, low, high,
                verbose=False, eps_abs=1e-6, eps_rel=1e-6, max_iter=2000, polishing=False, warm_starting=True,
            )  # fmt: skip
        else:
            self._solver.update(
                Px=self._column_major(scale * hessian), q=scale * gradient, Ax=matrix.ravel(order="F"), l=low, u=high
            )
        found = self._solver.solve(raise_error=False)
        self.solved = found.info.status_val in (1, 2)
        return found.x if self.solved else np.zeros(self._size)

    def _column_major(self, hessian: np.ndarray) -> np.ndarray:
        """The upper triangle, column by column."""
        columns, rows = np.tril_indices(self._size)
        return hessian[rows, columns]
