"""Where a mismatch acts: regime, time and frequency band, and how often there is said to be one where there is none."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from greygate.mismatch import locate as locating
from greygate.mismatch import rig, words
from greygate.mismatch.concealed.conceal import conceal
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.locate import added, band, left, locate, located

DT, SAMPLES = 1e-3, 20_000
T = np.arange(SAMPLES) * DT
X = 0.04 * np.sin(2 * np.pi * 0.9 * T + 0.3 * np.sin(T))  # m
V = np.gradient(X, DT)
NOISE = np.random.default_rng(1).standard_normal(SAMPLES)
UNITS = {"x": "m", "v": "m/s", "p_a": "Pa", "p_b": "Pa", "t": "s"}
MOTION = {"x": X, "v": V, "t": T}


def found(signal: np.ndarray, variables=MOTION) -> locating.Location:
    return locate(signal.reshape(SAMPLES, -1), T, variables, UNITS)


REGIMES = {
    "the ends of the stroke": (np.abs(X) > 0.031, r"\|x\| above (\S+) mm", [31]),
    "one end": (X > 0.031, r"x above (\S+) mm", [31]),
    "the middle": (np.abs(X) < 0.012, r"\|x\| below (\S+) mm", [12]),
    "a place between": ((X > 0.0) & (X < 0.02), r"x (\S+) to (\S+) mm", [0, 20]),
    "high speed": (np.abs(V) > 0.18, r"\|v\| above (\S+) m/s", [0.18]),
    "one direction": (V < 0, "backward", []),
    "the other direction": (V > 0, "forward", []),
}


@pytest.mark.parametrize("where", REGIMES)
def test_energy_is_located_at(where):
    there, words, limits = REGIMES[where]
    said = found(NOISE * there)
    told = re.match(words, said.regime)
    assert told, said.regime
    reach = 1e3 * X.max() if "mm" in words else V.max()
    np.testing.assert_allclose([float(b.replace("−", "-")) for b in told.groups()], limits, atol=0.07 * reach)
    assert said.time == "all the time"


def test_a_share_of_the_energy_and_of_the_time_is_told():
    there = np.abs(X) > 0.031
    energy, time = map(
        int, re.search(r"\((\d+) % of it, in (\d+) % of the time\)", found(NOISE * there).regime).groups()
    )
    assert energy > 95
    assert time == pytest.approx(100 * there.mean(), abs=3)


def test_of_two_pressures_the_difference_is_looked_at():
    low = lfilter([1e-2], [1, -0.99], np.random.default_rng(2).standard_normal((2, SAMPLES)))
    p_a, p_b = 1e7 + 5e6 * low
    said = found((p_a - p_b) ** 3, {"p_a": p_a, "p_b": p_b})
    assert re.match(r"\|p_a − p_b\| above \S+ bar", said.regime)


@pytest.mark.parametrize("seed", range(8))
def test_white_noise_is_everywhere_all_the_time(seed):
    said = found(np.random.default_rng(seed).standard_normal((SAMPLES, 2)))
    assert (said.regime, said.time) == ("everywhere", "all the time")


TIMES = {
    "from 12 s on": NOISE * (T > 12),
    "until 5 s": NOISE * (T < 5),
    "between 3 and 9 s": NOISE * ((T > 3) & (T < 9)),
    "until 3 s and from 17 s on": NOISE * ((T < 3) | (T > 17)),
    "grows with time": T,
    "fades with time": NOISE * (20 - T),
}


@pytest.mark.parametrize("time", TIMES)
def test_a_mismatch_acts(time):
    said = found(TIMES[time])
    assert (said.regime, said.time) == ("everywhere", time)


def test_signals_that_hang_together_are_rarely_said_to_act_somewhere(monkeypatch):
    """A second of memory in twenty; cell by cell, as though each were news, three times as many would be."""

    def claims() -> int:
        count = 0
        for seed in range(50):
            signal, x = lfilter([1.0], [1.0, -0.999], np.random.default_rng(seed).standard_normal((2, SAMPLES)))
            said = found(signal, {"x": x, "t": T})
            count += (said.regime, said.time) != ("everywhere", "all the time")
        return count

    rarely = claims()
    assert rarely <= 3
    monkeypatch.setattr(locating, "STRETCHES", locating.CELLS)
    assert claims() > 2 * rarely


def test_a_sine_has_its_band():
    ends = re.match(r"80 % of its power between (\S+) and (\S+) Hz", band(np.sin(2 * np.pi * 0.7 * T)[:, None], DT))
    assert 0.6 < float(ends[1]) < 0.7 < float(ends[2]) < 0.8
    assert band(np.sin(2 * np.pi * 50 * T)[:, None], DT) == "80 % of its power at 50 Hz"
    assert band(1 + 0.1 * NOISE[:, None], DT) == "constant"
    assert band(T[:, None], DT) == "90 % of its power below 0.1 Hz"


@pytest.fixture(scope="module")
def drum(tmp_path_factory):
    """Diagnosis of a drum that slips more when it moves backward."""
    folder = tmp_path_factory.mktemp("drum") / "case"
    return diagnose(rig.load(conceal("cable_drum", 3, folder, effect="direction_slip", kind="one")))


def test_what_a_parameter_adds_is_its_term_along_the_recording(drum):
    fit = drum.corrected
    travel = np.append(np.diff(fit.likelihood.model.recording["x_drum"]) / drum.rig.dt, 0.0)
    slip = added(fit, "transmission", ["asym"])  # it enters the balance of the slip, which the transmission shows
    np.testing.assert_allclose(slip[:, 0], fit.values["asym"] * np.minimum(travel, 0.0), atol=1e-12)
    np.testing.assert_array_equal(added(fit, "slip", ["asym"]), slip)


def test_a_diagnosis_says_where_it_acts(drum):
    (place,) = drum.as_dict()["where"]
    assert place["regime"] == "extra slip per travel when moving backward; backward"
    assert place["depends_on"] == ["v"]
    assert place["band"].endswith("Hz")
    printed = "\n".join(words.lines(drum))
    assert f"transmission, depends on v\n{' ' * 18}backward, {place['time']}, {place['band']}\n" in printed


EFFECTS = {
    "speed_slip": r"\|?v\|? above",
    "direction_slip": "backward",
    "acceleration_slip": r"\|a\| above",
    "cable_stretch": r"\|a\| above|a below",
    "drum_eccentricity": "everywhere, all the time",
    "drift": "everywhere, grows with time",
}


@pytest.mark.parametrize("key", EFFECTS)
def test_an_effect_of_the_table_acts_where_it_is_at_home(drum, key):
    effect = drum.search.effects[key]
    calibrated = drum.calibrated
    fit = replace(calibrated, fixed={**calibrated.fixed, **{f.symbol: f.typical for f in effect.free}})
    fit = replace(fit, errors=fit.likelihood.errors(fit.values, fit.shifts))
    place = {"equation": "transmission", "depends_on": list(effect.depends_on), "regime": ""}
    said = located(fit, place, [[f.symbol for f in effect.free]])
    assert re.match(EFFECTS[key], f"{said['regime']}, {said['time']}"), said


@pytest.mark.parametrize("drift", [1e-8, 1e-3])
def test_of_two_effects_in_one_place_the_one_counts_that_changes_more(drum, drift):
    fit = replace(drum.corrected, fixed={**drum.corrected.fixed, "drift": drift})
    fit = replace(fit, errors=fit.likelihood.errors(fit.values, fit.shifts))
    place = {"equation": "transmission", "depends_on": ["v", "t"], "regime": ""}
    said = located(fit, place, [("asym",), ("drift",)])
    assert ("backward" in said.values(), "grows with time" in said.values()) == (drift < 1e-6, drift > 1e-6)


def test_without_a_correction_what_is_left_is_located(drum):
    place = {"equation": "sensor_x_load", "depends_on": [], "regime": "somewhere"}
    said = located(drum.calibrated, place, ())
    assert said["regime"].startswith("somewhere; ")
    assert {**said, "regime": ""} != {**place, "regime": ""}
    samples = drum.calibrated.likelihood.windows * drum.calibrated.likelihood.block
    assert left(drum.calibrated, "sensor_x_load").shape == (samples, 1)
