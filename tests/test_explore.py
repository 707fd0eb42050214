"""A request is answered by the smallest design that meets it, or by what binds; the same on every processor."""

import json
import math
import re
from functools import cache
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from greygate.compiler.adders import solve
from greygate.compiler.emit import emitted
from greygate.compiler.explore import Point, Request, Room, _words, designs, explore, misses, pareto
from greygate.compiler.explore.cost import COUNTS, blocks, clocks_of, cost, digits, explored, sums, tiles, trivial
from greygate.compiler.explore.judge import Bound, Judge, Scale, agreed
from greygate.compiler.explore.trail import Candidate, Maker, coarser, knobs, short_neurons, trail
from greygate.compiler.pipeline import compile_network, fixed_error
from greygate.compiler.quantize import Formats, quantize
from greygate.compiler.targets import Design, Memory
from greygate.compiler.targets.folded import DEEP
from greygate.emulator.numbers import Fix
from greygate.emulator.program import Affine, Program
from greygate.errors import InputError
from greygate.hardware.exploring import Explorer, bounded, facts, microseconds, requested, side_by_side
from greygate.hardware.families import DEVICES
from greygate.models.layer import Layer, Port
from greygate.models.network import Network
from greygate.models.training.record import Record

ROOM = Room(20800, 90, 50)


@cache
def lag() -> tuple[Network, dict[str, Record]]:
    """Two neurons around a state that remembers, driven in two scenarios; it repeats its own output but for noise."""
    network = Network("lag", [Port("u", "V", scale=2.0)], [Port("y", "Pa", scale=1e5)])
    network.add("neurons", Layer({"u": [[1.5], [-0.7]], "y": [[0.4], [0.9]]}, [0.1, -0.2], "tansig"))
    network.add("memory", Layer({"neurons": [[0.08, -0.05]], "y": [[0.9]]}, [0.01]))
    for source, target, delay in (("u", "neurons.u", 0), ("memory", "neurons.y", 1), ("neurons", "memory.neurons", 0)):
        network.connect(source, target, delay)
    network.connect("memory", "memory.y", 1)
    network.connect("memory", "y")
    records = {}
    for n, name in enumerate(("train", "test")):
        rng = np.random.default_rng(n)
        inputs = {"u": 2.0 * np.sin(np.arange(600) * 0.01 * (n + 1)) * rng.uniform(0.9, 1.0, 600)}
        y = network.run(inputs)["y"]
        records[name] = Record(inputs, {"y": y + 1e-3 * np.ptp(y) * rng.normal(size=600)})
    return network, records


@cache
def maker(scale: Scale = Scale.RANGE, limit: float = math.inf) -> Maker:
    network, records = lag()
    compiled = compile_network(network, records)
    return Maker(compiled.network, compiled.ranges, Judge(compiled.network, records, Bound(limit, scale)), 1e-3)


def request(**more) -> Request:
    few = {"widths": (8, 11, 14), "finer": (0,), "multipliers": (1,), "architectures": ("folded",)}
    return Request("xc7a35t", "xilinx", ROOM, **({"room": ROOM} | few | more))


# -- what a design costs ---------------------------------------------------------------------------------------------


def test_digits_are_those_of_the_canonical_form():
    def slowly(n: int) -> int:
        found = 0
        while n:
            if n & 1:
                found, n = found + 1, n - (2 - (n & 3))
            n >>= 1
        return found

    numbers = np.array([0, 1, 3, 7, -7, 11, 23, 255, -341, 2**40 - 1])
    assert digits(numbers).tolist() == [slowly(abs(int(n))) for n in numbers]


def test_adders_are_estimated_near_those_of_the_graph():
    program = maker()(Formats(14)).program
    for o in program.operations:
        if isinstance(o, Affine):
            widths = [program.signals[a].fix.width for a in o.args for _ in range(program.signals[a].size)]
            true = solve(o.weights, widths, o.bias).adder_bits
            assert true / 2 <= sums(program, o).adders <= 2 * true


@pytest.mark.parametrize(
    ("family", "words", "bits", "ports", "count"),
    [
        ("ecp5", 512, 36, 1, 1),
        ("ecp5", 513, 36, 1, 2),
        ("ecp5", 512, 36, 2, 2),
        ("ice40", 257, 16, 1, 2),
        ("xilinx", 1024, 36, 1, 1.0),
        ("xilinx", 512, 10, 2, 0.5),
    ],
)
def test_blocks_hold_words(family, words, bits, ports, count):
    assert blocks(family, words, bits, ports) == count


