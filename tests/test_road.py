"""From a plant and its diagnosis to a network: exact integration, named effects as modules, and what is refused."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from greygate.errors import InputError
from greygate.identify.expert import building, diagnosed
from greygate.identify.expert.acting import FILTERS, acting
from greygate.identify.expert.building import build, corrected_task
from greygate.identify.expert.decisions import Log
from greygate.identify.expert.diagnosed import READS, _with_a_place, correct, rig_for
from greygate.identify.expert.integration import SCHEMES, step
from greygate.identify.expert.parts import part
from greygate.identify.expert.refined import refined
from greygate.identify.expert.task import Task
from greygate.mismatch.given import rig_of
from greygate.mismatch.model import FILTERS as ON_RECORD
from greygate.models.accuracy import rms
from greygate.models.network import Network, Port
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording
from greygate.plants.simulator import simulate
from greygate.progress import Budget

CART = {
    "step": 2e-4,
    "outputs": ["x"],
    "inputs": {"u": "V"},
    "parameters": {"mass": [2.0, "kg", 0.05], "k_f": [5.0, "N/V", 0.1], "b": [20.0, "N s/m", 0.3]},
    "states": {"x": {"unit": "m", "rate": "v"}, "v": {"unit": "m/s"}},
    "equations": {
        "place": {"x": {"speed": "v"}},
        "cart": {"v": {"storage": "mass", "motor": "k_f * u", "guide": "-b * v"}},
    },
}
DIAGNOSIS = {
    "schema": "diagnosis/2",
    "plant": "cart",
    "verdict": "missing_physics",
    "effects": [
        {"id": "dry_friction", "form": "dry_friction", "equations": ["cart"],
         "parameters": {"f_v": {"value": 6.0}, "f_v_speed": {"value": 0.003}}}
    ],
    "parameters": {"mass": {"value": 2.06}, "k_f": {"value": 5.3}, "b": {"value": 24.0}},
}  # fmt: skip
SAMPLES, DT = 600, 5e-3
VALVE = Path(__file__).parents[1] / "machines" / "valve_cylinder" / "valve_hydraulic.toml"


def valve_run(plant: Plant) -> Recording:
    """A recording of the names and units of the valve's; nothing of it is asked."""
    wave = np.sin(0.05 * np.arange(SAMPLES))
    sizes = {"v_c": 1.0, "x": 0.05, "p_a": 5e6, "p_b": 5e6}
    channels = {n: size * (1.5 + wave) for n, size in sizes.items()}
    return Recording(1e-3, channels, {n: plant.unit(n) for n in sizes})


def recorded(plant: Plant, seed: int, dt: float = DT) -> Recording:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-8, 8, SAMPLES // 40), 40)
    return simulate(plant, {"u": u}, sample_time=dt, step=2e-4)


@pytest.fixture(scope="module")
def cart() -> Plant:
    return Plant.of("cart", CART)


@pytest.fixture(scope="module")
def real(cart) -> Plant:
    return cart.with_term("cart", "dry", "-6.0 * tanh(v / 0.003)").with_parameters(k_f=5.3, b=24.0, mass=2.06)


@pytest.fixture(scope="module")
def built(cart, real):
    return build(cart, {"first": recorded(real, 1)}, {"other": recorded(real, 2)}, diagnosis=DIAGNOSIS)


def test_a_diagnosed_cart_errs_by_a_thousandth_of_what_the_data_sheet_does(built):
    rms = {who: by["other"]["x"] for who, by in built.rms.items()}
    assert rms["network"] < 1e-3  # m; issue 44
    assert rms["network"] < 5e-3 * rms["nominal"]
    assert rms["corrected"] < 1e-5


def test_named_friction_is_one_tanh_neuron_in_each_evaluation_and_nothing_else_bends(built):
    layers = built.network.layers()
    bent = [layer for layer in layers.values() if not layer.is_linear]
    (scheme,) = [d for d in built.log.decisions if d.about == "integration"]
    assert {layer.activation for layer in bent} == {"tansig"}
    substeps, order = int(scheme.choice.split()[0]), 2 if "second order" in scheme.choice else 1
    assert len(bent) == substeps * order
    assert "cart.dry_friction" in scheme.reason


def test_no_unknown_term_is_tried_where_the_diagnosis_leaves_nothing(built):
    assert not [d for d in built.log.decisions if "an unknown term" in d.choice]
    assert [d for d in built.log.decisions if d.about == "cart" and d.choice == "dry friction"]


