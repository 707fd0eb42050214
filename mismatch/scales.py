"""Lengths in samples, kept within what the signals of a rig themselves call short and long.

A machine may be sampled every microsecond or every minute, so no length here is in seconds. A length is a count of
samples; where a signal moves much faster or much slower than that, it is a share of the signal's own memory instead.
"""

from collections.abc import Iterable

import numpy as np

FORGOTTEN = 0.5  # of a signal's autocorrelation one sample on: where it falls below, the signal has forgotten
SMOOTHED, PARABOLA, CUBIC = 9, 2, 3  # samples and order of the smoothing that shows how rough a signal is
LEAST = 1e-9  # of a signal's size: the noise of one that is smooth, or rests
PART = 8  # a smoothing reaches no further than such a part of a recording
FEWEST_BESIDE = 2  # samples on either side, at least: a cubic needs four, and five leave one to smooth
WIDER = 1.25  # times as many samples as the smoothing tried before
WORSE = 3  # of them in a row, after which no wider one is tried


def memory(signal: np.ndarray) -> float:
    """Samples after which a signal (samples,) has half forgotten where it was; inf where it does not move, or is noise.

    It is compared with the autocorrelation one sample on, not with the variance, which white noise is part of.
    """
    away = signal - np.mean(signal)
    away = away / max(float(np.abs(away).max()), np.finfo(float).tiny)
    size = len(away)
    correlation = np.fft.irfft(np.abs(np.fft.rfft(away, 2 * size)) ** 2, 2 * size)[:size]
    if not (size > 1 and correlation[1] > FORGOTTEN**2 * correlation[0] > 0.0):
        return np.inf
    forgotten = np.flatnonzero(correlation < FORGOTTEN * correlation[1])
    return float(forgotten[0]) if len(forgotten) else float(size)


def span(samples: int, memories: Iterable[float], shares: tuple[float, float], least: int) -> int:
    """`samples`, but within `shares` (low, high) of the shortest of `memories`, and at least `least`.

    Twenty samples stay twenty where a signal remembers 400; of a slower one they become 50, of a faster one 5:
    `[span(20, [m], (0.005, 0.1), 2) for m in (400, 10_000, 50)] == [20, 50, 5]`.
    """
    shortest = min(memories, default=np.inf)
    if np.isfinite(shortest):
        samples = round(min(max(samples, shares[0] * shortest), shares[1] * shortest))
    return max(samples, least)


def noise(signal: np.ndarray) -> float:
    """RMS of the white noise in a signal (samples,), in its unit: what a cubic over nine samples leaves of it."""
    from scipy.signal import savgol_coeffs, savgol_filter  # takes a second

    left = signal - savgol_filter(signal, SMOOTHED, CUBIC)
    share = 1.0 - float(savgol_coeffs(SMOOTHED, CUBIC)[SMOOTHED // 2])  # a sample's weight in its own smoothed value
    size = float(np.abs(signal).max()) or 1.0
    return max(float(np.sqrt(np.mean(left**2) / share)), LEAST * size)


def smoothing(signal: np.ndarray) -> tuple[int, int]:
    """(samples on either side, degree) of the polynomials whose slopes come nearest to the rate of a signal (samples,).

    By Stein's estimate of their squared error (Annals of Statistics 9, 1981): their distance from the slopes of short
    cubics, which noise alone leads astray, and twice what both have of the same noise. Of a signal that moves in steps
    only so many samples count as it has steps: then its errors are about as independent as noise.
    """
    from scipy.signal import savgol_coeffs, savgol_filter

    moved = np.mean(np.diff(signal) != 0.0)
    every = int(np.clip(round(1.0 / max(moved, LEAST)), 1, max(len(signal) // (PART * SMOOTHED), 1)))
    thinned, most = signal[::every], len(signal) // (PART * every)
    if most <= SMOOTHED // 2:
        return FEWEST_BESIDE * every, PARABOLA
    variance = noise(thinned) ** 2

    def weights(half: int, degree: int) -> np.ndarray:
        return np.pad(savgol_coeffs(2 * half + 1, degree, deriv=1), most - half)

    short, common = savgol_filter(thinned, SMOOTHED, CUBIC, deriv=1), weights(SMOOTHED // 2, CUBIC)
    best = np.inf, FEWEST_BESIDE, PARABOLA
    for degree in (PARABOLA, CUBIC):
        half, least, worse = FEWEST_BESIDE, np.inf, 0
        while half <= most and worse < WORSE:
            slopes = savgol_filter(thinned, 2 * half + 1, degree, deriv=1)
            error = float(np.mean((slopes - short) ** 2) + 2.0 * variance * (weights(half, degree) @ common))
            worse = worse + 1 if error > least else 0
            least, best = min(error, least), min(best, (error, half, degree))
            half = max(half + 1, round(WIDER * half))
    return best[1] * every, best[2]
