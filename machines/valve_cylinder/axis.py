"""Position control of the valve-controlled cylinder: its model of prediction, its rig under way, and what is asked.

Model: the network of the chamber pressures (network.py, with the trained networks of flow and division) joined with
Newton's law. Over an interval T, by the implicit midpoint rule with the oil's stiffness at mid-stroke,

    moved(k) (2 + T^2 A kappa / 2m + T b / m) = 2 v(k-1) T + T^2/m (A (p_a - p_b + charge/2) - load - c x)(k-1)
    x(k) = x(k-1) + moved(k),   v(k) = 2 moved(k) / T - v(k-1),   load(k) = 2 load(k-1) - load(k-2)

kappa = beta A (1/V_a + 1/V_b); `charge`: what the flows of the interval add to p_a - p_b at rest. The rule is stable
although the oil's resonance (256 Hz) lies at half the sampling rate.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from greygate.compiler.quantize import Formats
from greygate.control.imitation import AHEAD, LAST, differences, imitator
from greygate.control.observer import Observer
from greygate.control.pi import Proportional
from greygate.control.prediction import Prediction, hats, knots, online
from greygate.control.predictive import Aim, Limits, Predictive
from greygate.control.stepping import Floating
from greygate.machines.control import Task
from greygate.machines.valve_cylinder.network import (
    POSITION,
    V_SCALE,
    V_STEP,
    VOLTAGE,
    X_SCALE,
    driven_spool,
    valve_srnn,
)
from greygate.machines.valve_cylinder.plant import spool_discrete, valve_cylinder
from greygate.machines.valve_cylinder.scenarios import RESOLUTION, SAMPLE_TIME, converted
from greygate.models.adaptation import adopt
from greygate.models.families.library import library
from greygate.models.network import Layer, Network, Port
from greygate.models.storage import TRAINED
from greygate.plants.excitation import multisine
from greygate.plants.simulator import Stepper

LOAD = 1e4  # N, the scale of the load
BOX = (2e6, 1.8e7)  # Pa


def constants() -> dict[str, float]:
    return {symbol: p.value for symbol, p in valve_cylinder().parameters.items()}


def axis_model(trained: Network, sample_time: float = SAMPLE_TIME) -> Network:
    """Position [m] and chamber pressures [Pa] from the voltage alone. trained: the network of the catalogue."""
    k, plant = constants(), valve_cylinder()
    scale = trained.port("p_a").scale
    rest = plant.initial()["p_a"]
    k |= {"p_s": scale, "p_a_rest": rest, "p_b_rest": rest, "area_a": k["area"], "area_b": k["area"]}
    spool = driven_spool(*spool_discrete(plant, sample_time), k["u_max"])
    pressures = valve_srnn(k, library("flow"), library("divider"), spool, sample_time=sample_time, taps=1)
    pressures = adopt(pressures, trained, ("spool", "qa", "qb", "pa", "pb"))
    pressures.inputs = [Port("v_c"), Port("x")]  # all of it in the units of the joined network
    pressures.outputs = [Port(name) for name in ("p_a", "p_b", "q_a", "q_b")]
    for chamber in "ab":
        pressures.connect(f"q{chamber}", f"q_{chamber}")

    area, mass, t, beta = k["area"], k["mass"], sample_time, k["bulk_modulus"]
    kappa = beta * area * (1 / k["v_a0"] + 1 / k["v_b0"])
    inertia = 2 + t * t * area * kappa / (2 * mass) + t * k["viscous"] / mass
    force = t * t / mass / inertia / X_SCALE
    flow = k["k_valve"] * k["u_max"] * np.sqrt(scale)
    charge = {c: t * beta * flow / k[f"v_{c}0"] for c in "ab"}
    outputs = [Port("x", "m", X_SCALE), Port("p_a", "Pa", scale), Port("p_b", "Pa", scale)]
    network = Network("axis", [VOLTAGE], outputs, dt=sample_time)
    network.add("pressures", pressures)
    weights = {"v": 2 / inertia, "p_a": force * area * scale, "p_b": -force * area * scale}
    weights |= {"q_a": force * area * charge["a"] / 2, "q_b": -force * area * charge["b"] / 2}
    weights |= {"load": -force * LOAD, "x": -force * k["stiffness"] * X_SCALE}

    def known(name: str, **ports: float) -> None:
        network.add(name, Layer({p: [[w]] for p, w in ports.items()}, [0.0], frozen={*ports, "bias"}))

    known("moved", **weights)
    known("v", moved=2.0, before=-1.0)
    known("place", moved=1.0, before=1.0)
    known("load", before=1.0, change=1.0)
    known("load_change", before=1.0)
    network.connect("v_c", "pressures.v_c")
    network.connect("place", "pressures.x")
    for c in "ab":
        network.connect(f"pressures.p_{c}", f"moved.p_{c}", delay=1)
        network.connect(f"pressures.q_{c}", f"moved.q_{c}")
        network.connect(f"pressures.p_{c}", f"p_{c}")
    for name, delay in (("v", 1), ("load", 1)):
        network.connect(name, f"moved.{name}", delay=delay)
    network.connect("place", "moved.x", delay=1)
    network.connect("moved", "v.moved")
    network.connect("v", "v.before", delay=1)
    network.connect("moved", "place.moved")
    network.connect("place", "place.before", delay=1)
    network.connect("load", "load.before", delay=1)
    network.connect("load_change", "load.change", delay=1)
    network.connect("load_change", "load_change.before", delay=1)
    network.connect("place", "x")
    return network.check()


LIMITS = Limits(-V_SCALE, V_SCALE, rate=0.2 * V_SCALE, resolution=V_STEP, outputs={"p_a": BOX, "p_b": BOX})
"""The converter's range, a slew of its amplifier, and pressures clear of cavitation and of the relief valve."""

