"""Experiments on a rig: inputs made by rule, within the bounds that a recording shows the rig to withstand."""

import copy
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import savgol_filter

from greygate.errors import InputError
from greygate.mismatch.effects import Effect, fitting
from greygate.mismatch.model import SMOOTH, Model, reach
from greygate.mismatch.rig import Channel, Rig
from greygate.plants.recording import Recording

SAMPLES = 3000  # of an experiment; no more than the recording has
RESTS = 20.0, 2.0  # lengths of an experiment that a rig rests before a move is repeated
RESTED, MOVED = 6, 2  # parts of the longest experiment: that moves take before a rest, and without one
ROUNDING = 1e-9  # of the longest time, by which an experiment may be longer
AMPLITUDES = (1.0, 0.5, 0.25, 0.1)  # of a swing
MARGIN = 0.1  # of its recorded range, by which an output may leave it
OFF_STOP = 1e-3  # of its recorded range: an output that stays so far from a stop has not touched it
EXTREME = 0.99  # quantile of a command that counts as its largest
NOMINAL = 2000  # samples of each motion of the simulated recording, where nothing is recorded yet
SLOW, SOFT = 1.0, 20.0  # travels in the time of such a motion, and in its square: of moves where none is recorded
HOLD = 0.25  # of an experiment's length, after which inputs at rest shall have moved nothing
TRIALS, NUDGE, TAME = 4, 0.02, 1e-4  # steps towards such inputs, their trials (of what is recorded), their damping
FIRM = 10.0  # by which a position's place counts more than another output's mean
STEPS = (2, 8, 32)  # in an experiment: slow enough to come to rest, as fast as a plant follows, and faster
HEIGHTS = 16  # of steps that rise to the full swing
SINES = (1, 4, 20)  # cycles of a sine in an experiment
SWEEP = 40  # cycles in an experiment's length at the upper end of a sine whose frequency rises,
SWEPT = 0.1  # of the sampling rate, at most
HALFWAY = 0.5  # of a step: where it begins at its middle


@dataclass(frozen=True)
class Experiment:
    """shape: of the inputs, in words. inputs: channel -> (samples,) in its unit, one every `dt` s."""

    shape: str
    inputs: Mapping[str, np.ndarray]
    dt: float

    @property
    def seconds(self) -> float:
        return len(next(iter(self.inputs.values()))) * self.dt


@dataclass(frozen=True)
class Bounds:
    """What may be asked of a rig, each in its channel's unit.

    rest: every input while nothing is asked. swing: how far the commands among the inputs may go from there, in the
    proportion in which they go together. low, high: bounds of every channel. speed, acceleration: of the other inputs,
    which are positions (in `unit`), in travels a second (squared).
    """

    rest: Mapping[str, float]
    swing: Mapping[str, float]
    low: Mapping[str, float]
    high: Mapping[str, float]
    speed: float = 0.0
    acceleration: float = 0.0
    unit: str = "m"

    @property
    def positions(self) -> list[str]:
        return [name for name in self.rest if name not in self.swing]

    @classmethod
    def of(cls, rig: Rig, recording: Recording, reach: float = 1.0) -> "Bounds":
        """`reach` times what `recording` shows.

        Travels stay as they are, inputs keep their sign, and a limit of a state that was not touched stays untouched.
        """
        low, high, moved = {}, {}, [name for name in positions(rig) if np.ptp(recording[name]) > 0]
        for name, channel in rig.channels.items():
            least, most = float(np.min(recording[name])), float(np.max(recording[name]))
            wider = 0.0 if name in moved else (reach - 1.0 + MARGIN * (channel.role == "output")) * (most - least)
            bottom, top = _stops(rig, name, OFF_STOP * (most - least))
            if channel.role == "input":
                bottom, top = (0.0 if least >= 0.0 else -np.inf), (0.0 if most <= 0.0 else np.inf)
            low[name], high[name] = max(least - wider, min(least, bottom)), min(most + wider, max(most, top))
        rest = {n: float(recording[n][0] if n in moved else np.mean(recording[n])) for n in rig.inputs}
        swing = {n: reach * s for n, s in _together(recording, [n for n in rig.inputs if n not in moved]).items()}
        if not moved:
            return cls(rest, swing, low, high)
        speed, acceleration = np.min([_rates(recording, name) for name in moved], axis=0)
        return cls(rest, swing, low, high, reach * speed, reach * acceleration, rig.channels[moved[0]].unit)

    def stood(self, signals: Mapping[str, np.ndarray]) -> bool:
        """Every channel is finite and within its bounds."""
        return all(self.low[n] <= np.min(signals[n]) and np.max(signals[n]) <= self.high[n] for n in self.low)


