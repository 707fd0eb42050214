"""A plant declared once: states, inputs, outputs, parameters, and balance equations by name.

Every equation and every intermediate quantity is a sum of *named terms*, each an arithmetic expression in a string.
The compiled simulation (`simulate`), the residual of one equation on measured signals (`Plant.residual`) and the
switching of single terms (`without`, `with_term`) all work on this one declaration.
"""

import ast
import keyword
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import NoReturn

import numpy as np

from greygate.errors import InputError

FUNCTIONS = {
    "sqrt": ("x", "np.sqrt(x)"),
    "exp": ("x", "np.exp(x)"),
    "log": ("x", "np.log(x)"),
    "sin": ("x", "np.sin(x)"),
    "cos": ("x", "np.cos(x)"),
    "tanh": ("x", "np.tanh(x)"),
    "sign": ("x", "np.sign(x)"),
    "abs": ("x", "np.abs(x)"),
    "min": ("x, y", "np.minimum(x, y)"),
    "max": ("x, y", "np.maximum(x, y)"),
    "when": ("condition, x", "np.where(condition != 0.0, x, 0.0)"),
    "orifice": ("u, p_1, p_2", "np.maximum(u, 0.0) * np.sign(p_1 - p_2) * np.sqrt(np.abs(p_1 - p_2))"),
}
"""Function of an expression -> (arguments, body): one text for NumPy arrays and for the compiled simulation."""

_ARITHMETIC = (
    ast.Name, ast.Load, ast.Constant, ast.Call, ast.UnaryOp, ast.UAdd, ast.USub,
    ast.BinOp, ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow,
)  # fmt: skip
_RESERVED = {"np", "njit", "jit", "derivative", "hold", "run", *FUNCTIONS}


@dataclass(frozen=True)
class Parameter:
    """A constant of the plant: `value` in `unit`, known to `tolerance` (relative, 0 = known)."""

    value: float
    unit: str
    tolerance: float = 0.0
    meaning: str = ""


@dataclass(frozen=True)
class State:
    """A state in `unit`; `initial`, `low` and `high` are numbers or expressions in the parameters.

    The state is held within [`low`, `high`]; on a bound neither it nor the state `rate`, its velocity, moves further
    outward. A stroke stop, a saturation, a pressure that cannot fall below zero.
    start: where it begins when a run starts within a recording, from parameters, inputs, states and definitions.
    """

    unit: str
    initial: float | str = 0.0
    low: float | str | None = None
    high: float | str | None = None
    rate: str | None = None
    start: str | None = None


