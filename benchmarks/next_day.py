"""`greygate identify` on recordings of one day, judged on those of another: other levels, signals and surroundings.

Twenty plants that numpy and scipy alone make, of the kinds on which a choice by held-out stretches has lost to a linear
model: two levels of the input, a disturbance that nobody measures, coloured noise, many samples a period. Each has its
error on the other day beside the best linear model's of any order, and both errors held out.

    python -m benchmarks next_day dryer converter --seconds 60
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.integrate import odeint
from scipy.signal import cheby1, cheby2, lfilter

from greygate.identify.files import figures, identify
from greygate.identify.task import started
from greygate.models.accuracy import rms
from greygate.models.training.record import Record
from greygate.plain import plain
from greygate.plants.excitation import multisine, prms
from greygate.plants.recording import Recording

from .made import keep
from .shared import say, stopwatch

TAKES = "half an hour"
JOBS = 2
Run = tuple[dict[str, np.ndarray], np.ndarray]  # inputs by name and the output, (N,) each


@dataclass(frozen=True)
class Made:
    """run: (random numbers, whether it is another day) -> a recording. dt in s."""

    run: Callable[[np.random.Generator, bool], Run]
    dt: float

    def recorded(self, seed: int, other: bool) -> Recording:
        inputs, y = self.run(np.random.default_rng([45, seed]), other)
        channels = {**inputs, "y": y}
        return Recording(self.dt, channels, dict.fromkeys(channels, "1"), source="other day" if other else "train")


def simulated(rate: Callable, start, inputs: np.ndarray, dt: float) -> np.ndarray:
    """States (N, n) of x' = rate(x, t, row of inputs), which are held."""
    found = np.empty((len(inputs), len(start)))
    x = np.array(start, float)
    for k, row in enumerate(inputs):
        found[k] = x
        x = odeint(rate, x, (0.0, dt), (row,))[-1]
    return found


def levels(random: np.random.Generator, count: int, low: float, high: float, hold: tuple[int, int]) -> np.ndarray:
    return prms(count, low, high, hold, int(random.integers(2**31)))


def dryer(random: np.random.Generator, other: bool) -> Run:
    """A linear plant of two lags and a delay, between two levels; noise that a lag colours."""
    u = np.where(levels(random, 700, -1, 1, (2, 20)) > 0, 6.3, 3.4)
    x = simulated(lambda x, t, u: [(x[1] - x[0]) / 0.25, (u[0] - x[1]) / 0.08], (5, 5), np.roll(u, 2)[:, None], 0.08)
    return {"u": u}, x[:, 0] + lfilter([0.03], [1, -0.9], random.normal(size=len(u)))


def converter(random: np.random.Generator, other: bool) -> Run:
    """A step-down converter: two levels of its duty on the first day, a staircase on the other; a diode blocks."""
    u = levels(random, 1000, 0, 1, (10, 60))
    u = 0.2 + 0.6 * u if other else np.where(u > 0.5, 0.55, 0.4)

    def rate(x, t, u):
        i, v = x
        fed = 24 * u[0] - v - 0.4 * i
        return [np.where((i <= 0) & (fed < 0), -200 * i, fed / 2e-2), (i - v / 60) / 2e-3]

    return {"u": u}, simulated(rate, (0.1, 9), u[:, None], 2e-3)[:, 1] + 0.05 * random.normal(size=len(u))


def heater(random: np.random.Generator, other: bool) -> Run:
    """Two heat capacities that radiate; the room, which nobody measures, wanders, and is colder on the other day."""
    u = levels(random, 900, 0, 60, (20, 80))
    room = (-4 if other else 0) + np.cumsum(0.08 * random.normal(size=len(u)))

    def rate(x, t, row):
        lost = 2e-9 * ((x[0] + 293) ** 4 - (293 + row[1]) ** 4) + 0.03 * (x[0] - row[1])
        return [(0.2 * (x[1] - x[0]) - lost) / 10, (row[0] - 0.2 * (x[1] - x[0])) / 3]

    return {"u": u}, simulated(rate, (0, 0), np.stack([u, room], 1), 4.0)[:, 0] + 0.1 * random.normal(size=len(u))


