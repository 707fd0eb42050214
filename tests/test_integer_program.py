"""docs/integer-program.md: what is legal, to the last bit, and that it is emulated as the text says."""

import re
from dataclasses import replace

import numpy as np
import pytest
from legal_programs import legal_codes, legal_program
from oracle import differing_bits, perform

from greygate.emulator.engine import run
from greygate.emulator.interpreter import interpret
from greygate.emulator.numbers import ACCUMULATOR_BITS, Fix, Rounding
from greygate.emulator.program import (
    SIZES,
    Affine,
    Clamp,
    Clipped,
    Lookup,
    Operation,
    Product,
    Program,
    Select,
    Signal,
    State,
    Terminal,
    Threshold,
)
from greygate.emulator.tables import Lines, Symmetry, Table
from greygate.errors import InputError

SEEDS = range(300)
LAST = (1 << (ACCUMULATOR_BITS - 1)) - 1  # the greatest sum of a legal program, its rounding constant included


WIDE = Fix(48, 0)


def program_of(*operations: Operation, inputs=(WIDE,), tables=(), states=()) -> Program:
    """Inputs u0, u1, ... of the size of the first result; not checked."""
    signals = [Signal(f"u{i}", operations[0].out.size, fix) for i, fix in enumerate(inputs)]
    ports = tuple(Terminal(s.name, s, "1", 1.0, 0.0) for s in signals)
    shown = Terminal("y", operations[-1].out, "1", 1.0, 0.0)
    return Program("limit", ports, tuple(states), tuple(operations), (shown,), tuple(tables))


def out(width: int = 48, frac: int = 0, size: int = 1) -> Signal:
    return Signal("x", size, Fix(width, frac))


def affine(to: Signal, bias: int, frac: int, weight: int = 1, rounding: Rounding = Rounding.HALF_UP) -> Affine:
    one = np.ones(to.size, np.int64)
    return Affine(to, ("u0",), np.eye(to.size, dtype=np.int64) * weight, one * bias, one * frac, rounding)


def sign(to: Signal) -> Threshold:
    return Threshold(to, "u0", 0, -1, 1)


def table(shift: int, points: tuple[int, ...], arg: Fix, to: Fix, interpolated=True, symmetry=Symmetry.ODD) -> Program:
    made = Table("t", "any", symmetry, shift, points, interpolated, arg, to, 0.0)
    return program_of(Lookup(Signal("x", 1, to), "u0", "t"), inputs=(arg,), tables=(made,))


def lines(arg=WIDE, to=WIDE, **changes) -> Program:
    """Two octaves of two segments each."""
    parts = {"start": 4, "shifts": (3, 3), "drops": (0, 1), "slope_frac": 2, "guard": 1}
    parts |= {"bases": (0, 6, 9, -9), "slopes": (1, 2, -3, 0)} | changes
    made = Lines("t", "any", Symmetry.ODD, **parts, arg=arg, out=to, worst_error=0.0)
    return program_of(Lookup(Signal("x", 1, to), "u0", "t"), inputs=(arg,), tables=(made,))


def state(initial: int) -> Program:
    fix = Fix(8, 0)
    return program_of(sign(out(8)), inputs=(fix,), states=[State(Signal("z", 1, fix), "u0", (initial,))])


