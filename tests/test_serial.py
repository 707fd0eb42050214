"""The serial architecture: its code equals the integer program in every bit, and its hardware performs the code."""

from itertools import pairwise

import numpy as np
import pytest
from legal_programs import legal_codes, legal_program
from programs import random_codes, random_program
from serial_machine import Machine
from test_rtl import hand_worked, lint, ring, scenario

from greygate.compiler.adders import signed_digits
from greygate.compiler.emit import emit
from greygate.compiler.serial.code import compiled
from greygate.compiler.serial.writer import Writer
from greygate.compiler.verilog import input_slices
from greygate.emulator.interpreter import interpret
from greygate.hardware.verify import Case, verify_many


def performed(program, codes):
    """(outputs, states after each step) of the code, which takes the clocks that it says."""
    machine = Machine(program, compiled(program))
    states = sum(s.signal.size for s in program.states)
    outputs, after = [], []
    for row in codes.tolist():
        sample = sum((v % (1 << s.fix.width)) << low for v, (s, _, low) in zip(row, input_slices(program), strict=True))
        outputs.append(machine.step(sample))
        assert not after or machine.clocks == machine.code.clocks  # the first step begins with the initial states
        after.append([machine.memory[k] for k in range(states)])
    return outputs, after


@pytest.mark.parametrize("draw", ["random", "legal"])
def test_the_code_equals_the_interpreter(draw):
    program_of, codes_of = {"random": (random_program, random_codes), "legal": (legal_program, legal_codes)}[draw]
    for seed in range(24):
        program = program_of(seed)
        codes = codes_of(program, seed, 12)
        run = interpret(program, codes)
        outputs, states = performed(program, codes)
        assert np.array_equal(outputs, run.outputs), seed
        assert not program.states or np.array_equal(states, run.states), seed


def test_the_hardware_equals_the_interpreter(tmp_path):
    p = legal_program(2)
    cases = [Case(p, {"legal": scenario(p, 2, 30, draw=legal_codes)}, "serial")]
    p, table = hand_worked("hand")
    cases.append(Case(p, {"table": table}, "serial"))
    p = ring("ring")
    elsewhere = np.array([9, 8, 7, 6, 5, 4, 3, 2, 1, 0])
    cases.append(Case(p, {"ring": scenario(p), "elsewhere": scenario(p, 1, 30, elsewhere)}, "serial"))
    result = verify_many(cases, tmp_path, seed=2)
    assert [v for v in result.verdicts if v.mismatch] == []
    assert result.passed


def test_every_emitted_file_passes_lint_without_a_waiver(tmp_path):
    for p in [*map(random_program, range(3)), *map(legal_program, range(3)), ring("ring")]:
        emit(p, tmp_path / p.name, "serial")
        assert lint(tmp_path / p.name, p.name, "-f", f"{p.name}.f") == ""


def test_signed_digits_give_the_weight_and_no_two_stand_side_by_side():
    for weight in [*range(-300, 300), (1 << 61) - 1, -(1 << 61)]:
        digits = signed_digits(weight)
        assert sum(digit << place for place, digit in digits) == weight
        places = [place for place, _ in digits]
        assert all(b - a > 1 for a, b in pairwise(places))


def test_a_sum_takes_no_more_words_than_its_digits_and_shifts():
    """5 and -3 have two digits each, in places 0 and 2; places 1 and 3 are empty; the constant comes with shift 4."""
    w = Writer(memory={"a": (-128, 127), "b": (-128, 127)})
    w.total(["a", "b"], [5, -3], 1000, 4)
    assert w.range == ((1000 - 5 * 128 - 3 * 127) >> 4, (1000 + 5 * 127 + 3 * 128) >> 4)
    assert len(w.lines) == 1 + 4 + 2 + 1
