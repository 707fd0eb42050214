"""Which hypothesis a recording bears out.

Forward selection over the hypotheses of `search`; pairs, where one effect after the other leaves something; backward
elimination; and the rivals and forms that short windows leave, compared over long ones.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import cached_property

import numpy as np

from greygate.mismatch.effects import Effect
from greygate.mismatch.fit import Fit, Likelihood
from greygate.mismatch.model import BLUR
from greygate.mismatch.search import Hypothesis, Score, Search

EVIDENCE = 30.0  # of cost, robust, that an effect must save; some thirty hypotheses are tried
EFFECTS = 3  # at most
STRUCTURE = 0.3  # of slow error over white error, above which structure is left
SLOW = 0.02  # s of a mean that tells slow errors from white ones
BLURRED = 0.2  # s of it where an effect acts by acceleration, whose jumps are known to some 20 ms
FLOOR = 0.92  # of the count of readings: cost of a fit that leaves nothing
FIRST, LATER = 6, 4  # hypotheses of the first round and of later ones that are fitted in full
STALLED = 0.1  # of what the best saves: cost above it of a fit that gave up, and is a rival too
FAR = 0.3  # of the most promising hypothesis's gain
NEARLY = 0.95  # of the gain that the plain form of an effect promises, that of another form counts
OWN = 0.05  # of what can be explained, which a second effect must explain by itself where the two leave something
PAIR = 0.5  # or of what the first effect leaves
LEAST = 5e-3  # of what can be explained, which an effect must explain beside one that acts by acceleration
AHEAD = 0.1  # of what it saves there, if that is below OWN, by which it must do so better than any other
NEAR, RIVALS = 0.05, 6  # of the count of readings: cost above the best; how many rivals see longer windows


class Selection:
    """Hypotheses fitted to one problem. say: called with what is being done; start: from which nothing is fitted.

    costs: the least of each. fits: the best of each that is possible. best: of those, by size.
    """

    def __init__(self, search: Search, problem: Likelihood, start: Fit, say: Callable[[str], None]):
        self.search, self.problem, self.start, self.say = search, problem, start, say
        self.costs: dict[Hypothesis, float] = {}
        self.fits: dict[Hypothesis, Fit] = {}
        self.best: dict[int, tuple[Hypothesis, Fit]] = {}

    @cached_property
    def plain(self) -> Fit:
        """The calibrated plant, with nothing added."""
        shifts = self.start.shifts if self.start.problem is self.problem else None
        enough = EVIDENCE / 10
        fit = self.search.fit(self.problem, Hypothesis(), self.start.values, shifts, enough=enough)
        self.add(Hypothesis(), fit)
        return fit

    def add(self, hypothesis: Hypothesis, fit: Fit, possible: bool = True) -> None:
        self.costs[hypothesis] = min(fit.cost, self.costs.get(hypothesis, np.inf))
        if possible and fit.cost == self.costs[hypothesis]:
            self.fits[hypothesis] = fit
        _, before = self.best.get(hypothesis.size, (None, None))
        if possible and (before is None or fit.cost < before.cost):
            self.best[hypothesis.size] = (hypothesis, fit)

    def fit(
        self, hypothesis: Hypothesis, values: Mapping[str, float], shifts, new: Hypothesis | None = None, **options
    ):
        """(fit of `hypothesis` from `values` on, whether what is `new` in it is physically possible)."""
        self.say(f"fitting {hypothesis}")
        fit = self.search.fit(self.problem, hypothesis, values, shifts, **options)
        allowed = possible(self.search, new or hypothesis, fit)
        self.add(hypothesis, fit, allowed)
        return fit, allowed

    # -- steps -------------------------------------------------------------------------------------------------------

    def forward(self, best: Hypothesis, current: Fit, start: Fit) -> tuple[Hypothesis, Fit]:
        """One effect or released parameter more as long as it pays. start: where scores are taken first."""
        while best.size < EFFECTS and not (best.size and whole(current)):
            found = self._added(best, current, start)
            if not found:
                break
            hypothesis, fit = min(found, key=_cost)
            if not whole(fit):
                hypothesis, fit = self.reshape(hypothesis, fit)
            enough = LEAST * self.explicable(self.plain) if blurred(current) else 0.0
            if current.cost - fit.cost < max(EVIDENCE * inflation(fit), enough) or fit.held_out() > current.held_out():
                break
            best, current, start = hypothesis, fit, fit
        return best, current

    def _added(self, best: Hypothesis, current: Fit, start: Fit) -> list[tuple[Hypothesis, Fit]]:
        """`best` with each of the most promising hypotheses added."""
        ranked = alternatives(self.search, self.search.scores(self.problem, start, best))
        self.say(f"scored {len(ranked)} hypotheses")
        ranked = [forms for forms in ranked if forms[0].gain > EVIDENCE / 3][: LATER if best.size else FIRST]
        found: list[tuple[Hypothesis, Fit]] = []
        for forms in ranked:
            most = ranked[0][0].gain
            if found and forms[0].gain < FAR * most and whole(min(found, key=_cost)[1]):
                break  # one explains all, and this one promises little
            for score in forms:
                hypothesis = best.plus(score.hypothesis)
                rival = min(map(_cost, found), default=np.inf)
                values = {**start.values, **score.values}
                fit, allowed = self.fit(hypothesis, values, start.shifts, score.hypothesis, rival=rival)
                if fit.cost > current.cost and score.gain > NEARLY * most:
                    fit, allowed = self.restarted(hypothesis, score, start, fit)
                if allowed:
                    found.append((hypothesis, fit))
                    break
        return found

    def restarted(self, hypothesis: Hypothesis, score: Score, start: Fit, worse: Fit) -> tuple[Fit, bool]:
        """A fit worse than one with less came to a local minimum: once more, from where there is no effect."""
        effects = [self.search.effects[key] for key in score.hypothesis.effects]
        strengths = {f.symbol for effect in effects for f in effect.strengths}
        shapes = {s: v for s, v in score.values.items() if s not in strengths and not score.hypothesis.released}
        again, _ = self.fit(hypothesis, {**start.values, **shapes}, start.shifts, score.hypothesis)
        better = min(worse, again, key=lambda fit: fit.cost)
        return better, possible(self.search, score.hypothesis, better)

    def reshape(self, best: Hypothesis, fit: Fit) -> tuple[Hypothesis, Fit]:
        """Put every effect of `best` in the form in which it fits best, where another form is better by enough."""
        for key in best.effects:
            for other, values in forms(self.search, best, fit.values, (key,)):
                again, allowed = self.fit(other, values, fit.shifts)
                if allowed and again.cost < fit.cost - EVIDENCE * inflation(again):
                    best, fit = other, again
        return best, fit

    def paired(self, best: Hypothesis, current: Fit, start: Fit) -> tuple[Hypothesis, Fit]:
        """Two effects taken up together, where `best` leaves something: each alone may fit badly."""
        for score in self.search.pairs(self.problem, start, LATER):
            if score.hypothesis in self.costs:
                continue
            values = {**start.values, **score.values}
            fit, allowed = self.fit(score.hypothesis, values, start.shifts, rival=current.cost)
            better = fit.cost < current.cost - EVIDENCE * inflation(fit) if allowed else False
            if better and fit.held_out() < current.held_out():
                best, current = score.hypothesis, fit
        return best, current

    def backward(self, best: Hypothesis, current: Fit) -> tuple[Hypothesis, Fit]:
        """Drop effects without which the fit is as good, and a second one that explains little where much is left."""
        changed = True
        while changed and best.size > 1:
            changed = False
            for drop in (*best.effects, *best.released):
                less = Hypothesis(*(tuple(k for k in kind if k != drop) for kind in (best.effects, best.released)))
                fit, _ = self.fit(less, current.values, current.shifts, rival=current.cost + EVIDENCE)
                if fit.cost < current.cost + EVIDENCE:
                    best, current, changed = less, fit, True
                    break
        if best.size < 2:
            return best, current
        (single, one), (pair, two) = self.best[1], self.best.get(2, (best, current))
        if whole(current) and not blurred(one):
            return best, current
        saved, all_ = one.cost - two.cost, self.explicable(self.plain)
        enough = min(OWN * all_, PAIR * self.explicable(one))
        if blurred(one) and saved < OWN * all_:
            enough = max(enough, LEAST * all_) if self.ahead(single, pair) > AHEAD * saved else np.inf
        return (pair, two) if saved > enough else (single, one)

    def ahead(self, single: Hypothesis, pair: Hypothesis) -> float:
        """Cost by which a pair fits better than `single` with any other second effect or parameter."""

        def named(hypothesis: Hypothesis) -> set[str]:
            return {self.search.effects[key].id for key in hypothesis.effects} | set(hypothesis.released)

        second = named(pair) - named(single)
        others = [
            cost for h, cost in self.costs.items()
            if h.size == 2 and named(single) <= named(h) and not named(h) & second
        ]  # fmt: skip
        return min(others, default=np.inf) - self.costs[pair]

    def explicable(self, fit: Fit) -> float:
        """Cost that a fit could still save."""
        return fit.cost - floor(self.problem)

    def explained(self, fit: Fit) -> float:
        """Share of what could be explained that a fit explains."""
        return (self.plain.cost - fit.cost) / max(self.explicable(self.plain), 1.0)

    # -- long windows ------------------------------------------------------------------------------------------------

    def over(self, final: Likelihood, best: Hypothesis, current: Fit) -> tuple["Selection", Hypothesis, Fit]:
        """The selection over longer windows: every hypothesis that explains all, in every form, and the best of them.

        Long windows tell forms apart that short ones do not. A further unknown costs what BIC says. A fit that gave up
        on its way to all goes on there.
        """
        saved = self.plain.cost - current.cost

        def near(fit: Fit) -> bool:
            above = fit.cost - current.cost
            if not fit.converged and above < STALLED * saved:
                return True
            return above < min(NEAR * self.problem.count, saved / 2) and whole(fit)

        rivals = {h: f for h, f in self.fits.items() if h.size == best.size and near(f)}
        rivals = {best: current, **{h: rivals[h] for h in sorted(rivals, key=lambda h: rivals[h].cost)[:RIVALS]}}
        longer = self
        if final is not self.problem:
            longer = Selection(self.search, final, self.plain, self.say)
        for hypothesis, fit in rivals.items():
            for form, values in [(hypothesis, fit.values), *forms(self.search, hypothesis, fit.values)]:
                if form not in longer.costs or (form == hypothesis and not fit.converged):
                    longer.fit(form, values, fit.shifts if longer is self else None)
        if best not in longer.fits:
            longer.add(best, longer.search.fit(final, best, current.values))

        def worth(h: Hypothesis) -> float:
            return longer.fits[h].cost + np.log(final.count) * (len(longer.fits[h].unknowns) + len(h.released))

        tried = [h for h in longer.fits if h.size == best.size]
        chosen = min(tried, key=worth)
        if longer is not self:
            by = longer.costs[best] - current.cost
            longer.costs = {**{h: cost + by for h, cost in self.costs.items()}, **longer.costs}
        return longer, chosen, longer.fits[chosen]


def alternatives(search: Search, ranked: Iterable[Score]) -> list[list[Score]]:
    """One list an effect or parameter, of its forms: the plain one first where it promises nearly the most."""
    by_name: dict[str, list[Score]] = {}
    for score in ranked:
        key = next(iter(score.hypothesis.effects), None)
        name = search.effects[key].id if key else score.hypothesis.released[0]
        by_name.setdefault(name, []).append(score)

    def worth(name: str, score: Score) -> float:
        return score.gain * (1.0 if score.hypothesis.effects == (name,) else NEARLY)

    return [sorted(forms, key=lambda s: -worth(name, s)) for name, forms in by_name.items()]


def forms(
    search: Search, hypothesis: Hypothesis, values: Mapping[str, float], keys: Iterable[str] | None = None
) -> Iterable[tuple[Hypothesis, dict]]:
    """(`hypothesis` with one effect, of `keys`, in another form, values from which it is fitted)."""
    for key in hypothesis.effects if keys is None else keys:
        effect = search.effects[key]
        for form in search.effects.values():
            if form.id == effect.id and form.key != key:
                effects = tuple(form.key if k == key else k for k in hypothesis.effects)
                yield Hypothesis(effects, hypothesis.released), {**values, **carried(effect, form, values)}


def carried(effect: Effect, form: Effect, values: Mapping[str, float]) -> dict[str, float]:
    """Where the parameters of another form start: at what those of the same name are in `effect`."""
    found = {f.reported: values[f.symbol] for f in effect.free if f.symbol in values}
    return {f.symbol: found.get(f.reported, f.guess[0] if f.guess else f.typical) for f in form.free}


# -- what a fit leaves ------------------------------------------------------------------------------------------------


def structure(fit: Fit) -> dict[str, float]:
    """Per channel, how much larger slow errors are than white noise would have them, less one."""
    problem = fit.problem
    model, channels = problem.model, problem.model.rig.predict
    projected = fit.projected[:, : problem.block * len(channels)].reshape(-1, problem.block, len(channels))
    size = max(round((BLURRED if blurred(fit) else SLOW) / model.rig.dt), 2)
    out = {}
    for i, name in enumerate(channels):
        e = projected[:, :, i]
        e = e[np.abs(e).sum(axis=1) > 0]
        pieces = e[:, : e.shape[1] // size * size].reshape(-1, size)
        out[name] = float(np.mean(pieces.mean(axis=1) ** 2) * size / max(1.0, _fast(e))) - 1.0
    return out


def blurred(fit: Fit) -> bool:
    """An effect of the fit acts by an acceleration that is made of a position."""
    return any(u.symbol == BLUR for u in fit.unknowns)


def _fast(e: np.ndarray) -> float:
    """Variance of what is fast in `e`."""
    return float(np.mean(np.diff(e, axis=1) ** 2) / 2)


def inflation(fit: Fit) -> float:
    """By how much errors that depend on each other widen the evidence on the last unknown."""
    bread = np.linalg.pinv(fit.information, hermitian=True, rcond=1e-14)
    return float(np.clip(fit.covariance[-1, -1] / max(bread[-1, -1], 1e-300), 1.0, 20.0))


def possible(search: Search, hypothesis: Hypothesis, fit: Fit) -> bool:
    """The fit runs, no size of the effect lies on its physical bound, no overtone is larger than its wave."""
    if not np.isfinite(fit.cost):
        return False
    effects = [search.effects[key] for key in hypothesis.effects]
    sizes = [[np.hypot(*(fit.values[s] for s in pair)) for pair in effect.wave.values()] for effect in effects]
    if any(overtones and max(overtones) > fundamental for fundamental, *overtones in filter(None, sizes)):
        return False  # a wave of that overtone's own period
    free = [f for effect in effects for f in effect.strengths]
    return not any(b and np.isclose(fit.values[f.symbol], b, rtol=1e-6) for f in free for b in (f.low, f.high))


def whole(fit: Fit) -> bool:
    """Nothing is left to be explained: no slow errors, or few, and no more error than the sensors make."""
    slow = max(structure(fit).values())
    return slow < STRUCTURE or (slow < 1.0 and fit.cost < fit.problem.count)


def floor(problem: Likelihood) -> float:
    """Cost of a fit that leaves nothing."""
    return problem.count * FLOOR


def _cost(found: tuple[Hypothesis, Fit]) -> float:
    return found[1].cost
