"""Maximum-likelihood fit of a plant's free parameters to one recording.

Two kinds of unknowns are fitted together by Gauss-Newton: free parameters (those with a tolerance, held to the data
sheet by it, and those of the effects under test), and where each window begins (x, v, pressures: as recorded, and
shifted). The shifts of a window touch that window alone and are eliminated there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import savgol_filter

from greygate.mismatch.model import Model

WARM = 0.25  # s at the beginning of a recording that count for nothing where states are not measured
LOOSE = 0.05  # m/s by which a smoothed velocity may be off where a window begins, RMS
LONGEST = 200  # samples of one recorded code that are counted as one reading
STEP = 1e-3  # of a parameter's scale, for differences
BLOCK = 0.25  # s within which errors may depend on each other, for intervals where there are no windows
HALVINGS = 6  # of a start from which the run diverges
ENOUGH = 0.05  # of cost, below which a further step is not taken


@dataclass(frozen=True)
class Unknown:
    """A parameter to be fitted: value = origin + scale * number.

    prior: standard deviation of that number, inf where nothing is known. low, high: bounds of the value.
    """

    symbol: str
    origin: float
    scale: float
    prior: float = np.inf
    low: float = -np.inf
    high: float = np.inf

    def value(self, number: float) -> float:
        return self.origin + self.scale * number

    def number(self, value: float) -> float:
        return (value - self.origin) / self.scale


@dataclass(frozen=True)
class Fit:
    """What a fit found.

    problem: of which it is the fit. numbers: of the unknowns, scaled (k,). shifts: (restarts, locals).
    errors: (target - prediction) / sigma, (samples, channels). cost: sum of squares of errors, of the shifts' and the
    parameters' priors. temper: by which the errors of each channel counted less.
    """

    problem: "Likelihood"
    unknowns: tuple[Unknown, ...]
    fixed: Mapping[str, float]
    numbers: np.ndarray
    shifts: np.ndarray
    errors: np.ndarray
    weight: np.ndarray
    cost: float
    converged: bool
    temper: np.ndarray

    @cached_property
    def basis(self):
        """Of each window's shifts."""
        return self.problem.basis(self.values, self.shifts, self.errors, self.temper)

    @cached_property
    def slopes(self) -> np.ndarray:
        slopes = self.problem.slopes(self.unknowns, self.values, self.shifts, self.errors, self.temper)
        return self.problem.eliminate(slopes, None, self.basis)[0]

    @cached_property
    def projected(self) -> np.ndarray:
        tail = None if self.basis is None else (np.sqrt(self.problem.heavy) * self.shifts)[:, :, None]
        rows = self.problem.rows(self.errors, self.temper)[:, :, None]
        return self.problem.eliminate(rows, tail, self.basis)[0][:, :, 0]

    @cached_property
    def values(self) -> dict[str, float]:
        """Value of every unknown and of what was fixed."""
        found = {u.symbol: float(u.value(n)) for u, n in zip(self.unknowns, self.numbers, strict=True)}
        return {**self.fixed, **found}

    @cached_property
    def information(self) -> np.ndarray:
        """Of the numbers, prior included, were errors white and of unit variance (k, k)."""
        flat = self.slopes.reshape(-1, len(self.numbers))
        return flat.T @ flat + np.diag(self.weight)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Of the numbers (k, k), robust to errors that depend on each other within a window (Huber's sandwich)."""
        bread = np.linalg.pinv(self.information, hermitian=True, rcond=1e-14)
        scores = np.einsum("wrk,wr->wk", self.slopes, self.projected)
        n, k = scores.shape
        scores = scores - scores.mean(axis=0)
        meat = scores.T @ scores * n / max(n - k, 1)
        naive = np.diag(self.weight)
        robust = bread @ (meat + naive) @ bread
        # no narrower than white errors of this size would have it
        white = bread * max(1.0, float(np.mean(self.projected**2)))
        return _larger(robust, white)

    def held_out(self, stretch: float = 1.0) -> float:
        """Cost of every other `stretch` s of the recording with the parameters that the rest alone would give.

        Both halves are judged so, each by the other; the step from the whole recording's parameters is linearised.
        """
        block = self.problem.block * self.problem.model.rig.dt
        even = (np.arange(len(self.slopes)) // max(round(stretch / block), 1)) % 2 == 0
        low, high = np.array([sorted((u.number(u.low), u.number(u.high))) for u in self.unknowns]).reshape(-1, 2).T
        total = 0.0
        for learn in (even, ~even):
            flat, errors = self.slopes[learn].reshape(-1, len(self.numbers)), self.projected[learn].reshape(-1)
            normal = flat.T @ flat + np.diag(self.weight + 1e-9)
            step = np.linalg.lstsq(normal, -(flat.T @ errors) - self.weight * self.numbers, rcond=1e-13)[0]
            step = np.clip(self.numbers + step, low, high) - self.numbers
            total += float(np.sum((self.projected[~learn] + self.slopes[~learn] @ step) ** 2))
        return total

    def deviation(self, symbol: str) -> float:
        """Standard deviation of a value."""
        j = [u.symbol for u in self.unknowns].index(symbol)
        return float(np.sqrt(self.covariance[j, j]) * abs(self.unknowns[j].scale))


def _larger(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """`one` stretched so that no variance is below that of `other`."""
    stretch = np.sqrt(np.maximum(np.diag(other) / np.maximum(np.diag(one), 1e-300), 1.0))
    return one * np.outer(stretch, stretch)


class Likelihood:
    """A model's recording with its weights: sigma (samples, channels) of what the sensors make of the truth."""

    def __init__(self, model: Model):
        self.model = model
        rig, samples = model.rig, len(model.target)
        free = model.window is None
        sigma = []
        for i, name in enumerate(rig.predict):
            channel = rig.channels[name]
            variance = np.full(samples, channel.noise**2)
            if channel.resolution:
                variance += channel.resolution**2 / 12 * runs(model.target[:, i])
            for given in rig.inputs if free else ():
                if rig.channels[given].unit != channel.unit:
                    continue  # how much of its rounding arrives the plant alone knows
                variance += rig.channels[given].resolution ** 2 / 12 * runs(model.recording[given])
            sigma.append(np.sqrt(variance) * (1.0 if channel.noise else roughness(model.target[:, i], channel.sigma)))
        self.sigma = np.stack(sigma, axis=1)
        scale = {name: rig.channels[name].sigma for name in model.measured}
        self.local_scale = np.array([scale.get(s, 1e-3) for s in model.locals])
        self.heavy = np.array([1e-6 if s in scale else (1e-3 / LOOSE) ** 2 for s in model.locals])
        block = model.window or round(BLOCK / rig.dt)
        self.windows, self.block = samples // block, block
        counted = np.zeros(samples, bool)
        counted[: self.windows * block] = True
        if not free and not all(model.reset):
            counted[: max(model.window, round(WARM / rig.dt))] = False  # states that no sensor shows settle
        self.sigma[~counted] = np.inf
        self.count = int(counted.sum()) * self.sigma.shape[1]

    def errors(self, values: Mapping[str, float], shifts: np.ndarray) -> np.ndarray:
        """(target - prediction) / sigma, (samples, channels)."""
        predicted = self.model.predict({**self.model.values, **values}, shifts * self.local_scale)
        return self.white(self.model.target - predicted)

    def white(self, what: np.ndarray) -> np.ndarray:
        """`what` (samples, channels, ...) in units of the noise."""
        return what / self.sigma[(..., *(None,) * (what.ndim - 2))]

    def nothing(self) -> np.ndarray:
        return np.zeros((len(self.model.restarts), len(self.model.locals)))

    def cost(self, errors: np.ndarray, shifts: np.ndarray, temper: np.ndarray) -> float:
        """Sum of squares of the tempered errors and of the shifts' prior, inf where the run diverged."""
        cost = float(np.sum((errors / temper) ** 2) + np.sum(self.heavy * shifts**2))
        return cost if np.isfinite(cost) else np.inf

    def rows(self, what: np.ndarray, temper: np.ndarray) -> np.ndarray:
        """(windows, rows, ...) of (samples, channels, ...), each channel divided by its `temper`."""
        scaled = what / temper[(slice(None), *(None,) * (what.ndim - 2))]
        kept = scaled[: self.windows * self.block]
        return kept.reshape(self.windows, self.block * what.shape[1], *what.shape[2:])

    def basis(self, values: Mapping[str, float], shifts: np.ndarray, errors: np.ndarray, temper: np.ndarray):
        """(q, r) of each window's own shifts, their prior in the last rows; None where nothing is shifted."""
        count = shifts.shape[1]
        if count == 0:
            return None
        columns = []
        for j in range(count):
            moved = shifts.copy()
            moved[:, j] += 0.1
            columns.append(self.rows(np.nan_to_num(self.errors(values, moved) - errors) / 0.1, temper))
        local = np.stack(columns, axis=2)
        prior = np.broadcast_to(np.diag(np.sqrt(self.heavy)), (self.windows, count, count))
        return np.linalg.qr(np.concatenate([local, prior], axis=1))

    def eliminate(self, rows: np.ndarray, tail: np.ndarray | None, basis) -> tuple[np.ndarray, np.ndarray]:
        """(rows less what the shifts explain, what they explain). rows: (windows, rows, n), tail: the prior's rows."""
        if basis is None:
            return rows, np.zeros((self.windows, 0, rows.shape[2]))
        q, _ = basis
        if tail is None:
            tail = np.zeros((self.windows, q.shape[2], rows.shape[2]))
        rows = np.concatenate([rows, tail], axis=1)
        inside = np.swapaxes(q, 1, 2) @ rows
        return rows - q @ inside, inside

    def slopes(self, symbols: Sequence[Unknown], values: Mapping[str, float], shifts, errors, temper) -> np.ndarray:
        """Of `errors` by each unknown's number, (windows, rows, k)."""
        columns = []
        for u in symbols:
            value = values[u.symbol]
            size = STEP * u.scale * (-1 if value + STEP * u.scale > u.high else 1)
            moved = self.errors({**values, u.symbol: value + size}, shifts)
            columns.append(self.rows(np.nan_to_num(moved - errors) / (size / u.scale), temper))
        if not columns:
            return np.zeros((self.windows, self.block * errors.shape[1], 0))
        return np.stack(columns, axis=2)

    def fit(
        self,
        unknowns: Sequence[Unknown],
        values: Mapping[str, float] | None = None,
        shifts: np.ndarray | None = None,
        iterations: int = 15,
        tempered: bool = False,
        rival: float = np.inf,
        enough: float = ENOUGH,
        slack: float = 0.0,
    ) -> Fit:
        """The best fit near `values` (of unknowns and others that stay) and `shifts`.

        enough: gain of cost below which no further step is taken; slack: the same, as a share of the cost beyond that
        of noise. rival: a cost; a fit that is on no way to it gives up. tempered: errors above the sensors' are laid to
        what the plant leaves out, so that they count less and the data sheet more. The cost is inf where even the
        plant of the data sheet diverges.
        """
        temper = np.ones(self.sigma.shape[1])
        unknowns, values = tuple(unknowns), dict(values or {})
        k = len(unknowns)
        numbers = np.array([u.number(values.pop(u.symbol, u.origin)) for u in unknowns])
        bounds = np.array([sorted((u.number(u.low), u.number(u.high))) for u in unknowns]).reshape(k, 2)
        low, high = bounds.T
        numbers = np.clip(numbers, low, high)
        shifts = self.nothing() if shifts is None else shifts.copy()
        weight = np.array([0.0 if np.isinf(u.prior) else 1.0 / u.prior**2 for u in unknowns])

        def full(n):
            return {**values, **{u.symbol: float(u.value(x)) for u, x in zip(unknowns, n, strict=True)}}

        def at(n, s):
            e = self.errors(full(n), s)
            return e, self.cost(e, s, temper) + float(np.sum(weight * n**2))

        errors, cost = at(numbers, shifts)
        for _ in range(HALVINGS):  # a start from which the run diverges: nearer to where each unknown has its origin
            if np.isfinite(cost):
                break
            numbers = np.clip(numbers / 2, low, high)
            errors, cost = at(numbers, shifts)
        if not np.isfinite(cost):
            return Fit(self, unknowns, values, numbers, shifts, errors, weight, cost, False, temper)
        damping, converged, slopes, basis, fresh = 0.0, False, None, None, False
        for iteration in range(iterations):
            if tempered:
                temper = np.maximum(np.sqrt(np.sum(errors**2, axis=0) / (self.count / errors.shape[1])), 1.0)
                cost = self.cost(errors, shifts, temper) + float(np.sum(weight * numbers**2))
                slopes = None
            if slopes is None:
                basis = self.basis(full(numbers), shifts, errors, temper)
                slopes = self.slopes(unknowns, full(numbers), shifts, errors, temper)
                slopes, inside = self.eliminate(slopes, None, basis)
                flat = slopes.reshape(-1, k)
                curvature, fresh = flat.T @ flat, True
            tail = None if basis is None else (np.sqrt(self.heavy) * shifts)[:, :, None]
            e, pulled = self.eliminate(self.rows(errors, temper)[:, :, None], tail, basis)
            right = -(e.reshape(-1) @ flat) - weight * numbers
            held = ((numbers <= low) & (right < 0)) | ((numbers >= high) & (right > 0))
            taken = None
            while damping < 1e8:
                normal = curvature + np.diag(weight + damping * (np.diag(curvature) + weight) + 1e-9)
                step = np.zeros(k)
                if (~held).any():
                    step[~held] = np.linalg.solve(normal[np.ix_(~held, ~held)], right[~held])
                moved = np.clip(numbers + step, low, high)
                step = moved - numbers
                promised = float(right @ step) + float(np.sum(pulled**2))
                if promised < enough:
                    converged = True
                    break
                s = shifts
                if basis is not None:
                    wanted = pulled[:, :, 0] + inside @ step
                    s = shifts - np.linalg.solve(basis[1], wanted[:, :, None])[:, :, 0] / (1 + damping)
                trial, c = at(moved, s)
                if c < cost:
                    taken = (moved, s, trial, c)
                    break
                if not fresh:
                    break
                damping = max(damping * 10, 1e-2)
            if converged or (taken is None and fresh):
                converged = True
                break
            if taken is None:
                slopes = None
                continue
            gain = cost - taken[3]
            numbers, shifts, errors, cost = taken
            damping = damping / 10 if damping > 1e-3 else 0.0
            if gain < max(enough, slack * (cost - self.count)):
                converged = True
                break
            if iteration and cost - 2 * gain > 1.1 * rival:
                break
            fresh = False
            if gain < 0.7 * promised or damping > 0:
                slopes = None  # the plant bends: made anew where it stands now
        return Fit(self, unknowns, values, numbers, shifts, errors, weight, cost, converged, temper)


def runs(signal: np.ndarray) -> np.ndarray:
    """For each sample the length of the run of equal values it stands in, at most LONGEST."""
    change = np.flatnonzero(np.diff(signal) != 0) + 1
    edges = np.concatenate(([0], change, [len(signal)]))
    lengths = np.diff(edges)
    return np.minimum(np.repeat(lengths, lengths), LONGEST).astype(float)


def roughness(signal: np.ndarray, sigma: float) -> float:
    """How much rougher a channel is than its rounding alone makes it, at least 1; for a sensor whose noise is not told.

    From what a cubic over nine samples leaves of the signal where it moves.
    """
    left = signal - savgol_filter(signal, 9, 3)
    moving = runs(signal) < 5
    if moving.mean() < 0.05:
        return 1.0
    share = 1.0 - savgol_coefficient(9, 3)
    return max(1.0, float(np.sqrt(np.mean(left[moving] ** 2) / share) / sigma))


def savgol_coefficient(window: int, order: int) -> float:
    """Weight of a sample in its own smoothed value."""
    from scipy.signal import savgol_coeffs

    return float(savgol_coeffs(window, order)[window // 2])
