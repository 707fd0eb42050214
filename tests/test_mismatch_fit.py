"""The fit: shifts of windows are eliminated as a joint least squares would, and intervals hold what they say."""

import copy
import threading
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest

from greygate.mismatch import cores, rig, simulation
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.effects import Effect, Free
from greygate.mismatch.fit import ITERATIONS, Descent, Fit, Likelihood, Unknown, _inverse
from greygate.mismatch.linearised import Normal, pair_gains, released_gains, solve
from greygate.mismatch.model import EARLY, FILTERS, Model, delayed, lagged
from greygate.mismatch.noise import LONGEST, roughness, runs
from greygate.mismatch.search import Hypothesis, Search
from greygate.plants.plant import Plant
from greygate.plants.simulator import Restarted, simulate

PLANT = """step = 5e-3
outputs = ["x"]
[inputs]
force = "N"
[parameters]
mass = [20.0, "kg"]
viscous = [300.0, "N s/m"]
[states]
x = { unit = "m", rate = "v" }
v = { unit = "m/s" }
[equations.position]
x = { velocity = "v" }
[equations.motion]
v = { storage = "mass", drive = "force", viscous = "-viscous * v" }
"""
RIG = """plant = "slide.toml"
sample_time_s = 0.01
predict = ["x"]
parameters = { mass = 20.0, viscous = 300.0 }
tolerance = { mass = 0.1, viscous = 0.2 }
channels.force = { unit = "N", role = "input" }
channels.x = { unit = "m", role = "output", noise_rms = 1e-5 }
"""
DELAY = Effect(
    "delay", "a delay", ("slide",), ("motion",), ("force",), (Free("delay", 1e-3, "s", reported="delay"),),
    filters={"force": "delay delay"},
)  # fmt: skip
SPRING = Effect(
    "spring", "a spring", ("slide",), ("motion",), ("x",), (Free("stiffness", 50.0, "N/m", reported="stiffness"),),
    terms={"motion.spring": "-stiffness * x"},
)  # fmt: skip
YIELDING = Effect(
    "yielding", "the sensor's side of a gear yields", ("slide",), ("x",), ("x",),
    (Free("yielding", 1e-4, "m/N", reported="yielding"),), terms={"sensor_x.yielding": "yielding * force"},
)  # fmt: skip
TRUE = {"mass": 20.7, "viscous": 285.0, "stiffness": 120.0}
NOISE = 1e-5


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A slide with a spring that its plant leaves out."""
    out = tmp_path_factory.mktemp("slide")
    (out / "slide.toml").write_text(PLANT)
    (out / "rig.toml").write_text(RIG)
    return out


def recorded(folder, seed: int, samples: int = 300, stiffness: float = TRUE["stiffness"]) -> None:
    rng = np.random.default_rng(seed)
    real = Plant.read(folder / "slide.toml").with_parameters(mass=TRUE["mass"], viscous=TRUE["viscous"])
    real = real.with_term("motion", "spring", f"-{stiffness} * x")
    force = 80 * np.repeat(rng.standard_normal(samples // 10), 10)
    x = simulate(real, {"force": force}, sample_time=0.01, step=5e-3)["x"] + NOISE * rng.standard_normal(samples)
    table = np.column_stack([np.arange(samples) * 0.01, force, x])
    np.savetxt(folder / "identify.csv", table, delimiter=",", header="t,force,x", comments="", fmt="%.10g")


def likelihood(folder, window: float | None, seed: int = 0) -> Likelihood:
    recorded(folder, seed)
    (folder / "rig.toml").write_text(RIG if window is None else RIG.replace("predict", f"window_s = {window}\npredict"))
    loaded = rig.load(folder)
    return Likelihood(Model(loaded, loaded.recording(folder / "identify.csv"), {"spring": SPRING}))


def test_a_window_begins_as_fast_as_the_state_moves_and_not_its_reading(tmp_path):
    time = np.arange(300) * 0.01
    force = 80 * (np.sin(4 * time) + np.sin(9 * time))
    (tmp_path / "slide.toml").write_text(PLANT)
    run = simulate(Plant.read(tmp_path / "slide.toml"), {"force": force}, sample_time=0.01, step=5e-3)
    (tmp_path / "rig.toml").write_text(RIG.replace("predict", "window_s = 0.2\npredict"))
    shown = run["x"] + 1e-3 * force
    table = np.column_stack([time, force, shown])
    np.savetxt(tmp_path / "identify.csv", table, delimiter=",", header="t,force,x", comments="", fmt="%.10g")
    loaded = rig.load(tmp_path)
    model = Model(loaded, loaded.recording(tmp_path / "identify.csv"), {"yielding": YIELDING})
    off = model.predict({**model.values, "yielding": 1e-3}) - shown[:, None]
    assert np.sqrt(np.mean(off**2)) < 0.02 * np.std(run["x"])


def unknowns(spring: bool = True) -> list[Unknown]:
    free = [Unknown("mass", 20.0, 1.0, 1.0), Unknown("viscous", 300.0, 30.0, 1.0)]
    return [*free, Unknown("stiffness", 0.0, 50.0)] if spring else free


def test_a_step_is_that_of_the_joint_least_squares_over_parameters_and_every_windows_start(folder):
    p = likelihood(folder, 0.25)
    asked = unknowns()
    values, shifts = {u.symbol: u.value(0.0) for u in asked}, p.nothing()
    errors = p.errors(values, shifts)
    even = np.ones(errors.shape[1])
    basis = p.basis(values, shifts, errors, even)
    raw = p.slopes(asked, values, shifts, errors, even)
    slopes, _ = p.eliminate(raw, None, basis)
    left, _ = p.eliminate(p.rows(errors, even)[:, :, None], None, basis)
    prior = np.diag([0.0 if np.isinf(u.prior) else u.prior**-2 for u in asked])
    flat = slopes.reshape(-1, len(asked))
    step = -np.linalg.solve(flat.T @ flat + prior, flat.T @ left.reshape(-1))

    windows, locals_ = shifts.shape
    rows, k = raw.shape[1], len(asked)
    joint = np.zeros((windows * rows + windows * locals_ + k, k + windows * locals_))
    right = np.zeros(len(joint))
    for w in range(windows):
        here, own = slice(w * rows, (w + 1) * rows), slice(k + w * locals_, k + (w + 1) * locals_)
        joint[here, :k], right[here] = raw[w], -p.rows(errors, even)[w]
        for j in range(locals_):
            moved = shifts.copy()
            moved[w, j] += 0.1
            joint[here, k + w * locals_ + j] = p.rows(p.errors(values, moved) - errors, even)[w] / 0.1
        joint[windows * rows + w * locals_ : windows * rows + (w + 1) * locals_, own] = np.diag(np.sqrt(p.heavy))
    joint[-k:, :k] = np.sqrt(prior)
    expected = np.linalg.lstsq(joint, right, rcond=None)[0][:k]
    np.testing.assert_allclose(step, expected, rtol=1e-6)


@pytest.mark.parametrize("window", [None, 0.25])
def test_parameters_and_effect_are_found_within_their_intervals(folder, window):
    fit = likelihood(folder, window).fit(unknowns())
    assert fit.converged
    for symbol, true in TRUE.items():
        assert abs(fit.values[symbol] - true) < 3 * fit.deviation(symbol), symbol
        assert fit.deviation(symbol) < 0.05 * true
    assert fit.cost == pytest.approx(fit.likelihood.count, rel=0.25)


@pytest.mark.parametrize("window", [None, 0.25])
def test_a_fit_to_the_rest_is_that_made_anew_in_a_fraction_of_the_runs(folder, window, monkeypatch):
    fit, runs, ran = likelihood(folder, window).fit(unknowns()), [], Model.predict
    monkeypatch.setattr(Model, "predict", lambda *given: runs.append(1) or ran(*given))
    blocks = [np.arange(300) // 30 % 5 == k for k in range(5)]
    led = [fit.without(held, 8) for held in blocks]
    few = len(runs)
    assert led == [fit.without(held, 8) for held in blocks]
    assert len(runs) == few
    for held, values in zip(blocks, led, strict=True):
        anew = fit.likelihood.without(held).fit(fit.unknowns, fit.values, fit.shifts, 8)
        for u in fit.unknowns:
            assert abs(values[u.symbol] - anew.values[u.symbol]) < 0.02 * fit.deviation(u.symbol)
            assert values[u.symbol] != fit.values[u.symbol]
    assert few <= 0.5 * (len(runs) - few)


def test_intervals_hold_the_truth_as_often_as_they_say(folder):
    fits = [likelihood(folder, None, seed).fit(unknowns()) for seed in range(40)]
    scores = np.array([[(f.values[s] - TRUE[s]) / f.deviation(s) for s in TRUE] for f in fits])
    assert 0.9 < np.mean(np.abs(scores) < 1.96) < 0.995
    assert np.abs(scores.mean(axis=0)).max() < 0.6


def test_a_smaller_model_fits_worse_and_one_that_starts_elsewhere_fits_as_well(folder):
    p = likelihood(folder, None)
    full, less = p.fit(unknowns()), p.fit(unknowns(spring=False))
    assert less.cost > full.cost + 1000
    elsewhere = p.fit(unknowns(), {"mass": 22.0, "viscous": 330.0, "stiffness": 20.0}, iterations=30)
    assert elsewhere.cost == pytest.approx(full.cost, abs=0.5)
    assert elsewhere.values["stiffness"] == pytest.approx(full.values["stiffness"], rel=1e-3)


def linear(slopes: np.ndarray, errors: np.ndarray, weight: np.ndarray, numbers: np.ndarray) -> Fit:
    """A fit of which only the linearisation is known."""
    fit = Fit(None, (None, None), {}, numbers, np.empty(0), errors, weight, 0.0, True, np.ones(1))
    vars(fit).update(slopes=slopes, projected=errors)
    return fit


def test_a_solution_within_bounds_is_that_of_least_squares_and_one_beyond_keeps_to_them():
    rng = np.random.default_rng(6)
    slopes, errors = rng.standard_normal((4, 30, 2)), rng.standard_normal((4, 30))
    columns, weight = rng.standard_normal((4, 30, 1)), np.array([0.0, 4.0])
    fit = linear(slopes, errors, weight, np.zeros(2))
    rows = np.concatenate([np.concatenate([slopes, columns], axis=2).reshape(120, 3), [[0.0, 2.0, 0.0]]])
    right = -np.append(errors.reshape(-1), 0.0)
    free, gain = solve(fit, columns, np.array([[-9.0, 9.0]] * 3), weight)
    np.testing.assert_allclose(free, np.linalg.lstsq(rows, right)[0], rtol=1e-6)
    assert gain == pytest.approx(right @ right - np.sum((right - rows @ free) ** 2), rel=1e-6)
    bound = free[2] / 2
    held, less = solve(fit, columns, np.array([[-9.0, 9.0], [-9.0, 9.0], sorted((0.0, bound))]), weight)
    assert held[2] == pytest.approx(bound, rel=1e-6)
    np.testing.assert_allclose(held[:2], np.linalg.lstsq(rows[:, :2], right - rows[:, 2] * bound)[0], rtol=1e-5)
    assert less < gain


def test_the_gain_of_a_pair_is_that_of_the_joint_least_squares():
    rng = np.random.default_rng(5)
    slopes, errors = rng.standard_normal((4, 30, 2)), rng.standard_normal((4, 30))
    columns = rng.standard_normal((4, 30, 5)) + errors[:, :, None]
    weight, numbers = np.array([0.0, 4.0]), np.array([0.3, -0.5])
    fit = linear(slopes, errors, weight, numbers)
    gains = pair_gains(Normal.of(fit, columns), (1, 3, 1))

    def cost(own: list[int]) -> float:
        """Of the unknowns and of `own` columns, the unknowns' priors as rows."""
        prior = np.pad(np.diag(np.sqrt(weight)), ((0, 0), (0, len(own))))
        rows = np.concatenate([np.concatenate([slopes, columns[:, :, own]], axis=2).reshape(120, -1), prior])
        right = np.concatenate([errors.reshape(-1), np.sqrt(weight) * numbers])
        left = right - rows @ np.linalg.lstsq(rows, right)[0]
        return float(left @ left)

    for i, j, own in ((0, 1, [0, 1, 2, 3]), (1, 2, [1, 2, 3, 4]), (0, 2, [0, 4])):
        assert gains[i, j] == pytest.approx(cost([]) - cost(own), rel=1e-6)
        assert gains[i, j] == pytest.approx(gains[j, i], rel=1e-6)


