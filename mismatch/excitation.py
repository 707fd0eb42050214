"""What a recording can show at all: a signal that never moves tells nothing about the effects that depend on it.

A general effect says what a signal does to another: a dead zone, a sensor's end. Where along a recording it does no
more than a gain and an offset do, its name cannot be told from these: a dead zone of an input that is never near zero,
an asymmetry of one that never changes its sign, an end of a sensor beyond which all readings lie.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from greygate.errors import InputError
from greygate.mismatch.cores import each
from greygate.mismatch.effects import GENERAL, SENSOR, Effect, fitting
from greygate.mismatch.fit import Fit
from greygate.mismatch.model import FILTERS, TINY, Model
from greygate.mismatch.rig import Rig
from greygate.mismatch.runs import along
from greygate.plants.expressions import names
from greygate.plants.plant import Values
from greygate.plants.recording import Recording

STILL = 3.0  # times the RMS of the sensor: a signal that stays within does not move
SEEN = 10.0  # of cost that an effect of its typical size must cause to be seen
NAMED = 4  # effects in a message
BENT = 0.01  # of the variance of what an effect does, that no gain and offset make: less has no name
FEWEST = 5  # samples at which that shows, at least
ROUNDING = 1e-6  # of the largest change, below which what is left of it is rounding
GLITCHES = 2e-3  # of all samples: so many of the largest values count as glitches
REACHES = (0.03, 0.1, 0.3)  # of a signal's largest size: widths and ends at which an effect is tried beforehand
TAKEN_UP = 0.999  # of its width: where a play stands before that, nobody knows
LATE = 5.0  # samples: a delay or a lag that is tried
KELVIN = "K"  # a temperature changes no sign
FARTHEST = 10.0  # times a signal's largest size, beyond which nothing offsets it
ROUND = (-1.0, 1.0, 801)  # first and last level and samples of a signal that passes every level and turns
RATES = ("rate", "smooth_rate")  # ways in which an input is derived that make a velocity


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


def unseen(fit: Fit, effects: Iterable[Effect] | None = None) -> list[str]:
    """Names of effects that, at their typical size, change nothing at `fit` that the sensors show.

    effects: by default those that were joined to the plant.
    """
    likelihood = fit.likelihood
    model = likelihood.model
    values = {s: v for s, v in fit.values.items() if s in model.values}
    if effects is None:
        effects = fitting(model.rig.plant, model.rig.datasheet, model.effects).values()
    tried = [effect for effect in effects if effect.id != "unknown"]
    rough, gives, base = fit.rough

    def shows(effect: Effect) -> bool:
        typical = {**effect.set, **{f.symbol: f.guess[0] if f.guess else f.typical for f in effect.free}}
        if answer := rough.model.answering(effect, values, fit.shifts * likelihood.local_scale):
            change = likelihood.white(answer(typical))
        else:
            change = gives({**values, **typical}, fit.shifts) - base
        return not np.sum(np.square(change)) < SEEN

    seen = {effect.id for effect, shown in zip(tried, each(shows, tried), strict=True) if shown}
    return sorted({effect.id for effect in tried} - seen)


# -- what a general effect does more than a gain ---------------------------------------------------------------------


@dataclass(frozen=True)
class Action:
    """What an effect does along a recording: to the signal `name`, or to a balance if that is empty.

    moved: name -> the signals it depends on, each (samples,). change: what it adds there (samples,). size: the largest
    value of the signal `name`, infinite where that is not recorded.
    """

    name: str
    moved: Mapping[str, np.ndarray]
    change: np.ndarray
    size: float = np.inf

    @property
    def bent(self) -> bool:
        """Whether no gain and no offset does the same: of the signal that it changes, or of what moves a balance."""
        if not np.isfinite(self.change).all() or np.count_nonzero(self.change) < FEWEST:
            return False
        away = np.abs(self.change - np.median(self.change))
        usual = away <= usual_size(away)  # a glitch of a derived signal, as large as it may be, decides nothing
        change = self.change[usual]
        own = (signal[usual] for name, signal in self.moved.items() if self.name in ("", name))
        affine = np.column_stack([np.ones(len(change)), *own])
        affine = affine / (np.max(np.abs(affine), axis=0) + TINY)
        left = change - affine @ np.linalg.lstsq(affine, change, rcond=None)[0]
        if not np.std(left) > ROUNDING * np.max(np.abs(change)):
            return False
        return bool(np.var(left) > BENT * np.var(change))

    @property
    def far(self) -> bool:
        """Whether it is out of all proportion to the signal that it changes."""
        return bool(self.name) and not np.max(np.abs(self.change)) <= FARTHEST * self.size


def usual_size(signal: np.ndarray) -> float:
    """The largest magnitude of a signal (samples,) that is no glitch."""
    most = max(round(GLITCHES * len(signal)), 1)
    return float(np.partition(np.abs(signal), -most)[-most])


def excited(model: Model, effects: Mapping[str, Effect]) -> tuple[dict[str, Effect], dict[str, str]]:
    """(the effects that the model's recording can show, key of each other one -> why it cannot).

    Only general effects are judged: what a table has of one plant, its author knows to be possible.
    """
    rig, kept, why = model.rig, {}, {}
    given = signals(rig, model.recording)
    shown = [given, {**given, **_true(model, {})}]  # a sensor acts on what is there, not on what it reads of it
    cut = model.pieces
    for key, effect in effects.items():
        reasons = [_reason(effect, rig, seen, values, cut) for seen in shown for values in _tried(effect, seen, rig.dt)]
        if reasons and all(reasons):
            why[key] = reasons[-1]
        else:
            kept[key] = effect
    return kept, why


def unexcited(effect: Effect, model: Model, values: Mapping[str, float]) -> str:
    """Why a model's recording cannot show a general effect of such `values` (symbol -> value); empty where it can."""
    if effect.table != str(GENERAL):
        return ""
    given = signals(model.rig, model.recording)
    if any(path.startswith(SENSOR) for path in effect.terms):
        given = {**given, **_true(model, values)}
    return _reason(effect, model.rig, given, values, model.pieces)


def signals(rig: Rig, recording: Recording) -> dict[str, np.ndarray]:
    """Channels, time, the rates of recorded positions and derived inputs, each (samples,), in SI units."""
    if len(recording.runs) > 1:
        each = [signals(rig, run) for run in recording.runs]
        return {name: np.concatenate([found[name] for found in each]) for name in each[0]}
    found = {"t": recording.time, **recording.channels}
    rates = {state.rate: x for x, state in rig.plant.states.items() if state.rate and state.rate in rig.plant.states}
    rates |= {name: how.split()[1] for name, how in rig.plant.derived.items() if how.split()[0] in RATES}
    for rate, position in rates.items():
        if rate not in found and position in recording.channels:
            found[rate] = np.gradient(recording[position], rig.dt)
    return found


@np.errstate(over="ignore", invalid="ignore")  # a run may diverge
def _true(model: Model, values: Mapping[str, float]) -> dict[str, np.ndarray]:
    """What is there of each predicted channel, by the simulation and before its sensor, (samples,)."""
    known = {s: v for s, v in values.items() if s in model.values}
    states, _ = model.states({**model.values, **known})
    sheet = {s: v for s, v in known.items() if s in model.rig.plant.parameters}
    found = dict(zip(model.rig.predict, model.predict({**model.values, **sheet}).T, strict=True))
    found |= dict(zip(model.plant.states, states.T, strict=True))
    return {name: found[name] for name in model.rig.predict if np.isfinite(found[name]).all()}


def _reason(
    effect: Effect,
    rig: Rig,
    given: Mapping[str, np.ndarray],
    values: Mapping[str, float],
    cut: Sequence[slice],
) -> str:
    turning = np.concatenate([np.linspace(*ROUND), np.linspace(*ROUND)[::-1]] * 2)
    ideal = {name: turning * FARTHEST * max(usual_size(s), TINY) for name, s in given.items()}
    found, units = "", {name: channel.unit for name, channel in rig.channels.items()}
    whole = [slice(0, len(turning))]
    pairs = zip(_actions(effect, rig, given, values, cut), _actions(effect, rig, ideal, values, whole), strict=True)
    for here, there in pairs:
        if here.far:
            return f"it would be more than {FARTHEST:g} times as large as {here.name} itself"
        if here.bent:
            return ""
        if there.bent:
            found = found or _why(here, units)
    return found


def _why(action: Action, units: Mapping[str, str]) -> str:
    for name, signal in action.moved.items():
        if np.ptp(signal) == 0.0:
            return f"{name} never moves"
        if (np.min(signal) >= 0.0 or np.max(signal) <= 0.0) and units.get(name) != KELVIN:
            return f"{name} never changes its sign"
    return f"along this recording a gain or an offset of {', '.join(action.moved) or action.name} does the same"


def _actions(
    effect: Effect,
    rig: Rig,
    given: Mapping[str, np.ndarray],
    values: Mapping[str, float],
    cut: Sequence[slice],
) -> list[Action]:
    """What the effect does; none where it depends on what is not recorded. cut: the samples of each recording."""
    out, sizes = [], {name: float(np.max(np.abs(signal))) for name, signal in given.items()}
    for name, text in effect.filters.items():
        kind, *symbols = text.split()
        if kind not in FILTERS or name not in given:
            return []
        acts = values[symbols[0]] != 0.0
        by = [values[s] for s in symbols]
        made = (
            along(lambda part, k=kind, by=by: FILTERS[k](part, *by, rig.dt), cut, given[name]) if acts else given[name]
        )
        change = made - given[name]
        first = int(np.argmax(np.abs(change) >= TAKEN_UP * np.max(np.abs(change)))) if kind == "play" else 0
        out.append(Action(name, {name: given[name][first:]}, change[first:], sizes[name]))
    for path, text in effect.terms.items():
        scope = Values(rig.plant, given)
        scope.update(values)
        try:
            change = scope.evaluate(text)
        except InputError:
            return []
        place = path.partition(".")[0]
        name = place.removeprefix(SENSOR) if place.startswith(SENSOR) else ""
        moved = {n: given[n] for n in names([text]) if n in given}
        change = np.broadcast_to(change, len(given["t"])).astype(float)
        out.append(Action(name, moved, change, sizes.get(name, np.inf)))
    return out


def _tried(effect: Effect, given: Mapping[str, np.ndarray], dt: float) -> list[dict[str, float]]:
    """Values of a general effect's parameters, by the size of what it acts on, at which it is looked at beforehand."""
    if effect.table != str(GENERAL):
        return []
    filtered = {symbol: name for name, text in effect.filters.items() for symbol in text.split()[1:]}
    out = []
    for k, reach in enumerate(REACHES):
        values = dict(effect.set)
        for f in effect.free:
            guesses = f.guess or (f.typical,)
            values[f.symbol] = guesses[min(k, len(guesses) - 1)]
            if f.guess or f.symbol not in filtered:
                continue
            if f.unit == "s":
                values[f.symbol] = LATE * dt
            elif f.unit != "1":
                values[f.symbol] = reach * usual_size(given.get(filtered[f.symbol], np.ones(1)))
        out.append(values)
    return out


def _still(signal: np.ndarray, sigma: float, about: float | None = None) -> bool:
    """Whether the signal stays `about` a value, by default its mean, within the noise of its sensor."""
    away = signal - (np.mean(signal) if about is None else about)
    return bool(np.ptp(signal) == 0.0 or np.sqrt(np.mean(away**2)) <= STILL * sigma)


def _fail(recording: Recording, lost: Iterable[str], why: str, wish: str) -> None:
    names = list(dict.fromkeys(lost))
    what = ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")
    shown = f"this recording cannot show {what}: " if names else ""
    raise InputError(f"{recording.source}: {shown}{why}; {wish}")
