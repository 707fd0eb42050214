"""How the folded architecture multiplies: weights as narrow words with shifts, codes in parts, rows aligned.

A weight is `word << shift`; a word fits the multipliers of every FPGA. The rows are aligned: a row is summed at the
fraction at which it is drained, `mode.shift` bits finer than its result, so that few drains serve all rows.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import NamedTuple

import numpy as np

from greygate.emulator.program import Affine, Operation, Overflow, Program, Rounding, signed_width

OPERANDS = (16, 18)  # widths of the multipliers that every family has: 16 x 16 on the iCE40, 18 x 18 on the others
FEW = 1.05  # products, as a factor, that narrower multipliers may cost
WIDER = 3  # bits that aligning a row may add to the widest sum: a drain of its own costs as many LUTs
COMBINATIONS = 20_000  # sets of stages that are tried one by one


class Mode(NamedTuple):
    """How a sum becomes a code: bits dropped, whether a tie goes to even, the width of the format, whether it wraps."""

    shift: int
    even: bool
    width: int
    wraps: bool


class Part(NamedTuple):
    """Which bits of a code a multiplier takes: from bit `low` up, the last one its sign or a 0."""

    low: int
    signed: bool


PLAIN = Part(0, True)


@dataclass(frozen=True)
class Layer:
    """An affine operation for the multipliers.

    columns: the element of the arguments that each column reads, by its place among them; one may stand in several.
    parts: the part of the code that a column takes, as an index into `Products.parts`. words, selects: (rows, columns),
    the words and the stages that shift their products. biases: with the rounding constant, aligned. modes: one a row,
    indices into `Products.modes`.
    """

    columns: np.ndarray
    parts: np.ndarray
    words: np.ndarray
    selects: np.ndarray
    biases: list[int]
    modes: list[int]


@dataclass(frozen=True)
class Products:
    """All layers, and the widths that they share.

    base, stages: a product is shifted by `base`, and by `stages[i]` where bit i of its select is set.
    """

    layers: dict[str, Layer]
    x_width: int
    word_width: int
    acc_width: int
    base: int
    stages: tuple[int, ...]
    parts: tuple[Part, ...]
    modes: tuple[Mode, ...]
    count: int  # products of a step


def laid_out(program: Program, operations: list[Operation]) -> Products:
    """The products of some operations, for the narrowest multipliers that do not cost many more of them."""
    affine = [o for o in operations if isinstance(o, Affine)]
    wide = _Maker(program, affine, OPERANDS[-1])
    narrow = _Maker(program, affine, OPERANDS[0])
    return (narrow if narrow.count <= FEW * wide.count else wide).products()


class _Maker:
    def __init__(self, program: Program, affine: list[Affine], operand: int):
        self.program, self.affine, self.operand = program, affine, operand
        self.parts: dict[Part, int] = {PLAIN: 0}
        self.x_width = min(operand, max([2, *(program.signals[a].fix.width for o in self.affine for a in o.args)]))
        self.widths = {o.out.name: _row_widths(program, o) for o in self.affine}
        self.aligned = _alignment(self.affine, self.widths)
        self.split = {o.out.name: self._columns(o) for o in self.affine}
        self.count = sum(int(np.count_nonzero(words)) for _, _, words, _ in self.split.values())

    def products(self) -> Products:
        words = [words for _, _, words, _ in self.split.values()]
        shifts = [shifts for *_, shifts in self.split.values()]
        word_width = max([2, *(int(width_of(w).max()) for w in words)])
        pairs = [_pairs(w, s, word_width) for w, s in zip(words, shifts, strict=True)]
        base, stages = choose_stages({p for found in pairs for p in found})
        modes: dict[Mode, int] = {}
        layers, acc_width = {}, 2
        for o in self.affine:
            columns, parts, words_, shifts_ = self.split[o.out.name]
            words_, selects = _selected(words_, shifts_, word_width, base, stages)
            biases, chosen = [], []
            for r in range(o.out.size):
                mode, bias, width = self._row(o, r)
                biases.append(bias)
                chosen.append(modes.setdefault(mode, len(modes)))
                acc_width = max(acc_width, width)
            layers[o.out.name] = Layer(columns, parts, words_, selects, biases, chosen)
        return Products(
            layers, self.x_width, word_width, acc_width, base, stages, tuple(self.parts), tuple(modes), self.count
        )

    def _row(self, o: Affine, r: int) -> tuple[Mode, int, int]:
        """The mode of a row, its bias with the rounding constant, and the width of its sum, all aligned."""
        shift = int(o.frac[r]) - o.out.fix.frac
        to = self.aligned[o.out.name][r]
        half = 1 << (to - 1) if shift > 0 and o.rounding is not Rounding.TRUNCATE else 0
        mode = Mode(to, shift > 0 and o.rounding is Rounding.HALF_EVEN, o.out.fix.width, o.overflow is Overflow.WRAP)
        return mode, (int(o.bias[r]) << (to - shift)) + half, self.widths[o.out.name][r] + to - shift

    def _columns(self, o: Affine) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Element, part, words and aligned shifts of every column that some row needs; at least one."""
        to = np.array(self.aligned[o.out.name]) - (o.frac - o.out.fix.frac)
        found: list[tuple[np.ndarray, int, np.ndarray, np.ndarray]] = []
        pieces = list(_pieces(o.weights, self.operand))
        first = 0
        for a in o.args:
            signal = self.program.signals[a]
            span = slice(first, first + signal.size)
            for part in _parts(signal.fix.width, self.x_width):
                for words, shifts in pieces:
                    used = np.flatnonzero(np.any(words[:, span] != 0, axis=0)) + first
                    if used.size:
                        index = self.parts.setdefault(part, len(self.parts))
                        found.append((used, index, words[:, used], shifts[:, used] + part.low + to[:, None]))
            first += signal.size
        if not found:  # no weight at all
            zero = np.zeros((o.out.size, 1), np.int64)
            return np.zeros(1, np.int64), np.zeros(1, np.int64), zero, zero
        columns = np.concatenate([used for used, *_ in found])
        parts = np.concatenate([np.full(len(used), index) for used, index, *_ in found])
        words = np.concatenate([w for *_, w, _ in found], axis=1)
        shifts = np.concatenate([s for *_, s in found], axis=1)
        return columns, parts, words, shifts


