"""Commands on recordings alone: look, init, init-rig."""

import shlex
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greygate.cli import options, words
from greygate.cli.terminal import Json, give, say
from greygate.errors import InputError
from greygate.machines.samples import DEMOS

if TYPE_CHECKING:
    from greygate.cli.printed import ChannelRead, Looking, ModelFit, Sampling

SHOWN = 6  # names in a message


Sample = StrEnum("Sample", {name: name for name in DEMOS})  # type: ignore[misc]  # members that DEMOS lists


def demo(
    name: Annotated[
        Sample | None, typer.Argument(metavar="NAME", help="Of a sample; all are listed if not given.")
    ] = None,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder to write into, beside what is there.")] = Path(),
    as_json: Json = False,
) -> None:
    """Write the sample data of a tutorial into a folder.

    A file that is there already is never replaced.
    """
    from greygate.machines.samples import write

    written = [] if name is None else write(name.value, out)
    found: Sampling = {"samples": {n: told.means for n, told in DEMOS.items()}, "written": [str(p) for p in written]}
    there = [f"cd {shlex.quote(str(out))}"] if out != Path() else []
    then = [] if name is None else ["then:", *there, *DEMOS[name.value].then]
    lines = (
        [f"written: {', '.join(found['written'])}", *then]
        if written
        else [f"{n:10} {m}" for n, m in found["samples"].items()]
    )
    give("demo", found, as_json, lines)


def look(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="CSV, .mat, .h5, .parquet, .mf4, .tdms or .mcap.")
    ],
    unit: Annotated[
        list[str], typer.Option(metavar="NAME=UNIT", help="Of a channel whose header does not say it.")
    ] = [],
    time: Annotated[str | None, typer.Option(help="Name of the time, if it is not t or time.")] = None,
    sample_time: Annotated[float | None, words.SAMPLE_TIME] = None,
    resample: Annotated[
        str | None, typer.Option(help="auto, or a step in s: bring all channels to one uniform time.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.csv", help="CSV to write, as every command reads it.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE.html", help="HTML page to write, which draws every channel.")
    ] = None,
    against: Annotated[
        list[str], typer.Option(metavar="MODEL", help="NAME.toml, BUILD, RIG, RIG=diagnosis.json: how well it fits.")
    ] = [],
    settle: Annotated[str, words.SETTLE] = "0",
    as_json: Json = False,
) -> None:
    """Print, draw or convert a recording, or compare models on it.

    Units other than the house's are converted to SI. With --against each model runs freely, and the page draws all
    together. Exit code 2 for a unit or a time that cannot be read in one way.
    """
    from greygate.files import replacing
    from greygate.pages.recorded import COLUMNS, page, rows
    from greygate.pages.summary import aligned
    from greygate.plants.readers.columns import UNKNOWN
    from greygate.plants.readers.columns import recording as uniform
    from greygate.plants.readers.read import read_channels

    skipped = words.settled(settle)
    if against:
        given = {"--unit": unit, "--time": time, "--sample-time": sample_time, "--resample": resample, "--out": out}
        if strange := [name for name, value in given.items() if value]:
            raise InputError(f"--against: the recording is read as the model says; leave out {strange[0]}")
        if skipped is None:
            raise InputError(f"--settle {settle}: only train and identify find it; give the number that they told")
        _models(recording, against, skipped, html, as_json)
        return
    if skipped != 0:
        raise InputError(f"--settle {settle}: is of models; give --against MODEL too")
    step = _step(resample)
    if time == "":
        raise InputError("--time: give the name of the column that holds the time")
    found = read_channels(
        recording, units=dict(map(_unit, unit)), time=time, dt=sample_time, unitless=UNKNOWN if out is None else None
    )
    if step and out is None:
        raise InputError("--resample changes what is written; give --out FILE.csv")
    made = None if out is None else uniform(found, str(recording), step, say)
    with ExitStack() as both:  # or neither
        if html is not None:
            drawn = both.enter_context(replacing(html))
            drawn.write_text(page(found, recording.name), encoding="utf-8", newline="\n")
        if made is not None and out is not None:
            made.write_csv(out)
    lines = aligned(rows(found), COLUMNS[:3]) + [f"written to {path}" for path in (out, html) if path is not None]
    if missing := [c.name for c in found if c.unit == UNKNOWN]:
        names = ", ".join(missing[:SHOWN]) + (", ..." if len(missing) > SHOWN else "")
        say(f"no unit is told of {names}; give --unit {missing[0]}=UNIT, or =1 for none, for each")
    channels: list[ChannelRead] = [
        {
            "name": c.name,
            "unit": c.unit,
            "given": c.given or c.unit,
            "samples": len(c.values),
            "from_s": float(c.time[0]),
            "to_s": float(c.time[-1]),
            "step_s": c.step,
            "jitter_s": c.jitter,
            "gaps": c.gaps,
            "least": float(c.values.min()),
            "greatest": float(c.values.max()),
        }
        for c in found
    ]
    result: Looking = {"recording": str(recording), "channels": channels}
    give("look", result, as_json, lines)


