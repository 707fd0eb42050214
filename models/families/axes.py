"""Regressors in other coordinates: differences and principal components of taps (thesis 3.2).

Neighbouring taps of a signal that is sampled fast are nearly the same number, so a neuron needs large weights that
cancel to see how the signal moves. A frozen linear layer between the taps and the first hidden layer gives the neurons
axes that differ, each within [-1, 1] on the records. The compiler merges it into the neurons.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import comb

import numpy as np

from greygate.errors import InputError
from greygate.models.network import Layer, Network
from greygate.models.training.record import Record

KINDS = ("differences", "principal")
LOST = 1e-12  # of the largest deviation: an axis along which nothing but rounding varies


def on_axes(
    network: Network, records: Sequence[Record], kind: str = "differences", layer: str = "hidden1", least: float = LOST
) -> Network:
    """The flat network whose `layer` reads axes of its taps; what it computes stays the same where no axis is left out.

    Draw its weights anew before training (`nguyen_widrow`): those of the taps are small along the new axes.
    kind: "differences" of each signal's taps, x(k), x(k) - x(k-1), x(k) - 2 x(k-1) + x(k-2), ...; "principal", the
    principal components of all taps together (Pearson 1901; Hotelling 1933).
    records: what the axes are made from, with the measured outputs as the outputs' past.
    least: axes that deviate by less than this share of the one that deviates most are left out, as noise is all they
    show; of principal components only.
    Raises InputError for another kind, a layer that is lacking or reads other layers, and records that are too short.
    """
    if kind not in KINDS:
        raise InputError(f"axes {kind!r}: give {' or '.join(KINDS)}")
    flat = network.flatten()
    if layer not in flat.layers():
        raise InputError(f"network {network.name}: no layer {layer!r}; has {', '.join(flat.layers())}")
    old = flat.layers()[layer]
    taps = {port: flat.feeds()[f"{layer}.{port}"] for port in old.weights}
    phi = np.concatenate([_taps(flat, record, layer, taps) for record in records])
    if len(phi) <= phi.shape[1]:
        raise InputError(f"network {network.name}: {len(phi)} rows for {phi.shape[1]} taps; record longer")
    middle = (phi.max(0) + phi.min(0)) / 2
    rows = _differences(taps, old) if kind == "differences" else _principal(phi, least)
    reach = np.abs((phi - middle) @ rows.T).max(0)
    rows /= np.where(reach > 0, reach, 1.0)[:, None]
    parts = np.split(rows, np.cumsum([w.shape[1] for w in old.weights.values()])[:-1], axis=1)
    axes = Layer(dict(zip(taps, parts, strict=True)), -rows @ middle, frozen={*taps, "bias"})
    whole = np.concatenate(list(old.weights.values()), axis=1)
    read = Layer({"axes": whole @ np.linalg.pinv(rows)}, old.bias + whole @ middle, old.activation, old.initial)
    kept = [c for c in flat.connections if c.target.rpartition(".")[0] != layer]
    modules = {n: (read if n == layer else m) for n, m in flat.modules.items()} | {"axes": axes}
    found = replace(flat, modules=modules, connections=kept)
    for port, (source, delay) in taps.items():
        found.connect(source, f"axes.{port}", delay)
    found.connect("axes", f"{layer}.axes")
    return found.check()


def _taps(flat: Network, record: Record, layer: str, taps: dict[str, tuple[str, int]]) -> np.ndarray:
    """What the layer reads, normalised (samples, taps), from the first sample that has them all."""
    inputs = {p.name: p.normalised(np.asarray(record.inputs[p.name], float)) for p in flat.inputs}
    shown = {flat.feeds()[p.name][0]: p.normalised(np.asarray(record.targets[p.name], float)) for p in flat.outputs}
    start, columns = max(d for _, d in taps.values()), []
    for port, (source, delay) in taps.items():
        if source not in inputs and source not in shown:
            raise InputError(f"layer {layer}: {port} reads {source}, which is no input and no output")
        signal = inputs[source] if source in inputs else shown[source]
        columns.append(signal.reshape(len(record), -1)[start - delay : len(record) - delay])
    return np.concatenate(columns, axis=1)


def _differences(taps: dict[str, tuple[str, int]], old: Layer) -> np.ndarray:
    """(axes, taps): of each signal its newest tap, then differences of rising order of its taps, newest first."""
    place: dict[tuple[str, int], list[tuple[int, int]]] = {}
    at = 0
    for port, (source, delay) in taps.items():
        for element in range(old.weights[port].shape[1]):
            place.setdefault((source, element), []).append((delay, at))
            at += 1
    rows = np.zeros((at, at))
    first = 0
    for found in place.values():
        ordered = [column for _, column in sorted(found)]
        for order in range(len(ordered)):
            for n, column in enumerate(ordered[: order + 1]):
                rows[first + order, column] = (-1) ** n * comb(order, n)
        first += len(ordered)
    return rows


def _principal(phi: np.ndarray, least: float) -> np.ndarray:
    """(axes, taps): directions in which the taps, each by its deviation, vary most; the largest first."""
    size = phi.std(0)
    size[size == 0] = 1.0
    _, deviations, directions = np.linalg.svd((phi - phi.mean(0)) / size, full_matrices=False)
    return directions[deviations >= max(least, LOST) * deviations[0]] / size
