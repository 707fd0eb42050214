"""`greygate make`: from a plant and two recordings to verified Verilog, and again after a cut, a change, a mistake."""

import json
import shutil
import sys
from copy import deepcopy as copied
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from checking import valid_files

from greygate import make, steps
from greygate.control.choices import Method, Place
from greygate.errors import InputError
from greygate.hardware import controlled
from greygate.identify.expert.building import Unfollowed
from greygate.identify.expert.diagnosed import Corrected
from greygate.mismatch.joining import acting
from greygate.mismatch.model import FILTERS, Model
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording
from greygate.plants.simulator import simulate
from greygate.plants.written import text
from greygate.progress import Budget

LAG = """
step = 1e-2
outputs = ["y"]
inputs = { u = "V" }
[parameters]
T = [0.5, "s", 0.3]
[states]
y = { unit = "V" }
[equations]
lag.y = { storage = "T", input = "u", loss = "-y" }
"""
DRIVEN = """
step = 1e-2
outputs = ["y"]
inputs = { u = "V", w = "V", p = "m", r = "m/s" }
derived = { r = "rate p" }
parameters = { T = [0.5, "s", 0.3] }
states = { y = { unit = "V" }, q = { unit = "V" }, z = { unit = "Wb" } }
[equations]
lag.y = { storage = "T", input = "u + w", loss = "-y + q + 0 * z", motion = "1000 * r" }
store.q = { loss = "-q" }
flux.z = { loss = "-z" }
"""
NAMES = ["look", "diagnose", "correct", "build-snn", "validate", "compile", "verify"]
SECONDS = 4  # for diagnosis and network


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> Path:
    """lag.toml, and three short recordings of a lag that takes 0.6 s."""
    folder = tmp_path_factory.mktemp("lag")
    (folder / "lag.toml").write_text(LAG)
    real = Plant.read(folder / "lag.toml").with_parameters(T=0.6)
    for seed, name in enumerate(("first", "second", "third")):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.uniform(-1, 1, 16), 15)
        y = simulate(real, {"u": u}, sample_time=0.1, step=1e-2)["y"] + 1e-3 * rng.standard_normal(len(u))
        Recording(0.1, {"u": u, "y": y}, {"u": "V", "y": "V"}).write_csv(folder / f"{name}.csv")
    return folder


def arguments(world: Path, out: Path, *more: str) -> list[str]:
    files = [str(world / f"{n}.csv") for n in ("first", "second")]
    return ["make", str(world / "lag.toml"), *files, "--out", str(out), "--seconds", str(SECONDS), *more]


@pytest.fixture(scope="module")
def made(world, tmp_path_factory) -> tuple[Path, dict]:
    from command_line import greygate

    out = tmp_path_factory.mktemp("made") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(make, "requested", partial(make.requested, widths=(16,), multipliers=(1,)))
        patch.setattr(make, "Budget", lambda seconds, work: Budget(work=work))  # a loaded machine ends no diagnosis
        code, printed, error = greygate(*arguments(world, out), "--json")
    assert code == 0, error
    return out, json.loads(printed)


@pytest.fixture
def copy(made, tmp_path) -> Path:
    """The folder, to be spoilt."""
    return Path(shutil.copytree(made[0], tmp_path / "out"))


def again(printed: str) -> list[str]:
    return [s["step"] for s in json.loads(printed)["steps"] if s["again"]]


def test_the_steps_lead_to_hardware_that_errs_no_more_than_the_network(made):
    out, told = made
    assert [s["step"] for s in told["steps"]] == NAMES
    assert told["passed"]
    assert not any(s["again"] for s in told["steps"])
    (study,) = json.loads((out / "verify" / "report.json").read_text())
    assert list(study["scenarios"]) == ["first", "second"]
    rmse = study["scenarios"]["second"]["outputs"]["y"]["rmse"]
    assert rmse["fixed"] < 1.2 * rmse["float"] < 3e-3  # V; the noise is 1e-3
    assert told["steps"][-1]["figure"].startswith("0 bits differ in 480 steps")
    assert {"diagnosis.json", "report.json", "lag.json", "program.json"} <= {*valid_files(out)}


