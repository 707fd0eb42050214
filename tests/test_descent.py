from threading import Barrier

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import random_network
from test_network import SMOOTH, delay_line
from test_training import as_record

from benchmarks.descent import _Static, _Swept, adam, gradient_descent, lbfgs, rtrl
from greygate.errors import InputError
from greygate.machines.benchmark_systems.plant import b1, b1_input
from greygate.models.families.blocks import feedforward, nguyen_widrow
from greygate.models.families.regression import noe
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import Outcome, multistart, train
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record

pytestmark = pytest.mark.nightly

METHODS = {
    "gradient_descent": (gradient_descent, {"rate": 0.05}),
    "rtrl": (rtrl, {"rate": 0.02}),
    "adam": (adam, {"rate": 0.02}),
    "lbfgs": (lbfgs, {}),
}


def learner() -> tuple[Network, Record]:
    """B1 and a network of 5 neurons that knows nothing yet."""
    u = b1_input(samples=200)
    network = nguyen_widrow(noe("b1", {Port("u"): (1,)}, Port("y"), (1, 2), (5,), bypass=False), 0)
    return network, Record({"u": u}, {"y": b1(u)}, skip=2)


def linear() -> tuple[Network, Record]:
    """A record that the network can follow exactly, and the network with other weights."""
    network = delay_line()
    u = np.random.default_rng(0).normal(size=300)
    record = Record({"u": u}, network.run({"u": u}))
    return network.with_parameters({"sum.own": np.array([[0.0]]), "sum.now": np.array([[0.3]])}), record


def squares(network: Network, record: Record) -> float:
    objective = Objective(network, [record])
    return objective.squares(objective.theta)


def moved(network: Network, fit) -> np.ndarray:
    before, after = network.flatten().parameters(), fit.network.parameters()
    return np.concatenate([(after[n] - before[n]).ravel() for n in before])


@settings(max_examples=25)
@given(st.integers(0, 10**9))
def test_the_sweep_back_through_time_equals_torch_for_any_topology(seed):
    network = random_network(seed, activations=SMOOTH)
    record = as_record(network, 15, seed)
    objective = _Swept(network, [record, record.cut(0, 9, weight=0.5)])
    objective.squares(objective.theta)
    tensors = {n: torch.tensor(v, requires_grad=True) for n, v in objective.flat.parameters().items()}
    for part, weight in ((record, 1.0), (record.cut(0, 9), 0.5)):
        run = objective.flat.run(part.inputs, parameters=tensors)
        for p in objective.flat.outputs:
            error = (run[p.name] - torch.tensor(part.targets[p.name])) / p.scale
            (0.5 * weight * (error[part.skip :] ** 2).sum()).backward(retain_graph=True)
    grads = {n: np.zeros(t.shape) if t.grad is None else t.grad.numpy() for n, t in tensors.items()}
    want = np.concatenate([grads[n].ravel() for n in objective.slices()])
    floor = 1e-8 * (np.abs(want).max(initial=0) + 1e-3)
    np.testing.assert_allclose(objective.gradient(objective.theta), want, rtol=1e-8, atol=floor)


