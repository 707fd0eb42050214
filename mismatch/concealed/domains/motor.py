"""DC motor of which only the speed is measured."""

import numpy as np
from numba import njit

from ..rig import Sensor, fields, nothing
from .integrate import FINE, Ways, acting, domain, hidden, integrate, kept, sensor, steps

HOLD = (20, 150)  # samples between steps
LEAST = 1e-3  # the resolution of the input
SHARP = 0.2  # rad/s: below this speed dry friction is less than it is
BREAKAWAY, CREEPING = 0.5, 6.0  # of the variant: what is added to dry friction near rest, and the speed where it ends
VOLTS = 6.0

PARAMETERS = {"inertia": 2e-4, "viscous": 1e-4, "resistance": 1.2, "inductance": 3e-3, "k_motor": 0.05}  # SI
EFFECTS = {
    "dry_friction": hidden("motion", "omega", f_dry=(3e-3, 4e-2)),
    "square_damping": hidden("motion", "omega", c_square=(4e-7, 4e-6)),
    "constant_load": hidden("motion", "", signed=True, load=(2e-3, 3e-2)),
    "input_dead_zone": hidden("u", "u", dead=(0.05, 0.6)),
    "input_delay": hidden("u", "u", delay=(2e-3, 2e-2)),
}
FOREIGN = {"iron_saturation": hidden("motion coil", "omega u", saturating=(0.01, 0.15))}
Motor = fields("Motor", __name__, PARAMETERS)
Effects = nothing("Effects", __name__, EFFECTS | FOREIGN)


@njit(cache=True)
def slopes(s, u, t, p, e, d):
    current, speed = s[0], s[1]
    k = p.k_motor / (1 + e.saturating * current * current)
    friction = e.f_dry * np.tanh(speed / SHARP)
    if e.form:  # variant: more near rest
        friction *= 1 + BREAKAWAY * np.exp(-((speed / CREEPING) ** 2))
    d[0] = (u[0] - p.resistance * current - k * speed) / p.inductance
    d[1] = (k * current - p.viscous * speed - friction - e.c_square * speed * abs(speed) - e.load) / p.inertia


@kept
def integrated(inputs, begin, dt, p, e):
    return integrate(slopes, inputs, begin, dt, p, e)


def run(volts, dt, parameters, extra):
    e = Effects(**extra)
    fine = acting(volts, dt, Ways(dead=e.dead, delay=e.delay))
    states = integrated(fine[:, None], np.zeros(2), dt / FINE, Motor(**parameters), e)
    return {"omega": states[:-1:FINE, 1]}


MOTOR = domain(
    plant="motor",
    dt=2e-3,
    samples=2400,
    source=Sensor("u", "V", "input", resolution=LEAST),
    sensors=(sensor("omega", "rad/s", 0.3),),
    excite=lambda rng, samples: steps(rng, samples, -VOLTS, VOLTS, HOLD, LEAST),
    run=run,
    parameters=PARAMETERS,
    tolerance={"inertia": 0.06, "viscous": 0.2, "k_motor": 0.03},
    places={"inertia": ("motion",), "viscous": ("motion",), "k_motor": ("motion", "coil")},
    effects=EFFECTS,
    foreign=FOREIGN,
    same=(frozenset({"dry_friction", "input_dead_zone"}),),
    alike=(frozenset({"constant_load", "input_offset"}),),
)
