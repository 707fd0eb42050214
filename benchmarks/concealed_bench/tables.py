"""The figures of a tool over all cases: tables, rows, and how far its confidence can be believed."""

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path

import numpy as np

from greygate.mismatch.concealed.conceal import EVERY_RIG
from greygate.mismatch.concealed.stress import CONDITIONS

from .score import SURE, Score

HALF = 0.5  # of the error: an effect that removes so much of it is to be found
WORSE = 1.01  # times the calibrated simulation's error in one channel: a correction beyond it does harm
QUIET = ("clean", "parameter")
LABEL, CELL = 36, 20  # characters of the table's columns
PLACES = 3  # behind the point, of a figure in it
BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)  # of confidence


def _share(rows: Sequence, test: Callable[[object], object]) -> dict:
    return {"of": len(rows), "count": sum(bool(test(row)) for row in rows)}


def summary(scores: Sequence[Score]) -> dict:
    """Every figure of the table, of all cases, under each condition, of each plant: {"of", "count"} or a number."""
    naming = any(s.claims or s.verdict for s in scores)
    return {"all": figures(scores, naming)} | {
        name: figures(part, naming)
        for name in (*CONDITIONS, *EVERY_RIG)
        if (part := [s for s in scores if name in (s.condition, s.plant)])
    }


def figures(scores: Sequence[Score], naming: bool = True) -> dict:
    """The figures of some cases. A case in which the tool failed is one that it did not explain.

    naming: whether the tool gives names or verdicts at all; without, only its predictions count.
    """
    ran = [s for s in scores if not s.error]
    speaking = scores if naming else []
    one = [s for s in speaking if s.kind == "one"]
    foreign = [s for s in speaking if s.kind == "foreign"]
    removed = [s.removed for s in ran if s.removed is not None]
    predicted = [s for s in ran if s.worse is not None and s.verdict != "consistent"]
    bare = [s for s in predicted if not s.corrects]
    typical = np.median(removed) if removed else np.nan
    return {
        "cases": len(scores),
        "errors": _share(scores, lambda s: s.error),
        "wrong names": _share([c for s in ran for c in s.claims], lambda c: not c[2]),
        "surely wrong names": _share([c for s in ran for c in s.claims], lambda c: not c[2] and (c[1] or 0.0) >= SURE),
        "cases with a surely wrong name": _share([s for s in speaking if not s.error], lambda s: s.surely_wrong),
        "clean rigs with a claim": _share([s for s in speaking if s.kind in QUIET and not s.error], lambda s: s.wrong),
        "right first, strong single effects": _share([s for s in one if s.removable >= HALF], lambda s: s.first),
        "right first, single effects": _share(one, lambda s: s.first),
        "all named, two effects": _share([s for s in speaking if s.kind == "two"], lambda s: s.all),
        "effect and parameter": _share([s for s in speaking if s.kind == "both"], lambda s: s.all and s.parameter),
        "parameter found": _share([s for s in speaking if s.kind == "parameter"], lambda s: s.parameter),
        "fault of the recording named": _share([s for s in speaking if s.fault is not None], lambda s: s.fault),
        "foreign, not explained": _share(foreign, lambda s: s.verdict in ("unexplained", "partly_explained")),
        "foreign, and right equation": _share(
            foreign, lambda s: s.verdict in ("unexplained", "partly_explained") and s.where
        ),
        "inside 95 % intervals": _share([i for s in ran for i in s.inside], bool),
        "corrections worse than calibrated": _share(predicted, lambda s: s.worse > WORSE),
        "of these, with nothing added": _share(bare, lambda s: s.worse > WORSE),
        "worse than the concealed machine, too": _share(predicted, lambda s: s.harms is not None and s.harms > WORSE),
        "median removed": float(typical) if np.isfinite(typical) else None,
        "median seconds": float(np.median([s.seconds for s in ran])) if ran else None,
        "worst seconds": max((s.seconds for s in scores), default=None),
    }


def reliability(scores: Sequence[Score]) -> list[dict]:
    """By confidence: how many claims, how many of them right."""
    claims = [(c, right) for s in scores if not s.error for _, c, right in s.claims if c is not None]
    return [
        {"from": low, "to": high, "claims": len(part), "right": sum(part)}
        for low, high in pairwise(BINS)
        for part in [[right for c, right in claims if low <= c < high or (high == 1.0 and c == 1.0)]]
    ]


def show(value: object) -> str:
    """A figure in words: "12 of 13, 92 %"."""
    if isinstance(value, dict):
        return f"{value['count']} of {value['of']}, {value['count'] / value['of']:.0%}" if value["of"] else "-"
    return "-" if value is None else f"{round(value, PLACES) + 0.0:.4g}" if isinstance(value, float) else str(value)


BY_CONDITION = (
    "errors", "surely wrong names", "clean rigs with a claim", "right first, strong single effects",
    "inside 95 % intervals", "corrections worse than calibrated",
)  # fmt: skip
BY_PLANT = ("errors", "right first, single effects", "median removed", "median seconds")


def lines(tools: Mapping[str, Mapping[str, Mapping]]) -> list[str]:
    """The table as text, a column for each tool: all cases first, then what differs most by condition and by plant.

    tools: name -> its `summary`.
    """

    def row(label: str, cells: Sequence[object]) -> str:
        return f"{label:{LABEL}}" + "".join(f"{show(cell):>{CELL}}" for cell in cells)

    first = next(iter(tools.values()))
    out = [row("", [name[-CELL + 1 :] for name in tools])]
    out += [row(name, [found["all"][name] for found in tools.values()]) for name in first["all"]]
    parts = [(name, CONDITIONS, "condition") for name in BY_CONDITION] + [
        (name, EVERY_RIG, "plant") for name in BY_PLANT
    ]
    for name, groups, what in parts:
        out += ["", f"{name}, by {what}"]
        for group in groups:
            cells = [found.get(group, {}).get(name) for found in tools.values()]
            out += [row(f"  {group}", cells)] if any(cells) else []
    return [line.rstrip() for line in out]


def write_rows(scores: Sequence[Score], path: Path) -> None:
    """One line a case."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(asdict(scores[0]))
        for s in scores:
            claims = (f"{n} {'-' if c is None else c}{'' if right else ' WRONG'}" for n, c, right in s.claims)
            row = asdict(s) | {
                "concealed": "+".join(s.concealed),
                "claims": "; ".join(claims),
                "inside": f"{sum(s.inside)} of {len(s.inside)}",
            }
            writer.writerow(f"{v:.4g}" if isinstance(v, float) else v for v in row.values())