def test_a_linear_plant_needs_one_step_and_equals_its_simulation(cart):
    told = {**DIAGNOSIS, "verdict": "consistent", "effects": [], "parameters": {}}
    run = recorded(cart, 3)
    found = build(cart, {"first": run}, {}, diagnosis=told)
    (scheme,) = [d for d in found.log.decisions if d.about == "integration"]
    assert scheme.choice == "one step a sample, of first order"
    assert found.rms["network"]["first"]["x"] < 1e-9 * np.ptp(run["x"])


@pytest.mark.parametrize(
    "wall",
    [
        "-when(max(abs(x) - 0.05, 0), 40 * v)",
        "-when(max(-1e-10 * x, 0), 60 * v * abs(v))",
        "when(max(-x - 0.02, 0), -when(max(v, 0), 40 * v))",
        "-when(max(-x, 0), 9 * tanh(v / 0.1))",
        "-when(mass, when(0, 3 * v) + 40 * v)",
        "-when(abs(b), 4 * v * abs(x))",
    ],
)
def test_a_term_acts_in_the_network_where_its_condition_holds(cart, wall):
    """By a level, of any size, around what is itself a layer; always or never, which needs no multiplexer."""
    damped = cart.with_term("cart", "wall", wall)
    told = {**DIAGNOSIS, "verdict": "consistent", "effects": [], "parameters": {}}
    run, free = (recorded(plant, 3) for plant in (damped, cart))
    found = build(damped, {"first": run}, {}, diagnosis=told)
    assert rms(run["x"] - free["x"]) > 0.01 * np.ptp(run["x"])
    assert found.rms["network"]["first"]["x"] < 5e-3 * np.ptp(run["x"])
    switched = [d for d in found.log.decisions if d.reason == "the term acts only where its condition holds"]
    assert bool(switched) is ("max" in wall)
    for layer in found.network.layers().values():  # a condition counts by its sign, in numbers that a word can hold
        if layer.activation == "select":
            assert 1e-2 < max(abs(w[0][0]) for w in layer.weights.values()) < 1e2


def test_a_condition_that_no_network_can_tell_is_refused(cart):
    told = {**DIAGNOSIS, "verdict": "consistent", "effects": [], "parameters": {}}
    heavier = Plant.of("cart", {**CART, "equations": {**CART["equations"], "cart": {
        "v": {**CART["equations"]["cart"]["v"], "storage": "mass + when(x, 0.5)"}}}})  # fmt: skip
    with pytest.raises(InputError, match=r"cart_storage_r: the condition of when\(\): .* write it as max\(\.\.\., 0\)"):
        build(heavier, {"first": recorded(heavier, 3)}, {}, diagnosis=told)


COIL = {
    "step": 5e-5,
    "outputs": ["i"],
    "inputs": {"u": "V"},
    "parameters": {"L": [5e-4, "H"], "R": [5.6, "ohm"]},
    "states": {"i": {"unit": "A"}, "warm": {"unit": "1"}},
    "equations": {
        "electric": {"i": {"storage": "L", "source": "u", "drop": "-R * i", "warmer": "-R * i * warm"}},
        "heat": {"warm": {"storage": "0.1", "power": "0.02 * R * i**2", "loss": "-warm"}},
    },
}


