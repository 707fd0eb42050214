"""Entropy pruning (thesis 3.6): it replaces neurons that hardly change by their mean, and trains the rest again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greygate.models.accuracy import pooled_rms
from greygate.models.network import Layer, Network
from greygate.models.simplify import Graph
from greygate.models.training.levenberg import Outcome, train
from greygate.models.training.objective import Objective, traces
from greygate.models.training.record import Record

BINS = 100
RIDGE = 1e-9  # of the regression, per sample

Pruning = Callable[[Network], "tuple[Network, list[Round]]"]  # a pass: the smaller network, and every attempt


@dataclass(frozen=True)
class Round:
    """One attempt: what it removed, how many neurons are left, and whether it was kept.

    removed: neurons by layer; or single weights by parameter, as flat indices of its matrix (`saliency.py`).
    error: RMS of each output over the records after training again, normalised.
    """

    removed: dict[str, list[int]]
    neurons: int
    error: tuple[float, ...]
    kept: bool


def spareable(layer: Layer) -> bool:
    """Whether neurons of a layer may be pruned: their outputs are bounded and take more than two values."""
    return layer.function.is_bounded and layer.function.lowered != "threshold"


def entropies(network: Network, records: list[Record]) -> dict[str, np.ndarray]:
    """H = -sum p ln p of each hidden neuron's histogram over the image of its activation (3.14), in nats, by layer."""
    objective = Objective(network, records)
    run, layers = np.concatenate(traces(objective)), objective.flat.layers()
    found = {}
    for name, columns in objective.elements().items():
        layer = layers.get(name)
        if layer is None or not spareable(layer):
            continue
        p = np.stack([np.histogram(v, BINS, layer.function.image)[0] for v in run[:, columns].T]) / len(run)
        found[name] = -np.sum(p * np.log(np.where(p > 0, p, 1.0)), axis=1)
    return found


def remove_neurons(
    network: Network, records: list[Record], chosen: dict[str, list[int]], onto_others: bool = True
) -> Network:
    """Remove neurons, and correct the layers that read them.

    The mean of each neuron is added to their biases. onto_others: the part of its variation that the other neurons of
    its layer explain by linear regression is added to their weights, which the thesis does not do.
    """
    objective = Objective(network, records)
    run = np.concatenate(traces(objective))
    g = Graph(objective.flat)
    for name, indices in chosen.items():
        keep = np.setdiff1d(np.arange(g.layers[name].size), indices)
        signal = run[:, objective.elements()[name]]
        mean = signal.mean(axis=0)
        varying = signal - mean
        rest = varying[:, keep]
        gram = rest.T @ rest + RIDGE * len(run) * np.eye(len(keep))
        share = np.linalg.solve(gram, rest.T @ varying[:, indices])  # removed ~ mean + (rest - its mean) @ share
        share *= onto_others
        for reader, port, _ in g.readers(name):
            layer = g.layers[reader]
            w = layer.weights[port]
            g.layers[reader] = replace(
                layer,
                weights=layer.weights | {port: w[:, keep] + w[:, indices] @ share.T},
                bias=layer.bias + w[:, indices] @ (mean[indices] - mean[keep] @ share),
            )
        layer = g.layers[name]
        own = {p: w[keep] for p, w in layer.weights.items()}
        g.layers[name] = replace(layer, weights=own, bias=layer.bias[keep], initial=layer.initial[keep])
    return g.network()


def retrained(network: Network, records: list[Record], epochs: int, **options) -> Network:
    """Train a network again; Ctrl-C, which ends a training early, ends the pruning too. options: of `train`."""
    fit = train(network, records, epochs=epochs, **options)
    if fit.outcome is Outcome.INTERRUPTED:
        raise KeyboardInterrupt
    return fit.network


def prune_by_entropy(
    network: Network,
    records: list[Record],
    retrain: Callable[[Network], Network],
    allowed: np.ndarray,
    low: float = 0.1,
    held: Sequence[Record] = (),
    onto_others: bool = True,
    tries: int = 1,
) -> tuple[Network, list[Round]]:
    """Remove neurons of low entropy and train again, round after round, until the error would exceed `allowed`.

    This is the flowchart of figure 3.7. onto_others: of `remove_neurons`.

    A round removes every neuron below `low` times the greatest possible entropy, or else the one of lowest entropy.
    allowed: RMS error of each output, normalised, over the held-out records, or over `records` if none are held out. A
    round that exceeds it, or whose network diverges on `records`, is undone, and the next one removes half as many.
    Where a single neuron could not be removed, the next lowest is tried; `tries` of them in a row end the pruning.
    """
    rounds: list[Round] = []
    largest, undone = sum(map(len, entropies(network, records).values())), 0
    while True:
        found = entropies(network, records)
        ranked = sorted((float(h), name, i) for name, values in found.items() for i, h in enumerate(values))
        removable = [r for r in ranked if len(found[r[1]]) > 1]
        if undone >= min(tries, len(removable)):
            return network, rounds
        batch = [r for r in removable if r[0] < low * np.log(BINS)][:largest]
        batch = batch if len(batch) > 1 else removable[undone : undone + 1]
        chosen: dict[str, list[int]] = {}
        for _, name, i in batch:
            if len(chosen.get(name, [])) < len(found[name]) - 1:
                chosen.setdefault(name, []).append(i)
        trial = retrain(remove_neurons(network, records, chosen, onto_others))
        error = pooled_rms(trial, records)
        within = (pooled_rms(trial, list(held)) if held else error) <= allowed
        kept = bool(within.all() and np.isfinite(error).all())  # it may diverge on the records and not on the held-out
        rounds.append(Round(chosen, len(ranked) - sum(map(len, chosen.values())), tuple(error.tolist()), kept))
        if kept:
            network, undone = trial, 0
        elif len(batch) > 1:
            largest = len(batch) // 2
        else:
            undone += 1
