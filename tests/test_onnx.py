"""An ONNX model is answered as onnxruntime answers, or refused with its node's name: never wrong without a word."""

from itertools import islice

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from onnx_cases import ML, OPSETS, Case, X, built, cases, f, i, judged, node_cases, one, recurrent

from greygate.errors import InputError
from greygate.models.importers import onnx_file
from greygate.models.importers.beside import beside
from greygate.models.importers.onnx_graph import from_onnx, imported
from greygate.models.importers.onnx_operations import FUNCTIONS

THINNED = 61  # of the choices of options: a prime, so that every operator is met
NODES = 3  # likewise of the node tests of the onnx package


def saved(model, tmp_path):
    path = tmp_path / "model.onnx"
    path.write_bytes(model.SerializeToString())
    return path


def refusal(model, tmp_path, **given):
    with pytest.raises(InputError) as found:
        from_onnx(saved(model, tmp_path), **given)
    return str(found.value)


def right(model, tmp_path, state=()):
    assert judged(Case("", model, dict(state)), tmp_path / "model.onnx")[0] == "right"


# -- right or refused ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("opset", OPSETS)
def test_a_choice_of_options_is_answered_as_by_onnxruntime_or_refused(opset, tmp_path):
    found = {}
    for case in islice(cases(opset), opset, None, THINNED):
        kind, said = judged(case, tmp_path / "case.onnx")
        found.setdefault(kind, []).append(f"{case.name}: {said}")
    assert not found.keys() & {"wrong", "traceback"}, found
    assert len(found["right"]) > 10


@pytest.mark.nightly
def test_a_node_test_of_the_onnx_package_is_answered_as_by_onnxruntime_or_refused(tmp_path):
    found = {}
    carried = (c for c in node_cases() if {n.op_type for n in c.model.graph.node} <= FUNCTIONS.keys())
    for case in islice(carried, 0, None, NODES):
        kind, said = judged(case, tmp_path / "case.onnx")
        found.setdefault(kind, []).append(f"{case.name}: {said}")
    assert not found.keys() & {"wrong", "traceback"}, found
    assert len(found["right"]) >= 10


WINDOW = {
    "mean": [helper.make_node("ReduceMean", ["x", "one"], ["y"], keepdims=0)],
    "sum": [helper.make_node("ReduceSum", ["x", "one"], ["y"], keepdims=0)],
    "first sample": [helper.make_node("Gather", ["x", "zero"], ["y"], axis=1)],
    "difference": [
        helper.make_node("Gather", ["x", "zero"], ["a"], axis=1),
        helper.make_node("Gather", ["x", "last"], ["b"], axis=1),
        helper.make_node("Sub", ["b", "a"], ["y"]),
    ],
    "deviation": [
        helper.make_node("ReduceMean", ["x", "one"], ["m"]),
        helper.make_node("Sub", ["x", "m"], ["d"]),
        helper.make_node("Tanh", ["d"], ["y"]),
    ],
}
PLACES = {"one": i(1), "zero": np.array(0), "last": np.array(-1)}


FIXED = {"w": f(8, 1), "third": np.array(3)}
BEYOND = {
    "flat": [helper.make_node("Flatten", ["x"], ["t"]), helper.make_node("MatMul", ["t", "w"], ["y"])],
    "fourth sample": [helper.make_node("Gather", ["x", "third"], ["y"], axis=1)],
}
FILTERS = {
    "convolution": [helper.make_node("Conv", ["x", "k"], ["y"])],
    "behind a pad": [helper.make_node("Pad", ["x", "pads"], ["p"]), helper.make_node("Conv", ["p", "k"], ["y"])],
    "average": [helper.make_node("AveragePool", ["x"], ["y"], kernel_shape=[3], strides=[2])],
    "all of them": [helper.make_node("GlobalAveragePool", ["x"], ["y"])],
}


@pytest.mark.parametrize("nodes", {**WINDOW, **BEYOND})
def test_a_model_of_a_window_becomes_a_delay_line_with_taps(nodes, tmp_path, capfd):
    model = built({**WINDOW, **BEYOND}[nodes], {"x": ["N", 4, 2]}, ["y"], PLACES | FIXED)
    right(model, tmp_path)
    assert "input 'x' is a window along its axis 1: the sample of this step and those before" in capfd.readouterr().err
    made = imported(saved(model, tmp_path))
    assert [p.name for p in made.network.inputs] == ["x_1", "x_2"]
    assert max(c.delay for c in made.network.flatten().connections) <= 3


@pytest.mark.parametrize("nodes", FILTERS)
def test_what_goes_into_a_convolution_is_a_window_along_its_last_axis(nodes, tmp_path):
    model = built(FILTERS[nodes], {"x": [1, 2, 7]}, ["y"], {"k": f(3, 2, 3), "pads": i(0, 0, 2, 0, 0, 0)})
    right(model, tmp_path)
    assert len(from_onnx(saved(model, tmp_path)).inputs) == 2


WRITTEN_OUT = {  # as exporters write what ONNX has no operator for, or had none in an old opset
    "softsign": [("Abs", "x", "a"), ("Add", "a", "one", "d"), ("Div", "x", "d", "y")],
    "log of a sigmoid": [("Sigmoid", "x", "s"), ("Log", "s", "y")],
    "truth of a comparison": [("Greater", "x", "one", "t"), ("BOOL", "t", "b"), ("FLOAT", "b", "y")],
    "truth of a number": [("Relu", "x", "r"), ("BOOL", "r", "b"), ("FLOAT", "b", "y")],
    "equal": [("Relu", "x", "r"), ("Equal", "x", "r", "t"), ("FLOAT", "t", "y")],
    "product": [("ReduceProd", "x", "y")],
}


@pytest.mark.parametrize("name", WRITTEN_OUT)
def test_what_an_exporter_writes_out_is_known(name, tmp_path):
    nodes = [
        helper.make_node("Cast", given, [y], to=getattr(TensorProto, op))
        if op in ("BOOL", "FLOAT")
        else helper.make_node(op, given, [y])
        for op, *given, y in WRITTEN_OUT[name]
    ]
    right(built(nodes, {"x": [1, 3]}, ["y"], {"one": np.float32(1)}), tmp_path)


def test_a_logarithm_of_what_may_be_negative_is_refused(tmp_path):
    assert "operation Log: the logarithm of a signal that may be negative" in refusal(
        one("Log", [1], opset=18), tmp_path
    )


def test_the_place_of_the_least_sample_is_that_in_a_window_though_a_draw_may_agree_by_chance(tmp_path):
    model = built([helper.make_node("ArgMin", ["x"], ["y"])], {"x": [2, 2]}, ["y"])
    network = from_onnx(saved(model, tmp_path))
    x = np.array([[2.0, 1.0], [3.0, -1.0], [0.0, 0.0]])
    answers = network.run({p.name: v for p, v in zip(network.inputs, x.T, strict=True)})
    assert [answers[p.name].tolist()[1:] for p in network.outputs] == [[0.0, 1.0], [1.0, 0.0]]


