"""A simulator of somebody else's: what it must answer, so that a plant's equations may be what it computes.

Such a plant has the simulator's states first. In each balance of a velocity stand the terms that the simulator computes
itself, as far as they can be said, so that a diagnosis knows of them; the others are what effects add. Over each step
of the simulator the sum of these others acts on it as a force. So that a stiff one, such as dry friction, does not make
the step unstable, it is taken where the step ends: as a force less a resistance times the change of the velocity.

A simulator that gives rates in place of steps (`Rated`) is integrated as any plant, with what effects add to the rates.
"""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol, runtime_checkable

import numpy as np

from greygate.plants.expressions import is_symbol


class Outside(Protocol):
    """What a kind of simulator answers.

    fixed: whether it takes no other steps than `Plant.step`.
    stepped: the plant's states that it steps, its first; the last `forced` of them that are velocities are
    `stepped[first : first + forced]`, on each of which a force acts. shown: those that it only shows, at the samples.
    parameters: those of the plant that it takes. own: "equation.term" that it computes itself. elements: (general
    effect, equation) -> the parameter by which the simulator says that effect itself.
    early: the share of a step by which inputs act early: half with an integrator of first order.
    source: functions that numba compiles once for all of a kind: `run(x, inputs, parameters, low, high, rate, h,
    substeps, out, of, on, at)`, whose `at` is what `lent` lends; or what `RUN` needs for that, and `RUN`.
    steps: whether it has steps of its own; else of the plant. whole: whether it may not begin within a recording, for
    nobody records all of its states. timed: whether what it computes depends on time itself.
    coupled: velocity -> the number of the mass matrix that couples it with others of that number, if one does.
    loop: what runs the plant, of the source of its terms, in a process of its own; None: this one does.
    """

    @property
    def fixed(self) -> bool: ...
    @property
    def stepped(self) -> tuple[str, ...]: ...
    @property
    def first(self) -> int: ...
    @property
    def forced(self) -> int: ...
    @property
    def shown(self) -> Collection[str]: ...
    @property
    def parameters(self) -> Collection[str]: ...
    @property
    def own(self) -> Collection[str]: ...
    @property
    def elements(self) -> Mapping[tuple[str, str], str]: ...
    @property
    def source(self) -> str: ...
    @property
    def steps(self) -> bool: ...
    @property
    def whole(self) -> bool: ...
    @property
    def timed(self) -> bool: ...
    @property
    def early(self) -> float: ...
    @property
    def coupled(self) -> Mapping[str, int]: ...
    @property
    def loop(self) -> Callable[[str], Any] | None: ...
    def lent(self, inputs: Sequence[str], values: Mapping[str, float], step: float) -> AbstractContextManager[Any]:
        """Memory for a run in steps of `step` s, with such values of its parameters; no other run has it meanwhile.

        inputs: the columns of u. What numba takes as `at`.
        """
        ...


@runtime_checkable
class Rated(Outside, Protocol):
    """One that gives rates. rates: functions that numba compiles; `rates(at, x, u, later, dx)` adds those of `stepped`.

    later: s since the row of inputs u began to act. It has no `source`.
    """

    @property
    def rates(self) -> str: ...


@runtime_checkable
class Local(Outside, Protocol):
    """One that can leave out what does nothing near some states, and so take less time."""

    def near(self, recorded: Mapping[str, np.ndarray]) -> "Outside":
        """The same for runs that stay near recorded signals (samples,), by name."""
        ...


def symbols(names: Sequence[str], kind: str, taken: Collection[str] = ()) -> list[str]:
    """Names of a model as symbols: letters, digits and underscores, none twice; those without one are numbered.

    One that is not a name, or `taken`, has its kind before it.
    """
    out: list[str] = []
    for i, name in enumerate(names):
        symbol = re.sub(r"\W", "_", name, flags=re.ASCII) or f"{kind}{i + 1}"
        symbol = symbol if is_symbol(symbol) and symbol not in taken else f"{kind}_{symbol}"
        while symbol in (*out, *taken):
            symbol += "_"
        out.append(symbol)
    return out


