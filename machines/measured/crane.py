"""The arm of a crane on a hydraulic cylinder: valve, oil and load, with only the oil's pressure measured.

    s(k) = c s(k-1) + d u(k - delay)               valve: its spool
    dp/dt = b (flow(s) - leakage p - v)            oil: what comes in, less what leaks, less what the moving load takes
    dv/dt = a (p - friction(v))                    load

p is the pressure, v the speed of the load, u the valve opening. Flow and friction are linear plus tanh neurons (for the
valve's saturation and Coulomb friction). Steps are semi-implicit Euler, p first, so that without losses an oscillation
keeps its amplitude.
"""

import numpy as np
from numpy.typing import ArrayLike

from greygate.models.network import Layer, Network, Port

VALVE = Port("u_valve", "1", 2.0)
PRESSURE = Port("p_oil", "1", 4.0)
TURN = 0.24  # rad per sample, the resonance at the start of training


def crane(flow: int, friction: int, delay: int = 1, seed: int = 0) -> Network:
    """Oil pressure from valve opening. flow, friction: tanh neurons of each. delay: samples before the spool moves."""
    rng = np.random.default_rng(seed)
    network = Network("crane", [VALVE], [PRESSURE])
    network.add("spool", Layer({"s": [[0.3]], "u": [[0.7]]}, [0.0], frozen={"bias"}))
    network.connect("spool", "spool.s", delay=1)
    network.connect(VALVE.name, "spool.u", delay)
    entering: dict[str, ArrayLike] = {"s": [[-0.5]]}
    if flow:
        _neurons(network, "orifice", flow, "spool", 0, rng)
        entering["orifice"] = 0.1 * rng.normal(size=(1, flow))
        network.connect("orifice", "flow.orifice")
    network.add("flow", Layer(entering, [0.0]))
    network.connect("spool", "flow.s")
    network.add("pressure", Layer({"p": [[1 - 0.1 * TURN]], "flow": [[TURN]], "v": [[-TURN]]}, [0.0], frozen={"bias"}))
    network.connect("pressure", "pressure.p", delay=1)
    network.connect("flow", "pressure.flow")
    network.connect("speed", "pressure.v", delay=1)
    moving: dict[str, ArrayLike] = {"v": [[1 - 0.5 * TURN]], "p": [[TURN]]}
    if friction:
        _neurons(network, "friction", friction, "speed", 1, rng)
        moving["friction"] = 0.02 * rng.normal(size=(1, friction))
        network.connect("friction", "speed.friction")
    network.add("speed", Layer(moving, [0.0], frozen={"p"}))
    network.connect("speed", "speed.v", delay=1)
    network.connect("pressure", "speed.p")
    network.connect("pressure", PRESSURE.name)
    return network.check()


def _neurons(network: Network, name: str, count: int, source: str, delay: int, rng: np.random.Generator) -> None:
    weights = 2 * rng.normal(size=(count, 1))
    network.add(name, Layer({source: weights}, rng.normal(size=count), "tansig"))
    network.connect(source, f"{name}.{source}", delay)
