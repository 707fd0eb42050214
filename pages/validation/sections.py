"""The sections of the page, each named as the template that it fills in; one whose context is None is left out."""

import math
from itertools import groupby

import numpy as np
from markupsafe import Markup

from greygate.models.spectra import Octave
from greygate.models.validation import LEASH, Correlation, Validation
from greygate.pages import figures
from greygate.pages.figures import Curve
from greygate.pages.units import display, labelled, number, per_cent
from greygate.pages.validation.judged import Judged, long_run, rows, tally
from greygate.pages.zoomable import Trace, curves, share
from greygate.plain import plain


def head(judged: Judged) -> dict:
    """The judgement itself, its headline, its table."""
    records = list(dict.fromkeys(v.record for v in judged.validations))
    return {"j": judged, "facts": facts(judged), "rows": rows(judged), "records": records}


def facts(judged: Judged) -> list[tuple[str, str, bool | None]]:
    """The headline: (value, its meaning, whether it is good, or None)."""
    fresh = [v for v in judged.validations if v.record not in judged.training] or judged.validations
    worst = min(fresh, key=lambda v: v.fit if not math.isnan(v.fit) else math.inf)
    where = f"{worst.output} on {worst.record}"
    fit = f"{per_cent(worst.fit)} %" if math.isfinite(worst.rms) else "diverges"
    lines: list[tuple[str, str, bool | None]] = [(fit, f"worst fit of a free run, {where}", None)]
    if ahead := [v for v in fresh if 1 in v.ahead]:
        worst = min(ahead, key=lambda v: v.ahead[1][1])
        where = f"{worst.output} on {worst.record}"
        lines.append((f"{per_cent(worst.ahead[1][1])} %", f"worst fit one step ahead, {where}", None))
    for residual in ("free run", "one step ahead"):
        tests = [t for v in fresh for t in v.tests.get(residual, ())]
        if tests:
            good = all(t.passed for t in tests)
            lines.append((tally(tests), f"residual tests passed, {residual}", good or None))
    runs = {long_run(v) for v in judged.validations}
    state = next(s for s in ("unbounded", "drifts", "stable") if s in runs)
    lines.append((state, "over ten times each record, inputs to 1.2 times", state == "stable"))
    if beyond := [r for r in judged.ranges if r.record not in judged.training]:
        widest = max(beyond, key=lambda r: r.outside)
        what = f"of {widest.signal} on {widest.record} beyond what was learnt"
        lines.append((f"{100 * widest.outside:.0f} %", what, None))
    return lines


NARROW = 1e-9  # of an error's size: within it the errors are one value
BARS = 40  # of the error's histogram
WIDTH = 285  # px of a small picture
SYMBOLS = {"phi_ee": "φ(e, e)", "phi_ue": "φ({}, e)", "phi_u2e": "φ({}², e)", "phi_u2e2": "φ({}², e²)",
           "phi_eeu": "φ(e·{}, e)"}  # fmt: skip
LINEAR = ("phi_ee", "phi_ue")


def records(judged: Judged) -> dict:
    """By record, each output with its pictures."""
    points = share(3 * len(judged.validations))
    records = {
        name: [(v, pictures(v, judged.period, points)) for v in group]
        for name, group in groupby(judged.validations, key=lambda v: v.record)
    }
    names = list(dict.fromkeys(v.output for v in judged.validations))
    return {"records": records, "names": names, "long_run": long_run, "drawn": points}


def label(test: Correlation) -> str:
    kind, _, name = test.name.partition(" ")
    return SYMBOLS[kind].format(name)


def pictures(v: Validation, period: float, points: int) -> dict:
    """Every drawing of one output on one record. points: of a curve."""
    used = slice(v.skip, None)
    small, small_unit = display(v.unit, v.rms if math.isfinite(v.rms) else v.spread)
    residual = v.measured[used] - v.predicted[used]
    tests = {
        residual: {
            "linear": [(t, label(t), stems(t)) for t in found if t.name.split()[0] in LINEAR],
            "higher": [(t, label(t), stems(t)) for t in found if t.name.split()[0] not in LINEAR],
        }
        for residual, found in v.tests.items()
    }
    return {
        "run": run_data(v, period, points),
        "histogram": histogram(residual * small, small_unit) if math.isfinite(v.rms) else "",
        "response": _response(v) if v.response else "",
        "octaves": [_octave(o, small, small_unit, v.skip * period) for o in v.octaves],
        "ahead": ahead(v, small, small_unit) if v.ahead else "",
        "long_run": repetitions(v, small, small_unit),
        "tests": tests,
    }


def _octave(o: Octave, factor: float, unit: str, start: float) -> tuple[str, str, str, str]:
    """(octave, error, its share of the signal, when it is most)"""
    share = f"{100 * o.error / o.signal:.3g} %" if o.signal > 0 else "–"
    return f"{o.low:.3g} to {o.high:.3g} Hz", f"{o.error * factor:.3g} {unit}", share, f"{start + o.at:.4g} s"


def _response(v: Validation) -> Markup:
    found = plain(v.response)
    return figures.accuracy(found["frequency"], {"response": found}, (72, 68, 90), WIDTH)


