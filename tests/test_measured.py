import json
from statistics import median

import numpy as np
import pytest

from greygate.errors import InputError
from greygate.identify.study import ROOT, Structure, Study, blocked, choose, find, identify, masked, stored, tails
from greygate.machines.measured.drives import drives
from greygate.machines.measured.study import CRANE, MTS, STUDIES
from greygate.machines.measured.tanks import MEAN, PUMP, pumped, square_root, tanks
from greygate.models.accuracy import rmse
from greygate.models.families.regression import noe
from greygate.models.network import Layer, Network, Port
from greygate.models.training.initial import initialised
from greygate.models.training.levenberg import Outcome, Trained, train
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record

CRANE_FILE = ROOT / "recordings" / "hydraulic-actuator-crane" / "actuator.csv"
MTS_RUNS = ("chirp_0A", "15Hz0A", "chirp_1A", "15Hz1A")


def small(seed=3, **options):
    y = Port("y", scale=4.0, initial=1.0)
    return noe("small", {Port("u", scale=2.0): (0, 2)}, y, (1, 3), (2,), seed, **options)


@pytest.fixture(scope="module")
def mts_runs():
    return MTS.runs()


def test_mts_trains_without_coil_current_and_tests_whole_runs_with_it(mts_runs):
    training, tests = mts_runs
    assert {n: len(r.targets["x_meas"]) for n, r in training.items()} == {"chirp_0A": 61500, "15Hz0A": 46800}
    assert {n: len(r.targets["x_meas"]) for n, r in tests.items()} == {"chirp_1A": 59100, "15Hz1A": 51900}
    assert all(r.skip == 0 for r in tests.values())


def test_crane_is_split_in_the_published_halves():
    runs = CRANE.records()
    assert [len(r) - r.skip for r in runs.values()] == [512, 512]
    assert runs["train"].inputs["u_valve"][0] == -0.0068164
    assert runs["test"].targets.keys() == {"p_oil"}


@pytest.mark.parametrize("name", STUDIES)
def test_stored_network_reproduces_its_figures(name):
    study = STUDIES[name]
    network, figures = stored(study)
    try:
        records = study.records()
    except InputError as missing:
        pytest.skip(str(missing))
    for run, record in records.items():
        assert study.score(network, record) == pytest.approx((figures["train"] | figures["test"])[run], rel=1e-6)


@pytest.mark.parametrize("name", STUDIES)
def test_stored_network_beats_the_linear_model(name):
    _, figures = stored(STUDIES[name])
    assert all(value < figures["linear"][run] for run, value in figures["test"].items())


def by_hand(network, u, y):
    """One-step predictions of `small` from measured y, in normalised units; rest is u = 0, y = 1."""
    p = network.parameters()
    u, y = np.r_[0, 0, 0, u] / 2, np.r_[1, 1, 1, y] / 4
    found = []
    for k in range(3, len(u)):
        taps = {"u_z0": u[k], "u_z2": u[k - 2], "y_z1": y[k - 1], "y_z3": y[k - 3]}
        n = p["hidden1.bias"] + sum(p[f"hidden1.{t}"][:, 0] * v for t, v in taps.items() if f"hidden1.{t}" in p)
        linear = sum(p[f"sum.{t}"][0, 0] * v for t, v in taps.items())
        found.append(4 * (p["sum.bias"][0] + linear + p["sum.hidden1"][0] @ np.tanh(n)))
    return np.array(found)


@pytest.mark.parametrize("linear_loop", [False, True])
def test_with_a_teacher_the_network_is_the_narx_written_by_hand(linear_loop):
    rng = np.random.default_rng(0)
    u, y = rng.normal(size=(2, 40))
    network = small(linear_loop=linear_loop)
    objective = Objective(network, [Record({"u": u}, {"y": y})], teacher=True)
    assert 4 * objective.errors(objective.theta)[0][:, 0] + y == pytest.approx(by_hand(network, u, y), abs=1e-12)


