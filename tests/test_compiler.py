import math
import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import delay_line, random_inputs, random_network

from greygate.compiler import pipeline
from greygate.compiler.centre import centre_biases, usual
from greygate.compiler.pipeline import compile_network, fixed_error
from greygate.compiler.quantize import Formats, loop_gain, memory, quantize
from greygate.compiler.ranges import ranges
from greygate.compiler.tables import make_table
from greygate.emulator.engine import run
from greygate.emulator.interpreter import fit, interpret, lookup, round_shift
from greygate.emulator.numbers import Fix, Overflow, Rounding
from greygate.emulator.program import Affine, Program, Signal, Terminal
from greygate.errors import InputError
from greygate.models.accuracy import float_error
from greygate.models.activations import ACTIVATIONS
from greygate.models.arithmetic import mean, xp
from greygate.models.families.blocks import feedforward, flow_record
from greygate.models.network import Layer, Network, Port
from greygate.models.simplify import merge_linear, multiplications, simplify
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record


def record_of(network: Network, steps: int, seed: int) -> Record:
    inputs = random_inputs(network, steps, seed)
    return Record(inputs, network.run(inputs))


def random_formats(seed: int) -> Formats:
    rng = np.random.default_rng(seed)
    return Formats(
        width=int(rng.integers(6, 19)),
        margin=float(rng.choice([0.6, 1.25])),  # 0.6 makes signals saturate
        wide=int(rng.integers(0, 4)),
        rounding=Rounding(rng.choice(list(Rounding))),
        overflow=Overflow(rng.choice(list(Overflow))),
        interpolated=bool(rng.random() < 0.7),
        finer=int(rng.integers(0, 4)),
    )


def random_program(seed: int) -> tuple[Program, np.ndarray]:
    network = simplify(random_network(seed))
    record = record_of(network, 40, seed)
    found, formats = ranges(network, [record]), random_formats(seed)
    try:
        program = quantize(network, found, formats)
    except InputError:  # a margin under one may leave no room for an initial value
        program = quantize(network, found, replace(formats, margin=1.25))
    return program, program.encode(random_inputs(network, 25, seed + 1))


@pytest.mark.parametrize("examples", [60, pytest.param(220, marks=pytest.mark.nightly)])
def test_engine_and_interpreter_agree_in_every_bit_of_every_signal_of_random_networks(examples):
    @settings(max_examples=examples)
    @given(st.integers(0, 10**9))
    def agree(seed):
        program, codes = random_program(seed)
        slow, fast = interpret(program, codes, trace=True), run(program, codes, trace=True)
        for name, want in slow.trace.items():
            np.testing.assert_array_equal(fast.trace[name], want, err_msg=name)
        np.testing.assert_array_equal(fast.outputs, slow.outputs)
        np.testing.assert_array_equal(fast.states, slow.states)
        assert fast.saturations == slow.saturations

    agree()


@settings(max_examples=30)
@given(st.integers(0, 10**9))
def test_a_batch_from_given_states_is_the_same_as_its_sequences(seed):
    program, codes = random_program(seed)
    initial = run(program, codes).states[[4, 9]]
    both = run(program, np.stack([codes, codes]), initial)
    for i in range(2):
        np.testing.assert_array_equal(both.outputs[i], interpret(program, codes, initial[i]).outputs)


@settings(max_examples=60)
@given(st.integers(0, 10**9))
def test_simplification_changes_no_output_by_more_than_1e_9(seed):
    network = random_network(seed)
    inputs = random_inputs(network, 30, seed)
    want = network.run(inputs)
    for simple in (simplify(network), merge_linear(network, always=True)):
        for name, y in simple.run(inputs).items():
            np.testing.assert_allclose(y, want[name], rtol=0, atol=1e-9 * np.abs(want[name]).max())
    assert multiplications(simplify(network)) <= multiplications(network)


@settings(max_examples=40)
@given(st.integers(0, 10**9))
def test_sound_bounds_hold_for_other_inputs_within_the_observed_ones(seed):
    network = simplify(random_network(seed))
    record = record_of(network, 30, seed)
    found = ranges(network, [record])
    rng = np.random.default_rng(seed)
    inside = {n: rng.choice(np.ravel(v), np.shape(v)) if np.ndim(v) == 1 else v[rng.permutation(len(v))]
              for n, v in record.inputs.items()}  # fmt: skip
    traced = network.run(inside, trace=True)
    for name in network.modules:
        low, high = found[name].sound
        assert low - 1e-9 <= traced[name].min()
        assert traced[name].max() <= high + 1e-9