def building(random: np.random.Generator, other: bool) -> Run:
    """Air and wall; heating and weather are measured, people and sun are not. The other day is of another month."""
    count, t = 900, np.arange(900) * 0.25
    weather = (10 if other else 2) + 4 * np.sin(2 * np.pi * t / 24) + np.cumsum(0.12 * random.normal(size=count))
    heat = np.where(levels(random, count, 0, 1, (4, 24)) > 0.5, 3.0, 0.0)
    people = 0.6 * (random.random(count // 30).repeat(30) > 0.6)

    def rate(x, t, row):
        air, wall = x
        return [(row[0] + row[2] + 0.5 * (wall - air) + 0.05 * (row[1] - air)) / 0.8,
                (0.5 * (air - wall) + 0.12 * (row[1] - wall)) / 8]  # fmt: skip

    y = simulated(rate, (19, 16), np.stack([heat, weather, people], 1), 0.25)[:, 0]
    return {"heat": heat, "weather": weather}, y + 0.05 * random.normal(size=count)


def motor(random: np.random.Generator, other: bool) -> Run:
    """A motor with dry friction, sampled hundreds of times a period, its speed in coarse steps."""
    u = levels(random, 6000, -12, 12, (300, 1200)) * (0.6 if other else 1)

    def rate(x, t, u):
        return [(5 * x[1] - 1.5 * np.tanh(x[0] / 0.3) - 0.1 * x[0]) / 0.08, (u[0] - 1.2 * x[1] - 0.4 * x[0]) / 4e-3]

    return {"u": u}, np.round(simulated(rate, (0, 0), u[:, None], 1e-3)[:, 0] / 0.05) * 0.05


def exchanger(random: np.random.Generator, other: bool) -> Run:
    """A steam-heated exchanger: its gain and its time constant fall with the flow."""
    u = levels(random, 1500, 0.2, 0.9, (8, 30)) if other else levels(random, 1500, 0.1, 1.0, (10, 60))

    def rate(x, t, u):
        return [(x[1] - x[0]) / 3, (80 - 60 * u[0] / (u[0] + 0.3) - x[1]) * (0.1 + 0.3 * u[0])]

    return {"u": u}, simulated(rate, (60, 60), u[:, None], 1.0)[:, 0] + 0.1 * random.normal(size=len(u))


def hysteresis(random: np.random.Generator, other: bool) -> Run:
    """Bouc and Wen's oscillator."""
    u = multisine(4000, 60 if other else 90, 2, 60, 2e-3, int(random.integers(2**31)))

    def rate(x, t, u):
        y, v, z = x
        return [v, (u[0] - 10 * v - 5e4 * y - z) / 2, 5e4 * v - 0.8e3 * abs(v) * z + 1.1e3 * v * abs(z)]

    return {"u": u}, simulated(rate, (0, 0, 0), u[:, None], 2e-3)[:, 0] + 8e-6 * random.normal(size=len(u))


def silverbox(random: np.random.Generator, other: bool) -> Run:
    """Duffing's oscillator; on the other day the drive grows beyond what it was."""
    u = multisine(5000, 0.1, 2, 180, 1 / 600, int(random.integers(2**31)))
    u = 1.3 * u * np.linspace(0, 1, len(u)) if other else u

    def rate(x, t, u):
        return [x[1], 6e4 * u[0] - 25 * x[1] - (4e5 * x[0] + 4e6 * x[0] ** 3) * 0.4]

    return {"u": u}, simulated(rate, (0, 0), u[:, None], 1 / 600)[:, 0] + 2e-4 * random.normal(size=len(u))


def sandwich(random: np.random.Generator, other: bool) -> Run:
    """Wiener and Hammerstein: a diode between two filters of third order, at a twelfth of the published speed."""
    noise = random.normal(size=8000)
    u = (0.6 if other else 0.7) * lfilter(*cheby1(4, 0.5, 0.35), noise)
    x = lfilter(*cheby1(3, 0.5, 2 * 4.4 / 51.2), u)
    z = np.where(x > 0, x / (1 + 1.5 * x), x)
    return {"u": u}, lfilter(*cheby2(3, 40, 2 * 5 / 51.2), z) + 3e-4 * random.normal(size=len(u))


def tanks(random: np.random.Generator, other: bool) -> Run:
    """Two tanks, one above the other, which runs over."""
    u = levels(random, 1200, 1, 6, (20, 80)) if other else levels(random, 1200, 0, 8, (20, 120))

    def rate(x, t, u):
        h, low = np.maximum(x, 0)
        over = 5 * max(h - 9, 0)
        return [0.25 * u[0] - 0.4 * np.sqrt(h) - over, 0.4 * np.sqrt(h) - 0.35 * np.sqrt(low) + 0.3 * over]

    y = simulated(rate, (4, 5), u[:, None], 4.0)[:, 1]
    return {"u": u}, np.minimum(y, 10) + 0.02 * random.normal(size=len(u))


def servo(random: np.random.Generator, other: bool) -> Run:
    """A position that rests anywhere, behind dry friction."""
    u = levels(random, 2500, -4, 4, (10, 60)) * (0.8 if other else 1)
    u -= u.mean()

    def rate(x, t, u):
        return [x[1], (u[0] - 0.6 * np.tanh(x[1] / 0.05) - 0.8 * x[1]) / 0.3]

    return {"u": u}, simulated(rate, (0, 0), u[:, None], 0.02)[:, 0] + 2e-3 * random.normal(size=len(u))


def plate(random: np.random.Generator, other: bool) -> Run:
    """Six resonances, linear: more than four orders."""
    u = levels(random, 4000, -1, 1, (1, 12))
    y = np.zeros(len(u))
    for f, d, g in ((0.012, 0.03, 1.0), (0.05, 0.02, 0.5), (0.11, 0.02, 0.4)):
        w = 2 * np.pi * f
        pole = np.exp(-d * w + 1j * w * np.sqrt(1 - d**2))
        y += g * w * lfilter([0, 1.0], np.real(np.poly([pole, pole.conj()])), u)
    return {"u": u}, y + 0.02 * np.std(y) * random.normal(size=len(u))


def battery(random: np.random.Generator, other: bool) -> Run:
    """A cell, whose charge rests anywhere; on the other day it begins emptier, with weaker pulses."""
    u = levels(random, 2000, -2, 2.05, (5, 60)) * (0.7 if other else 1)

    def rate(x, t, u):
        return [-u[0] / 2000, (0.03 * u[0] - x[1]) / 15]

    charge, drop = simulated(rate, (0.5 if other else 0.6, 0), u[:, None], 1.0).T
    rest = 3.4 + 0.6 * charge + 0.15 * np.tanh(8 * (charge - 0.9)) - 0.2 * np.tanh(20 * (0.1 - charge))
    return {"u": u}, rest - 0.05 * u - drop + 1e-3 * random.normal(size=len(u))


def reactor(random: np.random.Generator, other: bool) -> Run:
    """An exothermic stirred tank near its ignition."""
    u = levels(random, 1500, *((288, 300) if other else (285, 301)), (20, 80))

    def rate(x, t, u):
        k = 7.2e10 * np.exp(-8750 / x[1])
        return [1 - x[0] - k * x[0], 350 - x[1] + 209.2 * k * x[0] + 2.09 * (u[0] - x[1])]

    return {"u": u}, simulated(rate, (0.87, 325), u[:, None], 0.05)[:, 1] + 0.2 * random.normal(size=len(u))


def muscle(random: np.random.Generator, other: bool) -> Run:
    """The pressure of a chamber that a valve fills and empties; its flow chokes."""
    u = levels(random, 2000, *((-0.7, 0.8) if other else (-1, 1)), (20, 100))

    def flow(high, low):
        over = np.maximum(np.clip(low / high, 0, 1) - 0.3, 0) / 0.7
        return high * np.sqrt(1 - over**2)

    def rate(x, t, u):
        p = max(x[0], 1.0)
        return [3 * (max(u[0], 0) * flow(7, p) - max(-u[0], 0) * flow(p, 1.0)) - 0.05 * (p - 1)]

    return {"u": u}, simulated(rate, (3,), u[:, None], 0.01)[:, 0] + 0.01 * random.normal(size=len(u))


def boost(random: np.random.Generator, other: bool) -> Run:
    """A step-up converter: two levels of its duty on the first day, any on the other."""
    u = levels(random, 1200, 0, 1, (15, 60))
    u = 0.25 + 0.3 * u if other else np.where(u > 0.5, 0.5, 0.3)

    def rate(x, t, u):
        open_ = 1 - u[0]
        return [(12 - 0.3 * x[0] - open_ * x[1]) / 5e-3, (open_ * x[0] - x[1] / 30) / 1e-3]

    return {"u": u}, simulated(rate, (1, 18), u[:, None], 5e-4)[:, 1] + 0.05 * random.normal(size=len(u))


def mixer(random: np.random.Generator, other: bool) -> Run:
    """Heat that a flow carries on: the product of two inputs, and a lag that one of them sets."""
    inputs = {"flow": levels(random, 1500, 0.2, 1, (20, 100)), "power": levels(random, 1500, 0, 3, (15, 90))}
    inputs["power"] *= 0.8 if other else 1

    def rate(x, t, row):
        flow, power = row
        return [0.9 * power - 0.05 * flow * (x[0] - 15) - 0.01 * (x[0] - 20), (x[0] - x[1]) * (0.1 + 0.3 * flow)]

    y = simulated(rate, (30, 30), np.stack([*inputs.values()], 1), 1.0)[:, 1]
    return inputs, y + 0.1 * random.normal(size=len(y))


def gear(random: np.random.Generator, other: bool) -> Run:
    """A load behind a gear with play, which rests anywhere."""
    u = levels(random, 2500, -3, 3, (20, 80)) * (0.8 if other else 1)
    u -= u.mean()

    def rate(x, t, u):
        apart = x[0] - x[2]
        tooth = 400 * np.sign(apart) * max(abs(apart) - 0.15, 0)
        return [x[1], u[0] - tooth - 0.5 * x[1], x[3], (tooth - x[3]) / 0.8]

    return {"u": u}, simulated(rate, (0,) * 4, u[:, None], 0.02)[:, 2] + 2e-3 * random.normal(size=len(u))


def turbine(random: np.random.Generator, other: bool) -> Run:
    """A rotor in a wind that never stands still, and is stronger on the other day."""
    wind = 8 + other + 1.5 * lfilter([0.15], [1, -0.98], random.normal(size=2500))
    y = simulated(lambda x, t, u: [(0.02 * u[0] ** 3 / (x[0] + 1) - 0.02 * x[0] ** 2) / 4], (3,), wind[:, None], 0.5)
    return {"wind": wind}, y[:, 0] + 0.03 * random.normal(size=len(wind))


def closed(random: np.random.Generator, other: bool) -> Run:
    """A linear plant recorded under a controller, which feeds the noise back to the input."""
    asked = levels(random, 1500, -1, 1, (20, 60)) * (1.3 if other else 1)
    noise = lfilter([0.05], [1, -0.9], random.normal(size=len(asked)))
    u, y, summed, x = np.zeros(len(asked)), np.zeros(len(asked)), 0.0, np.zeros(2)
    for k, to in enumerate(asked):
        y[k] = x[1] + noise[k]
        summed += 0.02 * (to - y[k])
        u[k] = 1.5 * (to - y[k]) + summed
        x = np.array([0.85 * x[0] + 0.15 * np.clip(u[k], -1.5, 1.5), 0.9 * x[1] + 0.1 * x[0]])
    return {"u": u}, y


PLANTS = {
    "dryer": Made(dryer, 0.08), "converter": Made(converter, 2e-3), "heater": Made(heater, 4.0),
    "building": Made(building, 0.25), "motor": Made(motor, 1e-3), "exchanger": Made(exchanger, 1.0),
    "hysteresis": Made(hysteresis, 2e-3), "silverbox": Made(silverbox, 1 / 600), "sandwich": Made(sandwich, 1 / 51200),
    "tanks": Made(tanks, 4.0), "servo": Made(servo, 0.02), "plate": Made(plate, 1.0), "battery": Made(battery, 1.0),
    "reactor": Made(reactor, 0.05), "muscle": Made(muscle, 0.01), "boost": Made(boost, 5e-4), "mixer": Made(mixer, 1.0),
    "gear": Made(gear, 0.02), "turbine": Made(turbine, 0.5), "closed": Made(closed, 0.1),
}  # fmt: skip


def found_by(name: str, seconds: float, seed: int) -> dict:
    """What `identify` and the best linear model make of the other day, and what they promised."""
    given, other = (PLANTS[name].recorded(seed + of, bool(of)) for of in (0, 1))
    inputs = [n for n in given.channels if n != "y"]
    took = stopwatch()
    found = identify({"train": given}, inputs, "y", {}, seconds=seconds, jobs=JOBS)
    told, task = figures(found), found.task
    line, linear = found.search.best_linear()

    def error(network) -> float:
        record = Record({n: other[n] for n in inputs}, {"y": other["y"]}, skip=task.settle)
        errors = task.errors(network, started(record, task.output))
        return np.inf if errors is None else rms(errors)

    return plain(
        {
            "chosen": told["chosen"]["model"],
            "held_out": told["chosen"]["held_out"],
            "linear_held_out": line.error,
            "other_day": error(found.network),
            "linear": error(linear),
            "linear_model": line.model.name,
            "better_than_linear": told["confidence"]["better_than_linear"],
            "tried": told["tried"],
            "seconds": took(1),
        }
    )


def main(*name: Annotated[str, PLANTS], seconds: float = 60.0, seed: int = 1) -> None:
    for one in name or PLANTS:
        found = found_by(one, seconds, seed)
        keep("next_day", f"{one}, {seconds:g} s", found, one, "--seconds", f"{seconds:g}")
        ratio, (low, line) = found["other_day"] / found["linear"], (found["held_out"], found["linear_held_out"])
        say(
            f"{one:12} {found['other_day']:10.4g} linear {found['linear']:10.4g} ratio {ratio:6.3f} "
            f"held {low:9.4g}/{line:9.4g} {found['seconds']:5.0f} s {found['tried']} {found['chosen']} | "
            f"{found['linear_model']}"
        )
