"""Prunes single weights by saliency, after `prune.py` has removed neurons by entropy.

A method chooses the weights whose removal costs least, and corrects the others to compensate. It expands the loss to
second order about the trained weights: E(theta + d) = E + d'Hd / 2, where H = J'J + D + ridge and D is the weight decay
of the training (Hansen, Pedersen 1994; Norgaard 2000). A weight of zero counts as pruned everywhere; `nonzero` keeps it
at zero in training.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg

from greygate.errors import InputError
from greygate.models.accuracy import pooled_rms
from greygate.models.cores import blas
from greygate.models.network import Network
from greygate.models.prune import Pruning, Round, retrained, spareable
from greygate.models.simplify import Graph, fold_constants, parameter_count
from greygate.models.training.objective import Objective, traces
from greygate.models.training.record import Record
from greygate.progress import Progress, silent

RIDGES = (1e-8, 1e-6, 1e-4, 1e-2)  # of the Hessian, times its mean diagonal
"""With a small one a step goes too far where the loss is no quadratic."""
POPULATION, GENERATIONS = 16, 10  # of sets of weights that compete
MUTATED = 0.05  # share of what both parents remove that a child gives back
NEAR = 3  # times the weights to remove: among so many of the least saliency others are drawn


def nonzero(network: Network) -> dict[str, np.ndarray]:
    """{parameter: bool array}, for `train(..., free=...)`: pruned weights, which are zero, stay zero."""
    return {name: value != 0 for name, value in network.flatten().parameters().items()}


@dataclass(frozen=True, eq=False)
class Unit:
    """A hidden neuron. outgoing: (n,) its weights in the layers that read it, as positions in `Expansion.weights`.

    cost: number of parameters that are removed with it.
    """

    layer: str
    index: int
    outgoing: np.ndarray
    cost: int


@dataclass(frozen=True)
class Expansion:
    """Half the sum of squared errors to second order about the trained weights, over those that may be removed.

    theta: (P,) all parameters. weights: (M,) those neither frozen nor pruned, as indices of theta. curvature: (M, M)
    J'J. ridge: this multiple of the curvature's mean diagonal is added to the diagonal, because weights on which
    nothing depends make the curvature singular.
    """

    objective: Objective
    theta: np.ndarray
    weights: np.ndarray
    curvature: np.ndarray
    decay: float = 0.0
    ridge: float = RIDGES[0]

    @staticmethod
    def of(network: Network, records: Sequence[Record], decay: float = 0.0, ridge: float = RIDGES[0]) -> "Expansion":
        """Expand the loss of a trained network. Raises InputError if its free run diverges on a record."""
        network = fold_constants(network)
        objective = Objective(network, list(records), free=nonzero(network))
        if not np.isfinite(objective.squares(objective.theta)):
            raise InputError(f"network {network.name}: diverges on a record; train it before pruning")
        curvature, _ = objective.normal_equations(objective.theta)
        return Expansion(objective, objective.theta, objective.free, curvature, decay, ridge)

    @cached_property
    def squares(self) -> float:
        """Sum of squared errors of the trained weights."""
        return self.objective.squares(self.theta)

    @property
    def values(self) -> np.ndarray:
        """The weights that may be removed, (M,)."""
        return self.theta[self.weights]

    @cached_property
    def hessian(self) -> np.ndarray:
        """(M, M) J'J + D + ridge."""
        mean = np.trace(self.curvature) / len(self.curvature)
        return self.curvature + (self.decay + self.ridge * (mean or 1.0)) * np.eye(len(self.curvature))

    @cached_property
    def inverse(self) -> np.ndarray:
        """(M, M) H^-1. Raises InputError if H is singular."""
        try:
            factor = scipy.linalg.cho_factor(self.hessian)
        except scipy.linalg.LinAlgError:
            raise InputError(
                "the Hessian is singular: some weights act alike or have no effect; give a ridge > 0"
            ) from None
        return scipy.linalg.cho_solve(factor, np.eye(len(self.hessian)))

    @cached_property
    def units(self) -> list[Unit]:
        """The hidden neurons whose outgoing weights may all be removed."""
        flat, place = self.objective.flat, self.objective.slices()
        graph = Graph(flat)
        position = np.full(len(self.theta), -1)
        position[self.weights] = np.arange(len(self.weights))
        found = []
        for name, layer in flat.layers().items():
            if name in graph.shown() or not spareable(layer):
                continue
            read = [place[f"{r}.{p}"].reshape(-1, layer.size) for r, p, _ in graph.readers(name)]
            own = [place[f"{name}.{p}"].reshape(layer.size, -1) for p in (*layer.weights, "bias")]
            for i in range(layer.size):
                columns = np.unique(np.concatenate([r[:, i] for r in read]))
                outgoing = position[columns[self.theta[columns] != 0]]
                if (outgoing >= 0).all():
                    rows = np.concatenate([o[i] for o in own])
                    found.append(Unit(name, i, outgoing, int(np.count_nonzero(self.theta[np.union1d(columns, rows)]))))
        return found


