"""The schedule of the folded architecture (targets/folded.py): what every clock of a step reads, multiplies and writes.

Rows of a layer are summed in groups of as many as there are multipliers. A group reads its columns in consecutive
clocks, those in which one of its rows has a weight; while it is drained, the next one is summed. Of the jobs that can
go on first, that on the longest path comes first, and copies fill gaps. What is written takes the words of the memory
in the order of the writes, so that no line names the word that it writes.
"""

from collections import defaultdict
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from greygate.compiler.folding.jobs import Job, live_operations, measure, planned
from greygate.compiler.folding.products import Mode, Products, laid_out
from greygate.compiler.verilog import LATE_CLOCKS, shared_tables
from greygate.compiler.verilog import clocks as clocks_of
from greygate.emulator.numbers import signed_width
from greygate.emulator.program import Affine, Elementwise, Lookup, Product, Program

CLOSING = 2  # lines that are read while `done` returns the counter
REMARKED = 4096  # lines of a ROM up to which each says what it does
# Clocks from the read of a code to ...
WORD = 1  # ... the code at the output of the memory, and its weight beside it
SELECT = 2  # ... the stages of its product, in the line
SUM = 4  # ... the sum that takes its product
CODE = 6  # ... the code of a row that ends with it, and `levels` more where several multipliers take turns
ARGUMENT = 2  # ... the argument of a unit that reads the memory
CONTROL = 1  # a field of the control acts so many clocks after its line
NEAR = 4  # sums among which one clock can pick
DRAINED, COPIED, SAMPLED, UNITS = range(4)  # numbers of the sources of a write; each unit has one from UNITS up
FIELDS = ("first", "row", "last", "mode", "part", "source", "write", "show", "stored", "done")


