"""The timing-belt drive's rig: its band, its play, its paths, and what the sensors make of it."""

import numpy as np
import pytest

from greygate.errors import InputError
from greygate.machines.belt_drive.plant import (
    ENCODER,
    MOTIONS,
    PLAY,
    SAMPLE_TIME,
    Motion,
    belt_drive,
    measure,
    record,
    velocity,
)
from greygate.plants.simulator import simulate

QUIET = {"tooth": 0.0, "viscous": 0.0}


def run(turns, speed=0.03, sample_time=SAMPLE_TIME, channels=(), **values):
    v = velocity(Motion(turns, speed, day=5, by_hand=False))
    v = np.repeat(v, round(SAMPLE_TIME / sample_time))
    plant = belt_drive(**values)
    inputs = {"v": v, "slip": np.zeros(len(v))}
    return simulate(plant, inputs, sample_time=sample_time, channels=(*plant.outputs, *channels))


def engagement(at):
    return [np.clip(at[f"w{n}"], -1, 1) for n in (1, 2, 3)]


def test_the_boundaries_are_about_three_tenths_of_a_millimetre_apart_and_differ_in_texture():
    at = run((0.299, 0.001), **QUIET)
    turn = int(np.argmax(at["x"]))
    x = np.linspace(0.05, 0.25, 101)
    lower = np.interp(x, at["x"][:turn], at["e"][:turn])
    upper = np.interp(x, at["x"][turn:][::-1], at["e"][turn:][::-1])
    assert np.mean(upper - lower) == pytest.approx(3e-4, rel=0.05)
    assert np.std(upper - lower) > 1e-5


def test_at_a_turn_the_carriage_stands_while_the_motor_winds_the_belt_back_and_crosses_the_play():
    at = run((0.05, 0.03), sample_time=1e-3, channels=("x_carriage", "f_belt"))
    turn = int(np.argmax(at["x"]))
    free = turn + np.flatnonzero(np.abs(at["gap"][turn:]) < 0.49 * PLAY)
    assert len(free) > 1
    assert np.ptp(at["gap"]) == pytest.approx(PLAY, rel=0.15)  # the flanks are elastic
    assert np.abs(at["f_belt"][free]).max() < 2.0 < 9.0 < np.abs(at["f_belt"][turn - 100])
    assert at["x"][turn] - at["x"][free[-1]] > PLAY
    assert np.ptp(at["x_carriage"][turn : free[-1]]) < 10e-6


def test_engaged_teeth_carry_the_load_and_yield():
    at = run((0.2,), channels=("f_belt", "width"), tooth=0.0, band_long=0.0, band_short=0.0)
    k = len(at["x"]) * 3 // 4
    for n, part in ((1, 0.30), (2, 0.35), (3, 0.35)):
        carried = 4e6 * at["width"][k] * part * (-1 - at[f"w{n}"][k])
        assert carried == pytest.approx(at["f_belt"][k], rel=0.02)
    assert at["f_belt"][k] == pytest.approx(10 + 150 * 0.03, rel=0.02)


def test_a_carriage_that_accelerates_lags_by_its_mass():
    light, heavy = (run((0.1,), 0.04, m_carriage=m, tooth=0.0) for m in (4.0, 8.0))
    k = int(np.argmax(np.diff(light["x"], 2)))
    settled = slice(100, 200)
    assert light["e"][k] - heavy["e"][k] > 4e-6
    np.testing.assert_allclose(light["e"][settled], heavy["e"][settled], atol=1e-7)


def test_a_path_inside_the_band_depends_on_where_the_motion_turned():
    slipped = []
    for turn in (0.06, 0.12, 0.2):
        at = run((turn, turn - 0.01), **QUIET)
        k = int(np.argmax(at["x"]))
        slipped.append(at["e"][-1] - at["e"][k] - PLAY)
    assert max(slipped) > 1.1 * min(slipped) > 0


def test_a_path_remembers_more_than_the_point_where_it_turned():
    """Two histories that meet at one position and one error part again: more than one group of teeth."""
    at = run((0.150, 0.138, 0.1485, 0.140), **QUIET)
    last = [float(w[-1]) for w in engagement(at)]
    assert -1 < np.mean(last) < 1
    assert len({round(w, 3) for w in last}) == 3


def test_the_tooth_wave_is_fifteen_micrometres_and_speed_shifts_the_error():
    at = run((0.299,))
    wave = at["e"] - at["e_smooth"]
    assert np.max(wave) == pytest.approx(15e-6, rel=1e-3)
    fast, slow = (np.mean(run((0.299,), speed)["e"]) for speed in (0.04, 0.02))
    assert slow - fast == pytest.approx(4e-4 * 0.02, rel=0.25)


def test_the_encoder_counts_and_the_travel_is_kept():
    for name, motion in MOTIONS.items():
        x = np.cumsum(velocity(motion)) * SAMPLE_TIME
        assert x.min() > -1e-9, name
        assert x.max() < 0.3, name
    read = record("s1")
    counts = read["x"] / ENCODER
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    assert np.abs(read["x"] - read["x_true"]).max() <= ENCODER / 2 + 1e-12


def test_hand_motion_turns_only_where_it_is_told_and_does_the_same_again():
    motion = Motion((0.15, 0.1, 0.2), 0.03, day=9)
    v = velocity(motion)
    assert np.count_nonzero(np.diff(np.sign(v[v != 0]))) == 2
    steady = np.abs(v[len(v) // 20 : len(v) // 3])
    assert np.ptp(steady) > 0.1 * np.mean(steady)
    np.testing.assert_array_equal(measure(motion)["e"], measure(motion)["e"])


def test_an_unknown_motion_is_refused_with_those_there_are():
    with pytest.raises(InputError, match="unknown; give one of training, boundaries, choice, s1"):
        record("s5")
