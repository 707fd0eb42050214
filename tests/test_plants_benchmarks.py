import numpy as np
import pytest

from greygate.errors import InputError
from greygate.machines.benchmark_systems.plant import b1, b1_input, b2, b2_input, b2_test_input


def test_b1_is_its_equation_at_every_sample():
    u, k = b1_input(), np.arange(2, 501)
    y = b1(u)
    product = 2.5 * y[k - 1] * y[k - 2] / (1 + y[k - 1] ** 2 + y[k - 2] ** 2)
    np.testing.assert_allclose(y[k], product + 0.3 * np.cos(0.5 * (y[k - 1] + y[k - 2]) + 1.2 * u[k - 1]), rtol=1e-14)
    np.testing.assert_allclose(b1([1.0, 0.0])[:2], [0.3, 0.3 * np.cos(0.15 + 1.2)], rtol=1e-15)


def test_b2_is_its_equation_at_every_sample():
    u, k = b2_input(), np.arange(2, 1000)
    y = b2(u)
    numerator = y[k] * y[k - 1] * y[k - 2] * u[k - 1] * (y[k - 2] - 1) + u[k]
    np.testing.assert_allclose(y[k + 1], numerator / (1 + y[k - 2] ** 2 + y[k - 1] ** 2), rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(b2([0.5, 0.25])[:2], [0.0, 0.5])


def test_training_and_validation_signals_are_those_of_the_thesis():
    assert (len(b1_input()), len(b2_input()), len(b2_test_input())) == (501, 1001, 1000)
    for u in (b1_input(3), b2_input(3)):
        assert -1 <= u.min() < -0.9
        assert 0.9 < u.max() <= 1
    u = b2_test_input()
    assert u[500] == np.sin(4 * np.pi)
    np.testing.assert_allclose(u[510], 0.8 * np.sin(2 * np.pi * 510 / 250) + 0.2 * np.sin(2 * np.pi * 510 / 25))


@pytest.mark.parametrize("u", [[np.nan], 1.0, [[1.0]]])
def test_an_input_that_is_no_finite_sequence_is_named(u):
    with pytest.raises(InputError, match="b1: u is"):
        b1(u)
