"""Two tanks one above the other, with overflow: Torricelli's lower tank under an upper one that empties linearly.

    f1(k) = x1(k-1) + b u(k-1) - c1 x1(k-1) + d                                      x1 = min(max(f1, 0), 1)
    f2(k) = x2(k-1) + a x1(k-1-delay) - c2 sqrt(h(k-1) - h0) + s max(f1 - 1 - e, 0)  x2 = min(max(f2, 0), 1)
    y = h = x2 + q (x2^2 - x2)

x1, x2: water in a tank, 1 where it is full. d: dead band of the pump. When the upper tank is full, its rim holds back e
of the surplus, and a share s of the rest falls into the lower one. h: level at the sensor; h0: the level of the empty
lower tank. With q > 0 the lower tank is narrower above. The training run shows that the upper outflow is not a square
root.
Equations of the plant: Schoukens, Mattson, Wigren, Noel, "Cascaded tanks benchmark combining soft and hard
nonlinearities", 2016; Rogers et al. 2017 for the overflow.
"""

import numpy as np
from numpy.typing import ArrayLike

from greygate.models.adaptation import frozen
from greygate.models.families.blocks import feedforward
from greygate.models.network import Layer, Network, Port
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record

PUMP = Port("u", "V", 10.0, initial=3.2567)  # initial: the first value of the training record
LEVEL = Port("y", "V", 10.0)  # of the sensor, whose range ends where the lower tank is full
HALF = 0.5  # content of a tank before the first step, until it is estimated
MEAN = 2.8  # V, of the pump over the training record
RATE = 0.03  # share of a full tank that leaves it in a step
EMPTY = 0.29  # the lowest level on record


def tanks(seed: int, rim: bool = True, widening: bool = True, exchange: int = 0, delay: int = 1) -> Network:
    """The start whose pump gain `seed` draws; at the mean of the pump the upper tank stays half full.

    rim, widening: whether e and q are trained, else they are 0. exchange: tanh neurons of a correction
    r(x1(k-1), x2(k-1)) of f2. delay: steps that the water takes from the upper tank to the lower one.
    """
    rng = np.random.default_rng(seed)
    pump = 0.2 * np.exp(0.3 * rng.normal())
    network = Network("tanks", [PUMP], [LEVEL])
    weights = {"level": [[1.0]], "pump": [[pump]], "outflow": [[-RATE]]}
    network.add("upper_fill", Layer(weights, [_dead(pump, RATE)], initial=HALF, frozen={"level"}))
    network.add("upper", Layer({"fill": [[1.0]]}, [0.0], "satlin", HALF, {"fill", "bias"}))
    kept = {"fill"} if rim else {"fill", "bias"}
    network.add("spill", Layer({"fill": [[1.0]]}, [-1.0 - 0.005 * rim], "satlin", frozen=kept))
    filling: dict[str, ArrayLike] = {"level": [[1.0]], "inflow": [[RATE]], "outflow": [[-RATE]], "spill": [[0.5]]}
    if exchange:
        drawn = {"upper": rng.normal(size=(exchange, 1)), "lower": rng.normal(size=(exchange, 1))}
        network.add("exchange", Layer(drawn, rng.normal(size=exchange), "tansig"))
        network.connect("upper", "exchange.upper", delay=1)
        network.connect("lower", "exchange.lower", delay=1)
        filling["exchange"] = 0.002 * rng.normal(size=(1, exchange))
        network.connect("exchange", "lower_fill.exchange")
    network.add("lower_fill", Layer(filling, [0.0], initial=HALF, frozen={"level", "bias"}))
    network.add("lower", Layer({"fill": [[1.0]]}, [0.0], "satlin", HALF, {"fill", "bias"}))
    level = "lower"
    if widening:
        level = "level"
        network.add("square", Layer({"x": [[1.0]]}, [-0.5], "square", frozen={"x", "bias"}))
        network.add("bend", Layer({"square": [[1.0]]}, [-0.25], frozen={"square", "bias"}))
        network.add("level", Layer({"x": [[1.0]], "bend": [[0.5]]}, [0.0], initial=HALF, frozen={"x", "bias"}))
        network.connect("lower", "square.x")
        network.connect("square", "bend.square")
        network.connect("lower", "level.x")
        network.connect("bend", "level.bend")
    network.add("head", Layer({"level": [[1.0]]}, [-EMPTY], frozen={"level"}))
    network.add("root", square_root())
    network.connect(PUMP.name, "upper_fill.pump", delay=1)
    network.connect("upper", "upper_fill.level", delay=1)
    network.connect("upper", "upper_fill.outflow", delay=1)
    network.connect("upper_fill", "upper.fill")
    network.connect("upper_fill", "spill.fill")
    network.connect("upper", "lower_fill.inflow", delay=1 + delay)
    network.connect("spill", "lower_fill.spill")
    network.connect(level, "head.level", delay=1)
    network.connect("head", "root.x")
    network.connect("root", "lower_fill.outflow")
    network.connect("lower", "lower_fill.level", delay=1)
    network.connect("lower_fill", "lower.fill")
    network.connect(level, LEVEL.name)
    return network.check()


def pumped(network: Network, factor: float) -> Network:
    """The same network with `factor` times the pump gain; the tank is again half full at the mean of the pump."""
    values = network.parameters()
    pump, outflow = factor * values["upper_fill.pump"], -values["upper_fill.outflow"]
    return network.with_parameters({"upper_fill.pump": pump, "upper_fill.bias": _dead(pump, outflow)[0]})


def _dead(pump, outflow):
    return outflow * HALF - pump * MEAN / PUMP.scale


def square_root(neurons: int = 3) -> Network:
    """y = sqrt(x) for x from 0.02 to 1.2, frozen; below it falls to 0.08 at 0 without becoming steep."""
    x = np.linspace(0.02, 1.2, 200)
    start = feedforward("root", ["x"], [neurons], 0)
    return frozen(train(start, [Record({"x": x}, {"y": np.sqrt(x)})], epochs=300, decay=1e-6).network.flatten())