def test_in_free_run_its_own_output_stands_in_the_feedback():
    u = np.random.default_rng(1).normal(size=40)
    network = small()
    y = network.run({"u": u})["y"]
    assert y == pytest.approx(by_hand(network, u, y), abs=1e-12)
    assert rmse(network, Record({"u": u}, {"y": y + 0.5})) == pytest.approx(0.5)


def test_a_linear_loop_shows_hidden_neurons_no_feedback():
    assert {n for n in small(linear_loop=True).parameters() if n.startswith("hidden1")} == {
        "hidden1.u_z0", "hidden1.u_z2", "hidden1.bias",
    }  # fmt: skip


def test_the_output_cannot_feed_back_without_delay():
    with pytest.raises(InputError, match="the output's own at 1"):
        noe("n", {Port("u"): (0,)}, Port("y"), (0,))


@pytest.fixture
def crane_file(tmp_path):
    """A copy of the crane recording and a function that writes it with some lines changed."""
    lines = CRANE_FILE.read_text().splitlines()

    def write(change):
        (tmp_path / "actuator.csv").write_text("\n".join(change(list(lines))) + "\n")
        return tmp_path

    return write


BAD = {
    "a missing column": (lambda lines: [",".join(line.split(",")[:2]) for line in lines], "p_oil"),
    "NaN": (lambda lines: [*lines[:7], "6,nan,0,0", *lines[8:]], "not a finite number"),
    "a cut file": (lambda lines: lines[:900], "899 samples"),
    "a header alone": (lambda lines: lines[:1], "0 samples"),
}


@pytest.mark.parametrize("fault", BAD)
def test_a_bad_crane_recording_is_refused(fault, crane_file):
    change, message = BAD[fault]
    folder = crane_file(change)
    with pytest.raises(InputError, match=message):
        CRANE.records(folder)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t_s,x_cmd_m,x_meas_m\n0,0,0\n0.001,0,0\n0.005,0,0\n", "uniform"),
        ("", "empty"),
        ("t_s,x_cmd_m\n0,0\n0.001,0\n", "x_meas_m is missing"),
    ],
)
def test_a_bad_mts_recording_is_refused(text, message, tmp_path):
    for run in MTS_RUNS:
        (tmp_path / f"mts_{run}.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        MTS.records(tmp_path)


def test_a_recording_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match=r"mts_chirp_0A\.csv"):
        MTS.records(tmp_path)


def test_identification_repeats_and_saves_what_it_says(tmp_path):
    def load(folder):
        u = np.random.default_rng(5).normal(size=(2, 120))
        y = [np.convolve(v, [0, 0.6, 0.3, 0.1])[:120] for v in np.tanh(u)]
        return {"learnt": Record({"u": u[0]}, {"y": y[0]})}, {"new": Record({"u": u[1]}, {"y": y[1]})}

    def build(hidden):
        return lambda seed: noe("quick", {Port("u"): (1, 2)}, Port("y"), (1,), hidden, seed)

    def fit(network, records):
        return train(network, list(records), epochs=15, decay=1e-3)

    candidates = {"1 neuron": Structure(build((1,)), fit, grown=True), "2 neurons": Structure(build((2,)), fit)}
    study = Study("quick", "", "", load, Structure(build(()), fit), candidates, (0, 1), masked(3), 1.0)
    lines = []
    first, again = identify(study, tmp_path, lines.append), identify(study, tmp_path)
    assert len(lines) == 5
    assert first.figures["test"] == again.figures["test"]
    assert first.figures["held_out"] == min(first.figures["starts"][first.figures["candidate"]].values())
    assert first.figures["test"]["new"] < first.figures["linear"]["new"]
    first.save(tmp_path)
    network, figures = stored(study, tmp_path)
    assert figures == json.loads(json.dumps(first.figures))
    assert rmse(network, first.tests["new"]) == pytest.approx(first.figures["test"]["new"], rel=1e-12)