def test_a_product_takes_as_many_dsps_as_its_factors_are_wide():
    assert [tiles("xilinx", 25, 18), tiles("xilinx", 18, 25), tiles("ecp5", 19, 18), tiles("ice40", 17, 17)] == [
        1,
        1,
        2,
        4,
    ]


def test_every_explored_architecture_has_a_cost_on_every_family_of_a_device():
    program = maker()(Formats(12)).program
    for name in explored():
        for family in {d.family for d in DEVICES.values()}:
            found = cost(program, name, Design(memory=Memory.LOGIC), family)
            assert found.luts > 0
            assert found.clocks == clocks_of(program, name, Design()) > 0
            assert found.microseconds > 0


# -- how a program is judged -----------------------------------------------------------------------------------------


def test_errors_are_those_of_the_worst_scenario_in_each_scale():
    network, records = lag()
    made = maker()(Formats(10))
    floats = {n: network.run(r.inputs)["y"] for n, r in records.items()}
    ratio, growth = [], []
    for name, r in records.items():
        error = fixed_error(made.program, r)["y"]
        rms = np.sqrt(np.mean((error + r.targets["y"] - floats[name]) ** 2))
        ratio.append(100 * rms / np.ptp(floats[name]))
        growth.append(np.sqrt(np.mean(error**2) / np.mean((floats[name] - r.targets["y"]) ** 2)))
    assert made.error == pytest.approx(max(ratio), rel=1e-5)
    assert maker(Scale.GROWTH)(Formats(10)).error == pytest.approx(max(growth), rel=1e-5)


def test_growth_means_nothing_where_float_is_exact():
    network, records = lag()
    exact = {"a": Record(records["train"].inputs, network.run(records["train"].inputs))}
    with pytest.raises(InputError, match="growth means nothing; give per cent"):
        Judge(network, exact, Bound(1.05, Scale.GROWTH)).error(maker()(Formats(10)).program)


def test_digits_that_decide_are_few():
    assert agreed(1.23456789) == agreed(1.234567) == 1.23457
    assert agreed(math.nan) == math.inf


# -- formats ---------------------------------------------------------------------------------------------------------


def test_each_step_of_a_trail_makes_one_thing_coarser():
    make = maker()
    steps = list(trail(make(Formats(14)), make, lambda p: sum(s.size * s.fix.width for s in p.signals.values()), 1.0))
    assert len(steps) > 10
    for before, after in pairwise(steps):
        a, b = before.formats, after.formats
        changed = {k for k in a.signals | b.signals if a.signals.get(k) != b.signals.get(k)}
        changed |= {k for k in {**a.weights, **b.weights} if a.weights.get(k) != b.weights.get(k)}
        assert len(changed) + (a.table_budget != b.table_budget) == 1
        assert after.program.check()
        assert after.error == make.judge.error(after.program)
    assert steps[-1].error > steps[0].error


@pytest.mark.parametrize("finer", [0, 2])
def test_fewer_bits_of_weights_are_fewer_bits(finer):
    make = maker()
    made = make(Formats(14, finer))
    knob = next(k for k in knobs(made.program) if k == ("weights", "neurons.n"))
    formats = coarser(made, knob)
    assert digits(weights_of(make(formats).program)).sum() < digits(weights_of(made.program)).sum()
    for _ in range(6):
        formats = coarser(make(formats), knob)
    program = quantize(make.network, make.found, formats)
    assert digits(weights_of(program)).sum() < digits(weights_of(made.program)).sum() / 1.2


def weights_of(program: Program) -> np.ndarray:
    return next(o.weights for o in program.operations if o.out.name == "neurons.n")


def test_neurons_are_as_short_as_the_word_where_that_is_tried():
    make = maker()
    fine = make(Formats(14, 2))
    short = make(short_neurons(fine))
    assert (fine.program.signals["neurons"].fix, short.program.signals["neurons"].fix) == (Fix(16, 15), Fix(14, 13))
    narrow = make(Formats(14))
    assert short_neurons(narrow) == narrow.formats