def test_the_corrected_plant_is_one_that_errs_less(made, world):
    out, _ = made
    run = Plant.read(out / "correct" / "lag.toml")
    recording = make.read(world / "lag.toml", {"second": str(world / "second.csv")})[1]["second"]
    errors = [
        np.std(simulate(plant, {"u": recording["u"]}, sample_time=0.1, step=1e-2)["y"] - recording["y"])
        for plant in (run, Plant.read(world / "lag.toml"))
    ]
    assert errors[0] < 0.2 * errors[1]


def test_the_page_shows_each_step_with_its_figure_and_a_picture(made):
    out, told = made
    page = (out / "index.html").read_text()
    for step in told["steps"]:
        section = page[page.index(f'<h2 id="{step["step"]}">') :].partition("</section>")[0]
        assert step["figure"] in section
        assert 'class="plot"' in section or "<svg" in section or 'class="bar"' in section, step


def test_what_was_done_is_not_done_again(world, copy, greygate):
    before = {p: p.read_bytes() for p in copy.rglob("*.json")}
    code, printed, _ = greygate(*arguments(world, copy), "--json")
    assert (code, again(printed)) == (0, NAMES)
    assert {p: p.read_bytes() for p in copy.rglob("*.json")} == before


def test_a_step_of_which_something_changed_is_done_again_with_those_after_it(world, copy, greygate, monkeypatch):
    for name in NAMES[5:]:
        monkeypatch.setitem(make.STEPS, name, (name, make._look))
    code, printed, _ = greygate(*arguments(world, copy, "--max-error", "1.5x"), "--json")
    assert (code, again(printed)) == (0, NAMES[:5])


@pytest.fixture
def reference(tmp_path) -> Path:
    """What the lag's output is to be."""
    y = 0.2 * (1 - np.cos(0.2 * np.arange(60)))
    Recording(0.1, {"y": y}, {"y": "V"}).write_csv(tmp_path / "track.csv")
    return tmp_path / "track.csv"


def test_the_corrected_plant_is_controlled_within_what_is_on_record(world, copy, greygate, monkeypatch, reference):
    """The other controllers take a minute: here they are the PI."""
    seen, tables = [], []

    def only_pi(machine, method, place, progress):
        seen.append((machine, method, place))
        done = copied(tables[0]) if tables else controlled.table(machine, Method.PI, Place.FLOAT, progress)
        tables.append(copied(done))
        done.found["rows"] |= {"predictive": done.found["rows"]["PI"], make.HARDWARE: done.found["rows"]["PI"]}
        done.found["network"] = {"apart": {}, "matches": matches, "neurons": 10, "said": "so", "differing_bits": bits}
        return done

    monkeypatch.setattr(make, "table", only_pi)
    words = arguments(world, copy, "--control", str(reference), "--rate", "u=50", "--json")
    for bits, matches, code in ((0, True, 0), (3, True, 1), (0, False, 1)):
        got, printed, error = greygate(*words)
        assert (got, again(printed)) == (code, NAMES), error
        told = json.loads(printed)["steps"][-1]
        assert (told["step"], told["yes"]) == ("control", code == 0)
        assert f"under PI; {'' if matches else 'so; '}{bits} bits differ" in told["figure"]
        assert ("--limits u=-90:90 is in V; on record u goes from -" in error) is not matches
        if code == 0:
            assert again(greygate(*words)[1]) == [*NAMES, "control"]
        words += ["--limits", "u=-0.9:0.9" if code == 0 else "u=-90:90"]
    Recording(0.1, {"y": 0.1 * np.sin(0.2 * np.arange(60))}, {"y": "V"}).write_csv(reference)
    assert again(greygate(*words)[1]) == NAMES
    (machine, method, place), (other, *_), *_ = seen
    first = make.read(world / "lag.toml", {"first": str(world / "first.csv")})[1]["first"]["u"]
    assert (machine.limits.low, machine.limits.high) == (first.min(), first.max())
    assert (other.limits.low, other.limits.high, other.limits.rate) == (-0.9, 0.9, 5.0)
    assert 5e-4 < machine.noise["y"] < 2e-3  # V; what the corrected plant leaves
    assert (method, place) == (Method.NETWORK, Place.RTL)
    table = json.loads((copy / "control" / "control.json").read_text())
    assert "microseconds" not in table["rows"]["PI"]["load"]
    page = (copy / "index.html").read_text()
    assert "RMS / worst, supply" in page


