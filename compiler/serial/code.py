"""A program as code of the serial architecture: the words of a step, its routines, and what the memory holds.

The code begins with the routines, each in a block of its own. After a reset the main code writes the initial states;
a step begins at an address behind that. compiler/serial/writer.py makes the words.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

from greygate.compiler.adders import signed_digits
from greygate.compiler.folding.jobs import ordered
from greygate.compiler.serial.products import Multiplied
from greygate.compiler.serial.tables import FACTOR, Answer, Kept, kept_tables
from greygate.compiler.serial.writer import (
    ACCEPT,
    NOTHING,
    PLAIN,
    PUSH,
    SAMPLE,
    TAKE,
    ZERO,
    Add,
    Constant,
    Key,
    Line,
    Range,
    Word,
    Writer,
    name_of,
    width_of,
)
from greygate.compiler.verilog import input_slices, shared_tables
from greygate.emulator.numbers import Fix, Overflow
from greygate.emulator.program import Affine, Clamp, Lookup, Op, Product, Program, Select, Signal, Threshold

PAIRS = (("zero", FACTOR), ("above", "below"))  # words beside each other, of which one is chosen


@dataclass
class Routine:
    """Words that several places of the main code use. given: the range of the accumulator at their begin.

    does: looks up, multiplies; None chooses between the words `above` and `below` by the accumulator's sign.
    """

    does: Kept | Multiplied | None
    given: Range = ZERO
    lines: list[Line] = field(default_factory=list)


class Compiler:
    """Writes the words of a program. width: of the accumulator, 2 while it is not known."""

    def __init__(self, program: Program, width: int):
        self.program = program
        self.writer = Writer(width)
        self.main = self.writer.lines
        self.tables = shared_tables(program)
        self.routines: dict[str, Routine] = {}
        self.bits: dict[int, int] = {}  # place in the main code -> bit of the sample that its choice takes
        self.boot: list[Line] = []
        self.fused: set[str] = set()

    def compile(self, origin: int) -> None:
        """Write everything. origin: address of the tables in memory."""
        self.kept = kept_tables(list({t.name: t for t in self.tables.values()}.values()), origin)
        self.states()
        self.boot = self.writer.lines
        self.writer.lines = self.main = []
        self.inputs()
        readers = self.readers()
        for o in self.program.operations:
            if isinstance(o, Affine):
                lookup = self.fusable(o, readers)
                self.affine(o, lookup)
                if lookup:
                    self.fused.add(lookup.out.name)
            elif o.out.name not in self.fused:
                WRITTEN[o.op](self, o)
        self.end()
        for routine in self.routines.values():
            self.writer.lines = routine.lines
            self.writer.set(routine.given)
            if routine.does is None:
                self.choose()
            elif isinstance(routine.does, Multiplied):
                routine.does.write(self.writer, self.rest)
            else:
                Answer(self.writer, routine.does, self.rest).write()
            self.leave()
        self.writer.lines = self.main

    def states(self) -> None:
        """Write the initial states, and the zero beside `slope`."""
        w = self.writer
        w.clear()
        w.write("zero")
        for s in self.program.states:
            for k, v in enumerate(s.initial):
                w.load(Constant(v), f"initial {s.signal.name}[{k}]")
                w.write(element(s.signal, k))
                w.memory[element(s.signal, k)] = range_of(s.signal.fix)

    def inputs(self) -> None:
        """Take the sample bit by bit, each code from its lowest bit up."""
        w = self.writer
        w.word(Word.WAIT, SAMPLE, "wait for a sample")
        for s, k, low in input_slices(self.program):
            width = s.fix.width
            place, sign = Constant(0, 1 << (width - 1)), Constant(0, -1 << (width - 1))
            w.clear(element(s, k))
            for bit in range(width):
                self.bits[len(w.lines)] = low + bit
                w.add(place if bit else NOTHING, Add.SHIFT, f"bit {bit}", choose=True)
            w.add(sign, Add.SHIFT)
            w.set(range_of(s.fix))
            w.write(element(s, k))
        w.word(Word.WAIT, ACCEPT, "accept the sample")

    def affine(self, o: Affine, lookup: Lookup | None) -> None:
        columns = [element(self.program.signals[a], k) for a in o.args for k in range(self.program.signals[a].size)]
        self.scale(o, columns)
        for r in range(o.out.size):
            shift = int(o.frac[r]) - o.out.fix.frac
            self.writer.rounded(columns, o.weights[r].tolist(), int(o.bias[r]), shift, o.rounding, f"{o.out.name}[{r}]")
            flat = self.kept[self.tables[lookup.table].name].flat if lookup else None
            if (
                flat is None or flat > o.out.fix.hi or o.overflow is not Overflow.SATURATE
            ):  # else the answer is the same
                self.writer.fit(o.out.fix, o.overflow)
            if lookup:
                self.call(lookup, r)
            else:
                self.writer.write(element(o.out, r))

    def scale(self, o: Affine, columns: list[str]) -> None:
        """Keep codes scaled whose weights reach beyond the shift in more rows than one, as far as words are wide."""
        widest = max(s.fix.width for s in self.program.signals.values())
        shifts = (o.frac - o.out.fix.frac).tolist()
        for key, weights in zip(columns, o.weights.T.tolist(), strict=True):
            beyond = [signed_digits(w)[-1][0] - s for w, s in zip(weights, shifts, strict=True) if w]
            beyond = [b for b in beyond if b > 0]
            room = widest - width_of(self.writer.memory[key])
            if len(beyond) > 1 and room > 0:
                self.writer.scale(key, min(room, max(beyond)))

    def lookup(self, o: Lookup) -> None:
        for k in range(o.out.size):
            self.writer.load(element(self.program.signals[o.arg], k), f"{o.out.name}[{k}]")
            self.call(o, k)

    def clamp(self, o: Clamp) -> None:
        arg = self.program.signals[o.arg]
        for k in range(o.out.size):
            self.writer.load(element(arg, k), f"{o.out.name}[{k}]")
            self.writer.limit(o.lo, o.hi)
            self.writer.write("value")
            self.writer.requantized("value", arg.fix.frac - o.out.fix.frac, o.out.fix, o.rounding)
            self.writer.write(element(o.out, k))

    def threshold(self, o: Threshold) -> None:
        w, arg = self.writer, self.program.signals[o.arg]
        for k in range(o.out.size):
            for key, answer in (("above", o.above), ("below", o.below)):
                w.load(Constant(answer), f"{o.out.name}[{k}]")
                w.write(key)
            w.load(Constant(o.at))
            w.add(element(arg, k), TAKE)
            self.chosen(element(o.out, k), range_of(o.out.fix))

    def select(self, o: Select) -> None:
        w = self.writer
        condition, above, below = (self.program.signals[a] for a in o.args)
        for k in range(o.out.size):
            for key, s in (("above", above), ("below", below)):
                shift = s.fix.frac - o.out.fix.frac
                w.requantized(element(s, k), shift, o.out.fix, o.rounding, f"{o.out.name}[{k}] {key}")
                w.write(key)
            w.load(element(condition, k))
            self.chosen(element(o.out, k), range_of(o.out.fix))

    def end(self) -> None:
        """Move the states on, and show the outputs."""
        w, program = self.writer, self.program
        shown = [element(p.signal, k) for p in program.outputs for k in range(p.signal.size)]
        states = {element(s.signal, k) for s in program.states for k in range(s.signal.size)}
        for n, key in enumerate(shown[:-2]):
            w.load(key, f"output {n}")
            w.word(Word.WAIT, PUSH)
        kept = []
        for n, key in enumerate(shown[-2:]):  # the last in the accumulator, the one before in what memory has read
            if key in states:
                w.load(key, f"output {key}")
                w.write(f"shown {n}")
                key = f"shown {n}"
            kept.append(key)
        shadows, moves = ordered([(s.source, s.signal.name) for s in program.states if s.source != s.signal.name])
        for source, target in [*shadows, *moves]:
            signal = program.signals[source if source in program.signals else target]
            for k in range(signal.size):
                w.load(f"{source}[{k}]", f"state {target}[{k}]")
                w.write(f"{target}[{k}]")
                w.memory[f"{target}[{k}]"] = range_of(signal.fix)
        w.load(kept[-1], "the result")
        w.read(kept[0])
        w.word(Word.SHOW, kept[0], "show the result")
        w.word(PLAIN, NOTHING)

    def readers(self) -> dict[str, list[str]]:
        """Signal -> what reads it: results of operations, states and outputs."""
        found: dict[str, list[str]] = {}
        for o in self.program.operations:
            for a in o.args:
                found.setdefault(a, []).append(o.out.name)
        for s in self.program.states:
            found.setdefault(s.source, []).append(f"state {s.signal.name}")
        for p in self.program.outputs:
            found.setdefault(p.signal.name, []).append(f"output {p.name}")
        return found

    def fusable(self, o: Affine, readers: dict[str, list[str]]) -> Lookup | None:
        """The lookup that is the only reader of a sum."""
        lookups = {p.out.name: p for p in self.program.operations if isinstance(p, Lookup)}
        found = readers.get(o.out.name, [])
        return lookups.get(found[0]) if len(found) == 1 else None

    def product(self, o: Product) -> None:
        """The narrower code is multiplied bit by bit; a routine serves all products of its width and formats."""
        w = self.writer
        one, other = sorted((self.program.signals[a] for a in o.args), key=lambda s: -s.fix.width)
        does = Multiplied.of(o, one.fix, other.fix)
        for k in range(o.out.size):
            w.load(element(one, k), f"{o.out.name}[{k}]")
            for _ in range(does.doubled):
                w.double(carry=False)
            w.write(FACTOR)
            w.load(element(other, k))
            self.called(does.name, does, f"times {other.name}[{k}]")
            routine = self.routines[does.name].does
            assert isinstance(routine, Multiplied)
            routine.meets(w.memory[FACTOR])
            w.write("argument")
            w.set(range_of(o.out.fix))
            w.write(element(o.out, k))

    def called(self, name: str, does: Kept | Multiplied | None, note: str) -> None:
        w = self.writer
        routine = self.routines.setdefault(name, Routine(does, w.range))
        routine.given = min(routine.given[0], w.range[0]), max(routine.given[1], w.range[1])
        w.word(Word.CALL, list(self.routines).index(name), note)

    def call(self, o: Lookup, k: int) -> None:
        """Write the answer to the accumulator into an element."""
        kept = self.kept[self.tables[o.table].name]
        self.called(kept.table.name, kept, f"{o.out.name}[{k}] = {o.table}")
        self.writer.write("argument")
        self.writer.set(range_of(o.out.fix))
        self.writer.write(element(o.out, k))

    def chosen(self, key: Key, found: Range) -> None:
        self.called("choice", None, f"choose {name_of(key)}")
        self.writer.hold()
        self.writer.set(found)
        self.writer.write(key)

    def choose(self) -> None:
        """acc = the word `above`, or `below` if the accumulator is negative."""
        w = self.writer
        w.clear()
        w.add(NOTHING, choose=True)
        w.add("above")

    def leave(self) -> None:
        self.writer.word(Word.CALL, NOTHING, "end")
        self.writer.hold()

    @cached_property
    def rest(self) -> int:
        """Bits of an argument that are kept for the way between two points, and the place of a sign."""
        does = [r.does for r in self.routines.values()]
        shifted = [d.bits for d in does if isinstance(d, Multiplied)]
        return 1 + max([0, *(kept.place_bits for kept in self.kept.values()), *shifted])


WRITTEN: dict[Op, Callable[..., None]] = {
    Op.TABLE: Compiler.lookup,
    Op.CLAMP: Compiler.clamp,
    Op.THRESHOLD: Compiler.threshold,
    Op.SELECT: Compiler.select,
    Op.PRODUCT: Compiler.product,
}


def range_of(fix: Fix) -> Range:
    return fix.lo, fix.hi


def element(signal: Signal, k: int) -> str:
    return f"{signal.name}[{k}]"


@dataclass(frozen=True)
class Code:
    """A program laid out for the machine.

    words: (operation, field, note), by address. memory: what each word of memory holds at first, with a note, by
    address. bits: place in the main code -> bit of the sample.
    """

    words: list[tuple[int, int, str]]
    memory: dict[int, tuple[int, str]]
    bits: dict[int, int]
    widths: dict[str, int]  # acc, data, read, field, code, entry, count, rest
    boot: int
    start: int
    pushes: int
    clocks: int  # of a step in which neither side waits


@lru_cache(maxsize=1)
def compiled(program: Program) -> Code:
    """The code of a program: compiled anew until every width that the words depend on is known."""
    width, field_width = 2, 2
    while True:
        compiler = Compiler(program, width)
        compiler.compile(1 << field_width)
        layout = _Layout(compiler)
        if layout.field_width <= field_width and compiler.writer.acc_width <= width:
            return layout.code()
        width, field_width = max(width, compiler.writer.acc_width), max(field_width, layout.field_width)


class _Layout:
    """Gives every named word an address of memory, and every word of code its place."""

    def __init__(self, compiler: Compiler):
        self.compiler, self.program = compiler, compiler.program
        routines = compiler.routines.values()
        self.lines = [*compiler.boot, *compiler.main, *(line for r in routines for line in r.lines)]
        self.address: dict[Key, int] = {}
        writable = self._writable()
        constants = self._constants()
        half = max(bits(writable - 1), bits(len(constants) - 1))
        self.field_width = half + 1
        self.constants = constants

    def _writable(self) -> int:
        """Place what is written: states first, then pairs and words of the routines, then elements while they live."""
        elements = [element(s.signal, k) for s in self.program.states for k in range(s.signal.size)]
        fixed = [*elements, *([""] if len(elements) % 2 else []), *(k for pair in PAIRS for k in pair)]
        shared = (
            line.field for r in self.compiler.routines.values() for line in r.lines if line.operation != Word.LOOK
        )
        fixed += [k for k in dict.fromkeys(shared) if isinstance(k, str) and k not in fixed]
        self.address |= {key: n for n, key in enumerate(fixed)}
        end = len(fixed)
        free: list[int] = []
        last: dict[str, int] = {}
        for n, line in enumerate(self.compiler.main):
            if isinstance(line.field, str):
                last[line.field] = n
        dying: dict[int, list[str]] = {}
        for key, n in last.items():
            dying.setdefault(n, []).append(key)
        for n, line in enumerate(self.compiler.main):
            if isinstance(line.field, str) and line.field not in self.address and line.operation != Word.LOOK:
                if not free:
                    free, end = [end], end + 1
                self.address[line.field] = free.pop()
            free += [self.address[k] for k in dying.get(n, ()) if self.address[k] >= len(fixed)]
        return end

    def _constants(self) -> list[int]:
        """The words that are never written: pairs first, each at an even place."""
        found = dict.fromkeys(line.field for line in self.lines if isinstance(line.field, Constant))
        values: list[int] = []
        for c in found:
            if c.second is not None:
                values += [c.value, c.second]
        known = set(values)
        for value in dict.fromkeys(c.value for c in [NOTHING, *found] if c.second is None):
            values += [] if value in known else [value]
        return values

    def code(self) -> Code:
        compiler, program = self.compiler, self.program
        count = bits(max([1, *(len(r.lines) - 1 for r in compiler.routines.values())]))
        entry = bits(len(compiler.routines) - 1) if len(compiler.routines) > 1 else 0
        block, boot = 1 << count, 1 << (count + entry)
        start = 1 << bits(boot + len(compiler.boot) - 1)
        if any(isinstance(r.does, Multiplied) for r in compiler.routines.values()):
            start = boot + len(compiler.boot)  # a program with products is long: no word lies idle
        words = [(int(Word.CLEAR), 0, "")] * (start + len(compiler.main))
        places = [(n * block, r.lines) for n, r in enumerate(compiler.routines.values())]
        for place, lines in [*places, (boot, compiler.boot), (start, compiler.main)]:
            for n, line in enumerate(lines):
                words[place + n] = (int(line.operation), self.field(line), line.note)
        half = 1 << (self.field_width - 1)
        memory = {half + n: (v, "") for n, v in enumerate(self.constants)}
        for name, kept in compiler.kept.items():
            memory |= {kept.origin + n: (v, f"{name}[{n}]") for n, v in enumerate(kept.words)}
        data = max(compiler.writer.data_width, *(width_of((v, v)) for v, _ in memory.values()))
        read = bits(max(memory))
        outputs = sum(p.signal.size for p in program.outputs)
        widths = {
            "acc": max(compiler.writer.acc_width, data, read),
            "data": data,
            "read": max(read, self.field_width),
            "field": self.field_width,
            "code": bits(len(words) - 1),
            "entry": entry,
            "count": count,
            "rest": compiler.rest,
        }
        sample = {start + n + 1: bit for n, bit in compiler.bits.items()}
        lengths = [len(r.lines) + 1 for r in compiler.routines.values()]  # the word after a call is performed twice
        called = [line.field for line in compiler.main if line.operation == Word.CALL]
        clocks = len(compiler.main) + sum(lengths[at] for at in called if isinstance(at, int))
        return Code(words, memory, sample, widths, boot, start, max(0, outputs - 2), clocks)

    def field(self, line: Line) -> int:
        """The number in a word's field."""
        key, half = line.field, 1 << (self.field_width - 1)
        if line.operation == Word.LOOK:
            return 0
        if isinstance(key, int):
            return key
        if isinstance(key, str):
            return self.address[key]
        constant = NOTHING if key is None else key
        assert isinstance(constant, Constant)
        if constant.second is None:
            return half + self.constants.index(constant.value)
        pairs = zip(self.constants[::2], self.constants[1::2], strict=False)
        return half + 2 * next(n for n, pair in enumerate(pairs) if pair == (constant.value, constant.second))


def bits(largest: int) -> int:
    """Width of an unsigned number up to `largest`."""
    return max(1, int(largest).bit_length())
