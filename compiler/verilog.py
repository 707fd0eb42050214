"""What all architectures write alike: names, numbers, instances, tables, the stream at the edge (Verilog-2005)."""

import re
from collections.abc import Callable, Sequence
from dataclasses import fields as dataclass_fields
from functools import cache
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined

from greygate.emulator.numbers import Rounding
from greygate.emulator.program import (
    Clamp,
    Elementwise,
    Lookup,
    Op,
    Operation,
    Product,
    Program,
    Select,
    Signal,
    Threshold,
)
from greygate.emulator.tables import Lines, Segments, Symmetry, Table
from greygate.errors import InputError, one_line
from greygate.names import CORE_NAMES, CORE_PORTS, KEYWORDS

ROUNDING = {Rounding.TRUNCATE: 0, Rounding.HALF_UP: 1, Rounding.HALF_EVEN: 2}
LOOKUP_CLOCKS = 3  # clocks from a code to the answer of a table: word, product, sum
PRODUCT_CLOCKS = 2  # clocks from two codes to their product: exact, in its format
LATE_CLOCKS = 4  # clocks of a table with a register behind the memory
MEMORIES = {"block": '(* rom_style = "block" *) ', "logic": '(* rom_style = "logic" *) '}  # and how a tool is told
LONGEST = 110  # characters of a line of items
SYMMETRY = {Symmetry.ODD: 0, Symmetry.EVEN: 1, Symmetry.COMPLEMENT: 2}
TEMPLATES = Path(__file__).with_name("templates")
TOOLS = "verilator synopsys synthesis pragma ambit cadence synplify altera xilinx vcs coverage lint translate"
DIRECTIVE = re.compile(rf"\W*({'|'.join(TOOLS.split())})", re.IGNORECASE)  # how a comment begins that a tool obeys


def verilog_names(program: Program) -> dict[str, str]:
    """Every signal's name in Verilog: the program's own, with "__" for ".", or longer by a word where it is taken.

    Raises InputError where that fails.
    """
    names = {s: _free(s.replace(".", "__")) for s in program.signals}
    tables = [(t.name, table_module(program, t)) for t in program.tables]
    for original, name in [(program.name, program.name), *names.items(), *tables]:
        holdable(original, name)
    taken = dict.fromkeys((*CORE_NAMES, program.name), "a port or part of the core")
    for original, name in names.items():
        for used in (name, f"{name}_layer"):
            if used in taken:
                raise InputError(f"{original}: its name in Verilog is also that of {taken[used]}; rename one")
            taken[used] = original
    modules = [program.name, *(f"{program.name}_{names[o.out.name]}" for o in program.operations)]
    modules += [module for _, module in tables]
    for name in modules:
        if modules.count(name) > 1:
            raise InputError(f"{program.name}: two modules would be called {name}; rename an operation or a table")
    return names


def _free(name: str) -> str:
    taken = name in KEYWORDS or name in CORE_NAMES or name.startswith("greygate_")
    return f"{name}_signal" if taken else name


def holdable(original: str, name: str) -> None:
    """Raise InputError for a name that Verilog cannot hold. original: as it stands in the program."""
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) or name in KEYWORDS or name.startswith("greygate_"):
        said = one_line(original)
        raise InputError(f"{said}: not a name that Verilog can hold; use letters, digits and _, no keyword")


def number(value: int, width: int) -> str:
    """A signed decimal constant of a given width."""
    return f"{'-' if value < 0 else ''}{width}'sd{abs(int(value))}"


def packed(codes, width: int) -> str:
    """Codes side by side, element 0 in the least significant bits."""
    parts = [number(c, width) for c in reversed(list(codes))]
    return parts[0] if len(parts) == 1 else "{" + ", ".join(parts) + "}"


def lane_width(signal: Signal) -> int:
    """Bits that one code takes on AXI4-Stream: a whole number of bytes."""
    return (signal.fix.width + 7) // 8 * 8


