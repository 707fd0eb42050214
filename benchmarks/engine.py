"""Closed-loop steps per CPU second of the compiled cylinder network: engines, Verilator, cocotb, interpreter."""

import statistics
import time

from greygate.compiler.pipeline import compile_network
from greygate.emulator.engine import run
from greygate.emulator.interpreter import interpret
from greygate.hardware.verify import Scenario, verify
from greygate.machines.catalog import entry

from .shared import VERILATOR, scratch, taken
from .verilator_bench import measure

TAKES = "minutes"
NEEDS = VERILATOR

REPEATS = 7
SLOW_STEPS = 2000  # for the interpreter


def steps_per_second(work, steps: int, repeats: int = REPEATS) -> float:
    """Median over `repeats` of steps per CPU second."""
    return steps / statistics.median(taken(work, repeats, time.process_time))


def main() -> None:
    chosen = entry("valve_cylinder")
    records = chosen.records()
    program = compile_network(chosen.network(), records).program
    codes = program.encode(records["training"].inputs)
    answer = run(program, codes)
    with scratch() as folder:
        scenario = Scenario(codes, answer.outputs, answer.states)
        checked = verify(program, folder, {"training": scenario}, seed=0)
        assert checked.passed

    found = {
        "engine": steps_per_second(lambda: [run(program, codes, states=False) for _ in range(20)], 20 * len(codes)),
        "verilator": statistics.median(
            measure(program, codes, expected=answer.outputs)["steps_per_second"] for _ in range(3)
        ),
        "cocotb, every step checked": 2 * len(codes) / checked.run_seconds,
        "interpreter": steps_per_second(lambda: interpret(program, codes[:SLOW_STEPS]), SLOW_STEPS, 3),
    }
    for name, rate in found.items():
        print(f"{name:28} {rate:12,.0f} steps/s   engine is {found['engine'] / rate:8.1f} times as fast")
