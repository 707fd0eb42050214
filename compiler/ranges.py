"""The range of every signal: observed on records, and bounded by interval arithmetic."""

from dataclasses import dataclass

import numpy as np

from greygate.models.activations import Activation
from greygate.models.arithmetic import mean, product, xp
from greygate.models.network import Layer, Network
from greygate.models.training.objective import Objective, traces
from greygate.models.training.record import Record

PARTS = {"select": ("condition", "above", "below"), "product": ("one", "other")}  # sums of a neuron that has several
WIDEN_AFTER = 50  # sweeps of interval arithmetic before a signal that still grows is called unbounded


@dataclass(frozen=True)
class Range:
    """The range of one signal or pre-activation, over all its elements (normalised units).

    low, high: seen on the records. mean: of each element (size,). sound: (low, high), proved bounds as long as every
    input stays within its observed range; they may be inf.
    """

    low: float
    high: float
    mean: np.ndarray
    sound: tuple[float, float]

    @property
    def magnitude(self) -> float:
        return max(abs(self.low), abs(self.high))


def sums(name: str, layer: Layer) -> dict[str, slice]:
    """The sums of a layer by signal name, as slices of its rows: `layer.n`, or the parts of a select or a product."""
    size, parts = layer.size, PARTS.get(layer.function.lowered, ("n",))
    return {f"{name}.{part}": slice(i * size, (i + 1) * size) for i, part in enumerate(parts)}


def ranges(network: Network, records: list[Record]) -> dict[str, Range]:
    """Ranges of every input and layer of a flat network, and of every pre-activation by its name in `sums`."""
    objective = Objective(network, records)
    flat, runs = objective.flat, traces(objective)
    start, layers = flat.rest(), flat.layers()
    past: dict[str, int] = {}
    for source, delay in flat.feeds().values():
        past[source] = max(past.get(source, 0), delay)
    seen: dict[str, tuple[float, float]] = {}
    values: dict[str, list[np.ndarray]] = {}  # by record
    for record, run in zip(records, runs, strict=True):
        columns = np.split(
            run, np.cumsum([len(start[n]) for n in [*(p.name for p in flat.inputs), *flat.order()]]), axis=1
        )
        signal = dict(zip([*(p.name for p in flat.inputs), *flat.order()], columns, strict=False))
        history = {}
        for n, d in past.items():
            first = start[n]
            if n in record.initial:
                port = next((p for p in flat.inputs if p.name == n), None)
                value = record.initial[n] if port is None else port.normalised(record.initial[n])
                first = np.full(len(first), value)
            history[n] = np.concatenate([np.broadcast_to(first, (d, len(first))), signal[n]])
        feeds = flat.feeds()
        for name in flat.order():
            layer = layers[name]
            summed = np.broadcast_to(layer.bias, (len(run), layer.rows)).copy()
            for target, w in layer.weights.items():
                source, delay = feeds[f"{name}.{target}"]
                past_rows = history[source] if source in history else signal[source]
                offset = past.get(source, 0) - delay if source in history else 0
                summed += product(past_rows[offset : offset + len(run)], w.T)
            for part, rows in sums(name, layer).items():
                _extend(seen, part, summed[:, rows])
                values.setdefault(part, []).append(summed[:, rows])
        for name, run_of in signal.items():
            values.setdefault(name, []).append(run_of)
            _extend(seen, name, run_of)
            _extend(seen, name, history[name][: past[name]] if past.get(name) else run_of)
    bounds = _intervals(flat, {p.name: seen[p.name] for p in flat.inputs}, start)
    return {n: Range(low, high, mean(np.concatenate(values[n])), bounds[n]) for n, (low, high) in seen.items()}


def _extend(seen: dict[str, tuple[float, float]], name: str, values: np.ndarray) -> None:
    low, high = float(values.min()), float(values.max())
    before = seen.get(name, (low, high))
    seen[name] = (min(low, before[0]), max(high, before[1]))


@np.errstate(over="ignore")  # a bound that does not settle may pass through large numbers to inf
def _intervals(flat: Network, inputs: dict, start: dict[str, np.ndarray]) -> dict[str, tuple[float, float]]:
    """Interval bounds of every signal, by a fixed point over the delays; a bound that does not settle becomes inf."""
    low = {n: v.copy() for n, v in start.items()}
    high = {n: v.copy() for n, v in start.items()}
    for name, (a, b) in inputs.items():
        low[name] = np.minimum(low[name], a)
        high[name] = np.maximum(high[name], b)
    feeds, layers = flat.feeds(), flat.layers()
    bounds: dict[str, tuple[float, float]] = {}
    for sweep in range(2 * WIDEN_AFTER):
        changed = False
        for name in flat.order():
            layer = layers[name]
            f = layer.function
            a, b = layer.bias.copy(), layer.bias.copy()
            for port, w in layer.weights.items():
                source, _ = feeds[f"{name}.{port}"]
                up, down = np.maximum(w, 0), np.minimum(w, 0)
                a += sum((_times(up, low[source]) + _times(down, high[source])).T)
                b += sum((_times(up, high[source]) + _times(down, low[source])).T)
            bounds |= {p: (float(a[rows].min()), float(b[rows].max())) for p, rows in sums(name, layer).items()}
            if f.symmetry == "even":  # and monotone on either side of zero
                nearest = np.where((a <= 0) & (b >= 0), 0.0, np.minimum(np.abs(a), np.abs(b)))
                ends = [f.value(xp, n) for n in (nearest, np.maximum(np.abs(a), np.abs(b)))]
                a, b = np.minimum(*ends), np.maximum(*ends)
            elif f.lowered == "select":
                never, always = np.split(b, 3)[0] < -1e-12, np.split(a, 3)[0] > 1e-12
                (_, *a), (_, *b) = np.split(a, 3), np.split(b, 3)
                a = np.where(always, a[0], np.where(never, a[1], np.minimum(*a)))
                b = np.where(always, b[0], np.where(never, b[1], np.maximum(*b)))
            elif f.lowered == "product":
                (low_one, low_other), (high_one, high_other) = np.split(a, 2), np.split(b, 2)
                corners = [_times(x, y) for x in (low_one, high_one) for y in (low_other, high_other)]
                a, b = np.min(corners, axis=0), np.max(corners, axis=0)
            elif f.periodic:
                a, b = (np.full(len(a), end) for end in f.image)
            else:
                a, b = _at(f, a), _at(f, b)
            grow_low, grow_high = a < low[name] - 1e-12, b > high[name] + 1e-12
            if grow_low.any() or grow_high.any():
                changed = True
                wide = sweep >= WIDEN_AFTER
                least, most = f.image
                low[name] = np.where(grow_low, least if wide else a, low[name])
                high[name] = np.where(grow_high, most if wide else b, high[name])
        if not changed:
            break
    return bounds | {n: (float(low[n].min()), float(high[n].max())) for n in low}


def _at(f: Activation, n: np.ndarray) -> np.ndarray:
    """A monotone activation of bounds; at an infinite bound it is at an end of its image."""
    finite = np.isfinite(n)
    return np.where(finite, f.value(xp, np.where(finite, n, 0.0)), np.clip(n, *f.image))


def _times(w: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """w * bound, and 0 where w is 0 even if the bound is infinite."""
    return np.where(w == 0, 0.0, w * np.where(np.isfinite(bound) | (w != 0), bound, 0.0))
