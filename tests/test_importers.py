"""Networks of other tools answer as in their own tool."""

import json
import os
import re
import subprocess
import sys
from importlib.metadata import version
from importlib.util import find_spec
from itertools import pairwise

import numpy as np
import pytest
import torch
from command_line import greygate
from exported_models import judged, made
from imported_models import ALL, cells, fitnet, free_run, mlp, signal, write_v5
from test_docs import BLOCKS
from torch import nn

from greygate.errors import InputError
from greygate.hardware.build import Project
from greygate.machines.source import Source
from greygate.models.importers import beside, pytorch
from greygate.models.importers.files import ELSEWHERE, _told, compared, load
from greygate.models.importers.onnx_graph import from_onnx, imported
from greygate.models.importers.pytorch import from_torch, to_torch
from greygate.plants.recording import Recording

AGREED = 1e-6  # the largest difference over a free run; onnxruntime and its float32 models are the worst
STEPS = 300


@pytest.mark.parametrize("case", ALL, ids=lambda c: f"{c.source} {c.model}".replace(" ", "-"))
def test_an_imported_network_answers_as_in_its_own_tool(case, tmp_path):
    network, answer = case.make(tmp_path)
    x = signal(STEPS, len(network.inputs))
    expected = answer(x)
    assert np.ptp(expected) > 0.01, "it does something"
    assert np.abs(free_run(network, x) - expected).max() <= AGREED * max(1.0, np.abs(expected).max())


def test_a_network_goes_to_torch_and_back_with_what_it_learnt_there(tmp_path):
    torch.manual_seed(0)
    network = from_torch(mlp(), ["u0", "u1"], ["y"])
    module, x = to_torch(network), signal(80, 2)
    assert np.abs(module(torch.tensor(x)).detach().numpy() - free_run(network, x)).max() < 1e-12
    before = free_run(module.network(), x)
    optimizer = torch.optim.SGD(module.parameters(), 0.05)
    wanted = torch.tensor(x[:, :1] * x[:, 1:])
    losses = []
    for _ in range(5):
        optimizer.zero_grad()
        loss = ((module(torch.tensor(x)) - wanted) ** 2).mean()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < losses[0]
    after = module.network()
    assert np.abs(free_run(after, x) - before).max() > 1e-4
    assert np.abs(module(torch.tensor(x)).detach().numpy() - free_run(after, x)).max() < 1e-12


def test_without_torch_its_extra_is_named(monkeypatch):
    network = from_torch(mlp(), ["u0", "u1"], ["y"])
    monkeypatch.setattr(pytorch, "find_spec", lambda name: None)
    for ask in (lambda: from_torch(mlp(), ["u0", "u1"], ["y"]), lambda: to_torch(network)):
        with pytest.raises(InputError, match=re.escape("torch is not installed; pip install 'greygate[torch]'")):
            ask()


@pytest.mark.skipif(find_spec("keras") is None, reason="keras is not installed; pip install 'greygate[dev]'")
def test_the_recipe_for_keras_gives_a_network_that_answers_as_keras(tmp_path):
    x = signal(STEPS, 2).astype(np.float32)
    np.save(tmp_path / "x.npy", x)
    recipe = next(text for _, name, text in BLOCKS["importers.md"] if name == "keras_network.py")
    script = f'{recipe}np.save("y.npy", model.predict(np.load("x.npy"), verbose=0))'
    subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, check=True, env={**os.environ, "KERAS_HOME": str(tmp_path)}
    )
    network = load(tmp_path / "observer.onnx")
    assert [p.name for p in network.inputs] == ["keras_tensor_1", "keras_tensor_2"]
    assert network.outputs[0].name[0] == "n", "Keras calls it by a number"
    assert np.abs(free_run(network, x) - np.load(tmp_path / "y.npy")).max() < AGREED


REFUSED_OF_EXPORTERS = {"tree"}  # ends of names of files


@pytest.mark.nightly
def test_models_by_the_exporters_of_other_tools_are_right_or_refused_by_name(tmp_path):
    pytest.importorskip("keras")
    found = {file.stem: judged(file) for file in made(tmp_path)}
    assert len(found) >= 50
    refused = {name for name, (verdict, _) in found.items() if verdict == "refused"}
    assert {name.split()[-1] for name in refused} <= REFUSED_OF_EXPORTERS
    assert {v for v, _ in found.values()} == {"right", "refused"}, found


