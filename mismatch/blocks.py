"""Whether a fit simulates worse than a plainer one, on blocks of identify.csv that neither of them learnt from.

What leaves something unexplained is judged on halves, too: from one it must carry over to the other, as it must to the
next recording.

The recording is cut into pieces; every `FOLDS`-th of them is one block. Of several recordings each one is a block, if
the others show what the fit has beyond the plainer one; else it is cut, as one recording is. The parameters of both
fits are fitted again to the other pieces, and both simulations run by the rule of the rig, free or with its restarts. A
fit loses on a channel of a block where its error is larger, and by more than chance makes of it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2, t

from greygate.mismatch.fit import Fit, Likelihood, flattened
from greygate.mismatch.model import TINY
from greygate.mismatch.rig import IN
from greygate.mismatch.several import modelled
from greygate.mismatch.shown_by import SHOWN, margin

FOLDS, ROUNDS = 5, 2  # blocks, and pieces of each: spread, so that no regime of the plant is held out entirely
PERCENT = 100
PARTS = 8  # of a piece, each of them one draw of the difference of the squared errors
FEWEST_DRAWS = 2  # of which a standard error can be told
HALF = 0.1  # of its RMS error on a half, by which another fit may be worse: slow errors are few draws of chance
TOLL = 0.1  # of what a fit saves on all blocks, that one of them may take back: it is half of an even share
MORE = 0.01  # of the plainer fit's RMS error, by which another fit may be worse
SURE = 3.0  # standard errors of the difference of the squared errors, below which it may be chance
CHANCE = 0.01  # of calling a plant overfitted that is not, all channels together
NEXT = 1.1  # times its error where it was learnt from: what errs by less where it was not holds there, too
REFIT = 4  # iterations of a fit to the other pieces, which begins at that of the whole recording


@dataclass(frozen=True)
class Loss:
    """A channel of a block on which a fit is worse. spans: (from, to) of its pieces in s. before, after: RMS errors.

    recording: of several the one in which it lies. Without spans it is all of that, or of the only one. learnt: whether
    both fits did learn from it. cost: how much larger the sum of the squared errors is.
    """

    channel: str
    unit: str
    spans: tuple[tuple[float, float], ...]
    before: float
    after: float
    recording: str = ""
    learnt: bool = False
    cost: float = np.inf

    def __str__(self) -> str:
        when = " and ".join(f"{low:.3g} to {high:.3g} s" for low, high in self.spans)
        when = " ".join([*(["at", when] if when else []), *(["in", self.recording] if self.recording else [])])
        if not np.isfinite(self.after):
            return f"the run diverges {when}" + (", which it did not learn from" if not self.learnt else "")
        by = f"{self.channel} is {PERCENT * (self.after / self.before - 1):.2g} % worse {when}".rstrip()
        return by if self.learnt else f"{by}, not learnt from"


class Judge:
    """The rule of a rig over identify.csv, by which fits are compared.

    halves: whether a recording is cut into its two halves, and not into blocks that are spread.
    fold: number of the block in which each sample lies (samples,); of several recordings, of the recording.
    """

    def __init__(self, likelihood: Likelihood, halves: bool = False):
        model, self.halves = likelihood.model, halves
        again = model.window != model.rig.window
        self.model = modelled(model.rig, model.recording, model.effects) if again else model
        runs = self.model.pieces
        self.several = len({run.name for run in self.model.recording.runs}) > 1
        if self.several:
            self.fold = np.repeat(np.arange(len(runs)), [run.stop - run.start for run in runs])
        else:
            self.fold = _turns(len(self.model.target), *((2, 1) if halves else ()))

    @np.errstate(over="ignore", invalid="ignore")  # a run may diverge
    def errors(self, values: Mapping[str, float]) -> np.ndarray:
        """Recorded less simulated by the rule of the rig (samples, channels), in the channels' units."""
        known = {s: v for s, v in values.items() if s in self.model.values}
        return self.model.target - self.model.predict({**self.model.values, **known})

    def unseen(self, fit: Fit, held: np.ndarray, exact: bool = False) -> np.ndarray:
        """Errors of a fit that did not learn from a block, on that block (samples of it, channels).

        exact: fitted again to the rest, in place of one linearised step.
        """
        return self.errors(_without(fit, held, exact))[held]

    def blocks(self, plain: Fit, fit: Fit) -> list[np.ndarray]:
        """The blocks that are held out in turn (samples,), to compare a fit with a plainer one."""
        found = [self.fold == k for k in range(int(self.fold.max()) + 1)]
        had = {(u.symbol, np.isinf(u.prior)) for u in plain.unknowns}
        new = [u.symbol for u in fit.unknowns if (u.symbol, np.isinf(u.prior)) not in had]
        if not (self.several and new):
            return found
        of, cut = fit.likelihood.recording, []
        for k, held in enumerate(found):
            if margin(fit, new, of != k) > SHOWN:
                cut.append(held)
                continue
            turns = np.full(len(held), FOLDS)
            turns[held] = _turns(int(held.sum()))
            cut += [turns == turn for turn in range(FOLDS)]
        return cut

    def losses(self, plain: Fit, fit: Fit) -> list[Loss]:
        """Every channel of every block on which `fit` is worse than `plain`.

        What the linearised fits show is fitted again before it counts. Some block out of many is always worse: that one
        counts which takes back TOLL of what is saved on all. Of several recordings each one as a whole counts, too,
        though both fits learnt from it: what the others have need not be there.
        """
        found = []
        if self.several:
            both = self.errors(plain.values), self.errors(fit.values)
            for k in range(int(self.fold.max()) + 1):
                held = self.fold == k
                lost = self._lost(both[0][held], both[1][held], held)
                found += [replace(loss, learnt=True) for loss in lost]
        if found:
            return found
        saved = np.zeros(len(self.model.rig.predict))
        for held in self.blocks(plain, fit):
            before, after = self.unseen(plain, held), self.unseen(fit, held)
            if self._lost(before, after, held):
                before, after = (self.errors(_without(f, held, exact=True))[held] for f in (plain, fit))
                found += self._lost(before, after, held)
            saved += np.sum(before**2 - after**2, axis=0)
        if self.halves and not self.several:
            return found  # of two halves neither is one out of many
        most = dict(zip(self.model.rig.predict, TOLL * saved, strict=True))
        return [loss for loss in found if not loss.cost < most[loss.channel]]

    def _lost(self, before: np.ndarray, after: np.ndarray, block: np.ndarray) -> list[Loss]:
        rig, held = self.model.rig, np.flatnonzero(block)
        runs = np.split(held, np.flatnonzero(np.diff(held) > 1) + 1)
        name, time = "", self.model.recording.time
        if self.several:
            k = int(self.fold[held[0]])
            name = self.model.recording.runs[k].name
            runs = [] if np.array_equal(block, self.fold == k) else runs
        spans = tuple((float(time[run[0]]), float(time[run[-1]] + rig.dt)) for run in runs)
        out = []
        for i, channel in enumerate(rig.predict):
            was, now = (float(np.sqrt(np.mean(e[:, i] ** 2))) for e in (before, after))
            worse = not now <= (1.0 + HALF) * was if self.halves else errs_more(before[:, i], after[:, i])
            if np.isfinite(was) and worse:
                cost = float(np.sum(after[:, i] ** 2 - before[:, i] ** 2))
                out.append(Loss(channel, rig.channels[channel].unit, spans, was, now, name, cost=cost))
        return out

    def throughout(self, plain: Fit, fit: Fit) -> list[Loss]:
        """Every channel on which `fit` is worse than `plain` over all blocks together, by chance or not."""
        both = [np.concatenate([self.unseen(f, held) for held in self.blocks(plain, fit)]) for f in (plain, fit)]
        found = []
        for i, channel in enumerate(self.model.rig.predict):
            was, now = (float(np.sqrt(np.mean(e[:, i] ** 2))) for e in both)
            if np.isfinite(was) and not now <= (1.0 + MORE) * was:
                found.append(Loss(channel, self.model.rig.channels[channel].unit, (), was, now))
        return found

    def total(self, fit: Fit, exact: bool = False) -> float:
        """Squared error of a fit over that of the data sheet's plant, in the mean over channels, not learnt from.

        exact: as for `unseen`.
        """
        sheet = self.errors({})
        if not np.isfinite(sheet).all():
            return 0.0
        error = self.unlearnt(fit, exact)
        return float(np.mean(np.mean(error**2, axis=0) / (np.mean(sheet**2, axis=0) + TINY)))

    def unlearnt(self, fit: Fit, exact: bool = False) -> np.ndarray:
        """Errors of a fit, each block by the fit to the others (samples of all blocks, channels)."""
        return np.concatenate([self.unseen(fit, held, exact) for held in self.blocks(fit, fit)])

    def no_better(self, plain: Fit, fit: Fit, exact: bool = False) -> str:
        """Why `fit` does not earn to be worn in place of `plain`, on blocks not learnt from; empty where it does.

        Its squared error must be smaller, in the mean over channels each by that of `plain`, and no channel's larger by
        more than chance makes of it. So it must be where both did learn: a fit that has not converged may run worse
        than those to its blocks.
        """
        blocks = self.blocks(plain, fit)
        before, after = (np.concatenate([self.unseen(f, held, exact) for held in blocks]) for f in (plain, fit))
        if why := self._not_less(before, after, "where not learnt from"):
            return why
        return self._not_less(self.errors(plain.values), self.errors(fit.values), "where it was learnt from")

    def _not_less(self, before: np.ndarray, after: np.ndarray, where: str) -> str:
        """Why errors (samples, channels) are no smaller than others, in words; empty where they are."""
        ratio = squared(before, after)
        less = "" if np.mean(ratio) < 1.0 else f"with it the error of the run is no smaller {where}"
        return larger(self.model.rig.predict, before, after, where) or less

    def overfitted(self, fit: Fit) -> str:
        """What of a fit does not hold on blocks that it did not learn from, in words; empty where all does.

        By a one-sided test at the level CHANCE, all channels together: paired differences of the squared errors of
        each block with and without that block among what is learnt from. What linearised fits show is fitted again.
        A run that errs though its parameters are the same, within chance, is one that little leads astray.
        """
        if not (self._overfitted(fit, exact=False) and any(_moved(fit, held) for held in self.blocks(fit, fit))):
            return ""
        return self._overfitted(fit, exact=True)

    def _overfitted(self, fit: Fit, exact: bool) -> str:
        found, whole = [], self.errors(fit.values)
        pairs = [(whole[held], self.unseen(fit, held, exact)) for held in self.blocks(fit, fit)]
        for i, channel in enumerate(self.model.rig.predict):
            draws = np.array([_draws(before[:, i], after[:, i]) for before, after in pairs]).reshape(-1, 2)
            learnt, unseen = draws.mean(axis=0)
            times = float(np.sqrt(unseen / (learnt + TINY)))
            more = draws[:, 1] - draws[:, 0]
            error = more.std(ddof=1) / np.sqrt(len(more)) + TINY
            level = CHANCE / len(self.model.rig.predict)
            if not times <= NEXT and not t.sf(more.mean() / error, len(more) - 1) > level:
                found.append((times, channel))
        if not found:
            return ""
        times, channel = max(found)
        where = f"of {channel} where not learnt from"
        return f"the parameters explain this recording, not the next: {times:.2g} times the error {where}"

    def share(self, plain: Fit, without: Fit, fit: Fit) -> float:
        """The share of the squared error of `plain` that `fit` has less than `without`, in the mean over channels.

        At most 1: a run without it may err more than the plain one.
        """
        squared = [np.mean(self.errors(f.values) ** 2, axis=0) for f in (plain, without, fit)]
        return min(float(np.mean((squared[1] - squared[2]) / (squared[0] + TINY))), 1.0)


