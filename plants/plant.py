"""A plant declared once: states, inputs, outputs, parameters, and balance equations by name.

Every equation and every intermediate quantity is a sum of *named terms*; each term is an expression
(`expressions.parse`). The compiled simulation (`simulate`), the residual of one equation on measured signals
(`Plant.residual`) and the switching of single terms (`without`, `with_term`) all use this one declaration.
"""

from collections.abc import Collection, Container, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import NoReturn

import numpy as np

from greygate.errors import InputError, shown
from greygate.names import check_file_name
from greygate.plants.closure import Closure, check_closure
from greygate.plants.curves import read_curve
from greygate.plants.expressions import check_expression, check_name, is_name, is_symbol, names, parse
from greygate.plants.outside import Outside
from greygate.reading import entry_of, line, listed, named, number, read_toml, table, within

DERIVED = ("rate", "integral", "smooth_rate", "smooth_acceleration")  # ways to derive an input from a recorded signal
TERMS = 500  # most terms of a sum, because Python and numba recurse over them; a closure tries about 100
SHORTEST = 1e-9  # s, of a step


@dataclass(frozen=True)
class Parameter:
    """A constant of the plant: `value` in `unit`, with a relative `tolerance` (0: known exactly).

    plus_minus: the uncertainty in `unit`, in place of a tolerance, as of a value that is 0.
    """

    value: float
    unit: str
    tolerance: float = 0.0
    meaning: str = ""
    plus_minus: float = 0.0

    @property
    def reach(self) -> float:
        """The uncertainty in `unit`, of two standard deviations; 0 where the value is known."""
        return self.plus_minus or self.tolerance * abs(self.value)


@dataclass(frozen=True)
class State:
    """A state in `unit`; `initial`, `low` and `high` are numbers or expressions in the parameters.

    The state stays within [`low`, `high`]: on a bound neither the state nor the state `rate`, its velocity, moves
    further outward. Examples are a stroke stop, a saturation, and a pressure that cannot fall below zero.
    start: its value if a run starts within a recording, from parameters, inputs, states and definitions.
    """

    unit: str
    initial: float | str = 0.0
    low: float | str | None = None
    high: float | str | None = None
    rate: str | None = None
    start: str | None = None


@dataclass(frozen=True)
class Equation:
    """A balance: `storage` * d(`state`)/dt = sum of `terms` (name -> expression).

    couples: other states -> what their rates are multiplied with on the left side: the mass matrix off its diagonal.
    """

    state: str
    terms: Mapping[str, str]
    storage: str = "1"
    couples: Mapping[str, str] = field(default_factory=dict)

    @property
    def texts(self) -> tuple[str, ...]:
        """All its expressions."""
        return (self.storage, *self.couples.values(), *self.terms.values())

    def storing(self, more: str) -> "Equation":
        """The balance with an expression added to its storage."""
        return replace(self, storage=f"({self.storage}) + {more}")


@dataclass(frozen=True)
class Definition:
    """An algebraic quantity: `symbol` (in `unit`) = sum of `terms` (name -> expression)."""

    symbol: str
    unit: str
    terms: Mapping[str, str]


