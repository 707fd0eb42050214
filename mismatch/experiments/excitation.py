"""What a recording can show at all: a signal that never moves tells nothing about the effects that depend on it."""

from collections.abc import Iterable, Mapping
from itertools import combinations

import numpy as np

from greygate.errors import InputError
from greygate.mismatch.effects import Effect, fitting
from greygate.mismatch.fit import Fit
from greygate.mismatch.rig import Rig
from greygate.plants.recording import Recording

STILL = 3.0  # times the RMS of the sensor: a signal that stays within does not move
SEEN = 10.0  # of cost that an effect of its typical size must cause to be seen
NAMED = 4  # effects in a message


def check(rig: Rig, recording: Recording, effects: Mapping[str, Effect]) -> None:
    """Raises InputError for a recording in which nothing ever moves, or two moving outputs of one unit never differ."""
    known = fitting(rig.plant, rig.datasheet, effects).values()
    still = [name for name, channel in rig.channels.items() if _still(recording[name], channel.sigma)]
    if len(still) == len(rig.channels):
        _fail(recording, [e.id for e in known], f"{', '.join(still)} never move", "excite the rig")
    for one, other in combinations([name for name in rig.predict if name not in still], 2):
        a, b = rig.channels[one], rig.channels[other]
        if a.unit == b.unit and _still(recording[one] - recording[other], float(np.hypot(a.sigma, b.sigma)), 0.0):
            lost = [e.id for e in known if {one, other} <= set(e.depends_on)]
            _fail(recording, lost, f"{one} and {other} never differ", "record a motion that sets them apart")


def unseen(fit: Fit) -> list[str]:
    """Effects of the table that, at their typical size, change nothing at `fit` that the sensors show."""
    likelihood = fit.likelihood
    model = likelihood.model
    values = {s: v for s, v in fit.values.items() if s in model.values}
    seen, tried = set(), []
    for effect in fitting(model.rig.plant, model.rig.datasheet, model.effects).values():
        if effect.id == "unknown":
            continue
        tried.append(effect.id)
        typical = {**values, **effect.set, **{f.symbol: f.guess[0] if f.guess else f.typical for f in effect.free}}
        change = likelihood.errors(typical, fit.shifts) - fit.errors
        if not np.sum(np.square(change)) < SEEN:
            seen.add(effect.id)
    return sorted(set(tried) - seen)


def _still(signal: np.ndarray, sigma: float, about: float | None = None) -> bool:
    """Whether the signal stays `about` a value, by default its mean, within the noise of its sensor."""
    away = signal - (np.mean(signal) if about is None else about)
    return bool(np.ptp(signal) == 0.0 or np.sqrt(np.mean(away**2)) <= STILL * sigma)


def _fail(recording: Recording, lost: Iterable[str], why: str, wish: str) -> None:
    names = list(dict.fromkeys(lost))
    what = ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")
    shown = f"this recording cannot show {what}: " if names else ""
    raise InputError(f"{recording.source}: {shown}{why}; {wish}")
