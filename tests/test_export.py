"""What leaves for other tools computes what the emulator and the simulation compute."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import fmpy
import numpy as np
import pytest
from command_line import greygate
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from small_plants import motor

from greygate.emulator.emulation import emulate
from greygate.errors import InputError
from greygate.export.export import export_c, export_fmu
from greygate.hardware.build import Project
from greygate.hardware.verify import simulator_environment
from greygate.machines.source import Source
from greygate.mismatch import rig as rigs
from greygate.mismatch.simulation import read
from greygate.mismatch.simulation import simulate as predicted
from greygate.plants.plant import Plant
from greygate.plants.simulator import simulate
from greygate.project import compile_project

VERSIONS = ["3.0", "2.0"]


@pytest.fixture(scope="module")
def build(tmp_path_factory):
    """A network of two inputs' worth of history: B2, one input, one output."""
    folder = tmp_path_factory.mktemp("build") / "b2"
    compile_project(Source("b2", {}), folder, architectures=("c99",))
    return Project.open(folder)


def inputs(project, steps=400, beyond=1.5):
    """Values that reach beyond the formats."""
    rng = np.random.default_rng(7)
    return {
        p.name: p.offset + beyond * p.scale * p.signal.fix.hi * p.signal.fix.lsb * rng.uniform(-1, 1, steps)
        for p in project.program.inputs
    }


class Slave:
    """An FMU under way in fmpy, step by step."""

    def __init__(self, path, folder):
        self.about = fmpy.read_model_description(path)
        fmpy.extract(path, folder)
        kind = FMU3Slave if self.about.fmiVersion == "3.0" else FMU2Slave
        self.fmu = kind(
            guid=self.about.guid,
            unzipDirectory=str(folder),
            modelIdentifier=self.about.coSimulation.modelIdentifier,
            instanceName="one",
        )
        self.reference = {v.name: v.valueReference for v in self.about.modelVariables}
        self.time = 0.0  # s
        self.fmu.instantiate()

    def begin(self, **parameters):
        self.set(parameters)
        if self.about.fmiVersion == "2.0":
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        return self

    def set(self, values):
        write = self.fmu.setFloat64 if self.about.fmiVersion == "3.0" else self.fmu.setReal
        if values:
            write([self.reference[name] for name in values], [float(v) for v in values.values()])

    def get(self, names):
        read = self.fmu.getFloat64 if self.about.fmiVersion == "3.0" else self.fmu.getReal
        return [float(v) for v in read([self.reference[name] for name in names])]

    def step(self, size):
        self.fmu.doStep(self.time, size)
        self.time += size

    def close(self):
        self.fmu.terminate()
        self.fmu.freeInstance()


# -- a network -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("flags", [["-O2"], ["-O2", "-march=native", "-ffp-contract=fast"]])
def test_values_become_codes_and_codes_values_to_the_last_bit_however_the_compiler_joins_operations(
    build, tmp_path, flags
):
    export_c(build, tmp_path / "c")
    sources = ["b2.c", "b2_values.c", "example.c"]
    warned = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wsign-conversion", "-Wshadow", "-Werror"]
    command = ["gcc", *warned, *flags, *sources, "-o", "example"]
    subprocess.run(command, cwd=tmp_path / "c", check=True)
    given = inputs(build)
    lines = "\n".join(" ".join(f"{v:.17g}" for v in row) for row in zip(*given.values(), strict=True))

    def ran(text: str) -> subprocess.CompletedProcess:
        return subprocess.run([tmp_path / "c" / "example"], input=text, capture_output=True, text=True, check=False)

    done = ran(lines + "\n")
    found = np.array([[float(v) for v in line.split()] for line in done.stdout.splitlines()])
    expected = emulate(build.program, given)
    assert expected.clipped, "some values lie outside the format"
    assert done.returncode == 0
    assert re.fullmatch(r"\d+ values are beyond what their formats hold; they became the nearest code\n", done.stderr)
    for wrong, said in (("nan", "step 2: a value is not finite\n"), ("-inf", "step 2: a value is not finite\n"),
                        ("volts", "step 2: give 1 number\n")):  # fmt: skip
        done = ran(f"0\n{wrong}\n")
        assert (done.returncode, done.stderr, done.stdout.count("\n")) == (2, said, 1)
    assert found.T.tolist() == [v.tolist() for v in expected.outputs.values()]


