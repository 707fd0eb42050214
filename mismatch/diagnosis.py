"""What a recording says about a plant: the verdict, its grounds, and the file that keeps them (`diagnosis.json`).

Forward selection over the hypotheses of `search`, a claim only where its evidence is strong and little is left, and
`unexplained` where structure stays that no effect of the table has.
"""

import json
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from greygate.errors import InputError, replacing
from greygate.mismatch import effects as table
from greygate.mismatch.closure import closure
from greygate.mismatch.coloured import Coloured, explain, settled
from greygate.mismatch.effects import Effect
from greygate.mismatch.fit import Fit, Problem
from greygate.mismatch.locate import located
from greygate.mismatch.model import BLUR, Model
from greygate.mismatch.rig import Rig
from greygate.mismatch.search import Hypothesis, Score, Search

SCHEMA = "diagnosis/1"
EVIDENCE = 30.0  # of cost, robust, that an effect must save; some thirty hypotheses are tried
APART = 12.0  # of cost, within which two hypotheses are not told apart
EFFECTS = 3  # at most
STRUCTURE = 0.3  # of slow error over white error, above which structure is left
SHARE = 0.99  # of what can be explained, which a named effect explains though structure is left
WIDER = 1.25  # by which intervals are widened: then 95 % of the true values of concealed cases are inside
OWN = 0.05  # of what can be explained, which a second effect must explain by itself where the two leave something
FLOOR = 0.92  # of the count of readings: cost of a fit that leaves nothing
PAIR = 0.5  # or of what the first effect leaves
LEAST = 1e-2  # of what can be explained, which an effect must explain beside one that acts by acceleration
NEARLY = 0.95  # of the gain that the plain form of an effect promises, that of another form counts
NEAR, RIVALS = 0.05, 6  # of the count of readings: cost above the best; how many rivals see longer windows
FAR = 0.3  # of the most promising hypothesis's gain
FIRST, LATER = 6, 4  # hypotheses of the first round and of later ones that are fitted in full
SLOW = 0.02  # s of a mean that tells slow errors from white ones
BLURRED = 0.2  # s of it where an effect acts by acceleration, whose jumps are known to some 20 ms


@dataclass
class Diagnosis:
    """Everything found; `as_dict` is the file's content."""

    rig: Rig
    verdict: str
    best: Hypothesis
    calibrated: Fit
    corrected: Fit
    rivals: dict[Hypothesis, float]
    structure: dict[str, float]
    explained: float
    search: Search
    unknown: dict | None = None
    fits: dict = field(default_factory=dict)
    seconds: float = 0.0
    left: str = ""

    # -- the file ----------------------------------------------------------------------------------------------------

    def as_dict(self) -> dict:
        """Content of diagnosis.json, keys as in docs/diagnosis.md."""
        return {
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

    def write(self, path: Path | str) -> None:
        """Write diagnosis.json, whole or not at all."""
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(self.as_dict(), indent=1) + "\n")

    @cached_property
    def _where(self) -> list[dict]:
        """Places, each with what acts there, in which regime of the plant, when, and in which frequency band."""
        places: dict[str, dict] = {}
        acting: dict[str, list[tuple[str, ...]]] = {}

        def acts(equation: str, what: str, depends_on: Iterable[str], symbols: Iterable[str]) -> None:
            place = places.setdefault(equation, {"equation": equation, "depends_on": [], "regime": ""})
            place["depends_on"] += [v for v in depends_on if v not in place["depends_on"]]
            place["regime"] += f"; {what}" if place["regime"] else what
            acting.setdefault(equation, []).extend([tuple(symbols)] if symbols else [])

        if self.verdict == "unexplained":
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
        if self.verdict == "unexplained":
            return [self.unknown["effect"]] if self.unknown.get("effect") else []
        if self.verdict not in ("missing_physics",):
            return []
        out = []
        for key in self.best.effects:
            effect = self.search.effects[key]
            rivals = self._rivals(key)
            out.append(
                {
                    "id": effect.id,
                    "equations": list(effect.equations),
                    "confidence": round(self._confidence(rivals), 4),
                    "form": key,
                    "parameters": reported(effect, self.corrected),
                    "not_told_apart_from": sorted(name for name, gap in rivals.items() if gap < APART),
                }
            )
        return out

    def _rivals(self, key: str) -> dict[str, float]:
        """Other explanations in the place of effect `key` -> cost above the best."""
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
        return float(1.0 / (1.0 + sum(np.exp(-min(max(gap, 0.0), 1400.0) / 2) for gap in rivals.values())))

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
    reach = 1.96 * WIDER * deviation
    return [value - reach, value + reach]