RUN = '''
STEPPED, FIRST, FORCED, RESISTING = range(1, 5)  # places in `of`
STIFF = 0.1  # of a step's change of velocity that a force resists: from there on its end is solved for
CLOSE = 1e-3  # of that change, by which the end may be off
ROUNDS = 30  # of halving and secants, at most


@jit
def ended(x, u, p, on, of, h, trial, dx):
    """The forces at the velocities of `trial`, states of effects moved there along over the step."""
    n, stepped = len(x), of[STEPPED]
    for j in range(stepped, n):
        trial[j] = x[j]
    summed(trial, u, p, on, of, dx)
    if stepped < n:
        for j in range(stepped, n):
            trial[j] = x[j] + h * dx[j]
        summed(trial, u, p, on, of, dx)


@jit
def resisted(at, x, u, p, on, of, h, force, trial, moved, slope):
    """By how much each force falls with its velocity, from the beginning of a step to its end."""
    first, forced = of[FIRST], of[FORCED]
    for j in range(of[STEPPED]):
        trial[j] = x[j]
    for i in range(forced):
        trial[first + i] = x[first + i] + h * acceleration(at, i)
    ended(x, u, p, on, of, h, trial, moved)
    for i in range(forced):
        way, change = trial[first + i] - x[first + i], moved[first + i] - force[first + i]
        slope[i] = -change / way if change * way < 0.0 else 0.0
    for i in range(forced):
        if slope[i] * h * mobility(at, i) > STIFF:
            for j in range(forced):
                trial[first + j] = x[first + j]
            slope[i] = solved(at, i, x, u, p, on, of, h, force, trial, moved, slope[i])


@jit
def solved(at, i, x, u, p, on, of, h, force, trial, moved, slope):
    """The slope from the beginning to where the velocity i ends, by Illinois's rule of false position."""
    j, free = of[FIRST] + i, h * acceleration(at, i)
    gain = h * mobility(at, i)
    low, below, high, above = 0.0, -free, free, gain * slope * free
    for _ in range(ROUNDS):
        way = (low * above - high * below) / (above - below)
        trial[j] = x[j] + way
        ended(x, u, p, on, of, h, trial, moved)
        off = way - free - gain * (moved[j] - force[j])
        if abs(off) <= CLOSE * abs(free):
            break
        if (off < 0.0) == (above < 0.0):
            high, above = way, off
            below *= 0.5
        else:
            low, below = way, off
            above *= 0.5
    return max(-(moved[j] - force[j]) / way, 0.0) if way != 0.0 else slope


@jit
def run(x, inputs, parameters, low, high, rate, h, substeps, out, of, on, at):
    """Fill out[sample] with the state at each sample; return the first sample that is not finite, or -1."""
    n, stepped, count = len(x), of[STEPPED], 0
    k, y, force, moved, trial = np.empty((6, n)), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    slope, bounded = np.zeros(of[FORCED]), np.empty(n, np.int64)
    for j in range(n):
        out[0, j] = x[j]
        if j >= stepped and (low[j] > -np.inf or high[j] < np.inf):
            bounded[count] = j
            count += 1
    bounded = bounded[:count]
    begin(at, x)
    for sample in range(len(inputs) - 1):
        u = inputs[sample]
        for _ in range(substeps):
            summed(x, u, parameters, on, of, force)
            if not accelerate(at, x, u, force):
                return sample + 1
            if of[RESISTING]:
                resisted(at, x, u, parameters, on, of, h, force, trial, moved, slope)
            advance(at, x, slope)
            for stage in range(6 if stepped < n else 0):
                for j in range(n):
                    move = 0.0
                    for i in range(stage if j >= stepped else 0):
                        move += WEIGHTS[stage, i] * k[i, j]
                    y[j] = x[j] + h * move
                summed(y, u, parameters, on, of, k[stage])
                hold(y, k[stage], low, high, rate, bounded)
            for j in range(stepped, n):
                for i in range(6):
                    x[j] += h * WEIGHTS[6, i] * k[i, j]
                x[j] = min(max(x[j], low[j]), high[j])
        for j in range(n):
            out[sample + 1, j] = x[j]
            if not np.isfinite(x[j]):
                return sample + 1
    return -1
'''
"""The loop of plants that a simulator steps. of: the address of `all_terms` of `simulator.source`, or of `few_terms`;
how many states it steps; the first velocity among them, and how many; whether what is added may resist.

It needs `begin(at, x)`, which takes the states x; `accelerate(at, x, u, force)`, which says whether all is finite; then
`acceleration(at, i)` of velocity i; `mobility(at, i)`: about by how much a force accelerates it; `advance(at, x,
slope)`, which takes a step, the forces less by `slope[i]` times each change of velocity, to the states x after it.
"""
