"""A cable-drum sensor (thesis chapter 7), simulated: a drum on a carriage rolls along a tensioned cable and slips.

`cable_drum()` is the rig on the day of training; with `ANOTHER_DAY`, which no network knows, it is the rig on the day
of validation. `record` moves the carriage and reads drum encoder, linear scale and home beacon. The thesis's recordings
were never published. The sizes follow from the 0.5 to 0.65 mm by which table 7.1's networks err, which cannot know the
slip's sum, from the 37 um by which NOE #9 misses the drum's turn, and from the 9776 samples.
"""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from greygate.errors import InputError
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording
from greygate.plants.simulator import simulate

SAMPLE_TIME = 0.02  # s; 9776 samples are 196 s
TRAVEL = 0.6  # m
RADIUS = 0.02  # m, the nominal radius, which converts angles into positions
COUNTS = 2**15  # of the drum's encoder per turn
STEP = 2 * math.pi * RADIUS / COUNTS  # m of cable per count
SCALE_STEP, SCALE_NOISE = 5e-6, 5e-6  # m: the linear scale's resolution and the vibration it sees, RMS
BEACON = 20e-6  # m on either side of home, within which the beacon answers
SPEEDS = (0.05, 0.1, 0.14)  # m/s, of the round trips
ROUND_TRIPS = 16
HOMING = 8  # moves, after which a course comes home
SAMPLES = {"training": 9_776, "choice": 40_000, "validation": 12_500}
SEEDS = {"training": 1, "choice": 2, "validation": 3}

PLANT = Plant.read(Path(__file__).parent / "simulated" / "cable_drum.toml")

ANOTHER_DAY = {"tension": 0.975, "f_drag": 1.05, "f_bias": 1.05, "damping": 0.925, "micro": 7 / 6}
"""Factor of each parameter that differs in validation."""
DRIFT, DRIFT_TIME = 0.04, 60.0
"""RMS and time constant (s) of the slow random change of slip, relative: warmth and dirt."""


def cable_drum(**values: float) -> Plant:
    """Inputs `v_ref` (m/s), the carriage's speed as commanded, and `warmth` (1), the relative change of slip.

    States `x` (carriage), `v`, `phi` (drum, rad), `slip` and `micro_slip` (m). Raises InputError for another parameter.
    """
    return PLANT.with_parameters(**values)


def moves(samples: int, seed: int, home_every: int = 0) -> np.ndarray:
    """Speed command (samples,) in m/s: from rest to rest between random places of the travel at random speeds.

    10 to 140 mm/s, 0.1 to 1 m/s^2, rests of 0.2 to 2 s; it starts at home, x = 0. home_every: with n, every n-th move
    ends at home and rests there for a second.
    """
    rng = np.random.default_rng(seed)
    x, parts, length = 0.0, [], 0
    for count in range(1, samples):
        homing = home_every and count % home_every == 0
        goal = 0.0 if homing else rng.uniform(0.0, TRAVEL)
        speed = rng.uniform(0.01, 0.14) if rng.random() < 0.7 else rng.choice(SPEEDS)
        move = trapezoid(goal - x, speed, rng.uniform(0.1, 1.0))
        rest = 1.0 if homing else rng.uniform(0.2, 2.0)
        parts += [move, np.zeros(round(rest / SAMPLE_TIME))]
        x, length = goal, length + len(parts[-2]) + len(parts[-1])
        if length >= samples:
            break
    return np.concatenate(parts)[:samples]


def trapezoid(distance: float, speed: float, acceleration: float) -> np.ndarray:
    """Speed at every sample, whose sum times the sample time is exactly `distance` (m)."""
    speed = min(speed, math.sqrt(abs(distance) * acceleration))
    if speed == 0.0:
        return np.zeros(0)
    ramp, whole = speed / acceleration, abs(distance) / speed + speed / acceleration
    t = (np.arange(math.ceil(whole / SAMPLE_TIME)) + 0.5) * SAMPLE_TIME
    shape = np.clip(np.minimum(t, whole - t) / ramp, 0.0, 1.0)
    return distance * shape / (shape.sum() * SAMPLE_TIME)


