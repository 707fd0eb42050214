"""Fits tables of free lines: the least number of segments, then the least words, that meet an error.

A line is the chord of its segment, moved to halve the worst error; base and slope are rounded to their fractions before
the error is taken. All errors are in LSB of the result. Where the function is beyond the greatest code, that code is
exact here: nothing could be nearer.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from greygate.emulator.numbers import Fix, signed_width
from greygate.emulator.tables import Segments, Symmetry

SAMPLES = 32  # pairs of codes in a segment by which its line is chosen
GUARDS = range(4)  # fraction bits of a base that are tried
STEEP = range(5)  # fraction bits of the rise over a segment that are tried


@dataclass(frozen=True)
class Goal:
    """What a table is to be: f of codes 0 to 2^reach in LSB of the result, and the two formats."""

    f: Callable[[np.ndarray], np.ndarray]
    arg: Fix
    out: Fix
    reach: int


@dataclass(frozen=True)
class _Numbers:
    """Fractions of bases and slopes, and the most bits of a place."""

    guard: int
    steep: int
    place: int

    @property
    def slope_frac(self) -> int:
        return self.place + self.steep

    def drop(self, shift: int) -> int:
        return max(0, shift - self.place)


@dataclass(frozen=True)
class _Octave:
    """2^(size - shift) segments of 2^shift codes from `left`."""

    left: int
    size: int
    shift: int

    @property
    def count(self) -> int:
        return 1 << (self.size - self.shift)


def fit_lines(goal: Goal, symmetry: Symmetry, budget: float, aim: float, most_bits: int, several: bool) -> Segments:
    """Lines whose error is at most `budget` LSB at the sampled codes, or of the most segments if none meet it.

    aim: of the rounded lines, if exact lines over as many segments reach it; otherwise of all.
    several: choose octaves; otherwise all segments have one length. Fewest address bits come first, then fewest
    octaves, fewest segments, the shortest places and the narrowest words.
    """
    fitter = _Fitter(goal, symmetry)
    fine = _Numbers(GUARDS[-1], STEEP[-1], goal.reach)
    layout = fitter.layout(fine, budget, most_bits, several)
    if not fitter.meets(layout, fine, aim):
        layout = fitter.layout(fine, aim, most_bits, several)
    found = []
    for place in range(1, goal.reach + 1):
        if not fitter.meets(layout, _Numbers(GUARDS[-1], STEEP[-1], place), aim):
            continue
        for guard, steep in product(GUARDS, STEEP):
            numbers = _Numbers(guard, steep, place)
            if fitter.meets(layout, numbers, aim):
                found.append((fitter.width(layout, numbers), guard, numbers))
        break
    return fitter.segments(layout, min(found, key=lambda f: f[:2])[-1] if found else fine)


def affordable(goal: Goal, symmetry: Symmetry, budget: float, most_bits: int) -> float:
    """The budget, doubled until octaves of 2^most_bits segments in all meet it at the sampled codes."""
    fitter, fine = _Fitter(goal, symmetry), _Numbers(GUARDS[-1], STEEP[-1], goal.reach)
    while True:
        layout = fitter.layout(fine, budget, most_bits, True)
        if sum(octave.count for octave in layout) <= 1 << most_bits and fitter.meets(layout, fine, budget):
            return budget
        budget *= 2


class _Fitter:
    """The lines of octaves, and their errors."""

    def __init__(self, goal: Goal, symmetry: Symmetry):
        self.goal = goal
        self.wanted: dict[_Octave, tuple[np.ndarray, np.ndarray]] = {}
        self.errors: dict[tuple[_Octave, _Numbers], float] = {}
        self.beyond = goal.f(np.array([1 << goal.reach, max(1 << goal.reach, -goal.arg.lo)], np.int64))
        one = 1 << max(0, goal.out.frac)
        lo, hi = goal.out.lo, goal.out.hi
        self.least, self.most = {
            Symmetry.ODD: (-hi, hi),
            Symmetry.EVEN: (lo, hi),
            Symmetry.COMPLEMENT: (max(lo, one - hi), min(hi, one - lo)),
        }[symmetry]

    def layout(self, numbers: _Numbers, budget: float, most_bits: int, several: bool) -> list[_Octave]:
        """The octaves with the fewest segments."""
        reach = self.goal.reach

        def longest(left: int, size: int) -> _Octave:
            for shift in range(size, max(0, size - most_bits), -1):
                found = _Octave(left, size, shift)
                if self.error(found, numbers) <= budget:
                    return found
            return _Octave(left, size, max(0, size - most_bits))

        above = {size: longest(1 << size, size) for size in range(reach)} if several else {}
        layouts = [
            [longest(0, start), *(above[size] for size in range(start, reach))]
            for start in (range(reach, 0, -1) if several else [reach])
        ]
        meeting = [layout for layout in layouts if self.meets(layout, numbers, budget)]

        def cost(layout: list[_Octave]) -> tuple[int, int, int]:
            words = sum(octave.count for octave in layout)
            return (words - 1).bit_length(), len(layout), words

        return min(meeting or layouts, key=cost)

    def lines(self, octave: _Octave, numbers: _Numbers) -> tuple[np.ndarray, np.ndarray, float]:
        """(bases, slopes, the worst error at the sampled codes of both signs)."""
        s = self.fractions(numbers)
        lower, upper = s.halves
        shift, drop = octave.shift, numbers.drop(octave.shift)
        inner, want = self.samples(octave)
        # of positive codes, and of negative ones: their absolute values are one more
        place = np.stack([inner >> drop, (inner >> drop) + (drop == 0)])[:, None, :]
        unit, end = 2.0**s.slope_frac, 1 << (shift - drop)
        fits = np.clip(want, self.least, self.most)
        slopes = np.floor((fits[1, :, -1] - fits[0, :, 0]) / end * unit + 0.5).astype(np.int64)
        rest = fits - slopes[:, None] * place / unit
        middle = (rest.max((0, 2)) + rest.min((0, 2))) / 2
        bases = np.floor(middle * 2.0**s.guard + 0.5).astype(np.int64)
        for p in (0, end):  # both ends are results, and so is all between them
            exact = bases + upper + ((slopes * p + lower) >> s.below)
            bases -= np.maximum(0, exact - (((self.most + 1) << s.guard) - 1))
            bases += np.maximum(0, (self.least << s.guard) - exact)
        answer = s.at(bases[:, None], slopes[:, None], place)
        worst = self.distance(answer, want)
        if octave.left + (1 << octave.size) == 1 << self.goal.reach:  # its end answers for all beyond
            worst = max(worst, self.distance(s.at(bases[-1:], slopes[-1:], end), self.beyond))
        return bases, slopes, worst

    def distance(self, answer: np.ndarray, want: np.ndarray) -> float:
        """The worst error that another answer could avoid."""
        return float(np.abs(answer - want).max(where=(answer < self.goal.out.hi) | (want < answer), initial=0.0))

    def samples(self, octave: _Octave) -> tuple[np.ndarray, np.ndarray]:
        """Codes in a segment, and f at those of every segment and one beyond: (2, segments, codes)."""
        if octave not in self.wanted:
            shift = octave.shift
            step = 1 << max(0, shift - SAMPLES.bit_length() + 1)
            inner = np.arange(0, 1 << shift, step, dtype=np.int64)
            inner = np.unique([inner, inner + step - 1])  # both ends of what a place leaves out
            codes = octave.left + (np.arange(octave.count, dtype=np.int64) << shift)[:, None] + inner
            self.wanted[octave] = inner, np.stack([self.goal.f(codes), self.goal.f(codes + 1)])
        return self.wanted[octave]

    def fractions(self, numbers: _Numbers) -> Segments:
        return Segments(0, (), (), numbers.slope_frac, min(numbers.guard, numbers.slope_frac), (), ())

    def error(self, octave: _Octave, numbers: _Numbers) -> float:
        if (octave, numbers) not in self.errors:
            self.errors[octave, numbers] = self.lines(octave, numbers)[2]
        return self.errors[octave, numbers]

    def meets(self, layout: list[_Octave], numbers: _Numbers, budget: float) -> bool:
        return all(self.error(octave, numbers) <= budget for octave in layout)

    def width(self, layout: list[_Octave], numbers: _Numbers) -> int:
        """Bits of a word."""
        s = self.segments(layout, numbers)
        return sum(signed_width(max(map(abs, part))) for part in (s.bases, s.slopes))

    def segments(self, layout: list[_Octave], numbers: _Numbers) -> Segments:
        parts = [self.lines(octave, numbers) for octave in layout]
        bases, slopes = (tuple(np.concatenate([p[k] for p in parts]).tolist()) for k in (0, 1))
        shifts = tuple(octave.shift for octave in layout)
        drops = tuple(numbers.drop(shift) for shift in shifts)
        s = self.fractions(numbers)
        return Segments(layout[0].size, shifts, drops, s.slope_frac, s.guard, bases, slopes)
