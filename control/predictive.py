"""Nonlinear model predictive control in real-time iteration (Diehl, Bock, Schlöder 2005).

At every sample one Gauss-Newton step of

    min  sum_i ((y_i - r_i) / tolerance)^2 + smooth sum_m (change of the input between knots / rate)^2 + slack
    with u within its limits, its rate within its own, y within soft limits

by a quadratic program (OSQP), whose derivatives are exact (`Prediction`). Then the plan moves on by a sample. Limits of
the input are hard, those of outputs are soft: the program always has a solution.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from greygate.control.prediction import Prediction, State
from greygate.errors import InputError

EXACT = 1.0  # times the most that tracking gains by a violation: there is none where none is needed
TINY = 1e-300  # keeps a ratio finite where an output does not depend on the input
SOFT = 1.0  # weight of the square of a violation, over that of the tracking error that the same input makes


@dataclass(frozen=True)
class Limits:
    """low, high: of the input, in its unit. rate: its largest change between samples. resolution: of the actuator.

    outputs: port -> (low, high), kept where that is possible. Raises InputError for an empty range.
    """

    low: float
    high: float
    rate: float = np.inf
    resolution: float = 0.0
    outputs: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, (low, high) in {"input": (self.low, self.high), **self.outputs}.items():
            if not low < high:
                raise InputError(f"limits of {name}: {low} to {high}; give a lower limit below the upper one")
        if not self.rate > 0:
            raise InputError(f"rate {self.rate}: give a change between samples above 0")

    def kept(self, wanted: float, before: float) -> float:
        """What the actuator makes of an input, the one before being known."""
        return float(np.clip(wanted, max(self.low, before - self.rate), min(self.high, before + self.rate)))


@dataclass(frozen=True)
class Aim:
    """output: the port that tracks. tolerance: its error that counts as one, in its unit. smooth: what a change of the
    input by its rate, over the horizon, counts in the same measure."""

    output: str
    tolerance: float
    smooth: float


class Predictive:
    """The controller. `plan` holds the input at the knots, normalised; `solved` whether the last program was.

    Raises InputError where OSQP is not installed, or a port is not an output of the model.
    """

    def __init__(self, prediction: Prediction, aim: Aim, limits: Limits, every: int = 1):
        """every: of how many steps one is held to the limits of outputs."""
        try:
            import osqp
        except ImportError:
            raise InputError("osqp is not installed; pip install 'greygate[control]'") from None
        self.prediction, self.aim, self.limits = prediction, aim, limits
        ports = {p.name: (i, p) for i, p in enumerate(prediction.flat.outputs)}
        for name in (aim.output, *limits.outputs):
            if name not in ports:
                raise InputError(f"{name} is no output of network {prediction.flat.name}; it has {', '.join(ports)}")
        self._tracked, self._port = ports[aim.output]
        self._bounded = [ports[name] for name in limits.outputs]
        self._rows = np.arange(every - 1, prediction.steps, every)
        basis = prediction.basis
        self._moved_on = np.linalg.lstsq(basis, np.vstack([basis[1:], basis[-1:]]), rcond=None)[0]
        drive = prediction.port
        self._low, self._high = sorted(drive.normalised(v) for v in (limits.low, limits.high))
        self._rate = limits.rate / abs(drive.scale)
        self._assemble(osqp)
        self.reset()

    def reset(self) -> None:
        rest = self.prediction.port.rest
        self.plan = np.full(self.prediction.basis.shape[1], rest)
        self.before = rest
        self.solved = True

    # ---- the quadratic program: variables are the step of the plan and one violation for each limited output

    def _assemble(self, osqp: Any) -> None:
        knots = self.prediction.basis.shape[1]
        self._gaps = np.diff([-1, *np.argmax(self.prediction.basis, axis=0)]).astype(float)
        self._difference = np.eye(knots) - np.eye(knots, k=-1)
        self._step = self.aim.tolerance / abs(self._port.scale)
        self._weight = 1.0 / self._step**2
        rate = self._rate if np.isfinite(self._rate) else self._high - self._low
        change = self._difference / (rate * np.sqrt(self._gaps))[:, None]
        self._smooth = self.aim.smooth * change.T @ change
        self._first = self.aim.smooth * change[0] / (rate * np.sqrt(self._gaps[0]))
        self._size = knots + len(self._bounded)
        self._solver: Any = None
        self._osqp = osqp

    def __call__(self, state: State, reference: np.ndarray) -> float:
        """The input now [its unit]. state: of the model. reference: (steps,) [unit of the output] of the next steps."""
        p = self.prediction
        p.start(state)
        outputs = p.run(self.plan)
        if not np.isfinite(outputs).all():
            self.plan = np.full_like(self.plan, self.before)
            outputs = p.run(self.plan)
        self._solve(outputs, p.derivatives(), self._port.normalised(reference))
        wanted = float(p.basis[0] @ self.plan) * p.port.scale + p.port.offset
        self.plan = self._moved_on @ self.plan
        return wanted

    def applied(self, value: float) -> None:
        """Tell what the actuator made of the input [its unit]."""
        self.before = self.prediction.port.normalised(value)

    def _solve(self, outputs: np.ndarray, slopes: np.ndarray, reference: np.ndarray) -> None:
        j = slopes[:, self._tracked]
        knots, violations = len(self.plan), len(self._bounded)
        hessian = np.zeros((self._size, self._size))
        hessian[:knots, :knots] = self._weight * j.T @ j + self._smooth
        gradient = np.empty(self._size)
        error = outputs[:, self._tracked] - reference
        gradient[:knots] = self._weight * j.T @ error + self._smooth @ self.plan
        gradient[:knots] -= self._first * self.before
        for i, (column, _) in enumerate(self._bounded, knots):
            ratio = np.abs(j).max() / max(np.abs(slopes[:, column]).max(), TINY)
            gradient[i] = EXACT * self._weight * ratio * (np.abs(error).sum() + self._step)
            hessian[i, i] = SOFT * self._weight * ratio**2
        rows, low, high = [np.eye(knots), self._difference], [self._low - self.plan], [self._high - self.plan]
        change = self._difference @ self.plan
        change[0] -= self.before
        low.append(-self._rate * self._gaps - change)
        high.append(self._rate * self._gaps - change)
        matrix = [np.hstack([np.vstack(rows), np.zeros((2 * knots, violations))])]
        for i, (column, port) in enumerate(self._bounded):
            bounds = sorted(port.normalised(v) for v in self.limits.outputs[port.name])
            now, slope = outputs[self._rows, column], slopes[self._rows, column]
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