@dataclass(frozen=True)
class Removal:
    """The weights that a method removes.

    weights: (q,) indices of theta, cheapest first. saliency: (q,) of each, or of its neuron, in the method's measure.
    theta: (P,) the parameters after the removal.
    """

    weights: np.ndarray
    saliency: np.ndarray
    theta: np.ndarray


Method = Callable[[Expansion, int], Removal]  # int: parameters to remove; a method that removes neurons may exceed it


def magnitude(e: Expansion, count: int) -> Removal:
    """Remove the smallest weights."""
    return _least(e, np.abs(e.values), count)


def obd(e: Expansion, count: int) -> Removal:
    """Optimal brain damage (LeCun, Denker, Solla 1990): saliency w^2 (H_ww / 2 + D), without interactions.

    The decay D counts in full, not half, because at the minimum of error and decay the slope of the error alone is -D w
    (Pedersen, Hansen, Larsen 1996).
    """
    return _least(e, (np.diag(e.curvature) / 2 + e.decay) * e.values**2, count)


def obs(e: Expansion, count: int) -> Removal:
    """Optimal brain surgeon (Hassibi, Stork 1993): remove one weight after the other and correct all others each time.

    H^-1 is not computed anew in between; each removed weight is a rank-one change of it.
    """
    surgery, removed, saliency = _Surgery(e), [], []
    for _ in range(min(count, len(e.weights))):
        rises = surgery.saliencies()
        removed.append(int(np.argmin(rises)))
        saliency.append(rises[removed[-1]])
        surgery.remove(removed[-1:])
    return surgery.removal(removed, saliency)


def multi_obs(e: Expansion, count: int) -> Removal:
    """Optimal brain surgeon for a set: remove the weights of least saliency at once, and correct the others jointly.

    It is faster than `obs`, but does not notice that one weight can replace another.
    """
    surgery = _Surgery(e)
    rises = surgery.saliencies()
    removed = np.argsort(rises, kind="stable")[:count]
    surgery.remove(removed)
    return surgery.removal(removed, rises[removed])


def unit_obs(e: Expansion, count: int) -> Removal:
    """Unit-OBS (Stahlberger, Riedmiller 1997): remove neurons, each with all its outgoing weights at once."""
    surgery, removed, saliency = _Surgery(e), [], []
    left, gone = list(e.units), 0
    while gone < count and left:
        rises = [surgery.saliency(u.outgoing) for u in left]
        unit = left.pop(int(np.argmin(rises)))
        gone += unit.cost
        removed += unit.outgoing.tolist()
        saliency += [min(rises)] * len(unit.outgoing)
        surgery.remove(unit.outgoing)
    return surgery.removal(removed, saliency)


