"""How a run that begins anew in short windows answers forces and inputs, to first order: a linear step for each sample.

    d[k + 1] = A[k] d[k] + F[k] f[k] + U[k] u[k]

d (states,): by how much the states move, from where each window begins; f (balances,): forces beside those of the
plant; u (inputs,): what is added to its inputs; f and u constant over a sample. A, F, U are differences of the plant's
own steps along a run. Where a step is dear, as of a simulator from outside, hundreds of effects are scored so by the
runs of some dozen.
"""

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from greygate.mismatch.cores import each
from greygate.mismatch.entries import Effect, Free
from greygate.plants.plant import Plant

PUSHED = "pushed_"  # before a balance: a parameter, a constant force there
SLIGHT = 1e-4  # of how much a state or an input moves: differences
ONCE = 1.0  # of a force, by which is seen how much moves with it

Step = Callable[[np.ndarray, np.ndarray, Mapping[str, float]], np.ndarray]
"""(states (k, n), what is added to the inputs (k, m), forces) -> the states a sample later (k, n)."""


def forced(plant: Plant) -> list[str]:
    """The balances on which forces act in a simulator from outside that has steps of its own."""
    if (outside := plant.outside) is None or not outside.steps:
        return []
    moved = outside.stepped[outside.first : outside.first + outside.forced]
    return [name for name, equation in plant.equations.items() if equation.state in moved]


def pushes(plant: Plant) -> Iterable[Effect]:
    """For each of these balances a constant force, which no hypothesis has."""
    for place in forced(plant):
        symbol = PUSHED + place
        yield Effect(symbol, "a force", (), (place,), (), (Free(symbol, ONCE),), {f"{place}.push": symbol})


class Responses:
    """The linear steps along a run.

    step: of the plant. states (samples, n), inputs (samples, m): of that run. restarts: samples at which a window
    begins. places: the balances.
    """

    def __init__(self, step: Step, states: np.ndarray, inputs: np.ndarray, restarts: np.ndarray, places: Iterable[str]):
        x, still = states[:-1], np.zeros_like(inputs[:-1])
        base = step(x, still, {})
        self.states, self.restarts, self.places = states, restarts, {place: j for j, place in enumerate(places)}
        self.acting = np.flatnonzero(np.any(states, axis=0))  # the others are of effects that do nothing
        spread = np.ptp(states, axis=0)

        def ahead(of: np.ndarray, j: int) -> tuple[np.ndarray, float]:
            size = SLIGHT * float(np.ptp(of[:, j])) or SLIGHT
            return size * (np.arange(of.shape[1]) == j), size

        def changed(to: np.ndarray, size: float) -> np.ndarray:
            return ((to - base) / size)[:, self.acting]

        def by_state(j: int) -> np.ndarray:
            move, size = ahead(states, j)
            return changed(step(x + move, still, {}), size)

        def by_input(j: int) -> np.ndarray:
            move, size = ahead(inputs, j)
            return changed(step(x, still + move, {}), size)

        def by_force(place: str) -> np.ndarray:
            far = step(x, still, {PUSHED + place: ONCE}) - base
            share = np.max(np.abs(far) / np.where(spread > 0, spread, np.inf))
            size = SLIGHT * ONCE / share if share > 0 else ONCE
            return changed(step(x, still, {PUSHED + place: size}), size)

        def slopes(found: list[np.ndarray]) -> np.ndarray:
            return np.nan_to_num(np.stack(found, axis=2)) if found else np.zeros((len(x), len(self.acting), 0))

        self.by_state = slopes(each(by_state, map(int, self.acting)))
        self.by_input = slopes(each(by_input, range(inputs.shape[1])))
        self.by_force = slopes(each(by_force, self.places))
        ends = np.append(restarts[1:], len(states))
        after = ((restarts + i)[restarts + i + 1 < ends] for i in range(int(np.max(ends - restarts)) - 1))
        self.steps = [(at, self.by_state[at]) for at in after]  # of all windows side by side

    def moved(self, begun: np.ndarray, more: np.ndarray, forces: Mapping[str, np.ndarray]) -> np.ndarray:
        """By how much the states move (samples, n).

        begun: by how much they do at the restarts (restarts, n). more: what is added to the inputs (samples, m).
        forces: by balance (samples,).
        """
        pushed = np.einsum("kij,kj->ki", self.by_input, more[:-1])
        for place, force in forces.items():
            pushed += self.by_force[:, :, self.places[place]] * ((force[:-1] + force[1:]) / 2)[:, None]
        found = np.zeros((len(self.states), len(self.acting)))
        found[self.restarts] = begun[:, self.acting]
        for at, by_state in self.steps:
            found[at + 1] = np.einsum("kij,kj->ki", by_state, found[at]) + pushed[at]
        out = np.zeros_like(self.states)
        out[:, self.acting] = found
        return out
