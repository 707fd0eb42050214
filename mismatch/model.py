"""One recording under one plant: what the plant predicts where it restarts, for any values of its parameters.

The comparison rule of the rigs: a simulation restarts from the recorded state at the beginning of every window, and
runs free in between. Where the rig has no window, it runs free from the first sample to the last.
"""

import copy
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from functools import partial
from threading import Lock
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter, savgol_filter
from scipy.special import chdtri

from greygate.errors import InputError
from greygate.mismatch import filters as of
from greygate.mismatch.entries import SENSOR, TIME, Effect
from greygate.mismatch.joining import join
from greygate.mismatch.responses import Responses, forced, pushes
from greygate.mismatch.rig import IN, LINEAR, Rig
from greygate.mismatch.runs import pieces
from greygate.mismatch.scales import CUBIC, FEWEST_BESIDE, PARABOLA, PART, memory, noise, smoothing, span
from greygate.plants.expressions import names, summands
from greygate.plants.plant import Parameter, Values
from greygate.plants.recording import Recording
from greygate.plants.simulator import Restarted
from greygate.progress import check, spend

TIMING = "input_timing"  # s by which inputs act later than the recording says: a nuisance, known well
EARLY = "input_early"  # a nuisance: part of a sample by which inputs act early, in the mean, as they moved in between;
MOST_EARLY = 0.5  # at most, which are inputs that never rest: of m moves a sample it is (1 - 1/m) / 2
RAMP, STEEPEST = (-0.5, 0.5), 4.0  # ends of a sample; slope there of such an input over `EARLY` (1 - `EARLY`)
PARTS = 10  # of a sample, at most, in each of which a filtered input is constant: whole steps of the plant
BLUR = "input_blur"  # a nuisance: at 0 an acceleration is smoothed over SMOOTH, at 1 over the shorter FINER * SMOOTH
NUISANCES = (TIMING, EARLY, BLUR)
FINER = 0.6  # of SMOOTH
SMOOTH = 20  # samples on either side of a sample, over which a smoothed rate is taken
SMOOTHED = (0.005, 0.5)  # of a signal's memory, between which smoothing stays: it takes noise and leaves motion
FEWEST_SMOOTHED = 2 * FEWEST_BESIDE + 1  # samples
BEGINS = "begins_"  # before a state and the recording: a nuisance, by how much its free run begins off the reading
READINGS = 3  # rounds in which a sensor's error, a small function of the true value, is taken off its reading
TINY = 1e-300  # instead of a size that is 0, by which something is divided
FEWEST_FIRST = 6  # samples, at least, whose parabola gives the velocity at the first
BENT = 3.0  # times its deviation, by which that velocity may be off: a parabola bends unseen
STRAYS = 0.01  # chance that so many samples leave their own parabola by noise alone, below which it is too long
FAR = 10.0  # times its noise, by which a recorded state begins elsewhere than at 0
START_SIZE = 1e-3  # of the largest reading: the least size of a starting value, by which its steps are scaled
START_STEP = 1e-4  # of that size, for a difference
FARTHEST = 1e6  # spreads of a channel: a run that diverges is said to be so far off
KEPT = 2  # filtered inputs that are kept beside the newest: a slope asks for two by turns
START_TRIALS = 60  # runs in which starting values are fitted, at most


class Answers:
    """The last that was made, for whoever asks for the same."""

    def __init__(self) -> None:
        self._lock, self._key = Lock(), ()
        self._made: Any = None

    def of(self, key: tuple, make: Callable[[], Any]) -> Any:
        """What was made for `key`, or is now."""
        with self._lock:
            if self._made is None or key != self._key:
                self._key, self._made = key, make()
            return self._made


