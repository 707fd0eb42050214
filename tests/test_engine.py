import numpy as np
import pytest
import test_compiler
from legal_programs import legal_codes, legal_program
from oracle import perform
from programs import cylinder_program, random_codes, random_program

from greygate.emulator import engine, lanes
from greygate.emulator.engine import run
from greygate.emulator.interpreter import interpret
from greygate.emulator.numbers import Fix, Rounding
from greygate.emulator.program import Affine, Lookup, Program, Signal, Terminal
from greygate.emulator.tables import Symmetry, Table


def agree(program: Program, codes: np.ndarray, initial: np.ndarray | None = None) -> None:
    want = interpret(program, codes, initial, trace=True)
    got = run(program, codes, initial, trace=True)
    for name, signal in want.trace.items():
        np.testing.assert_array_equal(got.trace[name], signal, err_msg=f"{program.name}: {name}")
    np.testing.assert_array_equal(got.outputs, want.outputs)
    np.testing.assert_array_equal(got.states, want.states)
    assert got.saturations == want.saturations


def wide() -> Program:
    """Accumulators and products of a table beyond what float64 holds, every rounding, shifts to both sides."""
    x, out = Signal("x", 3, Fix(30, 20)), Fix(28, 12)
    rng = np.random.default_rng(5)
    operations = [
        Affine(
            Signal(f"{rounding}.sum", 5, out),
            ("x",),
            rng.integers(-(1 << 26), 1 << 26, (5, 3)),
            rng.integers(-(1 << 40), 1 << 40, 5),
            np.array([40, 38, 12, 10, 41]),
            rounding,
        )
        for rounding in Rounding
    ]
    points = tuple(int(p) for p in rng.integers(-(1 << 44), 1 << 44, 9))
    table = Table("steep", "any", Symmetry.ODD, 15, points, True, out, Fix(46, 30), 0.0)
    operations += [Lookup(Signal(f"{o.out.name}.y", 5, table.out), o.out.name, "steep") for o in operations]
    assert all(program_width(o, x) >= 53 for o in operations[:3])
    outputs = tuple(Terminal(o.out.name, o.out, "1", 1.0, 0.0) for o in operations)
    return Program("wide", (Terminal("x", x, "1", 1.0, 0.0),), (), tuple(operations), outputs, (table,)).check()


def program_width(o: Affine, x: Signal) -> int:
    return Program("", (Terminal("x", x, "1", 1.0, 0.0),), (), (o,), ()).accumulator_width(o)


# between them: every operation, rounding, overflow and symmetry; interpolated and plain; sizes of one and of several
@pytest.mark.parametrize("seed", [3, 11, 24, 37, 58])
def test_the_engine_equals_the_interpreter_in_every_bit_of_every_signal(seed):
    program = random_program(seed)
    agree(program, random_codes(program, seed, 60))


# between them: sums of 52, 53 and 62 bits, shifts beyond 62, tables whose lines need int64
@pytest.mark.parametrize("seed", [2, 6, 18])
def test_the_engine_on_a_program_at_the_limits_equals_the_interpreter_in_every_bit(seed):
    program = legal_program(seed)
    agree(program, legal_codes(program, seed, 60))


@pytest.mark.parametrize("seed", [1, 2])
def test_the_engine_on_a_compiled_network_equals_the_interpreter_in_every_bit(seed):
    agree(*test_compiler.random_program(seed))


def test_the_engine_on_wide_accumulators_equals_the_interpreter_in_every_bit():
    program = wide()
    agree(program, random_codes(program, 0, 200))


def test_the_engine_takes_batches_from_given_states_and_counts_their_saturations():
    program = cylinder_program()
    codes = np.stack([random_codes(program, seed, 50) for seed in range(6)]).reshape(2, 3, 50, -1)
    initial = run(program, codes[0, 0]).states[[3, 9, 20]]
    agree(program, codes, initial)
    assert run(program, codes, states=False).states.size == 0


LEGAL = [17, 37, 136, 198, 285]  # sums of up to 52 bits, lines over octaves, selects and products
MANY = lanes.LANES + 6  # a block and a part of one, on two cores


def many(program: Program, codes, seed: int, steps: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Scenarios of a few recordings, their steps in any order, each from a state of its own."""
    rng, some = np.random.default_rng(seed), np.stack([codes(program, 10 * seed + k, steps) for k in range(3)])
    starts = interpret(program, some[0]).states
    return rng.permuted(some[rng.integers(0, 3, MANY)], axis=1), starts[rng.integers(0, steps, MANY)]


def agree_in_lanes(program: Program, codes, seed: int) -> type:
    """That they run in lanes, with the interpreter's bits; the lanes' type."""
    beside = lanes.tabulate(program)
    assert beside is not None
    agree(program, *many(program, codes, seed))
    return beside.lines.dtype.type


# between them: every operation, rounding, overflow and symmetry, both widths of lanes
@pytest.mark.parametrize("seed", [0, *range(2, 13)])  # 1 is too wide
def test_scenarios_in_lanes_equal_the_interpreter_in_every_bit_of_every_signal(seed):
    agree_in_lanes(random_program(seed), random_codes, seed)


@pytest.mark.parametrize("seed", LEGAL)
def test_lanes_of_a_program_near_their_limits_equal_the_interpreter_in_every_bit(seed):
    assert agree_in_lanes(legal_program(seed), legal_codes, seed) is np.float64


@pytest.mark.parametrize("seed", [1, 2])
def test_lanes_of_a_compiled_network_equal_the_interpreter_in_every_bit(seed):
    program, codes = test_compiler.random_program(seed)
    agree(program, np.stack([np.roll(codes, k, axis=0)[:20] for k in range(MANY)]))


def test_a_program_too_wide_for_lanes_runs_all_the_same():
    program = wide()
    assert lanes.tabulate(program) is None
    agree(program, *many(program, random_codes, 0))


def test_no_layout_of_the_inputs_compiles_a_second_time():
    program = cylinder_program()
    codes = np.stack([random_codes(program, seed % 3, 8) for seed in range(MANY)])
    want = run(program, codes).outputs
    fixed = codes.copy()
    fixed.setflags(write=False)
    kernels = engine._run, lanes._run
    run(program, codes[0])
    compiled = [len(kernel.signatures) for kernel in kernels]
    for given in (np.asfortranarray(codes), fixed, codes.repeat(2, axis=1)[:, ::2], codes.astype(np.int32)):
        np.testing.assert_array_equal(run(program, given).outputs, want)
        np.testing.assert_array_equal(run(program, given[3], run(program, given[3]).states[0]).outputs.shape, (8, 2))
    assert [len(kernel.signatures) for kernel in kernels] == compiled


def test_octaves_beyond_every_code_change_nothing():
    program = legal_program(1269)  # 48 octaves, the first of them of 2^38 codes
    assert any(max(t.segments.lefts) > 1 << 64 for t in program.tables)
    codes = legal_codes(program, 1269, 20)
    np.testing.assert_array_equal(run(program, codes).outputs, perform(program, codes.tolist()).outputs)
    agree(program, codes)
