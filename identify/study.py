"""Identification on measured recordings, by rules under which the test runs influence no choice.

Structure and seed are chosen by their free-run errors on blocks held out of the training runs. The chosen network is
then fitted to all of the training runs, and the test runs are scored once. `measured/study.py` holds the studies.
"""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median
from time import monotonic

import numpy as np

from greygate import recordings
from greygate.errors import InputError
from greygate.models.accuracy import rmse
from greygate.models.network import Network
from greygate.models.storage import TRAINED
from greygate.models.training.levenberg import Outcome, Trained
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record
from greygate.progress import Progress, silent
from greygate.reading import read_json

RECORDINGS = Path(recordings.__file__).resolve().parent
ROOT = RECORDINGS.parent  # of a checkout, or of the package

Runs = Mapping[str, Record]


@dataclass(frozen=True)
class Fold:
    """pieces: what is fitted. blocks: what judges, each after the `skip` samples that its state may settle in."""

    pieces: Sequence[Record]
    blocks: Sequence[Record]


@dataclass(frozen=True)
class Structure:
    """A structure. build: seed -> start. fit: (start, records) -> what training makes of it.

    grown: the start takes the weights of the linear baseline wherever it has weights of the same name.
    """

    build: Callable[[int], Network]
    fit: Callable[[Network, Sequence[Record]], Trained]
    grown: bool = False


@dataclass(frozen=True)
class Study:
    """What is identified from what.

    recording: folder of the recording; published: where it can be had. load: that folder -> (training runs, test runs)
    by name. linear: the baseline. start: (network, record) -> the record with the state from which a judged run begins;
    it may look at the first `skip` samples only. period in s. typical: RMSEs of a candidate's seeds -> its own.
    """

    name: str
    recording: str
    published: str
    load: Callable[[Path], tuple[dict[str, Record], dict[str, Record]]]
    linear: Structure
    candidates: Mapping[str, Structure]
    seeds: Sequence[int]
    folds: Callable[[Runs], list[Fold]]
    period: float
    start: Callable[[Network, Record], Record] = lambda network, record: record
    typical: Callable[[Sequence[float]], float] = median

    def runs(self, folder: Path | None = None) -> tuple[dict[str, Record], dict[str, Record]]:
        """Training runs and test runs. Raises InputError where the recording is not there or not as published."""
        return self.load(folder or find(self.recording, self.published))

    def records(self, folder: Path | None = None) -> dict[str, Record]:
        """Every run by name, training runs first."""
        training, tests = self.runs(folder)
        return training | tests

    def score(self, network: Network, record: Record) -> float:
        """RMSE of a free run over the record, after its `skip` samples, in the unit of the output."""
        return rmse(network, self.start(network, record))


@dataclass(frozen=True)
class Choice:
    """What the held-out blocks chose. scores: candidate -> seed -> RMSE over all blocks; linear: the baseline's.

    network, baseline: as fitted to the last fold.
    """

    candidate: str
    seed: int
    network: Network
    baseline: Network
    scores: dict[str, dict[int, float]]
    linear: float


def find(recording: str, published: str) -> Path:
    """Folder of a recording: in `recordings/`, in $GREYGATE_RECORDINGS, or in ../shared/recordings beside the repo.

    Raises InputError saying where it is published and where to put it.
    """
    given = os.environ.get("GREYGATE_RECORDINGS")
    places = [RECORDINGS, *([Path(given)] if given else []), ROOT.parent / "shared" / "recordings"]
    for place in places:
        if (place / recording).is_dir():
            return place / recording
    raise InputError(
        f"the recording {recording} is not here; get it from {published} and put its folder into {places[0]} "
        "or into a folder that GREYGATE_RECORDINGS names"
    )


# ---- folds


def tails(share: float) -> Callable[[Runs], list[Fold]]:
    """One fold: the end of every run, run into from its beginning."""

    def folds(runs: Runs) -> list[Fold]:
        heads = {n: int((1 - share) * len(r)) for n, r in runs.items()}
        blocks = [replace(r, skip=heads[n]) for n, r in runs.items()]
        return [Fold([r.cut(0, heads[n]) for n, r in runs.items()], blocks)]

    return folds


def blocked(count: int, warm: int) -> Callable[[Runs], list[Fold]]:
    """`count` folds, each without one of as many equal blocks of every run; `warm` samples before a block settle it.

    Of the first block they are its own first samples.
    """

    def piece(run: Record, start: int, stop: int) -> Record:
        if start == 0:
            return run.cut(0, stop)
        return run.cut(start, stop, skip=0, initial={n: float(v[start - 1]) for n, v in run.inputs.items()})

    def part(run: Record, start: int, stop: int) -> tuple[list[Record], Record]:
        kept = [piece(run, a, b) for a, b in ((0, start), (stop, len(run))) if b > a]
        return kept, replace(piece(run, max(start - warm, 0), stop), skip=warm)

    return partial(_each, count, part)


