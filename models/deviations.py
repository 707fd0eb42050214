"""How well records determine the weights: standard deviations from J'J at the optimum."""

from collections.abc import Sequence

import numpy as np

from greygate.models.network import Network
from greygate.models.training.levenberg import RUNAWAY
from greygate.models.training.loss import Loss
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record

SINGULAR = 1e-12  # least eigenvalue of J'J, its diagonal scaled to one: what is below it is not determined


def deviations(network: Network, records: Sequence[Record], decay: float = 0.0) -> dict[str, tuple[float, float]]:
    """Every weight that moves, `layer.port[i, j]` -> (value, standard deviation), both normalised.

    For a residual that is white (Ljung 1999, 9.4): the covariance is s^2 (J'J + D)^-1 J'J (J'J + D)^-1, s^2 the sum of
    squares over samples less weights. decay: D. Initial states count as known. Empty where a free run
    diverges. Raises InputError as `Objective`.
    """
    objective = Objective(network, records)
    squares = objective.squares(objective.theta)
    if not squares <= RUNAWAY * 2 * objective.samples * objective.power:
        return {}
    squared, _ = objective.normal_equations(objective.theta)
    damped = squared + np.diag(Loss(objective, network, decay, {}).decay)
    size = np.sqrt(np.diag(damped))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(damped / np.outer(size, size))
    inverse = vectors / np.maximum(values, SINGULAR) @ vectors.T / np.outer(size, size)
    spread = squares / max(objective.samples - len(objective.free), 1) * (inverse @ squared @ inverse)
    theta, sizes = objective.theta[objective.free], np.sqrt(np.maximum(np.diag(spread), 0.0))
    silent = np.diag(squared) == 0.0  # what no output feels has no value that could be told
    names = _names(objective)
    return {
        names[place]: (float(v), float("inf") if mute else float(s))
        for place, v, s, mute in zip(objective.free.tolist(), theta, sizes, silent, strict=True)
    }


def _names(objective: Objective) -> dict[int, str]:
    """Column of theta -> the name of that weight."""
    shapes = {n: v.shape for n, v in objective.flat.parameters().items()}
    return {
        int(column): f"{name}[{', '.join(map(str, at))}]"
        for name, columns in objective.slices().items()
        for column, at in zip(columns, np.ndindex(shapes[name]), strict=True)
    }
