"""The explanations that a diagnosis leaves beside the one that it claims, each as a fit to the recording.

A search keeps what it fitted. A diagnosis.json keeps names and values: `restored` makes the fits again.
"""

import copy
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from greygate.errors import InputError, shown
from greygate.mismatch.coloured_selection import selected
from greygate.mismatch.diagnosis import Diagnosis, recovered
from greygate.mismatch.effects import Effect
from greygate.mismatch.fit import Fit, Likelihood
from greygate.mismatch.rig import Rig
from greygate.mismatch.search import Hypothesis, Search
from greygate.mismatch.selection import shown_noise
from greygate.mismatch.verdict import Verdict
from greygate.plants.recording import Recording
from greygate.progress import Progress, silent

ITERATIONS = 4  # of the fit of a rival


@dataclass(frozen=True)
class Rival:
    """An explanation that has `name` in the place of the claimed `effect`.

    here: standard deviations of the noise by which the claimed one is better, on the recording so far.
    """

    effect: str
    name: str
    fit: Fit
    here: float


def rivals(result: Diagnosis, entries: Iterable[Mapping], count: int | None = None) -> Iterator[Rival]:
    """The first `count` alternatives of some `effects` of a diagnosis."""
    pairs = [(entry, other) for entry in entries for other in entry["not_told_apart_from"]]
    for entry, other in pairs[:count]:
        rival = _rival(result, entry, other)
        if rival is not None:
            here = float(np.sqrt(max(result.rivals[rival] - result.rivals[result.best], 0.0)))
            yield Rival(entry["id"], other, _fitted(result, rival), here)


def screened(result: Diagnosis) -> Likelihood:
    """The likelihood in which explanations are compared."""
    return result.search.screen if result.rig.stated else result.corrected.likelihood


def _rival(result: Diagnosis, entry: Mapping, other: str) -> Hypothesis | None:
    """The best hypothesis that has `other` in the place of an effect of the diagnosis."""
    effects = result.search.effects
    rest = {key for key in result.best.effects if key != entry.get("form", entry["id"])}
    found = []
    for hypothesis, cost in result.rivals.items():
        names = [effects[key].id for key in hypothesis.effects if key not in rest] + list(hypothesis.released)
        if hypothesis.size == result.best.size and rest <= set(hypothesis.effects) and other in names:
            found.append((cost, hypothesis))
    return min(found, key=lambda pair: pair[0])[1] if found else None


def _fitted(result: Diagnosis, rival: Hypothesis) -> Fit:
    """The fit of a rival, which a search may have kept."""
    search = result.search
    if rival not in search.fits:
        start = {**result.corrected.values, **promised(search, result.calibrated, result.best, rival)}
        search.fits[rival] = search.fit(screened(result), rival, start, iterations=ITERATIONS)
    return search.fits[rival]


def promised(search: Search, calibrated: Fit, best: Hypothesis, rival: Hypothesis) -> dict[str, float]:
    """Values at which a linearised fit of what `rival` has and `best` has not is best; none where it promises none."""
    own = Hypothesis(tuple(k for k in rival.effects if k not in best.effects), rival.released)
    narrow = copy.copy(search)
    narrow.effects = {key: search.effects[key] for key in own.effects}
    scores = narrow.scores(calibrated, Hypothesis())
    return dict(next((s.values for s in scores if s.hypothesis == own), {}))


# -- from a file -----------------------------------------------------------------------------------------------------


def restored(
    rig: Rig, recording: Recording, effects: Mapping[str, Effect], found: Mapping, progress: Progress = silent
) -> Diagnosis:
    """The diagnosis `found` (content of diagnosis.json) of a rig's recording, as far as explanations are compared.

    effects: those that it had. Raises InputError where the file names what they, or the plant, do not have.
    """
    search = Search(rig, recording, effects)
    claimed = [_entry(search, entry) for entry in found["effects"]]
    released = [s for s, p in found["parameters"].items() if p.get("outside_tolerance")]
    best = Hypothesis(tuple(claimed), tuple(released))
    values = {symbol: float(p["value"]) for symbol, p in found["parameters"].items()}
    for key, entry in zip(claimed, found["effects"], strict=True):
        values |= recovered(search.effects[key], entry["parameters"])
    if not all(noise["as_told"] for noise in found.get("noise", {}).values()):
        search.under(shown_noise(search.fit(search.final, best, values)) or search.noise)
    again = _Again(search, progress)
    again.fit(best, values)
    for key, entry in zip(claimed, found["effects"], strict=True):
        rest = Hypothesis(tuple(k for k in claimed if k != key), tuple(released))
        for other in entry["not_told_apart_from"]:
            for rival in _hypotheses(search, rest, other):
                again.fit(rival, {**values, **promised(search, again.calibrated, best, rival)})
    costs = {hypothesis: fit.cost for hypothesis, fit in search.fits.items()}
    verdict = Verdict(found["verdict"])
    return Diagnosis(rig, verdict, best, again.calibrated, search.fits[best], costs, {}, 0.0, search)


class _Again:
    """Fits of the hypotheses of a diagnosis, which `search` keeps."""

    def __init__(self, search: Search, progress: Progress):
        self.search, self.progress = search, progress
        self.progress("calibrating")
        self.selection = selected(search)
        self.calibrated = self.selection.plain

    def fit(self, hypothesis: Hypothesis, values: Mapping[str, float]) -> None:
        self.progress(f"fitting {hypothesis}")
        self.search.fits[hypothesis] = self.selection.fitted(self.calibrated, hypothesis, values)


def _entry(search: Search, entry: Mapping) -> str:
    """Key of an effect of a diagnosis in the form that it chose."""
    key = entry.get("form", entry["id"])
    if key not in search.effects:
        raise InputError(f"diagnosis: effect {shown(key)} is unknown here; give --effects with the table it is of")
    return key


def _hypotheses(search: Search, rest: Hypothesis, other: str) -> list[Hypothesis]:
    """`rest` with `other`: an effect in any of its forms, or a parameter outside its tolerance."""
    found = [rest.plus(Hypothesis((key,))) for key, e in search.effects.items() if e.id == other]
    found += [rest.plus(Hypothesis((), (s,))) for s in search.toleranced if s == other]
    if not found:
        wish = "give --effects with the table it is of"
        raise InputError(f"diagnosis: not_told_apart_from: {shown(other)} is unknown here; {wish}")
    return found
