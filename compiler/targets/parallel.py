"""The parallel architecture: every layer has its own hardware with a register at its end.

A step takes as many clocks as the longest chain of operations has members, plus three. targets/folded.py shares
multipliers.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from greygate.compiler.targets import Architecture, Design, Register
from greygate.compiler.verilog import (
    ROUNDING,
    clocks,
    header,
    input_slices,
    instance,
    lane_width,
    levels,
    module_text,
    packed,
    remark,
    result_text,
    sign_extended,
    small_operation,
    stream_instance,
    table_texts,
    top_ports,
    unused_bits,
    unused_text,
    verilog_names,
    wrapped,
)
from greygate.emulator.program import Affine, Lookup, Operation, Overflow, Program, Signal

EDGES = 3  # clocks that the streams and the inputs take beside the longest chain


def parallel(program: Program) -> dict[str, str]:
    """File name -> text of the parallel architecture, without the building blocks."""
    names = verilog_names(program)
    texts = {f"{program.name}.v": _Top(program, names).text()}
    for o in program.operations:
        if isinstance(o, Affine):
            texts[f"{program.name}_{names[o.out.name]}.v"] = _Layer(program, o, names).text()
    return texts | table_texts(program)


def registers(program: Program) -> list[Register]:
    """A register for each state, with the name of the state."""
    names = verilog_names(program)
    signals = [s.signal for s in program.states]
    return [Register(names[s.name], k * s.fix.width) for s in signals for k in range(s.size)]


def step(program: Program, design: Design) -> int:
    """Clocks from one sample to the next."""
    return max(levels(program).values()) + EDGES


TARGET = Architecture(lambda program, design: parallel(program) | table_texts(program, design.memory), registers, step)


class _Layer:
    """The module of an affine operation: a readable sum for each row, and its rounding.

    wire: name of the wire of each element of the arguments that has a weight in some row; it is as wide as the sums.
    """

    def __init__(self, program: Program, o: Affine, names: dict[str, str]):
        self.program, self.o, self.names = program, o, names
        self.width = program.accumulator_width(o)
        self.arguments = [program.signals[a] for a in dict.fromkeys(o.args)]
        self.columns = [(program.signals[a], k) for a in o.args for k in range(program.signals[a].size)]
        self.used = np.flatnonzero(np.any(o.weights != 0, axis=0))
        self.taken = {"clk", "en", "unused", *(names[a] for a in o.args), names[o.out.name]}
        elements = dict.fromkeys(self.columns[j] for j in self.used)
        self.wire = {(s, k): self._fresh(f"{names[s.name]}_{k}") for s, k in elements}

    def _fresh(self, name: str) -> str:
        while name in self.taken:
            name += "_"
        self.taken.add(name)
        return name

    def text(self) -> str:
        o, out = self.o, self.o.out.fix
        comment = [
            f"{o.out.name}: {o.out.size} rows of {len(self.columns)} columns ({', '.join(o.args)}) to {out},"
            f" rounding {o.rounding.value}, overflow {o.overflow.value}.",
            f"No sum overflows {self.width} bits, whatever the arguments. One clock.",
        ]
        inputs = "".join(
            f"    input  wire [{s.size * s.fix.width - 1}:0] {self.names[s.name]},  // {s.size} x {s.fix}\n"
            for s in self.arguments
        )
        body = f"""\
module {self.program.name}_{self.names[o.out.name]} (
    input  wire clk,
    input  wire en,
{inputs}    output wire [{o.out.size * out.width - 1}:0] {self.names[o.out.name]}  // {o.out.size} x {out}
);

{self.wires()}{"".join(self.row(r) for r in range(o.out.size))}"""
        return module_text(comment, body)

    def wires(self) -> str:
        """The elements with a weight, extended to the width of the sums."""
        text = ""
        for (s, k), name in self.wire.items():
            code = sign_extended(self.names[s.name], k * s.fix.width, s.fix.width, self.width)
            text += f"    wire signed [{self.width - 1}:0] {name} = {code};\n"
        missing = [
            f"{self.names[s.name]}[{(k + 1) * s.fix.width - 1}:{k * s.fix.width}]"
            for s in self.arguments
            for k in range(s.size)
            if (s, k) not in self.wire
        ]
        if missing:
            text += "    wire unused = &{1'b0, " + ", ".join(missing) + "};  // their weights are all zero\n"
        return text

    def row(self, r: int) -> str:
        """The sum of row r: in physical numbers as a comment, then in codes, and its rounding."""
        o, out, width = self.o, self.o.out.fix, self.width
        bias, frac = int(o.bias[r]), int(o.frac[r])
        weights = [(self.columns[j], int(o.weights[r, j])) for j in self.used if o.weights[r, j]]
        floats = [f"{w * 2.0 ** (s.fix.frac - frac):+.6g} {s.name}[{k}]" for (s, k), w in weights]
        floats.append(f"{bias * 2.0**-frac:+.6g}")
        terms = [term(w, self.wire[element], width) for element, w in weights]
        terms += [f"{'-' if bias < 0 else '+'} {width}'sd{abs(bias)}"] if bias or not terms else []
        terms[0] = terms[0].removeprefix("+ ").replace("- ", "-", 1)
        total, rounded = self._fresh(f"sum_{r}"), self._fresh(f"row_{r}")
        parameters = {
            "IN_W": width,
            "OUT_W": out.width,
            "SHIFT": frac - out.frac,
            "ROUNDING": ROUNDING[o.rounding],
            "SATURATE": int(o.overflow is Overflow.SATURATE),
        }
        y = f"{self.names[o.out.name]}[{(r + 1) * out.width - 1}:{r * out.width}]"
        comment = wrapped([f"{o.out.name}[{r}] =", *floats], "    // ").splitlines()
        return f"""
{"".join(f"    {remark(line.removeprefix('    // '))}" + chr(10) for line in comment)}\
    wire signed [{width - 1}:0] {total} =
{wrapped(terms, "        ")};
{instance("greygate_requantize", rounded, parameters, {"clk": "clk", "en": "en", "a": total, "y": y})}"""


def term(weight: int, x: str, width: int) -> str:
    """weight * x with its sign in front; multiplication by a power of two is a shift."""
    sign, size = ("-", -weight) if weight < 0 else ("+", weight)
    if size == 1:
        return f"{sign} {x}"
    if size & (size - 1) == 0:
        return f"{sign} ({x} <<< {size.bit_length() - 1})"
    return f"{sign} {width}'sd{size} * {x}"


@dataclass(frozen=True)
class _Top:
    """The top module: registers of the states, one instance for each layer, and the two streams."""

    program: Program
    names: dict[str, str]

    @cached_property
    def level(self) -> dict[str, int]:
        return levels(self.program)

    def vector(self, kind: str, s: Signal, tail: str = "") -> str:
        return f"    {kind} [{s.size * s.fix.width - 1}:0] {self.names[s.name]}{tail};  // {s.size} x {s.fix}\n"

    def text(self) -> str:
        ports, width_in, width_out = top_ports(self.program)
        depth = max(self.level.values())
        body = f"""\
