"""A MuJoCo model as a plant: it moves as MuJoCo moves it, effects act on its joints, files stay where they are."""

import importlib
import json
import re
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from greygate import diagnose
from greygate.errors import InputError
from greygate.mismatch.diagnosis import READ
from greygate.mismatch.entries import fitting
from greygate.mismatch.excitation import unseen
from greygate.mismatch.fit import Likelihood, Unknown
from greygate.mismatch.general import general
from greygate.mismatch.model import TINY, Model
from greygate.mismatch.rig import load
from greygate.mismatch.search import Search
from greygate.mismatch.stretches import stretches
from greygate.plants import kinds, mjcf
from greygate.plants.plant import Parameter, Plant
from greygate.plants.simulator import Restarted, simulate
from greygate.progress import silent

mujoco = pytest.importorskip("mujoco")
finding = importlib.import_module("greygate.mismatch.diagnose")

DT, SAMPLES = 0.005, 600
ARM = """<mujoco>
  <option timestep="0.001" {option}/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" damping="0.02" frictionloss="{loss}"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02"/>
      <body name="lower" pos="0 0 -0.3">
        <joint name="el-bow" axis="0 1 0" damping="{damping}"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02"/>
      </body>
    </body>
  </worldbody>
  <actuator>{actuators}</actuator>
</mujoco>
"""
MOTORS = '<motor name="m1" joint="shoulder"/><position name="m2" joint="el-bow" kp="2" kv="0.05" forcerange="-1 1"/>'


def write(folder, name="arm.xml", option="", loss=0.01, damping=0.01, actuators=MOTORS):
    path = folder / name
    path.write_text(ARM.format(option=option, loss=loss, damping=damping, actuators=actuators))
    return path


def inputs(names):
    t = np.arange(SAMPLES) * DT
    return {name: 0.3 * np.sin(2.0 * t + i) + 0.1 * np.sin(11.0 * t) for i, name in enumerate(names)}


def stepped(path, controls, act=lambda data: None, loaded=lambda model: None):
    """Joint positions (samples, joints) as MuJoCo itself steps them."""
    model = mujoco.MjModel.from_xml_path(str(path))
    loaded(model)
    data, out = mujoco.MjData(model), []
    for row in np.stack([*controls.values()], axis=1):
        out.append(data.qpos.copy())
        data.ctrl[:] = row
        for _ in range(round(DT / model.opt.timestep)):
            act(data)
            mujoco.mj_step(model, data)
    return np.array(out)


@pytest.mark.parametrize("option", ["", 'integrator="implicitfast"', 'integrator="implicit"', 'integrator="RK4"'])
def test_a_plant_from_a_model_moves_as_mujoco_moves_it_in_every_bit(tmp_path, option):
    path, given = write(tmp_path, option=option), inputs(["m1", "m2"])
    plant = mjcf.read(path, [*given])
    assert list(plant.states) == ["shoulder", "el_bow", "v_shoulder", "v_el_bow"]
    found = simulate(plant, given, sample_time=DT, step=plant.step)
    wanted = stepped(path, given)
    assert np.ptp(wanted, axis=0).min() > 0.1
    assert np.array_equal(np.stack([found["shoulder"], found["el_bow"]], axis=1), wanted)


@pytest.mark.parametrize(("term", "resists"), [("0.1 * shoulder", False), ("-0.1 * v_shoulder", True)])
def test_only_what_is_added_may_resist_a_step(tmp_path, term, resists):
    """The model's own damping and friction are MuJoCo's, in its steps."""
    plant = mjcf.read(write(tmp_path), ["m1", "m2"]).with_term("motion_shoulder", "more", term)
    assert Restarted(plant, DT, plant.step).module.resisting is resists


@pytest.mark.parametrize("strength", [0.0, 1.0])
def test_an_effect_that_acts_may_resist_a_step_by_a_state_of_its_own(tmp_path, strength):
    term = "when(abs(more), more * shoulder)"
    plant = mjcf.read(write(tmp_path), ["m1", "m2"]).with_term(
        "motion_shoulder", "more", term, {"more": Parameter(0.0, "N m/rad")}
    )
    ran, told = Restarted(plant, DT, plant.step), []
    ran.module.loop = SimpleNamespace(pieces=lambda *given: told.append(given[-3][-1]) or -1)
    values = {symbol: p.value for symbol, p in plant.parameters.items()} | {"more": strength}
    ran.run(np.zeros((3, 2)), np.array([0]), np.zeros((1, 4)), np.ones(4, bool), values)
    assert told == [int(strength != 0.0)]


