"""What exploring finds and how long it takes: fronts of networks on FPGAs, and the tools' word on each choice.

Each request is one `greygate explore`; the chosen design is then verified, and placed and routed.
"""

from typing import Annotated

from greygate.machines.catalog import REPORTED

from .made import store, stored
from .shared import VERILATOR, Jobs, scratch, stopwatch, told

TAKES = "twenty minutes"
THREADS = "all"
NEEDS = VERILATOR
ROOM = "--max-error 1.05x --max-latency 20us --max-luts 1300 --max-dsps 3 --max-memories 12"  # 200 LUTs for a port
REQUESTS = {  # name -> (target, options of greygate explore)
    "up5k": ("up5k", f"valve_cylinder --target up5k {ROOM}"),
    "ecp5-25k": (
        "ecp5-25k",
        "valve_cylinder --prune 1.02 --weights obs --target ecp5-25k --architecture parallel --max-error 1.05x "
        "--max-latency 0.5us",
    ),
    **{
        f"{plant}, parallel": ("ecp5-85k", f"{plant} --target ecp5-85k --architecture parallel --max-error 1.05x")
        for plant in REPORTED
    },
    "point": ("up5k", "valve_cylinder --target up5k --width 16 --finer 2 --architecture folded"),
}


def measured(target: str, options: str, jobs: int) -> dict:
    """The exploration, its seconds, and what the tools make of the chosen design."""
    with scratch() as folder:
        build, watch = folder / "build", stopwatch()
        found = told("explore", *options.split(), "--jobs", jobs, "--out", build)
        row = {"command": f"greygate explore {options} --jobs {jobs}", "seconds": watch(1)}
        row |= {"explored": found.get("explored", found)}
        if "explored" not in found:  # no design meets the request
            return row
        figures = told("synthesize", build, "--target", target, "--clock-rate")
        row["built"] = {design: found for design, found in figures.items() if design.endswith(f", {target}")}
        row["verified"] = told("verify", build)
    return row


def main(*requests: Annotated[str, REQUESTS], jobs: Jobs = 2) -> None:
    for name in requests or REQUESTS:
        row = measured(*REQUESTS[name], jobs)
        rows, explored = stored("exploring") | {name: row}, row["explored"]
        print(f"{name}: {rows[name]['seconds']} s, {explored['programs']} programs, {explored['points']} designs")
        print(f"  {explored['why'] or explored['chosen']}\n  {rows[name].get('built')}", flush=True)
        store("exploring", rows)
