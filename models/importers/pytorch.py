"""From a PyTorch module, by `torch.export`, and back.

The module takes one step: `forward(x) -> y`, or `forward(x, *states) -> (y, *states)`. A module with `nn.RNN`, `nn.GRU`
or `nn.LSTM` inside takes a sequence (steps, channels), and its state goes on from step to step.
"""

import copy
import operator
import re
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from greygate.errors import InputError, shown
from greygate.models.importers.builder import Builder, Value, constant, joined, matmul, taken
from greygate.models.network import Network, Port

if TYPE_CHECKING:
    import torch

SEQUENCES = ("RNN", "GRU", "LSTM")


def from_torch(
    module: "torch.nn.Module",
    inputs: Sequence[Port | str],
    outputs: Sequence[Port | str],
    state: Sequence[np.ndarray] = (),
    name: str = "imported",
) -> Network:
    """The network that computes what a PyTorch module computes, step by step, to the rounding of float64.

    inputs, outputs: ports in the order of the elements of x and of y, or their names; in the ports' units.
    state: what each further argument of `forward` is before the first step. `forward` returns (y, *new states).
    Raises InputError for an operation that a network cannot carry, with its line in the module's source.

    >>> import torch
    >>> net = torch.nn.Sequential(torch.nn.Linear(1, 4), torch.nn.Tanh(), torch.nn.Linear(4, 1))
    >>> from_torch(net, ["u"], ["y"])
    <Network imported: u [1] -> y [1]; 2 layers, 13 parameters>
    """
    import torch

    if not isinstance(module, torch.nn.Module):
        raise InputError(f"{shown(module)} is no torch.nn.Module; a saved file is code: load it in your own program")
    builder = Builder(name, inputs, outputs)
    own = copy.deepcopy(module).double().eval()
    size = sum(p.size for p in builder.inputs)
    sequence = any(type(m).__name__ in SEQUENCES for m in own.modules())
    x = torch.zeros((1, size) if sequence and not state else (size,), dtype=torch.float64)
    starts = [torch.as_tensor(s, dtype=torch.float64) for s in state]
    try:
        with torch.no_grad(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of torch, about its own recurrent modules
            program = torch.export.export(own, (x, *starts), strict=False)
    except Exception as error:  # whatever the module raises on a step
        first = " ".join(str(error).split())[:300]
        raise InputError(f"torch.export does not take a step of {type(module).__name__}: {first}") from None
    walk = _Walk(builder, own, program)
    found = walk.results(builder.inputs, x.shape, starts)
    if len(found) != 1 + len(starts):
        raise InputError(
            f"forward gives {len(found)} results; give y and {len(starts)} states, one for each of `state`"
        )
    builder.output(builder.outputs, found[0])
    for kept, value in zip(walk.states, found[1:], strict=True):
        builder.keep(kept, value)
    return builder.finished()


def to_torch(network: Network) -> "torch.nn.Module":
    """A module whose parameters are the network's: forward((steps, inputs)) gives (steps, outputs), float64, in units.

    Its `network()` is the network with the parameters as they are now, to go on with here.

    >>> module = to_torch(from_torch(net, ["u"], ["y"]))
    >>> module(torch.zeros(3, 1, dtype=torch.float64)).shape
    torch.Size([3, 1])
    >>> module.network()
    <Network imported: u [1] -> y [1]; 2 layers, 13 parameters>
    """
    import torch

    class Module(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.names = list(network.parameters())
            frozen = {f"{path}.{port}" for path, layer in network.layers().items() for port in layer.frozen}
            self.values = torch.nn.ParameterList(
                torch.nn.Parameter(torch.tensor(np.array(v), dtype=torch.float64), requires_grad=n not in frozen)
                for n, v in network.parameters().items()
            )

        def forward(self, x: "torch.Tensor") -> "torch.Tensor":
            columns: dict[str, Any] = {}
            start = 0
            for p in network.inputs:
                part = x[..., start : start + p.size]
                columns[p.name] = part[..., 0] if p.size == 1 else part
                start += p.size
            flat = network.flatten()
            given = dict(zip(self.names, self.values, strict=True))
            known = flat.parameters()
            found = network.run(columns, parameters={n: v for n, v in given.items() if n in known})
            parts = [found[p.name][..., None] if p.size == 1 else found[p.name] for p in network.outputs]
            return torch.cat(parts, -1)

        def network(self) -> Network:
            found = {n: v.detach().numpy().copy() for n, v in zip(self.names, self.values, strict=True)}
            return network.with_parameters(found)

    return Module()


# -- the graph -------------------------------------------------------------------------------------------------------


class _Walk:
    """Walks the graph of an exported program; each node becomes a `Value`, or a list of them."""

    def __init__(self, builder: Builder, module: "torch.nn.Module", program: Any):
        self.builder, self.program = builder, program
        self.kept = {**dict(module.named_parameters()), **dict(module.named_buffers())}
        self.states: list[str] = []
        self.node: Any = None

    def results(self, ports: Sequence[Port], shape: Sequence[int], starts: Sequence[Any]) -> list[Value]:
        """What the program returns."""
        signature = self.program.graph_signature
        arrays = {
            **signature.inputs_to_parameters,
            **signature.inputs_to_buffers,
            **getattr(signature, "inputs_to_lifted_tensor_constants", {}),
        }
        values: dict[Any, Any] = {}
        given = 0
        for node in self.program.graph.nodes:
            self.node = node
            if node.op == "placeholder":
                if node.name in arrays:
                    target = arrays[node.name]
                    tensor = self.program.state_dict.get(target, self.program.constants.get(target))
                    values[node] = constant(tensor.detach().numpy())
                elif given == 0:
                    values[node], given = self.builder.input(ports, shape), 1
                else:
                    name, values[node] = self.builder.state(node.name, starts[given - 1].numpy())
                    self.states.append(name)
                    given += 1
            elif node.op == "call_function":
                values[node] = self._called(node, values)
            elif node.op == "output":
                return [values[n] for n in node.args[0]]
        raise InputError("the module returns nothing")

    def _called(self, node: Any, values: dict) -> Any:
        arguments = [_read(a, values) for a in node.args]
        options = {k: _read(a, values) for k, a in node.kwargs.items()}
        if node.target is operator.getitem:
            return arguments[0][arguments[1]]
        name = str(node.target).removeprefix("aten.")
        base = name.split(".")[0]
        if base in FUNCTIONS:
            return FUNCTIONS[base](self, *arguments, **options)
        raise self.refused(base)

    def refused(self, operation: str, why: str = "") -> InputError:
        """The error for an operation that cannot be carried, with the line of the user's source."""
        trace = re.findall(r'File "([^"]+)", line (\d+)[^\n]*\n\s*([^\n]*)', self.node.meta.get("stack_trace") or "")
        own = [t for t in trace if "/torch/" not in t[0]] or trace
        place = f" at {own[-1][0]}:{own[-1][1]}: {own[-1][2].strip()}" if own else ""
        return InputError(f"operation {operation}{place}: {why or CARRIED}")

    def signal(self, value: Value, operation: str) -> np.ndarray:
        """A value that must be a constant."""
        if (found := value.constant) is None:
            raise self.refused(operation, "this argument must be a constant, and is computed from the inputs")
        return found

    def hint(self) -> str:
        """A name for the layer of this node: the module's path, if it has one."""
        stack = self.node.meta.get("nn_module_stack") or {}
        paths = [path for path, _ in stack.values() if path]
        return paths[-1].removeprefix("L['self'].").replace(".", "_") if paths else str(self.node.name)


CARRIED = (
    "a network carries sums, products with constants and of two signals, slices, joins, tanh, sigmoid, relu, clamp, "
    "abs and recurrent cells of them; replace it, or approximate it by such a part"
)


def _read(x: Any, values: dict) -> Any:
    if isinstance(x, list | tuple):
        return [_read(i, values) for i in x]
    try:
        return values.get(x, x)
    except TypeError:
        return x


def _value(x: Any) -> Value:
    return x if isinstance(x, Value) else constant(x)


def _axis(dim: int, shape: Sequence[int]) -> int:
    return dim % max(len(shape), 1)


def _add(walk: _Walk, a: Any, b: Any, alpha: float = 1.0) -> Value:
    return _value(a).plus(_value(b).times(alpha))


def _subtract(walk: _Walk, a: Any, b: Any, alpha: float = 1.0) -> Value:
    return _value(a).plus(_value(b).times(-alpha))


def _multiply(walk: _Walk, a: Any, b: Any) -> Value:
    return walk.builder.product(_value(a), _value(b), walk.hint())


def _divide(walk: _Walk, a: Any, b: Any, rounding_mode: Any = None) -> Value:
    if rounding_mode is not None:
        raise walk.refused("div")
    if (by := _value(b).constant) is None:
        raise walk.refused("div", "the divisor is a signal; multiply by a function of it that you approximate instead")
    return _value(a).times(1.0 / by)


def _linear(walk: _Walk, x: Value, w: Value, b: Value | None = None) -> Value:
    out = x.linear(walk.signal(w, "linear"))
    return out if b is None else out.plus(b)


def _matmul(walk: _Walk, a: Value, b: Value) -> Value:
    if (found := matmul(a, b)) is None:
        raise walk.refused("matmul", "both factors are signals; one must be constant")
    return found


def _addmm(walk: _Walk, c: Value, a: Value, b: Value, beta: float = 1.0, alpha: float = 1.0) -> Value:
    return _matmul(walk, a, b).times(alpha).plus(c.times(beta))


def _activated(kind: str) -> Callable:
    return lambda walk, x: walk.builder.activated(x, kind, walk.hint())


def _clamp(walk: _Walk, x: Value, low: float | None = -1.0, high: float | None = 1.0, **options: float | None) -> Value:
    low, high = options.get("min", low), options.get("max", high)
    return walk.builder.clipped(x, low, high, walk.hint())


def _clamped(walk: _Walk, x: Value, low: float | None = None, high: float | None = None, **options: float) -> Value:
    return _clamp(walk, x, low, high, **options)


def _power(walk: _Walk, x: Value, n: float) -> Value:
    try:
        return walk.builder.power(x, n, walk.hint())
    except InputError as error:
        raise walk.refused("pow", str(error)) from None


def _reduced(walk: _Walk, x: Value, dims: Sequence[int] | None = None, keepdim: bool = False, **_: Any) -> Value:
    return x.summed(dims or (), keepdim)


def _mean(walk: _Walk, x: Value, dims: Sequence[int] | None = None, keepdim: bool = False, **_: Any) -> Value:
    return x.mean(dims or (), keepdim)


def _slice(
    walk: _Walk, x: Value, dim: int = 0, start: int | None = None, end: int | None = None, step: int = 1
) -> Value:
    return x.moved(lambda i: i[(slice(None),) * _axis(dim, x.shape) + (slice(start, end, step),)])


def _split(walk: _Walk, x: Value, sizes: Any, dim: int = 0) -> list[Value]:
    axis = _axis(dim, x.shape)
    lengths = sizes if isinstance(sizes, list) else [sizes] * -(-x.shape[axis] // sizes)
    return x.parts(lengths, axis)


def _chunk(walk: _Walk, x: Value, parts: int, dim: int = 0) -> list[Value]:
    return _split(walk, x, -(-x.shape[_axis(dim, x.shape)] // parts), dim)


def _view(walk: _Walk, x: Value, *shape: Any) -> Value:
    wanted = shape[0] if len(shape) == 1 and isinstance(shape[0], list) else list(shape)
    return x.moved(lambda i: i.reshape(wanted))


def _same(walk: _Walk, x: Value, *_: Any, **__: Any) -> Value:
    return x


def _stack(walk: _Walk, values: list[Value], dim: int = 0) -> Value:
    return joined([v.moved(lambda i: np.expand_dims(i, dim)) for v in values], dim)


def _squeeze(walk: _Walk, x: Value, dim: Any = None) -> Value:
    if dim is None:
        return x.moved(np.squeeze)
    dims = [d for d in (dim if isinstance(dim, list) else [dim]) if x.shape[d] == 1]
    return x.moved(lambda i: np.squeeze(i, tuple(dims)))


def _flatten(walk: _Walk, x: Value, start: int = 0, end: int = -1) -> Value:
    first, last = _axis(start, x.shape), _axis(end, x.shape)
    return x.moved(lambda i: i.reshape(*x.shape[:first], -1, *x.shape[last + 1 :]))


def _normed(walk: _Walk, x: Value, w: Any, b: Any, mean: Value, var: Value, *rest: Any) -> Value:
    training, eps = rest[0], rest[2]
    if training:
        raise walk.refused("batch_norm", "it is in training mode; call .eval() first")
    scale = 1.0 / np.sqrt(walk.signal(var, "batch_norm") + eps)
    scale = scale if w is None else scale * walk.signal(w, "batch_norm")
    out = x.plus(mean.times(-1.0)).times(scale)
    return out if b is None else out.plus(b)


def _filled(number: float) -> Callable:
    return lambda walk, shape, *_, **__: constant(np.full(shape, number))


def _layers(kind: str, count: int) -> Callable:
    """A recurrent module of `count` states a layer, along a sequence of one step whose states go on."""

    def run(walk: _Walk, x: Value, given: Any, flat: list[Value], biased: bool, layers: int, *rest: Any) -> list[Value]:
        if rest[2]:
            raise walk.refused(kind, "it runs in both directions, so a step needs what comes later")
        states = given if isinstance(given, list) else [given]
        each = 4 if biased else 2
        h: list[list[Value]] = [[] for _ in range(count)]
        step = x.moved(lambda i: i.reshape(x.shape[-1]))
        for k in range(layers):
            w = [walk.signal(v, kind) for v in flat[each * k : each * (k + 1)]]
            w = w if biased else [*w, np.zeros(len(w[0])), np.zeros(len(w[0]))]
            hint, before, names = f"{walk.hint()}_{k}" if layers > 1 else walk.hint(), [], []
            for j in range(count):
                start = states[j].moved(lambda i, k=k: i.reshape(layers, -1)[k])
                if (value := start.constant) is None:
                    before.append(start)
                else:  # zeros that the module makes: here the state goes on from step to step
                    name, past = walk.builder.state(f"{hint}_{'hc'[j]}", value)
                    names.append(name)
                    before.append(past)
            after = _cell(walk, kind, step, before, w, hint)
            for name, value in zip(names, after, strict=False):
                walk.builder.keep(name, value)
            for j, value in enumerate(after):
                h[j].append(value)
            step = after[0]
        shape = states[0].shape
        out = step.moved(lambda i: i.reshape(*x.shape[:-1], step.size))
        return [out, *(joined(v, 0).moved(lambda i: i.reshape(shape)) for v in h)]

    return run


def _cells(kind: str) -> Callable:
    """A recurrent cell of torch: x, states, W_x, W_h, b_x, b_h."""

    def run(walk: _Walk, x: Value, given: Any, *weights: Value | None) -> Any:
        states = given if isinstance(given, list) else [given]
        shape = states[0].shape
        w = [walk.signal(v, kind) for v in weights if v is not None]
        w = w if len(w) == 4 else [*w, np.zeros(len(w[0])), np.zeros(len(w[0]))]
        flat = [s.moved(np.ravel) for s in states]
        after = [
            v.moved(lambda i: i.reshape(shape)) for v in _cell(walk, kind, x.moved(np.ravel), flat, w, walk.hint())
        ]
        return after if len(after) > 1 else after[0]

    return run


def _cell(walk: _Walk, kind: str, x: Value, states: list[Value], w: list[np.ndarray], hint: str) -> list[Value]:
    if kind == "lstm":
        return [*walk.builder.lstm(x, states[0], states[1], w, hint)]
    if kind == "gru":
        return [walk.builder.gru(x, states[0], w, hint)]
    return [walk.builder.rnn(x, states[0], w, {"rnn_tanh": "tansig", "rnn_relu": "relu"}[kind], hint)]


FUNCTIONS: dict[str, Callable] = {
    "add": _add, "add_": _add, "sub": _subtract,
    "rsub": lambda walk, a, b, alpha=1: _subtract(walk, b, a, alpha),
    "mul": _multiply, "div": _divide, "neg": lambda walk, x: x.times(-1.0),
    "square": lambda walk, x: _power(walk, x, 2),
    "pow": _power, "linear": _linear, "addmm": _addmm, "mm": _matmul, "matmul": _matmul, "mv": _matmul,
    "tanh": _activated("tansig"), "sigmoid": _activated("logsig"),
    "relu": lambda walk, x: walk.builder.rectified(x, 0.0, walk.hint()),
    "relu6": lambda walk, x: walk.builder.clipped(x, 0.0, 6.0, walk.hint()),
    "leaky_relu": lambda walk, x, slope=0.01: walk.builder.rectified(x, slope, walk.hint()),
    "abs": lambda walk, x: walk.builder.rectified(x, -1.0, walk.hint()),
    "hardtanh": _clamp, "hardtanh_": _clamp, "clamp": _clamped, "clip": _clamped,
    "clamp_min": lambda walk, x, low: walk.builder.clipped(x, low, None, walk.hint()),
    "clamp_max": lambda walk, x, high: walk.builder.clipped(x, None, high, walk.hint()),
    "hardsigmoid": lambda walk, x: walk.builder.clipped(x.times(1 / 6).plus(constant(0.5)), 0.0, 1.0, walk.hint()),
    "sum": _reduced, "mean": _mean,
    "cat": lambda walk, values, dim=0: joined(values, dim), "stack": _stack, "slice": _slice,
    "select": lambda walk, x, dim, k: taken(x, k, dim),
    "index_select": lambda walk, x, dim, k: taken(x, walk.signal(k, "index").astype(int), dim),
    "split": _split, "split_with_sizes": _split, "chunk": _chunk, "unbind": lambda walk, x, dim=0: [
        taken(x, k, dim) for k in range(x.shape[dim])
    ],
    "view": _view, "reshape": _view, "_unsafe_view": _view, "flatten": _flatten,
    "unsqueeze": lambda walk, x, dim: x.moved(lambda i: np.expand_dims(i, dim)), "squeeze": _squeeze,
    "permute": lambda walk, x, dims: x.moved(lambda i: i.transpose(dims)),
    "transpose": lambda walk, x, a, b: x.moved(lambda i: np.swapaxes(i, a, b)),
    "t": lambda walk, x: x.moved(np.transpose),
    "expand": lambda walk, x, shape, **_: x.moved(
        lambda i: np.broadcast_to(i, [i.shape[k - len(shape)] if n == -1 else n for k, n in enumerate(shape)])
    ),
    **dict.fromkeys(
        ["clone", "detach", "detach_", "contiguous", "alias", "_to_copy", "to", "type_as", "dropout"],
        _same,
    ),
    "lift_fresh_copy": _same, "batch_norm": _normed, "zeros": _filled(0.0), "ones": _filled(1.0),
    "zeros_like": lambda walk, x, **_: constant(np.zeros(x.shape)),
    "rnn_tanh": _layers("rnn_tanh", 1), "rnn_relu": _layers("rnn_relu", 1), "gru": _layers("gru", 1),
    "lstm": _layers("lstm", 2), "rnn_tanh_cell": _cells("rnn_tanh"), "rnn_relu_cell": _cells("rnn_relu"),
    "gru_cell": _cells("gru"), "lstm_cell": _cells("lstm"),
}  # fmt: skip
"""What a network can carry: operation of torch -> how."""
