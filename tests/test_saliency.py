import re
from dataclasses import replace

import numpy as np
import pytest

from greygate.compiler.pipeline import compile_network
from greygate.compiler.targets import Design
from greygate.compiler.targets.folded import folded
from greygate.compiler.targets.parallel import parallel
from greygate.emulator.engine import run
from greygate.errors import InputError
from greygate.machines.benchmark_systems.plant import b2, b2_input
from greygate.models.accuracy import pooled_rms
from greygate.models.families.regression import noe
from greygate.models.network import Layer, Network, Port
from greygate.models.saliency import (
    METHODS,
    Expansion,
    evolution,
    magnitude,
    multi_obs,
    nonzero,
    obd,
    obs,
    perturbation,
    prune_by_saliency,
    saliency_pruning,
    smallest_variance,
    unit_obs,
)
from greygate.models.simplify import fold_constants, parameter_count
from greygate.models.training.levenberg import train
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record


def linear(mix: np.ndarray | None = None, samples: int = 200) -> tuple[Network, Record]:
    """y = w u + b on correlated inputs with noise, at w = 1."""
    rng = np.random.default_rng(0)
    mix = np.eye(8) + 0.3 * rng.normal(size=(8, 8)) if mix is None else mix
    u = rng.normal(size=(samples, len(mix))) @ mix
    record = Record({"u": u}, {"y": u @ rng.normal(size=len(mix)) + 0.5 + 0.3 * rng.normal(size=samples)})
    network = Network("linear", [Port("u", size=len(mix))], [Port("y")])
    network.add("sum", Layer({"u": np.ones((1, len(mix)))}, [1.0]))
    network.connect("u", "sum.u")
    network.connect("sum", "y")
    return network, record


def refit(network: Network, record: Record, decay: float, gone=()) -> tuple[np.ndarray, float]:
    """Least squares with decay without some weights, and half its sum of squared errors."""
    x = np.c_[record.inputs["u"], np.ones(len(record.targets["y"]))]
    stay = np.setdiff1d(np.arange(x.shape[1]), gone)
    theta = np.zeros(x.shape[1])
    normal = x[:, stay].T @ x[:, stay] + decay * np.eye(len(stay))
    theta[stay] = np.linalg.solve(normal, x[:, stay].T @ record.targets["y"])
    return theta, 0.5 * np.sum((x @ theta - record.targets["y"]) ** 2)


def expansion(network: Network, record: Record, decay: float = 0.0, ridge: float = 0.0) -> tuple[Expansion, float]:
    """At the minimum of a linear network, and half its sum of squared errors."""
    theta, loss = refit(network, record, decay)
    return Expansion.of(Objective(network, [record]).unpack(theta), [record], decay, ridge), loss


def two_layers(hidden: np.ndarray, bias: np.ndarray, out: np.ndarray) -> tuple[Network, Record]:
    """A tansig network on three inputs that repeats its record exactly."""
    network = Network("f", [Port("u", size=3)], [Port("y")])
    network.add("hidden", Layer({"u": hidden}, bias, "tansig"))
    network.add("out", Layer({"h": out}, [0.1]))
    network.connect("u", "hidden.u")
    network.connect("hidden", "out.h")
    network.connect("out", "y")
    u = np.random.default_rng(1).uniform(-1, 1, (300, 3))
    return network.check(), Record({"u": u}, network.run({"u": u}))


def names(e: Expansion, weights: np.ndarray) -> list[tuple[str, int]]:
    place = e.objective.slices()
    return [(n, int(np.flatnonzero(where == w)[0])) for w in weights for n, where in place.items() if w in where]


# ---- each method


@pytest.mark.parametrize("decay", [0.0, 7.0])
@pytest.mark.parametrize(("method", "count"), [(obs, 1), (obs, 4), (multi_obs, 4), (obs, 8), (multi_obs, 8)])
def test_surgery_on_a_network_linear_in_its_weights_is_least_squares_without_them(method, count, decay):
    network, record = linear()
    e, _ = expansion(network, record, decay)
    removal = method(e, count)
    assert len(removal.weights) == count
    np.testing.assert_allclose(removal.theta, refit(network, record, decay, removal.weights)[0], rtol=0, atol=1e-13)
    assert not removal.theta[removal.weights].any()


