"""Small ONNX models, each of an operator with a choice of its options, and whether the importer answers as they do."""

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper

from greygate.errors import InputError
from greygate.models.importers.onnx_graph import imported

OPSETS = range(17, onnx.defs.onnx_opset_version() + 1)
AGREED = 1e-6  # of the largest answer, or of 1
STEPS = 6
IMAGE = 4  # axes: all numbers are one sample
ML = "ai.onnx.ml"
RNG = np.random.default_rng(0)


class Case(NamedTuple):
    """state: input that is a state -> the output that it becomes."""

    name: str
    model: Any
    state: Mapping[str, str] = {}


def built(
    nodes: Sequence[Any],
    inputs: Mapping[str, Sequence],
    outputs: Sequence[str],
    constants: Mapping[str, Any] | None = None,
    opset: int = 18,
    kind: int = TensorProto.FLOAT,
    functions: Sequence[Any] = (),
    domains: Sequence[str] = (),
) -> Any:
    """A model; the shapes of its outputs are inferred."""
    fixed = [numpy_helper.from_array(np.asarray(v), k) for k, v in (constants or {}).items()]
    ins = [helper.make_tensor_value_info(n, kind, s) for n, s in inputs.items()]
    outs = [helper.make_tensor_value_info(n, kind, None) for n in outputs]
    opsets = [helper.make_opsetid("", opset), *(helper.make_opsetid(d, 3 if d == ML else 1) for d in domains)]
    graph = helper.make_graph(list(nodes), "g", ins, outs, fixed)
    made = helper.make_model(graph, opset_imports=opsets, ir_version=10, functions=list(functions))
    if not functions:  # whose shapes would be inferred call by call
        with suppress(Exception):
            made = onnx.shape_inference.infer_shapes(made)
    for tensor in made.graph.output:
        tensor.type.tensor_type.shape.dim.extend([])
        tensor.type.tensor_type.shape.SetInParent()
    return made


def one(
    op: str, shape: Sequence, *constants: Any, opset: int, outputs: int = 1, domain: str = "", **options: Any
) -> Any:
    """A model of one node, x first; a constant that is "x" is the input again, "" an input left out."""
    names = ["x", *("x" if v is X else "" if v is None else f"c{k}" for k, v in enumerate(constants))]
    fixed = {f"c{k}": v for k, v in enumerate(constants) if v is not None and v is not X}
    ends = [f"y{k}" for k in range(outputs)]
    node = helper.make_node(op, names, ends, domain=domain, **options)
    return built([node], {"x": shape}, ends, fixed, opset, domains=[domain] if domain else [])


X = object()
SHAPES = {
    "scalar": [], "3": [3], "1x3": [1, 3], "Nx3": ["N", 3], "1x1x3": [1, 1, 3], "NxTx3": ["N", "T", 3],
    "2x3": [2, 3], "1x5x3": [1, 5, 3], "1x2x3": [1, 2, 3], "1x1x1x3": [1, 1, 1, 3],
}  # fmt: skip


def f(*shape: int) -> np.ndarray:
    return RNG.normal(size=shape).astype(np.float32)


def i(*values: int) -> np.ndarray:
    return np.array(values, np.int64)


def cases(opset: int) -> Iterator[Case]:
    """Every choice of options, for one opset."""
    for name, op, shape, constants, options in (*_elementwise(), *_movements(opset), *_sums(opset)):
        outputs = options.pop("outputs", 1)
        yield Case(f"{op} {name}", one(op, shape, *constants, opset=opset, outputs=outputs, **options))
    yield from _swapped(opset)
    yield from _recurrent(opset)
    yield from _scans(opset)
    yield from _constants(opset)
    yield from _composed(opset)


