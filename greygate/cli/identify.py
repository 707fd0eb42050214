"""The command that finds a network from recordings alone."""

from pathlib import Path
from typing import Annotated

import typer

from greygate.cli import words
from greygate.cli.backends import Backend, OnBackend, Scheduler, joblib_on
from greygate.cli.terminal import Json, following, give, recordings


def identify(
    record: words.Recordings,
    output: Annotated[str, words.OUTPUT],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder to write; its name becomes the network's.")],
    input: Annotated[list[str], words.INPUT] = [],
    test: Annotated[list[str], words.TEST] = [],
    sample_time: Annotated[float | None, words.SAMPLE_TIME] = None,
    settle: Annotated[str, words.SETTLE] = words.AUTO,
    seconds: Annotated[float, words.SECONDS] = 60.0,
    jobs: words.Jobs = 2,
    backend: OnBackend = Backend.LOKY,
    scheduler: Scheduler = None,
    as_json: Json = False,
) -> None:
    """Find a network from recordings alone.

    It fits linear models, grows networks from the best, and chooses by held-out blocks. Exit code 1 if no network
    predicts better than the mean of what was held out, or the chosen one diverges on a test.
    """
    from greygate.identify.files import identify_files, lines

    side_by_side = jobs if backend is Backend.LOKY else -1
    with joblib_on(backend, scheduler), following("identifying") as progress:
        found = identify_files(
            recordings(record), recordings(test), input, output, out,
            dt=sample_time, seconds=seconds, jobs=side_by_side, settle=words.settled(settle), progress=progress,
        )  # fmt: skip
    give(
        "identify",
        found,
        as_json,
        [*lines(found), f"written to {found['out']}", *(f"next: {n}" for n in found["next"])],
    )
    if not found["better_than_mean"] or any(error is None for error in found["test"].values()):
        raise typer.Exit(1)
