"""How an input acts, as exact layers: the filters that a diagnosis names (mismatch/filters.py), a sample at a time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greygate.models.layer import LONGEST_DELAY
from greygate.models.network import Layer, Network

Filter = tuple[str, tuple[float, ...]]
"""Its kind and its parameters, in the unit of the input, or in s."""


@dataclass(frozen=True)
class Chain:
    """Layers behind an input. source: what acts so far. scale: of the input. first: its first value, over `scale`."""

    network: Network
    source: str
    scale: float
    first: float
    dt: float

    def add(self, name: str, layer: Layer, feeds: Mapping[str, str | tuple[str, int]]) -> str:
        """Add a layer that no training moves."""
        self.network.add(name, replace(layer, frozen=frozenset({*layer.weights, "bias"})), feeds)
        return name


def _offset(c: Chain, name: str, by: float) -> str:
    return c.add(name, Layer({"u": [[1.0]]}, [by / c.scale], initial=c.first + by / c.scale), {"u": c.source})


def _skew(c: Chain, name: str, by: float) -> str:
    first = c.first + by * abs(c.first)
    return c.add(name, Layer({"u": [[1.0], [1 + by], [1 - by]]}, np.zeros(3), "select", first), {"u": c.source})


def _within(c: Chain, name: str, width: float, feeds: dict[str, float], at: dict) -> str:
    """0 to 1 as a sum goes from -width to width."""
    w = width / c.scale
    return c.add(name, Layer({p: [[k / (2 * w)]] for p, k in feeds.items()}, [0.5], "satlin"), at)


def _dead_zone(c: Chain, name: str, width: float) -> str:
    part, w = _within(c, f"{name}_part", width, {"u": 1.0}, {"u": c.source}), width / c.scale
    first = np.sign(c.first) * max(abs(c.first) - w, 0.0)
    return c.add(name, Layer({"u": [[1.0]], "part": [[-2 * w]]}, [w], initial=first), {"u": c.source, "part": part})


def _saturation(c: Chain, name: str, share: float, level: float) -> str:
    part, w = _within(c, f"{name}_part", level, {"u": 1.0}, {"u": c.source}), level / c.scale
    first = c.first - share * np.sign(c.first) * max(abs(c.first) - w, 0.0)
    layer = Layer({"u": [[1.0 - share]], "part": [[2 * w * share]]}, [-w * share], initial=first)
    return c.add(name, layer, {"u": c.source, "part": part})


def _play(c: Chain, name: str, width: float) -> str:
    w, back = abs(width) / c.scale, (name, 1)
    part = _within(c, f"{name}_part", abs(width), {"u": 1.0, "at": -1.0}, {"u": c.source, "at": back})
    layer = Layer({"u": [[1.0]], "part": [[-2 * w]]}, [w], initial=c.first)
    return c.add(name, layer, {"u": c.source, "part": part})


def _rate_limit(c: Chain, name: str, share: float, rate: float) -> str:
    at, w = f"{name}_at", abs(rate) * c.dt / c.scale
    part = _within(c, f"{name}_part", abs(rate) * c.dt, {"u": 1.0, "at": -1.0}, {"u": c.source, "at": (at, 1)})
    c.add(at, Layer({"at": [[1.0]], "part": [[2 * w]]}, [-w], initial=c.first), {"at": (at, 1), "part": part})
    layer = Layer({"u": [[1.0 - share]], "at": [[share]]}, [0.0], initial=c.first)
    return c.add(name, layer, {"u": c.source, "at": at})


def _lag(c: Chain, name: str, lag: float) -> str:
    decay, end = float(np.exp(-c.dt / lag)), f"{name}_end"
    left = lag / c.dt * (1.0 - decay)
    c.add(
        end, Layer({"u": [[1.0 - decay]], "end": [[decay]]}, [0.0], initial=c.first), {"u": c.source, "end": (end, 1)}
    )
    layer = Layer({"u": [[1.0 - left]], "end": [[left]]}, [0.0], initial=c.first)
    return c.add(name, layer, {"u": c.source, "end": (end, 1)})


def _delay(c: Chain, name: str, by: float) -> str:
    steps, part = divmod(by / c.dt, 1.0)
    feeds = {"late": (c.source, int(steps)), "later": (c.source, int(steps) + 1)}
    return c.add(name, Layer({"late": [[1.0 - part]], "later": [[part]]}, [0.0], initial=c.first), feeds)


FILTERS: dict[str, Callable[..., str]] = {
    "offset": _offset,
    "skew": _skew,
    "dead_zone": _dead_zone,
    "saturation": _saturation,
    "play": _play,
    "rate_limit": _rate_limit,
    "lag": _lag,
    "delay": _delay,
}


def unbuilt(kind: str, given: Sequence[float], dt: float) -> str:
    """Why no layers are made of a filter; empty where they are."""
    if kind not in FILTERS:
        return f"no module is made of a {kind}"
    if kind == "delay" and not 0.0 <= given[0] / dt < LONGEST_DELAY - 1:
        return f"it is {given[0] / dt:.3g} samples; a network can be late by 0 to {LONGEST_DELAY - 2}"
    return ""


def acting(network: Network, name: str, scale: float, filters: Sequence[Filter], first: float, dt: float) -> str:
    """Add the layers of an input's filters; the name of what gives how it acts. scale: of the input's port."""
    source = name
    for place, (kind, given) in enumerate(filters):
        source = FILTERS[kind](Chain(network, source, scale, first / scale, dt), f"{name}_{kind}_{place}", *given)
        first = float(network.layers()[source].initial[0]) * scale
    return source
