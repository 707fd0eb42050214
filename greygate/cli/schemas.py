"""The command that shows the schemas of greygate's JSON: schema."""

import json
from typing import Annotated

import typer

from greygate import schemas
from greygate.cli.terminal import Json, give, print_out


def named(begun: str) -> list[str]:
    """For the shell's completion: names of schemas that begin so."""
    return [name for name in schemas.names() if name.startswith(begun)]


def schema(
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", help="Of a schema; all are listed if not given.", autocompletion=named),
    ] = None,
    as_json: Json = False,
) -> None:
    """Print the JSON Schema of a result, or list them.

    A result is what a command prints with --json, or a file that greygate writes.
    """
    if name is None:
        found = {name: schemas.load(name)["title"] for name in schemas.names()}
        give("catalogue", found, as_json, [f"{name:22} {title}" for name, title in found.items()])
    else:
        print_out(json.dumps(schemas.load(name), indent=1, ensure_ascii=False))
