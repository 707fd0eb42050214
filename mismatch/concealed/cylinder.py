"""What the two position-controlled cylinders share: oil, friction, leakage, late commands, and their reference."""

import numpy as np
from numba import njit

from .rig import SAMPLE_TIME, lag

ATMOSPHERE = 1e5  # Pa, above which pressures are measured
POLYTROPIC = 1.4  # exponent of air that is compressed without time to cool
TURBULENT = 8e6  # Pa, around which a leak of the variant form turns turbulent
TIME_ROUNDING = 1e-9  # samples, by which the quotient of two times may be off
WINDOW = 250  # samples between restarts of a simulation
STOP = 0.0499  # m from mid-stroke: the end of the stroke
QUANTUM = 5e-6  # m, of the position that the controller sees
SIGN_SPEED = 0.003  # m/s over which a friction of the sign of the speed changes it
HALF, WEIGHTS = 0.5, 6  # of Runge-Kutta 4: the place of the middle slopes, the sum of the weights 1, 2, 2, 1

# the reference, by the draw
REACH = (0.75, 1.0)  # of the travel, and again of the levels
SHORT_HOLD, LONG_HOLD = 0.15, (0.6, 1.5)  # s that a level is held
FOLLOWED = ("noise", "sine", "level")  # on which level: the first two beside it
NOISE_BAND = 0.1, (2, 8)  # Hz, lower and upper end of the noise
NOISE_SIZE = (0.05, 0.15)  # of the reach, RMS
SINE_RATE = (0.4, 3.0)  # Hz
SINE_PHASE = (0, 6.28)  # rad, nearly a turn
SINE_SIZE = (0.05, 0.3)  # of the reach
SINE_PERIOD = (6, 12)  # s, in each of which the sine is there for a half


@njit(cache=True)
def bulk(modulus, pressure, air, variant):
    """Effective bulk modulus with free air, isothermal or (variant) polytropic with exponent 1.4."""
    if air == 0.0:
        return modulus
    above = max(pressure, 0.0) + ATMOSPHERE
    if variant:
        return modulus / (1 + air * modulus / (POLYTROPIC * above) * (ATMOSPHERE / above) ** (1 / POLYTROPIC))
    return modulus / (1 + air * modulus * ATMOSPHERE / (above * above))


@njit(cache=True)
def seep(coefficient, drop, variant):
    """Laminar flow, or (variant) one that turns turbulent around 8 MPa."""
    return coefficient * drop / np.sqrt(1 + abs(drop) / TURBULENT) if variant else coefficient * drop


@njit(cache=True)
def stribeck(v, coulomb, static, speed):
    """Friction force [N] at a steady speed."""
    return coulomb + (static - coulomb) * np.exp(-((v / speed) ** 2))


@njit(cache=True)
def command_at(command, k, into, delay):
    """The command that acts `into` seconds after sample k, `delay` seconds late."""
    late = k + int(np.floor((into - delay) / SAMPLE_TIME + TIME_ROUNDING))
    return command[max(late, 0)]


def reference(rng: np.random.Generator, samples: int, reach: float, quick: tuple[float, float]) -> np.ndarray:
    """Position reference (samples,) in m, inside +-`reach`: levels held 0.15 to 1.5 s and approached through a lag of
    `quick` rad/s, and on them, by the draw, band-limited noise, a sine, or nothing (then the cylinder rests)."""
    t = np.arange(samples) * SAMPLE_TIME
    reach *= rng.uniform(*REACH)
    levels, holds = rng.uniform(-1, 1, samples), rng.uniform(SHORT_HOLD, rng.uniform(*LONG_HOLD), samples)
    target = reach * levels[np.searchsorted(np.cumsum(holds), t)]
    swing = rng.uniform(*REACH)
    target = swing * (target[0] + lag(target - target[0], SAMPLE_TIME, rng.uniform(*quick), 1.0))
    kind = FOLLOWED[rng.choice(len(FOLLOWED))]
    if kind == "noise":
        lines = np.fft.rfftfreq(samples, SAMPLE_TIME)
        inside = (lines > NOISE_BAND[0]) & (lines < rng.uniform(*NOISE_BAND[1]))
        noise = np.fft.irfft(inside * np.exp(2j * np.pi * rng.random(len(lines))), samples)
        target += rng.uniform(*NOISE_SIZE) * reach * noise / np.std(noise)
    elif kind == "sine":
        sine = np.sin(2 * np.pi * rng.uniform(*SINE_RATE) * t + rng.uniform(*SINE_PHASE))
        target += rng.uniform(*SINE_SIZE) * reach * sine * (np.sin(2 * np.pi * t / rng.uniform(*SINE_PERIOD)) > 0)
    return np.clip(target, -reach, reach)