def _elementwise() -> Iterator[tuple]:
    unary = {
        "Tanh": [{}], "Sigmoid": [{}], "Softsign": [{}], "Relu": [{}], "Abs": [{}], "Neg": [{}], "Identity": [{}],
        "LeakyRelu": [{}, {"alpha": 0.0}, {"alpha": 0.2}, {"alpha": -0.5}, {"alpha": 1.5}, {"alpha": 1.0}],
        "HardSigmoid": [{}, {"alpha": 0.5}, {"beta": 0.1}, {"alpha": -0.3, "beta": 0.7}, {"alpha": 0.0}],
        "Dropout": [{}, {"seed": 3}],
        "Elu": [{}], "Exp": [{}], "Sin": [{}], "Softmax": [{}], "HardSwish": [{}], "Sign": [{}], "Floor": [{}],
        "Sqrt": [{}], "Selu": [{}], "Softplus": [{}], "Erf": [{}], "Round": [{}], "Reciprocal": [{}], "Mish": [{}],
        "Celu": [{}], "ThresholdedRelu": [{}], "Gelu": [{}], "Swish": [{}], "Shrink": [{}], "Not": [{}], "IsNaN": [{}],
    }  # fmt: skip
    for op, choices in unary.items():
        for k, options in enumerate(choices):
            for name, shape in SHAPES.items():
                if k == 0 or name in ("3", "NxTx3"):
                    yield f"{options} {name}", op, shape, (), options
    for kind in ("FLOAT", "DOUBLE", "FLOAT16", "INT32", "INT64", "BOOL", "BFLOAT16", "UINT8"):
        yield kind, "Cast", [1, 3], (), {"to": getattr(TensorProto, kind)}
    for training in (False, True):
        yield f"training {training}", "Dropout", [1, 3], (np.float32(0.5), np.array(training)), {}
    for op in ("Add", "Sub", "Mul", "Div", "Max", "Min", "Mean", "Sum", "PRelu", "Mod"):
        options = {"fmod": 1} if op == "Mod" else {}
        for name, shape in SHAPES.items():
            yield f"two signals {name}", op, shape, (X,), options
            for of in ((), (3,), (1, 3), (2, 3), (1, 1, 3), (2, 1), (1, 5, 1)):
                yield f"{name} with {of}", op, shape, (f(*of),), options
    yield "one", "Sum", [3], (), {}
    yield "four", "Sum", [1, 3], (f(3), X, f(1)), {}
    yield "by zero", "Div", [3], (np.array([1.0, 0.0, 2.0], np.float32),), {}
    for exponent in (0.0, 1.0, 2.0, 3.0, 0.5, -1.0, 4.0, [2.0, 3.0, 2.0], [2.0, 2.0, 2.0], [[2.0], [2.0]]):
        yield f"{exponent}", "Pow", [3], (np.array(exponent, np.float32),), {}
        yield f"of a batch, {exponent}", "Pow", ["N", 3], (np.array(exponent, np.float32),), {}
        yield f"int {exponent}", "Pow", [1, 3], (np.array(exponent, np.int64),), {}
    yield "of two signals", "Pow", [3], (X,), {}
    limits = [None, *map(np.float32, (-0.5, 0.7, -1e30, 1e30, -np.inf, np.inf, 1e38, -3e38, 1000.0))]
    for low in limits:
        for high in limits:
            yield f"{low} to {high}", "Clip", ["N", 3], (low, high), {}
    yield "of one each", "Clip", [3], (np.full(1, -0.5, np.float32),), {}
    for offset in ([0.5], [0.5, -1.0, 2.0], [0.5, 1.0]):
        for scale in ([2.0], [2.0, -0.5, 3.0]):
            options = {"offset": offset, "scale": scale, "domain": ML}
            yield f"{offset} {scale}", "Scaler", [1, 3], (), options
            yield f"{offset} {scale} N", "Scaler", ["N", 3], (), dict(options)
    yield "of another domain", "Tanh", [3], (), {"domain": "strange"}
    yield "without a domain", "Scaler", [1, 3], (), {}


