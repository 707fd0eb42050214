"""Tables of the integer program: half of a symmetric function, as points or as a line over each segment.

docs/integer-program.md, "Lookup", is their normative text. Only this module declares them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import accumulate, pairwise
from typing import Annotated, ClassVar, NamedTuple

from greygate.emulator.fields import record
from greygate.emulator.numbers import ACCUMULATOR_BITS, Bits, Code, Fix, Name, Text, signed_width
from greygate.plain import SOME, Json
from greygate.reading import listed


class Symmetry(StrEnum):
    """How the answer to a negative code follows from the answer to its absolute value."""

    ODD = "odd"  # f(-x) = -f(x): tansig
    EVEN = "even"  # f(-x) = f(x): radbas
    COMPLEMENT = "complement"  # f(-x) = 1 - f(x): logsig


Function = Annotated[Text, "What it is a table of; for people."]
Answer = Annotated[Symmetry, "Answer to x < 0: -y, y, or 2^out.frac - y."]
Argument = Annotated[Fix, "Format of the argument."]
Outcome = Annotated[Fix, "Format of the result."]
Worst = Annotated[float, "Largest deviation from the function over every code, in units of the result. Changes no bit."]


class Segments(NamedTuple):
    """What an interpolated table does, whatever its kind; docs/integer-program.md, "Lookup", has its names.

    start: log2 of the length of the first octave. shifts, drops: of each octave. slope_frac: fraction bits of a slope.
    guard: those of a base. bases, slopes: of each segment.
    """

    start: int
    shifts: tuple[int, ...]
    drops: tuple[int, ...]
    slope_frac: int
    guard: int
    bases: tuple[int, ...]
    slopes: tuple[int, ...]

    @property
    def lefts(self) -> list[int]:
        """The least code of each octave."""
        return [0, *(1 << (self.start + o) for o in range(len(self.shifts) - 1))]

    @property
    def firsts(self) -> list[int]:
        """The first segment of each octave."""
        sizes = [self.start, *(self.start + o for o in range(len(self.shifts) - 1))]
        return [0, *accumulate(1 << (z - s) for z, s in zip(sizes[:-1], self.shifts[:-1], strict=True))]

    @property
    def below(self) -> int:
        """Fraction bits that a slope has and a base has not."""
        return self.slope_frac - self.guard

    @property
    def halves(self) -> tuple[int, int]:
        """Half of a result's LSB, in units of a slope and in units of a base; one of them is 0."""
        half = (1 << self.slope_frac) >> 1
        return (half, 0) if self.guard == 0 else (0, half >> self.below)

    def at(self, base, slope, place):
        """The answer of a line at a place: Python integers or int64 arrays."""
        lower, upper = self.halves
        return (base + upper + ((slope * place + lower) >> self.below)) >> self.guard

    def ends(self) -> list[int]:
        """The answer at both ends of every segment, and no answer lies beyond these."""
        firsts, found = [*self.firsts, len(self.bases)], []
        for o, (shift, drop) in enumerate(zip(self.shifts, self.drops, strict=True)):
            for i in range(firsts[o], firsts[o + 1]):
                found += [self.at(self.bases[i], self.slopes[i], place) for place in (0, 1 << (shift - drop))]
        return found

    @property
    def reach(self) -> int:
        """The least absolute value of a code from which on all answers are alike, those of one sign."""
        end = self.lefts[-1] + ((len(self.bases) - self.firsts[-1]) << self.shifts[-1])
        places = 1 << (self.shifts[-1] - self.drops[-1])
        last, beyond = (self.at(self.bases[-1], self.slopes[-1], p) for p in (places - 1, places))
        return end + (1 if self.drops[-1] and last != beyond else 0)  # -end is looked up one place before

    def width(self) -> int:
        """Bits that hold every product and every sum."""
        place = max(s - d for s, d in zip(self.shifts, self.drops, strict=True))
        base, slope = (max(map(abs, part)) for part in (self.bases, self.slopes))
        product = (slope << place) + self.halves[0]
        return signed_width(max(product, base + self.halves[1] + (product >> self.below) + 1))


def _answers(table: "Table | Lines", codes: list[int]) -> list[int]:
    """What the symmetry makes of these results."""
    one = 1 << max(0, table.out.frac)
    return {Symmetry.ODD: [-c for c in codes], Symmetry.EVEN: [], Symmetry.COMPLEMENT: [one - c for c in codes]}[
        table.symmetry
    ]


def _extremes(table: "Table | Lines") -> tuple[int, int]:
    """The least and the greatest result."""
    ends = list(table.points) if isinstance(table, Table) else table.segments.ends()
    found = [*ends, *_answers(table, ends)]
    return min(found), max(found)


