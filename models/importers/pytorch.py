"""From a PyTorch module, by `torch.export`, and back.

The module takes one step, x of shape (channels,) or else (1, channels): `forward(x) -> y`, or
`forward(x, *states) -> (y, *states)`. A module with `nn.RNN`, `nn.GRU` or `nn.LSTM` inside takes a sequence
(steps, channels), or a batch of one sequence, and its state goes on from step to step. A buffer that a step changes is
a state, too.

What stands in the graph is functional: no operation changes a tensor in place. An operation that is affine in the
signals is torch's own, asked for each column of their weights; what reads no signal, torch computes. At the end the
network and a copy of the module take the same steps, and must answer alike.
"""

import contextlib
import copy
import io
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from greygate.errors import InputError, shown
from greygate.models.importers import curves
from greygate.models.importers.builder import Builder, Value, joined
from greygate.models.importers.torch_functions import AFFINE, FUNCTIONS, LINEAR, LOGICAL, value_of
from greygate.models.importers.torch_trial import (
    STATES,
    Trial,
    doubled,
    first_line,
    kind_of,
    results_of,
    start_of,
    tensor,
    undisturbed,
)
from greygate.models.network import Network, Port

if TYPE_CHECKING:
    import torch


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
    The module is copied, and the copy is as after `.double().eval()`: Dropout does nothing, BatchNorm has fixed means.
    Raises InputError for an operation that a network cannot carry, with its line in the module's source, for memory
    outside buffers and states, and for a module that answers otherwise than the network.

    >>> import torch
    >>> net = torch.nn.Sequential(torch.nn.Linear(1, 4), torch.nn.Tanh(), torch.nn.Linear(4, 1))
    >>> from_torch(net, ["u"], ["y"])
    <Network imported: u [1] -> y [1]; 2 layers, 13 parameters>
    """
    _needed()
    import torch

    if not isinstance(module, torch.nn.Module):
        raise InputError(
            f"{shown(module)} is no torch.nn.Module; a saved file is code: load it in your own "
            "program, and give the module (of an ExportedProgram, its module())"
        )
    for ports, which in ((inputs, "inputs"), (outputs, "outputs"), (state, "state")):
        if isinstance(ports, str) or not isinstance(ports, Sequence):
            raise InputError(f"{which}: {shown(ports)} is no list; give one, with an entry for each")
    starts = [start_of(s, k) for k, s in enumerate(state)]
    try:
        return _imported(module, Builder(name, inputs, outputs), starts, torch.get_default_dtype())
    except InputError as error:
        if not re.search(r"(?i)\bfloat(32)?\b", str(error)):
            raise
    return _imported(module, Builder(name, inputs, outputs), starts, torch.float64)  # tensors that forward makes


def _needed() -> None:
    if find_spec("torch") is None:
        raise InputError("torch is not installed; pip install 'greygate[torch]'")


def _imported(
    module: "torch.nn.Module", builder: Builder, starts: Sequence["torch.Tensor"], kind: "torch.dtype"
) -> Network:
    """kind: of the tensors that `forward` makes of numbers."""
    with undisturbed(kind):
        trial = Trial(doubled(module), builder, starts)
        trial.first()
        _Walk(builder, trial).walk()
        network = builder.finished()
        trial.compare(network)
        return network


def to_torch(network: Network) -> "torch.nn.Module":
    """A module whose parameters are the network's: forward((steps, inputs)) gives (steps, outputs), float64, in units.

    Its `network()` is the network with the parameters as they are now, to go on with here.

    >>> module = to_torch(from_torch(net, ["u"], ["y"]))
    >>> module(torch.zeros(3, 1, dtype=torch.float64)).shape
    torch.Size([3, 1])
    >>> module.network()
    <Network imported: u [1] -> y [1]; 2 layers, 13 parameters>
    """
    _needed()
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
    """Walks the graph of an exported program; each node becomes a `Value` or, if it reads no signal, a tensor."""

    def __init__(self, builder: Builder, trial: Trial):
        import torch

        self.builder, self.trial = builder, trial
        self.node: Any = None
        own = copy.deepcopy(trial.module)
        given = (trial.x.clone(), *trial.given(trial.starts))
        try:
            with contextlib.redirect_stderr(io.StringIO()):  # of what it does not take it prints the whole graph
                self.program: Any = torch.export.export(own, given, strict=False).run_decompositions({})
        except Exception as error:  # whatever cannot be traced
            said = first_line(error)
            why = next((why for pattern, why in UNTRACED.items() if re.search(pattern, said)), "")
            raise InputError(f"torch.export does not take a step of {trial.kind}{why}: {said}") from None

    def walk(self) -> None:
        """Build what the program computes: its outputs, its states and the buffers that it changes."""
        signature = self.program.graph_signature
        entering = {s.arg.name: s for s in signature.input_specs}
        changed = {s.target for s in signature.output_specs if s.kind.name in CHANGED}
        values: dict[Any, Any] = {}
        states: list[str] = []
        kept: dict[str, str] = {}
        for node in self.program.graph.nodes:
            self.node = node
            if node.op == "placeholder":
                spec = entering[node.name]
                if spec.kind.name != "USER_INPUT":
                    tensor = self._fixed(spec.target)
                    values[node] = tensor
                    if spec.target in changed:
                        kept[spec.target], values[node] = self.builder.state(spec.target, tensor.numpy())
                elif node.name == signature.user_inputs[0]:
                    values[node] = self.builder.input(self.builder.inputs, self.trial.x.shape)
                else:
                    start = self.trial.starts[len(states)]
                    name, values[node] = self.builder.state(node.name, start.numpy())
                    states.append(name)
            elif node.op == "call_function":
                values[node] = self._called(node, values)
            elif node.op == "output":
                results = [value_of(_read(n, values)) for n in node.args[0]]
        of_user = []
        for spec, value in zip(signature.output_specs, results, strict=True):
            if spec.kind.name in CHANGED:
                self.builder.keep(kept[spec.target], value)
            elif spec.kind.name == "USER_OUTPUT":
                of_user.append(value)
        own = of_user[: self.trial.outputs]
        self.builder.output(
            self.builder.outputs, own[0] if len(own) == 1 else joined([v.moved(np.ravel) for v in own], 0)
        )
        for name, value in zip(states, of_user[self.trial.outputs :], strict=not self.trial.sequence):
            self.builder.keep(name, value)

    def _fixed(self, target: str) -> "torch.Tensor":
        """A parameter, a buffer, or a tensor that stands in the module's source."""
        import torch

        found = self.program.state_dict.get(target, self.program.constants.get(target))
        if not isinstance(found, torch.Tensor):
            raise InputError(f"{self.trial.kind}: {target} is {kind_of(found)} and no tensor; a step must not read it")
        if isinstance(found, torch._subclasses.FakeTensor):
            raise InputError(f"{self.trial.kind} reads what it kept of a step before; {STATES}")
        return found.detach()

    def _called(self, node: Any, values: dict) -> Any:
        import torch

        arguments = [_read(a, values) for a in node.args]
        options = {k: _read(a, values) for k, a in node.kwargs.items()}
        if node.target is operator.getitem:
            return arguments[0][arguments[1]]
        base = re.sub("^arc", "a", str(node.target).removeprefix("aten.").split(".")[0])  # arctan is atan
        seeded = "seeded" in str(getattr(node.target, "tags", "")) and "attention" not in base
        if base in RANDOM or (seeded and base not in FUNCTIONS):
            raise self.refused(base, "it draws at random; leave it out")
        if base == "_assert_tensor_metadata":
            return None
        signals = [v for v in _leaves([arguments, list(options.values())]) if isinstance(v, Value)]
        try:
            if base in UNDEFINED:
                found = torch.full(node.meta["val"].shape, torch.nan, dtype=torch.float64)
            elif not signals:
                found = node.target(*arguments, **options)
            elif base in AFFINE | LINEAR:
                found = self.affine(node.target, arguments, options)
            elif base in FUNCTIONS:
                found = FUNCTIONS[base](self, *arguments, **options)
            else:
                raise self.refused(base)
        except InputError as error:
            raise error if str(error).startswith("operation ") else self.refused(base, str(error)) from None
        except Exception as error:  # arguments that a function here does not take
            raise self.refused(base, f"with these arguments it is not carried ({first_line(error)})") from None
        if signals and base not in PLACES:
            self._exact(base)
        return found

    def _exact(self, base: str) -> None:
        """Raise InputError where the module's numbers are of a type that float64 does not stand for."""
        import torch

        def types(found: Any) -> set:
            return {v.dtype for v in _leaves([found]) if hasattr(v, "dtype")}

        given = {k for n in self.node.all_input_nodes for k in types(n.meta.get("val"))}
        whole = {torch.bool, torch.int64} if base in AFFINE | LOGICAL else {torch.int64}
        made = self.node.meta.get("val")
        made = made[0] if base in PLACED and isinstance(made, tuple | list) else made  # without the places
        for kind in types(made):
            if (torch.float64 in given and kind is torch.int64) or kind not in {torch.float64, *whole}:
                raise self.refused(base, f"it computes in {kind}, a network in float64; leave that out, or keep floats")

    def affine(self, target: Any, arguments: Sequence, options: Mapping) -> Any:
        """An operation of torch that is affine in its signals: of their bias, and of each column of their weights."""
        named = {**dict(zip((a.name for a in target._schema.arguments), arguments, strict=False)), **options}
        for key in INDICES & named.keys():
            if any(isinstance(v, Value) for v in _leaves(named[key])):
                raise InputError("its indices must be constant, and are computed from the inputs")
        signals = [v for v in _leaves(list(named.values())) if isinstance(v, Value)]
        factors = [v for k, a in named.items() if k != "bias" for v in _leaves(a) if isinstance(v, Value)]
        if len(factors) > 1 and target._opname in LINEAR:
            return self._bilinear(target, named, factors)
        bias = named.get("bias")

        def results(part: Callable[[Value], np.ndarray], given: dict) -> list[np.ndarray]:
            filled = {k: _mapped(v, lambda x: tensor(part(x), x.shape)) for k, v in given.items()}
            return [np.array(t.numpy(), float) for t in results_of(target(**filled))]

        linear = named if bias is None or isinstance(bias, Value) else {**named, "bias": None}
        whole, zero = results(lambda v: v.bias, named), results(lambda v: np.zeros(v.size), linear)
        width = {s: w.shape[1] for v in signals for s, w in v.weights.items()}
        weights: list[dict] = [{} for _ in whole]
        for signal, n in width.items():
            parts = [{id(v): v.weights.get(signal, np.zeros((v.size, n)))[:, j] for v in signals} for j in range(n)]
            columns = [results(lambda v, of=part: of[id(v)], linear) for part in parts]  # type: ignore[misc]
            for k, before in enumerate(zero):
                weights[k][signal] = np.stack([(c[k] - before).ravel() for c in columns], 1)
        values = [Value(y.shape, y.ravel(), w) for y, w in zip(whole, weights, strict=True)]
        return values if str(target._schema.returns[0].type).startswith("List") else values[0]

    def _bilinear(self, target: Any, named: Mapping[str, Any], signals: Sequence[Value]) -> Value:
        """A sum of products of the elements of one signal with what the other becomes."""
        if len(signals) > 2:
            raise InputError("three of its arguments are signals; write products of two")

        def of(unit: np.ndarray) -> Value:
            left = [tensor(unit, signals[0].shape)]  # the first that is met; the other stays

            def put(v: Any) -> Any:
                if isinstance(v, list | tuple):
                    return [put(i) for i in v]
                return left.pop() if left and v is signals[0] else v

            return self.affine(target, [], {k: put(v) for k, v in named.items() if k != "bias" or v is None})

        found = self.builder.bilinear(signals[0], of, self.hint())
        bias = named.get("bias")
        return found if bias is None else found.plus(value_of(bias))

    def fixed(self, given: Any) -> np.ndarray:
        """An argument that must be a constant."""
        if (found := value_of(given).constant) is None:
            raise InputError("this argument must be a constant, and is computed from the inputs")
        return found

    def refused(self, operation: str, why: str = "") -> InputError:
        """The error for an operation that cannot be carried, with the line of the user's source."""
        import torch

        trace = re.findall(r'File "([^"]+)", line (\d+)[^\n]*\n\s*([^\n]*)', self.node.meta.get("stack_trace") or "")
        library = Path(torch.__file__).parent
        outside = [t for t in trace if library not in Path(t[0]).parents]
        own = outside or trace
        place = f" at {own[-1][0]}:{own[-1][1]}: {own[-1][2].strip()}" if own else ""
        stack = [*(self.node.meta.get("nn_module_stack") or {}).values()]
        if not outside and stack and stack[-1][0]:
            path, kind = stack[-1]
            place = " in " + path.removeprefix("L['self'].") + f" ({str(kind).rpartition('.')[2]})"
        return InputError(f"operation {operation}{place}: {why or CARRIED + curves.instead(operation)}")

    def hint(self) -> str:
        """A name for the layer of this node: the module's path, if it has one."""
        stack = self.node.meta.get("nn_module_stack") or {}
        paths = [path for path, _ in stack.values() if path]
        return paths[-1].removeprefix("L['self'].").replace(".", "_") if paths else str(self.node.name)