def reported(effect: Effect, fit: Fit) -> dict:
    """An effect's parameters as the diagnosis names them: value, ci95, unit."""
    symbols = [u.symbol for u in fit.unknowns]
    scales = np.array([abs(u.scale) for u in fit.unknowns])
    covariance = fit.covariance * np.outer(scales, scales)
    waves = {s for pair in effect.wave.values() for s in pair}
    out = {}
    for name, (sine, cosine) in effect.wave.items():
        s, c = fit.values[sine], fit.values[cosine]
        at = [symbols.index(sine), symbols.index(cosine)]
        size = max(float(np.hypot(s, c)), 1e-300)
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
        unit = f.unit or fit.problem.model.plant.parameters[f.symbol].unit
        out[f.reported] = {"value": value, "ci95": _interval(value, deviation), "unit": unit}
    return out


def recovered(effect: Effect, found: Mapping[str, Mapping]) -> dict[str, float]:
    """Symbols' values from what a diagnosis reports of an effect; the inverse of `reported`."""
    values = dict(effect.set)
    for name, (sine, cosine) in effect.wave.items():
        size, phase = found[name]["value"], found[f"{name}_phase"]["value"]
        values[sine], values[cosine] = float(size * np.cos(phase)), float(size * np.sin(phase))
    for f in effect.free:
        if f.symbol not in values:
            if f.reported not in found:
                raise InputError(f"diagnosis: effect {effect.id} has no {f.reported}; give one that diagnose wrote")
            values[f.symbol] = float(found[f.reported]["value"])
    return values


class Tried:
    """Every hypothesis that was fitted. costs: the least of each. best: by size, of those that are possible.

    fits: the best of each that is possible.
    """

    def __init__(self):
        self.costs: dict[Hypothesis, float] = {}
        self.fits: dict[Hypothesis, Fit] = {}
        self.best: dict[int, tuple[Hypothesis, Fit]] = {}

    def add(self, hypothesis: Hypothesis, fit: Fit, possible: bool = True) -> None:
        self.costs[hypothesis] = min(fit.cost, self.costs.get(hypothesis, np.inf))
        if possible and fit.cost == self.costs[hypothesis]:
            self.fits[hypothesis] = fit
        _, before = self.best.get(hypothesis.size, (None, None))
        if possible and (before is None or fit.cost < before.cost):
            self.best[hypothesis.size] = (hypothesis, fit)

    def moved(self, by: float) -> "Tried":
        """The same costs over other windows, where the best one's differs `by` so much; no fit."""
        other = Tried()
        other.costs = {hypothesis: cost + by for hypothesis, cost in self.costs.items()}
        return other


# -- finding it ------------------------------------------------------------------------------------------------------


