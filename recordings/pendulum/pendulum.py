"""A pendulum on a motor as a function of Python; the one in run.csv has something more."""

from math import sin

import greygate


def rates(t, x, u, p):
    """d(angle, w)/dt."""
    return x[1], (u[0] - p.damping * x[1] - p.weight * sin(x[0])) / p.inertia


pendulum = greygate.Simulator(
    rates,
    dt=1e-3,
    states={"angle": {"unit": "rad", "rate": "w"}, "w": "rad/s"},
    inputs={"torque": "N m"},
    outputs=["angle"],
    parameters={"inertia": [0.1, "kg m^2"], "damping": [0.2, "N m s/rad", 0.2], "weight": [3.0, "N m", 0.02]},
    storage={"w": "inertia"},
    name="pendulum",
)

if __name__ == "__main__":
    print(greygate.diagnose(pendulum, "run.csv", noise_rms={"angle": 1e-4}))
