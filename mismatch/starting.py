"""A rig folder to start from, as `greygate init-rig` writes it: a placeholder plant, rig.toml and the recordings."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypedDict

import numpy as np

from greygate.errors import InputError
from greygate.files import replacing_folder
from greygate.mismatch.rig import FEWEST, HOLDOUT, IDENTIFY, SHORTEST, load
from greygate.mismatch.scales import noise
from greygate.names import check_name, check_unit
from greygate.plants.expressions import is_symbol
from greygate.plants.readers.read import read_recording
from greygate.plants.recording import Recording
from greygate.progress import once

KEPT = 0.75  # share of the recording that is explained; the rest is held out
UNSURE = 0.5  # tolerance of what was read off the recording
STEPS = 4  # of the integrator in a sample, or in the shortest time constant
QUICK, SLOW = 0.05, 0.9995  # share of the past that a sample keeps: beyond them no time constant can be read off


class RigStart(TypedDict):
    """A rig folder to start from. next: the command that goes on."""

    written: list[str]
    next: str


def init_rig(path: Path, record: str, inputs: Sequence[str], outputs: Sequence[str]) -> RigStart:
    """Write the folder of a rig that `greygate diagnose` takes; what was written, and the next command.

    The plant is a placeholder: every output follows the inputs with a lag, whose numbers are read off the recording.
    inputs: every channel that is no output, if none is given. Raises InputError for a name or a channel that cannot be,
    a recording that is too short, and a folder that is there; nothing is written then.
    """
    check_name(path.name, "--out")
    if path.exists():
        raise InputError(f"{path}: is there already; choose another --out, or remove it")
    recording = read_recording(record, told=once)
    inputs = inputs or [n for n in recording.channels if n not in outputs]
    for name in (*inputs, *outputs):
        check_unit(recording.units.get(name, "1"), f"{record}: {name}")
        if recording[name] is not None and not is_symbol(name):
            raise InputError(f"{record}: channel {name} cannot be a name in an equation; rename the column")
    if len({*inputs, *outputs}) < len(inputs) + len(outputs) or not outputs:
        raise InputError(f"{record}: give each --output once, and no channel as --input too")
    split = int(KEPT * recording.samples)
    held = recording.samples - split >= 2 * FEWEST and split >= SHORTEST
    with replacing_folder(path, "init-rig") as new:
        lags = {y: _lag(recording, inputs, y) for y in outputs}
        (new / "plant.toml").write_text(_plant(recording, inputs, lags), encoding="utf-8", newline="\n")
        (new / "rig.toml").write_text(_rig(recording, inputs, lags, held), encoding="utf-8", newline="\n")
        write(recording, (*inputs, *outputs), slice(0, split if held else None), new / IDENTIFY)
        if held:
            write(recording, (*inputs, *outputs), slice(split, None), new / HOLDOUT)
        load(new).to_explain()  # raises what is wrong with it before it has its name
    written = ["rig.toml", "plant.toml", IDENTIFY, *([HOLDOUT] if held else [])]
    return {"written": [str(path / n) for n in written], "next": f"greygate diagnose {path}"}


def _lag(recording: Recording, inputs: Sequence[str], output: str) -> dict[str, float]:
    """Symbol -> value, of `tau dy/dt = sum of gain u + level - y`, by least squares one sample ahead."""
    y = recording[output]
    columns = np.column_stack([y[:-1], *(recording[u][:-1] for u in inputs), np.ones(len(y) - 1)])
    kept, *gains, level = np.linalg.lstsq(columns, y[1:])[0]
    kept = min(max(kept, QUICK), SLOW)
    found = {f"tau_{output}": -recording.dt / math.log(kept)}
    found |= {f"gain_{output}_{u}": gain / (1 - kept) for u, gain in zip(inputs, gains, strict=True)}
    return found | {f"level_{output}": level / (1 - kept), f"start_{output}": float(y[0])}


def _unit(recording: Recording, symbol: str, output: str) -> str:
    unit = recording.units[output]
    if symbol.startswith("tau_"):
        return "s"
    u = symbol.removeprefix(f"gain_{output}_")
    of = recording.units.get(u, "")
    return unit if u == symbol else f"{unit}/{of}" if of.isalnum() else f"{unit}/({of})"


def _plant(recording: Recording, inputs: Sequence[str], lags: dict[str, dict[str, float]]) -> str:
    step = min([recording.dt, *(lag[f"tau_{y}"] for y, lag in lags.items())]) / STEPS
    lines = [
        "# PLACEHOLDER: every output follows the inputs with a lag. Replace the equations by those of your machine:",
        "# storage * d(state)/dt = sum of named terms. docs/plants.md says what a plant can hold;",
        "# docs/tutorial_plant.md shows a complete one. States that are no channel are added under [states].",
        f"step = {step:.3g}  # s, of the integrator",
        f"outputs = {listed(lags)}",
        f"required = {listed(s for lag in lags.values() for s in lag)}",
        "",
        "[inputs]",
        *(f'{u} = "{recording.units[u]}"' for u in inputs),
        "",
        "[parameters]  # value, unit",
    ]
    for y, lag in lags.items():
        lines += [f'{s} = [{v:.6g}, "{_unit(recording, s, y)}"]' for s, v in lag.items()]
    lines += ["", "[states]  # initial: where a run begins"]
    lines += [f'{y} = {{ unit = "{recording.units[y]}", initial = "start_{y}" }}' for y in lags]
    for y in lags:
        terms = [f'from_{u} = "gain_{y}_{u} * {u}"' for u in inputs]
        entries = ", ".join([f'storage = "tau_{y}"', *terms, f'level = "level_{y}"', f'back = "-{y}"'])
        lines += ["", f"[equations.lag_{y}]", f"{y} = {{ {entries} }}"]
    return "\n".join(lines) + "\n"


def _rig(recording: Recording, inputs: Sequence[str], lags: dict[str, dict[str, float]], held: bool) -> str:
    lines = [
        "# What is known of the machine; docs/diagnosis.md describes every entry.",
        'plant = "plant.toml"  # a placeholder: put your equations there',
        f"sample_time_s = {recording.dt!r}",
        *(
            [f"settle_s = {FEWEST * recording.dt:.6g}  # of {HOLDOUT}: they only give its initial state"]
            if held
            else []
        ),
        f"predict = {listed(lags)}  # what a simulation predicts",
        "",
        "[parameters]  # of the data sheet, in SI; these were read off the recording",
        *(f"{s} = {v:.6g}" for lag in lags.values() for s, v in lag.items()),
        "",
        "[tolerance]  # relative; a parameter that is not here is known",
        *(f"{s} = {UNSURE}" for lag in lags.values() for s, v in lag.items() if v),
    ]
    for name in (*inputs, *lags):
        role = "output" if name in lags else "input"
        lines += ["", f"[channels.{name}]", f'unit = "{recording.units[name]}"', f'role = "{role}"']
        if role == "output":
            size = float(noise(recording[name]))
            lines.append(
                f"# noise_rms = {size:.2g}  # state it if you know it of the sensor; so much the recording shows"
            )
    return "\n".join(lines) + "\n"


def listed(names: Iterable[str]) -> str:
    return "[" + ", ".join(f'"{n}"' for n in names) + "]"


def write(recording: Recording, names: Sequence[str], part: slice, path: Path) -> None:
    columns = [recording[n][part] for n in names]
    clock = recording.dt * np.arange(len(columns[0]))
    rows = zip((f"{t:.12g}" for t in clock), *(map(repr, c.tolist()) for c in columns), strict=True)
    path.write_text("\n".join([",".join(["t", *names]), *map(",".join, rows)]) + "\n", encoding="utf-8", newline="\n")
