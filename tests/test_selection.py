"""What a selection asks of a hypothesis before it takes it; fits are stand-ins of a cost and little else."""

from types import SimpleNamespace

import numpy as np
import pytest

from greygate.mismatch import selection
from greygate.mismatch.effects import Effect, Free
from greygate.mismatch.search import ROUGH, Hypothesis, Score, Search
from greygate.mismatch.selection import EVIDENCE, FLOOR, Selection, alternatives, complete, forms, possible, structure

NOTHING, DRIFT, SLIP = Hypothesis(), Hypothesis(("drift",)), Hypothesis(("slip",))


def effect(name: str, of: str = "") -> Effect:
    strength = Free(f"k_{name}", 1.0, "1", reported="k")
    return Effect(name, name, ("slide",), ("motion",), ("x",), (strength,), of=of)


EFFECTS = {e.key: e for e in (effect("drift"), effect("settling", "drift"), effect("slip"), effect("creep"))}


def fit(cost: float, held: float = 0.0, **values: float):
    return SimpleNamespace(cost=cost, held_out=lambda: held, values=values, shifts=None, likelihood=None, unknowns=())


@pytest.fixture
def chosen(monkeypatch):
    """A selection whose fits are never complete, and do not hang together."""
    for name, value in (("complete", False), ("inflation", 1.0), ("blurred", False)):
        monkeypatch.setattr(selection, name, lambda fit, value=value: value)
    made = Selection(
        SimpleNamespace(effects=EFFECTS, skips=lambda hypothesis: False),
        SimpleNamespace(count=0),
        None,
        lambda text: None,
    )
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
    monkeypatch.setattr(chosen, "from_the_sheet", lambda *found: found)
    best, _ = chosen.forward(NOTHING, chosen.plain, chosen.plain)
    assert best == (DRIFT if taken else NOTHING)


@pytest.mark.parametrize(("cost", "window", "tried"), [
    (400.0, 100, [("settling",)]), (600.0, 100, []), (400.0, None, [("slip",), ("drift",), ("settling",)]),
    (600.0, None, [("slip",)]),
], ids=["near, in windows", "far, in windows", "near", "far"])  # fmt: skip
def test_the_forms_of_what_explains_half_are_led_from_the_data_sheet_beside_the_first(
    chosen, monkeypatch, cost, window, tried
):
    """cost: of `drift`, another form of which leaves next to nothing."""
    search, began = chosen.search, []
    search.rig, search.leads = SimpleNamespace(window=window), True
    search.fit = lambda likelihood, hypothesis, values, **options: began.append(hypothesis.effects) or fit(900.0)
    search.from_the_sheet = lambda begun: fit(10.0 if began[-1:] == [("settling",)] else 900.0)
    monkeypatch.setattr(selection, "possible", lambda *given: True)
    monkeypatch.setattr(chosen, "share", lambda fit: 1 - fit.cost / 1000.0)
    chosen.add(DRIFT, fit(cost))
    asked = []
    monkeypatch.setattr(chosen, "progress", asked.append)
    best, found = chosen.from_the_sheet(SLIP, fit(300.0))
    assert asked == [f"fitting {Hypothesis(effects)} from the beginning on" for effects in tried]
    assert (best.effects, found.cost) == ((("settling",), 10.0) if ("settling",) in tried else (("slip",), 300.0))


@pytest.mark.parametrize(
    ("cost", "held", "taken"), [(100.0, 900.0, True), (100.0, 1100.0, False), (1000.0 - EVIDENCE + 1, 900.0, False)]
)
def test_so_is_a_pair(chosen, monkeypatch, cost, held, taken):
    both = Hypothesis(("drift", "slip"))
    chosen.search.pairs = lambda *_: [SimpleNamespace(hypothesis=both, values={})]
    monkeypatch.setattr(chosen, "fit", lambda *_, **__: (fit(cost, held), True))
    best, _ = chosen.paired(NOTHING, chosen.plain, chosen.plain)
    assert best == (both if taken else NOTHING)


def test_a_pair_needs_more_evidence_where_errors_hang_together(chosen, monkeypatch):
    monkeypatch.setattr(selection, "inflation", lambda fit: 2.0)
    both = Hypothesis(("drift", "slip"))
    chosen.search.pairs = lambda *_: [SimpleNamespace(hypothesis=both, values={})]
    monkeypatch.setattr(chosen, "fit", lambda *_, **__: (fit(1000.0 - 1.5 * EVIDENCE, 900.0), True))
    assert chosen.paired(NOTHING, chosen.plain, chosen.plain)[0] == NOTHING


