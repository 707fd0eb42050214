"""How large each effect could be at most where a recording shows none of them.

At the calibrated fit every effect is put beside the parameters in one linearised fit. Its size there, and the 95 %
interval about it, say what the recording rules out. Errors may depend on each other within a window, as everywhere.
Where an effect changes nothing that the sensors show, the reason is what its signals do along the recording.
"""

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from greygate.mismatch.effects import Effect
from greygate.mismatch.excitation import signals
from greygate.mismatch.fit import NORMAL, Fit
from greygate.mismatch.intervals import WIDER
from greygate.mismatch.locate import display_unit
from greygate.mismatch.model import TINY
from greygate.mismatch.rig import Rig
from greygate.mismatch.search import Search
from greygate.plants.recording import Recording

SHAPES = 12  # of an effect's grid that are looked at, at most; the largest bound of them counts
RIDGE = 1e-10  # of a unit diagonal
NOTHING = 1e-6  # of squared change, in units of noise: an effect that does no more does nothing
LITTLE = 0.1  # of its level, by which a signal moves that is said to be why an effect does not show
BEYOND = 30.0  # times its typical size: what is only ruled out from there on is not ruled out in practice


def ruled_out(search: Search, fit: Fit, not_shown: Mapping[str, str]) -> list[dict]:
    """For each effect its `id`, and its `parameters`: name -> value, unit; or `why` the recording cannot show it.

    fit: of the plant without effects. not_shown: key of an effect that was not tried -> why.
    """
    recording = fit.likelihood.model.recording
    out = {}
    for key, effect in search.effects.items():
        if key != effect.id and effect.id in search.effects:
            continue  # another form of an effect
        bound = _bound(search, fit, effect)
        name = key if effect.id in out else effect.id
        out[name] = (
            {"id": name, "parameters": bound} if bound else {"id": name, "why": why(effect, search.rig, recording)}
        )
    out |= {key: {"id": key, "why": reason} for key, reason in not_shown.items() if key not in out}
    return [out[name] for name in sorted(out)]


def _bound(search: Search, fit: Fit, effect: Effect) -> dict[str, dict]:
    """Name -> the least size that is ruled out; empty where none is."""
    found = list(search.directions(fit, effect))
    found = found[:: max(-(-len(found) // SHAPES), 1)]
    most: dict[str, float] = {}
    units = {f.symbol: f.unit or fit.likelihood.model.plant.parameters[f.symbol].unit for f in effect.free}
    for _, point, columns in found:
        if not np.sum(columns**2) > NOTHING:
            return {}
        reach = _reach(fit, columns)
        if point:
            sizes = {symbol: abs(value) * reach[0] for symbol, value in point.items() if _strong(effect, symbol)}
        else:
            sizes = {f.symbol: abs(f.typical) * r for f, r in zip(effect.strengths, reach, strict=True)}
        if not np.isfinite(reach).all() or np.min(reach) > BEYOND:
            return {}
        for symbol, size in sizes.items():
            most[symbol] = max(size, most.get(symbol, 0.0))
    if not most:
        return {}
    waves = {s for pair in effect.wave.values() for s in pair}
    out = {name: {"value": float(np.hypot(most[pair[0]], most[pair[1]])), "unit": units[pair[0]]}
           for name, pair in effect.wave.items()}  # fmt: skip
    for f in effect.strengths:
        if f.symbol not in waves and f.symbol in most:
            out[f.reported] = {"value": float(most[f.symbol]), "unit": units[f.symbol]}
    return out


def _strong(effect: Effect, symbol: str) -> bool:
    return symbol in {f.symbol for f in effect.strengths}


def _reach(fit: Fit, columns: np.ndarray) -> np.ndarray:
    """The end of the interval of each column's size that is farther from 0 (n,), the parameters fitted along."""
    k, n = len(fit.unknowns), columns.shape[2]
    slopes = np.concatenate([fit.slopes, columns], axis=2)
    flat = slopes.reshape(-1, k + n)
    weight = np.concatenate([fit.weight, np.zeros(n)])
    normal, right = flat.T @ flat + np.diag(weight), -(flat.T @ fit.projected.reshape(-1))
    right[:k] -= fit.weight * fit.numbers
    scale = np.sqrt(np.maximum(np.diag(normal), TINY))
    bread = np.linalg.pinv(normal / np.outer(scale, scale) + RIDGE * np.eye(k + n), hermitian=True) / np.outer(
        scale, scale
    )
    step = bread @ right
    left = fit.projected + np.einsum("wrk,k->wr", slopes, step)
    scores = np.einsum("wrk,wr->wk", slopes, left)
    scores = scores - scores.mean(axis=0)
    windows = len(scores)
    meat = scores.T @ scores * windows / max(windows - k - n, 1) + np.diag(weight)
    robust, white = bread @ meat @ bread, bread * max(1.0, float(np.mean(left**2)))
    deviation = np.sqrt(np.maximum(np.diag(robust), np.diag(white)))
    return (np.abs(step) + NORMAL * WIDER * deviation)[k:]


def why(effect: Effect, rig: Rig, recording: Recording) -> str:
    """What the signals that an effect depends on do along the recording, in words."""
    given = signals(rig, recording)
    names = [name for name in effect.depends_on if name in given] or list(rig.inputs)
    units = {name: rig.channels[name].unit for name in names if name in rig.channels}
    for one, other in combinations([n for n in names if n in units], 2):
        apart = given[one] - given[other]
        if units[one] == units[other] and np.max(np.abs(apart)) < LITTLE * np.max(np.abs(given[one])):
            return f"{one} and {other} never differ by more than {_size(apart, units[one])}"
    for n in names:
        if np.ptp(given[n]) < LITTLE * np.max(np.abs(given[n])):
            return f"{n} moves by no more than {_size(np.ptp(given[n]), units.get(n, ''))}"
    return "it changes the readings too little beside what the parameters can do"


def _size(signal: np.ndarray | float, unit: str) -> str:
    size = float(np.max(np.abs(signal)))
    factor, label = display_unit(unit, size)
    return f"{factor * size:.3g} {label}".rstrip()
