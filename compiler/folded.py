"""The folded architecture: few multipliers, one memory of codes, a schedule in ROM that says what every clock does.

The datapath, from left to right; the fields of a line of the schedule act in the clock in which the line stands:

    read ─ x ┬─ multiply-accumulate (weights, first, next, bias) ─ hold ─ pick ─ round ─ fit ─┬─ write
             └─ tables, clamps, thresholds, selects, copy ────────────────────────────────────┘

Rows of a layer are taken `macs` at a time; a group visits the columns in which one of its rows has a weight, and is
drained while the next group is being summed.
"""

from dataclasses import dataclass, field

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
    number,
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
from greygate.emulator.program import Affine, Lookup, Operation, Overflow, Program, Select, signed_width

WEIGHT, SUM, HOLD, PICK = 2, 3, 4, 5  # clocks after the read of a column in which its weight, sum, ... act
FIT = 1  # clocks from pick to write
UNIT = 3  # clocks from the read of an argument to the write of a result
DRAIN, COPY = 0, 1  # what is written; units follow


@dataclass
class Schedule:
    """Lines of fields, placed so that no field has two values in one line. Line 0 is idle."""

    lines: list[dict[str, int]] = field(default_factory=lambda: [{}])
    notes: list[list[str]] = field(default_factory=lambda: [[]])

    def free(self, t: int, *names: str) -> bool:
        return t >= len(self.lines) or not any(n in self.lines[t] for n in names)

    def place(self, t: int, note: str = "", **values: int) -> None:
        assert self.free(t, *values), "two values for one field in one clock"
        while t >= len(self.lines):
            self.lines.append({})
            self.notes.append([])
        self.lines[t] |= values
        if note:
            self.notes[t].append(note)


@dataclass(frozen=True)
class Folding:
    """A program laid out for the folded datapath.

    address: word of element 0 of each signal. words: size of the memory; beyond it inputs are read, outputs written.
    groups: the biases of each group of rows. units: what answers an argument in one clock, by source number.
    """

    schedule: Schedule
    address: dict[str, int]
    words: int
    groups: list[tuple[str, list[int]]]
    units: list[tuple[str, Operation]]


