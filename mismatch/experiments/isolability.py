"""What a rig's sensors and a recording's motion can show, before anything is explained.

Each effect changes the predicted channels in a direction. The part of this change that the parameters, inside their
tolerances, and the windows' beginnings can take up is not seen. Two effects are not told apart where one of them, of
any size, takes up the change of the other but for noise, or but for a tenth: a machine's effect is never quite the
table's.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import TypedDict

import numpy as np
from scipy.optimize import lsq_linear

from greygate.mismatch.coloured import coloured_likelihood, resized
from greygate.mismatch.effects import Effect
from greygate.mismatch.experiments.rivals import ITERATIONS
from greygate.mismatch.experiments.separation import (
    NEEDED,
    WORTH,
    Apart,
    Sensor,
    Separation,
    Trials,
    deviations,
    figure,
    imagined,
    sensor,
)
from greygate.mismatch.fit import Fit, Likelihood, tame
from greygate.mismatch.model import TINY
from greygate.mismatch.search import ROUGH, Hypothesis, Search
from greygate.plain import Figure

FORM = 0.1  # of an effect, by which a machine's may differ from the table's: a smaller difference tells nothing
TOLD = 1.0  # singular value below which the data sheet knows more than the recording
WEIGHTY = 0.3  # of a combination of parameters, the least that is named


class Alike(TypedDict):
    effects: list[str]
    pair: list[str]
    here: Figure
    experiment: Apart | None
    sensor: Sensor | None


class LeftToSheet(TypedDict):
    singular_value: Figure
    parameters: dict[str, float]


class Isolated(TypedDict):
    """What a rig's sensors cannot tell apart."""

    plant: str
    groups: list[Alike]
    unseen: list[Alike]
    singular_values: list[Figure]
    left_to_data_sheet: list[LeftToSheet]


@dataclass(frozen=True)
class Group:
    """Effects that are not told apart, or one that is not told from nothing, and what would tell the two most alike.

    pair: these two. here: standard deviations of the noise between them on the recording. sensor: (state, standard
    deviations with a sensor of it, on the same recording). Either is None where nothing tells.
    """

    effects: tuple[str, ...]
    pair: tuple[str, ...]
    here: float
    experiment: Separation | None
    sensor: tuple[str, float] | None

    def as_dict(self, units: Mapping[str, str]) -> Alike:
        named: Sensor | None = {"state": self.sensor[0], "apart": self.sensor[1]} if self.sensor else None
        tried = self.experiment.as_dict(units) if self.experiment else None
        effects, pair = list(self.effects), list(self.pair)
        return {"effects": effects, "pair": pair, "here": self.here, "experiment": tried, "sensor": named}


@dataclass(frozen=True)
class Isolability:
    """groups: effects that cannot be told apart. unseen: those that, of typical size, do not show.

    singular: values of the Jacobian, scaled by noise and tolerance, largest first. weak: those below TOLD, of which the
    recording says less than the data sheet, each with its combination of parameters. units: of the channels.
    """

    groups: list[Group]
    unseen: list[Group]
    singular: list[float]
    weak: list[tuple[float, dict[str, float]]]
    units: Mapping[str, str]

    def as_dict(self) -> dict:
        return {
            "groups": [group.as_dict(self.units) for group in self.groups],
            "unseen": [group.as_dict(self.units) for group in self.unseen],
            "singular_values": self.singular,
            "left_to_data_sheet": [{"singular_value": value, "parameters": parts} for value, parts in self.weak],
        }

    def lines(self) -> list[str]:
        """What a person reads."""
        out = []
        for group in self.groups:
            less = ", less than a tenth of it" if group.here > NEEDED else ""
            apart = f"{' and '.join(group.pair)} differ by {deviations(group.here)}{less}"
            out += [f"not told apart: {', '.join(group.effects)}", f"  {apart}", *self._remedies(group, "apart")]
        for group in self.unseen:
            out += [f"hardly shows: {group.effects[0]}, {deviations(group.here)}", *self._remedies(group, "seen")]
        for value, parts in self.weak:
            mixed = " ".join(f"{weight:+.2f} {symbol}" for symbol, weight in parts.items())
            out.append(f"left to the data sheet: {mixed}, singular value {value:.2g}")
        if self.singular:
            out.append(f"singular values of the parameters: {', '.join(map(figure, self.singular))}")
        return out if self.groups or self.unseen else ["every effect shows, and no two are alike", *out]

    def _remedies(self, group: Group, end: str) -> list[str]:
        if group.experiment is None and group.sensor is None:
            return [f"  {end} by no experiment that was tried, and by no sensor of a state"]
        experiment = [f"  {end} by {group.experiment.words(self.units)}"] if group.experiment else []
        state, apart = group.sensor or ("", 0.0)
        return experiment + ([f"  {end} by a sensor of {state}: {deviations(apart)}"] if state else [])


