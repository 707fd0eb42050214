"""Makes the folder of a board from a build, and its bitstream where the tools of PyPI are installed."""

import json
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NotRequired, TypedDict

from greygate.compiler.emit import emitted
from greygate.errors import InputError
from greygate.files import replacing_folder
from greygate.hardware.board.boards import BAUD, PORTS
from greygate.hardware.board.frames import seed
from greygate.hardware.board.package import Package, board, write
from greygate.hardware.tools import run_tool, yosys
from greygate.plain import Count, json_text
from greygate.progress import Progress, silent

if TYPE_CHECKING:
    from greygate.hardware.build import Project

FACTS = "board.json"
ARCHITECTURE = "folded"  # unless another is asked for: the port is slower than either
FULL = "no BELs remaining"  # how nextpnr says that a device is too small
LATER = (  # what `make` in the folder adds
    r"\w+\.(json|asc|config|bin|bit)|\w+\.vvp|obj_dir/.*|\w+\.rpt|build/.*|\.Xil/.*|vivado.*"
)


class BoardFacts(TypedDict):
    """A folder for a board."""

    board: str
    architecture: str
    port: str
    baud: int | None
    clock_mhz: float
    tick_clocks: Count
    scenario: str
    identity: str
    folder: NotRequired[str]
    bitstream: NotRequired[str | None]
    cells: NotRequired[dict[str, Count]]
    reached_mhz: NotRequired[float]
    meets: NotRequired[bool]
    seconds: NotRequired[float]


def make(
    project: "Project",
    name: str,
    out: Path | str,
    *,
    architecture: str | None = None,
    port: str = "uart",
    mhz: float | None = None,
    baud: int = BAUD,
    tick: bool = False,
    bitstream: bool = False,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Write the folder of one board, completely or not at all; return what board.json in it says.

    architecture: of the build; the folded one if not given. mhz: clock of the core; the board's own if not given.
    tick: steps begin with the network's own period. bitstream: make it here, with the tools of greygate[synthesis].
    Raises InputError for a board, architecture, port or clock that is not there, a build whose Verilog was changed,
    a folder that holds other files, and a design that does not fit. One that misses its clock gets no bitstream, and
    `meets` is False.
    """
    chosen = board(name)
    if port not in PORTS:
        raise InputError(f"--interface {port}: choose {' or '.join(PORTS)}")
    if bitstream and chosen.toolchain is None:
        raise InputError(
            f"{name}: its bitstream is made by its vendor's tool alone; leave out --bitstream, then `make`"
        )
    if architecture is None:
        architecture = ARCHITECTURE if ARCHITECTURE in project.designs else project.designs[0]
    if architecture not in project.designs:
        raise InputError(f"{project.folder}: has no architecture {architecture!r}; it has {', '.join(project.designs)}")
    if edited := project.edited():
        raise InputError(f"{edited[0]}: is not the Verilog of program.json; compile again")
    first = project.source.scenarios[0]
    package = Package(
        project.program,
        emitted(project.program, architecture, project.design),
        chosen,
        port,
        mhz or chosen.clock_mhz,
        baud,
        round((mhz or chosen.clock_mhz) * 1e6 * project.program.period) if tick else 0,
        project.scenarios((first,))[first].inputs,
    )
    facts: dict[str, Any] = {
        "board": name,
        "architecture": architecture,
        "port": port,
        "baud": baud if port == "uart" else None,
        "clock_mhz": package.mhz,
        "tick_clocks": package.tick,
        "scenario": first,
        "identity": f"{seed(project.program):04x}",
    }
    with replacing_folder(out, "board", LATER) as new:
        write(package, new)
        if bitstream:
            facts["bitstream"] = f"{package.name}.{package.suffix}"
            facts |= built(package, new, progress)
            if not facts["meets"]:
                (new / facts["bitstream"]).unlink(missing_ok=True)
                facts["bitstream"] = None
        (new / FACTS).write_text(json_text(facts), encoding="utf-8", newline="\n")
    return facts


def built(package: Package, folder: Path, progress: Progress = silent) -> dict[str, Any]:
    """Make the bitstream in the folder; return the cells that nextpnr placed, the clock rate reached, and seconds.

    meets: whether that is the clock of the board. Raises InputError if a tool is missing or fails.
    """
    chain, name, begun = package.board.toolchain, package.name, time.perf_counter()
    assert chain is not None
    yosys(package.script, folder, progress=progress)
    try:
        run_tool(
            chain.module, f"run_{chain.nextpnr.replace('-', '_')}", [*package.place, "--timing-allow-fail"], folder
        )
    except InputError as error:
        if FULL not in str(error):
            raise
        kind = re.search(r"cell type '(\w+)'", str(error))
        raise InputError(
            f"{name}: does not fit {package.board.title}, too few {kind[1] if kind else 'cells'}; compile with fewer "
            "multipliers (--macs) or narrower codes (--width)"
        ) from None
    run_tool(chain.module, f"run_{chain.pack}", [f"{name}.{chain.textual}", f"{name}.{chain.bitstream}"], folder)
    report = json.loads((folder / f"{name}__report.json").read_text(encoding="utf-8"))
    reached = min(rate["achieved"] for rate in report["fmax"].values())
    for path in (f"{name}.json", f"{name}.{chain.textual}", f"{name}__report.json"):
        (folder / path).unlink()
    used = {cell: counts["used"] for cell, counts in report["utilization"].items() if counts["used"]}
    return {
        "cells": used,
        "reached_mhz": round(reached, 2),
        "meets": reached >= package.mhz,
        "seconds": round(time.perf_counter() - begun, 1),
    }
