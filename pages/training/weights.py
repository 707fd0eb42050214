"""The weights: which moved most, and how well the recordings determine each."""

import math

from greygate.identify.trained import Evidence
from greygate.models.adaptation import weight_changes
from greygate.pages import figures as drawing

SHOWN = 20  # weights in the table of the least known ones
KNOWN = 2.0  # deviations that a weight must be off zero to be known at all


def context(figures: dict, evidence: Evidence) -> dict:
    """A picture of all changes, the largest as a table, and the least known weights."""
    found = sorted(evidence.weights.items(), key=lambda w: abs(w[1][0]) / w[1][1] if w[1][1] else math.inf)
    rows = [
        {"name": n, "value": v, "deviation": s if math.isfinite(s) else None, "known": abs(v) > KNOWN * s}
        for n, (v, s) in found
    ]
    return {
        "picture": drawing.weight_changes(weight_changes(evidence.before, evidence.after)),
        "moved": evidence.moved(),
        "least": rows[:SHOWN],
        "all": len(rows),
        "unknown": sum(not row["known"] for row in rows),
    }
