"""The wheel in an empty environment and an empty folder: every command of the README, in its order, and its exit code.

Exit code 1 if a command does not end with 0. Left out is `play`, which needs a board. The recordings that the README
calls the reader's own are made here: a lag with a dead zone.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

from .made import ROOT, keep
from .shared import VERILATOR, scratch, stopwatch

TAKES = "ten minutes"
THREADS = "all"
NEEDS = VERILATOR

EXTRAS = "synthesis,proof,board"  # what `synthesize`, `prove` and `board --bitstream` ask for
LEFT_OUT = ("greygate play", "greygate --help")
PERIOD, SAMPLES = 1e-3, 1500


def commands() -> list[str]:
    """Lines of the README's blocks that begin with greygate, without their remarks."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = "".join(body for kind, body in re.findall(r"^```(\w*)[^\n]*\n(.*?)^```", text, re.S | re.M) if not kind)
    found = [line.partition(" #")[0].strip() for line in re.findall(r"^greygate .*$", blocks, re.M)]
    return [line for line in found if not line.startswith(LEFT_OUT)]


def recordings(folder: Path) -> None:
    """train.csv, other.csv and test.csv: x_meas follows x_cmd behind a lag and a dead zone; u and y are the same."""
    for seed, name in enumerate(("train", "other", "test")):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.uniform(-0.02, 0.02, SAMPLES // 25), 25)
        y = np.zeros(SAMPLES)
        for k in range(SAMPLES - 1):
            y[k + 1] = y[k] + 0.05 * (np.sign(u[k]) * max(abs(u[k]) - 2e-3, 0.0) - y[k])
        y += 1e-5 * rng.standard_normal(SAMPLES)
        rows = np.column_stack([PERIOD * np.arange(SAMPLES), u, y, u, y])
        np.savetxt(
            folder / f"{name}.csv", rows, "%.9g", delimiter=",", header="t_s,x_cmd_m,x_meas_m,u_m,y_m", comments=""
        )


def script() -> str:
    """The README's block of Python, on train.csv."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    block = next(b for b in re.findall(r"```python\n(.*?)```", text, re.S) if "read_csv" in b)
    return re.sub(r'read_csv\("[^"]*"\)', 'read_csv("train.csv")', block)


def main() -> int:
    rows = []
    with scratch() as place:
        folder = place / "empty"
        pip = [sys.executable, "-m", "pip"]
        subprocess.run([*pip, "wheel", "-q", "--no-deps", "-w", place / "dist", ROOT], check=True)
        subprocess.run([sys.executable, "-m", "venv", place / "venv"], check=True)
        wheel = next((place / "dist").glob("greygate-*.whl"))
        own = [place / "venv" / "bin" / "python", "-m", "pip"]
        install = ["install", "-q", "-c", ROOT / "constraints.txt", f"{wheel}[{EXTRAS}]"]
        subprocess.run([*own, *install], check=True)
        folder.mkdir()
        recordings(folder)
        (folder / "budget.toml").write_text("[growth]\nerror = 0.5\n")
        bin_ = place / "venv" / "bin"
        environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL"))}
        environment |= {"PATH": f"{bin_}{os.pathsep}{os.environ['PATH']}", "XDG_CACHE_HOME": str(place / "cache")}
        todo = commands()
        first = next(k for k, c in enumerate(todo) if c.startswith("greygate train"))
        todo.insert(first, f"python -c {shlex.quote(script())}")
        for command in todo:
            words = shlex.split(command)
            command = "the block of Python" if words[0] == "python" else command
            if "accepted" in words:
                shutil.copytree(folder / "build", folder / "accepted")
            watch = stopwatch()
            done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
            row = {"command": command, "code": done.returncode, "seconds": watch(1)}
            if done.returncode:
                row["said"] = (done.stderr.strip().splitlines() or done.stdout.strip().splitlines() or [""])[-1][-200:]
            rows.append(row)
            print(row, flush=True)
        bytes_ = wheel.stat().st_size
    keep("wheel", "readme", {"extras": EXTRAS, "wheel_bytes": bytes_, "rows": rows})
    return int(any(row["code"] for row in rows))
