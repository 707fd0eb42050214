"""From an ONNX graph: one step of it, or a recurrent operator along a sequence.

The leading axes of an input (batch, steps) are taken as 1: the network makes one step at a time, and the state of RNN,
GRU, LSTM and Scan goes on from step to step. What comes out is compared with ONNX's own reference before it is given
(`onnx_reference.check`). Source: https://onnx.ai/onnx/operators.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial, reduce
from math import prod
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from greygate.errors import InputError, one_line, shown
from greygate.models.importers import angles, norms, onnx_space
from greygate.models.importers.builder import Builder, Value, constant, joined, taken, titled
from greygate.models.importers.curves import CURVES, instead, softplus
from greygate.models.importers.onnx_file import ELEMENTS, QONNX, STANDARD, array, first, ports_of, read, shape
from greygate.models.importers.onnx_outputs import ML, needed
from greygate.models.importers.onnx_recurrent import GATES, branch, loop, recurrent, scan
from greygate.models.importers.onnx_reference import (
    AFFINE,
    BILINEAR,
    CHECKED,
    FOLDED,
    Imported,
    Reference,
    Tensor,
    check,
    lengths,
    samples_of,
)
from greygate.models.importers.qonnx import LINEAR, QUANTIZERS, Declaring, Quantized
from greygate.models.layer import LONGEST_DELAY
from greygate.models.network import Network, Port
from greygate.progress import once

Kind = TypeVar("Kind", bound=Builder)
ALONG = {"Conv", "AveragePool", "MaxPool", "GlobalAveragePool", "GlobalMaxPool"}
STAYING = {"Add", "BatchNormalization", "Cast", "Div", "Identity", "Mul", "Pad", "Relu", "Sub", "Tanh"}  # of axes
SEQUENCE = 3  # axes of what these take along time: batch, channels, time
GRAPHS = ("Scan", "Loop", "If")  # they hold graphs, which read more numbers than are given to them
MICROSOFT = "com.microsoft"  # onnxruntime's own domain: QuantizeLinear to 16 bits, before opset 21
PORTS = 4096  # numbers of an input, an output or a state in one step
NOTHING = 1e-12  # a length that is as good as 0
NUMBERS = 8 * ELEMENTS  # weights that all results together may have, each of every signal that it is a sum of


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
    model's own names. state: an input of the model -> the output that it is in the next step; such outputs are ports
    only if there is no other. initial: such an input -> its value before the first step, 0 if not given. name: of the
    network, by default that of the file.
    Raises InputError for a file that is no model, and for an operation that a network cannot carry.

    >>> import onnx
    >>> step = "model (float[1] u, float[1] s) => (float[1] y, float[1] after) {after = Add(u, s) y = Tanh(after)}"
    >>> onnx.save(onnx.parser.parse_model(f'<ir_version: 9, opset_import: ["": 18]> {step}'), "sum.onnx")
    >>> from_onnx("sum.onnx", state={"s": "after"})
    <Network sum: u [1] -> y [1]; 3 layers, 8 parameters>
    """
    return imported(path, inputs, outputs, state, initial, name).network


def imported(
    path: Path | str,
    inputs: Sequence[Port | str] | None = None,
    outputs: Sequence[Port | str] | None = None,
    state: Mapping[str, str] | None = None,
    initial: Mapping[str, np.ndarray] | None = None,
    name: str | None = None,
) -> Imported:
    """As `from_onnx`: the network, and what of the model it stands for.

    A fixed number of samples is a batch or, where the model mixes them, a window: that of this step and those before.
    """
    model = opened(path)
    if _quantizes(model):
        return _built(model, path, Declaring, inputs, outputs, state, initial, name)[1]
    windows = {} if state else _windows(model, path)
    try:
        if not any(_along_time(model, n) for n in windows):
            return _built(model, path, Builder, inputs, outputs, state, initial, name)[1]
    except InputError:
        if not windows:
            raise
    made = _built(model, path, Builder, inputs, outputs, state, initial, name, windows)[1]
    for n, axis in windows.items():
        once(f"{path}: input {shown(n)} is a window along its axis {axis}: the sample of this step and those before")
    return made


def opened(path: Path | str) -> Any:
    """The model of a file, without what a network has no use for."""
    model = read(Path(path))
    return needed(model, path, _quantizes(model))


