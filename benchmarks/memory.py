"""Most memory of look, an epoch of train, validate, emulate and identify on a recording of 5,000,000 rows.

Each command runs in a process of its own, `look` converts the units and writes the recording again. The aim: 4 GB.
"""

import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from greygate.models.families.regression import noe
from greygate.models.network import Network, Port
from greygate.plants.excitation import prms

from .shared import GREYGATE, scratch, stopwatch

TAKES = "half an hour"
THREADS = "all"
ROWS = 5_000_000
AIM_GB = 4.0
SECONDS = 120  # that identify may search
BLOCK = 100_000  # rows that are written at once
PERIOD, NOISE = 1e-3, 1e-3


def plant() -> Network:
    """A lag behind a curve, in the form of the network that is trained on it."""
    start = noe("mine", {Port("u", "V"): (1, 2)}, Port("y", "m"), (1,), hidden=4)
    return replace(start.with_parameters({"sum.y_z1": [[0.9]]}), dt=PERIOD)  # else it integrates


def write(path: Path, rows: int, header: str = "t_s,u_V,y_m") -> None:
    """A recording of the lag, block by block."""
    rng, last = np.random.default_rng(0), 0.0
    with path.open("w") as file:
        file.write(f"{header}\n")
        for start in range(0, rows, BLOCK):
            u = prms(BLOCK, -1.0, 1.0, (5, 40), start)
            y = np.empty(BLOCK)
            for k, drive in enumerate(np.tanh(2 * u)):
                y[k] = last = 0.95 * last + 0.05 * drive
            table = np.column_stack([PERIOD * np.arange(start, start + BLOCK), u, y + NOISE * rng.normal(size=BLOCK)])
            np.savetxt(file, table[: rows - start], "%.3f,%.6f,%.6f")


def measured(words: list, folder: Path) -> dict:
    """Run a command in the folder: its most memory in GB (resident, of the process), and its seconds."""
    watch = stopwatch()
    done = subprocess.Popen([GREYGATE, *words], cwd=folder, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(done.pid, 0)
    if code := os.waitstatus_to_exitcode(status):
        sys.exit(f"greygate {' '.join(words)}: exit code {code}")
    return {"gb": round(used.ru_maxrss / 1e6, 2), "seconds": round(watch())}


def prepared(part: str, folder: Path) -> list[str]:
    """Write what a command needs; its words."""
    plant().save(folder / "mine")
    header = "t_s,u [mV],y [mm]" if part == "look" else "t_s,u_V,y_m"
    write(folder / "long.csv", ROWS, header)
    if part == "look":
        return ["look", "long.csv", "--out", "canonical.csv"]
    if part == "identify":
        channels = ["--input", "u", "--output", "y"]
        return ["identify", "long.csv", *channels, "--seconds", str(SECONDS), "--jobs", "1", "--out", "found"]
    if part == "train":
        return ["train", "mine.toml", "long.csv", "--no-narx", "--epochs", "1", "--out", "out"]
    if part == "validate":
        return ["validate", "mine.toml", "long.csv", "--html", "page.html"]
    write(folder / "short.csv", 10_000)
    measured(["compile", "mine.toml", "short.csv", "--out", "build"], folder)
    return ["emulate", "build", "long.csv", "--out", "predicted.csv"]


def of(command: str) -> dict:
    with scratch() as folder:
        return {"command": command, "rows": ROWS, "aim_gb": AIM_GB, **measured(prepared(command, folder), folder)}


PARTS = {command: partial(of, command) for command in ("look", "train", "validate", "emulate", "identify")}
