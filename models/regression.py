"""Regression networks on tapped delay lines: NARX and NOE of any order (thesis table 3.1).

    y(k) = W_lin phi(k) + W_out tansig( ... tansig(W phi(k) + b) ... ) + b_out
    phi(k) = inputs u_i(k - d) and the output's own past y(k - d)

One network is both: with `train(..., teacher=True)` the measured output stands in its feedback (series-parallel, NARX);
in free run its own does (parallel, NOE).
"""

from collections.abc import Mapping, Sequence

import numpy as np

from greygate.errors import InputError
from greygate.models.network import Layer, Network, Port


def noe(
    name: str,
    inputs: Mapping[Port, Sequence[int]],
    output: Port,
    feedback: Sequence[int],
    hidden: Sequence[int] = (),
    seed: int = 0,
    linear_loop: bool = False,
) -> Network:
    """A network on the taps u(k-d), d in `inputs[port]` >= 0, and y(k-d), d in `feedback` >= 1.

    hidden: neurons of each tansig layer; none gives the linear model of the same orders. Taps need not be neighbours:
    with wider spacing a slow plant sampled fast does not cancel large weights against each other.
    linear_loop: the first hidden layer sees the inputs alone (Hammerstein form): the only loop is linear, so free run
    is stable if its poles are.
    It starts as y(k) = y(k - feedback[0]), hidden weights drawn from `seed` at a size that keeps tansig near linear.
    Raises InputError for a tap that would look ahead or close a loop without delay.
    """
    taps = {f"{port.name}_z{d}": (port.name, d) for port, delays in inputs.items() for d in delays}
    taps |= {f"{output.name}_z{d}": ("sum", d) for d in feedback}
    if any(d < (source == "sum") for source, d in taps.values()):
        raise InputError(f"network {name}: taps {', '.join(taps)}; an input's start at 0, the output's own at 1")
    rng = np.random.default_rng(seed)
    network = Network(name, list(inputs), [output])
    last = {port: tap for port, tap in taps.items() if not (linear_loop and tap[0] == "sum")}
    fed = dict.fromkeys(last, 1)
    for depth, size in enumerate(hidden, 1):
        layer, fan_in = f"hidden{depth}", sum(fed.values())
        weights = {port: rng.normal(size=(size, n)) / np.sqrt(fan_in) for port, n in fed.items()}
        network.add(layer, Layer(weights, rng.normal(size=size), "tansig"))
        for port, (source, delay) in last.items():
            network.connect(source, f"{layer}.{port}", delay)
        fed, last = {layer: size}, {layer: (layer, 0)}
    bypass = {port: [[0.0]] for port in taps}
    if feedback:
        bypass[f"{output.name}_z{feedback[0]}"] = [[1.0]]
    if hidden:
        bypass |= {port: 0.01 * rng.normal(size=(1, n)) for port, n in fed.items()}
    network.add("sum", Layer(bypass, [0.0], initial=(output.initial - output.offset) / output.scale))
    for port, (source, delay) in (taps | last).items():
        network.connect(source, f"sum.{port}", delay)
    network.connect("sum", output.name)
    return network.check()
