"""Which hypothesis a recording supports whose noise nobody stated.

The steps are those of `selection`. What differs is the price: an effect must pay for its parameters and for the number
of hypotheses, and it must also predict blocks of the recording that were held out of its fit.
"""

import copy
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import takewhile

import numpy as np

from greygate.mismatch.adequacy import dependent
from greygate.mismatch.blocks import Judge
from greygate.mismatch.claims import Claims
from greygate.mismatch.coloured import Coloured, coloured_likelihood, remaining, resized
from greygate.mismatch.evidence import unseen
from greygate.mismatch.fit import Fit, Likelihood
from greygate.mismatch.model import TINY, beginnings
from greygate.mismatch.search import ROUGH, Hypothesis, Score, Search
from greygate.mismatch.selection import PART, Found, Selection, forms
from greygate.progress import Progress, cut, silent

EFFECTS = 4  # in a hypothesis, at most
ORDERINGS = 2  # times the order of the noise is chosen: for what the data sheet's plant leaves, then for a better fit
TRIED, FITTED = 5, 4  # hypotheses of a round that are fitted to the run, by each of two scores; with its noise, too
ALIKE = 0.01  # of what is unexplained: a run in longer steps of time that differs by less ranks hypotheses as well
DRAWS = 50  # from the data sheet's tolerance, the best of which starts a fit
RIVALS, NEAR = 4, 0.1  # of what the best run saves, within which others are rivals; so many are fitted in full
EXCHANGED = 3  # hypotheses that are tried in the place of an earlier one
SURE = 10.0  # of cost that an effect must save beyond what its parameters and the number of hypotheses cost
FOLDS = 5  # of the recording, held out in turn
BLOCKS = 4  # of a fold
FAR_LESS = 0.5  # of the squared error that names leave: a term that leaves no more of it stands in their place


