"""The building blocks equal the integer semantics, by SAT, for exactly the parameters that a design uses.

Each block has a reference in templates/check.v.j2: docs/integer-program.md in wide arithmetic, a second time and in
another form (a quotient and what is left of it, instead of adding half and shifting). Yosys's solver looks for an
input and a state on which the two differ; there is none if the proof succeeds. It begins in any state whatever.
"""

import re
import shutil
from collections.abc import Collection, Sequence
from pathlib import Path

from greygate.compiler.verilog import render
from greygate.files import scratch
from greygate.hardware.proofs.elaborated import Block, Proof, timed
from greygate.hardware.synthesis import reading
from greygate.hardware.tools import yosys
from greygate.progress import Progress, silent

SPARE = 4  # bits beyond every sum of a reference
SECONDS = 120  # the solver gives up after
HOW = "SAT against the integer semantics"


def primitives(
    files: Sequence[Path], found: Sequence[Block], seconds: int = SECONDS, progress: Progress = silent
) -> list[Proof]:
    """A proof for each block that has a reference. files: the Verilog of the blocks. seconds: the solver's limit."""
    proofs = []
    known = [block for block in found if block.name in REFERENCES]
    for k, block in enumerate(known):
        progress(f"SAT: {block} ({k + 1} of {len(known)})")
        proofs.append(_proof(files, block, seconds))
    return proofs


def unknown(found: Sequence[Block], elsewhere: Collection[str]) -> list[Proof]:
    """What is said of blocks without a reference. elsewhere: those that another proof covers."""
    names = sorted({block.name for block in found} - {*REFERENCES} - {*elsewhere})
    why = "it has no reference here; greygate verify compares the whole design"
    return [Proof(f"{name} equals the integer semantics", HOW, None, counterexample=why) for name in names]


def _proof(files: Sequence[Path], block: Block, seconds: int) -> Proof:
    what = f"{block} equals the integer semantics"
    with timed() as spent, scratch() as work:
        for path in files:
            shutil.copy(path, work)
        clocks = REFERENCES[block.name][1]
        (work / "check.v").write_text(reference(block), encoding="utf-8", newline="\n")
        prepared = "hierarchy -top check; proc; flatten; opt -full -share_all; memory; opt -share_all"
        sat = f"sat -seq {clocks + 1} -prove-skip {clocks} -prove ok 1 -show-inputs -show ok -timeout {seconds}"
        log = yosys(f"{reading([*files, Path('check.v')])}; {prepared}; {sat}", work)
    if "no model found: SUCCESS" in log:
        return Proof(what, HOW, True, spent[0])
    if "model found: FAIL" in log:
        return Proof(what, HOW, False, spent[0], _model(log))
    return Proof(what, HOW, None, spent[0], f"the solver gave up after {seconds} s")


def _model(log: str) -> str:
    """The counterexample of Yosys's table: signal=value at each time."""
    rows = re.findall(r"^\s+(\d+|init)\s+\\(\S+)\s+(-?\d+|--)\s+([0-9a-fx]+|-+)\s", log, re.M)
    return ", ".join(f"{name}[{time}]=0x{value}" for time, name, _, value in rows if name != "clk")


def reference(block: Block) -> str:
    """A module `check` of a block and its reference: ok where they agree. <port>_1: a port in the clock before."""
    inputs, enabled = REFERENCES[block.name][0], "en" in block.ports
    others = [name for name in block.ports if name not in (*inputs, "clk")]
    context = {"block": block, "n": block.number, "field": block.field, "inputs": list(inputs), "spare": SPARE}
    return render("check.v", context | {"enabled": enabled, "others": others}, "greygate.hardware")


REFERENCES = {  # block -> its inputs but for clock and enable, and the clocks after which its answer is that of them
    "greygate_requantize": (("a",), 1),
    "greygate_clamp": (("x",), 1),
    "greygate_threshold": (("x",), 1),
    "greygate_select": (("condition", "above", "below"), 1),
    "greygate_multiply": (("take", "one", "other"), 3),
    "greygate_drain": (("a", "mode"), 1),
    "greygate_mac": (("x", "word", "select", "first", "bias"), 4),
}
