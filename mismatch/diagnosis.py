"""What a recording says about a plant: the verdict, its grounds, and the file that keeps them (`diagnosis.json`).

A diagnosis claims an effect only where its evidence is strong and little is left unexplained. Where structure stays in
the errors that no effect of the table explains, the verdict is `unexplained`.
"""

import copy
import json
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from greygate.errors import InputError
from greygate.files import replacing
from greygate.mismatch import effects as table
from greygate.mismatch.adequacy import dependent
from greygate.mismatch.blocks import Judge
from greygate.mismatch.claims import Claims, earned
from greygate.mismatch.closure import closure
from greygate.mismatch.coloured import Coloured, remaining
from greygate.mismatch.coloured_selection import ColouredSelection
from greygate.mismatch.effects import SENSOR, Effect
from greygate.mismatch.evidence import Evidence
from greygate.mismatch.experiments.excitation import excited, unseen
from greygate.mismatch.fit import Fit, Likelihood
from greygate.mismatch.intervals import interval, least_share, margin, reported
from greygate.mismatch.locate import located
from greygate.mismatch.model import TINY, Model
from greygate.mismatch.noise import PLACES, Noise, learnt
from greygate.mismatch.rig import IN, Rig
from greygate.mismatch.ruled_out import ruled_out, why
from greygate.mismatch.search import Hypothesis, Search
from greygate.mismatch.selection import APART, STRUCTURE, Selection, complete, inflation, structure
from greygate.mismatch.several import by_rule, modelled
from greygate.mismatch.shown_by import Shown, shown_by
from greygate.mismatch.verdict import Verdict
from greygate.plain import plain
from greygate.plants.dimensions import clashes
from greygate.plants.expressions import names
from greygate.plants.plant import Parameter, Plant
from greygate.plants.recording import run_name
from greygate.progress import Progress, silent

SCHEMA = "diagnosis/2"
READ = (SCHEMA, "diagnosis/1")  # that can be simulated: the second adds to the first
SHARE = 0.99  # of what can be explained: an effect that explains so much is all that is missing,
ADEQUATE = 4.0  # where the squared errors are at most so many times those that the told noise makes
PART = 0.9  # of what can be explained: an effect that explains so much is named beside what is left
SOME = 0.1  # of the squared error in free run, likewise where no noise is told
OPEN = 0.9  # of confidence in a name beside which structure is left, or that any smooth curve is like
ELSE = 0.01  # weight of something that no table has, beside a name whose fit leaves nothing: machines are many
CLOSED = 0.05  # of the misfit, that a fitted term must take: less is not applied, and only located
FARTHEST = 1400.0  # of cost: a rival this far away has a likelihood of exp(-700), the least that a float can hold
BLOWN = 100.0  # times what was recorded: a run that is so far off diverges, and nothing can be read from it
DIGITS = 4  # after the point, of a confidence


