"""Networks of states: they begin as a linear model of taps, at any stride, and hold what taps cannot."""

import pickle
from dataclasses import replace
from functools import partial
from time import process_time, sleep

import numpy as np
import pytest
from scipy.signal import lfilter

from greygate.children import workers
from greygate.errors import InputError
from greygate.identify import fitted, halving
from greygate.identify.clock import Clock, Deadline
from greygate.identify.ladder import FORMS, LINEAR, Form, Orders, falling
from greygate.identify.states import balanced, pulled, realised, states
from greygate.identify.task import task
from greygate.identify.tried import STATE, SURE, Model, Tried, sure_of, surely
from greygate.plants.recording import Recording

SPACES = [f for f in FORMS if f.states]


def recorded(seed: int, samples: int = 600, noise: float = 0.002) -> Recording:
    """Two filters with a curve between them, two samples late; another input acts by itself."""
    random = np.random.default_rng(seed)
    u, w = lfilter([0.4], [1, -0.6], random.normal(size=(2, samples)))
    between = np.tanh(5 * lfilter([0, 0, 0, 0.5], [1, -0.5], u))
    y = lfilter([0.2], [1, -1.5, 0.7], between) + lfilter([0, 0.1], [1, -0.8], w)
    return Recording(0.1, {"u": u, "w": w, "y": y + noise * random.normal(size=samples)}, dict.fromkeys("uwy", "V"))


def line(posed, orders: Orders, **weights):
    network = LINEAR.build(orders, posed.inputs, posed.output, 0)
    return network.with_parameters({name: np.array([[w]]) for name, w in weights.items()} | {"state.bias": [0.02]})


@pytest.mark.parametrize(
    "orders",
    [Orders(1, (0, 0)), Orders(2, (2, 0)), Orders(3, (0, 1)), Orders(2, (0, 0), 4)],
    ids=["first", "late", "third", "apart"],
)
@pytest.mark.parametrize("form", SPACES, ids=lambda f: f"{f.states}+{f.after}")
def test_a_network_of_states_begins_as_its_linear_model(form, orders):
    posed = task({"a": recorded(1)}, ["u", "w"], "y")
    poles = dict(zip(orders.feedback, (1.1, -0.3, 0.02), strict=False)) if orders.order > 1 else {1: 0.8}
    taps = {f"state.u_z{orders.delays[0]}": 0.3, f"state.w_z{orders.delays[1] + orders.stride}": 0.2}
    linear = line(posed, orders, **taps, **{f"state.y_z{d}": w for d, w in poles.items()})
    record = next(iter(posed.records.values()))
    held = {n: np.repeat(v[::20], 20)[: len(v)] for n, v in record.inputs.items()}  # by the slower model, too
    network = states(form, orders, posed.inputs, posed.output, linear, [record], 0)
    expected, run = linear.run(held)["y"], network.run(held)["y"]
    assert np.abs(run - expected)[60 :: orders.stride].max() < 0.1 * np.std(expected)
    read = {n: np.zeros_like(w) for n, w in network.parameters().items() if n.endswith("neurons")}
    run = network.with_parameters(read).run(held)["y"]
    np.testing.assert_allclose(run[200 :: orders.stride], expected[200 :: orders.stride], atol=1e-6 * np.std(expected))
    assert falling(network, orders, posed.output) == pytest.approx(falling(linear, orders, posed.output), rel=1e-6)


def test_a_root_that_is_not_real_is_refused():
    posed = task({"a": recorded(1)}, ["u", "w"], "y")
    orders = Orders(1, (0, 0), 2)
    with pytest.raises(InputError, match="no real root"):
        realised(line(posed, orders, **{"state.y_z2": -0.5}), orders, posed.inputs, posed.output)


