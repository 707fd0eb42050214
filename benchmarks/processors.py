"""Is a build the same, byte by byte, whatever the processor?

Every network of the catalogue is compiled, and pruned too where it has a pruning of its own, in processes that are told
to compute as other processors would; NETWORK alone under two settings, and any command under one:

    python -m benchmarks processors NETWORK --setting Haswell Prescott
    python -m benchmarks processors --setting Prescott --run "COMMAND ..."

Exit code 1 if a file differs from what the first setting gives.
"""

import hashlib
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from typing import Annotated

import numpy as np

from .made import ROOT
from .shared import scratch, stopwatch

TAKES = "not timed"
THREADS = "all"

_NUMPY = np._core._multiarray_umath
_DISPATCHED = [n for n in _NUMPY.__cpu_dispatch__ if _NUMPY.__cpu_features__[n]]  # what it takes beyond its baseline
_OLD = {"OPENBLAS_CORETYPE": "Prescott", "NPY_DISABLE_CPU_FEATURES": " ".join(_DISPATCHED)}
_PLAIN = {"NUMBA_CPU_NAME": "nehalem", "NUMBA_CPU_FEATURES": ""}
SETTINGS = {
    "Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "SkylakeX": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "Zen": {"OPENBLAS_CORETYPE": "Zen"},
    "Prescott": {"OPENBLAS_CORETYPE": "Prescott"},
    "numpy without AVX512": {"NPY_DISABLE_CPU_FEATURES": " ".join(n for n in _DISPATCHED if n != "X86_V3")},
    "old BLAS and numpy": _OLD,
    "numba for SSE4": _PLAIN,
    "libm without FMA": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F"},
    "two threads": {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2"},
    "all old": _OLD | _PLAIN | {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F"},
}
PRUNED = " pruned"


def digests(names: Sequence[str]) -> dict[str, dict[str, str]]:
    """Network -> file of its build -> SHA-256."""
    from greygate.machines.source import Source
    from greygate.project import compile_project

    found = {}
    for name in names:
        source = Source(name.removesuffix(PRUNED), {})
        with scratch() as folder:
            build = folder / "build"
            compile_project(source, build, source.formats(), prune=1.0 if name.endswith(PRUNED) else None)
            files = sorted(p for p in build.rglob("*") if p.is_file())
            found[name] = {p.relative_to(build).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}
    return found


def compiled(setting: str, names: Sequence[str]) -> dict[str, dict[str, str]]:
    """`digests` in a process of that setting."""
    environment = {"OMP_NUM_THREADS": "1"} | os.environ | SETTINGS[setting]
    command = [sys.executable, "-m", "benchmarks", "processors", *names, "--only-digests"]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{setting}: {done.stderr}")
    return json.loads(done.stdout)


def main(
    *networks: Annotated[str, "of the catalogue; add ' pruned' for --prune 1.0"],
    setting: Annotated[Sequence[str], SETTINGS] = (),
    run: Annotated[str, "a command, under the one setting"] = "",
    only_digests: Annotated[bool, "print only the digests of these networks, as JSON"] = False,
) -> None:
    if run:
        (one,) = setting
        os.execvpe(shlex.split(run)[0], shlex.split(run), os.environ | SETTINGS[one])
    if only_digests:
        print(json.dumps(digests(networks)))
        return
    names, results = networks or _all(), {}
    for name in setting or SETTINGS:
        watch = stopwatch()
        results[name] = compiled(name, names)
        first = next(iter(results.values()))
        differing = [f"{n}/{f}" for n in names for f in first[n] if results[name][n].get(f) != first[n][f]]
        count = sum(map(len, results[name].values()))
        said = f"{count} files, " + (f"{len(differing)} differ: {', '.join(differing)}" if differing else "equal")
        print(f"{name:20} {watch():5.0f} s  {said}", flush=True)
    if any(result != first for result in results.values()):
        sys.exit(1)


def _all() -> list[str]:
    from greygate.machines.catalog import CATALOG

    return [*CATALOG, *(name + PRUNED for name, entry in CATALOG.items() if entry.prune)]
