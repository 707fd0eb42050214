"""How the folded architecture multiplies: weights as narrow words with shifts, codes in parts, rows aligned.

A weight is `word << shift`; a word fits the multipliers of every FPGA. The rows are aligned: a row is summed at the
fraction at which it is drained, `mode.shift` bits finer than its result, so that few drains serve all rows.
"""

from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from greygate.compiler.folding.words import choose_stages, pieces, selected, width_of
from greygate.emulator.numbers import Overflow, Rounding
from greygate.emulator.program import Affine, Operation, Program

NARROW = 16  # bits of the factors that every family multiplies in one DSP
FEW = 1.05  # products, as a factor, that narrower multipliers may cost
DRAINS = 3  # the most different shifts of drains that are tried
TRIED = 12  # the most shifts of rows of which every set is tried
BIAS = 1 << 12  # makes shifts positive


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


def laid_out(program: Program, operations: list[Operation], multipliers: int, factor: int) -> Products:
    """The products of some operations, for the narrowest multipliers that do not cost many more of them.

    factor: bits of the widest factor that is multiplied whole.
    """
    affine = [o for o in operations if isinstance(o, Affine)]
    chosen = _Split(program, affine, factor)
    if factor > NARROW:
        narrow = _Split(program, affine, NARROW)
        chosen = narrow if narrow.count <= FEW * chosen.count else chosen
    return chosen.products(_drains(chosen, multipliers))


class _Split:
    """The products before rows are aligned.

    columns: operation -> element, part, words and shifts (rows, columns) of every column that some row needs. shifts:
    of its rows, the bits that a drain drops; widths: of their sums.
    """

    def __init__(self, program: Program, affine: list[Affine], factor: int):
        self.program, self.affine, self.factor = program, affine, factor
        self.parts: dict[Part, int] = {PLAIN: 0}
        self.x_width = min(factor, max([2, *(program.signals[a].fix.width for o in affine for a in o.args)]))
        self.columns = {o.out.name: self._columns(o) for o in affine}
        self.count = sum(int(np.count_nonzero(words)) for _, _, words, _ in self.columns.values())
        self.word_width = max([2, *(int(width_of(words).max()) for _, _, words, _ in self.columns.values())])
        self.shifts = {o.out.name: o.frac - o.out.fix.frac for o in affine}
        self.widths = {o.out.name: np.array(program.row_widths(o)) for o in affine}

    def _columns(self, o: Affine) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        found: list[tuple[np.ndarray, int, np.ndarray, np.ndarray]] = []
        split = list(pieces(o.weights, self.factor))
        first = 0
        for a in o.args:
            signal = self.program.signals[a]
            span = slice(first, first + signal.size)
            for part in _parts(signal.fix.width, self.x_width):
                for words, shifts in split:
                    used = np.flatnonzero(np.any(words[:, span] != 0, axis=0)) + first
                    if used.size:
                        index = self.parts.setdefault(part, len(self.parts))
                        found.append((used, index, words[:, used], shifts[:, used] + part.low))
            first += signal.size
        if not found:  # no weight at all
            zero = np.zeros((o.out.size, 1), np.int64)
            return np.zeros(1, np.int64), np.zeros(1, np.int64), zero, zero
        columns = np.concatenate([used for used, *_ in found])
        parts = np.concatenate([np.full(len(used), index) for used, index, *_ in found])
        words = np.concatenate([w for *_, w, _ in found], axis=1)
        return columns, parts, words, np.concatenate([s for *_, s in found], axis=1)

    def kinds(self) -> np.ndarray:
        """The different (bits dropped, shift, room) of all products; a word has room for as many bits more."""
        found = [np.zeros((0, 3), np.int64)]
        for name, (_, _, words, shifts) in self.columns.items():
            used = words != 0
            dropped = np.broadcast_to(self.shifts[name][:, None], words.shape)[used]
            room = self.word_width - width_of(words[used])
            coded = np.unique((dropped + BIAS) << 32 | shifts[used] << 16 | room)
            found.append(np.stack([(coded >> 32) - BIAS, (coded >> 16) & 0xFFFF, coded & 0xFFFF], axis=1))
        return np.unique(np.concatenate(found), axis=0)

    def products(self, drains: tuple[int, ...]) -> Products:
        """The products whose rows are drained with these shifts."""
        base, stages = choose_stages(_ranges(self.kinds(), drains))
        modes: dict[Mode, int] = {}
        layers, acc_width = {}, 2
        for o in self.affine:
            name = o.out.name
            columns, parts, words, shifts = self.columns[name]
            more = _aligned(self.shifts[name], drains) - self.shifts[name]
            words, selects = selected(words, shifts + more[:, None], self.word_width, base, stages)
            biases, chosen = [], []
            for r, (shift, up) in enumerate(zip(self.shifts[name].tolist(), more.tolist(), strict=True)):
                half = 1 << (shift - 1) if shift > 0 and o.rounding is not Rounding.TRUNCATE else 0
                biases.append((int(o.bias[r]) + half) << up)
                even = shift > 0 and o.rounding is Rounding.HALF_EVEN
                mode = Mode(shift + up, even, o.out.fix.width, o.overflow is Overflow.WRAP)
                chosen.append(modes.setdefault(mode, len(modes)))
            acc_width = max(acc_width, int((self.widths[name] + more).max()))
            layers[name] = Layer(columns, parts, words, selects, biases, chosen)
        return Products(
            layers, self.x_width, self.word_width, acc_width, base, stages, tuple(self.parts), tuple(modes), self.count
        )