def _movements(opset: int) -> Iterator[tuple]:
    for axis in (0, 1, 2, -1, -2, -3):
        for name in ("1x3", "1x1x3", "NxTx3", "1x2x3"):
            yield f"{axis} {name}", "Concat", SHAPES[name], (X,), {"axis": axis}
            yield (
                f"{axis} {name} constant",
                "Concat",
                SHAPES[name],
                (f(1, 2, 3)[:1, : SHAPES[name][1] if name == "1x2x3" else 1],),
                {"axis": axis},
            )
            yield f"{axis} {name}", "Flatten", SHAPES[name], (), {"axis": axis}
            yield f"{axis} {name}", "Squeeze", SHAPES[name], (i(axis),), {}
            yield f"{axis} {name}", "Unsqueeze", SHAPES[name], (i(axis),), {}
            for at in (i(0), np.array(0), i(-1), i(2, 0), np.array([[0, 2], [1, 1]])):
                yield f"{at.tolist()} {axis} {name}", "Gather", SHAPES[name], (at,), {"axis": axis}
            yield f"by outputs {axis} {name}", "Split", SHAPES[name], (), {"axis": axis, "outputs": 3} | (
                {"num_outputs": 3} if opset > 17 else {})  # fmt: skip
            yield f"two of {axis} {name}", "Split", SHAPES[name], (), {"axis": axis, "outputs": 2} | (
                {"num_outputs": 2} if opset > 17 else {})  # fmt: skip
            yield f"sizes {axis} {name}", "Split", SHAPES[name], (i(1, 2),), {"axis": axis, "outputs": 2}
    yield "all", "Squeeze", [1, 1, 3], (), {}
    yield "free", "Squeeze", ["N", 1, 3], (), {}
    yield "two", "Unsqueeze", [3], (i(0, -1),), {}
    for starts, ends, axes, steps in (
        ([0], [2], None, None), ([1], [3], [1], None), ([0], [2**62], [-1], [2]), ([-1], [-(2**62)], [-1], [-1]),
        ([2], [0], [1], [-1]), ([-1], [-4], [1], [-2]), ([0, 1], [1, 3], None, None), ([1], [1], [1], None),
        ([0], [1], [0], None), ([-1], [2**62], [0], None), ([5], [9], [1], None),
    ):  # fmt: skip
        for name in ("1x3", "Nx3", "2x3"):
            given = [i(*v) if v is not None else None for v in (starts, ends, axes, steps)]
            yield f"{starts} {ends} {axes} {steps} {name}", "Slice", SHAPES[name], (*given,), {}
    for name in ("3", "1x3", "Nx3", "2x3", "NxTx3", "1x2x3"):
        for to in ((3,), (-1,), (1, 3), (-1, 3), (0, -1), (3, 1), (1, 1, 3), (-1, 1, 3), (0, 0), (6,), (2, -1), (0, 3)):
            yield f"{to} {name}", "Reshape", SHAPES[name], (i(*to),), {}
        yield f"allowzero {name}", "Reshape", SHAPES[name], (i(0, 3),), {"allowzero": 1}
        for to in ((3,), (1, 3), (2, 3), (1, 1, 3), (4, 1, 3), (2, 2, 3)):
            yield f"{to} {name}", "Expand", SHAPES[name], (i(*to),), {}
        for repeats in ((2,), (1, 2), (2, 1)):
            yield f"{repeats} {name}", "Tile", SHAPES[name], (i(*repeats),), {}
    for perm in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (2, 1, 0), (1, 2, 0), None):
        for name in ("1x1x3", "NxTx3", "1x2x3"):
            yield f"{perm} {name}", "Transpose", SHAPES[name], (), {} if perm is None else {"perm": perm}


def _sums(opset: int) -> Iterator[tuple]:
    for op in ("ReduceSum", "ReduceMean", "ReduceMax", "ReduceL1", "ReduceSumSquare"):
        for axes in (None, [], [0], [1], [-1], [0, 1], [1, -1]):
            for keep in (None, 0, 1):
                for noop in (None, 0, 1):
                    for name in ("1x3", "NxTx3", "1x5x3"):
                        options = {
                            k: v for k, v in (("keepdims", keep), ("noop_with_empty_axes", noop)) if v is not None
                        }
                        if op != "ReduceSum" and opset < 18:
                            if noop is not None:
                                continue
                            options |= {"axes": axes} if axes else {}
                            yield f"{axes} {keep} {name}", op, SHAPES[name], (), options
                        else:
                            given = () if axes is None else (i(*axes),)
                            yield f"{axes} {keep} {noop} {name}", op, SHAPES[name], given, options
    for shape in ([1, 3], ["N", 3], [1, 3, 2], [1, 3, 1, 2], ["N", 3, 2], [2, 3], [1, 2, 3]):
        statistics = f(3), f(3), f(3), np.abs(f(3))
        for options in ({}, {"epsilon": 0.1}, {"momentum": 0.5}, {"training_mode": 1}, {"training_mode": 0}):
            yield f"{shape} {options}", "BatchNormalization", shape, statistics, options
    for shape in ([1, 3], ["N", 3], [2, 3], [3, 1]):
        for b in (0, 1):
            for c in (None, (), (1,), (4,), (1, 4), (2, 4), (2, 1)):
                for options in ({}, {"alpha": 0.5}, {"beta": -0.3}, {"transA": 1}, {"alpha": 2.0, "beta": 0.0}):
                    weights = f(4, 3) if b else f(3, 4)
                    given = (weights,) if c is None else (weights, f(*c))
                    yield f"{shape} C {c} {options}", "Gemm", shape, given, {"transB": b, **options}
    for name, shape in SHAPES.items():
        for of in ((3,), (3, 4), (1, 3, 4), (2, 3, 4)):
            yield f"{name} with {of}", "MatMul", shape, (f(*of),), {}
    yield "of two signals", "MatMul", [3], (X,), {}
    for shape in ([1, 3, 1], [1, 2, 4]):
        for options in ({"kernel_shape": [1]}, {"kernel_shape": [3], "pads": [1, 1]}):
            yield f"{shape}", "Conv", shape, (f(2, shape[1], options["kernel_shape"][0]),), options


