"""The thesis's benchmark systems B1 and B2 (3.6) over 10 seeds.

    identified   trained: training MSE and free-run RMSE
    neurons      pruned by the loop of figure 3.7, as in the thesis and with regression onto the other neurons
    guarded      B2 pruned by that loop, each removal checked on held-out records in free run
    penalised    trained with a group lasso, or a decay, that empties neurons: these are removed
    weights      B2 pruned by optimal brain surgeon
    entropies    of the neurons, before and after the loop of figure 3.7, of one seed (figures 3.10 to 3.15)

A seed is the whole procedure, its starts chosen on held-out records (machines/benchmark_systems/study.py). Every seed
is kept.
"""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import repeat
from time import process_time

from greygate.machines.benchmark_systems.study import (
    SYSTEMS,
    System,
    figures,
    identify,
    prune_guarded,
    prune_neurons,
    prune_penalised,
    prune_weights,
)
from greygate.models.network import Network
from greygate.models.prune import entropies as entropies_of

from .shared import say, stopwatch

TAKES = "an hour"
SEEDS = 10
JOBS = 2


def identified(system: System, seed: int, network: Network, found: dict) -> dict:
    return {system.name: found}


def neurons(system: System, seed: int, network: Network, found: dict) -> dict:
    return _both_ways(prune_neurons, system, seed, network)


def guarded(system: System, seed: int, network: Network, found: dict) -> dict:
    return _both_ways(prune_guarded, system, seed, network)


def _both_ways(loop: Callable, system: System, seed: int, network: Network) -> dict:
    out = {}
    for name, onto_others in (("mean", False), ("onto_others", True)):
        watch = stopwatch(process_time)
        smaller, rounds = loop(system, seed, network, onto_others)
        found = {"layers": [layer.size for layer in smaller.modules.values()], "rounds": len(rounds)}
        found["cpu_seconds"] = watch(1)
        out[f"{system.name} {name}"] = figures(system, smaller, seed) | found
    return out


def penalised(system: System, seed: int, network: Network, found: dict) -> dict:
    out = {}
    for name, grouped in (("group lasso", True), ("decay", False)):
        watch = stopwatch(process_time)
        smaller, strength = prune_penalised(system, seed, network, grouped)
        found = {"strength": strength, "cpu_seconds": watch(1)}
        out[f"{system.name} {name}"] = figures(system, smaller, seed) | found
    return out


def weights(system: System, seed: int, network: Network, found: dict) -> dict:
    return {system.name: figures(system, prune_weights(system, seed, network, 1.0)[0], seed)}


def entropies(system: System, seed: int, network: Network, found: dict) -> dict:
    training = [system.record(system.excite(seed))]
    smaller, rounds = prune_neurons(system, seed, network, False)
    both = {"before": entropies_of(network, training), "after": entropies_of(smaller, training)}
    named = {when: {layer: h.tolist() for layer, h in layers.items()} for when, layers in both.items()}
    return {system.name: {**named, "rounds": len(rounds), "kept": sum(r.kept for r in rounds)}}


def one(work: Callable, name: str, seed: int) -> dict:
    found = work(SYSTEMS[name], seed, *identify(SYSTEMS[name], seed))
    for what, row in found.items():
        say(work.__name__, what, seed, row)
    return {what: {"seed": seed, **row} for what, row in found.items()}


def over_seeds(work: Callable, names: tuple[str, ...], seeds: int = SEEDS) -> dict:
    """One part, every system and seed."""
    jobs = [(name, seed) for name in names for seed in range(seeds)]
    found: dict[str, list] = {}
    with ProcessPoolExecutor(JOBS) as pool:
        for row in pool.map(one, repeat(work), *zip(*jobs, strict=True)):
            for what, figures_ in row.items():
                found.setdefault(what, []).append(figures_)
    return {"seeds": seeds, "rows": found}


PARTS = {
    "identified": partial(over_seeds, identified, tuple(SYSTEMS)),
    "neurons": partial(over_seeds, neurons, ("b1_30", "b2")),
    "guarded": partial(over_seeds, guarded, ("b2",)),
    "penalised": partial(over_seeds, penalised, ("b1_30", "b2")),
    "weights": partial(over_seeds, weights, ("b2",)),
    "entropies": partial(over_seeds, entropies, ("b1_30", "b2"), seeds=1),
}