@dataclass(frozen=True)
class Table:
    """Half of a symmetric function as `points` at the codes 0, 2^shift, 2 * 2^shift, ...

    `worst_error` is the largest deviation from the true function over every input code, in output units.
    """

    name: Name
    function: Function
    symmetry: Answer
    shift: Bits
    points: Annotated[tuple[Code, ...], Json(minItems=2), "Codes of the result's format."]
    interpolated: Annotated[bool, "true: a line between two points; false: the nearest point."]
    arg: Argument
    out: Outcome
    worst_error: Worst

    @property
    def segments(self) -> Segments:
        """The lines between the points: the rise from one to the next over a segment."""
        slopes = tuple(b - a for a, b in pairwise(self.points))
        return Segments(self.arg.width, (self.shift,), (0,), self.shift, 0, self.points[:-1], slopes)

    extremes = property(_extremes)

    @property
    def reach(self) -> int:
        """The least absolute value of a code from which on all answers are alike, those of one sign."""
        return (len(self.points) - 1) << self.shift

    @property
    def entries(self) -> int:
        return len(self.points)

    @property
    def bits(self) -> int:
        """Bits of all points."""
        return len(self.points) * self.out.width

    def problems(self) -> Iterator[str]:
        name, out = f"table {self.name}", self.out
        yield from self.arg.problems(name)
        yield from out.problems(name)
        if len(self.points) < 2 or out.frac < 0:
            yield f"{name}: needs two points, and a result's fraction that is not negative"
        if self.shift not in range(self.arg.width + 1):
            yield f"{name}: shift {self.shift} is not in 0..{self.arg.width}, the width of its argument"
        if not out.holds(*self.points, *_answers(self, list(self.points))):
            yield f"{name}: a point, or what its symmetry makes of it, does not fit {out}"
        if self.interpolated:
            width = self.shift + signed_width(max(abs(b - a) for a, b in pairwise(self.points)))
            if width > ACCUMULATOR_BITS:
                yield f"{name}: needs {width} bits between two points, more than {ACCUMULATOR_BITS}"


@dataclass(frozen=True)
class Lines:
    """Half of a symmetric function as a line over each segment; segments may be longer from octave to octave.

    start, shifts, drops, slope_frac, guard, bases, slopes: as in `Segments`. worst_error: as of a `Table`.
    """

    name: Name
    function: Function
    symmetry: Answer
    start: Bits
    shifts: Annotated[tuple[Bits, ...], SOME, "log2 of the codes of a segment, for each octave."]
    drops: Annotated[tuple[Bits, ...], SOME, "Low bits that the place in a segment leaves out, for each octave."]
    slope_frac: Annotated[Bits, "Fraction bits of a slope, in LSB of the result."]
    guard: Annotated[Bits, "Fraction bits of a base, in LSB of the result."]
    bases: Annotated[tuple[Code, ...], SOME, "One for each segment."]
    slopes: Annotated[tuple[Code, ...], SOME, "One for each segment."]
    arg: Argument
    out: Outcome
    worst_error: Worst
    interpolated: ClassVar[bool] = True

    @property
    def segments(self) -> Segments:
        return Segments(*(getattr(self, name) for name in Segments._fields))

    extremes = property(_extremes)

    @property
    def reach(self) -> int:
        """The least absolute value of a code from which on all answers are alike, those of one sign."""
        return self.segments.reach

    @property
    def entries(self) -> int:
        return len(self.bases)

    @property
    def bits(self) -> int:
        """Bits of all bases and slopes."""
        return len(self.bases) * sum(signed_width(max(map(abs, part))) for part in (self.bases, self.slopes))

    def problems(self) -> Iterator[str]:
        name, out, problem = f"table {self.name}", self.out, self._shape()
        yield from self.arg.problems(name)
        yield from out.problems(name)
        if problem:
            yield f"{name}: {problem}"
            return
        width = self.segments.width()
        if width > ACCUMULATOR_BITS:
            yield f"{name}: needs {width} bits for a sum, more than {ACCUMULATOR_BITS}"
        ends = list(self.segments.ends())
        if not out.holds(*ends, *_answers(self, ends)):
            yield f"{name}: an end of a segment, or what its symmetry makes of it, does not fit {out}"

    def _shape(self) -> str:
        """What is wrong with octaves, fractions or the number of segments; empty if nothing is."""
        several, width = len(self.shifts) > 1, self.arg.width
        if self.out.frac < 0:
            return "needs a result's fraction that is not negative"
        if self.start not in range(width + 1) or not 1 <= len(self.shifts) <= width:
            return f"start {self.start} is not in 0..{width}, or it has no octave or more than {width}"
        if len(self.drops) != len(self.shifts) or any(
            d not in range(s + 1) for s, d in zip(self.shifts, self.drops, strict=True)
        ):
            return "each octave needs a drop of 0 up to its shift"
        for o, shift in enumerate(self.shifts):
            most = self.start + max(0, o - 1) if several else width
            if shift not in range(most + 1):
                return f"shift {shift} of octave {o} is not in 0..{most}"
        if not 0 <= self.guard <= self.slope_frac <= ACCUMULATOR_BITS:
            return f"guard {self.guard} and slope_frac {self.slope_frac} are not in order, from 0 to {ACCUMULATOR_BITS}"
        first, size = self.segments.firsts[-1], self.start + len(self.shifts) - 2 - self.shifts[-1]
        if len(self.bases) != len(self.slopes) or len(self.bases) <= first:
            return "its last octave has no segment, or bases and slopes differ in number"
        if several and len(self.bases) > first + (1 << size):
            return f"its last octave has more than {1 << size} segments"
        return ""


def read_tables(value: object, where: str) -> tuple[Table | Lines, ...]:
    def read(entry: object, where: str) -> Table | Lines:
        return record(Lines if isinstance(entry, dict) and "bases" in entry else Table)(entry, where)

    return tuple(listed(read)(value, where))