@pytest.mark.parametrize("decay", [0.0, 7.0])
def test_the_saliency_of_surgery_is_the_rise_of_the_error_that_refitting_measures(decay):
    network, record = linear()
    e, _ = expansion(network, record, decay)
    for method in (multi_obs, obs):
        removal = method(e, 9)
        for k, rise in enumerate(removal.saliency):
            before = removal.weights[:k] if method is obs else []
            after = refit(network, record, decay, [*before, removal.weights[k]])[1]
            np.testing.assert_allclose(rise, after - refit(network, record, decay, before)[1], rtol=1e-9, atol=1e-11)
    assert (np.diff(multi_obs(e, 9).saliency) >= 0).all()


@pytest.mark.parametrize("decay", [0.0, 7.0])
def test_the_saliency_of_obd_is_the_rise_of_the_error_without_correction(decay):
    network, record = linear()
    e, loss = expansion(network, record, decay)
    removal = obd(e, 9)
    for weight, saliency in zip(removal.weights, removal.saliency, strict=True):
        theta = e.theta.copy()
        theta[weight] = 0.0
        np.testing.assert_allclose(saliency, e.objective.squares(theta) / 2 - loss, rtol=1e-9)


def test_perturbation_measures_what_obd_foretells_of_a_linear_network():
    network, record = linear()
    e, _ = expansion(network, record, 7.0)
    removal = perturbation(e, 9)
    assert (np.diff(removal.saliency) >= 0).all()
    np.testing.assert_allclose(removal.saliency, obd(e, 9).saliency, rtol=1e-9)
    assert perturbation(e, 2).weights.tolist() == removal.weights[:2].tolist()


def test_evolution_finds_the_pair_that_does_nothing_together():
    rng = np.random.default_rng(6)
    u = rng.normal(size=(300, 5))
    u[:, 1] = u[:, 0] + 1e-3 * rng.normal(size=300)  # weights of 5 and -5 on these: together next to nothing
    record = Record({"u": u}, {"y": u @ [5.0, -5.0, 0.4, 0.5, 0.6] + 0.3})
    network = Network("linear", [Port("u", size=5)], [Port("y")])
    network.add("sum", Layer({"u": np.ones((1, 5))}, [1.0]))
    network.connect("u", "sum.u")
    network.connect("sum", "y")
    e, _ = expansion(network, record)
    removal = evolution(e, 2)
    assert set(removal.weights) == {0, 1}
    assert set(obd(e, 2).weights) == {2, 5}
    rise = (e.objective.squares(removal.theta) - e.objective.squares(e.theta)) / 2
    np.testing.assert_allclose(removal.saliency, [rise, rise])
    np.testing.assert_array_equal(evolution(e, 2).weights, removal.weights)
    for count in range(1, 7):  # no set wins because it removes less
        assert len(set(evolution(e, count).weights)) == count


def test_magnitude_sees_the_size_obd_the_effect_and_surgery_what_others_can_stand_in_for():
    mix = np.diag([1.0, 0.05, 1e-3, 1.0])
    mix[0, 1] = 1.0  # u1 is u0 and 0.05 of its own
    network, record = linear(mix, 400)
    u = record.inputs["u"]
    record = Record({"u": u}, {"y": u @ [0.8, 0.8, 9.0, 0.2] + 0.3})
    e, _ = expansion(network, record)
    np.testing.assert_allclose(e.theta, [0.8, 0.8, 9.0, 0.2, 0.3], atol=1e-9)
    assert magnitude(e, 1).weights == [3]
    assert obd(e, 1).weights == [2]  # heavy on an input that hardly moves
    twins = obs(e, 2)
    assert twins.weights[0] == 2
    assert twins.weights[1] in (0, 1)
    np.testing.assert_allclose(twins.theta[1 - twins.weights[1]], 1.6, atol=0.02)
    assert obd(e, 4).weights.tolist()[:3] == [2, 3, 4]


def test_multi_obs_is_blind_to_twins_where_obs_is_not():
    network, record = linear(np.array([[1.0, 1.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 1.0]]))
    u = record.inputs["u"]
    record = Record({"u": u}, {"y": u @ [1.0, 1.0, 0.1] + 1.0})
    e, _ = expansion(network, record)
    assert set(multi_obs(e, 2).weights) == {0, 1}
    assert set(obs(e, 2).weights) in ({0, 2}, {1, 2})


