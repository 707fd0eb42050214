"""The functions of which a missing term may be made: libraries that come along, joined as a plant's file says.

The libraries are `closure.toml` and those of the plant's own `closure` (plants/closure.py). Joining makes one library
of several, as pysindy does with its feature libraries: the functions of the first, then those of the next.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from greygate.errors import InputError, shown
from greygate.plants.closure import SEEN, Library, check_library
from greygate.plants.expressions import Call as FunctionCall
from greygate.plants.expressions import Name, Number, check_name, parse, replaced
from greygate.plants.plant import TERMS, Plant
from greygate.reading import named, read_toml

COMMON = Path(__file__).parent / "closure.toml"


@dataclass(frozen=True)
class Candidate:
    """A function that may be missing: an expression in the plant's symbols, and the variables that it depends on."""

    expression: str
    depends_on: tuple[str, ...]


Basis = dict[str, Candidate]
"""Name -> candidate, in the order of declaration."""


def declared(plant: Plant) -> dict[str, Basis]:
    """Place -> the functions that the plant's file says may be missing there; empty where it says nothing.

    Raises InputError for a library, or a name in one, that the plant does not know.
    """
    known = {**_common(), **plant.closure.libraries}
    found: dict[str, Basis] = {}
    for where, place in plant.closure.places.items():
        joined: Library = {}
        for name in place.libraries:
            if name not in known:
                _fail(plant, where, f"there is no library {shown(name)}; there are {', '.join(known)}")
            joined |= known[name]
        if len(joined) >= TERMS:
            _fail(plant, where, f"{len(joined)} functions; {TERMS - 1} are the most")
        found[where] = {name: _candidate(plant, where, text, place.term) for name, text in joined.items()}
    return found


@cache
def _common() -> Mapping[str, Library]:
    return named(check_library, check_name)(read_toml(COMMON, "install greygate again"), f"{COMMON}:")


def _candidate(plant: Plant, where: str, text: str, term: str) -> Candidate:
    signals = plant.closure.signals
    used = parse(text).names
    expression = replaced(text, {name: _enclosed(signals[name]) for name in used if name in signals})
    if term != "f":
        expression = replaced(term, {"f": f"({expression})"})
    for name in parse(expression).names:
        if name not in plant.symbols and not any(name == f"{seen}{s}" for seen in SEEN for s in _moving(plant)):
            _fail(plant, where, f"{shown(text)}: unknown name {shown(name)}; say in closure.signals what it stands for")
    return Candidate(expression, tuple(name for name in used if _varies(plant, signals.get(name, name))))


def _varies(plant: Plant, expression: str) -> bool:
    """Whether a symbol in the expression is a signal: no parameter, no limit of what was seen."""
    return any(name in plant.symbols and name not in plant.parameters for name in parse(expression).names)


def _moving(plant: Plant) -> tuple[str, ...]:
    """Symbols of which the limits seen in a recording are known to a function."""
    return (*plant.inputs, *plant.states)


def _enclosed(expression: str) -> str:
    """In brackets where it needs them inside another one."""
    return expression if isinstance(parse(expression).tree, Name | Number | FunctionCall) else f"({expression})"


def _fail(plant: Plant, where: str, problem: str) -> None:
    raise InputError(f"plant {plant.name}: closure.places.{where}: {problem}")
