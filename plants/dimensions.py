"""Whether the terms of a plant's equations have one dimension: N and Pa m^2 do, N and N/m do not."""

from collections.abc import Mapping
from fractions import Fraction
from functools import cache
from math import prod

from greygate.plants import units
from greygate.plants.curves import CURVE
from greygate.plants.expressions import names
from greygate.plants.plant import Plant
from greygate.plants.units.quantities import Quantity, quantity

RATIOS = ("rad", "mrad", "deg", "°", "rev", "turn", "%", "rpm")
"""Units without a dimension, and rotations a minute."""
KNOWN = "m mm cm km µm um kg g s ms min h N kN Pa kPa MPa bar J W kW V mV A mA ohm H mH F µF uF C K Hz kHz T L"
SAME = {"degC": "K", "°C": "K", "Ω": "ohm", "l": "L"}
ROUNDING = 1e-9
Dimension = Mapping[str, float]


def clashes(plant: Plant) -> list[str]:
    """One sentence for each equation or definition in which two terms, or a term and the left side, do not agree.

    A term that is a mere number, or whose unit is not known, is left out, as are those of a measured curve.
    """
    known = {symbol: plant.unit(symbol) for symbol in plant.symbols}
    out = []
    outside = plant.outside.stepped if plant.outside else ()  # what stands on the left there, the simulator knows
    for name, equation in plant.equations.items():
        storage, state = units.of(equation.storage, known), units.powers(plant.unit(equation.state))
        left = (
            None
            if storage is None or state is None or equation.state in outside
            else units.times(units.times(storage, state), {"s": Fraction(1)}, -1)
        )
        out += _clash(name, {"left side": left, **_of_terms(equation.terms, known)})
    for name, definition in plant.definitions.items():
        left = units.powers(definition.unit)
        terms = {term: text for term, text in definition.terms.items() if not CURVE.fullmatch(term)}
        out += _clash(name, {"left side": left, **_of_terms(terms, known)})
    return out


def _of_terms(terms: Mapping[str, str], known: Mapping[str, str]) -> dict[str, units.Powers | None]:
    return {name: units.of(text, known) for name, text in terms.items() if names([text])}


def _clash(name: str, terms: Mapping[str, units.Powers | None]) -> list[str]:
    found = [(t, unit, of) for t, unit in terms.items() if unit is not None and (of := dimension(unit)) is not None]
    for term, unit, of in found[1:]:
        if of != found[0][2]:
            return [f"{name}: {found[0][0]} is in {units.written(found[0][1])}, {term} in {units.written(unit)}"]
    return []


def dimension(unit: units.Powers) -> Dimension | None:
    """The powers of length, mass, time and so on in a unit; None where it holds a symbol that is none of SI's."""
    out: dict[str, float] = {}
    for symbol, power in unit.items():
        of = _of(SAME.get(symbol, symbol))
        if of is None:
            return None
        for name, base in of.items():
            out[name] = out.get(name, 0.0) + float(power) * base
    return {name: power for name, power in out.items() if abs(power) > ROUNDING}


@cache
def _of(symbol: str) -> Dimension | None:
    if symbol not in (*RATIOS, *KNOWN.split()):
        return None
    return {name: float(power) for name, power in quantity(symbol).dimension.items() if name != "rad"}


@cache
def base(unit: str) -> tuple[dict[str, int], float] | None:
    """(powers of SI's base units and of rad, factor) of a unit: 1 of it is so many of them.

    None for one that is not known, that has a broken power, or that has an offset (degC).
    """
    found = units.powers(unit)
    if not found or any(s in SAME and s not in ("Ω", "l") for s in found) or dimension(found) is None:
        return None
    if any(power.denominator != 1 for power in found.values()) or {"%", "°", "rev", "turn", "rpm"} & set(found):
        return None
    made = prod((quantity(SAME.get(s, s)) ** int(power) for s, power in found.items()), start=Quantity())
    return made.dimension, made.value