def smallest_variance(e: Expansion, count: int) -> Removal:
    """Remove the neurons that vary least over the records (Sietsma, Dow 1991).

    The mean of each is added to the biases of the layers that read it. A neuron that feeds a layer with a frozen bias
    stays.
    """
    flat, place, theta = e.objective.flat, e.objective.slices(), e.theta.copy()
    graph = Graph(flat)
    run = np.concatenate(traces(e.objective))
    columns = e.objective.elements()
    signal = {u: run[:, columns[u.layer][u.index]] for u in e.units}
    removed, saliency, gone = [], [], 0
    for unit in sorted(e.units, key=lambda u: signal[u].var()):
        readers = graph.readers(unit.layer)
        if any("bias" in graph.layers[reader].frozen for reader, _, _ in readers):
            continue
        if gone >= count:
            break
        gone += unit.cost
        removed += unit.outgoing.tolist()
        saliency += [signal[unit].var()] * len(unit.outgoing)
        for reader, port, _ in readers:
            w = e.theta[place[f"{reader}.{port}"]].reshape(-1, graph.layers[unit.layer].size)[:, unit.index]
            theta[place[f"{reader}.bias"]] += w * signal[unit].mean()
    theta[e.weights[removed]] = 0.0
    return Removal(e.weights[removed], np.array(saliency), theta)


def perturbation(e: Expansion, count: int) -> Removal:
    """Set each weight to zero in turn, run the network over the records, and remove those that raise the error least.

    Nothing is expanded: it sees what a weight does as a whole, though not what two do together.
    """
    return _least(e, np.array([_rise(e, [j]) for j in range(len(e.weights))]), count)