# Each makes a program: with 0 it is legal and at the limit, with 1 it is one step beyond.
LIMITS = {
    "the widest format": lambda beyond: program_of(sign(out(48 + beyond))),
    "the narrowest format": lambda beyond: program_of(sign(out(2 - beyond))),
    "the finest fraction": lambda beyond: program_of(sign(out(8, 60 + beyond))),
    "the coarsest fraction": lambda beyond: program_of(sign(out(8, -48 - beyond))),
    "a fraction of an input": lambda beyond: program_of(sign(out(8)), inputs=(Fix(8, 60 + beyond),)),
    "the largest signal": lambda beyond: program_of(sign(out(2, 0, SIZES[-1] + beyond)), inputs=(Fix(2, 0),)),
    "a sum": lambda beyond: program_of(affine(out(), LAST - (1 << 47) + beyond, 0)),
    "a sum and its rounding constant": lambda beyond: program_of(
        affine(out(48, 0), LAST - (1 << 47) - (1 << 60) + beyond, 61)
    ),
    "the furthest shift of a sum": lambda beyond: program_of(affine(out(), 0, 61 + beyond)),
    "a sum shifted to the left": lambda beyond: program_of(affine(out(48, 57 + beyond), 0, 0), inputs=(Fix(4, 0),)),
    "a clamp shifted to the left": lambda beyond: program_of(Clamp(out(48, 14 + beyond), "u0", -(1 << 47), 1 << 40)),
    "a clamp's lower end": lambda beyond: program_of(Clamp(out(48, 14), "u0", -(1 << 47) - beyond, 0)),
    "a clamp's upper end": lambda beyond: program_of(Clamp(out(48, 14), "u0", 0, (1 << 47) - 1 + beyond)),
    "two values of a select": lambda beyond: program_of(
        Select(out(48, 9), "u0", "u0", "u1"), inputs=(Fix(48, 0), Fix(48, 14 + beyond))
    ),
    "the result of a select": lambda beyond: program_of(Select(out(48, 14 + beyond), "u0", "u0", "u0")),
    "a product": lambda beyond: program_of(Product(out(48, 0), "u0", "u1"), inputs=(Fix(48, 0), Fix(14 + beyond, 0))),
    "a product shifted to the left": lambda beyond: program_of(
        Product(out(48, 12 + beyond), "u0", "u0"), inputs=(Fix(25, 0),)
    ),
    "the code of a threshold": lambda beyond: program_of(Threshold(out(), "u0", (1 << 47) - 1 + beyond, 0, 1)),
    "the answer of a threshold": lambda beyond: program_of(Threshold(out(4), "u0", 0, -8 - beyond, 7)),
    "a table's shift": lambda beyond: table(8 + beyond, (-7, 5), Fix(8, 0), Fix(8, 0), interpolated=False),
    "a table's steepest line": lambda beyond: table(20, (0, (1 << 41) - 1 + beyond), Fix(40, 0), Fix(48, 0)),
    "a table's steepest line, downwards": lambda beyond: table(20, (0, 1 - (1 << 41) - beyond), Fix(40, 0), Fix(48, 0)),
    "a table's result": lambda beyond: table(3, (0, 127), Fix(8, 0), Fix(8, 0 - beyond)),
    "a table's point": lambda beyond: table(3, (0, 127 + beyond), Fix(8, 0), Fix(8, 0)),
    "minus a table's point": lambda beyond: table(3, (0, -127 - beyond), Fix(8, 0), Fix(8, 0)),
    "a table's complement": lambda beyond: table(
        3, (1 - beyond, 127), Fix(8, 0), Fix(8, 7), symmetry=Symmetry.COMPLEMENT
    ),
    "the first octave": lambda beyond: lines(Fix(4, 0), start=4 + beyond),
    "segments longer than their octave": lambda beyond: lines(shifts=(4 + beyond, 3), bases=(0,) * 3, slopes=(1,) * 3),
    "no octave": lambda beyond: lines(shifts=(3, 3)[beyond * 2 :], drops=(0, 1)[beyond * 2 :]),
    "a drop beyond a segment": lambda beyond: lines(drops=(0, 3 + beyond)),
    "a guard beyond the slope": lambda beyond: lines(guard=2 + beyond),
    "segments beyond the last octave": lambda beyond: lines(bases=(0,) * (4 + beyond), slopes=(1,) * (4 + beyond)),
    "no segment of the last octave": lambda beyond: lines(bases=(0,) * (3 - beyond), slopes=(1,) * (3 - beyond)),
    "a base without a slope": lambda beyond: lines(slopes=(1, 2, -3, 0)[beyond:]),
    "the steepest line": lambda beyond: lines(
        start=48, shifts=(3,), drops=(0,), slope_frac=15, guard=1, bases=(0,), slopes=((1 << 58) - (not beyond),)
    ),
    "the finest slope": lambda beyond: lines(slope_frac=61 + beyond, guard=0, slopes=(0,) * 4),
    "the end of a line": lambda beyond: lines(to=Fix(4, 0), bases=(0, 6, 9, 13 + 2 * beyond), slopes=(1, 2, -3, 0)),
    "minus the end of a line": lambda beyond: lines(to=Fix(4, 0), bases=(0, 6, 9, -15 - beyond)),
    "a line's fraction": lambda beyond: lines(to=Fix(48, 0 - beyond)),
    "an initial state": lambda beyond: state(-128 - beyond),
}


@pytest.mark.parametrize("limit", LIMITS)
def test_a_program_at_a_limit_is_emulated_as_the_text_says_and_one_step_beyond_is_refused(limit):
    program = LIMITS[limit](0).check()
    codes = legal_codes(program, 0, 12)
    want = perform(program, codes.tolist())
    assert differing_bits(program, want, interpret(program, codes, trace=True)) == 0
    assert differing_bits(program, want, run(program, codes, trace=True)) == 0
    with pytest.raises(InputError, match="program limit: "):
        LIMITS[limit](1).check()


