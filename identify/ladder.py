"""The models that compete: linear ones, and networks that are grown from the best of them.

A network begins as the linear model, with neurons that weigh next to nothing: its free run is stable from the first
epoch on, and training can only improve on the linear model.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from greygate.models.families.blocks import nguyen_widrow
from greygate.models.network import Layer, Network, Port

ROOM = 3.0  # deviations of a signal, which the scale of its port is
SMALL = 1e-3  # largest weight of a neuron, in what reads it, before training
NEURONS = "neurons"
LOOP, SHOWN = "state", "shown"  # layers: the linear dynamics, and the output
STATE, PAST = "states", "past"  # layer of a network of states, and its port of the state before
RATE = "rate"  # layer: what an integrating model adds to its output in a sample


@dataclass(frozen=True)
class Orders:
    """Taps of a linear model: u(k - delay - stride i), i = 0..order, by input; y(k - stride i), i = 1..order.

    step: of an integrating model, what its output moves in a sample at most, in the output's scale; 0: it is none. Such
    a model is one of y(k) - y(k - 1), so that its output, an axis's position or a tank's level, may rest anywhere; its
    taps are those of this difference.
    """

    order: int
    delays: tuple[int, ...]
    stride: int = 1
    step: float = 0.0

    def inputs(self, ports: Sequence[Port]) -> dict[Port, tuple[int, ...]]:
        reach = range(self.order + 1)
        return {p: tuple(d + self.stride * i for i in reach) for p, d in zip(ports, self.delays, strict=True)}

    @property
    def feedback(self) -> tuple[int, ...]:
        return tuple(self.stride * i for i in range(1, self.order + 1))

    @property
    def integrating(self) -> bool:
        return self.step > 0

    @property
    def deepest(self) -> int:
        return max(self.delays) + self.stride * self.order

    def __str__(self) -> str:
        late = "" if not any(self.delays) else f", delay {', '.join(map(str, self.delays))}"
        apart = f", taps {self.stride} apart" if self.stride > 1 else ""
        return f"order {self.order}{late}{apart}" + (", integrating" if self.integrating else "")


@dataclass(frozen=True)
class Form:
    """A kind of network around the dynamics of a linear model.

    before: neurons of a curve of each input, ahead of the dynamics (Hammerstein). after: neurons of a curve of what the
    dynamics give (Wiener). inside: neurons within the loop, which read the taps of `reads`. states: neurons in the next
    state of a network of states (identify/states.py); `after` are then in its output. feedback: False for a model that
    remembers inputs alone (FIR).
    """

    name: str
    before: int = 0
    after: int = 0
    inside: int = 0
    states: int = 0
    reads: str = "all"  # "all", "inputs" or "output"
    feedback: bool = True

    @property
    def linear(self) -> bool:
        return not self.before + self.after + self.inside + self.states

    @property
    def loop_is_linear(self) -> bool:
        """Whether the weights of its fed-back taps say if it is stable."""
        return self.feedback and not self.states and (not self.inside or self.reads == "inputs")

    def suits(self, orders: Orders) -> bool:
        """Whether it may be grown from a linear model of these taps.

        The rate of an integrating model may have a curve of each input now, and of itself, as friction is: what neurons
        of more than that get wrong is summed up for ever.
        """
        return not (orders.integrating and self.inside and self.reads != "output")

    def build(self, orders: Orders, inputs: Sequence[Port], output: Port, seed: int) -> Network:
        """The network with neurons that weigh next to nothing, and linear weights of zero."""
        network = Network("network", list(inputs), [output])
        taken = [p.name for p in (*inputs, output)]
        loop, rate, neurons, shown = (own(name, taken) for name in (LOOP, RATE, NEURONS, SHOWN))
        dynamics = rate if orders.integrating else loop
        ports: dict[str, tuple[str, int]] = {}
        for port, delays in orders.inputs(inputs).items():
            source = port.name
            if self.before:
                source = own(f"{port.name}_curve", taken)
                _curve(network, port.name, source, self.before)
            ports |= {f"{port.name}_z{d}": (source, d) for d in delays}
        fed_in = dict(ports)
        ports |= {f"{output.name}_z{d}": (dynamics, d) for d in orders.feedback if self.feedback}
        weights = {port: np.zeros((1, 1)) for port in ports}
        if self.inside:
            read = {"all": ports, "inputs": fed_in}.get(self.reads, {n: p for n, p in ports.items() if n not in fed_in})
            hidden = Layer({p: np.zeros((self.inside, 1)) for p in read}, np.zeros(self.inside), "tansig")
            network.add(neurons, hidden, read)
            weights[neurons], ports = np.zeros((1, self.inside)), ports | {neurons: (neurons, 0)}
        network.add(dynamics, Layer(weights, [0.0], initial=0.0 if orders.integrating else output.rest), ports)
        if orders.integrating:
            summed(network, rate, loop, orders.step, output.rest)
        if self.after:
            _curve(network, loop, shown, self.after)
        network.connect(shown if self.after else loop, output.name)
        return shrunk(nguyen_widrow(network.check(), seed))


def own(name: str, taken: Collection[str]) -> str:
    """A name for a part of a model, which no channel has: `name`, with a number behind it where one has it."""
    names = (f"{name}{k or ''}" for k in count())
    return next(n for n in names if not {n, f"{n}_{NEURONS}"} & set(taken))


def grown(network: Network, linear: Network) -> Network:
    """The network with the linear model's weights."""
    return network.with_parameters(linear.parameters())


