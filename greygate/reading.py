"""Reads TOML and JSON files, which anyone may have written: the result is plain data of known kinds, or an InputError.

`read_toml` and `read_json` return the content of a file. A kind then checks an entry: it is a function
(value, where) -> value, which raises InputError in one line. The line begins with `where`, the file and the entry, such
as "mine.toml: inputs[0].scale". The checks of `greygate.names` are kinds too.
"""

import json
import math
import tomllib
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from difflib import get_close_matches
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from greygate.contents import contents
from greygate.errors import InputError, shown
from greygate.names import check_path

DEEPEST = 64  # tables and lists inside one another: three times what the deepest network needs
LIKE = 0.75  # similarity (difflib) from which a known entry is suggested for an unknown one

Kind = Callable[[Any, str], Any]
NONE: Mapping[str, Kind] = MappingProxyType({})


# -- files -----------------------------------------------------------------------------------------------------------


def read_toml(path: Path | str, wish: str, data: bytes | None = None) -> dict:
    """Return the tables of a TOML file. wish: what the user should do if the file cannot be read.

    data: the bytes of the file, if it was read before. Raises InputError naming the file, and the place that is not
    TOML.
    """
    return _read(path, "TOML", tomllib.loads, wish, data)


def read_json(path: Path | str, wish: str) -> Any:
    """Return the value of a JSON file. wish: as in `read_toml`.

    Raises InputError naming the file, and the place that is not JSON.
    """
    return _read(path, "JSON", lambda text: json.loads(text, object_pairs_hook=_unrepeated), wish)


def _read(path: Path | str, format: str, parse: Callable, wish: str, data: bytes | None = None) -> Any:
    try:
        value = parse((contents(path) if data is None else data).decode("utf-8-sig"))
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); {wish}") from None
    except RecursionError:
        raise InputError(f"{path}: entries are nested more than {DEEPEST} deep; {wish}") from None
    except ValueError as error:  # TOMLDecodeError, JSONDecodeError, UnicodeDecodeError, a number of 5,000 digits
        raise InputError(f"{path}: is not {format} ({shown(str(error))[1:-1]}); {wish}") from None
    if _deeper(value, DEEPEST):
        raise InputError(f"{path}: entries are nested more than {DEEPEST} deep; {wish}")
    return value


def _deeper(value: object, depth: int) -> bool:
    """Whether tables and lists stand more than `depth` deep inside one another."""
    level = [value]
    for _ in range(depth + 1):
        level = [
            inner
            for outer in level
            if isinstance(outer, dict | list)
            for inner in (outer.values() if isinstance(outer, dict) else outer)
            if isinstance(inner, dict | list)
        ]
    return bool(level)


def _unrepeated(pairs: list[tuple[str, object]]) -> dict:
    found = dict(pairs)
    if len(found) < len(pairs):
        counts = Counter(name for name, _ in pairs)
        raise ValueError(f"the entry {shown(counts.most_common(1)[0][0])} appears twice")
    return found


# -- kinds -----------------------------------------------------------------------------------------------------------


def table(
    value: object, where: str, needed: Mapping[str, Kind], optional: Mapping[str, Kind] = NONE, others: bool = False
) -> dict:
    """Check a table: return its entries by name, each as its kind returns it. where: ends with ":" for a whole file.

    others: allow and ignore other entries, except those that look like a misspelt known one.
    """
    kinds = {**needed, **optional}
    if not isinstance(value, dict):
        raise InputError(f"{where} {shown(value)} is not a table; give {', '.join(kinds)}")
    for name in value:
        near = [] if name in kinds else get_close_matches(name, kinds, 1, LIKE)
        if near or not (name in kinds or others):
            meant = f"write {near[0]} if that is meant" if near else f"known are {', '.join(kinds)}"
            raise InputError(f"{entry_of(where, shown(name))}: there is no such entry; {meant}")
    for name in needed:
        if name not in value:
            raise InputError(f"{entry_of(where, name)} is missing; add it")
    return {name: kind(value[name], entry_of(where, name)) for name, kind in kinds.items() if name in value}


def named(kind: Kind, name: Kind = check_path) -> Kind:
    """A table with entries that the user names, all of one kind. name: the kind of the names."""

    def read(value: object, where: str) -> dict:
        if not isinstance(value, dict):
            raise InputError(f"{where} {shown(value)} is not a table; give NAME = ...")
        return {name(key, where): kind(entry, entry_of(where, key)) for key, entry in value.items()}

    return read


def listed(kind: Kind) -> Callable[[object, str], list]:
    """A list of one kind."""

    def read(value: object, where: str) -> list:
        if not isinstance(value, list):
            raise InputError(f"{where} {shown(value)} is not a list; put it in [ ]")
        return [kind(entry, f"{where}[{i}]") for i, entry in enumerate(value)]

    return read


def maybe(kind: Kind) -> Kind:
    """null, or an entry of that kind."""
    return lambda value, where: None if value is None else kind(value, where)


def anything(value: object, where: str) -> object:
    """Any value; the code that uses it checks it."""
    return value


def line(value: object, where: str) -> str:
    """One line of text, of any length or empty."""
    if not (isinstance(value, str) and value.isprintable()):
        raise InputError(f"{where} {shown(value)} is not a line of text; write one in quotes")
    return value


def number(value: object, where: str) -> float:
    """A finite number."""
    try:
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    except OverflowError:  # an integer beyond every float
        pass
    raise InputError(f"{where} {shown(value)} is not a finite number; correct it")


def within(low: float, high: float, wish: str) -> Kind:
    """A finite number from low to high. wish: what to give instead of another number."""

    def read(value: object, where: str) -> float:
        found = number(value, where)
        if not low <= found <= high:
            raise InputError(f"{where} {shown(value)} is too {'small' if found < low else 'large'}; {wish}")
        return found

    return read


def whole(low: int, high: float = math.inf) -> Kind:
    """A whole number from low to high."""

    def read(value: object, where: str) -> int:
        if type(value) is not int or not low <= value <= high:
            raise InputError(f"{where} {shown(value)} is not a whole number >= {low} and <= {high}; correct it")
        return value

    return read


def truth(value: object, where: str) -> bool:
    """true or false."""
    if not isinstance(value, bool):
        raise InputError(f"{where} {shown(value)} is neither true nor false; correct it")
    return value


def one_of(choices: type[StrEnum] | Collection[str]) -> Kind:
    """One of these texts, or a member of an enumeration by its value."""

    def read(value: object, where: str) -> str:
        for choice in choices:
            if value == choice:
                return choice
        raise InputError(f"{where} {shown(value)} does not exist; choose {', '.join(map(str, choices))}")

    return read


def array(value: object, where: str) -> np.ndarray:
    """Finite numbers as float64: one number (), a list (n,), or a list of lists of equal length (m, n)."""
    if not isinstance(value, list):
        return np.array(number(value, where))
    rows = listed(listed(number) if value and isinstance(value[0], list) else number)(value, where)
    if len({len(row) for row in rows if isinstance(row, list)}) > 1:
        raise InputError(f"{where}: its rows differ in length; correct it")
    return np.array(rows, float)


def entry_of(where: str, name: str) -> str:
    """The place of the entry `name` in the table at `where`."""
    return f"{where} {name}" if where.endswith(":") else f"{where}.{name}"
