"""Random programs over the whole legal space of docs/integer-program.md, at its limits as often as within."""

import math
from dataclasses import replace

import numpy as np

from greygate.emulator.numbers import ACCUMULATOR_BITS, FRACTIONS, WIDTHS, Fix, Overflow, Rounding
from greygate.emulator.program import (
    Affine,
    Clamp,
    Lookup,
    Operation,
    Product,
    Program,
    Select,
    Signal,
    State,
    Terminal,
    Threshold,
)
from greygate.emulator.tables import Lines, Segments, Symmetry, Table

LOWEST, HIGHEST = FRACTIONS[0], FRACTIONS[-1]
SIZES = (1, 1, 2, 3, 4, 5, 7)
MOST_POINTS = 33
MOST_STATES = 3


class _Drawing:
    """The parts of one program as they are drawn; `known` are the signals that an operation may read."""

    def __init__(self, seed: int):
        self.rng = np.random.default_rng([seed, 12])
        self.operations: list[Operation] = []
        self.tables: list[Table] = []
        self.known: list[Signal] = []

    def among(self, least: int, greatest: int) -> int:
        """An integer from least to greatest, the ends often."""
        kind = self.rng.random()
        if kind < 0.3 or least == greatest:
            return int(least if kind < 0.15 else greatest)
        return int(self.rng.integers(least, greatest, endpoint=True))

    def pick(self, items):
        return items[int(self.rng.integers(len(items)))]

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def width(self) -> int:
        return self.among(WIDTHS[0], WIDTHS[-1])

    def near(self, frac: int, least: int = LOWEST, greatest: int = HIGHEST) -> int:
        """A fraction: often one that leaves some of a value that has `frac`, else any."""
        found = frac + int(self.rng.integers(-12, 6)) if self.chance(0.6) else self.among(least, greatest)
        return min(max(found, least), greatest)

    def code(self, fix: Fix) -> int:
        return self.among(fix.lo, fix.hi)

    def signal(self, kind: str, size: int, fix: Fix) -> Signal:
        return Signal(f"{self.pick(('', 'net.'))}{kind}", size, fix)

    def arg(self) -> Signal:
        return self.pick(self.known)

    def initial(self, s: Signal) -> tuple[int, ...]:
        return tuple(self.code(s.fix) for _ in range(s.size))

    def add(self, operation: Operation) -> Signal:
        self.operations.append(operation)
        self.known.append(operation.out)
        return operation.out

    def affine(self, out: Signal) -> Affine:
        args = [self.arg() for _ in range(self.rng.integers(1, 4))]  # one twice, now and then
        reach = [-a.fix.lo for a in args for _ in range(a.size)]
        bits = self.pick((ACCUMULATOR_BITS, ACCUMULATOR_BITS, 54, 53, 52, int(self.rng.integers(2, 63))))
        rows = [self.row(out.fix, reach, bits) for _ in range(out.size)]
        weights, bias, frac = (np.array(part, np.int64) for part in zip(*rows, strict=True))
        modes = self.pick(list(Rounding)), self.pick(list(Overflow))
        return Affine(out, tuple(a.name for a in args), weights, bias, frac, *modes)

    def row(self, out: Fix, reach: list[int], bits: int) -> tuple[list[int], int, int]:
        """Weights, bias and fraction of a sum of at most `bits`; half of the sums use all of them."""
        left, right = bits - ACCUMULATOR_BITS, bits - 1  # the least and the greatest shift
        wanted = bits - out.width + int(self.rng.integers(-4, 5)) if self.chance(0.6) else self.among(left, right)
        shift = min(max(self.pick((wanted, wanted, wanted, 1, 2)), left), right)
        room = (1 << (bits - 1)) - 1 - (1 << (shift - 1) if shift > 0 else 0)
        alike = self.chance(0.4)  # all at their ends at once: the greatest sum, or the least
        weights = [0] * len(reach)
        for j in self.rng.permutation(len(reach)):
            most = room // reach[j]
            size = self.among(0, most if self.chance(0.3) else math.isqrt(most))
            size = 1 << (size.bit_length() - 1) if size and self.chance(0.2) else size
            weights[j] = size if alike or self.chance(0.5) else -size
            room -= size * reach[j]
        bias = room if self.chance(0.5) else self.among(0, room)
        sign = self.pick((-1, 1))
        return [sign * w for w in weights], -sign * bias if alike else self.pick((-1, 1)) * bias, out.frac + shift

    def lookup(self, name: str) -> Lookup:
        arg, symmetry, width = self.arg(), self.pick(list(Symmetry)), self.width()
        most = width - 1 if symmetry is Symmetry.COMPLEMENT else HIGHEST
        out = Signal(name, arg.size, Fix(width, self.near(width - 1, 0, most)))
        one, lo, hi = 1 << out.fix.frac, out.fix.lo, out.fix.hi
        lo, hi = {
            Symmetry.ODD: (-hi, hi),
            Symmetry.EVEN: (lo, hi),
            Symmetry.COMPLEMENT: (max(lo, one - hi), min(hi, one - lo)),
        }[symmetry]
        if self.chance(0.5):
            table = self.lines(arg.fix, out.fix, symmetry, lo, hi)
            self.tables.append(table)
            return Lookup(out, arg.name, table.name)
        last = int(self.rng.integers(1, MOST_POINTS))
        natural = max(0, arg.fix.width - last.bit_length() - int(self.rng.integers(-1, 2)))
        shift = min(natural if self.chance(0.6) else self.among(0, arg.fix.width), arg.fix.width)
        interpolated = self.chance(0.7)
        steepest = (1 << (ACCUMULATOR_BITS - 1 - shift)) - 1 if interpolated else hi - lo
        points = [self.among(lo, hi)]
        while len(points) <= last:
            points.append(self.among(max(lo, points[-1] - steepest), min(hi, points[-1] + steepest)))
        table = Table(
            f"t{len(self.tables)}", "any", symmetry, shift, tuple(points), interpolated, arg.fix, out.fix, 0.0
        )
        self.tables.append(table)
        return Lookup(out, arg.name, table.name)

    def lines(self, arg: Fix, out: Fix, symmetry: Symmetry, lo: int, hi: int) -> Lines:
        """Lines over one octave or several, with results lo to hi at both ends of every segment."""
        octaves = min(self.pick((1, 1, 2, 3, 4, 6, arg.width)), arg.width)
        natural = max(0, arg.width - octaves + int(self.rng.integers(-1, 2)))
        start = min(natural if self.chance(0.6) else self.among(0, arg.width), arg.width)
        sizes = [arg.width] if octaves == 1 else [start, *(start + o for o in range(octaves - 1))]
        shifts = [max(0, z - int(self.rng.integers(0, 4))) if self.chance(0.8) else z for z in sizes]
        if octaves == 1:
            shifts = [self.among(0, arg.width) if self.chance(0.4) else max(0, arg.width - self.pick((2, 3, 5)))]
        drops = [self.among(0, s) if self.chance(0.4) else 0 for s in shifts]
        most = 1 << (sizes[-1] - shifts[-1])
        last = self.among(1, min(most, MOST_POINTS) if octaves > 1 else MOST_POINTS)
        count = sum(1 << (z - s) for z, s in zip(sizes[:-1], shifts[:-1], strict=True)) + last
        guard = self.among(0, ACCUMULATOR_BITS - out.width - 3)
        slope_frac = self.among(guard, ACCUMULATOR_BITS - 2) if self.chance(0.3) else guard
        slope_frac = min(slope_frac + self.pick((0, 1, 4, 9)), ACCUMULATOR_BITS - 2)
        table = Lines(
            f"t{len(self.tables)}", "any", symmetry, start, tuple(shifts), tuple(drops), slope_frac, guard,
            (0,) * count, (0,) * count, arg, out, 0.0,
        )  # fmt: skip
        s = table.segments
        firsts, words, most = [*s.firsts, count], [], max(z - d for z, d in zip(shifts, drops, strict=True))
        for o, (shift, drop) in enumerate(zip(shifts, drops, strict=True)):
            for _ in range(firsts[o], firsts[o + 1]):
                words.append(self.line(s, shift - drop, most, lo, hi))
        bases, slopes = zip(*words, strict=True)
        return replace(table, bases=bases, slopes=slopes)

    def line(self, s: Segments, places: int, most: int, lo: int, hi: int) -> tuple[int, int]:
        """Base and slope whose answers at both ends are from lo to hi, and whose sums fit the emulators."""
        left, right = (self.among(lo, hi) for _ in range(2))
        base = (left << s.guard) + (self.among(0, (1 << s.guard) - 1) - s.halves[1] if s.guard else 0)
        steepest = ((1 << (ACCUMULATOR_BITS - 2)) - 1 - s.halves[0]) >> most
        rise = right - left
        size = min((abs(rise) << s.slope_frac) >> places, steepest)
        while size and not lo <= s.at(base, size if rise > 0 else -size, 1 << places) <= hi:
            size >>= 1
        return base, size if rise > 0 else -size

    def clamp(self, name: str) -> Clamp:
        arg, width = self.arg(), self.width()
        greatest = min(HIGHEST, arg.fix.frac + ACCUMULATOR_BITS - arg.fix.width)
        frac = self.near(arg.fix.frac - arg.fix.width + width, LOWEST, greatest)
        if self.chance(0.3):  # about the bits of an int64, and of the argument
            frac = max(LOWEST, arg.fix.frac - self.pick((*range(60, 67), arg.fix.width - 1, arg.fix.width)))
        lo, hi = sorted((self.code(arg.fix), self.code(arg.fix))) if self.chance(0.5) else (arg.fix.lo, arg.fix.hi)
        out = Signal(name, arg.size, Fix(width, frac))
        return Clamp(out, arg.name, lo, hi, self.pick(list(Rounding)))

    def threshold(self, name: str) -> Threshold:
        arg = self.arg()
        out = Signal(name, arg.size, Fix(self.width(), self.near(0)))
        return Threshold(out, arg.name, self.code(arg.fix), self.code(out.fix), self.code(out.fix))

    def select(self, name: str) -> Select:
        above = self.arg()
        alike = [s for s in self.known if s.size == above.size]

        def widest(below: Signal) -> int:
            finest = max(above.fix.frac, below.fix.frac)
            return max(s.fix.width + finest - s.fix.frac for s in (above, below))

        below = self.pick([s for s in alike if widest(s) <= ACCUMULATOR_BITS])
        finest = max(above.fix.frac, below.fix.frac)
        greatest, width = min(HIGHEST, finest + ACCUMULATOR_BITS - widest(below)), self.width()
        frac = self.near(above.fix.frac - above.fix.width + width, LOWEST, greatest)
        out = Signal(name, above.size, Fix(width, frac))
        args = self.pick(alike).name, *self.pick(((above.name, below.name), (below.name, above.name)))
        return Select(out, *args, self.pick(list(Rounding)))

    def product(self, name: str) -> Product | Clamp:
        """A product of two signals that are narrow enough; a clamp where there are none."""

        def left(a: Signal, b: Signal) -> int:
            return ACCUMULATOR_BITS - a.fix.width - b.fix.width

        same = [(a, b) for a in self.known for b in self.known if a.size == b.size and left(a, b) >= 0]
        pairs = [(a, b) for a, b in same if a.fix.frac + b.fix.frac + left(a, b) >= LOWEST]
        if not pairs:
            return self.clamp(name)
        one, other = self.pick(pairs)
        exact, width = one.fix.frac + other.fix.frac, self.width()
        greatest = min(HIGHEST, exact + left(one, other))
        frac = self.near(exact - one.fix.width - other.fix.width + width, LOWEST, greatest)
        if self.chance(0.1):
            frac = min(max(exact, LOWEST), greatest)
        return Product(Signal(name, one.size, Fix(width, frac)), one.name, other.name, self.pick(list(Rounding)))

    def operation(self, n: int) -> None:
        kinds = (self.lookup, self.lookup, self.lookup, self.clamp, self.threshold, self.select, self.product)
        if self.chance(0.4):
            fix = Fix(self.width(), self.near(20))
            self.add(self.affine(self.signal(f"x{n}", self.pick(SIZES), fix)))
        else:
            self.add(self.pick(kinds)(f"x{n}"))


