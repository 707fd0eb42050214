import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from checking import valid
from networks import delay_line
from typer.testing import CliRunner

from greygate import __version__, cli
from greygate.cli import app
from greygate.errors import InputError
from greygate.files import replacing_folder
from greygate.hardware.build import Project
from greygate.machines.catalog import CATALOG
from greygate.models.families.library import library
from greygate.models.network import Layer, Network, Port
from greygate.models.training import levenberg as training
from greygate.plants.recording import Recording

GREYGATE = str(Path(sys.executable).with_name("greygate"))


def installed(*arguments):
    """The installed command in a process of its own: exit code, stdout, stderr."""
    done = subprocess.run([GREYGATE, *map(str, arguments)], capture_output=True, text=True)
    return done.returncode, done.stdout, done.stderr


def recording(
    path: Path, header: str = "t_s,u_V,y_m", steps: int = 60, spoil=lambda rows: rows, reach=3, dt=1e-3
) -> Path:
    rng = np.random.default_rng(0)
    u = rng.uniform(-1, reach, steps)
    y = delay_line().run({"u": u})["y"] if steps else u
    rows = [[f"{k * dt:.3f}", repr(float(a)), repr(float(b))] for k, (a, b) in enumerate(zip(u, y, strict=True))]
    path.write_text("\n".join([header, *map(",".join, spoil(rows))]) + "\n")
    return path


@pytest.fixture
def network(tmp_path) -> Path:
    delay_line().save(tmp_path / "line")
    return tmp_path / "line.toml"


@pytest.fixture
def built(tmp_path, network, greygate) -> Path:
    code, _, error = greygate("compile", network, f"train={recording(tmp_path / 'a.csv')}", "--out", tmp_path / "build")
    assert code == 0, error
    return tmp_path / "build"


def test_the_version_and_the_catalogue_are_printed():
    assert installed("--version") == (0, f"greygate {__version__}\n", "")
    code, out, _ = installed("train", "list", "--json")
    assert code == 0
    assert set(json.loads(out)) == set(CATALOG)


def test_a_users_network_is_trained_on_a_users_recordings(tmp_path, network, greygate):
    """From weights that are off; the recording can be fitted exactly."""
    start = Network.load(network)
    off = {name: 0.8 * value + 0.01 for name, value in start.parameters().items()}
    start.with_parameters(off).save(tmp_path / "off")
    out, record = tmp_path / "out", recording(tmp_path / "a.csv", steps=300)
    out.mkdir()
    code, text, error = greygate("train", tmp_path / "off.toml", record, "--out", out, "--json")
    assert code == 0, error
    figures = json.loads(text)
    assert figures["rmse"]["a"]["y"] < 1e-4
    assert {"schema": "greygate/train/1"} | json.loads((out / "line.json").read_text()) == figures
    u = np.linspace(-1, 1, 50)
    assert Network.load(out / "line").run({"u": u})["y"] == pytest.approx(delay_line().run({"u": u})["y"], abs=1e-3)


@pytest.mark.usefixtures("alone")
def test_a_recording_that_starts_in_motion_is_trained_and_judged_from_a_state_of_its_own(tmp_path, network, greygate):
    def moving(path, state):
        u = np.random.default_rng(0).uniform(-1, 3, 200)
        y = delay_line().run({"u": u}, initial={"sum": state})["y"]
        rows = [f"{k * 1e-3:.3f},{float(a)!r},{float(b)!r}" for k, (a, b) in enumerate(zip(u, y, strict=True))]
        path.write_text("\n".join(["t_s,u_V,y_m", *rows]) + "\n")
        return path

    files = moving(tmp_path / "a.csv", 40.0), moving(tmp_path / "b.csv", -30.0)
    common = ["train", network, files[0], "--held", files[1], "--json", "--epochs", "30"]
    for settle, good in ((0, False), (20, True)):
        code, text, error = greygate(*common, "--settle", settle, "--out", tmp_path / "new" / str(settle))
        assert code == 0, error
        assert all((errors["y"] < 1e-3) == good for errors in json.loads(text)["rmse"].values())
    code, _, error = greygate("train", network, files[0], "--held", f"x={files[0]}", "--out", tmp_path / "n")
    assert (code, "given twice" in error) == (2, True)


