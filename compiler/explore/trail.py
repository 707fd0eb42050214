"""Programs of one network from fine to coarse: each signal and each sum gets a format of its own.

`trail` starts at one program and takes a bit away where that saves most for the error that it adds. The error of a bit
less is measured for each knob alone, in closed loop, and four times as much is expected of the next one; after each
step the program is measured again.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greygate.compiler.explore.judge import Judge, agreed
from greygate.compiler.quantize import Formats, quantize
from greygate.compiler.ranges import Range, ranges
from greygate.compiler.rounding import BITS, round_jointly
from greygate.emulator.numbers import Fix
from greygate.emulator.program import Affine, Lookup, Program
from greygate.errors import InputError
from greygate.models.network import Network
from greygate.models.training.record import Record

LEAST_WIDTH, LEAST_WEIGHT = 3, 3  # bits of a signal and of weights below which nothing is left of them
COARSEST = 40.0  # LSB of error that a table may have
SAMPLES, LONGER = 1500, 5000  # on which weights are rounded, of a network without memory, and of one with
STAGES = 16  # of joint rounding: more take longer, and the digits hardly fewer
KEPT = BITS + 2  # bits in which weights of few digits are kept: rounding moves some beyond the range they had
TABLES = "tables"  # the knob of all tables
NOISE = 1e-4  # of the error squared: what a bit is taken to add where its measure says that it adds nothing


@dataclass(frozen=True)
class Candidate:
    """A program, the formats that made it, and its error on the judge's scale.

    tuned: for which architecture, or "". price: as of its maker.
    """

    formats: Formats
    program: Program
    error: float
    tuned: str = ""
    price: float = 0.0


@dataclass(frozen=True)
class Maker:
    """Makes and measures programs of a simplified network. found: its ranges on `records`. period: s, of a step.

    price: at which its weights were rounded jointly, 0 if they were not.
    """

    network: Network
    found: Mapping[str, Range]
    judge: Judge
    period: float
    records: Sequence[Record] = ()
    price: float = 0.0

    def __call__(self, formats: Formats) -> Candidate | None:
        """None where the formats cannot hold the ranges."""
        try:
            program = quantize(self.network, self.found, formats, self.period)
        except InputError:
            return None
        return Candidate(formats, program, self.judge.error(program), price=self.price)


def without_memory(network: Network) -> bool:
    """Whether an output depends on the inputs of the same step alone."""
    return not any(c.delay for c in network.flatten().connections)


def thinned(network: Network, records: Sequence[Record]) -> list[Record]:
    """What weights are rounded on: evenly spread samples of a network without memory, else the begin of each record."""
    still = without_memory(network)
    most = max(1, (SAMPLES if still else LONGER) // max(1, len(records)))
    found = []
    for r in records:
        every = slice(None, None, -(-len(r) // most)) if still else slice(0, most)
        inputs, targets = ({n: np.asarray(v)[every] for n, v in part.items()} for part in (r.inputs, r.targets))
        found.append(replace(r, inputs=inputs, targets=targets, skip=0 if still else min(r.skip, most - 1)))
    return found


def with_few_digits(make: Maker, price: float) -> Maker | None:
    """A maker of the network with weights of few signed digits; None where rounding at that price leads astray."""
    try:
        network = round_jointly(make.network, thinned(make.network, make.records), price, stages=STAGES).network
        return replace(make, network=network, found=ranges(network, list(make.records)), price=price)
    except InputError:
        return None


def short_neurons(candidate: Candidate) -> Formats:
    """The formats in which the outputs of neurons have no bits beyond the word."""
    formats, signals = candidate.formats, candidate.program.signals
    outs = [o.out.name for o in candidate.program.operations if isinstance(o, Lookup)]
    less = {n: formats.width - f.width for n in outs if (f := signals[n].fix).width > formats.width}
    short = {n: Fix(formats.width, signals[n].fix.frac + bits) for n, bits in less.items()}
    return replace(formats, signals={**formats.signals, **short})


def knobs(program: Program, weights: bool = True) -> list[tuple[str, str]]:
    """(kind, name) of everything that can be made coarser by a step. weights: whether these can."""
    inputs = {p.signal.name for p in program.inputs}
    names = [n for n in program.signals if n in inputs] + [
        o.out.name for o in program.operations if not o.out.name.endswith(".view")
    ]
    sums = [o.out.name for o in program.operations if isinstance(o, Affine) and not o.out.name.endswith(".view")]
    tables = [("table", TABLES)] if program.tables else []
    return [("signal", n) for n in names] + [("weights", n) for n in sums if weights] + tables


def coarser(candidate: Candidate, knob: tuple[str, str]) -> Formats | None:
    """The formats with one knob a step coarser, None at its end."""
    formats, (kind, name) = candidate.formats, knob
    if kind == "signal":
        fix = candidate.program.signals[name].fix
        if fix.width <= LEAST_WIDTH:
            return None
        return replace(formats, signals={**formats.signals, name: Fix(fix.width - 1, fix.frac - 1)})
    if kind == "weights":
        bits = formats.weights.get(name, formats.width) - 1
        return replace(formats, weights={**formats.weights, name: bits}) if bits >= LEAST_WEIGHT else None
    budget = formats.table_budget * 2
    return replace(formats, table_budget=budget) if budget <= COARSEST else None


def trail(start: Candidate, make: Maker, price: Callable[[Program], float], end: float) -> Iterator[Candidate]:
    """Ever coarser candidates, the start first, until the error is above `end` or nothing can be taken away."""
    yield start
    here, adds, saves = start, {}, {}
    for knob in knobs(start.program, weights=not make.price):
        if (tried := _tried(here, knob, make)) is not None:
            adds[knob] = max(tried.error**2 - here.error**2, NOISE * here.error**2)
            saves[knob] = price(here.program) - price(tried.program)
    while adds and here.error <= end:
        knob = max(adds, key=lambda k: (_worth(saves[k], adds[k]), k))
        before, tried = here, _tried(here, knob, make)
        if tried is None or saves[knob] <= 0:
            del adds[knob]
            continue
        here = tried
        adds[knob] = 4 * max(here.error**2 - before.error**2, adds[knob] / 4)
        further = coarser(here, knob)
        if further is None:
            del adds[knob]
        else:
            saves[knob] = _saving(here, further, make, price)
        yield here


def _worth(saved: float, added: float) -> float:
    """What a step saves for the error that it adds, to digits on which every processor agrees."""
    return agreed(saved / added) if added > 0 else math.inf


def _tried(here: Candidate, knob: tuple[str, str], make: Maker) -> Candidate | None:
    formats = coarser(here, knob)
    return None if formats is None else make(formats)


def _saving(here: Candidate, further: Formats, make: Maker, price: Callable[[Program], float]) -> float:
    try:
        return price(here.program) - price(quantize(make.network, make.found, further, make.period))
    except InputError:
        return 0.0
