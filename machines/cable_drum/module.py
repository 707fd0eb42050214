"""Slip of a line sensor, added up along its travel, with a module for the physics that its simulation leaves out.

    d(k) = x(k) - x(k-1)
    slip(k) = slip(k-1) + creep d(k)                    the simulation: creep is what training moves
    slip(k) = slip(k-1) + (creep + g(s(k))) d(k)        g: a network of what the missing slip depends on, v or a

Thesis 7.4.2 without drum angle and beacon. The product is (g + d)^2 / 4 - (g - d)^2 / 4, two neurons that answer alike
where d is 0: nothing creeps at rest, in the hardware neither, and the only loop is the integrator, so that a free run
cannot diverge.
"""

import numpy as np

from greygate.models.network import Layer, Network, Port


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
