"""The model of a compiled network: its step in C99, bit for bit the emulator's, between values in physical units."""

from dataclasses import replace

from greygate.compiler.verilog import render
from greygate.emulator.program import Program, Terminal
from greygate.export import values
from greygate.export.model import Model, Variable

CLIPPED = "clipped_values"  # the name of the count; a port of that name keeps it


def model(program: Program, title: str) -> Model:
    """The model of a program. Its outputs of sample n are there once the time of sample n + 1 is reached."""
    inputs = tuple(v for p in program.inputs for v in _variables(p, p.offset))
    outputs = tuple(v for p in program.outputs for v in _variables(p, None))
    taken = {v.name for v in (*inputs, *outputs)}
    name = next(n for n in (CLIPPED, *(f"{CLIPPED}_{k}" for k in range(2, 9999))) if n not in taken)
    seen = (Variable(name, "", None, "input values so far that their formats do not hold"),)
    entered, left = values.fields(program)
    places = [f"in.{entered[p.name]}[{r}]" for p in program.inputs for r in range(p.signal.size)]
    answers = [f"out.{left[p.name]}[{r}]" for p in program.outputs for r in range(p.signal.size)]
    n = len(inputs)
    made = Model(
        name=program.name,
        meaning=title,
        period=program.period,
        discrete=True,
        inputs=inputs,
        parameters=(),
        outputs=outputs,
        seen=seen,
        state=("double begun;", "int64_t done;", f"{program.name}_state state;"),
        includes=(f"{program.name}_values.h",),
        sources={},
    )
    context = {
        "starts": made.starts,
        "name": program.name,
        "clipped": n + len(outputs),
        "read": "\n".join(f"        {place} = m->value[{i}];" for i, place in enumerate(places)),
        "written": "\n".join(f"        m->value[{n + i}] = {answer};" for i, answer in enumerate(answers)),
    }
    source = render("network.c", context, "greygate.export")
    files = {k: text for k, text in values.files(program).items() if k != values.EXAMPLE}
    return replace(made, sources={**files, "model.c": source})


def _variables(p: Terminal, start: float | None) -> list[Variable]:
    """A variable for a port; one for each element of a port of several, name[1], name[2], ..."""
    meaning = f"{p.signal.fix}, step {p.signal.fix.lsb * p.scale:.6g}"
    names = [p.name] if p.signal.size == 1 else [f"{p.name}[{r + 1}]" for r in range(p.signal.size)]
    return [Variable(name, p.unit, start, meaning) for name in names]
