"""Makes a compiled fixed-step simulation of a plant's declaration.

The terms of a plant are written out as Python source and compiled by numba, for a loop of Dormand-Prince 5 steps that
all plants share. The source is kept under its hash in `$XDG_CACHE_HOME/greygate/plants` (`~/.cache` by default) with
numba's cache beside it, so that a plant is compiled once on a computer. Parameters, limits and initial states are
arguments, so changing them does not compile again; only which terms `when(p, ...)` are off by the plant's own values
stands in the source.
"""

import copy
import re
import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from greygate.errors import InputError
from greygate.generated import load
from greygate.plants import calling
from greygate.plants.expressions import names, parse
from greygate.plants.functions import FUNCTIONS, NUMPY, text
from greygate.plants.outside import Outside, Rated
from greygate.plants.plant import Definition, Equation, Plant, Values
from greygate.plants.recording import Recording

# Dormand and Prince (1980), the six stages that the fifth-order solution needs.
_STAGES = (
    (),
    ("1/5",),
    ("3/40", "9/40"),
    ("44/45", "-56/15", "32/9"),
    ("19372/6561", "-25360/2187", "64448/6561", "-212/729"),
    ("9017/3168", "-355/33", "46732/5247", "49/176", "-5103/18656"),
)
STEP = 1e-4  # s, of integration (thesis 5.2)
TIME = "t"  # an input of that name is the time
_STRENGTH = re.compile(r"\w+|abs\(\w+\)")  # a condition that is a parameter, or its size
BLOCK = 8  # terms that may be off, to ask for at once: of a hundred a dozen, and eight in the block of one that is on
_SOLUTION = ("35/384", "0", "500/1113", "125/192", "-2187/6784", "11/84")


def simulate(
    plant: Plant,
    inputs: Mapping[str, np.ndarray],
    *,
    sample_time: float = 1e-3,
    step: float | None = None,
    initial: Mapping[str, float] | None = None,
    channels: Iterable[str] | None = None,
    samples: int | None = None,
) -> Recording:
    """Simulate `plant` with zero-order-hold inputs and fixed Dormand-Prince 5 steps.

    inputs: symbol -> (samples,), each held for `sample_time` s, which must be a whole number of `step` s: by default
    0.1 ms, of a `Simulator` its own. An input t that is left out is the time, in s from the first sample.
    samples: how many, where the plant has no input.
    initial: values of states that do not start as declared.
    channels: symbols to record, default the plant's outputs; inputs are always recorded.

    Sample k is taken at k * sample_time, where input k begins to act: a state has its value at that instant, and a
    definition is computed from the states at that instant and input k.

    Raises InputError for missing inputs, inputs of unequal length, a step that does not divide the sample time, and
    unknown states or channels; and, naming state and time, for a state that is no longer finite.

    >>> round(float(simulate(axis, {"force": np.full(100, 8.0)})["x"][-1]), 6)  # m, after 99 ms
    0.001118
    """
    held = _inputs(plant, _timed(plant, inputs, samples, sample_time), samples)
    if step is None:
        step = STEP if plant.outside is None else plant.step
    substeps = round(sample_time / step) if step > 0 else 0
    if substeps < 1 or abs(substeps * step - sample_time) > 1e-9 * sample_time:
        raise InputError(f"plant {plant.name}: step {step} s does not divide the sample time {sample_time} s")
    start = plant.initial()
    for state in initial or {}:
        if state not in start:
            raise InputError(f"plant {plant.name}: initial: {state!r} is no state; it has {', '.join(start)}")
    start.update(initial or {})

    states = np.empty((len(held), len(plant.states)))
    symbols, values = list(plant.states), {symbol: p.value for symbol, p in plant.parameters.items()}
    with _lent(plant, values, sample_time / substeps) as at:
        failed = _loop(plant).restarted(
            np.array([[float(start[symbol]) for symbol in symbols]]),
            *_whole(plant),
            held,
            np.array([*values.values()]),
            *_bounds(plant, plant.constant),
            _rates(plant),
            sample_time / substeps,
            substeps,
            states,
            *at,
        )
        if failed >= 0:
            state = symbols[int(np.flatnonzero(~np.isfinite(states[failed]))[0])]
            raise InputError(
                f"plant {plant.name}: state {state} is not finite at {failed * sample_time:.6g} s; "
                "check parameters, inputs and initial states, or take a smaller step"
            )
    signals = {**dict(zip(symbols, states.T.copy(), strict=True)), **dict(zip(plant.inputs, held.T, strict=True))}
    names = [*plant.inputs, *(name for name in channels or plant.outputs if name not in plant.inputs)]
    recorded = {name: np.broadcast_to(v, len(held)).copy() for name, v in plant.values(names, signals).items()}
    return Recording(sample_time, recorded, {name: plant.unit(name) for name in names}, source=plant.name)


