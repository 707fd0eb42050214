"""Weights as words with shifts, for the multipliers of the folded architecture: weight = sum of word << shift."""

from collections.abc import Iterator
from functools import cache
from itertools import combinations
from math import comb

import numpy as np

COMBINATIONS = 2_000  # sets of stages that are tried one by one
UNITS = range(1, 9)  # of those that are not


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


def pieces(weights: np.ndarray, width: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(words, shifts) of which the weights are the sums; every word is odd or 0 and has at most `width` bits."""
    rest, above = odd_part(weights)
    while np.any(rest):
        low = ((rest + (1 << (width - 1))) & ((1 << width) - 1)) - (1 << (width - 1))
        words = np.where(width_of(rest) > width, low, rest)
        yield words, above
        rest, more = odd_part((rest - words) >> width)
        above = above + more + width


def sums_of(stages: tuple[int, ...]) -> dict[int, int]:
    """Shift -> select of every shift that the stages make."""
    found = {0: 0}
    for i, amount in enumerate(stages):
        found |= {shift + amount: select | 1 << i for shift, select in found.items() if shift + amount not in found}
    return found


def choose_stages(ranges: frozenset[tuple[int, int]]) -> tuple[int, tuple[int, ...]]:
    """The least shift of all, and the fewest stages beyond it that reach into each range (least, greatest)."""
    if not ranges:
        return 0, ()
    base = min(greatest for _, greatest in ranges)
    return base, _stages(frozenset((max(0, least - base), greatest - base) for least, greatest in ranges))


@cache
def _stages(ranges: frozenset[tuple[int, int]]) -> tuple[int, ...]:
    masks = {(2 << hi) - (1 << lo) for lo, hi in ranges}
    top = max(hi for _, hi in ranges)
    apart, reached = 0, -1  # ranges of which no two meet: each needs a shift of its own
    for lo, hi in sorted(ranges, key=lambda r: r[1]):
        if lo > reached:
            apart, reached = apart + 1, hi

    def reaches(stages: tuple[int, ...]) -> bool:
        reached = 1
        for amount in stages:
            reached |= reached << amount
        return all(reached & mask for mask in masks)

    for count in range((apart - 1).bit_length(), top.bit_length()):
        if comb(top, count) <= COMBINATIONS:
            candidates: Iterator[tuple[int, ...]] = combinations(range(1, top + 1), count)
        else:
            candidates = (
                (*(unit << i for i in range(count - 1)), last) for unit in UNITS for last in range(1, top + 1)
            )
        for stages in candidates:
            if reaches(stages):
                return stages
    return tuple(1 << i for i in range(top.bit_length()))


def selected(
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
