"""The folded architecture: few multipliers, one memory of codes, and a schedule in ROM that controls every clock.

The datapath is drawn from left to right:

    samples ──────────────────────────────────────────────────────────────┐
    memory ─ word ┬─ part ─ multiply ─ shift ─ add ─ drain ┬──────────────┼─ y ─ memory, results
                  │         (words, selects, biases)       └─ tables ─────┤
                  └─ clamps, thresholds, selects, tables, copies ─────────┘

compiler/folding/schedule.py makes the schedule; this module writes the datapath and its ROMs.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from greygate.compiler.folding.products import PLAIN, Mode
from greygate.compiler.folding.roms import bits, flags, rom_rows, rom_text, vector
from greygate.compiler.folding.schedule import Folding, fold
from greygate.compiler.folding.schedule_lines import COPIED, FIELDS, NEAR, SAMPLED, UNITS
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
    table_texts,
    top_ports,
    unused_bits,
    unused_text,
    verilog_names,
)
from greygate.emulator.program import Program, Select
from greygate.errors import InputError


def folded(program: Program, design: Design) -> dict[str, str]:
    """File name -> text of the folded architecture, without the building blocks."""
    multipliers = design.multipliers
    if multipliers not in MULTIPLIERS:
        raise InputError(f"{multipliers} multipliers are not in {MULTIPLIERS.start}..{MULTIPLIERS.stop - 1}")
    verilog_names(program)
    core = _Core(program, fold(program, multipliers, design.factor))
    return {
        f"{program.name}.v": core.top(),
        f"{program.name}__schedule.v": core.schedule_rom(),
        f"{program.name}__biases.v": core.biases_rom(),
    } | table_texts(program, design.memory, late=True)


def registers(program: Program, design: Design) -> list[Register]:
    """States stand in words of the memory."""
    address = fold(program, design.multipliers, design.factor).address
    return [Register(f"memory[{word}]", alone=True) for s in program.states for word in address[s.signal.name].tolist()]


def clocks(program: Program, design: Design) -> int:
    """Clocks of a step: the lines of the schedule, and the one in which the next sample is taken."""
    return fold(program, design.multipliers, design.factor).clocks + 1


def memories(program: Program, design: Design) -> tuple[tuple[int, int], tuple[int, int], tuple[int, int]]:
    """(words, bits) of the schedule, of the biases, and of the memory of codes."""
    folding = fold(program, design.multipliers, design.factor)
    core = _Core(program, folding)
    line = sum(width for _, width, _ in core.fields)
    return (len(folding.reads), line), (max(1, len(folding.biases)), core.widths["acc"]), (
        1 << core.widths["address"], core.widths["code"])  # fmt: skip


TARGET = Architecture(folded, registers, clocks)


@dataclass(frozen=True)
class _Core:
    """A folded program, and the Verilog of each part of its datapath."""

    program: Program
    folding: Folding

    # -- widths ------------------------------------------------------------------------------------------------------

    @cached_property
    def widths(self) -> dict[str, int]:
        """Widths of the datapath and of the fields of a line."""
        program, f = self.program, self.folding
        kept = [s.fix.width for s in program.signals.values() if s.name in f.kept]
        shown = [p.signal.fix.width for p in program.outputs]
        return {
            "code": max([2, *kept]),  # of the memory
            "y": max([2, *kept, *shown]),
            "shown": max(shown),
            "input": max(p.signal.fix.width for p in program.inputs),
            "drained": max([2, *(m.width for m in f.modes)]),
            "address": bits(f.size - 1),
            "bias": bits(len(f.biases) - 1),
            "pc": bits(len(f.reads) - 1),
            "select": max(1, len(f.products.stages)),
            "word": f.products.word_width,
            "acc": f.acc_width,
            "x": f.products.x_width,
        }

    @cached_property
    def controls(self) -> dict[str, int]:
        """Width of each field of the control that is used at all, from left to right."""
        largest = self.folding.controls.max(axis=0).tolist()
        found = {name: bits(most) for name, most in zip(FIELDS, largest, strict=True) if most}
        always = ["source", "mode", "row"] + ["first", "last"] * (self.folding.multipliers > 1)
        return found | {name: 1 for name in always if name not in found}

    @cached_property
    def codes(self) -> tuple[np.ndarray, np.ndarray]:
        """The different values of the control, idle first, and the number of the one in each line."""
        packed = np.zeros(len(self.folding.controls), np.int64)
        for column in self.folding.controls.T:
            packed = packed << bits(column.max()) | column
        _, first, codes = np.unique(packed, return_index=True, return_inverse=True)
        return self.folding.controls[first], codes

    def constant(self, what: str, value: int) -> str:
        """An unsigned constant of that width."""
        return f"{self.widths[what]}'d{value}"

    def extended(self, name: str, width: int, to: int) -> str:
        """The low bits of a signed vector of `width` bits, extended or cut to `to` bits."""
        if width >= to:
            return name if width == to else f"{name}[{to - 1}:0]"
        return sign_extended(name, 0, width, to)

    # -- the ROMs ----------------------------------------------------------------------------------------------------

    @cached_property
    def fields(self) -> list[tuple[str, int, bool]]:
        """(name, width, signed) of the fields of a line, from left to right."""
        w, several = self.widths, range(self.folding.multipliers)
        found = [("code", bits(len(self.codes[0]) - 1), False), ("read", w["address"], False)]
        if self.folding.products.stages:
            found += [(f"select_{m}", w["select"], False) for m in several]
        return found + [(f"word_{m}", w["word"], True) for m in several]

    def columns(self) -> dict[str, np.ndarray]:
        """Field of a line -> its values."""
        f = self.folding
        found = {"code": self.codes[1], "read": f.reads}
        for m in range(f.multipliers):
            found |= {f"select_{m}": f.selects[:, m], f"word_{m}": f.words[:, m]}
        return found

    def schedule_rom(self) -> str:
        f = self.folding
        given = self.columns()
        rows = rom_rows([(given[name], k, s) for name, k, s in self.fields], f.notes)
        width = sum(k for _, k, _ in self.fields)
        ports = [f"    input  wire clk,\n    input  wire [{self.widths['pc'] - 1}:0] pc"]
        ports += [f"    output wire {'signed ' if s else ''}[{k - 1}:0] {n}" for n, k, s in self.fields]
        comment = [
            f"Schedule of {self.program.name}: {f.idle} lines that write the initial states, and those of a step.",
            f"They make {f.products.count} products from the sample to the result, in {f.clocks} clocks:"
            f" {f.utilisation:.0%} of what {f.multipliers} multiplier{'s' * (f.multipliers > 1)} could.",
            "Fields of a line from left to right: " + ", ".join(n for n, _, _ in self.fields) + ".",
        ]
        out = f"    assign {{{', '.join(n for n, _, _ in self.fields)}}} = line;\n"
        return rom_text(comment, f"{self.program.name}__schedule", ",\n".join(ports), width, rows, "pc", out)

    def biases_rom(self) -> str:
        f, width = self.folding, self.widths["acc"]
        rows = [f"{number(b, width)};" for b in f.biases] or [f"{width}'sd0;"]
        ports = f"    input  wire clk,\n    input  wire [{self.widths['bias'] - 1}:0] index,\n"
        ports += f"    output wire [{width - 1}:0] bias"
        comment = [
            f"Biases of {self.program.name} with their rounding constants, in the order in which the rows begin;"
            f" {f.boots} initial states first."
        ]
        name = f"{self.program.name}__biases"
        return rom_text(comment, name, ports, width, rows, "index", "    assign bias = line;\n")

    # -- the datapath ------------------------------------------------------------------------------------------------

    def top(self) -> str:
        ports, _, _ = top_ports(self.program)
        parts = (self.edge, self.counter, self.control, self.memory, self.multipliers, self.units, self.results)
        body = f"""\
