"""From the folder of a rig to a diagnosis, by commands; what is wrong with a folder is one line and exit code 2."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest

from greygate.mismatch import words
from greygate.mismatch.concealed import conceal
from greygate.mismatch.concealed.valve import VALVE
from greygate.mismatch.verdict import Verdict

DRUM = 3  # seed


@pytest.mark.parametrize(("confidence", "said"), [(0.498, "may be a fault of the recording"), (0.6, "is at fault")])
def test_a_fault_of_the_recording_is_said_to_be_one_where_it_is_likelier_than_not(confidence, said):
    effects = [{"id": "sensor_offset", "confidence": confidence}]
    assert said in words.sentence({"verdict": "recording_fault", "effects": effects})


@pytest.mark.parametrize("verdict", Verdict)
def test_a_verdict_is_the_string_of_the_file_and_its_words_begin_with_its_name(verdict):
    assert json.loads(json.dumps({"verdict": verdict})) == {"verdict": verdict.value}
    assert Verdict(verdict.value) is verdict
    assert verdict.words.startswith(verdict.value.replace("_", " ") + ": ")


@pytest.fixture(scope="module")
def drum(tmp_path_factory) -> Path:
    """A cable drum that conceals a slip that grows with speed."""
    return conceal.conceal(
        "cable_drum", DRUM, tmp_path_factory.mktemp("drum") / "case", effect="speed_slip", kind="one"
    )


@pytest.fixture(scope="module")
def clean(tmp_path_factory) -> Path:
    return conceal.conceal("cable_drum", DRUM, tmp_path_factory.mktemp("clean") / "case", kind="clean")


def copied(folder: Path, to: Path, toml=lambda text: text, rows=lambda rows: rows) -> Path:
    """The rig of `folder`, its rig.toml and the rows of its identify.csv changed."""
    to.mkdir()
    (to / "rig.toml").write_text(toml((folder / "rig.toml").read_text()))
    with (folder / "identify.csv").open(newline="") as file:
        changed = rows(list(csv.reader(file)))
    (to / "identify.csv").write_text("\n".join(map(",".join, changed)) + "\n")
    return to


# -- what the commands do --------------------------------------------------------------------------------------------


def test_what_is_concealed_is_diagnosed_written_and_revealed(drum, tmp_path, greygate):
    out = tmp_path / "diagnosis.json"
    code, printed, _ = greygate("diagnose", drum, "--out", out)
    assert code == 0
    found = json.loads(out.read_text())
    assert found["verdict"] == "missing_physics"
    assert [e["id"] for e in found["effects"]] == ["speed_slip"]
    assert "slip per travel that grows with speed" in printed
    assert "transmission, depends on v" in printed
    code, printed, _ = greygate("dev", "reveal", drum, "--diagnosis", out, "--json")
    scored = json.loads(printed)
    assert code == 0
    assert scored["right"]
    assert scored["removed"] == pytest.approx(1.0, abs=0.01)


def test_a_wrong_diagnosis_is_revealed_with_exit_code_one(drum, tmp_path, greygate):
    out = tmp_path / "diagnosis.json"
    wrong = {"schema": "diagnosis/1", "plant": "cable_drum", "verdict": "consistent", "where": [], "effects": [],
             "parameters": {}}  # fmt: skip
    out.write_text(json.dumps(wrong))
    code, printed, _ = greygate("dev", "reveal", drum, "--diagnosis", out)
    assert code == 1
    assert "speed_slip" in printed
    assert "wrong" in printed


def test_without_out_a_diagnosis_is_only_printed(clean, greygate):
    before = sorted(clean.iterdir())
    code, printed, _ = greygate("diagnose", clean)
    assert code == 0
    assert "consistent" in printed
    assert sorted(clean.iterdir()) == before
    assert len(printed.splitlines()) < 25


def test_several_rigs_are_diagnosed_by_one_command(drum, clean, tmp_path, greygate):
    rigs = [copied(drum, tmp_path / "one"), copied(clean, tmp_path / "two")]
    (tmp_path / "out").mkdir()
    code, _, _ = greygate("diagnose", *rigs, "--out", tmp_path / "out", "--jobs", 2)
    assert code == 0
    verdicts = {p.stem: json.loads(p.read_text())["verdict"] for p in (tmp_path / "out").iterdir()}
    assert verdicts == {"one": "missing_physics", "two": "consistent"}


def test_a_simulation_is_written_at_the_times_of_the_recording(drum, tmp_path, greygate):
    out = tmp_path / "predicted.csv"
    code, printed, _ = greygate("simulate", drum, drum / "holdout.csv", "--out", out, "--json")
    assert code == 0
    given, made = ([line.split(",") for line in p.read_text().split()] for p in (drum / "holdout.csv", out))
    assert made[0] == ["t", "x_load"]
    assert [row[0] for row in made] == [row[0] for row in given]
    error = np.array([float(a[1]) - float(b[2]) for a, b in zip(made[1:], given[1:], strict=True)])
    assert json.loads(printed)["rms"]["x_load"]["rms"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)


def test_a_log_is_simulated_as_init_rig_takes_it(drum, tmp_path, greygate):
    """Units beside the names are converted, columns of others are left out, and the rig's own form is what it was."""
    rows = [line.split(",") for line in (drum / "holdout.csv").read_text().split()]
    header = ["time [ms]", "x_drum", "x_load [mm]", "oil [degC]"]
    log = [[str(1e3 * float(t)), a, str(1e3 * float(b)), "20"] for t, a, b in rows[1:]]
    (tmp_path / "log.csv").write_text("\n".join(map(",".join, [header, *log])) + "\n")
    outs = []
    for name, path in (("own", drum / "holdout.csv"), ("log", tmp_path / "log.csv")):
        assert greygate("simulate", drum, path, "--out", tmp_path / f"{name}_out.csv")[0] == 0
        outs.append(np.genfromtxt(tmp_path / f"{name}_out.csv", delimiter=",", names=True)["x_load"])
    assert outs[0] == pytest.approx(outs[1], rel=1e-9)
    header[2] = "x_load [V]"
    (tmp_path / "log.csv").write_text("\n".join(map(",".join, [header, *log])) + "\n")
    code, _, err = greygate("simulate", drum, tmp_path / "log.csv", "--out", tmp_path / "no.csv")
    assert code == 2
    assert "x_load is in V, rig.toml has it in m" in err


