"""`greygate build-snn` on the four plants of the thesis and on two measured tanks, beside networks built by hand.

The recordings are written as CSV, and the command reads them with the plant's file.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np

from greygate.identify.expert.files import build_files
from greygate.machines.belt_drive import plant as belt_drive
from greygate.machines.cable_drum import plant as cable_drum
from greygate.machines.catalog import entry
from greygate.machines.pump_cylinder import plant as pump_cylinder
from greygate.machines.valve_cylinder import scenarios
from greygate.models.accuracy import free_run_rms
from greygate.plants.recording import Recording, read_csv

from .made import ROOT
from .shared import say, scratch, stopwatch

TAKES = "half an hour"
MACHINES = ROOT / "machines"


@dataclass(frozen=True)
class Case:
    """plant: its file below machines/. record: name -> recording. channels: those that the command is given."""

    plant: str
    record: Callable[[str], Recording]
    channels: Sequence[str]
    training: Sequence[str]
    tests: Sequence[str]
    sensors: Sequence[str]
    unit: str
    scale: float


def tanks(name: str) -> Recording:
    """The two tanks as they were measured (recordings/cascaded-tanks): `train` or `test`."""
    found = read_csv(ROOT / "recordings" / "cascaded-tanks" / "cascaded_tanks.csv")
    return Recording(found.dt, {n: found[f"{n}_{name}"] for n in "uy"}, {"u": "V", "y": "V"})


CASES = {
    "valve_cylinder": Case(
        "valve_cylinder/valve_hydraulic.toml", scenarios.scenario, ("v_c", "x", "p_a", "p_b"), ("training",),
        ("v1", "v2"), ("x",), "bar", 1e-5,
    ),
    "pump_cylinder": Case(
        "pump_cylinder/pump_hydraulic.toml", pump_cylinder.record, ("n_1", "n_2", "x", "p_a", "p_b"), ("rig_training",),
        ("rig_chirp", "rig_random", "rig_open"), ("x",), "bar", 1e-5,
    ),
    "belt_drive": Case(
        "belt_drive/belt_error.toml", belt_drive.record, ("x", "e"), ("training", "boundaries"),
        ("s1", "s2", "s3", "s4"), (), "µm", 1e6,
    ),
    "cable_drum": Case(
        "cable_drum/drum_error.toml", cable_drum.record, ("x_pe", "theta", "e"), ("training",),
        ("choice", "validation"), (), "µm", 1e6,
    ),
    "tanks": Case("../recordings/rigs/tanks/plant.toml", tanks, ("u", "y"), ("train",), ("test",), (), "V", 1.0),
}  # fmt: skip


def run(name: str) -> dict:
    """Build one network, and judge it beside the one of the catalogue. RMS in the case's unit, minutes of one core."""
    case = CASES[name]
    with scratch() as folder:
        files = {n: str(written(case, n, folder)) for n in (*case.training, *case.tests)}
        given = [{n: files[n] for n in names} for names in (case.training, case.tests)]
        watch = stopwatch(process_time)
        found = build_files(MACHINES / case.plant, *given, case.sensors, (), np.inf, folder / "out", say)
        minutes = watch() / 60
    hand = {
        n: scaled(free_run_rms(entry(name).network(), r), case) for n, r in entry(name).records().items() if n in files
    }
    rms = {who: {n: scaled(by, case) for n, by in of.items()} for who, of in found["rms"].items()}
    steps: dict[str, int] = {}
    for decision in found["decisions"]:
        steps[decision["step"]] = steps.get(decision["step"], 0) + 1
    return {
        "rms": rms, "hand": hand, "unit": case.unit, "training": list(case.training), "minutes": minutes,
        "decisions": len(found["decisions"]), "undone": sum(d["undone"] for d in found["decisions"]), "steps": steps,
        "neurons": found["neurons"], "hand_neurons": entry(name).network().neurons(), "text": found["text"],
    }  # fmt: skip


def written(case: Case, name: str, folder: Path) -> Path:
    recording = case.record(name)
    channels = {n: recording[n] for n in case.channels}
    Recording(recording.dt, channels, {n: recording.units[n] for n in channels}).write_csv(folder / f"{name}.csv")
    return folder / f"{name}.csv"


def scaled(errors: Mapping[str, float], case: Case) -> list[float]:
    return [value * case.scale for value in errors.values()]


PARTS = {name: partial(run, name) for name in CASES}
