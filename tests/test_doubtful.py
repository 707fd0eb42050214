"""Names that a diagnosis is not sure of: they may stand for a curve, or for a detail, that no table has."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from greygate.mismatch import claims, coloured, excitation
from greygate.mismatch import diagnose as finding
from greygate.mismatch.coloured import Coloured
from greygate.mismatch.diagnosis import Diagnosis
from greygate.mismatch.excitation import Action
from greygate.mismatch.fit import Fit
from greygate.mismatch.noise import Noise
from greygate.mismatch.search import Hypothesis, Search
from greygate.mismatch.verdict import Verdict


@pytest.mark.parametrize(("both", "share", "left"), [(112.0, 0.5, 2), (112.0, 0.01, 0), (205.0, 0.01, 2)])
def test_two_effects_that_undo_each_other_are_never_sure_and_dropped_where_they_do_little(both, share, left):
    """Without one of them the other one does nothing, so that either alone is worth what both are."""
    costs = {("a", "b"): 0.0, ("a",): 108.0, ("b",): 110.0, (): both}
    fit = {names: SimpleNamespace(cost=cost) for names, cost in costs.items()}
    kept = claims.Claims(Hypothesis(("a", "b")), fit["a", "b"], fit[()], without={"a": fit["b",], "b": fit["a",]})
    judge = SimpleNamespace(share=lambda plain, without, with_: share)
    search = SimpleNamespace(effects={name: SimpleNamespace(id=name) for name in "ab"})
    dropped = claims._undoing(search, judge, kept, lambda less, from_: fit[less.effects])
    assert (dropped, kept.best.size) == (left == 0, left)
    assert kept.only_with == ({"a": ["b"], "b": ["a"]} if share == 0.5 else {})


@pytest.mark.parametrize("rounded", [{"a", "b"}, {"a", "c"}, set()])
def test_two_that_together_smooth_the_steps_go_both(rounded, monkeypatch):
    monkeypatch.setattr(claims, "_rounded", lambda effects, fit: {e.id for e in effects} == rounded)
    fit = SimpleNamespace()
    kept = claims.Claims(Hypothesis(("a", "b", "c")), fit, fit)
    search = SimpleNamespace(effects={name: SimpleNamespace(id=name) for name in "abc"})
    assert claims._smoothing(search, kept, lambda less, from_: from_) is bool(rounded)
    assert {*kept.best.effects} == {*"abc"} - rounded
    assert len(kept.refused) == bool(rounded)


@pytest.mark.parametrize(
    ("one", "other", "both"),
    [("delay late", "dead_zone width", True), ("dead_zone width", "delay late", True), ("delay late", "lag by", False),
     ("lag by", "dead_zone width", False), ("offset by", "lag by", True)],
)  # fmt: skip
def test_a_delay_stands_beside_what_has_no_memory(one, other, both):
    def acting(key: str, text: str) -> SimpleNamespace:
        return SimpleNamespace(id=key, free=(SimpleNamespace(symbol=key),), filters={"u": text})

    search = SimpleNamespace(effects={"a": acting("a", one), "b": acting("b", other)})
    assert Search.joined(search, Hypothesis(("a",)), search.effects["b"]) is both


def test_one_glitch_of_a_derived_speed_switches_no_effect_off():
    v = np.sin(np.linspace(0.0, 40.0, 2000))
    assert Action("", {"v": v}, v * np.abs(v)).bent
    v[700] = 1e4
    assert Action("", {"v": v}, v * np.abs(v)).bent
    assert not Action("", {"v": v}, 0.3 * v + 0.1).bent


def test_what_another_signal_adds_to_a_reading_is_no_gain_of_that_reading():
    """A gear that yields adds what drives it to the sensor, in proportion."""
    x, drive = np.sin(np.linspace(0.0, 40.0, 2000)), np.cos(np.linspace(0.0, 90.0, 2000))
    assert Action("x", {"drive": drive}, 0.3 * drive + 0.1).bent
    assert not Action("x", {"x": x}, 0.3 * x + 0.1).bent


@pytest.mark.parametrize(
    ("unit", "why"), [("K", "a gain or an offset of t does the same"), ("m", "never changes its sign")]
)
def test_a_temperature_is_not_said_to_change_no_sign(unit, why):
    t = 290.0 + np.sin(np.linspace(0.0, 9.0, 100))
    assert why in excitation._why(Action("t", {"t": t}, 0.3 * t), {"t": unit})


@pytest.mark.parametrize("size", [1e3, 1e7])
def test_how_far_an_effect_goes_is_held_against_the_channel_that_it_changes(size):
    """What depends on time has no size in seconds: here 0.1 bar of pickup over 20 s of recording."""
    t = np.linspace(0.0, 20.0, 2001)
    action = Action("p_a", {"t": t}, 1.1e4 * np.sin(31.4 * t), size)
    assert action.far is (size == 1e3)


@pytest.mark.parametrize(
    ("claimed", "more", "said"),
    [("square_leak", True, True), ("square_leak", False, False), ("square_leak source", False, True),
     ("square_leak filling", False, False), ("source", True, False)],
)  # fmt: skip
def test_a_curve_with_a_constant_beside_it_or_with_something_left_is_not_quite_what_it_is_called(claimed, more, said):
    effects = {
        "square_leak": SimpleNamespace(id="square_leak", equations=("jacket",), depends_on=("t",), smooth=True),
        "source": SimpleNamespace(id="source", equations=("jacket",), depends_on=(), smooth=False),
        "filling": SimpleNamespace(id="filling", equations=("block",), depends_on=(), smooth=False),
    }
    search = SimpleNamespace(effects=effects)
    why = finding._unlike(search, Hypothesis(tuple(claimed.split())), lambda: more)
    assert ("what acts in jacket is not quite square_leak" in why) is said


@pytest.mark.parametrize(
    ("term", "smooth", "explained", "on", "alike"),
    [("-k * v", False, 0.98, ["v"], True), ("-k * v", False, 0.98, ["v", "i"], False),
     ("-k * v", False, 0.9, ["v"], False), ("-k * v", True, 0.98, ["v"], False)],
)  # fmt: skip
def test_a_name_that_explains_most_is_not_replaced_by_the_same_term_in_other_words(term, smooth, explained, on, alike):
    effect = SimpleNamespace(terms={"body.leak": term}, equations=("body",), smooth=smooth)
    plant = SimpleNamespace(states={"v": None}, inputs={"i": "A"})
    search = SimpleNamespace(effects={"leak": effect}, rig=SimpleNamespace(plant=plant))
    unknown = {"where": [{"equation": "body", "depends_on": on}]}
    assert finding._alike(search, Hypothesis(("leak",)), explained, unknown) is alike


@pytest.mark.parametrize("unlike", ["", "what acts is not quite leak"])
@pytest.mark.parametrize("alike", [True, False])
def test_a_formula_that_leaves_less_takes_the_place_of_a_name_unless_it_is_the_same(alike, unlike, monkeypatch):
    where = {"equation": "body", "depends_on": ["v"]}
    closed = ({"where": [where], "effect": {"confidence": 1.0}}, "closed")
    monkeypatch.setattr(finding, "closure", lambda *given: closed)
    monkeypatch.setattr(finding, "_no_term", lambda *given: "")
    monkeypatch.setattr(finding, "_alike", lambda *given: alike)
    monkeypatch.setattr(finding, "left_beside", lambda *given: [])
    selection = SimpleNamespace(calibrated=None, outdone=lambda *given: True, left=lambda fit: "")
    search = SimpleNamespace(part=None, in_part=lambda fit: fit, effects={"leak": SimpleNamespace(id="leak")})
    found = finding.Found(Hypothesis(("leak",)), SimpleNamespace(values={}), None, selection)
    claims = finding.Claims(Hypothesis(("leak",)), None, None)
    state = finding.State(search, selection, lambda text: None, found, claims, Verdict.PARTLY_EXPLAINED, 0.98)
    said = finding._closed(replace(state, unlike=unlike))
    assert (said.verdict, bool(claims.refused)) == (
        (Verdict.PARTLY_EXPLAINED, False) if alike else (Verdict.UNEXPLAINED, True)
    )


@pytest.mark.parametrize(
    ("equation", "on", "filtered", "share", "leaves", "doubted"),
    [("body", ("v",), "w", 0.5, "", True), ("body", ("t",), "w", 0.5, "", False),
     ("wheel", ("v",), "w", 0.5, "", False), ("wheel", ("v",), "u", 0.5, "", True),
     ("wheel", ("v",), "w", 0.001, "", True), ("wheel", ("v",), "w", 0.5, "_rough", True),
     ("wheel", ("v",), "w", 0.5, "_other_noise", True)],
)  # fmt: skip
def test_a_name_is_doubtful_beside_one_on_the_same_signals_and_where_it_takes_next_to_nothing_or_leaves_much(
    equation, on, filtered, share, leaves, doubted
):
    """equation, on: of another claim, which reshapes the input `filtered`; the judged one reads `u`.

    share: of the squared error, that the judged one takes. leaves: much, or another noise than that it was found in.
    """
    effects = {
        "a": SimpleNamespace(
            equations=("body",), depends_on=("x", "v"), smooth=False, filters={}, uses=lambda name: name == "u"
        ),
        "b": SimpleNamespace(
            equations=(equation,), depends_on=on, smooth=False, filters={filtered: "lag l"}, uses=lambda name: False
        ),
    }
    said = SimpleNamespace(
        search=SimpleNamespace(effects=effects), best=Hypothesis(("a", "b")), shares={"a": share}, only_with={},
        _remaining=lambda: "", _rough=leaves == "_rough", _other_noise=leaves == "_other_noise",
    )  # fmt: skip
    assert Diagnosis._doubtful(said, "a") is doubted


@pytest.mark.parametrize(("smooth", "like", "sure"), [(True, True, 0.66), (True, False, 0.99), (False, True, 0.99)])
def test_a_curve_is_never_sure_where_one_that_is_like_it_acts(smooth, like, sure):
    said = SimpleNamespace(
        search=SimpleNamespace(effects={"a": SimpleNamespace(smooth=smooth)}), evidence={}, only_like=like,
        verdict=Verdict.PARTLY_EXPLAINED, explained=1.0, _detail=lambda key: 0.0, _doubtful=lambda key: False,
    )  # fmt: skip
    assert Diagnosis._confidence(said, "a", {}) == pytest.approx(sure, abs=0.001)


@pytest.mark.parametrize(("heard", "told"), [(True, None), (False, 2e-6)])
def test_a_noise_that_nobody_told_is_not_said_to_be_told(heard, told):
    channels = {
        "x": SimpleNamespace(sigma=2e-6, unit="m", heard=heard),
        "y": SimpleNamespace(sigma=1.0, unit="m", heard=False),
    }
    rig = SimpleNamespace(predict=("x", "y"), channels=channels, heard=heard)
    shown = SimpleNamespace(size=np.ones(2), ar=((), ()), doubted=(False, False))
    likelihood = SimpleNamespace(sigma=np.array([[2e-6, 1.0]]))
    said = SimpleNamespace(rig=rig, told=not heard, corrected=SimpleNamespace(likelihood=likelihood))
    found = Diagnosis._noise(said, shown)
    assert [found[name]["told"] for name in ("x", "y")] == [told, 1.0]


@pytest.mark.parametrize(("expected", "left", "rough"), [(0.0, 0.05, True), (0.0, 0.012, False), (900.0, 0.05, False)])
def test_where_no_noise_is_told_a_name_is_doubtful_that_leaves_far_more_than_the_recording_is_rough(
    expected, left, rough
):
    """left: RMS of what a claim leaves of a slow wave with noise of 0.01. expected: above 0 where its noise is told."""
    time = np.linspace(0.0, 20.0, 2000)
    channel = np.sin(time) + 0.01 * np.random.default_rng(0).standard_normal(2000)
    recording = SimpleNamespace(runs=[{"x": channel}])
    model = SimpleNamespace(recording=recording)
    residual = np.sqrt(2.0) * left * np.sin(3 * time)[:, None]
    likelihood = SimpleNamespace(expected=expected, model=model, residual=lambda values: residual)
    said = SimpleNamespace(
        rig=SimpleNamespace(predict=["x"]), corrected=SimpleNamespace(likelihood=likelihood, values={})
    )
    assert Diagnosis._rough.func(said) is rough


@pytest.mark.parametrize(("shown", "within", "other"), [(1.0, 1.0, False), (3.0, 1.0, True), (3.0, 3.0, False)])
def test_another_noise_than_the_told_one_is_one_under_which_nothing_was_found(shown, within, other):
    """shown: its size, of the told one; within: of that under which the fit was made."""
    shown, within = (Noise(np.array([size]), (np.zeros(0),)) for size in (shown, within))
    fit = SimpleNamespace(likelihood=SimpleNamespace(noise=within))
    assert Diagnosis._other_noise.fget(SimpleNamespace(noise=shown, corrected=fit)) is other


@pytest.mark.parametrize(("costs", "rounds"), [([9.0, 7.5, 7.0, 5.0], 3), ([9.0, 8.5, 5.0], 2), ([9.0, 9.5, 5.0], 2)])
def test_plant_and_noise_are_fitted_in_turn_until_a_round_saves_less_than_one_of_cost(costs, rounds, monkeypatch):
    left, none = iter(costs), np.zeros(0)

    def noise(cost):
        return SimpleNamespace(
            order=1, nothing=lambda: none, white=lambda residual: residual, deviance=lambda: cost,
            learnt=lambda residual: noise(next(left)),
        )  # fmt: skip

    class Descent:
        at = SimpleNamespace(residual=none)

        def __init__(self, likelihood, *_):
            self.under(likelihood)

        def under(self, likelihood):
            self.likelihood = likelihood

        def ended(self, *_, **__):
            return Fit(self.likelihood, (), {}, none, none, none, none, 0.0, True, none)

    monkeypatch.setattr(coloured, "Descent", Descent)
    assert Coloured.fit(noise(np.inf), ()).cost == min(costs[:rounds])
    assert len(list(left)) == len(costs) - rounds
