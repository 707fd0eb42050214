import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import delay_line, random_inputs, random_network
from scipy.special import ndtr

from greygate.errors import InputError
from greygate.models.activations import ACTIVATIONS
from greygate.models.network import Layer, Network, Port

SMOOTH = ("tansig", "logsig", "linear", "radbas", "select")


def test_delays_initial_values_and_normalisation_are_those_worked_by_hand():
    u = np.array([3.0, 1.0, 5.0])  # inside: 1, 0, 2; before: (5 - 1) / 2 = 2
    s0 = 1 + 0.5 * 2 + 0.25 * 0.2 + 0.1
    s1 = 0 + 0.5 * 2 + 0.25 * s0 + 0.1
    s2 = 2 + 0.5 * 1 + 0.25 * s1 + 0.1
    np.testing.assert_allclose(delay_line().run({"u": u})["y"], 10 * np.array([s0, s1, s2]), rtol=1e-15)


def test_before_step_0_every_input_and_layer_is_at_rest_normalised():
    rest = delay_line().flatten().rest()
    assert {name: value.tolist() for name, value in rest.items()} == {"u": [2.0], "sum": [0.2]}


def test_initial_values_can_be_given_for_a_run():
    y = delay_line().run({"u": np.array([3.0])}, initial={"u": 1.0, "sum": 4.0})["y"]
    np.testing.assert_allclose(y, [10 * (1 + 0 + 1.0 + 0.1)], rtol=1e-15)


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_every_activation_is_its_definition(name):
    n = np.array([-3.0, -0.5, 0.0, 0.25, 2.0, -1.0])
    by_hand = {
        "tansig": 2 / (1 + np.exp(-2 * n)) - 1,
        "logsig": 1 / (1 + np.exp(-n)),
        "linear": n,
        "hardlim": [0, 0, 1, 1, 1, 0],
        "hardlims": [-1, -1, 1, 1, 1, -1],
        "satlin": [0, 0, 0, 0.25, 1, 0],
        "radbas": np.exp(-(n**2)),
        "square": n**2,
        "negexp": np.exp(-np.abs(n)),
        "softsign": n / (1 + np.abs(n)),
        "softfall": np.log1p(np.exp(-np.abs(n))),
        "normal": ndtr(n),
        "select": [2.0, -1.0],  # -3 and -0.5 choose between 0 or 2, and 0.25 or -1
        "product": [-0.75, -1.0, 0.0],
        "rsqrt": [3**-0.5, 2**0.5, 1e45, 2.0, 2**-0.5, 1.0],  # at 0 the root of 1e-90
        "root": np.sqrt(np.abs(n)),
        "turn": [-1.0, -0.5, 0.0, 0.25, 0.0, -1.0],
        "sine": np.sin(np.pi * n),
        "arctan": np.arctan(n) * 2 / np.pi,
        "ln": np.log(np.maximum(np.abs(n), 1e-90)),
    }
    np.testing.assert_allclose(ACTIVATIONS[name].value(np, n), by_hand[name], atol=1e-15)


@settings(max_examples=40)
@given(st.integers(0, 10**9))
def test_numpy_and_torch_agree_step_by_step_in_sequence_and_in_batch(seed):
    network = random_network(seed)
    inputs = random_inputs(network, 12, seed)
    want = network.run(inputs)
    tensors = {n: torch.tensor(v) for n, v in network.flatten().parameters().items()}
    torched = network.run(inputs, parameters=tensors)
    batch = network.run({n: np.stack([v, v]) for n, v in inputs.items()})
    for name, y in want.items():
        np.testing.assert_allclose(torched[name].numpy(), y, rtol=0, atol=1e-12)
        np.testing.assert_allclose(batch[name][1], y, rtol=0, atol=1e-12)


@settings(max_examples=40)
@given(st.integers(0, 10**9))
def test_a_flat_network_is_the_same_network_and_flattening_it_changes_nothing(seed):
    network = random_network(seed)
    inputs = random_inputs(network, 10, seed)
    flat = network.flatten()
    assert all(isinstance(m, Layer) for m in flat.modules.values())
    for name, y in network.run(inputs).items():
        np.testing.assert_array_equal(flat.run(inputs)[name], y)


@settings(max_examples=25)
@given(st.integers(0, 10**9))
def test_a_saved_network_comes_back_the_same(tmp_path_factory, seed):
    network = random_network(seed)
    path = tmp_path_factory.mktemp("saved") / "network"
    network.save(path)
    inputs = random_inputs(network, 6, seed)
    again = Network.load(path).run(inputs)
    for name, y in network.run(inputs).items():
        np.testing.assert_array_equal(again[name], y)
    assert sorted(p.name for p in path.parent.iterdir()) == ["network.safetensors", "network.toml"]


