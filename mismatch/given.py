"""A rig without a folder: a plant and recordings as Python has them, with what rig.toml says besides."""

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from greygate.errors import InputError
from greygate.mismatch import rig as rigs
from greygate.mismatch.libraries import declared
from greygate.mismatch.model import Model
from greygate.mismatch.rig import UNSURE, Rig
from greygate.plants.plant import Plant
from greygate.plants.readers.read import read_recording
from greygate.plants.recording import Recording
from greygate.plants.simulator import simulate
from greygate.plants.table import read_header
from greygate.progress import once
from greygate.reading import named, within

NOWHERE = Path(os.devnull)  # in which no file can stand
LONG = 0.1  # s that a run takes: with a thousand of them and more, a diagnosis takes minutes
SIZES = named(within(0.0, float("inf"), "give 0 or more"))


def rig_of(
    plant: Plant,
    recording: Any,
    *,
    holdout: Any = None,
    tolerance: Mapping[str, float] | None = None,
    plus_minus: Mapping[str, float] | None = None,
    noise_rms: Mapping[str, float] | None = None,
    resolution: Mapping[str, float] | None = None,
    predict: Sequence[str] | None = None,
    window_s: float | None = None,
) -> Rig:
    """The rig of a plant and a recording: a Recording, or what `read_recording` takes; or a list of such.

    Its channels are the plant's inputs, and one or more of its outputs; columns without a unit have the plant's.
    holdout: further recordings. tolerance: parameter -> relative, besides those that the plant has; plus_minus: in its
    unit, instead. noise_rms and resolution: channel -> in its unit. predict: the channels that a simulation predicts,
    by default all outputs. window_s: s between restarts. Raises InputError naming recording, channel or entry.
    """
    where = f"plant {plant.name}"
    identify = _named(plant, recording, "recording")
    held = [] if holdout is None else _named(plant, holdout, "holdout")
    first = identify[0]
    for other in (*identify, *held):
        if other.dt != first.dt or {*other.channels} != {*first.channels}:
            raise InputError(f"{other.source}: has other channels, or another sample time, than {first.source}")
    declared(plant)
    sizes = {"noise_rms": SIZES(dict(noise_rms or {}), f"{where}: noise_rms"),
             "resolution": SIZES(dict(resolution or {}), f"{where}: resolution")}  # fmt: skip
    channels = _channels(plant, first, sizes)
    absolute = UNSURE["plus_minus"](dict(plus_minus or {}), f"{where}: plus_minus")
    known = {s: p.tolerance for s, p in plant.parameters.items() if p.tolerance and s not in absolute}
    found: dict[str, Any] = {
        "sample_time_s": first.dt,
        "predict": list(predict or (name for name, c in channels.items() if c["role"] == "output")),
        "parameters": {symbol: p.value for symbol, p in plant.parameters.items()},
        "tolerance": known | UNSURE["tolerance"](dict(tolerance or {}), f"{where}: tolerance"),
        "plus_minus": absolute,
        "channels": channels,
        "identify": [run.name for run in identify],
        **({"holdout": [run.name for run in held]} if held else {}),
        **({} if window_s is None else {"window_s": window_s}),
    }
    return rigs.of(plant, found, NOWHERE / plant.name, where, {run.name: run for run in (*identify, *held)})


def tried(rig: Rig) -> None:
    """Run the plant twice over the recording: say so where that takes long.

    Raises InputError where the second run differs: a function keeps what no state of the plant says. Likewise where a
    simulator from outside does not stay finite.
    """
    runs = []
    for _ in range(2):
        models = [Model(rig.of(run.name), run, {}) for run in rig.to_explain().runs]
        began = time.perf_counter()
        runs.append([model.states(model.values)[0] for model in models])
    if not all(np.array_equal(one, other, equal_nan=True) for one, other in zip(*runs, strict=True)):
        wish = "let its function depend on its arguments alone; what it keeps from call to call is a state"
        raise InputError(f"{rig.title}: gives another run for the same inputs; {wish}")
    if rig.plant.outside and not all(np.isfinite(states).all() for states in runs[0]):
        _simulated(models)
    if (took := time.perf_counter() - began) > LONG:
        wish = "seconds=... ends it sooner, progress=print says where it is"
        once(f"{rig.title}: a run over the recording takes {took:.2g} s, a diagnosis a thousand and more; {wish}")


def _simulated(models: Sequence[Model]) -> None:
    """Raise InputError where the simulator does not stay finite, which says why."""
    for model in models:
        simulate(model.plant, model.inputs, sample_time=model.rig.dt, step=model.plant.step)


def _named(plant: Plant, given: Any, name: str) -> list[Recording]:
    """The recordings, those that are no files called `name`, numbered where there are several."""
    if given is None or (isinstance(given, list | tuple) and not given):
        raise InputError(f"plant {plant.name}: give a {name} of it")
    if not isinstance(given, list | tuple):
        return [_read(plant, given, name)]
    return [_read(plant, one, f"{name}{i}") for i, one in enumerate(given, 1)]


def _read(plant: Plant, source: Any, name: str) -> Recording:
    """A recording whose channels are the plant's, in its units."""
    found = source if isinstance(source, Recording) else read_recording(source, units=_units(plant, source))
    told = found.source if isinstance(source, str | Path) else name
    for channel, unit in found.units.items():
        if channel not in plant.symbols - {*plant.parameters}:
            known = ", ".join((*plant.inputs, *plant.outputs))
            raise InputError(f"{told}: channel {channel}: is none of plant {plant.name}; it has {known}; drop it")
        if unit != plant.unit(channel):
            raise InputError(f"{told}: channel {channel} is in {unit}, the plant has it in {plant.unit(channel)}")
    return Recording(found.dt, found.channels, found.units, told, found.history)


def _units(plant: Plant, source: Any) -> dict[str, str] | None:
    """The plant's units of columns that name none."""
    if isinstance(source, str | Path):
        path = Path(source)
        header = read_header(path)[0] if path.suffix == ".csv" or path.name.endswith(".csv.gz") else []
    else:
        header = [str(name) for name in (source if isinstance(source, Mapping) else getattr(source, "columns", ()))]
    return {name: plant.unit(name) for name in header if name in plant.symbols and name != "t"} or None


def _channels(plant: Plant, recording: Recording, sizes: Mapping[str, Mapping[str, float]]) -> dict[str, dict]:
    """What rig.toml says of channels."""
    for entry, told in sizes.items():
        if unknown := [name for name in told if name not in recording.channels]:
            raise InputError(f"plant {plant.name}: {entry}.{unknown[0]}: is no channel of {recording.source}")
    out: dict[str, dict] = {}
    for name, unit in recording.units.items():
        out[name] = {"unit": unit, "role": "input" if name in plant.inputs else "output"}
        out[name] |= {entry: told[name] for entry, told in sizes.items() if name in told}
    return out
