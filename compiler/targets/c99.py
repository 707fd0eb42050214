"""A step of the program in C99: one header and one source that need nothing but <stdint.h>.

It allocates nothing, and nothing in it is undefined or left to the compiler. Every intermediate result of a legal
program has at most 62 bits, so int64_t holds it; a negative number is never shifted. The text of each operation is that
of docs/integer-program.md.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from textwrap import wrap
from typing import Any

import numpy as np

from greygate.compiler.targets import Target
from greygate.compiler.verilog import render
from greygate.emulator.numbers import ACCUMULATOR_BITS, Fix, Overflow, Rounding
from greygate.emulator.program import Affine, Clamp, Lookup, Op, Program, Select, Signal, Terminal, Threshold
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
        yield from _BODY[o.op](program, n, o, signals, tables)
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


def _fitted(n: int, program: Program, out: Signal, to: str, overflow: Overflow) -> list[str]:
    """Bring the int64_t y into the format of `out`, and store it."""
    fix, told = out.fix, f"{program.name.upper()}_SATURATED({n});"
    lo, hi = number(fix.lo), number(fix.hi)
    store = f"{to}[r] = ({integer(fix)})y;"
    if overflow is Overflow.SATURATE:
        ends = [
            [f"if (y {sign} {end})", "{", f"    y = {end};", f"    {told}", "}"] for sign, end in (("<", lo), (">", hi))
        ]
        return [*ends[0], *ends[1], store]
    mask, turn = (1 << fix.width) - 1, number(1 << fix.width)
    wrapped = [f"y = (int64_t)((uint64_t)y & UINT64_C({mask}));", f"y = (y > {hi}) ? (y - {turn}) : y;"]
    return [f"if ((y < {lo}) || (y > {hi}))", "{", *(f"    {line}" for line in (*wrapped, told)), "}", store]


def _drop(value: Fix, out: Fix) -> int:
    """Fraction bits that are lost, at most ACCUMULATOR_BITS: more give the same result."""
    return min(value.frac - out.frac, ACCUMULATOR_BITS)


def _weights(program: Program, n: int, o: Affine) -> Text:
    start = 0
    for k, arg in enumerate(o.args):
        size = program.signals[arg].size
        yield from _constants(f"w{n}_{k}", o.weights[:, start : start + size])
        start += size
    yield from _constants(f"b{n}", o.bias)
    yield from _constants(f"s{n}", np.minimum(o.frac - o.out.fix.frac, ACCUMULATOR_BITS))


def _affine(program: Program, n: int, o: Affine, signals: dict[str, str], tables: dict[str, str]) -> Text:
    sums = []
    for k, arg in enumerate(o.args):
        term = f"y += (int64_t)w{n}_{k}[r][j] * (int64_t){signals[arg]}[j];"
        size = program.signals[arg].size
        loop = [f"for (int32_t j = 0; j < {size}; j++)", "{", f"    {term}", "}"]
        sums += loop if size > 1 else [term.replace("[j]", "[0]")]
    scaled = f"y = scaled(y, (int32_t)s{n}[r], {HALF[o.rounding]});"
    fitted = _fitted(n, program, o.out, signals[o.out.name], o.overflow)
    yield from each(o.out.size, f"int64_t y = (int64_t)b{n}[r];", *sums, scaled, *fitted)


def _lookup(program: Program, n: int, o: Lookup, signals: dict[str, str], tables: dict[str, str]) -> Text:
    answer = f"{tables[o.table]}((int64_t){signals[o.arg]}[r])"
    yield from each(o.out.size, f"{signals[o.out.name]}[r] = ({integer(o.out.fix)}){answer};")


def _clamp(program: Program, n: int, o: Clamp, signals: dict[str, str], tables: dict[str, str]) -> Text:
    lo, hi = number(o.lo), number(o.hi)
    shift = _drop(program.signals[o.arg].fix, o.out.fix)
    limited = [
        f"int64_t y = (int64_t){signals[o.arg]}[r];",
        f"y = (y < {lo}) ? {lo} : y;",
        f"y = (y > {hi}) ? {hi} : y;",
    ]
    scaled = f"y = scaled(y, {shift}, {HALF[o.rounding]});"
    yield from each(o.out.size, *limited, scaled, *_fitted(n, program, o.out, signals[o.out.name], o.overflow))


def _threshold(program: Program, n: int, o: Threshold, signals: dict[str, str], tables: dict[str, str]) -> Text:
    chosen = f"((int64_t){signals[o.arg]}[r] >= {number(o.at)}) ? {number(o.above)} : {number(o.below)}"
    yield from each(o.out.size, f"{signals[o.out.name]}[r] = ({integer(o.out.fix)})({chosen});")


def _select(program: Program, n: int, o: Select, signals: dict[str, str], tables: dict[str, str]) -> Text:
    def scaled(arg: str) -> str:
        shift = _drop(program.signals[arg].fix, o.out.fix)
        return f"scaled((int64_t){signals[arg]}[r], {shift}, {HALF[o.rounding]})"

    chosen = f"int64_t y = ({signals[o.condition]}[r] >= 0) ? {scaled(o.above)} : {scaled(o.below)};"
    yield from each(o.out.size, chosen, *_fitted(n, program, o.out, signals[o.out.name], o.overflow))


_BODY: dict[Op, Callable[..., Text]] = {
    Op.AFFINE: _affine,
    Op.TABLE: _lookup,
    Op.CLAMP: _clamp,
    Op.THRESHOLD: _threshold,
    Op.SELECT: _select,
}


def _lookup_function(t: Table | Lines, name: str) -> Text:
    """The answer of a table to one code."""
    s = t.segments
    context: dict[str, Any] = {
        "t": t,
        "s": s,
        "name": name,
        "points": not _on_lines(t),
        "half": number((1 << s.shifts[0]) >> 1),
    }
    if isinstance(t, Table) and not t.interpolated:
        yield from _constants(f"{name}_points", t.points)
        context["last"] = len(t.points) - 1
    else:
        parts = ("left", s.lefts), ("first", s.firsts), ("shift", s.shifts), ("drop", s.drops)
        for part, values in (*parts, ("base", s.bases), ("slope", s.slopes)):
            yield from _constants(f"{name}_{part}", values)
        context["last"], (context["lower"], context["upper"]) = len(s.bases) - 1, map(number, s.halves)
    one = number(1 << max(0, t.out.frac))
    negative = {Symmetry.ODD: "-y", Symmetry.EVEN: "y", Symmetry.COMPLEMENT: f"{one} - y"}[t.symmetry]
    yield render("c99_table", context | {"negative": negative}).rstrip()


TARGET = Target(lambda program, design: files(program))