class Restarted:
    """A plant compiled for many runs, which restart at some samples. sample_time, step: as in `simulate`."""

    def __init__(self, plant: Plant, sample_time: float, step: float):
        self.plant = plant
        self.substeps = max(round(sample_time / step), 1)
        self.step = sample_time / self.substeps
        self.rate = _rates(plant)
        self.module = _loop(plant)

    def in_steps(self, substeps: int) -> "Restarted":
        """The same plant in so many steps a sample."""
        other = copy.copy(self)
        other.substeps, other.step = substeps, self.step * self.substeps / substeps
        return other

    def run(
        self,
        inputs: np.ndarray,
        restarts: np.ndarray,
        starts: np.ndarray,
        reset: np.ndarray,
        values: Mapping[str, float],
    ) -> np.ndarray:
        """Simulate: states (samples, states); from the first sample that is not finite on, all are NaN.

        restarts: rising sample indices, the first 0. starts: (restarts, states). reset: (states,), which of them
        restart; the others go on. values: symbol -> value of every parameter of the plant.
        """
        if not self.plant.states:
            return np.empty((len(inputs), 0))
        if self.plant.whole and len(restarts) > 1:
            raise InputError(f"plant {self.plant.name}: has states that nobody records, such as those of events, and "
                             "cannot begin anew within a recording; leave window_s out")  # fmt: skip
        scope = Values(self.plant, {})
        scope.update(values)
        low, high = _bounds(self.plant, lambda bound: scope.evaluate(bound) if isinstance(bound, str) else bound)
        out = np.empty((len(inputs), len(self.plant.states)))
        parameters = np.array([values[symbol] for symbol in self.plant.parameters])
        with _lent(self.plant, values, self.step) as at:
            failed = self.module.restarted(
                np.ascontiguousarray(starts, dtype=float), restarts, reset, inputs, parameters,
                low, high, self.rate, self.step, self.substeps, out, *at,
            )  # fmt: skip
        if failed >= 0:
            out[failed:] = np.nan
        return out


class Stepper:
    """A plant under way, a sample at a time, so that a controller can answer it, in steps of 0.1 ms."""

    def __init__(self, plant: Plant, sample_time: float = 1e-3):
        self.plant, self.sample_time = plant, sample_time
        self._restarted = Restarted(plant, sample_time, STEP)
        self._place = {symbol: i for i, symbol in enumerate(plant.states)}
        self._now = np.array([*plant.initial().values()])
        self._values = np.array([p.value for p in plant.parameters.values()])
        self._low, self._high = _bounds(plant, plant.constant)
        self._whole = _whole(plant)
        self._samples = 0

    def __getitem__(self, state: str) -> float:
        """The value of a state now, in its unit."""
        return float(self._now[self._place[state]])

    def set(self, parameter: str, value: float) -> None:
        """Change a parameter under way."""
        self._values[list(self.plant.parameters).index(parameter)] = value

    def step(self, inputs: Mapping[str, float]) -> None:
        """Hold the inputs for a sample. Raises InputError where a state is no longer finite."""
        held = np.array([[float(inputs[n]) for n in self.plant.inputs]] * 2)
        out, r = np.empty((2, len(self._now))), self._restarted
        failed = r.module.restarted(
            self._now[None], *self._whole, held, self._values, self._low, self._high, r.rate, r.step, r.substeps, out
        )
        self._samples += 1
        if failed >= 0:
            state = list(self._place)[int(np.flatnonzero(~np.isfinite(out[1]))[0])]
            raise InputError(
                f"plant {self.plant.name}: state {state} is not finite at {self._samples * self.sample_time:.6g} s; "
                "check the controller, or take a smaller step"
            )
        self._now = out[1]


