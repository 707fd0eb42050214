"""The search where nobody told the noise: the run's error ranks, in the longest steps of time that serve."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from greygate import diagnose
from greygate.mismatch import coloured_selection, words
from greygate.mismatch import rig as rigs
from greygate.mismatch.coloured import Coloured, resized
from greygate.mismatch.coloured_selection import ALIKE, SURE, ColouredSelection, _foretells, quicker, selected
from greygate.mismatch.diagnosis import SCHEMA
from greygate.mismatch.effects import known
from greygate.mismatch.entries import Effect, Free
from greygate.mismatch.fit import Likelihood, Unknown
from greygate.mismatch.model import Model
from greygate.mismatch.search import Hypothesis, Score, Search
from greygate.mismatch.simulation import simulate as replayed
from greygate.plants.expressions import summands
from greygate.plants.plant import Parameter, Plant
from greygate.plants.simulator import Restarted, simulate

PLANT = """step = 1e-3
outputs = ["x"]
[inputs]
force = "N"
[parameters]
mass = [20.0, "kg"]
viscous = [300.0, "N s/m"]
[states]
x = { unit = "m", rate = "v" }
v = { unit = "m/s" }
[equations.position]
x = { velocity = "v" }
[equations.motion]
v = { storage = "mass", drive = "force", viscous = "-viscous * v" }
"""
RIG = """plant = "slide.toml"
sample_time_s = 0.012
predict = ["x"]
parameters = { mass = 20.0, viscous = 300.0 }
tolerance = { mass = 0.1, viscous = 0.2 }
channels.force = { unit = "N", role = "input" }
channels.x = { unit = "m", role = "output" }
"""
SAMPLES = 600


def recorded(folder, mass: float = 20.0, more: str = "") -> Coloured:
    """The likelihood of a slide whose friction is 10 % higher. more: a term that the real one has beside."""
    (folder / "slide.toml").write_text(PLANT.replace("step = 1e-3", "step = 1e-4"))
    (folder / "rig.toml").write_text(RIG.replace("mass = 20.0", f"mass = {mass}"))
    text = (folder / "slide.toml").read_text()
    (folder / "real.toml").write_text(text.replace('* v" }', f'* v", more = "{more}" }}') if more else text)
    real = Plant.read(folder / "real.toml").with_parameters(mass=mass, viscous=330.0)
    rng = np.random.default_rng(1)
    force = 80 * np.repeat(rng.standard_normal(SAMPLES // 10), 10)
    x = simulate(real, {"force": force}, sample_time=0.012, step=1e-4)["x"]
    table = np.column_stack([np.arange(SAMPLES) * 0.012, force, x + 1e-5 * rng.standard_normal(SAMPLES)])
    np.savetxt(folder / "identify.csv", table, delimiter=",", header="t,force,x", comments="", fmt="%.10g")
    rig = rigs.load(folder)
    return Coloured(Model(rig, rig.recording(folder / "identify.csv"), {}))


def test_a_fit_ends_where_plant_and_noise_agree(tmp_path):
    """Under the noise that it ends with, the plant's own fit is nowhere else."""
    before = recorded(tmp_path)
    before = before.ordered(before.residual({}))
    assert before.order
    fit = before.fit([Unknown("mass", 20.0, 1.0, 1.0), Unknown("viscous", 300.0, 30.0, 1.0)])
    again, first = (Likelihood.fit(noise, fit.unknowns, fit.values) for noise in (fit.likelihood, before))
    for u in fit.unknowns:
        assert abs(again.values[u.symbol] - fit.values[u.symbol]) < 0.1 * fit.deviation(u.symbol)
    assert abs(first.values["viscous"] - fit.values["viscous"]) > 0.2 * fit.deviation("viscous")


