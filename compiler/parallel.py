"""The parallel architecture: every layer has hardware of its own and a register at its end.

A step takes as many clocks as the longest chain of operations, and three more. compiler/folded.py shares multipliers.
"""

import numpy as np

from greygate.compiler.verilog import (
    ROUNDING,
    argument_ports,
    header,
    input_slices,
    instance,
    lane_width,
    levels,
    module_text,
    packed,
    remark,
    shared_tables,
    sign_extended,
    small_operation,
    stream_instance,
    table_module,
    table_text,
    top_ports,
    unused_bits,
    verilog_names,
    wrapped,
)
from greygate.emulator.program import Affine, Overflow, Program


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
        sum_lines = wrapped([f"{o.out.name}[{r}] =", *floats], "    // ").splitlines()
        body += "\n" + "".join(f"    {remark(line.removeprefix('    // '))}\n" for line in sum_lines)
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
    if program.states:
        body += "\n    // states: what their sources held in the step before\n"
        for s in program.states:
            body += vector("reg", s.signal, "")
    body += "\n    // layers\n"
    for o in program.operations:
        body += vector("wire", o.out, "")
    for o in program.operations:
        y = names[o.out.name]
        en = "start" if level[o.out.name] == 1 else f"stage[{level[o.out.name] - 2}]"
        ends = {"clk": "clk", "en": en}
        args = o.args
        if isinstance(o, Affine):
            ends |= {names[a]: names[a] for a in args} | {y: y}
            body += "\n" + instance(f"{program.name}_{y}", f"{y}_layer", {}, ends)
            continue
        ends |= {port: names[a] for port, a in zip(argument_ports(o), args, strict=True)} | {"y": y}
        module, parameters = small_operation(program, o)
        body += "\n" + instance(module, f"{y}_layer", parameters, ends)

    if program.states:
        body += "\n    always @(posedge clk)\n        if (rst) begin\n"
        for s in program.states:
            body += f"            {names[s.signal.name]} <= {packed(s.initial, s.signal.fix.width)};\n"
        body += "        end else if (done) begin\n"
        for s in program.states:
            body += f"            {names[s.signal.name]} <= {names[s.source]};\n"
        body += "        end\n"

    read = {a for o in program.operations for a in o.args}
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
