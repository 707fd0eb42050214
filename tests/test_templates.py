import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.thesis.recurrent import frnn
from benchmarks.thesis.templates import TEMPLATES, template
from greygate.errors import InputError
from greygate.models.families.recurrent import elman
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import train
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record

X, Y = Port("x", scale=2.0), Port("y", scale=4.0, offset=1.0, initial=2.0)
WITH_PAST = [n for n in TEMPLATES if n != 1]


def build(number, seed=3):
    """On x(k-1), x(k-2), y(k-1), y(k-2), with linear coefficients that are not zero."""
    network = template(number, "t", {X: (1, 2)}, Y, (1, 2) if number in WITH_PAST else (), (3,), (2,), seed)
    if "sum" in network.modules:
        linear = {n: [[0.3]] for n in network.parameters() if n.startswith("sum.") and "_z" in n}
        network = network.with_parameters({n: np.array(w) for n, w in linear.items()})
    return network


def by_table(number, network, x, y):
    """Table 3.2 as it is printed, one step, from past x and y (newest first, normalised)."""
    taps = {f"x_z{d}": v for d, v in enumerate(x, 1)} | {f"y_z{d}": v for d, v in enumerate(y, 1)}

    def call(part, **extra):
        module = network.modules[part]
        given = taps | extra
        return module.run({p.name: np.array([given[p.name]]) for p in module.inputs})["y"][0]

    alpha_y, beta_x = 0.3 * sum(y), 0.3 * sum(x)
    return {
        1: lambda: call("f"),
        2: lambda: call("f"),
        3: lambda: call("g") + call("f"),
        4: lambda: call("g") + beta_x,
        5: lambda: alpha_y + call("f"),
        6: lambda: call("g", f=call("f")),
        7: lambda: call("g", f=call("f")),
        8: lambda: call("g", f=call("f")) + beta_x,
    }[number]()


@pytest.mark.parametrize("number", TEMPLATES)
def test_a_template_is_its_row_of_table_3_2(number):
    network = build(number)
    x = np.random.default_rng(0).normal(size=20)
    y = network.run({"x": x})["y"]
    inside_x, inside_y = np.r_[0, 0, x] / 2, (np.r_[2, 2, y] - 1) / 4
    for k in range(2, 22):
        want = by_table(number, network, inside_x[[k - 1, k - 2]], inside_y[[k - 1, k - 2]])
        assert inside_y[k] == pytest.approx(want, abs=1e-13)


@pytest.mark.parametrize("number", TEMPLATES)
def test_f_and_g_read_what_table_3_2_gives_them(number):
    x, y, f = {"x_z1", "x_z2"}, {"y_z1", "y_z2"}, {"f"}
    want = {
        1: {"f": x},
        2: {"f": x | y},
        3: {"g": y, "f": x},
        4: {"g": y},
        5: {"f": x},
        6: {"g": y | f, "f": x},
        7: {"g": y | f, "f": x | y},
        8: {"g": y | f, "f": x | y},
    }[number]
    found = {n: {p.name for p in m.inputs} for n, m in build(number).modules.items() if isinstance(m, Network)}
    assert found == want


@pytest.mark.parametrize("number", TEMPLATES)
def test_a_teacher_stands_in_every_feedback_of_a_template(number):
    x, y = np.random.default_rng(1).normal(size=(2, 20))
    network = build(number)
    objective = Objective(network, [Record({"x": x}, {"y": y})], teacher=True)
    inside_x, inside_y = np.r_[0, 0, x] / 2, (np.r_[2, 2, y] - 1) / 4
    want = [by_table(number, network, inside_x[[k - 1, k - 2]], inside_y[[k - 1, k - 2]]) for k in range(2, 22)]
    np.testing.assert_allclose(objective.errors(objective.theta)[0][:, 0] + inside_y[2:], want, atol=1e-13)


def test_f_stays_as_it_is_while_g_learns():
    network = build(6)
    x = np.random.default_rng(0).normal(size=200)
    record = Record({"x": x}, build(6, seed=8).run({"x": x}))
    held = {n: np.zeros(w.shape, bool) for n, w in network.parameters().items() if n.startswith("f.")}
    fit = train(network, [record], epochs=20, free=held)
    assert fit.history[-1] < 0.1 * fit.history[0]
    for name, value in network.parameters().items():
        assert np.array_equal(fit.network.parameters()[name], value) == name.startswith("f."), name


@pytest.mark.parametrize(
    ("number", "inputs", "feedback", "message"),
    [
        (9, {X: (1,)}, (1,), "no template 9; table 3.2 has 1 to 8"),
        (1, {X: (1,)}, (1,), "type 1 has no feedback taps"),
        (4, {X: (1,)}, (), "type 4 needs feedback taps"),
        (2, {X: (1,)}, (0,), "of y from 1 on"),
        (2, {X: (-1,)}, (1,), "taps of x from 0 on"),
    ],
)
def test_a_template_that_cannot_be_is_refused(number, inputs, feedback, message):
    with pytest.raises(InputError, match=message):
        template(number, "t", inputs, Y, feedback)


def test_a_vector_port_is_refused_and_told_what_takes_it():
    with pytest.raises(InputError, match="template ports are scalars, y is not"):
        template(2, "t", {X: (1,)}, Port("y", size=2), (1,))


def test_elman_is_its_equation():
    network = elman("e", {X: (0, 1)}, [Y], (3,), seed=2)
    p = network.parameters()
    x = np.random.default_rng(0).normal(size=15)
    h, past, want = np.zeros(3), 0.0, []
    for now in x / 2:
        read = p["hidden1.x_z0"][:, 0] * now + p["hidden1.x_z1"][:, 0] * past
        h = np.tanh(read + p["hidden1.hidden1_past"] @ h + p["hidden1.bias"])
        want.append(1 + 4 * (p["y_layer.hidden1"][0] @ h + p["y_layer.bias"][0]))
        past = now
    np.testing.assert_allclose(network.run({"x": x})["y"], want, atol=1e-13)


def test_in_a_fully_recurrent_network_every_layer_reads_the_past_of_every_layer():
    network = frnn("f", {X: (0,)}, [Y], (3, 2))
    past = {"hidden1_past", "hidden2_past", "y_layer_past"}
    layers = network.layers()
    assert {n: layer.weights.keys() - past for n, layer in layers.items()} == {
        "hidden1": {"x_z0"},
        "hidden2": {"hidden1"},
        "y_layer": {"hidden2"},
    }
    assert all(past <= layer.weights.keys() for layer in layers.values())
    assert {c.delay for c in network.connections if c.target.endswith("_past")} == {1}


@pytest.mark.parametrize("build", [elman, frnn])
def test_recurrent_networks_learn_a_system_with_memory(build):
    x = np.random.default_rng(0).uniform(-1, 1, 300)
    y = lfilter([1.0], [1.0, -0.7], np.tanh(x))
    fit = train(build("n", {Port("x"): (0,)}, [Port("y", scale=2.0)], (4,), seed=4), [Record({"x": x}, {"y": y})])
    objective = Objective(fit.network, [Record({"x": x}, {"y": y})])
    assert np.std(2 * objective.errors(objective.theta)[0]) < 0.01 * np.std(y)


def test_a_recurrent_network_without_neurons_is_refused():
    with pytest.raises(InputError, match="give hidden neurons"):
        elman("e", {X: (0,)}, [Y], ())
