"""The parallel architecture: every operation has its own hardware, and one step is under way at a time.

Inputs and states hold still during a step, so that a register of an operation needs no enable: what depends on them
settles as it passes. A step ends after the longest chain of clocks. Layers whose turns do not meet share the units that
answer from their table; who reads an answer that does not stay takes its result in its own clock.
targets/folded.py shares multipliers, targets/pipelined.py takes a sample with every clock.
"""

from greygate.compiler.dataflow import Dataflow
from greygate.compiler.dataflow.sharing import readers, units
from greygate.compiler.targets import Architecture, Design, Register
from greygate.compiler.verilog import (
    header,
    instance,
    module_text,
    stream_instance,
    top_ports,
    verilog_names,
)
from greygate.emulator.program import Lookup, Program

EDGES = 2  # clocks that the streams take beside the longest chain


def parallel(program: Program, design: Design = Design()) -> dict[str, str]:
    """File name -> text of the parallel architecture, without the building blocks."""
    return _Parallel(program, design).files()


def registers(program: Program, design: Design) -> list[Register]:
    """A register for each state, with the name of the state."""
    names = verilog_names(program)
    signals = [s.signal for s in program.states]
    return [Register(names[s.name], k * s.fix.width) for s in signals for k in range(s.size)]


def clocks(program: Program, design: Design) -> int:
    """Clocks of a step: the longest chain of operations, and the edges of the core."""
    return max(Dataflow(program, design).since.values()) + EDGES


TARGET = Architecture(parallel, registers, clocks)


class _Parallel(Dataflow):
    """The parallel architecture of a program."""

    def __init__(self, program: Program, design: Design):
        super().__init__(program, design)
        self.units = units(self)
        self.enabled = {o.out.name for u in self.units for p in u[:-1] for o in readers(self, p.out.name)}
        for name in self.enabled & set(self.sums):
            self.sums[name].held = True

    def files(self) -> dict[str, str]:
        """File name -> text."""
        return {f"{self.program.name}.v": self.top()} | self.modules()

    def top(self) -> str:
        """The top module: registers of the states, the layers, and the two streams."""
        program = self.program
        ports, width_in, width_out = top_ports(program)
        depth = max(self.since.values())
        body = f"""\
module {program.name} (
{ports}
);

    localparam DEPTH = {depth};  // clocks from start to done

    wire [{width_in - 1}:0] sample;
    wire [{width_out - 1}:0] result;
    wire start;
{_stages(depth)}{self.inputs()}{self.states()}{self.layers()}{self.next_states()}{self.unread()}"""
        body += self.outputs(self.names) + stream_instance(width_in, width_out, "1'b1")
        return module_text(header(program, "parallel"), body)

    def states(self) -> str:
        if not self.program.states:
            return ""
        head = "\n    // states: what their sources held in the step before\n"
        return head + "".join(self.vector("reg", s.signal) for s in self.program.states)

    def clock(self, since: int) -> str:
        """The wire that is high in the clock that is so many clocks after the arguments of a step stand."""
        return f"stage[{since - 1}]" if since else "start"

    def layers(self) -> str:
        """Every operation's instance; lookups stand where the first one stands that their unit serves."""
        operations = self.program.operations
        text = "\n    // layers\n" + "".join(self.vector("wire", o.out) for o in operations)
        serving = {u[0].out.name: u for u in self.units}
        for o in operations:
            name = o.out.name
            if not isinstance(o, Lookup):
                enable = self.clock(self.since[name] - 1) if name in self.enabled else "1'b1"
                text += "\n" + self.layer(o, [self.names[a] for a in o.args], enable)
            elif name in serving:
                text += "\n" + self.unit(serving[name])
        return text

    def unit(self, served: list[Lookup]) -> str:
        """The instance that answers all of these lookups, each from the clock on in which its argument stands."""
        first = served[0]
        if len(served) == 1:
            return self.layer(first, [self.names[first.arg]], "1'b1")
        size = max(o.out.size for o in served)
        arg, out = self.program.signals[first.arg].fix.width, first.out.fix.width
        base = self.names[first.out.name]
        chosen, answer = self.fresh(f"{base}_asked"), self.fresh(f"{base}_answer")
        text, value = "", _widened(self.names[first.arg], first.out.size * arg, size * arg)
        for o in served[1:]:
            turn = self.fresh(f"{self.names[o.out.name]}_turn")
            text += f"    reg {turn};  // {o.arg} stands\n"
            begins = self.clock(self.since[o.arg] - 1)
            text += f"    always @(posedge clk) {turn} <= !rst && !done && ({turn} || {begins});\n"
            value = f"{turn} ? {_widened(self.names[o.arg], o.out.size * arg, size * arg)} : {value}"
        text += f"    wire [{size * arg - 1}:0] {chosen} = {value};\n    wire [{size * out - 1}:0] {answer};\n"
        for o in served:
            text += f"    assign {self.names[o.out.name]} = {answer}[{o.out.size * out - 1}:0];\n"
        module, parameters, _ = self.block(first, size)
        return text + instance(
            module, f"{base}_layer", parameters, {"clk": "clk", "en": "1'b1", "x": chosen, "y": answer}
        )

    def next_states(self) -> str:
        """The registers of the states: all take the values of their sources at once, when a step is done."""
        if not self.program.states:
            return ""
        named = [(self.names[s.signal.name], s) for s in self.program.states]
        initial = "".join(f"            {y} <= {self.initial()[s.signal.name]};\n" for y, s in named)
        sources = "".join(f"            {y} <= {self.names[s.source]};\n" for y, s in named)
        return f"""
    always @(posedge clk)
        if (rst) begin
{initial}        end else if (done) begin
{sources}        end
"""


def _widened(name: str, width: int, to: int) -> str:
    """A vector with zeros above it."""
    return name if width == to else f"{{{to - width}'d0, {name}}}"


def _stages(depth: int) -> str:
    if not depth:
        return "    wire done = start;\n"
    following = "start" if depth == 1 else "{stage[DEPTH-2:0], start}"
    return f"""\
    reg [DEPTH-1:0] stage;  // stage[k]: clock k + 1 of a step, one step under way at a time
    wire done = stage[{depth - 1}];

    always @(posedge clk) stage <= rst ? {{DEPTH{{1'b0}}}} : {following};
"""
