"""Position control of a simulated machine."""

from pathlib import Path
from typing import Annotated

import typer

from greygate.cli import options, words
from greygate.cli.terminal import Json, following, give
from greygate.control.choices import JUDGED, Case, Method, Place


def control(
    machine: Annotated[
        str, typer.Argument(metavar="MACHINE", help="A machine of the catalogue that has position control, or `list`.")
    ],
    controller: Annotated[Method, typer.Option(help="Who controls.")] = Method.MPC,
    place: Annotated[Place, typer.Option(help="Where the network and its soft sensor are computed.")] = Place.FLOAT,
    case: Annotated[Case, typer.Option(help="What disturbs the machine.")] = Case.NOMINAL,
    seed: Annotated[int, words.SEED] = JUDGED,
    samples: Annotated[int, typer.Option(callback=options.SAMPLES, help="0 for the machine's own number.")] = 0,
    out: Annotated[Path | None, typer.Option(metavar="FILE.csv", help="CSV for the signals of the run.")] = None,
    as_json: Json = False,
) -> None:
    """Control the position of a simulated machine.

    A tuned PI, predictive control, or the network that imitates it. The network and its soft sensor are computed in
    float, by the emulator or by simulated hardware. Seeds below 1000 are trajectories and days that it learnt on. Exit
    code 1 if the hardware differs from the emulator in any bit.
    """
    from greygate.hardware.controlling import controller as built
    from greygate.machines.catalog import CONTROLLED, task

    if machine == "list":
        titles = {name: build().title for name, build in CONTROLLED.items()}
        give("catalogue", titles, as_json, [f"{name:20} {title}" for name, title in titles.items()])
        return
    chosen = task(machine)
    with following(f"control of {machine}") as progress, built(chosen, controller, place, progress) as (made, designs):
        done = chosen.run(made, case, seed, samples, progress)
    found: dict = done.figures(min(chosen.settle, len(done.error) - 1)) | {"limits": dict(done.violations)}
    if designs:
        found["differing_bits"] = sum(d.differing for d in designs)
        found["compared_bits"] = sum(d.compared for d in designs)
        found["clocks"] = {d.program.name: d.clocks / d.steps for d in designs}
    if out:
        chosen.recording(done).write_csv(out)
    of = {"machine": machine, "controller": controller, "place": place, "case": case, "seed": seed}
    give("control", of | found, as_json, _lines(found))
    if found.get("differing_bits"):
        raise typer.Exit(1)


def _lines(found: dict) -> list[str]:
    lines = [f"error       RMS {1e6 * found['rms']:.2f} µm, worst {1e6 * found['worst']:.1f} µm"]
    broken = (f"{name} {count}" for name, count in found["limits"].items())
    lines.append(f"limits      samples in which one was broken: {', '.join(broken)}")
    if "energy" in found:
        lines.append(f"energy      {found['energy']:.0f} J")
    lines.append(f"time        {found['microseconds']:.0f} µs a step on this computer")
    if "clocks" in found:
        lines.append("clocks      " + ", ".join(f"{name} {value:.0f}" for name, value in found["clocks"].items()))
        lines.append(f"bits        {found['differing_bits']} of {found['compared_bits']} differ from the emulator")
    return lines
