"""Maximum-likelihood fit of a plant's free parameters to one recording.

    minimise  |e(n, s)|^2 + sum_j (n_j / prior_j)^2 + sum_w heavy |s_w|^2,    e = white(recorded - simulated(n, s))

n (k,): parameters in units of their scales, those with a tolerance and those of the effects under test. s_w: shifts of
the state in which window w begins, from what was recorded. white: noise.py. Each step of Gauss-Newton solves

    (J'J + L) dn = -(J'e + L n),    J = de/dn,  L = diag(1 / prior^2)

with the shifts eliminated window by window: J and e are what the slopes by s_w leave of them (variable projection;
Golub, Pereyra 1973). Covariance of n: B (S'S + L) B with B = (J'J + L)^-1 and S_w = J_w' e_w (Huber's sandwich).
"""

import copy
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from greygate.mismatch.cores import each
from greygate.mismatch.model import TINY, Model
from greygate.mismatch.noise import Noise, deviation
from greygate.mismatch.runs import along, whole
from greygate.mismatch.undetermined import deviations
from greygate.models.training.gauss_newton import Decades, bounded, search
from greygate.plants.recording import Recording
from greygate.progress import cut

WARM = 250  # samples at the beginning that do not count where states are not measured: these die away;
WARM_PART = 12  # but no more than such a part of a recording
LOOSE = 50.0  # shifts of one scale by which a smoothed rate may be off where a window begins, RMS: all of its size
FREE = 1e-6  # weight of a measured state's shift in the cost: a thousand times the noise before it counts
STEP = 1e-3  # of the scale of an effect's number, for differences; it may act by steps of a signal
COARSE = 2e-2  # the same where small ones only show how a run sticks and slips
FINE = 1e-5  # likewise to both sides: the truncation of larger ones makes what is known together look known
SLOPED = 0.05  # of a channel's spread: longer steps that change a run by less change its slopes hardly more
SHIFTED = 0.1  # of a shift's scale, for differences
BLOCK = 250  # samples within which errors may depend on each other, for intervals where there are no windows;
BLOCK_PART = 12  # but no more than such a part of a recording
HELD = 1000  # samples that are learnt from, then judged on, by turns;
HELD_PART = 20  # but no more than such a part of a recording
SINGULAR, BREAD_SINGULAR = 1e-13, 1e-14  # of the largest singular value, below which numbers cannot be told apart
ROUNDING = 1e-6  # of a number's variance: what leaving out a recording adds below it is rounding
ITERATIONS = 15  # of a fit, at most: near its end each gains more digits than the one before
DEAR = ITERATIONS  # runs: a linearisation that takes more, as many as all steps of a fit, is not made anew at once
DIVERGED = 1e100  # standard deviations of noise: what is farther away comes from a run that diverges
NORMAL = 1.96  # standard deviations on either side that hold 95 % of a normal distribution
HALVINGS = 6  # of the way from the unknowns' origins to a start from which the run diverges
ENOUGH = 0.05  # of cost, a twentieth of what noise alone makes of one parameter: a further step tells nothing more
RIDGE = 1e-9  # added to the curvature of each number, far below a prior's: what does not act on the errors stays
WIDENED, LEAP = 4, 10.0  # times that differences are widened by that factor, for deviations, at most; they are wider
UNKNOWN = 1e9  # scales, by which a number may be off, at most: it does nothing
STEEPER = 2.0  # still where one of them grows by more than this: there a run sticks and slips
LESS = 0.1  # of a difference, that in a smooth run changes as much of the errors
STRAIGHT_RUN = 0.01  # of the change of the errors, by which a tenth of it may be off in a run that is smooth
STRAIGHT = 0.7  # share of the promised gain from which the linearisation still serves; a new one costs k + 1 runs
HOPED = 2.0  # times the gain of its last step, that a fit may still gain: near its end steps gain ever less
NEAR = 0.1  # of what the rival's cost exceeds that of noise: a fit that is not hoped to come so near gives up,
FAR = 100.0  # or farther than this cost, which is more than any evidence asked for
MORE_THAN_NOISE = 2.0  # times the cost that noise makes: with more, something is left

Moves = tuple[np.ndarray, Mapping[str, np.ndarray]]
"""How a residual moves: with the windows' shifts (samples, channels, locals), with each symbol's number (samples,
channels)."""

Seen = Callable[[Mapping[str, float], np.ndarray], np.ndarray]


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


def _limits(unknowns: Sequence[Unknown]) -> np.ndarray:
    """Lowest and highest number of each unknown (2, k)."""
    return np.array([sorted((u.number(u.low), u.number(u.high))) for u in unknowns]).reshape(-1, 2).T


def _values(unknowns: Sequence[Unknown], numbers: np.ndarray, fixed: Mapping[str, float]) -> dict[str, float]:
    """Value of every unknown and of what is fixed."""
    return {**fixed, **{u.symbol: float(u.value(n)) for u, n in zip(unknowns, numbers, strict=True)}}


