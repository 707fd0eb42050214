"""Filters of recorded signals: what an actuator, a sensor or a logger may do to them.

An input is held over each sample, so that a filter of it gives a mean over a sample. A sensor's reading is taken at an
instant, so that a filter of it interpolates, by the cubic through the four samples around (Lagrange): a straight line
errs by an eighth of a sample's squared times the acceleration, which at few samples a swing is more than noise. The
first parameter of each is its strength, 0 where it does nothing.
"""

from collections.abc import Callable

import numpy as np
from numba import njit
from scipy.signal import lfilter, lfiltic

SHORTEST = 2.0  # samples of a period: a resonance above is none


def saturated(signal: np.ndarray, share: float, level: float, dt: float) -> np.ndarray:
    """An input of which `share` of what exceeds `level`, on either side of zero, is lost."""
    return signal - share * np.sign(signal) * np.maximum(np.abs(signal) - level, 0.0)


def rate_limited(signal: np.ndarray, share: float, rate: float, dt: float) -> np.ndarray:
    """An input of which `share` follows no faster than `rate` per second."""
    return signal + share * (_stepped(signal, abs(rate) * dt) - signal)


@njit(cache=True, nogil=True)
def _stepped(signal: np.ndarray, step: float) -> np.ndarray:
    """What follows a signal by no more than `step` a sample."""
    out, at = np.empty_like(signal), signal[0]
    for k, x in enumerate(signal):
        at = min(max(x, at - step), at + step)
        out[k] = at
    return out


def quantized(signal: np.ndarray, share: float, step: float, dt: float) -> np.ndarray:
    """An input of which `share` acts in whole steps."""
    return signal + share * (step * np.round(signal / step) - signal) if step else signal


def resonant(signal: np.ndarray, share: float, period: float, damping: float, dt: float) -> np.ndarray:
    """An input of which `share` acts through an oscillator of this period (s) and damping ratio."""
    omega = 2 * np.pi * dt / max(period, SHORTEST * dt)  # rad a sample
    pole = np.exp(complex(-damping, np.sqrt(max(1.0 - damping**2, 0.0))) * omega)
    denominator = np.array([1.0, -2 * pole.real, abs(pole) ** 2])
    gain = denominator.sum()
    start = lfiltic([gain], denominator, y=[signal[0], signal[0]])
    out, _ = lfilter([gain], denominator, signal, zi=start)
    return signal + share * (out - signal)


def fading(signal: np.ndarray, by: float, dt: float) -> np.ndarray:
    """An input whose effect changes in proportion to time: `by` of it a second."""
    return signal * (1.0 + by * np.arange(len(signal)) * dt)


INPUT: dict[str, Callable[..., np.ndarray]] = {
    "saturation": saturated,
    "rate_limit": rate_limited,
    "quantum": quantized,
    "resonance": resonant,
    "fading": fading,
}


# -- of sensors ------------------------------------------------------------------------------------------------------


CUBIC = np.array([[0, -2, 3, -1], [6, -3, -6, 3], [0, 6, 3, -3], [0, -1, 0, 1]]) / 6.0
"""Rows: the four samples around a piece, from the one before it; columns: powers of where in it, from 0 to 1."""
PARABOLA = np.array([3.0, -3.0, 1.0])  # of three samples in a row: the one before them
SERIES = 24  # terms of a mean over a short part of a lag, whose last is below the rounding


def _at(signal: np.ndarray, instants: np.ndarray, straight: bool = False) -> np.ndarray:
    """The signal at instants that count in samples; before and after the recording it goes on as it went, in range.

    straight: between samples, which gives a signal with noise less of that than a cubic.
    """
    last = len(signal) - 1
    inside = np.clip(instants, 0.0, last)
    if straight or len(signal) < len(CUBIC):
        found = np.interp(inside, np.arange(last + 1), signal)
    else:
        first = np.clip(inside.astype(int) - 1, 0, len(signal) - len(CUBIC))
        weights = np.vander(inside - first - 1, len(CUBIC), increasing=True) @ CUBIC.T
        found = np.sum(weights * signal[first[:, None] + np.arange(len(CUBIC))], axis=1)
    if last and (instants[0] < 0 or instants[-1] > last):
        found = found + (instants - inside) * np.where(instants < 0, signal[1] - signal[0], signal[-1] - signal[-2])
        found = np.clip(found, signal.min(), signal.max())
    return found


