"""Models of other tools, each with the answer of its own tool: PyTorch, onnxruntime, MATLAB's equations in NumPy."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import nn

from greygate.models.importers.files import load
from greygate.models.importers.matlab import from_matlab
from greygate.models.importers.onnx_graph import from_onnx
from greygate.models.importers.pytorch import from_torch
from greygate.models.network import Network

Answer = Callable[[np.ndarray], np.ndarray]
"""(steps, inputs) -> (steps, outputs)."""


@dataclass(frozen=True)
class Imported:
    """A network, and what its own tool answers."""

    source: str
    model: str
    operations: str
    make: Callable[[Path], tuple[Network, Answer]]


def signal(steps: int, columns: int, seed: int = 0) -> np.ndarray:
    """Slow random inputs (steps, columns) within [-1, 1]."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(0.2 * rng.standard_normal((steps, columns)), 0)
    return np.sin(walk)


def free_run(network: Network, x: np.ndarray) -> np.ndarray:
    found = network.run({p.name: x[:, k] for k, p in enumerate(network.inputs)})
    return np.column_stack([found[p.name] for p in network.outputs])


# -- PyTorch ---------------------------------------------------------------------------------------------------------


class Cell(nn.Module):
    """A recurrent cell and a linear output, a step at a time."""

    def __init__(self, kind, inputs=1, size=4):
        super().__init__()
        self.cell, self.out, self.size = kind(inputs, size), nn.Linear(size, 1), size

    def forward(self, x, *state):
        after = self.cell(x, state if len(state) > 1 else state[0])
        after = after if isinstance(after, tuple) else (after,)
        return self.out(after[0]), *after


class Noe(nn.Module):
    """An output-error model: taps of the input and of its own output are its state."""

    def __init__(self):
        super().__init__()
        self.hidden, self.out = nn.Linear(4, 6), nn.Linear(6, 1)

    def forward(self, u, past_u, past_y):
        y = 0.3 * self.out(torch.tanh(self.hidden(torch.cat([u, past_u, past_y])))) + 0.5 * past_y[:1]
        return y, u, torch.cat([y, past_y[:1]])


class Sequence(nn.Module):
    """A recurrent layer of torch along a sequence."""

    def __init__(self, kind, **options):
        super().__init__()
        self.recurrent, self.out = kind(2, 3, **options), nn.Linear(3, 1)

    def forward(self, x):
        y, _ = self.recurrent(x)
        return self.out(y)


class Mixed(nn.Module):
    """Slices, a product of signals, limits."""

    def __init__(self):
        super().__init__()
        self.first = nn.Linear(2, 6)
        self.register_buffer("gains", torch.tensor([0.5, -2.0, 1.5]))

    def forward(self, x):
        a, b = self.first(x).chunk(2)
        gate = torch.sigmoid(a) * torch.relu(b)
        return torch.clamp(gate * self.gains + torch.abs(a), -0.8, 1.2)[:2] - x / 4


def stepped(module: nn.Module, starts: tuple) -> Answer:
    def answer(x: np.ndarray) -> np.ndarray:
        state, found = [torch.tensor(np.array(s)) for s in starts], []
        with torch.no_grad():
            for row in x:
                y, *state = module(torch.tensor(row), *state)
                found.append(y.numpy().ravel())
        return np.array(found)

    return answer


