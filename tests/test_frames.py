"""Recordings and results as DataFrames."""

import json
import sys

import pytest

from greygate import InputError, Recording, read_recording, schemas, to_pandas

EXAMPLES = {name: schemas.load(name)["examples"][0] for name in ("identify", "report", "diagnosis")}


def test_a_recording_goes_to_pandas_and_back(tmp_path):
    recording = Recording(1e-3, {"u": [1.0, 2.0, 4.0], "p_a": [0.1, 0.2, 0.3]}, {"u": "V", "p_a": "Pa"})
    frame = to_pandas(recording)
    assert frame.columns.tolist() == ["u_V", "p_a_Pa"]
    assert frame.index.tolist() == recording.time.tolist()
    back = read_recording(frame.reset_index())
    assert (back.dt, back.units) == (recording.dt, recording.units)
    assert {n: v.tolist() for n, v in back.channels.items()} == {n: v.tolist() for n, v in recording.channels.items()}
    recording.write_csv(tmp_path / "a.csv")
    assert to_pandas(tmp_path / "a.csv").equals(frame)


def test_a_unit_that_no_header_can_say_is_refused():
    with pytest.raises(InputError, match="unit furlong has no suffix"):
        to_pandas(Recording(1.0, {"u": [1.0, 2.0]}, {"u": "furlong"}))


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_result_and_its_file_give_the_same_table(name, tmp_path):
    (tmp_path / "found.json").write_text(json.dumps(EXAMPLES[name]))
    assert to_pandas(tmp_path / "found.json").equals(to_pandas(EXAMPLES[name]))


def test_the_tables_hold_what_was_found():
    models = EXAMPLES["identify"]["models"]
    assert to_pandas(EXAMPLES["identify"]).to_dict("records") == models
    (study,) = EXAMPLES["report"]
    errors = [run["outputs"] for run in study["scenarios"].values()]
    frame = to_pandas(EXAMPLES["report"])
    assert frame["fixed"].tolist() == [o["rmse"]["fixed"] for outputs in errors for o in outputs.values()]
    assert frame["cost"].tolist() == [o["quantization"]["rms"] for outputs in errors for o in outputs.values()]
    found = EXAMPLES["diagnosis"]
    (effect,), frame = found["effects"], to_pandas(found)
    (name, first), *_ = effect["parameters"].items()
    assert frame.loc[0].tolist() == [
        *(effect["id"], name, first["value"], *first["ci95"], first["unit"], effect["confidence"])
    ]
    assert frame["of"].tolist() == [effect["id"]] * len(effect["parameters"]) + [found["plant"]] * len(
        found["parameters"]
    )


@pytest.mark.parametrize("source", [{"a": 1}, [1], 5, None])
def test_anything_else_is_refused(source):
    with pytest.raises(InputError, match="is no recording, and no result of identify, report or diagnose"):
        to_pandas(source)


def test_without_pandas_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"pandas is not installed; pip install 'greygate\[pandas\]'"):
        to_pandas({"verdict": "consistent"})