def test_a_training_that_is_refused_leaves_no_folder(tmp_path, network, greygate):
    record, out = recording(tmp_path / "a.csv"), tmp_path / "new"
    code, _, error = greygate("train", network, record, "--decay", "-1", "--out", out)
    assert (code, "decay -1" in error) == (2, True)
    assert not out.exists()


@pytest.mark.usefixtures("alone")
def test_a_library_network_that_is_trained_within_a_whole_keeps_its_meaning(tmp_path, greygate):
    whole = Network("whole", [Port("s"), Port("a"), Port("b")], [Port("y")])
    whole.add("switch", library("switch_2"))
    whole.add("gain", Layer({"x": [[0.5]]}, [0.0]))
    for port, name in zip(whole.modules["switch"].inputs, ("s", "a", "b"), strict=True):
        whole.connect(name, f"switch.{port.name}")
    whole.connect("switch", "gain.x")
    whole.connect("gain", "y")
    whole.save(tmp_path / "whole")
    rng = np.random.default_rng(0)
    signals = {n: np.round(rng.uniform(-0.9, 0.9, 100), 3) for n in "sab"}
    y = 2.0 * whole.run(signals)["y"]
    lines = ["t_s,s_1,a_1,b_1,y_1"]
    lines += [
        ",".join(map(repr, map(float, row))) for row in zip(np.arange(100) / 1000, *signals.values(), y, strict=True)
    ]
    (tmp_path / "r.csv").write_text("\n".join(lines) + "\n")
    code, _, error = greygate("train", tmp_path / "whole.toml", tmp_path / "r.csv", "--out", tmp_path / "out")
    assert code == 0, error
    trained = Network.load(tmp_path / "out" / "whole")
    assert trained.modules["switch"].meaning == whole.modules["switch"].meaning
    assert trained.parameters()["gain.x"].item() == pytest.approx(1.0, abs=1e-6)


def test_weights_are_pruned_by_saliency_on_request(tmp_path, network, greygate):
    record = f"train={recording(tmp_path / 'a.csv', steps=300)}"
    code, out, error = greygate("compile", network, record, "--weights", "obs", "--out", tmp_path / "b")
    assert code == 0, error
    assert "prune" in out
    code, _, error = greygate("compile", network, record, "--weights", "guess", "--out", tmp_path / "c")
    assert code == 2
    assert "there are magnitude, obd" in error


@pytest.mark.parametrize("how", [("--weights", "obs"), ("--prune", "1.02")])
def test_pruning_keeps_what_a_held_recording_shows_and_every_recording_is_printed(tmp_path, how, greygate, monkeypatch):
    """v moves in the second recording alone; what it acts through looks idle in the first."""
    monkeypatch.chdir(tmp_path)
    network = Network("two", [Port("u", "V"), Port("v", "V")], [Port("y", "m")])
    network.add("hidden", Layer({"u": [[0.5], [0.0]], "v": [[0.0], [0.5]]}, [0.1, 0.0], "tansig"))
    network.add("out", Layer({"hidden": [[1.0, 1.0]]}, [0.0]))
    for source, target in (("u", "hidden.u"), ("v", "hidden.v"), ("hidden", "out.hidden"), ("out", "y")):
        network.connect(source, target)
    network.save(tmp_path / "two")
    rng = np.random.default_rng(0)
    for name, reach in (("still", 0.0), ("moved", 1.0)):
        inputs = {"u": rng.uniform(-1, 1, 200), "v": reach * rng.uniform(-1, 1, 200)}
        y = network.run(inputs)["y"] + 0.01 * rng.normal(size=200)
        Recording(1e-3, inputs | {"y": y}, {"u": "V", "v": "V", "y": "m"}).write_csv(tmp_path / f"{name}.csv")

    def rmse(*arguments) -> dict:
        given = ["compile", "two.toml", "still.csv", *how, *arguments, "--json", "--out", "b"]
        code, out, error = greygate(*given)
        assert code == 0, error
        return json.loads(out)["rmse"]

    assert list(rmse()) == ["still"]
    weights = Network.load("b/network").layers()["hidden"].weights
    assert not np.any(weights.get("v", 0.0))
    for given in (["moved.csv"], ["--held", "moved.csv"]):
        seen = rmse(*given)
        assert list(seen) == ["still", "moved"]
        assert seen["moved"]["y"]["before"] == pytest.approx(0.01, rel=0.1)
        assert seen["moved"]["y"]["float"] <= 1.02 * seen["moved"]["y"]["before"]


