"""Scores the answers of a tool, case by case, against what was concealed."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from greygate.contents import contents
from greygate.errors import InputError
from greygate.mismatch.concealed.conceal import place
from greygate.mismatch.concealed.rig import rms, within
from greygate.plants.table import read_table
from greygate.reading import read_json

from .answer import FILE, PREDICTED, RUN, Answer, read
from .make import committed
from .vocabulary import LATE, PICKUP, right

SURE = 0.95  # a claim with this confidence or more is one that a reader takes for certain
SEEN = 0.1  # of the error: where less can be removed, the share that was removed means nothing
NAMED = ("one", "two", "both")
TURN = 2 * np.pi


@dataclass(frozen=True)
class Score:
    """Of one case. None where a question does not arise.

    claims: (name, confidence, whether it is concealed). first, all: whether the first claim, and every effect, is right
    and named. fault: whether the recording's fault was named. where: whether a right equation was named. removable:
    share of the calibrated simulation's error on the unseen recording that the truth removes. removed: the share of
    this that the tool removes. worse: its largest error over the calibrated simulation's, in one channel; corrects:
    whether it adds anything to a calibrated simulation. harms: as `worse`, but over the error of the concealed machine
    where that is larger: by chance the truth may be worse than what was calibrated. inside: for each interval whether
    it holds the true value.
    """

    case: str
    plant: str
    kind: str
    condition: str
    concealed: tuple[str, ...]
    verdict: str | None
    claims: tuple[tuple[str, float | None, bool], ...]
    first: bool | None
    all: bool | None
    fault: bool | None
    where: bool | None
    parameter: bool | None
    removable: float
    removed: float | None
    worse: float | None
    harms: float | None
    inside: tuple[bool, ...]
    seconds: float
    error: str
    corrects: bool = True

    @property
    def wrong(self) -> list[tuple[str, float | None]]:
        """Claims of what is not there."""
        return [(name, confidence) for name, confidence, right in self.claims if not right]

    @property
    def surely_wrong(self) -> bool:
        return any(confidence is not None and confidence >= SURE for _, confidence in self.wrong)


def score(bench: Path, answers: Path) -> list[Score]:
    """Score every case that was run: `answers` is what `run` wrote.

    Raises InputError for a folder that is no split, for answers that are not as docs/benchmark.md says, and where
    there are none.
    """
    folders = committed(bench, sealed=True)
    done = [name for name in folders if (Path(answers) / name / RUN).exists()]
    if not done:
        raise InputError(f"{answers}: holds no answers to {bench}; run a tool first")
    return [_score(name, folders[name], Path(answers) / name) for name in done]


def _score(name: str, sealed: Path, given: Path) -> Score:
    truth, ran = json.loads(contents(sealed / "sealed.json")), read_json(given / RUN, "run the tool again")
    answer = read(given) if (given / FILE).exists() else Answer()
    under, kind = truth.get("condition", "white"), truth["kind"]
    faults = {"late": {LATE}, "pickup": {PICKUP}}.get(under, set())
    concealed, plant = set(truth["effects"]), truth["plant"]

    def true(name: str) -> bool:
        return name in faults or any(right(plant, name, effect) for effect in concealed)

    claims = tuple((c["name"], c.get("confidence"), true(c["name"])) for c in answer.claims)
    physical = [n for n in answer.names if n not in faults]
    equations = {*map(place, (w["equation"] for w in answer.where))}
    released = [symbol for symbol, p in answer.parameters.items() if p.get("outside_tolerance")]
    third = truth["third"]
    errors = _errors(sealed, given, third, truth["counted_from"])
    return Score(
        case=name,
        plant=plant,
        kind=kind,
        condition=under,
        concealed=tuple(truth["concealed"]),
        verdict=answer.verdict,
        claims=claims,
        first=bool(physical) and true(physical[0]) if kind in NAMED else None,
        all=all(any(right(plant, n, effect) for n in answer.names) for effect in concealed) if kind in NAMED else None,
        fault=bool(faults & set(answer.names)) if faults else None,
        where=bool(equations & {*map(place, truth["equation"])}) if truth["equation"] else None,
        parameter=truth["parameter"] in released if truth["parameter"] else None,
        removable=truth["removable"],
        removed=_removed(errors, truth),
        worse=max((e / third[c]["calibrated"] for c, e in errors.items()), default=None),
        harms=max((e / max(third[c]["calibrated"], third[c]["true"]) for c, e in errors.items()), default=None),
        inside=tuple(_inside(answer, truth)),
        seconds=ran["seconds"],
        error=ran["error"],
        corrects=answer.corrects,
    )


def _errors(sealed: Path, given: Path, channels: Mapping[str, Mapping], first: int) -> dict[str, float]:
    """RMS of predicted minus recorded on the unseen recording, by channel; infinite where a prediction diverged.

    first: sample from which it counts.
    """
    path = given / PREDICTED
    if not path.exists():
        return {}
    found, recorded = read_table(path, nan=True), read_table(sealed / "third.csv")
    if missing := [c for c in channels if c not in found.header]:
        raise InputError(f"{path}: no column {missing[0]}; predict {', '.join(channels)}")
    if len(found.values) != len(recorded.values):
        raise InputError(f"{path}: {len(found.values)} samples; predict all {len(recorded.values)}")
    out = {}
    for channel in channels:
        error = found.values[:, found.header.index(channel)] - recorded.values[:, recorded.header.index(channel)]
        out[channel] = rms(error[first:]) if np.isfinite(error).all() else np.inf
    return out


def _removed(errors: Mapping[str, float], truth: Mapping) -> float | None:
    """(E_calibrated - E_tool) / (E_calibrated - E_true), E the mean over the channels of RMS over the truth's RMS."""
    if not errors or truth["removable"] < SEEN:
        return None
    third = truth["third"]
    calibrated, tool = (
        np.mean([e[channel] / fit["true"] for channel, fit in third.items()])
        for e in ({channel: fit["calibrated"] for channel, fit in third.items()}, errors)
    )
    return float((calibrated - tool) / (calibrated - 1)) if np.isfinite(tool) else -np.inf


def _inside(answer: Answer, truth: Mapping) -> Iterable[bool]:
    """Whether intervals of the plant's parameters, and of rightly named effects of standard form, hold the truth."""
    known = dict(truth["parameters_true"])
    if truth["effects"] and truth["form"] == "standard" and set(truth["effects"]) <= set(answer.names):
        known |= truth["effects_true"]
    for name, (low, high) in answer.intervals().items():
        if name in known:
            value = known[name]
            if name.endswith("_phase"):  # the interval may lie a whole number of turns away
                value += TURN * round(((low + high) / 2 - value) / TURN)
            yield within(low, value, high)
