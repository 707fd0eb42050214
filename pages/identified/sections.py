"""The sections of the page, each named as the template that it fills in."""

import math

import numpy as np
from markupsafe import Markup

from greygate.identify.files import Identified, IdentifiedFacts, lines
from greygate.identify.tried import Tried
from greygate.models.network import Network
from greygate.pages import figures as drawing
from greygate.pages.figures import Curve
from greygate.pages.units import display, labelled, per_cent, shown
from greygate.pages.zoomable import Trace, curves, share

DOT = 1e-6  # half the length of the stroke that is a model, of where it stands
FIRST = 12  # models in the table, before the others are unfolded
COLOURS = ("float", "cost", "extra")  # of the chosen model, the next one and the best linear one


def head(found: Identified, told: IdentifiedFacts) -> dict:
    """Headline, what to do, models, error against weights and against order."""
    reach = told["chosen"]["held_out"]
    rows = [
        {
            **row,
            "error": "∞" if row["held_out"] is None else shown(row["held_out"], told["unit"], reach),
            "chosen": row["model"] == told["chosen"]["model"],
        }
        for row in told["models"]
    ]
    said = lines(told)
    after = next(i for i, line in enumerate(said) if line.startswith("chosen: "))
    remarks = [line for seen in told["recordings"].values() for line in seen["remarks"]]
    return {
        "output": found.task.output.name,
        "inputs": [p.name for p in found.task.inputs],
        "facts": facts(found, told),
        "remarks": [*remarks, *said[after + 1 :]],
        "first": rows[:FIRST],
        "others": rows[FIRST:],
        "unit": display(told["unit"], reach)[1] or "1",
        "weighed": [(over, weighed(found, told, over)) for over in ("weights", "order")],
    }


def facts(found: Identified, told: IdentifiedFacts) -> list[tuple[str, str, bool | None]]:
    """The headline: (value, its meaning, whether it is good, or None)."""
    chosen, unit = told["chosen"], told["unit"]

    def size(value: float) -> str:
        return f"{shown(value, unit, value)} {display(unit, value)[1]}"

    rows: list[tuple[str, str, bool | None]] = [
        (f"{per_cent(chosen['fit'])} %", f"fit of what was held out, {chosen['model']}", None),
        (size(chosen["held_out"]), "RMS in free run, held out", None),
    ]
    if (line := straight(found)) is not None:
        rows.append((size(line.error), f"of the best linear model, {line.model.name}", None))
    for name, error in told["test"].items():
        rows.append(("diverges" if error is None else size(error), f"on {name}, which chose nothing", None))
    rows.append((str(chosen["parameters"]), f"weights; {told['tried']} models tried", None))
    return rows


def straight(found: Identified) -> Tried | None:
    """The best linear model."""
    return next((t for t in found.search.finalists() if t.model.form.linear and math.isfinite(t.error)), None)


def weighed(found: Identified, told: IdentifiedFacts, over: str) -> Markup:
    """Error held out: of linear models, networks, and the chosen one, where it is below the mean's.

    over: "weights", or "order", which is that of the past outputs or of the states.
    """
    factor, unit = display(told["unit"], told["chosen"]["held_out"])
    dots = []
    for row, tried in zip(told["models"], found.search.finalists(), strict=True):
        kind = "chosen" if tried is found.chosen else "straight" if tried.model.form.linear else "bent"
        if kind == "chosen" or (row["fit"] is not None and row["fit"] > 0):
            x = row["parameters"] if over == "weights" else tried.model.orders.order
            y = row["held_out"] * factor
            dots.append(Curve([x * (1 - DOT), x * (1 + DOT)], [y, y], f"dot {kind}"))
    log = over == "weights"
    limits = drawing.span([v for dot in dots for v in dot.x], log=log)
    label = labelled("held out, RMS", unit)
    return drawing.chart(dots, x=over, y=label, x_log=log, y_log=True, x_limits=limits, width=570, height=260)


def runs(found: Identified, told: IdentifiedFacts) -> dict:
    """Measured and predicted by the best three, over each recording and test."""
    named = {"chosen": found.network, **others(found)}
    records = dict(found.task.records) | {n: found.task.record(r) for n, r in found.tests.items()}
    output = found.task.output
    drawn, points = [], share(len(records) * (len(named) + 2))
    for name, record in records.items():
        y = np.asarray(record.targets[output.name])
        factor, unit = display(output.unit, float(np.abs(y).max()))
        traces = {"measured": Trace(y * factor, "reference", 3.0)}
        for (label, network), colour in zip(named.items(), COLOURS, strict=False):
            traces[label] = Trace((y + _padded(found, network, name, len(y))) * factor, colour)
        traces["error"] = Trace(_padded(found, found.network, name, len(y)) * factor, "fixed", 1.2, below=True)
        labels = (labelled(output.name, unit), labelled("error", unit))
        drawn.append((name, curves(traces, found.network.dt or 1.0, labels, points)))
    keys = list(zip(named, COLOURS, strict=False))
    longest = max(len(r) for r in records.values())
    return {"runs": drawn, "keys": keys, "samples": longest, "drawn": points, "output": output.name}


def others(found: Identified) -> dict[str, Network]:
    """The next best model, and the best linear one, as their first fold left them."""
    ranked = [t for t in found.search.finalists() if t is not found.chosen and math.isfinite(t.error)]
    next_best, line = ranked[:1], straight(found)
    picked = [*next_best, *([line] if line and line not in (found.chosen, *next_best) else [])]
    return {t.model.name: t.first for t in picked}


def _padded(found: Identified, network: Network, name: str, length: int) -> np.ndarray:
    """Errors (length,) of a free run, NaN where they do not count or the run diverges."""
    recordings = found.task.records
    record = recordings[name] if name in recordings else found.task.record(found.tests[name])
    errors = found.task.errors(network, record)
    whole = np.full(length, np.nan)
    if errors is not None:
        whole[length - len(errors) :] = errors
    return whole
