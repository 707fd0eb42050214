"""Nothing is lost: every command is failed and killed at every touch of the disk.

`GREYGATE_FAULTS=all pytest tests/test_faults.py` tries every point, else a sample drawn with a seed is tried.
"""

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from faults import KILLED, LEAVING, libc_has_exchange, struck, unforked, without_exchange
from networks import delay_line

from greygate import files, project, reporting
from greygate.compiler.quantize import Formats
from greygate.compiler.targets import Design
from greygate.export import fmu
from greygate.hardware.build import Project
from greygate.hardware.verify import Comparison, Verification
from greygate.identify import files as identifying
from greygate.identify import training
from greygate.machines.source import Source
from greygate.mismatch import explain
from greygate.models.network import Network
from greygate.models.training.levenberg import Checkpoint, Outcome, Trained
from greygate.pages import report
from greygate.project import compile_project

pytestmark = pytest.mark.usefixtures("alone")

pytestmark = pytest.mark.nightly

ALL = os.environ.get("GREYGATE_FAULTS") == "all"
SAMPLE = 8  # points of each command and way that `make test` tries, and the last ones
ENDS = 8  # the last points, in which results are put in their places
SEED = 20261122


@dataclass(frozen=True)
class Command:
    """A command that writes `target` (files or a folder) below `root`.

    read: what a later command does first, which may finish what was broken off. together: the files are one result.
    ignored: names in paths that are no result.
    """

    arguments: list
    root: Path
    target: list[Path]
    read: Callable[[], object] = lambda: None
    before: Callable[[], None] = lambda: None
    together: bool = True
    ignored: tuple[str, ...] = ("simulation", "line.checkpoint")

    def state(self) -> dict[str, bytes]:
        """Contents of the target's files by path."""
        found = [p for t in self.target for p in ([t] if t.is_file() else sorted(t.rglob("*")))]
        found = [p for p in found if p.is_file() and not files.OURS.fullmatch(p.name)]
        found = [p for p in found if not set(self.ignored) & set(p.parts)]
        return {str(p.relative_to(self.root)): p.read_bytes() for p in found}

    def strays(self) -> list[Path]:
        return [p for p in self.root.rglob(".*") if files.OURS.fullmatch(p.name)]


class Restored:
    """Puts the folder back as it was."""

    def __init__(self, root: Path):
        self.root, self.kept = root, root.with_name(root.name + ".kept")
        shutil.copytree(root, self.kept)

    def __call__(self) -> None:
        shutil.rmtree(self.root)
        shutil.copytree(self.kept, self.root)


def points(count: int) -> list[int]:
    drawn = np.random.default_rng(SEED).permutation(np.arange(1, count + 1))[:SAMPLE].tolist()
    return list(range(1, count + 1)) if ALL else sorted({*drawn, *range(max(1, count - ENDS), count + 1)})


def tried(command: Command) -> None:
    """Fail and kill the command at its points; see the docstring of this file for what must hold after each."""
    old, restore = command.state(), Restored(command.root)
    unforked(command.arguments)
    restore()
    unharmed = struck(command.arguments, command.root, 0, "fail", command.before)
    assert unharmed.code == 0, unharmed.error
    new = command.state()
    assert new != old
    assert command.strays() == []
    count, total = 0, unharmed.touches
    for how in ("fail", "kill"):
        for at in points(total):
            restore()
            ended = struck(command.arguments, command.root, at, how, command.before)
            count += 1
            where = f"{how} at {at} of {total}, {ended}"
            _judge(command, ended, old, new, where)
            again = struck(command.arguments, command.root, 0, "fail", command.before)
            assert again.code == 0, f"{where}: a rerun says {again.error}"
            assert command.state() == new, f"{where}: a rerun gives something else"
            assert command.strays() == [], f"{where}: a rerun leaves strays"
    print(f"{' '.join(map(str, command.arguments[:1]))}: {count} points tried of {2 * total}, results lost: 0")


