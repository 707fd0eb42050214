"""What has no name, as a diagnosis reports it: a formula with fitted coefficients, its curve, and the fit with it."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from greygate.mismatch.effects import SENSOR, Effect, Free
from greygate.mismatch.fit import NORMAL, Fit
from greygate.mismatch.forced import Forced, Place
from greygate.mismatch.formula import ONE, Finder, Formula
from greygate.mismatch.general import unit_of_coefficient
from greygate.mismatch.model import TINY
from greygate.mismatch.nearer import settled
from greygate.mismatch.search import Hypothesis, Search
from greygate.plants.expressions import names

CONSTANT = "constant size"
DIGITS = 4  # behind the point, of a share


def unnamed(search: Search, values: Mapping[str, float] | None = None) -> tuple[dict, Fit | None]:
    """(where, effect and share for the diagnosis, the fit with the formula); both empty where there is none.

    values: from which the plant is calibrated.
    """
    finder, formula = settled(search, values)
    if formula is None:
        return {"where": [], "effect": None}, None
    if not formula.shapes:
        share = min(formula.share, 1.0)
        regime = f"the sensor: its faults take {share:.0%} of the misfit"
        depends_on = [formula.place[0].removeprefix(SENSOR)]
        sensor = {"equation": formula.place[0], "depends_on": depends_on, "regime": regime}
        return {"where": [sensor], "effect": None, "share": share}, None
    effects = dict(zip(_symbols(formula), formula.texts, strict=True))
    plain, fit = _fitted(search, finder, formula, [*effects])
    share = _removed(plain, fit)
    parameters = {symbol: _parameter(fit, formula.place, symbol, text) for symbol, text in effects.items()}
    on = ", ".join(formula.depends_on) or CONSTANT
    where: dict = {
        "depends_on": formula.depends_on,
        "regime": f"a term of {on}, which takes {share:.0%} of the misfit",
        "formula": _sum(formula.texts, parameters.values()),
    }
    if formula.as_well:
        where["as_well"] = [_named(formula.place, *other) for other in formula.as_well]
    if curve := finder.curve(formula):
        columns = {"at": curve.at, "value": curve.value, "low": curve.low, "high": curve.high}
        where["curve"] = {"of": curve.signal, **{name: column.tolist() for name, column in columns.items()}}
    effect = {
        "id": "unknown",
        "equations": [*formula.place],
        "confidence": round(share, DIGITS),
        "parameters": parameters,
        "not_told_apart_from": [],
    }
    return {"where": [{"equation": name, **where} for name in formula.place], "effect": effect, "share": share}, fit


def unnamed_beside(search: Search, given: Hypothesis, values: Mapping[str, float]) -> tuple[list[dict], float]:
    """(where something is missing beside what is `given`, fitted with `values`; the share of the misfit there)."""
    finder = Finder(Forced(search, given, values))
    if not finder.forced.places or finder.misfit <= 0.0:
        return [], 0.0
    place, variables, gain = finder.where
    depends_on = sorted(names(variables))
    return [{"equation": name, "depends_on": depends_on} for name in place], min(gain / finder.misfit, 1.0)


def _fitted(search: Search, finder: Finder, formula: Formula, symbols: Sequence[str]) -> tuple[Fit, Fit]:
    """The fits without and with a formula, over the rig's windows or its free run, which is begun near."""
    forced, rig = finder.forced, search.rig
    effects = {
        s: _effect(rig.plant.name, formula.place, s, text, forced.unit(formula.place, text))
        for s, text in zip(symbols, formula.texts, strict=True)
    }
    start = dict(zip(symbols, map(float, finder.coefficients(formula)), strict=True))
    values: Mapping[str, float] = {**forced.base.values, **start}
    for each in [forced.rig, rig][forced.rig is rig :]:
        again = Search(each, search.final.model.recording, effects)
        if each.stated and each.window == rig.window:
            again.under(search.noise)
        again.effects, again.between = effects, search.between
        fit = again.fit(again.final, Hypothesis(tuple(effects)), values)
        values = fit.values
    return again.base(again.final), fit


def _named(place: Place, other: Place, depends_on: Sequence[str]) -> str:
    """Signals of which a term does as well as one in `place`, with their own place where that is another."""
    return (", ".join(depends_on) or CONSTANT) + (f" in {' and '.join(other)}" if other != place else "")


def _effect(plant: str, place: Place, symbol: str, text: str, size: float) -> Effect:
    """A function of a formula as an effect of its own: its coefficient is free. size: of that, where it is large."""
    signs = zip(place, ("", "-"), strict=False)
    terms = {f"{name}.{symbol}": f"{sign}{symbol} * ({text})" for name, sign in signs}
    free = (Free(symbol, size, reported=symbol),)
    return Effect(symbol, "a term without a name", (plant,), place, (), free, terms, of="unknown")


def _parameter(fit: Fit, place: Place, symbol: str, text: str) -> dict:
    """A coefficient as the diagnosis keeps it, with the term it stands in."""
    value, reach = fit.values[symbol], NORMAL * fit.deviation(symbol)
    return {
        "value": value,
        "ci95": [value - reach, value + reach],
        "unit": unit_of_coefficient(fit.likelihood.model.rig, place[0], text),
        "place": place[0],
        "term": f"{symbol} * ({text})",
        **({"against": place[1]} if len(place) > 1 else {}),
    }


def _removed(plain: Fit, fit: Fit) -> float:
    """The share of the squared error beyond the told noise that a fit removes, in the mean over channels."""

    def squared(one: Fit) -> np.ndarray:
        counts = np.isfinite(one.likelihood.sigma).all(axis=1)
        return np.mean(one.likelihood.residual(one.values)[counts] ** 2, axis=0)

    rig = fit.likelihood.model.rig
    noise = np.array([rig.channels[name].sigma ** 2 for name in rig.predict])
    before, after = (np.maximum(squared(one) - noise, 0.0) for one in (plain, fit))
    return float(np.clip(np.mean(1.0 - after / np.maximum(before, TINY)), 0.0, 1.0))


def _sum(texts: Sequence[str], parameters: Iterable[Mapping]) -> str:
    """A formula with its coefficients, as a person reads it: "40 N s/m abs(v) - 22.5 N tanh(v / 0.005)"."""
    sizes = (f"{p['value']:.3g}{' ' * bool(p['unit'])}{p['unit']}" for p in parameters)
    parts = [size if text == ONE else f"{size} {text}" for size, text in zip(sizes, texts, strict=True)]
    return " + ".join(parts).replace(" + -", " - ")


def _symbols(formula: Formula) -> list[str]:
    """A symbol for each coefficient of a formula, by its place, what its function does, and to which signal."""
    found: list[str] = []
    for shape in formula.shapes:
        for text in shape.texts:
            symbol = "_".join(["unknown", formula.place[0], shape.kind, *sorted(names([text]))])
            found.append(symbol if symbol not in found else f"{symbol}_{len(found) + 1}")
    return found