@pytest.mark.parametrize("seed", range(6))
def test_with_a_teacher_or_without_feedback_all_samples_at_once_equal_the_sweep(seed):
    rng = np.random.default_rng(seed)
    network = noe("n", {Port("u"): (0, 2), Port("v"): (1,)}, Port("y", scale=2.0), (1, 3), (4, 3), seed)
    inputs = {"u": rng.normal(size=40), "v": rng.normal(size=40)}
    records = [Record(inputs, {"y": rng.normal(size=40)}, skip=s, weight=w) for s, w in ((0, 1.0), (5, 0.3))]
    swept = _Swept(network, records, teacher=True)
    assert swept.is_static
    assert not _Swept(network, records).is_static
    static = _Static(swept)
    assert static.squares(swept.theta) == pytest.approx(swept.squares(swept.theta), rel=1e-12)
    np.testing.assert_allclose(static.gradient(swept.theta), swept.gradient(swept.theta), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("teacher", [True, False])
def test_every_method_lowers_the_loss_of_its_network(name, teacher):
    method, options = METHODS[name]
    network, record = learner()
    fit = method(network, [record], epochs=150, teacher=teacher, **options)
    assert fit.outcome is Outcome.EPOCHS
    assert fit.history[-1] < 0.1 * fit.history[0]
    objective = Objective(fit.network, [record], teacher)
    assert objective.squares(objective.theta) / (2 * objective.samples) == pytest.approx(min(fit.history), rel=1e-9)


@pytest.mark.parametrize("name", METHODS)
def test_a_model_that_can_be_exact_becomes_exact(name):
    method, options = METHODS[name]
    network, record = linear()
    fit = method(network, [record], epochs=5000, goal=1e-16, **options)
    assert fit.outcome is Outcome.REACHED
    np.testing.assert_allclose(fit.network.parameters()["sum.own"], 0.25, atol=1e-6)


def test_lbfgs_finds_the_minimum_that_levenberg_marquardt_finds():
    network, record = learner()
    start = train(network, [record], epochs=10, decay=0.01).network
    fits = [method(start, [record], decay=0.01, epochs=2000) for method in (train, lbfgs)]
    assert {f.outcome for f in fits} <= {Outcome.CONVERGED, Outcome.STALLED}
    assert fits[1].history[-1] == pytest.approx(fits[0].history[-1], rel=1e-3)


def test_rtrl_goes_along_the_batch_gradient_as_its_rate_goes_to_zero():
    network, record = learner()
    objective = Objective(network, [record])
    objective.squares(objective.theta)
    gradient = objective.normal_equations(objective.theta)[1]
    far, near = (
        np.abs(moved(network, rtrl(network, [record], rate=r, epochs=1)) / r + gradient).max() for r in (1e-5, 1e-7)
    )
    assert near < 1e-4 * np.abs(gradient).max()
    assert near < 0.02 * far  # of first order in the rate


def test_mini_batches_take_many_steps_an_epoch():
    network = feedforward("f", ["u", "v"], [8], 0)
    u, v = np.random.default_rng(0).uniform(-1, 1, (2, 600))
    record = Record({"u": u, "v": v}, {"y": u * v})
    full, parts = (adam(network, [record], rate=0.01, epochs=10, batch=b) for b in (None, 30))
    assert parts.history[-1] < 0.3 * full.history[-1]
    assert parts.history == adam(network, [record], rate=0.01, epochs=10, batch=30).history
    with pytest.raises(InputError, match="samples that do not depend on each other"):
        adam(learner()[0], [learner()[1]], batch=10)


@pytest.mark.parametrize("name", ["rtrl", "adam"])
def test_a_rate_that_is_too_large_is_said_and_costs_no_weights(name):
    method, _ = METHODS[name]
    network, record = learner()
    fit = method(network, [record], rate=30.0, epochs=50)
    assert fit.outcome is Outcome.DIVERGED
    assert "rate 30 is too large for this start: lower it" in fit.remarks
    assert squares(fit.network, record) <= squares(network, record)
    with pytest.raises(InputError, match="rate 0: give a positive one"):
        method(network, [record], rate=0.0)


@pytest.mark.parametrize("rate", [1e-4, None, 100.0])
@pytest.mark.parametrize("seed", range(3))
def test_gradient_descent_finds_its_rate_on_an_ordinary_noe_whatever_it_starts_with(seed, rate):
    network = nguyen_widrow(noe("n", {Port("u"): (1, 2)}, Port("y"), (1, 2), (6,), seed), seed)  # 2 free run wild
    fit = gradient_descent(network, [learner()[1]], epochs=300, **({} if rate is None else {"rate": rate}))
    assert fit.outcome is Outcome.EPOCHS
    assert min(fit.history) < 0.005
    with pytest.raises(InputError, match="rate 0: give a positive one"):
        gradient_descent(network, [learner()[1]], rate=0.0)


def test_frozen_weights_stay_tied_ones_stay_equal_and_decay_shrinks():
    network, record = learner()
    mask = np.ones((5, 1), bool)
    mask[2] = False
    for method, options in METHODS.values():
        tied = [("hidden1.y_z1", "hidden1.y_z2")]
        fit = method(network, [record], epochs=20, free={"hidden1.u_z1": mask}, tied=tied, **options)
        before, after = network.parameters(), fit.network.parameters()
        assert after["hidden1.u_z1"][2] == before["hidden1.u_z1"][2]
        assert (after["hidden1.u_z1"][[0, 1, 3, 4]] != before["hidden1.u_z1"][[0, 1, 3, 4]]).all()
        np.testing.assert_array_equal(after["hidden1.y_z1"], after["hidden1.y_z2"])
        light, heavy = (method(network, [record], epochs=100, decay=d, **options) for d in (0.0, 100.0))
        norms = [sum(np.sum(v**2) for v in f.network.parameters().values()) for f in (light, heavy)]
        assert norms[1] < 0.5 * norms[0]


@pytest.mark.parametrize("name", METHODS)
def test_decay_is_given_by_module_layer_or_parameter(name):
    method, options = METHODS[name]
    network, record = learner()

    def fit(decay):
        return method(network, [record], epochs=30, decay=decay, **options)

    assert fit({"hidden1": 0.5, "sum": 0.5}).history == fit(0.5).history
    norms = [{n: np.sum(v**2) for n, v in fit(d).network.parameters().items()} for d in (0.0, {"hidden1.bias": 100.0})]
    assert norms[1]["hidden1.bias"] < 0.5 * norms[0]["hidden1.bias"]
    assert norms[1]["hidden1.y_z1"] > 0.5 * norms[0]["hidden1.y_z1"]
    with pytest.raises(InputError, match="decay names nobody"):
        fit({"nobody": 1.0})


def test_training_stops_where_the_held_out_tail_no_longer_improves():
    network, record = learner()
    rng = np.random.default_rng(0)
    noisy = Record(record.inputs, {"y": record.targets["y"] + 0.2 * rng.normal(size=200)})
    fit = lbfgs(network, [noisy], epochs=2000, tail=0.3, patience=20)
    assert fit.outcome is Outcome.EARLY
    assert len(fit.held) == len(fit.history) == int(np.argmin(fit.held)) + 21


@pytest.mark.parametrize("name", METHODS)
def test_ctrl_c_in_a_multistart_ends_the_starts_under_way(name):
    method, options = METHODS[name]
    network, record = learner()
    both = Barrier(2)

    def fit(seed):
        both.wait(10)
        return method(network, [record], epochs=(1, 10**9)[seed], tolerance=0.0, seconds=10.0, **options)

    def interrupt(line):
        raise KeyboardInterrupt

    ranked = multistart(fit, lambda network: squares(network, record), range(2), progress=interrupt)
    assert {s.seed: s.fit.outcome for s in ranked} == {0: Outcome.EPOCHS, 1: Outcome.INTERRUPTED}


def test_time_and_goal_end_a_training():
    network, record = learner()
    late = adam(network, [record], epochs=10**9, seconds=0.05)
    assert late.outcome is Outcome.TIME
    assert late.seconds > 0.05
    done = adam(network, [record], goal=1e9)
    assert (done.outcome, len(done.history)) == (Outcome.REACHED, 1)


def test_an_interrupt_keeps_the_best_weights():
    def interrupt(line):
        if line.startswith("epoch 3 "):
            raise KeyboardInterrupt

    network, record = learner()
    fit = gradient_descent(network, [record], epochs=50, progress=interrupt)
    assert fit.outcome is Outcome.INTERRUPTED
    assert len(fit.history) == 4
    assert squares(fit.network, record) == pytest.approx(2 * 198 * min(fit.history))