@pytest.mark.parametrize("width", [8, 12, 16, 20, 24])
def test_fixed_point_approaches_float_as_the_width_grows(width):
    network = simplify(random_network(12, activations=("tansig", "logsig", "radbas", "linear", "satlin")))
    record = record_of(network, 400, 12)
    program = quantize(network, ranges(network, [record]), Formats(width))
    for error in fixed_error(program, record).values():
        assert np.abs(error).max() < 60 * 2.0**-width * 3


# ---- numbers


@pytest.mark.parametrize(
    ("rounding", "halves"),
    [  # codes -5 .. 5 shifted right by one: -2.5, -2, -1.5, ...
        (Rounding.TRUNCATE, [-3, -2, -2, -1, -1, 0, 0, 1, 1, 2, 2]),
        (Rounding.HALF_UP, [-2, -2, -1, -1, 0, 0, 1, 1, 2, 2, 3]),
        (Rounding.HALF_EVEN, [-2, -2, -2, -1, 0, 0, 0, 1, 2, 2, 2]),
    ],
)
def test_ties_round_as_the_table_worked_by_hand(rounding, halves):
    np.testing.assert_array_equal(round_shift(np.arange(-5, 6), np.int64(1), rounding), halves)


def test_a_negative_shift_is_exact_and_overflow_clips_or_wraps():
    np.testing.assert_array_equal(round_shift(np.array([-3, 3]), np.int64(-2), Rounding.HALF_UP), [-12, 12])
    codes = np.array([-9, -8, 7, 8, 24])
    np.testing.assert_array_equal(fit(codes, Fix(4, 0), Overflow.SATURATE), [-8, -8, 7, 7, 7])
    np.testing.assert_array_equal(fit(codes, Fix(4, 0), Overflow.WRAP), [7, -8, 7, -8, -8])


@pytest.mark.parametrize("function", [name for name, a in ACTIVATIONS.items() if a.lowered == "table"])
@pytest.mark.parametrize("arg", [Fix(10, 6), Fix(14, 11), Fix(18, 14), Fix(8, 7), Fix(16, 9)])
@pytest.mark.parametrize("interpolated", [True, False])
def test_a_table_states_its_worst_error_over_every_code(function, arg, interpolated):
    table = make_table(function, arg, Fix(12, 11), 1.25, interpolated)
    codes = np.arange(arg.lo, arg.hi + 1)
    true = ACTIVATIONS[function].value(xp, codes * arg.lsb)
    error = np.abs(lookup(table, codes) * table.out.lsb - np.clip(true, -1.0, 1.0))  # a square saturates
    assert table.worst_error == pytest.approx(error.max(), rel=1e-12)  # that of the float reference itself


def test_equal_neurons_share_one_table():
    network = feedforward("f", ["u", "p"], [5, 4], 3)
    program = quantize(network.flatten(), ranges(network.flatten(), [flow_record()]), Formats(16))
    assert len(program.tables) <= 2
    assert len({t.name for t in program.tables}) == len(program.tables)


def test_accumulators_are_proved_by_the_worst_case_and_refused_beyond_62_bits():
    network = simplify(delay_line())
    program = quantize(network, ranges(network, [record_of(network, 50, 0)]), Formats(16))
    affine = next(o for o in program.operations if isinstance(o, Affine))
    largest = sum(
        int(np.abs(affine.weights[0, j])) * -program.signals[a].fix.lo for j, a in enumerate(affine.args)
    ) + abs(int(affine.bias[0]))
    width = program.accumulator_width(affine)
    assert 2 ** (width - 2) <= largest + 2 ** int(affine.frac[0])
    assert largest < 2 ** (width - 1)
    broken = replace(program, operations=(replace(affine, weights=affine.weights << 46),))
    with pytest.raises(InputError, match="accumulator needs"):
        broken.check()


def test_a_state_that_integrates_gets_fraction_bits_and_the_program_says_why():
    network = Network("integrator", [Port("u")], [Port("y")])
    network.add("sum", Layer({"u": [[0.001]], "own": [[1.0]]}, [0.0]))
    network.connect("u", "sum.u")
    network.connect("sum", "sum.own", 1)
    network.connect("sum", "y")
    record = Record({"u": np.sin(np.arange(5000) / 300)}, {"y": np.zeros(5000)})
    program = quantize(network, ranges(network, [record]), Formats(12))
    assert program.signals["sum"].fix.width > 12
    assert "remembers its rounding" in program.notes["sum"]
    assert memory([np.eye(1)]) == math.inf
    assert loop_gain([np.eye(1)]) == 1  # an exact loop