def test_a_plant_in_other_steps_is_the_plant_compiled_for_them(tmp_path):
    (tmp_path / "slide.toml").write_text(PLANT)
    plant = Plant.read(tmp_path / "slide.toml")
    force = np.random.default_rng(2).standard_normal((50, 1))
    run = (force, np.array([0]), np.zeros((1, 2)), np.array([True, True]), dict(mass=20.0, viscous=300.0))
    fine, coarse = (Restarted(plant, 0.012, step) for step in (1e-3, 4e-3))
    assert not np.array_equal(fine.run(*run), coarse.run(*run))
    assert np.array_equal(fine.in_steps(3).run(*run), coarse.run(*run))
    assert fine.substeps == 12  # the one it was made of is as it was


def test_hypotheses_are_ranked_in_the_longest_steps_that_change_little(tmp_path):
    fine = recorded(tmp_path)
    error = np.std(fine.residual({}))
    quick = quicker(fine, {})
    assert quick.model.longer_steps == []  # one step over which an input rests
    assert 0 < np.std(quick.residual({}) - fine.residual({})) <= ALIKE * error
    assert fine.model.longer_steps  # the one it was made of is as it was
    stiff = quicker(recorded(tmp_path, mass=0.05), {}).model  # of 0.17 ms: a run in steps of 1.2 ms diverges
    assert stiff.longer_steps == [1]


def test_what_one_fold_alone_shows_may_be_missing_there_and_what_chance_shows_is_not_borne_out(tmp_path):
    likelihood = recorded(tmp_path)
    fixed = likelihood.fit([Unknown("mass", 20.0, 1.0, 1.0)], {"viscous": 300.0})
    free = likelihood.fit([Unknown("mass", 20.0, 1.0, 1.0), Unknown("viscous", 300.0, 30.0, 1.0)])
    assert _foretells(fixed, free, exact=False)
    assert _foretells(fixed, free, exact=True)
    assert not _foretells(free, fixed, exact=False)
    assert not _foretells(free, fixed, exact=True)
    lost = np.array(free.projected)
    lost[:2] *= 1e3  # the first block: of the first fold alone
    spoilt = replace(free)
    vars(spoilt).update(projected=lost, slopes=np.zeros_like(free.slopes))
    assert _foretells(fixed, spoilt, exact=False)
    lost[2:4] *= 1e3  # and of the second
    assert not _foretells(fixed, spoilt, exact=False)


@pytest.mark.parametrize("name", ["in_steps", "driven"])
def test_a_model_made_of_another_leaves_that_as_it_was(tmp_path, name):
    model = recorded(tmp_path).model
    before = model.predict(model.values)
    arguments = {"in_steps": (1,), "driven": ("force", np.zeros(SAMPLES))}[name]
    other = getattr(model, name)(*arguments)
    assert not np.array_equal(other.predict(model.values), before)
    assert np.array_equal(model.predict({**model.values, "mass": 20.0}), before)


def test_what_an_effect_adds_is_computed_without_what_its_strengths_of_0_take_away():
    assert summands("a * sin(x) + -b*cos(x / p) + (c + d) * x") == [
        ("a", "a * sin(x)"), ("b", "-b * cos(x / p)"), ("", "(c + d) * x"),
    ]  # fmt: skip
    assert summands("a * x / b") == [("a", "a * x / b")]
    assert summands("a - b") == [("", "a - b")]  # not a sum of two multiples: it stays whole


def test_the_size_of_what_is_negative_alone_stays_within_its_bound():
    """A lap of a valve that is negative: its bound above is 0, and no size."""
    model = SimpleNamespace(values={}, predict=lambda values: np.zeros((4, 1)))
    likelihood = SimpleNamespace(residual=lambda values: np.ones((4, 1)), model=model)
    lap = Free("lap", 1e-5, "m", -2e-6, 0.0, guess=(-1e-6,))
    effect = Effect("underlap", "lap", ("valve",), ("opening",), (), (lap,), {"opening.lap": "lap"})
    found = resized(likelihood, effect, SimpleNamespace(values={}))
    assert found.free[0].typical == 2e-6


