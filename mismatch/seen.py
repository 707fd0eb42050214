"""What a recording shows of a plant's signals: how large they are, how fast, and whether they do what an effect needs.

A signal that is recorded counts as recorded, the rate of a recorded position as its smoothed rate; every other one is
that of the data sheet's plant.
"""

from collections.abc import Iterable, Mapping
from functools import cached_property

import numpy as np

from greygate.errors import InputError
from greygate.mismatch.model import TINY, Model
from greygate.mismatch.places import rates
from greygate.mismatch.rig import Rig
from greygate.plants.expressions import names
from greygate.plants.plant import Equation, Values
from greygate.plants.recording import Recording

NOISY = 3.0  # times the RMS of its sensor: a signal that stays within does not move
SOME = 0.01  # of the samples: where fewer show something, the recording does not
SLOW = 0.02  # of a velocity's largest magnitude, below which it rests
NEAR = 0.1  # of an input's largest magnitude, below which it is near zero
SPECK = 1e-6  # of a signal's size: practically nothing
END = 0.01  # of a signal's range, nearer than which to its extreme a sample may be at the sensor's end
NEGATIVE = 0.05  # of a signal's size: noise alone takes a magnitude that far below zero
LINES = 3  # in a spectrum that are offered, at most
CHANCE = 1e-4  # of so strong a line in any place of a spectrum of noise
BESIDE = 25  # lines of a spectrum on either side, whose median is what noise gives there
NARROW = 3  # lines of a spectrum that one sine may take with a Hann window
OWN = 0.05  # of a frequency, by which the data sheet's machine may swing faster or slower than the real one
ALIKE = 0.1  # of the power of a line: one that the machine makes itself is as strong, or nearly
SLOWEST = 10.0  # periods of a line in a recording, at least: a slower one is motion;
MAINS, FAST = (50.0, 60.0), 4  # Hz: but these are looked for in one period, of so many samples or more
TWICE = 6.0  # variance of white noise differenced twice, over its own
DIGITS = 12  # behind the point: rates that differ beyond are one
LEVELS = 4  # values, or rates, that a signal must have: with fewer, a limit of it is another gain
UNMET = {
    "several": "there is no other channel of its kind beside {}",
    "beside": "there is no input, and no other channel, beside {}",
    "recorded": "{} is not recorded",
    "moves": "{} never moves",
    "turns": "{} never reverses",
    "both_signs": "{} never changes its sign",
    "near_zero": "{} is never near zero",
    "often_high": "{} is never at rest at its highest",
    "often_low": "{} is never at rest at its lowest",
    "goes_round": "{} never goes round once",
    "may_be_negative": "{} measures what cannot be negative",
    "never_negative": "{} goes below zero",
    "comes_down": "{} stays far above zero",
    "several_levels": "{} has few levels only",
    "several_rates": "{} has few rates only",
}
"""What a need is -> why a recording does not show it, with the signal's name in its place."""


