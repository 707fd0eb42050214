"""What `greygate identify` finds with no knob turned, beside the best linear model, on measured and simulated plants.

Simulated plants are integrated by scipy; their test runs are without noise. The first samples of a test give its state,
as many as the command took itself, or as are published where those are more. Each part takes a minute, the default of
the command, and the linear models are fitted to the end. Recordings that are not in the repo are looked for in
GREYGATE_RECORDINGS.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.integrate import odeint

from greygate.identify.files import figures, identify
from greygate.identify.task import Task, started
from greygate.machines.measured.study import STUDIES
from greygate.models.training.record import Record
from greygate.plain import plain
from greygate.plants.excitation import prms
from greygate.plants.recording import Recording

TAKES = "ten minutes"
SECONDS, JOBS = 120.0, 2
NAMES = ("dryer", "thermal", "dead_zone", "pendulum", "tanks", "ced", "crane", "emps", "mts")


@dataclass(frozen=True)
class Plant:
    """rate: (state, time, input) -> its rate; the output is the first state. hold: samples between two steps."""

    rate: Callable
    start: tuple[float, ...]
    dt: float
    samples: int
    low: float
    high: float
    hold: tuple[int, int]
    noise: float
    delay: int = 0

    def run(self, seed: int, noise: float) -> Record:
        u = prms(self.samples, self.low, self.high, self.hold, seed)
        x, y = np.array(self.start), np.zeros(self.samples)
        for k in range(self.samples):
            y[k] = x[0]
            x = odeint(self.rate, x, (0.0, self.dt), (u[max(k - self.delay, 0)],))[-1]
        return Record({"u": u}, {"y": y + noise * np.random.default_rng(seed).normal(size=len(y))})


def heater(x, t, u):
    """Two heat capacities; the second one radiates."""
    lost = 2e-9 * ((x[0] + 293) ** 4 - 293**4) + 0.01 * x[0]
    return [(0.2 * (x[1] - x[0]) - lost) / 10, (u - 0.2 * (x[1] - x[0])) / 3]


PLANTS = {
    "dryer": Plant(
        lambda x, t, u: [(x[1] - x[0]) / 0.25, (u - x[1]) / 0.08], (5, 5), 0.08, 1000, 3.4, 6.6, (3, 25), 0.05, 2
    ),
    "thermal": Plant(heater, (0, 0), 2.0, 1200, 0, 60, (10, 60), 0.2),
    "dead_zone": Plant(
        lambda x, t, u: [x[1], 2 * np.sign(u) * max(abs(u) - 0.7, 0) - 0.8 * x[1] - 3 * x[0]],
        (0, 0), 0.05, 1500, -3, 3, (10, 60), 0.01,
    ),
    "pendulum": Plant(
        lambda x, t, u: [x[1], u - 9.81 * np.sin(x[0]) - 0.6 * x[1]], (0, 0), 0.05, 1500, -5, 5, (8, 40), 0.01
    ),
}  # fmt: skip


def runs(name: str) -> tuple[dict[str, Record], dict[str, Record], float, str]:
    """Training runs, test runs, sample time and the unit of the output."""
    if name in PLANTS:
        plant = PLANTS[name]
        return {"train": plant.run(1, plant.noise)}, {"test": plant.run(2, 0.0)}, plant.dt, "1"
    study = STUDIES[name]
    training, tests = study.runs()
    return training, tests, study.period, study.linear.build(0).outputs[0].unit


def recorded(name: str) -> tuple[dict[str, Recording], list[str], str, dict[str, Record]]:
    """Training recordings, inputs, the output, and test runs."""
    training, tests, dt, unit = runs(name)
    first = next(iter(training.values()))
    inputs, (output,) = list(first.inputs), first.targets
    units = {**dict.fromkeys(inputs, "1"), output: unit}
    given = {n: Recording(dt, {**r.inputs, **r.targets}, units, source=n) for n, r in training.items()}
    return given, inputs, output, tests


def judged(asked: Task, test: Record) -> Record:
    """The test run, of which as many first samples give the state as the command took, or as are published."""
    return started(replace(test, skip=max(test.skip, asked.settle), initial={}), asked.output)


def found_by(name: str, seconds: float = SECONDS) -> dict:
    given, inputs, output, tests = recorded(name)
    found = identify(given, inputs, output, {}, seconds=seconds, jobs=JOBS)
    task, search = found.task, found.search
    line, linear = search.best_linear()

    def error(network, record: Record) -> float:
        errors = task.errors(network, judged(task, record))
        return np.inf if errors is None else float(np.sqrt(np.mean(errors**2)))

    kept = figures(found)
    kept |= {
        "noise": PLANTS[name].noise if name in PLANTS else None,
        "tests": {n: {"identified": error(found.network, r), "linear": error(linear, r)} for n, r in tests.items()},
        "linear_model": line.model.name,
        "linear_held_out": line.error,
    }
    kept["models"] = kept["models"][:5]
    print(name, kept["chosen"], kept["tests"], kept["seconds"], flush=True)
    return plain(kept)


PARTS = {name: partial(found_by, name) for name in NAMES}
