"""Residual tests: correlations of a residual with itself and with inputs, which are zero if nothing was missed."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import eigh, toeplitz

DEVIATIONS = 1.96  # of the 95 % band of a correlation
CHANCE = 0.005  # that a residual with nothing wrong in it has too many lags outside the band; or one too far outside
DRAWS = 2000  # from which that is found
WHAT = {
    "phi_ee": "the residual is not white: more taps of {output}, or a noise model (narmax)",
    "phi_ue": "{input} is left in the residual: taps of it are missing, or its delay is wrong",
    "phi_u2e": "an even term of {input} is missing: more neurons, or an absolute value",
    "phi_u2e2": "the error grows with {input}: a nonlinearity is missing, or the noise is no constant",
    "phi_eeu": "a product of {input} and noise is missing: more taps of {output} together with {input}",
}
"""What a failed residual test asks for, by the name that it begins with (docs/validation.md)."""


@dataclass(frozen=True)
class Correlation:
    """One residual test: a correlation that is zero at every lag if the residual is white and no input is in it.

    values: coefficients (M,) at `lags`, in steps; at a positive lag the residual comes after. plain: the 95 % band
    1.96/sqrt(N) (thesis 3.2). band: the same where one of the two is white, wider where both are coloured. allowed and
    limit: how many lags outside the band, and how large a coefficient, chance may bring about; neighbouring lags are
    alike where a signal is coloured, so that they leave the band together.
    """

    name: str
    lags: np.ndarray
    values: np.ndarray
    plain: float
    band: float
    allowed: int
    limit: float

    @property
    def outside(self) -> int:
        """Lags outside `band`; 5 % of them are expected."""
        return int(np.count_nonzero(np.abs(self.values) > self.band))

    @property
    def passed(self) -> bool:
        """Whether chance may have brought this about; it fails 1 % of residuals that have nothing wrong."""
        return self.outside <= self.allowed and bool(np.max(np.abs(self.values)) <= self.limit)


def correlation(name: str, a: np.ndarray, b: np.ndarray, lags: np.ndarray) -> Correlation | None:
    """Correlation of a(k - lag) with b(k), both (N,) and taken about their means (thesis 3.2); None if one is constant.

    If a and b are independent, the covariance of the coefficients at lags l and l + d is sum_t R_aa(t) R_bb(t + d) / N
    (Bartlett 1955; Ljung 1999, 16.6), 1/N at d = 0 where one of them is white; the band is never taken narrower. For an
    autocorrelation (a is b) it is that of a white signal.
    """
    if any(not np.ptp(x) > 1e-12 * np.abs(x).max() for x in (a, b)):
        return None
    n, white = len(a), a is b
    a, b = (np.fft.rfft(x - np.mean(x), 2 * n) for x in (a, b))
    own_a, own_b = (np.fft.irfft(np.abs(x) ** 2) for x in (a, b))
    values = np.fft.irfft(np.conj(a) * b)[lags] / np.sqrt(own_a[0] * own_b[0])
    spread = np.eye(1, len(lags))[0]
    if not white:
        for own in (own_a, own_b):
            own /= own[0]
            own[n // 4 : -(n // 4) + 1] = 0  # far lags are noise
        spread = np.fft.irfft(np.fft.rfft(own_a).real * np.fft.rfft(own_b).real)[: len(lags)]
    plain = float(DEVIATIONS / np.sqrt(n))
    band = plain * float(np.sqrt(max(1.0, spread[0])))
    allowed, limit = _by_chance(spread)
    return Correlation(name, lags, values, plain, band, allowed, limit * band / DEVIATIONS)


def _by_chance(spread: np.ndarray) -> tuple[int, float]:
    """Of M standard Gaussian numbers with covariance `spread` by lag: most outside 95 % bands, largest, by chance.

    The draws are multiplied by the symmetric root, which is unique. Eigenvectors are not: their signs, and where
    eigenvalues are equal their directions, differ between processors.
    """
    values, vectors = eigh(toeplitz(spread))
    root = vectors * np.sqrt(np.maximum(values, 0)) @ vectors.T
    root /= np.linalg.norm(root, axis=1, keepdims=True)
    draws = np.abs(_normal(len(spread)) @ root.T)
    outside, largest = np.count_nonzero(draws > DEVIATIONS, axis=1), np.max(draws, axis=1)
    at = int((1 - CHANCE) * DRAWS)
    return int(np.partition(outside, at)[at]), float(np.partition(largest, at)[at])


@lru_cache(4)
def _normal(columns: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(DRAWS, columns))


def residual_tests(e: np.ndarray, inputs: Mapping[str, np.ndarray], lags: int = 25) -> tuple[Correlation, ...]:
    """Tests of a residual (N,) against itself and each input (N,) (Billings and Voon 1986, Int. J. Control 44).

    phi_ee: whiteness. phi_ue: an input that is left in the residual linearly. phi_u2e, phi_u2e2: even terms of it;
    phi_eeu: e(k - 1) u(k - 1) left in e(k), a product of input and noise. u2 = u^2 less its mean. A test is left out
    where an input, or its square, is constant.
    """
    both, past = np.arange(-lags, lags + 1), np.arange(1, lags + 1)
    e = e - np.mean(e)
    found = [correlation("phi_ee", e, e, past)]
    for name, u in inputs.items():
        u = u - np.mean(u)
        found += [
            correlation(f"phi_ue {name}", u, e, both),
            correlation(f"phi_u2e {name}", u**2, e, both),
            correlation(f"phi_u2e2 {name}", u**2, e**2, both),
            correlation(f"phi_eeu {name}", e * u, e, past),
        ]
    return tuple(c for c in found if c)


def asks_for(test: Correlation, output: str) -> str:
    """What a failed test asks for."""
    kind, _, name = test.name.partition(" ")
    return WHAT[kind].format(input=name, output=output)
