"""Seconds to simulate 10 s of the valve cylinder (0.1 ms steps, 1 kHz samples), median of several runs."""

import statistics
import time

import numpy as np

from greygate.machines.valve_cylinder.plant import valve_cylinder
from greygate.plants import prms, simulate


def seconds(supply: str, runs: int = 9) -> tuple[float, float]:
    """First run (compiling, or loading from the cache) and median of `runs` more, in s."""
    inputs = {"v_c": prms(10_001, -0.5, 0.5, (10, 100), seed=1), "f_ext": np.zeros(10_001)}
    plant, taken = valve_cylinder(supply), []
    for _ in range(runs + 1):
        start = time.perf_counter()
        simulate(plant, inputs)
        taken.append(time.perf_counter() - start)
    return taken[0], statistics.median(taken[1:])


if __name__ == "__main__":
    for supply in ("constant", "full"):
        first, median = seconds(supply)
        print(f"{supply:9} supply: 10 s in {median:.3f} s (first run {first:.2f} s)")
