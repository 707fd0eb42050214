"""Errors of the prediction as regressors: NARMAX and NBJ (thesis table 3.1), and the noise filter of Box and Jenkins.

A network with e(k - d) = y(k - d) - y_hat(k - d) among its regressors has the measured output as a further input;
`with_measured` adds it to a record. A free run has no measurement, so e = 0 there; `free_run` makes that network.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greygate.errors import InputError
from greygate.models.families.regression import Named, noe
from greygate.models.network import Layer, Network, Port
from greygate.models.training.record import Record


def narmax(
    name: str, inputs: Named, output: Port | str, feedback: Sequence[int], noise: Sequence[int], *given, **options
) -> Network:
    """Network on inputs, the output's past and errors e(k-d), d in `noise` >= 1.

    NARMAX if trained with a teacher, else NBJ (of table 3.1). Records need the measured output as an input:
    `with_measured`. given, options: what else `noe` takes.
    """
    if min(noise, default=1) < 1:
        raise InputError(f"network {name}: errors {tuple(noise)}; an input's start at 0, the output's own at 1")
    output = Port(output) if isinstance(output, str) else output
    network = noe(name, {**inputs, Port("e", size=output.size): noise}, output, feedback, *given, **options)
    network.inputs.pop()  # what was an input is computed
    _measure(network, "e", "sum")
    return network.check()


nbj = narmax


def box_jenkins(plant: Network, noise: Sequence[int], shaping: Sequence[int]) -> Network:
    """y_hat(k) = w(k) + sum_d p_d v(k-d) + sum_d q_d e(k-d), v = y - w, e = y - y_hat; w: the plant's free run.

    Box, Jenkins 1970: y = w + (C/D) e with C = 1 + q_1 z^-1 + ... (d in `noise`) and D = 1 - p_1 z^-1 - ... (d in
    `shaping`), which share no pole with the plant. plant: a network of one output, such as `noe` builds. It feeds back
    its own output, so train without a teacher, on records `with_measured`. The weights of the filter start at zero.
    Raises InputError for a delay below 1 or a plant of several outputs.
    """
    if [p.size for p in plant.outputs] != [1] or min((*noise, *shaping), default=1) < 1:
        raise InputError(f"network {plant.name}: a noise filter needs one scalar output and delays of 1 or more")
    flat = plant.flatten()
    output = plant.outputs[0]
    source, delay = flat.feeds()[output.name]
    network = replace(flat, name=plant.name, outputs=[output])
    network.connections = [c for c in flat.connections if c.target != output.name]
    taps = {f"v_z{d}": ("v", d) for d in shaping} | {f"e_z{d}": ("e", d) for d in noise}
    weights = {"plant": [[1.0]]} | {port: [[0.0]] for port in taps}
    network.add("predicted", Layer(weights, [0.0], initial=output.rest, frozen={"plant", "bias"}))
    for port, (name, d) in ({"plant": (source, delay)} | taps).items():
        network.connect(name, f"predicted.{port}", d)
    network.connect("predicted", output.name)
    for name, of in (("v", source), ("e", "predicted")):
        if any(tap[0] == name for tap in taps.values()):
            _measure(network, name, of)
    return network.check()


def free_run(network: Network) -> Network:
    """The network that needs no measurement: y_hat stands for y, so every e is 0 and its taps vanish.

    Layers that read a measured output are removed, with all that reads them. A network without such layers is returned
    flat and otherwise unchanged.
    """
    flat = network.flatten()
    measured = {_measured(p).name for p in flat.outputs} & {p.name for p in flat.inputs}
    gone = {c.target.rpartition(".")[0] for c in flat.connections if c.source in measured}
    kept = [c for c in flat.connections if not {c.source, c.target.rpartition(".")[0]} & (gone | measured)]
    targets = {c.target for c in kept}
    modules: dict[str, Layer | Network] = {}
    for name, layer in flat.layers().items():
        if name not in gone:
            weights = {p: w for p, w in layer.weights.items() if f"{name}.{p}" in targets}
            modules[name] = replace(layer, weights=weights, frozen=layer.frozen & {*weights, "bias"})
    inputs = [p for p in flat.inputs if p.name not in measured]
    return replace(flat, inputs=inputs, modules=modules, connections=kept).check()


def with_measured(record: Record, network: Network) -> Record:
    """The record with those targets as further inputs that the network asks for, as `NAME_measured`."""
    asked = {p.name for p in network.inputs}
    given = {_measured(p).name: record.targets[p.name] for p in network.outputs if _measured(p).name in asked}
    return replace(record, inputs={**record.inputs, **given})


def _measured(output: Port) -> Port:
    return replace(output, name=f"{output.name}_measured")


def _measure(network: Network, name: str, of: str) -> None:
    """Add layer `name`: measured output less layer `of`, at this step."""
    port = _measured(network.outputs[0])
    one = np.eye(port.size)
    if port not in network.inputs:
        network.inputs.append(port)
    frozen = {"measured", "model", "bias"}
    network.add(name, Layer({"measured": one, "model": -one}, np.zeros(port.size), frozen=frozen))
    network.connect(port.name, f"{name}.measured")
    network.connect(of, f"{name}.model")