@pytest.mark.parametrize(
    ("value", "ci95", "unit", "text"),
    [
        (1.344e9, [1.3e9, 1.388e9], "Pa", "13440 [13000, 13880] bar"),
        (1.501e-5, [1.499e-5, 1.503e-5], "m", "15.010 [14.990, 15.030] µm"),
        (0.02, [0.015, 0.025], "m", "20.0 [15.0, 25.0] mm"),
        (0.0012, [0.0011, 0.0013], "s", "1.20 [1.10, 1.30] ms"),
        (2.2e-12, [2.0e-12, 2.4e-12], "m^3/(Pa s)", "2.20e-12 [2.00e-12, 2.40e-12] m^3/(Pa s)"),
        (9.0, [9.0, 9.0], "1/rev", "9 1/rev"),
        (0.0, [-0.1, 0.1], "1", "0.00 [-0.10, 0.10]"),
    ],
)
def test_figures_are_written_to_two_digits_of_their_uncertainty(value, ci95, unit, text):
    assert str(words.amount(value, ci95, unit)) == text


# -- what is wrong with a rig ----------------------------------------------------------------------------------------


def put(a: str, b: str):
    """`a` replaced by `b` where it stands first; it must be there."""

    def change(text: str) -> str:
        assert a in text, a
        return text.replace(a, b, 1)

    return change


