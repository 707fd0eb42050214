"""Excitation signals. Each returns float64 (samples,), and the same arguments give the same bits.

Each signal has a function for its spectrum: the mean of its periodogram, a one-sided power density [unit^2/Hz], at any
frequencies [Hz]. The integral of the spectrum over frequency is the power of the signal about its mean.
"""

import numpy as np
from scipy.special import fresnel

from greygate.errors import InputError


def prms(
    samples: int, low: float, high: float, hold: tuple[int, int], seed: int, levels: int | None = None
) -> np.ndarray:
    """Pseudo-random multi-level signal: piecewise constant, as the thesis uses for identification (5.3.1).

    Amplitude: each level is uniform on [`low`, `high`], or on `levels` equally spaced values of it. Hold: each level
    stays for a whole number of samples uniform on `hold` (both ends included). Spectrum: that of a random staircase,
    flat up to about 0.4 / mean hold and falling with 1/f beyond.
    """
    shortest, longest = hold
    if samples < 1 or not 1 <= shortest <= longest or not low < high or (levels is not None and levels < 2):
        raise InputError("prms: needs samples >= 1, 1 <= hold[0] <= hold[1], low < high and levels >= 2")
    rng = np.random.default_rng(seed)
    holds = rng.integers(shortest, longest, size=samples // shortest + 1, endpoint=True)
    if levels is None:
        values = rng.uniform(low, high, size=len(holds))
    else:
        values = np.linspace(low, high, levels)[rng.integers(levels, size=len(holds))]
    return np.repeat(values, holds)[:samples]


def prms_spectrum(
    frequency: np.ndarray,
    low: float,
    high: float,
    hold: tuple[int, int],
    sample_time: float,
    levels: int | None = None,
) -> np.ndarray:
    """Spectrum of `prms` at `frequency` [Hz], shape of `frequency`.

    A level that stays for H samples is a pulse; levels are independent, so S(f) = 2 T var E|D_H(f)|^2 / E[H] with the
    Dirichlet kernel D_H = sin(pi f H T)/sin(pi f T) and the variance of one level.
    """
    holds = np.arange(hold[0], hold[1] + 1)
    variance = (high - low) ** 2 / 12 * (1.0 if levels is None else (levels + 1) / (levels - 1))
    half = np.pi * sample_time * np.asarray(frequency, float)[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        kernel = np.where(np.abs(np.sin(half)) < 1e-12, holds, np.sin(half * holds) / np.sin(half))
    return 2 * sample_time * variance * np.mean(kernel**2, axis=-1) / np.mean(holds)


def chirp(samples: int, amplitude: float, start: float, stop: float, sample_time: float) -> np.ndarray:
    """Sine of constant `amplitude`, starting at 0, its frequency rising linearly from `start` to `stop` Hz.

    Spectrum: nearly flat between `start` and `stop`. There is no seed, because nothing is random.
    """
    _check_band("chirp", samples, start, stop, sample_time)
    t = np.arange(samples) * sample_time
    return amplitude * np.sin(2 * np.pi * (start + (stop - start) * t / (2 * samples * sample_time)) * t)


def chirp_spectrum(
    frequency: np.ndarray, samples: int, amplitude: float, start: float, stop: float, sample_time: float
) -> np.ndarray:
    """Spectrum of `chirp` at `frequency` [Hz]: amplitude^2 / (2 (stop - start)) in the band, with Fresnel's ripple.

    It omits the image of the negative frequencies, which matters only up to about 1 / length from 0 Hz.
    """
    f, length = np.asarray(frequency, float), samples * sample_time
    if stop == start:
        return amplitude**2 / 2 * length * np.sinc((f - start) * length) ** 2
    reach = np.sqrt(2 * length / (stop - start))
    (s_high, c_high), (s_low, c_low) = fresnel(reach * (stop - f)), fresnel(reach * (f - start))
    return amplitude**2 / (4 * (stop - start)) * ((c_high + c_low) ** 2 + (s_high + s_low) ** 2)


def band_limited_noise(
    samples: int, rms: float, start: float, stop: float, sample_time: float, seed: int
) -> np.ndarray:
    """Gaussian noise of exactly `rms` (zero mean) whose spectrum is flat from `start` to `stop` Hz and zero outside.

    Amplitude: Gaussian, so peaks reach about 4 `rms`. It is periodic over its length.
    """
    rng = np.random.default_rng(seed)
    lines = _lines("band_limited_noise", samples, start, stop, sample_time)
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    spectrum[lines] = rng.standard_normal(len(lines)) + 1j * rng.standard_normal(len(lines))
    noise = np.fft.irfft(spectrum, samples)
    return rms * noise / np.sqrt(np.mean(noise**2))


def band_limited_noise_spectrum(
    frequency: np.ndarray, samples: int, rms: float, start: float, stop: float, sample_time: float
) -> np.ndarray:
    """Spectrum of `band_limited_noise` at `frequency` [Hz]: flat over its lines, whose width is their spacing."""
    return rms**2 * _flat("band_limited_noise", frequency, samples, start, stop, sample_time)


def multisine(samples: int, amplitude: float, start: float, stop: float, sample_time: float, seed: int) -> np.ndarray:
    """Random-phase multisine: every line of the record's frequency grid from `start` to `stop` Hz has equal power.

    Amplitude: the largest absolute value is exactly `amplitude`. It is periodic over its length.
    """
    rng = np.random.default_rng(seed)
    lines = _lines("multisine", samples, start, stop, sample_time)
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(2j * np.pi * rng.random(len(lines)))
    wave = np.fft.irfft(spectrum, samples)
    return amplitude * wave / np.abs(wave).max()


def multisine_spectrum(
    frequency: np.ndarray, samples: int, amplitude: float, start: float, stop: float, sample_time: float, seed: int
) -> np.ndarray:
    """Spectrum of `multisine` at `frequency` [Hz]: flat over its lines, whose width is their spacing.

    The phases, which `seed` draws, determine the crest factor, and so the power at this `amplitude`.
    """
    power = np.mean(multisine(samples, amplitude, start, stop, sample_time, seed) ** 2)
    return power * _flat("multisine", frequency, samples, start, stop, sample_time)


def _flat(name: str, frequency: np.ndarray, samples: int, start: float, stop: float, sample_time: float) -> np.ndarray:
    """Power density of unit power, which the lines of the band share equally."""
    lines, spacing = _lines(name, samples, start, stop, sample_time), 1 / (samples * sample_time)
    nearest = np.round(np.asarray(frequency, float) / spacing)
    return ((nearest >= lines[0]) & (nearest <= lines[-1])) / (len(lines) * spacing)


def _check_band(name: str, samples: int, start: float, stop: float, sample_time: float) -> None:
    if samples < 1 or not 0 <= start <= stop < 0.5 / sample_time:
        raise InputError(
            f"{name}: {samples} samples, {start} to {stop} Hz; needs samples >= 1 and 0 <= start <= stop < half the "
            f"sample rate ({0.5 / sample_time:g} Hz)"
        )


def _lines(name: str, samples: int, start: float, stop: float, sample_time: float) -> np.ndarray:
    """Indices of the record's frequency lines within the band, without the mean."""
    _check_band(name, samples, start, stop, sample_time)
    frequencies = np.fft.rfftfreq(samples, sample_time)
    lines = np.flatnonzero((frequencies > 0) & (frequencies >= start) & (frequencies <= stop))
    if not lines.size:
        raise InputError(f"{name}: no line of {samples} samples lies in {start} to {stop} Hz; take a longer record")
    return lines
