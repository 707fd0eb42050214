"""Random programs over the whole legal space of docs/integer-program.md: who differs from Python integers, how often.

Every program goes through the interpreter and the engine; the first of them also through Verilator as every
architecture, and fewer through Icarus where it is installed (half an hour of one core). Exit code 1 if a bit differs.
"""

import json
import shutil
from collections.abc import Callable, Iterable
from typing import Annotated

import numpy as np
from legal_programs import legal_codes, legal_program
from oracle import differing_bits, perform
from test_pipelined import streamed

from greygate.compiler.targets import Design
from greygate.emulator.engine import run
from greygate.emulator.interpreter import Run, interpret
from greygate.emulator.program import Program
from greygate.hardware.verify import Case, Scenario, verify_many

from .made import store
from .shared import VERILATOR, say, scratch, stopwatch

TAKES = "half an hour"
NEEDS = VERILATOR
STEPS = 24
ARCHITECTURES = ("parallel", "pipelined", "folded", "serial")
TOGETHER = 50  # programs in one Verilator build


def emulated(seeds: Iterable[int], emulators: dict[str, Callable[..., Run]]) -> dict:
    """What each emulator makes of every program, beside the oracle."""
    found = {name: {"programs": 0, "differing_bits": 0, "differing_seeds": []} for name in emulators}
    bits, operations, watch = 0, 0, stopwatch()
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
    return found | {"operations": operations, "bits_compared_each": bits, "seconds": watch(1)}


def hardware(seeds: range) -> dict:
    """What Verilator makes of every program, as every architecture, beside the oracle."""
    found = {a: {"programs": 0, "differing_seeds": [], "differing": []} for a in ARCHITECTURES}
    bits, watch = 0, stopwatch()
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
        with scratch() as folder:
            verdicts = verify_many(cases, folder, seed=first).verdicts
        for v in verdicts:
            found[v.architecture]["programs"] += 1
            if v.mismatch:
                found[v.architecture]["differing_seeds"].append(seed_of[v.program])
                found[v.architecture]["differing"].append(v.mismatch)
        done = sum(f["programs"] for f in found.values())
        differing = sum(len(f["differing"]) for f in found.values())
        say(f"{done} designs in Verilator, {differing} of them differ")
    return found | {"bits_compared": bits, "seconds": watch(1)}


def icarus(seeds: range) -> dict:
    """What Icarus makes of every program, as every architecture, with and without pauses, beside the interpreter."""
    found: dict = {a: {"programs": 0, "differing_seeds": []} for a in ARCHITECTURES}
    watch = stopwatch()
    for seed in seeds:
        program = legal_program(seed, f"legal{seed}")
        for architecture, told in found.items():
            told["programs"] += 1
            with scratch() as folder:
                try:
                    streamed(program, legal_codes(program, seed, STEPS), folder, Design(), architecture)
                except AssertionError:
                    told["differing_seeds"].append(seed)
    return found | {"seconds": watch(1)}


def scenario_of(program: Program, codes: np.ndarray) -> Scenario:
    """The answers of the oracle, not of an emulator."""
    want = perform(program, codes.tolist())
    return Scenario(codes, np.array(want.outputs), np.array(want.states, np.int64).reshape(len(codes), -1))


def main(
    *,
    first: Annotated[int, "the first seed; `make test` takes those from 0"] = 1000,
    programs: Annotated[int, "in interpreter and engine"] = 10_000,
    designs: Annotated[int, "in Verilator, as each architecture"] = 300,
    others: Annotated[int, "in Icarus, as each architecture"] = 100,
) -> int:
    emulators = {
        "interpreter": lambda p, codes: interpret(p, codes, trace=True),
        "engine": lambda p, codes: run(p, codes, trace=True),
    }
    result = {"first_seed": first, "steps": STEPS, "emulators": emulated(range(first, first + programs), emulators)}
    result["hardware"] = hardware(range(first, first + designs))
    result["icarus"] = icarus(range(first, first + others)) if shutil.which("iverilog") else {}
    store("random_programs", result)
    print(json.dumps(result, indent=1))
    parts = (part for group in ("emulators", "hardware", "icarus") for part in result[group].values())
    return int(any(part["differing_seeds"] for part in parts if isinstance(part, dict)))
