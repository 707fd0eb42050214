"""What a rig can show: effects that its sensors cannot tell apart, and the experiment or the sensor that would."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from greygate.errors import InputError
from greygate.mismatch import effects as table
from greygate.mismatch import rig
from greygate.mismatch.concealed import conceal
from greygate.mismatch.experiments.experiment import MARGIN, Bounds, nominal
from greygate.mismatch.experiments.isolability import isolability, typical
from greygate.mismatch.experiments.separation import NEEDED, FreeRun, Trial, Trials, like
from greygate.mismatch.explain import explain
from greygate.mismatch.search import Hypothesis, Search
from greygate.plants.recording import Recording

PLANT = """step = 1e-3
outputs = ["x", "i"]
[inputs]
u = "V"
[parameters]
mass = [20.0, "kg"]
viscous = [300.0, "N s/m"]
motor = [40.0, "N/A"]
inductance = [0.01, "H"]
[states]
i = { unit = "A" }
x = { unit = "m", rate = "v" }
v = { unit = "m/s" }
[equations.coil]
i = { storage = "inductance", drive = "u", resistance = "-i" }
[equations.position]
x = { velocity = "v" }
[equations.motion]
v = { storage = "mass", motor = "motor * i", viscous = "-viscous * v" }
"""
RIG = """plant = "linear_motor.toml"
sample_time_s = 0.005
predict = ["x"]
parameters = { mass = 20.0, viscous = 300.0, motor = 40.0, inductance = 0.01 }
tolerance = { viscous = 0.02, inductance = 1e-3 }
channels.u = { unit = "V", role = "input" }
channels.x = { unit = "m", role = "output", noise_rms = 2e-4 }
"""
SENSED = RIG.replace('["x"]', '["x", "i"]') + 'channels.i = { unit = "A", role = "output", noise_rms = 1e-2 }\n'
EFFECT = """[{name}]
means = "{name}"
plants = ["linear_motor"]
equations = ["{place}"]
depends_on = ["u"]
parameters.{symbol} = {{ unit = "1", typical = {typical}, low = {low} }}
terms."{place}.{name}" = "{term}"
"""
EFFECTS = {
    "drive_loss": ("coil", "loss", 0.1, "-loss * u"),
    "weak_magnet": ("motion", "weak", 0.1, "-weak * motor * i"),
    "pull": ("motion", "pull", 5.0, "-pull * x"),
    "push": ("motion", "push", 5.0, "push * x"),
    "breath": ("motion", "breath", 1e-6, "-breath * x"),
}


SMALL = 0.03  # of its typical size: the noise counts


def own(low: float = 0.0) -> str:
    fields = ("place", "symbol", "typical", "term")
    return "".join(EFFECT.format(name=n, low=low, **dict(zip(fields, e, strict=True))) for n, e in EFFECTS.items())


def motor(folder: Path, text: str = RIG, low: float = 0.0) -> Path:
    """A linear motor that conceals a lost tenth of its drive, driven slowly."""
    folder.mkdir()
    (folder / "linear_motor.toml").write_text(PLANT)
    (folder / "rig.toml").write_text(text)
    (folder / "effects.toml").write_text(own(low))
    t, loaded = np.arange(2000) * 5e-3, rig.load(folder)
    real = FreeRun(loaded, table.read(folder / "effects.toml"), {"loss": 0.1})
    shown = noisy(real, {"u": 2.0 * np.sin(2 * np.pi * 0.3 * t)})
    columns = {"t": t, **shown}
    table_ = np.column_stack(list(columns.values()))
    np.savetxt(folder / "identify.csv", table_, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    return folder


def noisy(free: FreeRun, inputs) -> dict:
    """What the sensors show, channel -> (samples,)."""
    rng, shown = np.random.default_rng(2), free.shown(inputs)
    noise = {n: free.rig.channels[n].noise * rng.standard_normal(len(shown[n])) for n in free.rig.predict}
    return {n: s + noise.get(n, 0.0) for n, s in shown.items()}


def search(folder: Path) -> Search:
    """Over the rig's own effects, and those of the table that fit; without the general ones, for which see the end."""
    loaded, own = rig.load(folder), folder / "effects.toml"
    effects = table.read() | (table.read(own) if own.exists() else {})
    recording = loaded.recording(folder / "identify.csv")
    return Search(loaded, recording, table.fitting(loaded.plant, loaded.datasheet, effects))


@pytest.fixture(scope="module")
def blind(tmp_path_factory):
    return motor(tmp_path_factory.mktemp("blind") / "motor")


@pytest.fixture(scope="module")
def found(blind):
    return isolability(search(blind))


@pytest.fixture(scope="module")
def drum(tmp_path_factory) -> Path:
    """A cable drum as its data sheet has it, with a noisy sensor."""
    folder = conceal.conceal("cable_drum", 3, tmp_path_factory.mktemp("drum") / "case", kind="clean")
    text = (folder / "rig.toml").read_text()
    head, sensor = (
        text[: text.index("[channels.x_load]")],
        'channels.x_load = { unit = "m", role = "output", noise_rms = 2e-6 }',
    )
    (folder / "rig.toml").write_text(f"{sensor}\n{head}")
    return folder


