"""A diagnosed effect as a module of the structured network: better with it, still at rest, the same in Verilog."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from greygate import cli
from greygate.emulator.engine import run
from greygate.errors import InputError
from greygate.hardware.build import Project
from greygate.machines.cable_drum.augmentation import slip_sum
from greygate.machines.catalog import AUGMENTED
from greygate.machines.source import Source, read_record
from greygate.mismatch import augment as augmented
from greygate.mismatch.augment import augment
from greygate.mismatch.augmentation import Law
from greygate.mismatch.concealed.conceal import conceal
from greygate.mismatch.rig import load
from greygate.models.accuracy import free_run_rms
from greygate.models.families.blocks import feedforward
from greygate.models.network import Network, Port
from greygate.project import compile_project, verify_project

KEPT = Path(__file__).parents[1] / "benchmarks" / "results" / "augmented"
FIGURES = json.loads((KEPT / "figures.json").read_text())
NOISE = {"cable_drum": 8.6e-7, "valve_hydraulic": 14520.0}  # of the sensors, their quantum included: m, Pa, RMS


@pytest.fixture(scope="module")
def drum(tmp_path_factory) -> Path:
    return conceal("cable_drum", 3, tmp_path_factory.mktemp("drum") / "rig", kind="one", effect="speed_slip")


@pytest.fixture(scope="module")
def valve(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("valve") / "rig"
    return conceal("valve_hydraulic", 8, out, kind="one", effect="internal_leakage")


@pytest.fixture(scope="module")
def written(drum, tmp_path_factory) -> Path:
    """What `augment` leaves for the cable drum."""
    out = tmp_path_factory.mktemp("augmented") / "networks"
    augment(drum, FIGURES["cable_drum"]["diagnosis"], out, AUGMENTED)
    return out


def test_the_drum_errs_by_its_sensors_noise_with_the_module_and_by_much_more_without(written):
    facts = json.loads((written / "augment.json").read_text())
    without, with_it = (figures["trained"]["holdout"]["slip"] for figures in facts["networks"].values())
    assert with_it < NOISE["cable_drum"] < 0.05 * without
    assert list(facts["networks"]) == ["cable_drum", "cable_drum_speed_slip"]


@pytest.mark.parametrize("plant", FIGURES)
def test_kept_networks_give_the_kept_figures_on_the_held_out_recording(plant, request, tmp_path):
    rig = load(request.getfixturevalue({"cable_drum": "drum", "valve_hydraulic": "valve"}[plant]))
    kind = AUGMENTED[plant](rig, {})
    kind.recording(rig.recording(rig.folder / "holdout.csv")).write_csv(tmp_path / "holdout.csv")
    for name, figures in FIGURES[plant]["networks"].items():
        network = Network.load(KEPT / name)
        found = free_run_rms(network, read_record(network, tmp_path / "holdout.csv")[0])
        assert found == pytest.approx(figures["trained"]["holdout"], rel=1e-6)


@pytest.mark.parametrize("plant", FIGURES)
def test_the_effect_removes_most_of_the_error_on_the_held_out_recording(plant):
    without, with_it = (f["trained"]["holdout"] for f in FIGURES[plant]["networks"].values())
    assert all(with_it[output] < 0.2 * without[output] for output in without)
    assert all(with_it[output] < 1.35 * NOISE[plant] for output in without)


def test_the_verilog_of_the_augmented_drum_answers_as_the_emulator(written, tmp_path):
    short = tmp_path / "short.csv"
    short.write_text("\n".join((written / "holdout.csv").read_text().splitlines()[:101]) + "\n")  # two seconds
    recordings = {"identify": str(written / "identify.csv"), "short": str(short)}
    source = Source(str(written / "cable_drum_speed_slip.toml"), recordings)
    compile_project(source, tmp_path / "out", source.formats(), architectures=("parallel",))
    (result,) = verify_project(Project.open(tmp_path / "out"), ("short",), seed=1).values()
    assert result.passed
    assert result.verdicts[0].steps == 100


def test_nothing_creeps_at_rest_in_the_compiled_drum(written, tmp_path):
    source = Source(str(written / "cable_drum_speed_slip.toml"), {"identify": str(written / "identify.csv")})
    program = compile_project(source, tmp_path / "out", source.formats(), architectures=("parallel",)).program
    x = source.records()["identify"].inputs["x_drum"]
    rest = program.encode({"x_drum": np.append(x[:400], np.full(3000, x[400]))})
    answers = run(program, rest, states=False).outputs[402:]
    assert (answers == answers[0]).all()
    assert answers[0] != 0


@pytest.mark.parametrize("reads", ["v", "a"])
def test_a_slip_module_multiplies_travel_by_what_it_answers_to_speed_or_acceleration(reads):
    module = feedforward("missing", ["s"], [3], 1)
    network = slip_sum(Port("x", "m", 0.5), Port("slip", "m", 1e-3), 1e-2, 2e-4, (module, reads, 5e-3, 3e-3))
    x = np.cumsum(np.random.default_rng(0).normal(size=50)) * 1e-3
    d = np.diff(x, prepend=0.0)
    s = d if reads == "v" else np.diff(d, prepend=0.0)
    g = 3e-3 * np.array([module.run({"s": np.array([v / 5e-3])})["y"][0] for v in s])
    assert network.run({"x": x})["slip"] == pytest.approx(np.cumsum((2e-4 + g) * d), abs=1e-15)


def test_a_module_learns_its_law():
    at = np.linspace(-2.0, 2.0, 200)
    law = Law("v", at, 0.1 * np.abs(at))
    module, record = law.module(), law.record()
    answers = np.array([module.run({"s": np.array([s])})["y"][0] for s in record.inputs["s"][::20]])
    assert law.reach == 2.0
    assert law.size == 0.2
    assert np.abs(answers - record.targets["y"][::20]).max() < 0.05


def named(*ids: str, plant: str = "cable_drum") -> dict:
    """A diagnosis that names these effects."""
    effects = [{"id": name, "equations": [], "parameters": {}} for name in ids]
    return FIGURES["cable_drum"]["diagnosis"] | {"plant": plant, "effects": effects}


def test_an_effect_whose_form_has_a_memory_is_taught_by_its_plain_form(drum, written, tmp_path):
    said = json.loads(json.dumps(FIGURES["cable_drum"]["diagnosis"]))
    (entry,) = said["effects"]
    entry["form"] = "speed_slip_late"
    entry["parameters"]["slip_time"] = {"value": 0.02, "ci95": [0.01, 0.03], "unit": "s"}
    found, plain = augment(drum, said, tmp_path / "out", AUGMENTED), json.loads((written / "augment.json").read_text())
    for name, network in found["networks"].items():
        assert network["trained"] == plain["networks"][name]["trained"]


@pytest.mark.parametrize(
    ("diagnosis", "says"),
    [
        (named(), "names no effect"),
        (named("drift"), "names drift"),
        (named("speed_slip", "drift"), "names speed_slip and drift"),
        (named("speed_slip"), "has no speed_slip"),
        (named("speed_slip", plant="belt_drive"), "is of belt_drive, the rig is cable_drum"),
        ({}, "schema"),
    ],
)
def test_a_diagnosis_of_which_no_module_can_be_made_is_refused(diagnosis, says, drum, tmp_path):
    with pytest.raises(InputError, match=says):
        augment(drum, diagnosis, tmp_path / "out", AUGMENTED)
    assert not (tmp_path / "out").exists()


def test_a_recording_that_starts_elsewhere_is_refused(drum, tmp_path):
    (tmp_path / "rig.toml").write_text((drum / "rig.toml").read_text())
    for name in ("identify", "holdout"):
        t, x, load = np.loadtxt(drum / f"{name}.csv", delimiter=",", skiprows=1, unpack=True)
        table = np.column_stack([t, x + 0.1, load + 0.1])
        np.savetxt(tmp_path / f"{name}.csv", table, "%.7f", ",", header="t,x_drum,x_load", comments="")
    with pytest.raises(InputError, match=r"x_drum starts at 0\.1 m"):
        augment(tmp_path, FIGURES["cable_drum"]["diagnosis"], tmp_path / "out", AUGMENTED)


def test_the_command_writes_both_networks_and_names_their_errors(drum, tmp_path, monkeypatch, capsys):
    (tmp_path / "diagnosis.json").write_text(json.dumps(FIGURES["cable_drum"]["diagnosis"]))
    out = tmp_path / "out"
    arguments = ["augment", drum, "--diagnosis", tmp_path / "diagnosis.json", "--out", out]
    monkeypatch.setattr(sys, "argv", ["greygate", *map(str, arguments)])
    with pytest.raises(SystemExit) as stopped:
        cli.run()
    assert stopped.value.code == 0
    printed = capsys.readouterr().out
    assert "cable_drum_speed_slip: 7 neurons" in printed
    assert "holdout    slip     RMSE" in printed
    wanted = {"cable_drum", "cable_drum_speed_slip"}
    assert {p.stem for p in out.glob("*.toml")} == {p.stem for p in out.glob("*.safetensors")} == wanted


def test_a_leakage_outward_is_a_module_at_either_chamber(tmp_path, monkeypatch):
    monkeypatch.setattr(augmented, "EPOCHS", 3)
    rig = conceal("valve_hydraulic", 1, tmp_path / "rig", kind="one", effect="external_leakage")
    answer = json.loads((rig / "sealed.json").read_text())
    for name in ("identify", "holdout"):  # three seconds
        lines = (rig / f"{name}.csv").read_text().splitlines()
        (rig / f"{name}.csv").write_text("\n".join(lines[:3001]) + "\n")
    true = {key: {"value": value} for key, value in answer["parameters_true"].items()}
    found = {key: {"value": value} for key, value in answer["effects_true"].items()}
    told = named("external_leakage", plant="valve_hydraulic") | {"parameters": true}
    told["effects"][0]["parameters"] = found
    without, with_it = augment(rig, told, tmp_path / "out", AUGMENTED)["networks"].values()
    for output in ("p_a", "p_b"):
        assert with_it["trained"]["holdout"][output] < 0.2 * without["trained"]["holdout"][output]
    parameters = Network.load(tmp_path / "out" / "valve_hydraulic_external_leakage").parameters()
    for name in ("hidden1.s", "hidden1.bias", "out.hidden1", "out.bias"):
        assert np.array_equal(parameters[f"leak_a.{name}"], parameters[f"leak_b.{name}"])