def test_a_state_that_remembers_ten_steps_keeps_its_rounding_under_half_a_step_of_the_word():
    network = Network("slow", [Port("u")], [Port("y")])
    network.add("sum", Layer({"u": [[1 / 16]], "own": [[15 / 16]]}, [0.0]))  # short weights: what errs is the rounding
    network.connect("u", "sum.u")
    network.connect("sum", "sum.own", 1)
    network.connect("sum", "y")
    rng = np.random.default_rng(0)
    inputs = {"u": np.round(rng.uniform(-0.9, 0.9, 4000) * 2.0**9) / 2.0**9}
    record = Record(inputs, network.run(inputs))
    found = ranges(network, [record])
    program = quantize(network, found, Formats(12))
    step = 2.0 ** -(11 - math.ceil(math.log2(1.25 * found["sum"].magnitude)))
    assert 0.25 * step < fixed_error(program, record)["y"].std() < 0.5 * step


def test_neurons_read_a_wide_state_of_another_layer_rounded_to_the_word_and_their_own_as_it_is():
    network = Network("both", [Port("u")], [Port("y")])
    network.add("sum", Layer({"u": [[0.001]], "own": [[1.0]]}, [0.0]))
    network.add("held", Layer({"sum": [[0.5]], "own": [[0.5]]}, [0.0], "tansig"))
    for source, target, delay in (("u", "sum.u", 0), ("sum", "sum.own", 1), ("sum", "held.sum", 0)):
        network.connect(source, target, delay)
    network.connect("held", "held.own", 1)
    network.connect("held", "y")
    record = Record({"u": np.sin(np.arange(5000) / 300)}, {"y": np.zeros(5000)})
    program = quantize(network, ranges(network, [record]), Formats(8, finer=4))
    (reads,) = (o.args for o in program.operations if o.out.name == "held.n")
    assert reads == ("sum.view", "held.z1")
    width = {name: signal.fix.width for name, signal in program.signals.items()}
    assert min(width["sum"], width["held.z1"]) > 10
    assert width["sum.view"] == 8


def test_weights_in_a_loop_get_bits_for_its_worst_frequency():
    assert loop_gain([np.array([[0.9]])]) == pytest.approx(10)
    assert loop_gain([np.zeros((1, 1)), np.array([[-0.99]])]) == pytest.approx(100, rel=1e-3)  # resonance, not DC


@pytest.mark.parametrize(("radius", "angle"), [(0.99, 0.7), (0.9999, 2.0), (0.9, 0.1)])
def test_the_gain_of_a_loop_is_that_of_its_resonance_however_sharp(radius, angle):
    loops = [np.array([[2 * radius * math.cos(angle)]]), np.array([[-(radius**2)]])]
    near = np.exp(-1j * (angle + np.linspace(-0.1, 0.1, 100_001)))
    answers = np.abs(1 - loops[0][0, 0] * near - loops[1][0, 0] * near**2)
    assert loop_gain(loops) == pytest.approx(1 / answers.min(), rel=0.02)


def test_products_far_below_their_sum_err_by_half_a_step_of_it_at_most():
    small = np.random.default_rng(0).uniform(0.1, 0.2, (1, 8)) * 2.0**-6  # 12 bits hold them finer than the sum shows
    network = Network("both", [Port("u"), Port("v", size=8)], [Port("y")])
    network.add("sum", Layer({"u": [[1.0]], "v": small}, [0.0]))
    for source, target in (("u", "sum.u"), ("v", "sum.v"), ("sum", "y")):
        network.connect(source, target)
    signs = np.array(list(product((-1.0, 1.0), repeat=9)))
    inputs = {"u": 0.5 * signs[:, 0], "v": 0.9375 * signs[:, 1:]}
    record = Record(inputs, network.run(inputs))
    program = quantize(network, ranges(network, [record]), Formats(12))
    lsb = program.signals["sum"].fix.lsb
    assert np.abs(fixed_error(program, record)["y"]).max() < lsb  # half of it is the sum's own rounding


