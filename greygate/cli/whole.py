"""The command that goes the whole way: make."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greygate.cli import words
from greygate.cli.terminal import Json, following, give, recordings, say
from greygate.errors import InputError

if TYPE_CHECKING:
    from greygate.cli.printed import Making
    from greygate.steps import Done

UP5K = words.Target("up5k")
GROWTH = "1.1x"  # of the error of float: what fixed point may err by, where nothing else is asked


def make(
    plant: words.Plant,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for what each step writes, and the page.")],
    record: words.Recordings = [],
    test: Annotated[list[str], words.TEST] = [],
    target: Annotated[words.Target, words.TARGET] = UP5K,
    sensor: Annotated[list[str], words.SENSOR] = [],
    output: Annotated[list[str], words.OUTPUT] = [],
    max_error: Annotated[str, words.MAX_ERROR] = GROWTH,
    control: Annotated[
        Path | None, typer.Option(metavar="REFERENCE.csv", help="Control it, too: what outputs are to be.")
    ] = None,
    limits: Annotated[list[str], words.LIMITS] = [],
    rate: Annotated[list[str], words.RATE] = [],
    seconds: Annotated[float, words.SECONDS] = float("inf"),
    as_json: Json = False,
) -> None:
    """Go from a plant and recordings to verified Verilog.

    It looks, diagnoses, corrects the plant, builds a network, validates, compiles and verifies it, each in a folder of
    its own, and tells all of it on one page. Run again, it does only what has changed or was cut off. Without --test
    the last of several recordings judges, or the last fifth of a single one; a rig brings its own. With --control the
    corrected plant is controlled, last by a network in Verilog; an input without --limits stays within what is on
    record. Exit code 1 if a step says no.
    """
    from greygate.cli.controlling import numbers, ranges
    from greygate.compiler.explore import Unmet
    from greygate.identify.expert.building import Unfollowed
    from greygate.make import PAGE, Asked, Tracking
    from greygate.make import make as run
    from greygate.pages.summary import aligned

    if (limits or rate) and control is None:
        raise InputError("--limits and --rate are of a controller; give --control REFERENCE.csv, or leave them out")
    track = Tracking(control, ranges(limits), numbers("rate", rate)) if control else None
    tests = recordings(test)
    asked = Asked.of(plant, recordings(record), tests, sensor, output, target.value, max_error, seconds, track)
    done: list[Done] = []

    def finished(one: "Done") -> None:
        done.append(one)
        say(f"{one.name}: {'as it was' if one.again else f'{one.seconds:.1f} s'}: {one.figure}")

    unmet = ""
    with following(f"making {asked.task.plant.name}") as progress:
        try:
            run(asked, out, progress, finished)
        except Unmet as problem:
            unmet = f"compile: {problem}"
        except Unfollowed as problem:
            unmet = f"build-snn: {problem}"
    rows = [
        {"step": d.name, "figure": d.figure, "file": str(d.folder / d.file),
         "seconds": "as it was" if d.again else f"{d.seconds:.1f}"}
        for d in done
    ]  # fmt: skip
    yes = not unmet and all(d.yes for d in done)
    lines = [*aligned(rows, ("step", "figure", "file")), *([unmet] if unmet else []), f"written to {out / PAGE}"]
    told: Making = {
        "out": str(out), "page": str(out / PAGE), "passed": yes, "unmet": unmet,
        "steps": [{"step": d.name, "figure": d.figure, "file": str(d.folder / d.file), "yes": d.yes,
                   "seconds": d.seconds, "again": d.again} for d in done],
    }  # fmt: skip
    give("make", told, as_json, lines, yes)
