"""What `greygate validate` finds, as a table, as JSON and as one HTML page. How to read it: docs/validation.md."""

import base64
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from html import escape
from itertools import groupby, pairwise
from pathlib import Path

import numpy as np
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from greygate.errors import InputError
from greygate.files import replacing
from greygate.machines.catalog import CATALOG, entry
from greygate.machines.identification import initialised
from greygate.models.validation import LEASH, Correlation, Range, Validation, coverage, validate
from greygate.pages import figures
from greygate.pages.figures import Line
from greygate.pages.report import TRUSTED, display, plain, shown, templates
from greygate.project import Source

DRAWN = 20_000  # samples of a run that are drawn one by one; of a longer one, least and largest of so many bins
BARS = 40  # of the error's histogram
SYMBOLS = {"phi_ee": "φ(e, e)", "phi_ue": "φ({}, e)", "phi_u2e": "φ({}², e)", "phi_u2e2": "φ({}², e²)",
           "phi_eeu": "φ(e·{}, e)"}  # fmt: skip
LINEAR = ("phi_ee", "phi_ue")


@dataclass(frozen=True)
class Judged:
    """One network on its records. training: those that it learnt from. period: s."""

    title: str
    name: str
    parameters: int
    period: float
    training: tuple[str, ...]
    validations: list[Validation]
    ranges: list[Range]

    @property
    def bounded(self) -> bool:
        return all(v.bounded for v in self.validations)

    def figures(self) -> dict:
        """JSON-able: SI units, None for what is not finite; signals are left out."""
        found = {k: getattr(self, k) for k in ("title", "name", "parameters", "period", "training", "bounded")}
        found["outputs"] = [v.figures() for v in self.validations]
        return plain(found | {"ranges": [asdict(r) for r in self.ranges]})


def judge(source: Source, lags: int = 25, progress: Callable[[str], None] | None = None) -> Judged:
    """Validate a network of the catalogue, or a file, on its records. Raises InputError as `validate` and `Source`.

    A network of the catalogue is judged on what it learnt from too, if recordings are given; any other is taken to have
    learnt from the first one.
    """
    network, records, training = source.network(), source.records(), source.training
    if source.name in CATALOG and source.recordings:
        training, own = entry(source.name).training, entry(source.name).records()
        if taken := set(training) & set(records):
            raise InputError(f"record {min(taken)}: {source.name} learnt from one of that name; name yours otherwise")
        records = {n: own[n] for n in training} | records
    records = {name: initialised(network, record) for name, record in records.items()}
    validations = validate(network, records, period=source.period, lags=lags, progress=progress)
    size = sum(v.size for v in network.flatten().parameters().values())
    ranges = coverage(network, records, training)
    return Judged(source.title, network.name, size, source.period, training, validations, ranges)


def tally(tests: Sequence[Correlation] | None) -> str:
    """`4/5` of the tests passed."""
    return "–" if tests is None else f"{sum(t.passed for t in tests)}/{len(tests)}"


def per_cent(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:.1f}".replace("-", "−")


def long_run(v: Validation) -> str:
    return "unbounded" if not v.bounded else "stable" if v.long_run.stable else "drifts"


def rows(judged: Judged) -> list[dict]:
    """What stands in the table, by column, a row per record and output."""
    found = []
    for v in judged.validations:
        reach = v.rms if math.isfinite(v.rms) else v.spread
        ahead = {k: per_cent(v.ahead[k][1] if k in v.ahead else None) for k in (1, 10)}
        found.append(
            {
                "record": v.record + ("*" if v.record in judged.training else ""),
                "output": v.output,
                "std": shown(v.spread, v.unit, reach),
                "RMS": shown(v.rms, v.unit, reach) if math.isfinite(v.rms) else "∞",
                "unit": display(v.unit, reach)[1] or "1",
                "fit %": per_cent(v.fit),
                "1 step": ahead[1],
                "10 steps": ahead[10],
                "free run": tally(v.tests.get("free run")),
                "one step": tally(v.tests.get("one step ahead")),
                "long run": long_run(v),
            }
        )
    return found


def table(judged: Judged) -> list[str]:
    """Lines for a terminal."""
    found = rows(judged)
    names = list(found[0])
    widths = {n: max(len(n), *(len(r[n]) for r in found)) for n in names}
    left = ("record", "output", "unit", "long run")

    def line(cells: dict) -> str:
        return "  ".join(f"{cells[n]:{'<' if n in left else '>'}{widths[n]}}" for n in names).rstrip()

    sentences = {
        "*": "* learnt from this record",
        "fits": "fit %: free run; 1 step, 10 steps: fit % of the prediction that far ahead from what was measured",
        "tests": "free run, one step: residual tests passed; long run: ten times the record, inputs to 1.2 times",
    }
    return [judged.title, line({n: n for n in names}), *(line(r) for r in found), *sentences.values()]


