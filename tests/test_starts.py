"""`greygate train --seeds` and `--settle auto`: several starts, and how many samples only give the initial state."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from networks import delay_line

from greygate.errors import InputError
from greygate.identify.sensors import own_sensors
from greygate.identify.settling import settling
from greygate.identify.training import drawn, of_starts
from greygate.models.families.library import library
from greygate.models.families.regression import noe
from greygate.models.linearised import linearised
from greygate.models.network import Layer, Network, Port
from greygate.models.training.objective import Objective, best_gain
from greygate.models.training.record import Record
from greygate.plants.excitation import prms
from greygate.plants.recording import Recording

pytestmark = pytest.mark.usefixtures("alone")

POLE, NOISE = 0.9, 0.002


def record(seed: int, start: float = 0.0, samples: int = 400, gain: float = 1.0, offset: float = 0.0) -> Record:
    """A lag behind a curve, from an output of `start`; its sensor has a gain and an offset."""
    u, y = prms(samples, -1, 1, (5, 30), seed), np.full(samples, start)
    for k in range(1, samples):
        y[k] = POLE * y[k - 1] + (1 - POLE) * np.tanh(2 * u[k - 1])
    noise = NOISE * np.random.default_rng(seed).normal(size=samples)
    return Record({"u": u}, {"y": gain * y + offset + noise})


def write(path, record: Record, dt: float = 0.01) -> None:
    Recording(dt, {**record.inputs, **record.targets}, {"u": "V", "y": "m"}).write_csv(path)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    noe("mine", {Port("u", "V"): (1,)}, Port("y", "m"), (1,), hidden=3).save("mine")
    for name, seed, start in (("rest", 1, 0.0), ("away", 2, 1.5), ("held", 3, -0.5)):
        write(f"{name}.csv", record(seed, start))
    return tmp_path


def test_the_start_with_the_least_held_out_error_is_written_and_all_are_told(greygate, folder):
    words = ["train", "mine.toml", "rest.csv", "--held", "held.csv", "--seeds", "3", "--epochs", "25"]
    code, printed, said = greygate(*words, "--settle", "40", "--out", "out", "--html", "page.html")
    assert code == 0
    found = json.loads((folder / "out" / "mine.json").read_text())
    errors = [start["held_out"] for start in found["starts"]]
    assert sorted(start["start"] for start in found["starts"]) == [0, 1, 2]
    assert errors == sorted(errors)
    assert found["history"] == found["starts"][0]["history"]
    assert found["rmse"]["held"]["y"] == pytest.approx(errors[0])  # the scale of the port is 1
    assert f"{errors[0]:.4g}" in printed
    assert "judge on another recording" in said
    assert sorted(p.suffix for p in (folder / "out").iterdir()) == [".json", ".safetensors", ".toml"]
    worst = max(found["rmse"], key=lambda name: found["rmse"][name]["y"])
    first = re.search(r"<li><b>([\d.]+) (\S+)</b><span>(.*?)</span>", (folder / "page.html").read_text())
    assert float(first[1]) * {"mm": 1e-3, "µm": 1e-6}[first[2]] == pytest.approx(found["rmse"][worst]["y"], rel=0.01)
    assert first[3].startswith(f"RMS in free run of y on {worst}")


def test_several_starts_need_something_that_chooses(greygate, folder):
    code, _, said = greygate("train", "mine.toml", "rest.csv", "--seeds", "2", "--out", "out")
    assert code == 2
    assert "--held FILE.csv or --tail 0.2" in said
    assert not (folder / "out").exists()


def test_drawing_keeps_library_networks_and_refuses_what_has_no_neurons():
    network = Network("whole", [Port("x")], [Port("y")])
    network.add("bent", library("square"))
    network.add("hidden", Layer({"x": np.ones((3, 1))}, np.zeros(3), "tansig"))
    network.add("out", Layer({"hidden": np.ones((1, 3)), "bent": [[1.0]]}, [0.0]))
    for source, target in (("x", "bent.x"), ("x", "hidden.x"), ("hidden", "out.hidden"), ("bent.y", "out.bent")):
        network.connect(source, target)
    network.connect("out", "y")
    before, after = network.parameters(), drawn(network, 1).parameters()
    moved = {n for n in before if not np.array_equal(before[n], after[n])}
    assert moved == {"hidden.x", "hidden.bias", "out.hidden"}
    with pytest.raises(InputError, match="no neurons to draw"):
        drawn(delay_line(), 1)


def test_a_recording_from_rest_settles_in_no_sample_and_one_that_is_not_in_what_its_pole_takes():
    line = noe("line", {Port("u"): (1,)}, Port("y"), (1,))
    assert settling(line, {"rest": record(1)}).samples == 0
    found = settling(line, {"rest": record(1), "away": record(2, 5.0, samples=1000)})
    assert "y of away begins" in found.why
    assert found.samples == 40  # a tenth of the shorter one
    takes = np.log(0.01) / np.log(POLE)
    assert settling(line, {"away": record(2, 5.0, samples=1000)}).samples == pytest.approx(takes, rel=0.4)


def test_a_training_settles_by_itself_and_says_so(greygate, folder):
    words = ["train", "mine.toml", "rest.csv", "away.csv", "--epochs", "25"]
    code, printed, said = greygate(*words, "--settle", "auto", "--out", "out", "--json")
    assert code == 0
    assert json.loads(printed)["settle"] == 40
    assert "--settle 40: y of away begins" in said
    assert json.loads(printed)["rmse"]["away"]["y"] < 2 * NOISE


def test_poles_and_response_of_a_linear_network_are_those_of_its_difference_equation():
    model = noe("two", {Port("u", scale=2.0): (1, 3)}, Port("y", scale=5.0), (1, 2)).with_parameters(
        {"sum.u_z1": [[0.2]], "sum.u_z3": [[0.1]], "sum.y_z1": [[1.5]], "sum.y_z2": [[-0.7]]}
    )
    about = linearised(model, Record({"u": np.ones(50)}, {"y": np.zeros(50)}))
    assert np.sort_complex(about.poles()) == pytest.approx(np.sort_complex(np.roots([1, -1.5, 0.7])))
    frequency, period = np.array([0.5, 3.0]), 0.05
    z = np.exp(-2j * np.pi * frequency * period)
    wanted = 2.5 * (0.2 * z + 0.1 * z**3) / (1 - 1.5 * z + 0.7 * z**2)
    assert about.response(frequency, period)[:, 0, 0] == pytest.approx(wanted)


def test_what_the_starts_say_depends_on_how_far_they_are_apart():
    class Fit:
        outcome = None

    def said(*scores):
        return " ".join(
            of_starts([type("Start", (), {"seed": i, "fit": Fit, "score": s}) for i, s in enumerate(scores)])
        )

    assert "end alike" in said(1.0, 1.01)
    assert "2 times as much" in said(1.0, 2.0)
    assert "1 of 3 starts diverge" in said(1.0, 1.2, np.inf)
    assert of_starts([]) == []


def test_offsets_of_single_recordings_are_found_beside_the_weights_and_taken_off(greygate, folder):
    write("low.csv", record(4, offset=-0.3))
    write("high.csv", record(5, offset=0.2))
    words = ["train", "mine.toml", "rest.csv", "low.csv", "--held", "high.csv"]
    errors = {}
    for asked in ([], ["--offset", "y"]):
        code, printed, _ = greygate(*words, "--epochs", "40", *asked, "--out", f"out{len(asked)}", "--json")
        assert code == 0
        errors[len(asked)] = json.loads(printed)
    assert errors[2]["offsets"]["low"]["y"] == pytest.approx(-0.3, abs=0.002)
    assert errors[2]["offsets"]["high"]["y"] == pytest.approx(0.2, abs=0.002)
    assert errors[2]["rmse"]["high"]["y"] < 1.5 * NOISE
    assert errors[0]["rmse"]["high"]["y"] > 0.1


def test_the_gradient_and_the_gauss_newton_matrix_are_of_errors_about_their_mean():
    model = drawn(noe("mine", {Port("u"): (1,)}, Port("y"), (1,), hidden=3), 2)
    own = replace(record(4, offset=-0.3, samples=60), own_offset=frozenset({"y"}), skip=5)
    objective = Objective(model, [own])
    theta, step = objective.theta, 1e-6
    errors = []
    for i in range(len(theta)):
        ends = [objective.errors(theta + side * step * np.eye(len(theta))[i])[0][5:, 0].copy() for side in (1, -1)]
        errors.append((ends[0] - ends[1]) / (2 * step))
    assert objective.errors(theta)[0][5:].mean() == pytest.approx(0, abs=1e-14)
    jacobian, error = np.array(errors).T, objective.errors(theta)[0][5:, 0]
    hessian, gradient = objective.normal_equations(theta)
    assert hessian == pytest.approx(jacobian.T @ jacobian, rel=1e-6, abs=1e-6)
    assert gradient == pytest.approx(jacobian.T @ error, rel=1e-6, abs=1e-6)


def test_gains_and_offsets_of_single_recordings_are_found_beside_the_weights_and_undone(greygate, folder):
    write("weak.csv", record(4, gain=0.8))
    write("strong.csv", record(5, gain=1.3, offset=0.2))
    words = ["train", "mine.toml", "rest.csv", "weak.csv", "--held", "strong.csv"]
    code, printed, _ = greygate(*words, "--epochs", "40", "--gain", "y", "--offset", "y", "--out", "out")
    assert code == 0
    assert "gain" in printed
    found = json.loads((folder / "out" / "mine.json").read_text())
    for name, gain, offset in (("weak", 0.8, 0.0), ("strong", 1.3, 0.2)):
        assert found["gains"][name]["y"] == pytest.approx(gain, abs=0.004)
        assert found["offsets"][name]["y"] == pytest.approx(offset, abs=0.004)
    assert found["rmse"]["strong"]["y"] < 1.5 * NOISE


@pytest.mark.parametrize("offset", [False, True])
def test_the_gradient_is_that_of_errors_at_the_best_gain(offset):
    """Normal equations as of Kaufman: J beside what a change of gain, or of offset, could do."""
    model = drawn(noe("mine", {Port("u"): (1,)}, Port("y", offset=0.5, scale=2.0), (1,), hidden=3), 2)
    names = frozenset({"y"})
    own = replace(record(4, gain=0.7, samples=60), own_gain=names, own_offset=names if offset else frozenset(), skip=5)
    objective = Objective(model, [own])
    theta, step = objective.theta, 1e-6
    slope = [
        (objective.squares(theta + step * row) - objective.squares(theta - step * row)) / (4 * step)
        for row in np.eye(len(theta))
    ]
    error = objective.errors(theta)[0][5:, 0]
    shown = model.run(own.inputs)["y"][5:] / 2.0  # about the zero of the sensor, normalised
    assert error @ shown == pytest.approx(0, abs=1e-10)
    assert not offset or error.mean() == pytest.approx(0, abs=1e-12)
    hessian, gradient = objective.normal_equations(theta)
    assert gradient == pytest.approx(slope, rel=1e-5, abs=1e-6)
    plain = Objective(model, [replace(own, own_gain=frozenset(), own_offset=frozenset())])
    rows = []
    for row in np.eye(len(theta)):
        ends = [plain.errors(theta + side * step * row)[0][5:, 0].copy() for side in (1, -1)]
        rows.append((ends[0] - ends[1]) / (2 * step))
    z = np.linalg.qr(np.stack([shown, np.ones(55)][: 1 + offset], axis=1))[0]
    target = own.targets["y"][5:] / 2.0
    a = np.stack([shown, np.ones(55)][: 1 + offset], axis=1)
    gain = np.linalg.lstsq(a, target, rcond=None)[0][0]
    jacobian = gain * (np.array(rows).T - z @ (z.T @ np.array(rows).T))
    assert hessian == pytest.approx(jacobian.T @ jacobian, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--gain", "u", "--held", "held.csv"], "no such output"),
        (["--gain", "y"], "give another one beside it"),
        (["--offset", "u", "--held", "held.csv"], "no such output"),
        (["--offset", "y"], "give another one beside it"),
        (["--offset", "y", "away.csv", "--shooting", "40"], "leave one out"),
        (["--held", "slow.csv"], "greygate look slow.csv --resample 0.01 --out slow_10ms.csv"),
    ],
)
def test_what_several_recordings_cannot_be_is_refused_with_what_to_do(greygate, folder, words, said):
    write("slow.csv", record(4), dt=0.02)
    code, _, told = greygate("train", "mine.toml", "rest.csv", *words, "--out", "out")
    assert (code, said in told, (folder / "out").exists()) == (2, True, False)


def test_a_record_of_which_nothing_counts_and_one_that_rests_do_not_stop_a_training():
    model = drawn(noe("mine", {Port("u"): (1,)}, Port("y"), (1,), hidden=3), 2)
    names = frozenset({"y"})
    skipped = replace(record(5, samples=50), own_gain=names, own_offset=names, skip=50)
    objective = Objective(model, [record(4), skipped])
    plain = Objective(model, [record(4)])
    assert objective.squares(objective.theta) == plain.squares(plain.theta)
    for found, alone in zip(
        objective.normal_equations(objective.theta), plain.normal_equations(plain.theta), strict=True
    ):
        np.testing.assert_array_equal(found, alone)
    resting = replace(record(6), targets={"y": np.full(400, 0.3)}, own_gain=names, own_offset=names)
    sensors = own_sensors(model, resting)
    assert sensors.gains["y"] == 1.0
    assert np.isfinite(sensors.undone(resting).targets["y"]).all()


@pytest.mark.parametrize("about_mean", [False, True])
def test_a_gain_of_what_stands_still_is_one(about_mean):
    shown = np.full(100, 0.3 if about_mean else 0.0)
    gain, along = best_gain(shown, np.random.default_rng(0).normal(size=100), about_mean)
    assert gain == 1.0
    assert not along.any()


def test_each_element_of_an_output_has_a_gain_and_an_offset_of_its_own():
    network = Network("two", [Port("u")], [Port("y", size=2)])
    network.add("sum", Layer({"u": np.array([[1.0], [-0.5]])}, [0.0, 0.2]))
    network.connect("u", "sum.u")
    network.connect("sum", "y")
    u = np.random.default_rng(1).normal(size=200)
    y = network.run({"u": u})["y"]
    names = frozenset({"y"})
    seen = Record({"u": u}, {"y": y * [2.0, 5.0] + [1.0, -1.0]}, own_gain=names, own_offset=names)
    sensors = own_sensors(network, seen)
    np.testing.assert_allclose(sensors.gains["y"], [2.0, 5.0])
    np.testing.assert_allclose(sensors.offsets["y"], [1.0, -1.0])
    np.testing.assert_allclose(sensors.undone(seen).targets["y"], y)
    assert sensors.told(network)[0] == pytest.approx({"y[0]": 2.0, "y[1]": 5.0})
