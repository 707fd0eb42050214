"""Whole diagnoses, most of the two rigs that take seconds; recordings only, answers looked at afterwards."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from greygate.errors import InputError
from greygate.mismatch import effects, simulation
from greygate.mismatch.concealed.conceal import conceal, reveal
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.diagnosis import SCHEMA, Diagnosis
from greygate.mismatch.excitation import check, unseen
from greygate.mismatch.rig import load
from greygate.mismatch.search import Hypothesis, Search
from greygate.mismatch.selection import Selection
from greygate.plants.recording import Recording

SHARED = Path(__file__).parents[2] / "shared" / "rigs"


def turned(true: float, low: float, high: float) -> float:
    """A phase, so many whole turns on that it is nearest to the interval."""
    return true + 2 * np.pi * round(((low + high) / 2 - true) / (2 * np.pi))


@pytest.mark.parametrize("name", ["labelled-3", "labelled-4"])
def test_a_labelled_rig_gets_its_verdict_and_its_true_parameters_lie_within_three_standard_deviations(name, tmp_path):
    if not (SHARED / name).is_dir():
        pytest.skip("the labelled rigs are not here")
    for file in ("rig.toml", "identify.csv", "holdout.csv"):  # not the answer
        shutil.copy(SHARED / name / file, tmp_path)
    found = diagnose(load(tmp_path)).as_dict()
    answer = json.loads((SHARED / name / "answer.json").read_text())
    assert found["verdict"] == answer["verdict"]
    assert [e["id"] for e in found["effects"]] == answer["effects"]
    assert {place["equation"] for place in found["where"]} == set(answer["equation"])
    assert {v for place in found["where"] for v in place["depends_on"]} == set(answer["depends_on"])
    claimed = dict(found["parameters"])
    for entry in found["effects"]:
        claimed |= entry["parameters"]
    for symbol, true in {**answer["parameters_true"], **answer["effects_true"]}.items():
        low, high = claimed[symbol]["ci95"]
        off = (turned(true, low, high) if symbol.endswith("_phase") else true) - claimed[symbol]["value"]
        assert abs(off) < 3 * (high - low) / 3.92, symbol


CASES = {
    "clean": ("cable_drum", 11, {"kind": "clean"}),
    "parameter": ("cable_drum", 12, {"kind": "parameter"}),
    "eccentricity": ("cable_drum", 13, {"kind": "one", "effect": "drum_eccentricity"}),
    "slip": ("cable_drum", 14, {"kind": "one", "effect": "direction_slip"}),
    "far parameter": ("cable_drum", 1001, {"kind": "parameter"}),
    "clean belt": ("belt_drive", 15, {"kind": "clean"}),
    "scale": ("belt_drive", 16, {"kind": "one", "effect": "scale_error"}),
    "play": ("belt_drive", 17, {"kind": "one", "effect": "reversal_play"}),
    "another form": ("cable_drum", 1013, {"kind": "one"}),
    "jumping acceleration": ("cable_drum", 1002, {"kind": "one"}),
    "two": ("cable_drum", 1004, {"kind": "two"}),
    "two in another form": ("belt_drive", 1000, {"kind": "two"}),
    "two, each alone a bad fit": ("belt_drive", 8000, {"kind": "two"}),
    "wave with an overtone": ("belt_drive", 7305, {"kind": "one"}),
    "creep of two times": ("cable_drum", 8007, {"kind": "one"}),
    "acceleration, slipping": ("cable_drum", 8018, {"kind": "one"}),
    "lag, not delay": ("pump_hydraulic", 7304, {"kind": "one"}),  # which long windows alone tell apart
    "valve, not its supply": ("valve_hydraulic", 7305, {"kind": "one"}),  # likewise
    "loss beside a leakage": ("pump_hydraulic", 8005, {"kind": "two"}),  # which long windows alone show
}


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Name -> (folder, diagnosis), made once."""
    made: dict[str, tuple[Path, Diagnosis]] = {}

    def give(name: str) -> tuple[Path, Diagnosis]:
        if name not in made:
            plant, seed, options = CASES[name]
            folder = conceal(plant, seed, tmp_path_factory.mktemp("case") / "rig", **options)
            made[name] = folder, diagnose(load(folder))
        return made[name]

    return give