@pytest.mark.parametrize("version", VERSIONS)
def test_an_fmu_of_a_build_answers_as_the_emulator_in_every_bit(build, tmp_path, version):
    path = tmp_path / "b2.fmu"
    held = export_fmu(build.folder, path, version)
    assert validate_fmu(path) == []
    assert held["inputs"] == [p.name for p in build.program.inputs]
    slave, given = Slave(path, tmp_path / "extracted").begin(), inputs(build)
    names = [p.name for p in build.program.outputs]
    found = []
    for row in zip(*given.values(), strict=True):
        slave.set(dict(zip(given, row, strict=True)))
        slave.step(build.program.period)
        found.append(slave.get(names))
    expected = emulate(build.program, given)
    assert np.array(found).T.tolist() == [expected.outputs[name].tolist() for name in names]
    assert slave.get(["clipped_values"]) == [sum(c.count for c in expected.clipped.values())]
    slave.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_simulator_that_steps_at_another_rate_gets_each_sample_once(build, tmp_path, version):
    path, period = tmp_path / "b2.fmu", build.program.period
    export_fmu(build.folder, path, version)
    assert period == 1.0
    slow = Slave(path, tmp_path / "slow").begin()
    fast = Slave(path, tmp_path / "fast").begin()
    for slave in (slow, fast):
        slave.set({"u": 0.5})
    slow.step(6 * period)
    for _ in range(24):
        fast.step(period / 4)
    steady = emulate(build.program, {"u": np.full(6, 0.5)}).outputs["y"]
    assert slow.get(["y"]) == fast.get(["y"]) == [steady[-1]]


@pytest.mark.parametrize("version", VERSIONS)
def test_a_state_that_was_kept_goes_on_as_if_nothing_had_happened(build, tmp_path, version):
    path = tmp_path / "b2.fmu"
    export_fmu(build.folder, path, version)
    slave = Slave(path, tmp_path / "x").begin()
    keep, back = (
        (slave.fmu.getFMUState, slave.fmu.setFMUState)
        if version == "3.0"
        else (slave.fmu.getFMUstate, slave.fmu.setFMUstate)
    )
    slave.set({"u": 0.7})
    slave.step(3.0)
    kept, time = keep(), slave.time
    slave.step(1.0)
    once = slave.get(["y"])
    slave.set({"u": -0.7})
    slave.step(5.0)
    back(kept)
    slave.time = time
    slave.step(1.0)
    assert slave.get(["y"]) == once


def test_an_fmu_is_a_function_of_the_build(build, tmp_path):
    one, other = tmp_path / "a.fmu", tmp_path / "b.fmu"
    export_fmu(build.folder, one)
    export_fmu(build.folder, other)
    assert one.read_bytes() == other.read_bytes()


def test_an_fmu_refuses_a_value_that_is_no_number_and_a_step_out_of_turn(build, tmp_path):
    path = tmp_path / "b2.fmu"
    export_fmu(build.folder, path)
    slave = Slave(path, tmp_path / "x").begin()
    with pytest.raises(fmpy.fmi1.FMICallException):
        slave.set({"u": float("nan")})
    slave.time = 3.0
    with pytest.raises(fmpy.fmi1.FMICallException):
        slave.step(1.0)


# -- a plant ---------------------------------------------------------------------------------------------------------

CART = """outputs = ["x", "force"]
step = 1e-3
[inputs]
u = "V"
double = "N"
[parameters]
mass = [2.0, "kg"]
gain = [3.0, "N/V"]
stroke = [0.05, "m"]
start = [0.01, "m"]
friction = [0.7, "N"]
[states]
x = { unit = "m", rate = "v", initial = "start", low = "-stroke", high = "stroke" }
v = { unit = "m/s" }
w = { unit = "rad/s" }
z = { unit = "rad/s", initial = 0.3 }
[definitions]
drive = { force = { unit = "N", motor = "gain * u", spring = "-200 * x**3 / stroke**2", pull = "double" } }
[equations]
position = { x = { velocity = "v" } }
motion = { v = { storage = "mass", drive = "force", friction = "-friction * smooth_step(v, 0.01) - max(v, 0) ** 1.5" } }
one = { w = { storage = "2 + cos(x)", couples = { z = "0.5" }, turning = "when(x, sin(z)) - atan2(w, 1) - abs(w)" } }
other = { z = { storage = "1.5", couples = { w = "0.5" }, turning = "-z + min(u, 1) * sign(v) - 2 ** -1 * w" } }
"""


