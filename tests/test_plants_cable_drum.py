"""The cable-drum rig: its slip, its drum, its courses, and what its sensors read."""

import numpy as np
import pytest

from greygate.errors import InputError
from greygate.machines.cable_drum.plant import (
    ANOTHER_DAY,
    BEACON,
    COUNTS,
    RADIUS,
    SAMPLE_TIME,
    STEP,
    TRAVEL,
    cable_drum,
    drift,
    measure,
    moves,
    record,
    round_trips,
    trapezoid,
)
from greygate.plants.simulator import simulate


def trip(speed: float, there: float = TRAVEL, **values: float) -> dict:
    rest = np.zeros(25)
    v_ref = np.concatenate([rest, trapezoid(there, speed, 0.5), rest])
    start = {"x": max(0.0, -there)}
    return simulate(
        cable_drum(**values),
        {"v_ref": v_ref, "warmth": 0 * v_ref},
        sample_time=SAMPLE_TIME,
        step=1e-3,
        initial=start,
        channels=("x", "phi", "slip", "load"),
    )


def test_slip_depends_on_direction_and_speed():
    there, back = (trip(0.05, way * TRAVEL)["slip"][-1] for way in (1, -1))
    assert there > 0 > back
    assert there + back > 20e-6  # what a round trip leaves
    assert trip(0.14)["slip"][-1] > 1.3 * there


def test_nothing_slips_at_rest_and_less_under_more_tension():
    still = trip(0.1, 0.0)
    assert np.ptp(still["slip"]) == np.ptp(still["phi"]) == 0.0
    assert 0 < trip(0.1, tension=60.0)["slip"][-1] < 0.8 * trip(0.1)["slip"][-1]


def test_an_eccentric_drum_errs_by_its_eccentricity_once_a_turn():
    free = {"f_drag": 0.0, "f_bias": 0.0, "damping": 0.0, "mass": 0.0, "micro": 0.0, "oval": 0.0, "radius": RADIUS}
    at = trip(0.1, ecc=40e-6, **free)
    e = at["x"] - RADIUS * at["phi"]
    assert np.ptp(e) == pytest.approx(80e-6, rel=0.02)
    line = np.abs(np.fft.rfft(np.interp(np.linspace(0, 8 * np.pi, 512, endpoint=False), at["phi"], e)))[1:]
    assert np.argmax(line) + 1 == 4  # periods in four turns


def test_accelerating_loads_the_cable():
    at = trip(0.14, f_drag=0.0, f_bias=0.0, damping=0.0)
    assert at["load"].max() > 0.08 > -0.08 > at["load"].min()


def test_a_move_goes_exactly_as_far_as_asked_and_courses_stay_on_the_travel():
    for distance in (0.6, -0.3, 1e-4):
        assert trapezoid(distance, 0.1, 0.5).sum() * SAMPLE_TIME == pytest.approx(distance, rel=1e-12)
    place = np.cumsum(moves(5000, 7)) * SAMPLE_TIME
    assert -1e-9 < place.min() < 0.1 < 0.5 < place.max() <= TRAVEL + 1e-9
    assert np.abs(np.cumsum(round_trips(0.1, 2))[-1]) < 1e-9


def test_encoder_scale_and_beacon_read_in_steps():
    v_ref = moves(3000, 4, home_every=3)
    read = measure(cable_drum(), v_ref, 5)
    counts = read["x_pe"] / STEP
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    np.testing.assert_allclose(np.exp(1j * read["theta"]), np.exp(2j * np.pi * counts / COUNTS), atol=1e-9)
    assert np.abs(read["theta"]).max() <= np.pi
    assert np.abs(read["x_true"][read["home"] == 1]).max() <= BEACON
    assert read["home"].sum() > 100
    assert 3e-6 < np.std(read["e"] - read["e_true"]) < 8e-6
    np.testing.assert_array_equal(read["e"], measure(cable_drum(), v_ref, 5)["e"])


def test_the_encoder_stands_still_where_the_carriage_does():
    read = measure(cable_drum(), np.r_[moves(300, 4), np.zeros(300)], 5)
    assert np.ptp(read["x_pe"][-200:]) == 0.0


def test_slow_drift_has_the_size_and_the_memory_that_it_claims():
    warmth = drift(1_000_000, np.random.default_rng(0))
    assert np.std(warmth) == pytest.approx(0.04, rel=0.1)
    assert np.corrcoef(warmth[:-3000], warmth[3000:])[0, 1] == pytest.approx(np.exp(-1), abs=0.1)


def test_validation_is_another_day_and_comes_home_and_an_unknown_record_is_refused():
    found = record("validation")
    assert found.samples * found.dt == 250.0
    assert np.sum(np.diff(found["home"]) > 0) >= 4
    assert all(cable_drum().parameters[name] and factor != 1 for name, factor in ANOTHER_DAY.items())
    assert record("training", f_bias=0.12)["e_true"][-1] < record("training")["e_true"][-1] / 2
    with pytest.raises(InputError, match="unknown; give one of training, choice, validation, trips_50"):
        record("v1")