def positions(rig: Rig) -> list[str]:
    """Inputs that are positions: they can only be moved, not switched."""
    rated = {how.split()[1] for how in rig.plant.derived.values() if "integral" not in how}
    return [name for name in rig.inputs if name in rated or rig.channels[name].unit in ("m", "rad")]


def _stops(rig: Rig, name: str, off: float = 0.0) -> tuple[float, float]:
    """The plant's limits of the state `name`, less `off` on either side; infinite where there are none."""
    state = rig.plant.states.get(name)
    low = -np.inf if state is None or state.low is None else rig.plant.constant(state.low) + off
    high = np.inf if state is None or state.high is None else rig.plant.constant(state.high) - off
    return low, high


def _together(recording: Recording, names: list[str]) -> dict[str, float]:
    """How far the named inputs go from their means, along the direction in which they vary most."""
    if not names:
        return {}
    away = np.stack([recording[name] - np.mean(recording[name]) for name in names], axis=1)
    along = np.linalg.eigh(away.T @ away)[1][:, -1]
    along *= np.sign(along[np.argmax(np.abs(along))])
    return dict(zip(names, (np.quantile(np.abs(away @ along), EXTREME) * along).tolist(), strict=True))


def _rates(recording: Recording, name: str) -> tuple[float, float]:
    """(speed, acceleration) that a position comes to, in travels a second (squared)."""
    dt, travel = recording.dt, float(np.ptp(recording[name]))

    def rates(signal: np.ndarray, order: int) -> np.ndarray:
        return savgol_filter(signal, 2 * reach(signal, SMOOTH) + 1, order + 1, deriv=order, delta=dt)

    speed, acceleration = (max(float(np.max(np.abs(rates(run[name], n)))) for run in recording.runs) for n in (1, 2))
    return speed / travel, acceleration / travel


# -- inputs by rule --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Move:
    """A move between two shares of the travel, there and back.

    out, back, acceleration: shares of the highest speeds and acceleration. rest: after which it is repeated, in lengths
    of an experiment.
    """

    begin: float = 0.0
    end: float = 1.0
    out: float = 1.0
    back: float = 1.0
    acceleration: float = 1.0
    rest: float = 0.0


MOVES = (
    Move(), Move(out=0.5, back=0.5), Move(out=0.25, back=0.25), Move(back=0.25), Move(acceleration=0.25),
    Move(end=0.5), Move(begin=0.5), Move(end=0.1), Move(begin=0.9),
    *(Move(end=end, rest=rest) for rest in RESTS for end in (1.0, 0.1)),
)  # fmt: skip


def experiments(bounds: Bounds, seconds: float, dt: float, longest: float = np.inf) -> Iterable[list[Experiment]]:
    """Kinds of experiment, each from its strongest to its mildest form. seconds: of a short one; longest: of any."""
    found = _experiments(bounds, min(seconds, longest), dt, longest)
    yield from ([e for e in kind if e.seconds <= longest * (1 + ROUNDING)] for kind in found)


def _experiments(bounds: Bounds, seconds: float, dt: float, longest: float) -> Iterable[list[Experiment]]:
    for move in MOVES if bounds.positions else ():
        length = min(seconds, longest / (RESTED if move.rest else MOVED))
        rest = min(move.rest * length, longest - RESTED / 2 * length) if move.rest else 0.0
        yield [Experiment(_words(move, bounds, rest), _moving([move], bounds, length, dt, rest), dt)]
    for shape, wave in _waves(seconds, dt) if bounds.swing else ():
        amplitudes = AMPLITUDES if wave.any() else (0.0,)
        yield [Experiment(shape, _commanding(amplitude * wave, bounds), dt) for amplitude in amplitudes]


def _commanding(wave: np.ndarray, bounds: Bounds) -> dict[str, np.ndarray]:
    signals = {n: rest + bounds.swing.get(n, 0.0) * wave for n, rest in bounds.rest.items()}
    return {n: np.clip(s, bounds.low[n], bounds.high[n]) for n, s in signals.items()}


