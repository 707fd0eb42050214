"""A QONNX model becomes a program that gives every bit of QONNX's own executor."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import onnxruntime
import pytest
from command_line import greygate
from onnx import helper
from onnx_cases import built

from greygate.compiler.declared import declared_program
from greygate.emulator.emulation import emulate
from greygate.emulator.engine import run
from greygate.errors import InputError
from greygate.hardware.build import Project
from greygate.hardware.verify import Case, Scenario, verify_many
from greygate.machines.source import Source
from greygate.models.importers.files import load_quantized
from greygate.models.importers.onnx_reference import answer
from greygate.plants.recording import Recording
from greygate.project import compile_project

N = 400
"""Samples: the batch of a model, of which one step of a network is one."""


class Model:
    """A QONNX model under construction: every constant is a power of two, if nothing else is asked for."""

    def __init__(self, seed=0):
        self.rng, self.nodes, self.fixed = np.random.default_rng(seed), [], []

    def constant(self, values):
        from onnx import numpy_helper

        self.fixed.append(numpy_helper.from_array(np.asarray(values, np.float32), f"c{len(self.fixed)}"))
        return self.fixed[-1].name

    def node(self, kind, *given, **options):
        name = f"{kind}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, [*given], [f"{name}_out"], name=name, **options))
        return f"{name}_out"

    def quant(self, x, scale, bits, kind="Quant", zero=0.0, signed=1, narrow=0, mode="ROUND"):
        given = x, *(self.constant(v) for v in (scale, zero, bits))
        options = {"signed": signed, "narrow": narrow, "rounding_mode": mode}
        return self.node(kind, *given, **options, domain="qonnx.custom_op.general")

    def layer(self, x, n, m, scale=2.0**-5, bits=6):
        """x @ W + b of quantized constants; each column of W has a scale of its own."""
        scales = scale * 2.0 ** self.rng.integers(-1, 2, (1, m))
        w = self.quant(self.constant(self.rng.normal(size=(n, m)) / 2), scales, bits, narrow=1)
        b = self.quant(self.constant(self.rng.normal(size=(1, m)) / 2), 2.0**-8, 8, mode="FLOOR")
        return self.node("Add", self.node("MatMul", x, w), b)

    def saved(self, path, y, inputs=3, outputs=2):
        from onnx import TensorProto

        ports = [
            [helper.make_tensor_value_info(n, TensorProto.FLOAT, [N, c])] for n, c in (("x", inputs), (y, outputs))
        ]
        graph = helper.make_graph(self.nodes, "quantized", *ports, self.fixed)
        domains = [helper.make_opsetid("", 17), helper.make_opsetid("qonnx.custom_op.general", 1)]
        made = helper.make_model(graph, opset_imports=domains, ir_version=9)
        path.write_bytes(made.SerializeToString())
        return path


def rectified(m, **first):
    x = m.quant("x", 2.0**-5, 8, **first)
    h = m.quant(m.node("Relu", m.layer(x, 3, 6)), 2.0**-4, 5, signed=0)
    h = m.quant(m.node("Relu", m.layer(h, 6, 5)), 2.0**-4, 4, narrow=1)
    return m.quant(m.layer(h, 5, 2), 2.0**-6, 8, mode="FLOOR")


def curved(m, kind, bits=8, scale=2.0**-6):
    n = m.quant(m.layer(m.quant("x", 2.0**-5, 8), 3, 6), 2.0**-4, bits)
    return m.layer(m.quant(m.node(kind, n), scale, 7, signed=int(kind == "Tanh")), 6, 2)


def gemm(m):
    x = m.quant("x", 2.0**-2, 5, signed=0)
    w = m.quant(m.constant(m.rng.normal(size=(2, 3))), 2.0**-3, 5, kind="IntQuant")
    return m.node("Gemm", x, w, m.constant(np.array([0.25, -0.5])), transB=1, alpha=2.0)


def linked(m):
    """Two roads that meet, and a Quant of a sum, without any function."""
    x = m.quant("x", 2.0**-5, 8, narrow=1)
    h = m.quant(m.layer(x, 3, 3), 2.0**-3, 4)
    return m.layer(m.node("Sub", h, m.node("Mul", x, m.constant(0.5))), 3, 2)


def binary(m):
    """Weights of one bit, and an input that no Quant reads."""
    w = m.node("BipolarQuant", m.constant(m.rng.normal(size=(3, 4))), m.constant(0.5), domain="qonnx.custom_op.general")
    v = m.quant(m.constant(m.rng.normal(size=(4, 2))), 0.25, 1)
    h = m.quant(m.node("Relu", m.node("MatMul", "x", w)), 2.0**-4, 6, signed=0)
    return m.node("MatMul", h, v)


def bipolar(m):
    """Signals of one bit, by both nodes that say so, and limits between other roads."""
    x = m.quant("x", 2.0**-5, 8)
    h = m.node("BipolarQuant", m.layer(x, 3, 6), m.constant(0.5), domain="qonnx.custom_op.general")
    h = m.node("Add", h, m.quant(m.layer(h, 6, 6), 2.0, 1))
    return m.layer(m.node("Clip", h, m.constant(-1.25), m.constant(2.0)), 6, 2)


def limited(m):
    """Limits of codes and of a sum, LeakyRelu, Max and Min."""
    x = m.node("Clip", m.quant("x", 2.0**-5, 8), m.constant(-0.5), m.constant(2.0))
    h = m.node("Clip", m.layer(x, 3, 6), m.constant(-0.3125), m.constant(1.5))
    h = m.node("LeakyRelu", h, alpha=0.25)
    h = m.quant(m.node("Max", h, m.node("Min", m.layer(x, 3, 6), m.constant(0.5))), 2.0**-6, 8)
    return m.node("Clip", m.layer(h, 6, 2), m.constant(-0.5))


def shifted(m):
    """Zero points of signals and of weights."""
    x = m.quant("x", 2.0**-5, 8, zero=6.0, signed=0)
    w = m.quant(m.constant(m.rng.normal(size=(3, 2))), 2.0**-5, 6, zero=3.0)
    return m.quant(m.node("MatMul", x, w), 2.0**-4, 8, zero=-21.0)


CARRIED = {
    "relu": rectified,
    "relu, unsigned input": lambda m: rectified(m, signed=0),
    "tanh": lambda m: curved(m, "Tanh"),
    "sigmoid": lambda m: curved(m, "Sigmoid"),
    "gemm": gemm,
    "two roads": linked,
    "one bit": bipolar,
    "limits": limited,
    "zero points": shifted,
}


def executed(path, x):
    """What QONNX's own executor answers."""
    pytest.importorskip("qonnx", reason="qonnx is not installed; pip install 'greygate[dev]'")
    from qonnx.core.modelwrapper import ModelWrapper
    from qonnx.core.onnx_exec import execute_onnx
    from qonnx.transformation.infer_shapes import InferShapes

    (found,) = execute_onnx(ModelWrapper(str(path)).transform(InferShapes()), {"x": x}).values()
    return found