class ColouredSelection(Selection):
    """The hypotheses fitted to one recording, each with a noise of its own."""

    most = EFFECTS

    def __init__(self, search: Search, progress: Progress = silent):
        calibrated = _calibrated(search)
        search.final = search.screen = calibrated.likelihood
        search.effects = {key: resized(calibrated.likelihood, e, calibrated) for key, e in search.effects.items()}
        super().__init__(search, calibrated.likelihood, calibrated, progress)
        self.plain, self.calibrated = calibrated, calibrated.values
        self.fits = {Hypothesis(): calibrated}
        self.runs: dict[Hypothesis, Fit] = {}  # fitted to the run itself, as if its errors were white
        self._at, self._begun_at = calibrated, set[tuple]()  # from where runs were fitted last, and from what values
        self._full: dict[Hypothesis, tuple[Fit, Fit]] = {}  # of these the run, and the fit that began at it
        self._promising: dict[tuple, tuple[Fit, tuple[list[Score], list[Score]]]] = {}
        self.anew = set(beginnings(search.final.model))

    # -- what a diagnosis asks ---------------------------------------------------------------------------------------

    def searched(self) -> Found:
        alike = self._misled()
        if alike:
            self._alike(self.plain)
        best, fit = self.forward(Hypothesis(), self.plain, self.plain)
        best, fit = self.backward(*self.among_kin(best, fit))
        if best.size and alike:
            self._alike(fit)
            best, fit = self.backward(*self.forward(best, self.fits[best], self.fits[best]))
        self._beside(best, fit)
        return Found(best, fit, fit, self)

    def _misled(self) -> bool:
        """Whether noise with a memory undoes most of what the best effect removes of the run's error.

        It passes over all that is slow, and where a plant forgets soon, what is missing is as slow as what drives it.
        """
        nothing = Hypothesis()
        found = self._rough(nothing, self.plain, self.promising(self.plain, nothing, TRIED)[0])
        if not found:
            return False
        best, run = found[0]
        fit = self.fits[best] = self._fitted(self.plain, best, run)
        before, least, now = map(_squared, (self.run(nothing, self.plain), run, fit))
        saved, kept = np.mean(1.0 - least / before), np.mean(1.0 - now / before)
        return bool(saved > PART and kept < PART * saved)

    def _alike(self, fit: Fit) -> None:
        """Every fit anew, in which errors have no memory but count as seldom as those of `fit` have forgotten."""
        likelihood = coloured_likelihood(fit).alike(fit.likelihood.residual(fit.values))
        self.fits = {h: self.search.fit(likelihood, h, f.values, enough=ROUGH) for h, f in self.fits.items()}
        self.plain, self.runs, self._begun_at = self.fits[Hypothesis()], {}, set()

    def _beside(self, best: Hypothesis, fit: Fit) -> None:
        """Fit in full what comes as near to the recording as the best: it may be a rival."""
        if not best.size:
            return
        saved = self.run(Hypothesis(), self.plain).cost - self.run(best, fit).cost
        near = {h: run for h, run in self.runs.items() if h.size == best.size and h not in self.fits}
        for hypothesis in sorted(near, key=lambda h: near[h].cost)[:RIVALS]:
            if near[hypothesis].cost < self.runs[best].cost + NEAR * saved and not self.search.skips(hypothesis):
                self.fits[hypothesis] = self.fitted(fit, hypothesis, near[hypothesis].values)

    def claimable(self, found: Found) -> Found:
        return found

    def again(self, found: Found, claims: Claims) -> Found:
        self.fits.setdefault(claims.best, claims.fit)
        return Found(claims.best, claims.fit, claims.fit, self)

    def refit(self, less: Hypothesis, from_: Fit) -> Fit:
        starts = [(from_.likelihood, from_.values)]
        if less in self.fits:  # of all of the recording, or of the part that was searched
            found, here = self.fits[less], from_.likelihood
            starts.append(
                (found.likelihood if found.likelihood.model.recording is here.model.recording else here, found.values)
            )
        return min((self.search.fit(likelihood, less, values) for likelihood, values in starts), key=lambda f: f.cost)

    def left(self, fit: Fit) -> str:
        """What the innovations of a free run go with; where they go with nothing, what its errors go with."""
        likelihood = coloured_likelihood(fit)
        if not likelihood.order:
            likelihood = likelihood.ordered(likelihood.residual(fit.values))
            fit = replace(fit, likelihood=likelihood, errors=likelihood.errors(fit.values, fit.shifts))
        return dependent(fit) or remaining(fit)

    def structure(self, fit: Fit) -> dict[str, float]:
        return {}

    def open(self, found: Found, left: str = "") -> bool:
        return bool(left)

    def excess(self, found: Found) -> float:
        return np.inf

    def promises(self, found: Found) -> bool:
        return False

    def outdone(self, best: Hypothesis, explained: float, share: float, named: Fit, closed: Fit | None) -> bool:
        """Whether a term leaves far less of the squared error than what is named, on blocks not learnt from."""
        if closed is None or share <= 0.0:
            return False
        left = (Judge(fit.likelihood).total(fit, exact=True) for fit in (closed, named))
        return next(left) <= FAR_LESS * next(left)

    def explained(self, found: Found, calibrated: Fit) -> float:
        """The share of the squared error in free run that is removed, in the mean over channels."""
        before, after = (np.mean(f.likelihood.residual(f.values) ** 2, axis=0) for f in (calibrated, found.fit))
        return float(np.mean(1.0 - after / np.maximum(before, TINY)))

    def rivals(self, found: Found) -> dict[Hypothesis, float]:
        return {hypothesis: fit.cost for hypothesis, fit in self.fits.items()}

    # -- steps -------------------------------------------------------------------------------------------------------

    def done(self, best: Hypothesis, current: Fit) -> bool:
        return False

    def proposed(self, best: Hypothesis, current: Fit, start: Fit) -> Iterator[tuple[Hypothesis, Fit]]:
        """Those of the most promising hypotheses that pay their price, the one that saves most beyond it first.

        Rare effects are fitted only where none of the others is taken.
        """
        effects = self.search.effects.values()
        counts = sum(not effect.rare for effect in effects), len(effects)
        for ranked, count in zip(self.promising(current, best, TRIED), counts, strict=True):
            ranked = [s for s in ranked if not set(s.hypothesis.released) & self.anew]
            self.progress(f"fitting {len(ranked)} hypotheses")
            yield from self._paying(best, current, ranked, SURE + 2 * np.log(max(count, 1)))

    def _paying(
        self, best: Hypothesis, current: Fit, ranked: list[Score], price: float
    ) -> Iterator[tuple[Hypothesis, Fit]]:
        """The fits of `best` with one of `ranked` that save more than `price` and than their parameters cost.

        Those whose run errs least come first: an autoregression may take what is missing for noise. Of runs that do
        nearly alike it says which is likelier.
        """
        rough = self._rough(best, current, ranked)[:FITTED]
        if not rough:
            return
        before = self.run(best, current).cost
        near = (1.0 - NEAR) * (before - rough[0][1].cost)
        found = []
        for hypothesis, run in rough:
            fit = self._fitted(current, hypothesis, run)
            if fit.cost < getattr(self.fits.get(hypothesis), "cost", np.inf):
                self.fits[hypothesis] = fit
            asked = price + _price(fit, current)
            if current.cost - fit.cost > asked:
                found.append((before - run.cost < near, fit.cost + asked, hypothesis, fit))
        for *_, hypothesis, fit in sorted(found, key=lambda f: f[:2]):
            yield hypothesis, fit

    def _rough(self, best: Hypothesis, current: Fit, ranked: list[Score]) -> list[tuple[Hypothesis, Fit]]:
        """`best` with each of `ranked`, fitted to the run itself in long steps of time; the best of them first."""
        quick = quicker(_white(current), current.values)
        if current is not self._at:
            self._at, self._begun_at, self._full = current, set(), {}
        found: dict[Hypothesis, None] = {}  # in order: costs may tie
        for score in ranked:
            hypothesis = best.plus(score.hypothesis)
            for values in (score.values, *score.others):
                begin = (hypothesis, *values.items())
                if begin not in self._begun_at:
                    if self.search.skips(hypothesis):
                        break
                    self._begun_at.add(begin)
                    self._begun(quick, hypothesis, {**current.values, **values})
                found[hypothesis] = None
        runs = {h: self.runs[h] for h in found}
        return sorted(runs.items(), key=lambda f: f[1].cost + _price(f[1], current))

    def _fitted(self, current: Fit, hypothesis: Hypothesis, run: Fit) -> Fit:
        """The full fit of one of the runs that were fitted from `current` on."""
        if self._full.get(hypothesis, (None,))[0] is not run:
            self._full[hypothesis] = run, self.fitted(current, hypothesis, run.values)
        return self._full[hypothesis][1]

    def _begun(self, quick: Coloured, hypothesis: Hypothesis, values: Mapping[str, float]) -> Hypothesis:
        """The hypothesis, its run fitted from `values` on; that of a first effect also from the best of some draws.

        The parameters of a plant that lacks something may be far off.
        """
        starts = [values, drawn(self.search, quick, hypothesis, values)] if hypothesis.size == 1 else [values]
        fits = [self.search.fit(quick, hypothesis, start, enough=ROUGH) for start in starts]
        fits += [self.runs[hypothesis]] if hypothesis in self.runs else []
        self.runs[hypothesis] = min(fits, key=lambda f: f.cost)
        return hypothesis

    def run(self, hypothesis: Hypothesis, fit: Fit) -> Fit:
        """The fit of a hypothesis to the run itself, near `fit`."""
        if hypothesis not in self.runs:
            quick = quicker(_white(fit), fit.values)
            self.runs[hypothesis] = self.search.fit(quick, hypothesis, fit.values, enough=ROUGH)
        return self.runs[hypothesis]

    def pays(self, best: Hypothesis, current: Fit, hypothesis: Hypothesis, fit: Fit) -> bool:
        """Whether `hypothesis` does better on blocks that were held out of the fits, and in most folds.

        The blocks of a fold are spread over the recording, so that no regime is held out entirely. The run errs less
        there, or it is likelier with the noise: a few slow errors are much in the one, nothing in the other. What
        linearised fits refuse is fitted again.
        """
        self.progress(f"holding out blocks from {hypothesis}")
        runs = self.run(best, current), self.run(hypothesis, fit)
        return any(_foretells(*both, exact) for exact in (False, True) for both in (runs, (current, fit)))

    def exchanged(self, best: Hypothesis, current: Fit) -> tuple[Hypothesis, Fit]:
        """The same with earlier effects replaced by others that do better now that the last one is there."""
        for drop in best.effects[:-1]:
            best, current = self._replaced(best, current, drop, lambda plain, rare: plain)
        return self._in_form(best, current)

    def from_the_sheet(self, best: Hypothesis, fit: Fit) -> tuple[Hypothesis, Fit]:
        if best.size != 1 or not best.effects:
            return best, fit
        fit = self._anew(best, fit)
        for other in [best, *(form for form, _ in forms(self.search, best, fit.values))]:
            if not self.left(fit) or not self.search.leads or self.search.skips(other):
                continue
            self.progress(f"fitting {other} from the beginning on")
            again = self._led(other, coloured_likelihood(fit).order)
            if again.cost < fit.cost - SURE:
                self.runs.pop(other, None)
                self.fits[other] = again
                best, fit = other, again
        return best, fit

    def _led(self, hypothesis: Hypothesis, order: int) -> Fit:
        """The fit that is led from the data sheet, and from the recording's beginning to its end."""
        begun = self.search.fit(_white(self.plain), hypothesis, {}, iterations=0)
        run = self.search.from_the_sheet(begun)
        if not np.isfinite(run.cost):
            return run
        likelihood = coloured_likelihood(run).learnt(run.likelihood.residual(run.values), order)
        return self.search.fit(likelihood, hypothesis, run.values, enough=ROUGH)

    def _anew(self, best: Hypothesis, fit: Fit) -> Fit:
        """The fit of a first effect, or a better one from the data sheet on, where something is left.

        What was calibrated without it makes up for it, and a fit that begins there may end in a local minimum.
        """
        if not self.left(fit) or self.search.skips(best):
            return fit
        sheet = self.plain.likelihood.fit(self.plain.unknowns, iterations=0)
        own = {f.symbol for key in best.effects for f in self.search.effects[key].free}
        again = self.fitted(sheet, best, {s: v for s, v in fit.values.items() if s in own})
        if not again.cost < fit.cost - SURE:
            return fit
        self.runs.pop(best, None)
        self.fits[best] = again
        return again

    def _in_form(self, best: Hypothesis, current: Fit) -> tuple[Hypothesis, Fit]:
        """The same with the effect that was added last in another of its forms, which begins where that one ended.

        A richer form may fit badly from its own guesses and well from what the plainest has found.
        """
        quick, kept = quicker(_white(current), current.values), None
        while kept != best:
            kept = best
            for other, values in forms(self.search, best, current.values, best.effects[-1:]):
                if not self.search.skips(other):
                    self._begun(quick, other, values)
                    best, current = self._better(best, current, current, other, self.runs[other])
        return best, current

    def _better(
        self, best: Hypothesis, current: Fit, start: Fit, other: Hypothesis, rough: Fit
    ) -> tuple[Hypothesis, Fit]:
        """The other hypothesis, of the run `rough`, fitted from `start` on; the best one where it does no better."""
        here = self.run(best, current)
        if set(other.effects) == set(best.effects) or rough.cost + _price(rough, here) > here.cost:
            return best, current
        fit = self.fits[other] = self.fitted(start, other, rough.values)
        return (other, fit) if fit.cost + _price(fit, current) < current.cost else (best, current)

    def among_kin(self, best: Hypothesis, current: Fit) -> tuple[Hypothesis, Fit]:
        """The same with any replaced by a rare one that acts where it acts, as a late channel by its sensor's lag."""
        for drop in best.effects:
            kin = set(self._kin(drop))
            if kin:
                best, current = self._replaced(
                    best, current, drop, lambda plain, rare, kin=kin: [s for s in rare if kin & {*s.hypothesis.effects}]
                )
        return best, current

    def _replaced(
        self, best: Hypothesis, current: Fit, drop: str, of: Callable[..., list[Score]]
    ) -> tuple[Hypothesis, Fit]:
        """The same with the effect `drop` replaced by what does better, `of` the promising and the rare ones."""
        less = best.without(drop)
        without = self.fits.get(less) or self.search.fit(current.likelihood, less, current.values)
        self.fits[less] = without
        others = [s for s in of(*self.promising(without, less, EXCHANGED)) if s.hypothesis.effects]
        others = [s for s in others if less.plus(s.hypothesis) not in self.fits]
        for hypothesis, rough in self._rough(less, without, others):
            best, current = self._better(best, current, without, hypothesis, rough)
        return best, current

    def _kin(self, key: str) -> list[str]:
        """Rare effects where that one acts, of no more numbers."""
        effects, one = self.search.effects, self.search.effects[key]
        alike = (k for k, e in effects.items() if e.rare and e.equations == one.equations)
        return [k for k in alike if len(effects[k].free) <= len(one.free)]

    def backward(self, best: Hypothesis, current: Fit) -> tuple[Hypothesis, Fit]:
        """Drop the effects that no longer pay, and richer forms than what is beside them asks for."""
        for key in best.effects:
            for other, values in forms(self.search, best, current.values, (key,)):
                if len(self.search.unknowns(other)) >= len(current.unknowns) or self.search.skips(other):
                    continue
                fit = self.fits[other] = self.search.fit(current.likelihood, other, values)
                if fit.cost - current.cost < SURE + _price(current, fit):
                    best, current = other, fit
                    break
        for drop in (*best.effects, *best.released):
            if best.size < 2:
                break
            less = best.without(drop)
            fit = self.fits[less] = self.search.fit(current.likelihood, less, current.values)
            if fit.cost - current.cost < SURE + _price(current, fit):
                best, current = less, fit
        exact = self.search.fit(current.likelihood, best, current.values)
        self.fits[best] = min(current, exact, key=lambda f: f.cost)
        return best, self.fits[best]

    # -- fits --------------------------------------------------------------------------------------------------------

    def promising(self, fit: Fit, given: Hypothesis, count: int) -> tuple[list[Score], list[Score]]:
        """The `count` hypotheses of best score under the noise of `fit`, and as many under white noise; and rare ones.

        Noise that is learnt from a wrong plant takes its slow errors for noise, and would rank their cause last.
        """
        asked = (id(fit), given, count)
        if asked in self._promising:
            return self._promising[asked][1]
        likelihood = _white(fit)
        white = replace(fit, likelihood=likelihood, errors=likelihood.errors(fit.values, fit.shifts))
        found: tuple[list[Score], list[Score]] = ([], [])
        for f in (fit, white):
            scores = self.search.scores(f, given)
            leading = list(takewhile(self._odd, scores))[:count]
            for rare, those in enumerate(found):
                those += [*leading, *(s for s in scores if self._rare(s) is bool(rare) and s not in leading)][:count]
        self._promising = {asked: (fit, found)}  # with the fit, whose id no other may have meanwhile
        return found

    def _rare(self, score: Score) -> bool:
        return any(self.search.effects[key].rare for key in score.hypothesis.effects)

    def _odd(self, score: Score) -> bool:
        """Whether it is of a rare effect of the plant: such a one is tried first where it promises more than all."""
        return self._rare(score) and not any(self.search.effects[key].fault for key in score.hypothesis.effects)

    def fitted(self, fit: Fit, hypothesis: Hypothesis, values: Mapping[str, float]) -> Fit:
        """The better of two fits from `values` on: with the noise of `fit`, and with white noise first."""
        search, start = self.search, {**fit.values, **values}
        found = [search.fit(fit.likelihood, hypothesis, start, enough=ROUGH)]
        plain = search.fit(_white(fit), hypothesis, start, enough=ROUGH)
        if np.isfinite(plain.cost):
            order = coloured_likelihood(fit).order
            coloured = coloured_likelihood(plain).learnt(plain.likelihood.residual(plain.values), order)
            found.append(search.fit(coloured, hypothesis, plain.values, enough=ROUGH))
        best = min(found, key=lambda f: f.cost)
        return search.led(best) if np.isfinite(best.cost) else best


