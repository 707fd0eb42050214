"""A diagnosis in words: the lines that `greygate diagnose` prints, and the phrases that its page shares with them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from greygate.mismatch.diagnosis import Diagnosis
from greygate.mismatch.experiments.separation import separations
from greygate.mismatch.locate import display_unit
from greygate.mismatch.rig import Rig
from greygate.mismatch.selection import APART
from greygate.mismatch.verdict import LEAST_SURE, Verdict
from greygate.plants.expressions import names
from greygate.plants.plant import Parameter

EXPERIMENTS = {
    "x": "the same moves on another part of the travel, up to its ends",
    "v": "the same path slower and faster",
    "a": "the same path at the same speed with harder and softer starts",
    "t": "the same moves again minutes later",
}
"""Variable -> the experiment in which it alone changes, for the variables of any motion; plants add their own."""

DIVERGES = "diverges"  # in place of the error of a simulation that does not stay finite
ALONE = " alone"  # after a recording, which there was no time to ask by itself
FEW = 5  # hypotheses that are named of those for which there was no time
SIMULATED = 3  # number of alternatives for which simulation finds an experiment


@dataclass(frozen=True)
class Amount:
    """A value in a person's unit, written to two digits of its uncertainty."""

    value: str
    low: str
    high: str
    unit: str

    def __str__(self) -> str:
        between = f" [{self.low}, {self.high}]" if self.low else ""
        return f"{self.value}{between}{' ' * bool(self.unit)}{self.unit}"


def amount(value: float, ci95: Sequence[float] | None, unit: str) -> Amount:
    """`value` with its interval as a person reads it."""
    factor, label = display_unit(unit, abs(value))
    known = ci95 if ci95 and None not in ci95 else (value, value)
    value, (low, high) = value * factor, (b * factor for b in known)
    half = (high - low) / 2
    if not half > 0:
        return Amount(f"{value:.4g}", "", "", label)
    power = math.floor(math.log10(max(abs(value), half)))
    power = 0 if -3 <= power < 6 else power
    digits = min(max(1 - math.floor(math.log10(half)) + power, 0), 7)
    texts = [f"{v / 10.0**power:.{digits}f}" + (f"e{power}" if power else "") for v in (value, low, high)]
    return Amount(texts[0], texts[1], texts[2], label)


def means(result: Diagnosis, entry: Mapping) -> str:
    """An effect of the diagnosis in words."""
    effect = result.search.effects.get(entry.get("form", entry["id"]))
    return effect.means if effect else "a fitted term that the table does not have"


def lines(result: Diagnosis) -> list[str]:
    """The diagnosis on one screen."""
    found = result.as_dict()
    seconds = result.calibrated.likelihood.model.recording.samples * result.rig.dt
    out = [
        f"{result.rig.folder.resolve().name} ({found['plant']}), {seconds:.4g} s of recording",
        sentence(found),
    ]
    for i, (place, acts) in enumerate(where(found)):
        out.append(row("" if i else "where", place))
        out += [row("", f"  {acts}")] if acts else []
    formulas = dict.fromkeys(place["formula"] for place in found["where"] if "formula" in place)
    out += [row("formula", text) for text in formulas]
    for entry in found["effects"]:
        sure = f" (confidence {entry['confidence']:.3g})" if entry["id"] != "unknown" else ""
        out.append(row("effect", f"{entry['id']}: {means(result, entry)}{sure}"))
        for name, p in entry["parameters"].items():
            name = name.removeprefix(f"unknown_{p.get('place')}_")  # the file holds the full name with the place
            out.append(row("", f"{name:<14} {amount(p['value'], p['ci95'], p['unit'])}"))
        if shown := result.shown.get(entry.get("form", "")):
            out.append(row("", str(shown)))
    if "explained" in found:
        out.append(row("explains", f"{found['explained']:.1%} of the squared error that can be removed"))
    for i, (name, p) in enumerate(found["parameters"].items()):
        out.append(row("" if i else "parameters", parameter(result, name, p)))
    for name, own in found.get("recordings", {}).items():
        for symbol, p in own.get("parameters", {}).items():
            out.append(row(name, parameter(result, symbol, p, result.rig.of(name))))
        out += [row(name, own["resampled"])] if "resampled" in own else []
        out += [row(name, f"alone: {alone(own['alone'])}")] if "alone" in own else []
    out += fit_table(found["fit"])
    for i, text in enumerate(alike(result, found)):
        out.append(row("" if i else "alternatives", text))
    for i, text in enumerate(found.get("refused", ())):
        out.append(row("" if i else "refused", text))
    for i, text in enumerate(found.get("units", ())):
        out.append(
            row("" if i else "units", f"{text}: correct the units, or do not trust those of what is found there")
        )
    if untried := found.get("not_tried"):
        what = f"{len(untried)} hypotheses and steps"
        out.append(row("not tried", f"{what}, for want of time: {', '.join(untried[:FEW])}"))
    if share := found.get("searched"):
        out.append(row("searched", f"{share:.0%} of the recording, for runs are dear; fitted and tested on all of it"))
    for i, text in enumerate(bounds(found)):
        out.append(row("" if i else "not there", text))
    for i, text in enumerate(hidden(result)):
        out.append(row("" if i else "cannot show", text))
    for i, text in enumerate(noises(found)):
        out.append(row("" if i else "noise", text))
    out.append(row("remains", found["remaining"] or nothing_left(result)))
    if result.verdict == Verdict.UNEXPLAINED and result.search.lost(result.corrected):
        out.append(
            row("lost", "the free run leaves the recording, which a trifle may do; window_s in rig.toml restarts it")
        )
    return [*out, f"{found['seconds']:.1f} s"]


