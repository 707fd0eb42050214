"""Words of the serial architecture's code, and the arithmetic that they make: sums, rounding, limits.

rtl/greygate_serial.v performs one word a clock: {operation, field}. The code that a word reads from memory is added by
the word after it. Every operand is named here; targets/serial.py gives it an address. A range is proved for the
accumulator at each word, and the hardware is as wide as the widest.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag

from greygate.compiler.adders import signed_digits
from greygate.emulator.numbers import Fix, Overflow, Rounding, signed_width

Key = Hashable  # names a word of memory: Constant, or a string
Range = tuple[int, int]  # the least and the greatest value
ZERO: Range = (0, 0)


class Add(IntFlag):
    """How an addition changes the accumulator before, and what it adds beside the code."""

    CARRY = 1
    INVERT = 2
    SHIFT = 4


PLAIN = Add(0)
TAKE = Add.INVERT | Add.CARRY  # takes the accumulator from the code


class Word(IntEnum):
    """The operations that are no additions."""

    WRITE = 8
    CLEAR = 9
    RISE = 10
    LOOK = 11
    CHOOSE = 12
    CALL = 13
    WAIT = 14
    SHOW = 15


SAMPLE, ACCEPT, PUSH = 0, 1, 3  # fields of a WAIT


@dataclass(frozen=True)
class Constant:
    """A word of memory that is never written. `second`: the next word, where the first is one of a pair."""

    value: int
    second: int | None = None


NOTHING = Constant(0)


@dataclass
class Line:
    """One word. field: a number, the name of a word of memory, or None while nothing is to be read."""

    operation: int
    field: Key | int | None = None
    note: str = ""


@dataclass
class Writer:
    """Writes words one after the other, with the range of the accumulator and of each word of memory.

    width: of the accumulator, where it must be known beforehand (`wrap`). scaled: the codes that memory holds a second
    time, `doubled` this often. acc_width, data_width: what was found.
    """

    width: int = 2
    scaled: dict[Key, int] = field(default_factory=dict)
    lines: list[Line] = field(default_factory=list)
    range: Range = ZERO
    memory: dict[Key, Range] = field(default_factory=dict)
    acc_width: int = 2
    data_width: int = 2

    def word(self, operation: int, field: Key | int | None = None, note: str = "") -> None:
        self.lines.append(Line(operation, field, note))

    def read(self, key: Key) -> Range:
        """Let the last word read a code, and return the code's range."""
        last = self.lines[-1]
        assert last.field is None, "the word before reads or writes another"
        assert last.operation != Word.WRITE or isinstance(key, Constant), "the word before would write this"
        last.field = key
        if isinstance(key, Constant):
            both = (key.value, key.value if key.second is None else key.second)
            found = min(both), max(both)
            self.data_width = max(self.data_width, width_of(found))
            return found
        return self.memory[key]

    def set(self, found: Range) -> None:
        """State the range of the accumulator."""
        self.range = found
        self.acc_width = max(self.acc_width, width_of(found))

    def add(self, key: Key = NOTHING, how: Add = PLAIN, note: str = "", choose: bool = False) -> None:
        """Add a code. choose: the word reads the next code by a choice."""
        lo, hi = self.read(key)
        a, b = self.range
        how |= Add.SHIFT if choose else 0
        if how & Add.SHIFT:
            a, b = a >> 1, b >> 1
        if how & Add.INVERT:
            a, b = ~b, ~a
        carry = int(bool(how & Add.CARRY))
        self.word(Word.CHOOSE if choose else how, None, note)
        self.set((a + lo + carry, b + hi + carry))

    def clear(self, note: str = "") -> None:
        self.word(Word.CLEAR, None, note)
        self.set(ZERO)

    def load(self, key: Key, note: str = "") -> None:
        self.clear()
        self.add(key, note=note)

    def rise(self, note: str = "") -> None:
        """Raise what is negative to 0."""
        self.word(Word.RISE, None, note)
        self.set((max(0, self.range[0]), max(0, self.range[1])))

    def look(self, found: Range) -> None:
        """acc = the word of memory at the address in the accumulator, of that range."""
        self.word(Word.LOOK)
        self.set(ZERO)
        self.memory["point"] = found
        self.add("point")

    def write(self, key: Key, note: str = "") -> None:
        self.word(Word.WRITE, key, note)
        self.memory[key] = self.range
        self.data_width = max(self.data_width, width_of(self.range))

    def hold(self, note: str = "") -> None:
        """Change nothing, and read the constant that is added next: a constant is never written."""
        self.word(Word.WRITE, None, note)

    def limit(self, lo: int, hi: int) -> None:
        """Bring the accumulator to the nearest value in [lo, hi]."""
        over, under = self.range[1] > hi, self.range[0] < lo
        if over and under:
            self.add(Constant(hi), TAKE, f"at most {hi}")
            self.rise()
            self.add(Constant(hi - lo), TAKE, f"at least {lo}")
            self.rise()
            self.add(Constant(lo))
        elif over:
            self.add(Constant(hi), TAKE, f"at most {hi}")
            self.rise()
            self.add(Constant(hi), TAKE)
        elif under:
            self.add(Constant(-lo), note=f"at least {lo}")
            self.rise()
            self.add(Constant(lo))
        self.set((max(lo, min(hi, self.range[0])), max(lo, min(hi, self.range[1]))))

    def wrap(self, fix: Fix) -> None:
        """Keep the low bits of the accumulator, read as two's complement."""
        if fix.holds(*self.range):
            return
        spare, found = self.width - fix.width, self.acc_width
        whole = (-(1 << (self.width - 1)), (1 << (self.width - 1)) - 1)
        for _ in range(spare):
            self.double(carry=False)
            self.range = whole
        self.acc_width = found  # what lies beyond is lost on purpose
        for _ in range(spare):
            self.add(NOTHING, Add.SHIFT, "keep the low bits")
        self.set((fix.lo, fix.hi))

    def double(self, carry: bool) -> None:
        self.write("twice", "twice")
        self.load("twice")
        self.add("twice", Add.CARRY if carry else PLAIN)

    def scale(self, key: Key, times: int) -> None:
        """Keep a code times 2^times beside the code itself, for the sums that follow."""
        if self.scaled.get(key) != times:
            self.load(key, f"{key} * 2^{times}")
            for _ in range(times):
                self.double(carry=False)
            self.write(doubled(key))
            self.scaled[key] = times

    def fit(self, fix: Fix, overflow: Overflow) -> None:
        if overflow is Overflow.SATURATE:
            self.limit(fix.lo, fix.hi)
        else:
            self.wrap(fix)

    def total(self, keys: Sequence[Key], weights: Sequence[int], constant: int, shift: int, note: str = "") -> None:
        """acc = (constant + sum of weight * code) * 2^-shift, towards minus infinity."""
        terms = [(k, int(w)) for k, w in zip(keys, weights, strict=True) if w]
        lo = constant + sum(min(w * v for v in self.range_of(k)) for k, w in terms)
        hi = constant + sum(max(w * v for v in self.range_of(k)) for k, w in terms)
        exact = _shifted(lo, shift), _shifted(hi, shift)
        if shift < 0:
            terms, constant, shift = [(k, w << -shift) for k, w in terms], constant << -shift, 0
        if terms:
            spare = min(shift, *((w & -w).bit_length() - 1 for _, w in terms))
            terms = [(k, w >> spare) for k, w in terms]
            _Sum(self, terms, constant >> spare, shift - spare, note).write()
        else:
            self.load(Constant(constant >> shift), note)
        assert self.range[0] <= exact[0] <= exact[1] <= self.range[1]
        self.set(exact)

    def range_of(self, key: Key) -> Range:
        return (key.value, key.value) if isinstance(key, Constant) else self.memory[key]

    def rounded(
        self, keys: Sequence[Key], weights: Sequence[int], bias: int, shift: int, rounding: Rounding, note: str = ""
    ) -> None:
        """acc = the sum with its rounding, before it is fitted to a format."""
        half = 1 << (shift - 1) if shift > 0 else 0
        if rounding is Rounding.HALF_EVEN and half:
            self.total(keys, weights, bias, shift, note)
            self.write("quotient")
            self.hold()
            self.add(NOTHING, Add.SHIFT, "its lowest bit")
            self.write("half")
            self.load("half")
            self.add("half")
            self.add("quotient", TAKE)
            self.set((0, 1))
            self.write("odd")
            keys, weights, half = [*keys, "odd"], [*weights, 1], half - 1
        elif rounding is Rounding.TRUNCATE:
            half = 0
        self.total(keys, weights, bias + half, shift, note)

    def requantized(self, key: Key, shift: int, fix: Fix, rounding: Rounding, note: str = "") -> None:
        """acc = a code brought to a format with saturation. A shift beyond every bit of the code is cut short."""
        shift = min(shift, width_of(self.range_of(key)) + 2)
        self.rounded([key], [1], 0, shift, rounding, note)
        self.limit(fix.lo, fix.hi)


