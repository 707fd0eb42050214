"""What a TOML or JSON file holds, checked by kind: every entry of another kind is refused, with file and entry."""

import json
import math
import tomllib
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import NoReturn

from greygate.contents import contents
from greygate.errors import InputError

SHOWN = 60  # characters of a value in a message
LIKE = 0.75  # as much alike (difflib) are an unknown entry and the one that may be meant


def shown(value) -> str:
    """A value as a message shows it: quoted, on one line, not long."""
    try:
        quoted = repr(value)
    except (RecursionError, ValueError):  # nested too deep, or a whole number of too many digits
        return f"a {type(value).__name__} too large to show"
    return quoted if len(quoted) <= SHOWN else f"{quoted[: SHOWN - 3]}..."


def named(where: str) -> str:
    """The name of an entry as a message says it: printable, not long."""
    text = where if where.isprintable() else ascii(where)[1:-1]
    return text if len(text) <= 2 * SHOWN else f"{text[: 2 * SHOWN - 3]}..."


def read_toml(path: Path | str, wish: str) -> dict:
    """The table of a TOML file. Raises InputError where there is none, with `wish`, what to give."""
    return _read(path, tomllib.loads, "TOML", wish)


def read_json(path: Path | str, wish: str):
    """The content of a JSON file. Raises InputError where there is none, with `wish`, what to give."""
    return _read(path, json.loads, "JSON", wish)


def _read(path: Path | str, loads, kind: str, wish: str):
    try:
        return loads(contents(path).decode("utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); {wish}") from None
    except RecursionError:
        raise InputError(f"{path}: is nested too deep; {wish}") from None
    except ValueError as error:  # of the syntax, the encoding, or a whole number of thousands of digits
        raise InputError(f"{path}: is no {kind} ({shown(str(error))[1:-1]}); {wish}") from None


@dataclass(frozen=True)
class Entries:
    """The checks of one file's entries; each returns the entry. where: its name, "parameters.mass"."""

    path: Path | str

    def fail(self, where: str, problem: str) -> NoReturn:
        raise InputError(f"{self.path}: {named(where)}: {problem}")

    def text(self, where: str, value, known: Collection[str] = ()) -> str:
        """One line of text; one of `known` where these are given."""
        if not isinstance(value, str):
            self.fail(where, f"{shown(value)} is no text; write it in quotes")
        if not value.isprintable():
            self.fail(where, f"{shown(value)} holds a character that cannot be printed; write one plain line")
        if known and value not in known:
            self.fail(where, f"{shown(value)}; give {', '.join(known)}")
        return value

    def number(
        self, where: str, value, low: float = -math.inf, high: float = math.inf, wish: str = "write a finite number"
    ) -> float:
        """A finite number from `low` to `high`."""
        number = math.nan
        if type(value) in (int, float):
            with suppress(OverflowError):
                number = float(value)
        if not math.isfinite(number):
            self.fail(where, f"{shown(value)} is no number; {wish}")
        if not low <= number <= high:
            self.fail(where, f"{shown(value)}; {wish}")
        return number

    def table(self, where: str, value, known: Collection[str] = (), needed: Collection[str] = ()) -> dict:
        """A table; of entries among `known` where these are given, and with those that are `needed`."""
        if not isinstance(value, Mapping):
            self.fail(where, f"{shown(value)} is no table; write [{where}] or {{ ... }}")
        for key in value if known else ():
            if key not in known:
                near = get_close_matches(key, known, 1, LIKE)
                meant = f"write {near[0]} if that is meant" if near else f"there are {', '.join(known)}"
                self.fail(f"{where}.{key}" if where else key, f"is no entry; {meant}")
        for key in needed:
            if key not in value:
                self.fail(where, f"{key!r} is missing")
        return dict(value)

    def texts(self, where: str, value) -> tuple[str, ...]:
        """A list of texts."""
        if not isinstance(value, list | tuple):
            self.fail(where, f'{shown(value)} is no list; write ["...", ...]')
        return tuple(self.text(f"{where}[{i}]", text) for i, text in enumerate(value))

    def numbers(self, where: str, value) -> tuple[float, ...]:
        """A list of finite numbers."""
        if not isinstance(value, list | tuple):
            self.fail(where, f"{shown(value)} is no list; write [1.0, ...]")
        return tuple(self.number(f"{where}[{i}]", number) for i, number in enumerate(value))
