"""A plant over several recordings of one machine: one model for each, joined end to end.

Parameters and effects are shared. What a recording begins with, and what rig.toml lists as its own, is its own: a
parameter `mass` that is fitted in the recording run2 alone is `mass@run2` among the values of the joined model.
"""

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from greygate.mismatch.effects import Effect
from greygate.mismatch.model import Model, begun
from greygate.mismatch.rig import IN, Rig
from greygate.mismatch.runs import Runs
from greygate.plants.recording import Recording, run_name


def modelled(rig: Rig, recording: Recording, effects: Mapping[str, Effect], window: int | None = None) -> Model:
    """The rig's plant over a recording, or over several of them. Arguments as for `Model`."""
    if isinstance(recording, Runs):
        return Several(rig, recording, effects, window)
    return Model(rig, recording, effects, window)


class Several(Model):
    """The models of all recordings of a rig, as one: what is (samples, ...) is joined end to end."""

    def __init__(self, rig: Rig, recording: Runs, effects: Mapping[str, Effect], window: int | None = None):
        super().__init__(rig, recording.each[0], effects, window)
        self.all = [Model(rig.of(run.name), run, effects, window) for run in recording.each]
        names, learnt = [run.name for run in recording.each], [run_name(file) for file in rig.identify]
        self.fitted = [rig.fitted_in(name) if name in learnt else {} for name in names]
        own = [{*rig.own[name].parameters} if name in rig.own else set() for name in names]
        self.known = [symbols - {*fitted} for symbols, fitted in zip(own, self.fitted, strict=True)]
        for model, fitted in zip(self.all, self.fitted, strict=True):
            self.values |= {key: model.values[s] for s, key in {**fitted, **{b: b for b in model.begins}}.items()}
        self.recording = recording
        self.restarts = np.concatenate([p.start + m.restarts for p, m in zip(self.pieces, self.all, strict=True)])
        self.target = np.concatenate([m.target for m in self.all])
        self._inputs = {name: np.concatenate([m.inputs[name] for m in self.all]) for name in self.plant.inputs}

    @property
    def each(self) -> list[Model]:
        return self.all

    def over(self, recording: Recording) -> Model:
        """The model over one further recording, in which nothing is its own."""
        other = Model.__new__(Model)
        vars(other).update(vars(self))
        other._take(recording, self.window)
        return other

    def in_steps(self, steps: int) -> Model:
        other = copy.copy(self)
        other.all = [m.in_steps(steps) for m in self.all]
        return other

    def longer(self) -> Iterator[Model]:
        for models in zip(*(m.longer() for m in self.all), strict=True):
            other = copy.copy(self)
            other.all = [*models]
            yield other

    def driven(self, name: str, signal: np.ndarray) -> Model:
        other = copy.copy(self)
        other._inputs = {**self._inputs, name: signal}
        other.all = [m.driven(name, signal[p]) for m, p in zip(self.all, self.pieces, strict=True)]
        return other

    def in_each(self, values: Mapping[str, float]) -> list[dict[str, float]]:
        """The values that hold in each recording."""
        out = []
        for model, fitted, known in zip(self.all, self.fitted, self.known, strict=True):
            there = {s: v for s, v in values.items() if IN not in s}
            there |= {s: model.values[s] for s in known}
            there |= {s: values[s] for s in model.begins if s in values}
            out.append(there | {s: values[key] for s, key in fitted.items() if key in values})
        return out

    def spread(self, values: Mapping[str, float]) -> dict[str, float | np.ndarray]:
        each = self.in_each(values)
        out: dict[str, float | np.ndarray] = dict(values)
        for symbol in {s for fitted, known in zip(self.fitted, self.known, strict=True) for s in (*fitted, *known)}:
            if all(symbol in there for there in each):
                counts = [len(m.target) for m in self.all]
                out[symbol] = np.repeat([there[symbol] for there in each], counts)
        return out

    def _shifts(self, shifts: np.ndarray | None) -> Sequence[np.ndarray | None]:
        if shifts is None:
            return [None] * len(self.all)
        return np.split(shifts, np.cumsum([len(m.restarts) for m in self.all])[:-1])

    def starts(self, values: Mapping[str, float], signals: Mapping[str, np.ndarray]) -> np.ndarray:
        each = zip(self.all, self.in_each(values), self.pieces, strict=True)
        return np.concatenate([m.starts(v, {n: s[p] for n, s in signals.items()}) for m, v, p in each])

    def smooth_rate(self, channel: str) -> np.ndarray:
        return np.concatenate([m.smooth_rate(channel) for m in self.all])

    def states(self, values: Mapping[str, float], shifts: np.ndarray | None = None) -> tuple[np.ndarray, dict]:
        each = zip(self.all, self.in_each(values), self._shifts(shifts), strict=True)
        found = [m.states(v, s) for m, v, s in each]
        signals = {name: np.concatenate([given[name] for _, given in found]) for name in found[0][1]}
        return np.concatenate([states for states, _ in found]), signals

    def predict(self, values: Mapping[str, float], shifts: np.ndarray | None = None) -> np.ndarray:
        each = zip(self.all, self.in_each(values), self._shifts(shifts), strict=True)
        return np.concatenate([m.predict(v, s) for m, v, s in each])

    def added(self, effect: Effect, values: Mapping[str, float]) -> Callable[[Mapping[str, float]], np.ndarray] | None:
        each = zip(self.all, self.in_each({**self.values, **values}), strict=True)
        found = [m.added(effect, v) for m, v in each]
        return _joined(found)

    def answering(
        self, effect: Effect, values: Mapping[str, float], shifts: np.ndarray | None
    ) -> Callable[[Mapping[str, float]], np.ndarray] | None:
        each = zip(self.all, self.in_each({**self.values, **values}), self._shifts(shifts), strict=True)
        return _joined([m.answering(effect, v, s) for m, v, s in each])


def _joined(found: list) -> Callable[[Mapping[str, float]], np.ndarray] | None:
    """What one gives of each recording, end to end; None where one gives nothing."""
    return None if None in found else lambda own: np.concatenate([give(own) for give in found])


def by_rule(model: Model, values: Mapping[str, float], skip: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(predicted (samples, predict), whether a sample counts (samples,)), by the rule of the rig.

    In each recording what it begins with is fitted to its first `skip` samples, which do not count.
    """
    each = model.in_each(values) if isinstance(model, Several) else [values]
    known = [{s: v for s, v in there.items() if s in m.values} for m, there in zip(model.each, each, strict=True)]
    predicted = [m.predict(begun(m, there, skip)) for m, there in zip(model.each, known, strict=True)]
    counts = [np.arange(len(m.target)) >= skip for m in model.each]
    return np.concatenate(predicted), np.concatenate(counts)
