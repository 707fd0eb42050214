"""Two tanks one above the other, with overflow: levels as integrators, what is not known as small tanh networks.

    f1(k) = x1(k-1) + b u(k-1) - c1 q1(x1(k-1)) + d1                         x1 = min(max(f1, 0), 1)
    f2(k) = x2(k-1) + a q1(x1(k-1-delay)) - c2 q2(x2(k-1)) + s (f1 - x1) + r(x1(k-1), x2(k-1)) + d2
    y = x2 = min(max(f2, 0), 1)

x1, x2: levels, 1 where a tank is full. What the upper tank cannot hold, f1 - x1, spills, a share s of it into the lower
one. q1, q2 start as square roots (Torricelli). Equations of the plant: Schoukens, Mattson, Wigren, Noel, "Cascaded
tanks benchmark combining soft and hard nonlinearities", 2016; Rogers et al. 2017 for the overflow.
"""

import numpy as np

from greygate.models.blocks import feedforward
from greygate.models.network import Layer, Network, Port
from greygate.models.problem import Record
from greygate.models.training import train

PUMP = Port("u", "V", 10.0, initial=3.2567)  # the pump's rest: what the training record begins with
LEVEL = Port("y", "V", 10.0)  # of the sensor, which ends where the lower tank is full
HALF = 0.5  # levels before the first step, until they are estimated


def tanks(seed: int, exchange: int = 2, delay: int = 0, outflow: int = 3) -> Network:
    """The start that `seed` draws. exchange: neurons of r, 0 for none; outflow: neurons of q1 and q2 each.

    delay: steps that the water takes from the upper tank to the lower one.
    """
    rng = np.random.default_rng(seed)
    rate = 0.08 * np.exp(0.3 * rng.normal())  # share of a full tank that leaves it in a step
    network = Network("tanks", [PUMP], [LEVEL])
    network.add("upper_outflow", square_root(outflow, seed))
    network.add("lower_outflow", square_root(outflow, seed + 1000))
    weights = {"level": [[1.0]], "pump": [[2.2 * rate]], "outflow": [[-rate]]}
    network.add("upper_fill", Layer(weights, [0.0], initial=HALF, frozen={"level"}))
    network.add("upper", Layer({"fill": [[1.0]]}, [0.0], "satlin", HALF, {"fill", "bias"}))
    network.add("spill", Layer({"fill": [[1.0]], "level": [[-1.0]]}, [0.0], frozen={"fill", "level", "bias"}))
    weights = {"level": [[1.0]], "inflow": [[rate]], "outflow": [[-rate]], "spill": [[0.3]]}
    if exchange:
        drawn = {"upper": rng.normal(size=(exchange, 1)), "lower": rng.normal(size=(exchange, 1))}
        network.add("exchange", Layer(drawn, rng.normal(size=exchange), "tansig"))
        network.connect("upper", "exchange.upper", delay=1)
        network.connect("lower", "exchange.lower", delay=1)
        weights["exchange"] = 0.005 * rng.normal(size=(1, exchange))
        network.connect("exchange", "lower_fill.exchange")
    network.add("lower_fill", Layer(weights, [0.0], initial=HALF, frozen={"level"}))
    network.add("lower", Layer({"fill": [[1.0]]}, [0.0], "satlin", HALF, {"fill", "bias"}))
    network.connect(PUMP.name, "upper_fill.pump", delay=1)
    for tank in ("upper", "lower"):
        network.connect(tank, f"{tank}_outflow.x", delay=1)
        network.connect(tank, f"{tank}_fill.level", delay=1)
        network.connect(f"{tank}_outflow", f"{tank}_fill.outflow")
        network.connect(f"{tank}_fill", f"{tank}.fill")
    network.connect("upper_fill", "spill.fill")
    network.connect("upper", "spill.level")
    network.connect("upper_outflow", "lower_fill.inflow", delay=delay)
    network.connect("spill", "lower_fill.spill")
    network.connect("lower", LEVEL.name)
    return network.check()


def square_root(neurons: int, seed: int) -> Network:
    """y = sqrt(x) over a tank's range, as a network that training may bend further."""
    x = np.linspace(0.02, 1.2, 200)
    start = feedforward("outflow", ["x"], [neurons], seed)
    return train(start, [Record({"x": x}, {"y": np.sqrt(x)})], epochs=300, decay=1e-6).network
