"""The Verilog of an affine operation: its adder graph with a wire for each sum, its registers, rounding, saturation.

A sum is as wide as its exact range needs. Shifts are wiring. What its reader does not read is told to the tools.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from greygate.compiler.adders import CONSTANT, Graph, solve
from greygate.compiler.adders.graph import signed_width
from greygate.compiler.code_ranges import Interval, rounding_constant
from greygate.compiler.verilog import module_text, number, remark, unused_text, wrapped
from greygate.emulator.interpreter import fit, round_shift
from greygate.emulator.numbers import Overflow, Rounding
from greygate.emulator.program import Affine, Clamp, Program


def solved(program: Program, o: Affine, ranges: Mapping[str, list[Interval]]) -> Graph:
    """The adder graph of an operation, with bias and rounding constant in it. ranges: of every signal's elements."""
    columns = [interval for a in o.args for interval in ranges[a]]
    widths = [program.signals[a].fix.width for a in o.args for _ in range(program.signals[a].size)]
    shifts = [int(f) - o.out.fix.frac for f in o.frac]
    constants = [int(b) + rounding_constant(o.rounding, s) for b, s in zip(o.bias, shifts, strict=True)]
    return solve(o.weights, widths, constants, columns)


@dataclass(frozen=True)
class Stages:
    """Between which registers the adders of a graph stand: `of[operand]` is the stage, from 0; `count` of them.

    Only registers separate two stages, and no stage has more than `most` adders in a row.
    """

    of: tuple[int, ...]
    count: int