@pytest.mark.parametrize("activation", ["hardlims", "tansig"])
def test_a_bias_is_as_fine_as_the_sum_it_belongs_to_even_where_weights_are_whole_numbers(activation):
    network = Network("both", [Port("u"), Port("v")], [Port("y")])
    for name, source in (("one", "u"), ("two", "v")):
        network.add(name, Layer({"x": [[1.0]]}, [0.0], "hardlim"))
        network.connect(source, f"{name}.x")
    network.add("y_layer", Layer({"one": [[1.0]], "two": [[1.0]]}, [-1.5], activation))
    network.connect("one", "y_layer.one")
    network.connect("two", "y_layer.two")
    network.connect("y_layer", "y")
    inputs = {"u": np.array([-1.0, -1, 1, 1]), "v": np.array([-1.0, 1, -1, 1])}
    record = Record(inputs, network.run(inputs))
    program = quantize(network, ranges(network, [record]), Formats(16))
    np.testing.assert_allclose(fixed_error(program, record)["y"], 0, atol=2.0**-14)


def test_a_sign_test_has_the_sign_of_the_exact_sum():
    network = Network("sign", [Port("u"), Port("v")], [Port("y"), Port("z")])
    network.add("y_layer", Layer({"u": [[1.0]], "v": [[1e-3]]}, [0.0], "hardlims"))
    parts = {"u": [[1.0], [1.0], [0.0]], "v": [[1e-3], [0.0], [1.0]]}
    network.add("z_layer", Layer(parts, np.zeros(3), "select"))
    for source, target in product("uv", ("y_layer", "z_layer")):
        network.connect(source, f"{target}.{source}")
    network.connect("y_layer", "y")
    network.connect("z_layer", "z")
    lsb = 2.0**-8
    inputs = {"u": np.array([0.0, 0.0, 0.0, 1.0, -1.0]), "v": np.array([-lsb, 0.0, lsb, -1.0, 1.0])}
    record = Record(inputs, network.run(inputs))
    for rounding in Rounding:
        found = quantize(network, ranges(network, [record]), Formats(10, wide=0, rounding=rounding))
        out = found.decode(interpret(found, found.encode(inputs)).outputs)
        np.testing.assert_array_equal(out["y"], [-1, 1, 1, 1, -1])
        assert found.signals["z_layer"].fix == found.signals["v"].fix
        np.testing.assert_array_equal(np.sign(out["z"]), [-1, 0, 0, 1, 1])


def test_a_latch_holds_its_code_and_needs_no_bits_for_memory():
    network = Network("latch", [Port("u"), Port("s")], [Port("y")])
    parts = {"s": [[1.0], [0.0], [0.0]], "u": [[0.0], [1.0], [0.0]], "own": [[0.0], [0.0], [1.0]]}
    network.add("hold", Layer(parts, np.zeros(3), "select"))
    for source, port, delay in (("s", "s", 0), ("u", "u", 0), ("hold", "own", 1)):
        network.connect(source, f"hold.{port}", delay)
    network.connect("hold", "y")
    rng = np.random.default_rng(0)
    inputs = {"u": rng.uniform(-1, 1, 300), "s": rng.uniform(-1, 0.2, 300)}
    program = quantize(network, ranges(network, [Record(inputs, network.run(inputs))]), Formats(12))
    assert program.signals["hold"].fix == program.signals["u"].fix
    assert [o.op for o in program.operations] == ["select"]


def test_an_input_has_the_codes_of_its_sensor():
    network = delay_line()
    network.inputs = [Port("u", "V", scale=2.0, offset=1.0, initial=5.0, resolution=2.0 / 2**7)]
    program = quantize(simplify(network), ranges(simplify(network), [record_of(network, 50, 0)]), Formats(16))
    assert program.signals["u"].fix.frac == 7


# ---- the whole


def test_centred_biases_take_the_mean_out_of_one_step_errors():
    before = after = 0.0
    for seed in (20, 33, 35, 41):  # a mean over a record is a statistic: a network may be worse off by chance
        network = simplify(random_network(seed, activations=("tansig", "linear")))
        record = record_of(network, 600, seed)
        program = quantize(network, ranges(network, [record]), Formats(9))
        before += sum(abs(e.mean()) for e in fixed_error(program, record).values())
        after += sum(abs(e.mean()) for e in fixed_error(centre_biases(program, network, [record]), record).values())
    assert after <= 0.5 * before


