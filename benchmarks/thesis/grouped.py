"""Training that empties neurons, so that pruning can take them: a group lasso over the hidden neurons.

Beside the squared errors counts the length of each neuron's weights: those into it, its bias, and those that read it. A
length pulls as strongly near zero as far from it, so that it empties some neurons at little cost; the square that a
weight decay counts shortens those that are needed most of all. It is minimised as a decay of each neuron, set anew
after every training (Yuan, Lin 2006; Scardapane and others 2017).
"""

from collections.abc import Sequence

import numpy as np

from greygate.errors import InputError
from greygate.models.network import Network
from greygate.models.prune import retrained, spareable
from greygate.models.saliency import nonzero
from greygate.models.simplify import Graph
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record

ROUNDS = 10  # trainings, each with the decay that the one before asks for
EMPTY = 1e-3  # of the longest neuron's length, below which one is empty
LEAST = EMPTY / 10  # likewise, below which a shorter one pulls no stronger

Group = list[tuple[str, np.ndarray]]  # (parameter, flat indices in it) of the weights of one neuron


def train_grouped(
    network: Network, records: Sequence[Record], strength: float, *, rounds: int = ROUNDS, epochs: int = 50, **options
) -> Network:
    """Train with a group lasso over the hidden neurons; returns the flat network.

    strength: what the lengths of the given network count in the loss, divided by the sum of the targets' squares.
    epochs: of each round. options: of `train`; weights that were pruned stay zero unless `free` says otherwise.
    Raises InputError where no hidden neuron can be pruned or has weights, or the network diverges on a record.
    """
    network = network.flatten()
    groups = neurons(network)
    if not groups:
        raise InputError(f"network {network.name}: no hidden neuron of it can be pruned")
    objective = Objective(network, list(records))
    if not np.isfinite(objective.squares(objective.theta)):
        raise InputError(f"network {network.name}: diverges on a record; train it before")
    squares = 2 * objective.samples * objective.power  # of the targets
    total = sum(np.sqrt(len(of)) * length for of, length in _lengths(network, groups))
    if not total > 0:
        raise InputError(f"network {network.name}: its neurons have no weights yet; train it before")
    options = {"free": nonzero(network), **options}
    for _ in range(rounds):
        decay = _decay(network, groups, strength * squares / total)
        network = retrained(network, list(records), epochs, decay=decay, **options)
    return network


def emptied(network: Network) -> dict[str, list[int]]:
    """Layer -> the hidden neurons of a flat network whose weights are next to nothing, at most all but one of each."""
    groups = neurons(network)
    found: dict[str, list[int]] = {}
    lengths = [length for _, length in _lengths(network, groups)]
    for (layer, i), length in sorted(zip(groups, lengths, strict=True), key=lambda found: found[1]):
        if length < EMPTY * max(lengths) and len(found.get(layer, [])) < network.layers()[layer].size - 1:
            found.setdefault(layer, []).append(i)
    return found


def neurons(network: Network) -> dict[tuple[str, int], Group]:
    """(layer, number) -> the weights of each hidden neuron of a flat network that may be pruned."""
    graph = Graph(network)
    found: dict[tuple[str, int], Group] = {}
    for name, layer in network.layers().items():
        if name in graph.shown() or not spareable(layer):
            continue
        for i in range(layer.size):
            group = [(f"{name}.bias", np.array([i]))]
            for port, w in layer.weights.items():
                group.append((f"{name}.{port}", np.ravel_multi_index((i, np.arange(w.shape[1])), w.shape)))
            for reader, port, _ in graph.readers(name):
                w = graph.layers[reader].weights[port]
                group.append((f"{reader}.{port}", np.ravel_multi_index((np.arange(w.shape[0]), i), w.shape)))
            found[name, i] = group
    return found


def _lengths(network: Network, groups: dict[tuple[str, int], Group]) -> list[tuple[np.ndarray, float]]:
    """(weights, their length) of each neuron; a weight of a neuron onto itself counts twice."""
    parameters = network.parameters()
    weights = [np.concatenate([parameters[name].ravel()[at] for name, at in group]) for group in groups.values()]
    return [(w, float(np.linalg.norm(w))) for w in weights]


def _decay(network: Network, groups: dict[tuple[str, int], Group], strength: float) -> dict[str, np.ndarray]:
    """Parameter -> decay of its weights, which at these lengths has the slope of `strength` times the lengths."""
    decay = {name: np.zeros(value.shape) for name, value in network.parameters().items()}
    lengths = _lengths(network, groups)
    least = LEAST * max(length for _, length in lengths)
    for group, (of, length) in zip(groups.values(), lengths, strict=True):
        for name, at in group:
            decay[name].flat[at] += strength * np.sqrt(len(of)) / (2 * max(length, least))
    return decay
