"""The table of effects: each joins its plants, does nothing at null, and something where its strength is not zero."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from greygate.errors import InputError
from greygate.mismatch import effects as table
from greygate.mismatch.concealed.conceal import _toml
from greygate.mismatch.concealed.line import BELT, DRUM
from greygate.mismatch.concealed.pump import PUMP
from greygate.mismatch.concealed.valve import VALVE
from greygate.mismatch.diagnosis import recovered
from greygate.mismatch.effects import Effect, Free, fitting, join
from greygate.mismatch.intervals import reported
from greygate.mismatch.model import Model
from greygate.mismatch.rig import load
from greygate.mismatch.search import Search
from greygate.plants.plant import Definition, Equation, Parameter, Plant, State, Values
from greygate.plants.recording import Recording

MAKERS = {maker.plant: maker for maker in (VALVE, PUMP, BELT, DRUM)}
OPTIONAL = ("f_coulomb", "f_static", "sigma0", "sigma1", "sigma2", "v_stribeck", "play")
VOCABULARY = {
    "valve_hydraulic": "internal_leakage external_leakage valve_overlap valve_underlap orifice_asymmetry entrained_air "
    "supply_droop input_delay dry_friction constant_load hardening_spring end_cushion sensor_offset_p_a "
    "sensor_gain_p_a",
    "pump_hydraulic": "cylinder_leakage turbulent_leakage entrained_air input_delay constant_load pump_ripple "
    "motor_lag displacement_loss",
    "belt_drive": "tooth_ripple pulley_eccentricity guide_error inertial_stretch thermal_growth scale_error "
    "rate_dependent_band drift reversal_play",
    "cable_drum": "drift drum_eccentricity speed_slip direction_slip acceleration_slip cable_stretch rest_relaxation",
}
TABLE = {**table.read(), **table.read("hydraulics")}
PAIRS = [(plant, key) for plant in MAKERS for key, effect in TABLE.items() if plant in effect.plants]


def motion(samples: int = 2500) -> np.ndarray:
    """A travel of some 40 mm with rests and reversals, at up to 0.1 m/s."""
    t = np.arange(samples) * 1e-3
    return 0.02 * (1 - np.cos(2 * np.pi * 0.8 * t)) * (1 + 0.3 * np.sin(3 * t)) * np.clip(t - 0.1, 0, 1)


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Plant -> model of it with every effect of the table, on 2.5 s of made-up signals."""
    made = {}
    for plant, maker in MAKERS.items():
        folder = tmp_path_factory.mktemp(plant)
        sheet = {name: value for name, value in maker.parameters.items() if name not in OPTIONAL}
        (folder / "rig.toml").write_text(_toml(_less(maker, sheet), sheet))
        rig = load(folder)
        x = motion()
        t = np.arange(len(x)) * 1e-3
        signals = {"x_motor": x, "x_drum": x, "x_load": x, "x": x - 0.02, "v_c": 1.2 * np.sin(9 * t)}
        signals |= {"n_1": 6 * np.sin(8 * t), "n_2": 3 * np.sin(8 * t) + np.cos(5 * t)}
        signals |= {"p_a": 5e6 + 2e6 * np.sin(11 * t), "p_b": 7e6 + 1e6 * np.cos(11 * t)}
        chosen = {name: signals[name] for name in rig.channels}
        recording = Recording(rig.dt, chosen, {name: c.unit for name, c in rig.channels.items()})
        made[plant] = Model(rig, recording, fitting(rig.plant, rig.datasheet, TABLE))
    return made


def _less(maker, sheet):
    return replace(maker, tolerance={name: t for name, t in maker.tolerance.items() if name in sheet})


def without_effects(model: Model) -> np.ndarray:
    bare = Model(model.rig, model.recording, {})
    return bare.predict(bare.values)


@pytest.mark.parametrize("plant", MAKERS)
def test_the_vocabulary_of_a_plant_is_the_tables(plant):
    ids = {effect.id for effect in TABLE.values() if plant in effect.plants}
    assert set(VOCABULARY[plant].split()) <= ids


@pytest.mark.parametrize("plant", MAKERS)
def test_joined_effects_at_null_change_no_prediction(plant, models):
    model = models[plant]
    np.testing.assert_array_equal(model.predict(model.values), without_effects(model))