def test_a_plant_with_nothing_uncertain_is_fitted_too(tmp_path):
    fit = recorded(tmp_path).fit([])
    assert np.isfinite(fit.cost)
    assert fit.slopes.shape[2] == 0
    last = np.arange(len(fit.slopes)) == len(fit.slopes) - 1
    assert fit.judged(~last, last) > 0


@pytest.mark.parametrize("late", [False, True])
def test_a_run_is_fitted_once_from_one_start_and_stays_where_time_is_over(monkeypatch, late):
    """The first look at what misleads the noise fits the very runs that the search asks for next."""
    fitted = []
    run = SimpleNamespace(values={}, cost=1.0)
    search = SimpleNamespace(
        fit=lambda *given, **__: fitted.append(given[1]) or run, skips=lambda h: bool(fitted) and late
    )
    selection = object.__new__(ColouredSelection)
    selection.search, selection.runs, selection._at = search, {}, None
    monkeypatch.setattr(coloured_selection, "quicker", lambda *given: None)
    monkeypatch.setattr(coloured_selection, "_white", lambda fit: None)
    monkeypatch.setattr(coloured_selection, "_price", lambda *given: 0.0)
    given, one, other = Hypothesis(("a",)), *(Score(Hypothesis((key,)), 0.0, {key: 1.0}) for key in "bc")
    for ranked in ([one], [one, other]):
        found = selection._rough(given, run, ranked)
    assert fitted == [given.plus(s.hypothesis) for s in ([one] if late else [one, other])]
    assert [h for h, _ in found] == fitted
    selection._rough(given, SimpleNamespace(values={}, cost=1.0), [one])
    assert len(fitted) == (1 if late else 3), "from another fit it begins anew"


def test_scores_are_taken_once_for_one_fit_and_one_hypothesis(monkeypatch):
    asked = []
    selection = object.__new__(ColouredSelection)
    selection.search = SimpleNamespace(scores=lambda fit, given: asked.append(given) or [], effects={})
    selection._promising = {}
    noise = SimpleNamespace(errors=lambda *given: None)
    monkeypatch.setattr(coloured_selection, "_white", lambda fit: noise)
    monkeypatch.setattr(coloured_selection, "replace", lambda fit, **changed: fit)
    fit, other = (SimpleNamespace(values={}, shifts=None, likelihood=noise) for _ in range(2))
    for of, given in ((fit, "a"), (fit, "a"), (fit, "b"), (other, "b")):
        selection.promising(of, given, 3)
    assert asked == ["a", "a", "b", "b", "b", "b"]  # each under the noise of the fit, and under white noise


def test_a_run_is_fitted_in_full_once(monkeypatch):
    full = []
    selection = object.__new__(ColouredSelection)
    selection._full = {}
    selection.fitted = lambda current, hypothesis, values: full.append(values) or SimpleNamespace(of=values)
    first, better = SimpleNamespace(values={"k": 1.0}), SimpleNamespace(values={"k": 2.0})
    found = [selection._fitted(None, Hypothesis(("a",)), run).of for run in (first, first, better)]
    assert found == [first.values, first.values, better.values]
    assert len(full) == 2


TORSION = """step = 1e-3
outputs = ["q_m", "q_l"]
inputs = { u = "N m" }
[parameters]
j_m = [2e-3, "kg m^2"]
j_l = [5e-3, "kg m^2"]
k = [20.0, "N m/rad"]
c = [0.01, "N m s/rad"]
[states]
q_m = { unit = "rad", rate = "w_m" }
w_m = { unit = "rad/s" }
q_l = { unit = "rad", rate = "w_l" }
w_l = { unit = "rad/s" }
[definitions]
shaft.torque = { unit = "N m", spring = "k * (q_m - q_l)", loss = "c * (w_m - w_l)" }
[equations]
way_m.q_m = { speed = "w_m" }
way_l.q_l = { speed = "w_l" }
motor.w_m = { storage = "j_m", drive = "u", shaft = "-torque" }
load.w_l = { storage = "j_l", shaft = "torque" }
"""


