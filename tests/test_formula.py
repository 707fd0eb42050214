"""A formula for what has no name: hidden terms of a motor come back in their place, on their variable, as they were."""

import signal
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from greygate import progress
from greygate.cli.terminal import ended_early
from greygate.errors import InputError
from greygate.mismatch import coloured_selection, nearer
from greygate.mismatch import rig as rigs
from greygate.mismatch.concealed.conceal import EVERY_RIG, conceal
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.effects import read
from greygate.mismatch.forced import Acting, Forced, _opened, first
from greygate.mismatch.formula import Finder, Formula, Shape, Where
from greygate.mismatch.model import Model
from greygate.mismatch.nearer import Near, settled
from greygate.mismatch.runs import Runs
from greygate.mismatch.search import Hypothesis, Search
from greygate.mismatch.several import by_rule
from greygate.mismatch.unnamed import _removed
from greygate.mismatch.words import lines, where
from greygate.pages.diagnosis import page
from greygate.plants.plant import Plant
from greygate.plants.simulator import simulate
from greygate.progress import Budget

MOTOR = """
step = 1e-3
outputs = ["i", "w"]
inputs = { u = "V" }
parameters = { R = [1.2, "ohm"], L = [6e-3, "H"], K = [0.06, "V s"], J = [5.2e-4, "kg m^2"], b = [3e-4, "N m s"] }
states = { i = { unit = "A" }, w = { unit = "rad/s" } }
[equations]
electric.i = { storage = "L", supply = "u", resistance = "-R * i", emf = "-K * w" }
rotor.w = { storage = "J", torque = "K * i", viscous = "-b * w" }
"""
RIG = """
plant = "motor.toml"
sample_time_s = 0.004
predict = ["i", "w"]
parameters = { R = 1.2, L = 6e-3, K = 0.06, J = 5.2e-4, b = 3e-4 }
tolerance = { R = 0.1, J = 0.05, b = 0.3 }
channels.u = { unit = "V", role = "input" }
channels.i = { unit = "A", role = "output", noise_rms = 0.005 }
channels.w = { unit = "rad/s", role = "output", noise_rms = 0.05 }
"""
CART = """
step = 1e-3
outputs = ["x"]
inputs = { u = "N" }
parameters = { mass = [2.0, "kg"], b = [3.0, "N s/m"] }
states = { x = { unit = "m", rate = "v" }, v = { unit = "m/s" } }
[equations]
place.x = { speed = "v" }
motion.v = { storage = "mass", drive = "u", guide = "-b * v" }
"""
CART_RIG = """
plant = "cart.toml"
sample_time_s = 0.01
settle_s = 0.2
predict = ["x"]
parameters = { mass = 2.0, b = 3.0 }
channels.u = { unit = "N", role = "input" }
channels.x = { unit = "m", role = "output" }
"""
PAIR = """
step = 1e-3
outputs = ["x", "y"]
inputs = { u = "N" }
parameters = { m = [2.0, "kg"], n = [3.0, "kg"], c = [20.0, "N s/m"], k = [200.0, "N/m"] }
[states]
x = { unit = "m", rate = "v" }
v = { unit = "m/s" }
y = { unit = "m", rate = "w" }
w = { unit = "m/s" }
[equations]
first.x = { speed = "v" }
front.v = { storage = "m", pull = "u", spring = "-k * (x - y)", damper = "-c * (v - w)" }
second.y = { speed = "w" }
rear.w = { storage = "n", spring = "k * (x - y)", damper = "c * (v - w)", guide = "-c * w" }
"""
PAIR_RIG = """
plant = "pair.toml"
sample_time_s = 0.005
window_s = 0.25
predict = ["x", "y"]
parameters = { m = 2.0, n = 3.0, c = 20.0, k = 200.0 }
tolerance = { c = 0.1, k = 0.05 }
channels.u = { unit = "N", role = "input" }
channels.x = { unit = "m", role = "output", noise_rms = 1e-5 }
channels.y = { unit = "m", role = "output", noise_rms = 1e-5 }
"""
SAMPLES = 1500