HORIZON, KNOTS = 30, 8  # steps: five lags of the coil
TRACKING = Aim("x", tolerance=2 * RESOLUTION, smooth=1e-2)
SENSED = {"x": RESOLUTION, "p_a": 1e5, "p_b": 1e5}  # m, Pa: the scale's step, the soft sensor's error with some room
DISTURBED = {
    "load": 10.0 / LOAD,
    "load_change": 5.0 / LOAD,
    "v": 1e-5 / X_SCALE,
    "pressures.pa.state": 2e-3,
    "pressures.pb.state": 2e-3,
}
"""By step: 10 N, and 5 N in its change; 10 um a step in the speed; 2e-3 of the supply's pressure."""

PREVIEW = 24
SEEN = (
    {(AHEAD, PREVIEW): 1.0, ("x", 0): -1.0},
    *differences(AHEAD, [PREVIEW - step for step in (0, 1, 2, 4, 6, 9, 13, 18, 24)]),
    *differences("x", (0, 1, 2, 4, 8, 16)),
    *({("p_a", delay): 1.0, ("p_b", delay): -1.0} for delay in (0, 1, 3, 8, 16)),
    {("p_a", 0): 1.0, ("p_b", 0): 1.0},
    *({(LAST, delay): 1.0} for delay in (0, 1, 2)),
)
"""What the imitating network sees: error, the reference's and the position's motion, load and sum of the pressures, and
the last voltages."""

WHOLE = 5000  # samples, of which a shorter run is the beginning
SPEED, BAND = 0.06, (0.2, 3.0)  # m/s, Hz: of references; 60 % of the speed that the open valve gives
FORCE, FORCES = 3000.0, (0.1, 5.0)  # N, Hz: of the disturbed load, as in the thesis's v2
SAGGED = 30.0  # V, of the pump's motor, which has 240 V


class Predicted:
    """The predictive controller with the soft sensor and the observer that give it its state."""

    def __init__(self, trained: Network):
        model = axis_model(trained)
        self.predictive = Predictive(Prediction(model, "v_c", hats(knots(HORIZON, KNOTS))), TRACKING, LIMITS, every=3)
        self.observer = Observer(model, "v_c", SENSED, DISTURBED)
        self.sensor = Floating(online(trained, "v_c"))
        self.ahead = HORIZON

    def reset(self) -> None:
        for part in (self.predictive, self.observer, self.sensor):
            part.reset()

    def __call__(self, measured: Mapping[str, float], before: float, reference: np.ndarray) -> float:
        self.predictive.applied(before)
        pressures = self.sensor.step({"v_c": before, **measured})
        state = self.observer.corrected(before, {**measured, **pressures})
        return self.predictive(state, reference[1:])