@contextmanager
def _lent(plant: Plant, values: Mapping[str, float], step: float) -> Iterator[tuple]:
    """What `run` takes besides, of a plant that a simulator from outside steps."""
    if plant.outside is None:
        yield ()
        return
    with plant.outside.lent(list(plant.inputs), values, step) as at:
        yield (at,)


def _bounds(plant: Plant, value: Callable[[float | str], float]) -> tuple[np.ndarray, np.ndarray]:
    """The lowest and the highest value of each state. value: of a bound as it is declared."""
    low = [-np.inf if state.low is None else value(state.low) for state in plant.states.values()]
    high = [np.inf if state.high is None else value(state.high) for state in plant.states.values()]
    return np.array(low, float), np.array(high, float)


def _whole(plant: Plant) -> tuple[np.ndarray, np.ndarray]:
    """The restarts of a run that has none, and which states begin anew there."""
    return np.array([0]), np.ones(len(plant.states), bool)


def _rates(plant: Plant) -> np.ndarray:
    """The place of each state's velocity among the states; -1 where it has none."""
    states = list(plant.states)
    return np.array([-1 if s.rate is None else states.index(s.rate) for s in plant.states.values()], dtype=np.int64)


def _timed(
    plant: Plant, inputs: Mapping[str, np.ndarray], samples: int | None, sample_time: float
) -> Mapping[str, np.ndarray]:
    """The inputs with the time, where the plant has that input and none is given."""
    if TIME not in plant.inputs or TIME in inputs:
        return inputs
    count = samples if not inputs else np.size(next(iter(inputs.values())))
    return inputs if count is None else {**inputs, TIME: np.arange(count) * sample_time}


def _inputs(plant: Plant, inputs: Mapping[str, np.ndarray], samples: int | None) -> np.ndarray:
    if set(inputs) != set(plant.inputs):
        raise InputError(f"plant {plant.name}: inputs are {sorted(inputs)}; give {sorted(plant.inputs)}")
    if not plant.inputs:
        if samples is None or samples < 1:
            raise InputError(f"plant {plant.name} has no input; give samples, 1 or more")
        return np.empty((samples, 0))
    arrays = [np.asarray(inputs[name], dtype=np.float64) for name in plant.inputs]
    if len({array.shape for array in arrays}) != 1 or arrays[0].ndim != 1 or arrays[0].size == 0:
        shapes = dict(zip(plant.inputs, (array.shape for array in arrays), strict=True))
        raise InputError(f"plant {plant.name}: input shapes {shapes}; give each one sequence of the same length")
    for name, array in zip(plant.inputs, arrays, strict=True):
        if not np.isfinite(array).all():
            raise InputError(f"plant {plant.name}: input {name} is not finite at sample {np.isfinite(array).argmin()}")
    return np.stack(arrays, axis=1)


def source(plant: Plant) -> str:
    """Python source of the terms of `plant`, for the loop that runs it; it depends on names and expressions.

    Of the values it depends only on which terms are off, `when(p, ...)` with p of 0: `few_terms` does without these,
    and serves while they stay off; `asked` says which are on. It is written only from checked names and trees of
    checked expressions, because `Plant` refuses others.
    """
    lines = [_HEAD]
    for name in FUNCTIONS:
        if name != "when":  # `when` is written out in place
            lines += [*(["@jit"] if name not in NUMPY else []), text(name)]
    blocks: list[str] = []
    plant = _added(plant)
    full = _rates_of("all_terms", plant, blocks)
    bare = _rates_of("few_terms", _bare(plant), []) if blocks else ["few_terms = all_terms", ""]
    asked = [f"    _on[{i}] = {condition}" for i, condition in enumerate(blocks)]
    lines += [
        "@np.errstate(all='ignore')",
        "def asked(_p):",
        *_taken(asked, _p=plant.parameters),
        f"    _on = np.empty({len(blocks)}, np.bool_)",
    ]
    return "\n".join([*lines, *asked, "    return _on", "", *full, *bare])


