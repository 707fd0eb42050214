"""The pump-controlled cylinder: statics of table 6.1, both loops, and what its sensors make of it."""

import numpy as np
import pytest

from greygate.errors import InputError
from greygate.machines.pump_cylinder.plant import DIFFERENCES, SENSORS, measure, pump_cylinder, record
from greygate.plants.simulator import simulate

K = {symbol: p.value for symbol, p in pump_cylinder().parameters.items()}


def run(
    plant, samples, x_ref=0.0, n_ref=0.0, p_ref=12e6, channels=("x", "v", "p_a", "p_b", "n_1", "n_2", "q_a", "q_b")
):
    inputs = {"x_ref": x_ref, "n_ref": n_ref, "p_ref": p_ref}
    return simulate(plant, {n: np.full(samples, float(v)) for n, v in inputs.items()}, channels=channels)


def test_lambda_and_psi_of_the_thesis_hold_12_mpa_by_feedforward_alone():
    at = run(pump_cylinder(gravity=0.0, k_sum=0.0, k_position=0.0), 1000)
    assert at["p_a"][-1] + at["p_b"][-1] == pytest.approx(12e6, rel=0.01)
    assert abs(at["v"][-1]) < 1e-5


def test_the_loops_hold_position_and_sum_on_the_rig_too():
    at = run(pump_cylinder(**DIFFERENCES), 6000, x_ref=0.01, p_ref=13e6)
    assert at["x"][-1] == pytest.approx(0.01, abs=3e-4)
    assert at["p_a"][-1] + at["p_b"][-1] == pytest.approx(13e6, rel=0.005)


@pytest.mark.parametrize("n_ref", [3.0, -3.0])
def test_in_steady_motion_the_rod_side_swallows_what_pump_2_delivers(n_ref):
    at = run(pump_cylinder(k_position=0.0), 600, n_ref=n_ref)
    assert at["q_b"][-1] == pytest.approx(K["area_b"] * at["v"][-1], rel=0.01)
    assert at["q_a"][-1] == pytest.approx(K["area_a"] * at["v"][-1], rel=0.01)
    assert np.sign(at["v"][-1]) == np.sign(n_ref)


def test_with_still_pumps_leakage_empties_both_chambers():
    at = run(pump_cylinder(n_max=0.0), 3000)
    assert 0 <= at["p_a"][-1] < 0.1 * at["p_a"][0]
    assert 0 <= at["p_b"][-1] < 0.1 * at["p_b"][0]


def test_sensors_add_noise_in_steps_and_the_seed_alone_decides_it():
    still, p_ref = np.zeros(2000), np.full(2000, 12e6)
    read = measure(pump_cylinder(), still, still, p_ref, seed=5)
    for name, (_, noise, step) in SENSORS.items():
        error = read[name] - read[f"{name}_true"]
        assert np.std(error) == pytest.approx(np.hypot(noise, step / np.sqrt(12)), rel=0.1)
        np.testing.assert_allclose(read[name] / step, np.round(read[name] / step), atol=1e-6)
    again = measure(pump_cylinder(), still, still, p_ref, seed=5)
    np.testing.assert_array_equal(read["x"], again["x"])


def test_the_chirp_has_50000_samples_and_no_bound_is_touched():
    found = record("rig_chirp")
    assert found.samples == 50_000
    assert np.abs(found["x_true"]).max() < 0.04
    assert min(found["p_a_true"].min(), found["p_b_true"].min()) > 1e6
    assert np.ptp(found["p_b_true"]) > 1.5e6
    with pytest.raises(InputError, match="unknown; give one of training"):
        record("v3")
