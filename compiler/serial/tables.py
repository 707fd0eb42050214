"""Lookups of the serial architecture: what memory holds of a table, and the words that answer an argument.

docs/integer-program.md, "Lookup". A routine finds the argument in the word `argument` and leaves the answer in the
accumulator. It has no branches: every octave is visited, and gives 0 where the argument lies below.
"""

from dataclasses import dataclass
from functools import cached_property

from greygate.compiler.serial.writer import NOTHING, PLAIN, TAKE, ZERO, Add, Constant, Key, Range, Writer
from greygate.emulator.tables import Lines, Segments, Symmetry, Table

FACTOR = "slope"  # the word beside `zero`, of which a bit of another code chooses one


@dataclass(frozen=True)
class Kept:
    """What memory holds of a table, from address `origin` on."""

    table: Table | Lines
    origin: int

    @cached_property
    def last(self) -> int:
        """The index that answers all beyond: of the first point that is as all after it, or one behind the lines."""
        if isinstance(self.table, Lines):
            return len(self.table.bases)
        points = self.table.points
        last = len(points) - 1
        while last and points[last - 1] == points[-1]:
            last -= 1
        return last

    @property
    def flat(self) -> int:
        """A code from which the answer is the same."""
        t = self.table
        if isinstance(t, Lines):
            s = t.segments
            return s.lefts[-1] + ((self.last - s.firsts[-1]) << s.shifts[-1])
        return self.last << t.shift

    @property
    def between(self) -> bool:
        """Whether a line goes from point to point."""
        return isinstance(self.table, Table) and self.table.interpolated and self.table.shift > 0

    @property
    def place_bits(self) -> int:
        """Bits of the greatest place in a segment that is multiplied by a slope."""
        t = self.table
        if isinstance(t, Lines):
            most = [(1 << (s - d)) - (d > 0) for s, d in zip(t.shifts, t.drops, strict=True)]
            return max(most).bit_length()
        return t.shift if self.between else 0

    @property
    def finer(self) -> int:
        """Bits by which kept slopes are finer than the table's: no base is added before the last bit of a place."""
        return max(0, self.place_bits - self.table.segments.below) if isinstance(self.table, Lines) else 0

    @cached_property
    def words(self) -> list[int]:
        """Points, one more behind the last if lines go between; or bases, one more for all beyond, then slopes."""
        t = self.table
        if isinstance(t, Table):
            points = list(t.points[: self.last + 1])
            return [*points, points[-1]] if self.between else points
        s = t.segments
        beyond = s.at(s.bases[-1], s.slopes[-1], 1 << (s.shifts[-1] - s.drops[-1])) << s.guard
        return [*s.bases, beyond, *(slope << self.finer for slope in s.slopes), 0]