# -- over a recording ------------------------------------------------------------------------------------------------


BESIDE = [c for c in ALL if c.source == "ONNX"]


def recorded(case, folder):
    """(model file, columns of the network's inputs)."""
    network, _ = case.make(folder)
    x = signal(STEPS, len(network.inputs))
    (file,) = folder.glob("*.onnx")
    if "Cell" in case.model:
        file.with_suffix(".ports.toml").write_text('state = { h = "h_next" }')
    return file, {p.name: x[:, k] for k, p in enumerate(network.inputs)}


@pytest.mark.parametrize("case", BESIDE, ids=lambda c: c.model.replace(" ", "-"))
@pytest.mark.parametrize("program", ["onnxruntime", "ONNX's reference"])
def test_a_model_in_its_own_program_runs_the_recording_beside_the_network(case, program, tmp_path, monkeypatch):
    file, columns = recorded(case, tmp_path)
    if program != "onnxruntime":
        monkeypatch.setattr(beside, "find_spec", lambda name: None)
    found = compared(file, columns)
    assert found.program.startswith(program)
    assert (found.steps, found.largest < AGREED, found.why) == (STEPS, True, "")


def test_a_network_that_answers_otherwise_than_its_model_is_told_by_the_recording(tmp_path):
    file, columns = recorded(next(c for c in BESIDE if c.model == "GRU"), tmp_path)
    made = imported(file, **_told(file))
    wrong = made.network.with_parameters({n: 0.9 * v for n, v in made.network.parameters().items()})
    said = str(beside.beside(made._replace(network=wrong), file, columns))
    assert re.search(r"differ by at most 0\.\d+ of \w+ in 300 steps; that is more than rounding, in \d+ of them", said)


def test_commands_say_how_far_the_network_is_from_onnxruntime(tmp_path):
    file, columns = recorded(next(c for c in BESIDE if c.model == "scikit-learn pipeline"), tmp_path)
    network = load(file)
    columns |= dict(zip([p.name for p in network.outputs], free_run(network, signal(STEPS, 2)).T, strict=True))
    Recording(1e-3, columns, dict.fromkeys(columns, "1")).write_csv(tmp_path / "run.csv")
    for command, option in (("validate", "--html"), ("compile", "--out")):
        code, out, said = greygate(command, file, tmp_path / "run.csv", option, tmp_path / command, "--json")
        told = json.loads(out)["imported"]
        assert (code, told["steps"], told["largest"] < AGREED) == (0, STEPS, True)
        assert f"{file}: onnxruntime {version('onnxruntime')} and the network differ by at most" in said


@pytest.mark.parametrize("saved", [False, True])
def test_a_recording_of_inputs_alone_whose_headers_are_the_ports_is_compiled_and_verified(saved, tmp_path):
    file, columns = recorded(next(c for c in BESIDE if c.model == "scikit-learn pipeline"), tmp_path)
    name = file.stem
    if saved:
        load(file).save(tmp_path / "saved")
        file = tmp_path / "saved.toml"
    rows = np.column_stack([1e-3 * np.arange(STEPS), *columns.values()])
    csv, build = tmp_path / "run.csv", tmp_path / "build"
    np.savetxt(csv, rows, delimiter=",", comments="", header=",".join(["t_s", *columns]))
    code, _, said = greygate("compile", file, csv, "--out", build)
    assert code == 0, said
    assert f"{csv}: has no output of {name}; what the network answers stands for it" in said
    assert saved or greygate("verify", build)[0] == 0  # the same build
    code, _, said = greygate("validate", file, csv)
    assert (code, "is missing" in said) == (2, True)


# -- what cannot be carried ------------------------------------------------------------------------------------------


class Refused(nn.Module):
    """An operation on the sum of a linear layer."""

    def __init__(self, operation):
        super().__init__()
        self.first, self.operation = nn.Linear(3, 4), operation

    def forward(self, x):
        return self.operation(self.first(x))


UNSUPPORTED = {
    "erfinv": torch.erfinv,
    "pow": lambda y: torch.abs(y) ** 16.5,
    "sort": lambda y: torch.sort(y.repeat(5))[0],
    "cumprod": lambda y: torch.cumprod(y, 0),
    "layer_norm": lambda y: torch.nn.functional.layer_norm(y, (4,), eps=0.0),
    "log": lambda y: torch.log(1 + y),
    "sqrt": torch.sqrt,
    "rsqrt": torch.rsqrt,
}


