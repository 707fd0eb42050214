"""Effects that a plant's equations may leave out: a table in TOML, and how an effect joins a plant.

All effects that may enter a plant are joined to it once, with parameters at which they do nothing; a hypothesis is then
a set of parameters that become free, and nothing is compiled twice.
"""

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from greygate.errors import InputError
from greygate.plants.plant import Definition, Equation, Parameter, Plant, State

TABLE = Path(__file__).parent / "effects.toml"
GENERAL = Path(__file__).parent / "general.toml"
EXTRA = {"hydraulics": Path(__file__).parent / "hydraulics.toml"}
ANY = "*"  # among `plants`: for every plant
SENSOR = "sensor_"  # the place of a term that changes a channel's reading


@dataclass(frozen=True)
class Free:
    """A parameter that an effect sets free.

    typical: its scale. low, high: physical bounds. guess: where a search starts, besides `typical`. scan: "wave" where
    the period of a wave is looked for in the residual. shape: it only shapes the effect and means nothing at effect
    zero. whole: it is a whole number. reported: the name it goes by in a diagnosis.
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
        for name in ("typical", "low", "high"):
            if type(value := getattr(self, name)) not in (int, float):
                raise TypeError(f"{self.symbol}, {name}: {value!r} is no number")
        if not (self.typical > 0 or self.shape):
            raise TypeError(f"{self.symbol}, typical: {self.typical!r}; give a size above 0")


@dataclass(frozen=True)
class Effect:
    """One entry of the table (its comment says what each field is)."""

    key: str
    means: str
    plants: tuple[str, ...]
    equations: tuple[str, ...]
    depends_on: tuple[str, ...]
    free: tuple[Free, ...]
    terms: Mapping[str, str] = field(default_factory=dict)
    definitions: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    states: Mapping[str, Mapping] = field(default_factory=dict)
    equations_of: Mapping[str, Mapping] = field(default_factory=dict)
    filters: Mapping[str, str] = field(default_factory=dict)
    set: Mapping[str, float] = field(default_factory=dict)
    wave: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    frees: bool = False
    of: str = ""

    def __post_init__(self):
        for where, text in self.terms.items():
            if not isinstance(text, str):
                raise TypeError(f"term {where}: {text!r} is no expression in quotes")

    @property
    def id(self) -> str:
        """The name in a diagnosis: that of the effect of which this is a form."""
        return self.of or self.key

    @cached_property
    def strengths(self) -> tuple[Free, ...]:
        """The parameters that make the effect, without those that only shape it."""
        return tuple(f for f in self.free if not f.shape)

    def lazily(self, expression: str) -> str:
        """`expression`, computed only where the effect is there."""
        size = " + ".join(f"abs({f.symbol})" for f in self.strengths)
        return f"when({size}, {' '.join(expression.split())})" if size and not self.frees else expression


def read(path: Path | str = TABLE) -> dict[str, Effect]:
    """Effects by key, from a TOML table: a file, or the name of one that comes along ("hydraulics").

    Raises InputError naming file and entry.
    """
    path = EXTRA.get(str(path), Path(path))
    return {key: _effect(path, key, entry) for key, entry in _table(path).items()}


def _table(path: Path) -> dict:
    try:
        return tomllib.loads(path.read_text())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a table of effects") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is no TOML ({error}); mend that line") from None


def known(rig, recording) -> dict[str, Effect]:
    """The effects to be tried on a rig: the table's, and those of `effects.toml` in its folder.

    Where the rig's noise is not told, also the general ones in every place of its plant that they fit.
    """
    effects = read()
    if not rig.stated:
        effects |= general(rig, recording)
    own = rig.folder / "effects.toml"
    return effects | read(own) if own.exists() else effects


def general(rig, recording) -> dict[str, Effect]:
    """The general effects in every place of the rig's plant that they fit; the head of `general.toml` tells places."""
    plant, out = rig.plant, {}
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
            made = _placed(entry, place, rig, recording)
            out[name] = _effect(GENERAL, name, {"plants": [plant.name], **made})
    return out


def _placed(entry, place: Mapping[str, str], rig, recording):
    """`entry` with names for placeholders, and for "rate 0.5 {x}" that quantile of the channel's rate, or of itself."""
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


def _effect(path: Path, key: str, entry: dict) -> Effect:
    try:
        entry = dict(entry)
        released = entry.pop("frees", {})
        free = tuple(
            Free(symbol, reported=f.pop("as", symbol), guess=tuple(f.pop("guess", ())), **f)
            for symbol, f in ((s, dict(f)) for s, f in {**entry.pop("parameters", {}), **released}.items())
        )
        for name in ("plants", "equations", "depends_on"):
            entry[name] = tuple(entry.get(name, (ANY,)) if name == "plants" else entry[name])
        return Effect(key, free=free, frees=bool(released), **entry)
    except KeyError as error:
        raise InputError(f"{path}: effect {key}: {error} is missing; see the entries of {TABLE}") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: effect {key}: {error}; see the entries of {TABLE}") from None


def fitting(plant: Plant, datasheet: Mapping[str, float], effects: Mapping[str, Effect]) -> dict[str, Effect]:
    """Those effects that may enter `plant`, as its `datasheet` (symbol -> value) tells it."""
    chosen = {}
    for key, effect in effects.items():
        if plant.name not in effect.plants and ANY not in effect.plants:
            continue
        if effect.frees and any(datasheet.get(f.symbol, 0.0) for f in effect.free):
            continue  # it is there already
        chosen[key] = effect
    return chosen


def join(plant: Plant, effects: Iterable[Effect]) -> tuple[Plant, dict[str, dict[str, str]]]:
    """(plant with the effects' terms in it, doing nothing; reading terms by channel).

    Raises InputError naming effect and place where a term does not fit.
    """
    parameters, definitions = dict(plant.parameters), dict(plant.definitions)
    states, equations = dict(plant.states), dict(plant.equations)
    brought: dict[str, Definition] = {}
    readings: dict[str, dict[str, str]] = {}
    for effect in effects:
        for f in effect.free:
            if not effect.frees:
                parameters[f.symbol] = Parameter(f.typical if f.shape else 0.0, f.unit)
        for name, d in effect.definitions.items():
            brought[name] = Definition(d["symbol"], d["unit"], {"sum": effect.lazily(d["sum"])})
        for name, s in effect.states.items():
            states[name] = State(**s)
        for name, e in effect.equations_of.items():
            equations[name] = Equation(e["state"], e["terms"], e.get("storage", "1"))
        for path, expression in effect.terms.items():
            where, _, term = path.partition(".")
            expression = effect.lazily(expression)
            if where.startswith(SENSOR):
                readings.setdefault(where.removeprefix(SENSOR), {})[term] = expression
            elif where in equations:
                equations[where] = replace(equations[where], terms={**equations[where].terms, term: expression})
            elif where in definitions:
                definitions[where] = replace(definitions[where], terms={**definitions[where].terms, term: expression})
            else:
                names = ", ".join((*definitions, *equations))
                raise InputError(f"effect {effect.key}: {where}: {plant.name} has no such place; it has {names}")
    joined = replace(
        plant, parameters=parameters, states=states, equations=equations, definitions={**brought, **definitions}
    )
    return joined, readings