@pytest.mark.parametrize("model", CARRIED)
@pytest.mark.parametrize("seed", [0, 1])
def test_the_program_gives_every_bit_of_the_executor_of_qonnx(model, seed, tmp_path):
    m = Model(seed)
    path = m.saved(tmp_path / "model.onnx", CARRIED[model](m))
    x = (np.random.default_rng(9).normal(size=(N, 3)) * 2).astype(np.float32)  # beyond the format of the input, too
    quantized = load_quantized(path)
    assert not quantized.real
    expected, program = executed(path, x), declared_program(quantized)
    codes = program.encode({p.name: x[:, k] for k, p in enumerate(program.inputs)})
    answer = program.decode(run(program, codes, states=False).outputs)
    found = np.stack([answer[p.name] for p in program.outputs], 1)
    assert len(np.unique(expected)) > 10, "it does something"
    assert np.array_equal(found, expected)


def test_a_qonnx_model_is_compiled_and_emulated_as_any_network(tmp_path):
    m = Model()
    path = m.saved(tmp_path / "model.onnx", curved(m, "Tanh"))
    path.with_suffix(".ports.toml").write_text('inputs = ["u [V]", "x [m]", "f [N]"]\noutputs = ["p [Pa]", "q [m]"]\n')
    x = np.random.default_rng(9).normal(size=(N, 3)).astype(np.float32)
    columns = dict(zip("uxfpq", [*x.T, np.zeros(N), np.zeros(N)], strict=True))
    Recording(1e-3, columns, dict(zip("uxfpq", ["V", "m", "N", "Pa", "m"], strict=True))).write_csv(tmp_path / "r.csv")
    source = Source(str(path), {"r": str(tmp_path / "r.csv")})
    compile_project(source, tmp_path / "build", architectures=("folded",))
    project = Project.open(tmp_path / "build")
    found = emulate(project.program, project.inputs("r")[0]).outputs
    assert np.array_equal(np.stack([found["p"], found["q"]], 1), executed(path, x))
    code, _, err = greygate("compile", path, tmp_path / "r.csv", "--out", tmp_path / "b", "--width", "12")
    assert code == 2
    assert "Quant nodes fix every weight and format; leave out the width" in err
    assert not (tmp_path / "b").exists()