def test_an_operation_in_a_module_of_torch_is_named_with_that_module():
    said = r"operation layer_norm in 1 \(LayerNorm\): its epsilon is 0"
    with pytest.raises(InputError, match=said):
        from_torch(nn.Sequential(nn.Linear(1, 2), nn.LayerNorm(2, eps=0.0)), ["a"], ["y", "z"])


class Batched(nn.Module):
    """A recurrent layer as it is written for batches. zeros: it makes its first state itself."""

    def __init__(self, kind, first, zeros=False, last=False, **options):
        super().__init__()
        self.recurrent, self.out = kind(2, 3, batch_first=first, **options), nn.Linear(options.get("proj_size", 3), 1)
        self.first, self.zeros, self.last = first, zeros, last

    def forward(self, x):
        h = torch.zeros(self.recurrent.num_layers, x.size(0 if self.first else 1), 3, dtype=x.dtype).to(x.device)
        given = () if not self.zeros else ((h, h.clone()),) if isinstance(self.recurrent, nn.LSTM) else (h,)
        y, _ = self.recurrent(x, *given)
        return self.out((y[:, -1, :] if self.first else y[-1]) if self.last else y)


BATCHED = {
    f"{kind.__name__} {first} {zeros} {last}": (kind, first, zeros, last, {})
    for kind in (nn.RNN, nn.GRU, nn.LSTM)
    for first, zeros, last in ((True, True, True), (True, False, True), (False, True, False), (True, True, False))
} | {
    "projected": (nn.LSTM, True, False, True, {"proj_size": 2}),
    "two layers": (nn.GRU, True, True, True, {"num_layers": 2, "dropout": 0.3}),
}


@pytest.mark.parametrize("name", BATCHED)
def test_a_recurrent_layer_written_for_batches_goes_on_from_step_to_step(name):
    kind, first, zeros, last, options = BATCHED[name]
    torch.manual_seed(2)
    module = Batched(kind, first, zeros, last, **options).double().eval()
    x = signal(20, 2)
    network = from_torch(module, ["a", "b"], ["y"])
    whole = torch.tensor(x)[None] if first else torch.tensor(x)[:, None]
    wanted = module(whole).detach().numpy().ravel()
    got = free_run(network, x)[:, 0]
    assert np.abs(got[-len(wanted) :] - wanted).max() < 1e-12


class Stepped(nn.Module):
    """States with an axis of the batch, of an LSTM as a pair."""

    def __init__(self):
        super().__init__()
        self.recurrent = nn.LSTM(2, 3, batch_first=True)

    def forward(self, x, hc):
        y, hc = self.recurrent(x, hc)
        return torch.cat([y[:, -1], x[:, -1, 0:1]], 1), hc


class Columns(nn.Module):
    def __init__(self):
        super().__init__()
        self.cell, self.norm = nn.GRUCell(2, 3), nn.BatchNorm1d(3)

    def forward(self, x, h):
        h = self.cell(torch.cat([x[:, 1:2], x[:, 0:1]], dim=1), h)
        return torch.cat([self.norm(h), x[:, [1]]], 1), h


@pytest.mark.parametrize(("module", "starts"), [(Stepped(), [(1, 1, 3)] * 2), (Columns(), [(1, 3)])])
def test_the_states_of_a_batch_of_one_are_given_without_its_axis(module, starts):
    x, module = signal(20, 2), module.double().eval()
    network = from_torch(module, ["a", "b"], ["y1", "y2", "y3", "u"], [np.zeros(3) for _ in starts])
    states, rows = [torch.zeros(s, dtype=torch.float64) for s in starts], []
    for row in torch.tensor(x):
        y, states = module(row[None, None], tuple(states)) if len(states) > 1 else module(row[None], states[0])
        states = states if isinstance(states, tuple) else [states]
        rows.append(y.detach().numpy().ravel())
    assert np.abs(free_run(network, x) - rows).max() < 1e-12


PRODUCTS = {
    "matmul": lambda y: (y[:2] @ y[2:])[None],
    "outer": lambda y: torch.outer(y[:2], torch.tanh(y[2:])).flatten(),
    "einsum": lambda y: torch.einsum("i,ijk,k->j", y, torch.arange(32.0, dtype=y.dtype).reshape(4, 2, 4) / 9, y),
    "bilinear": lambda y: nn.functional.bilinear(y[:2], y[1:3], torch.ones(3, 2, 2, dtype=y.dtype), y[:3]),
}


