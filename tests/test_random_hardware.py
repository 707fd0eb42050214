"""Random networks, and a radial one, all the way: compiled, emitted in both architectures, compared in every bit."""

from dataclasses import replace

import numpy as np
import pytest
from networks import random_inputs
from test_compiler import random_program

from greygate.compiler.pipeline import compile_network
from greygate.compiler.quantize import Formats
from greygate.compiler.targets import Design
from greygate.emulator.engine import run
from greygate.emulator.program import Program
from greygate.hardware.verify import Case, Scenario, verify_many
from greygate.models.families.radial import radial
from greygate.models.network import Port
from greygate.models.training.record import Record

pytestmark = pytest.mark.nightly

COUNT = 30


def radial_program() -> tuple[Program, np.ndarray]:
    """Squares of taps and Gaussians of their sums in a loop, 14 bits; and codes to drive it with."""
    rng = np.random.default_rng(0)
    network = radial("radial", {Port("u"): (0, 2)}, Port("y"), (1,), rng.uniform(-1, 1, (4, 3)), 0.9)
    network = network.with_parameters({"sum.kernels": rng.uniform(-1, 1, (1, 4))})
    inputs = random_inputs(network, 60, 0)
    record = Record(inputs, network.run(inputs))
    program = compile_network(network, {"random": record}, Formats(14)).program
    assert {t.function for t in program.tables} == {"square", "negexp"}
    return program, program.encode(random_inputs(network, 60, 1))


def test_hardware_of_networks_equals_the_emulator_in_both_architectures(tmp_path):
    cases = []
    for seed, (program, codes) in enumerate([*map(random_program, range(COUNT)), radial_program()]):
        answer = run(program, codes)
        scenarios = {"random": Scenario(codes, answer.outputs, answer.states)}
        for architecture in ("parallel", "folded"):
            named = replace(program, name=f"{program.name}_{architecture}")
            cases.append(Case(named, scenarios, architecture, design=Design(1 + seed % 3, factor=18 - 3 * (seed % 4))))
    result = verify_many(cases, tmp_path, seed=1)
    assert [v.mismatch for v in result.verdicts if v.mismatch] == []
    assert len(result.verdicts) == 2 * COUNT + 2
