"""The flow network, 2-10-10-1: `qa` of the trained valve cylinder as a network of its own, and a grid of its inputs."""

import json
import subprocess
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from greygate.compiler.ranges import ranges
from greygate.machines.source import Source
from greygate.models.layer import Port
from greygate.models.network import Network
from greygate.models.training.record import Record

PEERS = ("da4ml", "alkaid")
SIDE = 99  # points of the grid along each input
ENDS = {"u": (-1.0, 1.0), "p": (0.01, 0.99)}


def flow() -> tuple[Network, Record]:
    """The network, and its own float output on the grid."""
    layers = Source("valve_cylinder").network().layers()
    network = Network("flow", [Port(name, "1") for name in ENDS], [Port("y", "1")])
    before = {"u": "u", "p": "p"}
    for name in ("hidden1", "hidden2", "out"):
        layer = layers[f"qa.{name}"]
        network.add(name, replace(layer, weights=dict(zip(before, layer.weights.values(), strict=True))))
        for port, source in before.items():
            network.connect(source, f"{name}.{port}")
        before = {name: name}
    network.connect("out", "y")
    axes = np.meshgrid(*(np.linspace(*ends, SIDE) for ends in ENDS.values()))
    inputs = {name: axis.ravel() for name, axis in zip(ENDS, axes, strict=True)}
    return network, Record(inputs, network.run(inputs))


def arrays() -> dict[str, np.ndarray]:
    """The network for flow_peers.py: x (N, 2), y (N,) of float, and weights, bias and reach of each layer."""
    network, record = flow()
    layers, found = network.layers(), {"x": np.stack(list(record.inputs.values()), 1), "y": record.targets["y"]}
    seen = ranges(network.flatten(), [record])
    for n, name in enumerate(("hidden1", "hidden2", "out"), 1):
        found |= {f"w{n}": np.hstack(list(layers[name].weights.values())), f"b{n}": layers[name].bias}
        found[f"reach{n}"] = np.array(seen[f"{name}.n"].magnitude)
    return found


def of_peer(python: Path, package: str, folder: Path, *words: object, data: Mapping | None = None) -> dict:
    """What flow_peers.py prints for a package, in the interpreter that has it; it works in the folder.

    data: as `arrays`, which are taken otherwise.
    """
    np.savez(folder / "data.npz", **(data or arrays()))
    script = Path(__file__).with_name("flow_peers.py").resolve()
    command = [python.absolute(), script, package, "data.npz", *map(str, words)]
    done = subprocess.run(command, cwd=folder, check=True, stdout=subprocess.PIPE, text=True)
    return json.loads(done.stdout.splitlines()[-1])
