"""The building blocks equal the integer semantics, by SAT, for exactly the parameters that a design uses.

Each block has a reference: docs/integer-program.md in wide arithmetic, written here a second time and in another form
(a quotient and what is left of it, instead of adding half and shifting). Yosys's solver looks for an input and a state
on which the two differ; there is none if the proof succeeds. The solver begins in any state whatever.
"""

import re
import shutil
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from greygate.files import scratch
from greygate.hardware.proofs.elaborated import Block
from greygate.hardware.proofs.proof import Proof, timed
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
        check, clocks = REFERENCES[block.name](block)
        (work / "check.v").write_text(check)
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


# -- references ------------------------------------------------------------------------------------------------------


def requantized(a: str, into: str, shift: int, rounding: int, width: int, wide: int, saturate: bool = True) -> str:
    """Verilog that declares `into`, `width` bits: requantize of the signed wire `a` of `wide` bits."""
    value = f"{wide}'sd"
    if shift > 0:
        rest, half = f"({a} & {value}{(1 << shift) - 1})", f"{value}{1 << (shift - 1)}"
        up = ["1'b0", f"{rest} >= {half}", f"{rest} > {half} || ({rest} == {half} && {into}_q[0])"][rounding]
        lines = f"wire signed [{wide - 1}:0] {into}_q = {a} >>> {shift};\n"
        lines += f"    wire signed [{wide - 1}:0] {into}_r = ({up}) ? {into}_q + {value}1 : {into}_q;\n"
    else:
        lines = f"wire signed [{wide - 1}:0] {into}_r = {a} <<< {-shift};\n"
    hi, lo = f"{value}{(1 << (width - 1)) - 1}", f"-{value}{1 << (width - 1)}"
    clipped = f"{into}_r > {hi} ? {hi} : {into}_r < {lo} ? {lo} : {into}_r" if saturate else f"{into}_r"
    lines += f"    wire signed [{wide - 1}:0] {into}_c = {clipped};\n"
    return f"    {lines}    wire [{width - 1}:0] {into} = {into}_c[{width - 1}:0];\n"


def _check(block: Block, inputs: Sequence[str], body: str, answer: str) -> tuple[str, int]:
    """A module `check` for a block of one clock with an enable: ok where y is the answer, or holds where en was 0.

    body, answer: Verilog on the inputs of the clock before, which are called <input>_1.
    """
    ports = "".join(f", input [{block.ports[n] - 1}:0] {n}" for n in inputs)
    past = "".join(f"    reg [{block.ports[n] - 1}:0] {n}_1;\n" for n in (*inputs, "y"))
    kept = " ".join(f"{n}_1 <= {n};" for n in (*inputs, "y"))
    return (
        f"""\
module check (input clk, input en{ports}, output ok);
    wire [{block.ports["y"] - 1}:0] y;
    {block.instance("block")}
{past}    reg en_1;
    always @(posedge clk) begin en_1 <= en; {kept} end
{body}    assign ok = y == (en_1 ? {answer} : y_1);
endmodule
""",
        1,
    )


def _requantize(block: Block) -> tuple[str, int]:
    n = block.number
    wide = n("IN_W") + abs(n("SHIFT")) + n("OUT_W") + SPARE
    body = f"    wire signed [{wide - 1}:0] v = $signed(a_1);\n"
    body += requantized("v", "f", n("SHIFT"), n("ROUNDING"), n("OUT_W"), wide, n("SATURATE") == 1)
    return _check(block, ("a",), body, "f")


def _each(size: int, body: Callable[[int], str], name: str) -> tuple[str, str]:
    """(Verilog of every element, their answers side by side)."""
    return "".join(body(k) for k in range(size)), "{" + ", ".join(f"{name}_{k}" for k in reversed(range(size))) + "}"


def _clamp(block: Block) -> tuple[str, int]:
    n = block.number
    arg, out = n("ARG_W"), n("OUT_W")
    wide = arg + abs(n("SHIFT")) + out + SPARE

    def element(k: int) -> str:
        lo, hi = (f"{'-' if v < 0 else ''}{wide}'sd{abs(v)}" for v in (n("LO"), n("HI")))
        return (
            f"    wire signed [{wide - 1}:0] x_{k} = $signed(x_1[{k * arg}+:{arg}]);\n"
            f"    wire signed [{wide - 1}:0] v_{k} = x_{k} < {lo} ? {lo} : x_{k} > {hi} ? {hi} : x_{k};\n"
            + requantized(f"v_{k}", f"f_{k}", n("SHIFT"), n("ROUNDING"), out, wide)
        )

    return _check(block, ("x",), *_each(n("SIZE"), element, "f"))


def _threshold(block: Block) -> tuple[str, int]:
    n = block.number
    arg, out = n("ARG_W"), n("OUT_W")

    def element(k: int) -> str:
        below, above = (f"{out}'d{n(name) % (1 << out)}" for name in ("BELOW", "ABOVE"))
        least = f"{'-' if n('AT') < 0 else ''}{arg + 1}'sd{abs(n('AT'))}"
        return (
            f"    wire signed [{arg}:0] x_{k} = $signed(x_1[{k * arg}+:{arg}]);\n"
            f"    wire [{out - 1}:0] f_{k} = x_{k} < {least} ? {below} : {above};\n"
        )

    return _check(block, ("x",), *_each(n("SIZE"), element, "f"))


