"""Which hypothesis a recording supports.

Forward selection over the hypotheses of `search`; then pairs of effects, where one effect after the other does not
explain everything; then backward elimination. At the end longer windows compare the rivals, and the forms of effects,
that short windows cannot tell apart.

`Selection` is for a recording whose noise is stated. `coloured_selection` overrides what differs where it is not: which
fits are proposed, what an effect must pay, and what it must predict.
"""

import copy
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from greygate.mismatch.claims import Claims, possible
from greygate.mismatch.coloured import Coloured
from greygate.mismatch.effects import Effect
from greygate.mismatch.fit import Fit, Likelihood
from greygate.mismatch.model import BLUR, TINY
from greygate.mismatch.noise import Noise, learnt
from greygate.mismatch.search import ROUGH, Hypothesis, Score, Search
from greygate.progress import Progress, silent

EVIDENCE = 30.0  # of cost, robust, that an effect must save: some thirty hypotheses are tried
CALIBRATED = EVIDENCE / 10  # of cost: the fit without effects stops when a step gains less, for less decides nothing
PROMISED = EVIDENCE / 3  # of cost that a linearised fit must promise, or no full fit is worth its time
EFFECTS = 3  # in a hypothesis, at most
STRUCTURE = 0.3  # of slow error over white error, above which structure is left
SLOW = 20  # samples of a mean that tells slow errors from white ones;
BLURRED = 200  # of that mean where an effect acts by acceleration, whose jumps are known to some 20 samples;
MEANS = 2  # of them in a block, at least
FLOOR = 0.92  # of the count of readings: the cost of a complete fit, whose unknowns take up some noise, too
FIRST, LATER = 6, 4  # hypotheses of the first round and of later ones that are fitted in full
STALLED = 0.1  # of what the best saves: a fit that gave up within so much cost above the best is a rival, too
BESIDE = 2  # single effects whose forms are led from the data sheet beside those of the first one
FAR = 0.3  # of the most promising gain: below that, no hypothesis is tried beside one whose fit is complete
NEARLY = 0.95  # of the gain that another form of an effect promises, which its plain form must promise to come first
APART = 12.0  # of cost: two hypotheses that differ by less are not told apart
ALMOST = 2.0  # times what several names leave, which a term may leave that does nearly as well
EXCHANGED, ROUNDS = 4, 3  # hypotheses that are fitted in the place of an effect; times that all are exchanged
KEPT = 0.5  # of the gain that the scores promise, of which a fit that saves less may be in a local minimum
PROMISING = 0.5  # of the gain that the scores promise of what is there, which they must promise of another
OWN = 0.05  # of what can be explained: a second effect must explain that much where the fit is not complete,
PART = 0.5  # of what can be explained: an effect that explains so much is named beside what is left
PAIR = 0.5  # or so much of what the first effect leaves
LEAST = 5e-3  # of what can be explained: an effect must explain that much beside one that acts by acceleration,
AHEAD = 0.1  # and be better than any other by so much of what it saves, where it saves less than OWN
NEAR, RIVALS = 0.05, 6  # of the count of readings: cost above the best; how many rivals see longer windows
MOST_INFLATED = 20.0  # by which evidence is widened, at most: a fit that is bad everywhere would else allow no effect
RANK = 1e-14  # of the largest singular value, below which the information on a direction is rounding


@dataclass(frozen=True)
class Found:
    """What a selection supports.

    fit: of the hypothesis `best`, over long windows. screened: its fit in which hypotheses are compared. of: the
    selection in which that is. costs: of every hypothesis, as there.
    """

    best: Hypothesis
    fit: Fit
    screened: Fit
    of: "Selection"
    costs: Mapping[Hypothesis, float] = field(default_factory=dict)


