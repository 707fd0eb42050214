"""Regressors on differences and principal components of taps."""

import numpy as np
import pytest

from benchmarks.thesis.axes import KINDS, on_axes
from greygate.compiler.pipeline import compile_network
from greygate.compiler.quantize import Formats
from greygate.errors import InputError
from greygate.machines.benchmark_systems.plant import b1, b1_input
from greygate.models.families.blocks import nguyen_widrow
from greygate.models.families.regression import noe
from greygate.models.network import Port
from greygate.models.training.levenberg import narx_noe
from greygate.models.training.record import Record

U, Y = Port("u", scale=2.0), Port("y", scale=0.5, offset=0.1)


def record(seed: int = 0) -> Record:
    signal = b1_input(seed=seed)
    return Record({"u": signal}, {"y": b1(signal)})


def network(hidden: int = 4):
    return noe("b1", {U: (0, 1, 2)}, Y, (1, 2), (hidden,), seed=3, bypass=False)


@pytest.mark.parametrize("kind", KINDS)
def test_the_function_stays_as_it_was(kind):
    given, rec = network(), record()
    turned = on_axes(given, [rec], kind)
    np.testing.assert_allclose(turned.run(rec.inputs)["y"], given.run(rec.inputs)["y"], rtol=1e-9, atol=1e-12)


def test_axes_are_differences_of_each_signal_within_the_range_of_the_records():
    rec = record()
    axes = on_axes(network(), [rec], "differences").layers()["hidden1_axes"]
    rows = np.concatenate([axes.weights[f"u_z{d}"] for d in range(3)], axis=1)[:3]
    np.testing.assert_allclose(rows / rows[:, :1], [[1, 0, 0], [1, -1, 0], [1, -2, 1]], atol=1e-12)
    n = U.normalised(rec.inputs["u"])
    moved = rows[1, 0] * (n[2:] - n[1:-1]) + axes.bias[1]
    np.testing.assert_allclose([moved.min(), moved.max()], [-1, 1])


def on(network, rec: Record, before: dict):
    """Its free run on a record that goes on from these samples."""
    whole = {n: np.concatenate([before[n], v]) for n, v in rec.inputs.items()}
    return network.run(whole)["y"][4 + len(before["u"]) :]


def test_what_does_not_vary_is_left_out_and_changes_nothing():
    """A ramp has constant differences; an input that follows another has no axis of its own."""
    ramp = Record({"u": np.linspace(0, 1, 200)}, {"y": np.sin(np.linspace(0, 9, 200))})
    given = noe("ramp", {U: (0, 1, 4)}, Y, (1,), (4,), seed=1, bypass=False)
    turned = on_axes(given, ramp, "differences")
    assert turned.layers()["hidden1_axes"].size == 2  # u and y; the differences of u are constant, and 0
    begun = {"u": np.full(4, ramp.inputs["u"][0]) - ramp.inputs["u"][[4, 3, 2, 1]]}
    np.testing.assert_allclose(on(turned, ramp, begun), on(given, ramp, begun), atol=1e-9)
    u = record().inputs["u"]
    two = Record({"u": u, "w": 0.01 * u}, record().targets)
    given = noe("two", {U: (0, 1), Port("w", scale=3.0): (0,)}, Y, (1,), (4,), seed=1, bypass=False)
    turned = on_axes(given, two, "principal")
    assert turned.layers()["hidden1_axes"].size == 3
    np.testing.assert_allclose(turned.run(two.inputs)["y"][2:], given.run(two.inputs)["y"][2:], atol=1e-9)


def test_signals_of_several_elements_and_two_layers_have_axes_of_their_own():
    rec = record()
    both = Record(rec.inputs, {"y": np.stack([rec.targets["y"], rec.targets["y"] ** 2], axis=1)})
    given = noe("vector", {U: (0, 1)}, Port("y", size=2), (1, 2), (4, 3), seed=2, bypass=False)
    turned = on_axes(given, [both], "differences")
    axes = turned.layers()["hidden1_axes"]
    for element, column in ((2, 0), (4, 1)):  # of the axes: u has two, then each element of y
        read = np.array([axes.weights["y_z1"][element, column], axes.weights["y_z2"][element, column]])
        assert read[0] > 0 == read[1]
        assert axes.weights["y_z1"][element + 1, column] == -axes.weights["y_z2"][element + 1, column]
    np.testing.assert_allclose(turned.run(both.inputs)["y"], given.run(both.inputs)["y"], rtol=1e-8, atol=1e-10)
    with pytest.raises(InputError, match="hidden1"):
        on_axes(turned, [both])


def test_principal_axes_do_not_correlate_and_the_weak_ones_are_left_out():
    rec = record()
    axes = on_axes(network(), [rec], "principal").layers()["hidden1_axes"]
    u, y = U.normalised(rec.inputs["u"]), Y.normalised(rec.targets["y"])
    delays = {"u_z0": u[2:], "u_z1": u[1:-1], "u_z2": u[:-2], "y_z1": y[1:-1], "y_z2": y[:-2]}
    along = sum(axes.weights[p] @ v[None, :] for p, v in delays.items())
    seen = np.corrcoef(along)
    np.testing.assert_allclose(seen, np.eye(5), atol=1e-9)
    fewer = on_axes(network(), [rec], "principal", least=0.3).layers()["hidden1_axes"]
    assert 1 <= fewer.size < 5


def test_a_network_is_trained_from_them_and_leaves_the_axes():
    rec, other = record(), record(1)
    turned = nguyen_widrow(on_axes(network(8), [rec]), seed=0)
    fit = narx_noe(turned, [rec], narx_epochs=60, epochs=60)
    for name in ("hidden1_axes.u_z1", "hidden1_axes.bias"):
        np.testing.assert_array_equal(fit.network.parameters()[name], turned.parameters()[name])
    missed = fit.network.run(other.inputs)["y"] - other.targets["y"]
    assert np.sqrt(np.mean(missed**2)) < 0.02 * np.std(other.targets["y"])


def test_hardware_has_no_layer_of_axes():
    rec = record()
    compiled = compile_network(on_axes(network(), [rec]), {"a": rec}, Formats(16))
    assert not any(name.endswith("axes") for name in compiled.network.layers())


@pytest.mark.parametrize(
    ("kind", "layer", "samples", "named"),
    [("wavelets", "hidden1", 500, "differences or principal"), ("principal", "hidden9", 500, "hidden9"),
     ("principal", "hidden1", 6, "record longer"), ("differences", "hidden1", 1, "0 rows"),
     ("principal", "sum", 500, "no input and no output")],
)  # fmt: skip
def test_what_cannot_be_is_named(kind, layer, samples, named):
    whole = record()
    part = Record({"u": whole.inputs["u"][:samples]}, {"y": whole.targets["y"][:samples]})
    with pytest.raises(InputError, match=named):
        on_axes(network(), [part], kind, layer)


def test_a_signal_that_is_missing_is_named():
    with pytest.raises(InputError, match="signal u is missing; given: v"):
        on_axes(network(), Record({"v": np.zeros(50)}, {"y": np.zeros(50)}))
