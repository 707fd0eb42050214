"""`greygate init` and `init-rig`: what they write runs at once, and nothing is overwritten."""

import json
import subprocess
import sys

import pytest
from test_starts import record, write

from greygate.mismatch.rig import load
from greygate.models.network import Network


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write("run.csv", record(2, 0.5))
    return tmp_path


def test_a_network_to_start_from_trains_at_once_and_says_what_its_parts_are_for(greygate, folder):
    code, printed, _ = greygate("init", "run.csv", "--out", "net", "--output", "y", "--json")
    assert code == 0
    assert json.loads(printed)["written"] == ["net.toml", "net.safetensors"]
    text = (folder / "net.toml").read_text()
    assert "# A curve of u, 6 neurons" in text.split("[modules.u_curve]")[0]
    code, printed, _ = greygate(
        "train", "net.toml", "run.csv", "--tail", "0.2", "--epochs", "30", "--settle", "20",
        "--out", "out", "--json",
    )  # fmt: skip
    found = json.loads(printed)
    assert code == 0
    assert found["rmse"]["run tail"]["y"] < 0.2 * found["linear"]["run"]["y"]


def test_the_script_makes_the_network_that_the_toml_holds(greygate, folder):
    words = ["run.csv", "--output", "y", "--block", "absolute", "--order", "3"]
    assert greygate("init", *words, "--out", "net")[0] == 0
    wanted = (folder / "net.toml").read_text(), (folder / "net.safetensors").read_bytes()
    for file in ("net.toml", "net.safetensors"):
        (folder / file).unlink()
    assert greygate("init", *words, "--out", "net", "--python")[0] == 0
    subprocess.run([sys.executable, "net.py"], check=True)
    made = (folder / "net.toml").read_text(), (folder / "net.safetensors").read_bytes()
    assert made[1] == wanted[1]
    assert made[0] == "".join(line for line in wanted[0].splitlines(True) if not line.startswith("#"))
    assert Network.load("net").modules["u_absolute"].meaning == "absolute"


def test_a_rig_to_start_from_is_read_at_once(greygate, folder):
    assert greygate("init-rig", "run.csv", "--out", "rig", "--output", "y")[0] == 0
    rig = load("rig")
    assert (rig.predict, rig.inputs, rig.channels["u"].unit) == (("y",), ("u",), "V")
    assert rig.plant.parameters["tau_y"].value == pytest.approx(0.01 / 0.105, rel=0.5)
    assert rig.to_explain().samples + rig.held_out().samples == 400
    assert "PLACEHOLDER" in (folder / "rig" / "plant.toml").read_text()


def test_what_is_there_is_not_overwritten(greygate, folder):
    for command, file in (("init", "net.toml"), ("init-rig", "rig")):
        (folder / file).write_text("mine")
        code, _, said = greygate(command, "run.csv", "--out", file.removesuffix(".toml"), "--output", "y")
        assert code == 2
        assert "is there already" in said
        assert (folder / file).read_text() == "mine"


def test_a_rig_to_start_from_is_diagnosed_at_once(greygate, folder):
    """What the lag of the file leaves out is a tanh of the input, which is like an input that saturates."""
    assert greygate("init-rig", "run.csv", "--out", "rig", "--output", "y")[0] == 0
    code, printed, _ = greygate("diagnose", "rig", "--json")
    found = json.loads(printed)
    assert (code, found["verdict"], found["effects"][0]["id"]) == (0, "partly_explained", "input_saturation")
    assert (found["where"][0]["equation"], found["where"][0]["depends_on"]) == ("u", ["u"])
    assert found["fit"]["holdout"]["y"]["corrected"] < 0.2 * found["fit"]["holdout"]["y"]["calibrated"]
