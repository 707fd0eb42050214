import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import random_inputs, random_network
from test_network import SMOOTH, delay_line

from greygate.errors import InputError
from greygate.models.blocks import feedforward, flow_rate, flow_record
from greygate.models.network import Layer, Network, Port
from greygate.models.problem import Problem, Record
from greygate.models.training import Outcome, train


def as_record(network: Network, steps: int, seed: int) -> Record:
    inputs = random_inputs(network, steps, seed)
    rng = np.random.default_rng(seed)
    targets = {n: y + rng.normal(size=y.shape) for n, y in network.run(inputs).items()}
    return Record(inputs, targets, skip=int(rng.integers(0, 3)))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**9))
def test_gradients_through_time_equal_those_of_torch_for_any_topology(seed):
    network = random_network(seed, activations=SMOOTH)
    record = as_record(network, 15, seed)
    problem = Problem(network, [record])
    assert np.isfinite(problem.squares(problem.theta))
    _, gradient = problem.normal_equations(problem.theta)
    tensors = {n: torch.tensor(v, requires_grad=True) for n, v in problem.flat.parameters().items()}
    run = problem.flat.run(record.inputs, parameters=tensors)
    loss = sum(
        0.5 * (((run[p.name] - torch.tensor(record.targets[p.name])) / p.scale)[record.skip :] ** 2).sum()
        for p in problem.flat.outputs
    )
    loss.backward()
    grads = {n: np.zeros(t.shape) if t.grad is None else t.grad.numpy() for n, t in tensors.items()}
    want = np.concatenate([grads[n].ravel() for n in problem.slices()])[problem.free]
    np.testing.assert_allclose(gradient, want, rtol=1e-8, atol=1e-8 * (np.abs(want).max(initial=0) + 1e-3))


def test_the_free_run_of_the_kernel_is_the_free_run_of_the_network():
    network = random_network(5)
    inputs = random_inputs(network, 30, 5)
    outputs = network.run(inputs)
    errors = (p := Problem(network, [Record(inputs, outputs)])).errors(p.theta)[0]
    np.testing.assert_allclose(errors, 0, atol=1e-12)


def test_levenberg_marquardt_finds_weights_it_cannot_be_told_apart_from():
    network = delay_line()
    rng = np.random.default_rng(0)
    u = rng.normal(size=400)
    record = Record({"u": u}, network.run({"u": u}))
    start = network.with_parameters({"sum.own": np.array([[0.0]]), "sum.now": np.array([[0.3]])})
    fit = train(start, [record], epochs=50, goal=1e-24)
    assert fit.outcome is Outcome.REACHED
    np.testing.assert_allclose(fit.network.parameters()["sum.own"], 0.25, atol=1e-9)


def test_series_parallel_training_feeds_the_measured_output_back():
    network = delay_line()
    u, y = np.array([3.0, 1.0, 5.0]), np.array([7.0, -2.0, 4.0])
    errors = (p := Problem(network, [Record({"u": u}, {"y": y})], teacher=True)).errors(p.theta)[0][:, 0]
    past = np.array([0.2, 0.7, -0.2])  # initial, then measured / 10
    want = np.array([1, 0, 2]) + 0.5 * np.array([2, 2, 1]) + 0.25 * past + 0.1 - y / 10
    np.testing.assert_allclose(errors, want, rtol=1e-14)


def test_frozen_and_pruned_weights_stay():
    network = feedforward("f", ["u", "p"], [4], 0)
    mask = np.ones((4, 1), bool)
    mask[2] = False
    fit = train(network, [flow_record()], epochs=5, free={"hidden1.u": mask, "out.bias": [False]})
    before, after = network.parameters(), fit.network.parameters()
    assert after["hidden1.u"][2] == before["hidden1.u"][2]
    assert after["out.bias"] == before["out.bias"]
    assert after["hidden1.u"][1] != before["hidden1.u"][1]


def test_rehearsal_keeps_a_part_right_where_the_record_does_not_reach():
    part = train(feedforward("part", ["u", "p"], [6], 1), [flow_record()], epochs=60).network
    whole = Network("whole", [Port("u"), Port("p")], [Port("y")])
    nested = feedforward("part", ["u", "p"], [6], 1).with_parameters(part.parameters())
    whole.add("part", nested)
    for name in ("u", "p"):
        whole.connect(name, f"part.{name}")
    whole.connect("part", "y")
    rng = np.random.default_rng(0)
    u, p = rng.uniform(0.1, 0.2, 300), rng.uniform(0.4, 0.5, 300)
    record = Record({"u": u, "p": p}, {"y": 1.1 * flow_rate(u, p)})

    def error_elsewhere(network):
        problem = Problem(network, [flow_record()])
        return problem.squares(problem.theta)

    alone = train(whole, [record], epochs=20)
    kept = train(whole, [record], epochs=20, rehearse={"part": flow_record()})
    assert error_elsewhere(kept.network) < 0.2 * error_elsewhere(alone.network)
    with pytest.raises(InputError, match=r"cannot rehearse part[.]hidden1"):
        train(whole, [record], rehearse={"part.hidden1": flow_record()})


def test_training_stops_at_the_best_weights_when_interrupted():
    def interrupt(epoch, loss):
        raise KeyboardInterrupt

    fit = train(feedforward("f", ["u", "p"], [4], 0), [flow_record()], epochs=50, progress=interrupt)
    assert fit.outcome is Outcome.INTERRUPTED
    assert fit.history[-1] < fit.history[0]


@pytest.mark.parametrize(
    ("records", "message"),
    [
        ([], "no records"),
        ([Record({"u": []}, {"y": []})], "no samples"),
        ([Record({"u": [1.0, 2.0]}, {"y": [1.0]})], "2 samples where the targets have 1"),
        ([Record({"u": [1.0]}, {"y": [np.nan]})], "NaN or inf"),
        ([Record({"u": [np.inf]}, {"y": [1.0]})], "NaN or inf"),
        ([Record({"v": [1.0]}, {"y": [1.0]})], "input u .* is missing"),
        ([Record({"u": [1.0]}, {"z": [1.0]})], "target y .* is missing"),
    ],
)
def test_bad_records_are_named(records, message):
    with pytest.raises(InputError, match=message):
        train(delay_line(), records)


def test_a_network_that_diverges_at_the_start_is_refused():
    network = Network("bomb", [Port("u")], [Port("y")])
    network.add("s", Layer({"own": [[1e30]], "u": [[1.0]]}, [0.0]))
    network.connect("u", "s.u")
    network.connect("s", "s.own", 1)
    network.connect("s", "y")
    with pytest.raises(InputError, match="diverges with its initial weights"):
        train(network, [Record({"u": np.ones(50)}, {"y": np.ones(50)})])
