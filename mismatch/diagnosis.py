"""What a recording says about a plant: the verdict, its grounds, and the file that keeps them (`diagnosis.json`).

A diagnosis claims an effect only where its evidence is strong and little is left unexplained. Where structure stays in
the errors that no effect of the table explains, the verdict is `unexplained`.
"""

import json
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from greygate.errors import InputError
from greygate.files import replacing
from greygate.mismatch import effects as table
from greygate.mismatch.closure import closure
from greygate.mismatch.coloured import Coloured, remaining
from greygate.mismatch.coloured_selection import ColouredSelection
from greygate.mismatch.effects import Effect
from greygate.mismatch.fit import NORMAL, Fit, Likelihood
from greygate.mismatch.locate import located
from greygate.mismatch.model import TINY, Model, begun
from greygate.mismatch.rig import Rig
from greygate.mismatch.search import Hypothesis, Search
from greygate.mismatch.selection import STRUCTURE, Selection, complete, inflation, structure
from greygate.mismatch.verdict import Verdict
from greygate.plain import plain
from greygate.progress import Progress, silent

SCHEMA = "diagnosis/1"
APART = 12.0  # of cost: two hypotheses that differ by less are not told apart
SHARE = 0.99  # of what can be explained: an effect that explains so much is named, though structure is left
WIDER = 1.25  # by which intervals are widened: then 95 % of the true values of concealed cases are inside
FARTHEST = 1400.0  # of cost: a rival this far away has a likelihood of exp(-700), the least that a float can hold
DIGITS = 4  # after the point, of a confidence


@dataclass
class Diagnosis:
    """Everything that was found; `as_dict` gives the content of diagnosis.json.

    calibrated, corrected: the fits of the plant without effects, and of `best`. rivals: cost of every hypothesis that
    was fitted. structure: by channel, what slow errors are left. explained: the share of what can be explained.
    """

    rig: Rig
    verdict: Verdict
    best: Hypothesis
    calibrated: Fit
    corrected: Fit
    rivals: dict[Hypothesis, float]
    structure: dict[str, float]
    explained: float
    search: Search
    unknown: dict = field(default_factory=dict)
    fits: dict = field(default_factory=dict)
    seconds: float = 0.0
    left: str = ""

    # -- the file ----------------------------------------------------------------------------------------------------

    def as_dict(self) -> dict:
        """Content of diagnosis.json, keys as in docs/diagnosis.md; None stands for what is not finite."""
        return plain(
            {
                "schema": SCHEMA,
                "plant": self.rig.plant.name,
                "verdict": self.verdict,
                "where": [dict(place) for place in self._where],
                "effects": self._effects(),
                "parameters": self._parameters(),
                "fit": self.fits,
                "remaining": self._remaining(),
                "seconds": round(self.seconds, 2),
            }
        )

    def write(self, path: Path | str) -> None:
        """Write diagnosis.json, whole or not at all."""
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(self.as_dict(), indent=1) + "\n")

    @cached_property
    def _where(self) -> list[dict]:
        """Every place where something acts: what it is, in which regime of the plant, when, at which frequencies."""
        places: dict[str, dict] = {}
        acting: dict[str, list[tuple[str, ...]]] = {}

        def acts(equation: str, what: str, depends_on: Iterable[str], symbols: Iterable[str]) -> None:
            place = places.setdefault(equation, {"equation": equation, "depends_on": [], "regime": ""})
            place["depends_on"] += [v for v in depends_on if v not in place["depends_on"]]
            place["regime"] += f"; {what}" if place["regime"] else what
            acting.setdefault(equation, []).extend([tuple(symbols)] if symbols else [])

        if self.verdict == Verdict.UNEXPLAINED:
            fitted = (self.unknown.get("effect") or {}).get("parameters", {})
            for place in self.unknown["where"]:
                acts(place["equation"], place["regime"], place["depends_on"], fitted)
        for symbol in self.best.released:
            for equation in self.search.places(symbol):
                acts(equation, f"{symbol} is not what the data sheet says", (), (symbol,))
        for effect in (self.search.effects[key] for key in self.best.effects):
            for equation in effect.equations:
                acts(equation, effect.means, effect.depends_on, (*(f.symbol for f in effect.free), *effect.set))
        return [located(self.corrected, place, acting[equation]) for equation, place in places.items()]

    def _effects(self) -> list[dict]:
        if self.verdict == Verdict.UNEXPLAINED:
            return [self.unknown["effect"]] if self.unknown.get("effect") else []
        if self.verdict != Verdict.MISSING_PHYSICS:
            return []
        out = []
        for key in self.best.effects:
            effect = self.search.effects[key]
            rivals = self._rivals(key)
            out.append(
                {
                    "id": effect.id,
                    "equations": list(effect.equations),
                    "confidence": round(self._confidence(rivals), DIGITS),
                    "form": key,
                    "parameters": reported(effect, self.corrected),
                    "not_told_apart_from": sorted(name for name, gap in rivals.items() if gap < APART),
                }
            )
        return out

    def _rivals(self, key: str) -> dict[str, float]:
        """Every other explanation in the place of effect `key` -> its cost above the best."""
        mine = self.search.effects[key].id
        rest = [k for k in self.best.effects if k != key]
        out: dict[str, float] = {}
        best = self.rivals[self.best]
        for hypothesis, cost in self.rivals.items():
            if hypothesis.size != self.best.size or not set(rest) <= set(hypothesis.effects):
                continue
            others = [k for k in hypothesis.effects if k not in rest]
            names = [self.search.effects[k].id for k in others] + list(hypothesis.released)
            for name in names:
                if name != mine and name not in self.best.released:
                    out[name] = min(out.get(name, np.inf), cost - best)
        return out

    def _confidence(self, rivals: Mapping[str, float]) -> float:
        return float(1.0 / (1.0 + sum(np.exp(-min(max(gap, 0.0), FARTHEST) / 2) for gap in rivals.values())))

    def _parameters(self) -> dict:
        out = {}
        fit, plant = self.corrected, self.rig.plant
        named = {f.symbol for key in self.best.effects for f in self.search.effects[key].free}
        for u in sorted(fit.unknowns, key=lambda u: u.symbol not in self.best.released):
            p = plant.parameters.get(u.symbol)
            if p is None or not p.tolerance or u.symbol in named:
                continue
            value, deviation = fit.values[u.symbol], fit.deviation(u.symbol)
            out[u.symbol] = {"value": value, "ci95": _interval(value, deviation), "unit": p.unit}
            if u.symbol in self.best.released:
                out[u.symbol]["outside_tolerance"] = True
        return out

    def _remaining(self) -> str:
        if self.left:
            return self.left
        left = {name: ratio for name, ratio in self.structure.items() if ratio > STRUCTURE}
        return "; ".join(
            f"{name}: slow errors {1 + ratio:.2g} times those of white noise" for name, ratio in left.items()
        )