@dataclass(frozen=True)
class Equation:
    """A balance: `storage` * d(`state`)/dt = sum of `terms` (name -> expression)."""

    state: str
    terms: Mapping[str, str]
    storage: str = "1"


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
    definitions: name -> Definition, each using only those before it
    equations:  name -> Equation
    outputs:    symbols (states, definitions or inputs) that a simulation returns
    derived:    input -> how it is made of a recorded one, "rate x_motor" (`Plant.derive`)
    switches:   parameter -> the parameter whose value in a data sheet turns it from 0 to 1
    required:   parameters that a data sheet must give
    step:       of integration that suits it, s

    All names are checked here. Raises InputError naming plant, equation and term.
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

    def __post_init__(self):
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
            for which in ("initial", "low", "high"):
                if isinstance(bound := getattr(state, which), str):
                    self._check(f"state {symbol}, {which}", bound, set(self.parameters))
            if state.rate is not None and state.rate not in self.states:
                self._fail(f"state {symbol}", f"rate {state.rate!r} is no state; name the state that is its velocity")
            if state.start is not None:
                self._check(f"state {symbol}, start", state.start, symbols)
        for table, owners in (
            ("derived", self.inputs),
            ("switches", self.parameters),
            ("required", self.parameters),
        ):
            for symbol in getattr(self, table):
                if symbol not in owners:
                    self._fail(table, f"{symbol!r} is not among {', '.join(owners)}")
        for name, equation in self.equations.items():
            if name in self.definitions:
                self._fail(f"equation {name}", "a definition has this name too; rename one")
            self._check(f"equation {name}, storage", equation.storage, symbols)
            self._check_terms(f"equation {name}", equation.terms, symbols)
        balanced = [equation.state for equation in self.equations.values()]
        for state in (*self.states, *balanced):
            if state not in self.states:
                self._fail("equations", f"{state!r} is no state; declare it")
            if balanced.count(state) != 1:
                self._fail("equations", f"state {state} has {balanced.count(state)} equations; give it one")
        for output in self.outputs:
            if output not in symbols - set(self.parameters):
                self._fail("outputs", f"{output!r} is no state, definition or input")

    @classmethod
    def read(cls, path: Path | str) -> "Plant":
        """The plant of a TOML file, as `plants/rigs/*.toml`; its name is the file's.

        Raises InputError naming file, line or entry.
        """
        path = Path(path)
        try:
            table = tomllib.loads(path.read_text())
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror}); give a plant's TOML file") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: is no TOML ({error}); mend that line") from None
        known = (
            "step", "outputs", "inputs", "derived", "parameters", "required", "switches", "states", "definitions",
            "equations",
        )  # fmt: skip
        for key in table:
            if key not in known:
                raise InputError(f"{path}: unknown entry {key!r}; a plant file has {', '.join(known)}")
        entries = _Entries(path)
        return cls(
            path.stem,
            {s: Parameter(*entries.numbered(f"parameters.{s}", v)) for s, v in table.get("parameters", {}).items()},
            {s: entries.text(f"inputs.{s}", v) for s, v in table.get("inputs", {}).items()},
            {s: entries.made(State, f"states.{s}", v) for s, v in table.get("states", {}).items()},
            {n: Equation(*entries.sum(f"equations.{n}", v, "storage")) for n, v in table.get("equations", {}).items()},
            tuple(table.get("outputs", ())),
            {
                n: Definition(*entries.sum(f"definitions.{n}", v, "unit"))
                for n, v in table.get("definitions", {}).items()
            },
            {s: entries.text(f"derived.{s}", v) for s, v in table.get("derived", {}).items()},
            {s: entries.text(f"switches.{s}", v) for s, v in table.get("switches", {}).items()},
            float(table.get("step", cls.step)),
            tuple(table.get("required", ())),
        )

    # -- switching terms ---------------------------------------------------------------------------------------------

    def without(self, *terms: str) -> "Plant":
        """This plant with the named terms, `"equation.term"`, left out."""
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

        parameters: those that the expression brings with it.
        """
        return self._with_terms(where, {**self._place(where).terms, term: expression}, parameters or {})

    def with_parameters(self, **values: float) -> "Plant":
        """This plant with other parameter values."""
        for symbol in values:
            if symbol not in self.parameters:
                self._fail("parameters", f"{symbol!r} is not among {', '.join(self.parameters)}")
        changed = {symbol: replace(self.parameters[symbol], value=float(v)) for symbol, v in values.items()}
        return replace(self, parameters={**self.parameters, **changed})

    def _place(self, where: str) -> Equation | Definition:
        place = self.equations.get(where) or self.definitions.get(where)
        if place is None:
            names = ", ".join((*self.definitions, *self.equations))
            self._fail(where, f"no such equation or definition; it has {names}")
        return place

    def _with_terms(self, where: str, terms: Mapping[str, str], parameters: Mapping[str, Parameter]) -> "Plant":
        table = "equations" if where in self.equations else "definitions"
        changed = {**getattr(self, table), where: replace(self._place(where), terms=terms)}
        return replace(self, parameters={**self.parameters, **parameters}, **{table: changed})

    # -- asking it ---------------------------------------------------------------------------------------------------

    def unit(self, symbol: str) -> str:
        """Unit of a parameter, input, state or definition."""
        return self._units[symbol]

    def values(self, symbols: Iterable[str], signals: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Each symbol from `signals` where it is there, else computed from its definition; shapes as in `signals`."""
        known = Values(self, signals)
        return {symbol: known[symbol] for symbol in symbols}

    def residual(self, where: str, signals: Mapping[str, np.ndarray], dt: float) -> np.ndarray:
        """What one equation leaves unexplained on sampled signals.

        For an equation `storage * d(state)/dt - sum(terms)`, the derivative by central differences (one-sided at both
        ends); for a definition `measured symbol - sum(terms)`. In the unit of the terms; shape as the signals.

        signals: inputs and states sampled every `dt` s, and any definition's symbol that was measured.
        Raises InputError naming the signal that is missing.
        """
        known, place = Values(self, signals), self._place(where)
        total = sum((known.evaluate(text) for text in place.terms.values()), start=0.0)
        if isinstance(place, Definition):
            if place.symbol not in signals:
                self._fail(f"definition {where}", f"{place.symbol} was not measured; give its signal")
            return np.asarray(signals[place.symbol]) - total
        return known.evaluate(place.storage) * np.gradient(known[place.state], dt) - total

    def initial(self) -> dict[str, float]:
        """Initial value of every state."""
        return {symbol: self.constant(state.initial) for symbol, state in self.states.items()}

    def constant(self, expression: float | str) -> float:
        """Value of a number or of an expression in the parameters."""
        return float(Values(self, {}).evaluate(expression) if isinstance(expression, str) else expression)

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
        if not symbol.isidentifier() or symbol.startswith("_") or keyword.iskeyword(symbol) or symbol in _RESERVED:
            self._fail(symbol, "is no name for a quantity; use letters, digits and underscores, no function's name")
        if symbol in symbols:
            self._fail(symbol, "is declared twice; rename one")
        symbols.add(symbol)

    def _check_terms(self, where: str, terms: Mapping[str, str], symbols: set[str]) -> None:
        for term, expression in terms.items():
            self._check(f"{where}, term {term}", expression, symbols)

    def _check(self, where: str, expression: str, symbols: set[str]) -> None:
        try:
            tree = ast.parse(expression.strip(), mode="eval").body
        except (SyntaxError, ValueError) as error:
            self._fail(where, f"{expression!r} is no expression ({getattr(error, 'msg', error)})")
        called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
        for node in ast.walk(tree):
            match node:
                case ast.Call(func=ast.Name(id=name), args=arguments) if name in FUNCTIONS:
                    if len(arguments) != (wanted := FUNCTIONS[name][0].count(",") + 1):
                        self._fail(where, f"{name} takes {wanted} arguments, {expression!r} gives {len(arguments)}")
                case ast.Call(func=function):
                    self._fail(where, f"unknown function {ast.unparse(function)!r}; known are {', '.join(FUNCTIONS)}")
                case ast.Name(id=name) if name not in symbols and id(node) not in called:
                    self._fail(where, f"unknown name {name!r}{self._hint(name)}")
                case ast.Constant(value=value) if type(value) not in (int, float):
                    self._fail(where, f"{value!r} in {expression!r} is no number; write a decimal number")
                case _ if not isinstance(node, _ARITHMETIC):
                    self._fail(where, f"{expression!r} is not arithmetic; use + - * / ** and the known functions")

    def _hint(self, name: str) -> str:
        defined = {definition.symbol for definition in self.definitions.values()}
        return "; it is defined further down, move it up" if name in defined else "; declare it or mend the spelling"


