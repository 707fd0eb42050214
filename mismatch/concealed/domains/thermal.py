"""A heated block in a jacket that stands in a room, recorded every ten seconds."""

import numpy as np
from numba import njit

from ..rig import Sensor, fields, nothing
from .integrate import FINE, Ways, acting, domain, hidden, integrate, kept, lagging, sensor, steps

HOLD = (20, 150)  # samples between steps
LEAST = 0.1  # the resolution of the input
WATTS = 200.0
KELVIN = 273.15  # of 0 degC
BOLTZMANN = 5.67e-8  # W/(m^2 K^4)
ROOM = 20.0  # degC

PARAMETERS = {"c_block": 800.0, "c_jacket": 1500.0, "g_between": 4.0, "g_loss": 1.5}  # SI and degC
EFFECTS = {
    "leak": hidden("block", "t_block", g_leak=(0.02, 0.6)),
    "input_delay": hidden("power", "power", delay=(10.0, 150.0)),
    "sensor_lag": hidden("t_jacket", "t_jacket", lag=(5.0, 90.0)),
    "sensor_offset": hidden("t_block", "", signed=True, zero=(0.3, 8.0)),
}
FOREIGN = {"radiation": hidden("jacket", "t_jacket", area=(0.02, 0.2))}
Thermal = fields("Thermal", __name__, PARAMETERS)
Effects = nothing("Effects", __name__, EFFECTS | FOREIGN)


@njit(cache=True)
def slopes(s, u, t, p, e, d):
    block, jacket = s[0], s[1]
    across = p.g_between * (block - jacket)
    leak = e.g_leak * (block - ROOM)
    radiated = BOLTZMANN * e.area * ((jacket + KELVIN) ** 4 - (ROOM + KELVIN) ** 4)
    d[0] = (u[0] - across - leak) / p.c_block
    d[1] = (across - p.g_loss * (jacket - ROOM) - radiated) / p.c_jacket


@kept
def integrated(inputs, begin, dt, p, e):
    return integrate(slopes, inputs, begin, dt, p, e)


def run(watts, dt, parameters, extra):
    e = Effects(**extra)
    fine = acting(watts, dt, Ways(delay=e.delay))
    states = integrated(fine[:, None], np.full(2, ROOM), dt / FINE, Thermal(**parameters), e)
    block, jacket = states[:-1].T
    return {"t_block": block[::FINE] + e.zero, "t_jacket": lagging(jacket, dt / FINE, e.lag)[::FINE]}


THERMAL = domain(
    plant="thermal",
    dt=10.0,
    samples=1200,
    source=Sensor("power", "W", "input", resolution=LEAST),
    sensors=(sensor("t_block", "degC", 0.1), sensor("t_jacket", "degC", 0.1)),
    excite=lambda rng, samples: steps(rng, samples, 0.0, WATTS, HOLD, LEAST),
    run=run,
    parameters=PARAMETERS,
    tolerance={"c_jacket": 0.05, "g_between": 0.06, "g_loss": 0.06},
    places={"c_jacket": ("jacket",), "g_between": ("block", "jacket"), "g_loss": ("jacket",)},
    effects=EFFECTS,
    foreign=FOREIGN,
)
