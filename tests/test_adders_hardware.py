"""Registers between adders of the parallel design: however many stand in a row, every code of every step is the same.

tests/test_pipelined.py has that for the pipelined design.
"""

from dataclasses import replace

import numpy as np
import pytest
from programs import random_codes, random_program

from greygate.compiler.adders import solve
from greygate.compiler.dataflow import Dataflow
from greygate.compiler.dataflow.sums import stages
from greygate.compiler.targets import Design, target
from greygate.emulator.interpreter import interpret
from greygate.hardware.verify import Case, Scenario, verify_many

SEEDS = (0, 4)  # two programs with deep sums and states
ROWS = (0, 1, 2, 3)  # adders between two registers; 0: no register
STEPS = 30


@pytest.mark.nightly
def test_registers_between_adders_change_no_bit(tmp_path):
    cases = []
    for seed in SEEDS:
        p = random_program(seed)
        codes = random_codes(p, seed, STEPS)
        run = interpret(p, codes)
        for most in ROWS:
            named = replace(p, name=f"random{seed}_{most}")
            scenario = {"random": Scenario(codes, run.outputs, run.states)}
            cases.append(Case(named, scenario, "parallel", Design(adders=most)))
    result = verify_many(cases, tmp_path, seed=4)
    assert [v.mismatch for v in result.verdicts if v.mismatch] == []


@pytest.mark.parametrize("seed", SEEDS)
def test_fewer_adders_in_a_row_take_more_clocks(seed):
    p = random_program(seed)
    clocks = [target("parallel").clocks(p, Design(adders=most)) for most in ROWS]
    assert clocks[0] < clocks[1]
    assert clocks[1:] == sorted(clocks[1:], reverse=True)
    for most in ROWS[1:]:
        for sums in Dataflow(p, Design(adders=most)).sums.values():
            assert sums.clocks == max(1, -(-sums.graph.depth // most))


@pytest.mark.parametrize("seed", [0, 6])  # of one the cut from the outputs is the cheaper, of one that from the columns
def test_of_two_cuts_the_one_that_keeps_fewer_bits_is_made(seed):
    weights = np.random.default_rng(seed).integers(-60, 60, size=(3, 5))
    graph = solve(weights, [8] * 5, [0] * 3, [(-128, 127)] * 5)
    nodes = list(enumerate(graph.nodes, graph.columns))
    above = [0] * (graph.columns + len(nodes))  # adders between each and the farthest output
    for k, n in reversed(nodes):
        for o in (n.left, n.right):
            above[o] = max(above[o], above[k] + 1)
    count = -(-graph.depth // 2)
    early = {k: (level - 1) // 2 for (k, _), level in zip(nodes, graph.levels, strict=True)}
    late = {k: count - 1 - above[k] // 2 for k, _ in nodes}

    def bits(of) -> int:
        """Of the sums that a later stage reads."""
        return sum(
            graph.width(o) for o in {o for k, n in nodes for o in (n.left, n.right) if o in early and of[o] < of[k]}
        )

    assert bits(early) != bits(late)
    assert bits(stages(graph, 2).of) == min(bits(early), bits(late))
