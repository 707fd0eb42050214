"""Is a headline figure the luck of its scenario? `python benchmarks/spread.py [MACHINE ...]`, minutes each.

The kept network of each machine is judged on 20 scenarios of the same kind, drawn at random; the cable drum is trained
on as many too. results/spread.json keeps every draw, from which `make pages` writes the tables of the machines' pages.
The valve-controlled cylinder has its own (benchmarks/valve_cylinder.py).
"""

import sys
from collections.abc import Callable, Iterable

import numpy as np
from made import keep
from threadpoolctl import threadpool_limits

from greygate.machines import catalog
from greygate.machines.asymmetric_cylinder import plant as asymmetric
from greygate.machines.belt_drive import plant as belt
from greygate.machines.cable_drum import plant as drum
from greygate.machines.cable_drum.study import fit
from greygate.machines.cable_drum.study import drum as drum_network
from greygate.machines.pump_cylinder import plant as pump
from greygate.models.accuracy import free_run_rms
from greygate.models.network import Network
from greygate.models.training.record import Record
from greygate.plants.recording import Recording

DRAWN = 20
FIRST = 1000  # seed of the first draw; those of the scenarios themselves are below
STOP = 0.0499  # m, from which on the asymmetric cylinder's piston is at its stop


def pressures(read: Recording, *inputs: str) -> Record:
    return Record({n: read[n] for n in inputs}, {n: read[n] for n in ("p_a", "p_b")})


def asymmetric_record(name: str, seed: int | None) -> Record | None:
    read = asymmetric.record(name, seed)
    return pressures(read, "u", "x") if np.abs(read["x_true"]).max() < STOP else None


def pump_record(name: str, seed: int | None) -> Record:
    return pressures(pump.record(name, seed), "n_1", "n_2", "x")


def drum_record(name: str, seed: int | None) -> Record:
    read = drum.record("validation" if name == "home" else name, seed)
    beacon = np.zeros(read.samples) if name == "validation" else read["home"]
    return Record({"x_pe": read["x_pe"], "theta": read["theta"], "home": beacon}, {"e": read["e"]})


def belt_record(name: str, day: int | None) -> Record:
    read = belt.record(name, day)
    return Record({"x": read["x"]}, {"e": read["e"]})


MACHINES: dict[str, tuple[float, tuple[str, ...], Callable[[str, int | None], Record | None]]] = {
    "asymmetric_cylinder": (1e5, ("v3", "v4", "v5", "v6"), asymmetric_record),
    "pump_cylinder": (1e6, ("rig_chirp", "rig_random", "rig_open"), pump_record),
    "cable_drum": (1e-6, ("validation", "home"), drum_record),
    "belt_drive": (1e-6, ("s1", "s2", "s3", "s4"), belt_record),
}
"""Machine -> unit that a page shows, scenarios, (scenario, seed or the kept one's) -> record; None: not to be used."""


def judged(machine: str) -> dict:
    """RMS of the kept network on other scenarios, beside that on the scenario of the page."""
    unit, names, record = MACHINES[machine]
    network = catalog.entry(machine).network()
    found = {}
    for name in names:
        each = draws(lambda seed, name=name: record(name, seed), lambda run: errors(network, run, unit))
        found[name] = ranked(each, errors(network, record(name, None), unit))
        print(f"{machine} {name}: {found[name]}", file=sys.stderr, flush=True)
    return found


def draws(record: Callable[[int], Record | None], error: Callable[[Record], list[float]]) -> list[dict]:
    """The first `DRAWN` seeds that give a record, each with its errors."""
    rows: list[dict] = []
    seed = FIRST
    while len(rows) < DRAWN:
        if (run := record(seed)) is not None:
            rows.append({"seed": seed, "rms": error(run)})
        seed += 1
    return rows


def errors(network: Network, run: Record, unit: float) -> list[float]:
    return [value / unit for value in free_run_rms(network, run).values()]


def ranked(rows: list[dict], picked: list[float]) -> dict:
    """By output: the median and the worst of the draws, and how many of them are better than the page's own."""
    values = np.array([row["rms"] for row in rows])
    return {
        "picked": picked,
        "median": np.median(values, axis=0).tolist(),
        "worst": values.max(axis=0).tolist(),
        "better": (values < np.array(picked)).sum(axis=0).tolist(),
        "of": len(rows),
        "each": rows,
    }


def trained_drum() -> dict:
    """The drum's network, of the size that the page has, trained on other courses: one start each, nothing chosen."""
    unit, names, record = MACHINES["cable_drum"]
    judges = {name: record(name, None) for name in names}
    rows: dict[str, list[dict]] = {name: [] for name in names}
    for seed in range(FIRST, FIRST + DRAWN):
        network = fit(drum_network((10,), seed - FIRST), record("training", seed))
        for name, run in judges.items():
            rows[name].append({"seed": seed, "rms": errors(network, run, unit)})
    kept = catalog.entry("cable_drum").network()
    return {name: ranked(each, errors(kept, judges[name], unit)) for name, each in rows.items()}


def parts(asked: Iterable[str]) -> None:
    with threadpool_limits(1, "blas"):
        for machine in asked:
            trained = {"trained_on": trained_drum()} if machine == "cable_drum" else {}
            keep("spread", machine, {"judged_on": judged(machine), **trained})


if __name__ == "__main__":
    parts(sys.argv[1:] or MACHINES)
