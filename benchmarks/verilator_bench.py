"""Closed-loop steps per CPU second of the emitted parallel RTL in Verilator, driven by a tight C++ loop on one thread.

The peer of the numba engine: no VPI, -O3, this machine's instructions; its outputs are compared with the emulator's.
"""

import subprocess
import tempfile
from pathlib import Path

import numpy as np

from greygate.compiler.emit import emit
from greygate.emulator.interpreter import interpret
from greygate.emulator.program import Program
from greygate.hardware.verify import lanes, run_logged, simulator_environment

from .shared import stopwatch

MAIN = Path(__file__).with_name("verilator_main.cpp")


def measure(
    program: Program,
    inputs: np.ndarray,
    steps: int = 1_000_000,
    folder: Path | None = None,
    expected: np.ndarray | None = None,
) -> dict[str, float]:
    """Steps per CPU second over `steps` steps of input codes (N, columns), repeated as needed.

    `expected` are the emulator's outputs for the first pass over `inputs` (computed with the interpreter if not given);
    a difference raises AssertionError. Returns steps_per_second, clocks_per_step, cpu_seconds, build_seconds.
    """
    if folder is None:
        with tempfile.TemporaryDirectory() as temporary:
            return measure(program, inputs, steps, Path(temporary), expected)
    environment = simulator_environment()
    samples = lanes([p.signal for p in program.inputs], inputs)
    results = [p.signal for p in program.outputs]
    expected = interpret(program, inputs).outputs if expected is None else expected
    wanted = lanes(results, expected)

    watch = stopwatch()
    sources = [str(f) for f in emit(program, folder / "rtl", "parallel") if f.suffix == ".v"]
    flags = f"-O3 -march=native -DSAMPLE_BYTES={samples.shape[1]} -DRESULT_BYTES={wanted.shape[1]}"
    run_logged(
        [
            *("verilator", "--cc", "--exe", "--build", "-j", "2", "--quiet", "-O3", "--noassert", "-Wno-lint"),
            *("--x-assign", "fast", "--x-initial", "fast", "--prefix", "Vtop", "--top-module", program.name),
            *("-Mdir", str(folder / "build"), "-o", "bench", "-CFLAGS", flags, "-MAKEFLAGS", "OPT_FAST=-O3"),
            *(str(MAIN), *sources),
        ],
        folder / "build.log",
        environment,
        folder,
    )
    built = watch()

    (folder / "samples").write_bytes(samples.tobytes())
    command = [str(folder / "build" / "bench"), str(folder / "samples"), str(folder / "outputs")]

    def run(count: int) -> tuple[float, int]:
        seconds, clocks = subprocess.run(
            [*command, str(count)], check=True, capture_output=True, text=True
        ).stdout.split()
        return float(seconds), int(clocks)

    run(len(inputs))
    got = np.fromfile(folder / "outputs", np.uint8).reshape(wanted.shape)
    different = np.flatnonzero(np.any(got != wanted, axis=1))
    assert not different.size, f"step {different[0]} differs from the emulator"
    seconds, clocks = run(steps)
    return {
        "steps_per_second": steps / seconds,
        "clocks_per_step": clocks / steps,
        "cpu_seconds": seconds,
        "build_seconds": built,
    }