@pytest.mark.parametrize("version", VERSIONS)
def test_an_fmu_of_a_plant_follows_the_simulation(tmp_path, version):
    (tmp_path / "cart.toml").write_text(CART)
    plant, path = Plant.read(tmp_path / "cart.toml"), tmp_path / "cart.fmu"
    held = export_fmu(tmp_path / "cart.toml", path, version)
    assert validate_fmu(path) == []
    assert held["parameters"] == list(plant.parameters)
    rng = np.random.default_rng(3)
    given = {"u": np.repeat(rng.uniform(-9, 9, 30), 10), "double": np.repeat(rng.uniform(-1, 1, 60), 5)}
    slave = Slave(path, tmp_path / "x").begin(mass=1.5, start=0.02)
    names = ["x", "v", "w", "z", "force"]
    found = []
    for k in range(300):
        slave.set({name: signal[k] for name, signal in given.items()})
        found.append(slave.get(names))
        slave.step(0.01)
    changed = plant.with_parameters(mass=1.5, start=0.02)
    expected = simulate(changed, given, sample_time=0.01, step=1e-3, channels=names)
    expected = np.stack([expected[name] for name in names], axis=1)
    assert (np.abs(expected[:, 0]) == 0.05).any(), "it reaches its stop"
    # one rounding of libm's functions differs from numba's; a plant that is stable keeps it small
    assert np.abs(np.array(found) - expected).max() <= 1e-12 * np.abs(expected).max()


def test_a_parameter_of_a_plant_is_set_before_the_first_step_and_not_later(tmp_path):
    (tmp_path / "cart.toml").write_text(CART)
    export_fmu(tmp_path / "cart.toml", tmp_path / "cart.fmu")
    slave = Slave(tmp_path / "cart.fmu", tmp_path / "x").begin()
    with pytest.raises(fmpy.fmi1.FMICallException):
        slave.set({"mass": 1.0})


def test_what_no_fmu_is_made_of_is_said(tmp_path):
    (tmp_path / "static.toml").write_text(
        'outputs = ["y"]\ninputs = { u = "V" }\n[definitions]\na = { y = { unit = "V", of = "2 * u" } }\n'
    )
    with pytest.raises(InputError, match="no state"):
        export_fmu(tmp_path / "static.toml", tmp_path / "x.fmu")
    with pytest.raises(InputError, match=r"greygate compile"):
        export_fmu(tmp_path, tmp_path / "x.fmu")
    assert not (tmp_path / "x.fmu").exists()


# -- a rig -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """A motor with dry friction, and what was diagnosed of it."""
    folder = motor(tmp_path_factory.mktemp("rig") / "motor", noise=0.5)
    assert greygate("diagnose", folder, "--out", folder / "diagnosis.json")[0] == 0
    return folder


@pytest.mark.parametrize("version", VERSIONS)
def test_an_fmu_of_a_rig_is_its_plant_as_the_diagnosis_corrects_it(rig, tmp_path, version):
    path, diagnosis = tmp_path / "motor.fmu", read(rig / "diagnosis.json")
    held = export_fmu(rig, path, version, diagnosis)
    assert {"f_w", "inertia"} <= set(held["parameters"]), "the effect's parameters can be set, too"
    assert "u_lost" not in held["parameters"], "what nobody named is not in it"
    slave = Slave(path, tmp_path / "x").begin()
    recording = rigs.load(rig).recording(rig / "identify.csv")
    expected = predicted(rigs.load(rig), recording, diagnosis)["w"]
    found = []
    for u in recording["u"]:
        slave.set({"u": u})
        found.append(slave.get(["w"])[0])
        slave.step(0.01)
    assert np.abs(np.array(found) - expected).max() <= 1e-9 * np.abs(expected).max()
    plain = tmp_path / "plain.fmu"
    assert set(export_fmu(rig, plain, version)["parameters"]) == {"inertia", "gain", "viscous"}


