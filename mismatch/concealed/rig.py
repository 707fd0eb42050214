"""What a rig with a concealed effect is made of, and what all of them share: sensors, velocities, calibration."""

from collections import namedtuple
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit

Columns = dict[str, np.ndarray]

SAMPLE_TIME = 1e-3  # s
RECORDINGS = {"identify": 20.0, "holdout": 8.0, "third": 8.0}  # seconds
UNIFORM_VARIANCE = 12  # an error spread evenly over a width has the variance width^2 / 12
PRESSURES, CODES = 40e6, 2**16  # Pa, and the codes of the converter that cover them
OFFSET_STEP, STEP = 1e-6, 1e-3  # for differences: of an offset in its unit, of a relative change
ROUNDING = 1e-9  # of a number, by which a file's and a draw's may differ
SMOOTHED = 5  # samples on either side, over which a recorded speed is taken

# a motion, by the draw
HARDNESS, SPEED = (0.3, 1.0), (0.35, 1.0)  # of the highest acceleration and speed
LONG_SHARE, HOME_SHARE = 0.6, 0.2  # of the moves are long, of them go home
LONG, SHORT = (0.2, 1.0), (0.01, 0.06)  # of the travel
LASTING = 2.5  # s, that a move goes on, at most
LEAST_MOVE = 1e-4  # m
PAUSE = (0.02, 0.5)  # s, between some moves
EVEN = 0.5  # of a draw with two outcomes
AXIS = (40, 90), (0.7, 1.0)  # rad/s and damping of an axis that follows through a lag


@dataclass(frozen=True)
class HiddenEffect:
    """One thing that a simulation may lack: where it enters, what it depends on, how large it may be.

    `sizes` are drawn log-uniformly between their bounds (with either sign if `signed`), `others` (periods, phases,
    places) uniformly, as whole numbers if the bounds are. Their keys are fields of the plant's effect tuple. `without`
    names the datasheet values that a rig with this effect does not give.
    """

    equation: tuple[str, ...]
    depends_on: tuple[str, ...]
    sizes: dict[str, tuple[float, float]]
    others: dict[str, tuple[float, float]] = field(default_factory=dict)
    signed: bool = False
    without: tuple[str, ...] = ()

    def draw(self, rng: np.random.Generator, least: float = 0.0) -> dict[str, float]:
        """Parameters of the effect: name to value, SI. Sizes of one effect keep the same place in their ranges, from
        `least` (0: barely seen) to 1 (dominant)."""
        place, sign = rng.uniform(least, 1.0), rng.choice([-1.0, 1.0]) if self.signed else 1.0
        sizes = {name: sign * low * (high / low) ** place for name, (low, high) in self.sizes.items()}
        others = {name: _drawn(rng, *bounds) for name, bounds in self.others.items()}
        return sizes | others


