"""From a concealed rig to verified Verilog, without and with the module of what was concealed: docs/augmented.md.

Conceals, diagnoses, augments; with --hardware compiles and verifies both networks in FOLDER. Prints the page's table,
draws its picture, keeps networks and figures in results/augmented.
"""

import json
from pathlib import Path

from pictures import FOLDER, over_time, panel, picture

from greygate.compiler.quantize import Formats
from greygate.compiler.targets import BOTH
from greygate.files import replacing
from greygate.hardware.build import Project
from greygate.machines.catalog import AUGMENTED
from greygate.machines.source import Source, read_record
from greygate.mismatch.augment import FACTS, augment
from greygate.mismatch.concealed.conceal import conceal
from greygate.mismatch.explain import explain
from greygate.models.accuracy import float_error
from greygate.models.network import Network
from greygate.project import compile_project, fixed_and_float, verify_project

from .made import place, stamp
from .shared import say

TAKES = "not timed"
CASES = {"cable_drum": (3, "speed_slip"), "valve_hydraulic": (8, "internal_leakage")}
UNITS = {"slip": (1e6, "µm"), "p_a": (1e-5, "bar"), "p_b": (1e-5, "bar")}


def chain(folder: Path, plant: str) -> dict:
    """Everything up to the networks; figures of `augment`, verdict, and what the hardware did."""
    seed, effect = CASES[plant]
    rig, told = folder / plant / "rig", folder / plant / "diagnosis.json"
    conceal(plant, seed, rig, kind="one", effect=effect)
    diagnosis, lines = explain(rig, told)
    say(*lines, sep="\n")
    return augment(rig, diagnosis, folder / plant / "networks", AUGMENTED) | {"diagnosis": diagnosis}


def in_hardware(folder: Path, name: str) -> dict:
    """One network compiled and verified on the held-out recording, ranges from the other one."""
    recordings = {r: str(folder / "networks" / f"{r}.csv") for r in ("identify", "holdout")}
    source = Source(str(folder / "networks" / f"{name}.toml"), recordings)
    compiled = compile_project(source, folder / name, Formats(), architectures=BOTH)
    project = Project.open(folder / name)
    results = verify_project(project, ("holdout",))
    return {
        "rmse": {r: fixed_and_float(compiled, record) for r, record in source.records().items()},
        "verified": {a: r.passed for a, r in results.items()},
        "steps": {v.architecture: v.steps for r in results.values() for v in r.verdicts},
        "clocks": {v.architecture: v.clocks_per_step for r in results.values() for v in r.verdicts},
    }


def rows(found: dict) -> list[str]:
    """The page's table."""
    lines = ["| network | neurons | output | float, identify | float, holdout | 16 bits, holdout | differing bits |"]
    lines[0] += " clocks a step, parallel / folded |"
    lines.append("| --- |" + " --- |" * 7)
    for facts in found.values():
        for name, figures in facts["networks"].items():
            done = facts.get("hardware", {}).get(name)
            for output, e in figures["trained"]["holdout"].items():
                factor, unit = UNITS[output]
                fixed = f"{factor * done['rmse']['holdout'][output]['fixed']:.4g} {unit}" if done else ""
                bits = ("0" if all(done["verified"].values()) else "some") if done else ""
                clocks = " / ".join(f"{c:.0f}" for c in done["clocks"].values()) if done else ""
                known = [f"{factor * v:.4g} {unit}" for v in (figures["trained"]["identify"][output], e)]
                cells = [f"`{name}`", str(figures["neurons"]), output, *known, fixed, bits, clocks]
                lines.append("| " + " | ".join(cells) + " |")
    return lines


def draw(folder: Path) -> None:
    """docs/pictures/augmented.svg: the held-out recordings, the networks without and with the module."""
    panels = []
    shown = {
        "cable_drum": ("slip", "slip [µm]", slice(0, 401)),
        "valve_hydraulic": ("p_a", "p_a [bar]", slice(2000, 4000)),
    }
    for plant, (output, label, part) in shown.items():
        source, lines = folder / plant / "networks", []
        for kind, name in (("fixed", plant), ("cost", f"{plant}_{CASES[plant][1]}")):
            network = Network.load(source / name)
            record = read_record(network, source / "holdout.csv")[0]
            factor, truth = UNITS[output][0], record.targets[output]
            told = truth + float_error(network, record)[output]
            period = json.loads((source / FACTS).read_text())["period_s"]
            if not lines:
                lines.append(over_time(factor * truth, part, period, "reference"))
            lines.append(over_time(factor * told, part, period, kind))
        panels.append((f"{plant}, {CASES[plant][1]}", panel(lines, "time [s]", label)))
    keys = (("reference", "recorded, held out"), ("fixed", "without the module"), ("cost", "with the module"))
    with replacing(FOLDER / "augmented.svg") as path:
        path.write_text(picture(panels, keys))


def main(folder: Path, *, hardware: bool = False) -> None:
    found, kept = {}, place("augmented")
    kept.mkdir(exist_ok=True)
    for plant in CASES:
        found[plant] = chain(folder, plant)
        if hardware:
            names = found[plant]["networks"]
            found[plant]["hardware"] = {name: in_hardware(folder / plant, name) for name in names}
        for name in found[plant]["networks"]:
            Network.load(folder / plant / "networks" / name).save(kept / name)
    (kept / "figures.json").write_text(json.dumps(found, indent=1) + "\n")
    stamp(kept)
    draw(folder)
    print(*rows(found), sep="\n")
