"""From an ONNX graph (opset 17 and newer): one step of it, or a recurrent operator along a sequence.

The leading axes of an input (batch, steps) are taken as 1: the network makes one step at a time, and the state of RNN,
GRU, LSTM and Scan goes on from step to step. Source: https://onnx.ai/onnx/operators.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from greygate.errors import InputError, one_line, shown
from greygate.models.importers.builder import Builder, Value, constant, joined, matmul, taken
from greygate.models.importers.onnx_file import array, first, ports_of, read, shape
from greygate.models.importers.qonnx import QUANTIZERS, Declaring, Quantized
from greygate.models.network import Network, Port

Kind = TypeVar("Kind", bound=Builder)


def from_onnx(
    path: Path | str,
    inputs: Sequence[Port | str] | None = None,
    outputs: Sequence[Port | str] | None = None,
    state: Mapping[str, str] | None = None,
    initial: Mapping[str, np.ndarray] | None = None,
    name: str | None = None,
) -> Network:
    """The network that computes what an ONNX model computes, step by step.

    inputs, outputs: ports in the order of the numbers of the model's inputs and outputs, or their names; by default the
    model's own names. state: an input of the model -> the output that it is in the next step. initial: such an input ->
    its value before the first step, 0 if not given. name: of the network, by default that of the file.
    Raises InputError for a file that is no model, and for an operation that a network cannot carry.

    >>> import onnx
    >>> step = "model (float[1] u, float[1] s) => (float[1] y, float[1] after) {after = Add(u, s) y = Tanh(after)}"
    >>> onnx.save(onnx.parser.parse_model(f'<ir_version: 9, opset_import: ["": 18]> {step}'), "sum.onnx")
    >>> from_onnx("sum.onnx", state={"s": "after"})
    <Network sum: u [1] -> y [1]; 3 layers, 8 parameters>
    """
    model = read(Path(path))
    kind = Declaring if _quantizes(model) else Builder
    return _built(model, path, kind, inputs, outputs, state, initial, name).finished()


def from_qonnx(
    path: Path | str,
    inputs: Sequence[Port | str] | None = None,
    outputs: Sequence[Port | str] | None = None,
    state: Mapping[str, str] | None = None,
    name: str | None = None,
) -> Quantized | None:
    """A QONNX model: the network without its rounding, and every signal in the format that its Quant nodes declare.

    inputs, outputs, state, name: as of `from_onnx`. None for a model without Quant nodes. Raises InputError as that,
    and for a Quant node that no format expresses, with what to do.
    """
    model = read(Path(path))
    if not _quantizes(model):
        return None
    builder = _built(model, path, Declaring, inputs, outputs, state, None, name)
    return Quantized(builder.finished(), tuple(builder.steps))


def _quantizes(model: Any) -> bool:
    return any(node.op_type in QUANTIZERS for node in model.graph.node)


def _built(
    model: Any,
    path: Path | str,
    kind: type[Kind],
    inputs: Sequence[Port | str] | None,
    outputs: Sequence[Port | str] | None,
    state: Mapping[str, str] | None,
    initial: Mapping[str, np.ndarray] | None,
    name: str | None,
) -> Kind:
    """The builder of a model's network, with all but the last check."""
    graph, state = model.graph, dict(state or {})
    fixed = {t.name: constant(array(t)) for t in graph.initializer}
    entered = [i for i in graph.input if i.name not in fixed]
    shapes = {i.name: shape(i, path) for i in (*entered, *graph.output)}
    names = [i.name for i in entered], [o.name for o in graph.output]
    for inner, after in state.items():
        if inner not in names[0] or after not in names[1]:
            raise InputError(
                f"{path}: state {inner} -> {after}: the model has inputs {', '.join(names[0])} and outputs "
                f"{', '.join(names[1])}"
            )
    free = [n for n in names[0] if n not in state], [n for n in names[1] if n not in state.values()]
    ports = [
        list(given) if given is not None else [p for n in tensors for p in ports_of(n, shapes[n])]
        for given, tensors in zip((inputs, outputs), free, strict=True)
    ]
    builder = kind(name or Path(path).stem, *ports)
    walk = _Walk(builder, str(path))
    values = dict(fixed)
    left = list(builder.inputs)
    for n in free[0]:
        count = int(np.prod(shapes[n]))
        values[n] = builder.input(first(left, count, f"{path}: input {n}"), shapes[n])
    if left:
        raise InputError(f"{path}: port {left[0].name} is one too many; the model takes fewer numbers")
    kept = {}
    for n in state:
        start = (initial or {}).get(n, np.zeros(shapes[n]))
        kept[n], values[n] = builder.state(n, np.asarray(start, float).reshape(shapes[n]))
    walk.run(graph, values)
    if missing := [n for n in names[1] if n not in values]:
        raise InputError(f"{path}: output {missing[0]} is of an operation that gives it only in training; leave it out")
    left = list(builder.outputs)
    for n in free[1]:
        builder.output(first(left, values[n].size, f"{path}: output {n}"), values[n])
    if left:
        raise InputError(f"{path}: port {left[0].name} is one too many; the model gives fewer numbers")
    for n, after in state.items():
        builder.keep(kept[n], values[after])
    return builder


