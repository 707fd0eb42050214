"""How well records determine weights, and what the page of a training shows is what its JSON says."""

import json

import numpy as np
import pytest
from test_starts import record, write

from benchmarks.thesis.linear import arx
from greygate.identify.trained import deviations
from greygate.models.families.regression import nfir
from greygate.models.network import Port
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record

pytestmark = pytest.mark.usefixtures("alone")


def test_deviations_are_the_spread_of_weights_that_are_fitted_again_and_again():
    start, u = nfir("taps", {Port("u"): (0, 1)}, Port("y")), np.random.default_rng(0).normal(size=200)
    clean = 0.5 * u + 0.2 * np.r_[0.0, u[:-1]]
    found = []
    for seed in range(1, 201):
        noisy = Record({"u": u}, {"y": clean + 0.1 * np.random.default_rng(seed).normal(size=200)})
        found.append(deviations(train(start, noisy, epochs=5).network, [noisy]))
    for name in found[0]:
        values, told = np.array([f[name] for f in found]).T
        assert told.mean() == pytest.approx(values.std(), rel=0.2)  # 200 draws: 5 % of deviation


def test_a_weight_that_nothing_feels_is_not_known():
    still = Record({"u": np.zeros(50)}, {"y": np.random.default_rng(0).normal(size=50)})
    told = deviations(nfir("taps", {Port("u"): (0,)}, Port("y")), [still])
    assert told["sum.u_z0[0, 0]"][1] == np.inf
    assert np.isfinite(told["sum.bias[0]"][1])


def test_the_json_of_a_training_has_poles_weights_and_tests_with_what_to_do(greygate, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write("run.csv", record(1))
    lag = arx([record(1)], {Port("u"): (3,)}, Port("y"), (1,)).network  # two samples too late, and without the curve
    lag.save("lag")
    assert lag.parameters()["sum.y_z1"].item() > 0
    (tmp_path / "lag.toml").write_text(
        (tmp_path / "lag.toml")
        .read_text()
        .replace('unit = "1"', 'unit = "V"', 1)
        .replace('unit = "1"', 'unit = "m"', 1)
    )
    words = [
        "train",
        "lag.toml",
        "run.csv",
        "--epochs",
        "20",
        "--out",
        "out",
        "--html",
        "page.html",
        "--json",
    ]
    code, printed, _ = greygate(*words)
    assert code == 0
    evidence = json.loads(printed)["evidence"]
    (pole,) = evidence["poles"]
    assert pole == pytest.approx([evidence["weights"]["sum.y_z1[0, 0]"]["value"], 0.0])
    failed = {t["test"]: t["do"] for t in evidence["tests"] if not t["passed"]}
    assert failed["phi_ee"].startswith("the residual is not white: more taps of y")
    page = (tmp_path / "page.html").read_text()
    assert failed["phi_ee"] in page
    assert f"{pole[0]:.4f}" in page
