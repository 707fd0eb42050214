"""Intervals hold the truth where a recording knows parameters only together."""

import re
from pathlib import Path

import numpy as np
import pytest
from small_plants import steps, write

from greygate.errors import InputError
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.effects import general
from greygate.mismatch.rig import load
from greygate.mismatch.undetermined import deviations

CART = """step = 5e-3
outputs = ["v"]
inputs = { u = "V" }
parameters = { mass = [1.0, "kg"], gain = [5.0, "N/V"], viscous = [8.0, "N s/m"] }
states = { v = { unit = "m/s" } }
equations.motion.v = { storage = "mass", motor = "gain * u", viscous = "-viscous * v" }
"""
SHEET = {"mass": 1.0, "gain": 5.0, "viscous": 8.0}


def independent(information: np.ndarray, weight: np.ndarray) -> np.ndarray:
    return np.sqrt(np.diag(np.linalg.inv(information + np.diag(weight))))


def found(information: np.ndarray, weight: np.ndarray) -> np.ndarray:
    return deviations(information, weight, independent(information, weight))


def test_numbers_known_to_their_sum_go_as_far_as_each_of_them_may():
    """Of n numbers whose differences are known, independent priors leave 1 / sqrt(n) of each; one cause leaves all."""
    n = 4
    differences = 1e8 * (np.eye(n) - np.ones((n, n)) / n)
    assert independent(differences, np.ones(n)) == pytest.approx(np.full(n, 0.5), rel=1e-3)
    assert found(differences, np.ones(n)) == pytest.approx(np.ones(n), rel=1e-3)


def test_the_best_known_of_them_holds_the_others():
    weight = np.array([1.0, 1.0, 25.0])  # the third is known five times better
    differences = 1e8 * (np.eye(3) - np.ones((3, 3)) / 3)
    assert found(differences, weight) == pytest.approx(np.full(3, 0.2), rel=1e-3)


def test_what_is_not_known_at_all_keeps_its_prior():
    assert found(np.diag([1e6, 0.0]), np.ones(2)) == pytest.approx([1e-3, 1.0], rel=1e-3)


def test_what_the_recording_determines_stays_as_it_is():
    information = np.array([[900.0, 300.0], [300.0, 400.0]])
    alone = independent(information, np.ones(2))
    assert deviations(information, np.ones(2), alone) is alone
    assert deviations(np.zeros((2, 2)), np.zeros(2), alone) is alone  # no priors: nothing can err together


def test_a_size_without_a_prior_goes_along():
    """What has no prior is known by its ratio to what has one: as uncertain as that, all at once."""
    n = 3
    differences = 1e8 * (np.eye(n) - np.ones((n, n)) / n)
    assert found(differences, np.array([1.0, 1.0, 0.0])) == pytest.approx(np.ones(n), rel=1e-3)


def cart(folder: Path, factor: float, seed: int) -> Path:
    """A cart all of whose parameters are off by one factor, which its speed cannot tell."""
    u, v, read = steps(seed, -1.5, 1.5, 25, 400), 0.0, []
    for volt in u.tolist():
        read.append(v)
        v = 5 / 8 * volt + (v - 5 / 8 * volt) * np.exp(-8.0 * 0.02)  # exact, over a sample
    noisy = np.array(read) + 1e-3 * np.random.default_rng(seed).standard_normal(400)
    channels = {"u": ("V", "input", None, u), "v": ("m/s", "output", 1e-3, noisy)}
    return write(folder, CART, {s: v / factor for s, v in SHEET.items()}, dict.fromkeys(SHEET, 0.3), channels, 0.02)


@pytest.mark.parametrize("factor", [0.78, pytest.param(1.0, marks=pytest.mark.nightly), 1.28])
def test_a_common_factor_that_no_motion_tells_is_in_every_interval(tmp_path, factor):
    parameters = diagnose(load(cart(tmp_path / "rig", factor, 3))).as_dict()["parameters"]
    for symbol, true in SHEET.items():
        low, high = parameters[symbol]["ci95"]
        assert low < true < high, symbol


