"""What a position-controlled cylinder is asked to follow."""

import numpy as np

from .rig import SAMPLE_TIME, lag


def reference(rng: np.random.Generator, samples: int, reach: float) -> np.ndarray:
    """Position reference (samples,) in m, inside +-`reach`: levels held 0.15 to 1.5 s and approached through a lag,
    and on them, by the draw, band-limited noise, a sine, or nothing (then the cylinder rests)."""
    t = np.arange(samples) * SAMPLE_TIME
    reach *= rng.uniform(0.65, 1.0)
    levels, holds = rng.uniform(-1, 1, samples), rng.uniform(0.15, rng.uniform(0.6, 1.5), samples)
    target = reach * levels[np.searchsorted(np.cumsum(holds), t)]
    swing = rng.uniform(0.4, 1.0)
    target = swing * (target[0] + lag(target - target[0], SAMPLE_TIME, rng.uniform(8, 40), 1.0))
    kind = rng.choice(3)
    if kind == 0:
        lines = np.fft.rfftfreq(samples, SAMPLE_TIME)
        inside = (lines > 0.1) & (lines < rng.uniform(2, 8))
        noise = np.fft.irfft(
            inside * rng.standard_normal(len(lines)) * np.exp(2j * np.pi * rng.random(len(lines))), samples
        )
        target += rng.uniform(0.05, 0.15) * reach * noise / np.std(noise)
    elif kind == 1:
        sine = np.sin(2 * np.pi * rng.uniform(0.4, 3.0) * t + rng.uniform(0, 6.28))
        target += rng.uniform(0.05, 0.3) * reach * sine * (np.sin(2 * np.pi * t / rng.uniform(6, 12)) > 0)
    return np.clip(target, -reach, reach)
