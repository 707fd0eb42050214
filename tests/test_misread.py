"""Columns in another unit than rig.toml says, and exchanged ones, are refused before anything is searched for."""

from pathlib import Path

import numpy as np
import pytest
from small_plants import steps, write

from greygate.errors import InputError
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.misread import check
from greygate.mismatch.rig import load
from greygate.mismatch.search import Hypothesis, Search

SWING = """step = 2e-3
outputs = ["phi"]
inputs = { torque = "N m" }
parameters = { inertia = [0.08, "kg m^2"], weight = [2.0, "N m"], drag = [0.02, "N m s/rad"] }
states = { phi = { unit = "rad", rate = "w" }, w = { unit = "rad/s" } }
[equations]
angle.phi = { speed = "w" }
swing.w = { storage = "inertia", weight = "-weight * sin(phi)", drag = "-drag * w", drive = "torque" }
"""
TANKS = """step = 0.5
outputs = ["upper", "lower"]
inputs = { q = "m^3/s" }
parameters = { area = [0.02, "m^2"], outlet = [1e-4, "m^(5/2)/s"] }
states = { upper = { unit = "m", initial = 0.2 }, lower = { unit = "m", initial = 0.1 } }
[equations]
first.upper = { storage = "area", inflow = "q", outflow = "-outlet * sqrt(max(upper, 0))" }
[equations.second.lower]
storage = "2 * area"
inflow = "outlet * sqrt(max(upper, 0))"
outflow = "-outlet * sqrt(max(lower, 0))"
"""


def swing(folder: Path, unit: float = 1.0, exchanged: bool = False, noise: float | None = None, dry: float = 0.0):
    """A pendulum whose angle stands in another unit: so many rad are 1 of it."""
    torque = steps(1, -0.6, 0.6, 40, 600)
    phi, w, found = 0.0, 0.0, []
    for u in torque.tolist():
        found.append(phi)
        for _ in range(20):
            phi, w = phi + 1e-3 * w, w + 1e-3 * (u - 2.05 * np.sin(phi) - 0.022 * w - dry * np.tanh(w / 0.01)) / 0.08
    read = np.array(found) + 5e-4 * np.random.default_rng(2).standard_normal(600)
    given = {"torque": torque, "phi": read / unit}
    if exchanged:
        given = {"torque": given["phi"], "phi": torque}
    channels = {"torque": ("N m", "input", None, given["torque"]), "phi": ("rad", "output", noise, given["phi"])}
    sheet = {"inertia": 0.08, "weight": 2.0, "drag": 0.02}
    return write(folder, SWING, sheet, {"weight": 0.05, "drag": 0.3}, channels, 0.02)


def tanks(folder: Path, exchanged: bool = False) -> Path:
    q = steps(3, 2e-5, 6e-5, 30, 500)
    level, found = np.array([0.2, 0.1]), []
    for inflow in q.tolist():
        found.append(level)
        for _ in range(20):
            out = 1.02e-4 * np.sqrt(np.maximum(level, 0.0))
            level = level + 0.1 * np.array([inflow - out[0], (out[0] - out[1]) / 2]) / 0.02
    read = np.array(found).T + 5e-4 * np.random.default_rng(4).standard_normal((2, 500))
    upper, lower = read[::-1] if exchanged else read
    channels = {
        "q": ("m^3/s", "input", None, q),
        "upper": ("m", "output", 5e-4, upper),
        "lower": ("m", "output", 5e-4, lower),
    }
    return write(folder, TANKS, {"area": 0.02, "outlet": 1e-4}, {"area": 0.05, "outlet": 0.1}, channels, 2.0)


ROOM = """step = 1.0
outputs = ["T"]
inputs = { heat = "W" }
parameters = { capacity = [500.0, "J/K"], loss = [2.0, "W/K"], room = [293.0, "K"] }
states = { T = { unit = "K", initial = 293.0 } }
[equations]
warm.T = { storage = "capacity", heat = "heat", loss = "-loss * (T - room)" }
"""


def room(folder: Path, below: float) -> Path:
    """A body that is heated, whose sensor reads so many K below what it is."""
    heat, warm, found = steps(5, 0.0, 60.0, 40, 500), 293.0, []
    for power in heat.tolist():
        found.append(warm)
        for _ in range(10):
            warm += 0.5 * (power - 2.06 * (warm - 293.0)) / 500.0
    read = np.array(found) - below + 0.02 * np.random.default_rng(6).standard_normal(500)
    channels = {"heat": ("W", "input", None, heat), "T": ("K", "output", 0.02, read)}
    return write(folder, ROOM, {"capacity": 500.0, "loss": 2.0, "room": 293.0}, {"loss": 0.1}, channels, 5.0)


def test_degrees_celsius_are_no_offset_of_a_sensor(tmp_path):
    with pytest.raises(InputError, match="T seems to be in degC, not in K: then the simulation errs by"):
        diagnose(load(room(tmp_path / "rig", 273.15)))
    named = diagnose(load(room(tmp_path / "other", 5.0))).as_dict()
    assert [effect["id"] for effect in named["effects"]] == ["sensor_offset"]


@pytest.mark.parametrize("noise", [None, 5e-4])
def test_an_angle_in_degrees_is_refused_with_its_unit(tmp_path, noise):
    folder = swing(tmp_path / "rig", np.pi / 180, noise=noise)
    with pytest.raises(InputError, match=r"identify.csv: phi seems to be in deg, not in rad: .*; convert it"):
        diagnose(load(folder))


def test_what_is_missing_beside_it_hides_no_degrees(tmp_path):
    with pytest.raises(InputError, match="phi seems to be in deg"):
        diagnose(load(swing(tmp_path / "rig", np.pi / 180, dry=0.02)))


def test_exchanged_columns_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"columns torque and phi seem to be exchanged: .*exchange their names"):
        diagnose(load(swing(tmp_path / "one", exchanged=True)))
    with pytest.raises(InputError, match="columns upper and lower seem to be exchanged"):
        diagnose(load(tanks(tmp_path / "two", exchanged=True)))


def test_one_of_several_recordings_is_enough_to_tell(tmp_path):
    folder = swing(tmp_path / "rig", np.pi / 180)
    (folder / "again.csv").write_bytes((folder / "identify.csv").read_bytes())
    sheet = (folder / "rig.toml").read_text()
    own = "\n[recordings.again]\ntolerance = { drag = 0.3 }\n"
    (folder / "rig.toml").write_text('identify = ["identify.csv", "again.csv"]\n' + sheet + own)
    with pytest.raises(InputError, match="phi seems to be in deg"):
        diagnose(load(folder))


@pytest.mark.parametrize("dry", [0.0, 0.3])
def test_columns_as_rig_toml_says_pass_whatever_is_missing(tmp_path, dry):
    rig = load(swing(tmp_path / "rig", dry=dry))
    search = Search(rig, rig.to_explain(), {})
    check(search, search.final.fit(search.unknowns(Hypothesis()), iterations=0))
