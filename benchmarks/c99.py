"""The C99 target on every scenario of the thesis's machines and on random legal programs: every bit, and bytes.

`make bench-c99` runs it and writes benchmarks/results/c99.json. Exit code 1 if a bit differs or a sanitizer speaks.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from legal_programs import legal_codes, legal_program
from made import keep
from test_c99 import COMPILERS, agree, built, same

from greygate.compiler.emit import emit
from greygate.emulator.engine import run
from greygate.machines.catalog import REPORTED
from greygate.project import Project, compile_project
from greygate.source import Source

STEPS = 24
LEVELS = ("-O0", "-O2")


def machine(name: str, folder: Path) -> dict:
    """Every scenario of a machine, complete, by every compiler at every level; the size of its object code."""
    compile_project(Source(name), folder / "build", architectures=("c99",))
    project = Project.open(folder / "build")
    records = project.source.records()
    steps = 0
    harnesses = [built(project.program, folder, compiler, level) for compiler in COMPILERS for level in LEVELS]
    for scenario in project.source.scenarios:
        codes = project.program.encode(records[scenario].inputs)
        steps += len(codes)
        want = run(project.program, codes)
        for harness in harnesses:
            same(project.program, codes, want, harness)
    emit(project.program, folder, "c99")
    source = f"{project.program.name}.c"
    subprocess.run(["gcc", "-std=c99", "-Os", "-c", source, "-o", "small.o"], cwd=folder, check=True)
    sizes = subprocess.run(["size", "small.o"], cwd=folder, capture_output=True, text=True, check=True).stdout
    code, data, zeroed = map(int, sizes.splitlines()[1].split()[:3])
    scenarios = len(project.source.scenarios)
    return {"machine": name, "scenarios": scenarios, "steps": steps, "bytes": code + data + zeroed}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--programs", type=int, default=100)
    parser.add_argument("part", choices=["bits"], nargs="?")
    given = parser.parse_args()
    machines = []
    for name in REPORTED:
        with tempfile.TemporaryDirectory() as folder:
            machines.append(machine(name, Path(folder)))
        print(machines[-1], flush=True)
    for seed in range(1000, 1000 + given.programs):
        program = legal_program(seed, f"random{seed}")
        codes = np.asarray(legal_codes(program, seed, STEPS))
        with tempfile.TemporaryDirectory() as folder:
            agree(program, codes, Path(folder), COMPILERS[seed % len(COMPILERS)], LEVELS[seed // 2 % 2])
    versions = [
        subprocess.run([c, "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[0]
        for c in COMPILERS
    ]
    programs = {"count": given.programs, "steps": STEPS}
    keep("c99", "bits", {"compilers": versions, "levels": LEVELS, "machines": machines, "programs": programs})
    print("no bit differs; written to benchmarks/results/c99.json")
    return 0


if __name__ == "__main__":
    sys.exit(main())
