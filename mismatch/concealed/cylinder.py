"""What the two position-controlled cylinders share: oil, friction, leakage, late commands, and what they follow."""

import numpy as np
from numba import njit

from .rig import SAMPLE_TIME, lag


@njit(cache=True)
def bulk(modulus, pressure, air, variant):
    """Effective bulk modulus with free air, isothermal or (variant) polytropic with exponent 1.4."""
    if air == 0.0:
        return modulus
    above = max(pressure, 0.0) + 1e5
    if variant:
        return modulus / (1 + air * modulus / (1.4 * above) * (1e5 / above) ** (1 / 1.4))
    return modulus / (1 + air * modulus * 1e5 / (above * above))


@njit(cache=True)
def seep(coefficient, drop, variant):
    """Laminar flow, or (variant) one that turns turbulent around 8 MPa."""
    return coefficient * drop / np.sqrt(1 + abs(drop) / 8e6) if variant else coefficient * drop


@njit(cache=True)
def stribeck(v, coulomb, static, speed):
    """Friction force [N] at a steady speed."""
    return coulomb + (static - coulomb) * np.exp(-((v / speed) ** 2))


@njit(cache=True)
def held(command, k, into, delay):
    """The command that acts `into` seconds after sample k, `delay` late."""
    late = k + int(np.floor((into - delay) / 1e-3 + 1e-9))
    return command[max(late, 0)]


def reference(rng: np.random.Generator, samples: int, reach: float, quick: tuple[float, float]) -> np.ndarray:
    """Position reference (samples,) in m, inside +-`reach`: levels held 0.15 to 1.5 s and approached through a lag of
    `quick` rad/s, and on them, by the draw, band-limited noise, a sine, or nothing (then the cylinder rests)."""
    t = np.arange(samples) * SAMPLE_TIME
    reach *= rng.uniform(0.75, 1.0)
    levels, holds = rng.uniform(-1, 1, samples), rng.uniform(0.15, rng.uniform(0.6, 1.5), samples)
    target = reach * levels[np.searchsorted(np.cumsum(holds), t)]
    swing = rng.uniform(0.75, 1.0)
    target = swing * (target[0] + lag(target - target[0], SAMPLE_TIME, rng.uniform(*quick), 1.0))
    kind = rng.choice(3)
    if kind == 0:
        lines = np.fft.rfftfreq(samples, SAMPLE_TIME)
        inside = (lines > 0.1) & (lines < rng.uniform(2, 8))
        noise = np.fft.irfft(inside * np.exp(2j * np.pi * rng.random(len(lines))), samples)
        target += rng.uniform(0.05, 0.15) * reach * noise / np.std(noise)
    elif kind == 1:
        sine = np.sin(2 * np.pi * rng.uniform(0.4, 3.0) * t + rng.uniform(0, 6.28))
        target += rng.uniform(0.05, 0.3) * reach * sine * (np.sin(2 * np.pi * t / rng.uniform(6, 12)) > 0)
    return np.clip(target, -reach, reach)
