"""The kinds of simulators from outside (`outside`): the ending of a model's file, and who answers for it."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import ModuleType

from greygate.errors import InputError
from greygate.names import check_file_name
from greygate.plants import fmu, mjcf
from greygate.plants.plant import Plant, read_entries
from greygate.reading import read_toml

TRUST = "trust"  # entry of rig.toml: the digest of the program that it means
KINDS: Mapping[str, ModuleType] = {".xml": mjcf, ".urdf": mjcf, ".fmu": fmu}
"""`read(path, recorded)` is the plant of a model; `bundle(path)` what a rig takes along of it; `forces(plant)` are the
inputs that it may have in place of its own."""


def of_file(path: Path) -> ModuleType:
    """The kind of a model by its file's ending. Raises InputError for an unknown one."""
    if path.suffix not in KINDS:
        raise InputError(f"{path}: is no model that is known; give one of {', '.join(KINDS)}")
    return KINDS[path.suffix]


def digest(path: Path) -> str | None:
    """SHA-256 of the program that computes the plant of a file, or of the model that it names; None: it is data."""
    return None if (file := _program(path)) is None else fmu.digest(file)


def trust(path: Path) -> None:
    """Let the program that computes such a plant run, from now on, for this user."""
    if (found := digest(path)) is not None:
        fmu.trust.give(found)


def _program(path: Path) -> Path | None:
    if path.suffix not in KINDS:
        named = read_toml(path, "give a plant's TOML file").get("model") if path.suffix == ".toml" else None
        path = path.parent / check_file_name(named, f"{path}: model") if named is not None else path
    return path if KINDS.get(path.suffix) is fmu else None


def read(path: Path, recorded: Mapping[str, str]) -> Plant:
    """The plant of a model, or of a plant's TOML file, which may add to the `model` that it names.

    recorded: channel -> its unit.

    What it adds are inputs, parameters, definitions, and terms in the balances that the model has; `step` and `outputs`
    are its own where it gives them. Raises InputError naming the file and the entry.
    """
    if path.suffix in KINDS:
        return KINDS[path.suffix].read(path, recorded)
    if "model" not in read_toml(path, "give a plant's TOML file"):
        return Plant.read(path)
    own = read_entries(path)
    model = path.parent / own.pop("model")
    base = of_file(model).read(model, recorded)
    equations = dict(base.equations)
    for name, equation in own.pop("equations", {}).items():
        if name not in equations or equations[name].state != equation.state:
            places = ", ".join(f"{place}.{e.state}" for place, e in equations.items())
            raise InputError(f"{path}: equations.{name}: is no balance of {model.name}; it has {places}")
        if twice := [term for term in equation.terms if term in equations[name].terms]:
            raise InputError(f"{path}: equations.{name}: {model.name} has a term {twice[0]} there; rename one")
        equations[name] = replace(equations[name], terms={**equations[name].terms, **equation.terms})
    joined = {
        key: {**getattr(base, key), **own.pop(key, {})} for key in ("parameters", "inputs", "states", "definitions")
    }
    return replace(base, name=path.stem, equations=equations, **joined, **{k: _tuple(v) for k, v in own.items()})


def _tuple(value: object) -> object:
    return tuple(value) if isinstance(value, list) else value
