"""The serial architecture: the least design. One adder and one memory perform a program of words, one a clock.

compiler/serial/code.py writes the words; rtl/greygate_serial.v performs them. A product is a few additions, one for
each signed digit of its weight, so that no multiplier is needed.
"""

from greygate.compiler import verilog
from greygate.compiler.serial.code import Code, compiled
from greygate.compiler.targets import Architecture, Design, Register
from greygate.emulator.program import Program

BLANK = "1'bx"  # no bit of the sample


def serial(program: Program, design: Design = Design()) -> dict[str, str]:
    """File name -> text of the serial architecture, without the building blocks."""
    verilog.verilog_names(program)
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


def boot(program: Program, design: Design) -> int:
    """Clocks after a reset until the memory holds the initial states, at most."""
    code = compiled(program)
    return code.start - code.boot + 2


TARGET = Architecture(serial, registers, clocks, boot)


def _top(program: Program, code: Code) -> str:
    w = code.widths
    parameters = {f"{k.upper()}_W": v for k, v in w.items()}
    parameters |= {"PUSHES": int(code.pushes > 0), "BOOT": code.boot, "START": code.start}
    ends = ["clk", "rst", "code_address", "code_read", "word", "sample_bit", "read", "write", "x", "y", "push"]
    ends += ["s_axis_tvalid", "s_axis_tready", "m_axis_tvalid", "m_axis_tready"]
    memory = {"clk": "clk", "read": "read", "write": "write", "field": f"word[{w['field'] - 1}:0]", "y": "y", "x": "x"}
    rom = {"clk": "clk", "read": "code_read", "address": "code_address", "word": "word"}
    bits, ordered = _sample(code)
    pushed, result = _outputs(program)
    unused = [*verilog.unused_bits(program), *([] if code.pushes else ["push"])]
    context = {"name": program.name, "w": w, "bits": bits, "ordered": ordered, "pushed": pushed, "result": result}
    context |= {"unused": verilog.unused_text(unused), **verilog.stream_widths(program)}
    context |= {"machine": verilog.instance("greygate_serial", "machine", parameters, {k: k for k in ends})}
    context |= {"code": verilog.instance(f"{program.name}__code", "code", {}, rom)}
    context |= {"memory": verilog.instance(f"{program.name}__memory", "memory", {}, memory)}
    return verilog.module_text(verilog.header(program, "serial"), verilog.render("serial.v", context))


def _sample(code: Code) -> tuple[int, str]:
    """Bits of the address, and the bit of the sample that a word of the main code takes."""
    width = 1
    while len({p % (1 << width) for p in code.bits}) < len(code.bits):
        width += 1
    taken = {place % (1 << width): f"sample[{bit}]" for place, bit in code.bits.items()}
    listed = [f"{taken.get(n, BLANK)}," for n in reversed(range(1 << width))]
    return width, verilog.wrapped(listed, "        ").rstrip(",")


def _outputs(program: Program) -> tuple[list[tuple[str, int, str]], str]:
    """(register, width, what it takes) of each output that is pushed, the first of which comes to stand last; the word.

    The last code stands in the accumulator, the one before as memory has read it.
    """
    shown = [p.signal for p in program.outputs for _ in range(p.signal.size)]
    names = [f"output_{n}" for n in range(len(shown) - 2)]
    widest = [max(s.fix.width for s in shown[: n + 1]) for n in range(len(names))]
    pushed = list(zip(names, widest, [*names[1:], "y"], strict=False))
    names += ["x", "y"][2 - min(2, len(shown)) :]
    lanes = [verilog.sign_extended(n, 0, s.fix.width, verilog.lane_width(s)) for n, s in zip(names, shown, strict=True)]
    return pushed, verilog.result_text(lanes)


def _code(program: Program, code: Code) -> str:
    field = code.widths["field"]
    rows = [
        f"words[{n}] = {{4'd{o}, {field}'d{f}}};  {verilog.remark(note)}" for n, (o, f, note) in enumerate(code.words)
    ]
    rows = [row.rstrip(" /") if row.endswith("//") else row for row in rows]
    head = f"Code of {program.name}: {len(rows)} words {{operation, field}}; rtl/greygate_serial.v tells what they do."
    return verilog.module_text(
        [head], verilog.render("serial_code.v", {"name": program.name, "w": code.widths, "rows": rows})
    )


def _memory(program: Program, code: Code) -> str:
    w, words = code.widths, sorted(code.memory.items())
    half = 1 << (w["field"] - 1)
    rows = [
        f"words[{n}] = {verilog.number(v, w['data'])};{f'  {verilog.remark(note)}' if note else ''}"
        for n, (v, note) in words
    ]
    head = f"Memory of {program.name}: states and results below {half}, then constants, then the points of tables."
    context = {"name": program.name, "w": w, "rows": rows, "depth": max(code.memory) + 1}
    return verilog.module_text([head], verilog.render("serial_memory.v", context))