class Seen:
    """The signals of one recording, or of several, under one rig's plant, found when they are asked for.

    each: the same of every recording alone.
    """

    def __init__(self, rig: Rig, recording: Recording):
        self.rig, self.recording = rig, recording
        runs = recording.runs
        self.each = [Seen(rig.of(run.name), run) for run in runs] if len(runs) > 1 else [self]

    @cached_property
    def model(self) -> Model:
        """Of one recording."""
        return Model(self.rig, self.recording.runs[0], {})

    @cached_property
    def recorded(self) -> dict[str, np.ndarray]:
        """Channels, derived inputs, and the smoothed rates of recorded positions."""
        found = {**self.model.inputs, **self.recording.channels}
        for position, rate in rates(self.rig.plant).items():
            if position in self.recording.channels and rate not in found:
                found[rate] = self.model.smooth_rate(position)
        return {name: signal for name, signal in found.items() if name in self.rig.plant.symbols}

    @cached_property
    def read(self) -> set[str]:
        """States that a channel reads through its law, which is of no other state, as a speed in rpm."""
        plant, read = self.rig.plant, set()
        for law in plant.definitions.values():
            used = names(law.terms.values())
            moved = {*used, *(n for d in plant.needed(used) for n in names(d.terms.values()))} & {*plant.states}
            read |= moved if law.symbol in self.rig.predict and len(moved) == 1 else set()
        return read

    @cached_property
    def simulated(self) -> dict[str, np.ndarray]:
        """The other states, by the data sheet's plant."""
        with np.errstate(over="ignore", invalid="ignore"):
            states, _ = self.model.states(self.model.values)
        symbols = self.rig.plant.states
        return {s: column for s, column in zip(symbols, states.T, strict=True) if s not in self.recorded}

    def of(self, expression: str, values: Mapping[str, float] | None = None) -> np.ndarray:
        """The finite samples of an expression along the recording; values: of symbols that the plant has not."""
        if len(self.each) > 1:
            return np.concatenate([one.of(expression, values) for one in self.each])
        plant = self.rig.plant
        used = names([expression])
        for definition in plant.needed(used, self.recorded):
            used |= names(definition.terms.values())
        known = dict(self.recorded)
        if any(symbol in plant.states and symbol not in known for symbol in used):
            known |= self.simulated
        scope = Values(plant, {"t": self.recording.time, **known})
        scope.update(values or {})
        with np.errstate(all="ignore"):
            found = np.broadcast_to(scope.evaluate(expression), self.recording.samples)
        return found[np.isfinite(found)]

    def size(self, expression: str, values: Mapping[str, float] | None = None) -> float:
        """RMS of an expression along the recording; 0 where it has no finite value."""
        found = self.of(expression, values)
        return float(np.sqrt(np.mean(found**2))) if len(found) else 0.0

    def largest(self, place: str) -> float:
        """RMS of the largest term of an equation or a definition; of the whole balance where it has no term.

        That is one that a simulator from outside computes.
        """
        plant = self.rig.plant
        table = plant.equations.get(place) or plant.definitions[place]
        if isinstance(table, Equation) and not table.terms:
            return self._balance(table)
        sizes = [self.size(text) for text in table.terms.values()]
        return max(sizes, default=0.0)

    def _balance(self, equation: Equation) -> float:
        """RMS of what the data sheet's plant makes of its left side."""
        sizes = []
        for one in self.each:
            with np.errstate(over="ignore", invalid="ignore"):
                states, _ = one.model.states(one.model.values)
                change = np.diff(states[:, list(one.rig.plant.states).index(equation.state)]) / one.rig.dt
            moved = change[np.isfinite(change)]
            sizes.append(float(np.mean(np.square(moved))) if len(moved) else 0.0)
        return float(np.sqrt(np.mean(sizes))) * self.size(equation.storage)

    def _swings(self, channel: str, line: float, strength: float, sure: float) -> bool:
        """Whether the data sheet's machine, run free, has a line there, too, of such a strength or nearly.

        sure: how far a line stands out.
        """
        if self.rig.window:
            return False  # it begins again and again as recorded, line and all
        with np.errstate(over="ignore", invalid="ignore"):
            run = self.model.predict(self.model.values)[:, self.rig.predict.index(channel)]
        if not np.isfinite(run).all():
            return False
        frequency, power = _spectrum(run, self.rig.dt)
        step = NARROW * (frequency[1] - frequency[0])
        near = np.abs(frequency - line) <= max(OWN * line, step)
        lines = power * (_above(power) > sure)
        return bool(lines[near].max(initial=0.0) > ALIKE * strength)

    # -- numbers in a table of effects ---------------------------------------------------------------------------------

    def number(self, text: str) -> float:
        """The number for which "KIND AMOUNT [NAME]" stands in `general.toml`. Raises InputError for another kind."""
        kind, *words = text.split()
        name = words[-1] if words and not _is_number(words[-1]) else ""
        amount = float(words[0]) if words and _is_number(words[0]) else 1.0
        if kind not in self._kinds:
            raise InputError(f"{text!r}: {kind!r} is no number of a recording; give one of {', '.join(self._kinds)}")
        return float(self._kinds[kind](amount, name))

    @cached_property
    def _kinds(self):
        dt, samples = self.rig.dt, max(run.samples for run in self.recording.runs)
        return {
            "samples": lambda a, name: a * dt,
            "duration": lambda a, name: a * dt * samples,
            "per_duration": lambda a, name: a / (dt * samples),
            "per_sample": lambda a, name: a / samples,
            "level": lambda a, name: np.quantile(self._some(name), a),
            "size": lambda a, name: self._size(a, name),
            "speck": lambda a, name: SPECK * self._peak(name),
            "rate": lambda a, name: self._rate(a, name),
            "range": lambda a, name: a * np.ptp(self._some(name)) or a * self._peak(name),
            "part": lambda a, name: np.min(self._some(name)) + a * np.ptp(self._some(name)),
            "waves": lambda a, name: 2 * np.pi * a / (np.ptp(self._some(name)) or self._peak(name)),
            "slope": lambda a, name: a * (np.ptp(self._some(name)) or self._peak(name)) / (dt * samples),
            "way": lambda a, name: a * self._way(name),
            "stride": lambda a, name: a * self._peak(name) * min(self.rig.plant.step, dt),
            "balance": lambda a, name: a * (self.largest(name) or 1.0),
            "noise": lambda a, name: a * self._noise(name),
        }

    def _some(self, name: str) -> np.ndarray:
        found = self.of(name)
        return found if len(found) else np.ones(1)

    def _peak(self, name: str) -> float:
        return float(np.max(np.abs(self._some(name)))) or 1.0

    def _size(self, quantile: float, name: str) -> float:
        """That quantile of a signal's magnitudes; where it rests then, of those with which it moves."""
        size, slow = np.abs(self._some(name)), SLOW * self._peak(name)
        found, moving = np.quantile(size, quantile), size[size >= slow]
        return float(found if found >= slow or not len(moving) else np.quantile(moving, quantile))

    def _rate(self, quantile: float, name: str) -> float:
        """That quantile of the magnitudes of a signal's rate where it changes."""
        change = np.abs(self._changes(name)) / self.rig.dt
        change = change[change > 0]
        return float(np.quantile(change, quantile)) if len(change) else self._peak(name) / self.rig.dt

    def _way(self, name: str) -> float:
        """How far a velocity goes from its furthest point to the other."""
        way = max(float(np.ptp(np.cumsum(one._some(name)))) for one in self.each)
        return way * self.rig.dt or self._peak(name) * self.rig.dt

    def _changes(self, name: str, order: int = 1) -> np.ndarray:
        """Differences of a signal from sample to sample, none of them from one recording to the next."""
        return np.concatenate([np.diff(one._some(name), order) for one in self.each])

    def _noise(self, name: str) -> float:
        """The noise of a channel as its differences from sample to sample show it; at most that of its signal."""
        signal = self._some(name)
        rough = np.sqrt(np.mean(self._changes(name, 2) ** 2) / TWICE) if len(signal) > LEVELS else 0.0
        return float(max(rough, SPECK * self._peak(name)))

    def lines(self, channel: str) -> list[float]:
        """Frequencies in Hz at which narrow lines stand out of a channel's spectrum; first those of no input.

        And those of the mains, where the recording is too short to make a narrow line of them. None is the machine's
        own swing.
        """
        if len(self.each) > 1:
            width = 1.0 / (self.rig.dt * min(run.samples for run in self.recording.runs))
            every: list[float] = []
            for line in (line for one in self.each for line in one.lines(channel)):
                every += [line] if all(abs(line - other) > width for other in every) else []
            return every[:LINES]
        frequency, power = _spectrum(self.recording[channel], self.rig.dt)
        given = [_spectrum(self.recording[name], self.rig.dt)[1] for name in self.rig.inputs]
        ratio = _above(power)
        sure = -np.log2(CHANCE / max(len(ratio), 1))  # of an exponential variable over its median
        slowest = SLOWEST / (self.rig.dt * self.recording.samples)
        found: list[tuple[bool, float]] = []
        for i in np.argsort(-ratio):
            if ratio[i] < sure or len(found) >= LINES * (NARROW + 1):
                break
            near = slice(max(i - NARROW, 0), i + NARROW + 1)
            if frequency[i] >= slowest and ratio[i] == ratio[near].max():
                shared = any(_above(other)[near].max() > sure for other in given)
                if not shared and self._swings(channel, frequency[i], power[i], sure):
                    continue
                found.append((shared, _refined(self.recording[channel], frequency[i], self.rig.dt)))
        spectral = [f for _, f in sorted(found, key=lambda line: line[0])][:LINES]
        once = 1.0 / (self.rig.dt * self.recording.samples)
        return spectral + [f for f in MAINS if once <= f < slowest and FAST * f * self.rig.dt <= 1.0]

    # -- what an effect needs ------------------------------------------------------------------------------------------

    def shows(self, need: str) -> bool:
        """Whether the recording does what "NEED NAME" says; raises InputError for an unknown need."""
        kind, _, name = need.partition(" ")
        if kind == "beside":
            return len(self.rig.predict) > 1 or bool(self.rig.inputs)
        if kind == "several":
            return len(self.rig.predict) > 1 or len(self.rig.inputs) > 1
        if kind == "recorded":
            return name in self.recorded or name in self.read
        state = self.rig.plant.states.get(name)
        if kind == "may_be_negative":
            return not (state and isinstance(state.low, float) and state.low >= 0)
        tests = {
            "moves": self._moves,
            "turns": lambda s: _often(s, s > 0, s < 0) or (_often(s, _slow(s)) and not _slow(s).all()),
            "both_signs": lambda s: _often(s, s > SLOW * np.max(np.abs(s)), s < -SLOW * np.max(np.abs(s))),
            "near_zero": lambda s: _often(s, np.abs(s) < NEAR * np.max(np.abs(s))) or _often(s, s > 0, s < 0),
            "often_high": lambda s: np.sum(s >= s.max() - END * np.ptp(s)) > LEVELS and np.ptp(s) > 0,
            "often_low": lambda s: np.sum(s <= s.min() + END * np.ptp(s)) > LEVELS and np.ptp(s) > 0,
            "goes_round": lambda s: np.ptp(s) > 2 * np.pi,
            "never_negative": lambda s: s.min() > -NEGATIVE * np.max(np.abs(s)),
            "comes_down": lambda s: s.min() < np.max(s) / 2,
            "several_levels": lambda s: len(np.unique(np.abs(s))) > LEVELS,
            "several_rates": lambda s: len(np.unique(np.abs(self._changes(name)).round(DIGITS))) > LEVELS,
        }  # fmt: skip
        if kind not in tests:
            raise InputError(f"needs {need!r}: {kind!r} is unknown; give one of several, recorded, {', '.join(tests)}")
        self.asked = name
        return bool(tests[kind](self._some(name)))

    def lacks(self, needs: Iterable[str]) -> str:
        """The first of an effect's needs that the recording does not show, in words; empty where it shows all."""
        for need in needs:
            if not self.shows(need):
                kind, _, name = need.partition(" ")
                return UNMET[kind].format(name)
        return ""

    def _moves(self, signal: np.ndarray) -> bool:
        channel = self.rig.channels.get(self.asked)
        return bool(np.std(signal) > (NOISY * channel.sigma if channel else 0.0) and np.ptp(signal) > 0)


