"""Headers such as "p_a [bar]", and what becomes of a unit: one of the house's stays, any other is converted to SI."""

import re
from functools import cache
from typing import Any

import numpy as np

from greygate.errors import InputError, shown
from greygate.plants.recording import UNITS

PLAIN = {  # suffix of a name, `n_rpm` -> unit as pint has it
    "rpm": "rpm", "deg": "deg", "deg_s": "deg/s", "mrad": "mrad", "degC": "degC", "mm": "mm", "cm": "cm", "um": "um",
    "km": "km", "mm_s": "mm/s", "km_h": "km/h", "kN": "kN", "mN": "mN", "kPa": "kPa", "MPa": "MPa", "hPa": "hPa",
    "mbar": "mbar", "psi": "psi", "mV": "mV", "kV": "kV", "mA": "mA", "kW": "kW",
    "kHz": "kHz", "L_min": "L/min", "l_min": "L/min", "mm2": "mm^2",
    "pct": "percent", "percent": "percent", "mNm": "mN m", "kNm": "kN m",
}  # fmt: skip
AMBIGUOUS = {
    "g": "a gram or the acceleration of free fall; write gram or g_0",
    "C": "coulomb or degree Celsius; write coulomb or degC",
    "F": "farad or degree Fahrenheit; write farad or degF",
    "barg": "a gauge pressure, which has no fixed zero; add the ambient pressure and write bar",
    "bar(g)": "a gauge pressure, which has no fixed zero; add the ambient pressure and write bar",
    "psig": "a gauge pressure, which has no fixed zero; add the ambient pressure and write psi",
    "dB": "a logarithm of a ratio; convert it to the quantity itself",
    "M": "molar or a million; write what is meant",
    "h": "an hour or Planck's constant; write hour",
    "d": "a day or a deciunit; write day",
    "t": "a ton or a time; write tonne, or rename the column",
    "l": "a litre or a length; write L or m",
    "MIN": "minutes or a minimum; write min",
    "U/min": "revolutions a minute in German; write rpm",
}
SPELT = {
    "°": "deg", "°C": "degC", "℃": "degC", "°F": "degF", "º": "deg", "ºC": "degC", "Ω": "ohm", "Ohm": "ohm",
    "%": "percent", "Nm": "N m", "kNm": "kN m", "mNm": "mN m", "Ncm": "N cm", "counts": "count", "raw": "count",
    "ticks": "tick", "-": "1", "": "1", "none": "1", "rev/min": "rpm", "1/min": "rpm", "min-1": "rpm", "min^-1": "rpm",
    "1/s": "Hz", "l/min": "L/min", "lpm": "L/min", "sec": "s", "seconds": "s", "Volt": "V", "Volts": "V", "Amp": "A",
    "celsius": "degC", "Celsius": "degC", "m/s2": "m/s^2", "m/s/s": "m/s^2", "rad/s2": "rad/s^2", "m/s²": "m/s^2",
    "rad/s²": "rad/s^2", "m²": "m^2", "m³": "m^3", "m³/s": "m^3/s", "m3/s": "m^3/s", "m³/h": "m^3/hour",
    "m3/h": "m^3/hour", "mm²": "mm^2", "km/h": "km/hour", "kWh": "kW hour",
}  # fmt: skip
"""Ways to write a unit -> pint's."""
WRITTEN = frozenset({u for u in (*UNITS.values(), *PLAIN.values(), *SPELT) if re.search(r"[/^%°²³]", u)})
"""Units with a sign, which no name has: `speed_rad/s`."""
SI = (
    "1", "m", "s", "kg", "A", "K", "rad", "N", "Pa", "J", "W", "V", "coulomb", "farad", "ohm", "H", "T", "Hz", "m/s",
    "m/s^2", "m^2", "m^3", "m^3/s", "kg/s", "N/m", "N s/m", "kg m^2", "kg/m^3", "Pa s",
)  # fmt: skip
TURNING = re.compile(r"rpm|rev|turn|deg|rad|arc")
_BRACKETS = re.compile(
    r"\s*(?P<name>.*?)\s*(?:\[(?P<a>[^\[\]]*)\]|\((?P<b>[^()]*(?:\([^()]*\))?)\)|\{(?P<c>[^{}]*)\})\s*"
)
_SLASH = re.compile(r"\s*(?P<name>[^/]+?)\s+/\s+(?P<unit>\S.*?)\s*")
_IN = re.compile(r"\s*(?P<name>\S.*?)\s+in\s+(?P<unit>\S+)\s*")
_COMMA = re.compile(r"\s*(?P<name>[^,:;]+?)\s*[,:;]\s*(?P<unit>[^,:;]+?)\s*")


