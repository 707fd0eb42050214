"""Models as people have them, made by the tools' own exporters: python tests/exported_models.py FOLDER writes them.

In a process of its own, as Keras takes its backend when it is imported, and exporters warn. `judged` asks what becomes
of a file.
"""

import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

AGREED = 1e-5  # of the largest answer: onnxruntime computes in float32
STEPS = 60
WINDOW = 6


def made(folder: Path) -> list[Path]:
    """The files that all exporters write into a folder."""
    ran = {**os.environ, "KERAS_BACKEND": "torch", "KERAS_HOME": str(folder)}
    subprocess.run([sys.executable, "-W", "ignore", __file__, str(folder)], check=True, env=ran, capture_output=True)
    return sorted(folder.glob("*.onnx"))


def judged(file: Path) -> tuple[str, str]:
    """("right", "refused", "wrong" or "traceback", what is said)."""
    from greygate.errors import InputError
    from greygate.models.importers.beside import beside
    from greygate.models.importers.onnx_graph import imported

    try:
        found = imported(file)
    except InputError as error:
        return ("traceback" if "\n" in str(error) else "refused"), str(error)
    except Exception as error:
        return "traceback", f"{type(error).__name__}: {error}"
    rng, ports = np.random.default_rng(0), [p.name for p in found.network.inputs]
    told = beside(found, file, {n: np.sin(np.cumsum(0.4 * rng.standard_normal(STEPS))) for n in ports})
    return ("right" if told.largest <= AGREED and told.steps == STEPS else "wrong"), str(told)


# -- the other process -----------------------------------------------------------------------------------------------


def _torch() -> Iterator[tuple[str, object, list[int]]]:
    """(name, module, shape of x)."""
    from torch import nn

    for kind in (nn.Tanh, nn.ReLU, nn.ELU, nn.GELU, nn.SiLU, nn.Softplus, nn.Softsign, nn.Hardshrink):
        yield kind.__name__, nn.Sequential(nn.Linear(3, 6), kind(), nn.Linear(6, 2)), [1, 3]
    yield "Softmax", nn.Sequential(nn.Linear(3, 6), nn.Softmax(-1), nn.Linear(6, 2)), [1, 3]
    yield "BatchNorm1d", nn.Sequential(nn.Linear(3, 6), nn.BatchNorm1d(6), nn.Tanh(), nn.Linear(6, 2)), [1, 3]
    yield "LayerNorm", nn.Sequential(nn.Linear(3, 6), nn.LayerNorm(6), nn.Tanh(), nn.Linear(6, 2)), [1, 3]
    flat = nn.Sequential(nn.Flatten(), nn.Linear(2 * WINDOW, 5), nn.Tanh(), nn.Linear(5, 1))
    yield "window", flat, [1, WINDOW, 2]
    yield (
        "Conv1d",
        nn.Sequential(nn.Conv1d(2, 4, 3), nn.ReLU(), nn.AvgPool1d(2), nn.Flatten(), nn.Linear(8, 1)),
        [1, 2, WINDOW],
    )
    for kind in (nn.RNN, nn.GRU, nn.LSTM):
        yield f"{kind.__name__} batch first", _last(kind, batch_first=True), [1, WINDOW, 2]
        yield f"{kind.__name__} step", _last(kind), [1, 1, 2]


