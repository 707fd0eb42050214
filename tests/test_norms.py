"""Softmax, norms and divisions: as their own tool answers, and in fixed point, of any logits and spreads."""

from dataclasses import replace

import numpy as np
import onnxruntime
import pytest
import torch
from imported_models import each, free_run, signal
from onnx import helper
from onnx_cases import built
from torch import nn
from torch.nn import functional as F

from greygate.compiler.centre import centre_biases
from greygate.compiler.pipeline import compile_network, fixed_error
from greygate.compiler.quantize import Formats
from greygate.emulator.emulation import emulate
from greygate.emulator.engine import run
from greygate.emulator.numbers import Overflow
from greygate.emulator.program import Affine
from greygate.errors import InputError
from greygate.hardware.verify import Case, Scenario, verify_many
from greygate.models.importers import norms
from greygate.models.importers.builder import Builder, constant
from greygate.models.importers.onnx_graph import from_onnx
from greygate.models.importers.pytorch import from_torch
from greygate.models.training.record import Record

N = 6
STEPS = 600
WIDE = 60.0  # of logits: e^60 is beyond what any format holds


class Behind(nn.Module):
    """A function of the sums of a linear layer."""

    def __init__(self, function, gain=1.0):
        super().__init__()
        torch.manual_seed(4)
        self.first, self.function, self.gain = nn.Linear(3, N), function, gain

    def forward(self, x):
        return self.function(self.gain * self.first(x))


class Attending(nn.Module):
    """Attention of this step to the last five."""

    def __init__(self, whole=False):
        super().__init__()
        torch.manual_seed(5)
        self.inner, self.q, self.k, self.v = nn.Linear(3, 4), nn.Linear(4, 4), nn.Linear(4, 4), nn.Linear(4, N)
        self.layer = nn.TransformerEncoderLayer(4, 2, 8, batch_first=True) if whole else None
        self.register_buffer("past", torch.randn(5, 4))

    def forward(self, x):
        self.past = torch.cat([self.past[1:], self.inner(x)[None]])
        past = self.past if self.layer is None else self.layer(self.past[None])[0]
        scores = self.q(past[-1]) @ self.k(past).T / 2
        return torch.softmax(scores, -1) @ self.v(past)