DRAGGED = CART.replace('viscous = [8.0, "N s/m"]', 'viscous = [8.0, "N s/m"], drag = [0.0, "N s^2/m^2"]').replace(
    ' viscous = "-', ' drag = "-drag * v * abs(v)", viscous = "-'
)


def dragged(folder: Path, drag: float, known: str) -> Path:
    """A cart in air, whose drag the data sheet takes for nothing; known: what rig.toml says of that."""
    u, v, read = steps(5, -1.5, 1.5, 25, 400), 0.0, []
    for volt in u.tolist():
        read.append(v)
        for _ in range(40):
            half = v + 2.5e-4 * (5 * volt - 8 * v - drag * v * abs(v))
            v += 5e-4 * (5 * volt - 8 * half - drag * half * abs(half))
    noisy = np.array(read) + 1e-3 * np.random.default_rng(5).standard_normal(400)
    channels = {"u": ("V", "input", None, u), "v": ("m/s", "output", 1e-3, noisy)}
    write(folder, DRAGGED, {**SHEET, "drag": 0.0}, {"viscous": 0.1}, channels, 0.02)
    (folder / "rig.toml").write_text((folder / "rig.toml").read_text() + known)
    return folder


@pytest.mark.parametrize(
    ("drag", "verdict"), [(0.03, "consistent"), (0.6, "parameter_error"), (-0.6, "parameter_error")]
)
def test_a_value_of_0_has_an_uncertainty_in_its_unit(tmp_path, greygate, drag, verdict):
    folder = dragged(tmp_path / "rig", drag, "[plus_minus]\ndrag = 0.05\n")
    rig = load(folder)
    assert rig.uncertain()["drag"].reach == 0.05
    found = diagnose(rig).as_dict()
    low, high = found["parameters"]["drag"]["ci95"]
    assert (found["verdict"], low < drag < high) == (verdict, True)
    assert high - low < 0.05
    assert found["parameters"]["drag"].get("outside_tolerance", False) is (verdict == "parameter_error")
    if verdict == "consistent":
        assert "(data sheet 0 ± 0.05)" in greygate("diagnose", folder)[1]


@pytest.mark.parametrize(
    ("known", "problem"),
    [
        ("[plus_minus]\ndrag = -0.05\n", "plus_minus.drag -0.05 is too small; give 0 or more"),
        ("[plus_minus]\nslip = 0.05\n", "plus_minus.slip: is no entry of [parameters]; give its value there"),
        ("[plus_minus]\nviscous = 0.5\n", "plus_minus.viscous: has a tolerance, too; give one of both"),
        ("[recordings.identify.plus_minus]\nslip = 1.0\n", "recordings.identify.plus_minus.slip: is no entry"),
    ],
)
def test_an_uncertainty_is_refused_that_cannot_be(tmp_path, known, problem):
    with pytest.raises(InputError, match=re.escape(problem)):
        load(dragged(tmp_path / "rig", 0.0, known))


def test_a_tolerance_may_be_all_of_a_value(tmp_path):
    folder = cart(tmp_path / "rig", 1.0, 3)
    sheet = (folder / "rig.toml").read_text()
    (folder / "rig.toml").write_text(sheet.replace("mass = 0.3", "mass = 1.0"))
    low, high = diagnose(load(folder)).as_dict()["parameters"]["gain"]["ci95"]
    assert low < 5.0 < high


def test_one_recording_may_know_a_value_of_0_less_than_the_others(tmp_path):
    folder = dragged(tmp_path / "rig", 0.3, "[recordings.identify]\nplus_minus = { drag = 0.5 }\n")
    low, high = diagnose(load(folder)).as_dict()["recordings"]["identify"]["parameters"]["drag"]["ci95"]
    assert low < 0.3 < high


@pytest.mark.parametrize(("known", "offered"), [("", True), ("[plus_minus]\ndrag = 0.05\n", False)])
def test_a_term_that_may_be_nothing_is_not_offered_again_under_a_general_name(tmp_path, known, offered):
    rig = load(dragged(tmp_path / "rig", 0.0, known))
    assert ("square_damping" in general(rig, rig.to_explain())) is offered
