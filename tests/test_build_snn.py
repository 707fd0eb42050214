"""`greygate build-snn`: a motor with friction that its plant file leaves out, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from greygate.expert.files import build_files
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording
from greygate.plants.simulate import simulate

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


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """motor.toml, and two recordings of a motor that has Coulomb friction too."""
    folder = tmp_path_factory.mktemp("motor")
    (folder / "motor.toml").write_text(MOTOR)
    real = Plant.read(folder / "motor.toml").with_term("rotation", "dry", "-0.15 * tanh(w / 2.0)")
    for seed, name in enumerate(("training", "held")):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.uniform(-8, 8, 40), 30)
        run = simulate(real, {"u": u}, sample_time=0.02, step=1e-3)
        noisy = {"u": u, "w": run["w"] + 0.05 * rng.standard_normal(len(u))}
        Recording(0.02, noisy, {"u": "V", "w": "rad/s"}).write_csv(folder / f"{name}.csv")
    return folder


def built(files: Path, out: Path, **changed) -> dict:
    given = {"tests": {"held": str(files / "held.csv")}, "sensors": (), "targets": (), "seconds": np.inf} | changed
    return build_files(files / "motor.toml", {"training": str(files / "training.csv")}, out=out, **given)


@pytest.fixture(scope="module")
def found(files, tmp_path_factory) -> tuple[dict, Path]:
    out = tmp_path_factory.mktemp("built") / "out"
    return built(files, out), out


def test_it_beats_the_plants_own_simulation_and_a_linear_model_on_what_was_held_out(found):
    rms = {who: by["held"]["w"] for who, by in found[0]["rms"].items()}
    assert rms["network"] < 0.2 * rms["nominal"]
    assert rms["network"] < 0.5 * rms["linear"]


def test_decisions_name_the_term_and_the_reason(found):
    (unknown, *_) = [d for d in found[0]["decisions"] if d["about"] == "rotation" and "unknown" in d["choice"]]
    assert "error" in unknown["reason"]
    assert not unknown["undone"]
    assert all(d["about"] and d["choice"] and d["reason"] for d in found[0]["decisions"])


def test_a_step_that_fails_is_undone_and_said_so(found):
    undone = [d for d in found[0]["decisions"] if d["undone"]]
    assert undone
    assert "UNDONE: " in (found[1] / "motor.decisions.txt").read_text()


def test_the_same_inputs_give_the_same_bytes(files, found, tmp_path):
    built(files, tmp_path / "again")
    for path in sorted(found[1].iterdir()):
        assert (tmp_path / "again" / path.name).read_bytes() == path.read_bytes(), path.name
