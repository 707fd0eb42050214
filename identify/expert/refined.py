"""Refines a diagnosed plant in free run, over all that a network of it is to learn from: values, and fuller shapes.

A diagnosis tells effects apart by few numbers. Where one is named, its curve may take a fuller shape (`FULLER`): more
numbers than would be needed to name it, fitted together with what the data sheet leaves uncertain.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import least_squares

from greygate.errors import InputError
from greygate.identify.expert.task import Task
from greygate.mismatch.scales import noise
from greygate.models.accuracy import rms
from greygate.plants.expressions import names
from greygate.plants.plant import Parameter
from greygate.plants.recording import Recording

RUNS = 25  # iterations of a fit, at most
WORK = 1e8  # steps of integration in a fit, at most: about a minute of a core
QUIET = 1.25  # times a recording's noise, below which nothing is left to fit
DIFFERENCE = 1e-4  # of a parameter's scale, for a difference
WILD = 1e3  # errors, in units of those at the start, by which a run that diverges is off
LONGEST = 5.0  # of its logarithm: no own parameter of an effect moves further


@dataclass(frozen=True)
class Fuller:
    """A fuller curve of an effect that answers one signal {v}, in {strength} and its own parameters.

    starts: of every own parameter, factors of the signal's largest value, or numbers where `relative` is not set.
    """

    text: str
    starts: Mapping[str, Sequence[float]]
    relative: frozenset[str] = frozenset()


FULLER = {
    "dry_friction": Fuller(
        "-{strength} * tanh({v} / {knee}) * (1.0 + {static} * exp(-({v} / {stribeck})**2))",
        {"knee": (0.005, 0.02), "static": (0.5,), "stribeck": (0.1,)},
        frozenset({"knee", "stribeck"}),
    )
}
"""By the name of an effect, or the beginning of it. Friction: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica
30 (1994), section 2, with a smooth knee."""


@dataclass(frozen=True)
class Trial:
    """A task with parameters that may move. own: those of effects; sheet: the others, as the data sheet has them."""

    task: Task
    own: tuple[str, ...]
    sheet: Mapping[str, Parameter] = field(default_factory=dict)

    def off(self, z: np.ndarray) -> np.ndarray:
        """By how much the others are off the data sheet, in units of its tolerances."""
        known = self.task.plant.parameters
        return z[len(self.own) :] + np.array([(known[s].value - p.value) / p.reach for s, p in self.sheet.items()])

    def at(self, z: np.ndarray) -> Task:
        """The task where own parameters are exp(z) times as large, others z tolerances off."""
        known = {s: p.value for s, p in self.task.plant.parameters.items()}
        moved = {s: known[s] * float(np.exp(v)) for s, v in zip(self.own, z, strict=False)}
        others = zip(self.sheet.items(), z[len(self.own) :], strict=True)
        moved |= {s: known[s] + p.reach * float(v) for (s, p), v in others}
        return replace(self.task, plant=self.task.plant.with_parameters(**moved))


def refined(
    task: Task,
    sheet: Mapping[str, Parameter],
    recordings: Sequence[Recording],
    own: Mapping[str, str],
    progress: Callable[[str], None],
    within: float = np.inf,
) -> list[tuple[str, Task]]:
    """What may be better than a diagnosed task: (what it is, the task), each fitted to the recordings.

    sheet: the parameters as the data sheet has them. own: parameter of an effect -> that effect. within: tolerances
    that a parameter of the data sheet may be off. A fit whose start diverges is left out; nothing is fitted where the
    task misses the recordings by no more than their noise.
    """
    if _quiet(task, recordings):
        return []
    found = []
    for said, trial in _trials(task, sheet, recordings, own):
        progress(f"fitting {said}")
        try:
            found.append((said, _fitted(trial, recordings, within)))
        except InputError:  # the start diverges
            continue
    return found


def _quiet(task: Task, recordings: Sequence[Recording]) -> bool:
    """Whether a task misses the recordings by little more than their noise."""
    try:
        runs = [(task.nominal(r), r) for r in recordings]
    except InputError:  # it diverges
        return False
    return all(rms(run[t] - r[t]) <= QUIET * noise(r[t]) for run, r in runs for t in task.targets)


def _trials(
    task: Task, sheet: Mapping[str, Parameter], recordings: Sequence[Recording], own: Mapping[str, str]
) -> list[tuple[str, Trial]]:
    """The task itself, and with each fuller curve, at its starts."""
    found = [("its values", task, tuple(own))]
    for effect in dict.fromkeys(own.values()):
        known = next((fuller for name, fuller in FULLER.items() if effect.startswith(name)), None)
        if known is not None:
            found += [(f"a fuller {effect}", *made) for made in _fuller(task, recordings, own, effect, known)]
    return [(said, _free(made, sheet, symbols)) for said, made, symbols in found]


def _free(task: Task, sheet: Mapping[str, Parameter], own: Sequence[str]) -> Trial:
    """What may move: the parameters of effects that are not 0, and what the data sheet leaves uncertain."""
    used = names(t for e in task.reduced.equations.values() for t in e.texts)
    used |= names(t for d in task.reduced.definitions.values() for t in d.terms.values())
    known = task.plant.parameters
    unsure = {s: p for s, p in sheet.items() if s in used and s not in own and p.reach}
    return Trial(task, tuple(s for s in own if s in used and known[s].value), unsure)


def _fuller(task: Task, recordings: Sequence[Recording], own: Mapping[str, str], effect: str, fuller: Fuller):
    """(task, its own parameters) for every start of a fuller curve."""
    plant = task.plant
    places = [(name, e) for name, e in plant.equations.items() if effect in e.terms]
    symbols = [s for s, of in own.items() if of == effect]
    if len(places) != 1:
        return
    name, equation = places[0]
    reads = [s for s in sorted(names([equation.terms[effect]])) if s not in plant.parameters]
    if len(reads) != 1:
        return
    run = task.nominal(recordings[0])
    size = float(np.abs({**run, **task.signals(recordings[0])}[reads[0]]).max())
    first = max(len(starts) for starts in fuller.starts.values())
    new = {key: f"{symbols[0]}_{key}" for key in fuller.starts}
    for i in range(first):
        values = {
            new[key]: Parameter(starts[min(i, len(starts) - 1)] * (size if key in fuller.relative else 1.0),
                                plant.unit(reads[0]) if key in fuller.relative else "1")
            for key, starts in fuller.starts.items()
        }  # fmt: skip
        text = fuller.text.format(v=reads[0], strength=symbols[0], **new)
        made = replace(task, plant=plant.with_term(name, effect, text, values))
        yield made, (*(s for s in own if own[s] != effect), symbols[0], *new.values())


def _fitted(trial: Trial, recordings: Sequence[Recording], within: float) -> Task:
    """Least squares in free run; what the data sheet says counts as one measurement with its own uncertainty."""
    task, count = trial.task, len(trial.own)
    start = _errors(task, recordings)
    size = {t: rms(e) or 1.0 for t, e in start.items()}

    def missed(z: np.ndarray) -> np.ndarray:
        try:
            errors = _errors(trial.at(z), recordings)
            run = np.concatenate([errors[t] / size[t] for t in task.targets])
        except InputError:
            run = np.full(sum(len(e) for e in start.values()), WILD)
        return np.concatenate([np.clip(run, -WILD, WILD), trial.off(z)])

    z = np.zeros(count + len(trial.sheet))
    steps = sum(r.samples for r in recordings) * max(task.step / task.plant.step, 1.0) * (len(z) + 1)
    runs = min(RUNS, int(WORK / steps))
    if not len(z) or not runs:
        return task
    off, own = trial.off(z), np.full(count, LONGEST)
    low, high = np.minimum(-within - off, -DIFFERENCE), np.maximum(within - off, DIFFERENCE)
    bounds = np.r_[-own, low], np.r_[own, high]
    found = least_squares(missed, z, jac=_slopes(missed), bounds=bounds, max_nfev=runs)
    return trial.at(found.x)


def _slopes(missed: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    def slopes(z: np.ndarray) -> np.ndarray:
        at = missed(z)
        return np.stack([(missed(z + DIFFERENCE * row) - at) / DIFFERENCE for row in np.eye(len(z))], axis=1)

    return slopes


def _errors(task: Task, recordings: Sequence[Recording]) -> dict[str, np.ndarray]:
    runs = [task.nominal(r) for r in recordings]
    return {t: np.concatenate([n[t] - r[t] for n, r in zip(runs, recordings, strict=True)]) for t in task.targets}
