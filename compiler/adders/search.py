"""The search for shared sums from several starts, in the matrix and in its transpose."""

from itertools import pairwise

import numpy as np

from greygate.compiler.adders.rounds import begin, search, transpose
from greygate.compiler.adders.shape import Term
from greygate.compiler.adders.table import (
    BOUNDED,
    COLUMNS,
    EXTRA,
    LENGTH,
    LEVEL,
    RANDOM,
    ROTATIONS,
    ROWS,
    TOP,
    ZERO,
    State,
)

ROOM = 24  # terms that a sum may hold beyond those of the longest at the start
DESTROYED, DIGITS, REWRITES = 4, 2, 90  # a round: definitions and digits at most, and rewrites in how many of 100
ROUNDS, PER_TERM = 1500, 20  # rounds of one turn at effort 1: so many, and for a small matrix so many a term
WORK = 1_500_000  # rounds times terms of one turn at most
TURNS = (9, 8)  # from the matrix and from its transpose, so that both end at the matrix
PAIRS = 1 << 21  # patterns that are counted at once: columns beyond them are first shared in blocks

Sums = list[list[Term]]


def best_sums(
    rows: Sums, columns: int, depth: int = 0, extra: list[int] | None = None, effort: float = 1.0
) -> list[tuple[Sums, Sums]]:
    """Share what the sums of the rows have in common, from several starts: (definitions, rows) of each.

    depth: the most adders in a row, 0 for no bound. extra: how many terms to leave room for in each row.
    """
    definitions, sums = _blocks(rows, columns, depth, extra)
    first = _packed(definitions, sums, columns)
    if effort <= 0 or depth:
        return [_run(first, columns, len(rows), 0, max(1, TURNS[0]) if effort > 0 else 0, effort, depth, extra)]
    return [_run(first, columns, len(rows), start, TURNS[start], effort, 0, extra) for start in (0, 1)]


def _run(
    first: tuple[np.ndarray, np.ndarray],
    columns: int,
    rows: int,
    start: int,
    turns: int,
    effort: float,
    depth: int,
    extra: list[int] | None,
) -> tuple[Sums, Sums]:
    """One start: turns of search, each in the transpose of what the one before it found."""
    body, length = first
    c, r = columns, rows
    terms = max(1, int(length.sum()))
    rounds = int(effort * min(ROUNDS, PER_TERM * terms, WORK // terms))
    for turn in range(start, max(1, start + turns)):
        if turn and not depth:
            body, length = transpose(body, length, c, r)
            c, r = r, c
        st = state(body, length, c, r, 1 + turn + 1000 * start, depth, extra)
        fits = begin(st)
        assert fits, "a sum outgrew its place"
        if turns:
            search(st, rounds, DESTROYED, DIGITS, REWRITES)
        body, length = st.terms[0], st.slot[:, LENGTH]
    return _unpacked(body, length, columns, rows)


def _blocks(rows: Sums, columns: int, depth: int, extra: list[int] | None) -> tuple[Sums, Sums]:
    """For a matrix with very many patterns: share within blocks of columns first."""
    pairs = sum(len(r) * (len(r) - 1) // 2 for r in rows)
    parts = int(np.ceil(np.sqrt(pairs / PAIRS))) if pairs else 1
    if parts < 2 or depth:
        return [], rows
    edges = [columns * i // parts for i in range(parts + 1)]
    definitions: Sums = []
    sums: Sums = [[] for _ in rows]
    for first, last in pairwise(edges):
        block = [[t for t in row if first <= t[0] < last] for row in rows]
        found, left = _run(_packed([], block, columns), columns, len(rows), 0, 0, 0.0, 0, None)
        shift = len(definitions)
        definitions += [[(o + shift if o >= columns else o, s, g) for o, s, g in d] for d in found]
        for row, more in zip(sums, left, strict=True):
            row += [(o + shift if o >= columns else o, s, g) for o, s, g in more]
    return definitions, sums


def _packed(definitions: Sums, rows: Sums, columns: int) -> tuple[np.ndarray, np.ndarray]:
    sums = [*rows, *definitions]
    length = np.array([len(s) for s in sums], np.int64)
    body = np.zeros((len(sums), int(length.max(initial=0))), np.int32)
    for k, terms in enumerate(sums):
        for i, (o, s, g) in enumerate(terms):
            op = o + len(rows) if o >= columns else o
            body[k, i] = (op << 9) | ((s + ZERO) << 1) | (g < 0)
    return body, length


def _unpacked(body: np.ndarray, length: np.ndarray, columns: int, rows: int) -> tuple[Sums, Sums]:
    """The slots as lists of terms, definitions in an order in which each stands before its users."""
    sums = [
        [(t >> 9, ((t >> 1) & 255) - ZERO, -1 if t & 1 else 1) for t in body[k, : length[k]].tolist()]
        for k in range(len(body))
    ]
    order: dict[int, int] = {}
    for r in range(rows):
        stack = [o for o, _, _ in sums[r] if o >= columns]
        while stack:
            below = [o for o, _, _ in sums[stack[-1] - columns] if o >= columns and o not in order]
            if below and stack[-1] not in order:
                stack += below
            else:
                o = stack.pop()
                order.setdefault(o, columns + len(order))
    named = [[(order.get(o, o), s, g) for o, s, g in terms] for terms in sums]
    return [named[o - columns] for o in order], named[:rows]


def state(body: np.ndarray, length: np.ndarray, columns: int, rows: int, seed: int, depth=0, extra=None) -> State:
    """Lay out the sums for a search, with every definition beside the others and room for more."""
    keep = [*range(rows), *(k for k in range(rows, len(body)) if length[k])]
    number = np.arange(columns + len(body))
    for new, k in enumerate(keep):
        number[columns + k] = columns + new
    total, longest = int(length.sum()), int(length.max(initial=0))
    slots, wide = len(keep) + total // 2 + 8, longest + ROOM
    packed = np.zeros((slots, wide), np.int32)
    count = np.zeros(slots, np.int32)
    for new, k in enumerate(keep):
        n = count[new] = length[k]
        terms = body[k, :n]
        packed[new, :n] = (number[terms >> 9] << 9) | (terms & 511)
    pairs = int((count.astype(np.int64) * (count - 1) // 2).sum())
    size = 1 << max(14, (4 * pairs).bit_length())
    index = 1 << (2 * ROTATIONS * (columns + slots)).bit_length()
    ints = np.zeros(16, np.int64)
    ints[COLUMNS], ints[ROWS], ints[TOP], ints[BOUNDED] = columns, rows, max(len(keep), rows), depth > 0
    ints[RANDOM] = seed * 2654435769 + 88172645463325252
    slot = np.zeros((slots, 9), np.int64)
    slot[:, LENGTH], slot[:, LEVEL] = count, depth
    if extra is not None:
        slot[: len(extra), EXTRA] = extra
    return State(
        np.stack([packed, np.zeros_like(packed), np.zeros_like(packed)]),
        slot,
        np.zeros((columns + slots, 5), np.int64),
        np.zeros((size, 2), np.int64),
        np.zeros((size, 2), np.int64),
        np.zeros((index, 2), np.int64),
        ints,
    )