def _swapped(opset: int) -> Iterator[Case]:
    """The constant comes first."""
    for op in ("Add", "Sub", "Mul", "Div", "Pow", "MatMul", "Gemm"):
        for name, shape in (("3", [3]), ("3x1", [3, 1]), ("1x3", [1, 3]), ("Nx3", ["N", 3]), ("1x3x1", [1, 3, 1])):
            node = helper.make_node(op, ["c", "x"], ["y"])
            yield Case(f"{op} constant first {name}", built([node], {"x": shape}, ["y"], {"c": f(4, 3)}, opset))
            yield Case(f"{op} vector first {name}", built([node], {"x": shape}, ["y"], {"c": f(3)}, opset))
    for op in ("Add", "Mul", "Sub", "Div", "MatMul", "Concat", "Max", "Sum"):
        for a, b in (
            ([1, 3], [1, 3]),
            ([3], [3]),
            (["N", 3], ["N", 3]),
            (["N", 3], [3]),
            ([1, 3], [3, 1]),
            ([2, 3], [1, 3]),
        ):
            node = helper.make_node(op, ["x", "z"], ["y"], **({"axis": -1} if op == "Concat" else {}))
            yield Case(f"{op} of {a} and {b}", built([node], {"x": a, "z": b}, ["y"], {}, opset))


USUAL = {"RNN": ["Tanh"], "GRU": ["Sigmoid", "Tanh"], "LSTM": ["Sigmoid", "Tanh", "Tanh"]}
GATES = {"RNN": 1, "GRU": 3, "LSTM": 4}


def recurrent(op: str, opset: int, shape: Sequence, left_out: str = "", more: Mapping | None = None, ends: int = 1,
              state: bool = False, n: int = 4, **options: Any) -> Case:  # fmt: skip
    """One recurrent operator. left_out: inputs that are not given, of B and the states."""
    g, held = GATES[op], ["initial_h", "initial_c"][: 2 if op == "LSTM" else 1]
    directions = 2 if options.get("direction") == "bidirectional" else 1
    given = {"W": f(directions, g * n, 3), "R": f(directions, g * n, n) / 2, "B": f(directions, 2 * g * n)}
    samples = shape[0 if options.get("layout") else 1]
    batch = samples if isinstance(samples, int) else 1
    if not state:
        given |= {h: f(directions, batch, n) / 3 for h in held}
    given = {k: v for k, v in given.items() if k not in left_out.split()} | dict(more or {})
    order = ["W", "R", "B", "sequence_lens", *held, *(["P"] if op == "LSTM" else [])]
    names = ["x", *(k if k in given or (state and k in held) else "" for k in order)]
    while names[-1] == "":
        names.pop()
    all_ends = ["Y", "Y_h", "Y_c"][: 3 if op == "LSTM" else 2]
    outs = [*all_ends] if state else [e if k < ends else "" for k, e in enumerate(all_ends)]
    node = helper.make_node(op, names, outs, hidden_size=n, **options)
    inputs = {"x": shape} | ({h: [1, batch, n] for h in held} if state else {})
    made = built([node], inputs, [o for o in outs if o], given, opset)
    told = (
        f"{op} {list(shape)} without {left_out!r} with {list(more or {})} {ends} {options} {'state' if state else ''}"
    )
    return Case(told, made, dict(zip(held, all_ends[1:], strict=True)) if state else {})


