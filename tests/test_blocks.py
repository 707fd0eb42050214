import numpy as np

from benchmarks.valve_flow import swap_flow
from greygate.machines.catalog import entry
from greygate.machines.valve_cylinder.network import V_SCALE
from greygate.machines.valve_cylinder.plant import spool_discrete, valve_cylinder
from greygate.models.families.blocks import feedforward, flow_rate, flow_record, nguyen_widrow
from greygate.models.families.regression import noe
from greygate.models.network import Layer, Port


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


def test_the_lap_of_a_valve_closes_or_opens_its_centre():
    p = np.linspace(0.01, 0.99, 9)
    centre = np.zeros(9)
    assert not flow_rate(centre, p, 0.05).any()
    assert not flow_rate(centre + 0.05, p, 0.05).any()
    np.testing.assert_allclose(flow_rate(centre, p, -0.05), 0.05 * (np.sqrt(1 - p) - np.sqrt(p)))
    np.testing.assert_allclose(flow_rate(centre + 0.5, p, 0.05), 0.45 * np.sqrt(1 - p))
    np.testing.assert_allclose(flow_rate(centre - 0.5, p, 0.05), -0.45 * np.sqrt(p))
    u, p = (flow_record().inputs[n] for n in "up")
    np.testing.assert_array_equal(flow_record().targets["y"], np.where(u > 0, u * np.sqrt(1 - p), u * np.sqrt(p)))


def test_a_swapped_flow_network_stands_in_both_places_and_the_rest_stays_as_trained():
    """What was learnt moves over to the bit. What `assemble` works out anew hangs on the kernels of BLAS, as far as its
    arithmetic errs: the spool's weights are differences of characteristic polynomials, whose roots err by the norm of
    their matrix times eps; the supply pressure is the mean of a simulation whose line has gains from least squares, 800
    rows of condition 17, which err by 3e-12.
    """
    plant = valve_cylinder()
    a = spool_discrete(plant)[0]
    spool = np.finfo(float).eps * np.linalg.norm(a) * V_SCALE / plant.parameters["u_max"].value
    trained, flow = entry("valve_cylinder").network(), feedforward("flow", ["u", "p"], [10, 10], seed=5)
    before, after, own = trained.parameters(), swap_flow(trained, flow).parameters(), flow.parameters()
    for name, value in after.items():
        part, _, inner = name.partition(".")
        if part in ("qa", "qb") and inner in own:
            np.testing.assert_array_equal(value, own[inner], err_msg=name)
        elif name.startswith("spool.mean."):
            np.testing.assert_allclose(value, before[name], rtol=0, atol=spool, err_msg=name)
        elif name.endswith(".state.rate"):
            np.testing.assert_allclose(value, before[name], rtol=1e-10, err_msg=name)
        else:
            np.testing.assert_array_equal(value, before[name], err_msg=name)
