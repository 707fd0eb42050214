"""Commands about greygate itself: ci-template, doctor, schema."""

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from greygate import schemas
from greygate.cli import words
from greygate.cli.grammar import leaves, spelt
from greygate.cli.terminal import Json, give, print_out, recordings
from greygate.errors import InputError

if TYPE_CHECKING:
    from greygate.cli.printed import Doctor, Serving


class Service(StrEnum):
    GITHUB = "github"
    GITLAB = "gitlab"


def ci_template(
    context: typer.Context,
    service: Service,
    network: words.Network,
    options: Annotated[
        list[str] | None,
        typer.Argument(metavar="-- [ARGS]", help="Recordings and options of compile; of explore with --target."),
    ] = None,
    accepted: Annotated[str, typer.Option(help="Folder of the build whose figures you accept.")] = "accepted",
    budget: Annotated[Path, words.BUDGET] = Path("budget.toml"),
    install: Annotated[
        str | None, typer.Option(help="What pip installs there, such as a wheel in the repository.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.yml", help="File to write; the service's usual place if not given.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Write a workflow that guards a network in CI.

    It compiles, simulates every bit, synthesizes, reports, and fails where a figure grew beyond the budget, which is
    written if there is none. Run it in the repository's folder. An earlier workflow is replaced if greygate wrote it.
    """
    from greygate.export.ci import BUILD, write_workflow
    from greygate.machines.catalog import CATALOG
    from greygate.machines.source import Source

    making = [network, *(options or [])]
    if any(word.split("=")[0] in ("--out", "-o") for word in making):
        raise InputError(f"--out: the workflow compiles into {BUILD}; leave it out")
    root: Any = context.find_root().command
    how = "explore" if any(word.split("=")[0] == "--target" for word in making) else "compile"
    how, *making = spelt(root, [how, *making])
    given = root.commands[how].make_context(how, [*making, "--out", BUILD]).params
    source = Source(network, recordings([*given["record"], *given["held"]]))
    source.records()
    files = [*source.recordings.values(), *([] if network in CATALOG else [network])]
    kept = {} if install is None else {"install": install}
    found = write_workflow(service.value, [how, *making], files, accepted=accepted, budget=str(budget), out=out, **kept)
    give("ci-template", found, as_json, [f"written: {', '.join(found['written'])}", "then, once:", *found["next"]])


def doctor(as_json: Json = False) -> None:
    """List the tools that greygate uses, and what is missing.

    Exit code 1 if a command of the plain installation would fail.
    """
    from greygate import __version__
    from greygate.doctor import tools
    from greygate.pages.summary import aligned

    found = tools()
    rows = [
        {
            "name": tool.name,
            "version": tool.version or ("MISSING" if tool.needed else "not here"),
            "for": tool.needed_by,
            "remedy": "" if tool.version else tool.remedy,
        }
        for tool in found
    ]
    healthy = all(tool.version or not tool.needed for tool in found)
    verdict = "every command of the plain installation can run" if healthy else "some commands cannot run: see MISSING"
    result: Doctor = {"greygate": __version__, "healthy": healthy, "tools": found}
    lines = [f"greygate {__version__}", *aligned(rows, ("name", "version", "for", "remedy")), verdict]
    give("doctor", result, as_json, lines, healthy)


def app(
    context: typer.Context,
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="What it shows and writes into.")] = Path(),
    port: Annotated[int, typer.Option("--tcp", help="Port here; 0: any that is free.", min=0, max=65535)] = 0,
    as_json: Json = False,
) -> None:
    """Show a folder in the browser, and run commands by forms.

    It prints the address, which nobody else can guess, and serves this computer alone until Ctrl-C.
    """
    from greygate.app.server import serve

    if not folder.is_dir():
        raise InputError(f"{folder}: is no folder; give one that is there")
    root: Any = context.find_root().command

    def begun(address: str) -> None:
        result: Serving = {"folder": str(folder), "address": address}
        give("app", result, as_json, [address])

    serve(folder, leaves(root), port, begun)


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
