"""What a network's outputs will be for a planned input, and by how much each part of the plan changes them.

The plan is a layer of the network: its weights times a basis give the input at every step. So the derivatives of the
outputs by the plan are those by weights, which training has already (models/training/kernels.py): exact, through every
loop and delay.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from greygate.errors import InputError
from greygate.models.network import Connection, Layer, Network, Port
from greygate.models.training.kernels import forward, sensitivities
from greygate.models.training.objective import Objective

PLAN = "plan"
State = Mapping[str, np.ndarray]  # layer or input -> (lags, size), newest first, normalised


def online(network: Network, *drives: str) -> Network:
    """The network as it runs beside the plant: at step k, each of `drives` brings what acts from step k-1 to step k.

    A network of a recording answers for step k from u(k-1). Layers that read u(k), which acts only afterwards, are
    evaluated a step later with what they lead to, and read with one delay less (Leiserson, Saxe 1991). Raises
    InputError where an output depends on u(k).
    """
    flat = network.flatten()
    for port in drives:
        if port not in (known := [p.name for p in flat.inputs]):
            raise InputError(f"network {network.name}: no input {port}; it has {', '.join(known)}")
    late = _at_once(flat, drives)
    if answered := [c.target for c in flat.connections if c.delay == 0 and c.source in late and "." not in c.target]:
        at = f"an output at step k must depend on {' and '.join(drives)} before step k alone"
        raise InputError(f"network {network.name}: {at}; {answered[0]} reads what acts only afterwards")

    def moved(c: Connection) -> Connection:
        later = (c.target.rpartition(".")[0] in late) - (c.source in late)
        return replace(c, delay=max(c.delay + later, 0))  # below 0 only where the weights are 0

    return replace(flat, connections=list(map(moved, flat.connections))).check()


def _at_once(flat: Network, drives: Sequence[str]) -> set[str]:
    """The drives, and the layers that depend on them within a step."""
    late, layers, feeds = set(drives), flat.layers(), flat.feeds()
    for name in flat.order():
        read = {source for port, w in layers[name].weights.items() for source, d in [feeds[f"{name}.{port}"]]
                if d == 0 and w.any()}  # fmt: skip
        if read & late:
            late.add(name)
    return late


def knots(steps: int, count: int) -> np.ndarray:
    """Steps of a plan at which its input is free: `count` of 0..steps-1, dense at first, each gap no smaller than the
    one before. Raises InputError unless 2 <= count <= steps."""
    if not 2 <= count <= steps:
        raise InputError(f"a plan of {steps} steps with {count} knots: give 2 to {steps} knots")
    low, high = 1.0, float(steps)
    while high - low > 1e-9:  # the ratio of a geometric series whose sum is steps - 1, rounded
        ratio = (low + high) / 2
        total = sum(ratio**i for i in range(count - 1))
        low, high = (ratio, high) if total < steps - 1 else (low, ratio)
    at = np.cumsum([0.0, *(low**i for i in range(count - 1))])
    found = np.unique(np.round(at).astype(int))
    found[-1] = steps - 1
    return found


def hats(at: np.ndarray) -> np.ndarray:
    """(steps, knots): the input at each step is interpolated linearly between the knots `at`."""
    steps = np.arange(at[-1] + 1)
    return np.stack([np.interp(steps, at, row) for row in np.eye(len(at))], axis=1)


class Prediction:
    """A network run from a state over a horizon, for a plan of one of its inputs.

    model: network whose input `drive` [its unit] is planned and which has no other; its outputs at step k depend on
    the drive before step k alone. basis: (steps, knots), what the plan is made of (`hats`). Inside, everything is
    normalised as the model's ports are. Raises InputError for a model with other inputs.
    """

    def __init__(self, model: Network, drive: str, basis: np.ndarray):
        if [p.name for p in model.inputs] != [drive]:
            given = ", ".join(p.name for p in model.inputs)
            raise InputError(f"network {model.name}: inputs {given}; a prediction plans one, {drive}, and has no other")
        self.port, self.basis = model.inputs[0], np.asarray(basis, float)
        self.drives = [self.port]
        flat = online(model, drive)
        plan = Port(PLAN, size=self.basis.shape[1])
        layer = Layer({PLAN: np.zeros((1, plan.size))}, [0.0], initial=self.port.rest)
        flat = replace(flat, inputs=[plan], modules={drive: layer, **flat.modules})
        flat.connect(PLAN, f"{drive}.{PLAN}")
        objective = Objective(flat, [])
        self.flat, tables, self.place = objective.flat, objective.tables, objective.elements()
        self.name, self.outputs = self.flat.name, self.flat.outputs
        self._theta, self._forced = objective.theta.copy(), objective.forced
        planned = objective.slices()[f"{drive}.{PLAN}"]
        self._columns = slice(int(planned[0]), int(planned[-1]) + 1)
        spans = np.tile([self._columns.start, self._columns.stop], (len(tables.rows), 1))
        self._tables = tables._replace(spans=spans)  # of all derivatives those by the plan
        self._shown = tables.rows[tables.shown]
        self._now = np.zeros((tables.depth + self.steps, len(self._forced)))
        self._jacobian = np.zeros((self.steps, len(tables.shown), len(self._theta)))
        self._now[tables.depth :, : plan.size] = self.basis
        self._remembered = {c.source for c in self.flat.connections if c.delay}
        for name, layer in self.flat.layers().items():
            self._now[: tables.depth, self.place[name]] = layer.initial

    @property
    def steps(self) -> int:
        return len(self.basis)

    @property
    def depth(self) -> int:
        """The longest delay, in steps."""
        return self._tables.depth

    def start(self, state: State) -> None:
        """Begin from a state. Raises InputError where it lacks a layer that the model remembers."""
        depth = self.depth
        if missing := self._remembered - state.keys():
            raise InputError(f"network {self.flat.name}: the state lacks {', '.join(sorted(missing))}")
        for name, past in state.items():
            lags = min(len(past), depth)
            self._now[depth - lags : depth, self.place[name]] = past[:lags][::-1]

    def run(self, plan: np.ndarray) -> np.ndarray:
        """Outputs (steps, outputs) for a plan (knots,): row i is the step after the input of row i of the basis began
        to act. NaN from where the run is no longer finite."""
        self._theta[self._columns] = plan
        t = self._tables
        done = forward(t.layers, t.links, t.n_inputs, t.depth, self._theta, self._now, self._now, self._forced)
        outputs = self._now[t.depth :, self._shown].copy()
        outputs[done:] = np.nan
        return outputs

    def derivatives(self) -> np.ndarray:
        """(steps, outputs, knots) of the last run."""
        t = self._tables
        carried = np.zeros((t.depth + 1, len(t.rows), len(self._theta)))
        sensitivities(*t, self._theta, self._now, self._now, carried, 0, self.steps, self._jacobian)
        return self._jacobian[:, :, self._columns].copy()