def test_an_effect_and_a_parameter_freed_of_its_prior_save_together_what_least_squares_says():
    rng = np.random.default_rng(4)
    errors = rng.standard_normal((4, 30))
    slopes, columns = rng.standard_normal((4, 30, 2)), rng.standard_normal((4, 30, 3)) + errors[:, :, None]
    weight, numbers = np.array([9.0, 4.0]), np.array([0.3, -0.5])
    fit = linear(slopes, errors, weight, numbers)

    def cost(own: list[int], weight: np.ndarray) -> float:
        """Of the unknowns and of `own` columns, the unknowns' priors as rows."""
        prior = np.pad(np.diag(np.sqrt(weight)), ((0, 0), (0, len(own))))
        rows = np.concatenate([np.concatenate([slopes, columns[:, :, own]], axis=2).reshape(120, -1), prior])
        right = np.concatenate([errors.reshape(-1), np.sqrt(weight) * numbers])
        left = right - rows @ np.linalg.lstsq(rows, right)[0]
        return float(left @ left)

    gains = released_gains(Normal.of(fit, columns), (1, 2), released=1)
    for i, own in enumerate(([0], [1, 2])):
        assert gains[i] == pytest.approx(cost([], weight) - cost(own, weight * [1, 0]), rel=1e-6)