def instance(module: str, name: str, parameters: dict, ports: dict, indent: str = "    ") -> str:
    """An instance with named parameters and ports."""

    def listed(pairs):
        return ",\n".join(f"{indent}    .{k}({v})" for k, v in pairs.items())

    head = (
        f"{indent}{module} #(\n{listed(parameters)}\n{indent}) {name} (" if parameters else f"{indent}{module} {name} ("
    )
    return f"{head}\n{listed(ports)}\n{indent});\n"


def wrapped(items: list[str], indent: str) -> str:
    """Items joined into lines of at most LONGEST characters."""
    lines, line = [], indent
    for item in items:
        if len(line) + len(item) > LONGEST and line.strip():
            lines.append(line.rstrip())
            line = indent
        line += item + " "
    return "\n".join([*lines, line.rstrip()])


def remark(text: str) -> str:
    """The text as a comment to the end of its line, which holds nothing but text whatever the text is.

    No end of line, no macro, no backslash that joins lines, no end of another comment, no directive to a tool.
    """
    plain = "".join(c if c.isprintable() and c not in "\\`" else "?" for c in text)
    plain = plain.replace("*/", "* /").replace("/*", "/ *")
    return f"// {'- ' if DIRECTIVE.match(plain) else ''}{plain}".rstrip()


def module_text(head: list[str], body: str) -> str:
    """A file: comment lines, then one module without implicit nets."""
    lines = "".join(remark(line) + "\n" for line in head)
    return f"{lines}\n`default_nettype none\n\n{body}\nendmodule\n\n`default_nettype wire\n"


def stream_widths(program: Program) -> dict[str, int]:
    """Bits of the two streams, as templates call them."""
    sides = {"width_in": program.inputs, "width_out": program.outputs}
    found = {name: sum(lane_width(p.signal) * p.signal.size for p in ports) for name, ports in sides.items()}
    if not all(found.values()):
        raise InputError(f"program {program.name}: hardware needs at least one input and one output")
    return found


def header(program: Program, architecture: str) -> list[str]:
    """Comment lines on top of the top: what this is, and where each signal stands in the two streams."""
    lines = [
        f"{program.name}: {architecture} architecture. Written by greygate; change the network, not this file.",
        "",
    ]
    for title, ports in (("s_axis_tdata", program.inputs), ("m_axis_tdata", program.outputs)):
        start = 0
        for p in ports:
            width = lane_width(p.signal) * p.signal.size
            of = "" if p.name == p.signal.name else f" shows {p.signal.name},"
            lines.append(
                f"{title}[{start + width - 1}:{start}]: {p.name},{of} {p.signal.size} x {p.signal.fix}, "
                f"value = code * {p.signal.fix.lsb * p.scale!r}{f' + {p.offset!r}' if p.offset else ''}"
                + (f" {p.unit}" if p.unit != "1" else "")
            )
            start += width
    return lines


def input_slices(program: Program) -> list[tuple[Signal, int, int]]:
    """(signal, element, lowest bit of its lane in the sample) of every input code, in order."""
    slices, start = [], 0
    for p in program.inputs:
        for k in range(p.signal.size):
            slices.append((p.signal, k, start))
            start += lane_width(p.signal)
    return slices


def unused_bits(program: Program) -> list[str]:
    """The sign extension in each lane of the sample, which the core does not look at."""
    lanes = [(start + s.fix.width, start + lane_width(s) - 1) for s, _, start in input_slices(program)]
    return [f"sample[{hi}:{lo}]" for lo, hi in lanes if hi >= lo]


def sign_extended(name: str, low: int, width: int, lane: int) -> str:
    """The code at bit `low` of a vector, extended to the width of its lane."""
    code = f"{name}[{low + width - 1}:{low}]"
    return code if lane == width else f"{{{{{lane - width}{{{name}[{low + width - 1}]}}}}, {code}}}"