module {self.program.name} (
{ports}
);
{"".join(part() for part in parts)}"""
        f = self.folding
        kind = f"folded ({f.multipliers} multiplier{'s' * (f.multipliers > 1)}, a sample in {f.clocks + 1} clocks)"
        return module_text(header(self.program, kind), body)

    def edge(self) -> str:
        """The handshakes, and the sample: element by element it moves down to bit 0, from where it is written."""
        w, slices = self.widths["input"], input_slices(self.program)
        lanes = [sign_extended("s_axis_tdata", low, s.fix.width, w) for s, _, low in slices]
        loaded = ",\n".join(f"            {lane}" for lane in reversed(lanes))
        rest = f"{{{w}'d0, sample[{len(lanes) * w - 1}:{w}]}}" if len(lanes) > 1 else ""
        shift = f"\n        else if (write && source == {self.source(SAMPLED)}) sample <= {rest};" if rest else ""
        unread = unused_text(
            [b.replace("sample", "s_axis_tdata") for b in unused_bits(self.program)], "  // sign extensions"
        )
        regs = "".join(f"    reg {f'[{k - 1}:0] ' if k > 1 else ''}{n};\n" for n, k in self.controls.items())
        return f"""
    // the control: what happens in a clock
{regs}
    // a step runs from the sample to the result; a reset lasts two clocks, and the initial states are written after it
    reg reset_last, running, booting, finished;
    wire clear = rst || reset_last;
    wire go = s_axis_tvalid && s_axis_tready;
    assign s_axis_tready = !running && !finished && !rst;
    assign m_axis_tvalid = finished;

    always @(posedge clk) begin
        reset_last <= rst;
        if (go) running <= 1'b1;
        if (m_axis_tready) finished <= 1'b0;
        if (done) begin
            running <= 1'b0;
            booting <= 1'b0;
            finished <= !booting;
        end
        if (clear) begin
            running <= 1'b1;
            booting <= 1'b1;
            finished <= 1'b0;
        end
    end

    reg [{len(lanes) * w - 1}:0] sample;
    always @(posedge clk)
        if (go) sample <= {{
{loaded}
        }};{shift}
{unread}"""

    def counter(self) -> str:
        """The counters of the lines, of the words that are written and of the biases."""
        w = self.widths
        wires = "".join(f"    wire {'signed ' if s else ''}[{k - 1}:0] {n};\n" for n, k, s in self.fields)
        ends = {"clk": "clk", "pc": "pc"} | {n: n for n, _, _ in self.fields}
        idle, one = self.constant("pc", self.folding.idle), self.constant("pc", 1)
        return f"""
    // the schedule: one line a clock; a step waits at line {self.folding.idle}
{wires}    reg [{w["pc"] - 1}:0] pc;
    always @(posedge clk)
        if (clear) pc <= {self.constant("pc", 0)};
        else if (done || !(running || go)) pc <= {idle};
        else pc <= pc + {one};

