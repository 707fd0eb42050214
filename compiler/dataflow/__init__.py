"""What the architectures share in which every operation has hardware of its own: when it is done, and its instance."""

from functools import cached_property

from greygate.compiler import verilog
from greygate.compiler.code_ranges import code_ranges
from greygate.compiler.dataflow.sums import Sums
from greygate.compiler.limits import clamps_behind
from greygate.compiler.targets import Design
from greygate.emulator.program import Affine, Clamp, Elementwise, Lookup, Operation, Product, Program, Signal
from greygate.names import CORE_NAMES


class Dataflow:
    """A program with a module or block for every operation."""

    def __init__(self, program: Program, design: Design, pipelined: bool = False):
        self.program, self.design, self.pipelined = program, design, pipelined
        self.dsps = design.dsps  # that are left
        self.names = verilog.verilog_names(program)
        self.taken = {
            *CORE_NAMES,
            program.name,
            *self.names.values(),
            *(f"{name}_layer" for name in self.names.values()),
        }

    def fresh(self, name: str) -> str:
        """That name, or one like it that the top does not have yet."""
        while name in self.taken:
            name += "_"
        self.taken.add(name)
        return name

    @cached_property
    def sums(self) -> dict[str, Sums]:
        """Result of each affine operation -> its module."""
        ranges, most, pipelined = code_ranges(self.program), self.design.adders, self.pipelined
        found = {}
        for o in self.program.operations:
            if isinstance(o, Affine):
                told, clamp = told_alike(self.program, o), self.clamps.get(o.out.name)
                found[o.out.name] = Sums(self.program, o, self.names, ranges, most, pipelined, told, clamp)
        return found

    @cached_property
    def clamps(self) -> dict[str, Clamp]:
        """Sum -> the clamp that its module performs as well."""
        return clamps_behind(self.program)

    def clocks(self, o: Operation) -> int:
        """From arguments to results."""
        if isinstance(o, Affine):
            return self.sums[o.out.name].clocks
        return 0 if self.performed(o) else verilog.clocks(o)

    def performed(self, o: Operation) -> bool:
        """Whether the module of a sum performs this clamp."""
        return isinstance(o, Clamp) and o.arg in self.clamps

    @cached_property
    def since(self) -> dict[str, int]:
        """Signal -> clocks after the arguments of a step stand; 0 for inputs and states."""
        found = dict.fromkeys(self.program.signals, 0)
        for o in self.program.operations:
            found[o.out.name] = self.clocks(o) + max(found[a] for a in o.args)
        return found

    def modules(self) -> dict[str, str]:
        """File name -> text of the modules below the top."""
        texts = {f"{self.program.name}_{self.names[y]}.v": sums.text() for y, sums in self.sums.items()}
        return texts | verilog.table_texts(self.program, self.design.memory)

    def vector(self, kind: str, s: Signal, tail: str = "") -> str:
        return f"    {kind} [{s.size * s.fix.width - 1}:0] {self.names[s.name]}{tail};  // {s.size} x {s.fix}\n"

    def inputs(self) -> str:
        """A wire for each input, out of the sample."""
        slices, text = verilog.input_slices(self.program), "\n    // inputs\n"
        for p in self.program.inputs:
            s = p.signal
            parts = [f"sample[{start + s.fix.width - 1}:{start}]" for t, _, start in slices if t is s]
            value = parts[0] if s.size == 1 else "{" + ", ".join(reversed(parts)) + "}"
            text += self.vector("wire", s, f" = {value}")
        return text

    def layer(self, o: Operation, arguments: list[str], enable: str) -> str:
        """The instance of an operation on wires of those names. enable: of its registers, where they have one."""
        y = self.names[o.out.name]
        if self.performed(o):
            return f"    assign {y} = {arguments[0]};\n"
        ends = {"clk": "clk"}
        if isinstance(o, Affine):
            sums = self.sums[o.out.name]
            ends |= {"en": enable} if sums.pipelined or sums.held else {}
            ends |= {self.names[a]: wire for a, wire in zip(o.args, arguments, strict=True)} | {y: y}
            return verilog.instance(f"{self.program.name}_{y}", f"{y}_layer", {}, ends)
        module, parameters, ports = self.block(o, o.out.size)
        if isinstance(o, Product):
            ends["take"], enable = enable, enable if self.pipelined else "1'b1"
        ends |= {"en": enable} | dict(zip(ports, arguments, strict=True)) | {"y": y}
        return verilog.instance(module, f"{y}_layer", parameters, ends)

    def block(self, o: Elementwise, size: int) -> verilog.Block:
        """As `small_operation`; tables and products multiply by DSPs as long as the design has any left."""
        module, parameters, ports = verilog.small_operation(self.program, o, size)
        if isinstance(o, Lookup | Product):
            used = min(size, self.dsps)
            self.dsps -= used
            parameters = parameters | {"MULTIPLIERS": used}
        return module, parameters, ports

    def unread(self) -> str:
        """What nothing reads."""
        program = self.program
        read = {a for o in program.operations for a in o.args}
        read |= {s.source for s in program.states} | {p.signal.name for p in program.outputs}
        unread = [self.names[s] for s in program.signals if s not in read] + verilog.unused_bits(program)
        head = "\n    // nothing reads these, nor the sign extensions of the inputs\n"
        return head + verilog.unused_text(unread) if unread else ""

    def outputs(self, names: dict[str, str]) -> str:
        """The word of the output stream. names: wire of each signal that is shown."""
        shown = [p.signal for p in self.program.outputs]
        lanes = [
            verilog.sign_extended(names[s.name], k * s.fix.width, s.fix.width, verilog.lane_width(s))
            for s in shown
            for k in range(s.size)
        ]
        return f"\n    // outputs\n{verilog.result_text(lanes)}"

    def initial(self) -> dict[str, str]:
        """State -> its initial codes side by side."""
        return {s.signal.name: verilog.packed(s.initial, s.signal.fix.width) for s in self.program.states}


def told_alike(program: Program, o: Affine) -> int:
    """So many low bits of a saturated result that nobody tells apart: where only tables read it, beyond their reach.

    A code whose upper bits are saturated then gets the same answer as the saturated code.
    """
    name = o.out.name
    if name in {p.signal.name for p in program.outputs} | {s.source for s in program.states}:
        return 0
    readers = [other for other in program.operations if name in other.args]
    tables = [program.table[other.table] for other in readers if isinstance(other, Lookup)]
    if len(tables) < len(readers):
        return 0
    bits = max(((t.reach - 1).bit_length() for t in tables), default=0)
    return bits if bits <= o.out.fix.width - 2 else 0
