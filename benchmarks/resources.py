"""What the thesis's plants take on FPGAs: every architecture, cells, clock rate and microseconds a step.

    python benchmarks/resources.py [--plant NAME ...] [--target DEVICE ...] [--limit 300] [--keep] [--count]

Each tool of each design is stopped after the limit, in seconds of processor time. Writes results/resources.json and
prints its table. --keep writes the figures into the package, where `greygate report --all` finds them: those of the
parallel and the folded design on the ECP5, unless others are asked for.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

from made import stamp

from greygate.compiler.targets import Design
from greygate.errors import InputError
from greygate.hardware.build import Project
from greygate.machines.catalog import REPORTED
from greygate.machines.source import Source
from greygate.project import compile_project, synthesize_project

RESULTS = Path(__file__).parent / "results" / "resources.json"
TARGETS = ("ecp5-85k", "xc7a35t", "up5k")
ARCHITECTURES = ("parallel", "folded", "serial")
DSPS = 80  # products of the parallel design that may take a DSP: fewer than the two larger devices have
COLUMNS = ("luts", "flip_flops", "dsps", "block_rams", "fits", "clock_mhz", "clocks", "us_per_step", "seconds")


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--plant", action="append", choices=REPORTED)
    options.add_argument("--target", action="append")
    options.add_argument("--architecture", action="append")
    options.add_argument("--limit", type=float, default=300.0)
    options.add_argument("--keep", action="store_true")
    options.add_argument("--count", action="store_true", help="count cells only, do not place")
    given = options.parse_args()
    if given.keep:
        given.target, given.architecture = given.target or ["ecp5"], given.architecture or ["parallel", "folded"]
    found = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    for name in given.plant or REPORTED:
        found.setdefault(name, {}).update(_plant(name, given, found.get(name, {})))
        RESULTS.write_text(json.dumps(found, indent=1) + "\n")
        stamp(RESULTS)
    print("\n".join(_table(found)))


def _belongs(design: str, architecture: str, given: argparse.Namespace) -> bool:
    """Whether figures of an earlier run stay in the package beside those of this architecture."""
    other, _, target = design.partition(", ")
    return target in (given.target or TARGETS) and other != architecture


def _plant(name: str, given: argparse.Namespace, before: dict) -> dict:
    source = Source(name)
    found: dict = {}
    for architecture in given.architecture or ARCHITECTURES:
        with tempfile.TemporaryDirectory() as folder:
            where = Path(folder) / name
            try:
                compile_project(
                    source, where, source.formats(), architectures=(architecture,), design=Design(dsps=DSPS)
                )
            except InputError as error:
                found[architecture] = {"not built": str(error)}
                continue
            project = Project.open(where)
            known = (before | found).items() if given.keep else ()
            beside = {d: figures for d, figures in known if _belongs(d, architecture, given)}
            (where / "resources.json").write_text(json.dumps(beside))  # those of the package are of an earlier design
            for target in given.target or TARGETS:
                start = time.perf_counter()
                clock = not given.count and not target.startswith(("xc", "xilinx", "gowin"))
                synthesize_project(project, target, clock, given.limit, given.keep, progress=_told(name, start))
                print(
                    f"{name}, {architecture}: {(project.resources or {}).get(f'{architecture}, {target}')}", flush=True
                )
            found |= project.resources or {}
    return found


def _told(name: str, start: float):
    last = [start]

    def tell(line: str) -> None:
        if time.perf_counter() - last[0] > 10:
            last[0] = time.perf_counter()
            print(f"{name}: {line} ({last[0] - start:.0f} s)", file=sys.stderr)

    return tell


def _table(found: dict) -> list[str]:
    """A row for each design, in Markdown."""
    rows = [f"| plant | design | {' | '.join(COLUMNS)} |", "| --- " * (len(COLUMNS) + 2) + "|"]
    for plant, designs in found.items():
        for design, figures in designs.items():
            cells = [figures.get(name) for name in COLUMNS]
            if set(figures) <= {"stopped_after_s", "not built"}:
                cells[0] = (
                    f"stopped after {figures['stopped_after_s']:g} s" if "stopped_after_s" in figures else "not built"
                )
            rows.append(f"| {plant} | {design} | {' | '.join(map(_shown, cells))} |")
    return rows


def _shown(value: object) -> str:
    return "" if value is None else f"{value:.5g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
