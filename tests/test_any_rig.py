"""What once ended in a traceback on a valid rig, and the lengths that go with a rig's own pace."""

import numpy as np
import pytest
from scipy.signal import lfilter, savgol_filter

from greygate.mismatch import rig as rigs
from greygate.mismatch.concealed.conceal import conceal
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.fit import _solved, tame
from greygate.mismatch.locate import Energy, Region, locate
from greygate.mismatch.model import SMOOTH, delayed, lagged, reach
from greygate.mismatch.scales import memory, noise, smoothing, span

DECAY = """
step = 0.5
outputs = ["x"]
parameters = { leak = [0.05, "1/s"], nought = [0.0, "1/s"], full = [2.0, "m"] }
states = { x = { unit = "m", initial = "full" } }
equations.level = { x = { leak = "-leak * x", nought = "nought * x" } }
"""
DECAY_RIG = """
plant = "decay.toml"
sample_time_s = 1.0
predict = ["x"]
parameters = { leak = 0.05, nought = 0.0, full = 2.0 }
tolerance = { leak = 0.1, nought = 0.1 }
channels.x = { unit = "m", role = "output", noise_rms = 1e-4 }
"""
LAW = """
outputs = ["y"]
inputs = { u = "V" }
parameters = { gain = [2.0, "N/V"] }
definitions.law = { y = { unit = "N", line = "gain * u" } }
"""
LAW_RIG = """
plant = "law.toml"
sample_time_s = 60.0
predict = ["y"]
parameters = { gain = 2.0 }
tolerance = { gain = 0.1 }
channels.u = { unit = "V", role = "input" }
channels.y = { unit = "N", role = "output", noise_rms = 1e-3 }
"""


def written(folder, name: str, plant: str, sheet: str, header: str, columns) -> rigs.Rig:
    (folder / f"{name}.toml").write_text(plant)
    (folder / "rig.toml").write_text(sheet)
    np.savetxt(folder / "identify.csv", np.column_stack(columns), delimiter=",", header=header, comments="")
    return rigs.load(folder)


@pytest.mark.parametrize("leak", [0.051, 0.1])
def test_a_plant_without_inputs_is_diagnosed(tmp_path, leak):
    t = np.arange(80.0)
    x = 2.0 * np.exp(-leak * t) + 1e-4 * np.random.default_rng(1).standard_normal(80)
    rig = written(tmp_path, "decay", DECAY, DECAY_RIG, "t,x", (t, x))
    found = diagnose(rig).as_dict()
    assert found["verdict"] == ("consistent" if leak < 0.06 else "parameter_error")
    low, high = found["parameters"]["leak"]["ci95"]
    assert low < leak < high
    assert "nought" not in found["parameters"]  # a share of 0 is 0


def test_a_static_plant_with_told_noise_says_in_which_law_something_is_missing(tmp_path):
    rng = np.random.default_rng(2)
    u = np.repeat(rng.standard_normal(40), 5)
    y = 2.02 * u + 0.5 * u**2 + 1e-3 * rng.standard_normal(200)
    rig = written(tmp_path, "law", LAW, LAW_RIG, "t,u,y", (60.0 * np.arange(200), u, y))
    found = diagnose(rig).as_dict()
    assert found["verdict"] == "unexplained"
    assert [(place["equation"], place["depends_on"]) for place in found["where"]] == [("law", ["u"])]
    rms = found["fit"]["identify"]["y"]
    assert rms["corrected"] < 0.1 * rms["calibrated"]


@pytest.mark.parametrize("delay", [1e300, np.inf, 200.0])
def test_a_delay_beyond_the_recording_leaves_the_first_value(delay):
    np.testing.assert_array_equal(delayed(np.arange(1.0, 101.0), delay, 1e-6), np.ones(100))


def test_a_lag_beyond_all_bounds_makes_no_error():
    with np.errstate(all="ignore"):
        assert lagged(np.arange(5.0), np.inf, 1.0).shape == (5,)


def test_a_singular_fit_takes_the_shortest_step_and_one_of_no_numbers_none():
    np.testing.assert_allclose(_solved(np.ones((2, 2)), np.array([2.0, 2.0])), [1.0, 1.0])
    np.testing.assert_array_equal(_solved(np.full((2, 2), np.inf), np.ones(2)), [0.0, 0.0])
    np.testing.assert_array_equal(tame(np.array([np.nan, np.inf, 1e200, 3.0])), [0.0, 0.0, 0.0, 3.0])


@pytest.mark.parametrize(("burst", "said"), [(slice(0, 100), "until 0.099 s"), (slice(9900, None), "from 9.9 s on")])
def test_a_burst_at_an_end_is_told_by_its_other_end(burst, said):
    signal = np.zeros((10_000, 1))
    signal[burst] = 1.0
    time = np.arange(10_000) * 1e-3
    energy = Energy.of(signal[:, 0])
    assert not Region.densest(energy, energy.beside(time)).whole
    assert locate(signal, time, {}, {}).time in (said, "all the time")


