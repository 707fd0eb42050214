"""The noise that a recording shows: its size and its memory, beside whatever the plant leaves out."""

import shutil

import numpy as np
import pytest
from scipy.signal import lfilter

from greygate.mismatch.concealed.conceal import conceal
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.noise import Noise, learnt
from greygate.mismatch.rig import load
from greygate.plants.table import read_table


def coloured(ar, samples, seed=0):
    """An autoregression of unit innovations (samples,), long after its beginning."""
    white = np.random.default_rng(seed).standard_normal(samples + 1000)
    return lfilter([1.0], np.concatenate(([1.0], -np.array(ar))), white)[1000:]


@pytest.mark.parametrize("ar", [(), (0.9,), (0.5, -0.3), (1.2, -0.5)])
def test_size_and_memory_are_found_beside_what_the_plant_leaves_out(ar):
    samples, stretch = 20_000, 100
    noise = 3.0 * coloured(ar, samples)
    left_out = 200.0 * np.concatenate([np.polyval(c, np.linspace(-1, 1, stretch)) for c in np.eye(4)[[0, 1] * 100]])
    found = learnt((noise + left_out)[:, None], stretch)
    assert found.scale[0] == pytest.approx(3.0, rel=0.03)
    assert len(found.ar[0]) == len(ar)
    assert found.ar[0] == pytest.approx(np.array(ar), abs=0.03)
    assert found.size[0] == pytest.approx(np.std(noise), rel=0.1)


def test_innovations_are_white_from_the_first_sample_of_a_stretch_on():
    ar, stretches = np.array([0.5, -0.3, 0.6]), 40_000
    noise = np.stack([coloured(ar, 8, seed) for seed in range(2000)] * (stretches // 2000)).reshape(-1, 1)
    white = Noise(np.array([2.0]), (ar,)).white(2.0 * noise, 8).reshape(stretches, 8)
    assert white.T @ white / stretches == pytest.approx(np.eye(8), abs=0.1)


def test_noise_as_it_is_told_changes_no_bit():
    errors = np.random.default_rng(0).standard_normal((50, 2, 3))
    assert Noise.told(2).white(errors, 10) is errors


@pytest.mark.parametrize(
    ("noise", "told"),
    [((1.1, ()), True), ((3.0, ()), False), ((0.5, ()), False), ((1.0, (0.05,)), True), ((1.0, (0.5,)), False)],
)
def test_noise_is_as_told_if_its_size_and_its_colour_are(noise, told):
    scale, ar = noise
    assert Noise(np.array([scale]), (np.array(ar),)).as_told is told


@pytest.mark.parametrize(
    ("scale", "ar", "swollen"),
    [(10.0, (), False), (1.0, (0.9,), False), (1.0, (0.98,), True), (0.1, (0.98,), False), (0.4, (0.9,), False)],
)
def test_a_noise_far_larger_than_told_and_slow_is_no_sensors(scale, ar, swollen):
    assert Noise(np.array([scale]), (np.array(ar),)).swollen is swollen


def test_a_short_stretch_tells_nothing():
    assert learnt(np.random.default_rng(0).standard_normal((60, 2)) * 9, 6).as_told


@pytest.fixture(scope="module")
def quiet(tmp_path_factory):
    """Folders of a clean rig and of one with an effect, their noise as told."""
    folder = tmp_path_factory.mktemp("quiet")
    conceal("cable_drum", 11, folder / "clean", kind="clean")
    conceal("cable_drum", 13, folder / "one", kind="one", effect="rest_relaxation")
    return folder


@pytest.mark.parametrize(("case", "verdict"), [("clean", "consistent"), ("one", "missing_physics")])
@pytest.mark.parametrize(("ar", "size"), [((), 10.0), ((0.9,), 2.0)])
def test_noise_that_is_told_wrong_is_found_and_neither_makes_a_claim_nor_hides_one(
    case, verdict, ar, size, quiet, tmp_path
):
    shutil.copy(quiet / case / "rig.toml", tmp_path)
    rig, table = load(tmp_path), read_table(quiet / case / "identify.csv")
    told = rig.channels["x_load"].sigma
    added = size * told * coloured(ar, len(table.values))
    values = table.values.copy()
    values[:, table.header.index("x_load")] += added
    np.savetxt(tmp_path / "identify.csv", values, delimiter=",", header=",".join(table.header), comments="", fmt="%.9g")
    found = diagnose(load(tmp_path)).as_dict()
    assert found["verdict"] == verdict
    assert [e["id"] for e in found["effects"]] == (["rest_relaxation"] if case == "one" else [])
    shown = found["noise"]["x_load"]
    assert shown["found"] == pytest.approx(np.hypot(np.std(added), told), rel=0.2)
    assert (shown["memory"] > 0) is bool(ar)