class Layout(NamedTuple):
    """Where a table stands in its memory: {base, slope} of each word, and the address of each octave's first.

    An octave begins at a multiple of its number of segments, so that an address needs no adder. lefts: the least code
    of each word.
    """

    words: list[tuple[int, int]]
    firsts: list[int]
    lefts: list[int]


def table_layout(table: Table | Lines) -> Layout:
    """The words of a memory: longer octaves first; a base with the rounding constant where it has fraction bits.

    Plain points have slope 0.
    """
    if isinstance(table, Table) and not table.interpolated:
        return Layout([(p, 0) for p in table.points], [0], [k << table.shift for k in range(len(table.points))])
    s = table.segments
    ends = [*s.firsts[1:], len(s.bases)]
    counts = [end - first for first, end in zip(s.firsts, ends, strict=True)]
    firsts = [0] * len(counts)
    words: list[tuple[int, int]] = []
    lefts: list[int] = []
    for o in sorted(range(len(counts)), key=lambda o: -(counts[o] - 1).bit_length()):
        room = 1 << (counts[o] - 1).bit_length()
        idle = -len(words) % room  # only after an octave that is not full
        words += [(0, 0)] * idle
        lefts += [0] * idle
        firsts[o] = len(words)
        for k in range(counts[o]):
            i = s.firsts[o] + k
            words.append((s.bases[i] + s.halves[1], s.slopes[i]))
            lefts.append(s.lefts[o] + (k << s.shifts[o]))
    return Layout(words, firsts, lefts)


def least_width(values: Sequence[int]) -> tuple[int, int]:
    """(bits, signed) of the least numbers that hold all values; signed is 0 if none is negative."""
    if min(values) < 0:
        return max(v.bit_length() if v >= 0 else (~v).bit_length() for v in values) + 1, 1
    return max(1, max(values).bit_length()), 0


def table_parameters(table: Table | Lines) -> dict:
    """Parameters of the lookup of one neuron."""
    words, firsts, _ = table_layout(table)
    bases, slopes = zip(*words, strict=True)
    (base, base_signed), (slope, slope_signed) = least_width(bases), least_width(slopes)
    one = 1 << max(0, table.out.frac) if table.symmetry is Symmetry.COMPLEMENT else 0
    s = table.segments
    if isinstance(table, Table) and not table.interpolated:
        s = Segments(table.arg.width, (table.shift,), (table.shift,), 0, 0, table.points, ())
    return {
        "ARG_W": table.arg.width,
        "OUT_W": table.out.width,
        "INTERPOLATED": int(table.interpolated),
        "SYMMETRY": SYMMETRY[table.symmetry],
        "ONE": f"{table.out.width + 1}'d{one}",
        "START": s.start,
        "OCTAVES": len(s.shifts),
        "SHIFTS": fields(s.shifts, 8),
        "DROPS": fields(s.drops, 8),
        "FIRSTS": fields(firsts, 32),
        "COUNT": len(s.bases) - s.firsts[-1],
        "PLACE_W": max(1, *(shift - drop for shift, drop in zip(s.shifts, s.drops, strict=True)), 1),
        "ADDRESS_W": max(1, (len(words) - 1).bit_length()),
        "SLOPE_FRAC": s.slope_frac,
        "GUARD": s.guard,
        "BASE_W": base,
        "BASE_SIGNED": base_signed,
        "SLOPE_W": slope,
        "SLOPE_SIGNED": slope_signed,
    }


def fields(values: Sequence[int], width: int) -> str:
    """Unsigned numbers side by side, the first in the least significant bits."""
    return "{" + ", ".join(f"{width}'d{v}" for v in reversed(values)) + "}"


def shared_tables(program: Program) -> dict[str, Table | Lines]:
    """Name of each table that is used -> the first table equal to it, whose module they share."""
    used = {o.table for o in program.operations if isinstance(o, Lookup)}
    alike = {}
    first: dict[tuple, Table | Lines] = {}
    for t in program.tables:
        if t.name in used:
            key = tuple(
                getattr(t, f.name) for f in dataclass_fields(t) if f.name not in ("name", "function", "worst_error")
            )
            alike[t.name] = first.setdefault(key, t)
    return alike