class Model:
    """The rig's plant over one recording; all effects have joined it, at values where they do nothing.

    values: symbol -> value at which the plant is that of the data sheet.
    locals: the states that begin at every restart as recorded; a fit may shift them. begins: likewise of one free run,
    where the plant's file says nothing of a beginning and the recording does not begin at 0: the nuisance that shifts
    a state, and the state. unsure: that nuisance's standard deviation. first: the rates of such states, as recorded.
    """

    def __init__(self, rig: Rig, recording: Recording, effects: Mapping[str, Effect], window: int | None = None):
        self.rig, self.effects = rig, effects
        own = pushes(rig.plant) if rig.window else ()
        self.plant, self.readings = join(rig.plant, [*effects.values(), *own])
        timed = bool(rig.window or rig.plant.early)
        if timed:
            self._add(TIMING, "s")
        if rig.window:
            self._add(EARLY, "1")
        derived = self.plant.derived.items()
        self.integrals = {name: how.partition(" ")[2] for name, how in derived if how.startswith("integral ")}
        self.finer = {name: how for name, how in derived if how.startswith("smooth_acceleration ")}
        if self.finer:
            self._add(BLUR, "1")
        self._filters: dict[str, list[tuple[str, tuple[str, ...]]]] = {}
        for effect in effects.values():
            for name, text in effect.filters.items():
                kind, *symbols = text.split()
                known = of.SENSOR if name.startswith(SENSOR) else FILTERS
                if kind not in known:
                    raise InputError(f"effect {effect.key}: filters.{name}: {kind!r}; give one of {', '.join(known)}")
                self._filters.setdefault(name, []).append((kind, tuple(symbols)))
        for name in rig.inputs if timed else ():
            self._filters.setdefault(name, []).append(("delay", (TIMING,)))
        steps = Restarted(self.plant, rig.dt, self.plant.step).substeps
        self._parts = next(parts for parts in range(PARTS, 0, -1) if steps % parts == 0)
        self._compiled = Restarted(self.plant, rig.dt / self._parts, self.plant.step)
        self._take(recording, rig.window if window is None else window)
        self.runs = 0

    def _add(self, nuisance: str, unit: str) -> None:
        """Give the plant a parameter of the simulation itself."""
        if nuisance in self.plant.symbols:
            raise InputError(f"plant {self.plant.name}: {nuisance}: is the simulation's own name; rename it")
        self.plant = replace(self.plant, parameters={**self.plant.parameters, nuisance: Parameter(0.0, unit)})

    @property
    def inputs(self) -> dict[str, np.ndarray]:
        """The plant's inputs along the recording (samples,), the derived ones too."""
        return dict(self._inputs)

    @property
    def each(self) -> list["Model"]:
        """The model over each recording alone; here it is one (`several` joins more)."""
        return [self]

    @property
    def pieces(self) -> list[slice]:
        """The samples of each recording."""
        return pieces(self.recording)

    def as_recorded(self) -> "Model":
        """This model, begun at every restart as recorded: no fit may shift where it begins."""
        for model in (self, *self.each):
            model.locals = []
        return self

    def spread(self, values: Mapping[str, float]) -> dict[str, float | np.ndarray]:
        """`values` along the recording: an array (samples,) where they differ from recording to recording."""
        return dict(values)

    def over(self, recording: Recording) -> "Model":
        """The same model over another recording of its rig."""
        other = copy.copy(self)
        other._take(recording, self.window)
        return other

    @property
    def early_by(self) -> float:
        """By how much inputs may act early (s): a simulator from outside takes them in steps of its own."""
        return self.plant.early * self._compiled.step

    @property
    def steps(self) -> int:
        """Steps of the plant in a sample."""
        return self._compiled.substeps * self._parts

    @property
    def work(self) -> int:
        """What a run is counted for: steps of its states."""
        return self.recording.samples * self.steps * len(self.plant.states)

    @property
    def longer_steps(self) -> list[int]:
        """How many steps an unchanging input may be integrated in, fewer than now, in rising order."""
        if self.plant.outside and self.plant.outside.fixed:
            return []
        steps = self._compiled.substeps
        return [n for n in range(1, steps) if steps % n == 0]

    def in_steps(self, steps: int) -> "Model":
        """The same model, an unchanging input integrated in so many steps."""
        other = copy.copy(self)
        other._compiled = self._compiled.in_steps(steps)
        other._last, other._answers = (None, np.empty((0, 0))), Answers()
        return other

    def longer(self) -> Iterator["Model"]:
        """The same model in longer steps of time, the longest first; none of a simulator whose steps are fixed."""
        if self.plant.outside and self.plant.outside.fixed:
            return
        for steps in (n for n in range(1, self.steps) if self.steps % n == 0):
            other = copy.copy(self)
            other._parts = next(parts for parts in range(PARTS, 0, -1) if steps % parts == 0)
            other._compiled = Restarted(self.plant, self.rig.dt / other._parts, self.rig.dt / steps)
            other._part()
            yield other

    def driven(self, name: str, signal: np.ndarray) -> "Model":
        """The same model with another signal (samples,) in the place of an input that nothing filters."""
        other = copy.copy(self)
        other._inputs = {**self._inputs, name: signal}
        other._parted = {**self._parted, name: self._over_parts(name, signal)}
        other._made, other._last, other._answers = {}, (None, np.empty((0, 0))), Answers()
        return other

    def _take(self, recording: Recording, window: int | None) -> None:
        self.recording, self.window = recording, window
        self.restarts = np.arange(0, recording.samples, window or recording.samples)  # the last window may be shorter
        states = self.plant.states
        rates = {s.rate: symbol for symbol, s in states.items() if s.rate is not None}
        moved = [s for s in states if s not in self.plant.shown]
        self.measured = [s for s in moved if s in self.rig.channels] if window else []
        self.rates = {v: x for v, x in rates.items() if x in self.measured}
        self.locals = [*self.measured, *self.rates]
        self.reset = np.array([s in self.locals for s in states])
        self._smooth_channels: dict[tuple[str, int], np.ndarray] = {}
        self._smoothing: dict[str, tuple[int, int]] = {}
        sources = {how.partition(" ")[2] for how in self.plant.derived.values()}
        if recording.samples < FEWEST_SMOOTHED and (sources or self.rates):
            few = f"{recording.samples} samples; a rate is smoothed over {FEWEST_SMOOTHED}"
            raise InputError(f"{recording.source}: {few}, record at least so many")
        self._smooth = {source: reach(recording[source], SMOOTH) for source in sources}
        self._inputs = {name: self._input(name, recording.channels) for name in self.plant.inputs}
        self._part()
        self._finer = {name: self._input(name, recording.channels, FINER) - self._inputs[name] for name in self.finer}
        self.target = np.stack([recording[name] for name in self.rig.predict], axis=1)
        self.first, self.unsure = ({}, {}) if window else self._elsewhere(rates)
        self.begins = {key: key.removeprefix(BEGINS).partition(IN)[0] for key in self.unsure}
        known = {symbol: p.value for symbol, p in self.plant.parameters.items()}
        self.values = {**known, **dict.fromkeys(self.begins, 0.0)}
        self.moving = [*self._moving(), *self.begins]

    def _part(self) -> None:
        """Its inputs in the parts of a sample; no run that was made before stands for one now."""
        self._parted = {name: self._over_parts(name, signal) for name, signal in self._inputs.items()}
        summed = {name: np.repeat(self.recording[u], self._parts) for name, u in self.integrals.items()}
        self._parted |= {name: self._summed(signal) for name, signal in summed.items()}
        self._last: tuple[tuple | None, np.ndarray] = (None, np.empty((0, 0)))
        self._made: dict[tuple, dict[str, np.ndarray]] = {}
        self._answers = Answers()

    def _elsewhere(self, rates: Mapping[str, str]) -> tuple[dict[str, float], dict[str, float]]:
        """Recorded states, and their rates, that do not begin at 0, where the plant's file says nothing else.

        (First rates, by how much states may begin off their readings as a standard deviation by nuisance.)
        """
        recorded, first, unsure = self.recording.channels, dict[str, float](), dict[str, float]()
        outside = self.plant.outside.stepped if self.plant.outside else ()
        moved = {s: x for s, x in self.plant.states.items() if s not in self.plant.shown}
        given = {s: x.initial for s, x in moved.items() if x.initial == 0.0 or s in outside}
        ways = {position: rate for rate, position in rates.items() if rate in given}
        for symbol in (s for s in given if s in recorded and s in self.rig.channels):
            sigma = max(self.rig.channels[symbol].sigma, noise(recorded[symbol]))
            if abs(recorded[symbol][0] - given[symbol]) > FAR * sigma:
                unsure[f"{BEGINS}{symbol}{IN}{self.recording.name}"] = sigma
                if rate := ways.get(symbol):
                    first[rate], away = first_rate(recorded[symbol], sigma)
                    first[rate] /= self.rig.dt
                    unsure[f"{BEGINS}{rate}{IN}{self.recording.name}"] = BENT * away / self.rig.dt
        return first, unsure

    def _moving(self) -> list[str]:
        """Parameters that change the states: all but those that only outputs and sensors use."""
        plant = self.plant
        outputs = {name for name, d in plant.definitions.items() if d.symbol in self.rig.predict}
        texts = [text for name, d in plant.definitions.items() if name not in outputs for text in d.terms.values()]
        texts += [text for e in plant.equations.values() for text in e.texts]
        bounds = (b for s in plant.states.values() for b in (s.initial, s.start, s.low, s.high))
        texts += [b for b in bounds if isinstance(b, str)]
        begun = [*self.measured, *(s for s in self.begins.values() if s in self.recording.channels)]
        moved = [*plant.inputs, *(SENSOR + channel for channel in begun)]
        filters = {symbol for name in moved for _, symbols in self._filters.get(name, ()) for symbol in symbols}
        texts += [text for channel in begun for text in self.readings.get(channel, {}).values()]
        outside = plant.outside.parameters if plant.outside else ()
        used = names(texts) | filters | {BLUR, EARLY, *outside}
        return [s for s in plant.parameters if s in used]

    def _input(self, name: str, recorded: Mapping[str, np.ndarray], share: float = 1.0) -> np.ndarray:
        if name in recorded:
            return recorded[name]
        if name == "t":
            return self.recording.time
        how, _, source = self.plant.derived[name].partition(" ")
        signal, dt = recorded[source], self.rig.dt
        if not np.isfinite(signal).all():  # of a filter that diverges, in a trial
            return np.full(len(signal), np.nan)
        half = max(round(share * self._smooth[source]), FEWEST_BESIDE)
        match how:
            case "rate":
                return np.append(np.diff(signal) / dt, 0.0)
            case "integral":
                return np.concatenate(([0.0], np.cumsum(signal[:-1]) * dt))
            case "smooth_rate":
                return savgol_filter(signal, 2 * half + 1, PARABOLA, deriv=1, delta=dt)
            case "smooth_acceleration":
                return savgol_filter(signal, 2 * half + 1, CUBIC, deriv=2, delta=dt)
        raise InputError(f"plant {self.plant.name}: derived {name}: {how!r}; give rate, integral, smooth_rate or so")

    def _signals(self, values: Mapping[str, float]) -> dict[str, np.ndarray]:
        """The plant's inputs (samples * parts,), filtered; the last are kept, for most parameters change none."""
        acting = ((name, *self._acting(name, values)) for name in self.plant.inputs)
        key = *acting, values.get(BLUR, 0.0), values.get(EARLY, 0.0)
        made = self._made  # other threads may put another in its place
        if key not in made:
            self._made = made = dict([*made.items()][-KEPT:]) | {key: self._filtered(values)}
        return dict(made[key])

    def _filtered(self, values: Mapping[str, float]) -> dict[str, np.ndarray]:
        """The plant's inputs (samples * parts,)."""
        signals = dict(self._parted)
        early, dt = values.get(EARLY, 0.0), self.rig.dt / self._parts
        for name in self.plant.inputs:
            if early and name in self.rig.inputs and not self._linear(name):
                signals[name] = self._moved(self._inputs[name], early)
            for kind, given in self._acting(name, values):
                signals[name] = FILTERS[kind](signals[name], *given, dt)
        for name, how in self.plant.derived.items():
            source = how.partition(" ")[2]
            if signals.get(source) is not self._parted.get(source):
                if name in self.integrals:
                    signals[name] = self._summed(signals[source])
                else:
                    signals[name] = np.repeat(self._input(name, {source: self._means(signals[source])}), self._parts)
        for name, more in self._finer.items():
            if values[BLUR]:
                signals[name] = signals[name] + values[BLUR] * np.repeat(more, self._parts)
        return signals

    def _linear(self, name: str) -> bool:
        """Whether an input goes straight from one sample to the next: a measurement, that no converter held."""
        return name in self.rig.channels and self.rig.channels[name].hold == LINEAR

    def _over_parts(self, name: str, signal: np.ndarray) -> np.ndarray:
        """An input (samples,) in each part of a sample (samples * parts,)."""
        if not self._linear(name):
            return np.repeat(signal, self._parts)
        way = (np.arange(self._parts) + 1 / 2) / self._parts
        return (signal[:, None] + np.append(np.diff(signal), 0.0)[:, None] * way).ravel()

    def _sampled(self, name: str, signal: np.ndarray) -> np.ndarray:
        """An input (samples * parts,) where the samples are taken (samples,)."""
        if not self._linear(name):
            return self._means(signal)
        if signal is self._parted[name] or self._parts == 1:
            return self._inputs[name] if signal is self._parted[name] else signal
        first, second = signal.reshape(-1, self._parts)[:, :2].T
        return first - (second - first) / 2

    def _means(self, signal: np.ndarray) -> np.ndarray:
        """Of a plant's input over each sample (samples,)."""
        return signal if self._parts == 1 else signal.reshape(-1, self._parts).mean(axis=1)

    def _summed(self, signal: np.ndarray) -> np.ndarray:
        """The integral of an input (samples * parts,): its mean over each part, in which it goes on rising."""
        return (np.cumsum(signal) - signal / 2) * (self.rig.dt / self._parts)

    def _moved(self, signal: np.ndarray, early: float) -> np.ndarray:
        """A recorded input that moved between the samples (samples * parts,), by so much `EARLY`.

        Its mean over each sample and its first moment there are those of an input that moves in equal steps.
        """
        parts, ends = self._parts, np.linspace(*RAMP, self._parts + 1)
        ramp = (ends[:-1] + ends[1:]) / 2
        slope = STEEPEST * early * (1.0 - early) / (1.0 - parts**-2) if parts > 1 else 0.0
        return (signal[:, None] + np.append(np.diff(signal), 0.0)[:, None] * (early + slope * ramp)).ravel()

    def _acting(self, name: str, values: Mapping[str, float]) -> list[tuple[str, tuple[float, ...]]]:
        """The filters of an input or a sensor whose strength is not 0, with their parameters."""
        filters = self._filters.get(name, ())
        return [(kind, tuple(values[s] for s in symbols)) for kind, symbols in filters if values[symbols[0]] != 0.0]

    def laws(self, values: Mapping[str, float]) -> dict[str, list[tuple[str, tuple[str, ...]]]]:
        """Input -> the filters behind which it acts, with the symbols of their parameters."""
        found = {n: [f for f in self._filters.get(n, ()) if values[f[1][0]] != 0.0] for n in self.plant.inputs}
        return {name: filters for name, filters in found.items() if filters}

    def beside(self, values: Mapping[str, float], but: Collection[str] = ()) -> list[str]:
        """Recorded signals that are filtered or misread before and after the plant: no part of its equations."""
        filtered = [name for name in self._filters if name not in but and any(self._acting(name, values))]
        read = [channel for channel in self.readings if any(self._shown(channel, values))]
        return sorted({name.removeprefix(SENSOR) for name in filtered} | {*read})

    def starts(self, values: Mapping[str, float], signals: Mapping[str, np.ndarray]) -> np.ndarray:
        """Where each state begins at each restart, (restarts, states), by the comparison rule of the rigs."""
        at = self.restarts
        scope = Values(self.plant, {name: signal[at] for name, signal in signals.items()})
        scope.update(values)
        for channel in self.measured:
            scope[channel] = self._read_at(channel, values, at)
        for rate, channel in self.rates.items():
            scope[rate] = self._rate_of_state(channel, values)[at]
        for key, s in self.begins.items():
            found = self.first[s] if s in self.first else self._read_at(s, values, at)
            scope[s] = found + values.get(key, 0.0)
        brought = {s for effect in self.effects.values() for s in effect.states}  # they begin so in a free run, too
        out = np.empty((len(at), len(self.plant.states)))
        for j, (symbol, state) in enumerate(self.plant.states.items()):
            if symbol not in scope:
                start = state.start if self.window or symbol in brought else None
                expression = state.initial if start is None else start
                scope[symbol] = scope.evaluate(expression) if isinstance(expression, str) else float(expression)
                for bound, take in ((state.low, np.maximum), (state.high, np.minimum)):
                    if bound is not None:
                        scope[symbol] = take(scope[symbol], scope.evaluate(bound) if isinstance(bound, str) else bound)
            out[:, j] = scope[symbol]
        return out

    def smooth_rate(self, channel: str) -> np.ndarray:
        """Velocity of a recorded channel (samples,), in its unit a second, as a restart takes it."""
        return self._smoothed(channel, 1)

    def _rate_of_state(self, channel: str, values: Mapping[str, float]) -> np.ndarray:
        """Velocity of the state that a channel shows (samples,): what its sensor adds may move, too."""
        if not (self._acting(SENSOR + channel, values) or any(self._shown(channel, values))):
            return self.smooth_rate(channel)
        state = self._read_at(channel, values, np.arange(self.recording.samples))
        return self._smooth_of(channel, state, 1)

    def _smoothed(self, channel: str, derivative: int) -> np.ndarray:
        """A recorded channel (samples,), smoothed as at a restart, or its derivative."""
        key = channel, derivative
        if key not in self._smooth_channels:
            self._smooth_channels[key] = self._smooth_of(channel, self.recording[channel], derivative)
        return self._smooth_channels[key]

    def _smooth_of(self, channel: str, signal: np.ndarray, derivative: int) -> np.ndarray:
        """A signal (samples,), smoothed as far as a channel is, or its derivative."""
        if channel not in self._smoothing:
            self._smoothing[channel] = smoothing(self.recording[channel])
        half, degree = self._smoothing[channel]
        return savgol_filter(signal, 2 * half + 1, degree, deriv=derivative, delta=self.rig.dt)

    def pace(self, rate: str) -> float:
        """RMS of a rate as a restart takes it, in its unit; where it rests, its sensor's noise a sample."""
        size = float(np.sqrt(np.mean(self.smooth_rate(self.rates[rate]) ** 2)))
        return size or self.rig.channels[self.rates[rate]].sigma / self.rig.dt

    def _read_at(self, channel: str, values: Mapping[str, float], at: np.ndarray) -> np.ndarray:
        """The state that a channel shows at the samples `at`, what its sensor adds taken off."""
        return self._unread(channel, self._unfiltered(channel, values)[at], values, at)

    @np.errstate(over="ignore", invalid="ignore")  # a reading may be infinite
    def _unread(self, channel: str, read: np.ndarray, values: Mapping[str, float], at: np.ndarray) -> np.ndarray:
        """The state that a channel shows as `read`: what its sensor adds is taken off, round after round."""
        state = read
        for _ in range(READINGS if channel in self.readings else 0):
            state = read - self._reading(channel, state, values, at)
        return state

    def _unfiltered(self, channel: str, values: Mapping[str, float]) -> np.ndarray:
        """The channel as recorded, less what filters of its sensor make of its smoothed course.

        So its noise stays what it is: one that a filter's parameter made larger or smaller would be fitted by it.
        """
        read = self.recording[channel]
        if not (filters := self._acting(SENSOR + channel, values)):
            return read
        shown = smooth = self._smoothed(channel, 0)
        for kind, given in filters:
            shown = of.unfiltered(kind, shown, given, self.rig.dt)
        return read + (shown - smooth)

    def _reading(
        self, channel: str, state: np.ndarray, values: Mapping[str, float], at=slice(None)
    ) -> np.ndarray | float:
        """What the channel's sensor adds to the state, at the samples `at`."""
        given = {name: signal[at] for name, signal in self._inputs.items()}
        scope = Values(self.plant, {**given, channel: state, TIME: self.recording.time[at]})
        scope.update(values)
        return sum((scope.evaluate(text) for text in self._shown(channel, values)), start=0.0)

    def states(self, values: Mapping[str, float], shifts: np.ndarray | None = None) -> tuple[np.ndarray, dict]:
        """(states (samples, states), input signals). shifts: (restarts, locals) added to where the locals begin."""
        parted = self._signals(values)
        signals = {name: self._sampled(name, signal) for name, signal in parted.items()}
        for name, source in self.integrals.items():  # at a sample it is what was summed before, not the mean after it
            given = {source: signals[source]} if source in signals else self.recording.channels
            signals[name] = self._input(name, given)
        starts = self.starts(values, signals)
        if shifts is not None and shifts.size:
            symbols = list(self.plant.states)
            starts[:, [symbols.index(s) for s in self.locals]] += shifts
        key = (tuple(values.get(s, 0.0) for s in self.moving), None if shifts is None else shifts.tobytes())
        last = self._last  # other threads may put another in its place
        spend(self.work)
        check()
        if key != last[0]:
            self.runs += 1
            parts = self._parts
            ran = self._compiled.run(self._columns(parted), parts * self.restarts, starts, self.reset, values)
            self._last = last = key, ran[::parts]
        return last[1], signals

    def _columns(self, signals: Mapping[str, np.ndarray]) -> np.ndarray:
        """The plant's inputs (samples * parts, inputs), in its order; there may be none."""
        columns = [signals[name] for name in self.plant.inputs]
        rows = self._parts * self.recording.samples
        return np.ascontiguousarray(np.stack(columns, axis=1)) if columns else np.empty((rows, 0))

    def scope(self, values: Mapping[str, float], shifts: np.ndarray | None = None) -> Values:
        """Every signal of a run (samples,), and what expressions make of them."""
        states, signals = self.states(values, shifts)
        scope = Values(self.plant, {**signals, **dict(zip(self.plant.states, states.T, strict=True))})
        scope.update(values)
        return scope

    @np.errstate(over="ignore", invalid="ignore")  # a run may diverge
    def predict(self, values: Mapping[str, float], shifts: np.ndarray | None = None) -> np.ndarray:
        """Predicted channels (samples, predict), in the order of `rig.predict`."""
        scope = self.scope(values, shifts)
        columns = [np.broadcast_to(scope[channel], self.recording.samples) for channel in self.rig.predict]
        return self._read(np.stack(columns, axis=1), values)

    def _read(self, shown: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        """What sensors read of the predicted channels (samples, predict)."""
        columns = []
        for channel, column in zip(self.rig.predict, shown.T, strict=True):
            for kind, given in self._acting(SENSOR + channel, values):
                column = of.SENSOR[kind](column, *given, self.rig.dt)
            if any(True for _ in self._shown(channel, values)):
                column = column + self._reading(channel, column, values)
            columns.append(column)
        return np.stack(columns, axis=1)

    def added(self, effect: Effect, values: Mapping[str, float]) -> Callable[[Mapping[str, float]], np.ndarray] | None:
        """A function of an effect's parameters: what the effect adds to the predicted channels (samples, predict).

        None where the effect does more than to add to these channels. values: of all other parameters.
        """
        places = {name: d.symbol for name, d in self.plant.definitions.items() if d.symbol in self.rig.predict}
        if effect.definitions or effect.states or effect.filters or effect.frees:
            return None
        if not all(path.partition(".")[0] in places for path in effect.terms):
            return None
        scope = self.scope({**self.values, **values})
        parts = [
            (self.rig.predict.index(places[path.partition(".")[0]]), *part)
            for path, expression in effect.terms.items()
            for part in summands(expression)
        ]

        def give(own: Mapping[str, float]) -> np.ndarray:
            scope.update(own)
            out = np.zeros((self.recording.samples, len(self.rig.predict)))
            for channel, factor, expression in parts:
                if own.get(factor) != 0.0:
                    out[:, channel] += scope.evaluate(expression)
            return out

        return give

    def answering(
        self, effect: Effect, values: Mapping[str, float], shifts: np.ndarray | None
    ) -> Callable[[Mapping[str, float]], np.ndarray] | None:
        """As `added`, to first order, of what acts as forces, by inputs and at sensors on a simulator from outside.

        None of any other effect, and where nothing begins anew. shifts: as for `states`.
        """
        places, channels, states = forced(self.plant), self.rig.predict, [*self.plant.states]
        if not (self.window and places and {*channels} <= {*states}) or not effect.adds:
            return None
        sensors = {SENSOR + channel for channel in self.rig.channels}
        acting = {path.partition(".")[0] for path in effect.terms} | effect.filters.keys()
        if not acting <= {*places, *self.rig.inputs, *sensors}:
            return None
        values = {**self.values, **values}
        key = *values.items(), None if shifts is None else shifts.tobytes()
        answers, signals, plain, first = self._answers.of(key, partial(self._answer, values, shifts))
        scope = Values(self.plant, {**signals, **dict(zip(states, answers.states.T, strict=True))})
        scope.update(values)
        at = [states.index(channel) for channel in channels]
        shows = self._read(answers.states[:, at], values)

        def give(own: Mapping[str, float]) -> np.ndarray:
            scope.update(own)
            given, forces = {**values, **own}, dict[str, np.ndarray]()
            for path, expression in effect.terms.items():
                if (place := path.partition(".")[0]) in places:
                    force = np.broadcast_to(scope.evaluate(expression), len(self.target))
                    forces[place] = forces[place] + force if place in forces else force
            begun = self.starts(given, signals) - first if acting & sensors else np.zeros_like(first)
            more = (self._columns(self._signals(given)) - plain).reshape(len(self.target), self._parts, -1).mean(axis=1)
            moved = answers.states + answers.moved(begun, more, forces)
            return self._read(moved[:, at], given) - shows

        return give

    def _answer(
        self, values: Mapping[str, float], shifts: np.ndarray | None
    ) -> tuple[Responses, dict[str, np.ndarray], np.ndarray, np.ndarray]:
        """(how a run answers, its input signals, those of the plant (samples * parts, inputs), where it begins)."""
        states, signals = self.states(values, shifts)
        columns, parts, count = self._columns(self._signals(values)), self._parts, len(states) - 1
        rows = columns[np.arange(count)[:, None] * parts + np.arange(parts + 1)]  # those of a sample, and the next one
        every = np.ones(states.shape[1], bool)

        def step(begin: np.ndarray, more: np.ndarray, forces: Mapping[str, float]) -> np.ndarray:
            spend(self.work)
            check()
            given = np.reshape(rows + more[:, None, :], (-1, columns.shape[1]))
            ran = self._compiled.run(given, (parts + 1) * np.arange(count), begin, every, {**values, **forces})
            return ran[parts :: parts + 1]

        answers = Responses(step, states, columns[::parts], self.restarts, forced(self.plant))
        return answers, signals, columns, self.starts(values, signals)

    def _shown(self, channel: str, values: Mapping[str, float]) -> Iterator[str]:
        """What a sensor's effects add to its channel, without those whose strengths are all 0."""
        for path, text in self.readings.get(channel, {}).items():
            effect = self.effects[path.rpartition(".")[0]]
            if any(values[f.symbol] for f in effect.strengths):
                yield text


def reach(signal: np.ndarray, samples: int) -> int:
    """Samples on either side over which a recorded signal is smoothed: `samples`, where its own pace allows."""
    return min(span(samples, [memory(signal)], SMOOTHED, FEWEST_BESIDE), max(len(signal) // PART, FEWEST_BESIDE))


def delayed(signal: np.ndarray, delay: float, dt: float) -> np.ndarray:
    """An input that is constant over each sample, `delay` s late: its mean over each sample.

    Before the first sample the input rests at its first value.
    """
    most = float(len(signal))  # later than the whole recording it does not come at all
    steps, part = divmod(max(min(most, delay / dt), -most), 1.0)
    k = np.arange(len(signal)) - int(steps)
    late, later = signal[np.clip(k, 0, len(k) - 1)], signal[np.clip(k - 1, 0, len(k) - 1)]
    return (1.0 - part) * late + part * later


def lagged(signal: np.ndarray, lag: float, dt: float, start: float | None = None) -> np.ndarray:
    """An input that is constant over each sample, behind a first-order lag of `lag` s: its mean over each sample.

    start: where the lag stands when the recording begins, by default at the first sample.
    """
    first = signal[0] if start is None else start
    decay = np.exp(-dt / lag)
    end, _ = lfilter([1.0 - decay], [1.0, -decay], signal, zi=[decay * first])
    begin = np.concatenate(([first], end[:-1]))
    return signal + (begin - signal) * (lag / dt) * (1.0 - decay)


def dead_band(signal: np.ndarray, width: float, dt: float) -> np.ndarray:
    """An input behind a dead band: `width` on either side of zero does nothing."""
    return np.sign(signal) * np.maximum(np.abs(signal) - width, 0.0)


FILTERS: dict[str, Callable[..., np.ndarray]] = {
    "delay": delayed,
    "lag": lagged,
    "lag_from_rest": lambda signal, lag, dt: lagged(signal, lag, dt, 0.0),
    "lag_twice_from_rest": lambda signal, lag, dt: lagged(lagged(signal, lag / 2, dt, 0.0), lag / 2, dt, 0.0),
    "offset": lambda signal, by, dt: signal + by,
    "dead_zone": dead_band,
    "play": of.loose,
    "skew": lambda signal, by, dt: signal + by * np.abs(signal),
    **of.INPUT,
}


# -- where a recording begins ----------------------------------------------------------------------------------------


def first_rate(signal: np.ndarray, sigma: float) -> tuple[float, float]:
    """(the change a sample at the first, its standard deviation), of a parabola over as many samples as follow one.

    sigma: of the signal's noise.
    """
    found, count = (0.0, np.inf), FEWEST_FIRST
    while count <= max(len(signal) // PART, FEWEST_FIRST):
        some = signal[:count]
        columns = np.vander(np.arange(len(some)), PARABOLA + 1)
        parabola = np.linalg.lstsq(columns, some)[0]
        freedom = len(some) - PARABOLA - 1
        left = np.sum((some - columns @ parabola) ** 2) / sigma**2
        if count > FEWEST_FIRST and left > chdtri(freedom, STRAYS):
            break
        size = sigma * max(1.0, np.sqrt(left / freedom))
        away = size * np.sqrt(np.linalg.inv(columns.T @ columns)[-2, -2])
        found, count = (float(parabola[-2]), float(away)), count + max(count // 2, 1)
    return found


def beginnings(model: Model) -> list[str]:
    """Parameters that differ from recording to recording: where a run begins, and those the rig calls `anew`."""
    initial = {s.initial for s in model.plant.states.values() if isinstance(s.initial, str)}
    own = [symbol for symbol in model.plant.parameters if symbol in initial or symbol in model.rig.anew]
    return [*own, *model.begins]


def begun(model: Model, values: Mapping[str, float], samples: int) -> dict[str, float]:
    """`values`, the `beginnings` as the recording's first `samples` have them, by least squares."""
    values = {**model.values, **values}
    symbols = beginnings(model)
    if not symbols or not samples:
        return values
    scale = np.std(model.target, axis=0)
    scale = np.where(scale > 0, scale, 1.0)

    def errors(at):
        left = model.target - model.predict({**values, **dict(zip(symbols, map(float, at), strict=True))})
        return np.clip(np.nan_to_num((left[:samples] / scale).ravel(), nan=FARTHEST), -FARTHEST, FARTHEST)

    start = np.array([values[s] for s in symbols])
    size = np.maximum(np.abs(start), START_SIZE * float(np.abs(model.target).max()) + TINY)

    def slopes(at):  # by steps of the same size everywhere: near 0 a part of the value is nothing
        steps = START_STEP * np.diag(size)
        return np.stack([(errors(at + step) - errors(at)) / step.sum() for step in steps], axis=1)

    found = least_squares(errors, start, slopes, x_scale=size, max_nfev=START_TRIALS).x
    return {**values, **dict(zip(symbols, map(float, found), strict=True))}
