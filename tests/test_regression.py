import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.thesis.linear import armax, arx, bj, fir, oe
from benchmarks.thesis.noise import box_jenkins, free_run, narmax, with_measured
from greygate.errors import InputError
from greygate.models.families.regression import narx, nfir, noe, regressors
from greygate.models.network import Port
from greygate.models.training.levenberg import Outcome, train
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record

U, Y = Port("u", scale=2.0), Port("y", scale=4.0, initial=1.0)
PLAIN = {Port("u"): (1, 2)}, Port("y"), (1, 2)
A, B = [1.0, -1.5, 0.7], [0.0, 1.0, 0.5]  # poles at 0.84 exp(+-0.46j)
WEIGHTS = {"sum.u_z1": 1.0, "sum.u_z2": 0.5, "sum.y_z1": 1.5, "sum.y_z2": -0.7}


def plant(noise, samples=2000, seed=0):
    """y = B/A u + noise(e), with e white of variance one."""
    rng = np.random.default_rng(seed)
    u, e = rng.choice([-1.0, 1.0], samples), rng.normal(size=samples)
    return Record({"u": u}, {"y": lfilter(B, A, u) + noise(e)})


def errors(network, record, teacher):
    objective = Objective(network, [with_measured(record, network)], teacher=teacher)
    return objective.errors(objective.theta)[0][:, 0]


def by_hand(network, u, y, own):
    """Normalised y_hat of `small`; own: the network's output in the feedback, not the measured one."""
    p = network.parameters()
    u, y = np.r_[0, 0, u] / 2, np.r_[1, 1, y] / 4
    shown, e = [0.25, 0.25], [0.0, 0.0]
    for k in range(2, len(u)):
        past = shown if own else y
        taps = {"u_z0": u[k], "u_z2": u[k - 2], "y_z1": past[k - 1], "e_z1": e[k - 1], "e_z2": e[k - 2]}
        n = p["hidden1.bias"] + sum(p[f"hidden1.{t}"][:, 0] * v for t, v in taps.items())
        linear = sum(p[f"sum.{t}"][0, 0] * v for t, v in taps.items())
        shown.append(p["sum.bias"][0] + linear + p["sum.hidden1"][0] @ np.tanh(n))
        e.append(y[k] - shown[k])
    return np.array(shown[2:])


def small():
    network = narmax("small", {U: (0, 2)}, Y, (1,), (1, 2), (3,), seed=4)
    rng = np.random.default_rng(1)
    return network.with_parameters({n: 0.4 * rng.normal(size=w.shape) for n, w in free_weights(network).items()})


def free_weights(network):
    return {n: w for n, w in network.parameters().items() if n.partition(".")[2] not in network.modules["e"].frozen}


@pytest.mark.parametrize("teacher", [True, False])
def test_one_network_is_narmax_with_a_teacher_and_box_jenkins_of_table_3_1_without(teacher):
    u, y = np.random.default_rng(0).normal(size=(2, 50))
    found = errors(small(), Record({"u": u}, {"y": y}), teacher)
    np.testing.assert_allclose(found, by_hand(small(), u, y, own=not teacher) - y / 4, atol=1e-12)


def test_with_the_same_lags_both_are_one_model_in_other_coordinates():
    u, y = np.random.default_rng(0).normal(size=(2, 50))
    shifted = {f"{layer}.e_z1": small().parameters()[f"{layer}.e_z1"] for layer in ("hidden1", "sum")}
    for name in shifted:  # w_y y + w_e e = w_y y_hat + (w_y + w_e) e
        shifted[name] = shifted[name] + small().parameters()[name.replace("e_z", "y_z")]
    record = Record({"u": u}, {"y": y})
    narmax, nbj = errors(small(), record, True), errors(small().with_parameters(shifted), record, False)
    np.testing.assert_allclose(nbj, narmax, atol=1e-12)


def test_the_free_run_has_no_errors_and_needs_no_measurement():
    u = np.random.default_rng(0).normal(size=50)
    network = free_run(small())
    assert [p.name for p in network.inputs] == ["u"]
    noise_free = noe("same", {U: (0, 2)}, Y, (1,), (3,))
    kept = {n: w for n, w in small().parameters().items() if n in noise_free.parameters()}
    assert network.parameters().keys() == kept.keys()
    np.testing.assert_array_equal(network.run({"u": u})["y"], noise_free.with_parameters(kept).run({"u": u})["y"])
    plain = noe("plain", {U: (0, 2)}, Y, (1,), (3,))
    np.testing.assert_array_equal(free_run(plain).run({"u": u})["y"], plain.run({"u": u})["y"])