# ---- the rules of choice


GAINS = {"lucky": (0.9, 0.1, 0.2, 0.3), "steady": (0.6, 0.7, 0.6, 0.65), "diverging": (np.inf,) * 4}


@pytest.mark.parametrize(("typical", "chosen"), [(median, ("steady", 1)), (min, ("lucky", 0))])
def test_a_structure_is_chosen_by_the_median_of_its_seeds_unless_the_study_says_otherwise(typical, chosen):
    def build(gain):
        network = Network("gain", [Port("u")], [Port("y")])
        unstable = np.isinf(gain)
        network.add("gain", Layer({"u": [[1.0 if unstable else gain]], "y": [[1e3 * unstable]]}, [0.0]))
        network.connect("u", "gain.u")
        network.connect("gain", "gain.y", delay=1)
        network.connect("gain", "y")
        return network

    def fit(network, records):
        return Trained(network, Outcome.CONVERGED, (), 0.0)

    u = np.random.default_rng(0).normal(size=200)
    runs = {"all": Record({"u": u}, {"y": u})}
    candidates = {name: Structure(lambda seed, of=of: build(of[seed]), fit) for name, of in GAINS.items()}
    linear = Structure(lambda seed: build(0.0), fit)
    study = Study(
        "gain", "", "", lambda f: (runs, runs), linear, candidates, range(4), tails(0.2), 1.0, typical=typical
    )
    choice = choose(study, runs)
    assert (choice.candidate, choice.seed) == chosen
    assert choice.network.parameters()["gain.u"] == GAINS[chosen[0]][chosen[1]]


@pytest.mark.parametrize("name", [name for name in STUDIES if name != "mts"])
def test_the_stored_choice_is_what_the_rule_makes_of_the_stored_starts(name):
    figures = stored(STUDIES[name])[1]
    starts = {n: list(of.values()) for n, of in figures["starts"].items()}
    assert figures["candidate"] == min(starts, key=lambda n: STUDIES[name].typical(starts[n]))
    assert figures["held_out"] == min(starts[figures["candidate"]])


def counted(records):
    return np.concatenate([r.targets["y"][r.skip :] for r in records])


@pytest.mark.parametrize("folds", [tails(0.2), blocked(4, 5), blocked(3, 0), masked(4)])
def test_what_judges_is_not_what_was_fitted(folds):
    u = np.zeros(50)
    runs = {"a": Record({"u": u}, {"y": np.arange(50.0)}), "b": Record({"u": u}, {"y": np.arange(100.0, 150.0)})}
    for fold in folds(runs):
        assert not set(counted(fold.pieces)) & set(counted(fold.blocks))
        assert len(counted(fold.pieces)) == len(set(counted(fold.pieces)))


def test_masked_blocks_judge_every_sample_once():
    run = Record({"u": np.zeros(50)}, {"y": np.arange(50.0)})
    assert sorted(counted([b for fold in masked(4)({"a": run}) for b in fold.blocks])) == list(range(50))


def test_the_state_is_settled_by_the_skipped_samples_alone(monkeypatch):
    monkeypatch.setattr("greygate.models.training.initial.PRIOR", 1e-9)
    rng = np.random.default_rng(2)
    network = small(linear_loop=True)
    u = rng.normal(size=60)
    told = network.run({"u": u}, initial={"sum": 0.9})["y"]
    spoilt = told.copy()
    spoilt[20:] = rng.normal(size=40)
    first, second = (initialised(network, Record({"u": u}, {"y": v}, skip=20)) for v in (told, spoilt))
    assert all(np.array_equal(first.initial[n], second.initial[n]) for n in first.initial)
    assert rmse(network, first) < 1e-3 * rmse(network, Record({"u": u}, {"y": told}, skip=20))