def test_terms_and_parameters_have_mujocos_names_and_values(tmp_path):
    plant = mjcf.read(write(tmp_path), ["m1", "m2"])
    assert {s: plant.parameters[s].value for s in ("damping_shoulder", "frictionloss_shoulder", "kp_m2", "kv_m2")} == {
        "damping_shoulder": 0.02, "frictionloss_shoulder": 0.01, "kp_m2": 2.0, "kv_m2": 0.05,
    }  # fmt: skip
    motion = plant.equations["motion_el_bow"].terms
    assert (
        motion["m2"] == "1.0 * (min(max(kp_m2 * m2 + -kp_m2 * (1.0 * el_bow) + -kv_m2 * (1.0 * v_el_bow), -1.0), 1.0))"
    )
    data = stepped_once(tmp_path / "arm.xml", {"shoulder": 0.2, "el_bow": -0.4}, {"m1": 0.3, "m2": 0.1})
    known = {**dict.fromkeys(plant.states, 0.0), "shoulder": 0.2, "el_bow": -0.4, "m1": 0.3, "m2": 0.1}
    for place, sum_ in (("motion_shoulder", data.qfrc_actuator[0]), ("motion_el_bow", data.qfrc_actuator[1])):
        values = plant.values(list(plant.states), known)
        drive = plant.equations[place].terms["m1" if place == "motion_shoulder" else "m2"]
        scope = {**{s: p.value for s, p in plant.parameters.items()}, **known, **values}
        from greygate.plants.expressions import parse

        assert float(parse(drive).over(scope)) == pytest.approx(sum_, rel=1e-12)


def stepped_once(path, positions, controls):
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = [*positions.values()], [*controls.values()]
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
def test_damping_as_an_effect_moves_as_mujocos_own(tmp_path, integrator):
    """A force that falls with the velocity is taken where the step ends, as MuJoCo does with its damping."""
    given = inputs(["m1", "m2"])
    option = f'integrator="{integrator}"'
    plain = mjcf.read(write(tmp_path, "plain.xml", option, damping=0.0), [*given])
    damped = plain.with_term("motion_el_bow", "oil", "-0.3 * v_el_bow")
    found = simulate(damped, given, sample_time=DT, step=plain.step)["el_bow"]
    wanted = stepped(write(tmp_path, "damped.xml", option, damping=0.3), given)[:, 1]
    assert np.abs(found - wanted).max() < 1e-9 * np.ptp(wanted)


def test_stiff_dry_friction_holds_a_joint_still(tmp_path):
    """Explicitly it would shake: the friction of a step turns the velocity round a hundred times over."""
    plain = mjcf.read(write(tmp_path, loss=0.0, damping=0.0), ["m1", "m2"])
    rough = plain.with_term("motion_el_bow", "dry", "-2.0 * tanh(v_el_bow / 1e-5)")
    given = {"m1": np.zeros(SAMPLES), "m2": np.full(SAMPLES, 0.2)}
    found = simulate(rough, given, sample_time=DT, step=plain.step)
    assert np.abs(found["v_el_bow"][1:]).max() < 1e-5
    assert np.abs(simulate(plain, given, sample_time=DT, step=plain.step)["v_el_bow"]).max() > 0.1


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
def test_dry_friction_of_a_joint_that_turns_is_that_of_finer_steps(tmp_path, integrator):
    """A Runge-Kutta step took its slope for a damping of the whole velocity: a joint that turned round ran away."""
    given = inputs(["m1", "m2"])
    option = f'integrator="{integrator}"'
    plain = mjcf.read(write(tmp_path, "arm.xml", option, loss=0.0), [*given])
    rough = plain.with_term("motion_el_bow", "dry", "-0.2 * tanh(v_el_bow / 1e-3)")
    coarse, fine, without = (
        simulate(plant, given, sample_time=DT, step=plain.step / parts)["el_bow"]
        for plant, parts in ((rough, 1), (rough, 20), (plain, 1))
    )
    assert np.abs(without - fine).max() > 20 * np.abs(coarse - fine).max()


def test_torques_of_a_log_take_the_place_of_controls(tmp_path):
    path, names = write(tmp_path), ["torque_shoulder", "torque_el_bow"]
    plant, given = mjcf.read(path, names), inputs(names)
    assert plant.inputs == {"torque_shoulder": "N m", "torque_el_bow": "N m"}
    found = simulate(plant, given, sample_time=DT, step=plant.step)
    wanted = stepped(
        write(tmp_path, "free.xml", actuators='<motor name="a" joint="shoulder"/><motor name="b" joint="el-bow"/>'),
        given,
    )
    assert np.abs(found["el_bow"] - wanted[:, 1]).max() < 1e-12


RIG = """plant = "arm.xml"
sample_time_s = 0.005
predict = ["shoulder", "el_bow"]
parameters = {{}}
tolerance = {{ {tolerance} = 0.2 }}
channels.m1 = {{ unit = "N m", role = "input" }}
channels.m2 = {{ unit = "rad", role = "input" }}
channels.shoulder = {{ unit = "rad", role = "output", noise_rms = 1e-4 }}
channels.el_bow = {{ unit = "rad", role = "output", noise_rms = 1e-4 }}
"""