RIGS = {
    "a unit that is another": (put('unit = "m"', 'unit = "mm"'), "channels.x_drum: unit 'mm', cable_drum has it in m"),
    "no unit": (put('unit = "m"\n', ""), "channels.x_drum.unit is missing"),
    "a role that is none": (put('role = "input"', 'role = "inputs"'), "'inputs' does not exist; choose input, output"),
    "a channel that is unknown": (put("[channels.x_load]", "[channels.y]"), "has no output of that name; it has"),
    "no channel of an input": (lambda t: t[: t.index("[channels.x_drum]")] + t[t.index("[channels.x_load]") :],
                               "channels.x_drum: is missing"),
    "no channels": (lambda t: t[: t.index("[channels")], "channels is missing"),
    "a parameter that is unknown": (put("creep =", "crep ="), "parameters.crep: cable_drum has radius, creep"),
    "no parameter": (put("radius =", "creep2 = 1.0 #"), "parameters.creep2"),
    "a parameter too few": (lambda t: re.sub(r"radius = .*\n", "", t, count=1), "radius missing; cable_drum needs it"),
    "a parameter in words": (put("radius = ", "radius = true # "), "parameters.radius True is not a finite number"),
    "a tolerance of nothing": (put("[tolerance]", "[tolerance]\nmass = 0.1"), "tolerance.mass: is no entry"),
    "a tolerance of 200 %": (put("[tolerance]\ncreep = ", "[tolerance]\ncreep = 2 # "), "give a relative uncertainty"),
    "a negative resolution": (put("resolution = ", "resolution = -"), "resolution -"),
    "a misspelt entry": (put("resolution", "resolutoin"), "'resolutoin': there is no such entry; write resolution"),
    "a window of one sample": (put("predict", "window_s = 0.001\npredict"), "window_s: 0.001; give at least 10"),
    "a window beyond the recording": (put("predict", "window_s = 100\npredict"), "record at least 100000 samples"),
    "nothing to predict": (put('["x_load"]', "[]"), "predict: []"),
    "an input to predict": (put('["x_load"]', '["x_drum"]'), "predict: 'x_drum' is no output channel"),
    "no plant": (put('plant = "cable_drum"', ""), "plant is missing"),
    "a plant that is unknown": (put("cable_drum", "cable_car"), "plant 'cable_car' is unknown; give belt_drive"),
    "no sample time": (put("sample_time_s = 0.001", "sample_time_s = 0"), "sample_time_s 0 is too small; give seconds"),
    "another sample time": (put("sample_time_s = 0.001", "sample_time_s = 0.002"), "row 3, column t: step 0.001 s"),
    "a syntax error": (put("[parameters]", "[parameters"), "is not TOML"),
}  # fmt: skip


def at(line: int, column: int, text: str):
    """The cell changed."""

    def change(rows):
        rows[line][column] = text
        return rows

    return change


RECORDINGS = {
    "no channel": (lambda rows: [r[:2] for r in rows], "no column x_load"),
    "a channel that is unknown": (lambda rows: [[*rows[0], "T"], *([*r, "3"] for r in rows[1:])], "column T is no"),
    "a channel twice": (lambda rows: [[*rows[0], "x_load"], *([*r, "3"] for r in rows[1:])], "column x_load appears"),
    "time elsewhere": (lambda rows: [r[::-1] for r in rows], "first column 'x_load'; it must be t"),
    "nothing": (lambda rows: [[]], "is empty"),
    "a header only": (lambda rows: rows[:1], "0 samples"),
    "too little": (lambda rows: rows[:31], "30 samples, 0.03 s; record at least 40 samples, 0.04 s"),
    "NaN": (at(49, 2, "nan"), "row 50, column x_load: 'nan' is not"),
    "a word": (at(49, 2, "none"), "row 50, column x_load: 'none' is not"),
    "an empty cell": (at(49, 1, ""), "row 50, column x_drum: '' is an empty cell"),
    "a row too long": (lambda rows: [*rows[:49], [*rows[49], "1"], *rows[50:]], "row 50 has 4 cells, the header 3"),
    "a gap in time": (lambda rows: rows[:49] + rows[60:], "row 50, column t: step 0.012 s"),
    "time that jitters": (at(49, 0, "0.0484"), "row 50, column t: step 0.0014 s"),
    "nothing that moves": (lambda rows: [rows[0], *([r[0], "0.1", "0.1"] for r in rows[1:])],
                           "x_drum, x_load never move; excite the rig"),
}  # fmt: skip


