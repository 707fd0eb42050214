"""The networks that come with greygate, by name, and the machines that they are of.

A machine is a folder beside this file with a machine.py in it; nothing else lists them.
"""

from importlib import import_module
from pathlib import Path

from greygate.errors import InputError
from greygate.machines.control import Task
from greygate.machines.entry import Entry, Machine
from greygate.mismatch.augmentation import Augmentation


def _machines() -> list[Machine]:
    """Of every folder, in their order."""
    names = sorted(path.parent.name for path in Path(__file__).parent.glob("*/machine.py"))
    found = [import_module(f"{__package__}.{name}.machine").MACHINE for name in names]
    return sorted(found, key=lambda machine: machine.place)


MACHINES = _machines()
CATALOG: dict[str, Entry] = {entry.name: entry for machine in MACHINES for entry in machine.networks}
AUGMENTED: dict[str, type[Augmentation]] = {
    plant: kind for machine in MACHINES for plant, kind in machine.augmented.items()
}
"""Plant -> the augmentation of its structured network."""

CONTROLLED = {name: build for machine in MACHINES for name, build in machine.controlled.items()}
"""Machine -> what builds its task of position control."""

REPORTED = tuple(
    entry.name for entry in sorted(CATALOG.values(), key=lambda entry: entry.row or 0) if entry.row is not None
)
"""Rows of the table of `greygate report --all`: the thesis's machines."""


def entry(name: str) -> Entry:
    """The entry of that name. Raises InputError naming those there are."""
    if name not in CATALOG:
        if Path(name).is_file():
            raise InputError(f"{name}: is no network; give an .onnx file, a .mat file, or NAME.toml beside its numbers")
        raise InputError(f"no network is called {name!r}; there are {', '.join(CATALOG)}, or give a NAME.toml file")
    return CATALOG[name]


def task(name: str) -> Task:
    """The position control of a machine. Raises InputError naming those there are."""
    if name not in CONTROLLED:
        raise InputError(f"no machine {name!r} has position control; there are {', '.join(CONTROLLED)}")
    return CONTROLLED[name]()
