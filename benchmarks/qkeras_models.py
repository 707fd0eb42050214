"""Quantized networks by QKeras, as qonnx writes them. quantized_exports.py runs this in an interpreter of theirs.

    python qkeras_models.py FOLDER    writes NAME.onnx and NAME.npz: x (N, 16), y (N, outputs) before a softmax

The choices of quantizers are those that the tests of qonnx convert.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnx
import tensorflow as tf
from qkeras import QActivation, QDense, binary, quantized_bits, quantized_relu, ternary
from qonnx.converters import from_keras
from tensorflow.keras.layers import Activation, Input
from tensorflow.keras.models import Model

INPUTS = 16
SAMPLES = 200
GRID = 128  # of the inputs between -1 and 1


def bits(width: int, whole: int, symmetric: int) -> quantized_bits:
    return quantized_bits(width, whole, symmetric, alpha=1)


SPLITS = [(8, 4, 4), (8, 8, 8), (4, 4, 8), (4, 0, 0), (4, 2, 2)]  # bits and whole bits of weights, whole bits of biases
PAIRS = [
    *((bits(w, i, k), bits(8, j, k)) for w, i, j in SPLITS for k in (0, 1)),
    *((bits(2, i, 1), bits(2, i, 1)) for i in (2, 1)),
    (ternary(alpha=1, threshold=0.5), quantized_bits(4, 4)),
    (binary(alpha=1), quantized_bits(4, 4)),
]
"""Quantizers of weights and of biases."""
RELUS = [(8,), (8, 4), (4,), (4, 4), (6, 2)]


def dense(pair: tuple, units: int, name: str, **options: object) -> QDense:
    starts = {
        f"{part}_initializer": tf.keras.initializers.RandomUniform(q.min(), q.max())
        for part, q in zip(("kernel", "bias"), pair, strict=True)
    }
    return QDense(units, kernel_quantizer=pair[0], bias_quantizer=pair[1], name=name, **starts, **options)


def models() -> Iterator[tuple[str, list]]:
    """Name and layers."""
    for k, pair in enumerate(PAIRS):
        yield f"dense_{k}", [dense(pair, 32, "dense_0")]
        between = QActivation("quantized_relu(6,2)", name="act_0")
        yield f"two_dense_{k}", [dense(pair, 32, "dense_0"), between, dense(pair, 32, "dense_1")]
        first = dense(pair, 32, "dense_0", activation=quantized_bits(6, 2, 1, alpha=1.0))
        between = QActivation("quantized_relu(6,4,0)", name="act_0")
        yield f"classifier_{k}", [first, between, dense(pair, 10, "dense_1"), Activation("softmax", name="softmax")]
    pair = bits(4, 0, 1), bits(8, 0, 1)
    for k, relu in enumerate(RELUS):
        yield f"relu_{k}", [QActivation(quantized_relu(*relu), name="act_0")]
        rest = []
        for j in range(2):
            options = {} if j else {"activation": bits(8, 8, 1)}
            rest += [dense(pair, 32, f"dense_{j}", **options), QActivation(quantized_relu(*relu), name=f"act_{j}")]
        last = dense(pair, 10, "dense_2", activation=bits(4, 4, 0), use_bias=False)
        yield f"three_dense_{k}", [*rest, last, Activation("softmax", name="softmax")]


def main(folder: Path) -> None:
    tf.keras.utils.set_random_seed(1)
    rng = np.random.default_rng(1)
    for name, layers in models():
        tensors = [Input(shape=(INPUTS,), name="input")]
        for layer in layers:
            tensors.append(layer(tensors[-1]))
        last = -2 if isinstance(layers[-1], Activation) else -1
        x = (rng.integers(1 - GRID, GRID, (SAMPLES, INPUTS)) / GRID).astype(np.float32)
        np.savez(folder / f"{name}.npz", x=x, y=Model(tensors[0], tensors[last]).predict(x, verbose=0))
        onnx.save(from_keras(Model(tensors[0], tensors[-1]), name, opset=13)[0], folder / f"{name}.onnx")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
