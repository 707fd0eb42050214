"""Networks and integer programs a step at a time, beside a plant under way."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from greygate.emulator.engine import run
from greygate.emulator.program import Program
from greygate.models.network import Network
from greygate.models.training.kernels import forward
from greygate.models.training.objective import Objective


class Stepped(Protocol):
    """Takes one sample of every input and gives one of every output, in the units of the ports."""

    def reset(self) -> None:
        """Back to before the first step."""

    def step(self, inputs: Mapping[str, float]) -> dict[str, float]:
        """One sample: a number or, of a vector port, (size,) of each."""


class Floating:
    """A float network under way, by the compiled kernel that training uses."""

    def __init__(self, network: Network):
        objective = Objective(network, [])
        self.flat, self._tables, self._theta = objective.flat, objective.tables, objective.theta
        self._place, self._forced = objective.elements(), objective.forced
        self._now = np.zeros((self._tables.depth + 1, len(self._forced)))  # the newest step last
        self._remembered = sorted(
            {c.source for c in self.flat.connections if c.delay and c.source in self.flat.modules}
        )
        self.reset()

    def reset(self) -> None:
        for name, rest in self.flat.rest().items():
            self._now[:, self._place[name]] = rest

    def advance(self, inputs: Mapping[str, float]) -> None:
        """A step of inputs, normalised."""
        now, t = self._now, self._tables
        now[:-1] = now[1:]
        for name, value in inputs.items():
            now[-1, self._place[name]] = value
        forward(t.layers, t.links, t.n_inputs, t.depth, self._theta, now, now, self._forced)

    def step(self, inputs: Mapping[str, float]) -> dict[str, float]:
        self.advance({p.name: p.normalised(inputs[p.name]) for p in self.flat.inputs})
        shown = self._now[-1, self._tables.rows[self._tables.shown]]
        return {p.name: float(v) * p.scale + p.offset for p, v in zip(self.flat.outputs, shown, strict=True)}

    def state(self) -> dict[str, np.ndarray]:
        """Layer -> (lags, size), newest first, of every layer that is read with a delay."""
        return {n: self._now[::-1, self._place[n]].copy() for n in self._remembered}


class Emulated:
    """An integer program under way in the emulator. `inputs`, `outputs`, `state`: codes of the last step."""

    def __init__(self, program: Program):
        self.program = program
        self.reset()

    def reset(self) -> None:
        self.state = np.array([v for s in self.program.states for v in s.initial], np.int64)
        self.inputs = self.outputs = np.zeros(0, np.int64)

    def step(self, inputs: Mapping[str, float]) -> dict[str, float]:
        codes = self.program.encode({n: np.asarray(v)[None] for n, v in inputs.items()})
        done = run(self.program, codes, self.state)
        self.inputs, self.outputs, self.state = codes[0], done.outputs[0], done.states[0]
        return {n: float(v[0]) for n, v in self.program.decode(done.outputs).items()}
