"""The kinds of simulators from outside (`outside`): the ending of a model's file, and who answers for it."""

from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

from greygate.errors import InputError
from greygate.plants import mjcf

KINDS: Mapping[str, ModuleType] = {".xml": mjcf, ".urdf": mjcf}
"""`read(path, recorded)` is the plant of a model; `bundle(path)` what a rig takes along of it; `forces(plant)` are the
inputs that it may have in place of its own."""


def of_file(path: Path) -> ModuleType:
    """The kind of a model by its file's ending. Raises InputError for an unknown one."""
    if path.suffix not in KINDS:
        raise InputError(f"{path}: is no model that is known; give one of {', '.join(KINDS)}")
    return KINDS[path.suffix]
