"""A plant as the TOML file that `Plant.read` reads."""

from collections.abc import Mapping
from dataclasses import asdict

import tomli_w

from greygate.plants.plant import Parameter, Plant

NO_UNIT = "1"


def text(plant: Plant, remarks: str = "") -> str:
    """The file. remarks: lines of comment at its top."""
    head = "".join(f"# {line}\n" for line in remarks.splitlines())
    return head + tomli_w.dumps(entries(plant))


def entries(plant: Plant) -> dict:
    """The entries of the file; those that are empty are left out. An uncertainty in a unit becomes a relative one."""
    found = {
        "step": plant.step,
        "outputs": [*plant.outputs],
        **({"required": [*plant.required]} if plant.required else {}),
        **{key: dict(getattr(plant, key)) for key in ("inputs", "derived", "switches", "experiments")},
        "parameters": {s: _parameter(p) for s, p in plant.parameters.items()},
        "states": {s: _filled(vars(state)) for s, state in plant.states.items()},
        "definitions": {n: {d.symbol: {"unit": d.unit, **d.terms}} for n, d in plant.definitions.items()},
        "equations": {
            n: {e.state: {"storage": e.storage, **_filled({"couples": dict(e.couples)}), **e.terms}}
            for n, e in plant.equations.items()
        },
        "closure": _filled(asdict(plant.closure)),
    }
    return _filled(found)


def _filled(found: Mapping) -> dict:
    """Without what is empty, at any depth."""
    kept = {key: _filled(value) if isinstance(value, Mapping) else value for key, value in found.items()}
    return {key: value for key, value in kept.items() if value is not None and value not in ({}, "")}


def _parameter(p: Parameter) -> list:
    known = [p.value, p.unit or NO_UNIT]
    share = p.plus_minus / abs(p.value) if p.plus_minus and p.value else p.tolerance
    return [*known, share, p.meaning] if p.meaning else [*known, share] if share else known