@pytest.mark.parametrize(("width", "said"), [(5, True), (16, False)])
def test_an_output_that_fixed_point_moves_by_a_plain_part_of_its_range_is_told_of(width, said):
    network = feedforward("f", ["u"], [4], 0)
    record = record_of(network, 200, 0)
    compiled = compile_network(network, {"quiet": Record({"u": np.zeros(9)}, {"y": np.zeros(9)}), "run": record},
                               Formats(width), ranged_on=["run"])  # fmt: skip
    name = network.outputs[0].name
    remarks = [r for p in compiled.passes for r in p.remarks if "differs from float" in r]
    apart, wanted = fixed_error(compiled.program, record)[name], record.targets[name]
    assert (np.abs(apart).max() > pipeline.COARSE * np.ptp(wanted)) == said
    assert [r[: r.index(":")] for r in remarks] == said * [
        f"{name} differs from float by up to {np.abs(apart).max() / np.ptp(wanted):.0%} of its range on run"
    ]


def test_a_budget_gives_the_cheapest_formats_that_meet_it():
    network = train(feedforward("f", ["u", "p"], [6], 1), [flow_record()], epochs=30).network
    record = flow_record()
    compiled = compile_network(network, {"grid": record}, budget=1.05)
    limit = 1.05 * np.sqrt(np.mean(float_error(network, record)["y"] ** 2))
    assert np.sqrt(np.mean(fixed_error(compiled.program, record)["y"] ** 2)) <= limit
    plain = compile_network(network, {"grid": record}, Formats(16))
    bits = [sum(s.fix.width * s.size for s in c.program.signals.values()) for c in (compiled, plain)]
    assert bits[0] < bits[1]


def test_a_budget_that_allows_anything_ends_at_four_bits():
    network = train(feedforward("f", ["u", "p"], [6], 1), [flow_record()], epochs=30).network
    program = compile_network(network, {"grid": flow_record()}, budget=1e6).program
    assert min(s.fix.width for s in program.signals.values()) == 4


def test_a_square_is_held_to_the_end_of_its_format():
    table = make_table("square", Fix(12, 8), Fix(10, 6))  # arguments up to 8, results up to 8: beyond they saturate
    assert table.worst_error <= 1.25 * table.out.lsb


def test_a_program_comes_back_from_its_file_the_same(tmp_path):
    program, codes = random_program(8)
    program.save(tmp_path / "program.json")
    again = Program.load(tmp_path / "program.json")
    np.testing.assert_array_equal(interpret(again, codes).outputs, interpret(program, codes).outputs)
    assert again.signals == program.signals


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda p: p.unlink(), "No such file"),
        (lambda p: p.write_text(p.read_text()[:300]), "is not JSON"),
        (
            lambda p: p.write_text(p.read_text().replace('"op": "affine"', '"op": "convolve"')),
            "op 'convolve' does not exist",
        ),
        (lambda p: p.write_text("{}"), "name is missing; add it"),
    ],
)
def test_a_spoilt_program_file_is_named(tmp_path, spoil, message):
    path = tmp_path / "program.json"
    random_program(8)[0].save(path)
    spoil(path)
    with pytest.raises(InputError, match=message):
        Program.load(path)


@pytest.mark.parametrize("width", [3, 33])
def test_a_width_out_of_reach_is_refused(width):
    network = simplify(delay_line())
    with pytest.raises(InputError, match="choose 4 to 32 bits"):
        quantize(network, ranges(network, [record_of(network, 20, 0)]), Formats(width))


def test_finer_weights_and_neurons_leave_the_word_as_it_is():
    network = feedforward("flow", ["u", "p"], [5], seed=3).flatten()
    plain, finer = (quantize(network, ranges(network, [flow_record()]), Formats(12, finer=f)) for f in (0, 2))
    before, after = plain.signals, finer.signals
    assert (before["hidden1"].fix, after["hidden1"].fix) == (Fix(12, 11), Fix(14, 13))
    assert all(before[n].fix == after[n].fix for n in ("u", "p", "out"))
    exact = np.hstack([network.modules["hidden1"].weights[n] for n in ("u", "p")])
    inputs = 2.0 ** np.array([before["u"].fix.frac, before["p"].fix.frac])
    found = (next(o for o in p.operations if o.out.name == "hidden1.n") for p in (plain, finer))
    rounded, closer = (np.abs(o.weights * 2.0 ** -o.frac[:, None] * inputs - exact).max() for o in found)
    assert closer < 0.5 * rounded


