"""What two lookups in one table of tansig take on each family, for every form of table, by Yosys.

Tables are those of the flow network at 12, 16 and 16 + 2 bits, whose worst error is at most 1.25 LSB. A line of
JSON for each.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from greygate import rtl
from greygate.compiler.tables import Form, make_table
from greygate.compiler.verilog import instance, module_text, table_module, table_text
from greygate.emulator.numbers import Fix
from greygate.emulator.program import Lookup, Program, Signal, Terminal
from greygate.emulator.tables import Lines, Table
from greygate.hardware.families import FAMILIES
from greygate.hardware.synthesis import synthesize

from .shared import scratch

TAKES = "ten minutes"

FORMATS = {"12": (Fix(15, 10), Fix(12, 11)), "16": (Fix(19, 14), Fix(16, 15)), "16 + 2": (Fix(19, 14), Fix(18, 17))}
NEURONS = 2
WAYS = (("block", NEURONS), ("logic", 0))  # where words are kept, and how many neurons multiply by a multiplier
LIMIT = 600  # s of processor time for a run of Yosys


def design(table: Table | Lines, memory: str, multipliers: int, folder: Path) -> str:
    """Write two lookups as a design of its own; return the name of its top."""
    u, y = Signal("u", NEURONS, table.arg), Signal("y", NEURONS, table.out)
    ports = (Terminal("u", u, "1", 1.0, 0.0),), (Terminal("y", y, "1", 1.0, 0.0),)
    program = Program("pair", ports[0], (), (Lookup(y, "u", table.name),), ports[1], (table,)).check()
    module = table_module(program, table)
    x_width, y_width = (s.size * s.fix.width for s in (u, y))
    body = f"module pair (\n    input  wire clk,\n    input  wire [{x_width - 1}:0] x,\n"
    body += f"    output wire [{y_width - 1}:0] y\n);\n\n"
    ends = {"clk": "clk", "en": "1'b1", "x": "x", "y": "y"}
    body += instance(module, "lookup", {"SIZE": NEURONS, "MULTIPLIERS": multipliers}, ends)
    texts = {"pair.v": module_text([], body), f"{module}.v": table_text(program, table, memory)}
    texts |= {f"{name}.v": rtl.block(name).read_text() for name in ("greygate_lookup", "greygate_product")}
    for name, text in (texts | {"pair.f": "\n".join(texts) + "\n"}).items():
        (folder / name).write_text(text)
    return "pair"


def main(*, families: Annotated[Sequence[str], FAMILIES] = ("xilinx", "ecp5", "ice40")) -> None:
    for bits, (arg, out) in FORMATS.items():
        for form in Form:
            table = make_table("tansig", arg, out, 1.25, form=form)
            for memory, multipliers in WAYS:
                row = {"bits": bits, "form": form.value, "entries": table.entries, "table_bits": table.bits}
                row |= {"worst_error_lsb": round(table.worst_error / out.lsb, 3), "memory": memory}
                row |= {"multipliers": multipliers}
                for family in families:
                    with scratch() as folder:
                        top = design(table, memory, multipliers, folder)
                        row[family] = synthesize(folder, top, family, limit=LIMIT)
                print(json.dumps(row), flush=True)
