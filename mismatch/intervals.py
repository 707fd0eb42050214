"""The intervals of an effect's parameters, as a diagnosis reports them."""

from collections.abc import Mapping

import numpy as np

from greygate.mismatch.effects import Effect
from greygate.mismatch.fit import NORMAL, Fit, Likelihood
from greygate.mismatch.model import TINY

WIDER = 1.25  # by which intervals are widened: then 95 % of the true values of concealed cases are inside
SHARES = (0.1, 0.3, 0.6)  # of a found size, at which an effect is held while all else is fitted again
HELD = 4  # iterations of such a fit


def interval(value: float, deviation: float) -> list[float]:
    """The 95 % interval of a value."""
    reach = NORMAL * WIDER * deviation
    return [value - reach, value + reach]


def reported(effect: Effect, fit: Fit, least: float = 0.0, together: bool = True) -> dict:
    """An effect's parameters as the diagnosis names them -> value, ci95, unit.

    least: share of its sizes below which the recording rules it out, where that is known better (`least_share`).
    together: whether the data sheet's errors may have one cause (`undetermined`).
    """
    symbols = [u.symbol for u in fit.unknowns]
    scales = np.array([abs(u.scale) for u in fit.unknowns])
    covariance = fit.covariance * np.outer(scales, scales)
    waves = {s for pair in effect.wave.values() for s in pair}
    out: dict[str, dict] = {}
    for name, (sine, cosine) in effect.wave.items():
        s, c = fit.values[sine], fit.values[cosine]
        at = [symbols.index(sine), symbols.index(cosine)]
        size = max(float(np.hypot(s, c)), TINY)
        inner = covariance[np.ix_(at, at)]
        along, across = np.array([s, c]) / size, np.array([-c, s]) / size**2
        unit = next(f.unit for f in effect.free if f.symbol == sine)
        out[name] = {"value": size, "ci95": interval(size, float(np.sqrt(along @ inner @ along))), "unit": unit}
        phase = float(np.arctan2(c, s))
        out[f"{name}_phase"] = {
            "value": phase, "ci95": interval(phase, float(np.sqrt(across @ inner @ across))), "unit": "rad",
        }  # fmt: skip
    for f in effect.free:
        if f.symbol in waves:
            continue
        value = fit.values[f.symbol]
        deviation = 0.0 if f.whole else fit.together[f.symbol] if together else fit.deviation(f.symbol)
        unit = f.unit or fit.likelihood.model.plant.parameters[f.symbol].unit
        out[f.reported] = {"value": value, "ci95": interval(value, deviation), "unit": unit}
    for name in sizes(effect, out) if least else ():
        value, (low, high) = out[name]["value"], out[name]["ci95"]
        out[name]["ci95"] = [max(low, least * value), high] if value > 0.0 else [low, min(high, least * value)]
    return out


def sizes(effect: Effect, found: Mapping[str, Mapping]) -> list[str]:
    """The reported parameters that are sizes of the effect: at 0 there is none."""
    return [*effect.wave, *(f.reported for f in effect.strengths if f.reported in found)]


def margin(effect: Effect, fit: Fit) -> float:
    """How far the surest of an effect's sizes is from 0, in half widths of its interval: above 1 it holds no 0."""
    found = reported(effect, fit, together=False)
    halves = {name: (found[name]["ci95"][1] - found[name]["ci95"][0]) / 2 for name in sizes(effect, found)}
    return max((abs(found[name]["value"]) / max(half, TINY) for name, half in halves.items()), default=0.0)


def least_share(effect: Effect, fit: Fit) -> float:
    """The largest of SHARES of an effect's found size that the recording rules out; 0 where it rules out none.

    Near an end that gives way no further (a rim, a stop) a straight line through the found size tells nothing of zero.
    So the size is held at that share, and everything else is fitted again.
    """
    strengths = {f.symbol for f in effect.strengths}
    likelihood, rest = fit.likelihood, [u for u in fit.unknowns if u.symbol not in strengths]
    wider = fit.widened(strengths)
    even = np.ones(len(fit.temper))
    here = likelihood.cost(fit.errors, fit.shifts, even) + float(np.sum(fit.weight * fit.numbers**2))
    found = 0.0
    for share in SHARES:
        held = {**fit.values, **{s: share * fit.values[s] for s in strengths}}
        again = Likelihood.fit(likelihood, rest, held, fit.shifts, iterations=HELD)
        if not again.cost - here > (NORMAL * WIDER) ** 2 * wider:
            break
        found = share
    return found
