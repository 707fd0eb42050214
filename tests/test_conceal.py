"""Concealed rigs: what is written, that it is what it says, and that a diagnosis is scored for what it claims."""

import ast
import importlib
import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

from greygate.errors import InputError
from greygate.mismatch import concealed
from greygate.mismatch.concealed.conceal import KINDS, RIGS, conceal, reveal
from greygate.mismatch.concealed.domains.integrate import lagging
from greygate.mismatch.concealed.rig import rms

FILES = {"rig.toml", "identify.csv", "holdout.csv", "third.csv", "sealed.json", "sealed.json.sha256"}


@pytest.fixture(scope="module")
def belt(tmp_path_factory):
    """A belt drive with a large tooth ripple."""
    return conceal("belt_drive", 3, tmp_path_factory.mktemp("belt") / "case", effect="tooth_ripple")


def answer(folder):
    return json.loads((folder / "sealed.json").read_text())


def diagnosis(folder, **changes):
    """The diagnosis that says what is concealed in `folder`, with `changes`."""
    true = answer(folder)
    interval = {k: {"value": v, "ci95": [v - abs(v) / 9, v + abs(v) / 9]} for k, v in true["effects_true"].items()}
    claim = {
        "verdict": true["verdict"],
        "where": [{"equation": name, "depends_on": true["depends_on"]} for name in true["equation"]],
        "effects": [{"id": name, "parameters": interval, "not_told_apart_from": []} for name in true["effects"]],
        "parameters": {k: {"value": v, "ci95": [v * 0.9, v * 1.1]} for k, v in true["parameters_true"].items()},
    }
    path = folder / "diagnosis.json"
    path.write_text(json.dumps(claim | changes))
    return path


def recorded(path):
    with path.open() as file:
        return file.readline().strip().split(","), np.loadtxt(file, delimiter=",")


def test_a_case_is_a_campaign_as_the_shared_rigs_are(belt):
    assert {path.name for path in belt.iterdir()} >= FILES
    rig = tomllib.loads((belt / "rig.toml").read_text())
    assert set(rig) == {"plant", "sample_time_s", "predict", "parameters", "tolerance", "channels"}
    for name, samples in (("identify", 20001), ("holdout", 8001), ("third", 8001)):
        names, table = recorded(belt / f"{name}.csv")
        assert names == ["t", *rig["channels"]]
        assert table.shape == (samples, len(names))
        np.testing.assert_array_equal(np.round(table[:, 0] * 1000), np.arange(samples))


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(belt, tmp_path):
    again = conceal("belt_drive", 3, tmp_path / "again", effect="tooth_ripple")
    other = conceal("belt_drive", 4, tmp_path / "other", effect="tooth_ripple")
    for name in FILES:
        assert (again / name).read_bytes() == (belt / name).read_bytes()
    assert (other / "identify.csv").read_bytes() != (belt / "identify.csv").read_bytes()


@pytest.mark.parametrize("plant", ["pump_hydraulic", "belt_drive", "cable_drum"])
def test_the_true_simulation_leaves_the_sensors_and_the_datasheet_does_not(plant, tmp_path):
    true = answer(conceal(plant, 1, tmp_path / "case", kind="parameter"))
    for fit in true["third"].values():
        assert fit["true"] <= fit["calibrated"] <= fit["simulation"]
    assert true["verdict"] == "parameter_error"
    name = true["parameter"]
    rig = RIGS[plant]
    off = abs(true["parameters_true"][name] / rig.parameters[name] - 1) / rig.tolerance[name]
    assert 3 <= off <= 6


@pytest.mark.parametrize("kind", KINDS)
def test_the_kind_is_what_is_concealed(kind, tmp_path):
    true = answer(conceal("cable_drum", 0, tmp_path / "case", kind=kind))
    counts = {"clean": 0, "parameter": 0, "one": 1, "two": 2, "foreign": 0}
    assert len(true["effects"]) == counts[kind]
    assert len(set(true["concealed"])) == max(counts[kind], kind == "foreign")
    assert set(true["concealed"]) <= set(
        RIGS["cable_drum"].foreign if kind == "foreign" else RIGS["cable_drum"].effects
    )


@pytest.mark.parametrize("plant", RIGS)
def test_every_effect_changes_what_its_plant_records(plant):
    rig = RIGS[plant]

    seconds = 1.0 if rig.window else 10.0

    def recorded(form, effects):
        return rig.record(rig.parameters, effects, form, seconds, np.random.default_rng(1))

    nothing = recorded(0.0, {})
    for name, effect in (rig.effects | rig.foreign).items():
        for form in (0.0, 1.0):
            true = recorded(form, effect.draw(np.random.default_rng(1), least=0.9))
            change = max(rms(true[c.name] - nothing[c.name]) / c.error for c in rig.channels)
            assert np.isfinite(change), name
            assert change > 1, (name, form)


