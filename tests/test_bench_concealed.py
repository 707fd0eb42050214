"""The blind benchmark: six small machines, nine conditions, the commitment, any tool's answers, their scores."""

import hashlib
import json
import shutil
import signal
import subprocess
import sys
import time
import tomllib

import numpy as np
import pytest
from test_children import ended

from benchmarks.concealed_bench import tables
from benchmarks.concealed_bench.answer import Answer
from benchmarks.concealed_bench.baselines import gaussian, linear, neural, sparse
from benchmarks.concealed_bench.entrant import answer as our_answer
from benchmarks.concealed_bench.make import COMMITMENT, KINDS, committed, make, plan
from benchmarks.concealed_bench.run import BASELINES, run
from benchmarks.concealed_bench.score import score
from benchmarks.concealed_bench.vocabulary import FAULTS, right, vocabulary
from greygate.errors import InputError
from greygate.mismatch.concealed.conceal import EVERY_RIG, conceal
from greygate.mismatch.concealed.domains import DOMAINS
from greygate.mismatch.concealed.rig import rms
from greygate.mismatch.concealed.stress import CONDITIONS, Recorder
from greygate.mismatch.rig import load
from greygate.plants import simulate

SECRET = "nobody will guess this secret"


@pytest.mark.parametrize("plant", DOMAINS)
def test_the_plant_that_a_user_would_write_moves_as_the_machine_does(plant, tmp_path):
    """Two integrators, two implementations, one machine: what differs is far below the noise of the sensors."""
    rig = load(conceal(plant, 2, tmp_path / "case", kind="clean"))
    own = DOMAINS[plant]
    true = own.record(own.parameters, {}, 0.0, own.seconds["third"], np.random.default_rng(1))
    source = own.channels[0].name
    nominal = rig.plant.with_parameters(**own.parameters)
    found = simulate(nominal, {source: true[source]}, sample_time=own.sample_time, step=rig.plant.step)
    for channel in own.predicted:
        assert rms(found[channel.name] - true[channel.name]) < channel.error / 10, channel.name


@pytest.mark.parametrize("plant", DOMAINS)
def test_every_effect_of_a_small_machine_changes_what_it_records(plant):
    rig = DOMAINS[plant]

    def recorded(form, effects):
        return rig.record(rig.parameters, effects, form, rig.seconds["identify"], np.random.default_rng(1))

    nothing = recorded(0.0, {})
    for name, effect in (rig.effects | rig.foreign).items():
        for form in (0.0, 1.0):
            true = recorded(form, effect.draw(np.random.default_rng(1), least=0.9))
            change = max(rms(true[c.name] - nothing[c.name]) / c.error for c in rig.predicted)
            assert change > 1, (name, form)


# -- conditions ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CONDITIONS)
def test_a_condition_is_what_it_says(name):
    """White noise has its told RMS and no memory; the others differ from it in the way that they are for."""
    rig, under = DOMAINS["pendulum"], CONDITIONS[name]
    rng = np.random.default_rng(3)
    recorder = Recorder.of(rig, under, rng)
    signals = {"torque": np.zeros(20_000), "theta": np.cumsum(np.ones(20_000)) * 1e-3}
    error = recorder.measure(signals, rng)["theta"] - signals["theta"][:: under.every]
    told = rig.predicted[0].error
    if under.late:
        assert np.median(error) == pytest.approx(-2e-3, rel=0.1)
        error = error - np.median(error)
    memory = np.corrcoef(error[1:], error[:-1])[0, 1]
    spectrum = np.abs(np.fft.rfft(error)) ** 2
    line = spectrum.max() / spectrum.sum()
    heavy = np.mean(np.abs(error) > 5 * error.std())
    assert error.std() / told == pytest.approx(
        {"louder": 10.0, "quieter": 0.2, "pickup": 10.65}.get(name, 1.0), rel=0.15
    )
    assert (memory > 0.8) == (name == "coloured") or name == "pickup"
    assert (line > 0.5) == (name == "pickup")
    assert (heavy > 1e-3) == (name == "heavy")
    assert len(error) == (10_000 if name == "half_rate" else 20_000)


