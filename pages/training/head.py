"""The head of the page: how the training ended, what was held out, and every start beside the others."""

import math

from markupsafe import Markup

from greygate.identify.trained import Evidence
from greygate.pages import figures as drawing
from greygate.pages.figures import Curve
from greygate.pages.units import display, shown

SERIES = 5  # colours of style.html; the starts beyond them share


def context(figures: dict, evidence: Evidence) -> dict:
    """Headline, errors, starts, curves by epoch."""
    starts = figures["starts"]
    return {
        "network": evidence.after.name,
        "facts": facts(figures),
        "remarks": figures["remarks"],
        "errors": errors(figures, evidence),
        "starts": starts,
        "loss": by_epoch(starts, "history", "loss J"),
        "held": by_epoch(starts, "held", "held out, RMS") if any(s["held"] for s in starts) else None,
        "series": SERIES,
    }


def facts(figures: dict) -> list[tuple[str, str, bool | None]]:
    """The headline: (value, its meaning, whether it is good, or None)."""
    found = [(figures["outcome"], figures["sentence"], figures["outcome"] != "diverged" or None)]
    found = [(v, text, False if v == "diverged" else None) for v, text, _ in found]
    found.append((str(figures["epochs"]), f"epochs, {figures['seconds']:.3g} s", None))
    if (held := figures["starts"][0]["held_out"]) is not None:
        found.append((f"{held:.3g}", "RMS on what was held out, normalised", None))
    if len(figures["starts"]) > 1:
        found.append((str(len(figures["starts"])), "starts; what was held out chose one", None))
    found.append((str(figures["settle"]), "first samples of each recording give only its initial state", None))
    return found


def errors(figures: dict, evidence: Evidence) -> list[dict]:
    """A row for each record and output: RMS in free run, and that of a linear model."""
    units = {p.name: p.unit for p in evidence.after.outputs}
    rows = []
    for record, outputs in figures["rmse"].items():
        for output, value in outputs.items():
            linear = figures["linear"].get(record, {}).get(output)
            reach = value or linear or 0.0
            rows.append(
                {
                    "record": record,
                    "output": output,
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