@dataclass(frozen=True)
class Fit:
    """What a fit found.

    likelihood: the likelihood that was fitted. fixed: values of other parameters. numbers: of the unknowns (k,).
    shifts: of the windows' first states, in units of their scales (restarts, locals).
    errors: (target - prediction) / sigma, (samples, channels). weight: of each number's square in the cost (k,).
    cost: sum of squares of the tempered errors, of the shifts and of the numbers, each by its prior.
    temper: what the errors of each channel were divided by (channels,). way: of differences that lead on from here.
    """

    likelihood: "Likelihood"
    unknowns: tuple[Unknown, ...]
    fixed: Mapping[str, float]
    numbers: np.ndarray
    shifts: np.ndarray
    errors: np.ndarray
    weight: np.ndarray
    cost: float
    converged: bool
    temper: np.ndarray
    way: float = STEP

    @property
    def room(self) -> np.ndarray:
        """By how much each unknown's number may fall and rise (k, 2)."""
        return _limits(self.unknowns).T - self.numbers[:, None]

    @cached_property
    def rough(self) -> "tuple[Likelihood, Seen, np.ndarray]":
        """What `Likelihood.roughly` gives of the errors here."""
        return self.likelihood.roughly(self.values, self.shifts, self.errors)

    @cached_property
    def basis(self):
        """Of each window's shifts: (q, r), or None where nothing is shifted."""
        rough, gives, base = self.rough
        return self.likelihood.shifted(rough.by_shifts(gives, base, self.values, self.shifts), self.temper)

    @cached_property
    def slopes(self) -> np.ndarray:
        """Of the errors by the unknowns' numbers, less what the shifts explain (windows, rows, k)."""
        return self._slopes()

    def _slopes(self, both: float = 0.0) -> np.ndarray:
        return self.by(self.unknowns, self.values, both)

    def by(self, unknowns: Sequence[Unknown], values: Mapping[str, float], both: float = 0.0) -> np.ndarray:
        """Likewise by the numbers of other unknowns at `values`, which add to those here what does nothing there."""
        return self.likelihood.eliminate(self.rows(unknowns, values, both), None, self.basis)[0]

    def rows(self, unknowns: Sequence[Unknown], values: Mapping[str, float], both: float = 0.0) -> np.ndarray:
        """The same, with what the shifts explain."""
        rough, gives, base = self.rough
        return self.likelihood.rows(rough.by_numbers(unknowns, gives, base, values, self.shifts, both), self.temper)

    def centred(self, way: float) -> "Fit":
        """This fit, its slopes by differences to both sides: what is known together only stays so in small ones.

        way: to either side, of the numbers' scales.
        """
        other = copy.copy(self)
        for name in ("normal", "information", "covariance"):
            vars(other).pop(name, None)
        vars(other)["slopes"] = other._slopes(way)
        return other

    @cached_property
    def projected(self) -> np.ndarray:
        """The errors less what the shifts explain (windows, rows)."""
        shifts = self.shifts[self.likelihood.fitted]
        tail = None if self.basis is None else (np.sqrt(self.likelihood.heavy) * shifts)[:, :, None]
        rows = self.likelihood.rows(self.errors, self.temper)[:, :, None]
        return self.likelihood.eliminate(rows, tail, self.basis)[0][:, :, 0]

    @cached_property
    def moves(self) -> Moves:
        """How the residual moves here."""
        of, values, shifts = self.likelihood, self.values, self.shifts
        rough, seen, base = of.roughly(values, shifts, of.left(values, shifts), white=False)
        given = seen, base, values, shifts
        by_numbers = rough.by_numbers(self.unknowns, *given, step=self.way)
        return rough.by_shifts(*given), {u.symbol: by_numbers[:, :, j] for j, u in enumerate(self.unknowns)}

    def without(self, held: np.ndarray, iterations: int) -> dict[str, float]:
        """The values of a fit to all samples but those `held` (samples,) of bool, which begins here.

        It is led by the slopes here for as long as they lead down.
        """
        key = held.tobytes(), iterations
        if key not in self._without:
            descent = Descent(self.likelihood.without(held), self.unknowns, self.values, self.shifts.copy())
            descent.moves, descent.fine, descent.way = self.moves, False, self.way
            self._without[key] = descent.ended(iterations).values
        return self._without[key]

    @cached_property
    def _without(self) -> dict[tuple[bytes, int], dict[str, float]]:
        return {}

    @property
    def flat(self) -> np.ndarray:
        """The slopes of all windows, one below the other (windows * rows, k)."""
        return self.slopes.reshape(self.projected.size, len(self.unknowns))

    @cached_property
    def normal(self) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrix (k, k) and right side (k,) of the linearised fit, without the prior."""
        return self.flat.T @ self.flat, -(self.flat.T @ self.projected.reshape(-1))

    @cached_property
    def values(self) -> dict[str, float]:
        """Value of every unknown and of what was fixed."""
        return _values(self.unknowns, self.numbers, self.fixed)

    @cached_property
    def information(self) -> np.ndarray:
        """Of the numbers, prior included, if the errors are white and of unit variance (k, k)."""
        return self.normal[0] + np.diag(self.weight)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Of the numbers (k, k), robust to errors that depend on each other within a window (Huber's sandwich)."""
        bread = _inverse(self.information)
        scores = np.einsum("wrk,wr->wk", self.slopes, self.projected)
        n, k = scores.shape
        scores = scores - scores.mean(axis=0)
        meat = scores.T @ scores * n / max(n - k, 1)
        naive = np.diag(self.weight)
        robust = bread @ (meat + naive) @ bread
        # no narrower than if errors of this size were white
        white = bread * max(1.0, float(np.mean(self.projected**2)))
        return _larger(robust, white)

    def spread(self) -> np.ndarray:
        """Standard deviation of each number (k,) by how far the recordings disagree beyond what each leaves open; or 0.

        It is that of the jackknife, but no more than the number's own times that by which the change that leaving out a
        recording makes exceeds its own deviation (Hausman, Econometrica 46, 1978).
        """
        of, whole_ = self.likelihood.recording, _inverse(self.information)
        steps, factors = [], []
        for name in (names := np.unique(of)) if of.any() else ():
            kept = flattened(self.slopes[of != name])
            more = np.diag(_inverse(kept.T @ kept + np.diag(self.weight)) - whole_)
            steps.append(self.step(of != name))
            factors.append(np.where(more > ROUNDING * np.diag(whole_), steps[-1] ** 2 / np.maximum(more, TINY), 0.0))
        if not steps:
            return np.zeros(len(self.numbers))
        factor = np.mean(factors, axis=0) / max(1.0, float(np.mean(self.projected**2)))
        jackknife = np.var(steps, axis=0) * (len(names) - 1)
        return np.sqrt(np.minimum(factor * np.diag(self.covariance), jackknife))

    def widened(self, symbols: Collection[str]) -> float:
        """The largest factor by which errors that depend on each other widen the variance of one of `symbols`."""
        at = [j for j, u in enumerate(self.unknowns) if u.symbol in symbols]
        bread = np.diag(_inverse(self.information))[at]
        return float(np.max(np.diag(self.covariance)[at] / np.maximum(bread, TINY), initial=1.0))

    def held_out(self, stretch: int = HELD) -> float:
        """Cost of the errors on each half of the recording, with the parameters that the other half alone gives.

        The halves are every other `stretch` samples.
        """
        even = self.likelihood.turns(stretch, 2) == 0
        return sum(self.judged(learn, ~learn) for learn in (even, ~even))

    def judged(self, learn: np.ndarray, judge: np.ndarray) -> float:
        """Cost of the errors in the windows `judge`, with the parameters that the windows `learn` alone give.

        learn, judge: (windows,) of bool. The parameters come from one linearised step from those of the fit.
        """
        step = self.step(learn)
        return float(np.sum((self.projected[judge] + self.slopes[judge] @ step) ** 2))

    def step(self, learn: np.ndarray) -> np.ndarray:
        """Change of the numbers (k,) that the windows `learn` (windows,) alone ask for, within all limits.

        It is of the linearised fit.
        """
        flat, errors = flattened(self.slopes[learn]), self.projected[learn].reshape(-1)
        normal = flat.T @ flat + np.diag(self.weight + RIDGE)
        step = np.linalg.lstsq(normal, -(flat.T @ errors) - self.weight * self.numbers, rcond=SINGULAR)[0]
        return np.clip(step, *self.room.T)

    def deviation(self, symbol: str) -> float:
        """Standard deviation of a value."""
        j = [u.symbol for u in self.unknowns].index(symbol)
        return float(np.sqrt(self.covariance[j, j]) * abs(self.unknowns[j].scale))

    @cached_property
    def together(self) -> dict[str, float]:
        """Standard deviation of every unknown's value, the data sheet's errors being those of one cause, if it may.

        It is widened for as long as slopes fall with wider differences. Where a run sticks and slips, those by small
        ones are far steeper than it is over any way that counts.
        """
        found = self.centred(FINE)._deviations()
        for times in range(1, WIDENED + 1):
            across = self.centred(FINE * LEAP**times)._deviations()
            if not np.any(across > STEEPER * found):
                break
            found = np.maximum(found, across)
        found = np.minimum(found, UNKNOWN)
        return {u.symbol: float(d * abs(u.scale)) for u, d in zip(self.unknowns, found, strict=True)}

    def _deviations(self) -> np.ndarray:
        """Standard deviation of each number (k,), the data sheet's errors being those of one cause, if it may."""
        white = max(1.0, float(np.mean(self.projected**2)))
        found = deviations(self.normal[0] / white, self.weight, np.sqrt(np.diag(self.covariance)))
        return np.maximum(found, self.spread())


