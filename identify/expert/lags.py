"""Stiff linear states of a plant, which a step of the sample time cannot follow: exact difference equations."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from greygate.identify.expert.forms import Form, linear
from greygate.identify.expert.task import Task
from greygate.plants.expressions import names, parse

FAST = 0.3  # of a state, in a sample interval, from which an added-up rate is not accurate enough


@dataclass(frozen=True)
class Lag:
    """s(k) = own s(k-1) + inputs u(k-1) + constant, and the mean of s between k-1 and k likewise.

    own: (n, n), inputs: (n, m), constant: (n,).
    """

    states: tuple[str, ...]
    inputs_from: tuple[str, ...]
    own: np.ndarray
    inputs: np.ndarray
    constant: np.ndarray
    mean_own: np.ndarray
    mean_inputs: np.ndarray
    mean_constant: np.ndarray
    why: str


def lags(task: Task, constant: Callable[[str], Form | None]) -> list[Lag]:
    """The groups of states that are linear in themselves and the inputs, and fast against the sample time."""
    forms = _linear_states(task, constant)
    found, left = [], list(forms)
    while left:
        group = {left[0]}
        while grown := {s for s in left if s not in group and _joined(s, group, forms)}:
            group |= grown
        states = tuple(s for s in task.states if s in group)
        left = [s for s in left if s not in group]
        lag = _discrete(task, states, forms)
        if lag is not None:
            found.append(lag)
    return found


def _joined(state: str, group: set[str], forms: dict[str, Form]) -> bool:
    """Whether a state drives one of the group, or is driven by one."""
    return bool(group & set(forms[state].weights)) or any(state in forms[other].weights for other in group)


def _linear_states(task: Task, constant: Callable[[str], Form | None]) -> dict[str, Form]:
    """State -> its rate, for the largest set of states whose rates are linear in the set and the inputs."""
    chosen = {s for s in task.states if s not in task.targets}
    while True:
        allowed = chosen | set(task.inputs)

        def resolve(symbol: str) -> Form:
            found = constant(symbol)
            return found if found is not None else Form(weights={symbol: 1.0})

        forms = {}
        for state in chosen:
            equation = task.plant.equations[task.equations[state]]
            if not names(equation.texts) <= allowed | set(task.plant.parameters):
                continue
            terms = [linear(parse(text).tree, resolve) for text in equation.terms.values()]
            storage = linear(parse(equation.storage).tree, resolve)
            if storage is not None and storage.is_constant and not any(term is None for term in terms):
                total = sum((term for term in terms if term is not None), start=Form())
                forms[state] = total.times(Form(1 / storage.constant))
        if set(forms) == chosen:
            return {s: forms[s] for s in task.states if s in forms}
        chosen = set(forms)


def _discrete(task: Task, states: tuple[str, ...], forms: dict[str, Form]) -> Lag | None:
    inputs = tuple(n for n in task.inputs if any(n in forms[s].weights for s in states))
    a = np.array([[forms[s].weights.get(o, 0.0) for o in states] for s in states])
    b = np.array([[*(forms[s].weights.get(u, 0.0) for u in inputs), forms[s].constant] for s in states])
    fastest = float(np.abs(np.linalg.eigvals(a)).max()) * task.step
    if fastest < FAST:
        return None
    n, m = b.shape
    whole = np.zeros((2 * n + m, 2 * n + m))  # s, held inputs, and the integral of s
    whole[:n, :n], whole[:n, n : n + m], whole[n + m :, :n] = a, b, np.eye(n)
    moved = expm(whole * task.step)
    own, given = moved[:n, :n], moved[:n, n : n + m]
    mean, mean_given = moved[n + m :, :n] / task.step, moved[n + m :, n : n + m] / task.step
    why = f"they are linear, and turn by {fastest:.2g} in a step of {task.step:g} s"
    return Lag(states, inputs, own, given[:, :-1], given[:, -1], mean, mean_given[:, :-1], mean_given[:, -1], why)