def _recurrent(opset: int) -> Iterator[Case]:
    for op, usual in USUAL.items():
        for shape in ([1, 1, 3], ["T", 1, 3], ["T", "N", 3], [5, 1, 3], [1, 2, 3]):
            for left_out in ("", "B", "initial_h initial_c", "B initial_h initial_c", "initial_h"):
                yield recurrent(op, opset, shape, left_out)
            yield recurrent(op, opset, shape, ends=len(usual) + 1)
        yield recurrent(op, opset, [1, 1, 3], state=True)
        yield recurrent(op, opset, [1, 1, 3], "B", state=True)
        base = (op, opset, ["T", 1, 3])
        for direction in ("forward", "reverse", "bidirectional"):
            yield recurrent(*base, "initial_h initial_c", direction=direction)
        rest, count = usual[1:], len(usual)
        for names in (
            usual, [u.lower() for u in usual], ["Relu", *rest], [*usual[:-1], "Affine"], ["HardSigmoid", *rest],
            ["Sigmoid"] * count, ["Softsign"] * count, ["Elu", *rest],
        ):  # fmt: skip
            yield recurrent(*base, activations=names)
        yield recurrent(*base, activations=["HardSigmoid", *usual[1:]], activation_alpha=[0.3], activation_beta=[0.4])
        yield recurrent(*base, activation_alpha=[0.3] * len(usual), activation_beta=[0.4] * len(usual))
        yield recurrent(*base, clip=0.2)
        yield recurrent(*base, clip=100.0)
        yield recurrent(*base, layout=1)
        yield recurrent(*base, layout=0)
        yield recurrent(*base, more={"sequence_lens": np.array([1], np.int32)})
        yield recurrent(op, opset, [1, 1, 3], more={"sequence_lens": np.array([1], np.int32)})
        yield recurrent(op, opset, [8, 1, 3], more={"sequence_lens": np.array([5], np.int32)})
        if op == "GRU":
            for late in (0, 1):
                for left_out in ("", "B", "initial_h"):
                    yield recurrent(*base, left_out, linear_before_reset=late)
                yield recurrent(op, opset, [1, 1, 3], state=True, linear_before_reset=late)
        if op == "LSTM":
            yield recurrent(*base, more={"P": f(1, 12)})
            yield recurrent(*base, more={"P": np.zeros((1, 12), np.float32)})
            yield recurrent(*base, input_forget=1)
            yield recurrent(*base, input_forget=0)


def _scans(opset: int) -> Iterator[Case]:
    def tensor(name: str, shape: Sequence) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

    a, b = f(3, 3) / 2, f(3)
    for shape in (["T", 3], [1, 3], [5, 3]):
        for options in (
            {}, {"scan_input_directions": [1]}, {"scan_output_directions": [1]}, {"scan_input_directions": [0]},
            {"scan_input_axes": [1]}, {"scan_output_axes": [1]}, {"scan_output_axes": [-1]},
        ):  # fmt: skip
            for outer in (False, True):
                body = helper.make_graph(
                    [
                        helper.make_node("MatMul", ["s", "A"], ["sA"]),
                        helper.make_node("Add", ["sA", "xi"], ["n"]),
                        helper.make_node("Tanh", ["n"], ["t"]),
                        helper.make_node("Add", ["t", "b"], ["y"]),
                        helper.make_node("Identity", ["t"], ["next"]),
                    ],
                    "body",
                    [tensor("s", [3]), tensor("xi", [3])],
                    [tensor("next", [3]), tensor("y", [3])],
                    [] if outer else [numpy_helper.from_array(v, k) for k, v in (("A", a), ("b", b))],
                )
                scan = helper.make_node("Scan", ["start", "x"], ["end", "ys"], num_scan_inputs=1, body=body, **options)
                fixed = {"start": f(3) / 3} | ({"A": a, "b": b} if outer else {})
                for ends in (["ys"], ["end"]):
                    yield Case(
                        f"Scan {shape} {options} {outer} {ends}", built([scan], {"x": shape}, ends, fixed, opset)
                    )


