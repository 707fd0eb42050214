import os
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from joblib import Parallel, delayed
from networks import random_inputs, random_network
from numba.extending import is_jitted
from test_network import SMOOTH, delay_line

from greygate.cores import usable_cores
from greygate.errors import InputError
from greygate.models.families.blocks import feedforward, flow_rate, flow_record
from greygate.models.families.regression import noe
from greygate.models.network import Layer, Network, Port
from greygate.models.training import kernels
from greygate.models.training import objective as objective_module
from greygate.models.training.levenberg import Outcome, multistart, narx_noe, train
from greygate.models.training.loss import Loss
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record


def as_record(network: Network, steps: int, seed: int) -> Record:
    inputs = random_inputs(network, steps, seed)
    rng = np.random.default_rng(seed)
    targets = {n: y + rng.normal(size=y.shape) for n, y in network.run(inputs).items()}
    return Record(inputs, targets, skip=int(rng.integers(0, 3)))


@settings(max_examples=100)
@given(st.integers(0, 10**9))
def test_gradients_through_time_equal_those_of_torch_for_any_topology(seed):
    network = random_network(seed, activations=(*SMOOTH, "product"))
    record = as_record(network, 15, seed)
    objective = Objective(network, [record])
    assert np.isfinite(objective.squares(objective.theta))
    _, gradient = objective.normal_equations(objective.theta)
    tensors = {n: torch.tensor(v, requires_grad=True) for n, v in objective.flat.parameters().items()}
    run = objective.flat.run(record.inputs, parameters=tensors)
    loss = sum(
        0.5 * (((run[p.name] - torch.tensor(record.targets[p.name])) / p.scale)[record.skip :] ** 2).sum()
        for p in objective.flat.outputs
    )
    loss.backward()
    grads = {n: np.zeros(t.shape) if t.grad is None else t.grad.numpy() for n, t in tensors.items()}
    want = np.concatenate([grads[n].ravel() for n in objective.slices()])[objective.free]
    np.testing.assert_allclose(gradient, want, rtol=1e-8, atol=1e-8 * (np.abs(want).max(initial=0) + 1e-3))


def test_every_function_of_a_kernel_says_its_own_arithmetic():
    """Else numba gives it that of what calls it first: to the bit the same, it would depend on what ran before."""
    found = {name: f for name, f in vars(kernels).items() if is_jitted(f)}
    assert {"slopes_at", "_slopes", "sensitivities"} <= found.keys()
    assert not [name for name, f in found.items() if "fastmath" not in f.targetoptions]
    fast = [name for name, f in found.items() if f.targetoptions["fastmath"]]
    assert fast == ["sensitivities"]


def test_the_free_run_of_the_kernel_is_the_free_run_of_the_network():
    network = random_network(5)
    inputs = random_inputs(network, 30, 5)
    outputs = network.run(inputs)
    errors = (p := Objective(network, [Record(inputs, outputs)])).errors(p.theta)[0]
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
    errors = (p := Objective(network, [Record({"u": u}, {"y": y})], teacher=True)).errors(p.theta)[0][:, 0]
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
    nested = Network("nested", [Port("u"), Port("p")], [Port("y")])
    nested.add("part", feedforward("part", ["u", "p"], [6], 1).with_parameters(part.parameters()))
    for name in ("u", "p"):
        nested.connect(name, f"part.{name}")
    nested.connect("part", "y")
    rng = np.random.default_rng(0)
    u, p = rng.uniform(0.1, 0.2, 300), rng.uniform(0.4, 0.5, 300)
    record = Record({"u": u, "p": p}, {"y": 1.1 * flow_rate(u, p)})

    def error_elsewhere(network):
        objective = Objective(network, [flow_record()])
        return objective.squares(objective.theta)

    alone = train(nested, [record], epochs=20)
    kept = train(nested, [record], epochs=20, rehearse={"part": flow_record()})
    assert error_elsewhere(kept.network) < 0.2 * error_elsewhere(alone.network)
    with pytest.raises(InputError, match=r"cannot rehearse part[.]hidden1"):
        train(nested, [record], rehearse={"part.hidden1": flow_record()})


