"""What a sensor was shown, from its reading."""

import numpy as np
import pytest

from greygate.mismatch import filters
from greygate.mismatch.filters import SENSOR, unfiltered

DT = 1e-3


@pytest.mark.parametrize(("kind", "parameters"), [("late", (3 * DT,)), ("late", (-2 * DT,)), ("lost", (4 * DT, 0.05))])
def test_what_only_moves_in_time_is_moved_back_exactly(kind, parameters):
    shown = np.cumsum(np.random.default_rng(1).standard_normal(200))
    back = unfiltered(kind, SENSOR[kind](shown, *parameters, DT), parameters, DT)
    inside = np.r_[5:50, 60:190]  # not what was lost, nor the ends
    np.testing.assert_array_equal(back[inside].round(9), shown[inside].round(9))


def test_a_fast_clock_is_undone_between_samples():
    shown = 0.5 * np.arange(300.0)
    back = unfiltered("clock", SENSOR["clock"](shown, 0.01, DT), (0.01,), DT)
    np.testing.assert_allclose(back[:290], shown[:290], atol=1e-9)


SWING = 2 * np.pi / 20  # rad a sample: twenty samples a swing
CLOCK = np.arange(400.0)


@pytest.mark.parametrize("by", [-3.3, 0.07, 0.5, 1.0, 7.25])
def test_a_swing_of_twenty_samples_is_late_to_a_few_parts_in_ten_thousand(by):
    """Straight between samples it would err by twelve in a thousand."""
    found = filters.late(np.sin(SWING * CLOCK), 0.01 * by, 0.01)
    assert np.abs(found - np.sin(SWING * (CLOCK - by)))[20:-20].max() < 5e-4


@pytest.mark.parametrize("lag", [1e-3, 0.2, 0.5, 1.0, 3.0, 1e3])
def test_a_swing_of_twenty_samples_is_behind_as_a_lag_answers_it(lag):
    """lag: in samples. The answer from rest at the first reading, in the closed form."""
    phase, size = np.arctan(SWING * lag), 1 / np.hypot(1.0, SWING * lag)
    exact = size * (np.sin(SWING * CLOCK - phase) + np.sin(phase) * np.exp(-CLOCK / lag))
    found = filters.behind(np.sin(SWING * CLOCK), 0.01 * lag, 0.01)
    assert found[0] == 0.0
    assert np.abs(found - exact).max() < 2e-3 * min(1.0, 1 / lag)  # at the ends, which a parabola continues
    assert np.abs(found - exact)[20:-20].max() < 3e-4


@pytest.mark.parametrize("samples", [1, 2, 3, 4, 5])
def test_a_parabola_is_read_exactly_and_what_is_constant_stays_so(samples):
    k = np.arange(float(samples))
    if samples >= 4:
        assert filters.late(k**2, 0.5, 1.0)[1:] == pytest.approx((k[1:] - 0.5) ** 2)
        behind = k**2 - 4.0 * k + 8.0 * (1 - np.exp(-k / 2.0))
        assert filters.behind(k**2, 2.0, 1.0) == pytest.approx(behind)
    for function in (filters.late, filters.behind):
        assert function(np.full(samples, 7.0), 0.3, 1.0) == pytest.approx(np.full(samples, 7.0))


def test_a_reading_is_undone_straight_between_samples_which_keeps_less_of_its_noise():
    noise = np.random.default_rng(1).standard_normal(50)
    undone = unfiltered("late", noise, (0.5,), 1.0)
    assert undone[:-1] == pytest.approx((noise[:-1] + noise[1:]) / 2)
