"""Closed-loop steps a second of the emulator, one scenario and many, beside Verilator, alkaid and da4ml in one run.

The compiled cylinder network, as the engine, the parallel design in Verilator and the interpreter run it; and the flow
network of flow_equal.py, whose peers take all steps of all scenarios at once: it has no states. Medians of wall and of
processor time; the load of the machine stands beside them.
"""

import os
from pathlib import Path

import numpy as np

from greygate.compiler.pipeline import compile_network
from greygate.emulator.engine import run
from greygate.emulator.interpreter import interpret
from greygate.emulator.program import Program
from greygate.machines.catalog import entry

from . import shared
from .flow import PEERS, arrays, of_peer
from .flow_designs import DESIGNS, PEER_INDEX, PEER_WIDTH, smallest
from .flow_equal import for_peers
from .flow_peers import rates
from .made import keep
from .shared import VERILATOR, scratch
from .verilator_bench import measure

TAKES = "five minutes"
NEEDS = VERILATOR
THREADS = "all"

BATCHES = (1, 100, 1000)
STEPS = 1000  # of each scenario
SLOW_STEPS, LONG = 500, 100_000  # for the interpreter; for Verilator, seconds


def scenarios(codes: np.ndarray, count: int) -> np.ndarray:
    """(count, STEPS, columns): stretches of a recording, each from another step on."""
    starts = np.random.default_rng(0).integers(0, len(codes) - STEPS, count)
    return np.stack([codes[start : start + STEPS] for start in starts])


def emulated(program: Program, codes: np.ndarray) -> dict:
    """The engine at each size of a batch, the parallel design in Verilator, and the interpreter."""
    found = {}
    for count in BATCHES:
        batch = scenarios(codes, count)
        found[f"engine, {count}"] = rates(lambda batch=batch: run(program, batch, states=False), count * STEPS)
        few = interpret(program, batch[-2:, :SLOW_STEPS])
        assert np.array_equal(run(program, batch, states=False).outputs[-2:, :SLOW_STEPS], few.outputs)
    answer = run(program, codes).outputs
    found["verilator, 1"] = {"cpu": measure(program, codes, LONG, expected=answer)["steps_per_second"]}
    found["interpreter, 1"] = rates(lambda: interpret(program, codes[:SLOW_STEPS]), SLOW_STEPS)
    return found


def peers(program: Program, python: Path) -> dict:
    """The peers with our weights and formats, on as many samples."""
    found, sizes = {}, [count * STEPS for count in BATCHES]
    for package in PEERS if python.exists() else ():
        with scratch() as folder:
            words = (package, folder, PEER_INDEX, PEER_WIDTH, "--rates", *sizes)
            told = of_peer(python, *words, data=for_peers(program))
        found |= {f"{package}, {count}": told[str(n)] for count, n in zip(BATCHES, sizes, strict=True)}
    return found


def main(*, peers_at: shared.Peers = shared.PEERS) -> None:
    chosen = entry("valve_cylinder")
    records = chosen.records()
    cylinder = compile_network(chosen.network(), records).program
    found = {"valve_cylinder": emulated(cylinder, cylinder.encode(records["training"].inputs))}
    flow = smallest(*DESIGNS["coarse"]).program
    x = dict(zip(("u", "p"), arrays()["x"].T, strict=True))
    found["flow"] = emulated(flow, flow.encode(x)) | peers(flow, peers_at)
    keep("engine", "rates", {"steps": STEPS, "load": os.getloadavg(), **found})
    for name, rows in found.items():
        for row, told in rows.items():
            print(f"{name:16} {row:16}", *(f"{kind} {rate:14,.0f} steps/s" for kind, rate in told.items()))