class _Walk:
    """Computes the nodes of a graph in their order, which ONNX guarantees."""

    def __init__(self, builder: Builder, where: str):
        self.builder, self.where = builder, where
        self.node: Any = None

    def run(self, graph: Any, values: dict[str, Value]) -> None:
        for node in graph.node:
            self.node = node
            try:
                found = self.called(node, [values[n] if n else None for n in node.input])
            except InputError:
                raise
            except Exception as error:  # attributes and shapes that do not fit one another fail in many ways
                why = one_line(" ".join(str(error).split()))[:100]
                raise self.refused(f"its inputs or attributes do not fit ({type(error).__name__}: {why})") from None
            self.node = node
            values |= dict(zip(node.output, found, strict=False))

    def called(self, node: Any, given: list[Any]) -> list[Value]:
        """The results of a node."""
        if node.op_type not in FUNCTIONS:
            if any(v is None or v.constant is None for v in given):
                raise self.refused(CARRIED)
            return self.folded(node, given)
        options = {a.name: _attribute(a) for a in node.attribute}
        made = FUNCTIONS[node.op_type](self, *given, **options)
        return list(made) if isinstance(made, list | tuple) else [made]

    def folded(self, node: Any, given: list[Any]) -> list[Value]:
        """The results of an operation on constants, by ONNX's own reference."""
        from onnx import TensorProto, helper
        from onnx.reference import ReferenceEvaluator

        whole = {
            "Reshape": [1],
            "Gather": [1],
            "Slice": [1, 2, 3, 4],
            "Expand": [1],
            "Unsqueeze": [1],
            "Range": [0, 1, 2],
        }
        kinds = {k: np.int64 for k in whole.get(node.op_type, [])}
        feeds = {
            n: v.constant.astype(kinds.get(k, np.float64))
            for k, (n, v) in enumerate(zip(node.input, given, strict=True))
        }
        ins = [helper.make_tensor_value_info(n, TensorProto.DOUBLE, None) for n in feeds]
        outs = [helper.make_tensor_value_info(n, TensorProto.DOUBLE, None) for n in node.output]
        model = helper.make_model(helper.make_graph([node], "one", ins, outs))
        try:
            return [constant(v) for v in ReferenceEvaluator(model).run(None, feeds)]
        except Exception as error:
            raise self.refused(f"its constants cannot be folded ({one_line(str(error))[:100]})") from None

    def refused(self, why: str) -> InputError:
        node = self.node
        label = f" {shown(node.name)}" if node.name else ""
        domain = f"{node.domain}." if node.domain else ""
        source = next((p.value for p in node.metadata_props if p.key == "pkg.torch.onnx.stack_trace"), "")
        line = " ".join(source.strip().splitlines()[-2:]).strip() if source else ""
        at = f" ({one_line(' '.join(line.split()))[:160]})" if line else ""
        return InputError(f"{self.where}: operation {domain}{node.op_type}{label}{at}: {why}")

    def fixed(self, value: Value | None, what: str) -> np.ndarray:
        """A value that must be a constant."""
        if value is None or (found := value.constant) is None:
            raise self.refused(f"{what} must be a constant, and is computed from the inputs")
        return found

    def whole(self, value: Value | None, what: str) -> list[int]:
        return [int(v) for v in np.atleast_1d(self.fixed(value, what))]

    @property
    def hint(self) -> str:
        return self.node.name or self.node.op_type


