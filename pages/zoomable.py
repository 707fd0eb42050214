"""Curves over time that a reader can zoom: the data that `zoomable.html` hands to Plotly."""

import base64
import gzip
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise

import numpy as np

LEVELS, MOMENTS = 1023, 65535  # of a curve from its least to its largest value, and of its times: several in a pixel
DRAWN = 20_000  # points of a curve, beside other drawings; a longer one is drawn by least and largest of bins
POINTS = 120_000  # of all curves of a page: of noise, at uneven times, they are half a megabyte


@dataclass(frozen=True)
class Trace:
    """A curve: values (n,) in the unit of its label. colour: a variable of style.html. below: on the axis below.

    time: of its samples [s], where they are not those of the other curves.
    """

    values: np.ndarray
    colour: str
    width: float = 1.3
    below: bool = False
    time: np.ndarray | None = None


def share(curves: int, most: int = DRAWN) -> int:
    """Points of each of so many curves of a page: at least the two of one bin."""
    return max(2, min(most, POINTS // max(curves, 1)))


def curves(traces: Mapping[str, Trace], time: float | np.ndarray, labels: Sequence[str], most: int = DRAWN) -> dict:
    """What Plotly draws, JSON-able, numbers `packed`. time: the step [s], or the time of each sample [s]. most: points.

    labels: of the axis, and of the axis below where there is one. Plotly takes them as HTML, so they are escaped; the
    template's `tojson` then keeps them inside <script>.
    """
    drawn = {
        name: _placed(trace.values, time if trace.time is None else trace.time, most)
        | {"colour": trace.colour, "width": trace.width, "below": trace.below}
        for name, trace in traces.items()
    }
    return {"traces": drawn, "labels": [escape(label, quote=False) for label in labels]}


def thinned(y: np.ndarray, most: int) -> np.ndarray:
    """Indices of the samples to draw: all, or those of the least and largest value of each of most / 2 bins."""
    if len(y) <= most:
        return np.arange(len(y))
    edges = np.linspace(0, len(y), most // 2 + 1).astype(int)
    y = np.nan_to_num(y)
    bins = ((a, y[a:b]) for a, b in pairwise(edges))
    return np.unique([a + k for a, part in bins for k in (part.argmin(), part.argmax())])


def _placed(y: np.ndarray, time: float | np.ndarray, most: int) -> dict:
    steps = thinned(y, most)
    if isinstance(time, np.ndarray):
        return {"y": packed(y[steps]), "x": packed(time[steps], MOMENTS)}
    whole = {"x0": 0.0, "dx": time} if len(steps) == len(y) else {"x": packed(steps * time, MOMENTS)}
    return {"y": packed(y[steps])} | whole


def packed(values: np.ndarray, gap: int = LEVELS) -> dict:
    """Numbers as so many levels of their range, one difference after another; what is not finite is level `gap`."""
    finite = np.isfinite(values)
    low, high = (values[finite].min(), values[finite].max()) if finite.any() else (0.0, 0.0)
    step = float(high - low) / (gap - 1) or 1.0
    levels = np.full(len(values), gap, np.uint16)
    levels[finite] = np.round((values[finite] - low) / step)
    planes = np.diff(levels, prepend=np.uint16(0)).astype("<u2").view(np.uint8).reshape(-1, 2).T
    data = base64.b64encode(gzip.compress(planes.tobytes(), mtime=0)).decode()
    return {"low": float(low), "step": step, "gap": gap, "packed": data}


def unpacked(found: Mapping) -> np.ndarray:
    """What the page makes of `packed` numbers."""
    planes = np.frombuffer(gzip.decompress(base64.b64decode(found["packed"])), np.uint8).reshape(2, -1)
    levels = np.cumsum(planes[0] + 256 * planes[1].astype(np.uint16), dtype=np.uint16)
    return np.where(levels == found["gap"], np.nan, found["low"] + found["step"] * levels)