def _alike(one: np.ndarray, other: np.ndarray, spread: np.ndarray) -> bool:
    """Whether two runs (samples, channels) are so alike, in parts of a spread, that their slopes are."""
    return bool(np.all(np.std(one - other, axis=0) <= SLOPED * spread))


def flattened(slopes: np.ndarray) -> np.ndarray:
    """Slopes (windows, rows, k) as (windows * rows, k); k may be 0."""
    return slopes.reshape(slopes.shape[0] * slopes.shape[1], slopes.shape[2])


def tame(change: np.ndarray) -> np.ndarray:
    """A change of errors, 0 where a run diverges: there it says nothing, and its square would be no number."""
    return np.where(np.abs(change) < DIVERGED, change, 0.0)


def _solved(normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The step that a normal matrix asks for; the shortest of all where it is singular, none where it is no number."""
    if not (len(right) and np.isfinite(normal).all() and np.isfinite(right).all()):
        return np.zeros(len(right))
    try:
        return np.linalg.solve(normal, right)
    except np.linalg.LinAlgError:
        return np.linalg.lstsq(normal, right, rcond=SINGULAR)[0]


def _inverse(information: np.ndarray) -> np.ndarray:
    """Of an information matrix (k, k), its pseudoinverse; an unknown's unit decides nothing of its rank."""
    size = np.sqrt(np.maximum(np.diag(information), TINY))
    units = np.outer(size, size)
    return np.linalg.pinv(information / units, hermitian=True, rcond=BREAD_SINGULAR) / units


def _larger(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """`one` stretched so that no variance is below that of `other`."""
    stretch = np.sqrt(np.maximum(np.diag(other) / np.maximum(np.diag(one), TINY), 1.0))
    return one * np.outer(stretch, stretch)


class Likelihood:
    """What a model's recording says of parameters: sigma (samples, channels) weighs the errors.

    sigma: standard deviation of what the sensors make of the truth, inf where a sample does not count.
    count: of samples that count, all channels together. windows, block: number of stretches within which errors may
    depend on each other, and their samples; kept: the samples in them. noise: what it is beside that of sigma.
    """

    _longer: tuple[Model, list[Model]] | None = None  # a model, and the same in longer steps

    def __init__(self, model: Model):
        self.model = model
        self.noise = Noise.told(len(model.rig.predict))
        rig, samples = model.rig, len(model.target)
        self.sigma = deviation(model)
        scale = {name: rig.channels[name].sigma for name in model.measured}
        self.local_scale = np.array([scale.get(s) or model.pace(s) / LOOSE for s in model.locals])
        self.heavy = np.array([FREE if s in scale else LOOSE**-2 for s in model.locals])
        shortest = min(p.stop - p.start for p in model.pieces)
        self.block = block = model.window or min(BLOCK, samples // BLOCK_PART, shortest)
        self.windows, self.kept = whole(model.pieces, block)
        counted = np.zeros(samples, bool)
        counted[self.kept] = True
        if model.window is not None and not all(model.reset):
            for piece in model.pieces:
                warm = max(model.window, min(WARM, (piece.stop - piece.start) // WARM_PART))
                counted[piece][:warm] = False
        self.sigma[~counted] = np.inf
        self.count = int(counted.sum()) * self.sigma.shape[1]

    @property
    def fitted(self) -> np.ndarray:
        """Which restarts begin a whole window; what is left behind the last of these is not fitted."""
        counted = np.zeros(len(self.model.target), bool)
        counted[self.kept if self.model.window else slice(None)] = True
        return np.flatnonzero(counted[self.model.restarts])

    @property
    def expected(self) -> float:
        """The cost that the told noise alone makes; 0 where none is told."""
        return float(self.count)

    @property
    def remembers(self) -> bool:
        """Whether the noise has a colour."""
        return any(len(ar) for ar in self.noise.ar)

    def residual(self, values: Mapping[str, float], shifts: np.ndarray | None = None) -> np.ndarray:
        """Recorded less predicted, in the channels' units (samples, channels). shifts: in the units of the locals."""
        return self.model.target - self.model.predict({**self.model.values, **values}, shifts)

    def errors(self, values: Mapping[str, float], shifts: np.ndarray) -> np.ndarray:
        """(target - prediction) / sigma, (samples, channels)."""
        return self.white(self.left(values, shifts))

    def left(self, values: Mapping[str, float], shifts: np.ndarray) -> np.ndarray:
        """The residual, shifts in units of their scales."""
        return self.residual(values, shifts * self.local_scale)

    def white(self, what: np.ndarray) -> np.ndarray:
        """`what` (samples, channels, ...) in units of the noise, less what the noise before makes expected."""
        scaled = what / self.sigma[(..., *(None,) * (what.ndim - 2))]
        return along(lambda part: self.noise.white(part, self.model.window or len(part)), self.model.pieces, scaled)

    @property
    def recording(self) -> np.ndarray:
        """The number of the recording in which each window lies (windows,)."""
        first = np.arange(len(self.model.target))[self.kept][:: self.block]
        return np.searchsorted([piece.stop for piece in self.model.pieces], first, side="right")

    def turns(self, stretch: int, parts: int) -> np.ndarray:
        """In which of so many parts each window is, where stretches of so many samples are in each by turns."""
        stretch = min(stretch, self.windows * self.block // HELD_PART)
        return (np.arange(self.windows) // max(round(stretch / self.block), 1)) % parts

    def without(self, held: np.ndarray) -> "Likelihood":
        """This likelihood without the samples that are `held` (samples,) of bool."""
        other = copy.copy(self)
        other.sigma = np.where(held[:, None], np.inf, self.sigma)
        other.count = int(np.isfinite(other.sigma).sum())
        return other

    def nothing(self) -> np.ndarray:
        """No shifts: every window begins as recorded."""
        return np.zeros((len(self.model.restarts), len(self.model.locals)))

    def cost(self, errors: np.ndarray, shifts: np.ndarray, temper: np.ndarray) -> float:
        """Sum of squares of the tempered errors and of the shifts' prior, inf where the run diverged."""
        cost = float(np.sum((errors / temper) ** 2) + np.sum(self.heavy * shifts**2))
        return cost if np.isfinite(cost) else np.inf

    def rows(self, what: np.ndarray, temper: np.ndarray) -> np.ndarray:
        """(windows, rows, ...) of (samples, channels, ...), each channel divided by its `temper`."""
        tempered = what / temper[(slice(None), *(None,) * (what.ndim - 2))]
        kept = tempered[self.kept]
        return kept.reshape(self.windows, self.block * what.shape[1], *what.shape[2:])

    def longer(self) -> list["Likelihood"]:
        """This likelihood of a simulator from outside in longer steps, the longest first; else none.

        In the longest of them the run without any effect hardly differs, in parts of what is recorded.
        """
        model = self.model
        if not model.plant.outside:
            return []
        if self._longer is None or self._longer[0] is not model:
            run, spread = model.predict(model.values), np.std(model.target, axis=0)
            models, first = [*model.longer()], 0
            while first < len(models) and not _alike(models[first].predict(model.values), run, spread):
                first += 1
            self._longer = model, models[first:]

        def over(longer: Model) -> "Likelihood":
            other = copy.copy(self)
            other.model = longer
            return other

        return [over(longer) for longer in self._longer[1]]

    def rough(self) -> "Likelihood":
        """That in the longest of them; else this."""
        return next(iter(self.longer()), self)

    def roughly(self, values: Mapping[str, float], shifts: np.ndarray, here: np.ndarray, white=True):
        """(this likelihood in the longest steps whose run hardly differs at these values, what it gives, that there).

        here, what it gives: the errors, or the residual where they are not to be `white`.
        """
        target = self.model.target
        for longer in self.longer():
            gives = longer.errors if white else longer.left
            there = gives(values, shifts)
            if _alike(there, here, np.std(self.white(target) if white else target, axis=0)):
                return longer, gives, there
        return self, self.errors if white else self.left, here

    def basis(self, values: Mapping[str, float], shifts: np.ndarray, errors, temper: np.ndarray):
        """(q, r) of each window's own shifts, their prior in the last rows; None where nothing is shifted."""
        rough, seen, base = self.roughly(values, shifts, errors)
        return self.shifted(rough.by_shifts(seen, base, values, shifts), temper)

    def shifted(self, moves: np.ndarray, temper: np.ndarray):
        """The same, by how the errors move with the shifts (samples, channels, locals)."""
        if not (count := moves.shape[2]):
            return None
        prior = np.broadcast_to(np.diag(np.sqrt(self.heavy)), (self.windows, count, count))
        return np.linalg.qr(np.concatenate([self.rows(moves, temper), prior], axis=1))

    def by_shifts(self, seen: Seen, base: np.ndarray, values: Mapping[str, float], shifts: np.ndarray) -> np.ndarray:
        """How what is seen of a run moves from `base` with the shifts, all windows at once (samples, channels, locals).

        seen: of values and shifts (samples, channels).
        """
        if not (count := shifts.shape[1]):
            return np.zeros((*base.shape, 0))

        def slope(j: int) -> np.ndarray:
            moved = shifts.copy()
            moved[:, j] += SHIFTED
            return tame(seen(values, moved) - base) / SHIFTED

        return np.stack(each(slope, range(count)), axis=2)

    def by_numbers(
        self,
        symbols: Sequence[Unknown],
        seen: Seen,
        base: np.ndarray,
        values: Mapping[str, float],
        shifts: np.ndarray,
        both=0.0,
        fine=False,
        step=STEP,
    ) -> np.ndarray:
        """Likewise with each unknown's number (samples, channels, k), by differences to one side or, inside, to both.

        both: of their scales, to both sides. fine: by small ones of the plant's own numbers. step: of the others'
        scales.
        """
        if not symbols:
            return np.zeros((*base.shape, 0))

        def slope(u: Unknown) -> np.ndarray:
            value = values[u.symbol]
            size = (both or (FINE if fine and np.isfinite(u.prior) else step)) * u.scale
            size *= -1 if value + size > u.high else 1
            moved = seen({**values, u.symbol: value + size}, shifts)
            inside = both and u.low <= value - size <= u.high
            before = seen({**values, u.symbol: value - size}, shifts) if inside else base
            return tame(moved - before) / ((2 if inside else 1) * size / u.scale)

        return np.stack(each(slope, symbols), axis=2)

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

    def slopes(
        self, symbols: Sequence[Unknown], values: Mapping[str, float], shifts: np.ndarray, errors, temper
    ) -> np.ndarray:
        """Of `errors` by each unknown's number (windows, rows, k), by differences of runs in longer steps."""
        rough, seen, base = self.roughly(values, shifts, errors)
        return self.rows(rough.by_numbers(symbols, seen, base, values, shifts), temper)

    def fit(
        self,
        unknowns: Sequence[Unknown],
        values: Mapping[str, float] | None = None,
        shifts: np.ndarray | None = None,
        iterations: int = ITERATIONS,
        tempered: bool = False,
        rival: float = np.inf,
        enough: float = ENOUGH,
        slack: float = 0.0,
        both: bool = False,
        leading: "Leading | None" = None,
    ) -> Fit:
        """The best fit near `values` (of unknowns, and of other parameters, which stay) and `shifts`.

        The fit has converged when a step lowers the cost by less than `enough`, or by less than `slack` as a share of
        what the cost exceeds that of noise; where the time of a search is over, it ends before. rival: a cost; a fit
        that is on no way to it gives up. tempered: errors beyond the sensors' noise are taken for what the plant leaves
        out, so that they count less and the data sheet counts more. both: by finer slopes, to both sides. The cost is
        inf if the run diverges from `values` and from nearer to the unknowns' origins too.
        """
        descent = Descent(self, unknowns, values or {}, self.nothing() if shifts is None else shifts.copy())
        descent.both = both
        descent.keep(leading.moves if leading else None)
        fit = descent.ended(iterations, tempered=tempered, rival=rival, enough=enough, slack=slack)
        if leading and descent.dear and fit.cost < leading.cost:
            leading.moves, leading.cost = descent.last, fit.cost
        return fit


@dataclass
class Leading:
    """How the residual moved where the best fit to a recording, of that cost, was linearised last: the next begins so.

    None, where no fit is dear.
    """

    recording: Recording
    moves: Moves | None = None
    cost: float = np.inf


@dataclass(frozen=True)
class _Point:
    """Numbers of the unknowns (k,), shifts of the windows, and the residual, the errors and the cost there."""

    numbers: np.ndarray
    shifts: np.ndarray
    residual: np.ndarray
    errors: np.ndarray
    cost: float


@dataclass(frozen=True)
class _Linear:
    """A likelihood linearised at a point, the windows' shifts eliminated.

    slopes: of the errors that shifts do not explain, by the unknowns' numbers (rows, k). explained: slopes of what
    shifts explain (windows, locals, k). basis: of the shifts, (q, r) or None.
    """

    slopes: np.ndarray
    explained: np.ndarray
    basis: tuple[np.ndarray, np.ndarray] | None
    curvature: np.ndarray


class Descent:
    """Gauss-Newton from a start, within the unknowns' bounds.

    Simulations are dear, and a linearisation takes one for every unknown and every shift: it is kept for as long as the
    steps do what it promises.
    """

    moves: Moves | None = None  # by which it is linearised; None: they are to be taken anew,
    kept: Moves | None = None  # but for these
    last: Moves | None = None  # that were taken
    partial = misled = False  # whether some of it was kept; whether such a step led up
    sharp = dull = False  # whether slopes are to be those of the run itself; whether they were of longer steps
    both = False  # sides, to which slopes are taken
    fine: bool | None = None  # whether small differences of the plant's numbers serve, as soon as that is known
    way = STEP  # of the differences of the others

    def __init__(self, likelihood: Likelihood, unknowns: Sequence[Unknown], values: Mapping, shifts: np.ndarray):
        self.likelihood, self.unknowns, self.fixed = likelihood, tuple(unknowns), dict(values)
        start = np.array([u.number(self.fixed.pop(u.symbol, u.origin)) for u in self.unknowns])
        self.low, self.high = _limits(self.unknowns)
        self.weight = np.array([0.0 if np.isinf(u.prior) else 1.0 / u.prior**2 for u in self.unknowns])
        self.temper = np.ones(likelihood.sigma.shape[1])
        self.at = self.point(np.clip(start, self.low, self.high), shifts)
        for _ in range(HALVINGS):
            if np.isfinite(self.at.cost):
                break
            self.at = self.point(np.clip(self.at.numbers / 2, self.low, self.high), shifts)

    def ended(self, iterations: int, **how: Any) -> Fit:
        """The fit after so many iterations or before. how: as for `run`."""
        converged = False
        with cut():
            converged = self.at.cost < np.inf and self.run(iterations, **how)
        at = self.at
        return Fit(
            self.likelihood, self.unknowns, self.fixed, at.numbers, at.shifts, at.errors, self.weight, at.cost,
            converged, self.temper, self.way,
        )  # fmt: skip

    def point(self, numbers: np.ndarray, shifts: np.ndarray) -> _Point:
        likelihood = self.likelihood
        values = _values(self.unknowns, numbers, self.fixed)
        residual = likelihood.left(values, shifts)
        errors = likelihood.white(residual)
        return _Point(numbers, shifts, residual, errors, self.cost(numbers, shifts, errors))

    def under(self, likelihood: Likelihood) -> None:
        """From here on by another noise; what is known of how the run moves serves still."""
        at, self.likelihood = self.at, likelihood
        errors = likelihood.white(at.residual)
        self.at = replace(at, errors=errors, cost=self.cost(at.numbers, at.shifts, errors))
        self.fine = False if self.way == COARSE else None

    def cost(self, numbers: np.ndarray, shifts: np.ndarray, errors: np.ndarray) -> float:
        return self.likelihood.cost(errors, shifts, self.temper) + float(np.sum(self.weight * numbers**2))

    def run(
        self,
        iterations: int,
        tempered: bool = False,
        rival: float = np.inf,
        enough: float = ENOUGH,
        slack: float = 0.0,
    ) -> bool:
        """Whether it has converged, after so many iterations or before. Arguments: as for `Likelihood.fit`."""
        damping, linear, final = Decades(), None, not tempered and rival == np.inf
        for iteration in range(iterations):
            if tempered:
                self.reweigh()
                linear = self.moves = None
            fresh = linear is None and self.moves is None and self.kept is None
            linear = linear or self.linearised()
            found = self.step(linear, damping, enough, fresh)
            if found is None:
                if not self.anew(final):
                    return True
                linear = None
                continue
            point, promised = found
            if not point.cost < self.at.cost:
                linear = None  # of a point too far away
                self.misled |= self.partial
                self.passed()
                continue
            gain, self.at = self.at.cost - point.cost, point
            damping.fall()
            if gain < max(enough, slack * (point.cost - self.likelihood.count)):
                if not self.anew(final):
                    return True
                linear = None
                continue
            if iteration and point.cost - HOPED * gain > rival + max(NEAR * (rival - self.likelihood.count), FAR):
                return False
            if gain < STRAIGHT * promised or damping.value > 0:
                linear = None
                self.passed()
        return False

    @property
    def dear(self) -> bool:
        """Whether some moves are kept: where all take many runs, and windows begin anew.

        There a plant moves with its own numbers much alike, wherever they are; in free run it does not.
        """
        runs = len(self.unknowns) + self.at.shifts.shape[1]
        return bool(self.likelihood.model.rig.window) and runs > DEAR

    def keep(self, moves: Moves | None) -> None:
        """What of `moves` is not taken anew: all but those with numbers without a prior, which are of effects."""
        known = {u.symbol for u in self.unknowns if np.isfinite(u.prior)}
        self.kept = None
        if moves and self.dear:
            self.kept = moves[0], {s: moved for s, moved in moves[1].items() if s in known}

    def passed(self) -> None:
        """What was linearised serves no more: it is taken anew, first of effects' numbers alone, then of all."""
        effects = any(np.isinf(u.prior) for u in self.unknowns)
        self.keep(self.last if effects and not (self.partial or self.misled) else None)
        self.moves = None

    def anew(self, final: bool) -> bool:
        """Whether this is no end yet, and all is taken anew: what was kept, too, and of a last fit in finer slopes.

        What was kept leads as far astray as errors are large.
        """
        doubted = self.partial and self.at.cost > MORE_THAN_NOISE * self.likelihood.count
        if not (doubted or (final and (self.sharpened() or self.coarsened()))):
            return False
        self.moves = self.kept = None
        return True

    def reweigh(self) -> None:
        """Let each channel's errors count less by as much as they exceed the sensors', here."""
        errors, samples = self.at.errors, self.likelihood.count / self.at.errors.shape[1]
        self.temper = np.maximum(np.sqrt(np.sum(errors**2, axis=0) / samples), 1.0)
        self.at = replace(self.at, cost=self.cost(self.at.numbers, self.at.shifts, errors))

    def linearised(self) -> _Linear:
        """The likelihood linearised here."""
        likelihood = self.likelihood
        if self.moves is None:
            self.moves = self.moving()
        by_shifts, by_number = self.moves
        by_numbers = [by_number[u.symbol][:, :, None] for u in self.unknowns]
        moved = np.concatenate([np.zeros((*by_shifts.shape[:2], 0)), *by_numbers], axis=2)
        shifts, numbers = (likelihood.white(m) if m.size else m for m in (by_shifts, moved))
        basis, slopes = likelihood.shifted(shifts, self.temper), likelihood.rows(numbers, self.temper)
        slopes, explained = likelihood.eliminate(slopes, None, basis)
        flat = flattened(slopes)
        return _Linear(flat, explained, basis, flat.T @ flat)

    def moving(self) -> Moves:
        """How the residual moves here, but for what is kept."""
        at, values = self.at, _values(self.unknowns, self.at.numbers, self.fixed)
        rough, seen, base = self.likelihood, self.likelihood.left, at.residual
        if not self.sharp:
            rough, seen, base = rough.roughly(values, at.shifts, base, white=False)
            self.dull = rough is not self.likelihood
        given = seen, base, values, at.shifts
        kept, self.kept = self.kept, None
        self.partial = kept is not None
        by_shifts, had = kept or (rough.by_shifts(*given), {})
        if self.fine is None:
            self.fine = self.smooth()
            if not self.fine:
                self.coarsened()
        new = [u for u in self.unknowns if u.symbol not in had]
        columns = rough.by_numbers(new, *given, FINE * self.both, self.fine, self.way)
        found = {**had, **{u.symbol: columns[:, :, j] for j, u in enumerate(new)}}
        self.last = by_shifts, found
        return self.last

    def sharpened(self) -> bool:
        """Whether slopes become those of the run itself, which they were not: where more than noise is left, it counts.

        Slopes that are a little off lead as little astray as the errors are large.
        """
        if self.sharp or not self.dull or not self.at.cost > MORE_THAN_NOISE * self.likelihood.count:
            return False
        self.sharp = True
        return True

    def coarsened(self) -> bool:
        """Whether differences become those across what sticks and slips, which they were not, and it does."""
        if self.way == COARSE or not len(self.unknowns) or self.bent(np.ones(len(self.unknowns))) < 1.0:
            return False
        self.way, self.fine = COARSE, False
        return True

    def smooth(self) -> bool:
        """Whether small differences of the plant's own numbers serve: no friction sticks, and nothing is lost."""
        own = np.isfinite([u.prior for u in self.unknowns])
        return not self.likelihood.model.rig.window and bool(any(own)) and self.bent(own) <= STRAIGHT_RUN

    def bent(self, of: np.ndarray) -> float:
        """By how much a tenth of a difference of the numbers `of` (k,) changes the errors unlike a tenth of that."""
        way = STEP * np.where(self.at.numbers + STEP > self.high, -1.0, 1.0) * of
        far, near = (
            tame(self.point(self.at.numbers + s * way, self.at.shifts).errors - self.at.errors) for s in (1.0, LESS)
        )
        return float(np.linalg.norm(near / LESS - far)) / (float(np.linalg.norm(far)) + TINY)

    def step(self, linear: _Linear, damping: Decades, enough: float, fresh: bool) -> tuple[_Point, float] | None:
        """(the point that a step leads to, the gain of cost that the linear model promises of it).

        The cost there is lower, unless the linearisation is not fresh: then the first point is given as it is. None
        where less than `enough` is promised, or no step lowers the cost.
        """
        likelihood, at = self.likelihood, self.at
        fitted = likelihood.fitted
        tail = None if linear.basis is None else (np.sqrt(likelihood.heavy) * at.shifts[fitted])[:, :, None]
        left, pulled = likelihood.eliminate(likelihood.rows(at.errors, self.temper)[:, :, None], tail, linear.basis)
        gradient = left.reshape(-1) @ linear.slopes + self.weight * at.numbers
        diagonal = np.diag(linear.curvature) + self.weight

        def attempt(value: float) -> tuple[_Point, float] | None:
            normal = linear.curvature + np.diag(self.weight + value * diagonal + RIDGE)

            def solved(moving: np.ndarray) -> np.ndarray:
                return _solved(normal[np.ix_(moving, moving)], -gradient[moving])

            numbers = bounded(at.numbers, gradient, self.low, self.high, solved)
            step = numbers - at.numbers
            promised = float(np.sum(pulled**2)) - float(gradient @ step)
            if promised < enough:
                return at, promised
            shifts = at.shifts
            if linear.basis is not None:
                wanted = pulled[:, :, 0] + linear.explained @ step
                shifts = shifts.copy()
                shifts[fitted] -= np.linalg.solve(linear.basis[1], wanted[:, :, None])[:, :, 0] / (1 + value)
            point = self.point(numbers, shifts)
            return (point, promised) if point.cost < at.cost or not fresh else None

        found = search(attempt, damping)
        return None if found is None or found[1] < enough else found