def write(judged: Judged, path: Path | str) -> None:
    """Write the page, whole or not at all. Raises InputError where the folder cannot be written."""
    text = page(judged)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def page(judged: Judged) -> str:
    """One HTML page that needs nothing else: styles, pictures (SVG), and Plotly for the runs that can be zoomed."""
    records = {
        name: [(v, pictures(v, judged.period)) for v in group]
        for name, group in groupby(judged.validations, key=lambda v: v.record)
    }
    template = templates().get_template("validation.html")
    return template.render(
        j=judged,
        rows=rows(judged),
        facts=facts(judged),
        records=records,
        ranges=range_picture(judged),
        plotly=Markup(get_plotlyjs()),
        long_run=long_run,
        drawn=DRAWN,
    )


def facts(judged: Judged) -> list[tuple[str, str, bool | None]]:
    """The headline: (value, what it is, good or bad or neither)."""
    fresh = [v for v in judged.validations if v.record not in judged.training] or judged.validations
    worst = min(fresh, key=lambda v: v.fit if not math.isnan(v.fit) else math.inf)
    where = f"{worst.output} on {worst.record}"
    fit = f"{per_cent(worst.fit)} %" if math.isfinite(worst.rms) else "diverges"
    lines = [(fit, f"worst fit of a free run, {where}", None)]
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


def label(test: Correlation) -> str:
    kind, _, name = test.name.partition(" ")
    return SYMBOLS[kind].format(name)


# ---- pictures


def pictures(v: Validation, period: float) -> dict:
    """Every drawing of one output on one record."""
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
        "run": run_data(v, period),
        "histogram": histogram(residual * small, small_unit) if math.isfinite(v.rms) else "",
        "response": response(v.response) if v.response else "",
        "ahead": ahead(v, small, small_unit) if v.ahead else "",
        "long_run": repetitions(v, small, small_unit),
        "tests": tests,
    }


def run_data(v: Validation, period: float) -> dict:
    """What Plotly draws: measured, predicted and error over time, JSON-able, with binary float32.

    Plotly takes labels as HTML, so they are escaped; the template's `tojson` then keeps them inside <script>.
    """
    factor, unit = display(v.unit, float(np.abs(v.measured).max()))
    small, small_unit = display(v.unit, v.rms if math.isfinite(v.rms) else v.spread)
    leash = np.mean(v.measured) + LEASH * (np.ptp(v.measured) or np.inf) * np.array(
        [-1, 1]
    )  # a run that diverges is drawn so far
    near = np.where((v.predicted > leash[0]) & (v.predicted < leash[1]), v.predicted, np.nan)
    traces = {"measured": v.measured * factor, "predicted": near * factor, "error": (v.measured - near) * small}
    drawn = {}
    for name, y in traces.items():
        steps = _thinned(y)
        time = {"x0": 0.0, "dx": period} if len(steps) == len(y) else {"x": _binary(steps * period)}
        drawn[name] = {"y": _binary(y[steps])} | time
    labels = {
        "y": f"{v.output} [{unit}]" if unit else v.output,
        "error": f"error [{small_unit}]" if small_unit else "error",
    }
    return {"traces": drawn, "labels": {axis: escape(label, quote=False) for axis, label in labels.items()}}