def test_what_cannot_be_controlled_is_refused_before_the_plant_is_diagnosed(world, tmp_path):
    """Columns that are no outputs, inputs that rest on record, and those that are derived from one that moves."""
    (tmp_path / "lag.toml").write_text(DRIVEN)
    k = np.arange(60)
    units = {"u": "V", "w": "V", "p": "m", "y": "V", "q": "V"}
    moved = {"u": np.sin(k), "w": np.zeros(60), "p": np.cos(k), "y": np.sin(0.2 * k), "q": np.sin(0.1 * k)}
    Recording(0.1, {n: moved[n] for n in "uwpy"}, units).write_csv(tmp_path / "run.csv")

    def refused(columns, limits=()):
        Recording(0.1, {n: moved[n] for n in columns}, units).write_csv(tmp_path / "track.csv")
        track = make.Tracking(tmp_path / "track.csv", dict(limits), {})
        files = {"run": str(tmp_path / "run.csv")}
        with pytest.raises(InputError) as caught:
            make.Asked.of(tmp_path / "lag.toml", files, {}, (), (), "up5k", "1.1x", 1.0, track)
        return str(caught.value)

    assert "w does not move on record; give --limits w=LOW:HIGH, or a column of REFERENCE.csv" in refused("y")
    assert "column q is no output of" in refused("yqw")
    assert "r is the rate p, which nothing computes under control" in refused("yw")
    assert "r is the rate p, which nothing computes under control" in refused("ywp")
    assert "r is the rate p" in refused("yp", [("w", (-1.0, 1.0))])
    (tmp_path / "lag.toml").write_text(DRIVEN.replace("rate p", "rate q"))
    assert "r is the rate q, which nothing computes under control" in refused("yw")
    plain = DRIVEN.replace('derived = { r = "rate p" }\n', "").replace(', r = "m/s"', "").replace("1000 * r", "p")
    (tmp_path / "lag.toml").write_text(plain)
    assert "unit Wb has no suffix" in refused("yw", [("z", (-1.0, 1.0))])


def test_control_without_its_solver_is_refused_at_once(world, tmp_path, greygate, monkeypatch, reference):
    monkeypatch.setitem(sys.modules, "osqp", None)
    code, _, error = greygate(*arguments(world, tmp_path / "out", "--control", str(reference)))
    assert code == 2
    assert "osqp is not installed; pip install 'greygate[control]'" in error
    assert not (tmp_path / "out").exists()


def test_laws_of_inputs_stand_in_the_corrected_plant_and_what_does_not_is_said(world):
    plant = Plant.read(world / "lag.toml")
    laws = {"u": [("offset", (-0.1,)), ("skew", (-2e-05,)), ("dead_zone", (0.3,)), ("saturation", (0.5, 0.8))]}
    whole, absent = make._whole(Corrected(plant, laws, {"y": {}}, (), ["drift"]))
    assert absent == "y, drift"
    u = np.linspace(-2.0, 2.0, 400)
    acts = u
    for kind, given in laws["u"]:
        acts = FILTERS[kind](acts, *given, 0.1)
    found, wanted = (simulate(p, {"u": v}, sample_time=0.1, step=1e-2)["y"] for p, v in ((whole, u), (plant, acts)))
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-12)
    whole, absent = make._whole(Corrected(plant, {"u": [("delay", (0.1,))]}, {}, (), []))
    assert (whole, absent) == (plant, "u")


def test_an_input_whose_rate_acts_has_no_law_of_its_own(tmp_path):
    (tmp_path / "spring.toml").write_text("""outputs = ["f"]
inputs = { x = "m", v = "m/s" }
parameters = { k = [5.0, "N/m"], d = [0.1, "N s/m"] }
derived = { v = "rate x" }
definitions.force.f = { unit = "N", spring = "k * x", damper = "d * v" }
""")
    plant = Plant.read(tmp_path / "spring.toml")
    assert acting(plant, {"x": [("offset", ("1.0",))]}) == (plant, ["x"])


def test_a_plant_that_is_driven_by_a_sensor_is_not_controlled(world, tmp_path, reference):
    asked = make.Asked.of(world / "lag.toml", {"first": str(world / "first.csv")}, {}, (), (), "up5k", "1.1x", 1.0)
    asked = replace(asked, sensors=("y",), track=make.Tracking(reference, {}, {}))
    with pytest.raises(InputError, match="--control: y drives the corrected plant as it was measured"):
        make.machine(asked, asked.task.plant, world / "lag.toml")


