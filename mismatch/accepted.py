"""A formula that a diagnosis found, as an effect of the rig's own table, tried and named like any other."""

import json
from collections.abc import Mapping
from itertools import count
from pathlib import Path

from greygate.errors import InputError
from greygate.files import replacing
from greygate.mismatch.effects import read
from greygate.plants.expressions import replaced

TABLE = "effects.toml"
UNKNOWN = "unknown_"  # before the symbols of a term without a name


def accept(folder: Path, found: Mapping) -> str:
    """Put what the diagnosis `found` says as a formula into the table of the rig in `folder`; a line that says so.

    Raises InputError where it says none, or where the table cannot be read.
    """
    place = next((where for where in found["where"] if "formula" in where), None)
    unknown = next((effect for effect in found["effects"] if effect["id"] == "unknown"), None)
    if place is None or unknown is None:
        raise InputError(f"{folder}: the diagnosis found no formula ({found['verdict']}): nothing was accepted")
    path = folder / TABLE
    known, before = (read(path), path.read_text(encoding="utf-8")) if path.exists() else ({}, "")
    key = next(name for n in count(1) if (name := f"own_{place['equation']}{f'_{n}' * (n > 1)}") not in known)
    with replacing(path) as temporary:
        entry = _entry(key, found["plant"], place, unknown)
        temporary.write_text(f"{before}\n{entry}" if before else entry, encoding="utf-8", newline="\n")
    return f"{path} has the effect {key} now: {place['formula']}"


def _entry(key: str, plant: str, place: Mapping, unknown: Mapping) -> str:
    """The effect in TOML; texts in JSON are texts in TOML."""
    new = {symbol: f"{key}_{symbol.removeprefix(UNKNOWN)}" for symbol in unknown["parameters"]}
    lines = [
        f"[{key}]",
        f"means = {json.dumps(place['formula'])}",
        f"plants = {json.dumps([plant])}",
        f"equations = {json.dumps(unknown['equations'])}",
        f"depends_on = {json.dumps(place['depends_on'])}",
    ]
    for symbol, p in unknown["parameters"].items():
        lines.append(f"parameters.{new[symbol]} = {{ unit = {json.dumps(p['unit'])}, typical = {abs(p['value'])!r} }}")
        term = replaced(p["term"], new)
        lines.append(f'terms."{p["place"]}.{new[symbol]}" = {json.dumps(term)}')
        if "against" in p:
            lines.append(f'terms."{p["against"]}.{new[symbol]}" = {json.dumps(f"-1.0 * ({term})")}')
    return "\n".join([*lines, ""])