def test_a_model_that_divides_by_0_at_a_sample_that_is_tried_is_refused(tmp_path):
    nodes = [
        ("Neg", "x", "n"),
        ("Relu", "x", "r"),
        ("Relu", "n", "m"),
        ("Mul", "r", "m", "never"),
        ("Log", "never", "y"),
    ]
    model = built([helper.make_node(op, given, [y]) for op, *given, y in nodes], {"x": [1]}, ["y"])
    assert "limit what may be 0 from below" in refusal(model, tmp_path)


def test_missing_values_and_thresholds_of_scikit_learn_are_carried(tmp_path):
    for options in ({"replaced_value_float": float("nan")}, {"replaced_value_float": 0.0}):
        more = {"imputed_value_floats": [0.5, 1.5, 2.5]}
        right(one("Imputer", [1, 3], opset=18, domain=ML, **more, **options), tmp_path)
    right(one("Binarizer", [1, 3], opset=18, domain=ML, threshold=0.2), tmp_path)


def test_a_batch_of_windows_must_be_answered_one_by_one(tmp_path):
    nodes = [helper.make_node("ReduceMean", ["x", "both"], ["y"], keepdims=0)]
    said = refusal(built(nodes, {"x": ["N", 4, 2]}, ["y"], {"both": i(0, 1)}), tmp_path)
    assert "along 'N', an axis whose length is free, the model mixes samples" in said


@pytest.mark.parametrize("nodes", BEYOND.values(), ids=BEYOND)
def test_an_operation_that_does_not_fit_one_sample_of_a_free_window_is_refused_with_the_window(nodes, tmp_path):
    said = refusal(built(nodes, {"x": [1, "T", 2]}, ["y"], FIXED), tmp_path)
    assert "does not fit one sample, and input 'x' is [1, 'T', 2]; a network takes one sample a step" in said


@pytest.mark.parametrize("nodes", WINDOW)
def test_samples_mixed_along_an_axis_of_free_length_are_refused(nodes, tmp_path):
    said = refusal(built(WINDOW[nodes], {"x": [1, "T", 2]}, ["y"], PLACES), tmp_path)
    assert "along 'T', an axis whose length is free, the model mixes samples" in said


def test_a_batch_a_sequence_and_the_last_sample_of_a_window_are_carried(tmp_path):
    for shape in (["N", 3], [7, 3], ["N", "T", 3]):
        right(one("Tanh", shape, opset=18), tmp_path)
    right(built([helper.make_node("Gather", ["x", "last"], ["y"], axis=1)], {"x": [1, 5, 2]}, ["y"], PLACES), tmp_path)
    right(recurrent("LSTM", 20, ["T", 1, 3]).model, tmp_path)


WAYS = ("forward", "reverse", "bidirectional")


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("kind", ["RNN", "GRU", "LSTM"])
def test_a_recurrent_operator_over_a_window_begins_anew_in_every_step(kind, way, tmp_path):
    lengths = {"sequence_lens": np.array([4], np.int32)}
    for more in ({}, lengths):
        right(recurrent(kind, 18, [5, 1, 3], direction=way, more=more).model, tmp_path)


def test_a_statistic_of_batch_normalization_belongs_to_axis_1(tmp_path):
    given = f(2), f(2), f(2), np.abs(f(2))
    nodes = [
        helper.make_node("Reshape", ["x", "s"], ["a"]),
        helper.make_node("BatchNormalization", ["a", *"wbmv"], ["n"]),
        helper.make_node("Reshape", ["n", "t"], ["y"]),
    ]
    fixed = dict(zip("wbmv", given, strict=True)) | {"s": i(1, 2, 2), "t": i(1, 4)}
    right(built(nodes, {"x": [1, 4]}, ["y"], fixed), tmp_path)
    assert "training mode" in refusal(one("BatchNormalization", [1, 2], *given, opset=18, training_mode=1), tmp_path)


RECURRENT = {
    "peepholes": lambda shape: recurrent("LSTM", 20, shape, more={"P": f(1, 12)}),
    "clip": lambda shape: recurrent("RNN", 20, shape, clip=0.2),
    "clip of an LSTM": lambda shape: recurrent("LSTM", 20, shape, clip=0.2),
    "clip of a GRU": lambda shape: recurrent("GRU", 20, shape, clip=0.2, linear_before_reset=1),
    "input_forget": lambda shape: recurrent("LSTM", 20, shape, input_forget=1),
    "activations": lambda shape: recurrent("LSTM", 20, shape, activations=["HardSigmoid", "Relu", "Softsign"]),
    "alpha in turn": lambda shape: recurrent(
        "LSTM", 20, shape, activations=["Sigmoid", "Affine", "LeakyRelu"], activation_alpha=[0.7, 0.2],
        activation_beta=[0.1],
    ),
    "limits": lambda shape: recurrent(
        "GRU", 20, shape, activations=["HardSigmoid", "ScaledTanh"], activation_alpha=[0.3, 0.8],
        activation_beta=[0.4, 1.2],
    ),
    "elu within limits": lambda shape: recurrent(
        "RNN", 20, shape, activations=["Elu"], activation_alpha=[0.6], clip=3.0
    ),
}  # fmt: skip


@pytest.mark.parametrize("option", RECURRENT)
def test_an_option_of_a_recurrent_operator_is_answered_as_by_onnxruntime(option, tmp_path):
    for shape in (["T", 1, 3], [4, 1, 3]):
        right(RECURRENT[option](shape).model, tmp_path)


@pytest.mark.parametrize("kind", ["RNN", "GRU", "LSTM"])
def test_the_batch_may_be_the_first_axis_of_a_recurrent_operator(kind, tmp_path):
    for shape in ([1, 1, 3], [1, 4, 3]):
        right(recurrent(kind, 20, shape, layout=1).model, tmp_path)


UNCARRIED = {  # what is said -> the operator
    "sequence_lens": lambda: recurrent("GRU", 20, ["T", 1, 3], more={"sequence_lens": np.array([1], np.int32)}),
    "direction reverse": lambda: recurrent("GRU", 20, ["T", 1, 3], direction="reverse"),
    "activation affine without its alpha": lambda: recurrent("RNN", 20, ["T", 1, 3], activations=["Affine"]),
    "activation gelu is not carried": lambda: recurrent("RNN", 20, ["T", 1, 3], activations=["Gelu"]),
}


@pytest.mark.parametrize("why", UNCARRIED)
def test_an_option_of_a_recurrent_operator_that_is_not_carried_is_refused(why, tmp_path):
    assert why in refusal(UNCARRIED[why]().model, tmp_path)