def _judge(command: Command, ended, old: dict, new: dict, where: str) -> None:
    assert ended.code in (0, 2, KILLED), f"{where}: exit code"
    assert ended.touch is not None, f"{where}: the shim never struck"
    if ended.code == 2:
        assert ended.error.count("\n") == 1, where
        assert ended.error.startswith("greygate: "), where
    if ended.code != KILLED and ended.touch.split()[0] not in LEAVING:
        journal = any(p.name.endswith("-commit") for p in command.strays())
        assert journal or command.strays() == [], f"{where}: strays {command.strays()}"
    command.read()
    found = command.state()
    if ended.code == 0:
        assert found == new, f"{where}: said to be done"
    if command.together:
        assert found in (old, new), f"{where}: neither old nor new"
    else:
        assert set(found) <= set(new), where
        assert all(found.get(n) in (old.get(n), new[n]) for n in new), f"{where}: a file is neither old nor new"


@pytest.fixture
def line(tmp_path) -> Source:
    """A small network and a recording, beside the folder under test."""
    delay_line().save(tmp_path / "line")
    rows = "".join(f"{k * 1e-3:.3f},{k % 5},{k % 3}\n" for k in range(20))
    (tmp_path / "a.csv").write_text("t_s,u_V,y_m\n" + rows)
    return Source(str(tmp_path / "line.toml"), {"a": str(tmp_path / "a.csv")})


@pytest.fixture
def built(line, tmp_path) -> Path:
    compile_project(line, tmp_path / "here" / "b", Formats(), design=Design(multipliers=2))
    return tmp_path / "here" / "b"


def test_train_leaves_the_old_network_or_the_new_one_with_its_figures(line, tmp_path, monkeypatch):
    def learn(network, records, checkpoint, **options):
        at = Checkpoint.load(checkpoint, "key") if checkpoint.exists() else Checkpoint(np.zeros(3), np.ones(3))
        at.save(checkpoint, "key")
        checkpoint.unlink()
        trained = network.with_parameters({n: 0.9 * v for n, v in network.parameters().items()})
        return Trained(trained, Outcome.CONVERGED, (1.0, 0.5), 0.0)

    monkeypatch.setattr(training, "narx_noe", learn)
    out = tmp_path / "here"
    out.mkdir()
    delay_line().save(out / "line", "{}\n")

    def read():
        Network.load(out / "line")

    tried(Command(["train", line.name, tmp_path / "a.csv", "--out", out], out, [out], read))


@pytest.mark.parametrize("exchange", [True, False])
def test_compile_leaves_the_old_build_or_the_new_one(line, built, tmp_path, monkeypatch, exchange):
    if exchange and not libc_has_exchange():
        pytest.skip("renameat2: this system has none")
    compiled = project.compile_network(line.network(), line.records(), Formats(), ranged_on=("a",))
    monkeypatch.setattr(project, "compile_network", lambda *a, **o: compiled)
    arguments = ["compile", line.name, tmp_path / "a.csv", "--out", built, "--macs", "4"]
    before = (lambda: None) if exchange else without_exchange
    tried(Command(arguments, built.parent, [built], lambda: Project.open(built), before))


def test_compile_into_a_new_folder_leaves_nothing_or_all(line, tmp_path, monkeypatch):
    compiled = project.compile_network(line.network(), line.records(), Formats(), ranged_on=("a",))
    monkeypatch.setattr(project, "compile_network", lambda *a, **o: compiled)
    root = tmp_path / "here"
    root.mkdir()
    tried(Command(["compile", line.name, tmp_path / "a.csv", "--out", root / "n" / "b"], root, [root / "n" / "b"]))