def _added(plant: Plant) -> Plant:
    """The plant without the terms that a simulator from outside computes."""
    return plant if plant.outside is None else plant.without(*plant.outside.own)


def _taken(body: Iterable[str], **arrays: Iterable[str]) -> list[str]:
    """Lines that take from arrays the symbols that stand in a function's body: each line takes numba milliseconds."""
    used = {word for line in body for word in re.findall(r"\w+", line)}
    return [
        f"    {symbol} = {array}[{i}]"
        for array, symbols in arrays.items()
        for i, symbol in enumerate(symbols)
        if symbol in used
    ]


def _rates_of(name: str, plant: Plant, blocks: list[str]) -> list[str]:
    """Lines of a function that computes the states' rates. blocks: to which the condition of each block is added."""
    lines: list[str] = []
    used = names(t for equation in plant.equations.values() for t in equation.texts)
    for definition in plant.needed(used):
        lines += _summed(definition.symbol, definition, plant, blocks)
    states = list(plant.states)
    for group in coupled(plant):
        for i, equation in enumerate(group):
            lines += _summed(f"_b{i}", equation, plant, blocks)
        if len(group) > 1:
            lines += _solved(group, states)
            continue
        storage = parse(group[0].storage).source()
        lines.append(f"    _dx[{states.index(group[0].state)}] = _b0 / ({storage})")
    taken = _taken(lines, _p=plant.parameters, _u=plant.inputs, _x=plant.states)
    return ["@called", f"def {name}(_x, _u, _p, _on, _dx):", *taken, *(lines or ["    pass"]), ""]


def _off(plant: Plant, term: str) -> str | None:
    """The source of what turns a term on, if the plant's own parameters say that it is off."""
    condition = parse(term).condition
    if condition is None or not plant.parameters.keys() >= {*condition.names}:
        return None
    on = condition.over({symbol: plant.parameters[symbol].value for symbol in condition.names})
    return None if on != 0.0 else condition.source()


def _bare(plant: Plant) -> Plant:
    """The plant without the terms that are off: those of a hundred effects take time, though none acts."""

    def bare(place):
        return replace(place, terms={name: term for name, term in place.terms.items() if _off(plant, term) is None})

    definitions = {name: bare(place) for name, place in plant.definitions.items()}
    return replace(plant, definitions=definitions, equations={n: bare(e) for n, e in plant.equations.items()})


def coupled(plant: Plant) -> list[list[Equation]]:
    """The equations in groups whose rates are coupled; alone where they are not."""
    groups: list[list[Equation]] = []
    for equation in plant.equations.values():
        rates = {equation.state, *equation.couples}
        near = [g for g in groups if any(e.state in rates or equation.state in e.couples for e in g)]
        groups = [g for g in groups if g not in near] + [[*(e for g in near for e in g), equation]]
    return groups


def _solved(group: list[Equation], states: list[str]) -> list[str]:
    """Lines that solve the mass matrix of coupled equations for their rates, by elimination without pivots."""
    n = len(group)
    lines: list[str] = []
    for i, e in enumerate(group):
        rates = {e.state: e.storage, **e.couples}
        lines += [f"    _m{i}_{j} = {parse(rates.get(o.state, '0')).source()}" for j, o in enumerate(group)]
    for k in range(n):
        for i in range(k + 1, n):
            lines.append(f"    _r = _m{i}_{k} / _m{k}_{k}")
            lines += [f"    _m{i}_{j} -= _r * _m{k}_{j}" for j in range(k + 1, n)]
            lines.append(f"    _b{i} -= _r * _b{k}")
    for i in reversed(range(n)):
        known = "".join(f" - _m{i}_{j} * _dx[{states.index(group[j].state)}]" for j in range(i + 1, n))
        lines.append(f"    _dx[{states.index(group[i].state)}] = (_b{i}{known}) / _m{i}_{i}")
    return lines