def test_half_the_rate_is_told_and_its_truth_still_leaves_the_sensors_alone(tmp_path):
    folder = conceal("tank", 4, tmp_path / "case", kind="one", under="half_rate")
    assert tomllib.loads((folder / "rig.toml").read_text())["sample_time_s"] == 2.0
    truth = json.loads((folder / "sealed.json").read_text())
    for fit, channel in zip(truth["third"].values(), DOMAINS["tank"].predicted, strict=True):
        assert fit["true"] < 2 * channel.error
    assert truth["condition"] == "half_rate"


def test_untold_noise_stands_nowhere_in_the_data_sheet(tmp_path):
    sheet = tomllib.loads((conceal("motor", 1, tmp_path / "case", under="untold") / "rig.toml").read_text())
    assert set(sheet["channels"]["omega"]) == {"unit", "role"}


def test_an_unknown_condition_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(InputError, match="no condition 'snow'; there are white"):
        conceal("motor", 1, tmp_path / "case", under="snow")
    assert not (tmp_path / "case").exists()


# -- making and sealing ----------------------------------------------------------------------------------------------


def test_a_plan_has_every_kind_under_every_condition_and_sealed_names_say_nothing():
    cases = plan(len(CONDITIONS) * len(KINDS))
    assert {(c.condition, c.kind) for c in cases} == {(c, k) for c in CONDITIONS for k in KINDS}
    assert {c.plant for c in cases} == set(EVERY_RIG)
    sealed = plan(40, SECRET)
    assert [c.name for c in sealed] == sorted(c.name for c in sealed)
    assert {c.seed for c in sealed}.isdisjoint(c.seed for c in plan(40, SECRET + "!"))
    assert len({c.condition for c in sealed[:9]}) < 9  # their order is not that of the plan


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Nine cases of one kind each way, on two quick plants."""
    folder = tmp_path_factory.mktemp("bench") / "bench"
    make(folder, 20, plants=["tank", "pendulum"], conditions=["white", "late"])
    return folder


def test_the_commitment_seals_every_file_and_the_cases_do_not_hold_the_answers(bench, tmp_path):
    seals = json.loads((bench / COMMITMENT).read_text())["cases"]
    assert len(seals) == 20
    for name, files in seals.items():
        assert {f"sealed/{name}/sealed.json", f"sealed/{name}/third.csv", f"cases/{name}/rig.toml"} < set(files)
        assert not {"sealed.json", "third.csv"} & {path.name for path in (bench / "cases" / name).iterdir()}
        for file, seal in files.items():
            assert hashlib.sha256((bench / file).read_bytes()).hexdigest() == seal
    again = tmp_path / "again"
    make(again, 20, plants=["tank", "pendulum"], conditions=["white", "late"])
    assert (again / COMMITMENT).read_bytes() == (bench / COMMITMENT).read_bytes()


def test_a_secret_is_committed_to_and_not_written(tmp_path):
    made = make(tmp_path / "bench", 2, SECRET, plants=["tank"])
    assert made["secret_sha256"] == hashlib.sha256(SECRET.encode()).hexdigest()
    assert SECRET not in "".join(p.read_text() for p in (tmp_path / "bench").rglob("*") if p.is_file())


def test_an_answer_that_was_changed_afterwards_is_not_scored(bench, tmp_path):
    copy = tmp_path / "bench"
    shutil.copytree(bench, copy)
    assert committed(copy, sealed=True)
    changed = next((copy / "sealed").glob("*/sealed.json"))
    changed.write_text(changed.read_text().replace('"plant"', '"plant" '))
    with pytest.raises(InputError, match=r"is not what was committed to \(SHA-256 differs\)"):
        committed(copy, sealed=True)


def test_the_vocabulary_says_what_each_name_means():
    names = vocabulary()
    assert set(names) == {*EVERY_RIG, "any"}
    for plant, rig in EVERY_RIG.items():
        assert set(rig.effects) <= set(names[plant])
        assert not set(rig.foreign) & set(names[plant])


# -- running and scoring ---------------------------------------------------------------------------------------------


def oracle(bench, folder, **changes):
    """Answers that say what is concealed, with `changes` (functions of the truth) of their entries."""
    for name, sealed in committed(bench, sealed=True).items():
        truth = json.loads((sealed / "sealed.json").read_text())
        names = truth["effects"] + ([next(iter(FAULTS))] if truth.get("condition") == "late" else [])
        told = {"value": 1.0, "ci95": [-1e30, 1e30]}
        true = {
            "verdict": truth["verdict"],
            "claims": [{"name": n, "confidence": 1.0} for n in names],
            "where": [{"equation": e} for e in truth["equation"]],
            "parameters": {
                n: told | {"outside_tolerance": n == truth["parameter"]} for n in truth["parameters_true"]
            },
        }  # fmt: skip
        (folder / name).mkdir(parents=True)
        entries = true | {key: change(truth) for key, change in changes.items()}
        Answer(entries["verdict"], tuple(entries["claims"]), tuple(entries["where"]), entries["parameters"]).write(
            folder / name
        )
        shutil.copy(sealed / "third.csv", folder / name / "predicted.csv")
        (folder / name / "run.json").write_text(json.dumps({"seconds": 1.0, "code": 0, "error": ""}))
    return folder


def shares(found):
    return {k: v["count"] / v["of"] for k, v in found.items() if isinstance(v, dict) and v["of"]}


def test_who_knows_everything_scores_everything_and_removes_all_that_can_be_removed(bench, tmp_path):
    scores = score(bench, oracle(bench, tmp_path / "oracle"))
    found = tables.figures(scores)
    wrong = ("errors", "wrong names", "surely wrong names", "cases with a surely wrong name", "clean rigs with a claim",
             "corrections worse than calibrated", "of these, with nothing added",
             "worse than the concealed machine, too")  # fmt: skip
    good = {name: share for name, share in shares(found).items() if name not in wrong}
    assert good == dict.fromkeys(good, 1.0)
    assert len(good) == 9
    assert not any(shares(found).get(name) for name in wrong)
    assert found["median removed"] > 1  # it even knows the noise
    assert found["median seconds"] == 1.0
    assert {s.kind for s in scores} == set(KINDS)


def test_a_sure_name_on_a_clean_rig_is_a_wrong_name_and_shows_in_the_reliability(bench, tmp_path):
    boastful = lambda truth: [{"name": "leak", "confidence": 0.97}]  # noqa: E731
    scores = score(bench, oracle(bench, tmp_path / "boastful", claims=boastful))
    found = tables.figures(scores)
    known = sum(s.concealed.count("leak") for s in scores)
    assert found["wrong names"] == found["surely wrong names"] == {"of": 20, "count": 20 - known}
    assert shares(found)["clean rigs with a claim"] == 1
    (bin97,) = [b for b in tables.reliability(scores) if b["claims"]]
    assert (bin97["from"], bin97["claims"], bin97["right"]) == (0.95, 20, known)


def test_who_adds_nothing_to_a_calibrated_simulation_corrects_nothing(bench, tmp_path):
    made = oracle(bench, tmp_path / "quiet", claims=lambda truth: [], parameters=lambda truth: {})
    for path in made.glob("*/answer.json"):
        path.write_text(json.dumps({"schema": "concealed-answer/1", "verdict": "unexplained", "corrects": False}))
    found = tables.figures(score(bench, made))
    assert found["corrections worse than calibrated"]["of"] == found["of these, with nothing added"]["of"] == 20
    path.write_text(json.dumps({"schema": "concealed-answer/1", "corrects": False, "claims": [{"name": "leak"}]}))
    with pytest.raises(InputError, match="corrects: false, but leak is claimed"):
        score(bench, made)


@pytest.mark.parametrize(
    ("effects", "outside", "corrects"),
    [([], {}, False), ([], {"outside_tolerance": True}, True), ([{"id": "unknown"}], {}, True)],
    ids=["nothing", "a parameter", "a term without a name"],
)
def test_our_own_answer_says_whether_it_adds_anything(effects, outside, corrects):
    parameters = {"viscous": {"value": 1.0, "ci95": [0.9, 1.1], **outside}}
    found = our_answer({"verdict": None, "effects": effects, "where": [], "parameters": parameters})
    assert found["corrects"] is corrects


def test_what_no_recording_tells_apart_is_no_wrong_name():
    """A constant torque and an offset of the voltage that makes a torque are one on the motor, and not on the car."""
    assert right("motor", "input_offset", "constant_load")
    assert not right("motor", "input_offset", "dry_friction")
    assert not right("quarter_car", "input_offset", "constant_load")


def test_intervals_are_counted_whatever_the_verdict_says(bench, tmp_path):
    narrow = lambda truth: {n: {"value": v, "ci95": [2 * v, 3 * v]} for n, v in truth["parameters_true"].items()}  # noqa: E731
    unsure = lambda truth: "unexplained"  # noqa: E731
    found = tables.figures(score(bench, oracle(bench, tmp_path / "narrow", parameters=narrow, verdict=unsure)))
    assert found["inside 95 % intervals"] == {"of": 20 * 3, "count": 0}


@pytest.mark.parametrize("method", BASELINES)
def test_a_baseline_answers_every_case_and_claims_nothing(bench, tmp_path, method):
    pytest.importorskip({"sparse": "pysindy", "gaussian": "sklearn", "neural": "sklearn"}.get(method, "numpy"))
    done = run(bench, method, tmp_path / method, 60.0, cases=2)
    assert [facts["error"] for facts in done.values()] == [""] * 2
    scores = score(bench, tmp_path / method)
    assert not any(s.claims for s in scores)
    assert tables.summary(scores)["all"]["right first, single effects"]["of"] == 0
    if method == "calibrated":
        assert all(s.worse == pytest.approx(1.0, rel=1e-3) for s in scores)
        assert all(s.removed == pytest.approx(0.0, abs=1e-2) for s in scores if s.removed is not None)


@pytest.mark.parametrize("model", [linear, sparse, gaussian, neural])
def test_a_residual_model_learns_what_it_can_express(model):
    pytest.importorskip({sparse: "pysindy", gaussian: "sklearn", neural: "sklearn"}.get(model, "numpy"))
    rng = np.random.default_rng(0)
    signals = rng.standard_normal((1000, 3))
    error = 0.8 * signals[:, 1] + 0.05 * rng.standard_normal(1000)
    new = rng.standard_normal((200, 3))
    assert rms(model(signals, error)(new) - 0.8 * new[:, 1]) < 0.1


STRANGER = """
import json, pathlib, sys, time
what, case, place = sys.argv[1], *map(pathlib.Path, sys.argv[2:4])
assert not (case / "third.csv").exists() and not (case / "sealed.json").exists()
if what == "explain":
    name = json.dumps({"schema": "concealed-answer/1", "claims": [{"name": "ghost", "confidence": 0.5}]})
    (place / "answer.json").write_text(name)
