"""The README alone, in an empty environment and an empty folder: what its installation takes, then every command.

The commands are those of its blocks, in their order; exit code 1 if one does not end with 0. Left out is what only
shows help or serves until it is stopped.
"""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

from .made import ROOT, keep
from .shared import VERILATOR, scratch, stopwatch

TAKES = "ten minutes"
THREADS = "all"
NEEDS = VERILATOR

LEFT_OUT = ("greygate app", "greygate --help")


def extras(text: str) -> list[str]:
    """Those that the README installs."""
    found = re.search(r"^pip install .*'\.\[([\w,]+)\]'$", text, re.M)
    assert found, "the README installs nothing"
    return found[1].split(",")


def commands(text: str) -> list[list[str]]:
    """The words of each line that begins with greygate, and of Python's block, in the README's order."""
    found = []
    for kind, block in re.findall(r"^```(\w*)[^\n]*\n(.*?)^```", text, re.S | re.M):
        if kind == "python":
            found.append(["python", "-c", block])
        elif not kind:
            lines = re.findall(r"^greygate .*$", block, re.M)
            found += [shlex.split(line, comments=True) for line in lines if not line.startswith(LEFT_OUT)]
    return found


def megabytes(folder: Path) -> float:
    return sum(p.lstat().st_size for p in folder.rglob("*")) / 1e6


def installed(place: Path, text: str) -> list[dict]:
    """An environment with greygate: seconds and megabytes without `hardware`, and with all that the README installs."""
    pip = [sys.executable, "-m", "pip"]
    subprocess.run([*pip, "wheel", "-q", "--no-deps", "-w", place / "dist", ROOT], check=True)
    subprocess.run([sys.executable, "-m", "venv", place / "venv"], check=True)
    (wheel,) = (place / "dist").glob("greygate-*.whl")
    watch, empty, rows = stopwatch(), megabytes(place / "venv"), []
    every = extras(text)
    for some in ([name for name in every if name != "hardware"], every):
        own = [place / "venv" / "bin" / "python", "-m", "pip", "install", "-q", "--no-cache-dir"]
        subprocess.run([*own, "-c", ROOT / "constraints.txt", f"{wheel}[{','.join(some)}]"], check=True)
        size = round(megabytes(place / "venv") - empty)
        rows.append({"extras": ",".join(some), "seconds": watch(0), "megabytes": size})
        print(rows[-1], flush=True)
    return [{"wheel_bytes": wheel.stat().st_size}, *rows]


def main() -> int:
    text, rows = (ROOT / "README.md").read_text(encoding="utf-8"), []
    with scratch() as place:
        wheel, *sizes = installed(place, text)
        (folder := place / "empty").mkdir()
        environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL"))}
        path = f"{place / 'venv' / 'bin'}{os.pathsep}{os.environ['PATH']}"
        environment |= {"PATH": path, "XDG_CACHE_HOME": str(place / "cache")}
        for words in commands(text):
            watch = stopwatch()
            done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
            command = "the block of Python" if words[0] == "python" else shlex.join(words)
            row = {"command": command, "code": done.returncode, "seconds": watch(1)}
            if done.returncode:
                row["said"] = (done.stderr.strip().splitlines() or done.stdout.strip().splitlines() or [""])[-1][-200:]
            rows.append(row)
            print(row, flush=True)
    keep("wheel", "readme", {**wheel, "installed": sizes, "rows": rows})
    return int(any(row["code"] for row in rows))
