"""Library networks become logic where that is proved, and stay networks where it is not."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from test_rtl import lint

from greygate.compiler.emit import emit
from greygate.compiler.meaning import FORMS
from greygate.compiler.pipeline import compile_network, fixed_error
from greygate.compiler.quantize import Formats
from greygate.compiler.targets import Design
from greygate.emulator.engine import run
from greygate.emulator.interpreter import interpret
from greygate.emulator.program import Clamp, Lookup, Program, Select, Threshold
from greygate.hardware.verify import Case, Scenario, verify_many
from greygate.models.families.library import LIBRARY, entry, library
from greygate.models.network import Layer, Network, Port
from greygate.models.training.record import Record

WORDS = {Select: "multiplexer", Threshold: "comparator", Clamp: "clamp", Lookup: "table look-up"}


def inputs_of(name: str, steps: int = 300, **args) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    found = {p: rng.uniform(max(lo, -1), min(hi, 1), steps) for p, (lo, hi) in entry(name, **args).ranges.items()}
    return found | ({"s": np.sign(found["s"])} if name == "switch_1" else {})


def compiled(network: Network, inputs: dict, width: int = 16, **options):
    record = Record(inputs, network.run(inputs))
    return compile_network(network, {"record": record}, Formats(width), **options)


def operations(program: Program) -> Counter:
    return Counter(kind for o in program.operations if (kind := WORDS.get(type(o))) for _ in range(o.out.size))


@pytest.mark.parametrize("name", [n for n in LIBRARY if n != "switch_1"])
def test_hardware_is_made_of_what_the_library_says(name):
    ((word, count),) = operations(compiled(library(name), inputs_of(name)).program).items()
    said = entry(name).hardware
    assert f"{count} {word}" == (said[:-1] if said.endswith("s") else said)


def switched_by_sign() -> Network:
    """Switch 1 is for signals that are 1 or -1 alone, such as a sign."""
    network = Network("chosen", [Port("u"), Port("s")], [Port("y")])
    network.add("which", library("sign"))
    network.add("switch", library("switch_1"))
    network.connect("s", "which.x")
    for source, port in (("u", "u1"), ("which", "s")):
        network.connect(source, f"switch.{port}")
    network.connect("u", "switch.u2", gain=-1.0)
    network.connect("switch", "y")
    return network


def test_switch_1_becomes_a_multiplexer_behind_a_sign_and_stays_behind_anything_else():
    chosen = compiled(switched_by_sign(), {"u": np.sin(np.arange(200)), "s": np.cos(np.arange(200.0))})
    assert operations(chosen.program)["multiplexer"] == 1
    assert operations(chosen.program)["table look-up"] == 0
    alone = compiled(library("switch_1"), inputs_of("switch_1"))
    assert operations(alone.program)["multiplexer"] == 0
    assert "put library network sign before s" in alone.passes[1].remarks[0]


@pytest.mark.parametrize(
    ("gain", "width", "larger"), [(1e5, 12, None), (1e5, 16, 9.84), (1e6, 16, None), (1e6, 20, 15.8)]
)
def test_codes_inside_the_gap_of_a_switch_are_answered_as_it_says_and_the_remark_names_the_gain(gain, width, larger):
    inputs = inputs_of("switch_2")
    result = compiled(library("switch_2", gain=gain), inputs, width)
    assert operations(result.program)["multiplexer"] == 1
    (remark,) = result.passes[1].remarks
    assert "became logic: within 3.33e-05" in remark
    assert ("inside its gap" in remark) == bool(larger)
    if larger:
        assert f"a gain, or a signal, {larger} times as large" in remark
        (remark,) = compiled(library("switch_2", gain=larger * gain), inputs, width).passes[1].remarks
        assert "inside its gap" not in remark


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1e3])
def test_a_switch_is_a_multiplexer_on_a_signal_of_any_size(scale):
    network = Network("chosen", [Port("u1"), Port("u2"), Port("s")], [Port("y")])
    network.add("switch", library("switch_2", reach=7.0))
    for port in ("u1", "u2", "s"):
        network.connect(port, f"switch.{port}")
    network.connect("switch", "y")
    rng = np.random.default_rng(0)
    inputs = {"u1": rng.uniform(-7, 7, 300), "u2": rng.uniform(-7, 7, 300), "s": scale * rng.uniform(-1, 1, 300)}
    program = compiled(network, inputs).program
    assert operations(program) == {"multiplexer": 1}
    codes = program.encode(inputs)
    chosen = np.where(codes[:, 2] >= 0, codes[:, 0], codes[:, 1])
    np.testing.assert_array_equal(interpret(program, codes).outputs[:, 0], chosen)


def test_a_limit_at_one_end_is_a_clamp():
    inputs = {"x": np.linspace(-1, 1, 200)}
    for args, expected in (({"hi": np.inf}, np.maximum), ({"lo": -np.inf, "hi": 0.0}, np.minimum)):
        program = compiled(library("limiter", **args), inputs).program
        assert operations(program) == {"clamp": 1}
        codes = program.encode(inputs)
        np.testing.assert_array_equal(interpret(program, codes).outputs, expected(codes, 0))


@pytest.mark.parametrize(("width", "clear"), [(16, True), (20, False)])
@pytest.mark.parametrize("name", ["sign", "switch_2"])
def test_the_gap_is_looked_for_where_the_tested_sum_is_zero(name, width, clear):
    """Beyond 2^17 codes those about zero are tried: about the zero of the sum, not of the signal that it is made of."""
    network = Network("moved", [Port("u"), Port("v")], [Port("y")])
    network.add("part", library(name))
    network.add("less", Layer({"v": [[1.0]]}, [-0.75]))
    network.connect("v", "less.v")
    network.connect("less", "part.x" if name == "sign" else "part.s")
    for port in ("u1", "u2") if name == "switch_2" else ():
        network.connect("u", f"part.{port}", gain=1.0 if port == "u1" else -1.0)
    network.connect("part", "y")
    rng = np.random.default_rng(0)
    result = compiled(network, {"u": rng.uniform(-1, 1, 200), "v": rng.uniform(-0.2, 1, 200)}, width)
    assert ("inside its gap" not in result.passes[1].remarks[0]) == clear


@pytest.mark.parametrize("name", FORMS)
def test_the_exact_form_is_the_stated_function_everywhere(name):
    found = entry(name)
    at = found.grid(41)
    for p, gaps in found.gaps.items():  # inside a gap too, but for switch 1, whose function knows only 1 and -1
        if name != "switch_1":
            inside = [np.linspace(a, b, 7)[1:-1] for a, b in gaps]
            at[p] = np.resize(np.concatenate([np.unique(at[p]), *inside]), len(at[p]))
    form = FORMS[name][0](found.network)
    got = form.run({p: v[:, None] for p, v in at.items()})["y"][:, 0]
    np.testing.assert_array_equal(got, found.function(**at))


def test_what_was_trained_again_or_leaves_its_range_stays_and_the_pass_says_so():
    network = library("switch_2")
    gate = network.modules["gate"]
    moved = replace(network, modules=network.modules | {"gate": replace(gate, bias=gate.bias + 1e-9)})
    (remark,) = compiled(moved, inputs_of("switch_2")).passes[1].remarks
    assert remark == "switch_2 stays: its weights are no longer those of the library"
    far = inputs_of("switch_2")
    (remark,) = compiled(network, far | {"u2": 3 * far["u2"]}).passes[1].remarks
    assert "stays: u2 reaches -2.9" in remark
    assert remark.endswith("beyond its range -1..1; give it reach=3")


def test_the_pass_is_listed_with_its_change_and_can_be_left_out():
    network, inputs = library("switch_2"), inputs_of("switch_2")
    with_logic, without = compiled(network, inputs), compiled(network, inputs, meanings=False)
    assert [p.name for p in with_logic.passes][:2] == ["as declared", "use_meanings"]
    assert 1e-5 < with_logic.passes[1].change <= entry("switch_2").worst_error * 1.05  # relative to the largest output
    assert "use_meanings" not in [p.name for p in without.passes]
    exact = Record(inputs, {"y": entry("switch_2").function(**inputs)})
    logic, tanh = (np.abs(fixed_error(c.program, exact)["y"]).max() for c in (with_logic, without))
    assert logic <= 2.0**-15 < 10 * 2.0**-15 < tanh  # tables a hundred times amplified


def machine() -> Network:
    """Holds u where v turned round: an exclusive or on differences, a zero region, a switch fed by its own past."""
    network = Network("machine", [Port("u"), Port("v")], [Port("held"), Port("turned"), Port("size"), Port("smooth")])
    for name in ("xor", "zero_region", "absolute"):
        network.add(name, library(name, **({"threshold": 0.1} if name == "zero_region" else {})))
    for name in ("latch", "choice"):
        network.add(name, library("switch_2"))
    network.add("step", Layer({"now": [[0.5]], "before": [[-0.5]]}, [0.0]))
    network.connect("v", "step.now")
    network.connect("v", "step.before", delay=1)
    network.connect("step", "xor.u1")
    network.connect("step", "xor.u2", delay=1)
    network.connect("u", "latch.u1")
    network.connect("latch", "latch.u2", delay=1)
    network.connect("xor", "latch.s")
    network.connect("u", "zero_region.x")
    network.connect("zero_region", "choice.s")
    network.connect("latch", "choice.u1")
    network.connect("u", "choice.u2", gain=0.7)
    network.connect("u", "absolute.x")
    network.add("smooth_layer", Layer({"choice": [[0.8], [-0.4]]}, [0.1, 0.2], "tansig"))
    network.add("mix", Layer({"layer": [[0.5, 0.5]]}, [0.0]))
    network.connect("choice", "smooth_layer.choice")
    network.connect("smooth_layer", "mix.layer")
    for source, port in (("latch", "held"), ("xor", "turned"), ("absolute", "size"), ("mix", "smooth")):
        network.connect(source, port)
    return network


@pytest.fixture(scope="module")
def made():
    rng = np.random.default_rng(3)
    inputs = {"u": rng.uniform(-1, 1, 400), "v": np.round(rng.uniform(-1, 1, 400), 1)}
    return compiled(machine(), inputs), inputs


def test_a_latch_holds_its_code_and_logic_answers_as_the_function_does(made):
    result, inputs = made
    assert len(result.passes[1].remarks) == 5
    assert all("became logic" in r for r in result.passes[1].remarks)
    program = result.program
    codes = program.encode(inputs)
    out = program.decode(interpret(program, codes).outputs)
    u, v = codes[:, 0], np.r_[0, 0, codes[:, 1]]
    up, before = np.sign(np.diff(v)[1:]), np.sign(np.diff(v)[:-1])
    turned = up != before
    np.testing.assert_array_equal(out["turned"], np.where(turned, 1.0, -1.0))
    held, lsb = 0, program.signals["u"].fix.lsb
    for k, change in enumerate(turned):
        held = u[k] if change else held
        assert out["held"][k] == held * lsb, k
    np.testing.assert_array_equal(out["size"], np.abs(u) * lsb)


def test_the_multiplexers_are_in_the_verilog_and_the_saturated_tables_are_not(made, tmp_path):
    result, inputs = made
    without = compiled(machine(), inputs, meanings=False).program
    assert operations(result.program)["table look-up"] == 2  # the two neurons that are no logic
    assert operations(without)["table look-up"] == 12
    for architecture in ("parallel", "folded"):
        folder = tmp_path / architecture
        emit(result.program, folder, architecture)
        assert lint(folder, "machine", "-f", "machine.f") == ""
        top = (folder / "machine.v").read_text()
        assert top.count("greygate_select #(") == 3
        assert len(list(folder.glob("machine_table_*.v"))) == 1
    assert ".condition(xor__out)" in (tmp_path / "parallel" / "machine.v").read_text()


def test_hardware_with_switches_logic_and_a_latch_equals_the_emulator_in_both_architectures(made, tmp_path):
    program, inputs = made[0].program, made[1]
    codes = program.encode(inputs)
    answer = run(program, codes)
    scenario = {"record": Scenario(codes, answer.outputs, answer.states)}
    cases = [
        Case(replace(program, name=f"machine_{architecture}"), scenario, architecture, design=Design(multipliers=2))
        for architecture in ("parallel", "folded")
    ]
    result = verify_many(cases, tmp_path, seed=1)
    assert [v.mismatch for v in result.verdicts] == [None, None]