def test_a_start_from_which_the_run_diverges_is_brought_nearer_to_the_data_sheet(folder):
    p = likelihood(folder, None)
    stiff = {"stiffness": 1e7}  # 700 rad/s, a step of 5 ms
    with np.errstate(over="ignore", invalid="ignore"):
        assert not np.isfinite(p.cost(p.errors(stiff, p.nothing()), p.nothing(), np.ones(1)))
        found = p.fit(unknowns(), stiff)
    assert found.cost == pytest.approx(p.fit(unknowns(), {"stiffness": 5e6}).cost)


def test_a_bound_holds(folder):
    bounded = [*unknowns(spring=False), Unknown("stiffness", 0.0, 50.0, np.inf, 0.0, 60.0)]
    fit = likelihood(folder, None).fit(bounded)
    assert fit.values["stiffness"] == 60.0


@pytest.mark.parametrize(("low", "high"), [(0.0, 60.0), (200.0, 300.0)])
def test_no_run_is_made_beyond_a_bound_not_even_for_a_slope(folder, low, high):
    p, tried = likelihood(folder, None), []
    residual = p.residual
    p.residual = lambda values, shifts: (tried.append(values["stiffness"]), residual(values, shifts))[1]
    p.fit([*unknowns(spring=False), Unknown("stiffness", 0.0, 50.0, np.inf, low, high)])
    assert low <= min(tried) < max(tried) <= high


def test_the_data_sheet_holds_a_parameter_that_the_recording_does_not_tell(folder):
    p = likelihood(folder, None)
    little = Unknown("stiffness", TRUE["stiffness"], 1e-9, 1.0)  # of that size the recording says nothing
    for start in (0.0, 30.0):  # of its deviations away
        fit = p.fit([*unknowns(spring=False), little], {"stiffness": TRUE["stiffness"] + start * 1e-9})
        assert fit.values["stiffness"] == pytest.approx(TRUE["stiffness"], abs=1e-9)
    assert fit.deviation("stiffness") == pytest.approx(1e-9, rel=0.15)