def _windows(model: Any, path: Path | str) -> dict[str, int]:
    """Input -> the one axis along which it holds samples; of what goes into a convolution along time, that of time."""
    fixed, found = {t.name for t in model.graph.initializer}, {}
    for tensor in model.graph.input:
        if tensor.name in fixed:
            continue
        axes = shape(tensor, path, True)
        through = len(axes) == SEQUENCE and axes[1] != 1 and _along_time(model, tensor.name)
        held = [2] if through else samples_of(axes)
        chosen = [k for k in held if isinstance(n := axes[k], int) and 1 < n <= LONGEST_DELAY]
        if len(chosen) == 1:
            found[tensor.name] = chosen[0]
    return found


def _along_time(model: Any, name: str) -> bool:
    """Whether a tensor (batch, channels, time) goes into a convolution or a pool as it is, but for its numbers."""
    same = {name}
    for node in model.graph.node:
        if same.isdisjoint(node.input):
            continue
        if node.op_type in ALONG:
            return True
        same.update(node.output if node.op_type in STAYING else ())
    return False


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
    model = opened(path)
    if not _quantizes(model):
        return None
    builder, made = _built(model, path, Declaring, inputs, outputs, state, None, name)
    return Quantized(made.network, tuple(builder.steps), builder.real)


def _quantizes(model: Any) -> bool:
    nodes, fixed = model.graph.node, {t.name for t in model.graph.initializer}
    return any(
        (n.domain in QONNX and n.op_type in QUANTIZERS)
        or (n.domain in (*STANDARD, MICROSOFT) and n.op_type == "QuantizeLinear" and n.input[0] not in fixed)
        for n in nodes
    )


def _built(
    model: Any,
    path: Path | str,
    kind: type[Kind],
    inputs: Sequence[Port | str] | None,
    outputs: Sequence[Port | str] | None,
    state: Mapping[str, str] | None,
    initial: Mapping[str, np.ndarray] | None,
    name: str | None,
    windows: Mapping[str, int] = MappingProxyType({}),
) -> tuple[Kind, Imported]:
    """The builder of a model's network, and the network, which answers as the model.

    windows: input -> its axis along which it holds the last samples.
    """
    graph, state = model.graph, dict(state or {})
    fixed = {t.name: array(t) for t in graph.initializer}
    entered = [i for i in graph.input if i.name not in fixed]
    names = [i.name for i in entered], [o.name for o in graph.output]
    for inner, after in state.items():
        if inner not in names[0] or after not in names[1]:
            raise InputError(
                f"{path}: state {inner} -> {after}: the model has inputs {', '.join(names[0])} and outputs "
                f"{', '.join(names[1])}"
            )
    axes = {
        t.name: shape(t, path, entering)
        for tensors, entering in ((entered, True), (graph.output, False))
        for t in tensors
    }
    free = [n for n in names[0] if n not in state], [n for n in names[1] if n not in state.values()] or names[1]
    whole = {*names[1], *windows} if windows else {*state}
    shapes = {
        n: [1 if k in samples_of(a) and n not in whole else m for k, m in enumerate(lengths(a, {}))]
        for n, a in axes.items()
    }
    if large := next((n for n, lengths_of in shapes.items() if prod(lengths_of) > PORTS), None):
        raise InputError(f"{path}: {large} has {prod(shapes[large])} numbers; a network has at most {PORTS} a step")
    starts = _starts(initial or {}, {n: tuple(shapes[n]) for n in state}, path)
    ports = [
        list(given)
        if given is not None
        else [p for n in tensors for p in ports_of(n, [m for k, m in enumerate(shapes[n]) if k != windows.get(n)])]
        for given, tensors in zip((inputs, outputs), free, strict=True)
    ]
    builder = kind(name or titled(path), *ports)
    samples = "" if windows else next((f"{shown(n)} is {axes[n]}" for n in free[0] if samples_of(axes[n])), "")
    walk = _Walk(builder, str(path), Reference(model.opset_import), samples, bool(windows))
    values: dict[str, Value | np.ndarray] = dict(fixed)
    left = list(builder.inputs)
    tensors: tuple[list[Tensor], list[Tensor]] = ([], [])
    for n in free[0]:
        axis = windows.get(n)
        count = prod(m for k, m in enumerate(shapes[n]) if k != axis)
        taken_ports = first(left, count, f"{path}: input {n}")
        tensors[0].append(Tensor(n, axes[n], taken_ports, axis))
        if axis is None:
            values[n] = builder.input(taken_ports, shapes[n])
        else:
            values[n] = builder.window(taken_ports, shapes[n], axis)
    if left:
        raise InputError(f"{path}: port {left[0].name} is one too many; the model takes fewer numbers")
    kept = {}
    for n, start in starts.items():
        kept[n], values[n] = builder.state(n, start)
    walk.run(graph, values)
    if missing := [n for n in names[1] if n not in values]:
        raise InputError(f"{path}: output {missing[0]} is of an operation that gives it only in training; leave it out")
    results = {n: signal(values[n]) for n in names[1]}
    left = list(builder.outputs)
    if empty := [n for n in names[1] if not results[n].size]:
        raise InputError(f"{path}: output {empty[0]} has no numbers; leave it out")
    found = [p for n in free[1] for p in ports_of(n, results[n].shape)]
    if outputs is None and len(found) != len(left) and len(found) <= PORTS:  # skl2onnx declares one number for several
        return _built(model, path, kind, inputs, found, state, initial, name, windows)
    for n in free[1]:
        tensors[1].append(Tensor(n, axes[n], first(left, results[n].size, f"{path}: output {n}")))
        builder.output(tensors[1][-1].ports, results[n])
    if left:
        raise InputError(f"{path}: port {left[0].name} is one too many; the model gives fewer numbers")
    for n, after in state.items():
        builder.keep(kept[n], results[after])
    network = builder.finished()
    states = {n: (kept[n], axes[n], after) for n, after in state.items()}
    made = Imported(network, *tensors, states, walk.constants, walk.changing, model.opset_import)
    check(made, str(path))
    return builder, made