def evolution(e: Expansion, count: int) -> Removal:
    """Sets of weights compete by the error of a run without them (Siebel, Boetel, Sommer 2009), from those of `obd`.

    A child keeps what both parents remove, draws the rest from what either does, and exchanges a few for weights of
    little saliency. The draws are the same on every run.
    """
    rng, order = np.random.default_rng(0), obd(e, len(e.weights)).weights
    count = min(count, len(order))
    ranked = np.searchsorted(e.weights, order)  # positions in e.weights, the least saliency first
    near = ranked[: NEAR * count]

    def drawn(sure: np.ndarray, among: np.ndarray) -> tuple[float, np.ndarray]:
        rest = np.setdiff1d(among, sure)
        chosen = np.union1d(sure, rng.choice(rest, min(count - len(sure), len(rest)), replace=False))
        return _rise(e, chosen), chosen

    nobody = np.zeros(0, int)
    sets = [drawn(ranked[:count], nobody), *(drawn(nobody, near) for _ in range(POPULATION - 1))]
    for _ in range(GENERATIONS if count < len(order) else 0):
        for _ in range(POPULATION):
            one, other = (sets[i][1] for i in rng.choice(len(sets), 2, replace=False))
            both = np.intersect1d(one, other)
            sure = both[rng.random(len(both)) >= MUTATED]
            either = np.concatenate([np.union1d(one, other), rng.choice(near, max(count // POPULATION, 1))])
            sets.append(drawn(sure, either))
        sets = sorted(sets, key=lambda found: found[0])[:POPULATION]
    rise, chosen = min(sets, key=lambda found: found[0])
    chosen = ranked[np.isin(ranked, chosen)]
    theta = e.theta.copy()
    theta[e.weights[chosen]] = 0.0
    return Removal(e.weights[chosen], np.full(len(chosen), rise), theta)


def _rise(e: Expansion, chosen: Sequence[int] | np.ndarray) -> float:
    """By how much half the sum of squared errors rises without the weights `chosen`; inf where the run diverges."""
    theta = e.theta.copy()
    theta[e.weights[chosen]] = 0.0
    return (e.objective.squares(theta) - e.squares) / 2


METHODS: dict[str, Method] = {
    method.__name__: method
    for method in (magnitude, obd, obs, multi_obs, unit_obs, smallest_variance, perturbation, evolution)
}
UNRIDGED = magnitude, obd, smallest_variance, perturbation, evolution  # methods that ask nothing of the ridge


def _least(e: Expansion, saliency: np.ndarray, count: int) -> Removal:
    order = np.argsort(saliency, kind="stable")[:count]
    theta = e.theta.copy()
    theta[e.weights[order]] = 0.0
    return Removal(e.weights[order], saliency[order], theta)


class _Surgery:
    """The weights, and H^-1 of the remaining ones, while sets of weights are removed one after the other."""

    def __init__(self, e: Expansion):
        self.expansion, self.values, self.inverse, self.decay = e, e.values, e.inverse.copy(), e.decay
        self.least = 1 / np.diag(e.hessian)  # a lower bound of the diagonal of the inverse
        self.left = np.ones(len(self.values), bool)

    def saliencies(self) -> np.ndarray:
        """(M,) rise of half the sum of squared errors by removing each weight alone; inf for removed weights.

        With decay the error is not at its minimum, so that its slope -D theta counts too (Hansen, Pedersen 1994).
        """
        diagonal = np.maximum(np.diag(self.inverse), self.least)
        pull = self.values / diagonal
        rise = pull**2 * diagonal / 2
        if self.decay:
            own = np.einsum("ij,ij->i", self.inverse, self.inverse)
            rise += self.decay * (pull * (self.inverse @ self.values) - pull**2 * own / 2)
        return np.where(self.left, rise, np.inf)

    def saliency(self, chosen: np.ndarray) -> float:
        """Rise of half the sum of squared errors by removing a set jointly."""
        columns = self.inverse[:, chosen]
        pull = np.linalg.solve(columns[chosen], self.values[chosen])
        step = columns @ pull
        return float(pull @ self.values[chosen] / 2 + self.decay * (step @ self.values - step @ step / 2))

    def remove(self, chosen: Sequence[int] | np.ndarray) -> None:
        """Set a set of weights to zero, and move the others to the remaining minimum."""
        columns = self.inverse[:, chosen]
        share = np.linalg.solve(columns[chosen], columns.T)
        self.values = self.values - self.values[chosen] @ share
        self.inverse -= columns @ share
        self.left[chosen] = False
        self.values[~self.left] = 0.0
        self.inverse[~self.left] = 0.0
        self.inverse[:, ~self.left] = 0.0

    def removal(self, removed: Sequence[int] | np.ndarray, saliency: Sequence[float] | np.ndarray) -> Removal:
        e = self.expansion
        theta = e.theta.copy()
        theta[e.weights] = self.values
        return Removal(e.weights[list(removed)], np.array(saliency), theta)


@dataclass(frozen=True)
class Stage:
    """One network of a pruning. error: RMS of each output over the records, normalised; held: over held-out ones."""

    network: Network
    parameters: int
    neurons: int
    error: tuple[float, ...]
    held: tuple[float, ...] = ()


@dataclass(frozen=True)
class Pruned:
    """The result of pruning.

    steps: the given network, then every network that was kept. rounds: every attempt, with the weights that it removed.
    """

    steps: tuple[Stage, ...]
    rounds: tuple[Round, ...]

    @property
    def network(self) -> Network:
        """The smallest network within the allowed error; the given one if there is no smaller one."""
        return self.steps[-1].network

    def at(self, parameters: int) -> Network:
        """The largest network with at most this many parameters. Raises InputError if there is none."""
        for step in self.steps:
            if step.parameters <= parameters:
                return step.network
        raise InputError(f"no network of {parameters} parameters or fewer; the smallest has {step.parameters}")


def prune_by_saliency(
    network: Network,
    records: Sequence[Record],
    method: Method,
    allowed: np.ndarray | float,
    *,
    held: Sequence[Record] = (),
    epochs: int = 20,
    decay: float = 0.0,
    share: float = 0.1,
    goal: int = 0,
    progress: Progress = silent,
) -> Pruned:
    """Remove weights and train the rest again, round after round, until the error would exceed `allowed`.

    allowed: RMS error of each output, normalised, over the held-out records, or over `records` if none are held out.
    A round removes `share` of the parameters. A round that exceeds `allowed` is undone, and the next one removes half
    as many; pruning ends when not even a single weight (or neuron) can be removed. epochs, decay: of each training; the
    network should come from a training with the same decay. Held-out records also choose the epoch. Each round takes
    the ridge with the least error after removal and before training. goal: end at this number of parameters. Frozen
    weights stay. Ctrl-C ends the pruning.
    Raises InputError if the network diverges on a record.
    """
    with blas().limit(limits=1, user_api="blas"):
        steps = [_step(fold_constants(network), records, held)]
        rounds: list[Round] = []
        batch, undone = max(1, round(share * steps[0].parameters)), np.array([])
        while steps[-1].parameters > goal:
            e = Expansion.of(steps[-1].network, records, decay)
            if not len(e.weights):
                break
            removal = _safest(e, method, min(batch, steps[-1].parameters - goal))
            if not len(removal.weights):
                break
            kept = False
            if not np.array_equal(removal.weights, undone):  # half as many parameters may be the same neuron
                smaller = fold_constants(e.objective.unpack(removal.theta))
                trial = _step(_retrained(smaller, records, held, epochs, decay), records, held)
                judged = np.array(trial.held or trial.error)
                kept = bool((np.isfinite(judged) & (judged <= allowed)).all())
                rounds.append(Round(_named(e.objective, removal.weights), trial.neurons, trial.error, kept))
            if kept:
                steps.append(trial)
                undone = np.array([])
                progress(f"pruning weights: {trial.parameters} parameters")
            elif batch == 1:
                break
            else:
                batch, undone = batch // 2, removal.weights
    return Pruned(tuple(steps), tuple(rounds))


def saliency_pruning(
    records: Sequence[Record], method: Method, allowed: float, held: Sequence[Record] = (), **options
) -> Pruning:
    """Make a pruning pass for `compile_network`.

    allowed: factor by which the RMS error of each output may rise, over the held-out records, or over `records` if none
    are held out. options: of `prune_by_saliency`.
    """

    def prune(network: Network) -> tuple[Network, list[Round]]:
        error = pooled_rms(network, list(held or records))
        pruned = prune_by_saliency(network, records, method, allowed * error, held=held, **options)
        return pruned.network, list(pruned.rounds)

    return prune


def _safest(e: Expansion, method: Method, count: int) -> Removal:
    """The removal with the ridge that leaves the least error."""
    removals = [method(replace(e, ridge=ridge), count) for ridge in (RIDGES[:1] if method in UNRIDGED else RIDGES)]
    return min(removals, key=lambda r: e.objective.squares(r.theta))


def _retrained(
    network: Network, records: Sequence[Record], held: Sequence[Record], epochs: int, decay: float
) -> Network:
    """Train again on the records; take the weights of the lowest error over the held-out records, if there are any."""
    free = nonzero(network)
    if not len(Objective(network, list(records), free=free).free):
        return network
    return retrained(network, list(records), epochs, decay=decay, free=free, held=held, patience=epochs)


def _step(network: Network, records: Sequence[Record], held: Sequence[Record]) -> Stage:
    neurons = sum(layer.size for layer in network.layers().values() if spareable(layer))
    error = pooled_rms(network, list(records))
    other = pooled_rms(network, list(held)) if held else np.array([])
    return Stage(network, parameter_count(network), neurons, tuple(error.tolist()), tuple(other.tolist()))


def _named(objective: Objective, weights: np.ndarray) -> dict[str, list[int]]:
    """Indices of theta by parameter, each flat."""
    found = {n: np.flatnonzero(np.isin(where, weights)).tolist() for n, where in objective.slices().items()}
    return {n: which for n, which in found.items() if which}
