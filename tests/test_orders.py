import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.thesis.linear import arx
from benchmarks.thesis.orders import lipschitz
from greygate.errors import InputError
from greygate.machines.benchmark_systems.plant import b1, b1_input
from greygate.models.network import Port
from greygate.models.training.record import Record

U, Y = Port("u"), Port("y", scale=0.1)


def propose(u, y, most=5):
    return lipschitz([Record({"u": u}, {"y": y})], {U: range(1, most + 1)}, Y, range(1, most + 1))


def linear(u, delay=1):
    return lfilter([0.0] * delay + [1.0, 0.5], [1, -1.5, 0.7], u)


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_two_poles_and_two_input_taps_are_found_under_noise(noise):
    rng = np.random.default_rng(0)
    u = rng.uniform(-1, 1, 800)
    y = linear(u)
    found = propose(u, y + noise * y.std() * rng.normal(size=800))
    assert (found.inputs, found.feedback) == ({U: (1, 2)}, (1, 2))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("u", [b1_input, lambda seed: np.random.default_rng(seed).uniform(-1, 1, 501)])
def test_the_orders_of_the_first_benchmark_are_found(u, seed):
    found = propose(u(seed), b1(u(seed)), 4)
    assert (found.inputs, found.feedback) == ({U: (1,)}, (1, 2))


def test_the_curve_falls_up_to_the_order_and_no_further():
    u = np.random.default_rng(1).uniform(-1, 1, 600)
    curve = propose(u, linear(u)).curve
    assert len(curve) == 10
    assert (curve[:3] > 2 * curve[1:4]).all()
    assert (curve[3:-1] < 1.5 * curve[4:]).all()


def test_an_input_that_does_nothing_is_left_out():
    u, w = np.random.default_rng(2).uniform(-1, 1, (2, 600))
    record = Record({"u": u, "w": w}, {"y": linear(u)})
    found = lipschitz([record], {U: (1, 2, 3), Port("w"): (0, 1)}, Y, (1, 2, 3))
    assert found.signals == ("u", "w", "y")
    assert found.index.shape == (4, 3, 4)
    assert (found.inputs, found.feedback) == ({U: (1, 2), Port("w"): ()}, (1, 2))


def test_what_is_proposed_goes_into_a_model():
    u = np.random.default_rng(3).uniform(-1, 1, 400)
    record = Record({"u": u}, {"y": linear(u)})
    found = lipschitz([record], {U: (1, 2, 3)}, Y, (1, 2, 3))
    assert arx([record], found.inputs, Y, found.feedback).history[-1] < 1e-25


def test_scales_of_signals_do_not_count():
    u = np.random.default_rng(4).uniform(-1, 1, 300)
    a, b = propose(u, linear(u)), propose(1e3 * u, 1e-3 * linear(u))
    np.testing.assert_allclose(a.index, b.index, rtol=1e-6)


NOISE = np.random.default_rng(5).normal(size=200)


@pytest.mark.parametrize(
    ("u", "y", "message"),
    [
        (np.ones(200), NOISE, "u is constant"),
        (NOISE, np.ones(200), "y is constant"),
        (NOISE[:16], NOISE[:16], "11 rows for 10 taps.*of the candidates"),
        (NOISE[:4], NOISE[:4], "no record is longer than the deepest tap, 5"),
        (np.r_[NOISE[:-1], np.nan], NOISE, "u: NaN or inf at sample 199"),
    ],
)
def test_a_record_that_shows_no_order_is_named(u, y, message):
    with pytest.raises(InputError, match=message):
        propose(u, y)