def test_unit_obs_takes_a_neuron_that_another_can_stand_in_for_and_gives_its_work_to_that():
    rng = np.random.default_rng(3)
    hidden, bias, out = rng.normal(size=(5, 3)), rng.normal(size=5), np.array([[1.0, 2.0, -1.0, 0.7, 1.5]])
    hidden[4], bias[4] = hidden[1], bias[1]
    network, record = two_layers(hidden, bias, out)
    e = Expansion.of(network, [record])
    removal = unit_obs(e, 1)
    [(name, index)] = names(e, removal.weights)
    assert name == "out.h"
    assert index in (1, 4)
    np.testing.assert_allclose(removal.theta[e.objective.slices()["out.h"]][5 - index], 3.5, atol=1e-3)
    smaller = fold_constants(e.objective.unpack(removal.theta))
    assert smaller.modules["hidden"].size == 4
    assert pooled_rms(smaller, [record]) < 1e-4
    assert len(unit_obs(e, 6).weights) == 2  # five parameters a neuron


def test_smallest_variance_takes_the_neuron_that_varies_least_and_leaves_its_mean():
    rng = np.random.default_rng(4)
    hidden, bias = rng.normal(size=(4, 3)), rng.normal(size=4)
    hidden[2] *= 1e-3
    bias[2] = 0.8
    network, record = two_layers(hidden, bias, np.array([[1.0, -1.0, 50.0, 0.5]]))  # heavy, so that OBD would keep it
    e = Expansion.of(network, [record])
    removal = smallest_variance(e, 1)
    assert names(e, removal.weights) == [("out.h", 2)]
    np.testing.assert_allclose(removal.theta[e.objective.slices()["out.bias"]], 0.1 + 50 * np.tanh(0.8), atol=1e-3)
    error = pooled_rms(e.objective.unpack(removal.theta), [record])
    np.testing.assert_allclose(error, np.sqrt(50**2 * removal.saliency[0]), rtol=1e-6)


@pytest.mark.parametrize("name", METHODS)
def test_no_method_touches_frozen_or_pruned_weights(name):
    rng = np.random.default_rng(5)
    out = np.array([[1.0, 0.0, 1e-9, 0.5]])
    network, record = two_layers(rng.normal(size=(4, 3)), rng.normal(size=4), out)
    layer = network.modules["hidden"]
    network.modules["hidden"] = Layer({"u": layer.weights["u"]}, layer.bias, "tansig", frozen={"u"})
    e = Expansion.of(network, [record])
    removal = METHODS[name](e, 100)
    assert len(removal.weights)
    assert {n for n, _ in names(e, removal.weights)} <= {"out.h", "hidden.bias", "out.bias"}
    place = e.objective.slices()["hidden.u"]
    np.testing.assert_array_equal(removal.theta[place], e.theta[place])
    assert e.theta[removal.weights].all()


def test_a_singular_hessian_is_named_and_a_ridge_mends_it():
    network, record = linear(np.diag([1.0, 0.0]))  # the second input is zero
    at = Objective(network, [record]).unpack(np.array([1.0, 2.0, 3.0]))
    with pytest.raises(InputError, match="singular"):
        obs(Expansion.of(at, [record], ridge=0.0), 1)
    removal = obs(Expansion.of(at, [record]), 1)
    assert removal.weights == [1]
    np.testing.assert_array_equal(removal.theta, [1.0, 0.0, 3.0])


# ---- the whole


def small_b2() -> tuple[Network, Record, Record]:
    """B2 on one hidden layer, trained briefly."""
    network = noe("b2", {Port("u"): (1, 2)}, Port("y"), (1, 2, 3), (8,), seed=1)
    record, held = (Record({"u": u}, {"y": b2(u)}) for u in (b2_input(), b2_input(1, 500)))
    fit = train(network, [record], teacher=True, epochs=40, decay=1e-4)
    return train(fit.network, [record], epochs=40, decay=1e-4).network, record, held


@pytest.fixture(scope="module")
def trained():
    return small_b2()


@pytest.mark.parametrize("name", METHODS)
def test_pruning_ends_within_the_allowed_error_and_every_earlier_network_can_be_had(name, trained):
    network, record, held = trained
    allowed = 1.3 * pooled_rms(network, [held])
    result = prune_by_saliency(network, [record], METHODS[name], allowed, held=[held], epochs=8, decay=1e-4)
    sizes = [s.parameters for s in result.steps]
    assert sizes == [parameter_count(s.network) for s in result.steps]
    assert (np.diff(sizes) < 0).all()
    assert result.network is result.steps[-1].network
    assert len(result.steps) == 1 + sum(r.kept for r in result.rounds)
    assert not result.rounds[-1].kept  # it went on until nothing could be spared
    for step in result.steps:
        assert step.held == tuple(pooled_rms(step.network, [held]))
        assert step.held <= tuple(allowed)
        assert result.at(step.parameters) is step.network
    assert result.at(sizes[0] + 5) is result.steps[0].network
    with pytest.raises(InputError, match=f"the smallest has {sizes[-1]}"):
        result.at(sizes[-1] - 1)
    if name in ("obs", "multi_obs"):
        assert sizes[-1] <= sizes[0] / 2


