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
import inspect
import math
import operator
import random
import re
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from greygate.errors import InputError, shown
from greygate.models.importers import curves, norms
from greygate.models.importers.builder import Builder, Value, constant, joined, stacked, taken
from greygate.models.network import Network, Port
from greygate.progress import once

if TYPE_CHECKING:
    import torch

SEQUENCES = ("RNN", "GRU", "LSTM")
STEPS = 10  # that the network and the module take side by side
AGREED = 1e-9  # of the largest that an output is: float64 keeps 16 digits, a cancellation may take some
FAR = 1e3  # of the largest port: a limit beyond takes three digits of the sum with it, a multiplexer none
DOUBLE = float(np.finfo(float).eps)  # torch's epsilon where none is given
SILENT = 1e-12  # of a port's scale: an output that is no larger is 0


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
    starts = [_start(s, k) for k, s in enumerate(state)]
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
    with _undisturbed(kind):
        trial = _Trial(_double(module), builder, starts)
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


# -- the module ------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def _undisturbed(kind: "torch.dtype") -> Iterator[None]:
    """New tensors are of that type; it and every generator of random numbers are afterwards as they were before.

    Where it is float64, what `forward` turns into float32 stays float64, too.
    """
    import torch

    class Double(torch.overrides.TorchFunctionMode):
        def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
            if func is torch.Tensor.float:
                func = torch.Tensor.double
            wide = {torch.float32: torch.float64}
            given = [wide.get(a, a) if isinstance(a, torch.dtype) else a for a in args]
            named = {k: wide.get(a, a) if isinstance(a, torch.dtype) else a for k, a in (kwargs or {}).items()}
            return func(*given, **named)

    before, drawn = torch.get_default_dtype(), (random.getstate(), np.random.get_state())  # noqa: NPY002, it may be used
    with torch.random.fork_rng(devices=[]), torch.no_grad(), warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # of torch, about its own recurrent modules
        torch.set_default_dtype(kind)
        try:
            kept = Double() if kind is torch.float64 else contextlib.nullcontext()
            with (
                kept,
                torch.compiler.set_stance("force_eager"),
            ):  # torch.compile would make it anew, for a minute
                yield
        finally:
            torch.set_default_dtype(before)
            random.setstate(drawn[0])
            np.random.set_state(drawn[1])  # noqa: NPY002


def _double(module: "torch.nn.Module") -> "torch.nn.Module":
    """A copy in float64 that is not in training, on the CPU."""
    import torch

    if isinstance(module, torch.jit.ScriptModule):
        raise InputError(f"{type(module).__name__} is compiled; give the module of which torch.jit made it")
    if any(isinstance(p, torch.nn.parameter.UninitializedParameter) for p in module.parameters()):
        raise InputError(f"{type(module).__name__} has parameters without a shape; call it once before it is imported")
    held = [v for part in module.modules() for v in vars(part).values() if isinstance(v, torch.Tensor)]
    made = {id(v): v.detach().clone() for v in held if not v.is_leaf}  # of weight_norm, which a hook makes anew
    try:
        own = copy.deepcopy(module, made).cpu().double().eval()
    except Exception as error:  # whatever a module holds
        raise InputError(f"{type(module).__name__} cannot be copied in float64: {_first(error)}") from None
    for part in own.modules():
        for key, found in vars(part).items():
            if isinstance(found, torch.Tensor) and found.is_floating_point():
                setattr(part, key, found.detach().cpu().double())
    return own


def _start(given: Any, k: int) -> "torch.Tensor":
    import torch

    try:
        found = torch.as_tensor(given, dtype=torch.float64).detach().cpu()
    except (TypeError, ValueError, RuntimeError):
        raise InputError(f"state {k + 1}: {shown(given)} is no array of numbers; give what it is at first") from None
    if not found.isfinite().all():
        raise InputError(f"state {k + 1}: a value before the first step is not finite")
    return found


