"""What differs between systems stands in one file; without POSIX the commands work, or refuse in one line."""

import ast
import ctypes
import os
import re
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import checking
import numpy as np
import pytest
from networks import recorded_line
from rooms import ROOT, modules

from greygate import children, system
from greygate.errors import InputError
from greygate.files import locked
from greygate.mismatch.concealed.conceal import conceal

ELSEWHERE = Path(__file__).with_name("elsewhere")
POSIX = re.compile(  # what some systems lack
    r"\b(?:import|from)\s+(?:\w+\s*,\s*)*(?:fcntl|resource|pwd|grp|termios|tty|pty)\b|[\"']/proc\b"
    r"|(?<![\"'])\bos\.(?:fork|forkpty|getuid|geteuid|getgid|killpg|setsid|statvfs|sched_\w+|chown|wait\w*|posix_\w+|O_NO\w+)\b"
    r"|\bsignal\.(?:SIGX\w+|SIGKILL|SIGCHLD|SIGPIPE|SIGALRM|SIGHUP|alarm|setitimer|pthread_\w+)\b"
    r"|\b(?:preexec_fn|start_new_session|pass_fds|effective_ids|dir_fd)\b|\bmsvcrt\b|ctypes\.(?:CDLL\(None|windll)"
)


def test_what_some_systems_lack_is_asked_for_in_one_file():
    found = {
        name: POSIX.findall(text)
        for name, path in modules().items()
        if POSIX.search(text := path.read_text(encoding="utf-8"))
    }
    assert found.pop("greygate.system")
    assert found == {}


def translated(path: Path) -> list[int]:
    """The lines that write text as the system ends its lines."""
    found = []
    for call in (node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)):
        name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
        given = {word.arg: word.value.value for word in call.keywords if isinstance(word.value, ast.Constant)}
        modes = [a.value for a in call.args[:2] if isinstance(a, ast.Constant)] + [given.get("mode", "r")]
        writes = name in ("open", "fdopen") and any(re.fullmatch(r"[wax]\+?t?", str(mode)) for mode in modes)
        if (writes or name == "write_text") and given.get("newline") not in ("", "\n"):
            found.append(call.lineno)
    return found


def test_what_is_written_is_the_same_byte_by_byte_on_every_system(tmp_path):
    assert {name: lines for name, path in modules().items() if (lines := translated(path))} == {}
    (tmp_path / "x.py").write_text(
        "p.write_text(t, newline='\\n')\np.open('w')\nopen(p, 'x', newline='')\np.write_text(t)"
    )
    assert translated(tmp_path / "x.py") == [2, 4]


@pytest.fixture(scope="module")
def given(tmp_path_factory) -> Path:
    """A folder with what the commands need."""
    folder = tmp_path_factory.mktemp("given")
    recorded_line(folder)
    u, y = np.repeat(np.random.default_rng(1).uniform(-1, 1, 60), 10), [0.0]
    for value in u[1:]:
        y.append(0.8 * y[-1] + 0.2 * np.tanh(3.0 * value))  # a bent curve and a lag, which no linear model is
    rows = "".join(f"{k * 1e-3:.3f},{a:.5f},{b:.5f}\n" for k, (a, b) in enumerate(zip(u, y, strict=True)))
    (folder / "bent.csv").write_text("t_s,u_V,y_m\n" + rows)
    conceal("cable_drum", 3, folder / "rig", kind="clean")
    return folder


def called(folder: Path, words: str, **more: str) -> subprocess.CompletedProcess[str]:
    """A command on a system that lacks what `elsewhere` takes away."""
    variables = {**os.environ, "PYTHONPATH": str(ELSEWHERE), "LOKY_MAX_CPU_COUNT": "2", **more}
    command = [sys.executable, "-m", "greygate", *words.split()]
    return subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True)