def test_training_stops_at_the_best_weights_when_interrupted():
    def interrupt(line):
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


def loop(own: float = 0.5, gain: float = 1.0, size: int = 1) -> Network:
    """s(k) = own s(k-1) + gain u(k), shown."""
    network = Network("loop", [Port("u")], [Port("y")])
    network.add("s", Layer({"own": own * np.eye(size), "u": np.full((size, 1), gain)}, np.zeros(size)))
    network.add("out", Layer({"s": np.ones((1, size))}, [0.0], frozen={"s", "bias"}))
    network.connect("u", "s.u")
    network.connect("s", "s.own", 1)
    network.connect("s", "out.s")
    network.connect("out", "y")
    return network


def excited(network: Network, steps: int = 200, seed: int = 0, **changes) -> Record:
    u = np.random.default_rng(seed).normal(size=steps)
    return Record({"u": u}, network.run({"u": u}, **changes))


def test_a_free_run_that_diverges_at_the_start_ends_with_a_sentence_and_the_weights_given():
    fit = train(loop(own=1e30), [Record({"u": np.ones(50)}, {"y": np.ones(50)})])
    assert fit.outcome is Outcome.DIVERGED
    assert "diverges" in fit.outcome.value
    assert fit.network.parameters()["s.own"] == 1e30


@pytest.mark.parametrize(
    ("record", "remark"),
    [
        (Record({"u": np.ones(50), "v": np.arange(50.0)}, {"y": np.ones(50)}), "input u is constant"),
        (
            Record({"u": np.sin(np.arange(50)), "v": 2 * np.sin(np.arange(50)) + 3}, {"y": np.ones(50)}),
            r"u\(k\), v\(k\) are collinear",
        ),
        (Record({"u": [1.0, 2.0, 1.0], "v": [2.0, 1.0, 0.0]}, {"y": np.ones(3)}), "3 samples for 17 free weights"),
    ],
)
def test_data_that_cannot_determine_the_weights_are_remarked_on(record, remark):
    fit = train(feedforward("f", ["u", "v"], [4], 0), [record], epochs=2)
    assert any(re.search(remark, r) for r in fit.remarks), fit.remarks


def test_good_data_bring_no_remark():
    assert not train(feedforward("f", ["u", "p"], [4], 0), [flow_record()], epochs=1).remarks


def test_tied_layers_stay_equal_and_move_by_the_sum_of_their_gradients():
    network = Network("two", [Port("u"), Port("v")], [Port("y")])
    for name in ("a", "b"):
        network.add(name, Layer({"x": [[0.3]]}, [0.1], "tansig"))
    network.add("out", Layer({"a": [[1.0]], "b": [[1.0]]}, [0.0], frozen={"a", "b"}))
    for source, target in (("u", "a.x"), ("v", "b.x"), ("a", "out.a"), ("b", "out.b"), ("out", "y")):
        network.connect(source, target)
    rng = np.random.default_rng(0)
    u, v = rng.normal(size=(2, 300))
    record = Record({"u": u, "v": v}, {"y": np.tanh(0.8 * u - 0.2) + np.tanh(0.8 * v - 0.2) + 0.5})
    fit = train(network, [record], tied=[("a", "b")], epochs=40, goal=1e-24)
    assert fit.outcome is Outcome.REACHED
    found = fit.network.parameters()
    np.testing.assert_allclose([found["a.x"].item(), found["a.bias"].item()], [0.8, -0.2], atol=1e-9)
    assert found["a.x"] == found["b.x"]
    assert found["a.bias"] == found["b.bias"]
    with pytest.raises(InputError, match="no module, layer or parameter c to tie"):
        train(network, [record], tied=[("a", "c")])