class Selection:
    """The hypotheses that are fitted to one likelihood, and the choice among them.

    start: the fit from which the plant without effects is fitted. costs: the least cost of each hypothesis. fits: the
    best fit of each that is physically possible. best: the best of those fits by the size of its hypothesis. unfitted:
    hypotheses that may be as good as the best, by their scores, and that were too many to be fitted. swapped: effects
    and released parameters of those that were fitted in exchange.
    """

    most = EFFECTS  # effects in a hypothesis
    calibrated: Mapping[str, float] | None = None  # values from which a term for the unknown is looked for

    def __init__(self, search: Search, likelihood: Likelihood, start: Fit, progress: Progress = silent):
        self.search, self.likelihood, self.start, self.progress = search, likelihood, start, progress
        self.costs: dict[Hypothesis, float] = {}
        self.fits: dict[Hypothesis, Fit] = {}
        self.best: dict[int, tuple[Hypothesis, Fit]] = {}
        self.unfitted: set[Hypothesis] = set()
        self.swapped: set[tuple[frozenset[str], frozenset[str]]] = set()
        self._scored: tuple[Fit | None, Hypothesis, list[Score]] = None, Hypothesis(), []

    @cached_property
    def plain(self) -> Fit:
        """The calibrated plant, with nothing added."""
        shifts = self.start.shifts if self.start.likelihood is self.likelihood else None
        fit = self.search.fit(self.likelihood, Hypothesis(), self.start.values, shifts, enough=CALIBRATED)
        self.add(Hypothesis(), fit)
        return fit

    @cached_property
    def lost(self) -> bool:
        """Whether the calibrated plant does not follow the recording, so that every fit may end elsewhere."""
        return self.search.lost(self.plain)

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
        """(fit of `hypothesis`, started at `values`; whether what is `new` in it is physically possible)."""
        self.progress(f"fitting {hypothesis}")
        fit = self.search.fit(self.likelihood, hypothesis, values, shifts, **options)
        fit = self.search.led(fit) if self.lost else fit
        allowed = possible(self.search, new or hypothesis, fit)
        self.add(hypothesis, fit, allowed)
        return fit, allowed

    # -- what a diagnosis asks ---------------------------------------------------------------------------------------

    def searched(self) -> Found:
        """The hypothesis that the recording supports."""
        search, base = self.search, self.start
        best, current = self.rivalled(*self.forward(Hypothesis(), self.plain, base))
        if not complete(current):
            best, current = self.paired(best, current, base)
        best, current = self.settled(*self.backward(best, current))
        if not (best.size and complete(current)):
            return Found(best, search.fit(search.final, best, current.values), current, self, self.costs)
        longer, chosen, corrected = self.over(search.final, best, current)
        if {search.effects[key].id for key in chosen.effects} != {search.effects[key].id for key in best.effects}:
            chosen, corrected = longer.settled(chosen, corrected)  # the exchanges that were made are not those of it
        best, costs = chosen, longer.costs
        if best.size == 1 and not longer.done(best, corrected):  # a second effect that long windows alone show
            more, fit = longer.backward(*longer.forward(best, corrected, corrected))
            if more != best:
                return Found(more, fit, fit, longer, costs)
        return Found(best, corrected, current, self, costs)

    def claimable(self, found: Found) -> Found:
        """`found`, or nothing: where it explains less than PART of what something else leaves, the gates can wait."""
        if not (found.best.size and self.open(found) and found.of.explained(found, self.plain) < PART):
            return found
        plain = self.search.fit(self.search.final, Hypothesis(), self.plain.values)
        nothing = Found(Hypothesis(), plain, self.plain, self)
        return nothing if self.open(nothing) else found

    def again(self, found: Found, claims: Claims) -> Found:
        """What the gates left of `found`, with the fit that they gave it."""
        if claims.best == found.best:
            return replace(found, fit=claims.fit)
        screened = self.search.fit(self.search.screen, claims.best, claims.fit.values)
        return Found(claims.best, claims.fit, screened, self, {**self.costs, claims.best: screened.cost})

    def refit(self, less: Hypothesis, from_: Fit) -> Fit:
        """The fit of a smaller hypothesis, from that of a larger one."""
        return self.search.fit(from_.likelihood, less, from_.values)

    def left(self, fit: Fit) -> str:
        """What a fit leaves, in words; empty where `structure` says it."""
        return ""

    def structure(self, fit: Fit) -> dict[str, float]:
        """By channel, what slow errors a fit leaves."""
        return structure(fit)

    def open(self, found: Found, left: str = "") -> bool:
        """Whether structure is left over long windows and over short ones."""
        return max(structure(found.fit).values()) > STRUCTURE and not complete(found.screened)

    def excess(self, found: Found) -> float:
        """Squared errors over those of the told noise."""
        return found.fit.cost / found.fit.likelihood.count

    def promises(self, found: Found) -> bool:
        """Whether a further effect or parameter promises a gain that is evidence."""
        fit = self.search.in_part(found.fit)
        return promised(self.search.scores(fit, found.best), fit) > 1.0

    def outdone(self, best: Hypothesis, explained: float, share: float, named: Fit, closed: Fit | None) -> bool:
        """Whether a term that takes such a `share` does as well as what is named, or nearly as several names do.

        Several names that leave something may be no more than such a term. named, closed: their fits.
        """
        return 1.0 - share <= (ALMOST if best.size > 1 else 1.0) * (1.0 - explained)

    def rivals(self, found: Found) -> dict[Hypothesis, float]:
        """The cost of every hypothesis, in units of evidence on `found`."""
        costs = {hypothesis: cost / inflation(found.screened) for hypothesis, cost in found.costs.items()}
        alike = (self.unfitted - costs.keys()) if found.best in costs else ()
        return {**costs, **{hypothesis: costs[found.best] for hypothesis in alike}}

    def fitted(self, fit: Fit, hypothesis: Hypothesis, values: Mapping[str, float]) -> Fit:
        """The fit of a hypothesis, from `values` on, and from those of `fit`."""
        return self.search.fit(self.search.screen, hypothesis, {**fit.values, **values})

    # -- steps -------------------------------------------------------------------------------------------------------

    def forward(self, best: Hypothesis, current: Fit, start: Fit) -> tuple[Hypothesis, Fit]:
        """Add one effect or released parameter after another while one pays. start: where scores are taken first."""
        while best.size < self.most and not self.done(best, current):
            proposals = self.proposed(best, current, start)
            taken = next((found for found in proposals if self.pays(best, current, *found)), None)
            if taken is None:
                break
            best, current = self.from_the_sheet(*self.exchanged(*taken))
            self.progress(f"best so far: {best}")
            start = current
        return best, current

    def from_the_sheet(self, best: Hypothesis, fit: Fit) -> tuple[Hypothesis, Fit]:
        """A first effect in the form, and with the fit, that is best led from the data sheet, where something is left.

        What was calibrated without it makes up for it, and what sticks has a valley for each place where it may. Of
        others that explain most, too: the form of one that is right may do so by far more.
        """
        if best.size != 1 or not best.effects or complete(fit) or not self.search.leads:
            return best, fit
        singles = {h: f for h, f in self.fits.items() if h.size == 1 and h.effects and self.share(f) >= PART}
        near = [best, *sorted(singles.keys() - {best}, key=lambda h: singles[h].cost)[:BESIDE]]
        own = [] if self.search.rig.window else near  # in windows, that begin where they were, no valley is far
        rich = [form for h in near for form, _ in forms(self.search, h, fit.values)]
        for other in dict.fromkeys([*own, *rich]):
            if self.search.skips(other) or complete(fit):
                continue
            self.progress(f"fitting {other} from the beginning on")
            begun = (
                fit
                if other == best
                else self.fits.get(other) or self.search.fit(self.likelihood, other, {}, iterations=0)
            )
            again = self.search.from_the_sheet(begun)
            if not possible(self.search, other, again):
                continue
            self.add(other, again)
            if again.cost < fit.cost - (0.0 if other == best else EVIDENCE * inflation(again)):
                best, fit = other, again
        return best, fit

    def rivalled(self, best: Hypothesis, current: Fit) -> tuple[Hypothesis, Fit]:
        """The same, or what grows from another single effect that saves nearly as much as the first that was taken.

        Of two that do alike the wrong one may come first, and no exchange of one for one leads back from what is added
        to it.
        """
        if not best.size or complete(current):
            return best, current
        mine = {self.search.effects[key].id for key in best.effects} | {*best.released}
        singles = {h: f for h, f in self.fits.items() if h.size == 1}
        names = {h: (*(self.search.effects[k].id for k in h.effects), *h.released)[0] for h in singles}
        first = min((f.cost for h, f in singles.items() if names[h] in mine), default=current.cost)
        others = {h: f for h, f in singles.items() if names[h] not in mine}
        if not others:
            return best, current
        rival, fit = min(others.items(), key=_cost)
        if self.share(fit) < PART or self.plain.cost - fit.cost < NEARLY * (self.plain.cost - first):
            return best, current
        self.progress(f"from {rival} on")
        rival, fit = self.forward(rival, fit, fit)
        price = EVIDENCE * inflation(fit) * (rival.size - best.size)
        return (rival, fit) if fit.cost + price < current.cost else (best, current)

    def done(self, best: Hypothesis, current: Fit) -> bool:
        """Whether no further effect is looked for: what is left is of the noise's size.

        Beside a single one a second is looked for nevertheless, if it promises evidence.
        """
        if best.size != 1 or not complete(current):
            return best.size > 0 and complete(current)
        louder = max(current.cost / self.likelihood.count, 1.0)  # if all that is left is noise, chance promises more
        return promised(self.scored(current, best), current) <= louder

    def scored(self, fit: Fit, given: Hypothesis) -> list[Score]:
        """What every candidate beside `given` promises at `fit`; once, where it is asked again."""
        at, beside, scores = self._scored
        if at is not fit or beside != given:
            scores = self.search.scores(fit, given)
            self._scored = fit, given, scores
        return scores

    def proposed(self, best: Hypothesis, current: Fit, start: Fit) -> Iterator[tuple[Hypothesis, Fit]]:
        """Fits with one effect or parameter more, the most likely first: here the best one, in its best form."""
        if found := self._added(best, current, start):
            hypothesis, fit = min(found, key=_cost)
            yield (hypothesis, fit) if complete(fit) else self.reshape(hypothesis, fit)

    def pays(self, best: Hypothesis, current: Fit, hypothesis: Hypothesis, fit: Fit) -> bool:
        """Whether `hypothesis` saves enough cost over `best`, also where its parameters are not fitted."""
        enough = LEAST * self.explicable(self.plain) if blurred(current) else 0.0
        price = max(EVIDENCE * inflation(fit), enough)
        return not (current.cost - fit.cost < price or fit.held_out() > current.held_out())

    def exchanged(self, best: Hypothesis, current: Fit) -> tuple[Hypothesis, Fit]:
        """The same after an earlier effect is replaced by one that now does better: here none is."""
        return best, current

    def settled(self, best: Hypothesis, current: Fit) -> tuple[Hypothesis, Fit]:
        """The same after no effect or parameter can be exchanged for another that does better.

        Every exchange of one for one is scored, and the most promising are fitted. Of the rest, those that may come as
        near as APART are kept as `unfitted`: nothing tells them apart.
        """
        for _ in range(ROUNDS):
            found = [self._exchanges(best, name, current) for name in (*best.effects, *best.released)]
            hypothesis, fit = min((one for ones in found for one in ones), key=_cost, default=(best, current))
            if not fit.cost < current.cost:
                break
            best, current = hypothesis, fit
        return best, current

    def _exchanges(self, best: Hypothesis, name: str, current: Fit) -> list[tuple[Hypothesis, Fit]]:
        """The fits with another effect or parameter in the place of `name` that may come near the best."""
        less = best.without(name)
        without = self.fits.get(less) or self.fit(less, current.values, current.shifts)[0]
        if not np.isfinite(without.cost):
            return []
        mine = {self.search.effects[key].id for key in best.effects}
        ranked = alternatives(self.search, self.search.scores(without, less))
        near = without.cost - current.cost - APART * inflation(current)
        own = [s.gain for forms in ranked for s in forms if name in (*s.hypothesis.effects, *s.hypothesis.released)]
        least = min([near, *(PROMISING * gain for gain in own)])  # a straight line promises too little, of `name` too
        found: list[tuple[Hypothesis, Fit]] = []
        tried = 0
        for score in (forms[0] for forms in ranked):
            hypothesis = less.plus(score.hypothesis)
            names = frozenset(hypothesis.effects), frozenset(hypothesis.released)
            same = names in self.swapped or any(
                names == (frozenset(h.effects), frozenset(h.released))
                for h in self.costs
                if h not in self.fits or self.fits[h].converged  # one that gave up on its way has a second try
            )
            if score.gain < least or same or mine & {self.search.effects[k].id for k in score.hypothesis.effects}:
                continue
            if tried == EXCHANGED:
                self.unfitted |= {hypothesis} if score.gain >= near else set()
                continue
            if self.search.skips(hypothesis):
                continue
            tried += 1
            self.swapped.add(names)
            values = {**without.values, **score.values}
            fit, allowed = self.fit(hypothesis, values, without.shifts, score.hypothesis, rival=current.cost)
            if allowed:
                found.append((hypothesis, fit))
        return found

    def _added(self, best: Hypothesis, current: Fit, start: Fit) -> list[tuple[Hypothesis, Fit]]:
        """`best` with each of the most promising hypotheses added."""
        ranked = alternatives(self.search, self.scored(start, best))
        self.progress(f"scored {len(ranked)} hypotheses")
        ranked = [forms for forms in ranked if forms[0].gain > PROMISED][: LATER if best.size else FIRST]
        found: list[tuple[Hypothesis, Fit]] = []
        for forms in ranked:
            most = ranked[0][0].gain
            if found and forms[0].gain < FAR * most and complete(min(found, key=_cost)[1]):
                break  # one explains everything, and this one promises little
            if self.search.skips(best.plus(forms[0].hypothesis)):
                continue
            for score in forms:
                hypothesis = best.plus(score.hypothesis)
                rival = min(map(_cost, found), default=np.inf)
                values = {**start.values, **score.values}
                fit, allowed = self.fit(hypothesis, values, start.shifts, score.hypothesis, rival=rival)
                if current.cost - fit.cost < KEPT * score.gain and score.gain > NEARLY * most:
                    fit, allowed = self.restarted(hypothesis, score, start, fit, current.cost)
                if allowed:
                    found.append((hypothesis, fit))
                    break
        return found

    def restarted(
        self, hypothesis: Hypothesis, score: Score, start: Fit, worse: Fit, before: float
    ) -> tuple[Fit, bool]:
        """Fit again: `worse`, which saves less of the cost `before` than was promised, may be in a local minimum.

        It begins at every size of the effect that was tried in a simulation, on the promised side; and, where `worse`
        saves nothing, at no effect.
        """
        effects = [self.search.effects[key] for key in score.hypothesis.effects]
        strengths = {f.symbol for effect in effects for f in effect.strengths}
        shapes = {s: v for s, v in score.values.items() if s not in strengths and not score.hypothesis.released}
        sizes = [point for effect in effects for point in self.search.points(effect) if alike(point, score.values)]
        found = [worse]
        for point in sizes:
            values = {**start.values, **shapes, **point}
            found.append(self.fit(hypothesis, values, None, score.hypothesis, rival=min(f.cost for f in found))[0])
        if worse.cost > before:
            found.append(self.fit(hypothesis, {**start.values, **shapes}, start.shifts, score.hypothesis)[0])
        better = min(found, key=lambda fit: fit.cost)
        return better, possible(self.search, score.hypothesis, better)

    def reshape(self, best: Hypothesis, fit: Fit) -> tuple[Hypothesis, Fit]:
        """`best` with each effect in another form, where that form is better by enough."""
        for key in best.effects:
            for other, values in forms(self.search, best, fit.values, (key,)):
                again, allowed = self.fit(other, values, fit.shifts)
                if allowed and again.cost < fit.cost - EVIDENCE * inflation(again):
                    best, fit = other, again
        return best, fit

    def paired(self, best: Hypothesis, current: Fit, start: Fit) -> tuple[Hypothesis, Fit]:
        """Try pairs where the fit of `best` is not complete: each of the two alone may fit badly.

        They are of two effects, or of an effect and a parameter that is outside its tolerance.
        """
        for score in self.search.pairs(start, LATER):
            if score.hypothesis in self.costs or self.search.skips(score.hypothesis):
                continue
            values = {**start.values, **score.values}
            fit, allowed = self.fit(score.hypothesis, values, start.shifts, rival=current.cost)
            better = fit.cost < current.cost - EVIDENCE * inflation(fit) if allowed else False
            if better and fit.held_out() < current.held_out():
                best, current = score.hypothesis, fit
        return best, current

    def backward(self, best: Hypothesis, current: Fit) -> tuple[Hypothesis, Fit]:
        """Drop effects without which the fit is as good; drop a second one that explains little where much is left."""
        changed = True
        while changed and best.size > 1:
            changed = False
            for drop in (*best.effects, *best.released):
                less = best.without(drop)
                fit, _ = self.fit(less, current.values, current.shifts, rival=current.cost + EVIDENCE)
                if fit.cost < current.cost + EVIDENCE:
                    best, current, changed = less, fit, True
                    break
        if best.size < 2:
            return best, current
        (single, one), (pair, two) = self.best[1], self.best.get(2, (best, current))
        if complete(current) and not blurred(one):
            return best, current
        saved, all_ = one.cost - two.cost, self.explicable(self.plain)
        enough = min(OWN * all_, PAIR * self.explicable(one))
        if blurred(one) and saved < OWN * all_:
            enough = max(enough, LEAST * all_) if self.ahead(single, pair) > AHEAD * saved else np.inf
        return (pair, two) if saved > enough else (single, one)

    def ahead(self, single: Hypothesis, pair: Hypothesis) -> float:
        """By how much cost `pair` is better than `single` with any other second effect or parameter."""

        def named(hypothesis: Hypothesis) -> set[str]:
            return {self.search.effects[key].id for key in hypothesis.effects} | set(hypothesis.released)

        second = named(pair) - named(single)
        others = [
            cost for h, cost in self.costs.items()
            if h.size == 2 and named(single) <= named(h) and not named(h) & second
        ]  # fmt: skip
        return min(others, default=np.inf) - self.costs[pair]

    def explicable(self, fit: Fit) -> float:
        """The cost that could still be saved beyond `fit`."""
        return fit.cost - floor(self.likelihood)

    def explained(self, found: Found, calibrated: Fit) -> float:
        """The share of what can be explained that `found` explains beyond the `calibrated` plant."""
        return self.share(found.screened)

    def share(self, fit: Fit) -> float:
        """The share of what can be explained that `fit` explains."""
        return (self.plain.cost - fit.cost) / max(self.explicable(self.plain), 1.0)

    # -- long windows ------------------------------------------------------------------------------------------------

    def over(self, final: Likelihood, best: Hypothesis, current: Fit) -> tuple["Selection", Hypothesis, Fit]:
        """(the selection over longer windows, the best hypothesis there, its fit).

        Long windows tell forms of an effect apart that short ones do not. So every hypothesis whose fit is complete is
        fitted there, in every form. Each further unknown costs what BIC says. A fit that gave up on its way goes on.
        """
        saved = self.plain.cost - current.cost

        def near(fit: Fit) -> bool:
            above = fit.cost - current.cost
            if not fit.converged and above < STALLED * saved:
                return True
            return above < min(NEAR * self.likelihood.count, saved / 2) and complete(fit)

        rivals = {h: f for h, f in self.fits.items() if h.size == best.size and near(f)}
        rivals = {best: current, **{h: rivals[h] for h in sorted(rivals, key=lambda h: rivals[h].cost)[:RIVALS]}}
        longer = self
        if final is not self.likelihood:
            longer = Selection(self.search, final, self.plain, self.progress)
        for hypothesis, fit in rivals.items():
            for form, values in [(hypothesis, fit.values), *forms(self.search, hypothesis, fit.values)]:
                if form not in longer.costs or (form == hypothesis and not fit.converged):
                    least = min((longer.costs[h] for h in rivals if h in longer.costs), default=np.inf)
                    how = {"shifts": fit.shifts} if longer is self else {"shifts": None, "rival": least}
                    longer.fit(form, values, **how, enough=ROUGH)
        if best not in longer.fits:
            longer.add(best, longer.search.fit(final, best, current.values))

        def worth(h: Hypothesis) -> float:
            return longer.fits[h].cost + np.log(final.count) * (len(longer.fits[h].unknowns) + len(h.released))

        tried = [h for h in longer.fits if h.size == best.size]
        chosen = min(tried, key=worth)
        rough = longer.fits[chosen]
        longer.fit(chosen, rough.values, rough.shifts)
        if longer is not self:
            by = longer.costs[best] - current.cost
            longer.costs = {**{h: cost + by for h, cost in self.costs.items()}, **longer.costs}
        return longer, chosen, longer.fits[chosen]


