"""Schemas of the JSON that greygate prints and writes: NAME.schema.json in this folder, JSON Schema of 2020-12.

An object says in `schema` which one it follows, "greygate/NAME/VERSION". A list, an object whose keys are names, and
some files have no place for that; docs/json.md lists them. A field is added without a new version; a field that
goes, or means something else, makes one.
"""

import json
from functools import cache
from pathlib import Path
from typing import Any

from greygate.errors import InputError, shown

ENDING = ".schema.json"
FOLDER = Path(__file__).parent


def names() -> list[str]:
    """The names of all schemas."""
    return sorted(path.name.removesuffix(ENDING) for path in FOLDER.glob(f"*{ENDING}"))


@cache
def load(name: str) -> dict[str, Any]:
    """A schema. Raises InputError for a name that none has."""
    if name not in names():
        raise InputError(f"no schema {shown(name)}; there are {', '.join(names())}")
    return json.loads((FOLDER / f"{name}{ENDING}").read_text(encoding="utf-8"))


def text(name: str, result: Any) -> str:
    """A result as the JSON that a command prints, without numpy and finite, with its schema where that has a place."""
    return json.dumps(marked(name, result), indent=1, allow_nan=False)


def marked(name: str, result: Any) -> Any:
    """A result as plain data that says which schema it follows."""
    from greygate.plain import plain

    own = load(name).get("properties", {}).get("schema")
    return ({"schema": own["const"]} if own else {}) | plain(result)