def test_runs_are_as_long_as_the_signal_rests_and_roughness_is_that_of_the_noise():
    np.testing.assert_array_equal(runs(np.array([1, 1, 2, 3, 3, 3.0])), [2, 2, 1, 3, 3, 3])
    assert runs(np.zeros(1000)).max() == LONGEST
    rng = np.random.default_rng(0)
    signal = np.sin(np.arange(20000) / 300) + 0.01 * rng.standard_normal(20000)
    assert roughness(signal, 0.01) == pytest.approx(1.0, abs=0.05)
    assert roughness(signal, 0.001) == pytest.approx(10.0, rel=0.05)


def test_a_delay_and_a_lag_of_a_held_input_are_those_of_its_continuous_signal():
    """Against the same input on a grid a hundred times as fine."""
    dt, fine = 1e-3, 100
    u = np.random.default_rng(0).standard_normal(50)
    held = np.repeat(u, fine)
    late = np.concatenate([np.full(170, u[0]), held])[: len(held)]  # 1.7 samples
    np.testing.assert_allclose(delayed(u, 1.7e-3, dt), late.reshape(-1, fine).mean(axis=1), atol=1e-12)
    y, out = u[0], []
    for value in held:
        begin, y = y, value + (y - value) * np.exp(-dt / fine / 2.5e-3)
        out.append(value + (begin - value) * (2.5e-3 * fine / dt) * (1 - np.exp(-dt / fine / 2.5e-3)))
    np.testing.assert_allclose(lagged(u, 2.5e-3, dt), np.reshape(out, (-1, fine)).mean(axis=1), atol=1e-9)


def test_what_is_made_of_an_input_is_made_of_it_as_it_arrives(folder):
    """A lag of the force is one of the impulse too, and at no lag both are as recorded."""
    recorded(folder, 0)
    (folder / "slide.toml").write_text(
        PLANT.replace('force = "N"', 'force = "N"\nimpulse = "N s"\n[derived]\nimpulse = "integral force"')
        .replace("-viscous * v", "-viscous * v + 0.0 * impulse")
    )  # fmt: skip
    (folder / "rig.toml").write_text(RIG)
    loaded = rig.load(folder)
    lag = Effect(
        "late", "a lag", ("slide",), ("motion",), ("force",), (Free("late", 0.05, "s"),), filters={"force": "lag late"}
    )
    model = Model(loaded, loaded.recording(folder / "identify.csv"), {"late": lag})
    force = model.recording["force"]
    for value, arrives in ((0.0, force), (0.04, lagged(force, 0.04, 0.01))):
        _, signals = model.states({**model.values, "late": value})
        np.testing.assert_allclose(signals["force"], arrives)
        np.testing.assert_allclose(signals["impulse"], np.append(0.0, np.cumsum(arrives[:-1]) * 0.01))
    (folder / "slide.toml").write_text(PLANT)


TURNING = """step = 1e-3
outputs = ["x"]
[inputs]
n = "rev/s"
turn = "rev"
[derived]
turn = "integral n"
[parameters]
ripple = [0.2, "m/s"]
[states]
x = { unit = "m" }
[equations.position]
x = { velocity = "ripple * sin(20.0 * turn)" }
"""
TURNING_RIG = """plant = "turning.toml"
sample_time_s = 0.01
predict = ["x"]
parameters = { ripple = 0.2 }
channels.n = { unit = "rev/s", role = "input" }
channels.x = { unit = "m", role = "output", noise_rms = 1e-6 }
"""


def test_an_integral_rises_within_a_sample(tmp_path):
    """A ripple of a shaft that turns by a tenth of a period in each sample: held, it would come half a sample late."""
    n = 3.0 + np.sin(0.05 * np.arange(400))
    (tmp_path / "turning.toml").write_text(TURNING)
    (tmp_path / "rig.toml").write_text(TURNING_RIG)
    table = np.column_stack([np.arange(400) * 0.01, n, n - n[0]])
    np.savetxt(tmp_path / "identify.csv", table, delimiter=",", header="t,n,x", comments="", fmt="%.15g")
    loaded = rig.load(tmp_path)
    late = Effect(
        "late", "a delay", ("turning",), ("position",), ("n",), (Free("late", 0.01, "s"),), filters={"n": "delay late"}
    )
    model = Model(loaded, loaded.recording(tmp_path / "identify.csv"), {"late": late})
    for value, arrives in ((0.0, n), (0.01, np.append(n[0], n[:-1]))):
        turn = np.append(0.0, np.cumsum(arrives) * 0.01)
        x = np.append(0.0, np.cumsum(0.2 / (20.0 * arrives) * -np.diff(np.cos(20.0 * turn))))[:-1]
        values = {**model.values, "late": value}
        np.testing.assert_allclose(model.predict(values)[:, 0], x, atol=2e-3 * np.ptp(x))
        _, signals = model.states(values)
        np.testing.assert_allclose(signals["turn"], turn[:-1], rtol=1e-12)  # at a sample it is what was summed before


