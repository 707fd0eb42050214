"""The sections of the page, each named as the template that it fills in; one whose context is None is left out."""

import math
from collections.abc import Iterator, Mapping, Sequence
from html import escape

import numpy as np
from markupsafe import Markup

from greygate.mismatch import words
from greygate.mismatch.diagnosis import Diagnosis
from greygate.mismatch.locate import display_unit
from greygate.mismatch.model import TINY, Model
from greygate.mismatch.places import unit_of_place
from greygate.mismatch.selection import APART
from greygate.mismatch.verdict import Verdict
from greygate.mismatch.words import DIVERGES, amount, means, parameter, sentence
from greygate.models.drawn import shortened
from greygate.pages import figures
from greygate.pages.diagnosis import advice
from greygate.pages.diagnosis.residual import FEW, Diagnosed, Residual, binned, dependence, edges_of, near, part_of
from greygate.pages.figures import Curve, Scale
from greygate.pages.units import labelled, number
from greygate.pages.zoomable import Trace, curves, share
from greygate.plants import units
from greygate.plants.expressions import names

BETTER = 0.98  # ratio of RMS errors below which a correction counts as an improvement


def head(case: Diagnosed) -> dict:
    """The verdict in a sentence, the headline, and whether there is a ladder of evidence to lead to."""
    return {
        "title": case.title,
        "plant": case.found["plant"],
        "sentence": sentence(case.found),
        "facts": facts(case),
        "rivals": sum(map(math.isfinite, case.result.rivals.values())) > 1,
        "steps": advice.steps(case),
        **signals(case),
    }


def signals(case: Diagnosed) -> dict:
    """The channel that the correction helps most: recorded, by the data sheet, and at best, its inputs below."""
    name, model, predicted = case.played
    channel, rig = _helped(case)[1], case.result.rig
    target, i = model.recording[channel], rig.predict.index(channel)
    factor, label = display_unit(rig.channels[channel].unit, float(np.abs(target).max()))
    best = "corrected" if "corrected" in predicted else "calibrated"
    traces = {"recorded": Trace(target * factor, "reference", 3.5)}
    for kind, colour in (("data sheet", "extra"), (best, "float")):
        traces[kind] = Trace(_within(near(predicted[kind][:, i], target), target) * factor, colour)
    below, unit = _inputs(case, model)
    labels, points = [labelled(channel, label), *([unit] if below else [])], _points(case)
    return {
        "channel": channel, "record": called(case, name), "best": best, "inputs": ", ".join(below),
        "samples": len(target), "run": curves(traces | below, rig.dt, labels, points), "drawn": points,
    }  # fmt: skip


def _points(case: Diagnosed) -> int:
    """Of a curve: recorded, two simulations and the inputs are drawn, and two errors of each channel."""
    return share(3 + len(case.result.rig.inputs) + 2 * len(case.result.rig.predict))


def called(case: Diagnosed, name: str) -> str:
    """What a reader calls the recordings of that name: their file, where they are one."""
    held, given = name == "holdout", case.result.rig.given
    file = f"{name}.csv" if not given else "what was held out" if held else "the recording"
    return f"{file}, which no fit has seen" if held else file


def _within(predicted: np.ndarray, target: np.ndarray) -> np.ndarray:
    """A simulation as far as it stays within sight of what was recorded: what runs away would flatten all else."""
    low, high = float(target.min()), float(target.max())
    return np.where((predicted >= low - (high - low)) & (predicted <= high + (high - low)), predicted, np.nan)


def _inputs(case: Diagnosed, model: Model) -> tuple[dict[str, Trace], str]:
    """(the recorded inputs to be drawn below, the label of their axis): of several units in parts of their largest."""
    given = {name: case.result.rig.channels[name].unit for name in case.result.rig.inputs}
    one = len({*given.values()}) == 1
    largest = {name: float(np.abs(model.recording[name]).max()) or 1.0 for name in given}
    factor, label = display_unit(next(iter(given.values()), "1"), max(largest.values(), default=1.0))
    traces = {
        name: Trace(
            model.recording[name] * (factor if one else 1.0 / largest[name]), COLOURS[k % len(COLOURS)], below=True
        )
        for k, name in enumerate(given)
    }
    return traces, labelled(", ".join(given) if one else "inputs, of their largest", label if one else "1")


