"""The sections of the page, each named as the template that it fills in; one whose context is None is left out."""

import math

import numpy as np
from markupsafe import Markup

from greygate.identify.trained import Evidence
from greygate.models.adaptation import weight_changes
from greygate.models.residuals import asks_for
from greygate.pages import figures as drawing
from greygate.pages.figures import Curve
from greygate.pages.units import NONE, display, labelled, shown
from greygate.pages.validation.sections import label, stems

SERIES = 5  # colours of style.html; the starts beyond them share


def head(figures: dict, evidence: Evidence) -> dict:
    """Headline, errors, starts, curves by epoch."""
    starts, rows = figures["starts"], errors(figures, evidence)
    return {
        "network": evidence.after.name,
        "facts": facts(figures, rows),
        "remarks": figures["remarks"],
        "errors": rows,
        "starts": starts,
        "loss": by_epoch(starts, "history", "loss J"),
        "held": by_epoch(starts, "held", "held out, RMS") if any(s["held"] for s in starts) else None,
        "series": SERIES,
    }


def facts(figures: dict, rows: list[dict]) -> list[tuple[str, str, bool | None]]:
    """The headline: (value, its meaning, whether it is good, or None). rows: of `errors`."""
    worst = max(rows, key=lambda row: row["normalised"])
    than = "" if worst["linear"] == NONE else f"; {worst['linear']} of a linear model"
    error = f"RMS in free run of {worst['output']} on {worst['record']}{than}"
    found: list[tuple[str, str, bool | None]] = [(f"{worst['rms']} {worst['unit']}".removesuffix(" 1"), error, None)]
    ended = False if figures["outcome"] == "diverged" else None
    found.append((f"{figures['epochs']} epochs", f"{figures['sentence']} {figures['seconds']:.3g} s", ended))
    if (held := figures["starts"][0]["held_out"]) is not None:
        found.append((f"{held:.3g}", "RMS on what was held out, normalised", None))
    if len(figures["starts"]) > 1:
        found.append((f"{len(figures['starts'])} starts", "what was held out chose one", None))
    if figures["settle"]:
        found.append((f"{figures['settle']} samples", "at first of each recording give only its initial state", None))
    return found


def errors(figures: dict, evidence: Evidence) -> list[dict]:
    """A row for each record and output: RMS in free run, also over the port's scale, and that of a linear model."""
    units = {p.name: p.unit for p in evidence.after.outputs}
    scales = {p.name: p.scale for p in evidence.after.outputs}
    rows = []
    for record, outputs in figures["rmse"].items():
        for output, value in outputs.items():
            linear = figures["linear"].get(record, {}).get(output)
            reach = value or linear or 0.0
            rows.append(
                {
                    "record": record,
                    "output": output,
                    "normalised": math.inf if value is None else value / scales[output],
                    "rms": "∞" if value is None else shown(value, units[output], reach),
                    "linear": shown(linear, units[output], reach),
                    "unit": display(units[output], reach)[1] or "1",
                }
            )
    return rows


def by_epoch(starts: list[dict], what: str, label: str) -> Markup:
    """A curve for each start, the chosen one above the others."""
    lines = []
    for i, start in reversed(list(enumerate(starts))):
        values = [v if v is not None and math.isfinite(v) and v > 0 else None for v in start[what]]
        lines.append(Curve(list(range(len(values))), values, f"series{i % SERIES} dots{'' if i else ' chosen'}"))
    return drawing.chart(lines, x="epoch", y=label, y_log=True, width=570, height=230)


WIDTH, HEIGHT = 285, 250  # px
DOT = 1e-3  # half the length of the stroke that is a pole
POLES = 12  # poles in the table


def dynamics(figures: dict, evidence: Evidence) -> dict | None:
    """None where the free run diverges, and there is no point to linearise about."""
    if evidence.about is None:
        return None
    poles = evidence.about.poles()
    return {
        "poles": [_row(p, evidence.period) for p in poles[:POLES]],
        "more": max(len(poles) - POLES, 0),
        "plane": _plane(poles),
        "responses": _responses(evidence),
    }


def _row(pole: complex, period: float) -> dict:
    size = abs(pole)
    rate = np.log(complex(pole)) / period
    return {
        "pole": f"{pole.real:.4f}" + (f" {'+' if pole.imag > 0 else '−'} {abs(pole.imag):.4f}i" if pole.imag else ""),
        "size": size,
        "time": -1 / rate.real if size < 1 else None,
        "hertz": abs(rate.imag) / (2 * np.pi) if pole.imag else None,
        "stable": size < 1,
    }


def _plane(poles: np.ndarray) -> Markup:
    turn = np.linspace(0, 2 * np.pi, 100)
    reach = max(1.1, 1.1 * np.abs(poles).max(initial=0.0))
    lines = [Curve(np.cos(turn), np.sin(turn), "circle")]
    lines += [Curve([p.real - DOT, p.real + DOT], [p.imag, p.imag], "pole") for p in poles]
    limits = (-reach, reach)
    return drawing.chart(lines, x="real", y="imaginary", x_limits=limits, y_limits=limits, width=WIDTH, height=HEIGHT)


def _responses(evidence: Evidence) -> list[tuple[str, Markup, Markup]]:
    """(pair, picture of the magnitude, picture of the phase)."""
    frequency = evidence.frequency
    found = evidence.about.response(frequency, evidence.period) if evidence.about else np.zeros((0, 0, 0))
    pictures = []
    for o, output in enumerate(evidence.after.outputs):
        for u, drive in enumerate(evidence.after.inputs):
            size = np.abs(found[:, o, u])
            phase = np.degrees(np.unwrap(np.angle(found[:, o, u])))
            unit = labelled("magnitude", f"{output.unit}/{drive.unit}" if output.unit != drive.unit else "")
            seen = [float(v) if v > 0 else None for v in size]
            magnitude = drawing.chart(
                [Curve(frequency, seen, "model")], y=unit, x_log=True, y_log=True, width=WIDTH, height=150
            )
            angle = drawing.chart(
                [Curve(frequency, phase, "model")],
                x="frequency [Hz]",
                y="phase [°]",
                x_log=True,
                width=WIDTH,
                height=170,
            )
            pictures.append((f"{output.name} from {drive.name}", magnitude, angle))
    return pictures


LEAST = 20  # weights in the table of the least known ones
KNOWN = 2.0  # deviations that a weight must be off zero to be known at all


def weights(figures: dict, evidence: Evidence) -> dict:
    """A picture of all changes, the largest as a table, and the least known weights."""
    found = sorted(evidence.weights.items(), key=lambda w: abs(w[1][0]) / w[1][1] if w[1][1] else math.inf)
    rows = [
        {"name": n, "value": v, "deviation": s if math.isfinite(s) else None, "known": abs(v) > KNOWN * s}
        for n, (v, s) in found
    ]
    return {
        "picture": drawing.weight_changes(weight_changes(evidence.before, evidence.after)),
        "moved": evidence.moved(),
        "least": rows[:LEAST],
        "all": len(rows),
        "unknown": sum(not row["known"] for row in rows),
    }


def residuals(figures: dict, evidence: Evidence) -> dict | None:
    """None where nothing could be tested."""
    groups = [
        (record, output, [(t, label(t), stems(t), "" if t.passed else asks_for(t, output)) for t in tests])
        for (record, output), tests in evidence.tests.items()
    ]
    return {"groups": groups} if groups else None