def fold(program: Program, macs: int) -> Folding:
    """Place every read, sum, drain and write of one step."""
    schedule, groups, units = Schedule(), [], []
    address, words = {}, 0
    level = levels(program)
    operations = sorted(program.operations, key=lambda o: level[o.out.name])  # independent ones side by side
    for s in [*(s.signal for s in program.states), *(o.out for o in operations)]:
        address[s.name] = words
        words += s.size
    moves = [(s.source, s.signal.name) for s in program.states if s.source != s.signal.name]
    shadows, moves = ordered(moves)
    for original, shadow in shadows:
        address[shadow] = words
        words += program.signals[original].size
    beyond = words
    for p in program.inputs:
        address[p.signal.name] = beyond
        beyond += p.signal.size
    ready: dict[int, int] = {}  # word -> the first line that can read its new value
    last_read: dict[int, int] = {}
    summed, picked = 0, 0  # the last line that read a column, or picked a row

    def read(t: int, word: int, note: str) -> None:
        schedule.place(t, f"read {note}", read=word)
        last_read[word] = max(last_read.get(word, 0), t)

    def write(t: int, word: int, source: int, note: str, **values: int) -> None:
        schedule.place(t, f"write {note}", write=word, enable=1, source=source, **values)
        ready[word] = t + 1

    def through(source: int, arguments: list[tuple[int, str]], to: int, note: str) -> None:
        """Read words in clocks on end, and write what a unit makes of them."""
        t, last = last_read.get(to, 0) - UNIT, len(arguments) - 1
        t = max([t, *(ready.get(word, 1) - i for i, (word, _) in enumerate(arguments))])
        reads = range(len(arguments))
        while not (all(schedule.free(t + i, "read") for i in reads) and schedule.free(t + last + UNIT, "write")):
            t += 1
        for i, (word, what) in enumerate(arguments):
            read(t + i, word, what)
        write(t + last + UNIT, to, source, note)

    def rows(o: Affine, start: int) -> None:
        nonlocal summed, picked
        weights = o.weights[start : start + macs]
        columns = [address[a] + k for a in o.args for k in range(program.signals[a].size)]
        names = [f"{a}[{k}]" for a in o.args for k in range(program.signals[a].size)]
        used = np.flatnonzero(np.any(weights != 0, axis=0)).tolist() or [0]
        used.sort(key=lambda j: ready.get(columns[j], 1))
        label = f"{o.out.name}[{start}]" + (f"..[{start + len(weights) - 1}]" if len(weights) > 1 else "")
        t = summed
        for n, j in enumerate(used):
            t = max(t + 1, ready.get(columns[j], 1), picked - HOLD if n + 1 == len(used) else 0)
            while not schedule.free(t, "read"):
                t += 1
            read(t, columns[j], names[j])
            schedule.place(
                t + WEIGHT, f"{label} from {names[j]}", **{f"weight_{m}": int(w) for m, w in enumerate(weights[:, j])}
            )
            if n == 0:
                schedule.place(t + WEIGHT, group=len(groups))
                schedule.place(t + SUM, first=1)
            else:
                schedule.place(t + SUM, next=1)
        summed = t
        schedule.place(t + HOLD, f"hold {label}", hold=1)
        groups.append((label, [int(b) for b in o.bias[start : start + macs]]))
        d = t + PICK
        for m in range(len(weights)):
            while not (schedule.free(d, "pick") and schedule.free(d + FIT, "write")):
                d += 1
            shift = int(o.frac[start + m]) - o.out.fix.frac
            schedule.place(d, pick=m, shift=shift, rounding=ROUNDING[o.rounding])
            fit = {"width": o.out.fix.width, "saturate": int(o.overflow is Overflow.SATURATE)}
            word = address[o.out.name] + start + m
            write(d + FIT, word, DRAIN, f"{o.out.name}[{start + m}]", **fit)
            picked = d
            d += 1

    unit_of: dict[str, int] = {}
    for o in operations:
        if isinstance(o, Affine):
            for start in range(0, o.out.size, macs):
                rows(o, start)
            continue
        key = f"table {shared_tables(program)[o.table].name}" if isinstance(o, Lookup) else o.out.name
        if key not in unit_of:
            unit_of[key] = COPY + 1 + len(units)
            units.append((key, o))
        for k in range(o.out.size):
            arguments = [(address[a] + k, f"{a}[{k}]") for a in o.args]
            through(unit_of[key], arguments, address[o.out.name] + k, f"{o.out.name}[{k}]")
    shown = [(p, k) for p in program.outputs for k in range(p.signal.size)]
    for n, (p, k) in enumerate(shown):
        through(COPY, [(address[p.signal.name] + k, f"{p.signal.name}[{k}]")], words + n, f"output {p.name}[{k}]")
    for source, target in [*shadows, *moves]:
        size = program.signals[source if source in program.signals else target].size
        for k in range(size):
            through(COPY, [(address[source] + k, f"{source}[{k}]")], address[target] + k, f"{target}[{k}]")
    schedule.place(len(schedule.lines), "done", last=1)
    return Folding(schedule, address, words, groups, units)


