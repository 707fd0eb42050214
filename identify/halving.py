"""Which model is best on blocks that it has not seen, by successive halving (Jamieson, Talwalkar 2016)."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import zip_longest
from time import process_time
from typing import NamedTuple

import numpy as np

from greygate import children
from greygate.errors import InputError
from greygate.identify.clock import Clock, Deadline
from greygate.identify.fitted import (
    FULL,
    LEAST,
    Rung,
    distances,
    grows,
    judged,
    longest,
    lowest,
    most,
    refitted,
    thinned,
    warm,
)
from greygate.identify.ladder import (
    ARMAX,
    ARX,
    BJ,
    FIR,
    FORMS,
    LINEAR,
    SUBSPACE,
    Form,
    Orders,
    falling,
)
from greygate.identify.task import HALVES, Task
from greygate.identify.tried import DECAY, SIMPLER, STATE, STRONG, Model, Tried, pooled, surely
from greygate.models.layer import LONGEST_DELAY
from greygate.models.network import Network
from greygate.models.training.levenberg import Trained
from greygate.progress import Progress, silent

ORDERS = (1, 2, 3, 4, 5, 6, 7, 8)
FEW = 4  # the highest order of taps that are set apart: they reach far enough
PAST = (16, 48)  # taps of a FIR model: it sees a decay of three and of ten of the longest taps of the others
SPOILT = 1.1  # factor of the error over everything by which a fit to everything may be worse than one to a part
WAYS = ((0.0, 1.0), (-0.5, 1.0), (0.5, 1.0), (0.0, 1.5))  # aside and louder: how networks of all folds must agree
APART = 1.5  # times what a linear model errs on what was held out, from which the networks of all folds answer apart
SAFER = 1.5  # factor of the error up to which a network whose linear loop does not grow is taken before one whose does
WORSE = 2.0  # factor of the held-out error that the error over everything may have: above it the free run drifts off
REFITTED = 5  # models that are fitted to everything at most
LONG = 50_000  # samples that they are then searched on, at most
EPOCHS = 150  # of a fit to everything
ENDING = 0.1  # share of the time limit that a linear model's fit to everything has at least

QUICK = Rung(10**6, 1, 0, 8000, 1, 0.2)  # linear models by least squares and by the subspace
LADDER = Rung(10**6, 1, 60, 8000, 1, 0.3)
LEADING = 4  # of the linear models, that are then fitted to their free run
ALONE = replace(LADDER, epochs=20, every=2)  # where nothing grows from the linear models: the best one is fitted anew
NOISES = replace(LADDER, until=0.35)  # the best of those under other ideas of the noise
RUNGS = (Rung(10**6, 1, 40, 4000, 2, 0.5), Rung(16, 1, 60, 8000, 1, 0.75), Rung(6, 2, 120, 20000, 1, 0.9))
AGAIN = 3  # times that the last rung has further starts, while there is time
BASES = 3  # linear models from which networks are grown, the best ones
LOW = (2, 3)  # orders of the linear models from which states are grown, beside the best one's
RICH = 3  # order of one more at each stride
DONE = 1e-7  # the same where the network is kept


def reach(task: Task, seen: Iterable[Mapping], deepest: int = FEW) -> tuple[list[tuple[int, ...]], list[int]]:
    """Delays and strides to try. seen: of each recording, by `look`. deepest: an order for which a stride leaves room.

    The delays that were seen, others about them, and none: which one is best shows only with a model.
    """
    seen = list(seen)
    apart = min(max(s["stride"] for s in seen), max(task.settle // deepest, 1))
    names = [p.name for p in task.inputs]
    found = [min((s["delays"][n] for s in seen if s["delays"][n] is not None), default=0) for n in names]
    delays = [tuple(max(d + shift, 0) for d in found) for shift in (0, -1, 1, -2)] + [(0,) * len(names)]
    return list(dict.fromkeys(delays)), sorted({1, apart})


class Standing(NamedTuple):
    """Whether a network's linear loop grows, and its RMS error over the complete recordings; inf: diverges."""

    grows: bool
    error: float
    network: Network


