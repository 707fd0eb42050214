"""Each entry of `models.activations` says what is true, in every arithmetic that reads it."""

import hashlib
import math
import re
from pathlib import Path

import numba
import numpy as np
import pytest
import torch

from greygate.compiler.pipeline import compile_network, strain
from greygate.compiler.quantize import Formats
from greygate.compiler.tables import make_table
from greygate.emulator.engine import run
from greygate.emulator.numbers import Fix
from greygate.hardware.verify import Case, Scenario, verify_many
from greygate.models import activations, arithmetic, scalars
from greygate.models.accuracy import free_run_rms
from greygate.models.activations import ACTIVATIONS
from greygate.models.families.regression import noe
from greygate.models.network import Layer, Network, Port
from greygate.models.training import kernels
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record

N = np.array([-40.0, -3.0, -1.0, -0.3, -1e-3, 0.0, 1e-3, 0.3, 1.0, 3.0, 40.0, 0.5])
ONE_ROW = [name for name, a in ACTIVATIONS.items() if a.rows == 1]
TABLES = [name for name, a in ACTIVATIONS.items() if a.lowered == "table"]


def layer_run(name: str, n: np.ndarray) -> np.ndarray:
    """What the training's kernel makes of pre-activations."""
    network = Network("one", [Port("n")], [Port("y")])
    network.add("f", Layer({"n": [[1.0]]}, [0.0], name))
    network.connect("n", "f.n")
    network.connect("f", "y")
    t, _ = kernels.tabulate(network.flatten())
    now = np.zeros((len(n), 2))
    now[:, 0] = n
    kernels.forward(t.layers, t.links, t.n_inputs, 0, np.array([1.0, 0.0]), now, now.copy(), np.zeros(2, bool))
    return now[:, 1]


@pytest.mark.parametrize("name", ONE_ROW)
def test_numpy_torch_portable_arithmetic_and_kernels_agree(name):
    a = ACTIVATIONS[name]
    want = a.value(np, N)
    np.testing.assert_allclose(a.value(torch, torch.tensor(N)).numpy(), want, rtol=1e-15, atol=1e-15)
    np.testing.assert_allclose(a.value(arithmetic.xp, N), want, rtol=1e-15, atol=1e-15)
    np.testing.assert_array_equal(layer_run(name, N), a.value(arithmetic.xp, N))


@pytest.mark.parametrize("name", ONE_ROW)
def test_a_slope_is_the_derivative_of_the_value(name):
    a = ACTIVATIONS[name]
    n = N[~np.isin(N, (-1.0, 0.0, 1.0))]  # where some bend
    at = torch.tensor(n, requires_grad=True)
    y = a.value(torch, at)
    want = np.zeros(len(n))
    if y.requires_grad:
        (want,) = torch.autograd.grad(y.sum(), at)
    for x, v, slope in zip(n, y.tolist(), want, strict=True):
        args = (np, v, x) if a.slope_reads_n else (np, v)
        assert a.slope(*args) == pytest.approx(float(slope), rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("name", ONE_ROW)
def test_image_symmetry_and_monotony_are_as_stated(name):
    a = ACTIVATIONS[name]
    n = np.arange(-5000, 5001) / 100
    y = a.value(np, n)
    assert a.image[0] <= y.min()
    assert y.max() <= a.image[1]
    if a.is_bounded:
        assert max(map(abs, a.image)) <= 1  # what the formats of the compiler hold
    mirrored = {"odd": -y, "even": y, "complement": 1 - y, None: y[::-1]}[a.symmetry]
    np.testing.assert_allclose(y[::-1], mirrored, rtol=0, atol=1e-15)
    steps = np.diff(y if a.symmetry != "even" else y[n >= 0])
    if a.periodic:
        np.testing.assert_allclose(y[200:], y[:-200], rtol=0, atol=1e-13)
        return
    assert (steps >= 0).all() or (a.symmetry == "even" and (steps <= 0).all())


@pytest.mark.parametrize("name", TABLES)
def test_a_table_may_end_where_its_function_is_flat_or_too_large(name):
    a, decades, most = ACTIVATIONS[name], 12 * math.log(2), 16.0
    end = a.flat_from(decades, most)
    y = a.value(np, np.array([end, 2 * end, 1e3 * end]))
    if a.periodic:
        assert make_table(name, Fix(12, 11), Fix(12, 11)).worst_error < 2.0**-10  # over all of a turn
    elif a.is_bounded:
        limit = a.value(np, np.array(1e300)) if a.symmetry != "even" else 0.0
        assert (np.abs(y - limit) <= 1.001 * math.exp(-decades)).all()
    else:
        assert (y >= most).all() or (y <= 1.001 * math.exp(-decades)).all()


def test_a_kind_that_no_entry_has_is_an_error():
    values = numba.njit(lambda kind, n: kernels._values(kind, n.reshape(1, 1), 0, 0, 1))
    slopes = numba.njit(lambda kind, n: kernels._slopes(kind, n, n, n))
    for function in (values, slopes):
        with pytest.raises(ValueError, match="no such kind"):
            function(len(ACTIVATIONS), np.zeros(1))


def test_compiled_kernels_are_kept_under_a_name_that_changes_with_the_entries():
    text = b"".join(Path(module.__file__).read_bytes() for module in (activations, scalars, kernels))
    for function in (kernels.forward, kernels.sensitivities):
        assert function.py_func.__qualname__.endswith(hashlib.sha256(text).hexdigest()[:12])


def test_half_of_an_activation_can_only_be_kept_where_it_tells_the_other_half():
    line = {"value": lambda xp, n: n, "slope": lambda xp, y: y, "image": (-1.0, 1.0)}
    with pytest.raises(ValueError, match="needs `symmetry` and `flat_from`"):
        activations.Activation(**line, lowered="table")
    clamp = activations.Activation(**line, lowered="clamp", symmetry="odd")
    assert not clamp.is_sigmoid


def test_the_documentation_lists_every_activation():
    page = (Path(__file__).parents[1] / "docs" / "network.md").read_text()
    (row,) = re.findall(r"^\| `transferFcn` \|.*$", page, re.MULTILINE)
    assert " ".join(re.findall(r"`([a-z ]+)`", row)).split() == list(ACTIVATIONS)


def test_a_network_of_softsigns_is_trained_compiled_and_verified(tmp_path):
    """It stands for any entry: nothing but its row in the table knows of it."""
    rng = np.random.default_rng(0)
    u = np.cumsum(rng.normal(size=400)) / 10
    y = np.zeros(400)
    for k in range(1, 400):
        y[k] = 0.8 * y[k - 1] + 0.2 * np.tanh(2 * u[k])
    inputs = {Port("u", scale=float(np.abs(u).max())): (0, 1)}
    start = noe("softsigns", inputs, Port("y"), (1,), (4,), seed=1, activation="softsign")
    record = Record({"u": u}, {"y": y})
    network = train(start, [record], epochs=30).network
    compiled = compile_network(network, {"walk": record}, Formats(14))
    program = compiled.program
    assert {t.function for t in program.tables} == {"softsign"}
    assert free_run_rms(network, record)["y"] < 0.1 * free_run_rms(start, record)["y"]
    assert strain(program, compiled.network, [record]) < 1.1
    codes = program.encode({"u": u[:60]})
    answer = run(program, codes)
    case = Case(program, {"walk": Scenario(codes, answer.outputs, answer.states)}, "parallel")
    assert [v.mismatch for v in verify_many([case], tmp_path, seed=1).verdicts] == [None]
