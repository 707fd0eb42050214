"""Networks of PyTorch answer as PyTorch, whatever the options, or are refused in a line.

A few cases of the whole table (benchmarks/torch_options.py), all that a step keeps, and wrong uses.
"""

import random
import threading

import numpy as np
import pytest
import torch
from torch import nn
from torch_cases import On, cases, tried

from greygate.compiler.pipeline import compile_network, fixed_error
from greygate.compiler.quantize import Formats
from greygate.errors import InputError
from greygate.models.importers.pytorch import from_torch
from greygate.models.training.record import Record

EVERY = {"activations": 61, "norms": 41, "sequences": 211, "cells": 17, "layers": 37, "functions": 127}
"""Of so many cases one is tried here; the benchmark tries all."""
DRAWN = [case for group, n in EVERY.items() for case in [c for c in cases() if c.group == group][::n]]
PLAIN = "bias=True, batch_first=False, dropout=0.0, bidirectional=False"
RIGHT = {  # cases of which some were silently wrong, or a traceback: now they are carried
    "view += 1", "view *= x", "y[2] = x[0]", "T.add_", "swap", "x[0] = 1", "matmul (2, 1, 3) (2, 3, 3)",
    "clamp to arrays", "pow of several", "where >", "cat of whole numbers", "einsum bi,cij->bcj", "index of two",
    "linspace",
    "BatchNorm1d(3, affine=True, track_running_stats=True, eps=1e-05, momentum=0.1) of (1, 3, 2)",
    "BatchNorm1d(2, affine=True, track_running_stats=True, eps=1e-05, momentum=0.1) of (1, 2, 3)",
    "a buffer, bound anew", "a buffer, add_", "a buffer as a delay line", "a cache of a constant",
    f"LSTM(proj_size=2, num_layers=2, {PLAIN}) along the sequence",
    f"GRU(num_layers=1, {PLAIN}) along a window within a step",
    f"GRU(num_layers=1, {PLAIN}) with its state in a buffer",
}  # fmt: skip
REFUSED = {  # cases that were silently wrong: what is said now
    "dropout in training": "draws at random", "long": "computes in torch.int64", "numpy's random": "run twice",
    "if x > 0": "branches on data", "item": "operation item", "an attribute": "keeps h from step to step",
    "a counter": "keeps n", "a counter that is read after 1000 steps": "keeps n", "a list": "keeps past",
    "a dict": "keeps held", "an object": "keeps held", "the first step": "differs from the network",
    "a default argument": "forward", "GRU, the mean of its steps": "differs from the network",
    "GRU, backwards": "differs from the network", "GRU along the batch": "differs from the network",
    "GRU behind cumsum": "differs from the network", "GRU from its own end": "differs from the network",
}  # fmt: skip


@pytest.mark.parametrize("case", DRAWN, ids=lambda c: f"{c.group} {c.name}".replace(" ", "-"))
def test_a_module_of_pytorch_is_carried_right_or_refused_in_a_line(case):
    found = tried(case)
    assert found.verdict in ("right", "refused"), found


@pytest.mark.parametrize("name", sorted(RIGHT))
def test_what_was_silently_wrong_or_a_traceback_is_carried(name):
    found = tried(next(c for c in cases() if c.name == name))
    assert (found.verdict, found.largest < 1e-9) == ("right", True), found


@pytest.mark.parametrize("name", REFUSED)
def test_what_was_silently_wrong_is_refused_with_its_reason(name):
    found = tried(next(c for c in cases() if c.name == name))
    assert found.verdict == "refused"
    assert REFUSED[name] in found.said


def test_the_module_itself_and_the_random_numbers_are_left_as_they_were():
    class Drawn(nn.Module):
        def __init__(self):
            super().__init__()
            self.register_buffer("n", torch.zeros(1))
            self.calls = 0

        def forward(self, x):
            self.calls += 1
            self.n.add_(1)
            return x + torch.rand(1) + np.random.rand() + random.random()  # noqa: NPY002

    module = Drawn().train()
    torch.manual_seed(3)
    before = torch.get_rng_state(), np.random.get_state()[1].copy(), random.getstate()  # noqa: NPY002
    with pytest.raises(InputError):
        from_torch(module, ["u"], ["y"])
    assert torch.equal(torch.get_rng_state(), before[0])
    assert np.array_equal(np.random.get_state()[1], before[1])  # noqa: NPY002
    assert random.getstate() == before[2]
    assert torch.get_default_dtype() is torch.float32
    assert (module.calls, module.n.item(), module.n.dtype, module.training) == (0, 0.0, torch.float32, True)


