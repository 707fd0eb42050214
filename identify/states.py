"""A network of states: a linear state space, which is balanced, with neurons in its next state and in its output.

    x(k) = A x(k-1) + B u(k-1) + E tanh(F x(k-1) + G u(k-1) + h) + b
    y(k) = C x(k) + D u(k) + K tanh(L x(k) + M u(k) + n) + c

It begins as a linear model of the ladder in other coordinates, in which every state moves as much as its signals do
(Schoukens 2021, Paduart 2010): neurons are then trained far more easily than between taps, which are nearly alike. A
model whose taps stand some samples apart is carried to one sample by the root of its matrix. Of an integrating model,
y(k) is what its output adds in a sample.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import fractional_matrix_power, solve_discrete_lyapunov

from greygate.errors import InputError
from greygate.identify.ladder import LOOP, NEURONS, PAST, RATE, ROOM, STATE, Form, Orders, own, shrunk, summed
from greygate.models.families.blocks import nguyen_widrow
from greygate.models.network import Layer, Network, Port
from greygate.models.training.record import Record

WITHIN = 0.98  # radius within which poles count as stable, to balance by; a slower pole only shortens its state
REAL = 1e-9  # part of a matrix root that may be imaginary: rounding


class Linear(NamedTuple):
    """x(k+1) = A x + B u + b, y = C x + D u + c. A (n, n), B (n, m), C (1, n), D (1, m), b (n,), c ()."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray
    rest: np.ndarray
    level: float


def states(
    form: Form, orders: Orders, inputs: Sequence[Port], output: Port, line: Network, pieces: Sequence[Record], seed: int
) -> Network:
    """The network of states that begins as the linear model `line`. Raises InputError where that has none."""
    space = spread(balanced(realised(line, orders, inputs, output)), orders, inputs, pieces)
    taken = [p.name for p in (*inputs, output)]
    within, loop, name, inner, outer = (own(n, taken) for n in (PAST, LOOP, STATE, f"{STATE}_{NEURONS}", NEURONS))
    count = len(space.a)
    network = Network("network", list(inputs), [output])
    late = dict(zip(inputs, orders.delays, strict=True))
    before = {f"{p.name}_z{d + 1}": (p.name, d + 1) for p, d in late.items()}
    now = {f"{p.name}_z{d}": (p.name, d) for p, d in late.items()}
    columns = dict(zip(before, space.b.T[:, :, None], strict=True))
    reads = {within: np.zeros((form.states, count)), **{port: np.zeros((form.states, 1)) for port in before}}
    network.add(inner, Layer(reads, np.zeros(form.states), "tansig"), {within: (name, 1), **before})
    weights = {within: space.a, **columns, inner: np.zeros((count, form.states))}
    network.add(name, Layer(weights, space.rest), {within: (name, 1), **before, inner: inner})
    weights = {name: space.c, **dict(zip(now, space.d.T[:, :, None], strict=True))}
    feeds = {name: (name, 0), **now}
    if form.after:
        reads = {name: np.zeros((form.after, count)), **{port: np.zeros((form.after, 1)) for port in now}}
        network.add(outer, Layer(reads, np.zeros(form.after), "tansig"), feeds)
        weights, feeds = weights | {outer: np.zeros((1, form.after))}, feeds | {outer: (outer, 0)}
    rate = own(RATE, taken)
    network.add(rate if orders.integrating else loop, Layer(weights, [space.level]), feeds)
    if orders.integrating:
        summed(network, rate, loop, orders.step, output.rest)
    network.connect(loop, output.name)
    return shrunk(nguyen_widrow(network.check(), seed))


def pulled(network: Network, decay: float) -> dict[str, float]:
    """The decay of its neurons and of what reads them: the linear state space is known well, and left as it is."""
    layers = network.layers()
    neurons = {name for name, layer in layers.items() if layer.function.is_sigmoid}
    read = {f"{name}.{port}" for name, layer in layers.items() for port in layer.weights if port in neurons}
    return dict.fromkeys(neurons | read, decay)


