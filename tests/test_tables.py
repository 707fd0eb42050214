"""Tables of points, of lines and of octaves: size, worst error, and that the hardware answers every code."""

import numpy as np
import pytest

from greygate import rtl
from greygate.compiler.tables import Form, make_table, output_fix
from greygate.compiler.verilog import LOOKUP_CLOCKS, table_layout, table_module, table_text
from greygate.emulator.interpreter import lookup
from greygate.emulator.numbers import Fix
from greygate.emulator.program import Lookup, Program, Signal, Terminal
from greygate.emulator.tables import Lines, Symmetry, Table
from greygate.errors import InputError
from greygate.hardware.replay import simulate
from greygate.models.activations import ACTIVATIONS
from greygate.models.arithmetic import xp

FORMS = (Form.LINES, Form.OCTAVES)
SIZE, MULTIPLIERS = 3, 2  # neurons of a module: two that share a memory and one alone, the last without a multiplier


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("arg", [Fix(10, 6), Fix(14, 11), Fix(18, 14), Fix(8, 7), Fix(16, 9), Fix(6, 2)])
@pytest.mark.parametrize("function", [name for name, a in ACTIVATIONS.items() if a.lowered == "table"])
def test_lines_state_their_worst_error_over_every_code_of_both_signs(function, arg, form):
    table = make_table(function, arg, Fix(12, 11), 1.25, form=form)
    assert list(table.problems()) == []
    codes = np.arange(0 if ACTIVATIONS[function].steep else arg.lo, arg.hi + 1)  # a root is of positive sums
    codes = np.append(codes, arg.lo)  # whose size is one more
    true = np.clip(ACTIVATIONS[function].value(xp, codes * arg.lsb), -1.0, 1.0)
    error = np.abs(lookup(table, codes) * table.out.lsb - true)
    assert table.worst_error == pytest.approx(error.max(), rel=1e-9)
    assert table.entries <= max(8, make_table(function, arg, Fix(12, 11), 1.25).entries)


@pytest.mark.parametrize(
    ("arg", "out", "entries"),
    [(Fix(15, 10), Fix(12, 11), (257, 128, 49)), (Fix(19, 14), Fix(16, 15), (1025, 512, 208)),
     (Fix(19, 14), Fix(18, 17), (2049, 1024, 416))],
)  # fmt: skip
def test_octaves_take_a_fifth_of_the_words_for_the_same_error(arg, out, entries):
    tables = [make_table("tansig", arg, out, 1.25, form=form) for form in Form]
    assert tuple(t.entries for t in tables) == entries
    assert all(t.worst_error <= 1.25 * out.lsb for t in tables)


@pytest.mark.parametrize(("out", "budgets"), [(Fix(26, 17), 1), (Fix(28, 19), 2)])
def test_octaves_of_a_root_that_hardly_fit_meet_the_budget_or_the_least_doubled_one(out, budgets):
    table = make_table("rsqrt", Fix(18, 18), out, 1.25, form=Form.OCTAVES)
    assert len(table.bases) <= 4096
    assert table.worst_error == pytest.approx(1.25 * budgets * out.lsb, rel=0.1)


def test_where_the_format_holds_the_function_208_lines_err_by_less_than_one_lsb():
    table = make_table("tansig", Fix(19, 14), Fix(16, 15), 1.0, form=Form.OCTAVES)
    assert table.entries == 208
    codes = np.arange(-(1 << 17), 1 << 17)
    true = np.tanh(codes * table.arg.lsb) / table.out.lsb
    held = np.abs(true) <= table.out.hi
    assert np.abs(lookup(table, codes) - true)[held].max() < 1.0


@pytest.mark.parametrize(("shift", "drop", "slopes"), [(3, 1, (0, 1)), (3, 1, (1, 0)), (3, 0, (0, 1)), (3, 1, (0, 0))])
def test_a_table_reaches_to_the_code_from_which_on_all_answers_of_a_sign_are_alike(shift, drop, slopes):
    """A negative code on the edge of a place is looked up one place before."""
    arg = Fix(8, 4)
    table = Lines("t", "t", Symmetry.ODD, 4, (shift,), (drop,), 3, 0, (0, 2), slopes, arg, Fix(8, 4), 0.0)
    assert list(table.problems()) == []
    answers = lookup(table, np.arange(arg.lo, arg.hi + 1))
    rising, falling = answers[-arg.lo :], answers[-arg.lo :: -1]
    alike = [int(np.flatnonzero(side != side[-1]).max(initial=-1)) + 1 for side in (rising, falling)]
    assert table.reach == max(16, *alike)  # its segments hold the codes 0 to 15


def test_a_memory_holds_octaves_at_multiples_of_their_length():
    table = make_table("tansig", Fix(19, 14), Fix(16, 15), 1.25, form=Form.OCTAVES)
    layout, s = table_layout(table), table.segments
    counts = np.diff([*s.firsts, len(s.bases)])
    for first, count, left in zip(layout.firsts, counts, s.lefts, strict=True):
        assert first % (1 << (int(count) - 1).bit_length()) == 0
        assert layout.lefts[first] == left
    assert len({*layout.lefts}) == table.entries


def odd(**changes) -> Lines:
    """Octaves of 4 and 2 segments, and two of the greatest; a place leaves out bits; slopes of both signs."""
    bases, slopes = (3, 60, 500, -70, -300, 900, 640, 200), (9, -8, 40, 7, -6, 15, -14, 0)
    parts = {"start": 4, "shifts": (2, 3, 4), "drops": (0, 1, 3), "slope_frac": 3, "guard": 1}
    parts |= {"bases": bases, "slopes": slopes, "arg": Fix(8, 4), "out": Fix(12, 4), "worst_error": 0.0} | changes
    return Lines("odd", "any", parts.pop("symmetry", Symmetry.ODD), **parts)


