"""The C99 target: every bit on every scenario of the thesis's machines and on random legal programs; size and pace.

Exit code 1 if a bit differs or a sanitizer speaks.
"controllers" needs gcc-arm-none-eabi, gcc-riscv64-unknown-elf and qemu-user of Debian: bytes of the object code, and
the instructions of a step, counted by QEMU, which also checks every output.
"""

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
from legal_programs import legal_codes, legal_program
from test_c99 import COMPILERS, agree, built, fields, same

from greygate.compiler.emit import emit
from greygate.emulator.engine import run
from greygate.hardware.build import Project
from greygate.machines.catalog import REPORTED
from greygate.machines.source import Source
from greygate.project import compile_project

from .made import keep
from .shared import scratch, versions

TAKES = "not timed"

STEPS = 24
LEVELS = ("-O0", "-O2")
CONTROLLERS = {  # name -> (compiler, its options, emulator, "exit" as a system call of Linux, register of its number)
    "Cortex-M4": (
        "arm-none-eabi-gcc",
        ["-mcpu=cortex-m4", "-mthumb"],
        ["qemu-arm", "-cpu", "max"],
        ("r7", "r0", "svc 0", 1),
    ),
    "RISC-V (RV32IMAC)": (
        "riscv64-unknown-elf-gcc",
        ["-march=rv32imac", "-mabi=ilp32"],
        ["qemu-riscv32"],
        ("a7", "a0", "ecall", 93),
    ),
}
COUNTED = (16, 48)  # steps of two runs: their difference counts no beginning and no end
BARE = """
#include "{name}.h"
{arrays}
void *memcpy(void *to, const void *from, unsigned long n)
{{ for (unsigned long i = 0; i < n; i++) ((char *)to)[i] = ((const char *)from)[i]; return to; }}
void *memset(void *to, int c, unsigned long n)
{{ for (unsigned long i = 0; i < n; i++) ((char *)to)[i] = (char)c; return to; }}
static {name}_state state;
static int run(void)
{{
    {name}_input in;
    {name}_output out;
    {name}_reset(&state);
    for (int k = 0; k < STEPS; k++)
    {{
{read}
        {name}_step(&state, &in, &out);
{write}
    }}
    return 0;
}}
void _start(void)
{{
    register int code __asm__("{code}") = run();
    register int number __asm__("{number}") = {exits};
    __asm__ volatile("{call}" : : "r"(code), "r"(number));
}}
"""


def machine(name: str, folder: Path) -> dict:
    """Every scenario of a machine, complete, by every compiler at every level; the size of its object code."""
    compile_project(Source(name), folder / "build", architectures=("c99",))
    project = Project.open(folder / "build")
    records = project.records()
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


def controllers(name: str, folder: Path) -> list[dict]:
    """Bytes, and instructions of a step, of a machine on each controller; QEMU checks the outputs."""
    compile_project(Source(name), folder / "build", architectures=("c99",))
    program = Project.open(folder / "build").program
    emit(program, folder, "c99")
    codes = program.encode(Source(name).records()[Source(name).scenarios[0]].inputs)[: COUNTED[-1]]
    wanted = run(program, codes, states=False).outputs
    rows = []
    for controller, (compiler, options, emulator, (number, code, call, exits)) in CONTROLLERS.items():
        sides = (("given", codes), ("wanted", wanted))
        arrays = [
            f"static const long long {what}[{len(v)}][{v.shape[1]}] = {{"
            + ", ".join("{" + ", ".join(f"{int(x)}LL" for x in row) + "}" for row in v)
            + "};"
            for what, v in sides
        ]
        read = [f"in.{f}[{r}] = given[k][{k}];" for k, (f, _, r) in enumerate(fields("in_", program.inputs))]
        write = [
            f"if (out.{f}[{r}] != wanted[k][{k}]) return 1;"
            for k, (f, _, r) in enumerate(fields("out_", program.outputs))
        ]
        text = BARE.format(
            name=program.name, arrays="\n".join(arrays), read="\n".join(read), write="\n".join(write),
            number=number, code=code, call=call, exits=exits,
        )  # fmt: skip
        (folder / "bare.c").write_text(text)
        row: dict = {"machine": name, "controller": controller}
        for level in ("-Os", "-O2"):
            own = [compiler, *options, "-std=c99", "-ffreestanding", level]
            subprocess.run([*own, "-c", f"{program.name}.c", "-o", "step.o"], cwd=folder, check=True)
            sizes = subprocess.run(["size", "step.o"], cwd=folder, capture_output=True, text=True, check=True).stdout
            row[f"bytes {level}"] = sum(map(int, sizes.splitlines()[1].split()[:3]))
            counts = []
            for steps in COUNTED:
                whole = [*own, "-std=gnu99", "-fno-tree-loop-distribute-patterns", f"-DSTEPS={steps}"]
                linked = ["-nostdlib", "-Wl,--no-relax", "bare.c", "step.o", "-lgcc", "-o", "bare.elf"]
                subprocess.run([*whole, *linked], cwd=folder, check=True)
                log = ["-singlestep", "-d", "exec,nochain", "-D", "log"]
                subprocess.run([*emulator, *log, "./bare.elf"], cwd=folder, check=True)
                counts.append(len(re.findall(r"^Trace ", (folder / "log").read_text(), re.M)))
            row[f"instructions {level}"] = round((counts[1] - counts[0]) / (COUNTED[1] - COUNTED[0]))
        rows.append(row)
    return rows


def bare() -> None:
    """Write the part "controllers"."""
    needed = [word for c, _, (e, *_), _ in CONTROLLERS.values() for word in (c, e)]
    if missing := [word for word in needed if shutil.which(word) is None]:
        sys.exit(f"missing: {', '.join(missing)}")
    rows = []
    for name in REPORTED:
        with scratch() as folder:
            rows += controllers(name, folder)
        print(*rows[-len(CONTROLLERS) :], sep="\n", flush=True)
    keep("c99", "controllers", {"tools": versions(needed), "steps": COUNTED, "rows": rows})


def main(part: Annotated[str, ("bits", "controllers")] = "bits", *, programs: int = 100) -> None:
    if part == "controllers":
        return bare()
    machines = []
    for name in REPORTED:
        with scratch() as folder:
            machines.append(machine(name, folder))
        print(machines[-1], flush=True)
    for seed in range(1000, 1000 + programs):
        program = legal_program(seed, f"random{seed}")
        codes = np.asarray(legal_codes(program, seed, STEPS))
        with scratch() as folder:
            agree(program, codes, folder, COMPILERS[seed % len(COMPILERS)], LEVELS[seed // 2 % 2])
    found = {"compilers": versions(COMPILERS), "levels": LEVELS, "machines": machines}
    keep("c99", "bits", found | {"programs": {"count": programs, "steps": STEPS}})
    print("no bit differs")