def _select(block: Block) -> tuple[str, int]:
    n = block.number
    condition, above, below, out = (n(f"{name}_W") for name in ("CONDITION", "ABOVE", "BELOW", "OUT"))
    left = n("ABOVE_LEFT"), n("BELOW_LEFT")
    wide = max(above + left[0], below + left[1]) + abs(n("SHIFT")) + out + SPARE

    def element(k: int) -> str:
        return (
            f"    wire signed [{condition - 1}:0] c_{k} = $signed(condition_1[{k * condition}+:{condition}]);\n"
            f"    wire signed [{wide - 1}:0] a_{k} = $signed(above_1[{k * above}+:{above}]);\n"
            f"    wire signed [{wide - 1}:0] b_{k} = $signed(below_1[{k * below}+:{below}]);\n"
            + requantized(f"a_{k}", f"fa_{k}", n("SHIFT") - left[0], n("ROUNDING"), out, wide)
            + requantized(f"b_{k}", f"fb_{k}", n("SHIFT") - left[1], n("ROUNDING"), out, wide)
            + f"    wire [{out - 1}:0] f_{k} = c_{k} < 0 ? fb_{k} : fa_{k};\n"
        )

    return _check(block, ("condition", "above", "below"), *_each(n("SIZE"), element, "f"))


def _drain(block: Block) -> tuple[str, int]:
    """Each mode is a format. The sum holds the rounding constant; a tie that goes to even is judged without it."""
    n, field = block.number, block.field
    wide = n("IN_W") + n("OUT_W") + max(field("SHIFTS", 8)) + SPARE
    body, answer = f"    wire signed [{wide - 1}:0] v = $signed(a_1);\n", ""
    for k in range(n("MODES")):
        shift, width, even = field("SHIFTS", 8)[k], field("WIDTHS", 8)[k], field("EVEN", 1)[k] and field("SHIFTS", 8)[k]
        less = f"{wide}'sd{1 << (shift - 1)}" if even else f"{wide}'sd0"
        body += f"    wire signed [{wide - 1}:0] v_{k} = v - {less};\n"
        body += requantized(f"v_{k}", f"f_{k}", shift, 2 if even else 0, width, wide, not field("WRAPS", 1)[k])
        body += f"    wire [{n('OUT_W') - 1}:0] s_{k} = {{{{{n('OUT_W')}{{f_{k}[{width - 1}]}}}}, f_{k}}};\n"
        answer += f"mode_1 == {k} ? s_{k} : " if k else ""
    return _registered(block, ("a", "mode"), body, f"y == ({answer}s_0)"), 1


def _mac(block: Block) -> tuple[str, int]:
    """Products that are equal by their operands are one; what is proved is everything about them."""
    n = block.number
    x, word, acc, stages = (n(name) for name in ("X_W", "WORD_W", "ACC_W", "STAGES"))
    wide = x + word + n("BASE") + sum(block.field("AMOUNTS", 8)) + acc
    more = "".join(f" + (select_1[{k}] ? 16'd{amount} : 16'd0)" for k, amount in enumerate(block.field("AMOUNTS", 8)))
    body = f"""\
    reg signed [{x - 1}:0] x_2;
    reg signed [{word - 1}:0] word_2;
    reg signed [{x + word - 1}:0] product;
    reg [{stages - 1}:0] select_2;
    wire [15:0] shift = 16'd{n("BASE")}{more.replace("select_1", "select_2")};
    wire signed [{wide - 1}:0] whole = product;
    reg signed [{wide - 1}:0] term, term_1;
    always @(posedge clk) begin
        x_2 <= x;
        word_2 <= word;
        product <= x_2 * word_2;
        select_2 <= select;
        term <= whole <<< shift;
        term_1 <= term;
    end
    wire [{acc - 1}:0] sum = (first_1 ? bias_1 : acc_1) + term_1[{acc - 1}:0];
"""
    return _registered(block, ("x", "word", "select", "first", "bias"), body, "acc == sum && x_reg == x_1"), 4


def _registered(block: Block, inputs: Sequence[str], body: str, ok: str) -> str:
    """A module `check` for a block without an enable. <port>_1: a port in the clock before."""
    outputs = [name for name in block.ports if name not in (*inputs, "clk")]
    ports = "".join(f", input [{block.ports[n] - 1}:0] {n}" for n in inputs)
    wires = "".join(f"    wire [{block.ports[n] - 1}:0] {n};\n" for n in outputs)
    past = "".join(f"    reg [{block.ports[n] - 1}:0] {n}_1;\n" for n in (*inputs, *outputs))
    kept = " ".join(f"{n}_1 <= {n};" for n in (*inputs, *outputs))
    return f"""\
module check (input clk{ports}, output ok);
{wires}    {block.instance("block")}
{past}    always @(posedge clk) begin {kept} end
{body}    assign ok = {ok};
endmodule
"""


REFERENCES: dict[str, Callable[[Block], tuple[str, int]]] = {
    "greygate_requantize": _requantize,
    "greygate_clamp": _clamp,
    "greygate_threshold": _threshold,
    "greygate_select": _select,
    "greygate_drain": _drain,
    "greygate_mac": _mac,
}
