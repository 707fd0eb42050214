"""What a diagnosis makes of a plant before a network is built: corrected values, the terms of each named effect."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from greygate.errors import InputError
from greygate.identify.expert.acting import Filter, unbuilt
from greygate.identify.expert.task import Task
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.diagnosis import Diagnosis
from greygate.mismatch.effects import known
from greygate.mismatch.entries import SENSOR, TIME, Effect, fitting
from greygate.mismatch.given import rig_of
from greygate.mismatch.joining import begun, join
from greygate.mismatch.model import Model
from greygate.mismatch.rig import LINEAR, Rig
from greygate.mismatch.simulation import corrected
from greygate.plants.plant import Parameter, Plant
from greygate.plants.recording import Recording
from greygate.progress import Budget, Progress, silent

READS = "reads"  # entry of a diagnosis that was made for a network: what that network reads


@dataclass(frozen=True)
class Corrected:
    """plant: with the diagnosed values and terms. filters, readings: as for `Task`.

    said: (place, what became of it, why) of every effect. left: effects of which no module is made. own: parameter of
    an effect -> the name of its term. knees: parameter that shapes an effect -> the upper end of its interval.
    """

    plant: Plant
    filters: Mapping[str, Sequence[Filter]] = field(default_factory=dict)
    readings: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    said: Sequence[tuple[str, str, str]] = ()
    left: Sequence[str] = ()
    own: Mapping[str, str] = field(default_factory=dict)
    knees: Mapping[str, float] = field(default_factory=dict)


def rig_for(task: Task, recordings: Sequence[Recording], held: Sequence[Recording] = ()) -> Rig:
    """The rig of what a network is to compute, driven by what the network reads. held: for the report alone.

    Every output on record says what is missing. What a rig's file says of its channels holds here too, and so do the
    effects beside it.
    """
    kept, every = task.reduced.symbols, (*recordings, *held)
    outputs = [n for n in task.plant.outputs if n in kept and all(n in r.channels for r in every)]
    channels = list(dict.fromkeys((*task.inputs, *task.targets, *outputs)))
    runs, others = ([only(r, channels) for r in each] for each in (recordings, held))
    rig = _beside(task, rig_of(task.reduced, runs, holdout=others or None))
    told = {n: c for n, c in task.rig.channels.items() if n in channels} if task.rig else {}
    known = {n: replace(c, role=rig.channels[n].role) for n, c in {**rig.channels, **told}.items()}
    straight = {n: replace(c, hold=LINEAR) for n, c in known.items() if n in task.measured}
    return replace(rig, channels={**known, **straight})


def _beside(task: Task, rig: Rig) -> Rig:
    """The rig as the task's settles, with the effects that stand in its folder, and none of the recordings there."""
    if task.rig is None:
        return rig
    held = tuple(name for name in rig.holdout if name in rig.given)
    return replace(rig, folder=task.rig.folder, holdout=held, settle=task.rig.settle)


def only(recording: Recording, channels: Sequence[str]) -> Recording:
    """A recording's channels of those names."""
    return Recording(recording.dt, {n: recording[n] for n in channels}, {n: recording.units[n] for n in channels},
                     recording.source)  # fmt: skip


def asked(
    task: Task, recordings: Sequence[Recording], budget: Budget, progress: Progress = silent,
    held: Sequence[Recording] = (),
) -> tuple[Diagnosis, dict]:  # fmt: skip
    """The diagnosis of what a network is to compute, and what is kept of it.

    budget: after it no further hypothesis is tried. held: recordings that it is only reported on: they judge the
    network.
    """
    rig = rig_for(task, recordings, held)
    found = diagnose(rig, effects=_with_a_place(rig), progress=progress, budget=budget, unseen=True)
    return found, found.as_dict() | {READS: list(task.inputs)}


def _with_a_place(rig: Rig) -> dict[str, Effect]:
    """The effects that may enter the plant of a rig: where a signal is measured, some of its equations are gone."""
    found = {}
    for key, effect in fitting(rig.plant, rig.datasheet, known(rig, rig.to_explain())).items():
        try:
            join(rig.plant, [effect])
        except InputError:
            continue
        found[key] = effect
    return found