def _waves(seconds: float, dt: float) -> Iterable[tuple[str, np.ndarray]]:
    """(in words, signal within +-1). Each begins at its peak: a state that integrates it then stays near its start."""
    t = np.arange(round(seconds / dt)) * dt
    for half in (seconds / steps for steps in STEPS):
        yield f"steps every {half:.2g} s", np.where(np.floor(t / half + HALFWAY) % 2 == 0, 1.0, -1.0)
    hold = seconds / HEIGHTS
    rising = (1 + np.floor(t / hold)) / HEIGHTS
    yield f"steps of rising height every {hold:.2g} s", rising * np.where(np.floor(t / hold) % 2 == 0, 1.0, -1.0)
    for cycles in SINES:
        yield f"a sine of {cycles / seconds:.2g} Hz", np.cos(2 * np.pi * cycles * t / seconds)
    first, last = 1 / seconds, min(SWEEP / seconds, SWEPT / dt)
    phase = 2 * np.pi * (first + (last - first) * t / (2 * seconds)) * t
    yield f"a sine that rises from {first:.2g} to {last:.2g} Hz", np.cos(phase)
    yield "rest", np.zeros(len(t))


def _moving(
    moves: Iterable[Move], bounds: Bounds, seconds: float, dt: float, rest: float = 0.0
) -> dict[str, np.ndarray]:
    """One move after the other, from where the position rests; the commands are at rest.

    seconds: for which each is repeated, and again after `rest` s if there is one.
    """
    name = bounds.positions[0]
    path = [np.array([(bounds.rest[name] - bounds.low[name]) / (bounds.high[name] - bounds.low[name])])]

    def go(to: float, share: float) -> None:
        if to != path[-1][-1]:
            path.append(leg(path[-1][-1], to, share * bounds.speed, move.acceleration * bounds.acceleration, dt))

    def there_and_back() -> None:
        began = sum(map(len, path))
        while (sum(map(len, path)) - began) * dt < seconds:
            go(move.end, move.out)
            go(move.begin, move.back)

    for move in moves:
        go(move.begin, move.out)
        there_and_back()
        if rest:
            path.append(np.full(round(rest / dt), path[-1][-1]))
            there_and_back()
    way = np.clip(np.concatenate(path), 0.0, 1.0)
    moved = {n: bounds.low[n] + (bounds.high[n] - bounds.low[n]) * way for n in bounds.positions}
    return {n: moved.get(n, np.full(len(way), rest)) for n, rest in bounds.rest.items()}


def leg(begin: float, end: float, speed: float, acceleration: float, dt: float) -> np.ndarray:
    """A path from `begin`, which is left out, to `end` with constant acceleration, speed, and deceleration."""
    way = abs(end - begin)
    top = min(speed, np.sqrt(way * acceleration))
    count = int(np.ceil((way / top + top / acceleration) / dt)) + 1
    t = (np.arange(count) + HALFWAY) * dt
    rate = np.clip(np.minimum(acceleration * t, acceleration * (count * dt - t)), 0.0, top)
    path = begin + (end - begin) * np.cumsum(rate) / np.sum(rate)
    path[-1] = end
    return path


def _words(move: Move, bounds: Bounds, rest: float) -> str:
    name = bounds.positions[0]
    travel = bounds.high[name] - bounds.low[name]
    out, back = (f"{travel * bounds.speed * share:.2g} {bounds.unit}/s" for share in (move.out, move.back))
    hard = f"{travel * bounds.acceleration * move.acceleration:.2g} {bounds.unit}/s^2"
    words = f"moves at {out}" + (f" and back at {back}" if back != out else "") + f", started and stopped at {hard}"
    return words + (f", the same again after {rest:.3g} s of rest" if rest else "")


# -- a rig that runs free --------------------------------------------------------------------------------------------


