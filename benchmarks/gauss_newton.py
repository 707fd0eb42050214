"""One Gauss-Newton evaluation (run, Jacobian, J'J and J'e) of the cylinder's network: 10,001 samples, two outputs.

Seconds of the wall clock on one core and on two, medians, beside the floor: forming one J'J of that size in BLAS alone,
on one core. They are kept as PART, `now` by default: another version of the project is measured beside by this folder,
put into it.
"""

import os
from statistics import median

import numpy as np

from greygate.machines import catalog
from greygate.models.training.objective import Objective

from .made import keep
from .shared import taken

TAKES = "a minute"

ROWS = 2048  # of the floor's Jacobian; the rest is scaled


def timed(work, repeats: int) -> float:
    work()
    return median(taken(work, repeats))


def pin(cores: list[int]) -> None:
    """Every thread there is runs on these from now on."""
    for thread in os.listdir("/proc/self/task"):
        os.sched_setaffinity(int(thread), cores)


def main(part: str = "now", *, repeats: int = 40) -> None:
    entry = catalog.entry("valve_cylinder")
    objective = Objective(entry.network(), [entry.records()["training"]])
    size = len(objective.free)
    jacobian = np.random.default_rng(0).normal(size=(ROWS, size))
    cores = sorted(os.sched_getaffinity(0))
    found = {"residuals": objective.samples, "free": size}

    def evaluation() -> None:
        objective.squares(objective.theta)
        objective.normal_equations(objective.theta)

    evaluation()  # all threads have begun
    for name, used in (("one_core", cores[:1]), ("two_cores", cores[:2])):
        pin(used)
        found[name] = round(timed(evaluation, repeats), 4)
    pin(cores[:1])
    found["run"] = round(timed(lambda: objective.squares(objective.theta), repeats), 4)
    found["floor"] = round(objective.samples / ROWS * timed(lambda: jacobian.T @ jacobian, 4 * repeats), 4)
    keep("gauss_newton", part, found)
    print(", ".join(f"{name} {value}" for name, value in found.items()))
