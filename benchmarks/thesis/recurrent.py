"""Fully recurrent networks in layers (thesis 4.4)."""

from collections.abc import Mapping, Sequence

import numpy as np

from greygate.models.families.recurrent import add_layer, tapped
from greygate.models.network import Network, Port


def frnn(
    name: str, inputs: Mapping[Port, Sequence[int]], outputs: Sequence[Port], hidden: Sequence[int], seed: int = 0
) -> Network:
    """Fully recurrent: every layer, the linear output too, reads the past step of every layer.

    Williams, Zipser 1989. inputs as in `elman`. Raises InputError for a tap that looks ahead.
    """
    last, network = tapped(name, inputs, hidden), Network(name, list(inputs), list(outputs))
    rng = np.random.default_rng(seed)
    layers = {f"hidden{depth}": size for depth, size in enumerate(hidden, 1)}
    past = {f"{n}_past": (n, 1, s) for n, s in (layers | {f"{p.name}_layer": p.size for p in outputs}).items()}
    for layer, size in layers.items():
        add_layer(network, rng, layer, last, past, size, "tansig")
        last = {layer: (layer, 0, size)}
    for port in outputs:
        add_layer(network, rng, f"{port.name}_layer", last, past, port.size, "linear", port.rest)
        network.connect(f"{port.name}_layer", port.name)
    return network.check()
