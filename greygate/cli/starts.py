"""The commands that write files to start from: init and init-rig."""

from pathlib import Path
from typing import Annotated

import typer

from greygate.cli import options, words
from greygate.cli.terminal import Json, give

Outputs = Annotated[list[str], words.OUTPUT]
Inputs = Annotated[list[str], words.INPUT]


def init(
    recording: words.Recording,
    output: Outputs,
    out: Annotated[Path, typer.Option(metavar="NAME", help="File to write: NAME.toml, which must not be there.")],
    input: Inputs = [],
    block: Annotated[
        list[str],
        typer.Option(metavar="NAME", help="Library network ahead of each curve, such as absolute."),
    ] = [],
    order: Annotated[
        int, typer.Option(callback=options.ORDER, help="Past samples of its own that an output reads.")
    ] = 2,
    python: Annotated[bool, typer.Option("--python", help="Write NAME.py, which makes NAME.toml.")] = False,
    as_json: Json = False,
) -> None:
    """Write a structured network to start from.

    It has limits, curves and linear dynamics on the channels of a recording, in its units and with its sample time. All
    other channels are inputs if none is given.
    """
    from greygate.identify.starting import init as write

    found = write(out, str(recording), input, output, block, order, python)
    give("init", found, as_json, [*(f"written to {file}" for file in found["written"]), f"next: {found['next']}"])


def init_rig(
    recording: words.Recording,
    output: Outputs,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder to write; it must not be there.")],
    input: Inputs = [],
    as_json: Json = False,
) -> None:
    """Write a rig to start from.

    That is rig.toml, the recordings, and a placeholder plant to be replaced. All other channels are inputs if none is
    given.
    """
    from greygate.mismatch.starting import init_rig as write

    found = write(out, str(recording), input, output)
    give("init-rig", found, as_json, [*(f"written to {file}" for file in found["written"]), f"next: {found['next']}"])
