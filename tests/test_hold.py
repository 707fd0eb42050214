"""An input that was measured goes straight from one sample to the next; one that was set keeps its value."""

import numpy as np
import pytest
from small_plants import write

from greygate.errors import InputError
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.model import Model
from greygate.mismatch.rig import load

WALL = """step = {step}
outputs = ["inside", "loss"]
inputs = {{ outside = "K" }}
states = {{ inside = {{ unit = "K", initial = 290.0 }} }}
parameters = {{ lag = [7200.0, "s"], u = [2.0, "W/K"] }}
definitions.wall = {{ loss = {{ unit = "W", through = "u * (inside - outside)" }} }}
equations.room.inside = {{ storage = "lag", wall = "outside - inside" }}
"""
DT, SAMPLES = 1800.0, 300


def weather(t: np.ndarray) -> np.ndarray:
    return 285.0 + 6.0 * np.sin(2 * np.pi * t / 86400.0) + np.sin(2 * np.pi * t / 50000.0)


def wall(folder, hold: str = "linear", step: float = 90.0):
    """A room behind a wall, half an hour a sample, in weather that knows of no samples."""
    t, fine = DT * np.arange(SAMPLES), DT / 200
    inside, found = 290.0, []
    for k in range(SAMPLES * 200):
        found += [inside] if k % 200 == 0 else []
        inside += fine / 7200.0 * (weather(np.array((k + 0.5) * fine)) - inside)
    noise = 0.05 * np.random.default_rng(1).standard_normal(SAMPLES)
    channels = {
        "outside": ("K", "input", None, weather(t)),
        "inside": ("K", "output", 0.05, np.array(found) + noise),
        "loss": ("W", "output", 0.1, 2.0 * (np.array(found) - weather(t)) + 2 * noise[::-1]),
    }
    write(folder, WALL.format(step=step), {"lag": 7200.0, "u": 2.0}, {"lag": 0.05, "u": 0.05}, channels, DT)
    sheet = folder / "rig.toml"
    sheet.write_text(sheet.read_text().replace('role = "input"\n', f'role = "input"\nhold = "{hold}"\n'))
    return load(folder)


def missed(rig) -> np.ndarray:
    model = Model(rig, rig.to_explain(), {})
    return np.sqrt(np.mean((model.target - model.predict(model.values)) ** 2, axis=0))


@pytest.mark.parametrize("step", [90.0, 1800.0])
def test_a_measured_input_acts_between_its_samples(tmp_path, step):
    assert missed(wall(tmp_path / "linear", step=step)) == pytest.approx([0.05, 0.1], rel=0.15)
    held = missed(wall(tmp_path / "step", "step", step))
    assert (held > [0.15, 0.3]).all()  # half a sample late


def test_a_held_measurement_is_no_late_channel(tmp_path):
    found = diagnose(wall(tmp_path / "rig")).as_dict()
    assert found["verdict"] == "consistent"


def test_filters_act_on_it_between_its_samples(tmp_path):
    """A delay of one whole sample gives the sample before, in the plant and in what is read beside it."""
    rig = wall(tmp_path / "rig")
    model = Model(rig, rig.to_explain(), {})
    late = model._over_parts("outside", weather(DT * np.arange(-1, SAMPLES - 1)))
    np.testing.assert_allclose(model._sampled("outside", late), weather(DT * np.arange(-1, SAMPLES - 1)), rtol=1e-12)
    driven = model.driven("outside", np.full(SAMPLES, 290.0))
    assert np.ptp(driven.predict(driven.values)[:, 0]) == pytest.approx(0.0, abs=1e-9)


def test_only_inputs_are_held(tmp_path):
    wall(tmp_path / "rig")
    sheet = tmp_path / "rig" / "rig.toml"
    text = sheet.read_text()
    sheet.write_text(text.replace('role = "output"\n', 'role = "output"\nhold = "linear"\n', 1))
    with pytest.raises(InputError, match=r"channels.inside.hold: is of an input; drop it here"):
        load(tmp_path / "rig")
    sheet.write_text(text.replace('hold = "linear"', 'hold = "cubic"'))
    with pytest.raises(InputError, match="hold 'cubic'"):
        load(tmp_path / "rig")
