"""The folded architecture: few multipliers, one memory of codes, and a schedule in ROM that controls every clock.

The datapath is drawn from left to right. The fields of a line of the schedule act in the clock of that line:

    read ─ x ┬─ multiply-accumulate (weights, first, next, bias) ─ hold ─ pick ─ round ─ fit ─┬─ write
             └─ tables, clamps, thresholds, selects, copy ────────────────────────────────────┘

compiler/schedule.py makes the schedule; this module writes the datapath and its ROMs.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from greygate.compiler.schedule import COPY, Folding, fold
from greygate.compiler.targets import MULTIPLIERS, Architecture, Design, Register
from greygate.compiler.verilog import (
    header,
    input_slices,
    instance,
    lane_width,
    module_text,
    number,
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
from greygate.emulator.program import Affine, Program, Select, signed_width
from greygate.errors import InputError

EDGES = 3  # clocks that the streams and the inputs take beside the schedule


def folded(program: Program, macs: int) -> dict[str, str]:
    """File name -> text of the folded architecture, without the building blocks."""
    if macs not in MULTIPLIERS:
        raise InputError(f"{macs} multipliers are not in {MULTIPLIERS.start}..{MULTIPLIERS.stop - 1}")
    verilog_names(program)
    core = _Core(program, macs, fold(program, macs))
    return {
        f"{program.name}.v": core.top(),
        f"{program.name}__schedule.v": core.schedule_rom(),
        f"{program.name}__biases.v": core.biases_rom(),
    } | table_texts(program)


def registers(program: Program) -> list[Register]:
    """States take the first words of the memory, in order."""
    return [Register(f"memory[{k}]", alone=True) for k in range(sum(s.signal.size for s in program.states))]


def clocks(program: Program, design: Design) -> int:
    """Clocks from one sample to the next."""
    return len(fold(program, design.multipliers).schedule.lines) + EDGES


TARGET = Architecture(
    lambda program, design: folded(program, design.multipliers) | table_texts(program, design.memory),
    registers,
    clocks,
)


@dataclass(frozen=True)
class _Core:
    """A folded program, and the Verilog of each part of its datapath."""

    program: Program
    macs: int
    folding: Folding

    # -- widths ------------------------------------------------------------------------------------------------------

    @cached_property
    def widths(self) -> dict[str, int]:
        """Widths of the datapath and of the fields of a line."""
        program = self.program
        affine = [o for o in program.operations if isinstance(o, Affine)]
        beyond = max(sum(p.signal.size for p in program.inputs), sum(p.signal.size for p in program.outputs))
        shifts = [int(s) - o.out.fix.frac for o in affine for s in o.frac] or [0]
        return {
            "code": max(s.fix.width for s in program.signals.values()),
            "weight": max([2, *(signed_width(int(np.abs(o.weights).max(initial=0))) for o in affine)]),
            "acc": max([2, *(program.accumulator_width(o) for o in affine)]),
            "address": bits(self.folding.words + beyond - 1),
            "group": bits(len(self.folding.groups) - 1),
            "pick": bits(self.macs - 1),
            "shift": max(2, *(signed_width(s) for s in map(abs, shifts)), 2),
            "left": max(0, -min(shifts)),
            "width": 6,
            "source": bits(COPY + len(self.folding.units)),
            "pc": bits(len(self.folding.schedule.lines) - 1),
        }

    @cached_property
    def fields(self) -> list[tuple[str, int, bool]]:
        """(name, width, signed) of the fields of a line, from left to right."""
        w = self.widths
        flags = [(n, 1, False) for n in ("last", "enable")]
        head = [("source", w["source"], False), ("write", w["address"], False)]
        drain = [("saturate", 1, False), ("width", w["width"], False), ("rounding", 2, False)]
        middle = [("shift", w["shift"], True), ("pick", w["pick"], False)]
        middle += [(n, 1, False) for n in ("hold", "next", "first")]
        tail = [("group", w["group"], False), ("read", w["address"], False)]
        return flags + head + drain + middle + tail + [(f"weight_{m}", w["weight"], True) for m in range(self.macs)]

    def constant(self, what: str, value: int) -> str:
        """An unsigned constant as wide as that field."""
        return f"{self.widths[what]}'d{value}"

    def code(self, name: str, low: int, width: int) -> str:
        """The code at bit `low` of a vector, extended to the width of the memory's words."""
        return sign_extended(name, low, width, self.widths["code"])

    # -- the ROMs ----------------------------------------------------------------------------------------------------

    def schedule_rom(self) -> str:
        lines, notes = self.folding.schedule.lines, self.folding.schedule.notes
        rows = []
        for t, line in enumerate(lines):
            values = [number(line.get(n, 0), k) if s else f"{k}'d{line.get(n, 0)}" for n, k, s in self.fields]
            rows.append(f"rom[{t}] = {{{', '.join(values)}}};  {remark('; '.join(notes[t]) or 'idle')}")
        ports = [f"    input  wire clk,\n    input  wire [{self.widths['pc'] - 1}:0] pc"]
        ports += [f"    output wire {'signed ' if s else ''}[{k - 1}:0] {n}" for n, k, s in self.fields]
        comment = [
            f"Schedule of {self.program.name}: what every clock of a step does. {len(lines)} lines, line 0 is idle.",
            "Fields from left to right as in the assignment to them below.",
        ]
        *others, last = (n for n, _, _ in self.fields)
        named = wrapped([*(f"{n}," for n in others), last], "        ")
        assign = f"    assign {{\n{named}\n    }} = line;\n"
        width = sum(k for _, k, _ in self.fields)
        return rom_text(comment, f"{self.program.name}__schedule", ",\n".join(ports), width, rows, "pc", assign)

    def biases_rom(self) -> str:
        acc, width = self.widths["acc"], self.macs * self.widths["acc"]
        groups = self.folding.groups + [("no rows", [])] * (2 - len(self.folding.groups))
        rows = []
        for g, (label, biases) in enumerate(groups):
            values = [number(b, acc) for b in [*biases, *[0] * (self.macs - len(biases))]]
            rows.append(f"rom[{g}] = {{{', '.join(reversed(values))}}};  {remark(label)}")
        ports = f"    input  wire clk,\n    input  wire [{self.widths['group'] - 1}:0] group,\n"
        ports += f"    output wire [{width - 1}:0] bias"
        comment = [f"Biases of {self.program.name}, a group of {self.macs} rows a line, the first row on the right."]
        name = f"{self.program.name}__biases"
        return rom_text(comment, name, ports, width, rows, "group", "    assign bias = line;\n")

    # -- the datapath ------------------------------------------------------------------------------------------------

    def top(self) -> str:
        ports, width_in, width_out = top_ports(self.program)
        parts = (self.counter, self.memory, self.boot, self.argument, self.multipliers, self.units, self.outputs)
        body = f"""\
module {self.program.name} (
{ports}
);

    wire [{width_in - 1}:0] sample;
    wire [{width_out - 1}:0] result;
    wire start;
{"".join(part() for part in parts)}"""
        head = header(self.program, f"folded ({self.macs} multipliers)")
        return module_text(head, body + stream_instance(width_in, width_out, "booted"))

    def counter(self) -> str:
        """The counter of the line of the schedule that acts."""
        last = self.widths["pc"] - 1
        zero, one = (self.constant("pc", n) for n in (0, 1))
        final = self.constant("pc", len(self.folding.schedule.lines) - 1)
        wires = "".join(f"    wire {'signed ' if signed else ''}[{k - 1}:0] {n};\n" for n, k, signed in self.fields)
        ends = {"clk": "clk", "pc": "pc"} | {n: n for n, _, _ in self.fields}
        return f"""
    // the schedule: one line a clock; line 0 is idle
{wires}    reg booted;
    wire done = last && booted;
    reg [{last}:0] pc;
    always @(posedge clk)
        if (rst) pc <= {zero};
        else if (start) pc <= {one};
        else if (pc != {zero}) pc <= pc == {final} ? {zero} : pc + {one};

{instance(f"{self.program.name}__schedule", "schedule", {}, ends)}"""

    def memory(self) -> str:
        """The memory, with the content of each word."""
        code, address = self.widths["code"] - 1, self.widths["address"]
        held = ""
        for s in [*(s.signal for s in self.program.states), *(o.out for o in self.program.operations)]:
            first = self.folding.address[s.name]
            last = f"..{first + s.size - 1}" if s.size > 1 else ""
            held += f"    {remark(f'{first}{last}: {s.name}, {s.size} x {s.fix}')}\n"
        return f"""
    // the memory: states first, then results; after a reset the initial states are written
{held}    reg signed [{code}:0] memory[0:{(1 << address) - 1}];
    reg [{address - 1}:0] boot;
    reg signed [{code}:0] initial_code;
    reg signed [{code}:0] y;
"""

    def boot(self) -> str:
        """The writes to the memory: the initial states after a reset, and the results of a step."""
        code = self.widths["code"]
        zero, one = (self.constant("address", n) for n in (0, 1))
        initial = [(f"{s.signal.name}[{k}]", v) for s in self.program.states for k, v in enumerate(s.initial)]
        cases = "".join(
            f"            {self.constant('address', n)}: initial_code = {number(v, code)};  {remark(element)}\n"
            for n, (element, v) in enumerate(initial)
        )
        return f"""
    always @(posedge clk)
        if (rst) begin
            boot <= {zero};
            booted <= 1'b0;
        end else if (!booted) begin
            boot <= boot + {one};
            booted <= boot == {self.constant("address", max(0, len(initial) - 1))};
        end

    always @*
        case (boot)
{cases}            default: initial_code = {code}'sd0;
        endcase

    always @(posedge clk)
        if (!booted) memory[boot] <= initial_code;
        else if (enable && write < {self.constant("address", self.folding.words)}) memory[write] <= y;
"""

    def argument(self) -> str:
        """The code that is read: from the memory or, at addresses beyond its words, from the input sample."""
        code, words = self.widths["code"] - 1, self.folding.words
        slices, cases = input_slices(self.program), ""
        for n, (s, k, low) in enumerate(slices):
            case = self.constant("address", words + n) if n + 1 < len(slices) else "default"
            value = self.code("sample", low, s.fix.width)
            cases += f"            {case}: input_code <= {value};  {remark(f'{s.name}[{k}]')}\n"
        return f"""
    reg signed [{code}:0] word;
    always @(posedge clk) word <= memory[read];

    reg from_input;
    reg signed [{code}:0] input_code;
    reg signed [{code}:0] x;  // a register of its own: block RAM is slow to answer
    always @(posedge clk) begin
        x <= from_input ? input_code : word;
        from_input <= read >= {self.constant("address", words)};
        case (read)
{cases}        endcase
    end
{unused_text(unused_bits(self.program), "  // sign extensions")}"""

    def multipliers(self) -> str:
        """The sums of products, and the path of a held row to its format."""
        w, macs = self.widths, self.macs
        code, acc = w["code"], w["acc"]
        parts = [f"[{(m + 1) * acc - 1}:{m * acc}]" for m in range(macs)]
        sums = ""
        for m, part in enumerate(parts):
            ends = {"clk": "clk", "x": "x", "weight": f"weight_{m}", "first": "first", "next": "next"}
            ends |= {"bias": f"bias{part}", "acc": f"sums{part}"}
            sums += "\n" + instance(
                "greygate_mac", f"mac_{m}", {"X_W": code, "WEIGHT_W": w["weight"], "ACC_W": acc}, ends
            )
        rows = "".join(f"            {self.constant('pick', m)}: row = held{parts[m]};\n" for m in range(1, macs))
        drain = instance(
            "greygate_drain",
            "drain",
            {"IN_W": acc, "OUT_W": code, "SHIFT_W": w["shift"], "LEFT": w["left"], "WIDTH_W": w["width"]},
            {"clk": "clk", "a": "row"} | {n: n for n in ("shift", "rounding", "width", "saturate")} | {"y": "drained"},
        )
        biases = {"clk": "clk", "group": "group", "bias": "bias"}
        return f"""
    // {macs} multipliers: sums, held while they are drained row by row
    wire [{macs * acc - 1}:0] bias;
    wire [{macs * acc - 1}:0] sums;
    reg [{macs * acc - 1}:0] held;
    reg signed [{acc - 1}:0] row;
    wire signed [{code - 1}:0] drained;

{instance(f"{self.program.name}__biases", "biases", {}, biases)}{sums}
    always @(posedge clk) if (hold) held <= sums;

    always @*
        case (pick)
{rows}            default: row = held{parts[0]};
        endcase

{drain}"""

    def units(self) -> str:
        """The units that answer an argument: a copy, and one for each small operation or shared table."""
        code = self.widths["code"] - 1
        before = ["x", "x_last", "x_before_last"]  # the codes read 0, 1 and 2 clocks earlier
        units, cases = "", [f"{self.constant('source', COPY)}: y = copied;"]
        for n, (key, o) in enumerate(self.folding.units.items()):
            module, parameters, ports = small_operation(self.program, o, size=1)
            out = o.out.fix.width
            ends = {"clk": "clk", "en": "1'b1"}
            for port, argument, place in zip(ports, o.args, reversed(before[: len(ports)]), strict=True):
                ends[port] = f"{place}[{self.program.signals[argument].fix.width - 1}:0]"
            ends["y"] = f"unit_{n}"
            units += f"\n    wire [{out - 1}:0] unit_{n};  {remark(key)}\n"
            units += instance(module, f"unit_{n}_{o.op.value}", parameters, ends)
            cases.append(
                f"{self.constant('source', COPY + 1 + n)}: y = {self.code(f'unit_{n}', 0, out)};  {remark(key)}"
            )
        return f"""
    // what answers an argument in one clock, or a table in more
    reg signed [{code}:0] copied;
    always @(posedge clk) copied <= x;
{self.select_arguments()}{units}
    always @*
        case (source)
{"".join(f"            {case}" + chr(10) for case in cases)}            default: y = drained;
        endcase
"""

    def select_arguments(self) -> str:
        """The two codes before the last, for units that read three, only as wide as these units need."""
        selects = [o for o in self.folding.units.values() if isinstance(o, Select)]
        if not selects:
            return ""
        condition, above = (
            max(self.program.signals[getattr(o, part)].fix.width for o in selects) for part in ("condition", "above")
        )
        last = max(condition, above)
        return f"""\
    // a select reads three codes on end
    reg [{last - 1}:0] x_last;
    reg [{condition - 1}:0] x_before_last;
    always @(posedge clk) begin
        x_last <= x[{last - 1}:0];
        x_before_last <= x_last[{condition - 1}:0];
    end
"""

    def outputs(self) -> str:
        """The registers of the outputs, and the result that they form."""
        codes = ""
        shown: list[str] = []
        for p in self.program.outputs:
            width = p.signal.fix.width
            for k in range(p.signal.size):
                n = len(shown)
                codes += (
                    f"    reg [{width - 1}:0] output_{n};  {remark(f'{p.name}[{k}]')}\n"
                    f"    always @(posedge clk) if (enable && write == "
                    f"{self.constant('address', self.folding.words + n)}) output_{n} <= y[{width - 1}:0];\n"
                )
                shown.append(sign_extended(f"output_{n}", 0, width, lane_width(p.signal)))
        return f"\n    // outputs\n{codes}{result_text(shown)}"


def bits(largest: int) -> int:
    """Width of an unsigned number up to `largest`."""
    return max(1, int(largest).bit_length())


def rom_text(comment: list[str], name: str, ports: str, width: int, rows: list[str], index: str, out: str) -> str:
    """A synchronous ROM with lines that a person can read."""
    return module_text(
        comment,
        f"module {name} (\n{ports}\n);\n\n"
        f"    reg [{width - 1}:0] rom[0:{len(rows) - 1}];\n"
        f"    reg [{width - 1}:0] line;\n"
        f"    always @(posedge clk) line <= rom[{index}];\n{out}\n"
        "    initial begin\n" + "\n".join(f"        {r}" for r in rows) + "\n    end\n",
    )