@pytest.fixture(scope="module")
def drums(drum):
    return isolability(search(drum))


def recorded(looked: Search, name: str, inputs) -> Recording:
    """What the rig's sensors show of `inputs` where the effect is true, of SMALL its typical size."""
    made = FreeRun(
        looked.rig, looked.screen.model.effects, {s: SMALL * v for s, v in typical(looked.effects[name]).items()}
    )
    noise, rng = {n: made.rig.channels[n].noise for n in made.rig.predict}, np.random.default_rng(2)
    shown = made.shown(inputs)
    shown = {n: s + noise.get(n, 0.0) * rng.standard_normal(len(s)) for n, s in shown.items()}
    return Recording(made.rig.dt, shown, made.units)


# -- what is not told apart ------------------------------------------------------------------------------------------


def test_effects_that_the_sensors_cannot_tell_apart_are_one_group_until_a_sensor_is_added(found, tmp_path):
    (group,) = found.groups
    assert group.effects == ("drive_loss", "weak_magnet")
    assert group.here < 0.1
    assert group.experiment is None  # of no input does the position tell the one from the other
    assert group.sensor[0] == "i"
    assert group.sensor[1] > 10 * NEEDED
    assert not isolability(search(motor(tmp_path / "sensed", SENSED))).groups


def test_an_effect_of_one_sign_is_not_taken_for_its_opposite(found, tmp_path):
    assert not any("push" in group.effects for group in found.groups)
    either = isolability(search(motor(tmp_path / "either", low=-1e9)))
    assert ("pull", "push") in [group.effects for group in either.groups]


def test_what_hardly_shows_and_what_is_left_to_the_data_sheet_are_told(found):
    (unseen,) = found.unseen
    assert unseen.effects == ("breath",)
    assert unseen.here < 0.01
    (value, parts), *_ = found.weak[::-1]
    assert list(parts) == ["inductance"]  # a slow motion does not show 10 ms
    assert value == min(found.singular) < 0.5


# -- the experiment --------------------------------------------------------------------------------------------------


def test_a_rest_tells_what_grows_with_time_from_what_grows_with_motion(drums):
    (group,) = drums.groups
    assert set(group.effects) == {"drift", "direction_slip"}
    assert group.experiment.apart > 10 * group.here
    assert group.experiment.experiment.shape.endswith("after 60 s of rest")


def test_the_proposed_experiment_recorded_tells_them_apart_as_a_distance_says(drum, drums):
    """The one effect is made true, with noise; both are fitted to the new recording alone."""
    (group,) = drums.groups
    looked = search(drum)
    gaps = []
    for inputs in ({"x_drum": looked.screen.model.recording["x_drum"]}, group.experiment.experiment.inputs):
        likelihood = like(looked.screen, looked.screen.model.over(recorded(looked, group.pair[0], inputs)))
        one, other = (likelihood.fit(looked.unknowns(Hypothesis((name,)))) for name in group.pair)
        gaps.append(np.sqrt(other.cost - one.cost))
        start = {u.symbol: u.origin for u in other.unknowns}
        rival = SimpleNamespace(values=start, unknowns=other.unknowns, information=np.diag(other.weight))
        assert Trial(likelihood, one.values).distance(rival) == pytest.approx(gaps[-1], rel=0.1, abs=1.0)
    assert gaps[1] > 10 * gaps[0]


def test_an_experiment_asks_no_more_than_the_recording_showed(blind, drum):
    for folder in (blind, drum):
        looked = search(folder)
        recorded = looked.screen.model.recording
        trials = Trials(looked.screen, {}).over(1.0)
        assert len(trials) > 8
        for trial in trials:
            shown = trial.likelihood.model.recording
            for name, channel in looked.rig.channels.items():
                beyond = MARGIN * np.ptp(recorded[name]) if channel.role == "output" else 1e-6
                assert shown[name].min() > recorded[name].min() - 1.01 * beyond
                assert shown[name].max() < recorded[name].max() + 1.01 * beyond


def test_a_position_is_moved_no_faster_and_no_harder_than_recorded(drum):
    looked = search(drum)
    recorded = looked.screen.model.recording["x_drum"]
    for trial in Trials(looked.screen, {}).over(1.0):
        path = trial.experiment.inputs["x_drum"]
        assert path[0] == pytest.approx(recorded[0], abs=1e-6)
        assert np.abs(np.diff(path)).max() <= 1.2 * np.abs(np.diff(recorded)).max()