def test_what_no_effect_of_the_table_has_is_closed_in_its_equation_on_its_variable(folder):
    """A spring, on a plant of one's own, with an empty table."""
    recorded(folder, 0, 2000, stiffness=10.0)
    (folder / "rig.toml").write_text(RIG)
    found = diagnose(rig.load(folder), effects={})
    assert found.verdict == "unexplained"
    content = found.as_dict()
    (place,), (entry,) = content["where"], content["effects"]
    assert (place["equation"], place["depends_on"]) == ("motion", ["x"])
    assert (entry["id"], entry["equations"]) == ("unknown", ["motion"])
    rms = content["fit"]["identify"]["x"]
    assert rms["corrected"] < 2 * NOISE < 0.1 * rms["calibrated"]
    loaded = rig.load(folder)
    predicted = simulation.simulate(loaded, loaded.recording(folder / "identify.csv"), content, {})
    error = predicted["x"] - loaded.recording(folder / "identify.csv")["x"]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(rms["corrected"], rel=1e-6)


def test_a_closure_keeps_only_functions_of_which_it_is_sure(folder):
    """A spring so stiff that the straight line that chooses them asks for more."""
    recorded(folder, 0, 2000)
    (folder / "rig.toml").write_text(RIG)
    (entry,) = diagnose(rig.load(folder), effects={}).as_dict()["effects"]
    for p in entry["parameters"].values():
        low, high = p["ci95"]
        assert abs(p["value"]) > 5 * (high - low) / 3.92


def test_motors_that_lag_begin_at_rest():
    """A step from the first sample on: one lag rises by its exponential, two equal ones later."""
    dt, lag = 1e-3, 0.02
    one, two = (FILTERS[name](np.ones(200), lag, dt) for name in ("lag_from_rest", "lag_twice_from_rest"))
    t = np.arange(201) * dt
    rising = t + lag * np.exp(-t / lag)  # integral of what one lag gives
    np.testing.assert_allclose(one, np.diff(rising) / dt, atol=1e-12)
    half = lag / 2
    rising = t + np.exp(-t / half) * (2 * half + t)
    np.testing.assert_allclose(two, np.diff(rising) / dt, atol=1e-3)


