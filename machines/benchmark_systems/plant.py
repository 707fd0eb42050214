"""The two discrete benchmark systems of the thesis (3.6) and the signals that they are identified with.

Both start at rest: inputs and outputs before the first sample are zero.
"""

import math

import numpy as np

from greygate.errors import InputError
from greygate.plants.excitation import prms


def b1(u: np.ndarray) -> np.ndarray:
    """Benchmark system 1 (thesis 3.15; Lazar and Pastravanu 2002). u, y: (N,), without unit.

    y(k) = 2.5 y(k-1) y(k-2) / (1 + y(k-1)^2 + y(k-2)^2) + 0.3 cos(0.5 (y(k-1) + y(k-2)) + 1.2 u(k-1)).
    Raises InputError unless u is a sequence of finite numbers.
    """
    y, y1, y2, u1 = [], 0.0, 0.0, 0.0
    for now in _signal("b1", u):
        y.append(2.5 * y1 * y2 / (1 + y1 * y1 + y2 * y2) + 0.3 * math.cos(0.5 * (y1 + y2) + 1.2 * u1))
        y1, y2, u1 = y[-1], y1, now
    return np.array(y)


def b2(u: np.ndarray) -> np.ndarray:
    """Benchmark system 2 (thesis 3.16; Narendra and Parthasarathy 1990, example 4). u, y: (N,), without unit.

    y(k+1) = [y(k) y(k-1) y(k-2) u(k-1) (y(k-2) - 1) + u(k)] / (1 + y(k-2)^2 + y(k-1)^2).
    Raises InputError unless u is a sequence of finite numbers.
    """
    y, y1, y2, y3, u1, u2 = [], 0.0, 0.0, 0.0, 0.0, 0.0
    for now in _signal("b2", u):
        y.append((y1 * y2 * y3 * u2 * (y3 - 1) + u1) / (1 + y3 * y3 + y2 * y2))
        y1, y2, y3, u1, u2 = y[-1], y1, y2, now, u1
    return np.array(y)


def b1_input(seed: int = 0, samples: int = 501) -> np.ndarray:
    """Training input of B1: levels uniform on [-1, 1], each held 1 to 5 samples.

    The thesis has 501 samples and shows its signal only in figure 3.8, so this signal is a choice.
    """
    return prms(samples, -1, 1, (1, 5), seed)


def b2_input(seed: int = 0, samples: int = 1001) -> np.ndarray:
    """Training input of B2: noise uniform on [-1, 1]; 1001 samples in the thesis."""
    return np.random.default_rng(seed).uniform(-1, 1, samples)


def b2_test_input(samples: int = 1000) -> np.ndarray:
    """Validation input of B2 (thesis 3.17).

    sin(2 pi k/250) for k <= 500, 0.8 sin(2 pi k/250) + 0.2 sin(2 pi k/25) after; k counts from 0.
    """
    k = np.arange(samples)
    slow, fast = np.sin(2 * np.pi * k / 250), np.sin(2 * np.pi * k / 25)
    return np.where(k <= 500, slow, 0.8 * slow + 0.2 * fast)


def _signal(name: str, u: np.ndarray) -> list[float]:
    u = np.asarray(u, float)
    if u.ndim != 1 or not np.isfinite(u).all():
        raise InputError(f"{name}: u is {u.shape} or holds NaN or inf; give finite (N,)")
    return u.tolist()