def test_the_usual_activations_of_a_recurrent_operator_may_be_written_out(tmp_path):
    right(recurrent("GRU", 21, ["T", 1, 3], activations=["Sigmoid", "Tanh"]).model, tmp_path)
    right(recurrent("LSTM", 21, ["T", 1, 3], activations=["sigmoid", "tanh", "tanh"]).model, tmp_path)
    right(recurrent("RNN", 21, ["T", 1, 3], activations=["Relu"]).model, tmp_path)


def test_every_element_is_raised_to_its_own_exponent(tmp_path):
    for exponents in ([2.0, 3.0], [2.0, 2.0], [[1.0, 4.0], [0.0, 3.0]]):
        right(one("Pow", [2], np.float32(exponents), opset=18), tmp_path)
    assert "operation Pow: the power 17; up to 16" in refusal(one("Pow", [2], np.float32([2, 17]), opset=18), tmp_path)


CARRIED = {  # name -> the model
    **{op: one(op, [1, 3], opset=20) for op in ("Elu", "Selu", "Celu", "Softplus", "Gelu", "Mish", "HardSwish", "Erf")},
    **{op: one(op, [1, 3], opset=20) for op in ("ThresholdedRelu", "Shrink", "Sign")},
    "Elu, alpha": one("Elu", [3], opset=20, alpha=0.4),
    "Gelu, tanh": one("Gelu", [3], opset=20, approximate="tanh"),
    "Shrink, bias": one("Shrink", [3], opset=20, lambd=0.3, bias=0.1),
    "Max": one("Max", ["N", 3], f(3), opset=20),
    "Min": one("Min", [1, 3], X, f(1), opset=20),
    "Mean": one("Mean", [1, 3], X, f(3), opset=20),
    "ReduceMax": one("ReduceMax", [1, 3], i(1), opset=20),
    "ReduceMin": one("ReduceMin", [1, 3], i(1), opset=20, keepdims=0),
    "ReduceSumSquare": one("ReduceSumSquare", [1, 3], i(1), opset=20),
    "ReduceL1": one("ReduceL1", [1, 3], i(-1), opset=20),
    "Gemm, constant first": built(
        [helper.make_node("Reshape", ["x", "s"], ["t"]), helper.make_node("Gemm", ["w", "t", "b"], ["y"])],
        {"x": [1, 3]}, ["y"], {"s": i(3, 1), "w": f(2, 3), "b": f(2, 1)},
    ),
    "Gemm, transA": built(
        [helper.make_node("Reshape", ["x", "s"], ["t"]), helper.make_node("Gemm", ["t", "w"], ["y"], transA=1)],
        {"x": [1, 3]}, ["y"], {"s": i(3, 1), "w": f(3, 2)},
    ),
    "Pad": one("Pad", [1, 3], i(0, 1, 0, 2), np.float32(0.7), opset=20),
    "Pad, reflected": one("Pad", [1, 3], i(0, 1, 0, 2), opset=20, mode="reflect"),
    "Tile": one("Tile", [1, 3], i(1, 2), opset=20),
    "GatherElements": one("GatherElements", [1, 3], i(2, 0)[None], opset=20, axis=1),
    "GatherND": one("GatherND", [1, 3], np.array([[0, 2], [0, 1]]), opset=20),
    "CumSum": one("CumSum", [1, 3], np.array(1), opset=20, reverse=1),
    "ScatterND": one("ScatterND", [1, 3], np.array([[0, 1]]), f(1), opset=20),
    "Einsum": built([helper.make_node("Einsum", ["x", "w"], ["y"], equation="bi,ij->bj")], {"x": [1, 3]}, ["y"],
                    {"w": f(3, 2)}),
}  # fmt: skip


@pytest.mark.parametrize("name", CARRIED)
def test_a_shape_of_neuron_or_an_affine_operation_answers_as_by_onnxruntime(name, tmp_path):
    right(CARRIED[name], tmp_path)


COMPARED = {
    "Greater": ["Greater"], "Less": ["Less"], "GreaterOrEqual": ["GreaterOrEqual"], "LessOrEqual": ["LessOrEqual"],
    "Not": ["Less", "Not"], "And": ["Less", "And"], "Or": ["Greater", "Or"],
}  # fmt: skip


@pytest.mark.parametrize("name", COMPARED)
def test_a_comparison_chooses_as_by_onnxruntime(name, tmp_path):
    first, *then = COMPARED[name]
    nodes = [helper.make_node(first, ["x", "w"], ["c"]), helper.make_node("Less", ["x", "v"], ["d"])]
    nodes += [helper.make_node(op, ["c"] if op == "Not" else ["c", "d"], ["e"]) for op in then]
    last = "e" if then else "c"
    nodes.append(helper.make_node("Where", [last, "x", "v"], ["chosen"]))
    nodes.append(helper.make_node("Cast", [last], ["number"], to=TensorProto.FLOAT))
    nodes.append(helper.make_node("Add", ["chosen", "number"], ["y"]))
    right(built(nodes, {"x": [1, 3]}, ["y"], {"w": np.float32([0.2]), "v": np.float32([-0.3])}), tmp_path)


SPACE = {  # operation, its constants and options; of the input [1, 6] as [1, 2, 3] or [1, 2, 1, 3]
    "Conv": ([1, 2, 3], "Conv", [f(4, 2, 2), f(4)], {}),
    "Conv, all of them": ([1, 2, 3], "Conv", [f(4, 2, 2)], {"pads": [2, 1], "strides": [2], "dilations": [2]}),
    "Conv, two groups": ([1, 2, 3], "Conv", [f(4, 1, 2), f(4)], {"group": 2}),
    "Conv of an image": ([1, 2, 1, 3], "Conv", [f(3, 2, 1, 2)], {"auto_pad": "SAME_UPPER"}),
    "Conv, SAME_LOWER": ([1, 2, 3], "Conv", [f(3, 2, 2)], {"auto_pad": "SAME_LOWER", "strides": [2]}),
    "ConvTranspose": ([1, 2, 3], "ConvTranspose", [f(2, 2, 2)], {}),
    "AveragePool": ([1, 2, 3], "AveragePool", [], {"kernel_shape": [2], "pads": [1, 0]}),
    "AveragePool, the pads": ([1, 2, 3], "AveragePool", [], {"kernel_shape": [2], "pads": [1, 0],
                                                            "count_include_pad": 1}),
    "MaxPool": ([1, 2, 3], "MaxPool", [], {"kernel_shape": [2], "strides": [1]}),
    "GlobalAveragePool": ([1, 2, 3], "GlobalAveragePool", [], {}),
    "GlobalMaxPool": ([1, 2, 1, 3], "GlobalMaxPool", [], {}),
}  # fmt: skip


@pytest.mark.parametrize("name", SPACE)
def test_a_convolution_or_a_pool_answers_as_by_onnxruntime(name, tmp_path):
    shape, op, constants, options = SPACE[name]
    names = [f"c{k}" for k in range(len(constants))]
    nodes = [
        helper.make_node("Reshape", ["x", "s"], ["t"]),
        helper.make_node(op, ["t", *names], ["r"], **options),
        helper.make_node("Flatten", ["r"], ["y"]),
    ]
    fixed = dict(zip(names, constants, strict=True)) | {"s": i(*shape)}
    right(built(nodes, {"x": [1, 6]}, ["y"], fixed), tmp_path)


