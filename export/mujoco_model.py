"""A rig's MuJoCo model as a diagnosis corrects it, and what MJCF has no element for as a callback in Python."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from greygate.errors import InputError
from greygate.mismatch.rig import Rig
from greygate.plants import mjcf
from greygate.plants.expressions import names, parse
from greygate.plants.functions import FUNCTIONS, text
from greygate.plants.plant import Plant

HEAD = '''"""{meaning}

What MJCF has no element for. `install(model)` adds it to every step of MuJoCo:

    import mujoco, {module}
    model = mujoco.MjModel.from_xml_path("{model}")
    {module}.install(model)
"""

import mujoco
import numpy as np

{functions}
JOINTS = {joints}
PARAMETERS = {parameters}


def force(q, v, p):
    """Forces (joints,) of positions, velocities (joints,) and parameters, in N m or N."""
{lines}


def install(model):
    """Let MuJoCo add the forces, in simulations of this model alone."""
    at = [(model.joint(name).qposadr[0], model.joint(name).dofadr[0]) for name in JOINTS]

    def passive(other, data):
        if other.signature != model.signature:
            return
        found = force([data.qpos[q] for q, _ in at], [data.qvel[v] for _, v in at], PARAMETERS)
        for (_, v), added in zip(at, found, strict=True):
            data.qfrc_passive[v] += added

    mujoco.set_mjcb_passive(passive)
'''


@dataclass(frozen=True)
class Corrected:
    """A corrected model. changed: parameter -> (value before, after). added: terms that the Python file has."""

    xml: str
    python: str
    changed: Mapping[str, tuple[float, float]]
    added: tuple[str, ...]


def corrected_model(rig: Rig, plant: Plant, out: Path, meaning: str) -> Corrected:
    """The model of a rig, whose plant a diagnosis corrected, to be written to `out`.

    Raises InputError for an effect with a state of its own, or one that acts elsewhere than on joints.
    """
    before = rig.plant
    values = {s: plant.parameters[s].value for s in before.parameters}
    changed = {s: (p.value, values[s]) for s, p in before.parameters.items() if values[s] != p.value}
    places = [place for place in before.equations if place.startswith("motion_")]
    added = {place: terms for place in places if (terms := _added(plant, place))}
    if more := [s for s in plant.states if s not in before.states]:
        raise InputError(
            f"diagnosis: {', '.join(more)} is a state of an effect, which a callback of MuJoCo has not yet"
        )
    python = _python(before, plant, added, out, meaning) if added else ""
    told = tuple(f"{place}.{term}" for place, terms in added.items() for term in terms)
    return Corrected(mjcf.corrected(before, values), python, changed, told)


def _added(plant: Plant, place: str) -> dict[str, str]:
    """The terms of a balance that the model itself has not: those of effects, and of the rig's plant.toml."""
    own = plant.outside.own if plant.outside else ()
    terms = plant.equations[place].terms.items()
    return {term: text for term, text in terms if f"{place}.{term}" not in own and text not in plant.inputs}


def _python(before: Plant, plant: Plant, added: Mapping[str, Mapping[str, str]], out: Path, meaning: str) -> str:
    joints = [s for s, state in before.states.items() if state.rate]
    used = names(t for terms in added.values() for t in terms.values())
    if outside := [s for s in used if s not in (*plant.parameters, *before.states)]:
        raise InputError(f"diagnosis: a correction uses {', '.join(outside)}, which a callback of MuJoCo does not know")
    lines = [f"    {s} = p[{s!r}]" for s in sorted(used & {*plant.parameters})]
    for i, joint in enumerate(joints):
        lines += [f"    {s} = {a}[{i}]" for s, a in ((joint, "q"), (before.states[joint].rate, "v")) if s in used]
    sums = [
        " + ".join(f"({parse(t).source()})" for t in added.get(f"motion_{j}", {}).values()) or "0.0" for j in joints
    ]
    lines += ["    return [", *(f"        {text}," for text in sums), "    ]"]
    functions = [text(name) for name in FUNCTIONS if name != "when"]
    return HEAD.format(
        meaning=meaning, module=out.stem, model=out.name, functions="\n\n".join(functions),
        joints=mjcf.names_of(before), lines="\n".join(lines),
        parameters={s: plant.parameters[s].value for s in sorted(used & {*plant.parameters})},
    )  # fmt: skip
