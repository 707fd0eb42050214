"""The eight standard templates (thesis figure 3.5, table 3.2).

Delays are counted from the output: the table's y(k+1) = f[x(k), ...] is y(k) = f[x(k-1), ...] here. As in
`models.families.regression`, `train(..., teacher=True)` puts the measured output in the feedback, else its own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greygate.errors import InputError
from greygate.models.families.blocks import feedforward
from greygate.models.network import Layer, Network, Port


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
