"""Random networks all the way: compiled, emitted in both architectures, simulated, compared in every bit."""

from dataclasses import replace

from test_compiler import random_program

from greygate.emulator.engine import run
from greygate.verify import Case, Scenario, verify_many

COUNT = 30


def test_hardware_of_random_networks_equals_the_emulator_in_both_architectures(tmp_path):
    cases = []
    for seed in range(COUNT):
        program, codes = random_program(seed)
        answer = run(program, codes)
        scenarios = {"random": Scenario(codes, answer.outputs, answer.states)}
        for architecture in ("parallel", "folded"):
            named = replace(program, name=f"{program.name}_{architecture}")
            cases.append(Case(named, scenarios, architecture, macs=1 + seed % 3))
    result = verify_many(cases, tmp_path, seed=1)
    assert [v.mismatch for v in result.verdicts if v.mismatch] == []
    assert len(result.verdicts) == 2 * COUNT