def _draws(before: np.ndarray, after: np.ndarray) -> list[tuple[float, float]]:
    """Mean squares of two series of errors (samples,) over some parts of a block, one pair a part."""
    parts = zip(*(np.array_split(e**2, min(ROUNDS * PARTS, len(e))) for e in (before, after)), strict=True)
    return [(float(np.mean(one)), float(np.mean(other))) for one, other in parts]


def squared(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Squared errors over others (channels,), both given as errors (samples, channels)."""
    return np.mean(after**2, axis=0) / (np.mean(before**2, axis=0) + TINY)


def larger(channels: Sequence[str], before: np.ndarray, after: np.ndarray, where: str, by: float = np.inf) -> str:
    """Why errors (samples, channels) are larger than others by more than chance, or than `by`, in words; else empty."""
    if not np.isfinite(after).all():
        return f"with it the run diverges {where}"
    for channel, was, now, ratio in zip(channels, before.T, after.T, np.sqrt(squared(before, after)), strict=True):
        if ratio > 1.0 + by or errs_more(was, now):
            return f"with it {channel} is {PERCENT * (ratio - 1):.2g} % worse {where}"
    return ""


def errs_more(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether errors (samples,) are larger than others, by more than MORE and than chance."""
    if not np.isfinite(after).all():
        return True
    if not np.mean(after**2) > (1.0 + MORE) ** 2 * np.mean(before**2):
        return False
    draws = min(ROUNDS * PARTS, len(after))
    if draws < FEWEST_DRAWS:
        return False
    parts = [np.mean(p) for p in np.array_split(after**2 - before**2, draws)]
    return bool(np.mean(parts) > SURE * np.std(parts, ddof=1) / np.sqrt(len(parts)))


def _without(fit: Fit, held: np.ndarray, exact: bool) -> dict[str, float]:
    """Values of a fit to all samples but those `held` (samples,): in full, or by one linearised step.

    What is a recording's own stays as it is where all of that recording is held.
    """
    if not fit.unknowns:
        return fit.values
    if own := _own(fit, held):
        shared = [j for j, u in enumerate(fit.unknowns) if u.symbol not in own]
        less = replace(
            fit,
            unknowns=tuple(fit.unknowns[j] for j in shared),
            numbers=fit.numbers[shared],
            weight=fit.weight[shared],
            fixed={**fit.fixed, **own},
        )
        vars(less).update(slopes=fit.slopes[:, :, shared], projected=fit.projected, basis=fit.basis)
        if exact:
            vars(less)["moves"] = fit.moves
        return _without(less, held, exact) if shared else fit.values
    if exact:
        return fit.without(held, REFIT)
    numbers = fit.numbers + fit.step(_learnt(fit, held))
    return {**fit.values, **{u.symbol: float(u.value(n)) for u, n in zip(fit.unknowns, numbers, strict=True)}}


def _moved(fit: Fit, held: np.ndarray) -> bool:
    """Whether the parameters are others, by more than chance, if a block is not learnt from (Wald's test)."""
    values = _without(fit, held, exact=True)
    away = np.array([u.number(values[u.symbol]) - n for u, n in zip(fit.unknowns, fit.numbers, strict=True)])
    slopes = flattened(fit.slopes[_learnt(fit, held)])
    information = slopes.T @ slopes + np.diag(fit.weight)
    squared = float(away @ information @ away) / max(1.0, float(np.mean(fit.projected**2)))
    return squared > chi2.isf(CHANCE, max(len(away), 1))


def _learnt(fit: Fit, held: np.ndarray) -> np.ndarray:
    """The windows (windows,) of a fit whose middle does not lie in a block (samples,)."""
    likelihood = fit.likelihood
    ends = np.arange(1, likelihood.windows + 1) * likelihood.block - 1
    return ~held[np.arange(len(held))[likelihood.kept][ends - likelihood.block // 2]]


def _own(fit: Fit, held: np.ndarray) -> dict[str, float]:
    """The unknowns that belong to recordings of which all samples are `held`, with their values."""
    model = fit.likelihood.model
    names = [run.name for run, p in zip(model.recording.runs, model.pieces, strict=True) if held[p].all()]
    own = [u.symbol for u in fit.unknowns if IN in u.symbol and u.symbol.partition(IN)[2] in names]
    return {symbol: fit.values[symbol] for symbol in own}


def _turns(samples: int, folds: int = FOLDS, rounds: int = ROUNDS) -> np.ndarray:
    """The number of the block in which each sample lies (samples,): blocks are spread, by turns."""
    return np.arange(samples) * folds * rounds // samples % folds
