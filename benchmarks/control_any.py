"""Control of three machines from their files alone: PI, predictive control, the network, its Verilog, and do-mpc.

    MACHINE   every controller of `greygate control --place rtl`, undisturbed, under a load, under a sagging supply
    peers     do-mpc with CasADi and IPOPT on the same machines, horizons and days; it is given the true state

A time is the median of a step on one core of this computer.
"""

import json
import subprocess
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from greygate.control.choices import Case, Method, Place
from greygate.control.own import Machine, UnderWay
from greygate.hardware.controlled import table
from greygate.machines.asked import Wishes, asked
from greygate.plants.excitation import multisine, prms
from greygate.plants.recording import Recording

from .made import stored
from .shared import PEERS, say, scratch

TAKES = "ten minutes"
NEEDS = ("g++", "make")
SAMPLES = 1500
CART = """
step = 5e-4
outputs = ["x"]
inputs = { u = "V" }
[parameters]
mass = [2.0, "kg", 0.05]
k_f = [5.0, "N/V", 0.1]
b = [20.0, "N s/m", 0.3]
dry = [6.0, "N", 0.3]
[states]
x = { unit = "m", rate = "v" }
v = { unit = "m/s" }
[equations]
place.x = { speed = "v" }
cart.v = { storage = "mass", motor = "k_f * u", guide = "-b * v", friction = "-dry * tanh(v / 0.01)" }
"""
TWO_MASSES = """
step = 5e-4
outputs = ["phi_m", "phi_l"]
inputs = { torque = "N m" }
[parameters]
j_m = [2e-3, "kg m^2", 0.05]
j_l = [4e-3, "kg m^2", 0.2]
k = [20.0, "N m/rad", 0.1]
d = [0.02, "N m s/rad", 0.3]
b = [0.01, "N m s/rad", 0.3]
[states]
phi_m = { unit = "rad", rate = "w_m" }
w_m = { unit = "rad/s" }
phi_l = { unit = "rad", rate = "w_l" }
w_l = { unit = "rad/s" }
[definitions]
shaft.t_s = { unit = "N m", spring = "k * (phi_m - phi_l)", damping = "d * (w_m - w_l)" }
[equations]
motor.phi_m = { speed = "w_m" }
rotor.w_m = { storage = "j_m", drive = "torque", shaft = "-t_s", bearing = "-b * w_m" }
load.phi_l = { speed = "w_l" }
wheel.w_l = { storage = "j_l", shaft = "t_s", bearing = "-b * w_l" }
"""
TANKS = """
step = 0.5
outputs = ["h_1", "h_2"]
inputs = { q_1 = "m^3/s", q_2 = "m^3/s" }
[parameters]
area = [0.0154, "m^2", 0.03]
c_1 = [3.3e-5, "m^2.5/s", 0.1]
c_2 = [4.4e-5, "m^2.5/s", 0.1]
c_12 = [5e-5, "m^2.5/s", 0.1]
[states]
h_1 = { unit = "m", initial = 0.3, low = 0.0 }
h_2 = { unit = "m", initial = 0.2, low = 0.0 }
[definitions]
between.q_12 = { unit = "m^3/s", flow = "c_12 * (h_1 - h_2) / sqrt(abs(h_1 - h_2) + 0.001)" }
[equations]
one.h_1 = { storage = "area", in = "q_1", over = "-q_12", out = "-c_1 * sqrt(h_1)" }
two.h_2 = { storage = "area", in = "q_2", over = "q_12", out = "-c_2 * sqrt(h_2)" }
"""


def swept(period: float, low: float, high: float, size: float, seed: int) -> np.ndarray:
    """A random motion from rest."""
    ramp = np.clip(np.arange(SAMPLES) / 100, 0, 1)
    return size * multisine(SAMPLES, 1.0, low, high, period, seed) * ramp**2 * (3 - 2 * ramp)


def stepped(start: float, low: float, high: float, seed: int) -> np.ndarray:
    """Levels that change at once, held for 100 to 250 samples."""
    found = prms(SAMPLES, low, high, (100, 250), seed)
    found[:50] = start
    return found


MACHINES: Mapping[str, tuple] = {  # plant, period [s], references, units, wishes
    "cart": (CART, 5e-3, {"x": swept(5e-3, 0.1, 1.0, 0.1, 7)}, "m",
             Wishes({"u": (-10.0, 10.0)}, {"u": 400.0}, {"x": 1e-5})),
    "two_masses": (TWO_MASSES, 5e-3, {"phi_l": swept(5e-3, 0.1, 2.0, 1.0, 8)}, "rad",
                   Wishes({"torque": (-1.0, 1.0), "t_s": (-0.6, 0.6)}, {"torque": 100.0},
                          {"phi_m": 1e-4, "phi_l": 1e-4})),
    "tanks": (TANKS, 5.0, {"h_1": stepped(0.3, 0.2, 0.5, 9), "h_2": stepped(0.2, 0.1, 0.35, 10)}, "m",
              Wishes({"q_1": (0.0, 1e-4), "q_2": (0.0, 1e-4), "h_1": (0.0, 0.48)}, {"q_1": 4e-6, "q_2": 4e-6},
                     {"h_1": 2e-4, "h_2": 2e-4})),
}  # fmt: skip


def machine(name: str, folder: Path) -> Machine:
    text, period, references, unit, wishes = MACHINES[name]
    (folder / f"{name}.toml").write_text(text)
    Recording(period, references, dict.fromkeys(references, unit)).write_csv(folder / "track.csv")
    return asked(folder / f"{name}.toml", folder / "track.csv", wishes)


def compared(name: str) -> dict:
    with scratch() as folder:
        done = table(machine(name, folder), Method.NETWORK, Place.RTL, lambda line: say(f"{name}: {line}"))
    return dict(done.found)


def peers() -> dict:
    """do-mpc on each machine and day, in the interpreter of `make peers`."""
    found = {}
    for name in MACHINES:
        horizon = stored("control_any")[name]["horizon"]
        with scratch() as folder:
            asked_of = machine(name, folder)
            (folder / "asked.json").write_text(json.dumps(days(asked_of, horizon)))
            command = [str(PEERS), str(Path(__file__).with_name("dompc_peer.py")), str(folder / "asked.json")]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
        found[name] = json.loads(done.stdout.splitlines()[-1])
        say(f"{name}: {found[name]}")
    return found


def days(of: Machine, horizon: int) -> dict:
    """What do-mpc is asked: the machine of each day, its loads, and the same limits and weights."""
    limits, cases = of.limits, {}
    for case in (Case.NOMINAL, Case.LOAD):
        day = UnderWay(of, case, 0, len(of.reference))
        cases[case] = {"values": day.model.values, "load": day._load.tolist(), "share": day._share.tolist()}
    return {
        "plant": of.name, "period": of.period, "horizon": horizon, "tracked": list(of.tracked),
        "reference": of.reference.tolist(), "sizes": of.sizes.tolist(), "low": limits.low.tolist(),
        "high": limits.high.tolist(), "rate": limits.rate.tolist(), "bounds": dict(limits.outputs),
        "start": of.model.start.tolist(), "told": of.truth(None).values, "cases": cases,
    }  # fmt: skip


PARTS = {**{name: partial(compared, name) for name in MACHINES}, "peers": peers}
