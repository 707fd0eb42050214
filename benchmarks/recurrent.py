"""A GRU of 16 and an LSTM of 20 units, torch's with random weights, at 16 bits: clocks, cells and bits of each design.

A weight of a gate has 11 significant bits, with which an answer is within a thousandth of the range of torch's. Exit
code 1 if a bit differs from the emulator, or an answer by more.
"""

from typing import Annotated

import numpy as np
import torch
from imported_models import Cell, free_run, signal
from torch import nn

from greygate.compiler.emit import emit
from greygate.compiler.pipeline import compile_network, fixed_error
from greygate.compiler.quantize import Formats
from greygate.compiler.targets import Design, architecture
from greygate.emulator.engine import run
from greygate.emulator.program import Affine, Program
from greygate.hardware.synthesis import synthesize
from greygate.hardware.verify import Case, Scenario, verify_many
from greygate.models.importers.pytorch import from_torch
from greygate.models.training.record import Record

from .made import keep
from .shared import VERILATOR, say, scratch

TAKES = "ten minutes"
NEEDS = VERILATOR
STEPS, PLAYED = 1000, 100
AGREED = 1e-3
WEIGHT = 11  # significant bits
CELLS = {"gru16": (nn.GRUCell, 16, 1), "lstm20": (nn.LSTMCell, 20, 2)}
DESIGNS = {
    "parallel": ("parallel", Design()),
    "folded, 1 multiplier": ("folded", Design(multipliers=1, factor=16)),
    "folded, 4 multipliers": ("folded", Design(multipliers=4, factor=16)),
    "serial": ("serial", Design()),
}
COUNTED = "up5k"


def compiled(name: str) -> tuple[Program, Record]:
    kind, size, states = CELLS[name]
    torch.manual_seed(0)
    network = from_torch(Cell(kind, 1, size), ["u"], ["y"], (np.zeros(size),) * states, name)
    x = signal(STEPS, 1)
    record = Record({"u": x[:, 0]}, {"y": free_run(network, x)[:, 0]})
    weights = {f"cell_{gate}.n": WEIGHT for gate in "rznifgo"}
    return compile_network(network, {"run": record}, Formats(16, weights=weights)).program, record


def designed(program: Program, record: Record, name: str, count: bool) -> dict:
    """Clocks, cells and differing designs of one design."""
    which, design = DESIGNS[name]
    codes = program.encode(record.inputs)[:PLAYED]
    played = run(program, codes)
    found: dict = {"clocks": architecture(which).clocks(program, design)}
    with scratch() as folder:
        case = Case(program, {"run": Scenario(codes, played.outputs, played.states)}, which, design)
        found["mismatch"] = [v.mismatch for v in verify_many([case], folder, seed=1).verdicts if v.mismatch]
    if count:
        with scratch() as folder:
            emit(program, folder, which, design)
            found |= synthesize(folder, program.name, COUNTED)
    return found


def measured(name: str) -> dict:
    program, record = compiled(name)
    ops = {op: sum(o.out.size for o in program.operations if o.op == op) for op in ("table", "product")}
    off = float(np.abs(fixed_error(program, record)["y"]).max() / np.ptp(record.targets["y"]))
    designs = {}
    for design in DESIGNS:
        designs[design] = designed(program, record, design, count=design != "parallel")
        say(f"{name}, {design}: {designs[design]}")
    edges = [p.signal.fix.width for p in (*program.inputs, *program.outputs)]
    weights = sum(int(np.count_nonzero(o.weights)) for o in program.operations if isinstance(o, Affine))
    found = {"tables": ops["table"], "products": ops["product"], "weights": weights, "edges": edges, "off": off}
    return found | {"designs": designs}


def main(*cell: Annotated[str, CELLS]) -> int:
    wrong = 0
    for name in cell or CELLS:
        found = measured(name)
        wrong += found["off"] > AGREED or any(d["mismatch"] for d in found["designs"].values())
        keep("importers", name, {"steps": STEPS, "played": PLAYED, "counted": COUNTED, **found})
    return int(wrong > 0)
