"""A Python function as a plant: it gives the rates of the states, or the states after a step.

Effects add their terms to the rate of each state that is no position, or their forces to its balance where `storage`
says what the rate is multiplied with. The function is compiled where numba can; else it is called as it is, from the
same loop, one run at a time.
"""

import ctypes
import dis
import inspect
import re
import threading
import warnings
from collections import namedtuple
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from greygate.errors import InputError, shown
from greygate.plants.expressions import check_expression, check_name
from greygate.plants.outside import RUN
from greygate.plants.plant import Plant
from greygate.plants.simulator import TIME
from greygate.reading import named

ROUNDING = 1e-9  # of the larger of two numbers, by which they may differ where they are one
SHARES = (0.0, 0.5, 1.0)  # of a change of velocity that moves the position in a step: of Euler's, a good one, the other
UNCLEAR = 1e-6  # of a velocity, that a step must change it by for its share to be seen
PROBED = (0.3, 0.7)  # in units of the states, between which a state lies at which a function is tried
TRIED = (0.0, 1.0)  # likewise, what the inputs are there
READS_ALL = {"locals", "vars", "eval", "exec"}  # what may read an argument without naming it
KEPT = "let it depend on these alone; what it keeps from call to call is a state"
ROUGH = (ArithmeticError, ValueError)  # what a function raises beside where its formulas hold
COARSE = (np.float16, np.float32, np.complex64, np.complex128)  # JAX gives float32 unless jax_enable_x64 is set
CALLED = '''
from llvmlite import ir
from numba.extending import intrinsic


@intrinsic
def call(context, address, t, x, u, p, out):
    """Call the C function at an address, with a number and with addresses of arrays."""

    def generate(context, builder, signature, arguments):
        kind = ir.FunctionType(ir.VoidType(), [context.get_value_type(a) for a in signature.args[1:]])
        builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])
        return context.get_dummy_value()

    array = types.intp
    return types.void(types.intp, types.float64, array, array, array, array), generate


@jit
def ask(at, t, x, u):
    """Let the function write what it makes of the states x."""
    address, columns, now, own, p, made = at[0], at[1], at[2], at[3], at[4], at[5]
    for j in range(len(now)):
        now[j] = x[j]
    for j in range(len(columns)):
        own[j] = u[columns[j]]
    call(address, t, now.ctypes.data, own.ctypes.data, p.ctypes.data, made.ctypes.data)


@jit
def time_of(at, u, later):
    """s from the first sample, `later` s after a row of inputs began. Those rows that follow in a sample have one t."""
    column, clock = at[6], at[7]
    if column < 0:
        return np.nan
    if u[column] != clock[0]:
        clock[0], clock[1] = u[column], 0.0
    elif later == 0.0:
        clock[1] += clock[2]
    clock[2] = max(clock[2], later)
    return clock[0] + clock[1] + later
'''
RATES = f"""{CALLED}

@jit
def rates(at, x, u, later, dx):
    ask(at, time_of(at, u, later), x, u)
    made = at[5]
    for j in range(len(made)):
        dx[j] += made[j]
"""
STEP = f'''{CALLED}

@jit
def begin(at, x):
    at[7][0], at[7][2] = np.nan, at[8]


@jit
def accelerate(at, x, u, force):
    ask(at, time_of(at, u, 0.0), x, u)
    made, way, acting = at[5], at[9], at[10]
    for j in range(len(made)):
        if not np.isfinite(made[j]):
            return False
        way[j], acting[j] = made[j] - x[j], force[j]
    return True


@jit
def acceleration(at, i):
    return at[9][i] / at[8] + at[10][i]


@jit
def mobility(at, i):
    return 1.0


EXPLICIT = 0.5  # of a change of velocity that a force may resist in a step without shaking it, as Euler takes it


@jit
def advance(at, x, slope):
    """A force acts with what it is where the step begins, and what resists too much for that, with where it ends.

    What it adds to a velocity moves its position as what the function adds to that does.
    """
    made, h, way, acting, rate, share = at[5], at[8], at[9], at[10], at[11], at[12]
    for j in range(len(made)):
        resisting = max(slope[j] - EXPLICIT / h, 0.0)
        acting[j] = h * (acting[j] - resisting * way[j]) / (1.0 + h * resisting)
    for j in range(len(made)):
        x[j] = made[j] + acting[j]
        if rate[j] >= 0:
            x[j] += share[j] * h * acting[rate[j]]
'''
Function = Callable[..., Any]
ANY = named(lambda value, where: _listed(value), check_name)
STATES = named(lambda value, where: {"unit": value} if isinstance(value, str) else value, check_name)
STORAGE = named(check_expression, check_name)


