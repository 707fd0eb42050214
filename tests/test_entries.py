"""A file whose entries are of another kind is refused in one line that names file and entry."""

import copy
import json
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from greygate.errors import InputError, shown
from greygate.mismatch import effects as table
from greygate.mismatch.model import Model
from greygate.mismatch.rig import load
from greygate.mismatch.simulation import read, simulate
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording
from greygate.plants.simulator import source

WRONG = [
    5, -1, 0.0, 1e308, -1e-300, 10**400, math.nan, math.inf, -math.inf, True, "", "text", "x", "1e999", "../up", "a\nb",
    "\u202e", [], [[]], ["x"], [1.0], [1.0, "1", -1.0], [True, "1"], [10**400, "1"], {}, {"a": {}}, {"x": "x"}, [{}],
]  # fmt: skip
PLANT = {
    "step": 1e-3,
    "outputs": ["x"],
    "required": ["mass"],
    "inputs": {"force": "N", "rate": "N/s"},
    "derived": {"rate": "rate force"},
    "parameters": {"mass": [20.0, "kg", 0.1, "of the slide"], "dry": [0.0, "1"], "c": [3.0, "N s/m"]},
    "switches": {"dry": "c"},
    "states": {"x": {"unit": "m", "initial": 0.1, "low": "-mass", "high": 50.0, "rate": "v", "start": "0"},
               "v": {"unit": "m/s"}},
    "definitions": {"damping": {"f": {"unit": "N", "viscous": "-c * v"}}},
    "equations": {"position": {"x": {"velocity": "v"}}, "motion": {"v": {"storage": "mass", "drive": "force + f"}}},
}  # fmt: skip
RIG = {
    "plant": "slide.toml",
    "sample_time_s": 0.005,
    "settle_s": 0.1,
    "predict": ["x"],
    "anew": ["c"],
    "parameters": {"mass": 20.0, "c": 3},
    "tolerance": {"mass": 0.1},
    "channels": {"force": {"unit": "N", "role": "input"},
                 "x": {"unit": "m", "role": "output", "resolution": 0.0, "noise_rms": 1e-4}},
}  # fmt: skip
EFFECTS = {
    "hose": {
        "means": "a hose pulls",
        "plants": ["slide"],
        "equations": ["motion"],
        "depends_on": ["x"],
        "parameters": {
            "k_hose": {"unit": "N/m", "typical": 1.0, "low": 0.0, "high": 9.0, "guess": [0.5], "as": "hose"},
            "reach": {"unit": "m", "typical": 1.0, "shape": True, "whole": False, "scan": "wave"},
            "k_s": {"typical": 1.0},
            "k_c": {"typical": 1.0},
        },
        "terms": {"motion.hose": "-k_hose * x * narrow + k_s * pulled + k_c", "sensor_x.gain": "k_s * x"},
        "definitions": {"narrowed": {"symbol": "narrow", "unit": "1", "sum": "1 / (1 + reach)"}},
        "states": {"pulled": {"unit": "m", "initial": 0.0, "low": "-1", "high": 5.0, "start": "x"}},
        "equations_of": {"pull": {"state": "pulled", "terms": {"in": "v"}, "storage": "1"}},
        "filters": {"force": "lag reach"},
        "set": {"dry": 1.0},
        "wave": {"size": ["k_s", "k_c"]},
    },
    "freed": {"of": "hose", "means": "", "equations": [], "depends_on": [], "frees": {"c": {"typical": 2.0}}},
}
DIAGNOSIS = {
    "schema": "diagnosis/1",
    "plant": "slide",
    "effects": [
        {"id": "unknown", "equations": ["motion"],
         "parameters": {"unknown_1": {"value": 0.5, "place": "motion", "term": "unknown_1 * x"}}},
        {"id": "hose", "form": "hose", "equations": ["motion"],
         "parameters": {n: {"value": 0.5} for n in ("hose", "reach", "size", "size_phase")}},
    ],
    "parameters": {"mass": {"value": 21.0}},
}  # fmt: skip