MASK = torch.tensor([True, False, False, True, False, False])
CARRIED = {
    "softmax": nn.Softmax(-1),
    "softmin": nn.Softmin(-1),
    "log softmax": nn.LogSoftmax(-1),
    "logsumexp": lambda y: y * torch.logsumexp(y, -1),
    "logaddexp": lambda y: torch.logaddexp(y, -y),
    "masked": lambda y: torch.softmax(y.masked_fill(MASK, float("-inf")), -1),
    "written out": lambda y: torch.exp(y) / torch.exp(y).sum(),
    "less the largest": lambda y: torch.exp(y - y.max()) / torch.exp(y - y.max()).sum(),
    "bell": lambda y: torch.exp(-y * y),
    "layer norm": nn.LayerNorm(N),
    "rms norm": nn.RMSNorm(N),
    "group norm": lambda y: F.group_norm(y.reshape(1, N), 2, y.new_ones(N), torch.arange(N, dtype=y.dtype) / 7).reshape(
        N
    ),
    "instance norm": lambda y: F.instance_norm(y.reshape(1, 2, 3)).reshape(N),
    "standardized": lambda y: (y - y.mean()) / (y.std() + 1e-3),
    "by variance": lambda y: (y - y.mean()) * torch.rsqrt(y.var(unbiased=False) + 1e-3),
    "unit length": lambda y: F.normalize(y, dim=-1),
    "cosine": lambda y: y * F.cosine_similarity(y[:3], y[3:], dim=0),
    "length": lambda y: y * torch.norm(y),
    "hypot": lambda y: torch.sqrt(y[:3] ** 2 + y[3:] ** 2).repeat(2),
    "rational": lambda y: y / (1 + y * y),
    "powers": lambda y: y ** torch.tensor([0, 1, 2, 5, 7, 16]) + (1 + y * y) ** -3 + (2 + torch.tanh(y)) ** 0.5,
    "negative divisor": lambda y: y / (-1 - torch.abs(y)),
    "shares": lambda y: torch.sigmoid(y) / torch.sigmoid(y).sum(),
    "sine and cosine": lambda y: torch.cat([torch.sin(3 * y[:3]), torch.cos(y[3:])]),
    "angles": lambda y: torch.cat([torch.atan(5 * y[:3]), torch.atan2(y[:3], y[3:])]),
    "logarithms": lambda y: torch.log1p(y.abs()) + torch.log2(1 + y * y) + torch.log10(2 + torch.tanh(y)),
    "arcs": lambda y: torch.asin(torch.tanh(y)) + torch.acos(y.clamp(-0.5, 1.0)) + torch.asinh(3 * y),
    "hyperbolic": lambda y: torch.sinh(y) + torch.cosh(y / 2) + torch.tan(torch.tanh(y)),
    "whole turns": lambda y: torch.remainder(3 * y, 2.0) + torch.floor(5 * y) - torch.ceil(y / 3),
    "in order": lambda y: torch.cat(
        [y.sort()[0][:2], y.topk(2)[0], y.median()[None], y.reshape(2, 3).median(1)[0][:1]]
    ),
    "divisor of any sign": lambda y: y / (y + 0.3) + 1 / y,
    "no numbers": lambda y: torch.nan_to_num(y),
    "roots of roots": lambda y: y.abs() ** torch.tensor([1.5, 0.25, 2.875, 0.3, -0.5, -1.5]).double(),
    "quaternion": lambda y: y / y.norm(),
    "distances": lambda y: torch.cdist(y.reshape(2, 3), torch.ones(3, 3, dtype=y.dtype)).ravel(),
    "places": lambda y: torch.stack([y.argmax(), y.argmin(), y[:3].argmax(), *y.reshape(2, 3).argmax(0)]).float(),
    "masked attention": lambda y: F.scaled_dot_product_attention(*(y.reshape(1, 3, 2),) * 3, is_causal=True).ravel(),
}


@pytest.mark.parametrize("name", CARRIED)
def test_what_divides_by_a_signal_is_carried_to_the_rounding_of_float64(name):
    network = from_torch(Behind(CARRIED[name]), ["a", "b", "c"], [f"y{k}" for k in range(N)])
    x = signal(50, 3)
    wanted = each(Behind(CARRIED[name]).double())(x)
    assert np.abs(free_run(network, x) - wanted).max() <= 1e-13 * np.abs(wanted).max()


def test_the_angle_of_nothing_is_0():
    class Angle(torch.nn.Module):
        def forward(self, x):
            return torch.atan2(x[:, :1], x[:, 1:])

    network = from_torch(Angle(), ["a", "b"], ["y"])
    for b, wanted in ((0.0, 0.0), (1.0, 0.0), (-1.0, np.pi)):
        assert network.run({"a": np.zeros(2), "b": np.full(2, b)})["y"][0] == pytest.approx(wanted, abs=1e-15)


@pytest.mark.parametrize("whole", [False, True])
def test_attention_to_the_last_steps_is_carried_and_its_error_in_fixed_point_is_small(whole):
    network = from_torch(Attending(whole), ["a", "b", "c"], [f"y{k}" for k in range(N)])
    _, _, error, wanted = fixed(network)
    assert np.abs(error).max() < 1e-3 * np.ptp(wanted)


def fixed(network, width=16):
    """(program, record, error, what float gives) of a run of signals."""
    x = signal(STEPS, len(network.inputs))
    given = {p.name: x[:, k] for k, p in enumerate(network.inputs)}
    record = Record(given, network.run(given))
    program = compile_network(network, {"run": record}, Formats(width)).program
    error = fixed_error(program, record)
    return program, record, *(np.column_stack([d[p.name] for p in network.outputs]) for d in (error, record.targets))