def _starts(
    initial: Mapping[str, np.ndarray], shapes: Mapping[str, tuple[int, ...]], path: Path | str
) -> dict[str, np.ndarray]:
    """What each state is before the first step."""
    for n, given in initial.items():
        if n not in shapes:
            raise InputError(f"{path}: initial {shown(n)}: no such state; the states are {', '.join(shapes) or 'none'}")
        try:
            count = np.asarray(given, float).size
        except (TypeError, ValueError):
            raise InputError(f"{path}: initial {n}: {shown(given)} holds no numbers") from None
        if count != int(np.prod(shapes[n])):
            raise InputError(f"{path}: initial {n} has {count} numbers; the state has {int(np.prod(shapes[n]))}")
    return {n: np.asarray(initial.get(n, np.zeros(s)), float).reshape(s) for n, s in shapes.items()}


class _Walk:
    """Computes the nodes of a graph in their order, which ONNX guarantees.

    A value is an array as long as nothing that is entered decides it, in its own type; else a `Value`.
    constants, changing: as `onnx_reference.Imported` has them. samples: an input that may hold several, in words.
    windows: an input holds the last samples, so a state begins anew in every step.
    """

    def __init__(self, builder: Builder, where: str, reference: Reference, samples: str = "", windows: bool = False):
        self.builder, self.where, self.reference = builder, where, reference
        self.samples, self.windows = samples, windows
        self.constants: dict[str, np.ndarray] = {}
        self.changing: list[Any] = []
        self.node: Any = None
        self.made: dict[str, Any] = {}  # a value's name -> the node that gave it
        self.scope: dict[str, Any] = {}
        self.left = NUMBERS
        self.columns = Reference(reference.opsets, CHECKED, double=True)

    @np.errstate(all="ignore")  # a number that is none is refused where a network would keep it
    def run(self, graph: Any, values: dict[str, Any]) -> None:
        """Add the results of its nodes to the values."""
        outer, self.scope = self.scope, values
        fixed = {n for n, v in values.items() if isinstance(v, np.ndarray)}
        changing = []
        for node in graph.node:
            self.node = node
            if missing := [n for n in node.input if n and n not in values]:
                raise self.refused(f"reads {shown(missing[0])}, which nothing gives, or only in training")
            try:
                found = self.called(node, [values[n] if n else None for n in node.input])
            except InputError as error:
                raise error if str(error).startswith(self.where) else self.refused(str(error)) from None
            except Exception as error:  # attributes and shapes that do not fit one another fail in many ways
                why = one_line(" ".join(str(error).split()))[:100]
                if self.samples:
                    raise self.refused(
                        f"it does not fit one sample, and input {self.samples}; a network takes one sample a step: "
                        "export the model with one step and a batch of 1"
                    ) from None
                raise self.refused(f"its inputs or attributes do not fit ({type(error).__name__}: {why})") from None
            self.node = node
            self.left -= sum(v.numbers for v in found if isinstance(v, Value))
            if self.left < 0:
                raise self.refused(
                    f"with it the model has more than {NUMBERS} weights of signals, the most that is read"
                )
            values |= {n: v for n, v in zip(node.output, found, strict=False) if n}
            self.made.update(dict.fromkeys(node.output, node))
            if fixed.issuperset(filter(None, node.input)) and all(isinstance(v, np.ndarray) for v in found):
                fixed.update(node.output)
            else:
                changing.append(node)
        self.constants, self.changing = {n: values[n] for n in fixed if n in values}, changing
        self.scope = outer

    def called(self, node: Any, given: list[Any]) -> list[Any]:
        """The results of a node."""
        fixed = all(v is None or isinstance(v, np.ndarray) for v in given)
        domain = "" if node.domain in STANDARD else node.domain
        if domain == "" and fixed and given and node.op_type in FOLDED:
            return self.folded(node)
        if domain == "" and node.op_type in AFFINE:
            return self.affine(node, given)
        function = next((f.get(node.op_type) for d, f in DOMAINS.items() if domain in d), None)
        if function is None:
            raise self.refused(CARRIED + instead(node.op_type))
        options = {a.name: _attribute(a) for a in node.attribute}
        made = function(self, *(None if v is None else signal(v) for v in given), **options)
        found = list(made) if isinstance(made, list | tuple) else [made]
        if fixed and given:
            kind = max((v.dtype for v in given if v is not None), key=lambda t: t.kind == "f")  # of codes and a scale
            kind = np.dtype(float) if node.op_type in GRAPHS else kind
            found = [v if isinstance(v, np.ndarray) or v.constant is None else v.constant.astype(kind) for v in found]
        return found

    def folded(self, node: Any) -> list[Any]:
        """The results of an operation on constants, by ONNX's own reference."""
        try:
            found = self.reference.run(node, self.scope)
        except InputError:
            raise
        except Exception as error:
            raise self.refused(f"its constants cannot be folded ({one_line(str(error))[:100]})") from None
        return [found.get(n) for n in node.output]

    def affine(self, node: Any, given: list[Any]) -> list[Any]:
        """The results of an operation that is affine in its signals: of their bias, and of each column of weights."""
        signals = {n: v for n, v in zip(node.input, given, strict=True) if isinstance(v, Value)}
        allowed = {n for k, n in enumerate(node.input) if k in AFFINE[node.op_type]}
        if not signals.keys() <= allowed:
            raise self.refused(f"{min(signals.keys() - allowed)} must be a constant, and is computed from the inputs")
        if (len(signals) > 1 and node.op_type in BILINEAR) or any(list(node.input).count(n) > 1 for n in signals):
            raise self.refused("two of its factors are signals; one must be constant")
        others = {n: v for n, v in zip(node.input, given, strict=True) if n and n not in signals}
        values = [v if isinstance(v, np.ndarray) else v.constant for v in others.values()]
        fixed = dict(zip(others, (v.astype(float) if v.dtype.kind == "f" else v for v in values), strict=True))

        def result(part: Callable[[Value], np.ndarray]) -> np.ndarray:
            filled = {n: part(v).reshape(v.shape) for n, v in signals.items()}
            return next(iter(self.columns.run(node, {**fixed, **filled}).values()))

        whole, zero = result(lambda v: v.bias), result(lambda v: np.zeros(v.size)).ravel()
        widths = {s: w.shape[1] for v in signals.values() for s, w in v.weights.items()}
        self.room(whole.size * sum(widths.values()))
        weights = {}
        for s, n in widths.items():
            parts = [{id(v): v.weights.get(s, np.zeros((v.size, n)))[:, j] for v in signals.values()} for j in range(n)]
            columns = [result(lambda v, of=part: of[id(v)]) for part in parts]  # type: ignore[misc]
            weights[s] = np.stack([c.ravel() - zero for c in columns], 1)
        return [Value(whole.shape, whole.ravel(), weights)]

    def room(self, count: int) -> None:
        """Raise InputError for more numbers than a result may have."""
        if count > NUMBERS:
            raise self.refused(f"it reads or gives {count} numbers; at most {NUMBERS} are taken")

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


