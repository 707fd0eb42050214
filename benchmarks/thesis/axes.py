"""Regressors in other coordinates: differences and principal components of taps (thesis 3.2).

Neighbouring taps of a signal that is sampled fast are nearly the same number, so a neuron needs large weights that
cancel to see how the signal moves. A frozen linear layer between the taps and the first hidden layer gives the neurons
axes that differ, each within [-1, 1] on the records. The compiler merges it into the neurons.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greygate.errors import InputError
from greygate.models.network import Layer, Network
from greygate.models.training.record import Record, listed

KINDS = ("differences", "principal")
LOST = 1e-12  # of the largest: what deviates by less is rounding


def on_axes(
    network: Network,
    records: Sequence[Record] | Record,
    kind: str = "differences",
    layer: str = "hidden1",
    least: float = LOST,
) -> Network:
    """The flat network whose `layer` reads axes of its taps, from a new layer `LAYER_axes`.

    What it computes on the records stays the same where no axis that varies is left out. Draw its weights anew before
    training (`nguyen_widrow`): those of the taps are small along the new axes.
    kind: "differences", each signal's newest tap and the divided differences of its taps (of neighbours x(k) - x(k-1),
    x(k) - 2 x(k-1) + x(k-2), ...); "principal", the principal components of all taps together (Pearson 1901, Hotelling
    1933). What does not vary is left out.
    records: what the axes are made from, with the measured outputs as the outputs' past.
    least: principal components that deviate by less than this share of the first are left out, as noise is all that
    they show.
    Raises InputError for another kind, a layer that is lacking, frozen, or reads other layers, a signal that a record
    lacks, and records that are too short.
    """
    if kind not in KINDS:
        raise InputError(f"axes {kind!r}: give {' or '.join(KINDS)}")
    flat = network.flatten()
    if layer not in flat.layers():
        raise InputError(f"network {network.name}: no layer {layer!r}; has {', '.join(flat.layers())}")
    old = flat.layers()[layer]
    if fixed := old.frozen & old.weights.keys():
        raise InputError(f"network {network.name}: {layer} is frozen in {', '.join(sorted(fixed))}; its taps stay")
    taps = {port: flat.feeds()[f"{layer}.{port}"] for port in old.weights}
    found = [_taps(flat, record, layer, taps) for record in listed(records)]
    phi = np.concatenate(found) if found else np.zeros((0, 0))
    if len(phi) <= phi.shape[1]:
        raise InputError(f"network {network.name}: {len(phi)} rows for {phi.shape[1]} taps; record longer")
    rows, back = _differences(taps, old) if kind == "differences" else _principal(phi)
    seen = phi @ rows.T
    middle, reach = (seen.max(0) + seen.min(0)) / 2, (seen.max(0) - seen.min(0)) / 2
    varies = reach > LOST * (np.abs(rows) @ np.abs(phi).max(0))
    if kind == "principal":
        varies &= seen.std(0) >= max(least, LOST) * seen.std(0).max()
    scaled = rows[varies] / reach[varies, None]
    parts = np.split(scaled, np.cumsum([w.shape[1] for w in old.weights.values()])[:-1], axis=1)
    whole = np.concatenate(list(old.weights.values()), axis=1) @ back
    name = f"{layer}_axes"
    axes = Layer(dict(zip(taps, parts, strict=True)), -middle[varies] / reach[varies], frozen={*taps, "bias"})
    weights, bias = {name: whole[:, varies] * reach[varies]}, old.bias + whole @ middle
    read = Layer(weights, bias, old.activation, old.initial, old.frozen)
    kept = [c for c in flat.connections if c.target.rpartition(".")[0] != layer]
    result = replace(flat, modules=dict(flat.modules) | {layer: read}, connections=kept)
    result.add(name, axes)
    for port, (source, delay) in taps.items():
        result.connect(source, f"{name}.{port}", delay)
    result.connect(name, f"{layer}.{name}")
    return result.check()


def _taps(flat: Network, record: Record, layer: str, taps: dict[str, tuple[str, int]]) -> np.ndarray:
    """What the layer reads, normalised (samples, taps), from the first sample that counts and has them all."""
    shown = {flat.feeds()[p.name][0]: p for p in flat.outputs}
    inputs = {p.name: p for p in flat.inputs}
    start, columns = max(record.skip, *(d for _, d in taps.values())), []
    for port, (source, delay) in taps.items():
        if source not in inputs and source not in shown:
            raise InputError(f"layer {layer}: {port} reads {source}, which is no input and no output")
        read, given = (inputs[source], record.inputs) if source in inputs else (shown[source], record.targets)
        if read.name not in given:
            raise InputError(f"signal {read.name} is missing; given: {', '.join(given) or 'nothing'}")
        signal = read.normalised(np.asarray(given[read.name], float)).reshape(len(record), -1)
        columns.append(signal[start - delay : max(len(record) - delay, start - delay)])
    return np.concatenate(columns, axis=1)


def _differences(taps: dict[str, tuple[str, int]], old: Layer) -> tuple[np.ndarray, np.ndarray]:
    """(axes, taps) and its inverse: of each signal its newest tap, then divided differences of rising order."""
    place: dict[tuple[str, int], list[tuple[int, int]]] = {}
    at = 0
    for port, (source, delay) in taps.items():
        for element in range(old.weights[port].shape[1]):
            place.setdefault((source, element), []).append((delay, at))
            at += 1
    rows = np.zeros((at, at))
    first = 0
    for found in place.values():
        ordered = sorted(found)
        for order in range(len(ordered)):
            used = ordered[: order + 1]
            for delay, column in used:
                rows[first + order, column] = 1 / np.prod([float(d - delay) for d, _ in used if d != delay])
        first += len(ordered)
    return rows, np.linalg.inv(rows)


def _principal(phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(axes, taps) and its inverse: directions in which the taps, each by its deviation, vary; the most first."""
    size = phi.std(0)
    size[size == 0] = 1.0
    directions = np.linalg.svd((phi - phi.mean(0)) / size, full_matrices=False)[2]
    return directions / size, size[:, None] * directions.T
