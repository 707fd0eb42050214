"""Position error of a cable-drum sensor from its own encoder: slip of each step, switched off at rest, added up.

    v(k) = x_pe(k) - x_pe(k-1)
    e(k) = e(k-1) + (0 where |v(k)| <= 0.001 mm/s, else slip[x_pe(k), v(k), v(k-1), v(k-2), cos theta, sin theta])
    at home  e(k) = -x_pe(k)

Thesis 7.4.2, figure 7.12. theta is the drum's angle within a turn, whose cosine and sine are library networks; the
detector and both switches are library networks too and become logic. At home, x = 0, the position is known, and so is
the error, whatever slipped before; without a beacon, `home` stays 0. The thesis's x_pe(k-1) and x_pe(k-2) add nothing
to v(k) and v(k-1), so they are left out. The error itself is not among the inputs of `slip`: the only loop is the
integrator, so a free run cannot diverge.
"""

import math
from collections.abc import Sequence

from greygate.models.adaptation import frozen
from greygate.models.families.blocks import feedforward
from greygate.models.families.library import library
from greygate.models.network import Layer, Network, Port

ERROR = Port("e", "m", 1e-3)
ANGLE = Port("theta", "rad", math.pi, resolution=math.pi / 2**14)
HOME = Port("home", "1", 1.0, initial=0.0, resolution=0.5)
FASTEST = 0.15  # m/s, the scale of the speed
AT_REST = 1e-6  # m/s: 0.001 mm/s
REACH = 1000.0  # mm: of the switch in the loop, whose tanh form then forgets 3e-11 of 1 mm in a step
PER_STEP = 0.05  # mm, the scale of slip in a step


def cable_drum(
    position: Port, sample_time: float, hidden: Sequence[int] = (10,), seed: int = 0, switched: bool = True
) -> Network:
    """The SNN. hidden: neurons of `slip`, drawn from `seed`. switched: without detector and switch it drifts at rest.

    position: the port `x_pe` [m]. Inputs `x_pe`, `theta` [rad, -pi to pi], `home` (0 or 1); output `e` [m].
    """
    network = Network("cable_drum", [position, ANGLE, HOME], [ERROR], dt=sample_time)
    rate = position.scale / (sample_time * FASTEST)
    network.add("speed", Layer({"now": [[rate]], "before": [[-rate]]}, [0.0], frozen={"now", "before", "bias"}))
    network.connect("x_pe", "speed.now")
    network.connect("x_pe", "speed.before", delay=1)
    slip = feedforward("slip", ["x", "v0", "v1", "v2", "cos", "sin"], hidden, seed)
    network.add("slip", slip)
    network.connect("x_pe", "slip.x")
    for delay in range(3):
        network.connect("speed", f"slip.v{delay}", delay=delay)
    for name, function in (("cos", "cosine"), ("sin", "sine")):
        network.add(name, frozen(library(function)))
        network.connect("theta", f"{name}.x", gain=math.pi)
        network.connect(name, f"slip.{name}")
    step = "slip"
    if switched:
        step = "moving"
        network.add("at_rest", library("zero_region", threshold=AT_REST / FASTEST))
        network.add("still", Layer({}, [0.0], frozen={"bias"}))
        network.add("moving", library("switch_1"))
        network.connect("speed", "at_rest.x")
        network.connect("at_rest", "moving.s")
        network.connect("still", "moving.u1")
        network.connect("slip", "moving.u2")
    network.add("sum", Layer({"before": [[1.0]], "step": [[PER_STEP]]}, [0.0], frozen={"before", "step", "bias"}))
    network.add("at_home", Layer({"home": [[1.0]]}, [-0.5], "hardlims", frozen={"home", "bias"}))
    network.add("error", library("switch_1", reach=REACH))
    network.connect("error", "sum.before", delay=1)
    network.connect(step, "sum.step")
    network.connect("home", "at_home.home")
    network.connect("at_home", "error.s")
    network.connect("x_pe", "error.u1", gain=-position.scale / ERROR.scale)
    network.connect("sum", "error.u2")
    network.connect("error", "e")
    return network.check()
