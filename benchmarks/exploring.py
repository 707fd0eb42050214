"""What exploring finds and how long it takes: fronts of networks on FPGAs, and the tools' word on each choice.

Each request is one `greygate compile`; the chosen design is then verified, and placed and routed.
Usage: python benchmarks/exploring.py [--request NAME...] [--jobs N]
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from made import stamp

from greygate.machines.catalog import REPORTED

ROOM = "--max-error 1.05x --max-latency 20us --max-luts 1300 --max-dsps 3 --max-memories 12"  # 200 LUTs for a port
REQUESTS = {  # name -> (target, options of greygate compile)
    "up5k": ("up5k", f"valve_cylinder --device up5k {ROOM}"),
    "ecp5-25k": (
        "ecp5-25k",
        "valve_cylinder --prune 1.02 --weights obs --device ecp5-25k --architecture parallel --max-error 1.05x "
        "--max-latency 0.5us",
    ),
    **{
        f"{plant}, parallel": ("ecp5-85k", f"{plant} --device ecp5-85k --architecture parallel --max-error 1.05x")
        for plant in REPORTED
    },
    "point": ("up5k", "valve_cylinder --device up5k --width 16 --finer 2 --architecture folded"),
}
RESULTS = Path(__file__).parent / "results/exploring.json"


def told(*words: str) -> tuple[dict, float]:
    """What a command prints as JSON, and its seconds."""
    begun = time.perf_counter()
    command = [sys.executable, "-c", "from greygate.cli import run; run()", *words, "--json"]
    done = subprocess.run(command, capture_output=True, text=True)
    if not done.stdout:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout), round(time.perf_counter() - begun, 1)


def measured(target: str, options: str, jobs: int) -> dict:
    """The exploration, its seconds, and what the tools make of the chosen design."""
    with tempfile.TemporaryDirectory() as folder:
        build = str(Path(folder) / "build")
        found, seconds = told("compile", *options.split(), "--jobs", str(jobs), "--out", build)
        row = {"command": f"greygate compile {options} --jobs {jobs}", "seconds": seconds}
        row |= {"explored": found.get("explored", found)}
        if "explored" not in found:  # no design meets the request
            return row
        figures = told("synthesize", build, "--target", target, "--clock-rate")[0]
        row["built"] = {design: found for design, found in figures.items() if design.endswith(f", {target}")}
        row["verified"] = told("verify", build)[0]
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--request", nargs="*", choices=REQUESTS, default=list(REQUESTS))
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    for name in given.request:
        row = measured(*REQUESTS[name], given.jobs)
        rows = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
        rows[name], explored = row, row["explored"]
        print(f"{name}: {rows[name]['seconds']} s, {explored['programs']} programs, {explored['points']} designs")
        print(f"  {explored['why'] or explored['chosen']}\n  {rows[name].get('built')}", flush=True)
        RESULTS.write_text(json.dumps(rows, indent=1) + "\n")
        stamp(RESULTS)


if __name__ == "__main__":
    main()
