"""Commands that bring a folder of `greygate compile` onto a board: board, play."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greygate.cli import options, words
from greygate.cli.terminal import Json, counting, following, give, say
from greygate.hardware.board.boards import BAUD, BOARDS, PORTS

if TYPE_CHECKING:
    import numpy as np

    from greygate.hardware.board.play import Played
    from greygate.hardware.build import Project

Board = StrEnum("Board", {name.upper(): name for name in BOARDS})  # type: ignore[misc]  # members that BOARDS lists
Line = StrEnum("Line", {name.upper(): name for name in PORTS})  # type: ignore[misc]  # members that PORTS lists
UART = Line("uart")


def board(
    name: Annotated[
        Board, typer.Argument(metavar="BOARD", help="; ".join(f"{name}: {b.title}" for name, b in BOARDS.items()))
    ],
    folder: words.Build,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder to write.")],
    architecture: Annotated[words.Architecture | None, words.ARCHITECTURE] = None,
    interface: Annotated[Line, typer.Option(help="How samples come to the board.")] = UART,
    mhz: Annotated[float | None, typer.Option(callback=options.MEGAHERTZ, help=words.MHZ.help)] = None,
    baud: Annotated[int, words.BAUD] = BAUD,
    tick: Annotated[bool, typer.Option("--tick", help="Begin the steps with the network's own period.")] = False,
    bitstream: Annotated[bool, typer.Option("--bitstream", help="Make the bitstream too: minutes.")] = False,
    as_json: Json = False,
) -> None:
    """Write what puts a build on a board.

    Pins, makefile, bench; with --bitstream that as well. The core is the folded one if the build has that, at the
    board's own clock. The folder stands on its own: `make` in it needs Yosys and nextpnr (or Vivado), and nothing of
    greygate.
    """
    from greygate.hardware.board.make import make
    from greygate.hardware.build import Project

    with following(f"{folder} on {name.value}") as progress:
        facts = make(
            Project.open(folder),
            name.value,
            out,
            architecture=architecture and architecture.value,
            port=interface.value,
            mhz=mhz,
            baud=baud,
            tick=tick,
            bitstream=bitstream,
            progress=progress,
        )
    lines = [f"{key.replace('_', ' ')}: {value}" for key, value in facts.items() if key != "cells"]
    lines += [f"  {cell}: {used}" for cell, used in facts.get("cells", {}).items()]
    give("board", {"folder": str(out)} | facts, as_json, [*lines, f"written to {out}"])
    if not facts.get("meets", True):
        reached, wanted = facts["reached_mhz"], facts["clock_mhz"]
        say(f"no bitstream: reaches {reached:.1f} MHz on this board, not {wanted:g}; give --mhz {int(reached)} or less")
        raise typer.Exit(1)


def play(
    folder: words.Build,
    recording: words.Scenario,
    port: Annotated[str, typer.Option(help="The serial port of the board, such as /dev/ttyUSB1.")],
    baud: Annotated[int, words.BAUD] = BAUD,
    as_json: Json = False,
) -> None:
    """Play a recording on a board; compare every bit.

    Exit code 1 if a bit differs.
    """
    from greygate.cli.printed import Playing
    from greygate.emulator.engine import run
    from greygate.hardware.board.play import opened
    from greygate.hardware.board.play import play as through
    from greygate.hardware.build import Project

    project = Project.open(folder)
    codes, clipped = _inputs(project, recording)
    answer = run(project.program, codes, states=False)
    with opened(port, baud) as line, counting(f"playing {recording}", len(codes)) as told:
        played = through(project.program, codes, answer.outputs, line, told)
    saturations = {name: count for name, count in answer.saturations.items() if count}
    result = Playing(**vars(played), saturations=saturations, clipped=clipped)
    give("play", result, as_json, _lines(played, saturations, clipped), not played.differing_bits)


def _inputs(project: "Project", recording: str) -> tuple["np.ndarray", dict[str, int]]:
    """Input codes of a recording, and how many values were clipped, by input."""
    values, _ = project.inputs(recording)
    clipped = {name: found.count for name, found in project.program.clipped(values).items()}
    return project.program.encode(values), clipped


def _lines(played: "Played", saturations: dict[str, int], clipped: dict[str, int]) -> list[str]:
    rate = played.samples / played.seconds
    verdict = played.mismatch or "every bit equal to the emulator"
    counted = f"saturations {saturations or 'none'}, clipped inputs {clipped or 'none'}"
    flags = f"resent {played.resent}, restarts {played.restarts}, overruns {played.overruns}"
    return [
        f"{played.samples} samples, differing bits {played.differing_bits}: {verdict}",
        f"{played.seconds:.1f} s, {rate:.0f} samples a second, {flags}, outputs at a limit {played.limited}",
        f"in the emulator: {counted}",
    ]
