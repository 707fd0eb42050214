"""The search for shared sums from several starts, in the matrix and in its transpose; less of it for a large matrix."""

from collections.abc import Callable

import numpy as np

from greygate.compiler.adders.flat import Flat
from greygate.compiler.adders.moves import COLUMNS, LENGTH, RANDOM, ROTATIONS, ROWS, TOP, ZERO, State, begin, search
from greygate.compiler.adders.shape import Term

ROOM = 24  # terms that a sum may hold beyond those of the longest at the start
REWRITES = 90  # in how many rounds of 100 sums are told apart by their values
ROUNDS, PER_TERM = 1500, 20  # rounds of one turn at effort 1: so many, and for a small matrix so many a term
WORK = 1_500_000  # rounds times terms of one turn at most
TURNS = (9, 8)  # from the matrix and from its transpose, so that both end at the matrix


# What follows counts pairs of terms in one sum. Every limit is one of size, never of time, so that any machine finds
# the same graph.
MANY = 1 << 16  # beyond them pairs are shared first (flat.py), and rounds only mend what that finds
MOST = 1 << 29  # counted at once: columns of more are shared in blocks
DIFFERENT = 1 << 21  # different ones counted at once: they take 200 bytes each
LARGE_ROUNDS, LARGE_WORK = 2000, 200_000_000  # rounds of one turn at effort 1: so many, or work as `_work` tells it
TALLIES = 64  # how much more than a look at a term the counting of a pair of a sum weighs
SEARCHED = 1 << 16  # terms up to which there are rounds at all
COUNTED, ROOMS = 1 << 21, 1 << 25  # pairs, and places for terms, up to which there are rounds: 100 and 12 bytes each
PRIME, GENERATOR = (1 << 255) - 19, 3**100  # of numbers as which sums are compared; no power of 2 below 2^200 is 1

Sums = list[list[Term]]


def best_sums(rows: Sums, columns: int, effort: float = 1.0, rewrites: int = REWRITES) -> list[tuple[Sums, Sums]]:
    """Share what the sums of the rows have in common, from several starts: (definitions, rows) of each.

    rewrites: as REWRITES; 0 for weights of more than WIDEST places.
    """
    flat = _flat(rows, columns)
    pairs = max(flat.pairs, flat.transposed().pairs)
    if pairs > MANY:
        return [_large(flat, effort, rewrites)]
    if pairs > DIFFERENT:
        return [([], rows)]
    terms = max(1, len(flat.terms))
    rounds = int(effort * min(ROUNDS, PER_TERM * terms, WORK // terms))
    if effort <= 0:
        return [_turned(flat, range(1), lambda length: 0, rewrites)]
    return [
        _turned(flat, range(start, start + turns), lambda length: rounds, rewrites, 1000 * start)
        for start, turns in enumerate(TURNS)
    ]


def looked(columns: int, definitions: Sums, rows: Sums) -> list[int]:
    """The rows' linear forms at columns that are powers of a number, modulo a prime: equal rows give equal numbers."""
    found = [pow(GENERATOR, c, PRIME) for c in range(columns)]
    turned = {s: pow(2, s, PRIME) for s in {s for terms in (*definitions, *rows) for _, s, _ in terms}}
    for terms in definitions:
        found.append(sum(g * found[o] * turned[s] for o, s, g in terms) % PRIME)
    return [sum(g * found[o] * turned[s] for o, s, g in terms) % PRIME for terms in rows]


def _large(flat: Flat, effort: float, rewrites: int) -> tuple[Sums, Sums]:
    """Pairs shared in the matrix and in its transpose, and the better of the two mended in turns."""
    ways = [_shared(flat), _shared(flat.transposed()).transposed()]
    found = min(ways, key=lambda f: f.adders)

    def rounds(length: np.ndarray) -> int | None:
        return int(effort * min(LARGE_ROUNDS, LARGE_WORK // _work(length))) if _fits(length) else None

    turns = TURNS[0] if effort > 0 and len(found.terms) <= SEARCHED else 0
    return _turned(found, range(turns), rounds, rewrites)


def _turned(
    flat: Flat, turns: range, rounds: Callable[[np.ndarray], int | None], rewrites: int, seed: int = 0
) -> tuple[Sums, Sums]:
    """Turns of search, each in the transpose of what the one before it found; turn 0 in the matrix itself.

    rounds: of a turn, from how many terms each sum has; None leaves the turn out.
    """
    for turn in turns:
        flat = flat.transposed() if turn else flat
        body, length = flat.packed()
        if (count := rounds(length)) is None:
            continue
        st = state(body, length, flat.columns, flat.rows, 1 + turn + seed)
        fits = begin(st)
        assert fits, "a sum outgrew its place"
        search(st, count, rewrites)
        flat = Flat.of(st.terms[0], st.slot[:, LENGTH], flat.columns, flat.rows)
    return _unpacked(*flat.packed(), flat.columns, flat.rows)


def _fits(length: np.ndarray) -> bool:
    """Whether the arrays of a search are not too large."""
    places = (len(length) + int(length.sum()) // 2) * (int(length.max(initial=0)) + ROOM)
    return places <= ROOMS and int((length * (length - 1) // 2).sum()) <= COUNTED


def _work(length: np.ndarray) -> int:
    """Steps of one round, about: it looks at every term, and counts the pairs of a few sums, long ones more often."""
    total = max(1, int(length.sum()))
    return total + TALLIES * int((length**3).sum()) // total


def _shared(flat: Flat) -> Flat:
    """The pairs shared; of very many first within blocks of columns, and then the rest if it is not too much."""
    parts = _parts(flat)
    if parts > 1:
        flat = flat.cut(parts).shared().joined(flat.rows)
    return flat.shared() if _parts(flat) == 1 else flat


def _parts(flat: Flat) -> int:
    """Blocks of columns in which few enough pairs stand."""
    pairs = flat.pairs
    different = min(pairs, flat.columns**2 * flat.places)
    return min(flat.columns, max(1, -(-pairs // MOST), -(-different // DIFFERENT)))


def _flat(rows: Sums, columns: int) -> Flat:
    """The rows as flat arrays."""
    of_sum = np.repeat(np.arange(len(rows)), [len(r) for r in rows])
    terms = [(o << 9) | ((s + ZERO) << 1) | (g < 0) for r in rows for o, s, g in r]
    return Flat(columns, len(rows), len(rows), of_sum, np.array(terms, np.int64))


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


def state(body: np.ndarray, length: np.ndarray, columns: int, rows: int, seed: int) -> State:
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
    ints[COLUMNS], ints[ROWS], ints[TOP] = columns, rows, max(len(keep), rows)
    ints[RANDOM] = seed * 2654435769 + 88172645463325252
    slot = np.zeros((slots, 6), np.int64)
    slot[:, LENGTH] = count
    return State(
        np.stack([packed, np.zeros_like(packed), np.zeros_like(packed)]),
        slot,
        np.zeros((columns + slots, 5), np.int64),
        np.zeros(columns + slots),
        np.zeros((size, 2), np.int64),
        np.zeros((size, 2), np.int64),
        np.zeros((index, 2), np.int64),
        ints,
    )