def structure(problem: Problem, fit: Fit) -> dict[str, float]:
    """Per channel, how much larger slow errors are than white noise would have them, less one."""
    model, channels = problem.model, problem.model.rig.predict
    projected = fit.projected[:, : problem.block * len(channels)].reshape(-1, problem.block, len(channels))
    size = max(round((BLURRED if blurred(fit) else SLOW) / model.rig.dt), 2)
    out = {}
    for i, name in enumerate(channels):
        e = projected[:, :, i]
        e = e[np.abs(e).sum(axis=1) > 0]
        pieces = e[:, : e.shape[1] // size * size].reshape(-1, size)
        out[name] = float(np.mean(pieces.mean(axis=1) ** 2) * size / max(1.0, _fast(e))) - 1.0
    return out


def blurred(fit: Fit) -> bool:
    """An effect of the fit acts by an acceleration that is made of a position."""
    return any(u.symbol == BLUR for u in fit.unknowns)


def _fast(e: np.ndarray) -> float:
    """Variance of what is fast in `e`."""
    return float(np.mean(np.diff(e, axis=1) ** 2) / 2)


@np.errstate(over="ignore", invalid="ignore")  # a trial may diverge
def diagnose(
    rig: Rig, effects: Mapping[str, Effect] | None = None, say: Callable[[str, float], None] | None = None
) -> Diagnosis:
    """Explain `rig.folder`/identify.csv; look at holdout.csv for the report alone.

    say: called with what is being done and how far it is (0 to 1).
    """
    began = time.perf_counter()
    say = say or (lambda text, share: None)
    recording = rig.recording(rig.folder / "identify.csv")
    effects = table.known(rig, recording) if effects is None else effects
    say("compiling the plant", 0.0)
    if not rig.stated:
        return _coloured(Search(rig, recording, effects, whole=Coloured), recording, began, say)
    search = Search(rig, recording, effects)
    problem, final = search.screen, search.final
    say("calibrating", 0.05)
    nothing = Hypothesis()
    base = search.base(problem)
    plain = search.fit(problem, nothing, base.values, base.shifts, enough=EVIDENCE / 10)
    tried = Tried()
    tried.add(nothing, plain)
    best, current = selected(search, base, [(nothing, plain)], tried, say)
    say("fitting over longer windows", 0.85)
    if whole(problem, current) and best.size:
        best, corrected, tried = compared(search, best, current, tried, say)
    else:
        corrected = search.fit(final, best, current.values)
    if best.size == 1 and whole(problem, current) and not whole(final, corrected):  # shown by longer windows alone
        calibrated = search.fit(final, nothing, plain.values)
        more, again = selected(search, corrected, [(nothing, calibrated), (best, corrected)], tried, say)
        if more != best:
            problem, plain, best, current, corrected = final, calibrated, more, again, again
    rivals = {h: c / inflation(current) for h, c in tried.costs.items()}
    left = structure(final, corrected)
    explained = (plain.cost - current.cost) / max(plain.cost - floor(problem), 1.0)
    open_ = max(left.values()) > STRUCTURE and not whole(problem, current)
    unknown = None
    if best == nothing and not open_:
        verdict = "consistent"
    elif open_ and explained < SHARE:
        verdict = "unexplained"
        say("looking for the equation", 0.9)
        unknown, closed = closure(search)
        corrected = closed or search.fit(final, nothing, plain.values)
        best, left = nothing, structure(corrected.problem, corrected)
    elif best.effects:
        verdict = "missing_physics"
    else:
        verdict = "parameter_error"
    result = Diagnosis(rig, verdict, best, plain, corrected, rivals, left, explained, search, unknown)
    say("predicting the recordings", 0.95)
    result.fits = fits(result, recording)
    result.seconds = time.perf_counter() - began
    return result


def selected(
    search: Search, start: Fit, steps: list[tuple[Hypothesis, Fit]], tried: Tried, say: Callable[[str, float], None]
) -> tuple[Hypothesis, Fit]:
    """Forward selection from the last of `steps` on, pairs where it leaves something, backward elimination.

    start: where scores are taken first. steps: from nothing on, each a hypothesis and its fit.
    """
    (_, plain), (best, current) = steps[0], steps[-1]
    problem, base = plain.problem, None if best.size else start
    while best.size < EFFECTS and not (best.size and whole(problem, current)):
        ranked = alternatives(search, search.scores(problem, start, best))
        share = 0.15 + 0.2 * (1 + best.size)
        say(f"scored {len(ranked)} hypotheses", share)
        promising = [forms for forms in ranked if forms[0].gain > EVIDENCE / 3][: LATER if best.size else FIRST]
        found: list[tuple[Hypothesis, Fit]] = []
        for forms in promising:
            if found and forms[0].gain < FAR * promising[0][0].gain and whole(problem, min(found, key=_cost)[1]):
                break  # one explains all, and this one promises little
            for score in forms:
                hypothesis = best.plus(score.hypothesis)
                say(f"fitting {hypothesis}", share)
                rival = min(map(_cost, found), default=np.inf)
                fit = search.fit(problem, hypothesis, {**start.values, **score.values}, start.shifts, rival=rival)
                if fit.cost > current.cost and score.gain > NEARLY * promising[0][0].gain:
                    fit = restarted(search, hypothesis, score, start, fit)
                allowed = possible(search, score.hypothesis, fit)
                tried.add(hypothesis, fit, allowed)
                if allowed:
                    found.append((hypothesis, fit))
                    break
        if not found:
            break
        hypothesis, fit = min(found, key=_cost)
        if not whole(problem, fit):
            hypothesis, fit = reshape(search, hypothesis, fit, tried, say, share)
        enough = LEAST * (plain.cost - floor(problem)) if blurred(current) else 0.0
        if current.cost - fit.cost < max(EVIDENCE * inflation(fit), enough) or fit.held_out() > current.held_out():
            break
        best, current = hypothesis, fit
        start = fit
    if base is not None and not whole(problem, current):
        best, current = paired(search, base, best, current, tried, say)
    if best.size > 1:
        best, current = eliminate(search, best, current, tried, say)
        if not whole(problem, current):  # several effects, and still not all
            (single, one), (pair, two) = tried.best[1], tried.best.get(2, (best, current))
            all_, left = plain.cost - floor(problem), one.cost - floor(problem)
            enough = max(min(OWN * all_, PAIR * left), LEAST * all_ if blurred(one) else 0.0)
            best, current = (pair, two) if one.cost - two.cost > enough else (single, one)
    return best, current


def _coloured(search: Search, recording, began: float, say) -> Diagnosis:
    """`diagnose` where the noise is not told."""
    found = explain(search, say)
    unknown = None
    if found.verdict == "unexplained":
        unknown = {"where": [{"equation": "", "depends_on": [], "regime": found.left}]}
    result = Diagnosis(
        search.rig, found.verdict, found.best, found.calibrated, found.corrected, found.costs, {},
        1.0, search, unknown, left=found.left,
    )  # fmt: skip
    say("predicting the recordings", 0.95)
    result.fits = fits(result, recording)
    result.seconds = time.perf_counter() - began
    return result


def inflation(fit: Fit) -> float:
    """By how much errors that depend on each other widen the evidence on the last unknown."""
    bread = np.linalg.pinv(fit.information, hermitian=True, rcond=1e-14)
    return float(np.clip(fit.covariance[-1, -1] / max(bread[-1, -1], 1e-300), 1.0, 20.0))


def possible(search: Search, hypothesis: Hypothesis, fit: Fit) -> bool:
    """The fit runs, no size of the effect lies on its physical bound, no overtone is larger than its wave."""
    if not np.isfinite(fit.cost):
        return False
    effects = [search.effects[key] for key in hypothesis.effects]
    sizes = [[np.hypot(*(fit.values[s] for s in pair)) for pair in effect.wave.values()] for effect in effects]
    if any(overtones and max(overtones) > fundamental for fundamental, *overtones in filter(None, sizes)):
        return False  # a wave of that overtone's own period
    free = [f for effect in effects for f in effect.strengths]
    return not any(b and np.isclose(fit.values[f.symbol], b, rtol=1e-6) for f in free for b in (f.low, f.high))


def whole(problem: Problem, fit: Fit) -> bool:
    """Nothing is left to be explained: no slow errors, or few, and no more error than the sensors make."""
    slow = max(structure(problem, fit).values())
    return slow < STRUCTURE or (slow < 1.0 and fit.cost < problem.count)


def floor(problem: Problem) -> float:
    """Cost of a fit that leaves nothing."""
    return problem.count * FLOOR


def _cost(found: tuple[Hypothesis, Fit]) -> float:
    return found[1].cost


def alternatives(search: Search, ranked: Iterable[Score]) -> list[list[Score]]:
    """One list an effect or parameter, of its forms: the plain one first where it promises nearly the most."""
    by_name: dict[str, list[Score]] = {}
    for score in ranked:
        key = next(iter(score.hypothesis.effects), None)
        name = search.effects[key].id if key else score.hypothesis.released[0]
        by_name.setdefault(name, []).append(score)

    def worth(name: str, score: Score) -> float:
        return score.gain * (1.0 if score.hypothesis.effects == (name,) else NEARLY)

    return [sorted(forms, key=lambda s: -worth(name, s)) for name, forms in by_name.items()]


def restarted(search: Search, hypothesis: Hypothesis, score: Score, start: Fit, worse: Fit) -> Fit:
    """A fit that is worse than one with less came to a local minimum: once more, from where there is no effect."""
    strengths = {f.symbol for key in score.hypothesis.effects for f in search.effects[key].strengths}
    shapes = {s: v for s, v in score.values.items() if s not in strengths and not score.hypothesis.released}
    again = search.fit(worse.problem, hypothesis, {**start.values, **shapes}, start.shifts)
    return min(worse, again, key=lambda fit: fit.cost)


def compared(search: Search, best: Hypothesis, fit: Fit, tried: Tried, say) -> tuple[Hypothesis, Fit, Tried]:
    """Every hypothesis that explains all over short windows, in every form, over long ones, and the best of them.

    Long windows tell forms apart that short ones do not. A further unknown costs what BIC says.
    """
    problem, final = fit.problem, search.final
    near = fit.cost + min(NEAR * problem.count, (tried.costs[Hypothesis()] - fit.cost) / 2)
    rivals = {h: f for h, f in tried.fits.items() if h.size == best.size and f.cost < near and whole(problem, f)}
    rivals = {best: fit, **{h: rivals[h] for h in sorted(rivals, key=lambda h: rivals[h].cost)[:RIVALS]}}
    found: dict[Hypothesis, Fit] = {}
    for hypothesis, start in rivals.items():
        for form, values in forms(search, hypothesis, start.values):
            if form not in found and not (final is problem and form in tried.costs):
                say(f"fitting {form} over longer windows", 0.88)
                again = search.fit(final, form, values, start.shifts if final is problem else None)
                if possible(search, form, again) or form == best:
                    found[form] = again
    if final is problem:
        found |= rivals
    other = tried.moved(found[best].cost - fit.cost)
    for hypothesis, again in found.items():
        other.costs.pop(hypothesis, None)
        other.add(hypothesis, again)
    best = min(found, key=lambda h: found[h].cost + np.log(final.count) * (len(found[h].unknowns) + len(h.released)))
    return best, found[best], other


def forms(search: Search, hypothesis: Hypothesis, values: Mapping[str, float]) -> Iterable[tuple[Hypothesis, dict]]:
    """(`hypothesis` with at most one effect in another form, values from which it is fitted)."""
    yield hypothesis, dict(values)
    for key in hypothesis.effects:
        effect = search.effects[key]
        for form in search.effects.values():
            if form.id == effect.id and form.key != key:
                effects = tuple(form.key if k == key else k for k in hypothesis.effects)
                yield Hypothesis(effects, hypothesis.released), {**values, **carried(effect, form, values)}


def paired(search, base: Fit, best: Hypothesis, fit: Fit, tried: Tried, say) -> tuple[Hypothesis, Fit]:
    """Two effects that were taken up together where one after the other leaves something: each alone may fit badly."""
    for score in search.pairs(fit.problem, base, LATER):
        if score.hypothesis in tried.costs:
            continue
        say(f"fitting {score.hypothesis}", 0.75)
        start = {**base.values, **score.values}
        again = search.fit(fit.problem, score.hypothesis, start, base.shifts, rival=fit.cost)
        allowed = possible(search, score.hypothesis, again)
        tried.add(score.hypothesis, again, allowed)
        if allowed and again.cost < fit.cost - EVIDENCE * inflation(again) and again.held_out() < fit.held_out():
            best, fit = score.hypothesis, again
    return best, fit


def reshape(search: Search, best: Hypothesis, fit: Fit, tried: Tried, say, share: float) -> tuple[Hypothesis, Fit]:
    """Put every effect of `best` in the form in which it fits best, where another form is better by enough."""
    for _ in best.effects:
        for other, start in [*forms(search, best, fit.values)][1:]:
            say(f"fitting {other}", share)
            again = search.fit(fit.problem, other, start, fit.shifts)
            allowed = possible(search, other, again)
            tried.add(other, again, allowed)
            if allowed and again.cost < fit.cost - EVIDENCE * inflation(again):
                best, fit = other, again
                break
        else:
            break
    return best, fit


def carried(effect: Effect, form: Effect, values: Mapping[str, float]) -> dict[str, float]:
    """Where the parameters of another form start: at what those of the same name are in `effect`."""
    found = {f.reported: values[f.symbol] for f in effect.free if f.symbol in values}
    return {f.symbol: found.get(f.reported, f.guess[0] if f.guess else f.typical) for f in form.free}


def eliminate(search, best: Hypothesis, fit: Fit, tried: Tried, say) -> tuple[Hypothesis, Fit]:
    """Drop effects without which the fit is as good."""
    changed = True
    while changed and best.size > 1:
        changed = False
        for drop in (*best.effects, *best.released):
            less = Hypothesis(tuple(k for k in best.effects if k != drop), tuple(s for s in best.released if s != drop))
            say(f"trying without {drop}", 0.8)
            again = search.fit(fit.problem, less, fit.values, fit.shifts, rival=fit.cost + EVIDENCE)
            tried.add(less, again, possible(search, less, again))
            if again.cost < fit.cost + EVIDENCE:
                best, fit, changed = less, again, True
                break
    return best, fit


def fits(result: Diagnosis, identify) -> dict:
    """RMS of every predicted channel by the rule of the rigs: data sheet, calibrated, corrected."""
    rig = result.rig
    recordings = {"identify": identify}
    if (rig.folder / "holdout.csv").exists():
        recordings["holdout"] = rig.recording(rig.folder / "holdout.csv")
    out = {}
    for name, recording in recordings.items():
        model = Model(rig, recording, result.corrected.problem.model.effects)
        kinds = {"simulation": {}, "calibrated": result.calibrated.values, "corrected": result.corrected.values}
        rms = {}
        for kind, values in kinds.items():
            known = {s: v for s, v in values.items() if s in model.values}
            skip = rig.settle if name == "holdout" else 0
            error = (model.predict(settled(model, known, skip)) - model.target)[skip:]
            rms[kind] = np.sqrt(np.mean(error**2, axis=0))
        out[name] = {
            channel: {**{kind: float(rms[kind][i]) for kind in kinds}, "unit": rig.channels[channel].unit}
            for i, channel in enumerate(rig.predict)
        }
    return out
