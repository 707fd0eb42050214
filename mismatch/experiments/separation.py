"""The experiment, or the sensor, that tells two explanations of a recording apart: both explanations are simulated.

The first explanation is simulated in free run over each experiment, as the sensors would record it. The second is
compared with that record by the comparison rule, after its parameters have adapted as far as the recording so far
allows. What is left is a distance in standard deviations of the noise.
"""

import copy
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypedDict

import numpy as np

from greygate.mismatch.coloured import Coloured
from greygate.mismatch.diagnosis import Diagnosis
from greygate.mismatch.experiments.experiment import HOLD, SAMPLES, Bounds, Experiment, FreeRun, experiments
from greygate.mismatch.experiments.rivals import Rival, rivals, screened
from greygate.mismatch.fit import Fit, Likelihood
from greygate.mismatch.locate import display_unit
from greygate.mismatch.model import Model
from greygate.mismatch.noise import Noise
from greygate.mismatch.rig import Channel
from greygate.mismatch.runs import with_channels
from greygate.mismatch.several import modelled
from greygate.plain import Figure
from greygate.plants.recording import Recording

REACHES = (1.0, 1.5)  # of what was recorded; the second where the first tells too little
NEEDED = 3.5  # standard deviations by which two explanations must differ to be told apart
WORTH = 2.0  # times the distance on the recording so far: less is not worth an experiment or a sensor
ENOUGH = 3.0  # times what is needed, or there already: an experiment that brings so much is good enough
SHORTLIST = 4  # experiments for which the distance is computed after the parameters have adapted
FINE = 1e-3  # of its range: the noise of a sensor that might be added
LARGEST = float(np.sqrt(np.finfo(float).max))  # range of a signal whose square is a number
INDEPENDENT = 1e-13  # of the largest singular value, below which parameters count as dependent on each other
TWO_DIGITS = 10  # from which a distance is written without digits after the point


class Span(TypedDict):
    low: float
    high: float
    unit: str


class Described(TypedDict):
    shape: str
    inputs: dict[str, Span]
    seconds: float


class Apart(Described):
    apart: Figure
    here: Figure


class Sensor(TypedDict):
    state: str
    apart: Figure


@dataclass(frozen=True)
class Separation:
    """apart: standard deviations of the noise by which two explanations then differ; here: on the recording so far."""

    experiment: Experiment
    apart: float
    here: float

    @property
    def tells(self) -> bool:
        return self.apart > max(WORTH * self.here, NEEDED)

    @property
    def enough(self) -> bool:
        return self.apart > ENOUGH * max(self.here, NEEDED)

    @property
    def merit(self) -> tuple:
        """Enough comes first, then what tells at all, then what a second of it brings."""
        return self.enough, self.tells, self.apart / np.sqrt(self.experiment.seconds)

    def as_dict(self, units: Mapping[str, str]) -> Apart:
        """shape, inputs: channel -> low, high, unit; seconds, apart, here."""
        return {**described(self.experiment, units), "apart": self.apart, "here": self.here}

    def words(self, units: Mapping[str, str]) -> str:
        """Input, amplitude, duration, and what it brings."""
        return f"{words(self.experiment, units)}; {deviations(self.apart)} apart, here {figure(self.here)}"


def described(experiment: Experiment, units: Mapping[str, str]) -> Described:
    """shape, inputs: channel -> low, high, unit; seconds."""
    spans: dict[str, Span] = {
        n: {"low": float(np.min(s)), "high": float(np.max(s)), "unit": units[n]} for n, s in experiment.inputs.items()
    }
    return {"shape": experiment.shape, "inputs": spans, "seconds": experiment.seconds}


def words(experiment: Experiment, units: Mapping[str, str]) -> str:
    """Input, amplitude, and duration."""
    spans = [_span(n, s, units[n]) for n, s in experiment.inputs.items()]
    return f"{', '.join(spans)}: {experiment.shape}, for {experiment.seconds:.3g} s"


def deviations(size: float) -> str:
    return f"{figure(size)} standard deviations of the noise"


def figure(size: float) -> str:
    return f"{size:.0f}" if size >= TWO_DIGITS else f"{size:.2g}"


def _span(name: str, signal: np.ndarray, unit: str) -> str:
    low, high = float(np.min(signal)), float(np.max(signal))
    factor, label = display_unit(unit, max(abs(low), abs(high)))
    least, most = f"{factor * low:.3g}", f"{factor * high:.3g}"
    return f"{name} {least} to {most} {label}".rstrip() if least != most else f"{name} at {least} {label}".rstrip()