def test_the_names_of_table_3_1_make_these_regressors():
    taps = {U: (0, 1)}, Y

    def read(network):
        return {c.target for c in network.connections if c.target.startswith("hidden1.")}

    inputs = {"hidden1.u_z0", "hidden1.u_z1"}
    assert read(nfir("n", *taps, (2,))) == inputs
    assert narx is noe
    assert read(noe("n", *taps, (1, 2), (2,))) == inputs | {"hidden1.y_z1", "hidden1.y_z2"}
    assert read(narmax("n", *taps, (1,), (3,), (2,))) == inputs | {"hidden1.y_z1", "hidden1.e_z3"}
    linear_loop = noe("n", *taps, (1,), (2,), linear_loop=True)
    assert read(linear_loop) == inputs
    assert linear_loop.layers()["sum"].weights.keys() == {"u_z0", "u_z1", "y_z1", "hidden1"}


def test_without_a_bypass_it_is_the_network_of_the_thesis_with_its_341_parameters():
    network = noe("b2", {Port("u"): (1, 2)}, Port("y"), (1, 2, 3), (20, 10), bypass=False)
    assert sum(w.size for w in network.parameters().values()) == 341
    logistic = noe("l", {Port("u"): (1,)}, Port("y"), hidden=(2,), activation="logsig")
    assert logistic.layers()["hidden1"].activation == "logsig"


@pytest.mark.parametrize(("feedback", "noise"), [((0,), (1,)), ((1,), (0,))])
def test_a_loop_without_delay_is_refused(feedback, noise):
    with pytest.raises(InputError, match="the output's own at 1"):
        narmax("n", {U: (0,)}, Y, feedback, noise)


def test_arx_without_noise_finds_the_plant_itself():
    fit = arx([plant(lambda e: 0 * e)], *PLAIN)
    for name, value in (WEIGHTS | {"sum.bias": 0.0}).items():
        assert fit.network.parameters()[name].item() == pytest.approx(value, abs=1e-12)
    assert fit.outcome is Outcome.CONVERGED


def test_arx_is_where_the_trainer_goes_too():
    record = plant(lambda e: lfilter([1.0], A, e))
    fit = arx([record], *PLAIN)
    trained = train(noe("n", *PLAIN), [Record(record.inputs, record.targets, skip=2)], teacher=True)
    assert fit.history[-1] == pytest.approx(trained.history[-1], rel=1e-12)
    for name, value in trained.network.parameters().items():
        np.testing.assert_allclose(fit.network.parameters()[name], value, atol=1e-6)


def test_fir_finds_the_impulse_response_in_physical_units():
    u = np.random.default_rng(0).normal(size=300)
    response = [0.0, 2.0, -1.0, 0.5]
    record = Record({"u": u}, {"y": 3 + lfilter(response, [1.0], u)})
    network = fir([record], {U: (1, 2, 3)}, Y).network
    pulse = network.run({"u": np.r_[0, 0, 0, 1.0, 0, 0, 0]})["y"]
    np.testing.assert_allclose(pulse[3:] - 3, response, atol=1e-12)


def test_armax_finds_the_plant_under_coloured_noise_and_arx_does_not():
    record = plant(lambda e: lfilter([1.0, 0.9, 0.6], A, e), 4000)
    fits = {"arx": arx([record], *PLAIN), "armax": armax([record], *PLAIN, (1, 2))}
    off = {n: max(abs(fit.network.parameters()[w].item() - v) for w, v in WEIGHTS.items()) for n, fit in fits.items()}
    assert off["armax"] < 0.05 < 0.1 < off["arx"]
    noise = [fits["armax"].network.parameters()[f"sum.e_z{d}"].item() for d in (1, 2)]
    assert noise == pytest.approx([0.9, 0.6], abs=0.05)
    assert 2 * fits["armax"].history[-1] == pytest.approx(1.0, rel=0.05)  # nothing but e is left
    clean = plant(lambda e: 0 * e, seed=1)
    run = {n: free_run(fit.network).run(clean.inputs)["y"] - clean.targets["y"] for n, fit in fits.items()}
    assert np.std(run["armax"]) < 0.5 * np.std(run["arx"])


