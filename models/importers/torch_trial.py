"""A PyTorch module as its user runs it: one step or a sequence, in float64, as an import is tried beside it."""

import contextlib
import copy
import inspect
import random
import warnings
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from greygate.errors import InputError, shown
from greygate.models.importers.builder import Builder
from greygate.models.network import Network
from greygate.progress import once

if TYPE_CHECKING:
    import torch

STEPS = 10  # that the network and the module take side by side
AGREED = 1e-9  # of the largest that an output is: float64 keeps 16 digits, a cancellation may take some
SILENT = 1e-12  # of a port's scale: an output that is no larger is 0


@contextlib.contextmanager
def undisturbed(kind: "torch.dtype") -> Iterator[None]:
    """New tensors are of that type; it and every generator of random numbers are afterwards as they were before.

    Where it is float64, what `forward` turns into float32 stays float64, too.
    """
    import torch

    class Double(torch.overrides.TorchFunctionMode):
        def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
            if func is torch.Tensor.float:
                func = torch.Tensor.double
            return func(*(_wide(a) for a in args), **{k: _wide(a) for k, a in (kwargs or {}).items()})

    distribution = torch.distributions.Distribution
    before, checked = torch.get_default_dtype(), distribution._validate_args
    drawn = (random.getstate(), np.random.get_state())  # noqa: NPY002, it may be used
    with torch.random.fork_rng(devices=[]), torch.no_grad(), warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # of torch, about its own recurrent modules
        torch.set_default_dtype(kind)
        distribution.set_default_validate_args(False)  # it branches on the data
        try:
            kept = Double() if kind is torch.float64 else contextlib.nullcontext()
            with (
                kept,
                torch.compiler.set_stance("force_eager"),
            ):  # torch.compile would make it anew, for a minute
                yield
        finally:
            torch.set_default_dtype(before)
            distribution.set_default_validate_args(checked)
            random.setstate(drawn[0])
            np.random.set_state(drawn[1])  # noqa: NPY002


def _wide(given: Any) -> Any:
    """An argument that is a type or an array of float32, in float64."""
    import torch

    if isinstance(given, np.ndarray) and given.dtype == np.float32:
        return given.astype(float)
    return torch.float64 if given is torch.float32 else given


def doubled(module: "torch.nn.Module") -> "torch.nn.Module":
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
        raise InputError(f"{type(module).__name__} cannot be copied in float64: {first_line(error)}") from None
    for part in own.modules():
        for key, found in vars(part).items():
            if isinstance(found, torch.Tensor) and found.is_floating_point():
                setattr(part, key, found.detach().cpu().double())
    return own


def start_of(given: Any, k: int) -> "torch.Tensor":
    import torch

    try:
        found = torch.as_tensor(given, dtype=torch.float64).detach().cpu()
    except (TypeError, ValueError, RuntimeError):
        raise InputError(f"state {k + 1}: {shown(given)} is no array of numbers; give what it is at first") from None
    if not found.isfinite().all():
        raise InputError(f"state {k + 1}: a value before the first step is not finite")
    return found


def first_line(error: Exception) -> str:
    """The beginning of what another library says."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:240]}"


class Trial:
    """Runs copies of a module, as a user would: step by step with the states fed on, or along a sequence."""

    def __init__(self, module: "torch.nn.Module", builder: Builder, starts: Sequence["torch.Tensor"]):
        import torch

        self.module, self.builder, self.starts = module, builder, list(starts)
        self.kind = type(module).__name__
        recurrent = [m for m in module.modules() if isinstance(m, torch.nn.RNNBase)]
        self.sequence = bool(recurrent) and not starts
        self.size = sum(p.size for p in builder.inputs)
        self.axis = int(bool(recurrent and recurrent[0].batch_first))  # of the steps, beside a batch of one
        self.outputs = 1  # tensors that forward gives before its states
        self.packed = False  # whether forward takes and gives its states as one tuple
        self.x = torch.zeros(self.size, dtype=torch.float64)

    def first(self) -> None:
        """Take one step. Raises InputError if the module does not, or returns something else than y and its states.

        It may take one sample, a batch of one or a batch of one sequence, and its states likewise.
        """
        import torch

        errors, taken, wanted = [], [], sum(p.size for p in self.builder.outputs)
        for form in list(self._forms()):
            self.x, self.starts, self.packed = form
            try:
                found = self._called(copy.deepcopy(self.module), self.x, self.starts)
            except InputError as error:
                errors.append(error)
                continue
            taken.append((*form, found))
            own = [y for y in self._results(found) if isinstance(y, torch.Tensor)]
            if sum(y.numel() for y in own[: len(own) - len(self.starts)]) == wanted:
                break  # else it may have taken its inputs for a batch
        else:
            if taken:
                self.x, self.starts, self.packed, found = taken[0]
        if not taken:
            batch = f"; nor does it take a batch of one: {str(errors[1]).split(': ', 1)[1]}" if errors[1:] else ""
            raise InputError(
                f"{errors[0]}{batch}; x is one tensor of all inputs: cut others out of it (x[..., :2]). If it takes a "
                "window of samples, compile what torch.onnx.export writes; of a loop along a sequence, write one step"
            )
        results = self._results(found)
        for result in results:
            if not isinstance(result, torch.Tensor):
                raise InputError(f"{self.kind}: forward gives {kind_of(result)}; return tensors: y, or (y, *states)")
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
        results = results_of(found)
        if self.packed and len(results) == 2:
            results = [results[0], *results_of(results[1])]
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
            found = self._results(self._called(module, tensor(row, self.x.shape), states))
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
            module, part = copy.deepcopy(self.module), tensor(x[:count], shape)
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
            raise InputError(
                f"{self.kind} does not take float64 tensors of shape {shapes}: {first_line(error)}"
            ) from None

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


def kind_of(result: Any) -> str:
    return "nothing" if result is None else f"a {type(result).__name__}"


def results_of(found: Any) -> list:
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


def tensor(flat: np.ndarray, shape: Sequence[int]) -> "torch.Tensor":
    import torch

    return torch.from_numpy(np.array(flat)).reshape(tuple(shape))