@pytest.mark.parametrize(("plant", "key"), PAIRS)
def test_an_effect_of_its_typical_size_changes_what_is_predicted(plant, key, models):
    model, effect = models[plant], TABLE[key]
    start = {f.symbol: f.guess[-1] if f.guess and not f.shape else f.typical for f in effect.free}
    changed = model.predict({**model.values, **effect.set, **start})
    assert np.isfinite(changed).all()
    sigma = np.array([model.rig.channels[name].sigma for name in model.rig.predict])
    assert np.abs((changed - model.predict(model.values)) / sigma).max() > 0.3


@pytest.mark.parametrize(("plant", "key"), PAIRS)
def test_an_effect_names_equations_that_the_plant_has_and_channels_that_there_are(plant, key, models):
    model, effect = models[plant], TABLE[key]
    assert set(effect.equations) <= {*model.plant.definitions, *model.plant.equations}
    assert set(effect.depends_on) <= {*model.rig.channels, "x", "v", "a", "t"}
    assert effect.means
    for f in effect.free:
        assert f.low <= f.typical <= f.high or f.high <= 0.0


@pytest.mark.parametrize("key", [key for key, effect in TABLE.items() if effect.wave or len(effect.free) > 1])
def test_what_is_reported_of_an_effect_gives_its_values_back(key, models):
    effect = TABLE[key]
    plant = effect.plants[0]
    model = models[plant]
    search = Search(model.rig, model.recording, TABLE)
    problem = search.screen
    unknowns = [search._unknown(f) for f in effect.free if not f.whole]
    values = {
        f.symbol: f.typical if f.whole else f.low / 2 if f.high <= 0 else (0.6 + 0.1 * i) * f.typical
        for i, f in enumerate(effect.free)
    }
    fit = problem.fit(unknowns, {**values, **effect.set}, iterations=0)
    given = {f.symbol: fit.values[f.symbol] for f in effect.free}
    assert all(given.values())
    assert recovered(effect, reported(effect, fit)) == pytest.approx({**effect.set, **given}, rel=1e-9)


def test_an_effect_in_a_place_that_is_none_is_named():
    plant = Plant.read(table.TABLE.parent.parent / "machines" / "cable_drum" / "cable_drum.toml")
    lost = replace(TABLE["drift"], terms={"gear.drift": "drift * t"})
    with pytest.raises(InputError, match=r"effect drift: gear: cable_drum has no such place"):
        join(plant, [lost])


# -- names of their own ----------------------------------------------------------------------------------------------

CAR = """
step = 1e-3
outputs = ["z_b"]
inputs = { road = "m" }

[parameters]
body = [300.0, "kg"]
wheel = [40.0, "kg"]
c_s = [1500.0, "N s/m"]
k_z_b = [2e4, "N/m"]
k_t = [1.8e5, "N/m"]

[states]
z_b = { unit = "m", rate = "v_b" }
v_b = { unit = "m/s" }
z_w = { unit = "m", rate = "v_w" }
v_w = { unit = "m/s" }

[equations]
lift.z_b = { velocity = "v_b" }
body.v_b = { storage = "body", spring = "-k_z_b * (z_b - z_w)", dry_friction = "-c_s * (v_b - v_w)" }
hop.z_w = { velocity = "v_w" }
wheel.v_w = { storage = "wheel", spring = "k_z_b * (z_b - z_w)", damper = "c_s*(v_b - v_w)", tyre = "k_t*(road - z_w)" }
"""
CAR_RIG = """plant = "car.toml"
sample_time_s = 0.005
predict = ["z_b"]
parameters = { body = 300.0, k_z_b = 2e4 }
channels.road = { unit = "m", role = "input" }
channels.z_b = { unit = "m", role = "output" }
"""


