import numpy as np
import pytest

from greygate.machines.measured.axis import FORCE, POSITION, axis, moving, starting
from greygate.models.accuracy import rmse
from greygate.models.training.record import Record

PERIOD = 1e-3


def by_hand(force, place, speed, mass, viscous, coulomb, offset):
    """Semi-implicit Euler in SI units; force[k - 1] acts at step k."""
    found = []
    for f in np.r_[0.0, force[:-1]]:
        speed += PERIOD / mass * (f - viscous * speed - coulomb * np.tanh(speed / 1e-3) - offset)
        place += PERIOD * speed
        found.append(place)
    return np.array(found)


def test_the_axis_is_the_equation_written_by_hand():
    force = 60 * np.sin(np.arange(3000) / 300)
    network = axis(90.0, 180.0, 15.0, 2.0)
    answer = network.run({FORCE.name: force})[POSITION.name]
    np.testing.assert_allclose(np.ravel(answer), by_hand(force, 0.0, 0.0, 90.0, 180.0, 15.0, 2.0), rtol=0, atol=1e-12)


@pytest.fixture
def run():
    force = 70 * np.sin(np.arange(4000) / 400)
    network = axis()
    return network, Record({FORCE.name: force}, {POSITION.name: np.ravel(network.run({FORCE.name: force})["position"])})


@pytest.mark.parametrize("start", [700, 2000])
def test_a_piece_starts_in_the_state_that_its_first_samples_show(run, start):
    network, whole = run
    assert rmse(network, moving(whole, start, 4000, 20)) < 2e-5


def test_hardware_starts_as_the_record_does(run):
    network, whole = run
    piece = moving(whole, 2000, 4000, 20)
    same = starting(network, piece)
    assert rmse(same, Record(piece.inputs, piece.targets, skip=20)) == rmse(network, piece)
