"""Random programs over the whole legal space of docs/integer-program.md: who differs from Python integers, in how many
bits. `make bench-programs` runs it and writes benchmarks/results/random_programs.json.

Every program goes through the interpreter and the generic engine; the first of them also through a kernel of their own,
and through Verilator in both architectures (a quarter of an hour of one core). Exit code 1 if a bit differs.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from unittest.mock import patch

import numpy as np
from legal_programs import legal_codes, legal_program
from made import stamp
from oracle import differing_bits, perform

from greygate.compiler.targets import Design
from greygate.emulator.engine import run
from greygate.emulator.interpreter import Run, interpret
from greygate.emulator.program import Program
from greygate.hardware.verify import Case, Scenario, verify_many

ROOT = Path(__file__).parents[1]
STEPS = 24
ARCHITECTURES = ("parallel", "folded")
TOGETHER = 50  # programs in one Verilator build


def emulated(seeds: Iterable[int], emulators: dict[str, Callable[..., Run]]) -> dict:
    """What each emulator makes of every program, beside the oracle."""
    found = {name: {"programs": 0, "differing_bits": 0, "differing_seeds": []} for name in emulators}
    bits, operations, started = 0, 0, time.perf_counter()
    for seed in seeds:
        program = legal_program(seed)
        codes = legal_codes(program, seed, STEPS)
        want = perform(program, codes.tolist())
        bits += STEPS * sum(s.size * s.fix.width for s in program.signals.values())
        operations += len(program.operations)
        for name, emulate in emulators.items():
            different = differing_bits(program, want, emulate(program, codes))
            found[name]["programs"] += 1
            found[name]["differing_bits"] += different
            found[name]["differing_seeds"] += [seed] if different else []
    seconds = round(time.perf_counter() - started, 1)
    return found | {"operations": operations, "bits_compared_each": bits, "seconds": seconds}


def hardware(seeds: range) -> dict:
    """What Verilator makes of every program, in both architectures, beside the oracle."""
    found = {a: {"programs": 0, "differing_seeds": [], "differing": []} for a in ARCHITECTURES}
    bits, started = 0, time.perf_counter()
    for first in range(0, len(seeds), TOGETHER):
        cases, seed_of = [], {}
        for seed in seeds[first : first + TOGETHER]:
            for architecture in ARCHITECTURES:
                program = legal_program(seed, f"legal{seed}_{architecture}")
                codes = legal_codes(program, seed, STEPS)
                design = Design(multipliers=1 + seed % 5)
                cases.append(Case(program, {"legal": scenario_of(program, codes)}, architecture, design))
                seed_of[program.name] = seed
                shown = [p.signal for p in program.outputs] + [s.signal for s in program.states]
                bits += STEPS * sum(s.size * s.fix.width for s in shown)
        with tempfile.TemporaryDirectory() as folder:
            verdicts = verify_many(cases, folder, seed=first).verdicts
        for v in verdicts:
            found[v.architecture]["programs"] += 1
            if v.mismatch:
                found[v.architecture]["differing_seeds"].append(seed_of[v.program])
                found[v.architecture]["differing"].append(v.mismatch)
        done = sum(f["programs"] for f in found.values())
        differing = sum(len(f["differing"]) for f in found.values())
        print(f"{done} designs in Verilator, {differing} of them differ", file=sys.stderr)
    return found | {"bits_compared": bits, "seconds": round(time.perf_counter() - started, 1)}


def scenario_of(program: Program, codes: np.ndarray) -> Scenario:
    """The answers of the oracle, not of an emulator."""
    want = perform(program, codes.tolist())
    return Scenario(codes, np.array(want.outputs), np.array(want.states, np.int64).reshape(len(codes), -1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=1000, help="the first seed; `make test` takes those from 0")
    parser.add_argument("--programs", type=int, default=10_000, help="in interpreter and generic engine")
    parser.add_argument("--specialised", type=int, default=100, help="with a kernel of their own")
    parser.add_argument("--hardware", type=int, default=300, help="in Verilator, in each architecture")
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks" / "results" / "random_programs.json")
    options = parser.parse_args()
    seeds = {name: range(options.first, options.first + getattr(options, name)) for name in ("programs", "specialised")}
    generic = {
        "interpreter": lambda p, codes: interpret(p, codes, trace=True),
        "engine": lambda p, codes: run(p, codes, trace=True, specialised=False),
    }
    own = {"specialised": lambda p, codes: run(p, codes, trace=True, specialised=True)}
    result = {
        "command": "make bench-programs",
        "first_seed": options.first,
        "steps": STEPS,
        "emulators": emulated(seeds["programs"], generic),
    }
    # nobody runs these kernels again
    with tempfile.TemporaryDirectory() as cache, patch.dict(os.environ, XDG_CACHE_HOME=cache):
        result["kernels"] = emulated(seeds["specialised"], own)
    result["hardware"] = hardware(range(options.first, options.first + options.hardware))
    options.out.write_text(json.dumps(result, indent=1) + "\n")
    stamp(options.out)
    print(json.dumps(result, indent=1))
    parts = (part for group in ("emulators", "kernels", "hardware") for part in result[group].values())
    sys.exit(int(any(part["differing_seeds"] for part in parts if isinstance(part, dict))))


if __name__ == "__main__":
    main()
