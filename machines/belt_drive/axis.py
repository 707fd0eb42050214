"""Position control of the carriage, on the load side, from the motor's encoder.

Model: the motor goes where it is told, x(k) = x(k-1) + T v(k-1), and the trained machine (network.py) says by how much
the carriage stands off. Inside the play the carriage does not move whatever the motor does, so a linearised model would
see no way out of it; there the model lets the carriage creep by the share `CREEP` of the motor's motion, and takes that
back where the play is crossed.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from greygate.compiler.quantize import Formats
from greygate.control.imitation import AHEAD, LAST, differences, imitator
from greygate.control.pi import Proportional
from greygate.control.prediction import Prediction, hats, knots
from greygate.control.predictive import Aim, Limits, Predictive
from greygate.control.stepping import Floating
from greygate.machines.belt_drive.network import X_SCALE, E, X
from greygate.machines.belt_drive.plant import ENCODER, PLANT, SAMPLE_TIME, SLIP, belt_drive
from greygate.machines.control import Task
from greygate.models.network import Layer, Network, Port
from greygate.models.storage import TRAINED
from greygate.plants.excitation import band_limited_noise
from greygate.plants.simulator import Stepper

SPEED = Port("v", "m/s", 2.0**-3)
CREEP = 0.1  # 0.3 leads out of the play as well


def axis_model(trained: Network) -> Network:
    """Position of the carriage [m] from the speed of the motor alone."""
    network = Network("belt_axis", [SPEED], [Port("carriage", "m", X_SCALE, X.offset)], dt=SAMPLE_TIME)
    home = -X.offset / X_SCALE
    step = {"before": [[1.0]], "v": [[SAMPLE_TIME * SPEED.scale / X_SCALE]]}
    network.add("place", Layer(step, [0.0], initial=home, frozen={*step, "bias"}))
    network.connect("place", "place.before", delay=1)
    network.connect("v", "place.v", delay=1)
    shown = trained.modules["shown"]
    assert isinstance(shown, Layer)
    weights = shown.weights | {"behind": (1 - CREEP) * shown.weights["behind"]}
    creeping = Layer(weights, shown.bias, shown.activation, shown.initial, shown.frozen)
    modules = trained.modules | {"shown": creeping}
    machine = replace(trained, inputs=[Port("x")], outputs=[Port("e")], modules=modules)  # as normalised as it is
    network.add("machine", machine)
    network.connect("place", "machine.x")
    off = {"x": [[1.0]], "e": [[E.scale / X_SCALE]]}
    network.add("load", Layer(off, [0.0], frozen={*off, "bias"}))
    network.connect("place", "load.x")
    network.connect("machine", "load.e")
    network.connect("load", "carriage")
    return network.check()


LIMITS = Limits(-0.1, 0.1, rate=0.01)  # m/s, m/s in a sample: 2 m/s^2
HORIZON, KNOTS = 16, 6  # steps
TRACKING = Aim("carriage", tolerance=ENCODER, smooth=1e-2)
PREVIEW = 12
SEEN = (
    {(AHEAD, PREVIEW): 1.0, ("x", 0): -1.0, ("e", 0): -1.0},
    *differences(AHEAD, [PREVIEW - step for step in (0, 1, 2, 3, 5, 8, 12)]),
    *differences("x", (0, 1, 2)),
    {("e", 0): 1.0},
    {("e", 0): 1.0, ("e", 1): -1.0},
    *({(LAST, delay): 1.0} for delay in (0, 1)),
)
"""What the imitating network sees: error on the load side, the motion of reference and encoder, how far the carriage
stands off, and the last speeds."""

SPEEDS, TURNS, RESTS = (0.02, 0.06), (0.02, 0.28), (20, 60)  # m/s, m, samples: of references
RAMP = 0.15  # s, in which a leg comes to its speed
WHOLE = 4000  # samples, of which a shorter run is the beginning
CALM, ROUGH = SLIP, 2 * SLIP  # RMS variation of the slip
LOOSER = 1.15  # closing distances of the belt that is loaded
SAGGED = 0.9  # of the speed that it is told, a drive of low supply reaches


class Predicted:
    """The predictive controller; the trained machine on the encoder gives it its state."""

    def __init__(self, trained: Network):
        prediction = Prediction(axis_model(trained), "v", hats(knots(HORIZON, KNOTS)))
        self.predictive = Predictive(prediction, TRACKING, LIMITS)
        self.machine = Floating(trained)
        self.ahead = HORIZON

    def reset(self) -> None:
        self.predictive.reset()
        self.machine.reset()

    def __call__(self, measured: Mapping[str, float], before: float, reference: np.ndarray) -> float:
        self.predictive.applied(before)
        self.machine.step(measured)
        state = {f"machine.{name}": past for name, past in self.machine.state().items()}
        state["place"] = np.array([[X.normalised(measured["x"])]])
        return self.predictive(state, reference[1:])


class BeltRig:
    """The drive of one day under way, at 200 Hz."""

    def __init__(self, case: str, seed: int, samples: int):
        """case: "load" doubles the variation of the slip and loosens the belt, "supply" lets the motor reach only a
        share of its speed over the middle third."""
        rng = np.random.default_rng(seed)
        plant = belt_drive(
            phase=rng.uniform(0, 2 * np.pi),
            drift=3e-6 * rng.normal(),
            closing=(1 + 0.06 * rng.normal()) * (LOOSER if case == "load" else 1.0),
            viscous=PLANT.parameters["viscous"].value * (1 + 0.1 * rng.normal()),
        )
        self._stepper = Stepper(plant, SAMPLE_TIME)
        rough = ROUGH if case == "load" else CALM
        self._slip = np.clip(
            band_limited_noise(max(samples, WHOLE), rough, 0.02, 0.5, SAMPLE_TIME, seed=seed), -0.6, 0.6
        )
        self._share = np.ones(samples)
        if case == "supply":
            self._share[samples // 3 : 2 * samples // 3] = SAGGED
        self._sample, self._speed = 0, 0.0

    def measured(self) -> dict[str, float]:
        return {"x": float(ENCODER * np.round(self._stepper["x"] / ENCODER))}

    def truth(self) -> dict[str, float]:
        plant = self._stepper.plant
        now = {n: np.array([self._stepper[n]]) for n in plant.states} | {"v": np.array([self._speed])}
        now["slip"] = self._slip[self._sample : self._sample + 1]
        return {"carriage": self._stepper["x"] + float(plant.values(["e"], now)["e"][0])}

    def actuate(self, value: float) -> float:
        self._speed = value * float(self._share[self._sample])
        self._stepper.step({"v": self._speed, "slip": float(self._slip[self._sample])})
        self._sample += 1
        return value


def reference(seed: int, samples: int) -> np.ndarray:
    """From place to place and rest, each place and speed drawn; m, (samples,)."""
    rng, at = np.random.default_rng(seed), 0.0
    path = [0.0] * RESTS[1]
    while len(path) < samples:
        to, speed = rng.uniform(*TURNS), rng.uniform(*SPEEDS)
        steps = max(round((abs(to - at) / speed + RAMP) / SAMPLE_TIME), round(2 * RAMP / SAMPLE_TIME))
        t = (np.arange(steps) + 0.5) / steps
        edge = np.minimum(np.minimum(t, 1 - t) * steps * SAMPLE_TIME / RAMP, 1.0)
        shape = np.sin(np.pi / 2 * edge) ** 2
        path += [*(at + (to - at) * np.cumsum(shape) / shape.sum()), *[to] * int(rng.integers(*RESTS))]
        at = to
    return np.array(path[:samples])


def imitating(hidden: int, seed: int) -> Network:
    ports = [replace(X, name=AHEAD, resolution=X_SCALE * 2.0**-16), X, stored().outputs[0], replace(SPEED, name=LAST)]
    return imitator("belt_drive_control", ports, SPEED, LIMITS, SEEN, hidden, seed)


def stored() -> Network:
    """The machine of experts that is kept in the package."""
    return Network.load(TRAINED / "belt_drive")


def position() -> Task:
    """Position of the carriage, by the speed of the motor; what the belt gives way comes from the trained machine."""
    return Task(
        name="belt_drive",
        title="Timing-belt drive: position of the carriage by the motor's speed, from the motor's encoder",
        tracked="carriage",
        period=SAMPLE_TIME,
        drive="v",
        limits=LIMITS,
        preview=PREVIEW,
        reference=reference,
        rig=BeltRig,
        predictive=lambda: Predicted(stored()),
        first=Proportional("x", LIMITS, SAMPLE_TIME, gain=20.0, reset_rate=0.1, forward=1.0),
        sensor=stored,
        sensor_drive="",
        imitator=imitating,
        own_formats=Formats(18, finer=2),
        settle=100,
        samples=WHOLE,
        rounds=4,
        units={"x": "m", "carriage": "m", "v": "m/s"},
    )
