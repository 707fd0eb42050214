"""The values of a program's ports in C99, beside its step: codes from values, and values from codes.

The arithmetic is that of `Terminal.codes` and `Program.decode`, to the bit: doubles of IEEE 754, rounded after every
operation.
"""

import re

from greygate.compiler.targets import c99
from greygate.compiler.verilog import render
from greygate.emulator.program import Program, Terminal

EXAMPLE = "example.c"


def files(program: Program) -> dict[str, str]:
    """File name -> text: the step, its header, and the functions that turn values into codes and back."""
    inputs, outputs = fields(program)
    context = {
        "name": program.name,
        "values": {
            "input": [(inputs[p.name], p.signal.size, _unit(p)) for p in program.inputs],
            "output": [(outputs[p.name], p.signal.size, _unit(p)) for p in program.outputs],
        },
        "encoded": [line for p in program.inputs for line in c99.each(p.signal.size, _encoded(p, inputs[p.name]))],
        "decoded": [line for p in program.outputs for line in c99.each(p.signal.size, _decoded(p, outputs[p.name]))],
        "read": [f"in.{inputs[p.name]}[{r}]" for p in program.inputs for r in range(p.signal.size)],
        "shown": [f"out.{outputs[p.name]}[{r}]" for p in program.outputs for r in range(p.signal.size)],
    }
    texts = {f"{program.name}_values.h": "values.h", f"{program.name}_values.c": "values.c", EXAMPLE: "example.c"}
    return c99.files(program) | {n: render(template, context, "greygate.export") for n, template in texts.items()}


def fields(program: Program) -> tuple[dict[str, str], dict[str, str]]:
    """Port -> its name in the structures of values, of the inputs and of the outputs."""
    inputs = c99.identifiers("in_", (p.name for p in program.inputs))
    return inputs, c99.identifiers("out_", (p.name for p in program.outputs))


def _unit(p: Terminal) -> str:
    return re.sub(r"[^\w^/%°·µ² .-]", "", p.unit) or "no unit"


def _encoded(p: Terminal, field: str) -> str:
    fix = p.signal.fix
    ends = f"{c99.number(fix.lo)}, {c99.number(fix.hi)}"
    numbers = f"{float(p.offset)!r}, {float(p.scale)!r}, {2.0**fix.frac!r}, {ends}"
    return f"input->{field}[r] = ({c99.integer(fix)})code_of(values->{field}[r], {numbers}, &clipped);"


def _decoded(p: Terminal, field: str) -> str:
    step = p.signal.fix.lsb * p.scale
    return f"values->{field}[r] = value_of((int64_t)output->{field}[r], {step!r}, {float(p.offset)!r});"
