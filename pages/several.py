"""Several models of a machine over one recording: how well each fits in free run, and all in one plot."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from greygate.emulator.emulation import emulate
from greygate.errors import InputError
from greygate.hardware.build import Project
from greygate.machines.source import Source, read_record
from greygate.mismatch import effects as table
from greygate.mismatch import rig as rigs
from greygate.mismatch import simulation
from greygate.models.accuracy import float_error, rms
from greygate.models.training.initial import initialised
from greygate.models.validation import LEASH, fit_per_cent
from greygate.pages import templates
from greygate.pages.units import NONE, display, labelled, per_cent, shown
from greygate.pages.zoomable import POINTS, Trace, curves, share
from greygate.plants.readers.read import read_recording

COLOURS = ("float", "fixed", "cost", "extra")  # of the models, in their order; then anew
COLUMNS = ("model", "output", "RMS", "unit", "fit %")
CORRECTED = "="  # between the folder of a rig and the diagnosis by which it is corrected


@dataclass(frozen=True)
class Predicted:
    """What a model says of an output: measured and predicted (n,) in `unit`, every `dt` s, from sample `skip` on."""

    model: str
    output: str
    unit: str
    dt: float
    measured: np.ndarray
    predicted: np.ndarray
    skip: int

    @property
    def rms(self) -> float:
        with np.errstate(over="ignore", invalid="ignore"):
            return rms(self.predicted - self.measured, self.skip)

    @property
    def fit(self) -> float:
        """In per cent, as MATLAB's `compare`; NaN where the run diverges or nothing moves."""
        used = slice(self.skip, None)
        return fit_per_cent(self.measured[used], self.predicted[used]) if math.isfinite(self.rms) else math.nan


def predictions(models: Sequence[str], recording: Path, settle: int = 0) -> list[Predicted]:
    """The free run of each model over a recording.

    models: a network's file, a build's folder, a rig's folder, or RIG=DIAGNOSIS.json, the rig as corrected. settle:
    first samples, to which a network's initial state is fitted; they count for no model. Raises InputError for a model
    or a recording that cannot be used.
    """
    return [one for model in models for one in _predicted(model, recording, settle)]


def _predicted(model: str, path: Path, settle: int) -> list[Predicted]:
    folder, _, diagnosis = model.partition(CORRECTED)
    if diagnosis or (Path(folder) / "rig.toml").is_file():
        ran = _simulated(Path(folder), path, diagnosis)
    elif Path(folder).is_dir():
        ran = _emulated(Path(folder), path)
    else:
        ran = _run(model, path, settle)
    samples = len(next(iter(ran.measured.values())))
    if settle >= samples:
        raise InputError(f"--settle {settle}: {path} has {samples} samples; settle for less")
    return [Predicted(model, n, u, ran.dt, ran.measured[n], ran.predicted[n], settle) for n, u in ran.units.items()]


@dataclass(frozen=True)
class _Ran:
    dt: float
    units: Mapping[str, str]
    measured: Mapping[str, np.ndarray]
    predicted: Mapping[str, np.ndarray]


def _simulated(folder: Path, path: Path, diagnosis: str) -> _Ran:
    rig = rigs.load(folder)
    measured = rig.timed(path)[0]
    claimed = simulation.read(diagnosis) if diagnosis else None
    effects = table.named(rig, measured, simulation.asked(claimed))
    units = {n: rig.channels[n].unit for n in rig.predict}
    return _Ran(rig.dt, units, measured.channels, simulation.simulate(rig, measured, claimed, effects))


def _emulated(folder: Path, path: Path) -> _Ran:
    project = Project.open(folder)
    inputs, dt = project.inputs(str(path))
    units = {p.name: p.unit for p in project.program.outputs}
    return _Ran(dt, units, read_recording(path, units).channels, emulate(project.program, inputs).outputs)


def _run(name: str, path: Path, settle: int) -> _Ran:
    network = Source(name).network()
    record, dt = read_record(network, path)
    record = initialised(network, replace(record, skip=min(settle, len(record) - 1)))
    measured, units = record.targets, {p.name: p.unit for p in network.outputs}
    try:
        errors = float_error(network, record)
    except InputError:  # it diverges
        errors = {n: np.full(len(record), np.nan) for n in units}
    return _Ran(dt, units, measured, {n: measured[n] + errors[n] for n in units})


def rows(found: Sequence[Predicted]) -> list[dict[str, str]]:
    """The columns of `pages.summary.aligned`, in a person's units; the errors of an output have one unit."""
    return [_row(one, [other.rms for other in found if other.output == one.output]) for one in found]


def _row(one: Predicted, errors: Sequence[float]) -> dict[str, str]:
    reach = max([e for e in errors if math.isfinite(e)], default=0.0)
    finite = math.isfinite(one.rms)
    return {
        "model": one.model,
        "output": one.output,
        "RMS": shown(one.rms, one.unit, reach) if finite else "diverges",
        "unit": display(one.unit, reach)[1] or "1",
        "fit %": per_cent(one.fit) if finite and not math.isnan(one.fit) else NONE,
    }


def page(found: Sequence[Predicted], recording: str) -> str:
    """Make one self-contained HTML page: the fits, and each output as measured and as each model predicts it."""
    outputs = dict.fromkeys(one.output for one in found)
    points = share(2 * len(found) + len(outputs), POINTS)
    drawn = [_drawn([one for one in found if one.output == output], points) for output in outputs]
    title = f"Models on {recording}"
    most = max(len(one.measured) for one in found)
    context = {"columns": COLUMNS, "rows": rows(found), "drawn": drawn, "samples": most, "most": points}
    return templates.render("several.html", title=title, plotly=templates.plotly(), **context)


def _drawn(found: Sequence[Predicted], points: int) -> tuple[str, list[tuple[str, str, str]], dict]:
    """(output, (model, colour, fit) of each, what is drawn: the errors below)"""
    first = found[0]
    factor, unit = display(first.unit, float(np.abs(first.measured).max()))
    traces = {"measured": Trace(first.measured * factor, "reference", 3.0)}
    keys = []
    for k, (one, row) in enumerate(zip(found, rows(found), strict=True)):
        colour, near = COLOURS[k % len(COLOURS)], _near(one) * factor
        traces[one.model] = Trace(near, colour)
        traces[f"error of {one.model}"] = Trace(near - one.measured * factor, colour, 1.0, below=True)
        keys.append((one.model, colour, row["fit %"]))
    return first.output, keys, curves(traces, first.dt, (labelled(first.output, unit), labelled("error", unit)), points)


def _near(one: Predicted) -> np.ndarray:
    """The prediction, without what runs far away."""
    reach = LEASH * (np.ptp(one.measured) or np.inf)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.where(np.abs(one.predicted - np.mean(one.measured)) < reach, one.predicted, np.nan)
