"""The simulation by the rule of the rigs: with the data sheet, or as a diagnosis corrected it."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from greygate.entries import Entries, read_json, shown
from greygate.errors import InputError
from greygate.mismatch import effects as table
from greygate.mismatch.diagnosis import SCHEMA, recovered
from greygate.mismatch.effects import Effect, Free, fitting
from greygate.mismatch.model import Model
from greygate.mismatch.rig import Rig
from greygate.plants.expressions import is_name, is_symbol, parse
from greygate.plants.recording import Recording


def simulate(
    rig: Rig, recording: Recording, diagnosis: Mapping | None = None, effects: Mapping[str, Effect] | None = None
) -> dict[str, np.ndarray]:
    """Predicted channels, each (samples,), over `recording`.

    diagnosis: content of a diagnosis.json for this plant; None for the data sheet.
    Raises InputError when it is of another plant, or names an effect or parameter that is unknown.
    """
    known = fitting(rig.plant, rig.datasheet, table.known(rig, recording) if effects is None else effects)
    values: dict[str, float] = {}
    if diagnosis is not None:
        check(diagnosis)
        if diagnosis["plant"] != rig.plant.name:
            of = shown(diagnosis["plant"])[1:-1]
            raise InputError(f"diagnosis: is of {of}, the rig is {rig.plant.name}; give the rig's own")
        values = {symbol: float(p["value"]) for symbol, p in diagnosis["parameters"].items()}
        for entry in diagnosis["effects"]:
            if entry["id"] == "unknown":
                unknown = _unknown(rig, entry)
                if twice := next((key for key in unknown if key in known), None):
                    raise InputError(f"diagnosis: unknown term {twice}: an effect has this name; {WRITTEN}")
                known = {**known, **unknown}
                values.update({s: float(p["value"]) for s, p in entry["parameters"].items()})
            else:
                values.update(recovered(_form(known, entry), entry["parameters"]))
    model = Model(rig, recording, known)
    for symbol in values:
        if symbol not in model.values:
            raise InputError(f"diagnosis: parameter {symbol} is unknown to {rig.plant.name}")
    predicted = model.predict({**model.values, **values})
    return dict(zip(rig.predict, predicted.T, strict=True))


def read(path: Path | str) -> dict:
    """A diagnosis.json. Raises InputError where it is none that can be simulated."""
    check(found := read_json(path, "give a diagnosis.json"))
    return found


WRITTEN = "give a file that diagnose wrote"


def check(diagnosis) -> None:
    """Raises InputError where `diagnosis` is no content of a diagnosis.json that can be simulated."""
    entries = Entries("diagnosis")

    def parameters(where: str, table) -> None:
        if not isinstance(table, dict):
            raise InputError(f"diagnosis: {where} is missing or no table; {WRITTEN}")
        for symbol, p in table.items():
            if not is_name(symbol):
                entries.fail(where, f"{shown(symbol)} is no name of a parameter; {WRITTEN}")
            if not isinstance(p, dict) or "value" not in p:
                raise InputError(f"diagnosis: {where}.{symbol} has no number as value; {WRITTEN}")
            entries.number(f"{where}.{symbol} has no number as value", p["value"], wish=WRITTEN)

    if not isinstance(diagnosis, dict) or diagnosis.get("schema") != SCHEMA:
        found = diagnosis.get("schema") if isinstance(diagnosis, dict) else diagnosis
        raise InputError(f"diagnosis: schema {shown(found)}; give a file of schema {SCHEMA}")
    for key, kind in (("plant", str), ("effects", list)):
        if not isinstance(diagnosis.get(key), kind):
            raise InputError(f"diagnosis: {key} is missing or no {kind.__name__}; {WRITTEN}")
    parameters("parameters", diagnosis.get("parameters"))
    for i, entry in enumerate(diagnosis["effects"]):
        here = f"effects[{i}]"
        if not (isinstance(entry, dict) and isinstance(entry.get("id"), str)):
            raise InputError(f"diagnosis: {here} has no id; {WRITTEN}")
        entries.text(f"{here}.form", entry.get("form", ""))
        entries.texts(f"{here}.equations", entry.get("equations", ()))
        parameters(f"{here}.parameters", entry.get("parameters"))
        for symbol, p in entry["parameters"].items() if entry["id"] == "unknown" else ():
            if not {"place", "term"} <= set(p):
                raise InputError(f"diagnosis: {here} is unknown and has no term; {WRITTEN}")
            if not is_symbol(symbol) or not is_name(p["place"]):
                entries.fail(f"{here}.parameters.{symbol}", f"place {shown(p['place'])} is no name; {WRITTEN}")
            try:
                parse(p["term"])
            except InputError as error:
                entries.fail(f"{here}.parameters.{symbol}, term", str(error))


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


def _unknown(rig: Rig, entry: Mapping) -> dict[str, Effect]:
    return {
        symbol: Effect(
            symbol,
            "unknown term",
            (rig.plant.name,),
            tuple(entry.get("equations", ())),
            (),
            (Free(symbol, 1.0, reported=symbol),),
            terms={f"{p['place']}.{symbol}": p["term"]},
            of="unknown",
        )
        for symbol, p in entry["parameters"].items()
    }
