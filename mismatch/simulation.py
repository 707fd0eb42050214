"""The simulation by the comparison rule of the rigs: with the data sheet's values, or as a diagnosis corrects it."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from greygate.errors import InputError, shown
from greygate.mismatch import effects as effect_table
from greygate.mismatch.diagnosis import READ, recovered
from greygate.mismatch.effects import Effect, Free, fitting
from greygate.mismatch.model import Model
from greygate.mismatch.rig import Own, Rig
from greygate.plants.expressions import check_expression, check_name, check_symbol
from greygate.plants.recording import Recording, run_name
from greygate.reading import line, listed, named, number, one_of, read_json, table


def simulate(
    rig: Rig,
    recording: Recording,
    diagnosis: Mapping | None = None,
    effects: Mapping[str, Effect] | None = None,
    name: str | None = None,
) -> dict[str, np.ndarray]:
    """Predicted channels, each (samples,), over `recording`.

    diagnosis: content of a diagnosis.json for this plant; None for the data sheet. name: of the recording of rig.toml
    whose own parameters hold, by default that of its file. What only the recording showed that was explained (its
    samples that are lost, the phase of a line) is left out over another.
    Raises InputError when it is of another plant, or names an effect or parameter that is unknown.
    """
    model, values = corrected(rig, recording, diagnosis, effects, name)
    return dict(zip(rig.predict, model.predict(values).T, strict=True))


def corrected(
    rig: Rig,
    recording: Recording,
    diagnosis: Mapping | None = None,
    effects: Mapping[str, Effect] | None = None,
    name: str | None = None,
) -> tuple[Model, dict[str, float]]:
    """The plant over `recording` with what a diagnosis names, and the values of its parameters. As for `simulate`."""
    name = recording.name if name is None else name
    learnt = name in {run_name(file) for file in rig.identify}
    known_there = rig.own.get(name, Own()).parameters
    rig = rig.of(name)
    diagnosis = None if diagnosis is None else check(diagnosis)
    every = effect_table.named(rig, recording, asked(diagnosis)) if effects is None else effects
    ids = {entry["id"] for entry in diagnosis["effects"]} if diagnosis else set()
    # others would only have to be compiled
    known = {key: effect for key, effect in fitting(rig.plant, rig.datasheet, every).items() if effect.id in ids}
    values: dict[str, float] = {}
    if diagnosis is not None:
        if diagnosis["plant"] != rig.plant.name:
            of = shown(diagnosis["plant"])[1:-1]
            raise InputError(f"diagnosis: is of {of}, the rig is {rig.plant.name}; give the rig's own")
        values = {s: p["value"] for s, p in diagnosis["parameters"].items() if s not in known_there}
        own = diagnosis.get("recordings", {}).get(name, {}).get("parameters", {})
        values |= {symbol: p["value"] for symbol, p in own.items()}
        for entry in diagnosis["effects"]:
            if entry["id"] == "unknown":
                unknown = _unknown(rig, entry)
                if twice := next((key for key in unknown if key in known), None):
                    raise InputError(f"diagnosis: unknown term {twice}: an effect has this name; {WRITTEN}")
                known = {**known, **unknown}
                values.update({s: p["value"] for s, p in entry["parameters"].items()})
            elif (effect := _form(known, entry)) and (learnt or not effect.once):
                values.update(recovered(effect, entry["parameters"]))
    model = Model(rig, recording, known)
    for symbol in values:
        if symbol not in model.values:
            raise InputError(f"diagnosis: parameter {symbol} is unknown to {rig.plant.name}")
    begins = diagnosis.get("begins", {}).get(recording.name, {}) if diagnosis else {}
    own = diagnosis.get("simulation", {}) if diagnosis else {}
    values |= {symbol: value for symbol, value in own.items() if symbol in model.values}
    values |= {key: begins[state] for key, state in model.begins.items() if state in begins}
    return model, {**model.values, **values}


def asked(diagnosis: Mapping | None) -> list[str]:
    """Keys of the effects that a diagnosis names, in the form that it chose."""
    entries = diagnosis["effects"] if diagnosis else []
    return [entry.get("form", entry["id"]) for entry in entries if entry["id"] != "unknown"]


def read(path: Path | str) -> dict:
    """Read a diagnosis.json. Raises InputError where it cannot be simulated."""
    check(found := read_json(path, "give a diagnosis.json"))
    return found


WRITTEN = "give a file that diagnose wrote"
PARAMETERS = named(lambda value, where: table(value, where, {"value": number}, others=True), check_name)
TERM = {"value": number, "place": check_name, "term": check_expression}
UNKNOWN = named(lambda value, where: table(value, where, TERM, {"against": check_name}, others=True), check_symbol)


def _effect(value: object, where: str) -> dict:
    """An effect that a diagnosis claims; one that is called unknown brings its own terms."""
    unknown = isinstance(value, dict) and value.get("id") == "unknown"
    needed = {"id": line, "parameters": UNKNOWN if unknown else PARAMETERS}
    return table(value, where, needed, {"form": line, "equations": listed(line)}, others=True)


HEAD = {"schema": one_of(READ)}
ENTRIES = {"plant": line, "effects": listed(_effect), "parameters": PARAMETERS}
OWN = {
    "recordings": named(lambda value, where: table(value, where, {}, {"parameters": PARAMETERS}, others=True), line),
    "begins": named(named(number, check_name), line),
    "simulation": named(number, check_name),
}


def check(diagnosis: object) -> dict:
    """The part of a diagnosis.json that a simulation needs. Raises InputError where an entry is missing or wrong."""
    try:
        table(diagnosis, "diagnosis:", HEAD, others=True)  # one of another schema may have other entries
        return table(diagnosis, "diagnosis:", ENTRIES, OWN, others=True)
    except InputError as error:
        raise InputError(f"{error}; {WRITTEN}") from None


def _form(known: Mapping[str, Effect], entry: Mapping) -> Effect:
    """The effect of that name in the form that the diagnosis chose."""
    forms = [e for e in known.values() if e.id == entry["id"]]
    for effect in forms:
        if effect.key == entry.get("form", entry["id"]):
            return effect
    if not forms:
        raise InputError(
            f"diagnosis: effect {shown(entry['id'])} is unknown here; give --effects with the table it is of"
        )
    return forms[0]


def _against(symbol: str, parameter: Mapping) -> dict[str, str]:
    """The term of opposite sign, where what is missing acts between two bodies."""
    return {f"{parameter['against']}.{symbol}": f"-1.0 * ({parameter['term']})"} if "against" in parameter else {}


def _unknown(rig: Rig, entry: Mapping) -> dict[str, Effect]:
    return {
        symbol: Effect(
            symbol,
            "unknown term",
            (rig.plant.name,),
            tuple(entry.get("equations", ())),
            (),
            (Free(symbol, 1.0, reported=symbol),),
            terms={f"{p['place']}.{symbol}": p["term"], **_against(symbol, p)},
            of="unknown",
        )
        for symbol, p in entry["parameters"].items()
    }