def _parts(width: int, x_width: int) -> list[Part]:
    """The parts of a code: itself if it is narrow, else pieces from the lowest up, of which only the last is signed."""
    if width <= x_width:
        return [PLAIN]
    lows = list(range(0, width - 1, x_width - 1))
    if len(lows) > 1 and width - lows[-2] <= x_width:
        lows.pop()
    return [Part(low, low == lows[-1]) for low in lows]


def _row_widths(program: Program, o: Affine) -> list[int]:
    """Width of each row's sum with its rounding constant."""
    largest = np.array([-program.signals[a].fix.lo for a in o.args for _ in range(program.signals[a].size)], object)
    magnitude = np.abs(o.weights).astype(object) @ largest
    shift = [int(s) for s in o.frac - o.out.fix.frac]
    rounding = [1 << (s - 1) if s > 0 else 0 for s in shift]
    return [signed_width(int(m) + abs(int(b)) + h) for m, b, h in zip(magnitude, o.bias, rounding, strict=True)]


def _alignment(affine: list[Affine], widths: dict[str, list[int]]) -> dict[str, list[int]]:
    """The bits that the drain of each row drops; equal for as many rows as the widest sum allows."""
    rows = [
        (int(s), width, o.out.name, r)
        for o in affine
        for r, (s, width) in enumerate(zip(o.frac - o.out.fix.frac, widths[o.out.name], strict=True))
    ]
    widest = max([width - min(0, s) for s, width, *_ in rows], default=2) + WIDER
    chosen: list[int] = []
    aligned: dict[str, list[int]] = {o.out.name: [0] * o.out.size for o in affine}
    for s, width, name, r in sorted(rows, reverse=True):
        fitting = [c for c in chosen if width + c - s <= widest]
        if not fitting:
            chosen.append(max(0, s))
            fitting = chosen[-1:]
        aligned[name][r] = fitting[0]
    return aligned


