"""Verilog-2005 from an integer program: the files, the names, and the parallel architecture.

The parallel architecture gives every layer hardware of its own and a register at its end: a step takes as many
clocks as the longest chain of operations, and three more. compiler/folded.py shares multipliers instead.
"""

import re
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from greygate import rtl
from greygate.emulator.program import Affine, Clamp, Lookup, Overflow, Program, Rounding, Signal, Symmetry, Table
from greygate.errors import InputError, replacing

ROUNDING = {Rounding.TRUNCATE: 0, Rounding.HALF_UP: 1, Rounding.HALF_EVEN: 2}
SYMMETRY = {Symmetry.ODD: 0, Symmetry.EVEN: 1, Symmetry.COMPLEMENT: 2}
PORTS = (
    "clk",
    "rst",
    "s_axis_tdata",
    "s_axis_tvalid",
    "s_axis_tready",
    "m_axis_tdata",
    "m_axis_tvalid",
    "m_axis_tready",
)
TAKEN = (*PORTS, "en", "stream", "sample", "start", "done", "ready", "result", "stage", "unused")
WORDS = """
always and assign automatic begin buf bufif0 bufif1 case casex casez cell cmos config deassign default defparam
design disable edge else end endcase endconfig endfunction endgenerate endmodule endprimitive endspecify endtable
endtask event for force forever fork function generate genvar highz0 highz1 if ifnone incdir include initial inout
input instance integer join large liblist library localparam macromodule medium module nand negedge nmos nor
noshowcancelled not notif0 notif1 or output parameter pmos posedge primitive pull0 pull1 pulldown pullup
pulsestyle_onevent pulsestyle_ondetect rcmos real realtime reg release repeat rnmos rpmos rtran rtranif0 rtranif1
scalared showcancelled signed small specify specparam strong0 strong1 supply0 supply1 table task time tran tranif0
tranif1 tri tri0 tri1 triand trior trireg unsigned use uwire vectored wait wand weak0 weak1 while wire wor xnor xor
bit byte logic int shortint longint do return break continue class new this super package import export interface
modport program property sequence assert assume cover final unique priority static void string enum struct union
type typedef virtual local protected pure rand ref var with within checker let global soft strong weak
"""
KEYWORDS = frozenset(WORDS.split())  # of Verilog-2005, and those of SystemVerilog that tools trip over


def emit(program: Program, folder: Path | str, architecture: str = "parallel", macs: int = 4) -> list[Path]:
    """Write the program as Verilog into `folder` and return the files, the top `<program>.v` first.

    The folder stands on its own: the building blocks used are copied into it, and `<program>.f` lists the sources.
    architecture: "parallel", or "folded" with `macs` multipliers. Either all files are written or none.
    Raises InputError for names that Verilog cannot hold, a program without input or output, an illegal option, or
    a folder that cannot be written.
    """
    from greygate.compiler.folded import folded  # which builds on this module

    program.check()
    if architecture not in ("parallel", "folded"):
        raise InputError(f"architecture {architecture!r} does not exist; choose parallel or folded")
    if architecture == "folded" and not 1 <= macs <= 256:
        raise InputError(f"{macs} multipliers are not in 1..256")
    texts = parallel(program) if architecture == "parallel" else folded(program, macs)
    blocks = sorted(set(re.findall(r"^ *(greygate_\w+) #\(", "".join(texts.values()), re.M)))
    if "greygate_clamp" in blocks:
        blocks = sorted({*blocks, "greygate_requantize"})
    texts |= {f"{b}.v": rtl.block(b).read_text() for b in blocks}
    texts[f"{program.name}.f"] = "\n".join(texts) + "\n"
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot make this folder ({error.strerror}); choose another") from None
    with ExitStack() as stack:
        for name, text in texts.items():
            stack.enter_context(replacing(folder / name)).write_text(text)
    return [folder / name for name in texts]


# Names and numbers