def whole(module: nn.Module) -> Answer:
    def answer(x: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return module(torch.tensor(x)).numpy().reshape(len(x), -1)

    return answer


def each(module: nn.Module) -> Answer:
    def answer(x: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return np.stack([module(torch.tensor(row)).numpy() for row in x])

    return answer


def from_module(build: Callable[[], nn.Module], inputs: int, outputs: int, starts: tuple, how: Callable) -> Callable:
    def make(folder: Path) -> tuple[Network, Answer]:
        torch.manual_seed(1)
        module = build().double().eval()
        names = [f"u{k}" for k in range(inputs)], [f"y{k}" for k in range(outputs)]
        network = from_torch(module, *names, state=starts, name="imported")
        return network, how(module, starts) if how is stepped else how(module)

    return make


def mlp() -> nn.Module:
    return nn.Sequential(nn.Linear(2, 8), nn.Tanh(), nn.Linear(8, 6), nn.Sigmoid(), nn.Linear(6, 1))


def rectified() -> nn.Module:
    return nn.Sequential(
        nn.Linear(2, 8), nn.BatchNorm1d(8), nn.ReLU(), nn.Linear(8, 4), nn.Hardtanh(), nn.LeakyReLU(), nn.Linear(4, 1)
    )


class Batched(nn.Module):
    """A module that wants a batch."""

    def __init__(self, inner):
        super().__init__()
        self.inner = inner

    def forward(self, x):
        return self.inner(x.unsqueeze(0)).squeeze(0)


ZERO4, ZERO3 = np.zeros(4), np.zeros(3)
TORCH = [
    Imported("torch", "tanh, sigmoid", "Linear, Tanh, Sigmoid", from_module(mlp, 2, 1, (), whole)),
    Imported(
        "torch", "rectified", "Linear, BatchNorm1d, ReLU, Hardtanh, LeakyReLU",
        from_module(lambda: Batched(rectified()), 2, 1, (), each),
    ),
    Imported("torch", "mixed", "chunk, product, clamp, abs, slice", from_module(Mixed, 2, 2, (), each)),
    Imported("torch", "output error", "cat, tanh, states", from_module(Noe, 1, 1, (np.zeros(1), np.zeros(2)), stepped)),
    Imported("torch", "RNNCell", "RNNCell, state", from_module(lambda: Cell(nn.RNNCell), 1, 1, (ZERO4,), stepped)),
    Imported("torch", "GRUCell", "GRUCell, state", from_module(lambda: Cell(nn.GRUCell), 1, 1, (ZERO4,), stepped)),
    Imported(
        "torch", "LSTMCell", "LSTMCell, two states",
        from_module(lambda: Cell(nn.LSTMCell, 2, 3), 2, 1, (ZERO3, ZERO3), stepped),
    ),
    Imported("torch", "RNN", "nn.RNN, a sequence", from_module(lambda: Sequence(nn.RNN), 2, 1, (), whole)),
    Imported(
        "torch", "GRU", "nn.GRU of two layers", from_module(lambda: Sequence(nn.GRU, num_layers=2), 2, 1, (), whole)
    ),
]  # fmt: skip


# -- ONNX ------------------------------------------------------------------------------------------------------------


def runtime(path: Path, shape: tuple, states: dict | None = None) -> Answer:
    """onnxruntime, step by step. states: input -> output that it is next."""
    import onnxruntime

    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    entered, given = session.get_inputs(), [o.name for o in session.get_outputs()]
    kinds = {i.name: np.float64 if "double" in i.type else np.float32 for i in entered}

    def answer(x: np.ndarray) -> np.ndarray:
        held = {i.name: np.zeros(i.shape, kinds[i.name]) for i in entered if i.name in (states or {})}
        free, found = next(i.name for i in entered if i.name not in held), []
        for row in x:
            out = dict(
                zip(given, session.run(None, {free: row.reshape(shape).astype(kinds[free]), **held}), strict=True)
            )
            held = {inner: out[after] for inner, after in (states or {}).items()}
            found.append(next(v for n, v in out.items() if n not in (states or {}).values()).ravel())
        return np.array(found)

    return answer


def exported(build: Callable, given: tuple, states: dict | None = None) -> Callable:
    """torch's own export to ONNX, in double precision."""

    def make(folder: Path) -> tuple[Network, Answer]:
        torch.manual_seed(2)
        path = folder / "model.onnx"
        inputs = ["u", *(states or {})]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            torch.onnx.export(
                build().double().eval(), given, path, dynamo=True, external_data=False, verbose=False,
                input_names=inputs, output_names=["y", *(states or {}).values()],
            )  # fmt: skip
        return from_onnx(path, state=states), runtime(path, tuple(given[0].shape), states)

    return make


def learnt(folder: Path) -> tuple[Network, Answer]:
    """A pipeline of scikit-learn, by skl2onnx."""
    from skl2onnx import to_onnx
    from sklearn.neural_network import MLPRegressor
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    x = signal(300, 2, seed=3)
    model = make_pipeline(
        StandardScaler(), MLPRegressor(hidden_layer_sizes=(8,), activation="tanh", max_iter=200, random_state=0)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model.fit(x, x[:, 0] * x[:, 1] + 0.1 * x[:, 0])
        made = to_onnx(model, x[:1], target_opset=18)
    path = folder / "model.onnx"
    path.write_bytes(made.SerializeToString())
    return from_onnx(path), runtime(path, (1, 2))


def operator(kind: str) -> Callable:
    """A recurrent operator of ONNX, whose state is fed back from outside in onnxruntime."""

    def make(folder: Path) -> tuple[Network, Answer]:
        from onnx import TensorProto, helper, numpy_helper

        rng, n, gates = np.random.default_rng(5), 3, {"RNN": 1, "GRU": 3, "LSTM": 4}[kind]
        shapes = {"W": (1, gates * n, 2), "R": (1, gates * n, n), "B": (1, 2 * gates * n)}
        fixed = [numpy_helper.from_array(rng.normal(size=s).astype(np.float32) / 2, k) for k, s in shapes.items()]
        held = ["h", "c"] if kind == "LSTM" else ["h"]
        after = [f"{s}_next" for s in held]
        node = helper.make_node(kind, ["x", "W", "R", "B", "", *held], ["all", *after], hidden_size=n)
        rest = [
            helper.make_node("Squeeze", ["all", "axes"], ["flat"]),
            helper.make_node("ReduceSum", ["flat", "last"], ["y"], keepdims=1),
        ]
        fixed += [numpy_helper.from_array(np.array([0, 1]), "axes"), numpy_helper.from_array(np.array([-1]), "last")]

        def tensor(name: str, shape: list) -> object:
            return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

        graph = helper.make_graph(
            [node, *rest],
            "recurrent",
            [tensor("x", [1, 1, 2]), *(tensor(s, [1, 1, n]) for s in held)],
            [tensor("y", [1, 1]), *(tensor(s, [1, 1, n]) for s in after)],
            fixed,
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
        path, states = folder / f"{kind.lower()}.onnx", dict(zip(held, after, strict=True))
        path.write_bytes(model.SerializeToString())
        text = "\n".join(f'{a} = "{b}"' for a, b in states.items())
        names = 'inputs = ["p [Pa]", "x [m]"]\noutputs = ["f [N]"]\n'
        path.with_suffix(".ports.toml").write_text(f"{names}[state]\n{text}\n")
        return load(path), runtime(path, (1, 1, 2), states)

    return make


def scanned(folder: Path) -> tuple[Network, Answer]:
    """Scan along a sequence: onnxruntime runs all of it at once."""
    import onnxruntime
    from onnx import TensorProto, helper, numpy_helper

    rng = np.random.default_rng(6)
    fixed = {"A": rng.normal(size=(3, 3)) / 2, "B": rng.normal(size=(2, 3)), "C": rng.normal(size=(3, 1))}
    start = numpy_helper.from_array(np.array([[0.1, -0.2, 0.3]]), "start")

    def tensor(name: str, shape: list) -> object:
        return helper.make_tensor_value_info(name, TensorProto.DOUBLE, shape)

    body = helper.make_graph(
        [
            helper.make_node("MatMul", ["s", "A"], ["sA"]),
            helper.make_node("MatMul", ["x", "B"], ["xB"]),
            helper.make_node("Add", ["sA", "xB"], ["n"]),
            helper.make_node("Tanh", ["n"], ["s_next"]),
            helper.make_node("MatMul", ["s_next", "C"], ["y"]),
        ],
        "body",
        [tensor("s", [1, 3]), tensor("x", [1, 2])],
        [tensor("s_next", [1, 3]), tensor("y", [1, 1])],
        [numpy_helper.from_array(v, k) for k, v in fixed.items()],
    )
    scan = helper.make_node("Scan", ["start", "xs"], ["end", "ys"], num_scan_inputs=1, body=body)
    graph = helper.make_graph([scan], "scan", [tensor("xs", ["n", 1, 2])], [tensor("ys", ["n", 1, 1])], [start])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    path = folder / "scan.onnx"
    path.write_bytes(model.SerializeToString())
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    return from_onnx(path), lambda x: session.run(None, {"xs": x[:, None, :]})[0].reshape(len(x), -1)


DOUBLE = torch.float64
ONNX = [
    Imported(
        "ONNX", "torch export", "Gemm, Tanh, Sigmoid", exported(mlp, (torch.zeros(1, 2, dtype=DOUBLE),)),
    ),
    Imported("ONNX", "scikit-learn pipeline", "Scaler, MatMul, Add, Tanh", learnt),
    Imported(
        "ONNX", "torch export of a GRUCell", "Gemm, Split, Sigmoid, Tanh, Mul, state",
        exported(
            lambda: Cell(nn.GRUCell), (torch.zeros(1, dtype=DOUBLE), torch.zeros(4, dtype=DOUBLE)), {"h": "h_next"}
        ),
    ),
    Imported("ONNX", "RNN", "RNN", operator("RNN")),
    Imported("ONNX", "GRU", "GRU", operator("GRU")),
    Imported("ONNX", "LSTM", "LSTM", operator("LSTM")),
    Imported("ONNX", "Scan", "Scan of MatMul, Add, Tanh", scanned),
]  # fmt: skip


# -- MATLAB ----------------------------------------------------------------------------------------------------------

FUNCTIONS = {
    "tansig": lambda n: 2.0 / (1.0 + np.exp(-2.0 * n)) - 1.0,
    "logsig": lambda n: 1.0 / (1.0 + np.exp(-n)),
    "purelin": lambda n: n,
    "poslin": lambda n: np.maximum(n, 0.0),
    "satlins": lambda n: np.clip(n, -1.0, 1.0),
    "radbas": lambda n: np.exp(-n * n),
}


def cells(rows: list) -> np.ndarray:
    """A cell array."""
    found = np.empty((len(rows), max(len(r) for r in rows)), object)
    for i, row in enumerate(rows):
        for j in range(found.shape[1]):
            found[i, j] = row[j] if j < len(row) and row[j] is not None else np.zeros((0, 0))
    return found


def minmax(low: float, high: float) -> dict:
    """Settings of mapminmax to [-1, 1]."""
    return {"name": "mapminmax", "xoffset": float(low), "gain": 2.0 / (high - low), "ymin": -1.0, "ymax": 1.0}


def layout(transfer: list, entering: list, within: list, biases: list, **more: object) -> dict:
    """The struct of a network. entering, within: rows of (weights, delays) or None."""

    def part(rows: list, which: int) -> np.ndarray:
        return cells([[None if c is None else np.asarray(c[which], float) for c in row] for row in rows])

    return {
        "transferFcn": cells([transfer]),
        "IW": part(entering, 0),
        "inputDelays": part(entering, 1),
        "LW": part(within, 0),
        "layerDelays": part(within, 1),
        "b": cells([[b] for b in biases]),
        **more,
    }


def write_v5(path: Path, net: dict) -> None:
    from scipy.io import savemat

    savemat(path, net)


def write_v73(path: Path, net: dict) -> None:
    """HDF5 as MATLAB 7.3 lays it out: transposed arrays, cells as references, classes as attributes."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        count = [0]

        def put(group: h5py.Group, name: str, value: object) -> h5py.Dataset | h5py.Group:
            if isinstance(value, dict):
                inner = group.create_group(name)
                inner.attrs["MATLAB_class"] = np.bytes_("struct")
                for k, v in value.items():
                    put(inner, k, v)
                return inner
            if isinstance(value, str):
                made = group.create_dataset(name, data=np.array([[ord(c)] for c in value], np.uint16))
                made.attrs["MATLAB_class"] = np.bytes_("char")
                return made
            if isinstance(value, np.ndarray) and value.dtype == object:
                references = np.empty(value.T.shape, h5py.ref_dtype)
                for at in np.ndindex(value.shape):
                    count[0] += 1
                    references[at[::-1]] = put(file.require_group("#refs#"), f"r{count[0]}", value[at]).ref
                made = group.create_dataset(name, data=references, dtype=h5py.ref_dtype)
                made.attrs["MATLAB_class"] = np.bytes_("cell")
                return made
            array = np.atleast_2d(np.asarray(value, float))
            if array.size == 0:
                made = group.create_dataset(name, data=np.array([0, 0], np.uint64))
                made.attrs["MATLAB_empty"] = np.uint8(1)
            else:
                made = group.create_dataset(name, data=array.T)
            made.attrs["MATLAB_class"] = np.bytes_("double")
            return made

        for k, v in net.items():
            put(file, k, v)
    with open(path, "r+b") as block:
        block.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def simulated(net: dict) -> Answer:
    """MATLAB's equations: processed inputs, layers in turn with their delays, reversed outputs."""
    transfer = [str(t) for t in net["transferFcn"].ravel()]
    settings = [s for s in net.get("inputProcess", np.empty(0, object)).ravel()]
    out = [s for s in net.get("outputProcess", np.empty(0, object)).ravel()]

    def answer(x: np.ndarray) -> np.ndarray:
        widths, start, entered = [], 0, []
        for j in range(net["IW"].shape[1]):
            i = next(i for i in range(len(transfer)) if net["IW"][i, j].size)
            widths.append(net["IW"][i, j].shape[1] // net["inputDelays"][i, j].size)
        for j, width in enumerate(widths):
            part = np.vstack([np.zeros((20, width)), x[:, start : start + width]])
            if "Xi" in net:
                part[20 - net["Xi"].shape[1] : 20] = [np.ravel(v) for v in net["Xi"][j]]
            if settings and isinstance(settings[j], dict):
                part = (part - settings[j]["xoffset"]) * settings[j]["gain"] + settings[j]["ymin"]
            entered.append(part)
            start += width
        past = [np.zeros((len(x) + 20, len(np.ravel(b)))) for b in net["b"].ravel()]
        for i, held in enumerate(net.get("Ai", ())):
            past[i][20 - len(held) : 20] = [np.ravel(v) for v in held]
        for k in range(20, len(x) + 20):
            for i, f in enumerate(transfer):
                n = np.ravel(net["b"].ravel()[i]).copy()
                for grid, delays, signals in (("IW", "inputDelays", entered), ("LW", "layerDelays", past)):
                    for j in range(net[grid].shape[1]):
                        if net[grid][i, j].size:
                            at = [k - int(d) for d in np.ravel(net[delays][i, j])]
                            n += net[grid][i, j] @ np.concatenate([signals[j][a] for a in at])
                past[i][k] = FUNCTIONS[f](n)
        y = past[-1][20:]
        if out and isinstance(out[-1], dict):
            y = (y - out[-1]["ymin"]) / out[-1]["gain"] + out[-1]["xoffset"]
        return y

    return answer


def drawn(seed: int) -> Callable:
    rng = np.random.default_rng(seed)
    return lambda *shape: rng.normal(size=shape) / np.sqrt(shape[-1])


def fitnet() -> dict:
    w = drawn(1)
    settings = {"inputProcess": cells([[minmax(-1.0, 1.0)]]), "outputProcess": cells([[None, minmax(-3.0, 5.0)]])}
    names = {"inputs": cells([["u [V]", "x [m]"]]), "outputs": cells([["y [N]"]])}
    inputs, layers = [[(w(8, 2), [0])], [None]], [[None, None], [(w(1, 8), [0]), None]]
    return layout(["tansig", "purelin"], inputs, layers, [w(8, 1), w(1, 1)], **settings, **names)


def narx_closed() -> dict:
    w = drawn(2)
    inputs, layers = [[(w(6, 3), [0, 1, 3])], [None]], [[None, (0.5 * w(6, 2), [1, 2])], [(w(1, 6), [0]), None]]
    settings = {"inputProcess": cells([[minmax(-1.2, 1.1)]]), "outputProcess": cells([[None, minmax(-40.0, 60.0)]])}
    names = {"inputs": cells([["u [V]"]]), "outputs": cells([["p [bar]"]])}
    return layout(["tansig", "purelin"], inputs, layers, [w(6, 1), w(1, 1)], **settings, **names)


def narx_started() -> dict:
    """With the states of before the first step, the oldest first; NaN for a layer that nothing reads late."""
    rng = np.random.default_rng(7)
    before = cells([[float(v) for v in rng.uniform(-1, 1, 3)]])
    layers = cells([[np.full((6, 1), np.nan)] * 2, [float(v) for v in rng.uniform(-1, 1, 2)]])
    return {**narx_closed(), "Xi": before, "Ai": layers}


def layrec() -> dict:
    w = drawn(3)
    inputs, layers = [[(w(5, 1), [0])], [None]], [[(0.6 * w(5, 5), [1]), None], [(w(1, 5), [0]), None]]
    names = {"inputs": cells([["u [V]"]]), "outputs": cells([["y [m]"]])}
    return layout(["logsig", "purelin"], inputs, layers, [w(5, 1), w(1, 1)], **names)


def timedelay() -> dict:
    w = drawn(4)
    inputs = [[(w(4, 4), [0, 2]), (w(4, 2), [1, 4])], [None, None], [None, None]]
    layers = [[None] * 3, [(w(3, 4), [0]), None, None], [(w(1, 4), [1]), (w(1, 3), [0]), None]]
    names = {"inputs": cells([["a [V]", "b [V]", "c [A]"]]), "outputs": cells([["y [m]"]])}
    return layout(["poslin", "radbas", "satlins"], inputs, layers, [w(4, 1), w(3, 1), w(1, 1)], **names)


def saved(net: Callable[[], dict], write: Callable) -> Callable:
    def make(folder: Path) -> tuple[Network, Answer]:
        write(folder / "net.mat", net())
        return from_matlab(folder / "net.mat"), simulated(net())

    return make


MATLAB = [
    Imported("MATLAB v5", "fitnet", "tansig, purelin, mapminmax", saved(fitnet, write_v5)),
    Imported("MATLAB v5", "NARX, closed loop", "delays, feedback, mapminmax", saved(narx_closed, write_v5)),
    Imported("MATLAB v5", "NARX from its states", "delays, feedback, Xi, Ai", saved(narx_started, write_v5)),
    Imported("MATLAB v7.3", "layrecnet", "logsig, layer delay", saved(layrec, write_v73)),
    Imported("MATLAB v7.3", "two inputs, three layers", "poslin, radbas, satlins, delays", saved(timedelay, write_v73)),
    Imported("MATLAB v7.3", "NARX, closed loop", "delays, feedback, mapminmax", saved(narx_closed, write_v73)),
]
ALL = [*TORCH, *ONNX, *MATLAB]