def test_bounds_hold_and_the_rest_is_the_optimum_within_them():
    record = excited(loop(0.5, 2.0))
    fit = train(loop(0.1, 0.5), [record], bounds={"s.u": (0.0, 1.5)}, epochs=60)
    assert fit.network.parameters()["s.u"] == 1.5
    own = fit.network.parameters()["s.own"].item()
    for other in (own - 1e-3, own + 1e-3):
        objective = Objective(fit.network.with_parameters({"s.own": np.array([[other]])}), [record])
        assert objective.squares(objective.theta) > 2 * fit.history[-1] * objective.samples * (1 - 1e-9)
    with pytest.raises(InputError, match="no parameter"):
        train(loop(), [record], bounds={"s.x": (0, 1)})


def test_decay_acts_on_the_module_it_names():
    record = excited(loop(0.5, 2.0))
    pulled = train(loop(0.1, 0.5), [record], decay={"s.u": 100.0}).network.parameters()
    assert abs(pulled["s.u"].item()) < 1.8
    assert train(loop(0.1, 0.5), [record], decay={"out": 100.0}).network.parameters()["s.u"].item() == pytest.approx(2)
    again = train(loop(0.1, 0.5), [record], decay={"s.u": np.array([[100.0]])}).network.parameters()
    assert again["s.u"] == pulled["s.u"]
    with pytest.raises(InputError, match=r"decay of s.u has the shape \(2,\); give one number"):
        train(loop(), [record], decay={"s.u": np.ones(2)})
    with pytest.raises(InputError, match="decay names s2"):
        train(loop(), [record], decay={"s2": 1.0})


def test_decay_is_that_of_the_longest_name_that_fits_and_of_whole_names_alone():
    network = Network("two", [Port("u")], [Port("y")])
    network.add("a", Layer({"u": [[1.0]]}, [0.0]))
    network.add("ab", Layer({"a": [[1.0]]}, [0.0]))
    for source, target in (("u", "a.u"), ("a", "ab.a"), ("ab", "y")):
        network.connect(source, target)
    objective = Objective(network, [excited(network)])

    def found(decay) -> dict:
        diagonal = Loss(objective, network, decay, {}).decay
        return {name: diagonal[columns].item() for name, columns in objective.slices().items()}

    assert found({"a": 1.0}) == {"a.u": 1.0, "a.bias": 1.0, "ab.a": 0.0, "ab.bias": 0.0}
    for decay in ({"a": 1.0, "a.u": 2.0}, {"a.u": 2.0, "a": 1.0}):
        assert found(decay) == {"a.u": 2.0, "a.bias": 1.0, "ab.a": 0.0, "ab.bias": 0.0}


def test_the_tail_of_a_record_is_not_trained_on_and_decides_when_to_stop():
    rng = np.random.default_rng(1)
    x = np.sort(rng.uniform(-1, 1, 60))[rng.permutation(60)]
    record = Record({"x": x}, {"y": np.sin(3 * x) + 0.3 * rng.normal(size=60)})
    spoilt = Record({"x": x}, {"y": np.where(np.arange(60) < 42, record.targets["y"], 1e3)})
    start = feedforward("f", ["x"], [20], 0)
    fit = train(start, [record], tail=0.3, epochs=300, patience=15)
    assert fit.outcome is Outcome.EARLY
    assert len(fit.held) == len(fit.history)
    judge = Objective(fit.network, [replace(record, skip=42)])
    assert judge.squares(judge.theta) / judge.samples == pytest.approx(min(fit.held), rel=1e-12)
    assert train(start, [spoilt], tail=0.3, epochs=5).history == train(start, [record], tail=0.3, epochs=5).history


