"""The table of effects: each joins its plants, does nothing at null, and something where its strength is not zero."""

from dataclasses import replace

import numpy as np
import pytest

from greygate.errors import InputError
from greygate.mismatch import effects as table
from greygate.mismatch.conceal import _toml
from greygate.mismatch.concealed.line import BELT, DRUM
from greygate.mismatch.concealed.pump import PUMP
from greygate.mismatch.concealed.valve import VALVE
from greygate.mismatch.diagnosis import recovered, reported
from greygate.mismatch.effects import fitting, join
from greygate.mismatch.model import Model
from greygate.mismatch.rig import load
from greygate.mismatch.search import Search
from greygate.plants.plant import Plant
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
    plant = Plant.read(table.TABLE.parent.parent / "plants" / "rigs" / "cable_drum.toml")
    lost = replace(TABLE["drift"], terms={"gear.drift": "drift * t"})
    with pytest.raises(InputError, match=r"effect drift: gear: cable_drum has no such place"):
        join(plant, [lost])
