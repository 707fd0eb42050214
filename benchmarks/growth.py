"""How the time grows with the network: compiling, writing both designs, synthesizing the folded one, and emulating.

Networks of two layers of tanh with 10 to 10,000 weights are compiled, written folded and parallel (with the adders that
its sums take), synthesized folded on ECP5 and emulated; one of 100,000 weights is compiled and written folded. Seconds
of the wall clock, and steps a second of the emulator.
"""

from collections.abc import Sequence

import numpy as np

from greygate.compiler.adders import solve
from greygate.compiler.dataflow import Dataflow
from greygate.compiler.emit import emit
from greygate.compiler.pipeline import compile_network
from greygate.compiler.targets import Design
from greygate.emulator.engine import run
from greygate.emulator.program import Program
from greygate.hardware.synthesis import synthesize
from greygate.models.layer import Layer, Port
from greygate.models.network import Network
from greygate.models.training.record import Record

from .made import store
from .shared import VERILATOR, Limit, scratch, stopwatch

TAKES = "two minutes"
THREADS = "all"
NEEDS = VERILATOR
WEIGHTS = (10, 100, 1_000, 10_000, 100_000)
SYNTHESIZED = 10_000  # weights up to which a design is synthesized and emulated
STEPS = 2_000  # of the record that sets the ranges
EMULATED = 20_000_000  # products that are emulated, in as many steps as that makes
INPUTS = 4
MULTIPLIERS = 4


def network(weights: int) -> tuple[Network, Record]:
    """4-n-n-1 with about that many weights, but at least one neuron; and its own output."""
    size = max(1, round((-(INPUTS + 1) + ((INPUTS + 1) ** 2 + 4 * weights) ** 0.5) / 2))
    rng = np.random.default_rng(weights)

    def dense(rows: int, columns: int, activation: str, port: str) -> Layer:
        w = rng.normal(size=(rows, columns)) / columns**0.5
        return Layer({port: w}, 0.1 * rng.normal(size=rows), activation)

    made = Network(f"grown_{weights}", [Port("x", size=INPUTS)], [Port("y")])
    made.add("first", dense(size, INPUTS, "tansig", "x"))
    made.add("second", dense(size, size, "tansig", "first"))
    made.add("last", dense(1, size, "linear", "second"))
    for source, target in (("x", "first.x"), ("first", "second.first"), ("second", "last.second"), ("last", "y")):
        made.connect(source, target)
    inputs = {"x": rng.uniform(-1, 1, size=(STEPS, INPUTS))}
    return made, Record(inputs, made.run(inputs))


def parallel(program: Program) -> dict[str, float]:
    """Seconds in which the parallel design is written, and its adders."""
    with scratch() as folder:
        watch = stopwatch()
        emit(program, folder, "parallel")
        seconds = watch(2)
    adders = sum(sums.graph.adders for sums in Dataflow(program, Design()).sums.values())
    return {"parallel_emit_s": seconds, "adders": adders}


def grown(weights: int, limit: float) -> dict[str, float]:
    """Figures of one size."""
    made, record = network(weights)
    found: dict[str, float] = {"weights": sum(w.size for n, w in made.parameters().items() if not n.endswith("bias"))}
    watch = stopwatch()
    program = compile_network(made, {"grid": record}).program
    found["compile_s"] = watch(2)
    with scratch() as folder:
        watch = stopwatch()
        emit(program, folder, "folded", Design(multipliers=MULTIPLIERS))
        found["emit_s"] = watch(2)
        if weights > SYNTHESIZED:
            return found
        found |= parallel(program)
        found |= {f"yosys_{k}": v for k, v in synthesize(folder, program.name, "ecp5", limit=limit).items()}
    codes = program.encode(record.inputs)
    many = np.tile(codes, (max(1, EMULATED // found["weights"] // STEPS), 1))
    run(program, codes, states=False)
    watch = stopwatch()
    run(program, many, states=False)
    found["steps_per_s"] = round(len(many) / watch())
    return found


def main(*, weights: Sequence[int] = WEIGHTS, limit: Limit = 300.0) -> None:
    solve(np.array([[5], [45], [225]]), [8])  # numba compiles, or reads what it compiled
    rows = []
    for size in weights:
        rows.append(grown(size, limit))
        print(rows[-1], flush=True)
    store("growth", rows)
