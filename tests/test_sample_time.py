"""The sample time of a network: where it is set, what keeps it, and every place that refuses a recording of another."""

import hashlib
import json
import shlex
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.thesis.noise import box_jenkins, free_run
from greygate.compiler.pipeline import compile_network
from greygate.control.prediction import Prediction, hats, knots, online
from greygate.errors import InputError
from greygate.hardware.build import Project
from greygate.identify import files
from greygate.machines.catalog import CATALOG, CONTROLLED, task
from greygate.machines.control import CONTROL
from greygate.machines.kept import PRUNED
from greygate.models.families.regression import noe
from greygate.models.network import Network, Port
from greygate.models.sampling import resampling, spoken
from greygate.models.simplify import SIMPLIFICATIONS
from greygate.models.storage import TRAINED
from greygate.models.training.record import Record
from greygate.models.validation import validate
from greygate.plants.recording import read_csv

pytestmark = pytest.mark.usefixtures("alone")

CASE = Path("/work/shared/cases/sample_time")
U, Y = Port("u", "V"), Port("y", "m")


def lag(dt: float | None = None) -> Network:
    """y(k) = 0.9 y(k-1) + 0.1 u(k-1)."""
    found = noe("lag", {U: (1,)}, Y, (1,))
    return replace(found.with_parameters({"sum.y_z1": [[0.9]], "sum.u_z1": [[0.1]]}), dt=dt)


