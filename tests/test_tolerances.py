"""Parameters beside something unexplained: it draws them, so they stay within their tolerances and are no surer."""

import copy
import importlib
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from greygate.mismatch.claims import Claims, held_to_tolerance
from greygate.mismatch.concealed.conceal import conceal
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.diagnosis import Diagnosis
from greygate.mismatch.rig import load
from greygate.mismatch.search import Hypothesis
from greygate.mismatch.simulation import corrected
from greygate.mismatch.verdict import Verdict
from greygate.progress import silent

finding = importlib.import_module("greygate.mismatch.diagnose")


def test_where_something_is_unexplained_no_parameter_is_better_known_than_before(slipping):
    search, plain, _, right = slipping
    rest = Diagnosis(search.rig, Verdict.UNEXPLAINED, Hypothesis(), plain, plain, {}, {}, 0.0, search, {"where": []})
    for symbol, p in rest.as_dict()["parameters"].items():
        sheet, (low, high) = search.sheet[symbol], p["ci95"]
        reach = sheet.tolerance * abs(sheet.value)
        assert low <= sheet.value - reach < sheet.value + reach <= high
    (symbol, *_) = rest.as_dict()["parameters"]
    for verdict, sure in ((Verdict.PARTLY_EXPLAINED, False), (Verdict.PARAMETER_ERROR, True)):
        outside = replace(rest, verdict=verdict, best=Hypothesis((), (symbol,))).as_dict()
        assert ("outside_tolerance" in outside["parameters"][symbol]) is sure
    exact = replace(rest, verdict=Verdict.CONSISTENT, corrected=right).as_dict()["parameters"]
    assert any(p["ci95"][1] < rest.as_dict()["parameters"][s]["ci95"][1] for s, p in exact.items())


def test_nor_is_a_parameter_that_is_drawn_as_far_as_it_may_go(steady):
    search, plain = steady
    kept = Diagnosis(search.rig, Verdict.CONSISTENT, Hypothesis(), plain, plain, {}, {}, 0.0, search)
    exact = kept.as_dict()["parameters"]["creep"]["ci95"]
    sheet = search.sheet["creep"]
    reach = sheet.tolerance * abs(sheet.value)
    assert not exact[0] <= sheet.value - reach < sheet.value + reach <= exact[1]
    numbers = np.array([u.number(u.high if u.symbol == "creep" else plain.values[u.symbol]) for u in plain.unknowns])
    low, high = replace(kept, corrected=replace(plain, numbers=numbers)).as_dict()["parameters"]["creep"]["ci95"]
    assert low <= sheet.value - reach < sheet.value + reach <= high


def test_beside_something_unexplained_parameters_stay_within_their_tolerance(slipping):
    search, plain, best, right = slipping
    search = copy.copy(search)
    wide = Hypothesis(best.effects, ("creep",))
    kept = Claims(wide, search.fit(search.final, wide, {**right.values, "creep": 5 * right.values["creep"]}), plain)
    found = held_to_tolerance(search, kept)
    assert found.best == best
    sheet = search.sheet["creep"]
    for fit in (found.fit, found.calibrated):
        (creep,) = (u for u in fit.unknowns if u.symbol == "creep")
        assert abs(fit.values["creep"] - sheet.value) <= sheet.tolerance * abs(sheet.value) * (1 + 1e-9)
        assert [creep.low, creep.high] == pytest.approx([sheet.value * (1 + s * sheet.tolerance) for s in (-1, 1)])
    assert held_to_tolerance(search, Claims(Hypothesis((), ("creep",)), plain, plain)).best == Hypothesis()


def test_a_parameter_without_which_the_error_is_tenfold_was_drawn_by_nothing(tmp_path):
    """Here noise that remembers is left, once a sensor ends and a capacity is a third smaller."""
    conceal("electrical", 3001, tmp_path / "rig", kind="both", effect="sensor_saturation", under="coloured")
    found, truth = diagnose(load(tmp_path / "rig")).as_dict(), json.loads((tmp_path / "rig/sealed.json").read_text())
    assert [e["id"] for e in found["effects"]] == ["sensor_saturation_v_2"]
    assert found["parameters"]["c_1"]["outside_tolerance"]
    low, high = found["parameters"]["c_1"]["ci95"]
    assert low < truth["parameters_true"]["c_1"] < high


@pytest.mark.parametrize(("excess", "unlike", "without", "stays"), [
    (0.6, "", 20.0, True), (1.3, "", 20.0, False), (0.6, "a smooth curve", 20.0, False), (0.6, "", 5.0, False),
])  # fmt: skip
def test_what_is_left_beside_a_parameter_says_whether_it_may_have_drawn_it(excess, unlike, without, stays, monkeypatch):
    claims = SimpleNamespace(best=Hypothesis(("end",), ("c",)), fit=SimpleNamespace(likelihood=None))
    held = SimpleNamespace(fit=SimpleNamespace(likelihood=None))
    monkeypatch.setattr(finding, "held_to_tolerance", lambda *given: held)
    monkeypatch.setattr(
        finding, "Judge", lambda _: SimpleNamespace(total=lambda fit: without if fit is held.fit else 1)
    )
    state = SimpleNamespace(
        open=True, search=SimpleNamespace(within=2.0), claims=claims, progress=silent, unlike=unlike, left="",
        found=SimpleNamespace(fit=None), selection=SimpleNamespace(excess=lambda found: excess, left=lambda fit: ""),
    )  # fmt: skip
    written = []
    monkeypatch.setattr(finding, "_written", lambda *given: written.append(given) or state)
    monkeypatch.setattr(finding, "replace", lambda *given, **more: SimpleNamespace(explained=1.0))
    finding._held_to_tolerance(state)
    assert (not written, state.search.within == finding.WITHIN) == (stays, stays)


def test_a_corrected_simulation_has_the_claimed_effect_alone(slipping):
    """Another would only have to be compiled; what it predicts is what the search's own model does."""
    search, plain, best, right = slipping
    found = Diagnosis(
        search.rig, Verdict.MISSING_PHYSICS, best, plain, right, {best: right.cost}, {}, 1.0, search, {}
    ).as_dict()
    recording = search.final.model.recording
    model, values = corrected(search.rig, recording, found)
    assert {effect.id for effect in model.effects.values()} == {"speed_slip"}
    whole = search.final.model.predict({**search.final.model.values, **right.values})
    alone = model.predict({**model.values, **values})
    np.testing.assert_allclose(alone, whole, rtol=1e-9, atol=1e-12)