def test_the_fully_connected_layers_of_matlab_are_convolutions_over_an_image(tmp_path):
    nodes = [
        helper.make_node("Sub", ["x", "mean"], ["a"]),
        helper.make_node("Conv", ["a", "w", "b"], ["c"], kernel_shape=[5, 1]),
        helper.make_node("Relu", ["c"], ["r"]),
        helper.make_node("Conv", ["r", "v"], ["y"], kernel_shape=[1, 1]),
    ]
    fixed = {"mean": f(1, 1, 5, 1), "w": f(4, 1, 5, 1), "b": f(4), "v": f(2, 4, 1, 1)}
    model = built(nodes, {"x": ["BatchSize", 1, 5, 1]}, ["y"], fixed, opset=6)
    model.ir_version = 3
    model.graph.input.extend(
        helper.make_tensor_value_info(t.name, t.data_type, t.dims) for t in model.graph.initializer
    )
    network = from_onnx(saved(model, tmp_path))
    x = np.random.default_rng(0).normal(size=(9, 5))
    got = network.run({p.name: x[:, k] for k, p in enumerate(network.inputs)})
    hidden = np.maximum((x - fixed["mean"].ravel()) @ fixed["w"].reshape(4, 5).T + fixed["b"], 0)
    assert np.abs(np.column_stack(list(got.values())) - hidden @ fixed["v"].reshape(2, 4).T).max() < 1e-6


@pytest.mark.parametrize(
    ("op", "why"),
    [
        ("Conv", "the kernel must be a constant"),
        ("Einsum", "two of its factors are signals"),
        ("ConvTranspose", "c must be a constant"),
    ],
)
def test_a_product_of_signals_within_an_operation_is_refused(op, why, tmp_path):
    options = {"equation": "abi,abi->ab"} if op == "Einsum" else {}
    nodes = [
        helper.make_node("Reshape", ["x", "s"], ["t"]),
        helper.make_node("Tanh", ["t"], ["c"]),
        helper.make_node(op, ["t", "c"], ["y"], **options),
    ]
    assert why in refusal(built(nodes, {"x": [1, 3]}, ["y"], {"s": i(1, 1, 3)}), tmp_path)


OF_CONSTANTS = {
    "Softmax": {}, "LogSoftmax": {}, "Celu": {}, "Gelu": {}, "Mish": {}, "Shrink": {}, "ThresholdedRelu": {},
    "Hardmax": {}, "LpNormalization": {},
}  # fmt: skip


@pytest.mark.parametrize("op", OF_CONSTANTS)
def test_an_operation_on_weights_leaves_them_constant(op, tmp_path):
    nodes = [helper.make_node(op, ["w"], ["v"]), helper.make_node("MatMul", ["x", "v"], ["y"])]
    right(built(nodes, {"x": [1, 3]}, ["y"], {"w": f(3, 2)}, 20), tmp_path)


def test_weights_of_whole_numbers_with_a_scale_and_a_zero_point_are_read(tmp_path):
    nodes = [helper.make_node("DequantizeLinear", ["w", "s", "z"], ["v"], axis=1)]
    nodes.append(helper.make_node("MatMul", ["x", "v"], ["y"]))
    fixed = {
        "w": np.array([[7, 250], [0, 3], [128, 9]], np.uint8),
        "s": np.float32([0.1, 0.25]),
        "z": np.array([3, 128], np.uint8),
    }
    network = from_onnx(saved(built(nodes, {"x": [1, 3]}, ["y"], fixed), tmp_path))
    found = network.run({p.name: np.full(1, v) for p, v in zip(network.inputs, (1.0, -2.0, 0.5), strict=True)})
    weights = (fixed["w"].astype(float) - fixed["z"]) * fixed["s"]
    assert np.allclose([v[0] for v in found.values()], np.array([1.0, -2.0, 0.5]) @ weights, atol=1e-6)


def test_the_powers_0_and_1_and_a_slope_for_each_channel_are_carried(tmp_path):
    for exponent in (0.0, 1.0):
        right(one("Pow", [1, 3], np.float32(exponent), opset=18), tmp_path)
    right(one("PRelu", [1, 3], f(3), opset=18), tmp_path)
    right(one("PRelu", ["N", 3], f(1), opset=18), tmp_path)


def test_a_chosen_feature_and_a_linear_model_of_scikit_learn_are_carried(tmp_path):
    right(one("ArrayFeatureExtractor", [1, 3], i(2, 0), opset=18, domain=ML), tmp_path)
    plane = {"coefficients": f(6).tolist(), "intercepts": f(2).tolist(), "targets": 2}
    right(one("LinearRegressor", ["N", 3], opset=18, domain=ML, **plane), tmp_path)
    said = refusal(one("LinearRegressor", [1, 3], opset=18, domain=ML, post_transform="LOGISTIC", **plane), tmp_path)
    assert "post_transform LOGISTIC is not carried" in said


def test_an_output_that_is_declared_too_short_has_a_port_for_each_number(tmp_path):
    model = one("MatMul", ["N", 3], f(3, 2), opset=18)
    output = model.graph.output[0]
    output.CopyFrom(helper.make_tensor_value_info(output.name, TensorProto.FLOAT, [None, 1]))
    network = from_onnx(saved(model, tmp_path))
    assert [p.name for p in network.outputs] == ["y0_1", "y0_2"]


def test_a_state_that_is_the_only_output_is_given_too(tmp_path):
    nodes = [helper.make_node("Add", ["x", "h"], ["t"]), helper.make_node("Tanh", ["t"], ["after"])]
    network = from_onnx(saved(built(nodes, {"x": [1], "h": [1]}, ["after"]), tmp_path), state={"h": "after"})
    once = np.tanh(1.0)
    assert network.run({"x": np.ones(2)})["after"].tolist() == [once, np.tanh(1.0 + once)]


def test_a_network_is_called_as_its_file_in_letters_that_a_name_has(tmp_path):
    path = tmp_path / "my model-2.5.onnx"
    path.write_bytes(one("Tanh", [2], opset=18).SerializeToString())
    assert from_onnx(path).name == "my_model_2_5"


def test_a_product_with_several_matrices_is_refused_with_their_shape(tmp_path):
    said = refusal(one("MatMul", [1, 3], f(2, 3, 2), opset=18), tmp_path)
    assert "operation MatMul: several matrices at once, [2, 3, 2], are not carried" in said


def test_limits_that_lie_far_apart_lose_no_digits(tmp_path):
    right(one("Clip", [3], np.float32(-1e30), np.float32(1e30), opset=18), tmp_path)
    right(one("Clip", [3], np.float32(-1e30), np.float32(0.5), opset=18), tmp_path)