def test_commands_rest_where_the_plant_stays_and_keep_their_sign(blind):
    looked = search(blind)
    model = looked.screen.model
    lifted = replace(model.recording, channels={**model.recording.channels, "u": model.recording["u"] + 3.0})
    bounds = Bounds.of(looked.rig, lifted, 1.5)
    assert bounds.low["u"] == pytest.approx(0.0)  # never below zero, so it stays
    assert bounds.rest["u"] == pytest.approx(3.0)
    rest = FreeRun(looked.rig, model.effects, {}).at_rest(bounds, lifted, 0.75).rest
    assert rest["u"] == pytest.approx(0.0, abs=0.02)


def test_a_diagnosis_names_the_experiment_that_tells_its_alternatives_apart(drum, tmp_path):
    looked = search(drum)
    made = recorded(looked, "direction_slip", {"x_drum": looked.screen.model.recording["x_drum"]})
    rows = np.column_stack([made.time, made["x_drum"], made["x_load"]])
    (tmp_path / "rig.toml").write_text((drum / "rig.toml").read_text())
    np.savetxt(tmp_path / "identify.csv", rows, delimiter=",", header="t,x_drum,x_load", comments="", fmt="%.9g")
    content, lines = explain(tmp_path)
    (entry,) = content["effects"]
    assert {entry["id"], *entry["not_told_apart_from"]} >= {"direction_slip", "drift"}
    alternatives = [line for line in lines if "in place of" in line]
    assert len(alternatives) == len(entry["not_told_apart_from"])
    for row in alternatives:
        found = re.search(r"; ([\d.]+) standard deviations of the noise apart, here ([\d.]+)$", row)
        then, here = map(float, found.groups())
        assert then > 3 * NEEDED > 3 * here


def test_a_diagnosis_says_so_where_no_experiment_tells_its_alternatives_apart(blind):
    _, lines = explain(blind)
    alternatives = [line for line in lines if "in place of" in line]
    named = {name for row in alternatives for name in re.search(r"(\w+) in place of (\w+);", row).groups()}
    assert named == {"drive_loss", "weak_magnet", "sensor_gain"}  # each scales what the one sensor shows
    assert all(row.endswith("no experiment that was tried tells them apart") for row in alternatives)


# -- the command -----------------------------------------------------------------------------------------------------


@pytest.mark.nightly
def test_the_command_prints_groups_and_remedies_and_gives_them_as_json(blind, drums, greygate):
    code, printed, _ = greygate("isolability", blind)
    assert code == 0
    assert re.search("not told apart: .*drive_loss, weak_magnet\n +drive_loss and weak_magnet differ by", printed)
    assert "apart by a sensor of i" in printed
    code, printed, _ = greygate("isolability", blind, "--json")
    (group,) = (group for group in json.loads(printed)["groups"] if group["pair"] == ["drive_loss", "weak_magnet"])
    assert {"sensor_gain", "input_delay"} <= set(group["effects"])  # the general effects are on offer too
    assert group["sensor"]["state"] == "i"
    assert group["experiment"] is None
    assert "apart by x_drum 0 to " in "\n".join(drums.lines())
    assert drums.as_dict()["groups"][0]["experiment"]["inputs"]["x_drum"]["unit"] == "m"


@pytest.mark.nightly
def test_before_data_motions_by_rule_stand_for_the_recording(blind, tmp_path, greygate):
    for name in ("rig.toml", "linear_motor.toml", "effects.toml"):
        (tmp_path / name).write_text((blind / name).read_text())
    code, printed, _ = greygate("isolability", tmp_path, "--range", "u=-2:2")
    assert code == 0
    assert re.search("not told apart: .*drive_loss, weak_magnet", printed)
    code, _, err = greygate("isolability", tmp_path)
    assert code == 2
    assert "identify.csv: there is no such file; record it, or give --range u=LOW:HIGH" in err


def test_a_plant_that_no_table_knows_is_told_of_the_general_effects(blind, tmp_path, greygate):
    for name in ("rig.toml", "linear_motor.toml"):
        (tmp_path / name).write_text((blind / name).read_text())
    code, printed, _ = greygate("isolability", tmp_path, "--range", "u=-2:2")
    assert code == 0
    assert re.search("not told apart: .*input_delay, input_lag", printed)


@pytest.mark.parametrize(
    ("ranges", "problem"),
    [
        ({}, "the inputs are u; give one of each"),
        ({"u": (-1.0, 1.0), "w": (0.0, 1.0)}, "the inputs are u; give one of each"),
        ({"u": (1.0, -1.0)}, "give two numbers, LOW below HIGH"),
        ({"u": (float("nan"), 1.0)}, "give two numbers, LOW below HIGH"),
    ],
)
def test_ranges_are_refused_that_are_no_ranges_of_the_inputs(ranges, problem, blind):
    with pytest.raises(InputError, match=problem):
        nominal(rig.load(blind), {}, ranges)


def test_a_range_that_is_none_is_named(blind, greygate):
    code, _, err = greygate("isolability", blind, "--range", "u=2")
    assert code == 2
    assert "--range u=2: give NAME=LOW:HIGH" in err
