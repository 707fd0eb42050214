"""The parallel architecture: every operation has its own hardware, and one step is under way at a time.

Inputs and states hold still during a step, so that a register of an operation needs no enable: what depends on them
settles as it passes. A step ends after the longest chain of clocks. Layers whose turns do not meet share the units that
answer from their table; who reads an answer that does not stay takes its result in its own clock.
targets/folded.py shares multipliers, targets/pipelined.py takes a sample with every clock.
"""

from greygate.compiler import verilog
from greygate.compiler.dataflow import Dataflow
from greygate.compiler.targets import Architecture, Design, Register
from greygate.emulator.program import Lookup, Operation, Program

EDGES = 2  # clocks that the streams take beside the longest chain


def parallel(program: Program, design: Design = Design()) -> dict[str, str]:
    """File name -> text of the parallel architecture, without the building blocks."""
    core = _Parallel(program, design)
    return {f"{program.name}.v": core.top()} | core.modules()


def registers(program: Program, design: Design) -> list[Register]:
    """A register for each state, with the name of the state."""
    names = verilog.verilog_names(program)
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

    def top(self) -> str:
        """The top module: registers of the states, the layers, and the two streams."""
        program = self.program
        named = {"core": self, "program": program, "names": self.names, "initial": self.initial()}
        widths = verilog.stream_widths(program)
        named |= {"layers": self.layers(), "stream": verilog.stream_instance(**widths)}
        body = verilog.render("parallel.v", named | widths | {"depth": max(self.since.values())})
        return verilog.module_text(verilog.header(program, "parallel"), body)

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
        return text + verilog.instance(
            module, f"{base}_layer", parameters, {"clk": "clk", "en": "1'b1", "x": chosen, "y": answer}
        )


def _widened(name: str, width: int, to: int) -> str:
    """A vector with zeros above it."""
    return name if width == to else f"{{{to - width}'d0, {name}}}"


def units(core: Dataflow) -> list[list[Lookup]]:
    """The lookups, a list for each unit, in the order in which the unit serves them."""
    tables = verilog.shared_tables(core.program)
    found: list[list[Lookup]] = []
    lookups = [o for o in core.program.operations if isinstance(o, Lookup)]
    for o in sorted(lookups, key=lambda o: core.since[o.arg]):
        free = [u for u in found if tables[u[0].table] is tables[o.table] and _gives_way(core, u[-1], o)]
        if free:
            min(free, key=lambda u: abs(max(p.out.size for p in u) - o.out.size)).append(o)
        else:
            found.append([o])
    return found


def _gives_way(core: Dataflow, before: Lookup, after: Lookup) -> bool:
    """Whether all who read the answers to `before` are done with them when those to `after` take their place."""
    program, name = core.program, before.out.name
    if core.since[after.arg] <= core.since[before.arg]:
        return False
    if name in {p.signal.name for p in program.outputs} | {s.source for s in program.states}:
        return False
    gone = core.since[after.arg] + verilog.LOOKUP_CLOCKS
    return all(not isinstance(o, Lookup) and core.since[o.out.name] <= gone for o in readers(core, name))


def readers(core: Dataflow, name: str) -> list[Operation]:
    """The operations that read a signal."""
    return [o for o in core.program.operations if name in o.args]
