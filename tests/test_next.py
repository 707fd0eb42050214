"""The next experiment: what tells apart what a diagnosis does not, as a CSV to play; and the loop that plays it."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from test_isolability import motor, search

from benchmarks import next_experiments as bench
from greygate.errors import InputError
from greygate.mismatch import effects as table
from greygate.mismatch import rig as rigs
from greygate.mismatch.experiments.experiment import MARGIN, Bounds, experiments
from greygate.mismatch.experiments.proposal import proposal
from greygate.mismatch.experiments.rivals import restored, rivals
from greygate.mismatch.experiments.separation import NEEDED, like
from greygate.mismatch.explain import explain
from greygate.mismatch.noise import Noise
from greygate.mismatch.simulation import read

LONGEST = 18.0  # s


@pytest.fixture(scope="module")
def ambiguous(tmp_path_factory):
    """A rig that conceals a slip by direction, short strokes of one speed on it, and their diagnosis."""
    case = next(c for c in bench.CASES if c.effect == "direction_slip")
    made = bench.machine(case, tmp_path_factory.mktemp("loop") / "rig")
    made.record({"x_drum": case.motion(case.samples, made.rig.dt)}, case.seed)
    bench.said(made.folder)
    return made


@pytest.fixture
def rig(ambiguous, tmp_path) -> Path:
    """A copy of its folder, with the diagnosis."""
    return Path(shutil.copytree(ambiguous.folder, tmp_path / "rig"))


def changed(rig: Path, **entries) -> Path:
    """The diagnosis with other entries in its first effect."""
    found = json.loads((rig / "diagnosis.json").read_text())
    found["effects"][0] |= entries
    (rig / "changed.json").write_text(json.dumps(found))
    return rig / "changed.json"


# -- the command -----------------------------------------------------------------------------------------------------


def test_the_file_to_play_stays_within_what_was_recorded(rig, greygate):
    out = rig / "next.csv"
    code, printed, _ = greygate("next", rig, "--diagnosis", rig / "diagnosis.json", "--out", out, "--longest", LONGEST)
    assert code == 0
    assert re.search(r"tells +drift from direction_slip: \d+ standard deviations of the noise, here [\d.]+\n", printed)
    assert printed.endswith(f"written to {out}\n")
    assert out.read_text().startswith("t,x_drum\n")
    played, recorded = (np.genfromtxt(path, delimiter=",", names=True) for path in (out, rig / "identify.csv"))
    dt = rigs.load(rig).dt
    assert np.allclose(np.diff(played["t"]), dt)
    assert played["t"][-1] + dt <= LONGEST * (1 + 1e-9)
    assert played["x_drum"].min() >= recorded["x_drum"].min() - 1e-6
    assert played["x_drum"].max() <= recorded["x_drum"].max() + 1e-6
    assert np.abs(np.diff(played["x_drum"])).max() <= (1 + MARGIN) * np.abs(np.diff(recorded["x_drum"])).max()


def test_as_json_every_pair_of_explanations_has_its_distances(rig, greygate):
    code, printed, _ = greygate("next", rig, "--diagnosis", rig / "diagnosis.json", "--longest", LONGEST, "--json")
    found = json.loads(printed)
    assert (code, found["plant"]) == (0, "cable_drum")
    said = read(rig / "diagnosis.json")["effects"][0]
    names = [said["id"], *said["not_told_apart_from"]]
    pairs = {frozenset((pair["one"], pair["other"])) for pair in found["pairs"]}
    assert pairs == {frozenset((a, b)) for a in names for b in names if a != b}
    for pair in found["pairs"][: len(names) - 1]:
        assert pair["here"] < NEEDED + 1 < pair["then"] <= pair["both"]
        assert pair["told_apart"]
    assert found["experiment"]["inputs"]["x_drum"]["unit"] == "m"


def test_where_nothing_is_ambiguous_it_says_so_and_writes_nothing(rig, greygate):
    given = changed(rig, not_told_apart_from=[])
    code, printed, _ = greygate("next", rig, "--diagnosis", given, "--out", rig / "next.csv")
    assert code == 1
    assert "nothing to tell apart: drift stands alone" in printed
    assert not (rig / "next.csv").exists()


def test_where_no_experiment_tells_the_sensor_is_named_that_would(tmp_path, greygate):
    """A motor that loses some of its drive, and one whose magnet is weak, move alike whatever drives them."""
    folder, file = motor(tmp_path / "motor"), tmp_path / "d.json"
    content, _ = explain(folder, file)
    (entry,) = content["effects"]
    assert {entry["id"], *entry["not_told_apart_from"]} == {"drive_loss", "weak_magnet", "sensor_gain"}
    code, printed, _ = greygate("next", folder, "--diagnosis", file, "--out", tmp_path / "next.csv")
    assert code == 1
    assert "no experiment within what was recorded tells them apart" in printed
    assert re.search(r"drive_loss from weak_magnet|weak_magnet from drive_loss", printed)
    assert re.search(r"; a sensor of i does: \d+ standard deviations of the noise", printed)
    assert not (tmp_path / "next.csv").exists()


def test_a_rig_without_inputs_is_told_that_there_is_nothing_to_play(tmp_path, greygate):
    t = np.arange(600) * 0.02
    x = np.exp(-0.3 * t) + 1e-3 * np.random.default_rng(1).standard_normal(600)
    rows = np.column_stack([t, x])
    np.savetxt(tmp_path / "identify.csv", rows, delimiter=",", header="t,x", comments="")
    (tmp_path / "plant.toml").write_text(DECAY)
    (tmp_path / "rig.toml").write_text(DECAYING)
    recording = rigs.load(tmp_path).to_explain()
    known = table.known(rigs.load(tmp_path), recording)
    one, other = (next(e for e in known.values() if e.id == name) for name in ("leak", "square_leak"))
    reported = {f.reported: {"value": 0.1, "ci95": [0.0, 1.0], "unit": f.unit} for f in one.free}
    entry = {"id": one.id, "form": one.key, "parameters": reported, "not_told_apart_from": [other.id]}
    said = {"schema": "diagnosis/2", "plant": "plant", "verdict": "missing_physics", "parameters": {}}
    (tmp_path / "d.json").write_text(json.dumps(said | {"effects": [entry]}))
    code, printed, _ = greygate("next", tmp_path, "--diagnosis", tmp_path / "d.json")
    assert code == 1
    assert "plant has no input, so there is nothing to play: record it from another beginning" in printed


DECAY = """
step = 0.01
outputs = ["x"]
parameters = { x_0 = [1.0, "m^3"], k = [0.2, "1/s"] }
states = { x = { unit = "m^3", initial = "x_0" } }
equations.content = { x = { out = "-k * x" } }
"""
DECAYING = """
plant = "plant.toml"
sample_time_s = 0.02
predict = ["x"]
parameters = { x_0 = 1.0, k = 0.2 }
tolerance = { x_0 = 0.05 }
channels.x = { unit = "m^3", role = "output", noise_rms = 1e-3 }
"""


@pytest.mark.parametrize(
    ("entries", "problem"),
    [
        ({"id": "nobody", "form": "nobody"}, "effect 'nobody' is unknown here; give --effects"),
        ({"not_told_apart_from": ["nobody"]}, "not_told_apart_from: 'nobody' is unknown here; give --effects"),
        ({"not_told_apart_from": None}, "give a file that diagnose wrote"),
        ({"parameters": {}}, "give one that diagnose wrote"),
    ],
)
def test_a_diagnosis_that_is_not_of_this_rig_is_refused(entries, problem, rig, greygate):
    code, printed, err = greygate("next", rig, "--diagnosis", changed(rig, **entries), "--out", rig / "next.csv")
    assert (code, printed) == (2, "")
    assert problem in err
    assert not (rig / "next.csv").exists()


def test_an_experiment_too_short_to_be_explained_is_refused(rig, greygate):
    code, _, err = greygate("next", rig, "--diagnosis", rig / "diagnosis.json", "--longest", "0.1")
    assert code == 2
    assert "--longest 0.1: below 40 samples; give at least 0.16 s" in err


# -- its parts -------------------------------------------------------------------------------------------------------


def test_a_diagnosis_read_again_has_the_fits_that_it_had(rig):
    loaded = rigs.load(rig)
    recording, found = loaded.to_explain(), read(rig / "diagnosis.json")
    again = restored(loaded, recording, table.known(loaded, recording), found)
    (entry,) = found["effects"]
    for name, p in entry["parameters"].items():
        low, high = p["ci95"]
        assert low <= again.corrected.values[name] <= high
        assert again.corrected.values[name] == pytest.approx(p["value"], abs=0.1 * (high - low))
    left = list(rivals(again, found["effects"]))
    assert [rival.name for rival in left] == entry["not_told_apart_from"]
    assert all(rival.here < NEEDED + 1 for rival in left)


def test_experiments_last_no_longer_than_they_may(rig):
    loaded = rigs.load(rig)
    recording = loaded.to_explain()
    bounds = Bounds.of(loaded, recording)
    for longest in (3.0, 7.0, 20.0):
        made = [e for kind in experiments(bounds, 6.0, recording.dt, longest) for e in kind]
        assert len(made) >= 3
        assert max(e.seconds for e in made) <= longest * (1 + 1e-9)
    assert max(e.seconds for kind in experiments(bounds, 6.0, recording.dt) for e in kind) > 100


def test_a_recording_to_come_has_the_noise_that_was_found(tmp_path):
    """Five times the told noise makes every distance a fifth."""
    looked = search(motor(tmp_path / "motor"))
    looked.under(Noise(np.array([5.0]), (np.array([0.5]),)))
    made = like(looked.screen, looked.screen.model)
    assert made.noise.scale.tolist() == [5.0]
    values = {"viscous": 310.0}
    shifts = made.nothing()
    assert np.array_equal(made.errors(values, shifts), looked.screen.errors(values, shifts))


def test_a_single_explanation_leaves_nothing_to_propose(rig):
    loaded = rigs.load(rig)
    recording, found = loaded.to_explain(), read(changed(rig, not_told_apart_from=[]))
    made = proposal(restored(loaded, recording, table.known(loaded, recording), found), found["effects"])
    assert made.experiment is None
    assert made.pairs == ()


# -- the loop --------------------------------------------------------------------------------------------------------


def test_the_experiment_played_on_the_true_rig_leaves_the_right_name_alone(ambiguous, tmp_path, greygate):
    folder = Path(shutil.copytree(ambiguous.folder, tmp_path / "rig"))
    there = bench.Machine(folder, ambiguous.rig, ambiguous.run, ambiguous.noise)

    def choose(round_, found):
        files = ("--diagnosis", folder / "diagnosis.json", "--out", folder / "next.csv")
        assert greygate("next", folder, *files, "--longest", LONGEST)[0] == 0
        return {"x_drum": np.genfromtxt(folder / "next.csv", delimiter=",", names=True)["x_drum"]}

    first = read(folder / "diagnosis.json")
    assert not bench.alone(first)
    ended = bench.loop(there, "direction_slip", first, choose)
    assert (ended["resolved"], ended["experiments"]) == (True, 1)


def test_every_way_keeps_the_limits_of_the_recording(ambiguous):
    recording = ambiguous.rig.recording(ambiguous.folder / "identify.csv")
    bounds = Bounds.of(ambiguous.rig, recording)
    travel = bounds.high["x_drum"] - bounds.low["x_drum"]
    for way in (bench.random, bench.sines):
        for seed in range(5):
            path = way(bounds, 3000, recording.dt, np.random.default_rng(seed))(1.0)["x_drum"]
            assert len(path) == 3000
            assert bounds.low["x_drum"] - 1e-12 <= path.min() <= path.max() <= bounds.high["x_drum"] + 1e-12
            assert np.abs(np.diff(path)).max() / recording.dt <= 1.1 * bounds.speed * travel


def test_random_levels_are_held(tmp_path):
    folder = motor(tmp_path / "motor")
    loaded = rigs.load(folder)
    bounds = Bounds.of(loaded, loaded.to_explain())
    made = bench.random(bounds, 1000, 5e-3, np.random.default_rng(1))
    assert np.ptp(made(0.1)["u"]) < 0.11 * np.ptp(made(1.0)["u"])
    assert np.mean(np.diff(made(1.0)["u"]) == 0) > 0.8


def test_a_table_that_the_diagnosis_had_must_be_given(rig):
    loaded = rigs.load(rig)
    recording, found = loaded.to_explain(), read(rig / "diagnosis.json")
    with pytest.raises(InputError, match="give --effects"):
        restored(loaded, recording, {}, found)
