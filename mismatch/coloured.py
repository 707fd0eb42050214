"""Recordings whose noise nobody told: its colour and size are fitted along with every hypothesis.

Measured plants leave errors that depend on each other for seconds. With each candidate an autoregression of what it
leaves in free run is fitted too, by channel (joint maximum likelihood); errors are then innovations, and costs are
-2 log likelihood. An effect is claimed where it pays for its parameters and for the number of hypotheses, and where it
also predicts blocks that were held out of its fit.
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter
from scipy.stats import norm

from greygate.mismatch.effects import Effect
from greygate.mismatch.fit import Fit, Problem, Unknown
from greygate.mismatch.model import Model
from greygate.mismatch.search import Hypothesis, Search
from greygate.mismatch.verdict import Verdict

ORDERS = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24)  # of the autoregression, one of them by BIC
MEMORY = 0.02  # of a recording, within which noise forgets
PIECES = 40  # of a recording, within which innovations may depend on each other, for intervals
ROUNDS = 6  # of plant and noise in turn, at most
EFFECTS = 4  # at most
TRIED = 5  # hypotheses of a round that are fitted in full, by each of two scores
DRAWS = 50  # from the data sheet's tolerance, the best of which starts a fit
EXCHANGED = 3  # hypotheses that are tried in the place of an earlier one
SURE = 10.0  # of cost that an effect must save beyond what its parameters and the number of hypotheses cost
HELD = 5  # folds that are held out in turn
BLOCKS = 4  # of a fold
LAGS = (0, 1, 2, 4, 8, 16)  # samples by which a signal goes before the innovation it may explain
SIGNIFICANT = 1e-4  # chance of so large a correlation where there is none, after correction


class Coloured(Problem):
    """A problem with an autoregression by channel: ar[i] (order,), scale (channels,) of its innovations, RMS.

    It forgets within MEMORY of the recording: what is slower than that is laid to the plant, not to noise. Before the
    first sample there was none, for there the plant begins.
    """

    def __init__(self, model: Model):
        self.model = model
        self.local_scale = self.heavy = np.ones(0)
        samples, channels = model.target.shape
        self.block = max(samples // PIECES, 2)
        self.windows = samples // self.block
        self.sigma = np.ones(model.target.shape)
        self.ar, self.scale = [np.zeros(0)] * channels, np.std(model.target, axis=0)
        self.mask = np.arange(samples) < self.windows * self.block  # samples that count
        self.decay = np.exp(-1.0 / (MEMORY * samples))

    @property
    def order(self) -> int:
        return len(self.ar[0])

    @property
    def count(self) -> int:
        return int(self.mask.sum()) * len(self.scale)

    def white(self, what: np.ndarray) -> np.ndarray:
        out = np.empty_like(what)
        for i, (ar, scale) in enumerate(zip(self.ar, self.scale, strict=True)):
            out[:, i] = lfilter(np.concatenate(([1.0], -ar)), [1.0], what[:, i], axis=0) / scale
        out[~self.mask] = 0.0
        return out

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Recorded less predicted, in the channels' units (samples, channels)."""
        return self.model.target - self.model.predict({**self.model.values, **values})

    def learnt(self, residual: np.ndarray, order: int | None = None) -> "Coloured":
        """This problem with the noise that fits `residual` best."""
        other = copy.copy(self)
        order = self.order if order is None else order
        shrink = self.decay ** np.arange(1, order + 1)
        other.ar = [shrink * _regressed(r, order, self.mask) for r in residual.T]
        other.scale = np.ones(len(self.scale))
        other.scale = np.sqrt(np.mean(other.white(residual)[self.mask] ** 2, axis=0)) + 1e-300
        return other

    def likelihood(self) -> float:
        """-2 log likelihood of the innovations, less a constant."""
        return float(np.sum(2.0 * np.log(self.scale)) * self.mask.sum())

    def ordered(self, residual: np.ndarray) -> "Coloured":
        """This problem with noise of the order that pays for itself."""
        orders = [order for order in ORDERS if order < len(residual) / 20]
        tried = [self.learnt(residual, order) for order in orders]
        return min(tried, key=lambda p: p.likelihood() + len(p.ar) * p.order * np.log(p.count))

    def fit(self, unknowns: Sequence[Unknown], values=None, shifts=None, **options) -> Fit:
        """Plant and noise in turn until neither gains. `cost` is the joint -2 log likelihood and the priors'."""
        options = {k: v for k, v in options.items() if k not in ("rival", "tempered")}
        problem, values, best = self, dict(values or {}), None
        for _ in range(ROUNDS if self.order else 2):
            fit = Problem.fit(problem, unknowns, values, shifts, **options)
            residual = problem.residual(fit.values)
            if not np.isfinite(residual).all():
                return best or replace(fit, cost=np.inf)
            problem = problem.learnt(residual)
            joint = problem.likelihood() + float(np.sum(fit.weight * fit.numbers**2))
            values = fit.values
            fit = replace(fit, problem=problem, errors=problem.white(residual), cost=joint)
            gain = np.inf if best is None else best.cost - joint
            if gain > 0:
                best = fit
            if gain < 1.0:
                break
        return best