def test_another_version_does_all_again(world, copy, greygate, monkeypatch):
    monkeypatch.setattr(make, "STEPS", {"look": make.STEPS["look"]})
    for name in NAMES[1:]:
        shutil.rmtree(copy / name)
    assert again(greygate(*arguments(world, copy), "--json")[1]) == ["look"]
    monkeypatch.setattr(steps, "__version__", "0.0")
    assert again(greygate(*arguments(world, copy), "--json")[1]) == []


def test_after_a_cut_the_rest_is_done_and_nothing_is_half_written(world, copy, greygate, monkeypatch):
    shutil.rmtree(copy / "verify")

    def cut(asked, out, new, progress):
        (new / "half").write_text("written")
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setitem(make.STEPS, "verify", (make.STEPS["verify"][0], cut))
        code, printed, _ = greygate(*arguments(world, copy))
        assert sorted(p.name for p in copy.iterdir()) == sorted([*NAMES[:-1], "index.html"])
        assert '<h2 id="verify">' not in (copy / "index.html").read_text()
        patch.setitem(make.STEPS, "verify", (make.STEPS["verify"][0], make._look))
        rest = greygate(*arguments(world, copy), "--json")[1]
    assert again(rest) == NAMES[:-1]
    assert (code, printed) == (130, "")


def test_where_no_design_will_do_the_answer_is_no_and_the_page_tells_of_the_rest(world, copy, greygate, monkeypatch):
    monkeypatch.setattr(make, "requested", partial(make.requested, widths=(8,), multipliers=(1,)))
    code, printed, _ = greygate(*arguments(world, copy, "--max-error", "1.0001x"), "--json")
    told = json.loads(printed)
    assert (code, again(printed), told["passed"]) == (1, NAMES[:5], False)
    assert told["unmet"].startswith("compile: ")
    assert '<h2 id="compile">' not in (copy / "index.html").read_text()


def test_where_no_network_follows_the_plant_the_answer_is_no(world, copy, greygate, monkeypatch):
    def steep(*given):
        raise Unfollowed("lag", "its term turns too fast")

    monkeypatch.setitem(make.STEPS, "build-snn", (make.STEPS["build-snn"][0], steep))
    (copy / "build-snn" / "lag.json").unlink()
    code, printed, _ = greygate(*arguments(world, copy), "--json")
    told = json.loads(printed)
    assert (code, again(printed)) == (1, NAMES[:3])
    assert told["unmet"] == (
        "build-snn: plant lag: no network of it: its term turns too fast; record faster, or soften what is steep"
    )


def test_a_file_that_somebody_changed_is_not_overwritten(world, copy, greygate):
    (copy / "correct" / "lag.toml").write_text("# mine\n")
    code, printed, error = greygate(*arguments(world, copy))
    assert (code, printed) == (2, "")
    assert "correct: holds other files (lag.toml)" in error.splitlines()[-1]
    assert (copy / "correct" / "lag.toml").read_text() == "# mine\n"


def test_the_last_of_several_recordings_is_held_out_and_the_end_of_a_single_one(world, tmp_path):
    def asked(*names):
        files = {n: str(world / f"{n}.csv") for n in names}
        return make.Asked.of(world / "lag.toml", files, {}, (), (), "up5k", "1.1x", 1.0)

    several, single = asked("first", "second", "third"), asked("first")
    assert ([*several.recordings], [*several.held]) == (["first", "second"], ["third"])
    assert ([*single.recordings], [*single.held], single.judges) == (["first"], [], ["first"])
    assert single.heads[0].samples == 144  # 0.75 of 0.8 of 240


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (["--target", "ice40"], "--target ice40: cannot be explored; choose"),
        (["--max-error", "0.2bar"], "--max-error 0.2bar: no output has a unit of that kind, but V"),
        (["--output", "z"], "plant lag: has no signal z; it has y"),
        (["--test", "FIRST"], "first is both a recording to learn from and one to judge by"),
        ([], "holds first.csv, which greygate make did not write; give a new folder"),
        (["--limits", "u=-1:1"], "are of a controller; give --control REFERENCE.csv, or leave them out"),
        (["--control", "FIRST"], "no input has limits; give --limits NAME=LOW:HIGH of each that is controlled"),
        (["--control", "FIRST", "--limits", "u=-1:1"], "column u is controlled, and cannot be given; leave one out"),
    ],
)
def test_what_cannot_be_made_is_refused_before_anything_is_written(world, tmp_path, greygate, given, says):
    more = [{"FIRST": str(world / "first.csv")}.get(word, word) for word in given]
    out = tmp_path / "out" if given else world
    before = sorted(world.iterdir())
    code, printed, error = greygate(*arguments(world, out, *more))
    assert (code, printed) == (2, "")
    assert says in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
    assert sorted(world.iterdir()) == before


