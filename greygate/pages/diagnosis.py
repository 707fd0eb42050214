"""The case of a diagnosis in pictures: one HTML page that needs nothing else (docs/diagnosis.md)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from markupsafe import Markup

from greygate.files import replacing
from greygate.mismatch.coloured import settled
from greygate.mismatch.diagnosis import APART, Diagnosis
from greygate.mismatch.experiments.excitation import unseen
from greygate.mismatch.fit import Fit
from greygate.mismatch.locate import signals
from greygate.mismatch.model import Model
from greygate.pages import figures
from greygate.pages import words as explain
from greygate.pages.figures import Line, Scale
from greygate.pages.report import BINS, envelope, shortened, templates
from greygate.plants.recording import Recording

PIECE = 0.1  # s of a window in pictures of the residual, where a rig restarts
SETTLED = 0.3  # of such a window, from which on its pressures count
SKIP = 0.5  # s at the beginning in which states settle that no sensor shows
PARTS = (6, 240)  # of a variable's range, in pictures of the residual: fewest and most
CELLS = {False: (36, 20), True: (16, 12)}  # of a map, by whether its points are few
FEW = 2000  # points
FEWEST = 5  # points in a part that is drawn
ZOOM = 2.0  # s drawn where the misfit is largest; two windows where a rig has them
SHORTEST = 150  # samples of that
LADDER = 12  # hypotheses drawn
KINDS = ("simulation", "calibrated", "corrected")


def write(result: Diagnosis, path: Path | str) -> None:
    """Write the page, whole or not at all. Raises InputError where the folder cannot be written."""
    text = page(result)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def page(result: Diagnosis) -> str:
    """The page of a diagnosis."""
    found = result.as_dict()
    fits = [result.calibrated, *([result.corrected] if changed(result) else [])]
    before, after, *_ = [*residuals(result, fits), None]
    told = [v for place in found["where"] for v in place["depends_on"] if v in before.variables]
    template = templates().get_template("diagnosis.html")
    return template.render(
        d=found,
        title=result.rig.folder.resolve().name,
        sentence=explain.VERDICTS[found["verdict"]],
        facts=facts(result, found),
        effects=[(e, explain.means(result, e), amounts(e["parameters"])) for e in found["effects"]],
        parameters=[(n, explain.parameter(result, n, p)) for n, p in found["parameters"].items()],
        fit=explain.fit_table(found["fit"]),
        alike=explain.alike(result, found),
        unseen=unseen(result.calibrated),
        where=explain.where(found),
        runs=runs(result),
        against=against(before, after, told),
        maps=maps(before, after, told),
        ladder=ladder(result),
        windowed=result.rig.window is not None,
        changed=changed(result),
    )


def changed(result: Diagnosis) -> bool:
    """The diagnosis corrects more than parameters inside their tolerances."""
    return result.verdict != "consistent" and (result.best.size > 0 or bool(result.as_dict()["effects"]))


def amounts(parameters: Mapping) -> list[tuple[str, explain.Amount, str]]:
    """(name, amount, term where a fitted term stands for the effect)."""
    return [
        (n, explain.amount(p["value"], p["ci95"], p["unit"]), f"{p['place']}: {p['term']}" if "term" in p else "")
        for n, p in parameters.items()
    ]


def facts(result: Diagnosis, found: Mapping) -> list[tuple[str, str, bool | None]]:
    """The headline: (value, what it is, good or bad or neither)."""
    place = " and ".join(p["equation"] for p in found["where"])
    lines: list[tuple[str, str, bool | None]] = [
        (found["verdict"].replace("_", " "), f"in {place}" if place else "verdict", None)
    ]
    for entry in found["effects"]:
        first = next(iter(amounts(entry["parameters"])), None)
        size = f", {first[0]} {first[1].value} {first[1].unit}" if first and entry["id"] != "unknown" else ""
        lines.append((entry["id"], f"{explain.means(result, entry)}{size}", None))
    for name, p in found["parameters"].items():
        if p.get("outside_tolerance"):
            lines.append((name, explain.parameter(result, name, p), None))
    record = "holdout" if "holdout" in found["fit"] else "identify"
    channel, rms = min(found["fit"][record].items(), key=lambda item: item[1]["corrected"] / item[1]["calibrated"])
    factor, unit = explain.scaled(rms["unit"], rms["calibrated"])
    was, now = (figures.number(factor * rms[kind]) for kind in ("calibrated", "corrected"))
    if changed(result):
        better = rms["corrected"] < 0.98 * rms["calibrated"]
        text = f"RMS error of {channel} on {record}, calibrated → corrected"
        lines.append((f"{was} → {now} {unit}", text, better or None))
    else:
        lines.append((f"{now} {unit}", f"RMS error of {channel} on {record}", None))
    return lines


# -- what is left ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Residual:
    """Recorded minus simulated by a fit, of every predicted channel, beside what it may depend on.

    errors: name -> (points,), SI, the name telling channel and kind. units: of errors and variables. variables: name ->
    (points,), SI. Points are samples; where the rig restarts, windows of `PIECE` s: a position by how fast its error
    grows, any other channel by its mean error.
    """

    errors: Mapping[str, np.ndarray]
    variables: Mapping[str, np.ndarray]
    units: Mapping[str, str]


def residuals(result: Diagnosis, fits: Sequence[Fit]) -> list[Residual]:
    """What each fit leaves of identify.csv."""
    rig, recording = result.rig, result.calibrated.problem.model.recording
    piece = max(round(PIECE / rig.dt), 10) if rig.window else None
    model = Model(rig, recording, result.corrected.problem.model.effects, piece)
    variables, units = signals(model)
    found = []
    for fit in fits:
        left = model.target - model.predict(known(model, fit))
        errors, kinds = {}, {}
        for i, channel in enumerate(rig.predict):
            unit = rig.channels[channel].unit
            if piece is None:
                errors[f"{channel} left"], kinds[f"{channel} left"] = left[:, i], unit
                continue
            rows = left[: len(left) // piece * piece, i].reshape(-1, piece)[round(SKIP / PIECE) :]
            if model.plant.states[channel].rate if channel in model.plant.states else False:
                clock = (np.arange(piece) - (piece - 1) / 2) * rig.dt
                name, values, unit = f"{channel} drifts", rows @ clock / (clock @ clock), f"{unit}/s"
            else:
                name, values = f"{channel} left", rows[:, round(SETTLED * piece) :].mean(axis=1)
            errors[name], kinds[name] = values, unit
        if piece is None:
            points = variables
        else:
            samples = recording.samples // piece * piece
            first = round(SKIP / PIECE)
            points = {n: v[:samples].reshape(-1, piece).mean(axis=1)[first:] for n, v in variables.items()}
        found.append(Residual(errors, points, {**units, **kinds}))
    return found


def known(model: Model, fit: Fit) -> dict[str, float]:
    """A fit's values for the parameters of `model`."""
    return {**model.values, **{s: v for s, v in fit.values.items() if s in model.values}}