class CylinderRig:
    """The thesis's plant with its full supply under way, at 1 kHz, with its linear scale and its converter."""

    def __init__(self, case: str, seed: int, samples: int):
        """case: "load" adds a random force, "supply" lets the pump's motor sag over the middle third."""
        self.plant = valve_cylinder()
        self._stepper = Stepper(self.plant, SAMPLE_TIME)
        self._force, self._voltage = np.zeros(samples), np.full(samples, self.plant.parameters["voltage"].value)
        if case == "load":
            self._force = multisine(max(samples, WHOLE), FORCE, *FORCES, SAMPLE_TIME, seed)
        if case == "supply":
            self._voltage[samples // 3 : 2 * samples // 3] = SAGGED
        self._sample, self._voltage_now = 0, self._voltage[0]

    def measured(self) -> dict[str, float]:
        return {"x": float(RESOLUTION * np.round(self._stepper["x"] / RESOLUTION))}

    def truth(self) -> dict[str, float]:
        """`power`: W, that the oil of the supply gives; `supply`: Pa, at the pump."""
        now = {n: self._stepper[n] for n in ("x", "p_a", "p_b", "u", "p_pump")}
        return {
            "position": now["x"], "p_a": now["p_a"], "p_b": now["p_b"], "supply": now["p_pump"],
            "power": now["p_pump"] * self._drawn(now),
        }  # fmt: skip

    def _drawn(self, now: Mapping[str, float]) -> float:
        """m^3/s, by the edge of the valve that opens to the supply."""
        pressure = now["p_a"] if now["u"] > 0 else now["p_b"]
        k = self.plant.parameters["k_valve"].value
        return k * abs(now["u"]) * float(np.sqrt(max(now["p_pump"] - pressure, 0.0)))

    def actuate(self, value: float) -> float:
        v_c = float(converted(np.array(value)))
        if self._voltage[self._sample] != self._voltage_now:
            self._voltage_now = self._voltage[self._sample]
            self._stepper.set("voltage", float(self._voltage_now))
        self._stepper.step({"v_c": v_c, "f_ext": float(self._force[self._sample])})
        self._sample += 1
        return v_c


def reference(seed: int, samples: int) -> np.ndarray:
    """Random, of band `BAND` and peak speed `SPEED`, from rest at mid-stroke; m, (samples,)."""
    whole = max(samples, WHOLE)
    ramp = np.clip(np.arange(whole) * SAMPLE_TIME / 0.5, 0, 1)
    path = multisine(whole, 1.0, *BAND, SAMPLE_TIME, seed) * ramp**2 * (3 - 2 * ramp)
    return (path * SPEED * SAMPLE_TIME / np.abs(np.diff(path)).max())[:samples]


def imitating(hidden: int, seed: int) -> Network:
    trained = stored()
    rest = valve_cylinder().initial()["p_a"]
    chambers = [replace(p, initial=rest) for p in trained.outputs]
    ahead = replace(POSITION, name=AHEAD, resolution=X_SCALE * 2.0**-16)
    ports = [ahead, POSITION, *chambers, replace(VOLTAGE, name=LAST)]
    return imitator("valve_cylinder_control", ports, VOLTAGE, LIMITS, SEEN, hidden, seed)


def stored() -> Network:
    """The network of the chamber pressures that is kept in the package."""
    return Network.load(TRAINED / "valve_cylinder")


def position() -> Task:
    """Position of the piston, by valve voltage; the chamber pressures come from the soft sensor."""
    k = constants()
    gain = k["k_valve"] * np.sqrt(k["p_supply"] / 2) * k["k_h"] / k["r_coil"] / k["area"]  # m/s per V, in rest
    return Task(
        name="valve_cylinder",
        title="Valve-controlled cylinder: position by valve voltage; pressures from the soft sensor",
        tracked="position",
        period=SAMPLE_TIME,
        drive="v_c",
        limits=LIMITS,
        preview=PREVIEW,
        reference=reference,
        rig=CylinderRig,
        predictive=lambda: Predicted(stored()),
        first=Proportional("x", LIMITS, SAMPLE_TIME, gain=20 / gain, reset_rate=5.0, forward=1 / gain),
        sensor=lambda: online(stored(), "v_c"),
        sensor_drive="v_c",
        imitator=imitating,
        settle=500,
        samples=WHOLE,
        rounds=3,
        units={"x": "m", "position": "m", "p_a": "Pa", "p_b": "Pa", "supply": "Pa", "v_c": "V"},
        formats=Formats(16, finer=2),
        own_formats=Formats(18),
    )
