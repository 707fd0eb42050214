"""Models fitted to what a fold leaves to learn from, and judged on what it holds out."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import process_time

import numpy as np

from greygate.errors import InputError
from greygate.identify.clock import Clock, Deadline
from greygate.identify.ladder import (
    ARMAX,
    ARX,
    BJ,
    LINEAR,
    LOOP,
    RATE,
    SUBSPACE,
    Orders,
    calmed,
    falling,
    fed_back,
    grown,
    own,
)
from greygate.identify.linear import estimated, taught
from greygate.identify.states import pulled, states
from greygate.identify.study import Fold
from greygate.identify.subspace import subspace
from greygate.identify.task import Task, started
from greygate.identify.tried import Model, Tried
from greygate.models.accuracy import float_error
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import Outcome, Trained, train
from greygate.models.training.record import Record

ASIDE = 0.5  # deviations by which inputs stand beside what was recorded
STRAY = 3.0  # times what the recording and a linear model then fill, from which a network's run strays
FEWEST = 20  # samples, from which something may be fitted at all
LEAST = 0.1  # s that a training has, where its rung has just run out of time
WINDOWS = 2  # for each part, into which a fold is cut that is too long to be trained on whole
FULL = 2  # the first rung at which every fold judges
STILL = 1e-3  # fall of the loss over ten epochs from which a model that is only compared is done


@dataclass(frozen=True)
class Rung:
    """keep: models that enter it. seeds: starts for each. epochs: of each. samples: at most, of a fold to train on.

    every: 2 for every second fold. until: share of the time limit at which it must end. first: seed.
    """

    keep: int
    seeds: int
    epochs: int
    samples: int
    every: int
    until: float
    first: int = 0


def warm(task: Task, clock: Clock | None = None) -> None:
    """Load what trains networks, or compile it where that was never done here; note what that takes."""
    if clock:
        clock.note()
    record = next(iter(task.records.values()))
    model, pieces = Model(LINEAR, Orders(1, (0,) * len(task.inputs)), 0.0), [record.cut(0, FEWEST, skip=0)]
    start = taught(model.form.build(model.orders, task.inputs, task.output, 0), pieces).network
    trained(model, task, start, pieces, 1, math.inf)
    if clock:
        clock.note()


def judged(
    task: Task,
    folds: Mapping[int, Fold],
    model: Model,
    line: Tried | None,
    before: Tried | None,
    number: int,
    rung: Rung,
    until: Deadline,
) -> Tried | None:
    """The model, trained on the folds of a rung and judged; None if time is up before.

    line: what it is grown from. before: what the rung below has made of it.
    """
    began = process_time()
    if not until.left > 0:
        return None
    networks, errors = {}, {}
    fit: Trained | None
    for place, fold in folds.items():
        known = line.networks[place] if line else None
        if known is None or model.form.linear:
            fit = linear(task, model, known, fold.pieces, rung, until.left)
            if model.form == SUBSPACE and fit.outcome is Outcome.TIME:  # too short for it
                return None
        else:
            earlier = [before.networks[place]] if before and place in before.networks else []
            fit = network(task, model, known, earlier, fold.pieces, rung, until)
        if fit is None:
            return None
        networks[place] = fit.network
        errors[place] = [task.errors(networks[place], block) for block in fold.blocks]
    growing = [grows(model, n, task) for n in networks.values()]
    if most(growing) and model.form.loop_is_linear:
        errors = {place: [None] * len(of) for place, of in errors.items()}
    if until.clock:
        until.clock.note()
    safe = not (most if model.form.linear else any)(growing)  # a line is fitted anew to everything
    if safe and line and number >= FULL:
        safe = not any(strays(n, line.networks[place], task) for place, n in networks.items())
    return Tried(model, number, networks, errors, process_time() - began, safe)


def most(of: Iterable[bool]) -> bool:
    """Whether more than half are true."""
    found = list(of)
    return 2 * sum(found) > len(found)


def longest(task: Task) -> int:
    """Samples of the longest recording."""
    return max(len(r) for r in task.records.values())


def grows(model: Model, network: Network, task: Task) -> bool:
    """Whether the motions of its linear loop grow by e within the longest recording.

    Its neurons are bounded: where they are at their bounds, beyond what it was trained on, the linear loop alone acts.
    """
    return model.form.feedback and -longest(task) < falling(network, model.orders, task.output) < 0


def strays(network: Network, line: Network | None, task: Task) -> bool:
    """Whether a run leaves what the recording and a linear model fill, where the inputs stand beside what they were.

    Held-out blocks of the same day do not show it: a loop of neurons that stands still about there may run off. A plant
    may, too, as a mass does over its top: so another network is only preferred.
    """
    return line is not None and any(
        not _reach(network, r, task.output, aside) <= STRAY * _reach(line, r, task.output, aside)
        for r in task.records.values()
        for aside in (-ASIDE, ASIDE)
    )


@np.errstate(over="ignore", invalid="ignore")  # a run may diverge
def distances(task: Task, networks: Sequence[Network], aside: float, louder: float) -> np.ndarray:
    """RMS distance of their free runs from the median of these, in the output's unit (networks,); inf: diverges.

    Of runs that go further than what was recorded, so much less. aside: deviations by which the inputs stand beside
    what was recorded. louder: how many times as far from their mean they go.
    """
    squares, count, far = np.zeros(len(networks)), 0, 1.0
    for record in task.records.values():
        inputs = {n: u.mean() + louder * (u - u.mean()) + aside * u.std() for n, u in record.inputs.items()}
        measured = record.targets[task.output.name][task.settle :]
        runs = np.array([_rested(task, n, replace(record, inputs=inputs)) for n in networks]) + measured
        middle = np.median(runs, axis=0)
        squares += np.nan_to_num(np.sum((runs - middle) ** 2, axis=1), nan=np.inf)
        count, far = count + len(measured), max(far, float(np.nan_to_num(np.std(middle) / np.std(measured), nan=1.0)))
    return np.sqrt(squares / count) / far


def _rested(task: Task, network: Network, record: Record) -> np.ndarray:
    """Errors of a free run from where it rests, for no first samples of it were measured; inf where it diverges."""
    try:
        return float_error(network, record)[task.output.name][task.settle :]
    except InputError:
        return np.full(len(record) - task.settle, np.inf)


def _reach(network: Network, record: Record, output: Port, aside: float) -> float:
    """How far a run with inputs so many deviations aside goes, or the recording does; inf where the run diverges."""
    inputs = {p.name: record.inputs[p.name] + aside * np.std(record.inputs[p.name]) for p in network.inputs}
    target = record.targets[output.name]
    try:
        error = float_error(network, replace(record, inputs=inputs))[output.name]
    except InputError:
        return np.inf
    return max(float(np.abs(output.normalised(y)).max()) for y in (target + error, target))


def linear(
    task: Task, model: Model, line: Network | None, pieces: Sequence[Record], rung: Rung, seconds: float
) -> Trained:
    """The linear model under its idea of the noise. line: the output-error model of the same taps, if there is one.

    An output-error model begins as the better one of ARX and of the subspace.
    """
    if line is None and model.orders.integrating:
        start = summed(model, task, pieces)
    else:
        start = line or begun(model, task, pieces)
    return refitted(model, task, start, pieces, rung.epochs, seconds) if rung.epochs else as_it_is(start, pieces)


def begun(model: Model, task: Task, pieces: Sequence[Record]) -> Network:
    """The linear model as ARX, or by the subspace where that runs free better."""
    start = taught(model.form.build(model.orders, task.inputs, task.output, 0), pieces).network
    if model.form != LINEAR or model.orders.stride > 1:
        return start
    ways = [start, subspace(model.orders, task.output, start, pieces)]
    return lowest([as_it_is(way, pieces) for way in ways if way]).network


def summed(model: Model, task: Task, pieces: Sequence[Record]) -> Network:
    """The integrating model: its rate begins as a model of the output's differences."""
    steps = replace(task.output, scale=task.output.scale * model.orders.step, offset=0.0, initial=0.0)
    of = replace(model, orders=replace(model.orders, step=0.0))
    found = begun(of, replace(task, output=steps), [differences(p, steps) for p in pieces]).parameters()
    network = model.form.build(model.orders, task.inputs, task.output, 0)
    taken = [p.name for p in (*task.inputs, task.output)]
    loop, rate = own(LOOP, taken), own(RATE, taken)
    return network.with_parameters({rate + n.removeprefix(loop): v for n, v in found.items()})