def selected(search: Search, progress: Progress = silent) -> Selection:
    """The selection over a search, by what is known of its noise."""
    if isinstance(search.final, Coloured):
        return ColouredSelection(search, progress)
    return Selection(search, search.screen, search.base(search.screen), progress)


def _calibrated(search: Search) -> Fit:
    """The fit of the plant without effects, and of the noise that this leaves."""
    nothing = Hypothesis()
    fit = search.led(search.fit(search.final, nothing, drawn(search, search.final, nothing, {})))
    for _ in range(ORDERINGS):
        likelihood = coloured_likelihood(fit).ordered(fit.likelihood.residual(fit.values))
        fit = search.fit(likelihood, nothing, fit.values)
    return fit


def _foretells(less: Fit, more: Fit, exact: bool) -> bool:
    """Whether `more` is likelier than `less` in folds that both did not learn from: in most, and in all but the worst.

    That may hold the only stretch from which it is learnt.
    """
    windows = more.likelihood.windows
    fold = (np.arange(windows) * FOLDS * BLOCKS // windows) % FOLDS
    costs = [[unseen(fit, fold != k, fold == k, exact) for fit in (less, more)] for k in range(FOLDS)]
    saved = np.sort([before - after for before, after in costs])
    return bool(np.sum(saved[1:]) > 0 and np.sum(saved > 0) > FOLDS / 2)


def quicker(likelihood: Coloured, values: Mapping[str, float]) -> Coloured:
    """A likelihood in the longest steps of time in which the run is practically the same."""
    model, other = likelihood.model, copy.copy(likelihood)
    error = np.std(likelihood.residual(values), axis=0)
    for steps in model.longer_steps:
        other.model = model.in_steps(steps)
        if np.all(np.std(other.residual(values) - likelihood.residual(values), axis=0) <= ALIKE * error):
            return other
    return likelihood


def _white(fit: Fit) -> Coloured:
    """The likelihood of `fit` with white noise as large as its residual."""
    return coloured_likelihood(fit).learnt(fit.likelihood.residual(fit.values), 0)


def _squared(fit: Fit) -> np.ndarray:
    """Mean squared errors of the run (channels,)."""
    return np.mean(fit.likelihood.residual(fit.values) ** 2, axis=0) + TINY


def _price(more: Fit, less: Fit) -> float:
    """What BIC asks for the parameters that one fit has and the other has not."""
    return (len(more.unknowns) - len(less.unknowns)) * np.log(more.likelihood.count)


def drawn(
    search: Search, likelihood: Likelihood, hypothesis: Hypothesis, values: Mapping[str, float]
) -> dict[str, float]:
    """`values`, and the best of DRAWS sets of the other parameters, drawn within the data sheet's tolerance."""
    rng = np.random.default_rng(0)
    own = {u.symbol: u for u in search.unknowns(hypothesis) if u.symbol in search.toleranced}
    constants = search.constants(hypothesis)
    best, least = dict(values), np.inf
    draws = [rng.uniform(-2.0, 2.0, len(own)) * (k > 0) for k in range(DRAWS)]  # the data sheet itself comes first
    with cut():
        for numbers in draws:
            each = zip(own.items(), numbers, strict=True)
            tried = {s: float(np.clip(u.value(x), u.low, u.high)) for (s, u), x in each}
            residual = likelihood.residual({**constants, **tried, **values})
            cost = float(np.sum(np.mean(residual**2, axis=0) / np.var(likelihood.model.target, axis=0)))
            if cost < least:
                best, least = {**tried, **values}, cost
    return best
