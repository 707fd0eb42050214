"""A form for each command, made from its own declaration, and the command line that its values give."""

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import PurePosixPath, PureWindowsPath
from types import UnionType
from typing import Any, get_args, get_origin

from greygate.errors import InputError, shown

HIDDEN = ("--help", "--json")


@dataclass(frozen=True)
class Field:
    """An argument or option. word: as it is typed, empty for an argument; off: the word that takes a flag back.

    kind: "text", "number", "flag", "choice" or "list" (one value a line).
    """

    name: str
    word: str
    off: str
    kind: str
    choices: tuple[str, ...]
    metavar: str
    help: str
    default: str
    required: bool


@dataclass(frozen=True)
class Form:
    """A command. name: as it is typed."""

    name: str
    help: str
    fields: tuple[Field, ...]

    @classmethod
    def of(cls, name: str, command: Any) -> "Form":
        """The form of a command of the command line."""
        fields = tuple(_field(p) for p in command.params if not {*HIDDEN} & {*p.opts})
        return cls(name, command.help or "", fields)

    def words(self, values: Mapping[str, object]) -> list[str]:
        """What follows `greygate` for these values, name -> text. Raises InputError for a value that does not fit."""
        known = {field.name for field in self.fields}
        if strange := [name for name in values if name not in known]:
            raise InputError(f"{self.name}: no field {shown(strange[0])}; reload the page")
        options, arguments = [*self.name.split()], list[str]()
        for field in self.fields:
            given = values.get(field.name, "")
            if not isinstance(given, str):
                raise InputError(f"{_title(field)}: {shown(given)} is no text; reload the page")
            found = [_checked(field, line.strip()) for line in given.splitlines() if line.strip()]
            if field.required and not found:
                raise InputError(f"{_title(field)}: is missing; fill it in")
            if field.kind == "flag":
                options += [w for w in ({"yes": field.word, "no": field.off}.get(value, "") for value in found) if w]
            elif field.word:
                options += [w for value in found if value != field.default for w in (field.word, value)]
            else:
                arguments += found
        return options + arguments


def line(words: list[str]) -> str:
    """The command line to copy."""
    return shlex.join(["greygate", *words])


def _field(parameter: Any) -> Field:
    kinds = _kinds(parameter.type_descriptor.annotation)
    choices = next((tuple(str(m.value) for m in k) for k in kinds if isinstance(k, type) and issubclass(k, Enum)), ())
    if getattr(parameter, "is_flag", False):
        kind = "flag"
    elif parameter.multiple or parameter.nargs == -1:
        kind = "list"
    else:
        kind = "choice" if choices else "number" if {int, float} & {*kinds} else "text"
    option = parameter.param_type_name == "option"
    word, off = (
        next((w for w in words if w.startswith("--")), "") for words in (parameter.opts, parameter.secondary_opts)
    )
    default = parameter.default
    default = str(getattr(default, "value", default)) if isinstance(default, str | int | float | Enum) else ""
    return Field(
        parameter.name, word if option else "", off, kind, choices, parameter.metavar or "", parameter.help or "",
        {"True": "yes", "False": ""}.get(default, default) if kind == "flag" else default, parameter.required,
    )  # fmt: skip


def _kinds(annotation: Any) -> list[Any]:
    """The plain types in an annotation."""
    if get_origin(annotation) is None and not isinstance(annotation, UnionType):
        return [annotation]
    return [kind for inner in get_args(annotation) for kind in _kinds(inner)]


def _title(field: Field) -> str:
    return field.word or field.metavar or field.name


def _checked(field: Field, value: str) -> str:
    """A value that may be said: of the choices, no option in disguise, no path that leaves the folder."""
    if field.choices and field.kind == "choice" and value not in field.choices:
        raise InputError(f"{_title(field)}: {shown(value)} is none of {', '.join(field.choices)}")
    if value.startswith("-") and field.kind != "number":
        raise InputError(
            f"{_title(field)}: {shown(value)} begins as an option does; write ./ before the name of a file"
        )
    for part in value.split("="):
        windows = PureWindowsPath(part)
        if (
            ".." in (*PurePosixPath(part).parts, *windows.parts)
            or part.startswith("/")
            or windows.anchor
            or part[:1] == "~"
        ):
            raise InputError(f"{_title(field)}: {shown(value)} leads out of the folder; name what lies in it")
    return value
