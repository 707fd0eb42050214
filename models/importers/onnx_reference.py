"""Operations of ONNX on arrays, by its own reference, within limits; whether a network answers as its model."""

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from functools import cache
from math import ceil, prod
from typing import Any, NamedTuple

import numpy as np

from greygate.errors import InputError, one_line, shown
from greygate.models.importers.onnx_file import ELEMENTS, QONNX, messages
from greygate.models.importers.onnx_recurrent import GATES, Options, computed
from greygate.models.importers.qonnx import LINEAR, quantized
from greygate.models.network import Network

AGREED = 1e-6  # of the largest answer: float64 on both sides, and products of signals made of squares
LEAST = 1e-12  # what is smaller is the rounding of an answer that should be 0
CHECKED = 4 * ELEMENTS  # numbers that the comparison with the reference may compute
ROWS = 4096  # samples of a window or a batch that are tried
IMAGE = 4  # axes: batch, channels, height, width
BOOL = 9  # of ONNX's types
SAMPLES = 3  # of an axis whose length is free
UNTRIED = "ONNX's reference does not run"
LIMIT = "it divides by 0, or takes its root or logarithm; limit what may be 0 from below (Clip)"
DRAWS = 4  # of samples along an axis
SPREAD = (0.3, 1.0, 3.0)  # of the numbers that are tried, one sample each

ELEMENTWISE = {
    "Abs", "Acos", "Acosh", "Add", "And", "Asin", "Asinh", "Atan", "Atanh", "Ceil", "Clip", "Cos", "Cosh", "Div",
    "Elu", "Equal", "Erf", "Exp", "Floor", "Greater", "GreaterOrEqual", "HardSigmoid", "HardSwish", "IsInf", "IsNaN",
    "LeakyRelu", "Less", "LessOrEqual", "Log", "Max", "Mean", "Min", "Mod", "Mul", "Neg", "Not", "Or", "PRelu", "Pow",
    "Reciprocal", "Relu", "Round", "Selu", "Sigmoid", "Sign", "Sin", "Sinh", "Softplus", "Softsign", "Sqrt", "Sub",
    "Sum", "Tan", "Tanh", "Where", "Xor", "Celu", "Gelu", "Hardmax", "LogSoftmax", "LpNormalization", "Mish", "Shrink",
    "Softmax", "Swish", "ThresholdedRelu",
}  # fmt: skip
REARRANGING = {
    "ArgMax", "ArgMin", "Cast", "CastLike", "Concat", "CumSum", "EyeLike", "Flatten", "Identity", "ReduceL1",
    "ReduceL2", "ReduceMax", "ReduceMean", "ReduceMin", "ReduceProd", "ReduceSum", "ReduceSumSquare", "Reshape",
    "Shape", "Size", "Slice", "Split", "Squeeze", "Transpose", "Trilu", "Unsqueeze", "DequantizeLinear",
    "GatherElements", "QuantizeLinear", "ReduceLogSum", "ReduceLogSumExp", "ScatterElements", "ScatterND", "TopK",
}  # fmt: skip
"""Operations whose results have no more numbers than what they read."""


def _extent(shape: Iterable[int]) -> int:
    """Numbers, where an axis of length 0 counts as 1: a sum along it has as many."""
    return prod(max(int(n), 1) for n in shape)


def _product(a: np.ndarray, b: np.ndarray) -> int:
    batch = np.broadcast_shapes(a.shape[:-2], b.shape[:-2])
    return _extent((*batch, *a.shape[-2:-1], *(b.shape[-1:] if b.ndim > 1 else ())))


def _multiplied(a: np.ndarray, b: np.ndarray, c: Any = None) -> int:
    return max(a.shape) * max(b.shape)


def _counted(start: np.ndarray, limit: np.ndarray, step: np.ndarray) -> int:
    return max(0, ceil((float(limit) - float(start)) / float(step)))


def _padded(x: np.ndarray, pads: np.ndarray, *_: Any) -> int:
    return _extent(n + int(np.abs(pads.astype(float)).sum()) for n in x.shape)