{instance(f"{self.program.name}__schedule", "schedule", {}, ends)}
    // results are written to one word after the other, initial states where the line says
    reg [{w["address"] - 1}:0] written;
    always @(posedge clk)
        if (go) written <= {self.constant("address", 0)};
        else if (write) written <= written + {self.constant("address", 1)};

    // and rows take one bias after the other
    reg [{w["bias"] - 1}:0] index;
    wire [{w["acc"] - 1}:0] bias;
    always @(posedge clk)
        if (clear) index <= {self.constant("bias", 0)};
        else if (go) index <= {self.constant("bias", self.folding.boots % (1 << w["bias"]))};
        else if (row) index <= index + {self.constant("bias", 1)};

{instance(f"{self.program.name}__biases", "biases", {}, {"clk": "clk", "index": "index", "bias": "bias"})}"""

    def control(self) -> str:
        """The control: what the code of a line stands for."""
        values, _ = self.codes
        names, width = list(self.controls), sum(self.controls.values())
        places = [FIELDS.index(n) for n in names]
        code = bits(len(values) - 1)
        cases = ""
        for n, value in enumerate(values.tolist()):
            if n:
                parts = ", ".join(f"{self.controls[name]}'d{value[i]}" for name, i in zip(names, places, strict=True))
                cases += f"            {code}'d{n}: {{{', '.join(names)}}} <= {{{parts}}};\n"
        return f"""
    // what the code of a line stands for
    always @(posedge clk)
        if (clear) {{{", ".join(names)}}} <= {width}'d0;
        else
            case (code)
{cases.replace("            ", "                ")}                default: {{{", ".join(names)}}} <= {width}'d0;
            endcase
"""

    def source(self, value: int) -> str:
        return f"{self.controls['source']}'d{value}"

    def memory(self) -> str:
        """The memory, with the content of each word."""
        f, w = self.folding, self.widths
        code, address = w["code"], w["address"]
        held = ""
        for s in [
            *(p.signal for p in self.program.inputs),
            *(o.out for o in self.program.operations),
            *(s.signal for s in self.program.states),
        ]:
            if s.name in f.kept and s.size:
                words = ", ".join(map(str, f.address[s.name][:8].tolist())) + (", ..." if s.size > 8 else "")
                held += f"    {remark(f'{s.name}, {s.size} x {s.fix}: {words}')}\n"
        return f"""
    // the memory, and the words of each signal
{held}    (* no_rw_check *) reg signed [{code - 1}:0] memory[0:{(1 << address) - 1}];
    reg signed [{code - 1}:0] word;
    reg signed [{w["y"] - 1}:0] y;
    wire [{address - 1}:0] place = booting ? read : written;
    integer k;
    initial for (k = 0; k < {1 << address}; k = k + 1) memory[k] = {code}'sd0;
    always @(posedge clk) begin
        word <= memory[read];
        if (write) memory[place] <= {self.extended("y", w["y"], code)};
    end
