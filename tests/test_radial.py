import numpy as np
import pytest
import torch

from benchmarks.descent import _Swept
from greygate.compiler.pipeline import compile_network, fixed_error
from greygate.compiler.quantize import Formats
from greygate.errors import InputError
from greygate.machines.benchmark_systems.plant import b1, b1_input
from greygate.models.accuracy import float_error
from greygate.models.families.radial import VARIANCE, radial, rbf, recursive_least_squares
from greygate.models.network import Port
from greygate.models.training.levenberg import train
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record

U, Y = Port("u", scale=2.0, offset=0.5), Port("y", scale=0.5, initial=0.2)
TAPS = {U: (0, 2)}, Y, (1,)


def benchmark(seed=0):
    u = b1_input(seed)
    return Record({"u": u}, {"y": b1(u)})


def identified(neurons=20, **options):
    return rbf([benchmark()], {Port("u"): (1,)}, Port("y"), (1, 2), neurons, **options)


def test_a_radial_network_is_gaussians_of_distance():
    rng = np.random.default_rng(0)
    centres, widths = rng.uniform(-1, 1, (4, 3)), rng.uniform(0.5, 2, (4, 3))
    network = radial("r", *TAPS, centres, widths)
    weights, bias = rng.normal(size=(1, 4)), rng.normal(size=1)
    network = network.with_parameters({"sum.kernels": weights, "sum.bias": bias})
    u = rng.normal(size=30)
    inside, past, want = np.r_[-0.25, -0.25, (u - 0.5) / 2], 0.4, []
    for k in range(2, 32):
        phi = np.array([inside[k], inside[k - 2], past])
        past = weights[0] @ np.exp(-(((phi - centres) / widths) ** 2).sum(1)) + bias[0]
        want.append(0.5 * past)
    np.testing.assert_allclose(network.run({"u": u})["y"], want, rtol=1e-12)


@pytest.mark.nightly
def test_derivatives_of_a_radial_network_in_a_loop_are_those_of_torch():
    rng = np.random.default_rng(1)
    network = radial("r", *TAPS, rng.uniform(-1, 1, (4, 3)), 1.5).with_parameters(
        {"sum.kernels": rng.normal(size=(1, 4))}
    )
    u, y = rng.normal(size=(2, 20))
    records = [Record({"u": u}, {"y": y})]
    objective = Objective(network, records)
    objective.squares(objective.theta)
    _, gradient = objective.normal_equations(objective.theta)
    swept = _Swept(network, records)
    swept.squares(swept.theta)
    tensors = {n: torch.tensor(v, requires_grad=True) for n, v in objective.flat.parameters().items()}
    run = objective.flat.run({"u": u}, parameters=tensors)["y"]
    (0.5 * (((run - torch.tensor(y)) / 0.5) ** 2).sum()).backward()
    want = np.concatenate([tensors[n].grad.numpy().ravel() for n in objective.slices()])[objective.free]
    np.testing.assert_allclose(gradient, want, rtol=1e-8, atol=1e-10 * np.abs(want).max())
    sweep = swept.gradient(swept.theta)[objective.free]
    np.testing.assert_allclose(sweep, want, rtol=1e-8, atol=1e-10 * np.abs(want).max())


def loss(network, record):
    """One step ahead, of the rows with all taps."""
    objective = Objective(network, [Record(record.inputs, record.targets, skip=2)], teacher=True)
    return objective.squares(objective.theta) / (2 * objective.samples)


def test_output_weights_of_the_whole_record_are_the_least_squares_ones():
    network = identified()
    objective = Objective(network, [Record(benchmark().inputs, benchmark().targets, skip=2)], teacher=True)
    elements = objective.elements()
    kernels = objective.simulate(objective.theta)[0][2:, elements["kernels"]]
    y = benchmark().targets["y"][2:]
    best = np.linalg.lstsq(np.column_stack([kernels, np.ones(len(y))]), y, rcond=None)[1][0]
    assert objective.squares(objective.theta) == pytest.approx(best, rel=1e-3)  # weights that start with variance 1e8


def test_more_neurons_fit_better_and_training_goes_on_from_there():
    few, many = (identified(neurons) for neurons in (5, 40))
    assert loss(many, benchmark()) < 0.1 * loss(few, benchmark())
    held = Objective(many, [benchmark(1)], teacher=True)
    assert held.squares(held.theta) / held.samples < 0.02 * np.var(benchmark(1).targets["y"])
    narx = train(few, [benchmark()], teacher=True, epochs=30)
    assert narx.history[-1] < 0.1 * loss(few, benchmark())
    assert np.isfinite(train(narx.network, [benchmark()], epochs=5).history[-1])


def test_the_same_seed_gives_the_same_centres():
    one, other, again = (identified(seed=seed).parameters()["kernels.bias"] for seed in (1, 2, 1))
    assert not np.array_equal(one, other)
    np.testing.assert_array_equal(one, again)


def test_one_neuron_is_enough_for_a_constant():
    record = Record({"u": np.linspace(-1, 1, 50)}, {"y": np.full(50, 3.0)})
    network = rbf([record], {Port("u"): (0,)}, Port("y"), (), 1)
    np.testing.assert_allclose(network.run(record.inputs)["y"], 3.0, atol=1e-6)


def test_recursive_least_squares_are_batch_least_squares_with_the_weights_held_near_zero():
    rng = np.random.default_rng(2)
    phi, y = rng.normal(size=(60, 4)), rng.normal(size=60)
    want = np.linalg.solve(phi.T @ phi + np.eye(4) / VARIANCE, phi.T @ y)
    np.testing.assert_allclose(recursive_least_squares(phi, y), want, rtol=1e-9, atol=1e-11)


def test_what_cannot_be_is_refused():
    with pytest.raises(InputError, match=r"centres \(2, 2\) for 3 taps"):
        radial("r", *TAPS, np.zeros((2, 2)), 1.0)
    with pytest.raises(InputError, match="widths must be positive"):
        radial("r", *TAPS, np.zeros((2, 3)), 0.0)
    with pytest.raises(InputError, match="the output's own at 1"):
        radial("r", {U: (0,)}, Y, (0,), np.zeros((2, 2)), 1.0)
    with pytest.raises(InputError, match="600 neurons for fewer rows"):
        identified(600)
    with pytest.raises(InputError, match="3 neurons for fewer rows that differ"):
        rbf([Record({"u": np.ones(9)}, {"y": np.arange(9.0)})], {Port("u"): (0,)}, Port("y"), (), 3)


@pytest.fixture(scope="module")
def compiled():
    network = train(identified(8), [benchmark()], teacher=True, epochs=20).network
    return compile_network(network, {"training": benchmark()}, Formats(16))


def test_sixteen_bits_cost_a_radial_network_little(compiled):
    true, fixed = float_error(compiled.network, benchmark())["y"], fixed_error(compiled.program, benchmark())["y"]
    assert np.std(fixed - true) < 0.2 * np.std(true)


def test_its_squares_and_gaussians_are_tables_within_their_budget(compiled):
    tables = {t.function: t for t in compiled.program.tables}
    assert tables.keys() == {"square", "negexp"}
    assert all(t.worst_error <= 1.25 * t.out.lsb and len(t.points) <= 1025 for t in tables.values())