def _last(kind: type, **options: object) -> object:
    """The last step of a recurrent layer, from a state of zeros."""
    import torch
    from torch import nn

    class Last(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.recurrent, self.out = kind(2, 3, **options), nn.Linear(3, 1)

        def forward(self, x: torch.Tensor) -> torch.Tensor:
            y, _ = self.recurrent(x)
            return self.out(y[:, -1, :] if options else y[-1])

    return Last()


def write_torch(folder: Path) -> None:
    """By the exporter of TorchScript and by the one of torch.export; a recurrent layer of one step by the old alone."""
    import torch

    torch.manual_seed(0)
    for name, module, shape in _torch():
        for new in (False, True):
            if new and name.endswith("step"):
                continue  # it unrolls the layer, so its state begins anew
            file = folder / f"torch {'new' if new else 'old'} {name}.onnx"
            torch.onnx.export(
                module.eval(), (torch.zeros(shape),), str(file), dynamo=new, input_names=["x"], output_names=["y"]
            )


def write_keras(folder: Path) -> None:
    import keras
    from keras import layers

    parts: dict[str, tuple[list[int], Callable[[], list]]] = {
        "Dense": ([3], lambda: [layers.Dense(5, "tanh"), layers.Dense(1)]),
        "Conv1D": ([8, 2], lambda: [layers.Conv1D(4, 3, activation="relu"), layers.Flatten(), layers.Dense(1)]),
        "causal": ([8, 2], lambda: [layers.Conv1D(4, 3, padding="causal"), layers.Flatten(), layers.Dense(1)]),
        "pooled": ([8, 2], lambda: [layers.Conv1D(4, 3), layers.AveragePooling1D(2), layers.Flatten()]),
        "flat": ([8, 2], lambda: [layers.Flatten(), layers.Dense(4, "sigmoid"), layers.Dense(1)]),
        "SimpleRNN": ([WINDOW, 2], lambda: [layers.SimpleRNN(4), layers.Dense(1)]),
        "GRU": ([WINDOW, 2], lambda: [layers.GRU(4), layers.Dense(1)]),
        "LSTM": ([WINDOW, 2], lambda: [layers.LSTM(4), layers.Dense(1)]),
        "LSTM, two": ([WINDOW, 2], lambda: [layers.LSTM(4, return_sequences=True), layers.LSTM(3), layers.Dense(1)]),
        "TimeDistributed": (
            [WINDOW, 2],
            lambda: [layers.TimeDistributed(layers.Dense(3, "tanh")), layers.GlobalAveragePooling1D(), layers.Dense(1)],
        ),
        "GroupNormalization": ([6], lambda: [layers.Dense(6), layers.GroupNormalization(2), layers.Dense(1)]),
        "UnitNormalization": ([3], lambda: [layers.Dense(4), layers.UnitNormalization(), layers.Dense(1)]),
        "both ways": ([WINDOW, 2], lambda: [layers.Bidirectional(layers.GRU(3)), layers.Dense(1)]),
    }
    keras.utils.set_random_seed(0)
    for name, (shape, of) in parts.items():
        model = keras.Sequential([keras.Input(shape), *of()])
        model(np.zeros((1, *shape)))
        model.export(str(folder / f"keras {name}.onnx"), format="onnx", verbose=False)


def write_sklearn(folder: Path) -> None:
    from skl2onnx import to_onnx
    from sklearn.compose import ColumnTransformer
    from sklearn.cross_decomposition import PLSRegression
    from sklearn.ensemble import GradientBoostingRegressor
    from sklearn.impute import SimpleImputer
    from sklearn.linear_model import LinearRegression, Ridge
    from sklearn.multioutput import MultiOutputRegressor
    from sklearn.neural_network import MLPRegressor
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import MinMaxScaler, PolynomialFeatures, StandardScaler
    from sklearn.tree import DecisionTreeRegressor

    rng = np.random.default_rng(0)
    x = rng.normal(size=(200, 3))
    y = np.column_stack([np.tanh(x @ [1, 2, 3]), x @ [1, -1, 0.5]])
    columns = ColumnTransformer([("a", StandardScaler(), [0, 2]), ("b", MinMaxScaler(), [1])])
    several = MLPRegressor(hidden_layer_sizes=(6,), activation="tanh", max_iter=60, random_state=0)
    parts = {
        "linear": LinearRegression(),
        "imputed": make_pipeline(SimpleImputer(), StandardScaler(), Ridge()),
        "polynomial": make_pipeline(PolynomialFeatures(2), Ridge()),
        "columns": make_pipeline(columns, several),
        "clipped": make_pipeline(MinMaxScaler(clip=True), several),
        "PLS": PLSRegression(2),
        "boosted tree": MultiOutputRegressor(GradientBoostingRegressor(n_estimators=3)),
        "tree": DecisionTreeRegressor(max_depth=3),
    }
    for name, part in parts.items():
        made_of = to_onnx(part.fit(x, y), x[:1].astype(np.float32))
        (folder / f"sklearn {name}.onnx").write_bytes(made_of.SerializeToString())


CONTROLLERS = {  # of the verification contest ARCH-COMP: inputs, neurons of each layer, outputs; what they bend by
    "ACC 3x20": ([5, 20, 20, 20, 1], "Relu"),
    "ACC 5x20": ([5, 20, 20, 20, 20, 20, 1], "Relu"),
    "ACC 7x20": ([5, *[20] * 7, 1], "Relu"),
    "TORA": ([4, 100, 100, 100, 1], "Relu"),
    "TORA, tanh": ([4, 20, 20, 20, 1], "Tanh"),
    "TORA, sigmoid": ([4, 20, 20, 20, 1], "Sigmoid"),
    "unicycle": ([4, 500, 2], "Relu"),
    "VCAS": ([3, 20, 20, 20, 20, 20, 9], "Relu"),
    "single pendulum": ([2, 25, 25, 1], "Relu"),
    "double pendulum": ([4, 25, 25, 2], "Relu"),
    "double pendulum, robust": ([4, 25, 25, 25, 2], "Relu"),
    "airplane": ([12, 100, 100, 20, 6], "Relu"),
    "attitude": ([6, 64, 64, 64, 3], "Sigmoid"),
    "quadrotor": ([12, 64, 64, 64, 3], "Sigmoid"),
    "docking": ([4, 256, 256, 4], "Tanh"),
    "mountain car": ([2, 16, 16, 1], "Tanh"),
}


def write_controllers(folder: Path) -> None:
    """As MATLAB's exporter writes them: an image of one pixel, less its mean, and convolutions over the whole of it."""
    from onnx import TensorProto, helper, numpy_helper

    rng = np.random.default_rng(0)
    for name, (sizes, bend) in CONTROLLERS.items():
        fixed, nodes, last = {"mean": rng.normal(size=(1, sizes[0], 1, 1))}, [], "input_centred"
        nodes.append(helper.make_node("Sub", ["input", "mean"], [last], name="input_Sub"))
        for k, (n, m) in enumerate(pairwise(sizes)):
            fixed |= {f"fc_{k}_W": rng.normal(size=(m, n, 1, 1)) / np.sqrt(n), f"fc_{k}_B": rng.normal(size=m) / 4}
            nodes.append(helper.make_node("Conv", [last, f"fc_{k}_W", f"fc_{k}_B"], [f"fc_{k}"], name=f"fc_{k}"))
            last = f"fc_{k}"
            if k < len(sizes) - 2:
                nodes.append(helper.make_node(bend, [last], [f"act_{k}"], name=f"act_{k}"))
                last = f"act_{k}"
        ports = [
            [helper.make_tensor_value_info(n, TensorProto.FLOAT, [1, c, 1, 1])]
            for n, c in (("input", sizes[0]), (last, sizes[-1]))
        ]
        constants = [numpy_helper.from_array(v.astype(np.float32), n) for n, v in fixed.items()]
        graph = helper.make_graph(nodes, "net", *ports, constants)
        made_of = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 9)], ir_version=4)
        (folder / f"matlab {name}.onnx").write_bytes(made_of.SerializeToString())