def sentence(found: Mapping) -> str:
    """The verdict in a sentence; that nothing explains is not said where hypotheses were left untried."""
    verdict, left = Verdict(found["verdict"]), found.get("not_tried", ())
    if verdict == Verdict.UNEXPLAINED and any(not what.endswith(ALONE) for what in left):
        return "unexplained: something is missing, and there was no time to try every effect: give more --seconds"
    if verdict == Verdict.RECORDING_FAULT and max(e["confidence"] for e in found["effects"]) < LEAST_SURE:
        return "recording fault: what is named here may be a fault of the recording, or of the simulation"
    return verdict.words


def alone(found: Mapping) -> str:
    """What one of several recordings says alone."""
    claimed = ", ".join(entry["id"] for entry in found["effects"] if entry["id"] != "unknown")
    return claimed or Verdict(found["verdict"]).replace("_", " ")


def nothing_left(result: Diagnosis) -> str:
    """What is said where nothing remains: a sensor's noise is only spoken of where somebody told it."""
    if result.told:
        return "nothing above what the sensors' noise makes"
    return "nothing that goes with the machine's signals; whether it is noise, nobody told"


def bounds(found: Mapping) -> list[str]:
    """Each effect that is not there with the size that the recording rules out."""
    out = []
    for entry in found.get("not_larger_than", ()):
        sizes = [f"{n} {amount(p['value'], None, p['unit'])}" for n, p in entry.get("parameters", {}).items()]
        out += [f"{entry['id']}: not larger than {', '.join(sizes)}"] if sizes else []
    return out


def noises(found: Mapping) -> list[str]:
    """Each channel whose noise is not what rig.toml tells."""
    out = []
    for name, noise in found.get("noise", {}).items():
        if noise["told"] and not noise["as_told"]:
            coloured = f", remembers {noise['memory']} samples" if noise["memory"] else ""
            size, times = amount(noise["found"], None, noise["unit"]), noise["found"] / noise["told"]
            out.append(f"{name}: {size}, {times:.2g} times what rig.toml tells{coloured}")
    return out


def hidden(result: Diagnosis) -> list[str]:
    """Effects that the recording cannot show, those of one reason together."""
    reasons: dict[str, list[str]] = {}
    for name, reason in result.cannot_show.items():
        reasons.setdefault(reason, []).append(name)
    return [", ".join(those) + (f": {reason}" if reason else "") for reason, those in reasons.items()]


def row(head: str, text: str) -> str:
    return f"  {head:<14}{text}"


def where(found: Mapping) -> list[tuple[str, str]]:
    """(equations and variables; regime, time and frequency band), with places that agree in all of it together."""
    places: dict[tuple, list[str]] = {}
    for place in found["where"]:
        regime = place["regime"].rpartition("; ")[2]  # where, after what acts there
        acts = ", ".join((regime, place["time"], place["band"])) if "time" in place else ""
        key = tuple(place["depends_on"]), tuple(place.get("as_well", ())), acts
        places.setdefault(key, []).append(place["equation"])
    return [
        (" and ".join(equations) + (f", depends on {', '.join(on)}" if on else "") + _as_well(others), acts)
        for (on, others, acts), equations in places.items()
    ]


def _as_well(others: Sequence[str]) -> str:
    return f" ({'; '.join(others)}: does as well)" if others else ""


