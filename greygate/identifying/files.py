"""From files to files: `greygate identify`."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic

import numpy as np

from greygate.errors import InputError
from greygate.files import making, writing
from greygate.identifying.halving import ORDERS, WORSE, Halving, Tried, pooled
from greygate.identifying.ladder import LINEAR
from greygate.identifying.looking import look
from greygate.identifying.task import Task, task
from greygate.machines.identification import resting
from greygate.models.network import Network
from greygate.plain import json_text, plain
from greygate.plants.recording import FEWEST, UNITS, Recording, read_csv
from greygate.progress import Progress, silent
from greygate.table import read_table

SAME_TIME = 1e-3  # relative difference that sample times may have, because printed times are rounded
DRAWS = 2000  # resampled sets of segments, from which confidence and interval follow
SEGMENTS = 4  # of a held-out block: its errors are resampled in runs, because neighbours are alike
SHOWN = 12  # models in the table of a terminal


def read(path: str, dt: float | None) -> Recording:
    """The recording of a CSV. A column without unit is taken as a plain number.

    dt: sample time in s of a file without a time column; its columns are all channels, but for an index `k`.
    Raises InputError as `read_csv`, and for a file without time where no dt is given.
    """
    table = read_table(path)
    bare = {c: "1" for c in table.header if not _has_unit(c)}
    if table.header[0] in ("t_s", "t"):
        if dt is not None:
            raise InputError(f"{path}: has a time column; leave out --sample-time")
        return read_csv(path, units={c: u for c, u in bare.items() if c != table.header[0]})
    if dt is None:
        raise InputError(f"{path}: the first column is {table.header[0]!r}, no time; name it t_s or give --sample-time")
    names = [c for c in table.header if c != "k"]
    if len(table.cells) < FEWEST:
        raise InputError(f"{path}: the recording holds {len(table.cells)} samples; give at least {FEWEST}")
    split = {c: (c, "1") if c in bare else _split(c) for c in names}
    channels = {split[c][0]: table.values[:, table.header.index(c)] for c in names}
    return Recording(dt, channels, dict(split.values()), source=str(path))


def _has_unit(column: str) -> bool:
    return bool(_split(column)[1])


def _split(column: str) -> tuple[str, str]:
    """`v_true_m_s` -> (`v_true`, `m/s`); a column without unit -> (column, "")."""
    parts = column.split("_")
    for start in range(1, len(parts)):
        if (suffix := "_".join(parts[start:])) in UNITS and all(parts[:start]):
            return "_".join(parts[:start]), UNITS[suffix]
    return column, ""


@dataclass(frozen=True)
class Identified:
    """The chosen model, fitted to everything, and every model that was tried."""

    task: Task
    chosen: Tried
    network: Network
    search: Halving
    tests: Mapping[str, Recording]
    seconds: float


def identify(
    recordings: Mapping[str, Recording],
    inputs: Sequence[str],
    output: str,
    tests: Mapping[str, Recording],
    *,
    seconds: float,
    jobs: int,
    settle: int | None = None,
    progress: Progress = silent,
) -> Identified:
    """Find a network of one output from recordings. Raises InputError as `task` and `Halving`."""
    began = monotonic()
    for recording in (*recordings.values(), *tests.values()):
        first = next(iter(recordings.values()))
        if abs(recording.dt - first.dt) > 1e-3 * first.dt:
            raise InputError(
                f"{recording.source}: sampled every {recording.dt:g} s, {first.source} every {first.dt:g} s"
            )
    posed = task(recordings, inputs, output, settle)
    seen = [look(r, inputs, output) for r in recordings.values()]
    apart = min(max(s["stride"] for s in seen), max(posed.settle // max(ORDERS), 1))
    found = [tuple(min((s["delays"][n] for s in seen if s["delays"][n] is not None), default=0) for n in inputs)]
    shifts = {tuple(max(d + shift, 0) for d in found[0]) for shift in (-2, -1, 0, 1)} | {(0,) * len(inputs)}
    search = Halving(posed, seconds - (monotonic() - began), jobs, progress)
    search.run(sorted(shifts), sorted({1, apart}))
    chosen, fit = search.final()
    initial: dict[str, np.ndarray] = {n: layer.initial[None] for n, layer in fit.network.layers().items()}
    network = resting(fit.network, initial | (fit.initial[0] if fit.initial else {}))
    return Identified(posed, chosen, network, search, tests, monotonic() - began)


# ---- what is told


def figures(found: Identified) -> dict:
    """Everything that is told, as plain data."""
    t, search = found.task, found.search
    table = [_row(t, tried) for tried in search.finalists()]
    tested = {n: t.errors(found.network, t.record(r)) for n, r in found.tests.items()}
    line = next((x for x in search.ranked() if x.model.form is LINEAR), None)
    others = [x for x in search.finalists() if x is not found.chosen and x.errors]
    runner = others[0] if others else None
    return {
        "chosen": _row(t, found.chosen),
        "whole": pooled(t, found.network),
        "expected": _interval(found.chosen),
        "test": {n: None if e is None else float(np.sqrt(np.mean(e**2))) for n, e in tested.items()},
        "unit": t.output.unit,
        "confidence": {
            "better_than_linear": None
            if line is None or found.chosen.model.form is LINEAR
            else _sure(found.chosen, line),
            "better_than_next": None if runner is None else _sure(found.chosen, runner),
            "next": None if runner is None else runner.model.name,
        },
        "models": table,
        "tried": len(search.tried),
        "settle": t.settle,
        "seconds": round(found.seconds, 1),
    }


def _row(t: Task, tried: Tried) -> dict:
    spread = float(np.std(np.concatenate([r.targets[t.output.name] for r in t.records.values()])))
    return {
        "model": tried.model.name,
        "parameters": tried.parameters,
        "held_out": tried.error,
        "fit": 100 * (1 - tried.error / spread),
        "seconds": round(tried.seconds, 2),
    }


def _segments(tried: Tried) -> np.ndarray:
    """Mean squared errors of the segments of all held-out blocks."""
    return np.array([np.mean(s**2) for block in tried.errors for s in np.array_split(block, SEGMENTS) if len(s)])


def _drawn(count: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, count, (DRAWS, count))


def _sure(one: Tried, other: Tried) -> float | None:
    """Share of resampled sets of segments over which `one` errs less; None where the two have other segments."""
    a, b = _segments(one), _segments(other)
    if len(a) != len(b):
        return None
    drawn = _drawn(len(a))
    return float(np.mean(a[drawn].mean(1) < b[drawn].mean(1)))


def _interval(tried: Tried) -> list[float]:
    """95 % of the RMS errors over resampled sets of held-out segments."""
    a = _segments(tried)
    rms = np.sqrt(a[_drawn(len(a))].mean(1))
    return [float(v) for v in np.quantile(rms, (0.025, 0.975))]


def lines(found: dict) -> list[str]:
    """What a person reads of the figures."""
    unit = f" {found['unit']}" if found["unit"] != "1" else ""
    rows = [f"{'model':62} {'weights':>7} {'held out':>10} {'fit %':>7} {'s':>6}"]
    for row in found["models"][:SHOWN]:
        mark = "*" if row["model"] == found["chosen"]["model"] else " "
        rows.append(
            f"{mark} {row['model'][:60]:60} {row['parameters']:7d} {row['held_out']:10.4g} {row['fit']:7.2f} "
            f"{row['seconds']:6.1f}"
        )
    if len(found["models"]) > SHOWN:
        rows.append(f"  and {len(found['models']) - SHOWN} more; all are in the .json")
    low, high = found["expected"]
    told = [*rows, f"chosen: {found['chosen']['model']}; held out {found['chosen']['held_out']:.4g}{unit}"]
    told.append(f"expected on a recording like these: {low:.4g} to {high:.4g}{unit} (95 %)")
    sure = found["confidence"]
    if sure["better_than_linear"] is not None:
        told.append(f"better than the best linear model with probability {sure['better_than_linear']:.2f}")
    if sure["better_than_next"] is not None:
        told.append(f"better than the next, {sure['next']}, with probability {sure['better_than_next']:.2f}")
    if found["whole"] > WORSE * found["chosen"]["held_out"]:
        told.append(
            f"over the complete recordings it errs by {found['whole']:.4g}{unit}: it drifts in runs longer than an "
            "eighth of a recording; give the input that is missing, or a structure (greygate build-snn)"
        )
    for name, error in found["test"].items():
        told.append(f"test {name}: RMSE {'inf' if error is None else format(error, '.4g')}{unit}")
    return told


def identify_files(
    files: Mapping[str, str],
    tests: Mapping[str, str],
    inputs: Sequence[str],
    output: str,
    out: Path,
    *,
    dt: float | None,
    seconds: float,
    jobs: int,
    settle: int | None,
    progress: Progress = silent,
) -> dict:
    """Identify from CSV files and write OUT/NAME.toml, .safetensors, .json and recordings of canonical form.

    Returns the figures. Raises InputError before anything is written.
    """
    if both := set(files) & set(tests):
        raise InputError(f"{min(both)} is both a recording to train on and one to test on; rename one of them")
    if len({Path(p).resolve() for p in (*files.values(), *tests.values())}) < len(files) + len(tests):
        raise InputError("one file is given twice; leave one out")
    name = out.name
    if not re.fullmatch(r"[A-Za-z]\w*", name):
        raise InputError(f"--out {out}: the folder gives the network its name; use letters, digits and _")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: is there already; give a folder that is not there, or an empty one")
    if not inputs:
        raise InputError("--input is missing; give the channels that drive the plant")
    if output in inputs or len(set(inputs)) < len(inputs):
        raise InputError(f"--input {', '.join(inputs)}, --output {output}: name each channel once")
    read_in = {n: read(p, dt) for n, p in files.items()}
    read_tests = {n: read(p, dt) for n, p in tests.items()}
    first = next(iter(read_in.values()))
    for recording in (*read_in.values(), *read_tests.values()):
        for channel in (*inputs, output):
            recording[channel]  # raises InputError for an unknown name
            if recording.units[channel] != first.units[channel]:
                raise InputError(f"{recording.source}: {channel} is in another unit than in {first.source}")
    with making(out), writing(out):
        found = identify(
            read_in, inputs, output, read_tests, seconds=seconds, jobs=jobs, settle=settle, progress=progress
        )
        kept = {**figures(found), "recording": look(first, inputs, output)}
        replace(found.network, name=name).save(out / name, json_text(plain(kept)))
        used = (*inputs, output)
        for label, recording in {**read_in, **read_tests}.items():
            of = Recording(recording.dt, {c: recording[c] for c in used}, {c: recording.units[c] for c in used})
            of.write_csv(out / f"{label}.csv")
    records = " ".join(f"--record {out / n}.csv" for n in read_in)
    file = out / f"{name}.toml"
    return plain(
        {
            **kept,
            "out": str(file),
            "next": [
                f"greygate validate {file} {records} --settle {kept['settle']}",
                f"greygate compile {file} {records} --out {out / 'compiled'}",
            ],
        }
    )
