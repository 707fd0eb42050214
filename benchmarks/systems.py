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
    AGAIN,
    SYSTEMS,
    System,
    figures,
    identify,
    prune_guarded,
    prune_neurons,
    prune_weights,
    rms,
    training_again,
)
from greygate.models.network import Network
from greygate.models.prune import entropies as entropies_of
from greygate.models.prune import remove_neurons
from greygate.models.training.levenberg import train
from greygate.progress import Progress, silent

from .shared import say, stopwatch
from .thesis.grouped import ROUNDS, emptied, train_grouped

TAKES = "an hour"
SEEDS = 10
JOBS = 2
STRENGTHS = 1e-6, 1e-5, 5e-5, 1e-4  # of the group lasso that makes neurons prunable,
DECAYS = 1e-4, 1e-3, 1e-2, 0.1  # and of a decay that does
PULLED = 150  # epochs of each of its trainings


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


def prune_penalised(
    system: System, seed: int, network: Network, grouped: bool, progress: Progress = silent
) -> tuple[Network, float]:
    """(the smallest network, the strength) of a training with a group lasso, or with a decay, that empties neurons.

    These are removed, and what is left is trained without. Bound and judges are those of `prune_guarded`; nothing but
    the strength is tried.
    """
    training, held = [system.record(system.excite(seed))], [system.record(u) for u in system.held]
    title = f"{system.name}, seed {seed}"
    again = training_again(title, training, held, AGAIN, progress, held=held, patience=250)
    bound, best = max(rms(network, held), system.spare), (network, 0.0)
    for strength in STRENGTHS if grouped else DECAYS:
        if grouped:
            pulled = train_grouped(network, training, strength, epochs=PULLED)
        else:
            pulled = train(network, training, epochs=ROUNDS * PULLED, decay=strength).network.flatten()
        if not (empty := emptied(pulled)):
            continue
        smaller = again(remove_neurons(pulled, training, empty, onto_others=False))
        if smaller.neurons() < best[0].neurons() and rms(smaller, held) <= bound:
            best = smaller, strength
    return best


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
