"""The part of a plant that a network is to compute: from what is measured in the field to what is not."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from greygate.errors import InputError
from greygate.identify.expert.acting import Filter
from greygate.mismatch.model import FILTERS
from greygate.mismatch.rig import FEWEST, Own, Rig
from greygate.models.sampling import same
from greygate.models.training.record import Record
from greygate.plants.closure import Closure
from greygate.plants.expressions import names, parse
from greygate.plants.plant import Definition, Equation, Plant, Values
from greygate.plants.recording import Recording, run_name
from greygate.plants.simulator import simulate

SHORTEST = 40  # samples of a recording
GRID = 2001  # values of a state at which a term is asked how fast it turns
NUDGE = 1e-3  # of the rates in which a recording begins, for a difference
SAME = 1e-6  # of a slope, by which that of a linear term differs by rounding


@dataclass(frozen=True)
class Task:
    """plant: with the values of the data sheet. inputs: recorded signals that the network reads. targets: its outputs.

    rates: signal -> the measured signal whose rate it is, and how the plant derives it. step: sample time in s.
    measured: inputs that no converter holds, which go straight from one sample to the next.
    filters, readings: how an input acts and what a target's sensor adds, as a diagnosis says. rig: what is known of the
    machine besides, where it is a rig's.
    """

    plant: Plant
    inputs: tuple[str, ...]
    targets: tuple[str, ...]
    rates: Mapping[str, tuple[str, str]]
    step: float
    measured: frozenset[str] = frozenset()
    filters: Mapping[str, Sequence[Filter]] = field(default_factory=dict)
    readings: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    rig: Rig | None = None

    @classmethod
    def of(
        cls, plant: Plant | Rig, recordings: Sequence[Recording], sensors: Sequence[str], targets: Sequence[str]
    ) -> "Task":
        """sensors: outputs that are measured in the field too. targets: by default every other output on record.

        Raises InputError for a signal that is not there or a plant that no network is made of.
        """
        rig = None
        if isinstance(plant, Rig):
            rig, plant = plant, plant.plant
            _alike(rig, recordings)
        if plant.outside is not None:
            why = "a model computes it, which has no equations here to build from"
            raise InputError(f"plant {plant.name}: {why}; `greygate identify` builds from the recordings alone")
        step, recorded = recordings[0].dt, set(recordings[0].channels)
        for recording in recordings:
            if recording.samples < SHORTEST:
                raise InputError(f"{recording.source}: {recording.samples} samples; give at least {SHORTEST}")
            if not same(recording.dt, step):
                raise InputError(f"{recording.source}: sampled every {recording.dt:g} s, not {step:g} s; resample it")
        for name in (*sensors, *targets):
            if name not in plant.symbols - set(plant.parameters):
                raise InputError(f"plant {plant.name}: has no signal {name}; it has {', '.join(plant.outputs)}")
        if given := [name for name in targets if name in plant.inputs]:
            them = ", ".join(plant.outputs)
            raise InputError(f"plant {plant.name}: {given[0]} is an input, which nothing computes; it has {them}")
        targets = tuple(targets or (n for n in plant.outputs if n in recorded and n not in sensors))
        if not targets:
            raise InputError(f"plant {plant.name}: no output is on record but those of a sensor; name one by --output")
        if both := set(targets) & set(sensors):
            raise InputError(f"{min(both)} is both --sensor and --output; leave one out")
        task = cls(plant, (), targets, _rates(plant, sensors), step)
        measured = {*sensors, *(n for n in plant.inputs if n not in plant.derived)}
        needed = task._needed(measured)
        inputs = tuple(n for n in (*plant.inputs, *sensors) if n in needed & measured)
        for recording in recordings:
            for name in (*inputs, *targets):
                if name not in recording.channels:
                    there = ", ".join(recording.channels)
                    raise InputError(f"{recording.source}: no channel {name}, which {plant.name} needs; it has {there}")
                if (unit := recording.units[name]) != plant.unit(name):
                    raise InputError(f"{recording.source}: {name} is in {unit}; convert it to {plant.unit(name)}")
        if not inputs:
            raise InputError(f"plant {plant.name}: {', '.join(targets)} depends on no recorded input; name a --sensor")
        rates = {n: v for n, v in task.rates.items() if n in needed}
        straight = frozenset({*sensors, *(source for source, _ in rates.values())} & {*inputs})
        return replace(task, inputs=inputs, rates=rates, measured=straight, rig=rig)

    @classmethod
    def over(
        cls, plant: Plant, step: float, inputs: Sequence[str], sensors: Sequence[str], targets: Sequence[str]
    ) -> "Task":
        """The task of a plant that is known to have recordings with these inputs and targets."""
        task = cls(plant, tuple(inputs), tuple(targets), _rates(plant, sensors), step)
        needed = task._needed({*inputs})
        return replace(task, rates={n: v for n, v in task.rates.items() if n in needed})

    def fastest(self, signals: Mapping[str, np.ndarray]) -> tuple[str, float]:
        """The term that is not linear and turns fastest along the signals, as "place.term"; by how much in a sample.

        "" and 0 where every term is linear.
        """
        plant, found = self.reduced, ("", 0.0)
        for name, equation in plant.equations.items():
            for term, text in equation.terms.items():
                for state in self.states:
                    turns = self._turns(plant, equation, text, state, signals) * self.step
                    found = max(found, (f"{name}.{term}", turns), key=lambda pair: pair[1])
        return found

    @staticmethod
    def _turns(plant: Plant, equation: Equation, text: str, state: str, signals: Mapping[str, np.ndarray]) -> float:
        """The largest change of a term's share in its rate with its state, 1/s; 0 where it is the same all along.

        With the integral of its state, as of a spring: the root of that change.
        """
        known = {n: v for n, v in signals.items() if n in plant.states or n in plant.inputs}
        span = float(np.ptp(known[state]))
        moved = next(e for e in plant.equations.values() if e.state == state)
        power = 1.0 if state == equation.state else 0.5
        if not span or (power != 1.0 and [*moved.terms.values()] != [equation.state]):
            return 0.0
        values = np.linspace(known[state].min(), known[state].max(), GRID)
        at = {n: np.full(GRID, float(np.median(v))) for n, v in known.items()} | {state: values}
        scope = Values(plant, at)
        rate = np.broadcast_to(scope.evaluate(text) / scope.evaluate(equation.storage), GRID)
        slopes = np.abs(np.diff(rate) / np.diff(values))
        return float(slopes.max()) ** power if np.ptp(slopes) > SAME * slopes.max() else 0.0

    def _needed(self, measured: set[str]) -> set[str]:
        """Every symbol on which the targets depend, up to what is measured."""
        found: set[str] = set()
        waiting = [*self.targets]
        while waiting:
            symbol = waiting.pop()
            if symbol in found:
                continue
            found.add(symbol)
            if symbol in self.rates:
                waiting.append(self.rates[symbol][0])
            elif symbol not in measured and symbol not in self.plant.parameters:
                waiting += self._texts(symbol)
        return found

    def _texts(self, symbol: str) -> set[str]:
        """What its sum reads, and what an unknown term of it would."""
        return self._known_texts(symbol) | self._unknown_texts(symbol)

    def _unknown_texts(self, symbol: str) -> set[str]:
        closure, found = self.plant.closure, set()
        for where, place in closure.places.items():
            sums = (self.plant.equations.get(where), self.plant.definitions.get(where))
            if symbol in {sums[0] and sums[0].state, sums[1] and sums[1].symbol}:
                texts = [t for name in place.libraries for t in closure.libraries.get(name, {}).values()]
                found |= names([t for t in texts if names([t]) <= self.plant.symbols])
                found |= names([place.term]) - {"f"}
        return found - {symbol}

    def _known_texts(self, symbol: str) -> set[str]:
        if symbol in self.plant.states:
            equation = next(e for e in self.plant.equations.values() if e.state == symbol)
            if equation.couples:
                raise InputError(
                    f"plant {self.plant.name}: {symbol} has coupled rates; solve its equation for the rate"
                )
            return names(equation.texts)
        found = next((d for d in self.plant.definitions.values() if d.symbol == symbol), None)
        return names(found.terms.values()) if found else set()

    @cached_property
    def needed(self) -> set[str]:
        return self._needed(set(self.inputs))

    @cached_property
    def states(self) -> tuple[str, ...]:
        """The states that the network keeps."""
        known = {*self.inputs, *self.rates}
        return tuple(s for s in self.plant.states if s in self.needed and s not in known)

    @cached_property
    def definitions(self) -> dict[str, Definition]:
        return {n: d for n, d in self.plant.definitions.items() if d.symbol in self.needed}

    @cached_property
    def equations(self) -> dict[str, str]:
        """State -> name of its equation."""
        return {e.state: n for n, e in self.plant.equations.items() if e.state in self.states}

    @cached_property
    def reduced(self) -> Plant:
        """The plant with the measured signals, and their rates, as inputs."""
        given = [*self.inputs, *self.rates]
        kept = {s: self.plant.states[s] for s in self.states}
        states = {s: replace(v, rate=v.rate if v.rate in kept else None, start=None) for s, v in kept.items()}
        equations = {n: self.plant.equations[n] for n in self.equations.values()}
        inputs = {n: self.plant.unit(n) for n in given}
        derived = {n: f"{how} {source}" for n, (source, how) in self.rates.items()}
        return replace(
            self.plant, inputs=inputs, states=states, equations=equations, definitions=self.definitions,
            outputs=self.targets, derived=derived, switches={}, required=(), closure=Closure(), experiments={},
        )  # fmt: skip

    def signals(self, recording: Recording) -> dict[str, np.ndarray]:
        """What acts and the rates of it, as the plant has them over the interval after each sample."""
        found = {n: self._acts(n, recording[n]) for n in self.inputs}
        for rate, (source, how) in self.rates.items():
            moved = np.diff(recording[source], append=recording[source][-1:]) / self.step
            found[rate] = np.gradient(moved, self.step) if "acceleration" in how else moved
        return found

    def _acts(self, name: str, signal: np.ndarray) -> np.ndarray:
        """An input as it acts: behind its filters; of a measured one its mean up to the next sample."""
        for kind, given in self.filters.get(name, ()):
            signal = FILTERS[kind](signal, *given, self.step)
        return signal if name not in self.measured else (signal + np.append(signal[1:], signal[-1:])) / 2

    def nominal(self, recording: Recording) -> dict[str, np.ndarray]:
        """Every signal of the plant's own simulation on what the recording's inputs are."""
        symbols = [*self.states, *(d.symbol for d in self.definitions.values())]
        found = dict(self._run(self.signals(recording), self._start(recording), symbols))
        scope = {**found, **{s: p.value for s, p in self.plant.parameters.items()}, **self.signals(recording)}
        for target, terms in self.readings.items():
            found[target] = found[target] + sum(parse(text).over(scope) for text in terms.values())
        return found

    def _start(self, recording: Recording) -> dict[str, float]:
        """Where the targets are at the first sample; and their rates, where a rig's file says that it settles.

        The rates are of a parabola through the samples in which it does, then by one step of Gauss-Newton. What a rig
        learns from begins at rest, as in its diagnosis.
        """
        known = {s: float(recording[s][0]) for s in self.states if s in self.targets}
        rates = {s: rate for s in known if (rate := self.plant.states[s].rate) in self.states and rate not in known}
        if self.rig is None or self.rig.settle < FEWEST or recording.name in map(run_name, self.rig.identify):
            return known
        settle = min(self.rig.settle, recording.samples)
        clock, signals = self.step * np.arange(settle), {n: v[:settle] for n, v in self.signals(recording).items()}
        moving = {rate: float(np.polyfit(clock, recording[s][:settle], 2)[1]) for s, rate in rates.items()}

        def missed(factor: float) -> np.ndarray:
            start = {**known, **{rate: factor * value for rate, value in moving.items()}}
            run = self._run(signals, start, [*rates])
            return np.concatenate([run[s] - recording[s][:settle] for s in rates])

        if not any(moving.values()):
            return known
        slope = (missed(1.0 + NUDGE) - missed(1.0)) / NUDGE
        best = 1.0 - float(slope @ missed(1.0)) / (float(slope @ slope) or 1.0)
        return known | {rate: best * value for rate, value in moving.items()}

    def _run(
        self, signals: Mapping[str, np.ndarray], start: Mapping[str, float], channels: Sequence[str]
    ) -> Mapping[str, np.ndarray]:
        inner = max(int(np.ceil(self.step / self.plant.step - 1e-9)), 1)
        return simulate(
            self.reduced, signals, sample_time=self.step, step=self.step / inner, initial=start, channels=channels
        ).channels

    def record(self, recording: Recording) -> Record:
        """What a network of this task learns, with the inputs at rest before the first sample."""
        inputs = {n: recording[n] for n in self.inputs}
        initial = {n: float(v[0]) for n, v in inputs.items()}
        return Record(inputs, {n: recording[n] for n in self.targets}, initial)


def _alike(rig: Rig, recordings: Sequence[Recording]) -> None:
    """Raise InputError where a recording has values of parameters of its own."""
    for recording in recordings:
        own = rig.own.get(recording.name, Own()).parameters
        if other := [s for s, value in own.items() if value != rig.plant.parameters[s].value]:
            why = f"{other[0]} has another value there, and a network has one; make it an input of the plant"
            raise InputError(f"{recording.source}: {why}")


def _rates(plant: Plant, sensors: Sequence[str]) -> dict[str, tuple[str, str]]:
    """The signals that are rates of measured ones: inputs derived from them, and velocities of measured positions."""
    found = {}
    for name, text in plant.derived.items():
        how, _, source = text.partition(" ")
        found[name] = (source, how)
    for equation in plant.equations.values():
        (rate, *others) = equation.terms.values()
        if equation.state in sensors and not others and rate in plant.states and equation.storage == "1":
            found.setdefault(rate, (equation.state, "rate"))
    return {n: v for n, v in found.items() if n not in sensors}