"""

    def multipliers(self) -> str:
        """The sums of products, and their way to a format."""
        f, w = self.folding, self.widths
        x, acc, count = w["x"], w["acc"], f.multipliers
        stages = f.products.stages or (0,)
        parameters: dict[str, int | str] = {
            "X_W": x,
            "WORD_W": w["word"],
            "ACC_W": acc,
            "BASE": f.products.base,
            "STAGES": len(stages),
        }
        parameters |= {"AMOUNTS": vector(stages)}
        text = "\n    // the multipliers: each takes the code of the one before, one clock later\n" + self.part()
        text += "    reg first_0;\n    always @(posedge clk) first_0 <= row;\n" if count == 1 else ""
        text += "".join(self.one_multiplier(m, parameters) for m in range(count))
        text += f"    wire unused_x = &{{1'b0, x_{count}}};\n"
        modes = f.modes or (Mode(0, False, 2, False),)
        drain: dict[str, int | str] = {
            "IN_W": acc,
            "OUT_W": w["drained"],
            "MODES": len(modes),
            "MODE_W": self.controls["mode"],
        }
        drain |= {"SHIFTS": vector([m.shift for m in modes]), "WIDTHS": vector([m.width for m in modes])}
        drain |= {"EVEN": flags([m.even for m in modes]), "WRAPS": flags([m.wraps for m in modes])}
        picked, picks = self.picks()
        ends = {"clk": "clk", "a": picked, "mode": "mode", "y": "drained"}
        text += f"{picks}\n    wire signed [{w['drained'] - 1}:0] drained;\n"
        return text + instance("greygate_drain", "drain", drain, ends)

    def one_multiplier(self, m: int, parameters: dict) -> str:
        """The instance of a multiplier and its wires."""
        w, count = self.widths, self.folding.multipliers
        text = f"    wire signed [{w['x'] - 1}:0] x_{m + 1};\n    wire signed [{w['acc'] - 1}:0] acc_{m};\n"
        if count > 1 and m:
            text += f"    reg first_{m};\n    always @(posedge clk) first_{m} <= first_{m - 1};\n"
        elif count > 1:
            text += "    wire first_0 = first;\n"
        select = f"select_{m}" if self.folding.products.stages else "1'b0"
        ends = {"clk": "clk", "x": f"x_{m}", "word": f"word_{m}", "select": select, "first": f"first_{m}"}
        return text + instance(
            "greygate_mac", f"mac_{m}", parameters, ends | {"bias": "bias", "x_reg": f"x_{m + 1}", "acc": f"acc_{m}"}
        )

    def part(self) -> str:
        """The code, or the part of it, that is multiplied."""
        x, code = self.widths["x"], self.widths["code"]
        parts = self.folding.products.parts

        def bits_of(low: int, signed: bool) -> str:
            if (low, signed) == PLAIN:
                return self.extended("word", code, x)
            if signed:
                return sign_extended("word", low, min(x, code - low), x)
            return f"{{1'b0, word[{low + x - 2}:{low}]}}"

        kinds = [(n, part) for n, part in enumerate(parts) if part.low + (1 if part.signed else x - 1) <= code]
        if len(kinds) <= 1 or "part" not in self.controls:
            return f"    wire signed [{x - 1}:0] x_0 = {bits_of(*PLAIN)};\n"
        width = self.controls["part"]
        cases = "".join(f"            {width}'d{n}: x_0 = {bits_of(*part)};\n" for n, part in kinds if n)
        return f"""\
    reg signed [{x - 1}:0] x_0;
    always @*
        case (part)
{cases}            default: x_0 = {bits_of(*PLAIN)};
        endcase
"""

    def picks(self) -> tuple[str, str]:
        """The sum that is drained, and how it is picked: {NEAR} of them a clock."""
        acc, names, level = self.widths["acc"], [f"acc_{m}" for m in range(self.folding.multipliers)], 0
        if len(names) == 1:
            return names[0], ""
        width = bits(len(names) - 1)
        text = f"""
    // the sums end one clock after the other: the turn goes round
    reg [{width - 1}:0] turn_0;
    always @(posedge clk) turn_0 <= last ? {width}'d0 : turn_0 + {width}'d1;
