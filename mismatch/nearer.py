"""A formula judged once more near the run that has it, where its rivals are told apart.

A formula is first chosen by what it changes in the errors of the calibrated plant, in proportion. That is not exact:
the parameters have gone astray to make up for what is missing. So its signal is made to act along the recording, the
parameters are fitted again, and the formula and its nearest rivals are judged where that run is linearised, which is
close to the recording. A run that stays with the recording is not begun anew there: what is slow shows.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from greygate.mismatch.entries import SENSOR
from greygate.mismatch.forced import EXPECTED, Acting, Forced, Place
from greygate.mismatch.formula import STEPS, Finder, Formula, Shape, Where, bare
from greygate.mismatch.search import Search
from greygate.plants.expressions import names

ROUNDS = 2  # in which a formula is judged near the run with the one before
MARGIN = 0.1  # of the misfit, by which rivals may be worse: so wrong is what is only in proportion
LESS = 1e-3  # of the misfit, that a formula may take less where the run is free
SEEN_NEAR = 2  # rivals that are nearly as good where the run is near, though they were not in proportion
RIVALS = 6  # for which a formula is written, at most
NEEDED = 2.0  # times what a formula leaves, that is left without one of its signals, if it needs that
FAR = 8.0  # times the best cost, beyond which a rival is out
FINEST = 9  # times that the step of a knee is halved: to 2 parts in a thousand of the distance of its grid
ALIKE = 0.1  # of what is left, within which two formulas are equally good
APART = 10.0  # of cost, by which the recording tells two formulas apart (Kass and Raftery 1995: "very strong")


def settled(search: Search, values: Mapping[str, float] | None) -> tuple[Finder, Formula | None]:
    """A finder and its formula, which is the best near the run that has it. values: as for `Forced`."""
    finder = Finder(Forced(search, values=values))
    formula = finder.found()
    if formula is None and finder.forced.anew:  # what is slow does not show where runs begin anew
        finder = Finder(Forced(search, values=values, free=True))
        formula = finder.found()
    if formula is None or not (formula.shapes and finder.forced.expected):  # without noise there is no near
        return finder, formula
    rivals = _rivals(finder)
    for _ in range(ROUNDS):
        near = _near(search, finder, formula)
        if near is None:
            break
        before, finder = formula, near
        formula, rivals = near.best(formula, _joined(_rivals(near)[:SEEN_NEAR], rivals))
        if not near.unclear(formula) or (formula.place, formula.texts) == (before.place, before.texts):
            break
    return finder, formula


def _rivals(finder: Finder) -> list[Where]:
    """The places and signals that are nearly as good as the best."""
    least = finder.where[2] - MARGIN * finder.misfit
    return [w for w in finder.ranked if w.gain >= least and not w.place[0].startswith(SENSOR)]


def _joined(first: Sequence[Where], others: Sequence[Where]) -> list[Where]:
    """Both, `first` before; what is of the same place and signals stands once."""
    known = {(w.place, w.variables) for w in first}
    return [*first, *(w for w in others if (w.place, w.variables) not in known)]


def _near(search: Search, finder: Finder, formula: Formula) -> "Near | None":
    """A finder near the run with a formula; None where no run with it stays with the recording.

    It is free where the formula takes as much of the misfit there: a run without damping drifts away from what acts on
    it, if that is taken from the recording.
    """
    forced = finder.forced
    parts = zip(finder.coefficients(formula), formula.texts, strict=True)
    acting = Acting(formula.place, np.sum([c * forced.of(text) for c, text in parts], axis=0))
    for free in (True, False) if forced.anew or forced.free else (False,):
        near = Near(Forced(search, values=forced.base.values, acting=acting, free=free))
        promised = min(formula.share, 1.0) - LESS if forced.anew and near.forced.free else 0.0
        if not near.forced.lost and near.moved(formula, formula.place).share >= promised:
            return near
    return None


class Near(Finder):
    """A finder near a run in which a formula acts."""

    def best(self, formula: Formula, rivals: Sequence[Where]) -> tuple[Formula, list[Where]]:
        """The best of a formula and its rivals, and the rivals that come near it.

        Of those that are not told apart it is the least strange. More signals are tried where something is left.
        """
        found, written = [self.moved(formula, formula.place)], dict[Where, Formula]()
        for larger in (False, True):
            unclear = all(map(self.unclear, found))
            if unclear or not larger:
                here = [w for w in rivals if (len(w.variables) > self._signals(formula)) is larger][:RIVALS]
                written |= {there: f for there in here if (f := self._rival(found[0], there, unclear))}
                found += written.values()
        least = min(map(self._cost, found))
        return self._likeliest(found), [w for w, f in written.items() if self._cost(f) <= FAR * least]

    def _rival(self, own: Formula, there: Where, unclear: bool) -> Formula | None:
        """A formula of the signals of a rival; where nothing is unclear but the place, it is that of before."""
        if {*own.depends_on} == names(there.variables) and not unclear:
            return self.moved(own, there.place)
        return self.written(there.place, self.pool(there.variables))

    def moved(self, formula: Formula, place: Place) -> Formula:
        """A formula in another place."""
        gain = self.judge(place, formula.texts).gain(formula.texts)
        return replace(formula, place=place, share=gain / self.misfit)

    def trials(self, best: Formula | None, pool: Sequence[Shape], size: int) -> list[list[Shape]]:
        if best is None:
            return [[shape] for shape in pool]
        return [[*best.shapes, shape] for shape in pool if shape not in best.shapes] if self.unclear(best) else []

    def polished(self, formula: Formula) -> Formula:
        return self.refined(formula, range(STEPS + 1, FINEST + 1))

    def worth(self, share: float, before: float) -> bool:
        return self._beyond(before) >= NEEDED * self._beyond(share)

    def alike(self, share: float, most: float) -> bool:
        return self._beyond(share) <= (1.0 + ALIKE) * self._beyond(most)

    def _likeliest(self, tried: Sequence[Formula]) -> Formula:
        """The formula that leaves least; of those that the recording does not tell apart from it, the least strange."""
        least = min(tried, key=self._cost)
        most = least.share - max(APART, ALIKE * self._left(least)) / self.misfit
        alike = [f for f in tried if f.share >= most and self._size(f) <= self._size(least)]
        best = min(alike, key=lambda f: (self._size(f), self.forced.strange(f.place, f.depends_on), -f.share))
        others = dict.fromkeys((f.place, tuple(f.depends_on)) for f in alike)
        return replace(best, as_well=tuple(o for o in others if o != (best.place, tuple(best.depends_on))))

    def _cost(self, formula: Formula) -> float:
        """What a formula leaves, times its price."""
        return self._left(formula) * NEEDED ** self._size(formula)

    def _size(self, formula: Formula) -> int:
        """How many signals a formula is of, and how many numbers are in it."""
        knees = sum(len(shape.numbers) for shape in formula.shapes)
        return self._signals(formula) + len(formula.texts) + knees

    def _signals(self, formula: Formula) -> int:
        """Of how many signals a formula is."""
        written, used = " ".join(formula.texts), {*formula.depends_on}
        return sum(names([v]) <= used and bare(v) in written for v in self.forced.places[formula.place])

    def unclear(self, formula: Formula) -> bool:
        """Whether a formula leaves so much that a further signal or term could be needed."""
        return self._left(formula) > NEEDED * self._spare

    def _left(self, formula: Formula) -> float:
        """The cost that a formula leaves beyond that of the noise, with what is left in any case."""
        return self._beyond(formula.share)

    def _beyond(self, share: float) -> float:
        return max((1.0 - share) * self.misfit, self._spare)

    @property
    def _spare(self) -> float:
        """The cost that is left in any case, for that of the noise is not known better."""
        return (1.0 - EXPECTED) / EXPECTED * self.forced.expected
