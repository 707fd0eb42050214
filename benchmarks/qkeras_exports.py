"""Quantized networks by QKeras, as qonnx writes them: every answer of the program beside QKeras's own, and its Verilog.

Exit code 1 if a number or a bit differs, or a model is refused.
"""

import subprocess
from collections import Counter
from pathlib import Path
from typing import Annotated

import numpy as np

from greygate.compiler.declared import declared_program
from greygate.emulator.engine import run
from greygate.errors import InputError
from greygate.hardware.verify import Case, Scenario, verify_many
from greygate.models.importers.files import load_quantized

from .made import ROOT, keep
from .shared import VERILATOR, scratch

TAKES = "ten minutes"
NEEDS = VERILATOR

SEEN = 20  # steps in Verilator


def beside(file: Path) -> tuple[dict, Case | None]:
    """How many numbers differ from QKeras's, and the program's first steps."""
    with np.load(file.with_suffix(".npz")) as told:
        x, y = told["x"].astype(float), told["y"].astype(float)
    try:
        quantized = load_quantized(file)
        given = {p.name: x[:, k] for k, p in enumerate(quantized.network.inputs)}
        program = declared_program(quantized, reach={n: float(np.abs(v).max()) for n, v in given.items()})
    except InputError as error:
        return {"refused": str(error)}, None
    codes = program.encode(given)
    answers = run(program, codes)
    found = program.decode(answers.outputs)
    got = np.column_stack([found[p.name] for p in program.outputs])
    case = Case(program, {"run": Scenario(codes[:SEEN], answers.outputs[:SEEN], answers.states[:SEEN])}, "folded")
    return {"numbers": y.size, "differing": int((got != y).sum())}, case


def main(*, python: Annotated[Path, "interpreter with benchmarks/qkeras.txt"]) -> int:
    rows, counts = [], Counter()
    with scratch() as folder:
        subprocess.run([python, ROOT / "benchmarks" / "qkeras_models.py", folder], check=True, capture_output=True)
        for k, file in enumerate(sorted(folder.glob("*.onnx"))):
            row, case = beside(file)
            if case is not None:
                row["bits"] = sum(bool(v.mismatch) for v in verify_many([case], folder / f"v{k}", seed=1).verdicts)
            rows.append({"model": file.stem, **row})
            counts["refused" if case is None else "other" if row["differing"] else "equal"] += 1
            counts["verified"] += case is not None and not row["bits"]
            print(rows[-1], flush=True)
    total = {k: counts[k] for k in ("equal", "other", "refused", "verified")}
    print(total, flush=True)
    keep("qkeras_exports", "models", {"models": len(rows), "total": total, "rows": rows}, "--python", "PYTHON")
    return int(total["verified"] < len(rows) or bool(total["other"]))