def refused(greygate, folder: Path, problem: str, *options):
    """One line that names the problem, exit code 2, nothing written."""
    before = sorted(folder.rglob("*"))
    code, out, err = greygate("diagnose", folder, "--out", folder / "d.json", "--html", folder / "d.html", *options)
    assert (code, out) == (2, "")
    message = err.strip().splitlines()
    assert len(message) == 1
    assert problem in message[0]
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("case", RIGS)
def test_a_rig_file_is_refused_that_has(case, clean, tmp_path, greygate):
    change, problem = RIGS[case]
    refused(greygate, copied(clean, tmp_path / "rig", toml=change), problem)


@pytest.mark.parametrize("case", RECORDINGS)
def test_a_recording_is_refused_that_has(case, clean, tmp_path, greygate):
    change, problem = RECORDINGS[case]
    refused(greygate, copied(clean, tmp_path / "rig", rows=change), problem)


def test_a_folder_that_is_missing_is_named(tmp_path, greygate):
    code, _, err = greygate("diagnose", tmp_path / "nowhere")
    assert code == 2
    assert "nowhere/rig.toml: cannot be read" in err


def test_pressures_that_never_differ_cannot_show_leakage(tmp_path, greygate):
    rng = np.random.default_rng(1)
    t = np.arange(3000) * 1e-3
    p = 1e7 + 1e6 * np.sin(20 * t)
    columns = {"t": t, "v_c": np.sin(7 * t), "x": 0.01 * np.sin(5 * t)}
    columns |= {name: p + 12e3 * rng.standard_normal(len(t)) for name in ("p_a", "p_b")}
    (tmp_path / "rig.toml").write_text(conceal._toml(VALVE, VALVE.parameters))
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    lines = [",".join(columns), *(f"{k:.3f}," + ",".join(map(str, r)) for k, *r in rows)]
    (tmp_path / "identify.csv").write_text("\n".join(lines) + "\n")
    refused(greygate, tmp_path, "cannot show internal_leakage, external_leakage")


EFFECT = """[own]
means = "mine"
plants = ["cable_drum"]
equations = ["transmission"]
depends_on = ["x"]
parameters.k = { unit = "1", typical = 1e-3 }
terms."transmission.own" = "k * v"
"""
TABLES = {
    "a syntax error": (put("[own]", "[own"), "is not TOML"),
    "no place that the plant has": (put("transmission.own", "gear.own"), "own: gear: cable_drum has no such place"),
    "a name that is unknown": (put("k * v", "k * w"), "unknown name 'w'"),
    "no equations": (put('equations = ["transmission"]', ""), "effect own.equations is missing"),
    "a size in words": (put("1e-3", '"small"'), "own.parameters.k.typical 'small' is not a finite number"),
    "no size": (put("1e-3", "0"), "typical: 0.0; give a size above 0"),
    "no expression": (put('"k * v"', "3"), "3 is not an expression in quotes"),
}


@pytest.mark.parametrize("case", TABLES)
def test_a_table_of_effects_is_refused_that_has(case, clean, tmp_path, greygate):
    change, problem = TABLES[case]
    (tmp_path / "own.toml").write_text(change(EFFECT))
    refused(greygate, copied(clean, tmp_path / "rig"), problem, "--effects", tmp_path / "own.toml")