GROWING: Mapping[str, Callable[..., int]] = {
    "ConstantOfShape": lambda shape: _extent(shape),
    "Expand": lambda x, shape: _extent(np.broadcast_shapes(x.shape, tuple(int(n) for n in shape))),
    "Tile": lambda x, repeats: _extent(n * int(r) for n, r in zip(x.shape, repeats, strict=True)),
    "Range": _counted,
    "Gather": lambda x, places: _extent(x.shape) * _extent(places.shape),
    "Pad": _padded,
    "GatherND": lambda x, places: _extent(x.shape) * _extent(places.shape),
    "OneHot": lambda places, depth, values: _extent(places.shape) * max(int(np.max(depth)), 1),
    "Einsum": lambda *factors: prod(_extent(f.shape) for f in factors),
    "Conv": lambda x, w, *_: x.shape[0] * _extent(x.shape[2:]) * _extent(w.shape),
    "ConvTranspose": lambda x, w, *_: _extent(x.shape) * _extent(w.shape),
    "MatMul": _product,
    "Gemm": _multiplied,
}
"""Operation -> how many numbers its result has at most."""
FOLDED = ELEMENTWISE | REARRANGING | GROWING.keys()
"""What is computed where every input is a constant: always the same, in a time that its numbers bound."""

AFFINE: Mapping[str, tuple[int, ...]] = {
    "ConvTranspose": (0,), "CumSum": (0,), "DepthToSpace": (0,), "Einsum": (0, 1), "GatherElements": (0,),
    "GatherND": (0,), "Pad": (0,), "ScatterElements": (0, 2), "ScatterND": (0, 2), "SpaceToDepth": (0,), "Tile": (0,),
    "Trilu": (0,),
}  # fmt: skip
"""Operation -> the inputs in which it is affine, together; the others must be constant."""
BILINEAR = {"ConvTranspose", "Einsum"}


NEWER = {"DequantizeLinear": 19, "QuantizeLinear": 19}
"""Operation -> the least opset that the reference has it of; an older one is the same with fewer types."""


