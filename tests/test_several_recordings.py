"""Several recordings of one machine: explained together, each held out in turn; and recordings of uneven time."""

import json

import numpy as np
import pytest

from greygate.errors import InputError
from greygate.mismatch import rig as rigs
from greygate.mismatch import words
from greygate.mismatch.blocks import Judge
from greygate.mismatch.coloured import Coloured, _late
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.excitation import signals
from greygate.mismatch.explain import predict
from greygate.mismatch.fit import Likelihood
from greygate.mismatch.noise import Noise
from greygate.mismatch.runs import Runs, along, whole
from greygate.mismatch.search import Hypothesis, Search
from greygate.mismatch.seen import Seen
from greygate.mismatch.several import Several, modelled
from greygate.mismatch.uneven import resampled
from greygate.plants import Plant, simulate
from greygate.plants.plant import Parameter
from greygate.progress import Budget

AXIS = """
step = 1e-3
outputs = ["x"]
inputs = { force = "N" }
parameters = { mass = [20.0, "kg"], viscous = [400.0, "N s/m"] }
[states]
x = { unit = "m", rate = "v" }
v = { unit = "m/s" }
[equations]
position.x = { velocity = "v" }
motion.v = { storage = "mass", motor = "force", viscous = "-viscous * v" }
"""
SHEET = """
plant = "axis.toml"
sample_time_s = 0.005
predict = ["x"]
ENTRIES
parameters = { mass = 20.0, viscous = 400.0 }
tolerance = { mass = 0.1, viscous = 0.1 }
channels.force = { unit = "N", role = "input", resolution = 1e-3 }
channels.x = { unit = "m", role = "output", noise_rms = NOISE }
"""
THREE = 'identify = ["run1.csv", "run2.csv", "run3.csv"]\nholdout = ["run4.csv"]'
SEEDS = {"run1": 1, "run2": 3, "run3": 7, "run4": 8}
SAMPLES = 400
TABLE = ("spring", "input_offset", "input_dead_zone", "square_damping", "hardening_spring", "dry_friction")


