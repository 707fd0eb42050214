"""The serial architecture: the least design. One adder and one memory perform a program of words, one a clock.

compiler/serial/code.py writes the words; rtl/greygate_serial.v performs them. A product is a few additions, one for
each signed digit of its weight, so that no multiplier is needed.
"""

from greygate.compiler.serial.layout import Code, compiled
from greygate.compiler.targets import Architecture, Design, Register
from greygate.compiler.verilog import (
    header,
    instance,
    lane_width,
    module_text,
    number,
    remark,
    result_text,
    sign_extended,
    top_ports,
    unused_bits,
    unused_text,
    verilog_names,
    wrapped,
)
from greygate.emulator.program import Program

BLANK = "1'bx"  # no bit of the sample


def serial(program: Program, design: Design = Design()) -> dict[str, str]:
    """File name -> text of the serial architecture, without the building blocks."""
    verilog_names(program)
    code = compiled(program)
    return {
        f"{program.name}.v": _top(program, code),
        f"{program.name}__code.v": _code(program, code),
        f"{program.name}__memory.v": _memory(program, code),
    }


def registers(program: Program, design: Design) -> list[Register]:
    """States take the first words of the memory, in order."""
    return [Register(f"memory.words[{k}]", alone=True) for k in range(sum(s.signal.size for s in program.states))]


def clocks(program: Program, design: Design) -> int:
    """Clocks of a step."""
    return compiled(program).clocks


TARGET = Architecture(serial, registers, clocks)


def _top(program: Program, code: Code) -> str:
    ports, width_in, width_out = top_ports(program)
    w = code.widths
    parameters = {f"{k.upper()}_W": v for k, v in w.items()}
    parameters |= {"PUSHES": int(code.pushes > 0), "BOOT": code.boot, "START": code.start}
    ends = {k: k for k in ("clk", "rst", "code_address", "code_read", "word", "sample_bit", "read", "write")}
    ends |= {k: k for k in ("x", "y", "push")}
    ends |= {k: k for k in ("s_axis_tvalid", "s_axis_tready", "m_axis_tvalid", "m_axis_tready")}
    field = f"word[{w['field'] - 1}:0]"
    memory = {"clk": "clk", "read": "read", "write": "write", "field": field, "y": "y", "x": "x"}
    rom = {"clk": "clk", "read": "code_read", "address": "code_address", "word": "word"}
    body = f"""\
module {program.name} (
{ports}
);

    wire [{w["code"] - 1}:0] code_address;
    wire code_read;
    wire [{w["field"] + 3}:0] word;
    wire [{w["read"] - 1}:0] read;
    wire write;
    wire [{w["data"] - 1}:0] x;
    wire [{w["data"] - 1}:0] y;
    wire push;
    wire [{width_in - 1}:0] sample = s_axis_tdata;
    wire [{width_out - 1}:0] result;
    assign m_axis_tdata = result;
{_sample(program, code)}
{instance("greygate_serial", "machine", parameters, ends)}
{instance(f"{program.name}__code", "code", {}, rom)}
{instance(f"{program.name}__memory", "memory", {}, memory)}
{_outputs(program, code)}"""
    return module_text(header(program, "serial"), body)


def _sample(program: Program, code: Code) -> str:
    """The bit of the sample that a word of the main code takes."""
    width = 1
    while len({p % (1 << width) for p in code.bits}) < len(code.bits):
        width += 1
    taken = {place % (1 << width): f"sample[{bit}]" for place, bit in code.bits.items()}
    listed = wrapped([f"{taken.get(n, BLANK)}," for n in reversed(range(1 << width))], "        ").rstrip(",")
    return f"""
    // the bits of the sample in the order in which the code takes them
    wire [{(1 << width) - 1}:0] ordered = {{
{listed}
    }};
    wire sample_bit = ordered[code_address[{width - 1}:0]];

{unused_text([*unused_bits(program), *([] if code.pushes else ["push"])])}"""


def _outputs(program: Program, code: Code) -> str:
    """The result: the last code in the accumulator, the one before as memory has read it, the others as pushed."""
    shown = [p.signal for p in program.outputs for _ in range(p.signal.size)]
    text, widest = "", 0
    registers = []
    for n, s in enumerate(shown[:-2]):  # the first is pushed first, and comes to stand last
        widest = max(widest, s.fix.width)
        registers.append((f"output_{n}", widest))
    for n, (name, width) in enumerate(registers):
        source = f"y[{width - 1}:0]" if n + 1 == len(registers) else f"output_{n + 1}[{width - 1}:0]"
        text += f"    reg [{width - 1}:0] {name};\n    always @(posedge clk) if (push) {name} <= {source};\n"
    names = [*(name for name, _ in registers), *["x", "y"][2 - min(2, len(shown)) :]]
    lanes = [sign_extended(n, 0, s.fix.width, lane_width(s)) for n, s in zip(names, shown, strict=True)]
    return f"{text}\n{result_text(lanes)}"


def _code(program: Program, code: Code) -> str:
    w = code.widths
    rows = [f"words[{n}] = {{4'd{o}, {w['field']}'d{f}}};  {remark(note)}" for n, (o, f, note) in enumerate(code.words)]
    listed = "\n".join(f"        {row}".rstrip(" /") if row.endswith("//") else f"        {row}" for row in rows)
    return module_text(
        [f"Code of {program.name}: {len(rows)} words {{operation, field}}; rtl/greygate_serial.v tells what they do."],
        f"""module {program.name}__code (
    input  wire clk,
    input  wire read,
    input  wire [{w["code"] - 1}:0] address,
    output reg  [{w["field"] + 3}:0] word
);

    reg [{w["field"] + 3}:0] words[0:{len(rows) - 1}];
    always @(posedge clk) if (read) word <= words[address];

    initial begin
{listed}
    end
""",
    )


def _memory(program: Program, code: Code) -> str:
    w = code.widths
    half = 1 << (w["field"] - 1)
    beyond = w["read"] - w["field"]
    where = f"{{{beyond}'d0, field}}" if beyond else "field"
    depth = max(code.memory) + 1
    rows = "\n".join(
        f"        words[{n}] = {number(v, w['data'])};" + (f"  {remark(note)}" if note else "")
        for n, (v, note) in sorted(code.memory.items())
    )
    return module_text(
        [f"Memory of {program.name}: states and results below {half}, then constants, then the points of tables."],
        f"""module {program.name}__memory (
    input  wire clk,
    input  wire [{w["read"] - 1}:0] read,
    input  wire write,
    input  wire [{w["field"] - 1}:0] field,
    input  wire [{w["data"] - 1}:0] y,
    output reg  [{w["data"] - 1}:0] x
);

    (* no_rw_check *)  // no word is read in the clock in which it is written
    reg signed [{w["data"] - 1}:0] words[0:{depth - 1}];

    always @(posedge clk) begin
        x <= words[read];
        if (write) words[{where}] <= y;
    end

    initial begin
{rows}
    end
""",
    )