TRUTHS = {"Greater", "GreaterOrEqual", "Less", "LessOrEqual", "Equal", "Not", "And", "Or"}  # what they give is 1 or 0
CARRIED = (
    "a network carries sums, products with constants and of two signals, slices, joins, Tanh, Sigmoid, Relu, Elu, "
    "Gelu, Clip, Max, Where, Conv and recurrent operators of them; "
)


def signal(value: Any) -> Value:
    """A constant array as a value."""
    return constant(value) if isinstance(value, np.ndarray) else value


def _attribute(a: Any) -> Any:
    from onnx import helper

    found = helper.get_attribute_value(a)
    if isinstance(found, list):
        return [v.decode("utf-8", "replace") if isinstance(v, bytes) else v for v in found]
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
    one, two = (v.moved(np.transpose) if turned else v for v, turned in ((a, transA), (b, transB)))
    out = walk.builder.matmul(one, two, walk.hint).times(alpha)
    return out if c is None else out.plus(c.times(beta))


def _divide(walk: _Walk, a: Value, b: Value) -> Value:
    if b.constant is None and _of_softsign(walk, *walk.node.input):
        return walk.builder.activated(a, "softsign", walk.hint)
    return walk.builder.product(a, norms.inverse(walk.builder, b, walk.hint), walk.hint)


