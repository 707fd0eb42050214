"""The command that writes a workflow for a CI service."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from greygate.cli.networks import Network
from greygate.cli.terminal import Json, give, recordings
from greygate.errors import InputError


class Service(StrEnum):
    GITHUB = "github"
    GITLAB = "gitlab"


def ci_template(
    context: typer.Context,
    service: Service,
    network: Network,
    options: Annotated[
        list[str] | None,
        typer.Argument(metavar="-- [OPTIONS]", help="Options of `greygate compile`, such as -- --record train.csv."),
    ] = None,
    accepted: Annotated[str, typer.Option(help="Folder of the build whose figures you accept.")] = "accepted",
    budget: Annotated[
        str, typer.Option(help="Budget of `greygate compare`; written if there is none.")
    ] = "budget.toml",
    install: Annotated[
        str | None, typer.Option(help="What pip installs there, such as a wheel in the repository.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File to write; the service's usual place if not given.")] = None,
    as_json: Json = False,
) -> None:
    """Write a workflow: compile, simulate every bit, synthesize, report, and fail where a figure grew beyond a budget.

    Run it in the repository's folder. An earlier workflow is replaced if greygate wrote it.
    """
    from greygate.export.ci import BUILD, write_workflow
    from greygate.machines.catalog import CATALOG
    from greygate.machines.source import Source

    words = [network, *(options or [])]
    if any(word.startswith("--out") for word in words):
        raise InputError(f"--out: the workflow compiles into {BUILD}; leave it out")
    command = context.find_root().command.commands["compile"]  # type: ignore[attr-defined]
    given = command.make_context("compile", [*words, "--out", BUILD]).params
    source = Source(network, recordings([*given["record"], *given["held"]]))
    source.records()
    files = [*source.recordings.values(), *([] if network in CATALOG else [network])]
    kept = {} if install is None else {"install": install}
    found = write_workflow(service.value, words, files, accepted=accepted, budget=budget, out=out, **kept)
    give("ci-template", found, as_json, [f"written: {', '.join(found['written'])}", "then, once:", *found["next"]])
