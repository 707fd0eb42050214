"""`greygate build-snn` on six plants that scipy alone made, each with one effect that their equations leave out.

Beside it: the plant as it is and calibrated, `greygate identify`, the best linear model, and the plant with the true
effect, its size fitted. All are judged on one further recording; the network's Verilog is compared in every bit.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from greygate import diagnose
from greygate.mismatch.given import rig_of
from greygate.mismatch.several import by_rule, modelled
from greygate.plants.excitation import prms
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording

from .shared import scratch, stopwatch, told

TAKES = "ten minutes"
NOISE = 1e-3  # of what a channel moves
FINE = {"rtol": 1e-8, "atol": 1e-10}


@dataclass(frozen=True)
class Made:
    """rates: (state, input) -> its rates. outputs: channel -> (its unit, the number of its state); the last is judged.

    plant: its file without the effect. missing: what makes it the true one: (text, in its place), and the parameter.
    """

    rates: Callable[[np.ndarray, float], Sequence[float]]
    start: Sequence[float]
    outputs: dict[str, tuple[str, int]]
    sensors: Sequence[str]
    plant: str
    missing: Sequence[tuple[str, str]]
    unit: str
    span: tuple[float, float]
    hold: tuple[int, int]
    dt: float
    samples: int = 3000

    def run(self, seed: int) -> Recording:
        """One recording, with noise."""
        u, random = prms(self.samples, *self.span, self.hold, seed), np.random.default_rng([44, seed])
        x, states = np.array(self.start, float), []
        for level in u:
            states.append(x)
            x = solve_ivp(lambda t, x, u=level: self.rates(x, u), (0.0, self.dt), x, **FINE).y[:, -1]
        moved = np.array(states)
        channels, units = {"u": u}, {"u": self.unit}
        for name, (unit, j) in self.outputs.items():
            clean = moved[:, j]
            channels[name] = clean + NOISE * np.ptp(clean) * random.standard_normal(len(clean))
            units[name] = unit
        return Recording(self.dt, channels, units, source=f"run{seed}")


def play(way: float, half: float) -> float:
    return np.sign(way) * max(abs(way) - half, 0.0)


MOTOR = """step = 1e-4
outputs = ["i", "w"]
inputs = { u = "V" }
[parameters]
inductance = [5e-3, "H", 0.1, "armature"]
resistance = [1.0, "ohm", 0.1, "armature"]
k_m = [0.05, "N m/A", 0.05, "motor constant"]
k_e = [0.05, "V s/rad", 0.05, "back emf"]
inertia = [5e-5, "kg m^2", 0.1, "rotor"]
bearing = [2e-4, "N m s/rad", 0.3, "bearing"]
[states]
i = { unit = "A" }
w = { unit = "rad/s" }
[equations]
electric.i = { storage = "inductance", supply = "u", emf = "-k_e * w", winding = "-resistance * i" }
motion.w = { storage = "inertia", torque = "k_m * i", bearing = "-bearing * w" }
"""
TANK = """step = 0.1
outputs = ["h"]
inputs = { u = "V" }
[parameters]
area = [0.02, "m^2", 0.05, "tank"]
k_in = [5e-5, "m^3/(s V)", 0.1, "pump"]
k_out = [2e-4, "m^(5/2)/s", 0.1, "outlet"]
[states]
h = { unit = "m", initial = 0.2, low = 0.0 }
[equations]
level.h = { storage = "area", inflow = "k_in * u", outflow = "-k_out * sqrt(max(h, 0))" }
"""
DRIVE = """step = 2e-4
outputs = ["q_m", "q_l"]
inputs = { u = "N m" }
[parameters]
j_m = [1e-3, "kg m^2", 0.1, "motor"]
j_l = [3e-3, "kg m^2", 0.1, "load"]
k = [5.0, "N m/rad", 0.1, "shaft"]
d = [0.02, "N m s/rad", 0.3, "shaft"]
b_m = [5e-3, "N m s/rad", 0.3, "motor"]
b_l = [1e-2, "N m s/rad", 0.3, "load"]
k_l = [0.5, "N m/rad", 0.1, "spring at the load"]
[states]
q_m = { unit = "rad", rate = "w_m" }
w_m = { unit = "rad/s" }
q_l = { unit = "rad", rate = "w_l" }
w_l = { unit = "rad/s" }
[definitions]
shaft.torque = { unit = "N m", spring = "k * (q_m - q_l)", loss = "d * (w_m - w_l)" }
[equations]
way_m.q_m = { speed = "w_m" }
way_l.q_l = { speed = "w_l" }
motor.w_m = { storage = "j_m", drive = "u", shaft = "-torque", bearing = "-b_m * w_m" }
load.w_l = { storage = "j_l", shaft = "torque", bearing = "-b_l * w_l", spring = "-k_l * q_l" }
"""
HEATER = """step = 0.05
outputs = ["T"]
inputs = { u = "W" }
[parameters]
heat = [20.0, "J/K", 0.1, "capacity"]
loss = [0.05, "W/K", 0.2, "to the air"]
air = [293.0, "K", 0.0, "of the air"]
[states]
T = { unit = "K", initial = 293.0 }
[equations]
warmth.T = { storage = "heat", power = "u", air = "-loss * (T - air)" }
"""
AXIS = """step = 1e-4
outputs = ["x", "p"]
inputs = { u = "V" }
[parameters]
mass = [20.0, "kg", 0.1, "piston and load"]
area = [1e-3, "m^2", 0.01, "piston"]
b = [400.0, "N s/m", 0.3, "seal"]
k = [2e4, "N/m", 0.1, "spring"]
c = [1e-12, "m^3/Pa", 0.1, "volume over bulk modulus"]
k_q = [2e-5, "m^3/(s V)", 0.1, "valve"]
[states]
x = { unit = "m", rate = "v" }
v = { unit = "m/s" }
p = { unit = "Pa" }
[equations]
way.x = { speed = "v" }
piston.v = { storage = "mass", pressure = "area * p", seal = "-b * v", spring = "-k * x" }
chamber.p = { storage = "c", valve = "k_q * u", motion = "-area * v" }
"""
PENDULUM = """step = 1e-3
outputs = ["q"]
inputs = { u = "N m" }
[parameters]
inertia = [0.02, "kg m^2", 0.1, "pendulum"]
weight = [1.0, "N m", 0.05, "m g l"]
bearing = [0.02, "N m s/rad", 0.3, "bearing"]
[states]
q = { unit = "rad", rate = "w" }
w = { unit = "rad/s" }
[equations]
way.q = { speed = "w" }
swing.w = { storage = "inertia", drive = "u", weight = "-weight * sin(q)", bearing = "-bearing * w" }
"""


def motor(x: np.ndarray, u: float) -> list[float]:
    i, w = x
    return [(u - 0.052 * w - 1.04 * i - 0.35 * np.tanh(i / 0.05)) / 5e-3, (0.05 * i - 2.2e-4 * w) / 5.2e-5]


def tank(x: np.ndarray, u: float) -> list[float]:
    return [(5.2e-5 * max(u - 0.6, 0.0) - 1.9e-4 * np.sqrt(max(x[0], 0.0))) / 0.02]


def drive(x: np.ndarray, u: float) -> list[float]:
    q_m, w_m, q_l, w_l = x
    loose = abs(q_m - q_l) < 0.03
    torque = 5.2 * play(q_m - q_l, 0.03) + (0.0 if loose else 0.02 * (w_m - w_l))
    return [w_m, (u - torque - 5.5e-3 * w_m) / 1e-3, w_l, (torque - 1e-2 * w_l - 0.49 * q_l) / 3.1e-3]


def heater(x: np.ndarray, u: float) -> list[float]:
    return [(u - 0.052 * (x[0] - 293.0) - 1.5e-10 * (x[0] ** 4 - 293.0**4)) / 20.5]


def axis(x: np.ndarray, u: float) -> list[float]:
    way, v, p = x
    return [v, (1e-3 * p - 420.0 * v - 2.05e4 * way) / 20.0, (2.05e-5 * u - 1e-3 * v - 1.5e-11 * p) / 1e-12]


def pendulum(x: np.ndarray, u: float) -> list[float]:
    q, w = x
    return [w, (u - 1.02 * np.sin(q) - 0.018 * w - 0.01 * abs(w) * w) / 0.0205]


PLANTS = {
    "motor": Made(
        motor, (0.0, 0.0), {"i": ("A", 0), "w": ("rad/s", 1)}, (), MOTOR,
        [('winding = "-resistance * i"', 'winding = "-resistance * i", brushes = "-drop * tanh(i / 0.05)"'),
         ("[states]", 'drop = [0.2, "V", 1.0, "brushes"]\n[states]')],
        "V", (-6.0, 6.0), (20, 150), 1e-3,
    ),
    "tank": Made(
        tank, (0.2,), {"h": ("m", 0)}, (), TANK,
        [('"k_in * u"', '"k_in * max(u - dead, 0)"'), ("[states]", 'dead = [0.5, "V", 1.0, "pump"]\n[states]')],
        "V", (0.0, 5.0), (20, 100), 2.0,
    ),
    "drive": Made(
        drive, (0.0, 0.0, 0.0, 0.0), {"q_m": ("rad", 0), "q_l": ("rad", 2)}, (), DRIVE,
        [('spring = "k * (q_m - q_l)", loss = "d * (w_m - w_l)"',
          'spring = "k * (max(q_m - q_l - half, 0) + min(q_m - q_l + half, 0))", '
          'loss = "d * (w_m - w_l) * max(sign(abs(q_m - q_l) - half), 0)"'),
         ("[states]", 'half = [0.02, "rad", 1.0, "play"]\n[states]')],
        "N m", (-0.25, 0.25), (50, 300), 2e-3,
    ),
    "heater": Made(
        heater, (293.0,), {"T": ("K", 0)}, (), HEATER,
        [('air = "-loss * (T - air)"', 'air = "-loss * (T - air)", radiation = "-e * (T**4 - air**4)"'),
         ("[states]", 'e = [1e-10, "W/K^4", 1.0, "surface"]\n[states]')],
        "W", (0.0, 20.0), (30, 300), 1.0,
    ),
    "axis": Made(
        axis, (0.0, 0.0, 0.0), {"x": ("m", 0), "p": ("Pa", 2)}, (), AXIS,
        [('motion = "-area * v"', 'motion = "-area * v", leak = "-k_l * p"'),
         ("[states]", 'k_l = [1e-11, "m^3/(s Pa)", 1.0, "leak"]\n[states]')],
        "V", (-3.0, 3.0), (20, 150), 2e-3,
    ),
    "pendulum": Made(
        pendulum, (0.0, 0.0), {"q": ("rad", 0)}, (), PENDULUM,
        [('bearing = "-bearing * w"', 'bearing = "-bearing * w", drag = "-c * abs(w) * w"'),
         ("[states]", 'c = [5e-3, "N m s^2/rad^2", 1.0, "air"]\n[states]')],
        "N m", (-0.7, 0.7), (10, 80), 1e-2,
    ),
}  # fmt: skip


def calibrated(text: str, folder: Path, files: Sequence[Path]) -> float:
    """RMS on the second recording of the plant of `text`, calibrated to the first, no effect tried."""
    (folder / "plant.toml").write_text(text)
    plant = Plant.read(folder / "plant.toml")
    free = {s: p.tolerance for s, p in plant.parameters.items() if p.tolerance}
    found = diagnose(plant, files[0], effects={}, tolerance=free)
    rig = rig_of(plant, files[0], tolerance=free, holdout=[files[1]])
    model = modelled(rig, rig.held_out(), {})
    left = by_rule(model, {s: v for s, v in found.corrected.values.items() if s in model.values})[0] - model.target
    return float(np.sqrt(np.mean(left[:, -1] ** 2)))


def found(name: str) -> dict:
    """RMS of each on the further recording, in the unit of the judged channel; what was named; bits; minutes."""
    made = PLANTS[name]
    judged = [*made.outputs][-1]
    with scratch() as folder:
        files = [folder / "train.csv", folder / "test.csv"]
        for seed, file in enumerate(files):
            made.run(seed).write_csv(file)
        (folder / "nominal.toml").write_text(made.plant)
        true = made.plant
        for old, new in made.missing:
            assert old in true
            true = true.replace(old, new)
        watch = stopwatch()
        sensors = [word for s in made.sensors for word in ("--sensor", s)]
        words = (folder / "nominal.toml", files[0], "--test", files[1], *sensors, "--output", judged)
        built = told("build-snn", *words, "--seconds", 600, "--out", folder / "net")
        minutes = watch() / 60
        diagnosis = next((folder / "net").glob("*.diagnosis.json"), None)
        told("compile", built["out"], files[0], files[1], "--architecture", "folded", "--out", folder / "rtl")
        bits = told("verify", folder / "rtl", "--seed", 1)
        words = (word for name in ("u", *made.sensors) for word in ("--input", name))
        words = (files[0], "--test", files[1], "--output", judged, *words, "--seconds", 60)
        other = told("identify", *words, "--out", folder / "id")
        rms = {who: next(iter(by["test"].values())) for who, by in built["rms"].items()}
        rms |= {"identify": other["test"]["test"], "calibrated": calibrated(made.plant, folder, files)}
        said = {} if diagnosis is None else json.loads(diagnosis.read_text())
        return {
            "channel": judged, "unit": made.outputs[judged][0], "rms": rms | {"true": calibrated(true, folder, files)},
            "named": [called(effect) for effect in said.get("effects", ())], "minutes": round(minutes, 2),
            "neurons": built["neurons"], "steps": sum(v["steps"] for v in bits["verdicts"]),
            "differing": sum(v["mismatch"] is not None for v in bits["verdicts"]),
        }  # fmt: skip


def called(effect: dict) -> str:
    """The name of an effect; of a term that has none, what it is a function of and how."""
    if effect["id"] != "unknown":
        return effect["id"]
    return " + ".join(symbol.removeprefix("unknown_") for symbol in effect["parameters"])


PARTS = {name: partial(found, name) for name in PLANTS}