def test_balanced_states_are_as_easily_driven_as_seen():
    posed = task({"a": recorded(1)}, ["u", "w"], "y")
    orders = Orders(2, (0, 0))
    weights = {"state.u_z1": 0.3, "state.w_z2": 0.1, "state.y_z1": 1.2, "state.y_z2": -0.5}
    space = balanced(realised(line(posed, orders, **weights), orders, posed.inputs, posed.output))
    driven, seen = np.zeros((2, 2)), np.zeros((2, 2))
    for k in range(400):
        power = np.linalg.matrix_power(space.a, k)
        driven += power @ space.b @ space.b.T @ power.T
        seen += power.T @ space.c.T @ space.c @ power
    np.testing.assert_allclose(driven, seen, atol=1e-9 * driven.max())
    assert abs(driven[0, 1]) < 1e-9 * driven[0, 0]


def test_states_hold_a_curve_between_two_filters():
    given, other = recorded(1, 1500), recorded(2, 1500, noise=0.0)
    posed = task({"a": given}, ["u", "w"], "y")
    orders, records = Orders(4, (2, 0)), list(posed.records.values())
    rung = replace(halving.LADDER, epochs=150)
    linear = fitted.linear(posed, Model(LINEAR, orders, 0.0), None, records, rung, np.inf).network
    model = Model(next(f for f in SPACES if f.states == 8 and f.after == 8), orders, STATE[0])
    found = fitted.network(posed, model, linear, [], records, rung, Deadline()).network
    error, straight = (np.std(posed.errors(n, posed.record(other))) for n in (found, linear))
    assert error < 0.2 * straight


def test_only_neurons_and_what_reads_them_are_pulled_to_zero():
    posed = task({"a": recorded(1)}, ["u", "w"], "y")
    orders, records = Orders(2, (0, 0)), [*posed.records.values()]
    linear = line(posed, orders, **{"state.u_z0": 1.0, "state.y_z1": 0.5})
    network = states(Form("x", states=3, after=2), orders, posed.inputs, posed.output, linear, records, 0)
    assert pulled(network, 0.5) == dict.fromkeys(
        ["states_neurons", "neurons", "states.states_neurons", "state.neurons"], 0.5
    )


def test_states_that_grow_are_judged_as_a_model_that_diverges():
    posed = task({"a": recorded(1)}, ["u", "w"], "y")
    model = Model(SPACES[0], Orders(1, (0, 0)))
    linear, records = line(posed, model.orders, **{"state.u_z0": 1.0, "state.y_z1": 0.5}), [*posed.records.values()]
    network = states(model.form, model.orders, posed.inputs, posed.output, linear, records, 0)
    assert not fitted.grows(model, network, posed)
    assert fitted.grows(model, network.with_parameters({"states.past": [[1.2]]}), posed)


def test_a_network_is_chosen_only_where_it_is_surely_better_than_a_line():
    posed = task({"a": recorded(1)}, ["u", "w"], "y")
    search, random = halving.Halving(posed, np.inf, 1), np.random.default_rng(0)
    network = LINEAR.build(Orders(1, (0, 0)), posed.inputs, posed.output, 0)

    def tried(form: Form, error: float, rung: int) -> Tried:
        model = Model(form, Orders(1, (0, 0)), 0.0)
        return Tried(model, rung, {0: network}, {0: [error * random.normal(size=40)]}, 0.0)

    straight, near, far = tried(LINEAR, 1.0, 0), tried(SPACES[0], 0.9, 3), tried(SPACES[1], 0.2, 3)
    search.tried = {t.model: t for t in (straight, near)}
    assert search.chosen() is straight
    search.tried[far.model] = far
    assert search.chosen() is far


