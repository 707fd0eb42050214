"""What the least design costs: the catalogue's plants in the serial architecture, as default formats make them.

Words of code and of memory, clocks and microseconds of a step, and what Yosys counts; on the UP5K nextpnr places and
routes.
"""

from collections.abc import Sequence

from greygate.compiler.emit import emit
from greygate.compiler.serial.code import compiled
from greygate.emulator.program import Program
from greygate.hardware.synthesis import synthesize
from greygate.machines.source import Source
from greygate.project import compile_project

from .made import store, stored
from .shared import Limit, scratch

TAKES = "a quarter of an hour"
PLANTS = ("valve_cylinder", "asymmetric_cylinder", "pump_cylinder", "cable_drum", "belt_drive")
TARGETS = ("up5k", "ecp5-25k", "xc7a35t")
PLACED = ("up5k",)
WIDTH = 16
MHZ = 12.0  # of the clock that a UP5K has inside


def measured(program: Program, targets: Sequence[str], limit: float) -> dict[str, object]:
    """Figures of one program."""
    code = compiled(program)
    found: dict[str, object] = {"words": len(code.words), "memory": max(code.memory) + 1}
    found |= {"clocks": code.clocks, f"us_at_{MHZ:g}_mhz": round(code.clocks / MHZ, 1), "widths": code.widths}
    with scratch() as folder:
        emit(program, folder, "serial")
        for name in targets:
            found[name] = synthesize(folder, program.name, name, name in PLACED, limit)
            print(f"  {name}: {found[name]}", flush=True)
    return found


def main(*, plants: Sequence[str] = PLANTS, targets: Sequence[str] = TARGETS, limit: Limit = 300.0) -> None:
    rows = stored("least")  # of other plants and targets
    for name in plants:
        with scratch() as folder:
            source = Source(name)
            formats = source.formats(WIDTH, None)  # the catalogue chooses how many bits finer
            compile_project(source, folder / name, formats, architectures=("listing",))
            program = Program.load(folder / name / "program.json")
        print(name, flush=True)
        rows[name] = rows.get(name, {}) | measured(program, targets, limit)
        store("least", rows)