def write_examples(folder: Path) -> None:
    """Shapes of the example models of hls4ml."""
    import keras
    from keras import layers

    def dense(*sizes: int, act: str = "relu", end: str = "softmax", norm: bool = False) -> list:
        found: list = []
        for n in sizes[:-1]:
            found += [layers.Dense(n), *([layers.BatchNormalization()] if norm else []), layers.Activation(act)]
        return [*found, layers.Dense(sizes[-1], end)]

    parts: dict[str, tuple[list[int], Callable[[], list]]] = {
        "keras_1layer": ([10], lambda: dense(32, 1, end="sigmoid")),
        "keras_3layer": ([16], lambda: dense(64, 32, 32, 5)),
        "keras_3layer_binary_smaller": ([16], lambda: dense(32, 16, 8, 1, end="sigmoid")),
        "keras_3layer_batch_norm": ([16], lambda: dense(64, 32, 32, 5, norm=True)),
        "keras_3layer_elu": ([16], lambda: dense(64, 32, 32, 5, act="elu")),
        "keras_3layer_selu": ([16], lambda: dense(64, 32, 32, 5, act="selu")),
        "keras_dense_16x100x100x100x5": ([16], lambda: dense(100, 100, 100, 5)),
        "keras_conv1d_small": (
            [10, 4],
            lambda: [layers.Conv1D(8, 3, activation="relu"), layers.Flatten(), *dense(16, 5)],
        ),
        "jetTagger_Conv1D": (
            [16, 7],
            lambda: [
                layers.Conv1D(8, 4, 2, activation="relu"),
                layers.MaxPooling1D(2),
                layers.Flatten(),
                *dense(16, 5),
            ],
        ),
        "keras_conv2d_small": (
            [6, 6, 1],
            lambda: [layers.Conv2D(4, 3, activation="relu"), layers.Flatten(), *dense(5)],
        ),
        "toptagging_GRU": ([8, 6], lambda: [layers.GRU(10), *dense(16, 1, end="sigmoid")]),
        "toptagging_LSTM": ([8, 6], lambda: [layers.LSTM(10), *dense(16, 1, end="sigmoid")]),
        "quickdraw_RNN": ([8, 3], lambda: [layers.SimpleRNN(10), *dense(16, 5)]),
    }
    keras.utils.set_random_seed(1)
    for name, (shape, of) in parts.items():
        model = keras.Sequential([keras.Input(shape), *of()])
        model(np.zeros((1, *shape)))
        model.export(str(folder / f"hls4ml {name}.onnx"), format="onnx", verbose=False)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    for write in (write_torch, write_keras, write_sklearn, write_controllers, write_examples):
        write(Path(sys.argv[1]))