def differences(record: Record, output: Port) -> Record:
    """The record from its second sample on, of the output's difference from one sample to the next."""
    inputs = {n: v[1:] for n, v in record.inputs.items()}
    return started(Record(inputs, {output.name: np.diff(record.targets[output.name])}), output)


def refitted(
    model: Model,
    task: Task,
    start: Network,
    records: Sequence[Record],
    epochs: int,
    seconds: float,
    tolerance: float = STILL,
) -> Trained:
    """The model fitted to records from `start` on, in free run, or as its idea of the noise asks."""
    if model.form == SUBSPACE:
        found = subspace(model.orders, task.output, start, records)
        if found is None:  # too short for it: left untried, as what time does not suffice for
            return replace(as_it_is(start, records), outcome=Outcome.TIME)
        return as_it_is(found, records)
    if model.form in (ARX, ARMAX, BJ):
        return estimated(model.form, model.orders, task.output, start, records, epochs, max(seconds, LEAST))
    return trained(model, task, start, records, epochs, seconds, tolerance)


def network(
    task: Task,
    model: Model,
    line: Network,
    known: Sequence[Network],
    pieces: Sequence[Record],
    rung: Rung,
    until: Deadline,
) -> Trained | None:
    """The network, trained on from what is `known` of it or grown from the linear one with each seed, as time allows.

    The lowest loss of a stable one wins. None where nothing can be grown.
    """
    seeds = range(max(rung.first, len(known)), rung.seeds)
    starts = [*known, *(seeded(task, model, line, pieces, seed) for seed in seeds)]
    fits: list[Trained] = []
    for start in filter(None, starts):
        if (left := until.left) > 0:
            fits.append(trained(model, task, start, pieces, rung.epochs, left))
    return lowest([f for f in fits if not grows(model, f.network, task)] or fits) if fits else None