def split(header: str, where: str) -> tuple[str, str | None]:
    """(name, unit as written or None) of a column. Raises InputError for a header with two readings."""
    for form in (_BRACKETS, _SLASH, _IN, _COMMA):
        if (found := form.fullmatch(header)) is not None:
            groups = found.groupdict()
            unit = groups.get("unit") or next((groups[k] for k in "abc" if groups.get(k) is not None), None)
            inner, beside = suffixed(groups["name"])
            if beside is not None and form is _BRACKETS and _known(unit or "") != _known(beside):
                raise InputError(
                    f"{where}: column {shown(header)} names two units, {beside} and {unit}; write one of them"
                )
            return _name(inner if beside is not None else groups["name"]), unit
    name, unit = suffixed(header)
    return _name(name), unit


def suffixed(header: str) -> tuple[str, str | None]:
    """(name, unit or None) by the suffix of a name: `p_a_Pa`, `n_rpm`."""
    parts = header.strip().split("_")
    for start in range(1, len(parts)):
        suffix = "_".join(parts[start:])
        if suffix in UNITS or suffix in PLAIN:
            return "_".join(parts[:start]), UNITS.get(suffix) or PLAIN[suffix]
        if suffix in WRITTEN:
            return "_".join(parts[:start]), suffix
    return header.strip(), None


def _known(unit: str) -> str:
    return SPELT.get(unit.strip(), unit.strip())


def _name(text: str) -> str:
    """A channel's name: what is no letter, digit or _ becomes _."""
    plain = re.sub(r"\W+", "_", text.strip(), flags=re.ASCII).strip("_")
    return plain if plain and not plain[0].isdigit() else f"n{plain}"


def converted(values: np.ndarray, unit: str, where: str, wanted: str | None = None) -> tuple[np.ndarray, str]:
    """(values, unit): unchanged where it is `wanted` or one of the house's units, else in SI, or in `wanted`.

    Raises InputError for a unit that is unknown or ambiguous, or of another quantity than `wanted`.
    """
    text = unit.strip()
    if text in AMBIGUOUS:
        raise InputError(f"{where}: the unit {text} is {AMBIGUOUS[text]}")
    spelt = SPELT.get(text, text)
    if spelt == wanted or (wanted is None and spelt in UNITS.values()):
        return values, spelt
    factor, zero, to = _scale(spelt, wanted, where)
    return (values * factor + zero if zero else values * factor), to


@cache
def _registry() -> Any:
    import pint

    registry: Any = pint.UnitRegistry(autoconvert_offset_to_baseunit=False)
    registry.define("tick = []")
    registry.define("house_count = []")
    return registry


@cache
def _scale(unit: str, wanted: str | None, where: str) -> tuple[float, float, str]:
    """(factor, zero, SI unit): what 1 and 0 of the unit are there."""
    registry = _registry()
    try:
        given = registry.parse_units(_written(unit))
    except Exception:  # whatever pint and its parser raise
        raise InputError(
            f"{where}: the unit {shown(unit)} is not known; write it as m/s^2, N m, L/min, degC, percent, or 1 for none"
        ) from None
    if wanted is None:
        turning = TURNING.search(unit)
        hint = ["rad/s", "rad/s^2", "rad"] if turning else ["N m"] if re.search(r"N\s?\S*\s?m", unit) else []
        candidates = [*hint, *SI]
    else:
        candidates = [wanted]
    for name in candidates:
        other = registry.parse_units(_written(name))
        if other.dimensionality == given.dimensionality:
            ends = [float(registry.Quantity(v, given).to(other).magnitude) for v in (0.0, 1.0)]
            factor, zero = ends[1] - ends[0], ends[0]
            return (round(factor, 12) if zero else factor), zero, name
    if wanted is not None:
        raise InputError(f"{where}: is in {unit}, which cannot be converted to {wanted}")
    raise InputError(f"{where}: the unit {shown(unit)} is of a quantity without a unit here; convert it, or write 1")


def _written(unit: str) -> str:
    """For pint: a blank between units is a product."""
    spelt = SPELT.get(unit, unit)
    spelt = {"count": "house_count", "1": "dimensionless"}.get(spelt, spelt)
    spelt = (
        spelt.replace("²", "^2")
        .replace("³", "^3")
        .replace("·", " ")
        .replace("⋅", " ")
        .replace("µ", "u")
        .replace("μ", "u")
    )
    if not re.fullmatch(r"[A-Za-z0-9_ ^*/().+-]{1,40}", spelt) or re.search(r"\d{3}|\*\*\s*\d\d|\^\s*\d\d", spelt):
        raise ValueError(unit)
    return re.sub(r"(?<=[A-Za-z0-9)])\s+(?=[A-Za-z(])", " * ", spelt.strip())