def parameter(result: Diagnosis, name: str, found: Mapping, rig: Rig | None = None) -> str:
    """A fitted parameter beside the value of its data sheet. rig: as it is in one recording."""
    known = (rig or result.rig).plant.parameters[name]
    low, high = (end if end is not None else math.nan for end in found["ci95"])
    far = low > known.value + known.reach or high < known.value - known.reach
    off = " OUTSIDE ITS TOLERANCE" if found.get("outside_tolerance") else " beyond its tolerance" if far else ""
    sheet = given(known, found["value"])
    return f"{name:<14} {amount(found['value'], found['ci95'], found['unit'])}  (data sheet {sheet}){off}"


def given(sheet: Parameter, value: float) -> str:
    """What the data sheet says of a parameter, in the unit in which `value` is written."""
    factor, _ = display_unit(sheet.unit, abs(value))
    unsure = f"{sheet.plus_minus * factor:.5g}" if sheet.plus_minus else f"{100 * sheet.tolerance:g} %"
    return f"{sheet.value * factor:.5g} ± {unsure}"


def fit_table(fit: Mapping) -> list[str]:
    """RMS of simulated minus recorded, one line for each recording and channel."""
    lines = fit_rows(fit)
    first, second = (max(least, *(len(line[i]) + 1 for line in lines)) for i, least in enumerate((10, 8)))
    out = [row("fit (RMS)", f"{'':{first + second + 4}}{'data sheet':>11}{'calibrated':>12}{'corrected':>11}")]
    for recording, channel, unit, *texts in lines:
        name = f"{recording:<{first}}{channel:<{second}}{unit:<4}"
        out.append(row("", f"{name}{texts[0]:>11}{texts[1]:>12}{texts[2]:>11}"))
    return out


def fit_rows(fit: Mapping) -> list[tuple[str, ...]]:
    """(recording, channel, unit, RMS of the data sheet's simulation, calibrated, corrected)."""
    out = []
    for recording, channel, rms in ((r, c, rms) for r, channels in fit.items() for c, rms in channels.items()):
        values = [rms[kind] for kind in ("simulation", "calibrated", "corrected")]
        factor, unit = display_unit(rms["unit"], max((v for v in values if v is not None), default=0.0))
        out.append((recording, channel, unit, *(DIVERGES if v is None else f"{factor * v:.4g}" for v in values)))
    return out


def alike(result: Diagnosis, found: Mapping) -> list[str]:
    """Every explanation that is about as good as the best, with the experiment that would separate the two."""
    out, told = [], separations(result, found["effects"], SIMULATED)
    units = {name: channel.unit for name, channel in result.rig.channels.items()}
    for entry in found["effects"]:
        for other in entry["not_told_apart_from"]:
            by = told.get((entry["id"], other))
            how = f"apart by {by.words(units) if by else experiment(result, entry['id'], other)}"
            if by and not by.tells:
                how = "no experiment that was tried tells them apart"
            out.append(f"{other} in place of {entry['id']}; {how}")
        out += [
            f"something else in place of {entry['id']} and {other}: each explains little without the other"
            for other in entry.get("only_with", ())
            if entry["id"] < other
        ]
    if not found["effects"]:
        best = result.rivals.get(result.best, 0.0)
        rivals = sorted((cost - best, str(h)) for h, cost in result.rivals.items() if h != result.best)
        out += [f"with {name} a little better, too little for a claim" for gap, name in rivals if gap < -APART][:3]
    return out


def experiment(result: Diagnosis, one: str, other: str) -> str:
    """The experiment that changes a variable on which only one of the two effects depends."""
    first, second = (_depends(result, name) for name in (one, other))
    differ = [v for v in (*first, *second) if (v in first) != (v in second)] or [*first, *second]
    known = {**EXPERIMENTS, **result.rig.plant.experiments}
    tests = [known.get(v, f"steps of {v}, small and large") for v in differ]
    return ", or ".join(list(dict.fromkeys(tests))[:2]) or "a longer recording with larger moves"


def _depends(result: Diagnosis, name: str) -> tuple[str, ...]:
    """Variables that an effect, or the equation of a parameter, depends on."""
    for effect in result.search.effects.values():
        if effect.id == name:
            return effect.depends_on
    plant = result.rig.plant
    texts = [t for e in plant.equations.values() for t in e.terms.values() if name in names([t])]
    texts += [t for d in plant.definitions.values() for t in d.terms.values() if name in names([t])]
    return tuple(v for v in ("x", "v", *result.rig.channels) if v in names(texts))