def test_an_operation_is_known_by_its_domain_and_its_name(tmp_path):
    double = helper.make_function(
        "my", "Tanh", ["x"], ["y"], [helper.make_node("Add", ["x", "x"], ["y"])], [helper.make_opsetid("", 18)]
    )
    call = helper.make_node("Tanh", ["x"], ["y"], domain="my")
    model = built([call], {"x": [3]}, ["y"], functions=[double], domains=["my"])
    model.graph.output[0].CopyFrom(helper.make_tensor_value_info("y", TensorProto.FLOAT, [3]))
    right(model, tmp_path)
    strange = built([helper.make_node("Tanh", ["x"], ["y"], domain="strange")], {"x": [1]}, ["y"], domains=["strange"])
    assert "operation strange.Tanh: a network carries" in refusal(strange, tmp_path)
    double.domain = ""
    model = built([helper.make_node("Tanh", ["x"], ["y"])], {"x": [1]}, ["y"], functions=[double])
    assert "function 'Tanh' is in the domain of ONNX" in refusal(model, tmp_path)


@pytest.mark.parametrize("op", ["RandomNormal", "RandomUniform", "RandomNormalLike", "Bernoulli", "RandomUniformLike"])
def test_a_random_operation_never_becomes_a_constant(op, tmp_path):
    options = {"shape": [3]} if op in ("RandomNormal", "RandomUniform") else {}
    nodes = [
        helper.make_node(op, [] if options else ["a"], ["r"], **options),
        helper.make_node("Add", ["x", "r"], ["y"]),
    ]
    assert f"operation {op}: a network carries" in refusal(
        built(nodes, {"x": [3]}, ["y"], {"a": np.full(3, 0.5, np.float32)}), tmp_path
    )


def test_constants_keep_their_type(tmp_path):
    nodes = [
        helper.make_node("Div", ["a", "b"], ["q"]),
        helper.make_node("Cast", ["q"], ["r"], to=TensorProto.FLOAT),
        helper.make_node("Mul", ["x", "r"], ["y"]),
    ]
    path = saved(built(nodes, {"x": [1]}, ["y"], {"a": np.array(7), "b": np.array(-2)}), tmp_path)
    assert from_onnx(path).run({"x": np.ones(1)})["y"].tolist() == [-3.0]


@pytest.mark.parametrize(
    "held",
    [{"value": numpy_helper.from_array(np.array([3.0], np.float32))}, {"value_float": 3.0}, {"value_floats": [3.0]}],
    ids=lambda held: next(iter(held)),
)
def test_a_constant_is_carried_in_every_form_that_holds_numbers(held, tmp_path):
    nodes = [helper.make_node("Constant", [], ["c"], **held), helper.make_node("Mul", ["x", "c"], ["y"])]
    assert from_onnx(saved(built(nodes, {"x": [1]}, ["y"]), tmp_path)).run({"x": np.ones(1)})["y"].tolist() == [3.0]


def test_initial_values_are_of_states_that_there_are(tmp_path):
    case = recurrent("GRU", 18, [1, 1, 3], state=True)
    given = {"state": case.state}
    said = refusal(case.model, tmp_path, **given, initial={"h": np.zeros(4)})
    assert "initial 'h': no such state; the states are initial_h" in said
    said = refusal(case.model, tmp_path, **given, initial={"initial_h": np.zeros(3)})
    assert "has 3 numbers; the state has 4" in said
    assert "holds no numbers" in refusal(case.model, tmp_path, **given, initial={"initial_h": "off"})


def test_a_split_that_leaves_nothing_is_refused(tmp_path):
    said = refusal(one("Split", [1, 3], opset=17, outputs=3, axis=0), tmp_path)
    assert "operation Split: splits 1 numbers into 1, 1, 1" in said
    said = refusal(one("Slice", [1, 3], i(1), i(1), i(1), opset=18), tmp_path)
    assert "has no numbers" in said or "name a port for each" in said


def test_an_input_that_is_not_of_floats_is_refused(tmp_path):
    model = built([helper.make_node("Add", ["x", "x"], ["y"])], {"x": [3]}, ["y"], kind=TensorProto.INT64)
    assert "x is of INT64" in refusal(model, tmp_path)


def test_what_does_not_answer_as_its_model_is_not_given(tmp_path, monkeypatch):
    """An operator that is carried wrongly, whichever it is, is found by ONNX's own reference."""
    monkeypatch.setitem(FUNCTIONS, "Neg", lambda walk, x: x.times(-1.00001))
    assert "does not answer as the model" in refusal(one("Neg", [3], opset=18), tmp_path)


# -- limits, and numbers that are elsewhere --------------------------------------------------------------------------


def elsewhere(name="w"):
    tensor = numpy_helper.from_array(np.ones(3, np.float32), name)
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", "private.bin"
    return tensor


def test_a_scan_over_rows_of_constants_is_unrolled_as_no_time_goes_by(tmp_path):
    """Distances to the samples of a Gaussian process, by skl2onnx."""
    ins = [helper.make_tensor_value_info(n, TensorProto.FLOAT, [3]) for n in ("s", "row")]
    outs = [helper.make_tensor_value_info(n, TensorProto.FLOAT, None) for n in ("t", "d")]
    steps = [("Identity", ["s"], ["t"]), ("Sub", ["s", "row"], ["e"]), ("Mul", ["e", "e"], ["d"])]
    body = helper.make_graph([helper.make_node(*step) for step in steps], "body", ins, outs)
    scan = helper.make_node("Scan", ["x", "rows"], ["kept", "y"], num_scan_inputs=1, body=body)
    model = built([scan], {"x": [3]}, ["y"], {"rows": f(4, 3)})
    assert judged(Case("rows", model), tmp_path / "m.onnx")[0] == "right"


def outside(where):
    """A model with a tensor whose numbers are in private.bin."""
    add = helper.make_node("Add", ["x", "w"], ["y"])
    kept = helper.make_node("Constant", [], ["w"], value=elsewhere())
    if where == "a function":
        call = helper.make_node("Plus", ["x"], ["y"], domain="my")
        function = helper.make_function("my", "Plus", ["x"], ["y"], [kept, add], [helper.make_opsetid("", 18)])
        return built([call], {"x": [3]}, ["y"], functions=[function], domains=["my"])
    if where == "a Constant":
        return built([kept, add], {"x": [3]}, ["y"])
    if where == "a body":
        tensors = [helper.make_tensor_value_info(n, TensorProto.FLOAT, [3]) for n in ("x", "y")]
        body = helper.make_graph([kept, add], "body", tensors[:1], tensors[1:])
        return built([helper.make_node("Scan", ["x"], ["y"], num_scan_inputs=1, body=body)], {"x": [1, 3]}, ["y"])
    if where == "an attribute":
        filled = helper.make_node("ConstantOfShape", ["n"], ["w"], value=elsewhere())
        return built([filled, add], {"x": [3]}, ["y"], {"n": i(3)})
    model = built([add], {"x": [3]}, ["y"], {"w": f(3)})
    if where == "an initializer":
        model.graph.initializer[0].CopyFrom(elsewhere())
    else:
        del model.graph.initializer[:]
        sparse = model.graph.sparse_initializer.add()
        sparse.values.CopyFrom(elsewhere())
        sparse.indices.CopyFrom(numpy_helper.from_array(i(0, 1, 2), "places"))
        sparse.dims.append(3)
    return model


