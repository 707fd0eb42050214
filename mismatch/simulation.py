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
    known = fitting(rig.plant, rig.datasheet, table.read() if effects is None else effects)
    values: dict[str, float] = {}
    if diagnosis is not None:
        if diagnosis.get("schema") != SCHEMA:
            raise InputError(f"diagnosis: schema {diagnosis.get('schema')!r}; give a file of schema {SCHEMA}")
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


def _form(known: Mapping[str, Effect], entry: Mapping) -> Effect:
    """The effect of that name in the form that the diagnosis chose."""
    forms = [e for e in known.values() if e.id == entry["id"]]
    for effect in forms:
        if effect.key == entry.get("form", entry["id"]):
            return effect
    if not forms:
        raise InputError(f"diagnosis: effect {entry['id']!r} is unknown here; there are {', '.join(known)}")
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
