"""What a network makes of each operation in a graph of PyTorch."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from greygate.errors import InputError
from greygate.models.importers import angles, curves, norms
from greygate.models.importers.builder import Builder, Value, constant, joined, stacked, taken
from greygate.models.importers.torch_trial import Trial, tensor

FAR = 1e3  # of the largest port: a limit beyond takes three digits of the sum with it, a multiplexer none
DOUBLE = float(np.finfo(float).eps)  # torch's epsilon where none is given


class Walk(Protocol):
    """What an operation is told of the graph in which it stands."""

    builder: Builder
    trial: Trial
    node: Any

    def affine(self, target: Any, arguments: Sequence, options: Mapping) -> Any: ...

    def fixed(self, given: Any) -> np.ndarray: ...

    def hint(self) -> str: ...

    def refused(self, operation: str, why: str = "") -> InputError: ...


def value_of(x: Any) -> Value:
    return x if isinstance(x, Value) else constant(x.detach().numpy() if hasattr(x, "detach") else x)


def _add(walk: Walk, a: Any, b: Any, alpha: float = 1.0) -> Value:
    return value_of(a).plus(value_of(b).times(alpha))


def _multiply(walk: Walk, a: Any, b: Any) -> Value:
    return walk.builder.product(value_of(a), value_of(b), walk.hint())


def _divide(walk: Walk, a: Any, b: Any, rounding_mode: Any = None) -> Value:
    if rounding_mode is not None:
        raise walk.refused("div", "it rounds to whole numbers; leave that out")
    if (by := value_of(b).constant) is None:
        if len(walk.node.args) > 1 and _of_softsign(*walk.node.args[:2]):
            return _softsign(walk.builder, value_of(a), walk.hint())
        return _multiply(walk, a, norms.inverse(walk.builder, value_of(b), walk.hint()))
    return value_of(a).times(1.0 / by)


def _of_softsign(x: Any, divisor: Any) -> bool:
    """Whether a divisor is 1 + |x|: torch has no operation of that name."""

    def called(node: Any, name: str) -> bool:
        return str(getattr(node, "target", "")).startswith(f"aten.{name}.")

    if not called(divisor, "add") or divisor.args[1:] != (1,) or divisor.kwargs:
        return False
    inner = divisor.args[0]
    return called(inner, "abs") and inner.args == (x,)


def _fused(kind: str) -> Callable:
    """beta c + alpha (a times b)."""

    def run(walk: Walk, c: Any, a: Any, b: Any, beta: float = 1.0, alpha: float = 1.0) -> Value:
        import torch

        product = walk.affine(getattr(torch.ops.aten, kind).default, [a, b], {})
        return product.times(alpha).plus(value_of(c).times(beta))

    return run


def _activated(kind: str) -> Callable:
    return lambda walk, x: walk.builder.activated(x, kind, walk.hint())


def _chosen(walk: Walk, condition: Value, above: Any, below: Any) -> Value:
    """`above` where the condition is 0 or more, else `below`."""
    return walk.builder.chosen(condition, value_of(above), value_of(below), walk.hint())


def _less(walk: Walk, a: Any, b: Any) -> Value:
    return value_of(a).plus(value_of(b).times(-1.0))


def _where(walk: Walk, condition: Any, above: Any, below: Any) -> Value:
    if not isinstance(condition, Value):
        return walk.affine(walk.node.target, [condition, above, below], {})
    return _chosen(walk, condition.plus(constant(-0.5)), above, below)  # 1 or 0


def _logical(how: Callable[[Value], Value]) -> Callable:
    """A function of the sum of truths, each 1 or 0."""

    def run(walk: Walk, *truths: Any) -> Value:
        if any(str(n.meta["val"].dtype) != "torch.bool" for n in walk.node.all_input_nodes):
            raise InputError("of numbers that are not true or false")
        total = constant(0.0)
        for truth in truths:
            total = total.plus(value_of(truth))
        return how(total) if len(truths) == 1 else walk.builder.activated(how(total), "hardlim", walk.hint())

    return run


_not = _logical(lambda x: x.times(-1.0).plus(constant(1.0)))
_and = _logical(lambda total: total.plus(constant(-1.5)))
_or = _logical(lambda total: total.plus(constant(-0.5)))


def _masked(walk: Walk, x: Any, mask: Any, other: Any) -> Value:
    if not isinstance(mask, Value):
        return walk.affine(walk.node.target, [x, mask, other], {})
    return _where(walk, mask, other, x)


def _maximum(walk: Walk, a: Any, b: Any) -> Value:
    return walk.builder.maximum(value_of(a), value_of(b), walk.hint())


def _minimum(walk: Walk, a: Any, b: Any) -> Value:
    return walk.builder.minimum(value_of(a), value_of(b), walk.hint())


def _extreme(sign: float) -> Callable:
    """The maximum (1) or minimum (-1): of two tensors, or along axes, without its places."""

    def run(walk: Walk, x: Value, other: Any = (), keep: bool = False) -> Any:
        if not isinstance(other, int | list | tuple):
            return (_maximum if sign > 0 else _minimum)(walk, x, other)
        along = [other] if isinstance(other, int) else list(other)
        found = walk.builder.largest(value_of(x).times(sign), along, bool(keep), walk.hint()).times(sign)
        return [found, None] if isinstance(other, int) else found

    return run


def _curve(how: Callable) -> Callable:
    return lambda walk, x, *options, **named: how(walk.builder, x, walk.hint(), *options, **named)


def _log_sigmoid(builder: Builder, x: Value, hint: str) -> Value:
    return x.plus(curves.softplus(builder, x, hint).times(-1.0))


def _softsign(builder: Builder, x: Value, hint: str) -> Value:
    return builder.activated(x, "softsign", hint)


def _clamp(walk: Walk, x: Value, low: Any = None, high: Any = None, **options: Any) -> Value:
    """Limits are numbers, arrays or signals; one that is infinite is none."""
    given = [options.get("min", low), options.get("max", high)]
    limits = [None if v is None else value_of(v) for v in given]
    limits = [None if v is None or (not v.weights and np.isinf(v.bias).all()) else v for v in limits]
    fixed = [None if v is None else v.constant for v in limits]
    if not any(v is not None and v.weights for v in limits):
        if any(v is not None and not np.isfinite(v).all() for v in fixed):
            raise InputError("some of its limits are not finite; give finite ones")
        ports = [*walk.builder.inputs, *walk.builder.outputs]
        widest = FAR * max(max(p.scale, abs(p.offset)) for p in ports)
        if all(v is None or np.abs(v).max() <= widest for v in fixed):
            return walk.builder.clipped(x, fixed[0], fixed[1], walk.hint())
    for limit, how in zip(limits, (_maximum, _minimum), strict=True):
        x = x if limit is None else how(walk, x, limit)
    return x


def _power(walk: Walk, x: Any, n: Any) -> Value:
    """Every element to its own exponent."""
    if isinstance(n, Value):
        raise InputError("its exponent is a signal; a number can be carried")
    return norms.powers(walk.builder, x, np.asarray(n, float), walk.hint())


def _prelu(walk: Walk, x: Value, slope: Any) -> Value:
    """A slope for each channel, which is axis 1."""
    found = walk.fixed(slope)
    slopes = found.reshape(1, -1, *[1] * (len(x.shape) - 2)) if found.size > 1 else found.reshape(())
    return walk.builder.rectified(x, slopes, walk.hint())


def _rrelu(walk: Walk, x: Value, low: float = 1 / 8, high: float = 1 / 3, training: bool = False, *_: Any) -> Value:
    if training:
        raise InputError("it draws its slopes at random in training")
    return walk.builder.rectified(x, (low + high) / 2, walk.hint())


def _unit(walk: Walk, x: Value) -> Value:
    return walk.builder.clipped(x.times(1 / 6).plus(constant(0.5)), 0.0, 1.0, walk.hint())


def _gated(walk: Walk, x: Value, gate: Value) -> Value:
    return walk.builder.product(x, walk.builder.activated(gate, "logsig", walk.hint()), walk.hint())


def _halves(walk: Walk, x: Value, dim: int = -1) -> Value:
    return _gated(walk, *x.parts([x.shape[dim] // 2] * 2, dim))


def _normed(walk: Walk, x: Value, w: Any, b: Any, mean: Any, var: Any, *rest: Any) -> list:
    """By fixed statistics for each channel, which is axis 1."""
    shape = (-1, *[1] * (len(x.shape) - 2))
    center, spread = (walk.fixed(v).reshape(shape) for v in (mean, var))
    gain, shift = (0.0 if v is None else walk.fixed(v).reshape(shape) for v in (w, b))
    scale = (1.0 if w is None else gain) / np.sqrt(spread + rest[-1])
    return [x.plus(constant(-center)).times(scale).plus(constant(shift)), None, None]


def _softmax(how: Callable) -> Callable:
    return lambda walk, x, dim, *_, **__: how(walk.builder, x, dim, walk.hint())


def _log_sum(walk: Walk, x: Value, dim: Any, keepdim: bool = False) -> Value:
    return norms.log_sum(walk.builder, x, [dim] if isinstance(dim, int) else dim, keepdim, walk.hint())


def _shifted(x: Value, w: Any, b: Any, shape: Sequence[int]) -> Value:
    """Times a gain, plus a bias, where they are given, each in that shape."""
    for given, how in ((w, Value.times), (b, lambda v, by: v.plus(constant(by)))):
        if given is not None:
            x = how(x, value_of(given).bias.reshape(tuple(shape)))
    return x


def _layer_norm(
    walk: Walk, x: Value, shape: list[int], w: Any = None, b: Any = None, eps: float = 1e-5, *_: Any
) -> list:
    axes = list(range(len(x.shape) - len(shape), len(x.shape)))
    return [_shifted(norms.normalised(walk.builder, x, axes, eps, walk.hint()), w, b, shape), None, None]


def _rms_norm(walk: Walk, x: Value, shape: list[int], w: Any = None, eps: float | None = None) -> list:
    axes = list(range(len(x.shape) - len(shape), len(x.shape)))
    found = norms.normalised(walk.builder, x, axes, DOUBLE if eps is None else eps, walk.hint(), centred=False)
    return [_shifted(found, w, None, shape), None]


def _group_norm(walk: Walk, x: Value, groups: int, w: Any = None, b: Any = None, eps: float = 1e-5, *_: Any) -> Value:
    parts = x.moved(lambda i: i.reshape(x.shape[0], groups, -1))
    found = norms.normalised(walk.builder, parts, [-1], eps, walk.hint()).moved(lambda i: i.reshape(x.shape))
    return _shifted(found, w, b, (-1, *[1] * (len(x.shape) - 2)))


def _variance(walk: Walk, x: Value, dim: Any = None, correction: Any = 1, keepdim: bool = False, **_: Any) -> Value:
    if isinstance(dim, bool):
        dim, correction = None, dim  # an older form, of `unbiased` alone
    axes = [dim] if isinstance(dim, int) else list(dim or range(len(x.shape)))
    own = walk.builder.activated(x.plus(x.mean(axes, True).times(-1.0)), "linear", walk.hint())
    found = walk.builder.power(own, 2, walk.hint()).summed(axes, keepdim)
    return found.times(1 / (x.size / found.size - (1 if correction is None else float(correction))))


def _attention(
    walk: Walk, q: Any, k: Any, v: Any, mask: Any = None, dropout: float = 0.0, causal: bool = False,
    scale: float | None = None, **_: Any,
) -> Value:  # fmt: skip
    if dropout:
        raise InputError("it drops at random in training")
    q, k, v = (value_of(given) for given in (q, k, v))
    seen = np.tri(q.shape[-2], k.shape[-2], dtype=bool) if causal else np.ones(1, bool)
    added = constant(np.where(seen, 0.0, -np.inf))
    if mask is not None:
        found = walk.fixed(mask)
        truths = str(getattr(mask, "dtype", "")) == "torch.bool"
        added = constant(np.where(found, 0.0, -np.inf) if truths else found)
    return norms.attention(walk.builder, q, k, v, added, scale or q.shape[-1] ** -0.5, walk.hint())


def _cosine(walk: Walk, a: Any, b: Any, dim: int = 1, eps: float = 1e-8) -> Value:
    """Of the angle between two."""
    one, two = value_of(a), value_of(b)
    lengths = [
        walk.builder.clipped(_length(walk, v, 2, dim), eps, None, walk.hint()) if v.weights
        else constant(np.maximum(np.linalg.norm(walk.fixed(v), axis=dim), eps))
        for v in (one, two)
    ]  # fmt: skip
    found = walk.builder.product(one, two, walk.hint()).summed([dim])
    for length in lengths:
        found = _divide(walk, found, length)
    return found


def _log_add(walk: Walk, a: Any, b: Any) -> Value:
    return norms.log_sum(walk.builder, stacked([value_of(a), value_of(b)], 0), [0], False, walk.hint())


def _length(walk: Walk, x: Value, order: Any = 2, dim: Any = None, keepdim: bool = False, **_: Any) -> Value:
    axes = [dim] if isinstance(dim, int) else list(dim or [])
    if order == 1:
        return walk.builder.rectified(x, -1.0, walk.hint()).summed(axes, keepdim)
    if order != 2:
        raise InputError(f"its order is {order}; 1 and 2 can be carried")
    return norms.root(walk.builder, walk.builder.power(x, 2, walk.hint()).summed(axes, keepdim), walk.hint())


def _distances(walk: Walk, a: Any, b: Any, order: float = 2.0, *_: Any) -> Value:
    """Of every row of one from every row of the other."""
    one, other = value_of(a).moved(lambda i: i[..., :, None, :]), value_of(b).moved(lambda i: i[..., None, :, :])
    return _length(walk, _less(walk, one, other), order, -1)


def _sorted(walk: Walk, x: Value, dim: int = -1, descending: bool = False, **_: Any) -> list[Value | None]:
    """Of their places nothing is known."""
    found = walk.builder.ordered(x, dim, walk.hint())
    return [joined(found[::-1] if descending else found, dim), None]


def _top(walk: Walk, x: Value, count: int, dim: int = -1, largest: bool = True, *_: Any) -> list[Value | None]:
    found = walk.builder.ordered(x, dim, walk.hint())
    return [joined((found[::-1] if largest else found)[:count], dim), None]


def _median(walk: Walk, x: Value, dim: int | None = None, keep: bool = False) -> Any:
    """The lower one of two."""
    flat = x if dim is not None else x.moved(np.ravel)
    axis = -1 if dim is None else dim
    found = walk.builder.ordered(flat, axis, walk.hint())[(flat.shape[axis] - 1) // 2]
    found = found if keep else found.moved(lambda i: np.squeeze(i, axis))
    return found if dim is None else [found, None]


def _angle(walk: Walk, y: Any, x: Any) -> Value:
    return angles.arctan2(walk.builder, value_of(y), value_of(x), walk.hint())


def _logarithm(base: float) -> Callable:
    return lambda walk, x: norms.ln(walk.builder, x, walk.hint()).times(1 / math.log(base))


def _place(sign: float) -> Callable:
    """The index of the maximum (1) or the minimum (-1), along an axis or of all."""

    def run(walk: Walk, x: Value, dim: int | None = None, keep: bool = False) -> Value:
        turned = x.times(sign)
        if dim is None:
            return walk.builder.place(turned.moved(np.ravel), 0, False, walk.hint())
        return walk.builder.place(turned, dim, keep, walk.hint())

    return run


def _instance(walk: Walk, x: Value, w: Any, b: Any, mean: Any, var: Any, own: bool, *rest: Any) -> Value:
    if own:
        return _group_norm(walk, x, x.shape[1], w, b, rest[1])
    return _normed(walk, x, w, b, mean, var, rest[1])[0]


def _shaped(walk: Walk, x: Value, *arguments: Any, **options: Any) -> Any:
    """A new tensor in the shape of another, whatever that holds."""
    return walk.node.target(tensor(np.zeros(x.size), x.shape), *arguments, **options)


def _layers(kind: str, count: int) -> Callable:
    """A recurrent module of `count` states a layer. Along the sequence of a module, the states that it makes go on."""

    def run(
        walk: Walk, x: Any, given: Any, flat: list, biased: bool, layers: int, dropout: float, train: bool, both: bool,
        batch_first: bool = False,
    ) -> list[Value]:  # fmt: skip
        if both is not False and both is not True:
            raise InputError("its sequence is packed; give it a tensor")
        if both:
            raise InputError("it runs in both directions, so a step needs what comes later")
        if train and dropout:
            raise InputError("it drops at random in training")
        states = [value_of(v) for v in (given if isinstance(given, list) else [given])]
        x = value_of(x).moved(lambda i: np.swapaxes(i, 0, 1)) if batch_first else value_of(x)
        steps = [taken(x, k, 0) for k in range(x.shape[0])]
        if walk.trial.sequence and len(steps) != 1:
            raise InputError(f"it takes {len(steps)} steps of one step of the sequence; keep the axis of the steps")
        each = len(flat) // layers
        ends: list[list[Value]] = [[] for _ in states]
        for k in range(layers):
            w = [walk.fixed(v) for v in flat[each * k : each * (k + 1)]]
            hint, names = f"{walk.hint()}_{k}" if layers > 1 else walk.hint(), []
            after = [taken(s, k, 0) for s in states]
            for j, start in enumerate(after):
                if walk.trial.sequence and start.constant is not None:
                    name, after[j] = walk.builder.state(f"{hint}_{'hc'[j]}", start.constant)
                    names.append(name)
            for t, step in enumerate(steps):
                after = _cell(walk, kind, step, after, w[: 4 if biased else 2], hint)
                if count == 2 and len(w) in (3, 5):  # a projection of h
                    after[0] = after[0].linear(w[-1])
                steps[t] = after[0]
            for name, value in zip(names, after, strict=False):
                walk.builder.keep(name, value)
            for end, value in zip(ends, after, strict=True):
                end.append(value)
        out = stacked(steps, 0)
        return [out.moved(lambda i: np.swapaxes(i, 0, 1)) if batch_first else out, *(stacked(end, 0) for end in ends)]

    return run


def _cells(kind: str) -> Callable:
    """A recurrent cell of torch: x, states, W_x, W_h, b_x, b_h."""

    def run(walk: Walk, x: Any, given: Any, *weights: Any) -> Any:
        states = [value_of(v) for v in (given if isinstance(given, list) else [given])]
        w = [walk.fixed(v) for v in weights if v is not None]
        after = _cell(walk, kind, value_of(x), states, w, walk.hint())
        return after if len(after) > 1 else after[0]

    return run


def _cell(walk: Walk, kind: str, x: Value, states: list[Value], w: list[np.ndarray], hint: str) -> list[Value]:
    w = w if len(w) == 4 else [*w, np.zeros(len(w[0])), np.zeros(len(w[0]))]
    if kind == "lstm":
        return [*walk.builder.lstm(x, states[0], states[1], w, hint)]
    if kind == "gru":
        return [walk.builder.gru(x, states[0], w, hint)]
    act = walk.builder.act({"rnn_tanh": "tansig", "rnn_relu": "relu"}[kind])
    return [walk.builder.rnn(x, states[0], w, act, hint)]


AFFINE = {
    "slice", "select", "index", "index_select", "take", "gather", "split", "split_with_sizes", "unsafe_split", "chunk",
    "unsafe_chunk", "unbind", "view", "reshape", "_unsafe_view", "flatten", "unflatten", "unsqueeze", "squeeze",
    "permute", "transpose", "t", "numpy_T", "mT", "movedim", "expand", "expand_as", "view_as", "repeat",
    "repeat_interleave", "tile", "roll", "flip", "fliplr", "flipud", "rot90", "cat", "concat", "concatenate", "stack",
    "hstack", "vstack", "column_stack", "unfold", "diagonal", "diag", "diag_embed", "narrow", "clone", "detach",
    "alias", "contiguous", "lift_fresh_copy", "slice_scatter", "select_scatter", "index_put", "index_copy",
    "index_add", "scatter", "scatter_add", "masked_scatter", "fill", "copy", "pad", "constant_pad_nd",
    "reflection_pad1d", "replication_pad1d", "pad_sequence", "tril", "triu", "sum", "mean", "cumsum", "diff", "neg",
    "trace", "avg_pool1d", "avg_pool2d", "avg_pool3d", "adaptive_avg_pool1d", "adaptive_avg_pool2d", "pixel_shuffle",
    "pixel_unshuffle", "channel_shuffle", "meshgrid", "atleast_1d", "atleast_2d", "broadcast_tensors", "block_diag",
    "ravel", "_reshape_alias",
}  # fmt: skip
"""Operations that are affine in all of their tensors together, but for indices."""
LINEAR = {
    "matmul", "mm", "bmm", "mv", "dot", "inner", "outer", "kron", "tensordot", "einsum", "linear", "bilinear",
    "conv1d", "conv2d", "conv3d", "convolution", "conv_transpose1d", "conv_transpose2d",
}  # fmt: skip
"""Operations that are affine in any of their tensors while the others are constant."""
LOGICAL = {
    "gt", "ge", "lt", "le", "eq", "ne", "where", "logical_not", "bitwise_not", "logical_and", "bitwise_and", "__and__",
    "logical_or", "bitwise_or", "__or__",
}  # fmt: skip
FUNCTIONS: dict[str, Callable] = {
    "add": _add,
    "sub": lambda walk, a, b, alpha=1.0: _add(walk, a, b, -alpha),
    "rsub": lambda walk, a, b, alpha=1.0: _add(walk, b, a, -alpha),
    "mul": _multiply, "div": _divide, "true_divide": _divide,
    "square": lambda walk, x: _power(walk, x, 2), "pow": _power,
    "addmm": _fused("mm"), "addmv": _fused("mv"), "baddbmm": _fused("bmm"),
    "addcmul": lambda walk, a, b, c, value=1.0: _add(walk, a, _multiply(walk, b, c), value),
    "lerp": lambda walk, a, b, w: _add(walk, a, _multiply(walk, w, _less(walk, b, a))),
    "tanh": _activated("tansig"), **dict.fromkeys(["sigmoid", "special_expit"], _activated("logsig")),
    "relu": lambda walk, x: walk.builder.rectified(x, 0.0, walk.hint()),
    "relu6": lambda walk, x: walk.builder.clipped(x, 0.0, 6.0, walk.hint()),
    "leaky_relu": lambda walk, x, slope=0.01: walk.builder.rectified(x, slope, walk.hint()),
    "prelu": _prelu, "rrelu": _rrelu, 
    "rrelu_with_noise_functional": lambda walk, x, noise, *rest: [_rrelu(walk, x, *rest), noise],
    "abs": lambda walk, x: walk.builder.rectified(x, -1.0, walk.hint()),
    "hardtanh": lambda walk, x, low=-1.0, high=1.0: _clamp(walk, x, low, high),
    "clamp": _clamp, "clip": _clamp, "clamp_min": _clamp,
    "clamp_max": lambda walk, x, high: _clamp(walk, x, None, high),
    "maximum": _maximum, "minimum": _minimum, "max": _extreme(1.0), "min": _extreme(-1.0), "amax": _extreme(1.0),
    "amin": _extreme(-1.0),
    "threshold": lambda walk, x, limit, other: _chosen(walk, _less(walk, limit, x), other, x),
    "hardsigmoid": _unit, "hardswish": _curve(curves.hardswish),
    "silu": _curve(curves.silu), "glu": _halves, "elu": _curve(curves.elu), "celu": _curve(curves.celu),
    "gelu": _curve(curves.gelu), "erf": _curve(curves.erf), "mish": _curve(curves.mish), "selu": _curve(curves.selu),
    "softplus": _curve(curves.softplus), "softsign": _curve(_softsign), "log_sigmoid": _curve(_log_sigmoid),
    "log_sigmoid_forward": lambda walk, x: [_curve(_log_sigmoid)(walk, x), None],
    "where": _where, "sign": _curve(curves.sign), "masked_fill": _masked, "logical_not": _not, "bitwise_not": _not,
    **dict.fromkeys(["logical_and", "bitwise_and", "__and__"], _and),
    **dict.fromkeys(["logical_or", "bitwise_or", "__or__"], _or),
    "ge": lambda walk, a, b: walk.builder.activated(_less(walk, a, b), "hardlim", walk.hint()),
    "le": lambda walk, a, b: walk.builder.activated(_less(walk, b, a), "hardlim", walk.hint()),
    "gt": lambda walk, a, b: FUNCTIONS["le"](walk, a, b).times(-1.0).plus(constant(1.0)),
    "lt": lambda walk, a, b: FUNCTIONS["ge"](walk, a, b).times(-1.0).plus(constant(1.0)),
    "eq": lambda walk, a, b: walk.builder.equal(_less(walk, a, b), constant(0.0), walk.hint()),
    "ne": lambda walk, a, b: FUNCTIONS["eq"](walk, a, b).times(-1.0).plus(constant(1.0)),
    **dict.fromkeys(["_to_copy", "to", "type_as"], lambda walk, x, *_, **__: x),
    **dict.fromkeys(["zero", "zeros_like", "ones_like", "full_like", "new_zeros", "new_ones", "new_full"], _shaped),
    **dict.fromkeys(["softmax", "_softmax"], _softmax(norms.softmax)),
    **dict.fromkeys(["log_softmax", "_log_softmax"], _softmax(norms.log_softmax)),
    "scaled_dot_product_attention": _attention, "cosine_similarity": _cosine, "logaddexp": _log_add,
    "exp": _curve(norms.exp), "log": _curve(norms.ln),
    **{name: _curve(how) for name, how in angles.FUNCTIONS.items()},
    "log1p": lambda walk, x: norms.ln(walk.builder, x.plus(constant(1.0)), walk.hint()),
    "log2": _logarithm(2.0), "log10": _logarithm(10.0),
    "nan_to_num": lambda walk, x, *_: x,
    "remainder": lambda walk, x, by: angles.remainder(walk.builder, x, walk.fixed(by), walk.hint()),
    "sort": _sorted, "topk": _top, "median": _median,
    "atan2": _angle,
    "argmax": _place(1.0), "argmin": _place(-1.0), "_cdist_forward": _distances, "cdist": _distances,
    "expm1": lambda walk, x: norms.exp(walk.builder, x, walk.hint()).plus(constant(-1.0)),
    "logsumexp": _log_sum, "native_layer_norm": _layer_norm, "group_norm": _group_norm,
    "layer_norm": lambda *given: _layer_norm(*given)[0], "rms_norm": lambda *given: _rms_norm(*given)[0],
    "_fused_rms_norm": _rms_norm, "var": _variance, **dict.fromkeys(["linalg_vector_norm", "norm"], _length),
    "std": lambda walk, *given, **told: norms.root(walk.builder, _variance(walk, *given, **told), walk.hint()),
    "sqrt": lambda walk, x: norms.root(walk.builder, x, walk.hint()),
    "rsqrt": lambda walk, x: norms.inverse_root(walk.builder, x, walk.hint()),
    "reciprocal": lambda walk, x: norms.inverse(walk.builder, x, walk.hint()),
    "_native_batch_norm_legit_no_training": _normed, "instance_norm": _instance,
    "rnn_tanh": _layers("rnn_tanh", 1), "rnn_relu": _layers("rnn_relu", 1), "gru": _layers("gru", 1),
    "lstm": _layers("lstm", 2), "rnn_tanh_cell": _cells("rnn_tanh"), "rnn_relu_cell": _cells("rnn_relu"),
    "gru_cell": _cells("gru"), "lstm_cell": _cells("lstm"),
}  # fmt: skip
"""What else a network can carry: operation of torch -> how."""