def round_trips(speed: float, count: int = ROUND_TRIPS) -> np.ndarray:
    """Speed command of `count` round trips over the travel at one speed (7.3), with rests of 1 s."""
    rest = np.zeros(round(1 / SAMPLE_TIME))
    there = trapezoid(TRAVEL, speed, 0.5)
    return np.concatenate([rest, *[there, rest, -there, rest] * count])


def record(name: str, **values: float) -> Recording:
    """`training` (9,776 samples), `choice` (40,000), `validation` (12,500) or one of `trips_50`, `_100`, `_140`.

    Validation and choice come home at every eighth move; validation is of another day. `choice` serves for the choices
    that training leaves open. values: other parameters of the rig. Raises InputError for another name.
    """
    plant = cable_drum(**values)
    if name == "validation":
        return validation(another_day(plant), SEEDS[name])
    if name in SAMPLES:
        v_ref = moves(SAMPLES[name], SEEDS[name], home_every=HOMING if name == "choice" else 0)
        return measure(plant, v_ref, SEEDS[name] + 100, name)
    trips = {f"trips_{round(1e3 * speed)}": speed for speed in SPEEDS}
    if name not in trips:
        raise InputError(f"record {name!r} is unknown; give one of {', '.join((*SAMPLES, *trips))}")
    return measure(plant, round_trips(trips[name]), list(trips).index(name) + 200, name)


def validation(plant: Plant, seed: int, warmth: float = 1.0) -> Recording:
    """A course of 250 s that comes home at every eighth move. warmth: as `measure`."""
    v_ref = moves(SAMPLES["validation"], seed, home_every=HOMING)
    return measure(plant, v_ref, seed + 100, "validation", warmth)


def another_day(plant: Plant, factors: Mapping[str, float] = ANOTHER_DAY) -> Plant:
    """The rig with each of these parameters times its factor."""
    return plant.with_parameters(**{n: plant.parameters[n].value * factor for n, factor in factors.items()})


def measure(plant: Plant, v_ref: np.ndarray, seed: int, source: str = "cable_drum", warmth: float = 1.0) -> Recording:
    """Simulate the rig and read it through its sensors.

    v_ref: m/s, (samples,). seed: of the scale's noise and of the slow drift. warmth: factor on that. Channels: `x_pe`
    (m) of the encoder, `theta` (rad, -pi to pi), its angle within a turn, `home` (0, 1), `e` (m), linear scale minus
    `x_pe` (7.1), and the true values `e_true`, `x_true`, `v_true`.
    """
    rng = np.random.default_rng(seed)
    true = simulate(
        plant, {"v_ref": v_ref, "warmth": warmth * drift(len(v_ref), rng)}, sample_time=SAMPLE_TIME, step=1e-3
    )
    counts = np.floor(true["phi"] * COUNTS / (2 * math.pi) + 0.5)
    x_pe = counts * STEP
    scale = SCALE_STEP * np.round((true["x"] + SCALE_NOISE * rng.standard_normal(true.samples)) / SCALE_STEP)
    channels = {
        "x_pe": x_pe,
        "theta": ((counts + COUNTS / 2) % COUNTS / COUNTS - 0.5) * 2 * math.pi,
        "home": (np.abs(true["x"]) <= BEACON).astype(float),
        "e": scale - x_pe,
        "e_true": true["x"] - RADIUS * true["phi"],
        "x_true": true["x"],
        "v_true": true["v"],
    }
    units = {n: "m" for n in channels} | {"theta": "rad", "home": "1", "v_true": "m/s"}
    return Recording(SAMPLE_TIME, channels, units, source)


def drift(samples: int, rng: np.random.Generator) -> np.ndarray:
    """First-order noise of `DRIFT` RMS and `DRIFT_TIME`, (samples,)."""
    from scipy.signal import lfilter  # takes a second

    keep = math.exp(-SAMPLE_TIME / DRIFT_TIME)
    noise = DRIFT * rng.standard_normal(samples + 1)
    noise[1:] *= math.sqrt(1 - keep**2)
    return lfilter([1.0], [1.0, -keep], noise)[1:]
