"""The folded architecture: few multipliers, one memory of codes, and a schedule in ROM that controls every clock.

The datapath is drawn from left to right:

    samples ──────────────────────────────────────────────────────────────┐
    memory ─ word ┬─ part ─ multiply ─ shift ─ add ─ drain ┬──────────────┼─ y ─ memory, results
                  │         (words, selects, biases)       └─ tables ─────┤
                  └─ clamps, thresholds, selects, tables, copies ─────────┘

compiler/folding/schedule.py makes the schedule; this module writes the datapath and its ROMs.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from greygate.compiler import verilog
from greygate.compiler.folding.products import Mode
from greygate.compiler.folding.schedule import COPIED, FIELDS, NEAR, REMARKED, SAMPLED, UNITS, Folding, fold
from greygate.compiler.targets import MULTIPLIERS, Architecture, Design, Register
from greygate.emulator.program import Elementwise, Product, Program, Select
from greygate.errors import InputError


def folded(program: Program, design: Design) -> dict[str, str]:
    """File name -> text of the folded architecture, without the building blocks."""
    multipliers = design.multipliers
    if multipliers not in MULTIPLIERS:
        raise InputError(f"{multipliers} multipliers are not in {MULTIPLIERS.start}..{MULTIPLIERS.stop - 1}")
    verilog.verilog_names(program)
    core = _Core(program, fold(program, multipliers, design.factor))
    return {
        f"{program.name}.v": core.top(),
        f"{program.name}__schedule.v": core.schedule_rom(),
        f"{program.name}__biases.v": core.biases_rom(),
    } | verilog.table_texts(program, design.memory, late=True)


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

DEEP = 16  # lines from which a ROM is kept in block RAM


@dataclass(frozen=True)
class _Core:
    """A folded program, and the Verilog of each part of its datapath."""

    program: Program
    folding: Folding

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

    def extended(self, name: str, width: int, to: int) -> str:
        """The low bits of a signed vector of `width` bits, extended or cut to `to` bits."""
        if width >= to:
            return name if width == to else f"{name}[{to - 1}:0]"
        return verilog.sign_extended(name, 0, width, to)

    @cached_property
    def fields(self) -> list[tuple[str, int, bool]]:
        """(name, width, signed) of the fields of a line, from left to right."""
        w, several = self.widths, range(self.folding.multipliers)
        found = [("code", bits(len(self.codes[0]) - 1), False), ("read", w["address"], False)]
        if self.pairs:
            found += [("read_other", w["address"], False)]
        if self.folding.products.stages:
            found += [(f"select_{m}", w["select"], False) for m in several]
        return found + [(f"word_{m}", w["word"], True) for m in several]

    def columns(self) -> dict[str, np.ndarray]:
        """Field of a line -> its values."""
        f = self.folding
        found = {"code": self.codes[1], "read": f.reads, "read_other": f.others}
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
        out = f"{{{', '.join(n for n, _, _ in self.fields)}}}"
        context = {"name": f"{self.program.name}__schedule", "ports": ",\n".join(ports), "width": width, "rows": rows}
        return rom_text(comment, context | {"index": "pc", "out": out})

    def biases_rom(self) -> str:
        f, width = self.folding, self.widths["acc"]
        rows = [f"{verilog.number(b, width)};" for b in f.biases] or [f"{width}'sd0;"]
        ports = f"    input  wire clk,\n    input  wire [{self.widths['bias'] - 1}:0] index,\n"
        ports += f"    output wire [{width - 1}:0] bias"
        comment = [
            f"Biases of {self.program.name} with their rounding constants, in the order in which the rows begin;"
            f" {f.boots} initial states first."
        ]
        context = {"name": f"{self.program.name}__biases", "ports": ports, "width": width, "rows": rows}
        return rom_text(comment, context | {"index": "index", "out": "bias"})

    def top(self) -> str:
        f, program, w = self.folding, self.program, self.widths
        lanes = [
            verilog.sign_extended("s_axis_tdata", low, s.fix.width, w["input"])
            for s, _, low in verilog.input_slices(program)
        ]
        unread = [b.replace("sample", "s_axis_tdata") for b in verilog.unused_bits(program)]
        places, shown = self.results()
        condition, last = self.selected()
        picked, picks = self.picks()
        ends = {"clk": "clk", "pc": "pc"} | {n: n for n, _, _ in self.fields}
        body = verilog.render(
            "folded.v",
            {
                **{
                    "name": program.name,
                    **verilog.stream_widths(program),
                    "core": self,
                    "f": f,
                    "w": w,
                    "lanes": lanes,
                },
                **{
                    "unread": verilog.unused_text(unread, "  // sign extensions"),
                    "held": self.held(),
                    "stored": self.stored,
                },
                **{"extended": self.extended, "source": self.source, "sign_extended": verilog.sign_extended},
                **{"COPIED": COPIED, "SAMPLED": SAMPLED, "UNITS": UNITS, "control": f"{{{', '.join(self.controls)}}}"},
                **{
                    "schedule": verilog.instance(f"{program.name}__schedule", "schedule", {}, ends),
                    "cases": self.cases(),
                },
                "biases": verilog.instance(
                    f"{program.name}__biases", "biases", {}, {n: n for n in ("clk", "index", "bias")}
                ),
                **{"parts": self.parts(), "plain": self.extended("word", w["code"], w["x"]), "macs": self.macs()},
                **{"picks": picks, "drain": self.drain(picked), "condition": condition, "last": last},
                **{"units": self.units(), "places": places, "shown": shown, "following": self.following(places)},
            },
        )
        kind = f"folded ({f.multipliers} multiplier{'s' * (f.multipliers > 1)}, a sample in {f.clocks + 1} clocks)"
        return verilog.module_text(verilog.header(program, kind), body)

    def cases(self) -> list[str]:
        """The control for each code but the idle one."""
        values, _ = self.codes
        names, code = ", ".join(self.controls), bits(len(values) - 1)
        places = [(width, FIELDS.index(name)) for name, width in self.controls.items()]
        parts = [", ".join(f"{width}'d{value[i]}" for width, i in places) for value in values.tolist()]
        return [f"{code}'d{n}: {{{names}}} <= {{{part}}};" for n, part in enumerate(parts) if n]

    def source(self, value: int) -> str:
        return f"{self.controls['source']}'d{value}"

    def held(self) -> list[str]:
        """Comments: the words of each signal that has any."""
        program, f = self.program, self.folding
        signals = [p.signal for p in program.inputs] + [o.out for o in program.operations]
        signals = [s for s in [*signals, *(s.signal for s in program.states)] if s.name in f.kept and s.size]
        words = {s.name: ", ".join(map(str, f.address[s.name][:8].tolist())) for s in signals}
        return [
            verilog.remark(f"{s.name}, {s.size} x {s.fix}: {words[s.name]}{', ...' * (s.size > 8)}") for s in signals
        ]

    def parts(self) -> list[tuple[int, str]]:
        """(number, bits of the word) of each part of a code that is multiplied."""
        x, code = self.widths["x"], self.widths["code"]
        found = []
        for n, (low, signed) in enumerate(self.folding.products.parts):
            if low + (1 if signed else x - 1) <= code:
                whole = f"{{1'b0, word[{low + x - 2}:{low}]}}"
                found.append((n, verilog.sign_extended("word", low, min(x, code - low), x) if signed else whole))
        return found if "part" in self.controls else []

    def macs(self) -> list[str]:
        """The instances of the multipliers."""
        products, w = self.folding.products, self.widths
        stages = products.stages or (0,)
        parameters: dict[str, int | str] = {"X_W": w["x"], "WORD_W": w["word"], "ACC_W": w["acc"]}
        parameters |= {"BASE": products.base, "STAGES": len(stages), "AMOUNTS": verilog.fields(stages, 8)}
        found = []
        for m in range(self.folding.multipliers):
            select = f"select_{m}" if products.stages else "1'b0"
            ends = {"clk": "clk", "x": f"x_{m}", "word": f"word_{m}", "select": select, "first": f"first_{m}"}
            ends |= {"bias": "bias", "x_reg": f"x_{m + 1}", "acc": f"acc_{m}"}
            found.append(verilog.instance("greygate_mac", f"mac_{m}", parameters, ends))
        return found

    def drain(self, picked: str) -> str:
        """The instance that brings a sum to its format."""
        modes = self.folding.modes or (Mode(0, False, 2, False),)
        drain: dict[str, int | str] = {"IN_W": self.widths["acc"], "OUT_W": self.widths["drained"]}
        drain |= {"MODES": len(modes), "MODE_W": self.controls["mode"]}
        drain |= {
            "SHIFTS": verilog.fields([m.shift for m in modes], 8),
            "WIDTHS": verilog.fields([m.width for m in modes], 8),
        }
        drain |= {"EVEN": flags([m.even for m in modes]), "WRAPS": flags([m.wraps for m in modes])}
        return verilog.instance(
            "greygate_drain", "drain", drain, {"clk": "clk", "a": picked, "mode": "mode", "y": "drained"}
        )

    def picks(self) -> tuple[str, list[str]]:
        """The sum that is drained, and how it is picked: NEAR of them a clock."""
        acc, names, level = self.widths["acc"], [f"acc_{m}" for m in range(self.folding.multipliers)], 0
        if len(names) == 1:
            return names[0], []
        width = bits(len(names) - 1)
        turn = f"always @(posedge clk) turn_0 <= last ? {width}'d0 : turn_0 + {width}'d1;"
        lines = [f"reg [{width - 1}:0] turn_0;", turn]
        while len(names) > 1:
            following = []
            low = 2 * level
            high = min(low + 1, width - 1)
            for g in range(0, len(names), NEAR):
                group, name = names[g : g + NEAR], f"picked_{level}_{g // NEAR}"
                following.append(name)
                chosen = group[-1]
                for i in range(len(group) - 2, -1, -1):
                    chosen = f"turn_{level}[{high}:{low}] == {high - low + 1}'d{i} ? {group[i]} : {chosen}"
                lines += [f"reg signed [{acc - 1}:0] {name};", f"always @(posedge clk) {name} <= {chosen};"]
            level, names = level + 1, following
            if len(names) > 1:
                lines.append(f"reg [{width - 1}:0] turn_{level};")
                lines.append(f"always @(posedge clk) turn_{level} <= turn_{level - 1};")
        used = ", ".join(f"turn_{k}" for k in range(level))
        return names[0], [*lines, f"wire unused_turn = &{{1'b0, {used}}};"]

    def units(self) -> list[dict]:
        """Width of the answer, comment and instance of the units that answer an argument."""
        found = []
        before = ["argument", "argument_last", "argument_before_last"]  # the codes read 0, 1 and 2 clocks earlier
        for n, (key, o) in enumerate(self.folding.units.items()):
            module, parameters, ports = verilog.small_operation(self.program, o, size=1)
            ends, places = {"clk": "clk", "en": "1'b1"}, before[len(ports) - 1 :: -1]
            if isinstance(o, Product):
                ends, places = ends | {"take": "1'b1"}, ["argument", "argument_other"]
            for port, argument, place in zip(ports, o.args, places, strict=True):
                ends[port] = self.argument(key, place, self.program.signals[argument].fix.width)
            text = verilog.instance(module, f"unit_{n}_{o.op.value}", parameters, ends | {"y": f"unit_{n}"})
            found.append({"width": o.out.fix.width, "remark": verilog.remark(key), "instance": text})
        return found

    def argument(self, key: str, place: str, width: int) -> str:
        """The argument of a unit: a row that is drained, a code of the memory, or either."""
        drained, stored = f"drained[{width - 1}:0]", f"{place}[{width - 1}:0]"
        if key in self.folding.fused and key in self.folding.stored:
            return f"stored ? {stored} : {drained}"
        return drained if key in self.folding.fused else stored

    @property
    def pairs(self) -> bool:
        """Whether the memory is read at two places at once, for a product."""
        return any(isinstance(o, Product) for o in self.folding.units.values())

    @property
    def stored(self) -> list[Elementwise]:
        """Units that read codes from the memory."""
        return [o for key, o in self.folding.units.items() if key in self.folding.stored]

    def selected(self) -> tuple[int, int]:
        """Widths of the codes read two clocks earlier and one: of conditions, and of these and what stands above."""
        signals, selects = self.program.signals, [o for o in self.stored if isinstance(o, Select)]
        condition = max((signals[o.condition].fix.width for o in selects), default=0)
        return condition, max([condition, *(signals[o.above].fix.width for o in selects)])

    def results(self) -> tuple[int, list[str]]:
        """Places of what is shown, which moves down from the highest, and the lanes of the outputs."""
        shown, w = self.folding.shown, self.widths["shown"]
        lanes = [
            verilog.sign_extended("results", place * w, p.signal.fix.width, verilog.lane_width(p.signal))
            for p in self.program.outputs
            for place in shown[p.signal.name]
        ]
        return 1 + max(max(places) for places in shown.values()), lanes

    def following(self, places: int) -> str:
        """What the results become when another is shown."""
        w = self.widths["shown"]
        code = self.extended("y", self.widths["y"], w)
        return f"{{{code}, results[{places * w - 1}:{w}]}}" if places > 1 else code


def bits(largest: int) -> int:
    """Width of an unsigned number up to `largest`."""
    return max(1, int(largest).bit_length())


def flags(values: Iterable[bool]) -> str:
    """Bits side by side, the first lowest."""
    listed = list(values)
    return f"{len(listed)}'b" + "".join(str(int(v)) for v in reversed(listed))


def rom_rows(columns: list[tuple[np.ndarray, int, bool]], notes: dict[int, list[str]]) -> list[str]:
    """The lines of a ROM from the columns (values, width, signed) of their fields; a long ROM as plain numbers."""
    count = len(columns[0][0])
    if count <= REMARKED:
        texts = [
            [verilog.number(v, k) if signed else f"{k}'d{v}" for v in values.tolist()] for values, k, signed in columns
        ]
        return [
            f"{{{', '.join(parts)}}};  {verilog.remark('; '.join(notes.get(t, ())) or '-')}"
            for t, parts in enumerate(zip(*texts, strict=True))
        ]
    total = [0] * count
    for values, k, _ in columns:
        mask = (1 << k) - 1
        total = [t << k | v & mask for t, v in zip(total, values.tolist(), strict=True)]
    width = sum(k for _, k, _ in columns)
    return [f"{width}'h{t:x};" for t in total]


def rom_text(comment: list[str], context: dict) -> str:
    """A synchronous ROM with lines that a person can read: name, ports, width, rows, index and what reads a line."""
    style = verilog.MEMORIES["block"] if len(context["rows"]) >= DEEP else ""
    return verilog.module_text(comment, verilog.render("rom.v", context | {"style": style}))
