"""The command that builds a network from a plant's file."""

from pathlib import Path
from typing import Annotated

import typer

from greygate.cli import options
from greygate.cli.terminal import Json, finite, following, give, recordings


def build_snn(
    plant: Annotated[Path, typer.Argument(help="A plant's TOML file, a rig.toml, or a folder with one.")],
    record: Annotated[list[str], typer.Argument(metavar="RECORDINGS...", help="FILE.csv to train on.")],
    out: Annotated[Path, typer.Option(help="Folder for NAME.toml, .safetensors, .json and NAME.decisions.txt.")],
    test: Annotated[
        list[str], typer.Option(help="FILE.csv to judge the result on; else the end of each recording.")
    ] = [],
    sensor: Annotated[list[str], typer.Option(help="An output of the plant that is measured in the field too.")] = [],
    target: Annotated[
        list[str], typer.Option(help="An output to predict; every other one on record if not given.")
    ] = [],
    seconds: Annotated[float, typer.Option(callback=options.SECONDS, help="Time limit.")] = float("inf"),
    as_json: Json = False,
) -> None:
    """Build a structured network from a plant's equations and recordings, and say what was decided and why.

    Exit code 1 if the plant's own simulation is better on what was kept to test on; the network is written then too.
    """
    from greygate.identify.expert.files import build_files

    with following("building") as progress:
        found = build_files(plant, recordings(record), recordings(test), sensor, target, seconds, out, progress)
    lines = [str(line) for line in found["text"]]
    for name, by_target in found["rms"]["network"].items():
        for port, error in by_target.items():
            others = ", ".join(f"{who} {finite(found['rms'][who][name][port], '.4g')}" for who in ("nominal", "linear"))
            lines.append(f"{name:12} {port:10} RMSE {finite(error, '.4g')} ({others})")
    give(
        "build-snn",
        {n: v for n, v in found.items() if n != "text"},
        as_json,
        [*lines, f"written to {found['out']}", found["next"]],
    )
    if not found["better"]:
        raise typer.Exit(1)