def _aligned(shifts: np.ndarray, drains: tuple[int, ...]) -> np.ndarray:
    """The least of the drains that drops at least as many bits as each row does."""
    return np.array(drains)[np.searchsorted(drains, shifts)]


def _ranges(kinds: np.ndarray, drains: tuple[int, ...]) -> frozenset[tuple[int, int]]:
    """(least, greatest) shift with which each product may be made: a word with room may itself be shifted."""
    greatest = kinds[:, 1] + _aligned(kinds[:, 0], drains) - kinds[:, 0]
    return frozenset(zip(np.maximum(0, greatest - kinds[:, 2]).tolist(), greatest.tolist(), strict=True))


def _drains(split: _Split, multipliers: int) -> tuple[int, ...]:
    """The shifts of drains, in rising order, with which the sums, the stages and the drains take the fewest LUTs."""
    rows = {
        row
        for name, shifts in split.shifts.items()
        for row in zip(shifts.tolist(), split.widths[name].tolist(), strict=True)
    }
    wanted = sorted({s for s, _ in rows})
    if not wanted:
        return (0,)
    last, kinds = max(0, wanted[-1]), split.kinds()
    least = [s for s in wanted if 0 <= s < last]
    if len(least) > TRIED:
        least = sorted({least[i * len(least) // TRIED] for i in range(TRIED)})
    width = max(o.out.fix.width for o in split.affine)
    best: tuple[int, tuple[int, ...]] | None = None
    for count in range(DRAINS):
        for more in combinations(least, count):
            drains = (*more, last)
            acc = max(w + drains[np.searchsorted(drains, s)] - s for s, w in rows)
            cost = multipliers * acc * 2 + width * count
            if best is None or cost < best[0]:
                cost += multipliers * acc * len(choose_stages(_ranges(kinds, drains))[1])
                if best is None or cost < best[0]:
                    best = cost, drains
    assert best is not None
    return best[1]


def _parts(width: int, x_width: int) -> list[Part]:
    """The parts of a code: itself if it is narrow, else pieces from the lowest up, of which only the last is signed."""
    if width <= x_width:
        return [PLAIN]
    lows = list(range(0, width - 1, x_width - 1))
    if len(lows) > 1 and width - lows[-2] <= x_width:
        lows.pop()
    return [Part(low, low == lows[-1]) for low in lows]
