"""Four small machines of a user, each with something that its plant file leaves out; made by equations of their own.

Each maker writes rig.toml, plant.toml and identify.csv to a folder. Time runs in `INNER` Euler steps a sample.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

INNER = 20  # steps of integration in a sample
SAMPLES = 900


def steps(seed: int, low: float, high: float, hold: int, samples: int = SAMPLES) -> np.ndarray:
    """An input that jumps to another level every `hold` samples."""
    levels = np.random.default_rng(seed).uniform(low, high, samples // hold + 1)
    return np.repeat(levels, hold)[:samples]


def integrated(rate: Callable[[float, float], float], inputs: np.ndarray, dt: float, start: float = 0.0) -> np.ndarray:
    """The state (samples,) of a first-order plant: its rate is a function of state and input."""
    out, state = np.empty(len(inputs)), start
    for k, u in enumerate(inputs.tolist()):
        out[k] = state
        for _ in range(INNER):
            state += dt / INNER * rate(state, u)
    return out


def write(
    folder: Path, plant: str, sheet: Mapping[str, float], tolerance: Mapping[str, float], channels: Mapping, dt: float
) -> Path:
    """channels: name -> (unit, role, noise or None where it is not told, signal)."""
    folder.mkdir(parents=True)
    (folder / "plant.toml").write_text(plant)
    outputs = [name for name, (_, role, *_) in channels.items() if role == "output"]
    lines = ['plant = "plant.toml"', f"sample_time_s = {dt}", f"predict = {outputs!r}".replace("'", '"')]
    lines += ["[parameters]", *(f"{s} = {v!r}" for s, v in sheet.items())]
    lines += ["[tolerance]", *(f"{s} = {v!r}" for s, v in tolerance.items())]
    for name, (unit, role, noise, _) in channels.items():
        lines += [f"[channels.{name}]", f'unit = "{unit}"', f'role = "{role}"']
        lines += [f"noise_rms = {noise!r}"] if noise else []
    (folder / "rig.toml").write_text("\n".join(lines) + "\n")
    columns = {name: signal for name, (*_, signal) in channels.items()}
    rows = np.column_stack([np.arange(len(next(iter(columns.values())))) * dt, *columns.values()])
    header = ",".join(["t", *columns])
    np.savetxt(folder / "identify.csv", rows, "%.9g", delimiter=",", header=header, comments="")
    return folder


MOTOR = """step = 1e-3
outputs = ["w"]
[inputs]
u = "V"
[parameters]
inertia = [0.01, "kg m^2"]
gain = [0.1, "N m/V"]
viscous = [0.01, "N m s/rad"]
[states]
w = { unit = "rad/s" }
[equations.rotation]
w = { storage = "inertia", motor = "gain * u", viscous = "-viscous * w" }
"""


def motor(folder: Path, noise: float | None = None) -> Path:
    """A motor whose speed is measured, with Coulomb friction of 0.15 N m; noise: as told, it is 0.5 rad/s."""
    dt, u = 0.01, steps(1, -10.0, 10.0, 40)
    w = integrated(lambda w, u: (0.1 * u - 0.0105 * w - 0.15 * np.tanh(w / 0.05)) / 0.01, u, dt)
    w = w + 0.5 * np.random.default_rng(2).standard_normal(len(w))
    sheet = {"inertia": 0.01, "gain": 0.1, "viscous": 0.01}
    channels = {"u": ("V", "input", None, u), "w": ("rad/s", "output", noise, w)}
    return write(folder, MOTOR, sheet, {"inertia": 0.1, "viscous": 0.2}, channels, dt)


ENCODER = """step = 1e-3
outputs = ["phi"]
[inputs]
u = "V"
[parameters]
gain = [2.0, "rad/(s V)"]
lag = [0.1, "s"]
[states]
phi = { unit = "rad", rate = "w" }
w = { unit = "rad/s" }
[equations.position]
phi = { velocity = "w" }
[equations.speed]
w = { storage = "lag", command = "gain * u", own = "-w" }
"""


def encoder(folder: Path, noise: float | None = None) -> Path:
    """A turning axis whose encoder sits behind a play of 24 mrad; noise: as told, it is 0.5 mrad."""
    dt, u = 0.01, steps(3, -1.0, 1.0, 60)
    w = integrated(lambda w, u: (2.0 * u - w) / 0.1, u, dt)
    phi = np.concatenate(([0.0], np.cumsum(w[:-1] * dt)))
    at, shown = phi[0], np.empty_like(phi)
    for k, x in enumerate(phi.tolist()):
        at = min(max(at, x - 0.012), x + 0.012)
        shown[k] = at
    shown = shown + 5e-4 * np.random.default_rng(4).standard_normal(len(phi))
    channels = {"u": ("V", "input", None, u), "phi": ("rad", "output", noise, shown)}
    return write(folder, ENCODER, {"gain": 2.0, "lag": 0.1}, {"gain": 0.05, "lag": 0.2}, channels, dt)


CIRCUIT = """step = 1e-3
outputs = ["v"]
[inputs]
u = "V"
[parameters]
resistance = [1e3, "ohm"]
capacity = [1e-4, "F"]
[states]
v = { unit = "V" }
[equations.charge]
v = { storage = "capacity", through = "(u - v) / resistance" }
"""


def circuit(folder: Path, noise: float | None = None) -> Path:
    """A capacitor behind a resistor, with a diode across it; noise: as told, it is 2 mV."""
    dt, u = 0.01, steps(5, -1.0, 1.5, 25)
    v = integrated(lambda v, u: ((u - v) / 1e3 - 1e-9 * (np.exp(v / 0.05) - 1.0)) / 1e-4, u, dt)
    v = v + 2e-3 * np.random.default_rng(6).standard_normal(len(v))
    sheet = {"resistance": 1e3, "capacity": 1e-4}
    channels = {"u": ("V", "input", None, u), "v": ("V", "output", noise, v)}
    return write(folder, CIRCUIT, sheet, {"resistance": 0.05, "capacity": 0.1}, channels, dt)


HEATER = """step = 0.5
outputs = ["temp"]
[inputs]
power = "W"
[parameters]
capacity = [50.0, "J/K"]
loss = [0.5, "W/K"]
ambient = [20.0, "degC"]
[states]
temp = { unit = "degC", initial = "ambient" }
[equations.heat]
temp = { storage = "capacity", heater = "power", loss = "-loss * (temp - ambient)" }
"""


def heater(folder: Path, noise: float | None = None) -> Path:
    """A heated block that also radiates; its power is never negative. noise: as told, it is 0.2 degC."""
    dt, power = 5.0, steps(7, 20.0, 180.0, 40)
    radiated = 2e-9  # W/K^4
    temp = integrated(
        lambda t, p: (p - 0.5 * (t - 20.0) - radiated * ((t + 273.15) ** 4 - 293.15**4)) / 50.0, power, dt, 20.0
    )
    temp = temp + 0.2 * np.random.default_rng(8).standard_normal(len(temp))
    sheet = {"capacity": 50.0, "loss": 0.5, "ambient": 20.0}
    channels = {"power": ("W", "input", None, power), "temp": ("degC", "output", noise, temp)}
    return write(folder, HEATER, sheet, {"capacity": 0.1, "loss": 0.1}, channels, dt)