def realised(line: Network, orders: Orders, inputs: Sequence[Port], output: Port) -> Linear:
    """The linear model of taps as a state space of one sample, in observer form.

    Raises InputError where a root of its matrix is not real.
    """
    values = line.parameters()
    loop = own(RATE if orders.integrating else LOOP, [p.name for p in (*inputs, output)])
    poles = np.array([float(values[f"{loop}.{output.name}_z{d}"][0, 0]) for d in orders.feedback])
    taps = [
        [float(values[f"{loop}.{p.name}_z{d}"][0, 0]) for d in delays] for p, delays in orders.inputs(inputs).items()
    ]
    zeros = np.array([*taps, [float(values[f"{loop}.bias"][0]), *np.zeros(orders.order)]])  # (m + 1, order + 1)
    a = np.eye(orders.order, k=1)
    a[:, 0] = poles
    through = zeros[:, 0]
    driven = (zeros[:, 1:] + np.outer(through, poles)).T  # (order, m + 1)
    if orders.stride > 1:
        a, driven = _finer(a, driven, orders.stride)
    c = np.eye(1, orders.order)
    return Linear(a, driven[:, :-1], c, through[None, :-1], driven[:, -1], float(through[-1]))


def _finer(a: np.ndarray, driven: np.ndarray, stride: int) -> tuple[np.ndarray, np.ndarray]:
    """The state space of one sample that moves through `stride` samples of held inputs as the given one in a step."""
    root = fractional_matrix_power(a, 1 / stride)
    if not np.isfinite(root).all() or np.abs(np.imag(root)).max() > REAL * np.abs(root).max():
        raise InputError("the matrix of a linear model has no real root")
    root = np.real(root)
    summed = sum(np.linalg.matrix_power(root, i) for i in range(stride))
    return root, np.linalg.solve(summed, driven)


def balanced(space: Linear) -> Linear:
    """In coordinates in which each state is as easily driven as seen (Moore 1981).

    Raises InputError where a state is neither.
    """
    radius = np.abs(np.linalg.eigvals(space.a)).max(initial=0.0)
    a = space.a * min(1.0, WITHIN / radius) if radius > 0 else space.a
    driven = solve_discrete_lyapunov(a, space.b @ space.b.T)
    seen = solve_discrete_lyapunov(a.T, space.c.T @ space.c)
    try:
        lower = np.linalg.cholesky(driven + 1e-12 * np.trace(driven) * np.eye(len(a)))
    except np.linalg.LinAlgError:
        raise InputError("a linear model has a state that nothing drives") from None
    vectors, values, _ = np.linalg.svd(lower.T @ seen @ lower)
    to = lower @ vectors / np.maximum(values, 1e-24 * values[0]) ** 0.25
    return _turned(space, to)


def _turned(space: Linear, to: np.ndarray) -> Linear:
    """With x = `to` times the new states."""
    back = np.linalg.inv(to)
    if not np.isfinite(back).all():
        raise InputError("a linear model has states that cannot be told apart")
    return space._replace(a=back @ space.a @ to, b=back @ space.b, c=space.c @ to, rest=back @ space.rest)


def spread(space: Linear, orders: Orders, inputs: Sequence[Port], pieces: Sequence[Record]) -> Linear:
    """With states that deviate as far as a normalised signal over the pieces."""
    moved = np.concatenate([_run(space, orders, inputs, piece) for piece in pieces])
    return _turned(space, np.diag(np.maximum(ROOM * np.std(moved, axis=0), np.finfo(float).tiny)))


def _run(space: Linear, orders: Orders, inputs: Sequence[Port], piece: Record) -> np.ndarray:
    """States (N, n) over a record, from where its first inputs leave them at rest."""
    late = [
        np.concatenate([np.full(min(d, len(piece)), s[0]), s[: max(len(piece) - d, 0)]])
        for s, d in ((p.normalised(piece.inputs[p.name]), d) for p, d in zip(inputs, orders.delays, strict=True))
    ]
    driven = np.stack(late, axis=1) @ space.b.T + space.rest
    x = np.linalg.lstsq(np.eye(len(space.a)) - space.a, driven[0], rcond=None)[0]
    found = np.empty_like(driven)
    for k, row in enumerate(driven):
        found[k] = x
        x = space.a @ x + row
    return found