LINEAR = {  # type of the codes, their zero points, a scale
    "uint8": (np.uint8, 128, 2.0**-5),
    "uint8 above": (np.uint8, 7, 2.0**-6),
    "int8": (np.int8, 0, 2.0**-5),
    "int8 below": (np.int8, -100, 2.0**-5),
    "int16": (np.int16, 12, 2.0**-8),
}


def linear(name, path):
    """A model of QuantizeLinear and DequantizeLinear."""
    kind, zero, scale = LINEAR[name]
    rng = np.random.default_rng(3)
    fixed = {
        "s": np.float32(scale), "z": kind(zero), "w": rng.integers(-20, 20, (3, 2)).astype(np.int8),
        "ws": np.float32(0.125), "wz": np.int8(3), "t": np.float32(2 * scale),
    }  # fmt: skip
    nodes = [
        helper.make_node("QuantizeLinear", ["x", "s", "z"], ["q"]),
        helper.make_node("DequantizeLinear", ["q", "s", "z"], ["d"]),
        helper.make_node("DequantizeLinear", ["w", "ws", "wz"], ["m"]),
        helper.make_node("MatMul", ["d", "m"], ["n"]),
        helper.make_node("Relu", ["n"], ["r"]),
        helper.make_node("QuantizeLinear", ["r", "t", "z"], ["p"]),
        helper.make_node("DequantizeLinear", ["p", "t", "z"], ["y"]),
    ]
    path.write_bytes(built(nodes, {"x": ["N", 3]}, ["y"], fixed, 21).SerializeToString())
    return path


@pytest.mark.parametrize("name", LINEAR)
def test_zero_points_of_signals_give_every_bit_of_onnxruntime(name, tmp_path):
    path, scale = linear(name, tmp_path / "model.onnx"), LINEAR[name][2]
    x = (np.random.default_rng(4).normal(size=(N, 3)) * 3).astype(np.float32)
    x[(x / scale) % 1 == 0.5] += np.float32(scale / 8)  # midway between two codes the host goes up
    (expected,) = onnxruntime.InferenceSession(str(path)).run(None, {"x": x})
    program = declared_program(load_quantized(path))
    answer = program.decode(
        run(program, program.encode({f"x_{k + 1}": x[:, k] for k in range(3)}), states=False).outputs
    )
    assert len(np.unique(expected)) > 10, "it does something"
    assert np.array_equal(np.stack([answer["y_1"], answer["y_2"]], 1), expected)