def written(folder, entries: str, noise: float, names=tuple(SEEDS), **each) -> rigs.Rig:
    """A rig of recordings `names`. each: mass, spring (N/m) or size of the force of one, or by name of a recording."""
    (folder / "axis.toml").write_text(AXIS)
    (folder / "rig.toml").write_text(SHEET.replace("ENTRIES", entries).replace("NOISE", repr(noise)))
    for name in names:
        mass, spring, size = (
            each.get(key, usual)[name] if isinstance(each.get(key), dict) else each.get(key, usual)
            for key, usual in (("mass", 20.5), ("spring", 0.0), ("size", 60.0))
        )
        force = size * np.repeat(np.random.default_rng(SEEDS[name]).standard_normal(SAMPLES // 40), 40)
        plant = Plant.read(folder / "axis.toml").with_parameters(mass=mass)
        plant = plant.with_term("motion", "hidden", "-hidden * x", {"hidden": Parameter(spring, "N/m")})
        x = simulate(plant, {"force": force}, sample_time=5e-3, step=1e-3)["x"]
        x = x + noise * np.random.default_rng(100 + SEEDS[name]).standard_normal(SAMPLES)
        columns = np.column_stack([np.arange(SAMPLES) * 5e-3, force, x])
        np.savetxt(folder / f"{name}.csv", columns, "%.12g", delimiter=",", header="t,force,x", comments="")
    return rigs.load(folder)


def few(rig: rigs.Rig) -> dict:
    """The effects of TABLE, so that a test is short."""
    from greygate.mismatch.effects import known

    return {key: effect for key, effect in known(rig, rig.to_explain()).items() if effect.id in TABLE}


# -- what they say together --------------------------------------------------------------------------------------------


def test_three_recordings_name_together_what_none_shows_alone(tmp_path):
    """Alone the noise hides the spring: nothing is named, or only with little confidence."""
    rig = written(tmp_path, THREE, 2.8e-3, spring=20.0)
    found = diagnose(rig).as_dict()
    assert found["verdict"] == "missing_physics"
    assert [effect["id"] for effect in found["effects"]] == ["spring"]
    low, high = found["effects"][0]["parameters"]["k_x"]["ci95"]
    assert low < 20.0 < high
    assert set(found["effects"][0]["recordings"]) == {"run1", "run2", "run3"}
    assert found["effects"][0]["confidence"] > 0.95
    for name in ("run1", "run2", "run3"):
        (tmp_path / "rig.toml").write_text(
            SHEET.replace("ENTRIES", f'identify = ["{name}.csv"]').replace("NOISE", "2.8e-3")
        )
        alone = diagnose(rigs.load(tmp_path)).as_dict()
        assert not any(effect["confidence"] > 0.9 for effect in alone["effects"]), name


@pytest.fixture(scope="module")
def one_shows(tmp_path_factory):
    """In two recordings the axis hardly moves, so that a spring hardly pulls."""
    size = {"run1": 0.5, "run2": 0.5, "run3": 60.0, "run4": 60.0}
    rig = written(tmp_path_factory.mktemp("one"), THREE, 2e-4, spring=20.0, size=size)
    return diagnose(rig, effects=few(rig))


def test_an_effect_that_one_recording_shows_is_said_to_be_so(one_shows):
    found = one_shows.as_dict()
    assert [effect["id"] for effect in found["effects"]] == ["spring"]
    assert found["effects"][0]["shown_by"] == ["run3"]
    assert found["effects"][0]["recordings"]["run3"]["without"] < 1.0
    assert "only run3 shows it" in found["where"][0]["regime"]
    assert "in run3" in found["where"][0]["time"]
    assert any("only run3 shows it" in line for line in words.lines(one_shows))


def test_the_error_is_told_of_all_together_and_of_each(one_shows):
    fit = one_shows.as_dict()["fit"]
    assert list(fit) == ["identify", "run1", "run2", "run3", "holdout"]
    squared = [fit[name]["x"]["corrected"] ** 2 for name in ("run1", "run2", "run3")]
    assert fit["identify"]["x"]["corrected"] == pytest.approx(np.sqrt(np.mean(squared)))
    assert fit["holdout"]["x"]["corrected"] < 0.2 * fit["holdout"]["x"]["calibrated"]


def test_what_one_of_three_machines_has_is_told_of_that_one(tmp_path):
    """The spring was hung in for one recording alone: together they are unexplained, alone that one is not."""
    spring = {"run1": 0.0, "run2": 0.0, "run3": 60.0, "run4": 0.0}
    rig = written(tmp_path, THREE, 2e-4, spring=spring)
    found = diagnose(rig, effects=few(rig)).as_dict()
    assert found["verdict"] == "unexplained"
    alone = {name: entry["alone"] for name, entry in found["recordings"].items()}
    assert [alone[name]["verdict"] for name in alone] == ["consistent", "consistent", "missing_physics"]
    assert [effect["id"] for effect in alone["run3"]["effects"]] == ["spring"]
    late = diagnose(rig, effects=few(rig), budget=Budget(0.0)).as_dict()
    assert {"run1.csv alone", "run2.csv alone", "run3.csv alone"} <= set(late["not_tried"])
    assert not any("alone" in entry for entry in late.get("recordings", {}).values())


# -- what differs from recording to recording --------------------------------------------------------------------------


MASSES = {"run1": 20.5, "run2": 26.0, "run3": 20.5, "run4": 30.0}
OTHER = "\nrecordings.run4.parameters = { mass = 30.0 }"


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    """A payload that the data sheet knows to 10 % in run2, and exactly in the held-out run4."""
    own = THREE + "\nrecordings.run2 = { parameters = { mass = 25.0 }, tolerance = { mass = 0.1 } }" + OTHER
    rig = written(tmp_path_factory.mktemp("loaded"), own, 2e-5, spring=20.0, mass=MASSES)
    return diagnose(rig, effects=few(rig))


def test_a_payload_of_its_own_is_fitted_in_its_recording_alone(loaded):
    found = loaded.as_dict()
    assert [effect["id"] for effect in found["effects"]] == ["spring"]
    for parameters, mass in ((found["parameters"], 20.5), (found["recordings"]["run2"]["parameters"], 26.0)):
        low, high = parameters["mass"]["ci95"]
        assert low < mass < high
    assert found["recordings"].keys() == {"run2"}
    assert found["fit"]["holdout"]["x"]["corrected"] < 1.1 * 2e-5


def test_simulate_takes_the_values_of_the_recording_that_it_is_given(loaded, tmp_path):
    folder, found = loaded.rig.folder, loaded.as_dict()
    (tmp_path / "d.json").write_text(json.dumps(found))
    for name, part in (("run2", "run2"), ("run4", "holdout")):
        rms = predict(folder, folder / f"{name}.csv", tmp_path / "d.json", tmp_path / "s.csv")["x"]["rms"]
        assert rms == pytest.approx(found["fit"][part]["x"]["corrected"], rel=1e-6)
    (tmp_path / "copy.csv").write_text((folder / "run2.csv").read_text())
    plain = predict(folder, tmp_path / "copy.csv", tmp_path / "d.json", tmp_path / "s.csv")["x"]["rms"]
    named = predict(folder, tmp_path / "copy.csv", tmp_path / "d.json", tmp_path / "s.csv", name="run2")["x"]["rms"]
    assert named < 0.1 * plain


def test_an_exact_value_is_not_fitted_and_a_shared_one_is_no_longer_where_all_have_their_own(tmp_path):
    own = "".join(f"\nrecordings.{n}.parameters = {{ mass = {20 + i} }}" for i, n in enumerate(SEEDS))
    rig = written(tmp_path, THREE + own, 2e-5)
    assert list(rig.uncertain()) == ["viscous"]
    model = modelled(rig, rig.to_explain(), {})
    assert isinstance(model, Several)
    assert [there["mass"] for there in model.in_each(model.values)] == [20.0, 21.0, 22.0]
    assert model.spread(model.values)["mass"].tolist() == [20.0] * 400 + [21.0] * 400 + [22.0] * 400
    begins = 'anew = ["viscous"]\n' + THREE
    rig = written(tmp_path, begins, 2e-5)
    assert list(rig.uncertain()) == ["mass", "viscous@run1", "viscous@run2", "viscous@run3"]


def test_own_values_are_kept_where_their_recording_is_held_out(loaded):
    judge = Judge(loaded.corrected.likelihood)
    held = judge.fold == 1
    values = Judge.unseen(judge, loaded.corrected, held)
    assert np.sqrt(np.mean(values**2)) < 1.2 * 2e-5


# -- nothing looks across a seam ---------------------------------------------------------------------------------------


@pytest.fixture
def three(tmp_path) -> rigs.Rig:
    return written(tmp_path, THREE, 2e-4)


@pytest.mark.parametrize("window", ["", "\nwindow_s = 0.3"])
def test_a_run_of_several_is_each_run_alone(tmp_path, window):
    rig = written(tmp_path, THREE + window, 2e-4)
    together = rig.to_explain()
    effects = few(rig)
    joined = modelled(rig, together, effects)
    values = {**joined.values, "k_x": 30.0}
    alone = [modelled(rig, run, effects) for run in together.runs]
    np.testing.assert_array_equal(joined.predict(values), np.concatenate([m.predict(values) for m in alone]))
    np.testing.assert_array_equal(joined.states(values)[0], np.concatenate([m.states(values)[0] for m in alone]))
    assert joined.restarts.tolist() == [400 * k + r for k, m in enumerate(alone) for r in m.restarts]
    if window:
        np.testing.assert_array_equal(joined.smooth_rate("x"), np.concatenate([m.smooth_rate("x") for m in alone]))
        ranges = [Likelihood(m) for m in (joined, *alone)]
        assert ranges[0].windows == sum(one.windows for one in ranges[1:])
        assert ranges[0].recording.tolist() == [0] * 6 + [1] * 6 + [2] * 6
        assert [len(m.restarts) for m in alone] == [7] * 3  # six whole windows, and what is left of each recording
        assert [one.fitted.tolist() for one in ranges] == [
            [*range(6), *range(7, 13), *range(14, 20)],
            *[[*range(6)]] * 3,
        ]
        shifts = np.random.default_rng(0).standard_normal((21, 2))
        moved = [m.predict(values, s) for m, s in zip(alone, np.split(shifts, 3), strict=True)]
        np.testing.assert_array_equal(joined.predict(values, shifts), np.concatenate(moved))


@pytest.mark.parametrize("kind", [Likelihood, Coloured])
def test_noise_of_a_recording_knows_nothing_of_the_one_before(three, kind):
    model = modelled(three, three.to_explain(), {})
    likelihood = kind(model)
    ar = (np.array([0.5, 0.2]),)
    if kind is Coloured:
        likelihood.ar, likelihood.scale = list(ar), np.ones(1)
    else:
        likelihood.noise = Noise(np.ones(1), ar)
    what = np.zeros((1200, 1))
    what[399] = 1.0  # the last sample of the first recording
    likelihood.sigma[:] = 1.0
    white = likelihood.white(what)
    assert not np.any(white[400:])
    late = _late(what[:, 0], 3, model.pieces)
    assert not np.any(late)


def test_rates_and_filters_end_with_their_recording(three):
    together = three.to_explain()
    found = signals(three, together)
    alone = [signals(three, run) for run in together.runs]
    for name in found:
        np.testing.assert_array_equal(found[name], np.concatenate([one[name] for one in alone]))
    steps = Seen(three, together)._changes("force")
    assert len(steps) == 1200 - 3
    pieces = [slice(0, 2), slice(2, 5)]
    assert along(np.cumsum, pieces, np.ones(5)).tolist() == [1, 2, 1, 2, 3]
    count, kept = whole(pieces, 2)
    assert (count, kept.tolist()) == (2, [0, 1, 2, 3])


def test_each_recording_is_a_block_where_the_others_show_the_effect(three):
    effects = few(three)
    search = Search(three, three.to_explain(), effects)
    plain = search.fit(search.final, Hypothesis(), {})
    spring = search.fit(search.final, Hypothesis(("spring",)), {})
    judge = Judge(search.final)
    assert [block.sum() for block in judge.blocks(plain, plain)] == [400, 400, 400]
    cut = judge.blocks(plain, spring)  # there is none: no others show it, so every recording is cut
    assert len(cut) == 15
    assert np.array_equal(np.sum(cut, axis=0), np.ones(1200))


# -- rig.toml ----------------------------------------------------------------------------------------------------------


def test_one_recording_by_name_says_what_identify_csv_says(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    one = written(
        tmp_path / "a", 'identify = ["run1.csv"]\nholdout = ["run2.csv"]', 2e-5, ["run1", "run2"], spring=20.0
    )
    two = written(tmp_path / "b", "", 2e-5, ["run1", "run2"], spring=20.0)
    for old, new in (("run1", "identify"), ("run2", "holdout")):
        (two.folder / f"{old}.csv").rename(two.folder / f"{new}.csv")
    found = [diagnose(rig, effects=few(rig)).as_dict() for rig in (one, two)]
    assert {**found[0], "seconds": 0} == {**found[1], "seconds": 0}
    assert not {"recordings", "shown_by"} & {*found[0], *found[0]["effects"][0]}
    assert not isinstance(two.to_explain(), Runs)


@pytest.mark.parametrize(
    ("entries", "says"),
    [
        ("identify = []", "identify: .*; list the files"),
        ('identify = ["run1.csv", "run1.csv"]', "each name once"),
        ('identify = ["run1.csv", "../run2.csv"]', "not a file name"),
        (THREE + "\nrecordings.run5.parameters = { mass = 2.0 }", "recordings.run5: is no recording"),
        (THREE + "\nrecordings.run2.parameters = { masse = 2.0 }", "recordings.run2.parameters.masse: is no entry"),
        (THREE + "\nrecordings.run2.payload = 2.0", "there is no such entry"),
    ],
)
def test_a_list_of_recordings_that_cannot_serve_is_refused(tmp_path, entries, says):
    with pytest.raises(InputError, match=says):
        written(tmp_path, entries, 2e-4, ["run1"])


def test_a_missing_file_is_named(three):
    (three.folder / "run2.csv").unlink()
    with pytest.raises(InputError, match=r"run2\.csv: cannot be read"):
        three.to_explain()


# -- uneven time -------------------------------------------------------------------------------------------------------


def uneven(rig: rigs.Rig, name: str, noise: float, gap: int = 0) -> np.ndarray:
    """Record run NAME again, with a spring, at instants 2.5 to 7.5 ms apart at which the force changes, too.

    Returns the noiseless position every 5 ms. gap: ms at half time in which nothing is recorded.
    """
    rng, fine = np.random.default_rng(5), 5e-4
    at = np.cumsum(np.append(0, rng.integers(5, 16, SAMPLES)))
    table = np.loadtxt(rig.folder / f"{name}.csv", delimiter=",", skiprows=1)
    force = table[np.minimum(at // 10, SAMPLES - 1), 1]
    held = np.repeat(force, np.diff(at, append=at[-1] + 10))
    plant = Plant.read(rig.folder / "axis.toml").with_parameters(mass=20.5)
    plant = plant.with_term("motion", "hidden", "-20.0 * x", {})
    x = simulate(plant, {"force": held}, sample_time=fine, step=fine)["x"]
    seen = x[at] + noise * rng.standard_normal(len(at))
    kept = (at < at[-1] // 2) | (at > at[-1] // 2 + 2 * gap)
    columns = np.column_stack([at * fine, force, seen])[kept]
    np.savetxt(rig.folder / f"{name}.csv", columns, "%.9g", delimiter=",", header="t,force,x", comments="")
    return x[::10]


def test_uneven_time_is_made_even_and_said(tmp_path):
    rig = written(tmp_path, THREE, 3e-4, spring=20.0)
    true = uneven(rig, "run2", 3e-4)
    made = rig.recording(rig.folder / "run2.csv")
    assert made.history[0].startswith("time steps of 2.5 to 7.5 ms, resampled to 5 ms; between two readings x is unc")
    assert np.sqrt(np.mean((made["x"] - true[: made.samples]) ** 2)) < 3e-4  # of the noise a straight line takes a part
    found = diagnose(rig, effects=few(rig)).as_dict()
    assert [effect["id"] for effect in found["effects"]] == ["spring"]
    assert found["recordings"] == {"run2": {"resampled": made.history[0]}}


def test_a_gap_is_still_refused_and_a_slip_of_one_clock(tmp_path):
    rig = written(tmp_path, THREE, 2e-5)
    uneven(rig, "run2", 2e-5, gap=200)
    with pytest.raises(InputError, match=r"run2\.csv: row .*, column t: step 0\.2"):
        rig.recording(rig.folder / "run2.csv")
    rows = (rig.folder / "run1.csv").read_text().splitlines()
    (rig.folder / "run1.csv").write_text("\n".join(rows[:49] + rows[50:]))
    with pytest.raises(InputError, match=r"step 0\.01 s where 0\.005 s"):
        rig.recording(rig.folder / "run1.csv")


def test_an_input_that_is_held_keeps_its_mean(tmp_path):
    clock, u = np.array([0.0, 1.5, 2.0, 4.0]), np.array([1.0, 3.0, 5.0, 7.0])
    instants, out, _ = resampled(clock, {"u": u, "x": clock}, 1.0, ["u"], {"u": "V", "x": "m"})
    assert instants.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert out["u"].tolist() == [1.0, 2.0, 5.0, 5.0, 7.0]  # half of the second sample is 1 V, half 3 V
    np.testing.assert_allclose(out["x"], instants)


def test_an_input_that_rests_goes_on_resting():
    """To the last bit, however its instants vary: else a recording shows what never moved."""
    clock = np.cumsum(np.random.default_rng(4).uniform(4e-3, 6e-3, 500))
    _, made, _ = resampled(clock, {"on": np.full(500, 7.3)}, 5e-3, {"on"}, {"on": "V"})
    assert set(made["on"]) == {7.3}


def test_a_name_of_any_length_stands_apart_from_the_next_column():
    rms = {"simulation": 0.1, "calibrated": 0.02, "corrected": 0.01, "unit": "rad"}
    head, *lines = words.fit_table({"identify": {"q": rms}, "a_very_long_name": {"q": rms, "pressure_of_oil": rms}})
    assert [line.split()[:3] for line in lines] == [
        ["identify", "q", "rad"], ["a_very_long_name", "q", "rad"], ["a_very_long_name", "pressure_of_oil", "rad"],
    ]  # fmt: skip
    assert len({len(line) for line in (head, *lines)}) == 1
