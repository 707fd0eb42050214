"""`seconds` is kept by a plant whose simulation is slow, and what is not tested in time is not claimed."""

import importlib

import numpy as np
import pytest

from greygate import Recording, Simulator, diagnose, progress, simulate
from greygate.mismatch import cores
from greygate.mismatch.given import rig_of

finding = importlib.import_module("greygate.mismatch.diagnose")  # the package has a function of this name
SAMPLES = 300
RUN = 6 * (SAMPLES - 1)  # calls of the function in a run
BESIDE = 50  # runs that a diagnosis needs before a search and after it


def cart(t, x, u, p):
    return x[1], (u[0] - p.viscous * x[1]) / p.mass


class Slow:
    """The same; each call takes a second of a clock of its own."""

    def __init__(self):
        self.calls = 0

    def now(self) -> float:
        return self.calls

    def __call__(self, t, x, u, p):
        self.calls += 1
        return cart(t, x, u, p)


def plant(function, compiled=False):
    return Simulator(
        function, dt=0.01, states={"x": {"unit": "m", "rate": "v"}, "v": "m/s"}, inputs={"force": "N"}, outputs=["x"],
        parameters={"mass": [2.0, "kg", 0.05], "viscous": [4.0, "N s/m", 0.2]}, storage={"v": "mass"},
        compiled=compiled,
    )  # fmt: skip


@pytest.fixture(scope="module")
def recording():
    """With dry friction."""
    rng = np.random.default_rng(2)
    force = 10.0 * np.repeat(rng.standard_normal(SAMPLES // 20), 20)
    real = Simulator(
        lambda t, x, u, p: (x[1], (u[0] - p.viscous * x[1] - 2.0 * np.tanh(x[1] / 0.01)) / p.mass),
        dt=0.001, states={"x": {"unit": "m", "rate": "v"}, "v": "m/s"}, inputs={"force": "N"}, outputs=["x"],
        parameters={"mass": [2.0, "kg"], "viscous": [4.0, "N s/m"]}, compiled=True,
    )  # fmt: skip
    x = simulate(real, {"force": force}, sample_time=0.01)["x"] + 1e-4 * rng.standard_normal(SAMPLES)
    return Recording(0.01, {"force": force, "x": x}, {"force": "N", "x": "m"})


@pytest.mark.parametrize("told", [{}, {"noise_rms": {"x": 1e-4}}], ids=["noise untold", "noise told"])
@pytest.mark.parametrize("runs", [1, pytest.param(30, marks=pytest.mark.nightly), 150])
def test_the_time_is_kept_within_the_fit_of_a_hypothesis(recording, told, runs, monkeypatch):
    slow = Slow()
    monkeypatch.setattr(progress, "monotonic", slow.now)
    found = diagnose(plant(slow), recording, seconds=runs * RUN, **told).as_dict()
    assert slow.calls < (1.2 * runs + BESIDE) * RUN
    assert found["not_tried"]
    assert not found["effects"]


def test_what_is_not_tested_in_time_is_not_claimed(recording, monkeypatch):
    slow = Slow()
    monkeypatch.setattr(cores, "CORES", 1)  # threads side by side would spend each other's time
    monkeypatch.setattr(progress, "monotonic", slow.now)
    monkeypatch.setattr(finding, "GRACE", 0.0)  # no time after that of the search, cut among the rivals
    found = diagnose(plant(slow), recording, seconds=240 * RUN, noise_rms={"x": 1e-4}).as_dict()
    assert found["verdict"] == "unexplained"
    assert not found["effects"]
    assert "dry_friction is not claimed: there was no time to test it" in found["refused"]
    assert "the parameters are left as on the data sheet: there was no time to test others" in found["refused"]
    assert {s: p["value"] for s, p in found["parameters"].items()} == {"mass": 2.0, "viscous": 4.0}


def test_a_claim_that_has_time_is_made(recording):
    found = diagnose(plant(cart, True), recording, seconds=1e9, noise_rms={"x": 1e-4}).as_dict()
    assert "not_tried" not in found
    assert "dry_friction" in [e["id"] for e in found["effects"]]


def test_a_claim_stays_where_time_ends_under_the_noise_that_the_recording_shows(recording):
    """And is none that is sure: that noise might be what it stands for."""
    budget = progress.Budget()

    def say(text: str) -> None:
        if text.startswith("searching again: the noise"):
            budget.stop()

    found = diagnose(plant(cart, True), recording, progress=say, budget=budget, noise_rms={"x": 2e-5}).as_dict()
    assert "the noise that the recording shows" in found["not_tried"]
    assert not found["noise"]["x"]["as_told"]
    assert ("dry_friction", True) in [(e["id"], 0.5 < e["confidence"] < 0.9) for e in found["effects"]]


@pytest.mark.parametrize("runs", [30, pytest.param(100, marks=pytest.mark.nightly), 400])
def test_a_budget_of_work_ends_alike_on_one_core_and_on_many(recording, runs, monkeypatch):
    monkeypatch.setattr(cores, "WORTH", 0.0)

    def found(count: int) -> dict:
        monkeypatch.setattr(cores, "CORES", count)
        work = progress.Budget(work=runs * 2 * SAMPLES)
        told = rig_of(plant(cart), recording, noise_rms={"x": 1e-4})
        return {key: value for key, value in diagnose(told, budget=work).as_dict().items() if key != "seconds"}

    one = found(1)
    assert one == found(2)
    assert one["not_tried"]


def test_work_is_counted_alike_on_one_core_and_on_many(monkeypatch):
    monkeypatch.setattr(cores, "WORTH", 0.0)

    def found(count: int, most: float) -> tuple[int, bool]:
        monkeypatch.setattr(cores, "CORES", count)
        before, budget, ended = progress.worked(), progress.Budget(work=most), True
        with budget.searching(), progress.cut():
            cores.each(worth, [1, 2, 3, 4])
            ended = False
        return progress.worked() - before, ended

    assert found(1, 1000.0) == found(2, 1000.0) == (20, False)
    assert found(1, 10.0) == found(2, 10.0) == (8, True)  # the third would take more than its part of six


def worth(item: int) -> int:
    for _ in range(item):
        progress.spend(2)
        progress.check()
    return item


@pytest.mark.parametrize("seconds", [np.inf, 100.0])
def test_what_is_stopped_has_a_share_of_the_time_until_then_to_end(seconds, monkeypatch):
    slow = Slow()
    monkeypatch.setattr(progress, "monotonic", slow.now)
    budget = progress.Budget(seconds)
    slow.calls = 10
    budget.stop()
    assert (budget.over, budget.late(0.5)) == (True, False)
    slow.calls = 15
    assert budget.late(0.5)
