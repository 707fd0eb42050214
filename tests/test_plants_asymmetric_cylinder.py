"""The second machine: its statics, its position loop, and what sensors and filters make of it."""

from dataclasses import replace

import numpy as np
import pytest

from greygate.errors import InputError
from greygate.machines.asymmetric_cylinder.plant import (
    CUTOFF,
    DIFFERENCES,
    SENSORS,
    asymmetric_cylinder,
    measure,
    moves,
    record,
    smoothed,
)
from greygate.plants.preparation import filtered
from greygate.plants.simulator import simulate

STATES = ("x", "v", "p_a", "p_b", "p_s", "q_a", "q_b")


def run(plant, v_c, x_ref=0.0, samples=None):
    v_c = np.broadcast_to(v_c, samples or len(v_c)).astype(float)
    inputs = {"v_c": v_c, "x_ref": np.full(len(v_c), x_ref), "f_ext": np.zeros(len(v_c))}
    return simulate(plant, inputs, channels=STATES)


def test_it_stays_where_it_is_with_the_valve_closed():
    at = run(asymmetric_cylinder(), 0.0, samples=200)
    assert np.abs(at["x"]).max() < 1e-6
    k = {symbol: p.value for symbol, p in asymmetric_cylinder().parameters.items()}
    weight = at["p_a"][-1] * k["area_a"] - at["p_b"][-1] * k["area_b"]
    assert weight == pytest.approx(k["mass"] * k["gravity"], rel=1e-3)


@pytest.mark.parametrize("v_c", [1.0, -1.0])
def test_in_steady_motion_each_chamber_takes_the_flow_that_its_own_area_sweeps(v_c):
    at = run(asymmetric_cylinder(), v_c, samples=600)
    assert np.sign(at["v"][-1]) == np.sign(v_c)
    for chamber, sign, area in (("a", 1, 1963.5e-6), ("b", -1, 1001.4e-6)):
        assert at[f"q_{chamber}"][-1] == pytest.approx(sign * area * at["v"][-1], rel=0.01)


def test_nominal_flow_is_24_litres_a_minute_at_35_bar():
    k = {symbol: p.value for symbol, p in asymmetric_cylinder().parameters.items()}
    assert k["k_valve"] * k["u_max"] * np.sqrt(35e5) == pytest.approx(24e-3 / 60, rel=0.001)


def test_the_position_loop_goes_to_its_reference():
    at = run(asymmetric_cylinder(k_position=300.0), 0.0, x_ref=0.01, samples=1500)
    assert at["x"][-1] == pytest.approx(0.01, abs=2e-4)


def test_air_in_the_oil_makes_it_softer():
    held = {"mass": 1e9, "gravity": 0.0}  # too heavy to move: the flow goes into the oil alone
    stiff, soft = (run(asymmetric_cylinder(p_air=p, **held), 1.0, samples=12)["p_a"] for p in (0.0, 5e6))
    assert 0 < soft[-1] - soft[0] < stiff[-1] - stiff[0]


def test_a_parameter_that_it_has_not_is_named():
    with pytest.raises(InputError, match="'area'"):
        asymmetric_cylinder(area=1e-3)


def test_sensors_add_noise_and_the_filters_delay_every_channel_alike():
    samples = 3000
    v_c = smoothed(np.repeat([0.5, -0.5, 0.8], samples // 3), 5.0)
    still = np.zeros(samples)
    read = measure(asymmetric_cylinder(**DIFFERENCES), v_c, still, still, seed=5)
    lags = range(-20, 21)
    for name in ("u", "x", "p_a", "p_b"):
        got, true = smoothed(read[name], 20.0)[500:-500], smoothed(read[f"{name}_true"], 20.0)
        misses = [np.std(got - true[500 - lag : samples - 500 - lag]) for lag in lags]
        assert lags[int(np.argmin(misses))] == 2, name  # ms, sqrt(2) / (2 pi 100 Hz)
        assert 0 < min(misses) < SENSORS[name][1]
    again = measure(asymmetric_cylinder(**DIFFERENCES), v_c, still, still, seed=5)
    np.testing.assert_array_equal(read["p_b"], again["p_b"])


def test_a_reading_does_not_depend_on_what_comes_after_it():
    """Online there is no later sample."""
    raw = record("v3", cutoff=None)
    cut = replace(raw, channels={name: values[:600] for name, values in raw.channels.items()})
    early = filtered(cut, "low", CUTOFF, phase="causal", channels=tuple(SENSORS))
    for name in SENSORS:
        np.testing.assert_array_equal(record("v3")[name][:600], early[name])


@pytest.mark.parametrize(("name", "samples"), [("v3", 2_500), ("v5", 10_000), ("v6", 50_000)])
def test_validation_runs_stay_off_the_stops(name, samples):
    found = record(name)
    assert found.samples == samples
    assert np.abs(found["x_true"]).max() < 0.0499
    assert found["p_a_true"].min() > 1e5


@pytest.mark.parametrize(("name", "least", "most"), [("training", 0.08, 0.2), ("choice", 0.08, 0.2), ("v3", 0.0, 0.0)])
def test_the_valve_rests_in_what_is_trained_on(name, least, most):
    near = np.convolve(np.abs(record(name)["u"]), np.full(100, 0.01), "valid") < 0.05
    assert least <= near.mean() <= most


def test_moves_and_rests_alternate():
    moving = moves(20_000, 7)
    lengths = np.diff(np.flatnonzero(np.diff(moving.astype(int))))
    assert len(moving) == 20_000
    assert moving[0]
    assert (lengths >= 500).all()
    assert (lengths < 1500).all()


def test_an_unknown_record_is_refused():
    with pytest.raises(InputError, match="unknown; give one of training, choice, v3, v4, v5, v6"):
        record("validation")