def _constants(opset: int) -> Iterator[Case]:
    """What is computed of constants alone: y = x + the result."""

    def plus(name: str, nodes: Sequence[Any], fixed: Mapping[str, Any], result: str = "r", **more: Any) -> Case:
        cast = helper.make_node("Cast", [result], ["f"], to=TensorProto.FLOAT)
        add = helper.make_node("Add", ["x", "f"], ["y"])
        return Case(f"of constants: {name}", built([*nodes, cast, add], {"x": [1, 3]}, ["y"], fixed, opset, **more))

    a, b = np.array([7, -7, 5]), np.array([2, 2, -3])
    for dtype in (np.int32, np.int64, np.float32, np.float64):
        for op in ("Add", "Sub", "Mul", "Div", "Mod", "Max", "Min", "Equal", "Less", "Greater", "Pow", "Sum", "Mean"):
            options = {"fmod": 1} if op == "Mod" and dtype in (np.float32, np.float64) else {}
            fixed = {"a": a.astype(dtype), "b": np.abs(b).astype(dtype) if op == "Pow" else b.astype(dtype)}
            yield plus(f"{op} {dtype.__name__}", [helper.make_node(op, ["a", "b"], ["r"], **options)], fixed)
        for op in (
            "Neg", "Abs", "Sign", "Relu", "Identity", "Floor", "Ceil", "Round", "Sqrt", "Exp", "Erf", "Softplus",
            "Tanh", "Sigmoid", "Softmax", "IsNaN", "CumSum", "ReduceMax", "ReduceProd", "ArgMax", "NonZero", "Softsign",
        ):  # fmt: skip
            fixed = {"a": (a / 2).astype(dtype) if dtype in (np.float32, np.float64) else a.astype(dtype)}
            names = ["a", "axis"] if op == "CumSum" else ["a"]
            fixed |= {"axis": np.array(0)} if op == "CumSum" else {}
            yield plus(f"{op} {dtype.__name__}", [helper.make_node(op, names, ["r"])], fixed)
        for to in ("FLOAT", "DOUBLE", "INT32", "INT64", "BOOL", "FLOAT16", "INT8", "UINT8", "BFLOAT16"):
            node = helper.make_node("Cast", ["a"], ["r"], to=getattr(TensorProto, to))
            yield plus(f"Cast {dtype.__name__} to {to}", [node], {"a": np.array([1.5, 2.5, 0.0]).astype(dtype)})
    yield plus(
        "Where",
        [helper.make_node("Where", ["c", "a", "b"], ["r"])],
        {"c": np.array([True, False, True]), "a": a, "b": b},
    )
    yield plus("Not", [helper.make_node("Not", ["c"], ["r"])], {"c": np.array([True, False, True])})
    yield plus(
        "Range",
        [helper.make_node("Range", ["p", "q", "s"], ["r"])],
        {"p": np.array(1), "q": np.array(7), "s": np.array(2)},
    )
    yield plus("ConstantOfShape", [helper.make_node("ConstantOfShape", ["n"], ["r"])], {"n": i(3)})
    filled = helper.make_node("ConstantOfShape", ["n"], ["r"], value=numpy_helper.from_array(i(7)))
    yield plus("ConstantOfShape of 7", [filled], {"n": i(1, 3)})
    yield plus(
        "OneHot", [helper.make_node("OneHot", ["p", "n", "v"], ["r"])], {"p": np.array(1), "n": np.array(3), "v": f(2)}
    )
    for kind, value in (
        ("value_float", 1.5), ("value_floats", [1.5, 2.0, 3.0]), ("value_int", 7), ("value_ints", [1, 2, 3]),
        ("value", numpy_helper.from_array(f(3))), ("value", numpy_helper.from_array(i(1, 2, 3))),
        ("value_string", "a"), ("value_strings", ["a", "b"]),
    ):  # fmt: skip
        yield plus(f"Constant {kind}", [helper.make_node("Constant", [], ["r"], **{kind: value})], {})
    for op, options in (("RandomNormal", {"shape": [3]}), ("RandomUniform", {"shape": [3]}), ("RandomNormalLike", {}),
                        ("RandomUniformLike", {}), ("Bernoulli", {}), ("Multinomial", {})):  # fmt: skip
        node = helper.make_node(op, [] if "shape" in options else ["a"], ["r"], **options)
        yield plus(op, [node], {"a": np.full((1, 3) if op == "Multinomial" else 3, 0.5, np.float32)})
    halves = [helper.make_node("Shape", ["x"], ["n"], start=1), helper.make_node("Div", ["n", "two"], ["r"])]
    yield plus("half of a shape", halves, {"two": i(2)})
    yield plus("Size", [helper.make_node("Size", ["x"], ["r"])], {})
    for op in ("If", "Loop"):
        inner = helper.make_graph(
            [helper.make_node("Identity", ["a"], ["o"])]
            + ([helper.make_node("Identity", ["k"], ["go"])] if op == "Loop" else []),
            "inner",
            [] if op == "If" else [helper.make_tensor_value_info(n, t, []) for n, t in (("j", 7), ("k", 9))],
            [
                *([helper.make_tensor_value_info("go", 9, [])] if op == "Loop" else []),
                helper.make_tensor_value_info("o", 1, [3]),
            ],
        )
        branches = {"then_branch": inner, "else_branch": inner} if op == "If" else {"body": inner}
        names = ["t"] if op == "If" else ["m", "t"]
        fixed = {"t": np.array(True), "m": np.array(3), "a": f(3)}
        yield plus(op, [helper.make_node(op, names, ["r"], **branches)], fixed)