@pytest.mark.parametrize("model", [*CARRIED, "weights alone", *LINEAR])
def test_the_line_of_trust_compares_the_program_with_a_model_that_rounds(model, tmp_path, monkeypatch):
    m, path = Model(4), tmp_path / "model.onnx"
    if model in LINEAR:
        linear(model, path)
    else:
        m.saved(path, CARRIED.get(model, lambda m: m.layer("x", 3, 2))(m))
    x = np.random.default_rng(9).normal(size=(N, 3)) * 2
    names = ["x_1", "x_2", "x_3", *(p.name for p in load_quantized(path).network.outputs)]
    columns = dict(zip(names, [*x.T, np.zeros(N), np.zeros(N)], strict=True))
    Recording(1e-3, columns, dict.fromkeys(columns, "1")).write_csv(tmp_path / "r.csv")
    source = Source(str(path), {"r": str(tmp_path / "r.csv")})
    assert (source.imported.largest, source.imported.steps, source.imported.why) == (0.0, N, "")
    if model in LINEAR:  # where onnxruntime is not installed
        monkeypatch.setattr("greygate.models.importers.beside.find_spec", lambda name: None)
        alone = Source(str(path), {"r": str(tmp_path / "r.csv")}).imported
        assert (alone.program, alone.largest, alone.steps) == ("ONNX's reference", 0.0, N)
    if model in CARRIED and model not in ("gemm", "one bit"):  # which round nothing but their input
        monkeypatch.setattr("greygate.models.importers.beside.answer", lambda *given: answer(*given[:3]))
        worse = Source(str(path), {"r": str(tmp_path / "r.csv")}).imported
        assert worse.largest > 1e-3, "a program that does not answer as the model is seen"


def test_a_model_that_has_no_program_is_no_less_a_network(tmp_path):
    m = Model()
    path = m.saved(tmp_path / "model.onnx", REFUSED["input x_1: is rounded to the nearest code"](m), outputs=3)
    ports = load_quantized(path).network
    columns = {p.name: np.ones(N) for p in (*ports.inputs, *ports.outputs)}
    Recording(1e-3, columns, dict.fromkeys(columns, "1")).write_csv(tmp_path / "r.csv")
    source = Source(str(path), {"r": str(tmp_path / "r.csv")})
    assert len(source.records()["r"].inputs["x_1"]) == N
    assert "there is no program (input x_1: is rounded to the nearest code" in source.imported.why


def scaled(m):
    """Scales of any size: of an input, of each column of the weights, of what is hidden, of the output."""
    h = m.quant("x", 0.021, 8)
    for n, s in ((6, 0.037), (5, 0.051)):
        w = m.quant(m.constant(m.rng.normal(size=(3 if n == 6 else 6, n)) / 2), m.rng.uniform(0.004, 0.01, (1, n)), 8)
        h = m.quant(
            m.node("Relu", m.node("Add", m.node("MatMul", h, w), m.constant(m.rng.normal(size=n)))), s, 8, signed=0
        )
    return m.quant(m.node("MatMul", h, m.constant(m.rng.normal(size=(5, 2)))), 0.043, 8)


def answered(path, x):
    """(what the program of a model answers, the scales of its outputs)."""
    program = declared_program(load_quantized(path))
    found = run(program, program.encode({p.name: x[:, k] for k, p in enumerate(program.inputs)}), states=False).outputs
    answer = program.decode(found)
    return np.stack([answer[p.name] for p in program.outputs], 1), [p.scale for p in program.outputs]


def test_scales_that_are_no_powers_of_two_give_every_code(tmp_path, capfd):
    m = Model(3)
    path = m.saved(tmp_path / "scaled.onnx", scaled(m))
    x = np.random.default_rng(9).normal(size=(N, 3)).astype(np.float32)
    found, scales = answered(path, x)
    codes, wanted = found / scales, executed(path, x) / scales
    assert np.abs(codes - wanted).max() < 1e-3
    assert len(np.unique(np.round(wanted))) > 20
    assert "no program equals it in every bit (its scales are no powers of two)" in capfd.readouterr().err


