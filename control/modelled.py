"""A plant or a network as one step of a state, so that a controller can predict it and an observer can correct it.

    x(k+1) = f(x(k), u(k)),   y(k+1) = g(x(k), u(k)):   u(k) acts from sample k to k+1, where y(k+1) is taken

Derivatives are differences: all the runs that they need are one call of the compiled simulation.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from greygate.control.prediction import online
from greygate.errors import InputError
from greygate.models import sampling
from greygate.models.network import Network, Port
from greygate.models.training.kernels import forward
from greygate.models.training.objective import Objective
from greygate.plants.plant import Plant
from greygate.plants.simulator import TIME, Restarted

SHARE = 1e-5  # of a signal's size: the step of a difference, far above rounding and below what is curved
AGREED = 1e-4  # of a state's size: fewer steps of integration than the plant's must come so near


class Model(Protocol):
    """start: (n,), the state at rest. free: (n,), states that may depart from it. Inputs and signals are in their
    units, in the order that it was made with."""

    name: str
    start: np.ndarray
    free: np.ndarray

    def roll(self, states: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(B, n) and (B, steps, inputs) -> the states after them (B, n), the signals after each (B, steps, signals).

        NaN from where a run is no longer finite, and in the runs after it.
        """


class OfPlant:
    """A plant, whose other inputs stay at `held`. `values`: of its parameters; `base`: (inputs,), all that it has.

    signals: states, definitions, inputs. A definition is that of the input that acted, as a sensor sees it before the
    next one acts. Raises InputError for names that the plant does not have, and for one that asks for the time.
    """

    def __init__(self, plant: Plant, drives: Sequence[str], signals: Sequence[str], period: float):
        self.plant, self.name, self.signals = plant, plant.name, list(signals)
        if TIME in plant.inputs:
            raise InputError(f"plant {plant.name}: depends on the time {TIME}, which no controller plans; leave it out")
        known = {*plant.states, *plant.inputs, *(d.symbol for d in plant.definitions.values())}
        for name, among in (*((n, plant.inputs) for n in drives), *((n, known) for n in signals)):
            if name not in among:
                raise InputError(f"plant {plant.name}: has no {name}; it has {', '.join(sorted(among))}")
        self._columns = [list(plant.inputs).index(n) for n in drives]
        self.restarted = Restarted(plant, period, plant.step)
        self.base = np.zeros(len(plant.inputs))
        self.values = {n: p.value for n, p in plant.parameters.items()}
        self.start = np.array([*plant.initial().values()])
        self.free = np.ones(len(self.start), bool)

    def faster(self, states: np.ndarray, inputs: np.ndarray) -> "OfPlant":
        """The same in as few steps of integration as agree with all of them. states: (B, n), inputs: (B, inputs)."""
        model, size = OfPlant(self.plant, [], self.signals, 1.0), np.abs(states).max(axis=0)
        model.__dict__.update(self.__dict__)
        ends, most = self.roll(states, inputs[:, None])[0], self.restarted.substeps
        if self.plant.outside is not None and self.plant.outside.fixed:
            return model
        for steps in (2**i for i in range(most.bit_length() - 1)):
            model.restarted = self.restarted.in_steps(steps)
            if np.all(np.abs(model.roll(states, inputs[:, None])[0] - ends) <= AGREED * size):
                return model
        return self

    def roll(self, states: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        count, steps, _ = inputs.shape
        held = np.tile(self.base, (count, steps + 1, 1))
        held[:, :-1, self._columns] = inputs
        first, reset = np.arange(count) * (steps + 1), np.ones(states.shape[1], bool)
        out = self.restarted.run(held.reshape(-1, held.shape[2]), first, states, reset, self.values)
        out = out.reshape(count, steps + 1, -1)[:, 1:]
        seen = dict(zip(self.plant.states, np.moveaxis(out, 2, 0), strict=True))
        seen |= dict(zip(self.plant.inputs, np.moveaxis(held[:, :-1], 2, 0), strict=True))
        told = self.plant.with_parameters(**self.values).values(self.signals, seen) if self._defined else seen
        return out[:, -1], np.stack([np.broadcast_to(told[n], (count, steps)) for n in self.signals], axis=2)

    @property
    def _defined(self) -> bool:
        return not {*self.signals} <= {*self.plant.states, *self.plant.inputs}


class OfNetwork:
    """A network beside the plant, whose other inputs stay where they rest. Raises InputError as `online`, for outputs
    that it does not have, and for another sample time."""

    def __init__(self, network: Network, drives: Sequence[str], signals: Sequence[str], period: float):
        sampling.check(network, period, f"control with {network.name}", "give a reference of that sample time")
        objective = Objective(online(network, *drives), [])
        flat, self.name, self._theta = objective.flat, network.name, objective.theta
        self._tables, self._place, self._forced = objective.tables, objective.elements(), objective.forced
        ports = {p.name: i for i, p in enumerate(flat.outputs)}
        for name in signals:
            if name not in ports:
                raise InputError(f"{name} is no output of network {network.name}; it has {', '.join(ports)}")
        shown = [p for p in flat.outputs for _ in range(p.size)]
        chosen = [ports[n] for n in signals]
        self._shown = self._tables.rows[self._tables.shown][chosen]
        self._seen = np.array([(shown[i].scale, shown[i].offset) for i in chosen]).T
        driven = [next(p for p in flat.inputs if p.name == n) for n in drives]
        self._drives = np.array([self._place[n][0] for n in drives])
        self._driven = np.array([(p.scale, p.offset) for p in driven]).T
        deepest = dict.fromkeys(flat.rest(), 0)
        for c in flat.connections:
            deepest[c.source] = max(deepest[c.source], c.delay)
        at = [(int(e), lag) for n, deep in deepest.items() for e in self._place[n] for lag in range(1, deep + 1)]
        self._elements, self._lags = np.array(at, int).reshape(-1, 2).T
        rest = np.zeros(len(self._forced))
        for name, value in flat.rest().items():
            rest[self._place[name]] = value
        self._rest, self.start = rest, rest[self._elements]
        self.free = (self._lags == 1) & (self._elements >= sum(p.size for p in flat.inputs))

    def roll(self, states: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        t, (count, steps, _) = self._tables, inputs.shape
        now = np.tile(self._rest, (count, t.depth + steps, 1))
        now[:, t.depth - self._lags, self._elements] = states
        now[:, t.depth :, self._drives] = (inputs - self._driven[1]) / self._driven[0]
        for one in now:
            done = forward(t.layers, t.links, t.n_inputs, t.depth, self._theta, one, one, self._forced)
            one[t.depth + done :] = np.nan
        ends = now[:, t.depth + steps - self._lags, self._elements]
        return ends, now[:, t.depth :, self._shown] * self._seen[0] + self._seen[1]


class Disturbed:
    """A model with unknown constants: added to some inputs, then to some signals (places); they are its last states."""

    def __init__(self, model: Model, inputs: Sequence[int], signals: Sequence[int]):
        self.model, self.name = model, model.name
        self.on_inputs, self.on_signals = list(inputs), list(signals)
        self.count = len(self.on_inputs) + len(self.on_signals)
        self.start = np.append(model.start, np.zeros(self.count))
        self.free = np.append(model.free, np.ones(self.count, bool))

    def roll(self, states: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        inner = states.shape[1] - self.count
        split = inner + len(self.on_inputs)
        acting = inputs.copy()
        acting[:, :, self.on_inputs] += states[:, None, inner:split]
        ends, seen = self.model.roll(states[:, :inner], acting)
        seen[:, :, self.on_signals] += states[:, None, split:]
        return np.hstack([ends, states[:, inner:]]), seen


def derivatives(model: Model, state: np.ndarray, held: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, ...]:
    """(state after a sample, signals then, and their derivatives by the state before). sizes: (n,), of states."""
    steps = SHARE * sizes
    states = np.vstack([state, state + np.diag(steps)])
    ends, seen = model.roll(states, np.tile(held, (len(states), 1, 1)))
    seen = seen[:, 0]
    return ends[0], seen[0], ((ends[1:] - ends[0]) / steps[:, None]).T, ((seen[1:] - seen[0]) / steps[:, None]).T


class Rolled:
    """A model over a horizon, for a plan of its inputs (`predictive.Predicting`).

    drives, outputs: with the scales in which the program is solved. basis: (steps, knots).
    """

    def __init__(self, model: Model, drives: Sequence[Port], outputs: Sequence[Port], basis: np.ndarray):
        self.model, self.name, self.basis = model, model.name, basis
        self.drives, self.outputs = list(drives), list(outputs)
        self._scale, self._offset = (np.array([getattr(p, n) for p in drives]) for n in ("scale", "offset"))
        self._moves = np.zeros((1 + len(drives) * basis.shape[1], len(basis), len(drives)))
        for i in range(len(drives)):
            rows = slice(1 + i * basis.shape[1], 1 + (i + 1) * basis.shape[1])
            self._moves[rows, :, i] = SHARE * basis.T

    def start(self, state: np.ndarray) -> None:
        self._state = state

    def run(self, plan: np.ndarray) -> np.ndarray:
        plans = (self.basis @ plan.reshape(len(self.drives), -1).T)[None] + self._moves
        states = np.tile(self._state, (len(plans), 1))
        seen = self.model.roll(states, plans * self._scale + self._offset)[1]
        seen = (seen - [p.offset for p in self.outputs]) / [p.scale for p in self.outputs]
        self._slopes = np.moveaxis((seen[1:] - seen[0]) / SHARE, 0, 2)
        return seen[0]

    def derivatives(self) -> np.ndarray:
        return self._slopes


def disturbances(
    model: Model, state: np.ndarray, held: np.ndarray, sizes: np.ndarray, ranges: np.ndarray, seen: Mapping[int, float]
) -> Disturbed:
    """The model with as many unknown constants as there are measured signals, where these tell them.

    First of inputs, for that is where loads act, then of signals. A constant is told where the state and all constants
    have a unique rest: [[A - I, B], [C, D]] has full rank (Pannocchia, Rawlings 2003). state, held: about which.
    sizes: of the states, ranges: of the inputs, seen: measured signal -> its size.
    """
    rows = [*seen]
    weights = np.concatenate([1 / sizes, 1 / np.array([*seen.values()])])
    chosen: list[tuple[int, int]] = []
    for place in (*((0, i) for i in range(len(ranges))), *((1, i) for i in rows)):
        tried = [*chosen, place]
        more = Disturbed(model, *([i for kind, i in tried if kind == of] for of in (0, 1)))
        size = np.concatenate([sizes, [ranges[i] if kind == 0 else seen[i] for kind, i in sorted(tried)]])
        _, _, a, c = derivatives(more, np.append(state, np.zeros(len(tried))), held, size)
        change = np.vstack([(a - np.eye(len(a)))[: len(state)], c[rows]]) * size * weights[:, None]
        if len(tried) <= len(rows) and np.linalg.matrix_rank(change, tol=RANK * np.abs(change).max()) == len(size):
            chosen = tried
    return Disturbed(model, *([i for kind, i in chosen if kind == of] for of in (0, 1)))


RANK = 1e-7  # of the largest: differences err by less
