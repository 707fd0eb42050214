"""Two signals multiplied: what the compiler makes of them, and the bits of every architecture."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from imported_models import Cell, free_run, signal
from legal_programs import legal_codes
from oracle import perform
from test_pipelined import streamed
from torch import nn

from greygate.compiler.pipeline import compile_network, fixed_error
from greygate.compiler.quantize import Formats
from greygate.compiler.targets import Design
from greygate.emulator.interpreter import interpret
from greygate.emulator.numbers import Fix, Rounding
from greygate.emulator.program import Product, Program, Signal, State, Terminal
from greygate.hardware.verify import Case, Scenario, verify_many
from greygate.models.importers.pytorch import from_torch
from greygate.models.simplify import simplify
from greygate.models.training.record import Record

ARCHITECTURES = ("parallel", "pipelined", "folded", "serial")


def products(name: str) -> Program:
    """Ends, roundings and shifts of every kind: a square, a chain, a product with a state, a code in parts."""
    u, v, w = Signal("u", 3, Fix(9, 4)), Signal("v", 3, Fix(5, 9)), Signal("w", 3, Fix(33, 20))
    square = Signal("square", 3, Fix(17, 8))
    wide, fine = Signal("wide", 3, Fix(40, 31)), Signal("fine", 3, Fix(20, 16))
    coarse, own = Signal("coarse", 3, Fix(6, -3)), Signal("own", 3, Fix(12, 4))
    operations = [
        Product(square, "u", "u", Rounding.TRUNCATE),
        Product(wide, "w", "square", Rounding.HALF_EVEN),
        Product(fine, "u", "v", Rounding.HALF_UP),
        Product(coarse, "v", "square", Rounding.HALF_EVEN),
        Product(own, "held", "u", Rounding.HALF_UP),
    ]
    state = State(Signal("held", 3, own.fix), "own", (1, -2048, 2047))
    ports = [[Terminal(s.name, s, "1", 1.0, 0.0) for s in part] for part in ((u, v, w), (wide, fine, coarse, own))]
    return Program(name, tuple(ports[0]), (state,), tuple(operations), tuple(ports[1])).check()


@pytest.fixture(scope="module")
def cells() -> dict[str, tuple[Program, Record]]:
    """A GRU and an LSTM of torch, compiled at 16 bits on a run of theirs."""
    found = {}
    for kind, states in ((nn.GRUCell, 1), (nn.LSTMCell, 2)):
        network = from_torch(Cell(kind), ["u"], ["y"], (np.zeros(4),) * states, name=kind.__name__.lower())
        x = signal(400, 1)
        record = Record({"u": x[:, 0]}, {"y": free_run(network, x)[:, 0]})
        found[network.name] = compile_network(network, {"run": record}, Formats(16)).program, record
    return found


def scenario(program: Program, codes: np.ndarray) -> Scenario:
    run = interpret(program, codes)
    return Scenario(codes, run.outputs, run.states)


@pytest.mark.parametrize("name", ["grucell", "lstmcell"])
def test_a_recurrent_cell_multiplies_where_it_had_squares_and_keeps_its_answers(name, cells):
    program, record = cells[name]
    ops = [o.op for o in program.operations]
    assert ops.count("product") == {"grucell": 2, "lstmcell": 3}[name]
    assert "square" not in {t.function for t in program.tables}
    assert np.abs(fixed_error(program, record)["y"]).max() < 1e-3 * np.abs(record.targets["y"]).max()


def test_a_sum_that_a_product_reads_is_made_once():
    network = from_torch(Cell(nn.LSTMCell), ["u"], ["y"], (np.zeros(4),) * 2)
    layers = simplify(network).layers()
    assert set(layers["cell_kept"].weights) == {"cell_f", "cell_c_z1"}


@pytest.mark.parametrize("every", [2, pytest.param(1, marks=pytest.mark.nightly)])  # which of the cells
def test_products_equal_the_emulator_in_every_architecture_in_verilator(every, cells, tmp_path):
    cases = []
    for place, architecture in enumerate(ARCHITECTURES):
        for dsps in (0, 2) if architecture == "parallel" else (0,):
            p = products(f"ends_{architecture}{dsps}")
            codes = legal_codes(p, 4, 40)
            np.testing.assert_array_equal(perform(p, codes.tolist()).outputs, interpret(p, codes).outputs)
            cases.append(Case(p, {"ends": scenario(p, codes)}, architecture, Design(dsps=dsps)))
        for program, record in [*cells.values()][place % every :: every]:
            named = replace(program, name=f"{program.name}_{architecture}")
            run = scenario(named, named.encode(record.inputs)[:60])
            cases.append(Case(named, {"run": run}, architecture, Design(multipliers=3)))
    assert [v for v in verify_many(cases, tmp_path, seed=3).verdicts if v.mismatch] == []


@pytest.mark.skipif(shutil.which("iverilog") is None, reason="needs Icarus Verilog")
@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_products_equal_the_emulator_in_every_architecture_in_icarus(architecture, tmp_path):
    program = products("ends")
    streamed(program, legal_codes(program, 5, 40), tmp_path, Design(dsps=1), architecture)
