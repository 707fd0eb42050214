"""What a recording says about a plant: the verdict, its grounds, and the file that keeps them (`diagnosis.json`)."""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from greygate.errors import InputError
from greygate.files import replacing
from greygate.mismatch.claims import ON_BOUND
from greygate.mismatch.effects import SENSOR, Effect
from greygate.mismatch.evidence import Evidence
from greygate.mismatch.excitation import unseen
from greygate.mismatch.fit import Fit
from greygate.mismatch.intervals import interval, least_share, margin, reported
from greygate.mismatch.locate import located
from greygate.mismatch.model import NUISANCES, TINY
from greygate.mismatch.noise import PLACES, Noise
from greygate.mismatch.rig import IN, Rig
from greygate.mismatch.ruled_out import why
from greygate.mismatch.scales import noise
from greygate.mismatch.search import Hypothesis, Search
from greygate.mismatch.selection import APART, STRUCTURE
from greygate.mismatch.shown_by import Shown, shown_by
from greygate.mismatch.verdict import Verdict
from greygate.plain import plain
from greygate.plants.dimensions import clashes
from greygate.plants.plant import Parameter

SCHEMA = "diagnosis/2"
READ = (SCHEMA, "diagnosis/1")  # that can be simulated: the second adds to the first
OPEN = 0.9  # of confidence in a name that is `_doubtful`
LIKE = 2 / 3  # of confidence in a curve where one that is like it acts: of six such on rigs with a truth one was right
DETAIL = 3e-3  # of a misfit: two explanations that differ by less may do so because no model is exact
ELSE = 0.01  # weight of something that no table has, beside a name whose fit leaves nothing: machines are many
FURTHER = 2.0  # times an error, beyond which a recording's own chance does not make it
LITTLE = 0.1  # of the calibrated error: what keeps less is explained, however much less there is elsewhere
FARTHEST = 1400.0  # of cost: a rival this far away has a likelihood of exp(-700), the least that a float can hold
DIGITS = 4  # after the point, of a confidence
SAID = ("formula", "as_well", "curve")  # of a place, besides what is said of each


