"""Two tanks, one after the other, recorded every second."""

import numpy as np
from numba import njit

from ..rig import Sensor, fields, nothing
from .integrate import FINE, Ways, acting, domain, hidden, integrate, kept, sensor, steps

HOLD = (20, 200)  # samples between steps
LEAST = 1e-7  # the resolution of the input
UPPER, LOWER = 0.3, 0.15  # m, at the beginning
INFLOW = (1e-5, 7e-5)  # m^3/s

PARAMETERS = {"area_1": 0.02, "area_2": 0.02, "k_1": 1e-4, "k_2": 1e-4}  # SI
EFFECTS = {
    "leak": hidden("upper", "h_1", k_leak=(2e-6, 6e-5)),
    "input_lag": hidden("q_in", "q_in", lag=(2.0, 40.0)),
    "input_delay": hidden("q_in", "q_in", delay=(2.0, 40.0)),
    "sensor_offset": hidden("h_1", "", signed=True, zero=(2e-3, 5e-2)),
}
FOREIGN = {
    "clogging": hidden("lower", "h_2 t", clogging=(3e-5, 4e-4)),
    "weir": hidden("upper", "h_1", {"weir_at": (0.2, 0.3)}, weir=(2e-5, 4e-4)),
}
Tank = fields("Tank", __name__, PARAMETERS)
Effects = nothing("Effects", __name__, EFFECTS | FOREIGN)


@njit(cache=True)
def slopes(s, u, t, p, e, d):
    upper, lower = max(s[0], 0.0), max(s[1], 0.0)
    between = p.k_1 * np.sign(upper - lower) * np.sqrt(abs(upper - lower))
    out = p.k_2 * np.exp(-e.clogging * t) * np.sqrt(lower)
    lost = e.k_leak * upper + e.weir * max(upper - e.weir_at, 0.0)
    d[0] = (u[0] - between - lost) / p.area_1
    d[1] = (between - out) / p.area_2


@kept
def integrated(inputs, begin, dt, p, e):
    return integrate(slopes, inputs, begin, dt, p, e)


def run(inflow, dt, parameters, extra):
    e = Effects(**extra)
    fine = acting(inflow, dt, Ways(lag=e.lag, delay=e.delay))
    begin = np.array([UPPER, LOWER])
    states = integrated(fine[:, None], begin, dt / FINE, Tank(**parameters), e)
    upper, lower = np.maximum(states[:-1:FINE], 0.0).T
    return {"h_1": upper + e.zero, "h_2": lower}


TANK = domain(
    plant="tank",
    dt=1.0,
    samples=1500,
    source=Sensor("q_in", "m^3/s", "input", resolution=LEAST),
    sensors=(sensor("h_1", "m", 5e-4), sensor("h_2", "m", 5e-4)),
    excite=lambda rng, samples: steps(rng, samples, *INFLOW, HOLD, LEAST),
    run=run,
    parameters=PARAMETERS,
    tolerance={"area_2": 0.03, "k_1": 0.06, "k_2": 0.06},
    places={"area_2": ("lower",), "k_1": ("upper", "lower"), "k_2": ("lower",)},
    effects=EFFECTS,
    foreign=FOREIGN,
)
