"""Finds the orders of a regression from the record alone, by Lipschitz quotients (He, Asada 1993; thesis 5.3.1).

If y = g(phi) is smooth, |y_i - y_j| / |phi_i - phi_j| stays small. If phi lacks a regressor that g needs, one phi has
two values of y, and the largest quotients become very large. A superfluous regressor changes them little.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial.distance import pdist

from greygate.errors import InputError
from greygate.models.families.regression import Taps, regressors
from greygate.models.network import Port
from greygate.models.training.record import Record

from .linear import faults

SHARE = 0.015  # of the rows: number of the largest quotients that count (He and Asada: 0.01 to 0.02)


@dataclass(frozen=True)
class Orders:
    """Order index of every candidate, and the taps proposed, ready for `narx(name, inputs, output, feedback)`.

    index: one axis for each of `signals` (inputs, then the output): the number of its candidate taps that are used,
    from 0 on. The corner where none is used is inf.
    curve: (T,), the lowest index with 1, 2, ... T taps in all. It falls steeply to the order, its knee, and is flat
    from there.
    """

    signals: tuple[str, ...]
    index: np.ndarray
    curve: np.ndarray
    inputs: dict[Port, tuple[int, ...]]
    feedback: tuple[int, ...]


def lipschitz(
    records: Sequence[Record],
    inputs: Taps,
    output: Port,
    feedback: Sequence[int],
    fall: float = 1.6,
    samples: int = 1000,
) -> Orders:
    """Order index of the first n taps of each input and of the output, for every combination of n.

    index = (prod_(i <= p) sqrt(T) q_i)^(1/p) for T taps, where q_i are the p = 0.015 M largest quotients over all pairs
    of M rows; every signal is divided by its standard deviation. The proposal is the knee of `Orders.curve`: the last
    tap that still divides the curve by `fall`. Of the combinations with that number of taps it takes the one with the
    lowest index. Noise and weak terms flatten the knee: look at the curve, and choose between neighbours by the error
    in free run.
    inputs, feedback: the candidates, in order, such as {u: range(1, 6)}, range(1, 6). samples: number of rows to
    compare, spread evenly. Raises InputError as `regressors`, for constant signals and for too few rows.
    """
    phi = regressors(records, inputs, output, feedback)
    names = [p.name for p in inputs] + [output.name]
    rows, columns = phi.matrix.shape
    if rows <= columns + 1:
        raise InputError(f"{faults(phi)[0]} of the candidates")
    used = np.unique(np.linspace(0, rows - 1, min(samples, rows)).astype(int))
    target = phi.target[used]
    of = [tap.rpartition("_z")[0] for tap in phi.taps]
    spread = {n: np.std(phi.matrix[:, [i for i, m in enumerate(of) if m == n]]) for n in set(of)}
    for name, value in (spread | {output.name: np.std(target)}).items():
        if value <= 1e-12:
            raise InputError(f"signal {name} is constant: nothing can be learnt from it; excite it or leave it out")
    between = {n: [np.zeros(len(used) * (len(used) - 1) // 2)] for n in names}
    for tap, name in enumerate(of):
        between[name].append(between[name][-1] + pdist(phi.matrix[used, tap : tap + 1] / spread[name], "sqeuclidean"))
    differ = pdist(target[:, None] / np.std(target))
    count = max(1, round(SHARE * len(used)))
    index = np.full([len(between[n]) for n in names], np.inf)
    for orders in product(*map(range, index.shape)):
        if any(orders):
            distance = np.sqrt(sum(between[n][order] for n, order in zip(names, orders, strict=True)))
            quotients = differ / np.maximum(distance, 1e-12)
            largest = np.partition(quotients, -count)[-count:]
            index[orders] = np.sqrt(sum(orders)) * np.exp(np.mean(np.log(np.maximum(largest, 1e-300))))
    taps = np.indices(index.shape).sum(axis=0)
    curve = np.array([index[taps == t].min() for t in range(1, taps.max() + 1)])
    knee = 1 + max(np.flatnonzero(curve[:-1] >= fall * curve[1:]) + 1, default=0)
    chosen = np.unravel_index(np.argmin(np.where(taps == knee, index, np.inf)), index.shape)
    proposed = {p: tuple(inputs[p])[:n] for p, n in zip(inputs, chosen, strict=False)}
    return Orders(tuple(names), index, curve, proposed, tuple(feedback)[: chosen[-1]])