@dataclass(repr=False)
class Diagnosis:
    """Everything that was found; `as_dict` gives the content of diagnosis.json.

    calibrated, corrected: the fits of the plant without effects, and of `best`. rivals: cost of every hypothesis that
    was fitted. structure: by channel, what slow errors are left. explained: the share of what can be explained. noise:
    what `corrected` leaves, in units of what rig.toml tells, if it tells it. refused: claims that were dropped, one
    sentence each. evidence, shares: by key of an effect, what the recording says for it where its fit did not look, and
    the share of the calibrated plant's squared error that it takes. only_with: by key, what it explains nothing
    without, as that without it. not_shown: key of an effect that the recording cannot show, and that was therefore not
    tried -> why. not_larger_than: of a consistent recording, what it rules out. alone: where several recordings are
    unexplained together, what each says alone (verdict, effects). only_like: whether in the place of a curve that is
    claimed one acts that is like it. words: the lines that are printed of it.
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
    only_with: dict[str, list[str]] = field(default_factory=dict)
    not_shown: dict[str, str] = field(default_factory=dict)
    not_larger_than: list[dict] = field(default_factory=list)
    alone: dict[str, dict] = field(default_factory=dict)
    told: bool = True
    only_like: bool = False
    words: Callable[["Diagnosis"], Iterable[str]] = lambda found: (f"<Diagnosis {found.rig.title}: {found.verdict}>",)

    def __str__(self) -> str:
        """What `greygate diagnose` prints of it."""
        return "\n".join(self.words(self))

    __repr__ = __str__  # what a notebook shows

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
                **({"begins": begun} if (begun := self._begins()) else {}),
                **({"simulation": left} if (left := self._own_values()) else {}),
                **({"explained": round(self.explained, DIGITS)} if self.verdict == Verdict.PARTLY_EXPLAINED else {}),
                **({"refused": self.refused} if self.refused else {}),
                **({"not_tried": [*self.search.untried]} if self.search.untried else {}),
                **({"units": clashing} if (clashing := clashes(self.rig.plant)) else {}),
                **({"searched": share} if (share := self.search.searched) < 1.0 else {}),
                **({"not_larger_than": self.not_larger_than} if self.not_larger_than else {}),
                **({"noise": self._noise(self.noise)} if self.noise else {}),
                "seconds": round(self.seconds, 2),
            }
        )

    def write(self, path: Path | str) -> None:
        """Write diagnosis.json, whole or not at all."""
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(self.as_dict(), indent=1) + "\n", encoding="utf-8", newline="\n")

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

        fitted = (self.unknown.get("effect") or {}).get("parameters", {})
        for place in self.unknown.get("where", ()):
            acts(place["equation"], place["regime"], place["depends_on"], fitted)
            places[place["equation"]] |= {key: place[key] for key in SAID if key in place}
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
    def elsewhere(self) -> dict[str, float]:
        """The values of `corrected`, without those of effects that another recording does not repeat."""
        return lasting(self.search, self.best, self.corrected)

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
                    "confidence": round(self.confidences[key], DIGITS),
                    "form": key,
                    "parameters": reported(effect, self.corrected, self._least[key]),
                    "not_told_apart_from": sorted(name for name, gap in rivals.items() if gap < APART),
                    **({"only_with": self._named(self.only_with[key])} if key in self.only_with else {}),
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
            others = [self.search.effects[k].id for k in hypothesis.effects if k not in rest]
            if mine in others:
                continue  # it differs in a parameter that is outside its tolerance
            for name in [*others, *hypothesis.released]:
                if name not in self.best.released:
                    out[name] = min(out.get(name, np.inf), cost - best)
        return out

    def _confidence(self, key: str, rivals: Mapping[str, float]) -> float:
        """The weight of effect `key` beside its rivals, nothing, and something that no table has."""
        detail = self._detail(key)
        others = sum(_weight(gap, detail) for gap in rivals.values())
        nothing = np.exp(-min(self.evidence[key].log_e, FARTHEST)) if key in self.evidence else 0.0
        sure = float(1.0 / (1.0 + others + nothing + ELSE))
        if self.verdict == Verdict.PARTLY_EXPLAINED:
            sure *= min(max(self.explained, 0.0), 1.0)
        sure *= LIKE if self.only_like and self.search.effects[key].smooth else 1.0
        return sure * (OPEN if self._doubtful(key) else 1.0)

    @cached_property
    def confidences(self) -> dict[str, float]:
        """Key of an effect that is claimed -> the confidence in it."""
        return {key: self._confidence(key, self._rivals(key)) for key in self.best.effects}

    @cached_property
    def placed(self) -> dict[str, float]:
        """Key of an effect that is claimed -> the confidence in it or in a rival that acts in the same equations."""
        equations = {effect.id: effect.equations for effect in self.search.effects.values()}
        out = {}
        for key, sure in self.confidences.items():
            there, detail = self.search.effects[key].equations, self._detail(key)
            rivals = {name: gap for name, gap in self._rivals(key).items() if equations.get(name) == there}
            out[key] = sure * (1.0 + sum(_weight(gap, detail) for gap in rivals.values()))
        return out

    def _detail(self, key: str) -> float:
        """The cost by which two explanations in the place of effect `key` may differ as no model is exact."""
        best = self.rivals[self.best]
        return DETAIL * (self.rivals.get(self.best.without(key), best) - best)

    def _doubtful(self, key: str) -> bool:
        """Whether an effect may stand for what no model has: something is left, any smooth curve is like it, it undoes
        another, takes next to nothing of the error, acts in another's equation, or reshapes its input; or for noise.
        """
        effect = self.search.effects[key]
        beside = (self.search.effects[k] for k in self.best.effects if k != key)
        alike = any(_alike(effect, other) for other in beside)
        slight = self.shares.get(key, 1.0) < DETAIL
        left = self._remaining() or self._rough or self._other_noise
        return bool(left or effect.smooth or key in self.only_with or slight or alike)

    @cached_property
    def _rough(self) -> bool:
        """Whether nobody told the noise, and the corrected run errs by far more than the recording itself is rough."""
        likelihood = self.corrected.likelihood
        if likelihood.expected:
            return False
        errors = np.sqrt(np.mean(likelihood.residual(self.corrected.values) ** 2, axis=0))
        rough = [max(noise(run[n]) for run in likelihood.model.recording.runs) for n in self.rig.predict]
        return bool((errors > FURTHER * np.array(rough)).any())

    @property
    def _other_noise(self) -> bool:
        """Whether the recording shows another noise than that of the corrected fit: for that there was no time."""
        return bool(self.noise and not self.noise.as_told and self.corrected.likelihood.noise.as_told)

    def _named(self, keys: Iterable[str]) -> list[str]:
        """The names of effects, and the symbols of parameters."""
        return [self.search.effects[key].id if key in self.search.effects else key for key in keys]

    def _noise(self, shown: Noise) -> dict:
        """By channel, in its unit, the noise that rig.toml tells and that the recording shows; samples it remembers."""
        rig, told = self.rig, self.corrected.likelihood.sigma
        usual = np.median(told[np.isfinite(told).all(axis=1)], axis=0)
        return {
            name: {
                "told": rig.channels[name].sigma if (self.told or rig.heard) and not rig.channels[name].heard else None,
                "found": float(f"{size:.{PLACES}g}"),
                "unit": rig.channels[name].unit,
                "memory": len(ar),
                "as_told": not doubted,
            }
            for name, size, ar, doubted in zip(rig.predict, shown.size * usual, shown.ar, shown.doubted, strict=True)
        }

    def _parameters(self) -> dict:
        out = {}
        fit, plant = self.corrected, self.rig.plant
        named = {f.symbol for key in self.best.effects for f in self.search.effects[key].free}
        for u in sorted(fit.unknowns, key=lambda u: u.symbol not in self.best.released):
            p = plant.parameters.get(u.symbol)
            if p is None or not p.reach or u.symbol in named:
                continue
            out[u.symbol] = self._parameter(u.symbol, p)
        return out

    def _parameter(self, symbol: str, p: Parameter) -> dict:
        value = self.corrected.values[symbol]
        low, high = interval(value, self.corrected.together[symbol])
        outside = {"outside_tolerance": True} if symbol in self.best.released else {}
        if self.verdict in (Verdict.UNEXPLAINED, Verdict.PARTLY_EXPLAINED) or self._drawn(symbol):
            # what is missing draws a parameter, as far as it may go: no better known than on the data sheet
            low, high, outside = min(low, p.value - p.reach), max(high, p.value + p.reach), {}
        return {"value": value, "ci95": [low, high], "unit": p.unit, **outside}

    def _drawn(self, symbol: str) -> bool:
        """Whether a parameter with a tolerance lies as far from the data sheet as a fit lets it go."""
        unknown = next(u for u in self.corrected.unknowns if u.symbol == symbol)
        value, ends = self.corrected.values[symbol], [unknown.low, unknown.high]
        return symbol not in self.best.released and bool(np.isclose(value, ends, rtol=ON_BOUND, atol=0.0).any())

    def _own_values(self) -> dict[str, float]:
        """The values of what the simulation itself leaves open, such as when its inputs act."""
        return {s: self.corrected.values[s] for s in NUISANCES if s in self.corrected.values}

    def _begins(self) -> dict[str, dict[str, float]]:
        """By recording and state, by how much its free run begins off what is read there."""
        out: dict[str, dict[str, float]] = {}
        for model in self.corrected.likelihood.model.each:
            for key, state in model.begins.items():
                out.setdefault(model.recording.name, {})[state] = self.corrected.values.get(key, 0.0)
        return out

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
        slow = [
            f"{name}: slow errors {1 + ratio:.2g} times those of white noise{self._when(name)}"
            for name, ratio in self.structure.items()
            if ratio > STRUCTURE
        ]
        return "; ".join([*([self.left] if self.left else slow), *self._not_the_next()])

    def _not_the_next(self) -> list[str]:
        """Each channel of which far more stays on the held-out recording than where it was learnt from."""
        found = []
        for channel, held in self.fits.get("holdout", {}).items():
            own = self.fits["identify"][channel]
            times, there, here = held["corrected"] / (own["corrected"] + TINY), _kept(held), _kept(own)
            if self.best.size and there > LITTLE and min(times, there / (here + TINY)) > FURTHER:
                kept = f"{there:.0%} of the calibrated error of {channel}, {here:.0%} where it was learnt from"
                found.append(f"the held-out recording keeps {kept}")
        return found

    def _when(self, channel: str) -> str:
        """Where, when and at which frequencies a channel still errs."""
        place = {"equation": SENSOR + channel, "depends_on": [], "regime": ""}
        found = located(self.corrected, place, [])
        return f" ({found['regime']}, {found['time']}, {found['band']})" if "time" in found else ""


def lasting(search: Search, best: Hypothesis, fit: Fit) -> dict[str, float]:
    """The values of a fit, without those of effects that another recording does not repeat."""
    effects = (search.effects[key] for key in best.effects)
    once = {f.symbol for effect in effects if effect.once for f in effect.strengths}
    return {symbol: value for symbol, value in fit.values.items() if symbol not in once}


def _kept(errors: Mapping[str, float]) -> float:
    """The share of the calibrated plant's RMS error that the corrected one has."""
    return errors["corrected"] / (errors["calibrated"] + TINY)


def _weight(gap: float, detail: float) -> float:
    """The likelihood of an explanation whose cost is `gap` above the best, over that of the best."""
    gap = max(gap, 0.0) * min(1.0, max(gap, 0.0) / max(detail, TINY))
    return float(np.exp(-min(gap, FARTHEST) / 2))


def _alike(one: Effect, other: Effect) -> bool:
    """Whether two act in one equation, and one of them on nothing but signals that the other acts on, too.

    Or one reshapes an input that the other reads.
    """
    mine, others = set(one.depends_on), set(other.depends_on)
    together = bool(set(one.equations) & set(other.equations)) and (mine <= others or others <= mine)
    return together or any(b.uses(name) for a, b in ((one, other), (other, one)) for name in a.filters)


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
