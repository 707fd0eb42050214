"""Pruning by entropy: which neurons go, when a round is undone, and where their means go."""

import numpy as np
import pytest

from greygate.compiler.pipeline import compile_network, entropy_pruning
from greygate.models.accuracy import float_error
from greygate.models.families.blocks import feedforward, flow_record
from greygate.models.families.regression import noe
from greygate.models.network import Port
from greygate.models.prune import entropies, prune_by_entropy, remove_neurons
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record


def test_entropy_pruning_removes_neurons_that_do_nothing_and_keeps_the_error():
    part = train(feedforward("f", ["u", "p"], [6], 1), [flow_record()], epochs=40).network
    parameters = part.parameters()
    network = feedforward("f", ["u", "p"], [8], 1).with_parameters(
        {
            "hidden1.u": np.r_[parameters["hidden1.u"], [[1e-3], [1e-3]]],
            "hidden1.p": np.r_[parameters["hidden1.p"], [[0.0], [0.0]]],
            "hidden1.bias": np.r_[parameters["hidden1.bias"], 0.5, -0.3],
            "out.hidden1": np.c_[parameters["out.hidden1"], 2.0, -1.0],
            "out.bias": parameters["out.bias"] - 2.0 * np.tanh(0.5) + np.tanh(-0.3),
        }
    )
    record = flow_record()
    idle = entropies(network, [record])["hidden1"][6:]
    assert (idle < 1.0).all()

    def retrain(n):
        return train(n, [record], epochs=10).network

    compiled = compile_network(network, {"grid": record}, prune=entropy_pruning([record], retrain, 1.05))
    assert compiled.pruning[0].kept
    assert {6, 7} <= set(compiled.pruning[0].removed["hidden1"])
    assert not compiled.pruning[-1].kept  # it went on until the error threshold was missed, and undid that
    assert compiled.network.modules["hidden1"].size == compiled.pruning[-2].neurons
    before, after = (np.std(float_error(n, record)["y"]) for n in (network, compiled.network))
    assert after <= 1.05 * before


def test_a_round_whose_network_diverges_on_the_records_is_undone_even_if_the_held_out_ones_are_too_short_to_show_it():
    network = noe("lag", {Port("u"): (0,)}, Port("y"), (1,), hidden=(3,), linear_loop=True)
    (loop,) = [name for name, w in network.parameters().items() if name.endswith(".y_z1") and w.shape == (1, 1)]
    network, wild = (network.with_parameters({loop: np.array([[pole]])}) for pole in (0.5, 2e3))
    inputs = {"u": np.sin(np.arange(400.0))}
    record = Record(inputs, network.run(inputs))

    def retrain(trial):
        return trial.with_parameters({loop: wild.parameters()[loop]})

    held = record.cut(0, 2)
    found, rounds = prune_by_entropy(network, [record], retrain, np.array([np.inf]), held=[held])
    assert found is network
    assert not any(r.kept for r in rounds)


@pytest.mark.parametrize(("tries", "left"), [(1, 3), (2, 2)])
def test_where_the_neuron_of_lowest_entropy_may_not_go_the_next_one_is_tried(tries, left):
    network = feedforward("f", ["u"], [3], 1).with_parameters(
        {
            "hidden1.u": np.array([[0.2], [0.5], [1.0]]),  # entropy rises from one to the next
            "hidden1.bias": np.zeros(3),
            "out.hidden1": np.array([[9.0, 0.0, 1.0]]),  # nothing reads the second
            "out.bias": np.zeros(1),
        }
    )
    inputs = {"u": np.linspace(-1, 1, 400)}
    record = Record(inputs, network.run(inputs))
    rest = {"low": 0.0, "onto_others": False, "tries": tries}
    smaller, rounds = prune_by_entropy(network, [record], lambda n: n, np.array([1e-6]), **rest)
    assert smaller.neurons() == left
    assert rounds[0].removed == {"hidden1": [0]}
    assert [r.kept for r in rounds] == [False, True, False, False][: len(rounds)]
    assert len(rounds) == (1 if tries == 1 else 4)


def test_the_mean_of_a_removed_neuron_goes_into_the_biases_it_fed():
    network = feedforward("f", ["u", "p"], [4], 2)
    constant = network.with_parameters({"hidden1.u": np.zeros((4, 1)), "hidden1.p": np.zeros((4, 1))})
    smaller = remove_neurons(constant, [flow_record()], {"hidden1": [1, 3]})
    inputs = {"u": np.linspace(-1, 1, 7), "p": np.full(7, 0.5)}
    np.testing.assert_allclose(smaller.run(inputs)["y"], constant.run(inputs)["y"], atol=1e-14)
    assert smaller.modules["hidden1"].size == 2