def test_the_sine_of_an_angle_of_many_turns_keeps_its_digits():
    network = from_torch(Behind(lambda y: torch.sin(200 * y)), ["a", "b", "c"], [f"y{k}" for k in range(N)])
    program, record, error, _ = fixed(network)
    assert np.abs(error).max() < 0.01  # 16 bits of an input are 5e-3 rad of an angle of 300
    assert [o.overflow for o in program.operations if o.out.name.endswith(".n")] == ["wrap"]
    answer = emulate(program, record.inputs)
    assert answer.saturations == {}


@pytest.mark.parametrize("gain", [1.0, WIDE])
def test_a_softmax_of_any_logits_overflows_nowhere_and_names_the_same_class(gain):
    network = from_torch(Behind(nn.Softmax(-1), gain), ["a", "b", "c"], [f"y{k}" for k in range(N)])
    _, _, error, wanted = fixed(network)
    clear = np.diff(np.sort(wanted, 1)[:, -2:], axis=1)[:, 0] > 0.01
    assert clear.sum() > STEPS / 2
    assert ((wanted + error).argmax(1) == wanted.argmax(1))[clear].all()
    assert np.abs(error).max() < (1e-3 if gain == 1.0 else 0.05)


@pytest.mark.parametrize("norm", [nn.LayerNorm(N), nn.RMSNorm(N)])
def test_a_norm_keeps_its_digits_in_fixed_point(norm):
    _, _, error, wanted = fixed(from_torch(Behind(norm), ["a", "b", "c"], [f"y{k}" for k in range(N)]))
    assert np.abs(error).max() < 2e-3 * np.ptp(wanted)


def test_a_norm_of_two_numbers_that_are_now_and_then_nearly_equal_keeps_its_digits():
    network = from_torch(Behind(lambda y: F.layer_norm(y[:2], (2,))), ["a", "b", "c"], ["y0", "y1"])
    _, _, error, wanted = fixed(network)
    assert np.abs(error).max() < 5e-3 * np.ptp(wanted)


def test_a_spread_of_more_octaves_than_the_format_has_is_refused_with_what_to_do():
    norm = Behind(lambda y: F.layer_norm(y * torch.relu(y[:1]), (N,), eps=1e-10))
    network = from_torch(norm, ["a", "b", "c"], [f"y{k}" for k in range(N)])
    with pytest.raises(
        InputError,
        match=r"divided by it or its root, .* and it goes from .*; 20 bits hold 16 octaves\. Limit",
    ):
        fixed(network, 12)


def exact(function, gain=1.0):
    """(compiled, record, error) of a function of one number, on codes that every format holds."""
    x = gain * np.arange(-400, 600) / 1024
    network = from_torch(Plain(function), ["x"], ["y"])
    record = Record({"x": x}, network.run({"x": x}))
    compiled = compile_network(network, {"run": record}, Formats(16))
    return compiled, record, fixed_error(compiled.program, record)["y"]


class Plain(nn.Module):
    def __init__(self, function):
        super().__init__()
        self.function = function

    def forward(self, x):
        return self.function(x)


def test_the_weights_of_an_angle_have_bits_for_its_whole_turns():
    _, _, error = exact(lambda x: torch.sin(300 * x))
    assert np.abs(error).max() < 2e-4


def test_whole_turns_are_no_error_that_a_bias_mends():
    compiled, record, _ = exact(lambda x: torch.sin(300 * x))
    before = compiled.program
    after = centre_biases(before, compiled.network, [record])
    moved = [abs(b.bias - a.bias) * 2.0 ** -a.frac for a, b in zip(before.operations, after.operations, strict=True)
             if isinstance(a, Affine) and a.overflow is Overflow.WRAP]  # fmt: skip
    assert np.concatenate(moved).max() < 1e-3