PLACES_OF_NUMBERS = ["an initializer", "a Constant", "a function", "a body", "an attribute"]


@pytest.mark.parametrize("where", PLACES_OF_NUMBERS[:-1])
def test_numbers_in_a_file_beside_the_model_are_read(where, tmp_path):
    (tmp_path / "private.bin").write_bytes(np.float32([1, 2, 3]).tobytes())
    model = outside(where)
    if where == "a function":
        model.graph.output[0].CopyFrom(helper.make_tensor_value_info("y", TensorProto.FLOAT, [3]))
    network = from_onnx(saved(model, tmp_path))
    found = network.run({p.name: np.zeros(1) for p in network.inputs})
    assert [float(found[p.name][0]) for p in network.outputs] == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("where", [*PLACES_OF_NUMBERS, "a sparse one"])
def test_numbers_elsewhere_are_not_read(where, tmp_path, monkeypatch):
    (tmp_path / "model").mkdir()
    monkeypatch.chdir(tmp_path)
    (tmp_path / "private.bin").write_bytes(np.float32([1, 2, 3]).tobytes())
    model = outside(where)
    said = refusal(model, tmp_path / "model")
    assert "is sparse" in said if where == "a sparse one" else "'private.bin', which is missing; copy it beside" in said
    if where != "a sparse one":
        (tmp_path / "model" / "private.bin").symlink_to(tmp_path / "private.bin")
        assert "'private.bin', which is not beside the model" in refusal(model, tmp_path / "model")


@pytest.mark.parametrize(
    ("told", "why"),
    [
        ({"location": "../private.bin"}, "which is not beside the model"),
        ({"location": "/etc/hostname"}, "which is not beside the model"),
        ({"location": "."}, "which is missing"),
        ({"location": "private.bin", "length": "13"}, "which ends before them"),
        ({"location": "private.bin", "offset": "1e3"}, "which is no place in a file"),
        ({"location": "private.bin", "offset": "-4"}, "which is not beside the model"),
        ({"location": "private.bin", "length": "99999999"}, "99999999 bytes; all together may have 16 MiB"),
    ],
)
def test_numbers_beside_a_model_must_be_where_it_says(told, why, tmp_path):
    (tmp_path / "model").mkdir()
    for folder in (tmp_path, tmp_path / "model"):
        (folder / "private.bin").write_bytes(np.float32([1, 2, 3]).tobytes())
    model = outside("an initializer")
    del model.graph.initializer[0].external_data[:]
    for key, value in told.items():
        entry = model.graph.initializer[0].external_data.add()
        entry.key, entry.value = key, value
    assert why in refusal(model, tmp_path / "model")


OLD = (6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16)


@pytest.mark.parametrize("opset", OLD)
def test_a_model_of_an_old_opset_answers_as_it_did_and_a_line_says_so(opset, tmp_path, capfd):
    gemm = {"broadcast": 1} if opset < 7 else {}
    nodes = [
        helper.make_node("Gemm", ["x", "w", "b"], ["g"], transB=1, **gemm),
        helper.make_node("Relu", ["g"], ["r"]),
        helper.make_node("Gemm", ["r", "v", "c"], ["y"], transB=1, **gemm),
    ]
    model = built(nodes, {"x": [1, 3]}, ["y"], {"w": f(4, 3), "b": f(4), "v": f(2, 4), "c": f(2)}, opset)
    model.ir_version = 3
    model.graph.input.extend(
        helper.make_tensor_value_info(t.name, t.data_type, t.dims) for t in model.graph.initializer
    )
    path = saved(model, tmp_path)
    network = from_onnx(path)
    assert f"{path}: opset {opset}, read as 17 by onnx's own converter" in capfd.readouterr().err
    w, b, v, c = (numpy_helper.to_array(t).astype(float) for t in model.graph.initializer)
    x = np.random.default_rng(0).normal(size=(5, 3))
    got = network.run({p.name: x[:, k] for k, p in enumerate(network.inputs)})
    wanted = np.maximum(x @ w.T + b, 0) @ v.T + c
    assert np.abs(np.column_stack(list(got.values())) - wanted).max() < 1e-9


@pytest.mark.parametrize("left_out", ["constants among the inputs", "the shape of its output"])
def test_what_some_tools_leave_out_of_a_file_is_not_asked_for(left_out, tmp_path):
    model = built([helper.make_node("MatMul", ["x", "w"], ["y"])], {"x": [1, 3]}, ["y"], {"w": f(3, 2)}, opset=8)
    model.ir_version = 3
    if left_out == "the shape of its output":
        model.ir_version = 8
        model.graph.output[0].type.tensor_type.ClearField("shape")
    assert len(from_onnx(saved(model, tmp_path)).outputs) == 2


def test_a_model_of_an_opset_that_onnxruntime_has_not_runs_beside_the_network_in_a_newer_one(tmp_path):
    nodes = [helper.make_node("Mul", ["x", "w"], ["y"], broadcast=1)]
    path = saved(built(nodes, {"x": [1, 3]}, ["y"], {"w": f(3)}, opset=6), tmp_path)
    made = imported(path)
    found = beside(made, path, {p.name: np.linspace(-1, 1, 9) for p in made.network.inputs})
    assert (found.steps, found.why, found.largest < 1e-6) == (9, "", True)
    assert found.program.startswith("onnxruntime")


def test_every_input_may_have_its_own_name_for_the_batch(tmp_path):
    """As Keras's exporter names them."""
    nodes = [helper.make_node("Concat", ["a", "b"], ["c"], axis=1), helper.make_node("Tanh", ["c"], ["y"])]
    network = from_onnx(saved(built(nodes, {"a": ["unk__1", 2], "b": ["unk__2", 1]}, ["y"]), tmp_path))
    assert [p.name for p in network.inputs] == ["a_1", "a_2", "b"]
    mixed = [helper.make_node("ReduceSum", ["c", "zero"], ["s"]), helper.make_node("Add", ["c", "s"], ["y"])]
    model = built([nodes[0], *mixed], {"a": ["unk__1", 2], "b": ["unk__2", 1]}, ["y"], {"zero": i(0)})
    assert "the model mixes samples" in refusal(model, tmp_path)