@pytest.fixture
def hidden(tmp_path):
    """What makes a rig whose machine has a further term: (place, expression) -> the rig."""

    def make(place: str, term: str, told: bool = True):
        (tmp_path / "motor.toml").write_text(MOTOR)
        lines = [line.partition(", noise_rms")[0] + " }" * ("noise_rms" in line) for line in RIG.splitlines()]
        (tmp_path / "rig.toml").write_text(RIG if told else "\n".join(lines))
        plant = Plant.read(tmp_path / "motor.toml")
        real = plant.with_term(place, "hidden", term) if term else plant
        for seed, name in enumerate(("identify", "holdout")):
            rng = np.random.default_rng(seed)
            u = np.repeat(rng.uniform(-6, 6, SAMPLES // 25), 25)
            run = simulate(real, {"u": u}, sample_time=4e-3, step=1e-3)
            i, w = run["i"] + 0.005 * rng.standard_normal(SAMPLES), run["w"] + 0.05 * rng.standard_normal(SAMPLES)
            columns = np.column_stack([np.arange(SAMPLES) * 4e-3, u, i, w])
            np.savetxt(tmp_path / f"{name}.csv", columns, delimiter=",", header="t,u,i,w", comments="")
        return rigs.load(tmp_path)

    return make


def finder(rig) -> Finder:
    return Finder(Forced(Search(rig, rig.to_explain(), {})))


def test_a_drop_at_the_brushes_comes_back_with_its_knee_its_size_and_its_unit(hidden):
    result = diagnose(hidden("electric", "-0.35 * tanh(i / 0.1)"), effects={})
    found = result.as_dict()
    (place,) = found["where"]
    assert (place["equation"], place["depends_on"]) == ("electric", ["i"])
    size, _, rest = place["formula"].partition(" V tanh(i / ")
    assert float(size) == pytest.approx(-0.35, rel=0.03)
    assert float(rest.rstrip(")")) == pytest.approx(0.1, rel=0.1)
    for recording in found["fit"].values():
        assert all(rms["corrected"] < 1.1 * noise for rms, noise in zip(recording.values(), (0.005, 0.05), strict=True))
    assert any(place["formula"] in line for line in lines(result))
    assert place["formula"] in page(result)


def test_the_curve_holds_the_term_within_its_band(hidden):
    look = finder(hidden("rotor", "-2e-5 * w * abs(w)"))
    formula = look.found()
    assert (formula.place, formula.texts) == (("rotor",), ["w * abs(w)"])
    curve = look.curve(formula)
    truth = -2e-5 * curve.at * np.abs(curve.at)
    inside = (curve.low <= truth) & (truth <= curve.high)
    assert inside.mean() > 0.7
    assert np.ptp(curve.value) > 0.8 * np.ptp(truth)


@pytest.mark.parametrize(
    ("place", "term", "depends_on", "kind"),
    [
        ("electric", "-0.5", [], "constant"),
        ("rotor", "-0.004 * max(i - 1.5, 0)", ["i"], "threshold"),
        ("rotor", "-4e-4 * w * i", ["i", "w"], "product"),
        ("rotor", "0.01 * sin(0.6 * w)", ["w"], "periodic"),
    ],
)
def test_terms_of_other_kinds_come_back_on_their_variables(hidden, place, term, depends_on, kind):
    look = finder(hidden(place, term))
    formula = look.found()
    assert sorted(formula.depends_on) == depends_on
    assert kind in formula.kinds
    assert formula.share > 0.8


@pytest.fixture
def concealed(tmp_path):
    """What makes a rig of the generator with a hidden effect: (plant, effect, seed) -> the rig."""

    def make(plant: str, effect: str, seed: int):
        kind = "one" if effect in EVERY_RIG[plant].effects else "foreign"
        return rigs.load(conceal(plant, seed, tmp_path / effect, effect=effect, kind=kind))

    return make


def search(rig) -> Search:
    return Search(rig, rig.to_explain(), {})


def test_a_pull_to_a_place_comes_back_with_where_it_is_and_how_far_it_reaches(tmp_path):
    """A magnet beside the way of a cart on a spring, which swings through it with more and with less force."""
    (tmp_path / "cart.toml").write_text(CART.replace('guide = "', 'spring = "-40 * x", guide = "'))
    (tmp_path / "rig.toml").write_text(CART_RIG.replace('"output" }', '"output", noise_rms = 1e-4 }'))
    real = Plant.read(tmp_path / "cart.toml").with_term(
        "motion", "hidden", "-60 * (x - 0.3) * exp(-((x - 0.3) / 0.2)**2)"
    )
    rng = np.random.default_rng(4)
    force = np.repeat(rng.uniform(-30, 30, 60), 25)
    x = simulate(real, {"u": force}, sample_time=0.01, step=1e-3)["x"] + 1e-4 * rng.standard_normal(1500)
    columns = np.column_stack([np.arange(1500) * 0.01, force, x])
    np.savetxt(tmp_path / "identify.csv", columns, delimiter=",", header="t,u,x", comments="")
    _, formula = settled(search(rigs.load(tmp_path)), None)
    assert (formula.place, formula.depends_on, formula.kinds) == (("motion",), ["x"], ["local"])
    assert formula.shapes[0].numbers == (pytest.approx(0.3, abs=0.01), pytest.approx(0.2, rel=0.05))
    assert formula.share > 0.99


def test_a_signal_is_told_from_one_that_moves_like_it(concealed):
    """The voltages of a low pass: what a diode takes is of the one behind the resistor, though the other seems best."""
    rig = concealed("electrical", "diode", 32)
    assert finder(rig).found().depends_on == ["v_1"]
    _, formula = settled(search(rig), None)
    assert (formula.place, formula.depends_on, formula.kinds) == (("second",), ["v_2"], ["threshold"])
    assert formula.shapes[0].numbers[0] == pytest.approx(0.752, abs=0.01)
    assert formula.as_well == ()


def test_of_two_signals_that_nothing_tells_apart_the_stored_one_is_named_and_the_other_said(concealed):
    """A leak from v_1 is one from v_2 with another capacitor."""
    (place,) = diagnose(concealed("electrical", "leak", 32), effects={}).as_dict()["where"]
    assert (place["equation"], place["depends_on"], place["as_well"]) == ("second", ["v_2"], ["v_1"])
    ((said, _),) = where({"where": [place]})
    assert said == "second, depends on v_2 (v_1: does as well)"


def test_a_place_that_nothing_tells_apart_is_said_beside_the_one_whose_state_it_is(hidden):
    _, formula = settled(search(hidden("rotor", "-2e-5 * w * abs(w)")), None)
    assert (formula.place, formula.as_well) == (("rotor",), ())
    forced = Forced(search(hidden("rotor", "-0.5")))
    assert [forced.strange(("rotor",), [v]) for v in ("w", "i", "t")] == [0, 1, 2]
    assert forced.strange(("electric",), ["w", "i"]) == 1


@pytest.mark.parametrize("seed", [31, 32])
def test_what_grows_with_time_is_a_product_with_the_signal_that_it_acts_on(concealed, seed):
    _, formula = settled(search(concealed("tank", "clogging", seed)), None)
    assert (formula.place, formula.texts[0], formula.depends_on) == (("lower",), "t * sqrt(abs(h_2))", ["h_2", "t"])


def test_what_is_too_slow_for_short_windows_is_found_in_one_free_run(concealed):
    rig = concealed("tank", "leak", 31)
    assert finder(rig).found() is None
    look, formula = settled(search(rig), None)
    assert (look.forced.rig.window, formula.place, formula.texts) == (None, ("upper",), ["h_1"])
    assert look.coefficients(formula)[0] == pytest.approx(-3.355e-6, rel=0.05)


def test_a_speed_is_of_the_run_where_that_follows_the_recording_better(concealed):
    rig = concealed("quarter_car", "dry_friction", 32)
    forced = Forced(search(rig))
    smooth = forced.model.smooth_rate("z_body") - forced.model.smooth_rate("z_wheel")
    speed = forced.signals["(v_body - v_wheel)"]
    assert not np.array_equal(speed, smooth)
    found = diagnose(rig, effects={}).as_dict()
    assert [(place["equation"], place["depends_on"]) for place in found["where"]] == [
        ("body", ["v_body", "v_wheel"]),
        ("wheel", ["v_body", "v_wheel"]),
    ]
    (entry,) = found["effects"]
    (size,) = (p["value"] for p in entry["parameters"].values())
    assert size == pytest.approx(-33.2, rel=0.05)


def test_a_speed_is_smoothed_where_the_run_leaves_the_recording(tmp_path):
    """A cart with a spring that its plant has not."""
    (tmp_path / "cart.toml").write_text(CART)
    (tmp_path / "rig.toml").write_text(CART_RIG)
    real = Plant.read(tmp_path / "cart.toml").with_term("motion", "hidden", "-800 * x")
    force = np.repeat(np.random.default_rng(0).uniform(-50, 50, 20), 50)
    x = simulate(real, {"u": force}, sample_time=0.01, step=1e-3)["x"]
    columns = np.column_stack([np.arange(1000) * 0.01, force, x])
    np.savetxt(tmp_path / "identify.csv", columns, delimiter=",", header="t,u,x", comments="")
    forced = Forced(search(rigs.load(tmp_path)))
    assert np.array_equal(forced.signals["v"], forced.model.smooth_rate("x"))


def test_a_small_coefficient_is_fitted_in_steps_of_its_own_size(concealed):
    """A damping of 5e-7 N m s^2: a run with 1e-3 of one N m s^2 diverges."""
    found = diagnose(concealed("motor", "square_damping", 32), effects={}).as_dict()
    (entry,) = found["effects"]
    (size,) = (p["value"] for p in entry["parameters"].values())
    assert (entry["equations"], size) == (["motion"], pytest.approx(-4.99e-7, rel=0.02))


def test_near_a_run_with_a_term_the_errors_are_those_without_it(hidden):
    rig = hidden("electric", "-0.5")
    acting = Acting(("electric",), np.full(SAMPLES, -0.5))
    near, far = (Forced(search(rig), acting=a, free=True) for a in (acting, None))
    assert not near.lost
    told = near.expected / 0.9
    assert np.sum(near.run.projected**2) == pytest.approx(told, rel=0.1)
    assert np.sum(near.base.projected**2) > 20 * told
    assert Near(near).misfit > 0.8 * Finder(far).misfit
    constant = Formula(("electric",), (Shape(("1.0",), "constant", 1),), 0.0)
    assert Near(near).coefficients(constant)[0] == pytest.approx(-0.5, rel=0.02)


def test_the_share_is_of_the_runs_own_error_beyond_the_noise():
    channels = {"a": SimpleNamespace(sigma=1.0), "b": SimpleNamespace(sigma=0.0)}
    model = SimpleNamespace(rig=SimpleNamespace(channels=channels, predict=("a", "b")))

    def fit(*rms):
        errors = np.tile(np.array(rms), (4, 1))
        likelihood = SimpleNamespace(model=model, sigma=np.ones((4, 2)), residual=lambda values: errors)
        return SimpleNamespace(likelihood=likelihood, values={})

    assert _removed(fit(3.0, 2.0), fit(1.0, 2.0)) == pytest.approx(0.5)  # all of a, nothing of b
    assert _removed(fit(3.0, 2.0), fit(3.0, 9.0)) == 0.0


def test_what_acts_between_two_bodies_acts_on_both_with_opposite_signs(tmp_path):
    """A spring that hardens between two carriages, of which one is pulled."""
    (tmp_path / "pair.toml").write_text(PAIR)
    (tmp_path / "rig.toml").write_text(PAIR_RIG)
    plant, hard = Plant.read(tmp_path / "pair.toml"), "-4e3 * (x - y)**3"
    real = plant.with_term("front", "hidden", hard).with_term("rear", "hidden", hard.removeprefix("-"))
    rng = np.random.default_rng(0)
    force = np.repeat(rng.uniform(-40, 40, 40), 50)
    run = simulate(real, {"u": force}, sample_time=5e-3, step=1e-3)
    x, y = (run[name] + 1e-5 * rng.standard_normal(2000) for name in ("x", "y"))
    columns = np.column_stack([np.arange(2000) * 5e-3, force, x, y])
    np.savetxt(tmp_path / "identify.csv", columns, delimiter=",", header="t,u,x,y", comments="")
    look = finder(rigs.load(tmp_path))
    formula = look.found()
    assert (formula.place, formula.texts) == (("front", "rear"), ["(x - y)**3"])
    assert look.coefficients(formula)[0] == pytest.approx(-4e3, rel=0.1)


def test_where_nothing_is_missing_there_is_no_formula(hidden):
    look = finder(hidden("", ""))
    assert look.found() is None
    assert 0.0 < look.misfit < 0.2 * look.forced.expected  # a tenth of the noise's cost is not expected


def test_a_run_that_leaves_the_recording_is_begun_anew_and_noise_need_not_be_told(hidden):
    rig = hidden("electric", "-0.35 * tanh(i / 0.1)", told=False)
    assert not rig.stated
    look = finder(rig)
    assert look.forced.search.rig.window
    assert look.found().texts[0].startswith("tanh(i / 0.")


def test_an_accepted_formula_is_named_as_an_effect_of_the_rigs_own_table(hidden, greygate):
    rig = hidden("electric", "-0.02 * i**3")
    code, _, err = greygate("diagnose", rig.folder, "--accept")
    assert (code, "has the effect own_electric now: -0.0" in err) == (0, True)
    result = diagnose(rigs.load(rig.folder), effects=read(rig.folder / "effects.toml"))
    assert (str(result.verdict), [effect["id"] for effect in result.as_dict()["effects"]]) == (
        "missing_physics",
        ["own_electric"],
    )
    code, _, err = greygate("diagnose", rig.folder, "--accept")  # now it has a name
    assert (code, "found no formula (missing_physics): nothing was accepted" in err) == (2, True)
    assert greygate("diagnose", rig.folder, rig.folder, "--accept")[0] == 2


def test_an_input_of_the_plant_is_not_taken_for_one_of_the_search(hidden):
    rig = hidden("", "")
    plant = replace(rig.plant, inputs={**rig.plant.inputs, "forced_rotor": "N m"})
    with pytest.raises(InputError, match="forced_rotor: is the simulation's own name; rename it"):
        _opened(plant, ["rotor"])


def test_a_formula_that_is_refused_is_not_shown(hidden, monkeypatch):
    monkeypatch.setattr("greygate.mismatch.diagnose._no_term", lambda *_: "it does harm elsewhere")
    found = diagnose(hidden("electric", "-0.5"), effects={}).as_dict()
    assert found["refused"][-1] == "no term is fitted: it does harm elsewhere"
    assert ("formula" in found["where"][0], found["effects"]) == (False, [])


def test_a_run_that_begins_elsewhere_than_the_plant_says_begins_as_recorded(tmp_path):
    """The last 300 of 600 samples of a cart that moves: position and speed are those of that moment."""
    (tmp_path / "cart.toml").write_text(CART)
    (tmp_path / "rig.toml").write_text(CART_RIG)
    force = np.repeat(np.random.default_rng(0).uniform(-5, 5, 12), 50)
    x = simulate(Plant.read(tmp_path / "cart.toml"), {"u": force}, sample_time=0.01, step=1e-3)["x"]
    for name, part in (("identify", slice(0, 300)), ("holdout", slice(300, 600))):
        columns = np.column_stack([np.arange(300) * 0.01, force[part], x[part]])
        np.savetxt(tmp_path / f"{name}.csv", columns, delimiter=",", header="t,u,x", comments="")
    rig = rigs.load(tmp_path)
    first, second = (Model(rig, rig.recording(tmp_path / f"{name}.csv"), {}) for name in ("identify", "holdout"))
    assert (list(first.begins.values()), list(second.begins.values())) == ([], ["x", "v"])
    predicted, counts = by_rule(second, {}, skip=20)
    assert np.abs(predicted - second.target)[counts].max() < 1e-3 * np.ptp(x)
    place, speed = second.starts(second.values, second.inputs)[0]
    assert place == pytest.approx(x[300], abs=1e-3 * np.ptp(x))
    assert speed == pytest.approx((x[301] - x[299]) / 0.02, rel=0.1)


def test_when_the_time_is_over_the_best_so_far_is_said_and_what_was_not_tried(hidden, greygate):
    rig = hidden("rotor", "-0.004 * max(i - 1.5, 0)")
    found = diagnose(rig, budget=Budget(0.0)).as_dict()
    assert (found["verdict"], len(found["not_tried"]) > 2) == ("unexplained", True)
    assert not found["effects"]
    code, out, _ = greygate("diagnose", rig.folder, "--seconds", "1e-9")
    assert (code, "not tried" in out, "there was no time to try every effect" in out) == (0, True, True)


def test_a_search_leaves_time_to_test_what_it_finds(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress, "monotonic", lambda: now[0])
    budget = Budget(100.0)
    now[0] = 50.0
    with budget.searching():
        assert not budget.over
        now[0] = 81.0
        assert budget.over
    assert not budget.over
    now[0] = 100.0
    assert budget.over


def test_the_first_interrupt_ends_the_budget_and_the_second_the_command(capsys):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # what starts in the background ignores it
    try:
        with ended_early(Budget()) as budget:
            assert not budget.over
            signal.raise_signal(signal.SIGINT)
            assert budget.over
            assert "ending with what was found" in capsys.readouterr().err
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_long_recording_is_looked_at_in_part_and_several_in_equal_parts(hidden):
    recording = hidden("", "").to_explain()
    several = Runs.of([recording, recording])
    assert first(recording, SAMPLES) is recording
    assert first(recording, 300).samples == 300
    assert [run.samples for run in first(several, 600).runs] == [300, 300]


@pytest.mark.parametrize(("left", "share", "instead"), [(0.4, 0.9, True), (0.6, 0.9, False), (0.4, 0.0, False)])
def test_without_a_told_noise_a_term_stands_in_the_place_of_names_that_leave_twice_as_much(
    monkeypatch, left, share, instead
):
    totals = {"term": left, "names": 1.0}
    monkeypatch.setattr(coloured_selection, "Judge", lambda of: SimpleNamespace(total=lambda fit, exact: totals[of]))
    named, closed = (SimpleNamespace(likelihood=of) for of in ("names", "term"))
    outdone = coloured_selection.ColouredSelection.outdone
    assert outdone(None, Hypothesis(("input_dead_zone",)), 0.87, share, named, closed) == instead


def test_what_is_best_near_the_run_is_tried_though_it_was_no_rival_in_proportion(monkeypatch):
    """Of a motor's brush drop the current was none, as its curve is too sharp; near the run it takes all."""
    far, near, both = (Where(("electric",), (v,), gain) for v, gain in (("u", 9.0), ("i", 10.0), ("u", 8.0)))
    tried = []
    finder = SimpleNamespace(
        found=lambda: Formula(("electric",), (Shape(("u",), "linear", 1),), 0.6), ranked=[far], where=("", "", 9.0),
        misfit=10.0, forced=SimpleNamespace(expected=1.0, anew=False),
    )  # fmt: skip
    there = SimpleNamespace(
        ranked=[near, both], where=("", "", 10.0), misfit=10.0, unclear=lambda formula: False,
        best=lambda formula, rivals: (tried.extend(rivals), (formula, rivals))[1],
    )  # fmt: skip
    monkeypatch.setattr(nearer, "Finder", lambda forced: finder)
    monkeypatch.setattr(nearer, "Forced", lambda *given, **named: None)
    monkeypatch.setattr(nearer, "_near", lambda *given: there)
    settled(None, None)
    assert [(w.variables, w.gain) for w in tried] == [(("i",), 10.0), (("u",), 9.0)]
    there.ranked[1] = replace(both, gain=9.5)
    tried.clear()
    settled(None, None)
    assert [(w.variables, w.gain) for w in tried] == [(("i",), 10.0), (("u",), 9.5)]  # once, as it is near the run