def test_where_nothing_can_be_explained_a_fit_explains_nothing(chosen, monkeypatch):
    monkeypatch.setattr(chosen, "explicable", lambda fit: 0.0)
    assert chosen.share(chosen.plain) == 0.0


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
    search = SimpleNamespace(effects=EFFECTS, skips=lambda hypothesis: False)
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


def test_a_wave_one_of_whose_overtones_is_larger_than_itself_is_not_possible():
    free = tuple(Free(s, 1.0, "m") for s in ("s1", "c1", "s2", "c2", "s3", "c3"))
    pairs = {"size": ("s1", "c1"), "second": ("s2", "c2"), "third": ("s3", "c3")}
    search = SimpleNamespace(effects={"wave": Effect("wave", "", (), (), (), free, wave=pairs)})
    values = {"s1": 3.0, "c1": 4.0, "s2": 0.5, "c2": 0.0, "s3": 0.2, "c3": 0.1}
    assert possible(search, Hypothesis(("wave",)), fit(1.0, **values))
    for overtone in ("s2", "s3"):
        assert not possible(search, Hypothesis(("wave",)), fit(1.0, **values | {overtone: 6.0}))


def test_the_plain_form_of_an_effect_is_tried_first_where_it_promises_nearly_the_most():
    def order(plain: float, other: float) -> list[list[str]]:
        gains = {SLIP: 300.0, Hypothesis(("settling",)): other, DRIFT: plain}
        ranked = [Score(h, g, {}) for h, g in sorted(gains.items(), key=lambda item: -item[1])]
        found = alternatives(SimpleNamespace(effects=EFFECTS), ranked)
        return [[score.hypothesis.effects[0] for score in forms] for forms in found]

    assert order(98.0, 100.0) == [["slip"], ["drift", "settling"]]
    assert order(90.0, 100.0) == [["slip"], ["settling", "drift"]]


def left(errors: np.ndarray, cost: float):
    """A fit of one channel, in windows of 100 samples of 1 ms, that leaves `errors`."""
    model = SimpleNamespace(rig=SimpleNamespace(predict=("x",), dt=1e-3))
    likelihood = SimpleNamespace(block=100, model=model, count=errors.size)
    return SimpleNamespace(projected=errors, likelihood=likelihood, unknowns=(), cost=cost)


def test_slow_errors_are_structure_unless_they_are_small_and_the_cost_is_that_of_noise():
    white = np.random.default_rng(0).standard_normal((400, 100))
    steps = np.repeat(np.random.default_rng(1).standard_normal((400, 5)), 20, axis=1)  # each lasts 20 ms
    for size, share in ((0.0, 0.0), (0.2, 0.8), (0.5, 5.0)):  # its variance, twenty times
        assert structure(left(white + size * steps, 1.0))["x"] == pytest.approx(share, abs=0.15)
    assert complete(left(white, 1.1 * white.size))
    assert complete(left(white + 0.2 * steps, 0.99 * white.size))
    assert not complete(left(white + 0.2 * steps, 1.01 * white.size))
    assert not complete(left(white + 0.5 * steps, 0.99 * white.size))
    less = white * 0.1  # errors below the sensors' own are none
    assert structure(left(less + 0.1 * steps, 1.0))["x"] < 0.0
    assert structure(left(3.0 * white, 1.0))["x"] == pytest.approx(0.0, abs=0.15)  # larger, but as white
    assert structure(left(np.vstack([white, np.zeros((4000, 100))]), 1.0))["x"] == pytest.approx(0.0, abs=0.15)


def test_what_a_fit_explains_is_a_share_of_what_noise_alone_would_leave(chosen):
    chosen.likelihood.count = 500
    assert chosen.share(fit(1000.0)) == 0.0
    assert chosen.share(fit(FLOOR * 500)) == 1.0
    assert chosen.share(fit((1000.0 + FLOOR * 500) / 2)) == pytest.approx(0.5)


def test_another_form_is_taken_for_its_evidence_alone(chosen, monkeypatch):
    current = fit(500.0, k_drift=1.0)
    for less, taken in ((EVIDENCE + 1, Hypothesis(("settling",))), (EVIDENCE - 1, DRIFT)):
        monkeypatch.setattr(chosen, "fit", lambda *_, less=less: (fit(500.0 - less), True))
        assert Selection.reshape(chosen, DRIFT, current)[0] == taken
    monkeypatch.setattr(chosen, "fit", lambda *_: (fit(0.0), False))
    assert Selection.reshape(chosen, DRIFT, current)[0] == DRIFT


