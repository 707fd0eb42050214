"""How the thesis's benchmark systems (3.6) are identified, seed by seed: NARX, free run, pruning; here B2.

A seed draws the training record and every start. Starts are compared on held-out records of the same system; the
thesis's validation signal enters no choice.
"""

from collections.abc import Callable
from dataclasses import dataclass
from time import process_time

import numpy as np

from greygate.machines.benchmark_systems.plant import b2, b2_input, b2_test_input
from greygate.models.families.blocks import nguyen_widrow
from greygate.models.families.regression import noe
from greygate.models.network import Network, Port
from greygate.models.prune import Round
from greygate.models.saliency import Method, nonzero, obs, prune_by_saliency
from greygate.models.simplify import parameter_count
from greygate.models.training.levenberg import train
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record
from greygate.plants.excitation import chirp, prms
from greygate.progress import Progress, silent

U, Y = Port("u"), Port("y")
SHARES = (0.1, 0.05, 0.03, 0.02)  # of the parameters, to be taken out in one round
THESIS = {
    "mse": 8.57e-8,
    "rmse": 4.2e-3,
    "seconds": 64 + 190,
    "pruned_mse": 8.65e-8,
    "pruned_neurons": 24,
    "pruned_parameters": 244,
    "pruned_rmse": 5.2e-3,
}


@dataclass(frozen=True)
class System:
    """A benchmark: the plant, a start of its network, and the records that train and judge a start.

    held: held-out records, which only choose. good: RMS error over them at which no further start is tried. spare: RMS
    error over them that pruning of weights may reach. goal: parameters after that. epochs: of the one-step prediction
    and of the free run. starts: the most starts.
    """

    name: str
    plant: Callable[[np.ndarray], np.ndarray]
    start: Callable[[int], Network]
    excite: Callable[[int], np.ndarray]
    held: tuple[np.ndarray, ...]
    test: np.ndarray
    epochs: tuple[int, int]
    starts: int
    good: float
    spare: float
    goal: int

    def record(self, u: np.ndarray) -> Record:
        return Record({"u": u}, {"y": self.plant(u)})


B2 = System(
    "b2",
    b2,
    lambda seed: nguyen_widrow(noe("b2", {U: (1, 2)}, Y, (1, 2, 3), (20, 10), seed, bypass=False), seed),
    b2_input,
    (prms(2000, -1, 1, (5, 50), 7), chirp(2000, 1.0, 0.001, 0.05, 1.0)),
    b2_test_input(),
    (200, 500),
    6,
    1e-3,
    2e-3,
    244,
)


def rms(network: Network, records: list[Record]) -> float:
    """RMS error of the free run over all records; inf if one diverges."""
    objective = Objective(network, records)
    squares = objective.squares(objective.theta)
    return float(np.sqrt(squares / objective.samples))


def identify(system: System, seed: int, progress: Progress = silent) -> tuple[Network, dict]:
    """Find the best of the seed's starts on the held-out records; return the network and its figures.

    Figures: training MSE, RMS errors held out and on the test signal, starts tried, CPU seconds.
    """
    began = process_time()
    training, held = [system.record(system.excite(seed))], [system.record(u) for u in system.held]
    best, error, tried = None, np.inf, 0
    while tried < system.starts and error > system.good:
        start = system.start(100 * seed + tried)
        narx = train(start, training, teacher=True, epochs=system.epochs[0], tolerance=1e-3)
        fit = train(narx.network, training, epochs=system.epochs[1], tolerance=1e-4, held=held, patience=200)
        tried += 1
        found = rms(fit.network, held)
        progress(f"{system.name}, seed {seed}, start {tried}: {found:.3g} held out, {fit.outcome.value}")
        if best is None or found < error:
            best, error = fit.network, found
    assert best is not None  # a system has at least one start
    return best, figures(system, best, seed) | {"starts": tried, "cpu_seconds": round(process_time() - began, 1)}


def figures(system: System, network: Network, seed: int) -> dict:
    """Neurons, parameters, training MSE, RMS errors held out and on the test signal."""
    return {
        "neurons": network.neurons(),
        "parameters": parameter_count(network),
        "mse": rms(network, [system.record(system.excite(seed))]) ** 2,
        "held": rms(network, [system.record(u) for u in system.held]),
        "rmse": rms(network, [system.record(system.test)]),
    }


def prune_weights(
    system: System, seed: int, network: Network, allowed: float, weights: Method = obs, progress: Progress = silent
) -> tuple[Network, list[Round]]:
    """Prune to `goal` parameters by a method of saliency.

    allowed: factor by which the RMS error over the held-out records, or `spare` if that is larger, may rise.
    """
    training, held = [system.record(system.excite(seed))], [system.record(u) for u in system.held]
    bound = allowed * max(rms(network, held), system.spare)
    ways = []
    for share in SHARES:  # smaller and smaller rounds, until a result is good on the held-out records
        found = prune_by_saliency(
            network, training, weights, bound, held=held, epochs=60, goal=system.goal, share=share
        )
        free = nonzero(found.network)
        fit = train(found.network, training, epochs=300, tolerance=1e-4, held=held, patience=60, free=free)
        missed = max(parameter_count(found.network) - system.goal, 0)
        ways.append((missed, rms(fit.network, held), fit.network, list(found.rounds)))
        progress(f"{system.name}, {share:.0%} a round: {missed} over the goal, {ways[-1][1]:.3g} held out")
        if not missed and ways[-1][1] <= system.good:
            break
    _, _, smaller, rounds = min(ways, key=lambda way: way[:2])
    return smaller, rounds