def _regressed(error: np.ndarray, order: int, keep: np.ndarray) -> np.ndarray:
    """Of `error` on its own past (order,), by least squares over the samples in `keep`."""
    if not order:
        return np.zeros(0)
    past = np.stack([_late(error, k) for k in range(1, order + 1)], axis=1)[keep]
    return np.linalg.lstsq(past, error[keep], rcond=1e-10)[0]


def _late(signal: np.ndarray, by: int) -> np.ndarray:
    return np.concatenate((np.zeros(by), signal[: len(signal) - by]))


# -- the search ------------------------------------------------------------------------------------------------------


@dataclass
class Found:
    """What `explain` found; for each claimed effect `gains` has (cost saved, cost saved on held-out blocks)."""

    verdict: Verdict
    best: Hypothesis
    calibrated: Fit
    corrected: Fit
    costs: dict
    gains: dict
    left: str
    search: Search


def explain(search: Search, say: Callable[[str, float], None]) -> Found:
    """Forward selection and backward elimination over the hypotheses of `search`, whose noise is not told."""
    nothing = Hypothesis()
    say("calibrating", 0.05)
    calibrated = search.fit(search.final, nothing, drawn(search, search.final, nothing, {}))
    for _ in range(2):
        problem = calibrated.problem.ordered(calibrated.problem.residual(calibrated.values))
        calibrated = search.fit(problem, nothing, calibrated.values)
    search.final = search.screen = calibrated.problem
    search.effects = {key: scaled(calibrated.problem, effect, calibrated) for key, effect in search.effects.items()}
    tried = {nothing: calibrated}
    gains: dict[str, tuple[float, float]] = {}
    best, fit, start = nothing, calibrated, set(beginnings(search.final.model))
    for round_ in range(EFFECTS):
        taken = None
        ranked = [s for s in promising(search, fit, best, TRIED) if not set(s.hypothesis.released) & start]
        say(f"fitting {len(ranked)} hypotheses", 0.1 + 0.15 * round_)
        found = []
        for score in ranked:
            hypothesis = best.plus(score.hypothesis)
            richer = fitted(search, fit, hypothesis, score.values)
            if not np.isfinite(richer.cost):
                continue
            if richer.cost < getattr(tried.get(hypothesis), "cost", np.inf):
                tried[hypothesis] = richer
            price = SURE + 2 * np.log(len(search.effects)) + _price(richer, fit)
            if fit.cost - richer.cost > price:
                found.append((richer.cost + price, hypothesis, richer))
        for _, hypothesis, richer in sorted(found, key=lambda f: f[0]):
            say(f"holding out blocks from {hypothesis}", 0.2 + 0.15 * round_)
            gain, better = held_out(search, best, fit, hypothesis, richer)
            if gain > 0 and better > HELD / 2:
                taken = hypothesis, richer
                name = (hypothesis.effects[len(best.effects) :] + hypothesis.released[len(best.released) :])[0]
                gains[name] = fit.cost - richer.cost, gain
                break
        if taken is None:
            break
        best, fit = _exchanged(search, *taken, tried)
    best, fit = _eliminated(search, best, fit, tried)
    costs = {h: f.cost for h, f in tried.items()}
    left = remaining(fit)
    if best == nothing:
        verdict = Verdict.UNEXPLAINED if left else Verdict.CONSISTENT
    else:
        verdict = Verdict.MISSING_PHYSICS if best.effects else Verdict.PARAMETER_ERROR
    return Found(verdict, best, calibrated, fit, costs, gains, left, search)


