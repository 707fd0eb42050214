"""Levenberg-Marquardt for any network, feedback included, with exact derivatives through time."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from time import monotonic

import numpy as np
import scipy.linalg
from threadpoolctl import threadpool_limits

from greygate.errors import InputError
from greygate.models.kernels import Tables, forward, sensitivities, tabulate
from greygate.models.network import Network

CHUNK = 2048  # steps of Jacobian held at once


class Outcome(Enum):
    """How a training ended, as a sentence."""

    CONVERGED = "The loss no longer falls: converged."
    REACHED = "The loss that was asked for is reached."
    EPOCHS = "All epochs are used; the loss was still falling."
    TIME = "Out of time; these are the best weights so far."
    INTERRUPTED = "Interrupted; these are the best weights so far."
    STALLED = "No step lowers the loss: stalled at a point that may be no minimum."


@dataclass(frozen=True)
class Record:
    """One sequence to learn: inputs and targets {port: (N,)} in physical units.

    initial: as for `Network.run`. skip: first samples that do not count. weight: of this record in the loss.
    """

    inputs: Mapping[str, np.ndarray]
    targets: Mapping[str, np.ndarray]
    initial: Mapping[str, float] = field(default_factory=dict)
    skip: int = 0
    weight: float = 1.0


@dataclass(frozen=True)
class Fit:
    """A trained network. history: loss J after each epoch, J = (1/2N) sum e^2 + (1/2N) theta' D theta, normalised."""

    network: Network
    outcome: Outcome
    history: tuple[float, ...]
    seconds: float


