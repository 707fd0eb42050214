"""Fits the parameters of an FMU to a recording, and asks whether the recording itself is at fault.

The inside of an FMU is closed: its inputs, outputs and parameters can be explained, its equations cannot. An FMU is a
program of whoever made it, and runs here with all rights.
"""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from types import TracebackType
from typing import Annotated, TypedDict

import numpy as np
from scipy.optimize import least_squares

from greygate.errors import InputError, brought_by, one_line
from greygate.plain import Json
from greygate.plants.readers.read import read_recording
from greygate.plants.recording import Recording
from greygate.progress import Progress, once, silent

LEARNT = 0.6  # share of the recording that is fitted; the rest judges
BETTER = 0.05  # share of the held-out error that a fault of the recording must take away, to be named
LATEST = 0.05  # of the recording: the longest delay of a channel
WIDE = 1.96  # standard deviations of a 95 % interval
STEP = 1e-5  # of a parameter's scale, for differences
KINDS = ("delay", "offset", "gain")
PAIRED = 6  # faults, those that fit best alone, of which all pairs are tried
FAR = 1e6  # deviations of a channel: a run that fails is said to be so far off


Parts = Annotated[dict[str, float], Json(minProperties=1)]


class FittedParameter(TypedDict):
    value: float
    interval: tuple[float, float]
    start: float
    unit: str


class FittedOutput(TypedDict):
    unit: str
    start: Parts
    calibrated: Parts
    with_faults: Parts


class FittedFault(TypedDict):
    channel: str
    kind: str
    size: float
    interval: tuple[float, float]
    unit: str


class Calibrated(TypedDict):
    """Parameters of an FMU fitted to a recording."""

    fmu: str
    recording: str
    parameters: dict[str, FittedParameter]
    rms: dict[str, FittedOutput]
    faults: list[FittedFault]
    cannot_show: str


@dataclass(frozen=True)
class Fault:
    """Something that a recording may have done to a channel: kind is "offset", "gain" or "delay"."""

    channel: str
    kind: str
    entered: bool  # an input, else an output

    def __str__(self) -> str:
        return f"{self.kind} of {self.channel}"


class Unit:
    """An FMU under way; use it in `with`."""

    def __init__(self, path: Path | str):
        with brought_by("fmi", "fmpy"):
            import fmpy
        self.fmpy, self.path = fmpy, Path(path)
        try:
            self.about = fmpy.read_model_description(str(path))
        except Exception as error:  # of fmpy, lxml, zipfile
            raise InputError(f"{path}: is no FMU ({one_line(' '.join(str(error).split()))[:150]})") from None
        if self.about.coSimulation is None:
            raise InputError(f"{path}: is for model exchange alone; export it for co-simulation")
        kinds = {"Real", "Float64"}
        self.variables = {v.name: v for v in self.about.modelVariables if v.type in kinds and not v.dimensions}
        if found := [
            v.name for v in self.about.modelVariables if v.causality == "input" and v.name not in self.variables
        ]:
            raise InputError(f"{path}: input {found[0]} is no scalar of floating point; only such are set")

    def named(self, *causalities: str) -> list[str]:
        return [n for n, v in self.variables.items() if v.causality in causalities]

    def unit(self, name: str) -> str:
        return self.variables[name].unit or "1"

    def __enter__(self) -> "Unit":
        self._folder = tempfile.TemporaryDirectory()
        self.fmpy.extract(str(self.path), self._folder.name)
        newer = self.about.fmiVersion.startswith("3")
        kind = self.fmpy.fmi3.FMU3Slave if newer else self.fmpy.fmi2.FMU2Slave
        self.slave = kind(
            guid=self.about.guid,
            unzipDirectory=self._folder.name,
            modelIdentifier=self.about.coSimulation.modelIdentifier,
            instanceName="fit",
        )
        self._write = self.slave.setFloat64 if newer else self.slave.setReal
        self._read = self.slave.getFloat64 if newer else self.slave.getReal
        self._newer = newer
        self.slave.instantiate()
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.slave.freeInstance()
        self._folder.cleanup()

    def run(
        self, parameters: Mapping[str, float], inputs: Mapping[str, np.ndarray], dt: float, outputs: Sequence[str]
    ) -> np.ndarray:
        """The outputs (samples, outputs) at the instants at which inputs begin to act; NaN from where it fails."""
        samples = len(next(iter(inputs.values())))
        found = np.full((samples, len(outputs)), np.nan)
        references = [self.variables[n].valueReference for n in inputs]
        wanted = [self.variables[n].valueReference for n in outputs]
        rows = np.column_stack(list(inputs.values())).tolist()
        try:
            self.slave.reset()
            self._write([self.variables[n].valueReference for n in parameters], list(map(float, parameters.values())))
            if not self._newer:
                self.slave.setupExperiment(startTime=0.0)
            self.slave.enterInitializationMode()
            self.slave.exitInitializationMode()
            for k, row in enumerate(rows):
                self._write(references, row)
                found[k] = self._read(wanted)
                self.slave.doStep(k * dt, dt)
        except self.fmpy.fmi1.FMICallException:
            pass
        return found