def promising(search: Search, fit: Fit, given: Hypothesis, count: int) -> list:
    """The hypotheses of best score under the noise of `fit`, and under white noise, each with where it starts.

    Noise learnt from a wrong plant takes slow errors for its own, and would rank their cause last.
    """
    plain = fit.problem.learnt(fit.problem.residual(fit.values), 0)
    white = replace(fit, problem=plain, errors=plain.errors(fit.values, fit.shifts))
    ranked = [search.scores(f.problem, f, given)[:count] for f in (fit, white)]
    return [*ranked[0], *ranked[1]]


def fitted(search: Search, fit: Fit, hypothesis: Hypothesis, values: Mapping[str, float]) -> Fit:
    """The best of two fits from `values` on: with the noise of `fit`, and with white noise first.

    A first effect has a third, from the best draw from the data sheet: the parameters of a plant that lacks something
    may be far off.
    """
    found = [search.fit(fit.problem, hypothesis, {**fit.values, **values})]
    white = fit.problem.learnt(fit.problem.residual(fit.values), 0)
    starts = [{**fit.values, **values}]
    if hypothesis.size == 1:
        starts.append(drawn(search, white, hypothesis, values))
    for start in starts:
        plain = search.fit(white, hypothesis, start)
        if np.isfinite(plain.cost):
            coloured = plain.problem.learnt(plain.problem.residual(plain.values), fit.problem.order)
            found.append(search.fit(coloured, hypothesis, plain.values))
    return min(found, key=lambda f: f.cost)


def drawn(search: Search, problem: Coloured, hypothesis: Hypothesis, values: Mapping[str, float]) -> dict[str, float]:
    """`values` with parameters drawn within the data sheet's tolerance, the best of DRAWS."""
    rng = np.random.default_rng(0)
    own = {u.symbol: u for u in search.unknowns(hypothesis) if u.symbol in search.toleranced}
    constants = search.constants(hypothesis)
    best, least = dict(values), np.inf
    for k in range(DRAWS):
        numbers = rng.uniform(-2.0, 2.0, len(own)) * (k > 0)
        tried = {s: float(np.clip(u.value(x), u.low, u.high)) for (s, u), x in zip(own.items(), numbers, strict=True)}
        residual = problem.residual({**constants, **tried, **values})
        cost = float(np.sum(np.mean(residual**2, axis=0) / np.var(problem.model.target, axis=0)))
        if cost < least:
            best, least = {**tried, **values}, cost
    return best


def _exchanged(search: Search, best: Hypothesis, fit: Fit, fits) -> tuple[Hypothesis, Fit]:
    """With earlier effects replaced by others that do better now that the last one is there."""
    for drop in best.effects[:-1]:
        less = Hypothesis(tuple(k for k in best.effects if k != drop), best.released)
        without = fits.get(less) or search.fit(fit.problem, less, fit.values)
        fits[less] = without
        for score in promising(search, without, less, EXCHANGED):
            hypothesis = less.plus(score.hypothesis)
            if not score.hypothesis.effects or set(hypothesis.effects) == set(best.effects):
                continue
            if hypothesis in fits:
                continue
            other = fitted(search, without, hypothesis, score.values)
            fits[hypothesis] = other
            if other.cost + _price(other, fit) < fit.cost:
                best, fit = hypothesis, other
    return best, fit


def _price(more: Fit, less: Fit) -> float:
    """BIC's, of the parameters that one fit has and the other has not."""
    return (len(more.unknowns) - len(less.unknowns)) * np.log(more.problem.count)


def _eliminated(search: Search, best: Hypothesis, fit: Fit, fits):
    """Without the effects that no longer pay."""
    for drop in (*best.effects, *best.released):
        if best.size < 2:
            break
        less = Hypothesis(tuple(k for k in best.effects if k != drop), tuple(s for s in best.released if s != drop))
        tried = fits[less] = search.fit(fit.problem, less, fit.values)
        if tried.cost - fit.cost < SURE + _price(fit, tried):
            best, fit = less, tried
    return best, fit