def edges_of(values: np.ndarray, parts: int) -> np.ndarray:
    """Equal parts of where nearly all values lie."""
    low, high = np.percentile(values, (0.5, 99.5))
    return np.linspace(low, high if high > low else low + 1.0, parts + 1)


def part_of(x: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Number of the part in which each value lies, the last edge within; below 0 or beyond where it lies in none."""
    return np.digitize(x, edges) - 1 - (x == edges[-1])


def parts_of(x: np.ndarray) -> int:
    return int(np.clip(len(x) // (15 if len(x) < FEW else 80), *PARTS))


def binned(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(middle of each part of x, quartiles of y there (parts, 3)); only parts that hold enough."""
    edges = edges_of(x, parts_of(x))
    which = part_of(x, edges)
    middles, quartiles = [], []
    for k in range(len(edges) - 1):
        inside = y[which == k]
        if len(inside) >= FEWEST:
            middles.append((edges[k] + edges[k + 1]) / 2)
            quartiles.append(np.percentile(inside, (25, 50, 75)))
    return np.array(middles), np.array(quartiles).reshape(-1, 3)


def dependence(x: np.ndarray, y: np.ndarray) -> float:
    """Share of the variance of y that its mean over parts of x explains, less what chance explains."""
    parts = parts_of(x)
    which = np.clip(np.digitize(x, edges_of(x, parts)), 0, parts + 1)
    count = np.bincount(which, minlength=parts + 2)
    mean = np.bincount(which, y, minlength=parts + 2) / np.maximum(count, 1)
    total, used = float(np.var(y)), int((count > 0).sum())
    if total == 0.0 or len(y) <= used:
        return 0.0
    share = float(np.sum(count * (mean - np.mean(y)) ** 2) / (total * len(y)))
    return max(1.0 - (1.0 - share) * (len(y) - 1) / (len(y) - used), 0.0)


def against(before: Residual, after: Residual | None, told: Sequence[str]) -> list[dict]:
    """A row a channel, a picture a variable: median and quartiles of the residual."""
    rows = []
    for channel, error in before.errors.items():
        drawn = {name: binned(x, error) for name, x in before.variables.items()}
        values = np.concatenate([[0.0], *(q.ravel() for _, q in drawn.values())])
        factor, unit = explain.scaled(before.units[channel], float(np.abs(values).max()) or 1.0)
        pictures = []
        for name, (middle, quartiles) in drawn.items():
            scale, label = explain.scaled(before.units[name], float(np.abs(before.variables[name]).max()))
            x, q = middle * scale, quartiles * factor
            lines = [Line([*x, *x[::-1]], [*q[:, 0], *q[::-1, 2]], "quartiles"), Line(x, q[:, 1], "before")]
            if after is not None:
                at, now = binned(after.variables[name], after.errors[channel])
                lines.append(Line(at * scale, now[:, 1] * factor, "after"))
            picture = figures.chart(
                lines,
                x=_label(name, label),
                y=_label(channel, unit),
                y_limits=figures.span([factor * values.min(), factor * values.max()]),
                levels=[(0.0, "")],
                width=285,
                height=170,
            )
            share = dependence(before.variables[name], error)
            pictures.append({"name": name, "picture": picture, "share": 100 * share, "told": name in told})
        rows.append({"channel": channel, "pictures": pictures})
    return rows


def _label(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


# -- maps ------------------------------------------------------------------------------------------------------------


def maps(before: Residual, after: Residual | None, told: Sequence[str]) -> list[dict]:
    """Of each channel: residual over the two variables that tell most of it, and over time."""
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
        factor, unit = explain.scaled(before.units[channel], reach)
        rows.append({"channel": channel, "pictures": pictures, "reach": f"{figures.number(reach * factor)} {unit}"})
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
    labels = [explain.scaled(residual.units[n], float(np.abs(s).max())) for n, s in zip(pair, signals, strict=True)]
    frame = figures.chart(
        [Line([e * labels[0][0] for e in edges[0][[0, -1]]], [e * labels[1][0] for e in edges[1][[0, -1]]], "none")],
        x=_label(pair[0], labels[0][1]),
        y=_label(pair[1], labels[1][1]),
        y_limits=tuple(e * labels[1][0] for e in edges[1][[0, -1]]),
        width=width,
        height=190,
    )
    inner = (width - figures.LEFT - figures.RIGHT, 190 - figures.TOP - figures.BOTTOM)
    wide, tall = inner[0] / columns, inner[1] / rows
    parts = []
    for value, k in zip(mean, at, strict=True):
        i, j = divmod(int(k), rows)
        strength = min(abs(value) / reach, 1.0)
        parts.append(
            f'<rect class="{"above" if value > 0 else "below"}" x="{figures.LEFT + i * wide:.1f}" '
            f'y="{figures.TOP + inner[1] - (j + 1) * tall:.1f}" width="{wide + 0.2:.1f}" height="{tall + 0.2:.1f}" '
            f'fill-opacity="{0.1 + 0.9 * strength:.2f}"/>'
        )
    return Markup(str(frame).removesuffix("</svg>") + "".join(parts) + "</svg>")


# -- evidence --------------------------------------------------------------------------------------------------------


def ladder(result: Diagnosis, width: int = 980) -> Markup:
    """Every hypothesis that was fitted in full, by how much worse than the best it is, on a logarithmic scale."""
    if len(result.rivals) < 2:
        return Markup("")
    best = min(result.rivals.values())
    taken = None if result.verdict == "unexplained" else result.best
    rungs = sorted((cost - best, str(h), h == taken) for h, cost in result.rivals.items())
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
        label = figures.number(10.0**power, 1).removeprefix("1·")
        parts.append(f'<text class="tick" x="{at:.1f}" y="{height - 24}" text-anchor="middle">{label}</text>')
    at = left + scale(APART)
    parts.append(f'<path class="mark" d="M{at:.1f} 0V{height - below + 4}"/>')
    for k, (gap, name, taken) in enumerate(rungs):
        y = row * k + row / 2
        end = scale(max(gap, 1.0))
        bold = ' font-weight="600"' if taken else ""
        parts.append(f'<text x="{left - 10}" y="{y + 4:.1f}" text-anchor="end"{bold}>{escape(name)}</text>')
        kind = "good-dot" if taken else "dot"
        parts.append(f'<path class="rung" d="M{left} {y:.1f}h{end:.1f}"/>')
        parts.append(f'<circle class="{kind}" cx="{left + end:.1f}" cy="{y:.1f}" r="5"/>')
        text = "best" if gap == 0.0 else figures.number(gap)
        parts.append(f'<text class="tick" x="{left + end + 10:.1f}" y="{y + 4:.1f}">{text}</text>')
    parts.append(
        f'<text class="label" x="{left + (width - left - right) / 2}" y="{height - 5}">'
        "cost above the best (logarithmic); left of the dashed line: not told apart</text>"
    )
    return Markup("".join(parts) + "</svg>")


# -- before and after ------------------------------------------------------------------------------------------------


def runs(result: Diagnosis) -> list[dict]:
    """Per channel: errors over a whole recording by the rule of the rigs, and a zoom on the largest misfit.

    The recording is holdout.csv where there is one.
    """
    rig = result.rig
    path = rig.folder / "holdout.csv"
    name = "holdout" if path.exists() else "identify"
    recording: Recording = rig.recording(path if path.exists() else rig.folder / "identify.csv")
    model = Model(rig, recording, result.corrected.problem.model.effects)
    kinds = {"calibrated": result.calibrated, "corrected": result.corrected}
    if not changed(result):
        del kinds["corrected"]
    skip = rig.settle if path.exists() else 0
    predicted = {kind: model.predict(settled(model, known(model, fit), skip)) for kind, fit in kinds.items()}
    rows = []
    for i, channel in enumerate(rig.predict):
        target = model.target[:, i]
        errors = {kind: np.nan_to_num(p[:, i] - target) for kind, p in predicted.items()}
        rows.append(
            {
                "channel": channel,
                "record": name,
                "run": run_picture(errors, result, channel),
                "zoom": zoom_picture(result, target, {k: p[:, i] for k, p in predicted.items()}, channel),
            }
        )
    return rows


LOOK = {"calibrated": "before", "corrected": "after"}  # class of a line


def run_picture(errors: Mapping[str, np.ndarray], result: Diagnosis, channel: str) -> Markup:
    """Errors over the whole recording, scaled to what comes after the first window."""
    dt = result.rig.dt
    later = [e[result.rig.window or 0 :] for e in errors.values()]
    low, high = min(float(e.min()) for e in later), max(float(e.max()) for e in later)
    factor, label = explain.scaled(result.rig.channels[channel].unit, max(-low, high))
    lines = []
    for kind, error in errors.items():
        points = envelope(error * factor, BINS)
        lines.append(Line([k * dt for k in points["step"]], points["value"], LOOK[kind]))
    return figures.chart(
        lines,
        x="time [s]",
        y=_label(f"error of {channel}", label),
        x_limits=(0.0, len(later[0]) * dt + (result.rig.window or 0) * dt),
        y_limits=figures.span([low * factor, high * factor]),
        width=770,
        height=230,
    )


def zoom_picture(result: Diagnosis, target: np.ndarray, predicted: Mapping[str, np.ndarray], channel: str) -> Markup:
    """What the calibrated simulation misses where it errs most, and what the correction adds to it."""
    dt, window = result.rig.dt, result.rig.window
    length = min(2 * window if window else max(round(ZOOM / dt), SHORTEST), len(target))
    missed = np.nan_to_num(target - predicted["calibrated"])
    power = np.concatenate(([0.0], np.cumsum(missed**2)))
    starts = np.arange(window or 0, len(target) - length + 1, window or max(length // 4, 1))
    first = int(starts[np.argmax(power[starts + length] - power[starts])]) if len(starts) else 0
    steps = np.arange(first, min(first + length, len(target)), max(length // 500, 1))
    factor, label = explain.scaled(result.rig.channels[channel].unit, float(np.abs(missed[steps]).max()))
    times = (steps * dt).tolist()
    lines = [Line(times, shortened(missed[steps] * factor), "reference")]
    if "corrected" in predicted:
        added = np.nan_to_num(predicted["corrected"] - predicted["calibrated"])
        lines.append(Line(times, shortened(added[steps] * factor), "after"))
    marks = [k * dt for k in range(first, first + length, window)][1:] if window else []
    return figures.chart(
        lines,
        x="time [s]",
        y=_label(f"{channel} − calibrated", label),
        x_limits=(times[0], times[-1]),
        marks=marks,
        levels=[(0.0, "")],
        height=230,
    )
