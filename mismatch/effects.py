"""Effects that a plant's equations may leave out: a table in TOML, and how an effect joins a plant.

All effects that may enter a plant join it once, with parameters at which they do nothing. A hypothesis is then a set of
parameters that become free, and nothing is compiled twice. Joining overwrites nothing of the plant: an effect's terms
carry its key (`spring.spring`), general effects take symbols that the plant does not have, and every other clash is an
error (`_Joining`).
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import NoReturn

import numpy as np

from greygate.errors import InputError, shown
from greygate.plants.expressions import check_expression, check_name, is_name, is_symbol, parse, replaced
from greygate.plants.plant import Definition, Equation, Parameter, Plant, State, check_state, check_terms
from greygate.reading import Kind, line, listed, named, number, one_of, read_toml, table, truth

TABLE = Path(__file__).parent / "effects.toml"
GENERAL = Path(__file__).parent / "general.toml"
EXTRA = {"hydraulics": Path(__file__).parent / "hydraulics.toml"}
ANY = "*"  # among `plants`: for every plant
SENSOR = "sensor_"  # the place of a term that changes a channel's reading


@dataclass(frozen=True)
class Free:
    """A parameter that an effect sets free.

    typical: its scale. low, high: physical bounds. guess: values at which a search starts, besides `typical`. scan:
    "wave" for the period of a wave, which is looked for along the travel. shape: the parameter shapes the effect, and
    has no meaning where the effect is zero. whole: the value is a whole number and is not fitted. reported: its name in
    a diagnosis.
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
    filters: Mapping[str, str] = field(default_factory=dict)
    set: Mapping[str, float] = field(default_factory=dict)
    wave: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    frees: bool = False
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
            if filtered.split()[1:] not in ([symbol] for symbol in symbols):
                raise InputError(f"filters.{name}: {shown(filtered)}; write a filter and one of its parameters")
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
    return {key: _effect(path, key, entry) for key, entry in _table(path).items()}


def _table(path: Path) -> dict:
    return read_toml(path, "give a table of effects")


def known(rig, recording) -> dict[str, Effect]:
    """The effects to be tried on a rig: those of the table, and those of `effects.toml` in its folder.

    Where the rig does not state its noise, also the general effects in every place of its plant that they fit.
    """
    path = rig.folder / "effects.toml"
    effects, own = read(), read(path) if path.exists() else {}
    if not rig.stated:
        effects |= general(rig, recording, fitting(rig.plant, rig.datasheet, effects | own).values())
    return effects | own


def general(rig, recording, beside: Iterable[Effect] = ()) -> dict[str, Effect]:
    """The general effects in every place of the rig's plant that they fit; the head of `general.toml` lists the places.

    Where the plant, or an effect `beside` them, has one of their symbols already, they take another symbol. A diagnosis
    reports it by the name that stands in the table.
    """
    plant, out = rig.plant, {}
    taken = plant.symbols | {symbol for effect in beside for symbol in effect.symbols}
    balance = {e.state: name for name, e in plant.equations.items()}
    places = {
        "u": [{"u": name} for name in rig.inputs],
        "y": [{"y": name} for name in rig.predict if name in plant.states],
        "level": [{"y": name} for name in rig.predict if name in plant.states and not plant.states[name].rate],
        "v": [{"x": x, "v": s.rate, "motion": balance[s.rate]} for x, s in plant.states.items() if s.rate],
    }
    for key, entry in _table(GENERAL).items():
        at = places[entry.pop("at")]
        for place in at:
            name = key if len(at) == 1 else f"{key}_{next(iter(place.values()))}"
            made = _renamed(_placed(entry, place, rig, recording), taken)
            taken |= set(made["parameters"])
            out[name] = _effect(GENERAL, name, {"plants": [plant.name], **made})
    return out


def _renamed(entry: dict, taken: Collection[str]) -> dict:
    """`entry` with new symbols in place of those that are `taken`."""
    own = entry["parameters"]
    new = {s: next(f"{s}_{n}" for n in count(2) if f"{s}_{n}" not in {*taken, *own}) for s in own if s in taken}
    if not new:
        return entry
    return entry | {
        "parameters": {new.get(s, s): {"as": s, **p} for s, p in own.items()},
        "terms": {path: replaced(text, new) for path, text in entry.get("terms", {}).items()},
        "filters": {name: " ".join(new.get(w, w) for w in t.split()) for name, t in entry.get("filters", {}).items()},
    }


def _placed(entry, place: Mapping[str, str], rig, recording):
    """`entry` with names in place of placeholders, and quantiles of the recording in place of "rate 0.5 {x}"."""
    match entry:
        case dict():
            return {_placed(k, place, rig, recording): _placed(v, place, rig, recording) for k, v in entry.items()}
        case list():
            return [_placed(v, place, rig, recording) for v in entry]
        case str():
            for name, symbol in place.items():
                entry = entry.replace(f"{{{name}}}", symbol)
            kind, _, rest = entry.partition(" ")
            if kind not in ("rate", "level"):
                return entry
            share, channel = rest.split()
            signal = recording[channel] if channel in recording.channels else recording[rig.predict[0]]
            if kind == "rate":
                signal = np.abs(np.gradient(signal, rig.dt))
            return float(np.quantile(signal, float(share)))
    return entry


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
    "scan": one_of(("", "wave")), "shape": truth, "whole": truth, "as": line,
}  # fmt: skip
_NEEDED: dict[str, Kind] = {"means": line, "equations": _texts, "depends_on": _texts}
_ENTRIES: dict[str, Kind] = {
    "plants": _texts,
    "of": line,
    "terms": named(check_expression, line),
    "definitions": named(_defined, check_name),
    "states": named(check_state, check_name),
    "equations_of": named(_balance, check_name),
    "filters": named(line, check_name),
    "set": named(number, check_name),
    "wave": named(_texts, check_name),
    **dict.fromkeys(
        ("parameters", "frees"), named(lambda value, where: table(value, where, {"typical": number}, _FREE))
    ),
}


