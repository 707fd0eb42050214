"""The table of effects: what each entry of a TOML file says, read and checked.

An effect is what a plant's equations may leave out: terms in its balances and definitions, terms and filters of what
its sensors show, filters of its inputs. `joining` puts effects into a plant, `general` fills in those of any plant.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from greygate.errors import InputError, shown
from greygate.plants.expressions import check_expression, check_name, is_name, is_symbol, names, parse
from greygate.plants.plant import Definition, Equation, Plant, State, check_state, check_terms
from greygate.reading import Kind, line, listed, named, number, one_of, read_toml, table, truth

TABLE = Path(__file__).parent / "effects.toml"
GENERAL = Path(__file__).parent / "general.toml"
EXTRA = {"hydraulics": Path(__file__).parent / "hydraulics.toml"}
ANY = "*"  # among `plants`: for every plant
SENSOR = "sensor_"  # the place of a term, and of a filter, that changes a channel's reading
TIME = "t"  # the time in s, which an effect's terms may use


@dataclass(frozen=True)
class Free:
    """A parameter that an effect sets free.

    typical: its scale. low, high: physical bounds. guess: values at which a search starts, besides `typical`. scan:
    "wave" for the period of a wave, which is looked for along the travel. shape: the parameter shapes the effect, and
    has no meaning where the effect is zero. whole: the value, a whole number or a place, is not fitted. least: a value
    that is certainly smaller is not this effect. reported: its name in a diagnosis.
    """

    symbol: str
    typical: float
    unit: str = ""
    low: float = -float("inf")
    high: float = float("inf")
    guess: tuple[float, ...] = ()
    scan: str = ""
    shape: bool = False
    whole: bool = False
    least: float = 0.0
    reported: str = ""

    def __post_init__(self):
        if not is_symbol(self.symbol) or not (self.reported == "" or is_name(self.reported)):
            raise InputError(f"{shown(self.symbol)} is no name for a parameter; use ASCII letters, digits, underscores")
        for name in ("typical", "low", "high"):
            if type(value := getattr(self, name)) not in (int, float):
                raise InputError(f"{self.symbol}, {name}: {shown(value)} is no number")
        if not (self.typical > 0 or self.shape):
            raise InputError(f"{self.symbol}, typical: {self.typical!r}; give a size above 0")
        if not self.low <= self.high:
            raise InputError(f"{self.symbol}, low: {self.low!r} is above high, {self.high!r}; exchange them")


@dataclass(frozen=True)
class Effect:
    """One entry of the table; the comment at the head of `effects.toml` says what each field is."""

    key: str
    means: str
    plants: tuple[str, ...]
    equations: tuple[str, ...]
    depends_on: tuple[str, ...]
    free: tuple[Free, ...]
    terms: Mapping[str, str] = field(default_factory=dict)
    definitions: Mapping[str, Definition] = field(default_factory=dict)
    states: Mapping[str, State] = field(default_factory=dict)
    equations_of: Mapping[str, Equation] = field(default_factory=dict)
    storages: Mapping[str, str] = field(default_factory=dict)
    filters: Mapping[str, str] = field(default_factory=dict)
    set: Mapping[str, float] = field(default_factory=dict)
    wave: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    frees: bool = False
    fault: bool = False
    rare: bool = False
    smooth: bool = False
    once: bool = False
    of: str = ""
    table: str = ""

    def __post_init__(self):
        for name in (self.key, self.id):
            if not is_name(name):
                raise InputError(f"{shown(name)} is no name for an effect; use ASCII letters, digits, underscores")
        for name in (*self.definitions, *self.equations_of):
            if not is_name(name):
                raise InputError(f"{shown(name)} is no name for a place; use ASCII letters, digits, underscores")
        for symbol in (*self.symbols, *self.set):
            if not is_symbol(symbol):
                raise InputError(f"{shown(symbol)} is no name for a quantity; use ASCII letters, digits, underscores")
        for path, text in self.terms.items():
            where, _, term = path.partition(".")
            if not (is_name(where) and is_name(term)):
                raise InputError(f'term {shown(path)}: write "place.term" with names of ASCII letters')
            try:
                parse(text)
            except InputError as error:
                raise InputError(f"term {path}: {error}") from None
        symbols = {f.symbol for f in self.free}
        for name, filtered in self.filters.items():
            if not (own := filtered.split()[1:]) or not set(own) <= symbols:
                raise InputError(f"filters.{name}: {shown(filtered)}; write a filter and parameters of the effect")
        for name, pair in self.wave.items():
            if not (is_name(name) and len(pair) == 2 and set(pair) <= symbols):
                raise InputError(f"wave.{name}: {shown(pair)}; give two of its parameters, [sine, cosine]")

    @property
    def id(self) -> str:
        """The name in a diagnosis: the key, or that of the effect of which this is another form."""
        return self.of or self.key

    @cached_property
    def symbols(self) -> Collection[str]:
        """The symbols that it brings along: of parameters, states and definitions."""
        own = () if self.frees else (f.symbol for f in self.free)
        return {*own, *self.states, *(d.symbol for d in self.definitions.values())}

    @property
    def adds(self) -> bool:
        """Whether it only adds to balances and readings, and filters signals: it stores nothing and frees nothing."""
        return not (self.definitions or self.states or self.equations_of or self.storages or self.frees)

    def uses(self, symbol: str) -> bool:
        """Whether a term that it brings along names `symbol`."""
        brought: list[Definition | Equation] = [*self.definitions.values(), *self.equations_of.values()]
        texts = (text for place in brought for text in place.terms.values())
        return symbol in names((*self.terms.values(), *self.storages.values(), *texts))

    @cached_property
    def strengths(self) -> tuple[Free, ...]:
        """The parameters that make the effect, without those that only shape it; at 0 there is no effect."""
        return tuple(f for f in self.free if not f.shape)

    def lazily(self, expression: str) -> str:
        """`expression`, computed only while a strength differs from 0."""
        size = " + ".join(f"abs({f.symbol})" for f in self.strengths)
        return f"when({size}, {parse(expression)})" if size and not self.frees else expression


def read(path: Path | str = TABLE) -> dict[str, Effect]:
    """Effects by key, from a TOML table: a file, or the name of one that comes along ("hydraulics").

    Raises InputError naming file and entry.
    """
    path = EXTRA.get(str(path), Path(path))
    return {key: effect_of(path, key, entry) for key, entry in entries(path).items()}


def entries(path: Path) -> dict:
    """The entries of a table of effects, as they are written."""
    return read_toml(path, "give a table of effects")


def _defined(value: object, where: str) -> Definition:
    """`{ symbol = "q", unit = "m^3/s", sum = "expression" }`."""
    found = table(value, where, {"symbol": line, "unit": line, "sum": check_expression})
    return Definition(found["symbol"], found["unit"], {"sum": found["sum"]})


def _balance(value: object, where: str) -> Equation:
    """`{ state = "x", terms = { ... }, storage = "expression" }`."""
    return Equation(**table(value, where, {"state": line, "terms": check_terms}, {"storage": check_expression}))


def _texts(value: object, where: str) -> tuple[str, ...]:
    return tuple(listed(line)(value, where))


_FREE: dict[str, Kind] = {
    "unit": line, "low": number, "high": number, "guess": lambda value, where: tuple(listed(number)(value, where)),
    "least": number, "scan": one_of(("", "wave")), "shape": truth, "whole": truth, "as": line,
}  # fmt: skip
_NEEDED: dict[str, Kind] = {"means": line, "equations": _texts, "depends_on": _texts}
_ENTRIES: dict[str, Kind] = {
    "plants": _texts,
    "of": line,
    "fault": truth,
    "rare": truth,
    "smooth": truth,
    "once": truth,
    "terms": named(check_expression, line),
    "definitions": named(_defined, check_name),
    "states": named(check_state, check_name),
    "equations_of": named(_balance, check_name),
    "storages": named(check_expression, check_name),
    "filters": named(line, check_name),
    "set": named(number, check_name),
    "wave": named(_texts, check_name),
    **dict.fromkeys(
        ("parameters", "frees"), named(lambda value, where: table(value, where, {"typical": number}, _FREE))
    ),
}


_ACTING = ("terms", "filters", "equations_of", "storages")


def effect_of(path: Path, key: str, entry: object) -> Effect:
    """One entry of a table. Raises InputError naming file, effect and what is wrong."""
    where = f"{path}: effect {key}"
    found = {"plants": (ANY,)} | table(entry, where, _NEEDED, _ENTRIES)
    brought, released = (found.pop(name, {}) for name in ("parameters", "frees"))
    if brought and released:
        raise InputError(f"{where} has parameters and frees; give one of them")
    if not (released or any(found.get(name) for name in _ACTING)):
        raise InputError(f"{where} changes nothing of the plant by itself; give one of {', '.join(_ACTING)} or frees")
    try:
        free = tuple(Free(s, reported=f.pop("as", s), **f) for s, f in (brought | released).items())
        return Effect(key, free=free, frees=bool(released), table=str(path), **found)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def fitting(plant: Plant, datasheet: Mapping[str, float], effects: Mapping[str, Effect]) -> dict[str, Effect]:
    """The effects that may enter `plant`, and that its `datasheet` (symbol -> value) does not have already."""
    chosen = {}
    for key, effect in effects.items():
        if plant.name not in effect.plants and ANY not in effect.plants:
            continue
        if effect.frees and any(datasheet.get(f.symbol, 0.0) for f in effect.free):
            continue
        chosen[key] = effect
    return chosen