def levels_of(multipliers: int) -> int:
    """Clocks in which one of so many sums is picked."""
    levels = 0
    while multipliers > 1:
        multipliers, levels = -(-multipliers // NEAR), levels + 1
    return levels


@dataclass
class Lines:
    """Lines of the ROM while they are laid out.

    controls: field -> {line: value}. others: what a line reads beside, for a product. bursts: (line, elements read,
    words and selects of each multiplier).
    """

    controls: dict[str, dict[int, int]] = field(default_factory=lambda: {n: {} for n in FIELDS})
    reads: dict[int, int] = field(default_factory=dict)
    others: dict[int, int] = field(default_factory=dict)
    bursts: list[tuple[int, np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=list)
    notes: dict[int, list[str]] = field(default_factory=lambda: defaultdict(list))

    def control(self, clock: int, **values: int) -> None:
        """Let fields act in a clock. Every field has one value in a line."""
        for name, value in values.items():
            if value:
                assert clock - CONTROL not in self.controls[name], f"two values of {name} in one clock"
                self.controls[name][clock - CONTROL] = value

    @cached_property
    def length(self) -> int:
        """Lines up to the last that does anything."""
        ends = [max(found) for found in (*self.controls.values(), self.reads) if found]
        return 1 + max(ends, default=0)

    def arrays(self, multipliers: int) -> tuple[np.ndarray, ...]:
        """reads, others (lines,), words, selects (lines, multipliers), controls (lines, fields); CLOSING lines idle."""
        count = self.length + CLOSING
        (reads, others), controls = np.zeros((2, count), np.int64), np.zeros((count, len(FIELDS)), np.int64)
        words, selects = np.zeros((2, count, multipliers), np.int64)
        reads[list(self.reads)] = list(self.reads.values())
        others[list(self.others)] = list(self.others.values())
        for i, name in enumerate(FIELDS):
            controls[list(self.controls[name]), i] = list(self.controls[name].values())
        for start, elements, w, s in self.bursts:
            n = len(elements)
            reads[start : start + n] = elements
            for m in range(len(w)):
                words[start + WORD + m : start + WORD + m + n, m] = w[m]
                selects[start + SELECT + m : start + SELECT + m + n, m] = s[m]
        return reads, others, words, selects, controls


@dataclass(frozen=True)
class Folding:
    """A program laid out for the folded datapath.

    reads: (lines,) words of the memory, or where an initial state is written. others: what a product reads beside.
    words, selects: (lines, multipliers).
    controls: (lines, fields), as in FIELDS. idle: the line at which the core waits for a sample; those before it write
    the initial states. biases: in the order in which rows begin; `boots` of them are initial states. address: signal ->
    words of its elements. size: words of the memory. kept: the signals
    that have words. shown: signal -> places of its elements among the results. units:
    what answers arguments, by source number less UNITS. fused: units that answer drained rows; stored: those that
    answer codes of the memory. notes: line -> what it does.
    """

    products: Products
    multipliers: int
    modes: tuple[Mode, ...]
    acc_width: int
    reads: np.ndarray
    others: np.ndarray
    words: np.ndarray
    selects: np.ndarray
    controls: np.ndarray
    idle: int
    biases: list[int]
    boots: int
    address: dict[str, np.ndarray]
    size: int
    kept: set[str]
    shown: dict[str, list[int]]
    units: dict[str, Elementwise]
    fused: set[str]
    stored: set[str]
    notes: dict[int, list[str]]

    @property
    def clocks(self) -> int:
        """Clocks of a step, from the sample to the result."""
        return len(self.reads) - CLOSING - self.idle + 2

    @property
    def utilisation(self) -> float:
        """Share of the multipliers' clocks in a step that make a product."""
        return self.products.count / (self.clocks * self.multipliers)


@lru_cache(maxsize=1)
def fold(program: Program, multipliers: int, factor: int) -> Folding:
    """Place every read, product, sum, drain and write of one step. factor: as in `Design`."""
    return _Folder(program, multipliers, factor).folding()


def _lines(job: Job) -> int:
    """Lines that read the arguments of an element: a product reads both at once."""
    return 1 if isinstance(job.operation, Product) else len(job.reads)


class _Folder:
    """Places the jobs of a step, one after the other, each from the first line at which it needs no pause.

    first: signal -> number of its element 0. ready: element -> the first line that can read it. taken: clocks of
    writes. order: elements in the order in which they take words.
    """

    def __init__(self, program: Program, multipliers: int, factor: int):
        self.program, self.multipliers = program, multipliers
        self.levels = levels_of(multipliers)
        self.operations = live_operations(program)
        self.products = laid_out(program, self.operations, multipliers, factor)
        self.plan = planned(program, multipliers)
        self.inside = {o.out.name for o in self.plan.answers.values()}
        self.outputs = {p.signal.name for p in program.outputs}
        sizes = {s.name: s.size for s in program.signals.values()}
        sizes |= {shadow: sizes[state] for shadow, state in self.plan.shadows.items()}
        ends = np.cumsum([0, *sizes.values()]).tolist()
        self.first = dict(zip(sizes, ends, strict=False))
        self.sizes = sizes
        self.ready = np.zeros(ends[-1], np.int64)
        self.lines = Lines()
        self.taken: set[int] = set()
        self.written: dict[int, int] = {}  # clock -> element
        self.shows: dict[int, int] = {}
        self.biases: list[int] = []
        self.modes = list(self.products.modes)
        self.acc_width = self.products.acc_width
        self.now = 1  # the first line without a read
        self.begins = self.ends = 0  # the first line at which the next group may begin, and end
        self.group_reads: dict[str, tuple[int, np.ndarray, np.ndarray]] = {}
        self.units: dict[str, Elementwise] = {}
        self.fused: set[str] = set()
        self.stored: set[str] = set()
        self._name_units()

    def _name_units(self) -> None:
        """A unit for each operation that is not affine; lookups in equal tables share one, and products alike."""
        shared = shared_tables(self.program)
        self.unit: dict[str, str] = {}
        for o in self.operations:
            if isinstance(o, Affine):
                continue
            key = f"table {shared[o.table].name}" if isinstance(o, Lookup) else o.out.name
            if isinstance(o, Product):
                one, other = (self.program.signals[a].fix for a in o.args)
                key = f"product of {one} and {other} to {o.out.fix}, {o.rounding}"
            self.units.setdefault(key, o)
            self.unit[o.out.name] = key
            (self.fused if o.out.name in self.inside else self.stored).add(key)

    def _source(self, name: str) -> int:
        """The source number of the unit that makes that signal."""
        return UNITS + list(self.units).index(self.unit[name])

    def folding(self) -> Folding:
        boot = self._boot()
        self._samples()
        reads = {key: self._cost(job) for key, job in self.plan.jobs.items()}
        measure(self.plan.jobs, reads, CODE + self.levels + LATE_CLOCKS)
        left = dict(self.plan.jobs)
        while left:
            job, start = self._chosen(left)
            if job.operation is None:
                self._copy(job, start)
            elif isinstance(job.operation, Affine):
                self._group(job, job.operation, start)
            else:
                self._element(job, job.operation, start)
            if job.next >= job.size:
                del left[job.key]
                for other in left.values():
                    other.after.discard(job.key)
        self.lines.control(max(self.taken), done=1)
        return self._finished(boot)

    def _cost(self, job: Job) -> int:
        if isinstance(job.operation, Affine):
            layer = self.products.layers[job.operation.out.name]
            return -(-int(np.count_nonzero(layer.words)) // self.multipliers)
        return job.size * _lines(job)

    def _chosen(self, left: dict[str, Job]) -> tuple[Job, int]:
        """The job that goes on, and from which line."""
        free = [job for job in left.values() if not job.after]
        best: tuple[int, int, Job] | None = None
        for job in free:
            if job.operation is not None:
                start = self._start(job)
                if best is None or (start, -job.length) < best[:2]:
                    best = start, -job.length, job
        if best is None or best[0] > self.now:
            for job in free:
                if job.operation is None:
                    start = self._start(job)
                    if best is None or start < best[0]:
                        best = start, 0, job
                    if start == self.now:
                        break
        assert best is not None, "the jobs of a step wait for each other"
        return best[2], best[0]

    def _start(self, job: Job) -> int:
        """The first line from which the next piece of a job can be placed without a pause."""
        if isinstance(job.operation, Affine):
            elements = self._group_reads(job, job.operation)[0]
            rows = min(self.multipliers, job.size - job.next)
            writes = self._row_writes(job.operation.out.name)
            offset = len(elements) - 1 + CODE + self.levels
            clocks = [offset + m + later for m in range(rows) for later in writes]
            start = max(self.now, self.begins, self.ends - len(elements) + 1)
        else:
            elements = np.array([self.first[a] + job.next for a in job.reads])
            clocks = [self._latency(job)]
            start = self.now
        ready = self.ready[elements]  # of a group in rising order
        if ready.max() > start:
            together = isinstance(job.operation, Product)
            start = max(start, int((ready - (0 if together else np.arange(len(ready)))).max()))
        while any(start + clock in self.taken for clock in clocks):
            start += 1
        return start

    def _row_writes(self, name: str) -> list[int]:
        """Clocks from the code of a row to what it causes: its own write, and that of the lookup which it asks."""
        own = [0] if name in self.plan.kept or name in self.outputs else []
        return own + ([LATE_CLOCKS] if name in self.plan.answers else [])

    def _latency(self, job: Job) -> int:
        """Clocks from the first read of an element to the write of its result."""
        o = job.operation
        if o is None:
            return WORD
        return _lines(job) - 1 + ARGUMENT + (LATE_CLOCKS if isinstance(o, Lookup) else clocks_of(o))

    def _write(self, clock: int, name: str, k: int, source: int, shows: bool = True) -> None:
        """Write element k of a signal where it is kept, and show it where it is an output."""
        assert clock not in self.taken, "two results in one clock"
        self.taken.add(clock)
        element, kept, shown = self.first[name] + k, name in self.plan.kept, shows and name in self.outputs
        if kept:
            self.written[clock] = element
            self.ready[element] = clock + 1
        if shown:
            self.shows[clock] = element
        self.lines.control(clock, source=source, write=int(kept), show=int(shown))
        self.lines.notes[clock - CONTROL].append(f"{'write' if kept else 'show'} {name}[{k}]")

    def _read(self, line: int, name: str, k: int) -> None:
        self.lines.reads[line] = self.first[name] + k
        self.lines.notes[line].append(f"read {name}[{k}]")
        self.now = line + 1

    def _samples(self) -> None:
        """Write the inputs, in their order, as soon as a step begins."""
        clock = 1 + CONTROL
        for p in self.program.inputs:
            for k in range(p.signal.size):
                self.taken.add(clock)
                element, shown = self.first[p.signal.name] + k, p.signal.name in self.outputs
                self.written[clock] = element
                self.ready[element] = clock + 1
                if shown:
                    self.shows[clock] = element
                self.lines.control(clock, source=SAMPLED, write=1, show=int(shown))
                self.lines.notes[clock - CONTROL].append(f"write {p.signal.name}[{k}]")
                clock += 1

    def _copy(self, job: Job, start: int) -> None:
        """Copy one element to a state, or show it."""
        k = job.next
        self._read(start, job.source, k)
        if job.target:
            self._write(start + WORD, job.target, k, COPIED, shows=False)
        else:
            self.taken.add(start + WORD)
            self.shows[start + WORD] = self.first[job.source] + k
            self.lines.control(start + WORD, source=COPIED, show=1)
        job.next += 1

    def _element(self, job: Job, o: Elementwise, start: int) -> None:
        """Read the arguments of one element in consecutive clocks, and write what the unit answers."""
        for i, a in enumerate(o.args[: _lines(job)]):
            self._read(start + i, a, job.next)
        if isinstance(o, Product):
            self.lines.others[start] = self.first[o.other] + job.next
            self.lines.notes[start].append(f"and {o.other}[{job.next}]")
        if isinstance(o, Lookup) and self.unit[o.out.name] in self.fused:
            self.lines.control(start + ARGUMENT, stored=1)
        self._write(start + self._latency(job), o.out.name, job.next, self._source(o.out.name))
        job.next += 1

    def _group_reads(self, job: Job, o: Affine) -> tuple[np.ndarray, np.ndarray]:
        """The elements that the next group reads, in the order in which they are ready, and their columns."""
        cached = self.group_reads.get(job.key)
        if cached is None or cached[0] != job.next:
            layer = self.products.layers[o.out.name]
            words = layer.words[job.next : job.next + self.multipliers]
            columns = np.flatnonzero(np.any(words != 0, axis=0))
            columns = columns if columns.size else np.zeros(1, np.int64)
            arguments = np.concatenate([self.first[a] + np.arange(self.sizes[a]) for a in o.args])
            elements = arguments[layer.columns[columns]]
            order = np.argsort(self.ready[elements], kind="stable")
            cached = job.next, elements[order], columns[order]
            self.group_reads[job.key] = cached
        return cached[1:]

    def _group(self, job: Job, o: Affine, start: int) -> None:
        """Sum a group of rows from a line on, and drain it."""
        name, layer, row = o.out.name, self.products.layers[o.out.name], job.next
        elements, columns = self._group_reads(job, o)
        rows = min(self.multipliers, job.size - row)
        span = slice(row, row + rows)
        self.lines.bursts.append((start, elements, layer.words[span, columns], layer.selects[span, columns]))
        for i in np.flatnonzero(layer.parts[columns]).tolist():
            self.lines.control(start + i + WORD, part=int(layer.parts[columns[i]]))
        last = start + len(elements) - 1
        self.lines.notes[start].append(f"sum {name}[{row}]" + (f"..[{row + rows - 1}]" if rows > 1 else ""))
        if self.products.count <= REMARKED:
            read = [f"{a}[{k}]" for a in o.args for k in range(self.sizes[a])]
            for i, column in enumerate(layer.columns[columns].tolist()):
                self.lines.notes[start + i].append(f"times {read[column]}")
        self._sum(start, last, layer.biases[span])
        for m in range(rows):
            clock = last + CODE + self.levels + m
            self.lines.control(clock - 1, mode=layer.modes[row + m])
            if name in self.plan.kept or name in self.outputs:
                self._write(clock, name, row + m, DRAINED)
            if name in self.plan.answers:
                answer = self.plan.answers[name].out.name
                self._write(clock + LATE_CLOCKS, answer, row + m, self._source(answer))
        self.now, self.begins, self.ends = last + 1, start + rows, last + rows
        job.next += rows

    def _sum(self, start: int, last: int, biases: list[int], lines: Lines | None = None) -> None:
        """Open the sums of a group that reads from line `start` to line `last`."""
        lines = lines or self.lines
        for m in range(len(biases)):
            lines.control(start + SUM - 1 + m, row=1)
        if self.multipliers > 1:
            lines.control(start + SUM, first=1)
            lines.control(last + SUM, last=1)
        self.biases += biases

    def _boot(self) -> Lines:
        """The lines that write the initial states after a reset: rows without a weight."""
        lines = Lines()
        self.boots: list[tuple[int, int]] = []  # line, element
        line = 0
        for s in self.program.states:
            for k, code in enumerate(s.initial):
                line += 1
                mode = self._exact(s.signal.fix.width, int(code))
                bias = (int(code) << self.modes[mode].shift) + int(self.modes[mode].even)
                self._sum(line, line, [bias], lines)
                clock = line + CODE + self.levels
                lines.control(clock - 1, mode=mode)
                lines.control(clock, source=DRAINED, write=1)
                lines.notes[clock].append(f"write {s.signal.name}[{k}] = {code}")
                self.boots.append((clock, self.first[s.signal.name] + k))
        lines.control(line + CODE + self.levels, done=1)
        return lines

    def _exact(self, width: int, code: int) -> int:
        """A mode that gives a code of that width as it is, of those there are the one with the narrowest sum."""
        fitting = [i for i, m in enumerate(self.modes) if m.width >= width and (m.shift or not m.even)]
        if not fitting:
            self.modes.append(Mode(min((m.shift for m in self.modes), default=0), False, width, False))
            fitting = [len(self.modes) - 1]
        best = min(fitting, key=lambda i: self.modes[i].shift)
        self.acc_width = max(self.acc_width, signed_width((abs(code) << self.modes[best].shift) + 1))
        return best

    def _finished(self, boot: Lines) -> Folding:
        """The lines of the reset and of the step, with words for elements."""
        words = np.full(len(self.ready), -1, np.int64)
        words[[self.written[clock] for clock in sorted(self.written)]] = np.arange(len(self.written))
        for result, state in self.plan.home.items():
            own, taken = self._span(state), self._span(result)
            words[own] = words[taken]
        size = len(self.written)
        for s in self.program.states:
            for element in range(*self._span(s.signal.name).indices(len(words))):
                if words[element] < 0:
                    words[element] = size
                    size += 1
        for line, element in self.boots:
            boot.reads[line] = element
        parts = [lines.arrays(self.multipliers) for lines in (boot, self.lines)]
        reads, others, weights, selects, controls = (np.concatenate(pair) for pair in zip(*parts, strict=True))
        idle = boot.length + CLOSING
        read = np.zeros(len(reads), bool)
        for at, lines in ((0, boot), (idle, self.lines)):
            read[[at + line for line in lines.reads]] = True
            for start, elements, *_ in lines.bursts:
                read[at + start : at + start + len(elements)] = True
        reads = np.where(read, words[reads], 0)
        second = [idle + line for line in self.lines.others]
        others[second] = words[others[second]]
        notes = dict(boot.notes) | {idle + line: found for line, found in self.lines.notes.items()}
        order = {element: n for n, element in enumerate(self.shows[clock] for clock in sorted(self.shows))}
        shown = {name: [order[self.first[name] + k] for k in range(self.sizes[name])] for name in self.outputs}
        return Folding(
            products=self.products,
            multipliers=self.multipliers,
            modes=tuple(self.modes),
            acc_width=self.acc_width,
            reads=reads,
            others=others,
            words=weights,
            selects=selects,
            controls=controls,
            idle=idle,
            biases=self.biases,
            boots=len(self.boots),
            address={name: words[self._span(name)] for name in self.sizes},
            size=size,
            kept=self.plan.kept,
            shown=shown,
            units=self.units,
            fused=self.fused,
            stored=self.stored,
            notes=notes,
        )

    def _span(self, name: str) -> slice:
        return slice(self.first[name], self.first[name] + self.sizes[name])
