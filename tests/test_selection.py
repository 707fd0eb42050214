"""What a selection asks of a hypothesis before it takes it; fits are stand-ins of a cost and little else."""

from types import SimpleNamespace

import numpy as np
import pytest

from greygate.mismatch import selection
from greygate.mismatch.effects import Effect, Free
from greygate.mismatch.search import Hypothesis
from greygate.mismatch.selection import EVIDENCE, Selection, forms, possible

NOTHING, DRIFT, SLIP = Hypothesis(), Hypothesis(("drift",)), Hypothesis(("slip",))


def effect(name: str, of: str = "") -> Effect:
    strength = Free(f"k_{name}", 1.0, "1", reported="k")
    return Effect(name, name, ("slide",), ("motion",), ("x",), (strength,), of=of)


EFFECTS = {e.key: e for e in (effect("drift"), effect("settling", "drift"), effect("slip"), effect("creep"))}


def fit(cost: float, held: float = 0.0, **values: float):
    return SimpleNamespace(cost=cost, held_out=lambda: held, values=values, shifts=None, problem=None, unknowns=())


@pytest.fixture
def chosen(monkeypatch):
    """A selection whose fits are never whole, and do not hang together."""
    for name, value in (("whole", False), ("inflation", 1.0), ("blurred", False)):
        monkeypatch.setattr(selection, name, lambda fit, value=value: value)
    made = Selection(SimpleNamespace(effects=EFFECTS), SimpleNamespace(count=0), None, lambda text: None)
    made.plain = fit(1000.0, 1000.0)
    made.add(NOTHING, made.plain)
    monkeypatch.setattr(made, "reshape", lambda hypothesis, fit: (hypothesis, fit))
    return made


@pytest.mark.parametrize(
    ("cost", "held", "taken"),
    [(100.0, 900.0, True), (100.0, 1100.0, False), (1000.0 - EVIDENCE + 1, 900.0, False)],
    ids=["better", "worse on what it did not learn from", "too little evidence"],
)
def test_an_effect_is_taken_for_its_evidence_and_for_blocks_it_did_not_learn_from(
    chosen, monkeypatch, cost, held, taken
):
    monkeypatch.setattr(chosen, "_added", lambda best, *_: [] if best.size else [(DRIFT, fit(cost, held))])
    best, _ = chosen.forward(NOTHING, chosen.plain, chosen.plain)
    assert best == (DRIFT if taken else NOTHING)


@pytest.mark.parametrize(("held", "taken"), [(900.0, True), (1100.0, False)])
def test_so_is_a_pair(chosen, monkeypatch, held, taken):
    both = Hypothesis(("drift", "slip"))
    chosen.search.pairs = lambda *_: [SimpleNamespace(hypothesis=both, values={})]
    monkeypatch.setattr(chosen, "fit", lambda *_, **__: (fit(100.0, held), True))
    best, _ = chosen.paired(NOTHING, chosen.plain, chosen.plain)
    assert best == (both if taken else NOTHING)


def test_beside_an_effect_of_acceleration_a_small_second_one_must_do_better_than_any_other(chosen, monkeypatch):
    monkeypatch.setattr(selection, "blurred", lambda fit: True)
    both, alike = Hypothesis(("slip", "drift")), Hypothesis(("slip", "creep"))
    chosen.add(SLIP, fit(80.0))
    chosen.add(both, fit(35.0))
    monkeypatch.setattr(chosen, "fit", lambda less, *_, **__: (fit(80.0 if less == SLIP else 900.0), True))
    chosen.add(alike, fit(60.0))
    assert chosen.backward(both, chosen.fits[both])[0] == both
    chosen.costs[alike] = 36.0
    assert chosen.backward(both, chosen.fits[both])[0] == SLIP


def test_another_form_of_the_same_effect_is_no_other(chosen):
    chosen.costs = {Hypothesis(("slip", "drift")): 20.0, Hypothesis(("slip", "settling")): 20.0}
    assert chosen.ahead(SLIP, Hypothesis(("slip", "drift"))) == np.inf


def test_forms_start_where_parameters_of_the_same_name_are():
    search = SimpleNamespace(effects=EFFECTS)
    ((form, values),) = forms(search, Hypothesis(("drift", "slip"), ("mass",)), {"k_drift": 3.0})
    assert form == Hypothesis(("settling", "slip"), ("mass",))
    assert values == {"k_drift": 3.0, "k_settling": 3.0}


def test_what_diverged_lies_on_a_bound_or_is_another_waves_overtone_is_not_possible():
    free = (*(Free(s, 1.0, "m") for s in ("s1", "c1", "s2", "c2")), Free("size", 1.0, "m", low=0.0, high=0.5))
    wave = Effect("wave", "", (), (), (), free, wave={"size": ("s1", "c1"), "overtone": ("s2", "c2")})
    search, named = SimpleNamespace(effects={"wave": wave}), Hypothesis(("wave",))
    good = {"s1": 3.0, "c1": 4.0, "s2": 0.5, "c2": 0.0, "size": 0.2}
    assert possible(search, named, fit(1.0, **good))
    assert not possible(search, named, fit(np.inf, **good))
    assert not possible(search, named, fit(1.0, **good | {"size": 0.5}))
    assert not possible(search, named, fit(1.0, **good | {"s2": 6.0}))