def legal_program(seed: int, name: str | None = None) -> Program:
    """A program of some vectors whose every number is drawn from all that is legal; the limits come often."""
    d = _Drawing(seed)

    def format_() -> Fix:
        return Fix(d.width(), d.near(20))

    inputs = [d.signal(f"u{i}", d.pick(SIZES), format_()) for i in range(d.rng.integers(1, 3))]
    promised = [d.signal(f"s{i}", d.pick(SIZES), format_()) for i in range(d.rng.integers(0, MOST_STATES))]
    d.known = inputs + promised
    states = []
    for i in range(d.rng.integers(0, MOST_STATES)):  # a delay of an input or state, a tap of a tap among them
        source = d.arg()
        tap = Signal(f"tap{i}", source.size, source.fix)
        states.append(State(tap, source.name, d.initial(tap)))
        d.known.append(tap)
    for n in range(d.rng.integers(1, 6)):
        d.operation(n)
    for s in promised:
        following = d.add(d.affine(Signal(f"{s.name}_next", s.size, s.fix)))
        states.append(State(s, following.name, d.initial(s)))
    shown = {s.name: s for s in [*(d.arg() for _ in range(2)), d.operations[-1].out]}.values()
    return Program(
        name=name or f"legal{seed}",
        inputs=tuple(Terminal(s.name, s, "1", 1.0, 0.0) for s in inputs),
        states=tuple(states[i] for i in d.rng.permutation(len(states))),
        operations=tuple(d.operations),
        outputs=tuple(Terminal(f"y.{s.name}", s, "1", 1.0, 0.0) for s in shown),
        tables=tuple(d.tables),
    ).check()


def legal_codes(program: Program, seed: int, steps: int) -> np.ndarray:
    """Input codes (steps, columns): first all at one end, all at the other, all 0, all -1; then of every magnitude."""
    rng = np.random.default_rng([seed, 13])
    fixes = [p.signal.fix for p in program.inputs for _ in range(p.signal.size)]
    lo, hi = np.array([(f.lo, f.hi) for f in fixes], np.int64).T
    codes = rng.integers(lo, hi, (steps, len(fixes)), endpoint=True)
    small = rng.integers(0, [f.width for f in fixes], codes.shape)
    codes = np.where(rng.random(codes.shape) < 0.5, codes >> small, codes)
    special = rng.random(codes.shape)
    codes = np.where(special < 0.05, lo, np.where(special > 0.95, hi, codes))
    ends = np.array([lo, hi, 0 * lo, 0 * lo - 1])[:steps]
    codes[: len(ends)] = ends
    return codes
