"""What `greygate validate` says should be done, and the linear model beside `greygate train`."""

import json
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from greygate.models.families.regression import noe
from greygate.models.network import Port
from greygate.models.training.record import Record
from greygate.models.validation import validate
from greygate.pages.validation.judged import Judged, advice, settling
from greygate.plants.excitation import prms
from greygate.plants.recording import Recording

LAG = noe("lag", {Port("u"): (1,)}, Port("y"), (1,)).with_parameters({"sum.u_z1": [[0.2]], "sum.y_z1": [[0.8]]})
NOISE = 0.01


def judged(network, late: int = 0, start: float = 0.0, samples: int = 600) -> Judged:
    """A lag's recording of an input, `late` samples late and from another state, judged by a network."""
    u = prms(samples + late, -1, 1, (5, 30), 3)
    noise = lfilter([NOISE], [1.0, -0.8], np.random.default_rng(0).normal(size=samples))  # it enters with the input
    y = LAG.run({"u": u[:samples]})["y"] + noise
    y = y + start * 0.8 ** np.arange(samples)
    record = Record({"u": u[late:]}, {"y": y})
    return Judged("t", "lag", 3, 1.0, (), validate(network, {"r": record}, period=1.0), [])


def test_a_network_that_is_right_needs_no_advice():
    assert advice(judged(LAG)) == []


def test_a_state_that_is_not_rest_asks_for_settling():
    found = judged(LAG, start=2.0)
    samples, ratio = settling(found.validations[0])
    assert samples in (20, 50)
    assert ratio > 3
    assert any(f"--settle {samples}" in line for line in advice(found))
    settled = replace(found.validations[0], skip=samples)
    assert settling(settled) is None


def test_a_missing_tap_is_named_with_its_input():
    assert any("u is left in the residual" in line for line in advice(judged(LAG, late=3)))


def test_an_unstable_network_is_told_what_may_help():
    wild = LAG.with_parameters({"sum.y_z1": [[1.02]]})
    assert any("leaves what was measured" in line for line in advice(judged(wild)))


def test_training_shows_a_linear_model_beside(greygate, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    u = prms(300, -1, 1, (5, 30), 1)
    Recording(0.1, {"u": u, "y": np.abs(LAG.run({"u": u})["y"])}, {"u": "V", "y": "m"}).write_csv("a.csv")
    noe("mine", {Port("u", "V"): (1, 2)}, Port("y", "m"), (1, 2), hidden=4).save("mine")
    code, printed, _ = greygate("train", "mine.toml", "a.csv", "--epochs", "30", "--out", "out", "--json")
    found = json.loads(printed)
    assert code == 0
    assert 0 < found["rmse"]["a"]["y"] < found["linear"]["a"]["y"]
