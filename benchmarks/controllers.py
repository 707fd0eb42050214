"""Tunes and learns the controllers that the package keeps, in models/trained/control.

The PI controller is tuned, and the predictive controller imitated, on trajectories of their own; what is judged runs on
others, and on days of the machine that no one has seen.
"""

import json
import sys
from dataclasses import asdict, replace
from typing import Annotated

import numpy as np

from greygate.control.choices import JUDGED, Case
from greygate.control.imitation import Watched, dagger
from greygate.control.pi import Proportional, tuned
from greygate.control.stepping import Floating
from greygate.errors import InputError
from greygate.machines.catalog import CONTROLLED, task
from greygate.machines.control import CONTROL, LEARNING, Task
from greygate.models.network import Network
from greygate.models.training.record import Record

from .made import stamp
from .shared import say

TAKES = "half an hour"
TUNING = 50  # seed of the trajectory and day
EPOCHS, DECAY = 60, 1e-6  # of DAgger
HIDDEN, SEED = 10, 0


def tune(chosen: Task) -> Proportional:
    """The PI controller with the least RMS error on the tuning trajectory of the undisturbed machine."""

    def track(controller: Proportional) -> float:
        try:
            figures = chosen.run(controller, Case.NOMINAL, TUNING).figures(chosen.settle)
        except InputError:  # the rig left the range of numbers
            return np.inf
        return figures["rms"] if np.isfinite(figures["rms"]) else np.inf

    return tuned(chosen.first, track, lead=True)


def learn(chosen: Task) -> Network:
    """The predictive controller, imitated by DAgger; every visit takes trajectories of its own, with and without a
    disturbance."""
    untrained = chosen.imitator(HIDDEN, SEED)
    expert, visits = chosen.predictive(), iter(range(LEARNING, JUDGED))
    reads = chosen.imitated(Floating(untrained), Floating(chosen.sensor()))

    def visit(student: Network | None) -> list[Record]:
        records = []
        for case in (Case.NOMINAL, Case.LOAD, Case.LOAD):
            driver = chosen.floating(student) if student else None
            watched = Watched(driver, expert, reads, chosen.limits)
            found = chosen.run(watched, case, next(visits)).figures(chosen.settle)
            say(f"{'student' if student else 'expert'}, {case}: RMS {1e6 * found['rms']:.2f} µm")
            records.append(watched.record(untrained, chosen.preview + chosen.settle // 10))
        return records

    return dagger(untrained, visit, chosen.rounds, EPOCHS, DECAY, say)


def main(*name: Annotated[str, CONTROLLED]) -> None:
    for chosen in map(task, name or CONTROLLED):
        print(chosen.name, file=sys.stderr)
        best = tune(chosen)
        say(f"PI tuned: {best}")
        kept = {n: float(v) for n, v in asdict(best).items() if n in ("gain", "reset_rate", "forward", "lead")}
        network = replace(learn(chosen), dt=chosen.period)
        network.save(CONTROL / chosen.name, json.dumps({"pi": kept}, indent=1) + "\n")
        stamp(CONTROL / f"{chosen.name}.json")
