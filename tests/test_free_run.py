"""A pendulum swings freely in air, recorded from where it was let go: its own run alone tells where it began."""

import numpy as np
import pytest

from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.effects import known
from greygate.mismatch.fit import Unknown
from greygate.mismatch.rig import load
from greygate.mismatch.search import Hypothesis, Search
from greygate.mismatch.simulation import simulate

DT, STEP = 0.01, 2 * np.pi / 8192
PLANT = """
step = 2e-3
outputs = ["q"]
[parameters]
inertia = [0.02, "kg m^2", 0.1, "rod"]
moment = [0.5, "N m", 0.1, "weight times arm"]
b = [1e-3, "N m s", 1.0, "bearing"]
[states]
q = { unit = "rad", rate = "w" }
w = { unit = "rad/s" }
[equations]
way.q = { speed = "w" }
swing.w = { storage = "inertia", gravity = "-moment * sin(q)", bearing = "-b * w" }
"""
RIG = """
plant = "plant.toml"
sample_time_s = 0.01
predict = ["q"]
[parameters]
inertia = 0.02
moment = 0.5
b = 1e-3
[tolerance]
inertia = 0.1
moment = 0.1
b = 1.0
[channels.q]
unit = "rad"
role = "output"
"""


def swung(begin: float, samples: int, viscous=1e-3, dry=0.0, drag=0.0) -> np.ndarray:
    """Angle (samples,) in rad, let go at rest, by Runge and Kutta in steps of a tenth of a sample."""

    def rates(x):
        torque = -0.5 * np.sin(x[0]) - viscous * x[1] - dry * np.tanh(x[1] / 1e-2) - drag * abs(x[1]) * x[1]
        return np.array([x[1], torque / 0.02])

    x, h, out = np.array([begin, 0.0]), DT / 10, []
    for _ in range(samples):
        out.append(x[0])
        for _ in range(10):
            a = rates(x)
            b = rates(x + h / 2 * a)
            c = rates(x + h / 2 * b)
            x = x + h / 6 * (a + 2 * b + 2 * c + rates(x + h * c))
    return np.array(out)


def rig(folder, lost: int = 0, **truth):
    rng = np.random.default_rng(5)
    (folder / "plant.toml").write_text(PLANT)
    (folder / "rig.toml").write_text(RIG)
    for name, begin, gone in (("identify", 1.2, lost), ("holdout", 0.8, 0)):
        q = np.delete(swung(begin, 2001 + gone, **truth), np.arange(700, 700 + gone))
        read = np.round((q + rng.normal(0, 2e-4, len(q))) / STEP) * STEP
        rows = [f"{k * DT:.2f},{angle:.9g}" for k, angle in enumerate(read)]
        (folder / f"{name}.csv").write_text("\n".join(["t,q", *rows]) + "\n")
    return load(folder)


def test_nothing_is_missing_where_the_pendulum_was_let_go_at_rest(tmp_path):
    loaded = rig(tmp_path)
    found = diagnose(loaded).as_dict()
    assert found["verdict"] == "consistent"
    recording = loaded.to_explain()
    error = simulate(loaded, recording, found)["q"] - recording["q"]  # the same run, where it began
    assert np.sqrt(np.mean(error**2)) == pytest.approx(found["fit"]["identify"]["q"]["corrected"], rel=1e-9)
    low, high = found["parameters"]["inertia"]["ci95"]  # inertia, weight and friction are known to a common factor
    assert low < 0.019
    assert high > 0.021


@pytest.mark.nightly
def test_dry_friction_and_the_drag_of_the_air_are_both_named(tmp_path):
    found = diagnose(rig(tmp_path, viscous=2e-4, dry=1.5e-3, drag=8e-4)).as_dict()
    assert {e["id"] for e in found["effects"]} == {"dry_friction", "square_damping"}
    held = found["fit"]["holdout"]["q"]
    assert held["corrected"] < 0.1 * held["calibrated"]


@pytest.mark.nightly
def test_four_lost_samples_are_found(tmp_path):
    found = diagnose(rig(tmp_path, lost=4)).as_dict()
    assert [e["id"] for e in found["effects"]] == ["lost_samples"]
    numbers = found["effects"][0]["parameters"]
    assert numbers["q_lost"]["value"] == pytest.approx(4 * DT, rel=0.01)
    assert numbers["q_since"]["value"] == pytest.approx(7.0, abs=DT * 1.1)


def test_a_run_begins_where_a_sensor_with_an_offset_showed_it(tmp_path):
    loaded = rig(tmp_path)
    recording = loaded.to_explain()
    search = Search(loaded, recording, known(loaded, recording))
    model = search.final.model
    assert list(model.begins.values()) == ["q", "w"]
    read, off = model.predict(model.values), model.predict({**model.values, "q_offset": 0.1})
    assert off[0, 0] == pytest.approx(read[0, 0])  # the state began 0.1 lower, and is read as much higher
    assert np.abs(off - read).max() > 0.05
    unknowns = search.unknowns(Hypothesis())
    assert {u.symbol for u in unknowns} >= set(model.begins)
    assert all(isinstance(u, Unknown) and u.prior > 0 for u in unknowns)
