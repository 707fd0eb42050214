"""An ONNX file read and checked, within limits; its tensors and the ports that they become."""

from collections.abc import Iterator, Sequence
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from greygate.errors import InputError, one_line, shown
from greygate.foreign import converted
from greygate.models.importers.builder import word
from greygate.models.network import Port
from greygate.progress import once

if TYPE_CHECKING:
    import onnx

OLDEST = 17  # opset; an older model is written in it first
LARGEST = 16 << 20  # bytes of a file: four million weights
FIELDS = 1 << 19  # of a file: each may become an object of some hundred bytes
NODES = 1_000  # operations, those inside functions each time that they are called
ELEMENTS = 1 << 22  # numbers that all constants together may have: as many as the weights of the largest file
STANDARD = ("", "ai.onnx")
SCANS = 9  # the opset since which Scan has no batches
QONNX = ("qonnx.custom_op.general", "finn.custom_op.general", "onnx.brevitas")
"""Domains of Quant nodes."""


def read(path: Path) -> "onnx.ModelProto":
    """The model of a file, its functions written out where they are called.

    An opset below OLDEST is converted, and a line says so; numbers in files beside it are read. Raises InputError for
    what is no model, is larger than the limits, is newer than onnx, or has numbers elsewhere.
    """
    try:
        import onnx
    except ImportError:
        raise InputError("onnx is not installed; pip install 'greygate[onnx]'") from None
    try:
        if not path.is_file() and path.exists():
            raise InputError(f"{path}: is no file; give an .onnx file")
        if path.stat().st_size > LARGEST:
            raise InputError(f"{path}: larger than {LARGEST >> 20} MiB; a network here has a few hundred weights")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; give an .onnx file") from None
    if not _fits(data, onnx.ModelProto.DESCRIPTOR):
        raise InputError(f"{path}: has more than {FIELDS} parts; a network here has a few hundred weights")
    try:
        model = onnx.load_model_from_string(data)
        _gathered(model, path)
        _declare(model)
        onnx.checker.check_model(model)
    except InputError:
        raise
    except Exception as error:  # of protobuf or of the checker
        raise InputError(f"{path}: is no valid ONNX model ({one_line(' '.join(str(error).split()))[:200]})") from None
    newest = onnx.defs.onnx_opset_version()
    opset = next((o.version for o in model.opset_import if o.domain in STANDARD), OLDEST)
    if opset > newest:
        raise InputError(f"{path}: opset {opset}; the onnx that is installed knows {newest}: pip install -U onnx")
    return _written_out(model if opset >= OLDEST else _newer(model, opset, path), path)


def _newer(model: "onnx.ModelProto", opset: int, path: Path) -> "onnx.ModelProto":
    """The model in opset OLDEST, by onnx's own converter."""
    from onnx import load_model_from_string

    if opset < SCANS and any(getattr(m, "op_type", "") == "Scan" for m in messages(model.graph)):
        raise InputError(f"{path}: Scan of opset {opset} has batches, which the converter loses: export it in {OLDEST}")
    ends = [*model.graph.input, *model.graph.output]
    free = {t.name: t.SerializeToString() for t in ends}
    for tensor in ends:  # the converter wants lengths
        for length in tensor.type.tensor_type.shape.dim:
            length.dim_value = length.dim_value or 1
    try:
        made = load_model_from_string(converted(model.SerializeToString(), OLDEST, path))
    except InputError as error:
        raise InputError(f"{error}; opset {opset} is converted to {OLDEST} first: export it in {OLDEST}") from None
    del made.graph.value_info[:]
    for tensor in (*made.graph.input, *made.graph.output):
        tensor.ParseFromString(free[tensor.name])
    once(f"{path}: opset {opset}, read as {OLDEST} by onnx's own converter")
    return made


def _fits(data: bytes, kind: Any) -> bool:
    """Whether a message of protobuf has no more than FIELDS fields, those of the messages in it too.

    Counted before it is read: two bytes become an object of 150, so a file of 16 MiB would take 3 GB.
    """

    def number(at: int) -> tuple[int, int]:
        found = shift = 0
        while True:
            byte = data[at]
            found, at, shift = found | (byte & 127) << shift, at + 1, shift + 7
            if byte < 128 or shift > 63:
                return found, at

    left, waiting = FIELDS, [(0, len(data), kind)]
    try:
        while waiting:
            at, end, kind = waiting.pop()
            while at < end:
                tag, at = number(at)
                left -= 1
                if left < 0:
                    return False
                if tag & 7 == 0:
                    _, at = number(at)
                elif tag & 7 == 2:
                    length, at = number(at)
                    field = kind.fields_by_number.get(tag >> 3)
                    if field is not None and field.message_type is not None:
                        waiting.append((at, at + length, field.message_type))
                    at += length
                else:
                    at += {1: 8, 5: 4}[tag & 7]
    except (IndexError, KeyError):
        return True  # cut short or of no such kind: protobuf says so
    return True


def messages(message: Any) -> Iterator[Any]:
    """Every message inside one, at any depth."""
    waiting = [message]
    while waiting:
        for field, value in waiting.pop().ListFields():
            if field.message_type is not None:
                inner = [value] if hasattr(value, "ListFields") else list(value)
                yield from inner
                waiting += inner


