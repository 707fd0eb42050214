"""Writes dataclasses as plain JSON and reads them: each field is an entry, of the kind that its annotation names.

`Annotated[type, kind]` gives the kind itself (greygate/reading.py). A number, an enumeration, a tuple, a named tuple, a
table of texts and a dataclass each have one kind. So declaring a class is enough to write and read it, and to describe
it (greygate/schemas.py).
"""

from dataclasses import fields, is_dataclass
from enum import StrEnum
from functools import cache
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np

from greygate.errors import InputError
from greygate.names import check_text
from greygate.reading import Kind, listed, named, number, one_of, table, truth


def to_json(value: Any) -> Any:
    """A dataclass and its content as tables, lists and numbers of JSON; the first entry of an operation is its op."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, tuple | list):
        return [to_json(v) for v in value]
    if isinstance(value, dict):
        return {k: to_json(v) for k, v in value.items()}
    if is_dataclass(value):
        head = {"op": value.op.value} if hasattr(value, "op") else {}
        return head | {f.name: to_json(getattr(value, f.name)) for f in fields(value)}
    return value


@cache
def record(cls: type) -> Kind:
    """The kind of a table that has all fields of a dataclass, and no other entry except `op`."""
    hints = get_type_hints(cls, include_extras=True)
    kinds = {f.name: _kind(hints[f.name]) for f in fields(cls)}
    head = {"op": one_of([cls.op])} if hasattr(cls, "op") else {}

    def read(value: object, where: str) -> Any:
        found = table(value, where, head | kinds)
        return cls(**{name: found[name] for name in kinds})

    return read


def _kind(annotation: Any) -> Kind:
    inner = get_args(annotation)
    if get_origin(annotation) is Annotated:
        return next((note for note in inner[1:] if callable(note)), None) or _kind(inner[0])
    if get_origin(annotation) is tuple:
        elements = listed(_kind(inner[0]))
        return lambda value, where: tuple(elements(value, where))
    if get_origin(annotation) is dict:
        return named(check_text)
    if isinstance(annotation, type) and is_dataclass(annotation):
        return record(annotation)
    if issubclass(annotation, tuple):
        return _numbers(annotation)
    if issubclass(annotation, StrEnum):
        return one_of(annotation)
    return {bool: truth, float: number}[annotation]


def _numbers(cls: type) -> Kind:
    """The kind of a list that has an element for each field of a named tuple."""
    hints = get_type_hints(cls, include_extras=True)
    kinds = [_kind(hint) for hint in hints.values()]

    def read(value: object, where: str) -> Any:
        if not isinstance(value, list) or len(value) != len(kinds):
            raise InputError(f"{where}: give a list of {' and '.join(hints)}")
        return cls(*(kind(v, f"{where}[{i}]") for i, (kind, v) in enumerate(zip(kinds, value, strict=True))))

    return read
