"""The step within bounds and the damping that trainings and fits share."""

import numpy as np
import pytest

from greygate.models.training.gauss_newton import Decades, Nielsen, bounded, search

CURVATURE = np.array([[2.0, 0.5], [0.5, 1.0]])
MINIMUM = np.array([3.0, -2.0])


def stepped(x, low=(-np.inf, -np.inf), high=(np.inf, np.inf)) -> np.ndarray:
    """Where one undamped step leads in a bowl with its minimum at MINIMUM."""
    x = np.array(x, float)
    gradient = CURVATURE @ (x - MINIMUM)

    def step(moving):
        return -np.linalg.solve(CURVATURE[np.ix_(moving, moving)], gradient[moving])

    return bounded(x, gradient, np.array(low), np.array(high), step)


def test_without_bounds_a_step_leads_to_the_minimum():
    np.testing.assert_allclose(stepped([0.0, 0.0]), MINIMUM, atol=1e-12)


def test_a_variable_at_its_bound_stays_and_the_other_goes_to_the_minimum_that_is_left():
    found = stepped([1.0, 0.0], high=(1.0, np.inf))
    np.testing.assert_allclose(found, [1.0, -2.0 + 0.5 * (3.0 - 1.0)], atol=1e-12)


def test_a_variable_at_its_bound_leaves_it_where_the_cost_falls_inside():
    np.testing.assert_allclose(stepped([0.0, 0.0], low=(0.0, -np.inf)), MINIMUM, atol=1e-12)


def test_a_step_ends_at_the_bound_that_it_would_cross():
    assert stepped([0.0, 0.0], high=(1.0, 10.0))[0] == 1.0


def test_where_every_variable_is_at_its_bound_none_moves():
    np.testing.assert_array_equal(stepped([1.0, 0.0], low=(-9.0, 0.0), high=(1.0, 9.0)), [1.0, 0.0])


@pytest.mark.parametrize("damping", [Nielsen(), Decades()])
def test_the_damping_rises_until_an_attempt_succeeds(damping):
    tried = []

    def attempt(value):
        tried.append(value)
        return "found" if value > 1.0 else None

    assert search(attempt, damping) == "found"
    assert tried == sorted(tried)
    assert tried[-1] == damping.value > 1.0 >= tried[-2]


@pytest.mark.parametrize("damping", [Nielsen(), Decades()])
def test_a_search_in_vain_ends(damping):
    tried = []
    assert search(tried.append, damping) is None
    assert len(tried) < 20


def test_nielsens_damping_falls_to_a_third_after_a_step_as_predicted_and_rises_after_a_poor_one():
    damping = Nielsen(1.0, 8.0)
    damping.fall(1.0)
    assert (damping.value, damping.growth) == (1 / 3, 2.0)
    damping.fall(0.1)
    assert damping.value == pytest.approx(1 / 3 * (1 + 0.8**3))


def test_damping_by_decades_starts_at_none_and_ends_there():
    damping = Decades()
    damping.rise()
    assert damping.value == 1e-2
    for _ in range(3):
        damping.fall()
    assert damping.value == 0.0