@pytest.mark.parametrize("curve", ["Tanh", "Sigmoid"])
def test_a_curve_between_such_scales_gives_every_code_that_is_no_near_tie(curve, tmp_path):
    m = Model(3)
    weights = (m.quant(m.constant(m.rng.normal(size=s) / 2), 0.0083, 8) for s in ((3, 16), (16, 2)))
    h = m.node(curve, m.node("MatMul", m.quant("x", 0.021, 8), next(weights)))
    path = m.saved(tmp_path / "model.onnx", m.node("MatMul", m.quant(h, 0.019, 7), next(weights)))
    x = np.random.default_rng(9).normal(size=(N, 3)).astype(np.float32)
    apart = np.abs(answered(path, x)[0] - executed(path, x)).max(1)
    assert (apart > 1e-4).mean() < 0.02
    assert apart.max() < 1.2 * 0.019 * 127 * 0.0083


def static(folder, x, each, signed, bits=8, **extra):
    """A network of three layers as onnxruntime's quantize_static leaves it, in QDQ format."""
    from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

    rng = np.random.default_rng(1)
    sizes, nodes, fixed, last = (3, 8, 6, 2), [], {}, "x"
    for k, (n, o) in enumerate(pairwise(sizes)):
        fixed |= {f"w{k}": rng.normal(size=(n, o)).astype(np.float32), f"b{k}": rng.normal(size=o).astype(np.float32)}
        nodes.append(helper.make_node("Gemm", [last, f"w{k}", f"b{k}"], [f"g{k}"], name=f"gemm{k}"))
        last = "y" if o == sizes[-1] else f"r{k}"
        nodes.append(helper.make_node("Identity" if last == "y" else "Relu", [f"g{k}"], [last], name=f"act{k}"))

    class Reader(CalibrationDataReader):
        left = iter([{"x": x}])

        def get_next(self):
            return next(self.left, None)

    (folder / "float.onnx").write_bytes(built(nodes, {"x": ["N", 3]}, ["y"], fixed, 17).SerializeToString())
    kind, file = getattr(QuantType, f"Q{'' if signed else 'U'}Int{bits}"), folder / f"q{each:d}{signed:d}.onnx"
    options = {"activation_type": kind, "weight_type": QuantType.QInt8, "per_channel": each, "extra_options": extra}
    quantize_static(folder / "float.onnx", file, Reader(), QuantFormat.QDQ, **options)
    return file


def unmoved(file, x):
    """What the file says, in no kernel of the optimizer: those of 8 bits saturate on a processor without VNNI."""
    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    return onnxruntime.InferenceSession(str(file), options).run(None, {"x": x})[0]


@pytest.mark.parametrize("each", [False, True])
@pytest.mark.parametrize("signed", [False, True])
def test_a_static_quantization_of_onnxruntime_gives_every_code_of_it(each, signed, tmp_path):
    x = np.random.default_rng(7).normal(size=(N, 3)).astype(np.float32)
    file = static(tmp_path, x, each, signed)
    expected = unmoved(file, x)
    found, scales = answered(file, x)
    assert np.abs(found - expected).max() < 1e-3 * max(scales)
    assert len(np.unique(expected)) > 20


def test_a_static_quantization_to_16_bits_in_the_domain_of_onnxruntime_is_read(tmp_path):
    """Its optimizer moves such codes by hundreds, so what runs beside the network is not optimized."""
    x = np.random.default_rng(7).normal(size=(N, 3)).astype(np.float32)
    file = static(tmp_path, x, True, False, 16, UseQDQContribOps=True)
    expected = unmoved(file, x)
    found, scales = answered(file, x)
    assert np.abs(found - expected).max() < 2 * max(scales)
    columns = {f"x_{k + 1}": x[:, k].astype(float) for k in range(3)}
    Recording(1e-3, columns, dict.fromkeys(columns, "1")).write_csv(tmp_path / "run.csv")
    beside = Source(str(file), {"run": str(tmp_path / "run.csv")}).imported
    assert (beside.why, beside.largest < 1e-4) == ("", True)