@dataclass
class Diagnosis:
    """Everything that was found; `as_dict` gives the content of diagnosis.json.

    calibrated, corrected: the fits of the plant without effects, and of `best`. rivals: cost of every hypothesis that
    was fitted. structure: by channel, what slow errors are left. explained: the share of what can be explained. noise:
    what `corrected` leaves, in units of what rig.toml tells, if it tells it. refused: claims that were dropped, one
    sentence each. evidence, shares: by key of an effect, what the recording says for it where its fit did not look, and
    the share of the calibrated plant's squared error that it takes. not_shown: key of an effect that the recording
    cannot show, and that was therefore not tried -> why. not_larger_than: of a consistent recording, what it rules out.
    alone: where several recordings are unexplained together, what each says alone (verdict, effects).
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
    noise: Noise | None = None
    refused: list[str] = field(default_factory=list)
    evidence: dict[str, Evidence] = field(default_factory=dict)
    shares: dict[str, float] = field(default_factory=dict)
    not_shown: dict[str, str] = field(default_factory=dict)
    not_larger_than: list[dict] = field(default_factory=list)
    alone: dict[str, dict] = field(default_factory=dict)

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
                **({"recordings": own} if (own := self._recordings()) else {}),
                **({"explained": round(self.explained, DIGITS)} if self.verdict == Verdict.PARTLY_EXPLAINED else {}),
                **({"refused": self.refused} if self.refused else {}),
                **({"units": clashing} if (clashing := clashes(self.rig.plant)) else {}),
                **({"not_larger_than": self.not_larger_than} if self.not_larger_than else {}),
                **({"noise": self._noise(self.noise)} if self.noise else {}),
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
                acts(equation, f"{symbol.replace(IN, ' in ')} is not what the data sheet says", (), (symbol,))
        for key in self.best.effects:
            effect, shown = self.search.effects[key], self.shown.get(key)
            means = f"{effect.means}; {shown}" if shown else effect.means
            for equation in effect.equations:
                acts(equation, means, effect.depends_on, (*(f.symbol for f in effect.free), *effect.set))
        return [located(self.corrected, place, acting[equation]) for equation, place in places.items()]

    @cached_property
    def cannot_show(self) -> dict[str, str]:
        """Name of an effect that this recording cannot show -> why; none that the diagnosis claims."""
        if self.not_larger_than:
            return {entry["id"]: entry["why"] for entry in self.not_larger_than if "why" in entry}
        claimed, recording = {e["id"] for e in self._effects()}, self.calibrated.likelihood.model.recording
        offered = {effect.id: effect for effect in self.search.effects.values()}
        hidden = [name for name in unseen(self.calibrated, self.search.effects.values()) if name not in claimed]
        return {**self.not_shown, **{name: why(offered[name], self.rig, recording) for name in hidden}}

    def _effects(self) -> list[dict]:
        if self.verdict == Verdict.UNEXPLAINED:
            return [self.unknown["effect"]] if self.unknown.get("effect") else []
        if self.verdict not in (Verdict.MISSING_PHYSICS, Verdict.PARTLY_EXPLAINED, Verdict.RECORDING_FAULT):
            return []
        out = []
        for key in self.best.effects:
            effect = self.search.effects[key]
            rivals = self._rivals(key)
            out.append(
                {
                    "id": effect.id,
                    "equations": list(effect.equations),
                    "confidence": round(self._confidence(key, rivals), DIGITS),
                    "form": key,
                    "parameters": reported(effect, self.corrected, self._least[key]),
                    "not_told_apart_from": sorted(name for name, gap in rivals.items() if gap < APART),
                    **({"share": round(self.shares[key], DIGITS)} if key in self.shares else {}),
                    **({"evidence": self.evidence[key].as_dict()} if key in self.evidence else {}),
                    **({"shown_by": shown.by, "recordings": shown.as_dict()} if (shown := self.shown.get(key)) else {}),
                }
            )
        return out

    @cached_property
    def _least(self) -> dict[str, float]:
        """Key of an effect -> the share of its size that is ruled out where its interval holds 0 nevertheless."""
        claimed, fit = {key: self.search.effects[key] for key in self.best.effects}, self.corrected
        return {key: 0.0 if margin(e, fit) > 1.0 else least_share(e, fit) for key, e in claimed.items()}

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

    def _confidence(self, key: str, rivals: Mapping[str, float]) -> float:
        """The weight of effect `key` beside its rivals, nothing, and something that no table has."""
        others = sum(np.exp(-min(max(gap, 0.0), FARTHEST) / 2) for gap in rivals.values())
        nothing = np.exp(-min(self.evidence[key].log_e, FARTHEST)) if key in self.evidence else 0.0
        sure = float(1.0 / (1.0 + others + nothing + ELSE))
        if self.verdict == Verdict.PARTLY_EXPLAINED:
            sure *= min(max(self.explained, 0.0), 1.0)
        return sure * (OPEN if self._remaining() or self.search.effects[key].smooth else 1.0)

    def _noise(self, noise: Noise) -> dict:
        """By channel, in its unit, the noise that rig.toml tells and that the recording shows; samples it remembers."""
        rig, told = self.rig, self.corrected.likelihood.sigma
        usual = np.median(told[np.isfinite(told).all(axis=1)], axis=0)
        return {
            name: {
                "told": rig.channels[name].sigma,
                "found": float(f"{size:.{PLACES}g}"),
                "unit": rig.channels[name].unit,
                "memory": len(ar),
                "as_told": not doubted,
            }
            for name, size, ar, doubted in zip(rig.predict, noise.size * usual, noise.ar, noise.doubted, strict=True)
        }

    def _parameters(self) -> dict:
        out = {}
        fit, plant = self.corrected, self.rig.plant
        named = {f.symbol for key in self.best.effects for f in self.search.effects[key].free}
        for u in sorted(fit.unknowns, key=lambda u: u.symbol not in self.best.released):
            p = plant.parameters.get(u.symbol)
            if p is None or not p.tolerance or u.symbol in named:
                continue
            out[u.symbol] = self._parameter(u.symbol, p)
        return out

    def _parameter(self, symbol: str, p: Parameter) -> dict:
        value, deviation = self.corrected.values[symbol], self.corrected.deviation(symbol)
        outside = {"outside_tolerance": True} if symbol in self.best.released else {}
        return {"value": value, "ci95": interval(value, deviation), "unit": p.unit, **outside}

    def _recordings(self) -> dict[str, dict]:
        """By the name of a recording, the parameters that were fitted to it alone, and how its time was made even."""
        out: dict[str, dict] = {}
        for run in self.corrected.likelihood.model.recording.runs:
            own = {s: self._parameter(key, self.search.sheet[key]) for s, key in self.rig.fitted_in(run.name).items()}
            here = {
                **({"alone": self.alone[run.name]} if run.name in self.alone else {}),
                **({"parameters": own} if own else {}),
                **({"resampled": "; ".join(run.history)} if run.history else {}),
            }
            out |= {run.name: here} if here else {}
        return out

    @cached_property
    def shown(self) -> dict[str, Shown]:
        """By key of an effect, which of several recordings shows it; empty where there is one."""
        found: dict[str, Shown] = {}
        for key in self.best.effects:
            shown = shown_by(self.corrected, {f.symbol for f in self.search.effects[key].strengths})
            found |= {key: shown} if shown else {}
        return found

    def _remaining(self) -> str:
        if self.left:
            return self.left
        left = {name: ratio for name, ratio in self.structure.items() if ratio > STRUCTURE}
        return "; ".join(
            f"{name}: slow errors {1 + ratio:.2g} times those of white noise{self._when(name)}"
            for name, ratio in left.items()
        )

    def _when(self, channel: str) -> str:
        """Where, when and at which frequencies a channel still errs."""
        place = {"equation": SENSOR + channel, "depends_on": [], "regime": ""}
        found = located(self.corrected, place, [])
        return f" ({found['regime']}, {found['time']}, {found['band']})" if "time" in found else ""


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
    search.effects, not_shown = excited(search.final.model, search.effects)
    offered = {effect.id for effect in search.effects.values()}
    not_shown |= {name: why for name, why in table.unmet(rig, recording).items() if name not in offered}
    progress("calibrating")
    result = (_of_stated_noise if rig.stated else _of_coloured_noise)(search, progress)
    result.not_shown = not_shown
    if result.verdict == Verdict.MISSING_PHYSICS and all(search.effects[key].fault for key in result.best.effects):
        result.verdict = Verdict.RECORDING_FAULT
    if result.verdict == Verdict.CONSISTENT:
        progress("bounding what is not there")
        result.not_larger_than = ruled_out(search, result.corrected, not_shown)
    progress("predicting the recordings")
    result.fits = fits(result, recording)
    if diverging := [c for c, rms in result.fits["identify"].items() if _diverges(rms["corrected"], recording[c])]:
        raise InputError(
            f"{rig.folder}: the simulation of {', '.join(diverging)} diverges, whatever the parameters; check the "
            "values and units in rig.toml, or restart it in windows of window_s"
        )
    if result.verdict == Verdict.UNEXPLAINED and len(recording.runs) > 1:
        result.alone = _each_alone(rig, effects, progress)
    result.seconds = time.perf_counter() - began
    return result


def _each_alone(rig: Rig, effects: Mapping[str, Effect], progress: Progress) -> dict[str, dict]:
    """By its name, what each of several recordings says alone: one may show what the others lack."""
    out = {}
    for file in rig.identify:
        progress(f"asking {file} alone")
        try:
            found = diagnose(replace(rig, identify=(file,), holdout=()), effects).as_dict()
        except InputError:  # too short alone, or a run that diverges
            continue
        out[run_name(file)] = {key: found[key] for key in ("verdict", "effects")}
    return out


def _diverges(rms: float, recorded: np.ndarray) -> bool:
    return not rms <= BLOWN * np.max(np.abs(recorded))


def _of_stated_noise(search: Search, progress: Progress) -> Diagnosis:
    """Explain with the noise that was told, and once more where the recording shows another."""
    found = _explained(search, progress)
    noise = shown_noise(found.corrected)
    if noise.as_told:
        return replace(found, noise=noise)
    progress("searching again: the noise is not as rig.toml tells it")
    again = _explained(search.under(noise), progress)
    if again.verdict == Verdict.CONSISTENT and dependent(again.corrected):
        search.under(Noise.told(len(search.rig.predict)))  # what the machine's own motion foretells is no noise
        return replace(found, noise=noise)
    return replace(again, noise=shown_noise(again.corrected))


def shown_noise(fit: Fit) -> Noise:
    """The noise, in units of what rig.toml tells, that a fit leaves."""
    likelihood, model = copy.copy(fit.likelihood), fit.likelihood.model
    likelihood.noise = Noise.told(len(model.rig.predict))
    return learnt(likelihood.errors(fit.values, fit.shifts), model.window or len(likelihood.sigma), model.pieces)


def _explained(search: Search, progress: Progress) -> Diagnosis:
    base = search.base(search.screen)
    short = Selection(search, search.screen, base, progress)
    best, current = short.forward(Hypothesis(), short.plain, base)
    if not complete(current):
        best, current = short.paired(best, current, base)
    best, current = short.settled(*short.backward(best, current))
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
    claims = earned(search, short.plain, best, corrected, progress=progress)
    if claims.best != best:
        selection, current = short, search.fit(search.screen, claims.best, claims.fit.values)
        costs = {**short.costs, claims.best: current.cost}
    best, corrected = claims.best, claims.fit
    left, explained = structure(corrected), selection.explained(current)
    open_ = max(left.values()) > STRUCTURE and not complete(current)
    verdict = _verdict(best, open_, explained, corrected.cost / corrected.likelihood.count)
    unknown: dict = {}
    if verdict in (Verdict.UNEXPLAINED, Verdict.PARTLY_EXPLAINED):
        progress("looking for the equation")
        found = closure(search)
        share = (found[0].get("effect") or {}).get("confidence", 1.0)  # a sensor has no term: it may take all
        # what any smooth term does as well is no name, and several names that leave something are such a term
        if verdict == Verdict.UNEXPLAINED or share >= explained or best.size > 1:
            verdict, best = Verdict.UNEXPLAINED, Hypothesis()
            unknown, corrected = _unknown(search, claims, *found)
            left = structure(corrected)
    rivals = {hypothesis: cost / inflation(current) for hypothesis, cost in costs.items()}
    rivals |= {hypothesis: rivals[best] for hypothesis in short.unfitted if best in rivals and hypothesis not in rivals}
    return Diagnosis(
        search.rig, verdict, best, claims.calibrated, corrected, rivals, left, explained, search, unknown,
        refused=claims.refused, evidence=claims.evidence, shares=claims.shares,
    )  # fmt: skip


def _of_coloured_noise(search: Search, progress: Progress) -> Diagnosis:
    selection = ColouredSelection(search, progress)
    best, fit = selection.backward(*selection.forward(Hypothesis(), selection.plain, selection.plain))
    claims = earned(search, selection.plain, best, fit, progress=progress)
    if claims.best not in selection.fits:
        selection.fits[claims.best] = claims.fit
    best, fit = claims.best, claims.fit
    left = _goes_on(fit)
    explained = removed(claims.calibrated, fit)
    verdict = _verdict(best, bool(left), explained, np.inf, SOME)
    unexplained = {}
    if verdict == Verdict.UNEXPLAINED:
        best, fit = Hypothesis(), claims.calibrated
        left = _goes_on(fit) or left
        unexplained = {"where": [_likeliest(search, selection.fits, left)]}
    return Diagnosis(
        search.rig, verdict, best, claims.calibrated, fit, {h: f.cost for h, f in selection.fits.items()}, {},
        explained, search, unexplained, left=left, refused=claims.refused, evidence=claims.evidence,
        shares=claims.shares,
    )  # fmt: skip


def _verdict(best: Hypothesis, open_: bool, explained: float, left: float, part: float = PART) -> Verdict:
    """open_: whether structure is left. left: squared errors over those of the noise, infinite where none is told."""
    if open_ and (explained < SHARE or left > ADEQUATE):
        return Verdict.PARTLY_EXPLAINED if best.effects and explained >= part else Verdict.UNEXPLAINED
    if best.effects:
        return Verdict.MISSING_PHYSICS
    return Verdict.PARAMETER_ERROR if best.size else Verdict.CONSISTENT


def _unknown(search: Search, claims: Claims, unknown: dict, closed: Fit | None) -> tuple[dict, Fit]:
    """(where and effect of what no effect explains; the fit with a term for it, if one is worth it).

    unknown, closed: what `closure` found.
    """
    share = (unknown.get("effect") or {}).get("confidence", 0.0)
    if closed is not None:
        losses = Judge(closed.likelihood).losses(claims.calibrated, closed) if share >= CLOSED else []
        if share >= CLOSED and not losses:
            return unknown, closed
        why = f"with it {losses[0]}" if losses else f"it takes {share:.0%} of the misfit"
        claims.refused.append(f"no term is fitted: {why}")
    for place in unknown["where"]:
        if closed is not None:
            place["regime"] = "no function of the signals that was tried takes what is left"
    plain = claims.calibrated  # its values as they are: fitted anew to long windows, they may predict worse
    return {**unknown, "effect": None}, search.final.fit(plain.unknowns, plain.values, iterations=0)


def _goes_on(fit: Fit) -> str:
    """What the innovations of a free run go with; where they go with nothing, what its errors go with."""
    likelihood = fit.likelihood
    assert isinstance(likelihood, Coloured)
    if not likelihood.order:
        likelihood = likelihood.ordered(likelihood.residual(fit.values))
        fit = replace(fit, likelihood=likelihood, errors=likelihood.errors(fit.values, fit.shifts))
    return dependent(fit) or remaining(fit)


def removed(calibrated: Fit, corrected: Fit) -> float:
    """The share of the squared error in free run that a correction removes, in the mean over channels."""

    def squared(fit: Fit) -> np.ndarray:
        assert isinstance(fit.likelihood, Coloured)
        return np.mean(fit.likelihood.residual(fit.values) ** 2, axis=0)

    before, after = squared(calibrated), squared(corrected)
    return float(np.mean(1.0 - after / np.maximum(before, TINY)))


def _likeliest(search: Search, fitted: Mapping[Hypothesis, Fit], left: str) -> dict:
    """The equation of what is unexplained: where the single effect acts that comes nearest, else of a channel."""
    tried = sorted((h for h in fitted if h.size == 1 and h.effects), key=lambda h: fitted[h].cost)
    nearest = [(search.effects[h.effects[0]].equations, search.effects[h.effects[0]].depends_on) for h in tried]
    plant, whole = search.rig.plant, [(search.rig.predict, ())]
    for places, depends_on in (*nearest, *whole):
        for place in places:
            if equation := _equation(plant, place):
                return {"equation": equation, "depends_on": list(depends_on), "regime": left}
    return {"equation": search.rig.predict[0], "depends_on": [], "regime": left}


def _equation(plant: Plant, place: str) -> str:
    """The equation or definition of that name, or that makes a channel of that name, or that uses such an input."""
    made = {**{e.state: name for name, e in plant.equations.items()},
            **{d.symbol: name for name, d in plant.definitions.items()}}  # fmt: skip
    if place in plant.equations or place in plant.definitions:
        return place
    sums = {**{n: e.terms for n, e in plant.equations.items()}, **{n: d.terms for n, d in plant.definitions.items()}}
    using = (name for name, terms in sums.items() if place in names(terms.values()))
    return made.get(place) or next(using, "")


def fits(result: Diagnosis, identify) -> dict:
    """RMS error of every predicted channel by the comparison rule: of the data sheet's plant, calibrated, corrected.

    Of several recordings, all together and each alone.
    """
    rig = result.rig
    recordings = {"identify": identify}
    if held_out := rig.held_out():
        recordings["holdout"] = held_out
    out = {}
    for name, recording in recordings.items():
        model = modelled(rig, recording, result.corrected.likelihood.model.effects)
        kinds = {"simulation": {}, "calibrated": result.calibrated.values, "corrected": result.corrected.values}
        skip = rig.settle if name == "holdout" else 0
        ran = {kind: by_rule(model, values, skip) for kind, values in kinds.items()}
        parts = {name: slice(None)}
        if len(model.pieces) > 1:
            files = {run.name: Path(run.source).name for run in recording.runs}
            names = (run if run not in recordings else files[run] for run in files)
            parts |= dict(zip(names, model.pieces, strict=True))
        for part, piece in parts.items():
            out[part] = {
                channel: {
                    **{kind: _rms(model, *ran[kind], piece, i) for kind in kinds}, "unit": rig.channels[channel].unit,
                }
                for i, channel in enumerate(rig.predict)
            }  # fmt: skip
    return out


def _rms(model: Model, predicted: np.ndarray, counts: np.ndarray, piece: slice, channel: int) -> float:
    """The RMS error of a channel over the samples of `piece` that count."""
    error = (predicted[piece] - model.target[piece])[counts[piece]]
    return float(np.sqrt(np.mean(error**2, axis=0))[channel])