def test_inputs_beside_a_window_may_have_their_own_name_for_the_batch(tmp_path):
    nodes = [helper.make_node("Flatten", ["x"], ["t"]), helper.make_node("Concat", ["t", "b"], ["y"], axis=1)]
    network = from_onnx(saved(built(nodes, {"x": ["M", 4, 2], "b": ["N", 1]}, ["y"]), tmp_path))
    assert len(network.inputs) == 3


def test_statistics_of_batch_normalization_may_be_computed_as_tensorflow_writes_a_layer_norm(tmp_path):
    nodes = [
        helper.make_node("ReduceMean", ["x", "axis"], ["m"], keepdims=1),
        helper.make_node("Sub", ["x", "m"], ["d"]),
        helper.make_node("Mul", ["d", "d"], ["s"]),
        helper.make_node("ReduceMean", ["s", "axis"], ["v"], keepdims=1),
        *(helper.make_node("Squeeze", [n, "axis"], [f"{n}_flat"]) for n in "mv"),
        helper.make_node("Unsqueeze", ["x", "first"], ["row"]),
        helper.make_node("BatchNormalization", ["row", "one", "zero", "m_flat", "v_flat"], ["n"]),
        helper.make_node("Squeeze", ["n", "first"], ["y"]),
    ]
    fixed = {"axis": i(1), "first": i(0), "one": np.ones(1), "zero": np.zeros(1)}
    right(built(nodes, {"x": [1, 4]}, ["y"], {n: v if v.dtype == int else f(1) for n, v in fixed.items()}), tmp_path)


def repeated(times, on="go"):
    """A body that adds a step's sample to what it holds, and shows that, so many times."""
    inside = [
        helper.make_node("Identity", [on], ["on"]),
        helper.make_node("Gather", ["x", "k"], ["sample"], axis=1),
        helper.make_node("Add", ["h", "sample"], ["s"]),
        helper.make_node("Tanh", ["s"], ["after"]),
        helper.make_node("Identity", ["after"], ["row"]),
    ]
    kinds = {"k": (7, []), "go": (9, []), "h": (1, None), "on": (9, []), "after": (1, None), "row": (1, None)}
    told = {n: helper.make_tensor_value_info(n, *kind) for n, kind in kinds.items()}
    body = helper.make_graph(
        inside, "b", [told[n] for n in ("k", "go", "h")], [told[n] for n in ("on", "after", "row")]
    )
    nodes = [
        helper.make_node("Loop", ["times", "", "start"], ["last", "rows"], body=body),
        helper.make_node("Transpose", ["rows"], ["turned"], perm=[1, 0, 2]),
        helper.make_node("Flatten", ["turned"], ["flat"]),
        helper.make_node("Concat", ["last", "flat"], ["y"], axis=1),
    ]
    return built(nodes, {"x": ["N", 4, 2]}, ["y"], {"times": np.array(times), "start": np.zeros((1, 2), np.float32)})


def test_a_loop_of_known_length_over_a_window_is_written_out(tmp_path):
    right(repeated(4), tmp_path)
    right(repeated(3), tmp_path)


@pytest.mark.parametrize("op", ["Loop", "If"])
def test_a_graph_inside_that_reads_constants_alone_keeps_their_type(op, tmp_path):
    found = [c for c in cases(OPSETS[0]) if c.name == f"of constants: {op}"]
    assert [judged(case, tmp_path / "case.onnx")[0] for case in found] == ["right"]


def test_a_scan_of_opset_8_whose_batches_the_converter_loses_is_refused(tmp_path):
    (case,) = (c for c in node_cases() if c.name == "test_scan_sum")
    assert "Scan of opset 8 has batches" in refusal(case.model, tmp_path)


@pytest.mark.parametrize("chosen", [True, False])
def test_the_branch_of_a_known_condition_is_taken(chosen, tmp_path):
    shown = helper.make_tensor_value_info("z", 1, None)
    graphs = {
        f"{name}_branch": helper.make_graph([helper.make_node(op, ["x"], ["z"])], name, [], [shown])
        for name, op in (("then", "Tanh"), ("else", "Sigmoid"))
    }
    right(
        built([helper.make_node("If", ["c"], ["y"], **graphs)], {"x": [1, 3]}, ["y"], {"c": np.array(chosen)}), tmp_path
    )
    asked = [
        helper.make_node("ReduceMax", ["x"], ["m"], keepdims=0),
        helper.make_node("Greater", ["m", "m"], ["c"]),
        helper.make_node("If", ["c"], ["y"], **graphs),
    ]
    said = refusal(built(asked, {"x": [1, 3]}, ["y"]), tmp_path)
    assert "how it goes on depends on the inputs; write Where" in said


def test_layers_of_long_names_are_joined(tmp_path):
    """As Keras's exporter makes them of the names of all its parts."""
    names = [f"model/{'a_part_of_the_model/' * 3}{k}" for k in range(2)]
    nodes = [
        helper.make_node("Tanh", ["x"], ["t"], name=names[0]),
        helper.make_node("Sigmoid", ["t"], ["y"], name=names[1]),
    ]
    right(built(nodes, {"x": [1, 3]}, ["y"]), tmp_path)


def test_an_old_operator_that_has_no_counterpart_is_refused_in_one_line(tmp_path):
    model = built([helper.make_node("Tile", ["x", "t", "a"], ["y"])], {"x": [1, 3], "t": [1], "a": [1]}, ["y"], opset=5)
    said = refusal(model, tmp_path)
    assert said.startswith(f"{tmp_path / 'model.onnx'}: cannot be read (")
    assert said.endswith("opset 5 is converted to 17 first: export it in 17")


def added(*nodes, **fixed):
    """y = x + the sum of r, which the nodes make of constants."""
    rest = [
        helper.make_node("ReduceSum", ["r"], ["q"], keepdims=0),
        helper.make_node("Cast", ["q"], ["p"], to=TensorProto.FLOAT),
        helper.make_node("Add", ["x", "p"], ["y"]),
    ]
    return built([*nodes, *rest], {"x": [3]}, ["y"], fixed)


def looped():
    body = helper.make_graph(
        [helper.make_node("Identity", ["k"], ["go"]), helper.make_node("Add", ["a", "a"], ["b"])],
        "body",
        [helper.make_tensor_value_info(n, t, s) for n, t, s in (("j", 7, []), ("k", 9, []), ("a", 1, [3]))],
        [helper.make_tensor_value_info(n, t, s) for n, t, s in (("go", 9, []), ("b", 1, [3]))],
    )
    node = helper.make_node("Loop", ["m", "t", "s"], ["r"], body=body)
    return added(node, m=np.array(2**62), t=np.array(True), s=f(3))


def doubling(op, **options):
    return [helper.make_node(op, [f"a{k}"] * 8, [f"a{k + 1}"], **options) for k in range(60)]


