"""The values of a program's ports in C99, beside its step: codes from values, and values from codes.

The arithmetic is that of `Terminal.codes` and `Program.decode`, to the bit: doubles of IEEE 754, rounded after every
operation.
"""

import re
from collections.abc import Iterator

from greygate.compiler.targets import c99
from greygate.emulator.program import Program, Terminal

EXAMPLE = "example.c"
CODE = """
/* floor((value - offset) / scale * steps + 1/2) within [lo, hi]; what is outside is counted, and a NaN becomes lo. */
static int64_t code_of(double value, double offset, double scale, double steps, int64_t lo, int64_t hi,
                       int32_t *clipped)
{
    /* `steps` is a power of two: the product is exact, so it is the same where a compiler joins it with the sum. */
    const double y = (((value - offset) / scale) * steps) + 0.5;
    int64_t code = lo;
    if (y >= ((double)hi + 1.0))
    {
        code = hi;
        *clipped += 1;
    }
    else if (y >= (double)lo)
    {
        code = (int64_t)y;
        code = ((double)code > y) ? (code - 1) : code;
    }
    else
    {
        *clipped += 1;
    }
    return code;
}

/* code * step + offset. */
static double value_of(int64_t code, double step, double offset)
{
    const volatile double y = (double)code * step; /* volatile: rounded, whatever the compiler joins */
    return y + offset;
}
"""


def files(program: Program) -> dict[str, str]:
    """File name -> text: the step, its header, and the functions that turn values into codes and back."""
    name = program.name
    made = c99.files(program)
    made |= {f"{name}_values.h": "\n".join(_header(program)) + "\n"}
    return made | {f"{name}_values.c": "\n".join(_source(program)) + "\n", EXAMPLE: _example(program)}


def fields(program: Program) -> tuple[dict[str, str], dict[str, str]]:
    """Port -> its name in the structures of values, of the inputs and of the outputs."""
    inputs = c99.identifiers("in_", (p.name for p in program.inputs))
    return inputs, c99.identifiers("out_", (p.name for p in program.outputs))


def _header(program: Program) -> Iterator[str]:
    name, guard = program.name, f"{program.name.upper()}_VALUES_H"
    yield f"/* Values of the ports of {name}, in their units. */"
    yield from (f"#ifndef {guard}", f"#define {guard}", "", f'#include "{name}.h"', "")
    for kind, ports, names in zip(("input", "output"), (program.inputs, program.outputs), fields(program), strict=True):
        yield from ("typedef struct", "{")
        yield from (f"    double {names[p.name]}[{p.signal.size}]; /* {_unit(p)} */" for p in ports)
        yield from (f"}} {name}_{kind}_values;", "")
    yield "/* Codes of the values, and how many values their formats do not hold: they become the nearest code. */"
    yield f"int32_t {name}_encode(const {name}_input_values *values, {name}_input *input);"
    yield ""
    yield f"void {name}_decode(const {name}_output *output, {name}_output_values *values);"
    yield from ("", "#endif")


def _unit(p: Terminal) -> str:
    return re.sub(r"[^\w^/%°·µ² .-]", "", p.unit) or "no unit"


def _source(program: Program) -> Iterator[str]:
    name = program.name
    inputs, outputs = fields(program)
    yield f'#include "{name}_values.h"'
    yield from CODE.splitlines()
    yield from ("", f"int32_t {name}_encode(const {name}_input_values *values, {name}_input *input)", "{")
    yield "    int32_t clipped = 0;"
    for p in program.inputs:
        fix, field = p.signal.fix, inputs[p.name]
        numbers = (
            f"{float(p.offset)!r}, {float(p.scale)!r}, {2.0**fix.frac!r}, {c99.number(fix.lo)}, {c99.number(fix.hi)}"
        )
        call = f"input->{field}[r] = ({c99.integer(fix)})code_of(values->{field}[r], {numbers}, &clipped);"
        yield from c99.each(p.signal.size, call)
    yield from ("    return clipped;", "}", "")
    yield from (f"void {name}_decode(const {name}_output *output, {name}_output_values *values)", "{")
    for p in program.outputs:
        field, step = outputs[p.name], p.signal.fix.lsb * p.scale
        call = f"values->{field}[r] = value_of((int64_t)output->{field}[r], {step!r}, {float(p.offset)!r});"
        yield from c99.each(p.signal.size, call)
    yield "}"


def _example(program: Program) -> str:
    """A main loop that reads values and prints values: what an interrupt does with sensors and actuators."""
    name = program.name
    inputs, outputs = (list(f.values()) for f in fields(program))
    sizes = [p.signal.size for p in program.inputs], [p.signal.size for p in program.outputs]
    read = [f"in.{f}[{r}]" for f, n in zip(inputs, sizes[0], strict=True) for r in range(n)]
    shown = [f"out.{f}[{r}]" for f, n in zip(outputs, sizes[1], strict=True) for r in range(n)]
    return f"""/* One line of input values a step on stdin, one line of output values on stdout. */
#include "{name}_values.h"
#include <stdio.h>

int main(void)
{{
    {name}_state state;
    {name}_input codes;
    {name}_output answer;
    {name}_input_values in;
    {name}_output_values out;
    {name}_reset(&state);
    while (scanf("{"%lf" * len(read)}", {", ".join(f"&{x}" for x in read)}) == {len(read)})
    {{
        (void){name}_encode(&in, &codes);
        {name}_step(&state, &codes, &answer);
        {name}_decode(&answer, &out);
        (void)printf("{" ".join(["%.17g"] * len(shown))}\\n", {", ".join(shown)});
    }}
    return 0;
}}
"""
