"""The schedule of the folded architecture (targets/folded.py): what it reads, sums, drains and writes in each clock.

Rows of a layer are summed in groups of `macs`. A group visits only the columns in which one of its rows has a weight,
and is drained while the next group is being summed.
"""

from dataclasses import dataclass, field

import numpy as np

from greygate.compiler.verilog import ROUNDING, clocks, levels, shared_tables
from greygate.emulator.program import Affine, Elementwise, Lookup, Operation, Overflow, Program

WEIGHT, SUM, HOLD, PICK = 2, 3, 4, 5  # clocks from the read of a column to its weight, sum, hold and pick
FIT = 1  # clocks from pick to write
UNIT = 2  # clocks from the read of an argument to the unit that answers it
DRAIN, COPY = 0, 1  # numbers of the sources of a write; units follow


@dataclass
class Schedule:
    """Lines of fields, placed so that no field has two values in one line. Line 0 is idle."""

    lines: list[dict[str, int]] = field(default_factory=lambda: [{}])
    notes: list[list[str]] = field(default_factory=lambda: [[]])

    def free(self, t: int, *names: str) -> bool:
        return t >= len(self.lines) or not any(n in self.lines[t] for n in names)

    def place(self, t: int, note: str = "", /, **values: int) -> None:
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

    address: word of element 0 of each signal. words: size of the memory; at addresses beyond it, inputs are read and
    outputs written. groups: the biases of each group of rows. units: the units that answer an argument, by
    source number.
    """

    schedule: Schedule
    address: dict[str, int]
    words: int
    groups: list[tuple[str, list[int]]]
    units: dict[str, Elementwise]


def fold(program: Program, macs: int) -> Folding:
    """Place every read, sum, drain and write of one step."""
    level = levels(program)
    operations = sorted(program.operations, key=lambda o: level[o.out.name])  # independent ones side by side
    shadows, moves = ordered([(s.source, s.signal.name) for s in program.states if s.source != s.signal.name])
    folder = _Folder(program, macs, operations, shadows)
    for o in operations:
        if isinstance(o, Affine):
            folder.layer(o)
        else:
            folder.elements(o)
    shown = [(f"{p.signal.name}[{k}]", f"{p.name}[{k}]") for p in program.outputs for k in range(p.signal.size)]
    for n, (element, name) in enumerate(shown):
        folder.copy(element, folder.words + n, f"output {name}")
    for source, target in [*shadows, *moves]:
        size = program.signals[source if source in program.signals else target].size
        for k in range(size):
            folder.copy(f"{source}[{k}]", folder.address[target] + k, f"{target}[{k}]")
    folder.schedule.place(len(folder.schedule.lines), "done", last=1)
    return Folding(folder.schedule, folder.address, folder.words, folder.groups, folder.units)


class _Folder:
    """Assigns words to every signal, and places each operation as early as its arguments and the datapath allow."""

    def __init__(self, program: Program, macs: int, operations: list[Operation], shadows: list[tuple[str, str]]):
        self.program, self.macs = program, macs
        self.schedule = Schedule()
        self.groups: list[tuple[str, list[int]]] = []
        self.units: dict[str, Elementwise] = {}
        self.address: dict[str, int] = {}
        self.word: dict[str, int] = {}  # by element
        for s in [*(s.signal for s in program.states), *(o.out for o in operations)]:
            self._give(s.name, s.size)
        for original, shadow in shadows:
            self._give(shadow, program.signals[original].size)
        self.words = len(self.word)
        for p in program.inputs:
            self._give(p.signal.name, p.signal.size)
        self.ready: dict[int, int] = {}  # word -> the first line that can read its new value
        self.last_read: dict[int, int] = {}
        self.summed, self.picked = 0, 0  # the last line that read a column, or picked a row

    def layer(self, o: Affine) -> None:
        """Place the rows of an affine operation, group by group."""
        columns = [f"{a}[{k}]" for a in o.args for k in range(self.program.signals[a].size)]
        for start in range(0, o.out.size, self.macs):
            self._sum(o, start, columns)
            self._drain(o, start)

    def elements(self, o: Elementwise) -> None:
        """Place every element of any other operation on one unit; lookups in equal tables share a unit."""
        key = o.out.name
        if isinstance(o, Lookup):
            key = f"table {shared_tables(self.program)[o.table].name}"
        self.units.setdefault(key, o)
        source = COPY + 1 + list(self.units).index(key)
        for k in range(o.out.size):
            arguments, to = [f"{a}[{k}]" for a in o.args], self.address[o.out.name] + k
            self._through(source, arguments, to, f"{o.out.name}[{k}]", UNIT + clocks(o))

    def copy(self, element: str, to: int, note: str) -> None:
        self._through(COPY, [element], to, note, UNIT + 1)

    def _give(self, name: str, size: int) -> None:
        self.address[name] = len(self.word)
        self.word |= {f"{name}[{k}]": len(self.word) + k for k in range(size)}

    def _read(self, t: int, element: str) -> None:
        word = self.word[element]
        self.schedule.place(t, f"read {element}", read=word)
        self.last_read[word] = max(self.last_read.get(word, 0), t)

    def _write(self, t: int, word: int, source: int, note: str, **values: int) -> None:
        self.schedule.place(t, f"write {note}", write=word, enable=1, source=source, **values)
        self.ready[word] = t + 1

    def _when(self, element: str) -> int:
        """The first line that can read an element."""
        return self.ready.get(self.word[element], 1)

    def _through(self, source: int, arguments: list[str], to: int, note: str, unit: int) -> None:
        """Read the arguments in consecutive clocks, and write the result `unit` clocks after the last."""
        free, last = self.schedule.free, len(arguments) - 1
        t = max([self.last_read.get(to, 0) - unit, *(self._when(a) - i for i, a in enumerate(arguments))])
        while not (all(free(t + i, "read") for i in range(len(arguments))) and free(t + last + unit, "write")):
            t += 1
        for i, argument in enumerate(arguments):
            self._read(t + i, argument)
        self._write(t + last + unit, to, source, note)

    def _sum(self, o: Affine, start: int, columns: list[str]) -> None:
        """Sum a group of rows over their columns, in the order in which the columns become ready, and hold the sums."""
        weights = o.weights[start : start + self.macs]
        used = np.flatnonzero(np.any(weights != 0, axis=0)).tolist() or [0]
        used.sort(key=lambda j: self._when(columns[j]))
        label = f"{o.out.name}[{start}]" + (f"..[{start + len(weights) - 1}]" if len(weights) > 1 else "")
        place, t = self.schedule.place, self.summed
        for n, j in enumerate(used):
            t = max(t + 1, self._when(columns[j]), self.picked - HOLD if n + 1 == len(used) else 0)
            while not self.schedule.free(t, "read"):
                t += 1
            self._read(t, columns[j])
            given = {f"weight_{m}": int(w) for m, w in enumerate(weights[:, j])}
            place(t + WEIGHT, f"{label} from {columns[j]}", **given)
            if n == 0:
                place(t + WEIGHT, group=len(self.groups))
            place(t + SUM, **({"first": 1} if n == 0 else {"next": 1}))
        place(t + HOLD, f"hold {label}", hold=1)
        self.summed = t
        self.groups.append((label, [int(b) for b in o.bias[start : start + self.macs]]))

    def _drain(self, o: Affine, start: int) -> None:
        """Round, fit and write the rows of the group that was summed last, one row a clock."""
        fix, d = o.out.fix, self.summed + PICK
        fit = {"width": fix.width, "saturate": int(o.overflow is Overflow.SATURATE)}
        for r in range(start, min(start + self.macs, o.out.size)):
            while not (self.schedule.free(d, "pick") and self.schedule.free(d + FIT, "write")):
                d += 1
            self.schedule.place(d, pick=r - start, shift=int(o.frac[r]) - fix.frac, rounding=ROUNDING[o.rounding])
            self._write(d + FIT, self.address[o.out.name] + r, DRAIN, f"{o.out.name}[{r}]", **fit)
            self.picked = d
            d += 1


def ordered(moves: list[tuple[str, str]]) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Order the moves (source, state) so that none overwrites a state that a later one reads.

    A copy opens a ring of states. Copies are made first, and are returned before the moves.
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