def places(content, path=()) -> Iterator[tuple]:
    """The paths of every entry, tables and lists included."""
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in items:
        yield (*path, key)
        yield from places(value, (*path, key))


def changed(content, path: tuple, value):
    """`content` with another value there, and none where it is `...`; with another key where it is a key's text."""
    content = copy.deepcopy(content)
    at = content
    for key in path[:-1]:
        at = at[key]
    if value is ...:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return content


def mutants(content) -> Iterator[tuple[str, object]]:
    for path in places(content):
        for value in (*WRONG, ...):
            yield f"{path} = {shown(value)}", changed(content, path, value)
        yield f"{path} and another", changed(content, (*path[:-1], "\u00e9 x"), 5) if isinstance(path[-1], str) else {}


def taken(what: str, read, *named: str) -> bool:
    """Whether `read` takes it; if not, its one line names one of `named`."""
    try:
        with np.errstate(all="ignore"):
            read()
    except InputError as error:
        message = str(error)
        assert message.isprintable(), what
        assert message.startswith(named), (what, message)
        return False
    return True


@pytest.fixture
def rig(tmp_path) -> Path:
    (tmp_path / "slide.toml").write_text(tomli_w.dumps(PLANT))
    (tmp_path / "rig.toml").write_text(tomli_w.dumps(RIG))
    return tmp_path


@pytest.fixture
def recording() -> Recording:
    t = np.arange(500) * 5e-3
    return Recording(5e-3, {"force": np.sin(t), "x": 0.1 * np.cos(t)}, {"force": "N", "x": "m"})


def test_every_entry_of_a_plant_file_is_of_its_kind_or_refused(rig):
    path = rig / "slide.toml"
    source(Plant.read(path))
    refused = 0
    for what, mutant in mutants(PLANT):
        path.write_text(tomli_w.dumps(mutant), encoding="utf-8")
        refused += not taken(what, lambda: source(Plant.read(path)), f"{path}: ", "plant slide: ")
    assert refused > 500


def test_every_entry_of_a_rig_file_is_of_its_kind_or_refused(rig):
    path = rig / "rig.toml"
    load(rig)
    refused = 0
    for what, mutant in mutants(RIG):
        path.write_text(tomli_w.dumps(mutant), encoding="utf-8")
        refused += not taken(what, lambda: load(rig), f"{path}: ", f"{rig}")
    assert refused > 300


def test_every_entry_of_a_table_of_effects_is_of_its_kind_or_refused(rig, recording):
    path, slide = rig / "effects.toml", load(rig)
    path.write_text(tomli_w.dumps(EFFECTS))
    Model(slide, recording, table.read(path))
    refused = 0
    for what, mutant in mutants(EFFECTS):
        path.write_text(tomli_w.dumps(mutant), encoding="utf-8")

        def joined() -> None:
            effects = table.fitting(slide.plant, slide.datasheet, table.read(path))
            source(table.join(slide.plant, effects.values())[0])

        refused += not taken(what, joined, f"{path}: ", "effect ", "plant slide: ")
    assert refused > 900


@pytest.mark.nightly
def test_every_entry_of_a_diagnosis_is_of_its_kind_or_refused(rig, recording):
    path, slide = rig / "diagnosis.json", load(rig)
    (rig / "effects.toml").write_text(tomli_w.dumps({"hose": EFFECTS["hose"]}))
    effects = table.read(rig / "effects.toml")
    path.write_text(json.dumps(DIAGNOSIS))
    simulate(slide, recording, read(path), effects)
    refused = 0
    for what, mutant in mutants(DIAGNOSIS):
        path.write_text(json.dumps(mutant))
        said = f"{path}: ", "diagnosis: ", "effect unknown_1: ", "plant slide: "
        refused += not taken(what, lambda: simulate(slide, recording, read(path), effects), *said)
    assert refused > 300