def calibrate(
    path: Path | str, recording: Path | str | Recording, parameters: Sequence[str], progress: Progress = silent
) -> Calibrated:
    """Fit parameters of an FMU to the first part of a recording; judge on the rest.

    recording: with a channel for every input of the FMU and for one output or more, in any units. parameters: names.
    Returns values with 95 % intervals, RMS errors of both parts before and after by output, and the faults of the
    recording that reduce the held-out error. Raises InputError for names that the FMU has not.
    """
    unit = Unit(path)
    known = unit.named("parameter")
    for name in parameters:
        if name not in known:
            raise InputError(f"{path}: no parameter {name}; it has {', '.join(known) or 'none'}")
    if not parameters:
        raise InputError(f"{path}: name a parameter to fit; it has {', '.join(known) or 'none'}")
    entered = unit.named("input")
    if isinstance(recording, Recording):
        given = recording
    else:
        given = read_recording(recording, {n: unit.unit(n) for n in entered}, told=once)
    outputs = [n for n in unit.named("output", "local") if n in given.channels]
    if missing := [n for n in entered if n not in given.channels]:
        raise InputError(f"{given.source}: no channel {missing[0]}, an input of the FMU")
    if not outputs:
        raise InputError(
            f"{given.source}: no channel is an output of the FMU; it has {', '.join(unit.named('output'))}"
        )
    for n in outputs:
        if given.units[n] != unit.unit(n) and unit.variables[n].unit:
            raise InputError(f"{given.source}: {n} is in {given.units[n]}, in the FMU in {unit.unit(n)}; convert it")
    with unit:
        fit = _Fit(unit, given, entered, outputs, list(parameters))
        return fit.result(progress)


@dataclass(frozen=True)
class _Tried:
    """A set of faults, fitted along with `parameters` parameters."""

    faults: tuple[Fault, ...]
    values: np.ndarray
    spread: np.ndarray
    rms: dict[str, dict[str, float]]
    parameters: int

    @property
    def clear(self) -> bool:
        """Whether the size of every fault is off zero."""
        sizes, spreads = self.values[self.parameters :], self.spread[self.parameters :]
        return bool((np.abs(sizes) > WIDE * spreads).all())

    @property
    def misfit(self) -> float:
        """On the part that is fitted; sets of one size are compared."""
        return float(np.sum(np.log([e["fitted"] for e in self.rms.values()])))


