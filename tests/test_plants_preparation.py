"""What is done to a recording does what it says, and is written down."""

import numpy as np
import pytest

from greygate.errors import InputError
from greygate.models.ports import ports
from greygate.plants.preparation import (
    estimated_delay,
    filtered,
    resampled,
    without_delay,
    without_drift,
    without_offset,
    without_outliers,
)
from greygate.plants.recording import Recording

DT = 1e-3
TIME = np.arange(4000) * DT


def recording(**channels) -> Recording:
    return Recording(DT, channels, dict.fromkeys(channels, "V"), "run.csv")


def sine(hertz: float, phase: float = 0.0) -> np.ndarray:
    return np.sin(2 * np.pi * hertz * TIME - phase)


def amplitude(x: np.ndarray, hertz: float) -> complex:
    middle = slice(1000, 3000)
    return 2 * np.mean(x[middle] * np.exp(-2j * np.pi * hertz * TIME[middle]))


@pytest.mark.parametrize(
    ("kind", "cutoff", "passed", "stopped"),
    [("low", 50.0, 5.0, 400.0), ("high", 50.0, 400.0, 2.0), ("band", (20.0, 80.0), 40.0, 1.0)],
)
@pytest.mark.parametrize("phase", ["zero", "causal"])
def test_a_filter_passes_its_band_and_stops_the_rest(kind, cutoff, passed, stopped, phase):
    r = recording(a=sine(passed), b=sine(stopped), c=sine(stopped))
    done = filtered(r, kind, cutoff, phase=phase, channels=["a", "b"])
    assert abs(amplitude(done["a"], passed)) == pytest.approx(1, abs=0.03)
    assert abs(amplitude(done["b"], stopped)) < 0.03
    np.testing.assert_array_equal(done["c"], r["c"])
    assert phase in done.history[0]
    assert "a, b" in done.history[0]


def test_zero_phase_neither_delays_nor_keeps_3_db_and_causal_does_both():
    r = recording(a=sine(50.0))
    zero, causal = (amplitude(filtered(r, "low", 50.0, phase=p)["a"], 50.0) for p in ("zero", "causal"))
    before = amplitude(r["a"], 50.0)
    assert abs(np.angle(zero / before)) < 1e-3
    assert abs(zero) == pytest.approx(0.5, rel=1e-2)
    assert abs(causal) == pytest.approx(np.sqrt(0.5), rel=1e-2)
    assert np.degrees(np.angle(causal / before)) == pytest.approx(-90, abs=1)


def test_a_causal_filter_does_not_look_ahead_and_starts_at_rest():
    x = 3.0 + np.r_[np.zeros(2000), np.ones(2000)]
    done = filtered(recording(a=x), "low", 20.0, phase="causal")["a"]
    np.testing.assert_allclose(done[:2000], 3.0, atol=1e-12)
    assert done[-1] == pytest.approx(4.0)


def test_the_choice_of_phase_cannot_be_left_out():
    with pytest.raises(TypeError, match="phase"):
        filtered(recording(a=TIME), "low", 20.0)


def test_offset_is_the_mean_or_that_of_the_rest():
    x = np.r_[np.full(100, 2.0), np.full(3900, 5.0)]
    assert np.mean(without_offset(recording(a=x))["a"]) == pytest.approx(0, abs=1e-12)
    done = without_offset(recording(a=x, b=x), ["a"], rest=100)
    assert done["a"][0] == 0.0
    assert done["b"][0] == 2.0
    assert "2 from a" in done.history[0]


@pytest.mark.parametrize("how", [{"degree": 2}, {"cutoff": 0.5}])
def test_drift_goes_and_signal_and_mean_stay(how):
    clean = 1.0 + sine(30.0)
    drift = 0.8 * (TIME - 2.0) + 0.3 * (TIME - 2.0) ** 2 if "degree" in how else 2.0 * sine(0.26)
    done = without_drift(recording(a=clean + drift), **how)
    middle = slice(500, 3500)
    wanted = clean + np.mean(drift)
    assert np.std((done["a"] - wanted)[middle]) < 0.2 * np.std(drift)
    assert np.mean(done["a"]) == pytest.approx(np.mean(wanted), abs=0.05)
    assert abs(amplitude(done["a"], 30.0)) == pytest.approx(1, abs=1e-2)


def test_a_line_goes_exactly():
    done = without_drift(recording(a=3.0 + 2 * TIME), degree=1)["a"]
    np.testing.assert_allclose(done, np.mean(3.0 + 2 * TIME), rtol=1e-12)


def test_outliers_are_replaced_and_counted_and_nothing_else_is():
    clean = sine(3.0)
    spoilt = clean.copy()
    spoilt[[100, 101, 2000, 3999]] += [5.0, -4.0, 9.0, 7.0]
    step = np.r_[np.zeros(2000), np.ones(2000)]
    done, counts = without_outliers(recording(a=spoilt, step=step), ["a", "step"], threshold=6.0)
    assert counts == {"a": 4, "step": 0}
    assert np.abs(done["a"] - clean).max() < 0.1
    assert np.count_nonzero(done["a"] != spoilt) == 4
    np.testing.assert_array_equal(done["step"], step)
    assert "4 samples of a" in done.history[0]


def test_a_flickering_last_bit_is_no_outlier_where_the_resolution_is_given():
    x = np.zeros(200)
    x[50] = 1e-3
    assert without_outliers(recording(a=x), ["a"], least=1e-4)[1] == {"a": 1}
    assert without_outliers(recording(a=x), ["a"], least=1e-3)[1] == {"a": 0}