def ordered(moves: list[tuple[str, str]]) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Moves (source, state) in an order in which none overwrites a state that a later one reads.

    A ring of states is opened by a copy: those come first, and are returned before the moves.
    """
    shadows, done, left = [], [], list(moves)
    while left:
        sources = {source for source, _ in left}
        safe = [m for m in left if m[1] not in sources]
        if safe:
            done += safe
            left = [m for m in left if m not in safe]
        else:
            state = left[0][1]
            shadow = f"{state} before the step"
            shadows.append((state, shadow))
            left = [(shadow if source == state else source, target) for source, target in left]
    return shadows, done


def folded(program: Program, macs: int) -> dict[str, str]:
    """File name -> text of the folded architecture, without the building blocks."""
    names = verilog_names(program)
    folding = fold(program, macs)
    texts = {
        f"{program.name}.v": folded_top(program, macs, folding, names),
        f"{program.name}__schedule.v": schedule_text(program, macs, folding),
        f"{program.name}__biases.v": biases_text(program, macs, folding),
    }
    for table in shared_tables(program).values():
        texts[f"{table_module(program, table)}.v"] = table_text(program, table)
    return texts


def widths(program: Program, macs: int, folding: Folding) -> dict[str, int]:
    """Widths of the datapath and of the fields of a line."""
    affine = [o for o in program.operations if isinstance(o, Affine)]
    beyond = max(sum(p.signal.size for p in program.inputs), sum(p.signal.size for p in program.outputs))
    shifts = [int(s) - o.out.fix.frac for o in affine for s in o.frac] or [0]
    return {
        "code": max(s.fix.width for s in program.signals.values()),
        "weight": max([2, *(signed_width(int(np.abs(o.weights).max(initial=0))) for o in affine)]),
        "acc": max([2, *(program.accumulator_width(o) for o in affine)]),
        "address": bits(folding.words + beyond - 1),
        "group": bits(len(folding.groups) - 1),
        "pick": bits(macs - 1),
        "shift": max(2, *(signed_width(s) for s in map(abs, shifts)), 2),
        "left": max(0, -min(shifts)),
        "width": 6,
        "source": bits(COPY + len(folding.units)),
        "pc": bits(len(folding.schedule.lines) - 1),
    }


def bits(largest: int) -> int:
    return max(1, int(largest).bit_length())


def fields(macs: int, w: dict[str, int]) -> list[tuple[str, int, bool]]:
    """(name, width, signed) of the fields of a line, as they stand from left to right."""
    flags = [(n, 1, False) for n in ("last", "enable")]
    head = [("source", w["source"], False), ("write", w["address"], False)]
    drain = [("saturate", 1, False), ("width", w["width"], False), ("rounding", 2, False), ("shift", w["shift"], True)]
    middle = [("pick", w["pick"], False), *((n, 1, False) for n in ("hold", "next", "first"))]
    tail = [("group", w["group"], False), ("read", w["address"], False)]
    return flags + head + drain + middle + tail + [(f"weight_{m}", w["weight"], True) for m in range(macs)]


def rom_text(comment: list[str], name: str, ports: str, width: int, rows: list[str], index: str, out: str) -> str:
    """A synchronous ROM whose lines can be read."""
    return module_text(
        comment,
        f"module {name} (\n{ports}\n);\n\n"
        f"    reg [{width - 1}:0] rom[0:{len(rows) - 1}];\n"
        f"    reg [{width - 1}:0] line;\n"
        f"    always @(posedge clk) line <= rom[{index}];\n{out}\n"
        "    initial begin\n" + "\n".join(f"        {r}" for r in rows) + "\n    end\n",
    )


def schedule_text(program: Program, macs: int, folding: Folding) -> str:
    w = widths(program, macs, folding)
    layout = fields(macs, w)
    lines = folding.schedule.lines
    rows = []
    for t, line in enumerate(lines):
        values = [number(line.get(n, 0), k) if s else f"{k}'d{line.get(n, 0)}" for n, k, s in layout]
        note = "; ".join(folding.schedule.notes[t]) or "idle"
        rows.append(f"rom[{t}] = {{{', '.join(values)}}};  {remark(note)}")
    ports = [f"    input  wire clk,\n    input  wire [{w['pc'] - 1}:0] pc"]
    ports += [f"    output wire {'signed ' if s else ''}[{k - 1}:0] {n}" for n, k, s in layout]
    comment = [
        f"Schedule of {program.name}: what every clock of a step does. {len(lines)} lines, line 0 is idle.",
        "Fields from left to right as in the assignment to them below.",
    ]
    named = wrapped([n + ("," if n != layout[-1][0] else "") for n, _, _ in layout], "        ")
    assign = f"    assign {{\n{named}\n    }} = line;\n"
    width = sum(k for _, k, _ in layout)
    return rom_text(comment, f"{program.name}__schedule", ",\n".join(ports), width, rows, "pc", assign)


def biases_text(program: Program, macs: int, folding: Folding) -> str:
    w = widths(program, macs, folding)
    groups = folding.groups + [("no rows", [])] * (2 - len(folding.groups))
    rows = []
    for g, (label, biases) in enumerate(groups):
        values = [number(b, w["acc"]) for b in [*biases, *[0] * (macs - len(biases))]]
        rows.append(f"rom[{g}] = {{{', '.join(reversed(values))}}};  {remark(label)}")
    ports = f"    input  wire clk,\n    input  wire [{w['group'] - 1}:0] group,\n"
    ports += f"    output wire [{macs * w['acc'] - 1}:0] bias"
    comment = [f"Biases of {program.name}, a group of {macs} rows a line, the first row on the right."]
    name = f"{program.name}__biases"
    return rom_text(comment, name, ports, macs * w["acc"], rows, "group", "    assign bias = line;\n")


def folded_top(program: Program, macs: int, folding: Folding, names: dict[str, str]) -> str:
    """The datapath."""
    ports, width_in, width_out = top_ports(program)
    w = widths(program, macs, folding)
    code, acc = w["code"], w["acc"]
    layout = fields(macs, w)
    state_words = sum(s.signal.size for s in program.states)
    last_word = max(0, state_words - 1)
    address = w["address"]
    inputs = len(input_slices(program))
    body = f"module {program.name} (\n{ports}\n);\n\n"
    body += f"    wire [{width_in - 1}:0] sample;\n    wire [{width_out - 1}:0] result;\n    wire start;\n"

    body += "\n    // the schedule: one line a clock; line 0 is idle\n"
    for n, k, signed in layout:
        body += f"    wire {'signed ' if signed else ''}[{k - 1}:0] {n};\n"
    body += f"    reg booted;\n    wire done = last && booted;\n    reg [{w['pc'] - 1}:0] pc;\n"
    final = len(folding.schedule.lines) - 1
    body += (
        "    always @(posedge clk)\n"
        f"        if (rst) pc <= {w['pc']}'d0;\n"
        f"        else if (start) pc <= {w['pc']}'d1;\n"
        f"        else if (pc != {w['pc']}'d0) pc <= pc == {w['pc']}'d{final} ? {w['pc']}'d0 : pc + {w['pc']}'d1;\n\n"
    )
    body += instance(
        f"{program.name}__schedule", "schedule", {}, {"clk": "clk", "pc": "pc"} | {n: n for n, _, _ in layout}
    )

    body += "\n    // the memory: states first, then results; after a reset the initial states are written\n"
    for s in [*(s.signal for s in program.states), *(o.out for o in program.operations)]:
        first = folding.address[s.name]
        last = f"..{first + s.size - 1}" if s.size > 1 else ""
        body += f"    {remark(f'{first}{last}: {s.name}, {s.size} x {s.fix}')}\n"
    body += f"    reg signed [{code - 1}:0] memory[0:{(1 << address) - 1}];\n"
    body += f"    reg [{address - 1}:0] boot;\n    reg signed [{code - 1}:0] initial_code;\n"
    body += f"    reg signed [{code - 1}:0] y;\n\n"
    body += (
        "    always @(posedge clk)\n        if (rst) begin\n"
        f"            boot <= {address}'d0;\n            booted <= 1'b0;\n"
        f"        end else if (!booted) begin\n            boot <= boot + {address}'d1;\n"
        f"            booted <= boot == {address}'d{last_word};\n        end\n\n"
    )
    body += "    always @*\n        case (boot)\n"
    n = 0
    for s in program.states:
        for k, v in enumerate(s.initial):
            body += (
                f"            {address}'d{n}: initial_code = {number(v, code)};  {remark(f'{s.signal.name}[{k}]')}\n"
            )
            n += 1
    body += f"            default: initial_code = {code}'sd0;\n        endcase\n\n"
    body += (
        f"    always @(posedge clk)\n        if (!booted) memory[boot] <= initial_code;\n"
        f"        else if (enable && write < {address}'d{folding.words}) memory[write] <= y;\n\n"
    )
    body += f"    reg signed [{code - 1}:0] word;\n    always @(posedge clk) word <= memory[read];\n\n"
    body += f"    reg from_input;\n    reg signed [{code - 1}:0] input_code;\n"
    body += f"    reg signed [{code - 1}:0] x;  // a register of its own: block RAM is slow to answer\n"
    body += "    always @(posedge clk) begin\n"
    body += "        x <= from_input ? input_code : word;\n"
    body += f"        from_input <= read >= {address}'d{folding.words};\n        case (read)\n"
    for n, (s, k, low) in enumerate(input_slices(program)):
        value = sign_extended("sample", low, s.fix.width, code)
        end = f"{address}'d{folding.words + n}" if n + 1 < inputs else "default"
        body += f"            {end}: input_code <= {value};  {remark(f'{s.name}[{k}]')}\n"
    body += "        endcase\n    end\n"
    if unused_bits(program):
        body += "    wire unused = &{\n" + wrapped([f"{u}," for u in unused_bits(program)], "        ")
        body += " 1'b0\n    };  // sign extensions\n"

    body += f"\n    // {macs} multipliers: sums, held while they are drained row by row\n"
    body += f"    wire [{macs * acc - 1}:0] bias;\n    wire [{macs * acc - 1}:0] sums;\n"
    body += f"    reg [{macs * acc - 1}:0] held;\n    reg signed [{acc - 1}:0] row;\n"
    body += f"    wire signed [{code - 1}:0] drained;\n\n"
    body += instance(f"{program.name}__biases", "biases", {}, {"clk": "clk", "group": "group", "bias": "bias"})
    for m in range(macs):
        part = f"[{(m + 1) * acc - 1}:{m * acc}]"
        ends = {"clk": "clk", "x": "x", "weight": f"weight_{m}", "first": "first", "next": "next"}
        ends |= {"bias": f"bias{part}", "acc": f"sums{part}"}
        body += "\n" + instance("greygate_mac", f"mac_{m}", {"X_W": code, "WEIGHT_W": w["weight"], "ACC_W": acc}, ends)
    body += "\n    always @(posedge clk) if (hold) held <= sums;\n\n    always @*\n        case (pick)\n"
    for m in range(1, macs):
        body += f"            {w['pick']}'d{m}: row = held[{(m + 1) * acc - 1}:{m * acc}];\n"
    body += f"            default: row = held[{acc - 1}:0];\n        endcase\n\n"
    body += instance(
        "greygate_drain",
        "drain",
        {"IN_W": acc, "OUT_W": code, "SHIFT_W": w["shift"], "LEFT": w["left"], "WIDTH_W": w["width"]},
        {"clk": "clk", "a": "row"} | {n: n for n in ("shift", "rounding", "width", "saturate")} | {"y": "drained"},
    )

    body += "\n    // what answers an argument in one clock\n"
    body += f"    reg signed [{code - 1}:0] copied;\n    always @(posedge clk) copied <= x;\n"
    before = {"condition": "x_before_last", "above": "x_last", "below": "x", "x": "x"}  # port -> where its code stands
    selects = [o for _, o in folding.units if isinstance(o, Select)]
    if selects:  # no wider than they are read
        condition, above = (max(program.signals[o.args[i]].fix.width for o in selects) for i in (0, 1))
        last = max(condition, above)
        body += (
            "    // a select reads three codes on end\n"
            f"    reg [{last - 1}:0] x_last;\n    reg [{condition - 1}:0] x_before_last;\n"
            f"    always @(posedge clk) begin\n        x_last <= x[{last - 1}:0];\n"
            f"        x_before_last <= x_last[{condition - 1}:0];\n    end\n"
        )
    cases = [f"{w['source']}'d{COPY}: y = copied;"]
    for n, (key, o) in enumerate(folding.units):
        module, parameters = small_operation(program, o, size=1)
        out = o.out.fix.width
        arguments = {
            port: f"{before[port]}[{program.signals[a].fix.width - 1}:0]"
            for port, a in zip(argument_ports(o), o.args, strict=True)
        }
        body += f"\n    wire [{out - 1}:0] unit_{n};  {remark(key)}\n"
        body += instance(
            module,
            f"unit_{n}_{o.op.value}",
            parameters,
            {"clk": "clk", "en": "1'b1"} | arguments | {"y": f"unit_{n}"},
        )
        cases.append(f"{w['source']}'d{COPY + 1 + n}: y = {sign_extended(f'unit_{n}', 0, out, code)};  {remark(key)}")
    body += "\n    always @*\n        case (source)\n" + "".join(f"            {c}\n" for c in cases)
    body += "            default: y = drained;\n        endcase\n"

    body += "\n    // outputs\n"
    shown, n = [], 0
    for p in program.outputs:
        for k in range(p.signal.size):
            width = p.signal.fix.width
            body += f"    reg [{width - 1}:0] output_{n};  {remark(f'{p.name}[{k}]')}\n"
            condition = f"enable && write == {address}'d{folding.words + n}"
            body += f"    always @(posedge clk) if ({condition}) output_{n} <= y[{width - 1}:0];\n"
            shown.append(sign_extended(f"output_{n}", 0, width, lane_width(p.signal)))
            n += 1
    body += "    assign result = {\n" + ",\n".join(f"        {s}" for s in reversed(shown)) + "\n    };\n\n"
    head = header(program, f"folded ({macs} multipliers)")
    return module_text(head, body + stream_instance(width_in, width_out, "booted"))
