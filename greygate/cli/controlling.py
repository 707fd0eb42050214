"""The command on machines in closed loop: control."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greygate.cli import options, words
from greygate.cli.terminal import Json, following, give
from greygate.control.choices import JUDGED, Case, Method, Place
from greygate.errors import InputError

if TYPE_CHECKING:
    from greygate.hardware.controlled import Controlled

OF_CATALOGUE = "--case, --seed and --samples are for a machine of the catalogue; leave them out"


def control(
    machine: Annotated[
        str,
        typer.Argument(
            metavar="MACHINE", help="PLANT.toml, NETWORK.toml, a rig; or a name of the catalogue, or `list`."
        ),
    ],
    recording: Annotated[
        Path | None, typer.Argument(metavar="[RECORDING]", help="How rough it is says the noise of the sensors.")
    ] = None,
    track: Annotated[
        Path | None, typer.Option(metavar="REFERENCE.csv", help="What outputs are to be; what other inputs are.")
    ] = None,
    limits: Annotated[list[str], words.LIMITS] = [],
    rate: Annotated[list[str], words.RATE] = [],
    noise: Annotated[list[str], typer.Option(metavar="NAME=RMS", help="Noise of a sensor, in its unit.")] = [],
    network: Annotated[
        Path | None, typer.Option(metavar="NETWORK.toml", help="Predicts in place of the plant.")
    ] = None,
    controller: Annotated[Method, typer.Option(help="Who controls.")] = Method.MPC,
    place: Annotated[Place, typer.Option(help="Where the network and its soft sensor are computed.")] = Place.FLOAT,
    case: Annotated[Case, typer.Option(help="What disturbs the machine.")] = Case.NOMINAL,
    seed: Annotated[int, words.SEED] = JUDGED,
    samples: Annotated[int, typer.Option(callback=options.SAMPLES, help="0 for the machine's own number.")] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="For network and signals; FILE.csv of a machine's signals.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Control a simulated machine in closed loop.

    A tuned PI, predictive control, or the network that imitates it, computed in float, by the emulator or by simulated
    hardware. Of a machine of your own every controller up to that one is printed, undisturbed, under a load and under a
    sagging supply. Of the catalogue's, seeds below 1000 are trajectories and days that it learnt on. Exit code 1 if the
    hardware differs from the emulator in any bit.
    """
    from greygate.machines.asked import is_machine

    if is_machine(machine):
        if (case, seed, samples) != (Case.NOMINAL, JUDGED, 0):
            raise InputError(OF_CATALOGUE)
        _own(Path(machine), recording, track, limits, rate, noise, network, controller, place, out, as_json)
    elif recording or track or limits or rate or noise or network:
        raise InputError(f"{machine}: is no file; a machine of the catalogue has its own reference and limits")
    else:
        _catalogued(machine, controller, place, case, seed, samples, out, as_json)


def _own(
    where: Path, recording: Path | None, track: Path | None, limits: Sequence[str], rate: Sequence[str],
    noise: Sequence[str], network: Path | None, controller: Method, place: Place, out: Path | None, as_json: bool,
) -> None:  # fmt: skip
    from greygate.hardware.controlled import checked, table, written
    from greygate.machines.asked import Wishes, asked

    if track is None:
        raise InputError(f"{where}: what is it to track? give --track REFERENCE.csv")
    wishes = Wishes(ranges(limits), numbers("rate", rate), numbers("noise", noise), recording, network)
    chosen = asked(where, track, wishes)
    if out is not None:
        checked(chosen, out)
    with following(f"control of {chosen.name}") as progress:
        done = table(chosen, controller, place, progress)
    if out is not None:
        written(chosen, done, out)
    bits = done.found.get("network", {}).get("differing_bits", 0)
    give("control-own", done.found, as_json, [*_table(done.found), *([f"written to {out}"] if out else [])], not bits)


def ranges(limits: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Of --limits NAME=LOW:HIGH; an end that is left out is infinite. Raises InputError."""
    return dict(_pair("limits", text) for text in limits)


def numbers(option: str, given: Sequence[str]) -> dict[str, float]:
    """Of an option NAME=VALUE. Raises InputError."""
    return {name: value for name, (value, _) in (_pair(option, text, 1) for text in given)}


def _pair(option: str, text: str, numbers: int = 2) -> tuple[str, tuple[float, float]]:
    """NAME=LOW:HIGH, or NAME=VALUE, whose value stands twice; an end that is left out is no limit."""
    name, equals, values = text.partition("=")
    parts = values.split(":")
    try:
        if not name or not equals or len(parts) != numbers:
            raise ValueError
        ends = [
            float(part) if part or numbers == 1 else sign * float("inf")
            for part, sign in zip(parts, (-1, 1), strict=False)
        ]
        if any(v != v for v in ends) or (numbers == 1 and not 0 < ends[0] < float("inf")):
            raise ValueError
    except ValueError:
        wish = "NAME=LOW:HIGH, such as u=-10:10" if numbers == 2 else "NAME=VALUE, a number above 0"
        raise InputError(f"--{option} {text}: write {wish}") from None
    return name, (ends[0], ends[-1])


def _table(found: "Controlled") -> list[str]:
    from greygate.pages.summary import aligned

    rows = []
    for name, cases in found["rows"].items():
        row = {"RMS / worst": name}
        for case, run in cases.items():
            errors = [f"{e['rms']:.3g} / {e['worst']:.3g}" for e in run["errors"].values()]
            row[case] = ", ".join(errors)
        row["broken"] = str(sum(sum(run["limits"].values()) for run in cases.values()))
        row["us a step"] = f"{max(run['microseconds'] for run in cases.values()):.0f}"
        rows.append(row)
    units = ", ".join(f"{name} [{unit}]" for name, unit in found["units"].items())
    lines = [*aligned(rows, ["RMS / worst"]), f"errors of {units}; broken: samples in which a limit was"]
    if (network := found.get("network")) is not None:
        lines.append(network["said"])
        if "bits" in network:
            lines.append(f"fixed point of {network['bits']} bits")
        if "clocks" in network:
            lines.append(
                f"bits        {network['differing_bits']} of {network['compared_bits']} differ from the emulator"
            )
            lines.append(f"clocks      {network['clocks']:.0f} a step")
    return lines


def _catalogued(
    machine: str, controller: Method, place: Place, case: Case, seed: int, samples: int, out: Path | None, as_json: bool
) -> None:
    from greygate.hardware.in_loop import controller as built
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
    give("control", of | found, as_json, _lines(found), not found.get("differing_bits"))


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