@pytest.mark.nightly
def test_the_hardware_of_models_that_round_is_that_of_the_emulator_in_every_bit(tmp_path):
    x = np.random.default_rng(7).normal(size=(N, 3)).astype(np.float32)
    files = [static(tmp_path, x, each, signed) for each in (False, True) for signed in (False, True)]
    files += [linear(name, tmp_path / f"{name}.onnx") for name in ("uint8 above", "int8 below")]
    for k, of in enumerate((rectified, CARRIED["tanh"], scaled, binary, bipolar, limited, shifted, unrounded)):
        model = Model(k)
        files.append(model.saved(tmp_path / f"m{k}.onnx", of(model)))
    cases = []
    for k, file in enumerate(files):
        program = replace(
            declared_program(load_quantized(file), reach={f"x_{j}": 9.0 for j in (1, 2, 3)}), name=f"m{k}"
        )
        codes = program.encode({p.name: x[:40, j] for j, p in enumerate(program.inputs)})
        answers = run(program, codes)
        for architecture in ("parallel", "folded"):
            named = replace(program, name=f"m{k}_{architecture}")
            cases.append(Case(named, {"run": Scenario(codes, answers.outputs, answers.states)}, architecture))
    assert [v for v in verify_many(cases, tmp_path / "v", seed=1).verdicts if v.mismatch] == []


def test_weights_of_one_bit_and_an_input_without_quant_are_carried(tmp_path, capfd):
    m = Model()
    path = m.saved(tmp_path / "model.onnx", binary(m))
    x = np.random.default_rng(9).integers(-1000, 1000, (N, 3)).astype(np.float32) / 256
    expected = executed(path, x)
    ports = load_quantized(path).network
    names = [p.name for p in (*ports.inputs, *ports.outputs)]
    Recording(1e-3, dict(zip(names, [*x.T, *expected.T], strict=True)), dict.fromkeys(names, "1")).write_csv(
        tmp_path / "r.csv"
    )
    compile_project(Source(str(path), {"r": str(tmp_path / "r.csv")}), tmp_path / "build", architectures=("folded",))
    assert "input x_1: no Quant reads it; Fix(16, 13) by the recording" in capfd.readouterr().err
    project = Project.open(tmp_path / "build")
    found = emulate(project.program, project.inputs("r")[0]).outputs
    assert np.array_equal(np.stack([found[n] for n in names[3:]], 1), expected)


def behind(operation):
    """An operation behind the first Quant."""
    return lambda m: operation(m, m.quant("x", 2.0**-5, 8))


REFUSED = {  # what is said -> the model's output
    "its scale is -0.3; give it a positive one": lambda m: m.quant("x", -0.3, 8),
    "rounding_mode 'CEIL'; the hardware has ROUND and FLOOR": lambda m: m.quant("x", 0.5, 8, mode="CEIL"),
    "zero point 0.5; give a signal one whole": lambda m: m.quant("x", 0.5, 8, zero=0.5),
    "a zero point of one bit": lambda m: m.quant("x", 0.5, 1, zero=1.0),
    "its codes are finer than the 16 bits of Tanh_1; give it fewer bits": (
        lambda m: m.quant(m.node("Tanh", m.quant("x", 0.03, 8)), 2.0**-19, 21)
    ),
    "bit width 0; give one whole number from 1 to 24": lambda m: m.quant("x", 0.5, 0),
    "bit width 4.5": lambda m: m.quant("x", 0.5, 4.5),
    "input x_1: is rounded to the nearest code": lambda m: m.quant("x", 0.5, 8, mode="FLOOR"),
    "input x_1: its format would be a guess": lambda m: m.quant(m.node("Relu", "x"), 0.5, 8),
    "Mul_1: beside Quant nodes": behind(lambda m, x: m.node("Mul", x, x)),
}


