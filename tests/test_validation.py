"""Validation says what is right of a right model, and finds what is wrong with a wrong one."""

import json
from collections.abc import Mapping

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

from greygate.errors import InputError
from greygate.models.families.regression import noe
from greygate.models.network import Layer, Network, Port
from greygate.models.residuals import correlation, residual_tests
from greygate.models.spectra import octaves
from greygate.models.training.levenberg import train
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record
from greygate.models.validation import REPETITIONS, coverage, fit_per_cent, validate

PERIOD = 1e-2


def linear(feedback=(0.5,), taps=(1.0, 0.5), gain=1.0) -> Network:
    """y(k) = sum feedback_i y(k-i) + gain sum taps_i u(k-i), i from 1."""
    network = noe("arx", {Port("u", "V", 2.0): range(1, 1 + len(taps))}, Port("y", "m", 4.0, 1.0, initial=1.0),
                  range(1, 1 + len(feedback)))  # fmt: skip
    values = {f"sum.u_z{i}": np.array([[gain * b * 2 / 4]]) for i, b in enumerate(taps, 1)}
    values |= {f"sum.y_z{i}": np.array([[a]]) for i, a in enumerate(feedback, 1)}
    return network.with_parameters(values)


def held(samples: int, seed: int, hold: int = 1) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).uniform(-1, 1, -(-samples // hold)), hold)[:samples]


def record(samples=4000, seed=0, equation_noise=0.0, output_noise=0.0, hold=1) -> Record:
    """What `linear()` says of the plant is true; u as held, y starts at its rest, 1."""
    u = held(samples, seed, hold)
    e, v = np.random.default_rng(1000 + seed).normal(size=(2, samples))
    x = lfilter([0, 1, 0.5], [1, -0.5], u) + equation_noise * lfilter([1], [1, -0.5], e)
    return Record({"u": u}, {"y": 1.0 + x + output_noise * v})


def test_a_perfect_model_fits_to_100_per_cent_in_free_run_and_at_every_horizon():
    (v,) = validate(linear(), {"run": record()}, period=PERIOD)
    assert v.rms < 1e-14
    assert v.fit == pytest.approx(100)
    assert v.ahead[100][1] == pytest.approx(100)
    assert v.long_run.stable
    np.testing.assert_allclose(v.response["magnitude"], 1, rtol=1e-9)


def test_figures_are_those_of_a_free_run_in_the_unit_of_the_output():
    r = record(equation_noise=0.3)
    network = linear(gain=0.9)
    (v,) = validate(network, {"run": Record(r.inputs, r.targets, skip=100)}, period=PERIOD)
    e = (r.targets["y"] - network.run(r.inputs)["y"])[100:]
    y = r.targets["y"][100:]
    assert v.samples == 3900
    assert v.rms == pytest.approx(np.sqrt(np.mean(e**2)), rel=1e-12)
    assert v.worst == pytest.approx(np.abs(e).max(), rel=1e-12)
    assert v.fit == pytest.approx(100 * (1 - np.linalg.norm(e) / np.linalg.norm(y - y.mean())), rel=1e-12)
    np.testing.assert_allclose(v.predicted, network.run(r.inputs)["y"], atol=1e-12)


def test_k_steps_ahead_is_the_recursion_that_starts_from_what_was_measured():
    r = record(600, equation_noise=0.3)
    network = linear(feedback=(0.6, -0.2), taps=(0.8,))
    (v,) = validate(network, {"run": r}, period=PERIOD, horizons=(1, 2, 7))
    u, y = r.inputs["u"], r.targets["y"] - 1.0
    for k, (rms, fit) in v.ahead.items():
        last = len(y) - (1 if k == 1 else 7)
        residual, measured = [], []
        for t in range(last + 1):  # y is known before t
            past = [y[i] if i >= 0 else 0.0 for i in (t - 2, t - 1)]
            for i in range(t, t + k):
                past.append(0.6 * past[-1] - 0.2 * past[-2] + (0.8 * u[i - 1] if i > 0 else 0.0))
            residual.append(y[t + k - 1] - past[-1])
            measured.append(y[t + k - 1])
        assert rms == pytest.approx(np.sqrt(np.mean(np.square(residual))), rel=1e-9)
        assert fit == pytest.approx(100 * (1 - np.linalg.norm(residual) / np.linalg.norm(measured - np.mean(measured))))


def test_one_step_ahead_is_series_parallel_and_far_ahead_comes_near_the_free_run():
    r = record(equation_noise=0.3)
    network = linear(gain=0.9)
    (v,) = validate(network, {"run": r}, period=PERIOD)
    objective = Objective(network, [r], teacher=True)
    taught = 4.0 * objective.errors(objective.theta)[0][:, 0]
    np.testing.assert_allclose(v.measured - v.one_step, -taught, atol=1e-12)
    assert v.ahead[1][0] == pytest.approx(np.sqrt(np.mean(taught**2)), rel=1e-12)
    rms = [rms for rms, _ in v.ahead.values()]
    assert rms[0] < rms[1] < rms[2]
    assert rms[-1] == pytest.approx(v.rms, rel=0.1)


def test_a_hidden_state_starts_where_measured_outputs_have_brought_it():
    """The output feeds a filter with a state of its own, which feeds the output: exact if the state is followed."""
    network = Network("hidden", [Port("u")], [Port("y")])
    network.add("state", Layer({"s": [[0.9]], "y": [[0.1]]}, [0.0]))
    network.add("sum", Layer({"u": [[1.0]], "s": [[-0.5]]}, [0.0]))
    network.connect("state", "state.s", 1)
    network.connect("sum", "state.y", 1)
    network.connect("u", "sum.u", 1)
    network.connect("state", "sum.s")
    network.connect("sum", "y")
    u = held(1000, 0)
    r = Record({"u": u}, network.run({"u": u}))
    (v,) = validate(network, {"run": r}, period=PERIOD, horizons=(1, 10))
    assert v.ahead[1][0] < 1e-14
    assert v.ahead[10][0] < 1e-14


def test_without_an_output_in_the_feedback_there_is_the_free_run_alone():
    network = noe("fir", {Port("u"): (1, 2)}, Port("y"), ())
    (v,) = validate(network, {"run": record()}, period=PERIOD)
    assert v.ahead == {}
    assert v.one_step is None
    assert set(v.tests) == {"free run"}


# -- residual tests ----------------------------------------------------------------------------------------------------


def share_outside(residual, hold: int, runs: int = 100, samples: int = 2000) -> dict[str, tuple[float, float]]:
    """Share of lags outside (the band, the plain band), and of failed tests, by test, over seeds."""
    found = {}
    with threadpool_limits(1, "blas"):
        for seed in range(runs):
            for test in residual_tests(residual(seed, samples), {"u": held(samples, seed, hold)}):
                beyond = np.mean(np.abs(test.values) > test.plain)
                found.setdefault(test.name, []).append((test.outside / len(test.lags), beyond, not test.passed))
    return {name: tuple(np.mean(values, axis=0)) for name, values in found.items()}


def white(seed, samples):
    return np.random.default_rng(5000 + seed).normal(size=samples)


@pytest.mark.parametrize("hold", [1, 10])
def test_of_a_white_residual_5_per_cent_of_the_lags_lie_outside(hold):
    found = share_outside(white, hold)
    assert set(found) == {"phi_ee", "phi_ue u", "phi_u2e u", "phi_u2e2 u", "phi_eeu u"}
    for name, (outside, plain, failed) in found.items():
        assert outside == pytest.approx(0.05, abs=0.015), name
        assert plain == pytest.approx(0.05, abs=0.015), name
        assert failed <= 0.04, name  # 1 % are meant to


def test_a_coloured_residual_fails_whiteness_alone_and_the_plain_band_would_blame_the_input():
    def coloured(seed, samples):
        return lfilter([1], [1, -0.9], white(seed, samples))

    found = share_outside(coloured, 10)
    assert found["phi_ee"][2] == 1
    for name in ("phi_ue u", "phi_u2e u", "phi_u2e2 u"):
        outside, plain, failed = found[name]
        assert outside == pytest.approx(0.05, abs=0.025), name
        assert failed <= 0.04, name
        assert plain > 0.3, name


def test_a_right_model_passes_and_one_that_lacks_a_lag_says_which():
    right, lacking = linear(), linear(taps=(1.0,))
    runs = {str(seed): record(2000, seed=seed, equation_noise=2.0) for seed in range(20)}
    passed = [t.passed for v in validate(right, runs, period=PERIOD, horizons=(1,)) for t in v.tests["one step ahead"]]
    assert np.mean(passed) >= 0.96  # 1 % are meant to fail
    innocent = []
    for v in validate(lacking, runs, period=PERIOD, horizons=(1,)):
        found = {t.name: t for t in v.tests["one step ahead"]}
        blamed = found.pop("phi_ue u")
        assert not blamed.passed
        assert blamed.lags[np.argmax(blamed.values)] == 2
        innocent += [t.passed for name, t in found.items() if name != "phi_ee"]
    assert np.count_nonzero(np.logical_not(innocent)) <= 1  # of 60, each of which is meant to fail in 1 %


def test_what_chance_may_bring_about_does_not_hang_on_the_eigenvectors_that_a_processor_takes(monkeypatch):
    """Their signs, and their order, are free; the limits are not."""

    def other(matrix):
        values, vectors = eigh(matrix)
        return values[::-1], -vectors[:, ::-1]

    u, e = held(2000, 3), lfilter([1], [1, -0.9], white(3, 2000))
    here = residual_tests(e, {"u": u})
    monkeypatch.setattr("greygate.models.residuals.eigh", other)
    for one, another in zip(here, residual_tests(e, {"u": u}), strict=True):
        assert one.allowed == another.allowed
        assert one.limit == pytest.approx(another.limit, rel=1e-9)


def test_an_even_term_and_a_product_with_noise_are_seen_by_the_higher_orders():
    u, e = held(4000, 1), white(1, 4000)
    shifted = np.roll(u, 3)

    def failed(residual):
        return {t.name for t in residual_tests(residual, {"u": u}) if not t.passed}

    assert "phi_u2e u" in failed(e + 2 * shifted**2)
    assert "phi_ue u" not in failed(e + 2 * shifted**2)
    assert "phi_u2e2 u" in failed(e * (0.2 + np.abs(shifted)))
    assert "phi_eeu u" in failed(e + 0.8 * np.roll(e * u, 1))
    assert "phi_eeu u" not in failed(e)


def test_a_correlation_is_that_of_the_thesis():
    u, e = held(300, 1), white(1, 300)
    found = correlation("phi_ue", u, e, np.array([-4, 0, 7]))
    du, de = u - u.mean(), e - e.mean()
    for lag, value in zip(found.lags, found.values, strict=True):
        pairs = [du[k - lag] * de[k] for k in range(300) if 0 <= k - lag < 300]
        assert value == pytest.approx(sum(pairs) / np.sqrt(np.sum(du**2) * np.sum(de**2)), rel=1e-9)
    assert found.plain == 1.96 / np.sqrt(300)


def test_what_does_not_move_is_not_tested():
    e, samples = white(0, 500), 500
    assert [t.name for t in residual_tests(e, {"u": np.full(samples, 3.0)})] == ["phi_ee"]
    binary = [t.name for t in residual_tests(e, {"u": np.sign(held(samples, 0) - np.median(held(samples, 0)))})]
    assert binary == ["phi_ee", "phi_ue u", "phi_eeu u"]
    assert residual_tests(np.zeros(samples), {"u": held(samples, 0)}) == ()


# -- the long run ------------------------------------------------------------------------------------------------------


def test_the_long_run_is_the_free_run_over_the_record_again_and_again():
    r = record(400, equation_noise=0.2)
    network = linear(feedback=(0.995,), taps=(0.1,))
    (v,) = validate(network, {"run": r}, period=PERIOD)
    many = network.run({"u": np.tile(r.inputs["u"], REPETITIONS)})["y"].reshape(REPETITIONS, -1)
    e = (many - r.targets["y"])[:, 200:]
    np.testing.assert_allclose(v.long_run.rms, np.sqrt(np.mean(e**2, axis=1)), rtol=1e-8)
    u = r.inputs["u"]
    louder = network.run({"u": np.tile(u.mean() + 1.2 * (u - u.mean()), REPETITIONS)})["y"].reshape(REPETITIONS, -1)
    y = r.targets["y"]
    reach = np.abs(louder - y.mean())[:, 200:].max(axis=1) / (np.ptp(y) / 2)
    np.testing.assert_allclose(v.long_run.reach[1], reach, rtol=1e-8)


@pytest.mark.parametrize(
    ("pole", "bounded", "stable"), [(0.9, True, True), (0.9999, True, False), (1.05, False, False)]
)
def test_a_loop_that_grows_is_unbounded_and_one_that_drifts_is_not_stable(pole, bounded, stable):
    u = held(1000, 0)
    u += (0.001 if pole == 0.9999 else 0.0) - u.mean()
    y = lfilter([0, 1], [1, -0.9], u)
    network = linear(feedback=(pole,), taps=(1.0,))
    (v,) = validate(network, {"run": Record({"u": u}, {"y": y + 1.0})}, period=PERIOD)
    assert (v.long_run.bounded, v.long_run.stable) == (bounded, stable)
    assert v.bounded == bounded


def test_a_free_run_that_diverges_has_no_figures_but_a_prediction_one_step_ahead():
    u = held(3000, 0)
    r = Record({"u": u}, {"y": 1.0 + lfilter([0, 1], [1, -0.9], u)})
    (v,) = validate(linear(feedback=(2.0,), taps=(1.0,)), {"run": r}, period=PERIOD)
    assert v.rms == v.worst == np.inf
    assert v.fit == -np.inf
    assert not v.bounded
    assert v.response is None
    assert set(v.tests) == {"one step ahead"}
    assert np.isfinite(v.ahead[1][0])
    assert v.ahead[1][0] < v.ahead[10][0]


# -- shape and bad input -----------------------------------------------------------------------------------------------


def test_every_output_of_every_record_is_judged_vectors_by_element():
    network = Network("two", [Port("u", size=2)], [Port("p", "Pa", 1e5, size=2), Port("x", "m")])
    network.add("state", Layer({"u": np.eye(2), "p": 0.5 * np.eye(2)}, [0, 0]))
    network.add("out", Layer({"p": [[1.0, 1.0]]}, [0.0]))
    network.connect("u", "state.u")
    network.connect("state", "state.p", 1)
    network.connect("state", "out.p")
    network.connect("state", "p")
    network.connect("out", "x")
    u = np.random.default_rng(0).normal(size=(400, 2))
    y = network.run({"u": u})
    y = {n: v + 0.1 * np.std(v) * np.random.default_rng(1).normal(size=v.shape) for n, v in y.items()}
    runs = {"a": Record({"u": u}, y), "b": Record({"u": u[:300]}, {n: v[:300] for n, v in y.items()})}
    found = validate(network, runs, period=PERIOD)
    assert [(v.record, v.output, v.unit) for v in found] == [
        (r, o, unit) for r in "ab" for o, unit in (("p[0]", "Pa"), ("p[1]", "Pa"), ("x", "m"))
    ]
    for v in found:
        assert v.rms == pytest.approx(0.1 * v.spread, rel=0.15)
        assert len(v.tests["free run"]) == 9


def test_figures_are_json_once_infinities_are_gone():
    from greygate.plain import plain

    (v,) = validate(linear(), {"run": record(500, equation_noise=0.1)}, period=PERIOD)
    figures = plain(v.figures())
    assert json.loads(json.dumps(figures, allow_nan=False)) == figures
    assert figures["tests"]["free run"][0]["outside"] == v.tests["free run"][0].outside
    assert figures["ahead"]["1"][0] == v.ahead[1][0]
    assert "measured" not in figures


class Columns(Mapping):
    """A mapping that is no dict, and so knows no `|`."""

    def __init__(self, columns):
        self.columns = columns

    def __getitem__(self, name):
        return self.columns[name]

    def __iter__(self):
        return iter(self.columns)

    def __len__(self):
        return len(self.columns)


def test_a_record_may_hold_its_signals_in_any_mapping():
    network = noe("lag", {Port("u"): (0,)}, Port("y"), (1,))
    u = np.sin(np.arange(60.0))
    record = Record({"u": u}, network.run({"u": u}))
    other = Record(Columns(record.inputs), Columns(record.targets), Columns({}))
    one, two = (coverage(network, {"a": r}, ["a"]) for r in (record, other))
    assert one == two
    shot = [train(network, [r], epochs=4, shooting=20).history for r in (record, other)]
    assert shot[0] == shot[1]


def test_coverage_is_the_share_of_samples_beyond_the_training_records():
    a, b = record(1000, 1), record(1000, 2)
    b.inputs["u"][:250] *= 100
    found = {(c.signal, c.record): c for c in coverage(linear(), {"a": a, "b": b}, ["a"])}
    assert found["u", "a"].outside == 0
    assert found["u", "b"].outside == pytest.approx(0.25, abs=0.01)
    assert found["u", "b"].trained == (a.inputs["u"].min(), a.inputs["u"].max())
    assert found["y", "b"].unit == "m"


def spoilt(r: Record, **inputs) -> Record:
    return Record(r.inputs | inputs, r.targets)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: validate(linear(), {}, period=PERIOD), "no records"),
        (
            lambda: validate(linear(), {"a": record(100)}, period=PERIOD),
            "record a: 100 samples are too few for 25 lags",
        ),
        (lambda: validate(linear(), {"a": record(1000)}, period=PERIOD, lags=0), "0 lags"),
        (lambda: validate(linear(), {"a": record(1000)}, period=PERIOD, horizons=()), "horizons"),
        (lambda: validate(linear(), {"a": spoilt(record(), u=np.full(4000, np.nan))}, period=PERIOD), "NaN or inf"),
        (lambda: validate(linear(), {"a": Record({}, record().targets)}, period=PERIOD), "input u .* missing"),
        (lambda: validate(linear(), {"a": Record(record().inputs, {})}, period=PERIOD), "target y .* missing"),
    ],
)
def test_what_cannot_be_judged_is_named(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_the_fit_to_a_constant_is_no_number():
    assert np.isnan(fit_per_cent(np.ones(5), np.ones(5)))


def test_octaves_share_the_error_and_say_when():
    rng, period = np.random.default_rng(0), 0.01
    signal = rng.standard_normal(4096)
    error = np.zeros(4096)
    error[3000:3040] = 0.5 * np.sin(np.pi * (np.arange(40) + 0.5))  # at Nyquist, around 30.2 s
    found = octaves(error, signal, period)
    assert [(o.low, o.high) for o in found[:2]] == [(25.0, 50.0), (12.5, 25.0)]
    assert found[-1].low == 0.0
    assert sum(o.error**2 for o in found) == pytest.approx(np.mean(error**2))
    assert sum(o.signal**2 for o in found) == pytest.approx(np.var(signal))
    assert found[0].error ** 2 > 0.99 * np.mean(error**2)
    assert found[0].at == pytest.approx(30.2, abs=0.21)


def test_octaves_of_a_few_samples_are_one():
    [one] = octaves(np.array([1.0, -1.0, 1.0]), np.arange(3.0), 0.1)
    assert (one.low, one.high, one.error) == (0.0, 5.0, 1.0)
