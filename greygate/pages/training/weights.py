"""The weights: which moved most, and how well the recordings determine each."""

from greygate.models.adaptation import weight_changes
from greygate.pages import figures as drawing
from greygate.trained import Evidence

SHOWN = 20  # weights in the table of the least known ones
KNOWN = 2.0  # deviations that a weight must be off zero to be known at all


def context(figures: dict, evidence: Evidence) -> dict:
    """A picture of all changes, the largest as a table, and the least known weights."""
    rows = sorted(
        (
            {"name": n, "value": v, "deviation": s, "known": abs(v) > KNOWN * s}
            for n, (v, s) in evidence.weights.items()
        ),
        key=lambda row: abs(row["value"]) / row["deviation"] if row["deviation"] else float("inf"),
    )
    return {
        "picture": drawing.weight_changes(weight_changes(evidence.before, evidence.after)),
        "moved": evidence.moved(),
        "least": [r | {"deviation": r["deviation"] if r["deviation"] < float("inf") else None} for r in rows[:SHOWN]],
        "all": len(rows),
        "unknown": sum(not row["known"] for row in rows),
    }
