"""Position control of the valve-controlled cylinder: its model of prediction, its rig under way, and what is asked.

Model: the network of the chamber pressures (network.py, with the trained networks of flow and division) joined with
Newton's law. Over an interval T, by the implicit midpoint rule with the oil's stiffness at mid-stroke,

    moved(k) (2 + T^2 A kappa / 2m + T b / m) = 2 v(k-1) T + T^2/m (A (p_a - p_b + charge/2) - load - c x)(k-1)
    x(k) = x(k-1) + moved(k),   v(k) = 2 moved(k) / T - v(k-1),   load(k) = load(k-1)

kappa = beta A (1/V_a + 1/V_b); `charge`: what the flows of the interval add to p_a - p_b at rest. The rule is stable
although the oil's resonance (256 Hz) lies at half the sampling rate.
"""

import numpy as np

from greygate.machines.valve_cylinder.network import VOLTAGE, X_SCALE, driven_spool, valve_srnn
from greygate.machines.valve_cylinder.plant import spool_discrete, valve_cylinder
from greygate.machines.valve_cylinder.scenarios import RESOLUTION, SAMPLE_TIME, converted
from greygate.models.adaptation import adopt
from greygate.models.families.library import library
from greygate.models.network import Layer, Network, Port
from greygate.plants.simulate import Stepper

LOAD = 1e4  # N, the scale of the load


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
    network = Network(
        "axis", [VOLTAGE], [Port("x", "m", X_SCALE), Port("p_a", "Pa", scale), Port("p_b", "Pa", scale)]
    )
    network.add("pressures", pressures)
    weights = {"v": 2 / inertia, "p_a": force * area * scale, "p_b": -force * area * scale}
    weights |= {"q_a": force * area * charge["a"] / 2, "q_b": -force * area * charge["b"] / 2}
    weights |= {"load": -force * LOAD, "x": -force * k["stiffness"] * X_SCALE}

    def known(name: str, **ports: float) -> None:
        network.add(name, Layer({p: [[w]] for p, w in ports.items()}, [0.0], frozen={*ports, "bias"}))

    known("moved", **weights)
    known("v", moved=2.0, before=-1.0)
    known("place", moved=1.0, before=1.0)
    known("load", before=1.0)
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
    network.connect("place", "x")
    return network.check()


class CylinderRig:
    """The thesis's plant with its full supply under way, at 1 kHz, with its linear scale and its converter."""

    def __init__(self, load: np.ndarray | None = None, voltage: np.ndarray | None = None, **values: float):
        """load: N, (samples,), against extension. voltage: V, (samples,), of the pump's motor where it sags."""
        self.plant = valve_cylinder(**values)
        self._stepper = Stepper(self.plant, SAMPLE_TIME)
        self._load, self._voltage, self._sample, self._before = load, voltage, 0, 0.0

    def measured(self) -> dict[str, float]:
        return {"x": float(RESOLUTION * np.round(self._stepper["x"] / RESOLUTION))}

    def truth(self) -> dict[str, float]:
        now = {n: self._stepper[n] for n in ("x", "p_a", "p_b")}
        return {"position": now["x"], "p_a": now["p_a"], "p_b": now["p_b"]}

    def actuate(self, value: float) -> float:
        v_c = float(converted(np.array(value)))
        if self._voltage is not None:
            self._stepper.set("voltage", float(self._voltage[self._sample]))
        f_ext = 0.0 if self._load is None else float(self._load[self._sample])
        self._stepper.step({"v_c": v_c, "f_ext": f_ext})
        self._sample += 1
        return v_c
