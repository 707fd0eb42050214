"""What a unit is worth: an exact factor to SI, powers of SI's base units, and the zero of a temperature.

Units are products of symbols, each with the prefixes that are used with it; nothing else is a unit. An angle
counts as a base unit, so that a turn, a radian and a plain number are not mixed up (ISO 80000-3 has them all as 1).
"""

import math
import re
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache, lru_cache
from pathlib import Path

from greygate.reading import read_toml

Powers = dict[str, int]
BASES = ("m", "kg", "s", "A", "K", "mol", "cd", "rad")
WITHOUT = frozenset({"count", "tick"})  # base units that are plain numbers with a name
PREFIXES = {"P": 15, "p": -12, "n": -9, "u": -6, "m": -3, "c": -2, "d": -1, "h": 2, "k": 3, "M": 6, "G": 9}
LONG = {"peta": "P", "pico": "p", "nano": "n", "micro": "u", "milli": "m", "centi": "c", "deci": "d", "hecto": "h", 
        "kilo": "k", "mega": "M", "giga": "G"}  # fmt: skip
MOST = 12  # the powers of a unit, all together: W/(m^2 K^4) has 7

TABLE = read_toml(Path(__file__).with_name("units.toml"), "install greygate again")
SYMBOLS: dict[str, list[str]] = TABLE["symbols"]  # symbol -> what 1 of it is, in symbols above it; its prefixes
ZEROS = {name: Fraction(zero) for name, zero in TABLE["zeros"].items()}
TOGETHER: dict[str, str] = TABLE["together"]  # products that are written as one word


def spelt(*parts: str) -> dict[str, str]:
    """What stands in parts of the table, by each of its spellings."""
    return {text: own for part in parts for own, texts in TABLE[part].items() for text in texts}


PLAIN = spelt("bare_names")  # other names of a symbol, which no prefix goes with
NAMES = spelt("names", "bare_names")
FORCE = {"kg": 1, "m": 1, "s": -2}

_TOKEN = re.compile(
    r"\s*(?:(?P<name>(?:mm|cm|m|in|ft)H2O|[um]?g_0|g0|[^\W\d_]+|[%‰°])|(?P<one>1(?![\d.]))|(?P<sign>[*/().-]))"
)
_BESIDE = re.compile(r"[%‰]\s*[^\W\d_]|[^\W\d_]\s*[%‰]")  # %V, m%: a share of a volume, of a mass; no product
_POWER = re.compile(r"(?:\^|\*\*)?(?:\(([-+]?\d)\)|([-+]?\d))(?![\d.])")
_RAISED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺", "0123456789-+")
Factors = list[tuple[str, int]]


class Twofold(ValueError):
    """A product that is read in two ways, for want of parentheses."""


@dataclass(frozen=True)
class Quantity:
    """1 of a unit: `factor` of SI's units in `powers`; 0 of it is `zero` of them. powers: no 0; pi counts as one."""

    factor: Fraction = Fraction(1)
    powers: Powers = field(default_factory=dict)
    zero: Fraction = Fraction(0)

    def __mul__(self, other: "Quantity") -> "Quantity":
        """The product; a product has no zero of its own, since a rate of temperature has none."""
        both = {s: self.powers.get(s, 0) + other.powers.get(s, 0) for s in {**self.powers, **other.powers}}
        return Quantity(self.factor * other.factor, {s: p for s, p in both.items() if p})

    def __pow__(self, power: int) -> "Quantity":
        return self if power == 1 else Quantity(self.factor**power, {s: p * power for s, p in self.powers.items()})

    @property
    def dimension(self) -> Powers:
        """Powers of the base units, without numbers: pi, counts and ticks."""
        return {s: p for s, p in self.powers.items() if s != "pi" and s not in WITHOUT}

    @property
    def value(self) -> float:
        """The factor with its powers of pi."""
        return float(self.factor) * math.pi ** self.powers.get("pi", 0)


def plain(unit: str) -> str:
    """A unit with one sign for each thing: ² as ^2, µ as u, a blank as one blank, no full stop of an abbreviation."""
    text = re.sub("[⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺]+", lambda found: "^" + found[0].translate(_RAISED), unit)
    for sign, other in (("µ", "u"), ("μ", "u"), ("Ω", "Ω"), ("·", "*"), ("⋅", "*"), ("×", "*"), ("−", "-"),
                        ("º", "°"), ("˚", "°"), ("℃", "°C"), ("℉", "°F"), ("′", "'"), ("″", '"')):  # fmt: skip
        text = text.replace(sign, other)
    text = re.sub(r"\s+per\s+", "/", text)
    return re.sub(r"(?<=[A-Za-z])\.(?=[\s-]|$)", "", " ".join(text.split()))


def factors(unit: str) -> Factors:
    """(symbol, power) of each factor of a plain unit. Raises ValueError if it is no product, Twofold if two.

    A product behind a slash needs parentheses: `N/m s` is read in two ways. So is `N/m/s`, N s/m or N/(m s).
    """
    if _BESIDE.search(unit):
        raise ValueError(unit)
    tokens, at = [], 0
    while at < len(unit):
        found = _TOKEN.match(unit, at)
        if found is None:
            raise ValueError(unit)
        at = found.end()
        power = _POWER.match(unit, at) if found["name"] or found["sign"] == ")" else None
        tokens.append((found["name"] or found["one"] or found["sign"], int(power[1] or power[2]) if power else 1))
        at = power.end() if power else at
    out, rest = _product(tokens)
    if rest or any(p == 0 for _, p in out) or sum(abs(p) for _, p in out) > MOST:
        raise ValueError(unit)
    return out


