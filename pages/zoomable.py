"""Curves over time that a reader can zoom: the data that `zoomable.html` hands to Plotly."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise

import numpy as np

DRAWN = 20_000  # longest curve that is drawn sample by sample; a longer one is drawn by least and largest of bins


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


def curves(traces: Mapping[str, Trace], time: float | np.ndarray, labels: Sequence[str]) -> dict:
    """What Plotly draws, JSON-able, numbers as binary float32. time: the step [s], or the time of each sample [s].

    labels: of the axis, and of the axis below where there is one. Plotly takes them as HTML, so they are escaped; the
    template's `tojson` then keeps them inside <script>.
    """
    drawn = {
        name: _placed(trace.values, time if trace.time is None else trace.time)
        | {"colour": trace.colour, "width": trace.width, "below": trace.below}
        for name, trace in traces.items()
    }
    return {"traces": drawn, "labels": [escape(label, quote=False) for label in labels]}


def thinned(y: np.ndarray) -> np.ndarray:
    """Indices of the samples to draw: all, or those of the least and largest value of each of DRAWN / 2 bins."""
    if len(y) <= DRAWN:
        return np.arange(len(y))
    edges = np.linspace(0, len(y), DRAWN // 2 + 1).astype(int)
    y = np.nan_to_num(y)
    bins = ((a, y[a:b]) for a, b in pairwise(edges))
    return np.unique([a + k for a, part in bins for k in (part.argmin(), part.argmax())])


def _placed(y: np.ndarray, time: float | np.ndarray) -> dict:
    steps = thinned(y)
    if isinstance(time, np.ndarray):
        return {"y": _binary(y[steps]), "x": _binary(time[steps])}
    whole = {"x0": 0.0, "dx": time} if len(steps) == len(y) else {"x": _binary(steps * time)}
    return {"y": _binary(y[steps])} | whole


def _binary(values: np.ndarray) -> dict:
    return {"dtype": "f4", "bdata": base64.b64encode(np.asarray(values, "<f4").tobytes()).decode()}