@dataclass(frozen=True)
class Plant:
    """States, inputs and outputs joined by named definitions and balance equations.

    parameters: symbol -> Parameter
    inputs:     symbol -> unit
    states:     symbol -> State; each has exactly one equation
    definitions: name -> Definition, which uses only earlier definitions
    equations:  name -> Equation
    outputs:    symbols (states, definitions or inputs) that a simulation returns
    derived:    input -> how it is derived from a recorded signal, "rate x_motor" (`Plant.derive`)
    switches:   parameter -> a second parameter; if a data sheet gives the second, the first turns from 0 to 1
    required:   parameters that a data sheet must give
    step:       suitable integration step, s
    closure:    the places that may lack an unnamed term, and the functions of which such a term is made
    experiments: variable -> the experiment, in words, in which it changes alone
    outside:    the simulator of somebody else's that steps some of the states

    All names are checked. Raises InputError naming plant, equation and term.

    >>> text = '''
    ... outputs = ["x"]
    ... inputs = { force = "N" }
    ... parameters = { mass = [20.0, "kg"], viscous = [400.0, "N s/m"] }
    ... states = { x = { unit = "m", rate = "v" }, v = { unit = "m/s" } }
    ... [equations]
    ... position = { x = { velocity = "v" } }
    ... motion = { v = { storage = "mass", drive = "force", friction = "-viscous * v" } }
    ... '''
    >>> _ = Path("axis.toml").write_text(text)
    >>> axis = Plant.read("axis.toml")
    >>> axis
    <Plant axis: force [N] -> x; states x [m], v [m/s]>
    """

    name: str
    parameters: Mapping[str, Parameter]
    inputs: Mapping[str, str]
    states: Mapping[str, State]
    equations: Mapping[str, Equation]
    outputs: tuple[str, ...]
    definitions: Mapping[str, Definition] = field(default_factory=dict)
    derived: Mapping[str, str] = field(default_factory=dict)
    switches: Mapping[str, str] = field(default_factory=dict)
    step: float = 1e-4
    required: tuple[str, ...] = ()
    closure: Closure = field(default_factory=Closure)
    experiments: Mapping[str, str] = field(default_factory=dict)
    outside: Outside | None = None

    def __repr__(self) -> str:
        inputs = ", ".join(f"{symbol} [{unit}]" for symbol, unit in self.inputs.items())
        states = ", ".join(f"{symbol} [{state.unit}]" for symbol, state in self.states.items())
        return f"<Plant {self.name}: {inputs} -> {', '.join(self.outputs)}; states {states}>"

    def __post_init__(self) -> None:
        symbols: set[str] = set()
        for symbol in (*self.parameters, *self.inputs, *self.states):
            self._declare(symbol, symbols)
        for symbol, parameter in self.parameters.items():
            if not (np.isfinite(parameter.value) and parameter.tolerance >= 0):
                self._fail(f"parameter {symbol}", f"{parameter.value} +- {parameter.tolerance}; give finite numbers")
        for name, definition in self.definitions.items():
            self._check_terms(f"definition {name}", definition.terms, symbols)
            self._declare(definition.symbol, symbols)
        for symbol, state in self.states.items():
            self._check_state(symbol, state, symbols)
        self._check_derived(symbols)
        for entry, owners in (("switches", self.parameters), ("required", self.parameters), ("experiments", symbols)):
            for symbol in getattr(self, entry):
                self._among(entry, symbol, owners)
        for symbol in self.switches.values():
            self._among("switches", symbol, self.parameters)
        for where in self.closure.places:
            self._place(where)
        for name in (*self.definitions, *self.equations):
            if not is_name(name):
                self._fail(shown(name), "is not a name for a place; use ASCII letters, digits and underscores")
        for name, equation in self.equations.items():
            if name in self.definitions:
                self._fail(f"equation {name}", "a definition has this name too; rename one")
            self._check(f"equation {name}, storage", equation.storage, symbols)
            for other, expression in equation.couples.items():
                if other not in self.states or other == equation.state:
                    self._fail(f"equation {name}, couples", f"{shown(other)} is no other state; name one")
                self._check(f"equation {name}, couples {other}", expression, symbols)
            self._check_terms(f"equation {name}", equation.terms, symbols)
        balanced = [equation.state for equation in self.equations.values()]
        for name in (*self.states, *balanced):
            if name not in self.states:
                self._fail("equations", f"{shown(name)} is no state; declare it")
            if balanced.count(name) != 1:
                self._fail("equations", f"state {name} has {balanced.count(name)} equations; give it one")
        for output in self.outputs:
            if output not in symbols - set(self.parameters):
                self._fail("outputs", f"{shown(output)} is no state, definition or input")
        if not (np.isfinite(self.step) and self.step >= SHORTEST):
            self._fail("step", f"{self.step} s; give {SHORTEST:g} s or more")

    @classmethod
    def read(cls, path: Path | str) -> "Plant":
        """Read a plant from a TOML file such as `machines/*/*.toml`; it has the name of the file.

        Raises InputError naming the file, and the line or the entry.
        """
        path = Path(path)
        return cls.of(path.stem, read_toml(path, "give a plant's TOML file"), path.parent, str(path))

    @classmethod
    def of(cls, name: str, declaration: Mapping, folder: Path | str = ".", where: str = "plant") -> "Plant":
        """A plant from the tables of such a file as a dictionary. folder: of the CSV files that it names.

        Raises InputError naming `where`, and the entry.

        >>> lag = Plant.of("lag", {
        ...     "outputs": ["y"],
        ...     "inputs": {"u": "V"},
        ...     "parameters": {"T": [0.5, "s"]},
        ...     "states": {"y": {"unit": "V"}},
        ...     "equations": {"lag": {"y": {"storage": "T", "input": "u", "loss": "-y"}}},
        ... })
        >>> lag
        <Plant lag: u [V] -> y; states y [V]>
        """
        found = _entries(declaration, folder, where)
        if "model" in found:
            raise InputError(f"{where}: model: only the plant of a rig may be one; name the file in rig.toml")
        needed = {key: found.get(key, {}) for key in ("parameters", "inputs", "states", "equations")}
        return cls(name, **found | needed | {key: tuple(found.get(key, ())) for key in ("outputs", "required")})

    # -- switching terms ---------------------------------------------------------------------------------------------

    def without(self, *terms: str) -> "Plant":
        """This plant without the named terms, each `"equation.term"`."""
        plant = self
        for path in terms:
            where, _, term = path.partition(".")
            if term not in plant._place(where).terms:
                plant._fail(f"{where}.{term}", f"no such term; {where} has {', '.join(plant._place(where).terms)}")
            kept = {name: text for name, text in plant._place(where).terms.items() if name != term}
            plant = plant._with_terms(where, kept, {})
        return plant

    def with_term(
        self, where: str, term: str, expression: str, parameters: Mapping[str, Parameter] | None = None
    ) -> "Plant":
        """This plant with `expression` added to equation or definition `where` as `term`, or replacing that term.

        parameters: new parameters of the expression.
        """
        return self._with_terms(where, {**self._place(where).terms, term: expression}, parameters or {})

    def with_parameters(self, **values: float) -> "Plant":
        """This plant with other values of some parameters."""
        for symbol in values:
            if symbol not in self.parameters:
                self._fail("parameters", f"{shown(symbol)} is not among {', '.join(self.parameters)}")
        changed = {symbol: replace(self.parameters[symbol], value=float(v)) for symbol, v in values.items()}
        return replace(self, parameters={**self.parameters, **changed})

    def _place(self, where: str) -> Equation | Definition:
        place = self.equations.get(where) or self.definitions.get(where)
        if place is None:
            names = ", ".join((*self.definitions, *self.equations))
            self._fail(where, f"no such equation or definition; it has {names}")
        return place

    def _with_terms(self, where: str, terms: Mapping[str, str], parameters: Mapping[str, Parameter]) -> "Plant":
        place, known = self._place(where), {**self.parameters, **parameters}
        if isinstance(place, Equation):
            return replace(self, parameters=known, equations={**self.equations, where: replace(place, terms=terms)})
        return replace(self, parameters=known, definitions={**self.definitions, where: replace(place, terms=terms)})

    @property
    def shown(self) -> Collection[str]:
        """States that a simulator from outside only shows: nothing acts in their balances."""
        return self.outside.shown if self.outside else ()

    @property
    def whole(self) -> bool:
        """Whether a run may not begin within a recording: it has states that nobody records."""
        return bool(self.outside and self.outside.whole)

    @property
    def early(self) -> float:
        """The share of a step by which inputs act early."""
        return self.outside.early if self.outside else 0.0

    # -- asking it ---------------------------------------------------------------------------------------------------

    def unit(self, symbol: str) -> str:
        """Unit of a parameter, input, state or definition."""
        return self._units[symbol]

    def values(self, symbols: Iterable[str], signals: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Value of each symbol: from `signals` if it is there, else from its definition; shapes as in `signals`."""
        known = Values(self, signals)
        return {symbol: known[symbol] for symbol in symbols}

    def residual(self, where: str, signals: Mapping[str, np.ndarray], dt: float) -> np.ndarray:
        """The residual of one equation or definition on sampled signals.

        It is `storage * d(state)/dt - sum(terms)` for an equation, with the derivative by central differences
        (one-sided at both ends), and `measured symbol - sum(terms)` for a definition. Rates that `couples` names count
        like the equation's own. It has the unit of the terms and the shape of the signals.

        signals: inputs and states sampled every `dt` s, and the symbols of those definitions that were measured.
        Raises InputError naming the signal that is missing.
        """
        known, place = Values(self, signals), self._place(where)
        total = sum((known.evaluate(text) for text in place.terms.values()), start=0.0)
        if isinstance(place, Definition):
            if place.symbol not in signals:
                self._fail(f"definition {where}", f"{place.symbol} was not measured; give its signal")
            return np.asarray(signals[place.symbol]) - total
        rates = {place.state: place.storage, **place.couples}
        return sum(known.evaluate(text) * np.gradient(known[s], dt) for s, text in rates.items()) - total

    def initial(self) -> dict[str, float]:
        """Initial value of every state."""
        return {symbol: self.constant(state.initial) for symbol, state in self.states.items()}

    def constant(self, expression: float | str) -> float:
        """Value of a number or of an expression in the parameters."""
        if not isinstance(expression, str):
            return float(expression)
        value = float(Values(self, {}).evaluate(expression))
        if not np.isfinite(value):
            self._fail(shown(expression), f"is {value}; check the parameters in it")
        return value

    def needed(self, symbols: Iterable[str], known: Container[str] = ()) -> list[Definition]:
        """The definitions on which `symbols` depend, in their order, without those whose symbol is `known`."""
        wanted, found = set(symbols), []
        for definition in reversed([*self.definitions.values()]):
            if definition.symbol in wanted and definition.symbol not in known:
                found.append(definition)
                wanted |= names(definition.terms.values())
        return found[::-1]

    @cached_property
    def symbols(self) -> frozenset[str]:
        """The symbols of parameters, inputs, states and definitions."""
        return frozenset(self._units)

    @cached_property
    def _units(self) -> dict[str, str]:
        return {
            **{symbol: parameter.unit for symbol, parameter in self.parameters.items()},
            **self.inputs,
            **{symbol: state.unit for symbol, state in self.states.items()},
            **{definition.symbol: definition.unit for definition in self.definitions.values()},
        }

    # -- checks at declaration ---------------------------------------------------------------------------------------

    def _fail(self, where: str, problem: str) -> NoReturn:
        raise InputError(f"plant {self.name}: {where}: {problem}")

    def _declare(self, symbol: str, symbols: set[str]) -> None:
        if not is_symbol(symbol):
            where = symbol if is_name(symbol) else shown(symbol)
            self._fail(where, "is not a name for a quantity; use ASCII letters, digits and underscores, "
                       "a letter first, no word of Python and no function's name")  # fmt: skip
        if symbol in symbols:
            self._fail(symbol, "is declared twice; rename one")
        symbols.add(symbol)

    def _among(self, where: str, symbol: str, owners: Iterable[str]) -> None:
        if symbol not in owners:
            self._fail(where, f"{shown(symbol)} is not among {', '.join(owners)}")

    def _check_state(self, symbol: str, state: State, symbols: Container[str]) -> None:
        for which, known in (("initial", self.parameters), ("low", self.parameters), ("high", self.parameters),
                             ("start", symbols)):  # fmt: skip
            if isinstance(given := getattr(state, which), str):
                self._check(f"state {symbol}, {which}", given, known)
        if state.rate is not None and state.rate not in self.states:
            self._fail(f"state {symbol}", f"rate {shown(state.rate)} is no state; name the state that is its velocity")

    def _check_derived(self, symbols: Container[str]) -> None:
        for symbol, text in self.derived.items():
            self._among("derived", symbol, self.inputs)
            how, _, source = text.partition(" ")
            if how not in DERIVED or source not in symbols or source in self.derived:
                self._fail(f"derived {symbol}", f"{shown(text)}; give {', '.join(DERIVED)} and a recorded signal")

    def _check_terms(self, where: str, terms: Mapping[str, str], symbols: Container[str]) -> None:
        if len(terms) > TERMS:
            self._fail(where, f"has {len(terms)} terms; {TERMS} are the most, split it into definitions")
        for term, expression in terms.items():
            if not all(map(is_name, term.split("."))):
                self._fail(where, f"{shown(term)} is not a name for a term; use ASCII letters, digits and underscores")
            self._check(f"{where}, term {term}", expression, symbols)

    def _check(self, where: str, expression: str, symbols: Container[str]) -> None:
        try:
            found = parse(expression).names
        except InputError as error:
            self._fail(where, str(error))
        for name in found:
            if name not in symbols:
                self._fail(where, f"unknown name {shown(name)}{self._hint(name)}")

    def _hint(self, name: str) -> str:
        defined = {definition.symbol for definition in self.definitions.values()}
        return "; it is defined further down, move it up" if name in defined else "; declare it or correct the spelling"


# -- kinds (`greygate.reading`) of the entries that declare a plant, or an effect for one -----------------------------


def read_entries(path: Path) -> dict:
    """The entries of such a file by the names of `Plant`'s fields, of a plant that differs in them from another one."""
    return _entries(read_toml(path, "give a plant's TOML file"), path.parent, str(path))


def _entries(declaration: Mapping, folder: Path | str, where: str) -> dict:
    entries = {
        "parameters": named(_parameter, check_name),
        "inputs": named(line, check_name),
        "states": named(check_state, check_name),
        "equations": named(_equation, check_name),
        "outputs": listed(line),
        "definitions": named(partial(_definition, Path(folder)), check_name),
        "derived": named(line, check_name),
        "switches": named(line, check_name),
        "step": within(SHORTEST, np.inf, f"give {SHORTEST:g} s or more"),
        "required": listed(line),
        "closure": check_closure,
        "experiments": named(line, check_name),
        "model": check_file_name,  # which this plant adds to (`plants.kinds`)
    }
    return table(dict(declaration), f"{where}:", {}, entries)


def _parameter(value: object, where: str) -> Parameter:
    """`[value, "unit"]`, or with its tolerance and its meaning."""
    if not (isinstance(value, list) and 2 <= len(value) <= 4):
        raise InputError(f'{where} {shown(value)} is not a parameter; write [value, "unit"]')
    kinds = (number, line, within(0.0, np.inf, "give 0 or more"), line)
    return Parameter(*(kind(part, f"{where}[{i}]") for i, (kind, part) in enumerate(zip(kinds, value, strict=False))))


def _amount(value: object, where: str) -> float | str:
    """A number, or an expression."""
    return (check_expression if isinstance(value, str) else number)(value, where)


_STATE = {"initial": _amount, "low": _amount, "high": _amount, "rate": check_name, "start": check_expression}
check_terms = named(check_expression, check_name)  # `{ name = "expression", ... }`


def check_state(value: object, where: str) -> State:
    """`{ unit = "m", initial = 0.0, ... }`."""
    return State(**table(value, where, {"unit": line}, _STATE))


def _equation(value: object, where: str) -> Equation:
    """`state = { storage = "expression", term = "expression", ... }`, the storage 1 where it is left out."""
    state, where, terms = _sum(value, where)
    storage = check_expression(terms.pop("storage", "1"), entry_of(where, "storage"))
    couples = named(check_expression, check_name)(terms.pop("couples", {}), entry_of(where, "couples"))
    return Equation(state, check_terms(terms, where), storage, couples)


def _definition(folder: Path, value: object, where: str) -> Definition:
    """`symbol = { unit = "N", term = "expression", ... }`; `table = { file = "curve.csv", of = "q" }` is terms, too."""
    symbol, where, terms = _sum(value, where)
    if "unit" not in terms:
        raise InputError(f"{where} has no unit; write {symbol} = {{ unit = ..., ... }}")
    unit, curve = line(terms.pop("unit"), entry_of(where, "unit")), {}
    if "table" in terms:
        entry = entry_of(where, "table")
        found = table(terms.pop("table"), entry, {"file": check_file_name, "of": check_expression})
        curve = read_curve(folder / found["file"], found["of"])
    return Definition(symbol, unit, {**check_terms(terms, where), **curve})


def _sum(value: object, where: str) -> tuple[str, str, dict]:
    """(symbol, place of its sum, content of the sum)."""
    if not (isinstance(value, dict) and len(value) == 1 and isinstance(given := next(iter(value.values())), dict)):
        wish = 'write one line, symbol = { term = "expression", ... }'
        raise InputError(f"{where} {shown(value)} is not a sum of terms; {wish}")
    symbol = next(iter(value))
    return symbol, entry_of(where, symbol), dict(given)


class Values(dict):
    """Symbol -> array: from the given signals, else from parameters, else from definitions when first asked for."""

    def __init__(self, plant: Plant, signals: Mapping[str, np.ndarray]):
        super().__init__({symbol: np.asarray(values, dtype=np.float64) for symbol, values in signals.items()})
        self._plant = plant

    def __missing__(self, symbol: str):
        plant = self._plant
        if symbol in plant.parameters:
            self[symbol] = plant.parameters[symbol].value
        elif any(d.symbol == symbol for d in plant.definitions.values()):
            for definition in plant.needed({symbol}, self):
                self[definition.symbol] = sum(map(self.evaluate, definition.terms.values()), start=0.0)
        else:
            raise InputError(f"plant {plant.name}: signal {symbol} is missing; give it")
        return self[symbol]

    def evaluate(self, expression: str):
        """Value of an expression, with the shape of its symbols."""
        return parse(expression).over(self)
