"""The chamber pressures of the valve-controlled cylinder, with a module for a leakage (mismatch/augment.py)."""

from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np

from greygate.machines.valve_cylinder.network import driven_spool, valve_srnn
from greygate.machines.valve_cylinder.plant import spool_discrete
from greygate.mismatch.augmentation import ROOM, Augmentation, Law, grid, port
from greygate.mismatch.rig import Rig
from greygate.models.adaptation import frozen
from greygate.models.families.library import library
from greygate.models.network import Layer, Network
from greygate.plants.recording import Recording


class Pressures(Augmentation):
    """Chamber pressures [Pa] from `v_c` and `x`; training does not change the known parts.

    A module reads the pressure difference "between" the chambers, or a chamber's own pressure, "outward", and answers
    the leakage in m^3/s.
    """

    needs, inputs, starts = ("v_c", "x", "p_a", "p_b"), ("v_c", "x"), "x"
    effects: ClassVar = {
        "internal_leakage": ("continuity_a", "between"),
        "external_leakage": ("continuity_a", "outward"),
    }
    modules = ("leak", "leak_a", "leak_b")
    tied = (("qa.gain.q", "qb.gain.q"), *((f"speed_a.d{n}", f"speed_b.d{n}") for n in range(4)))

    def __init__(self, rig: Rig, values: Mapping[str, float]):
        self.rig, self.values, self.period = rig, values, rig.dt

    def recording(self, recorded: Recording) -> Recording:
        units = {n: self.rig.channels[n].unit for n in self.needs}
        return Recording(self.period, {n: recorded[n] for n in self.needs}, units, recorded.source)

    def law(self, recorded: Recording, reads: str, term: Callable[..., np.ndarray]) -> Law:
        p_a, p_b = recorded["p_a"], recorded["p_b"]
        if reads == "between":
            at = ROOM * np.abs(p_a - p_b).max() * grid()
        else:
            at = ROOM * max(p_a.max(), p_b.max()) * (1 + grid()) / 2
        return Law(reads, at, -term(p_a=at, p_b=np.zeros_like(at)))

    def network(self, recorded: Recording, law: Law | None) -> Network:
        k = dict(self.values)
        k |= {"p_s": k["p_supply"], "p_a_rest": k["p_supply"] / 2, "p_b_rest": k["p_supply"] / 2}
        k |= {"area_a": k["area"], "area_b": k["area"], "q_max": k["k_valve"] * k["u_max"] * np.sqrt(k["p_supply"])}
        v_c, x = (port(n, recorded[n], self.rig.channels[n].unit, self.rig.channels[n]) for n in ("v_c", "x"))
        plant = self.rig.plant.with_parameters(
            **{s: v for s, v in self.values.items() if s in self.rig.plant.parameters}
        )
        spool = driven_spool(*spool_discrete(plant, self.period), k["u_max"], v_c.scale)
        flow, divider = _scaled(library("flow")), _scaled(library("divider"))
        leakage = (law.module(), law.reads, law.reach, law.size / k["q_max"]) if law else None
        return valve_srnn(k, flow, divider, spool, v_c, x, self.period, leakage=leakage)


def _scaled(network: Network) -> Network:
    """A frozen library network whose answer is multiplied by a trained gain."""
    scaled = Network(network.name, network.inputs, network.outputs)
    scaled.add("known", frozen(network))
    scaled.add("gain", Layer({"q": [[1.0]]}, [0.0], frozen={"bias"}))
    for given in network.inputs:
        scaled.connect(given.name, f"known.{given.name}")
    scaled.connect("known", "gain.q")
    scaled.connect("gain", network.outputs[0].name)
    return scaled
