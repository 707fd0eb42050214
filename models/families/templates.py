"""The eight standard templates (thesis figure 3.5, table 3.2), Elman and fully recurrent networks.

Delays are counted from the output: the table's y(k+1) = f[x(k), ...] is y(k) = f[x(k-1), ...] here. As in
`models.regression`, `train(..., teacher=True)` puts the measured output in the feedback, `teacher=False` its own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greygate.errors import InputError
from greygate.models.families.blocks import feedforward
from greygate.models.network import Layer, Network, Port

MEMORY = 0.3  # initial gain of a recurrent network's past


@dataclass(frozen=True)
class Template:
    """The signals that g, f and the linear sum at the output read: x and y are their taps, f and g the networks."""

    g: str = ""
    f: str = ""
    sum: str = ""


TEMPLATES = {
    1: Template(f="x"),
    2: Template(f="xy"),
    3: Template(g="y", f="x", sum="gf"),
    4: Template(g="y", sum="gx"),
    5: Template(f="x", sum="fy"),
    6: Template(g="yf", f="x"),
    7: Template(g="yf", f="xy"),
    8: Template(g="yf", f="xy", sum="gx"),
}


def template(
    number: int,
    name: str,
    inputs: Mapping[Port, Sequence[int]],
    output: Port,
    feedback: Sequence[int] = (),
    f: Sequence[int] = (10,),
    g: Sequence[int] = (10,),
    seed: int = 0,
) -> Network:
    """Type `number` of table 3.2, with x(k-d), d in `inputs[port]` >= 0, and y(k-d), d in `feedback` >= 1.

        1  y = f[x]               5  y = sum alpha_i y_i + f[x]
        2  y = f[y, x]            6  y = g{y, f[x]}
        3  y = g[y] + f[x]        7  y = g{y, f[x, y]}
        4  y = g[y] + sum b_i x_i 8  y = g{y, f[x, y]} + sum b_i x_i

    f, g: neurons of their hidden layers. Both are modules of those names, tansig with one linear output, which can be
    frozen, rehearsed or replaced. The linear part is the layer `sum`, whose coefficients start at zero.
    Raises InputError for a number that is not in the table, for taps that look ahead, and for taps that the type does
    not have.
    """
    if number not in TEMPLATES:
        raise InputError(f"network {name}: no template {number}; table 3.2 has 1 to 8")
    if vectors := [port.name for port in (*inputs, output) if port.size > 1]:
        raise InputError(
            f"network {name}: template ports are scalars, {vectors[0]} is not; `regression.noe` takes vectors"
        )
    form = TEMPLATES[number]
    reads = form.g + form.f + form.sum
    if bool(feedback) != ("y" in reads):
        raise InputError(f"network {name}: type {number} {'needs' if 'y' in reads else 'has no'} feedback taps")
    last = "sum" if form.sum else "g" if form.g else "f"
    feeds = {
        "x": {f"{port.name}_z{d}": (port.name, d) for port, delays in inputs.items() for d in delays},
        "y": {f"{output.name}_z{d}": (last, d) for d in feedback},
    }
    if any(d < 0 for _, d in feeds["x"].values()) or any(d < 1 for d in feedback) or not feeds["x"]:
        raise InputError(f"network {name}: give taps of x from 0 on and of y from 1 on")
    feeds |= {part: {part: (part, 0)} for part in "fg"}
    network = Network(name, list(inputs), [output])

    def read(kinds: str) -> dict[str, tuple[str, int]]:
        return {port: feed for kind in kinds for port, feed in feeds[kind].items()}

    for offset, (part, hidden) in enumerate((("f", f), ("g", g))):
        if ports := read(getattr(form, part)):
            module = feedforward(part, list(ports), hidden, 2 * seed + offset)
            if part == last:
                module.modules["out"] = replace(module.layers()["out"], initial=np.array(output.rest))
            network.add(part, module)
            for port, (source, delay) in ports.items():
                network.connect(source, f"{part}.{port}", delay)
    if ports := read(form.sum):
        own = frozenset(ports.keys() & {"f", "g"})
        weights = {port: [[1.0 if port in own else 0.0]] for port in ports}
        network.add("sum", Layer(weights, [0.0], initial=output.rest, frozen=own | {"bias"}))
        for port, (source, delay) in ports.items():
            network.connect(source, f"sum.{port}", delay)
    network.connect(last, output.name)
    return network.check()


def elman(
    name: str, inputs: Mapping[Port, Sequence[int]], outputs: Sequence[Port], hidden: Sequence[int], seed: int = 0
) -> Network:
    """Each hidden layer reads its own past: h(k) = tansig(W x(k) + V h(k-1) + b), y(k) = C h(k) + d.

    Elman 1990 (thesis 4.4). inputs: taps by port, as in `template`. Raises InputError for a tap that looks ahead.
    """
    return _recurrent(name, inputs, outputs, hidden, seed, full=False)


def frnn(
    name: str, inputs: Mapping[Port, Sequence[int]], outputs: Sequence[Port], hidden: Sequence[int], seed: int = 0
) -> Network:
    """Fully recurrent: every layer, the linear output too, reads the past step of every layer.

    Williams, Zipser 1989, in layers (thesis 4.4). inputs as in `elman`. Raises InputError for a tap that looks ahead.
    """
    return _recurrent(name, inputs, outputs, hidden, seed, full=True)


def _recurrent(name, inputs, outputs, hidden, seed, full) -> Network:
    taps = {f"{port.name}_z{d}": (port.name, d, port.size) for port, delays in inputs.items() for d in delays}
    if not taps or not hidden or any(d < 0 for _, d, _ in taps.values()):
        raise InputError(f"network {name}: give hidden neurons and taps of inputs from 0 on")
    rng = np.random.default_rng(seed)
    network = Network(name, list(inputs), list(outputs))
    layers = {f"hidden{depth}": size for depth, size in enumerate(hidden, 1)}
    if full:
        layers |= {f"{port.name}_layer": port.size for port in outputs}
    last = taps
    for depth, size in enumerate(hidden, 1):
        layer = f"hidden{depth}"
        past = {f"{n}_past": (n, 1, s) for n, s in layers.items() if full or n == layer}
        _layer(network, rng, layer, last, past, size, "tansig")
        last = {layer: (layer, 0, size)}
    past = {f"{n}_past": (n, 1, s) for n, s in layers.items()} if full else {}
    for port in outputs:
        layer = f"{port.name}_layer"
        _layer(network, rng, layer, last, past, port.size, "linear", port.rest)
        network.connect(layer, port.name)
    return network.check()


def _layer(network, rng, name, reads, past, size, activation, initial=0.0) -> None:
    """Weights that keep the layer's sum of present signals near one, and that of past signals near `MEMORY`."""
    weights: dict[str, np.ndarray] = {}
    for ports, gain in ((reads, 1.0), (past, MEMORY)):
        norm = gain / np.sqrt(max(sum(width for _, _, width in ports.values()), 1))
        weights |= {port: norm * rng.normal(size=(size, width)) for port, (_, _, width) in ports.items()}
    network.add(name, Layer(weights, 0.5 * rng.normal(size=size), activation, initial=initial))
    for port, (source, delay, _) in (reads | past).items():
        network.connect(source, f"{name}.{port}", delay)