@pytest.mark.parametrize(("explains", "tried"), [(True, [DRIFT, SLIP]), (False, [DRIFT, SLIP, Hypothesis(("creep",))])])
def test_once_an_effect_explains_all_those_that_promise_little_are_not_fitted(chosen, monkeypatch, explains, tried):
    gains = {DRIFT: 900.0, SLIP: 500.0, Hypothesis(("creep",)): 200.0, NOTHING.plus(Hypothesis((), ("mass",))): 5.0}
    scores = [Score(h, g, {}) for h, g in gains.items()]
    chosen.search.scores = lambda *_: scores
    monkeypatch.setattr(selection, "complete", lambda fit: explains)
    asked = []

    def fitted(hypothesis, *_, **options):
        asked.append((hypothesis, options["rival"]))
        return fit(1000.0 - gains[hypothesis]), True

    monkeypatch.setattr(chosen, "fit", fitted)
    found = chosen._added(NOTHING, chosen.plain, chosen.plain)
    assert [h for h, _ in found] == [h for h, _ in asked] == tried
    assert [rival for _, rival in asked][:2] == [np.inf, 100.0]  # the best so far is the rival of the next


def test_a_fit_that_got_worse_is_begun_again_without_the_effect_but_in_its_shape(chosen, monkeypatch):
    free = (Free("size", 1.0), Free("period", 1.0, shape=True))
    chosen.search.effects = EFFECTS | {"wave": Effect("wave", "", (), (), (), free)}
    score = Score(Hypothesis(("wave",)), 500.0, {"size": 9.0, "period": 2.0})
    begun = []

    def fitted(hypothesis, values, *_):
        begun.append(values)
        return fit(700.0, size=0.5, period=2.0), True

    monkeypatch.setattr(chosen, "fit", fitted)
    chosen.search.points = lambda _: [{}]
    better, allowed = chosen.restarted(score.hypothesis, score, fit(1000.0, mass=1.0), fit(1200.0), 1000.0)
    assert begun == [{"mass": 1.0, "period": 2.0}]
    assert better.cost == 700.0
    assert allowed
    kept, _ = chosen.restarted(score.hypothesis, score, fit(1000.0), fit(600.0, size=0.5, period=2.0), 1000.0)
    assert kept.cost == 600.0


def test_a_fit_that_keeps_little_of_what_was_promised_is_begun_at_every_size_that_was_tried(chosen, monkeypatch):
    chosen.search.effects = EFFECTS | {"late": Effect("late", "", (), (), (), (Free("by", 1.0),))}
    chosen.search.points = lambda _: [{"by": by} for by in (-1.0, 1.0, 2.0)]
    score = Score(Hypothesis(("late",)), 80.0, {"by": 0.8})
    costs = {0.8: 990.0, 1.0: 940.0, 2.0: 820.0}
    begun = []

    def fitted(hypothesis, values, *_, **__):
        begun.append(values["by"])
        made = fit(costs[values["by"]], by=values["by"])
        chosen.add(hypothesis, made)
        return made, True

    monkeypatch.setattr(chosen, "fit", fitted)
    chosen.search.scores = lambda *_: [score]
    ((_, better),) = chosen._added(NOTHING, chosen.plain, chosen.plain)
    assert (begun, better.cost) == ([0.8, 1.0, 2.0], 820.0)
    costs[0.8], begun[:] = 1000.0 - 0.6 * score.gain, []  # more than half of what was promised
    chosen._added(NOTHING, chosen.plain, chosen.plain)
    assert begun == [0.8]


def test_scores_are_taken_once_for_a_fit_and_what_is_beside_it(chosen):
    asked = []
    chosen.search.scores = lambda *given: [asked.append(given)]
    for given in (NOTHING, NOTHING, SLIP, SLIP):
        chosen.scored(chosen.plain, given)
    assert asked == [(chosen.plain, NOTHING), (chosen.plain, SLIP)]


@pytest.mark.parametrize(
    ("promised", "size", "over"), [(EVIDENCE + 1, 1, False), (EVIDENCE - 1, 1, True), (99.0, 2, True)]
)
def test_a_complete_fit_of_one_effect_ends_the_search_where_no_second_one_promises_evidence(
    chosen, monkeypatch, promised, size, over
):
    monkeypatch.setattr(selection, "complete", lambda fit: True)
    chosen.search.scores = lambda *_: [Score(SLIP, promised, {})]
    current = fit(90.0)
    chosen.likelihood = SimpleNamespace(count=100)
    best = Hypothesis(("drift", "creep")[:size])
    assert chosen.done(best, current) is over
    assert not chosen.done(NOTHING, current)
    current.cost = 200.0  # where what is left is more than noise, so is what chance promises
    assert chosen.done(best, current)