def _models(recording: Path, models: list[str], skipped: int, html: Path | None, as_json: bool) -> None:
    """Compare models on a recording."""
    from greygate.pages.several import COLUMNS, page, predictions, rows
    from greygate.pages.summary import aligned
    from greygate.pages.templates import write
    from greygate.plain import plain

    found = predictions(models, recording, skipped)
    if html is not None:
        write(page(found, recording.name), html)
    fits: list[ModelFit] = [
        {"model": one.model, "output": one.output, "unit": one.unit, "rms": one.rms, "fit": one.fit} for one in found
    ]
    result: Looking = {"recording": str(recording), "channels": [], "models": fits}
    give("look", plain(result), as_json, aligned(rows(found), COLUMNS) + ([f"written to {html}"] if html else []))


def _unit(text: str) -> tuple[str, str]:
    name, equals, unit = text.partition("=")
    if not equals or not name or not unit:
        raise InputError(f"--unit {text}: write NAME=UNIT, such as p_a=bar")
    return name, unit


def _step(text: str | None) -> float | bool:
    """What `columns.recording` takes."""
    if text is None:
        return False
    if text == words.AUTO:
        return True
    try:
        step = float(text)
    except ValueError:
        step = 0.0
    if not 0.0 < step < float("inf"):
        raise InputError(f"--resample {text}: give auto, or a step in seconds above 0")
    return step


Outputs = Annotated[list[str], words.OUTPUT]
Inputs = Annotated[list[str], words.INPUT]


def init(
    recording: words.Recording,
    output: Outputs,
    out: Annotated[Path, typer.Option(metavar="NAME", help="File to write: NAME.toml, which must not be there.")],
    input: Inputs = [],
    block: Annotated[
        list[str], typer.Option(metavar="NAME", help="Library network ahead of each curve, such as absolute.")
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
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder to write; it must not be there.")],
    output: Outputs = [],
    input: Inputs = [],
    model: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Model that simulates the machine: MJCF or URDF of MuJoCo, FMU.")
    ] = None,
    map: Annotated[
        list[str], typer.Option(metavar="NAME=COLUMN", help="Column of a joint, an actuator, a variable of the model.")
    ] = [],
    trust: words.Trust = False,
    as_json: Json = False,
) -> None:
    """Write a rig to start from.

    That is rig.toml, the recordings, and the model, whose joints and actuators, or inputs, outputs and states, are
    columns of the recording. An FMU runs only with --trust. Without --model it is a placeholder plant to be replaced;
    all channels but --output are inputs if none is given.
    """
    from greygate.mismatch import starting, starting_model

    named = {name: column for name, _, column in (text.partition("=") for text in map)}
    if model is None:
        if map:
            raise InputError("--map: names columns of a --model; give that too")
        found = starting.init_rig(out, str(recording), input, output)
    elif input or output:
        raise InputError("--model: says itself what is an input and what an output; leave out --input and --output")
    else:
        found = starting_model.init_rig(out, str(recording), model, named, trust)
    give("init-rig", found, as_json, [*(f"written to {file}" for file in found["written"]), f"next: {found['next']}"])