def test_verify_leaves_the_old_verdict_or_the_new_one(built, monkeypatch):
    def simulated(cases, folder, seed):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "results.xml").write_text(f"<testsuites><!-- {seed} --></testsuites>")
        verdicts = tuple(Comparison("line", case.architecture, "a", 20, 9.0, 0.1, None) for case in cases)
        return Verification(verdicts, seed, folder / "results.xml", 0.1, 0.1)

    monkeypatch.setattr(project, "verify_many", simulated)
    project.verify_project(Project.open(built), (), 1)
    target = [built / n for n in ("verify.json", "results-parallel.xml", "results-folded.xml")]
    read = lambda: Project.open(built).hardware  # noqa: E731
    tried(Command(["verify", built, "--seed", "2"], built.parent, target, read))


def test_synthesize_leaves_the_old_figures_or_the_new_ones(built, monkeypatch):
    (built / "resources.json").write_text('{"folded, ecp5": {"luts": 1}}')
    monkeypatch.setattr(project, "synthesize", lambda *a: {"luts": 42})
    tried(Command(["synthesize", built], built.parent, [built / "resources.json"]))


def test_report_leaves_the_old_pages_or_the_new_ones(built, tmp_path, monkeypatch):
    study = {"title": "line", "scenarios": {}}
    monkeypatch.setattr(reporting, "study_of", lambda *a, **o: study)
    monkeypatch.setattr(report, "page", lambda *a: "<html>new</html>")
    root = tmp_path / "pages"
    root.mkdir()
    target = [root / "r.html", root / "r.json"]
    for path in target:
        path.write_text("old")
    tried(Command(["report", built, "--html", target[0]], root, target, lambda: files.settle(target)))


def test_diagnose_leaves_each_file_old_or_new(tmp_path, monkeypatch):
    made = explain.Explained({"verdict": "clean"}, ["clean"], "<html>new</html>")
    monkeypatch.setattr(explain.Explained, "of", lambda *a, **o: made)
    root = tmp_path / "pages"
    root.mkdir()
    (root / "d.json").write_text(json.dumps({"verdict": "old"}))
    target = [root / "d.json", root / "d.html"]
    arguments = ["diagnose", tmp_path, "--out", target[0], "--html", target[1]]
    tried(Command(arguments, root, target, together=False))


def test_identify_leaves_no_folder_or_the_whole_one(line, tmp_path, monkeypatch):
    told = {"better_than_mean": True, "test": {}, "settle": 0}
    monkeypatch.setattr(identifying, "identify", lambda *a, **o: SimpleNamespace(network=delay_line()))
    monkeypatch.setattr(identifying, "figures", lambda found: told)
    monkeypatch.setattr(identifying, "lines", lambda found: [])
    root = tmp_path / "here"
    root.mkdir()
    words = ["identify", tmp_path / "a.csv", "--input", "u", "--output", "y", "--out", root / "found"]
    tried(Command(words, root, [root / "found"]))


def test_diagnose_leaves_the_files_of_each_of_several_rigs_old_or_new(tmp_path, monkeypatch):
    made = explain.Explained({"verdict": "clean"}, ["clean"], "<html>new</html>")
    monkeypatch.setattr(explain, "_attempt", lambda *a: made)
    root = tmp_path / "pages"
    root.mkdir()
    (root / "one.json").write_text(json.dumps({"verdict": "old"}))
    words = ["diagnose", tmp_path / "one", tmp_path / "two", "--out", root, "--jobs", 1]
    tried(Command(words, root, [root], together=False))


def test_export_leaves_the_old_fmu_or_the_new_one(built, tmp_path, monkeypatch):
    monkeypatch.setattr(fmu, "_library", lambda *a: (b"library", "binaries/x86_64-linux/line.so"))
    root = tmp_path / "out"
    root.mkdir()
    (root / "line.fmu").write_text("old")
    tried(Command(["export", "fmu", built, "--out", root / "line.fmu"], root, [root / "line.fmu"]))


def test_board_leaves_no_folder_or_the_whole_one(built, tmp_path):
    root = tmp_path / "out"
    root.mkdir()
    tried(Command(["board", "icebreaker", built, "--out", root / "board"], root, [root / "board"]))