def late(signal: np.ndarray, by: float, dt: float) -> np.ndarray:
    """A reading that comes `by` s late."""
    return _at(signal, np.arange(len(signal)) - by / dt)


def behind(signal: np.ndarray, lag: float, dt: float) -> np.ndarray:
    """A reading behind a first-order lag of `lag` s: exact for a signal that is a cubic between samples."""
    if lag <= 0.0 or len(signal) < len(CUBIC):
        return signal
    before, after = (float(PARABOLA @ end[: len(PARABOLA)]) for end in (signal, signal[::-1]))
    weights = CUBIC @ _forgotten(lag / dt, len(CUBIC))
    driven = np.convolve(np.concatenate([[before], signal, [after]]), weights[::-1], "valid")
    return lfilter([1.0], [1.0, -np.exp(-dt / lag)], np.concatenate([signal[:1], driven]))


def _forgotten(ratio: float, powers: int) -> np.ndarray:
    """Integrals over a sample of exp(-(1 - s) / ratio) / ratio times s to the power of 0, 1, ... (powers,)."""
    found = np.zeros(powers)
    if ratio < 1.0:  # by parts
        found[0] = -np.expm1(-1.0 / ratio)
        for n in range(1, powers):
            found[n] = 1.0 - n * ratio * found[n - 1]
        return found
    for n in range(powers):
        term = 1.0 / (ratio * (n + 1))
        for k in range(SERIES):
            found[n] += term
            term *= -1.0 / (ratio * (n + k + 2))
    return found


def skewed(signal: np.ndarray, by: float, dt: float) -> np.ndarray:
    """A reading whose clock goes fast by a share `by` of the time."""
    return _at(signal, np.arange(len(signal)) * (1.0 + by))


def lost(signal: np.ndarray, span: float, since: float, dt: float) -> np.ndarray:
    """A reading of which `span` s are lost at the instant `since` (s): what follows comes too early."""
    k = np.arange(len(signal), dtype=float)
    passed = np.clip(k - since / dt, 0.0, 1.0)  # over one sample, so that a fit can move the instant
    return _at(signal, k + passed * span / dt)


def loose(signal: np.ndarray, width: float, dt: float) -> np.ndarray:
    """A signal behind a play of half width `width`; at the first sample it stands in the middle."""
    return _dragged(signal, abs(width))


@njit(cache=True, nogil=True)
def _dragged(signal: np.ndarray, width: float) -> np.ndarray:
    """What a signal takes along that has so much room on either side."""
    out, at = np.empty_like(signal), signal[0]
    for k, x in enumerate(signal):
        at = min(max(at, x - width), x + width)
        out[k] = at
    return out


SENSOR: dict[str, Callable[..., np.ndarray]] = {
    "late": late,
    "behind": behind,
    "clock": skewed,
    "lost": lost,
    "play": loose,
}


def _in_time(signal: np.ndarray, by: float, dt: float) -> np.ndarray:
    return _at(signal, np.arange(len(signal)) + by / dt, straight=True)


def _even(signal: np.ndarray, by: float, dt: float) -> np.ndarray:
    return _at(signal, np.arange(len(signal)) / (1.0 + by), straight=True)


def _whole(signal: np.ndarray, span: float, since: float, dt: float) -> np.ndarray:
    """Of what was lost, the last reading before it."""
    k = np.arange(len(signal), dtype=float)
    return _at(signal, np.maximum(np.minimum(k, since / dt), k - span / dt), straight=True)


UNDONE: dict[str, Callable[..., np.ndarray]] = {"late": _in_time, "clock": _even, "lost": _whole}
"""The inverse of a filter that moves a reading in time."""


def unfiltered(kind: str, signal: np.ndarray, parameters: tuple[float, ...], dt: float) -> np.ndarray:
    """What a sensor was shown, from its reading: the inverse of its filter, where it has one; else to first order."""
    if kind in UNDONE:
        return UNDONE[kind](signal, *parameters, dt)
    return 2.0 * signal - SENSOR[kind](signal, *parameters, dt)