def alternatives(search: Search, ranked: Iterable[Score]) -> list[list[Score]]:
    """For each effect or parameter its forms; the plain one comes first where it promises nearly the most."""
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
    """(`hypothesis` with one of its effects `keys` in another form, the values from which that is fitted)."""
    for key in hypothesis.effects if keys is None else keys:
        effect = search.effects[key]
        for form in search.effects.values():
            if form.id == effect.id and form.key != key:
                effects = tuple(form.key if k == key else k for k in hypothesis.effects)
                yield Hypothesis(effects, hypothesis.released), {**values, **carried(effect, form, values)}


def carried(effect: Effect, form: Effect, values: Mapping[str, float]) -> dict[str, float]:
    """Where the parameters of another form start: at the values that those of the same name have in `effect`."""
    found = {f.reported: values[f.symbol] for f in effect.free if f.symbol in values}
    return {f.symbol: found.get(f.reported, f.guess[0] if f.guess else f.typical) for f in form.free}


# -- what a fit leaves ------------------------------------------------------------------------------------------------


def shown_noise(fit: Fit) -> Noise | None:
    """The noise, in units of what rig.toml tells, that a fit leaves; None where that tells none."""
    if isinstance(fit.likelihood, Coloured):
        return None
    likelihood, model = copy.copy(fit.likelihood), fit.likelihood.model
    likelihood.noise = Noise.told(len(model.rig.predict))
    return learnt(likelihood.errors(fit.values, fit.shifts), model.window or len(likelihood.sigma), model.pieces)