@dataclass(frozen=True)
class _Entries:
    """Checked entries of the plant file `path`."""

    path: Path

    def fail(self, where: str, problem: str) -> NoReturn:
        raise InputError(f"{self.path}: {where}: {problem}")

    def text(self, where: str, value) -> str:
        if not isinstance(value, str):
            self.fail(where, f"{value!r} is no text; write it in quotes")
        return value

    def numbered(self, where: str, value) -> tuple:
        """(value, unit, ...) of `[1.4e9, "Pa"]`."""
        if not (isinstance(value, list) and len(value) > 1 and type(value[0]) in (int, float)):
            self.fail(where, f'{value!r}; write [value, "unit"]')
        return float(value[0]), *value[1:]

    def made(self, kind: type, where: str, value):
        try:
            return kind(**value)
        except TypeError as error:
            self.fail(where, f"{value!r} ({error}); write {{ unit = ... }}")

    def sum(self, where: str, table, extra: str) -> tuple:
        """(symbol, ...) of `symbol = { extra = ..., term = "expression", ... }`."""
        if not (isinstance(table, dict) and len(table) == 1 and isinstance(next(iter(table.values())), dict)):
            self.fail(where, 'write one line, symbol = { term = "expression", ... }')
        symbol, terms = next(iter(table.items()))
        terms = {name: self.text(f"{where}, {name}", text) for name, text in terms.items()}
        if extra == "storage":
            storage = terms.pop(extra, "1")
            return symbol, terms, storage
        if extra not in terms:
            self.fail(where, f"has no {extra}; write {symbol} = {{ {extra} = ..., ... }}")
        return symbol, terms.pop(extra), terms


class Values(dict):
    """Symbol -> array: given signals first, then parameters, then definitions, computed when first asked for."""

    def __init__(self, plant: Plant, signals: Mapping[str, np.ndarray]):
        super().__init__({symbol: np.asarray(values, dtype=np.float64) for symbol, values in signals.items()})
        self._plant = plant

    def __missing__(self, symbol: str):
        plant = self._plant
        if symbol in FUNCTIONS:
            raise KeyError(symbol)  # eval looks among its globals next
        if symbol in plant.parameters:
            value = plant.parameters[symbol].value
        elif definition := next((d for d in plant.definitions.values() if d.symbol == symbol), None):
            value = sum((self.evaluate(text) for text in definition.terms.values()), start=0.0)
        else:
            raise InputError(f"plant {plant.name}: signal {symbol} is missing; give it")
        self[symbol] = value
        return value

    def evaluate(self, expression: str):
        return eval(_code(expression), _namespace(), self)


@cache
def _code(expression: str):
    return compile(expression.strip(), "<expression>", "eval")


@cache
def _namespace() -> dict:
    space: dict = {"np": np, "__builtins__": {}}
    for name, (arguments, body) in FUNCTIONS.items():
        exec(f"def {name}({arguments}): return {body}", space)
    return space