def test_a_correction_of_what_is_recorded_is_no_part_of_an_fmu(rig, tmp_path):
    diagnosis = read(rig / "diagnosis.json")
    late = {"id": "input_delay", "parameters": {"u_delay": {"value": 0.02}}}
    with pytest.raises(InputError, match="recorded as u"):
        export_fmu(rig, tmp_path / "x.fmu", diagnosis={**diagnosis, "effects": [late]})


def test_the_command_says_what_the_fmu_holds(rig, tmp_path):
    out = tmp_path / "motor.fmu"
    code, printed, _ = greygate("export", "fmu", rig, "--diagnosis", rig / "diagnosis.json", "--out", out, "--json")
    assert code == 0
    assert json.loads(printed)["outputs"] == ["w"]
    code, _, told = greygate("export", "fmu", rig / "rig.toml", "--out", out)
    assert code == 2
    assert "Traceback" not in told


# -- a project for FuseSoC -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """The folder that `export fusesoc` writes of a small network."""
    folder = tmp_path_factory.mktemp("cores")
    name, made = "mts", folder / "made"
    compile_project(Source(name, {}), made, architectures=("parallel",))
    code, _, told = greygate("export", "fusesoc", made, "--out", folder / "core")
    assert code == 0, told
    return folder / "core"


def fusesoc(folder, target):
    """Run a target of the exported core in Verilator."""
    command = [Path(sys.executable).parent / "fusesoc", "--cores-root", ".", "run", f"--target={target}"]
    command += ["--tool=verilator", "greygate::mts"]
    return subprocess.run(command, cwd=folder, env=simulator_environment(), capture_output=True, text=True)


@pytest.mark.nightly
def test_fusesoc_runs_the_scenario_and_every_bit_is_equal(project):
    done = fusesoc(project, "sim")
    assert done.returncode == 0, done.stderr[-2000:]
    assert re.search(r"PASS: \d+ steps in \d+ clocks, every bit equal", done.stdout + done.stderr)
    assert fusesoc(project, "lint").returncode == 0


@pytest.mark.nightly
def test_the_simulation_of_fusesoc_fails_where_a_bit_differs(project, tmp_path):
    folder = tmp_path / "core"
    shutil.copytree(project, folder, ignore=shutil.ignore_patterns("build"))
    scenario = folder / "bench" / "scenario.hex"
    lines = scenario.read_text().splitlines()
    lines[20] = f"{int(lines[20], 16) ^ (1 << 4 * len(lines[20]) - 1):0{len(lines[20])}x}"
    scenario.write_text("\n".join(lines) + "\n")
    done = fusesoc(folder, "sim")
    assert done.returncode != 0
    assert "FAIL: step 20" in done.stdout + done.stderr


@pytest.mark.nightly
def test_the_bench_in_cocotb_passes_and_fails_as_it_should(project, tmp_path):
    """In one folder, so that the second run finds the simulation built."""
    folder = tmp_path / "core"
    shutil.copytree(project, folder, ignore=shutil.ignore_patterns("build"))
    scenario = folder / "bench" / "scenario.hex"
    lines = scenario.read_text().splitlines()[:60]
    right = lines[20]
    wrong = f"{int(right, 16) ^ (1 << 4 * len(right) - 1):0{len(right)}x}"
    environment = simulator_environment() | {"SIM": "verilator"}
    for line, code, said in ((right, 0, "TESTS=2 PASS=2 FAIL=0"), (wrong, 1, "TESTS=2 PASS=0 FAIL=2")):
        lines[20] = line
        scenario.write_text("\n".join(lines) + "\n")
        command = [sys.executable, "bench/run.py"]
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
        assert done.returncode == code, done.stdout[-2000:] + done.stderr[-2000:]
        assert said in done.stdout


def test_an_export_replaces_an_export_and_nothing_else(project, tmp_path):
    made = tmp_path / "other"
    made.mkdir()
    (made / "thesis.txt").write_text("mine")
    code, _, told = greygate("export", "fusesoc", project.parent / "made", "--out", made)
    assert (code, (made / "thesis.txt").read_text()) == (2, "mine")
    assert "Traceback" not in told