def isolability(search: Search) -> Isolability:
    """What the recording of `search` shows of its effects, each in its plain form and of its typical size."""
    fit = base(search)
    effects: dict[str, Effect] = {}
    for effect in search.effects.values():
        effects.setdefault(effect.id, effect)
    rows = _coordinates(fit, {name: moved(fit, effect) for name, effect in effects.items()})
    sizes = {name: float(_lengths(columns).max()) for name, columns in rows.items()}
    seen = [name for name, size in sizes.items() if size > NEEDED]
    apart = {}
    for pair in combinations(seen, 2):
        ways = (pair, pair[::-1])
        apart[pair] = min(_left(_own(rows[a]), rows[b], _reach(effects[b])) / _least(rows[a]) for a, b in ways)
    groups = []
    for names in _groups(seen, apart):
        pair = min(combinations(names, 2), key=lambda pair: apart[pair])
        groups.append(_group(search, fit, names, *(effects[name] for name in pair)))
    unseen = [_group(search, fit, (name,), effects[name]) for name in sizes if name not in seen]
    units = {name: channel.unit for name, channel in search.rig.channels.items()}
    return Isolability(groups, unseen, *_singular(fit), units)


def base(search: Search) -> Fit:
    """The fit of the data sheet's plant.

    Where the noise is not stated, it is what the calibrated plant leaves, and the effects become as large as that.
    """
    unknowns = search.unknowns(Hypothesis())
    if search.rig.stated:
        return search.screen.fit(unknowns, iterations=0)
    fit = search.fit(search.final, Hypothesis(), {})
    likelihood = coloured_likelihood(fit).ordered(fit.likelihood.residual(fit.values))
    search.effects = {key: resized(likelihood, effect, fit) for key, effect in search.effects.items()}
    return Likelihood.fit(likelihood, unknowns, fit.values, iterations=0)


def typical(effect: Effect) -> dict[str, float]:
    """Values at which an effect has its typical size."""
    return {**effect.set, **{f.symbol: f.guess[0] if f.guess else f.typical for f in effect.free}}


def moved(fit: Fit, effect: Effect) -> np.ndarray:
    """Columns (rows, n) by which an effect of typical size changes the errors.

    There is one for each strength, or one for all of them where they start from a guess or from a parameter's value.
    """
    full, likelihood = typical(effect), fit.likelihood
    nothing = {f.symbol: 0.0 for f in effect.strengths}
    steps = [full] if _together(effect) else [{**full, **nothing, s: full[s]} for s in nothing]
    changes = [tame(likelihood.errors({**fit.values, **step}, fit.shifts) - fit.errors) for step in steps]
    columns = likelihood.rows(np.stack(changes, axis=2), fit.temper)
    return likelihood.eliminate(columns, None, fit.basis)[0].reshape(-1, len(steps))


def _together(effect: Effect) -> bool:
    return effect.frees or any(f.guess for f in effect.strengths)


def _reach(effect: Effect) -> tuple[np.ndarray, np.ndarray]:
    """The least and the largest multiple of each of its columns that an effect may have, (n,) each."""
    if _together(effect):
        return np.zeros(1), np.full(1, np.inf)
    ends = np.sort([(f.low / f.typical, f.high / f.typical) for f in effect.strengths], axis=1)
    return ends[:, 0], ends[:, 1]