def Simulator(
    rates: Function | None = None,
    *,
    step: Function | None = None,
    dt: float,
    states: Mapping[str, Any],
    inputs: Mapping[str, str] | None = None,
    parameters: Mapping[str, Sequence[Any]] | None = None,
    outputs: Sequence[str] | None = None,
    definitions: Mapping[str, Any] | None = None,
    storage: Mapping[str, str] | None = None,
    name: str = "simulator",
    compiled: bool | None = None,
) -> Plant:
    """The plant that a Python function simulates, for `simulate` and `diagnose`.

    rates: `rates(t, x, u, p)` gives d(states)/dt, (states,). step: `step(t, x, u, p)` gives the states dt s later,
    (states,), in its place. x (states,) and u (inputs,) are float64 in the order in which `states` and `inputs` name
    them; p is a named tuple of the parameters; t is s from the first sample: the plant of a function that uses it has
    an input `t`. The same arguments give the same result: what a function keeps from call to call is a state.
    dt: s, of a step: of Dormand-Prince 5 on `rates`, or the one that `step` takes. A sample is one step or more.
    states: symbol -> unit, or {"unit": ..., "rate": the state that is its velocity, "initial": ...}; inputs: symbol ->
    unit; parameters: symbol -> [value, unit, relative tolerance, meaning]: those with a tolerance are fitted; outputs:
    the symbols that are recorded, by default the states; definitions: what sensors read otherwise, as in `Plant.of`.
    storage: state -> what its rate is multiplied with in its balance, an expression: with "mass" effects act there in
    N, without it in the unit of the rate. A balance is called `motion_STATE` of a velocity, else `balance_STATE`.
    compiled: True: numba compiles the function, and it is as fast as a plant's file; False: it is called as it is, some
    microseconds each time; None: whichever can be, with a warning where it is the slower one. What a compiled function
    reads beside its arguments stays as it is now.

    An error of arithmetic, or a ValueError, is a state that is not finite. Raises InputError for a declaration as
    `Plant.of` does, for a function that raises, gives no rates of the states, or differs from call to call, and for one
    that numba cannot compile where `compiled` is True.

    >>> def cart(t, x, u, p):
    ...     return x[1], (u[0] - p.viscous * x[1]) / p.mass
    >>> pushed = Simulator(
    ...     cart, dt=1e-3,
    ...     states={"x": {"unit": "m", "rate": "v"}, "v": "m/s"}, inputs={"force": "N"}, outputs=["x"],
    ...     parameters={"mass": [20.0, "kg"], "viscous": [400.0, "N s/m", 0.1]}, storage={"v": "mass"},
    ... )
    >>> round(float(simulate(pushed, {"force": np.full(100, 8.0)})["x"][-1]), 6)  # m, after 99 ms
    0.001118
    """
    functions = [function for function in (rates, step) if function is not None]
    if len(functions) != 1:
        raise InputError(f"simulator {name}: give rates or step, one of them")
    plant = _declared(name, dt, states, inputs or {}, parameters or {}, outputs, definitions or {}, storage or {})
    told = _Told(functions[0], step is not None, plant)
    told.check()
    outside = (_Steps if told.stepping else _Rates)(told, _compiled(told, compiled), told.shares())
    clock = {TIME: "s"} if told.timed else {}
    return replace(plant, inputs={**plant.inputs, **clock}, outside=outside)


