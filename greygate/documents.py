"""TOML and JSON files, which anyone may have written: plain data comes out of them, or one InputError."""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path

from greygate.errors import InputError

LARGEST = 1 << 26  # bytes: a hundred times the largest file that greygate writes
DEEPEST = 64  # tables and lists inside one another: three times what the deepest network needs


def read_toml(path: Path | str, wish: str) -> dict:
    """The tables of a TOML file. wish: what the user is to give instead of a file that cannot be read.

    Raises InputError naming the file, and the line where TOML ends.
    """
    return _read(path, "TOML", tomllib.loads, wish)


def read_json(path: Path | str, wish: str) -> object:
    """The value of a JSON file. wish: as in `read_toml`. Raises InputError naming the file, and where JSON ends."""
    return _read(path, "JSON", json.loads, wish)


def _read(path: Path | str, kind: str, parse: Callable, wish: str):
    path = Path(path)
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST + 1)
        if len(data) > LARGEST:
            raise InputError(f"{path}: is larger than {LARGEST >> 20} MiB; {wish}")
        value = parse(data.decode("utf-8-sig"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); {wish}") from None
    except RecursionError:
        raise InputError(f"{path}: entries are nested more than {DEEPEST} deep; {wish}") from None
    except ValueError as error:  # TOMLDecodeError, JSONDecodeError, UnicodeDecodeError, a number of 5,000 digits
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is no {kind} ({error}); {wish}") from None
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
