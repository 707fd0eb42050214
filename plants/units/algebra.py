"""Units of expressions, by the units that a plant declares: `N s/m` times `m/s` is `N`.

A unit is a product of powers of the symbols in which it is written; symbols are not converted (1 N is not 1 kg m/s^2
here). What has no unit of this kind - a sum of unlike units, a power that varies - has none, which is no error.
"""

import re
from collections.abc import Mapping
from fractions import Fraction

from greygate.errors import InputError
from greygate.plants.expressions import Call, Name, Node, Number, Operation, Signed, parse

Powers = dict[str, Fraction]
"""Symbol -> its power; no symbol has the power 0."""

_TOKEN = re.compile(r"\s*(?:(?P<number>\d+)|(?P<name>[^\W\d]+|%|°\w*)|(?P<sign>[-^*/()]))")
_SAME = ("abs", "min", "max", "when")  # functions whose value has the unit of their last argument


def powers(unit: str) -> Powers | None:
    """The powers in a unit, "m^(5/2)/kg^(1/2)" or "N m s/rad"; None where it is written otherwise."""
    try:
        tokens = _tokens(unit)
        found, rest = _product(tokens)
    except (ValueError, IndexError, ZeroDivisionError):
        return None
    return found if not rest else None


def written(unit: Powers) -> str:
    """A unit as a person writes it: "N s/m", "1/s", "1"."""
    above = [_power(s, p) for s, p in unit.items() if p > 0]
    below = [_power(s, -p) for s, p in unit.items() if p < 0]
    under = f"({' '.join(below)})" if len(below) > 1 else "".join(below)
    return " ".join(above or ["1"]) + (f"/{under}" if below else "")


def times(one: Powers, other: Powers, power: Fraction | int = 1) -> Powers:
    """`one` times `other` to a power."""
    found = {s: one.get(s, Fraction(0)) + power * other.get(s, Fraction(0)) for s in {**one, **other}}
    return {s: p for s, p in found.items() if p}


def of(expression: str, units: Mapping[str, str]) -> Powers | None:
    """The unit of an expression, whose symbols have `units`; None where that cannot be said."""
    known = {symbol: found for symbol, unit in units.items() if (found := powers(unit)) is not None}
    try:
        return _unit(parse(expression).tree, known)
    except InputError:
        return None


def _unit(node: Node, known: Mapping[str, Powers]) -> Powers | None:
    match node:
        case Number():
            return {}
        case Name(symbol):
            return known.get(symbol)
        case Signed(_, inner):
            return _unit(inner, known)
        case Operation("**", base, exponent):
            found, power = _unit(base, known), _number(exponent)
            if not found:
                return found
            return None if power is None else times({}, found, power)
        case Operation(sign, left, right):
            if sign in "+-" and (_zero(left) or _zero(right)):
                return _unit(right if _zero(left) else left, known)
            one, other = _unit(left, known), _unit(right, known)
            if sign in "+-":
                if _number(left) is not None:
                    return other
                return one if one == other or _number(right) is not None else None
            return None if one is None or other is None else times(one, other, 1 if sign == "*" else -1)
        case Call("sqrt", (inner,)):
            found = _unit(inner, known)
            return None if found is None else times({}, found, Fraction(1, 2))
        case Call("orifice", (u, pressure, _)):
            one, other = _unit(u, known), _unit(pressure, known)
            return None if one is None or other is None else times(one, other, Fraction(1, 2))
        case Call(name, arguments) if name in _SAME:
            return _unit(next((a for a in reversed(arguments) if _number(a) is None), arguments[-1]), known)
    return {}


def _zero(node: Node) -> bool:
    """Whether a factor of it is the number 0."""
    match node:
        case Number(value):
            return value == 0
        case Signed(_, inner):
            return _zero(inner)
        case Operation("*", left, right):
            return _zero(left) or _zero(right)
        case Operation("/", left, _):
            return _zero(left)
    return False


def _number(node: Node) -> Fraction | None:
    match node:
        case Number(value):
            return Fraction(value).limit_denominator()
        case Signed(sign, inner):
            found = _number(inner)
            return -found if sign == "-" and found is not None else found
        case Operation("/", left, right):
            one, other = _number(left), _number(right)
            return one / other if one is not None and other else None
    return None


# -- how a unit is written -------------------------------------------------------------------------------------------


def _tokens(unit: str) -> list[str]:
    found, at = [], 0
    text = unit.strip()
    while at < len(text):
        token = _TOKEN.match(text, at)
        if token is None:
            raise ValueError(unit)
        found.append(token[0].strip())
        at = token.end()
    return found


def _product(tokens: list[str]) -> tuple[Powers, list[str]]:
    """(the unit of factors up to a closing bracket or the end, the tokens behind them)."""
    found: Powers = {}
    sign = 1
    while tokens and tokens[0] != ")":
        if tokens[0] in "*/":
            sign, tokens = (-1 if tokens[0] == "/" else 1), tokens[1:]
        factor, tokens = _factor(tokens)
        found, sign = times(found, factor, sign), 1  # a slash counts for the factor behind it
    return found, tokens


def _factor(tokens: list[str]) -> tuple[Powers, list[str]]:
    head, rest = tokens[0], tokens[1:]
    if head == "(":
        inner, rest = _product(rest)
        if rest[0] != ")":
            raise ValueError(head)
        rest = rest[1:]
    elif head == "sqrt":
        inner, rest = _factor(rest)
        inner = times({}, inner, Fraction(1, 2))
    elif head.isdigit():
        if int(head) != 1:
            raise ValueError(head)
        inner = {}
    else:
        inner = {head: Fraction(1)}
    if rest and rest[0] == "^":
        power, rest = _exponent(rest[1:])
        inner = times({}, inner, power)
    return inner, rest


def _exponent(tokens: list[str]) -> tuple[Fraction, list[str]]:
    if tokens[0] == "-":
        power, rest = _exponent(tokens[1:])
        return -power, rest
    if tokens[0] != "(":
        return Fraction(int(tokens[0])), tokens[1:]
    end = tokens.index(")")
    over = "".join(tokens[1:end])
    return Fraction(over), tokens[end + 1 :]


def _power(symbol: str, power: Fraction) -> str:
    if power == 1:
        return symbol
    return f"{symbol}^{power}" if power.denominator == 1 else f"{symbol}^({power})"