def _interval(value: float, deviation: float) -> list[float]:
    reach = NORMAL * WIDER * deviation
    return [value - reach, value + reach]


def reported(effect: Effect, fit: Fit) -> dict:
    """An effect's parameters as the diagnosis names them -> value, ci95, unit."""
    symbols = [u.symbol for u in fit.unknowns]
    scales = np.array([abs(u.scale) for u in fit.unknowns])
    covariance = fit.covariance * np.outer(scales, scales)
    waves = {s for pair in effect.wave.values() for s in pair}
    out = {}
    for name, (sine, cosine) in effect.wave.items():
        s, c = fit.values[sine], fit.values[cosine]
        at = [symbols.index(sine), symbols.index(cosine)]
        size = max(float(np.hypot(s, c)), TINY)
        inner = covariance[np.ix_(at, at)]
        along, across = np.array([s, c]) / size, np.array([-c, s]) / size**2
        unit = next(f.unit for f in effect.free if f.symbol == sine)
        out[name] = {"value": size, "ci95": _interval(size, float(np.sqrt(along @ inner @ along))), "unit": unit}
        phase = float(np.arctan2(c, s))
        out[f"{name}_phase"] = {
            "value": phase, "ci95": _interval(phase, float(np.sqrt(across @ inner @ across))), "unit": "rad",
        }  # fmt: skip
    for f in effect.free:
        if f.symbol in waves:
            continue
        value = fit.values[f.symbol]
        deviation = 0.0 if f.whole else fit.deviation(f.symbol)
        unit = f.unit or fit.likelihood.model.plant.parameters[f.symbol].unit
        out[f.reported] = {"value": value, "ci95": _interval(value, deviation), "unit": unit}
    return out


def recovered(effect: Effect, found: Mapping[str, Mapping]) -> dict[str, float]:
    """Symbols -> values, from what a diagnosis reports of an effect: the inverse of `reported`.

    Raises InputError where one of its parameters is missing.
    """

    def given(name: str) -> float:
        if name not in found:
            raise InputError(f"diagnosis: effect {effect.id} has no {name}; give one that diagnose wrote")
        return float(found[name]["value"])

    values = dict(effect.set)
    for name, (sine, cosine) in effect.wave.items():
        size, phase = given(name), given(f"{name}_phase")
        values[sine], values[cosine] = float(size * np.cos(phase)), float(size * np.sin(phase))
    for f in effect.free:
        if f.symbol not in values:
            values[f.symbol] = given(f.reported)
    return values


# -- finding it ------------------------------------------------------------------------------------------------------


