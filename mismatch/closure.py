"""Where no effect of the table fits: the equation in which something is missing, what it depends on, and a term for it.

Each equation, and each sensor, in turn gets a sum of a few functions of the signals. They are chosen and judged on
stretches of the recording that their coefficients were not fitted to. What is missing is missing where that sum removes
most of the misfit; in an equation the sum becomes the term called `unknown`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from greygate.mismatch.effects import SENSOR, Effect, Free
from greygate.mismatch.fit import NORMAL, Fit
from greygate.mismatch.forced import EXPECTED, sensors
from greygate.mismatch.formula import ALIKE, WORTH
from greygate.mismatch.halves import Halves
from greygate.mismatch.libraries import Basis, declared
from greygate.mismatch.rig import Rig
from greygate.mismatch.search import Hypothesis, Search
from greygate.mismatch.unnamed import unnamed, unnamed_beside
from greygate.plants.closure import SEEN, Place
from greygate.plants.expressions import names, replaced

TERMS = 4  # basis functions in a closure, at most
SURE = 5.0  # standard deviations of a coefficient, below which its function goes again
CONFIDENCE_DIGITS = 4  # behind the point, of a share in diagnosis.json
LEAST = 1e-9  # cost, in place of a misfit of 0


class NowhereError(Exception):
    """The plant has no place in which a term may be missing."""


def bases(search: Search, signals: Mapping[str, np.ndarray]) -> dict[str, Basis]:
    """Place -> functions that may be missing there, as the plant's file declares them.

    signals: inputs and states along the recording (samples,). A function of a signal that does not move is left out.
    """
    seen = {f"{limit}{symbol}" for limit in SEEN for symbol in signals}
    found = declared(search.rig.plant)
    return {
        where: {
            name: candidate
            for name, candidate in basis.items()
            if {n for n in names([candidate.expression]) if n.startswith(SEEN)} <= seen
        }
        for where, basis in found.items()
    }


def _subset(halves: Halves, mine: list[int], total: float) -> tuple[float, list[int]]:
    """(cost saved, columns): the smallest set of `mine` to which a further function adds little."""
    plain = halves.saved([])
    gain, chosen = max((halves.saved([j]) - plain, [j]) for j in mine)
    for size in range(2, TERMS + 1):
        if size == 2:
            trials = [list(pair) for pair in combinations(mine, 2)]
        else:
            trials = [[*chosen, j] for j in mine if j not in chosen]
        saved = [(halves.saved(use) - plain, use) for use in trials]
        most = max(saved)[0]
        if not most - gain >= WORTH * total:  # nor where it is no number
            break
        # of those nearly as good the ones declared first: plain powers before waves and bumps
        least = most - ALIKE * max(total, 0.0)
        gain, chosen = min(((g, use) for g, use in saved if g >= least), key=lambda t: sum(t[1]))
    return gain, chosen


@dataclass(frozen=True)
class _Unknowns:
    """The candidates of all places as effects, joined to the rig's plant, and what each changes in the residuals.

    keys: (place, key of the effect, or function of a sensor) of each column.
    """

    search: Search
    effects: dict[str, Effect]
    seen: dict[str, float]
    base: Fit
    keys: list[tuple[str, str]]
    columns: np.ndarray

    @classmethod
    def of(cls, search: Search, given: Hypothesis, values: Mapping[str, float] | None) -> "_Unknowns":
        rig = search.rig
        signals = _signals(search)
        low, high = SEEN
        seen = {f"{low}{symbol}": float(signal.min()) for symbol, signal in signals.items()}
        seen |= {f"{high}{symbol}": float(signal.max()) for symbol, signal in signals.items()}
        effects = _effects(rig, bases(search, signals))
        limits = tuple(Free(symbol, value, shape=True) for symbol, value in seen.items())
        beside = {key: search.effects[key] for key in given.effects}  # a plant with all effects takes twice the time
        joined = {**beside, **effects, "seen": Effect("seen", "", (rig.plant.name,), (), (), limits)}
        again = Search(rig, search.final.model.recording, joined, noise=search.noise)
        again.effects, again.between = joined, search.between
        likelihood = again.final
        base = again.fit(likelihood, given, values or {}) if given.size else again.base(likelihood, values)
        keys = [(effect.equations[0], key) for key, effect in effects.items()]
        columns = []
        for _, key in keys:
            unknowns = [again._unknown(f) for f in effects[key].free]
            start = {**base.values, **{f.symbol: 0.0 for f in effects[key].free}}
            columns.append(base.rows(unknowns, start))
        if rig.window:
            for place, column in sensors(base).items():
                keys.append(place)
                columns.append(likelihood.rows(column[:, :, None], base.temper))
        if not columns:
            raise NowhereError
        joint = likelihood.eliminate(np.concatenate(columns, axis=2), None, base.basis)[0]
        return cls(again, effects, seen, base, keys, joint)

    def chosen(self) -> tuple[str, list[str], float]:
        """(place, its functions, share of the misfit that they take) where a term removes most."""
        halves = Halves.of(self.base, self.columns)
        noise = self.search.final.expected * EXPECTED / float(np.mean(self.base.temper**2))
        total = float(np.sum(self.base.projected**2)) - (noise + halves.saved([]) if noise else 0.0)
        best = {
            place: _subset(halves, [halves.k + j for j, key in enumerate(self.keys) if key[0] == place], total)
            for place in dict.fromkeys(place for place, _ in self.keys)
        }
        place, (gain, at) = max(best.items(), key=lambda item: item[1][0] - WORTH * total * len(item[1][1]))
        share = float(np.clip(gain / max(total, LEAST), 0.0, 1.0))
        return place, [self.keys[j - halves.k][1] for j in sorted(at)], share

    def where(self, place: str, chosen: Sequence[str]) -> dict:
        """The equation of a place as a diagnosis reports it, and the signals on which the chosen functions depend."""
        if place.startswith(SENSOR):
            return {"equation": place, "depends_on": [place.removeprefix(SENSOR)]}
        declared = self.search.rig.plant.closure.places.get(place)
        depends = dict.fromkeys(v for key in chosen for v in self.effects[key].depends_on)
        return {"equation": (declared and declared.reported) or place, "depends_on": list(depends)}

    def fit(self, chosen: list[str]) -> tuple[list[str], Fit]:
        """The functions of which the fit with all that are chosen is sure, and the fit with them."""
        fit = self.search.fit(self.search.final, Hypothesis(tuple(chosen)), self.base.values, self.base.shifts)
        sure = [key for key in chosen if abs(fit.values[key]) > SURE * fit.deviation(key)]
        if sure and sure != chosen:  # the others were there to bend the straight line that chose them
            return sure, self.search.fit(self.search.final, Hypothesis(tuple(sure)), fit.values, fit.shifts)
        return chosen, fit


def _effects(rig: Rig, found: Mapping[str, Basis]) -> dict[str, Effect]:
    """Each candidate as an effect of its own."""
    effects = {}
    for place, basis in found.items():
        typical = rig.plant.closure.places.get(place, Place(())).typical
        for name, candidate in basis.items():
            symbol = f"unknown_{place}_{name}"
            free = (Free(symbol, typical, "", reported=symbol),)
            term = {f"{place}.{symbol}": f"{symbol} * ({candidate.expression})"}
            means, plants = f"unknown term in {place}", (rig.plant.name,)
            effects[symbol] = Effect(symbol, means, plants, (place,), candidate.depends_on, free, term, of="unknown")
    return effects


def left_beside(search: Search, given: Hypothesis, values: Mapping[str, float]) -> list[dict]:
    """Where something is missing beside the hypothesis `given`, which was fitted with `values`."""
    if not search.rig.plant.closure.places:
        where, share = unnamed_beside(search, given, values)
    else:
        try:
            unknowns = _Unknowns.of(search, given, values)
        except NowhereError:
            return []
        place, chosen, share = unknowns.chosen()
        where = [unknowns.where(place, chosen)]
    regime = "left beside it: something that depends on {}, {:.0%} of what is left"
    nothing = "nothing that was recorded"
    return [{**w, "regime": regime.format(", ".join(w["depends_on"]) or nothing, share)} for w in where]


def closure(search: Search, values: Mapping[str, float] | None = None) -> tuple[dict, Fit | None]:
    """(where and effect for the diagnosis, fit with the unknown term; None where a sensor is at fault).

    values: of the plant's parameters, from which it is calibrated; by default the data sheet's. Both are empty for a
    plant that has no place in which a term may be missing. Where the plant's file does not declare of what a term is
    made, it is a formula (formula.py).
    """
    if not search.rig.plant.closure.places:
        return unnamed(search, values)
    try:
        unknowns = _Unknowns.of(search, Hypothesis(), values)
    except NowhereError:
        return {"where": [], "effect": None}, None
    place, chosen, share = unknowns.chosen()
    where = unknowns.where(place, chosen)
    effect, fit = None, None
    if not place.startswith(SENSOR):
        chosen, fit = unknowns.fit(chosen)
        where = unknowns.where(place, chosen)
        effect = {
            "id": "unknown",
            "equations": [where["equation"]],
            "confidence": round(share, CONFIDENCE_DIGITS),
            "parameters": {s: _parameter(unknowns.effects[s], fit, unknowns.seen) for s in chosen},
            "not_told_apart_from": [],
        }
    depends = ", ".join(where["depends_on"])
    regime = f"a term of {depends or 'constant size'}, which takes {share:.0%} of the misfit"
    return {"where": [{**where, "regime": regime}], "effect": effect, "share": share}, fit


def _signals(search: Search) -> dict[str, np.ndarray]:
    """Inputs and states that move, as recorded, or a rate of what was recorded; other states as simulated.

    What is derived of an input is the rate of a state already, where there are states.
    """
    model = search.final.model
    states, inputs = model.states(model.values)
    rates = {state.rate: symbol for symbol, state in model.plant.states.items() if state.rate}
    derived = model.plant.derived if model.plant.states else {}
    found = {name: signal for name, signal in inputs.items() if name not in derived}
    for symbol, simulated in zip(model.plant.states, states.T, strict=True):
        if symbol in model.recording.channels:
            found[symbol] = model.recording[symbol]
        elif rates.get(symbol) in model.recording.channels:
            found[symbol] = model.smooth_rate(rates[symbol])
        elif symbol in search.rig.plant.states:
            found[symbol] = simulated
    return {symbol: signal for symbol, signal in found.items() if np.isfinite(signal).all() and np.ptp(signal) > 0}


def _parameter(effect: Effect, fit: Fit, seen: dict[str, float]) -> dict:
    """A coefficient as the diagnosis keeps it, with the term it stands in, its limits as numbers."""
    symbol = effect.key
    place, term = effect.equations[0], effect.terms[f"{effect.equations[0]}.{symbol}"]
    term = replaced(term, {name: repr(limit) for name, limit in seen.items()})
    value, reach = fit.values[symbol], NORMAL * fit.deviation(symbol)
    return {"value": value, "ci95": [value - reach, value + reach], "unit": "", "place": place, "term": term}