def test_a_recording_is_found_where_the_environment_says(tmp_path, monkeypatch):
    (tmp_path / "mine").mkdir()
    monkeypatch.setenv("GREYGATE_RECORDINGS", str(tmp_path))
    assert find("mine", "nowhere") == tmp_path / "mine"
    with pytest.raises(InputError, match="get it from somewhere and put its folder into"):
        find("yours", "somewhere")


# ---- the structures


@pytest.mark.parametrize("options", [{}, {"rim": False, "widening": False, "delay": 0}, {"exchange": 2}])
def test_tanks_are_the_equations_of_their_docstring(options):
    network, root = tanks(3, **options), square_root()
    p = {n: w.ravel() for n, w in network.parameters().items()}
    u = np.random.default_rng(0).uniform(0, 10, size=200)
    drawn, past = network.run({"u": u}, trace=True), np.r_[PUMP.initial, u] / 10
    bend, delay = p.get("level.bend", [0.0])[0], options.get("delay", 1)
    x1, x2, level, full = [0.5] * 3, 0.5, 0.5, 0
    for k in range(200):
        f1 = x1[-1] + p["upper_fill.pump"][0] * past[k] + p["upper_fill.outflow"][0] * x1[-1] + p["upper_fill.bias"][0]
        out = root.run({"x": np.array([level + p["head.bias"][0]])})["y"][0]
        spilt = max(f1 + p["spill.bias"][0], 0.0)
        x2 += p["lower_fill.inflow"][0] * x1[-1 - delay] + p["lower_fill.outflow"][0] * out
        x2 += p["lower_fill.spill"][0] * spilt
        if "exchange" in options:
            x2 += p["lower_fill.exchange"] @ drawn["exchange"][k]
        x1.append(np.clip(f1, 0.0, 1.0))
        x2 = np.clip(x2, 0.0, 1.0)
        level = x2 + bend * (x2 * x2 - x2)
        full += f1 > 1
        assert drawn["y"][k] == pytest.approx(10 * level, abs=1e-9)
    assert full > 5
    assert np.abs(np.diff(drawn["y"])).max() > 0.1


def test_another_pump_gain_leaves_the_upper_tank_half_full_at_the_mean_of_the_pump():
    for factor in (0.7, 1.4):
        network = pumped(tanks(1), factor)
        upper = network.run({"u": np.full(50, MEAN)}, {"u": MEAN}, trace=True)["upper"]
        assert upper == pytest.approx(np.full(50, 0.5))
        assert network.parameters()["upper_fill.pump"] == pytest.approx(
            factor * tanks(1).parameters()["upper_fill.pump"]
        )


def test_drives_without_small_networks_are_the_equations_of_their_docstring():
    network = drives(3, friction=0)
    p = {n: w.ravel() for n, w in network.parameters().items()}
    u = np.random.default_rng(0).normal(size=50)
    v, z, past = np.zeros(53), np.zeros(51), np.r_[0, 0, 0, u / 4]
    for k in range(50):
        v[k + 3] = sum(p[f"speed.v{i}"][0] * v[k + 3 - i] + p[f"speed.u{i}"][0] * past[k + 3 - i] for i in (1, 2, 3))
        m = abs(v[k + 3])
        z[k + 1] = p["pulses.z1"][0] * z[k] + p["pulses.magnitude"][0] * m + p["pulses.square"][0] * m * m
    assert np.abs(v).max() < 2
    assert network.run({"u": u})["z"] == pytest.approx(4 * z[1:], abs=1e-12)


def test_small_networks_begin_with_hardly_any_part_in_the_drives():
    small = ("drive", "friction", "counter")
    for seed in range(10):
        weights = drives(seed, friction=2, counter=2, drive=2).parameters()
        shares = np.array([w.ravel() for name, w in weights.items() if name.rpartition(".")[2] in small])
        assert shares.shape == (3, 2)
        assert shares.all()
        assert (np.abs(shares) < 0.1).all()
