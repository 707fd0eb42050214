"""The serial architecture laid out: an address for every word of code and of memory."""

from dataclasses import dataclass

from greygate.compiler.lately import lately
from greygate.compiler.serial.code import PAIRS, Compiler, element
from greygate.compiler.serial.writer import NOTHING, Constant, Key, Line, Word, width_of
from greygate.emulator.program import Program


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


@lately
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