module {self.program.name} (
{ports}
);

    localparam DEPTH = {depth};  // clocks from start to done

    wire [{width_in - 1}:0] sample;
    wire [{width_out - 1}:0] result;
    wire start;
{self.stages(depth)}{self.inputs()}{self.states()}{self.layers()}{self.next_states()}{self.unread()}{self.outputs()}"""
        return module_text(header(self.program, "parallel"), body + stream_instance(width_in, width_out, "1'b1"))

    def stages(self, depth: int) -> str:
        if not depth:
            return "    wire done = start;\n"
        following = "start" if depth == 1 else "{stage[DEPTH-2:0], start}"
        return f"""\
    reg [DEPTH-1:0] stage;  // stage[k]: clock k + 1 of a step, one step under way at a time
    wire done = stage[{depth - 1}];

    always @(posedge clk) stage <= rst ? {{DEPTH{{1'b0}}}} : {following};
"""

    def inputs(self) -> str:
        slices, text = input_slices(self.program), "\n    // inputs\n"
        for p in self.program.inputs:
            s = p.signal
            parts = [f"sample[{start + s.fix.width - 1}:{start}]" for t, _, start in slices if t is s]
            value = parts[0] if s.size == 1 else "{" + ", ".join(reversed(parts)) + "}"
            text += self.vector("wire", s, f" = {value}")
        return text

    def states(self) -> str:
        if not self.program.states:
            return ""
        head = "\n    // states: what their sources held in the step before\n"
        return head + "".join(self.vector("reg", s.signal) for s in self.program.states)

    def layers(self) -> str:
        wires = "".join(self.vector("wire", o.out) for o in self.program.operations)
        return "\n    // layers\n" + wires + "".join(f"\n{self.layer(o)}" for o in self.program.operations)

    def layer(self, o: Operation) -> str:
        """The instance of an operation, which is enabled when its arguments are valid."""
        y, level = self.names[o.out.name], self.level[o.out.name]
        first = level - clocks(o)  # the clock before the first of the operation
        arguments = [self.names[a] for a in o.args]
        ends = {"clk": "clk", "en": "start" if first == 0 else f"stage[{first - 1}]"}
        if isinstance(o, Affine):
            ends |= {a: a for a in arguments} | {y: y}
            return instance(f"{self.program.name}_{y}", f"{y}_layer", {}, ends)
        if isinstance(o, Lookup):
            ends["en"] = "1'b1"  # several clocks: its answer holds still because its argument does
        module, parameters, ports = small_operation(self.program, o, o.out.size)
        ends |= dict(zip(ports, arguments, strict=True)) | {"y": y}
        return instance(module, f"{y}_layer", parameters, ends)

    def next_states(self) -> str:
        """The registers of the states: all take the values of their sources at once, when a step is done."""
        if not self.program.states:
            return ""
        named = [(self.names[s.signal.name], s) for s in self.program.states]
        initial = "".join(f"            {y} <= {packed(s.initial, s.signal.fix.width)};\n" for y, s in named)
        sources = "".join(f"            {y} <= {self.names[s.source]};\n" for y, s in named)
        return f"""
    always @(posedge clk)
        if (rst) begin
{initial}        end else if (done) begin
{sources}        end
"""

    def unread(self) -> str:
        program = self.program
        read = {a for o in program.operations for a in o.args}
        read |= {s.source for s in program.states} | {p.signal.name for p in program.outputs}
        unread = [self.names[s] for s in program.signals if s not in read] + unused_bits(program)
        head = "\n    // nothing reads these, nor the sign extensions of the inputs\n"
        return head + unused_text(unread) if unread else ""

    def outputs(self) -> str:
        shown = [p.signal for p in self.program.outputs]
        lanes = [
            sign_extended(self.names[s.name], k * s.fix.width, s.fix.width, lane_width(s))
            for s in shown
            for k in range(s.size)
        ]
        return f"\n    // outputs\n{result_text(lanes)}"
