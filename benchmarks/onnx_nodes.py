"""ONNX beside onnxruntime: the node tests of the onnx package, and every choice of options of what is carried.

An answer is right that is within 1e-6 of onnxruntime's (of ONNX's own reference where onnxruntime lacks the operator),
of the largest answer or of 1. Exit code 1 if one is wrong without a word, or ends in a traceback.
"""

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Annotated

import onnx
from onnx_cases import AGREED, OPSETS, Case, cases, judged, node_cases

from greygate.models.importers.onnx_operations import FUNCTIONS

from .made import keep
from .shared import scratch

TAKES = "not timed"

KINDS = ("right", "refused", "wrong", "traceback", "no model")
FEWER = 50  # of the choices of operators that an opset does not change, every fiftieth is taken
FAMILIES = {"RNN": "RNN", "GRU": "GRU", "LSTM": "LSTM", "Scan": "Scan"}
ELEMENTWISE = {
    *("Tanh", "Sigmoid", "Softsign", "Relu", "LeakyRelu", "Abs", "HardSigmoid", "Clip", "Add", "Sub", "Mul", "Div"),
    *("Neg", "Sum", "Pow", "Identity", "Dropout", "Cast", "Scaler"),
}


def family(op: str) -> str:
    """The row of the table of an operator."""
    if op in FAMILIES:
        return op
    if op == "of":
        return "of constants alone"
    if op in ELEMENTWISE:
        return "elementwise"
    return "other, carried" if op in FUNCTIONS else "other"


def chosen() -> Iterator[tuple[str, Case]]:
    """Every choice of options in the oldest two opsets; in each newer one those of operators that it changes."""
    for opset in OPSETS:
        for k, case in enumerate(cases(opset)):
            op = case.name.split()[0]
            if opset <= OPSETS[1] or k % FEWER == opset % FEWER or _changed(op, opset):
                yield family(op), case


def _changed(op: str, opset: int) -> bool:
    try:
        return onnx.defs.get_schema(op, opset).since_version == opset
    except onnx.defs.SchemaError:
        return False


def offered() -> Iterator[tuple[str, Case]]:
    for case in node_cases():
        kinds = {n.op_type for n in case.model.graph.node}
        rows = {family(k) for k in kinds}
        yield (rows.pop() if len(rows) == 1 else "other, carried" if kinds <= FUNCTIONS.keys() else "other"), case


def counted(given: Iterable[tuple[str, Case]]) -> dict:
    """Row -> kind -> how many; and those that are wrong."""
    rows: dict[str, Counter] = {}
    bad = []
    with scratch() as folder:
        for row, case in given:
            kind, said = judged(case, folder / "case.onnx")
            rows.setdefault(row, Counter())[kind] += 1
            if kind in ("wrong", "traceback"):
                bad.append(f"{case.name}: {kind}: {said}")
                print(bad[-1], flush=True)
    total = sum(rows.values(), Counter())
    return {
        "agreed": AGREED,
        "opsets": [OPSETS[0], OPSETS[-1]],
        "rows": [{"what": row, **{k: found[k] for k in KINDS}} for row, found in sorted(rows.items())],
        "total": {k: total[k] for k in KINDS},
        "bad": bad,
    }


GIVEN = {"nodes": offered, "options": chosen}


def main(*parts: Annotated[str, GIVEN]) -> int:
    bad = []
    for name in parts or GIVEN:
        found = counted(GIVEN[name]())
        print(name, found["total"], flush=True)
        keep("onnx_nodes", name, found)
        bad += found["bad"]
    return int(bool(bad))