def test_what_is_left_of_whole_periods_errs_by_a_code_but_where_it_jumps():
    _, record, error = exact(lambda x: torch.remainder(9 * x, 0.7))
    calm = np.abs(record.targets["y"] - 0.35) < 0.34
    assert calm.sum() > 800
    assert np.abs(error[calm]).max() < 1e-3


def test_a_root_of_what_reaches_0_is_compiled_and_a_logarithm_of_it_is_refused():
    _, _, error = exact(lambda x: torch.sqrt(torch.relu(x)))
    assert np.abs(error).max() < 1e-3
    with pytest.raises(InputError, match="its logarithm is taken, and it goes from 0"):
        exact(lambda x: torch.log(x.abs()))


def angles(y):
    return torch.cat(
        [torch.sin(30 * y[:2]), torch.atan(y[2:3]), torch.remainder(9 * y[3:4], 2), torch.log1p(y[4:].abs())]
    )


IN_HARDWARE = (
    (nn.Softmax(-1), ("pipelined",)),
    (nn.LayerNorm(N), ("folded",)),
    (angles, ("parallel", "serial")),
)
OTHERS = (nn.LayerNorm(N), ("parallel", "serial")), (angles, ("pipelined", "folded"))


@pytest.mark.parametrize("functions", [IN_HARDWARE, pytest.param(OTHERS, marks=pytest.mark.nightly)])
def test_the_hardware_of_softmax_norms_and_angles_is_that_of_the_emulator_in_every_bit(functions, tmp_path):
    cases = []
    for k, (function, architectures) in enumerate(functions):
        network = from_torch(Behind(function), ["a", "b", "c"], [f"y{j}" for j in range(N)], name=f"norm_{k}")
        program, record, _, _ = fixed(network)
        codes = program.encode(record.inputs)[:40]
        answers = run(program, codes)
        for architecture in architectures:
            cases.append(
                Case(
                    replace(program, name=f"{program.name}_{architecture}"),
                    {"run": Scenario(codes, answers.outputs, answers.states)},
                    architecture,
                )
            )
    assert [v for v in verify_many(cases, tmp_path, seed=1).verdicts if v.mismatch] == []


ONNX = {
    "Softmax": {}, "LogSoftmax": {"axis": 1}, "LpNormalization": {},
    "ReduceL2": {"keepdims": 0}, "ReduceLogSumExp": {"keepdims": 0}, "Exp": {}, "LayerNormalization": {},
    "RMSNormalization": {"epsilon": 1e-3},
}  # fmt: skip


@pytest.mark.parametrize("op", ONNX)
def test_what_onnx_has_of_them_is_carried(op, tmp_path):
    given = ["x", "gain"] if op.endswith("yerNormalization") or op.startswith("RMS") else ["x"]
    opset = 23 if op.startswith("RMS") else 18
    gain = {"gain": np.arange(1, 6, dtype=np.float32)} if len(given) > 1 else {}
    model = built([helper.make_node(op, given, ["y"], **ONNX[op])], {"x": [1, 5]}, ["y"], gain, opset=opset)
    (tmp_path / "m.onnx").write_bytes(model.SerializeToString())
    assert len(from_onnx(tmp_path / "m.onnx").inputs) == 5  # which compares it with ONNX's reference


def by_mean_of_squares(x, axes):
    """A variance as Keras writes it, and what is normalised by it."""
    return [
        helper.make_node("ReduceMean", [x, axes], ["m"]), helper.make_node("Mul", [x, x], ["s"]),
        helper.make_node("ReduceMean", ["s", axes], ["e"]), helper.make_node("Mul", ["m", "m"], ["k"]),
        helper.make_node("Sub", ["e", "k"], ["v"]), helper.make_node("Add", ["v", "eps"], ["w"]),
        helper.make_node("Sqrt", ["w"], ["r"]), helper.make_node("Sub", [x, "m"], ["d"]),
        helper.make_node("Div", ["d", "r"], ["y"]),
    ]  # fmt: skip


