"""Headers such as "p_a [bar]", and what becomes of a unit: one of the house's stays, any other is converted to SI.

A text that is neither a product of `quantities`' symbols nor among the spellings, or that has several readings, is
refused.
"""

import re
from functools import cache, lru_cache
from itertools import product as every
from math import prod

import numpy as np

from greygate.errors import InputError, shown
from greygate.names import LONGEST_UNIT
from greygate.plants.recording import MOST_PARTS, UNITS, unambiguous
from greygate.plants.units.quantities import (
    FORCE,
    NAMES,
    SYMBOLS,
    TABLE,
    TOGETHER,
    Quantity,
    Twofold,
    factors,
    plain,
    quantity,
    ratio,
    spelt,
    symbol,
)

SPELT = spelt("spellings")  # a whole unit as `quantities.plain` has it -> the unit in the symbols there
READINGS = spelt("readings")  # a factor, or a whole unit -> what it may be, each with its meaning; ? has no unit here
SUFFIXES: dict[str, str] = TABLE["suffixes"]  # of a name, `n_rpm` -> unit as it is written
SI: list[str] = TABLE["si"]  # what a unit becomes: the first that is of its kind
FORCES = ("N m", "N s/m", "N m/A")  # of `SI`: also J, kg/s and Wb
LONGEST = 256  # characters of a header
MOST_READINGS = 16  # of a product
_SIGN = re.compile(r"[/^%°²³]")  # of a unit, in no name: `speed_rad/s`
_BRACKETS = re.compile(
    r"\s*(?P<name>.*?)\s*(?:\[(?P<a>[^\[\]]*)\]|\((?P<b>[^()]*(?:\([^()]*\))?)\)|\{(?P<c>[^{}]*)\})\s*"
)
_SLASH = re.compile(r"\s*(?P<name>[^/]+?)\s+/\s+(?P<unit>\S.*?)\s*")
_IN = re.compile(r"\s*(?P<name>\S.*?)\s+in\s+(?P<unit>\S+)\s*")
_COMMA = re.compile(r"\s*(?P<name>[^,:;]+?)\s*[,:;]\s*(?P<unit>[^,:;]+?)\s*")

ALONE = frozenset({"h", "d", "t", "l"})  # of `READINGS`: in a product they are the unit
ADVICE = [(re.compile(form), told) for form, told in TABLE["advice"].items()]  # of what is no unit of a value at a time
PRESSURE = re.compile(
    r"(?P<base>..+?)(?:\s*[([_\s-]\s*(?P<apart>absolute|absolut|abs|a|gauge|gage|ga|g|relative|relativ|rel|ü|ue|"
    r"differential|diff|d)\.?\s*[)\]]?|(?P<joined>abs|a|g|d|ü))",
    re.I,
)
"""A pressure and what it counts from: bar(a), psig, kPa abs, mbar rel."""
GAUGE = "grüu"  # what begins so counts from the ambient pressure
TEMPERATURE = re.compile(
    r"(?<![^\W\d_])(?P<milli>m|milli)?(?:deg(?:ree)?s?|°)[\s._]{0,2}(?P<of>c(?:elsius)?|f(?:ahrenheit)?|k(?:elvin)?)(?![^\W\d_])"
    r"|(?<![^\W\d_])(?:grad\s)(?P<grad>c)(?![^\W\d_])|(?<![^\W\d_])(?:grad\s)?(?P<word>celsius|fahrenheit|centigrade)(?![^\W\d_])",
    re.I,
)
"""deg C, °c, degrees_F, Grad Celsius, also within a product."""


