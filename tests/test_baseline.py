"""The linear model beside a network is the strongest that is found in seconds."""

import numpy as np

from greygate.identify.baseline import linear, linear_rms
from greygate.machines.measured.study import STUDIES
from greygate.models.training.record import Record

N = 600


def record(system, seed: int, inputs: int = 1) -> Record:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.normal(size=(N // 5, inputs)), 5, axis=0)
    u[:10], y = 0.0, np.zeros(N)  # it begins at rest
    for k in range(8, N):
        y[k] = system(u, y, k)
    return Record({"u": u if inputs > 1 else u[:, 0]}, {"y": y})


def late(u, y, k):  # order 4 with a delay of 3: no model of order 2 is near it
    return 1.5 * y[k - 1] - 0.9 * y[k - 2] + 0.4 * y[k - 3] - 0.2 * y[k - 4] + u[k - 3, 0] - 0.4 * u[k - 4, 0]


def test_a_plant_of_fourth_order_with_a_delay_is_found():
    test = record(late, 2)
    rms = linear_rms([record(late, 1)], {"test": test})["test"]["y"]
    assert rms < 1e-3 * np.std(test.targets["y"])


def test_every_column_of_a_port_is_a_port_of_the_linear_model():
    def both(u, y, k):
        return 0.6 * y[k - 1] + u[k - 1, 0] - 2 * u[k - 1, 1]

    one, test = record(both, 1, 2), record(both, 2, 2)
    wide = [Record(r.inputs, {"y": np.stack([r.targets["y"], 3 * r.targets["y"]], 1)}) for r in (one, test)]
    assert linear_rms(wide[:1], {"test": wide[1]})["test"]["y"] < 1e-3 * np.std(wide[1].targets["y"])


def test_where_nothing_moves_or_a_record_is_too_short_it_is_the_mean():
    still = Record({"u": np.zeros(200)}, {"y": np.full(200, 3.0)})
    short = Record({"u": np.arange(8.0)}, {"y": np.arange(8.0) ** 2})
    for r in (still, short):
        np.testing.assert_allclose(linear([r]).run(r.inputs)["y"], np.mean(r.targets["y"]))


def test_on_two_tanks_it_is_stronger_than_what_identify_found_in_its_time():
    training, tests = STUDIES["tanks"].runs()
    assert linear_rms(list(training.values()), tests)["test"]["y"] < 0.65  # there 0.664