else:
    recording = pathlib.Path(sys.argv[4])
    assert recording.parent == case.parent
    (place / "predicted.csv").write_text(recording.read_text())
"""


def test_a_strangers_tool_enters_by_a_command(bench, tmp_path, greygate):
    (tmp_path / "tool.py").write_text(STRANGER)
    command = f"{sys.executable} {tmp_path / 'tool.py'}"
    code, printed, _ = greygate(
        "dev", "bench-concealed", "run", bench, "--out", tmp_path / "a", "--tool", command, "--cases", 2, "--jobs", 2
    )
    assert code == 0, printed
    rows, picture = tmp_path / "rows.csv", tmp_path / "picture.svg"
    code, printed, _ = greygate(
        "dev", "bench-concealed", "score", bench, tmp_path / "a", "--json", "--out", rows, "--picture", picture
    )
    assert code == 0
    found = json.loads(printed)["a"]
    assert found["all"]["wrong names"] == {"of": 2, "count": 2}
    assert found["all"]["surely wrong names"]["count"] == 0
    assert [found[name]["cases"] for name in ("all", "tank", "pendulum", "white", "late")] == [2, 1, 1, 1, 1]
    assert len(rows.read_text().splitlines()) == 3
    assert "ghost 0.5 WRONG" in rows.read_text()
    assert picture.read_text().startswith("<svg")


def test_what_was_kept_back_is_predicted_when_it_is_published_and_nothing_is_explained_again(bench, tmp_path):
    early = tmp_path / "early"
    shutil.copytree(bench, early, ignore=lambda folder, names: ["sealed"] if folder == str(bench) else [])
    (first,) = run(early, "nominal", tmp_path / "a", 60.0, cases=1)
    written = (tmp_path / "a" / first / "answer.json").stat().st_mtime_ns
    assert not (tmp_path / "a" / first / "predicted.csv").exists()
    with pytest.raises(InputError, match="holds no answers; put the folder `sealed` there"):
        score(early, tmp_path / "a")
    run(bench, "nominal", tmp_path / "a", 60.0, cases=1)
    assert (tmp_path / "a" / first / "predicted.csv").exists()
    assert (tmp_path / "a" / first / "answer.json").stat().st_mtime_ns == written


@pytest.mark.parametrize(
    ("code", "said"),
    [("import time; time.sleep(60)", "not done after 1 s"), ("raise ValueError('no')", "ValueError: no"),
     ("pass", "wrote no answer.json")],
)  # fmt: skip
def test_a_tool_that_hangs_or_fails_is_an_error_of_that_case_alone(bench, tmp_path, greygate, code, said):
    (tmp_path / "tool.py").write_text(code)
    command = f"{sys.executable} {tmp_path / 'tool.py'}"
    status, _, err = greygate(
        "dev", "bench-concealed", "run", bench, "--out", tmp_path / "a", "--tool", command, "--cases", 1, "--seconds", 1
    )
    assert status == 1
    assert said in err
    (only,) = score(bench, tmp_path / "a")
    assert said in only.error
    assert tables.figures([only])["errors"] == {"of": 1, "count": 1}


def test_an_interrupted_run_ends_its_tools_and_counts_no_case(bench, tmp_path):
    (tmp_path / "tool.py").write_text(
        "import os, pathlib, sys, time\n"
        f"pathlib.Path({str(tmp_path / 'pid')!r}).write_text(str(os.getpid()))\n"
        "time.sleep(60)"
    )
    began = "from greygate.cli import run; run()"
    tool = f"{sys.executable} {tmp_path / 'tool.py'}"
    arguments = [
        "dev",
        "bench-concealed",
        "run",
        str(bench),
        "--out",
        str(tmp_path / "a"),
        "--tool",
        tool,
        "--cases",
        "1",
    ]
    process = subprocess.Popen(
        [sys.executable, "-c", began, *arguments],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background ignores it
    )
    while not (tmp_path / "pid").exists() or not (tmp_path / "pid").read_text():
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=30)[1].endswith("greygate: interrupted\n")
    assert process.returncode == 130
    assert not list((tmp_path / "a").rglob("run.json"))
    assert ended([int((tmp_path / "pid").read_text())])


def test_an_answer_that_is_not_one_is_refused_by_name(bench, tmp_path):
    folder = oracle(bench, tmp_path / "oracle")
    (folder / "d0003" / "answer.json").write_text('{"schema": "concealed-answer/1", "verdict": "maybe"}')
    with pytest.raises(InputError, match=r"d0003/answer.json: verdict"):
        score(bench, folder)


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        ("sensor_lag_z_body", "sensor_lag"),
        ("late_channel", "late_channel"),
        ("friction_between_a_b", "dry_friction"),
        ("sensor_offset_p_a", "sensor_offset_p_a"),  # of the machine's own table
        ("speed_slip", "speed_slip"),
        ("of_my_own", "of_my_own"),
    ],
)
def test_a_general_effect_goes_without_its_place(ours, theirs):
    diagnosis = {"verdict": "missing_physics", "effects": [{"id": ours}], "where": [], "parameters": {}}
    assert [claim["name"] for claim in our_answer(diagnosis)["claims"]] == [theirs]


def test_our_own_answer_has_the_names_of_the_benchmark():
    interval = {"value": 1.0, "ci95": [0.5, 1.5], "unit": "N"}
    diagnosis = {
        "verdict": "missing_physics",
        "effects": [{"id": "friction_between", "confidence": 0.9, "parameters": {"f": interval}}, {"id": "unknown"}],
        "where": [{"equation": "body", "depends_on": ["v"], "regime": "always"}],
        "parameters": {},
    }
    found = our_answer(diagnosis)
    assert [claim["name"] for claim in found["claims"]] == ["dry_friction"]
    assert found["where"] == [{"equation": "body", "depends_on": ["v"]}]


def test_without_a_checkout_the_command_says_that_it_needs_one(tmp_path, greygate, monkeypatch):
    monkeypatch.setattr("greygate.cli.bench.BENCHMARKS", tmp_path / "none")
    code, printed, error = greygate("dev", "bench-concealed", "make", "--out", tmp_path / "new")
    assert (code, printed, error.count("\n")) == (2, "", 1)
    assert "needs a checkout of greygate's repository" in error