@pytest.mark.parametrize("moves", [2, 5])
def test_an_input_that_moves_several_times_a_sample_has_its_mean_and_moment_there(folder, moves):
    """It is commanded `moves` times as often as it is recorded, and rises evenly."""
    likely = likelihood(folder, None)
    model = copy.copy(likely.model)
    model._parts = parts = 10
    seen = np.arange(0.0, 40.0, 4.0)
    moved = model._moved(seen, (1 - 1 / moves) / 2).reshape(-1, parts)[:-1]
    true = np.repeat(np.arange(0.0, 40.0, 4.0 / moves), parts // moves).reshape(-1, parts)[:-1]
    at = np.arange(parts) - (parts - 1) / 2
    np.testing.assert_allclose(moved.mean(axis=1), true.mean(axis=1), rtol=1e-12)
    np.testing.assert_allclose(moved @ at, true @ at, rtol=1e-12)
    model._parts = 1
    np.testing.assert_allclose(model._moved(seen, (1 - 1 / moves) / 2)[:-1], true.mean(axis=1), rtol=1e-12)


@pytest.mark.parametrize("late", [0.3, 1.5])
def test_an_input_that_comes_between_the_samples_acts_there(folder, late):
    """The mean over a sample alone is off by far more."""
    likely = likelihood(folder, None)
    model, dt = likely.model, likely.model.rig.dt
    model = Model(model.rig, model.recording, {"delay": DELAY})
    fine = 100
    force = np.repeat(model.recording["force"], fine)
    wait = round(late * fine)
    force = np.concatenate([np.full(wait, force[0]), force[:-wait]])
    true = simulate(model.rig.plant, {"force": force}, sample_time=dt / fine, step=dt / fine)["x"][::fine]
    found = model.predict({**model.values, "delay": late * dt})[:, 0]
    model._parts, model._parted, model._last, model._made = 1, model.inputs, (None, None), {}
    model._compiled = Restarted(model.plant, dt, model.plant.step)
    coarse = model.predict({**model.values, "delay": late * dt})[:, 0]
    assert np.std(found - true) < 0.3 * np.std(coarse - true)


@pytest.mark.parametrize("every", [1, 2])
def test_an_input_that_seems_to_act_before_it_moves_moved_between_the_samples(folder, every):
    """Of the samples at which the force moves, every second one may not be in the recording."""
    fine, samples = 0.01 / every, 4000
    rng = np.random.default_rng(2)
    force = 80 * np.repeat(rng.standard_normal(samples * every // 7 + 1), 7)[: samples * every]
    real = Plant.read(folder / "slide.toml").with_parameters(mass=TRUE["mass"], viscous=TRUE["viscous"])
    x = simulate(real, {"force": force}, sample_time=fine, step=5e-3)["x"][::every]
    columns = [np.arange(samples) * 0.01, force[::every], x + NOISE * rng.standard_normal(samples)]
    np.savetxt(folder / "identify.csv", np.column_stack(columns), delimiter=",", header="t,force,x", comments="")
    (folder / "rig.toml").write_text(RIG.replace("predict", "window_s = 0.4\npredict"))
    loaded = rig.load(folder)
    search = Search(loaded, loaded.recording(folder / "identify.csv"), {})
    fit = search.base(search.screen)
    assert search.between is (every == 2)
    assert fit.values.get(EARLY, 0.0) == pytest.approx(0.25 if every == 2 else 0.0, abs=0.05)
    assert not search.moved_between(fit)  # it says so once
    for symbol in ("mass", "viscous"):
        assert abs(fit.values[symbol] - TRUE[symbol]) < 3 * fit.deviation(symbol), symbol


def test_intervals_hold_the_truth_where_errors_hang_together_too(folder):
    """Errors that last a quarter of a second, not a sample: twelve a recording; as if they were white, 40 % hold it."""
    scores = []
    for seed in range(40):
        p = likelihood(folder, None, seed)
        slow = np.random.default_rng(1000 + seed).standard_normal((12, 1))
        p.model.target += NOISE * np.repeat(slow, 25, axis=0)
        fit = p.fit(unknowns())
        scores.append([(fit.values[s] - TRUE[s]) / fit.deviation(s) for s in TRUE])
    assert np.mean(np.abs(scores) < 1.96) > 0.8


def test_intervals_from_few_windows_are_as_wide_as_those_from_many():
    """Errors that last a window, and eight windows that weigh alike: the variance is right in the mean over draws."""
    windows, rows, rng = 8, 20, np.random.default_rng(5)
    signs = np.array([[(-1) ** (w >> bit & 1) for bit in range(3)] for w in range(windows)])
    slopes = np.repeat(signs[:, None, :], rows, axis=1).astype(float)
    told = []
    for _ in range(300):
        drawn = rng.standard_normal(windows)
        step = -drawn @ signs / windows
        left = np.repeat((drawn + signs @ step)[:, None], rows, axis=1)
        asked = tuple(Unknown(name, 0.0, 1.0) for name in "abc")
        fit = Fit(
            SimpleNamespace(recording=np.zeros(windows)),
            asked,
            {},
            step,
            np.zeros((windows, 0)),
            left,
            np.zeros(3),
            0.0,
            True,
            np.ones(1),
        )
        fit.__dict__.update(slopes=slopes, projected=left)
        told.append(np.diag(fit.covariance))
    assert np.mean(told) == pytest.approx(1 / windows, rel=0.1)


def test_a_run_restarts_where_a_sensor_that_reads_wrong_showed_the_state_to_be(folder):
    recorded(folder, 0)
    (folder / "rig.toml").write_text(RIG.replace("predict", "window_s = 0.25\npredict"))
    loaded = rig.load(folder)
    gain = Effect(
        "gain", "a wrong gain", ("slide",), ("motion",), ("x",), (Free("gain", 0.05, "1"),),
        terms={"sensor_x.gain": "gain * x"},
    )  # fmt: skip
    model = Model(loaded, loaded.recording(folder / "identify.csv"), {"gain": gain})
    predicted = model.predict({**model.values, "gain": 0.05})[model.restarts, 0]
    read = model.target[model.restarts, 0]
    np.testing.assert_allclose(predicted, read, rtol=1e-4)


def test_what_is_held_out_is_every_other_stretch_under_the_parameters_of_the_rest():
    rng = np.random.default_rng(7)
    slopes, errors = rng.standard_normal((16, 30, 2)), rng.standard_normal((16, 30))
    weight, numbers = np.array([0.0, 4.0]), np.array([0.3, -0.5])
    second = np.arange(16) // 4 % 2  # windows of 25 samples

    def held_out(high: float) -> float:
        made = SimpleNamespace(turns=lambda stretch, parts: second % parts)
        asked = (Unknown("a", 0.0, 1.0), Unknown("b", 0.0, 1.0, 0.5, high=high))
        fit = Fit(made, asked, {}, numbers, np.zeros((16, 0)), errors, weight, 0.0, True, np.ones(1))
        fit.__dict__.update(slopes=slopes, projected=errors)
        return fit.held_out()

    def expected(high: float) -> float:
        cost = 0.0
        for learn in (0, 1):
            rows = np.concatenate([slopes[second == learn].reshape(-1, 2), np.diag(np.sqrt(weight))])
            right = np.concatenate([errors[second == learn].reshape(-1), np.sqrt(weight) * numbers])
            step = -np.linalg.lstsq(rows, right)[0]
            step[1] = min(numbers[1] + step[1], high) - numbers[1]
            other = second != learn
            cost += float(np.sum((errors[other] + slopes[other] @ step) ** 2))
        return cost

    assert held_out(np.inf) == pytest.approx(expected(np.inf), rel=1e-6)
    assert held_out(-0.5) == pytest.approx(expected(-0.5), rel=1e-6)
    assert expected(-0.5) != pytest.approx(expected(np.inf), rel=1e-4)


def test_the_rounding_of_an_input_counts_where_it_is_of_the_predicted_kind_alone(tmp_path):
    sigma = []
    for unit in ("N", "m"):
        channel = f'channels.force = {{ unit = "{unit}", role = "input", resolution = 1e-4 }}'
        (tmp_path / "slide.toml").write_text(PLANT.replace('force = "N"', f'force = "{unit}"'))
        (tmp_path / "rig.toml").write_text(RIG.replace('channels.force = { unit = "N", role = "input" }', channel))
        recorded(tmp_path, 0)
        loaded = rig.load(tmp_path)
        model = Model(loaded, loaded.recording(tmp_path / "identify.csv"), {"spring": SPRING})
        sigma.append(Likelihood(model).sigma[0, 0])
    assert sigma[0] == pytest.approx(NOISE)
    repeated = runs(model.recording["force"])[0]
    assert sigma[1] == pytest.approx(np.sqrt(NOISE**2 + repeated * 1e-8 / 12))


def test_the_first_twelfth_counts_for_nothing_where_a_state_has_no_sensor(tmp_path):
    plant = PLANT.replace('drive = "force"', 'drive = "late"').replace(
        "[equations.position]",
        '[equations.lag]\nlate = { storage = "0.02", catch_up = "force - late" }\n[equations.position]',
    )
    (tmp_path / "slide.toml").write_text(plant.replace("[states]\n", '[states]\nlate = { unit = "N" }\n'))
    (tmp_path / "rig.toml").write_text(RIG.replace("predict", "window_s = 0.1\npredict"))
    t = np.arange(300) * 0.01
    table = np.column_stack([t, np.sin(t), 1e-3 * np.sin(t)])
    np.savetxt(tmp_path / "identify.csv", table, delimiter=",", header="t,force,x", comments="", fmt="%.10g")
    loaded = rig.load(tmp_path)
    p = Likelihood(Model(loaded, loaded.recording(tmp_path / "identify.csv"), {}))
    counted = np.isfinite(p.sigma[:, 0])
    assert not counted[:25].any()
    assert counted[25:].all()
    assert p.count == 275


def test_the_cost_of_a_fit_counts_how_far_it_strays_from_the_data_sheet(folder):
    p = likelihood(folder, None)
    strict = [Unknown("mass", 20.0, 1.0, 0.001), Unknown("viscous", 300.0, 30.0, 1.0), Unknown("stiffness", 0.0, 50.0)]
    fit = p.fit(strict)
    strayed = np.sum(np.array([1e6, 1.0, 0.0]) * fit.numbers**2)
    assert strayed > 1.0
    assert fit.cost == pytest.approx(np.sum(fit.errors**2) + strayed, rel=1e-9)


@pytest.mark.parametrize("start", [{"stiffness": 2000.0}, {"viscous": 3.0, "stiffness": 2000.0}])
def test_a_fit_that_begins_far_away_comes_back_by_shorter_steps(folder, start):
    p = likelihood(folder, None)
    with np.errstate(over="ignore", invalid="ignore"):  # full steps diverge
        fit = p.fit(unknowns(), start, iterations=60)
    assert fit.converged
    assert fit.cost == pytest.approx(p.fit(unknowns()).cost, abs=0.5)


def test_a_fit_ends_well_where_a_step_saves_less_than_asked_for(folder):
    p = likelihood(folder, None)
    start = {"mass": 20.5}
    once, full = p.fit(unknowns(), start, slack=1e9), p.fit(unknowns(), start)
    assert once.converged
    assert full.cost < once.cost < p.fit(unknowns(), start, iterations=0).cost  # it took that one step
    assert not p.fit(unknowns(), start, iterations=1).converged  # of which it does not know how good it is


def test_the_cost_counts_the_square_of_each_shift_by_its_weight(folder):
    p = likelihood(folder, 0.5)
    shifts = np.full_like(p.nothing(), 3.0)
    errors, temper = np.zeros_like(p.model.target), np.ones(p.sigma.shape[1])
    assert shifts.size
    assert np.all(np.asarray(p.heavy) > 0)
    assert p.cost(errors, shifts, temper) == pytest.approx(9.0 * np.sum(p.heavy * np.ones_like(shifts)), rel=1e-12)


@pytest.mark.parametrize(("windows", "size", "each"), [(200, 100, 10), (80, 25, 4), (6, 25, 1)])
def test_stretches_are_a_thousand_samples_or_a_twentieth_of_the_recording(windows, size, each):
    made = SimpleNamespace(windows=windows, block=size)
    np.testing.assert_array_equal(Likelihood.turns(made, 1000, 2), np.arange(windows) // each % 2)


def test_a_number_may_change_both_ways_whatever_the_sign_of_its_size():
    """A level that is sized below zero: the bounds of its number are those of its value, turned around."""
    below = Unknown("level", 0.0, scale=-2.0, low=-np.inf, high=1.0)
    above = Unknown("size", 0.0, scale=4.0, low=0.0, high=2.0)
    fit = SimpleNamespace(unknowns=(below, above), numbers=np.array([1.0, 0.25]))
    np.testing.assert_array_equal(Fit.room.fget(fit), [[-1.5, np.inf], [-0.25, 0.25]])


@pytest.mark.parametrize(("seconds", "threads"), [(0.0, False), (1.0, True)])
def test_what_takes_long_is_done_side_by_side(monkeypatch, seconds, threads):
    """In order, under numpy's error state, and within a thread one after the other. seconds: that an item takes."""
    clock = count(0.0, seconds)
    monkeypatch.setattr(cores, "CORES", 2)
    monkeypatch.setattr(cores, "perf_counter", lambda: next(clock))
    found = cores.each(lambda i: (i, threading.get_ident()), range(6))
    assert [i for i, _ in found] == [*range(6)]
    assert any(thread != threading.get_ident() for _, thread in found) is threads
    inner = cores.each(lambda _: {*cores.each(lambda _: threading.get_ident(), range(4))}, range(4))
    assert all(len(threads) == 1 for threads in inner[1:])
    with np.errstate(over="raise"), pytest.raises(FloatingPointError):
        cores.each(lambda x: np.float64(1e308) * x, [0.1, 0.1, 0.1, 100.0])


def test_scores_leave_the_fit_as_it_is(folder):
    """A parameter that is scored without its tolerance has it again for the next score."""
    recorded(folder, 5)
    given = rig.load(folder)
    search = Search(given, given.recording(folder / "identify.csv"), {"spring": SPRING})
    fit = search.fit(search.final, Hypothesis(), {})
    room = fit.room.copy()
    first, again = (search.scores(fit, Hypothesis()) for _ in range(2))
    assert any(score.hypothesis.released for score in first)
    assert first == again
    np.testing.assert_array_equal(fit.room, room)


def test_slopes_are_the_same_on_one_core_and_on_several(folder, monkeypatch):
    recorded(folder, 5)
    given = rig.load(folder)
    search = Search(given, given.recording(folder / "identify.csv"), {"spring": SPRING})
    fits = []
    for several in (1, 2):
        monkeypatch.setattr(cores, "CORES", several)
        monkeypatch.setattr(cores, "WORTH", 0.0)
        fits.append(search.fit(search.final, Hypothesis(("spring",)), {}))
    assert fits[0].values == fits[1].values
    np.testing.assert_array_equal(fits[0].slopes, fits[1].slopes)


def test_the_unit_of_one_unknown_decides_nothing_of_what_is_known_of_the_others():
    information = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]])
    units = np.array([1.0, 1e-7, 1e14])
    found = _inverse(information * np.outer(units, units)) * np.outer(units, units)
    assert found == pytest.approx(np.linalg.inv(information), rel=1e-9)
    information[2] = information[:, 2] = 0.0
    assert _inverse(information)[2] == pytest.approx([0.0, 0.0, 0.0])


def searched(folder, monkeypatch, window: float | None = 0.4) -> Search:
    """A search on the slide with a spring, in windows or in free run, whose slopes are held for dear."""
    monkeypatch.setattr("greygate.mismatch.fit.DEAR", 0)
    model = likelihood(folder, window).model
    return Search(model.rig, model.recording, {"spring": SPRING})


@pytest.mark.parametrize(("window", "fewer"), [(0.4, True), (None, False)])
def test_a_fit_in_windows_begins_with_what_led_the_best_before(folder, monkeypatch, window, fewer):
    search, spring = searched(folder, monkeypatch, window), Hypothesis(("spring",))
    model = search.final.model

    def fitted():
        before = model.runs
        return search.fit(search.final, spring, {}), model.runs - before

    first, all_ = fitted()
    again, kept = fitted()
    assert (kept < all_) is fewer
    (leading,) = search.leading.values()
    assert (leading.moves is not None) is fewer
    assert again.cost == pytest.approx(first.cost, abs=0.1)


@pytest.mark.parametrize("wrong", [0.0, -1.0])
def test_what_is_kept_and_leads_astray_is_taken_anew(folder, monkeypatch, wrong):
    """None promises a gain, or each step leads up."""
    search = searched(folder, monkeypatch)
    right = search.fit(search.final, Hypothesis(("spring",)), {})
    ((shifts, numbers),) = (leading.moves for leading in search.leading.values())
    astray = wrong * shifts, {symbol: wrong * moved for symbol, moved in numbers.items()}
    start = {**right.values, "mass": 0.9 * right.values["mass"]}
    descent = Descent(search.final, search.unknowns(Hypothesis(("spring",))), start, search.final.nothing())
    descent.keep(astray)
    assert descent.ended(ITERATIONS).cost == pytest.approx(right.cost, abs=0.1)
    assert descent.misled is (wrong < 0)


def test_an_effects_numbers_are_taken_anew_before_those_of_the_plant(folder, monkeypatch):
    search, asked, by_numbers = searched(folder, monkeypatch), [], Likelihood.by_numbers

    def asking(likelihood, unknowns, *given, **how):
        asked.append([u.symbol for u in unknowns])
        return by_numbers(likelihood, unknowns, *given, **how)

    monkeypatch.setattr(Likelihood, "by_numbers", asking)
    descent = Descent(search.final, search.unknowns(Hypothesis(("spring",))), {}, search.final.nothing())
    descent.linearised()
    descent.passed()
    descent.linearised()
    descent.passed()
    descent.linearised()
    assert [set(symbols) - {"stiffness"} != set() for symbols in asked] == [True, False, True]
    assert asked[1] == ["stiffness"]
    descent.misled = True
    descent.passed()
    descent.linearised()
    assert len(asked[-1]) == len(descent.unknowns)
    monkeypatch.setattr("greygate.mismatch.fit.DEAR", len(descent.unknowns) + len(search.final.model.locals))
    descent.keep(descent.last)
    assert descent.kept is None  # all of that is cheap


def test_what_leads_is_of_the_best_fit_where_windows_begin_alike(folder, monkeypatch):
    search = searched(folder, monkeypatch)
    search.fit(search.final, Hypothesis(("spring",)), {})
    (best,) = search.leading.values()
    moves, cost = best.moves, best.cost
    search.fit(search.final, Hypothesis(()), {})
    assert best.moves is moves
    assert best.cost == cost  # nothing explains less than the spring
    search.fit(Likelihood(search.final.model.as_recorded()), Hypothesis(("spring",)), {})
    assert len(search.leading) == 2