def _first(error: Exception) -> str:
    """The beginning of what another library says."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:240]}"


class _Trial:
    """Runs copies of a module, as a user would: step by step with the states fed on, or along a sequence."""

    def __init__(self, module: "torch.nn.Module", builder: Builder, starts: Sequence["torch.Tensor"]):
        import torch

        self.module, self.builder, self.starts = module, builder, list(starts)
        self.kind = type(module).__name__
        self.sequence = any(type(m).__name__ in SEQUENCES for m in module.modules()) and not starts
        self.size = sum(p.size for p in builder.inputs)
        recurrent = [m for m in module.modules() if type(m).__name__ in SEQUENCES]
        self.axis = int(bool(recurrent and recurrent[0].batch_first))  # of the steps, beside a batch of one
        self.outputs = 1  # tensors that forward gives before its states
        self.packed = False  # whether forward takes and gives its states as one tuple
        self.x = torch.zeros(self.size, dtype=torch.float64)

    def first(self) -> None:
        """Take one step. Raises InputError if the module does not, or returns something else than y and its states.

        It may take one sample, a batch of one or a batch of one sequence, and its states likewise.
        """
        import torch

        errors = []
        for form in list(self._forms()):
            self.x, self.starts, self.packed = form
            try:
                found = self._called(copy.deepcopy(self.module), self.x, self.starts)
                break
            except InputError as error:
                errors.append(error)
        else:
            batch = f"; nor does it take a batch of one: {str(errors[1]).split(': ', 1)[1]}" if errors[1:] else ""
            raise InputError(
                f"{errors[0]}{batch}; x is one tensor of all inputs. If it takes a window of samples, compile what "
                "torch.onnx.export writes"
            )
        results = self._results(found)
        for result in results:
            if not isinstance(result, torch.Tensor):
                raise InputError(f"{self.kind}: forward gives {_kind(result)}; return tensors: y, or (y, *states)")
        self.outputs = len(results) - len(self.starts)
        if self.outputs < 1:
            raise InputError(
                f"forward gives {len(results)} results; give y, and {len(self.starts)} states, one for each of `state`"
            )

    def _forms(self) -> Iterator[tuple["torch.Tensor", list["torch.Tensor"], bool]]:
        """(x, states, whether these are one tuple) of one step, the plainest first."""
        samples = [(1, self.size), (1, 1, self.size)] if self.sequence else [(self.size,), (1, self.size)]
        deeper = [] if self.sequence or not self.starts else [(1, 1, self.size)]
        for shape in (*samples, *deeper):
            states = self.starts
            for _ in range(len(shape) if self.starts else 1):
                for packed in (False, True)[: 1 + (len(states) > 1)]:
                    yield self.x.reshape(shape), states, packed
                states = [v[None] for v in states]

    def _results(self, found: Any) -> list:
        """y and the states that forward is given; along a sequence its last ones go on by themselves."""
        results = _results(found)
        if self.packed and len(results) == 2:
            results = [results[0], *_results(results[1])]
        return results[:1] if self.sequence else results

    def compare(self, network: Network) -> None:
        """Raise InputError unless the network answers to random steps as the module does, from step to step; say it."""
        rng, ports = np.random.default_rng(0), self.builder.inputs
        size = np.resize([1.0, 0.1, 10.0], STEPS)  # within and beyond the limits that a module may have
        drawn = [p.offset + p.scale * size[:, None] * rng.standard_normal((STEPS, p.size)) for p in ports]
        found = network.run({p.name: v[:, 0] if p.size == 1 else v for p, v in zip(ports, drawn, strict=True)})
        got = np.column_stack([found[p.name].reshape(STEPS, p.size) for p in self.builder.outputs])
        answers, x = self.along if self.sequence else self.stepped, np.concatenate(drawn, 1)
        steps, wanted = answers(x)
        got, again = got[steps], answers(x)[1]
        names = [p.name for p in self.builder.outputs for _ in range(p.size)]
        scales = np.array([p.scale for p in self.builder.outputs for _ in range(p.size)])
        finite = np.where(np.isfinite(wanted), np.abs(wanted), 0.0)
        allowed = np.maximum(AGREED * finite.max(0), SILENT * scales)
        for other, what in (
            (again, "from itself, run twice on the same inputs: it draws at random, or remembers; leave that out"),
            (got, "from the network made of it, so forward does what torch.export does not show, such as memory"),
        ):
            apart = ~(np.abs(other - wanted) <= allowed) & ~(np.isnan(wanted) & np.isnan(other)) & (other != wanted)
            if apart.any():
                row, k = np.argwhere(apart)[0]
                by = f"{wanted[row, k]:.6g} beside {other[row, k]:.6g} in {names[k]} at step {steps[row] + 1}"
                if not np.isfinite(wanted[row, k]):
                    raise InputError(f"{self.kind} gives {by}: {LIMIT}")
                raise InputError(f"{self.kind} differs {what}: {by}")
        with np.errstate(all="ignore"):
            largest = np.nan_to_num(np.abs(got - wanted) / np.maximum(finite.max(0), SILENT * scales)).max(initial=0.0)
        once(f"{self.kind}: torch and the network differ by at most {largest:.2g} in {STEPS} random steps")

    def stepped(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(steps, outputs at these) of a module that takes one step at a time, its states fed on."""
        module, states, rows = copy.deepcopy(self.module), self.starts, []
        before: dict[str, Any] = {}
        for row in x:
            found = self._results(self._called(module, _tensor(row, self.x.shape), states))
            states = found[self.outputs :]
            rows.append(np.concatenate([_array(y) for y in found[: self.outputs]]))
            before = before or _attributes(module)  # what a first step sets once may stay
        self._forgets(before, module)
        return np.arange(len(x)), np.array(rows)

    def along(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(steps, outputs at these) of a module that takes a sequence: of this one, and of its first steps alone.

        A module that gives no more than one step is taken to give the last one.
        """
        total, steps, rows = sum(p.size for p in self.builder.outputs), [], []
        for count in range(1, len(x) + 1):
            shape = list(self.x.shape)
            shape[self.axis if len(shape) > 2 else 0] = count
            module, part = copy.deepcopy(self.module), _tensor(x[:count], shape)
            y = _array(self._results(self._called(module, part, []))[0])
            if y.size not in (total, count * total):
                raise InputError(f"{self.kind}: of {count} steps forward gives {y.size} numbers; give {total} for each")
            rows.append(y.reshape(-1, total))
            steps.append(np.arange(count - len(rows[-1]), count))
        before = _attributes(module)
        self._called(module, part, [])
        self._forgets(before, module)
        return np.concatenate(steps), np.concatenate(rows)

    def _called(self, module: "torch.nn.Module", x: "torch.Tensor", states: Sequence["torch.Tensor"]) -> Any:
        """What `forward` returns, of tensors that it may change."""
        try:
            return module(x.clone(), *self.given(states))
        except Exception as error:  # whatever the module raises on a step
            shapes = ", ".join(str(list(v.shape)) for v in (x, *states))
            raise InputError(f"{self.kind} does not take float64 tensors of shape {shapes}: {_first(error)}") from None

    def given(self, states: Sequence["torch.Tensor"]) -> tuple:
        """The arguments of forward behind x."""
        own = tuple(s.clone() for s in states)
        return (own,) if self.packed else own

    def _forgets(self, before: Mapping[str, Any], module: "torch.nn.Module") -> None:
        """Raise InputError if a step changes what no state and no buffer is."""
        after = _attributes(module)
        changed = [path for path in {**before, **after} if before.get(path) != after.get(path)]
        if changed:
            raise InputError(f"{self.kind} keeps {changed[0]} from step to step, in an attribute; {STATES}")


LIMIT = "it divides by 0, or takes its root or logarithm; limit what may be 0 from below (torch.clamp)"
STATES = "make it a buffer (register_buffer), or write forward(x, *states) -> (y, *states)"


def _kind(result: Any) -> str:
    return "nothing" if result is None else f"a {type(result).__name__}"


def _results(found: Any) -> list:
    """Of a dict its values, in their order."""
    if isinstance(found, Mapping):
        return list(found.values())
    return list(found) if isinstance(found, tuple | list) else [found]


def _array(tensor: "torch.Tensor") -> np.ndarray:
    try:
        return tensor.detach().double().numpy().ravel()
    except (RuntimeError, TypeError):  # a sparse one, or one of the graph that was kept for a later step
        raise InputError(f"forward gives a {type(tensor).__name__} without numbers to read; {STATES}") from None


def _attributes(module: "torch.nn.Module") -> dict[str, Any]:
    """What the parts of a module hold besides parameters and buffers, in a form that can be compared."""
    import torch

    own, seen = set(vars(torch.nn.Module())), dict[int, Any]()
    return {
        f"{path}.{key}".lstrip("."): _content(found, seen)
        for path, part in module.named_modules()
        for key, found in vars(part).items()
        if key not in own
    }


def _content(x: Any, seen: dict[int, Any]) -> Any:
    """What equals that of another value of the same content. seen: every object is read once."""
    import torch

    if isinstance(x, torch.Tensor | np.ndarray):
        array = x.detach().cpu().numpy() if isinstance(x, torch.Tensor) else x
        return str(array.dtype), array.shape, array.tobytes()
    if isinstance(x, str | bytes | int | float | complex | None):
        return repr(x)
    if id(x) in seen or isinstance(x, type) or inspect.isroutine(x):
        return None
    seen[id(x)] = x
    if isinstance(x, Mapping):
        return [(repr(k), _content(v, seen)) for k, v in x.items()]
    if isinstance(x, list | tuple | deque):
        return [_content(v, seen) for v in x]
    return [(k, _content(v, seen)) for k, v in vars(x).items()] if hasattr(x, "__dict__") else repr(x)


# -- the graph -------------------------------------------------------------------------------------------------------


class _Walk:
    """Walks the graph of an exported program; each node becomes a `Value` or, if it reads no signal, a tensor."""

    def __init__(self, builder: Builder, trial: _Trial):
        import torch

        self.builder, self.trial = builder, trial
        self.node: Any = None
        own = copy.deepcopy(trial.module)
        given = (trial.x.clone(), *trial.given(trial.starts))
        try:
            self.program: Any = torch.export.export(own, given, strict=False).run_decompositions({})
        except Exception as error:  # whatever cannot be traced
            said = _first(error)
            branches = re.search(r"data-dependent|DataDependent|\.item\(", said)
            why = f"; {BRANCH}" if branches else f", which keeps a tensor of it; {STATES}" if "fake" in said else ""
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
                results = [_value(_read(n, values)) for n in node.args[0]]
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
            raise InputError(f"{self.trial.kind}: {target} is {_kind(found)} and no tensor; a step must not read it")
        if isinstance(found, torch._subclasses.FakeTensor):
            raise InputError(f"{self.trial.kind} reads what it kept of a step before; {STATES}")
        return found.detach()

    def _called(self, node: Any, values: dict) -> Any:
        import torch

        arguments = [_read(a, values) for a in node.args]
        options = {k: _read(a, values) for k, a in node.kwargs.items()}
        if node.target is operator.getitem:
            return arguments[0][arguments[1]]
        base = str(node.target).removeprefix("aten.").split(".")[0]
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
            raise self.refused(base, f"with these arguments it is not carried ({_first(error)})") from None
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
            filled = {k: _mapped(v, lambda x: _tensor(part(x), x.shape)) for k, v in given.items()}
            return [np.array(t.numpy(), float) for t in _results(target(**filled))]

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
            left = [_tensor(unit, signals[0].shape)]  # the first that is met; the other stays

            def put(v: Any) -> Any:
                if isinstance(v, list | tuple):
                    return [put(i) for i in v]
                return left.pop() if left and v is signals[0] else v

            return self.affine(target, [], {k: put(v) for k, v in named.items() if k != "bias" or v is None})

        found = self.builder.bilinear(signals[0], of, self.hint())
        bias = named.get("bias")
        return found if bias is None else found.plus(_value(bias))

    def fixed(self, given: Any) -> np.ndarray:
        """An argument that must be a constant."""
        if (found := _value(given).constant) is None:
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
BRANCH = "forward branches on data or reads a number out of a tensor: write torch.where, torch.clamp or torch.relu"
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


def _tensor(flat: np.ndarray, shape: Sequence[int]) -> "torch.Tensor":
    import torch

    return torch.from_numpy(np.array(flat)).reshape(tuple(shape))


def _value(x: Any) -> Value:
    return x if isinstance(x, Value) else constant(x.detach().numpy() if hasattr(x, "detach") else x)


def _add(walk: _Walk, a: Any, b: Any, alpha: float = 1.0) -> Value:
    return _value(a).plus(_value(b).times(alpha))


def _multiply(walk: _Walk, a: Any, b: Any) -> Value:
    return walk.builder.product(_value(a), _value(b), walk.hint())


def _divide(walk: _Walk, a: Any, b: Any, rounding_mode: Any = None) -> Value:
    if rounding_mode is not None:
        raise walk.refused("div", "it rounds to whole numbers; leave that out")
    if (by := _value(b).constant) is None:
        if len(walk.node.args) > 1 and _of_softsign(*walk.node.args[:2]):
            return _softsign(walk.builder, _value(a), walk.hint())
        return _multiply(walk, a, norms.inverse(walk.builder, _value(b), walk.hint()))
    return _value(a).times(1.0 / by)


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

    def run(walk: _Walk, c: Any, a: Any, b: Any, beta: float = 1.0, alpha: float = 1.0) -> Value:
        import torch

        product = walk.affine(getattr(torch.ops.aten, kind).default, [a, b], {})
        return product.times(alpha).plus(_value(c).times(beta))

    return run


def _activated(kind: str) -> Callable:
    return lambda walk, x: walk.builder.activated(x, kind, walk.hint())


def _chosen(walk: _Walk, condition: Value, above: Any, below: Any) -> Value:
    """`above` where the condition is 0 or more, else `below`."""
    return walk.builder.chosen(condition, _value(above), _value(below), walk.hint())


def _less(walk: _Walk, a: Any, b: Any) -> Value:
    return _value(a).plus(_value(b).times(-1.0))


def _where(walk: _Walk, condition: Any, above: Any, below: Any) -> Value:
    if not isinstance(condition, Value):
        return walk.affine(walk.node.target, [condition, above, below], {})
    return _chosen(walk, condition.plus(constant(-0.5)), above, below)  # 1 or 0


def _logical(how: Callable[[Value], Value]) -> Callable:
    """A function of the sum of truths, each 1 or 0."""

    def run(walk: _Walk, *truths: Any) -> Value:
        if any(str(n.meta["val"].dtype) != "torch.bool" for n in walk.node.all_input_nodes):
            raise InputError("of numbers that are not true or false")
        total = constant(0.0)
        for truth in truths:
            total = total.plus(_value(truth))
        return how(total) if len(truths) == 1 else walk.builder.activated(how(total), "hardlim", walk.hint())

    return run


_not = _logical(lambda x: x.times(-1.0).plus(constant(1.0)))
_and = _logical(lambda total: total.plus(constant(-1.5)))
_or = _logical(lambda total: total.plus(constant(-0.5)))


def _masked(walk: _Walk, x: Any, mask: Any, other: Any) -> Value:
    if not isinstance(mask, Value):
        return walk.affine(walk.node.target, [x, mask, other], {})
    return _where(walk, mask, other, x)


def _maximum(walk: _Walk, a: Any, b: Any) -> Value:
    return walk.builder.maximum(_value(a), _value(b), walk.hint())


def _minimum(walk: _Walk, a: Any, b: Any) -> Value:
    return walk.builder.minimum(_value(a), _value(b), walk.hint())


def _extreme(sign: float) -> Callable:
    """The maximum (1) or minimum (-1): of two tensors, or along axes, without its places."""

    def run(walk: _Walk, x: Value, other: Any = (), keep: bool = False) -> Any:
        if not isinstance(other, int | list | tuple):
            return (_maximum if sign > 0 else _minimum)(walk, x, other)
        along = [other] if isinstance(other, int) else list(other)
        found = walk.builder.largest(_value(x).times(sign), along, bool(keep), walk.hint()).times(sign)
        return [found, None] if isinstance(other, int) else found

    return run


def _curve(how: Callable) -> Callable:
    return lambda walk, x, *options, **named: how(walk.builder, x, walk.hint(), *options, **named)


def _log_sigmoid(builder: Builder, x: Value, hint: str) -> Value:
    return x.plus(curves.softplus(builder, x, hint).times(-1.0))


def _softsign(builder: Builder, x: Value, hint: str) -> Value:
    return builder.activated(x, "softsign", hint)


def _clamp(walk: _Walk, x: Value, low: Any = None, high: Any = None, **options: Any) -> Value:
    """Limits are numbers, arrays or signals; one that is infinite is none."""
    given = [options.get("min", low), options.get("max", high)]
    limits = [None if v is None else _value(v) for v in given]
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


def _power(walk: _Walk, x: Any, n: Any) -> Value:
    """Every element to its own exponent."""
    if isinstance(n, Value):
        raise InputError("its exponent is a signal; a number can be carried")
    return norms.powers(walk.builder, x, np.asarray(n, float), walk.hint())


def _prelu(walk: _Walk, x: Value, slope: Any) -> Value:
    """A slope for each channel, which is axis 1."""
    found = walk.fixed(slope)
    slopes = found.reshape(1, -1, *[1] * (len(x.shape) - 2)) if found.size > 1 else found.reshape(())
    return walk.builder.rectified(x, slopes, walk.hint())


def _rrelu(walk: _Walk, x: Value, low: float = 1 / 8, high: float = 1 / 3, training: bool = False, *_: Any) -> Value:
    if training:
        raise InputError("it draws its slopes at random in training")
    return walk.builder.rectified(x, (low + high) / 2, walk.hint())


def _unit(walk: _Walk, x: Value) -> Value:
    return walk.builder.clipped(x.times(1 / 6).plus(constant(0.5)), 0.0, 1.0, walk.hint())


def _gated(walk: _Walk, x: Value, gate: Value) -> Value:
    return walk.builder.product(x, walk.builder.activated(gate, "logsig", walk.hint()), walk.hint())


def _halves(walk: _Walk, x: Value, dim: int = -1) -> Value:
    return _gated(walk, *x.parts([x.shape[dim] // 2] * 2, dim))


def _normed(walk: _Walk, x: Value, w: Any, b: Any, mean: Any, var: Any, *rest: Any) -> list:
    """By fixed statistics for each channel, which is axis 1."""
    shape = (-1, *[1] * (len(x.shape) - 2))
    center, spread = (walk.fixed(v).reshape(shape) for v in (mean, var))
    gain, shift = (0.0 if v is None else walk.fixed(v).reshape(shape) for v in (w, b))
    scale = (1.0 if w is None else gain) / np.sqrt(spread + rest[-1])
    return [x.plus(constant(-center)).times(scale).plus(constant(shift)), None, None]


def _softmax(how: Callable) -> Callable:
    return lambda walk, x, dim, *_, **__: how(walk.builder, x, dim, walk.hint())


def _log_sum(walk: _Walk, x: Value, dim: Any, keepdim: bool = False) -> Value:
    return norms.log_sum(walk.builder, x, [dim] if isinstance(dim, int) else dim, keepdim, walk.hint())


def _shifted(x: Value, w: Any, b: Any, shape: Sequence[int]) -> Value:
    """Times a gain, plus a bias, where they are given, each in that shape."""
    for given, how in ((w, Value.times), (b, lambda v, by: v.plus(constant(by)))):
        if given is not None:
            x = how(x, _value(given).bias.reshape(tuple(shape)))
    return x


def _layer_norm(
    walk: _Walk, x: Value, shape: list[int], w: Any = None, b: Any = None, eps: float = 1e-5, *_: Any
) -> list:
    axes = list(range(len(x.shape) - len(shape), len(x.shape)))
    return [_shifted(norms.normalised(walk.builder, x, axes, eps, walk.hint()), w, b, shape), None, None]


def _rms_norm(walk: _Walk, x: Value, shape: list[int], w: Any = None, eps: float | None = None) -> list:
    axes = list(range(len(x.shape) - len(shape), len(x.shape)))
    found = norms.normalised(walk.builder, x, axes, DOUBLE if eps is None else eps, walk.hint(), centred=False)
    return [_shifted(found, w, None, shape), None]


def _group_norm(walk: _Walk, x: Value, groups: int, w: Any = None, b: Any = None, eps: float = 1e-5, *_: Any) -> Value:
    parts = x.moved(lambda i: i.reshape(x.shape[0], groups, -1))
    found = norms.normalised(walk.builder, parts, [-1], eps, walk.hint()).moved(lambda i: i.reshape(x.shape))
    return _shifted(found, w, b, (-1, *[1] * (len(x.shape) - 2)))


def _variance(walk: _Walk, x: Value, dim: Any = None, correction: Any = 1, keepdim: bool = False, **_: Any) -> Value:
    if isinstance(dim, bool):
        dim, correction = None, dim  # an older form, of `unbiased` alone
    axes = [dim] if isinstance(dim, int) else list(dim or range(len(x.shape)))
    own = walk.builder.activated(x.plus(x.mean(axes, True).times(-1.0)), "linear", walk.hint())
    found = walk.builder.power(own, 2, walk.hint()).summed(axes, keepdim)
    return found.times(1 / (x.size / found.size - (1 if correction is None else float(correction))))


def _attention(
    walk: _Walk, q: Any, k: Any, v: Any, mask: Any = None, dropout: float = 0.0, causal: bool = False,
    scale: float | None = None, **_: Any,
) -> Value:  # fmt: skip
    if dropout:
        raise InputError("it drops at random in training")
    q, k, v = (_value(given) for given in (q, k, v))
    seen = np.tri(q.shape[-2], k.shape[-2], dtype=bool) if causal else np.ones(1, bool)
    added = constant(np.where(seen, 0.0, -np.inf))
    if mask is not None:
        found = walk.fixed(mask)
        truths = str(getattr(mask, "dtype", "")) == "torch.bool"
        added = constant(np.where(found, 0.0, -np.inf) if truths else found)
    return norms.attention(walk.builder, q, k, v, added, scale or q.shape[-1] ** -0.5, walk.hint())


def _cosine(walk: _Walk, a: Any, b: Any, dim: int = 1, eps: float = 1e-8) -> Value:
    """Of the angle between two."""
    one, two = _value(a), _value(b)
    lengths = [
        walk.builder.clipped(_length(walk, v, 2, dim), eps, None, walk.hint()) if v.weights
        else constant(np.maximum(np.linalg.norm(walk.fixed(v), axis=dim), eps))
        for v in (one, two)
    ]  # fmt: skip
    found = walk.builder.product(one, two, walk.hint()).summed([dim])
    for length in lengths:
        found = _divide(walk, found, length)
    return found


def _log_add(walk: _Walk, a: Any, b: Any) -> Value:
    return norms.log_sum(walk.builder, stacked([_value(a), _value(b)], 0), [0], False, walk.hint())


def _length(walk: _Walk, x: Value, order: Any = 2, dim: Any = None, keepdim: bool = False, **_: Any) -> Value:
    axes = [dim] if isinstance(dim, int) else list(dim or [])
    if order == 1:
        return walk.builder.rectified(x, -1.0, walk.hint()).summed(axes, keepdim)
    if order != 2:
        raise InputError(f"its order is {order}; 1 and 2 can be carried")
    return norms.root(walk.builder, walk.builder.power(x, 2, walk.hint()).summed(axes, keepdim), walk.hint())


def _distances(walk: _Walk, a: Any, b: Any, order: float = 2.0, *_: Any) -> Value:
    """Of every row of one from every row of the other."""
    apart = (
        _value(a).moved(lambda i: i[..., :, None, :]).plus(_value(b).moved(lambda i: i[..., None, :, :]).times(-1.0))
    )
    return _length(walk, apart, order, -1)


def _sorted(walk: _Walk, x: Value, dim: int = -1, descending: bool = False, **_: Any) -> list[Value | None]:
    """Of their places nothing is known."""
    found = walk.builder.ordered(x, dim, walk.hint())
    return [joined(found[::-1] if descending else found, dim), None]


def _top(walk: _Walk, x: Value, count: int, dim: int = -1, largest: bool = True, *_: Any) -> list[Value | None]:
    found = walk.builder.ordered(x, dim, walk.hint())
    return [joined((found[::-1] if largest else found)[:count], dim), None]


def _median(walk: _Walk, x: Value, dim: int | None = None, keep: bool = False) -> Any:
    """The lower one of two."""
    flat = x if dim is not None else x.moved(np.ravel)
    axis = -1 if dim is None else dim
    found = walk.builder.ordered(flat, axis, walk.hint())[(flat.shape[axis] - 1) // 2]
    found = found if keep else found.moved(lambda i: np.squeeze(i, axis))
    return found if dim is None else [found, None]


def _angle(walk: _Walk, y: Any, x: Any) -> Value:
    return norms.arctan2(walk.builder, _value(y), _value(x), walk.hint())


def _logarithm(base: float) -> Callable:
    return lambda walk, x: norms.ln(walk.builder, x, walk.hint()).times(1 / math.log(base))


def _place(sign: float) -> Callable:
    """The index of the maximum (1) or the minimum (-1), along an axis or of all."""

    def run(walk: _Walk, x: Value, dim: int | None = None, keep: bool = False) -> Value:
        turned = x.times(sign)
        if dim is None:
            return walk.builder.place(turned.moved(np.ravel), 0, False, walk.hint())
        return walk.builder.place(turned, dim, keep, walk.hint())

    return run


def _instance(walk: _Walk, x: Value, w: Any, b: Any, mean: Any, var: Any, own: bool, *rest: Any) -> Value:
    if own:
        return _group_norm(walk, x, x.shape[1], w, b, rest[1])
    return _normed(walk, x, w, b, mean, var, rest[1])[0]


def _shaped(walk: _Walk, x: Value, *arguments: Any, **options: Any) -> Any:
    """A new tensor in the shape of another, whatever that holds."""
    return walk.node.target(_tensor(np.zeros(x.size), x.shape), *arguments, **options)


def _layers(kind: str, count: int) -> Callable:
    """A recurrent module of `count` states a layer. Along the sequence of a module, the states that it makes go on."""

    def run(
        walk: _Walk, x: Any, given: Any, flat: list, biased: bool, layers: int, dropout: float, train: bool, both: bool,
        batch_first: bool = False,
    ) -> list[Value]:  # fmt: skip
        if both is not False and both is not True:
            raise InputError("its sequence is packed; give it a tensor")
        if both:
            raise InputError("it runs in both directions, so a step needs what comes later")
        if train and dropout:
            raise InputError("it drops at random in training")
        states = [_value(v) for v in (given if isinstance(given, list) else [given])]
        x = _value(x).moved(lambda i: np.swapaxes(i, 0, 1)) if batch_first else _value(x)
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

    def run(walk: _Walk, x: Any, given: Any, *weights: Any) -> Any:
        states = [_value(v) for v in (given if isinstance(given, list) else [given])]
        w = [walk.fixed(v) for v in weights if v is not None]
        after = _cell(walk, kind, _value(x), states, w, walk.hint())
        return after if len(after) > 1 else after[0]

    return run


def _cell(walk: _Walk, kind: str, x: Value, states: list[Value], w: list[np.ndarray], hint: str) -> list[Value]:
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
    "gt", "ge", "lt", "le", "where", "logical_not", "bitwise_not", "logical_and", "bitwise_and", "__and__",
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
    "tanh": _activated("tansig"), "sigmoid": _activated("logsig"),
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
    **dict.fromkeys(["_to_copy", "to", "type_as"], lambda walk, x, *_, **__: x),
    **dict.fromkeys(["zero", "zeros_like", "ones_like", "full_like", "new_zeros", "new_ones", "new_full"], _shaped),
    **dict.fromkeys(["softmax", "_softmax"], _softmax(norms.softmax)),
    **dict.fromkeys(["log_softmax", "_log_softmax"], _softmax(norms.log_softmax)),
    "scaled_dot_product_attention": _attention, "cosine_similarity": _cosine, "logaddexp": _log_add,
    "exp": _curve(norms.exp), "log": _curve(norms.ln), "sin": _curve(norms.sine), "cos": _curve(norms.cosine),
    "log1p": lambda walk, x: norms.ln(walk.builder, x.plus(constant(1.0)), walk.hint()),
    "log2": _logarithm(2.0), "log10": _logarithm(10.0),
    **dict.fromkeys(["atan", "arctan"], _curve(norms.arctan)),
    **dict.fromkeys(["asin", "arcsin"], _curve(norms.arcsine)),
    **dict.fromkeys(["acos", "arccos"], lambda walk, x: _add(walk, math.pi / 2, _curve(norms.arcsine)(walk, x), -1.0)),
    **dict.fromkeys(["asinh", "arcsinh"], _curve(norms.arsinh)),
    "sinh": lambda walk, x: norms.hyperbolic(walk.builder, x, -1.0, walk.hint()),
    "cosh": lambda walk, x: norms.hyperbolic(walk.builder, x, 1.0, walk.hint()),
    "tan": lambda walk, x: _divide(walk, _curve(norms.sine)(walk, x), _curve(norms.cosine)(walk, x)),
    "floor": _curve(norms.floor), "ceil": _curve(norms.ceil), "nan_to_num": lambda walk, x, *_: x,
    "remainder": lambda walk, x, by: norms.remainder(walk.builder, x, walk.fixed(by), walk.hint()),
    "sort": _sorted, "topk": _top, "median": _median,
    **dict.fromkeys(["atan2", "arctan2"], _angle),
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