def _composed(opset: int) -> Iterator[Case]:
    """Functions of the model, and what mixes samples."""
    double = helper.make_function(
        "my", "Tanh", ["x"], ["y"],
        [helper.make_node("Add", ["x", "x"], ["y"])], [helper.make_opsetid("", opset)],
    )  # fmt: skip
    scaled = helper.make_function(
        "my", "Scaled", ["x"], ["y"],
        [helper.make_node("Tanh", ["x"], ["t"], domain="my"), helper.make_node("LeakyRelu", ["t"], ["y"])],
        [helper.make_opsetid("", opset), helper.make_opsetid("my", 1)], ["alpha"],
    )  # fmt: skip
    alpha = scaled.node[1].attribute.add()
    alpha.name, alpha.ref_attr_name, alpha.type = "alpha", "alpha", onnx.AttributeProto.FLOAT
    for name, options in (("Tanh", {}), ("Scaled", {"alpha": 0.3})):
        node = helper.make_node(name, ["x"], ["y"], domain="my", **options)
        made = built([node], {"x": [3]}, ["y"], {}, opset, functions=[double, scaled], domains=["my"])
        made.graph.output[0].CopyFrom(helper.make_tensor_value_info("y", TensorProto.FLOAT, [3]))
        yield Case(f"a function {name}", made)
    for name, shape in SHAPES.items():
        if len(shape) > 1:
            mean = helper.make_node(
                "ReduceMean", ["x", *(["a"] if opset > 17 else [])], ["m"], **({} if opset > 17 else {"axes": [-2]})
            )
            less = helper.make_node("Sub", ["x", "m"], ["y"])
            yield Case(
                f"less its mean {name}",
                built([mean, less], {"x": shape}, ["y"], {"a": i(-2)} if opset > 17 else {}, opset),
            )
            weighted = [
                helper.make_node("Mul", ["x", "w"], ["m"]),
                helper.make_node("ReduceSum", ["m", "a"], ["y"], keepdims=0),
            ]
            yield Case(f"weighted sum {name}", built(weighted, {"x": shape}, ["y"], {"w": f(5, 1), "a": i(-2)}, opset))


# -- the judge -------------------------------------------------------------------------------------------------------


def node_cases() -> Iterator[Case]:
    """The node tests of the onnx package. One of an opset before 17 is taken as 17, if its operator has not changed."""
    from onnx.backend.test.case.node import collect_testcases

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = collect_testcases(None)
    for test in found:
        model = test.model
        opset = next((o for o in model.opset_import if o.domain == ""), None)
        kinds = {n.op_type for n in model.graph.node if n.domain == ""}
        if opset is not None and opset.version < OPSETS[0]:
            with suppress(onnx.defs.SchemaError):
                since = [[onnx.defs.get_schema(k, v).since_version for k in kinds] for v in (opset.version, OPSETS[0])]
                opset.version = OPSETS[0] if since[0] == since[1] else opset.version
        yield Case(test.name, model)


def judged(case: Case, path: Path) -> tuple[str, str]:
    """("right", "refused", "wrong", "traceback" or "no model", what is said or by how much it differs)."""
    path.write_bytes(case.model.SerializeToString())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            made = imported(path, state=case.state or None, name="case")
    except InputError as error:
        return "refused", str(error).removeprefix(f"{path}: ")
    except Exception as error:
        return "traceback", f"{type(error).__name__}: {error}"
    try:
        windows = {t.name: t for t in made.inputs if t.window is not None}
        worst = streamed(case, made, path) if windows else difference(case, made.network, path)
    except _Invalid as error:
        return "no model", str(error)
    return ("right" if worst <= AGREED else "wrong"), f"{worst:.2g}"


class _Invalid(Exception):
    """Neither onnxruntime nor the reference runs it."""