class FreeRun:
    """A rig's plant in free run, with `values` (symbol -> value), as the sensors show it."""

    def __init__(self, rig: Rig, effects: Mapping[str, Effect], values: Mapping[str, float]):
        outputs = tuple(name for name, channel in rig.channels.items() if channel.role == "output")
        self.rig = replace(rig, predict=outputs)
        self.units = {name: channel.unit for name, channel in rig.channels.items()}
        blank = {name: np.zeros(SAMPLES) for name in rig.channels}
        self.model = Model(self.rig, Recording(rig.dt, blank, self.units), effects, 0)
        self.values = {**self.model.values, **{s: v for s, v in values.items() if s in self.model.values}}

    def under(self, values: Mapping[str, float]) -> "FreeRun":
        """The same plant with other values."""
        other = copy.copy(self)
        other.values = {**self.model.values, **{s: v for s, v in values.items() if s in self.model.values}}
        return other

    def shown(self, inputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Inputs and outputs, rounded as the sensors do, channel -> (samples,)."""
        given = {n: _rounded(self.rig.channels[n], s) for n, s in inputs.items()}
        blank = {n: np.zeros(len(next(iter(given.values())))) for n in self.rig.predict}
        predicted = self.model.over(Recording(self.rig.dt, {**given, **blank}, self.units)).predict(self.values)
        return {**given, **{n: _rounded(self.rig.channels[n], s) for n, s in zip(blank, predicted.T, strict=True)}}

    def record(self, inputs: Mapping[str, np.ndarray], bounds: Bounds) -> Recording | None:
        """The recording of an experiment; None where a channel leaves its bounds."""
        shown = self.shown(inputs)
        return Recording(self.rig.dt, shown, self.units) if bounds.stood(shown) else None

    def at_rest(self, bounds: Bounds, recording: Recording, seconds: float) -> Bounds:
        """`bounds` with inputs at rest that keep positions at their start, other outputs at their recorded means.

        seconds: after which nothing shall have moved.
        """
        rig, names, states = self.rig, list(bounds.swing), self.rig.plant.states
        kept = [n for n in rig.predict if n in states and states[n].rate]
        reach = np.array([np.ptp(recording[n]) for n in names])

        def resting(numbers: np.ndarray) -> Bounds:
            asked = zip(names, numbers * reach, strict=True)
            inside = {n: float(np.clip(bounds.rest[n] + by, bounds.low[n], bounds.high[n])) for n, by in asked}
            return replace(bounds, rest={**bounds.rest, **inside})

        def gone(numbers: np.ndarray) -> np.ndarray:
            shown = self.shown({n: np.full(round(seconds / rig.dt), v) for n, v in resting(numbers).rest.items()})
            away = [
                (shown[n][-1] - (shown[n][0] if n in kept else np.mean(recording[n]))) / (np.ptp(recording[n]) or 1.0)
                for n in rig.predict
            ]
            return np.nan_to_num(away) * [FIRM if n in kept else 1.0 for n in rig.predict]

        numbers = np.zeros(len(names))
        for _ in range(TRIALS if names else 0):
            now = gone(numbers)
            slopes = np.stack([(gone(numbers + NUDGE * one) - now) / NUDGE for one in np.eye(len(names))], axis=1)
            damped = slopes.T @ slopes + TAME * np.eye(len(names))
            numbers = numbers - np.linalg.solve(damped, slopes.T @ now + TAME * numbers)
        return resting(numbers)


def nominal(rig: Rig, effects: Mapping[str, Effect], ranges: Mapping[str, tuple[float, float]]) -> Recording:
    """What the sensors would record of the data sheet's plant under motions by rule, where nothing is recorded yet.

    ranges: (low, high) of every input, in its unit. Raises InputError where one is missing or unknown, where the noise
    is not stated, and where such motions take the plant to its limits.
    """
    if not rig.stated:
        raise InputError(f"{rig.folder}/rig.toml: before data the noise must be stated; give noise_rms or resolution")
    if set(ranges) != set(rig.inputs):
        raise InputError(f"range of {', '.join(ranges)}: the inputs are {', '.join(rig.inputs)}; give one of each")
    for name, (low, high) in ranges.items():
        if not -np.inf < low < high < np.inf:
            raise InputError(f"range of {name}: {low:g} to {high:g}; give two numbers, LOW below HIGH")
    moved = positions(rig)
    rest = {n: float(np.clip(0.0, low, high)) if n in moved else (low + high) / 2 for n, (low, high) in ranges.items()}
    swing = {n: (high - low) / 2 for n, (low, high) in ranges.items() if n not in moved}
    stops = {n: _stops(rig, n) for n, c in rig.channels.items() if c.role == "output"}
    lowest, highest = ({n: pair[i] for n, pair in {**stops, **ranges}.items()} for i in (0, 1))
    lasts = NOMINAL * rig.dt
    bounds = Bounds(rest, swing, lowest, highest, SLOW / lasts, SOFT / lasts**2)
    free = FreeRun(rig, fitting(rig.plant, rig.datasheet, effects), {})
    if moved:
        tried = [_moving([m for m in MOVES if not m.rest], bounds, lasts, rig.dt)]
    else:
        wave = np.concatenate([wave for _, wave in _waves(lasts, rig.dt)])
        tried = [_commanding(amplitude * wave, bounds) for amplitude in AMPLITUDES]
    for inputs in tried:
        if (recording := free.record(inputs, bounds)) is not None:
            return recording
    raise InputError(f"{rig.folder}: with these ranges the data sheet's plant comes to its limits; give smaller ones")


def _rounded(channel: Channel, signal: np.ndarray) -> np.ndarray:
    return np.round(signal / channel.resolution) * channel.resolution if channel.resolution else signal
