"""The command that writes a workflow for a CI service."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from greygate.cli import words
from greygate.cli.grammar import spelt
from greygate.cli.terminal import Json, give, recordings
from greygate.errors import InputError


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