def _effect(path: Path, key: str, entry) -> Effect:
    where = f"{path}: effect {key}"
    found = {"plants": (ANY,)} | table(entry, where, _NEEDED, _ENTRIES)
    brought, released = (found.pop(name, {}) for name in ("parameters", "frees"))
    if brought and released:
        raise InputError(f"{where} has parameters and frees; give one of them")
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


def join(plant: Plant, effects: Iterable[Effect]) -> tuple[Plant, dict[str, dict[str, str]]]:
    """(the plant with the effects' terms, at values where they do nothing; the terms of sensors by channel).

    Raises InputError naming effect and place where a term does not fit, or where a name belongs to the plant or to
    another effect that is no form of the same one.
    """
    joining, effects = _Joining(plant), list(effects)
    for effect in effects:
        joining.bring(effect)
    for effect in effects:
        joining.enter(effect)
    return joining.joined(), joining.readings


class _Joining:
    """A plant while effects join it."""

    def __init__(self, plant: Plant):
        self.plant = plant
        self.parameters, self.states = dict(plant.parameters), dict(plant.states)
        self.equations, self.definitions = dict(plant.equations), dict(plant.definitions)
        self.brought: dict[str, Definition] = {}
        self.readings: dict[str, dict[str, str]] = {}
        self.owners: dict[tuple[str, str], tuple[Effect, object]] = {}
        self.places = {*plant.equations, *plant.definitions}
        for place in self.places:
            if place.startswith(SENSOR):
                raise InputError(f"plant {plant.name}: {place}: names in {SENSOR} are kept for readings; rename it")

    def fail(self, effect: Effect, problem: str) -> NoReturn:
        raise InputError(f"effect {effect.key}: {problem}")

    def claim(self, effect: Effect, kind: str, name: str, what, taken: Collection[str]) -> None:
        """Give `name` to the effect. Only a form of the same effect may have it, too, and mean the same by it."""
        if name in taken:
            self.fail(effect, f"{kind} {name}: plant {self.plant.name} has this name too; rename one")
        other, same = self.owners.setdefault((kind, name), (effect, what))
        if not (effect.id == other.id or effect.table == other.table) or what != same:
            self.fail(effect, f"{kind} {name}: effect {other.key} has something else of this name; rename one")

    def bring(self, effect: Effect) -> None:
        """Bring the effect's own parameters, definitions, states and balances along."""
        plant = self.plant
        for f in effect.free:
            if not effect.frees:
                self.claim(effect, "symbol", f.symbol, (f.unit, f.shape), plant.symbols)
                self.parameters[f.symbol] = Parameter(f.typical if f.shape else 0.0, f.unit)
            elif f.symbol not in plant.parameters:
                self.fail(effect, f"frees {f.symbol}: plant {plant.name} has no such parameter")
        for name, d in effect.definitions.items():
            made = replace(d, terms={term: effect.lazily(text) for term, text in d.terms.items()})
            self.claim(effect, "place", name, made, self.places)
            self.claim(effect, "symbol", d.symbol, made, plant.symbols)
            self.brought[name] = made
        for symbol, state in effect.states.items():
            self.claim(effect, "symbol", symbol, state, plant.symbols)
            self.states[symbol] = state
        for name, equation in effect.equations_of.items():
            self.claim(effect, "place", name, equation, self.places)
            self.equations[name] = equation
        for name in effect.filters:
            if name not in plant.inputs:
                self.fail(effect, f"filters.{name}: plant {plant.name} has no such input")

    def enter(self, effect: Effect) -> None:
        """Enter the effect's terms, each under the effect's key."""
        for path, text in effect.terms.items():
            where, _, term = path.partition(".")
            if where.startswith(SENSOR):
                self.show(effect, where.removeprefix(SENSOR), term, text)
                continue
            table = self.equations if where in self.equations else self.definitions
            if where not in table:
                names = ", ".join((*self.definitions, *self.equations))
                self.fail(effect, f"{where}: {self.plant.name} has no such place; it has {names}")
            terms, term = table[where].terms, f"{effect.key}.{term}"
            if term in terms:
                self.fail(effect, f"{where}.{term}: plant {self.plant.name} has this term too; rename one")
            table[where] = replace(table[where], terms={**terms, term: effect.lazily(text)})
        for symbol in effect.set:
            if symbol not in self.parameters:
                self.fail(effect, f"set {symbol}: plant {self.plant.name} has no such parameter")

    def show(self, effect: Effect, channel: str, term: str, text: str) -> None:
        """Enter a term that a sensor adds to its channel; it may use that channel and parameters, nothing else."""
        if channel not in self.plant.symbols or channel in self.plant.parameters:
            self.fail(effect, f"{SENSOR}{channel}: plant {self.plant.name} has no signal {channel}")
        for name in parse(text).names:
            if name != channel and name not in self.parameters:
                self.fail(effect, f"{SENSOR}{channel}.{term}: unknown name {name!r}; use {channel} and parameters")
        self.readings.setdefault(channel, {})[f"{effect.key}.{term}"] = effect.lazily(text)

    def joined(self) -> Plant:
        return replace(
            self.plant,
            parameters=self.parameters,
            states=self.states,
            equations=self.equations,
            definitions={**self.brought, **self.definitions},
        )
