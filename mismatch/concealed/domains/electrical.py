"""Two resistors and two capacitors as a low pass, recorded at 100 kHz."""

import numpy as np
from numba import njit

from ..rig import Sensor, fields, nothing
from .integrate import FINE, Ways, acting, domain, hidden, integrate, kept, sensor, steps

HOLD = (10, 80)  # samples between steps
LEAST = 1e-3  # the resolution of the input
VOLTS = 5.0

PARAMETERS = {"r_1": 1000.0, "r_2": 2000.0, "c_1": 1e-7, "c_2": 5e-8}  # SI
EFFECTS = {
    "leak": hidden("second", "v_2", g_leak=(1e-6, 1e-4)),
    "input_offset": hidden("u", "", signed=True, offset=(5e-3, 0.5)),
    "input_lag": hidden("u", "u", lag=(1e-6, 4e-5)),
    "sensor_saturation": hidden("v_2", "v_2", {"top": (1.2, 2.8)}),
}
FOREIGN = {"diode": hidden("second", "v_2", {"v_on": (0.4, 0.9)}, g_diode=(1e-5, 1e-3))}
Electrical = fields("Electrical", __name__, PARAMETERS)
Effects = nothing("Effects", __name__, EFFECTS | FOREIGN)


@njit(cache=True)
def slopes(s, u, t, p, e, d):
    first, second = s[0], s[1]
    across = (first - second) / p.r_2
    d[0] = ((u[0] - first) / p.r_1 - across) / p.c_1
    d[1] = (across - e.g_leak * second - e.g_diode * max(second - e.v_on, 0.0)) / p.c_2


@kept
def integrated(inputs, begin, dt, p, e):
    return integrate(slopes, inputs, begin, dt, p, e)


def run(volts, dt, parameters, extra):
    e = Effects(**extra)
    fine = acting(volts, dt, Ways(offset=e.offset, lag=e.lag))
    states = integrated(fine[:, None], np.zeros(2), dt / FINE, Electrical(**parameters), e)
    first, second = states[:-1:FINE].T
    return {"v_1": first, "v_2": np.minimum(second, e.top) if e.top else second}


ELECTRICAL = domain(
    plant="electrical",
    dt=1e-5,
    samples=1500,
    source=Sensor("u", "V", "input", resolution=LEAST),
    sensors=(sensor("v_1", "V", 2e-3), sensor("v_2", "V", 2e-3)),
    excite=lambda rng, samples: steps(rng, samples, -VOLTS, VOLTS, HOLD, LEAST),
    run=run,
    parameters=PARAMETERS,
    tolerance={"r_2": 0.05, "c_1": 0.1, "c_2": 0.1},
    places={"r_2": ("first", "second"), "c_1": ("first",), "c_2": ("second",)},
    effects=EFFECTS,
    foreign=FOREIGN,
)
