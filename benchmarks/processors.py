"""Is a build the same, byte by byte, whatever the processor? Every network of the catalogue is compiled, and pruned
too where it has a pruning of its own, in processes that are told to compute as other processors would.

    python benchmarks/processors.py                # all networks under all settings
    python benchmarks/processors.py --network b2 --setting Haswell --setting Prescott
    python benchmarks/processors.py --setting Prescott --run COMMAND ...    # any command under a setting

Exit code 1 if a file differs from what the first setting gives.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

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


def digests(names: list[str]) -> dict[str, dict[str, str]]:
    """Network -> file of its build -> SHA-256."""
    from greygate.machines.source import Source
    from greygate.project import compile_project

    found = {}
    for name in names:
        source = Source(name.removesuffix(PRUNED), {})
        with tempfile.TemporaryDirectory() as folder:
            build = Path(folder) / "build"
            compile_project(source, build, source.formats(), prune=1.0 if name.endswith(PRUNED) else None)
            files = sorted(p for p in build.rglob("*") if p.is_file())
            found[name] = {p.relative_to(build).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}
    return found


def compiled(setting: str, names: list[str]) -> dict[str, dict[str, str]]:
    """`digests` in a process of that setting."""
    environment = {"OMP_NUM_THREADS": "1"} | os.environ | SETTINGS[setting]
    command = [sys.executable, __file__, "--digests", *names]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{setting}: {done.stderr}")
    return json.loads(done.stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--network", action="append", help="of the catalogue; add ' pruned' for --prune 1.0")
    parser.add_argument("--setting", action="append", choices=SETTINGS)
    parser.add_argument("--run", nargs=argparse.REMAINDER, help="under that setting, the last argument")
    parser.add_argument("--digests", nargs="+", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.run:
        (setting,) = asked.setting or parser.error("--run: name one setting before it")
        os.execvpe(asked.run[0], asked.run, os.environ | SETTINGS[setting])
    if asked.digests:
        print(json.dumps(digests(asked.digests)))
        return
    names = asked.network or _all()
    results = {}
    for setting in asked.setting or SETTINGS:
        began = time.perf_counter()
        results[setting] = compiled(setting, names)
        first = next(iter(results.values()))
        differing = [f"{n}/{f}" for n in names for f in first[n] if results[setting][n].get(f) != first[n][f]]
        count = sum(map(len, results[setting].values()))
        said = f"{count} files, " + (f"{len(differing)} differ: {', '.join(differing)}" if differing else "equal")
        print(f"{setting:20} {time.perf_counter() - began:5.0f} s  {said}", flush=True)
    if any(result != first for result in results.values()):
        sys.exit(1)


def _all() -> list[str]:
    from greygate.machines.catalog import CATALOG

    return [*CATALOG, *(name + PRUNED for name, entry in CATALOG.items() if entry.prune)]


if __name__ == "__main__":
    main()
