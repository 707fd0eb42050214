"""The serial architecture: its code equals the integer program in every bit, and its hardware performs the code."""

import numpy as np
import pytest
from legal_programs import legal_codes, legal_program
from programs import random_codes, random_program
from serial_machine import Machine

from greygate.compiler.serial_code import compiled
from greygate.compiler.verilog import input_slices
from greygate.emulator.interpreter import interpret


def performed(program, codes):
    """(outputs, states after each step) of the code."""
    machine = Machine(program, compiled(program))
    states = sum(s.signal.size for s in program.states)
    outputs, after = [], []
    for row in codes.tolist():
        sample = sum((v % (1 << s.fix.width)) << low for v, (s, _, low) in zip(row, input_slices(program), strict=True))
        outputs.append(machine.step(sample))
        after.append([machine.memory[k] for k in range(states)])
    return outputs, after


@pytest.mark.parametrize("draw", ["random", "legal"])
def test_the_code_equals_the_interpreter(draw):
    program_of, codes_of = {"random": (random_program, random_codes), "legal": (legal_program, legal_codes)}[draw]
    for seed in range(60):
        program = program_of(seed)
        codes = codes_of(program, seed, 12)
        run = interpret(program, codes)
        outputs, states = performed(program, codes)
        assert np.array_equal(outputs, run.outputs), seed
        assert not program.states or np.array_equal(states, run.states), seed