def by_hand(road: np.ndarray, dt: float) -> np.ndarray:
    """The body's position: the linear quarter car, exact for a held road."""
    body, wheel, c, k, tyre = 300.0, 40.0, 1500.0, 2e4, 1.8e5
    a = np.zeros((5, 5))
    a[0, 1] = a[2, 3] = 1.0
    a[1, :4] = np.array([-k, -c, k, c]) / body
    a[3, :4] = np.array([k, c, -k - tyre, -c]) / wheel
    a[3, 4] = tyre / wheel
    step, state, out = expm(a * dt), np.zeros(5), []
    for u in road:
        state[4] = u
        out.append(state[0])
        state = step @ state
    return np.array(out)


@pytest.fixture(scope="module")
def car(tmp_path_factory):
    """The folder of a quarter car whose suspension is called as a general effect and its parameter are."""
    folder = tmp_path_factory.mktemp("car")
    (folder / "car.toml").write_text(CAR)
    (folder / "rig.toml").write_text(CAR_RIG)
    t = np.arange(1200) * 5e-3
    road = 0.01 * np.sin(2 * np.pi * 1.3 * t) + 0.02 * (t > 1.0)
    columns = np.column_stack([t, road, by_hand(road, 5e-3)])
    for name in ("identify", "holdout"):
        np.savetxt(folder / f"{name}.csv", columns, delimiter=",", header="t,road,z_b", comments="", fmt="%.17g")
    return folder


def test_a_plant_keeps_a_term_that_is_called_as_a_general_effect(car, greygate):
    out = car / "predicted.csv"
    code, printed, message = greygate("simulate", car, car / "identify.csv", "--out", out, "--json")
    assert code == 0, message
    found = json.loads(printed)["rms"]["z_b"]["rms"]
    assert found < 1e-9  # m, of a motion of some 20 mm


@pytest.mark.parametrize("names", ["effects", "general", "hydraulics"])
def test_effects_of_every_table_at_null_leave_a_plant_that_has_all_their_names(car, names, tmp_path):
    """The plant's terms are called as the table's are; a symbol that is taken is another in the effect, or refused."""
    rig = load(car)
    recording = rig.recording(car / "identify.csv")
    if names == "general":
        effects = table.general(rig, recording)
        assert {f.symbol for f in effects["spring_z_b"].free} == {"k_z_b_2"}
        assert {f.reported for f in effects["spring_z_b"].free} == {"k_z_b"}
    else:
        made = table.read() if names == "effects" else table.read("hydraulics")
        terms = {path.partition(".")[2] for effect in made.values() for path in effect.terms}
        effects = {
            f"e{i}": Effect(
                f"e{i}", "", ("car",), ("body",), (), (Free(f"s{i}", 1.0),), {f"body.{term}": f"s{i} * z_b"}
            )
            for i, term in enumerate(sorted(terms | {"spring", "dry_friction"}))
        }
    joined, _ = join(rig.plant, effects.values())
    for place, equation in rig.plant.equations.items():
        assert dict(equation.terms).items() <= dict(joined.equations[place].terms).items()
    model = Model(rig, recording, effects)
    np.testing.assert_array_equal(model.predict(model.values), without_effects(model))
    np.testing.assert_allclose(model.predict(model.values)[:, 0], recording["z_b"], atol=1e-9)


@pytest.mark.parametrize("plant", MAKERS)
def test_general_effects_at_null_change_no_prediction(plant, models):
    model = models[plant]
    effects = table.general(model.rig, model.recording)
    assert effects
    general = Model(model.rig, model.recording, effects)
    np.testing.assert_array_equal(general.predict(general.values), without_effects(model))


OWN = Effect("own", "", ("car",), ("body",), (), (Free("own_k", 1.0),), {"body.own": "own_k * z_b"}, table="mine")
LOAD = {"load": Definition("f", "N", {"sum": "own_k * z_b"})}
CLASHES = {
    "parameter": (replace(OWN, free=(Free("k_z_b", 1.0),), terms={}), "symbol k_z_b: plant car has this name too"),
    "a parameter that is an input": (replace(OWN, free=(Free("road", 1.0),), terms={}), "symbol road: plant car has"),
    "state": (replace(OWN, states={"z_b": State("m")}), "symbol z_b: plant car has this name too"),
    "definition": (replace(OWN, definitions={"body": LOAD["load"]}), "place body: plant car has this name too"),
    "definition's symbol": (
        replace(OWN, definitions={"load": Definition("z_w", "m", {"sum": "z_b"})}), "symbol z_w: plant car has"),
    "equation": (replace(OWN, equations_of={"lift": Equation("q", {"t": "z_b"})}), "place lift: plant car has"),
    "input that is none": (replace(OWN, filters={"track": "delay own_k"}), "filters.track: plant car has no"),
    "constant that is none": (replace(OWN, set={"dry": 1.0}), "set dry: plant car has no such parameter"),
    "what it frees is none": (replace(OWN, free=(Free("dry", 1.0),), frees=True, terms={}), "frees dry: plant car has"),
    "sensor of nothing": (replace(OWN, terms={"sensor_p.own": "own_k"}), "sensor_p: plant car has no signal p"),
    "sensor that reads another": (
        replace(OWN, terms={"sensor_z_b.own": "own_k * z_w"}), "unknown name 'z_w'; use z_b, inputs and parameters"),
}  # fmt: skip


