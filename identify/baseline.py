"""The strongest linear model beside a network, so that its error has a measure: searched as `identify` does."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from greygate.errors import InputError
from greygate.identify.fitted import thinned
from greygate.identify.halving import LONG, Halving, reach
from greygate.identify.ladder import LINEAR, Orders
from greygate.identify.looking import look
from greygate.identify.sensors import own_sensors
from greygate.identify.task import FOLDS, HALVES, LONGEST, SETTLING, Task, scaled, started
from greygate.models.accuracy import free_run_rms
from greygate.models.network import Network
from greygate.models.training.initial import initialised
from greygate.models.training.record import Record
from greygate.plants.recording import Recording


def linear(records: Sequence[Record]) -> Network:
    """The linear model of scalar records with one target, whose orders, delays and noise held-out parts have chosen.

    The mean of the target, where the records are too short for more or nothing in them moves.
    """
    first = records[0]
    (output,) = first.targets
    joined = {n: np.concatenate([{**r.inputs, **r.targets}[n] for r in records]) for n in (*first.inputs, output)}
    moving = [n for n in first.inputs if np.ptp(joined[n]) > 0] or list(first.inputs)
    shortest = min(map(len, records))
    settle = min(shortest // (FOLDS * SETTLING), LONGEST)
    ports = [scaled(n, "1", joined[n]) for n in (*moving, output)]
    task = Task(tuple(ports[:-1]), ports[-1], {}, settle, FOLDS if settle >= SETTLING else HALVES)
    runs = [started(replace(r, inputs={n: r.inputs[n] for n in moving}, skip=settle), ports[-1]) for r in records]
    task = replace(task, records={str(k): r for k, r in enumerate(thinned(runs, LONG, task))})
    channels = [{**r.inputs, **r.targets} for r in task.records.values()]
    seen = [look(Recording(1.0, c, dict.fromkeys(c, "1")), moving, output) for c in channels]
    search = Halving(task, math.inf, 1)
    try:
        search.linear_only(*reach(task, seen))
        return search.best_linear()[1]
    except InputError:
        return LINEAR.build(Orders(1, (0,) * len(moving)), ports[:-1], ports[-1], 0)


def linear_rms(learnt: Sequence[Record], judged: Mapping[str, Record]) -> dict[str, dict[str, float]]:
    """RMS error in free run by record and output, in its unit, of linear models of the same inputs.

    learnt: the records that the network was trained on; a first sample that does not count gives the state.
    """
    found: dict[str, dict[str, float]] = {name: {} for name in judged}
    for output, values in learnt[0].targets.items():
        squares: dict[str, list[float]] = {name: [] for name in judged}
        for column in range(np.asarray(values).reshape(len(values), -1).shape[1]):
            model = linear([of_one(r, output, column) for r in learnt])
            for name, record in judged.items():
                one = of_one(record, output, column)
                one = initialised(model, own_sensors(model, one).undone(one))
                squares[name] += [v**2 for v in free_run_rms(model, one).values()]
        for name, of in squares.items():
            found[name][output] = math.sqrt(np.mean(of))
    return found


def of_one(record: Record, output: str, column: int = 0) -> Record:
    """The record with that column of a target alone, every column of an input for itself, and no state but of those."""

    def columns(values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        wide = {n: np.asarray(v).reshape(len(v), -1) for n, v in values.items()}
        return {n if v.shape[1] == 1 else f"{n}_column{i}": v[:, i] for n, v in wide.items() for i in range(v.shape[1])}

    inputs = columns(record.inputs)
    initial = {n: v for n, v in record.initial.items() if n in inputs}
    offset, gain = record.own_offset & {output}, record.own_gain & {output}
    target = np.asarray(record.targets[output]).reshape(len(record), -1)[:, column]
    return replace(record, inputs=inputs, targets={output: target}, initial=initial, own_offset=offset, own_gain=gain)