def scaled(problem: Coloured, effect: Effect, fit: Fit) -> Effect:
    """The effect with `typical` strengths at which it changes the prediction by as much as is unexplained."""
    size = np.std(problem.residual(fit.values), axis=0) + 1e-300
    base = problem.model.predict({**problem.model.values, **fit.values})
    free = []
    for f in effect.free:
        typical = f.typical
        for _ in range(0 if f.shape or effect.frees or f.guess else 4):
            value = min(max(1e-3 * typical, f.low), f.high) or max(-1e-3 * typical, f.low)
            moved = problem.model.predict({**problem.model.values, **fit.values, **effect.set, f.symbol: value})
            change = float(np.max(np.nan_to_num(np.std(moved - base, axis=0), nan=np.inf) / size)) * 1e3
            if not 0.0 < change < np.inf:
                typical *= 100.0 if change == 0.0 else 0.01
            elif 0.3 < change < 3.0:
                break
            else:
                typical /= change
        free.append(replace(f, typical=float(np.clip(typical, -abs(f.low), abs(f.high)))))
    return replace(effect, free=tuple(free))


def held_out(search: Search, less, fit: Fit, more, richer: Fit) -> tuple[float, int]:
    """(cost that `more` saves over `less` on blocks held out of both, in how many of the HELD folds it saves).

    A fold's blocks are spread over the recording, so that no regime is held out as a whole.
    """
    mask = fit.problem.mask
    fold = (np.arange(len(mask)) * HELD * BLOCKS // len(mask)) % HELD
    saved = []
    for k in range(HELD):
        block = mask & (fold == k)
        scores = []
        for hypothesis, full in ((less, fit), (more, richer)):
            without = copy.copy(full.problem)
            without.mask = full.problem.mask & ~block
            tried = search.fit(without, hypothesis, full.values, iterations=8)
            judge = copy.copy(tried.problem)
            judge.mask = block
            errors = judge.errors(tried.values, tried.shifts)
            scores.append(float(np.sum(errors**2)) + judge.likelihood())
        saved.append(scores[0] - scores[1])
    return float(np.sum(saved)), int(np.sum(np.array(saved) > 0))


def remaining(fit: Fit) -> str:
    """What the innovations of the errors still depend on, in words; empty where nothing is significant.

    They are compared with lagged inputs, their magnitudes, and time.
    """
    model = fit.problem.model
    signals = {name: model.recording[name] for name in model.rig.inputs}
    found = []
    keep = fit.problem.mask
    for channel, error in zip(model.rig.predict, fit.errors.T, strict=True):
        e = error[keep] - error[keep].mean()
        for name, signal in {**signals, "t": model.recording.time}.items():
            for shown, kind in ((name, signal), (f"|{name}|", np.abs(signal - np.median(signal)))):
                for lag in LAGS:
                    s = _late(kind, lag)[keep]
                    s = s - s.mean()
                    r = float(e @ s / (np.linalg.norm(e) * np.linalg.norm(s) + 1e-300))
                    found.append((abs(r) * np.sqrt(len(e)), r, channel, shown, lag))
    z, r, channel, shown, lag = max(found)
    if 2 * norm.sf(z) * len(found) > SIGNIFICANT:
        return ""
    late = f", {lag} samples earlier" if lag else ""
    return f"innovations of {channel} still go with {shown}{late}: correlation {r:.2f}"


# -- where a run begins ----------------------------------------------------------------------------------------------


def beginnings(model: Model) -> list[str]:
    """Parameters that every recording has anew: initial values of states, and those that the rig names."""
    initial = {s.initial for s in model.plant.states.values() if isinstance(s.initial, str)}
    return [symbol for symbol in model.plant.parameters if symbol in initial or symbol in model.rig.anew]


def settled(model: Model, values: Mapping[str, float], samples: int) -> dict[str, float]:
    """`values` with those that every recording has anew fitted to its first `samples`, by least squares."""
    values = {**model.values, **values}
    symbols = beginnings(model)
    if not symbols or not samples:
        return values
    scale = np.std(model.target, axis=0) + 1e-300

    def errors(at):
        given = {**values, **dict(zip(symbols, at, strict=True))}
        return ((model.target - model.predict(given))[:samples] / scale).ravel()

    start = np.array([values[s] for s in symbols])
    size = np.maximum(np.abs(start), 1e-3)
    found = least_squares(errors, start, x_scale=size, diff_step=1e-4, max_nfev=60)
    return {**values, **dict(zip(symbols, map(float, found.x), strict=True))}