def _summed(name: str, place: Equation | Definition, plant: Plant, blocks: list[str]) -> list[str]:
    """Lines that set `name` to the sum of the terms; those that are off stand behind, in blocks."""
    switched = [(parse(t).chosen.source(), c) for t in place.terms.values() if (c := _off(plant, t)) is not None]
    always = (f"({parse(t).source()})" for t in place.terms.values() if _off(plant, t) is None)
    lines = [f"    {name} = {' + '.join(always) or '0.0'}"]
    for first in range(0, len(switched), BLOCK):
        block = switched[first : first + BLOCK]
        lines.append(f"    if _on[{len(blocks)}]:")
        for term, condition in block:  # a statement each: an expression with `else` takes numba half as long again
            lines += [f"        if {condition} != 0.0:", f"            {name} += {term}"]
        plain = all(_STRENGTH.fullmatch(condition) for _, condition in block)  # else Python might answer otherwise
        blocks.append(" | ".join(f"({condition} != 0.0)" for _, condition in block) if plain else "True")
    return lines


def weights() -> list[list[str]]:
    """The weights of the six stages and of the solution, a row of fractions each."""
    return [[*row, *["0"] * (len(_SOLUTION) - len(row))] for row in (*_STAGES, _SOLUTION)]


def _rows() -> str:
    return ", ".join(f"[{', '.join(row)}]" for row in weights())


# Loops in place of array operations: numba compiles that in a third of the time.
BOUNDED = f'''

@jit
def hold(x, dx, low, high, rate, bounded):
    """Let no state at its bound, nor the rate of one, move further outward."""
    for j in bounded:
        moved = rate[j] if rate[j] >= 0 else j
        if (x[j] <= low[j] and dx[moved] < 0.0) or (x[j] >= high[j] and dx[moved] > 0.0):
            dx[moved] = 0.0


WEIGHTS = np.array([{_rows()}])
'''
_RUN = '''

@jit
def pieces(starts, restarts, reset, inputs, parameters, low, high, rate, h, substeps, out, of, on{at}):
    """Fill out[sample] with the state at each sample; return the first sample that is not finite, or -1.

    At restarts[i] the states in `reset` become starts[i]; the others go on.
    """
    n, count = starts.shape[1], 0
    k, bounded = np.empty((6, n)), np.empty(n, np.int64)
    x, y = np.empty(n), np.empty(n)
    for j in range(n):
        if low[j] > -np.inf or high[j] < np.inf:
            bounded[count] = j
            count += 1
    bounded = bounded[:count]
    for piece in range(len(restarts)):
        first = restarts[piece]
        last = restarts[piece + 1] if piece + 1 < len(restarts) else len(inputs) - 1
        for j in range(n):
            if piece == 0 or reset[j]:
                x[j] = starts[piece, j]
            out[first, j] = x[j]
        for sample in range(first, last):
            u = inputs[sample]
            for {substep} in range(substeps):
                for stage in range(6):
                    for j in range(n):
                        move = 0.0
                        for i in range(stage):
                            move += WEIGHTS[stage, i] * k[i, j]
                        y[j] = x[j] + h * move
                    summed(y, u, parameters, on, of, k[stage])
{rates}                    hold(y, k[stage], low, high, rate, bounded)
                for j in range(n):
                    move = 0.0
                    for i in range(6):
                        move += WEIGHTS[6, i] * k[i, j]
                    x[j] += h * move
                for j in bounded:
                    if x[j] < low[j]:
                        x[j] = low[j]
                        if rate[j] >= 0:
                            x[rate[j]] = max(x[rate[j]], 0.0)
                    elif x[j] > high[j]:
                        x[j] = high[j]
                        if rate[j] >= 0:
                            x[rate[j]] = min(x[rate[j]], 0.0)
            for j in range(n):
                out[sample + 1, j] = x[j]
            for j in range(n):
                if not np.isfinite(x[j]):
                    return sample + 1
    return -1
'''
_ALONE = {"at": "", "substep": "_", "rates": ""}
_RATED = {
    "at": ", at",
    "substep": "substep",
    "rates": """\
                    rates(at, y, u, (substep + WEIGHTS[stage].sum()) * h, k[stage])
""",
}
"""What the loop has besides where a simulator from outside gives rates."""
RESTARTED = '''

@jit
def pieces(starts, restarts, reset, inputs, parameters, low, high, rate, h, substeps, out{at}):
    """`run` piece by piece: at restarts[i] the states in `reset` become starts[i]; the others go on."""
    x = np.empty(starts.shape[1])
    for piece in range(len(restarts)):
        first = restarts[piece]
        last = restarts[piece + 1] + 1 if piece + 1 < len(restarts) else len(inputs)
        for j in range(len(x)):
            x[j] = starts[piece, j] if piece == 0 or reset[j] else out[first, j]
        failed = run(x, inputs[first:last], parameters, low, high, rate, h, substeps, out[first:last]{at})
        if failed >= 0:
            return first + failed
    return -1
'''