@pytest.mark.parametrize("finer", [-1, 17])
def test_bits_beyond_the_word_are_refused_out_of_reach(finer):
    network = simplify(delay_line())
    with pytest.raises(InputError, match="choose 0 to 16 bits beyond the 16"):
        quantize(network, ranges(network, [record_of(network, 20, 0)]), Formats(16, finer=finer))


def test_a_width_that_cannot_hold_the_range_names_the_signal():
    network = simplify(delay_line())
    record = record_of(network, 20, 0)
    with pytest.raises(InputError, match=r"signal u: reaches .* which 6 bits cannot hold"):
        quantize(network, ranges(network, [Record({"u": record.inputs["u"] * 100}, record.targets)]), Formats(6))


def test_a_network_that_diverges_on_a_scenario_is_refused():
    network = Network("bomb", [Port("u")], [Port("y")])
    network.add("s", Layer({"own": [[1e30]], "u": [[1.0]]}, [0.0]))
    network.connect("u", "s.u")
    network.connect("s", "s.own", 1)
    network.connect("s", "y")
    with pytest.raises(InputError, match="diverges on scenario v1"):
        compile_network(network, {"v1": Record({"u": np.ones(50)}, {"y": np.ones(50)})})


# ---- what the formats and biases are worth


def summing(weights: np.ndarray) -> Network:
    """y = weights @ u."""
    network = Network("summing", [Port("u", size=weights.size)], [Port("y")])
    network.add("sum", Layer({"u": weights.reshape(1, -1)}, [0.0]))
    network.connect("u", "sum.u")
    network.connect("sum", "y")
    return network


def test_a_sum_may_go_a_fifth_beyond_its_record_without_saturation():
    network, rng = summing(np.ones(2)), np.random.default_rng(0)
    one = rng.uniform(-0.95, 0.95, 400)
    seen = {"u": np.column_stack([one, np.clip(0.95 * np.sign(one) - one, -0.5, 0.5)])}  # never beyond 0.95
    found = ranges(network, [Record(seen, network.run(seen))])
    assert found["sum"].magnitude < 1.0
    program = quantize(network, found, Formats(12))
    more = {"u": np.array([[0.9, 0.24], [-0.9, -0.24]])}
    got = interpret(program, program.encode(more))
    assert not any(got.saturations.values())
    np.testing.assert_allclose(program.decode(got.outputs)["y"], [1.14, -1.14], atol=2.0**-9)


def test_what_rounded_weights_cost_on_average_is_in_the_bias():
    lsb = 2.0**-6  # of weights near one in 8 bits
    network = summing(0.5 + 0.4 * lsb * np.ones(8))  # all rounded down
    rng = np.random.default_rng(0)
    inputs = {"u": 0.8 + 0.1 * rng.uniform(-1, 1, (500, 8))}
    record = Record(inputs, network.run(inputs))
    program = quantize(network, ranges(network, [record]), Formats(8))
    assert abs(fixed_error(program, record)["y"].mean()) < 0.25 * program.signals["sum"].fix.lsb


@pytest.mark.parametrize("pole", [0.3, 0.9, -0.99])
def test_memory_is_by_how_much_a_loop_raises_the_variance_of_its_rounding(pole):
    answer = pole ** np.arange(5000)  # to one rounding, in all later steps
    assert memory([np.array([[pole]])]) == pytest.approx(np.sum(answer**2), rel=1e-9)


def test_an_accumulator_holds_its_largest_sum_with_the_constant_that_rounds_it():
    def rounded(weight: int, bias: int, shift: int, argument: Fix) -> Program:
        u, out = Signal("u", 1, argument), Signal("y", 1, Fix(16, 0))
        arrays = np.array([[weight]]), np.array([bias]), np.array([shift])
        ports = (Terminal(s.name, s, "1", 1.0, 0.0) for s in (u, out))
        return Program("rounded", (next(ports),), (), (Affine(out, ("u",), *arrays),), tuple(ports))

    p = rounded(1, 127, 7, Fix(8, 0))  # at most 128 + 127, which 9 bits hold, and 64 to round
    width = p.accumulator_width(p.operations[0])
    assert 2 ** (width - 1) > 128 + 127 + 64
    rounded(2**30, 0, 30, Fix(31, 0)).check()
    with pytest.raises(InputError, match="needs 63 bits"):
        rounded(2**31 - 1, 2**31 - 1, 31, Fix(31, 0)).check()  # 2^61 - 1: 62 bits, but for the 2^30 that round it