def test_the_initial_state_is_estimated_with_the_weights():
    truth = loop(0.95, 1.0)
    record = excited(truth, 60, initial={"s": 5.0})
    assert train(loop(0.5, 0.5), [record]).history[-1] > 1e-2
    fit = train(loop(0.5, 0.5), [record], estimate_initial=True, goal=1e-24)
    assert fit.outcome is Outcome.REACHED
    np.testing.assert_allclose(fit.initial[0]["s"], [[5.0]], atol=1e-9)
    again = Objective(fit.network, [replace(record, initial=fit.initial[0])])
    assert again.squares(again.theta) < 1e-18
    np.testing.assert_allclose(fit.network.run(record.inputs, fit.initial[0])["y"], record.targets["y"], atol=1e-9)


def test_the_free_run_after_shooting_starts_from_the_state_that_shooting_found():
    record = excited(loop(0.95, 1.0), 60, initial={"s": 5.0})
    fit = train(loop(0.5, 0.5), [record], estimate_initial=True, shooting=10)
    assert fit.history[0] < 1e-9


def crossed(rng: np.random.Generator) -> Network:
    """Two layers of two neurons that feed each other and themselves, each with an output of its own."""
    network = Network("n", [Port("u")], [Port("y"), Port("z")])
    for name, other in (("a", "b"), ("b", "a")):
        weights = {p: rng.normal(size=(2, n)) * 0.5 for p, n in (("u", 1), ("own", 2), ("other", 2))}
        network.add(name, Layer(weights, rng.normal(size=2), "tansig"))
        network.connect("u", f"{name}.u", 1)
        network.connect(name, f"{name}.own", 3)
        network.connect(other, f"{name}.other", 1)
    for name, port in (("a", "y"), ("b", "z")):
        network.add(f"out_{port}", Layer({"x": rng.normal(size=(1, 2))}, [0.0]))
        network.connect(name, f"out_{port}.x")
        network.connect(f"out_{port}", port)
    return network


@pytest.mark.parametrize(
    "options", [{"estimate_initial": True}, {"shooting": 7}, {"shooting": 7, "tied": [("a", "b")]}]
)
def test_derivatives_by_initial_states_and_across_windows_are_exact(options):
    rng = np.random.default_rng(3)
    network = crossed(rng)
    targets = {"y": rng.normal(size=40), "z": rng.normal(size=40)}
    record = Record({"u": rng.normal(size=40)}, targets, skip=3, weight=2.0)
    objective = Objective(network, [record, replace(record, skip=0)], **options)
    objective.continuity = 3.0
    theta = objective.moved(objective.theta, 0.1 * rng.normal(size=len(objective.free)))
    objective.squares(theta)
    _, gradient = objective.normal_equations(theta)
    steps = 1e-6 * np.eye(len(objective.free))
    slopes = [
        (objective.squares(objective.moved(theta, s)) - objective.squares(objective.moved(theta, -s))) / 4e-6
        for s in steps
    ]
    np.testing.assert_allclose(gradient, slopes, rtol=1e-6, atol=1e-6 * np.abs(gradient).max())


@pytest.mark.parametrize("chunk", [1, 31, 32, 33, 64, 300])
def test_normal_equations_do_not_depend_on_how_the_steps_are_cut_or_on_the_cores(chunk, monkeypatch):
    rng = np.random.default_rng(5)
    network = crossed(rng)
    record = Record({"u": rng.normal(size=200)}, {"y": rng.normal(size=200), "z": rng.normal(size=200)}, skip=3)
    posed = Objective(network, [record], estimate_initial=True)
    posed.squares(posed.theta)
    want = posed.normal_equations(posed.theta)
    steps = 1e-6 * np.eye(len(posed.theta))
    errors = [posed.errors(posed.theta + s)[0][3:].ravel() for s in (*steps, *-steps)]
    slopes = (np.array(errors[: len(steps)]) - errors[len(steps) :]).T / 2e-6
    np.testing.assert_allclose(want[0], (slopes.T @ slopes)[np.ix_(posed.free, posed.free)], rtol=1e-5, atol=1e-6)
    monkeypatch.setattr(objective_module, "CHUNK", chunk)
    found = []
    for worth, cores in ((0.0, 2), (np.inf, 2), (0.0, 1)):
        monkeypatch.setattr(objective_module, "WORTH", worth)
        monkeypatch.setattr(objective_module, "usable_cores", lambda cores=cores: cores)
        posed.squares(posed.theta)
        found.append(posed.normal_equations(posed.theta))
    for of, whole in zip(found[0], want, strict=True):
        np.testing.assert_allclose(of, whole, rtol=1e-10, atol=1e-10)
    for other in found[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(found[0], other, strict=True))


