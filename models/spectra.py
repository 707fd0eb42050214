"""Spectra by Welch's method, averaged over bins that are even on a logarithmic scale; octaves by Haar's wavelet."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

MOST = 200  # points of a spectrum
OCTAVES, FEWEST = 12, 8  # octaves at most; wavelets of the longest, at least


def spectrum(signal: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequency [Hz] and power density [unit^2/Hz] by Welch's method, averaged over bins even on a log scale."""
    from scipy.signal import welch  # takes a second

    frequency, power = welch(signal, 1 / period, nperseg=_segment(len(signal)))
    bins = _log_bins(frequency)
    return _averaged(frequency, bins), _averaged(power, bins)


def frequency_response(reference: np.ndarray, predictions: Mapping[str, np.ndarray], period: float) -> dict:
    """Accuracy frequency response Y_hat/Y of each prediction (N,) (thesis figs. 5.7, 5.8): H1 estimator S_yx / S_xx.

    frequency in Hz; per prediction magnitude, phase in degrees and coherence, None where the reference has no power.
    """
    from scipy.signal import csd, welch  # takes a second

    rate, n = 1 / period, _segment(len(reference))
    frequency, power = welch(reference, rate, nperseg=n)
    bins = _log_bins(frequency)
    power = _averaged(power, bins)
    found: dict = {"frequency": _averaged(frequency, bins)}
    for name, prediction in predictions.items():
        cross = _averaged(csd(reference, prediction, rate, nperseg=n)[1], bins)
        own = _averaged(welch(prediction, rate, nperseg=n)[1], bins)
        with np.errstate(divide="ignore", invalid="ignore"):
            found[name] = {
                "magnitude": np.abs(cross) / power,
                "phase": np.where(power > 0, np.degrees(np.angle(cross)), np.nan),
                "coherence": np.abs(cross) ** 2 / (power * own),
            }
    return found


@dataclass(frozen=True)
class Octave:
    """RMS of a signal and of an error between `low` and `high` Hz, in their unit. at: s, where the error is most."""

    low: float
    high: float
    error: float
    signal: float
    at: float


def octaves(error: np.ndarray, signal: np.ndarray, period: float) -> list[Octave]:
    """Error and signal (N,) by octave, the fastest first, by Haar's wavelet; the last one is all that is slower.

    Other than a spectrum it says when (thesis 3.2). The squares add up to the mean square of the error, and to the
    signal's variance, over the samples that whole wavelets cover.
    """
    depth = int(np.clip(math.log2(max(len(error) // FEWEST, 1)), 0, OCTAVES))
    count = len(error) >> depth << depth
    kept = np.stack([error[:count], signal[:count] - np.mean(signal[:count])])
    found, high = [], 0.5 / period
    for level in range(1, depth + 1):
        kept, waves = (kept[:, ::2] + kept[:, 1::2]) / math.sqrt(2), (kept[:, ::2] - kept[:, 1::2]) / math.sqrt(2)
        found.append(_octave(high / 2, high, waves, count, period * 2**level))
        high /= 2
    return [*found, _octave(0.0, high, kept, count, period * 2**depth)]


def _octave(low: float, high: float, waves: np.ndarray, count: int, length: float) -> Octave:
    error, signal = (float(np.sqrt(np.sum(w**2) / max(count, 1))) for w in waves)
    return Octave(low, high, error, signal, (int(np.argmax(np.abs(waves[0]))) + 0.5) * length if waves.size else 0.0)


def _segment(samples: int) -> int:
    """Length of Welch's segments: a power of two, at least six of them half overlapping, at most 4096 steps."""
    return min(4096, 1 << max(3, int(math.log2(max(samples, 16) / 4))))


def _log_bins(frequency: np.ndarray) -> np.ndarray:
    """First indices of at most MOST bins that are even on a log scale; the mean (f = 0) is left out."""
    edges = np.geomspace(1, len(frequency), MOST + 1)[:-1]
    return np.unique(edges.astype(int))


def _averaged(values: np.ndarray, bins: np.ndarray) -> np.ndarray:
    return np.add.reduceat(values, bins) / np.diff([*bins, len(values)])