def calling():
    """60 functions, each of which calls the next one twice."""
    opsets = [helper.make_opsetid("", 18), helper.make_opsetid("my", 1)]
    functions = [helper.make_function("my", "F0", ["x"], ["y"], [helper.make_node("Tanh", ["x"], ["y"])], opsets)]
    for k in range(1, 60):
        twice = [helper.make_node(f"F{k - 1}", [a], [b], domain="my") for a, b in (("x", "t"), ("t", "y"))]
        functions.append(helper.make_function("my", f"F{k}", ["x"], ["y"], twice, opsets))
    call = helper.make_node("F59", ["x"], ["y"], domain="my")
    return built([call], {"x": [3]}, ["y"], functions=functions, domains=["my"])


BOMBS = {  # model -> what is said
    "Loop": (looped, "operation Loop: it runs more than 500 times"),
    "ConstantOfShape": (
        lambda: added(helper.make_node("ConstantOfShape", ["n"], ["r"]), n=i(20000, 20000)),
        "operation ConstantOfShape: its result has 400000000 numbers; all together may have 4194304",
    ),
    "Range": (
        lambda: added(helper.make_node("Range", [*"abc"], ["r"]), a=np.array(0), b=np.array(2**40), c=np.array(1)),
        "operation Range: its result has 1099511627776 numbers",
    ),
    "Range by nothing": (
        lambda: added(helper.make_node("Range", [*"abc"], ["r"]), a=np.array(0), b=np.array(1), c=np.array(0)),
        "operation Range: its constants cannot be folded",
    ),
    "Expand": (
        lambda: added(helper.make_node("Expand", ["a", "n"], ["r"]), a=f(1), n=i(20000, 20000)),
        "operation Expand: its result has 400000000 numbers",
    ),
    "Expand of a signal": (
        lambda: added(
            helper.make_node("Expand", ["x", "n"], ["s"]),
            helper.make_node("ReduceSum", ["s"], ["r"]),
            n=i(20000, 1000, 3),
        ),
        "operation Expand: its result has 240000000 weights; at most 4194304 are taken",
    ),
    "Tile": (
        lambda: added(helper.make_node("Tile", ["a", "n"], ["r"]), a=f(1, 1), n=i(20000, 20000)),
        "operation Tile: its result has 400000000 numbers",
    ),
    "Pad": (
        lambda: added(helper.make_node("Pad", ["a", "n"], ["r"]), a=f(1), n=i(2**30, 2**30)),
        "operation Pad: its result has 2147483649 numbers",
    ),
    "MatMul": (
        lambda: added(helper.make_node("MatMul", ["a", "b"], ["r"]), a=f(9000, 1), b=f(1, 9000)),
        "operation MatMul: its result has 81000000 numbers",
    ),
    "Gather": (
        lambda: added(helper.make_node("Gather", ["a", "n"], ["r"]), a=f(9000), n=np.zeros(9000, np.int64)),
        "operation Gather: its result has 81000000 numbers",
    ),
    "Concat": (
        lambda: added(*doubling("Concat", axis=0), helper.make_node("Identity", ["a60"], ["r"]), a0=f(4)),
        "operation Concat: its result has",
    ),
    "nothing along an axis": (
        lambda: added(helper.make_node("Identity", ["a"], ["r"]), a=np.zeros((2**40, 0), np.float32)),
        "tensor 'a' has 1099511627776 numbers; at most 4194304 are read",
    ),
    "functions": (calling, "576460752303423488 operations; at most 1000 are read"),
    "nodes": (
        lambda: built([helper.make_node("Tanh", ["x"], [f"y{k}"]) for k in range(1001)], {"x": [3]}, ["y0"]),
        "1001 operations; at most 1000 are read",
    ),
    "ports": (lambda: one("Tanh", [1, 10**9], opset=18), "x has 1000000000 numbers; a network has at most 4096 a step"),
    "samples": (lambda: one("Tanh", [10**9, 3], opset=18), "holds 1000000000 samples along its axis 0"),
}  # fmt: skip


@pytest.mark.parametrize("bomb", BOMBS)
def test_a_small_model_that_would_grow_is_refused_with_the_limit(bomb, tmp_path):
    model, why = BOMBS[bomb]
    model = model()
    assert model.ByteSize() < 200_000
    assert why in refusal(model, tmp_path)


def test_a_file_of_many_empty_nodes_is_refused_before_it_is_read(tmp_path, monkeypatch):
    nodes = b"\x0a\x00" * (1 << 20)
    (tmp_path / "m.onnx").write_bytes(b"\x08\x09\x3a\x80\x80\x80\x01" + nodes)
    monkeypatch.setattr(onnx_file, "FIELDS", 1000)
    monkeypatch.setattr(onnx, "load_model_from_string", lambda data: pytest.fail("it was read"))
    with pytest.raises(InputError, match="has more than 1000 parts"):
        from_onnx(tmp_path / "m.onnx")


def test_an_opset_that_is_not_known_is_refused(tmp_path):
    model = one("Tanh", [3], opset=18)
    model.opset_import[0].version = 99
    assert "opset 99" in refusal(model, tmp_path)


# -- what is left out ------------------------------------------------------------------------------------------------


def classifier(folder, **options):
    """(file of a classifier of scikit-learn, its samples, its probabilities)."""
    skl2onnx = pytest.importorskip("skl2onnx")
    from sklearn.linear_model import LogisticRegression
    from sklearn.neural_network import MLPClassifier

    x = np.random.default_rng(0).normal(size=(200, 3)).astype(np.float32)
    kind = np.array(["low", "mid", "high"])[(x @ [1, 2, 3] > 0).astype(int) + (x[:, 0] > 1)]
    for name, model in (("mlp", MLPClassifier((5,), tol=1.0)), ("linear", LogisticRegression())):
        made = skl2onnx.to_onnx(model.fit(x, kind), x[:1], options={"zipmap": options["zipmap"]})
        (folder / f"{name}.onnx").write_bytes(made.SerializeToString())
        yield folder / f"{name}.onnx", x, model.predict_proba(x), kind


@pytest.mark.parametrize("zipmap", [False, True])
def test_a_classifier_gives_its_probabilities_and_the_class_is_left_out_with_a_word(zipmap, tmp_path, capfd):
    for file, x, wanted, _ in classifier(tmp_path, zipmap=zipmap):
        network = from_onnx(file)
        got = network.run({p.name: x[:, k].astype(float) for k, p in enumerate(network.inputs)})
        found = np.column_stack([got[p.name] for p in network.outputs])
        assert np.abs(found - wanted).max() < 1e-6
        told = beside(imported(file), file, {p.name: x[:, k].astype(float) for k, p in enumerate(network.inputs)})
        assert (told.steps, told.largest < 1e-6) == (len(x), True)
        assert "label holds whole numbers or words and is left out" in capfd.readouterr().err


def test_operations_that_no_output_depends_on_are_not_asked_for(tmp_path):
    nodes = [helper.make_node("Round", ["x"], ["r"]), helper.make_node("Tanh", ["x"], ["y"])]
    right(built(nodes, {"x": [1, 3]}, ["y"]), tmp_path)