def test_a_word_with_finer_bits_is_tried_with_short_neurons_beside():
    for short, fixes in ((False, [Fix(16, 15)]), (True, [Fix(16, 15), Fix(14, 13)])):
        found = _words(maker(), short, Formats(14, 2))
        assert [c.program.signals["neurons"].fix for c in found] == fixes


@pytest.mark.parametrize(
    ("weights", "bias", "alone"),
    [([[4, 0], [0, -1]], 0, True), ([[4, 0], [0, 3]], 0, False), ([[4, 1], [0, 1]], 0, False), ([[4, 0]], 1, False)],
)
def test_an_operation_that_only_shifts_needs_no_adders(weights, bias, alone):
    operation = SimpleNamespace(weights=np.array(weights), bias=np.full(len(weights), bias))
    assert trivial(None, operation) is alone


def test_an_ice40_multiplies_by_its_own_width_and_rom_is_counted_as_it_is_written():
    program = maker()(Formats(16, 2)).program
    asked = Request("up5k", "ice40", Room(5280, 8, 30), Room(5280, 8, 30))
    assert {d.factor for d in designs("folded", program, asked)} == {16}
    assert {d.factor for d in designs("folded", program, request())} == {18}
    design = Design(1, 16)
    counted = COUNTS["folded"](program, design, "ice40")
    text = emitted(program, "folded", design)
    shapes = [
        (rom[2], int(rom[3]) + 1, int(rom[1]) + 1)
        for name in text
        for rom in [re.search(r"reg (?:signed )?\[(\d+):0\] (rom|memory)\[0:(\d+)\]", text[name])]
        if rom
    ]
    assert len(shapes) == 4  # schedule, biases, table, codes
    assert counted.memories == sum(
        blocks("ice40", words, bits) for kind, words, bits in shapes if kind == "memory" or words >= DEEP
    )
    assert counted.dsps == 2


# -- the choice ------------------------------------------------------------------------------------------------------


def test_the_front_is_what_no_more_accurate_point_beats():
    rng = np.random.default_rng(1)
    made, (a, b, c) = maker()(Formats(10)), rng.uniform(1, 100, (3, 200))

    def point(error: float, luts: float, clocks: float) -> Point:
        one = cost(made.program, "folded", Design(), "xilinx", int(clocks))
        one = type(one)(int(1000 * luts), 0, 0, int(1000 * clocks), one.period)
        return Point(Candidate(made.formats, made.program, error), "folded", Design(), one)

    points = [point(*row) for row in zip(a, b, c, strict=True)]
    front = pareto(points)

    def beaten(p: Point, by: Point) -> bool:
        better = by.candidate.error < p.candidate.error
        return better and by.cost.luts <= 1.02 * p.cost.luts and by.cost.microseconds <= 1.02 * p.cost.microseconds

    assert all(not beaten(p, q) for p in front for q in front)
    assert all(any(beaten(p, q) for q in front) for p in points if p not in front)


def test_a_request_is_met_by_the_smallest():
    asked = request(bound=Bound(0.5), latency=5.0)
    found = explore(maker(limit=0.5), asked)
    assert found.chosen is not None
    assert not misses(found.chosen, asked)
    assert all(found.chosen.area(ROOM) <= p.area(ROOM) for p in found.front if not misses(p, asked))
    assert found.programs > 5
    assert found.front


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"room": Room(5, 90, 50)}, "--max-luts binds: with"),
        ({"bound": Bound(1e-9)}, "--max-error binds: with"),
        ({"latency": 1e-4}, "--max-latency binds: with"),
        ({"latency": 1e-4, "room": Room(5, 90, 50)}, "bind together; nearest is"),
    ],
)
def test_what_binds_is_told(more, says):
    found = explore(maker(), request(**more))
    assert found.chosen is None
    assert says in found.why


def test_one_word_is_one_program():
    found = explore(maker(), request(widths=(12,), multipliers=(2,)))
    assert found.programs == 1
    assert {(p.architecture, p.design.multipliers) for p in found.front} == {("folded", 2)}


def test_side_by_side_it_finds_the_same():
    asked = request(widths=(12, 14), architectures=("parallel",), bound=Bound(0.5))
    alone, both = (explore(maker(limit=0.5), asked, mapper) for mapper in (map, side_by_side(2)))
    assert json.dumps(facts(alone)) == json.dumps(facts(both))