def masked(count: int) -> Callable[[Runs], list[Fold]]:
    """As `blocked`, but runs go through from their first sample, state and all: what is held out does not count."""

    def part(run: Record, start: int, stop: int) -> tuple[list[Record], Record]:
        kept = [run.cut(0, start)] * (start > 0) + [replace(run, skip=stop)] * (stop < len(run))
        return kept, run.cut(0, stop, skip=start)

    return partial(_each, count, part)


def _each(count: int, part: Callable, runs: Runs) -> list[Fold]:
    """part: (run, start, stop) -> (pieces to fit, block to judge) for the block start..stop."""
    found = []
    for i in range(count):
        parts = [part(run, *(len(run) * k // count for k in (i, i + 1))) for run in runs.values()]
        found.append(Fold([piece for kept, _ in parts for piece in kept], [block for _, block in parts]))
    return found


# ---- choice and result


def choose(study: Study, training: Runs, progress: Progress = silent) -> Choice:
    """Fit every candidate from every seed on every fold and judge it by its RMSE over the held-out blocks.

    The candidate whose seeds are typically lowest wins (`Study.typical`, the median: many seeds are no advantage), then
    the lowest of its seeds.
    """
    folds = study.folds(training)

    def judge(networks: Sequence[Network]) -> float:
        pairs = zip(networks, folds, strict=True)
        squares = [study.score(network, block) ** 2 for network, fold in pairs for block in fold.blocks]
        return float(np.sqrt(np.mean(squares)))

    linear = [study.linear.fit(study.linear.build(0), fold.pieces).network for fold in folds]
    baseline = judge(linear)
    unit = linear[0].outputs[0].unit
    progress(f"{study.name}, linear: {baseline:.4g} {unit} RMSE on held-out blocks")
    scores: dict[str, dict[int, float]] = {}
    best: dict[str, tuple[int, Network]] = {}  # of each candidate
    for name, candidate in study.candidates.items():
        scores[name] = {}
        for seed in study.seeds:
            networks = []
            for fold, start in zip(folds, linear, strict=True):
                network = candidate.build(seed)
                if candidate.grown:
                    network = network.with_parameters(start.parameters())
                networks.append(candidate.fit(network, fold.pieces).network)
            value, lowest = judge(networks), min(scores[name].values(), default=np.inf)
            scores[name][seed] = value
            progress(f"{study.name}, {name}, seed {seed}: {value:.4g} {unit} RMSE on held-out blocks")
            if value < lowest:
                best[name] = seed, networks[-1]
    if not best:
        raise InputError(f"{study.name}: every candidate diverges on a held-out block; give others")
    name = min(best, key=lambda n: (study.typical(list(scores[n].values())), min(scores[n].values())))
    seed, network = best[name]
    return Choice(name, seed, network, linear[-1], scores, baseline)


@dataclass(frozen=True)
class Result:
    """network, and the linear baseline. figures: as in the JSON beside the stored network."""

    study: Study
    network: Network
    linear: Network
    training: Runs
    tests: Runs
    figures: dict

    def save(self, folder: Path = TRAINED) -> None:
        """Write NAME.toml, NAME.safetensors and NAME.json. Raises InputError where that cannot be done."""
        network = replace(self.network, dt=self.study.period)
        network.save(folder / self.study.name, json.dumps(self.figures, indent=2) + "\n")


def identify(study: Study, folder: Path | None = None, progress: Progress = silent) -> Result:
    """Choose, fit the chosen network of the last fold to all of the training runs, score the test runs.

    progress: called with a line per start. Raises InputError as `Study.runs`, `choose` and the fits.
    """
    began = monotonic()
    training, tests = study.runs(folder)
    choice = choose(study, training, progress)
    fits = [
        candidate.fit(network, list(training.values()))
        for candidate, network in (
            (study.candidates[choice.candidate], choice.network),
            (study.linear, choice.baseline),
        )
    ]
    for fit in fits:
        if fit.outcome is Outcome.DIVERGED:
            raise InputError(f"{study.name}: the last fit diverged; {fit.outcome.value}")
    network, linear = (fit.network for fit in fits)
    seconds = monotonic() - began
    output = network.outputs[0]

    def table(model: Network, runs: Runs) -> dict[str, float]:
        return {name: study.score(model, r) for name, r in runs.items()}

    figures = {
        "unit": output.unit,
        "signal": {n: float(np.std(r.targets[output.name][r.skip :])) for n, r in (training | tests).items()},
        "train": table(network, training),
        "held_out": choice.scores[choice.candidate][choice.seed],
        "test": table(network, tests),
        "linear": {"held_out": choice.linear} | table(linear, training | tests),
        "starts": {name: {str(seed): v for seed, v in of.items()} for name, of in choice.scores.items()},
        "candidate": choice.candidate,
        "seed": choice.seed,
        "parameters": parameters(network),
        "seconds": round(seconds, 1),
    }
    return Result(study, network, linear, training, tests, figures)


def parameters(network: Network) -> int:
    """Weights and biases that training may move."""
    return len(Objective(network, []).free)


def stored(study: Study, folder: Path = TRAINED) -> tuple[Network, dict]:
    """The network kept in the package and its figures. Raises InputError as `Network.load`."""
    network = Network.load(folder / study.name)
    return network, read_json(folder / f"{study.name}.json", "train the network again")
