"""From an ONNX graph: one step of it, or a recurrent operator along a sequence.

The leading axes of an input (batch, steps) are taken as 1: the network makes one step at a time, and the state of RNN,
GRU, LSTM and Scan goes on from step to step. What comes out is compared with ONNX's own reference before it is given
(`onnx_reference.check`). Source: https://onnx.ai/onnx/operators.
"""

from collections.abc import Callable, Mapping, Sequence
from math import prod
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from greygate.errors import InputError, one_line, shown
from greygate.models.importers.builder import Builder, Value, titled
from greygate.models.importers.curves import instead
from greygate.models.importers.onnx_file import ELEMENTS, QONNX, STANDARD, array, first, ports_of, read, shape
from greygate.models.importers.onnx_operations import DOMAINS, MICROSOFT, signal
from greygate.models.importers.onnx_outputs import needed
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
from greygate.models.importers.qonnx import QUANTIZERS, Declaring, Quantized
from greygate.models.layer import LONGEST_DELAY
from greygate.models.network import Network, Port
from greygate.progress import once

Kind = TypeVar("Kind", bound=Builder)
ALONG = {"Conv", "AveragePool", "MaxPool", "GlobalAveragePool", "GlobalMaxPool"}
STAYING = {"Add", "BatchNormalization", "Cast", "Div", "Identity", "Mul", "Pad", "Relu", "Sub", "Tanh"}  # of axes
SEQUENCE = 3  # axes of what these take along time: batch, channels, time
GRAPHS = ("Scan", "Loop", "If")  # they hold graphs, which read more numbers than are given to them
PORTS = 4096  # numbers of an input, an output or a state in one step
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


CARRIED = (
    "a network carries sums, products with constants and of two signals, slices, joins, Tanh, Sigmoid, Relu, Elu, "
    "Gelu, Clip, Max, Where, Conv and recurrent operators of them; "
)


def _attribute(a: Any) -> Any:
    from onnx import helper

    found = helper.get_attribute_value(a)
    if isinstance(found, list):
        return [v.decode("utf-8", "replace") if isinstance(v, bytes) else v for v in found]
    return found.decode("utf-8", "replace") if isinstance(found, bytes) else found