@pytest.mark.parametrize("seeds", [SEEDS[k::10] for k in range(10)], ids=lambda seeds: f"{seeds[0]}, {seeds[1]}, ...")
def test_interpreter_and_engine_equal_python_integers_over_the_whole_legal_space(seeds):
    for seed in seeds:
        program = legal_program(seed)
        codes = legal_codes(program, seed, 20)
        want = perform(program, codes.tolist())
        for emulator, answer in (
            ("interpreter", interpret(program, codes, trace=True)),
            ("engine", run(program, codes, trace=True)),
        ):
            assert differing_bits(program, want, answer) == 0, f"seed {seed}: {emulator}"


def test_the_random_programs_reach_every_limit_of_the_text():
    programs = [legal_program(seed) for seed in SEEDS]
    fixes = {s.fix for p in programs for s in p.signals.values()}
    assert {f.width for f in fixes} >= {2, 3, 47, 48}
    assert {f.frac for f in fixes} >= {-48, -47, 59, 60}
    pairs = [(p, o) for p in programs for o in p.operations]
    sums = [
        (p.accumulator_width(o), int(s)) for p, o in pairs if isinstance(o, Affine) for s in o.frac - o.out.fix.frac
    ]
    assert {width for width, _ in sums} >= {52, 53, 54, ACCUMULATOR_BITS}
    assert {shift for _, shift in sums} >= {0, 1, 61}
    assert min(shift for _, shift in sums) <= -40
    clamps = {p.signals[o.arg].fix.frac - o.out.fix.frac for p, o in pairs if isinstance(o, Clamp)}
    assert {shift > 64 for shift in clamps} == {True, False}
    products = [(o, [p.signals[a].fix for a in o.args]) for p, o in pairs if isinstance(o, Product)]
    assert max(sum(f.width for f in both) for _, both in products) == ACCUMULATOR_BITS
    shifts = {sum(f.frac for f in both) - o.out.fix.frac for o, both in products}
    assert {np.sign(s) for s in shifts} == {-1, 0, 1}
    assert max(shifts) > 64
    tables = [t for p in programs for t in p.tables]
    points, lines = ([t for t in tables if isinstance(t, kind)] for kind in (Table, Lines))
    assert {t.shift for t in points} >= {0, 48}
    assert {t.shift == t.arg.width for t in points} == {True, False}
    assert {len(t.shifts) for t in lines} >= {1, 2, 3, 48}
    assert {(any(t.drops), t.guard > 0, any(t.slopes)) for t in lines} >= {(d, g, True) for d in (0, 1) for g in (0, 1)}
    assert {s for t in lines for s in t.shifts} >= {0, 1, 48}
    assert {(t.symmetry, t.interpolated) for t in tables} == {(s, i) for s in Symmetry for i in (True, False)}


@pytest.mark.parametrize("rounding", Rounding)
def test_the_width_of_a_sum_counts_its_rounding_constant(rounding):
    # 2^10 from the argument and 2^9 from rounding off 10 bits: beside them a bias of 2^11 - 1 - 2^10 - 2^9 just fits
    for bias, width in ((511, 12), (512, 13)):
        o = affine(out(), bias, 10, rounding=rounding)
        assert program_of(o, inputs=(Fix(11, 0),)).accumulator_width(o) == width
    o = affine(out(), 1023, 0, rounding=rounding)
    assert program_of(o, inputs=(Fix(11, 0),)).accumulator_width(o) == 12


def test_a_right_shift_of_any_amount_is_what_the_formula_says():
    codes = np.array([[-(1 << 47)], [-1], [0], [1], [(1 << 47) - 1]])
    for drop in (46, 47, 48, 49, 62, 63, 64, 65, 100, 108):
        for rounding in Rounding:
            fix = Fix(8, 60 - drop)
            clamp = Clamp(Signal("x", 1, fix), "u0", -(1 << 47), (1 << 47) - 1, rounding)
            select = Select(Signal("y", 1, fix), "u0", "u0", "u0", rounding)
            program = program_of(clamp, select, inputs=(Fix(48, 60),)).check()
            for answer in (interpret(program, codes, trace=True), run(program, codes, trace=True)):
                assert differing_bits(program, perform(program, codes.tolist()), answer) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"period": 0.0}, "period 0.0 is not a time"),
        ({"period": float("nan")}, "period nan is not a time"),
        ({"period": "1"}, "period 1 is not a time"),
        ({"inputs": ()}, "needs at least one input and one output"),
        ({"outputs": ()}, "needs at least one input and one output"),
    ],
)
def test_a_program_without_a_meaning_is_refused(change, message):
    with pytest.raises(InputError, match=re.escape(message)):
        replace(state(0), **change).check()


