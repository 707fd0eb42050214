"""What the emitted Verilog costs on an FPGA: Yosys counts the cells, nextpnr tells the clock rate. On request only.

hardware/families.py says which families and devices there are.
"""

import json
import re
import shutil
import time
from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

from greygate.compiler.emit import sources
from greygate.compiler.verilog import render
from greygate.errors import InputError
from greygate.files import scratch
from greygate.hardware.families import COUNTED, LARGE, Device, Family, PlaceAndRoute, chosen, placing
from greygate.hardware.tools import run_tool, yosys
from greygate.plain import Figure, Json
from greygate.progress import Progress, silent

HELD = ("luts", "flip_flops", "dsps", "block_rams")  # what of COUNTED a device says how many it has
NETLIST, STAT, REPORT = "netlist.json", "stat.json", "report.json"


Resources = Annotated[
    dict[str, dict[str, Figure]],
    Json(minProperties=1),
    '"ARCHITECTURE, TARGET" -> figures: luts, flip_flops, dsps, block_rams, lut_rams, fits, clock_mhz, clocks, '
    "us_per_step, meets, edge_bits, weights, or stopped_after_s.",
]


def synthesize(
    folder: Path | str,
    top: str,
    target: str = "ecp5",
    clock_rate: bool = False,
    limit: float | None = None,
    mhz: float | None = None,
    progress: Progress = silent,
) -> dict[str, float | None]:
    """Cells of the design in `folder` (as emit leaves it) on a device or a family of greygate.hardware.families.

    Returns luts, flip_flops, dsps, block_rams and lut_rams, as the row of the family counts them; `fits` (1 or 0) where
    the target is a device; with `clock_rate` clock_mhz after placing and routing without pins, None if the device is
    too small. mhz: the clock for which nextpnr places, which adds `meets` (1 or 0). limit: seconds of processor time
    for each tool; {"stopped_after_s": limit} where Yosys takes longer, and beside the counts where nextpnr does.
    Raises InputError for an unknown target, a folder without <top>.f, or a tool that is not installed.
    """
    family, device = chosen(target)
    placed = placing(target) if clock_rate or mhz is not None else None
    files = sources(folder, top)
    with scratch() as work:
        for path in files:
            shutil.copy(path, work)
        script = f"{reading(files)}; {family.synth.format(top=top)}; tee -q -o {STAT} stat -json"
        if placed and placed.place:
            script += f"; {netlist(family, placed.place, work, top)}"
        try:
            start = time.perf_counter()
            yosys(script, work, limit, progress)
        except TimeoutError:
            return {"stopped_after_s": limit}
        found = json.loads((work / STAT).read_text())["design"]["num_cells_by_type"]
        counts: dict[str, float | None] = {**counted(family, found)}
        if device:
            counts["fits"] = float(not lacking(device, counts))
        if placed and placed.place:
            small = lacking(placed, counts)
            large = placed.place.large if (counts["luts"] or 0) > LARGE else ()
            clock = {"clock_mhz": None} if small else placed_and_routed(placed.place, work, limit, mhz, progress, large)
            counts |= clock
            if mhz is not None:
                counts["meets"] = float((counts.get("clock_mhz") or 0.0) >= mhz)
            if device and counts.get("clock_mhz", 0.0) is None:
                counts["fits"] = 0.0
        return counts | {"seconds": round(time.perf_counter() - start, 1)}


def reading(files: list[Path]) -> str:
    """The Yosys command that reads these files, copied into the folder where it runs."""
    return "read_verilog " + " ".join(path.name for path in files)


def counted(family: Family, found: Mapping[str, int]) -> dict[str, float]:
    """Cells by name, such as Yosys counts them, in the words of a person."""
    return {
        what: sum(
            weight * n
            for cell, n in found.items()
            for pattern, weight in getattr(family, what).items()
            if fnmatchcase(cell, pattern)
        )
        for what in COUNTED
    }


def lacking(device: Device, counts: Mapping[str, float | None]) -> list[str]:
    """What of the counts the device has too few of: "luts: 30000 of 24288"."""
    pairs = [(what, counts[what] or 0, getattr(device, what)) for what in HELD]
    return [f"{what}: {wanted:g} of {has:g}" for what, wanted, has in pairs if wanted > has]


def netlist(family: Family, place: PlaceAndRoute, folder: Path, top: str) -> str:
    """The Yosys commands that write the netlist for nextpnr; where it needs pins, of the design behind few pins."""
    if not place.pins:
        return f"write_json {NETLIST}"
    width_in, width_out = stream_widths((folder / f"{top}.v").read_text(), top)
    pins = render("pins.v", {"top": top, "width_in": width_in, "width_out": width_out}, __package__)
    (folder / "greygate_pins.v").write_text(pins, encoding="utf-8", newline="\n")
    mapped = (
        f"design -save mapped; design -reset; read_verilog greygate_pins.v; {family.synth.format(top='greygate_pins')}"
    )
    return f"{mapped}; delete {top}; design -copy-from mapped {top}; flatten; opt_clean; write_json {NETLIST}"


def stream_widths(text: str, top: str) -> tuple[int, int]:
    """Widths of the two streams of the top module. Raises InputError if it has no such ports."""
    found = [re.search(rf"\[(\d+):0\]\s+{port}\b", text) for port in ("s_axis_tdata", "m_axis_tdata")]
    if None in found:
        raise InputError(f"{top}.v: no ports s_axis_tdata and m_axis_tdata; emit the design again")
    into, out = (int(m[1]) + 1 for m in found if m)
    return into, out


def placed_and_routed(
    place: PlaceAndRoute,
    folder: Path,
    limit: float | None,
    mhz: float | None,
    progress: Progress,
    more: tuple[str, ...] = (),
) -> dict[str, float | None]:
    """`clock_mhz` on the device of `place`; None if it does not fit. limit, mhz: as in `synthesize`.

    more: further arguments of nextpnr.
    """
    arguments = [*place.arguments, *more, "--json", NETLIST, "--report", REPORT]
    arguments += ["--freq", f"{mhz:g}"] if mhz is not None else []
    try:
        run_tool(place.module, place.module.replace("yowasp_", "run_"), arguments, folder, limit, progress)
    except TimeoutError:
        return {"stopped_after_s": limit}
    except InputError as error:
        if re.search("no BELs remaining|no more|[Ff]ailed to (find|place|expand)|[Uu]nable to find", str(error)):
            return {"clock_mhz": None}
        raise
    return {"clock_mhz": min(c["achieved"] for c in json.loads((folder / REPORT).read_text())["fmax"].values())}