@pytest.mark.parametrize("told", [2e-4, None])
def test_what_sticks_is_led_from_the_beginning_of_the_recording(tmp_path, told):
    """Dry friction at the load: a fit from what was calibrated without it ends in one of many valleys."""
    (tmp_path / "torsion.toml").write_text(TORSION)
    noise = "" if told is None else f", noise_rms = {told}"
    sensors = "".join(f'channels.{n} = {{ unit = "rad", role = "output"{noise} }}\n' for n in ("q_m", "q_l"))
    (tmp_path / "rig.toml").write_text(
        'plant = "torsion.toml"\nsample_time_s = 4e-3\npredict = ["q_m", "q_l"]\n'
        "parameters = { j_m = 2e-3, j_l = 5e-3, k = 20.0, c = 0.01 }\ntolerance = { j_l = 0.1, k = 0.1 }\n"
        f'channels.u = {{ unit = "N m", role = "input" }}\n{sensors}'
    )
    nominal, rng = Plant.read(tmp_path / "torsion.toml"), np.random.default_rng(7)
    real = nominal.with_parameters(j_l=5.2e-3).with_term("load", "dry", "-0.06 * tanh(w_l / 0.02)")
    u = 0.25 * np.repeat(rng.standard_normal(30), 50)
    run = simulate(real, {"u": u}, sample_time=4e-3, step=5e-4)
    seen = [run[n] + 2e-4 * rng.standard_normal(len(u)) for n in ("q_m", "q_l")]
    table = np.column_stack([np.arange(len(u)) * 4e-3, u, *seen])
    np.savetxt(tmp_path / "identify.csv", table, delimiter=",", header="t,u,q_m,q_l", comments="", fmt="%.10g")
    rig = rigs.load(tmp_path)
    effects = {k: e for k, e in known(rig, rig.to_explain()).items() if e.id == "dry_friction_q_l"}
    search = Search(rig, rig.to_explain(), effects)
    selection, best = selected(search), Hypothesis((min(effects),))
    own = {f.symbol: f.typical for f in effects[best.effects[0]].free}
    stuck = search.fit(
        selection.likelihood if told else selection.plain.likelihood, best, {**selection.plain.values, **own}
    )
    form, found = selection.from_the_sheet(best, stuck)
    left = np.std(found.likelihood.residual(found.values), axis=0)
    assert (left < 1.1 * 2e-4).all()
    assert found.values["f_w_l"] == pytest.approx(0.06, rel=1e-2)
    assert search.effects[form.effects[0]].id == "dry_friction_q_l"