def correct(task: Task, recordings: Sequence[Recording], diagnosis: Mapping) -> Corrected:
    """The plant as a diagnosis corrects it: of what the network computes, or of the whole plant.

    Raises InputError as `simulate` for a diagnosis of another plant.
    """
    if diagnosis.get(READS) == list(task.inputs):
        rig = rig_for(task, recordings)
    else:
        known = [n for n in recordings[0].channels if n in task.plant.symbols]
        rig = _beside(task, rig_of(task.plant, [only(r, known) for r in recordings]))
    model, values = corrected(rig, rig.to_explain().runs[0], diagnosis)
    return _joined(rig, model, values, diagnosis)


def _joined(rig: Rig, model: Model, values: Mapping[str, float], diagnosis: Mapping) -> Corrected:
    plant, said = rig.plant, []
    filters: dict[str, list[Filter]] = {}
    readings: dict[str, dict[str, str]] = {}
    sure = {s: p for s, p in diagnosis["parameters"].items()}
    for entry in diagnosis["effects"]:
        sure |= entry["parameters"]
    acting = {key: e for key, e in model.effects.items() if any(values.get(f.symbol) for f in e.strengths)}
    left = {key: why for key, e in acting.items() if (why := _unbuilt(e, values, model))}
    for key, effect in acting.items():
        where = ", ".join(effect.equations)
        said.append(
            (
                where,
                f"{effect.means} left out" if key in left else effect.means,
                left.get(key) or _sized(effect, values),
            )
        )
    built = [e for key, e in acting.items() if key not in left]
    for effect in built:
        for name, text in effect.filters.items():
            kind, *symbols = text.split()
            filters.setdefault(name, []).append((kind, tuple(values[s] for s in symbols)))
        for path, text in effect.terms.items():
            where, _, term = path.partition(".")
            if where.startswith(SENSOR):
                readings.setdefault(where.removeprefix(SENSOR), {})[f"{effect.key}_{term}"] = text
        plant = _with(plant, effect, values)
    plant = replace(plant, parameters={s: _known(s, p, values, sure) for s, p in plant.parameters.items()})
    own = {f.symbol: e.key for e in built for f in e.free if e.terms and e.id != "unknown"}
    shaped = [f.symbol for e in built for f in e.free if f.symbol in own and f.shape]
    knees = {s: p.value + p.reach for s, p in plant.parameters.items() if s in shaped}
    return Corrected(plant, filters, readings, said, [*left], own, knees)


def _with(plant: Plant, effect: Effect, values: Mapping[str, float]) -> Plant:
    """The plant with an effect's parameters, states, definitions, storages and terms."""
    brought = {} if effect.frees else {f.symbol: Parameter(values[f.symbol], f.unit) for f in effect.free}
    plant = replace(
        plant,
        parameters={**plant.parameters, **brought},
        states={**plant.states, **effect.states},
        equations={**plant.equations, **effect.equations_of},
        definitions={**effect.definitions, **plant.definitions},
    )
    plant = begun(plant, [effect])
    heavier = {where: plant.equations[where].storing(text) for where, text in effect.storages.items()}
    plant = replace(plant, equations={**plant.equations, **heavier})
    for path, text in effect.terms.items():
        where, _, term = path.partition(".")
        if not where.startswith(SENSOR):
            plant = plant.with_term(where, term if effect.id == "unknown" else effect.key, text)
    return plant


def _known(symbol: str, parameter: Parameter, values: Mapping[str, float], sure: Mapping) -> Parameter:
    """A parameter with its diagnosed value, as sure as the diagnosis is of it."""
    value = values.get(symbol, parameter.value)
    ends = sure.get(symbol, {}).get("ci95")
    if not ends or None in ends or not value:
        return replace(parameter, value=value)
    return replace(parameter, value=value, tolerance=abs(ends[1] - ends[0]) / 2 / abs(value), plus_minus=0.0)


def _unbuilt(effect: Effect, values: Mapping[str, float], model: Model) -> str:
    """Why a network has no module for an effect; empty where it has."""
    if effect.uses(TIME):
        return "it goes with the time, and a network has no clock"
    for name, text in effect.filters.items():
        kind, *symbols = text.split()
        if name.startswith(SENSOR):
            return "it is the sensor's, and the network gives what the sensor is shown"
        if any(how.partition(" ")[2] == name for how in model.rig.plant.derived.values()):
            return f"{name} is measured, and the network reads its rate too"
        if why := unbuilt(kind, [values[s] for s in symbols], model.rig.dt):
            return why
    return ""


def _sized(effect: Effect, values: Mapping[str, float]) -> str:
    return "the diagnosis names it: " + ", ".join(
        f"{f.symbol} = {values[f.symbol]:.4g} {f.unit}".strip() for f in effect.free
    )