def record(folder, path, tolerance="mass_lower", act=lambda data: None):
    given = inputs(["m1", "m2"])
    columns = [np.arange(SAMPLES) * DT, *given.values(), *stepped(path, given, act).T]
    header = "t,m1,m2,shoulder,el_bow"
    np.savetxt(folder / "identify.csv", np.stack(columns, axis=1), "%.17g", ",", header=header, comments="")
    (folder / "rig.toml").write_text(RIG.format(tolerance=tolerance))
    return load(folder)


@pytest.mark.parametrize(
    ("symbol", "array", "index"),
    [
        ("mass_lower", "body_mass", 2),
        ("frictionloss_shoulder", "dof_frictionloss", 0),
        ("ipos_z_lower", "body_ipos", (2, 2)),
    ],
)
def test_a_released_parameter_is_written_into_the_model(tmp_path, symbol, array, index):
    path = write(tmp_path)
    rig = record(tmp_path, path, symbol)
    assert [*rig.uncertain()] == [symbol]
    model = Model(rig, rig.to_explain(), {})
    assert np.array_equal(model.predict(model.values), model.target)
    other = 1.2 * model.values[symbol]
    found = model.predict({**model.values, symbol: other})
    changed = mujoco.MjModel.from_xml_path(str(path))
    getattr(changed, array)[index] = other
    data = mujoco.MjData(changed)
    mujoco.mj_setConst(changed, data)
    mujoco.mj_resetData(changed, data)
    wanted = []
    for row in np.stack([model.recording["m1"], model.recording["m2"]], axis=1):
        wanted.append(data.qpos.copy())
        data.ctrl[:] = row
        for _ in range(5):
            mujoco.mj_step(changed, data)
    assert np.abs(found - model.target).max() > 1e-3
    assert np.abs(found - wanted).max() < 1e-12
    assert np.array_equal(model.predict(model.values), model.target)  # and back


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<option", '<extension><plugin plugin="mujoco.pid"/></extension><option', "a plugin is a program"),
        ("<option", '<include file="../other.xml"/><option', "not under the model's folder"),
        ("<option", '<asset><mesh file="http://a.b/c.stl"/></asset><option', "not under the model's folder"),
        ('<joint name="shoulder" axis="0 1 0"', '<joint type="ball" name="shoulder"', "is a ball joint"),
        ("<mujoco>", "<!DOCTYPE mujoco><mujoco>", "DOCTYPE"),
        ("</mujoco>", "", "is no XML"),
        ('axis="0 1 0"', 'axis="0 0 0"', "MuJoCo does not load it"),
    ],
)
def test_a_model_that_cannot_be_is_refused_in_one_line(tmp_path, old, new, said):
    path = write(tmp_path)
    (tmp_path.parent / "other.xml").write_text("<mujoco/>")
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=said):
        mjcf.read(path, ["m1", "m2"])


def log(folder, path, given, columns=("m1", "m2", "q1", "q2")):
    """log.csv of a model's own motion, its columns so named."""
    signals = [*given.values(), *stepped(path, given).T]
    table = np.stack([np.arange(SAMPLES) * DT, *signals], axis=1)
    np.savetxt(folder / "log.csv", table, "%.17g", ",", header=",".join(["t", *columns]), comments="")


MAPPED = ["--map", "shoulder=q1", "--map", "el_bow=q2"]