def _difference(walk: _Walk, a: Value, b: Value) -> Value:
    """Of a mean of squares and the square of that mean: the mean square of the rest, never negative, no digits lost."""
    x, mean = (_squared_by(walk, n) for n in (_mean_of(walk, walk.node.input[0]), walk.node.input[1]))
    if x and _mean_of(walk, mean) == x and a.shape == b.shape and len(b.shape) == len(walk.scope[x].shape):
        axes = [k for k, (n, m) in enumerate(zip(walk.scope[x].shape, b.shape, strict=True)) if n != m]
        rest = walk.builder.activated(walk.scope[x].plus(walk.scope[mean].times(-1.0)), "linear", walk.hint)
        return walk.builder.power(rest, 2, walk.hint).mean(axes, True) if axes else constant(np.zeros(a.shape))
    return a.plus(b.times(-1.0))


def _mean_of(walk: _Walk, name: str) -> str:
    """What that value is the mean of; "" if it is none."""
    made = walk.made.get(name)
    return made.input[0] if made is not None and made.op_type == "ReduceMean" else ""


def _squared_by(walk: _Walk, name: str) -> str:
    """What that value is the square of, a signal; "" if it is none."""
    made = walk.made.get(name)
    if made is None or made.op_type not in ("Mul", "Pow") or not isinstance(walk.scope[made.input[0]], Value):
        return ""
    one, two = made.input
    square = one == two if made.op_type == "Mul" else np.all(np.asarray(walk.scope[two]) == 2)
    return one if square else ""


def _of_softsign(walk: _Walk, x: str, divisor: str) -> bool:
    """Whether a divisor is 1 + |x|, as exporters write softsign out."""
    total = walk.made.get(divisor)
    if total is None or total.op_type != "Add":
        return False
    parts = [(n, walk.scope[n]) for n in total.input]
    one = any(isinstance(v, np.ndarray) and np.all(v == 1) for _, v in parts)
    return one and any(
        n in walk.made and walk.made[n].op_type == "Abs" and walk.made[n].input[0] == x for n, _ in parts
    )


def _logarithm(walk: _Walk, x: Value) -> Value:
    """Of a sigmoid, as exporters write logsigmoid out: v - softplus(v)."""
    inner = walk.made.get(walk.node.input[0])
    if inner is None or inner.op_type != "Sigmoid":
        return norms.ln(walk.builder, x, walk.hint)
    value = walk.scope[inner.input[0]]
    return value.plus(softplus(walk.builder, value, walk.hint).times(-1.0))


def _modulo(walk: _Walk, x: Value, period: Value, fmod: int = 0) -> Value:
    if fmod:
        raise walk.refused("fmod = 1, with the sign of what is divided, is not carried; write x - p floor(x / p)")
    return angles.remainder(walk.builder, x, walk.fixed(period, "the period"), walk.hint)


def _top(walk: _Walk, x: Value, count: Value, axis: int = -1, largest: int = 1, sorted: int = 1) -> list[Value | None]:
    """Their values; of their places nothing is known."""
    found = walk.builder.ordered(x, axis, walk.hint)
    first = (found[::-1] if largest else found)[: walk.whole(count, "the count")[0]]
    return [joined(first, axis), None]


