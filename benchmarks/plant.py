"""Seconds to simulate 10 s of the valve cylinder (0.1 ms steps, 1 kHz samples), median of several runs."""

import statistics

import numpy as np

from greygate.machines.valve_cylinder.plant import valve_cylinder
from greygate.plants import prms, simulate

from .shared import taken

TAKES = "seconds"
RUNS = 9


def main() -> None:
    inputs = {"v_c": prms(10_001, -0.5, 0.5, (10, 100), seed=1), "f_ext": np.zeros(10_001)}
    for supply in ("constant", "full"):
        plant = valve_cylinder(supply)
        first, *more = taken(lambda plant=plant: simulate(plant, inputs), RUNS + 1)  # the first compiles, or loads
        print(f"{supply:9} supply: 10 s in {statistics.median(more):.3f} s (first run {first:.2f} s)")