@dataclass(frozen=True)
class Trial:
    """A recording as it would be if the explanation `values` were true. likelihood: that of the recording."""

    likelihood: Likelihood
    values: Mapping[str, float]
    _left: dict[int, tuple[Fit, np.ndarray]] = field(default_factory=dict, init=False, compare=False, repr=False)
    _slopes: dict[int, tuple[Fit, np.ndarray]] = field(default_factory=dict, init=False, compare=False, repr=False)

    @cached_property
    def truth(self) -> np.ndarray:
        """Errors of the explanation (samples, channels): on an experiment those of rounding."""
        return self.likelihood.errors(self.values, self.likelihood.nothing())

    @cached_property
    def basis(self):
        even = np.ones(self.truth.shape[1])
        return self.likelihood.basis(self.values, self.likelihood.nothing(), self.truth, even)

    def left(self, rival: Fit) -> np.ndarray:
        """By how much `rival` predicts otherwise, in units of the noise, (windows, rows); 0 where it diverges.

        What other beginnings of the windows explain is taken off.
        """
        if id(rival) not in self._left:
            errors = self.likelihood.errors(rival.values, self.likelihood.nothing()) - self.truth
            errors = errors if np.isfinite(errors).all() else np.zeros_like(errors)
            rows = self.likelihood.rows(errors, np.ones(errors.shape[1]))
            self._left[id(rival)] = rival, self.likelihood.eliminate(rows[:, :, None], None, self.basis)[0][:, :, 0]
        return self._left[id(rival)][1]

    def slopes(self, rival: Fit) -> np.ndarray:
        """Of what `rival` predicts by the numbers of its unknowns, likewise (windows * rows, k)."""
        if id(rival) not in self._slopes:
            shifts, even = self.likelihood.nothing(), np.ones(self.truth.shape[1])
            errors = self.likelihood.errors(rival.values, shifts)
            slopes = self.likelihood.slopes(rival.unknowns, rival.values, shifts, errors, even)
            slopes = self.likelihood.eliminate(slopes, None, self.basis)[0].reshape(-1, len(rival.unknowns))
            self._slopes[id(rival)] = rival, slopes
        return self._slopes[id(rival)][1]

    def distance(self, rival: Fit, alone: bool = False, true: Fit | None = None) -> float:
        """Standard deviations of the noise by which `rival` differs after its parameters have adapted.

        They adapt as far as the recording of its own fit leaves them free; alone: as far as the data sheet does.
        true: the explanation from which it differs, by default that of the trial.
        """
        left, slopes = self.left(rival).reshape(-1), self.slopes(rival)
        if true is not None:
            left = left - self.left(true).reshape(-1)
        known = np.diag(rival.weight) if alone else rival.information
        pull = slopes.T @ left
        step = np.linalg.lstsq(slopes.T @ slopes + known, pull, rcond=INDEPENDENT)[0]
        return float(np.sqrt(max(left @ left - pull @ step, 0.0)))


@dataclass(frozen=True)
class PlayedTrial(Trial):
    """The recording of an experiment."""

    experiment: Experiment


class Trials:
    """Experiments on the rig of `likelihood`, as they run if the explanation `values` (symbol -> value) is true.

    longest: seconds that one may take.
    """

    def __init__(self, likelihood: Likelihood, values: Mapping[str, float], longest: float = np.inf):
        self.likelihood, self.longest = likelihood, longest
        self.free = FreeRun(likelihood.model.rig, likelihood.model.effects, values)
        self._over: dict[tuple[float, float], list[PlayedTrial]] = {}
        self._bounds: dict[float, Bounds] = {}

    def apart(self, rival: Fit, here: float) -> Separation | None:
        """The experiment that tells `rival` from the explanation best; None where the rig withstands none of them.

        here: standard deviations of the noise between the two on the recording so far.
        """
        found: list[Separation] = []
        for reach in REACHES:
            found += [Separation(t.experiment, t.distance(rival), here) for t in self.likeliest(rival, reach)]
            if any(s.tells for s in found):
                break
        return max(found, key=lambda s: s.merit, default=None)

    def likeliest(self, rival: Fit, reach: float, times: float = 1.0) -> list[PlayedTrial]:
        """Those in which `rival` differs most before its parameters adapt, in a second. Arguments: as for `over`."""
        trials = self.over(reach, times)
        return sorted(trials, key=lambda t: -np.sum(t.left(rival) ** 2) / t.experiment.seconds)[:SHORTLIST]

    @property
    def seconds(self) -> float:
        """Of a short experiment."""
        recording = self.likelihood.model.recording
        return min(SAMPLES, recording.samples) * recording.dt

    def bounds(self, reach: float) -> Bounds:
        """What may be asked of the rig: `reach` times what was recorded."""
        if reach not in self._bounds:
            recording = self.likelihood.model.recording
            bounds = Bounds.of(self.likelihood.model.rig, recording, reach)
            self._bounds[reach] = self.free.at_rest(bounds, recording, HOLD * self.seconds)
        return self._bounds[reach]

    def over(self, reach: float, times: float = 1.0) -> list[PlayedTrial]:
        """The strongest and the mildest experiment of every kind that stay within `reach` times what was recorded.

        times: as long as usual.
        """
        if (reach, times) not in self._over:
            bounds, found, dt = self.bounds(reach), [], self.likelihood.model.recording.dt
            for kind in experiments(bounds, times * self.seconds, dt, self.longest):
                stood = [(e, r) for e in kind if (r := self.free.record(e.inputs, bounds)) is not None]
                found += [self._trial(*pair) for pair in (*stood[:1], *stood[1:][-1:])]
            self._over[reach, times] = found
        return self._over[reach, times]

    def withstood(self, experiment: Experiment, left: Iterable[Rival], reach: float) -> bool:
        """Whether no channel leaves its bounds, whichever of the explanations that are `left` is true."""
        return all(self.free.under(r.fit.values).record(experiment.inputs, self.bounds(reach)) for r in left)

    def _trial(self, experiment: Experiment, record: Recording) -> PlayedTrial:
        return PlayedTrial(like(self.likelihood, self.likelihood.model.over(record)), self.free.values, experiment)