def by_limited_root(x, axes):
    """Unit length as Keras writes it."""
    return [
        helper.make_node("Mul", [x, x], ["s"]), helper.make_node("ReduceSum", ["s", axes], ["e"]),
        helper.make_node("Sqrt", ["e"], ["r"]), helper.make_node("Div", ["one", "r"], ["i"]),
        helper.make_node("Cast", ["i"], ["c"], to=1), helper.make_node("Min", ["c", "most"], ["l"]),
        helper.make_node("Mul", [x, "l"], ["y"]),
    ]  # fmt: skip


@pytest.mark.parametrize("of", [by_mean_of_squares, by_limited_root])
def test_norms_as_keras_writes_them_out_are_carried_and_keep_their_digits(of, tmp_path):
    fixed_of = {"axes": np.array([-1]), "eps": np.float32(1e-3), "one": np.float32(1), "most": np.float32(1e3)}
    model = built(of("x", "axes"), {"x": [1, 4]}, ["y"], fixed_of, opset=18)
    (tmp_path / "m.onnx").write_bytes(model.SerializeToString())
    network = from_onnx(tmp_path / "m.onnx")
    session = onnxruntime.InferenceSession(str(tmp_path / "m.onnx"))
    x = np.vstack([0.5 + signal(50, 4), np.zeros((1, 4))]).astype(np.float32)
    wanted = np.vstack([session.run(None, {"x": row[None]})[0] for row in x])
    assert np.abs(free_run(network, x) - wanted).max() < 1e-4
    record = Record({p.name: v for p, v in zip(network.inputs, x[:-1].T, strict=True)}, {})
    record = replace(record, targets=network.run(record.inputs))
    error = fixed_error(compile_network(network, {"run": record}, Formats(16)).program, record)
    assert max(np.abs(e).max() / np.ptp(record.targets[n]) for n, e in error.items()) < 0.01


@pytest.mark.parametrize("end", ["shown", "read"])
def test_a_root_that_others_see_stays_as_it_is(end, tmp_path):
    nodes = [*by_limited_root("x", "axes"), helper.make_node("Mul", ["r", "r"], ["q"])]
    fixed_of = {"axes": np.array([-1]), "one": np.float32(1), "most": np.float32(1e3)}
    model = built(nodes, {"x": [1, 4]}, ["y", "r" if end == "shown" else "q"], fixed_of, opset=18)
    (tmp_path / "m.onnx").write_bytes(model.SerializeToString())
    network = from_onnx(tmp_path / "m.onnx")  # which compares it with ONNX's reference
    assert free_run(network, np.zeros((1, 4))).tolist() == [[0.0] * 5]


def test_bounds_are_those_of_squares_limits_and_what_is_never_0():
    builder = Builder("n", ["u"], ["y"])
    u = builder.input(builder.inputs, (1,))
    square, limited = builder.power(u, 2), builder.clipped(u, 0.25, None)
    bounds = {
        "square": builder.ends(square.plus(constant(0.5)))[0],
        "negative": -builder.ends(builder.product(u, u.times(-2.0)))[1],
        "limited": builder.ends(limited)[0],
        "rectified": builder.ends(builder.rectified(u))[0],
        "root": builder.ends(norms.root(builder, square.plus(constant(4.0))))[0],
    }
    assert {n: float(v[0]) for n, v in bounds.items()} == {
        "square": 0.5, "negative": 0.0, "limited": 0.25, "rectified": 0.0, "root": 2.0
    }  # fmt: skip
    assert builder.ends(u)[0] == -np.inf
    assert 0 < builder.ends(builder.activated(u, "logsig", "gate"))[0] < 1e-9