def _loop(plant: Plant) -> Any:
    """What runs a plant: its terms and their loop, or what stands for them where a simulator runs elsewhere."""
    of, text = plant.outside, source(plant)
    return _Loop(plant, text) if of is None or of.loop is None else of.loop(text)


class _Loop:
    """The loop of all plants, or of those of a kind of simulators, which calls a plant's terms by their address."""

    def __init__(self, plant: Plant, text: str):
        self.terms, of = _module(text), plant.outside
        self.sizes, self.resisting = tuple[int, ...](), False
        if of is None:
            loop = _RUN.format(**_ALONE)
        elif isinstance(of, Rated):
            loop = f"\n{of.rates}{_RUN.format(**_RATED)}"
        else:
            loop = of.source + RESTARTED.format(at=", of, on, at")
            self.sizes, self.resisting = (len(of.stepped), of.first, of.forced), _resisting(_added(plant), of)
        self.loop = _module(_LOOP + loop)

    def restarted(
        self, starts: np.ndarray, restarts: np.ndarray, reset: np.ndarray, inputs: np.ndarray, parameters: np.ndarray,
        low: np.ndarray, high: np.ndarray, rate: np.ndarray, h: float, substeps: int, out: np.ndarray, *at: Any,
    ) -> int:  # fmt: skip
        """Fill out (samples, states); the first sample that is not finite, or -1. See `Restarted.run`."""
        inputs, parameters = (np.ascontiguousarray(a, dtype=float) for a in (inputs, parameters))  # read by address
        on = self.terms.asked(parameters)
        acting = bool(on.any())
        terms = self.terms.all_terms if acting else self.terms.few_terms
        of = (terms.address, *self.sizes, int(self.resisting or acting))
        return self.loop.pieces(
            starts, restarts, reset, inputs, parameters, low, high, rate, h, substeps, out, of, on, *at
        )


def _resisting(plant: Plant, of: Outside) -> bool:
    """Whether terms of the plant itself depend on the velocities on which they act as forces."""
    moving = {*of.stepped[of.first : of.first + of.forced]}
    used = names(t for e in plant.equations.values() if e.state in moving for t in e.terms.values())
    return bool((used | names(t for d in plant.needed(used) for t in d.terms.values())) & moving)


_HEAD = """
import numpy as np
from numba import cfunc, njit, types

jit = njit(cache=True, error_model='numpy', nogil=True)
REAL, BYTE = types.CPointer(types.float64), types.CPointer(types.uint8)
called = cfunc(types.void(REAL, REAL, REAL, BYTE, REAL), cache=True, error_model='numpy')
"""
_LOOP = f"""
import numpy as np
from numba import njit, types

from greygate.plants.calling import call as added  # {calling.TEXT}

jit = njit(cache=True, error_model='numpy', nogil=True)
min, max = np.minimum, np.maximum  # of what is no number they make none


@jit
def summed(x, u, p, on, of, dx):
    # The rates of the states; for velocities of a simulator that steps, the force that effects add.
    added(of[0], x.ctypes.data, u.ctypes.data, p.ctypes.data, on.ctypes.data, dx.ctypes.data)
{BOUNDED}"""


@lru_cache(maxsize=64)
def _module(text: str) -> types.ModuleType:
    return load("plant", text)
