"""`greygate look --against`: several models over one recording, in free run."""

import numpy as np
import pytest
from networks import delay_line
from test_cli import recording

from greygate.machines.samples import write
from greygate.machines.source import read_record
from greygate.models.network import Network
from greygate.models.validation import fit_per_cent
from greygate.pages.several import Predicted, predictions
from greygate.plants.recording import read_csv

ROUNDING = 1e-14  # of one order of summation against another


@pytest.fixture
def folder(greygate, tmp_path):
    """A network `line.toml`, a recording, and the build `line`."""
    delay_line().save(tmp_path / "line")
    recording(tmp_path / "run.csv", steps=200)
    assert greygate("compile", tmp_path / "line.toml", tmp_path / "run.csv", "--out", tmp_path / "line")[0] == 0
    return tmp_path


def test_a_network_is_run_as_validate_runs_it_and_a_build_as_emulate(greygate, folder):
    of_network, of_build = predictions([str(folder / "line.toml"), str(folder / "line")], folder / "run.csv")
    network = Network.load(folder / "line.toml")
    record = read_record(network, folder / "run.csv")[0]
    own = network.run(record.inputs)[of_network.output]
    assert np.abs(of_network.predicted - own).max() < ROUNDING * np.abs(own).max()
    assert greygate("emulate", folder / "line", folder / "run.csv", "--out", folder / "answer.csv")[0] == 0
    assert np.array_equal(of_build.predicted, read_csv(folder / "answer.csv")[of_build.output])


def test_a_rig_is_simulated_as_its_data_sheet_says_and_as_it_was_diagnosed(greygate, tmp_path):
    write("plant", tmp_path)
    rig, told = tmp_path / "axis", tmp_path / "axis.json"
    assert greygate("diagnose", rig, "--out", told)[0] == 0
    words = [rig / "holdout.csv", "--against", rig, "--against", f"{rig}={told}", "--html", tmp_path / "page.html"]
    code, out, _ = greygate("look", *words)
    assert code == 0
    sheet, corrected = out.splitlines()[1:3]
    assert sheet.split()[1:3] == ["x", "167"]
    assert corrected.split()[-1] == "100.0"
    page = (tmp_path / "page.html").read_text()
    assert page.count('role="application"') == 1
    assert "100.0 %" in page


def test_the_fit_is_of_what_counts_and_none_where_it_diverges():
    y = np.sin(np.arange(100.0))
    one = Predicted("a", "y", "m", 0.1, y, np.where(np.arange(100) < 10, 9.0, y + 0.1), 10)
    assert one.fit == fit_per_cent(y[10:], y[10:] + 0.1)
    assert np.isnan(Predicted("a", "y", "m", 0.1, y, np.full(100, np.inf), 0).fit)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--against", "none.toml"], "none.toml"),
        (["--against", "line.toml", "--settle", "200"], "--settle 200: "),
        (["--against", "line.toml", "--settle", "auto"], "--settle auto: "),
        (["--against", "line.toml", "--out", "x.csv"], "leave out --out"),
        (["--against", "line.toml=none.json"], "line.toml"),
    ],
    ids=["no file", "too long", "auto", "out", "no rig"],
)
def test_what_cannot_be_compared_is_refused(greygate, folder, monkeypatch, words, told):
    monkeypatch.chdir(folder)
    code, out, error = greygate("look", "run.csv", *words, "--html", "page.html")
    assert (code, out) == (2, "")
    assert told in error
    assert not (folder / "page.html").exists()