def like(likelihood: Likelihood, model: Model) -> Likelihood:
    """A likelihood with the same noise over the recording of another model, which may have further channels."""
    if isinstance(likelihood, Coloured):
        coloured = Coloured(model)
        further = [model.rig.channels[name].noise for name in model.rig.predict[len(likelihood.scale) :]]
        coloured.ar = [*likelihood.ar, *(np.zeros(likelihood.order) for _ in further)]
        coloured.scale = np.append(likelihood.scale, further)
        return coloured
    made = Likelihood(model)
    known, told = likelihood.noise, made.noise
    count = len(known.scale)
    made.noise = Noise(np.append(known.scale, told.scale[count:]), (*known.ar, *told.ar[count:]))
    return made


def sensor(likelihood: Likelihood, values: Mapping[str, float], rival: Fit) -> tuple[str, float] | None:
    """(state, distance): the state whose sensor, of FINE resolution, would tell `rival` from `values` best.

    On the recording as it is; None where every state is a channel already, or the rate of one.
    """
    model = likelihood.model
    values = {**model.values, **{s: v for s, v in values.items() if s in model.values}}
    states, _ = model.states(values, likelihood.nothing())
    found = []
    for symbol, signal in zip(model.plant.states, states.T, strict=True):
        known = symbol in model.rig.channels or symbol in model.rates or symbol not in model.rig.plant.states
        if known or not 0.0 < np.ptp(signal) < LARGEST:
            continue
        trial = Trial(like(likelihood, _with_sensor(model, symbol, signal)), values)
        found.append((trial.distance(rival), symbol))
    return max(found)[::-1] if found else None


def _with_sensor(model: Model, symbol: str, signal: np.ndarray) -> Model:
    """`model` on a rig that also has a sensor of the state `symbol`, which showed `signal`."""
    rig, recording = model.rig, model.recording
    channel = Channel(model.plant.states[symbol].unit, "output", noise=FINE * float(np.ptp(signal)))
    richer = replace(rig, channels={**rig.channels, symbol: channel}, predict=(*rig.predict, symbol))
    channels, units = {**recording.channels, symbol: signal}, {**recording.units, symbol: channel.unit}
    return modelled(richer, with_channels(recording, channels, units), model.effects, model.window)


def imagined(likelihood: Likelihood, values: Mapping[str, float]) -> Likelihood:
    """`likelihood` as if it had recorded what `values` (symbol -> value) predict, without noise."""
    other = copy.copy(likelihood)
    other.model = copy.copy(likelihood.model)
    other.model.target = likelihood.model.predict({**likelihood.model.values, **values}, likelihood.nothing())
    return other


# -- of a diagnosis --------------------------------------------------------------------------------------------------


def separations(result: Diagnosis, entries: Iterable[Mapping], count: int) -> dict[tuple[str, str], Separation]:
    """What tells effects of a diagnosis from what they are not told apart from, (effect, other) -> separation.

    entries: some of its `effects`. Only the first `count` alternatives are tried. Those are left out for which the rig
    withstands no experiment.
    """
    trials, found = None, {}
    for rival in rivals(result, entries, count):
        trials = trials or Trials(screened(result), result.corrected.values)
        told = trials.apart(rival.fit, rival.here)
        if told is not None:
            found[rival.effect, rival.name] = told
    return found
