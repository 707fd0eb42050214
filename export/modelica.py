"""A plant as a Modelica model: its equations term by term, with names, units and meanings."""

import re
from collections.abc import Iterator, Mapping

from greygate.plants.expressions import Call, Name, Node, Number, Operation, Signed, parse
from greygate.plants.plant import Plant
from greygate.plants.simulator import coupled

# Words of the language, and functions that an equation here may call.
WORDS = """algorithm annotation assert block break class connect connector constant constrainedby der discrete each else
elseif elsewhen encapsulated end enumeration equation expandable extends external final flow function if import impure
in initial inner input loop model operator outer output package parameter partial protected public pure record redeclare
replaceable return stream then time type when within true false Real Integer Boolean String abs sign sqrt sin cos tan
atan atan2 tanh exp log min max pre reinit noEvent mod div"""
RESERVED = frozenset(re.findall(r"\w+", WORDS))

_FACTOR = r"[A-Za-z]+(?:-?\d+)?"
_FACTORS = rf"{_FACTOR}(?:\.{_FACTOR})*"
NOTATION = re.compile(rf"(?:1|{_FACTORS})(?:/(?:{_FACTOR}|\({_FACTORS}\)))?")


def modelica(plant: Plant, meaning: str) -> str:
    """The text of a model with the plant's name, inputs, parameters and outputs; other quantities are variables of it.

    meaning: one line that a tool shows. A state at its bound stays there, and its velocity is set to 0, as in
    `plants.simulate`. Units are in Modelica's notation.
    """
    return "\n".join(_model(plant, meaning)) + "\n"


def _model(plant: Plant, meaning: str) -> Iterator[str]:
    yield f"model {symbol(plant.name)} {_text(meaning)}"
    for s, p in plant.parameters.items():
        yield _variable("parameter ", s, p.unit, value=f" = {_number(p.value)}", meaning=p.meaning)
    for s, unit in plant.inputs.items():
        yield _variable("input ", s, unit, meaning=plant.derived.get(s, ""))
    for s, state in plant.states.items():
        start = expression(state.initial) if isinstance(state.initial, str) else _number(state.initial)
        yield _variable(_output(plant, s), s, state.unit, f"start = {start}", "fixed = true")
    for d in plant.definitions.values():
        yield _variable(_output(plant, d.symbol), d.symbol, d.unit)
    bounded = _bounded(plant)
    for s in bounded:
        yield f"  Real {rate_of(s)} {_text(f'rate of {s} away from its bounds')};"
    yield "equation"
    for name, d in plant.definitions.items():
        yield from _equation(name, symbol(d.symbol), d.terms)
    rates = {s: rate_of(s) if s in bounded else f"der({symbol(s)})" for s in plant.states}
    for group in coupled(plant):
        names = {e.state: name for name, e in plant.equations.items()}
        for e in group:
            of = {e.state: e.storage, **e.couples}
            left = " + ".join(
                rates[s] if storage == "1" else f"{expression(storage)} * {rates[s]}" for s, storage in of.items()
            )
            yield from _equation(names[e.state], left, e.terms)
    for s, (held, holds) in bounded.items():
        yield f"  der({symbol(s)}) = noEvent(if {holds} then 0.0 else {rate_of(s)}) {_text(f'held where {held} ends')};"
    yield from _stops(plant)
    yield f"end {symbol(plant.name)};"


def _bounded(plant: Plant) -> dict[str, tuple[str, str]]:
    """State whose rate is held at a bound -> the state that has the bound, and the condition."""
    found = {}
    for s, state in plant.states.items():
        moved = state.rate or s
        ends = [
            f"({symbol(s)} {sign} {_bound(bound)} and {rate_of(moved)} {outward} 0.0)"
            for bound, sign, outward in ((state.low, "<=", "<"), (state.high, ">=", ">"))
            if bound is not None
        ]
        if ends:
            found[moved] = (s, " or ".join(ends))
    return found


