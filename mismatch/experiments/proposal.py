"""The experiment to do next: the one that tells most of the explanations apart which a diagnosis leaves.

Any of them may be true, so it is judged by every pair of them. What is counted is what the new recording tells by
itself: the parameters adapt to it as far as the data sheet lets them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import TypedDict

import numpy as np

from greygate.mismatch.diagnosis import Diagnosis
from greygate.mismatch.experiments.experiment import Experiment
from greygate.mismatch.experiments.rivals import Rival, rivals, screened
from greygate.mismatch.experiments.separation import (
    ENOUGH,
    NEEDED,
    REACHES,
    WORTH,
    Described,
    PlayedTrial,
    Sensor,
    Trials,
    described,
    deviations,
    figure,
    sensor,
    words,
)
from greygate.mismatch.fit import Fit
from greygate.plain import Figure
from greygate.progress import Progress, silent

LENGTHS = (1.0, 4.0)  # times the usual one; the second where the first tells too little
LEAST = 0.1  # standard deviations: a distance below is none


class PairFacts(TypedDict):
    one: str
    other: str
    here: Figure | None
    then: Figure | None
    both: Figure | None
    told_apart: bool
    sensor: Sensor | None


class Played(Described):
    reach: float


class Proposed(TypedDict):
    """The experiment that tells apart what a diagnosis does not."""

    plant: str
    pairs: list[PairFacts]
    experiment: Played | None


@dataclass(frozen=True)
class Pair:
    """Two explanations by the names in which they differ, and what lies between them in standard deviations.

    here: on the recording so far; None between two that are not claimed. then: on that of the experiment alone, None
    where there is none; both: on the two recordings together. sensor: (state, distance) of the sensor that would tell
    them apart where the experiment does not.
    """

    one: str
    other: str
    here: float | None
    then: float | None = None
    both: float | None = None
    sensor: tuple[str, float] | None = None

    @property
    def needed(self) -> float:
        return max(WORTH * (self.here or 0.0), NEEDED)

    @property
    def told(self) -> bool:
        return self.then is not None and self.then > self.needed

    def as_dict(self) -> PairFacts:
        return {
            "one": self.one,
            "other": self.other,
            "here": self.here,
            "then": self.then,
            "both": self.both,
            "told_apart": self.told,
            "sensor": {"state": self.sensor[0], "apart": self.sensor[1]} if self.sensor else None,
        }


@dataclass(frozen=True)
class Proposal:
    """experiment: what to play; None where nothing tells any of the claimed from another.

    pairs: the claimed ones with each of the others first, then those of the others. reach: times what was recorded,
    that the experiment asks of the rig at most.
    """

    pairs: tuple[Pair, ...]
    experiment: Experiment | None = None
    reach: float = 1.0

    def as_dict(self, units: Mapping[str, str]) -> dict:
        tried = described(self.experiment, units) | {"reach": self.reach} if self.experiment else None
        return {"pairs": [pair.as_dict() for pair in self.pairs], "experiment": tried}

    def lines(self, units: Mapping[str, str]) -> list[str]:
        """What a person reads."""
        told = [pair for pair in self.pairs if pair.told and self.experiment]
        left = [pair for pair in self.pairs if pair not in told]
        out = [f"play      {words(self.experiment, units)}"] if self.experiment else []
        for i, pair in enumerate(told):
            here = "" if pair.here is None else f", here {figure(pair.here)}"
            out.append(f"{'' if i else 'tells':<9} {pair.one} from {pair.other}: {deviations(pair.then or 0.0)}{here}")
        for i, pair in enumerate(left):
            of = f"; a sensor of {pair.sensor[0]} does: {deviations(pair.sensor[1])}" if pair.sensor else ""
            apart = f"here {figure(pair.here or 0.0)}" if pair.then is None else figure(pair.then)
            out.append(f"{'' if i else 'does not':<9} {pair.one} from {pair.other}: {apart}{of}")
        return out


def proposal(
    result: Diagnosis, entries: Sequence[Mapping], longest: float = np.inf, progress: Progress = silent
) -> Proposal:
    """The experiment that tells the explanations of a diagnosis apart, of at most `longest` s.

    entries: its `effects`. None is proposed that leaves the rig's bounds if one of the explanations is true.
    """
    left = [rival for rival in rivals(result, entries) if np.isfinite(rival.here)]
    trials = Trials(screened(result), result.corrected.values, longest)
    best: Judged | None = None
    for reach, times in product(REACHES, LENGTHS) if result.rig.inputs else ():
        progress(f"simulating experiments of {reach:g} times what was recorded, {times * trials.seconds:.3g} s long")
        likely = {id(trial): trial for rival in left for trial in trials.likeliest(rival.fit, reach, times)}
        judged = [Judged(trial, left, result.calibrated, reach) for trial in likely.values()]
        for one in sorted(judged, key=lambda j: j.merit, reverse=True):
            if (best is None or one.merit > best.merit) and trials.withstood(one.trial.experiment, left, reach):
                best = one
                break
        if best is not None and all(pair.told for pair in best.claimed):
            break
    pairs = best.pairs if best else [Pair(r.effect, r.name, r.here) for r in left]
    sensed = [_with_sensor(trials, pair, rival) for pair, rival in zip(pairs, left, strict=False)]
    between = pairs[len(left) :]
    if best is None or not best.tells:
        return Proposal((*sensed, *between))
    return Proposal((*sensed, *between), best.trial.experiment, best.reach)


class Judged:
    """A trial, and the distances in it between every two of the explanations that are `left`; and from no effect."""

    def __init__(self, trial: PlayedTrial, left: Sequence[Rival], nothing: Fit, reach: float):
        self.trial, self.reach = trial, reach
        self.claimed = [
            Pair(r.effect, r.name, r.here, trial.distance(r.fit, alone=True), trial.distance(r.fit)) for r in left
        ]
        between = [
            Pair(one.name, other.name, None, trial.distance(other.fit, alone=True, true=one.fit))
            for one, other in combinations(left, 2)
            if one.name != other.name
        ]
        self.pairs = [*self.claimed, *between]
        self.seen = trial.distance(nothing, alone=True)

    @property
    def tells(self) -> bool:
        """Whether it tells the claimed explanation from any other."""
        return any(pair.told for pair in self.claimed)

    @property
    def merit(self) -> tuple[bool, int, int, float, float]:
        """Whether it tells; pairs told apart with ease, and at all; what a second brings up to that; and beyond."""
        needed = np.array([*(pair.needed for pair in self.pairs), NEEDED])
        apart = np.maximum([*(pair.then or 0.0 for pair in self.pairs), self.seen], LEAST) / needed
        brings = np.mean(np.log(np.minimum(apart, ENOUGH))) - np.log(self.trial.experiment.seconds) / 2
        told = int(np.sum(apart > ENOUGH)), int(np.sum(apart > 1))
        return self.tells, *told, float(brings), float(np.mean(np.log(apart)))


def _with_sensor(trials: Trials, pair: Pair, rival: Rival) -> Pair:
    """The pair with the sensor that tells it apart on the recording so far, where the experiment does not."""
    if pair.told:
        return pair
    found = sensor(trials.likelihood, trials.free.values, rival.fit)
    return replace(pair, sensor=found) if found and found[1] > pair.needed else pair
