"""A request such as `--target up5k --max-error 0.2bar`, and what answers it while a network is compiled."""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from greygate import children
from greygate.compiler.centre import centre_biases
from greygate.compiler.explore import Exploration, Point, Request, Room, Unmet, explore, told
from greygate.compiler.explore.judge import Bound, Judge, Scale
from greygate.compiler.explore.trail import Maker
from greygate.compiler.pipeline import beyond
from greygate.compiler.quantize import Formats
from greygate.compiler.ranges import Range
from greygate.compiler.study import Costed, Explored
from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.hardware.families import DEVICES
from greygate.models.network import Network
from greygate.models.training.record import Record
from greygate.plain import plain
from greygate.plants.units.reading import factor
from greygate.progress import Progress, silent

FILLED = 0.9  # part of the LUTs of a device that place and route can fill
MEASURE = re.compile(r"\s*([+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*(.*?)\s*")


def measured(text: str, option: str, wish: str) -> tuple[float, str]:
    """A number above 0 and what stands behind it. Raises InputError naming the option."""
    found = MEASURE.fullmatch(text)
    try:
        value = float(found[1]) if found else 0.0
    except ValueError:
        value = 0.0
    if not found or not 0 < value < math.inf:
        raise InputError(f"{option} {text}: give {wish}")
    return value, found[2]


def bounded(text: str | None, units: Mapping[str, str]) -> Bound:
    """The bound that --max-error gives: 0.5% of the range of each output, 0.2bar, or 1.05x the error of float.

    units: of each output. A unit bounds the outputs that have a unit of its kind.
    """
    if text is None:
        return Bound()
    wish = "per cent of an output's range (0.5%), a unit of one (0.2bar), or times float's error (1.05x)"
    value, unit = measured(text, "--max-error", wish)
    if unit in ("%", "x"):
        return Bound(value, Scale(unit))
    factors = {n: f for n, own in units.items() if (f := factor(own or "1", unit or "1")) is not None}
    if not factors:
        raise InputError(f"--max-error {text}: no output has a unit of that kind, but {', '.join(units.values())}")
    return Bound(value, Scale.UNIT, unit, factors)


def microseconds(text: str | None) -> float:
    """The time that --max-latency gives, such as 2us; inf if it is not given."""
    if text is None:
        return math.inf
    value, unit = measured(text, "--max-latency", "a time such as 2us")
    factor = {"s": 1e6, "ms": 1e3, "us": 1.0, "µs": 1.0, "ns": 1e-3}.get(unit)
    if factor is None:
        raise InputError(f"--max-latency {text}: give a time in s, ms, us or ns")
    return value * factor


def requested(
    device: str,
    units: Mapping[str, str],
    error: str | None = None,
    latency: str | None = None,
    luts: int | None = None,
    dsps: int | None = None,
    memories: float | None = None,
    **tried,
) -> Request:
    """The request that the options of the command line make. tried: of `Request`. Raises InputError."""
    if device not in DEVICES:
        *others, last = DEVICES
        raise InputError(f"--target {device}: cannot be explored; choose {', '.join(others)} or {last}")
    chip = DEVICES[device]
    whole = Room(math.floor(FILLED * chip.luts), chip.dsps, chip.block_rams)
    asked = (luts, dsps, memories)
    room = Room(*(most if less is None else min(less, most) for less, most in zip(asked, _limits(whole), strict=True)))
    return Request(device, chip.family, whole, room, bounded(error, units), microseconds(latency), **tried)


def _limits(room: Room) -> tuple[float, float, float]:
    return room.luts, room.dsps, room.memories