def _place(sign: float) -> Callable:
    """The index of the maximum (1) or the minimum (-1) along an axis."""

    def run(walk: _Walk, x: Value, axis: int = 0, keepdims: int = 1, select_last_index: int = 0) -> Value:
        if select_last_index:
            raise walk.refused("select_last_index is not carried; the first of equal ones is")
        return walk.builder.place(x.times(sign), axis, bool(keepdims), walk.hint)

    return run


def _softmax(how: Callable) -> Callable:
    return lambda walk, x, axis=-1: how(walk.builder, x, axis, walk.hint)


def _layer_norm(how: Callable) -> Callable:
    def run(
        walk: _Walk, x: Value, gain: Value, shift: Value | None = None, axis: int = -1, epsilon: float = 1e-5, **_: Any
    ) -> Value:
        axes = list(range(axis % len(x.shape), len(x.shape)))
        found = walk.builder.product(how(walk.builder, x, axes, epsilon, walk.hint), gain, walk.hint)
        return found if shift is None else found.plus(shift)

    return run


def _group_norm(
    walk: _Walk, x: Value, gain: Value, shift: Value, epsilon: float = 1e-5, num_groups: int = 0, **_: Any
) -> Value:
    """num_groups: of the channels; 0 is a group for each."""
    groups = num_groups or x.shape[1]
    parts = x.moved(lambda i: i.reshape(x.shape[0], groups, -1))
    whole = norms.normalised(walk.builder, parts, [-1], epsilon, walk.hint).moved(lambda i: i.reshape(x.shape))
    each = [np.repeat(v, x.shape[1] // v.size) for v in (walk.fixed(gain, "the scale"), walk.fixed(shift, "the bias"))]
    scale, bias = (v.reshape(-1, *(1 for _ in x.shape[2:])) for v in each)
    return whole.times(scale).plus(constant(bias))


def _unit_length(walk: _Walk, x: Value, axis: int = -1, p: int = 2) -> Value:
    """By the root of the sum of squares; ONNX gives 0 where that is 0."""
    if p != 2:
        raise walk.refused("p = 1 is not carried; write p = 2")
    length = walk.builder.power(x, 2, walk.hint).summed([axis], True).plus(constant(NOTHING**2))
    return walk.builder.product(x, norms.inverse_root(walk.builder, length, walk.hint), walk.hint)


def _activated(kind: str) -> Callable:
    return lambda walk, x: walk.builder.activated(x, kind, walk.hint)


def _clip(walk: _Walk, x: Value, low: Value | None = None, high: Value | None = None) -> Value:
    ends = [None if end is None else float(walk.fixed(end, "a limit").reshape(())) for end in (low, high)]
    low_end, high_end = (
        None if end is None or far * end > 1e38 else end for end, far in zip(ends, (-1, 1), strict=True)
    )
    return walk.builder.clipped(x, low_end, high_end, walk.hint)


def _power(walk: _Walk, x: Value, n: Value) -> Value:
    return norms.powers(walk.builder, x, walk.fixed(n, "the exponent"), walk.hint)


def _where(walk: _Walk, condition: Value, above: Value, below: Value) -> Value:
    return walk.builder.chosen(condition.plus(constant(-0.5)), above, below, walk.hint)  # it is 1 or 0


def _not(x: Value) -> Value:
    return x.times(-1.0).plus(constant(1.0))


def _truth(least: float) -> Callable:
    """1 where so many of two truths hold, each 1 or 0."""
    return lambda walk, a, b: walk.builder.at_least(a.plus(b), constant(least), walk.hint)


def _extreme(sign: float) -> Callable:
    """The maximum (1) or the minimum (-1) of several."""

    def run(walk: _Walk, *values: Value) -> Value:
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


def _absolute(walk: _Walk, x: Value) -> Value:
    return walk.builder.rectified(x, -1.0, walk.hint)


def _squared(walk: _Walk, x: Value) -> Value:
    return walk.builder.power(x, 2, walk.hint)


def _of(part: Callable) -> Callable:
    """A sum along axes of a function of each element."""
    return lambda walk, x, *rest, **options: _reduced(Value.summed)(walk, part(walk, x), *rest, **options)


def _curve(how: Callable) -> Callable:
    return lambda walk, x, **options: how(walk.builder, x, walk.hint, **options)


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
    if sum(lengths) != x.shape[axis] and not num_outputs:
        raise walk.refused(f"splits {x.shape[axis]} numbers into {', '.join(map(str, lengths))}")
    return x.parts(lengths, axis)


def _reshape(walk: _Walk, x: Value, shape: Value, allowzero: int = 0) -> Value:
    wanted = [x.shape[k] if n == 0 and not allowzero else n for k, n in enumerate(walk.whole(shape, "the shape"))]
    known = int(np.prod([n for n in wanted if n != -1]))
    if known == 0 or x.size % known or (-1 not in wanted and x.size != known):
        raise walk.refused(f"reshapes {list(x.shape)} to {wanted}: export the model with one step and a batch of 1")
    return x.moved(lambda i: i.reshape(wanted))


def _squeeze(walk: _Walk, x: Value, axes: Value | None = None) -> Value:
    chosen = None if axes is None else tuple(walk.whole(axes, "the axes"))
    return x.moved(lambda i: np.squeeze(i, chosen))


def _normed(walk: _Walk, x: Value, *rest: Value, epsilon: float = 1e-5, training_mode: int = 0, **_: Any) -> Value:
    """Its channels are axis 1, whatever the number of axes."""
    if training_mode:
        raise walk.refused("it is in training mode; export the model in eval mode")
    each = [-1, *(1 for _ in x.shape[2:])]
    scale, bias, mean, var = (r.moved(lambda i: i.reshape(each)) for r in rest)  # TensorFlow's layer norm has signals
    root = norms.inverse_root(walk.builder, var.plus(constant(epsilon)), walk.hint)
    whole = walk.builder.product(x.plus(mean.times(-1.0)), root, walk.hint)
    return walk.builder.product(whole, scale, walk.hint).plus(bias)


def _reduced(of: Callable) -> Callable:
    def along(walk: _Walk, x: Value, axes: Any = None, keepdims: int = 1, noop_with_empty_axes: int = 0) -> Value:
        chosen = walk.whole(axes, "the axes") if isinstance(axes, Value) else axes or []  # an attribute below opset 18
        if not chosen and noop_with_empty_axes:
            return x
        return of(x, chosen, bool(keepdims))

    return along


def _constant(walk: _Walk, **given: Any) -> np.ndarray:
    ((kind, value),) = given.items()
    if kind == "value":
        return array(value)
    if not kind.startswith(("value_float", "value_int")):
        raise walk.refused("holds no numbers")
    return np.asarray(value, np.float32 if kind.startswith("value_float") else np.int64)


def _expanded(walk: _Walk, x: Value, shape: Value) -> Value:
    wide = np.broadcast_shapes(x.shape, tuple(walk.whole(shape, "the shape")))
    return x.moved(lambda i: np.broadcast_to(i, wide))


def _cast(walk: _Walk, x: Value, to: int, **_: Any) -> Value:
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


def _dropout(walk: _Walk, x: Value, ratio: Value | None = None, training: Value | None = None, **_: Any) -> Value:
    if training is not None and bool(walk.fixed(training, "training_mode").any()):
        raise walk.refused("it is in training mode; export the model in eval mode")
    return x


def _extracted(walk: _Walk, x: Value, places: Value) -> Value:
    wide = x if x.shape[1:] else x.moved(np.atleast_2d)
    return taken(wide, np.ravel(walk.whole(places, "the places")), -1)


def _regressed(
    walk: _Walk,
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
    walk: _Walk,
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


def _row_norm(walk: _Walk, x: Value, norm: str = "MAX") -> Value:
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


def _scaler(walk: _Walk, x: Value, offset: Sequence[float] = (0.0,), scale: Sequence[float] = (1.0,)) -> Value:
    return x.plus(constant(-np.asarray(offset))).times(np.asarray(scale))


def _imputed(walk: _Walk, x: Value, replaced_value_float: float = float("nan"), **values: Any) -> Value:
    """A recording has no NaN; another value is replaced by that of its column."""
    if np.isnan(replaced_value_float):
        return x
    found = np.asarray(values.get("imputed_value_floats", [0.0]), float)
    missing = walk.builder.equal(x, constant(replaced_value_float), walk.hint)
    return _where(walk, missing, constant(found), x)


def _binarized(walk: _Walk, x: Value, threshold: float = 0.0) -> Value:
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