@pytest.mark.parametrize(
    ("rival", "grown", "taken"),
    [(120.0, 10.0, True), (120.0, 90.0, False), (200.0, 10.0, False)],
    ids=["does more", "is not worth one more", "saved less than nearly as much"],
)
def test_a_first_effect_that_did_nearly_as_well_is_followed_too(chosen, monkeypatch, rival, grown, taken):
    beside = Hypothesis(("slip", "creep"))
    for hypothesis, cost in ((DRIFT, 100.0), (SLIP, rival)):
        chosen.add(hypothesis, fit(cost))
    monkeypatch.setattr(chosen, "share", lambda fit: 1.0 - fit.cost / chosen.plain.cost)
    monkeypatch.setattr(chosen, "forward", lambda best, *_: (beside, fit(grown)) if best == SLIP else None)
    best, found = chosen.rivalled(DRIFT, chosen.fits[DRIFT])
    assert (best, found.cost) == ((beside, grown) if taken else (DRIFT, 100.0))


def test_no_rival_is_followed_where_nothing_was_taken_or_nothing_is_left(chosen, monkeypatch):
    monkeypatch.setattr(chosen, "forward", lambda *_: pytest.fail("nothing is to be followed"))
    assert chosen.rivalled(NOTHING, chosen.plain) == (NOTHING, chosen.plain)
    for hypothesis, cost in ((DRIFT, 100.0), (SLIP, 101.0)):
        chosen.add(hypothesis, fit(cost))
    monkeypatch.setattr(selection, "complete", lambda fit: True)
    assert chosen.rivalled(DRIFT, chosen.fits[DRIFT])[0] == DRIFT


def test_a_second_effect_stays_where_it_explains_a_share_of_its_own(chosen, monkeypatch):
    both = Hypothesis(("drift", "slip"))
    chosen.add(DRIFT, fit(200.0))
    monkeypatch.setattr(chosen, "fit", lambda less, *_, **__: (fit(200.0 if less == DRIFT else 900.0), True))
    for cost, taken in ((140.0, both), (165.0, DRIFT), (175.0, DRIFT)):  # 5 % of 1000 are 50, EVIDENCE is 30
        chosen.best.pop(2, None)
        chosen.add(both, two := fit(cost))
        chosen.costs[both] = cost
        assert chosen.backward(both, two)[0] == taken


def test_over_the_same_windows_a_rival_that_gave_up_near_the_best_is_fitted_to_its_end(chosen, monkeypatch):
    def made(cost: float, converged: bool):
        return SimpleNamespace(cost=cost, converged=converged, values={}, shifts=None, unknowns=("k",))

    chosen.search.effects = {e.key: e for e in map(effect, ("drift", "slip", "creep", "mass"))}
    creep, mass = Hypothesis(("creep",)), Hypothesis(("mass",))
    for h, cost, converged in ((DRIFT, 100.0, True), (SLIP, 150.0, False), (creep, 250.0, False), (mass, 150.0, True)):
        chosen.add(h, made(cost, converged))
    chosen.likelihood.count = 100
    asked = []

    def fitted(hypothesis, *_, enough=None, **__):
        asked.append((hypothesis, enough))
        chosen.add(hypothesis, made(60.0, True))

    monkeypatch.setattr(chosen, "fit", fitted)
    longer, best, found = chosen.over(chosen.likelihood, DRIFT, chosen.fits[DRIFT])
    assert asked == [(SLIP, ROUGH), (SLIP, None)]  # a tenth of what the best saves is 90; what is chosen, to its end
    assert (longer, best, found.cost) == (chosen, SLIP, 60.0)


def over_longer_windows(chosen, monkeypatch, costs: dict, unknowns: dict):
    """(What fits over longer windows are asked for, what is chosen of them); `costs` there, of so many unknowns."""
    monkeypatch.setattr(selection, "complete", lambda fit: True)
    asked, final = [], SimpleNamespace(count=1000)

    def made(h: Hypothesis, cost: float):
        return SimpleNamespace(cost=cost, converged=True, values={}, shifts=None, unknowns=("k",) * unknowns[h])

    def fitted(self, hypothesis, *_, enough=None, **__):
        assert self.likelihood is final
        if enough is not None:
            asked.append(hypothesis)
        self.add(hypothesis, made(hypothesis, costs[hypothesis]))

    monkeypatch.setattr(Selection, "fit", fitted)
    _, best, _ = chosen.over(final, DRIFT, chosen.fits[DRIFT])
    return asked, best