def split(header: str, where: str) -> tuple[str, str | None]:
    """(name, unit as written or None) of a column. Raises InputError for a header with two readings."""
    if len(header) > LONGEST:
        raise InputError(f"{where}: column {shown(header)} has {len(header)} characters; rename it, at most {LONGEST}")
    for form in (_BRACKETS, _SLASH, _IN, _COMMA):
        if (found := form.fullmatch(header)) is not None:
            groups = found.groupdict()
            unit = groups.get("unit") or next((groups[k] for k in "abc" if groups.get(k) is not None), None)
            inner, beside = suffixed(groups["name"])
            if beside is not None and form is _BRACKETS and (beside == "1" or not same(unit or "", beside)):
                if re.search(r"_\w$", groups["name"].strip()) and (beside == "1" or not factor(unit or "", beside)):
                    return _name(groups["name"]), unit  # x_1 [1], x_1 [mm], p_A [bar]: a sign that numbers channels
                raise InputError(
                    f"{where}: column {shown(header)} names two units, {beside} and {unit}; write one of them"
                )
            return _name(inner if beside is not None else groups["name"]), unit
    name, unit = suffixed(header)
    unambiguous(header, name, unit or "", where)
    return _name(name), unit


def suffixed(header: str) -> tuple[str, str | None]:
    """(name, unit or None) by the suffix of a name: `p_a_Pa`, `n_rpm`."""
    parts = header.strip().split("_")
    for start in range(max(1, len(parts) - MOST_PARTS), len(parts)):
        suffix = "_".join(parts[start:])
        if suffix in UNITS or suffix in SUFFIXES:
            return "_".join(parts[:start]), UNITS.get(suffix) or SUFFIXES[suffix]
        if _SIGN.search(suffix) and _is_unit(suffix):
            return "_".join(parts[:start]), suffix
    return header.strip(), None


def same(unit: str, other: str) -> bool:
    """Whether both are one unit."""
    try:
        return unit.strip() == other or scale(unit.strip(), None) == scale(other, None)
    except InputError:
        return False


def _is_unit(text: str) -> bool:
    try:
        return bool(_read(text))
    except InputError:
        return False


def _name(text: str) -> str:
    """A channel's name: what is no letter, digit or _ becomes _."""
    plain = re.sub(r"\W+", "_", text.strip(), flags=re.ASCII).strip("_")
    return plain if plain and not plain[0].isdigit() else f"n{plain}"


def converted(values: np.ndarray, unit: str, where: str, wanted: str | None = None) -> tuple[np.ndarray, str]:
    """(values, unit): unchanged where it is `wanted` or one of the house's units, else in SI, or in `wanted`.

    What is wanted settles a unit of several readings if it is of the kind of one alone.
    Raises InputError for a unit that is unknown or ambiguous, or of another quantity than `wanted`.
    """
    text = unit.strip()
    if text == wanted:
        return values, text
    try:
        factor, zero, to = scale(text, wanted)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return (values * factor + zero if zero else values if factor == 1 else values * factor), to


def factor(unit: str, wanted: str) -> float | None:
    """What a difference of 1 of a unit is in another; None where they are of two kinds, or one is not known."""
    try:
        return 1.0 if unit == wanted else scale(unit, wanted)[0]
    except InputError:
        return None


@lru_cache(4096)
def scale(unit: str, wanted: str | None) -> tuple[float, float, str]:
    """(factor, zero, unit): what 1 and 0 of the unit are there. Raises InputError without a place."""
    symbols = _read(unit, wanted)
    given = quantity(symbols)
    if wanted is not None:
        if (found := _ratio(given, wanted)) is None:
            raise InputError(f"is in {unit}, which cannot be converted to {wanted}")
        return *found, wanted
    forces = FORCES if _has_force(symbols) else ()
    for name in (*forces, *(unit for unit in UNITS.values() if unit not in FORCES)):
        if quantity(name) == given:
            return 1.0, 0.0, name
    for name in (*forces, *SI):
        if (found := ratio(given, quantity(name))) is not None and quantity(name).dimension == given.dimension:
            return *found, name
    raise InputError(f"the unit {shown(unit)} is of a quantity without a unit here; convert it, or write 1")


def _ratio(given: Quantity, wanted: str) -> tuple[float, float] | None:
    try:
        return ratio(given, quantity(_read(wanted)))
    except InputError:
        return None


def _has_force(unit: str) -> bool:
    """Whether a unit is written with a force: then a torque is no energy, and a damping no flow of mass."""
    names = [name for name, _ in factors(unit)]
    return any(symbol(n).powers == FORCE or (n in TOGETHER and _has_force(TOGETHER[n])) for n in names)