def broken(change) -> Network:
    network = delay_line()
    change(network)
    return network


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda n: n.connect("sum", "sum.now"), "loop without delay through sum -> sum"),
        (lambda n: n.connect("sum", "sum.elsewhere", 1), "module sum has no such port"),
        (lambda n: n.connect("ghost", "sum.now"), "neither a module nor a port"),
        (lambda n: n.connect("u", "sum.now", -1), "delay -1 is not a whole number"),
        (lambda n: n.connect("u", "sum.now", gain=np.ones((2, 1))), "1 signals into 1 with a gain of"),
        (lambda n: n.connect("u", "sum.now", gain=np.nan), "gain holds NaN or inf"),
        (lambda n: n.add("wide", Layer({"in": np.ones((2, 3))}, [0.0, 0.0])), "port wide.in receives nothing"),
        (lambda n: n.add("odd", Layer({}, [0.0], "sigmoid")), "unknown activation 'sigmoid'"),
        (lambda n: n.add("nan", Layer({}, [np.nan])), "layer nan: bias holds NaN or inf"),
        (lambda n: n.add("inf", Layer({"in": [[np.inf]]}, [0.0])), "layer inf: in holds NaN or inf"),
        (lambda n: n.add("rows", Layer({"in": np.ones((3, 1))}, [0.0])), "in has 3 rows where the layer has 1"),
        (lambda n: n.add("a__b", Layer({}, [0.0])), "use letters, digits and single underscores"),
        (lambda n: n.add("cold", Layer({}, [0.0], frozen={"x"})), "cannot freeze x"),
        (lambda n: n.outputs.append(Port("z")), "output z receives nothing"),
        (lambda n: n.inputs.append(Port("w", scale=0.0)), "scale not 0"),
    ],
)
def test_a_wrong_declaration_is_named(change, message):
    with pytest.raises(InputError, match=message):
        broken(change).check()


def test_two_modules_cannot_share_a_name():
    with pytest.raises(InputError, match="used twice"):
        delay_line().add("sum", Layer({}, [0.0]))


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        ({}, "input u .* is missing"),
        ({"u": [1.0, np.nan]}, "input u: holds NaN or inf"),
        ({"u": np.ones(0)}, "not zero"),
    ],
)
def test_wrong_inputs_are_named(inputs, message):
    with pytest.raises(InputError, match=message):
        delay_line().run(inputs)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda p: p.with_suffix(".toml").unlink(), "no such file"),
        (lambda p: p.with_suffix(".safetensors").unlink(), "no such file"),
        (lambda p: p.with_suffix(".safetensors").write_bytes(b"\x00" * 20), "not a readable network"),
        (lambda p: p.with_suffix(".toml").write_text("name = "), "is not TOML"),
        (lambda p: p.with_suffix(".toml").write_text('name = "x"'), "inputs is missing; add it"),
        (lambda p: _edit(p, "rows = 1", "rows = 2"), "should have shape"),
        (lambda p: _edit(p, "own = 1", "mine = 1"), "should have shape"),
        (lambda p: _edit(p, 'activation = "linear"', 'activation = "relu"'), "unknown activation"),
        (lambda p: _edit(p, "delay = 1", "delay = 0"), "loop without delay"),
        (lambda p: _edit(p, "delay = 1", 'delay = "1"'), r"delay '1' is not a whole number"),
        (lambda p: _edit(p, "delay = 1", "delay = nan"), "is not a whole number"),
        (lambda p: _edit(p, "delay = 1", "delay = 2000"), "<= 500"),
        (lambda p: _edit(p, "scale = 2.0", 'scale = "2"'), r"inputs\[0\].scale '2' is not a finite number"),
        (lambda p: _edit(p, "resolution = 0.0", "resolution = -1.0"), "resolution must be finite"),
    ],
)
def test_a_spoilt_file_is_named(tmp_path, spoil, message):
    path = tmp_path / "network"
    delay_line().save(path)
    spoil(path)
    with pytest.raises(InputError, match=message):
        Network.load(path)


def _edit(path, old, new):
    toml = path.with_suffix(".toml")
    assert old in toml.read_text()
    toml.write_text(toml.read_text().replace(old, new))


def test_a_folder_that_cannot_be_written_leaves_nothing_behind(tmp_path):
    with pytest.raises(InputError, match="cannot write here"):
        delay_line().save(tmp_path / "missing" / "network")
    assert not list(tmp_path.iterdir())