@dataclass
class Explorer:
    """Chooses a program, an architecture and a design while a network is compiled; `found` tells of it afterwards.

    training: scenarios on which weights are rounded; the first if none is given.
    """

    request: Request
    mapper: Callable[[Callable, Iterable], Iterable] = map
    progress: Progress = silent
    training: Sequence[str] = ()
    found: Exploration | None = field(default=None, init=False)

    def choose(
        self, records: Mapping[str, Record], period: float, network: Network, ranges: Mapping[str, Range]
    ) -> Program:
        """The program of the smallest design that meets the request, measured on all records. Raises Unmet."""
        judge = Judge(network, records, self.request.bound)
        judge.allowed  # noqa: B018 - a bound that means nothing is told before the work
        training = [records[name] for name in self.training or list(records)[:1]]
        make = Maker(network, ranges, judge, period, training)
        self.found = explore(make, self.request, self.mapper, self.progress)
        if self.found.chosen is None:
            usual = make(Formats())
            if usual and (beside := beyond(usual.program, records)):
                self.found = replace(self.found, why=f"{self.found.why}; {beside}")
            raise Unmet(self.found)
        plain = self.found.chosen.candidate.program
        centred = centre_biases(plain, network, list(records.values()))
        return min((plain, centred), key=judge.error)

    @property
    def point(self) -> Point:
        assert self.found is not None, "it has explored"
        assert self.found.chosen is not None, "it has chosen"
        return self.found.chosen

    @property
    def lines(self) -> list[str]:
        """What a person reads of the exploration."""
        return lines(self.found) if self.found else []

    @property
    def facts(self) -> Explored:
        """What compile.json and --json tell of the exploration."""
        assert self.found, "it has explored"
        return facts(self.found)


def facts(found: Exploration) -> Explored:
    """An exploration as plain data."""
    request = found.request
    limits = {"error": request.bound.limit, "latency_us": request.latency}
    limits |= dict(zip(("luts", "dsps", "memories"), _limits(request.room), strict=True))
    content: Explored = {
        "device": request.device,
        "family": request.family,
        "error_in": request.bound.unit if request.bound.scale is Scale.UNIT else str(request.bound.scale),
        "request": {name: value if math.isfinite(value) else None for name, value in limits.items()},
        "programs": found.programs,
        "points": found.points,
        "front": [_facts(p) for p in found.front],
        "chosen": None if found.chosen is None else _facts(found.chosen),
        "why": found.why,
    }
    return plain(content)


def lines(found: Exploration) -> list[str]:
    """The front as a table, and the answer to the request."""
    rows = [
        f"{p.architecture:9} {_how(p):14} {p.cost.luts:6} {p.cost.dsps:5} {p.cost.memories:8g} "
        f"{p.cost.microseconds:9.3f}  {found.request.bound.text(p.candidate.error)}"
        for p in found.front
    ]
    head = f"{'front':24} {'LUTs':>6} {'DSPs':>5} {'memories':>8} {'us':>9}  error"
    answer = f"smallest: {told(found.chosen, found.request)}" if found.chosen else found.why
    return [f"{found.programs} programs, {found.points} designs on {found.request.device}", head, *rows, answer]


def _how(p: Point) -> str:
    memory = "" if p.design.memory == "block" else " logic"
    return (f"x{p.design.multipliers}" if p.architecture == "folded" else f"{p.candidate.formats.width} bits") + memory


def _facts(p: Point) -> Costed:
    formats, cost = p.candidate.formats, p.cost
    return {
        "error": p.candidate.error,
        "luts": cost.luts,
        "dsps": cost.dsps,
        "memories": cost.memories,
        "clocks": cost.clocks,
        "period_ns": cost.period,
        "microseconds": cost.microseconds,
        "architecture": p.architecture,
        "design": p.design,
        "width": formats.width,
        "finer": formats.finer,
        "tables": str(formats.tables),
        "table_budget": formats.table_budget,
        "signals": {name: str(fix) for name, fix in formats.signals.items()},
        "weights": dict(formats.weights),
        "price": p.candidate.price,
    }


def side_by_side(jobs: int) -> Callable[[Callable, Iterable], Iterable]:
    """A `map` of that many processes, or of the cluster that joblib's configuration names."""
    if jobs == 1:
        return map
    return partial(_mapped, jobs)


def _mapped(jobs: int, function: Callable, items: Iterable) -> Iterable:
    for found in children.workers(jobs, [partial(function, item) for item in items]):
        if found is children.DIED:
            raise InputError(children.KILLED)
        yield found
