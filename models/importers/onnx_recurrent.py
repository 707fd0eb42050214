"""RNN, GRU, LSTM, Scan, Loop of ONNX: a step whose state goes on; over a window every step of it, begun anew.

Source: https://onnx.ai/onnx/operators, which onnxruntime settles where it is open.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from greygate.errors import InputError
from greygate.models.importers import curves
from greygate.models.importers.builder import Activate, Builder, Value, constant, stacked, taken
from greygate.models.importers.onnx_file import array
from greygate.models.layer import LONGEST_DELAY


class Shape(NamedTuple):
    """An activation: its formula here and in NumPy, of alpha and beta; what these are where nothing is said.

    usual: None for an alpha or a beta that onnxruntime takes otherwise than ONNX says: it must be written out.
    """

    build: Callable[..., Value]
    compute: Callable[..., np.ndarray]
    usual: tuple[float | None, ...] = ()


ACTIVATIONS = {
    "relu": Shape(lambda b, x, hint: b.rectified(x, 0.0, hint), lambda x: np.maximum(x, 0)),
    "tanh": Shape(lambda b, x, hint: b.activated(x, "tansig", hint), np.tanh),
    "sigmoid": Shape(lambda b, x, hint: b.activated(x, "logsig", hint), lambda x: 1 / (1 + np.exp(-x))),
    "softsign": Shape(lambda b, x, hint: b.activated(x, "softsign", hint), lambda x: x / (1 + np.abs(x))),
    "softplus": Shape(curves.softplus, lambda x: np.logaddexp(x, 0)),
    "elu": Shape(curves.elu, lambda x, a: np.where(x > 0, x, a * np.expm1(np.minimum(x, 0))), (1.0,)),
    "thresholdedrelu": Shape(curves.thresholded, lambda x, a: np.where(x > a, x, 0), (None,)),
    "leakyrelu": Shape(lambda b, x, hint, a: b.rectified(x, a, hint), lambda x, a: np.where(x > 0, x, a * x), (0.01,)),
    "affine": Shape(lambda b, x, hint, a, c: x.times(a).plus(constant(c)), lambda x, a, c: a * x + c, (None, None)),
    "hardsigmoid": Shape(
        lambda b, x, hint, a, c: b.clipped(x.times(a).plus(constant(c)), 0.0, 1.0, hint),
        lambda x, a, c: np.clip(a * x + c, 0, 1),
        (0.2, 0.5),
    ),
    "scaledtanh": Shape(
        lambda b, x, hint, a, c: b.activated(x.times(c), "tansig", hint).times(a),
        lambda x, a, c: a * np.tanh(c * x),
        (None, None),
    ),
}
GATES = {"RNN": ("tanh",), "GRU": ("sigmoid", "tanh"), "LSTM": ("sigmoid", "tanh", "tanh")}
ORDER = {"RNN": [0], "GRU": [1, 0, 2], "LSTM": [0, 2, 3, 1]}  # of torch's gates among those of ONNX


@dataclass(frozen=True)
class Options:
    """The attributes of RNN, GRU and LSTM, by their names in ONNX."""

    direction: str = "forward"
    activations: Sequence[str] = ()
    activation_alpha: Sequence[float] = ()
    activation_beta: Sequence[float] = ()
    clip: float = 0.0
    layout: int = 0
    linear_before_reset: int = 0
    input_forget: int = 0
    hidden_size: int = 0

    def shapes(self, kind: str) -> list[list[tuple[Shape, tuple]]]:
        """For each direction its activations, with alpha and beta. Raises InputError for one that does not exist.

        Values of alpha and beta are for those activations alone that have them, in turn.
        """
        each = 2 if self.direction == "bidirectional" else 1
        names = [n.lower() for n in self.activations] or [*GATES[kind]] * each
        values = iter(self.activation_alpha), iter(self.activation_beta)
        found = []
        for name in names:
            if name not in ACTIVATIONS:
                raise InputError(f"activation {name} is not carried; there are {', '.join(ACTIVATIONS)}")
            usual = ACTIVATIONS[name].usual
            told = tuple(next(v, u) for v, u in zip(values, usual, strict=False))
            if None in told:
                raise InputError(
                    f"activation {name} without its alpha or beta, which programs suppose otherwise; add it"
                )
            found.append((ACTIVATIONS[name], told))
        count = len(GATES[kind])
        return [found[k * count : (k + 1) * count] for k in range(each)]


def recurrent(kind: str) -> Callable:
    """RNN, GRU or LSTM."""

    def run(
        walk: Any,
        x: Value,
        w: Value,
        r: Value,
        b: Value | None = None,
        lens: Value | None = None,
        h: Value | None = None,
        c: Value | None = None,
        p: Value | None = None,
        **given: Any,
    ) -> list[Value]:
        options = Options(**given)
        if options.layout:
            x, h, c = _swapped(x), h and _swapped(h), c and _swapped(c)
        if x.shape[1] != 1 or (x.shape[0] != 1 and not walk.windows):
            raise walk.refused(f"takes {list(x.shape)}: export the model with one step and a batch of 1")
        if options.direction != "forward" and not walk.windows:
            raise walk.refused(f"direction {options.direction}: a step would need what comes later")
        if lens is not None and not walk.windows:
            raise walk.refused("sequence_lens is not carried: a step is one sample of one sequence; leave it out")
        length = x.shape[0] if lens is None else int(walk.fixed(lens, "the lengths").max())
        turned = [bool(k) or options.direction == "reverse" for k in range(len(options.shapes(kind)))]
        ways = []
        for k, back in enumerate(turned):
            weights = [walk.fixed(w, "a weight")[k], walk.fixed(r, "a weight")[k]]
            more = [None if v is None else walk.fixed(v, "a weight")[k] for v in (b, p)]
            cell = _cell(walk, kind, options, k, weights[0], weights[1], *more)
            starts = [None if v is None else taken(v, k, 0) for v in ((h, c) if kind == "LSTM" else (h,))]
            ways.append(_way(walk, cell, taken(x, 0, 1), starts, length, r.shape[-1], back))
        return _ends(ways, options.layout)

    return run


def _swapped(x: Value) -> Value:
    return x.moved(lambda i: np.swapaxes(i, 0, 1))


def _cell(
    walk: Any, kind: str, options: Options, way: int, w: np.ndarray, r: np.ndarray, b: Any = None, p: Any = None
) -> Callable[[Value, list[Value]], list[Value]]:
    """A step of one direction: of x and the states, the states behind it."""
    n, builder, hint = r.shape[-1], walk.builder, walk.hint
    count = len(w) // n
    both = np.zeros(2 * len(w)) if b is None else b
    parts = [w, r, both[: len(w)], both[len(w) :]]
    weights = [np.concatenate([m[g * n : (g + 1) * n] for g in ORDER[kind][:count]]) for m in parts]
    clips = options.clip, options.clip, 0.0  # what leaves an LSTM's cell is not clipped in onnxruntime
    acts = [_activate(builder, *shape, clip) for shape, clip in zip(options.shapes(kind)[way], clips, strict=False)]
    if kind == "RNN":
        return lambda x, s: [builder.rnn(x, s[0], weights, acts[0], hint)]
    if kind == "GRU":
        return lambda x, s: [builder.gru(x, s[0], weights, hint, bool(options.linear_before_reset), acts)]
    peep = None if p is None else np.split(p, 3)
    return lambda x, s: [*builder.lstm(x, *s, weights, hint, acts, peep, bool(options.input_forget))]


def _activate(builder: Builder, shape: Shape, values: tuple, clip: float) -> Activate:
    def run(x: Value, hint: str) -> Value:
        return shape.build(builder, builder.clipped(x, -clip, clip, hint) if clip else x, hint, *values)

    return run


def _way(
    walk: Any, cell: Callable, x: Value, starts: Sequence[Value | None], length: int, n: int, back: bool
) -> tuple[Value, list[Value]]:
    """(what every step shows, (steps, n); the states behind the last one) in one direction."""
    states, names = [], []
    for j, start in enumerate(starts):
        states.append(constant(np.zeros(n)) if start is None else start.moved(np.ravel))
        if (first := states[j].constant) is not None and not walk.windows:
            name, states[j] = walk.builder.state(f"{walk.hint}_{'hc'[j]}", first)
            names.append((name, j))
    shown = [constant(np.zeros(n))] * x.shape[0]
    for k in range(length)[:: -1 if back else 1]:
        states = cell(taken(x, k, 0), states)
        shown[k] = states[0]
    for name, j in names:
        walk.builder.keep(name, states[j])
    return stacked(shown, 0), states


def _ends(ways: Sequence[tuple[Value, list[Value]]], layout: int) -> list[Value]:
    """Y and the last states of all directions, in the order of axes of that layout."""
    every = stacked([shown for shown, _ in ways], 1).moved(lambda i: i[:, :, None])
    last = [stacked([s[j] for _, s in ways], 0).moved(lambda i: i[:, None]) for j in range(len(ways[0][1]))]
    if not layout:
        return [every, *last]
    return [every.moved(lambda i: i.transpose(2, 0, 1, 3)), *map(_swapped, last)]


def scan(walk: Any, *given: Value, body: Any, num_scan_inputs: int, **options: Any) -> list[Value]:
    """Passes of the body, one over a step; what it starts from and hands on is then a state."""
    if any(options.get("scan_input_directions") or []) or any(options.get("scan_output_directions") or []):
        raise walk.refused("it runs backwards, so a step needs what comes later")
    if any(options.get("scan_input_axes") or []) or any(options.get("scan_output_axes") or []):
        raise walk.refused("the steps are not its first axis")
    count = len(given) - num_scan_inputs
    steps = given[count].shape[0]
    unrolled = walk.windows or all(v.constant is not None for v in given[count:])  # by rows of constants, not of time
    if steps != 1 and not unrolled:
        raise walk.refused(f"{steps} steps: export the model with one")
    states, kept = list(given[:count]), []
    for j, inner in enumerate(body.input[:count] if not unrolled else ()):
        first = walk.fixed(states[j], "the initial state")
        name, states[j] = walk.builder.state(f"{walk.hint}_{inner.name}", first)
        kept.append(name)
    rows = []
    for k in range(steps):
        found = [_value(v) for v in _passed(walk, body, *states, *(taken(part, k, 0) for part in given[count:]))]
        states = found[:count]
        rows.append(found[count:])
    for name, value in zip(kept, states, strict=False):
        walk.builder.keep(name, value)
    return [*states, *(stacked(part, 0) for part in zip(*rows, strict=True))]


def loop(walk: Any, *_: Value, body: Any) -> list[Any]:
    """Every pass of the body written out; their number must be known. Keras writes a layer over a window so."""
    (limit, on), held = _known(walk, walk.node.input[:2]), [walk.scope[n] for n in walk.node.input[2:]]
    rows: list[list[Any]] = []
    while (on is None or bool(on)) and (limit is None or len(rows) < int(limit)):
        if len(rows) == LONGEST_DELAY:
            raise walk.refused(f"it runs more than {LONGEST_DELAY} times; export the model with a shorter window")
        on, *found = _passed(walk, body, np.array(len(rows)), np.array(True), *held)
        if isinstance(on, Value):
            raise walk.refused(UNTOLD)
        held = found[: len(held)]
        rows.append(found[len(held) :])
    return [*held, *(_joined(part) for part in zip(*rows, strict=True))]


def _joined(passes: Sequence[Any]) -> Any:
    """What passes give, along an axis of their own; constants stay arrays of their type."""
    if all(isinstance(v, np.ndarray) for v in passes):
        return np.stack(passes)
    return stacked([_value(v) for v in passes], 0)


def branch(walk: Any, _: Value, then_branch: Any, else_branch: Any) -> list[Any]:
    """The graph that is chosen; it must be known which."""
    (chosen,) = _known(walk, walk.node.input)
    return _passed(walk, then_branch if bool(chosen) else else_branch)


def _known(walk: Any, names: Sequence[str]) -> list[np.ndarray | None]:
    found = [walk.scope[n] if n else None for n in names]
    if any(isinstance(v, Value) for v in found):
        raise walk.refused(UNTOLD)
    return found


def _passed(walk: Any, body: Any, *entering: Any) -> list[Any]:
    """What a graph inside a node gives."""
    node, fixed = walk.node, {t.name: array(t) for t in body.initializer}
    values = {**walk.scope, **fixed, **dict(zip((i.name for i in body.input), entering, strict=True))}
    walk.run(body, values)
    walk.node = node
    return [values[o.name] for o in body.output]


def _value(found: Any) -> Value:
    return found if isinstance(found, Value) else constant(found)


UNTOLD = "how it goes on depends on the inputs; write Where, or export with a fixed number of steps"


# -- the same in NumPy, as ONNX's reference lacks most options --------------------------------------------------------


def computed(kind: str, options: Options, x: np.ndarray, w: np.ndarray, r: np.ndarray, *rest: Any) -> list[np.ndarray]:
    """The outputs of RNN, GRU or LSTM on arrays. rest: B, sequence_lens, initial_h, initial_c, P, each or None."""
    given: list[Any] = [*rest, *[None] * (5 - len(rest))]
    b, lens, h, c, p = given
    x, h, c = (v if v is None or not options.layout else np.swapaxes(v, 0, 1) for v in (x, h, c))
    n, batch = r.shape[-1], x.shape[1]
    lens = np.full(batch, len(x)) if lens is None else lens
    shown, ends = [], []
    for k, shapes in enumerate(options.shapes(kind)):
        states = [np.zeros((batch, n)) if v is None else v[k] for v in (h, c)]
        both = np.zeros(2 * len(w[k])) if b is None else b[k]
        peep = np.zeros((3, n)) if p is None else p[k].reshape(3, n)
        y = np.zeros((len(x), batch, n))
        for t in range(len(x))[:: -1 if k or options.direction == "reverse" else 1]:
            inside = (t < lens)[:, None]
            after = _stepped(kind, options, shapes, x[t], states, w[k], r[k], np.split(both, 2), peep)
            states = [np.where(inside, a, s) for a, s in zip(after, states, strict=True)]
            y[t] = np.where(inside, states[0], 0)
        shown.append(y)
        ends.append(states)
    found = [np.stack(shown, 1), *(np.stack([e[j] for e in ends]) for j in range(2))]
    turned = [found[0].transpose(2, 0, 1, 3), *(np.swapaxes(v, 0, 1) for v in found[1:])] if options.layout else found
    return turned[: 3 if kind == "LSTM" else 2]


def _stepped(
    kind: str, options: Options, shapes: Sequence, x: np.ndarray, states: Sequence[np.ndarray], w: np.ndarray,
    r: np.ndarray, b: Sequence[np.ndarray], p: np.ndarray,
) -> list[np.ndarray]:  # fmt: skip
    """One step: h and c behind it."""

    def act(k: int, v: np.ndarray) -> np.ndarray:
        shape, values = shapes[k]
        return shape.compute(np.clip(v, -options.clip, options.clip) if options.clip and k < 2 else v, *values)

    (h, c), n = states, r.shape[-1]
    of_x, of_h = x @ w.T + b[0], h @ r.T + b[1]
    if kind == "RNN":
        return [act(0, of_x + of_h), c]
    parts = [(of_x[:, k : k + n], of_h[:, k : k + n]) for k in range(0, len(w), n)]
    if kind == "GRU":
        z, q = (act(0, sum(parts[k])) for k in (0, 1))
        late = q * parts[2][1] if options.linear_before_reset else (q * h) @ r[2 * n :].T + b[1][2 * n :]
        return [(1 - z) * act(1, parts[2][0] + late) + z * h, c]
    i, o, f, g = (sum(part) for part in parts)
    i = act(0, i + p[0] * c)
    f = 1 - i if options.input_forget else act(0, f + p[2] * c)
    c = f * c + i * act(1, g)
    return [act(0, o + p[1] * c) * act(2, c), c]