def test_a_rig_from_a_model_and_a_log_runs_at_once(greygate, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    log(tmp_path, write(tmp_path), inputs(["m1", "m2"]))
    assert greygate("init-rig", "log.csv", "--model", "arm.xml", "--out", "arm", *MAPPED)[0] == 0
    rig = load("arm")
    assert (rig.predict, rig.inputs, rig.window) == (("shoulder", "el_bow"), ("m1", "m2"), None)
    assert {"damping_shoulder", "kp_m2"} <= {*rig.uncertain()}
    code, printed, _ = greygate("simulate", "arm", "arm/identify.csv", "--out", "sim.csv", "--json")
    assert code == 0
    assert all(e["rms"] < 1e-6 for e in json.loads(printed)["rms"].values())


def test_steps_that_err_by_more_than_the_noise_are_made_finer(greygate, tmp_path, monkeypatch):
    """Euler's steps of 5 ms are, for they err by half of that, but no log that was made in such steps."""
    monkeypatch.chdir(tmp_path)
    given, path = inputs(["m1", "m2"]), write(tmp_path)
    log(tmp_path, path, given)
    coarse = tmp_path / "coarse.xml"
    coarse.write_text(path.read_text().replace('timestep="0.001"', 'timestep="0.005"').replace('kp="2"', 'kp="1.9"'))
    for name in ("fine", "own"):
        words = ("init-rig", "log.csv", "--model", "coarse.xml", "--out", name, *MAPPED)
        assert greygate(*words)[0] == 0
        log(tmp_path, coarse, given)
    assert load("fine").plant.step < 0.005
    assert load("own").plant.step == 0.005


def test_a_run_that_loses_the_recording_begins_anew_in_windows(greygate, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = inputs(["m1", "m2"])
    log(tmp_path, write(tmp_path, damping=0.5), given)
    write(tmp_path, actuators=MOTORS.replace('kp="2"', 'kp="0.2"'))
    assert greygate("init-rig", "log.csv", "--model", "arm.xml", "--out", "arm", *MAPPED)[0] == 0
    assert load("arm").window == 45  # a tenth of what is explained


@pytest.mark.parametrize(
    ("columns", "more", "said"),
    [
        (("m1", "other", "q1", "q2"), MAPPED, "no column for m2; give --map m2=COLUMN, or columns torque_shoulder"),
        (("m1", "m2", "q1", "q2"), [], "no column is a state of arm; give --map for one of shoulder, el_bow"),
        (("m1", "m2", "q1", "q2"), ["--map", "knee=q1"], "arm has no such name; it has m1, m2, shoulder"),
        (("m1", "m2", "q1", "q2"), ["--map", "shoulder=q3"], "log.csv has no column q3; it has m1, m2, q1, q2"),
        (("m1", "m2", "q1 [m]", "q2"), ["--map", "shoulder=q1"], "q1 is in 'm', arm has shoulder in rad"),
    ],
)
def test_a_log_that_does_not_fit_the_model_is_refused_in_one_line(greygate, tmp_path, monkeypatch, columns, more, said):
    monkeypatch.chdir(tmp_path)
    log(tmp_path, write(tmp_path), inputs(["m1", "m2"]), columns)
    code, _, err = greygate("init-rig", "log.csv", "--model", "arm.xml", "--out", "arm", *more)
    assert code == 2
    assert said in err
    assert not (tmp_path / "arm").exists()


def test_names_that_meet_are_told_apart_and_numbered_ones_are_read(greygate, tmp_path, monkeypatch):
    """An actuator may have its joint's name; a reader of logs takes the number of joint_1 for a unit."""
    monkeypatch.chdir(tmp_path)
    motors = '<motor name="joint_1" joint="joint_1"/><motor joint="el-bow"/>'
    path = write(tmp_path, actuators=motors)
    path.write_text(path.read_text().replace('"shoulder"', '"joint_1"'))
    assert list(mjcf.read(path, []).inputs) == ["actuator_joint_1", "actuator2"]
    log(tmp_path, path, inputs(["u", "w"]), ("u", "w", "joint_1", "el_bow"))
    words = ["--map", "actuator_joint_1=u", "--map", "actuator2=w"]
    assert greygate("init-rig", "log.csv", "--model", "arm.xml", "--out", "arm", *words)[0] == 0
    assert load("arm").predict == ("joint_1", "el_bow")


URDF = """<robot name="arm">
  <link name="base"/>
  <link name="upper">
    <visual><geometry><mesh filename="package://arm/meshes/none.dae"/></geometry></visual>
    <collision><geometry><mesh filename="package://arm/meshes/upper.dae"/></geometry></collision>
    <inertial><origin xyz="0 0 -0.2"/><mass value="0.5"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <dynamics damping="0.05" friction="0.02"/></joint>
</robot>
"""


def test_a_urdf_moves_under_the_torques_of_a_log(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    assert "mesh" not in mjcf.bundle(path)["arm.urdf"].decode()
    plant = mjcf.read(path, ["torque_shoulder"])
    assert plant.parameters["frictionloss_shoulder"].value == 0.02
    given = {"torque_shoulder": np.full(SAMPLES, 0.3)}
    found = simulate(plant, given, sample_time=DT, step=DT / 2)["shoulder"]
    assert found[-1] == pytest.approx(np.arcsin(0.3 / (0.5 * 9.81 * 0.2)), abs=0.05)


def test_what_mujoco_warns_of_leaves_no_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "arm.urdf"
    limited = '<limit lower="1" upper="1" effort="1" velocity="1"/>'
    path.write_text(URDF.replace("continuous", "revolute").replace("<dynamics", f"{limited}<dynamics"))
    mjcf.read(path, [])
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def said(rig, effects, parameters):
    """A diagnosis.json of the rig."""
    return {
        "schema": next(iter(READ)), "plant": rig.plant.name, "effects": effects,
        "parameters": {s: {"value": v} for s, v in parameters.items()},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("symbol", "value"),
    [
        ("mass_lower", 0.5),
        ("frictionloss_el_bow", 0.05),
        ("kp_m2", 1.5),
        ("inertia_upper", 0.006),
        ("ipos_z_lower", -0.12),
        ("damping_shoulder", 0.1),
        ("payload_lower", 0.2),
        ("gravity_x", 0.5),
    ],
)
def test_a_corrected_model_loads_and_moves_as_the_corrected_simulation(greygate, tmp_path, monkeypatch, symbol, value):
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path)
    log(tmp_path, path, inputs(["m1", "m2"]))
    assert greygate("init-rig", "log.csv", "--model", "arm.xml", "--out", "arm", *MAPPED)[0] == 0
    rig = load("arm")
    (tmp_path / "d.json").write_text(json.dumps(said(rig, [], {symbol: value})))
    assert greygate("export", "mjcf", "arm", "--out", "new.xml", "--diagnosis", "d.json")[0] == 0
    assert not (tmp_path / "new.py").exists()
    assert greygate("simulate", "arm", "arm/identify.csv", "--diagnosis", "d.json", "--out", "sim.csv")[0] == 0
    found = np.genfromtxt("sim.csv", delimiter=",", names=True)
    wanted = stepped(tmp_path / "new.xml", inputs(["m1", "m2"]))[: len(found)]
    assert np.abs(wanted - stepped(path, inputs(["m1", "m2"]))[: len(found)]).max() > 1e-3
    assert np.abs(found["el_bow"] - wanted[:, 1]).max() < 1e-6 * np.ptp(wanted[:, 1])


def test_a_corrected_model_has_the_step_of_its_rig(greygate, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path)
    log(tmp_path, path, inputs(["m1", "m2"]))
    assert greygate("init-rig", "log.csv", "--model", "arm.xml", "--out", "arm", *MAPPED)[0] == 0
    rig = load("arm")
    text = (tmp_path / "arm" / "rig.toml").read_text()
    fine = rig.plant.step / 4
    (tmp_path / "arm" / "rig.toml").write_text(text.replace("predict =", f"step_s = {fine!r}\npredict =", 1))
    (tmp_path / "d.json").write_text(json.dumps(said(rig, [], {})))
    assert greygate("export", "mjcf", "arm", "--out", "new.xml", "--diagnosis", "d.json")[0] == 0
    assert mujoco.MjModel.from_xml_path("new.xml").opt.timestep == pytest.approx(fine, rel=1e-12)


def test_a_body_of_a_urdf_is_corrected_along_its_own_axes(tmp_path):
    path = tmp_path / "arm.urdf"
    inertia = '<inertia ixx="0.002" ixy="0.0003" ixz="0" iyy="0.003" iyz="0" izz="0.004"/>'
    path.write_text(re.sub(r"<inertia [^>]*/>", inertia, URDF))
    path.write_bytes(mjcf.bundle(path)["arm.urdf"])  # as a rig keeps it
    assert 'ixy="0.0003"' in path.read_text()
    plant = mjcf.read(path, ["torque_shoulder"])
    (symbol,) = (s for s in plant.parameters if s.startswith("inertia_"))
    value = 1.1 * plant.parameters[symbol].value
    new = mujoco.MjModel.from_xml_string(
        mjcf.corrected(plant, {s: p.value for s, p in plant.parameters.items()} | {symbol: value})
    )
    old = mjcf.load(path)
    b = int(np.argmax(old.body_inertia[:, 0]))
    np.testing.assert_allclose(new.body_inertia[b].max(), 1.1 * old.body_inertia[b].max(), rtol=1e-6)
    np.testing.assert_allclose(np.abs(new.body_iquat[b]), np.abs(old.body_iquat[b]), atol=1e-6)


@pytest.mark.parametrize(
    ("effect", "parameters", "term"),
    [
        ("square_damping_el_bow", {"c2_v_el_bow": 0.3}, "square_damping_el_bow.square_damping"),
        (  # with a state of its own
            "dry_friction_el_bow",
            {"f_v_el_bow": 0.2, "f_v_el_bow_yield": 0.02},
            "dry_friction_elastic_el_bow.dry_friction_elastic",
        ),
    ],
)
def test_what_mjcf_has_no_element_for_is_a_callback_that_moves_as_the_simulation(
    greygate, tmp_path, monkeypatch, effect, parameters, term
):
    monkeypatch.chdir(tmp_path)
    given = inputs(["m1", "m2"])
    log(tmp_path, write(tmp_path), given)
    assert greygate("init-rig", "log.csv", "--model", "arm.xml", "--out", "arm", *MAPPED)[0] == 0
    entry = {
        "id": effect,
        "form": term.partition(".")[0],
        "parameters": {s: {"value": v} for s, v in parameters.items()},
    }
    (tmp_path / "d.json").write_text(json.dumps(said(load("arm"), [entry], {})))
    code, printed, err = greygate("export", "mjcf", "arm", "--out", "new.xml", "--diagnosis", "d.json", "--json")
    assert code == 0, err
    assert [joint["left"] for joint in json.loads(printed)["joints"]] == [[], [term]]
    assert greygate("simulate", "arm", "arm/identify.csv", "--diagnosis", "d.json", "--out", "sim.csv")[0] == 0
    found = np.genfromtxt("sim.csv", delimiter=",", names=True)["el_bow"]
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "new", raising=False)
    new = importlib.import_module("new")

    try:
        wanted = stepped(tmp_path / "new.xml", given, loaded=new.install)[: len(found), 1]
        with pytest.raises(InputError, match="a callback"):
            load("arm").plant.outside.lent([], {}, 0.001).__enter__()
    finally:
        mujoco.set_mjcb_passive(None)
    plain = stepped(tmp_path / "arm.xml", given)[: len(found), 1]
    assert np.abs(wanted - plain).max() > 0.05
    assert np.abs(found - wanted).max() < 2e-3 * np.ptp(
        wanted
    )  # one takes the force where a step begins, one where it ends


def test_a_payload_is_a_point_mass_of_its_own_body(tmp_path):
    """Mass, center and moments of what moves together are those that MuJoCo makes of two bodies."""
    plant, given = mjcf.read(write(tmp_path), ["m1", "m2"]), inputs(["m1", "m2"])
    values = {"payload_lower": 0.3, "payload_x_lower": 0.04, "payload_y_lower": -0.03, "payload_z_lower": -0.1}
    parameters = plant.parameters | {s: replace(plant.parameters[s], value=v) for s, v in values.items()}
    found = simulate(replace(plant, parameters=parameters), given, sample_time=DT, step=plant.step)["el_bow"]
    path = tmp_path / "loaded.xml"
    load = '<body pos="0.04 -0.03 -0.25"><inertial pos="0 0 0" mass="0.3" diaginertia="1e-9 1e-9 1e-9"/></body>'
    path.write_text((tmp_path / "arm.xml").read_text().replace("</body>", f"{load}</body>", 1))
    wanted = stepped(path, given)[:, 1]
    assert np.abs(found - stepped(tmp_path / "arm.xml", given)[:, 1]).max() > 0.05
    assert np.abs(found - wanted).max() < 1e-6
    assert np.array_equal(simulate(plant, given, sample_time=DT, step=plant.step)["el_bow"],
                          stepped(tmp_path / "arm.xml", given)[:, 1])  # and back  # fmt: skip


def test_loads_and_a_tilted_base_are_offered_where_the_model_has_none(tmp_path):
    path = write(tmp_path)
    rig = record(tmp_path, path)
    known = general(rig, rig.to_explain())
    assert [f.symbol for f in known["payload"].free] == [
        "payload_lower", "payload_x_lower", "payload_y_lower", "payload_z_lower",
    ]  # fmt: skip
    assert [known[key].free[0].symbol for key in ("tilt_gravity_x", "tilt_gravity_y")] == ["gravity_x", "gravity_y"]
    assert {"ripple_shoulder", "ripple_el_bow"} <= {*known}
    assert known["gear_play"].terms.keys() == {"sensor_shoulder.gear_play"}  # the other's servo asks for speed


@pytest.mark.parametrize("bad", ["nan", "inf", "x"])
def test_what_is_no_number_in_the_middle_of_a_log_is_refused_in_one_line(greygate, tmp_path, monkeypatch, bad):
    monkeypatch.chdir(tmp_path)
    log(tmp_path, write(tmp_path), inputs(["m1", "m2"]))
    lines = (tmp_path / "log.csv").read_text().splitlines()
    lines[300] = ",".join([*lines[300].split(",")[:-1], bad])
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    code, _, err = greygate("init-rig", "log.csv", "--model", "arm.xml", "--out", "arm", *MAPPED)
    assert code == 2
    assert "q2" in err
    assert len(err.strip().splitlines()) == 1
    assert not (tmp_path / "arm").exists()


def test_mujocos_own_element_is_what_is_named_where_it_has_one(tmp_path):
    """Dry friction, damping and a spring have one name in a model: not frictionloss here and f_v there."""
    path = write(tmp_path, loss=0.0, damping=0.0)
    rig = record(tmp_path, path)
    known = general(rig, rig.to_explain())
    released = {key: [f.symbol for f in e.free] for key, e in known.items() if e.frees}
    frees = {key: symbols for key, symbols in released.items() if not key.startswith(("payload", "tilt"))}
    assert frees == {
        "dry_friction_shoulder": ["frictionloss_shoulder"], "dry_friction_el_bow": ["frictionloss_el_bow"],
        "viscous_friction_shoulder": ["damping_shoulder"], "viscous_friction_el_bow": ["damping_el_bow"],
        "spring_shoulder": ["stiffness_shoulder"], "spring_el_bow": ["stiffness_el_bow"],
    }  # fmt: skip
    assert known["dry_friction_shoulder"].free[0].unit == "N m"
    assert "sensor_offset_shoulder" in known  # its weight knows where it hangs
    rough = record(tmp_path, write(tmp_path))
    offered = fitting(rough.plant, rough.datasheet, general(rough, rough.to_explain()))
    assert "dry_friction_shoulder" not in offered  # it has some: the parameter is what is off
    assert "dry_friction_el_bow" in offered


def test_what_no_motion_tells_apart_is_not_released_and_the_rig_says_so(greygate, tmp_path, monkeypatch):
    """The motion of a pendulum knows inertia, weight, motor and damping only over one another: three numbers."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco><worldbody><body name="bob"><joint name="hinge" axis="0 1 0" damping="0.05"/>'
        '<geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03"/></body></worldbody>'
        '<actuator><motor name="m" joint="hinge" gear="3"/></actuator></mujoco>'
    )
    log(tmp_path, path, inputs(["m"]), ("m", "hinge"))
    assert greygate("init-rig", "log.csv", "--model", "arm.xml", "--out", "arm")[0] == 0
    assert len(load("arm").uncertain()) == 3
    (said,) = [
        line for line in (tmp_path / "arm" / "rig.toml").read_text().splitlines() if line.startswith("# mass_bob")
    ]
    assert "no motion of this log tells it from" in said


ADDED = """model = "arm.xml"
outputs = ["el_bow"]
[inputs]
goal = "rad"
[parameters]
gain = [0.8, "N m/rad"]
[definitions.controller]
drive = {{ unit = "N m", error = "gain * (goal - el_bow)" }}
[equations.{place}]
v_el_bow = {{ controller = "drive" }}
"""


def test_a_plants_file_adds_to_a_model_what_that_has_not(tmp_path):
    """A controller of the plant's file moves the arm as the same one of the model."""
    write(tmp_path, actuators='<position name="goal" joint="el-bow" kp="0.8"/>')
    given = inputs(["goal"])
    wanted = stepped(tmp_path / "arm.xml", given)[:, 1]
    write(tmp_path, actuators="")
    (tmp_path / "servo.toml").write_text(ADDED.format(place="motion_el_bow"))
    plant = kinds.read(tmp_path / "servo.toml", ["goal"])
    assert (plant.name, plant.outputs, plant.inputs) == ("servo", ("el_bow",), {"goal": "rad"})
    assert np.abs(simulate(plant, given, sample_time=DT, step=plant.step)["el_bow"] - wanted).max() < 1e-12
    (tmp_path / "servo.toml").write_text(ADDED.format(place="motion_knee"))
    with pytest.raises(InputError, match="motion_knee: is no balance of arm"):
        kinds.read(tmp_path / "servo.toml", ["goal"])
    with pytest.raises(InputError, match="only the plant of a rig may be one"):
        Plant.read(tmp_path / "servo.toml")


OFFERED = ("dry_friction_shoulder", "dry_friction_el_bow", "viscous_friction_el_bow")


@pytest.fixture
def dear(tmp_path, monkeypatch):
    """A function that gives the rig of what another arm did, and the effects; 4 stretches of its 600 are searched."""
    monkeypatch.setattr("greygate.mismatch.stretches.DEAR", 1)

    def recorded(act=lambda data: None, **other):
        write(tmp_path, loss=0.0)
        rig = record(tmp_path, write(tmp_path, "other.xml", **other), "damping_shoulder", act)
        rig = replace(rig, window=20)
        return rig, {key: e for key, e in general(rig, rig.to_explain()).items() if key in OFFERED}

    return recorded


def test_what_is_found_in_stretches_of_a_recording_is_fitted_to_all_of_it(dear):
    rig, effects = dear(loss=0.02)
    found = diagnose(rig, effects=effects)
    assert found.search.part.final.model.recording.samples == 240
    assert found.corrected.likelihood.model.recording.samples == SAMPLES
    assert found.as_dict()["searched"] == 0.4
    assert "searched      40% of the recording" in str(found)
    assert [e["id"] for e in found.as_dict()["effects"]] == ["dry_friction_shoulder"]
    assert abs(found.corrected.values["frictionloss_shoulder"] - 0.02) < 1e-3


@pytest.mark.parametrize(("torque", "overlooked"), [(0.0, True), (0.05, False)])
def test_what_acts_between_the_stretches_alone_is_not_overlooked(dear, torque, overlooked):
    def pushed(data):
        data.qfrc_applied[0] = torque if 1.25 < data.time < 1.75 else 0.0

    rig, effects = dear(pushed, loss=0.0)
    search = Search(rig, rig.to_explain(), effects)
    search.part = search.over(stretches(search))
    finding._searched(search, silent)
    assert (search.part is not search) == overlooked  # else all of the recording was searched in the end


def test_slopes_of_an_arm_in_finer_steps_are_those_of_longer_ones(tmp_path, monkeypatch):
    """Nearly, and so is where they lead a fit, whose runs are its own; it takes a part of the time."""
    write(tmp_path, loss=0.0)
    rig = record(tmp_path, write(tmp_path, "other.xml", loss=0.0), "damping_shoulder")
    rig = replace(rig, plant=replace(rig.plant, step=DT / 20))
    likelihood = Search(rig, rig.to_explain(), {}).final
    rough = likelihood.rough()
    assert likelihood.model.steps == 20
    assert rough.model.steps < 5
    given = likelihood.model.values, likelihood.nothing()
    errors, temper = likelihood.errors(*given), np.ones(2)
    unknown = [Unknown("damping_shoulder", 0.01, 0.01, np.inf, 0.0, 1.0)]
    longer = likelihood.slopes(unknown, *given, errors, temper)
    found = likelihood.fit(unknown)
    monkeypatch.setattr(Likelihood, "longer", lambda whole: [])
    exact = likelihood.slopes(unknown, *given, errors, temper)
    assert 0 < np.linalg.norm(exact - longer) < 0.05 * np.linalg.norm(exact)
    away = found.values["damping_shoulder"] - likelihood.fit(unknown).values["damping_shoulder"]
    assert abs(away) < 0.05 * found.deviation("damping_shoulder")


def test_steps_are_no_longer_than_the_effects_of_a_fit_bear(tmp_path):
    """An elastic friction shakes in steps that serve the arm without it."""
    write(tmp_path, loss=0.0)
    rig = record(tmp_path, write(tmp_path, "other.xml", loss=0.02), "damping_shoulder")
    rig = replace(rig, plant=replace(rig.plant, step=DT / 20))
    effects = {k: e for k, e in general(rig, rig.to_explain()).items() if k == "dry_friction_elastic_shoulder"}
    likelihood = Search(rig, rig.to_explain(), effects).final
    (effect,) = effects.values()
    size, room = (f.symbol for f in effect.free)
    steps = []
    for values in ({size: 0.0, room: 1e-3}, {size: 0.02, room: 1e-3}):
        given = {**likelihood.model.values, **effect.set, **values}, likelihood.nothing()
        of, gives, there = likelihood.roughly(*given, likelihood.errors(*given))
        assert np.array_equal(gives(*given), there)
        steps.append(of.model.steps)
    assert steps[0] == likelihood.rough().model.steps < steps[1]


ADDING = (
    "dry_friction_static",
    "ripple",
    "place_friction",
    "input_delay",
    "input_dead_zone",
    "sensor_gain",
    "lost_samples",
)


@pytest.fixture
def adding(tmp_path):
    """The search among effects that only add to an arm, in windows of 0.1 s; its elbow has dry friction."""
    write(tmp_path, loss=0.0)
    rig = replace(record(tmp_path, write(tmp_path, "other.xml", loss=0.02), "damping_shoulder"), window=20)
    found = {k: e for k, e in general(rig, rig.to_explain()).items() if k.startswith(ADDING)}
    return Search(rig, rig.to_explain(), found)


def test_what_effects_do_to_an_arm_is_told_by_a_linear_step_a_sample(adding, monkeypatch):
    """As by simulating each of them, in a fraction of the runs."""
    fit, runs = adding.base(adding.screen), []
    ran = Restarted.run
    monkeypatch.setattr(Restarted, "run", lambda *given: runs.append(1) or ran(*given))

    def columns():
        return {
            (key, i): column
            for key, effect in adding.effects.items()
            for i, (*_, column) in enumerate(adding.directions(fit, effect))
        }

    told, few = columns(), len(runs)
    monkeypatch.setattr(Model, "answering", lambda *given: None)
    simulated = columns()
    assert {key for key, _ in told} == adding.effects.keys()
    assert few < 0.3 * (len(runs) - few)
    off = {key: np.linalg.norm(told[key] - one) / (np.linalg.norm(one) + TINY) for key, one in simulated.items()}
    assert max(off.values()) < 0.15
    assert np.median([*off.values()]) < 0.02


def test_what_an_arm_cannot_show_is_told_by_it_too(adding, monkeypatch):
    fit = adding.base(adding.screen)
    one = next(effect for key, effect in adding.effects.items() if key.startswith("place_friction"))
    slight = replace(one, key="slight", of="", free=tuple(replace(f, typical=1e-9 * f.typical) for f in one.free))
    effects = [*adding.effects.values(), slight]
    told = unseen(fit, effects)
    assert "slight" in told
    assert one.id not in told
    monkeypatch.setattr(Model, "answering", lambda *given: None)
    assert unseen(fit, effects) == told


@pytest.mark.parametrize(("noise", "steps"), [(1e-2, 1), (1e-7, 20)])
def test_the_screen_takes_the_longest_steps_that_err_by_less_than_the_noise(adding, noise, steps):
    rig = adding.rig
    channels = {n: replace(c, noise=noise) if n in rig.predict else c for n, c in rig.channels.items()}
    rig = replace(rig, plant=replace(rig.plant, step=DT / 20), channels=channels)
    search = Search(rig, rig.to_explain(), adding.effects)
    assert search.final.model.steps == 20
    assert search.screen.model.steps == steps
