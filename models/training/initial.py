"""The state in which a recording begins: fitted to its first samples, or where a network rests."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from greygate.errors import InputError
from greygate.models.network import Network
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record

PRIOR = 1e-4  # weight of the square of (state - rest), normalised, against one squared normalised error
STEPS = 30


def initialised(network: Network, record: Record) -> Record:
    """The record with the initial state that fits its first `skip` samples best; the weights stay as they are.

    By Gauss-Newton with halved steps.
    """
    held = {name: np.zeros(w.shape, bool) for name, w in network.flatten().parameters().items()}
    if record.skip < 1:
        return record
    window = record.cut(0, record.skip, skip=0)
    try:
        objective = Objective(network, [window], free=held, estimate_initial=True)
    except InputError:  # shorter than the delays: nothing to settle in
        return record
    rest = objective.theta[objective.free]
    if not len(rest):  # it remembers inputs alone, and those are known
        return record

    def cost(theta):
        return objective.squares(theta) + PRIOR * float(np.sum((theta[objective.free] - rest) ** 2))

    value = cost(objective.theta)
    for _ in range(STEPS):
        objective.squares(objective.theta)
        hessian, gradient = objective.normal_equations(objective.theta)
        gradient += PRIOR * (objective.theta[objective.free] - rest)
        try:
            step = -np.linalg.solve(hessian + PRIOR * np.eye(len(rest)), gradient)
        except np.linalg.LinAlgError:  # the run explodes: no state is better than another
            break
        while (trial := cost(objective.moved(objective.theta, step))) > value and np.abs(step).max() > 1e-9:
            step /= 2
        if not trial < value:
            break
        objective.theta, value = objective.moved(objective.theta, step), trial
    return replace(record, initial={**record.initial, **objective.initial(objective.theta)[0]})


def resting(network: Network, initial: Mapping[str, np.ndarray]) -> Network:
    """The flat network whose layers start, in hardware too, from a state of `Trained.initial` (its newest step)."""
    flat = network.flatten()
    modules = {n: replace(layer, initial=initial[n][-1]) for n, layer in flat.modules.items()}
    return replace(flat, modules=modules)
