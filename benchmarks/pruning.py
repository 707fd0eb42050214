"""The pruning methods on one network: thesis benchmark system 2 (3.6.2), 341 parameters.

The error against parameters, and the smallest network, of each method. All choices (rounds
kept, smallest network) fall on held-out noise; the thesis's validation signal only reports.
"""

from collections.abc import Callable

import numpy as np

from greygate.errors import InputError
from greygate.machines.benchmark_systems.plant import b2, b2_input, b2_test_input
from greygate.models.accuracy import pooled_rms
from greygate.models.families.regression import noe
from greygate.models.network import Network, Port
from greygate.models.prune import prune_by_entropy
from greygate.models.saliency import METHODS, Method, Pruned, prune_by_saliency
from greygate.models.simplify import parameter_count
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record

from .shared import stopwatch

TAKES = "two minutes"
SIZES = (341, 300, 270, 244, 220, 200, 170, 140, 110, 80)
DECAY = 1e-6


def record(u: np.ndarray) -> Record:
    return Record({"u": u}, {"y": b2(u)})


def trained(seed: int, training: Record) -> Network:
    """20 + 10 neurons, NARX and then NOE."""
    network = noe("b2", {Port("u"): (1, 2)}, Port("y"), (1, 2, 3), (20, 10), seed, bypass=False)
    network = train(network, [training], teacher=True, epochs=150, decay=1e-4).network
    return train(network, [training], epochs=150, decay=DECAY).network


def methods() -> dict:
    training, held, test = record(b2_input()), record(b2_input(1, 500)), record(b2_test_input())
    watch = stopwatch()
    network = trained(0, training)

    def rms(n: Network, r: Record) -> float:
        return float(pooled_rms(n, [r])[0])

    def at(pruned: Pruned, size: int) -> float | None:
        try:
            return rms(pruned.at(size), held)
        except InputError:
            return None

    first = {"parameters": parameter_count(network), "seconds": watch(1)}
    first |= {"training": rms(network, training), "held": rms(network, held), "test": rms(network, test)}
    print("trained", first)
    curves, smallest = {}, {}
    for name, method in METHODS.items():
        watch = stopwatch()
        result = prune_by_saliency(network, [training], method, 0.02, held=[held], decay=DECAY, goal=SIZES[-1])
        curves[name] = {"seconds": watch(1), "held": [at(result, size) for size in SIZES]}
        print(name, curves[name], flush=True)
    allowed = 1.5 * rms(network, held)

    def least(name: str, start: Network, watch: Callable[[int], float], method: Method) -> None:
        options = {"held": [held], "epochs": 50, "decay": DECAY}
        result = prune_by_saliency(start, [training], method, allowed, **options)
        last = result.steps[-1]
        errors = {n: rms(last.network, r) for n, r in (("training", training), ("held", held), ("test", test))}
        found = {"parameters": last.parameters, "neurons": last.neurons, **errors, "rounds": len(result.rounds)}
        smallest[name] = {**found, "seconds": watch(1)}
        print(name, smallest[name], flush=True)

    for name, method in METHODS.items():
        least(name, network, stopwatch(), method)
    watch = stopwatch()

    def retrain(n: Network) -> Network:
        return train(n, [training], epochs=50, decay=DECAY).network

    fewer, _ = prune_by_entropy(network, [training], retrain, 1.5 * pooled_rms(network, [training]))
    entropy = {"parameters": parameter_count(fewer), "held": rms(fewer, held)}
    least("entropy, obs", fewer, watch, METHODS["obs"])
    found = {"first": first, "sizes": SIZES, "allowed": allowed, "curves": curves, "smallest": smallest}
    return found | {"entropy": entropy}


PARTS = {"b2": methods}