@pytest.mark.parametrize("case", CLASHES)
def test_a_clash_of_an_effect_with_the_plant_is_refused(case, car):
    effect, problem = CLASHES[case]
    with pytest.raises(InputError) as caught:
        join(load(car).plant, [effect])
    assert str(caught.value).startswith("effect own: ")
    assert problem in str(caught.value)


def test_effects_share_a_name_only_with_their_relatives(car):
    plant = load(car).plant
    other = replace(OWN, key="other", terms={"body.own": "own_k"})
    joined, _ = join(plant, [OWN, other])
    assert {"own.own", "other.own"} <= set(joined.equations["body"].terms)
    join(plant, [OWN, replace(other, of="own", table="yours")])
    for stranger in (
        replace(other, table="yours"),
        replace(other, free=(Free("own_k", 1.0, "N"),)),
        replace(other, free=(Free("own_k", 1.0, shape=True),)),
    ):
        with pytest.raises(InputError, match="effect other: symbol own_k: effect own has something else of this name"):
            join(plant, [OWN, stranger])
    with pytest.raises(InputError, match="place load: effect own has something else"):
        join(plant, [replace(OWN, definitions=LOAD), replace(other, definitions={"load": Definition("g", "N", {})})])


def test_a_place_of_the_plant_is_no_sensor(car, tmp_path):
    plant = load(car).plant
    read = replace(plant, equations={f"sensor_{n}": e for n, e in plant.equations.items()})
    with pytest.raises(InputError, match="names in sensor_ are kept for readings"):
        join(read, [])


def test_a_name_of_the_simulation_itself_is_refused(car):
    rig = load(car)
    taken = replace(rig.plant, parameters={**rig.plant.parameters, "input_timing": Parameter(0.0, "s")})
    rig = replace(rig, plant=taken, window=100)
    with pytest.raises(InputError, match="input_timing: is the simulation's own name"):
        Model(rig, rig.recording(car / "identify.csv"), {})


def test_a_filter_that_is_unknown_is_refused(car):
    rig = load(car)
    effect = replace(OWN, filters={"road": "echo own_k"})
    with pytest.raises(InputError, match=r"effect own: filters\.road: 'echo'; give one of delay, lag"):
        Model(rig, rig.recording(car / "identify.csv"), {"own": effect})


def test_an_effect_that_borrows_the_terms_of_another_is_refused(tmp_path):
    """It would do nothing where it is simulated without the other."""
    path = tmp_path / "effects.toml"
    path.write_text('[lap]\nmeans = ""\nequations = ["flow_a"]\ndepends_on = []\nparameters.overlap.typical = 1e-5\n')
    with pytest.raises(InputError, match=r"effects\.toml: effect lap changes nothing of the plant by itself; give one"):
        table.read(path)


@pytest.mark.parametrize(("key", "size"), [("valve_overlap", 1e-5), ("valve_underlap", -1e-5)])
def test_a_lap_narrows_or_widens_all_four_edges_and_never_the_other_ones(key, size):
    effect = TABLE[key]
    assert {path.partition(".")[0] for path in effect.terms} == {f"opening_{edge}" for edge in ("sa", "at", "sb", "bt")}
    for text in effect.terms.values():
        assert [Values(None, {"overlap": by}).evaluate(text) for by in (size, -size)] == [-size, 0.0]
