import numpy as np

from greygate.models.blocks import nguyen_widrow
from greygate.models.network import Layer, Port
from greygate.models.regression import noe


def test_neurons_of_a_sigmoid_layer_share_out_their_input_range():
    network = nguyen_widrow(noe("b2", {Port("u"): (1, 2)}, Port("y"), (1, 2, 3), (20, 10), bypass=False), seed=3)
    assert sum(v.size for v in network.parameters().values()) == 341
    for layer, fan_in in (("hidden1", 5), ("hidden2", 20)):
        module = network.modules[layer]
        lengths = np.linalg.norm(np.hstack(list(module.weights.values())), axis=1)
        np.testing.assert_allclose(lengths, 0.7 * module.size ** (1 / fan_in))
        assert len(set(np.abs(module.bias).round(12))) == module.size / 2


def test_a_new_start_leaves_frozen_weights_and_linear_paths_alone():
    network = noe("n", {Port("u"): (1,)}, Port("y"), (1,), (4,))
    layer = network.modules["hidden1"]
    network.modules["hidden1"] = Layer(layer.weights, layer.bias, "tansig", frozen=frozenset({"u_z1", "bias"}))
    before, after = network.parameters(), nguyen_widrow(network, 0).parameters()
    moved = {n for n in before if not np.array_equal(before[n], after[n])}
    assert moved == {"hidden1.y_z1", "sum.hidden1"}