def verilog_names(program: Program) -> dict[str, str]:
    """Every signal's name in Verilog: the program's own, with "__" for "."; raises InputError where that fails."""
    names = {s: s.replace(".", "__") for s in program.signals}
    for original, name in [(program.name, program.name), *names.items()]:
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) or name in KEYWORDS or name.startswith("greygate_"):
            raise InputError(f"{original}: not a name that Verilog can hold; use letters, digits and _, no keyword")
    taken = dict.fromkeys((*TAKEN, program.name), "a port or part of the core")
    for original, name in names.items():
        for used in (name, f"{name}_layer"):
            if used in taken:
                raise InputError(f"{original}: its name in Verilog is also that of {taken[used]}; rename one")
            taken[used] = original
    modules = [program.name, *(f"{program.name}_{names[o.out.name]}" for o in program.operations)]
    modules += [f"{program.name}_table_{t.name}".replace(".", "__") for t in program.tables]
    for name in modules:
        if modules.count(name) > 1:
            raise InputError(f"{program.name}: two modules would be called {name}; rename an operation or a table")
    return names


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


def wrapped(items: list[str], indent: str, separator: str = " ", limit: int = 110) -> str:
    """Items joined into lines of at most `limit` characters."""
    lines, line = [], indent
    for item in items:
        if len(line) + len(item) > limit and line.strip():
            lines.append(line.rstrip())
            line = indent
        line += item + separator
    return "\n".join([*lines, line.rstrip()])


def module_text(comment: list[str], body: str) -> str:
    """A file: comment lines, then one module without implicit nets."""
    head = "".join(f"// {line}".rstrip() + "\n" for line in comment)
    return f"{head}\n`default_nettype none\n\n{body}\nendmodule\n\n`default_nettype wire\n"


def top_ports(program: Program) -> tuple[str, int, int]:
    """The top's port list, and the widths of its two streams."""
    width_in = sum(lane_width(p.signal) * p.signal.size for p in program.inputs)
    width_out = sum(lane_width(p.signal) * p.signal.size for p in program.outputs)
    if not width_in or not width_out:
        raise InputError(f"program {program.name}: hardware needs at least one input and one output")
    last_in, last_out = f"[{width_in - 1}:0]", f"[{width_out - 1}:0]"
    pad = max(len(last_in), len(last_out))
    rows = [
        f"input  wire {'':{pad}} clk",
        f"input  wire {'':{pad}} rst",
        f"input  wire {last_in:>{pad}} s_axis_tdata",
        f"input  wire {'':{pad}} s_axis_tvalid",
        f"output wire {'':{pad}} s_axis_tready",
        f"output wire {last_out:>{pad}} m_axis_tdata",
        f"output wire {'':{pad}} m_axis_tvalid",
        f"input  wire {'':{pad}} m_axis_tready",
    ]
    return ",\n".join(f"    {r}" for r in rows), width_in, width_out


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
                f"value = code * {p.signal.fix.lsb * p.scale:g}{f' + {p.offset:g}' if p.offset else ''} {p.unit}"
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


def table_parameters(table: Table, size: int) -> dict:
    """Parameters of a lookup for `size` neurons, but for the points."""
    return {
        "SIZE": size,
        "ARG_W": table.arg.width,
        "OUT_W": table.out.width,
        "SHIFT": table.shift,
        "LAST": len(table.points) - 1,
        "INTERPOLATED": int(table.interpolated),
        "SYMMETRY": SYMMETRY[table.symmetry],
        "ONE": f"{table.out.width + 1}'d{1 << max(0, table.out.frac) if table.symmetry is Symmetry.COMPLEMENT else 0}",
    }


def shared_tables(program: Program) -> dict[str, Table]:
    """Name of each table that is used -> the first table equal to it, whose module they share."""
    used = {o.table for o in program.operations if isinstance(o, Lookup)}
    alike, first = {}, {}
    for t in program.tables:
        if t.name in used:
            key = (t.symmetry, t.shift, t.points, t.interpolated, t.arg, t.out)
            alike[t.name] = first.setdefault(key, t)
    return alike