def test_recordings_set_the_ranges_but_for_a_held_one_of_which_it_is_said_that_it_leaves_them(
    tmp_path, network, greygate, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    recording(tmp_path / "a.csv")
    recording(tmp_path / "big.csv", reach=90)

    def holds(*arguments) -> tuple[float, str]:
        code, out, error = greygate("compile", "line.toml", "a.csv", *arguments, "--out", "b")
        assert code == 0, error
        program = Project.open("b").program
        return float(program.inputs[0].values(np.array([program.inputs[0].signal.fix.hi]))[0]), out

    both, said = holds("big.csv")
    assert both > 89.7461
    assert "its word holds" not in said
    assert Project.open("b").source.training == ("a", "big")
    first, said = holds("--held", "big.csv")
    assert first < 10
    assert "of its range on big: u is -0.750796 to 89.7461 on big, its word holds -7 to" in said
    code, out, _ = greygate(
        "explore", "line.toml", "a.csv", "--held", "big.csv", "--target", "up5k", "--max-error", "1%", "--out", "c"
    )
    assert code == 1
    assert "u is -0.750796 to 89.7461 on big, its word holds" in out


def test_a_users_network_goes_the_whole_road(tmp_path, built, greygate):
    code, out, _ = greygate("verify", built, "--seed", 1, "--json")
    assert code == 0
    found = json.loads(out)
    assert found["passed"]
    assert {(v["architecture"], v["steps"]) for v in found["verdicts"]} == {("parallel", 60), ("folded", 60)}
    assert (built / "results-parallel.xml").exists()
    code, out, _ = greygate("emulate", built, tmp_path / "a.csv", "--out", tmp_path / "p.csv", "--json")
    assert code == 0
    assert json.loads(out)["steps"] == 60
    assert (tmp_path / "p.csv").read_text().startswith("t_s,y_m\n")
    code, out, _ = greygate("report", built, "--html", tmp_path / "r.html", "--json")
    assert code == 0
    (study,) = json.loads((tmp_path / "r.json").read_text())
    assert json.loads(out) == [study]
    valid("report", [study])
    assert study["scenarios"]["train"]["outputs"]["y"]["hardware"]["parallel"]["equals_fixed"]


def test_changed_verilog_is_not_run_unless_that_is_asked_for(built, greygate):
    layer = next((built / "rtl" / "parallel").glob("*_sum.v"))
    text = layer.read_text()
    assert " + " in text
    layer.write_text(text.replace(" + ", " - ", 1))
    code, out, error = greygate("verify", built, "--seed", 1)
    assert (code, out, error.count("\n")) == (2, "", 1)
    assert f"{layer}: is not the Verilog of program.json" in error


def test_compiling_again_replaces_the_folder_and_forgets_what_was_verified(tmp_path, network, built, greygate):
    (built / "verify.json").write_text("{}")
    code, _, _ = greygate("compile", network, f"t={tmp_path / 'a.csv'}", "--out", built, "--architecture", "folded")
    assert code == 0
    assert not (built / "verify.json").exists()
    assert not (built / "rtl" / "parallel").exists()


TWO_TIMES = "slow.csv: sampled every 0.01 s, a.csv every 0.001 s; resample it: greygate look slow.csv"


def swapped(rows, row, column, text):
    rows[row][column] = text
    return rows


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda p: recording(p, header="t_s,u,y_m"), "unit"),
        (lambda p: recording(p, header="t_s,u_A,y_m"), "u"),
        (lambda p: recording(p, header="t_s,w_V,y_m"), "u"),
        (lambda p: recording(p, header="clock,u_V,y_m"), "t_s"),
        (lambda p: recording(p, spoil=lambda r: swapped(r, 5, 0, "0.0055")), "uniform"),
        (lambda p: recording(p, spoil=lambda r: swapped(r, 5, 1, "nan")), "nan"),
        (lambda p: recording(p, spoil=lambda r: swapped(r, 5, 2, "inf")), "inf"),
        (lambda p: recording(p, spoil=lambda r: swapped(r, 5, 1, "lots")), "lots"),
        (lambda p: recording(p, spoil=lambda r: [*r[:7], r[7][:2], *r[8:]]), "a.csv"),
        (lambda p: recording(p, steps=0), "a.csv"),
        (lambda p: p, "a.csv"),
    ],
)
def test_a_bad_recording_is_named_in_one_line_and_nothing_is_written(
    tmp_path, network, make, message, greygate, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    before = {*tmp_path.iterdir(), make(tmp_path / "a.csv")}
    code, out, error = greygate("compile", network, "t=a.csv", "--out", "build")
    assert (code, out) == (2, "")
    assert error.count("\n") == 1
    assert error.startswith("greygate: ")
    assert message in error
    assert {*tmp_path.iterdir()} <= before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["compile", "nobody", "--out", "b"], "no network is called 'nobody'"),
        (["compile", "missing.toml", "t=a.csv", "--out", "b"], "missing.toml: no such file"),
        (["compile", "line.toml", "--out", "b"], "no recordings"),
        (["compile", "line.toml", "=a.csv", "--out", "b"], "write SCENARIO=FILE.csv"),
        (["validate", "line.toml"], "line.toml: no recordings; give FILE.csv after it\n"),
        (["compile", "line.toml", "a.csv", "slow.csv", "--out", "b"], TWO_TIMES),
        (["validate", "line.toml", "a.csv", "slow.csv"], TWO_TIMES),
        (["compile", "line.toml", "--held", "a.csv", "--prune", "1.1", "--out", "b"], "a sets the ranges"),
        (["compile", "line.toml", "t=a.csv", "--width", "3", "--out", "b"], "--width 3: give 4 to 32 bits"),
        (["compile", "line.toml", "t=big.csv", "--width", "8", "--out", "b"], "8 bits cannot hold"),
        (["compile", "line.toml", "t=a.csv", "--max-error", "0.5x", "--out", "b"], "--max-error 0.5x"),
        (["compile", "line.toml", "t=a.csv", "--prune", "0.5", "--out", "b"], "--prune 0.5"),
        (["compile", "line.toml", "t=a.csv", "--macs", "0", "--out", "b"], "--macs 0: give 1 to 256"),
        (["compile", "line.toml", "t=a.csv", "--out", "/proc/b"], "cannot make this folder"),
        (["compile", "line.toml", "t=a.csv", "--out", "other"], "holds other files"),
        (["compile", "line.toml", "t=a.csv", "--out", "a.csv"], "a file of that name is in the way"),
        (["verify", "other"], "run greygate compile first"),
        (["report", "other"], "run greygate compile first"),
        (["train", "nobody"], "no network is called 'nobody'"),
        (["train", "crane", "--out", "nowhere"], "no such folder"),
        (["train", "crane"], "--out is missing; give the folder to write"),
        (
            ["train", "crane", "--epochs", "5", "--no-narx"],
            "crane is trained with its own options; give --narx, --epochs with",
        ),
        (["train", "line.toml", "a.csv", "--settle", "60", "--out", "b"], "skips 60 of its 60 samples"),
        (
            ["train", "line.toml", "a.csv", "--shooting", "31", "--out", "b"],
            "give windows of 1 to 30 steps",
        ),
        (["validate", "line.toml", "a.csv", "--settle", "61"], "skips 61 of its 60 samples"),
        (["validate", "line.toml", "a.csv", "--lags", "25"], "60 samples are too few for 25 lags"),
    ],
)
def test_wrong_use_is_one_line_with_exit_code_2_and_nothing_is_left(
    tmp_path, network, arguments, message, greygate, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    recording(tmp_path / "a.csv")
    recording(tmp_path / "big.csv", reach=900)
    recording(tmp_path / "slow.csv", dt=1e-2)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    code, out, error = greygate(*arguments)
    assert (code, out) == (2, "")
    assert message in error
    assert error.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


def test_a_truncated_network_file_is_named(tmp_path, network, greygate):
    numbers = network.with_suffix(".safetensors")
    numbers.write_bytes(numbers.read_bytes()[:40])
    recording(tmp_path / "a.csv")
    code, _, error = greygate("compile", network, f"t={tmp_path / 'a.csv'}", "--out", tmp_path / "b")
    assert code == 2
    assert "not a readable network" in error
    assert not (tmp_path / "b").exists()


def test_a_scenario_that_does_not_exist_is_named(built, greygate):
    code, _, error = greygate("verify", built, "--scenario", "v9")
    assert code == 2
    assert "no scenario 'v9'; there are train" in error


def heeding():
    """Heed Ctrl-C in a child: those of a job in the background ignore it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.parametrize(
    ("number", "code", "said"),
    [(signal.SIGINT, 130, b"greygate: interrupted\n"), (signal.SIGTERM, 143, b"")],
)
def test_an_interrupted_compilation_leaves_nothing_behind(tmp_path, number, code, said):
    process = subprocess.Popen(
        [GREYGATE, "compile", "valve_cylinder", "--prune", "1.01", "--out", "build"],
        cwd=tmp_path,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        preexec_fn=heeding,
    )
    until = time.monotonic() + 60
    while not os.listdir(tmp_path) and time.monotonic() < until:  # it is at work once its folder stands
        time.sleep(0.1)
    process.send_signal(number)
    _, error = process.communicate(timeout=30)
    told = b"".join(line for line in error.splitlines(True) if not line.startswith(b"compiling"))
    assert (process.returncode, told) == (code, said)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(("asked", "lines"), [("", 1), ("cli._stopped.append(KeyboardInterrupt())", 0)])
def test_what_a_signal_left_half_made_is_not_told(asked, lines):
    program = f"""
import sys
import greygate.cli as cli
class Half:
    def __del__(self):
        self.handle.close()
{asked or "pass"}
sys.unraisablehook = cli._ignored
Half()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert done.stderr.count("no attribute 'handle'") == lines


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_what_a_signal_left_half_made_is_not_freed_before_the_end(name):
    """Once llvmlite's own handler has run at the exit, it frees nothing more."""
    program = f"""
import os, signal
import greygate.cli as cli
from llvmlite.binding.common import _is_shutting_down
class Half:
    def __del__(self):
        os.write(1, b"at the end" if _is_shutting_down() else b"too early")
def app(**_):
    half = Half()
    os.kill(os.getpid(), signal.{name})
    raise AssertionError
cli.app = app
cli.run()
"""
    called = [sys.executable, "-c", program]
    done = subprocess.run(called, capture_output=True, text=True, preexec_fn=heeding, timeout=60)
    assert (done.returncode, done.stdout) == ({"SIGINT": 130, "SIGTERM": 143}[name], "at the end")


@pytest.mark.parametrize("second", [0.1, 0.4])
def test_ctrl_c_while_it_starts_is_one_line_too(second, tmp_path):
    """Of a command that takes seconds, so that it cannot be done before."""
    program, out = "import greygate.__main__ as m; print(flush=True); m.run()", str(tmp_path / "built")
    process = subprocess.Popen(
        [sys.executable, "-c", program, "compile", "valve_cylinder", "--prune", "1.0", "--out", out],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=heeding,
    )
    process.stdout.readline()
    time.sleep(second)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=30)[1] == b"greygate: interrupted\n"
    assert process.returncode == 130


