"""What is identified: inputs, one output and its recordings, as ports and records for every model of the ladder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greygate.errors import InputError
from greygate.identify.ladder import LOOP, ROOM, own
from greygate.identify.study import Fold, blocked
from greygate.models.accuracy import float_error
from greygate.models.network import Network, Port
from greygate.models.training.initial import initialised
from greygate.models.training.record import Record
from greygate.plants.recording import Recording

FOLDS = 8  # each holds out an eighth of every recording
HALVES = 2  # folds where a free run over an eighth says little of one over everything
LONGEST = 100  # samples that a state may settle in, if the user does not say: several times any model's states
SHORTEST = 5  # samples in which a state settles, for the length of a block
SETTLING = 4  # blocks have at least this many times the samples that their state settles in


@dataclass(frozen=True)
class Task:
    """inputs, output: ports of the models. records: by name, to train on.

    settle: first samples of each run, which only give its initial state. parts: of each recording, one held out at a
    time.
    """

    inputs: tuple[Port, ...]
    output: Port
    records: Mapping[str, Record]
    settle: int
    parts: int = FOLDS

    @property
    def step(self) -> float:
        """ROOM deviations of the output's difference from one sample to the next, in the output's scale."""
        steps = [np.diff(r.targets[self.output.name]) for r in self.records.values()]
        return ROOM * float(np.std(np.concatenate(steps))) / float(self.output.scale)

    def record(self, recording: Recording) -> Record:
        """The recording as a record of this task's ports, to be judged after `settle` samples."""
        return started(
            Record(
                {p.name: recording[p.name] for p in self.inputs},
                {self.output.name: recording[self.output.name]},
                skip=self.settle,
            ),
            self.output,
        )

    def folds(self) -> list[Fold]:
        """A fold without each part of every recording."""
        runs = {n: replace(r, skip=0) for n, r in self.records.items()}
        return [
            Fold([started(p, self.output) for p in f.pieces], [started(b, self.output) for b in f.blocks])
            for f in blocked(self.parts, self.settle)(runs)
        ]

    def errors(self, network: Network, record: Record) -> np.ndarray | None:
        """Errors of a free run over the record once its state has settled, in the output's unit; None: it diverges."""
        try:
            return float_error(network, initialised(network, record))[self.output.name][record.skip :]
        except InputError:
            return None


def started(record: Record, output: Port) -> Record:
    """The record with a guess of its initial state: inputs and output stood where they are at its first sample."""
    first = {n: float(v[0]) for n, v in record.inputs.items()}
    level = float(output.normalised(record.targets[output.name][:1])[0])
    return replace(record, initial={**first, own(LOOP, [*first, output.name]): level})


def scaled(name: str, unit: str, values: np.ndarray) -> Port:
    """A port for these values; it rests at the first one."""
    scale, mean = ROOM * float(np.std(values)) or 1.0, float(np.mean(values))
    return Port(name, unit, scale, offset=mean, initial=float(values[0]))


def task(recordings: Mapping[str, Recording], inputs: Sequence[str], output: str, settle: int | None = None) -> Task:
    """Raises InputError for a channel that is missing or constant, and for recordings that are too short."""
    if not recordings:
        raise InputError("no recording; give FILE.csv")
    joined = {n: np.concatenate([r[n] for r in recordings.values()]) for n in (*inputs, output)}
    first = next(iter(recordings.values()))
    for name, values in joined.items():
        if not np.ptp(values) > 1e-12 * np.abs(values).max():
            raise InputError(f"{first.source}: channel {name} is constant; record it while it moves, or leave it out")

    def port(name: str) -> Port:
        return scaled(name, first.units[name], joined[name])

    shortest = min(recordings.values(), key=lambda r: r.samples)
    asked = settle if settle is not None else min(shortest.samples // (FOLDS * SETTLING), LONGEST)
    part = SETTLING * max(asked, SHORTEST)
    if shortest.samples < (least := HALVES * part):
        raise InputError(f"{shortest.source}: {shortest.samples} samples; give at least {least} in each recording")
    parts = min(FOLDS, shortest.samples // part)
    found = Task(tuple(port(n) for n in inputs), port(output), {}, asked, parts)
    return replace(found, records={n: found.record(r) for n, r in recordings.items()})
