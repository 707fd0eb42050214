"""Excitation signals. Each returns float64 (samples,), and the same arguments give the same bits."""

import numpy as np

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


def chirp(samples: int, amplitude: float, start: float, stop: float, sample_time: float) -> np.ndarray:
    """Sine of constant `amplitude`, starting at 0, its frequency rising linearly from `start` to `stop` Hz.

    Spectrum: nearly flat between `start` and `stop`. There is no seed, because nothing is random.
    """
    _check_band("chirp", samples, start, stop, sample_time)
    t = np.arange(samples) * sample_time
    return amplitude * np.sin(2 * np.pi * (start + (stop - start) * t / (2 * samples * sample_time)) * t)


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