CARRIED = (
    "a network carries sums, products with constants and of two signals, slices, joins, tanh, sigmoid, relu, clamp, "
    "abs and recurrent cells of them; "
)
DERIVED = "a derivative (torch.autograd, torch.func) is written out, layer by layer"
UNTRACED = {
    r"data-dependent|DataDependent|\.item\(": "; forward branches on data or reads a number out of a tensor: write "
    "torch.where, torch.clamp or torch.relu",
    "functorch": f"; {DERIVED}",
    "fake": f", which keeps a tensor of it, or takes a derivative of it; {STATES}; {DERIVED}",
}
"""What torch.export says of what it does not take -> what to write."""
CHANGED = ("BUFFER_MUTATION", "PARAMETER_MUTATION")
PLACED = {"max", "min", "sort", "topk", "median"}  # whose places are left out
PLACES = {"argmax", "argmin"}  # whose whole numbers are a result
INDICES = {"index", "indices", "mask", "condition"}
RANDOM = {"native_dropout", "dropout", "rand", "randn", "bernoulli"}
UNDEFINED = {"empty", "empty_like", "new_empty", "empty_strided", "new_empty_strided"}


def _read(x: Any, values: dict) -> Any:
    if isinstance(x, list | tuple):
        return [_read(i, values) for i in x]
    try:
        return values.get(x, x)
    except TypeError:
        return x


def _leaves(x: Any) -> list:
    return [v for i in x for v in _leaves(i)] if isinstance(x, list | tuple) else [x]


def _mapped(x: Any, how: Callable[[Value], Any]) -> Any:
    """The same nested lists with something else for each value."""
    if isinstance(x, list | tuple):
        return [_mapped(i, how) for i in x]
    return how(x) if isinstance(x, Value) else x
