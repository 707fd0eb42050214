"""The pump-controlled cylinder's SRNN: it forgets its start, and holds 50,000 steps without a pressure sensor."""

import json

import numpy as np
import pytest

from benchmarks.pump_cylinder import black_box, narx
from greygate.machines.catalog import entry
from greygate.machines.pump_cylinder.network import leakage_bounds
from greygate.machines.pump_cylinder.study import assemble, recording
from greygate.models.accuracy import free_run_rms
from greygate.models.storage import TRAINED
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record


def worst(network):
    """Parameters at the bound where the chambers drain least."""
    return network.with_parameters({n: np.array([[high]]) for n, (_, high) in leakage_bounds(network).items()})


def spread(network, inputs, start):
    """Largest difference of the pressures of two runs, one of which starts at 4 and 8 MPa, at every step."""
    before = {n: v[0] for n, v in inputs.items()}
    runs = [
        network.run(inputs, before | {f"p{c}.state": v / 2e7 for c, v in at.items()})
        for at in (start, {"a": 4e6, "b": 8e6})
    ]
    return np.max([np.abs(runs[0][p] - runs[1][p]) for p in ("p_a", "p_b")], axis=0)


@pytest.mark.parametrize("start", [{"a": 6e6, "b": 8e6}, {"a": 4e6, "b": 6e6}, {"a": 6e6, "b": 6e6}])
@pytest.mark.parametrize("build", [assemble, lambda: worst(assemble()), lambda: entry("pump_cylinder").network()])
def test_no_error_of_a_pressure_grows_in_any_step(build, start):
    inputs = recording("rig_chirp").cut(40_000, 40_400).inputs
    apart = spread(build(), inputs, start)
    assert (np.diff(apart) <= 1e-6).all()
    assert apart[-1] < apart[0]


def test_the_divider_rises_with_its_first_input_wherever_the_piston_can_be():
    gamma = np.repeat(np.linspace(-0.75, 0.75, 61), 121)
    omega = np.tile(np.linspace(-1, 1, 121), 61)
    divider = assemble().modules["pa"].modules["divider"]
    y = divider.run({"omega": omega[:, None], "gamma": gamma[:, None]})["y"].reshape(61, 121)
    slope = np.diff(y, axis=1) * 60
    assert slope.min() > 0
    network = assemble()
    for chamber in "ab":  # and no step drains more than is there, at ten times the nominal leakage
        rate = network.parameters()[f"p{chamber}.state.rate"].item() * 5.0
        drained = -sum(low for n, (low, _) in leakage_bounds(network).items() if n.startswith(f"q{chamber}."))
        assert rate * slope.max() * drained < 1


def test_the_stored_network_keeps_its_bounds_and_its_figure_on_50000_steps_without_a_pressure_sensor():
    network = entry("pump_cylinder").network()
    assert [p.name for p in network.inputs] == ["n_1", "n_2", "x"]
    for name, (low, high) in leakage_bounds(assemble()).items():
        assert low <= network.parameters()[name].item() <= high
    found = free_run_rms(network, recording("rig_chirp"))
    assert len(recording("rig_chirp")) == 50_000
    assert max(found.values()) < 0.2e6
    kept = json.loads((TRAINED / "pump_cylinder.json").read_text())["adapted"]["rig_chirp"]
    assert list(found.values()) == pytest.approx(kept, rel=1e-6)


def test_a_chamber_with_a_sensor_is_an_input_and_the_other_one_alone_is_predicted():
    network = assemble(known="b")
    assert [p.name for p in network.inputs] == ["n_1", "n_2", "x", "p_b_measured"]
    assert [p.name for p in network.outputs] == ["p_a"]
    assert free_run_rms(network, recording("chirp", "b").cut(0, 5000))["p_a"] < 0.2e6


def test_training_lowers_the_error_on_the_rig_and_keeps_the_bounds():
    network = assemble()
    record: Record = recording("rig_choice").cut(0, 4000)
    bounds = leakage_bounds(network)
    fit = train(network, [record], epochs=3, bounds=bounds)
    assert fit.history[-1] < 0.2 * fit.history[0]
    assert all(low <= fit.network.parameters()[n].item() <= high for n, (low, high) in bounds.items())


def test_a_black_box_of_table_6_2_learns_one_step_ahead_from_the_same_signals():
    record = black_box("training").cut(0, 2000)
    assert set(record.inputs) == {"n_1", "n_2", "x", "v"}
    fit = train(narx(2, 5), [record], teacher=True, epochs=15)
    assert np.sqrt(2 * fit.history[-1]) * 2e7 < 0.1e6
