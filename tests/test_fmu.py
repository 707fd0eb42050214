"""An FMU as a plant: it moves as fmpy moves it, runs for those who trust it alone, and harms nobody when it breaks."""

import json
import zipfile
from dataclasses import replace
from pathlib import Path

import fmus
import numpy as np
import pytest
from command_line import greygate
from test_export import Slave

from greygate.errors import InputError
from greygate.plants import fmu, kinds
from greygate.plants.fmu import archive, trust, unit
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording
from greygate.plants.simulator import simulate

fmpy = pytest.importorskip("fmpy")

DT = 0.01
VERSIONS = ["2.0", "3.0"]
BALL = fmus.Made(
    states={"h": (1.0, "m"), "v": (0.0, "m/s")},
    rates={"h": "q_v", "v": "-q_g"},
    parameters={"g": (9.81, "m/s2"), "e": (0.7, "1")},
    indicators=1,
    code={
        "INDICATE": "m->z[0] = q_h;",
        "EVENT": "if (q_h <= 0.0 && q_v < 0.0) { q_h = 0.0; q_v = -q_e * q_v; m->changed = 1; }",
    },
)
STAIR = fmus.Made(
    states={},
    rates={},
    outputs={"count": ("1", "q_count")},
    code={"NEXT": "0.25", "EVENT": "if (m->t >= m->next) { q_count += 1.0; m->next += 0.25; }"},
)
OSCILLATOR = fmus.Made(
    states={"x": (2.0, ""), "y": (0.0, "")},
    rates={"x": "q_y", "y": "q_mu * ((1.0 - q_x * q_x) * q_y) - q_x"},
    parameters={"mu": (1.0, "")},
)
DECAY = fmus.Made(states={"x": (1.0, "K")}, rates={"x": "-q_k * q_x"}, parameters={"k": (0.7, "1/s")})
DRIVEN = replace(DECAY, rates={"x": "sin(3.0 * m->t) - q_k * q_x"})
THROUGH = fmus.Made(states={}, rates={}, inputs={"u": "V"}, outputs={"y": ("V", "2.0 * q_u")})


@pytest.fixture(scope="module", autouse=True)
def own_store(tmp_path_factory):
    """What these tests trust is trusted here alone."""
    folder = tmp_path_factory.mktemp("trusted")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trust, "_place", lambda digest: folder / digest)
        yield


def trusted(path: Path) -> Path:
    kinds.trust(path)
    return path


def written(folder, made=fmus.PRESS, version="2.0", kind="ModelExchange", name="press.fmu", **more):
    return trusted(fmus.write(folder / name, made, version, kind, **more))


def plant_of(path: Path, *recorded: str) -> Plant:
    return fmu.read(path, dict.fromkeys(recorded, "1"))


