"""Lengths in samples, kept within what the signals of a rig themselves call short and long.

A machine may be sampled every microsecond or every minute, so no length here is in seconds. A length is a count of
samples; where a signal moves much faster or much slower than that, it is a share of the signal's own memory instead.
"""

from collections.abc import Iterable

import numpy as np

FORGOTTEN = 0.5  # of a signal's autocorrelation one sample on: where it falls below, the signal has forgotten


SMOOTHED, CUBIC = 9, 3  # samples and order of the smoothing that shows how rough a signal is
LEAST = 1e-9  # of a signal's size: the noise of one that is smooth, or rests


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
