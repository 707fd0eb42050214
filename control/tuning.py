"""PI and predictive control of any machine, tuned on references and days of their own."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
from scipy.optimize import linear_sum_assignment

from greygate.control.choices import Case
from greygate.control.loop import Run
from greygate.control.modelled import Rolled, disturbances
from greygate.control.observer import Kalman
from greygate.control.own import Machine
from greygate.control.pi import Loops, Proportional, tuned
from greygate.control.prediction import hats, knots
from greygate.control.predictive import Aim, Limits, Predictive
from greygate.errors import InputError
from greygate.progress import Progress, silent

TUNING, SAMPLES = 50, 600  # seed of the reference and day, samples
GAINS = (0.1, 1.0, 10.0, 100.0)  # of an input's range over an output's: where tuning of PI begins
EVALUATIONS, ROUNDS = 120, 2  # of a loop's gains, of all loops
EARLY = 10  # samples after which an input is asked what it does to an output
STATES = (1e-6, 1e-4, 1e-2)  # of a state's size: by how much it departs from the model in a sample
LOADS = (1e-4, 1e-3, 1e-2, 0.1)  # of an input's range: by how much a load changes in a sample
HORIZONS, SMOOTHS = (12, 25, 50), (1e-4, 1e-2, 1.0, 100.0)
KNOTS = 7
MARGIN = 3.0  # standard deviations of a sensor, by which a limit of what it measures is kept
SENSED = 1e-4  # of a signal's size, RMS: no sensor is taken for a better one
TOLERANCE = 1e-2  # of a tracked output's size: the error that counts as one


def gains(machine: Machine) -> np.ndarray:
    """(tracked, inputs): what a tenth of an input's range does to an output early, over that output's size."""
    size, names = 0.2 * np.array([p.scale for p in machine.drives]), [p.name for p in machine.signals]
    moved = machine.rest + np.vstack([np.zeros(len(size)), np.diag(size)])
    within = np.clip(moved, machine.limits.low, machine.limits.high)
    within[1:] = np.where(within[1:] == within[0], machine.rest - np.diag(size), within[1:])
    states = np.tile(machine.model.start, (len(moved), 1))
    ends = machine.model.roll(states, np.repeat(within[:, None], EARLY, axis=1))[1][:, -1]
    by = np.diag(within[1:] - within[0])
    return ((ends[1:] - ends[0]) / by[:, None]).T[[names.index(n) for n in machine.tracked]]


def proportional(machine: Machine, progress: Progress = silent) -> Loops:
    """A PI controller of each tracked output by the input that moves it most. Raises InputError where none does."""
    effect = gains(machine)
    relative = np.abs(effect) * [abs(p.scale) for p in machine.drives] / machine.sizes[:, None]
    pairs = list(zip(*linear_sum_assignment(-relative), strict=True))
    if len(pairs) < len(machine.tracked) or not all(relative[pair] > 0 for pair in pairs):
        raise InputError(f"{machine.name}: not every tracked output is moved by an input of its own; track fewer")

    def loop(row: int, column: int, share: float) -> Proportional:
        gain = share * abs(machine.drives[column].scale) / machine.sizes[row] * np.sign(effect[row, column])
        reset, forward = 0.1 / (EARLY * machine.period), 0.01 * gain * EARLY * machine.period
        return Proportional(machine.tracked[row], _one(machine.limits, column), machine.period, gain, reset, forward)

    shocked = replace(machine, shocked=True)  # where gains that are too high are shown

    def track(loops: list[Proportional]) -> float:
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                controller = Loops(loops, [c for _, c in pairs], machine.rest)
                days = [day.run(controller, Case.LOAD, TUNING, SAMPLES) for day in (machine, shocked)]
                return float(np.linalg.norm([*map(machine.cost, days)]))
        except InputError:  # the machine left the range of numbers
            return np.inf

    starts = [[loop(row, column, share) for row, column in pairs] for share in GAINS]
    best = min(starts, key=track)
    for _ in range(ROUNDS if len(pairs) > 1 else 1):
        for i in range(len(pairs)):
            progress(f"tuning PI of {best[i].output}")
            best[i] = tuned(best[i], partial(_with, track, best, i), True, EVALUATIONS)
    return Loops(best, [c for _, c in pairs], machine.rest)


def _with(track: Callable[[list], float], loops: list, i: int, loop: Proportional) -> float:
    return track([*loops[:i], loop, *loops[i + 1 :]])


def _one(limits: Limits, column: int) -> Limits:
    low, high, rate = (
        float(np.broadcast_to(v, np.shape(limits.low))[column]) for v in (limits.low, limits.high, limits.rate)
    )
    return Limits(low, high, rate)


def _within(machine: Machine) -> Limits:
    """The limits, those of measured outputs narrower by their noise; a narrow range keeps half of its own."""
    outputs = {}
    for name, (low, high) in machine.limits.outputs.items():
        room = min(MARGIN * machine.noise.get(name, 0.0), (high - low) / 4)
        outputs[name] = (low + room, high - room)
    return replace(machine.limits, outputs=outputs)


class Predicted:
    """Predictive control with the observer that gives it the state, and what disturbs."""

    def __init__(self, machine: Machine, observer: Kalman, horizon: int, smooth: float):
        tracked = [next(p for p in machine.signals if p.name == n) for n in machine.tracked]
        aims = [Aim(p.name, TOLERANCE * s, smooth) for p, s in zip(tracked, machine.sizes, strict=True)]
        prediction = Rolled(observer.model, machine.drives, machine.signals, hats(knots(horizon, min(KNOTS, horizon))))
        self.predictive = Predictive(prediction, aims, _within(machine))
        self.observer, self.ahead, self._measured = observer, horizon, [*machine.noise]

    def reset(self) -> None:
        self.predictive.reset()
        self.observer.reset()

    def __call__(self, measured: Mapping[str, float], before: np.ndarray, reference: np.ndarray) -> np.ndarray:
        self.predictive.applied(before)
        state = self.observer.corrected(before, np.array([measured[n] for n in self._measured]))
        return self.predictive(state, reference[1:])


class Observers:
    """Extended Kalman filters of the state and of what disturbs, by how much both depart from the model in a sample.

    done: a run, from which come sizes and places. Raises InputError where the model diverges on its inputs.
    """

    def __init__(self, machine: Machine, done: Run):
        inputs, states = np.vstack([machine.rest, done.input[:-1]]), [machine.model.start]
        for given in inputs:
            states.append(machine.model.roll(states[-1][None], given[None, None])[0][0])
        sizes = np.abs(states).max(axis=0)
        if not np.isfinite(sizes).all():
            raise InputError(f"{machine.name}: the model diverges on what PI control did; give another one")
        sizes[sizes == 0] = 1.0
        names, own = [*machine.noise], [abs(p.scale) for p in machine.signals]
        order = sorted(range(len(names)), key=lambda i: names[i] in machine.tracked)
        ranges, middle = np.array([2 * abs(p.scale) for p in machine.drives]), len(states) // 2
        held, seen = inputs[min(middle, len(inputs) - 1)], {i: own[i] for i in order}
        self.model = disturbances(machine.model, states[middle], held, sizes, ranges, seen)
        self._noise = {i: max(machine.noise[n], SENSED * own[i]) for i, n in enumerate(names)}
        told = [ranges[i] for i in self.model.on_inputs] + [own[i] for i in self.model.on_signals]
        self._sizes, self._inner = np.append(sizes, told), len(sizes)

    def tuned(self, state: float, load: float) -> Kalman:
        """state, load: shares of the sizes of both."""
        process = self._sizes * np.where(np.arange(len(self._sizes)) < self._inner, state, load)
        return Kalman(self.model, self._noise, process * self.model.free, self._sizes)


def predicted(machine: Machine, done: Run, progress: Progress = silent) -> Predicted:
    """The predictive controller with the observer, the smoothness and the horizon that track best in a disturbed run.

    done: a run under PI control.
    """
    sees = Observers(machine, done)

    def best(choices: Iterable[tuple]) -> tuple:
        return min(choices, key=cost)

    def cost(choice: tuple) -> float:
        progress(f"tuning predictive control: horizon {choice[2]}")
        return machine.cost(machine.run(made(choice), Case.LOAD, TUNING, SAMPLES))

    def made(choice: tuple) -> Predicted:
        state, load, horizon, smooth = choice
        return Predicted(machine, sees.tuned(state, load), horizon, smooth)

    found = best(product(STATES, LOADS, HORIZONS[1:2], SMOOTHS[1:2]))
    found = best((*found[:3], smooth) for smooth in SMOOTHS)
    return made(best((*found[:2], horizon, found[3]) for horizon in HORIZONS))
