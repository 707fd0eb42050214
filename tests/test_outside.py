"""Commands on rigs whose plant a model computes: each works, or says in one line which other does."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import greygate

from greygate.errors import InputError
from greygate.identify.expert.task import Task
from greygate.mismatch.diagnosis import READ
from greygate.mismatch.explain import table_of
from greygate.mismatch.rig import load
from greygate.pages.diagnosis import advice
from greygate.pages.diagnosis.sections import adds
from greygate.plants.python import Simulator
from greygate.plants.recording import Recording

mujoco = pytest.importorskip("mujoco")

DT, SAMPLES, NOISE = 0.005, 1000, 2e-4
ARM = """<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <body name="link">
      <joint name="hinge" axis="0 1 0" damping="0.02"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" density="2000"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge"/></actuator>
</mujoco>
"""
DIAGNOSIS = {
    "schema": READ[0], "plant": "arm", "verdict": "missing_physics",
    "parameters": {"damping_hinge": {"value": 0.02}},
    "effects": [{
        "id": "dry_friction", "form": "dry_friction", "equations": ["motion_hinge"],
        "parameters": {"frictionloss_hinge": {"value": 0.12}}, "not_told_apart_from": ["load_friction"],
    }],
}  # fmt: skip


def recorded(path):
    """A log of the arm with dry friction that its model has not."""
    model, t = mujoco.MjModel.from_xml_path(str(path)), np.arange(SAMPLES) * DT
    model.dof_frictionloss[0] = 0.12
    data, found = mujoco.MjData(model), []
    motor = 1.2 * np.sin(np.pi * t + 1.0) + 0.5 * np.sin(3.4 * np.pi * t)
    for torque in motor:
        found.append(data.qpos[0])
        data.ctrl[:] = torque
        for _ in range(round(DT / model.opt.timestep)):
            mujoco.mj_step(model, data)
    return t, motor, np.array(found) + NOISE * np.random.default_rng(1).standard_normal(SAMPLES)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the rig `arm` is, and the log that it was made of."""
    place = tmp_path_factory.mktemp("outside")
    (place / "arm.xml").write_text(ARM)
    columns = np.stack(recorded(place / "arm.xml"), axis=1)
    np.savetxt(place / "log.csv", columns, "%.6f", ",", header="t,motor [N m],hinge [rad]", comments="")
    assert greygate("init-rig", place / "log.csv", "--model", place / "arm.xml", "--out", place / "arm")[0] == 0
    return place


@pytest.mark.nightly
def test_effects_of_a_model_are_alike_where_they_are_and_apart_else(folder):
    """The sine of an unbalance is what the released inertia does: that makes it like no other effect."""
    code, printed, _ = greygate("isolability", folder / "arm", "--json")
    found = json.loads(printed)
    assert code == 0
    groups = [set(group["effects"]) for group in found["groups"]]
    assert {"constant_load", "input_offset"} in groups
    assert not any("dry_friction" in group for group in groups)
    assert max(map(len, groups)) <= 4
    motor = np.abs(np.genfromtxt(folder / "arm/identify.csv", delimiter=",", names=True)["motor"]).max()
    asked = [group["experiment"] for group in found["groups"] if group["experiment"]]
    assert asked
    for experiment in asked:
        assert -motor <= experiment["inputs"]["motor"]["low"] <= experiment["inputs"]["motor"]["high"] <= motor


def test_a_structured_network_needs_equations_and_the_refusal_names_what_does_not(folder):
    out = folder / "network"
    code, _, told = greygate("build-snn", folder / "arm", folder / "arm/identify.csv", "--out", out)
    assert (code, told.count("\n")) == (2, 1)
    assert "greygate identify" in told
    assert greygate("make", folder / "arm", "--out", out) == (2, "", told)
    assert not out.exists()


def test_no_network_is_built_of_a_function_that_has_no_equations():
    slide = Simulator(
        lambda t, x, u, p: (x[1], u[0]), dt=DT, states={"x": {"unit": "m", "rate": "v"}, "v": "m/s"},
        inputs={"force": "N"}, outputs=["x"], name="slide",
    )  # fmt: skip
    log = Recording(DT, {"force": np.zeros(SAMPLES), "x": np.zeros(SAMPLES)}, {"force": "N", "x": "m"})
    with pytest.raises(InputError, match=r"plant slide: a model computes it.*`greygate identify`"):
        Task.of(slide, [log], [], [])


def test_a_plant_without_a_structured_network_says_what_finds_one(folder, tmp_path):
    (tmp_path / "d.json").write_text(json.dumps(DIAGNOSIS))
    code, _, told = greygate("augment", folder / "arm", "--diagnosis", tmp_path / "d.json", "--out", tmp_path / "out")
    assert (code, told.count("\n")) == (2, 1)
    assert "arm has no structured network; `greygate identify`" in told


def test_the_next_experiment_on_a_model_stays_within_what_was_recorded(folder, tmp_path):
    (tmp_path / "d.json").write_text(json.dumps(DIAGNOSIS))
    out = tmp_path / "next.csv"
    code, _, told = greygate("next", folder / "arm", "--diagnosis", tmp_path / "d.json", "--out", out, "--json")
    assert code == 0, told
    motor, asked = (np.genfromtxt(p, delimiter=",", names=True)["motor"] for p in (folder / "arm/identify.csv", out))
    assert np.abs(asked).max() <= np.abs(motor).max()
    assert np.ptp(asked) > 0.1 * np.ptp(motor)


def test_the_page_shows_what_an_effect_adds_and_how_to_take_the_model_along(folder):
    rig = load(folder / "arm")
    search = SimpleNamespace(effects=table_of([], rig, rig.to_explain()))
    result, entry = SimpleNamespace(rig=rig, search=search), {"id": "load_friction"}
    assert adds(result, DIAGNOSIS["effects"][0]) == ["the model's own frictionloss_hinge"]
    (text,) = adds(result, entry)
    assert text.startswith("motion_hinge: + (-mu_v_hinge * abs(")
    assert adds(result, {"id": "unknown"}) == []
    found = {**DIAGNOSIS, "effects": [{**DIAGNOSIS["effects"][0], "not_told_apart_from": []}]}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(advice.words, "alike", lambda *_: [])
        told = advice.steps(SimpleNamespace(found=found, result=SimpleNamespace(rig=rig)))[1]
    assert f"greygate export mjcf {folder / 'arm'} --diagnosis FILE.json --out CORRECTED.xml" in told