def test_among_equal_neighbours_nothing_is_an_outlier_and_the_history_says_so():
    levels = np.repeat(np.random.default_rng(0).integers(0, 2, 512), 4).astype(float)
    done, counts = without_outliers(recording(u=levels), ["u"])
    assert counts == {"u": 0}
    np.testing.assert_array_equal(done["u"], levels)
    assert done.history[-1].endswith("left 2048 samples of u unjudged, whose neighbours are equal: give least")


@pytest.mark.parametrize("delay", [0, 1, 17])
def test_a_delay_is_found_through_a_coloured_input_and_noise_and_removed(delay):
    rng = np.random.default_rng(delay)
    u = np.repeat(rng.uniform(-1, 1, 400), 10)
    y = np.r_[np.zeros(delay), u[: len(u) - delay]] + 0.1 * rng.normal(size=len(u))
    r = recording(u=u, y=y)
    assert estimated_delay(r, "u", "y", 60) == delay
    done = without_delay(r, {"y": delay})
    assert done.samples == 4000 - delay
    assert np.std(done["y"] - done["u"]) < 0.12


def test_the_onset_is_the_dead_time_of_a_plant_that_answers_slowly():
    rng = np.random.default_rng(0)
    u, y = rng.normal(size=4000), np.zeros(4000)
    for k in range(14, 4000):
        y[k] = 1.8 * y[k - 1] - 0.82 * y[k - 2] + 0.02 * u[k - 12]
    r = recording(u=u, y=y + 0.01 * rng.normal(size=4000))
    assert abs(estimated_delay(r, "u", "y", 60, onset=True) - 12) <= 2
    assert estimated_delay(r, "u", "y", 60) > 14


def test_resampling_keeps_what_is_below_nyquist_and_nothing_folds_down():
    r = recording(slow=sine(20.0), fast=sine(180.0))
    done = resampled(r, down=5)
    assert done.dt == pytest.approx(5e-3)
    assert done.samples == 800
    middle = slice(100, 700)
    np.testing.assert_allclose(done["slow"][middle], r["slow"][::5][middle], atol=5e-3)
    assert np.abs(done["fast"][middle]).max() < 5e-3
    assert resampled(r, up=3, down=2).samples == 6000


def test_history_grows_by_a_line_a_step_and_the_first_recording_stays_as_it_was():
    r = recording(a=sine(5.0))
    before = r["a"].copy()
    done = resampled(filtered(without_offset(r), "low", 50.0, phase="zero"), down=2)
    assert len(done.history) == 3
    assert r.history == ()
    np.testing.assert_array_equal(r["a"], before)


def test_ports_normalise_the_training_recording_and_keep_its_first_sample():
    r = recording(u=2.0 + 3.0 * sine(5.0), y=sine(1.0))
    u, y = ports(r.channels, r.units, ["u", "y"])
    inside = (r["u"] - u.offset) / u.scale
    assert (inside.min(), inside.max()) == pytest.approx((-1, 1))
    assert (u.unit, u.initial, y.name) == ("V", 2.0, "y")


CONSTANT, SHORT = recording(a=np.ones(4000), b=TIME), Recording(DT, {"a": np.arange(8.0)}, {"a": "V"}, "run.csv")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: recording(a=[0.0, np.nan]), "sample 1 is nan"),
        (lambda: filtered(CONSTANT, "low", 500.0, phase="zero"), "Nyquist, 500 Hz"),
        (lambda: filtered(CONSTANT, "band", (80.0, 20.0), phase="zero"), "rising"),
        (lambda: filtered(CONSTANT, "low", (1.0, 2.0), phase="zero"), "one cut-off"),
        (lambda: filtered(CONSTANT, "low", 20.0, phase="minimum"), "looks ahead"),
        (lambda: filtered(CONSTANT, "low", 0.1, phase="zero"), "4 s hold no period of 0.1 Hz"),
        (lambda: filtered(CONSTANT, "low", 20.0, phase="zero", channels=["c"]), "no channel c; it has a, b"),
        (lambda: filtered(SHORT, "low", 200.0, phase="zero"), "8 samples are too few"),
        (lambda: without_offset(SHORT, rest=9), "rest of 9"),
        (lambda: without_drift(SHORT), "give a degree"),
        (lambda: without_drift(SHORT, degree=7), "too few for degree 7"),
        (lambda: without_outliers(SHORT, ["a"]), "11 samples"),
        (lambda: estimated_delay(CONSTANT, "a", "b", 5), "channel a is constant"),
        (lambda: estimated_delay(SHORT, "a", "a", 5), "too few"),
        (lambda: without_delay(SHORT, {"a": 8}), "leave 0"),
        (lambda: resampled(SHORT, down=8), "too few to keep 1 of 8"),
        (lambda: resampled(SHORT, down=0), "above 0"),
        (lambda: ports(CONSTANT.channels, CONSTANT.units, ["a"]), "constant at 1"),
        (lambda: ports(CONSTANT.channels, CONSTANT.units, ["z"]), "no such channel; there are a, b"),
        (lambda: ports({"a": [0.0, np.inf]}, {}, ["a"]), "NaN or inf"),
    ],
)
def test_what_cannot_be_done_is_named(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_a_target_that_does_not_answer_is_named():
    rng = np.random.default_rng(1)
    with pytest.raises(InputError, match="y does not answer u"):
        estimated_delay(recording(u=rng.normal(size=4000), y=rng.normal(size=4000)), "u", "y", 20)
