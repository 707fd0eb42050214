"""The thesis's benchmark systems B1 and B2 (3.6) over 10 seeds: `python benchmarks/systems.py [PART ...]`.

    identified   trained: training MSE and free-run RMSE
    neurons      pruned by the loop of figure 3.7, as in the thesis and with regression onto the other neurons
    guarded      B2 pruned by that loop, each removal checked on held-out records in free run
    penalised    trained with a group lasso, or a decay, that empties neurons: these are removed
    weights      B2 pruned by optimal brain surgeon
    entropies    of the neurons, before and after the loop of figure 3.7, of one seed (figures 3.10 to 3.15)

A seed is the whole procedure, its starts chosen on held-out records (machines/benchmark_systems/study.py). Every seed
is kept in results/systems.json, from which `make pages` writes the table.
"""

import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from time import process_time

from made import keep
from threadpoolctl import threadpool_limits

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
        began = process_time()
        smaller, rounds = loop(system, seed, network, onto_others)
        seconds = round(process_time() - began, 1)
        sizes = [layer.size for layer in smaller.modules.values()]
        out[f"{system.name} {name}"] = figures(system, smaller, seed) | {"layers": sizes, "rounds": len(rounds)}
        out[f"{system.name} {name}"] |= {"cpu_seconds": seconds}
    return out


def penalised(system: System, seed: int, network: Network, found: dict) -> dict:
    out = {}
    for name, grouped in (("group lasso", True), ("decay", False)):
        began = process_time()
        smaller, strength = prune_penalised(system, seed, network, grouped)
        row = figures(system, smaller, seed) | {"strength": strength, "cpu_seconds": round(process_time() - began, 1)}
        out[f"{system.name} {name}"] = row
    return out


def weights(system: System, seed: int, network: Network, found: dict) -> dict:
    return {system.name: figures(system, prune_weights(system, seed, network, 1.0)[0], seed)}


def entropies(system: System, seed: int, network: Network, found: dict) -> dict:
    training = [system.record(system.excite(seed))]
    smaller, rounds = prune_neurons(system, seed, network, False)
    both = {"before": entropies_of(network, training), "after": entropies_of(smaller, training)}
    named = {when: {layer: h.tolist() for layer, h in layers.items()} for when, layers in both.items()}
    return {system.name: {**named, "rounds": len(rounds), "kept": sum(r.kept for r in rounds)}}


PARTS = {
    identified: tuple(SYSTEMS),
    neurons: ("b1_30", "b2"),
    guarded: ("b2",),
    penalised: ("b1_30", "b2"),
    weights: ("b2",),
    entropies: ("b1_30", "b2"),
}
ONE = {"entropies"}  # parts that a single seed shows


def one(part: str, name: str, seed: int) -> dict:
    with threadpool_limits(1, "blas"):
        work = next(work for work in PARTS if work.__name__ == part)
        found = work(SYSTEMS[name], seed, *identify(SYSTEMS[name], seed))
    for what, row in found.items():
        print(part, what, seed, row, file=sys.stderr, flush=True)
    return {what: {"seed": seed, **row} for what, row in found.items()}


def main(parts: list[str]) -> None:
    for part in parts or [work.__name__ for work in PARTS]:
        names = next(systems for work, systems in PARTS.items() if work.__name__ == part)
        seeds = 1 if part in ONE else SEEDS
        jobs = [(name, seed) for name in names for seed in range(seeds)]
        with ProcessPoolExecutor(JOBS) as pool:
            rows = list(pool.map(one, repeat(part), *zip(*jobs, strict=True)))
        found: dict[str, list] = {}
        for row in rows:
            for what, figures_ in row.items():
                found.setdefault(what, []).append(figures_)
        keep("systems", part, {"seeds": seeds, "rows": found})


if __name__ == "__main__":
    main(sys.argv[1:])