def short(chosen, costs: dict) -> None:
    chosen.search.effects = {e.key: e for e in map(effect, ("drift", "slip", "creep"))}
    for h, cost in costs.items():
        chosen.add(h, SimpleNamespace(cost=cost, converged=True, values={}, shifts=None, unknowns=("k",)))


def test_rivals_nearly_as_good_as_the_best_are_seen_over_longer_windows_and_no_others(chosen, monkeypatch):
    creep = Hypothesis(("creep",))
    chosen.likelihood.count = 1000  # a twentieth of the readings are 50; half of what the best saves are 450
    short(chosen, {DRIFT: 100.0, SLIP: 149.0, creep: 151.0})
    each = {DRIFT: 300.0, SLIP: 200.0, creep: 100.0}
    asked, best = over_longer_windows(chosen, monkeypatch, each, dict.fromkeys(each, 1))
    assert asked == [DRIFT, SLIP]
    assert best == SLIP


def test_over_longer_windows_an_unknown_more_costs_the_logarithm_of_the_readings(chosen, monkeypatch):
    chosen.likelihood.count = 1000
    for saves, better in ((6.0, DRIFT), (8.0, SLIP)):  # the logarithm of 1000 is 6.9
        chosen.best.clear()
        short(chosen, {DRIFT: 100.0, SLIP: 120.0})
        each = {DRIFT: 300.0, SLIP: 300.0 - saves}
        assert over_longer_windows(chosen, monkeypatch, each, {DRIFT: 3, SLIP: 4})[1] == better


def test_an_effect_without_which_the_fit_is_as_good_goes(chosen, monkeypatch):
    monkeypatch.setattr(selection, "complete", lambda fit: True)
    both = Hypothesis(("drift", "slip"))
    chosen.add(DRIFT, fit(900.0))
    chosen.add(both, two := fit(100.0))
    for more, left in ((EVIDENCE - 1, SLIP), (EVIDENCE + 1, both)):
        monkeypatch.setattr(chosen, "fit", lambda *_, more=more, **__: (fit(100.0 + more), True))
        assert chosen.backward(both, two)[0] == left


def test_the_plain_plant_is_fitted_from_the_shifts_of_its_own_windows_alone():
    own, asked = SimpleNamespace(), []

    def fitted(likelihood, hypothesis, values, shifts, **_):
        asked.append(shifts)
        return fit(10.0)

    for likelihood in (own, SimpleNamespace()):
        start = SimpleNamespace(likelihood=likelihood, shifts="shifts", values={})
        assert Selection(SimpleNamespace(fit=fitted), own, start, lambda text: None).plain.cost == 10.0
    assert asked == ["shifts", None]


def test_the_plain_plant_counts_among_what_was_fitted():
    plain = fit(10.0)
    start = SimpleNamespace(likelihood=None, shifts=None, values={})
    made = Selection(SimpleNamespace(fit=lambda *_, **__: plain), SimpleNamespace(), start, lambda text: None)
    assert made.plain is plain
    assert (made.costs, made.best) == ({NOTHING: 10.0}, {0: (NOTHING, plain)})


@pytest.mark.parametrize("lost", [False, True])
def test_where_the_plain_plant_does_not_follow_the_recording_every_fit_is_led_through_it(lost, monkeypatch):
    found, led = fit(100.0), fit(50.0)
    search = SimpleNamespace(fit=lambda *_, **__: found, led=lambda fit: led, lost=lambda fit: lost)
    made = Selection(search, SimpleNamespace(), SimpleNamespace(likelihood=None, values={}), lambda text: None)
    monkeypatch.setattr(selection, "possible", lambda *_: True)
    assert made.fit(DRIFT, {}, None)[0] is (led if lost else found)


@pytest.mark.parametrize(("share", "window", "lost"), [(0.2, None, False), (0.4, None, True), (0.4, 100, False)])
def test_a_free_run_is_lost_where_one_channel_errs_by_more_than_three_tenths_of_what_it_moves(share, window, lost):
    target = np.random.default_rng(0).normal(size=(50, 2)) * [1.0, 1000.0]
    likelihood = SimpleNamespace(residual=lambda values: target * [0.01, share], model=SimpleNamespace(target=target))
    search = SimpleNamespace(rig=SimpleNamespace(window=window))
    assert Search.lost(search, SimpleNamespace(likelihood=likelihood, values={})) == lost


def test_a_parameter_that_an_effect_frees_is_tried_at_a_third_of_its_typical_size_and_at_three_times():
    free = SimpleNamespace(symbol="k", typical=10.0, guess=())
    points = Search.points(None, SimpleNamespace(strengths=(free,), frees=("k",), free=(free,)))
    assert points == [{"k": pytest.approx(size)} for size in (3.0, 10.0, 30.0)]
