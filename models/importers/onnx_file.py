"""An ONNX file read and checked; its tensors and the ports that they become."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from greygate.errors import InputError, one_line, shown
from greygate.models.importers.builder import word
from greygate.models.network import Port

if TYPE_CHECKING:
    import onnx

OLDEST = 17  # opset
LARGEST = 64 << 20  # bytes of a file


def read(path: Path) -> "onnx.ModelProto":
    """The model of a file. Raises InputError for what is no model, is too large, or has an older opset."""
    try:
        import onnx
    except ImportError:
        raise InputError("onnx is not installed; pip install 'greygate[onnx]'") from None
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(f"{path}: larger than {LARGEST >> 20} MiB; a network here has a few hundred weights")
        model = onnx.load(path, load_external_data=False)
        onnx.checker.check_model(model)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; give an .onnx file") from None
    except InputError:
        raise
    except Exception as error:  # of protobuf or of the checker
        raise InputError(f"{path}: is no valid ONNX model ({one_line(' '.join(str(error).split()))[:200]})") from None
    opset = next((o.version for o in model.opset_import if o.domain in ("", "ai.onnx")), OLDEST)
    if opset < OLDEST:
        raise InputError(f"{path}: opset {opset}; convert it to {OLDEST} or newer (onnx.version_converter)")
    if outside := [t.name for t in model.graph.initializer if t.external_data]:
        raise InputError(f"{path}: the numbers of {outside[0]} are in another file; save the model in one file")
    return model


def shape(tensor: Any, path: Path | str) -> tuple[int, ...]:
    """Of an input or output; every axis but the last is 1. Raises InputError for what is no tensor."""
    if not tensor.type.HasField("tensor_type"):
        raise InputError(f"{path}: {tensor.name} is no tensor; a network has ports of numbers")
    dims = [d.dim_value for d in tensor.type.tensor_type.shape.dim]
    return (*(1 for _ in dims[:-1]), *(max(d, 1) for d in dims[-1:]))


def ports_of(name: str, shape: Sequence[int]) -> list[str]:
    """Names for the numbers of a tensor; what no port may be called, such as Keras's "30", is made a word."""
    count, name = int(np.prod(shape)), word(name)
    return [name] if count == 1 else [f"{name}_{k + 1}" for k in range(count)]


def first(ports: list[Port], count: int, where: str) -> list[Port]:
    """The first ports that hold so many numbers; they are removed."""
    found: list[Port] = []
    while sum(p.size for p in found) < count and ports:
        found.append(ports.pop(0))
    if sum(p.size for p in found) != count:
        raise InputError(f"{where}: holds {count} numbers; name a port for each, and no more")
    return found


def array(tensor: Any) -> np.ndarray:
    """The numbers of a constant, float64. Raises InputError if it holds none."""
    from onnx import numpy_helper

    try:
        return np.asarray(numpy_helper.to_array(tensor), float)
    except Exception as error:  # a tensor of texts, or one whose bytes and shape do not agree
        raise InputError(f"tensor {shown(tensor.name)}: holds no numbers ({one_line(str(error))[:100]})") from None