def facts(case: Diagnosed) -> list[tuple[str, str, bool | None]]:
    """The headline: (value, its meaning, whether it is good, or None)."""
    found = case.found
    place = " and ".join(p["equation"] for p in found["where"])
    lines: list[tuple[str, str, bool | None]] = [
        (found["verdict"].replace("_", " "), f"in {place}" if place else "verdict", None)
    ]
    for entry in found["effects"]:
        size = ""
        if entry["id"] != "unknown" and entry["parameters"]:
            name, p = next(iter(entry["parameters"].items()))
            known = amount(p["value"], p["ci95"], p["unit"])
            sure = entry["confidence"]
            size = f", {name} {known}; confidence {sure:.2g}: {advice.trust(sure)}"
        if entry["id"] == "unknown" and "formula" in found["where"][0]:
            lines.append(("a formula", found["where"][0]["formula"], None))
        else:
            lines.append((entry["id"], f"{means(case.result, entry)}{size}", None))
    if "explained" in found:
        lines.append((f"{found['explained']:.0%}", "of the squared error that can be removed, by what is named", None))
    for name, p in found["parameters"].items():
        if p.get("outside_tolerance"):
            lines.append((name, parameter(case.result, name, p), None))
    return [*lines, _error(case)]


def _helped(case: Diagnosed) -> tuple[str, str, Mapping]:
    """(recording, channel, its RMS errors) where the correction reduces the error most."""
    fit = case.found["fit"]
    record = "holdout" if "holdout" in fit else "identify"

    def reduced(item: tuple[str, Mapping]) -> float:
        was, now = item[1]["calibrated"], item[1]["corrected"]
        return math.inf if was is None or now is None else now / max(was, TINY)

    return (record, *min(fit[record].items(), key=reduced))


def _error(case: Diagnosed) -> tuple[str, str, bool | None]:
    """The RMS error that the correction reduces most, before and after it."""
    record, channel, rms = _helped(case)
    if None in (rms["calibrated"], rms["corrected"]):
        return DIVERGES, f"the simulation of {channel} on {record}", False
    factor, unit = display_unit(rms["unit"], rms["calibrated"])
    was, now = (number(factor * rms[kind]) for kind in ("calibrated", "corrected"))
    if not case.changed:
        return f"{now} {unit}", f"RMS error of {channel} on {record}", None
    better = rms["corrected"] < BETTER * rms["calibrated"]
    return f"{was} → {now} {unit}", f"RMS error of {channel} on {record}, calibrated → corrected", better or None


ZOOM = 2000  # samples drawn where the misfit is largest; two windows where a rig has them;
ZOOM_PART = 4  # but no more than such a part of a recording
SHORTEST = 150  # samples that are drawn at least
COLOUR = {"calibrated": "fixed", "corrected": "float"}
COLOURS = "cost", "fixed", "ink", "soft"  # of inputs


def runs(case: Diagnosed) -> dict:
    """A row of pictures per channel."""
    return {"changed": case.changed, "runs": channels(case), "drawn": _points(case)}


def channels(case: Diagnosed) -> list[dict]:
    """For each channel, the errors over a recording by the rig's rule, and a zoom on the largest misfit.

    The recording is holdout.csv where there is one.
    """
    result, (name, model, predicted) = case.result, case.played
    rows = []
    for i, channel in enumerate(result.rig.predict):
        target = model.target[:, i]
        drawn = {kind: near(predicted[kind][:, i], target) for kind in case.fits}
        errors = {kind: p - target for kind, p in drawn.items()}
        rows.append(
            {
                "channel": channel,
                "record": called(case, name),
                "samples": len(target),
                "run": run_data(errors, result, channel, _points(case)),
                "zoom": zoom_picture(result, target, drawn, channel),
            }
        )
    return rows


def run_data(errors: Mapping[str, np.ndarray], result: Diagnosis, channel: str, points: int) -> dict:
    """The errors over the recording, to zoom. A first window far beyond the rest is left out, not to flatten it."""
    opening = result.rig.window or 0
    later = [e[opening:] for e in errors.values()]
    low, high = min(float(e.min()) for e in later), max(float(e.max()) for e in later)
    factor, label = display_unit(result.rig.channels[channel].unit, max(-low, high))
    least, largest = figures.span([low, high], margin=1.0)
    shown = {k: np.where((e >= least) & (e <= largest), e, np.nan) * factor for k, e in errors.items()}
    traces = {kind: Trace(error, COLOUR[kind]) for kind, error in shown.items()}
    return curves(traces, result.rig.dt, [labelled(f"error of {channel}", label)], points)


