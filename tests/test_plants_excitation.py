"""The periodograms of excitation signals have the spectra that theory gives them.

A spectrum is the mean of the periodogram, a one-sided power density [unit^2/Hz], at any frequencies [Hz]. Its integral
over frequency is the power of the signal about its mean.
"""

import numpy as np
import pytest
from scipy.signal import periodogram
from scipy.special import fresnel

from greygate.plants.excitation import _lines, band_limited_noise, chirp, multisine, prms

T = 1e-3


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


def band_limited_noise_spectrum(
    frequency: np.ndarray, samples: int, rms: float, start: float, stop: float, sample_time: float
) -> np.ndarray:
    """Spectrum of `band_limited_noise` at `frequency` [Hz]: flat over its lines, whose width is their spacing."""
    return rms**2 * _flat("band_limited_noise", frequency, samples, start, stop, sample_time)


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


@pytest.mark.parametrize(("hold", "levels"), [((5, 30), None), ((1, 1), None), ((4, 4), 5), ((3, 40), 2)])
def test_the_mean_periodogram_of_prms_is_its_spectrum(hold, levels):
    runs = [periodogram(prms(4096, -0.5, 1.5, hold, seed, levels), 1 / T)[1] for seed in range(400)]
    frequency, found = np.fft.rfftfreq(4096, T)[1:-1], np.mean(runs, axis=0)[1:-1]
    expected = prms_spectrum(frequency, -0.5, 1.5, hold, T, levels)
    bands = np.arange(0, len(frequency), 64)  # 400 runs x 64 lines: 0.6 % is one deviation of a band's mean
    ratio = np.add.reduceat(found, bands) / np.add.reduceat(expected, bands)
    strong = np.add.reduceat(expected, bands) > 1e-2 * np.add.reduceat(expected, bands).max()
    np.testing.assert_allclose(ratio[strong], 1, atol=0.05)
    power = np.mean([np.var(prms(4096, -0.5, 1.5, hold, seed, levels)) for seed in range(400)])
    assert np.sum(expected) / (4096 * T) == pytest.approx(power, rel=0.05)


def test_the_periodogram_of_a_chirp_is_its_spectrum_ripple_included():
    arguments = 20_000, 2.0, 20.0, 200.0, T
    frequency, found = periodogram(chirp(*arguments), 1 / T, detrend=False)
    expected = chirp_spectrum(frequency, *arguments)
    inside = (frequency > 21) & (frequency < 199)
    np.testing.assert_allclose(found[inside], expected[inside], rtol=0.03)  # the image of the negative frequencies
    assert np.median(expected[inside]) == pytest.approx(2.0**2 / (2 * 180), rel=0.02)
    assert np.sum(expected) / 20 == pytest.approx(2.0, rel=1e-2)
    assert np.sum(found) / 20 == pytest.approx(2.0, rel=1e-2)


def test_a_chirp_that_stays_at_one_frequency_has_the_spectrum_of_a_sine():
    frequency, found = periodogram(chirp(1000, 2.0, 50.0, 50.0, T), 1 / T, detrend=False)
    np.testing.assert_allclose(chirp_spectrum(frequency, 1000, 2.0, 50.0, 50.0, T), found, atol=1e-12)


def test_the_mean_periodogram_of_band_limited_noise_is_flat_and_zero_outside():
    band = 1000, 3.0, 100.0, 300.0, T
    found = np.mean([periodogram(band_limited_noise(*band, seed), 1 / T, detrend=False)[1] for seed in range(500)], 0)
    expected = band_limited_noise_spectrum(np.fft.rfftfreq(1000, T), *band)
    inside = expected > 0
    assert np.all(found[~inside] < 1e-20)
    assert np.mean(found[inside]) == pytest.approx(np.mean(expected[inside]), rel=1e-9)
    np.testing.assert_allclose(found[inside], expected[inside], rtol=0.2)  # 500 runs: one deviation is 4.5 %
    assert expected.sum() * 1.0 == pytest.approx(9.0)


def test_the_periodogram_of_a_multisine_is_its_spectrum_line_by_line():
    arguments = 4000, 2.0, 5.0, 50.0, T, 4
    frequency, found = periodogram(multisine(*arguments), 1 / T, detrend=False)
    expected = multisine_spectrum(frequency, *arguments)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-18)
