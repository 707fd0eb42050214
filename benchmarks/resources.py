"""What the thesis's plants take on FPGAs: every architecture, cells, clock rate and microseconds a step.

Each tool of each design is stopped after the limit. Prints its table. --keep writes the figures into the package, where
`greygate report --all` finds them: by default those of the parallel and the folded design on the ECP5.
"""

import json
from collections.abc import Callable, Collection, Sequence
from typing import Annotated

from greygate.compiler.targets import Design
from greygate.errors import InputError
from greygate.hardware.build import Project
from greygate.machines.catalog import REPORTED
from greygate.machines.source import Source
from greygate.project import compile_project, synthesize_project

from .made import store, stored
from .shared import Limit, say, scratch, stopwatch

TAKES = "hours"
TARGETS = ("ecp5-85k", "xc7a35t", "up5k")
ARCHITECTURES = ("parallel", "folded", "serial")
DSPS = 80  # products of the parallel design that may take a DSP: fewer than the two larger devices have
COLUMNS = ("luts", "flip_flops", "dsps", "block_rams", "fits", "clock_mhz", "clocks", "us_per_step", "seconds")


def main(
    *plants: Annotated[str, REPORTED],
    target: Sequence[str] = (),
    architecture: Sequence[str] = (),
    limit: Limit = 300.0,
    keep: Annotated[bool, "write the figures into the package"] = False,
    count: Annotated[bool, "count cells only, do not place"] = False,
) -> None:
    targets = target or (("ecp5",) if keep else TARGETS)
    architectures = architecture or (("parallel", "folded") if keep else ARCHITECTURES)
    found = stored("resources")
    for name in plants or REPORTED:
        before = found.setdefault(name, {})
        before.update(_plant(name, targets, architectures, limit, keep, count, dict(before)))
        store("resources", found)
    print("\n".join(_table(found)))


def _belongs(design: str, architecture: str, targets: Collection[str]) -> bool:
    """Whether figures of an earlier run stay in the package beside those of this architecture."""
    other, _, target = design.partition(", ")
    return target in targets and other != architecture


def _plant(
    name: str, targets: Sequence[str], architectures: Sequence[str], limit: float, keep: bool, count: bool, before: dict
) -> dict:
    source = Source(name)
    found: dict = {}
    for architecture in architectures:
        with scratch() as folder:
            where = folder / name
            try:
                compile_project(
                    source, where, source.formats(), architectures=(architecture,), design=Design(dsps=DSPS)
                )
            except InputError as error:
                found[architecture] = {"not built": str(error)}
                continue
            project = Project.open(where)
            known = (before | found).items() if keep else ()
            beside = {d: figures for d, figures in known if _belongs(d, architecture, targets)}
            (where / "resources.json").write_text(json.dumps(beside))  # those of the package are of an earlier design
            for target in targets:
                clock = not count and not target.startswith(("xc", "xilinx", "gowin"))
                synthesize_project(project, target, clock, limit, keep, progress=_told(name))
                print(
                    f"{name}, {architecture}: {(project.resources or {}).get(f'{architecture}, {target}')}", flush=True
                )
            found |= project.resources or {}
    return found


def _told(name: str) -> Callable[[str], None]:
    watch, last = stopwatch(), [0.0]

    def tell(line: str) -> None:
        if watch() - last[0] > 10:
            last[0] = watch()
            say(f"{name}: {line} ({last[0]:.0f} s)")

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
