"""Adders of constant matrices: our solver beside alkaid's on the same integer matrices.

MATRICES.json holds `cases`: name, bits, matrix (inputs, outputs; y = x @ M). Without it, random matrices are solved.
The peer is alkaid's `cmvm_solve` with its defaults, in this run and in the interpreter that --peers names; without it,
the figures that the file brings are shown. Adders are additions and subtractions; `cost` is alkaid's own estimate of
LUTs, `bits` ours; seconds are of the processor. build/adders.json keeps what it printed.
"""

import json
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np

from greygate.compiler.adders import Graph, solve

from .made import ROOT
from .shared import stopwatch

TAKES = "not timed"
OUT = ROOT / "build" / "adders.json"
WIDTH = 16  # bits of every input code
SIZES = ((8, 8), (16, 16), (32, 32), (100, 100))  # random matrices for growth: 64 to 10,000 weights
GROWTH_BITS = 12

PEER = """
import json, sys, time
import numpy as np
from alkaid.cmvm import cmvm_solve
found = []
for matrix in json.load(sys.stdin):
    kernel = np.array(matrix, dtype=np.float32)
    began = time.process_time()
    stages = cmvm_solve(kernel, qintervals=[(-32768.0, 32767.0, 1.0)] * len(kernel))
    seconds = time.process_time() - began
    ops = [o for s in stages for o in s.ops]
    cost = float(sum(o.cost for o in ops))
    found.append({"adders": sum(o.opcode in (0, 1) for o in ops), "cost": cost, "seconds": seconds})
json.dump(found, sys.stdout)
"""


def main(
    matrices: Path | None = None,
    *,
    peers: Annotated[str, "a Python interpreter that imports alkaid"] = "",
    bits: Sequence[int] = (16, 12, 10, 8),
    efforts: Sequence[float] = (0.0, 1.0),
) -> None:
    solve(np.array([[5], [45], [225]]), [WIDTH])  # numba compiles, or reads what it compiled
    result: dict = {"width": WIDTH, "cases": [], "sums": [], "growth": []}
    if matrices:
        cases = [c for c in json.loads(matrices.read_text(encoding="utf-8"))["cases"] if c["bits"] in bits]
        found = beside(peers, [c["matrix"] for c in cases]) if peers else [None] * len(cases)
        result["cases"] = [measured(c, efforts, p) for c, p in zip(cases, found, strict=True)]
        result["sums"] = sums(result["cases"], efforts)
    save(result)
    for size in SIZES:
        result["growth"].append(growth(*size, efforts))
        save(result)


def save(result: dict) -> None:
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


def measured(case: dict, efforts: Sequence[float], peer: dict | None) -> dict:
    """One matrix by each effort, beside the peer in this run or, without one, as the file has it."""
    weights = np.array(case["matrix"]).T
    row = {"name": case["name"], "bits": case["bits"], "shape": list(weights.shape), "ours": {}}
    for effort in efforts:
        row["ours"][f"{effort:g}"] = figures(weights, effort)
    if peer:
        row["alkaid"] = {k: peer[k] for k in ("adders", "cost")} | {"seconds": round(peer["seconds"], 4)}
    else:
        row["alkaid"] = {k: case[k] for k in ("adders", "cost", "seconds") if k in case}
    print(f"{row['name']:24} {row['bits']:2} {row['ours']} alkaid {row['alkaid']}", flush=True)
    return row


def figures(weights: np.ndarray, effort: float) -> dict:
    watch = stopwatch(time.process_time)
    graph: Graph = solve(weights, [WIDTH] * weights.shape[1], effort=effort)
    seconds = watch(3)
    return {
        "adders": graph.adders,
        "bits": graph.adder_bits,
        "depth": graph.depth,
        "negations": sum(o.negate for o in graph.outputs),
        "seconds": seconds,
    }


def sums(cases: list[dict], efforts: Sequence[float]) -> list[dict]:
    """The sums over the matrices of each network (the name before the first dot) and number of bits."""
    found = []
    for network, bits in dict.fromkeys((c["name"].split(".")[0], c["bits"]) for c in cases):
        own = [c for c in cases if c["name"].split(".")[0] == network and c["bits"] == bits]
        row = {"network": network, "bits": bits, "alkaid": added([c["alkaid"] for c in own])}
        for effort in efforts:
            row[f"effort {effort:g}"] = added([c["ours"][f"{effort:g}"] for c in own])
        print(row, flush=True)
        found.append(row)
    return found


def added(rows: list[dict]) -> dict:
    return {k: round(sum(r[k] for r in rows), 3) for k in rows[0] if k != "depth"}


def beside(interpreter: str, matrices: list) -> list[dict]:
    """What alkaid finds for each matrix."""
    command = [interpreter, "-c", PEER]
    answer = subprocess.run(command, input=json.dumps(matrices), capture_output=True, text=True, check=True)
    return json.loads(answer.stdout)


def growth(rows: int, columns: int, efforts: Sequence[float]) -> dict:
    """Seconds and adders of a random matrix."""
    draw = np.random.default_rng(rows)
    weights = draw.integers(-(1 << (GROWTH_BITS - 1)), 1 << (GROWTH_BITS - 1), (rows, columns))
    row = {"weights": rows * columns, "bits": GROWTH_BITS}
    row |= {f"effort {e:g}": figures(weights, e) for e in efforts}
    print(row, flush=True)
    return row
