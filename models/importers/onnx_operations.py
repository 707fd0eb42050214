"""What a network can carry of ONNX: each operation, and how.

walk: the walk of `onnx_graph`, which has the builder, the node and the values that are known.
Source: https://onnx.ai/onnx/operators.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial, reduce
from math import prod
from typing import Any

import numpy as np

from greygate.models.importers import angles, norms, onnx_space
from greygate.models.importers.builder import Builder, Value, constant, joined, taken
from greygate.models.importers.curves import CURVES, softplus
from greygate.models.importers.onnx_file import QONNX, STANDARD, array
from greygate.models.importers.onnx_outputs import ML
from greygate.models.importers.onnx_recurrent import GATES, branch, loop, recurrent, scan
from greygate.models.importers.qonnx import LINEAR, QUANTIZERS

MICROSOFT = "com.microsoft"  # onnxruntime's own domain: QuantizeLinear to 16 bits, before opset 21
NOTHING = 1e-12  # a length that is as good as 0
TRUTHS = {"Greater", "GreaterOrEqual", "Less", "LessOrEqual", "Equal", "Not", "And", "Or"}  # what they give is 1 or 0


def signal(value: Any) -> Value:
    """A constant array as a value."""
    return constant(value) if isinstance(value, np.ndarray) else value


def _gemm(
    walk: Any,
    a: Value,
    b: Value,
    c: Value | None = None,
    alpha: float = 1.0,
    beta: float = 1.0,
    transA: int = 0,
    transB: int = 0,
) -> Value:
    one, two = (v.moved(np.transpose) if turned else v for v, turned in ((a, transA), (b, transB)))
    out = walk.builder.matmul(one, two, walk.hint).times(alpha)
    return out if c is None else out.plus(c.times(beta))


def _divide(walk: Any, a: Value, b: Value) -> Value:
    if b.constant is None and _of_softsign(walk, *walk.node.input):
        return walk.builder.activated(a, "softsign", walk.hint)
    return walk.builder.product(a, norms.inverse(walk.builder, b, walk.hint), walk.hint)


def _difference(walk: Any, a: Value, b: Value) -> Value:
    """Of a mean of squares and the square of that mean: the mean square of the rest, never negative, no digits lost."""
    x, mean = (_squared_by(walk, n) for n in (_mean_of(walk, walk.node.input[0]), walk.node.input[1]))
    if x and _mean_of(walk, mean) == x and a.shape == b.shape and len(b.shape) == len(walk.scope[x].shape):
        axes = [k for k, (n, m) in enumerate(zip(walk.scope[x].shape, b.shape, strict=True)) if n != m]
        rest = walk.builder.activated(walk.scope[x].plus(walk.scope[mean].times(-1.0)), "linear", walk.hint)
        return walk.builder.power(rest, 2, walk.hint).mean(axes, True) if axes else constant(np.zeros(a.shape))
    return a.plus(b.times(-1.0))


def _mean_of(walk: Any, name: str) -> str:
    """What that value is the mean of; "" if it is none."""
    made = walk.made.get(name)
    return made.input[0] if made is not None and made.op_type == "ReduceMean" else ""


def _squared_by(walk: Any, name: str) -> str:
    """What that value is the square of, a signal; "" if it is none."""
    made = walk.made.get(name)
    if made is None or made.op_type not in ("Mul", "Pow") or not isinstance(walk.scope[made.input[0]], Value):
        return ""
    one, two = made.input
    square = one == two if made.op_type == "Mul" else np.all(np.asarray(walk.scope[two]) == 2)
    return one if square else ""


def _of_softsign(walk: Any, x: str, divisor: str) -> bool:
    """Whether a divisor is 1 + |x|, as exporters write softsign out."""
    total = walk.made.get(divisor)
    if total is None or total.op_type != "Add":
        return False
    parts = [(n, walk.scope[n]) for n in total.input]
    one = any(isinstance(v, np.ndarray) and np.all(v == 1) for _, v in parts)
    return one and any(
        n in walk.made and walk.made[n].op_type == "Abs" and walk.made[n].input[0] == x for n, _ in parts
    )


def _logarithm(walk: Any, x: Value) -> Value:
    """Of a sigmoid, as exporters write logsigmoid out: v - softplus(v)."""
    inner = walk.made.get(walk.node.input[0])
    if inner is None or inner.op_type != "Sigmoid":
        return norms.ln(walk.builder, x, walk.hint)
    value = walk.scope[inner.input[0]]
    return value.plus(softplus(walk.builder, value, walk.hint).times(-1.0))


def _modulo(walk: Any, x: Value, period: Value, fmod: int = 0) -> Value:
    if fmod:
        raise walk.refused("fmod = 1, with the sign of what is divided, is not carried; write x - p floor(x / p)")
    return angles.remainder(walk.builder, x, walk.fixed(period, "the period"), walk.hint)


def _top(walk: Any, x: Value, count: Value, axis: int = -1, largest: int = 1, sorted: int = 1) -> list[Value | None]:
    """Their values; of their places nothing is known."""
    found = walk.builder.ordered(x, axis, walk.hint)
    first = (found[::-1] if largest else found)[: walk.whole(count, "the count")[0]]
    return [joined(first, axis), None]


def _place(sign: float) -> Callable:
    """The index of the maximum (1) or the minimum (-1) along an axis."""

    def run(walk: Any, x: Value, axis: int = 0, keepdims: int = 1, select_last_index: int = 0) -> Value:
        if select_last_index:
            raise walk.refused("select_last_index is not carried; the first of equal ones is")
        return walk.builder.place(x.times(sign), axis, bool(keepdims), walk.hint)

    return run


def _softmax(how: Callable) -> Callable:
    return lambda walk, x, axis=-1: how(walk.builder, x, axis, walk.hint)


def _layer_norm(how: Callable) -> Callable:
    def run(
        walk: Any, x: Value, gain: Value, shift: Value | None = None, axis: int = -1, epsilon: float = 1e-5, **_: Any
    ) -> Value:
        axes = list(range(axis % len(x.shape), len(x.shape)))
        found = walk.builder.product(how(walk.builder, x, axes, epsilon, walk.hint), gain, walk.hint)
        return found if shift is None else found.plus(shift)

    return run


def _group_norm(
    walk: Any, x: Value, gain: Value, shift: Value, epsilon: float = 1e-5, num_groups: int = 0, **_: Any
) -> Value:
    """num_groups: of the channels; 0 is a group for each."""
    groups = num_groups or x.shape[1]
    parts = x.moved(lambda i: i.reshape(x.shape[0], groups, -1))
    whole = norms.normalised(walk.builder, parts, [-1], epsilon, walk.hint).moved(lambda i: i.reshape(x.shape))
    each = [np.repeat(v, x.shape[1] // v.size) for v in (walk.fixed(gain, "the scale"), walk.fixed(shift, "the bias"))]
    scale, bias = (v.reshape(-1, *(1 for _ in x.shape[2:])) for v in each)
    return whole.times(scale).plus(constant(bias))


def _unit_length(walk: Any, x: Value, axis: int = -1, p: int = 2) -> Value:
    """By the root of the sum of squares; ONNX gives 0 where that is 0."""
    if p != 2:
        raise walk.refused("p = 1 is not carried; write p = 2")
    length = walk.builder.power(x, 2, walk.hint).summed([axis], True).plus(constant(NOTHING**2))
    return walk.builder.product(x, norms.inverse_root(walk.builder, length, walk.hint), walk.hint)


def _activated(kind: str) -> Callable:
    return lambda walk, x: walk.builder.activated(x, kind, walk.hint)


def _clip(walk: Any, x: Value, low: Value | None = None, high: Value | None = None) -> Value:
    ends = [None if end is None else float(walk.fixed(end, "a limit").reshape(())) for end in (low, high)]
    low_end, high_end = (
        None if end is None or far * end > 1e38 else end for end, far in zip(ends, (-1, 1), strict=True)
    )
    return walk.builder.clipped(x, low_end, high_end, walk.hint)


def _power(walk: Any, x: Value, n: Value) -> Value:
    return norms.powers(walk.builder, x, walk.fixed(n, "the exponent"), walk.hint)


def _where(walk: Any, condition: Value, above: Value, below: Value) -> Value:
    return walk.builder.chosen(condition.plus(constant(-0.5)), above, below, walk.hint)  # it is 1 or 0


def _not(x: Value) -> Value:
    return x.times(-1.0).plus(constant(1.0))


def _truth(least: float) -> Callable:
    """1 where so many of two truths hold, each 1 or 0."""
    return lambda walk, a, b: walk.builder.at_least(a.plus(b), constant(least), walk.hint)


def _extreme(sign: float) -> Callable:
    """The maximum (1) or the minimum (-1) of several."""

    def run(walk: Any, *values: Value) -> Value:
        turned = (v.times(sign) for v in values)
        return reduce(lambda a, b: walk.builder.maximum(a, b, walk.hint), turned).times(sign)

    return run


def _along(sign: float) -> Callable:
    """The maximum or the minimum along axes."""
    return lambda walk, x, *rest, **options: _reduced(
        lambda v, axes, keep: walk.builder.largest(v.times(sign), axes, keep, walk.hint).times(sign)
    )(walk, x, *rest, **options)


def _many(how: Callable) -> Callable:
    """A function of all elements along axes."""
    return lambda walk, x, *rest, **options: _reduced(
        lambda v, axes, keep: how(walk.builder, v, axes, keep, walk.hint)
    )(walk, x, *rest, **options)


def _absolute(walk: Any, x: Value) -> Value:
    return walk.builder.rectified(x, -1.0, walk.hint)


def _squared(walk: Any, x: Value) -> Value:
    return walk.builder.power(x, 2, walk.hint)


def _of(part: Callable) -> Callable:
    """A sum along axes of a function of each element."""
    return lambda walk, x, *rest, **options: _reduced(Value.summed)(walk, part(walk, x), *rest, **options)


def _curve(how: Callable) -> Callable:
    return lambda walk, x, **options: how(walk.builder, x, walk.hint, **options)


def _slice(walk: Any, x: Value, *rest: Value | None) -> Value:
    bounds = [None if r is None else walk.whole(r, "a bound") for r in rest] + [None] * (4 - len(rest))
    starts, ends = bounds[0] or [], bounds[1] or []
    axes, steps = bounds[2] or list(range(len(starts))), bounds[3] or [1] * len(starts)
    cut: list[slice] = [slice(None)] * len(x.shape)
    for start, end, axis, step in zip(starts, ends, axes, steps, strict=True):
        last = None if step < 0 and end < -(1 << 30) else end
        cut[axis] = slice(start, last, step)
    return x.moved(lambda i: i[tuple(cut)])


def _split(walk: Any, x: Value, sizes: Value | None = None, axis: int = 0, num_outputs: int = 0) -> list[Value]:
    parts = num_outputs or len(walk.node.output)
    lengths = walk.whole(sizes, "the sizes") if sizes is not None else [-(-x.shape[axis] // parts)] * parts
    if sum(lengths) != x.shape[axis] and not num_outputs:
        raise walk.refused(f"splits {x.shape[axis]} numbers into {', '.join(map(str, lengths))}")
    return x.parts(lengths, axis)


def _reshape(walk: Any, x: Value, shape: Value, allowzero: int = 0) -> Value:
    wanted = [x.shape[k] if n == 0 and not allowzero else n for k, n in enumerate(walk.whole(shape, "the shape"))]
    known = int(np.prod([n for n in wanted if n != -1]))
    if known == 0 or x.size % known or (-1 not in wanted and x.size != known):
        raise walk.refused(f"reshapes {list(x.shape)} to {wanted}: export the model with one step and a batch of 1")
    return x.moved(lambda i: i.reshape(wanted))


def _squeeze(walk: Any, x: Value, axes: Value | None = None) -> Value:
    chosen = None if axes is None else tuple(walk.whole(axes, "the axes"))
    return x.moved(lambda i: np.squeeze(i, chosen))


def _normed(walk: Any, x: Value, *rest: Value, epsilon: float = 1e-5, training_mode: int = 0, **_: Any) -> Value:
    """Its channels are axis 1, whatever the number of axes."""
    if training_mode:
        raise walk.refused("it is in training mode; export the model in eval mode")
    each = [-1, *(1 for _ in x.shape[2:])]
    scale, bias, mean, var = (r.moved(lambda i: i.reshape(each)) for r in rest)  # TensorFlow's layer norm has signals
    root = norms.inverse_root(walk.builder, var.plus(constant(epsilon)), walk.hint)
    whole = walk.builder.product(x.plus(mean.times(-1.0)), root, walk.hint)
    return walk.builder.product(whole, scale, walk.hint).plus(bias)


def _reduced(of: Callable) -> Callable:
    def along(walk: Any, x: Value, axes: Any = None, keepdims: int = 1, noop_with_empty_axes: int = 0) -> Value:
        chosen = walk.whole(axes, "the axes") if isinstance(axes, Value) else axes or []  # an attribute below opset 18
        if not chosen and noop_with_empty_axes:
            return x
        return of(x, chosen, bool(keepdims))

    return along


def _constant(walk: Any, **given: Any) -> np.ndarray:
    ((kind, value),) = given.items()
    if kind == "value":
        return array(value)
    if not kind.startswith(("value_float", "value_int")):
        raise walk.refused("holds no numbers")
    return np.asarray(value, np.float32 if kind.startswith("value_float") else np.int64)


def _expanded(walk: Any, x: Value, shape: Value) -> Value:
    wide = np.broadcast_shapes(x.shape, tuple(walk.whole(shape, "the shape")))
    return x.moved(lambda i: np.broadcast_to(i, wide))


def _cast(walk: Any, x: Value, to: int, **_: Any) -> Value:
    """A signal to another kind of number: only between floats that are exact here."""
    from onnx import TensorProto

    if to in (TensorProto.FLOAT, TensorProto.DOUBLE):
        return x
    if to == TensorProto.BOOL:
        made = walk.made.get(walk.node.input[0])
        return (
            x if made is not None and made.op_type in TRUTHS else _not(walk.builder.equal(x, constant(0.0), walk.hint))
        )
    raise walk.refused(
        f"a signal becomes {TensorProto.DataType.Name(to)}, which rounds it; keep it in FLOAT or "
        "DOUBLE; of a class that picks a row (Embedding) make one port of 0 or 1 for each, and of places in a list "
        "(QuantileTransformer, Discretizer) a curve that is trained"
    )


def _dropout(walk: Any, x: Value, ratio: Value | None = None, training: Value | None = None, **_: Any) -> Value:
    if training is not None and bool(walk.fixed(training, "training_mode").any()):
        raise walk.refused("it is in training mode; export the model in eval mode")
    return x


def _extracted(walk: Any, x: Value, places: Value) -> Value:
    wide = x if x.shape[1:] else x.moved(np.atleast_2d)
    return taken(wide, np.ravel(walk.whole(places, "the places")), -1)


def _regressed(
    walk: Any,
    x: Value,
    coefficients: Sequence[float],
    intercepts: Sequence[float] = (0.0,),
    targets: int = 1,
    post_transform: str = "NONE",
) -> Value:
    if post_transform != "NONE":
        raise walk.refused(f"post_transform {post_transform} is not carried; export the model without it")
    wide = x if x.shape[1:] else x.moved(np.atleast_2d)
    return wide.linear(np.reshape(coefficients, (targets, -1))).plus(constant(intercepts))


def _classified(
    walk: Any,
    x: Value,
    coefficients: Sequence[float],
    intercepts: Sequence[float],
    post_transform: str = "NONE",
    **_: Any,
) -> list[Value | None]:
    """The numbers of all classes; the class itself is none."""
    wide = x if x.shape[1:] else x.moved(np.atleast_2d)
    scores = wide.linear(np.reshape(coefficients, (len(intercepts), -1))).plus(constant(intercepts))
    if post_transform == "SOFTMAX":
        return [None, norms.softmax(walk.builder, scores, -1, walk.hint)]
    if post_transform == "LOGISTIC":
        return [None, walk.builder.activated(scores, "logsig", walk.hint)]
    if post_transform != "NONE":
        raise walk.refused(f"post_transform {post_transform} is not carried; SOFTMAX and LOGISTIC are")
    return [None, scores]


def _row_norm(walk: Any, x: Value, norm: str = "MAX") -> Value:
    """By the sum of absolute values, or the root of that of squares; 0 where that is 0."""
    made = walk.made.get(walk.node.input[0])
    shares = [a.s for a in made.attribute if a.name == "post_transform"] if made is not None else []
    if norm == "L1" and shares == [b"SOFTMAX"]:
        return x  # its sum is 1
    if norm == "L2":
        return _unit_length(walk, x)
    if norm != "L1":
        raise walk.refused(f"norm {norm} is not carried; L1 and L2 are")
    total = walk.builder.rectified(x, -1.0, walk.hint).summed([-1], True).plus(constant(NOTHING))
    return walk.builder.product(x, norms.inverse(walk.builder, total, walk.hint), walk.hint)


def _scaler(walk: Any, x: Value, offset: Sequence[float] = (0.0,), scale: Sequence[float] = (1.0,)) -> Value:
    return x.plus(constant(-np.asarray(offset))).times(np.asarray(scale))


def _imputed(walk: Any, x: Value, replaced_value_float: float = float("nan"), **values: Any) -> Value:
    """A recording has no NaN; another value is replaced by that of its column."""
    if np.isnan(replaced_value_float):
        return x
    found = np.asarray(values.get("imputed_value_floats", [0.0]), float)
    missing = walk.builder.equal(x, constant(replaced_value_float), walk.hint)
    return _where(walk, missing, constant(found), x)


def _binarized(walk: Any, x: Value, threshold: float = 0.0) -> Value:
    return _not(walk.builder.at_least(constant(threshold), x, walk.hint))


FUNCTIONS: dict[str, Callable] = {
    "Gemm": _gemm,
    "MatMul": lambda walk, a, b: walk.builder.matmul(a, b, walk.hint),
    "Add": lambda walk, a, b: a.plus(b),
    "Sub": _difference,
    "Mul": lambda walk, a, b: walk.builder.product(a, b, walk.hint),
    "Div": _divide,
    "Neg": lambda walk, x: x.times(-1.0),
    "Sum": lambda walk, *values: reduce(Value.plus, values),
    "Pow": _power,
    "Log": _logarithm,
    **{name.capitalize(): _curve(how) for name, how in angles.FUNCTIONS.items()},
    "Mod": _modulo,
    "IsNaN": lambda walk, x: np.zeros(x.shape, bool),
    "IsInf": lambda walk, x, **_: np.zeros(x.shape, bool),
    "TopK": _top,
    "ArgMax": _place(1.0),
    "ArgMin": _place(-1.0),
    "Exp": lambda walk, x: norms.exp(walk.builder, x, walk.hint),
    "Sqrt": lambda walk, x: norms.root(walk.builder, x, walk.hint),
    "Reciprocal": lambda walk, x: norms.inverse(walk.builder, x, walk.hint),
    "Softmax": _softmax(norms.softmax),
    "LogSoftmax": _softmax(norms.log_softmax),
    "ReduceLogSumExp": _many(norms.log_sum),
    "ReduceL2": lambda walk, x, *rest, **options: norms.root(
        walk.builder, _of(_squared)(walk, x, *rest, **options), walk.hint
    ),
    "LayerNormalization": _layer_norm(norms.normalised),
    "RMSNormalization": _layer_norm(partial(norms.normalised, centred=False)),
    "InstanceNormalization": _group_norm,
    "GroupNormalization": _group_norm,
    "LpNormalization": _unit_length,
    "Tanh": _activated("tansig"),
    "Sigmoid": _activated("logsig"),
    "Softsign": _activated("softsign"),
    "Relu": lambda walk, x: walk.builder.rectified(x, 0.0, walk.hint),
    "PRelu": lambda walk, x, slope: walk.builder.rectified(x, walk.fixed(slope, "the slope"), walk.hint),
    "LeakyRelu": lambda walk, x, alpha=0.01: walk.builder.rectified(x, alpha, walk.hint),
    "Abs": _absolute,
    **{name: _curve(how) for name, how in CURVES.items()},
    "Max": _extreme(1.0),
    "Min": _extreme(-1.0),
    "Mean": lambda walk, *values: reduce(Value.plus, values).times(1 / len(values)),
    "ReduceMax": _along(1.0),
    "ReduceMin": _along(-1.0),
    "ReduceProd": _many(Builder.multiplied),
    "ReduceSumSquare": _of(_squared),
    "ReduceL1": _of(_absolute),
    "Where": _where,
    "GreaterOrEqual": lambda walk, a, b: walk.builder.at_least(a, b, walk.hint),
    "LessOrEqual": lambda walk, a, b: walk.builder.at_least(b, a, walk.hint),
    "Greater": lambda walk, a, b: _not(walk.builder.at_least(b, a, walk.hint)),
    "Less": lambda walk, a, b: _not(walk.builder.at_least(a, b, walk.hint)),
    "Equal": lambda walk, a, b: walk.builder.equal(a, b, walk.hint),
    "Not": lambda walk, x: _not(x),
    "And": _truth(1.5),
    "Or": _truth(0.5),
    "Conv": onnx_space.conv,
    "AveragePool": onnx_space.average,
    "MaxPool": onnx_space.largest,
    "GlobalAveragePool": onnx_space.whole(Value.mean),
    "GlobalMaxPool": lambda walk, x: walk.builder.largest(x, list(range(2, len(x.shape))), True, walk.hint),
    "HardSigmoid": lambda walk, x, alpha=0.2, beta=0.5: walk.builder.clipped(
        x.times(alpha).plus(constant(beta)), 0.0, 1.0, walk.hint
    ),
    "Clip": _clip,
    "Concat": lambda walk, *values, axis: joined(values, axis),
    "Slice": _slice,
    "Split": _split,
    "Gather": lambda walk, x, at, axis=0: taken(x, walk.fixed(at, "the places").astype(int), axis),
    "Reshape": _reshape,
    "Flatten": lambda walk, x, axis=1: x.moved(lambda i: i.reshape(prod(x.shape[:axis]), -1)),
    "Squeeze": _squeeze,
    "Unsqueeze": lambda walk, x, axes: x.moved(lambda i: np.expand_dims(i, tuple(walk.whole(axes, "the axes")))),
    "Transpose": lambda walk, x, perm=None: x.moved(lambda i: i.transpose(perm)),
    "Shape": lambda walk, x, start=0, end=None: np.array(x.shape[start:end], np.int64),
    "Size": lambda walk, x: np.array(x.size, np.int64),
    "Expand": _expanded,
    "Constant": _constant,
    "ReduceSum": _reduced(Value.summed),
    "ReduceMean": _reduced(Value.mean),
    "BatchNormalization": _normed,
    **{kind: recurrent(kind) for kind in GATES},
    **LINEAR,
    "Scan": scan,
    "Loop": loop,
    "If": branch,
    "Cast": _cast,
    "Dropout": _dropout,
    "Identity": lambda walk, x: x,
}
"""What a network can carry: operation of ONNX -> how."""
DOMAINS: dict[tuple[str, ...], Mapping[str, Callable]] = {
    STANDARD: FUNCTIONS,
    QONNX: QUANTIZERS,
    (MICROSOFT,): LINEAR,
    (ML,): {
        "Scaler": _scaler,
        "ArrayFeatureExtractor": _extracted,
        "LinearRegressor": _regressed,
        "LinearClassifier": _classified,
        "Normalizer": _row_norm,
        "Imputer": _imputed,
        "Binarizer": _binarized,
    },
}
"""The same by the domains that an operation may be of: one of another domain is another one, whatever its name."""
