"""`greygate demo` writes what a tutorial begins with, beside what is there."""

import re
import runpy
import subprocess
import sys

import numpy as np
import pytest
from rooms import ROOT

from greygate.machines.samples import DEMOS
from greygate.plants import read_csv, simulate

SIMULATOR = ROOT / "recordings" / "pendulum"


@pytest.mark.parametrize("name", DEMOS)
def test_a_sample_is_written_and_never_over_a_file(name, greygate, tmp_path):
    code, out, _ = greygate("demo", name, "--out", tmp_path / "new")
    assert (code, f"written: {tmp_path / 'new'}" in out) == (0, True)
    assert out.splitlines()[1:] == ["then:", f"cd {tmp_path / 'new'}", *DEMOS[name].then]
    assert all((tmp_path / "new" / n).exists() for n in DEMOS[name].names)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    code, out, error = greygate("demo", name, "--out", tmp_path / "new")
    assert (code, out, error.count("\n")) == (2, "", 1)
    assert "is there already" in error
    assert before == {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}


def test_a_sample_that_cannot_be_written_whole_leaves_nothing(greygate, tmp_path):
    (tmp_path / "holdout.csv").write_text("mine")
    (tmp_path / "axis").symlink_to(tmp_path / "nowhere")
    code, _, error = greygate("demo", "plant", "--out", tmp_path)
    assert (code, "Traceback" in error) == (2, False)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["axis", "holdout.csv"]


def test_the_plant_is_that_of_its_tutorial():
    page = (ROOT / "docs" / "tutorial_plant.md").read_text()
    blocks = dict(re.findall(r'```toml title="([\w/.]+)"\n(.*?)```', page, re.S))
    for name in ("axis.toml", "rig.toml", "mine.toml"):
        assert (ROOT / "recordings" / "axis" / name).read_text() == blocks[f"axis/{name}"]


def test_the_network_is_cut_as_its_tutorial_cuts(greygate, tmp_path):
    greygate("demo", "network", "--out", tmp_path)
    page = (ROOT / "docs" / "tutorial_network.md").read_text()
    cuts = re.findall(r'cut\("(\w+)", ([\d_]+), ([\d_]+), "(\w+)\.csv"\)', page)
    assert len(cuts) == 2
    for source, first, last, name in cuts:
        whole = read_csv(ROOT / "recordings" / "servohydraulic-mts" / f"{source}.csv")
        made = read_csv(tmp_path / f"{name}.csv")
        assert (made["x_meas"] == whole["x_meas"][int(first) : int(last)]).all()


def test_the_simulator_misses_what_its_source_says_and_nothing_else():
    told = (SIMULATOR / "SOURCE.md").read_text()
    friction, place = re.search(r"`(-.*?)` in `(\w+)`", told).groups()
    damping, noise = (float(re.search(words, told)[1]) for words in (r"damping of ([\d.]+)", r"with ([\d.]+) mrad"))
    plant = runpy.run_path(str(SIMULATOR / "pendulum.py"))["pendulum"]
    real = plant.with_term(place, "dry", friction).with_parameters(damping=damping)
    run = read_csv(SIMULATOR / "run.csv")
    given = {"torque": run["torque"]}
    found = [simulate(one, given, sample_time=run.dt)["angle"] for one in (plant, real)]
    away = [np.std(angle - run["angle"]) / (1e-3 * noise) for angle in found]
    assert away[0] > 100
    assert away[1] == pytest.approx(1.0, abs=0.1)


@pytest.mark.nightly
def test_the_simulator_is_explained_by_one_call(greygate, tmp_path):
    greygate("demo", "simulator", "--out", tmp_path)
    done = subprocess.run([sys.executable, "pendulum.py"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "dry_friction:" in done.stdout
    assert float(re.search(r"f_w +([\d.]+) ", done.stdout)[1]) == pytest.approx(0.15, rel=1e-3)


def test_all_samples_are_listed_with_what_they_are(greygate):
    code, out, _ = greygate("demo")
    assert code == 0
    assert all(name in out and demo.means in out for name, demo in DEMOS.items())