def test_pruned_weights_stay_zero_in_further_training(trained):
    network, record, _ = trained
    pruned = prune_by_saliency(network, [record], obs, np.inf, goal=40, epochs=3).network
    assert parameter_count(pruned) <= 40
    further = train(pruned, [record], epochs=3, free=nonzero(pruned)).network
    for name, value in further.parameters().items():
        np.testing.assert_array_equal(value != 0, pruned.parameters()[name] != 0)


def test_everything_may_go_and_a_constant_remains():
    network, record = two_layers(np.ones((2, 3)), np.ones(2), np.ones((1, 2)))
    for method in METHODS.values():
        last = prune_by_saliency(network, [record], method, np.inf, epochs=2).network
        assert parameter_count(last) <= 2
        assert np.ptp(last.run(record.inputs)["y"]) == 0


@pytest.mark.parametrize("name", METHODS)
def test_a_network_that_is_frozen_is_given_back(name):
    network, record = two_layers(np.ones((2, 3)), np.ones(2), np.ones((1, 2)))
    for path, layer in network.modules.items():
        network.modules[path] = replace(layer, frozen=frozenset({*layer.weights, "bias"}))
    result = prune_by_saliency(network, [record], METHODS[name], np.inf)
    assert (len(result.steps), result.rounds) == (1, ())


def test_a_network_that_diverges_is_named_before_pruning():
    network = noe("wild", {Port("u"): (0,)}, Port("y"), (1,), seed=0)
    network = network.with_parameters({"sum.y_z1": np.array([[2e3]]), "sum.bias": np.ones(1)})
    record = Record({"u": np.ones(400)}, {"y": np.ones(400)})
    with pytest.raises(InputError, match="diverges"):
        prune_by_saliency(network, [record], obs, 1.0)


def terms(network: Network, record: Record) -> tuple[int, int, int]:
    """Adders of the parallel architecture; weights and lines in the schedule of the folded one."""
    program = compile_network(network, {"record": record}).program
    adders = sum(int(n) for text in parallel(program).values() for n in re.findall(r"^// (\d+) adders", text, re.M))
    schedule = next(
        text for name, text in folded(program, Design(multipliers=1)).items() if name.endswith("schedule.v")
    )
    lines = re.findall(r"^ *rom\[\d+\] = .*'sd(\d+)};", schedule, re.M)
    return adders, sum(int(w) != 0 for w in lines), len(lines)


def test_zeroed_weights_and_dead_neurons_vanish_from_the_verilog_of_both_architectures():
    rng = np.random.default_rng(6)
    hidden, bias, out = rng.uniform(0.3, 0.9, (6, 3)), rng.uniform(0.1, 0.4, 6), rng.uniform(0.3, 0.9, (1, 6))
    network, record = two_layers(hidden, bias, out)
    adders, weights, before = terms(network, record)
    assert weights == 24
    zeroed_hidden, zeroed_out = hidden.copy(), out.copy()
    zeroed_hidden[0, 1] = zeroed_hidden[3, 0] = zeroed_hidden[3, 2] = 0.0
    zeroed_hidden[4] = 0.0  # a constant
    zeroed_out[0, 5] = 0.0  # read by nobody
    zeroed = network.with_parameters({"hidden.u": zeroed_hidden, "out.h": zeroed_out})
    fewer, weights, after = terms(zeroed, record)
    assert weights == 13  # 24 - 3 - (3 + 1) - (3 + 1)
    assert fewer < adders * 2 / 3
    assert after < before
    program = compile_network(zeroed, {"record": record}).program
    assert program.signals["hidden"].size == 4
    decoded = program.decode(run(program, program.encode(record.inputs)).outputs)["y"]
    np.testing.assert_allclose(decoded, zeroed.run(record.inputs)["y"], atol=1e-3)


def test_saliency_pruning_is_a_pass_of_the_compiler(trained):
    network, record, _ = trained
    prune = saliency_pruning([record], obs, 1.2, epochs=5, decay=1e-4)
    compiled = compile_network(network, {"record": record}, prune=prune)
    assert any(r.kept for r in compiled.pruning)
    assert pooled_rms(compiled.network, [record]) <= 1.2 * pooled_rms(network, [record])
    after, before = terms(compiled.network, record), terms(network, record)
    assert all(a < b for a, b in zip(after, before, strict=True))
