"""What exporters write as several operations, as one that a network has."""

from typing import Any

import numpy as np

from greygate.models.importers.onnx_file import array

SAME = ("Cast", "Identity")
"""Operations that change no float."""


def limited_roots(graph: Any) -> None:
    """Let min(1 / sqrt(v), c), as Keras writes a unit norm, be 1 / sqrt(max(v, 1 / c^2)): it never divides by 0."""
    from onnx import helper, numpy_helper

    if not any(node.op_type == "Min" for node in graph.node):
        return
    made = {n: node for node in graph.node for n in node.output}
    fixed = {t.name: t for t in graph.initializer}
    fixed |= {n.output[0]: a.t for n in graph.node if n.op_type == "Constant" for a in n.attribute if a.name == "value"}
    readers: dict[str, int] = {}
    for name in (*(o.name for o in graph.output), *(n for node in graph.node for n in node.input)):
        readers[name] = readers.get(name, 0) + 1

    def number(name: str) -> float:
        found = array(fixed[name]) if name in fixed else np.zeros(2)
        return float(found.reshape(())) if found.size == 1 else np.nan

    def alone(name: str, kind: str) -> Any:
        """The operation of that kind that gives a value which nothing else reads; else None."""
        while name in made and readers[name] == 1 and made[name].op_type in SAME:
            name = made[name].input[0]
        return made[name] if name in made and readers[name] == 1 and made[name].op_type == kind else None

    found: dict[str, tuple[str, str]] = {}  # result of a root -> of the limit, its floor
    nodes = []
    for node in graph.node:
        for of, end in (node.input, reversed(node.input)) if node.op_type == "Min" and len(node.input) == 2 else ():
            inverse, limit = alone(of, "Div"), number(end)
            root = alone(inverse.input[1], "Sqrt") if inverse and number(inverse.input[0]) == 1 else None
            if root is None or not limit > 0:
                continue
            floor = f"{node.output[0]}_floor"
            graph.initializer.append(numpy_helper.from_array(np.array(limit**-2.0, array(fixed[end]).dtype), floor))
            found[root.output[0]] = node.output[0], floor
            node = helper.make_node("Identity", [of], [node.output[0]], name=node.name)
            break
        nodes.append(node)
    del graph.node[:]
    for node in nodes:
        if node.output and node.output[0] in found:
            name, floor = found[node.output[0]]
            above = helper.make_node("Max", [node.input[0], floor], [f"{name}_above"], name=f"{node.name}_floor")
            graph.node.append(above)
            node.input[0] = above.output[0]
        graph.node.append(node)
