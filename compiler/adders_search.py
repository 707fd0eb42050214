"""The search for shared sums: pairs of terms that occur often become definitions; then parts are undone and done again.

Everything is integers and one generator of pseudo-random numbers, so that every processor finds the same graph.
A *term* is one integer: operand << 9 | (shift + 128) << 1 | (1 if negative). Operands 0 to columns - 1 are columns,
columns + k is the sum in slot k. Slots 0 to rows - 1 are the rows of the matrix, the others definitions.
"""

import numpy as np
from numba import njit

from greygate.compiler.adders_shape import Term

ZERO = 128  # the shift 0 as a term holds it
LOWEST, HIGHEST = 8, 248  # shifts as a term holds them, beyond which a rewrite is refused


@njit(cache=True)
def random(state):
    """The next of a row of 64-bit pseudo-random numbers (xorshift64*)."""
    x = state[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    state[0] = x
    return (x * np.uint64(2685821657736338717)) >> np.uint64(33)


@njit(cache=True)
def below(state, n):
    """A pseudo-random integer of 0 to n - 1."""
    return np.int64(random(state) % np.uint64(n))


@njit(cache=True)
def insert(body, length, s, term):
    """Add a term to sum s; equal terms become one of twice the weight, opposite ones vanish. False: no room."""
    while True:
        n = length[s]
        again = False
        for i in range(n):
            if body[s, i] == term:
                body[s, i] = body[s, n - 1]
                length[s] = n - 1
                term += 2
                again = True
                break
            if body[s, i] == (term ^ 1):
                body[s, i] = body[s, n - 1]
                length[s] = n - 1
                return True
        if not again:
            break
    n = length[s]
    if n >= body.shape[1]:
        return False
    body[s, n] = term
    length[s] = n + 1
    return True


@njit(cache=True)
def compress(body, length, s):
    """Write the digits of each operand in sum s canonically where that takes fewer; True if anything changed."""
    changed = False
    i = 0
    while i < length[s]:
        op = body[s, i] >> 9
        low, count = 10000, 0
        first = True
        for j in range(length[s]):
            if body[s, j] >> 9 == op:
                if j < i:
                    first = False
                    break
                count += 1
                low = min(low, (body[s, j] >> 1) & 255)
        i += 1
        if not first or count < 2:
            continue
        value = np.int64(0)
        fits = True
        for j in range(length[s]):
            if body[s, j] >> 9 == op:
                shift = ((body[s, j] >> 1) & 255) - low
                if shift > 60:
                    fits = False
                    break
                value += -(np.int64(1) << shift) if body[s, j] & 1 else np.int64(1) << shift
        if not fits:
            continue
        rest, digits = value, 0
        while rest != 0:
            if rest & 1:
                rest -= 2 - (rest & 3)
                digits += 1
            rest >>= 1
        if digits >= count:
            continue
        changed = True
        n = 0
        for j in range(length[s]):
            if body[s, j] >> 9 != op:
                body[s, n] = body[s, j]
                n += 1
        rest, shift = value, low
        while rest != 0:
            if rest & 1:
                digit = 2 - (rest & 3)
                rest -= digit
                body[s, n] = (op << 9) | (shift << 1) | (1 if digit < 0 else 0)
                n += 1
            rest >>= 1
            shift += 1
        length[s] = n
        i = 0
    return changed


@njit(cache=True)
def inline(body, length, columns, k):
    """Write definition k out in every sum that uses it, and empty it. False if a sum has no room for that."""
    op = columns + k
    for s in range(body.shape[0]):
        i = 0
        touched = False
        while i < length[s]:
            term = body[s, i]
            if term >> 9 != op:
                i += 1
                continue
            body[s, i] = body[s, length[s] - 1]
            length[s] -= 1
            shift, sign = ((term >> 1) & 255) - ZERO, term & 1
            for j in range(length[k]):
                part = body[k, j]
                there = ((part >> 1) & 255) + shift
                if there < LOWEST or there > HIGHEST:
                    return False
                if not insert(body, length, s, (part + 2 * shift) ^ sign):
                    return False
            touched = True
            i = 0
        if touched:
            compress(body, length, s)
    length[k] = 0
    return True


@njit(cache=True)
def pair(p, q):
    """The pattern of two terms whatever their common shift and sign: operands, distance, and whether signs differ."""
    if p > q:
        p, q = q, p
    distance = ((q >> 1) & 255) - ((p >> 1) & 255)
    return (np.int64(p >> 9) << 33) | (np.int64(q >> 9) << 11) | (np.int64(distance + 512) << 1) | ((p ^ q) & 1)


@njit(cache=True)
def count_pairs(body, length, keys, counts, touched):
    """Count every pattern of every sum in an open hash table; gives the number of patterns, their places in touched."""
    mask = keys.shape[0] - 1
    found = 0
    for s in range(body.shape[0]):
        for i in range(length[s]):
            p = body[s, i]
            for j in range(i + 1, length[s]):
                key = pair(p, body[s, j])
                h = np.int64((np.uint64(key) * np.uint64(11400714819323198485)) >> np.uint64(40)) & mask
                while counts[h] != 0 and keys[h] != key:
                    h = (h + 1) & mask
                if counts[h] == 0:
                    keys[h] = key
                    touched[found] = h
                    found += 1
                counts[h] += 1
    return found


@njit(cache=True)
def replace(body, length, columns, key, new, apply):
    """Replace a pattern by the term of slot new wherever it stands; gives how often. Only counts it unless apply."""
    a, b = np.int32(key >> 33), np.int32((key >> 11) & ((1 << 22) - 1))
    distance, differ = np.int32(((key >> 1) & 1023) - 512), np.int32(key & 1)
    total = 0
    gone = np.zeros(body.shape[1], np.bool_)
    for s in range(body.shape[0]):
        n = length[s]
        if n < 2 or s == new:
            continue
        any_gone = False
        for i in range(n):
            p = body[s, i]
            if p >> 9 != a or gone[i]:
                continue
            q = ((b << 9) | (p & 511)) + 2 * distance
            q ^= differ
            for j in range(n):
                if j != i and body[s, j] == q and not gone[j]:
                    gone[i] = gone[j] = True
                    any_gone = True
                    total += 1
                    if apply:
                        body[s, i] = ((columns + new) << 9) | (p & 511)
                        gone[i] = False
                    break
        if any_gone:
            if apply:
                m = 0
                for i in range(n):
                    if not gone[i]:
                        body[s, m] = body[s, i]
                        m += 1
                length[s] = m
            gone[:n] = False
    return total


@njit(cache=True)
def tidy(body, length, columns, rows):
    """Open definitions of one term, those used once, and drop those unused. False if there was no room."""
    uses = np.zeros(body.shape[0], np.int32)
    while True:
        uses[:] = 0
        for s in range(body.shape[0]):
            for i in range(length[s]):
                op = body[s, i] >> 9
                if op >= columns:
                    uses[op - columns] += 1
        changed = False
        for k in range(rows, body.shape[0]):
            if length[k] == 0:
                if uses[k] == 0:
                    continue
                inline(body, length, columns, k)  # it came to nothing: a zero
                changed = True
                break
            if uses[k] == 0:
                length[k] = 0
                changed = True
                break
            if uses[k] == 1 or length[k] == 1:
                if not inline(body, length, columns, k):
                    return False
                changed = True
                break
        if not changed:
            return True


@njit(cache=True)
def cost(length):
    """Adders: the terms of every sum less one."""
    total = 0
    for s in range(length.shape[0]):
        if length[s] > 1:
            total += length[s] - 1
    return total


@njit(cache=True)
def share(body, length, columns, rows, keys, counts, touched, state, noise):
    """Make the most frequent pattern a definition until none occurs twice. Ties are drawn; noise blurs the counts."""
    useless = np.empty(64, np.int64)
    barred = 0
    while True:
        found = count_pairs(body, length, keys, counts, touched)
        best, best_score = np.int64(-1), np.int64(-1)
        ties = 0
        for t in range(found):
            h = touched[t]
            if counts[h] >= 2:
                key = keys[h]
                skip = False
                for u in range(barred):
                    if useless[u] == key:
                        skip = True
                if not skip:
                    score = np.int64(counts[h]) * 16
                    if noise > 0:
                        score += below(state, noise)
                    if score > best_score:
                        best_score, best, ties = score, key, 1
                    elif score == best_score:
                        ties += 1
                        if below(state, ties) == 0:
                            best = key
            counts[h] = 0
        if best < 0:
            return
        if replace(body, length, columns, best, -1, False) < 2:
            if barred == 64:
                return
            useless[barred] = best
            barred += 1
            continue
        new = -1
        for k in range(rows, body.shape[0]):
            if length[k] == 0:
                new = k
                break
        if new < 0:
            return
        replace(body, length, columns, best, new, True)
        a, b = np.int32(best >> 33), np.int32((best >> 11) & ((1 << 22) - 1))
        distance, differ = np.int32(((best >> 1) & 1023) - 512), np.int32(best & 1)
        body[new, 0] = (a << 9) | (ZERO << 1)
        body[new, 1] = (b << 9) | ((ZERO + distance) << 1) | differ
        length[new] = 2


@njit(cache=True)
def transpose(body, length, columns, rows):
    """The transposed network: each edge turned round. Sums in slots: the columns first, then the definitions."""
    fans = np.zeros(columns + body.shape[0], np.int64)
    for s in range(body.shape[0]):
        for i in range(length[s]):
            fans[body[s, i] >> 9] += 1
    new_body = np.zeros((columns + body.shape[0] - rows, fans.max() + 8), np.int32)
    new_length = np.zeros(new_body.shape[0], np.int32)
    for s in range(body.shape[0]):
        for i in range(length[s]):
            op = body[s, i] >> 9
            slot = op if op < columns else op - rows  # columns + definitions, the rows left out
            source = s if s < rows else s + columns
            new_body[slot, new_length[slot]] = (source << 9) | (body[s, i] & 511)
            new_length[slot] += 1
    return new_body, new_length


@njit(cache=True)
def redigit(body, length, state, times):
    """Write a few pairs of digits another way: a - 4a as -a - 2a, and back."""
    for _ in range(times):
        s = below(state, body.shape[0])
        n = length[s]
        if n < 2:
            continue
        i = below(state, n)
        p = body[s, i]
        for j in range(n):
            q = body[s, j]
            if j == i or q >> 9 != p >> 9:
                continue
            apart = ((q >> 1) & 255) - ((p >> 1) & 255)
            if apart == 2 and (p ^ q) & 1:
                body[s, i], body[s, j] = p ^ 1, q - 2
                break
            if apart == 1 and not (p ^ q) & 1:
                body[s, i], body[s, j] = p ^ 1, q + 2
                break


@njit(cache=True)
def search(body, length, columns, rows, rounds, seed, destroy, noise, slack, digits):
    """Large-neighbourhood search: write a few definitions out, share again, keep what is no worse. Gives the trace."""
    state = np.array([seed * np.uint64(2654435769) + np.uint64(88172645463325252)], np.uint64)
    for _ in range(8):
        random(state)
    size = 1 << 16
    keys, counts = np.zeros(size, np.int64), np.zeros(size, np.int32)
    touched = np.zeros(size, np.int64)
    share(body, length, columns, rows, keys, counts, touched, state, noise)
    tidy(body, length, columns, rows)
    current = cost(length)
    best, best_body, best_length = current, body.copy(), length.copy()
    start = current
    kept_body, kept_length = body.copy(), length.copy()
    live = np.zeros(body.shape[0], np.int64)
    for _ in range(rounds):
        n = 0
        for k in range(rows, body.shape[0]):
            if length[k] > 0:
                live[n] = k
                n += 1
        if n == 0:
            break
        ok = True
        for _ in range(1 + below(state, destroy)):
            k = live[below(state, n)]
            if length[k] > 0 and not inline(body, length, columns, k):
                ok = False
                break
        if digits > 0:
            redigit(body, length, state, below(state, digits + 1))
        if ok:
            share(body, length, columns, rows, keys, counts, touched, state, noise)
            ok = tidy(body, length, columns, rows)
        now = cost(length) if ok else 1 << 30
        if now <= current + (slack if below(state, 100) < 2 else 0):
            current = now
            kept_body[:], kept_length[:] = body, length
            if now < best:
                best = now
                best_body[:], best_length[:] = body, length
        else:
            body[:], length[:] = kept_body, kept_length
    body[:], length[:] = best_body, best_length
    return start, best


ROOM = 24  # terms that a sum may hold beyond those of the longest row at the start
SHIFTS = (100, 2)  # rounds in a turn: as many as this; digits rewritten in a round at most


def best_sums(sums: list[list[Term]], columns: int) -> tuple[list[list[Term]], list[list[Term]]]:
    """Share what the sums of the rows have in common: definitions and rows as adders_shape reads them."""
    kept = [(_packed(sums, columns), columns, len(sums))]
    (body, length), columns, rows = kept[0]
    best = (1 << 30, body, length)
    for start in (0, 1):
        (body, length), c, r = kept[0]
        body, length = body.copy(), length.copy()
        turned = 0
        for turn in range(10 + start):
            if turn or not start:
                search(body, length, c, r, 1000, np.uint64(1000 * start + turn + 1), 4, 0, 0, 2)
                now = cost(length) if not turned else best[0]
                if now < best[0]:
                    best = (now, body.copy(), length.copy())
            body, length = _roomy(*transpose(body, length, c, r), r)
            c, r, turned = r, c, 1 - turned
    return _unpacked(best[1], best[2], columns, rows)


def _packed(sums: list[list[Term]], columns: int) -> tuple[np.ndarray, np.ndarray]:
    terms = [[(o << 9) | ((s + ZERO) << 1) | (g < 0) for o, s, g in row] for row in sums]
    total, longest = sum(map(len, terms)), max(map(len, terms), default=0)
    body = np.zeros((len(terms) + total, longest + ROOM), np.int32)
    length = np.zeros(len(body), np.int32)
    for r, row in enumerate(terms):
        body[r, : len(row)], length[r] = row, len(row)
    return body, length


def _roomy(body: np.ndarray, length: np.ndarray, rows: int) -> tuple[np.ndarray, np.ndarray]:
    slots = max(len(body), rows + int(length.sum()))
    wide = np.zeros((slots, max(body.shape[1], 60)), np.int32)
    wide[: len(body), : body.shape[1]] = body
    return wide, np.concatenate([length, np.zeros(slots - len(length), np.int32)])


def _unpacked(
    body: np.ndarray, length: np.ndarray, columns: int, rows: int
) -> tuple[list[list[Term]], list[list[Term]]]:
    """The slots as lists of terms, definitions in an order in which each stands before its users."""
    sums = [
        [(t >> 9, ((t >> 1) & 255) - ZERO, -1 if t & 1 else 1) for t in body[s, : length[s]].tolist()]
        for s in range(len(body))
    ]
    order: dict[int, int] = {}

    def place(k: int) -> None:
        for o, _, _ in sums[k]:
            if o >= columns and o not in order:
                place(o - columns)
        if k >= rows:
            order[columns + k] = columns + len(order)

    for r in range(rows):
        place(r)
    named = [[(order.get(o, o), s, g) for o, s, g in terms] for terms in sums]
    return [named[k - columns] for k in order], named[:rows]
