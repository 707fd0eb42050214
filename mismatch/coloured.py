"""Recordings whose noise nobody stated: its colour and size are fitted along with every hypothesis.

Measured plants leave errors that depend on each other for seconds. An autoregression of what a hypothesis leaves in
free run is fitted along with it, channel by channel (joint maximum likelihood). Errors are then innovations, and costs
are -2 log likelihood.
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter
from scipy.stats import norm

from greygate.mismatch.effects import Effect
from greygate.mismatch.fit import ENOUGH, ITERATIONS, Descent, Fit, Leading, Likelihood, Unknown
from greygate.mismatch.model import TINY, Model
from greygate.mismatch.noise import Noise
from greygate.mismatch.runs import along, whole
from greygate.mismatch.scales import memory
from greygate.progress import cut

ORDERS = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24)  # of the autoregression, among which BIC chooses
SAMPLES_EACH = 20  # of the recording for each coefficient of the autoregression, at least
MEMORY = 0.02  # of a recording, within which noise forgets
PIECES = 40  # of a recording, within which innovations may depend on each other, for intervals
ROUNDS, WHITE_ROUNDS = 6, 2  # in which plant and noise are fitted in turn, at most; where the noise has no memory
GAIN = 1.0  # of cost: a round that gains less is the last
DEPENDENT = 1e-10  # of the largest singular value, below which past errors count as multiples of each other
PROBE = 1e-3  # of its typical strength: so small an effect changes the prediction in proportion
SIZINGS = 4  # rounds in which a typical strength is corrected: two to leave zero or infinity, two to come close
LEAP = 100.0  # by which a strength is enlarged that changes nothing, or reduced that makes the run diverge
ABOUT = (0.3, 3.0)  # times what is unexplained: an effect that changes the prediction so much has its typical strength
LAGS = (0, 1, 2, 4, 8, 16)  # samples by which a signal goes before the innovation it may explain
SIGNIFICANT = 1e-4  # chance of so large a correlation where there is none, after correction


class Coloured(Likelihood):
    """A likelihood whose noise is an autoregression in each channel.

    ar: coefficients of each channel (order,). scale: RMS of the innovations (channels,). mask: samples that count.
    each: so many of them count as one, for those are alike.
    The autoregression forgets within MEMORY of the recording: slower errors are the plant's, not noise. Before the
    first sample the noise is 0, for there the plant begins.
    """

    each = 1.0

    def __init__(self, model: Model):
        self.model = model
        self.noise = Noise.told(len(model.rig.predict))  # not that of the errors: `ar` and `scale` are
        self.local_scale = self.heavy = np.ones(0)
        samples, channels = model.target.shape
        recordings = model.pieces
        self.block = min(max(samples // PIECES, 2), *(p.stop - p.start for p in recordings), samples)
        self.windows, self.kept = whole(recordings, self.block)
        self.sigma = np.ones(model.target.shape)
        self.ar, self.scale = [np.zeros(0)] * channels, np.std(model.target, axis=0)
        self.mask = np.zeros(samples, bool)
        self.mask[self.kept] = True
        self.decay = np.exp(-1.0 / (MEMORY * samples / len(recordings)))

    @property
    def order(self) -> int:
        return len(self.ar[0])

    @property
    def count(self) -> float:
        return self.mask.sum() * len(self.scale) / self.each

    @property
    def expected(self) -> float:
        return 0.0

    @property
    def remembers(self) -> bool:
        return self.order > 0

    def white(self, what: np.ndarray) -> np.ndarray:
        out = np.empty_like(what)
        for i, (ar, scale) in enumerate(zip(self.ar, self.scale, strict=True)):
            by = np.concatenate(([1.0], -ar))
            out[:, i] = along(lambda part, by=by: lfilter(by, [1.0], part, axis=0), self.model.pieces, what[:, i])
            out[:, i] /= scale * np.sqrt(self.each)
        out[~self.mask] = 0.0
        return out

    def learnt(self, residual: np.ndarray, order: int | None = None) -> "Coloured":
        """This likelihood with the noise, of the given order, that fits `residual` (samples, channels) best."""
        other = copy.copy(self)
        order = self.order if order is None else order
        shrink = self.decay ** np.arange(1, order + 1)
        other.ar = [shrink * _regressed(r, order, self.mask, self.model.pieces) for r in residual.T]
        other.scale = np.ones(len(self.scale))
        other.scale = np.sqrt(self.each * np.mean(other.white(residual)[self.mask] ** 2, axis=0)) + TINY
        return other

    def alike(self, residual: np.ndarray) -> "Coloured":
        """This likelihood with white noise as large as `residual` (samples, channels), where neighbours are alike."""
        other = copy.copy(self)
        forgotten = [memory(r[self.mask]) for r in residual.T]  # on either side; inf: it is noise
        other.each = max(2.0 * min(forgotten), 1.0) if np.isfinite(min(forgotten)) else 1.0
        return other.learnt(residual, 0)

    def without(self, held: np.ndarray) -> "Coloured":
        other = copy.copy(self)
        other.mask = self.mask & ~held
        return other

    def deviance(self) -> float:
        """-2 log likelihood of the innovations beyond their sum of squares, less a constant."""
        return float(np.sum(2.0 * np.log(self.scale)) * self.mask.sum() / self.each)

    def ordered(self, residual: np.ndarray) -> "Coloured":
        """This likelihood with noise of the order that BIC chooses, in which each sample counts."""
        other = copy.copy(self)
        other.each = 1.0
        orders = [order for order in ORDERS if order < len(residual) / SAMPLES_EACH]
        tried = [other.learnt(residual, order) for order in orders]
        return min(tried, key=lambda p: p.deviance() + len(p.ar) * p.order * np.log(p.count))

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
        leading: Leading | None = None,
    ) -> Fit:
        """Fit plant and noise in turn until neither gains. `cost` is -2 log of the joint likelihood and the priors.

        tempered, rival: without effect, for noise takes up what the plant leaves out, and its size is not known before;
        so are shifts, for a free run has none, and `leading`, which is of windows.
        """
        descent, likelihood = Descent(self, unknowns, values or {}, self.nothing()), self
        descent.both = both
        best: Fit | None = None
        for _ in range(ROUNDS if self.order else WHITE_ROUNDS):
            fit = descent.ended(iterations, enough=enough, slack=slack)
            residual = descent.at.residual
            if not np.isfinite(residual).all():
                return best or replace(fit, cost=np.inf)
            likelihood = likelihood.learnt(residual)
            descent.under(likelihood)
            joint = likelihood.deviance() + float(np.sum(fit.weight * fit.numbers**2))
            fit = replace(fit, likelihood=likelihood, errors=likelihood.white(residual), cost=joint)
            gain = np.inf if best is None else best.cost - joint
            if gain > 0:
                best = fit
            if gain < GAIN:
                break
        assert best is not None  # that of the first round, or a better one
        return best


def coloured_likelihood(fit: Fit) -> Coloured:
    """The likelihood of a fit to a recording whose noise nobody stated."""
    assert isinstance(fit.likelihood, Coloured)
    return fit.likelihood


def _regressed(error: np.ndarray, order: int, keep: np.ndarray, pieces: Sequence[slice]) -> np.ndarray:
    """Coefficients (order,) of the regression of `error` on its own past, over the samples in `keep`."""
    if not order:
        return np.zeros(0)
    past = np.stack([_late(error, k, pieces) for k in range(1, order + 1)], axis=1)[keep]
    return np.linalg.lstsq(past, error[keep], rcond=DEPENDENT)[0]


def _late(signal: np.ndarray, by: int, pieces: Sequence[slice]) -> np.ndarray:
    """The signal `by` samples late; 0 before each recording begins."""

    def late(part: np.ndarray) -> np.ndarray:
        return np.concatenate((np.zeros(min(by, len(part))), part[: max(len(part) - by, 0)]))

    return along(late, pieces, signal)


def resized(likelihood: Likelihood, effect: Effect, fit: Fit) -> Effect:
    """The effect with `typical` strengths that change the prediction by about as much as `fit` leaves unexplained.

    It is as it was where the time of a search is over.
    """
    with cut():
        return _resized(likelihood, effect, fit)
    return effect


def _resized(likelihood: Likelihood, effect: Effect, fit: Fit) -> Effect:
    size = np.std(likelihood.residual(fit.values), axis=0) + TINY
    values = {**likelihood.model.values, **fit.values, **effect.set}
    base = likelihood.model.predict({**likelihood.model.values, **fit.values})

    def change(symbol: str, value: float) -> float:
        """The largest change of a channel, over what is unexplained there; infinite where the run diverges."""
        moved = likelihood.model.predict({**values, symbol: value})
        return float(np.max(np.nan_to_num(np.std(moved - base, axis=0), nan=np.inf) / size))

    free = []
    for f in effect.free:
        typical = f.typical
        for _ in range(0 if f.shape or effect.frees or f.guess else SIZINGS):
            probe = min(max(PROBE * typical, f.low), f.high) or max(-PROBE * typical, f.low)
            typical, found = _corrected(typical, change(f.symbol, probe) * (1 / PROBE))
            if found:
                break
        free.append(replace(f, typical=float(min(typical, max(abs(f.low), abs(f.high))))))
    return replace(effect, free=tuple(free))


def _corrected(typical: float, change: float) -> tuple[float, bool]:
    """(a better typical strength than one that makes so much `change`, whether that was good already)."""
    if change == 0.0:
        return typical * LEAP, False
    if not 0.0 < change < np.inf:
        return typical * (1 / LEAP), False
    return (typical, True) if ABOUT[0] < change < ABOUT[1] else (typical / change, False)


def remaining(fit: Fit) -> str:
    """What the innovations still depend on, in words; empty where nothing is significant.

    They are correlated with lagged inputs, with the inputs' magnitudes, and with time.
    """
    model = fit.likelihood.model
    signals = {name: model.recording[name] for name in model.rig.inputs}
    found = []
    keep = coloured_likelihood(fit).mask
    for channel, error in zip(model.rig.predict, fit.errors.T, strict=True):
        e = error[keep] - error[keep].mean()
        for name, signal in {**signals, "t": model.recording.time}.items():
            for shown, kind in ((name, signal), (f"|{name}|", np.abs(signal - np.median(signal)))):
                for lag in LAGS:
                    s = _late(kind, lag, model.pieces)[keep]
                    s = s - s.mean()
                    r = float(e @ s / (np.linalg.norm(e) * np.linalg.norm(s) + TINY))
                    found.append((abs(r) * np.sqrt(len(e)), r, channel, shown, lag))
    z, r, channel, shown, lag = max(found)
    if 2 * norm.sf(z) * len(found) > SIGNIFICANT:
        return ""
    late = f", {lag} samples earlier" if lag else ""
    return f"innovations of {channel} still go with {shown}{late}: correlation {r:.2f}"