def _declared(name, dt, states, inputs, parameters, outputs, definitions, storage) -> Plant:
    """The plant without what the function computes."""
    where = f"simulator {name}"
    declared = STATES(states, f"{where}: states")
    ways = {s: d["rate"] for s, d in declared.items() if isinstance(d, dict) and d.get("rate")}
    for symbol in (storage := STORAGE(storage, f"{where}: storage")):
        if symbol not in declared or symbol in ways:
            given = ", ".join(s for s in declared if s not in ways)
            raise InputError(f"{where}: storage.{symbol}: is no state that effects act on; give {given}")
    equations = {}
    for symbol in declared:
        place = ("way_" if symbol in ways else "motion_" if symbol in ways.values() else "balance_") + symbol
        content = {"speed": ways[symbol]} if symbol in ways else {"storage": storage.get(symbol, "1")}
        equations[place] = {symbol: content}
    tables = {
        "states": declared,
        "inputs": inputs,
        "parameters": ANY(parameters, f"{where}: parameters"),
        "outputs": list(declared) if outputs is None else _listed(outputs),
        "definitions": definitions,
        "equations": equations,
        "step": dt,
    }
    return Plant.of(name, tables, where=where)


def _listed(given: Any) -> Any:
    """A tuple as the list that a file would have."""
    return list(given) if isinstance(given, tuple) else given