CARRIED = (
    "a network carries sums, products with constants and of two signals, slices, joins, Tanh, Sigmoid, Relu, Clip, Abs "
    "and recurrent operators of them; replace it, or approximate it by such a part"
)


def _attribute(a: Any) -> Any:
    from onnx import helper

    found = helper.get_attribute_value(a)
    return found.decode("utf-8", "replace") if isinstance(found, bytes) else found


# -- operations ------------------------------------------------------------------------------------------------------


def _gemm(
    walk: _Walk,
    a: Value,
    b: Value,
    c: Value | None = None,
    alpha: float = 1.0,
    beta: float = 1.0,
    transA: int = 0,
    transB: int = 0,
) -> Value:
    if transA:
        raise walk.refused("transA = 1: the signal's batch would be summed over")
    matrix = walk.fixed(b, "the matrix")
    out = a.linear(matrix if transB else matrix.T).times(alpha)
    return out if c is None else out.plus(c.times(beta))


def _matmul(walk: _Walk, a: Value, b: Value) -> Value:
    if (found := matmul(a, b)) is None:
        raise walk.refused("both factors are signals; one must be constant")
    return found


def _divide(walk: _Walk, a: Value, b: Value) -> Value:
    return a.times(1.0 / walk.fixed(b, "the divisor"))


def _activated(kind: str) -> Callable:
    return lambda walk, x: walk.builder.activated(x, kind, walk.hint)


def _clip(walk: _Walk, x: Value, low: Value | None = None, high: Value | None = None) -> Value:
    ends = [None if end is None else float(walk.fixed(end, "a limit")) for end in (low, high)]
    ends = [None if end is not None and abs(end) > 1e38 else end for end in ends]
    return walk.builder.clipped(x, ends[0], ends[1], walk.hint)


def _power(walk: _Walk, x: Value, n: Value) -> Value:
    try:
        return walk.builder.power(x, float(walk.fixed(n, "the exponent").ravel()[0]), walk.hint)
    except InputError as error:
        raise walk.refused(str(error)) from None


def _slice(walk: _Walk, x: Value, *rest: Value | None) -> Value:
    bounds = [None if r is None else walk.whole(r, "a bound") for r in rest] + [None] * (4 - len(rest))
    starts, ends = bounds[0] or [], bounds[1] or []
    axes, steps = bounds[2] or list(range(len(starts))), bounds[3] or [1] * len(starts)
    cut: list[slice] = [slice(None)] * len(x.shape)
    for start, end, axis, step in zip(starts, ends, axes, steps, strict=True):
        last = None if step < 0 and end < -(1 << 30) else end
        cut[axis] = slice(start, last, step)
    return x.moved(lambda i: i[tuple(cut)])