def _thinned(y: np.ndarray) -> np.ndarray:
    """Samples to draw: all, or where each of DRAWN / 2 bins has its least and its largest value."""
    if len(y) <= DRAWN:
        return np.arange(len(y))
    edges = np.linspace(0, len(y), DRAWN // 2 + 1).astype(int)
    y = np.nan_to_num(y)
    bins = ((a, y[a:b]) for a, b in pairwise(edges))
    return np.unique([a + k for a, part in bins for k in (part.argmin(), part.argmax())])


def _binary(values: np.ndarray) -> dict:
    return {"dtype": "f4", "bdata": base64.b64encode(np.asarray(values, "<f4").tobytes()).decode()}


def histogram(error: np.ndarray, unit: str) -> Markup:
    """Share of samples by error, and the Gaussian of the same mean and deviation."""
    counts, edges = np.histogram(error, BARS)
    share = counts / counts.sum()
    x, y = np.repeat(edges, 2), np.r_[0, np.repeat(share, 2), 0]
    mean, deviation = np.mean(error), np.std(error)
    at = np.linspace(edges[0], edges[-1], 120)
    normal = (
        np.exp(-0.5 * ((at - mean) / deviation) ** 2) / (deviation * math.sqrt(2 * math.pi)) if deviation else 0 * at
    )
    lines = [Line(x, 100 * y, "bars"), Line(at, 100 * normal * (edges[1] - edges[0]), "normal")]
    return figures.chart(lines, x=f"error [{unit}]" if unit else "error", y="samples [%]", width=285, height=230)


def stems(test: Correlation) -> Markup:
    """Coefficients over lag, those outside the band in red; bands dashed, the thesis's 1.96/sqrt(N) dotted."""
    beyond = np.abs(test.values) > test.band
    ends = [float(test.lags[0]) - 1, float(test.lags[-1]) + 1]
    lines = []
    for kind, which in (("inside", ~beyond), ("beyond", beyond)):
        x = [v for lag in test.lags[which] for v in (lag, lag, None)]
        y = [v for value in test.values[which] for v in (0.0, value, None)]
        lines.append(Line(x, y, f"stem {kind}"))
    for level, kind in ((test.plain, "plain"), (test.band, "band")):
        if kind == "band" or test.band > 1.02 * test.plain:
            lines += [Line(ends, [sign * level] * 2, kind) for sign in (-1, 1)]
    reach = 1.15 * max(np.abs(test.values).max(), test.band)
    return figures.chart(
        lines,
        x="lag [steps]",
        x_limits=tuple(ends),
        y_limits=(-reach, reach),
        levels=[(0.0, "")],
        width=285,
        height=160,
    )


def response(found: dict) -> Markup:
    """Magnitude and phase of Y_hat/Y where the coherence says that they mean something, and the coherence."""
    frequency, found = (plain(v) for v in (found["frequency"], found))
    sure = [c is not None and c >= TRUSTED for c in found["coherence"]]
    limits = figures.span(frequency, log=True, margin=0)

    def panel(part: str, y: str, low: float, high: float, **options) -> Markup:
        values = found[part]
        if part != "coherence":
            values = [v if ok else None for v, ok in zip(values, sure, strict=True)]
        known = [v for v in values if v is not None]
        reach = figures.span([*np.percentile(known, (2, 98)), low, high]) if known else (low, high)
        rest = [] if part == "coherence" else [((low + high) / 2, "")]
        line = Line(frequency, values, "response")
        return figures.chart(
            [line], y=y, x_log=True, x_limits=limits, y_limits=reach, levels=rest, width=285, **options
        )

    return (
        panel("magnitude", "|Ŷ/Y|", 0.9, 1.1, height=72)
        + panel("phase", "phase [°]", -10, 10, height=68)
        + panel("coherence", "coherence", 0, 1, x="frequency [Hz]", height=90)
    )


def ahead(v: Validation, factor: float, unit: str) -> Markup:
    """RMS over the horizon; the level is the free run's."""
    steps = list(v.ahead)
    values = plain([rms * factor if math.isfinite(rms) else None for rms, _ in v.ahead.values()])
    levels = [(v.rms * factor, "")] if math.isfinite(v.rms) else []
    return figures.chart(
        [Line(steps, values, "series0 dots")],
        x="steps ahead",
        y=f"RMS [{unit}]" if unit else "RMS",
        x_log=True,
        x_limits=(0.9 * steps[0], 1.1 * max(steps[-1], 2)),
        x_ticks=steps,
        y_limits=figures.span([0.0, *values, *(level for level, _ in levels)]),
        levels=levels,
        width=285,
        height=230,
    )


def repetitions(v: Validation, factor: float, unit: str) -> Markup:
    """Error of each repetition, and how far the prediction goes as recorded and with larger inputs."""
    number = list(range(1, len(v.long_run.rms) + 1))
    ends = (0.6, number[-1] + 0.4)
    rms = plain([value * factor for value in v.long_run.rms])
    reach = [plain(list(values)) for values in v.long_run.reach]
    known = [value for line in reach for value in line if value is not None]
    return figures.chart(
        [Line(number, rms, "series0 dots")],
        y=f"RMS [{unit}]" if unit else "RMS",
        x_limits=ends,
        x_ticks=number,
        y_limits=figures.span([0.0, *rms]),
        width=285,
        height=100,
    ) + figures.chart(
        [Line(number, values, f"series{i} dots") for i, values in enumerate(reach)],
        x="repetition",
        y="reach [½ range]",
        x_limits=ends,
        x_ticks=number,
        y_limits=(0.0, min(1.1 * max(known, default=2.0), 2 * LEASH)),
        width=285,
        height=130,
    )


def range_picture(judged: Judged) -> list[tuple[str, list[dict]]]:
    """(signal with unit, a bar per record) in per cent of the axis: what was learnt, and what the record covers."""
    found = []
    for (signal, unit), group in groupby(judged.ranges, key=lambda r: (r.signal, r.unit)):
        group = list(group)
        low, high = min(r.low for r in group), max(r.high for r in group)
        factor, name = display(unit, max(abs(low), abs(high)))
        width = high - low or 1.0
        bars = [
            {
                "record": r.record,
                "trained": (100 * (r.trained[0] - low) / width, 100 * (r.trained[1] - r.trained[0]) / width),
                "covered": (100 * (r.low - low) / width, 100 * (r.high - r.low) / width),
                "text": f"{figures.number(r.low * factor)} to {figures.number(r.high * factor)}",
                "outside": 100 * r.outside,
                "learnt": r.record in judged.training,
            }
            for r in group
        ]
        found.append((f"{signal} [{name}]" if name else signal, bars))
    return found
