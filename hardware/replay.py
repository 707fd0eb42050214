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
MAIN = """\
#include "Vbench.h"
#include "verilated.h"
#include <cstdio>
int main(int argc, char** argv) {
    VerilatedContext context;
    context.randReset(2);
    context.randSeed(1);
    context.commandArgs(argc, argv);
    Vbench bench{&context};
    while (!context.gotFinish()) {
        bench.clk = 0;
        bench.eval();
        bench.clk = 1;
        bench.eval();
    }
    bench.final();
    return 0;
}
"""


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
    text = bench(program.name, len(inputs), *(8 * rows.shape[1] for rows in words))
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
        for name, text in (*data.items(), ("bench.v", bench), ("main.cpp", MAIN)):
            (work / name).write_text(text)
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


def bench(top: str, steps: int, width_in: int, width_out: int) -> str:
    """A bench of one clock: it resets the design, offers each sample, and writes what came of it to result.json."""
    return f"""\
module bench (input clk);
    reg [{width_in - 1}:0] samples[0:{steps - 1}];
    reg [{width_out - 1}:0] wanted[0:{steps - 1}];
    initial $readmemh("samples.hex", samples);
    initial $readmemh("wanted.hex", wanted);
    integer offered = 0, taken = 0, idle = 0, clock = 0, began = 0, ended = 0, first = -1, file, differing = 0, k;
    reg [{width_out - 1}:0] given = 0, right = 0, difference;
    reg [2:0] starting = 0;
    wire rst = starting < 4;
    wire s_ready, m_valid;
    wire [{width_out - 1}:0] m_data;
    wire s_valid = offered < {steps};
    {top} core (
        .clk(clk), .rst(rst), .s_axis_tdata(samples[s_valid ? offered : 0]), .s_axis_tvalid(s_valid),
        .s_axis_tready(s_ready), .m_axis_tdata(m_data), .m_axis_tvalid(m_valid), .m_axis_tready(1'b1)
    );
    always @(posedge clk) begin
        clock <= clock + 1;
        idle <= rst || m_valid ? 0 : idle + 1;
        if (rst) starting <= starting + 1;
        if (!rst && s_valid && s_ready) offered <= offered + 1;
        if (!rst && m_valid) begin
            difference = m_data ^ wanted[taken];
            if (difference != 0 && first < 0) begin
                first <= taken;
                given <= m_data;
                right <= wanted[taken];
            end
            for (k = 0; k < {width_out}; k = k + 1) if (difference[k]) differing = differing + 1;
            if (taken == 0) began <= clock;
            ended <= clock;
            taken <= taken + 1;
        end
        if (taken == {steps} || idle > {PATIENCE}) begin
            file = $fopen("result.json", "w");
            $fwrite(file, "{{\\"steps\\": %0d, \\"differing\\": %0d, \\"first\\": %0d, ", taken, differing, first);
            $fwrite(file, "\\"given\\": \\"%0x\\", \\"wanted\\": \\"%0x\\", ", given, right);
            $fwrite(file, "\\"clocks\\": %0d}}", ended - began);
            $fclose(file);
            $finish;
        end
    end
endmodule
"""