def test_centring_leaves_an_exact_difference_alone():
    network = summing(np.array([1.0, -1.0]))
    lsb = 2.0**-7
    off = {"u": np.tile([0.5 + 0.4 * lsb, 0.25 - 0.4 * lsb], (200, 1))}  # inputs between codes, always on the same side
    off["u"][:2] = [[-0.9, 0.9], [0.9, -0.9]]
    record = Record(off, network.run(off))
    program = centre_biases(quantize(network, ranges(network, [record]), Formats(8)), network, [record])
    assert program.signals["u"].fix.lsb == lsb
    equal = {"u": np.repeat(np.linspace(-0.9, 0.9, 19)[:, None], 2, axis=1)}
    np.testing.assert_array_equal(interpret(program, program.encode(equal)).outputs, 0)


def test_a_simplification_that_moves_an_output_by_a_millionth_stops_the_compiler(monkeypatch):
    def nearly(network: Network) -> Network:
        (name,) = (n for n in network.parameters() if n.endswith(".u"))
        return network.with_parameters({name: network.parameters()[name] * (1 + 1e-6)})

    monkeypatch.setattr(pipeline, "SIMPLIFICATIONS", (*pipeline.SIMPLIFICATIONS, nearly))
    network, u = summing(np.ones(1)), np.linspace(-1.0, 1.0, 50)[:, None]
    with pytest.raises(AssertionError, match="nearly changed the outputs of summing by 1e-06"):
        compile_network(network, {"run": Record({"u": u}, network.run({"u": u}))}, Formats(12))


@pytest.mark.parametrize(("by", "stops"), [(2.0**-52, False), (1e-6, True), (1e-11, True)])
def test_a_simplification_may_round_a_network_whose_runs_part(monkeypatch, by, stops):
    """What parts by a factor of two in a step makes a trillion of a rounding in forty."""

    def nearly(network: Network) -> Network:
        (name,) = (n for n in network.parameters() if n.endswith(".u"))
        return network.with_parameters({name: network.parameters()[name] * (1 + by)})

    network = Network("parting", [Port("u")], [Port("y")])
    network.add("bend", Layer({"x": [[4.0]]}, [0.0], "tansig"))
    network.add("x", Layer({"u": [[0.1]], "bend": [[2.0]], "own": [[-1.8]]}, [0.0]))
    for source, target, delay in (("x", "bend.x", 1), ("u", "x.u", 0), ("bend", "x.bend", 0), ("x", "x.own", 1)):
        network.connect(source, target, delay=delay)
    network.connect("x", "y")
    u = np.random.default_rng(1).uniform(-1.0, 1.0, 90)[:, None]
    record = Record({"u": u}, network.run({"u": u}))
    monkeypatch.setattr(pipeline, "SIMPLIFICATIONS", (nearly,))
    passes = pipeline._Passes(network, {"run": record})
    if stops:
        with pytest.raises(AssertionError, match="nearly changed the outputs of parting"):
            passes.simplified(network, False)
        return
    passes.simplified(network, False)
    assert passes.done[-1].change > pipeline.SAME


def test_an_output_that_is_always_the_same_number_keeps_the_width():
    network = Network("still", [Port("u")], [Port("y")], {"none": Layer({"u": [[0.0]]}, [-0.0666759])})
    network.connect("u", "none.u")
    network.connect("none", "y")
    u = np.linspace(-1.0, 1.0, 50)
    program = compile_network(network, {"run": Record({"u": u}, network.run({"u": u}))}, Formats(12)).program
    answered = run(program, program.encode({"u": u})).outputs * program.signals["none"].fix.lsb
    np.testing.assert_allclose(answered, -0.0666759, rtol=2**-11)


def test_an_output_that_is_always_zero_compiles():
    network = Network("still", [Port("u")], [Port("y")], {"none": Layer({"u": [[0.0]]}, [0.0])})
    network.connect("u", "none.u")
    network.connect("none", "y")
    u = np.linspace(-1.0, 1.0, 50)
    compiled = compile_network(network, {"run": Record({"u": u}, {"y": 0.0 * u})}, Formats(12), ranged_on=["run"])
    assert [p.change for p in compiled.passes] == [0.0] * len(compiled.passes)
    assert not run(compiled.program, compiled.program.encode({"u": u})).outputs.any()