def _drawn(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between both; a whole one, below `high`, where they are whole."""
    whole = isinstance(low, int) and isinstance(high, int)
    return float(rng.integers(int(low), int(high)) if whole else rng.uniform(low, high))


def fields(name: str, module: str, values: Mapping[str, float]) -> Any:
    """A named tuple of numbers, as kernels take it. module: where it is the global `name`, so that kernels are kept."""
    return namedtuple(name, values, defaults=values.values(), module=module)  # type: ignore[misc]


def nothing(name: str, module: str, effects: Mapping[str, HiddenEffect], *ones: str) -> Any:
    """`fields` of what a rig may conceal, its effects' keys, and of their `form`; all zero: nothing.

    ones: keys that are divided by, and so are 1.
    """
    keys = [key for effect in effects.values() for key in (*effect.sizes, *effect.others)]
    return fields(name, module, dict.fromkeys(("form", *keys), 0.0) | dict.fromkeys(ones, 1.0))


@dataclass(frozen=True)
class Sensor:
    """A recorded signal: `resolution` is rounded to, `noise` is Gaussian with that RMS; both in `unit`."""

    name: str
    unit: str
    role: str
    resolution: float = 0.0
    noise: float = 0.0

    @property
    def error(self) -> float:
        """RMS of what the sensor adds."""
        return float(np.hypot(self.noise, self.resolution / np.sqrt(UNIFORM_VARIANCE)))

    @property
    def step(self) -> float:
        """The converter's."""
        return self.resolution or (self.noise / 2 if self.unit == "m" else PRESSURES / CODES)

    def measure(self, signal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """What the recorder writes: noise first, then the converter's grid (16 bits of 40 MPa for pressures)."""
        noisy = signal + self.noise * rng.standard_normal(len(signal)) if self.noise else signal
        rounded = self.step * np.round(noisy / self.step)
        return np.round(rounded) if self.unit == "Pa" else rounded


@dataclass(frozen=True)
class ConcealedRig:
    """One plant as its maker knows it.

    `record(parameters, effects, form, seconds, rng)` gives the true signals of a campaign, `predict(columns,
    parameters, effects, form)` the predicted channels by the comparison rule of the rigs. `form` is 0 for the standard
    form of every effect and 1 for its variant. `places` is the equation of each parameter with a tolerance, `same` the
    effects that are one claim, `alike` those that no recording of it tells apart, `optional` the parameters of
    something that one rig in ten has not got. `seconds` are those of its recordings; with `own` its plant is the file
    domains/PLANT.toml, which lies beside its rig.toml.
    """

    plant: str
    parameters: dict[str, float]
    tolerance: dict[str, float]
    places: dict[str, tuple[str, ...]]
    channels: tuple[Sensor, ...]
    window: float | None
    effects: dict[str, HiddenEffect]
    foreign: dict[str, HiddenEffect]
    record: Callable[..., Columns]
    predict: Callable[..., Columns]
    same: tuple[frozenset[str], ...] = ()
    optional: tuple[str, ...] = ()
    alike: tuple[frozenset[str], ...] = ()
    sample_time: float = SAMPLE_TIME
    seconds: dict[str, float] = field(default_factory=RECORDINGS.copy)
    own: bool = False

    @property
    def predicted(self) -> list[Sensor]:
        """The channels that a simulation predicts."""
        return [channel for channel in self.channels if channel.role == "output"]

    @property
    def restart(self) -> int:
        """Samples before the first restart; 0 where a simulation runs free."""
        return round((self.window or 0.0) / self.sample_time)


def errors(
    rig: ConcealedRig, columns: Columns, parameters: dict, effects: dict, form: float, every: int = 1
) -> Columns:
    """Simulated minus recorded, channel by channel; of every `every`-th window only (0.25 s, else of the whole)."""
    simulated = rig.predict(columns, parameters, effects, form, every)
    return {name: simulated[name] - columns[name] for name in simulated}


def rms(error: np.ndarray) -> float:
    """Root mean square of the finite values."""
    return float(np.sqrt(np.nanmean(np.square(error))))


def within(low: float, value: float, high: float) -> bool:
    """Whether an interval holds a value; a file's last digit decides nothing."""
    return bool(low - ROUNDING * abs(low) <= value <= high + ROUNDING * abs(high))


def calibrate(
    rig: ConcealedRig, columns: Columns, known: dict[str, float], rounds: int = 2, every: int = 1
) -> dict[str, float]:
    """Parameters without any effect that fit `columns` best under the tolerance as prior (sigma = tolerance / 2).

    Gauss-Newton on relative changes, weighted by what is left in each channel; stops where a round does not help.
    """
    names = [name for name in rig.tolerance if name in known]
    sigma = np.array([rig.tolerance[name] / 2 for name in names])
    if "offset" in known:
        names, sigma = [*names, "offset"], np.append(sigma, np.inf)

    def at(change: np.ndarray) -> dict[str, float]:
        scale = [known[name] or 1.0 for name in names]
        return known | {n: known[n] + s * c for n, s, c in zip(names, scale, change, strict=True)}

    def residual(change: np.ndarray) -> np.ndarray:
        return np.concatenate([e[np.isfinite(e)] / w for e, w in zip(raw(change), weights, strict=True)])

    def raw(change: np.ndarray) -> list[np.ndarray]:
        return list(errors(rig, columns, at(change), {}, 0.0, every).values())

    step = np.array([OFFSET_STEP if name == "offset" else STEP for name in names])
    best, weights = np.zeros(len(names)), [1.0] * len(rig.predicted)
    for _ in range(rounds):
        weights = [max(rms(e), c.error) for e, c in zip(raw(best), rig.predicted, strict=True)]
        r = residual(best)
        slopes = np.stack([(residual(best + d) - r) / h for d, h in zip(np.diag(step), step, strict=True)], axis=1)
        move = -np.linalg.solve(slopes.T @ slopes + np.diag(sigma**-2), slopes.T @ r + best / sigma**2)
        trial = np.clip(best + move, -2 * sigma, 2 * sigma)
        if not np.mean(residual(trial) ** 2) < np.mean(r**2):
            break
        best = trial
    return at(best)


def smoothed_difference(position: np.ndarray, half: int = SMOOTHED) -> np.ndarray:
    """Velocity [unit/s] of a recorded position: slope of a line through 2 `half` + 1 samples."""
    weights = np.arange(half, -half - 1, -1) / (2 * np.sum(np.arange(1, half + 1) ** 2) * SAMPLE_TIME)
    return np.convolve(np.pad(position, half, mode="reflect", reflect_type="odd"), weights, mode="valid")


def motion(rng: np.random.Generator, seconds: float, dt: float, travel: float, speed: float, hardness: float):
    """Positions, velocities and accelerations (samples,) of moves with trapezoidal speed between rests, from 0.

    Moves are short or long, in [0, `travel`] m, at up to `speed` m/s and `hardness` m/s^2, each with its own; the
    second goes back, every fifth goes home. Half of the axes follow through a lag of second order.
    """
    moves: list[tuple[float, float, float, float, float]] = []
    samples = round(seconds / dt)
    at, clock = 0.0, 0.0
    while clock < seconds:
        a, v = hardness * rng.uniform(*HARDNESS), speed * rng.uniform(*SPEED)
        long = rng.uniform() < LONG_SHARE
        reach = min(rng.uniform(*LONG) * travel, LASTING * v) if long else rng.uniform(*SHORT) * travel
        way = [-1.0, 1.0][int(len(moves) != 1 and (at - reach < 0 or rng.uniform() < EVEN))]
        to = 0.0 if rng.uniform() < HOME_SHARE else float(np.clip(at + way * reach, 0, travel))
        if abs(to - at) < LEAST_MOVE:
            continue
        v = min(v, np.sqrt(a * abs(to - at)))
        moves.append((clock, at, to, v, a))
        clock += abs(to - at) / v + v / a + rng.choice([0.0, rng.uniform(*PAUSE)])
        at = to
    rate, t = np.zeros(samples), np.arange(samples) * dt
    for start, begin, end, top, hard in moves:
        duration = abs(end - begin) / top + top / hard
        into = t - start
        rate += np.sign(end - begin) * np.clip(np.minimum(hard * into, hard * (duration - into)), 0, top)
    if rng.uniform() < EVEN:
        rate = lag(rate, dt, *(rng.uniform(*bounds) for bounds in AXIS))
    return np.cumsum(rate) * dt, rate, np.gradient(rate, dt)


@njit(cache=True)
def lag(signal, dt, omega, zeta):
    """Second-order lag of unit gain, semi-implicit Euler."""
    out = np.empty_like(signal)
    y, rate = 0.0, 0.0
    for k in range(len(signal)):
        rate += dt * (omega * omega * (signal[k] - y) - 2 * zeta * omega * rate)
        y += dt * rate
        out[k] = y
    return out