def _product(tokens: Factors) -> tuple[Factors, Factors]:
    """(the factors up to a closing parenthesis or the end, the tokens behind them)."""
    out: Factors = []
    below: Factors = []  # the last factor behind a slash
    while tokens and tokens[0][0] != ")":
        sign = tokens[0][0] if out and tokens[0][0] in "*/.-" else ""
        inner, tokens = _factor(tokens[1:] if sign else tokens)
        if below and (sign != "/" or _speed(below, inner)):
            raise Twofold("a product behind a slash")
        below = inner if sign == "/" else []
        out += [(name, -p) for name, p in inner] if sign == "/" else inner
    if not out:
        raise ValueError("nothing")
    return out, tokens


def _factor(tokens: Factors) -> tuple[Factors, Factors]:
    if not tokens or tokens[0][0] in ("*", "/", ".", "-", ")"):
        raise ValueError("no factor")
    (name, power), rest = tokens[0], tokens[1:]
    if name != "(":
        return [(name, power)], rest
    inner, rest = _product(rest)
    if not rest:
        raise ValueError("no closing parenthesis")
    return [(name, p * rest[0][1]) for name, p in inner], rest[1:]


def _speed(above: Factors, below: Factors) -> bool:
    """Whether one over the other is a speed, so that a/b/c may be a/(b/c)."""
    try:
        return product(above).dimension in ({"m": 1}, {"rad": 1}) and product(below).dimension == {"s": 1}
    except ValueError:
        return False


def product(found: Factors) -> Quantity:
    """The quantity of factors. Raises ValueError for a symbol that is none, or is not raised to a power."""
    out = Quantity()
    for name, power in found:
        if name in TOGETHER and abs(power) != 1:
            raise ValueError(name)
        out = symbol(name) if found == [(name, 1)] else out * symbol(name) ** power
    return out


@cache
def symbol(name: str) -> Quantity:
    """The quantity of a symbol, a word or a product in one word. Raises ValueError if it is none of them."""
    if name == "1":
        return Quantity()
    if name in TOGETHER:
        return quantity(TOGETHER[name])
    own = NAMES.get(name, name)
    if own in SYMBOLS:
        return _defined(own)
    for base in (name[1:], NAMES.get(name[1:], "") if name[1:] not in PLAIN else ""):
        if base in SYMBOLS and name[0] in SYMBOLS[base][1].split():
            return Quantity(Fraction(10) ** PREFIXES[name[0]]) * _defined(base)
    return _worded(name.lower())


def _defined(name: str) -> Quantity:
    text = SYMBOLS[name][0]
    if not text:
        return Quantity(powers={name: 1})
    number = re.match(r"[\d./]+(?= |$)", text)
    rest = text[number.end() :].strip() if number else text
    made = (quantity(rest) if rest else Quantity()) * Quantity(Fraction(number[0]) if number else Fraction(1))
    return Quantity(made.factor, made.powers, ZEROS.get(name, Fraction(0)))


@cache
def _words() -> dict[str, str]:
    """A word in small letters -> its symbol, with a prefix or without."""
    found = {"feet": "ft", "henries": "henry", "inches": "inch", "mins": "min"}
    for word, own in spelt("words").items():
        found |= {word: own, f"{word}s": own}
        for long, short in LONG.items() if len(word) > 2 else ():
            if short in SYMBOLS[own][1].split() or own in ("gram", "m", "W", "V", "A"):
                found |= {f"{long}{word}": f"{short}\0{own}", f"{long}{word}s": f"{short}\0{own}"}
    return found


def _worded(word: str) -> Quantity:
    found = _words().get(word)
    if found is None:
        raise ValueError(word)
    prefix, _, own = found.rpartition("\0")
    return Quantity(Fraction(10) ** PREFIXES[prefix]) * _defined(own) if prefix else _defined(own)


@lru_cache(4096)
def quantity(unit: str) -> Quantity:
    """The quantity of a unit such as "N m s/rad", "m/s^2". Raises ValueError if it is none, or may be two."""
    return product(factors(plain(unit)))


def ratio(given: Quantity, wanted: Quantity) -> tuple[float, float] | None:
    """(factor, zero): x of the one is factor x + zero of the other; None where they are of two kinds.

    A plain number is in radians; degrees or turns are of another kind than plain numbers.
    """
    one, other = given.dimension, wanted.dimension
    radians = {} in (one, other) and {"rad": 1} in (one, other) and "pi" not in (*given.powers, *wanted.powers)
    if one != other and not radians:
        return None
    zero = (given.zero - wanted.zero) / wanted.factor
    powers = given.powers.get("pi", 0) - wanted.powers.get("pi", 0)
    return float(given.factor / wanted.factor) * math.pi**powers, float(zero)
