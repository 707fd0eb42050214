"""What bears a name: an e-value from data that its fit did not see, and no other effect that does as well."""

import json
from dataclasses import replace

import numpy as np
import pytest

from greygate.mismatch import effects as table
from greygate.mismatch.claims import earned
from greygate.mismatch.concealed.conceal import conceal
from greygate.mismatch.evidence import FALSE, Evidence, borne_out, evidence
from greygate.mismatch.rig import load
from greygate.mismatch.search import Hypothesis, Search
from greygate.mismatch.selection import Selection
from greygate.plants.recording import Recording

NOTHING = Hypothesis()
PAIR = ("drift", "direction_slip")  # both true in `two`


def search_of(folder) -> Search:
    rig = load(folder)
    recording = rig.recording(folder / "identify.csv")
    return Search(rig, recording, table.known(rig, recording))


@pytest.fixture(scope="module")
def clean(tmp_path_factory) -> Search:
    """A cable drum as its data sheet has it."""
    return search_of(conceal("cable_drum", 3, tmp_path_factory.mktemp("drum") / "rig", kind="clean"))


@pytest.fixture(scope="module")
def two(tmp_path_factory) -> Search:
    """The same that drifts and slips in one direction, both by many times the noise."""
    folder = conceal("cable_drum", 3, tmp_path_factory.mktemp("drum") / "rig", kind="clean")
    looked = search_of(folder)
    fit = looked.fit(looked.final, NOTHING, {})
    model, sigma = looked.final.model, float(np.nanmin(looked.final.sigma))
    found = dict(model.recording.channels)
    for key in PAIR:
        (free,) = looked.effects[key].strengths
        full = model.predict({**model.values, **fit.values, free.symbol: free.typical})
        change = (full - model.predict({**model.values, **fit.values}))[:, 0]
        found["x_load"] = found["x_load"] + 20 * sigma * change / np.std(change)
    return Search(looked.rig, Recording(looked.rig.dt, found, model.recording.units), looked.effects)


def both(search: Search, *effects: str) -> tuple:
    """The fits without and with some effects."""
    plain = search.fit(search.final, NOTHING, {})
    return plain, search.fit(search.final, Hypothesis(effects), plain.values)


def test_what_is_not_there_is_given_no_evidence(clean):
    for effect in clean.effects.values():
        assert evidence(*both(clean, effect.key)).log_e < np.log(len(clean.effects) / FALSE), effect.key


def test_an_e_value_is_one_on_average_at_most_where_nothing_is_there(clean):
    """Over draws of the noise: what makes of it a bound on false names."""
    model = clean.final.model
    rng, values = np.random.default_rng(4), []
    truth = model.predict({**model.values, **clean.fit(clean.final, NOTHING, {}).values})
    sigma = float(np.nanmin(clean.final.sigma))
    for _ in range(40):
        shown = {**model.recording.channels, "x_load": truth[:, 0] + sigma * rng.standard_normal(len(truth))}
        again = Search(clean.rig, Recording(clean.rig.dt, shown, model.recording.units), clean.effects)
        values.append(np.exp(evidence(*both(again, "speed_slip")).log_e))
    assert np.mean(values) <= 1.0


def test_what_is_there_is_given_much(two):
    plain, right = both(two, *PAIR)
    found = evidence(plain, right)
    assert found.log_e > 100
    assert found.gain == pytest.approx(plain.cost - right.cost, rel=0.1)
    assert evidence(plain, right, wider=10.0).log_e < found.log_e / 9


def test_the_more_names_the_less_each_one_needs():
    """e-BH: two of 40 candidates need half of what one alone needs."""
    alone = np.log(40 / FALSE)
    either = alone - np.log(2) + 0.01
    assert borne_out({"a": Evidence(either, 0.0)}, 40) == set()
    assert borne_out({"a": Evidence(either, 0.0), "b": Evidence(either, 0.0)}, 40) == {"a", "b"}
    assert borne_out({"a": Evidence(alone + 0.01, 0.0), "b": Evidence(-1.0, 0.0)}, 40) == {"a"}
    assert borne_out({}, 40) == set()


def test_a_half_that_speaks_against_a_name_refutes_it_however_lucky_the_other_is():
    luck = Evidence(1e4, 2e4, np.log(FALSE) - 0.1)
    assert borne_out({"a": luck}, 40) == set()
    assert borne_out({"a": replace(luck, least=np.log(FALSE) + 0.1)}, 40) == {"a"}


def test_an_e_value_beyond_all_numbers_is_one_in_the_file():
    assert json.loads(json.dumps(Evidence(1e6, 2e6).as_dict())) == {"e_value": 1e300, "held_out_gain": 2e6}


def test_a_name_without_evidence_is_refused(clean):
    plain, fit = both(clean, "speed_slip")
    narrow = fit.__class__(**{**fit.__dict__, "numbers": fit.numbers})  # a fit of its own: nothing is cached
    narrow.__dict__["covariance"] = fit.covariance / 1e6  # so that its interval holds no zero
    found = earned(clean, plain, Hypothesis(("speed_slip",)), narrow)
    assert found.best == NOTHING
    assert found.refused[0].startswith("speed_slip is not claimed: ")


def test_a_wrong_one_of_a_pair_is_exchanged_for_the_right_one(two):
    """The search takes one effect after another; a wrong one among them is exchanged at the end."""
    base = two.base(two.screen)
    selection = Selection(two, two.screen, base)
    wrong = Hypothesis(("drift", "acceleration_slip"))
    start = selection.plain
    fit, _ = selection.fit(wrong, start.values, start.shifts)
    best, better = selection.settled(wrong, fit)
    assert set(best.effects) == set(PAIR)
    assert better.cost < fit.cost


def test_an_exchange_is_fitted_though_straight_lines_promise_too_little(two, monkeypatch):
    """Of a strong effect a linearised fit promises a part, of the one that is there as of every other."""
    selection = Selection(two, two.screen, two.base(two.screen))
    start, scores = selection.plain, two.scores
    monkeypatch.setattr(two, "scores", lambda *given: [replace(s, gain=0.3 * s.gain) for s in scores(*given)])
    fit, _ = selection.fit(Hypothesis(("drift", "acceleration_slip")), start.values, start.shifts)
    assert set(selection.settled(Hypothesis(("drift", "acceleration_slip")), fit)[0].effects) == set(PAIR)


def test_hypotheses_that_were_too_many_to_fit_count_as_rivals(two, monkeypatch):
    monkeypatch.setattr("greygate.mismatch.selection.EXCHANGED", 0)
    monkeypatch.setattr("greygate.mismatch.selection.APART", 1e9)
    selection = Selection(two, two.screen, two.base(two.screen))
    start = selection.plain
    right = Hypothesis(PAIR)
    fit, _ = selection.fit(right, start.values, start.shifts)
    assert selection.settled(right, fit) == (right, fit)
    unfitted = {frozenset(h.effects) for h in selection.unfitted}
    assert {frozenset({"drift", "cable_stretch"}), frozenset({"direction_slip", "cable_stretch"})} <= unfitted
