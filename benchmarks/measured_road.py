"""`greygate make` on measured machines: from a plant and recordings to a network in Verilog.

Beside the network: the plant as its data sheet has it and as it is corrected, and the best linear model. All are judged
on the recordings that `measured_mismatch` holds out.
"""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

from .measured_mismatch import bam, make, record
from .shared import scratch, stopwatch, told

TAKES = "ten minutes"


def servo(folder: Path) -> Path:
    """The rig `bam`, learnt at the least and the greatest gain: a network does not go beyond what it has learnt."""
    make("bam", folder)
    text = (folder / "rig.toml").read_text()
    (folder / "rig.toml").write_text(text.replace("_400", "_800").replace("k_p = 400.0", "k_p = 800.0"))
    return record(folder, bam(800))


def found(rig: Callable[[Path], Path]) -> dict:
    """RMS of each on every recording held out, by output; bits; the design; minutes."""
    with scratch() as folder:
        rig(folder / "rig")
        watch = stopwatch()
        said = told("make", folder / "rig", "--out", folder / "out")
        minutes = watch() / 60
        diagnosis = json.loads((folder / "out" / "diagnose" / "diagnosis.json").read_text())
        (study,) = json.loads((folder / "out" / "verify" / "report.json").read_text())
        built = json.loads((folder / "out" / "build-snn" / "plant.json").read_text())["rms"]
        compiled = next(s["figure"] for s in said["steps"] if s["step"] == "compile")
        verified = next(s["figure"] for s in said["steps"] if s["step"] == "verify")
        held = {n: by["outputs"] for n, by in study["scenarios"].items() if n in built["network"]}
    fixed = {n: {t: o["rmse"]["fixed"] for t, o in by.items()} for n, by in held.items()}
    return {
        "named": [e["id"] for e in diagnosis["effects"]], "plant": diagnosis["fit"]["holdout"],
        "rms": {**built, "fixed": fixed}, "design": compiled, "verified": verified, "minutes": round(minutes, 2),
    }  # fmt: skip


PARTS = {"emps": partial(found, partial(make, "emps")), "servo": partial(found, servo)}