def test_trainings_side_by_side_share_the_cores():
    few, shares = usable_cores(), Parallel(2)(delayed(usable_cores)() for _ in range(2))
    assert shares == 2 * [max(few // 2, 1)]


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="this system pins no process to a core")
def test_a_process_that_is_pinned_to_a_core_hands_nothing_to_another():
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, sorted(before)[:1])
        assert usable_cores() == 1
    finally:
        os.sched_setaffinity(0, before)


def test_multiple_shooting_trains_from_weights_whose_free_run_diverges():
    record = excited(loop(0.98, 1.0), 2000)
    start = loop(1.5, 1.0)
    assert train(start, [record]).outcome is Outcome.DIVERGED
    fit = train(start, [record], shooting=10, goal=1e-20)
    assert fit.outcome is Outcome.REACHED
    assert fit.network.parameters()["s.own"].item() == pytest.approx(0.98, abs=1e-9)


def test_a_training_that_was_cut_off_goes_on_from_its_checkpoint_as_if_it_had_not_been(tmp_path):
    start, path = feedforward("f", ["u", "p"], [4], 0), tmp_path / "training.npz"
    at_once = train(start, [flow_record()], epochs=12)

    def interrupt(line):
        if line.startswith("epoch 5 "):
            raise KeyboardInterrupt

    assert train(start, [flow_record()], epochs=12, checkpoint=path, progress=interrupt).outcome is Outcome.INTERRUPTED
    assert path.exists()
    with pytest.raises(InputError, match="checkpoint of other records, options or weights"):
        train(feedforward("f", ["u", "p"], [4], 1), [flow_record()], epochs=12, checkpoint=path)
    resumed = train(start, [flow_record()], epochs=12, checkpoint=path, keep=True)
    assert resumed.history == at_once.history
    assert train(start, [flow_record()], epochs=12, checkpoint=path).history == at_once.history
    assert not path.exists()
    path.write_text("no")
    with pytest.raises(InputError, match="not a readable checkpoint"):
        train(start, [flow_record()], checkpoint=path)


def test_starts_are_ranked_by_their_score_and_do_not_depend_on_how_many_run_at_once():
    def fit(seed):
        return train(feedforward("f", ["u", "p"], [3], seed), [flow_record()], epochs=5)

    def score(network):
        objective = Objective(network, [flow_record()])
        return objective.squares(objective.theta)

    ranked = multistart(fit, score, range(4))
    assert [s.score for s in ranked] == sorted(s.score for s in ranked)
    assert [(s.seed, s.score) for s in ranked] == [(s.seed, s.score) for s in multistart(fit, score, range(4), jobs=1)]
    with pytest.raises(InputError, match="no start"):
        multistart(fit, score, [])


def test_narx_then_noe_ends_in_a_free_run_at_the_optimum():
    record = excited(loop(0.9, 1.0), 300)
    fit = narx_noe(loop(0.1, 0.1), [record], goal=1e-22)
    assert fit.outcome is Outcome.REACHED