class Problem:
    """Residuals and normal equations of a network on records, as functions of its free parameters.

    teacher: feed measured outputs back instead of the network's own (series-parallel, NARX); else free run (NOE).
    free: {parameter: bool array} of single weights that may move (pruned ones stay zero); others follow `frozen`.
    Raises InputError for records that are empty, too short or not finite.
    """

    def __init__(self, network: Network, records: list[Record], teacher: bool = False, free: Mapping | None = None):
        self.flat = network.flatten()
        feeds = self.flat.feeds()
        outputs = {p.name for p in self.flat.outputs}
        self._tables, self._names = tabulate(self.flat, frozenset(outputs) if teacher else frozenset())
        values = self.flat.parameters()
        self._shapes = [values[n].shape for n in self._names]
        self.theta = np.concatenate([values[n].ravel() for n in self._names])
        may_move = [
            np.full(values[n].size, not self._frozen(n)) & np.asarray((free or {}).get(n, True)).ravel()
            for n in self._names
        ]
        self.free = np.flatnonzero(np.concatenate(may_move))
        elements = int(self._tables.layers[-1, 0])
        first = {n: int(e) for n, e in zip(self.flat.order(), self._tables.layers[:, 0], strict=False)}
        self._forced = np.zeros(elements, bool)
        if teacher:
            for p in self.flat.outputs:
                at = first[feeds[p.name][0]]
                self._forced[at : at + p.size] = True
        self._records = [self._arrays(r, first, teacher) for r in records]
        self.samples = sum((len(t) - skip) * t.shape[1] for _, _, t, skip, _ in self._records)
        if records and self.samples <= 0:
            raise InputError(f"network {network.name}: no samples to train on; the records are empty or all skipped")

    def _frozen(self, name: str) -> bool:
        layer, _, port = name.rpartition(".")
        return port in self.flat.modules[layer].frozen

    def slices(self) -> dict[str, np.ndarray]:
        """Where each parameter stands in theta."""
        ends = np.cumsum([int(np.prod(s)) for s in self._shapes])
        return dict(zip(self._names, np.split(np.arange(ends[-1]), ends[:-1]), strict=True))

    def _arrays(self, record: Record, first: dict[str, int], teacher: bool):
        flat, depth = self.flat, self._tables.depth
        targets = []
        for p in flat.outputs:
            if p.name not in record.targets:
                raise InputError(f"target {p.name} [{p.unit}] is missing; given: {', '.join(record.targets)}")
            targets.append((np.asarray(record.targets[p.name], float).reshape(-1, p.size) - p.offset) / p.scale)
        target = np.concatenate(targets, axis=1)
        now = np.empty((depth + len(target), len(self._forced)))
        at = 0
        for p in flat.inputs:
            if p.name not in record.inputs:
                raise InputError(f"input {p.name} [{p.unit}] is missing; given: {', '.join(record.inputs)}")
            value = (np.asarray(record.inputs[p.name], float).reshape(-1, p.size) - p.offset) / p.scale
            if len(value) != len(target):
                raise InputError(f"input {p.name}: {len(value)} samples where the targets have {len(target)}")
            now[depth:, at : at + p.size] = value
            now[:depth, at : at + p.size] = (record.initial.get(p.name, p.initial) - p.offset) / p.scale
            at += p.size
        for name, layer in flat.modules.items():
            now[:depth, first[name] : first[name] + layer.size] = record.initial.get(name, layer.initial)
        if not (np.isfinite(now[:, :at]).all() and np.isfinite(target).all()):
            raise InputError(f"network {flat.name}: a record holds NaN or inf; mend or cut it")
        past = now.copy()
        if teacher:
            past[depth:, self._forced] = target
        return now, past, target, record.skip, record.weight

    def unpack(self, theta: np.ndarray) -> Network:
        """The flat network with these parameters."""
        parts = np.split(theta, np.cumsum([int(np.prod(s)) for s in self._shapes])[:-1])
        return self.flat.with_parameters(
            {n: p.reshape(s) for n, p, s in zip(self._names, parts, self._shapes, strict=True)}
        )

    @property
    def depth(self) -> int:
        """The longest delay, in steps."""
        return self._tables.depth

    def elements(self) -> dict[str, np.ndarray]:
        """Columns of each input and layer in `simulate`'s traces."""
        sizes = {p.name: p.size for p in self.flat.inputs} | {n: self.flat.modules[n].size for n in self.flat.order()}
        ends = np.cumsum(list(sizes.values()))
        return dict(zip(sizes, np.split(np.arange(ends[-1]), ends[:-1]), strict=True))

    def simulate(self, theta: np.ndarray) -> list[np.ndarray] | None:
        """Every element's signal, (N, elements) per record, inputs first; None if it diverges."""
        t = self._tables
        found = []
        for now, past, target, _, _ in self._records:
            if forward(t.layers, t.links, t.n_inputs, t.depth, theta, now, past, self._forced) < len(target):
                return None
            found.append(now[t.depth :])
        return found

    def errors(self, theta: np.ndarray) -> list[np.ndarray] | None:
        """Normalised prediction less target, (N, outputs) per record; None if the free run diverges."""
        runs = self.simulate(theta)
        if runs is None:
            return None
        shown = self._tables.rows[self._tables.shown]
        return [run[:, shown] - target for run, (_, _, target, _, _) in zip(runs, self._records, strict=True)]

    def squares(self, theta: np.ndarray) -> float:
        """Weighted sum of squared errors; inf where the run diverges."""
        errors = self.errors(theta)
        if errors is None:
            return np.inf
        return sum(
            weight * float(np.sum(e[skip:] ** 2))
            for e, (_, _, _, skip, weight) in zip(errors, self._records, strict=True)
        )

    def normal_equations(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(J'J, J'e) over the free parameters. Call after `squares` at the same theta (it uses that run)."""
        t: Tables = self._tables
        size = len(theta)
        hessian, gradient = np.zeros((size, size)), np.zeros(size)
        for now, past, target, skip, weight in self._records:
            carried = np.zeros((t.depth + 1, len(t.rows), size))
            error = now[t.depth :, t.rows[t.shown]] - target
            block = np.zeros((min(CHUNK, len(target)), len(t.shown), size))
            for start in range(0, len(target), CHUNK):
                stop = min(start + CHUNK, len(target))
                sensitivities(*t, theta, now, past, carried, start, stop, block)
                use = slice(max(skip - start, 0), stop - start)
                for j, row in enumerate(t.shown):
                    a, b = t.spans[row]
                    part = block[use, j, a:b]
                    hessian[a:b, a:b] += weight * (part.T @ part)
                    gradient[a:b] += weight * (part.T @ error[start:stop][use, j])
        return hessian[np.ix_(self.free, self.free)], gradient[self.free]


class _Whole:
    """A network on its records together with modules of it on records of their own, over one theta."""

    def __init__(self, network: Network, records: list[Record], teacher: bool, free: Mapping | None, rehearse: Mapping):
        if not records:
            raise InputError(f"network {network.name}: no records to train on")
        self.main = Problem(network, records, teacher, free)
        self.parts = []
        place = self.main.slices()
        position = np.full(len(self.main.theta), -1)
        position[self.main.free] = np.arange(len(self.main.free))
        for path, record in rehearse.items():
            part = Problem(_module(network, path), [record])
            index = np.concatenate([place[f"{path}.{n}"] for n in part.slices()])
            moving = np.flatnonzero(position[index[part.free]] >= 0)
            self.parts.append((part, index, moving, position[index[part.free]][moving]))

    def loss(self, theta: np.ndarray, decay: float) -> float:
        """J = (1/2N) (sum e^2 + rehearsal's weighted sum e^2 + decay theta' theta); inf where a run diverges."""
        squares = self.main.squares(theta) + sum(part.squares(theta[index]) for part, index, _, _ in self.parts)
        value = (squares + decay * float(np.sum(theta[self.main.free] ** 2))) / (2 * self.main.samples)
        return value if np.isfinite(value) else np.inf

    def normal_equations(self, theta: np.ndarray, decay: float) -> tuple[np.ndarray, np.ndarray]:
        hessian, gradient = self.main.normal_equations(theta)
        for part, index, moving, where in self.parts:
            h, g = part.normal_equations(theta[index])
            hessian[np.ix_(where, where)] += h[np.ix_(moving, moving)]
            gradient[where] += g[moving]
        hessian[np.diag_indices_from(hessian)] += decay
        return hessian, gradient + decay * theta[self.main.free]


def _module(network: Network, path: str) -> Network:
    for name in path.split("."):
        network = getattr(network, "modules", {}).get(name)
        if not isinstance(network, Network):
            raise InputError(f"cannot rehearse {path}: {name} is not a network with ports of its own")
    return network


def train(
    network: Network,
    records: list[Record],
    *,
    teacher: bool = False,
    epochs: int = 100,
    decay: float = 0.0,
    rehearse: Mapping[str, Record] | None = None,
    goal: float = 0.0,
    seconds: float = np.inf,
    tolerance: float = 1e-7,
    free: Mapping | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> Fit:
    """Levenberg-Marquardt (Marquardt 1963; Nielsen's damping). The trained network is flat.

    decay: D of the loss, one number for every free weight (biases included). goal: stop at this loss.
    rehearse: module path -> a record of its own ports, weighted by `Record.weight`: parts that were right stay right
    where `records` do not reach.
    tolerance: relative fall over ten epochs below which it has converged. progress: called with (epoch, loss).
    Ctrl-C keeps the best weights so far.
    """
    began = monotonic()
    with threadpool_limits(1, "blas"):  # two BLAS threads are slower than one on matrices this small
        whole = _Whole(network, records, teacher, free, rehearse or {})
        problem = whole.main
        theta = problem.theta.copy()
        loss = whole.loss(theta, decay)
        if not np.isfinite(loss):
            raise InputError(
                f"network {network.name}: diverges with its initial weights; start from a NARX fit or smaller weights"
            )
        history, damping, growth, outcome = [loss], 1e-3, 2.0, Outcome.EPOCHS
        best = theta.copy()
        try:
            for epoch in range(epochs):
                hessian, gradient = whole.normal_equations(theta, decay)
                scale = np.diag(hessian).copy() + 1e-12 * np.trace(hessian) / len(hessian) + 1e-300
                while True:
                    try:
                        factor = scipy.linalg.cho_factor(hessian + np.diag(damping * scale), check_finite=False)
                        step = -scipy.linalg.cho_solve(factor, gradient, check_finite=False)
                    except scipy.linalg.LinAlgError:
                        step = None
                    if step is not None and np.isfinite(step).all():
                        trial = theta.copy()
                        trial[problem.free] += step
                        value = whole.loss(trial, decay)
                        expected = 0.5 * float(step @ (damping * scale * step - gradient)) / problem.samples
                        ratio = (loss - value) / expected if expected > 0 else -1.0
                        if value < loss:
                            break
                    damping *= growth
                    growth *= 2
                    if damping > 1e12:
                        break
                if damping > 1e12:
                    outcome = (
                        Outcome.CONVERGED
                        if np.linalg.norm(gradient) < 1e-6 * np.sqrt(loss) * len(gradient)
                        else Outcome.STALLED
                    )
                    break
                theta, loss, growth = trial, value, 2.0
                best = theta
                damping = max(damping * max(1 / 3, 1 - (2 * ratio - 1) ** 3), 1e-15)
                history.append(loss)
                if progress:
                    progress(epoch + 1, loss)
                if loss <= goal:
                    outcome = Outcome.REACHED
                    break
                if len(history) > 10 and history[-11] - loss < tolerance * loss:
                    outcome = Outcome.CONVERGED
                    break
                if monotonic() - began > seconds:
                    outcome = Outcome.TIME
                    break
        except KeyboardInterrupt:
            outcome = Outcome.INTERRUPTED
        return Fit(problem.unpack(best), outcome, tuple(history), monotonic() - began)