"""
        while len(names) > 1:
            following = []
            low = 2 * level
            high = min(low + 1, width - 1)
            for g in range(0, len(names), NEAR):
                group, name = names[g : g + NEAR], f"picked_{level}_{g // NEAR}"
                following.append(name)
                chosen = group[-1]
                select = f"turn_{level}[{high}:{low}]"
                for i in range(len(group) - 2, -1, -1):
                    chosen = f"{select} == {high - low + 1}'d{i} ? {group[i]} : {chosen}"
                text += f"    reg signed [{acc - 1}:0] {name};\n    always @(posedge clk) {name} <= {chosen};\n"
            level, names = level + 1, following
            if len(names) > 1:
                text += f"    reg [{width - 1}:0] turn_{level};\n"
                text += f"    always @(posedge clk) turn_{level} <= turn_{level - 1};\n"
        used = [f"turn_{k}" for k in range(level)]
        return names[0], text + f"    wire unused_turn = &{{1'b0, {', '.join(used)}}};\n"

    def units(self) -> str:
        """The units that answer an argument, and the choice of what is written."""
        f, y = self.folding, self.widths["y"]
        code = self.widths["code"]
        before = ["argument", "argument_last", "argument_before_last"]  # the codes read 0, 1 and 2 clocks earlier
        text, cases = "", [f"{self.source(COPIED)}: y = {self.extended('word', code, y)};"]
        cases += [f"{self.source(SAMPLED)}: y = {self.first_sample(y)};"]
        for n, (key, o) in enumerate(f.units.items()):
            module, parameters, ports = small_operation(self.program, o, size=1)
            ends = {"clk": "clk", "en": "1'b1"}
            for port, argument, place in zip(ports, o.args, reversed(before[: len(ports)]), strict=True):
                ends[port] = self.argument(key, place, self.program.signals[argument].fix.width)
            ends["y"] = f"unit_{n}"
            out = o.out.fix.width
            text += f"\n    wire [{out - 1}:0] unit_{n};  {remark(key)}\n"
            text += instance(module, f"unit_{n}_{o.op.value}", parameters, ends)
            cases.append(f"{self.source(UNITS + n)}: y = {self.extended(f'unit_{n}', out, y)};  {remark(key)}")
        chosen = "".join(f"            {case}\n" for case in cases)
        unread = ", ".join(["sample", "drained", *(f"unit_{n}" for n in range(len(f.units)))])
        return f"""
    // what is written, and the units that answer an argument
{self.arguments()}{text}
    always @*
        case (source)
{chosen}            default: y = {self.extended("drained", self.widths["drained"], y)};
        endcase
    wire unused_y = &{{1'b0, {unread}}};  // a result may be wider than what is kept
"""

    def first_sample(self, to: int) -> str:
        """The element of the sample that is written next, extended or cut to `to` bits."""
        width = self.widths["input"]
        return sign_extended("sample", 0, min(width, to), to)

    def argument(self, key: str, place: str, width: int) -> str:
        """The argument of a unit: a row that is drained, a code of the memory, or either."""
        drained, stored = f"drained[{width - 1}:0]", f"{place}[{width - 1}:0]"
        if key in self.folding.fused and key in self.folding.stored:
            return f"stored ? {stored} : {drained}"
        return drained if key in self.folding.fused else stored

    def arguments(self) -> str:
        """The registers of the codes that units read from the memory, only as many and as wide as units need."""
        units = [o for key, o in self.folding.units.items() if key in self.folding.stored]
        if not units:
            return ""
        code = self.widths["code"]
        text = f"    reg signed [{code - 1}:0] argument;\n    always @(posedge clk) argument <= word;\n"
        text += "    wire unused_argument = &{1'b0, argument};\n"
        selects = [o for o in units if isinstance(o, Select)]
        if not selects:
            return text
        condition, above = (
            max(self.program.signals[getattr(o, part)].fix.width for o in selects) for part in ("condition", "above")
        )
        last = max(condition, above)
        return f"""{text}\
    // a select reads three codes on end
    reg [{last - 1}:0] argument_last;
    reg [{condition - 1}:0] argument_before_last;
    always @(posedge clk) begin
        argument_last <= argument[{last - 1}:0];
        argument_before_last <= argument_last[{condition - 1}:0];
    end
"""

    def results(self) -> str:
        """The registers of the outputs: what is shown moves down from the highest place."""
        f, w, y = self.folding, self.widths["shown"], self.widths["y"]
        places = 1 + max(max(places) for places in f.shown.values())
        lanes = []
        for p in self.program.outputs:
            for place in f.shown[p.signal.name]:
                lanes.append(sign_extended("results", place * w, p.signal.fix.width, lane_width(p.signal)))
        code = self.extended("y", y, w)
        following = f"{{{code}, results[{places * w - 1}:{w}]}}" if places > 1 else code
        used = [f"results[{places * w - 1}:0]"]
        return f"""
    // outputs
    reg [{places * w - 1}:0] results;
    always @(posedge clk) if (show) results <= {following};
{result_text(lanes).replace("assign result", "assign m_axis_tdata").rstrip()}
    wire unused_results = &{{1'b0, {", ".join(used)}}};
"""