def structure(fit: Fit) -> dict[str, float]:
    """Channel -> the variance of its slow errors over that of the slow part of white noise, less one."""
    likelihood = fit.likelihood
    channels = likelihood.model.rig.predict
    projected = fit.projected[:, : likelihood.block * len(channels)].reshape(-1, likelihood.block, len(channels))
    size = max(min(BLURRED if blurred(fit) else SLOW, likelihood.block // MEANS), 2)
    out = {}
    for i, name in enumerate(channels):
        e = projected[:, :, i]
        e = e[np.abs(e).sum(axis=1) > 0]
        if not len(e):  # a channel that is predicted exactly, as one that rests
            out[name] = -1.0
            continue
        pieces = e[:, : e.shape[1] // size * size].reshape(-1, size)
        out[name] = float(np.mean(pieces.mean(axis=1) ** 2) * size / max(1.0, _fast(e))) - 1.0
    return out


def blurred(fit: Fit) -> bool:
    """Whether an effect of the fit acts by an acceleration that is derived from a recorded position."""
    return any(u.symbol == BLUR for u in fit.unknowns)


def _fast(e: np.ndarray) -> float:
    """The variance of the fast part of `e`: half that of its differences from sample to sample."""
    return float(np.mean(np.diff(e, axis=1) ** 2) / 2)


def inflation(fit: Fit) -> float:
    """The factor by which errors that depend on each other widen the evidence on the last unknown."""
    bread = np.linalg.pinv(fit.information, hermitian=True, rcond=RANK)
    return float(np.clip(fit.covariance[-1, -1] / max(bread[-1, -1], TINY), 1.0, MOST_INFLATED))


def complete(fit: Fit) -> bool:
    """Whether a fit leaves nothing to explain: no slow errors, or few and no more error than the sensors make."""
    slow = max(structure(fit).values())
    return slow < STRUCTURE or (slow < 1.0 and fit.cost < fit.likelihood.count)


def promised(scores: Iterable[Score], fit: Fit) -> float:
    """The largest gain that scores promise beside `fit`, over that which is evidence there."""
    return max((score.gain for score in scores), default=0.0) / (EVIDENCE * inflation(fit))


def floor(likelihood: Likelihood) -> float:
    """The cost of a complete fit."""
    return likelihood.count * FLOOR


def alike(point: Mapping[str, float], promised: Mapping[str, float]) -> bool:
    """Whether sizes that were tried, if any, have the signs of those that a fit promises."""
    return bool(point) and all(v * promised.get(symbol, v) > 0 for symbol, v in point.items())


def _cost(found: tuple[Hypothesis, Fit]) -> float:
    return found[1].cost