def test_a_checkpoint_of_other_records_or_options_is_refused_and_a_resumed_training_says_so(tmp_path):
    start, path, record = feedforward("f", ["u", "p"], [4], 0), tmp_path / "training.npz", flow_record()

    def interrupt(line):
        if line.startswith("epoch 3 "):
            raise KeyboardInterrupt

    train(start, [record], checkpoint=path, progress=interrupt)
    other = replace(record, targets={"y": 2 * record.targets["y"]})
    for records, options in (([other], {}), ([record], {"decay": 1.0}), ([record], {"held": [other]})):
        with pytest.raises(InputError, match="checkpoint of other records, options or weights"):
            train(start, records, checkpoint=path, **options)
    assert "resumed at epoch 3" in train(start, [record], epochs=5, checkpoint=path).remarks


def fed_back(own: float, gain: float) -> Network:
    """y(k) = own y(k-1) + gain u(k-1): its output is fed back, so that there is a NARX stage."""
    network = noe("n", {Port("u"): (1,)}, Port("y"), (1,), ())
    return network.with_parameters({"sum.y_z1": [[own]], "sum.u_z1": [[gain]], "sum.bias": [0.0]})


def test_an_interrupted_narx_stage_leaves_its_checkpoint_and_is_taken_up(tmp_path):
    record, path = excited(fed_back(0.9, 1.0), 300), tmp_path / "training.npz"

    def interrupt(line):
        raise KeyboardInterrupt

    start = fed_back(0.1, 0.1)
    assert narx_noe(start, [record], checkpoint=path, progress=interrupt).outcome is Outcome.INTERRUPTED
    assert (tmp_path / "training.npz.narx").exists()
    assert narx_noe(start, [record], checkpoint=path, goal=1e-22).outcome is Outcome.REACHED
    assert not list(tmp_path.iterdir())


def test_the_narx_stage_does_not_learn_the_tail():
    record = excited(fed_back(0.9, 1.0), 300)
    spoilt = replace(record, targets={"y": np.r_[record.targets["y"][:200], 50.0 * np.ones(100)]})
    fit = narx_noe(fed_back(0.1, 0.1), [spoilt], tail=1 / 3, epochs=0)
    assert fit.network.parameters()["sum.y_z1"].item() == pytest.approx(0.9, abs=1e-6)


def test_held_out_records_are_judged_from_their_own_start_and_tails_from_that_of_their_record():
    plant, rng = loop(0.9, 1.0), np.random.default_rng(3)
    u = rng.normal(size=200)
    moving, resting = (Record({"u": u}, {"y": plant.run({"u": u}, initial=i)["y"]}) for i in ({"s": 5.0}, {}))
    fit = train(loop(0.9, 1.0), [moving], epochs=20, estimate_initial=True, held=[resting], tolerance=0.0)
    assert min(fit.held) < 1e-15
    tail = train(loop(0.9, 1.0), [moving], epochs=20, estimate_initial=True, tail=0.5, tolerance=0.0)
    assert min(tail.held) < 1e-15
    both = train(
        loop(0.9, 1.0), [moving], epochs=20, estimate_initial=True, tail=0.5, held=[resting] * 2, tolerance=0.0
    )
    assert min(both.held) < 1e-15


def test_ties_that_share_a_member_hold_in_any_order_and_fixed_members_are_refused():
    record = excited(loop(0.5, 0.5), 100)
    names = list(Objective(loop(0.5, 0.3), [record]).slices())
    assert len(names) >= 3
    a, b, c = names[:3]
    for groups in ([(a, b), (b, c)], [(b, c), (a, b)]):
        values = train(loop(0.5, 0.3), [record], tied=groups, epochs=3).network.parameters()
        assert values[a].item() == values[b].item() == values[c].item()
    with pytest.raises(InputError, match="may not move; no tie"):
        Objective(loop(0.5, 0.3), [record], tied=[(a, b)], free={b: np.zeros(1, bool)})


