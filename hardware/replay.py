"""Plays a scenario through Verilog in Verilator without cocotb: a bench in Verilog, quick to build and quick to run.

It serves where a design is a netlist, in which no state has a name, or where only its clocks are asked for. The outputs
are compared bit by bit; hardware/verify.py compares the states too, and pauses and resets.
"""

import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from greygate.compiler.verilog import render
from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.files import scratch
from greygate.hardware.verify import (
    borrow_runtime,
    keep_runtime,
    lanes,
    run_logged,
    runtime_cache,
    simulator_environment,
)
from greygate.progress import Progress, silent

PATIENCE = 100_000  # clocks without an answer before the design is said to hang
FEW = 10_000  # steps, for which no compiler's optimisation is worth its time
RUNTIME = ("verilated.o", "verilated_threads.o")  # of Verilator, the same for every design
LINT = ("-Wno-lint", "-Wno-style", "-Wno-fatal", "-Wno-MULTIDRIVEN", "-Wno-SPECIFYIGN", "-Wno-TIMESCALEMOD")
MAIN = Path(__file__).with_name("templates") / "replay.cpp"


@dataclass(frozen=True)
class Replay:
    """steps: compared. differing_bits: of the outputs. first: (step, given, wanted) of the first word that differs.

    clocks: of a step, in the mean. hung: no answer came to the next step.
    """

    steps: int
    differing_bits: int
    first: tuple[int, int, int] | None
    clocks: float
    hung: bool


def replay(
    files: Sequence[Path],
    program: Program,
    inputs: np.ndarray,
    outputs: np.ndarray,
    include: Sequence[Path] = (),
    progress: Progress = silent,
) -> Replay:
    """Play input codes (N, columns) and compare with the output codes (N, columns) of the emulator.

    files: the Verilog of a design whose top is the program's. include: folders of the files that they include.
    Raises InputError as `simulate`.
    """
    signals = [p.signal for p in program.inputs], [p.signal for p in program.outputs]
    words = [lanes(s, codes) for s, codes in zip(signals, (inputs, outputs), strict=True)]
    data = {
        f"{name}.hex": "".join(row[::-1].tobytes().hex() + "\n" for row in rows)
        for name, rows in zip(("samples", "wanted"), words, strict=True)
    }
    widths = {"width_in": 8 * words[0].shape[1], "width_out": 8 * words[1].shape[1]}
    context = {"top": program.name, "steps": len(inputs), "patience": PATIENCE} | widths
    text = render("replay.v", context, __package__)
    found = simulate(files, text, data, include, progress, optimised=len(inputs) > FEW)
    first = None if found["first"] < 0 else (found["first"], int(found["given"], 16), int(found["wanted"], 16))
    clocks = found["clocks"] / (found["steps"] - 1) if found["steps"] > 1 else float("nan")
    return Replay(found["steps"], found["differing"], first, clocks, found["steps"] < len(inputs))


def simulate(
    files: Sequence[Path],
    bench: str,
    data: Mapping[str, str],
    include: Sequence[Path] = (),
    progress: Progress = silent,
    optimised: bool = True,
) -> Any:
    """Build and run a Verilog module `bench` with the one input `clk`; return what it writes to result.json.

    data: files that it reads, by name. optimised: False for a large design and few clocks, which takes longer to build
    than to run. Raises InputError where a tool is missing, or Verilator cannot build it.
    """
    with built(files, bench, data, include, progress, optimised) as work:
        progress("simulating")
        _tool(work, str(work / "bench"))
        if not (work / "result.json").exists():
            raise InputError("the simulation ended without a result")
        return json.loads((work / "result.json").read_text())


@contextmanager
def built(
    files: Sequence[Path],
    bench: str,
    data: Mapping[str, str],
    include: Sequence[Path] = (),
    progress: Progress = silent,
    optimised: bool = True,
) -> Iterator[Path]:
    """A temporary folder in which the program `bench` is built of a Verilog module of that name; as `simulate`."""
    with scratch() as work:
        for name, text in (*data.items(), ("bench.v", bench), ("main.cpp", MAIN.read_text())):
            (work / name).write_text(text, encoding="utf-8", newline="\n")
        for path in files:
            shutil.copy(path, work)
        environment = simulator_environment()
        progress("Verilator")
        options = ["--cc", "--exe", "--prefix", "Vbench", "--top-module", "bench", "-Mdir", ".", "-o", "bench"]
        options += ["--timescale", "1ns/1ns", "--x-initial", "unique", "-O3", "--output-split", "20000", *LINT]
        options += [f"-I{path}" for path in include]
        sources = [str(work / p.name) for p in files]  # whole paths: a bare name is looked for in -I first
        _tool(work, "verilator", *options, "main.cpp", "bench.v", *sources)
        progress("compiling the simulation")
        cache, level = runtime_cache(environment, False), "-O1" if optimised else "-O0"
        borrow_runtime(cache, work, RUNTIME)
        make = ["make", "-j", str(os.cpu_count() or 1), "-f", "Vbench.mk"]
        _tool(work, *make, f"OPT_FAST={level}", "OPT_SLOW=-O0", "OPT_GLOBAL=-O1")
        keep_runtime(cache, work)
        yield work


def _tool(work: Path, *command: str) -> None:
    try:
        run_logged([*command], work / "log", simulator_environment(), work)
    except InputError as error:
        said = (work / "log").read_text(errors="replace").splitlines()
        why = next((line for line in said if re.search("[Ee]rror", line)), str(error))
        raise InputError(f"{why}; the simulation cannot be built or run") from None
