"""Several rigs at a time: where joblib is told to run them, on a cluster too."""

import json
import shutil
import sys
from pathlib import Path

import joblib
import pytest
from joblib._parallel_backends import ThreadingBackend

from greygate.cli import backends
from greygate.errors import InputError
from greygate.mismatch.concealed.conceal import conceal
from greygate.mismatch.explain import explain, explain_all
from greygate.pages.diagnosis import page

WITHOUT = "distributed is not installed: pip install 'greygate[cluster]'"


@pytest.fixture(scope="module")
def drums(tmp_path_factory) -> list[Path]:
    """Five seconds of two cable drums: one slips more when it is fast, one is as its data sheet says."""
    made = tmp_path_factory.mktemp("rigs")
    conceal("cable_drum", 3, made / "fast", effect="speed_slip", kind="one")
    conceal("cable_drum", 3, made / "clean", kind="clean")
    for table in made.glob("*/*.csv"):
        table.write_text("".join(table.read_text().splitlines(keepends=True)[:5001]))
    return [made / "fast", made / "clean"]


def verdicts(results: dict) -> dict[str, str]:
    return {name: content["verdict"] for name, (content, _) in results.items()}


def test_they_run_where_joblib_is_told_to(drums, tmp_path):
    taken = []

    class Watched(ThreadingBackend):
        def submit(self, task, callback=None):
            taken.append(task)
            return super().submit(task, callback)

    joblib.register_parallel_backend("watched", Watched)
    followed = []
    with joblib.parallel_config(backend="watched", n_jobs=2):
        results = explain_all(drums, out=tmp_path, html=tmp_path, progress=followed.append, page=page)
    assert len(taken) == 2
    assert verdicts(results) == {"fast": "missing_physics", "clean": "consistent"}
    assert followed == ["1 of 2: fast", "2 of 2: clean"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["clean.html", "clean.json", "fast.html", "fast.json"]
    alone, lines = explain(drums[0])
    assert {**alone, "seconds": 0} == {**json.loads((tmp_path / "fast.json").read_text()), "seconds": 0}
    assert lines[:-1] == results["fast"][1][:-1]


def test_a_cluster_diagnoses_them(drums, cluster, cluster_tasks, tmp_path):
    from distributed import Client

    before = cluster_tasks()
    with Client(cluster), joblib.parallel_config(backend="dask"):
        results = explain_all(drums, out=tmp_path)
    assert verdicts(results) == {"fast": "missing_physics", "clean": "consistent"}
    assert cluster_tasks() == before + 2
    assert len(list(tmp_path.iterdir())) == 2


def test_what_is_wrong_with_a_rig_is_said_from_a_cluster_too(drums, cluster, tmp_path):
    from distributed import Client

    with Client(cluster), joblib.parallel_config(backend="dask"):
        results = explain_all([drums[1], tmp_path / "nowhere"])
        with pytest.raises(InputError, match=r"nowhere/rig\.toml: cannot be read"):
            explain_all([tmp_path / "nowhere"])
    assert results["clean"][0]["verdict"] == "consistent"
    assert "nowhere/rig.toml: cannot be read" in results["nowhere"][0]["error"]


@pytest.fixture
def spoilt(drums, tmp_path) -> list[Path]:
    """The two, and between them rigs that cannot be diagnosed."""
    made = {}
    for name in ("no_toml", "no_table", "no_recording", "huge", "backwards"):
        made[name] = tmp_path / "rigs" / name
        shutil.copytree(drums[1], made[name])
    (made["no_toml"] / "rig.toml").unlink()
    (made["no_table"] / "rig.toml").write_text("plant =")
    (made["no_recording"] / "identify.csv").unlink()
    header, *rows = (made["huge"] / "identify.csv").read_text().splitlines()
    huge = ",".join(["1e308"] * len(header.split(",")))
    (made["huge"] / "identify.csv").write_text("\n".join([header, *[huge] * len(rows)]))
    (made["backwards"] / "identify.csv").write_text("\n".join([header, *rows[::-1]]))
    return [drums[0], *made.values(), drums[1]]


SAID = {
    "no_toml": "rig.toml: cannot be read",
    "no_table": "rig.toml: is not TOML",
    "no_recording": "identify.csv: cannot be read",
    "huge": "is beyond any quantity",
    "backwards": "does not increase",
}


@pytest.mark.parametrize("as_json", [False, True])
def test_rigs_that_cannot_be_diagnosed_end_no_other(spoilt, as_json, tmp_path, greygate):
    code, printed, error = greygate("diagnose", *spoilt, "--out", tmp_path, *["--json"] * as_json)
    assert code == 2
    assert sorted(p.name for p in tmp_path.glob("*.json")) == ["clean.json", "fast.json"]
    said = [line for line in error.splitlines() if not line.startswith("diagnosing")]  # progress, on a slow machine
    lines = dict(line.removeprefix("greygate: ").split(": ", 1) for line in said)
    assert list(lines) == list(SAID)
    found = json.loads(printed) if as_json else {}
    for name, said in SAID.items():
        assert said in lines[name]
        assert found[name] == {"error": lines[name]} if as_json else f"{name}: not diagnosed: {lines[name]}" in printed
    assert {"fast", "clean"} <= set(found) if as_json else "missing physics" in printed


def test_the_command_sends_a_rig_to_a_cluster(drums, cluster, cluster_tasks, tmp_path, greygate):
    before = cluster_tasks()
    out = tmp_path / "diagnosis.json"
    code, printed, _ = greygate(
        "diagnose", drums[1], "--backend", "dask", "--scheduler", cluster.scheduler_address, "--out", out
    )
    assert code == 0
    assert "consistent" in printed
    assert json.loads(out.read_text())["verdict"] == "consistent"
    assert cluster_tasks() == before + 1


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--backend", "dask", "--scheduler", "tcp://127.0.0.1:1"], WITHOUT),
        (["--scheduler", "tcp://127.0.0.1:1"], "loky has no scheduler; add --backend dask"),
    ],
)
def test_without_a_cluster_one_line_says_so(options, problem, drums, monkeypatch, greygate):
    monkeypatch.setitem(sys.modules, "distributed", None)
    code, printed, err = greygate("diagnose", *drums, *options)
    assert (code, printed) == (2, "")
    assert problem.partition(":")[0] in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize("address", [[], ["--scheduler", "somewhere"], ["--scheduler", "tcp://127.0.0.1:1"]])
def test_a_cluster_that_is_not_there_is_named(address, drums, monkeypatch, greygate):
    pytest.importorskip("distributed", reason=WITHOUT)
    monkeypatch.setattr(backends, "REACHED", 0.2)
    code, printed, err = greygate("diagnose", *drums, "--backend", "dask", *address)
    assert (code, printed) == (2, "")
    assert "--scheduler" in err
    assert len(err.strip().splitlines()) == 1


def test_two_rigs_of_one_name_and_a_folder_that_is_missing_are_refused(drums, tmp_path):
    with pytest.raises(InputError, match="fast: two rigs of that name"):
        explain_all([drums[0], drums[0]])
    with pytest.raises(InputError, match="no such folder"):
        explain_all(drums, out=tmp_path / "nowhere")