def doubled(key: Key) -> str:
    return f"{key}, scaled"


def width_of(found: Range) -> int:
    """The least width in two's complement, of 2 or more bits, that holds a range."""
    return max(2, *(signed_width(v if v >= 0 else ~v) for v in found))


def _shifted(value: int, shift: int) -> int:
    return value >> shift if shift >= 0 else value << -shift


class _Sum:
    """One weighted sum, a place of its digits after the other.

    Places from `shift` up are summed from the highest down, by doubling; then those below from the lowest up, by
    halving the accumulator. `inverted` says that the accumulator holds the complement of the sum: to subtract a code is
    to add it to the complement. An addition's carry is a digit of the constant: +1, or -1 while inverted.
    """

    def __init__(self, writer: Writer, terms: list[tuple[Key, int]], constant: int, shift: int, note: str):
        self.writer, self.constant, self.shift, self.note = writer, constant, shift, note
        self.places: dict[int, list[tuple[Key, int]]] = {}
        for key, weight in terms:
            times = writer.scaled.get(key, 0)
            for place, digit in signed_digits(weight):
                if shift < place <= shift + times and place >= times:
                    self.places.setdefault(place - times, []).append((doubled(key), digit))
                else:
                    self.places.setdefault(place, []).append((key, digit))
        self.inverted = False

    def write(self) -> None:
        writer, highest = self.writer, max(self.places)
        last = self.places.get(self.shift, [])
        writer.clear(self.note)
        if highest > self.shift:
            for place in range(highest, self.shift, -1):
                self.place(self.places.get(place, []), 0)
                writer.double(self.inverted)
            if self.shift:
                writer.write("upper")
                last = [*last, ("upper", -1 if self.inverted else 1)]
                self.constant -= self.inverted << self.shift
                self.inverted = False
                writer.clear()
        for place in range(self.shift):
            digits, odd = self.places.get(place, []), self.constant & 1
            given = self.place(digits, Add.SHIFT if place else 0, odd)
            self.constant = (self.constant - given) >> 1
        self.final(last)

    def place(self, digits: list[tuple[Key, int]], how: int, odd: int = 0) -> int:
        """Add the digits of one place, the shift with the first. Returns the constant's digit, that the first has."""
        given = 0
        digits = sorted(digits, key=lambda d: (d[1] < 0) != self.inverted)  # those that need no inversion first
        if not digits and (how or odd):
            digits = [(NOTHING, -1 if self.inverted else 1)]
        for key, digit in digits:
            if (digit < 0) != self.inverted:
                how |= Add.INVERT
                self.inverted = not self.inverted
            if odd:
                how |= Add.CARRY
                given, odd = (-1 if self.inverted else 1), 0
            self.writer.add(key, Add(how), f"{'-' if digit < 0 else '+'} {name_of(key)}")
            how = 0
        return given

    def final(self, digits: list[tuple[Key, int]]) -> None:
        """Add the digits of the last place and what is left of the constant; end without inversion."""
        digits = sorted(digits, key=lambda d: d[1] > 0)
        if self.constant and not (self.constant == 1 and digits and digits[-1][1] > 0):
            digits.append((Constant(self.constant), 1))
            self.constant = 0
        if digits[-1][1] < 0 if digits else self.shift or self.inverted:
            digits.append((NOTHING, 1))
        for n, (key, digit) in enumerate(digits):
            how = Add.SHIFT if self.shift and n == 0 else PLAIN
            self.place([(key, digit)], how, self.constant if n + 1 == len(digits) else 0)


def name_of(key: Key) -> str:
    if isinstance(key, Constant):
        return str(key.value) if key.second is None else f"{key.value} or {key.second}"
    return str(key)
