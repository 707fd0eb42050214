"""Strict readers of what a TOML or JSON file holds: every entry is of its kind, none is missing, none is unknown.

A kind is a function (value, where) -> value. It raises InputError in one line that begins with `where`, the file and
the entry, such as "mine.toml: inputs[0].scale". The checks of `greygate.names` are kinds too.
"""

import json
import math
from collections.abc import Callable, Mapping
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType

import numpy as np

from greygate.contents import contents
from greygate.errors import InputError
from greygate.names import check_path, shown

Kind = Callable[[object, str], object]
NONE: Mapping[str, Kind] = MappingProxyType({})


def table(value: object, where: str, needed: Mapping[str, Kind], optional: Mapping[str, Kind] = NONE) -> dict:
    """Entries by name, each as its kind gives it. where: ends with ":" at the head of a file."""
    kinds = {**needed, **optional}
    if not isinstance(value, dict):
        raise InputError(f"{where} {shown(value)} is not a table; give {', '.join(kinds)}")
    for name in value:
        if name not in kinds:
            raise InputError(f"{entry_of(where, shown(name))}: there is no such entry; known are {', '.join(kinds)}")
    for name in needed:
        if name not in value:
            raise InputError(f"{entry_of(where, name)} is missing; add it")
    return {name: kind(value[name], entry_of(where, name)) for name, kind in kinds.items() if name in value}


def named(kind: Kind) -> Kind:
    """A table whose entries the user names, all of one kind."""

    def read(value: object, where: str) -> dict:
        if not isinstance(value, dict):
            raise InputError(f"{where} {shown(value)} is not a table; give NAME = ...")
        return {check_path(name, where): kind(entry, entry_of(where, name)) for name, entry in value.items()}

    return read


def listed(kind: Kind) -> Kind:
    """A list of one kind."""

    def read(value: object, where: str) -> list:
        if not isinstance(value, list):
            raise InputError(f"{where} {shown(value)} is not a list; put it in [ ]")
        return [kind(entry, f"{where}[{i}]") for i, entry in enumerate(value)]

    return read


def number(value: object, where: str) -> float:
    """A finite number."""
    try:
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    except OverflowError:  # an integer beyond every float
        pass
    raise InputError(f"{where} {shown(value)} is not a finite number; mend it")


def whole(low: int, high: int) -> Kind:
    """A whole number from low to high."""

    def read(value: object, where: str) -> int:
        if type(value) is not int or not low <= value <= high:
            raise InputError(f"{where} {shown(value)} is not a whole number >= {low} and <= {high}; mend it")
        return value

    return read


def truth(value: object, where: str) -> bool:
    """true or false."""
    if not isinstance(value, bool):
        raise InputError(f"{where} {shown(value)} is neither true nor false; mend it")
    return value


def one_of(choices: type[StrEnum]) -> Kind:
    """A member of an enumeration, by its value."""

    def read(value: object, where: str) -> StrEnum:
        if value not in [*choices]:
            raise InputError(f"{where} {shown(value)} does not exist; choose {', '.join(choices)}")
        return choices(value)

    return read


def array(value: object, where: str) -> np.ndarray:
    """Finite numbers, one, a list of them (n,), or a list of such lists of one length (m, n): float64."""
    if not isinstance(value, list):
        return np.array(number(value, where))
    rows = listed(listed(number) if value and isinstance(value[0], list) else number)(value, where)
    if len({len(row) for row in rows if isinstance(row, list)}) > 1:
        raise InputError(f"{where}: its rows differ in length; mend it")
    return np.array(rows, float)


def json_data(path: Path) -> object:
    """What a JSON file holds; InputError where it cannot be read, or names an entry twice."""
    try:
        return json.loads(contents(path), object_pairs_hook=_unrepeated)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check the path") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not a readable JSON file ({shown(str(error))}); write it again") from None


def _unrepeated(pairs: list[tuple[str, object]]) -> dict:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        raise InputError(f"the entry {shown(next(n for n in names if names.count(n) > 1))} stands twice; remove one")
    return found


def entry_of(where: str, name: str) -> str:
    """Where the entry `name` of the table at `where` stands."""
    return f"{where} {name}" if where.endswith(":") else f"{where}.{name}"