def table_module(program: Program, table: Table | Lines) -> str:
    return f"{program.name}_table_{table.name}".replace(".", "__")


def table_kind(table: Table | Lines) -> str:
    """What the table holds, in words."""
    if isinstance(table, Lines):
        return f"{len(table.bases)} lines over {len(table.shifts)} octave{'s' if len(table.shifts) > 1 else ''}"
    return f"{len(table.points)} points, {'a line between two' if table.interpolated else 'the nearest'}"


def table_text(program: Program, table: Table | Lines, memory: str = "block", late: bool = False) -> str:
    """A module that answers SIZE neurons from the table, whose words it holds in a memory for every two neurons.

    memory: where the words are kept, a key of MEMORIES. late: with a register behind the memory, for a higher clock
    rate; an answer takes LATE_CLOCKS.
    """
    parameters = table_parameters(table) | ({"LATE": 1} if late else {})
    arg, out, address, base, slope = (parameters[k] for k in ("ARG_W", "OUT_W", "ADDRESS_W", "BASE_W", "SLOPE_W"))
    words, _, lefts = table_layout(table)
    unit = table.out.lsb * 2.0 ** -(table.segments.guard if table.interpolated else 0)
    kept = [f"{{{slope}'d{d % (1 << slope)}, {base}'d{b % (1 << base)}}}" for b, d in words]
    means = [f"from {left * table.arg.lsb:g}: {b * unit:g}" for (b, _), left in zip(words, lefts, strict=True)]

    def lookup(n: str, side: str, indent: str) -> str:
        ends = {"clk": "clk", "en": "en", "x": f"x[{n}*{arg}+:{arg}]", "address": f"address_{side}"}
        ends |= {"base": f"word_{side}[{base - 1}:0]", "slope": f"word_{side}[{base + slope - 1}:{base}]"}
        multiplier = {"MULTIPLIER": f"{n} < MULTIPLIERS ? 1 : 0"}
        ends |= {"y": f"y[{n}*{out}+:{out}]"}
        return instance("greygate_lookup", f"lookup_{side}", parameters | multiplier, ends, indent)

    rows = [f"rom[{k}] = {word};  // {meaning}" for k, (word, meaning) in enumerate(zip(kept, means, strict=True))]
    context = {"module": table_module(program, table), "style": MEMORIES[memory], "rows": rows, "lookup": lookup}
    context |= {"arg": arg, "out": out, "address": address, "base": base, "slope": slope, "late": late}
    head = [
        f"Table {table.name}: {table.function} from {table.arg} to {table.out}, {table_kind(table)}.",
        f"{table.symmetry.value.capitalize()} symmetry. Worst error over every input code: {table.worst_error:g}.",
        "Two neurons read one memory of words {slope, base}, which has two ports for reading.",
    ]
    return module_text(head, render("table.v", context))


def table_texts(program: Program, memory: str = "block", late: bool = False) -> dict[str, str]:
    """File name -> text of the module of every table that is used."""
    tables = shared_tables(program).values()
    return {f"{table_module(program, t)}.v": table_text(program, t, memory, late) for t in tables}


def clocks(o: Operation) -> int:
    """Clocks from the arguments of an operation to its result."""
    return {Op.TABLE: LOOKUP_CLOCKS, Op.PRODUCT: PRODUCT_CLOCKS}.get(o.op, 1)


# Each small operation of `size` elements: module, parameters, and the ports that take its arguments, in their order.
Block = tuple[str, dict, tuple[str, ...]]


def _lookup(program: Program, o: Lookup, size: int) -> Block:
    return table_module(program, shared_tables(program)[o.table]), {"SIZE": size}, ("x",)