def table_module(program: Program, table: Table) -> str:
    return f"{program.name}_table_{table.name}".replace(".", "__")


def table_text(program: Program, table: Table) -> str:
    """A module that answers SIZE neurons from the table, which it holds."""
    w, last = table.out.width, len(table.points) - 1
    rows = []
    for k in range(last, -1, -1):
        p = table.points[k]
        x, y = k * 2.0**table.shift * table.arg.lsb, p * table.out.lsb
        rows.append(f"        {number(p, w)}{',' if k else ' '}  // points[{k}]: {x:g} -> {y:g}")
    listed = "\n".join(rows)
    ports = {"clk": "clk", "en": "en", "x": "x", "y": "y"}
    parameters = table_parameters(table, "SIZE") | {"POINTS": "POINTS"}
    return module_text(
        [
            f"Table {table.name}: {table.function} from {table.arg} to {table.out}, {last + 1} points"
            f" {'and a line between two' if table.interpolated else ', the nearest one'}.",
            f"{table.symmetry.value.capitalize()} symmetry. Worst error over every input code: {table.worst_error:g}.",
        ],
        f"module {table_module(program, table)} #(\n"
        f"    parameter SIZE = 1  // number of neurons\n) (\n"
        f"    input  wire clk,\n    input  wire en,\n"
        f"    input  wire [SIZE*{table.arg.width}-1:0] x,\n    output wire [SIZE*{w}-1:0] y\n);\n\n"
        f"    localparam [{(last + 1) * w - 1}:0] POINTS = {{\n{listed}\n    }};\n\n"
        + instance("greygate_lookup", "lookup", parameters, ports),
    )


# The parallel architecture


def levels(program: Program) -> dict[str, int]:
    """Signal -> the clock of a step, counted from 1, at whose end it stands; 0 for inputs and states."""
    level = dict.fromkeys(program.signals, 0)
    for o in program.operations:
        level[o.out.name] = 1 + max(level[a] for a in program.args(o))
    return level


def parallel(program: Program) -> dict[str, str]:
    """File name -> text of the parallel architecture, without the building blocks."""
    names = verilog_names(program)
    texts = {f"{program.name}.v": parallel_top(program, names)}
    for o in program.operations:
        if isinstance(o, Affine):
            texts[f"{program.name}_{names[o.out.name]}.v"] = affine_text(program, o, names)
    for table in shared_tables(program).values():
        texts[f"{table_module(program, table)}.v"] = table_text(program, table)
    return texts