@pytest.mark.parametrize("name", PRODUCTS)
def test_a_product_of_two_signals_within_an_operation_is_a_sum_of_products(name):
    module = Refused(PRODUCTS[name]).double()
    x = signal(STEPS, 3)
    wanted = np.array([module(torch.tensor(row)).detach().numpy().ravel() for row in x])
    network = from_torch(module, ["a", "b", "c"], [f"y{k}" for k in range(wanted.shape[1])])
    assert np.abs(free_run(network, x) - wanted).max() < 1e-12


@pytest.mark.parametrize("name", UNSUPPORTED)
def test_an_operation_that_a_network_cannot_carry_is_named_with_its_line(name):
    with pytest.raises(InputError) as found:
        from_torch(Refused(UNSUPPORTED[name]), ["a", "b", "c"], [f"y{k}" for k in range(4)])
    assert re.match(rf"operation \w*{name}\w* at .*test_importers.py:\d+: .+: .+", str(found.value)), found.value


SHAPES = {
    "elu": nn.ELU(0.7), "selu": nn.SELU(inplace=True), "celu": nn.CELU(0.6), "softplus": nn.Softplus(2.0),
    "softplus, cut": nn.Softplus(1.0, 0.5), "gelu": nn.GELU(), "gelu by tanh": nn.GELU("tanh"), "silu": nn.SiLU(),
    "mish": nn.Mish(), "softsign": nn.Softsign(), "hardswish": nn.Hardswish(), "prelu": nn.PReLU(4),
    "log_sigmoid": nn.LogSigmoid(),
}  # fmt: skip


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_of_neuron_answers_as_torch(name):
    module = nn.Sequential(nn.Linear(2, 4), SHAPES[name]).double()
    network, x = from_torch(module, ["a", "b"], [f"y{k}" for k in range(4)]), 4 * signal(STEPS, 2)
    assert np.abs(free_run(network, x) - module(torch.tensor(x)).detach().numpy()).max() < 1e-9


@pytest.mark.parametrize(
    "how",
    [
        lambda y: torch.max(y, 0)[0],
        lambda y: torch.amin(y, -1, keepdim=True),
        lambda y: torch.maximum(y, y.flip(0)),
        torch.min,
    ],
)
def test_the_largest_and_the_least_of_signals_are_carried(how):
    module = Refused(how).double()
    x = signal(STEPS, 3)
    wanted = np.array([module(torch.tensor(row)).detach().numpy().ravel() for row in x])
    network = from_torch(module, ["a", "b", "c"], [f"y{k}" for k in range(wanted.shape[1])])
    assert np.abs(free_run(network, x) - wanted).max() < 1e-12


def test_a_recurrent_layer_of_both_directions_is_refused():
    class Both(nn.Module):
        def __init__(self):
            super().__init__()
            self.r = nn.GRU(2, 3, bidirectional=True)

        def forward(self, x):
            return self.r(x)[0]

    with pytest.raises(InputError, match="both directions"):
        from_torch(Both(), ["a", "b"], [f"y{k}" for k in range(6)])


@pytest.mark.parametrize("kept", [tuple, lambda parts: dict(zip("ba", parts, strict=True))])
def test_several_results_are_outputs_in_their_order(kept):
    class Several(nn.Module):
        def forward(self, x, state):
            y = kept([x[:1] + state, 2 * x])
            return (*y, state + 1) if isinstance(y, tuple) else y

    class Once(Several):
        def forward(self, x):
            return super().forward(x, 0)

    module, state = (Several(), [np.zeros(1)]) if kept is tuple else (Once(), [])
    network = from_torch(module, ["a", "b"], ["p", "q", "r"], state)
    assert free_run(network, np.array([[1.0, 2.0], [3.0, 4.0]]))[:, 1:].tolist() == [[2.0, 4.0], [6.0, 8.0]]
    assert free_run(network, np.zeros((3, 2)))[:, 0].tolist() == ([0.0, 1.0, 2.0] if kept is tuple else [0.0] * 3)


