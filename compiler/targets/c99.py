"""A step of the program in C99: one header and one source that need nothing but <stdint.h>.

It allocates nothing, and nothing in it is undefined or left to the compiler. Every intermediate result of a legal
program has at most 62 bits, so int64_t holds it; a negative number is never shifted. The text of each operation is that
of docs/integer-program.md.
"""

import re
from collections.abc import Iterable, Iterator
from textwrap import wrap
from typing import Any

import numpy as np

from greygate.compiler.targets import Target
from greygate.compiler.verilog import render
from greygate.emulator.numbers import ACCUMULATOR_BITS, Fix, Rounding
from greygate.emulator.program import Affine, Program, Terminal
from greygate.emulator.tables import Lines, Symmetry, Table

WORDS = (8, 16, 32, 64)  # bits of the integer types
LINE, NEW = 110, "\n"  # characters of a line of constants
HALF = {Rounding.TRUNCATE: 0, Rounding.HALF_UP: 1, Rounding.HALF_EVEN: 2}
Text = Iterator[str]


def files(program: Program) -> dict[str, str]:
    """File name -> text."""
    context: dict[str, Any] = {"name": program.name, "program": program, "integer": integer, "meaning": _meaning}
    context |= {"states": identifiers("s_", (s.signal.name for s in program.states))}
    context |= {"signals": identifiers("v_", program.signals)}
    context |= {"inputs": identifiers("in_", (p.name for p in program.inputs))}
    context |= {"outputs": identifiers("out_", (p.name for p in program.outputs))}
    sides = [("input", context["inputs"], program.inputs), ("output", context["outputs"], program.outputs)]
    rounds = any(o.requantizes for o in program.operations)
    context |= {"sides": sides, "rounds": rounds, "shifts": rounds or any(_on_lines(t) for t in program.tables)}
    context |= {"constants": list(_data(program, context["states"]))}
    context |= {"reset": list(_reset(program, context["states"])), "step": list(_step(program, context))}
    return {f"{program.name}.{end}": render(f"c99.{end}", context) for end in "ch"}


def identifiers(prefix: str, names: Iterable[str]) -> dict[str, str]:
    """Name -> C identifier: the prefix keeps it from every keyword, a number from every other name."""
    found: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        plain = prefix + re.sub(r"\W", "_", name, flags=re.ASCII)
        chosen, n = plain, 2
        while chosen in taken:
            chosen, n = f"{plain}_{n}", n + 1
        taken.add(chosen)
        found[name] = chosen
    return found


def integer(fix: Fix) -> str:
    return f"int{next(w for w in WORDS if w >= fix.width)}_t"


def _type_of(values: np.ndarray) -> str:
    """The smallest type that holds every value."""
    lo, hi = int(values.min()), int(values.max())
    return f"int{next(w for w in WORDS if -(1 << (w - 1)) <= lo and hi < 1 << (w - 1))}_t"


def number(value: int) -> str:
    return str(value) if abs(value) < 1 << 31 else f"INT64_C({value})"


def _constants(name: str, values: object) -> Text:
    """A constant array of one or two dimensions."""
    array = np.array(values, np.int64)
    dims = "".join(f"[{n}]" for n in array.shape)
    yield f"static const {_type_of(array)} {name}{dims} = {{"
    for row in array if array.ndim == 2 else [array]:
        lines = wrap(", ".join(map(number, row.tolist())), LINE)
        opened, closed = ("{", "},") if array.ndim == 2 else ("", "")
        yield from (f"    {line}" for line in f"{opened}{NEW.join(lines)}{closed}".split(NEW))
    yield "};"


def _meaning(p: Terminal) -> str:
    """The comment behind a port: its format, and what a code stands for."""
    unit = re.sub(r"[^\w^/%°·µ² .-]", "", p.unit)
    return f"/* {p.signal.fix}, step {p.signal.fix.lsb * p.scale:.9g}, offset {p.offset:.9g}, unit {unit} */"


def _data(program: Program, states: dict[str, str]) -> Text:
    """Tables, weights and initial codes, each behind an empty line."""
    for t in program.tables:
        yield from ("", *_lookup_function(t, _tables(program)[t.name]))
    for n, o in enumerate(program.operations):
        if isinstance(o, Affine):
            yield from ("", *_weights(program, n, o))
    yield ""
    for s in program.states:
        yield from _constants(f"initial_{states[s.signal.name]}", s.initial)