def _split(walk: _Walk, x: Value, sizes: Value | None = None, axis: int = 0, num_outputs: int = 0) -> list[Value]:
    parts = num_outputs or len(walk.node.output)
    lengths = walk.whole(sizes, "the sizes") if sizes is not None else [-(-x.shape[axis] // parts)] * parts
    return x.parts(lengths, axis)


def _gather(walk: _Walk, x: Value, places: Value, axis: int = 0) -> Value:
    at = walk.fixed(places, "the places").astype(int)
    return taken(x, at, axis)


def _reshape(walk: _Walk, x: Value, shape: Value, allowzero: int = 0) -> Value:
    wanted = [x.shape[k] if n == 0 and not allowzero else n for k, n in enumerate(walk.whole(shape, "the shape"))]
    if x.size != abs(int(np.prod(wanted))) and -1 not in wanted:
        raise walk.refused(f"reshapes {list(x.shape)} to {wanted}: export the model with one step and a batch of 1")
    return x.moved(lambda i: i.reshape(wanted))


def _squeeze(walk: _Walk, x: Value, axes: Value | None = None) -> Value:
    chosen = None if axes is None else tuple(walk.whole(axes, "the axes"))
    return x.moved(lambda i: np.squeeze(i, chosen))


def _unsqueeze(walk: _Walk, x: Value, axes: Value) -> Value:
    return x.moved(lambda i: np.expand_dims(i, tuple(walk.whole(axes, "the axes"))))


def _flatten(walk: _Walk, x: Value, axis: int = 1) -> Value:
    return x.moved(lambda i: i.reshape(int(np.prod(x.shape[:axis])), -1))


def _normed(walk: _Walk, x: Value, *rest: Value, epsilon: float = 1e-5, **_: Any) -> Value:
    scale, bias, mean, var = (walk.fixed(r, "a statistic") for r in rest)
    by = scale / np.sqrt(var + epsilon)
    return x.plus(constant(-mean)).times(by).plus(constant(bias))


def _reduced(of: Callable) -> Callable:
    def reduce(walk: _Walk, x: Value, axes: Value | None = None, keepdims: int = 1, **options: Any) -> Value:
        if axes is None and options.get("noop_with_empty_axes"):
            return x
        return of(x, walk.whole(axes, "the axes") if axes is not None else (), bool(keepdims))

    return reduce


def _constant(walk: _Walk, **given: Any) -> Value:
    if "value" in given:
        return constant(array(given["value"]))
    return constant(next(iter(given.values())))


def _filled(walk: _Walk, shape: Value, value: Any = None) -> Value:
    number = 0.0 if value is None else float(array(value).ravel()[0])
    return constant(np.full(walk.whole(shape, "the shape"), number))


def _recurrent(kind: str, gates: int, order: Sequence[int]) -> Callable:
    """RNN, GRU or LSTM of one direction. order: of torch's gates among those of ONNX."""

    def run(
        walk: _Walk, x: Value, w: Value, r: Value, b: Value | None = None, *rest: Value | None, **options: Any
    ) -> list[Value]:
        if options.get("direction", "forward") != "forward":
            raise walk.refused(f"direction {options['direction']}: a step would need what comes later")
        if options.get("clip") or options.get("input_forget") or options.get("layout"):
            raise walk.refused("clip, input_forget and layout are not carried")
        n = int(options["hidden_size"])
        names = [f.lower() for f in options.get("activations", [])]
        usual = {"rnn": ["tanh"], "gru": ["sigmoid", "tanh"], "lstm": ["sigmoid", "tanh", "tanh"]}[kind]
        if names and names != usual and not (kind == "rnn" and names == ["relu"]):
            raise walk.refused(f"activations {', '.join(names)}; {', '.join(usual)} are carried")
        matrices = [walk.fixed(v, "a weight")[0] for v in (w, r)]
        both = walk.fixed(b, "a bias")[0] if b is not None else np.zeros(2 * gates * n)
        parts = [*matrices, both[: gates * n], both[gates * n :]]
        weights = [np.concatenate([p[g * n : (g + 1) * n] for g in order]) for p in parts]
        count = 2 if kind == "lstm" else 1
        starts = [rest[1 + j] if len(rest) > 1 + j else None for j in range(count)]
        step, states, names_kept = x.moved(np.ravel), [], []
        for j, start in enumerate(starts):
            flat = constant(np.zeros(n)) if start is None else start.moved(np.ravel)
            if (first := flat.constant) is None:
                states.append(flat)
            else:
                kept, past = walk.builder.state(f"{walk.hint}_{'hc'[j]}", first)
                names_kept.append(kept)
                states.append(past)
        if kind == "lstm":
            after = [*walk.builder.lstm(step, states[0], states[1], weights, walk.hint)]
        elif kind == "gru":
            late = bool(options.get("linear_before_reset", 0))
            after = [walk.builder.gru(step, states[0], weights, walk.hint, after=late)]
        else:
            f = "relu" if names == ["relu"] else "tansig"
            after = [walk.builder.rnn(step, states[0], weights, f, walk.hint)]
        for kept, value in zip(names_kept, after, strict=False):
            walk.builder.keep(kept, value)
        ends = [v.moved(lambda i: i.reshape(1, 1, n)) for v in after]
        return [after[0].moved(lambda i: i.reshape(1, 1, 1, n)), *ends]

    return run


def _scan(walk: _Walk, *given: Value, body: Any, num_scan_inputs: int, **options: Any) -> list[Value]:
    """One pass of the body; what it starts from and hands on is a state."""
    if any(options.get("scan_input_directions") or []) or any(options.get("scan_output_directions") or []):
        raise walk.refused("it runs backwards, so a step needs what comes later")
    if any(options.get("scan_input_axes") or []) or any(options.get("scan_output_axes") or []):
        raise walk.refused("the steps are not its first axis")
    count = len(given) - num_scan_inputs
    values = {t.name: constant(array(t)) for t in body.initializer}
    kept = []
    for inner, start in zip(body.input[:count], given[:count], strict=True):
        first = walk.fixed(start, "the initial state")
        name, values[inner.name] = walk.builder.state(f"{walk.hint}_{inner.name}", first)
        kept.append(name)
    for inner, sequence in zip(body.input[count:], given[count:], strict=True):
        if sequence.shape[0] != 1:
            raise walk.refused(f"{sequence.shape[0]} steps: export the model with one")
        values[inner.name] = sequence.moved(lambda i: i[0])
    node = walk.node
    walk.run(body, values)
    walk.node = node
    found = [values[o.name] for o in body.output]
    for name, value in zip(kept, found, strict=False):
        walk.builder.keep(name, value)
    return [*found[:count], *(v.moved(lambda i: i[None]) for v in found[count:])]


def _cast(walk: _Walk, x: Value, to: int, **_: Any) -> Value:
    """To another kind of number: of a signal only between floats that are exact here."""
    from onnx import TensorProto

    if to in (TensorProto.FLOAT, TensorProto.DOUBLE):
        return x
    if (fixed := x.constant) is not None and to in (TensorProto.INT32, TensorProto.INT64):
        return constant(np.trunc(fixed))
    raise walk.refused(f"a signal becomes {TensorProto.DataType.Name(to)}, which rounds it; keep it in FLOAT or DOUBLE")


def _dropout(walk: _Walk, x: Value, ratio: Value | None = None, training: Value | None = None, **_: Any) -> Value:
    if training is not None and bool(walk.fixed(training, "training_mode").any()):
        raise walk.refused("it is in training mode; export the model in eval mode")
    return x


def _same(walk: _Walk, x: Value) -> Value:
    return x


def _scaler(walk: _Walk, x: Value, offset: Sequence[float] = (0.0,), scale: Sequence[float] = (1.0,)) -> Value:
    return x.plus(constant(-np.asarray(offset))).times(np.asarray(scale))


FUNCTIONS: dict[str, Callable] = {
    "Gemm": _gemm,
    "MatMul": _matmul,
    "Add": lambda walk, a, b: a.plus(b),
    "Sub": lambda walk, a, b: a.plus(b.times(-1.0)),
    "Mul": lambda walk, a, b: walk.builder.product(a, b, walk.hint),
    "Div": _divide,
    "Neg": lambda walk, x: x.times(-1.0),
    "Sum": lambda walk, first, *rest: _total(first, rest),
    "Pow": _power,
    "Tanh": _activated("tansig"),
    "Sigmoid": _activated("logsig"),
    "Softsign": _activated("softsign"),
    "Relu": lambda walk, x: walk.builder.rectified(x, 0.0, walk.hint),
    "LeakyRelu": lambda walk, x, alpha=0.01: walk.builder.rectified(x, alpha, walk.hint),
    "Abs": lambda walk, x: walk.builder.rectified(x, -1.0, walk.hint),
    "HardSigmoid": lambda walk, x, alpha=0.2, beta=0.5: walk.builder.clipped(
        x.times(alpha).plus(constant(beta)), 0.0, 1.0, walk.hint
    ),
    "Clip": _clip,
    "Concat": lambda walk, *values, axis: joined(values, axis),
    "Slice": _slice,
    "Split": _split,
    "Gather": _gather,
    "Reshape": _reshape,
    "Flatten": _flatten,
    "Squeeze": _squeeze,
    "Unsqueeze": _unsqueeze,
    "Transpose": lambda walk, x, perm=None: x.moved(lambda i: i.transpose(perm)),
    "Shape": lambda walk, x, **_: constant(np.array(x.shape)),
    "Constant": _constant,
    "ConstantOfShape": _filled,
    "ReduceSum": _reduced(Value.summed),
    "ReduceMean": _reduced(Value.mean),
    "BatchNormalization": _normed,
    "RNN": _recurrent("rnn", 1, [0]),
    "GRU": _recurrent("gru", 3, [1, 0, 2]),
    "LSTM": _recurrent("lstm", 4, [0, 2, 3, 1]),
    "Scan": _scan,
    "Scaler": _scaler,
    "Cast": _cast,
    "Dropout": _dropout,
    "Identity": _same,
    **QUANTIZERS,
}
"""What a network can carry: operation of ONNX -> how."""


def _total(first: Value, rest: Sequence[Value]) -> Value:
    for other in rest:
        first = first.plus(other)
    return first