def test_what_a_module_turns_into_float32_stays_exact():
    class Turned(nn.Module):
        def forward(self, x):
            y = torch.relu(x).float() + (x > 0).to(torch.float32) * torch.arange(2, dtype=torch.float32) / 3
            return y + torch.as_tensor(np.array([0.5, 0.0], np.float32))

    network = from_torch(Turned(), ["a", "b"], ["p", "q"])
    assert free_run(network, np.array([[0.1, 0.1]])).tolist() == [[0.1 + 0.5, 0.1 + 1 / 3]]


def test_a_step_with_another_number_of_results_is_refused():
    class Forgetful(nn.Module):
        def forward(self, x, state):
            return x + state

    with pytest.raises(InputError, match="forward gives 1 results; give y, and 1 states"):
        from_torch(Forgetful(), ["u"], ["y"], state=(np.zeros(1),))
    with pytest.raises(InputError, match="name one port each"):
        from_torch(mlp(), ["u0", "u1"], ["y", "z"])


# -- files -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", ELSEWHERE)
def test_a_file_that_may_hold_code_is_not_opened_and_how_to_have_onnx_of_it_is_told(tmp_path, ending):
    path = tmp_path / f"model{ending}"
    path.write_bytes(b"cos\nsystem\n(S'touch owned'\ntR.")
    with pytest.raises(InputError, match=f"may hold code.*{re.escape(ELSEWHERE[ending])}"):
        load(path)
    code, _, err = greygate("compile", path, "--out", tmp_path / "build")
    assert (code, ELSEWHERE[ending] in err) == (2, True)


def test_a_file_that_is_no_network_is_told_from_a_name(tmp_path):
    (tmp_path / "model.pmml").write_text("<PMML/>")
    code, _, err = greygate("compile", tmp_path / "model.pmml", "--out", tmp_path / "build")
    assert (code, "model.pmml: is no network; give an .onnx file" in err) == (2, True)


@pytest.mark.parametrize("ending", ["onnx", "mat"])
def test_a_damaged_file_is_refused_in_one_line(tmp_path, ending):
    case = next(c for c in ALL if c.model == ("LSTM" if ending == "onnx" else "fitnet"))
    case.make(tmp_path)
    path = next(tmp_path.glob(f"*.{ending}"))
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    refused, lines = 0, set()
    for _ in range(20 if ending == "mat" else 100):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), 1 + int(rng.integers(4))):
            data[at] = int(rng.integers(256))
        path.write_bytes(bytes(data[: len(data) - int(rng.integers(2)) * int(rng.integers(len(data)))]))
        try:
            load(path)
        except InputError as error:
            refused += 1
            lines.add(str(error).count("\n"))
    assert refused > 5
    assert lines == {0}


ONNX_REFUSED = {  # text of a model -> what is said
    "(float[2] x) => (int64[2] y) {y = Cast<to = 7>(x)}": "operation Cast.*becomes INT64, which rounds it",
    "(float[2] x) => (float16[2] y) {y = Cast<to = 10>(x)}": "becomes FLOAT16",
    "(float[2] x) => (float[2] y, bool[2] mask) {y, mask = Dropout(x)}": "output mask is of an operation",
    "(float[2] x, float[2] b) => (float[2] y) {y = Mod<fmod = 1>(x, b)}": "operation Mod: fmod = 1, with the sign",
    "(float[2] x) => (float[2] y) {y = Sqrt(x)}": "operation Sqrt: a root of a signal that may be negative",
    "(float[2] x) => (float[2] y) {y = Round(x)}": "operation Round",
    "(float[2] x, float r) => (float[2] y) <bool t = {1}> {y = Dropout(x, r, t)}": "in training mode",
    "() => (float[2] y) {y = Constant<value_floats = [1.0, 2.0]>()}": "has no input",
}  # fmt: skip


@pytest.mark.parametrize("model", ONNX_REFUSED)
def test_an_operation_of_onnx_that_would_change_its_meaning_is_refused(model, tmp_path):
    import onnx

    text = f'<ir_version: 9, opset_import: ["": 18]> m {model}'
    onnx.save(onnx.parser.parse_model(text), tmp_path / "m.onnx")
    with pytest.raises(InputError, match=ONNX_REFUSED[model]):
        from_onnx(tmp_path / "m.onnx")


