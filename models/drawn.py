"""Curves with fewer points and digits, which look the same when they are drawn."""

from itertools import pairwise

import numpy as np

BINS = 400  # of the drawing of a complete run; each shows its least and its largest value


def envelope(values: np.ndarray, bins: int = BINS) -> dict[str, list]:
    """Least and largest value of each bin, in the order in which they come: {"step": [...], "value": [...]}."""
    edges = np.unique(np.linspace(0, len(values), min(bins, len(values)) + 1).astype(int))
    steps = []
    for a, b in pairwise(edges):
        part = values[a:b]
        steps += sorted({a + int(np.argmin(part)), a + int(np.argmax(part))})
    return {"step": steps, "value": shortened(values[steps])}


def shortened(values: np.ndarray) -> list[float]:
    """Round to six significant digits, which are enough for drawing and take half the bytes."""
    return [float(f"{v:.6g}") for v in values]