class Answer:
    """The words of one routine. rest: bits that the machine keeps of those shifted out, and the place of a sign."""

    def __init__(self, writer: Writer, kept: Kept, rest: int):
        self.writer, self.kept, self.rest = writer, kept, rest

    def write(self) -> None:
        w, table = self.writer, self.kept.table
        w.memory["argument"] = w.range
        if isinstance(table, Lines):
            self.lines(table.segments)
            w.set((table.out.lo, table.out.hi))
        else:
            self.points(table)
        if table.symmetry is not Symmetry.EVEN:
            self.mirror(1 << table.out.frac if table.symmetry is Symmetry.COMPLEMENT else 0)

    def points(self, table: Table) -> None:
        w, kept, shift = self.writer, self.kept, table.shift
        w.load("argument", f"table {table.name}")
        w.add("argument")
        w.rise("twice the argument, or 0")
        w.add("argument", Add.INVERT)
        nearest = -1 if kept.between else shift - 1  # the place at which half a step is added
        w.add(NOTHING, Add.INVERT | (Add.CARRY if nearest == 0 else PLAIN), "the absolute value")
        w.set((0, 1 + max(map(abs, w.memory["argument"]))))
        for place in range(1, shift + 1):
            w.add(NOTHING, Add.SHIFT | (Add.CARRY if nearest == place else PLAIN), "the index")
        w.add(Constant(kept.last), TAKE)
        w.rise("at most the last")
        w.add(Constant(kept.origin + kept.last), TAKE)
        w.set((kept.origin, kept.origin + kept.last))
        if kept.between:
            self.line(shift)
        else:
            self.look(kept.words)

    def look(self, words: list[int]) -> None:
        """acc = the word of memory at the address in the accumulator."""
        self.writer.look((min(words), max(words)))

    def line(self, shift: int) -> None:
        """acc = the value between two points: that of the index, and the next."""
        w, points = self.writer, self.kept.words
        index = w.range
        w.write("index")
        if self.rest - shift - 1:
            w.hold()
            self.pass_by(self.rest - shift - 1)
            w.load("index")
        self.look(points)
        w.write("base")
        w.load("index")
        w.add(NOTHING, Add.CARRY, "the next point")
        w.set((index[0] + 1, index[1] + 1))
        self.look(points)
        w.add("base", Add.INVERT)
        w.add(NOTHING, Add.INVERT, "the slope")
        w.write("slope")
        self.product(shift, shift - 1)
        w.add("base", Add.SHIFT, "the value")
        w.set((min(points), max(points)))

    def pass_by(self, count: int) -> None:
        for _ in range(count):
            self.writer.add(NOTHING, Add.SHIFT, "bring the bits of the place to their end")

    def product(self, bits: int, half: int) -> None:
        """acc = slope * the place whose bits were shifted out, above its lowest `bits` - 1 bits; plus half, there."""
        w = self.writer
        lo, hi = w.memory["slope"]
        w.clear()
        w.add(NOTHING, Add.SHIFT)
        w.memory["zero"] = min(0, lo), max(0, hi)
        w.add(NOTHING, choose=True)
        for bit in range(bits - 1):
            w.add("zero", choose=True, note=f"bit {bit} of the place")
        w.add("zero", Add.SHIFT | (Add.CARRY if half == bits - 1 else PLAIN), f"bit {bits - 1} of the place")
        w.memory["zero"] = ZERO

    def lines(self, s: Segments) -> None:
        """acc = the answer of a line: its segment is the sum over octaves of those that the argument has passed."""
        w, kept = self.writer, self.kept
        self.magnitude()
        for o in range(len(s.shifts)):
            self.octave(s, o)
        octaves = range(len(s.shifts))
        last = kept.last
        self.sum([f"segments {o}" for o in octaves], (0, last))
        w.write("index")
        self.at(kept.origin + last + 1, kept.words[last + 1 :])
        w.write("slope")
        self.at(kept.origin, kept.words[: last + 1])
        w.write("base")
        bits = kept.place_bits
        if bits:
            self.place(s)
        below, frac = s.below + kept.finer, s.slope_frac + kept.finer
        half = frac - 1 if s.slope_frac else -1  # the place at which half is added
        if bits:
            self.product(bits, half)
            for place in range(bits, below):
                w.add(NOTHING, Add.SHIFT | (Add.CARRY if half == place else PLAIN))
            w.add("base", (Add.SHIFT if below else PLAIN) | (Add.CARRY if half == below else PLAIN))
        else:
            w.load("base")
            w.add(NOTHING, Add.CARRY if half >= 0 and half == below else PLAIN)
        for place in range(below + 1, frac + 1):
            w.add(NOTHING, Add.SHIFT | (Add.CARRY if half == place else PLAIN))

    def magnitude(self) -> None:
        """Write the argument's bits, inverted if it is negative."""
        w = self.writer
        lo, hi = w.memory["argument"]
        w.load("argument", f"table {self.kept.table.name}")
        w.add("argument", Add.CARRY)
        w.rise()
        w.add("argument", Add.INVERT)
        w.add(Constant(-1), Add.INVERT, "the magnitude")
        w.set((0, max(0, hi, ~lo)))
        w.write("magnitude")

    def octave(self, s: Segments, o: int) -> None:
        """Write how far the argument goes into an octave: whole segments, and steps of its places."""
        w, kept, several = self.writer, self.kept, o + 1 < len(s.shifts)
        end = s.lefts[o + 1] if several else kept.flat
        w.load("magnitude", f"octave {o}")
        if s.lefts[o]:
            w.add(Constant(-s.lefts[o]))
        w.limit(0, end - s.lefts[o])
        self.halve(s.drops[o])
        w.write(f"steps {o}")
        w.hold()
        self.halve(s.shifts[o] - s.drops[o])
        w.write(f"segments {o}")

    def halve(self, times: int) -> None:
        for _ in range(times):
            self.writer.add(NOTHING, Add.SHIFT)

    def sum(self, keys: list[Key], found: Range) -> None:
        w = self.writer
        w.clear()
        for key in keys:
            w.add(key)
        w.set(found)

    def at(self, origin: int, words: list[int]) -> None:
        w = self.writer
        index = w.memory["index"]
        w.load("index")
        w.add(Constant(origin))
        w.set((origin + index[0], origin + index[1]))
        self.look(words)

    def place(self, s: Segments) -> None:
        """Shift the place in the segment out: all steps less those of whole segments."""
        w, octaves = self.writer, range(len(s.shifts))
        bits = [shift - drop for shift, drop in zip(s.shifts, s.drops, strict=True)]
        one_more = self.one_more(s)
        w.clear("steps of whole segments")
        for level in range(max(bits), -1, -1):
            for o in octaves:
                if bits[o] == level:
                    w.add(f"segments {o}")
            if level and w.range != ZERO:
                w.double(carry=False)
        w.write("whole")
        self.sum([*(f"steps {o}" for o in octaves), *one_more], (0, w.memory["whole"][1] + (1 << max(bits))))
        w.write("steps")
        w.load("whole")
        w.add("steps", TAKE, "the place")
        w.set((0, (1 << self.kept.place_bits) - 1))
        self.halve(self.kept.place_bits)
        self.pass_by(self.rest - self.kept.place_bits - 1)

    def one_more(self, s: Segments) -> list[Key]:
        """What a negative argument adds to its place in an octave of which no bit is dropped."""
        w = self.writer
        if all(s.drops):
            return []
        keys: list[Key] = []
        for o, drop in enumerate(s.drops):
            if drop == 0:
                for n, left in enumerate((s.lefts[o], *s.lefts[o + 1 : o + 2])):
                    w.load("magnitude", f"whether it lies in octave {o}")
                    w.add(Constant(1 - left))
                    w.limit(0, 1)
                    if n:
                        w.add(NOTHING, TAKE)
                    w.write(f"within {o} {n}")
                    keys.append(f"within {o} {n}")
        w.load("argument", "whether the argument is negative")
        w.add(NOTHING, TAKE)
        w.limit(0, 1)
        w.write("negative")
        self.sum([*keys, "negative"], (0, 2))
        w.add(Constant(-1))
        w.limit(0, 1)
        w.write("one more")
        return ["one more"]

    def mirror(self, one: int) -> None:
        """acc = one - acc if the argument is negative."""
        w, found = self.writer, self.writer.range
        w.write("above")
        w.load("above")
        w.add(Constant(one), TAKE)
        w.write("below")
        both = min(found[0], w.range[0]), max(found[1], w.range[1])
        w.load("argument")
        w.memory["above"] = both
        w.clear("its sign chooses")
        w.add(NOTHING, choose=True)
        w.add("above")


def kept_tables(tables: list[Table | Lines], origin: int) -> dict[str, Kept]:
    """Every table, one behind the other from an address of memory on, by name."""
    found = {}
    for t in tables:
        found[t.name] = Kept(t, origin)
        origin += len(found[t.name].words)
    return found
