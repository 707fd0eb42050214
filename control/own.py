"""Control of any machine: what it is, what is asked of it, and the machine under way with what disturbs it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from greygate.control.choices import Case
from greygate.control.loop import Controller, Run, run
from greygate.control.modelled import Model, OfPlant
from greygate.control.predictive import Limits
from greygate.errors import InputError
from greygate.models.network import Port
from greygate.plants.excitation import band_limited_noise
from greygate.progress import Progress, silent

LOAD = 0.05  # of an input's range, RMS: of the load that the machine feels beside it
LOADED = 4  # periods of the load's fastest part in a hundred samples
SAGGED = 0.9  # of what they are told, inputs reach while the supply sags
BLEND = 1.5  # times the reference's own greatest speed: the least time in which another one is come to
SHOCK, SHOCKED, APART = 0.5, 5, 60  # of an input's range, samples, samples from one to the next
SIZED = 0.7, 1.1  # sizes of other references, of the one that was asked for


@dataclass(frozen=True)
class Machine:
    """What is controlled, and what is asked of it.

    truth: the machine itself, by the seed of its day; None: as declared. model: that predicts. drives: inputs that are
    controlled, each with its range as scale and its rest as initial. signals: what both tell, in their order: measured
    ones first. noise: of each measured one, its standard deviation. tracked: of the measured ones. reference: (N,
    tracked). acting: other input -> (N,), what disturbs the machine. shocked: whether inputs get short shocks, of
    which a network learns to come back (Laskey et al. 2017).
    """

    name: str
    period: float
    truth: Callable[[int | None], Model]
    model: Model
    drives: Sequence[Port]
    signals: Sequence[Port]
    noise: Mapping[str, float]
    tracked: Sequence[str]
    limits: Limits
    reference: np.ndarray
    acting: Mapping[str, np.ndarray] = field(default_factory=dict)
    shocked: bool = False

    @property
    def rest(self) -> np.ndarray:
        """(inputs,) before the first sample."""
        return np.array([p.initial for p in self.drives])

    @property
    def sizes(self) -> np.ndarray:
        """(tracked,): half of the range that the reference goes through."""
        return np.maximum(np.ptp(self.reference, axis=0), 1e-3 * np.abs(self.reference).max(axis=0)) / 2

    def references(self, seed: int | None, samples: int) -> np.ndarray:
        """(samples, tracked): that which is asked for, or another one of its kind."""
        own = self.reference[:samples]
        return own if seed is None else varied(self.reference, samples, seed)

    def run(
        self, controller: Controller, case: Case, seed: int | None, samples: int = 0, progress: Progress = silent
    ) -> Run:
        """A closed loop on that reference and day; seed None: the reference that was asked for."""
        samples = samples or len(self.reference)
        reference = self.references(seed, samples)
        rig = UnderWay(self, case, 0 if seed is None else seed, len(reference))
        return run(rig, controller, reference, self.tracked, self.limits, self.period, self.rest, progress)

    def cost(self, done: Run) -> float:
        """RMS error, each output's over its size; with the share of samples in which a limit of an output is broken."""
        broken = sum(done.violations[n] for n in self.limits.outputs) / len(done.error)
        found = float(np.sqrt(np.mean((done.error / self.sizes) ** 2))) + broken
        return found if np.isfinite(found) else np.inf


def varied(reference: np.ndarray, samples: int, seed: int) -> np.ndarray:
    """Another reference of the same kind: the one given and its reversal, from a drawn sample on, of a drawn size about
    where it begins, from where the machine rests."""
    rng = np.random.default_rng(seed)
    there_and_back = np.concatenate([reference, reference[::-1]])
    begun = np.roll(there_and_back, -int(rng.integers(len(there_and_back))), axis=0)
    begun = np.resize(begun, (samples, reference.shape[1])) - reference[0]
    speed = np.abs(np.diff(reference, axis=0)).max(axis=0)
    longest = BLEND * float(np.max(np.ptp(reference, axis=0) / np.where(speed > 0, speed, np.inf)))
    ramp = np.clip(np.arange(samples) / max(min(longest, samples / 2), 1.0), 0.0, 1.0)[:, None]
    return reference[0] + ramp**2 * (3 - 2 * ramp) * rng.uniform(*SIZED) * begun


class UnderWay:
    """A machine on one day, with its sensors and actuators."""

    def __init__(self, machine: Machine, case: Case, seed: int, samples: int):
        """case: `load` draws what the machine's parameters are within their tolerances, and adds a load to its inputs;
        `supply` lets its inputs reach only a share over the middle third."""
        self.machine = machine
        self.model = machine.truth(seed if case is Case.LOAD else None)
        rng, shape = np.random.default_rng(seed), (samples, len(machine.drives))
        self._share, self._load = np.ones(samples), np.zeros(shape)
        if case is Case.SUPPLY:
            self._share[samples // 3 : 2 * samples // 3] = SAGGED
        if case is Case.LOAD:
            for i, port in enumerate(machine.drives):
                size, whole = LOAD * 2 * abs(port.scale), max(samples, 100)
                noise = band_limited_noise(whole, size, 0.0, LOADED / 100, 1.0, seed + i)[:samples]
                self._load[:, i] = noise * np.clip(np.arange(samples) / 20, 0, 1)
        if machine.shocked:
            most = SHOCK * 2 * np.abs([p.scale for p in machine.drives])
            for at in range(int(rng.integers(APART)), samples, APART):
                self._load[at : at + SHOCKED] += rng.uniform(-most, most)
        sensed = np.array([*machine.noise.values()])
        self._noise = rng.normal(size=(samples, len(sensed))) * sensed
        self._sample, self._state = 0, self.model.start
        self._hold(machine.rest)

    def _hold(self, values: np.ndarray) -> None:
        if self.machine.acting and isinstance(self.model, OfPlant):
            for name, values_of in self.machine.acting.items():
                place = list(self.model.plant.inputs).index(name)
                self.model.base[place] = values_of[min(self._sample, len(values_of) - 1)]
        ends, seen = self.model.roll(self._state[None], values[None, None])
        if not np.isfinite(ends).all():
            at = f"{self._sample * self.machine.period:.6g} s"
            raise InputError(f"{self.machine.name}: a state is not finite at {at}; check the limits and the plant")
        self._state, self._seen = ends[0], seen[0, 0]

    def measured(self) -> dict[str, float]:
        noise = self._noise[self._sample]
        return {n: float(v + e) for n, v, e in zip(self.machine.noise, self._seen, noise, strict=False)}

    def truth(self) -> dict[str, float]:
        return {p.name: float(v) for p, v in zip(self.machine.signals, self._seen, strict=True)}

    def actuate(self, value: np.ndarray) -> np.ndarray:
        self._hold(value * self._share[self._sample] + self._load[self._sample])
        self._sample += 1
        return value


def ranged(machine: Machine, done: Run) -> Machine:
    """The machine whose signals have the scales of a run, and of the references."""
    found = []
    for port in machine.signals:
        values = done.signals[port.name]
        if port.name in machine.tracked:
            values = np.append(values, machine.reference[:, machine.tracked.index(port.name)])
        low, high = float(values.min()), float(values.max())
        scale = (high - low) / 2 or max(abs(high), 1.0)
        found.append(replace(port, scale=scale, offset=(low + high) / 2, initial=float(values[0])))
    return replace(machine, signals=found)