@pytest.mark.parametrize(("number", "code"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_a_signal_that_python_ignores_in_a_callback_is_sent_again(number, code):
    program = f"""
import os, signal, sys, time
from greygate import cli, doctor
class Callback:
    def __del__(self):
        os.kill(os.getpid(), signal.{number})
        time.sleep(0.001)
def at_work(*_):
    Callback()
    try:
        time.sleep(20)
    finally:
        print("tidied")
doctor.tools = at_work
sys.argv = ["greygate", "doctor"]
cli.run()
"""
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, preexec_fn=heeding)
    assert (done.returncode, done.stdout) == (code, "tidied\n")
    assert done.stderr == ("greygate: interrupted\n" if number == "SIGINT" else "")


def test_a_failure_while_writing_leaves_the_earlier_folder_as_it_was(tmp_path):
    target = tmp_path / "build"
    with replacing_folder(target, "compile") as new:
        (new / "compile.json").write_text("old")

    def fail():
        with replacing_folder(target, "compile") as new:
            (new / "half").write_text("x")
            raise InputError("broken")

    with pytest.raises(InputError, match="broken"):
        fail()
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["build", "compile.json", "manifest.json"]


def test_help_names_every_command():
    text = CliRunner().invoke(app, ["--help"]).stdout
    for command in ("train", "compile", "emulate", "verify", "prove", "synthesize", "report", "validate"):
        assert command in text
    assert cli.__doc__


def unstable() -> Network:
    """Its own feedback, which no training may move, makes every long free run diverge."""
    network = Network("line", [Port("u", "V")], [Port("y", "m")])
    network.add("sum", Layer({"u": [[0.5]], "own": [[30.0]]}, [0.0], frozen=frozenset({"own"})))
    network.connect("u", "sum.u")
    network.connect("sum", "sum.own", delay=1)
    network.connect("sum", "y")
    return network


@pytest.mark.usefixtures("alone")
@pytest.mark.parametrize(
    "how",
    [
        [],
        ["--tail", "0.2"],
        *(pytest.param(h.split(), marks=pytest.mark.nightly) for h in ("--seconds 60", "--settle 3")),
    ],
)
def test_a_training_whose_free_run_diverges_falls_back_to_shooting_and_says_so(tmp_path, how, monkeypatch, greygate):
    unstable().save(tmp_path / "line")
    record = recording(tmp_path / "a.csv", steps=300)
    windows = []
    problem = training.Objective

    def watched(*arguments, shooting=None, **options):
        windows.append(shooting)
        return problem(*arguments, shooting=shooting, **options)

    monkeypatch.setattr(training, "Objective", watched)
    out = tmp_path / "out"
    code, printed, error = greygate("train", tmp_path / "line.toml", record, "--epochs", 4, "--out", out, *how)
    assert (code, "Traceback" in error) == (1, False)
    assert {w for w in windows if w is not None} == {12 if "--tail" in how else 15}
    assert "The free run diverges" in printed
    assert "RMSE inf" in printed
    assert json.loads((out / "line.json").read_text())["rmse"]["a"]["y"] is None


PLANT = """
step = 1e-3
outputs = ["y"]
[inputs]
u = "m"
[parameters]
gain = [1.0, "1/s"]
[states]
y = { unit = "m" }
[equations.motion]
y = { own = "gain * y", drive = "u" }
"""
RIG = """
plant = "plant.toml"
sample_time_s = 0.01
predict = ["y"]
parameters = {{ gain = {gain} }}
channels.u = {{ unit = "m", role = "input" }}
channels.y = {{ unit = "m", role = "output", noise_rms = 0.001 }}
"""


@pytest.fixture
def rig(tmp_path) -> Path:
    """Thirty seconds of a plant of one's own, which falls back to rest."""
    folder = tmp_path / "rig"
    folder.mkdir()
    (folder / "plant.toml").write_text(PLANT)
    (folder / "rig.toml").write_text(RIG.format(gain=-1.0))
    rows = [f"{k / 100:.2f},{np.sin(k / 50):.4f},{np.sin(k / 50 - 1) / 2:.4f}" for k in range(3000)]
    (folder / "run.csv").write_text("\n".join(["t,u,y", *rows]) + "\n")
    return folder


def test_a_simulation_that_diverges_is_told_with_exit_code_1(rig, tmp_path, greygate):
    (rig / "rig.toml").write_text(RIG.format(gain=50.0))
    out = tmp_path / "out.csv"
    code, printed, error = greygate("simulate", rig, rig / "run.csv", "--out", out)
    assert (code, error) == (1, "greygate: the simulation diverges\n")
    assert printed.startswith("y          RMS of simulated minus recorded inf m\n")
    assert out.read_text().endswith(",nan\n")


@pytest.mark.parametrize(
    "written",
    [
        lambda text: text + "\n\n",
        lambda text: text.replace("\n", "\n\n"),
        lambda text: text.replace(",", ";").replace(".", ","),
        lambda text: "\ufeff" + text.replace("\n", "\r\n"),
    ],
)
def test_a_simulation_reads_its_times_as_it_reads_its_channels(rig, tmp_path, written, greygate):
    greygate("simulate", rig, rig / "run.csv", "--out", tmp_path / "plain.csv")
    (rig / "run.csv").write_text(written((rig / "run.csv").read_text()), newline="")
    code, _, error = greygate("simulate", rig, rig / "run.csv", "--out", tmp_path / "out.csv")
    assert (code, error) == (0, "")
    assert (tmp_path / "out.csv").read_text() == (tmp_path / "plain.csv").read_text()


def test_a_reader_that_closes_early_hears_no_traceback(tmp_path):
    done = subprocess.run(
        f"set -o pipefail; {GREYGATE} train list | true",
        shell=True,
        executable="/bin/bash",
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("command", ["diagnose", "isolability"])
def test_a_rig_in_which_nothing_is_uncertain_is_refused_in_a_line(rig, command, greygate):
    (rig / "run.csv").rename(rig / "identify.csv")
    code, printed, error = greygate(command, rig)
    assert (code, printed) == (2, "")
    assert error.endswith("rig.toml: tolerance: no parameter is uncertain; give at least one, e.g. 0.01\n")


def test_a_rig_whose_simulation_explodes_is_refused_in_a_line(rig, greygate):
    (rig / "rig.toml").write_text(RIG.format(gain=50.0) + "tolerance = { gain = 0.1 }\n")
    (rig / "run.csv").rename(rig / "identify.csv")
    code, printed, error = greygate("diagnose", rig)
    assert (code, printed) == (2, "")
    (said,) = [line for line in error.splitlines() if not line.startswith("diagnosing: ")]  # progress of a slow machine
    assert "the simulation of y diverges, whatever the parameters" in said


def completed(words: str) -> list[str]:
    """What bash offers for the last of these words."""
    wish = {"_GREYGATE_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    done = subprocess.run([GREYGATE], env={**os.environ, **wish}, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split()


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("greygate comp", ["compile", "compare"]),
        ("greygate export f", ["fmu", "fusesoc"]),
        ("greygate explore build --max-l", ["--max-latency", "--max-luts"]),
        ("greygate synthesize build --target ice", ["ice40"]),
        ("greygate compile valve", [name for name in CATALOG if name.startswith("valve")]),
        ("greygate compile ./mi", []),  # left to the shell: a file
    ],
)
def test_the_shell_completes_commands_options_and_names(words, offered):
    assert completed(words) == offered


def test_a_command_loads_only_what_it_needs():
    heavy = "{'numba', 'scipy', 'torch', 'plotly'} & set(sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", f"import greygate.cli, sys; print({heavy})"], capture_output=True)
    assert loaded.stdout == b"set()\n"


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_that_a_library_turns_into_an_error_of_its_own_is_no_traceback(number, code, monkeypatch, capsys):
    def compiling(**_):
        try:
            os.kill(os.getpid(), number)
            time.sleep(1)
        except BaseException as error:
            raise RuntimeError("lowering failed") from error

    monkeypatch.setattr(cli, "app", compiling)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
    try:
        with pytest.raises(SystemExit) as ended:
            cli.run()
    finally:
        signal.signal(signal.SIGINT, before)
    assert ended.value.code == code
    assert "lowering" not in capsys.readouterr().err
