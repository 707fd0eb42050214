"""Is a headline figure the luck of its scenario?

The kept network of each machine is judged on 20 scenarios of the same kind as the page's, drawn at random; of what is
no random signal (a chirp) another draw has other noise, of the belt's motions another day and another hand.
The valve-controlled cylinder and the cable drum have their own (valve_cylinder.py, cable_drum.py).
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from greygate.machines import catalog
from greygate.machines.asymmetric_cylinder import plant as asymmetric
from greygate.machines.belt_drive import plant as belt
from greygate.machines.pump_cylinder import plant as pump
from greygate.models.accuracy import free_run_rms
from greygate.models.network import Network
from greygate.models.training.record import Record
from greygate.plants.recording import Recording

from .shared import say
from .valve_cylinder import DRAWN, ranked

TAKES = "minutes"

FIRST = 1000  # seed of the first draw; those of the pages' own scenarios are below
STOP = 0.0499  # m, from which on the asymmetric cylinder's piston is at its stop

Read = Callable[[str, int | None], Record | None]


def pressures(read: Recording, *inputs: str) -> Record:
    return Record({n: read[n] for n in inputs}, {n: read[n] for n in ("p_a", "p_b")})


def of_asymmetric(name: str, seed: int | None) -> Record | None:
    read = asymmetric.record(name, seed)
    return pressures(read, "u", "x") if np.abs(read["x_true"]).max() < STOP else None


def of_pump(name: str, seed: int | None) -> Record:
    return pressures(pump.record(name, seed), "n_1", "n_2", "x")


def of_belt(name: str, day: int | None) -> Record:
    motion = belt.MOTIONS[name]
    read = belt.measure(motion if day is None else replace(motion, day=day), name)
    return Record({"x": read["x"]}, {"e": read["e"]})


MACHINES: dict[str, tuple[float, tuple[str, ...], Read]] = {
    "asymmetric_cylinder": (1e5, ("v3", "v4", "v5", "v6"), of_asymmetric),
    "pump_cylinder": (1e6, ("rig_chirp", "rig_random", "rig_open"), of_pump),
    "belt_drive": (1e-6, ("s1", "s2", "s3", "s4"), of_belt),
}
"""Machine -> unit that a page shows, scenarios, (scenario, seed; None: the page's) -> record; None: not to be used."""


def judged(machine: str) -> dict:
    """RMS of the kept network on other scenarios, beside that on the page's."""
    unit, names, read = MACHINES[machine]
    network = catalog.entry(machine).network()
    found = {}
    for name in names:
        own = read(name, None)
        assert own is not None
        rows, seed = [], FIRST
        while len(rows) < DRAWN:
            if run := read(name, seed):
                rows.append({"seed": seed, name: errors(network, run, unit)})
            seed += 1
        picked = errors(network, own, unit)
        found[name] = {"picked": picked} | ranked([row[name] for row in rows], picked) | {"each": rows}
        say(machine, name)
    return found


def errors(network: Network, run: Record, unit: float) -> list[float]:
    return [value / unit for value in free_run_rms(network, run).values()]


PARTS = {machine: partial(judged, machine) for machine in MACHINES}
