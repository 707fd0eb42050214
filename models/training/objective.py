"""Residuals, exact Jacobian through time and normal equations of any network on its records."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from greygate.cores import usable_cores
from greygate.errors import InputError
from greygate.models.arithmetic import gram
from greygate.models.network import Network
from greygate.models.training.kernels import Tables, forward, portable_sensitivities, sensitivities, tabulate
from greygate.models.training.record import Record, check_skips

CHUNK = 2048  # steps of Jacobian held at once
CORES = ThreadPoolExecutor(2, "greygate")  # kernels and BLAS both let go of the interpreter
WORTH = 2e6  # multiplications below which a second core does not pay
NARROW = 0.9  # share of free columns above which it is faster to drop the others after J'J than before
STILL = 1e-9  # of an output's size, below which its motion is rounding
IN_RANGE = 10.0  # of a normalised signal: a guess beyond it has diverged


@dataclass
class _Window:
    """One run of the network: arrays for the kernels, and the columns of theta that hold its initial state, if any."""

    now: np.ndarray  # (depth + N, elements)
    past: np.ndarray
    target: np.ndarray  # (N, outputs)
    skip: int
    weight: float
    state: slice
    follows: bool  # its initial state should be what the window before ends with
    own: tuple[int, ...] = ()  # output columns whose sensor has an offset of its own
    scaled: Mapping[int, float] = field(default_factory=dict)  # one with a gain of its own -> its zero, normalised


def best_gain(shown: np.ndarray, measured: np.ndarray, about_mean: bool) -> tuple[float, np.ndarray]:
    """(gain, along): the gain of `shown` (N,) that comes nearest to `measured`, and what it multiplies.

    about_mean: both about their means. Where nothing is shown that a gain could multiply, it is 1, along a zero.
    """
    along, target = shown, measured
    if about_mean:
        along, target = shown - shown.mean(), measured - measured.mean()
    size = float(along @ along)
    if not size > STILL**2 * float(shown @ shown):
        return 1.0, np.zeros(len(shown))
    return float(along @ target) / size, along


class Objective:
    """Residuals and normal equations of a network on records, as functions of theta.

    theta: every weight and bias (frozen ones too), then the initial states that are estimated. Steps are taken in the
    variables `free`; `moved` applies one.
    teacher: feed measured outputs back instead of the network's own (one-step prediction, series-parallel, NARX).
    Without it the network feeds back its own (free-run simulation, NOE).
    free: {parameter: bool array}, the single weights that may move (pruned ones stay zero). A parameter that is not
    named moves unless its layer declares it `frozen`.
    tied: groups of modules, layers or parameters that keep equal weights, those of the first.
    estimate_initial: the state before each record is free too. shooting: steps of a window; each record is run in
    windows whose initial states are free, and `continuity` weighs the gaps between them (multiple shooting, Bock 1984).
    portable: `normal_equations` come out the same, to the bit, on every processor, more slowly.
    Raises InputError for a signal that is missing, too short or not finite, naming what and where.
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
        portable: bool = False,
    ):
        self.flat, self.portable = network.flatten(), portable
        self.teacher, self.estimate_initial = teacher, estimate_initial
        self.continuity = 1.0
        feeds = self.flat.feeds()
        outputs = {p.name for p in self.flat.outputs}
        self.tables, self._names = tabulate(self.flat, frozenset(outputs) if teacher else frozenset())
        values = self.flat.parameters()
        self._shapes = [values[n].shape for n in self._names]
        theta = np.concatenate([values[n].ravel() for n in self._names])
        self._size = len(theta)
        elements = int(self.tables.layers[-1, 0])
        first = {n: int(e) for n, e in zip(self.flat.order(), self.tables.layers[:, 0], strict=False)}
        self._outputs = np.zeros(elements, bool)
        for p in self.flat.outputs:
            at = first[feeds[p.name][0]]
            self._outputs[at : at + p.size] = True
        self.forced = self._outputs if teacher else np.zeros(elements, bool)
        self._state = self._state_elements()
        runs = [self._arrays(r, i, first) for i, r in enumerate(records)]
        if shooting is not None and any(w.own or w.scaled for w in runs):
            raise InputError(
                f"network {network.name}: shooting does not go with offsets and gains of a recording's own; "
                "leave one out"
            )
        if not any(0 <= r.skip < len(w.target) for r, w in zip(records, runs, strict=True)):
            check_skips(network, records)
        longest = max((len(w.target) for w in runs), default=0)
        if shooting is not None and not 1 <= shooting <= longest // 2:
            raise InputError(f"shooting {shooting}: give windows of 1 to {longest // 2} steps, half the longest record")
        self.windows = list(self._windowed(runs, theta, estimate_initial, shooting))
        states = [self._state_of(w.now) for w in self.windows if w.state.stop > w.state.start]
        self.theta = np.concatenate([theta, *states])
        self._choose(free or {}, tied)
        self.samples = sum((len(w.target) - w.skip) * w.target.shape[1] for w in self.windows)
        if records and self.samples <= 0:
            raise InputError(f"network {network.name}: no samples to train on; the records are empty or all skipped")

    # ---- what is free

    def _choose(self, free: Mapping, tied: Sequence[Sequence[str]]) -> None:
        place = self.slices()
        may_move = np.concatenate([movable(self.flat, place, free), np.ones(len(self.theta) - self._size, bool)])
        like = leaders(self.flat, place, may_move, tied)
        self.theta = self.theta[like]
        self.free = np.flatnonzero(may_move & (like == np.arange(len(like))))
        position = np.full(len(self.theta), -1)
        position[self.free] = np.arange(len(self.free))
        self.variable = position[like]  # of each column of theta; -1 where it stays
        self._tied = bool(tied)

    def moved(self, theta: np.ndarray, step: np.ndarray) -> np.ndarray:
        """theta after a step (len(free),) of the variables."""
        return theta + np.where(self.variable >= 0, step[self.variable], 0.0)

    def slices(self) -> dict[str, np.ndarray]:
        """Where each parameter stands in theta."""
        ends = np.cumsum([int(np.prod(s)) for s in self._shapes])
        return dict(zip(self._names, np.split(np.arange(ends[-1]), ends[:-1]), strict=True))

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Parameter -> its shape, in the order of theta."""
        return dict(zip(self._names, self._shapes, strict=True))

    def unpack(self, theta: np.ndarray) -> Network:
        """The flat network with these parameters."""
        parts = np.split(theta[: self._size], np.cumsum([int(np.prod(s)) for s in self._shapes])[:-1])
        return self.flat.with_parameters(
            {n: p.reshape(s) for n, p, s in zip(self._names, parts, self._shapes, strict=True)}
        )

    # ---- records as arrays

    def _arrays(self, record: Record, index: int, first: dict[str, int]) -> _Window:
        flat, depth = self.flat, self.tables.depth
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
            return p.normalised(value)

        target = np.concatenate([signal("target", record.targets, p) for p in flat.outputs], axis=1)
        now = np.zeros((depth + len(target), len(self._outputs)))
        at = 0
        for p in flat.inputs:
            value = signal("input", record.inputs, p)
            if len(value) != len(target):
                raise InputError(f"input {p.name}: {len(value)} samples where the targets have {len(target)}")
            now[depth:, at : at + p.size] = value
            now[:depth, at : at + p.size] = p.normalised(record.initial.get(p.name, p.initial))
            at += p.size
        for name, layer in flat.layers().items():
            now[:depth, first[name] : first[name] + layer.size] = record.initial.get(name, layer.initial)
        if 0 < len(target) <= depth:
            raise InputError(
                f"network {flat.name}: record {index} has {len(target)} samples, too short for a delay of {depth}"
            )
        past = now.copy()
        if self.teacher:
            past[depth:, self.forced] = target
        for what, names in (("offset", record.own_offset), ("gain", record.own_gain)):
            if unknown := names - {p.name for p in flat.outputs}:
                raise InputError(
                    f"network {flat.name}: no output {min(unknown)}, whose {what} is to be a recording's own"
                )
        columns = [p for p in flat.outputs for _ in range(p.size)]
        own = tuple(i for i, p in enumerate(columns) if p.name in record.own_offset)
        scaled = {i: p.offset / p.scale for i, p in enumerate(columns) if p.name in record.own_gain}
        return _Window(now, past, target, record.skip, record.weight, slice(0, 0), False, own, scaled)

    def _state_elements(self) -> np.ndarray:
        """(X, 2): element and lag of every past value of a layer that is read."""
        t = self.tables
        longest = np.zeros(int(t.layers[-1, 0]), int)
        for source, width, delay, _ in t.links:
            longest[source : source + width] = np.maximum(longest[source : source + width], delay)
        return np.array(
            [(e, lag) for e in np.flatnonzero(t.row_of >= 0) for lag in range(1, longest[e] + 1)], int
        ).reshape(-1, 2)

    def _state_of(self, now: np.ndarray, step: int = 0) -> np.ndarray:
        """The state before `step`."""
        return now[self.tables.depth + step - self._state[:, 1], self._state[:, 0]]

    def _windowed(
        self, runs: list[_Window], theta: np.ndarray, estimate: bool, shooting: int | None
    ) -> Iterator[_Window]:
        """Each record's run as it is, or cut into windows of `shooting` steps, with the columns of theta added that
        hold the initial states."""
        depth, width = self.tables.depth, len(self._state)
        at = self._size

        def own_state() -> slice:
            nonlocal at
            at += width
            return slice(at - width, at)

        for w in runs:
            first = own_state() if estimate and width else slice(0, 0)
            length = max(shooting or len(w.target), depth, 1)
            if len(w.target) < 2 * length or not width:
                yield replace(w, state=first)
                continue
            t, shown = self.tables, self.tables.rows[self.tables.shown]
            guess = w.past.copy()  # outputs were measured; with them fed back, the other signals follow, if in range
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
        depth, place = self.tables.depth, self.elements()
        found = []
        for w in self.windows:
            if not w.follows:
                self._start(w, theta)
                found.append({n: w.now[:depth, place[n]].copy() for n in self.flat.modules})
        return found

    # ---- evaluation

    @property
    def depth(self) -> int:
        """The longest delay, in steps."""
        return self.tables.depth

    def elements(self) -> dict[str, np.ndarray]:
        """Columns of each input and layer in `simulate`'s traces."""
        layers = self.flat.layers()
        sizes = {p.name: p.size for p in self.flat.inputs} | {n: layers[n].size for n in self.flat.order()}
        ends = np.cumsum(list(sizes.values()))
        return dict(zip(sizes, np.split(np.arange(ends[-1]), ends[:-1]), strict=True))

    def _start(self, w: _Window, theta: np.ndarray) -> None:
        if w.state.stop > w.state.start:
            row, column = self.tables.depth - self._state[:, 1], self._state[:, 0]
            w.now[row, column] = w.past[row, column] = theta[w.state]

    def simulate(self, theta: np.ndarray) -> list[np.ndarray] | None:
        """Every element's signal, (N, elements) per record or window, inputs first; None if it diverges."""
        t = self.tables

        def run(w: _Window) -> bool:
            self._start(w, theta)
            done = forward(t.layers, t.links, t.n_inputs, t.depth, theta, w.now, w.past, self.forced)
            return done == len(w.target)

        work = max((len(w.target) for w in self.windows), default=0) * self._size
        ways = CORES.map if len(self.windows) > 1 and work > WORTH else map
        if not all(list(ways(run, self.windows))):
            return None
        return [w.now[t.depth :] for w in self.windows]

    def errors(self, theta: np.ndarray) -> list[np.ndarray] | None:
        """Normalised prediction less target, (N, outputs) per record or window; None if the free run diverges.

        An offset and a gain of a record's own are the best at theta: they scale the prediction, in what was measured.
        """
        return None if self.simulate(theta) is None else [self._error(w) for w in self.windows]

    def _error(self, w: _Window) -> np.ndarray:
        """Of the run that the window holds."""
        shown = w.now[self.tables.depth :, self.tables.rows[self.tables.shown]]
        error = shown - w.target
        if w.skip >= len(error):
            return error
        for output, zero in w.scaled.items():
            gain, _ = self._gain(w, output)
            error[:, output] = gain * (shown[:, output] + zero) - (w.target[:, output] + zero)
        for output in w.own:
            error[:, output] -= error[w.skip :, output].mean()
        return error

    def _gain(self, w: _Window, output: int) -> tuple[float, np.ndarray]:
        """(the gain that fits best, what it multiplies): where samples count, about the mean beside an offset."""
        shown = w.now[self.tables.depth + w.skip :, self.tables.rows[self.tables.shown][output]] + w.scaled[output]
        return best_gain(shown, w.target[w.skip :, output] + w.scaled[output], about_mean=output in w.own)

    def _own(self, w: _Window) -> dict[int, tuple[float, np.ndarray]]:
        """Output column -> (its gain, orthonormal signals (k, N) of what a gain and an offset of its own may add)."""
        found: dict[int, tuple[float, np.ndarray]] = {}
        count = len(w.target) - w.skip
        for output in {*w.own, *w.scaled} if count > 0 else ():
            gain, signals = 1.0, [np.full(count, count**-0.5)] if output in w.own else []
            if output in w.scaled:
                gain, along = self._gain(w, output)
                if size := float(np.linalg.norm(along)):
                    signals.append(along / size)
            whole = np.zeros((len(signals), len(w.target)))
            whole[:, w.skip :] = signals if signals else 0.0
            found[output] = gain, whole
        return found

    def squares(self, theta: np.ndarray) -> float:
        """Weighted sum of squared errors, gaps between windows included; inf where the run diverges."""
        errors = self.errors(theta)
        if errors is None:
            return np.inf
        with np.errstate(over="ignore", invalid="ignore"):
            total = sum(
                w.weight * float(np.vdot(e[w.skip :], e[w.skip :])) for e, w in zip(errors, self.windows, strict=True)
            )
            total += self.continuity * sum(float(np.sum(gap**2)) for _, gap in self._gaps(theta))
        return total if np.isfinite(total) else np.inf

    @property
    def power(self) -> float:
        """The loss of an output of zero."""
        total = sum(w.weight * float(np.vdot(w.target[w.skip :], w.target[w.skip :])) for w in self.windows)
        return total / (2 * max(self.samples, 1))

    def fingerprint(self) -> str:
        """A digest of the records, of what is free, and of where theta starts: equal objectives have equal ones."""
        scalars = (self._names, self._shapes, self.teacher, [(w.skip, w.weight, w.own, w.scaled) for w in self.windows])
        found = hashlib.sha256(repr(scalars).encode())
        for array in (self.theta, self.variable, *(a for w in self.windows for a in (w.past, w.target))):
            found.update(array.tobytes())
        return found.hexdigest()

    def taking(self, other: "Objective", theta: np.ndarray, states: bool) -> np.ndarray:
        """This objective's theta with the weights of another's, and with `states` the initial states of its records."""
        mine = self.theta.copy()
        mine[: self._size] = theta[: self._size]
        if states:
            own, given = ([w.state for w in p.windows if not w.follows] for p in (self, other))
            for here, there in zip(own, given, strict=True):
                mine[here] = theta[there]
        return mine

    def _gaps(self, theta: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
        """(window, the state it ends with less the one that the next begins with)."""
        for i, following in enumerate(self.windows[1:]):
            if following.follows:
                w = self.windows[i]
                yield i, self._state_of(w.now, len(w.target)) - theta[following.state]

    def normal_equations(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(J'J, J'e) over the variables. Call after `squares` at the same theta (it uses that run)."""
        size = len(self.free)
        hessian, gradient = np.zeros((size, size)), np.zeros(size)
        gaps = dict(self._gaps(theta))
        jobs = enumerate(self.windows)
        spread = len(self.windows) > 1 and self.samples * size**2 > WORTH
        ways = CORES.map if spread else map
        for i, (columns, h, g, end) in enumerate(
            ways(lambda job: self._window_equations(job[1], theta, job[0] in gaps, spread), jobs)
        ):
            if len(columns) == size and i not in gaps:
                hessian += h
                gradient += g
                continue
            if i in gaps:  # d gap = end (columns) - d next state
                after = self.variable[self.windows[i + 1].state]
                joint = np.concatenate([columns, after])
                end = np.hstack([end, -np.eye(len(after))])
                hessian[np.ix_(joint, joint)] += self.continuity * end.T @ end
                gradient[joint] += self.continuity * end.T @ gaps[i]
            hessian[np.ix_(columns, columns)] += h
            gradient[columns] += g
        return hessian, gradient

    def _window_equations(self, w: _Window, theta: np.ndarray, wants_end: bool, alone: bool):
        """(variables that act on it, J'J, J'e, sensitivity of the state at its end) of one window."""
        t: Tables = self.tables
        n, own = self._size, w.state.stop - w.state.start
        carried = np.zeros((t.depth + 1, len(t.rows), n + own))
        if own:
            carried[-self._state[:, 1] % (t.depth + 1), t.row_of[self._state[:, 0]], n + np.arange(own)] = 1.0
        columns = np.concatenate([self.variable[:n], self.variable[w.state]])
        used = np.flatnonzero(columns >= 0)
        targets, where = np.unique(columns[used], return_inverse=True)
        spans = [self._span(row, used, n) for row in t.shown]
        error = self._error(w)
        length = len(w.target)
        rows = min(CHUNK, length)
        alone = alone or length * len(used) ** 2 < WORTH or length <= CHUNK or usable_cores() < 2
        blocks = [np.zeros((rows, len(t.shown), n + own)) for _ in range(1 if alone else 2)]
        outputs = list(enumerate(spans))
        # what one core sums and what two do is the same, to the bit; of portable ones it always was one sum
        parts = [outputs] if self.portable else [part for part in (outputs[::2], outputs[1::2]) if part]
        totals = [(np.zeros((n + own, n + own)), np.zeros(n + own)) for _ in parts]
        added = self._own(w)
        sums = {output: np.zeros((len(z), n + own)) for output, (_, z) in added.items()}  # of J along what they add

        def add(part: int, block: np.ndarray, start: int, stop: int) -> None:
            hessian, gradient = totals[part]
            use = slice(max(w.skip - start, 0), stop - start)
            for output, span in parts[part]:
                j, e = block[use, output, span], error[start:stop][use, output]
                here = (span, span) if isinstance(span, slice) else np.ix_(span, span)
                if output in added:
                    gain, z = added[output]
                    j = gain * j
                    sums[output][:, span] += z[:, start:stop][:, use] @ j
                if self.portable:
                    joint = gram(np.column_stack([j, e]))
                    hessian[here] += joint[:-1, :-1]
                    gradient[span] += joint[:-1, -1]
                else:
                    hessian[here] += j.T @ j
                    gradient[span] += j.T @ e

        derivatives = portable_sensitivities if self.portable else sensitivities
        under_way: list[Future] = []
        for i, start in enumerate(range(0, length, CHUNK)):
            stop, block = min(start + CHUNK, length), blocks[i % len(blocks)]
            derivatives(*t, theta[:n], w.now, w.past, carried, start, stop, block)
            if alone:
                for part in range(len(parts)):
                    add(part, block, start, stop)
                continue
            for future in under_way:
                future.result()
            under_way = [CORES.submit(add, part, block, start, stop) for part in range(len(parts))]  # and fill the next
        for future in under_way:
            future.result()
        hessian, gradient = (sum(found[1:], start=found[0]) for found in zip(*totals, strict=True))
        for total in sums.values():  # offset and gain are the best at every theta (Golub, Pereyra 1973; Kaufman 1975)
            hessian -= total.T @ total
        if len(used) < len(columns):
            hessian, gradient = hessian[np.ix_(used, used)], gradient[used]
        end = None
        if wants_end:
            end = carried[(length - self._state[:, 1]) % (t.depth + 1), t.row_of[self._state[:, 0]]][:, used]
        if self._tied:
            joined = np.zeros((len(used), len(targets)))  # each free column of theta to its variable
            joined[np.arange(len(used)), where] = 1.0
            hessian, gradient = joined.T @ hessian @ joined, joined.T @ gradient
            end = end if end is None else end @ joined
        if w.weight != 1.0:
            hessian *= w.weight
            gradient *= w.weight
        return targets, hessian, gradient, end

    def _span(self, row: int, used: np.ndarray, size: int) -> slice | np.ndarray:
        """Free columns of theta that act on a row: as a slice, where few of those between are frozen."""
        lo, hi = self.tables.spans[row]
        acts = used[((used >= lo) & (used < hi)) | (used >= size)]
        first, last = (int(acts[0]), int(acts[-1]) + 1) if len(acts) else (0, 0)
        return slice(first, last) if len(acts) > NARROW * (last - first) else acts


def movable(flat: Network, place: Mapping[str, np.ndarray], free: Mapping) -> np.ndarray:
    """For each column of the weights and biases, whether it may move: it is not frozen, and `free` allows it.

    place: parameter -> its columns. free: as for `Objective`. Raises InputError for another name or shape.
    """
    for name, which in free.items():
        if name not in place:
            raise InputError(f"network {flat.name}: no parameter {name} to leave free")
        if np.size(which) not in (1, len(place[name])):
            raise InputError(f"free: {name} has shape {flat.parameters()[name].shape}, not {np.shape(which)}")
    found, layers = [], flat.layers()
    for name, columns in place.items():
        layer, _, port = name.rpartition(".")
        frozen = port in layers[layer].frozen
        found.append(np.full(len(columns), not frozen) & np.asarray(free.get(name, True), bool).ravel())
    return np.concatenate(found)


def leaders(
    flat: Network, place: Mapping[str, np.ndarray], may_move: np.ndarray, tied: Sequence[Sequence[str]]
) -> np.ndarray:
    """For each column of theta, the column whose value it takes: its own, or in a group that is tied the first one's.

    Raises InputError for a name that the network does not have, members of different shapes, and those that may not
    move.
    """
    like = np.arange(len(may_move))
    for group in tied:
        first, *others = [_columns(flat, place, name) for name in group]
        for name, columns in zip(group[1:], others, strict=True):
            if len(columns) != len(first):
                raise InputError(f"network {flat.name}: {name} and {group[0]} differ in shape; no tie")
            if not (may_move[columns].all() and may_move[first].all()):
                raise InputError(f"network {flat.name}: {name} or {group[0]} may not move; no tie")
            like[columns] = like[first]
    while (like[like] != like).any():  # groups that share a member
        like = like[like]
    return like


def _columns(flat: Network, place: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    found = [c for n, c in place.items() if n == name or n.startswith(name + ".")]
    if not found:
        raise InputError(f"network {flat.name}: no module, layer or parameter {name} to tie")
    return np.concatenate(found)


def traces(objective: Objective) -> list[np.ndarray]:
    """`Objective.simulate` with the weights as they are. Raises InputError if a run diverges."""
    runs = objective.simulate(objective.theta)
    if runs is None:
        raise InputError(f"network {objective.flat.name}: diverges on the records; train it before compiling")
    return runs