def test_a_row_that_an_input_picks_is_picked_in_fixed_point_too():
    """One of floor(x) == k is 1, also where floor in float64 is a difference that rounds."""
    rows = np.array([0.3, -0.2, 0.9, 0.4, -0.7, 0.1, 0.8])

    class Picked(nn.Module):
        def forward(self, x):
            place = torch.floor(4 * x[:1])
            one = (place == torch.arange(-3, 4, dtype=x.dtype)).to(x.dtype)
            return torch.cat([(one * torch.tensor(rows, dtype=x.dtype)).sum()[None], (x[1:] != 0.5).to(x.dtype)])

    network = from_torch(Picked(), ["u", "v"], ["y", "z"])
    u, v = np.linspace(-0.7, 0.9, 401), np.where(np.arange(401) % 3, 0.5, 0.1)
    answers = network.run({"u": u, "v": v})
    assert answers["y"] == pytest.approx(rows[np.floor(4 * u).astype(int) + 3], abs=1e-12)
    assert answers["z"].tolist() == (v != 0.5).tolist()
    record = Record({"u": u, "v": v}, answers)
    apart = fixed_error(compile_network(network, {"run": record}, Formats(16)).program, record)
    assert np.median(np.abs(apart["y"])) < 1e-4
    assert np.sum(np.abs(apart["y"]) > 0.01) <= 7  # where a word rounds over an edge
    assert not apart["z"].any()


def test_a_module_that_has_the_name_of_a_recurrent_layer_is_none():
    class LSTM(nn.Module):
        def __init__(self):
            super().__init__()
            self.cell = nn.LSTMCell(1, 2)

        def forward(self, x, h, c):
            h, c = self.cell(x, (h, c))
            return h[:1], h, c

    network = from_torch(LSTM(), ["u"], ["y"], (np.zeros(2), np.zeros(2)))
    assert np.ptp(network.run({"u": np.linspace(-1.0, 1.0, 9)})["y"]) > 1e-4


def test_a_buffer_that_a_step_changes_starts_at_its_value():
    module = On(lambda s, x: (s.n.add_(1), s.n * x)[1])
    module.register_buffer("n", torch.tensor([5.0]))
    network = from_torch(module, ["u"], ["y"])
    assert network.run({"u": np.ones(4)})["y"].tolist() == [6.0, 7.0, 8.0, 9.0]


class Locked(nn.Module):
    def __init__(self):
        super().__init__()
        self.lock = threading.Lock()

    def forward(self, x):
        return x


def answered(module, x, count):
    columns = {f"u{k}": x[:, k] for k in range(x.shape[1])}
    outputs = [f"y{k}" for k in range(count)]
    return np.column_stack(list(from_torch(module, list(columns), outputs).run(columns).values()))


def test_a_module_that_takes_a_batch_takes_a_batch_of_one_sample():
    module = nn.Sequential(nn.Linear(2, 3), nn.BatchNorm1d(3), nn.PReLU(3), nn.Flatten(), nn.Linear(3, 1)).double()
    module(torch.randn(9, 2, dtype=torch.float64))  # it learns a mean and a spread
    x = np.random.default_rng(0).normal(size=(5, 2))
    wanted = module.eval()(torch.tensor(x)).detach().numpy()
    assert np.abs(answered(module, x, 1) - wanted).max() < 1e-14


def test_a_sample_that_a_module_takes_for_a_batch_is_given_as_a_batch_of_one():
    module = On(lambda s, x: torch.tanh(s.first(x) + torch.zeros(x.shape[0], 3)), first=nn.Linear(2, 3)).double()
    x = np.random.default_rng(0).normal(size=(5, 2))
    assert np.abs(answered(module, x, 3) - module(torch.tensor(x)).detach().numpy()).max() < 1e-14


def test_a_policy_gives_what_its_distribution_is_of():
    def policy(s, x):
        of = torch.distributions.Normal(s.mean(x), s.deviation(x).clamp(-20, 2).exp())
        return torch.cat([torch.tanh(of.mean), of.stddev, torch.distributions.Categorical(logits=s.mean(x)).probs], -1)

    module = On(policy, mean=nn.Linear(2, 2), deviation=nn.Linear(2, 2)).double()
    x = np.random.default_rng(0).normal(size=(5, 2))
    checked = torch.distributions.Distribution._validate_args
    assert np.abs(answered(module, x, 6) - module(torch.tensor(x)).detach().numpy()).max() < 1e-12
    assert torch.distributions.Distribution._validate_args is checked


