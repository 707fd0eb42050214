"""What the six small machines share: Runge-Kutta 4, excitations, and what may happen to an input or a sensor."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.signal import lfilter

from ..rig import Columns, ConcealedRig, HiddenEffect, Sensor

FINE = 10  # steps of integration in a recorded sample
HALF, SIXTH = 0.5, 6.0  # weights of Runge-Kutta 4
EVEN = 2  # samples: inputs change at every second one, so that half the sample rate still records them whole
SEEN = 4  # of a sensor: its converter's steps in the RMS of its noise
_TEXT = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:12]


@njit(inline="always")
def integrate(slopes, inputs, begin, dt, p, e):
    """States (samples + 1, states) from `begin`, under inputs (samples, inputs) that are held; `slopes` fills d."""
    states, count = np.empty((len(inputs) + 1, len(begin))), len(begin)
    states[0] = begin
    k1, k2, k3, k4 = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    for k in range(len(inputs)):
        s, u, t = states[k], inputs[k], k * dt
        slopes(s, u, t, p, e, k1)
        slopes(s + HALF * dt * k1, u, t + HALF * dt, p, e, k2)
        slopes(s + HALF * dt * k2, u, t + HALF * dt, p, e, k3)
        slopes(s + dt * k3, u, t + dt, p, e, k4)
        states[k + 1] = s + dt / SIXTH * (k1 + 2 * k2 + 2 * k3 + k4)
    return states


def kept(function: Callable) -> Callable:
    """A call of `integrate`, compiled once on a computer, under a name that changes with this file.

    numba keeps no function that takes another as an argument, such as `integrate` itself.
    """
    function.__qualname__ += f"_{_TEXT}"
    return njit(cache=True)(function)


def steps(rng: np.random.Generator, samples: int, low: float, high: float, hold: tuple[int, int], quantum: float):
    """An input (samples,) of levels between `low` and `high`, each held for some samples, on a converter's grid."""
    levels: list[float] = []
    while len(levels) < samples:
        levels += [rng.uniform(low, high)] * (EVEN * int(rng.integers(hold[0] // EVEN, hold[1] // EVEN + 1)))
    return quantum * np.round(np.array(levels[:samples]) / quantum)


def smooth(rng: np.random.Generator, samples: int, size: float, lag: float, quantum: float):
    """A random input (samples,) of RMS `size` through two lags of `lag` samples, on a converter's grid."""
    keep = np.exp(-EVEN / lag)
    noise = rng.standard_normal(samples // EVEN + 1)
    found = lfilter([1 - keep], [1, -keep], lfilter([1 - keep], [1, -keep], noise))
    found *= size / found.std()
    return quantum * np.round(np.repeat(found, EVEN)[:samples] / quantum)


class Ways(NamedTuple):
    """What may happen to the input before it acts: offset, dead zone in its unit; delay and lag in s."""

    offset: float = 0.0
    dead: float = 0.0
    delay: float = 0.0
    lag: float = 0.0


def acting(signal: np.ndarray, dt: float, ways: Ways) -> np.ndarray:
    """The input (samples * FINE,) as it acts, from its record (samples,); dt: of a sample, s."""
    fine = np.repeat(signal, FINE) + ways.offset
    fine = np.sign(fine) * np.maximum(np.abs(fine) - ways.dead, 0.0) if ways.dead else fine
    late = round(ways.delay / dt * FINE)
    fine = np.concatenate([np.full(late, fine[0]), fine[: len(fine) - late]]) if late else fine
    return lagging(fine, dt / FINE, ways.lag)


def lagging(signal: np.ndarray, dt: float, lag: float) -> np.ndarray:
    """`signal` through a first-order lag in s that begins at rest.

    It is exact both for the means of an input that is held, and for readings of what is straight between them.
    """
    if not lag:
        return signal
    keep = np.exp(-dt / lag)
    rise = lag / dt * (1 - keep)
    return lfilter([1 - rise, rise - keep], [1, -keep], signal, zi=[rise * signal[0]])[0]


def sensor(name: str, unit: str, noise: float) -> Sensor:
    """A predicted channel; its resolution is a fraction of its noise."""
    return Sensor(name, unit, "output", resolution=noise / SEEN, noise=noise)


def hidden(equation: str, on: str, others: dict | None = None, *, signed: bool = False, **sizes) -> HiddenEffect:
    """An effect in `equation` (several are separated by blanks) that depends on the variables `on`."""
    return HiddenEffect(tuple(equation.split()), tuple(on.split()), sizes, others or {}, signed=signed)


def domain(
    *,
    dt: float,
    samples: int,
    source: Sensor,
    excite: Callable[[np.random.Generator, int], np.ndarray],
    run: Callable[[np.ndarray, float, dict, dict], Columns],
    **entries,
) -> ConcealedRig:
    """A machine with one input that runs free from its rest; holdout and third recording have half the samples.

    excite: gives the input (samples,). run: gives the outputs, each (samples,), from the input, the length of a sample,
    the parameters, and the effects with `form`.
    """

    def record(parameters: dict, extra: dict, form: float, seconds: float, rng: np.random.Generator) -> Columns:
        signal = excite(rng, round(seconds / dt) + 1)
        return {source.name: signal, **run(signal, dt, parameters, extra | {"form": form})}

    def predict(columns: Columns, parameters: dict, extra: dict, form: float, every: int = 1) -> Columns:
        return run(columns[source.name], dt, parameters, extra | {"form": form})

    channels = (source, *entries.pop("sensors"))
    return ConcealedRig(
        channels=channels,
        window=None,
        record=record,
        predict=predict,
        sample_time=dt,
        seconds={"identify": samples * dt, "holdout": samples // 2 * dt, "third": samples // 2 * dt},
        own=True,
        **entries,
    )
