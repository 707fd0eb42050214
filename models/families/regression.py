"""Regression networks on tapped delay lines (thesis table 3.1).

    y_hat(k) = W_lin phi(k) + W_out tansig( ... tansig(W phi(k) + b) ... ) + b_out
    phi(k) = inputs u_i(k - d), the output's past (k - d)

One network is two models: `train(..., teacher=True)` feeds back the measured output (NARX, linear ARX), `teacher=False`
the network's own (NOE, OE).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greygate.errors import InputError
from greygate.models.network import Layer, Network, Port
from greygate.models.training.record import Record

Taps = Mapping[Port, Sequence[int]]
Named = Taps | Mapping[str, Sequence[int]]  # a name alone is a port without unit and scale


def noe(
    name: str,
    inputs: Named,
    output: Port | str,
    feedback: Sequence[int] = (),
    hidden: Sequence[int] | int = (),
    seed: int = 0,
    linear_loop: bool = False,
    *,
    bypass: bool = True,
    activation: str = "tansig",
) -> Network:
    """A network on the taps u(k-d), d in `inputs[port]` >= 0, and y(k-d), d in `feedback` >= 1.

    Several inputs are several ports; several outputs are one port of that size, and each reads the past of all. A name
    stands for a port without unit and scale.
    hidden: neurons of each hidden layer, or of the only one; () gives the linear model of the same orders. Taps need
    not be neighbours: with wider spacing, a slow plant that is sampled fast does not need large weights that cancel.
    linear_loop: the first hidden layer reads only the inputs (Hammerstein form). Then the only loop is linear, so the
    free run is stable if its poles are.
    bypass: the taps of the hidden layers also reach the output directly (not in the thesis's networks).
    The network starts as y(k) = y(k - feedback[0]) if the output reads that tap. Hidden weights are drawn from `seed`
    at a size that keeps tansig near linear. Raises InputError for a tap that would look ahead or close a loop without
    delay.
    """
    hidden = (hidden,) if isinstance(hidden, int) else hidden
    inputs, output = {_port(p): _delays(name, "inputs", d) for p, d in inputs.items()}, _port(output)
    feedback = _delays(name, "feedback", feedback)
    taps = tapped(name, inputs, output, feedback)
    sizes = {port.name: port.size for port in inputs} | {"sum": output.size}
    rng = np.random.default_rng(seed)
    network = Network(name, list(inputs), [output])
    last = {port: tap for port, tap in taps.items() if not (linear_loop and tap[0] == "sum")}
    direct = {port: tap for port, tap in taps.items() if bypass or not hidden or port not in last}
    fed = {port: sizes[source] for port, (source, _) in last.items()}
    for depth, size in enumerate(hidden, 1):
        layer, fan_in = f"hidden{depth}", sum(fed.values())
        weights = {port: rng.normal(size=(size, n)) / np.sqrt(fan_in) for port, n in fed.items()}
        network.add(layer, Layer(weights, rng.normal(size=size), activation), last)
        fed, last = {layer: size}, {layer: (layer, 0)}
    weights = {port: np.zeros((output.size, sizes[source])) for port, (source, _) in direct.items()}
    if feedback and f"{output.name}_z{feedback[0]}" in direct:
        weights[f"{output.name}_z{feedback[0]}"] = np.eye(output.size)
    if hidden:
        weights |= {port: 0.01 * rng.normal(size=(output.size, n)) for port, n in fed.items()}
    network.add("sum", Layer(weights, np.zeros(output.size), initial=output.rest), direct | last)
    network.connect("sum", output.name)
    return network.check()


def tapped(name: str, inputs: Taps, output: Port, feedback: Sequence[int]) -> dict[str, tuple[str, int]]:
    """Name of each tap, `u_z1` -> (its source, its delay); the output is that of layer `sum`. Raises as `noe`."""
    taps = {f"{port.name}_z{d}": (port.name, d) for port, delays in inputs.items() for d in delays}
    taps |= {f"{output.name}_z{d}": ("sum", d) for d in feedback}
    if any(d < (source == "sum") for source, d in taps.values()):
        raise InputError(f"network {name}: taps {', '.join(taps)}; an input's start at 0, the output's own at 1")
    return taps


def _port(given: Port | str) -> Port:
    return Port(given) if isinstance(given, str) else given


def _delays(name: str, argument: str, given: Sequence[int]) -> Sequence[int]:
    """Raises InputError, naming the argument, for what is no list of delays."""
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise InputError(f"network {name}: {argument} {given!r} is no list of delays; write ({given},) for one delay")
    return given


narx = noe


def nfir(
    name: str, inputs: Named, output: Port | str, hidden: Sequence[int] | int = (), seed: int = 0, **options
) -> Network:
    """Network on inputs only, which has no loop and so is always stable. options: of `noe`."""
    return noe(name, inputs, output, (), hidden, seed, **options)


# ---- the regression matrix


@dataclass(frozen=True)
class Regressors:
    """phi(k), normalised as in the network: matrix (M, T), target (M,), taps: name of each column, `u_z1`."""

    taps: tuple[str, ...]
    matrix: np.ndarray
    target: np.ndarray


def regressors(records: Sequence[Record], inputs: Taps, output: Port, feedback: Sequence[int] = ()) -> Regressors:
    """The regression matrix: rows k of every record, from the first one with all taps inside it (and from `skip`).

    Raises InputError for a signal that is missing, has another length or is not finite, and for too short records.
    """
    delays = [*(d for taps in inputs.values() for d in taps), *feedback]
    taps = [(port, d) for port, ds in inputs.items() for d in ds] + [(output, d) for d in feedback]
    rows, targets = [], []
    for record in records:
        y = _signal(record.targets, output)
        signals = {port.name: _signal(record.inputs, port) for port in inputs} | {output.name: y}
        for name, s in signals.items():
            if len(s) != len(y):
                raise InputError(f"input {name}: {len(s)} samples where {output.name} has {len(y)}")
        start = max([record.skip, *delays])
        if start < len(y):
            rows.append(np.stack([signals[p.name][start - d : len(y) - d] for p, d in taps], axis=1))
            targets.append(y[start:])
    if not rows:
        deepest = max(delays, default=0)
        raise InputError(f"output {output.name}: no record is longer than the deepest tap, {deepest}; lower the orders")
    return Regressors(tuple(f"{p.name}_z{d}" for p, d in taps), np.concatenate(rows), np.concatenate(targets))


def _signal(signals: Mapping[str, np.ndarray], port: Port) -> np.ndarray:
    if port.name not in signals:
        raise InputError(f"signal {port.name} [{port.unit}] is missing; given: {', '.join(signals) or 'nothing'}")
    value = port.normalised(np.asarray(signals[port.name], float))
    if value.ndim != 1:
        raise InputError(f"signal {port.name}: {value.shape}; give one number a sample")
    bad = np.flatnonzero(~np.isfinite(value))
    if len(bad):
        raise InputError(
            f"signal {port.name}: NaN or inf at sample {bad[0]} ({len(bad)} in all); repair or cut the record"
        )
    return value