def _clamp(program: Program, o: Clamp, size: int) -> Block:
    arg, out = program.signals[o.arg].fix, o.out.fix
    parameters = {"SIZE": size, "ARG_W": arg.width, "OUT_W": out.width}
    parameters |= {"SHIFT": arg.frac - out.frac, "ROUNDING": ROUNDING[o.rounding]}
    return "greygate_clamp", parameters | {"LO": number(o.lo, arg.width), "HI": number(o.hi, arg.width)}, ("x",)


def _threshold(program: Program, o: Threshold, size: int) -> Block:
    arg, out = program.signals[o.arg].fix, o.out.fix
    parameters = {"SIZE": size, "ARG_W": arg.width, "OUT_W": out.width, "AT": number(o.at, arg.width)}
    answers = {"BELOW": number(o.below, out.width), "ABOVE": number(o.above, out.width)}
    return "greygate_threshold", parameters | answers, ("x",)


def _select(program: Program, o: Select, size: int) -> Block:
    condition, above, below = (program.signals[a].fix for a in o.args)
    frac = max(above.frac, below.frac)
    widths = {"CONDITION_W": condition.width, "ABOVE_W": above.width, "BELOW_W": below.width}
    left = {"ABOVE_LEFT": frac - above.frac, "BELOW_LEFT": frac - below.frac}
    rounding = {"SHIFT": frac - o.out.fix.frac, "ROUNDING": ROUNDING[o.rounding]}
    parameters = {"SIZE": size} | widths | {"OUT_W": o.out.fix.width} | left | rounding
    return "greygate_select", parameters, ("condition", "above", "below")


def _product(program: Program, o: Product, size: int) -> Block:
    one, other = (program.signals[a].fix for a in o.args)
    parameters = {"SIZE": size, "ONE_W": one.width, "OTHER_W": other.width, "OUT_W": o.out.fix.width}
    parameters |= {"SHIFT": one.frac + other.frac - o.out.fix.frac, "ROUNDING": ROUNDING[o.rounding]}
    return "greygate_multiply", parameters, ("one", "other")


_BLOCKS: dict[Op, Callable] = {
    Op.TABLE: _lookup,
    Op.CLAMP: _clamp,
    Op.THRESHOLD: _threshold,
    Op.SELECT: _select,
    Op.PRODUCT: _product,
}


def small_operation(program: Program, o: Elementwise, size: int) -> Block:
    """The block that computes `size` elements of a table, clamp, threshold, select or product, in `clocks`."""
    return _BLOCKS[o.op](program, o, size)


def unused_text(bits: Sequence[str], comment: str = "") -> str:
    """A wire that reads bits which nothing else reads, so that no tool warns of them; nothing if there are none."""
    if not bits:
        return ""
    listed = wrapped([f"{b}," for b in bits], "        ")
    return f"    wire unused = &{{\n{listed} 1'b0\n    }};{comment}\n"


def result_text(lanes: Sequence[str]) -> str:
    """The word of the output stream, from its lanes, the lowest first."""
    listed = ",\n".join(f"        {lane}" for lane in reversed(lanes))
    return f"    assign result = {{\n{listed}\n    }};\n\n"


def stream_instance(width_in: int, width_out: int) -> str:
    """The edge of the core."""
    ports = {p: p for p in CORE_PORTS} | {"ready": "1'b1"} | {p: p for p in ("sample", "start", "done", "result")}
    return instance("greygate_stream", "stream", {"IN_W": width_in, "OUT_W": width_out}, ports)


def skid_instance(width: int, beat: str, valid: str, take: str) -> str:
    """The entry of a core, which answers with a register. beat, valid, take: names of wires."""
    ports = {p: p for p in CORE_PORTS if not p.startswith("m_axis")} | {"beat": beat, "valid": valid, "take": take}
    return instance("greygate_skid", "skid", {"W": width}, ports)


@cache
def _environment(package: str) -> Environment:
    found = Environment(
        loader=PackageLoader(package, "templates"),
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    found.filters["remark"] = remark
    return found


def render(template: str, context: dict, package: str = __package__) -> str:
    """The template of that name in the folder of a package, filled in."""
    return _environment(package).get_template(f"{template}.j2").render(context)
