"""Training with a group lasso: which neurons it empties, and what that costs."""

import numpy as np
import pytest

from benchmarks.thesis.grouped import emptied, neurons, train_grouped
from greygate.errors import InputError
from greygate.models.accuracy import pooled_rms
from greygate.models.families.blocks import feedforward
from greygate.models.network import Layer, Network, Port
from greygate.models.prune import entropies, remove_neurons
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record


@pytest.fixture(scope="module")
def record() -> Record:
    u = np.random.default_rng(0).uniform(-1, 1, 400)
    return Record({"u": u}, {"y": np.tanh(2.0 * u) - 0.5 * np.tanh(4.0 * u - 1.0)})


def test_a_group_lasso_leaves_the_two_neurons_that_made_the_target_and_decay_spoils_them(record):
    network = train(feedforward("f", ["u"], [8], 3), [record], epochs=60).network

    def left(of: Network) -> int:
        return 8 - len(emptied(of.flatten()).get("hidden1", []))

    grouped = train_grouped(network, [record], 1e-6)
    decayed = train(network, [record], epochs=300, decay=1e-4).network
    assert (left(network), left(grouped)) == (8, 2)
    assert left(decayed) > 2
    before, after, spoilt = (pooled_rms(n, [record])[0] for n in (network, grouped, decayed))
    assert after < before < spoilt
    smaller = remove_neurons(grouped, [record], emptied(grouped), onto_others=False)
    assert (smaller.neurons(), smaller.modules["hidden1"].size) == (2, 2)
    np.testing.assert_allclose(pooled_rms(smaller, [record])[0], after, rtol=1e-3)
    assert (entropies(grouped, [record])["hidden1"] < 1.0).sum() == 6  # those of no length stand still


def test_each_neuron_has_the_weights_into_it_its_bias_and_those_that_read_it():
    groups = neurons(feedforward("f", ["u", "p"], [3, 2], 0).flatten())
    assert [*groups] == [("hidden1", 0), ("hidden1", 1), ("hidden1", 2), ("hidden2", 0), ("hidden2", 1)]
    found = {name: at.tolist() for name, at in groups["hidden1", 1]}
    assert found.pop("hidden1.bias") == [1]
    assert [v for n, v in found.items() if n.startswith("hidden2")] == [[1, 4]]


def test_a_network_without_neurons_that_may_go_is_refused(record):
    network = Network("line", [Port("u")], [Port("y")])
    network.add("sum", Layer({"u": np.ones((1, 1))}, [0.0]))
    network.connect("u", "sum.u")
    network.connect("sum", "y")
    with pytest.raises(InputError, match="no hidden neuron"):
        train_grouped(network, [record], 1.0)
