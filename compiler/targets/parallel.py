"""The parallel architecture: every operation has its own hardware, and one step is under way at a time.

Inputs and states hold still during a step, so no register of an operation needs an enable: what depends on them
settles as it passes. A step ends after the longest chain of clocks. targets/folded.py shares multipliers,
targets/pipelined.py takes a sample with every clock.
"""

from greygate.compiler.dataflow import Dataflow
from greygate.compiler.targets import Architecture, Design, Register
from greygate.compiler.verilog import header, module_text, stream_instance, top_ports, verilog_names
from greygate.emulator.program import Program

EDGES = 2  # clocks that the streams take beside the longest chain


def parallel(program: Program, design: Design = Design()) -> dict[str, str]:
    """File name -> text of the parallel architecture, without the building blocks."""
    core = Dataflow(program, design)
    return {f"{program.name}.v": _top(core)} | core.modules()


def registers(program: Program, design: Design) -> list[Register]:
    """A register for each state, with the name of the state."""
    names = verilog_names(program)
    signals = [s.signal for s in program.states]
    return [Register(names[s.name], k * s.fix.width) for s in signals for k in range(s.size)]


def clocks(program: Program, design: Design) -> int:
    """Clocks of a step: the longest chain of operations, and the edges of the core."""
    return max(Dataflow(program, design).since.values()) + EDGES


TARGET = Architecture(parallel, registers, clocks)


def _top(core: Dataflow) -> str:
    program = core.program
    ports, width_in, width_out = top_ports(program)
    depth = max(core.since.values())
    body = f"""\
module {program.name} (
{ports}
);

    localparam DEPTH = {depth};  // clocks from start to done

    wire [{width_in - 1}:0] sample;
    wire [{width_out - 1}:0] result;
    wire start;
{_stages(depth)}{core.inputs()}{_states(core)}{_layers(core)}{_next_states(core)}{core.unread()}"""
    body += core.outputs(core.names) + stream_instance(width_in, width_out, "1'b1")
    return module_text(header(program, "parallel"), body)


def _stages(depth: int) -> str:
    if not depth:
        return "    wire done = start;\n"
    following = "start" if depth == 1 else "{stage[DEPTH-2:0], start}"
    return f"""\
    reg [DEPTH-1:0] stage;  // stage[k]: clock k + 1 of a step, one step under way at a time
    wire done = stage[{depth - 1}];

    always @(posedge clk) stage <= rst ? {{DEPTH{{1'b0}}}} : {following};
"""


def _states(core: Dataflow) -> str:
    if not core.program.states:
        return ""
    head = "\n    // states: what their sources held in the step before\n"
    return head + "".join(core.vector("reg", s.signal) for s in core.program.states)


def _layers(core: Dataflow) -> str:
    operations = core.program.operations
    wires = "".join(core.vector("wire", o.out) for o in operations)
    layers = [core.layer(o, [core.names[a] for a in o.args], "1'b1") for o in operations]
    return "\n    // layers\n" + wires + "".join(f"\n{layer}" for layer in layers)


def _next_states(core: Dataflow) -> str:
    """The registers of the states: all take the values of their sources at once, when a step is done."""
    if not core.program.states:
        return ""
    named = [(core.names[s.signal.name], s) for s in core.program.states]
    initial = "".join(f"            {y} <= {core.initial()[s.signal.name]};\n" for y, s in named)
    sources = "".join(f"            {y} <= {core.names[s.source]};\n" for y, s in named)
    return f"""
    always @(posedge clk)
        if (rst) begin
{initial}        end else if (done) begin
{sources}        end
"""
