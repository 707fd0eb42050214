"""The section on the ranges of the training records, and on how far each record exceeds them."""

from itertools import groupby

from greygate.pages.units import display, labelled, number
from greygate.pages.validation.judged import Judged


def context(judged: Judged) -> dict:
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
