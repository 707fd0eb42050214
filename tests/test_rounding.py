"""Weights rounded jointly: few digits, and the network still does the same."""

import numpy as np
import pytest
from networks import delay_line

from greygate.compiler.pipeline import compile_network
from greygate.compiler.quantize import Formats
from greygate.compiler.rounding import BITS, prices, round_jointly, signed_digits
from greygate.emulator.program import Affine
from greygate.errors import InputError
from greygate.models.arithmetic import gram, inverse
from greygate.models.network import Layer, Network, Port
from greygate.models.training.record import Record

STAGES = 6


@pytest.fixture(scope="module")
def network():
    """Six neurons in a loop, with weights as training leaves them."""
    rng = np.random.default_rng(5)
    made = Network("loop", [Port("u", "V")], [Port("y", "m")])
    made.add(
        "hidden", Layer({"u": rng.normal(size=(6, 1)), "y": rng.normal(size=(6, 1)) / 3}, rng.normal(size=6), "tansig")
    )
    made.add("out", Layer({"hidden": rng.normal(size=(1, 6)) / 4}, [0.05]))
    made.connect("u", "hidden.u")
    made.connect("out", "hidden.y", delay=1)
    made.connect("hidden", "out.hidden")
    made.connect("out", "y")
    return made


@pytest.fixture(scope="module")
def record(network):
    inputs = {"u": np.sin(np.arange(800) ** 1.3 / 30)}
    return Record(inputs, network.run(inputs))


def weights(network):
    return np.concatenate(
        [w.ravel() for name, w in network.flatten().parameters().items() if not name.endswith("bias")]
    )


def error(network, record):
    return float(np.sqrt(np.mean((network.run(record.inputs)["y"] - record.targets["y"]) ** 2)))


@pytest.mark.parametrize(("code", "digits"), [(0, 0), (1, 1), (-8, 1), (7, 2), (11, 3), (-0b101010101, 5), (255, 2)])
def test_the_signed_digits_of_an_integer_are_counted(code, digits):
    assert signed_digits(code) == digits


def test_joint_rounding_is_far_more_accurate_than_rounding_each_weight_to_as_many_digits(network, record):
    rounded = round_jointly(network, [record], 1e-7, stages=STAGES)
    digits = rounded.digits / len(weights(rounded.network))

    def alone(value, count):
        total = 0.0
        for _ in range(count):
            rest = value - total
            if rest:
                total += np.copysign(2.0 ** np.round(np.log2(abs(rest))), rest)
        return total

    values = {
        n: w if n.endswith("bias") else np.vectorize(lambda v: alone(v, round(digits)))(w)
        for n, w in network.flatten().parameters().items()
    }
    each = network.flatten().with_parameters(values)
    assert error(rounded.network, record) < error(each, record) / 5
    assert rounded.error == pytest.approx(error(rounded.network, record) / np.sqrt(np.mean(record.targets["y"] ** 2)))


def test_a_dear_digit_leaves_fewer_of_them_and_a_larger_error(network, record):
    cheap, dear = (round_jointly(network, [record], p, stages=STAGES) for p in (1e-9, 1e-5))
    assert dear.digits < cheap.digits
    assert dear.error > cheap.error


def test_the_digits_are_those_of_the_weights_and_the_quantizer_keeps_them(network, record):
    rounded = round_jointly(network, [record], 1e-7, stages=STAGES)
    program = compile_network(rounded.network, {"training": record}, Formats(16)).program
    layers = [o for o in program.operations if isinstance(o, Affine)]
    assert sum(signed_digits(int(w)) for o in layers for w in o.weights.ravel()) == rounded.digits
    flat = rounded.network.flatten()
    for o in layers:
        name = o.out.name.removesuffix(".n")
        kept = np.concatenate([flat.layers()[name].weights[p] for p in flat.layers()[name].weights], axis=1)
        fracs = np.concatenate([[program.signals[a].fix.frac] * program.signals[a].size for a in o.args])
        assert np.array_equal(o.weights * 2.0 ** (fracs[None] - o.frac[:, None]), kept)


def test_weights_of_one_digit_stay():
    network = delay_line()
    inputs = {"u": np.sin(np.arange(200) / 7.0)}
    rounded = round_jointly(network, [Record(inputs, network.run(inputs))], 1e-9, stages=STAGES)
    assert rounded.digits == 3
    assert rounded.error < 1e-15  # the bias is free, and rounds in its last bit


def test_neurons_that_nothing_reads_are_removed(network, record):
    values = network.flatten().parameters()
    out = values["out.hidden"].copy()
    out[0, 2] = 0.0
    idle = network.flatten().with_parameters({"out.hidden": out})
    rounded = round_jointly(idle, [Record(record.inputs, idle.run(record.inputs))], 1e-9, stages=STAGES)
    assert rounded.network.layers()["hidden"].size == 5


def test_rounding_is_a_function_of_its_inputs(network, record):
    first, second = (round_jointly(network, [record], 1e-7, stages=STAGES).network.flatten() for _ in range(2))
    for name, value in first.parameters().items():
        assert np.array_equal(value, second.parameters()[name])


def test_no_record_and_a_network_that_diverges_are_refused(network, record):
    with pytest.raises(InputError, match="no record to round"):
        round_jointly(network, [], 1e-7)
    wild = delay_line().flatten().with_parameters({"sum.own": np.array([[1e3]])})
    with pytest.raises(InputError, match="diverges on a record"):
        round_jointly(wild, [Record({"u": np.ones(400)}, {"y": np.ones(400)})], 1e-7)


def test_the_ladder_begins_with_the_most_accurate():
    assert prices() == sorted(prices())
    assert BITS >= 8


def test_portable_algebra_is_algebra():
    a = np.random.default_rng(1).normal(size=(13, 5))
    assert np.allclose(gram(a), a.T @ a, rtol=1e-14, atol=0)
    assert np.allclose(inverse(gram(a)) @ gram(a), np.eye(5), atol=1e-12)
    assert np.isnan(inverse(-np.eye(3))).all()
