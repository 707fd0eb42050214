"""What greygate starts runs nothing of the folder it is started in, and ends with whoever started it."""

import os
import shutil
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
from networks import recorded_line
from workers import killed, killed_always

from greygate import children
from greygate.errors import InputError
from greygate.mismatch import explain
from greygate.mismatch.concealed.conceal import conceal

GREYGATE = str(Path(sys.executable).with_name("greygate"))
SOON = 5.0  # s in which what was started ends after its starter
TRAP = "from pathlib import Path\nPath({ran!r}).write_text(__name__)\n"


@pytest.fixture(scope="module")
def given(tmp_path_factory) -> Path:
    """A folder with what the commands need."""
    folder = tmp_path_factory.mktemp("given")
    recorded_line(folder)
    for name, kind in (("fast", {"effect": "speed_slip", "kind": "one"}), ("clean", {"kind": "clean"})):
        conceal("cable_drum", 3, folder / name, **kind)
        for table in (folder / name).glob("*.csv"):
            table.write_text("".join(table.read_text().splitlines(keepends=True)[:1001]))
    return folder


@pytest.fixture
def strange(tmp_path) -> Path:
    """A stranger's folder: modules that Python would import before ours, if it looked here."""
    folder = tmp_path / "strange"
    (folder / "greygate").mkdir(parents=True)
    for name in ("numpy.py", "joblib.py", "sitecustomize.py", "os.py", "greygate/__init__.py", "cocotb.py"):
        (folder / name).write_text(TRAP.format(ran=str(tmp_path / "ran")))
    return folder


def called(folder: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """GREYGATE_UNLIMITED: what sets no limits on memory would refuse a file of MATLAB, and read nothing."""
    variables = {**os.environ, "GREYGATE_UNLIMITED": "1"}
    return subprocess.run([GREYGATE, *map(str, words)], cwd=folder, env=variables, capture_output=True, text=True)


@pytest.mark.parametrize(
    "words",
    [
        "look {given}/r.mat --unit u=V --unit y=m",
        "identify {given}/a.csv --input u --output y --seconds 1 --jobs 2 --out found",
        "diagnose {given}/fast {given}/clean --seconds 1 --jobs 2",
        "verify built",
    ],
)
def test_a_strangers_folder_runs_nothing(words, given, strange):
    if words == "verify built":
        made = f"compile {given}/line.toml {given}/a.csv --architecture parallel --out built"
        built = called(strange, *made.split())
        assert built.returncode == 0, built.stderr
    done = called(strange, *words.format(given=given).split())
    assert done.returncode in (0, 1), done.stderr
    assert not (strange.parent / "ran").exists()


def test_what_is_started_there_runs_nothing_of_it(strange, monkeypatch):
    monkeypatch.chdir(strange)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(["", ".", *os.environ.get("PYTHONPATH", "").split(os.pathsep)]))
    done = children.ran(children.python("-c", "import numpy, joblib, greygate"))
    assert (done.returncode, done.stderr) == (0, "")
    assert list(children.workers(2, [partial(abs, -k) for k in range(3)])) == [0, 1, 2]
    assert not (strange.parent / "ran").exists()


def living(pid: int) -> bool:
    """Whether it is there, and no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def ended(pids: list[int]) -> bool:
    until = time.monotonic() + SOON
    while any(map(living, pids)) and time.monotonic() < until:
        time.sleep(0.05)
    return not any(map(living, pids))


def told(file: Path, count: int) -> list[int]:
    """The process ids that a file holds as soon as they are so many."""
    until = time.monotonic() + 60
    while time.monotonic() < until:
        pids = file.read_text().split() if file.exists() else []
        if len(pids) >= count:
            return [int(pid) for pid in pids]
        time.sleep(0.05)
    raise AssertionError("it did not begin")


STARTER = """
import sys, time
from functools import partial
sys.path.insert(0, {tests!r})
from greygate import children
from workers import slept
match {how!r}:
    case "command":
        children.ran(["sh", "-c", "sleep 600 & echo $! $$ >> {file}; wait"])
    case "workers":
        list(children.workers(2, [partial(slept, {file!r})] * 2))
"""


@pytest.mark.parametrize(("how", "count"), [("command", 2), ("workers", 4)])
def test_what_was_started_ends_with_who_was_killed(how, count, tmp_path):
    file = tmp_path / "pids"
    code = STARTER.format(tests=str(Path(__file__).parent), how=how, file=str(file))
    starter = subprocess.Popen([sys.executable, "-c", code])
    try:
        pids = told(file, count)
        assert all(map(living, pids))
    finally:
        starter.kill()
        starter.wait()
    assert ended(pids)


def test_a_command_that_takes_too_long_is_killed_with_what_it_started(tmp_path):
    with pytest.raises(children.TimeoutExpired):
        children.ran(["sh", "-c", "sleep 600 & echo $! > pids; wait"], cwd=tmp_path, timeout=0.5)
    assert ended(told(tmp_path / "pids", 1))


@pytest.mark.parametrize(("script", "code"), [("exit 3", 3), ("kill -9 $$", -9), ("kill -24 $$", -24)])
def test_a_command_ends_as_it_would_alone(script, code):
    assert children.ran(["sh", "-c", script]).returncode == code


def test_a_program_that_is_not_there_is_an_error_of_the_caller():
    with pytest.raises(FileNotFoundError, match="no-such-program"):
        children.ran(["no-such-program"])


@pytest.mark.parametrize(("times", "result"), [(1, 1), (2, children.DIED)])
@pytest.mark.parametrize("in_order", [True, False])
def test_a_task_whose_process_is_killed_is_tried_once_more_and_the_others_go_on(times, result, in_order, tmp_path):
    tasks = [partial(killed, tmp_path, place, times) for place in range(4)]
    found = list(children.workers(2, tasks, in_order))
    assert found == [0, result, 2, 3] if in_order else set(found) == {0, result, 2, 3}


class Deadly:
    """Diagnoses rigs; the process that has the one called `fast` is killed."""

    def __init__(self, before):
        self.before = before

    def __call__(self, folder, *arguments):
        if folder.name == "fast":
            os.kill(os.getpid(), signal.SIGKILL)
        return self.before(folder, *arguments)


def test_a_rig_whose_process_dies_twice_is_told_and_the_others_are_written(given, tmp_path, greygate, monkeypatch):
    monkeypatch.setattr(explain, "_attempt", Deadly(explain._attempt))
    shutil.copytree(given / "clean", tmp_path / "rigs" / "second")
    rigs = [given / "fast", given / "clean", tmp_path / "rigs" / "second"]
    code, printed, error = greygate("diagnose", *rigs, "--jobs", 2, "--seconds", 1, "--out", tmp_path)
    assert (code, "Traceback" in error) == (2, False)
    assert "fast: not diagnosed: a process of the work was killed twice" in printed + error
    assert sorted(p.name for p in tmp_path.glob("*.json")) == ["clean.json", "second.json"]


def test_a_search_whose_process_dies_twice_says_so(monkeypatch):
    from greygate.hardware.exploring import side_by_side

    with pytest.raises(InputError, match="killed twice"):
        list(side_by_side(2)(killed_always, [1, 2]))
