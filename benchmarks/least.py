"""What the least design costs: the catalogue's plants in the serial architecture, as default formats make them.

Words of code and of memory, clocks and microseconds of a step, and what Yosys counts; on the UP5K nextpnr places and
routes. Usage: python benchmarks/least.py [--plants NAME...] [--targets NAME...] [--limit SECONDS]
"""

import argparse
import json
import tempfile
from pathlib import Path

from made import stamp

from greygate.compiler.emit import emit
from greygate.compiler.serial.layout import compiled
from greygate.emulator.program import Program
from greygate.hardware.synthesis import synthesize
from greygate.machines.source import Source
from greygate.project import compile_project

PLANTS = ("valve_cylinder", "asymmetric_cylinder", "pump_cylinder", "cable_drum", "belt_drive")
TARGETS = ("up5k", "ecp5-25k", "xc7a35t")
PLACED = ("up5k",)
WIDTH = 16
MHZ = 12.0  # of the clock that a UP5K has inside
RESULTS = Path(__file__).parent / "results/least.json"


def measured(program: Program, targets: list[str], limit: float) -> dict[str, object]:
    """Figures of one program."""
    code = compiled(program)
    found: dict[str, object] = {"words": len(code.words), "memory": max(code.memory) + 1}
    found |= {"clocks": code.clocks, f"us_at_{MHZ:g}_mhz": round(code.clocks / MHZ, 1), "widths": code.widths}
    with tempfile.TemporaryDirectory() as folder:
        emit(program, folder, "serial")
        for name in targets:
            found[name] = synthesize(folder, program.name, name, name in PLACED, limit)
            print(f"  {name}: {found[name]}", flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", nargs="*", default=PLANTS)
    parser.add_argument("--targets", nargs="*", default=TARGETS)
    parser.add_argument("--limit", type=float, default=300.0, help="seconds of processor time for each tool")
    given = parser.parse_args()
    rows = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}  # of other plants and targets
    for name in given.plants:
        with tempfile.TemporaryDirectory() as folder:
            source = Source(name)
            formats = source.formats(WIDTH, None)  # the catalogue chooses how many bits finer
            compile_project(source, Path(folder) / name, formats, architectures=("listing",))
            program = Program.load(Path(folder) / name / "program.json")
        print(name, flush=True)
        rows[name] = rows.get(name, {}) | measured(program, given.targets, given.limit)
        RESULTS.write_text(json.dumps(rows, indent=1) + "\n")
        stamp(RESULTS)


if __name__ == "__main__":
    main()
