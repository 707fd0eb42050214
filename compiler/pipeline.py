"""From a trained network to an integer program: all passes in order, each checked before and after."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from greygate.compiler.centre import centre_biases
from greygate.compiler.declared import declared_program
from greygate.compiler.meaning import Replaced, prove, use_meanings
from greygate.compiler.quantize import Formats, quantize
from greygate.compiler.ranges import Range, ranges
from greygate.emulator.engine import run
from greygate.emulator.numbers import Fix, Overflow
from greygate.emulator.program import Affine, Operation, Program, Select, Threshold
from greygate.errors import InputError
from greygate.models import sampling
from greygate.models.accuracy import float_error, pooled_rms, portable_rms
from greygate.models.importers.qonnx import Quantized
from greygate.models.network import Network
from greygate.models.prune import Pruning, Round, prune_by_entropy
from greygate.models.simplify import SIMPLIFICATIONS, merge_linear, multiplications, parameter_count
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record
from greygate.plain import Count, Figure

PERIOD = 1e-3  # s, of a step, where neither the caller nor the network says it
SAME = 1e-9  # largest relative change of any output that a simplification may cause
WIDTHS = range(8, 33)
ROUNDING = 2.0**-50  # of a parameter: a few units in its last place
ROUNDED = 100.0  # times what that changes: a rewrite rounds anew in every step
EXACT = 1e-9  # error of float, relative to the signal, below which it has none
FINER = "give more bits (--width)"
BOUND = ", or a largest error (--max-error 1.05x)"  # where float errs
COARSE = 1 / 32  # of an output's range: beyond it, fixed point has fewer than five bits of it right, which a plot shows
WASTED = 2**-8  # of a word's span: recorded values that need less leave eight bits unused
FLIPS = 0.1  # of the samples: in fewer it is no width that lacks, where a comparison tips


@dataclass(frozen=True)
class Pass:
    """What one pass left: layers, parameters, multiplications; and the largest relative change of an output.

    remarks: sentences on single modules and outputs.
    """

    name: str
    layers: Count
    parameters: Count
    multiplications: Count
    change: Figure
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Compiled:
    """The generic network, its ranges, the program, and how it came about."""

    network: Network
    ranges: dict[str, Range]
    program: Program
    passes: tuple[Pass, ...]
    pruning: tuple[Round, ...] = ()


def compile_network(
    network: Network,
    records: Mapping[str, Record],
    formats: Formats | None = None,
    *,
    ranged_on: Sequence[str] = (),
    budget: float | None = None,
    prune: Pruning | None = None,
    generic: bool = False,
    meanings: bool = True,
    choose: Callable[[Network, Mapping[str, Range]], Program] | None = None,
    period: float | None = None,
) -> Compiled:
    """Put logic for library networks, simplify, prune, range and quantize a network.

    records: scenarios {name: Record}; every simplification is checked on all of them. ranged_on: those whose ranges
    set the formats (the first, if none is given). budget: instead of a width, the largest factor by which fixed point
    may raise the RMS error on each of `ranged_on`, 1.05 for five per cent. prune: see `entropy_pruning`. generic:
    merge linear layers even where that costs multiplications. meanings: let library networks become the logic that they
    stand for (`meaning.py`), else keep their tanh form. choose: instead of formats and a budget, what makes the program
    of the simplified network and its ranges. period: s, of a step; the network's own if not given. Raises InputError
    without a record, for a network that diverges on one or has another sample time, and for formats that cannot hold
    the ranges.

    >>> compiled = compile(lag, {"train": record}, Formats(18))
    >>> [p.name for p in compiled.passes][:2]
    ['as declared', 'use_meanings']
    """
    if not records:
        raise InputError(f"network {network.name}: no record to compile on; ranges come from one")
    period = period or network.sample_time() or PERIOD
    sampling.check(network, period, f"period {period:g}", "resample the records")
    training, formats = [records[name] for name in ranged_on or list(records)[:1]], formats or Formats()
    refused: dict[str, str] = {}  # path -> remark of modules whose exact form a finished program did not bear out
    while True:
        passes = _Passes(network, records)
        small, replaced, remarks = passes.with_meanings(refused) if meanings else (network, {}, {})
        small = passes.simplified(small, generic)
        small, rounds = passes.pruned(small, prune) if prune else (small, [])
        found = ranges(small, training)
        if choose is not None:
            program = choose(small, found)
        elif budget is None:
            program = quantize_centred(small, found, training, formats, period)
        else:
            program = meet_budget(small, found, training, budget, formats, period)
        proved, more = prove(program, small, replaced)
        if more:
            refused |= more
            continue
        if meanings:
            passes.remark("use_meanings", remarks | proved)
        passes.remark(passes.done[-1].name, wasted(program, training) | coarse(program, small, records))
        return Compiled(small, found, program, tuple(passes.done), tuple(rounds))


def compile_declared(
    quantized: Quantized, records: Mapping[str, Record], ranged_on: Sequence[str], period: float
) -> Compiled:
    """The program of a network whose signals have declared formats; its ranges, for reports, on `ranged_on`.

    Raises InputError as `declared_program`.
    """
    flat, ranged = quantized.network.flatten(), [records[name] for name in ranged_on]
    found = ranges(flat, ranged)
    reach = {p.name: max(float(np.abs(r.inputs[p.name]).max()) for r in ranged) for p in flat.inputs}
    program = declared_program(quantized, period, reach)
    return Compiled(flat, found, program, (_summary("as declared", flat, 0.0),))


class _Passes:
    """The passes of one attempt on `network`, each noted with what it left and what it changed on the records."""

    def __init__(self, network: Network, records: Mapping[str, Record]):
        self.network, self.records = network, records
        self.reference = _outputs(network.flatten(), records)
        self.done = [_summary("as declared", network.flatten(), 0.0)]

    def _note(self, name: str, network: Network) -> dict[str, np.ndarray]:
        """Note what a pass left; returns the outputs now."""
        now = _outputs(network, self.records)
        change = max(float(parted(now[n], v)[-1]) for n, v in self.reference.items())
        self.done.append(_summary(name, network, change))
        return now

    def with_meanings(self, refused: Mapping[str, str]) -> tuple[Network, dict[str, Replaced], dict[str, str]]:
        """As `use_meanings`; what follows is compared with the logic."""
        network, replaced, remarks = use_meanings(self.network, list(self.records.values()), refused)
        self.reference = self._note("use_meanings", network)
        return network, replaced, remarks

    def simplified(self, network: Network, generic: bool) -> Network:
        """The generic network, checked after every simplification to compute the same."""
        for rewrite in SIMPLIFICATIONS:
            network = merge_linear(network, always=generic) if rewrite is merge_linear else rewrite(network)
            self._note(rewrite.__name__, network)
            if (change := self.done[-1].change) > SAME and not self._rounded(network):
                raise AssertionError(f"{rewrite.__name__} changed the outputs of {network.name} by {change:.3g}")
        return network

    def _rounded(self, network: Network) -> bool:
        """Whether up to each sample a network leaves its reference by little more than what rounding alone does.

        That grows along a run of a network whose runs part; a wrong rewrite shows before.
        """
        now = _outputs(network, self.records)
        return all(
            bool((parted(now[n], v) <= np.maximum(SAME, ROUNDED * self._of_rounding[n])).all())
            for n, v in self.reference.items()
        )

    @cached_property
    def _of_rounding(self) -> dict[str, np.ndarray]:
        flat = self.network.flatten()
        rounded = flat.with_parameters({name: value * (1.0 + ROUNDING) for name, value in flat.parameters().items()})
        before = _outputs(flat, self.records)
        return {n: parted(v, before[n]) for n, v in _outputs(rounded, self.records).items()}

    def pruned(self, network: Network, prune: Pruning) -> tuple[Network, list[Round]]:
        network, rounds = prune(network)
        self._note("prune", network)
        return network, rounds

    def remark(self, name: str, remarks: Mapping[str, str]) -> None:
        """Add remarks on modules and outputs, by path, to the pass of that name."""
        told = tuple(f"{path or self.network.name} {why}" for path, why in sorted(remarks.items()))
        self.done = [replace(p, remarks=(*p.remarks, *told)) if p.name == name else p for p in self.done]


def entropy_pruning(
    records: Sequence[Record], retrain: Callable[[Network], Network], allowed: float, held: Sequence[Record] = ()
) -> Pruning:
    """A pruning pass for `compile_network`. allowed: factor by which the RMS error of each output over the held-out
    records may rise, or over `records` if none are held out."""

    def prune(network: Network) -> tuple[Network, list[Round]]:
        error = pooled_rms(network, list(held or records))
        return prune_by_entropy(network, list(records), retrain, allowed * error, held=held)

    return prune


def parted(now: np.ndarray, before: np.ndarray) -> np.ndarray:
    """By how much outputs (samples, elements) have parted up to each sample, over their size (samples,)."""
    size = float(np.abs(before).max()) or 1.0  # 1.0 of what is always 0
    return np.maximum.accumulate(np.abs(now - before).max(axis=1)) / size


def fixed_error(program: Program, record: Record) -> dict[str, np.ndarray]:
    """Fixed-point prediction less target, by output, in physical units, (N,) or (N, size)."""
    decoded = program.decode(run(program, program.encode(record.inputs), states=False).outputs)
    return {p.name: decoded[p.name] - np.asarray(record.targets[p.name]) for p in program.outputs}


def wasted(program: Program, records: Sequence[Record]) -> dict[str, str]:
    """Input -> a remark, where its recorded values stand still or need but a small part of their word."""
    found = {}
    for port in program.inputs:
        values = np.concatenate([np.ravel(r.inputs[port.name]) for r in records])
        span, middle = float(np.ptp(values)), float(values.min() + values.max()) / 2
        steps, enough = span / abs(port.signal.fix.lsb * port.scale), WASTED * 2**port.signal.fix.width
        if not span:
            found[port.name] = (
                f"is {middle:g} in every sample: its format is a guess; give a recording in which it moves"
            )
        elif steps < enough:
            found[port.name] = (
                f"moves by {span:.3g} about {middle:.6g}, {steps:.2g} steps of its word: read it without that offset, "
                f"or give {math.ceil(math.log2(enough / steps))} bits more (--width)"
            )
    return found


def coarse(program: Program, network: Network, records: Mapping[str, Record]) -> dict[str, str]:
    """Output -> a remark, where fixed point differs from float by more than COARSE of its range on a record."""
    worst: dict[str, tuple[float, str, str]] = {}
    for scenario, record in records.items():
        floating, fixed = float_error(network, record), fixed_error(program, record)
        for name, error in fixed.items():
            answers = (np.asarray(record.targets[name]) + floating[name])[record.skip :]
            apart, span = np.abs(error - floating[name])[record.skip :], np.ptp(answers)
            share = float(apart.max() / span) if span > EXACT * np.abs(answers).max() else 0.0
            off = int(np.sum(apart.reshape(len(apart), -1).max(axis=1) > COARSE * span))
            few = f", in {off} of {len(apart)} samples" if off <= FLIPS * len(apart) else ""
            finer = FINER + (BOUND if np.abs(floating[name]).max() > EXACT * span else "")
            tips = "a comparison or an angle tips there, or " if few and any(map(_jumps, program.operations)) else ""
            why = beyond(program, {scenario: record}) or tips + finer
            worst[name] = max(worst.get(name, (COARSE, "", "")), (share, scenario, f"{few}: {why}"))
    return {
        name: f"differs from float by up to {share:.0%} of its range on {scenario}{why}"
        for name, (share, scenario, why) in worst.items()
        if scenario
    }


def _jumps(operation: Operation) -> bool:
    """Whether a step of its argument may change its answer by more than a step."""
    wraps = isinstance(operation, Affine) and operation.overflow is Overflow.WRAP
    return wraps or isinstance(operation, Threshold | Select)


def beyond(program: Program, records: Mapping[str, Record]) -> str:
    """The input that leaves what its word holds in the most samples of a record, and what to do; "" if none does."""
    steps = {p.name: abs(p.signal.fix.lsb * p.scale) for p in program.inputs}  # by less, a range ends
    clipped = {
        (name, n): c
        for name, r in records.items()
        for n, c in program.clipped(r.inputs).items()
        if c.given[0] < c.holds[0] - steps[n] or c.given[1] > c.holds[1] + steps[n]
    }
    if not clipped:
        return ""
    scenario, name = max(clipped, key=lambda where: clipped[where].share)
    found = clipped[scenario, name]
    held, given = (f"{low:.6g} to {high:.6g}" for low, high in (found.holds, found.given))
    return (
        f"{name} is {given} on {scenario}, its word holds {held}; let a recording with such values set the ranges, "
        "or leave this one out"
    )


def strain(program: Program, network: Network, records: Sequence[Record]) -> float:
    """RMS error of fixed point over that of float, the worst of all outputs and records."""
    return max(
        portable_rms(fixed_error(program, r)[n], r.skip) / max(portable_rms(e, r.skip), 1e-300)
        for r in records
        for n, e in float_error(network, r).items()
    )


def quantize_centred(
    network: Network, found: Mapping[str, Range], records: Sequence[Record], formats: Formats, period: float
) -> Program:
    """Quantize, and correct the biases if that lowers the worst error on the records."""
    plain = quantize(network, found, formats, period)
    centred = centre_biases(plain, network, records)
    return min((plain, centred), key=lambda program: strain(program, network, records))


def meet_budget(
    network: Network,
    found: Mapping[str, Range],
    records: Sequence[Record],
    budget: float,
    formats: Formats,
    period: float,
) -> Program:
    """The cheapest program whose RMS error is at most `budget` times that of float, at every output on every record.

    First the least word width that meets it; then signals give up fraction bits, the least sensitive first: sensitivity
    is the error that one bit less of that signal alone adds, measured on the records.
    """

    def meets(program: Program) -> bool:
        return strain(program, network, records) <= budget

    def build(width: int, signals: Mapping[str, Fix]) -> Program | None:
        try:
            return quantize_centred(network, found, records, replace(formats, width=width, signals=signals), period)
        except InputError:
            return None

    for r in records:
        for name, error in float_error(network, r).items():
            if portable_rms(error, r.skip) <= EXACT * float(np.std(r.targets[name])):
                raise InputError(
                    f"output {name}: float repeats the record exactly, so a budget means nothing; use --width"
                )
    for width in WIDTHS:
        program = build(width, formats.signals)
        if program and meets(program):
            break
    else:
        raise InputError(f"budget {budget}: not met with {WIDTHS[-1]} bits; allow more, or train longer")
    chosen = dict(formats.signals)
    inputs = {p.signal.name for p in program.inputs}
    names = [o.out.name for o in program.operations if not o.out.name.endswith(".view") and o.out.name not in inputs]
    margin = {}
    for name in names:
        narrower = build(width, chosen | {name: _less(program.signals[name].fix)})
        if narrower:
            margin[name] = strain(narrower, network, records)
    for name in sorted(margin, key=margin.__getitem__):
        while program.signals[name].fix.width > 4:
            trial = build(width, chosen | {name: _less(program.signals[name].fix)})
            if trial is None or not meets(trial):
                break
            chosen[name] = trial.signals[name].fix
            program = trial
    return program


def _less(fix: Fix) -> Fix:
    return Fix(fix.width - 1, fix.frac - 1)


def _summary(name: str, network: Network, change: float) -> Pass:
    return Pass(name, len(network.flatten().modules), parameter_count(network), multiplications(network), change)


def _outputs(network: Network, records: Mapping[str, Record]) -> dict[str, np.ndarray]:
    found = {}
    for name, record in records.items():
        objective = Objective(network, [record])
        runs = objective.simulate(objective.theta)
        if runs is None:
            raise InputError(f"network {network.name}: diverges on scenario {name}; train it before compiling")
        feeds = objective.flat.feeds()
        columns = np.concatenate([objective.elements()[feeds[p.name][0]] for p in objective.flat.outputs])
        found[name] = runs[0][:, columns].copy()
    return found
