"""Quantized networks by QKeras and Brevitas: every answer of the program beside the tool's own, and its Verilog.

QKeras has powers of two alone, and its answers are the program's in every bit. Brevitas computes with scales of any
size in float32, which near a tie gives the code beside it. Exit code 1 if a bit of the Verilog differs, a model of
QKeras is answered otherwise or refused, or one of Brevitas differs in more than NEAR of its numbers.
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
TOOLS = {"qkeras": 0.0, "brevitas": 2.0**-20}  # difference of an output's range that is none: of float32 sums
NEAR = 0.05


def beside(file: Path, least: float) -> tuple[dict, Case | None]:
    """How many numbers differ from the tool's, by how much of their range, and the program's first steps."""
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
    apart = np.abs(got - y) / max(float(np.ptp(y)), 1e-30)
    return {"numbers": y.size, "differing": int((apart > least).sum()), "most": float(apart.max())}, case


def main(tool: Annotated[str, TOOLS], *, python: Annotated[Path, "interpreter with benchmarks/TOOL.txt"]) -> int:
    rows, counts = [], Counter()
    with scratch() as folder:
        made = [python, ROOT / "benchmarks" / f"{tool}_models.py", folder]
        subprocess.run(made, check=True, stdout=subprocess.PIPE)
        for k, file in enumerate(sorted(folder.glob("*.onnx"))):
            row, case = beside(file, TOOLS[tool])
            if case is not None:
                row["bits"] = sum(bool(v.mismatch) for v in verify_many([case], folder / f"v{k}", seed=1).verdicts)
            rows.append({"model": file.stem, **row})
            counts["refused" if case is None else "other" if row["differing"] else "equal"] += 1
            counts["verified"] += case is not None and not row["bits"]
            print(rows[-1], flush=True)
    total = {k: counts[k] for k in ("equal", "other", "refused", "verified")}
    print(total, flush=True)
    keep("quantized_exports", tool, {"models": len(rows), "total": total, "rows": rows}, tool, "--python", "PYTHON")
    worst = max((r["differing"] / r["numbers"] for r in rows if "numbers" in r), default=0.0)
    wrong = any(r.get("bits") for r in rows) or worst > (NEAR if TOOLS[tool] else 0.0)
    return int(wrong or (tool == "qkeras" and bool(counts["refused"])))