def zoom_picture(result: Diagnosis, target: np.ndarray, predicted: Mapping[str, np.ndarray], channel: str) -> Markup:
    """Draw the calibrated simulation's residual where it is largest, and the change by the correction."""
    dt, window = result.rig.dt, result.rig.window
    length = min(2 * window if window else max(min(ZOOM, len(target) // ZOOM_PART), SHORTEST), len(target))
    missed = target - predicted["calibrated"]
    power = np.concatenate(([0.0], np.cumsum(missed**2)))
    starts = np.arange(window or 0, len(target) - length + 1, window or max(length // 4, 1))
    first = int(starts[np.argmax(power[starts + length] - power[starts])]) if len(starts) else 0
    steps = np.arange(first, min(first + length, len(target)), max(length // 500, 1))
    factor, label = display_unit(result.rig.channels[channel].unit, float(np.abs(missed[steps]).max()))
    times = (steps * dt).tolist()
    lines = [Curve(times, shortened(missed[steps] * factor), "reference")]
    if "corrected" in predicted:
        added = predicted["corrected"] - predicted["calibrated"]
        lines.append(Curve(times, shortened(added[steps] * factor), "after"))
    marks = [k * dt for k in range(first, first + length, window)][1:] if window else []
    return figures.chart(
        lines,
        x="time [s]",
        y=labelled(f"{channel} − calibrated", label),
        x_limits=(times[0], times[-1]),
        marks=marks,
        levels=[(0.0, "")],
        height=230,
    )


def where(case: Diagnosed) -> dict:
    """Places in words, and a row of pictures per channel."""
    before, after = case.residuals["calibrated"], case.residuals.get("corrected")
    return {
        "where": words.where(case.found),
        "record": called(case, "identify"),
        "windowed": case.result.rig.window is not None,
        "changed": case.changed,
        "missing": [missing(case, place) for place in case.found["where"][:1] if "curve" in place],
        "against": against(before, after, case.depends_on),
    }


def missing(case: Diagnosed, place: Mapping) -> dict:
    """The term that is missing over the signal on which it depends: as a curve with its band, beside the formula."""
    curve, plant = place["curve"], case.result.rig.plant
    one = min(names([curve["of"]]))  # of a difference all have the same unit
    unit = plant.unit(one) if one in plant.symbols else "s"
    scale, label = display_unit(unit, max(map(abs, curve["at"])))
    x = [scale * at for at in curve["at"]]
    band = Curve([*x, *x[::-1]], [*curve["low"], *curve["high"][::-1]], "quartiles")
    power = unit_of_place(plant, place["equation"])
    picture = figures.chart(
        [band, Curve(x, curve["value"], "before")],
        x=labelled(curve["of"], label),
        y=labelled(place["equation"], units.written(power) if power else ""),
        y_limits=figures.span([min(curve["low"]), max(curve["high"])]),
        levels=[(0.0, "")],
        width=480,
        height=260,
    )
    return {"equation": place["equation"], "formula": place["formula"], "picture": picture}


def against(before: Residual, after: Residual | None, told: Sequence[str]) -> list[dict]:
    """Median and quartiles of the residual: a row for each channel, a picture for each variable."""
    rows = []
    for channel, error in before.errors.items():
        drawn = {name: binned(x, error) for name, x in before.variables.items()}
        values = np.concatenate([[0.0], *(q.ravel() for _, q in drawn.values())])
        factor, unit = display_unit(before.units[channel], float(np.abs(values).max()) or 1.0)
        pictures = []
        for name, (middle, quartiles) in drawn.items():
            scale, label = display_unit(before.units[name], float(np.abs(before.variables[name]).max()))
            x, q = middle * scale, quartiles * factor
            lines = [Curve([*x, *x[::-1]], [*q[:, 0], *q[::-1, 2]], "quartiles"), Curve(x, q[:, 1], "before")]
            if after is not None:
                at, now = binned(after.variables[name], after.errors[channel])
                lines.append(Curve(at * scale, now[:, 1] * factor, "after"))
            picture = figures.chart(
                lines,
                x=labelled(name, label),
                y=labelled(channel, unit),
                y_limits=figures.span([factor * values.min(), factor * values.max()]),
                levels=[(0.0, "")],
                width=285,
                height=170,
            )
            share = dependence(before.variables[name], error)
            pictures.append({"name": name, "picture": picture, "share": 100 * share, "told": name in told})
        rows.append({"channel": channel, "pictures": pictures})
    return rows


CELLS = {False: (36, 20), True: (16, 12)}  # of a map, by whether its points are few


def maps(case: Diagnosed) -> dict:
    """A row of pictures per channel."""
    return {"maps": mapped(case.residuals["calibrated"], case.residuals.get("corrected"), case.depends_on)}


def mapped(before: Residual, after: Residual | None, told: Sequence[str]) -> list[dict]:
    """For each channel, the residual over the two variables that explain most of it, and over time."""
    rows = []
    for channel, error in before.errors.items():
        shares = {n: dependence(x, error) for n, x in before.variables.items()}
        ranked = [*dict.fromkeys([*told, *sorted(shares, key=lambda n: -shares[n])])]
        one, other = [n for n in ranked if n != "t"][:2] if len(ranked) > 2 else (ranked[0], ranked[-1])
        pairs = [(one, other), ("t", one)]
        reach = max(float(np.percentile(np.abs(cells(before, channel, pair)[0]), 95)) for pair in pairs) or 1.0
        pictures = []
        for pair in pairs:
            for title, residual in (("calibrated", before), ("corrected", after)):
                if residual is not None:
                    pictures.append((title, pair, heat(residual, channel, pair, reach)))
        factor, unit = display_unit(before.units[channel], reach)
        rows.append({"channel": channel, "pictures": pictures, "reach": f"{number(reach * factor)} {unit}"})
    return rows


def cells(residual: Residual, channel: str, pair: tuple[str, str]) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """(mean residual of each cell that holds points, number of that cell, edges of both variables)."""
    error = residual.errors[channel]
    signals = [residual.variables[name] for name in pair]
    columns, rows = CELLS[len(error) < FEW]
    edges = [edges_of(s, n) for s, n in zip(signals, (columns, rows), strict=True)]
    i, j = (part_of(s, e) for s, e in zip(signals, edges, strict=True))
    inside = (i >= 0) & (i < columns) & (j >= 0) & (j < rows)
    cell = (i * rows + j)[inside]
    count = np.bincount(cell, minlength=columns * rows)
    at = np.flatnonzero(count)
    return np.bincount(cell, error[inside], minlength=columns * rows)[at] / count[at], at, edges


def heat(residual: Residual, channel: str, pair: tuple[str, str], reach: float, width: int = 285) -> Markup:
    """Mean residual in cells of two variables: blue above zero, orange below, full colour at `reach`."""
    mean, at, edges = cells(residual, channel, pair)
    columns, rows = (len(e) - 1 for e in edges)
    signals = [residual.variables[name] for name in pair]
    labels = [display_unit(residual.units[n], float(np.abs(s).max())) for n, s in zip(pair, signals, strict=True)]
    wide, tall = 100 / columns, 100 / rows
    parts = []
    for value, k in zip(mean, at, strict=True):
        i, j = divmod(int(k), rows)
        strength = min(abs(value) / reach, 1.0)
        parts.append(
            f'<rect class="{"above" if value > 0 else "below"}" x="{i * wide:.2f}%" '
            f'y="{100 - (j + 1) * tall:.2f}%" width="{1.02 * wide:.2f}%" height="{1.02 * tall:.2f}%" '
            f'fill-opacity="{0.1 + 0.9 * strength:.2f}"/>'
        )
    return figures.chart(
        [Curve([e * labels[0][0] for e in edges[0][[0, -1]]], [e * labels[1][0] for e in edges[1][[0, -1]]], "none")],
        x=labelled(pair[0], labels[0][1]),
        y=labelled(pair[1], labels[1][1]),
        y_limits=tuple(e * labels[1][0] for e in edges[1][[0, -1]]),
        inside="".join(parts),
        width=width,
        height=190,
    )


LADDER = 12  # hypotheses drawn


def evidence(case: Diagnosed) -> dict | None:
    """The ladder of hypotheses; None where there is only one."""
    if sum(map(math.isfinite, case.result.rivals.values())) < 2:
        return None
    return {"ladder": ladder(case.result), "verdict": case.found["verdict"]}


def ladder(result: Diagnosis, width: int = 980) -> Markup:
    """Draw every fully fitted hypothesis by its distance from the best, on a logarithmic scale."""
    rivals = {h: cost for h, cost in result.rivals.items() if math.isfinite(cost)}  # the others diverge
    best = min(rivals.values())
    taken = None if result.verdict == Verdict.UNEXPLAINED else result.best
    rungs = sorted((cost - best, str(h), h == taken) for h, cost in rivals.items())
    rungs = [*rungs[:LADDER], *(rung for rung in rungs[LADDER:] if rung[1] == "nothing")]
    right, row, below = 70, 22, 40
    left = min(max(round(6.8 * max(len(name) for _, name, _ in rungs)) + 20, 160), width - 400)
    height = row * len(rungs) + below
    top = max(max(gap for gap, _, _ in rungs), 100.0)
    scale = Scale(1.0, top, width - left - right, log=True)
    parts = [f'<svg class="chart" viewBox="0 0 {width} {height}" role="img" aria-label="evidence for each hypothesis">']
    for power in range(math.ceil(math.log10(top)) + 1):
        if 10.0**power > top:
            break
        at = left + scale(10.0**power)
        parts.append(f'<path class="grid" d="M{at:.1f} 0V{height - below + 4}"/>')
        label = number(10.0**power, 1).removeprefix("1·")
        parts.append(f'<text class="tick" x="{at:.1f}" y="{height - 24}" text-anchor="middle">{label}</text>')
    at = left + scale(APART)
    parts.append(f'<path class="mark" d="M{at:.1f} 0V{height - below + 4}"/>')
    for k, (gap, name, bold) in enumerate(rungs):
        y = row * k + row / 2
        end = scale(max(gap, 1.0))
        weight = ' font-weight="600"' if bold else ""
        parts.append(f'<text x="{left - 10}" y="{y + 4:.1f}" text-anchor="end"{weight}>{escape(name)}</text>')
        kind = "good-dot" if bold else "dot"
        parts.append(f'<path class="rung" d="M{left} {y:.1f}h{end:.1f}"/>')
        parts.append(f'<circle class="{kind}" cx="{left + end:.1f}" cy="{y:.1f}" r="5"/>')
        text = "best" if gap == 0.0 else number(gap)
        parts.append(f'<text class="tick" x="{left + end + 10:.1f}" y="{y + 4:.1f}">{text}</text>')
    parts.append(
        f'<text class="label" x="{left + (width - left - right) / 2}" y="{height - 5}">'
        "cost above the best (logarithmic); left of the dashed line: not told apart</text>"
    )
    return Markup("".join(parts) + "</svg>")


def numbers(case: Diagnosed) -> dict:
    """Effects with their parameters, the fit, and open questions."""
    result, found = case.result, case.found
    return {
        "effects": [(e, words.means(result, e), adds(result, e), amounts(e["parameters"])) for e in found["effects"]],
        "parameters": [*fitted(result, found)],
        "fit": words.fit_rows(found["fit"]),
        "resampled": [(n, own["resampled"]) for n, own in found.get("recordings", {}).items() if "resampled" in own],
        "alike": words.alike(result, found) if not found["effects"] else [],
        "unseen": words.hidden(result),
        "refused": found.get("refused", []),
        "bounds": [
            (entry["id"], name, amount(p["value"], None, p["unit"]))
            for entry in found.get("not_larger_than", ())
            for name, p in entry.get("parameters", {}).items()
        ],
        "noises": words.noises(found),
        "remaining": found["remaining"] or words.nothing_left(result),
    }


def fitted(result: Diagnosis, found: Mapping) -> Iterator[tuple[str, words.Amount, str, bool]]:
    """(name, value, what the data sheet says, whether it lies outside of that) of each parameter that was fitted."""
    own = {name: there.get("parameters", {}) for name, there in found.get("recordings", {}).items()}
    for run, parameters in {"": found["parameters"], **own}.items():
        sheet = result.rig.of(run).plant.parameters
        for symbol, p in parameters.items():
            name = f"{symbol} in {run}" if run else symbol
            known = words.given(sheet[symbol], p["value"])
            yield name, amount(p["value"], p["ci95"], p["unit"]), known, p.get("outside_tolerance", False)


def adds(result: Diagnosis, entry: Mapping) -> list[str]:
    """What an effect of the table adds to the equations, or which parameters of the model that computes them it is."""
    effect, outside = result.search.effects.get(entry.get("form", entry["id"])), result.rig.plant.outside
    if effect is None:
        return []
    own = [f.reported for f in effect.free if outside and f.symbol in outside.parameters]
    added = [f"{path.partition('.')[0]}: + ({text})" for path, text in effect.terms.items()]
    added += [f"{where}: storage + ({text})" for where, text in effect.storages.items()]
    return [*added, *([f"the model's own {', '.join(own)}"] if own else [])]


def amounts(parameters: Mapping) -> list[tuple[str, words.Amount, str]]:
    """(name, amount, and the term, if a fitted term stands for the effect)."""
    return [
        (n, words.amount(p["value"], p["ci95"], p["unit"]), f"{p['place']}: {p['term']}" if "term" in p else "")
        for n, p in parameters.items()
    ]
