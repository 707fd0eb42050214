"""What resists the motion of a plant, as joint properties of MuJoCo: damping, dry friction, added inertia."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any
from xml.sax.saxutils import quoteattr

from greygate.errors import InputError
from greygate.mismatch.places import is_rate
from greygate.plants.plant import Equation, Plant
from greygate.plants.symbolic import symbolic, sympy_module


@dataclass
class Joint:
    """A degree of freedom, in SI units: of force for a way, of torque for an angle.

    carried: property -> the terms it is made of. left: terms of the same balance that no property of a joint says.
    """

    velocity: str
    name: str
    damping: float = 0.0
    frictionloss: float = 0.0
    armature: float = 0.0
    carried: dict[str, list[str]] = field(default_factory=dict)
    left: list[str] = field(default_factory=list)


def joints(plant: Plant, names: Mapping[str, str], nominal: Plant | None = None) -> list[Joint]:
    """The joints of a plant. names: velocity -> name of the joint's class; all velocities by their own names if empty.

    A term -c v is damping; -f sign(v) or -f tanh(v / w) is dry friction, whatever the width w. nominal: the plant of
    which MuJoCo's model has the inertia already; what the plant has beyond it is added inertia. Needs sympy. Raises
    InputError for a name that is no velocity, and a plant without one.
    """
    moving = {e.state: (place, e) for place, e in plant.equations.items() if is_rate(plant.unit(e.state))}
    if not moving:
        raise InputError(f"plant {plant.name}: no state is a velocity, in m/s or rad/s; there is no joint to describe")
    for v in names:
        if v not in moving:
            raise InputError(f"--joint {v}: is no velocity of plant {plant.name}; it has {', '.join(moving)}")
    return [
        _joint(plant, place, equation, name, nominal)
        for v, name in (names or {v: v for v in moving}).items()
        for place, equation in [moving[v]]
    ]


def _joint(plant: Plant, place: str, equation: Equation, name: str, nominal: Plant | None) -> Joint:
    found = Joint(equation.state, name)
    sympy = sympy_module()
    v, value = sympy.Symbol(equation.state), _numbers(plant)
    for term, text in equation.terms.items():
        for part in sympy.Add.make_args(sympy.expand(value(text))):
            kind, size = _resists(sympy, part, v)
            if kind:
                setattr(found, kind, getattr(found, kind) + size)
                found.carried.setdefault(kind, []).append(term)
            elif term not in found.left:
                found.left.append(term)
    if nominal is not None and not equation.couples:
        more = value(equation.storage) - _numbers(nominal)(nominal.equations[place].storage)
        if more.is_number and more > 0:
            found.armature = float(more)
            found.carried["armature"] = ["storage"]
    return found


def _numbers(plant: Plant) -> Any:
    """A function from the text of an expression to sympy, with definitions inserted and parameters as numbers."""
    sympy = sympy_module()
    known = {sympy.Symbol(s): sympy.Float(p.value) for s, p in plant.parameters.items()}

    def inserted(text: str) -> Any:
        return symbolic(text).subs(known)

    for d in plant.definitions.values():
        known[sympy.Symbol(d.symbol)] = sum((inserted(text) for text in d.terms.values()), start=sympy.Integer(0))
    return inserted


def _resists(sympy: Any, part: Any, v: Any) -> tuple[str, float]:
    """The property that a part of a sum is, and its size; no property if it is none."""
    factor, rest = part.as_independent(v, as_Add=False)
    if not (factor.is_number and factor < 0):
        return "", 0.0
    if rest == v:
        return "damping", -float(factor)
    widths = rest.args[0] / v if rest.func in (sympy.tanh, sympy.sign) else sympy.Integer(0)
    return ("frictionloss", -float(factor)) if widths.is_number and widths > 0 else ("", 0.0)


def mjcf(found: list[Joint], meaning: str) -> str:
    """The text of a file that a model includes; a class for each joint: `<joint class="NAME" .../>`."""
    lines = ["<mujocoinclude>", f"  <!-- {_comment(meaning)}. SI units; an angle counts in radians. -->", "  <default>"]
    for joint in found:
        said = [f"{what}: {', '.join(terms)}" for what, terms in joint.carried.items()]
        said += [f"not here: {', '.join(joint.left)}"] * bool(joint.left)
        sizes = "".join(
            f' {what}="{getattr(joint, what)!r}"'
            for what in ("damping", "frictionloss", "armature")
            if what in joint.carried
        )
        lines += [
            f"    <default class={quoteattr(joint.name)}>",
            f"      <!-- {_comment('; '.join([joint.velocity, *said]))} -->",
            f"      <joint{sizes}/>",
            "    </default>",
        ]
    return "\n".join([*lines, "  </default>", "</mujocoinclude>"]) + "\n"


def _comment(text: str) -> str:
    """Text that ends no comment."""
    return "".join(c if c.isprintable() else "?" for c in text).replace("--", "- -").rstrip("-")
