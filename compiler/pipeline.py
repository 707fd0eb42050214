"""From a trained network to an integer program: the whole list of passes, each checked before and after."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greygate.compiler.centre import centre_biases
from greygate.compiler.meaning import prove, use_meanings
from greygate.compiler.prune import Round, output_errors, prune_by_entropy
from greygate.compiler.quantize import Formats, quantize
from greygate.compiler.ranges import Range, ranges
from greygate.compiler.simplify import SIMPLIFICATIONS, merge_linear, multiplications, parameter_count
from greygate.emulator.engine import run
from greygate.emulator.program import Fix, Program
from greygate.errors import InputError
from greygate.models.arithmetic import mean
from greygate.models.network import Network
from greygate.models.training.problem import Problem, Record

SAME = 1e-9  # largest relative change of any output that a simplification may cause
WIDTHS = range(8, 33)
EXACT = 1e-9  # error of float, relative to the signal, below which it has none


@dataclass(frozen=True)
class Pass:
    """What one pass left: layers, parameters, multiplications; and the largest relative change of an output.

    remarks: what it has to say of single modules.
    """

    name: str
    layers: int
    parameters: int
    multiplications: int
    change: float
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
    prune: Callable[[Network], tuple[Network, list[Round]]] | None = None,
    generic: bool = False,
    meanings: bool = True,
    period: float = 1e-3,
) -> Compiled:
    """Put logic for library networks, simplify, prune, range and quantize a network.

    records: scenarios {name: Record}; every simplification is checked on all of them. ranged_on: those whose ranges
    set the formats (the first, if none is given). budget: instead of a width, the largest factor by which fixed point
    may raise the RMS error on each of `ranged_on`, 1.05 for five per cent. prune: see `entropy_pruning`. generic:
    merge linear layers even where that costs multiplications. meanings: let library networks become the logic that they
    stand for (`meaning.py`), else keep their tanh form. period: s, of a step. Raises InputError without a record, for
    a network that diverges on one, and for formats that cannot hold the ranges.

    >>> compiled = compile(lag, {"train": record}, Formats(18))
    >>> [p.name for p in compiled.passes][:2]
    ['as declared', 'use_meanings']
    """
    if not records:
        raise InputError(f"network {network.name}: no record to compile on; ranges come from one")
    refused: dict[str, str] = {}
    while True:  # what the finished program does not bear out is done again without
        compiled, more = _compile(
            network, records, formats, ranged_on, budget, prune, generic, meanings, period, refused
        )
        if not more:
            return compiled
        refused |= more


def _compile(
    network, records, formats, ranged_on, budget, prune, generic, meanings, period, refused
) -> tuple[Compiled, dict[str, str]]:
    """One attempt, and the modules whose exact form it does not bear out, with a remark each."""
    training = [records[name] for name in ranged_on or list(records)[:1]]
    before = network.flatten()
    passes = [_summary("as declared", before, 0.0)]
    reference = _outputs(before, records)
    replaced, remarks = {}, {}
    if meanings:
        network, replaced, remarks = use_meanings(network, list(records.values()), refused)
        logic = _outputs(network, records)
        passes.append(_summary("use_meanings", network, _change(reference, logic)))
        reference = logic
    for rewrite in SIMPLIFICATIONS:
        network = merge_linear(network, always=generic) if rewrite is merge_linear else rewrite(network)
        change = _change(reference, _outputs(network, records))
        if change > SAME:
            raise AssertionError(f"{rewrite.__name__} changed the outputs of {network.name} by {change:.3g}")
        passes.append(_summary(rewrite.__name__, network, change))
    rounds: list[Round] = []
    if prune:
        network, rounds = prune(network)
        passes.append(_summary("prune", network, _change(reference, _outputs(network, records))))
    found = ranges(network, training)
    if budget is None:
        program = quantize_centred(network, found, training, formats or Formats(), period)
    else:
        program = meet_budget(network, found, training, budget, formats or Formats(), period)
    proved, refused = prove(program, network, replaced)
    if meanings:
        told = [f"{path or network.name} {why}" for path, why in sorted((remarks | proved).items())]
        passes[1] = replace(passes[1], remarks=tuple(told))
    return Compiled(network, found, program, tuple(passes), tuple(rounds)), refused


def entropy_pruning(
    records: Sequence[Record], retrain: Callable[[Network], Network], allowed: float, held: Sequence[Record] = ()
) -> Callable[[Network], tuple[Network, list[Round]]]:
    """A pruning pass for `compile_network`. allowed: factor by which the RMS error of each output over the held-out
    records may rise, or over `records` if none are held out."""

    def prune(network: Network) -> tuple[Network, list[Round]]:
        error = output_errors(network, list(held or records))
        return prune_by_entropy(network, list(records), retrain, allowed * error, held=held)

    return prune


def fixed_error(program: Program, record: Record) -> dict[str, np.ndarray]:
    """Fixed-point prediction less target, by output, in physical units, (N,) or (N, size)."""
    decoded = program.decode(run(program, program.encode(record.inputs), states=False).outputs)
    return {p.name: decoded[p.name] - np.asarray(record.targets[p.name]) for p in program.outputs}


def float_error(network: Network, record: Record) -> dict[str, np.ndarray]:
    """Float prediction less target, by output, in physical units, (N,) or (N, size)."""
    problem = Problem(network, [record])
    errors = problem.errors(problem.theta)
    if errors is None:
        raise InputError(f"network {network.name}: diverges on the record")
    ends = np.cumsum([p.size for p in problem.flat.outputs])[:-1]
    parts = zip(problem.flat.outputs, np.split(errors[0], ends, axis=1), strict=True)
    return {p.name: (e if p.size > 1 else e[:, 0]) * p.scale for p, e in parts}


def strain(program: Program, network: Network, records: Sequence[Record]) -> float:
    """RMS error of fixed point over that of float, the worst of all outputs and records."""
    return max(
        _rms(fixed_error(program, r)[n], r) / max(_rms(e, r), 1e-300)
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
            if _rms(error, r) <= EXACT * float(np.std(r.targets[name])):
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
    for name in sorted(margin, key=margin.get):
        while program.signals[name].fix.width > 4:
            trial = build(width, chosen | {name: _less(program.signals[name].fix)})
            if trial is None or not meets(trial):
                break
            chosen[name] = trial.signals[name].fix
            program = trial
    return program


def _less(fix: Fix) -> Fix:
    return Fix(fix.width - 1, fix.frac - 1)


def _rms(error: np.ndarray, record: Record) -> float:
    return math.sqrt(float(mean(error[record.skip :].ravel() ** 2)))


def _summary(name: str, network: Network, change: float) -> Pass:
    return Pass(name, len(network.flatten().modules), parameter_count(network), multiplications(network), change)


def _outputs(network: Network, records: Mapping[str, Record]) -> dict[str, np.ndarray]:
    found = {}
    for name, record in records.items():
        problem = Problem(network, [record])
        runs = problem.simulate(problem.theta)
        if runs is None:
            raise InputError(f"network {network.name}: diverges on scenario {name}; train it before compiling")
        feeds = problem.flat.feeds()
        columns = np.concatenate([problem.elements()[feeds[p.name][0]] for p in problem.flat.outputs])
        found[name] = runs[0][:, columns].copy()
    return found


def _change(reference: dict[str, np.ndarray], now: dict[str, np.ndarray]) -> float:
    return max(float(np.abs(now[n] - v).max() / np.abs(v).max()) for n, v in reference.items())