def difference(case: Case, network: Any, path: Path) -> float:
    """The largest difference, of the largest answer or of 1. Samples of a free or a long axis are steps."""
    rng, run = np.random.default_rng(1), runner(case.model, path)
    inputs = {
        t.name: [d.dim_value or d.dim_param for d in t.type.tensor_type.shape.dim] for t in case.model.graph.input
    }
    free = {d for s in inputs.values() for d in s if isinstance(d, str)}
    worst = 0.0
    if case.state:  # step by step, by hand
        held = {h: np.zeros(inputs[h], np.float32) for h in case.state}
        x = rng.normal(size=(STEPS, *inputs["x"])).astype(np.float32)
        got = network.run({p.name: x.reshape(STEPS, -1)[:, k] for k, p in enumerate(network.inputs)})
        for k in range(STEPS):
            out = run({"x": x[k], **held})
            held = {h: out[after] for h, after in case.state.items()}
            kept = np.concatenate([np.ravel(v) for n, v in out.items() if n not in case.state.values()])
            worst = max(worst, apart(np.array([got[p.name][k] for p in network.outputs]), kept))
        return worst
    for axis in sorted(free) or [""]:
        shapes = {n: [STEPS if d == axis else d if isinstance(d, int) else 1 for d in s] for n, s in inputs.items()}
        feeds = {n: rng.normal(size=s).astype(np.float32) for n, s in shapes.items()}
        try:
            out = run(feeds)
        except Exception as error:
            if axis:
                continue  # the model itself runs with one sample alone
            raise _Invalid(str(error)) from None
        numbers = {n: v for n, v in out.items() if v.dtype.kind in "bf"} or out  # beside such, others are left out
        rows = {}
        for n, s in shapes.items():
            at = inputs[n].index(axis) if axis in inputs[n] else None
            rows[n] = (
                np.moveaxis(feeds[n], at, 0).reshape(s[at], -1)
                if at is not None
                else feeds[n].reshape(*([1, -1] if len(s) >= IMAGE else [-1, s[-1] if s else 1]))
            )
        count = max(len(r) for r in rows.values())
        x = np.concatenate([np.resize(r, (count, r.shape[1])) for r in rows.values()], 1)
        ways = []
        for together in (False, True):
            columns = {p.name: x[:, k] if together else x[:, k, None] for k, p in enumerate(network.inputs)}
            got = network.run(columns)
            answers = {
                n: np.stack(
                    [np.reshape(got[p.name], count) for p in network.outputs if re.fullmatch(rf"{n}(_\d+)?", p.name)], 1
                )
                for n in numbers
            }
            ways.append(max(_nearest(answers[n], w, together) for n, w in numbers.items()))
        worst = max(worst, min(ways))
    return worst


def streamed(case: Case, made: Any, path: Path) -> float:
    """As `difference`, of a model of the last samples: at every step it is given those."""
    rng, run = np.random.default_rng(1), runner(case.model, path)
    longest = max(t.length for t in made.inputs)
    rows = {t.name: rng.normal(size=(longest + STEPS, sum(p.size for p in t.ports))) for t in made.inputs}
    columns = {p.name: rows[t.name][:, k] for t in made.inputs for k, p in enumerate(t.ports)}
    got, worst = made.network.run(columns), 0.0
    for k in range(longest, longest + STEPS):
        try:
            out = run({t.name: t.samples(rows[t.name][:k]).astype(np.float32) for t in made.inputs})
        except Exception as error:
            raise _Invalid(str(error)) from None
        for t in made.outputs:
            worst = max(worst, apart(np.array([got[p.name][k - 1] for p in t.ports]), np.ravel(out[t.name])))
    return worst


def _nearest(answers: np.ndarray, wanted: np.ndarray, together: bool) -> float:
    """How far answers, a row for each sample, are from an array: its samples lie along any axis, or it has the last."""
    count, size = answers.shape
    if wanted.size == size < answers.size:
        return apart(answers[-1], wanted) if together else np.inf
    if wanted.size != answers.size:
        return np.inf
    lying = [np.moveaxis(wanted, k, 0) for k, n in enumerate(wanted.shape) if n == count]
    return min(apart(answers, v) for v in (*lying, wanted))


def apart(a: np.ndarray, b: np.ndarray) -> float:
    a, b = np.ravel(a).astype(float), np.ravel(b).astype(float)
    if a.size != b.size or not np.isfinite(b).all():
        return np.inf
    return float(np.abs(a - b).max() / max(1.0, np.abs(b).max())) if a.size else 0.0


def runner(model: Any, path: Path) -> Any:
    """By onnxruntime; by the reference where it lacks the operator."""
    from onnx.reference import ReferenceEvaluator

    names = [o.name for o in model.graph.output]
    options = onnxruntime.SessionOptions()
    options.log_severity_level, options.intra_op_num_threads = 4, 1
    try:
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        return lambda feeds: dict(zip(names, session.run(None, feeds), strict=True))
    except Exception as first:
        try:
            evaluator = ReferenceEvaluator(model)
        except Exception:
            raise _Invalid(str(first)) from None
        return lambda feeds: dict(zip(names, evaluator.run(None, feeds), strict=True))