def stages(graph: Graph, most: int) -> Stages:
    """The fewest stages of at most `most` adders in a row (0: all in one), of the two obvious cuts the cheaper.

    One cut counts adders from the columns, the other from the outputs.
    """
    if not most or graph.depth <= most:
        return Stages((0,) * (graph.columns + len(graph.nodes)), 1)
    count = -(-graph.depth // most)
    early: list[int] = [0] * graph.columns + [(level - 1) // most for level in graph.levels]
    above = _heights(graph)
    late = [0] * graph.columns + [count - 1 - h // most for h in above[graph.columns :]]
    chosen = min((early, late), key=lambda of: _crossing(graph, list(of)))
    return Stages(tuple(chosen), count)


def _heights(graph: Graph) -> list[int]:
    """Adders in a row from each operand to the farthest output, its own not counted."""
    found = [0] * (graph.columns + len(graph.nodes))
    for k in range(len(graph.nodes) - 1, -1, -1):
        node = graph.nodes[k]
        for operand in (node.left, node.right):
            if operand != CONSTANT:
                found[operand] = max(found[operand], found[graph.columns + k] + 1)
    return found


def _crossing(graph: Graph, of: Sequence[int]) -> int:
    """Bits of the nodes that a later stage reads."""
    crossing = set()
    for k, node in enumerate(graph.nodes, graph.columns):
        crossing |= {o for o in (node.left, node.right) if o >= graph.columns and of[o] < of[k]}
    return sum(graph.width(o) for o in crossing)


@dataclass
class _Value:
    """A vector in two's complement, and which of its bits somebody reads."""

    name: str
    width: int
    read: set[int] = field(default_factory=set)

    def bits(self, shift: int, low: int, width: int) -> str:
        """Bits low to low + width - 1 of the value times 2^shift: sign extension, a slice, zeros."""
        first, last = low - shift, low - shift + width - 1  # as bits of the value
        parts = []
        extension = last - max(self.width - 1, first - 1)
        if extension > 0:
            self.read.add(self.width - 1)
            sign = f"{self.name}[{self.width - 1}]"
            parts.append(sign if extension == 1 else f"{{{extension}{{{sign}}}}}")
        top, bottom = min(last, self.width - 1), max(first, 0)
        if top >= bottom:
            self.read |= set(range(bottom, top + 1))
            whole = (bottom, top) == (0, self.width - 1)
            one = f"{self.name}[{top}]" if top == bottom else f"{self.name}[{top}:{bottom}]"
            parts.append(self.name if whole else one)
        if first < 0:
            parts.append(f"{min(-first, width)}'d0")
        return parts[0] if len(parts) == 1 and not parts[0].startswith("{") else "{" + ", ".join(parts) + "}"

    def unread(self) -> list[str]:
        """Its slices that nobody reads."""
        found, start = [], None
        for k in range(self.width + 1):
            unread = k < self.width and k not in self.read
            if unread and start is None:
                start = k
            if not unread and start is not None:
                found.append(f"{self.name}[{k - 1}:{start}]" if k - 1 > start else f"{self.name}[{start}]")
                start = None
        return [self.name] if found and len(self.read) == 0 else found


class Sums:
    """The module of an affine operation.

    most: adders in a row between two registers, 0 for no register inside. pipelined: a new argument may come with
    every clock, so that registers balance the ways and `en` holds them all; else arguments hold still, and nothing
    holds the registers. held: arguments are there only for a while, so that `en` takes the result. told: so many low
    bits of a result need not be right where it saturates, because its readers answer all such codes alike. clamp: what
    limits the result before the register. clocks: from arguments to results.
    """

    held = False

    def __init__(
        self,
        program: Program,
        o: Affine,
        names: Mapping[str, str],
        ranges: Mapping[str, list[Interval]],
        most: int,
        pipelined: bool = False,
        told: int = 0,
        clamp: Clamp | None = None,
    ):
        self.program, self.o, self.names, self.pipelined, self.told = program, o, names, pipelined, told
        self.clamp = clamp
        self.graph = solved(program, o, ranges)
        self.stages = stages(self.graph, most)
        self.clocks = self.stages.count
        self.arguments = [program.signals[a] for a in dict.fromkeys(o.args)]
        self.columns = [(program.signals[a], k) for a in o.args for k in range(program.signals[a].size)]
        self.taken = {"clk", "en", "unused", *(names[a] for a in o.args), names[o.out.name]}
        self.ports = {s.name: _Value(names[s.name], s.size * s.fix.width) for s in self.arguments}
        self.elements: dict[tuple[str, int], _Value] = {}
        self.operands = self._operands()
        self.delayed: dict[str, list[_Value]] = {}  # name of a value -> it one clock later, two clocks, ...
        self.spare: list[str] = []  # other bits that nobody reads

    def _fresh(self, name: str) -> str:
        while name in self.taken:
            name += "_"
        self.taken.add(name)
        return name

    def _operands(self) -> list[_Value | None]:
        """A value for each operand of the graph that is read; equal columns are one."""
        graph = self.graph
        used = {p for n in graph.nodes for p in (n.left, n.right)} | {p.operand for p in graph.outputs}
        found: list[_Value | None] = []
        for j, (s, k) in enumerate(self.columns):
            if j in used and (s.name, k) not in self.elements:
                self.elements[s.name, k] = _Value(self._fresh(f"{self.names[s.name]}_{k}"), graph.width(j))
            found.append(self.elements.get((s.name, k)))
        return found + [_Value(self._fresh(f"n{k}"), node.width) for k, node in enumerate(graph.nodes)]

    def at(self, operand: int, stage: int) -> _Value:
        """An operand as a stage reads it: behind all registers between, or behind one where arguments hold still."""
        value = self.operands[operand]
        assert value is not None, "an operand that is read has a value"
        late = stage - self.stages.of[operand]
        if not self.pipelined:
            late = min(late, 1) if operand >= self.graph.columns else 0
        chain = self.delayed.setdefault(value.name, [])
        while len(chain) < late:
            (chain or [value])[-1].read |= set(range(value.width))
            chain.append(_Value(self._fresh(f"{value.name}_q{len(chain) + 1}"), value.width))
        return chain[late - 1] if late else value

    def text(self) -> str:
        """The file."""
        o, graph, out = self.o, self.graph, self.o.out
        body = self._sums()  # first: it notes what is read
        columns = self._columns()
        inside = f", at most {-(-graph.depth // self.clocks)} in a row between registers" if self.clocks > 1 else ""
        comment = [
            f"{out.name}: {out.size} rows of {len(self.columns)} columns ({', '.join(o.args)}) to {out.fix},"
            f" rounding {o.rounding.value}, overflow {o.overflow.value}.",
            f"{graph.adders} adders{inside}. {self.clocks} clock{'s' if self.clocks > 1 else ''}.",
        ]
        if self.clamp:
            comment.append(f"Results are limited to {self.clamp.lo} to {self.clamp.hi}, as {self.clamp.out.name} is.")
        inputs = "".join(
            f"    input  wire [{s.size * s.fix.width - 1}:0] {self.names[s.name]},  // {s.size} x {s.fix}\n"
            for s in self.arguments
        )
        enable = "    input  wire en,\n" if self.pipelined or self.held else ""
        head = f"module {self.program.name}_{self.names[out.name]} (\n    input  wire clk,\n{enable}{inputs}"
        port = f"    output reg  [{out.size * out.fix.width - 1}:0] {self.names[out.name]}  // {out.size} x {out.fix}\n"
        return module_text(comment, f"{head}{port});\n{columns}{body}{self._unread()}")

    def _columns(self) -> str:
        """The elements that are read."""
        text = ""
        for (name, k), value in self.elements.items():
            width = self.program.signals[name].fix.width
            code = self.ports[name].bits(0, k * width, value.width)
            text += f"    wire signed [{value.width - 1}:0] {value.name} = {code};\n"
        return "\n" + text if text else ""

    def _unread(self) -> str:
        values = [*self.ports.values(), *self.elements.values(), *filter(None, self.operands[self.graph.columns :])]
        values += [value for chain in self.delayed.values() for value in chain]
        unread = list(dict.fromkeys(bits for value in values for bits in value.unread()))
        unread += self.spare
        return f"\n    // nothing reads these\n{unused_text(unread)}" if unread else ""

    def _sums(self) -> str:
        """Adders shared by rows, then each row with its own, then the registers."""
        owners = _owners(self.graph)
        own: dict[int | None, list[int]] = {}
        for k, owner in enumerate(owners):
            own.setdefault(owner, []).append(k)
        shared = "".join(map(self._adder, own.get(None, [])))
        text = f"\n    // what several rows share\n{shared}" if shared else ""
        rows = [self._row(r, "".join(map(self._adder, own.get(r, [])))) for r in range(self.o.out.size)]
        text += "".join(part for part, _ in rows)
        following = []  # (register, what it takes, width)
        for name, chain in self.delayed.items():
            for before, value in zip([name, *(v.name for v in chain)], chain, strict=False):
                following.append((value.name, before, value.width))
        declared = "".join(f"    reg signed [{width - 1}:0] {q};\n" for q, _, width in following)
        return declared + text + self._registers(following, [name for _, name in rows])

    def _registers(self, following: Sequence[tuple[str, str, int]], rows: Sequence[str]) -> str:
        packed = rows[0] if len(rows) == 1 else "{\n" + wrapped([f"{r}," for r in rows[:0:-1]] + [rows[0]], " " * 12)
        packed += "" if len(rows) == 1 else "\n        }"
        inner = "".join(f"        {q} <= {d};\n" for q, d, _ in following)
        result = f"{self.names[self.o.out.name]} <= {packed};\n"
        if self.pipelined:
            return f"\n    always @(posedge clk) if (en) begin\n{inner}        {result}    end\n"
        result = f"        {'if (en) ' if self.held else ''}{result}"
        return f"\n    always @(posedge clk) begin\n{inner}{result}    end\n"

    def _bits(self, operand: int, constant: int, stage: int, shift: int, low: int, width: int) -> str:
        if operand == CONSTANT:
            return f"{width}'d{(constant >> low) & ((1 << width) - 1)}"
        return self.at(operand, stage).bits(shift, low, width)

    def _adder(self, k: int) -> str:
        """The wire of one adder. Low bits that are always 0 are dropped: their carry goes into the rest."""
        n, operand = self.graph.nodes[k], self.graph.columns + k
        stage, value = self.stages.of[operand], self.operands[operand]
        assert value is not None
        if n.left == CONSTANT and not n.subtract:
            n = n._replace(left=n.right, left_shift=n.right_shift, right=n.left, right_shift=n.left_shift)
        left = self._bits(n.left, n.constant, stage, n.left_shift, n.drop, value.width)
        right = self._bits(n.right, n.constant, stage, n.right_shift, n.drop, value.width)
        sign = "-" if n.subtract else "+"
        if not n.drop or n.subtract:
            return f"    wire signed [{value.width - 1}:0] {value.name} = {left} {sign} {right};\n"
        carried, carry = self._fresh(f"{value.name}_carried"), self._bits(n.left, 0, stage, n.left_shift, 0, n.drop)
        self.spare.append(f"{carried}[0]")
        return (
            f"    wire [{value.width}:0] {carried} = {{{left}, 1'b1}} + {{{right}, |{carry}}};\n"
            f"    wire signed [{value.width - 1}:0] {value.name} = {carried}[{value.width}:1];\n"
        )

    def _row(self, r: int, adders: str) -> tuple[str, str]:
        """The row in physical numbers, its own adders, its rounding; and the name of the code."""
        o, p = self.o, self.graph.outputs[r]
        row, text = self._fresh(f"row_{r}"), self._formula(r) + adders
        shift, width = int(o.frac[r]) - o.out.fix.frac, o.out.fix.width
        if p.operand == CONSTANT:
            exact = round_shift(o.bias[r : r + 1], np.array([shift]), o.rounding)
            constant = int(fit(exact, o.out.fix, o.overflow)[0])
            return self._limited(text + f"    wire signed [{width - 1}:0] {row} = {number(constant, width)};\n", row)
        value = self.at(p.operand, self.clocks - 1 if self.pipelined else self.stages.of[p.operand])
        lo, hi = self.graph.range(p.operand)
        if p.negate:
            lo, hi = -hi, -lo
            negated = _Value(self._fresh(f"negated_{r}"), signed_width(lo, hi))
            zeros = value.bits(0, 0, negated.width)
            text += f"    wire signed [{negated.width - 1}:0] {negated.name} = {negated.width}'d0 - {zeros};\n"
            value = negated
        drop = max(0, shift)
        left = p.shift + max(0, -shift)
        lo, hi = (lo << left) >> drop, (hi << left) >> drop
        odd = ""
        if o.rounding is Rounding.HALF_EVEN and shift > 0:
            lo &= ~1
            odd = self._fresh(f"odd_{r}")  # the lowest bit, which is 0 where the sum lay between two codes
            low = value.bits(left, 0, drop)
            text += f"    wire {odd} = {value.bits(left, drop, 1)} && {low} != {drop}'d0;\n"

        def bits(low: int, count: int) -> str:
            if not odd or low:
                return value.bits(left, drop + low, count)
            return odd if count == 1 else f"{{{value.bits(left, drop + 1, count - 1)}, {odd}}}"

        if o.overflow is Overflow.WRAP or (o.out.fix.lo <= lo and hi <= o.out.fix.hi):
            code = bits(0, width)
        else:
            more = signed_width(lo, hi) - width
            beyond, sign, told = self._fresh(f"beyond_{r}"), bits(width - 1 + more, 1), min(self.told, width - 2)
            text += f"    wire {beyond} = {bits(width - 1, more)} != {{{more}{{{sign}}}}};\n"
            code = f"{beyond} ? {{{width - 1 - told}{{!{sign}}}}} : {bits(told, width - 1 - told)}"
            code = f"{{{sign}, {code}{f', {bits(0, told)}' if told else ''}}}"
        if p.negate:
            self.spare += value.unread()
        return self._limited(text + f"    wire signed [{width - 1}:0] {row} = {code};\n", row)

    def _limited(self, text: str, row: str) -> tuple[str, str]:
        """The code of a row within the limits of the clamp."""
        if not self.clamp:
            return text, row
        fix, limited = self.o.out.fix, self._fresh(f"limited_{row}")
        lo, hi = (number(v, fix.width) for v in (self.clamp.lo, self.clamp.hi))
        code = f"{row} > {hi} ? {hi} : {row}" if self.clamp.hi < fix.hi else row
        code = f"{row} < {lo} ? {lo} : {code}" if self.clamp.lo > fix.lo else code
        return f"{text}    wire signed [{fix.width - 1}:0] {limited} = {code};\n", limited

    def _formula(self, r: int) -> str:
        """A comment: the row in physical numbers."""
        o, frac = self.o, int(self.o.frac[r])
        weights = [(self.columns[j], int(w)) for j, w in enumerate(o.weights[r]) if w]
        floats = [f"{w * 2.0 ** (s.fix.frac - frac):+.6g} {s.name}[{k}]" for (s, k), w in weights]
        floats.append(f"{int(o.bias[r]) * 2.0**-frac:+.6g}")
        lines = wrapped([f"{o.out.name}[{r}] =", *floats], "").splitlines()
        return "\n" + "".join(f"    {remark(line)}\n" for line in lines)


def _owners(graph: Graph) -> list[int | None]:
    """The row that each node serves, None if there are several."""
    rows = [0] * (graph.columns + len(graph.nodes))  # a bit for each row
    for r, p in enumerate(graph.outputs):
        if p.operand != CONSTANT:
            rows[p.operand] |= 1 << r
    for k in range(len(graph.nodes) - 1, -1, -1):
        for operand in (graph.nodes[k].left, graph.nodes[k].right):
            if operand != CONSTANT:
                rows[operand] |= rows[graph.columns + k]
    return [m.bit_length() - 1 if m & (m - 1) == 0 else None for m in rows[graph.columns :]]
