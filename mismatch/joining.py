"""How effects join a plant: once, all that may enter, with parameters at which they do nothing.

Joining overwrites nothing of the plant: an effect's terms carry its key (`spring.spring`), and a clash of names is an
error.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NoReturn

from greygate.errors import InputError
from greygate.mismatch.entries import SENSOR, TIME, Effect
from greygate.plants.expressions import parse, replaced
from greygate.plants.plant import Definition, Parameter, Plant, Values


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


def begun(plant: Plant, effects: Iterable[Effect]) -> Plant:
    """A plant with effects, of which what they store begins where a diagnosis lets it begin: as the plant's states."""
    scope = Values(plant, {})
    scope.update({**dict.fromkeys(plant.inputs, 0.0), **plant.initial()})
    first = {
        symbol: replace(state, initial=float(scope.evaluate(state.start)))
        for effect in effects for symbol, state in effect.states.items() if state.start is not None
    }  # fmt: skip
    return replace(plant, states={**plant.states, **first})


LAWS = {  # filter of an input without memory -> the law of it, as in `model.FILTERS`
    "offset": "{u} + {0}",
    "skew": "{u} + {0} * abs({u})",
    "dead_zone": "max({u} - {0}, 0) + min({u} + {0}, 0)",
    "saturation": "{u} - {0} * (max({u} - {1}, 0) + min({u} + {1}, 0))",
}


def acting(plant: Plant, filters: Mapping[str, Sequence[tuple[str, Sequence[str]]]]) -> tuple[Plant, list[str]]:
    """(a plant in which inputs act by the laws of their filters; those whose filters have none).

    filters: input -> (kind, its parameters, as symbols or numbers) in their order.
    """
    rated = {how.partition(" ")[2] for how in plant.derived.values()}  # whose rate is that of what acts, too
    none = rated if plant.outside is None else {*filters}
    left = [n for n, kinds in filters.items() if n in none or any(kind not in LAWS for kind, _ in kinds)]
    acts, laws = {}, {}
    for name, kinds in filters.items():
        if name in left:
            continue
        text, acts[name] = name, f"{name}_acts"
        for kind, given in kinds:
            text = LAWS[kind].format(*given, u=name if text == name else f"({text})")
        laws[acts[name]] = Definition(acts[name], plant.inputs[name], {"law": text})
    if taken := {*laws} & plant.symbols:
        raise InputError(f"plant {plant.name}: {min(taken)} is what an input would act by; rename it")

    def with_acts(terms: Mapping[str, str]) -> dict[str, str]:
        return {term: replaced(text, acts) for term, text in terms.items()}

    definitions = {n: replace(d, terms=with_acts(d.terms)) for n, d in plant.definitions.items()}
    equations = {
        n: replace(e, terms=with_acts(e.terms), storage=replaced(e.storage, acts)) for n, e in plant.equations.items()
    }
    return replace(plant, definitions={**laws, **definitions}, equations=equations), left


class _Joining:
    """A plant while effects join it."""

    def __init__(self, plant: Plant):
        self.plant = plant
        self.parameters, self.states, self.inputs = dict(plant.parameters), dict(plant.states), dict(plant.inputs)
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
            if name.startswith(SENSOR):
                self.signal(effect, name.removeprefix(SENSOR))
            elif name not in plant.inputs:
                self.fail(effect, f"filters.{name}: plant {plant.name} has no such input")
        if TIME not in plant.symbols and effect.uses(TIME):
            self.inputs[TIME] = "s"

    def enter(self, effect: Effect) -> None:
        """Enter the effect's terms, each under the effect's key."""
        for path, text in effect.terms.items():
            where, _, term = path.partition(".")
            if where.startswith(SENSOR):
                self.show(effect, where.removeprefix(SENSOR), term, text)
                continue
            table: dict = self.equations if where in self.equations else self.definitions
            if where not in table:
                names = ", ".join((*self.definitions, *self.equations))
                self.fail(effect, f"{where}: {self.plant.name} has no such place; it has {names}")
            terms, term = table[where].terms, f"{effect.key}.{term}"
            if term in terms:
                self.fail(effect, f"{where}.{term}: plant {self.plant.name} has this term too; rename one")
            table[where] = replace(table[where], terms={**terms, term: effect.lazily(text)})
        for where, text in effect.storages.items():
            if where not in self.equations:
                self.fail(effect, f"storages.{where}: {self.plant.name} has no such balance")
            self.equations[where] = self.equations[where].storing(effect.lazily(text))
        for symbol in effect.set:
            if symbol not in self.parameters:
                self.fail(effect, f"set {symbol}: plant {self.plant.name} has no such parameter")

    def show(self, effect: Effect, channel: str, term: str, text: str) -> None:
        """Enter a term that a sensor adds to its channel; it may use that channel, inputs, `t` and parameters."""
        self.signal(effect, channel)
        for name in parse(text).names:
            if name not in (channel, TIME, *self.plant.inputs) and name not in self.parameters:
                known = f"use {channel}, inputs and parameters"
                self.fail(effect, f"{SENSOR}{channel}.{term}: unknown name {name!r}; {known}")
        self.readings.setdefault(channel, {})[f"{effect.key}.{term}"] = effect.lazily(text)

    def signal(self, effect: Effect, channel: str) -> None:
        if channel not in self.plant.symbols or channel in self.plant.parameters:
            self.fail(effect, f"{SENSOR}{channel}: plant {self.plant.name} has no signal {channel}")

    def joined(self) -> Plant:
        return replace(
            self.plant,
            parameters=self.parameters,
            inputs=self.inputs,
            states=self.states,
            equations=self.equations,
            definitions={**self.brought, **self.definitions},
        )