def test_a_first_effect_is_fitted_from_the_data_sheet_on_where_something_is_left(tmp_path, monkeypatch):
    """What was calibrated without it makes up for it, and may hold its fit in a local minimum."""
    (tmp_path / "slide.toml").write_text(PLANT)
    (tmp_path / "rig.toml").write_text(RIG)
    real = Plant.read(tmp_path / "slide.toml").with_term("motion", "dry", "-12 * tanh(v / 0.005)")
    rng = np.random.default_rng(2)
    force = 80 * np.repeat(rng.standard_normal(SAMPLES // 10), 10)
    x = simulate(real, {"force": force}, sample_time=0.012, step=1e-3)["x"] + 1e-5 * rng.standard_normal(SAMPLES)
    table = np.column_stack([np.arange(SAMPLES) * 0.012, force, x])
    np.savetxt(tmp_path / "identify.csv", table, delimiter=",", header="t,force,x", comments="", fmt="%.10g")
    rig = rigs.load(tmp_path)
    recording = rig.to_explain()
    search = Search(rig, recording, {k: e for k, e in known(rig, recording).items() if e.id == "dry_friction"})
    selection, best = selected(search), Hypothesis((next(iter(search.effects)),))
    right = selection.fitted(selection.plain, best, {})
    stuck = right.likelihood.fit(right.unknowns, {**right.values, "mass": 25.0, "viscous": 420.0}, iterations=0)
    with monkeypatch.context() as patch:
        patch.setattr(selection, "fitted", None)
        assert selection._anew(best, right) is right  # nothing is left
    better = selection._anew(best, stuck)
    assert better.cost < stuck.cost - SURE
    assert better.cost < right.cost + SURE
    assert abs(better.values["mass"] - 20.0) < 0.1
    assert selection.fits[best] is better
    kept = selection.from_the_sheet(best, stuck)
    assert kept[0] == best
    assert kept[1].cost < stuck.cost - SURE
    search.budget.stop()
    assert selection._anew(best, stuck) is stuck


def test_a_richer_form_than_what_is_there_asks_for_gives_way(tmp_path):
    """Friction in the form of Stribeck, with nothing of that in it, is plain dry friction."""
    model = recorded(tmp_path, more="-12 * tanh(v / 0.05)").model
    search = Search(model.rig, model.recording, known(model.rig, model.recording))
    selection, (plain, rich) = selected(search), (("dry_friction",), ("dry_friction_static",))
    fit = search.fit(selection.plain.likelihood, Hypothesis(plain), {})
    likelihood = fit.likelihood.learnt(fit.likelihood.residual(fit.values), fit.likelihood.order)
    best, found = selection.backward(Hypothesis(rich), search.fit(likelihood, Hypothesis(rich), fit.values))
    assert best.effects == plain
    assert found.values["f_v"] == pytest.approx(12.0, rel=0.05)


def test_when_inputs_act_is_kept_for_a_simulation(tmp_path):
    """In windows a fit leaves open when inputs act; without it no simulation repeats the figures of a diagnosis."""
    recorded(tmp_path)
    text = (tmp_path / "rig.toml").read_text().replace("predict =", "window_s = 0.6\npredict =")
    (tmp_path / "rig.toml").write_text(text)
    rig = rigs.load(tmp_path)
    recording = rig.recording(tmp_path / "identify.csv")
    said = {"schema": SCHEMA, "plant": "slide", "effects": [], "parameters": {}}
    plain, late = (replayed(rig, recording, said | {"simulation": own})["x"] for own in ({}, {"input_timing": 5e-3}))
    assert np.abs(plain - late).max() > 1e-4
    np.testing.assert_array_equal(replayed(rig, recording, said)["x"], plain)
    found = diagnose(rig).as_dict()
    assert "input_timing" in found["simulation"]
    errors = replayed(rig, recording, found)["x"] - recording["x"]
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(found["fit"]["identify"]["x"]["corrected"], rel=1e-6)


def test_noise_that_nobody_told_is_not_held_against_rig_toml():
    of = {"found": 2e-4, "unit": "rad", "memory": 0, "as_told": False}
    assert words.noises({"noise": {"q": {**of, "told": None}}}) == []
    assert words.noises({"noise": {"q": {**of, "told": 1e-4}}}) == ["q: 0.0002 rad, 2 times what rig.toml tells"]


@pytest.mark.parametrize(
    ("interval", "marked"), [([1.4, 1.6], True), ([1.4, 1.9], False), ([2.3, 2.5], True), ([None, None], False)]
)
def test_a_parameter_whose_interval_leaves_its_tolerance_is_marked(interval, marked):
    plant = SimpleNamespace(parameters={"m": Parameter(2.0, "kg", 0.1)})
    found = {"value": 1.5, "ci95": interval, "unit": "kg"}
    said = words.parameter(SimpleNamespace(rig=SimpleNamespace(plant=plant)), "m", found)
    assert said.endswith("± 10 %) beyond its tolerance") is marked