@pytest.mark.parametrize("fixed", ["first", "second"])
def test_a_group_of_which_some_weights_alone_may_not_move_is_refused(fixed):
    network = feedforward("f", ["u"], [2, 2], 0)
    both = {"first": "hidden1.bias", "second": "hidden2.bias"}
    record = Record({"u": np.ones(5)}, {"y": np.ones(5)})
    with pytest.raises(InputError, match="may not move; no tie"):
        Objective(network, [record], tied=[tuple(both.values())], free={both[fixed]: np.array([True, False])})


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"decay": -1.0}, "decay -1.0"),
        ({"epochs": -3}, "epochs -3"),
        ({"shooting": -5}, "shooting -5"),
        ({"shooting": 0}, "shooting 0: give windows of 1 to 50 steps"),
        ({"shooting": 51}, "shooting 51"),
        ({"decay": np.nan}, "decay nan"),
        ({"decay": {"s": np.inf}}, "inf.*: give finite numbers"),
        ({"seconds": np.nan}, "seconds nan"),
        ({"bounds": {"s.own": ([0.0, 0.0], 1.0)}}, "two numbers"),
        ({"bounds": {"s.own": (1.0, 0.0), "s.u": (0.0, 1.0)}}, "a lower bound lies above its upper"),
        ({"bounds": {"s.own": (0.0, 1.0)}, "free": {"s.own": [False]}}, "bounds on s.own, which is frozen"),
        ({"free": {"s.own": [True, False]}}, "free: s.own has shape"),
        ({"free": {name: [False] for name in ("s.own", "s.u", "s.bias")}}, "nothing to train"),
    ],
)
def test_senseless_options_are_named(options, said):
    with pytest.raises(InputError, match=said):
        train(loop(0.5, 0.3), [excited(loop(0.5, 0.5), 100)], **options)


def test_a_fit_to_the_last_bit_has_converged_and_an_absurd_finite_loss_has_diverged():
    exact = excited(loop(0.9, 1.0), 300)
    assert train(loop(0.8, 1.0), [exact], tolerance=0.0).outcome is Outcome.CONVERGED
    assert train(loop(3.0, 1.0), [exact], epochs=0).outcome is Outcome.DIVERGED


def test_a_weight_that_is_not_positive_is_refused():
    record = replace(excited(loop(0.9, 1.0), 100), weight=-1.0)
    with pytest.raises(InputError, match="weighs -1"):
        train(loop(0.9, 1.0), [record])


def test_a_constant_target_is_remarked_on():
    record = excited(loop(0.9, 1.0), 100)
    fit = train(loop(0.5, 1.0), [replace(record, targets={"y": np.full(100, 3.0)})], epochs=3)
    assert any("target y is constant" in remark for remark in fit.remarks)


@pytest.mark.parametrize("activation", ["hardlim", "hardlims"])
def test_a_hard_limit_passes_no_gradient_on(activation):
    network = Network("switched", [Port("u")], [Port("y")])
    network.add("sign", Layer({"u": [[0.7]]}, [0.1], activation))
    network.add("sum", Layer({"sign": [[0.5]], "u": [[0.3]]}, [0.2]))
    for source, target in (("u", "sign.u"), ("sign", "sum.sign"), ("u", "sum.u"), ("sum", "y")):
        network.connect(source, target)
    objective = Objective(network, [excited(loop(0.9, 1.0), 50)])
    assert np.isfinite(objective.squares(objective.theta))
    _, gradient = objective.normal_equations(objective.theta)
    small = 1e-6 * np.eye(len(objective.theta))
    want = [(objective.squares(objective.theta + d) - objective.squares(objective.theta - d)) / 4e-6 for d in small]
    np.testing.assert_allclose(gradient, want, atol=1e-6)


def test_a_held_out_tail_is_not_judged_on_what_its_record_skips():
    plant = loop(0.9, 1.0)
    record = excited(plant, 100)
    unsettled = replace(record, targets={"y": np.r_[np.full(80, 50.0), record.targets["y"][80:]]}, skip=80)
    fit = train(loop(0.8, 1.0), [excited(plant, 300, seed=1), unsettled], tail=0.5, tolerance=0.0)
    assert min(fit.held) < 1e-15
