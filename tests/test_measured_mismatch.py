"""Measured rigs: their folders are as a user would write them, and untold noise is learnt with each hypothesis."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import measured_mismatch as bench
from greygate.errors import InputError
from greygate.mismatch import effects as table
from greygate.mismatch.coloured import Coloured
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.model import FILTERS, Model, begun
from greygate.mismatch.rig import load

ROOT = Path(__file__).parent.parent
QUANTIZED = {"dfki", "bam", "dfki-mjcf", "bam-mjcf"}  # rigs whose sensors' steps are known
RIGS = sorted(path.parent for path in (ROOT / "recordings" / "rigs").glob("*/rig.toml"))


@pytest.fixture(scope="module")
def tanks(tmp_path_factory):
    return load(bench.make("tanks", tmp_path_factory.mktemp("rigs") / "tanks"))


def test_every_measured_rig_has_a_maker():
    assert {path.name for path in RIGS} == set(bench.MAKERS)


@pytest.mark.parametrize("folder", RIGS, ids=lambda path: path.name)
def test_the_effects_of_a_measured_rig_join_its_plant(folder):
    rig = load(folder)
    assert rig.stated == (folder.name in QUANTIZED)
    own = table.read(folder / "effects.toml") if (folder / "effects.toml").exists() else {}
    fitting = table.fitting(rig.plant, rig.datasheet, own)
    assert list(fitting) == list(own)
    joined, _ = table.join(rig.plant, fitting.values())
    assert set(rig.plant.parameters) <= set(joined.parameters)


def test_general_effects_take_the_names_of_the_plant(tanks):
    known = table.known(tanks, tanks.recording(tanks.folder / "identify.csv"))
    assert {"upper_overflow", "input_dead_zone", "sensor_saturation"} <= set(known)
    assert known["input_delay"].filters == {"u": "delay u_delay"}
    assert "dry_friction" not in table.fitting(tanks.plant, tanks.datasheet, known)  # no state has a rate


def test_filters_of_an_input_by_hand():
    signal = np.array([0.0, 1.0, 3.0, 2.0, -1.0])
    assert FILTERS["dead_zone"](signal, 1.0, 0.1).tolist() == [0.0, 0.0, 2.0, 1.0, 0.0]
    assert FILTERS["play"](signal, 1.0, 0.1).tolist() == [0.0, 0.0, 2.0, 2.0, 0.0]
    assert FILTERS["skew"](signal, 0.5, 0.1).tolist() == [0.0, 1.5, 4.5, 3.0, -0.5]


def test_noise_is_learnt_and_forgets_within_its_share_of_the_recording(tanks):
    likelihood = Coloured(Model(tanks, tanks.recording(tanks.folder / "identify.csv"), {}))
    rng = np.random.default_rng(3)
    noise = np.zeros((1024, 1))
    for k in range(1, 1024):
        noise[k] = 0.6 * noise[k - 1] + rng.normal(0, 0.1)
    learnt = likelihood.ordered(noise)
    assert learnt.order == 1
    assert learnt.ar[0][0] == pytest.approx(0.6 * np.exp(-1 / (0.02 * 1024)), abs=0.05)
    assert learnt.scale[0] == pytest.approx(0.1, rel=0.1)
    slow = np.cumsum(noise, axis=0)
    assert np.abs(np.roots(np.r_[1.0, -likelihood.ordered(slow).ar[0]])).max() < np.exp(-1 / (0.02 * 1024)) * 1.001


@pytest.mark.nightly
def test_overflow_of_the_tanks_is_not_claimed_where_a_sensor_offset_is_the_alternative(tanks):
    known = table.known(tanks, tanks.recording(tanks.folder / "identify.csv"))
    found = diagnose(tanks, effects={key: known[key] for key in ("upper_overflow", "sensor_offset")}).as_dict()
    assert found["verdict"] == "unexplained"  # the lower tank spills as well
    assert any("upper_overflow is not claimed" in why for why in found["refused"])
    held = found["fit"]["holdout"]["y"]
    assert held["corrected"] <= held["calibrated"] < held["simulation"]


@pytest.mark.parametrize("truth", [-1.018e-3, 0.0, 1e-3])
def test_a_beginning_is_found_on_the_other_side_of_zero(truth, monkeypatch):
    monkeypatch.setattr("greygate.mismatch.model.beginnings", lambda model: ["zero"])
    ramp = np.linspace(0.0, 0.3, 100)[:, None]
    model = SimpleNamespace(values={}, target=ramp - truth, predict=lambda values: ramp - values["zero"])
    assert begun(model, {"zero": 1.4e-3}, 50)["zero"] == pytest.approx(truth, abs=1e-9)


def test_what_a_recording_has_anew_is_fitted_to_its_first_samples(tanks):
    model = Model(tanks, tanks.recording(tanks.folder / "holdout.csv"), {})
    values = begun(model, {}, tanks.settle)
    assert {s for s in values if values[s] != model.values[s]} == {"h_0", "y_0"}
    first = model.target[0, 0]
    assert abs(values["y_0"] - first) < abs(model.values["y_0"] - first)


def test_a_parameter_that_is_anew_must_be_declared(tanks, tmp_path):
    shutil.copytree(tanks.folder, tmp_path / "rig")
    path = tmp_path / "rig" / "rig.toml"
    path.write_text('anew = ["zero"]\n' + path.read_text())
    with pytest.raises(InputError, match="anew: 'zero' is no entry"):
        load(tmp_path / "rig")