def test_windows_need_no_told_noise(tmp_path):
    """It is read off identify.csv, for those channels alone of which rig.toml says nothing."""
    rng = np.random.default_rng(2)
    u = np.repeat(rng.standard_normal(40), 5)
    columns = (60.0 * np.arange(200), u, 0.02 * np.arange(200) + 5e-3 * rng.standard_normal(200))
    untold = LAW_RIG.replace(", noise_rms = 1e-3", "").replace("predict", "window_s = 1200.0\npredict")
    rig = written(tmp_path, "law", LAW, untold, "t,u,y", columns)
    assert rig.channels["y"].noise == pytest.approx(5e-3, rel=0.15)
    assert rig.channels["u"].noise == 0.0
    told = written(tmp_path, "law", LAW, LAW_RIG.replace("predict", "window_s = 1200.0\npredict"), "t,u,y", columns)
    assert told.channels["y"].noise == 1e-3
    assert noise(np.full(50, 3.0)) == pytest.approx(3e-9)


# -- lengths -----------------------------------------------------------------------------------------------------------


def moving(samples: int, memory: float, noise: float = 0.0) -> np.ndarray:
    """A first-order autoregression that has half forgotten after `memory` samples, and white noise beside it."""
    rng = np.random.default_rng(3)
    out = lfilter([1.0], [1.0, -(0.5 ** (1 / memory))], rng.standard_normal(samples))
    return out + noise * np.std(out) * rng.standard_normal(samples)


@pytest.mark.parametrize("noise", [0.0, 0.5])
@pytest.mark.parametrize("length", [10, 100, 1000])
def test_the_memory_of_a_signal_is_found_under_noise(length, noise):
    found = np.median([memory(part) for part in moving(40 * 40 * length, length, noise).reshape(40, -1)])
    assert found == pytest.approx(length, rel=0.3)


def test_what_rests_or_is_noise_has_no_memory_that_counts():
    assert memory(np.full(100, 7.0)) == np.inf
    assert memory(np.random.default_rng(0).standard_normal(1000)) == np.inf


def test_a_length_in_samples_stays_where_the_signal_allows_it():
    assert [span(20, [m], (0.005, 0.1), 2) for m in (400, 10_000, 50, np.inf)] == [20, 50, 5, 20]
    assert span(20, [], (0.005, 0.1), 30) == 30


def test_a_rate_is_smoothed_alike_at_every_sample_time():
    """Twenty samples of a machine that is sampled well, fewer of one that is sampled coarsely or recorded shortly."""
    assert reach(moving(20_000, 400), SMOOTH) == 20
    assert reach(moving(20_000, 6), SMOOTH) < 6
    assert reach(np.sin(np.arange(40) / 20), SMOOTH) <= 40 // 8


def test_a_pendulum_that_goes_over_the_top_is_led_along_its_recording(tmp_path):
    """A fit of the whole run at once ends in another valley, where an effect that is not there would help."""
    rig = rigs.load(conceal("pendulum", 500048, tmp_path / "rig", kind="clean", under="louder"))
    found = diagnose(rig).as_dict()
    assert found["verdict"] == "consistent"
    assert found["fit"]["identify"]["theta"]["simulation"] > 1.0 > 0.01 > found["fit"]["identify"]["theta"]["corrected"]


@pytest.mark.parametrize("samples", [800, 8000])
@pytest.mark.parametrize("spoilt", ["", "noise", "much noise", "steps", "coarse steps"])
def test_a_rate_is_smoothed_as_far_as_it_gains(samples, spoilt):
    """Nearly as well as the best of all lengths, whatever the sensor and however fine the samples."""
    time = np.linspace(0.0, 10.0, samples)
    rate = 1.1 * np.cos(1.1 * time) + 0.9 * np.cos(6.0 * time)
    signal = np.sin(1.1 * time) + 0.15 * np.sin(6.0 * time)
    size = {"": 0.0, "noise": 3e-4, "much noise": 1e-2, "steps": 3e-3, "coarse steps": 3e-2}[spoilt]
    if "steps" in spoilt:
        signal = size * np.round(signal / size)
    else:
        signal = signal + size * np.random.default_rng(1).standard_normal(samples)

    def off(half: int, degree: int) -> float:
        slopes = savgol_filter(signal, 2 * half + 1, degree, deriv=1, delta=time[1])
        return float(np.sqrt(np.mean((slopes - rate) ** 2)))

    halves = np.unique(np.geomspace(2, samples // 8, 25).astype(int))
    best = min(off(half, degree) for half in halves for degree in (2, 3))
    assert off(*smoothing(signal)) < max(1.6 * best, 2e-3)
    assert off(*smoothing(signal)) <= 1.02 * off(10, 2)


def test_what_is_too_short_to_tell_is_hardly_smoothed():
    assert smoothing(np.arange(12.0) ** 2) == (2, 2)
