"""`greygate build-snn`: a motor with friction that its plant file leaves out, and what is refused."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from greygate.cli import app
from greygate.errors import InputError
from greygate.identify.expert import building
from greygate.identify.expert.building import Attempt, Decided, Expert, Way, better, chance
from greygate.identify.expert.decisions import Log
from greygate.identify.expert.files import build_files
from greygate.identify.expert.parts import part
from greygate.models.network import Network
from greygate.plants.functions import orifice
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording
from greygate.plants.simulator import simulate

MOTOR = """
step = 1e-3
outputs = ["w"]
inputs = { u = "V" }
states = { w = { unit = "rad/s" } }
[parameters]
inertia = [0.01, "kg m^2", 0.1]
gain = [0.1, "N m/V", 0.05]
viscous = [0.01, "N m s/rad", 0.2]
[equations.rotation]
w = { storage = "inertia", motor = "gain * u", viscous = "-viscous * w" }
"""
FRICTION = {"f_w": {"value": 0.15}, "f_w_speed": {"value": 2.0}}
NAMED = [{"id": "dry_friction", "form": "dry_friction", "equations": ["rotation"], "parameters": FRICTION}]
TOLD = {"schema": "diagnosis/2", "plant": "motor", "verdict": "missing_physics", "effects": NAMED, "parameters": {}}
OPEN = TOLD | {"verdict": "unexplained", "effects": []}


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """motor.toml, two recordings of a motor that has dry friction too, and one of a motor that has none."""
    folder = tmp_path_factory.mktemp("motor")
    (folder / "motor.toml").write_text(MOTOR)
    for name, told in {"told": TOLD, "open": OPEN}.items():
        (folder / f"{name}.json").write_text(json.dumps(told))
    real = Plant.read(folder / "motor.toml").with_term("rotation", "dry", "-0.15 * tanh(w / 2.0)")
    plants = {"training": real, "held": real, "plain": Plant.read(folder / "motor.toml")}
    for seed, (name, plant) in enumerate(plants.items()):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.uniform(-8, 8, 40), 30)
        run = simulate(plant, {"u": u}, sample_time=0.02, step=1e-3)
        noisy = {"u": u, "w": run["w"] + 0.05 * rng.standard_normal(len(u))}
        Recording(0.02, noisy, {"u": "V", "w": "rad/s"}).write_csv(folder / f"{name}.csv")
    return folder


def built(files: Path, out: Path, **changed) -> dict:
    given = {"tests": {"held": str(files / "held.csv")}, "sensors": (), "targets": (), "seconds": np.inf}
    given |= {"diagnosis": files / "told.json"} | changed
    return build_files(files / "motor.toml", {"training": str(files / "training.csv")}, out=out, **given)


@pytest.fixture(scope="module")
def found(files, tmp_path_factory) -> tuple[dict, Path]:
    out = tmp_path_factory.mktemp("built") / "out"
    return built(files, out), out


@pytest.fixture
def alone(monkeypatch):
    """The linear model to compare with learns from little: its search takes most of the time, and `found` has it."""
    whole = building.linear
    monkeypatch.setattr(building, "linear", lambda records: whole([r.cut(0, 60) for r in records]))


def test_it_beats_the_plants_own_simulation_and_a_linear_model_on_what_was_held_out(found):
    rms = {who: by["held"]["w"] for who, by in found[0]["rms"].items()}
    assert rms["network"] < 0.2 * rms["nominal"]
    assert rms["network"] < 0.6 * rms["linear"]


def test_decisions_name_the_effect_and_the_reason(found):
    (named,) = [d for d in found[0]["decisions"] if d["step"] == "diagnose" and d["about"] == "rotation"]
    assert named["choice"] == "dry friction"
    assert named["reason"] == "the diagnosis names it: f_w = 0.15 N m, f_w_speed = 2 rad/s"
    assert all(d["about"] and d["choice"] and d["reason"] for d in found[0]["decisions"])


@pytest.mark.usefixtures("alone")
def test_a_step_that_fails_is_undone_and_said_so(files, tmp_path):
    out = tmp_path / "out"
    arguments = ({"plain": str(files / "plain.csv")}, {}, (), (), np.inf, out)
    done = build_files(files / "motor.toml", *arguments, diagnosis=files / "open.json")
    (unknown,) = [d for d in done["decisions"] if d["about"] == "rotation"]
    assert unknown["undone"]
    assert "not below 0.9 of it" in unknown["reason"]
    assert "rotation: UNDONE: an unknown term of 4 neurons" in (out / "motor.decisions.txt").read_text()
    assert Network.load(out / "motor").neurons() == 0


def test_the_same_inputs_give_the_same_bytes(files, found, tmp_path):
    built(files, tmp_path / "again")
    for path in sorted(found[1].iterdir()):
        assert (tmp_path / "again" / path.name).read_bytes() == path.read_bytes(), path.name


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"sensors": ("speed",)}, "plant motor: has no signal speed"),
        ({"targets": ("w",), "sensors": ("w",)}, "w is both --sensor and --output"),
        ({"sensors": ("w",)}, "no output is on record but those of a sensor"),
        ({"tests": {"training": "training.csv"}}, "training is both a recording to train on and one to test on"),
    ],
)
def test_what_cannot_be_built_is_refused_before_anything_is_written(files, tmp_path, changed, says):
    with pytest.raises(InputError, match=says):
        built(files, tmp_path / "out", **changed)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("header", "rows", "says"),
    [
        ("t_s,u_V", 100, "no output is on record"),
        ("t_s,w_rad_s", 100, "no channel u, which motor needs"),
        ("t_s,u_V,w_V", 100, "w is in V; convert it to rad/s"),
        ("t_s,u_V,w_rad_s", 20, "20 samples; give at least 40"),
    ],
)
def test_a_recording_that_does_not_do_is_refused_by_name(files, tmp_path, header, rows, says):
    columns = header.count(",")
    lines = [",".join([f"{0.02 * k:.2f}", *["0.5"] * columns]) for k in range(rows)]
    (tmp_path / "bad.csv").write_text("\n".join([header, *lines]) + "\n")
    given = ({"bad": str(tmp_path / "bad.csv")}, {}, (), (), np.inf, tmp_path / "out")
    with pytest.raises(InputError, match=says):
        build_files(files / "motor.toml", *given)
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("alone")
def test_the_command_gives_json_and_the_next_command(files, tmp_path):
    arguments = ["build-snn", str(files / "motor.toml"), str(files / "training.csv"), "--out", str(tmp_path / "out")]
    arguments += ["--diagnosis", str(files / "told.json")]
    done = CliRunner().invoke(app, [*arguments, "--json"])
    assert done.exit_code == 0
    found = json.loads(done.stdout)
    assert found["next"].startswith("next: greygate compile ")
    assert set(found["rms"]["network"]) == {"training", "training end"}
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "motor.toml", "motor.safetensors", "motor.json", "motor.decisions.txt", "motor.diagnosis.json"
    }  # fmt: skip


@pytest.mark.usefixtures("alone")
def test_of_a_rig_whose_file_has_the_units_the_next_command_runs_as_printed(files, tmp_path):
    rig = tmp_path / "rig"
    rig.mkdir()
    (rig / "motor.toml").write_text(MOTOR)
    (rig / "rig.toml").write_text(
        'plant = "motor.toml"\nsample_time_s = 0.02\npredict = ["w"]\n'
        "parameters = { inertia = 0.01, gain = 0.1, viscous = 0.01 }\n"
        'channels.u = { unit = "V", role = "input" }\nchannels.w = { unit = "rad/s", role = "output" }\n'
    )
    bare = (files / "training.csv").read_text().replace("t_s,u_V,w_rad_s", "t,u,w", 1)
    (rig / "identify.csv").write_text(bare)
    out, told = rig, files / "told.json"  # beside what is the user's own
    arguments = [rig, rig / "identify.csv", "--diagnosis", told, "--out", out, "--json"]
    done = CliRunner().invoke(app, ["build-snn", *map(str, arguments)])
    assert done.exit_code == 0, done.stderr
    command = json.loads(done.stdout)["next"].removeprefix("next: greygate ").split()
    assert command[:3] == ["compile", str(out / "motor.toml"), str(out / "motor.recording.csv")]
    assert CliRunner().invoke(app, command).exit_code == 0
    assert (rig / "identify.csv").read_text() == bare


def test_a_valve_is_found_in_the_library_and_a_curve_is_trained():
    log = Log()
    seen = {"u": np.linspace(-1e-3, 1e-3, 500), "p": np.linspace(2e5, 8e5, 500)[::-1]}

    def flow(at):
        return 3e-5 * (orifice(at["u"], 1e6, at["p"]) - orifice(-at["u"], at["p"], 0.0))

    found = part("flow", flow, seen, {"u": [1e-3], "p": [1e6]}, 0, log)
    assert found.of_library
    assert found.scales == {"u": 1e-3, "p": 1e6}
    other = part("curve", lambda at: np.exp(-at["u"] * 1e3), {"u": seen["u"]}, {"u": []}, 0, log)
    assert not other.of_library
    assert "no library network is this term" in log.decisions[-1].reason


def outcome(error: float, blocks: list[float]) -> Decided:
    """What is decided, by an expert that only tells the error of each block."""
    expert = SimpleNamespace(by_block=lambda network: blocks)
    return Decided(expert, SimpleNamespace(error=error, network=None), [])


@pytest.mark.parametrize(
    ("plain", "blocks", "taken"),
    [(0.5, [0.5, 0.5, 0.5, 2.0], True), (0.99, [0.9, 0.9, 0.9, 0.9], False), (0.5, [0.1, 0.1, 2.0, 2.0], False)],
    ids=["less in most blocks", "hardly less", "less in half of them"],
)
def test_the_data_sheets_plant_is_taken_where_a_diagnosis_led_astray(plain, blocks, taken):
    corrected, sheet = outcome(1.0, [1.0] * 4), outcome(plain, blocks)
    given = SimpleNamespace(plant=SimpleNamespace(name="motor"))
    best = better(corrected, lambda task: sheet, given)
    assert best.expert is (sheet if taken else corrected).expert
    (said,) = best.log
    assert (said.step, said.undone) == ("start", not taken)


def test_a_plant_that_no_network_follows_leaves_the_corrected_one():
    def none(task):
        raise InputError("plant motor: no network of it")

    corrected = outcome(1.0, [1.0])
    best = better(corrected, none, SimpleNamespace(plant=SimpleNamespace(name="motor")))
    assert (best.expert, best.log[0].undone, best.log[0].reason) == (
        corrected.expert, True, "plant motor: no network of it",
    )  # fmt: skip


def test_what_gains_most_alone_is_added_first_and_what_follows_is_held_against_it(files, monkeypatch):
    errors = {(): 1.0, ("b",): 0.5, ("a",): 0.6, ("a", "b"): 0.55, ("c",): 0.9, ("b", "c"): 0.4}
    candidates = {key: SimpleNamespace(network=key, error=error, choices=key) for key, error in errors.items()}

    class Fake(Expert):
        parts, begins, remains, task = {}, {}, True, SimpleNamespace(plant=SimpleNamespace(name="motor"))

        def __init__(self):
            self.log, self.asked = Log(), []

        def ways(self):
            return [Way(n, n, lambda choices, n=n: tuple(sorted({*choices, n}))) for n in "abc"]

        def by_block(self, network):
            return [errors[network]] * 4

        def attempt(self, best, way):
            key = way.change(best.choices)
            self.asked.append(key)
            return Attempt(candidates[key], errors[key], [errors[key]] * 4)

    expert = Fake()
    assert expert.widened(candidates[()]).network == ("b", "c")
    assert expert.asked == [("a",), ("b",), ("c",), ("a", "b"), ("b", "c")]


def test_many_blocks_stand_for_a_large_gain():
    assert (chance(8, 8), chance(7, 8)) == (1 / 256, 9 / 256)
    assert chance(4, 4) == 1 / 16
