"""Whether a recording's columns are in another unit than rig.toml says, or exchanged: asked before any search.

A column is read otherwise, and the calibrated plant is run again. No missing physics makes a run follow a recording
that was a factor of 57.3 away, and what it cannot follow at all as it stands.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from greygate.errors import InputError
from greygate.mismatch.fit import Fit
from greygate.mismatch.model import TINY, Model
from greygate.mismatch.rig import Rig
from greygate.mismatch.runs import with_channels
from greygate.mismatch.search import LED, LOST, Hypothesis, Search
from greygate.plants.recording import Recording
from greygate.plants.units.reading import converted, factor

OFTEN = (
    ("deg", "deg/s"), ("rev", "rpm"), ("mm", "mm/s"), ("bar",), ("kPa",), ("MPa",), ("L/min",), ("degC",), ("mA", "mV"),
    ("kN",),
)  # fmt: skip
"""Units in which sensors and loggers write what equations have in another; those of one line go together."""
BETTER = 4.0  # times less must a run err, read otherwise: by chance no other reading does that
PROMISING = 2.0  # times less must the data sheet's run err, read otherwise, or no calibration is worth its time
LIKELY = 4  # readings that rank best in longer steps are run as the plant is
TRIED = 2  # of these are calibrated, at most


@dataclass(frozen=True)
class Reading:
    """A recording read otherwise: what that says of its columns, and what to do about it."""

    recording: Recording
    says: str
    remedy: str


def check(search: Search, calibrated: Fit) -> None:
    """Raise InputError where the calibrated plant follows the recording only if its columns are read otherwise."""
    as_it_stands = _errors(search.final.residual(calibrated.values), search.final.model.target)
    if max(as_it_stands) <= LOST:
        return
    model = search.final.model
    before = _score(model, model.recording)
    rough = search.final.rough().model
    likely = sorted(readings(search), key=lambda reading: _score(rough, reading.recording))[:LIKELY]
    found = [(_score(model, reading.recording), reading) for reading in likely]
    for score, reading in sorted(found, key=lambda f: f[0])[:TRIED]:
        left = _calibrated(search, reading) if score * PROMISING < before else np.inf
        if left <= LOST and left * BETTER < _mean(as_it_stands):
            errs = f"the simulation errs by {left:.2g} of what the channels move, else by {_mean(as_it_stands):.2g}"
            raise InputError(f"{reading.recording.source}: {reading.says}: then {errs}; {reading.remedy}")


def readings(search: Search) -> Iterator[Reading]:
    """The recording of a search with columns in the units that are often written, and with two exchanged."""
    rig, recording = search.rig, search.final.model.recording
    for family in OFTEN:
        units = {name: unit for name in rig.channels for unit in family if _converts(unit, rig.channels[name].unit)}
        for names in dict.fromkeys([tuple(units), *((name,) for name in units)]):
            if names:
                yield _rescaled(rig, recording, {name: units[name] for name in names})
    for one, other in combinations(rig.channels, 2):
        channels = {**recording.channels, one: recording[other], other: recording[one]}
        says = f"columns {one} and {other} seem to be exchanged"
        yield Reading(_with(recording, channels), says, "exchange their names in the first line")


def _converts(unit: str, wanted: str) -> bool:
    return unit != wanted and factor(unit, wanted) is not None


def _rescaled(rig: Rig, recording: Recording, units: dict[str, str]) -> Reading:
    channels = dict(recording.channels)
    for name, unit in units.items():
        channels[name], _ = converted(recording[name], unit, name, rig.channels[name].unit)
    told = [f"{name} seems to be in {unit}, not in {rig.channels[name].unit}" for name, unit in units.items()]
    return Reading(_with(recording, channels), " and ".join(told), "convert it, or change rig.toml and the plant")


def _with(recording: Recording, channels: dict[str, np.ndarray]) -> Recording:
    return with_channels(recording, channels, recording.units)


@np.errstate(over="ignore", invalid="ignore")  # a run may diverge
def _errors(error: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The RMS error of each channel in parts of its spread (channels,). error, target: (samples, channels)."""
    found = np.sqrt(np.mean(error**2, axis=0)) / (np.std(target, axis=0) + TINY)
    return np.nan_to_num(found, nan=np.inf, posinf=np.inf)


def _mean(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def _score(model: Model, recording: Recording) -> float:
    """How far the data sheet's run errs: a swing that is lost at last may be followed at first."""
    found = []
    for one, run in zip(model.each, recording.runs, strict=True):
        over = one.over(run)
        error = over.target - over.predict(over.values)
        parts = [slice(max(round(share * len(error)), 1)) for share in (*LED, 1.0)]
        found += [np.mean(np.minimum(_errors(error[part], over.target[part]), 1.0)) for part in parts]
    return float(np.mean(found))


def _calibrated(search: Search, reading: Reading) -> float:
    """RMS error of the run that is calibrated to a reading, all channels together, in parts of their spreads."""
    other = Search(search.rig, reading.recording, search.effects)
    likelihood = other.final
    fit = other.led(other.fit(likelihood, Hypothesis(), other.base(likelihood).values))
    return _mean(_errors(likelihood.residual(fit.values), likelihood.model.target))