@pytest.mark.parametrize("plant", ["belt_drive", "cable_drum"])
def test_what_drifts_begins_with_nothing_in_either_form(plant):
    rig = RIGS[plant]
    (name,) = [name for name, effect in rig.effects.items() if "drift" in effect.sizes]
    effects = rig.effects[name].draw(np.random.default_rng(1), least=0.9)

    def recorded(form, effects):
        return rig.record(rig.parameters, effects, form, 10.0, np.random.default_rng(1))

    nothing = recorded(0.0, {})
    for form in (0.0, 1.0):
        true = recorded(form, effects)
        off = np.max([np.abs(true[c.name] - nothing[c.name]) / c.error for c in rig.channels], axis=0)
        assert off[:10].max() <= 1, form
        assert off[-1] > 10, form


def test_phases_are_drawn_from_one_whole_turn():
    effects = [effect for rig in RIGS.values() for effect in (rig.effects | rig.foreign).values()]
    phases = [bounds for effect in effects for name, bounds in effect.others.items() if name.endswith("phase")]
    assert phases
    assert set(phases) == {(0.0, 2 * np.pi)}


@pytest.mark.parametrize("plant", ["valve_hydraulic", "pump_hydraulic"])
def test_a_simulation_restarts_from_the_record_and_leaves_out_windows(plant):
    rig = RIGS[plant]
    true = rig.record(rig.parameters, {}, 0.0, 2.0, np.random.default_rng(5))
    every, fourth = (rig.predict(true, rig.parameters, {}, 0.0, n) for n in (1, 4))
    for name in ("x", "p_a", "p_b"):
        np.testing.assert_array_equal(every[name][::250], true[name][::250])
        np.testing.assert_array_equal(fourth[name][:250], every[name][:250])
        assert np.isnan(fourth[name][250:1000]).all()


@pytest.mark.parametrize("plant", ["valve_hydraulic", "pump_hydraulic"])
def test_the_steps_are_fine_enough_for_the_sensors(plant, monkeypatch):
    rig = RIGS[plant]
    equations = importlib.import_module(rig.predict.__module__)
    true = rig.record(rig.parameters, {}, 0.0, 1.0, np.random.default_rng(5))
    coarse = rig.predict(true, rig.parameters, {}, 0.0)
    monkeypatch.setattr(equations, "COARSE", 4 * equations.COARSE)
    fine = rig.predict(true, rig.parameters, {}, 0.0)
    for channel in rig.predicted:
        assert rms(coarse[channel.name] - fine[channel.name]) < 0.01 * channel.error


