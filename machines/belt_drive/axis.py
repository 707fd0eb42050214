"""Position control of the carriage, on the load side, from the motor's encoder.

Model: the motor goes where it is told, x(k) = x(k-1) + T v(k-1), and the trained machine (network.py) says by how much
the carriage stands off.
"""

import numpy as np

from greygate.machines.belt_drive.network import X, X_SCALE
from greygate.machines.belt_drive.plant import ENCODER, SAMPLE_TIME, belt_drive
from greygate.models.network import Layer, Network, Port
from greygate.plants.excitation import band_limited_noise
from greygate.plants.simulate import Stepper

SPEED = Port("v", "m/s", 2.0**-3)


def axis_model(trained: Network) -> Network:
    """Position of the carriage [m] from the speed of the motor alone."""
    network = Network("belt_axis", [SPEED], [Port("carriage", "m", X_SCALE, X.offset)])
    home = -X.offset / X_SCALE
    step = {"before": [[1.0]], "v": [[SAMPLE_TIME * SPEED.scale / X_SCALE]]}
    network.add("place", Layer(step, [0.0], initial=home, frozen={*step, "bias"}))
    network.connect("place", "place.before", delay=1)
    network.connect("v", "place.v", delay=1)
    machine = trained
    network.add("machine", machine)
    network.add("metres", Layer({"x": [[X_SCALE]]}, [X.offset], frozen={"x", "bias"}))
    network.connect("place", "metres.x")
    network.connect("metres", "machine.x")
    off = {"x": [[1.0]], "e": [[1 / X_SCALE]]}
    network.add("load", Layer(off, [0.0], frozen={*off, "bias"}))
    network.connect("place", "load.x")
    network.connect("machine", "load.e")
    network.connect("load", "carriage")
    return network.check()


class BeltRig:
    """The drive of one day under way, at 200 Hz."""

    def __init__(self, day: int, samples: int, slip: float, **values: float):
        rng = np.random.default_rng(1000 + day)
        drawn = {
            "phase": rng.uniform(0, 2 * np.pi), "drift": 3e-6 * rng.normal(),
            "closing": 1 + 0.06 * rng.normal(), "lag": 4e-4 + 4e-5 * rng.normal(),
        }  # fmt: skip
        self.plant = belt_drive(**{**drawn, **values})
        self._stepper = Stepper(self.plant, SAMPLE_TIME)
        self._slip = np.clip(band_limited_noise(samples, slip, 0.02, 0.5, SAMPLE_TIME, seed=2000 + day), -0.6, 0.6)
        self._sample, self._speed = 0, 0.0

    def measured(self):
        return {"x": float(ENCODER * np.round(self._stepper["x"] / ENCODER))}

    def truth(self):
        names = list(self.plant.states)
        signals = {n: np.array([self._stepper[n]]) for n in names} | {"v": np.array([self._speed]), "slip": np.array([self._slip[min(self._sample, len(self._slip)-1)]])}
        e = float(self.plant.values(["e"], signals)["e"][0])
        return {"carriage": self._stepper["x"] + e}

    def actuate(self, value):
        self._speed = value
        self._stepper.step({"v": value, "slip": float(self._slip[self._sample])})
        self._sample += 1
        return value