def test_a_system_without_posix_is_one(given):
    done = subprocess.run(
        [sys.executable, "-c", "import os, greygate.system as s; print(s.fcntl, s.resource, hasattr(os, 'getuid'))"],
        env={**os.environ, "PYTHONPATH": str(ELSEWHERE)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.stdout == "None None False\n", done.stderr


@pytest.mark.parametrize(
    "words",
    [
        "look a.csv --out canonical.csv",
        "train line.toml a.csv --epochs 2 --out trained",
        "compile line.toml a.csv --architecture parallel --out built",
        "emulate built a.csv --out predicted.csv",
        "simulate rig rig/{recording} --out simulated.csv",
        "identify bent.csv --input u --output y --seconds 5 --jobs 2 --out found",
        "doctor",
    ],
)
def test_commands_work_without_posix(words, given):
    recording = min(p.name for p in (given / "rig").glob("*.csv"))
    done = called(given, words.format(recording=recording))
    assert "Traceback" not in done.stderr
    assert done.returncode == 0, done.stderr
    left = [p.name for p in given.rglob(".*greygate*")]
    assert left == []


def test_a_build_made_without_posix_is_the_same(given, greygate):
    words = "compile line.toml a.csv --architecture parallel --out elsewhere"
    assert called(given, words).returncode == 0
    made = ["compile", given / "line.toml", given / "a.csv", "--architecture", "parallel", "--out", given / "here"]
    assert greygate(*made)[0] == 0
    here, there = (
        {p.relative_to(root): p.read_bytes() for p in (root / "rtl").rglob("*.v")}
        for root in (given / "here", given / "elsewhere")
    )
    assert here == there != {}


def test_a_file_of_another_tool_is_refused_where_memory_has_no_limit_or_read_with_a_word(given):
    refused = called(given, "look r.mat --unit u=V --unit y=m")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "bounds no memory of a process" in refused.stderr
    assert "GREYGATE_UNLIMITED=1" in refused.stderr
    read = called(given, "look r.mat --unit u=V --unit y=m", GREYGATE_UNLIMITED="1")
    assert read.returncode == 0
    assert "read without limits of memory and computing" in read.stderr


def test_doctor_says_what_this_system_does_not_do(given):
    lines = {line.split("  ")[0]: line for line in called(given, "doctor").stdout.splitlines()}
    assert "held" in lines["file locks"]
    assert "not installed" not in lines["memory limits"]
    assert "not here" in lines["memory limits"]
    assert "GREYGATE_UNLIMITED" in lines["memory limits"]


@checking.POSIX
def test_a_limit_that_the_system_takes_and_does_not_hold_to_is_no_limit():
    code = (
        "from greygate import system\nsystem.resource.setrlimit = lambda *_: None\nprint(system.limit(1 << 28, 9, 1))"
    )
    assert children.ran(children.python("-c", code)).stdout.strip() == "False"
    assert children.ran(children.python("-c", code.replace("setrlimit", "other"))).stdout.strip() == "True"


def test_two_writers_without_posix_exclude_each_other(given):
    hold = (
        "import sys; from greygate.files import locked\n"
        "with locked('x'):\n    print('held', flush=True); sys.stdin.readline()\n"
    )
    variables = {**os.environ, "PYTHONPATH": str(ELSEWHERE)}
    piped = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", hold], cwd=given, env=variables, **piped) as holder:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(InputError, match="another greygate is writing it"), locked(given / "x"):
            pytest.fail("both hold it")
        second = subprocess.run([sys.executable, "-c", hold], cwd=given, env=variables, capture_output=True, text=True)
        assert "another greygate is writing it" in second.stderr
        holder.communicate("\n")
    with locked(given / "x"):
        pass


def test_a_system_without_any_lock_is_refused(monkeypatch, tmp_path):
    for name in ("fcntl", "msvcrt"):
        monkeypatch.setattr(system, name, None)
    with pytest.raises(OSError, match="neither fcntl nor msvcrt"), locked(tmp_path / "x"):
        pytest.fail("it holds nothing")


class Kernel:
    """What of kernel32 a job needs; a job is a list of processes here."""

    def __init__(self, failing: str = ""):
        self.failing, self.calls, self.held = failing, [], []

    def __getattr__(self, name):
        def call(*arguments):
            self.calls.append(name)
            if name == self.failing:
                return 0
            if name == "SetInformationJobObject":
                self.flags = arguments[2]._obj.flags
            if name == "AssignProcessToJobObject":
                self.held.append(arguments[1].value)
            if name in ("TerminateJobObject", "CloseHandle"):
                while self.held:
                    os.kill(self.held.pop(), signal.SIGKILL)
            return 7

        return call


class Windows(subprocess.Popen):
    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self._handle = self.pid


@pytest.fixture
def kernel(monkeypatch):
    def made(failing: str = "") -> Kernel:
        found = Kernel(failing)
        monkeypatch.setattr(system, "WINDOWS", True)
        monkeypatch.setattr(system, "Popen", Windows)
        monkeypatch.setattr(ctypes, "WinDLL", lambda *_, **__: found, raising=False)
        monkeypatch.setattr(ctypes, "get_last_error", lambda: 5, raising=False)
        return found

    return made


def test_on_windows_a_job_ends_all_that_was_started(kernel):
    found = kernel()
    with children.started(["sleep", "600"]) as process:
        assert process.poll() is None
    assert process.returncode == -signal.SIGKILL
    assert found.flags == 0x2000  # JOB_OBJECT_LIMIT_KILL_ON_JOB_CLOSE
    assert found.calls == [
        "CreateJobObjectW", "SetInformationJobObject", "AssignProcessToJobObject", "TerminateJobObject", "CloseHandle",
    ]  # fmt: skip
    assert (ctypes.sizeof(system._Limits), system._Limits.flags.offset) == (144, 16)  # of 64-bit Windows


@pytest.mark.parametrize("failing", ["CreateJobObjectW", "SetInformationJobObject", "AssignProcessToJobObject"])
def test_on_windows_nothing_runs_outside_a_job(kernel, failing):
    kernel(failing)
    with pytest.raises(OSError, match=failing), children.started(["sleep", "600"]):
        pytest.fail("it runs")


def test_readme_classifiers_and_workflow_name_the_same_systems():
    told = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["classifiers"]
    assert [c for c in told if c.startswith("Operating System")] == ["Operating System :: POSIX :: Linux"]
    readme, workflow = ((ROOT / n).read_text() for n in ("README.md", ".github/workflows/systems.yml"))
    assert "tested on Linux" in readme
    for name in ("ubuntu-latest", "macos-latest", "windows-latest"):
        assert name in workflow