def test_the_generator_shares_nothing_with_the_diagnoser_or_the_plants():
    folder = Path(concealed.__file__).parent
    imported = set()
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module == "greygate":
                imported |= {f"greygate.{alias.name}" for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                imported.add(node.module)
            elif isinstance(node, ast.ImportFrom):
                assert node.level <= len(path.relative_to(folder).parts), path
    house = {name for name in imported if name.startswith("greygate")}
    ground = ("contents", "errors", "files", "plain", "plants.table", "reading")  # of plants the reader of CSV alone
    assert house == {f"greygate.{name}" for name in ground}


def test_play_that_is_concealed_is_not_in_the_datasheet(tmp_path):
    folder = conceal("belt_drive", 0, tmp_path / "case", effect="reversal_play")
    rig = tomllib.loads((folder / "rig.toml").read_text())
    assert "play" not in rig["parameters"]
    assert "play" not in rig["tolerance"]
    assert answer(folder)["effects_true"]["play"] > 0


def test_the_right_diagnosis_has_full_marks(belt):
    score = reveal(belt, diagnosis(belt))
    for name in ("right_verdict", "right_first", "all_named", "in_set", "right_equation", "right_place"):
        assert score[name] is True
    assert score["false_effects"] == []
    assert score["depends_on"] == 1.0
    assert all(score["inside"].values())
    assert set(score["inside"]) == {"band", "closing", "play", *answer(belt)["effects_true"]}
    assert score["removed"] is None


def test_a_wrong_name_costs_marks_and_a_set_that_holds_the_right_one_is_seen(belt):
    wrong = [{"id": "drift", "parameters": {}, "not_told_apart_from": ["tooth_ripple"]}]
    score = reveal(belt, diagnosis(belt, effects=wrong, where=[{"equation": "motion", "depends_on": ["t"]}]))
    assert score["right_verdict"]
    assert not score["right_first"]
    assert not score["all_named"]
    assert score["in_set"]
    assert score["false_effects"] == ["drift"]
    assert not score["right_place"]
    assert score["depends_on"] == 0


def test_a_phase_whole_turns_away_is_inside_and_half_a_turn_is_not(belt):
    phase = answer(belt)["effects_true"]["ripple_phase"]
    for turns, inside in ((-2, True), (0.5, False)):
        middle = phase + turns * 2 * np.pi
        claim = {"ripple_phase": {"value": middle, "ci95": [middle - 0.1, middle + 0.1]}}
        effects = [{"id": "tooth_ripple", "parameters": claim, "not_told_apart_from": []}]
        assert reveal(belt, diagnosis(belt, effects=effects))["inside"]["ripple_phase"] is inside


def test_the_share_removed_is_one_for_the_truth_and_nothing_for_the_calibrated(belt, tmp_path):
    _, table = recorded(belt / "third.csv")
    fit = answer(belt)["third"]["x_load"]
    noise = np.random.default_rng(0).standard_normal(len(table))
    for error, share in (("true", 1.0), ("calibrated", 0.0)):
        wave = noise / np.sqrt(np.mean(noise**2)) * fit[error]
        path = tmp_path / f"{error}.csv"
        np.savetxt(path, np.c_[table[:, 0], table[:, 2] + wave], delimiter=",", header="t,x_load", comments="")
        assert reveal(belt, diagnosis(belt), {"corrected": path})["removed"] == pytest.approx(share, abs=1e-9)


def test_the_sealed_truth_run_on_the_recording_kept_back_removes_all(tmp_path):
    folder = conceal("valve_hydraulic", 3, tmp_path / "case", effect="external_leakage")
    true, rig = answer(folder), RIGS["valve_hydraulic"]
    names, table = recorded(folder / "third.csv")
    parameters = tomllib.loads((folder / "rig.toml").read_text())["parameters"] | true["parameters_true"]
    columns = dict(zip(names, table.T, strict=True))
    simulated = rig.predict(columns, parameters, true["effects_true"], float(true["form"] == "variant"))
    path = tmp_path / "predicted.csv"
    np.savetxt(path, np.c_[columns["t"], *simulated.values()], delimiter=",", header="t,x,p_a,p_b", comments="")
    assert true["removable"] > 0.1
    assert reveal(folder, diagnosis(folder), {"corrected": path})["removed"] == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("boat", 0, {}), "no plant 'boat'; there are"),
        (("belt_drive", 0, {"effect": "rust"}), "belt_drive has no effect 'rust'"),
        (("belt_drive", 0, {"kind": "three"}), "no kind 'three'; there are"),
        (("belt_drive", 0, {"kind": "clean", "effect": "drift"}), "no case of kind 'clean'; use one or two"),
        (("belt_drive", -1, {}), "seed -1"),
    ],
)
def test_what_cannot_be_concealed_is_named_before_anything_is_written(arguments, message, tmp_path):
    plant, seed, options = arguments
    with pytest.raises(InputError, match=message):
        conceal(plant, seed, tmp_path / "case", **options)
    assert not any(tmp_path.iterdir())


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="holds other files"):
        conceal("belt_drive", 0, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_a_broken_seal_and_a_missing_diagnosis_are_refused(belt, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(belt, broken)
    claim = diagnosis(broken)
    (broken / "sealed.json").write_text((broken / "sealed.json").read_text().replace("tooth_ripple", "drift"))
    with pytest.raises(InputError, match="SHA-256 differs"):
        reveal(broken, claim)
    with pytest.raises(InputError, match="holds no sealed answer"):
        reveal(tmp_path, claim)
    with pytest.raises(InputError, match="cannot be read"):
        reveal(belt, tmp_path / "none.json")
    with pytest.raises(InputError, match="effects None is not a list"):
        reveal(belt, diagnosis(belt, effects=None))


@pytest.mark.parametrize("lag", [0.1, 1.0, 30.0])
def test_a_lag_of_an_input_that_is_held_has_its_exact_means(lag):
    signal = np.array([0.0, 1.0, 1.0, -0.5, -0.5, 2.0, 0.0])
    found = lagging(np.concatenate([[0.0], signal]), 1.0, lag)[1:]
    fine = np.repeat(signal, 20000)
    at, slow = np.empty(len(fine)), 0.0
    for k, x in enumerate(fine):
        at[k] = slow + (x - slow) * (1 - lag * 20000 * (1 - np.exp(-1 / (lag * 20000))))
        slow += (x - slow) * (1 - np.exp(-1 / (lag * 20000)))
    assert found == pytest.approx(at.reshape(-1, 20000).mean(axis=1), abs=1e-9)


def test_so_has_a_lag_of_what_is_straight_between_its_readings():
    ramp = np.arange(400.0)
    assert lagging(ramp, 1.0, 7.0)[-1] == pytest.approx(ramp[-1] - 7.0)