def _gathered(model: "onnx.ModelProto", path: Path) -> None:
    """Put numbers of files beside the model into it; refuse tensors that are sparse or above the limit."""
    import onnx

    left = LARGEST
    for found in messages(model):
        if isinstance(found, onnx.SparseTensorProto):
            raise InputError(f"{path}: tensor {shown(found.values.name)} is sparse; save it dense")
        if not isinstance(found, onnx.TensorProto):
            continue
        if (count := prod(max(d, 1) for d in found.dims)) > ELEMENTS:
            raise InputError(f"{path}: tensor {shown(found.name)} has {count} numbers; at most {ELEMENTS} are read")
        if found.external_data or found.data_location == onnx.TensorProto.EXTERNAL:
            data = _beside(found, path, left)
            left -= len(data)
            found.ClearField("external_data")
            found.data_location, found.raw_data = onnx.TensorProto.DEFAULT, data


def _beside(tensor: Any, path: Path, most: int) -> bytes:
    """The bytes of a tensor in a file in the folder of the model, or below. Raises InputError for any other place."""
    told = {entry.key: entry.value for entry in tensor.external_data}
    what = f"{path}: tensor {shown(tensor.name)}: its numbers are in {shown(told.get('location', ''))}"
    folder = path.parent.resolve()
    try:
        file = (folder / told.get("location", "")).resolve()
        start, length = int(told.get("offset") or 0), int(told.get("length") or -1)
    except (ValueError, OSError, RuntimeError):
        raise InputError(f"{what}, which is no place in a file; save the model in one file") from None
    if not file.is_relative_to(folder) or start < 0:
        raise InputError(f"{what}, which is not beside the model; save the model in one file")
    if not file.is_file():
        raise InputError(f"{what}, which is missing; copy it beside the model, or save the model in one file")
    length = file.stat().st_size - start if length < 0 else length
    if length > most:
        raise InputError(f"{what}, {length} bytes; all together may have {LARGEST >> 20} MiB")
    try:
        with file.open("rb") as opened:
            opened.seek(start)
            data = opened.read(length)
    except OSError as error:
        raise InputError(f"{what}: {error.strerror or error}; check that file") from None
    if len(data) != length:
        raise InputError(f"{what}, which ends before them; copy it once more")
    return data


def _declare(model: "onnx.ModelProto") -> None:
    """Version 1 of a domain of Quant nodes that QKeras's exporter uses and does not name.

    Older files list their constants among the inputs, too; many do not.
    """
    import onnx

    model.ir_version = max(model.ir_version, onnx.IR_VERSION_2019_1_22)
    for tensor in model.graph.output:
        if tensor.type.HasField("tensor_type"):
            tensor.type.tensor_type.shape.SetInParent()  # some leave it out
    named = {o.domain for o in model.opset_import}
    for domain in {n.domain for n in model.graph.node} & {*QONNX} - named:
        model.opset_import.append(onnx.helper.make_opsetid(domain, 1))


def _written_out(model: "onnx.ModelProto", path: Path) -> "onnx.ModelProto":
    """The model without functions of its own; its nodes are counted before, as functions that call one another grow."""
    from onnx import AttributeProto, inliner

    functions = {(f.domain, f.name, f.overload): f for f in model.functions}
    counts: dict[tuple, int] = {}

    def counted(nodes: Sequence[Any], above: tuple) -> int:
        total = 0
        for node in nodes:
            called = (node.domain, node.op_type, node.overload)
            if called in above:
                raise InputError(f"{path}: function {shown(node.op_type)} calls itself; export the model without it")
            if called in functions and called not in counts:
                counts[called] = counted(functions[called].node, (*above, called))
            total += counts.get(called, 1)
            for a in node.attribute:
                graphs = [a.g] if a.type == AttributeProto.GRAPH else a.graphs
                total += sum(counted(g.node, above) for g in graphs)
        return total

    if clash := [f.name for f in model.functions if f.domain in STANDARD]:
        raise InputError(f"{path}: function {shown(clash[0])} is in the domain of ONNX; give it one of its own")
    if (count := counted(model.graph.node, ())) > NODES:
        raise InputError(f"{path}: {count} operations; at most {NODES} are read")
    if not functions:
        return model
    try:
        return inliner.inline_local_functions(model)
    except Exception as error:
        raise InputError(f"{path}: its functions cannot be written out ({one_line(str(error))[:100]})") from None


def shape(tensor: Any, path: Path | str, entering: bool) -> list[int | str]:
    """Of an input or output: lengths of its axes, or names where they are free, "" if one has none.

    Raises InputError for what is no tensor; for an input also if it is not of floats.
    """
    from onnx import TensorProto

    if not tensor.type.HasField("tensor_type"):
        raise InputError(f"{path}: {tensor.name} is no tensor; a network has ports of numbers")
    kind = tensor.type.tensor_type.elem_type
    if entering and kind not in (TensorProto.FLOAT, TensorProto.DOUBLE):
        raise InputError(
            f"{path}: {tensor.name} is of {TensorProto.DataType.Name(kind)}, in which numbers are rounded otherwise "
            "than here; export the model in FLOAT or DOUBLE"
        )
    return [max(d.dim_value, 0) or d.dim_param for d in tensor.type.tensor_type.shape.dim]


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
    """The numbers of a constant, in their own type. Raises InputError if it holds none."""
    from onnx import numpy_helper

    try:
        found = numpy_helper.to_array(tensor)
        found.astype(float)
    except Exception as error:  # a tensor of texts, or one whose bytes and shape do not agree
        raise InputError(f"tensor {shown(tensor.name)}: holds no numbers ({one_line(str(error))[:100]})") from None
    return found
