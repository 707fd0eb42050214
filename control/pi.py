"""The rival: a PI controller with velocity feed-forward, tuned on a trajectory of its own."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from greygate.control.predictive import Limits


@dataclass
class Proportional:
    """u = gain e + integral of reset_rate gain e + forward dr/dt, e = r - y; the integral stands while u is limited.

    output: the measured signal. gain: [input/output unit], reset_rate: [1/s], forward: [input per output unit per s],
    lead: s, by which the reference's velocity is read ahead of the present, because the plant lags. period: s.
    """

    output: str
    limits: Limits
    period: float
    gain: float
    reset_rate: float
    forward: float
    lead: float = 0.0

    def __post_init__(self) -> None:
        self.ahead = int(np.ceil(self.lead / self.period)) + 1
        self.reset()

    def reset(self) -> None:
        self._integral = 0.0

    def __call__(self, measured: Mapping[str, float], before: float, reference: np.ndarray) -> float:
        error = float(reference[0]) - measured[self.output]
        at = self.lead / self.period
        a, b = np.interp([at, at + 1], np.arange(len(reference)), reference)
        wanted = self.gain * error + self._integral + self.forward * (b - a) / self.period
        if self.limits.kept(wanted, before) == wanted:
            self._integral += self.gain * self.reset_rate * error * self.period
        return float(wanted)


@dataclass
class Loops:
    """A PI controller of each output that tracks. columns: the input of each; the other inputs stay at `rest`."""

    loops: Sequence[Proportional]
    columns: Sequence[int]
    rest: np.ndarray

    def __post_init__(self) -> None:
        self.ahead = max(loop.ahead for loop in self.loops)
        self.reset()

    def reset(self) -> None:
        for loop in self.loops:
            loop.reset()

    def __call__(self, measured: Mapping[str, float], before: np.ndarray, reference: np.ndarray) -> np.ndarray:
        wanted = self.rest.copy()
        for row, (loop, column) in enumerate(zip(self.loops, self.columns, strict=True)):
            wanted[column] = loop(measured, float(before[column]), reference[:, row])
        return wanted


def tuned(
    start: Proportional, track: Callable[[Proportional], float], lead: bool, evaluations: int = 120
) -> Proportional:
    """The controller with the least RMS error on the tuning trajectory, by Nelder and Mead on the logarithms.

    track: closed loop on that trajectory, its RMS error (inf where it fails). lead: whether the lead is tuned, too.
    """
    names = ["gain", "reset_rate", "forward", *(["lead"] if lead else [])]
    first = {n: getattr(start, n) for n in names}
    if lead and not first["lead"]:
        first["lead"] = start.period
    fixed = {n: getattr(start, n) for n in ("output", "limits", "period")}

    def at(x: np.ndarray) -> Proportional:
        return Proportional(**fixed, **{n: first[n] * float(np.exp(v)) for n, v in zip(names, x, strict=True)})

    simplex = np.vstack([np.zeros(len(names)), np.eye(len(names))])
    options = {"maxfev": evaluations, "initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-12}
    found = minimize(lambda x: track(at(x)), simplex[0], method="Nelder-Mead", options=options)
    return at(found.x)
