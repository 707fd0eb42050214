"""The folded architecture: its words, shifts, drains and jobs, in plain integers."""

from dataclasses import replace

import numpy as np
import pytest
from legal_programs import legal_program
from programs import cylinder_program, random_program

from greygate.compiler.emit import emitted
from greygate.compiler.folding.jobs import is_ordered, planned
from greygate.compiler.folding.products import Products, laid_out
from greygate.compiler.folding.schedule import FIELDS, fold
from greygate.compiler.folding.words import choose_stages, odd_part, pieces, sums_of, width_of
from greygate.compiler.targets import FACTORS, Design
from greygate.emulator.program import Affine, Program

PROGRAMS = [cylinder_program(), *map(random_program, range(6)), *map(legal_program, range(6))]


def shift_of(products: Products, select: int) -> int:
    return products.base + sum(amount for i, amount in enumerate(products.stages) if select >> i & 1)


def part_of(products: Products, code: int, index: int, width: int) -> int:
    part = products.parts[index]
    kept = (code & (1 << width) - 1) >> part.low
    if not part.signed:
        return kept & (1 << products.x_width - 1) - 1
    kept &= (1 << products.x_width) - 1
    return code >> part.low if width - part.low <= products.x_width else kept


def drained(products: Products, total: int, index: int) -> int:
    """The code of an aligned sum, before it saturates or wraps."""
    mode = products.modes[index]
    tie = mode.even and total & (1 << mode.shift) - 1 == 0
    return (total >> mode.shift) & ~1 if tie else total >> mode.shift


def rounded(o: Affine, row: int, total: int) -> int:
    """The same by docs/integer-program.md."""
    shift = int(o.frac[row]) - o.out.fix.frac
    if shift <= 0:
        return total << -shift
    half = {"truncate": 0, "half_up": 1 << shift - 1}.get(o.rounding.value)
    return (total + ((1 << shift - 1) - 1 + (total >> shift & 1) if half is None else half)) >> shift


@pytest.mark.parametrize("factor", [9, 16, 18])
@pytest.mark.parametrize("program", PROGRAMS, ids=lambda p: p.name)
def test_words_and_drains_give_every_row_of_a_program(program: Program, factor: int):
    products = laid_out(program, list(program.operations), 2, factor)
    rng = np.random.default_rng(0)
    for o in program.operations:
        if not isinstance(o, Affine):
            continue
        layer = products.layers[o.out.name]
        formats = [program.signals[a].fix for a in o.args for _ in range(program.signals[a].size)]
        for draw in range(8):
            codes = [f.lo if draw == 0 else int(rng.integers(f.lo, f.hi, endpoint=True)) for f in formats]
            for r in range(o.out.size):
                total = layer.biases[r]
                for c, j in enumerate(layer.columns.tolist()):
                    part = part_of(products, codes[j], int(layer.parts[c]), formats[j].width)
                    total += part * int(layer.words[r, c]) << shift_of(products, int(layer.selects[r, c]))
                assert -(1 << products.acc_width - 1) <= total < 1 << products.acc_width - 1
                exact = int(o.bias[r]) + sum(int(w) * x for w, x in zip(o.weights[r].tolist(), codes, strict=True))
                assert drained(products, total, layer.modes[r]) == rounded(o, r, exact)
        assert int(width_of(layer.words).max()) <= products.word_width <= 18


def test_pieces_of_a_weight_are_odd_and_narrow_and_sum_to_it():
    rng = np.random.default_rng(1)
    weights = rng.integers(-(1 << 61), 1 << 61, 200) >> rng.integers(0, 61, 200)
    total = np.zeros(weights.shape, object)
    for words, shifts in pieces(weights, 16):
        assert (words[words != 0] % 2 == 1).all()
        assert int(width_of(words).max()) <= 16
        total += words.astype(object) << shifts.astype(object)
    assert total.tolist() == weights.tolist()
    odd, shift = odd_part(weights)
    assert (odd << shift == weights).all()
    assert width_of(np.array([0, 1, -1, -2, 127, -128, 128])).tolist() == [1, 2, 1, 2, 8, 8, 9]


def test_stages_reach_into_every_range_and_are_as_few_as_can_be():
    assert choose_stages(frozenset()) == (0, ())
    assert choose_stages(frozenset({(3, 3), (4, 4), (5, 5), (6, 6)})) == (3, (1, 2))
    assert choose_stages(frozenset({(0, 2), (1, 5), (2, 9)})) == (2, ())
    base, stages = choose_stages(frozenset({(0, 0), (0, 3), (7, 9), (21, 40)}))
    assert (base, len(stages)) == (0, 2)
    assert {0, 7, 21} <= set(sums_of((7, 14)))


@pytest.mark.parametrize("multipliers", [1, 3])
def test_every_element_is_written_before_it_is_read_and_a_state_after_its_last_reader(multipliers: int):
    for program in PROGRAMS:
        plan = planned(program, multipliers)
        assert is_ordered(plan.jobs.values())
        folding = fold(program, multipliers, FACTORS[-1])
        words = [
            w for name, found in folding.address.items() if name not in plan.home for w in found.tolist() if w >= 0
        ]
        assert len(set(words)) == len(words) == folding.size


def test_a_large_layer_keeps_its_multipliers_busy():
    rng = np.random.default_rng(2)
    program = cylinder_program()
    o = next(o for o in program.operations if isinstance(o, Affine))
    u = replace(program.inputs[0].signal, name="u", size=40)
    wide = Affine(
        replace(o.out, size=40),
        ("u",),
        rng.integers(-99, 99, (40, 40)) * 2 + 1,
        np.zeros(40, np.int64),
        np.full(40, 20),
    )
    shown = replace(program.outputs[0], signal=wide.out)
    made = Program("wide", (replace(program.inputs[0], signal=u),), (), (wide,), (shown,)).check()
    for multipliers in (1, 4):
        folding = fold(made, multipliers, FACTORS[-1])
        assert folding.utilisation > 0.9 if multipliers == 1 else folding.utilisation > 0.85
        done = folding.controls[:, FIELDS.index("done")]
        assert done.sum() == 2  # of the reset and of the step


def test_a_long_schedule_is_written_as_numbers():
    program = cylinder_program()
    o = next(o for o in program.operations if isinstance(o, Affine))
    u = replace(program.inputs[0].signal, name="u", size=80)
    wide = Affine(replace(o.out, size=80), ("u",), np.ones((80, 80), np.int64), np.zeros(80, np.int64), np.full(80, 20))
    shown = replace(program.outputs[0], signal=wide.out)
    made = Program("wide", (replace(program.inputs[0], signal=u),), (), (wide,), (shown,)).check()
    text = emitted(made, "folded", Design(multipliers=1))["wide__schedule.v"]
    assert "rom[4096] = " in text
    assert "'h" in text