# -- what is asked for -----------------------------------------------------------------------------------------------


def test_bounds_have_units():
    assert bounded("0.2bar", {"p": "Pa", "x": "m"}).factors == pytest.approx({"p": 1e-5})
    assert bounded("2e3", {"y": "1"}).factors == {"y": 1.0}
    assert bounded("1degC", {"t": "K"}).factors == {"t": 1.0}  # of a difference: no zero


def test_bounds_are_per_cent_or_growth():
    assert bounded("0.5%", {"y": "Pa"}) == Bound(0.5, Scale.RANGE)
    assert bounded("1.05x", {"y": "Pa"}) == Bound(1.05, Scale.GROWTH)
    assert microseconds("500ns") == 0.5
    assert microseconds(None) == math.inf


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"device": "zx81"}, "--target zx81: cannot be explored; choose up5k"),
        ({"device": "up5k", "error": "-1%"}, "--max-error -1%: give per cent"),
        ({"device": "up5k", "error": "0%"}, "--max-error 0%: give per cent"),
        ({"device": "up5k", "error": "1..2%"}, r"--max-error 1\.\.2%: give per cent"),
        ({"device": "up5k", "latency": "2"}, "--max-latency 2: give a time in s, ms, us or ns"),
        ({"device": "up5k", "latency": "fast"}, "--max-latency fast: give a time such as 2us"),
    ],
)
def test_a_request_that_means_nothing_is_one_line(options, says):
    with pytest.raises(InputError, match=says):
        requested(options.pop("device"), {"y": "Pa"}, **options)


@pytest.mark.parametrize("error", ["1bar", "1nonsense", "1m/"])
def test_a_unit_of_no_output_is_one_line(error):
    with pytest.raises(InputError, match="no output has a unit of that kind"):
        requested("up5k", {"y": "V"}, error)


def test_a_bound_that_takes_exploring_is_refused_without(greygate, tmp_path):
    code, _, err = greygate("compile", "mts", "--max-luts", 5, "--out", tmp_path / "b")
    assert (code, "No such option: --max-luts" in err) == (2, True)
    code, _, err = greygate("compile", "mts", "--max-error", "5%", "--out", tmp_path / "b")
    assert (code, "greygate explore takes other bounds" in err) == (2, True)


@pytest.fixture
def line(compiled):
    return compiled.parent / "line.toml", f"a={compiled.parent / 'a.csv'}"


def test_a_build_says_what_was_asked_and_found(greygate, line, tmp_path):
    asked = ("--target", "up5k", "--max-error", "1%", "--width", 12, "--architecture", "folded", "--macs", 1)
    code, out, err = greygate("explore", *line, *asked, "--out", tmp_path / "b", "--json")
    assert code == 0, err
    told = json.loads((tmp_path / "b/compile.json").read_text())
    assert told["explored"] == json.loads(out)["explored"]
    assert told["explored"]["chosen"]["width"] == 12
    assert told["architectures"] == ["folded"]
    assert told["design"]["multipliers"] == 1
    code, _, err = greygate("report", tmp_path / "b", "--html", tmp_path / "r.html")
    assert code == 0, err
    assert "The designs worth having on up5k" in (tmp_path / "r.html").read_text()


def test_a_request_that_no_design_meets_writes_nothing(greygate, line, tmp_path):
    asked = ("--target", "up5k", "--max-luts", 3, "--width", 12, "--architecture", "folded")
    code, out, _ = greygate("explore", *line, *asked, "--out", tmp_path / "b")
    assert code == 1
    assert "--max-luts binds: with" in out
    assert not (tmp_path / "b").exists()


def test_an_explorer_that_has_not_explored_says_nothing():
    assert Explorer(request()).lines == []


@pytest.mark.parametrize(
    ("option", "architecture"), [("--macs", "serial"), ("--factor", "parallel"), ("--dsps", "folded")]
)
def test_an_option_of_another_architecture_is_refused(greygate, line, tmp_path, option, architecture):
    code, out, err = greygate("compile", *line, "--architecture", architecture, option, "16", "--out", tmp_path / "b")
    assert (code, out) == (2, "")
    assert f"{option}: means nothing for {architecture}" in err
