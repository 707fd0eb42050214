"""A quarter of a car on a road whose height is recorded: body and wheel, one on the other."""

import numpy as np
from numba import njit

from ..rig import Sensor, fields, nothing
from .integrate import FINE, Ways, acting, domain, hidden, integrate, kept, lagging, sensor, smooth

STATES = 4
LEAST = 1e-5  # the resolution of the input
SHARP = 2e-3  # m/s: below this speed dry friction is less than it is
ROAD, LAG = 0.02, 20.0  # m RMS, and samples of the lags that make it smooth

PARAMETERS = {"m_body": 300.0, "m_wheel": 40.0, "k_spring": 18000.0, "c_damper": 1200.0, "k_tyre": 180000.0}  # SI
EFFECTS = {
    "dry_friction": hidden("body wheel", "z_body z_wheel v", f_dry=(8.0, 200.0)),
    "hardening_spring": hidden("body wheel", "z_body z_wheel", k_cubic=(2e6, 8e7)),
    "direction_friction": hidden("body wheel", "z_body z_wheel v", signed=True, skew=(40.0, 700.0)),
    "sensor_lag": hidden("z_body", "z_body", lag=(2e-3, 3e-2)),
}
FOREIGN = {"bump_stop": hidden("body wheel", "z_body z_wheel", {"stop_at": (0.005, 0.015)}, stop=(1e4, 1.5e5))}
QuarterCar = fields("QuarterCar", __name__, PARAMETERS)
Effects = nothing("Effects", __name__, EFFECTS | FOREIGN)


@njit(cache=True)
def slopes(s, u, t, p, e, d):
    body, body_speed, wheel, wheel_speed = s[0], s[1], s[2], s[3]
    bent, rate = body - wheel, body_speed - wheel_speed
    strut = p.k_spring * bent + p.c_damper * rate
    strut += e.f_dry * np.tanh(rate / SHARP) + e.k_cubic * bent**3 + e.skew * abs(rate)
    strut += e.stop * np.sign(bent) * max(abs(bent) - e.stop_at, 0.0)
    d[0], d[2] = body_speed, wheel_speed
    d[1] = -strut / p.m_body
    d[3] = (strut + p.k_tyre * (u[0] - wheel)) / p.m_wheel


@kept
def integrated(inputs, begin, dt, p, e):
    return integrate(slopes, inputs, begin, dt, p, e)


def run(road, dt, parameters, extra):
    e = Effects(**extra)
    fine = acting(road, dt, Ways())
    states = integrated(fine[:, None], np.zeros(STATES), dt / FINE, QuarterCar(**parameters), e)[:-1]
    return {"z_body": lagging(states[:, 0], dt / FINE, e.lag)[::FINE], "z_wheel": states[::FINE, 2]}


QUARTER_CAR = domain(
    plant="quarter_car",
    dt=5e-3,
    samples=1200,
    source=Sensor("z_road", "m", "input", resolution=LEAST),
    sensors=(sensor("z_body", "m", 1e-4), sensor("z_wheel", "m", 1e-4)),
    excite=lambda rng, samples: smooth(rng, samples, ROAD, LAG, LEAST),
    run=run,
    parameters=PARAMETERS,
    tolerance={"m_body": 0.05, "k_spring": 0.05, "c_damper": 0.1, "k_tyre": 0.1},
    places={"m_body": ("body",), "k_spring": ("body", "wheel"), "c_damper": ("body", "wheel"), "k_tyre": ("wheel",)},
    effects=EFFECTS,
    foreign=FOREIGN,
)