@dataclass(frozen=True, eq=False)
class _Told:
    """A function as it was given, and the plant that was declared for it."""

    function: Function
    stepping: bool
    plant: Plant

    @property
    def name(self) -> str:
        return f"simulator {self.plant.name}: {'step' if self.stepping else 'rates'}"

    @property
    def timed(self) -> bool:
        """Whether it may use the time: its code says where it does not."""
        code = getattr(getattr(self.function, "py_func", self.function), "__code__", None)
        first = int(inspect.ismethod(self.function))
        if code is None or code.co_argcount <= first or READS_ALL & {*code.co_names}:
            return True
        used = (i.argval for i in dis.get_instructions(code))
        return any(code.co_varnames[first] in (u if isinstance(u, tuple) else (u,)) for u in used)

    @property
    def places(self) -> np.ndarray:
        """Of each state the place of its velocity, or -1."""
        symbols = list(self.plant.states)
        return np.array([symbols.index(s.rate) if s.rate else -1 for s in self.plant.states.values()], np.int64)

    @cached_property
    def tuple_of(self) -> Any:
        """The named tuple of parameters."""
        return namedtuple("Parameters", [*self.plant.parameters])

    def probes(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Where it is tried: states (states,) at which it begins, and beside, each with some inputs (inputs,)."""
        start = np.array([*self.plant.initial().values()])
        beside = start + np.linspace(*PROBED, len(start))
        return [(x, np.full(len(self.plant.inputs), u)) for x in (start, beside) for u in TRIED]

    def at(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """What it gives there, as it gives it. Raises what it raises."""
        p = self.tuple_of(*(p.value for p in self.plant.parameters.values()))
        return self.function(0.0, x.copy(), u.copy(), p)

    def check(self) -> None:
        """Raise InputError where it gives no rates (states,), others the second time, or another rate of a position."""
        once, again = ([self.given(i, x, u) for i, (x, u) in enumerate(self.probes())] for _ in range(2))
        if any(not np.array_equal(one, other, equal_nan=True) for one, other in zip(once, again, strict=True)):
            raise InputError(f"{self.name}: gives two results for the same arguments; {KEPT}")
        for (x, _), found in zip(() if self.stepping else self.probes(), once, strict=False):
            self._check_ways(x, found)

    def given(self, place: int, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """What it gives there (states,), NaN where it raises; it must not where it begins, which is place 0."""
        try:
            found = self.at(x, u)
            kind = np.asarray(found).dtype
            made = np.asarray(found) if kind in COARSE else np.asarray(found, dtype=float)
        except Exception as error:
            if place or isinstance(error, ArithmeticError):
                return np.full(len(x), np.nan)
            raise InputError(f"{self.name}: raises {_said(error)} where it begins, with inputs of 0") from error
        if made.size != len(x) or found is None:
            given = "nothing" if found is None else f"{made.shape} numbers"
            raise InputError(f"{self.name}: gives {given}; give one for each of {len(x)} states")
        if kind in COARSE:
            wish = "let it compute in float64, for a fit lives on small differences"
            raise InputError(f"{self.name}: gives {kind}; {wish}")
        return made.reshape(len(x))

    def shares(self) -> np.ndarray:
        """Which of `SHARES` a step has, by the place of a position; the mean where it does not show."""
        found = np.full(len(self.plant.states), SHARES[1])
        for x, u in self.probes() if self.stepping else ():
            change = self.given(1, x, u) - x
            for j, i in enumerate(self.places):
                if i >= 0 and abs(change[i]) > UNCLEAR * abs(x[i]) + UNCLEAR * self.plant.step:
                    share = (change[j] / self.plant.step - x[i]) / change[i]
                    found[j] = min(SHARES, key=lambda known: abs(known - share))
        return found

    def _check_ways(self, x: np.ndarray, found: np.ndarray) -> None:
        symbols = list(self.plant.states)
        for j, i in enumerate(self.places):
            if i >= 0 and abs(found[j] - x[i]) > ROUNDING * max(abs(x[i]), abs(found[j])):
                problem = f"the rate of {symbols[j]} is {found[j]:g} where {symbols[i]} is {x[i]:g}"
                raise InputError(f"{self.name}: {problem}; leave its `rate` out, or correct it")


def _said(error: BaseException) -> str:
    return f"{type(error).__name__} ({shown(str(error))[1:-1]})"


@dataclass(frozen=True, eq=False)
class _Steps:
    """A function that takes steps, as an `Outside`. compiled: what numba makes of it, None where it makes nothing."""

    told: _Told
    compiled: Any
    share: np.ndarray
    lock: Any = field(default_factory=threading.Lock)  # what a function keeps, such as an environment, is one
    first: int = 0
    fixed: bool = True
    steps: bool = True
    whole: bool = False
    timed: bool = False
    early: float = 0.0
    shown: Collection[str] = ()
    loop: None = None
    source: str = STEP + RUN
    elements: Mapping[tuple[str, str], str] = field(default_factory=dict)
    coupled: Mapping[str, int] = field(default_factory=dict)

    @property
    def stepped(self) -> tuple[str, ...]:
        return tuple(self.told.plant.states)

    @property
    def forced(self) -> int:
        return len(self.told.plant.states)

    @property
    def parameters(self) -> tuple[str, ...]:
        return tuple(self.told.plant.parameters)

    @property
    def own(self) -> Collection[str]:
        return {f"{name}.{term}" for name, e in self.told.plant.equations.items() for term in e.terms}

    @contextmanager
    def lent(self, inputs: Sequence[str], values: Mapping[str, float], step: float) -> Iterator[tuple[Any, ...]]:
        plant, dt = self.told.plant, self.told.plant.step
        if self.fixed and abs(step - dt) > ROUNDING * dt:
            wish = "let a sample take one of them, or more; resample the recording, or give another dt"
            raise InputError(f"{self.told.name}: takes steps of {dt:g} s, not of {step:g} s; {wish}")
        columns = np.array([inputs.index(name) for name in plant.inputs], np.int64)
        p = np.array([values[symbol] for symbol in plant.parameters], float)
        x, made, way, acting = np.empty((4, len(plant.states)))
        u, clock = np.empty(len(columns)), np.array([np.nan, 0.0, 0.0])
        column = inputs.index(TIME) if self.told.timed else -1
        with self._address(x, u, p, made) as address:
            yield address, columns, x, u, p, made, column, clock, step, way, acting, self.told.places, self.share

    @contextmanager
    def _address(self, x: np.ndarray, u: np.ndarray, p: np.ndarray, made: np.ndarray) -> Iterator[int]:
        """The address of what C calls, for a run with these arrays. Raises InputError for what the function raises."""
        if self.compiled is not None:
            yield self.compiled.address
            return
        failed: InputError | None = None
        with self.lock:
            called = _Plain(self.told, x, u, p, made)
            try:
                yield called.address
            except InputError as error:
                failed = error
        called.tell(failed)


@dataclass(frozen=True, eq=False)
class _Rates(_Steps):
    """A function that gives rates, as a `Rated`."""

    fixed: bool = False
    steps: bool = False
    source: str = ""
    rates: str = RATES


class _Plain:
    """A function as it is, behind C's types, which reads x, u and p of a run and writes what it makes of them."""

    def __init__(self, told: _Told, x: np.ndarray, u: np.ndarray, p: np.ndarray, made: np.ndarray):
        self.told, self.raised = told, None
        function, values = told.function, told.tuple_of(*p.tolist())

        def called(t: float, *_: int) -> None:
            try:
                made[:] = np.asarray(function(t, x.copy(), u.copy(), values), dtype=float).reshape(len(made))
            except BaseException as error:
                made[:] = np.nan
                self.raised = self.raised or (error, [*x, *u])

        number, array = ctypes.c_double, ctypes.c_void_p
        self.called = ctypes.CFUNCTYPE(None, number, array, array, array, array)(called)
        self.address = ctypes.cast(self.called, ctypes.c_void_p).value or 0

    def tell(self, failed: InputError | None) -> None:
        """Raise what stopped a run: what the function raised, where that is no trial of a fit, or else `failed`."""
        error, at = self.raised or (None, [])
        if error is not None and not isinstance(error, Exception):
            raise error  # it was interrupted
        if error is not None and (failed is not None or not isinstance(error, ROUGH)):
            plant = self.told.plant
            where = ", ".join(f"{s} is {v:.6g}" for s, v in zip([*plant.states, *plant.inputs], at, strict=True))
            raise InputError(f"{self.told.name}: raises {_said(error)} where {where}") from error
        if failed is not None:
            raise failed


# -- what numba compiles ---------------------------------------------------------------------------------------------


class _NotCompiled(Exception):
    """Why numba does not compile a function."""


def _compiled(told: _Told, wanted: bool | None) -> Any:
    """The function as C calls it, void(t, x, u, p, made); None where it is to be called as it is."""
    if wanted is False:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what numba would rather see
            return _as_it_takes(told)
    except _NotCompiled as error:
        if wanted:
            raise InputError(
                f"{told.name}: numba does not compile it: {error}; mend that, or leave compiled out"
            ) from None
        slow = "runs in Python, which is slower: numba does not compile it"
        warnings.warn(f"{told.name}: {slow}: {error}; or say compiled=False", stacklevel=3)
        return None


def _as_it_takes(told: _Told) -> Any:
    """The function given arrays, or else tuples, which it may unpack. Raises _NotCompiled."""
    from numba import njit
    from numba.extending import is_jitted

    why = ""
    for tuples in (False, True):
        try:
            function = told.function
            jitted = function if is_jitted(function) else njit(error_model="numpy", nogil=True)(function)
            made = _compiled_for(told, jitted, tuples)
        except Exception as error:  # of many kinds
            why = why or _reason(error)
            continue
        _check_same(told, made)
        return made
    raise _NotCompiled(why)


def _reason(error: Exception) -> str:
    """The line in which numba says what it cannot do."""
    lines = [re.sub(r"\x1b\[[\d;]*m", "", text).strip() for text in str(error).splitlines()]
    told = [text for text in lines if text and not text.startswith("Failed in")]
    return shown((told or lines or [type(error).__name__])[0].rstrip(":."))[1:-1]


def _compiled_for(told: _Told, jitted: Any, tuples: bool) -> Any:
    from numba import carray, cfunc, njit, types
    from numba.np.unsafe.ndarray import to_fixed_tuple

    fixed: Any = to_fixed_tuple  # whose types are numba's own
    makes, plant = told.tuple_of, told.plant
    n, m, k = len(plant.states), len(plant.inputs), len(plant.parameters)

    @njit
    def vector(pointer, count):
        return carray(pointer, (count,)).copy()

    @njit
    def asked(t, x, u, p):
        return jitted(t, fixed(x, n), fixed(u, m), p) if tuples else jitted(t, x, u, p)

    def called(t, x, u, p, made):
        out = carray(made, (n,))
        try:
            found = np.asarray(asked(t, vector(x, n), vector(u, m), makes(*fixed(vector(p, k), k))))
            for j in range(n):
                out[j] = found[j]
        except Exception:
            for j in range(n):
                out[j] = np.nan

    array = types.CPointer(types.float64)
    return cfunc(types.void(types.float64, array, array, array, array))(called)


def _check_same(told: _Told, made: Any) -> None:
    """Raise _NotCompiled where a compiled function gives others than it gives as it is."""
    p = np.array([p.value for p in told.plant.parameters.values()])
    for x, u in told.probes():
        wanted, found = told.given(1, x, u), np.empty(len(x))
        pointers = [a.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for a in (x, u, p, found)]
        made.ctypes(0.0, *pointers)
        there = np.isfinite(wanted)
        if not np.allclose(found[there], wanted[there], rtol=ROUNDING, atol=0.0):
            raise _NotCompiled("compiled it gives other numbers than in Python")
