"""The command that finds a network from recordings alone."""

from pathlib import Path
from typing import Annotated

import typer

from greygate.cli import options
from greygate.cli.backends import Backend, Scheduler, joblib_on
from greygate.cli.terminal import Json, following, give, recordings


def identify(
    record: Annotated[list[str], typer.Argument(metavar="RECORDINGS...", help="FILE.csv to train on.")],
    output: Annotated[str, typer.Option(help="The channel to predict in free run.")],
    out: Annotated[Path, typer.Option(help="Folder to write; its name becomes the network's.")],
    input: Annotated[list[str], typer.Option(help="A channel that drives the plant; several may be given.")] = [],
    test: Annotated[list[str], typer.Option(help="FILE.csv that is scored once, at the end.")] = [],
    sample_time: Annotated[
        float | None, typer.Option(callback=options.SECONDS, help="Seconds, for a file without a time column.")
    ] = None,
    settle: Annotated[
        int | None,
        typer.Option(callback=options.COUNT, help="First samples that only give the initial state; found if omitted."),
    ] = None,
    seconds: Annotated[float, typer.Option(callback=options.SECONDS, help="Time limit of the search.")] = 60.0,
    jobs: Annotated[
        int, typer.Option(callback=options.JOBS, help="Trainings side by side; dask uses all its workers.")
    ] = 2,
    backend: Annotated[Backend, typer.Option(help="Train on this computer, or on a cluster.")] = Backend.LOKY,
    scheduler: Scheduler = None,
    as_json: Json = False,
) -> None:
    """Find a network from recordings: look at them, fit linear models, grow networks from the best, choose by held-out
    blocks.

    Exit code 1 if no network predicts better than the mean of what was held out, or the chosen one diverges on a test.
    """
    from greygate.identify.files import identify_files, lines

    side_by_side = jobs if backend is Backend.LOKY else -1
    with joblib_on(backend, scheduler), following("identifying") as progress:
        found = identify_files(
            recordings(record), recordings(test), input, output, out,
            dt=sample_time, seconds=seconds, jobs=side_by_side, settle=settle, progress=progress,
        )  # fmt: skip
    give(
        "identify",
        found,
        as_json,
        [*lines(found), f"written to {found['out']}", *(f"next: {n}" for n in found["next"])],
    )
    if not found["better_than_mean"] or any(error is None for error in found["test"].values()):
        raise typer.Exit(1)
