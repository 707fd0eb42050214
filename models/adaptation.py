"""From one machine to another like it (thesis 5.4.3): the new machine's network takes over the learnt weights and keeps
its own normalisations; and the changes that training then makes are counted."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greygate.errors import InputError
from greygate.models.network import Network


def adopt(network: Network, learnt: Network, modules: Sequence[str]) -> Network:
    """`network` with the weights that `learnt`, nested or flat, has in the layers under `modules` (paths).

    Raises InputError for a module that has no layers, or a weight that `learnt` lacks or has in another shape.
    """
    own, found = network.parameters(), learnt.parameters()
    values = {}
    for module in modules:
        names = [n for n in own if n.startswith(f"{module}.")]
        if not names:
            raise InputError(f"network {network.name}: no module {module} to adopt; has {', '.join(network.modules)}")
        for name in names:
            if name not in found or found[name].shape != own[name].shape:
                has = f"has it as {found[name].shape}" if name in found else "lacks it"
                raise InputError(f"cannot adopt {name}, {own[name].shape} here: network {learnt.name} {has}")
            values[name] = found[name]
    return network.with_parameters(values)


def weight_changes(before: Network, after: Network) -> dict[str, np.ndarray]:
    """Per cent by which training changed each weight that is not frozen, 100 (after - before) / |before|, by parameter.

    The figures 5.14 to 5.16 of the thesis as numbers. A weight that was zero and no longer is gives NaN.
    Raises InputError if the two are not one network with two sets of weights.
    """
    flat, found = before.flatten(), after.flatten().parameters()
    own, layers = flat.parameters(), flat.layers()
    if own.keys() != found.keys() or any(v.shape != found[n].shape for n, v in own.items()):
        odd = sorted(
            n for n in own.keys() | found.keys() if n not in own or n not in found or found[n].shape != own[n].shape
        )
        raise InputError(f"networks {before.name} and {after.name} differ in {', '.join(odd[:5])}; compare one network")
    changes = {}
    for name, value in own.items():
        layer, _, port = name.rpartition(".")
        if port not in layers[layer].frozen:
            size = np.where(value == 0, np.nan, np.abs(value))
            changes[name] = np.where(found[name] == value, 0.0, 100 * (found[name] - value) / size)
    return changes


def frozen(network: Network) -> Network:
    """The network with every parameter frozen, as training shall leave it. network: of layers, not of networks."""
    return replace(
        network, modules={n: replace(m, frozen=frozenset({*m.weights, "bias"})) for n, m in network.layers().items()}
    )
