"""A pendulum that a torque turns about its pivot; its angle is measured."""

import numpy as np
from numba import njit

from ..rig import Sensor, fields, nothing
from .integrate import FINE, Ways, acting, domain, hidden, integrate, kept, sensor, steps

NEAR = 0.1  # rad within which the magnet pulls
HOLD = (20, 120)  # samples between steps
LEAST = 1e-4  # the resolution of the input
SHARP = 0.01  # rad/s: below this speed dry friction is less than it is
BREAKAWAY, CREEPING = 0.5, 0.3  # of the variant: what is added to dry friction near rest, and the speed where it ends
TORQUE = 1.2  # N m

PARAMETERS = {"inertia": 0.03, "weight": 1.5, "viscous": 0.05}  # SI
EFFECTS = {
    "dry_friction": hidden("motion", "v", f_dry=(4e-3, 0.12)),
    "square_damping": hidden("motion", "v", c_square=(1e-3, 3e-2)),
    "constant_load": hidden("motion", "", signed=True, load=(4e-3, 0.15)),
    "input_dead_zone": hidden("torque", "torque", dead=(0.01, 0.2)),
}
FOREIGN = {
    "magnet": hidden("motion", "theta", {"magnet_at": (-0.3, 0.3)}, magnet=(0.5, 8.0)),
    "sticky_side": hidden("motion", "theta v", sticky=(0.02, 0.4)),
}
Pendulum = fields("Pendulum", __name__, PARAMETERS)
Effects = nothing("Effects", __name__, EFFECTS | FOREIGN)


@njit(cache=True)
def slopes(s, u, t, p, e, d):
    angle, speed = s[0], s[1]
    friction = e.f_dry * np.tanh(speed / SHARP)
    if e.form:  # variant: more near rest
        friction *= 1 + BREAKAWAY * np.exp(-((speed / CREEPING) ** 2))
    friction += e.c_square * speed * abs(speed) + e.sticky * speed * max(angle, 0.0)
    pulled = e.magnet * (angle - e.magnet_at) * np.exp(-(((angle - e.magnet_at) / NEAR) ** 2))
    d[0] = speed
    d[1] = (u[0] - p.weight * np.sin(angle) - p.viscous * speed - friction - e.load - pulled) / p.inertia


@kept
def integrated(inputs, begin, dt, p, e):
    return integrate(slopes, inputs, begin, dt, p, e)


def run(torque, dt, parameters, extra):
    e = Effects(**extra)
    fine = acting(torque, dt, Ways(dead=e.dead))
    states = integrated(fine[:, None], np.zeros(2), dt / FINE, Pendulum(**parameters), e)
    return {"theta": states[:-1:FINE, 0]}


PENDULUM = domain(
    plant="pendulum",
    dt=5e-3,
    samples=1200,
    source=Sensor("torque", "N m", "input", resolution=LEAST),
    sensors=(sensor("theta", "rad", 5e-4),),
    excite=lambda rng, samples: steps(rng, samples, -TORQUE, TORQUE, HOLD, LEAST),
    run=run,
    parameters=PARAMETERS,
    tolerance={"inertia": 0.05, "weight": 0.03, "viscous": 0.2},
    places={"inertia": ("motion",), "weight": ("motion",), "viscous": ("motion",)},
    effects=EFFECTS,
    foreign=FOREIGN,
    alike=(frozenset({"constant_load", "input_offset"}),),
)
