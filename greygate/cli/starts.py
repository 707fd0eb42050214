"""The commands that write files to start from: init and init-rig."""

from pathlib import Path
from typing import Annotated

import typer

from greygate.cli import options
from greygate.cli.terminal import Json, give

Record = Annotated[str, typer.Option(help="FILE.csv whose channels, units and sample time are taken.")]
Outputs = Annotated[list[str], typer.Option(help="A channel to predict; several may be given.")]
Inputs = Annotated[list[str], typer.Option(help="A channel that drives it; all others, if none is given.")]


def init(
    new_name: Annotated[Path, typer.Argument(metavar="NAME", help="Name of the network; NAME.toml must not be there.")],
    record: Record,
    output: Outputs,
    input: Inputs = [],
    block: Annotated[
        list[str], typer.Option(help="Library network of one input ahead of each curve, such as absolute.")
    ] = [],
    order: Annotated[
        int, typer.Option(callback=options.ORDER, help="Past samples of its own that an output reads.")
    ] = 2,
    python: Annotated[bool, typer.Option("--python", help="Write NAME.py, which makes NAME.toml.")] = False,
    as_json: Json = False,
) -> None:
    """Write a structured network to start from: limits, curves and linear dynamics on the channels of a recording."""
    from greygate.identify.starting import init as write

    found = write(new_name, record, input, output, block, order, python)
    give("init", found, as_json, [*(f"written to {file}" for file in found["written"]), f"next: {found['next']}"])


def init_rig(
    new_name: Annotated[Path, typer.Argument(metavar="NAME", help="Folder to write; it must not be there.")],
    record: Record,
    output: Outputs,
    input: Inputs = [],
    as_json: Json = False,
) -> None:
    """Write a rig folder to start from: rig.toml, the recordings, and a placeholder plant to be replaced."""
    from greygate.mismatch.starting import init_rig as write

    found = write(new_name, record, input, output)
    give("init-rig", found, as_json, [*(f"written to {file}" for file in found["written"]), f"next: {found['next']}"])
