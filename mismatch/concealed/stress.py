"""Conditions under which a campaign is recorded: what its sensors and its recorder do beyond what rig.toml says.

The machine itself is the same under each. "white" is the campaign as `conceal` always wrote it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from greygate.errors import InputError

from .rig import Columns, ConcealedRig, Sensor

STICKY = 0.9  # of coloured noise: what a sample keeps of the one before
TAILS = 3  # degrees of freedom of heavy-tailed noise: the fewest whole number with a variance
MAINS = 50.0  # Hz
FAST = 5  # samples in a period of the mains: a recorder with fewer picks up another line instead
LINES = (0.1, 0.4)  # of the sample rate: where the other line lies
TURN = 2 * np.pi

Noise = Callable[[np.random.Generator, int], np.ndarray]


def _white(rng: np.random.Generator, samples: int) -> np.ndarray:
    return rng.standard_normal(samples)


def _coloured(rng: np.random.Generator, samples: int) -> np.ndarray:
    fresh = np.sqrt(1 - STICKY**2) * rng.standard_normal(samples)
    return lfilter([1.0], [1.0, -STICKY], fresh, zi=[STICKY * rng.standard_normal()])[0]


def _heavy(rng: np.random.Generator, samples: int) -> np.ndarray:
    return rng.standard_t(TAILS, samples) * np.sqrt((TAILS - 2) / TAILS)


@dataclass(frozen=True)
class Condition:
    """What differs from "white".

    noise: draws noise of unit RMS. times: its true RMS over what rig.toml says. told: whether rig.toml says it at all.
    line: amplitude of what one output picks up, over its told noise. late: samples by which one output comes late.
    every: of the samples is recorded. fault: whether the recording, not the machine, is at fault.
    """

    means: str
    noise: Noise = _white
    times: float = 1.0
    told: bool = True
    line: float = 0.0
    late: int = 0
    every: int = 1

    @property
    def fault(self) -> bool:
        return bool(self.line or self.late)


CONDITIONS = {
    "white": Condition("white noise of the told size"),
    "coloured": Condition(f"each sample of the noise keeps {STICKY} of the one before", noise=_coloured),
    "heavy": Condition(f"noise with heavy tails (Student, {TAILS} degrees of freedom)", noise=_heavy),
    "louder": Condition("noise ten times what rig.toml says", times=10.0),
    "quieter": Condition("noise a fifth of what rig.toml says", times=0.2),
    "untold": Condition("rig.toml says nothing of the noise", told=False),
    "half_rate": Condition("every second sample is recorded", every=2),
    "pickup": Condition("one channel picks up the mains, 15 times the noise", line=15.0),
    "late": Condition("one channel comes two samples late", late=2),
}


def condition(name: str) -> Condition:
    """Raises InputError for an unknown name."""
    if name not in CONDITIONS:
        raise InputError(f"conceal: no condition {name!r}; there are {', '.join(CONDITIONS)}")
    return CONDITIONS[name]


@dataclass(frozen=True)
class Recorder:
    """Turns the true signals of a rig into what is written: `faulty` is the channel that picks up or comes late."""

    rig: ConcealedRig
    under: Condition
    faulty: str | None = None
    frequency: float = 0.0

    @classmethod
    def of(cls, rig: ConcealedRig, under: Condition, rng: np.random.Generator) -> "Recorder":
        """The recorder of one rig: every recording has the same fault."""
        if not under.fault:
            return cls(rig, under)
        faulty = str(rng.choice([channel.name for channel in rig.predicted]))
        other = rng.uniform(*LINES) / rig.sample_time
        return cls(rig, under, faulty, MAINS if MAINS * FAST * rig.sample_time <= 1 else float(other))

    def measure(self, signals: Columns, rng: np.random.Generator) -> Columns:
        """Columns as they are written."""
        columns = {c.name: self._measure(c, signals[c.name], rng) for c in self.rig.channels}
        return {name: column[:: self.under.every] for name, column in columns.items()}

    def _measure(self, channel: Sensor, signal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        under = self.under
        if channel.role == "input" or (under.noise is _white and under.times == 1 and channel.name != self.faulty):
            return channel.measure(signal, rng)
        if under.late:
            signal = np.concatenate([np.full(under.late, signal[0]), signal[: -under.late]])
        if under.line:
            clock = np.arange(len(signal)) * self.rig.sample_time
            wave = np.sin(TURN * (self.frequency * clock + rng.uniform()))
            signal = signal + under.line * channel.error * wave
        noise = under.times * channel.noise * under.noise(rng, len(signal))
        return replace(channel, noise=0.0, resolution=channel.step).measure(signal + noise, rng)

    def written(self) -> ConcealedRig:
        """The rig as rig.toml describes it, its simulation on the samples that are recorded."""
        rig, every = self.rig, self.under.every
        if not self.under.told:
            bare = (replace(c, resolution=0.0, noise=0.0) if c.role == "output" else c for c in rig.channels)
            return replace(rig, channels=tuple(bare))
        if every == 1:
            return rig
        return replace(rig, sample_time=every * rig.sample_time, predict=between(rig, every))


def between(rig: ConcealedRig, every: int) -> Callable[..., Columns]:
    """The rig's prediction on records of each `every`-th sample: commands are held, all else is interpolated."""
    held = {c.name for c in rig.channels if c.role == "input" and (rig.own or c.unit not in ("m", "Pa"))}

    def predict(columns: Columns, *arguments) -> Columns:
        fine = {}
        for name, column in columns.items():
            at = np.arange(len(column) * every) / every
            fine[name] = np.repeat(column, every) if name in held else np.interp(at, np.arange(len(column)), column)
        return {name: column[::every] for name, column in rig.predict(fine, *arguments).items()}

    return predict
