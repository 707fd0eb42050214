"""Which model is best on blocks that it has not seen, by successive halving (Jamieson, Talwalkar 2016)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import monotonic

import joblib
import numpy as np

from greygate.errors import InputError
from greygate.identifying.ladder import FORMS, LINEAR, Form, Orders, grown
from greygate.identifying.task import Task, started
from greygate.machines.identification import parameters
from greygate.models.network import Network
from greygate.models.training.levenberg import Outcome, Trained, train
from greygate.models.training.record import Record
from greygate.progress import Progress, silent

ORDERS = (1, 2, 3, 4)
DECAY = 1e-3  # a prior: no normalised weight should be far above thirty deviations of one normalised error
STRONG = 3e-2  # the same for recordings whose noise would be learnt with DECAY
SIMPLER = 1.03  # a model of fewer weights wins if no other is better by more than this factor: 4 to 8 blocks judge
WORSE = 2.0  # factor of the held-out error that the error over everything may have: above it the last fit has failed
LEAST = 0.1  # s that a training has, where its rung has just run out of time
REFITTED = 5  # models that are fitted to everything at most
WINDOWS = 16  # into which a fold is cut that is too long to be trained on whole


@dataclass(frozen=True)
class Rung:
    """keep: models that enter it. seeds: starts for each. epochs: of each. samples: at most, of a fold to train on.

    every: 2 for every second fold. until: share of the time limit at which it must end.
    """

    keep: int
    seeds: int
    epochs: int
    samples: int
    every: int
    until: float


LADDER = Rung(10**6, 1, 60, 8000, 1, 0.2)
RUNGS = (Rung(10**6, 1, 12, 4000, 2, 0.45), Rung(16, 2, 40, 8000, 1, 0.65), Rung(5, 3, 120, 20000, 1, 0.85))
FINAL = Rung(1, 3, 150, 10**9, 1, 1.0)
BASES = 3  # linear models from which networks are grown


@dataclass(frozen=True)
class Model:
    """A model of the ladder. decay: D of the loss."""

    form: Form
    orders: Orders
    decay: float = DECAY

    @property
    def name(self) -> str:
        return f"{self.form.name}, {self.orders}" + (", strong decay" if self.decay > DECAY else "")


@dataclass
class Tried:
    """What became of a model: error on what was held out (inf: diverged), in the unit of the output.

    errors: errors over each held-out block, (N,). networks: of each fold. seconds: that it took in all.
    """

    model: Model
    error: float = np.inf
    errors: tuple[np.ndarray, ...] = ()
    networks: tuple[Network, ...] = ()
    seconds: float = 0.0
    parameters: int = 0
    rung: int = 0


class Halving:
    """A search over one task. seconds: its time limit. jobs: trainings side by side."""

    def __init__(self, task: Task, seconds: float, jobs: int, progress: Progress = silent):
        self.task, self.seconds, self.jobs, self.progress = task, seconds, jobs, progress
        self.began = monotonic()
        self.folds = task.folds()
        self.tried: dict[Model, Tried] = {}
        self.linear: dict[tuple[Orders, int], Network] = {}

    def left(self, until: float) -> float:
        return until * self.seconds - (monotonic() - self.began)

    def run(self, delays: Sequence[tuple[int, ...]], strides: Sequence[int]) -> list[Tried]:
        """Every model that was tried, the best first. Raises InputError if none was."""
        ladder = [Model(LINEAR, Orders(o, d, s), 0.0) for s in strides for o in ORDERS for d in delays]
        self.rung(0, LADDER, ladder)
        bases = self.bases()
        models = [Model(form, base.model.orders) for form in FORMS for base in bases]
        for number, rung in enumerate(RUNGS, 1):
            self.rung(number, rung, models[: rung.keep])
            ranked = [t for t in self.ranked() if t.model.form is not LINEAR]
            models = [t.model for t in ranked if t.rung == number]
            if number == len(RUNGS) - 1:
                models = [m for model in models for m in (model, replace(model, decay=STRONG))]
        return self.ranked()

    def bases(self) -> list[Tried]:
        """The best linear models that differ in order or stride, from which networks are grown."""
        found: dict[tuple[int, int], Tried] = {}
        for tried in self.ranked():
            if np.isfinite(tried.error):
                found.setdefault((tried.model.orders.order, tried.model.orders.stride), tried)
        if not found:
            raise InputError("no linear model was finished in time, or every one diverges; give more --seconds")
        return list(found.values())[:BASES]

    def ranked(self) -> list[Tried]:
        return sorted(self.tried.values(), key=lambda t: (t.error, t.parameters))

    def rung(self, number: int, rung: Rung, models: Sequence[Model]) -> None:
        """Train the models on every fold and judge them; those for which no time is left stay as they are."""

        def one(model: Model) -> Tried | None:
            return self.judged(model, rung, number) if self.left(rung.until) > 0 else None

        work = joblib.Parallel(self.jobs, prefer="threads", return_as="generator_unordered")
        for tried in work(joblib.delayed(one)(m) for m in models):
            if tried is None:
                continue
            before = self.tried.get(tried.model)
            if before is None or tried.rung > before.rung:
                self.tried[tried.model] = tried
            best = min(self.tried.values(), key=lambda t: t.error)
            self.progress(f"{len(self.tried)} models, best {best.model.name}: {best.error:.4g} held out")

    def judged(self, model: Model, rung: Rung, number: int) -> Tried:
        began = monotonic()
        networks, errors = [], []
        for place in range(0, len(self.folds), rung.every):
            fold = self.folds[place]
            fit = self.fit(model, thinned(fold.pieces, rung.samples, self.task), rung, place)
            networks.append(fit.network)
            errors += [self.task.errors(fit.network, block) for block in fold.blocks]
        found = [e for e in errors if e is not None]
        if len(found) < len(errors):
            found = []
        error = float(np.sqrt(np.mean(np.concatenate(found) ** 2))) if found else np.inf
        seconds = monotonic() - began
        return Tried(model, error, tuple(found), tuple(networks), seconds, parameters(networks[0]), number)

    def chosen(self) -> Tried:
        """The best model of the last rung that is finished or of the ladder; a simpler one that is as good wins."""
        ranked = self.finalists()
        near = [t for t in ranked if t.error <= SIMPLER * ranked[0].error]
        return min(near, key=lambda t: (t.parameters, t.error))

    def finalists(self) -> list[Tried]:
        """Linear models and the networks that reached the highest rung, the best first."""
        last = max(t.rung for t in self.tried.values())
        return [t for t in self.ranked() if t.rung in (0, last)]

    def final(self) -> tuple[Tried, Trained]:
        """The chosen model, fitted to everything; where its free run then drifts off, the next that does not.

        Where all of the best do, it is the one that errs least: the recordings' inputs do not explain their output.
        """
        first = self.chosen()
        best = [first, *(t for t in self.finalists() if t is not first)][:REFITTED]
        drift = {t.model: pooled(self.task, t.networks[0]) for t in best}
        sound = [t for t in best if drift[t.model] <= WORSE * t.error]
        best = sound or sorted(best, key=lambda t: drift[t.model])
        found: list[tuple[float, Tried, Trained]] = []
        for done, tried in enumerate(best):
            if found and self.left(FINAL.until) <= 0:
                break
            fit = self.complete(tried, 1 if sound else len(best) - done)
            error = pooled(self.task, fit.network)
            if drift[tried.model] < error:  # more data have made it worse: as its first fold left it
                error, fit = drift[tried.model], replace(fit, network=tried.networks[0], initial=())
            found.append((error, tried, fit))
            if error <= WORSE * tried.error:
                break
        error, tried, fit = found[-1] if error <= WORSE * tried.error else min(found, key=lambda f: f[0])
        if not np.isfinite(error):
            raise InputError("every model diverges over the complete recordings; are they of one plant?")
        return tried, fit

    def complete(self, tried: Tried, of: int = 1) -> Trained:
        """A model fitted to everything, from what two of its folds have made of it; the lower loss wins.

        of: models among which the time that is left is shared.
        """
        records = list(self.task.records.values())
        starts = tried.networks[:: max(len(tried.networks) // 2, 1)]
        fits = []
        for done, start in enumerate(starts):
            shared = self.left(FINAL.until) / of / (len(starts) - done)
            fits.append(self.trained(start, records, FINAL, tried.model.decay, shared))
        return min(fits, key=lambda f: (f.outcome is Outcome.DIVERGED, f.history[-1]))

    def fit(self, model: Model, pieces: Sequence[Record], rung: Rung, place: int) -> Trained:
        """Train a model from its seeds on records; the lowest loss wins. place: of the fold, -1 for everything."""
        ports, output = self.task.inputs, self.task.output
        if model.form is LINEAR:
            found = self.line(model.orders, pieces, rung)
            self.linear[model.orders, place] = found.network
            return found
        fits = []
        for seed in range(rung.seeds):
            start = grown(model.form.build(model.orders, ports, output, seed), self.linear[model.orders, place])
            fits.append(self.trained(start, pieces, rung, model.decay))
        return min(fits, key=lambda f: (f.outcome is Outcome.DIVERGED, f.history[-1]))

    def line(self, orders: Orders, pieces: Sequence[Record], rung: Rung) -> Trained:
        """The linear model: ARX, then output error."""
        start = LINEAR.build(orders, self.task.inputs, self.task.output, 0)
        taught = train(start, pieces, teacher=True, epochs=5)
        return self.trained(taught.network, pieces, rung, 0.0)

    def trained(
        self, start: Network, pieces: Sequence[Record], rung: Rung, decay: float, seconds: float = np.inf
    ) -> Trained:
        left = max(min(self.left(rung.until), seconds), LEAST)
        return train(start, pieces, estimate_initial=True, epochs=rung.epochs, decay=decay, seconds=left)


def pooled(task: Task, network: Network) -> float:
    """RMS error of free runs over all recordings; inf: diverges."""
    errors = [task.errors(network, r) for r in task.records.values()]
    found = [e for e in errors if e is not None]
    return float(np.sqrt(np.mean(np.concatenate(found) ** 2))) if len(found) == len(errors) else np.inf


def thinned(pieces: Sequence[Record], samples: int, task: Task) -> list[Record]:
    """The pieces, or as many windows of them, evenly spread, as hold at most `samples`."""
    total = sum(len(p) for p in pieces)
    if total <= samples:
        return list(pieces)
    length = max(10 * task.settle, samples // WINDOWS)
    found = []
    for piece in pieces:
        count = max(int(len(piece) * samples / total / length), 1)
        for start in np.linspace(0, max(len(piece) - length, 0), count).astype(int):
            found.append(started(piece.cut(int(start), int(start) + length), task.output))
    return found