def _stops(plant: Plant) -> Iterator[str]:
    """What moves outward at a bound stands still from then on."""
    for s, state in plant.states.items():
        ends = [(bound, sign, keeps) for bound, sign, keeps in ((state.low, "<=", "max"), (state.high, ">=", "min"))
                if bound is not None and state.rate is not None]  # fmt: skip
        v = symbol(state.rate or "")
        for n, (bound, sign, keeps) in enumerate(ends):
            yield f"  {'elsewhen' if n else 'when'} {symbol(s)} {sign} {_bound(bound)} then"
            yield f"    reinit({v}, {keeps}(pre({v}), 0.0));"
        if ends:
            yield "  end when;"


def _equation(name: str, left: str, terms: Mapping[str, str]) -> Iterator[str]:
    yield f"  // {name}"
    said = [f"    {'+ ' if n else ''}{expression(text)} // {term}" for n, (term, text) in enumerate(terms.items())]
    yield from (f"  {left} =", *(said or ["    0.0"]), "  ;")


def symbol(name: str) -> str:
    """The name, in quotes where it is a word of Modelica."""
    return f"'{name}'" if name in RESERVED else name


def rate_of(state: str) -> str:
    """The variable that holds the rate of a state before its bounds are heeded."""
    return f"'rate of {state}'"


def expression(text: str) -> str:
    """An expression in Modelica."""
    return _written(parse(text).tree)


def _written(node: Node) -> str:
    match node:
        case Number(value):
            return _number(value)
        case Name(name):
            return symbol(name)
        case Signed(sign, inner):
            return f"({sign}{_written(inner)})"
        case Operation("**", base, Number(int(power))):
            return f"({_written(base)} ^ {power})"
        case Operation(sign, left, right):
            return f"({_written(left)} {'^' if sign == '**' else sign} {_written(right)})"
        case Call("when", (condition, value)):
            return f"noEvent(if abs({_written(condition)}) > 0.0 then {_written(value)} else 0.0)"
        case Call("smooth_step", (x, width)):
            return f"(0.5 + 0.5 * tanh({_written(x)} / {_written(width)}))"
        case Call("orifice", given):
            u, p, q = map(_written, given)
            return f"(max({u}, 0.0) * sign({p} - {q}) * sqrt(abs({p} - {q})))"
        case Call(function, given):
            return f"{function}({', '.join(map(_written, given))})"
    raise AssertionError(node)


def _number(value: float) -> str:
    return repr(float(value))


def _bound(bound: float | str) -> str:
    return expression(bound) if isinstance(bound, str) else f"({_number(bound)})"


def _output(plant: Plant, name: str) -> str:
    return "output " * (name in plant.outputs)


def _text(words: str) -> str:
    kept = "".join(c if c.isprintable() else "?" for c in words)
    return '"' + kept.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _variable(kind: str, name: str, unit: str, *attributes: str, value: str = "", meaning: str = "") -> str:
    """A declaration. A unit that Modelica has no notation for stands in the text."""
    noted = _unit(unit)
    given = ", ".join([*([f"unit = {_text(noted)}"] if noted else []), *attributes])
    told = ", ".join(part for part in (meaning, "" if noted else f"in {unit}") if part)
    return f"  {kind}Real {symbol(name)}{f'({given})' if given else ''}{value}{f' {_text(told)}' if told else ''};"


def _unit(unit: str) -> str | None:
    """The unit in Modelica's notation: a dot multiplies, a number after a letter is a power. None if it has none."""
    plain = unit.replace("µ", "u").replace("°C", "degC").replace("°", "deg").replace("%", "1").replace("**", "^")
    plain = (
        re.sub(r"\s*/\s*", "/", re.sub(r"\s*[*·⋅]\s*|\s+", ".", plain.strip())).replace("./", "/").replace("/.", "/")
    )
    plain = re.sub(r"\^(-?\d+)", r"\1", plain)
    first, *under = plain.split("/")
    if len(under) > 1:
        plain = f"{first}/({'.'.join(part.strip('()') for part in under)})"
    return plain if NOTATION.fullmatch(plain) else None
