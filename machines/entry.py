"""What a machine's folder declares for the catalogue: `MACHINE`, a `Machine`, in its machine.py."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from greygate.machines.control import Task
from greygate.machines.kept import Kept
from greygate.mismatch.augmentation import Augmentation
from greygate.models.network import Network
from greygate.models.storage import TRAINED
from greygate.models.training.record import Record
from greygate.progress import Progress

LAST = 1000  # the place of a machine that asks for none
BAR = 1e5  # Pa


@dataclass(frozen=True)
class Entry:
    """One network of the catalogue.

    train: (progress) -> (network, figures). records: scenarios by name, the training ones first; the first one sets
    the ranges of the fixed-point formats. scenarios: those on which hardware is compared with the emulator.
    references: source -> scenario -> output -> published RMSE in the output's unit, or a pair (best, worst).
    prune: the network's own pruning; what it came to is kept in the package.
    finer: of `Formats`; 2 where pressures are pure integrals: the fewest bits with which a word of 16 costs the
    training record less than 5 %.
    row: its place in the table of `greygate report --all`; None where it is not in that table.
    """

    name: str
    title: str
    train: Callable[[Progress], tuple[Network, dict]]
    records: Callable[[], Mapping[str, Record]]
    training: tuple[str, ...]
    scenarios: tuple[str, ...]
    period: float = 1e-3
    references: Mapping[str, Mapping] = field(default_factory=dict)
    prune: Kept | None = None
    finer: int = 0
    row: int | None = None

    def network(self) -> Network:
        """The trained network that is kept in the package."""
        return Network.load(TRAINED / self.name)

    def save(self, network: Network, figures: dict, folder: Path = TRAINED) -> None:
        """Write NAME.toml, NAME.safetensors and NAME.json (the figures)."""
        replace(network, dt=self.period).save(folder / self.name, json.dumps(figures, indent=2) + "\n")


@dataclass(frozen=True)
class Machine:
    """A machine: its networks, and what stands for a plant of its folder where a diagnosis augments its network.

    augmented: plant -> class of its augmentation (mismatch/augment.py). controlled: name -> what builds its task of
    position control (machines/control.py). place: among the machines, in lists.
    """

    networks: tuple[Entry, ...] = ()
    augmented: Mapping[str, type[Augmentation]] = field(default_factory=dict)
    controlled: Mapping[str, Callable[[], Task]] = field(default_factory=dict)
    place: int = LAST


def pressures(bar: Mapping[str, tuple[float, float]], scenarios: Sequence[str]) -> dict[str, dict[str, float]]:
    """Published RMSE of chambers A and B in Pa, of those scenarios that have one. bar: scenario -> RMSE in bar."""
    return {name: {"p_a": BAR * bar[name][0], "p_b": BAR * bar[name][1]} for name in scenarios if name in bar}