class _Fit:
    """The least-squares problem of one recording."""

    def __init__(self, unit: Unit, given: Recording, entered: list[str], outputs: list[str], parameters: list[str]):
        self.unit, self.given, self.entered, self.outputs, self.parameters = unit, given, entered, outputs, parameters
        self.target = np.column_stack([given[n] for n in outputs])
        self.end = int(LEARNT * given.samples)
        deviation = self.target[: self.end].std(axis=0)
        self.scale = np.where(deviation > 0, deviation, 1.0)
        self.start = [float(unit.variables[n].start or 0.0) for n in parameters]

    def predicted(self, values: np.ndarray, faults: Sequence[Fault]) -> np.ndarray:
        """(samples, outputs), as a recording with these faults shows them."""
        count = len(self.parameters)
        signals = {n: self.given[n] for n in self.entered}
        for fault, size in zip(faults, values[count:], strict=True):
            if fault.entered:
                signals[fault.channel] = self._changed(signals[fault.channel], fault, size, undone=True)
        out = self.unit.run(
            dict(zip(self.parameters, values[:count], strict=True)), signals, self.given.dt, self.outputs
        )
        for fault, size in zip(faults, values[count:], strict=True):
            if not fault.entered:
                k = self.outputs.index(fault.channel)
                out[:, k] = self._changed(out[:, k], fault, size)
        return out

    def _changed(self, signal: np.ndarray, fault: Fault, size: float, undone: bool = False) -> np.ndarray:
        """The signal as a fault records it; undone: the signal that was there before. Offsets are in deviations of the
        channel, gains are shares, delays are samples.
        """
        back = -1.0 if undone else 1.0
        if fault.kind == "offset":
            return signal + back * size * (self.given[fault.channel].std() or 1.0)
        if fault.kind == "gain":
            return signal * (1.0 + size) ** back
        places = np.arange(len(signal))
        return np.interp(places - back * size, places, signal)

    def fitted(self, start: Sequence[float] | np.ndarray, faults: Sequence[Fault]) -> tuple[np.ndarray, np.ndarray]:
        """(values, standard deviations)."""
        count = len(self.parameters)
        first = np.array([*start, *([0.0] * (count + len(faults) - len(start)))])
        size = np.where(np.arange(len(first)) < count, np.maximum(np.abs(first), 1e-12), 1.0)
        size = np.where((np.arange(len(first)) < count) & (first == 0), 1.0, size)
        most = max(LATEST * self.end, 1.0)
        edges = [most if f.kind == "delay" else np.inf for f in faults]
        bounds = [-np.inf] * count + [-e for e in edges], [np.inf] * count + edges

        def errors(values: np.ndarray) -> np.ndarray:
            left = ((self.predicted(values, faults) - self.target)[: self.end] / self.scale).ravel()
            return np.clip(np.nan_to_num(left, nan=FAR), -FAR, FAR)

        steps = np.where(np.arange(len(first)) < count, STEP, 0.05)  # a delay is piecewise: a twentieth of a sample

        def slopes(values: np.ndarray) -> np.ndarray:
            base = errors(values)
            moved = [values + steps[j] * size[j] * (np.arange(len(values)) == j) for j in range(len(values))]
            return np.column_stack([(errors(m) - base) / (steps[j] * size[j]) for j, m in enumerate(moved)])

        found = least_squares(errors, first, jac=slopes, x_scale=size, bounds=bounds, max_nfev=60)
        free = max(len(found.fun) - len(first), 1)
        spread = np.linalg.pinv(found.jac.T @ found.jac) * (2 * found.cost / free)
        return found.x, np.sqrt(np.maximum(np.diag(spread), 0.0))

    def rms(self, values: np.ndarray, faults: Sequence[Fault]) -> dict[str, dict[str, float]]:
        left = self.predicted(values, faults) - self.target
        parts = {"fitted": left[: self.end], "held_out": left[self.end :]}
        return {
            n: {part: float(np.sqrt(np.mean(e[:, k] ** 2))) for part, e in parts.items()}
            for k, n in enumerate(self.outputs)
        }

    def held(self, rms: Mapping[str, Mapping[str, float]]) -> float:
        """The held-out error in deviations, over all outputs."""
        return float(
            np.sqrt(np.mean([(rms[n]["held_out"] / s) ** 2 for n, s in zip(self.outputs, self.scale, strict=True)]))
        )

    def result(self, progress: Progress) -> Calibrated:
        progress("fitting the parameters")
        faults: list[Fault] = []
        before = self.rms(np.array(self.start), [])
        values, spread = self.fitted(self.start, [])
        plain = self.rms(values, [])
        after = plain
        known = [Fault(n, k, n in self.entered) for n in (*self.entered, *self.outputs) for k in KINDS]
        singles = self._tried([(f,) for f in known], values, progress)
        near = [t.faults[0] for t in sorted(singles, key=lambda t: t.misfit)[:PAIRED]]
        pairs = self._tried(list(combinations(near, 2)), values, progress)
        for group in (singles, pairs):  # a pair must earn more than the best single one
            best = min((t for t in group if t.clear), key=lambda t: t.misfit, default=None)
            if best is not None and self.held(best.rms) < (1 - BETTER) * self.held(after):
                faults, values, spread, after = list(best.faults), best.values, best.spread, best.rms
        count = len(self.parameters)
        return {
            "fmu": str(self.unit.path),
            "recording": self.given.source,
            "parameters": {
                n: {
                    "value": float(v),
                    "interval": (float(v - WIDE * s), float(v + WIDE * s)),
                    "start": start,
                    "unit": self.unit.unit(n),
                }
                for n, v, s, start in zip(self.parameters, values, spread, self.start, strict=False)
            },
            "rms": {
                n: {"unit": self.given.units[n], "start": before[n], "calibrated": plain[n], "with_faults": after[n]}
                for n in self.outputs
            },
            "faults": [self._fault(f, v, s) for f, v, s in zip(faults, values[count:], spread[count:], strict=True)],
            "cannot_show": "which equation inside the FMU is wrong, or what it lacks: its inside is closed",
        }

    def _tried(self, sets: Sequence[tuple[Fault, ...]], start: np.ndarray, progress: Progress) -> list["_Tried"]:
        """Each set of faults, fitted from these values of the parameters."""
        found = []
        for faults in sets:
            progress(f"asking for {' and '.join(map(str, faults))}")
            values, spread = self.fitted(start[: len(self.parameters)], faults)
            found.append(_Tried(faults, values, spread, self.rms(values, faults), len(self.parameters)))
        return found

    def _fault(self, fault: Fault, size: float, spread: float) -> FittedFault:
        by = {"delay": (self.given.dt, "s"), "gain": (1.0, "1")}
        by["offset"] = (float(self.given[fault.channel].std() or 1.0), self.given.units[fault.channel])
        factor, unit = by[fault.kind]
        low, high = (float((size + k * WIDE * spread) * factor) for k in (-1, 1))
        return {
            "channel": fault.channel,
            "kind": fault.kind,
            "size": float(size * factor),
            "interval": (low, high),
            "unit": unit,
        }
