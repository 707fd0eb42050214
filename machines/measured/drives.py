"""Coupled electric drives: motors, belt and sprung pulley as one linear loop with friction; a counter sees |speed|.

    v(k) = sum_i a_i v(k-i) + sum_i b_i u(k-i) + f(v(k-1)) + d(u(k-1)) + c         i = 1..order
    z(k) = p z(k-1) + g1 |v(k)| + g2 v(k)^2 + h(|v(k)|) + e

v: speed of the pulley (the third order: motor and lightly damped belt), z: the pulse counter behind its low-pass. f
(friction), d (drive) and h (counter) are small tanh networks, or left out. Plant: Wigren, Schoukens, "Coupled Electric
Drives Data Set and Reference Models", Uppsala 2017. Its reference models are linear up to |v|; that z bends upwards was
seen in the training part.
"""

import numpy as np

from greygate.models.network import Layer, Network, Port

VOLTAGE = Port("u", "V", 4.0)
PULSES = Port("z", "tick/s", 4.0)
REACH = 2.0  # of |v|, beyond which f, d and h saturate


def drives(seed: int, order: int = 3, friction: int = 2, counter: int = 0, drive: int = 0) -> Network:
    """The start that `seed` draws: stable poles, a pair of them lightly damped. friction, counter, drive: neurons."""
    rng = np.random.default_rng(seed)
    pair = rng.uniform(0.85, 0.97) * np.exp(1j * rng.uniform(0.1, 0.8))
    poles = [rng.uniform(0.6, 0.95), pair, pair.conj(), *rng.uniform(-0.3, 0.6, size=order - 3)]
    polynomial = np.real(np.poly(poles))
    own = {f"v{i}": [[-polynomial[i]]] for i in range(1, order + 1)}
    share = 1 / order + 0.3 * rng.normal(size=order)
    taps = {f"u{i}": [[0.6 * polynomial.sum() * share[i - 1]]] for i in range(1, order + 1)}
    network = Network("ced", [VOLTAGE], [PULSES])
    into_speed: dict[str, np.ndarray] = {}
    into_pulses: dict[str, np.ndarray] = {}

    def small(name: str, neurons: int, source: str, delay: int, into: dict) -> None:
        if neurons:
            network.add(name, Layer({"x": 2 * rng.normal(size=(neurons, 1))}, rng.normal(size=neurons), "tansig"))
            network.connect(source, f"{name}.x", delay)
            into[name] = 0.02 * rng.normal(size=(1, neurons))

    small("drive", drive, VOLTAGE.name, 1, into_speed)
    small("friction", friction, "speed", 1, into_speed)
    network.add("speed", Layer({**taps, **own, **into_speed}, [0.0]))
    sides = Layer({"v": [[1 / REACH], [-1 / REACH]]}, [0.0, 0.0], "satlin", frozen={"v", "bias"})
    network.add("sides", sides)
    network.add("magnitude", Layer({"sides": [[REACH, REACH]]}, [0.0], frozen={"sides", "bias"}))
    network.add("square", Layer({"v": [[1.0]]}, [0.0], "square", frozen={"v", "bias"}))
    small("counter", counter, "magnitude", 0, into_pulses)
    network.add("pulses", Layer({"magnitude": [[0.5]], "square": [[0.3]], "z1": [[0.5]], **into_pulses}, [0.0]))
    for i in range(1, order + 1):
        network.connect(VOLTAGE.name, f"speed.u{i}", delay=i)
        network.connect("speed", f"speed.v{i}", delay=i)
    for name, into in (("speed", into_speed), ("pulses", into_pulses)):
        for source in into:
            network.connect(source, f"{name}.{source}")
    network.connect("speed", "sides.v")
    network.connect("speed", "square.v")
    network.connect("sides", "magnitude.sides")
    network.connect("magnitude", "pulses.magnitude")
    network.connect("square", "pulses.square")
    network.connect("pulses", "pulses.z1", delay=1)
    network.connect("pulses", PULSES.name)
    return network.check()
