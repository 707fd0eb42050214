"""The cable drum's slip, summed along its travel, with a module for the slip that the simulation leaves out.

    d(k) = x(k) - x(k-1)
    slip(k) = slip(k-1) + creep d(k)                    the simulation: creep is what training moves
    slip(k) = slip(k-1) + (creep + g(s(k))) d(k)        g: a network of what the missing slip depends on, v or a

Thesis 7.4.2 without drum angle and beacon. The product is (g + d)^2 / 4 - (g - d)^2 / 4: two neurons whose answers are
equal where d is 0. So nothing creeps at rest, not even in the hardware. The only loop is the integrator, so a free run
cannot diverge.
"""

from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np

from greygate.machines.cable_drum.plant import SAMPLE_TIME
from greygate.mismatch.augmentation import ROOM, Augmentation, Law, grid, port
from greygate.mismatch.rig import Rig
from greygate.models.network import Layer, Network, Port
from greygate.plants.recording import Recording


class Slip(Augmentation):
    """Slip [m], load less drum, from `x_drum`, sampled as the thesis's sensor is.

    A module reads the speed "v" or the acceleration "a" and answers slip per travel.
    """

    needs, inputs, starts = ("x_drum", "x_load"), ("x_drum",), "x_drum"
    effects: ClassVar = {
        "speed_slip": ("slip", "v"),
        "direction_slip": ("slip", "v"),
        "acceleration_slip": ("slip", "a"),
    }
    modules, tied = ("missing",), ()

    def __init__(self, rig: Rig, values: Mapping[str, float]):
        self.every = max(round(SAMPLE_TIME / rig.dt), 1)
        self.rig, self.values, self.period = rig, values, self.every * rig.dt

    def recording(self, recorded: Recording) -> Recording:
        x, load = (recorded[name][:: self.every] for name in ("x_drum", "x_load"))
        return Recording(self.period, {"x_drum": x, "slip": load - x}, {"x_drum": "m", "slip": "m"}, recorded.source)

    def law(self, recorded: Recording, reads: str, term: Callable[..., np.ndarray]) -> Law:
        x = self.recording(recorded)["x_drum"]
        signal = np.diff(x) / self.period if reads == "v" else np.diff(x, 2) / self.period**2
        at = ROOM * np.abs(signal).max() * grid()
        travel = at if reads == "v" else np.ones_like(at)
        return Law(reads, at, term(v=at, a=at, travel=travel) / travel)

    def network(self, recorded: Recording, law: Law | None) -> Network:
        r = self.recording(recorded)
        x, slip = (port(name, r[name], "m", self.rig.channels.get(name)) for name in ("x_drum", "slip"))
        step = ROOM * float(np.abs(np.diff(r["x_drum"])).max())
        missing = None
        if law:
            missing = law.module(), law.reads, law.reach * self.period ** (2 if law.reads == "a" else 1), law.size
        return slip_sum(x, slip, step, self.values["creep"], missing)


def slip_sum(
    position: Port, slip: Port, step: float, creep: float, missing: tuple[Network, str, float, float] | None = None
) -> Network:
    """The network from `position` [m] to `slip` [m], both ports normalised by their scales.

    step: m, the scale of d. creep: m/m, where training starts. missing: (module from port `s` to `y`, reads, reach,
    size): g is size times y, s is d / reach where it reads "v", and d's change / reach where "a".
    """
    network = Network("slip", [position], [slip])
    rate = position.scale / step
    travel = {"now": [[rate]], "before": [[-rate]]}
    network.add("travel", Layer(travel, [0.0], frozen={*travel, "bias"}))
    network.connect(position.name, "travel.now")
    network.connect(position.name, "travel.before", delay=1)
    terms = {"before": [[1.0]], "creep": [[creep * step / slip.scale]]}
    if missing:
        module, reads, reach, size = missing
        quarter = size * step / slip.scale / 4
        terms["missing"] = [[quarter, -quarter]]
    network.add("sum", Layer(terms, [0.0], frozen={*terms, "bias"} - {"creep"}))
    network.connect("sum", "sum.before", delay=1)
    network.connect("travel", "sum.creep")
    if missing:
        network.add("missing", module)
        network.connect("travel", "missing.s", gain=step / reach)
        if reads == "a":
            network.connect("travel", "missing.s", delay=1, gain=-step / reach)
        product = {"g": [[1.0], [1.0]], "d": [[1.0], [-1.0]]}
        network.add("product", Layer(product, np.zeros(2), "square", frozen={*product, "bias"}))
        network.connect("missing", "product.g")
        network.connect("travel", "product.d")
        network.connect("product", "sum.missing")
    network.connect("sum", slip.name)
    return network.check()