PLANTS = {
    "a syntax error": ("[inputs\n", "mine.toml: is not TOML"),
    "an expression that is none": (
        'outputs = ["y"]\n[inputs]\nu = "m"\n[definitions.gear]\ny = { unit = "m", drive = "2 * * u" }\n',
        "mine.toml: definitions.gear.y.drive: '2 * * u' is no expression",
    ),
    "an unknown entry": ("equation = 3\n", "'equation': there is no such entry; write equations if that is meant"),
}


@pytest.mark.parametrize("case", PLANTS)
def test_a_plant_file_of_ones_own_is_refused_that_has(case, clean, tmp_path, greygate):
    text, problem = PLANTS[case]
    rig = copied(clean, tmp_path / "rig", toml=put('"cable_drum"', '"mine.toml"'))
    (rig / "mine.toml").write_text(text)
    refused(greygate, rig, problem)


DIAGNOSES = {
    "no JSON": ("{", "is not JSON"),
    "a list": ("[]", "[] is not a table; give schema"),
    "another schema": ('{"schema": "x"}', "schema 'x' does not exist; choose diagnosis/2, diagnosis/1"),
    "another plant": ('{"schema": "diagnosis/1", "plant": "belt_drive", "effects": [], "parameters": {}}',
                      "is of belt_drive, the rig is cable_drum"),
    "no parameters": ('{"schema": "diagnosis/1", "plant": "cable_drum", "effects": []}', "parameters is missing"),
    "a parameter without a value": (
        '{"schema": "diagnosis/1", "plant": "cable_drum", "effects": [], "parameters": {"creep": {}}}',
        "parameters.creep.value is missing"),
    "a parameter that is unknown": (
        '{"schema": "diagnosis/1", "plant": "cable_drum", "effects": [], "parameters": {"mass": {"value": 1}}}',
        "parameter mass is unknown to cable_drum"),
    "an effect that is unknown": (
        '{"schema": "diagnosis/1", "plant": "cable_drum", "effects": [{"id": "magic", "parameters": {}}],'
        ' "parameters": {}}', "effect 'magic' is unknown here"),
    "an effect without its parameter": (
        '{"schema": "diagnosis/1", "plant": "cable_drum", "effects": [{"id": "drift", "parameters": {}}],'
        ' "parameters": {}}', "effect drift has no drift"),
}  # fmt: skip


@pytest.mark.parametrize("case", DIAGNOSES)
def test_a_diagnosis_is_refused_that_is_or_has(case, clean, tmp_path, greygate):
    text, problem = DIAGNOSES[case]
    given, out = tmp_path / "d.json", tmp_path / "predicted.csv"
    given.write_text(text)
    code, _, err = greygate("simulate", clean, clean / "holdout.csv", "--diagnosis", given, "--out", out)
    assert code == 2
    assert problem in err
    assert len(err.strip().splitlines()) == 1
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["crane", "--seed", 1], "no plant 'crane'; there are valve_hydraulic"),
        (["cable_drum", "--seed", 1, "--kind", "three"], "no kind 'three'; there are clean"),
        (["cable_drum", "--seed", -1], "--seed -1: give a whole number from 0"),
        (["cable_drum", "--seed", 1, "--effect", "entrained_air"], "has no effect 'entrained_air'"),
    ],
)
def test_conceal_names_what_it_does_not_know(arguments, problem, tmp_path, greygate):
    code, _, err = greygate("dev", "conceal", *arguments, "--out", tmp_path / "case")
    assert code == 2
    assert problem in err
    assert not (tmp_path / "case").exists()


def test_only_what_was_concealed_can_be_revealed(tmp_path, greygate):
    code, _, err = greygate("dev", "reveal", tmp_path)
    assert code == 2
    assert "holds no sealed answer" in err


def test_a_folder_to_write_to_must_be_there(clean, tmp_path, greygate):
    code, _, err = greygate("diagnose", clean, "--out", tmp_path / "nowhere" / "d.json")
    assert code == 2
    assert "nowhere: no such folder" in err