def test_a_fast_state_whose_square_warms_a_slow_one_begins_as_the_plant():
    """Before the first sample its current would be 270 times as large, and heat it: Newton's whole step goes astray."""
    coil = Plant.of("coil", COIL)
    u = np.repeat(np.random.default_rng(1).uniform(2, 8, SAMPLES // 40), 40)
    run = simulate(coil, {"u": u}, sample_time=5e-4, step=5e-5)
    told = {**DIAGNOSIS, "plant": "coil", "verdict": "consistent", "effects": [], "parameters": {}}
    found = build(coil, {"first": run}, {}, diagnosis=told)
    assert found.rms["network"]["first"]["i"] < 2e-3 * np.ptp(run["i"])


def test_what_judges_the_network_decides_nothing_in_its_diagnosis(cart, real, monkeypatch):
    """`greygate make` shows the diagnosis what it is held against, for the report."""
    seen = {}

    def told(rig, **options):
        seen.update(options, held=rig.held_out().samples)
        return SimpleNamespace(as_dict=dict)

    monkeypatch.setattr(diagnosed, "diagnose", told)
    first, other = recorded(real, 1), recorded(real, 2)
    diagnosed.asked(Task.of(cart, [first], (), ()), [first], Budget(1.0), held=[other])
    assert (seen["unseen"], seen["held"]) == (True, SAMPLES)


def test_a_diagnosis_of_another_plant_is_refused(cart, real):
    with pytest.raises(InputError, match="is of wagon, the rig is cart"):
        build(cart, {"first": recorded(real, 1)}, {}, diagnosis={**DIAGNOSIS, "plant": "wagon"})


def test_a_plant_that_no_step_follows_is_refused_by_its_term(cart):
    stiff = cart.with_term("cart", "wall", "-2e18 * x**3")
    told = {**DIAGNOSIS, "verdict": "consistent", "effects": [], "parameters": {}}
    with pytest.raises(InputError, match=r"no network of it: cart.wall turns by .* 0.01 is allowed; record faster"):
        build(stiff, {"first": recorded(stiff, 1)}, {}, diagnosis=told)


def test_a_knee_that_no_step_follows_is_softened_within_its_interval_alone(cart, real, monkeypatch):
    monkeypatch.setattr(building, "best_fit", lambda task, *given: task)  # which would find the knee here
    monkeypatch.setattr(building, "COARSE", 4e-3)

    def told(**interval):
        (effect,) = DIAGNOSIS["effects"]
        sharp = {"f_v": {"value": 20.0}, "f_v_speed": {"value": 3e-4, **interval}}
        return {**DIAGNOSIS, "effects": [{**effect, "parameters": sharp}]}

    recordings = {"first": recorded(real, 1)}
    with pytest.raises(InputError, match=r"no network of it: cart\.dry_friction turns by"):
        build(cart, recordings, {}, diagnosis=told())
    found = build(cart, recordings, {}, diagnosis=told(ci95=[-9.4e-3, 0.01]))
    (soft,) = [d for d in found.log.decisions if d.step == "soften"]
    assert soft.choice == "f_v_speed 0.01"
    assert "else cart.dry_friction turns by" in soft.reason
    (scheme,) = [d for d in found.log.decisions if d.about == "integration"]
    assert "cart.dry_friction turns by" in scheme.reason


def test_named_friction_takes_a_fuller_shape_where_the_recording_has_one(cart):
    stribeck = "-6.0 * tanh(v / 0.003) * (1.0 + 0.5 * exp(-(v / 0.1)**2))"
    run = recorded(cart.with_term("cart", "dry", stribeck), 5)
    task = Task.of(cart, [run], (), ())
    told = {**DIAGNOSIS, "parameters": {}, READS: ["u"]}
    found = correct(task, [run], told)
    known = corrected_task(task, found, (), told, Log())
    tried = dict(refined(known, cart.parameters, [run], found.own, lambda line: None))
    fuller = tried["a fuller dry_friction"].plant.parameters
    missed = {what: rms(made.nominal(run)["x"] - run["x"]) for what, made in tried.items()}
    assert missed["a fuller dry_friction"] < 0.01 * missed["its values"]
    assert fuller["f_v_static"].value == pytest.approx(0.5, rel=0.05)
    assert fuller["f_v_stribeck"].value == pytest.approx(0.1, rel=0.05)


def test_nothing_is_refined_that_misses_the_recording_by_its_noise_alone(cart):
    run = recorded(cart, 6)
    noisy = run["x"] + 1e-5 * np.random.default_rng(7).standard_normal(SAMPLES)
    noisy = Recording(run.dt, {"u": run["u"], "x": noisy}, run.units)
    task = Task.of(cart, [noisy], (), ())
    assert refined(task, cart.parameters, [noisy], {}, lambda line: None) == []
    off = replace(task, plant=cart.with_parameters(b=22.0))
    assert [what for what, _ in refined(off, cart.parameters, [noisy], {}, lambda line: None)] == ["its values"]


def test_a_linear_step_is_exact_and_a_sum_does_not_leak():
    a, h = np.array([[0.0, 1.0], [0.0, -12.0]]), 5e-3
    found, decay = step(a, h), np.exp(-12.0 * h)
    assert found.own[0].tolist() == [1.0, pytest.approx((1 - decay) / 12.0, rel=1e-12)]
    assert found.own[1].tolist() == [0.0, pytest.approx(decay, rel=1e-14)]
    assert found.first[1, 1] == pytest.approx((1 - decay) / 12.0, rel=1e-12)
    assert found.second[1, 1] == pytest.approx((decay - 1 + 12.0 * h) / (144.0 * h), rel=1e-9)


def test_a_pascal_does_not_round_away_what_a_metre_does():
    """A piston on oil: pressure moves it by 1e-7 a sample, it moves pressure by 1e6; both are exact."""
    si = np.array([[-20.0, 5e-5], [-1e9, 0.0]])
    mega = np.array([[1.0, 1e6], [1e-6, 1.0]])  # of an entry, where pressure is in MPa
    found, alike = step(si, 2e-3), step(si * mega, 2e-3)
    for one, other in zip(vars(found).values(), vars(alike).values(), strict=True):
        assert one * mega == pytest.approx(other, rel=1e-9)
    assert found.own[0, 1] > 0.0


def test_values_are_not_refined_further_off_than_they_may(cart, real):
    run = recorded(real, 8)
    task = Task.of(cart, [run], (), ())
    for within in (1.0, 2.0):
        ((_, found),) = refined(task, cart.parameters, [run], {}, lambda line: None, within)
        off = [abs(found.plant.parameters[s].value - p.value) / p.reach for s, p in cart.parameters.items()]
        assert 0.9 * within < max(off) <= within * (1 + 1e-9)


def test_effects_that_have_no_place_where_a_signal_is_measured_do_not_end_the_diagnosis():
    """A network that reads the piston's place has no balance of its motion, in which the table has effects."""
    plant = Plant.read(VALVE)
    run = valve_run(plant)
    task = Task.of(plant, [run], ["x"], ["p_a", "p_b"])
    offered = _with_a_place(rig_for(task, [run]))
    assert "supply_droop" in offered
    assert "constant_load" not in offered
    assert not any(e.equations == ("motion",) for e in offered.values())


def test_what_has_no_name_leaves_the_data_sheet_as_it_is(cart, real):
    told = {**DIAGNOSIS, "verdict": "unexplained", "effects": []}
    found = build(cart, {"first": recorded(real, 1)}, {}, diagnosis=told)
    (said,) = [d for d in found.log.decisions if d.step == "diagnose"]
    assert said.choice == "the data sheet's values"
    assert found.rms["corrected"] == found.rms["nominal"]


def test_cheaper_schemes_are_tried_first():
    counts = [scheme.evaluations for scheme in SCHEMES]
    assert counts == sorted(counts)
    assert counts[0] == 1
    assert counts[-1] == 16


GIVEN = {
    "offset": (0.3,), "skew": (0.2,), "dead_zone": (0.5,), "saturation": (0.9, 1.5), "play": (0.4,),
    "rate_limit": (0.8, 30.0), "lag": (0.02,), "delay": (0.0125,),
}  # fmt: skip


@pytest.mark.parametrize("kind", FILTERS)
def test_layers_of_an_input_do_what_the_filter_of_a_diagnosis_does(kind):
    signal = 2.0 * np.sin(np.arange(200) * 0.13) + np.random.default_rng(4).normal(size=200) + 0.7
    network = Network("chain", [Port("u", "V", scale=3.0, initial=float(signal[0]))], [Port("y", "V", scale=3.0)])
    network.connect(acting(network, "u", 3.0, [(kind, GIVEN[kind])], float(signal[0]), DT), "y")
    assert network.run({"u": signal})["y"] == pytest.approx(ON_RECORD[kind](signal, *GIVEN[kind], DT), abs=1e-12)


def test_a_root_is_found_in_the_library():
    log, seen = Log(), {"h": np.linspace(0.05, 0.4, 300)}
    found = part("outflow", lambda at: 3e-4 * np.sqrt(np.maximum(at["h"], 0.0)), seen, {"h": []}, 0, log)
    assert found.of_library
    assert "library network square_root" in log.decisions[-1].choice


def test_the_held_out_part_of_a_rig_is_simulated_from_the_motion_in_which_it_begins(real):
    """As `init-rig` makes it of one recording: its first samples only give its initial state."""
    whole = recorded(real, 3)
    later = Recording(DT, {n: v[300:] for n, v in whole.channels.items()}, whole.units, "holdout.csv")
    task = Task.of(replace(rig_of(real, whole), settle=10), [whole], (), ())
    at_rest = simulate(real, {"u": later["u"]}, sample_time=DT, step=2e-4, initial={"x": float(later["x"][0])})
    errors = [rms(run["x"] - later["x"]) for run in (task.nominal(later), at_rest)]
    assert errors[0] < 1e-4 < 0.05 * errors[1]
    first = replace(later, source=f"{task.rig.identify[0]}.csv")  # what it learns from begins at rest
    assert rms(task.nominal(first)["x"] - at_rest["x"]) == 0.0
