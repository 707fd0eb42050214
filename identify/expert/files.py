"""From files to files: `greygate build-snn`."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, NotRequired, TypedDict

import numpy as np

from greygate.errors import InputError
from greygate.files import making, replacing, writing
from greygate.identify.expert.building import Built, build
from greygate.identify.expert.decisions import Decision
from greygate.mismatch.rig import Channel, Own, Rig, load
from greygate.mismatch.simulation import read as read_diagnosis
from greygate.models.accuracy import Errors
from greygate.plain import Count, json_text, plain
from greygate.plants.expressions import names
from greygate.plants.plant import Plant
from greygate.plants.readers.read import read_recording
from greygate.plants.recording import UNITS, Recording
from greygate.progress import Progress, once, silent

RIG = "rig.toml"


class BuiltFacts(TypedDict):
    """A structured network from a plant's equations. Errors are RMS; null where it diverges."""

    rms: Annotated[dict[str, Errors], "network, nominal, corrected, linear -> recording -> target -> RMS."]
    decisions: list[Decision]
    better: NotRequired[bool]
    seconds: NotRequired[float]
    neurons: NotRequired[Count]
    out: NotRequired[str]
    next: NotRequired[str]


def build_files(
    where: Path,
    recordings: Mapping[str, str],
    tests: Mapping[str, str],
    sensors: Sequence[str],
    targets: Sequence[str],
    seconds: float,
    out: Path,
    progress: Progress = silent,
    diagnosis: Path | None = None,
) -> dict:
    """Build the network of the plant in a file or of a rig, and write it with its figures and decisions to a folder.

    diagnosis: a diagnosis.json of the plant, or one that an earlier build wrote; else the recordings are diagnosed, and
    NAME.diagnosis.json keeps it. Of a rig, NAME.recording.csv is its first recording with units. Returns the
    figures. Raises InputError as `build`, before anything is written.
    """
    if both := set(recordings) & set(tests):
        raise InputError(f"{min(both)} is both a recording to train on and one to test on; rename one of them")
    files = {**recordings, **tests}
    if len({Path(path).resolve() for path in files.values()}) < len(files):
        raise InputError("one file is given twice, under two names; leave one out")
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is not a folder; give another one")
    plant, found = read(where, files)
    used, told = {n: found[n] for n in recordings}, None if diagnosis is None else read_diagnosis(diagnosis)
    with making(out), writing(out):
        judges = {n: found[n] for n in tests}
        built = build(plant, used, judges, sensors, targets, seconds, progress, told)
        return _written(built, {n: files[n] for n in found}, out, found if isinstance(plant, Rig) else {})


def read(where: Path, files: Mapping[str, str]) -> tuple[Plant | Rig, dict[str, Recording]]:
    """The plant of a file, or a rig, and the recordings. Raises InputError."""
    folder = where if where.is_dir() else where.parent
    if where.is_dir() or where.name == RIG:
        rig = load(folder)
        return driven(rig, {name: rig.recording(Path(path)) for name, path in files.items()})
    return Plant.read(where), {name: read_recording(path, told=once) for name, path in files.items()}


def driven(rig: Rig, recordings: Mapping[str, Recording]) -> tuple[Rig, dict[str, Recording]]:
    """The rig with an input for each parameter that has an exact value of its own in a recording, and the recordings.

    A network has one value of a parameter; an input's may be another in each recording.
    """
    plant, own = rig.plant, {n: rig.own.get(n, Own()).parameters for n in recordings}
    bounds = names(b for s in plant.states.values() for b in (s.initial, s.low, s.high) if isinstance(b, str))
    fixed = {*rig.anew, *bounds, *plant.switches, *plant.switches.values(), *plant.required}
    fixed |= {s for o in rig.own.values() for s in o.unsure}
    others = {s for o in own.values() for s, v in o.items() if v != plant.parameters[s].value}
    moved = {s: p for s, p in plant.parameters.items() if s in others - fixed}
    units = {s: p.unit for s, p in moved.items()}
    known = replace(plant, parameters=_but(plant.parameters, moved), inputs={**plant.inputs, **units})
    rig = replace(
        rig,
        plant=known,
        datasheet=_but(rig.datasheet, moved),
        channels={**rig.channels, **{s: Channel(unit, "input") for s, unit in units.items()}},
        own={n: replace(o, parameters=_but(o.parameters, moved)) for n, o in rig.own.items()},
    )
    found = {}
    for n, r in recordings.items():
        values = {s: np.full(r.samples, own[n].get(s, p.value)) for s, p in moved.items()}
        found[n] = replace(r, channels={**r.channels, **values}, units={**r.units, **units})
    return rig, found


def _but(given: Mapping, without: Collection) -> dict:
    return {name: value for name, value in given.items() if name not in without}


def _written(built: Built, files: Mapping[str, str], out: Path, bare: Mapping[str, Recording]) -> dict:
    """bare: the recordings whose files have no units; the first is written as the network reads it."""
    name = built.network.name
    kept = {"rms": built.rms, "decisions": built.log.facts}
    first = next(iter(built.rms["network"]))
    built.network.save(out / name, json_text(plain(kept)))
    with replacing(out / f"{name}.decisions.txt") as path:
        path.write_text(built.log.text, encoding="utf-8", newline="\n")
    if built.diagnosis is not None:
        with replacing(out / f"{name}.diagnosis.json") as path:
            path.write_text(json_text(plain(built.diagnosis)), encoding="utf-8", newline="\n")
    judged = [n for n in built.rms["network"] if n not in files or n != first]
    given, read_by = next(iter(files.items()))
    if bare and {*bare[given].units.values()} <= {*UNITS.values()}:
        read_by = str(out / f"{name}.recording.csv")
        bare[given].write_csv(read_by)
    command = f"greygate compile {out / name}.toml {read_by} --out {out / 'compiled'}"
    about = {"better": _better(built, judged), "seconds": round(built.seconds, 1), "neurons": built.network.neurons()}
    text = built.log.text.splitlines()
    return plain({**kept, **about, "out": str(out / f"{name}.toml"), "next": f"next: {command}", "text": text})


def _better(built: Built, judged: Sequence[str]) -> bool:
    """Whether the network beats the plant's own simulation on what was kept: the mean over targets of their ratio."""
    ratios = [
        built.rms["network"][n][t] / built.rms["nominal"][n][t]
        for n in judged for t in built.rms["nominal"][n] if built.rms["nominal"][n][t]
    ]  # fmt: skip
    return bool(ratios) and sum(ratios) / len(ratios) < 1.0