@pytest.mark.parametrize("gain", [1.0, -1.0])
def test_what_equals_the_level_of_a_comparison_stays_equal(gain):
    """An input on a grid of tenths, which no code has, beside a comparison with one of them."""
    network = Network("n", [Port("u", "1", 1.0)], [Port("y", "1", 1.0)])
    network.add("above", Layer({"u": [[gain]]}, [-0.3 * gain], "hardlim"), {"u": "u"})
    network.add("sum", Layer({"u": [[0.37]], "above": [[0.5]]}, [0.0]), {"u": "u", "above": "above"})
    network.connect("sum", "y")
    u = np.random.default_rng(1).integers(0, 11, 400) / 10.0
    record = Record({"u": u}, network.check().run({"u": u}))
    program = compile_network(network, {"run": record}, Formats(16)).program
    assert np.abs(fixed_error(program, record)["y"]).max() < 1e-4


def test_what_a_comparison_makes_of_a_few_samples_is_no_shift_of_all():
    apart = np.random.default_rng(2).normal(0.2, 1.0, (400, 2))
    assert np.array_equal(usual(apart, 1.0), mean(apart))
    flipped = apart.copy()
    flipped[::40, 1] += 1e4
    assert usual(flipped, 1.0)[0] == mean(apart)[0]
    assert usual(flipped, 1.0)[1] == pytest.approx(np.delete(apart[:, 1], slice(None, None, 40)).mean(), abs=1e-12)


@pytest.mark.parametrize(("at", "few"), [(0.31, True), (0.0, False)])
def test_a_jump_in_a_few_samples_is_told_as_one_and_a_coarse_word_as_that(at, few):
    """at: of a comparison of a square, which a word of eight bits holds roughly; else all is rough."""
    u = np.linspace(-1.0, 1.0, 400)
    network = feedforward("f", ["u"], [3], 0) if not few else Network("f", [Port("u", "1", 1.0)], [Port("y", "1", 1.0)])
    if few:
        network.add("bent", Layer({"u": [[1.0]]}, [0.0], "tansig"), {"u": "u"})
        network.add("above", Layer({"bent": [[1.0]]}, [-at], "hardlim"), {"bent": "bent"})
        network.connect("above", "y")
    source = network.check().inputs[0].name
    record = Record({source: u}, network.run({source: u}))
    program = quantize(network, ranges(network, [record]), Formats(6 if few else 4))
    (told,) = pipeline.coarse(program, network, {"run": record}).values()
    assert (
        re.search(r", in \d+ of 400 samples: a comparison or an angle tips there, or give more bits", told) is not None
    ) == few
    assert "--max-error" not in told
    assert few or "tips" not in told


@pytest.mark.parametrize(
    ("u", "said"),
    [
        (100.0 + 1e-3 * np.sin(np.arange(300)), "u moves by 0.002 about 100, 0.51 steps of its word: read it without"),
        (np.zeros(300), "u is 0 in every sample"),
        (1e-6 * np.sin(np.arange(300)), ""),
        (np.arange(300) % 2.0, ""),
    ],
    ids=["beside an offset", "still", "small", "off and on"],
)
def test_an_input_that_needs_little_of_its_word_is_told_of(u, said):
    network = Network("n", [Port("u", "1", 1.0)], [Port("y", "1", 1.0)])
    network.add("same", Layer({"u": [[0.5]]}, [0.0]), {"u": "u"})
    network.connect("same", "y")
    record = Record({"u": u}, network.check().run({"u": u}))
    compiled = compile_network(network, {"run": record}, Formats(16))
    told = [r for p in compiled.passes for r in p.remarks if r.startswith("u ")]
    assert [r.startswith(said) for r in told] == [True] * bool(said)


def test_no_comparison_is_blamed_where_there_is_none():
    network = Network("n", [Port("u", "1", 1.0)], [Port("y", "1", 1.0)])
    network.add("same", Layer({"u": [[0.5]]}, [0.0]), {"u": "u"})
    network.connect("same", "y")
    u = np.where(np.arange(400) == 7, 1.0, 0.0)
    record = Record({"u": u}, network.check().run({"u": u}))
    program = quantize(network, ranges(network, [record]), Formats(16))
    halved = replace(program, operations=(replace(program.operations[0], weights=program.operations[0].weights // 2),))
    (told,) = pipeline.coarse(halved, network, {"run": record}).values()
    assert told.endswith("on run, in 1 of 400 samples: give more bits (--width)")