class Halving:
    """A search over one task. seconds: its time limit. jobs: trainings side by side."""

    def __init__(self, task: Task, seconds: float, jobs: int, progress: Progress = silent):
        self.task, self.jobs, self.progress = task, jobs, progress
        self.clock, self.seconds, self.loaded = Clock(), seconds, 0.0
        self.folds = task.folds()
        self.tried: dict[Model, Tried] = {}
        self.late: set[Model] = set()

    @property
    def untried(self) -> list[Model]:
        """Models for which there was no time."""
        return sorted(self.late - set(self.tried), key=lambda m: m.name)

    def deadline(self, until: float = 1.0) -> Deadline:
        """Where that share of what there was to search in is used, for trainings side by side."""
        return Deadline(self.clock, self.loaded + until * (self.seconds - self.loaded), max(self.jobs, 1))

    def used(self) -> float:
        """Share of what there was to search in that is used."""
        return (self.clock.spent() - self.loaded) / max(self.seconds - self.loaded, LEAST)

    def load(self) -> None:
        """Start the processes, and note what that takes: no share of the search is to pay for it."""
        list(children.workers(self.jobs, [partial(warm, self.task, self.clock)] * max(self.jobs, 1)))
        if math.isfinite(self.seconds):
            self.loaded = min(self.clock.spent(), self.seconds / 2)

    def run(self, delays: Sequence[tuple[int, ...]], strides: Sequence[int]) -> None:
        """Try the linear models and what grows from them. Raises InputError if every linear model diverges."""
        self.load()
        self.linear_models(delays, strides)
        if self.drifts() and (self.used() < NOISES.until or not self.lines()):
            self.lengthen([t.model for t in self.ranked()], strides, delays)
        self.rung(0, NOISES, self.noises())
        models, left = self.networks(), np.clip((1 - self.used()) / (1 - NOISES.until), 0.0, 1.0)
        rungs = [replace(r, until=1 - left * (1 - r.until)) for r in RUNGS]  # of what linear models have left
        for number, rung in enumerate(rungs, 1):
            self.rung(number, rung, models[: rung.keep])
            models = [t.model for t in sorted(self.tried.values(), key=lambda t: t.typical) if t.rung == number]
        if math.isfinite(self.seconds):
            for seed in range(RUNGS[-1].seeds, RUNGS[-1].seeds + AGAIN):
                last = replace(rungs[-1], first=seed, seeds=seed + 1)
                self.rung(len(rungs), last, models[: last.keep])

    def linear_models(self, delays: Sequence[tuple[int, ...]], strides: Sequence[int]) -> None:
        """Orders at the delay that was seen, delays of the best orders; the best are fitted to their free run."""
        rich = [Orders(RICH, (0,) * len(self.task.inputs), s) for s in strides]
        self.rung(0, QUICK, [Model(LINEAR, o, 0.0) for o in dict.fromkeys([*ordered(delays[0], strides), *rich])])
        best = [t.model.orders for t in self.ranked()[:LEADING]]
        late = [Model(LINEAR, replace(o, delays=d), 0.0) for d in delays for o in best]
        self.rung(0, QUICK, [m for m in late if m not in self.tried])
        self.free_run([t.model for t in self.ranked()[:LEADING] if np.isfinite(t.error)], LADDER.until)

    def free_run(self, models: Sequence[Model], until: float) -> None:
        """Fit linear models to their free run; networks wait for the first ones, from which they grow."""
        self.rung(0, replace(LADDER, until=max(until, RUNGS[0].until)), models[: self.jobs])
        self.rung(0, replace(LADDER, until=until), models[self.jobs :])

    def networks(self) -> list[Model]:
        """What grows from the linear models, the most promising first, those of states and others by turns."""
        spaces = [Model(form, o, decay) for decay in STATE for o in self.spaces() for form in FORMS if form.states]
        forms = sorted((form for form in FORMS if not form.states), key=lambda f: (f.reads != "all", not f.inside))
        taps = [
            Model(form, o, d) for o in self.grown_from() for d in (DECAY, STRONG) for form in forms if form.suits(o)
        ]
        turns = zip_longest(spaces, taps)
        return [model for pair in turns for model in pair if model]

    def spaces(self) -> list[Orders]:
        """Taps of the linear models from which states are grown: the best one, of each kind, and of low orders.

        Where an output may rest anywhere, integrating ones alone: no others would know where it begins.
        """
        found = [t.model.orders for t in self.lines()]
        found = [o for o in found if o.integrating] or found
        stay, drift = ([o for o in found if o.integrating is kind] for kind in (False, True))
        low = [[o for o in stay if o.order == order] for order in LOW]
        return list(dict.fromkeys(o for of in (found, found[1:], drift, stay, *low) for o in of[:1]))

    def lengthen(self, ladder: Sequence[Model], strides: Sequence[int], delays: Sequence[tuple[int, ...]] = ()) -> None:
        """Try the linear models again where longer runs judge, longer windows train and an output may rest anywhere.

        Where time does not suffice for one of them, all stays as it is.
        """
        before, step = (self.task, self.folds, self.tried), self.task.step
        late = dict.fromkeys([self.ranked()[0].model.orders.delays, *delays[:3]])
        resting = [Model(LINEAR, Orders(o, d, s, step), 0.0) for d in late for s in strides for o in ORDERS[: FEW - 1]]
        runs = bool(self.lines())
        until = NOISES.until if runs else RUNGS[0].until
        self.task = replace(self.task, parts=HALVES)
        self.folds, self.tried = self.task.folds(), {}
        if not runs:  # what would be tried again has not run before: it waits
            self.free_run(resting, until)
        self.rung(0, replace(QUICK, until=until), ladder)
        self.free_run([*(t.model for t in self.ranked()[:LEADING]), *(resting if runs else [])], until)
        if not self.tried:
            self.task, self.folds, self.tried = before

    def noises(self) -> list[Model]:
        """The best linear models under other ideas of the noise, of which an integrating one has none."""
        best = [base.model.orders for base in self.bases() if not base.model.orders.integrating]
        longer = [replace(orders, order=taps - 1) for orders in best[:1] for taps in PAST]
        shortest = min(len(p) for f in self.folds for p in thinned(f.pieces, NOISES.samples, self.task))
        found = [Model(SUBSPACE, orders, 0.0) for orders in best if orders.stride == 1]
        found += [Model(form, orders, 0.0) for form in (ARX, ARMAX, BJ) for orders in best]
        return found + [Model(FIR, o, 0.0) for o in longer if o.deepest < min(shortest, LONGEST_DELAY)]

    def drifts(self) -> bool:
        """Whether the best stable linear model does not settle within a recording, or errs far more over everything."""
        best = next((t for t in self.ranked() if t.model.form == LINEAR and np.isfinite(t.error)), None)
        if best is None:
            return True
        networks = best.networks.values()
        falls = [falling(n, best.model.orders, self.task.output) for n in networks]
        slow = most(not 0 <= f <= longest(self.task) for f in falls)
        return slow or most(self.whole(n) > WORSE * best.error for n in networks)

    def bases(self) -> list[Tried]:
        """The best linear models that differ in more than their delays, from which networks are grown."""
        found: dict[Orders, Tried] = {}
        for tried in self.lines():
            found.setdefault(replace(tried.model.orders, delays=()), tried)
        if not found:
            raise InputError("every linear model that was tried diverges; give more --seconds")
        return list(found.values())[:BASES]

    def grown_from(self) -> list[Orders]:
        """Taps of the linear models from which networks are grown: of the best, and of rich ones without delay.

        What a linear model takes for a delay, or does without, a curve may explain.
        """
        found = [base.model.orders for base in self.bases()]
        rich = [o for o in (t.model.orders for t in self.lines()) if o.order == RICH and not any(o.delays)]
        return list(dict.fromkeys([found[0], *rich, *found[1:], *self.spaces()]))

    def lines(self) -> list[Tried]:
        """Linear models that run, the best first; before it the one of fewest weights among those as good."""
        found = [t for t in self.ranked() if t.model.form == LINEAR and np.isfinite(t.error)]
        near = [t for t in found if t.error <= SIMPLER * found[0].error]
        lean = min(near, key=lambda t: t.parameters, default=None)
        return sorted(found, key=lambda t: t is not lean)

    def ranked(self) -> list[Tried]:
        return sorted(self.tried.values(), key=lambda t: (t.error, t.parameters))

    def rung(self, number: int, rung: Rung, models: Sequence[Model]) -> None:
        """Train the models on every fold and judge them; those that time does not suffice for stay as they are.

        The first of all has what time it takes: something is to be told.
        """
        until = self.deadline(rung.until)
        folds = {  # every process is sent only what is trained on
            place: replace(self.folds[place], pieces=thinned(self.folds[place].pieces, rung.samples, self.task))
            for place in range(0, len(self.folds), rung.every)
        }
        known = [(m, self.tried.get(m.line), self.tried.get(m)) for m in models]
        ends = [until if k or self.tried else replace(until, at=math.inf) for k in range(len(known))]
        tasks = [partial(judged, self.task, folds, *of, number, rung, end) for of, end in zip(known, ends, strict=True)]
        self.late.update(models)
        for tried in children.workers(self.jobs, tasks, in_order=False):
            if tried is children.DIED:
                raise InputError(children.KILLED)
            if tried is not None:
                before = self.tried.get(tried.model)
                if before and set(before.errors) == set(tried.errors) and before.error < tried.error:
                    tried = replace(before, rung=number)  # more training has made it worse on what it has not seen
                self.tried[tried.model] = tried
                best = self.ranked()[0]
                self.progress(f"{len(self.tried)} models, best {best.model.name}: {best.error:.4g} held out")

    def shared(self) -> list[int]:
        """The folds that judged every finalist."""
        return sorted(set.intersection(*(set(t.errors) for t in self._last())))

    def _last(self) -> list[Tried]:
        """Linear models, and the networks that every fold has judged; where there are none, those of half the folds."""
        least = min(max(t.rung for t in self.tried.values()), FULL)
        return [t for t in self.tried.values() if t.rung == 0 or t.rung >= least]

    def finalists(self) -> list[Tried]:
        """Linear models and the networks that came far enough, the best first, by blocks that judged all."""
        folds = self.shared()
        return sorted(self._last(), key=lambda t: (t.over(folds), t.parameters))

    def chosen(self) -> Tried:
        """The best of the finalists; a simpler one that is as good wins, and a linear one where that is not refuted."""
        ranked, folds = self.finalists(), self.shared()
        lines = [t for t in ranked if t.model.form.linear]
        bent = [t for t in ranked if not t.model.form.linear and (not lines or surely(t, lines[0], folds))]
        ranked = [t for t in bent if not lines or self.agrees(t, lines[0])] or lines or bent
        safe = [t for t in ranked if t.safe and t.over(folds) <= SAFER * ranked[0].over(folds)]
        ranked = safe or ranked
        near = [t for t in ranked if t.over(folds) <= SIMPLER * ranked[0].over(folds)]
        return min(near, key=lambda t: (t.parameters, t.over(folds)))

    def agrees(self, tried: Tried, line: Tried) -> bool:
        """Whether the networks of all folds answer alike, where a linear model says what alike is.

        Networks that learnt from nearly the same, and answer otherwise where inputs are larger or stand aside, know
        little of what is there. One of them may be an odd one.
        """
        return bool(np.max(np.median(self.apart(tried.networks.values(), line), axis=1)) <= APART)

    def apart(self, networks: Iterable[Network], line: Tried) -> np.ndarray:
        """How far each runs from the median of all (ways of the inputs, networks), in parts of what is alike.

        That is what a linear model errs on what was held out, or how far apart those of its folds run.
        """
        found, all_ = [], list(networks)
        for way in WAYS:
            alike = max(line.error, float(np.median(distances(self.task, list(line.networks.values()), *way))))
            found.append(distances(self.task, all_, *way) / alike if np.isfinite(alike) else np.zeros(len(all_)))
        return np.array(found)

    def whole(self, network: Network) -> float:
        """RMS error of free runs over the complete recordings; inf: diverges."""
        return pooled([self.task.errors(network, r) for r in self.task.records.values()])

    def stands(self, model: Model, network: Network) -> "Standing":
        return Standing(grows(model, network, self.task), self.whole(network), network)

    def standing(self, tried: Tried) -> "Standing":
        """A fold's network over the complete recordings: the first that does not drift off, if any."""
        found = []
        for network in sorted(tried.networks.values(), key=lambda n: grows(tried.model, n, self.task)):
            found.append(self.stands(tried.model, network))
            if found[-1].error <= WORSE * tried.error:
                return found[-1]
        return min(found, key=lambda f: (f.grows, f.error))

    def final(self) -> tuple[Tried, Trained]:
        """The chosen model, fitted to everything; the next one where its free run over everything drifts off.

        Where all of the best do, it is the one that errs least: the recordings' inputs do not explain their output.
        """
        first = self.chosen()
        line = next((t for t in self.finalists() if t.model.form.linear), None)
        others = (t for t in self.finalists() if t.safe and t is not first)
        best = [first, *(t for t in others if t.model.form.linear or not line or self.agrees(t, line))][:REFITTED]
        starts = {t.model: self.standing(t) for t in best}
        sound = [t for t in best if starts[t.model].error <= WORSE * t.error]
        best = sound or sorted(best, key=lambda t: starts[t.model].error)
        found: list[tuple[Standing, Tried, Trained]] = []
        for done, tried in enumerate(best):
            left = self.deadline().left * max(self.jobs, 1)
            if (sound or left <= 0) and any(not now.grows for now, *_ in found):
                break
            share = left if sound else left / (len(best) - done)
            share = max(share, ENDING * self.seconds) if tried.model.form.linear else share
            fit, start = self.complete(tried, share), starts[tried.model]
            now = self.stands(tried.model, fit.network)
            if (odd := self.odd(tried, fit.network, line)) is not None:
                start = odd
            if odd or (start.grows, SPOILT * start.error) < (now.grows, now.error):  # more data have made it worse
                now, fit = start, replace(fit, network=start.network, initial=())
            found.append((now, tried, fit))
        now, tried, fit = min(found, key=lambda f: (f[0].grows, f[0].error))
        if not np.isfinite(now.error):
            raise InputError("every model diverges over the complete recordings; are they of one plant?")
        return tried, fit

    def odd(self, tried: Tried, network: Network, line: Tried | None) -> Standing | None:
        """The fold's network amid the others, where the one fitted to everything runs apart from them."""
        if line is None or tried.model.form.linear:
            return None
        far = np.max(self.apart([*tried.networks.values(), network], line), axis=0)
        amid = int(np.argmin(far[:-1]))
        if far[-1] <= APART or far[amid] > APART:
            return None
        found = self.stands(tried.model, list(tried.networks.values())[amid])
        return found if not found.grows and found.error <= WORSE * tried.error else None

    def best_linear(self) -> tuple[Tried, Network]:
        """The linear model that errs least on what was held out and does not drift off, fitted to everything.

        Where all drift, the one that errs least over everything. Raises InputError where none runs.
        """
        found = []
        for tried in [t for t in self.ranked() if t.model.form.linear and np.isfinite(t.error)][:REFITTED]:
            network = self.complete(tried, np.inf).network
            error = self.whole(network)
            if error <= WORSE * tried.error:
                return tried, network
            found.append((error, tried, network))
        if not found:
            raise InputError("every linear model diverges")
        return min(found, key=lambda f: f[0])[1:]

    def linear_only(self, delays: Sequence[tuple[int, ...]], strides: Sequence[int]) -> None:
        """Try linear models without a limit of time: orders, then delays of the best order, then ideas of the noise."""
        shortest = min(len(p) for f in self.folds for p in thinned(f.pieces, ALONE.samples, self.task))

        def fitted(orders: Iterable[Orders], forms: Sequence[Form] = (LINEAR,)) -> None:
            models = [Model(form, o, 0.0) for o in orders if 2 * o.deepest < shortest for form in forms]
            self.rung(0, ALONE, [m for m in models if m not in self.tried])

        fitted(o for o in ordered(min(delays), strides) if o.order <= FEW)
        if not self.tried:
            raise InputError("the recordings are too short for a linear model")
        fitted(replace(self.ranked()[0].model.orders, delays=d) for d in delays)
        if self.drifts():
            self.lengthen([t.model for t in self.ranked()], strides, delays)
        if not (best := self.ranked()[0].model.orders).integrating:
            fitted([best], [ARX, ARMAX, BJ, *[SUBSPACE] * (best.stride == 1)])

    def complete(self, tried: Tried, seconds: float) -> Trained:
        """A model fitted to everything, from what two of its folds have made of it; the lower loss wins."""
        records, starts = list(self.task.records.values()), list(tried.networks.values())
        starts, fits = starts[:: max(len(starts) // 2, 1)], []
        ends = process_time() + seconds
        for done, start in enumerate(starts):
            share = (ends - process_time()) / (len(starts) - done)
            fits.append(refitted(tried.model, self.task, start, records, EPOCHS, share, DONE))
        return lowest(fits)


def ordered(delay: tuple[int, ...], strides: Sequence[int]) -> list[Orders]:
    """Every order of linear models of one delay, the lowest first."""
    return [Orders(o, delay, s) for o in ORDERS for s in strides if s == 1 or o <= FEW]