@np.errstate(over="ignore", invalid="ignore")  # a trial may diverge
def diagnose(rig: Rig, effects: Mapping[str, Effect] | None = None, progress: Progress = silent) -> Diagnosis:
    """Explain the recording `rig.folder`/identify.csv; holdout.csv serves for the report alone.

    effects: those to be tried, by key; by default all that are known for the rig. Raises InputError where a recording
    or the table of effects cannot serve.

    >>> force = 60.0 * np.repeat(np.random.default_rng(2).standard_normal(30), 40)
    >>> real = axis.with_parameters(viscous=500.0)  # the data sheet of `load_rig` says 400, up to 10 % off
    >>> x = simulate(real, {"force": force}, sample_time=5e-3)["x"]
    >>> x = x + 2e-6 * np.random.default_rng(3).standard_normal(1200)
    >>> columns = np.column_stack([np.arange(1200) * 5e-3, force, x])
    >>> np.savetxt("rig/identify.csv", columns, delimiter=",", header="t,force,x", comments="")
    >>> found = diagnose(rig)
    >>> str(found.verdict), list(found.as_dict()["parameters"])
    ('parameter_error', ['viscous'])
    """
    began = time.perf_counter()
    recording = rig.to_explain()
    effects = table.known(rig, recording) if effects is None else effects
    progress("compiling the plant")
    search = Search(rig, recording, effects, free_run=Likelihood if rig.stated else Coloured)
    progress("calibrating")
    result = (_of_stated_noise if rig.stated else _of_coloured_noise)(search, progress)
    progress("predicting the recordings")
    result.fits = fits(result, recording)
    result.seconds = time.perf_counter() - began
    return result


def _of_stated_noise(search: Search, progress: Progress) -> Diagnosis:
    base = search.base(search.screen)
    short = Selection(search, search.screen, base, progress)
    best, current = short.forward(Hypothesis(), short.plain, base)
    if not complete(current):
        best, current = short.paired(best, current, base)
    best, current = short.backward(best, current)
    selection, costs = short, short.costs
    if best.size and complete(current):
        longer, best, corrected = short.over(search.final, best, current)
        costs = longer.costs
        if best.size == 1 and not complete(corrected):  # a second effect that long windows alone show
            more, fit = longer.backward(*longer.forward(best, corrected, corrected))
            if more != best:
                selection, best, current, corrected = longer, more, fit, fit
    else:
        corrected = search.fit(search.final, best, current.values)
    left, explained = structure(corrected), selection.explained(current)
    open_ = max(left.values()) > STRUCTURE and not complete(current)
    verdict = _verdict(best, open_ and explained < SHARE)
    unknown: dict = {}
    if verdict == Verdict.UNEXPLAINED:
        progress("looking for the equation")
        unknown, closed = closure(search)
        corrected = closed or search.fit(search.final, Hypothesis(), short.plain.values)
        best, left = Hypothesis(), structure(corrected)
    rivals = {hypothesis: cost / inflation(current) for hypothesis, cost in costs.items()}
    return Diagnosis(search.rig, verdict, best, short.plain, corrected, rivals, left, explained, search, unknown)


def _of_coloured_noise(search: Search, progress: Progress) -> Diagnosis:
    selection = ColouredSelection(search, progress)
    best, fit = selection.backward(*selection.forward(Hypothesis(), selection.plain, selection.plain))
    left = remaining(fit)
    verdict = _verdict(best, not best.size and bool(left))
    unexplained = {"where": [{"equation": "", "depends_on": [], "regime": left}]}
    return Diagnosis(
        search.rig, verdict, best, selection.plain, fit, {h: f.cost for h, f in selection.fits.items()}, {},
        1.0, search, unexplained if verdict == Verdict.UNEXPLAINED else {}, left=left,
    )  # fmt: skip


def _verdict(best: Hypothesis, unexplained: bool) -> Verdict:
    if unexplained:
        return Verdict.UNEXPLAINED
    if best.effects:
        return Verdict.MISSING_PHYSICS
    return Verdict.PARAMETER_ERROR if best.size else Verdict.CONSISTENT


def fits(result: Diagnosis, identify) -> dict:
    """RMS error of every predicted channel by the comparison rule: of the data sheet's plant, calibrated, corrected."""
    rig = result.rig
    recordings = {"identify": identify}
    if held_out := rig.held_out():
        recordings["holdout"] = held_out
    out = {}
    for name, recording in recordings.items():
        model = Model(rig, recording, result.corrected.likelihood.model.effects)
        kinds = {"simulation": {}, "calibrated": result.calibrated.values, "corrected": result.corrected.values}
        rms = {}
        for kind, values in kinds.items():
            known = {s: v for s, v in values.items() if s in model.values}
            skip = rig.settle if name == "holdout" else 0
            error = (model.predict(begun(model, known, skip)) - model.target)[skip:]
            rms[kind] = np.sqrt(np.mean(error**2, axis=0))
        out[name] = {
            channel: {**{kind: float(rms[kind][i]) for kind in kinds}, "unit": rig.channels[channel].unit}
            for i, channel in enumerate(rig.predict)
        }
    return out
