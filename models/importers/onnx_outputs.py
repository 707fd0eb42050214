"""What of an ONNX model is computed: outputs that are numbers, and the operations that they need."""

from pathlib import Path
from typing import Any

from greygate.models.importers.onnx_file import STANDARD
from greygate.models.importers.onnx_patterns import limited_roots
from greygate.progress import once

ML = "ai.onnx.ml"
SHAPING = ("Identity", "Reshape", "Flatten", "Squeeze", "Unsqueeze")
"""Operations that change no number."""


def needed(model: Any, path: Path | str, quantized: bool) -> Any:
    """The model without what a network has no use for; a line says what was left out, if it was shown.

    A dictionary of probabilities (ZipMap) is what it is made of; a class's name or number is left out, as the largest
    of its probabilities tells it; so is, of a quantized model, a softmax at the end, which changes no order. Operations
    that nothing shown depends on are left out.
    """
    made = type(model)()
    made.CopyFrom(model)
    graph = made.graph
    _plain_maps(graph)
    _numbers(graph, path)
    limited_roots(graph)
    if quantized:
        _without_softmax(graph, path)
    _living(graph)
    return made


def _plain_maps(graph: Any) -> None:
    """Show what a ZipMap reads, in its place."""
    maps = {n.output[0]: n.input[0] for n in graph.node if n.domain == ML and n.op_type == "ZipMap"}
    for tensor in graph.output:
        if tensor.name in maps:
            _declare(tensor, maps[tensor.name])


def _declare(tensor: Any, name: str) -> None:
    """Let an output be that tensor, of floats in any shape."""
    from onnx import TensorProto

    tensor.Clear()
    tensor.name = name
    tensor.type.tensor_type.elem_type = TensorProto.FLOAT
    tensor.type.tensor_type.shape.SetInParent()


def _numbers(graph: Any, path: Path | str) -> None:
    """Keep the outputs of floats and truths, if there are any."""
    from onnx import TensorProto

    floats = (TensorProto.FLOAT, TensorProto.DOUBLE, TensorProto.FLOAT16, TensorProto.BOOL)
    kept = [o for o in graph.output if o.type.tensor_type.elem_type in floats]
    left = [o.name for o in graph.output if o not in kept]
    if kept and left:
        del graph.output[:]
        graph.output.extend(kept)
        given = ", ".join(o.name for o in kept)
        once(f"{path}: output {', '.join(left)} holds whole numbers or words and is left out; what stays is {given}")


def _without_softmax(graph: Any, path: Path | str) -> None:
    at_the_end = {o.name for o in graph.output}
    for node in reversed(graph.node):
        if node.domain not in STANDARD or node.output[0] not in at_the_end or _readers(graph, node) - at_the_end:
            continue
        if node.op_type in SHAPING:
            at_the_end.add(node.input[0])
        elif node.op_type in ("Softmax", "LogSoftmax"):
            what = f"{node.output[0]} is what goes into it, whose largest is the same class"
            once(f"{path}: {node.op_type} at the end is left out, as no format rounds as it does: {what}")
            node.op_type = "Identity"
            del node.attribute[:]


def _readers(graph: Any, node: Any) -> set[str]:
    """What is computed of what a node gives."""
    return {name for n in graph.node if node.output[0] in n.input for name in n.output}


def _living(graph: Any) -> None:
    """Leave out every operation that no output depends on."""
    wanted, living = {o.name for o in graph.output}, []
    for node in reversed(graph.node):
        if wanted.intersection(node.output) or not node.output:
            living.append(node)
            wanted.update(node.input)
            wanted.update(n for a in node.attribute for g in (a.g, *a.graphs) for n in _read(g))
    if len(living) < len(graph.node):
        del graph.node[:]
        graph.node.extend(reversed(living))
        for fixed in [t for t in graph.initializer if t.name not in wanted]:
            graph.initializer.remove(fixed)


def _read(graph: Any) -> set[str]:
    """Names that a graph inside an operation reads, those of its own too."""
    inner = {n for node in graph.node for a in node.attribute for g in (a.g, *a.graphs) for n in _read(g)}
    return inner | {n for node in graph.node for n in node.input} | {o.name for o in graph.output}