def signals(samples: int = 600) -> dict[str, np.ndarray]:
    u = np.repeat(np.random.default_rng(0).uniform(-1, 1, samples // 10), 10)
    return {"u": u, **lag().run({"u": u})}


def record(path: Path, dt: float, header: str = "t_s,u_V,y_m") -> Path:
    rows = zip(signals()["u"], signals()["y"] + 1e-3 * np.random.default_rng(1).normal(size=600), strict=True)
    lines = [f"{k * dt:.9g},{u!r},{y!r}" for k, (u, y) in enumerate((float(u), float(y)) for u, y in rows)]
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


@pytest.fixture
def place(tmp_path, monkeypatch, greygate) -> Path:
    """out/lag.toml, trained on slow.csv of 10 ms; `the bench/fast run.csv` of 2 ms. It is the current folder."""
    monkeypatch.chdir(tmp_path)
    lag().save("lag")
    record(Path("slow.csv"), 0.01)
    Path("the bench").mkdir()
    record(Path("the bench/fast run.csv"), 0.002)
    words = ["slow.csv", "--no-narx", "--epochs", "1", "--out", "out"]
    code, _, error = greygate("train", "lag.toml", *words)
    assert (code, "sample time" in error) == (0, False)
    return tmp_path


@pytest.fixture
def build(place, greygate) -> Path:
    words = ["slow.csv", "--architecture", "parallel", "--out", "build"]
    assert greygate("compile", "out/lag.toml", *words)[0] == 0
    return place / "build"


FAST = "the bench/fast run.csv"
SAID = "sample time 2 ms, the network lag was made for 10 ms; resample it: "
COMMANDS = {
    "validate": ("validate", "out/lag.toml", FAST),
    "compile": ("compile", "out/lag.toml", FAST, "--architecture", "c99", "--out", "other"),
    "compile held": ("compile", "out/lag.toml", "slow.csv", "--held", FAST, "--prune", "1.1", "--out", "o"),
    "train": ("train", "out/lag.toml", FAST, "--no-narx", "--epochs", "1", "--out", "more"),
    "emulate": ("emulate", "build", FAST, "--out", "predicted.csv"),
}


@pytest.mark.parametrize("words", COMMANDS.values(), ids=COMMANDS)
def test_a_recording_of_another_sample_time_is_refused_and_taken_once_the_printed_command_ran(build, greygate, words):
    before = set(build.parent.rglob("*"))
    code, out, error = greygate(*words)
    assert (code, out, error.count("\n")) == (2, "", 1)
    told, _, command = error.rstrip("\n").partition(SAID)
    assert told == "greygate: fast run.csv: "
    assert set(build.parent.rglob("*")) == before
    name, *resample = shlex.split(command)
    assert (name, greygate(*resample)[0]) == ("greygate", 0)
    given = resample[resample.index("--out") + 1]
    code, _, error = greygate(*(given if word == FAST else word for word in words))
    assert (code, "sample time" in error) == (0, False), error


def test_play_refuses_it_before_it_opens_the_port(build, greygate):
    code, _, error = greygate("play", "build", FAST, "--port", "no such port")
    assert (code, SAID in error) == (2, True)


def test_verify_and_report_refuse_a_recording_that_has_become_another_one(build, greygate):
    record(Path("slow.csv"), 0.002)
    for words in (("verify", "build"), ("report", "build", "--html", "r.html"), ("compare", "build", "build")):
        code, _, error = greygate(*words)
        assert (code, SAID in error) == (2, True), words


def test_a_build_of_before_networks_had_a_sample_time_has_that_of_its_program(build, greygate):
    kept, manifest = build / "network.toml", build / "manifest.json"
    kept.write_text(kept.read_text().replace("dt = 0.01\n", ""))
    assert "dt" not in tomllib.loads(kept.read_text())
    listed = json.loads(manifest.read_text())
    listed["files"]["network.toml"] = hashlib.sha256(kept.read_bytes()).hexdigest()
    manifest.write_text(json.dumps(listed))
    assert Project.open(build).network.dt == 0.01
    code, _, error = greygate("emulate", "build", FAST, "--out", "predicted.csv")
    assert (code, SAID in error) == (2, True)


@pytest.mark.parametrize(("dt", "code"), [(0.010004, 0), (0.009995, 0), (0.0101, 2), (0.02, 2)])
def test_a_sample_time_is_equal_to_the_error_of_a_printed_time(place, greygate, dt, code):
    record(Path("other.csv"), dt)
    assert greygate("validate", "out/lag.toml", "other.csv")[0] == code


def test_init_writes_the_sample_time_too(place, greygate):
    assert greygate("init", "slow.csv", "--out", "begun", "--output", "y")[0] == 0
    assert Network.load("out/lag").dt == Network.load("begun").dt == 0.01
    assert greygate("init", "slow.csv", "--out", "script", "--output", "y", "--python")[0] == 0
    assert "dt=recording.dt" in Path("script.py").read_text()


def test_the_network_that_identify_finds_has_the_sample_time_of_its_recordings(tmp_path, monkeypatch):
    class Search:
        clock = SimpleNamespace(spent=lambda: 0.0)

        def __init__(self, task, *_):
            self.task = task

        def run(self, *_):
            pass

        def final(self):
            return None, SimpleNamespace(network=lag())

    monkeypatch.setattr(files, "Halving", Search)
    recording = read_csv(record(tmp_path / "slow.csv", 0.01))
    assert files.identify({"slow": recording}, ["u"], "y", {}, seconds=1.0, jobs=1).network.dt == 0.01


@pytest.mark.parametrize(
    "words", [("validate",), ("compile", "--architecture", "c99", "--out", "b")], ids=lambda w: w[0]
)
def test_a_network_that_does_not_say_its_sample_time_is_taken_at_its_recordings_with_a_line(place, greygate, words):
    code, _, error = greygate(words[0], "lag.toml", FAST, *words[1:])
    line = f"network lag does not say its sample time; taken as that of {FAST} (2 ms)"
    assert (code, error.splitlines()) == (0, [line])
    if words[0] == "compile":
        assert tomllib.loads(Path("b/network.toml").read_text())["dt"] == 0.002


def test_a_recording_in_another_unit_of_the_house_is_converted_whatever_its_form(place, greygate):
    replace(noe("lag", {U: (1,)}, Port("p", "Pa"), (1,)), dt=0.01).save("pascal")
    record(Path("bar.csv"), 0.01, "t_s,u_V,p_bar")
    assert greygate("validate", "pascal.toml", "bar.csv")[0] == 0


@pytest.mark.parametrize("dt", ["0", "-0.01", "1e400", "nan", '"10 ms"', "true"])
def test_a_file_with_a_sample_time_that_is_none_is_refused(tmp_path, dt):
    lag(0.01).save(tmp_path / "lag")
    path = tmp_path / "lag.toml"
    path.write_text(path.read_text().replace("dt = 0.01", f"dt = {dt}"))
    with pytest.raises(InputError, match="dt"):
        Network.load(path)


def test_whatever_makes_a_network_of_another_keeps_its_sample_time(tmp_path):
    network = lag(0.01)
    network.save(tmp_path / "kept")
    drive = Prediction(network, "u", hats(knots(8, 3)))
    made = {
        "load": Network.load(tmp_path / "kept"),
        "flatten": network.flatten(),
        "with_parameters": network.with_parameters({"sum.bias": np.zeros(1)}),
        "online": online(network, "u"),
        "prediction": drive.flat,
        "box_jenkins": box_jenkins(network, (1,), (1,)),
        "free_run": free_run(box_jenkins(network, (1,), (1,))),
        **{of.__name__: of(network) for of in SIMPLIFICATIONS},
    }
    assert {name: one.dt for name, one in made.items()} == dict.fromkeys(made, 0.01)


def test_a_network_keeps_its_sample_time_through_torch():
    torch = pytest.importorskip("torch")
    from greygate.models.importers.pytorch import to_torch

    module = to_torch(lag(0.01))
    assert isinstance(module, torch.nn.Module)
    assert module.network().dt == 0.01


def test_a_network_of_networks_has_the_one_sample_time_of_its_modules():
    outer = Network("outer", [U], [Y])
    outer.add("inner", lag(0.01))
    outer.connect("u", "inner.u")
    outer.connect("inner", "y")
    assert (outer.dt, outer.sample_time(), outer.flatten().dt) == (None, 0.01, 0.01)
    told = "network outer: it was made for 2 ms, module inner for 10 ms; train both on recordings of one sample time"
    with pytest.raises(InputError, match=told):
        replace(outer, dt=0.002).check()


def test_the_library_refuses_a_period_that_is_not_the_networks_and_takes_the_networks_where_none_is_given():
    data = signals()
    records = {"a": Record({"u": data["u"]}, {"y": data["y"]})}
    with pytest.raises(InputError, match="sample time 1 ms, the network lag was made for 10 ms"):
        validate(lag(0.01), records, period=1e-3)
    with pytest.raises(InputError, match="sample time 1 ms, the network lag was made for 10 ms"):
        compile_network(lag(0.01), records, period=1e-3)
    assert compile_network(lag(0.01), records).program.period == 0.01


def test_control_refuses_a_network_and_a_sensor_of_another_sample_time():
    position = task("belt_drive")
    position.floating(position.network())
    for other in (replace(position.network(), dt=0.01), position.network()):
        own = position if other.dt == 0.01 else replace(position, period=0.001)
        with pytest.raises(InputError, match=r"control of belt_drive: sample time .* the network .* was made for"):
            own.floating(other)


def test_every_stored_network_with_a_memory_says_the_sample_time_of_its_machine():
    stored = {TRAINED / name: entry.period for name, entry in CATALOG.items()}
    stored |= {path: CATALOG[path.stem].period for path in PRUNED.glob("*.toml")}
    stored |= {CONTROL / name: build().period for name, build in CONTROLLED.items()}
    assert {path: Network.load(path).dt for path in stored} == stored
    others = {p.with_suffix("") for p in TRAINED.rglob("*.toml")} - {p.with_suffix("") for p in stored}
    assert {path.parent.name for path in others} == {"library"}
    for path in others:  # a function without a memory is the same at every sample time
        found = Network.load(path)
        assert (found.dt, any(c.delay for c in found.flatten().connections)) == (None, False)


@pytest.mark.parametrize(
    ("dt", "text"),
    [(2.0, "2 s"), (1.0, "1 s"), (0.01, "10 ms"), (1e-3, "1 ms"), (12.5e-6, "12.5 us"), (1e-9, "0.001 us")],
)
def test_a_sample_time_is_told_in_the_unit_that_suits_it(dt, text):
    assert spoken(dt) == text


@pytest.mark.parametrize(
    ("path", "out"),
    [
        ("a/run.csv", "run_10ms.csv"),
        ("run.csv.gz", "run_10ms.csv"),
        ("run.mat", "run_10ms.csv"),
        ("$x.csv", "$x_10ms.csv"),
    ],
)
def test_the_resampled_file_has_the_recordings_name_and_the_sample_time(path, out):
    words = shlex.split(resampling(path, 0.01).removeprefix("resample it: "))
    assert words == ["greygate", "look", path, "--resample", "0.01", "--out", out]


@pytest.mark.skipif(not CASE.is_dir(), reason="the case is not on this machine")
def test_the_network_of_the_case_says_nothing_so_a_line_does(tmp_path, greygate):
    code, _, error = greygate("validate", CASE / "mot2.toml", CASE / "m1_2ms.csv", "--html", tmp_path / "v.html")
    assert code == 0
    assert "network mot2 does not say its sample time; taken as that of" in error