def _read(unit: str, wanted: str | None = None) -> str:
    """A unit in the symbols of `quantities`. Raises InputError if it is none, or has several readings."""
    text = plain(unit)
    if len(unit) > LONGEST_UNIT:
        raise InputError(f"the unit {shown(unit)} is longer than any; write it as m/s^2, N m, L/min, or 1 for none")
    for form, advice in ADVICE:
        if form.fullmatch(text):
            raise InputError(f"the unit {text} is {advice}")
    if (pressure := _pressure(text)) is not None:
        return pressure
    text = TEMPERATURE.sub(_degrees, text)
    try:
        read = _readings(SPELT.get(text, text))
    except Twofold:
        raise InputError(f"the unit {shown(unit)} has two readings, a/(b c) and a c/b; write parentheses") from None
    except ValueError:
        raise InputError(_unknown(unit, text)) from None
    if len(read) > 1 and wanted is not None:
        fits = [r for r in read if r[0] != "?" and _ratio(quantity(r[0]), wanted) is not None]
        read = fits if len(fits) == 1 else read
    if len(read) > 1:
        write = " or ".join(dict.fromkeys(symbols for symbols, _ in read if symbols != "?")) or "what is meant"
        raise InputError(f"the unit {text} is {' or '.join(means for _, means in read)}; write {write}")
    return read[0][0]


def _pressure(text: str) -> str | None:
    """The unit of an absolute pressure or of a difference; None if it is neither. Raises InputError for a gauge's."""
    found = PRESSURE.fullmatch(text)
    if found is None:
        return None
    try:
        base = _read(found["base"].strip(), "Pa")
        if _ratio(quantity(base), "Pa") is None:
            return None
    except InputError:
        return None
    if (found["apart"] or found["joined"])[0].lower() in GAUGE:
        raise InputError(
            f"the unit {text} is a gauge pressure, which has no fixed zero; add the ambient pressure and write {base}"
        )
    return base


def _degrees(found: re.Match[str]) -> str:
    letter = (found["of"] or found["grad"] or found["word"])[0].upper()
    return ("m" if found["milli"] else "") + ("K" if letter == "K" else f"deg{letter}")


def _readings(text: str) -> list[tuple[str, str]]:
    """(unit in the symbols of `quantities`, meaning) of each reading. Raises ValueError if there is none."""
    if text in READINGS:
        return [
            (unit, means or unit) for unit, _, means in (part.partition(": ") for part in READINGS[text].split("; "))
        ]
    found = factors(text)
    parts = {n: _readings(n) for n, _ in found if n in READINGS and not (len(found) > 1 and n in ALONE)}
    if prod(map(len, parts.values())) > MOST_READINGS:
        raise ValueError(text)
    made = []
    for choice in every(*parts.values()):
        made_of = text
        for name, (unit, means) in zip(parts, choice, strict=True):
            inner = f"({means if unit == '?' else unit})" if unit == "?" or re.search(r"[ /^]", unit) else unit
            made_of = re.sub(rf"(?<![^\W\d_]){re.escape(name)}(?![^\W\d_])", inner, made_of)
        made.append(("?" if any(unit == "?" for unit, _ in choice) else made_of, made_of))
    if not any(unit != "?" and quantity(unit) for unit, _ in made):
        raise ValueError(text)
    return made


def _unknown(unit: str, text: str) -> str:
    told = f"the unit {shown(unit)} is not known; "
    if other := sorted(_by_letters().get(text.lower(), ())):
        return f"{told}in other letters it is {' or '.join(other)}: write which"
    return f"{told}write it as m/s^2, N m, L/min, degC, percent, or 1 for none"


@cache
def _by_letters() -> dict[str, set[str]]:
    """Units in small letters -> as they are written."""
    found: dict[str, set[str]] = {}
    names = {name: SYMBOLS[name][1].split() for name in SYMBOLS} | {
        n: SYMBOLS[own][1].split() for n, own in NAMES.items()
    }
    for unit in (*(p + n for n, prefixes in names.items() for p in ("", *prefixes)), *TOGETHER, *SPELT):
        found.setdefault(unit.lower(), set()).add(unit)
    return found