def _coordinates(fit: Fit, rows: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The columns less what the parameters take up, in a basis of all of them."""
    count = len(fit.unknowns)
    slopes = np.concatenate([fit.slopes.reshape(-1, count), np.diag(np.sqrt(fit.weight))])
    basis, _ = np.linalg.qr(slopes)
    stacked = np.concatenate(list(rows.values()), axis=1)
    stacked = np.concatenate([stacked, np.zeros((count, stacked.shape[1]))])
    left = np.linalg.qr(stacked - basis @ (basis.T @ stacked), mode="r")
    at = np.cumsum([columns.shape[1] for columns in rows.values()])[:-1]
    return dict(zip(rows, np.split(left, at, axis=1), strict=True))


def _lengths(columns: np.ndarray) -> np.ndarray:
    """(n,) of columns, in standard deviations of the noise."""
    return np.sqrt(np.sum(columns**2, axis=0))


def _least(columns: np.ndarray) -> float:
    """Of what may be left of an effect, the least that tells it."""
    return max(NEEDED, FORM * float(_lengths(columns).max()))


def _own(columns: np.ndarray) -> np.ndarray:
    """Those of an effect that the parameters do not take up: the others are like nothing, not like other effects."""
    return columns[:, _lengths(columns) > _least(columns)]


def _left(columns: np.ndarray, others: np.ndarray, reach: tuple[np.ndarray, np.ndarray]) -> float:
    """What `others`, within `reach`, leave of the column of which they leave least."""
    size = max(float(np.abs(columns).max()), float(np.abs(others).max()), TINY)  # squares of it might be no numbers
    found = (lsq_linear(others / size, column / size, reach).cost for column in columns.T)
    return min(float(size * np.sqrt(2 * max(cost, 0.0))) for cost in found)


def _groups(names: list[str], apart: Mapping[tuple[str, str], float]) -> list[tuple[str, ...]]:
    """Names that are joined by pairs which are less than 1 apart, in units of what would tell them apart."""
    groups = [{name} for name in names]
    for pair, by in apart.items():
        if by < 1.0:
            joined = [group for group in groups if group & set(pair)]
            groups = [group for group in groups if group not in joined] + [set().union(*joined)]
    return [tuple(sorted(group, key=names.index)) for group in groups if len(group) > 1]


def _group(search: Search, fit: Fit, names: tuple[str, ...], one: Effect, other: Effect | None = None) -> Group:
    """The group `names`, with what tells `one` from the best fit of `other`, or of nothing, to its own record."""
    values = {**fit.values, **typical(one)}
    unknowns = search.unknowns(Hypothesis((other.key,) if other else ()))
    start = {**fit.values, **(typical(other) if other else {})}
    rival = Likelihood.fit(imagined(fit.likelihood, values), unknowns, start, iterations=ITERATIONS, enough=ROUGH)
    here = float(np.sqrt(rival.cost))
    experiment = Trials(fit.likelihood, values).apart(rival, here)
    sensed = sensor(fit.likelihood, values, rival)
    return Group(
        names,
        (one.id, other.id) if other else (one.id,),
        here,
        experiment if experiment and experiment.tells else None,
        sensed if sensed and sensed[1] > max(WORTH * here, NEEDED) else None,
    )


def _singular(fit: Fit) -> tuple[list[float], list[tuple[float, dict[str, float]]]]:
    symbols = [u.symbol for u in fit.unknowns]
    if not symbols:
        return [], []
    _, values, rights = np.linalg.svd(np.linalg.qr(fit.slopes.reshape(-1, len(symbols)), mode="r"))
    weak = [
        (float(value), {s: float(w) for s, w in zip(symbols, right, strict=True) if abs(w) > WEIGHTY})
        for value, right in zip(values, rights, strict=True)
        if value < TOLD
    ]
    return values.tolist(), weak
