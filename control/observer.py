"""The state of a model beside the plant: Kalman filters, a stationary one of a network and an extended one of any."""

from collections.abc import Mapping

import numpy as np
from scipy.linalg import solve_discrete_are

from greygate.control.modelled import Model, derivatives
from greygate.control.prediction import online
from greygate.control.stepping import Floating
from greygate.errors import InputError
from greygate.models.network import Network
from greygate.models.training.kernels import sensitivities

UNKNOWN = 0.01  # of a state's size, by which a plant may stand elsewhere before the first sample
LEAST = 1e-6  # deviation, normalised, of what is said to be exact: the Riccati equation needs some


class Observer(Floating):
    """Runs a model beside the plant and corrects its state by what is measured.

    model: network whose only input is `drive`. measured: output of the model -> standard deviation of what is given for
    it [its unit]; each of these must be a layer that the model reads with a delay. disturbed: layer -> standard
    deviation, normalised, by which it departs from the model at every step; a layer that is not named departs by
    nothing. The gain is that of the model linearised where it rests. Raises InputError for names that the model does
    not have, and where the measured outputs do not tell the state.
    """

    def __init__(self, model: Network, drive: str, measured: Mapping[str, float], disturbed: Mapping[str, float]):
        super().__init__(online(model, drive))
        order = self.flat.order()
        lags = {n: 0 for n in order}
        for c in self.flat.connections:
            if c.source in lags:
                lags[c.source] = max(lags[c.source], c.delay)
        state = [(int(e), lag) for n in order for e in self._place[n] for lag in range(1, lags[n] + 1)]
        self._state = np.array(state, int).reshape(-1, 2)
        self.port = self.flat.inputs[0]
        shown = dict(
            zip((p.name for p in self.flat.outputs), self._tables.rows[self._tables.shown].tolist(), strict=True)
        )
        ports = {p.name: p for p in self.flat.outputs}
        for name in measured:
            if name not in shown or (shown[name], 1) not in state:
                raise InputError(f"network {model.name}: {name} is no output that the model remembers; measure another")
        for name in disturbed:
            if name not in self._remembered:
                raise InputError(f"network {model.name}: {name} is no layer that it remembers: {', '.join(lags)}")
        self.measured = {n: ports[n] for n in measured}
        self._seen = np.array([state.index((shown[n], 1)) for n in measured])
        owner = {int(e): n for n in order for e in self._place[n]}
        deviation = np.array([disturbed.get(owner[e], 0.0) * (lag == 1) for e, lag in state])
        noise = np.array([max(d / abs(ports[n].scale), LEAST) for n, d in measured.items()])
        self._gain = self._stationary(deviation, noise)
        self.reset()

    def _stationary(self, deviation: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """(state, measured): the gain, by the discrete algebraic Riccati equation."""
        t, size = self._tables, len(self._state)
        n = len(self._theta)
        self.advance({self.port.name: self.port.rest})
        carried = np.zeros((t.depth + 1, len(t.rows), n + size))
        slot, row = -self._state[:, 1] % (t.depth + 1), t.row_of[self._state[:, 0]]
        carried[slot, row, n + np.arange(size)] = 1.0
        jacobian = np.zeros((1, len(t.shown), n + size))
        sensitivities(*t, self._theta, self._now, self._now, carried, 0, 1, jacobian)
        step = np.zeros((size, size))
        for i, (element, lag) in enumerate(self._state):
            if lag == 1:
                step[i] = carried[0, t.row_of[element], n:]
            else:
                step[i, int(np.flatnonzero((self._state == (element, lag - 1)).all(axis=1))[0])] = 1.0
        seen = np.eye(size)[self._seen]
        try:
            spread = solve_discrete_are(step.T, seen.T, np.diag(deviation**2 + LEAST**4), np.diag(noise**2))
        except np.linalg.LinAlgError:
            raise InputError(f"network {self.flat.name}: the measured outputs do not tell its state") from None
        return spread @ seen.T @ np.linalg.inv(seen @ spread @ seen.T + np.diag(noise**2))

    def corrected(self, applied: float, measured: Mapping[str, float]) -> dict[str, np.ndarray]:
        """The state now: layer or input -> (lags, size), newest first. applied: what acted since the last step, and
        measured: what is seen now, each in its unit."""
        self.advance({self.port.name: self.port.normalised(applied)})
        rows, columns = len(self._now) - self._state[:, 1], self._state[:, 0]
        now = self._now[rows, columns]
        seen = np.array([p.normalised(measured[n]) for n, p in self.measured.items()])
        self._now[rows, columns] = now + self._gain @ (seen - now[self._seen])
        return self.state()

    def state(self) -> dict[str, np.ndarray]:
        return super().state() | {self.port.name: self._now[::-1, :1].copy()}

    def value(self, layer: str) -> float:
        """Of one layer of size 1, normalised."""
        return float(self._now[-1, self._place[layer][0]])


class Kalman:
    """An extended Kalman filter beside a plant, of what disturbs it at the beginning of every sample:

        x(k+1) = f(x(k) + w(k), u(k)),   y(k+1) = g(x(k) + w(k), u(k)) + v(k+1)

    measured: places of the model's signals -> standard deviation of v. process: (n,), that of w. sizes: (n,), of the
    states, a share `UNKNOWN` of which is not known at first.
    """

    def __init__(self, model: Model, measured: Mapping[int, float], process: np.ndarray, sizes: np.ndarray):
        self.model, self._sizes = model, sizes
        self._rows, self._noise = [*measured], np.diag(np.square([*measured.values()]))
        self._process = np.diag(process**2)
        self.reset()

    def reset(self) -> None:
        self.state = self.model.start.copy()
        self._spread = np.diag((UNKNOWN * self._sizes) ** 2)

    def corrected(self, applied: np.ndarray, measured: np.ndarray) -> np.ndarray:
        """The state now. applied: (inputs,) that acted since the last sample; measured: in the order of `measured`."""
        state, seen, a, c = derivatives(self.model, self.state, applied, self._sizes)
        c, spread = c[self._rows], self._spread + self._process
        off = measured - seen[self._rows]
        certain = c @ spread @ c.T + self._noise
        gain = np.linalg.solve(certain, c @ spread @ a.T).T
        self.state = state + gain @ off
        self._spread = a @ spread @ a.T - gain @ certain @ gain.T
        return self.state
