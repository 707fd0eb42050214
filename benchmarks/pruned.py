"""Prunes what the catalogue says how to prune, keeps it; `greygate compile NAME --prune 1.0` takes it from there."""

import json
from dataclasses import asdict
from typing import Annotated

from greygate.compiler.pipeline import compile_network
from greygate.machines import kept as keeping
from greygate.machines.catalog import CATALOG
from greygate.machines.kept import ALLOWED, Kept, digest
from greygate.models.network import Network
from greygate.models.prune import Round

from .made import stamp

TAKES = "minutes"
PRUNING = [name for name, entry in CATALOG.items() if entry.prune]


def make(kept: Kept, network: Network) -> tuple[Network, list[Round]]:
    """Prune anew, and keep what comes out."""
    smaller, rounds = kept.prune(network, ALLOWED)
    facts = {
        "made_of": kept.made_of(network, ALLOWED, {}),
        "network": digest(smaller),
        "rounds": [asdict(r) for r in rounds],
    }
    smaller.save(keeping.PRUNED / kept.name, json.dumps(facts, indent=1) + "\n")
    stamp(keeping.PRUNED / f"{kept.name}.json")
    return smaller, rounds


def main(*name: Annotated[str, PRUNING]) -> None:
    for chosen in name or PRUNING:
        entry = CATALOG[chosen]
        compiled = compile_network(
            entry.network(), entry.records(), ranged_on=entry.training, prune=lambda n, of=entry.prune: make(of, n)
        )
        print(f"{chosen}: {compiled.pruning[-1].neurons} neurons, written to {keeping.PRUNED / chosen}.toml")