def test_output_error_finds_the_plant_under_white_noise_of_the_sensor_and_arx_does_not():
    record = plant(lambda e: e, 4000)
    fits = {"arx": arx([record], *PLAIN), "oe": oe([record], *PLAIN)}
    off = {n: max(abs(fit.network.parameters()[w].item() - v) for w, v in WEIGHTS.items()) for n, fit in fits.items()}
    assert off["oe"] < 0.03 < 0.1 < off["arx"]


def test_output_error_starts_from_an_unstable_arx_solution_too():
    u = np.ones(60)
    u[30:] = -1
    record = Record({"u": u}, {"y": np.exp(0.05 * np.arange(60.0)) + 0.3 * np.random.default_rng(0).normal(size=60)})
    start = arx([record], {Port("u"): (1,)}, Port("y"), (1,))
    assert start.network.parameters()["sum.y_z1"].item() > 1
    assert np.isfinite(oe([record], {Port("u"): (1,)}, Port("y"), (1,)).history[-1])


def test_box_jenkins_finds_plant_and_noise_filter_apart():
    record = plant(lambda e: lfilter([1.0, 0.5], [1.0, -0.9], 0.5 * e), 4000)
    fit = bj([record], *PLAIN, noise=(1,), shaping=(1,))
    found = fit.network.parameters()
    for name, value in WEIGHTS.items():
        assert found[name].item() == pytest.approx(value, abs=0.03), name
    # v = (1 + 0.5 z^-1) / (1 - 0.9 z^-1) e: v(k) = 0.9 v(k-1) + 0.5 e(k-1) + e(k)
    assert found["predicted.v_z1"].item() == pytest.approx(0.9, abs=0.03)
    assert found["predicted.e_z1"].item() == pytest.approx(0.5, abs=0.05)
    assert 2 * fit.history[-1] == pytest.approx(0.25, rel=0.05)


def test_a_noise_filter_leaves_the_free_run_of_its_plant_as_it_was():
    plant = noe("plant", {U: (0, 2)}, Y, (1,), (3,), seed=4)
    network = box_jenkins(plant, (1, 2), (1,))
    filtered = network.with_parameters({"predicted.v_z1": [[0.7]], "predicted.e_z2": [[0.2]]})
    u, y = np.random.default_rng(0).normal(size=(2, 50))
    np.testing.assert_array_equal(free_run(filtered).run({"u": u})["y"], plant.run({"u": u})["y"])
    record = Record({"u": u}, {"y": y})
    np.testing.assert_array_equal(errors(network, record, False), errors(plant, record, False))
    v, e = -errors(plant, record, False), -errors(filtered, record, False)
    np.testing.assert_allclose(e, v - 0.7 * np.r_[0, v[:-1]] - 0.2 * np.r_[0, 0, e[:-2]], atol=1e-12)
    with pytest.raises(InputError, match="delays of 1 or more"):
        box_jenkins(plant, (0,), ())


def test_several_inputs_and_records_are_rows_of_one_regression():
    rng = np.random.default_rng(0)
    ports = {Port("u"): (0, 2), Port("w", scale=10.0, offset=1.0): (1,)}
    records = []
    for _ in range(3):
        u, w = rng.normal(size=(2, 40))
        y = np.zeros(40)
        for k in range(2, 40):
            y[k] = 0.5 * y[k - 1] + u[k] - 0.25 * u[k - 2] + 2 * w[k - 1]
        records.append(Record({"u": u, "w": w}, {"y": y}))
    phi = regressors(records, ports, Port("y"), (1,))
    assert phi.taps == ("u_z0", "u_z2", "w_z1", "y_z1")
    assert phi.matrix.shape == (3 * 38, 4)
    assert phi.matrix[38, 2] == (records[1].inputs["w"][1] - 1) / 10
    found = arx(records, ports, Port("y"), (1,)).network.parameters()
    assert [found[f"sum.{t}"].item() for t in phi.taps] == pytest.approx([1, -0.25, 20, 0.5], abs=1e-12)


GOOD = np.random.default_rng(0).normal(size=50)