def test_a_network_whose_folds_answer_apart_is_not_chosen():
    """However small its error: what is not known of larger inputs shows where networks of all folds part."""
    posed = task({"a": recorded(1)}, ["u", "w"], "y")
    search, orders = halving.Halving(posed, np.inf, 1), Orders(1, (0, 0))
    model = Model(SPACES[0], orders)
    linear, records = line(posed, orders, **{"state.u_z0": 1.0, "state.y_z1": 0.5}), [*posed.records.values()]
    alike = states(model.form, orders, posed.inputs, posed.output, linear, records, 0)
    (neurons,) = (n for n in alike.parameters() if n.startswith("states.") and n.endswith("neurons"))
    bent = alike.with_parameters({neurons: 3.0 * np.ones_like(alike.parameters()[neurons])})

    def tried(model: Model, networks, error: float) -> Tried:
        errors = {k: [np.full(40, error)] for k in range(2)}
        return Tried(model, 3, dict(enumerate(networks)), errors, 0.0)

    straight = tried(Model(LINEAR, orders, 0.0), [linear, linear], 0.1)
    one, other = tried(model, [alike, alike], 0.01), tried(model, [alike, bent], 0.01)
    assert search.agrees(one, straight)
    assert not search.agrees(other, straight)
    assert search.agrees(tried(model, [alike, bent, alike], 0.01), straight)  # one may be odd
    assert search.odd(one, alike, straight) is None
    found = search.odd(replace(one, errors={0: [np.full(40, 9.0)]}), bent, straight)
    assert found is not None
    assert found.network is alike
    for network in (one, other):
        search.tried = {t.model: t for t in (straight, network)}
        assert search.chosen() is (one if network is one else straight)
    shifted = linear.with_parameters({"state.bias": [1.0]})
    assert fitted.distances(posed, [linear, linear], 0.5, 1.5).tolist() == [0.0, 0.0]
    assert fitted.distances(posed, [linear, shifted], 0.0, 1.0).min() > 0.3 * posed.output.scale
    runaway = linear.with_parameters({"state.y_z1": [[9.0]]})
    assert fitted.distances(posed, [linear, linear, runaway], 0.0, 1.0)[2] > 1e9


def test_a_network_that_fails_over_one_stretch_alone_is_better_too():
    posed = task({"a": recorded(1)}, ["u", "w"], "y")
    network = LINEAR.build(Orders(1, (0, 0)), posed.inputs, posed.output, 0)

    def tried(form: Form, errors) -> Tried:
        model = Model(form, Orders(1, (0, 0)), 0.0)
        return Tried(model, 0, {0: network}, {k: [np.full(40, e)] for k, e in enumerate(errors)}, 0.0)

    straight = tried(LINEAR, [1.0] * 8)
    wild, wilder = (tried(SPACES[0], [0.3] * 7 + [last]) for last in (2.7, 3.5))
    assert sure_of(wild, straight, range(8)) < SURE
    assert surely(wild, straight, range(8))
    assert not surely(wilder, straight, range(8))
    assert not surely(tried(SPACES[0], [0.9] * 5 + [1.15] * 3), straight, range(8))


# ---- seconds of the processor


def busy(clock: Clock, seconds: float) -> int:
    began = process_time()
    clock.note()
    while process_time() - began < seconds:
        pass
    clock.note()
    return 1


def test_a_clock_counts_what_all_processes_work_and_no_waiting():
    clock = Clock()
    sleep(0.3)
    assert clock.spent() < 0.2
    assert sum(workers(2, [partial(busy, clock, 0.2)] * 3)) == 3
    assert 0.6 < clock.spent() < 2.0
    assert Deadline(clock, 100.0, 2).left == pytest.approx((100 - clock.spent()) / 2, abs=0.1)
    assert Deadline().left == np.inf


def test_a_worker_leaves_the_file_of_a_clock_and_one_elsewhere_counts_the_wall():
    clock = Clock()
    there = pickle.loads(pickle.dumps(clock))
    there.note()
    del there
    assert clock.file.exists()
    there = pickle.loads(pickle.dumps(clock))
    file = clock.file
    del clock
    assert not file.exists()
    sleep(0.05)
    assert there.spent() >= 0.05


def test_where_an_output_may_rest_anywhere_states_integrate():
    posed = task({"a": recorded(1)}, ["u", "w"], "y")
    search = halving.Halving(posed, np.inf, 1)
    network = LINEAR.build(Orders(1, (0, 0)), posed.inputs, posed.output, 0)

    def tried(error: float, **orders) -> None:
        model = Model(LINEAR, Orders(1, (0, 0), **orders), 0.0)
        search.tried[model] = Tried(model, 0, {0: network}, {0: [np.full(40, error)]}, 0.0)

    tried(0.5)
    assert [o.integrating for o in search.spaces()] == [False]
    tried(1.0, step=0.1)
    assert [o.integrating for o in search.spaces()] == [True]
