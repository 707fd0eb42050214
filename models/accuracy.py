"""How far a network's prediction is from what was measured: errors of the free run, and their root mean squares."""

import math
from collections.abc import Sequence

import numpy as np

from greygate.errors import InputError
from greygate.models.arithmetic import mean
from greygate.models.network import Network
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record
from greygate.plain import Figure

Errors = dict[str, dict[str, Figure]]  # recording -> output -> RMS


def rms(error: np.ndarray, skip: int = 0) -> float:
    """Root mean square of an error (N, ...) from sample `skip` on; inf where it is not finite."""
    return float(_rms(np.asarray(error)[skip:], None))


def rms_by_column(error: np.ndarray) -> np.ndarray:
    """Root mean square of each column of an error (N, columns) -> (columns,); inf where it is not finite."""
    return _rms(np.asarray(error), 0)


def _rms(error: np.ndarray, axis: int | None) -> np.ndarray:
    with np.errstate(over="ignore", invalid="ignore"):  # what is finite may still be too large to square
        found = np.sqrt(np.mean(np.square(error), axis=axis))
    return np.where(np.isfinite(found), found, np.inf)


def portable_rms(error: np.ndarray, skip: int = 0) -> float:
    """`rms` with the same bits on every processor, for what decides a build (`models.arithmetic`)."""
    return math.sqrt(float(mean(error[skip:].ravel() ** 2)))


def float_error(network: Network, record: Record) -> dict[str, np.ndarray]:
    """Free-run prediction less target, by output, in physical units, (N,) or (N, size).

    Raises InputError where the run diverges.
    """
    objective = Objective(network, [record])
    errors = objective.errors(objective.theta)
    if errors is None:
        raise InputError(f"network {network.name}: diverges on the record")
    ends = np.cumsum([p.size for p in objective.flat.outputs])[:-1]
    parts = zip(objective.flat.outputs, np.split(errors[0], ends, axis=1), strict=True)
    return {p.name: (e if p.size > 1 else e[:, 0]) * p.scale for p, e in parts}


def free_run_rms(network: Network, record: Record) -> dict[str, float]:
    """RMS error of a free run from `record.skip` on, by output, in its unit; inf where the run diverges."""
    try:
        errors = float_error(network, record)
    except InputError:
        return {port.name: math.inf for port in network.outputs}
    return {name: rms(e, record.skip) for name, e in errors.items()}


def pooled_rms(network: Network, records: Sequence[Record]) -> np.ndarray:
    """RMS error over all records, normalised, of each output column; inf where a run diverges."""
    objective = Objective(network, records)
    errors = objective.errors(objective.theta)
    if errors is None:
        return np.full(sum(p.size for p in objective.flat.outputs), np.inf)
    return rms_by_column(np.concatenate([e[r.skip :] for e, r in zip(errors, records, strict=True)]))


def rmse(network: Network, record: Record) -> float:
    """Root mean square of free run less recording, from `record.skip` on.

    In the unit of the output, of which there is one; inf if it diverges. Raises InputError as `Objective`.
    """
    objective = Objective(network, [record])
    errors = objective.errors(objective.theta)
    if errors is None:
        return np.inf
    return network.outputs[0].scale * rms(errors[0], record.skip)