def affine_text(program: Program, o: Affine, names: dict[str, str]) -> str:
    """One layer: a readable sum for each row, and its rounding."""
    width = program.accumulator_width(o)
    args = list(dict.fromkeys(o.args))
    taken = {"clk", "en", "unused", *(names[a] for a in args), names[o.out.name]}

    def fresh(name: str) -> str:
        while name in taken:
            name += "_"
        taken.add(name)
        return name

    columns = [(program.signals[a], k) for a in o.args for k in range(program.signals[a].size)]
    used = np.flatnonzero(np.any(o.weights != 0, axis=0))
    elements = list(dict.fromkeys(columns[j] for j in used))
    wire = {e: fresh(f"{names[e[0].name]}_{e[1]}") for e in elements}
    body = f"module {program.name}_{names[o.out.name]} (\n    input  wire clk,\n    input  wire en,\n"
    for a in args:
        s = program.signals[a]
        body += f"    input  wire [{s.size * s.fix.width - 1}:0] {names[a]},  // {s.size} x {s.fix}\n"
    y = names[o.out.name]
    out = o.out.fix
    body += f"    output wire [{o.out.size * out.width - 1}:0] {y}  // {o.out.size} x {out}\n);\n\n"
    for (s, k), name in wire.items():
        code = sign_extended(names[s.name], k * s.fix.width, s.fix.width, width)
        body += f"    wire signed [{width - 1}:0] {name} = {code};\n"
    missing = [
        f"{names[a]}[{(k + 1) * s.fix.width - 1}:{k * s.fix.width}]"
        for a in args
        for s in [program.signals[a]]
        for k in range(s.size)
        if (s, k) not in wire
    ]
    if missing:
        body += "    wire unused = &{1'b0, " + ", ".join(missing) + "};  // their weights are all zero\n"
    for r in range(o.out.size):
        weights = [(wire[columns[j]], columns[j], int(o.weights[r, j])) for j in used if o.weights[r, j]]
        frac = int(o.frac[r])
        floats = [f"{w * 2.0 ** (s.fix.frac - frac):+.6g} {s.name}[{k}]" for _, (s, k), w in weights]
        floats.append(f"{int(o.bias[r]) * 2.0**-frac:+.6g}")
        terms = [term(w, x, width) for x, _, w in weights]
        terms += [f"{'-' if o.bias[r] < 0 else '+'} {width}'sd{abs(int(o.bias[r]))}"] if o.bias[r] or not terms else []
        terms[0] = terms[0].removeprefix("+ ").replace("- ", "-", 1)
        total, row = fresh(f"sum_{r}"), fresh(f"row_{r}")
        parameters = {
            "IN_W": width,
            "OUT_W": out.width,
            "SHIFT": frac - out.frac,
            "ROUNDING": ROUNDING[o.rounding],
            "SATURATE": int(o.overflow is Overflow.SATURATE),
        }
        ports = {"clk": "clk", "en": "en", "a": total}
        ports["y"] = f"{y}[{(r + 1) * out.width - 1}:{r * out.width}]"
        body += "\n" + wrapped([f"{o.out.name}[{r}] =", *floats], "    // ") + "\n"
        body += f"    wire signed [{width - 1}:0] {total} =\n" + wrapped(terms, "        ") + ";\n"
        body += instance("greygate_requantize", row, parameters, ports)
    comment = [
        f"{o.out.name}: {o.out.size} rows of {len(columns)} columns ({', '.join(o.args)}) to {out},"
        f" rounding {o.rounding.value}, overflow {o.overflow.value}.",
        f"No sum overflows {width} bits, whatever the arguments. One clock.",
    ]
    return module_text(comment, body)


def term(weight: int, x: str, width: int) -> str:
    """weight * x with its sign in front; a power of two is a shift."""
    sign, size = ("-", -weight) if weight < 0 else ("+", weight)
    if size == 1:
        return f"{sign} {x}"
    if size & (size - 1) == 0:
        return f"{sign} ({x} <<< {size.bit_length() - 1})"
    return f"{sign} {width}'sd{size} * {x}"