def _reset(program: Program, states: dict[str, str]) -> Text:
    for s in program.states:
        field = states[s.signal.name]
        yield from each(s.signal.size, f"state->{field}[r] = initial_{field}[r];")
    yield from () if program.states else ["    state->none = 0;"]


def _step(program: Program, context: dict) -> Text:
    """What a step does, behind its declarations."""
    signals, states, tables = context["signals"], context["states"], _tables(program)
    for p in program.inputs:
        yield from each(p.signal.size, f"{signals[p.signal.name]}[r] = input->{context['inputs'][p.name]}[r];")
    for s in program.states:
        yield from each(s.signal.size, f"{signals[s.signal.name]}[r] = state->{states[s.signal.name]}[r];")
    yield from () if program.states else ["    (void)state;"]
    yield from (f"    (void){signals[name]};" for name in _unread(program))
    for n, o in enumerate(program.operations):
        yield f"    /* {n}: {o.op.value} {re.sub(r'[^ -~]', '?', o.out.name)} {o.out.fix} */"
        own = {"n": n, "o": o, "to": signals[o.out.name], "tables": tables, "number": number}
        body = render("c99_operation", context | own | {"half": HALF, "most": ACCUMULATOR_BITS})
        yield from each(o.out.size, *body.splitlines())
    for p in program.outputs:
        yield from each(p.signal.size, f"output->{context['outputs'][p.name]}[r] = {signals[p.signal.name]}[r];")
    for s in program.states:
        yield from each(s.signal.size, f"state->{states[s.signal.name]}[r] = {signals[s.source]}[r];")


def _tables(program: Program) -> dict[str, str]:
    return identifiers("lookup_", (t.name for t in program.tables))


def _on_lines(t: Table | Lines) -> bool:
    return isinstance(t, Lines) or t.interpolated


def _unread(program: Program) -> list[str]:
    """Signals that no operation, state or output reads."""
    read = {a for o in program.operations for a in o.args}
    read |= {s.source for s in program.states} | {p.signal.name for p in program.outputs}
    return [name for name in program.signals if name not in read]


def each(size: int, *body: str) -> Text:
    """A loop over the elements r of a signal; a signal of one element needs none."""
    if size > 1:
        yield from (
            f"    for (int32_t r = 0; r < {size}; r++)",
            "    {",
            *(f"        {line}" for line in body),
            "    }",
        )
    elif len(body) == 1:
        yield f"    {body[0].replace('[r]', '[0]')}"
    else:
        yield from ("    {", *(f"        {line.replace('[r]', '[0]')}" for line in body), "    }")


def _weights(program: Program, n: int, o: Affine) -> Text:
    start = 0
    for k, arg in enumerate(o.args):
        size = program.signals[arg].size
        yield from _constants(f"w{n}_{k}", o.weights[:, start : start + size])
        start += size
    yield from _constants(f"b{n}", o.bias)
    yield from _constants(f"s{n}", np.minimum(o.frac - o.out.fix.frac, ACCUMULATOR_BITS))


def _lookup_function(t: Table | Lines, name: str) -> Text:
    """The answer of a table to one code."""
    s = t.segments
    context: dict[str, Any] = {"t": t, "s": s, "name": name, "half": number((1 << s.shifts[0]) >> 1)}
    if isinstance(t, Table) and not t.interpolated:
        yield from _constants(f"{name}_points", t.points)
        context["last"] = len(t.points) - 1
    else:
        lefts = [min(left, 1 << ACCUMULATOR_BITS) for left in s.lefts]  # no code has so many bits
        parts = ("left", lefts), ("first", s.firsts), ("shift", s.shifts), ("drop", s.drops)
        for part, values in (*parts, ("base", s.bases), ("slope", s.slopes)):
            yield from _constants(f"{name}_{part}", values)
        context["last"], (context["lower"], context["upper"]) = len(s.bases) - 1, map(number, s.halves)
    one = number(1 << max(0, t.out.frac))
    negative = {Symmetry.ODD: "-y", Symmetry.EVEN: "y", Symmetry.COMPLEMENT: f"{one} - y"}[t.symmetry]
    yield render("c99_table", context | {"negative": negative, "points": not _on_lines(t)}).rstrip()


TARGET = Target(lambda program, design: files(program))