@pytest.mark.parametrize(
    ("u", "y", "message"),
    [
        (np.full(50, 0.3), GOOD, "u is constant.*vary it"),
        (np.sin(0.3 * np.arange(50)), GOOD, "u_z2 is collinear with u_z0, u_z1"),
        (GOOD, np.r_[0, GOOD[:-1]], "y_z1 is collinear with u_z2"),
        (GOOD[:7], GOOD[:7], "4 rows for 5 taps"),
        (GOOD[:3], GOOD[:3], "deepest tap, 3"),
        (np.r_[GOOD[:9], np.nan, GOOD[10:]], GOOD, "signal u: NaN or inf at sample 9 "),
        (GOOD, np.r_[GOOD[:49], np.inf], "signal y: NaN or inf at sample 49"),
        (GOOD[:40], GOOD, "input u: 40 samples where y has 50"),
        (GOOD[:, None], GOOD, r"u: \(50, 1\); give one number a sample"),
    ],
)
def test_what_keeps_a_regression_from_one_answer_is_named(u, y, message):
    with pytest.raises(InputError, match=message):
        arx([Record({"u": u}, {"y": y})], {Port("u"): (0, 1, 2)}, Port("y"), (1, 3))


@pytest.mark.parametrize(
    ("fit", "orders"), [(arx, ((1,),)), (armax, ((1,), (1,))), (oe, ((1,),)), (bj, ((1,), (1,), (1,))), (fir, ())]
)
def test_an_error_names_the_model_that_was_asked_for(fit, orders):
    with pytest.raises(InputError, match=f"^{fit.__name__}: u is constant"):
        fit([Record({"u": np.ones(50)}, {"y": GOOD})], {U: (1,)}, Y, *orders)


@pytest.mark.parametrize("hidden", [(), (3,)])
def test_outputs_of_one_vector_port_are_learnt_together(hidden):
    u = np.random.default_rng(0).normal(size=(400, 2))
    y = np.zeros((400, 2))
    a, b = np.array([[0.6, -0.3], [0.2, 0.5]]), np.array([[1.0, 0.2], [0.0, -0.5]])
    for k in range(1, 400):
        y[k] = a @ y[k - 1] + b @ u[k - 1]
    network = noe("pair", {Port("u", size=2): (1,)}, Port("y", size=2), (1,), hidden)
    trained = train(network, [Record({"u": u}, {"y": y})], epochs=60).network
    np.testing.assert_allclose(trained.run({"u": u})["y"], y, atol=1e-3)
    if not hidden:
        np.testing.assert_allclose(trained.parameters()["sum.y_z1"], a, atol=1e-4)


def test_errors_of_a_vector_output_are_measured_each():
    network = narmax("pair", {U: (1,)}, Port("y", size=2), (1,), (1,))
    y = np.random.default_rng(0).normal(size=(30, 2))
    weights = network.parameters() | {"sum.y_z1": np.zeros((2, 2)), "sum.e_z1": np.eye(2)}
    record = with_measured(Record({"u": np.zeros(30)}, {"y": y}), network)
    got = network.with_parameters(weights).run(record.inputs)["y"]
    expected = np.zeros((30, 2))
    for k in range(1, 30):
        expected[k] = y[k - 1] - expected[k - 1]
    np.testing.assert_allclose(got, expected, atol=1e-12)


def test_a_signal_that_is_missing_is_named():
    with pytest.raises(InputError, match=r"u .* is missing; given: v"):
        arx([Record({"v": GOOD}, {"y": GOOD})], *PLAIN)


def test_names_stand_for_ports_one_number_for_a_layer_and_one_record_for_a_list():
    short = noe("mine", {"u": (1, 2)}, "y", (1, 2), hidden=4)
    long = noe("mine", {Port("u"): (1, 2)}, Port("y"), (1, 2), hidden=(4,))
    assert short.inputs == long.inputs
    assert all(np.array_equal(v, long.parameters()[n]) for n, v in short.parameters().items())
    u = np.sin(np.arange(60.0))
    record = Record({"u": u}, {"y": 0.5 * u})
    one, listed = (train(short, r, epochs=2).history for r in (record, [record]))
    assert one == listed


@pytest.mark.parametrize("given", [{"inputs": {"u": 1}}, {"feedback": 2}, {"feedback": "12"}])
def test_what_is_no_list_of_delays_is_refused_by_the_name_of_its_argument(given):
    with pytest.raises(InputError, match=f"{next(iter(given))} .* is no list of delays"):
        noe("mine", **{"inputs": {"u": (1,)}, "output": "y", "feedback": (1,), **given})