def falling(network: Network, orders: Orders, output: Port) -> float:
    """Samples in which the slowest motion of a model's linear loop falls by e; below 0: in which it grows by e.

    Of an integrating model: of its rate.
    """
    weights = network.parameters()
    names = fed_back(network, orders, output)
    loop = [weights[name] for name in names]
    motions = np.linalg.eigvals(loop[0]) if len(loop) == 1 else np.roots([1.0, *(-float(w[0, 0]) for w in loop)])
    largest = float(np.max(np.abs(motions), initial=0.0))
    return np.inf if largest == 1 else 0.0 if largest == 0 else -min(names.values()) / float(np.log(largest))


def fed_back(network: Network, orders: Orders, output: Port) -> dict[str, int]:
    """The weights of a model's linear loop, by name, and the samples ago that each reads."""
    taken = [p.name for p in (*network.inputs, output)]
    if (state := f"{own(STATE, taken)}.{own(PAST, taken)}") in network.parameters():
        return {state: 1}
    loop = own(RATE if orders.integrating else LOOP, taken)
    return {f"{loop}.{output.name}_z{d}": d for d in orders.feedback}


def calmed(network: Network, orders: Orders, output: Port, within: int) -> Network:
    """The network, whose linear loop is scaled so that its slowest motion falls by e `within` samples."""
    factor = np.exp(-1 / within - 1 / abs(falling(network, orders, output)))
    weights = network.parameters()
    loop = fed_back(network, orders, output)
    return network.with_parameters({name: weights[name] * factor**ago for name, ago in loop.items()})


def _curve(network: Network, source: str, name: str, neurons: int) -> None:
    """Layer `name`: the signal itself, plus neurons of it."""
    hidden = f"{name}_{NEURONS}"
    network.add(hidden, Layer({source: np.zeros((neurons, 1))}, np.zeros(neurons), "tansig"), {source: source})
    joined = Layer({"itself": [[1.0]], hidden: np.zeros((1, neurons))}, [0.0], frozen={"itself", "bias"})
    network.add(name, joined, {"itself": source, hidden: hidden})


def summed(network: Network, source: str, name: str, step: float, initial: float) -> None:
    """Layer `name`: the sum of a signal over all samples, `step` for each 1 of it."""
    weights = {source: [[step]], "before": [[1.0]]}
    level = Layer(weights, [0.0], initial=initial, frozen={*weights, "bias"})
    network.add(name, level, {source: source, "before": (name, 1)})


def shrunk(network: Network) -> Network:
    """The network whose neurons weigh SMALL at most in what reads them."""
    feeds, layers = network.feeds(), network.layers()
    read = {
        f"{name}.{port}": w
        for name, layer in layers.items()
        if layer.is_linear
        for port, w in layer.weights.items()
        if (source := feeds[f"{name}.{port}"][0]) in layers and layers[source].function.is_sigmoid
    }
    return network.with_parameters({n: SMALL * w / np.abs(w).max() for n, w in read.items()})


LINEAR = Form("OE")
FIR, ARX, ARMAX, BJ = Form("FIR", feedback=False), Form("ARX"), Form("ARMAX"), Form("BJ")
SUBSPACE = Form("subspace")
SIZES = (3, 8)
STATES = tuple(Form(f"state space, {n} + {m} neurons", states=n, after=m) for n, m in ((3, 3), (8, 8), (3, 0), (8, 0)))
FORMS = STATES + tuple(
    form
    for n in SIZES
    for form in (
        Form(f"Hammerstein, {n} neurons", before=n),
        Form(f"Wiener, {n} neurons", after=n),
        Form(f"Hammerstein-Wiener, {n} + {n} neurons", before=n, after=n),
        Form(f"NOE, {n} neurons", inside=n),
        Form(f"NOE, {n} neurons on inputs", inside=n, reads="inputs"),
        Form(f"NOE, {n} neurons on the output", inside=n, reads="output"),
    )
)