@pytest.mark.nightly
@pytest.mark.parametrize("name", CASES)
def test_what_was_concealed_is_what_is_said(name, case):
    folder, result = case(name)
    result.write(folder / "diagnosis.json")
    score = reveal(folder, folder / "diagnosis.json")
    assert score["right_verdict"]
    assert not score["false_effects"]
    assert score["all_named"] is not False
    assert score["right_parameter"] is not False


def test_an_effect_is_named_by_its_own_name_in_the_form_that_fits(case):
    _, result = case("another form")
    (entry,) = result.as_dict()["effects"]
    assert (entry["id"], entry["form"]) == ("drift", "drift_settling")
    low, high = entry["parameters"]["settle_time"]["ci95"]
    assert low < 40.0 < high


def test_an_effect_in_the_wrong_form_is_put_in_the_right_one(case):
    folder, _ = case("another form")
    rig = load(folder)
    recording = rig.recording(folder / "identify.csv")
    search = Search(rig, recording, effects.known(rig, recording))
    plain = Hypothesis(("drift",))
    fit = search.fit(search.screen, plain, {})
    best, better = Selection(search, search.screen, fit, lambda text: None).reshape(plain, fit)
    assert best.effects == ("drift_settling",)
    assert better.cost < fit.cost


def test_the_file_gives_the_simulation_that_the_diagnosis_reports(case):
    folder, result = case("eccentricity")
    found = json.loads(json.dumps(result.as_dict()))
    rig = load(folder)
    for name in ("identify", "holdout"):
        recording = rig.recording(folder / f"{name}.csv")
        for kind, given in (("simulation", None), ("corrected", found)):
            error = simulation.simulate(rig, recording, given)["x_load"] - recording["x_load"]
            assert np.sqrt(np.mean(error**2)) == pytest.approx(found["fit"][name]["x_load"][kind], rel=1e-6)
    assert found["fit"]["holdout"]["x_load"]["corrected"] < 0.5 * found["fit"]["holdout"]["x_load"]["calibrated"]


def test_the_holdout_is_never_fitted(case, tmp_path):
    """Without it the same values are found."""
    folder, result = case("clean")
    for file in ("rig.toml", "identify.csv"):
        shutil.copy(folder / file, tmp_path)
    alone = diagnose(load(tmp_path)).as_dict()
    assert alone["parameters"] == result.as_dict()["parameters"]
    assert set(alone["fit"]) == {"identify"}


def test_a_diagnosis_says_what_it_is_doing_in_single_lines(case):
    folder, _ = case("slip")
    lines: list[str] = []
    diagnose(load(folder), progress=lines.append)
    assert lines[0] == "compiling the plant"
    assert "fitting direction_slip" in lines
    assert lines[-1] == "predicting the recordings"
    assert all(line and "\n" not in line for line in lines)


def test_a_diagnosis_is_written_whole_or_not_at_all(case, tmp_path):
    _, result = case("clean")
    with pytest.raises(InputError, match="cannot write here"):
        result.write(tmp_path / "nowhere" / "diagnosis.json")
    result.write(tmp_path / "diagnosis.json")
    found = json.loads((tmp_path / "diagnosis.json").read_text())
    assert found["schema"] == SCHEMA
    assert set(found) >= {"plant", "verdict", "where", "effects", "parameters", "fit", "remaining"}


def test_a_recording_without_a_return_cannot_show_what_hangs_on_direction(case):
    """The effect is in the table, but of its usual size no sensor would tell it."""
    folder, _ = case("clean")
    rig = load(folder)
    whole = rig.recording(folder / "identify.csv")
    assert "direction_slip" not in unseen(case("clean")[1].calibrated)
    forward = {n: np.linspace(0, 0.1, 3000) + 1e-6 * np.random.default_rng(0).standard_normal(3000) * (n == "x_load")
               for n in rig.channels}  # fmt: skip
    one_way = Recording(rig.dt, forward, whole.units)
    check(rig, one_way, effects.read())
    search = Search(rig, one_way, effects.read())
    assert "direction_slip" in unseen(search.fit(search.final, Hypothesis(), {}))
