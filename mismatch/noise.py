"""The noise of the sensors, as a rig states it and as a recording shows it.

What a fit leaves, in units of the told noise, is modelled in each channel as e = X b + v: in every stretch of samples a
cubic X b that the plant leaves out, and noise v(t) = sum_k a_k v(t-k) + scale w(t) with w white of unit variance. Scale
and a minimise the restricted likelihood (Patterson, Thompson 1971), V scale^2 being the covariance of v:

    -2 log L = N log scale^2 + log|V| + log|X' V^-1 X|,    scale^2 = e'(V^-1 - V^-1 X (X' V^-1 X)^-1 X' V^-1) e / N

N: samples less coefficients of the cubics. BIC chooses the order of a.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.signal import savgol_coeffs, savgol_filter

from greygate.mismatch.model import TINY, Model

LONGEST = 200  # samples of one recorded code that are counted as one reading
SMOOTHED, SMOOTHING = 9, 3  # samples and order of the smoothing that shows how rough a signal is
MOVING = 5  # samples of one recorded code, below which a signal is said to move
SELDOM = 0.05  # share of moving samples below which they do not show how rough a signal is
EVEN = 12  # the variance of errors spread evenly over one step is a twelfth of its square
ORDERS = (0, 1, 2, 4)  # of the autoregression, among which BIC chooses
STRETCH = 128  # samples in which a cubic counts as the plant's: long beside the noise's memory, short beside a motion
LEAST = 4  # times as many samples as the cubic has coefficients: a shorter stretch tells nothing of noise
CLOSEST = 0.98  # of a partial correlation: a longer memory than fifty samples is no sensor's
DOUBTED = 1.5  # times the told noise, or a part of it: noise of another size is not as it was told
COLOURED = 0.3  # of its slow part over that of white noise, above which noise is not white
SWOLLEN = 3.0  # times the told noise: so large a noise is no sensor's,
SLOW = 4.0  # where it is so many times its innovations (each sample keeps 0.97 of the one before)
PLACES = 3  # of a size that is reported


def deviation(model: Model) -> np.ndarray:
    """Standard deviation of the noise of each predicted channel (samples, channels), in its unit.

    In free-run simulation the rounding of the inputs adds to that of an output of the same unit. How much of another
    unit's rounding arrives at the output, only the plant knows: it is left out.
    """
    return np.concatenate([_deviation(one) for one in model.each])


def _deviation(model: Model) -> np.ndarray:
    rig, found = model.rig, []
    for i, name in enumerate(rig.predict):
        channel, target = rig.channels[name], model.target[:, i]
        variance = np.full(len(target), channel.noise**2)
        if channel.resolution:
            variance += channel.resolution**2 / EVEN * runs(target)
        for given in rig.inputs if model.window is None else ():
            if rig.channels[given].unit == channel.unit:
                variance += rig.channels[given].resolution ** 2 / EVEN * runs(model.recording[given])
        found.append(np.sqrt(variance) * (1.0 if channel.noise else roughness(target, channel.sigma)))
    return np.stack(found, axis=1)


def runs(signal: np.ndarray) -> np.ndarray:
    """For each sample the length of the run of equal values it stands in, at most LONGEST."""
    change = np.flatnonzero(np.diff(signal) != 0) + 1
    edges = np.concatenate(([0], change, [len(signal)]))
    lengths = np.diff(edges)
    return np.minimum(np.repeat(lengths, lengths), LONGEST).astype(float)


def roughness(signal: np.ndarray, sigma: float) -> float:
    """How much rougher a channel is than its rounding alone makes it, at least 1; for a sensor of unknown noise.

    A cubic is fitted over nine samples at a time; what it leaves of the signal where that moves is the noise.
    """
    left = signal - savgol_filter(signal, SMOOTHED, SMOOTHING)
    moving = runs(signal) < MOVING
    if moving.mean() < SELDOM:
        return 1.0
    share = 1.0 - float(
        savgol_coeffs(SMOOTHED, SMOOTHING)[SMOOTHED // 2]
    )  # a sample's weight in its own smoothed value
    return max(1.0, float(np.sqrt(np.mean(left[moving] ** 2) / share) / sigma))


# -- as a recording shows it -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Noise:
    """Noise in units of what was told: scale, RMS of the innovations (channels,); ar, coefficients by channel."""

    scale: np.ndarray
    ar: tuple[np.ndarray, ...]

    @classmethod
    def told(cls, channels: int) -> "Noise":
        """As rig.toml says: white, of the told size."""
        return cls(np.ones(channels), (np.zeros(0),) * channels)

    @property
    def size(self) -> np.ndarray:
        """RMS of the noise over the told one (channels,)."""
        return self.scale * np.array([np.sqrt(_variances(_partial(ar))[0]) for ar in self.ar])

    @property
    def slow(self) -> np.ndarray:
        """Power of its slowest part over that of white noise of the told size (channels,)."""
        return (self.scale / np.array([1.0 - np.sum(ar) for ar in self.ar])) ** 2

    @property
    def doubted(self) -> np.ndarray:
        """Whether it is of another size than the told one, or not white (channels,)."""
        another = np.abs(np.log(self.scale)) > np.log(DOUBTED)
        return another | (self.slow > (1.0 + COLOURED) * np.maximum(self.scale, 1.0) ** 2)

    @property
    def swollen(self) -> bool:
        """Whether a channel's noise is far larger than the told one, and nearly all of it slow: no sensor's, then."""
        return bool(np.any((self.size > SWOLLEN) & (self.size > SLOW * self.scale)))

    @property
    def as_told(self) -> bool:
        """Whether it is white and of the told size, in every channel."""
        return not np.any(self.doubted)

    def white(self, errors: np.ndarray, stretch: int) -> np.ndarray:
        """Innovations, in units of their RMS, of `errors` (samples, channels, ...) in units of the told noise.

        Each `stretch` of samples begins anew, for a simulation that restarts there makes errors of its own.
        """
        if not any(len(ar) for ar in self.ar) and np.all(self.scale == 1.0):
            return errors
        out = errors / self.scale[(slice(None), *(None,) * (errors.ndim - 2))]
        whole = len(errors) // stretch * stretch
        for i, ar in enumerate(self.ar):
            if len(ar):
                rows = out[:whole, i].reshape(-1, stretch, *errors.shape[2:])
                out[:whole, i] = _innovations(rows, ar).reshape(whole, *errors.shape[2:])
                if whole < len(out):
                    out[whole:, i] = _innovations(out[None, whole:, i], ar)[0]
        return out


def _innovations(rows: np.ndarray, ar: np.ndarray) -> np.ndarray:
    """What an autoregression does not foresee, (rows, samples, ...); the first samples by what went before alone."""
    out = rows.copy()
    for lag, c in enumerate(ar, start=1):
        out[:, lag:] -= c * rows[:, :-lag]
    partial = _partial(ar)
    variance = _variances(partial)
    for k in range(min(len(ar), rows.shape[1])):
        foreseen = sum((c * rows[:, k - 1 - j] for j, c in enumerate(_coefficients(partial[:k]))), start=0.0)
        out[:, k] = (rows[:, k] - foreseen) / np.sqrt(variance[k])
    return out


def _coefficients(partial: np.ndarray) -> np.ndarray:
    """Of an autoregression, from its partial correlations (Levinson)."""
    ar = np.zeros(0)
    for p in partial:
        ar = np.append(ar - p * ar[::-1], p)
    return ar


def _partial(ar: np.ndarray) -> np.ndarray:
    """The partial correlations of an autoregression: the inverse of `_coefficients`."""
    out, ar = np.zeros(len(ar)), ar.copy()
    for k in range(len(ar) - 1, -1, -1):
        out[k] = p = ar[k]
        ar = (ar[:k] + p * ar[:k][::-1]) / (1.0 - p**2)
    return out


def _variances(partial: np.ndarray) -> np.ndarray:
    """Variance of the k-th sample given all before it, over that of the innovations (order + 1,)."""
    return np.append(np.cumprod(1.0 / (1.0 - partial[::-1] ** 2))[::-1], 1.0)


def learnt(errors: np.ndarray, stretch: int, pieces: Sequence[slice] = (slice(None),)) -> Noise:
    """The noise of `errors` (samples, channels), in units of the told noise; stretches that are 0 do not count.

    stretch: samples after which a simulation restarts; no longer ones than STRETCH are looked at together. pieces: the
    samples of each recording.
    """
    parts = [errors[piece] for piece in pieces]
    length = min(stretch, STRETCH, *map(len, parts), len(errors))
    parts = [part[: len(part) // length * length] for part in parts]
    kept = np.concatenate(parts).reshape(-1, length, errors.shape[1])
    kept = kept[np.any(kept != 0.0, axis=(1, 2))]
    cubics = np.vander(np.linspace(-1.0, 1.0, length), SMOOTHING + 1)
    if length < LEAST * cubics.shape[1] or not len(kept):
        return Noise.told(errors.shape[1])
    found = [_restricted(kept[:, :, i], cubics) for i in range(errors.shape[1])]
    return Noise(np.array([scale for scale, _ in found]), tuple(ar for _, ar in found))


def _restricted(seen: np.ndarray, trends: np.ndarray) -> tuple[float, np.ndarray]:
    """(RMS of the innovations, coefficients) by the likelihood of `seen` (stretches, samples) beside any `trends`."""
    stretches, count = len(seen), len(seen) * (seen.shape[1] - trends.shape[1])

    def fitted(partial: np.ndarray) -> tuple[float, float]:
        """(-2 log likelihood, variance of the innovations)."""
        ar = _coefficients(partial)
        q, r = np.linalg.qr(_innovations(trends[None], ar)[0])
        new = _innovations(seen, ar)
        variance = float(np.sum(new**2) - np.sum((new @ q) ** 2)) / count + TINY
        volume = np.sum(np.log(_variances(partial)[:-1])) + 2.0 * np.sum(np.log(np.abs(np.diag(r))))
        return stretches * float(volume) + count * np.log(variance), variance

    best, least, start = (1.0, np.zeros(0)), np.inf, np.zeros(0)
    for order in ORDERS:
        start = np.concatenate((start, np.zeros(order - len(start))))
        if order:
            reach = [(-CLOSEST, CLOSEST)] * order
            start = minimize(lambda p: fitted(p)[0], start, method="L-BFGS-B", bounds=reach).x
        cost, variance = fitted(start)
        cost += order * np.log(count)
        if cost < least:
            best, least = (float(np.sqrt(variance)), _coefficients(start)), cost
    return best
