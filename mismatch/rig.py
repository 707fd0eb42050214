"""A rig: what the engineer knows of it (`rig.toml`), and its recordings.

The layout is that of `docs/diagnosis.md`: `rig.toml`, `identify.csv`, `holdout.csv`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

import numpy as np

from greygate.errors import InputError, shown
from greygate.mismatch.libraries import declared
from greygate.names import check_file_name
from greygate.plants.expressions import check_name
from greygate.plants.plant import Parameter, Plant
from greygate.plants.recording import Recording
from greygate.reading import line, listed, named, number, one_of, read_toml, table, within
from greygate.table import read_table

PLANTS = Path(__file__).parent.parent / "machines"  # NAME.toml in one of its folders is the plant NAME
SHORTEST = 2.0  # s of recording below which nothing is diagnosed
UNIFORM = 1e-3  # of a sample interval
FEWEST = 10  # samples of a window
LONGEST = 1e9  # s of a sample, a window, a settling: thirty years
MOST = 100_000  # steps of integration in a sample, above which a simulation seems to hang


@dataclass(frozen=True)
class Channel:
    """A recorded signal. resolution: its quantum; noise: its white noise, RMS; both in `unit`, 0 where not stated."""

    unit: str
    role: str
    resolution: float = 0.0
    noise: float = 0.0

    @property
    def sigma(self) -> float:
        """RMS of noise and rounding."""
        return float(np.hypot(self.noise, self.resolution / np.sqrt(12)))


@dataclass(frozen=True)
class Rig:
    """plant: with the data sheet's values and tolerances. datasheet: symbol -> value as `rig.toml` gives it.

    window: samples between restarts of the simulation, None for one run from the first sample to the last.
    settle: samples of holdout.csv that do not count: to them are fitted the initial states, and the parameters in
    `anew`, which every recording has of its own.
    """

    plant: Plant
    datasheet: Mapping[str, float]
    channels: Mapping[str, Channel]
    predict: tuple[str, ...]
    dt: float
    window: int | None
    folder: Path
    settle: int = 0
    anew: tuple[str, ...] = ()

    @property
    def stated(self) -> bool:
        """The noise of every predicted channel is told; else it is estimated from what a fit leaves."""
        return all(self.channels[name].sigma > 0 for name in self.predict)

    @property
    def inputs(self) -> tuple[str, ...]:
        return tuple(name for name, channel in self.channels.items() if channel.role == "input")

    def recording(self, path: Path | str) -> Recording:
        """A recording of this rig: first column `t` in s, then one column a channel.

        Raises InputError for missing or unknown channels, NaN, time that is not uniform, too short a recording.
        """
        return self.timed(path)[0]

    def timed(self, path: Path | str) -> tuple[Recording, list[str]]:
        """The recording, and its column `t` as it is written there."""
        table = read_table(path)
        path, header = table.path, table.header
        if header[0] != "t":
            raise InputError(f"{path}: first column {header[0]!r}; it must be t, in s")
        if missing := [name for name in self.channels if name not in header]:
            raise InputError(f"{path}: no column {', '.join(missing)}; rig.toml names these channels")
        if unknown := [name for name in header[1:] if name not in self.channels]:
            raise InputError(f"{path}: column {', '.join(unknown)} is no channel of rig.toml; declare or drop it")
        samples, shortest = len(table.cells), max(SHORTEST, (self.window or 0) * self.dt)
        if samples * self.dt < shortest:
            raise InputError(f"{path}: {samples} samples, {samples * self.dt:g} s; record at least {shortest:g} s")
        steps = np.diff(table.values[:, 0])
        table.require_steps(steps, np.abs(steps - self.dt) > UNIFORM * self.dt + 1e-12, self.dt, "stands in rig.toml")
        channels = {name: table.values[:, header.index(name)] for name in self.channels}
        recording = Recording(self.dt, channels, {n: c.unit for n, c in self.channels.items()}, source=str(path))
        return recording, [row[0] for row in table.cells]


CHANNEL = {"unit": line, "role": one_of(("input", "output"))}
ERRORS = dict.fromkeys(("resolution", "noise_rms"), within(0.0, np.inf, "give 0 or more"))
NEEDED = {
    "plant": line,
    "sample_time_s": within(1e-9, LONGEST, "give seconds"),
    "predict": listed(line),
    "parameters": named(number, check_name),
    "channels": named(lambda *entry: table(*entry, CHANNEL, ERRORS, others=True), check_name),
}
OPTIONAL = {
    "window_s": within(0.0, LONGEST, "give seconds"),
    "settle_s": within(0.0, LONGEST, "give seconds"),
    "anew": listed(line),
    "tolerance": named(within(0.0, np.nextafter(1.0, 0.0), "give a relative uncertainty, 0 to 1"), check_name),
}


def load(folder: Path | str, plants: Path | None = None) -> Rig:
    """The rig of `folder`/rig.toml; its plant is one of `machines/*/NAME.toml`, or a TOML file named beside it.

    Raises InputError naming file and entry.
    """
    folder = Path(folder)
    path = folder / "rig.toml"
    found = table(read_toml(path, "give the folder of a rig"), f"{path}:", NEEDED, OPTIONAL, others=True)
    predict, anew, dt, window = found["predict"], found.get("anew", ()), found["sample_time_s"], found.get("window_s")
    datasheet, tolerance = found["parameters"], found.get("tolerance", {})

    def fail(where: str, problem: str) -> NoReturn:
        raise InputError(f"{path}: {where}: {problem}")

    if not predict or len(set(predict)) < len(predict):
        fail("predict", f"{shown(predict)}; list the channels that a simulation predicts, each once")
    plant = _plant(path, found["plant"])
    if not dt <= MOST * plant.step:
        fail("sample_time_s", f"{dt:g} s, {plant.name} takes steps of {plant.step:g} s; take {MOST} a sample at most")
    if window is not None and window < FEWEST * dt:
        fail("window_s", f"{window:g}; give at least {FEWEST} samples, in s")
    for symbol in datasheet:
        if symbol not in plant.parameters:
            fail(f"parameters.{symbol}", f"{plant.name} has {', '.join(plant.parameters)}")
    if missing := [s for s in plant.required if s not in datasheet]:
        fail("parameters", f"{', '.join(missing)} missing; {plant.name} needs {'it' if len(missing) == 1 else 'them'}")
    for symbol in tolerance:
        if symbol not in datasheet:
            fail(f"tolerance.{symbol}", "is no entry of [parameters]; give its value there")
    channels = {}
    for name, entry in found["channels"].items():
        unit, role = entry["unit"], entry["role"]
        known = plant.inputs.get(name) if role == "input" else _unit(plant, name)
        if known is None:
            there = [n for n in plant.inputs if n not in plant.derived] if role == "input" else plant.outputs
            fail(f"channels.{name}", f"{plant.name} has no {role} of that name; it has {', '.join(there)}")
        if unit != known:
            fail(f"channels.{name}", f"unit {shown(unit)}, {plant.name} has it in {known}; convert it")
        channels[name] = Channel(known, role, entry.get("resolution", 0.0), entry.get("noise_rms", 0.0))
    for name in plant.inputs:
        if name not in channels and name not in plant.derived and name != "t":
            fail(f"channels.{name}", f"is missing; it is an input of {plant.name}")
    for name, how in plant.derived.items():
        if (source := how.partition(" ")[2]) not in channels:
            fail(f"channels.{source}", f"is missing; {plant.name} derives {name} of it")
    for name in predict:
        if name not in channels or channels[name].role != "output":
            fail("predict", f"{shown(name)} is no output channel")
    if not all(channels[name].sigma > 0 for name in predict) and window is not None:
        fail("window_s", "needs resolution or noise_rms of every predicted channel; give these, or run free")
    for symbol in anew:
        if symbol not in datasheet:
            fail("anew", f"{shown(symbol)} is no entry of [parameters]; give its value there")
    switched = {on: 1.0 for on, by in plant.switches.items() if datasheet.get(by)}
    parameters = {
        symbol: Parameter(
            switched.get(symbol, datasheet.get(symbol, p.value)), p.unit, tolerance.get(symbol, 0.0), p.meaning
        )
        for symbol, p in plant.parameters.items()
    }
    return Rig(
        replace(plant, parameters=parameters),
        datasheet,
        channels,
        tuple(predict),
        dt,
        None if window is None else round(window / dt),
        folder,
        round(found.get("settle_s", 0.0) / dt),
        tuple(anew),
    )


def _unit(plant: Plant, name: str) -> str | None:
    try:
        return plant.unit(name)
    except KeyError:
        return None


def _plant(rig: Path, name: str) -> Plant:
    own = rig.parent / check_file_name(name, f"{rig}: plant")
    known = {path.stem: path for path in sorted(PLANTS.glob("*/*.toml"))}
    path = own if name.endswith(".toml") else known.get(name, own)
    if not path.exists():
        given = ", ".join(known)
        raise InputError(f"{rig}: plant {shown(name)} is unknown; give {given}, or a plant file beside rig.toml")
    plant = Plant.read(path)
    declared(plant)
    return plant
