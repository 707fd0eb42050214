"""Residuals, exact Jacobian through time and normal equations of any network on its records."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from greygate.errors import InputError
from greygate.models.kernels import Tables, forward, sensitivities, tabulate
from greygate.models.network import Network

CHUNK = 2048  # steps of Jacobian held at once


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
