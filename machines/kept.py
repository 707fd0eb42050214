"""Pruned networks that are kept in the package, so that `greygate compile NAME --prune 1.0` builds the same everywhere.

Pruning trains, and training is not the same to the last bit on every kind of processor. What it ended in is therefore
kept beside the trained network: models/trained/pruned/NAME.toml, .safetensors and .json, which says what it was made
of. It answers where that is given again: the same network to the bit, the same factor and method, and the same records
as far as the network's errors on them tell. Else pruning is done anew; what came out is network.toml in the build, and
from that a compilation without pruning gives the same build everywhere.

`python -m benchmarks pruned` makes and keeps them.
"""

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from greygate.compiler.pipeline import float_error
from greygate.errors import InputError
from greygate.models.network import Network
from greygate.models.prune import Round
from greygate.models.storage import TRAINED
from greygate.models.training.record import Record
from greygate.reading import read_json

PRUNED = TRAINED / "pruned"
ALLOWED = 1.0  # the factor of those that are kept
SAME_ERRORS = 1e-6  # relative: processors change an error by 1e-12 of it, another record by far more


def digest(network: Network) -> str:
    """SHA-256 of a flat network: its ports, connections, layers and every bit of its numbers."""
    layers = {n: (v.activation, sorted(v.frozen), list(v.weights)) for n, v in network.layers().items()}
    found = hashlib.sha256(
        repr((network.name, network.inputs, network.outputs, network.connections, layers)).encode("utf-8")
    )
    for layer in network.layers().values():
        for numbers in (*layer.weights.values(), layer.bias, layer.initial):
            found.update(np.ascontiguousarray(numbers, "<f8").tobytes())
    return found.hexdigest()


@dataclass(frozen=True)
class Kept:
    """A network's own pruning, which answers from the package where what is kept there was made of the same.

    records: those it is pruned on. prune: (network, allowed, progress=, weights=) -> (network, rounds).
    """

    name: str
    records: Callable[[], Mapping[str, Record]]
    prune: Callable[..., tuple[Network, list[Round]]]

    def __call__(self, network: Network, allowed: float, **options) -> tuple[Network, list[Round]]:
        """Raises InputError if the file that is kept is not what it was."""
        path = PRUNED / self.name
        if path.with_suffix(".json").exists():
            facts = read_json(path.with_suffix(".json"), "run python -m benchmarks pruned")
            if _same(facts["made_of"], self.made_of(network, allowed, options)):
                found = Network.load(path)
                if digest(found) != facts["network"]:
                    raise InputError(
                        f"{path}.toml: its digest says that it was changed; run python -m benchmarks pruned"
                    )
                return found, [Round(**{**r, "error": tuple(r["error"])}) for r in facts["rounds"]]
        return self.prune(network, allowed, **options)

    def made_of(self, network: Network, allowed: float, options: Mapping) -> dict:
        """What its answer depends on: the network, what is asked of it, and its errors on the records."""
        method = options.get("weights")
        return {
            "network": digest(network),
            "allowed": allowed,
            "weights": method and method.__name__,
            "errors": {
                f"{scenario} {output}": float(np.sqrt(np.mean(error**2)))
                for scenario, record in self.records().items()
                for output, error in float_error(network, record).items()
            },
        }


def _same(kept: Mapping, given: Mapping) -> bool:
    return (
        all(kept[key] == given[key] for key in ("network", "allowed", "weights"))
        and kept["errors"].keys() == given["errors"].keys()
        and all(math.isclose(e, given["errors"][key], rel_tol=SAME_ERRORS) for key, e in kept["errors"].items())
    )