def pushes(samples, size=10.0):
    return np.repeat(np.random.default_rng(1).uniform(-size, size, samples // 25 + 1), 25)[:samples]


def by_fmpy(path, names, samples, inputs=None, **parameters):
    """What fmpy's own run gives (samples, names); inputs jump where a sample begins."""
    clock, given = np.arange(samples) * DT, None
    if inputs is not None:
        rows = [(0.0, inputs[0])]
        for k in np.flatnonzero(np.diff(inputs)) + 1:
            rows += [(clock[k], inputs[k - 1]), (clock[k], inputs[k])]
        rows.append((clock[-1] + DT, inputs[-1]))
        given = np.array(rows, dtype=[("time", float), ("force", float)])
    found = fmpy.simulate_fmu(
        str(path), stop_time=clock[-1], output_interval=DT, input=given, output=names, start_values=parameters,
        solver="CVode", relative_tolerance=1e-10, fmi_type="ModelExchange",
    )  # fmt: skip
    at = [np.flatnonzero(np.abs(found["time"] - t) < 1e-9)[-1] for t in clock]  # after what jumps there
    return np.stack([found[n][at] for n in names], axis=1)


@pytest.mark.parametrize("version", VERSIONS)
def test_an_fmu_moves_as_fmpy_moves_it(tmp_path, version):
    path, samples = written(tmp_path, version=version), 400
    plant, force = plant_of(path, "force", "x", "load"), pushes(400)
    assert {s: p.unit for s, p in plant.parameters.items()} == {"mass": "kg", "damping": "N s/m", "stiffness": "N/m"}
    for values in ({}, {"mass": 3.0, "damping": 1.0}):
        found = simulate(plant.with_parameters(**values), {"force": force}, sample_time=DT, step=DT / 4)
        wanted = by_fmpy(path, ["x", "v", "load"], samples, force, **values)
        off = np.stack([found[s] for s in ("x", "v", "load")], axis=1) - wanted
        assert (np.abs(off).max(axis=0) < 1e-6 * np.ptp(wanted, axis=0)).all(), np.abs(off).max(axis=0)


@pytest.mark.parametrize("version", VERSIONS)
def test_positions_are_found_by_what_the_fmu_computes(tmp_path, version):
    plant = plant_of(written(tmp_path, version=version), "force", "position")
    assert (plant.states["position"].rate, plant.states["v"].unit) == ("v", "m/s")
    assert plant.equations["motion_v"].terms == {}
    half = replace(fmus.PRESS, rates={**fmus.PRESS.rates, "x": "q_ratio * q_v"},
                   parameters={**fmus.PRESS.parameters, "ratio": (1.0, "1")})  # fmt: skip
    other = plant_of(written(tmp_path, half, version, name="half.fmu"), "force", "x")
    assert other.states["x"].rate is None  # with another ratio it is no rate of that


@pytest.mark.parametrize("version", VERSIONS)
def test_what_an_effect_adds_to_a_rate_is_as_if_the_fmu_had_it(tmp_path, version):
    oil = replace(fmus.PRESS, rates={**fmus.PRESS.rates, "v": f"{fmus.PRESS.rates['v']} - 0.8 * tanh(q_v / 0.02)"})
    force = pushes(400)
    plain = plant_of(written(tmp_path, version=version), "force", "x")
    rough = plain.with_term("motion_v", "dry", "-0.8 * tanh(v / 0.02)")
    found = simulate(rough, {"force": force}, sample_time=DT, step=DT / 10)["x"]
    wanted = simulate(plant_of(written(tmp_path, oil, version, name="oil.fmu"), "force", "x"), {"force": force},
                      sample_time=DT, step=DT / 10)["x"]  # fmt: skip
    assert np.abs(found - wanted).max() < 1e-12
    assert np.abs(found - simulate(plain, {"force": force}, sample_time=DT, step=DT / 10)["x"]).max() > 0.01


@pytest.mark.parametrize("version", VERSIONS)
def test_a_ball_bounces_where_it_meets_the_ground(tmp_path, version):
    path, samples = written(tmp_path, BALL, version, name="ball.fmu"), 200
    found = simulate(plant_of(path), {}, sample_time=DT, step=DT, samples=samples)["h"]
    t, speed, begun, wanted = np.arange(samples) * DT, 0.0, 0.0, []
    fall = np.sqrt(2.0 / 9.81)
    bounces = [(0.0, 1.0, 0.0)]
    begun, speed = fall, 0.7 * 9.81 * fall
    while begun < t[-1]:
        bounces.append((begun, 0.0, speed))
        begun, speed = begun + 2 * speed / 9.81, 0.7 * speed
    for instant in t:
        begun, height, speed = max((b for b in bounces if b[0] <= instant), key=lambda b: b[0])
        wanted.append(height + speed * (instant - begun) - 9.81 / 2 * (instant - begun) ** 2)
    assert len(bounces) == 5
    assert np.abs(found - wanted).max() < 1e-9


@pytest.mark.parametrize("version", VERSIONS)
def test_events_at_told_times_are_kept(tmp_path, version):
    path = written(tmp_path, STAIR, version, name="stair.fmu")
    found = simulate(plant_of(path, "count"), {}, sample_time=0.1, step=0.1, samples=11)["count"]
    assert found.tolist() == [0, 0, 0, 1, 1, 2, 2, 2, 3, 3, 4]


@pytest.mark.parametrize("made", [OSCILLATOR, DECAY, DRIVEN])
def test_an_fmu_without_inputs_moves_as_fmpy_moves_it(tmp_path, made):
    path = written(tmp_path, made, name="free.fmu")
    found = simulate(plant_of(path), {}, sample_time=DT, step=DT, samples=300)
    wanted = by_fmpy(path, [*made.states], 300)
    off = np.stack([found[s] for s in made.states], axis=1) - wanted
    assert np.abs(off).max() < 1e-6


@pytest.mark.parametrize("version", VERSIONS)
def test_an_output_without_a_state_follows_its_input_at_once(tmp_path, version):
    plant, u = plant_of(written(tmp_path, THROUGH, version, name="through.fmu"), "u", "y"), pushes(50)
    assert np.array_equal(simulate(plant, {"u": u}, sample_time=DT, step=DT)["y"], 2.0 * u)


def test_units_of_the_fmu_become_those_of_a_log(tmp_path):
    """What the reader of a log converts to SI, the plant has in SI: degrees, and not bar."""
    made = fmus.Made(
        states={"angle": (90.0, "deg"), "speed": (0.0, "deg/s")},
        rates={"angle": "q_speed", "speed": "q_gain * q_p - q_back * q_angle"},
        inputs={"p": "bar"},
        parameters={"gain": (10.0, "deg/(s2.bar)"), "back": (4.0, "1/s2")},
    )
    plant = plant_of(written(tmp_path, made, name="lever.fmu"), "p", "angle")
    assert (plant.inputs, plant.unit("angle"), plant.unit("speed")) == ({"p": "bar"}, "rad", "rad/s")
    assert plant.states["angle"].rate == "speed"
    assert plant.initial()["angle"] == pytest.approx(np.pi / 2, rel=1e-12)
    found = simulate(plant, {"p": np.full(200, 3.0)}, sample_time=DT, step=DT / 4)["angle"]
    t = np.arange(200) * DT
    wanted = np.deg2rad(7.5 + 82.5 * np.cos(2.0 * t))
    assert np.abs(found - wanted).max() < 1e-6


def test_a_step_is_short_beside_the_fastest_motion(tmp_path):
    made = fmus.Made(states={"a": (1.0, ""), "b": (1.0, "")}, rates={"a": "-400.0 * q_a", "b": "q_a - q_b"})
    plain = plant_of(written(tmp_path, made, name="plain.fmu"))
    assert plain.step == pytest.approx(0.5 / 400.0, rel=1e-6)
    told = replace(made, attributes={"providesDirectionalDerivative": "true"})
    assert plant_of(written(tmp_path, told, name="told.fmu")).step == pytest.approx(0.5 / 400.0, rel=1e-12)


def test_a_parameter_is_unsure_no_further_than_its_values_go(tmp_path):
    made = replace(fmus.PRESS, bounds={"mass": {"min": "1.0", "max": "2.1"}, "damping": {"min": "3.0"}})
    plant = plant_of(written(tmp_path, made), "force", "x")
    found = {s: p.tolerance for s, p in plant.parameters.items()}
    assert found == pytest.approx({"mass": 0.05, "damping": 0.0, "stiffness": 0.2})


def test_what_depends_on_time_has_no_second_beginning(tmp_path):
    path = written(tmp_path, DRIVEN, name="press.fmu")
    x = simulate(plant_of(path), {}, sample_time=DT, step=DT, samples=400)["x"]
    Recording(DT, {"x": x + 1e-4 * np.random.default_rng(0).standard_normal(400)}, {"x": "K"}).write_csv(
        tmp_path / "log.csv"
    )
    rig, out = started(tmp_path)
    assert "holdout" not in out
    code, _, told = greygate("simulate", rig, rig / "identify.csv", "--out", tmp_path / "out.csv")
    assert code == 0, told
    assert np.abs(np.genfromtxt(tmp_path / "out.csv", delimiter=",", names=True)["x"] - x).max() < 1e-3


# -- from a log to a name --------------------------------------------------------------------------------------------


def recorded(folder, made, effect="", samples=1000, late=0, gain=1.0, path=None, **true):
    """log.csv of the FMU's machine with something more; a tenth of a millimetre of noise."""
    plant = plant_of(path or folder / "press.fmu", "force", "position")
    if effect:
        plant = plant.with_term("motion_v", "more", effect)
    force = pushes(samples)
    acting = gain * np.concatenate([np.full(late, force[0]), force[: samples - late]])
    step = plant.step if plant.outside.steps else DT / 20  # an FMU's own steps are part of what it computes
    x = simulate(plant.with_parameters(**true), {"force": acting}, sample_time=DT, step=step)["position"]
    x = x + 1e-4 * np.random.default_rng(3).standard_normal(samples)
    units = {"force": "N", "position": "m"}
    Recording(DT, {"force": force, "position": x}, units).write_csv(folder / "log.csv")


def started(folder, *more):
    code, out, told = greygate("init-rig", folder / "log.csv", "--model", folder / "press.fmu", "--out", folder / "rig",
                               *more, "--trust")  # fmt: skip
    assert code == 0, told
    return folder / "rig", out


@pytest.mark.parametrize("version", [VERSIONS[0], *(pytest.param(v, marks=pytest.mark.nightly) for v in VERSIONS[1:])])
def test_dry_friction_that_an_fmu_lacks_is_named(tmp_path, version):
    written(tmp_path, version=version)
    recorded(tmp_path, fmus.PRESS, "-0.8 * tanh(v / 0.005)", stiffness=52.0)
    rig, out = started(tmp_path)
    assert "press.fmu" in out
    assert 'trust = "' in (rig / "rig.toml").read_text()
    found = diagnosed(rig)
    assert [e["id"] for e in found["effects"]] == ["dry_friction"]
    low, high = found["effects"][0]["parameters"]["f_v"]["ci95"]
    assert low < 0.8 < high
    low, high = found["parameters"]["stiffness"]["ci95"]
    assert low < 52.0 < high
    words = "--diagnosis", tmp_path / "d.json", "--out"
    assert greygate("simulate", rig, rig / "identify.csv", *words, tmp_path / "out.csv")[0] == 0
    for newer in VERSIONS:  # the corrected plant as an FMU, which has the first one in it
        path = tmp_path / f"corrected{newer[0]}.fmu"
        code, _, told = greygate("export", "fmu", rig, *words, path, "--fmi", newer)
        assert code == 0, told
        for problem in ("modelica", "latex", "mjcf"):
            code, _, told = greygate("export", problem, rig, *words, tmp_path / "none")
            assert (code, told.count("\n")) == (2, 1)
        slave = Slave(path, tmp_path / f"unpacked{newer[0]}").begin()
        given, wanted = (
            np.genfromtxt(p, delimiter=",", names=True) for p in (rig / "identify.csv", tmp_path / "out.csv")
        )
        got = []
        for force in given["force"][:200]:
            slave.set({"force": force})
            got += slave.get(["position"])
            slave.step(DT)
        assert np.abs(np.array(got) - wanted["position"][:200]).max() < 1e-9


def diagnosed(rig):
    code, out, told = greygate("diagnose", rig, "--json", "--out", rig.parent / "d.json")
    assert code == 0, told
    return json.loads(out)


def test_parameters_that_an_export_is_given_reach_the_inner_fmu(tmp_path):
    written(tmp_path)
    recorded(tmp_path, fmus.PRESS, samples=200)
    rig, _ = started(tmp_path)
    assert greygate("export", "fmu", rig, "--out", tmp_path / "same.fmu")[0] == 0
    plant, force = plant_of(tmp_path / "press.fmu", "force", "position"), pushes(100)
    slave = Slave(tmp_path / "same.fmu", tmp_path / "unpacked").begin(mass=3.0)
    got = []
    for push in force:
        slave.set({"force": push})
        got.append(slave.get(["position", "v"]))
        slave.step(DT)
    found = simulate(plant.with_parameters(mass=3.0), {"force": force}, sample_time=DT, step=DT / 10)
    assert np.abs(np.array(got) - np.stack([found["position"], found["v"]], axis=1)).max() < 1e-12


def test_an_fmu_with_events_is_not_wrapped(tmp_path):
    path = written(tmp_path, BALL, name="press.fmu")
    h = simulate(plant_of(path), {}, sample_time=DT, step=DT, samples=200)["h"]
    Recording(DT, {"h": h}, {"h": "m"}).write_csv(tmp_path / "log.csv")
    rig, _ = started(tmp_path)
    code, _, told = greygate("export", "fmu", rig, "--out", tmp_path / "ball.fmu")
    assert (code, told.count("\n")) == (2, 1)
    assert "its FMU has events, or steps itself" in told


# -- co-simulation ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
def test_an_fmu_for_co_simulation_moves_as_fmpy_moves_it(tmp_path, version):
    path, force = written(tmp_path, version=version, kind="CoSimulation"), pushes(100)
    plant = plant_of(path, "force", "position", "load")
    assert [*plant.states] == ["position", "load"]
    found = simulate(plant.with_parameters(mass=3.0), {"force": force}, sample_time=DT, step=DT)
    slave = Slave(path, tmp_path / "unpacked").begin(mass=3.0)
    for k, push in enumerate(force):
        slave.set({"force": push})
        assert slave.get(["position", "load"]) == [found["position"][k], found["load"][k]]
        slave.step(DT)


@pytest.mark.nightly
@pytest.mark.parametrize(("late", "gain", "name"), [(5, 1.0, "input_delay"), (0, 1.0, "")])
def test_what_precedes_an_fmu_for_co_simulation_is_named(tmp_path, late, gain, name):
    written(tmp_path, kind="CoSimulation")
    recorded(tmp_path, fmus.PRESS, late=late, gain=gain, damping=3.3)
    rig, _ = started(tmp_path)
    found = diagnosed(rig)
    assert [e["id"] for e in found["effects"]] == ([name] if name else [])
    low, high = found["parameters"]["damping"]["ci95"]
    assert low < 3.3 < high


def test_an_fmu_runs_for_those_who_trust_it_alone(tmp_path):
    path = fmus.write(tmp_path / "press.fmu", replace(fmus.PRESS, bounds={"mass": {"max": "7"}}))
    with pytest.raises(InputError, match=r"an FMU is a program .* give --trust"):
        plant_of(path)
    trusted(path)
    recorded(tmp_path, fmus.PRESS, path=path)
    rig, _ = started(tmp_path)
    fmus.write(rig / "press.fmu", replace(fmus.PRESS, bounds={"mass": {"max": "8"}}))  # another program
    words = "simulate", rig, rig / "identify.csv", "--out", tmp_path / "out.csv"
    for more in ((), ("--trust",)):
        code, out, told = greygate(*words, *more)
        assert (code, out, told.count("\n")) == (2, "", 1)
        assert "is another program than it says" in told
    sheet = (rig / "rig.toml").read_text()
    (rig / "rig.toml").write_text(sheet.replace(fmu.digest(path), fmu.digest(rig / "press.fmu")))
    code, _, told = greygate(*words)  # whoever sends a rig may have written that
    assert (code, told.count("\n")) == (2, 1)
    assert "give --trust" in told
    assert greygate(*words, "--trust")[0] == 0
    assert greygate(*words)[0] == 0


# -- FMUs that break -------------------------------------------------------------------------------------------------


def refused(folder, *more, path="press.fmu", trust=True):
    """The one line that init-rig says."""
    if not (folder / "log.csv").exists():
        t = np.arange(100) * DT
        units = {"force": "N", "position": "m"}
        Recording(DT, {"force": np.sin(t), "position": t}, units).write_csv(folder / "log.csv")
    words = ["init-rig", folder / "log.csv", "--model", folder / path, "--out", folder / "rig", *more]
    code, out, told = greygate(*words, *(["--trust"] if trust else []))
    assert (code, out, told.count("\n")) == (2, "", 1), told
    assert not (folder / "rig").exists()
    return told


@pytest.mark.parametrize("version", VERSIONS)
def test_an_fmu_without_a_license_is_quoted(tmp_path, version):
    fmus.write(tmp_path / "press.fmu", replace(fmus.PRESS, code={"LICENSE": "1"}), version)
    assert "makes no instance (no license" in refused(tmp_path)


@pytest.mark.parametrize(("place", "what"), [("INITIAL", "when it begins"), ("CRASH", "when it begins")])
def test_an_fmu_that_crashes_is_said(tmp_path, place, what):
    fmus.write(tmp_path / "press.fmu", replace(fmus.PRESS, code={place: "abort();"}))
    assert f"crashes (signal 6) {what}" in refused(tmp_path)


def test_an_fmu_that_ends_its_process_is_said(tmp_path):
    fmus.write(tmp_path / "press.fmu", replace(fmus.PRESS, code={"INITIAL": "exit(7);"}))
    assert "ends its process (exit code 7) when it begins" in refused(tmp_path)


def test_an_fmu_that_hangs_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(unit, "OPENING", 3.0)
    fmus.write(tmp_path / "press.fmu", replace(fmus.PRESS, code={"INITIAL": "for (;;) { m->t += 1.0; }"}))
    assert "does not answer within 3 s when it begins" in refused(tmp_path)


def test_an_fmu_that_crashes_in_a_run_is_said_and_in_a_trial_gone_on_from(tmp_path):
    path = written(tmp_path, replace(fmus.PRESS, code={"CRASH": "if (m->t > 1.5) abort();"}))
    force = pushes(200)
    with pytest.raises(InputError, match=r"crashes \(signal 6\) while it is simulated"):
        simulate(plant_of(path, "force"), {"force": force}, sample_time=DT, step=DT)
    path = written(tmp_path, replace(fmus.PRESS, code={"CRASH": "if (q_mass < 0.0) abort();"}), name="mass.fmu")
    plant = plant_of(path, "force")
    assert np.isfinite(simulate(plant, {"force": force}, sample_time=DT, step=DT)["x"]).all()
    with pytest.raises(InputError, match="not finite at 0 s"):
        simulate(plant.with_parameters(mass=-1.0), {"force": force}, sample_time=DT, step=DT)
    assert np.isfinite(simulate(plant, {"force": force}, sample_time=DT, step=DT)["x"]).all()


def test_values_that_an_fmu_refuses_are_a_run_that_fails(tmp_path):
    path = written(tmp_path, replace(fmus.PRESS, code={"REFUSE": "if (q_mass < 0.0) return 3;"}))
    plant, force = plant_of(path, "force"), pushes(100)
    simulate(plant, {"force": force}, sample_time=DT, step=DT)
    with pytest.raises(InputError, match="not finite at 0 s"):
        simulate(plant.with_parameters(mass=-1.0), {"force": force}, sample_time=DT, step=DT)


def test_what_an_fmu_logs_when_it_fails_is_told(tmp_path, capfd):
    made = replace(fmus.PRESS, code={"CRASH": 'if (m->t > 1.5) { say(m, "the seal is torn"); return 3; }'})
    with pytest.raises(InputError, match=r"not finite at 1\.5\d* s"):
        simulate(plant_of(written(tmp_path, made), "force"), {"force": pushes(200)}, sample_time=DT, step=DT)
    assert "it says 'the seal is torn'" in capfd.readouterr().err


def test_what_is_no_fmu_is_refused(tmp_path):
    (tmp_path / "press.fmu").write_bytes(b"PK nothing")
    assert "is no FMU" in refused(tmp_path)
    with zipfile.ZipFile(tmp_path / "press.fmu", "w") as made:
        made.writestr("other.xml", "<a/>")
    assert "is no FMU" in refused(tmp_path)
    with zipfile.ZipFile(tmp_path / "press.fmu", "w") as made:
        made.writestr("modelDescription.xml", '<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>')
    assert "<!DOCTYPE or <!ENTITY" in refused(tmp_path)
    assert "cannot be read" in refused(tmp_path, path="none.fmu")


def test_an_fmu_for_another_computer_is_said(tmp_path):
    fmus.write(tmp_path / "press.fmu", fmus.PRESS, place="win64")
    assert "has programs for win64, none for linux64" in refused(tmp_path)


def test_an_fmu_that_needs_its_tool_is_said(tmp_path):
    fmus.write(tmp_path / "press.fmu", replace(fmus.PRESS, attributes={"needsExecutionTool": "true"}))
    assert "needs the tool that made it" in refused(tmp_path)


@pytest.mark.parametrize("name", ["../stolen.txt", "/tmp/stolen.txt", "a/../../stolen.txt", "C:/stolen.txt"])
def test_no_file_of_an_archive_is_written_elsewhere(tmp_path, name):
    fmus.write(tmp_path / "press.fmu", fmus.PRESS)
    with zipfile.ZipFile(tmp_path / "press.fmu", "a") as made:
        made.writestr(name, "stolen")
    assert "a file outside of it" in refused(tmp_path)


def test_an_archive_that_unpacks_to_too_much_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(archive, "UNPACKED", 1 << 10)
    fmus.write(tmp_path / "press.fmu", fmus.PRESS)
    assert "unpacks to more than" in refused(tmp_path)


def test_a_log_with_other_columns_or_a_gap_is_said(tmp_path):
    written(tmp_path)
    t = np.arange(100) * DT
    Recording(DT, {"push": np.sin(t), "x": t}, {"push": "N", "x": "m"}).write_csv(tmp_path / "log.csv")
    assert "no column for force; give --map force=COLUMN" in refused(tmp_path)
    Recording(DT, {"force": np.sin(t), "y": t}, {"force": "N", "y": "m"}).write_csv(tmp_path / "log.csv")
    assert "no column is a state of press" in refused(tmp_path)
    text = "t,force_N,position_m\n" + "".join(f"{k / 100},{k % 7},{'nan' if k == 50 else k}\n" for k in range(100))
    (tmp_path / "log.csv").write_text(text)
    assert "log.csv" in refused(tmp_path)


def test_events_that_nobody_records_forbid_windows(tmp_path):
    path = written(tmp_path, BALL, name="press.fmu")
    plant = plant_of(path)
    assert plant.whole
    h = simulate(plant, {}, sample_time=DT, step=DT, samples=200)["h"]
    Recording(DT, {"h": h}, {"h": "m"}).write_csv(tmp_path / "log.csv")
    rig, _ = started(tmp_path)
    sheet = (rig / "rig.toml").read_text()
    assert "window_s" not in sheet
    assert not (rig / "holdout.csv").exists()
    (rig / "rig.toml").write_text(sheet.replace("predict =", "window_s = 0.5\npredict ="))
    code, _, told = greygate("simulate", rig, rig / "identify.csv", "--out", tmp_path / "out.csv")
    assert (code, told.count("\n")) == (2, 1)
    assert "cannot begin anew within a recording; leave window_s out" in told