@pytest.mark.parametrize("why", REFUSED)
def test_what_a_format_cannot_express_is_refused_with_what_to_do(why, tmp_path):
    m = Model()
    path = m.saved(tmp_path / "model.onnx", REFUSED[why](m), outputs=3)
    with pytest.raises(InputError, match=why):
        declared_program(load_quantized(path))


@pytest.mark.parametrize("kind", ["Softmax", "LogSoftmax", "Softmax Identity Flatten"])
def test_a_softmax_at_the_end_of_a_quantized_classifier_is_left_out_with_a_word(kind, tmp_path, capfd):
    m = Model()
    shown = rectified(m)
    kind, *after = kind.split()
    for operation in (kind, *after):
        shown = m.node(operation, shown)
    file = m.saved(tmp_path / "m.onnx", shown)
    x = m.rng.normal(size=(N, 3)).astype(np.float32)
    program = declared_program(load_quantized(file))
    codes = run(program, program.encode({p.name: x[:, k] for k, p in enumerate(program.inputs)})).outputs
    assert (codes.argmax(1) == executed(file, x).argmax(1)).all()
    assert f"{kind} at the end is left out" in capfd.readouterr().err


def unrounded(m):
    """A bias that no Quant rounds."""
    w = m.quant(m.constant(m.rng.normal(size=(3, 3))), 2.0**-6, 8)
    h = m.node("Add", m.node("MatMul", m.quant("x", 2.0**-5, 8), w), m.constant(m.rng.normal(size=3)))
    return m.quant(h, 2.0**-6, 8)


INEXACT = {  # what is said -> the model's output, and by how much it may be another
    "its scales are no powers of two": (lambda m: m.quant("x", [[0.5, 0.25, 0.3]], 8), 0.0),
    "a weight or a bias is on no grid": (behind(lambda m, x: m.node("Mul", x, m.constant(1e-30))), 0.0),
    "needs 25 bits, more than the 24 that float32 holds": (
        behind(lambda m, x: m.node("Mul", x, m.constant(1 + 2**-17))), 0.0,
    ),
    "put a Quant directly behind it": (behind(lambda m, x: m.node("Tanh", x)), 2.0**-15),
    "ROUND and a scale of 1/2 or less": (behind(lambda m, x: m.quant(m.node("Tanh", x), 1.0, 2)), 0.0),
    "its argument has 15 bits, a table at most 13": (
        lambda m: m.quant(m.node("Tanh", m.quant("x", 1.0, 15)), 0.5, 4), 0.0,
    ),
    "lies between two codes, where float32": (
        lambda m: m.quant(m.node("Tanh", m.quant("x", 2.0**-9, 12)), 2.0**-14, 16), 2.0**-14,
    ),
    "needs 30 bits, more than the 24": (unrounded, 0.0),
}  # fmt: skip


@pytest.mark.parametrize("why", INEXACT)
def test_a_model_that_no_program_equals_in_every_bit_is_as_near_as_float32_and_a_line_says_why(why, tmp_path, capfd):
    (make, most), m = INEXACT[why], Model()
    path = m.saved(tmp_path / "inexact.onnx", make(m), outputs=3)
    x = np.random.default_rng(9).normal(size=(N, 3)).astype(np.float32)
    expected = executed(path, x)
    ports = [p.name for p in load_quantized(path).network.inputs]
    program = declared_program(load_quantized(path), reach=dict.fromkeys(ports, 4.0))
    assert why in capfd.readouterr().err
    answer = program.decode(run(program, program.encode(dict(zip(ports, x.T, strict=True))), states=False).outputs)
    found = np.stack([answer[p.name] for p in program.outputs], 1)
    assert len(np.unique(expected)) > 2, "it does something"
    assert np.abs(found - expected).max() <= most + 2.0**-24 * np.abs(expected).max()
