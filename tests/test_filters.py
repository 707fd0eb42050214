"""What a sensor was shown, from its reading."""

import numpy as np
import pytest

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