def test_an_input_without_a_column_may_be_a_state_and_how_to_say_so_is_told(tmp_path):
    next(c for c in ALL if c.model == "GRU" and c.source == "ONNX").make(tmp_path)
    (tmp_path / "gru.ports.toml").unlink(missing_ok=True)
    Recording(1e-3, {"x": np.zeros(9)}, {"x": "1"}).write_csv(tmp_path / "run.csv")
    source = Source(str(tmp_path / "gru.onnx"), {"run": str(tmp_path / "run.csv")})
    with pytest.raises(InputError, match=r'is missing; .* inputs = .* in gru.ports.toml .* state = \{ h = "h_next" \}'):
        source.records(answering=True)


def test_states_of_an_onnx_model_must_be_its_own(tmp_path):
    case = next(c for c in ALL if c.model == "GRU" and c.source == "ONNX")
    case.make(tmp_path)
    with pytest.raises(InputError, match="inputs x, h and outputs y, h_next"):
        from_onnx(tmp_path / "gru.onnx", state={"s": "h_next"})


def test_a_file_of_matlab_must_name_its_ports_and_fit(tmp_path):
    net = fitnet()
    del net["inputs"]
    write_v5(tmp_path / "a.mat", net)
    with pytest.raises(InputError, match="names no inputs"):
        load(tmp_path / "a.mat")
    net = fitnet()
    net["transferFcn"][0, 0] = "softmax"
    write_v5(tmp_path / "b.mat", net)
    with pytest.raises(InputError, match="layer 1 has transferFcn 'softmax'"):
        load(tmp_path / "b.mat")
    net = fitnet()
    net["LW"][1, 0] = np.ones((1, 7))
    write_v5(tmp_path / "c.mat", net)
    with pytest.raises(InputError, match=r"weights of layer 2 from 1"):
        load(tmp_path / "c.mat")


@pytest.mark.parametrize("model", ["GRU", "fitnet"])
def test_a_file_of_another_tool_stands_wherever_a_network_does(model, tmp_path):
    case = next(c for c in ALL if c.model == model and c.source != "torch")
    network, _ = case.make(tmp_path)
    x = signal(100, len(network.inputs))
    columns = {p.name: x[:, k] for k, p in enumerate(network.inputs)}
    columns |= {p.name: v for p, v in zip(network.outputs, free_run(network, x).T, strict=True)}
    units = {p.name: p.unit for p in (*network.inputs, *network.outputs)}
    Recording(1e-3, columns, units).write_csv(tmp_path / "run.csv")
    file = next(p for p in tmp_path.iterdir() if p.suffix in (".onnx", ".mat"))
    code, _, told = greygate(
        "compile", file, tmp_path / "run.csv", "--architecture", "folded", "--out", tmp_path / "build"
    )
    assert code == 0, told
    assert Project.open(tmp_path / "build").program.name == file.stem


PLAIN_LAYERS = {
    "cells": lambda names: cells([names]),
    "a matrix of characters": lambda names: np.array(names),
}


@pytest.mark.parametrize("written", PLAIN_LAYERS)
def test_a_struct_of_weights_biases_and_names_of_functions_is_read(written, tmp_path):
    from scipy.io import savemat

    rng = np.random.default_rng(0)
    sizes = (3, 5, 4, 2)
    weights = [rng.normal(size=(m, n)) for n, m in pairwise(sizes)]
    biases = [rng.normal(size=(n, 1)) for n in sizes[1:]]
    names = PLAIN_LAYERS[written](["relu", "tanh", "purelin"])
    savemat(tmp_path / "net.mat", {"W": cells([weights]), "b": cells([biases]), "act_fcns": names})
    network, x = load(tmp_path / "net.mat"), signal(STEPS, 3)
    h = np.tanh(weights[1] @ np.maximum(weights[0] @ x.T + biases[0], 0) + biases[1])
    assert [p.name for p in (*network.inputs, *network.outputs)] == ["x_1", "x_2", "x_3", "y_1", "y_2"]
    assert np.abs(free_run(network, x) - (weights[2] @ h + biases[2]).T).max() < 1e-12


def test_weights_by_names_of_their_own_are_told_how_to_be_written(tmp_path):
    from scipy.io import savemat

    savemat(tmp_path / "net.mat", {"W1": np.ones((2, 1)), "b1": np.ones((2, 1))})
    with pytest.raises(InputError, match=r"has no IW, but W1, b1; .* plain layers with W = \{W1, W2\}"):
        load(tmp_path / "net.mat")
