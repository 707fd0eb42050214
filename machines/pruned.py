"""Prune and keep each network of the catalogue that has a pruning of its own: python -m greygate.machines.pruned"""

from greygate.compiler.pipeline import compile_network
from greygate.machines.catalog import CATALOG
from greygate.machines.kept import PRUNED


def main() -> None:
    for name, entry in CATALOG.items():
        if entry.prune:
            compiled = compile_network(
                entry.network(), entry.records(), ranged_on=entry.training, prune=entry.prune.make
            )
            print(f"{name}: {compiled.pruning[-1].neurons} neurons, written to {PRUNED / name}.toml")


if __name__ == "__main__":
    main()
