"""Spectra by Welch's method, averaged over bins that are even on a logarithmic scale."""

import math
from collections.abc import Mapping

import numpy as np
from scipy.signal import csd, welch

MOST = 200  # points of a spectrum


def spectrum(signal: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequency [Hz] and power density [unit^2/Hz] by Welch's method, averaged over bins even on a log scale."""
    frequency, power = welch(signal, 1 / period, nperseg=_segment(len(signal)))
    bins = _log_bins(frequency)
    return _averaged(frequency, bins), _averaged(power, bins)


def frequency_response(reference: np.ndarray, predictions: Mapping[str, np.ndarray], period: float) -> dict:
    """Accuracy frequency response Y_hat/Y of each prediction (N,) (thesis figs. 5.7, 5.8): H1 estimator S_yx / S_xx.

    frequency in Hz; per prediction magnitude, phase in degrees and coherence, None where the reference has no power.
    """
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


def _segment(samples: int) -> int:
    """Length of Welch's segments: a power of two, at least six of them half overlapping, at most 4096 steps."""
    return min(4096, 1 << max(3, int(math.log2(max(samples, 16) / 4))))


def _log_bins(frequency: np.ndarray) -> np.ndarray:
    """First indices of at most MOST bins that are even on a log scale; the mean (f = 0) is left out."""
    edges = np.geomspace(1, len(frequency), MOST + 1)[:-1]
    return np.unique(edges.astype(int))


def _averaged(values: np.ndarray, bins: np.ndarray) -> np.ndarray:
    return np.add.reduceat(values, bins) / np.diff([*bins, len(values)])
