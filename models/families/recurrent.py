"""Elman networks (thesis 4.4)."""

from collections.abc import Mapping, Sequence

import numpy as np

from greygate.errors import InputError
from greygate.models.network import Layer, Network, Port

MEMORY = 0.3  # initial gain of a recurrent network's past


def elman(
    name: str, inputs: Mapping[Port, Sequence[int]], outputs: Sequence[Port], hidden: Sequence[int], seed: int = 0
) -> Network:
    """Each hidden layer reads its own past: h(k) = tansig(W x(k) + V h(k-1) + b), y(k) = C h(k) + d.

    Elman 1990. inputs: port -> delays, each 0 or more. Raises InputError for a tap that looks ahead.
    """
    last, network = tapped(name, inputs, hidden), Network(name, list(inputs), list(outputs))
    rng = np.random.default_rng(seed)
    for depth, size in enumerate(hidden, 1):
        layer = f"hidden{depth}"
        add_layer(network, rng, layer, last, {f"{layer}_past": (layer, 1, size)}, size, "tansig")
        last = {layer: (layer, 0, size)}
    for port in outputs:
        add_layer(network, rng, f"{port.name}_layer", last, {}, port.size, "linear", port.rest)
        network.connect(f"{port.name}_layer", port.name)
    return network.check()


def tapped(name: str, inputs: Mapping[Port, Sequence[int]], hidden: Sequence[int]) -> dict[str, tuple[str, int, int]]:
    """Name of each tap -> (its source, its delay, its size)."""
    taps = {f"{port.name}_z{d}": (port.name, d, port.size) for port, delays in inputs.items() for d in delays}
    if not taps or not hidden or any(d < 0 for _, d, _ in taps.values()):
        raise InputError(f"network {name}: give hidden neurons and taps of inputs from 0 on")
    return taps


def add_layer(network, rng, name, reads, past, size, activation, initial=0.0) -> None:
    """Weights that keep the layer's sum of present signals near one, and that of past signals near `MEMORY`."""
    weights: dict[str, np.ndarray] = {}
    for ports, gain in ((reads, 1.0), (past, MEMORY)):
        norm = gain / np.sqrt(max(sum(width for _, _, width in ports.values()), 1))
        weights |= {port: norm * rng.normal(size=(size, width)) for port, (_, _, width) in ports.items()}
    feeds = {port: (source, delay) for port, (source, delay, _) in (reads | past).items()}
    network.add(name, Layer(weights, 0.5 * rng.normal(size=size), activation, initial=initial), feeds)