RIG = """plant = "lag.toml"
sample_time_s = 0.1
predict = ["y"]
identify = ["first.csv"]
holdout = ["second.csv"]
[parameters]
T = 0.5
[tolerance]
T = 0.3
[channels.u]
unit = "V"
role = "input"
[channels.y]
unit = "V"
role = "output"
noise_rms = 1e-3
"""


def test_a_rig_brings_its_recordings_its_noise_and_its_own_effects(world, tmp_path):
    rig = Path(shutil.copytree(world, tmp_path / "rig"))
    (rig / "rig.toml").write_text(RIG)
    asked = make.Asked.of(rig, {}, {}, (), (), "up5k", "1.1x", 1.0)
    assert ([*asked.recordings], [*asked.held], asked.task.targets) == (["first"], ["second"], ("y",))
    fit = {"y": {"corrected": 0.5}}
    assert make._noise(asked, fit) == {"y": 1e-3}
    bare = replace(asked, task=replace(asked.task, rig=None))
    assert make._noise(bare, {"y": {"corrected": None}})["y"] > 5e-3  # V; rough, as it moves much in a sample
    assert make._noise(bare, {"y": {"corrected": 2e-3}}) == {"y": 2e-3}
    seen = make.correct.__globals__["rig_for"](asked.task, asked.heads)
    assert (seen.channels["y"].noise, seen.folder, seen.held_out()) == (1e-3, rig, None)
    assert Model(seen, seen.to_explain(), {}).target.shape == (180, 1)


def test_a_value_that_a_recording_has_of_its_own_is_an_input_of_the_network(world, tmp_path):
    rig = Path(shutil.copytree(world, tmp_path / "rig"))
    (rig / "rig.toml").write_text(f"{RIG}[recordings]\nsecond.parameters = {{ T = 0.7 }}\n")
    known, found = make.read(rig, {n: str(rig / f"{n}.csv") for n in ("first", "second")})
    assert (known.plant.inputs["T"], known.channels["T"].role, known.own["second"].parameters) == ("s", "input", {})
    assert "T" not in {*known.plant.parameters, *known.datasheet}
    assert [(set(r["T"].tolist()), r.units["T"]) for r in found.values()] == [({0.5}, "s"), ({0.7}, "s")]
    asked = make.Asked.of(rig, {}, {}, (), (), "up5k", "1.1x", 1.0)
    assert asked.task.inputs == ("u", "T")
    assert set(asked.recordings["first"]["T"].tolist()) == {0.5}


def test_an_uncertain_value_of_a_recording_is_refused(world, tmp_path, greygate):
    rig = Path(shutil.copytree(world, tmp_path / "rig"))
    own = "second.parameters = { T = 0.7 }\nsecond.tolerance = { T = 0.1 }"
    (rig / "rig.toml").write_text(f"{RIG}[recordings]\n{own}\n")
    code, _, error = greygate("make", rig, "--out", tmp_path / "out")
    assert code == 2
    assert "second.csv: T has another value there, and a network has one; make it an input of the plant" in error
    assert not (tmp_path / "out").exists()


def test_a_plant_of_a_name_that_verilog_cannot_hold_is_refused_at_once(world, tmp_path, greygate):
    shutil.copy(world / "lag.toml", tmp_path / "force.toml")
    code, printed, error = greygate("make", tmp_path / "force.toml", world / "first.csv", "--out", tmp_path / "out")
    assert (code, printed) == (2, "")
    assert "force: not a name that Verilog can hold" in error
    assert not (tmp_path / "out").exists()


MACHINES = sorted((Path(__file__).parents[1] / "machines").glob("*/*.toml"))


@pytest.mark.parametrize("path", MACHINES, ids=lambda p: p.stem)
def test_a_plant_that_is_written_is_read_as_it_was(path, tmp_path):
    plant = Plant.read(path)
    (tmp_path / path.name).write_text(text(plant, "two\nlines"))
    assert Plant.read(tmp_path / path.name) == plant
