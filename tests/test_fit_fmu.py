"""An FMU is fitted to a recording, and what is wrong with the recording is told from its parameters."""

import json

import numpy as np
import pytest
from command_line import greygate
from small_plants import MOTOR, steps

from greygate.errors import InputError
from greygate.export.calibrate import Fault, Unit, _Fit, calibrate
from greygate.export.export import export_fmu
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording
from greygate.plants.simulator import simulate

DT = 0.01
TRUE = {"inertia": 0.012, "viscous": 0.0135}


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmu")
    (folder / "motor.toml").write_text(MOTOR)
    export_fmu(folder / "motor.toml", folder / "motor.fmu", "3.0")
    export_fmu(folder / "motor.toml", folder / "motor2.fmu", "2.0")
    return folder


def recorded(folder, late=0, offset=0.0):
    """The motor with other parameters, 0.2 rad/s of noise, its speed `late` samples and `offset` rad/s off."""
    u = steps(1, -10.0, 10.0, 40, 600)
    plant = Plant.read(folder / "motor.toml").with_parameters(**TRUE)
    w = simulate(plant, {"u": u}, sample_time=DT, step=1e-3)["w"]
    w = np.concatenate([np.zeros(late), w[: len(w) - late]]) + offset
    w = w + 0.2 * np.random.default_rng(2).standard_normal(len(w))
    return Recording(DT, {"u": u, "w": w}, {"u": "V", "w": "rad/s"})


def within(found, true):
    low, high = found["interval"]
    return low <= true <= high


@pytest.mark.parametrize("name", ["motor.fmu", "motor2.fmu"])
def test_the_parameters_of_an_fmu_are_found_on_a_recording(fmu, name):
    found = calibrate(fmu / name, recorded(fmu), ["inertia", "viscous"])
    assert all(within(found["parameters"][n], true) for n, true in TRUE.items()), found["parameters"]
    errors = found["rms"]["w"]
    assert errors["calibrated"]["held_out"] < 0.25 < errors["start"]["held_out"]
    assert found["faults"] == []


def test_a_late_sensor_with_an_offset_is_told_from_the_parameters(fmu):
    found = calibrate(fmu / "motor.fmu", recorded(fmu, late=3, offset=4.0), ["inertia", "viscous"])
    faults = {(f["channel"], f["kind"]): f for f in found["faults"]}
    assert {kind for _, kind in faults} == {"delay", "offset"}
    (channel, _), late = next(item for item in faults.items() if item[0][1] == "delay")
    assert late["size"] == pytest.approx({"u": -0.03, "w": 0.03}[channel], abs=0.002)  # an early input, a late output
    assert all(abs(found["parameters"][n]["value"] / true - 1) < 0.02 for n, true in TRUE.items())
    assert found["rms"]["w"]["with_faults"]["held_out"] < 0.25


@pytest.mark.parametrize(("kind", "size"), [("gain", 0.25), ("offset", -0.4), ("delay", 3.0)])
def test_a_fault_of_an_input_is_undone_before_the_fmu_sees_it(fmu, kind, size):
    unit, given = Unit(fmu / "motor.fmu"), recorded(fmu)
    fit = _Fit(unit, given, ["u"], ["w"], ["viscous"])
    fault = Fault("u", kind, True)
    shown = fit._changed(given["u"], fault, size)
    assert np.abs(shown - given["u"]).max() > 0.5
    assert np.abs(fit._changed(shown, fault, size, undone=True) - given["u"])[3:-3].max() < 1e-12


def test_what_does_not_help_on_data_that_was_held_out_is_no_fault(fmu):
    given = recorded(fmu)
    shifted = given["w"] + 2.0 * (np.arange(600) < 360)  # a sensor that was mended where the held-out part begins
    found = calibrate(
        fmu / "motor.fmu", Recording(DT, {"u": given["u"], "w": shifted}, given.units), ["inertia", "viscous"]
    )
    assert found["rms"]["w"]["with_faults"] == found["rms"]["w"]["calibrated"]
    assert found["faults"] == []


def test_what_an_fmu_has_not_is_named(fmu, tmp_path):
    with pytest.raises(InputError, match="no parameter mass; it has inertia, gain, viscous"):
        calibrate(fmu / "motor.fmu", recorded(fmu), ["mass"])
    only = recorded(fmu)
    with pytest.raises(InputError, match="no channel u, an input of the FMU"):
        calibrate(fmu / "motor.fmu", Recording(DT, {"w": only["w"]}, {"w": "rad/s"}), ["inertia"])
    (tmp_path / "no.fmu").write_bytes(b"PK nothing")
    with pytest.raises(InputError, match="is no FMU"):
        calibrate(tmp_path / "no.fmu", only, ["inertia"])


def test_the_command_runs_an_fmu_only_if_its_maker_is_trusted(fmu, tmp_path):
    recorded(fmu).write_csv(tmp_path / "run.csv")
    words = ["fit-fmu", fmu / "motor.fmu", tmp_path / "run.csv", "--parameter", "inertia", "--parameter", "viscous"]
    code, out, told = greygate(*words)
    assert (code, out) == (2, "")
    assert "give --trust" in told
    code, out, told = greygate(*words, "--trust", "--json")
    assert code == 0, told
    assert within(json.loads(out)["parameters"]["inertia"], TRUE["inertia"])