# -- words and shifts ------------------------------------------------------------------------------------------------


def width_of(values: np.ndarray) -> np.ndarray:
    """The least width in two's complement of each integer of 64 bits."""
    rest = np.where(values < 0, ~values, values)
    width = np.ones(values.shape, np.int64)
    for step in (32, 16, 8, 4, 2, 1):
        above = rest >> step != 0
        width += np.where(above, step, 0)
        rest = np.where(above, rest >> step, rest)
    return width + (rest != 0)


def odd_part(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(odd, shift) with values = odd << shift; (0, 0) for 0."""
    odd, shift = values.copy(), np.zeros(values.shape, np.int64)
    for step in (32, 16, 8, 4, 2, 1):
        even = (odd & ((1 << step) - 1) == 0) & (odd != 0)
        shift += np.where(even, step, 0)
        odd = np.where(even, odd >> step, odd)
    return odd, shift


def _pieces(weights: np.ndarray, width: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(words, shifts) of which the weights are the sums; every word is odd or 0 and has at most `width` bits."""
    rest, above = odd_part(weights)
    while np.any(rest):
        low = ((rest + (1 << (width - 1))) & ((1 << width) - 1)) - (1 << (width - 1))
        words = np.where(width_of(rest) > width, low, rest)
        yield words, above
        rest, more = odd_part((rest - words) >> width)
        above = above + more + width


def _pairs(words: np.ndarray, shifts: np.ndarray, width: int) -> set[tuple[int, int]]:
    """(least, greatest) shift with which each product may be made: a narrow word may itself be shifted."""
    used = words != 0
    greatest = shifts[used]
    least = np.maximum(0, greatest - (width - width_of(words[used])))
    return set(map(tuple, np.unique(np.stack([least, greatest], axis=1), axis=0).tolist()))


def sums_of(stages: tuple[int, ...]) -> dict[int, int]:
    """Shift -> select of every shift that the stages make."""
    found = {0: 0}
    for i, amount in enumerate(stages):
        found |= {shift + amount: select | 1 << i for shift, select in found.items() if shift + amount not in found}
    return found


def choose_stages(ranges: set[tuple[int, int]]) -> tuple[int, tuple[int, ...]]:
    """The least shift of all, and the fewest stages beyond it that reach into each range (least, greatest)."""
    if not ranges:
        return 0, ()
    base = min(greatest for _, greatest in ranges)
    needed = {(max(0, least - base), greatest - base) for least, greatest in ranges}
    masks = {(2 << hi) - (1 << lo) for lo, hi in needed}
    top = max(hi for _, hi in needed)

    def reaches(stages: tuple[int, ...]) -> bool:
        reached = 1
        for amount in stages:
            reached |= reached << amount
        return all(reached & mask for mask in masks)

    for count in range(top.bit_length() + 1):
        if comb(top, count) <= COMBINATIONS:
            candidates = combinations(range(1, top + 1), count)
        else:
            candidates = (
                tuple(sorted([*(unit << i for i in range(count - 1)), last]))
                for unit in range(1, 9)
                for last in range(1, top + 1)
            )
        for stages in candidates:
            if reaches(stages):
                return base, stages
    return base, tuple(1 << i for i in range(top.bit_length()))


def _selected(
    words: np.ndarray, shifts: np.ndarray, width: int, base: int, stages: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """The words and selects with which the stages make `words << shifts`."""
    reached = sums_of(stages)
    available = np.array(sorted(reached))
    selects = np.array([reached[shift] for shift in available.tolist()])
    nearest = np.maximum(np.searchsorted(available, shifts - base, side="right") - 1, 0)
    used = words != 0
    left = np.where(used, shifts - base - available[nearest], 0)
    moved = words << left
    assert (left >= 0).all(), "a product needs a smaller shift than the stages make"
    assert int(width_of(moved).max(initial=2)) <= width, "a word is wider than the multiplier"
    return moved, np.where(used, selects[nearest], 0)