def parallel_top(program: Program, names: dict[str, str]) -> str:
    """The top: registers of the states, one instance a layer, the two streams."""
    ports, width_in, width_out = top_ports(program)
    level = levels(program)
    depth = max(level.values())
    body = f"module {program.name} (\n{ports}\n);\n\n"
    body += f"    localparam DEPTH = {depth};  // clocks from start to done\n\n"
    body += f"    wire [{width_in - 1}:0] sample;\n    wire [{width_out - 1}:0] result;\n"
    body += "    wire start;\n"
    if depth:
        body += (
            "    reg [DEPTH-1:0] stage;  // stage[k]: clock k + 1 of a step, one step under way at a time\n"
            f"    wire done = stage[{depth - 1}];\n\n"
            f"    always @(posedge clk) stage <= rst ? {{DEPTH{{1'b0}}}} : "
            + ("start;\n" if depth == 1 else "{stage[DEPTH-2:0], start};\n")
        )
    else:
        body += "    wire done = start;\n"

    def vector(kind, s, tail):
        return f"    {kind} [{s.size * s.fix.width - 1}:0] {names[s.name]}{tail};  // {s.size} x {s.fix}\n"

    body += "\n    // inputs\n"
    slices = input_slices(program)
    for p in program.inputs:
        s = p.signal
        parts = [f"sample[{start + s.fix.width - 1}:{start}]" for t, _, start in slices if t is s]
        body += vector("wire", s, " = " + (parts[0] if s.size == 1 else "{" + ", ".join(reversed(parts)) + "}"))
    body += "\n    // layers\n"
    for o in program.operations:
        body += vector("wire", o.out, "")
    for o in program.operations:
        y = names[o.out.name]
        en = "start" if level[o.out.name] == 1 else f"stage[{level[o.out.name] - 2}]"
        ends = {"clk": "clk", "en": en}
        args = program.args(o)
        if isinstance(o, Affine):
            ends |= {names[a]: names[a] for a in args} | {y: y}
            body += "\n" + instance(f"{program.name}_{y}", f"{y}_layer", {}, ends)
            continue
        ends |= {"x": names[o.arg], "y": y}
        module, parameters = small_operation(program, o)
        body += "\n" + instance(module, f"{y}_layer", parameters, ends)

    if program.states:
        body += "\n    // states: what their sources held in the step before\n"
        for s in program.states:
            body += vector("reg", s.signal, "")
        body += "\n    always @(posedge clk)\n        if (rst) begin\n"
        for s in program.states:
            body += f"            {names[s.signal.name]} <= {packed(s.initial, s.signal.fix.width)};\n"
        body += "        end else if (done) begin\n"
        for s in program.states:
            body += f"            {names[s.signal.name]} <= {names[s.source]};\n"
        body += "        end\n"

    read = {a for o in program.operations for a in program.args(o)}
    read |= {s.source for s in program.states} | {p.signal.name for p in program.outputs}
    unread = [names[s] for s in program.signals if s not in read] + unused_bits(program)
    if unread:
        body += "\n    // nothing reads these, nor the sign extensions of the inputs\n"
        body += "    wire unused = &{\n" + wrapped([f"{u}," for u in unread], "        ") + " 1'b0\n    };\n"

    shown = [
        sign_extended(names[s.name], k * s.fix.width, s.fix.width, lane_width(s))
        for p in program.outputs
        for s in [p.signal]
        for k in range(s.size)
    ]
    body += "\n    // outputs\n    assign result = {\n"
    body += ",\n".join(f"        {part}" for part in reversed(shown)) + "\n    };\n\n"
    return module_text(header(program, "parallel"), body + stream_instance(width_in, width_out, "1'b1"))


def small_operation(program: Program, o, size: int | None = None) -> tuple[str, dict]:
    """Module and parameters of a table, clamp or threshold of `size` elements."""
    arg, size = program.signals[o.arg], size or o.out.size
    if isinstance(o, Lookup):
        return table_module(program, shared_tables(program)[o.table]), {"SIZE": size}
    parameters = {"SIZE": size, "ARG_W": arg.fix.width, "OUT_W": o.out.fix.width}
    if isinstance(o, Clamp):
        limits = {"LO": number(o.lo, arg.fix.width), "HI": number(o.hi, arg.fix.width)}
        shift = {"SHIFT": arg.fix.frac - o.out.fix.frac, "ROUNDING": ROUNDING[o.rounding]}
        return "greygate_clamp", parameters | shift | limits
    answers = {"BELOW": number(o.below, o.out.fix.width), "ABOVE": number(o.above, o.out.fix.width)}
    return "greygate_threshold", parameters | {"AT": number(o.at, arg.fix.width)} | answers


def stream_instance(width_in: int, width_out: int, ready: str) -> str:
    """The edge of the core."""
    ports = {p: p for p in PORTS} | {"ready": ready} | {p: p for p in ("sample", "start", "done", "result")}
    return instance("greygate_stream", "stream", {"IN_W": width_in, "OUT_W": width_out}, ports)
