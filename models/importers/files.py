"""A network from a file of another tool, by the ending of its name."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from greygate.errors import InputError
from greygate.models.importers.beside import Beside, Run, beside
from greygate.models.importers.builder import port
from greygate.models.importers.matlab import from_matlab
from greygate.models.importers.onnx_graph import from_onnx, from_qonnx, imported
from greygate.models.importers.qonnx import Quantized
from greygate.models.network import Network
from greygate.reading import line, listed, named, read_toml, table

ENDINGS = (".onnx", ".mat")
TORCH = "call greygate.from_torch in your program, or torch.onnx.export"
SKLEARN = "write skl2onnx.to_onnx(model, X[:1]).SerializeToString() into an .onnx file"
KERAS = "write model.export('model.onnx', format='onnx') in Keras 3, or tf2onnx.convert --keras"
ELSEWHERE: Mapping[str, str] = {
    **dict.fromkeys((".pt", ".pth", ".pt2", ".ckpt"), TORCH),
    **dict.fromkeys((".pkl", ".pickle", ".joblib"), SKLEARN),
    **dict.fromkeys((".keras", ".h5"), KERAS),
    ".tflite": "write python -m tf2onnx.convert --tflite FILE --output model.onnx",
    ".pb": "write python -m tf2onnx.convert --graphdef FILE --inputs x:0 --outputs y:0 --output model.onnx",
    ".pdmodel": "write paddle2onnx --model_dir FOLDER --save_file model.onnx",
    ".mlmodel": "write onnxmltools.convert_coreml",
    ".nnet": "write it as ONNX by NNet's own writeNNet2ONNX",
}
"""Files that may hold code, or that only their own tool reads -> how to have ONNX of one."""


def foreign(path: str) -> bool:
    """Whether a file of that name is read here, or refused here."""
    return path.lower().endswith((*ENDINGS, *ELSEWHERE))


def load(path: Path | str) -> Network:
    """Read a network of another tool.

    Beside model.onnx, model.ports.toml may name its ports and states: inputs = ["u [V]"], outputs = ["y [m]"],
    state = { h = "h_next" }. Raises InputError for a file that holds code, and as the importers.
    """
    path = Path(path)
    if (how := ELSEWHERE.get(path.suffix.lower())) is not None:
        raise InputError(f"{path}: may hold code, or needs its own tool; for ONNX of it {how}")
    if path.suffix.lower() == ".mat":
        return from_matlab(path)
    return from_onnx(path, **_told(path))


def load_quantized(path: Path | str) -> Quantized | None:
    """A QONNX model with the formats of its signals; None for any other file. Raises InputError as `load`."""
    path = Path(path)
    if path.suffix.lower() != ".onnx":
        return None
    return from_qonnx(path, **_told(path))


def compared(path: Path | str, inputs: Mapping[str, np.ndarray], rounded: Run | None = None) -> Beside | None:
    """A model beside its network over a recording, as `beside`; None for a file that no other program here runs.

    inputs: port of the network -> (N,), in its unit. rounded: as of `beside`. Raises InputError as `load`.
    """
    path = Path(path)
    if path.suffix.lower() != ".onnx":
        return None
    return beside(imported(path, **_told(path)), path, inputs, rounded)


def _told(path: Path) -> dict[str, Any]:
    """What the file of ports beside a model says, if there is one: inputs, outputs, state."""
    names = path.with_suffix(".ports.toml")
    kinds = {"inputs": listed(line), "outputs": listed(line), "state": named(line, line)}
    told = table(read_toml(names, "name the ports"), f"{names}:", {}, kinds) if names.exists() else {}
    return told | {key: [port(text) for text in told[key]] for key in ("inputs", "outputs") if key in told}
