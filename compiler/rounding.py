"""Rounds the weights of a network jointly, so that few signed digits say them and the network still does the same.

A weight of few signed digits (7 = 8 - 1 has two) costs few adders. Rounding one weight alone costs accuracy; rounding
them one after the other, with all those still free correcting what each rounding did, costs far less (optimal brain
surgeon, Hassibi, Stork 1993, with a grid in place of zero). A weight q moves by d to the grid, and with it the others:

    dw = d C e_q / C_qq,    cost = d^2 / (2 C_qq) + price digits,    C = (J'J)^-1

J (samples, weights): slopes of the outputs in free run, feedback included, anew after every few weights. Biases stay
free: a constant costs the same whatever its digits.

All of it is computed portably (models/arithmetic.py): a build is a function of its inputs on every processor.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numba
import numpy as np

from greygate.errors import InputError
from greygate.models.arithmetic import inverse, product
from greygate.models.network import Network
from greygate.models.saliency import nonzero
from greygate.models.simplify import Graph, fold_constants
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record

STAGES = 32  # linearisations on the way; with fewer, a sketch diverges from what the expansion foretells
STEPS = 2  # Gauss-Newton steps of the free weights at each stage
LAST_STEPS = 6  # of the biases, when every weight is rounded
RIDGE = 1e-8  # of the Hessian's mean diagonal; less, and steps follow directions that rounding of floats made up
TRIES = 8  # dampings that a Gauss-Newton step tries, each ten times the last
MOST_DIGITS = 8  # of one weight
BITS = 14  # significant bits of the largest weight of a port; smaller weights share its grid
CHEAPEST, DEAREST = -9, -5  # decades of the price
PER_DECADE = 2


@dataclass(frozen=True)
class Rounded:
    """A network whose weights are sums of few signed powers of two.

    price: what a digit was allowed to cost, as a share of the outputs' mean square. digits: signed digits of all free
    weights. error: RMS of what rounding did to the outputs, over the RMS of the outputs, on the records.
    """

    network: Network
    price: float
    digits: int
    error: float


def prices() -> list[float]:
    """The prices that are tried, the most accurate first."""
    count = (DEAREST - CHEAPEST) * PER_DECADE + 1
    return [float(f"1e{CHEAPEST}") * 10.0 ** (k // PER_DECADE) * (1.0, 3.0)[k % PER_DECADE] for k in range(count)]


def round_jointly(
    network: Network, records: Sequence[Record], price: float, bits: int = BITS, stages: int = STAGES
) -> Rounded:
    """Round all free weights of a network so that a digit less is worth `price`.

    price: rise of the outputs' mean squared error that a signed digit may cost, as a share of their mean square; from
    1e-9 (every digit counts) to 1e-5 (a sketch). bits: significant bits of the largest weight of each port of a layer.
    stages: linearisations on the way. records: what the network is run on; their targets do not matter, since the
    outputs are to stay as they are. A neuron that nothing reads any more is removed.
    Raises InputError if the network diverges on a record.
    """
    flat = fold_constants(network).flatten()
    if not any(len(r) for r in records):
        raise InputError(f"network {network.name}: no record to round its weights on")
    own = [replace(r, targets=_shown(flat, r)) for r in records]
    objective = Objective(flat, own, free=nonzero(flat), portable=True)
    rounder = _Rounder(objective, price, bits, stages)
    best = min((rounder.rounded(by_cost) for by_cost in (False, True)), key=lambda found: found[1])
    theta, _ = best
    error = math.sqrt(rounder.squares(theta) / rounder.power)
    slim = without_dead(objective.unpack(theta))
    names = [n for n, columns in objective.slices().items() if rounder.grid[columns].any()]
    values = np.concatenate([slim.parameters()[n].ravel() for n in names]) if names else np.zeros(0)
    return Rounded(slim, price, sum(signed_digits(_odd(v)) for v in values.tolist()), error)


def signed_digits(code: int) -> int:
    """Digits other than zero of an integer in canonical signed digits."""
    return (3 * abs(code) ^ abs(code)).bit_count()


def _odd(value: float) -> int:
    """A float as an integer times some power of two."""
    return int(math.ldexp(math.frexp(value)[0], 53))


def _shown(flat: Network, record: Record) -> dict[str, np.ndarray]:
    """The outputs of the network over a record, by port, in physical units."""
    objective = Objective(flat, [record])
    runs = objective.simulate(objective.theta)
    if runs is None:
        raise InputError(f"network {flat.name}: diverges on a record; train it before rounding")
    columns, feeds = objective.elements(), flat.feeds()
    found = {p.name: runs[0][:, columns[feeds[p.name][0]]] * p.scale + p.offset for p in flat.outputs}
    return {p.name: found[p.name][:, 0] if p.size == 1 else found[p.name] for p in flat.outputs}


class _Rounder:
    """The weights of one objective, and how to round them at a price."""

    def __init__(self, objective: Objective, price: float, bits: int, stages: int):
        self.objective, self.start, self.stages = objective, objective.theta, stages
        self.power = max(_sum_of_squares([w.target[w.skip :] for w in objective.windows]), 1e-300)
        self.price = price * self.power / 2
        self.grid = np.zeros(len(self.start))  # 0 for what is not rounded
        may_move = np.zeros(len(self.start), bool)
        may_move[objective.free] = True
        for name, columns in objective.slices().items():
            chosen = columns[may_move[columns]]
            if name.endswith(".bias") or not len(chosen):
                continue
            largest = float(np.abs(self.start[chosen]).max())
            self.grid[chosen] = math.ldexp(1.0, math.frexp(largest)[1] - (bits - 1)) if largest else 0.0

    def squares(self, theta: np.ndarray) -> float:
        """Sum of squared errors of the outputs; inf where the run diverges."""
        errors = self.objective.errors(theta)
        if errors is None:
            return math.inf
        total = _sum_of_squares([e[w.skip :] for e, w in zip(errors, self.objective.windows, strict=True)])
        return total if math.isfinite(total) else math.inf

    def digits(self, theta: np.ndarray) -> int:
        """Signed digits of the weights on the grid."""
        on = self.grid > 0
        return int(sum(signed_digits(int(c)) for c in np.rint(theta[on] / self.grid[on])))

    def rounded(self, by_cost: bool) -> tuple[np.ndarray, float]:
        """theta with all weights on the grid, and half its squared error plus the price of its digits.

        by_cost: round first what is cheapest in error and digits together, else in error alone.
        """
        theta, left = self.start.copy(), self.grid > 0
        free = np.zeros(len(theta), bool)
        free[self.objective.free] = True
        count = -(-int(left.sum()) // self.stages)
        while left.any():
            theta, fixed = self._some_fixed(theta, free, left, min(count, int(left.sum())), by_cost)
            free[fixed] = left[fixed] = False
            theta = self._corrected(theta, free, STEPS if left.any() else LAST_STEPS)
        return theta, self.squares(theta) / 2 + self.price * self.digits(theta)

    def _hessian(self, theta: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """J'J and J'e of the free parameters, and the mean diagonal. Call after `squares` at the same theta."""
        hessian, gradient = self.objective.normal_equations(theta)
        chosen = free[self.objective.free]
        hessian, gradient = hessian[np.ix_(chosen, chosen)], gradient[chosen]
        scale = float(_sum_of_squares([np.sqrt(np.maximum(np.diag(hessian), 0.0))[:, None]])) / max(len(hessian), 1)
        return hessian, gradient, scale or 1.0

    def _corrected(self, theta: np.ndarray, free: np.ndarray, steps: int) -> np.ndarray:
        """theta after Gauss-Newton steps of the free parameters, each damped until the error falls."""
        at = np.flatnonzero(free)
        if not len(at):
            return theta
        least, damping = self.squares(theta), RIDGE
        for _ in range(steps):
            self.squares(theta)
            hessian, gradient, scale = self._hessian(theta, free)
            for _ in range(TRIES):
                trial = theta.copy()
                trial[at] -= product(inverse(hessian + damping * scale * np.eye(len(at))), gradient)
                found = self.squares(trial)
                if found < least:
                    theta, least, damping = trial, found, max(damping / 10, RIDGE)
                    break
                damping *= 10
            else:
                break
        return theta

    def _some_fixed(
        self, theta: np.ndarray, free: np.ndarray, left: np.ndarray, count: int, by_cost: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """theta with `count` more weights on the grid, the free ones moved to make up for it; and which those are."""
        at = np.flatnonzero(free)
        self.squares(theta)
        hessian, _, scale = self._hessian(theta, free)
        covariance = inverse(hessian + RIDGE * scale * np.eye(len(at)))
        values = theta[at].copy()
        fixed = _fix(covariance, values, self.grid[at], left[at], count, self.price, by_cost)
        moved = theta.copy()
        moved[at] = values
        if not self.squares(moved) < math.inf:  # the expansion led astray: keep the others where they were
            moved = theta.copy()
            moved[at[fixed]] = values[fixed]
        return moved, at[fixed]


def without_dead(flat: Network) -> Network:
    """A flat network without the neurons that nothing reads, and without those that read nothing.

    Of the latter the constant is added to the biases of their readers.
    """
    while True:
        graph = Graph(flat)
        shown = graph.shown()
        for name, layer in list(graph.layers.items()):
            readers = list(graph.readers(name))
            if name in shown or layer.function.rows > 1 or not readers:
                continue
            if any(delay or graph.layers[r].size == 0 for r, _, delay in readers):
                continue
            read = np.any([np.any(graph.layers[r].weights[p] != 0, axis=0) for r, p, _ in readers], axis=0)
            keep = np.flatnonzero(read)
            if 0 < len(keep) < layer.size:
                _keep(graph, name, keep)
                break
        else:
            return flat
        flat = graph.network()


def _keep(graph: Graph, name: str, keep: np.ndarray) -> None:
    """Leave only these neurons of a layer."""
    for reader, port, _ in graph.readers(name):
        layer = graph.layers[reader]
        graph.layers[reader] = replace(layer, weights=layer.weights | {port: layer.weights[port][:, keep]})
    layer = graph.layers[name]
    own = {p: w[keep] for p, w in layer.weights.items()}
    graph.layers[name] = replace(layer, weights=own, bias=layer.bias[keep], initial=layer.initial[keep])


@numba.njit(cache=True, nogil=True)
def _nearest_power(x, grid):  # pragma: no cover - compiled
    """The signed power of two nearest to x, at least the grid."""
    power = math.ldexp(1.0, math.frexp(abs(x) / 0.75)[1] - 1)
    return math.copysign(max(power, grid), x)


@numba.njit(cache=True, nogil=True)
def _fix(covariance, values, grid, left, count, price, by_cost):  # pragma: no cover - compiled
    """Round `count` of the values for which `left`, the cheapest first; correct the others. Changes its arrays.

    Returns the places of those that were rounded.
    """
    size, fixed = len(values), np.zeros(count, np.int64)
    waiting = left.copy()
    for n in range(count):
        best, chosen, to = np.inf, -1, 0.0
        for i in range(size):
            if not waiting[i]:
                continue
            spread, x = covariance[i, i], values[i]
            cheapest, at, loss = np.inf, 0.0, np.inf
            v = 0.0
            for digits in range(MOST_DIGITS + 1):
                rise = (v - x) * (v - x) / (2.0 * spread)
                if rise + price * digits < cheapest:
                    cheapest, at, loss = rise + price * digits, v, rise
                if abs(x - v) < grid[i] / 2:
                    break
                v += _nearest_power(x - v, grid[i])
            key = cheapest if by_cost else loss
            if key < best:
                best, chosen, to = key, i, at
        fixed[n] = chosen
        spread = covariance[chosen, chosen]
        share = covariance[:, chosen] / spread
        step = to - values[chosen]
        for i in range(size):
            values[i] += share[i] * step
        values[chosen] = to
        row = covariance[chosen].copy()
        for i in range(size):
            if share[i] != 0.0:
                for j in range(size):
                    covariance[i, j] -= share[i] * row[j]
        covariance[chosen, :] = 0.0
        covariance[:, chosen] = 0.0
        waiting[chosen] = False
    return fixed


@numba.njit(cache=True, nogil=True)
def _squares(a):  # pragma: no cover - compiled
    total = 0.0
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            total += a[i, j] * a[i, j]
    return total


def _sum_of_squares(parts: Sequence[np.ndarray]) -> float:
    """Sum of the squares of every element, added one after the other."""
    return float(sum(_squares(np.ascontiguousarray(p)) for p in parts))
