"""One Gauss-Newton evaluation (run, Jacobian, J'J and J'e) of the cylinder's network: 10,001 samples, one core.

OMP_NUM_THREADS=1 python benchmarks/gauss_newton.py [REPEATS]

CPU seconds, beside the floor: forming J'J of that size in BLAS alone. Medians, and the least of each.
"""

import sys
from statistics import median
from time import process_time

import numpy as np
from threadpoolctl import threadpool_limits

from greygate.machines import catalog
from greygate.models.training.objective import Objective


def timed(work, repeats: int) -> list[float]:
    work()
    times = []
    for _ in range(repeats):
        began = process_time()
        work()
        times.append(process_time() - began)
    return times


def main(repeats: int) -> None:
    entry = catalog.entry("valve_cylinder")
    objective = Objective(entry.network(), [entry.records()["training"]])
    size = len(objective.free)
    jacobian = np.random.default_rng(0).normal(size=(2048, size))
    runs = objective.samples / len(jacobian)
    with threadpool_limits(1, "blas"):
        run = timed(lambda: objective.squares(objective.theta), repeats)
        equations = timed(lambda: objective.normal_equations(objective.theta), repeats)
        floor = [runs * t for t in timed(lambda: jacobian.T @ jacobian, 4 * repeats)]
    both = [a + b for a, b in zip(run, equations, strict=True)]
    print(f"{objective.samples} residuals, {len(objective.theta)} parameters, {size} free")
    for name, times in (("run", run), ("Jacobian, J'J, J'e", equations), ("evaluation", both), ("J'J alone", floor)):
        print(f"{name:20} median {median(times):.3f} s  least {min(times):.3f} s")
    print(f"evaluation over J'J alone: {median(both) / median(floor):.2f}")


main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
