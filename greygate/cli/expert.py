"""The command that builds a network from a plant's file."""

from pathlib import Path
from typing import Annotated

import typer

from greygate.cli import words
from greygate.cli.terminal import Json, finite, following, give, recordings


def build_snn(
    plant: words.Plant,
    record: words.Recordings,
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder for NAME.toml, .safetensors, .json and NAME.decisions.txt.")
    ],
    test: Annotated[list[str], words.TEST] = [],
    sensor: Annotated[
        list[str], typer.Option(metavar="CHANNEL", help="An output of the plant that is measured in the field too.")
    ] = [],
    output: Annotated[list[str], words.OUTPUT] = [],
    seconds: Annotated[float, words.SECONDS] = float("inf"),
    as_json: Json = False,
) -> None:
    """Build a structured network from a plant's equations.

    It says what was decided and why. Without --test the end of each recording judges; without --output every output on
    record that is no sensor's is predicted. Exit code 1 if the plant's own simulation is better on what was kept to
    test on; the network is written then too.
    """
    from greygate.identify.expert.files import build_files

    with following("building") as progress:
        found = build_files(plant, recordings(record), recordings(test), sensor, output, seconds, out, progress)
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