class Reference:
    """Computes nodes of a model. elements: how many numbers all results together may have. double: in float64."""

    def __init__(self, opsets: Sequence[Any], elements: int = ELEMENTS, double: bool = False):
        self.opsets, self.most, self.left, self.double = opsets, elements, elements, double
        self._ready: dict[int, tuple[Any, Any]] = {}

    def run(self, node: Any, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Output -> array. Raises InputError above the limit, and whatever the reference raises."""
        given = [values[n] if n else None for n in node.input]
        self._spend(node, given)
        names = {n: values[n] for n in (*node.input, *captured(node)) if n}
        if id(node) not in self._ready:
            self._ready[id(node)] = node, self._evaluator(node, names)
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            found = self._ready[id(node)][1].run(None, names)
        return {n: np.asarray(v) for n, v in zip([o for o in node.output if o], found, strict=True)}

    def _evaluator(self, node: Any, names: Mapping[str, np.ndarray]) -> Any:
        from onnx import helper
        from onnx.reference import ReferenceEvaluator

        node = _doubled(node) if self.double and any(a.HasField("g") for a in node.attribute) else node
        ins = [
            helper.make_tensor_value_info(n, helper.np_dtype_to_tensor_dtype(v.dtype), None) for n, v in names.items()
        ]
        outs = [helper.make_tensor_value_info(n, 0, None) for n in node.output if n]
        graph = helper.make_graph([node], "one", ins, outs)
        opsets = [helper.make_opsetid(o.domain, max(o.version, NEWER.get(node.op_type, 0))) for o in self.opsets]
        return ReferenceEvaluator(helper.make_model(graph, opset_imports=opsets), new_ops=_mended())

    def _spend(self, node: Any, given: Sequence[np.ndarray | None]) -> None:
        arrays = [v for v in given if v is not None]
        if node.op_type in GROWING:
            count = GROWING[node.op_type](*arrays)
        elif node.op_type in ELEMENTWISE:
            count = _extent(np.broadcast_shapes(*(v.shape for v in arrays)))
        else:
            count = sum(_extent(v.shape) for v in arrays)
        self.left -= count
        if self.left < 0:
            raise InputError(f"its result has {count} numbers; all together may have {self.most}")


@cache
def _mended() -> list[type]:
    """Operators with what the reference lacks: options of RNN, GRU and LSTM, and Softsign of a tensor without axes.

    Loop: its reference joins what the passes give along their first axis; ONNX has them along one of their own, and
    a condition that is left out holds.
    """
    from onnx.reference.op_run import OpRun
    from onnx.reference.ops import op_loop

    class Recurrent(OpRun):
        op_domain = ""

        def _run(self, *given: Any, **_: Any) -> tuple[np.ndarray, ...]:
            told = {f.name: getattr(self, f.name, None) for f in fields(Options)}
            found = computed(type(self).__name__, Options(**{n: v for n, v in told.items() if v}), *given)
            return tuple(found[: max(len(self.onnx_node.output), 1)])

    class Softsign(OpRun):
        op_domain = ""

        def _run(self, x: np.ndarray) -> tuple[np.ndarray]:
            return (np.asarray(x / (1 + np.abs(x))),)

    class Loop(op_loop.Loop):
        op_domain = ""

        def __init__(self, *given: Any):
            super().__init__(*given)
            inner, first = vars(self)["_run_body"], 1 + self.N

            def passed(*given: Any, **told: Any) -> list[Any]:
                found = inner(*given, **told)
                return [np.asarray(v)[None] if k >= first else v for k, v in enumerate(found)]

            vars(self)["_run_body"] = passed

        def _run(self, *given: Any, **told: Any) -> Any:  # type: ignore[override]
            limit, on, *held = given
            return super()._run(limit, np.array(True) if on is None else on, *held, **told)

    return [*(type(kind, (Recurrent,), {}) for kind in GATES), Softsign, Loop]


def _doubled(node: Any) -> Any:
    """The node with all floats of the graphs inside it as float64."""
    from onnx import NodeProto, TensorProto, numpy_helper

    made = NodeProto()
    made.CopyFrom(node)
    for found in messages(made):
        if isinstance(found, TensorProto) and found.data_type == TensorProto.FLOAT:
            found.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(found).astype(float), found.name))
        elif isinstance(found, NodeProto):
            for a in found.attribute:
                if found.op_type == "Cast" and a.name == "to" and a.i == TensorProto.FLOAT:
                    a.i = TensorProto.DOUBLE
                if found.op_type == "Constant" and a.name in ("value_float", "value_floats"):
                    value = np.array(a.f if a.name == "value_float" else list(a.floats))
                    a.Clear()
                    a.name, a.type = "value", a.TENSOR
                    a.t.CopyFrom(numpy_helper.from_array(value))
    return made


def captured(node: Any) -> list[str]:
    """What the graphs inside a node read from around it."""
    found: dict[str, None] = {}
    for a in node.attribute:
        if not a.HasField("g"):
            continue
        own = {i.name for i in (*a.g.input, *a.g.initializer)}
        for inner in a.g.node:
            found |= dict.fromkeys(n for n in (*inner.input, *captured(inner)) if n and n not in own)
            own |= set(inner.output)
        found |= dict.fromkeys(o.name for o in a.g.output if o.name not in own)
    return list(found)


# -- whether the network answers as its model ------------------------------------------------------------------------


class Tensor(NamedTuple):
    """An input or output of a model: its axes (a name where the length is free) and its ports.

    window: the axis along which it holds the last samples, if it does.
    """

    name: str
    axes: Sequence[int | str]
    ports: Sequence[Any]
    window: int | None = None

    @property
    def length(self) -> int:
        """Samples of its window; 1 without one."""
        return 1 if self.window is None else int(self.axes[self.window])

    def samples(self, rows: np.ndarray) -> np.ndarray:
        """What it is at the last of the rows (samples, numbers)."""
        shape = lengths(self.axes, {})
        if self.window is None:
            return np.resize(rows[-1], shape)
        rest = [n for k, n in enumerate(shape) if k != self.window]
        return np.moveaxis(rows[-self.length :].reshape(self.length, *rest), 0, self.window)


class Imported(NamedTuple):
    """A network beside the model that it was made of.

    constants: all values of the graph that no input changes. changing: nodes whose results an input changes.
    states: input that is a state -> (its layer, its axes, the output that it becomes).
    """

    network: Network
    inputs: Sequence[Tensor]
    outputs: Sequence[Tensor]
    states: Mapping[str, tuple[str, Sequence[int | str], str]]
    constants: Mapping[str, np.ndarray]
    changing: Sequence[Any]
    opsets: Sequence[Any]


def named(axes: Sequence[int | str]) -> list[int | str]:
    """Axes, each with a name where its length is free; what has none is called by its place."""
    return [n or f"axis {k}" for k, n in enumerate(axes)]


def lengths(axes: Sequence[int | str], free: Mapping[str, int]) -> list[int]:
    """The shape, with lengths for the free axes that are named, 1 for the others."""
    return [n if isinstance(n, int) else free.get(n, 1) for n in named(axes)]


def samples_of(axes: Sequence[int | str]) -> list[int]:
    """The axes along which an input holds samples: all but the last one whose length is free or above 1.

    Of an image, such as MATLAB's, only those of free length: all its numbers are one sample.
    """
    return [k for k, n in enumerate(axes[:-1]) if not isinstance(n, int) or (n > 1 and len(axes) < IMAGE)]


def check(made: Imported, where: str) -> None:
    """Compare the network with the model: one step, then several samples along each axis whose length is not 1.

    Along such an axis every sample must be answered by itself (a batch) or as the network goes on from step to step (a
    sequence); what mixes samples otherwise is no step of a network. Raises InputError, which says where they differ.
    """
    if any(t.window is not None for t in made.inputs):
        return _check_windows(made, where)
    every = [t.axes for t in made.inputs] + [axes for _, axes, _ in made.states.values()]
    free = dict.fromkeys(n for axes in every for n in named(axes) if isinstance(n, str))
    windows = [(t, k, n) for t in made.inputs for k in samples_of(t.axes) if isinstance(n := t.axes[k], int)]
    reference = Reference(made.opsets, CHECKED, double=True)
    advice = "a network takes one sample a step: export the model with that axis 1"
    if windows:
        tensor, axis, length = windows[0]
        place = f"{where}: input {shown(tensor.name)} holds {length} samples along its axis {axis}"
        if any(c.delay for c in made.network.flatten().connections):
            raise InputError(f"{place}, and its state would begin anew behind them; {advice}")
        if off := _differences(made, {}, reference):
            raise InputError(f"{place}, which the model mixes ({off}); {advice}")
    elif off := _difference(made, {}, reference):
        raise _unequal(where, off)
    for axis_name in free:
        off = _differences(made, {axis_name: SAMPLES}, reference)
        if off and off.startswith(UNTRIED):
            off = _differences(made, dict.fromkeys(_together(axis_name, every), SAMPLES), reference)
        if off:
            raise InputError(
                f"{where}: along {shown(axis_name)}, an axis whose length is free, the model mixes samples ({off}); "
                f"{advice}"
            )


def _together(name: str, every: Iterable[Sequence[int | str]]) -> set[str]:
    """A free axis, and those that are one batch with it: each input's first axis, which Keras names anew."""
    first = {n for axes in every if axes and isinstance(n := named(axes)[0], str)}
    return first if name in first else {name}


def _unequal(where: str, off: str) -> InputError:
    if off.startswith(UNTRIED):
        return InputError(f"{where}: nothing says whether the network made of it answers as the model ({off})")
    report = "" if off.endswith(LIMIT) else "; please report this"
    return InputError(f"{where}: the network made of it does not answer as the model ({off}){report}")


def _check_windows(made: Imported, where: str) -> None:
    """As `check`, of a network that makes a window of the last samples: over several steps, and in a batch of them."""
    reference = Reference(made.opsets, CHECKED, double=True)
    rng, last = np.random.default_rng(0), max(t.length for t in made.inputs)
    steps = last + SAMPLES - 1
    sizes = np.resize(SPREAD, steps)[:, None]
    rows = {t.name: sizes * rng.normal(size=(steps, sum(p.size for p in t.ports))) for t in made.inputs}
    got = {n: v[last - 1 :] for n, v in _stepped(made, rows, steps, True).items()}
    fed = [{t.name: t.samples(rows[t.name][: k + 1]) for t in made.inputs} for k in range(last - 1, steps)]
    for k, feeds in enumerate(fed):
        if off := _unlike(made, feeds, {n: v[k : k + 1] for n, v in got.items()}, reference):
            raise _unequal(where, off)
    for name in dict.fromkeys(n for t in made.inputs for n in named(t.axes) if isinstance(n, str)):
        batch = _together(name, [t.axes for t in made.inputs])
        along = {t.name: k for t in made.inputs for k, n in enumerate(named(t.axes)) if n in batch}
        feeds = {n: np.concatenate([f[n] for f in fed], along[n]) if n in along else v for n, v in fed[-1].items()}
        if off := _unlike(made, feeds, got, reference):
            raise InputError(
                f"{where}: along {shown(name)}, an axis whose length is free, the model mixes samples ({off}); "
                "export the model with that axis 1"
            )


def _unlike(
    made: Imported, feeds: Mapping[str, np.ndarray], got: Mapping[str, np.ndarray], reference: Reference
) -> str | None:
    """What differs from the model's answer, in words. got: output -> a row for each sample."""
    try:
        wanted = answer(made, feeds, reference)
    except Exception as error:  # of shapes that do not fit, in many ways
        return f"{UNTRIED} it: {one_line(' '.join(str(error).split()))[:100]}"
    return next(filter(None, (_off(n, value, wanted[n], False) for n, value in got.items())), None)


def _differences(made: Imported, free: Mapping[str, int], reference: Reference) -> str | None:
    """As `_difference`; the samples grow, then shrink: the last one is neither always the largest nor the least.

    Drawn several times: of an index, a draw may agree by chance.
    """
    tried = ((spread, seed) for seed in range(DRAWS) for spread in (SPREAD, SPREAD[::-1]))
    found = (_difference(made, free, reference, spread, seed) for spread, seed in tried)
    return next(filter(None, found), None)


def _difference(
    made: Imported, free: Mapping[str, int], reference: Reference, spread: Sequence[float] = SPREAD, seed: int = 0
) -> str | None:
    """What differs, in words; None if nothing does. free: lengths of axes that are free, 1 if not named.

    spread: of the numbers of each sample.
    """
    rng = np.random.default_rng(seed)
    axes = {t.name: t.axes for t in made.inputs} | {n: a for n, (_, a, _) in made.states.items()}
    shapes = {n: lengths(a, free) for n, a in axes.items()}
    if (total := sum(prod(s) for s in shapes.values())) > CHECKED:
        return f"it takes {total} numbers; at most {CHECKED} are tried"
    feeds, rows = {}, {}
    for n, shape in shapes.items():
        along = [k for k, name in enumerate(named(axes[n])) if name in free]
        if n not in made.states:
            along = sorted({*along, *(k for k in samples_of(axes[n]) if shape[k] > 1)})
        count = prod(shape[k] for k in along)
        rows[n] = rng.normal(size=(count, prod(shape) // count)) * np.resize(spread, count)[:, None]
        rest = [length for k, length in enumerate(shape) if k not in along]
        feeds[n] = np.moveaxis(rows[n].reshape([*(shape[k] for k in along), *rest]), range(len(along)), along)
    count = max(len(r) for r in rows.values())
    if count > ROWS:
        return f"it holds {count}; at most {ROWS} are tried"
    if any(len(r) not in (1, count) for r in rows.values()):
        return "its inputs hold different numbers of samples"
    try:
        wanted = answer(made, feeds, reference)
    except Exception as error:  # of shapes that do not fit, in many ways
        return f"{UNTRIED} {count} of them: {one_line(' '.join(str(error).split()))[:100]}"
    worst: str | None = None
    for on in (False, True):
        if on and any(len(rows[n]) > 1 for n in made.states):
            break
        got = _stepped(made, {n: np.resize(r, (count, r.shape[1])) for n, r in rows.items()}, count, on)
        found = (_off(n, value, wanted[n], on) for n, value in got.items())
        if (worst := next(filter(None, found), None)) is None:
            return None
    return worst


def answer(
    made: Imported, feeds: Mapping[str, np.ndarray], reference: Reference, rounds: bool = False
) -> dict[str, np.ndarray]:
    """What the model gives, all floats as float64, so that their rounding is no difference.

    rounds: a node that quantizes rounds; else it only limits.
    """
    values = {n: _wide(v) for n, v in made.constants.items()} | dict(feeds)
    types = {n: v for n, v in made.constants.items() if v.dtype.kind in "iu"}  # of zero points
    for node in made.changing:
        if node.domain in QONNX or node.op_type in LINEAR:
            values[node.output[0]] = quantized(node, values | types, rounds)
        elif node.op_type == "Cast" and values[node.input[0]].dtype.kind == "f":
            truth = any(a.name == "to" and a.i == BOOL for a in node.attribute)
            values[node.output[0]] = values[node.input[0]] != 0 if truth else values[node.input[0]]
        else:
            values |= {n: _wide(v) for n, v in reference.run(node, values).items()}
    return values


def _wide(value: np.ndarray) -> np.ndarray:
    return value.astype(float) if value.dtype.kind == "f" else value


def _stepped(made: Imported, rows: Mapping[str, np.ndarray], count: int, on: bool) -> dict[str, np.ndarray]:
    """Output of the model -> what the network answers, a row for each sample. on: from step to step, else each anew."""
    runs = [range(count)] if on else [range(k, k + 1) for k in range(count)] if made.states else [range(count)]
    parts: dict[str, list[np.ndarray]] = {}
    for run in runs:
        each = not on and len(run) > 1
        columns = {}
        for tensor in made.inputs:
            at = 0
            for p in tensor.ports:
                column = rows[tensor.name][list(run), at : at + p.size]
                column = column[:, None] if each else column
                columns[p.name], at = column[..., 0] if p.size == 1 else column, at + p.size
        start = {layer: rows[n][run[0]] for n, (layer, _, _) in made.states.items()}
        with np.errstate(all="ignore"):
            found = made.network.run(columns, initial=start, trace=True)
        for tensor in made.outputs:
            signals = [found[p.name].reshape(len(run), p.size) for p in tensor.ports]
            parts.setdefault(tensor.name, []).append(np.concatenate(signals, 1))
        given = {t.name for t in made.outputs}
        for layer, _, after in made.states.values():
            if after not in given:
                parts.setdefault(after, []).append(found[layer].reshape(len(run), -1))
    return {n: np.concatenate(p) for n, p in parts.items()}


def _off(name: str, got: np.ndarray, wanted: np.ndarray, on: bool) -> str | None:
    """How an output differs. got: a row for each sample. on: it may also be that of the last sample alone."""
    count, size = got.shape
    if on and wanted.size == size:
        got = got[-1:]
    if wanted.size != got.size:
        return f"output {shown(name)} has the shape {list(wanted.shape)} for {count} samples"
    if not np.isfinite(wanted).all():
        return f"output {shown(name)} is no number: {LIMIT}"
    with np.errstate(invalid="ignore"):
        worst = min(_least(np.abs(w - got).max()) for w in arranged(wanted, *got.shape))
    if worst <= AGREED * np.abs(wanted).max() + LEAST:
        return None
    return f"output {shown(name)} by {worst:.2g}"


def arranged(wanted: np.ndarray, count: int, size: int) -> Iterator[np.ndarray]:
    """What an output may mean: a row for each sample (count, size), along any axis of that length, or in order."""
    yield from (np.moveaxis(wanted, k, 0).reshape(count, size) for k, n in enumerate(wanted.shape) if n == count)
    yield wanted.reshape(count, size)


def _least(worst: np.floating) -> float:
    return float("inf") if np.isnan(worst) else float(worst)
