"""Residuals, exact Jacobian through time and normal equations of any network on its records."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from greygate.errors import InputError
from greygate.models.network import Network
from greygate.models.training.kernels import Tables, forward, sensitivities, tabulate

CHUNK = 2048  # steps of Jacobian held at once
CORES = ThreadPoolExecutor(2, "greygate")  # kernels and BLAS both let go of the interpreter
WORTH = 2e6  # multiplications below which a second core does not pay
NARROW = 0.9  # share of free columns above which it is faster to leave out the others after J'J than before
IN_RANGE = 10.0  # of a normalised signal
COLLINEAR = 1e-9  # smallest singular value of the scaled regressors, relative to the largest


@dataclass(frozen=True)
class Record:
    """One sequence to learn: inputs and targets {port: (N,)} in physical units.

    initial: as for `Network.run`, or what `Fit.initial` found. skip: first samples that do not count. weight: of this
    record in the loss.

    >>> t = np.arange(500) * 1e-3
    >>> inputs = {"u": 2.0 * np.sin(40.0 * t**1.5)}
    >>> record = Record(inputs, lag.run(inputs))
    >>> record
    <Record: u -> y, 500 samples>
    """

    inputs: Mapping[str, np.ndarray]
    targets: Mapping[str, np.ndarray]
    initial: Mapping[str, float | np.ndarray] = field(default_factory=dict)
    skip: int = 0
    weight: float = 1.0

    def __repr__(self) -> str:
        return f"<Record: {', '.join(self.inputs)} -> {', '.join(self.targets)}, {len(self)} samples>"

    def __len__(self) -> int:
        return len(next(iter(self.targets.values()), ()))

    def cut(self, start: int, stop: int, **changes) -> "Record":
        """Samples start..stop alone; `changes` as for `dataclasses.replace`."""
        parts = ({n: v[start:stop] for n, v in part.items()} for part in (self.inputs, self.targets))
        return replace(self, **(dict(zip(("inputs", "targets"), parts, strict=True)) | changes))


def held_out(
    network: Network, records: Sequence[Record], tail: float, held: Sequence[Record]
) -> tuple[list[Record], list[Record]]:
    """(records to train on, records to judge on): the share `tail` at the end of each is judged, and so is `held`.

    A tail is run from the start of its record; of one that skips beyond it nothing is left to train on. Raises
    InputError for a share outside [0, 1), no records, or a record that skips itself wholly.
    """
    if not records:
        raise InputError(f"network {network.name}: no records to train on")
    if not 0 <= tail < 1:
        raise InputError(f"tail {tail}: a share from 0 up to 1, without 1")
    _check_skips(network, [*records, *held])
    if not tail:
        return list(records), list(held)
    heads = [int((1 - tail) * len(r)) for r in records]
    tails = [replace(r, skip=max(h, r.skip)) for r, h in zip(records, heads, strict=True)]
    return [r.cut(0, h) for r, h in zip(records, heads, strict=True)], tails + list(held)


def _check_skips(network: Network, records: Sequence[Record]) -> None:
    for i, record in enumerate(records):
        if len(record) and not 0 <= record.skip < len(record):
            raise InputError(
                f"network {network.name}: record {i} skips {record.skip} of its {len(record)} samples; skip fewer"
            )


@dataclass
class _Window:
    """A run of its own: arrays for the kernels, and the columns of theta that hold its initial state, if any."""

    now: np.ndarray  # (depth + N, elements)
    past: np.ndarray
    target: np.ndarray  # (N, outputs)
    skip: int
    weight: float
    state: slice
    follows: bool  # its initial state should be what the window before ends with


class Problem:
    """Residuals and normal equations of a network on records, as functions of theta.

    theta: every weight and bias (frozen ones too), then the initial states that are estimated. Steps are taken in the
    variables `free`; `moved` applies one.
    teacher: feed measured outputs back instead of the network's own (series-parallel, NARX); else free run (NOE).
    free: {parameter: bool array} of single weights that may move (pruned ones stay zero); others follow `frozen`.
    tied: groups of modules, layers or parameters that keep equal weights, those of the first.
    estimate_initial: the state before each record is free too. shooting: steps of a window; each record is run in
    windows whose initial states are free, and `continuity` weighs the gaps between them (multiple shooting, Bock 1984).
    Raises InputError for records that are too short or not finite, naming what and where.
    """

    def __init__(
        self,
        network: Network,
        records: Sequence[Record],
        teacher: bool = False,
        free: Mapping | None = None,
        *,
        tied: Sequence[Sequence[str]] = (),
        estimate_initial: bool = False,
        shooting: int | None = None,
    ):
        self.flat = network.flatten()
        self.teacher, self.estimate_initial = teacher, estimate_initial
        self.continuity = 1.0
        feeds = self.flat.feeds()
        outputs = {p.name for p in self.flat.outputs}
        self._tables, self._names = tabulate(self.flat, frozenset(outputs) if teacher else frozenset())
        values = self.flat.parameters()
        self._shapes = [values[n].shape for n in self._names]
        theta = np.concatenate([values[n].ravel() for n in self._names])
        self._size = len(theta)
        elements = int(self._tables.layers[-1, 0])
        first = {n: int(e) for n, e in zip(self.flat.order(), self._tables.layers[:, 0], strict=False)}
        self._outputs = np.zeros(elements, bool)
        for p in self.flat.outputs:
            at = first[feeds[p.name][0]]
            self._outputs[at : at + p.size] = True
        self._forced = self._outputs if teacher else np.zeros(elements, bool)
        self._state = self._state_elements()
        whole = [self._arrays(r, i, first) for i, r in enumerate(records)]
        if not any(0 <= r.skip < len(w.target) for r, w in zip(records, whole, strict=True)):
            _check_skips(network, records)
        longest = max((len(w.target) for w in whole), default=0)
        if shooting is not None and not 1 <= shooting <= longest // 2:
            raise InputError(f"shooting {shooting}: give windows of 1 to {longest // 2} steps, half the longest record")
        self._windows = list(self._windowed(whole, theta, estimate_initial, shooting))
        states = [self._state_of(w.now) for w in self._windows if w.state.stop > w.state.start]
        self.theta = np.concatenate([theta, *states])
        self._variables(free or {}, tied)
        self.samples = sum((len(w.target) - w.skip) * w.target.shape[1] for w in self._windows)
        if records and self.samples <= 0:
            raise InputError(f"network {network.name}: no samples to train on; the records are empty or all skipped")

    # ---- what is free

    def _variables(self, free: Mapping, tied: Sequence[Sequence[str]]) -> None:
        shapes = dict(zip(self._names, self._shapes, strict=True))
        for name, which in free.items():
            if name not in shapes:
                raise InputError(f"network {self.flat.name}: no parameter {name} to leave free or hold")
            if np.size(which) not in (1, int(np.prod(shapes[name]))):
                raise InputError(f"free: {name} has shape {shapes[name]}, not {np.shape(which)}")
        may_move = np.concatenate(
            [
                np.full(int(np.prod(shape)), not self._frozen(n)) & np.asarray(free.get(n, True), bool).ravel()
                for n, shape in zip(self._names, self._shapes, strict=True)
            ]
            + [np.ones(len(self.theta) - self._size, bool)]
        )
        like = np.arange(len(self.theta))  # the column that each one follows
        for group in tied:
            leader, *others = [self._columns(name) for name in group]
            for name, columns in zip(group[1:], others, strict=True):
                if len(columns) != len(leader):
                    raise InputError(f"network {self.flat.name}: {name} and {group[0]} differ in shape; no tie")
                if not (may_move[columns].all() and may_move[leader].all()):
                    raise InputError(f"network {self.flat.name}: {name} or {group[0]} is held fixed; no tie")
                like[columns] = like[leader]
        while (like[like] != like).any():  # groups that share a member
            like = like[like]
        self.theta[:] = self.theta[like]
        self.free = np.flatnonzero(may_move & (like == np.arange(len(like))))
        position = np.full(len(self.theta), -1)
        position[self.free] = np.arange(len(self.free))
        self.variable = position[like]  # of each column of theta; -1 where it stays
        self._tied = bool(tied)

    def _columns(self, name: str) -> np.ndarray:
        place = self.slices()
        found = [c for n, c in place.items() if n == name or n.startswith(name + ".")]
        if not found:
            raise InputError(f"network {self.flat.name}: no module, layer or parameter {name} to tie")
        return np.concatenate(found)

    def _frozen(self, name: str) -> bool:
        layer, _, port = name.rpartition(".")
        return port in self.flat.modules[layer].frozen

    def moved(self, theta: np.ndarray, step: np.ndarray) -> np.ndarray:
        """theta after a step (len(free),) of the variables."""
        return theta + np.where(self.variable >= 0, step[self.variable], 0.0)

    def slices(self) -> dict[str, np.ndarray]:
        """Where each parameter stands in theta."""
        ends = np.cumsum([int(np.prod(s)) for s in self._shapes])
        return dict(zip(self._names, np.split(np.arange(ends[-1]), ends[:-1]), strict=True))

    def unpack(self, theta: np.ndarray) -> Network:
        """The flat network with these parameters."""
        parts = np.split(theta[: self._size], np.cumsum([int(np.prod(s)) for s in self._shapes])[:-1])
        return self.flat.with_parameters(
            {n: p.reshape(s) for n, p, s in zip(self._names, parts, self._shapes, strict=True)}
        )

    # ---- records as arrays

    def _arrays(self, record: Record, index: int, first: dict[str, int]) -> _Window:
        flat, depth = self.flat, self._tables.depth
        if not record.weight > 0:
            raise InputError(f"network {flat.name}: record {index} weighs {record.weight}; give a positive weight")

        def signal(kind: str, given: Mapping, p) -> np.ndarray:
            if p.name not in given:
                raise InputError(f"{kind} {p.name} [{p.unit}] is missing; given: {', '.join(given)}")
            value = np.asarray(given[p.name], float).reshape(-1, p.size)
            bad = np.flatnonzero(~np.isfinite(value).all(axis=1))
            if len(bad):
                raise InputError(
                    f"network {flat.name}: {kind} {p.name} of record {index} holds NaN or inf at sample {bad[0]}"
                    f" ({len(bad)} in all); mend or cut it"
                )
            return (value - p.offset) / p.scale

        target = np.concatenate([signal("target", record.targets, p) for p in flat.outputs], axis=1)
        now = np.zeros((depth + len(target), len(self._outputs)))
        at = 0
        for p in flat.inputs:
            value = signal("input", record.inputs, p)
            if len(value) != len(target):
                raise InputError(f"input {p.name}: {len(value)} samples where the targets have {len(target)}")
            now[depth:, at : at + p.size] = value
            now[:depth, at : at + p.size] = (record.initial.get(p.name, p.initial) - p.offset) / p.scale
            at += p.size
        for name, layer in flat.modules.items():
            now[:depth, first[name] : first[name] + layer.size] = record.initial.get(name, layer.initial)
        if 0 < len(target) <= depth:
            raise InputError(
                f"network {flat.name}: record {index} has {len(target)} samples, too short for a delay of {depth}"
            )
        past = now.copy()
        if self.teacher:
            past[depth:, self._forced] = target
        return _Window(now, past, target, record.skip, record.weight, slice(0, 0), False)

    def _state_elements(self) -> np.ndarray:
        """(X, 2): element and lag of every past value of a layer that is read."""
        t = self._tables
        longest = np.zeros(int(t.layers[-1, 0]), int)
        for source, width, delay, _ in t.links:
            longest[source : source + width] = np.maximum(longest[source : source + width], delay)
        return np.array(
            [(e, lag) for e in np.flatnonzero(t.row_of >= 0) for lag in range(1, longest[e] + 1)], int
        ).reshape(-1, 2)

    def _state_of(self, now: np.ndarray, step: int = 0) -> np.ndarray:
        """The state before `step`."""
        return now[self._tables.depth + step - self._state[:, 1], self._state[:, 0]]

    def _windowed(
        self, whole: list[_Window], theta: np.ndarray, estimate: bool, shooting: int | None
    ) -> Iterator[_Window]:
        depth, width = self._tables.depth, len(self._state)
        at = self._size

        def own_state() -> slice:
            nonlocal at
            at += width
            return slice(at - width, at)

        for w in whole:
            first = own_state() if estimate and width else slice(0, 0)
            length = max(shooting or len(w.target), depth, 1)
            if len(w.target) < 2 * length or not width:
                yield replace(w, state=first)
                continue
            t, shown = self._tables, self._tables.rows[self._tables.shown]
            guess = w.past.copy()  # what is shown was measured, and teaches what is not, if that stays in range
            guess[depth:, shown] = w.target
            forward(t.layers, t.links, t.n_inputs, depth, theta, w.now, guess, self._outputs)
            starts = list(range(0, len(w.target) - length + 1, length))
            for start, stop in zip(starts, [*starts[1:], len(w.target)], strict=True):
                rows = slice(start, stop + depth)
                past = np.where(np.abs(guess) < IN_RANGE, guess, 0.0)[rows].copy() if start else w.past[rows].copy()
                past[depth:] = w.past[depth + start : depth + stop]
                yield _Window(
                    past.copy(),
                    past,
                    w.target[start:stop],
                    min(max(w.skip - start, 0), stop - start),
                    w.weight,
                    own_state() if start else first,
                    start > 0,
                )

    def initial(self, theta: np.ndarray) -> list[dict[str, np.ndarray]]:
        """The state that each record starts from, as for `Record.initial`: layer -> (depth, size), oldest first."""
        depth, place = self._tables.depth, self.elements()
        found = []
        for w in self._windows:
            if not w.follows:
                self._start(w, theta)
                found.append({n: w.now[:depth, place[n]].copy() for n in self.flat.modules})
        return found

    # ---- evaluation

    @property
    def depth(self) -> int:
        """The longest delay, in steps."""
        return self._tables.depth

    def elements(self) -> dict[str, np.ndarray]:
        """Columns of each input and layer in `simulate`'s traces."""
        sizes = {p.name: p.size for p in self.flat.inputs} | {n: self.flat.modules[n].size for n in self.flat.order()}
        ends = np.cumsum(list(sizes.values()))
        return dict(zip(sizes, np.split(np.arange(ends[-1]), ends[:-1]), strict=True))

    def _start(self, w: _Window, theta: np.ndarray) -> None:
        if w.state.stop > w.state.start:
            row, column = self._tables.depth - self._state[:, 1], self._state[:, 0]
            w.now[row, column] = w.past[row, column] = theta[w.state]

    def simulate(self, theta: np.ndarray) -> list[np.ndarray] | None:
        """Every element's signal, (N, elements) per record or window, inputs first; None if it diverges."""
        t = self._tables

        def run(w: _Window) -> bool:
            self._start(w, theta)
            done = forward(t.layers, t.links, t.n_inputs, t.depth, theta, w.now, w.past, self._forced)
            return done == len(w.target)

        work = max((len(w.target) for w in self._windows), default=0) * self._size
        ways = CORES.map if len(self._windows) > 1 and work > WORTH else map
        if not all(list(ways(run, self._windows))):
            return None
        return [w.now[t.depth :] for w in self._windows]

    def errors(self, theta: np.ndarray) -> list[np.ndarray] | None:
        """Normalised prediction less target, (N, outputs) per record or window; None if the free run diverges."""
        runs = self.simulate(theta)
        if runs is None:
            return None
        shown = self._tables.rows[self._tables.shown]
        return [run[:, shown] - w.target for run, w in zip(runs, self._windows, strict=True)]

    def squares(self, theta: np.ndarray) -> float:
        """Weighted sum of squared errors, gaps between windows included; inf where the run diverges."""
        errors = self.errors(theta)
        if errors is None:
            return np.inf
        with np.errstate(over="ignore", invalid="ignore"):
            total = sum(
                w.weight * float(np.vdot(e[w.skip :], e[w.skip :])) for e, w in zip(errors, self._windows, strict=True)
            )
            total += self.continuity * sum(float(np.sum(gap**2)) for _, gap in self._gaps(theta))
        return total if np.isfinite(total) else np.inf

    @property
    def power(self) -> float:
        """The loss of an output of zero."""
        total = sum(w.weight * float(np.vdot(w.target[w.skip :], w.target[w.skip :])) for w in self._windows)
        return total / (2 * max(self.samples, 1))

    def fingerprint(self) -> str:
        """Of the records, what is free, and where theta starts: equal problems have equal ones."""
        scalars = (self._names, self._shapes, self.teacher, [(w.skip, w.weight) for w in self._windows])
        found = hashlib.sha256(repr(scalars).encode())
        for array in (self.theta, self.variable, *(a for w in self._windows for a in (w.past, w.target))):
            found.update(array.tobytes())
        return found.hexdigest()

    def taking(self, other: "Problem", theta: np.ndarray, states: bool) -> np.ndarray:
        """Theta with the weights of another's; states: and the initial states of its records, in their order."""
        mine = self.theta.copy()
        mine[: self._size] = theta[: self._size]
        if states:
            own, given = ([w.state for w in p._windows if not w.follows] for p in (self, other))
            for here, there in zip(own, given, strict=True):
                mine[here] = theta[there]
        return mine

    def _gaps(self, theta: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
        """(window, the state it ends with less the one that the next begins with)."""
        for i, following in enumerate(self._windows[1:]):
            if following.follows:
                w = self._windows[i]
                yield i, self._state_of(w.now, len(w.target)) - theta[following.state]

    def normal_equations(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(J'J, J'e) over the variables. Call after `squares` at the same theta (it uses that run)."""
        size = len(self.free)
        hessian, gradient = np.zeros((size, size)), np.zeros(size)
        gaps = dict(self._gaps(theta))
        jobs = enumerate(self._windows)
        spread = len(self._windows) > 1 and self.samples * size**2 > WORTH
        ways = CORES.map if spread else map
        for i, (columns, h, g, end) in enumerate(
            ways(lambda job: self._window_equations(job[1], theta, job[0] in gaps, spread), jobs)
        ):
            if len(columns) == size and i not in gaps:
                hessian += h
                gradient += g
                continue
            if i in gaps:  # d gap = end (columns) - d next state
                after = self.variable[self._windows[i + 1].state]
                joint = np.concatenate([columns, after])
                end = np.hstack([end, -np.eye(len(after))])
                hessian[np.ix_(joint, joint)] += self.continuity * end.T @ end
                gradient[joint] += self.continuity * end.T @ gaps[i]
            hessian[np.ix_(columns, columns)] += h
            gradient[columns] += g
        return hessian, gradient

    def _window_equations(self, w: _Window, theta: np.ndarray, wants_end: bool, alone: bool):
        """(variables that act on it, J'J, J'e, sensitivity of the state at its end) of one window."""
        t: Tables = self._tables
        n, own = self._size, w.state.stop - w.state.start
        carried = np.zeros((t.depth + 1, len(t.rows), n + own))
        if own:
            carried[-self._state[:, 1] % (t.depth + 1), t.row_of[self._state[:, 0]], n + np.arange(own)] = 1.0
        columns = np.concatenate([self.variable[:n], self.variable[w.state]])
        used = np.flatnonzero(columns >= 0)
        targets, where = np.unique(columns[used], return_inverse=True)
        spans = [self._span(row, used, n) for row in t.shown]
        error = w.now[t.depth :, t.rows[t.shown]] - w.target
        length = len(w.target)
        rows = min(CHUNK, length)
        alone = alone or length * len(used) ** 2 < WORTH or length <= CHUNK
        blocks = [np.zeros((rows, len(t.shown), n + own)) for _ in range(1 if alone else 2)]
        hessian, gradient = np.zeros((n + own, n + own)), np.zeros(n + own)

        def add(block: np.ndarray, start: int, stop: int) -> None:
            use = slice(max(w.skip - start, 0), stop - start)
            for output, span in enumerate(spans):
                j = block[use, output, span]
                here = (span, span) if isinstance(span, slice) else np.ix_(span, span)
                hessian[here] += j.T @ j
                gradient[span] += j.T @ error[start:stop][use, output]

        under_way: Future | None = None
        for i, start in enumerate(range(0, length, CHUNK)):
            stop, block = min(start + CHUNK, length), blocks[i % len(blocks)]
            sensitivities(*t, theta[:n], w.now, w.past, carried, start, stop, block)
            if alone:
                add(block, start, stop)
                continue
            if under_way:
                under_way.result()
            under_way = CORES.submit(add, block, start, stop)  # while the next block is filled
        if under_way:
            under_way.result()
        if len(used) < len(columns):
            hessian, gradient = hessian[np.ix_(used, used)], gradient[used]
        end = None
        if wants_end:
            end = carried[(length - self._state[:, 1]) % (t.depth + 1), t.row_of[self._state[:, 0]]][:, used]
        if self._tied:
            sums = np.zeros((len(used), len(targets)))  # each free column of theta to its variable
            sums[np.arange(len(used)), where] = 1.0
            hessian, gradient, end = sums.T @ hessian @ sums, sums.T @ gradient, end if end is None else end @ sums
        if w.weight != 1.0:
            hessian *= w.weight
            gradient *= w.weight
        return targets, hessian, gradient, end

    def _span(self, row: int, used: np.ndarray, size: int) -> slice | np.ndarray:
        """Free columns of theta that act on a row: as a slice, where few of those between are frozen."""
        lo, hi = self._tables.spans[row]
        acts = used[((used >= lo) & (used < hi)) | (used >= size)]
        first, last = (int(acts[0]), int(acts[-1]) + 1) if len(acts) else (0, 0)
        return slice(first, last) if len(acts) > NARROW * (last - first) else acts

    # ---- what a person should know of the data

    def remarks(self) -> list[str]:
        """Why the weights may not be found from these records, a sentence each: constant inputs, collinear regressors,
        fewer samples than weights."""
        found = []
        if self.samples < len(self.free):
            found.append(f"{self.samples} samples for {len(self.free)} free weights: more data, fewer weights or decay")
        columns = [f"{p.name}[{i}]" if p.size > 1 else p.name for p in self.flat.outputs for i in range(p.size)]
        for label, target in zip(columns, np.concatenate([w.target for w in self._windows]).T, strict=True):
            if np.ptp(target) <= 1e-12 * (1 + np.abs(target).max()):
                found.append(f"target {label} is constant: a bias alone fits it; record it while it moves")
        names, taps = [], []
        t, place = self._tables, self.elements()
        for name, columns in place.items():
            delays = {int(d) for s, width, d, _ in t.links if s == columns[0] and width == len(columns)}
            if name in self.flat.modules and not self._forced[columns].any():
                continue
            for i, c in enumerate(columns):
                component = name if len(columns) == 1 else f"{name}[{i}]"
                used = np.concatenate([w.past[t.depth :, c] for w in self._windows])
                if name not in self.flat.modules and len(used) and np.ptp(used) <= 1e-12 * (1 + np.abs(used).max()):
                    found.append(
                        f"input {component} is constant: its weights cannot be told from the biases; excite it"
                    )
                    continue
                for d in sorted(delays):
                    names.append(f"{component}(k-{d})" if d else f"{component}(k)")
                    taps.append(
                        np.concatenate([w.past[t.depth - d : len(w.past) - d or None, c] for w in self._windows])
                    )
        if len(taps) > 1 and len(taps[0]) > 1:
            x = np.array(taps).T[:: max(1, len(taps[0]) // 5000)]
            x = x - x.mean(axis=0)
            _, s, v = np.linalg.svd(x / (np.linalg.norm(x, axis=0) + 1e-300), full_matrices=False)
            if s[-1] < COLLINEAR * s[0]:
                alike = [n for n, c in zip(names, v[-1], strict=True) if abs(c) > 0.1 * np.abs(v[-1]).max()]
                found.append(f"regressors {', '.join(alike)} are collinear: leave one out, or excite them apart")
        return found
