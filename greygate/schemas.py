"""JSON Schemas (2020-12) of what greygate prints and writes, made from the types that declare it.

results.toml names every result and its type: a dataclass, a TypedDict, or an alias. A class's
docstring describes it, a text in `Annotated` a field; `Json` in `Annotated` adds keywords of JSON Schema. An
object says in `schema` which one it follows, "greygate/NAME/VERSION". A list, an object whose keys are names, and some
files have no place for that; docs/json.md lists them. A field is added without a new version; a field that goes, or
means something else, makes one.
"""

import json
import tomllib
import types
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import StrEnum
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired, Union, get_args, get_origin, get_type_hints, is_typeddict

import numpy as np

from greygate.errors import InputError, shown
from greygate.plain import Json, plain

DRAFT, PART = "https://json-schema.org/draft/2020-12/schema", "#/$defs/"
SCALARS = {str: "string", int: "integer", float: "number", bool: "boolean", types.NoneType: "null"}
FREE = (Any, object, np.ndarray)  # an array's `Annotated` says what is in it
Schema = dict[str, Any]
EXAMPLES, LISTED = (Path(__file__).with_name(name) for name in ("examples.json", "results.toml"))


@dataclass(frozen=True)
class Result:
    """A result, as results.toml says."""

    title: str
    declared: str
    marked: bool = True
    file: tuple[str, ...] | None = None
    version: int = 1


RESULTS = {name: Result(**told) for name, told in tomllib.loads(LISTED.read_text(encoding="utf-8")).items()}


def names() -> list[str]:
    """The names of all schemas."""
    return sorted(RESULTS)


@cache
def load(name: str) -> Schema:
    """A schema. Raises InputError for a name that none has."""
    if name not in RESULTS:
        raise InputError(f"no schema {shown(name)}; there are {', '.join(names())}")
    result, parts = RESULTS[name], dict[str, Schema]()
    module, _, kind = result.declared.partition(":")
    found = _Maker(parts).inline(getattr(import_module(f"greygate.{module}"), kind))
    head = {"$schema": DRAFT, "$id": f"urn:greygate:{name}:{result.version}", "title": result.title}
    if result.marked:
        for one in [parts[part["$ref"].removeprefix(PART)] for part in found.get("anyOf", ())] or [found]:
            one |= _marked(one, name, result)
    return head | found | {"$defs": parts, "examples": examples().get(name, [])}


@cache
def examples() -> dict[str, list]:
    """Name -> results that a command printed, their lists cut short."""
    return json.loads(EXAMPLES.read_text(encoding="utf-8"))


def _mark_of(name: str) -> str:
    return f"greygate/{name}/{RESULTS[name].version}"


def _marked(found: Schema, name: str, result: Result) -> Schema:
    """What an object has with the field `schema`; in a file it is not there, nor what only a printed result has."""
    return {
        "properties": {"schema": {"const": _mark_of(name)}} | found["properties"],
        "required": ["schema"] * (result.file is None) + found["required"],
        **({"dependentRequired": {"schema": list(result.file)}} if result.file else {}),
    }


def text(name: str, result: Any) -> str:
    """A result as the JSON that a command prints, without numpy and finite, with its schema where that has a place."""
    return json.dumps(marked(name, result), indent=1, allow_nan=False)


def marked(name: str, result: Any) -> Any:
    """A result as plain data that says which schema it follows."""
    found = plain(result)
    return {"schema": _mark_of(name)} | found if RESULTS[name].marked else found


class _Maker:
    """Makes schemas of types. parts: collects those of classes."""

    def __init__(self, parts: dict[str, Schema]):
        self.parts, self.kinds = parts, dict[str, type]()

    def of(self, hint: Any) -> Schema:
        origin, inner = get_origin(hint), get_args(hint)
        if origin is Annotated:
            return self._annotated(*inner)
        if origin is NotRequired:
            return self.of(inner[0])
        if origin is Literal:
            return {"const": inner[0]} if len(inner) == 1 else {"enum": list(inner)}
        if origin in (Union, types.UnionType):
            return self._any([self.of(one) for one in inner])
        if origin in (dict, Mapping):
            return self._named(*map(self.of, inner))
        if origin in (list, tuple):
            return self._listed(inner)
        if hint is dict:
            return {"type": "object"}
        return {} if hint in FREE else {"type": SCALARS[hint]} if hint in SCALARS else self._class(hint)

    def inline(self, hint: Any) -> Schema:
        """The schema without a reference to the class that it is of."""
        return self._body(hint) if is_typeddict(hint) or is_dataclass(hint) else self.of(hint)

    def _annotated(self, hint: Any, *notes: Any) -> Schema:
        words = {key: self._word(value) for note in notes if isinstance(note, Json) for key, value in note.items()}
        texts = [note for note in notes if isinstance(note, str)]
        told = {"description": texts[-1]} if texts else {}
        return (self.inline(hint) if words else self.of(hint)) | words | told

    def _word(self, value: Any) -> Any:
        """A keyword's value; a type stands for its schema."""
        return value if isinstance(value, str | int | float | list | dict) else self.of(value)

    def _any(self, found: list[Schema]) -> Schema:
        if all(one.keys() == {"type"} for one in found):
            listed = (one["type"] if isinstance(one["type"], list) else [one["type"]] for one in found)
            return {"type": list(dict.fromkeys(name for each in listed for name in each))}  # a Figure may be null
        if len(found) == 2 and found[1] == {"type": "null"} and isinstance(found[0].get("type"), str):
            return found[0] | {"type": [found[0]["type"], "null"]}
        return {"anyOf": found}

    def _named(self, key: Schema, value: Schema) -> Schema:
        found = {"type": "object"} | ({"additionalProperties": value} if value else {})
        return found if key.keys() == {"type"} else found | {"propertyNames": key}

    def _listed(self, inner: tuple) -> Schema:
        if len(inner) == 1 or inner[1] is ...:
            return {"type": "array", "items": self.of(inner[0])}
        parts = [self.of(one) for one in inner]
        return {"type": "array", "prefixItems": parts, "minItems": len(parts), "maxItems": len(parts)}

    def _class(self, kind: type) -> Schema:
        if issubclass(kind, StrEnum):
            return {"enum": [member.value for member in kind]}
        if self.kinds.setdefault(kind.__name__, kind) is not kind:
            raise TypeError(f"{kind} and {self.kinds[kind.__name__]} have one name")
        if kind.__name__ not in self.parts:
            self.parts[kind.__name__] = {}  # its place, should it hold itself
            self.parts[kind.__name__] |= self._body(kind)
        return {"$ref": f"{PART}{kind.__name__}"}

    def _body(self, kind: Any) -> Schema:
        """What a class is described by, and an object of its fields, or the list that a named tuple is."""
        doc = " ".join((kind.__doc__ or "").partition(">>>")[0].split())
        told = {"description": doc} if doc and not doc.startswith(f"{kind.__name__}(") else {}
        hints = get_type_hints(kind, include_extras=True)
        if issubclass(kind, tuple):
            return told | self._listed(tuple(hints.values()))
        return told | self._fields(kind, hints if is_typeddict(kind) else {f.name: hints[f.name] for f in fields(kind)})

    def _fields(self, kind: Any, hints: dict[str, Any]) -> Schema:
        """An object; that of an operation begins with its `op`."""
        head = {"op": {"const": kind.op.value}} if hasattr(kind, "op") else {}
        found = head | {name: self.of(hint) for name, hint in hints.items()}
        needed = [name for name in found if name in getattr(kind, "__required_keys__", found)]
        return {"type": "object", "properties": found, "required": needed, "additionalProperties": False}
