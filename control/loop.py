"""Closed loops: a controller on a rig, and what is asked of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from greygate.control.predictive import Limits
from greygate.errors import InputError
from greygate.progress import Progress, silent


class Rig(Protocol):
    """A simulated machine under way, with its sensors and its actuator."""

    def measured(self) -> dict[str, float]:
        """What the sensors give now."""

    def actuate(self, value: Any) -> Any:
        """Hold an input, or (inputs,), for a sample; returns what the actuator made of it."""

    def truth(self) -> dict[str, float]:
        """What is judged: the output that tracks, those with limits, and `power` [W] that is drawn; no sensor's."""


class Controller(Protocol):
    ahead: int
    """Samples of the reference that it reads beyond the present one."""

    def reset(self) -> None:
        """Back to before the first step."""

    def __call__(self, measured: Mapping[str, float], before: Any, reference: np.ndarray) -> Any:
        """The input now. before: what acted since the last sample. reference: (ahead + 1,), from the present sample.

        Where there are several, the inputs are (inputs,), the reference (ahead + 1, outputs that track).
        """


@dataclass(frozen=True)
class Run:
    """A closed loop that was run. error: (N,) of the output that tracks. input: (N,) as the actuator made it; both
    have a column for each where there are several.

    signals: truth and measured, (N,). seconds: (N,) that the controller took on this computer. violations: samples in
    which a limit was broken, by limit.
    """

    error: np.ndarray
    input: np.ndarray
    signals: Mapping[str, np.ndarray]
    seconds: np.ndarray
    violations: Mapping[str, int]
    period: float

    def figures(self, skip: int = 0) -> dict[str, float]:
        """rms, worst: of the error [its unit]. effort: RMS of the input. energy: J, where the rig tells its power.
        microseconds: of a step, median."""
        error = self.error[skip:]
        found = {
            "rms": float(np.sqrt(np.mean(error**2))),
            "worst": float(np.abs(error).max()),
            "effort": float(np.sqrt(np.mean(self.input[skip:] ** 2))),
            "violations": sum(self.violations.values()),
            "microseconds": 1e6 * float(np.median(self.seconds)),
        }
        if "power" in self.signals:
            found["energy"] = float(self.signals["power"].sum() * self.period)
        return found


def run(
    rig: Rig,
    controller: Controller,
    reference: np.ndarray,
    output: str | Sequence[str],
    limits: Limits,
    period: float,
    start: Any = 0.0,
    progress: Progress = silent,
) -> Run:
    """Track a reference (N,) [unit of `output`]; beyond its end it rests. start: the input before the first sample.

    Of several outputs the reference is (N, outputs), and start (inputs,). Raises InputError for a reference that is
    empty or not finite.
    """
    reference = np.asarray(reference, float)
    if reference.ndim != 1 + (not isinstance(output, str)) or not reference.size or not np.isfinite(reference).all():
        raise InputError(f"reference of shape {reference.shape}: give one sequence of finite numbers")
    samples, before = len(reference), start
    longer = np.concatenate([reference, np.repeat(reference[-1:], controller.ahead, axis=0)])
    given, seconds = np.empty((samples, *np.shape(start))), np.empty(samples)
    signals: dict[str, np.ndarray] = {}
    controller.reset()
    for k in range(samples):
        measured = rig.measured()
        for name, value in (measured | rig.truth()).items():
            signals.setdefault(name, np.empty(samples))[k] = value
        began = perf_counter()
        wanted = controller(measured, before, longer[k : k + controller.ahead + 1])
        seconds[k] = perf_counter() - began
        given[k] = rig.actuate(limits.kept(wanted, before))
        before = given[k]
        if not k % 1000:
            progress(f"sample {k} of {samples}")
    tracked = signals[output] if isinstance(output, str) else np.stack([signals[n] for n in output], axis=1)
    return Run(tracked - reference, given, signals, seconds, _violations(limits, given, signals, start), period)


def _violations(limits: Limits, given: np.ndarray, signals: Mapping[str, np.ndarray], start: Any) -> dict[str, int]:
    rounding = np.maximum(
        limits.resolution, 1e-9 * (limits.high - limits.low)
    )  # what the actuator rounds breaks no limit
    found = {
        "input": (given < limits.low - rounding) | (given > limits.high + rounding),
        "rate": np.abs(np.diff(given, axis=0, prepend=np.array(start)[None])) > limits.rate + rounding,
    }
    found |= {n: (signals[n] < low) | (signals[n] > high) for n, (low, high) in limits.outputs.items()}
    return {n: int(np.count_nonzero(broken)) for n, broken in found.items()}
