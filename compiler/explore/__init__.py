"""The designs of one network on one FPGA, which of them are worth having, and the smallest that meets a request.

explore = programs (trail.py) x architectures x designs, each program measured (judge.py), each design costed (cost.py).
The result depends on the network, the records and the request alone: nothing is timed, and every comparison is of
numbers on which all processors agree.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from greygate.compiler.explore.cost import COUNTS, Cost, clocks_of, cost, explored, factor, served, standing
from greygate.compiler.explore.judge import Bound
from greygate.compiler.explore.trail import (
    KEPT,
    Candidate,
    Maker,
    short_neurons,
    trail,
    with_few_digits,
    without_memory,
)
from greygate.compiler.quantize import Formats
from greygate.compiler.rounding import prices
from greygate.compiler.tables import Form
from greygate.compiler.targets import Design, Memory
from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.progress import Progress, silent

WIDTHS = range(8, 25)  # words that are tried everywhere
FINER = (0, 1, 2, 4)  # bits beyond them
OCTAVES = 18  # bits of a word and beyond up to which tables by octaves are tried: wider ones take seconds to make
MULTIPLIERS = (1, 2, 4, 8, 16, 32)  # of the folded architecture
STARTS = (0.25, 1.0 / 64)  # error of a trail's start, as a part of the largest that is of interest
ALIKE = 1.02  # factor by which LUTs or time must be better for a point to stand on the front beside a more accurate one
REACH = 2.0  # factor by which a design of plain words may be too large, where weights of few digits are tried
REMEMBERED = (1e-12, 1e-11)
"""Prices of a digit for a network with memory: it feeds its error back, so that those which others bear spoil it; and
rounding it takes long."""
LESS = 0.99  # factor by which a step of a trail must be cheaper than those before it to be looked at
SETTLED = 1.05  # an error so near to the least of a network that signals have bits enough
PER_BIT = 0.01  # LUTs by which a trail prefers a narrower signal where no part of the design gets smaller


@dataclass(frozen=True)
class Room:
    """What a device has. The most of each that a design may take: of LUTs, of DSPs, of blocks of memory."""

    luts: float
    dsps: float
    memories: float


@dataclass(frozen=True)
class Request:
    """What is asked for. room: of the device, and no more than the request allows. whole: of the device alone.

    latency: us, of a step. widths, finer, architectures, multipliers, factors: what is tried; without factors, the
    widest that a DSP takes.
    """

    device: str
    family: str
    whole: Room
    room: Room
    bound: Bound = field(default_factory=Bound)
    latency: float = math.inf
    widths: Sequence[int] = WIDTHS
    finer: Sequence[int] = FINER
    architectures: Sequence[str] = ()
    multipliers: Sequence[int] = MULTIPLIERS
    factors: Sequence[int] = ()

    @property
    def single(self) -> bool:
        """Whether only one word is asked for: then no other format is tried."""
        return len(self.widths) == 1 and len(self.finer) == 1


@dataclass(frozen=True)
class Point:
    """A design: a candidate as an architecture."""

    candidate: Candidate
    architecture: str
    design: Design
    cost: Cost

    def area(self, whole: Room) -> float:
        """The share of the device that it takes: of LUTs, DSPs and memories together."""
        pairs = ((self.cost.luts, whole.luts), (self.cost.dsps, whole.dsps), (self.cost.memories, whole.memories))
        return round(sum(taken / room if taken else 0.0 for taken, room in pairs if room or taken), 9)


@dataclass(frozen=True)
class Exploration:
    """What was found: front by error; chosen, None if no design meets the request; why, in words, what binds then."""

    request: Request
    programs: int
    points: int
    front: tuple[Point, ...]
    chosen: Point | None
    why: str = ""


class Unmet(Exception):
    """No design meets the request."""

    def __init__(self, found: Exploration):
        super().__init__(found.why)
        self.found = found


Mapper = Callable[[Callable, Iterable], Iterable]  # `map`, or one that works side by side


def explore(make: Maker, request: Request, mapper: Mapper = map, progress: Progress = silent) -> Exploration:
    """Try formats and designs, and choose."""
    candidates = list(_candidates(make, request, mapper, progress))
    costed = _counted(mapper(partial(_costed, request), candidates), f"of {len(candidates)} programs costed", progress)
    points = [p for found in costed for p in found]
    fitting = [p for p in points if _fits(p, request.whole)]
    chosen = _smallest([p for p in fitting if not misses(p, request)], request)
    front = pareto([p for p in fitting if p.candidate.error <= request.bound.interest])
    why = "" if chosen else _binding(points, request)
    return Exploration(request, len(candidates), len(points), tuple(front), chosen, why)


def _candidates(make: Maker, request: Request, mapper: Mapper, progress: Progress) -> Iterator[Candidate]:
    """Words first, then trails from fine ones of them."""
    plain = [Formats(w, f) for w in request.widths for f in request.finer if w + f <= 32]
    words = plain + [replace(f, tables=Form.OCTAVES) for f in plain if f.width + f.finer <= OCTAVES]
    if request.single:
        words = [Formats(request.widths[0], request.finer[0])]
    measured = _counted(
        mapper(partial(_words, make, not request.single), words), f"of {len(words)} words measured", progress
    )
    found = [c for some in measured for c in some]
    yield from found
    if request.single:
        return
    walks = []
    for name in _walked(request):
        price = partial(_price, request, name)
        starts: list[Candidate] = []
        for part in STARTS:
            fine = [c for c in found if c.error <= part * request.bound.interest]
            start = min(fine, key=lambda c: (price(c.program), c.error), default=None)
            starts += [start] if start is not None and all(start is not s for s in starts) else []
        walks += [(name, start) for start in starts]
    trails = mapper(partial(_walk, make, request), walks)
    for steps in _counted(trails, f"of {len(walks)} trails walked", progress):
        yield from steps[1:]
    if not _counting_digits(request) or not _within_reach(found, request):
        return
    paid = prices() if without_memory(make.network) else REMEMBERED
    rounded = mapper(partial(_rounded, make, request), paid)
    for steps in _counted(rounded, f"of {len(paid)} prices of a digit tried", progress):
        yield from steps


def _counted(items: Iterable, what: str, progress: Progress) -> Iterator:
    """The items, each told as it comes; before the first one, that none has come."""
    progress(f"0 {what}")
    for n, item in enumerate(items, 1):
        progress(f"{n} {what}")
        yield item


def _words(make: Maker, short: bool, formats: Formats) -> list[Candidate]:
    """The program of some formats; short: and the one whose neurons have no bits beyond the word."""
    found = [c for c in (make(formats),) if c is not None]
    if found and short and formats.finer:
        found += [c for c in (make(short_neurons(found[0])),) if c is not None]
    return found


def _within_reach(found: Sequence[Candidate], request: Request) -> bool:
    """Whether weights of few digits may make a design fit that counts digits."""
    luts = [cost(c.program, n, Design(), request.family, 1).luts for c in found for n in _counting_digits(request)]
    return min(luts, default=math.inf) <= REACH * request.room.luts


def _walk(make: Maker, request: Request, walk: tuple[str, Candidate]) -> list[Candidate]:
    """A trail as a list, in a process of its own."""
    name, start = walk
    price, found, least = partial(_price, request, name), [], math.inf
    for step in trail(start, make, price, request.bound.interest):
        if (now := price(step.program)) < LESS * least:
            least = now
            found.append(replace(step, tuned=name))
    return found


def _rounded(make: Maker, request: Request, price: float) -> list[Candidate]:
    """Words and trails of the network with weights of few digits, at a price of a digit."""
    fewer, end = with_few_digits(make, price), request.bound.interest
    if fewer is None:
        return []
    found = [c for w in request.widths if (c := fewer(Formats(w, keep=KEPT))) is not None]
    least = min((c.error for c in found), default=math.inf)
    if least > end:
        return []
    start = next(c for c in found if c.error <= SETTLED * least)
    names = _counting_digits(request)
    words = [replace(c, tuned=name) for name in names for c in found if c.error <= end]
    return words + [c for name in names for c in _walk(fewer, request, (name, start))[1:]]


def _counting_digits(request: Request) -> list[str]:
    """Those of them whose size depends on the digits of the weights; to the folded one they cost nothing."""
    return [n for n in _walked(request) if n != "folded"]


def _walked(request: Request) -> list[str]:
    """The architectures for which trails are walked. The serial one has the same few LUTs whatever the formats are."""
    return [n for n in request.architectures or explored() if n != "serial"]


def _price(request: Request, architecture: str, program: Program) -> float:
    """What a program costs as a plain design, in LUTs: a block of memory counts as its share of the device.

    Half of what the blocks count is what of them is filled, so that a step counts that only together with others saves
    a block.
    """
    whole, family = request.whole, request.family
    parts = COUNTS[architecture](program, Design(multipliers=1, factor=factor(family)), family)
    block = whole.luts / whole.memories if whole.memories else whole.luts
    bits = sum(s.size * s.fix.width for s in program.signals.values())
    return parts.sized(family, architecture) + block * (parts.memories + parts.filled) / 2 + PER_BIT * bits


def _costed(request: Request, candidate: Candidate) -> list[Point]:
    """The designs of a candidate, each with its cost."""
    found = []
    for name in (candidate.tuned,) if candidate.tuned else request.architectures or explored():
        clocks: dict[tuple[int, int, int], int] = {}  # of designs that differ in nothing that counts
        for design in designs(name, candidate.program, request):
            key = design.multipliers, design.factor, design.adders
            if key not in clocks:
                clocks[key] = clocks_of(candidate.program, name, design)
            one = cost(candidate.program, name, design, request.family, clocks[key])
            found.append(Point(candidate, name, design, one))
    return found


def designs(name: str, program: Program, request: Request) -> Iterator[Design]:
    """The designs of an architecture that are worth a try."""
    kept = [m for m in Memory if m is not Memory.BLOCK or request.room.memories]
    if name == "folded":
        factors = request.factors or (factor(request.family),)
        numbers = [m for m in request.multipliers if m <= request.whole.dsps]
        yield from (Design(m, f, memory) for m in numbers for f in factors for memory in kept)
    elif name == "parallel":
        units = sum(n for _, n in served(program, standing(program, Design())))
        room = int(min(request.room.dsps, units))
        yield from (Design(dsps=n, memory=memory) for memory in kept for n in dict.fromkeys((0, room // 2, room)))
    else:
        yield from (Design(memory=memory) for memory in kept)


def _fits(point: Point, room: Room) -> bool:
    c = point.cost
    return c.luts <= room.luts and c.dsps <= room.dsps and c.memories <= room.memories


def misses(point: Point, request: Request) -> dict[str, float]:
    """Constraint -> the factor by which the point misses it; only those that it misses."""
    c, room = point.cost, request.room
    pairs = {
        "--max-error": (point.candidate.error, request.bound.limit),
        "--max-latency": (c.microseconds, request.latency),
        "--max-luts": (c.luts, room.luts),
        "--max-dsps": (c.dsps, room.dsps),
        "--max-memories": (c.memories, room.memories),
    }
    return {name: value / limit if limit else math.inf for name, (value, limit) in pairs.items() if value > limit}


def _smallest(met: Sequence[Point], request: Request) -> Point | None:
    """The smallest whose clocks, counted as it is written, still meet the request."""
    for p in sorted(met, key=lambda p: _rank(p, request)):
        clocks = clocks_of(p.candidate.program, p.architecture, p.design, exact=True)
        exact = replace(p, cost=replace(p.cost, clocks=clocks))
        if not misses(exact, request):
            return exact
    return None


def _rank(p: Point, request: Request) -> tuple:
    """The smallest first; of equal ones the more accurate, then the faster."""
    return p.area(request.whole), p.candidate.error, p.cost.microseconds, p.architecture, str(p.design)


def pareto(points: Sequence[Point]) -> list[Point]:
    """The points that no more accurate one beats or equals in LUTs and in microseconds."""
    keys = [(p.candidate.error, p.cost.luts, p.cost.microseconds, p.cost.dsps, p.cost.memories) for p in points]
    order = sorted(range(len(points)), key=lambda n: keys[n])
    kept: list[int] = []
    best = np.empty((0, 2))
    for n in order:
        luts, microseconds = keys[n][1:3]
        if not ((best[:, 0] <= ALIKE * luts) & (best[:, 1] <= ALIKE * microseconds)).any():
            kept.append(n)
            best = np.vstack([best, [luts, microseconds]])
    return [points[n] for n in kept]


def _binding(points: Sequence[Point], request: Request) -> str:
    """Which constraint no design meets with the others, and what is nearest."""
    if not points:
        raise InputError("no format holds the ranges of the network; allow other widths")
    missed = [(misses(p, request), p) for p in points]
    lone = [(next(iter(m.items())), p) for m, p in missed if len(m) == 1]
    says = []
    for name in dict.fromkeys(n for (n, _), _ in lone):
        (_, factor), p = min(((m, p) for m, p in lone if m[0] == name), key=lambda f: (f[0][1], _rank(f[1], request)))
        says.append((factor, f"{name} binds: with {needs(p, name, request)} all else is met, by {told(p, request)}"))
    if says:
        return "; ".join(text for _, text in sorted(says))
    found, p = min(missed, key=lambda f: (sum(map(math.log2, f[0].values())), _rank(f[1], request)))
    return f"{' and '.join(found)} bind together; nearest is {told(p, request)}"


def needs(p: Point, name: str, request: Request) -> str:
    """What a constraint would have to allow for this point."""
    c = p.cost
    return {
        "--max-error": request.bound.text(p.candidate.error),
        "--max-latency": f"{c.microseconds:.3g} us",
        "--max-luts": f"{c.luts} LUTs",
        "--max-dsps": f"{c.dsps} DSPs",
        "--max-memories": f"{c.memories:g} blocks of memory",
    }[name]


def told(p: Point, request: Request) -> str:
    """A point in a line of words."""
    c = p.cost
    how = f", {p.design.multipliers} multiplier{'s' * (p.design.multipliers > 1)}" if p.architecture == "folded" else ""
    how += ", tables in LUTs" if p.design.memory is Memory.LOGIC else ""
    return (
        f"{p.architecture}{how}: {c.luts} LUTs, {c.dsps} DSPs, {c.memories:g} memories, {c.clocks} clocks, "
        f"{c.microseconds:.3g} us, error {request.bound.text(p.candidate.error)}"
    )