def seeded(task: Task, model: Model, line: Network, pieces: Sequence[Record], seed: int) -> Network | None:
    """The network as it grows from the linear model, whose neurons weigh next to nothing; None where it cannot."""
    if not model.form.states:
        return grown(model.form.build(model.orders, task.inputs, task.output, seed), line)
    try:
        return states(model.form, model.orders, task.inputs, task.output, line, pieces, seed)
    except InputError:
        return None


def as_it_is(network: Network, records: Sequence[Record]) -> Trained:
    """The network and its loss in free run, not trained."""
    return train(network, records, estimate_initial=True, epochs=0)


def trained(
    model: Model,
    task: Task,
    start: Network,
    pieces: Sequence[Record],
    epochs: int,
    seconds: float,
    tolerance: float = STILL,
) -> Trained:
    """The model trained in free run from `start` on. seconds: of the processor.

    Neurons can hold a linear loop that grows, but only where they were trained. Such a loop is calmed and held, and
    they are trained once more: they may still add to it, within their bounds.
    """
    ends = process_time() + seconds
    decay = pulled(start, model.decay) if model.form.states else model.decay
    run = partial(
        train,
        records=pieces,
        estimate_initial=True,
        epochs=epochs,
        decay=decay,
        clock=process_time,
        tolerance=tolerance,
    )
    fit = run(start, seconds=max(seconds, LEAST))
    if model.form.linear or not grows(model, fit.network, task):
        return fit
    of = model.orders, task.output
    calm = calmed(fit.network, *of, longest(task))
    loop = dict.fromkeys(fed_back(calm, *of), False)
    again = run(calm, free=loop, seconds=max(ends - process_time(), LEAST))
    return fit if again.outcome is Outcome.DIVERGED else again


def lowest(fits: Sequence[Trained]) -> Trained:
    """The fit of the lowest loss; one that diverges comes last."""
    return min(fits, key=lambda f: (f.outcome is Outcome.DIVERGED, f.history[-1]))


def thinned(pieces: Sequence[Record], samples: int, task: Task) -> list[Record]:
    """The pieces, or as many windows of them, evenly spread, as hold at most `samples`."""
    total = sum(len(p) for p in pieces)
    if total <= samples:
        return list(pieces)
    length = max(10 * task.settle, samples // (WINDOWS * task.parts))
    found = []
    for piece in pieces:
        count = max(int(len(piece) * samples / total / length), 1)
        for start in np.linspace(0, max(len(piece) - length, 0), count).astype(int):
            found.append(started(piece.cut(int(start), int(start) + length), task.output))
    return found
