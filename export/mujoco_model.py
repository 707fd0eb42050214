"""A rig's MuJoCo model as a diagnosis corrects it, and what MJCF has no element for as a callback in Python."""

from collections.abc import Iterable, Mapping, Sequence
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


def force(q, v, p, x=()):
    """Forces (joints,) of positions, velocities (joints,), parameters and own states, in N m or N."""
{lines}
{states}

def install(model):
    """Let MuJoCo add the forces, in simulations of this model alone."""
    at = [(model.joint(name).qposadr[0], model.joint(name).dofadr[0]) for name in JOINTS]
{kept}
    def passive(other, data):
        if other.signature != model.signature:
            return
        q, v = [data.qpos[q] for q, _ in at], [data.qvel[v] for _, v in at]
{moved}        for (_, j), added in zip(at, force(q, v, PARAMETERS{own}), strict=True):
            data.qfrc_passive[j] += added

    mujoco.set_mjcb_passive(passive)
'''
STATES = '''

def begin(q, v, p):
    """Own states (states,) where a simulation begins."""
{start}


def rates(q, v, p, x):
    """Their rates (states,)."""
{rate}

'''
KEPT = "    last = {}  # of a simulation: its time, and its own states then\n"
MOVED = """\
        before, x = last.get(id(data), (data.time, None))
        if x is None or data.time < before:
            x = begin(q, v, PARAMETERS)
        elif data.time > before:
            step = data.time - before
            x = [own + step * rate for own, rate in zip(x, rates(q, v, PARAMETERS, x), strict=True)]
        last[id(data)] = data.time, x
"""


@dataclass(frozen=True)
class Corrected:
    """A corrected model. changed: parameter -> (value before, after). added: terms that the Python file has."""

    xml: str
    python: str
    changed: Mapping[str, tuple[float, float]]
    added: tuple[str, ...]


def corrected_model(rig: Rig, plant: Plant, out: Path, meaning: str) -> Corrected:
    """The model of a rig, whose plant a diagnosis corrected, to be written to `out`.

    Raises InputError for an effect that acts elsewhere than on joints.
    """
    before = rig.plant
    values = {s: plant.parameters[s].value for s in before.parameters}
    changed = {s: (p.value, values[s]) for s, p in before.parameters.items() if values[s] != p.value}
    places = [place for place in before.equations if place.startswith("motion_")]
    added = {place: terms for place in places if (terms := _added(plant, place))}
    python = _python(before, plant, added, out, meaning) if added else ""
    told = tuple(f"{place}.{term}" for place, terms in added.items() for term in terms)
    return Corrected(mjcf.corrected(before, values), python, changed, told)


def _added(plant: Plant, place: str) -> dict[str, str]:
    """The terms of a balance that the model itself has not: those of effects, and of the rig's plant.toml."""
    own = plant.outside.own if plant.outside else ()
    terms = plant.equations[place].terms.items()
    return {term: text for term, text in terms if f"{place}.{term}" not in own and term != mjcf.APPLIED}


def _python(before: Plant, plant: Plant, added: Mapping[str, Mapping[str, str]], out: Path, meaning: str) -> str:
    joints = [s for s, state in before.states.items() if state.rate]
    own = [s for s in plant.states if s not in before.states]
    balances = {e.state: e for e in plant.equations.values()}
    sums = [_sum(added.get(f"motion_{j}", {}).values()) for j in joints]
    starts = [_start(plant, s) for s in own]
    moves = [f"({_sum(balances[s].terms.values())}) / ({balances[s].storage})" for s in own]
    texts = [*sums, *starts, *moves]
    used = names(texts)
    if outside := [s for s in used if s not in (*plant.parameters, *before.states, *own)]:
        raise InputError(f"diagnosis: a correction uses {', '.join(outside)}, which a callback of MuJoCo does not know")

    def body(found: list[str], of: Sequence[str]) -> str:
        """Lines that give the values of these expressions. of: the own states that are known."""
        known = names(found)
        lines = [f"    {s} = p[{s!r}]" for s in sorted(known & {*plant.parameters})]
        for i, joint in enumerate(joints):
            pair = ((joint, "q"), (before.states[joint].rate, "v"))
            lines += [f"    {s} = {a}[{i}]" for s, a in pair if s in known]
        lines += [f"    {s} = x[{i}]" for i, s in enumerate(of) if s in known]
        return "\n".join([*lines, "    return [", *(f"        {parse(text).source()}," for text in found), "    ]"])

    functions = [found for name in FUNCTIONS if name != "when" and (found := text(name))]
    return HEAD.format(
        meaning=meaning, module=out.stem, model=out.name, functions="\n\n".join(functions),
        joints=mjcf.names_of(before), lines=body(sums, own),
        states=STATES.format(start=body(starts, []), rate=body(moves, own)) if own else "",
        kept=KEPT if own else "", moved=MOVED if own else "", own=", x" if own else "",
        parameters={s: plant.parameters[s].value for s in sorted(used & {*plant.parameters})},
    )  # fmt: skip


def _sum(terms: Iterable[str]) -> str:
    return " + ".join(f"({text})" for text in terms) or "0.0"


def _start(plant: Plant, symbol: str) -> str:
    """Where a state of an effect begins."""
    state = plant.states[symbol]
    return str(state.initial if state.start is None else state.start)