@pytest.mark.parametrize(
    ("scale", "offset"), [(0.0, 0.0), (float("inf"), 0.0), (1.0, float("nan")), (10**400, 0.0), ("1", 0.0)]
)
def test_a_port_whose_codes_mean_nothing_is_refused(scale, offset):
    program = state(0)
    port = replace(program.inputs[0], scale=scale, offset=offset)
    with pytest.raises(InputError, match=r"port u0: scale .* is not finite, or scale is 0"):
        replace(program, inputs=(port,)).check()


@pytest.mark.parametrize("weight", [-(1 << 63), (1 << 63) - 1, 1 << 62])
def test_a_weight_at_the_end_of_an_int64_is_refused(weight):
    with pytest.raises(InputError, match="accumulator needs"):
        program_of(affine(out(), 0, 0, weight), inputs=(Fix(2, 0),)).check()


def test_weights_at_both_ends_of_an_int64_do_not_cancel_in_the_width_of_their_sum():
    weights = np.array([[-(1 << 63), (1 << 63) - 1]])
    o = replace(affine(out(), 0, 0), args=("u0", "u0"), weights=weights)
    with pytest.raises(InputError, match="accumulator needs"):
        program_of(o, inputs=(Fix(2, 0),)).check()


@pytest.mark.parametrize("frac", [1 << 62, -(1 << 62), 70, -70])
def test_a_fraction_far_from_that_of_the_result_is_refused_at_once(frac):
    with pytest.raises(InputError, match="fraction is more than 62 bits from"):
        program_of(affine(out(), 0, frac)).check()


def test_one_row_whose_fraction_is_far_off_is_enough():
    two = affine(out(size=2), 0, 0)
    with pytest.raises(InputError, match="a row's fraction is more than 62 bits"):
        program_of(replace(two, frac=np.array([0, 10**6]))).check()


def test_weights_that_are_not_integers_are_refused():
    o = affine(out(), 0, 0)
    with pytest.raises(InputError, match="not integers of 64 bits"):
        program_of(replace(o, weights=o.weights * 0.5)).check()


def test_a_table_that_no_operation_reads_is_checked_as_well():
    spoilt = table(9, (0, 1), Fix(8, 0), Fix(8, 0)).tables
    with pytest.raises(InputError, match="table t: shift 9"):
        replace(state(0), tables=spoilt).check()


def volts() -> Program:
    """One input of two elements in V, -1.0 to 127/128 of 2 V about 1 V, and one of one element."""
    ports = (
        Terminal("v", Signal("v", 2, Fix(8, 7)), "V", -2.0, 1.0),
        Terminal("w", Signal("w", 1, Fix(8, 0)), "1", 1.0, 0.0),
    )
    shown = Signal("x", 1, Fix(2, 0))
    return Program(
        "volts", ports, (), (Threshold(shown, "w", 0, 0, 1),), (Terminal("y", shown, "1", 1.0, 0.0),)
    ).check()


def test_clipped_inputs_are_counted_with_what_was_given_and_what_the_format_holds():
    program = volts()
    v, w = np.array([[1.0, 3.0], [-0.99, 4.0], [3.01, -1.0], [0.0, 0.0]]), np.zeros(4)
    found = program.clipped({"v": v, "w": w})
    lowest = 1.0 - 2.0 * 127 / 128
    assert found == {"v": Clipped(3, 3 / 8, (lowest, 3.0), (-1.0, 4.0))}  # 3.01 V is -129 of 128 codes; -0.99 V is 127
    np.testing.assert_array_equal(program.encode({"v": v, "w": w})[:, 0], [0, 127, -128, 64])
    assert program.clipped({"v": np.clip(v, lowest, 3.0), "w": w}) == {}
    assert program.clipped({"v": v / 10, "w": w + 1e308})["w"].share == 1.0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_an_input_that_is_not_finite_is_refused(value):
    with pytest.raises(InputError, match="input w: a value is not finite"):
        volts().encode({"v": np.zeros((2, 2)), "w": np.array([0.0, value])})
