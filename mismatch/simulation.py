"""The simulation by the rule of the rigs: with the data sheet, or as a diagnosis corrected it."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from greygate.errors import InputError
from greygate.mismatch import effects as table
from greygate.mismatch.diagnosis import SCHEMA, recovered
from greygate.mismatch.effects import Effect, Free, fitting
from greygate.mismatch.model import Model
from greygate.mismatch.rig import Rig
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
            raise InputError(f"diagnosis: is of {diagnosis['plant']}, the rig is {rig.plant.name}; give the rig's own")
        values = {symbol: float(p["value"]) for symbol, p in diagnosis["parameters"].items()}
        for entry in diagnosis["effects"]:
            if entry["id"] == "unknown":
                unknown = _unknown(rig, entry)
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
    """A diagnosis.json. Raises InputError where it is none."""
    try:
        return json.loads(Path(path).read_text())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a diagnosis.json") from None
    except ValueError as error:
        raise InputError(f"{path}: is no JSON ({error}); give a diagnosis.json") from None


def check(diagnosis) -> None:
    """Raises InputError where `diagnosis` is no content of a diagnosis.json that can be simulated."""

    def number(value) -> bool:
        return type(value) in (int, float) and np.isfinite(value)

    def parameters(where: str, table) -> None:
        if not isinstance(table, dict):
            raise InputError(f"diagnosis: {where} is missing or no table; give a file that diagnose wrote")
        for symbol, p in table.items():
            if not (isinstance(p, dict) and number(p.get("value"))):
                raise InputError(f"diagnosis: {where}.{symbol} has no number as value; give a file that diagnose wrote")

    if not isinstance(diagnosis, dict) or diagnosis.get("schema") != SCHEMA:
        found = diagnosis.get("schema") if isinstance(diagnosis, dict) else diagnosis
        raise InputError(f"diagnosis: schema {found!r}; give a file of schema {SCHEMA}")
    for key, kind in (("plant", str), ("effects", list)):
        if not isinstance(diagnosis.get(key), kind):
            raise InputError(f"diagnosis: {key} is missing or no {kind.__name__}; give a file that diagnose wrote")
    parameters("parameters", diagnosis.get("parameters"))
    for i, entry in enumerate(diagnosis["effects"]):
        if not (isinstance(entry, dict) and isinstance(entry.get("id"), str)):
            raise InputError(f"diagnosis: effects[{i}] has no id; give a file that diagnose wrote")
        parameters(f"effects[{i}].parameters", entry.get("parameters"))
        if entry["id"] == "unknown" and not all({"place", "term"} <= set(p) for p in entry["parameters"].values()):
            raise InputError(f"diagnosis: effects[{i}] is unknown and has no term; give a file that diagnose wrote")


def _form(known: Mapping[str, Effect], entry: Mapping) -> Effect:
    """The effect of that name in the form that the diagnosis chose."""
    forms = [e for e in known.values() if e.id == entry["id"]]
    for effect in forms:
        if effect.key == entry.get("form", entry["id"]):
            return effect
    if not forms:
        raise InputError(f"diagnosis: effect {entry['id']!r} is unknown here; give --effects with the table it is of")
    return forms[0]


def _unknown(rig: Rig, entry: Mapping) -> dict[str, Effect]:
    return {
        symbol: Effect(
            symbol,
            "unknown term",
            (rig.plant.name,),
            tuple(entry["equations"]),
            (),
            (Free(symbol, 1.0, reported=symbol),),
            terms={f"{p['place']}.{symbol}": p["term"]},
            of="unknown",
        )
        for symbol, p in entry["parameters"].items()
    }
