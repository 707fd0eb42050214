"""Models by the exporters of PyTorch (both), Keras and scikit-learn, MATLAB-shaped controllers, the shapes of hls4ml.

Each is right beside onnxruntime, refused, or wrong; one that is right is compiled at 16 bits and its Verilog compared
with the emulator. Exit code 1 if one is wrong, ends in a traceback, or differs in a bit.
"""

from collections import Counter
from pathlib import Path

import numpy as np
from exported_models import AGREED, STEPS, judged, made
from imported_models import signal

from greygate.compiler.pipeline import compile_network, fixed_error
from greygate.compiler.quantize import Formats
from greygate.emulator.engine import run
from greygate.errors import InputError
from greygate.hardware.verify import Case, Scenario, verify_many
from greygate.models.importers.onnx_graph import from_onnx
from greygate.models.training.record import Record

from .made import keep
from .shared import VERILATOR, scratch

TAKES = "half an hour"
NEEDS = VERILATOR

WIDTH = 16
RECORDED = 300
SEEN = 20  # steps in Verilator
LARGEST = 20_000  # weights of a design in Verilator, whose build takes a minute there


def compiled(file: Path, k: int) -> tuple[dict, Case | None]:
    """What fixed point errs by, of an output's range, and in how many steps its largest output is another."""
    network = from_onnx(file, name=f"model_{k}")
    x = signal(RECORDED, len(network.inputs))
    given = {p.name: x[:, j] for j, p in enumerate(network.inputs)}
    record = Record(given, network.run(given))
    try:
        program = compile_network(network, {"run": record}, Formats(WIDTH)).program
    except InputError as error:
        return {"compiled": str(error)}, None
    error, wanted = (
        np.column_stack([d[p.name] for p in network.outputs]) for d in (fixed_error(program, record), record.targets)
    )
    weights = sum(o.weights.size for o in program.operations if o.op == "affine")
    found = {
        "compiled": "",
        "weights": int(weights),
        "error": float((np.abs(error).max(0) / np.maximum(np.ptp(wanted, 0), 1e-12)).max()),
        "another_largest": float(((wanted + error).argmax(1) != wanted.argmax(1)).mean()),
    }
    if weights > LARGEST:
        return found, None
    codes = program.encode(given)[:SEEN]
    answers = run(program, codes)
    return found, Case(program, {"run": Scenario(codes, answers.outputs, answers.states)}, "folded")


def main() -> int:
    rows, counts = [], Counter()
    with scratch() as folder:
        for k, file in enumerate(made(folder)):
            verdict, said = judged(file)
            counts[verdict] += 1
            row = {"model": file.stem, "verdict": verdict, "said": said.replace(f"{folder}/", "")}
            if verdict == "right":
                found, case = compiled(file, k)
                row |= found
                counts["compiled"] += not found["compiled"]
                if case is not None:
                    bits = [v for v in verify_many([case], folder / f"v{k}", seed=1).verdicts if v.mismatch]
                    row["differing"] = len(bits)
                    counts["verified"] += not bits
                    counts["differing"] += bool(bits)
            rows.append(row)
            print(row, flush=True)
    kinds = ("right", "refused", "wrong", "traceback", "compiled", "verified", "differing")
    total = {k: counts[k] for k in kinds}
    print(total, flush=True)
    settings = {"steps": STEPS, "agreed": AGREED, "width": WIDTH, "largest": LARGEST}
    keep("exported", "models", {**settings, "total": total, "rows": rows})
    return int(bool(counts["wrong"] + counts["traceback"] + counts["differing"]))