def test_a_module_that_takes_a_derivative_is_told_so_and_torch_prints_no_graph(capfd):
    def energy(s, x):
        with torch.enable_grad():
            x = x.requires_grad_(True)
            return torch.autograd.grad(torch.tanh(s.first(x)).sum(), x)[0]

    for how in (energy, lambda s, x: torch.func.grad(lambda y: torch.tanh(s.first(y)).sum())(x)):
        with pytest.raises(InputError, match="derivative"):
            from_torch(On(how, first=nn.Linear(2, 3)), ["a", "b"], ["y", "z"])
    with pytest.raises(InputError, match="branches on data"):
        from_torch(On(lambda s, x: x if x.sum() > 0 else -x), ["a", "b"], ["y", "z"])
    assert "def forward" not in capfd.readouterr().err


def test_a_weight_that_a_hook_makes_is_made():
    with pytest.warns(FutureWarning):
        module = nn.utils.weight_norm(nn.Linear(2, 3))
    x = np.random.default_rng(0).normal(size=(5, 2))
    found = answered(module.double(), x, 3)
    assert np.abs(found - module(torch.tensor(x)).detach().numpy()).max() < 1e-14


def test_a_compiled_module_is_not_compiled_again():
    def backend(graph, given):
        raise AssertionError("compiled")

    module = torch.compile(nn.Linear(2, 1), backend=backend)
    assert answered(module, np.ones((3, 2)), 1).shape == (3, 1)


def step(s, x, h):
    return x + h, h


WRONG = {  # the arguments of from_torch -> what is said
    "a class": ((nn.Linear, ["u"], ["y"]), "is no torch.nn.Module"),
    "a function": ((torch.tanh, ["u"], ["y"]), "is no torch.nn.Module"),
    "no input": ((nn.Tanh(), [], ["y"]), "has no input"),
    "no output": ((nn.Tanh(), ["u"], []), "has no output"),
    "a name for a list": ((nn.Tanh(), "u", ["y"]), "inputs: 'u' is no list"),
    "a number for a list": ((nn.Tanh(), ["u"], 3), "outputs: 3 is no list"),
    "a number for a port": ((nn.Tanh(), [3], ["y"]), "port 3"),
    "a name twice": ((nn.Tanh(), ["u"], ["u"]), "u is used twice"),
    "a name for two": ((nn.Linear(1, 2), ["u"], ["y"]), "name one port each"),
    "too many inputs": ((nn.Linear(1, 1), ["u", "v"], ["y"]), "shape"),
    "too few inputs": ((nn.Linear(3, 1), ["u", "v"], ["y"]), "shape"),
    "a name of the network": ((nn.Tanh(), ["u"], ["y"], (), "a b"), "a b"),
    "states that are a name": ((On(step), ["u"], ["y"], "h"), "state: 'h' is no list"),
    "a state of words": ((On(step), ["u"], ["y"], ["h"]), "state 1: 'h' is no array"),
    "a state of NaN": ((On(step), ["u"], ["y"], [[np.nan]]), "not finite"),
    "a state of another size": (
        (On(lambda s, x, h: (x, h * 1.0)), ["u", "v"], ["y", "z"], [[0.0], [1.0]]),
        "arguments but 4",
    ),
    "a state that shrinks": ((On(lambda s, x, h: (x, h[:1])), ["u"], ["y"], [[0.0, 1.0]]), "2 elements become 1"),
    "no state": ((On(step), ["u"], ["y"]), "missing 1 required"),
    "a dict": ((On(lambda s, x: {"y": 1.0}), ["u"], ["y"]), "gives a float"),
    "nothing": ((On(lambda s, x: None), ["u"], ["y"]), "gives nothing"),
    "a number": ((On(lambda s, x: 1.0), ["u"], ["y"]), "gives a float"),
    "two outputs": ((On(lambda s, x: (x, x)), ["u"], ["y"]), r"gives \[2\], 2 numbers; name one port each"),
    "no output of forward": ((On(lambda s, x: ()), ["u"], ["y"]), "0 results"),
    "no forward": ((nn.Module(), ["u"], ["y"]), "forward"),
    "an error": ((On(lambda s, x: 1 / 0), ["u"], ["y"]), "ZeroDivisionError"),
    "a lock": ((Locked(), ["u"], ["y"]), "cannot be copied"),
    "NaN": ((On(lambda s, x: x * torch.nan), ["u"], ["y"]), "NaN or inf"),
    "sparse": ((On(lambda s, x: x.to_sparse()), ["u"], ["y"]), "sparse"),
    "a lazy layer": ((nn.LazyLinear(1), ["u"], ["y"]), "LazyLinear has parameters without a shape; call it once"),
    "a script": ((torch.jit.ScriptModule(), ["u"], ["y"]), "give the module of which torch.jit"),
    "a complex layer": ((nn.Linear(1, 1, dtype=torch.complex64), ["u"], ["y"]), "does not take float64"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_use_is_refused_in_a_line(name):
    given, said = WRONG[name]
    with pytest.raises(InputError, match=said) as found:
        from_torch(*given)
    assert "\n" not in str(found.value)
