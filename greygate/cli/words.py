"""The words that several commands share: one word has one type and one meaning.

Recordings are positional, a result is `--out`, a page is `--html`; the first and the last say in each command of what.
"""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from greygate.cli import options
from greygate.compiler.targets import NAMES
from greygate.errors import InputError
from greygate.hardware.families import TARGETS

AUTO = "auto"

_architectures = {name.upper(): name for name in (*NAMES, "both")}
Architecture = StrEnum("Architecture", _architectures)  # type: ignore[misc]  # members that NAMES lists
_targets = {name.upper().replace("-", "_"): name for name in TARGETS}
Target = StrEnum("Target", _targets)  # type: ignore[misc]  # members that TARGETS lists


def catalogued(begun: str) -> list[str]:
    """For the shell's completion: names of the catalogue that begin so; if there are none, it completes files."""
    from greygate.machines.catalog import CATALOG

    return [name for name in CATALOG if name.startswith(begun)]


Build = Annotated[Path, typer.Argument(metavar="BUILD", help="A folder that `greygate compile` wrote.")]
Builds = Annotated[list[Path], typer.Argument(metavar="BUILD", help="Folders that `greygate compile` wrote.")]
Network = Annotated[
    str, typer.Argument(metavar="NETWORK", help="A name of the catalogue, or NAME.toml.", autocompletion=catalogued)
]
Plant = Annotated[Path, typer.Argument(metavar="PLANT", help="PLANT.toml, rig.toml, or a folder with one.")]
Recording = Annotated[Path, typer.Argument(metavar="RECORDING", help="FILE.csv, or another format that look reads.")]
Recordings = Annotated[list[str], typer.Argument(metavar="RECORDING", help="FILE.csv or SCENARIO=FILE.csv.")]
Scenario = Annotated[str, typer.Argument(metavar="RECORDING", help="FILE.csv, or a scenario of the build.")]
Rig = Annotated[Path, typer.Argument(metavar="RIG", help="Folder that holds rig.toml.")]

ARCHITECTURE = typer.Option(metavar="NAME", help=f"How it is built: {', '.join(_architectures.values())}.")
BAUD = typer.Option(callback=options.BAUD, help="Bits a second of the serial line.")
BUDGET = typer.Option(metavar="FILE.toml", help="How much each figure may grow, and its limit.")
CASES = typer.Option(callback=options.COUNT, help="Number of cases.")
CONDITION = typer.Option(metavar="NAME", help="How it is recorded; an unknown name lists the ways.")
DIAGNOSIS = typer.Option(metavar="FILE.json", help="diagnosis.json that `greygate diagnose` wrote.")
HELD = typer.Option(metavar="FILE.csv", help="Held out: chooses the epoch, bounds the error of pruning, sets no range.")
INPUT = typer.Option(metavar="CHANNEL", help="A channel that drives the machine.")
MAX_ERROR = typer.Option(metavar="BOUND", help="1.05x the RMSE of float; explore: also 0.5% of a range, 0.2bar.")
MHZ = typer.Option(callback=options.MHZ, help="Clock rate in MHz.")
OUTPUT = typer.Option(metavar="CHANNEL", help="A channel to predict.")
SAMPLE_TIME = typer.Option(callback=options.SECONDS, help="Seconds between samples of a file without time.")
SECONDS = typer.Option(callback=options.SECONDS, help="Time limit.")
SEED = typer.Option(callback=options.SEED, help="Seed of what is drawn.")
SENSOR = typer.Option(metavar="CHANNEL", help="An output of the plant that is measured in the field too.")
SETTLE = typer.Option(help="First samples of a record that give only its initial state, or auto.")
TARGET = typer.Option(metavar="NAME", help=f"FPGA or family: {', '.join(TARGETS)}.")
TEST = typer.Option(metavar="FILE.csv", help="Judges the result, once, at the end.")
LIMITS = typer.Option(metavar="NAME=LOW:HIGH", help="Of a controlled input, an output, a state, in SI units.")
RATE = typer.Option(metavar="NAME=PER_S", help="Largest change of an input in a second.")

Effects = Annotated[list[Path], typer.Option(metavar="FILE.toml", help="Effects besides greygate's own.")]
Jobs = Annotated[int, typer.Option(callback=options.JOBS, help="How many run side by side.")]


def settled(text: str) -> int | None:
    """Samples; None where they are to be found. Raises InputError for another text."""
    if text == AUTO:
        return None
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise InputError(f"--settle {text}: give a whole number of samples from 0 to {options.MOST}, or {AUTO}")
    return int(text)


Trust = Annotated[bool, typer.Option("--trust", help="Let the rig's FMU run: it is a program of whoever made it.")]