def run_data(v: Validation, period: float, points: int) -> dict:
    """Measured, predicted and, below, error over time, to zoom."""
    factor, unit = display(v.unit, float(np.abs(v.measured).max()))
    small, small_unit = display(v.unit, v.rms if math.isfinite(v.rms) else v.spread)
    reach = LEASH * (np.ptp(v.measured) or np.inf)  # a run that diverges is drawn up to here
    leash = np.mean(v.measured) + reach * np.array([-1, 1])
    near = np.where((v.predicted > leash[0]) & (v.predicted < leash[1]), v.predicted, np.nan)
    traces = {
        "measured": Trace(v.measured * factor, "reference", 3.0),
        "predicted": Trace(near * factor, "float"),
        "error": Trace((v.measured - near) * small, "fixed", 1.2, below=True),
    }
    return curves(traces, period, (labelled(v.output, unit), labelled("error", small_unit)), points)


def histogram(error: np.ndarray, unit: str) -> Markup:
    """Share of samples by error, and the Gaussian of the same mean and deviation."""
    size = float(np.abs(error).max())
    apart = None if np.ptp(error) > NARROW * size else (error[0] - size * NARROW, error[0] + size * NARROW)
    counts, edges = np.histogram(error, BARS, apart if size else None)
    share = counts / counts.sum()
    x, y = np.repeat(edges, 2), np.r_[0, np.repeat(share, 2), 0]
    mean, deviation = np.mean(error), np.std(error)
    at = np.linspace(edges[0], edges[-1], 120)
    normal = (
        np.exp(-0.5 * ((at - mean) / deviation) ** 2) / (deviation * math.sqrt(2 * math.pi)) if deviation else 0 * at
    )
    lines = [Curve(x, 100 * y, "bars"), Curve(at, 100 * normal * (edges[1] - edges[0]), "normal")]
    return figures.chart(lines, x=labelled("error", unit), y="samples [%]", width=WIDTH, height=230)


def stems(test: Correlation) -> Markup:
    """Coefficients over lag, those outside the band in red; bands dashed, the thesis's 1.96/sqrt(N) dotted."""
    beyond = np.abs(test.values) > test.band
    ends = (float(test.lags[0]) - 1, float(test.lags[-1]) + 1)
    lines = []
    for kind, which in (("inside", ~beyond), ("beyond", beyond)):
        x = [v for lag in test.lags[which] for v in (lag, lag, None)]
        y = [v for value in test.values[which] for v in (0.0, value, None)]
        lines.append(Curve(x, y, f"stem {kind}"))
    for level, kind in ((test.plain, "plain"), (test.band, "band")):
        if kind == "band" or test.band > 1.02 * test.plain:
            lines += [Curve(ends, [sign * level] * 2, kind) for sign in (-1, 1)]
    reach = 1.15 * max(np.abs(test.values).max(), test.band)
    return figures.chart(
        lines, x="lag [steps]", x_limits=ends, y_limits=(-reach, reach), levels=[(0.0, "")], width=WIDTH, height=160
    )


def ahead(v: Validation, factor: float, unit: str) -> Markup:
    """RMS over the prediction horizon; the horizontal line is the RMS of the free run."""
    steps = list(v.ahead)
    values = plain([rms * factor if math.isfinite(rms) else None for rms, _ in v.ahead.values()])
    levels = [(v.rms * factor, "")] if math.isfinite(v.rms) else []
    return figures.chart(
        [Curve(steps, values, "series0 dots")],
        x="steps ahead",
        y=labelled("RMS", unit),
        x_log=True,
        x_limits=(0.9 * steps[0], 1.1 * max(steps[-1], 2)),
        x_ticks=steps,
        y_limits=figures.span([0.0, *values, *(level for level, _ in levels)]),
        levels=levels,
        width=WIDTH,
        height=230,
    )


def repetitions(v: Validation, factor: float, unit: str) -> Markup:
    """Error of each repetition, and the range of the prediction with the recorded inputs and with larger ones."""
    number = list(range(1, len(v.long_run.rms) + 1))
    ends = (0.6, number[-1] + 0.4)
    rms = plain([value * factor for value in v.long_run.rms])
    reach = [plain(list(values)) for values in v.long_run.reach]
    known = [value for line in reach for value in line if value is not None]
    return figures.chart(
        [Curve(number, rms, "series0 dots")],
        y=labelled("RMS", unit),
        x_limits=ends,
        x_ticks=number,
        y_limits=figures.span([0.0, *rms]),
        width=WIDTH,
        height=100,
    ) + figures.chart(
        [Curve(number, values, f"series{i} dots") for i, values in enumerate(reach)],
        x="repetition",
        y="reach [½ range]",
        x_limits=ends,
        x_ticks=number,
        y_limits=(0.0, min(1.1 * max(known, default=2.0), 2 * LEASH)),
        width=WIDTH,
        height=130,
    )


def ranges(judged: Judged) -> dict:
    """A row per signal and record."""
    return {"ranges": bars(judged)}


def bars(judged: Judged) -> list[tuple[str, list[dict]]]:
    """(signal with unit, a bar for each record): the ranges of training and of the record, in per cent of the axis."""
    found = []
    for (signal, unit), ranges in groupby(judged.ranges, key=lambda r: (r.signal, r.unit)):
        group = list(ranges)
        low, high = min(r.low for r in group), max(r.high for r in group)
        factor, name = display(unit, max(abs(low), abs(high)))
        width = high - low or 1.0
        row = [
            {
                "record": r.record,
                "trained": (100 * (r.trained[0] - low) / width, 100 * (r.trained[1] - r.trained[0]) / width),
                "covered": (100 * (r.low - low) / width, 100 * (r.high - r.low) / width),
                "text": f"{number(r.low * factor)} to {number(r.high * factor)}",
                "outside": 100 * r.outside,
                "learnt": r.record in judged.training,
            }
            for r in group
        ]
        found.append((labelled(signal, name), row))
    return found