def _is_number(word: str) -> bool:
    return word.lstrip("-")[:1].isdigit()


def _often(signal: np.ndarray, *where: np.ndarray) -> bool:
    """Whether each of the conditions (samples,) holds in some share of the samples."""
    return all(np.mean(w) >= SOME for w in where)


def _slow(signal: np.ndarray) -> np.ndarray:
    return np.abs(signal) < SLOW * np.max(np.abs(signal))


def _spectrum(signal: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """(frequencies in Hz, power) of a signal less its trend, through a Hann window."""
    n = len(signal)
    trend = np.polyval(np.polyfit(np.arange(n), signal, 1), np.arange(n)) if n > 2 else signal
    power = np.abs(np.fft.rfft((signal - trend) * np.hanning(n))) ** 2
    return np.fft.rfftfreq(n, dt), power


def _above(power: np.ndarray) -> np.ndarray:
    """Each line's power over the median of those beside it."""
    wide = np.pad(power, BESIDE, mode="reflect") if len(power) > BESIDE else np.pad(power, BESIDE, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(wide, 2 * BESIDE + 1)
    return power / (np.median(around, axis=1) + TINY)


def _refined(signal: np.ndarray, frequency: float, dt: float) -> float:
    """The frequency near `frequency` at which the signal has most power, to a thousandth of a line."""
    n = len(signal)
    window, instants, width = np.hanning(n) * (signal - signal.mean()), np.arange(n) * dt, 1.0 / (n * dt)
    for _ in range(NARROW):
        tried = frequency + width * np.linspace(-1, 1, 2 * BESIDE + 1)
        power = [abs(np.sum(window * np.exp(-2j * np.pi * f * instants))) for f in tried]
        frequency, width = float(tried[int(np.argmax(power))]), width / BESIDE * 2
    return frequency
