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

import numpy as np

from greygate.machines.benchmark_systems.plant import b1, b1_input
from greygate.machines.benchmark_systems.study import B2, THESIS, System, U, Y, figures, identify, prune_weights, rms
from greygate.models.families.blocks import nguyen_widrow
from greygate.models.families.regression import noe
from greygate.models.network import Network
from greygate.models.prune import Round, prune_by_entropy, remove_neurons
from greygate.models.prune import entropies as entropies_of
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record
from greygate.progress import Progress, silent

from .shared import say, stopwatch
from .thesis.grouped import ROUNDS, emptied, train_grouped

TAKES = "an hour"
SEEDS = 10
JOBS = 2

THESIS_B1 = {
    "b1_10": {"mse": 1.38e-6, "seconds": 57 + 57},
    "b1_30": {"mse": 7.4e-10, "seconds": 98 + 63, "pruned_neurons": 22},
}
ALLOWED = {"b1_30": THESIS_B1["b1_30"]["mse"], "b2": THESIS["pruned_mse"]}  # training MSE of a pruned network
AGAIN = 500, 500  # epochs of a network that lost neurons: one step ahead, as in table 3.3, and in free run
GUARDED = 150, 150  # the same, where held-out records end the free run's
STRENGTHS = 1e-6, 1e-5, 5e-5, 1e-4  # of the group lasso that makes neurons prunable,
DECAYS = 1e-4, 1e-3, 1e-2, 0.1  # and of a decay that does
PULLED = 150  # epochs of each of its trainings
TRIES = 8  # neurons in a row that may not be removed, before the guarded loop ends


def _b1(neurons: int) -> System:
    return System(
        f"b1_{neurons}",
        b1,
        lambda seed: nguyen_widrow(noe("b1", {U: (1,)}, Y, (1, 2), (neurons,), seed, bypass=False), seed),
        b1_input,
        (b1_input(1000),),
        b1_input(2000, 1000),
        (400, 200),
        3,
        1e-3 if neurons == 10 else 5e-4,
        5e-4,
        22 * 5 + 1,
    )


SYSTEMS = {"b1_10": _b1(10), "b1_30": _b1(30), "b2": B2}


def prune_neurons(
    system: System, seed: int, network: Network, onto_others: bool = False, progress: Progress = silent
) -> tuple[Network, list[Round]]:
    """Remove neurons by the loop of figure 3.7, as long as the training error stays at that of the thesis's network.

    A smaller network is trained again as the first one was: one step ahead, and then in free run; what trains in free
    run alone counts, if it is better. onto_others: of `remove_neurons`.
    """
    training = [system.record(system.excite(seed))]
    again = _again(f"{system.name}, seed {seed}", training, training, AGAIN, progress)
    bound = np.sqrt([ALLOWED[system.name]])
    return prune_by_entropy(network, training, again, bound, onto_others=onto_others)


def prune_guarded(
    system: System, seed: int, network: Network, onto_others: bool = False, progress: Progress = silent
) -> tuple[Network, list[Round]]:
    """Remove neurons by the loop of figure 3.7, checked in free run on the held-out records.

    Their RMS error may rise to `spare`, or stay where it is if that is larger, as for `prune_weights`. Training in free
    run stops on them, too. Where the neuron of lowest entropy may not go, the next ones are tried.
    """
    training, held = [system.record(system.excite(seed))], [system.record(u) for u in system.held]
    again = _again(f"{system.name}, seed {seed}", training, held, GUARDED, progress, held=held, patience=60)
    bound = np.array([max(rms(network, held), system.spare)])
    return prune_by_entropy(network, training, again, bound, held=held, onto_others=onto_others, tries=TRIES)


def prune_penalised(
    system: System, seed: int, network: Network, grouped: bool, progress: Progress = silent
) -> tuple[Network, float]:
    """(the smallest network, the strength) of a training with a group lasso, or with a decay, that empties neurons.

    These are removed, and what is left is trained without. Bound and judges are those of `prune_guarded`; nothing but
    the strength is tried.
    """
    training, held = [system.record(system.excite(seed))], [system.record(u) for u in system.held]
    title = f"{system.name}, seed {seed}"
    again = _again(title, training, held, AGAIN, progress, held=held, patience=250)
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


def _again(
    title: str, training: list[Record], judges: list[Record], epochs: tuple[int, int], progress: Progress, **options
) -> Callable[[Network], Network]:
    """What trains a smaller network again: in free run as it is, and after one step ahead; the better one by `judges`.

    epochs: one step ahead, in free run. options: of `train` in free run.
    """

    def again(smaller: Network) -> Network:
        ahead = train(smaller, training, teacher=True, epochs=epochs[0], tolerance=1e-5).network
        runs = [train(n, training, epochs=epochs[1], tolerance=1e-5, **options).network for n in (smaller, ahead)]
        best = min(runs, key=lambda run: np.nan_to_num(rms(run, judges), nan=np.inf))
        progress(f"{title}: {best.neurons()} neurons, RMS {rms(best, judges):.2g}")
        return best

    return again


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