BASES, SLOPES = (3, 60, 500, -70, -300, 900, 640, 200, 33, 5), (9, -8, 40, 7, -6, 15, -14, 0, -31, 2)


def every_kind() -> list[Table | Lines]:
    cases = [("tansig", Fix(13, 8), Fix(10, 9)), ("logsig", Fix(12, 7), Fix(9, 8)), ("radbas", Fix(11, 7), Fix(9, 8))]
    made = [make_table(*case, 1.25, form=form) for case in cases for form in Form]
    made += [make_table("tansig", Fix(8, 4), Fix(7, 6), 1.25, interpolated=False)]
    made += [odd(), odd(symmetry=Symmetry.EVEN), odd(symmetry=Symmetry.COMPLEMENT), odd(guard=0, slope_frac=0)]
    cases = [("tansig", Fix(10, 7), Fix(9, 8)), ("radbas", Fix(9, 5), Fix(9, 8)), ("logsig", Fix(9, 5), Fix(9, 8))]
    made += [make_table(*case, segments=128) for case in cases]  # products of few bits
    made += [odd(guard=0, shifts=(2, 3, 3), drops=(0, 1, 1), bases=BASES, slopes=SLOPES)]
    return made


def bench(tables: list[Table | Lines], modules: list[str]) -> str:
    """Every code to every neuron of every table; the number of wrong answers of each table."""
    longest = max(1 << t.arg.width for t in tables) + LOOKUP_CLOCKS
    text, shown = "", []
    for k, (t, module) in enumerate(zip(tables, modules, strict=True)):
        a, w = t.arg.width, t.out.width
        same = " && ".join(f"y_{k}[{n * w}+:{w}] == wanted_{k}[now_{k} + {a}'d{n}]" for n in range(SIZE))
        codes = ", ".join(f"count[{a - 1}:0] + {a}'d{n}" for n in reversed(range(SIZE)))
        text += f"""
    reg [{w - 1}:0] wanted_{k}[0:{(1 << a) - 1}];
    initial $readmemh("wanted_{k}", wanted_{k});
    wire [{SIZE * w - 1}:0] y_{k};
    wire [{a - 1}:0] now_{k} = count[{a - 1}:0] - {a}'d{LOOKUP_CLOCKS};
    integer wrong_{k} = 0;
    {module} #(.SIZE({SIZE}), .MULTIPLIERS({MULTIPLIERS})) t_{k} (.clk(clk), .en(1'b1), .x({{{codes}}}), .y(y_{k}));
    always @(posedge clk)
        if (count >= {LOOKUP_CLOCKS} && !({same})) wrong_{k} <= wrong_{k} + 1;
"""
        shown.append(f"wrong_{k}")
    return f"""module bench (input clk);
    reg [31:0] count = 0;
    integer file;
{text}
    always @(posedge clk) begin
        count <= count + 1;
        if (count == {longest}) begin
            file = $fopen("result.json", "w");
            $fwrite(file, "[{", ".join(["%0d"] * len(tables))}]", {", ".join(shown)});
            $fclose(file);
            $finish;
        end
    end
endmodule
"""


@pytest.mark.parametrize("memory", ["block", "logic"])
def test_the_hardware_answers_every_code_as_the_program_says(memory, tmp_path):
    tables, files, modules, data = every_kind(), [], [], {}
    for k, t in enumerate(tables):
        u, y = Signal("u", 1, t.arg), Signal("y", 1, t.out)
        ports = (Terminal("u", u, "1", 1.0, 0.0),), (Terminal("y", y, "1", 1.0, 0.0),)
        program = Program(f"p{k}", ports[0], (), (Lookup(y, "u", t.name),), ports[1], (t,)).check()
        modules.append(table_module(program, t))
        files.append(tmp_path / f"{modules[-1]}.v")
        files[-1].write_text(table_text(program, t, memory))
        codes = np.arange(1 << t.arg.width)
        codes = np.where(codes >> (t.arg.width - 1), codes - (1 << t.arg.width), codes)
        data[f"wanted_{k}"] = "\n".join(f"{v:x}" for v in (lookup(t, codes) & ((1 << t.out.width) - 1)).tolist())
    blocks = [rtl.block(name) for name in ("greygate_lookup", "greygate_product")]
    wrong = simulate([*files, *blocks], bench(tables, modules), data)
    assert dict(zip(modules, wrong, strict=True)) == dict.fromkeys(modules, 0)


def test_a_table_of_more_segments_has_shorter_ones_and_errs_no_more():
    arg, out = Fix(13, 10), Fix(12, 11)
    few, many = make_table("tansig", arg, out), make_table("tansig", arg, out, segments=1024)
    assert (few.entries, few.shift) == (129, 5)
    assert (many.entries, many.shift) == (1025, 2)
    assert many.worst_error < few.worst_error
    assert make_table("tansig", Fix(8, 5), out, segments=1024).shift == 0  # no more than there are codes


def test_an_argument_of_more_codes_than_can_be_checked_is_refused():
    with pytest.raises(InputError, match=r"would answer 2\^34 arguments, and each is checked: .* a smaller --width"):
        make_table("tansig", Fix(40, 32), output_fix(8))
