"""The search for shared sums: pairs of terms that occur often become definitions; then parts are undone and done again.

Everything is integers and one generator of pseudo-random numbers, so every processor finds the same graph. A *term* is
one integer: operand << 9 | (shift + 128) << 1 | (1 if negative). Operands 0 to columns - 1 are columns, columns + k is
the sum in slot k. Slots 0 to rows - 1 are the rows of the matrix, the others definitions (empty ones are free). A
*pattern* is two terms whatever their common shift and sign. A table counts the patterns of all sums; it is kept up to
date whenever a sum changes, and every pattern whose count rises above 1 goes on a heap.
"""

from collections import namedtuple
from itertools import pairwise

import numpy as np
from numba import njit

from greygate.compiler.adders_shape import Term

kernel = njit(cache=True, error_model="numpy", _nrt=False)  # nothing here allocates: it compiles in half the time
ZERO = 128  # the shift 0 as a term holds it
LOWEST, HIGHEST = 8, 248  # shifts as a term holds them, beyond which a rewrite is refused
FREE = -1  # a key of the table that holds no pattern
ROTATIONS = 61  # values are modulo 2^61 - 1, where a factor of 2 turns the bits
WINDOW = 128  # operands that one rewrite tries
MODULUS = (1 << ROTATIONS) - 1

# terms[0]: the terms of each slot; terms[1]: those of slots that changed in this round, before; terms[2]: marks.
# slot: the fields below of each slot. form: what is known of each operand as a linear form of the columns.
# table: the patterns with their counts. index: where a linear form stands.
State = namedtuple("State", "terms slot form table heap index ints")
LENGTH, LEVEL, EXTRA, USES, STAMP, SAVED, SAVED_LENGTH, SAVED_LEVEL, SAVED_VALUE = range(9)  # of slot
VALUE, LOW, HIGH, SUPPORT, MARK = range(5)  # of form
KEY, COUNT = range(2)  # of table
SCORE = SLOT = 1  # of heap and index, beside KEY
COLUMNS, ROWS, TOP, HEAP, CHANGED, ROUND, TAKEN, BOUNDED, COST, NOISE, MARKS, RANDOM = range(12)  # of ints


@kernel
def draw(st, n):
    """A pseudo-random integer of 0 to n - 1 (xorshift64*)."""
    x = np.uint64(st.ints[RANDOM])
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    st.ints[RANDOM] = np.int64(x)
    return np.int64(((x * np.uint64(2685821657736338717)) >> np.uint64(33)) % np.uint64(n))


@kernel
def pattern(p, q):
    """Two terms whatever their common shift and sign: operands, distance, and whether their signs differ."""
    if p > q:
        p, q = q, p
    distance = ((q >> 1) & 255) - ((p >> 1) & 255)
    return (np.int64(p >> 9) << 33) | (np.int64(q >> 9) << 11) | (np.int64(distance + 512) << 1) | ((p ^ q) & 1)


@kernel
def push(st, score, key):
    """Put a pattern on the heap; a full heap forgets it."""
    i = st.ints[HEAP]
    if i >= st.heap.shape[0]:
        return
    st.ints[HEAP] = i + 1
    while i > 0:
        above = (i - 1) >> 1
        if st.heap[above, SCORE] >= score:
            break
        st.heap[i, SCORE], st.heap[i, KEY] = st.heap[above, SCORE], st.heap[above, KEY]
        i = above
    st.heap[i, SCORE], st.heap[i, KEY] = score, key


@kernel
def pop(st):
    """Take the pattern of the highest score off the heap."""
    score, key = st.heap[0, SCORE], st.heap[0, KEY]
    n = st.ints[HEAP] - 1
    st.ints[HEAP] = n
    last_score, last_key = st.heap[n, SCORE], st.heap[n, KEY]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= n:
            break
        if child + 1 < n and st.heap[child + 1, SCORE] > st.heap[child, SCORE]:
            child += 1
        if st.heap[child, SCORE] <= last_score:
            break
        st.heap[i, SCORE], st.heap[i, KEY] = st.heap[child, SCORE], st.heap[child, KEY]
        i = child
    st.heap[i, SCORE], st.heap[i, KEY] = last_score, last_key
    return score, key


@kernel
def place(st, key):
    """The place of a pattern in the table: where it stands, or where it would."""
    mask = st.table.shape[0] - 1
    h = np.int64((np.uint64(key) * np.uint64(11400714819323198485)) >> np.uint64(34)) & mask
    while st.table[h, KEY] != FREE and st.table[h, KEY] != key:
        h = (h + 1) & mask
    return h


@kernel
def tally(st, s, by, pushing):
    """Add `by` to the count of every pattern of sum s, to the uses of its operands, and its adders to the cost."""
    columns = st.ints[COLUMNS]
    n = st.slot[s, LENGTH]
    if n > 1:
        st.ints[COST] += by * (n - 1)
    for i in range(n):
        p = st.terms[0, s, i]
        op = p >> 9
        if op >= columns:
            st.slot[op - columns, USES] += by
        for j in range(i + 1, n):
            key = pattern(p, st.terms[0, s, j])
            h = place(st, key)
            if st.table[h, KEY] == FREE:
                st.table[h, KEY] = key
                st.table[h, COUNT] = 0
                st.ints[TAKEN] += 1
            st.table[h, COUNT] += by
            if pushing and st.table[h, COUNT] > 1:
                push(
                    st,
                    (np.int64(st.table[h, COUNT]) << 24) + draw(st, 1 << 20) + (draw(st, 1 + st.ints[NOISE]) << 20),
                    key,
                )


@kernel
def rebuild(st):
    """Write the table anew once too many of its places hold patterns that no longer occur."""
    for h in range(st.table.shape[0]):
        st.table[h, KEY] = FREE
    st.ints[TAKEN] = 0
    st.ints[COST] = 0
    for s in range(st.slot.shape[0]):
        st.slot[s, USES] = 0
    for s in range(st.ints[TOP]):
        tally(st, s, 1, False)


@kernel
def lift(st, s):
    """Take sum s out of the counts before it changes, and save it if it was not saved in this round."""
    if st.slot[s, STAMP] != st.ints[ROUND]:
        st.slot[s, STAMP] = st.ints[ROUND]
        m = st.ints[CHANGED]
        st.slot[m, SAVED], st.slot[m, SAVED_LENGTH], st.slot[m, SAVED_LEVEL] = s, st.slot[s, LENGTH], st.slot[s, LEVEL]
        st.slot[m, SAVED_VALUE] = st.form[s + st.ints[COLUMNS], VALUE]
        for i in range(st.slot[s, LENGTH]):
            st.terms[1, m, i] = st.terms[0, s, i]
        st.ints[CHANGED] = m + 1
    tally(st, s, -1, False)


@kernel
def undo(st):
    """Put back every sum as it was at the start of the round."""
    for m in range(st.ints[CHANGED] - 1, -1, -1):
        s = st.slot[m, SAVED]
        tally(st, s, -1, False)
        st.slot[s, LENGTH], st.slot[s, LEVEL] = st.slot[m, SAVED_LENGTH], st.slot[m, SAVED_LEVEL]
        st.form[s + st.ints[COLUMNS], VALUE] = st.slot[m, SAVED_VALUE]
        for i in range(st.slot[s, LENGTH]):
            st.terms[0, s, i] = st.terms[1, m, i]
        tally(st, s, 1, False)


@kernel
def insert(st, s, term):
    """Add a term to sum s; equal terms become one of twice the weight, opposite ones vanish. False: no room."""
    i = 0
    while i < st.slot[s, LENGTH]:
        have = st.terms[0, s, i]
        if have == term or have == term ^ 1:
            st.slot[s, LENGTH] -= 1
            st.terms[0, s, i] = st.terms[0, s, st.slot[s, LENGTH]]
            if have != term:
                return True
            term += 2
            i = 0
        else:
            i += 1
    n = st.slot[s, LENGTH]
    shift = (term >> 1) & 255
    if n >= st.terms.shape[2] or shift < LOWEST or shift > HIGHEST:
        return False
    st.terms[0, s, n] = term
    st.slot[s, LENGTH] = n + 1
    return True


@kernel
def compress(st, s, op):
    """Write the digits of an operand in sum s canonically where that takes fewer."""
    low, high, count = 1000, 0, 0
    for j in range(st.slot[s, LENGTH]):
        if st.terms[0, s, j] >> 9 == op:
            shift = (st.terms[0, s, j] >> 1) & 255
            low, high, count = min(low, shift), max(high, shift), count + 1
    if count < 2 or high - low > 60:
        return
    value = np.int64(0)
    for j in range(st.slot[s, LENGTH]):
        if st.terms[0, s, j] >> 9 == op:
            weight = np.int64(1) << (((st.terms[0, s, j] >> 1) & 255) - low)
            value += -weight if st.terms[0, s, j] & 1 else weight
    rest, digits = value, 0
    while rest != 0:
        if rest & 1:
            rest -= 2 - (rest & 3)
            digits += 1
        rest >>= 1
    if digits >= count:
        return
    n = 0
    for j in range(st.slot[s, LENGTH]):
        if st.terms[0, s, j] >> 9 != op:
            st.terms[0, s, n] = st.terms[0, s, j]
            n += 1
    rest, shift = value, low
    while rest != 0:
        if rest & 1:
            digit = 2 - (rest & 3)
            rest -= digit
            st.terms[0, s, n] = (op << 9) | (shift << 1) | (1 if digit < 0 else 0)
            n += 1
        rest >>= 1
        shift += 1
    st.slot[s, LENGTH] = n


@kernel
def inline(st, k):
    """Write definition k out in every sum that uses it, and empty it. False if a sum has no room for that."""
    op = st.ints[COLUMNS] + k
    left = st.slot[k, USES]
    fits = True
    for s in range(st.ints[TOP]):
        if left == 0:
            break
        used = 0
        for i in range(st.slot[s, LENGTH]):
            if st.terms[0, s, i] >> 9 == op:
                used += 1
        if used == 0 or s == k:
            continue
        left -= used
        lift(st, s)
        for _ in range(used):
            i = 0
            while st.terms[0, s, i] >> 9 != op:
                i += 1
            term = st.terms[0, s, i]
            st.slot[s, LENGTH] -= 1
            st.terms[0, s, i] = st.terms[0, s, st.slot[s, LENGTH]]
            for j in range(st.slot[k, LENGTH]):
                fits &= insert(st, s, (st.terms[0, k, j] + 2 * (((term >> 1) & 255) - ZERO)) ^ (term & 1))
        for j in range(st.slot[k, LENGTH]):
            compress(st, s, st.terms[0, k, j] >> 9)
        tally(st, s, 1, True)
    lift(st, k)
    st.slot[k, LENGTH] = 0
    return fits


@kernel
def weight(st, s):
    """Sum of 2^level over the terms of a sum: a tree of d levels has room for 2^d of them."""
    columns = st.ints[COLUMNS]
    total = np.int64(st.slot[s, EXTRA])
    for i in range(st.slot[s, LENGTH]):
        op = st.terms[0, s, i] >> 9
        total += np.int64(1) << (st.slot[op - columns, LEVEL] if op >= columns else 0)
    return total


@kernel
def replace(st, key, new, level, apply):
    """Replace a pattern by the term of slot new wherever it stands and the level allows; gives how often.

    It only counts unless `apply`.
    """
    columns = st.ints[COLUMNS]
    a, b = np.int32(key >> 33), np.int32((key >> 11) & ((1 << 22) - 1))
    distance, differ = np.int32(((key >> 1) & 1023) - 512), np.int32(key & 1)
    more = np.int64(0)
    if st.ints[BOUNDED]:
        more = np.int64(1) << level
        for op in (a, b):
            more -= np.int64(1) << (st.slot[op - columns, LEVEL] if op >= columns else 0)
    total = 0
    for s in range(st.ints[TOP]):
        n = st.slot[s, LENGTH]
        if n < 2 or s == new:
            continue
        room = np.int64(1) << 60
        hits = 0
        for i in range(n):
            p = st.terms[0, s, i]
            if p >> 9 != a or st.terms[2, 0, i]:
                continue
            q = (((b << 9) | (p & 511)) + 2 * distance) ^ differ
            for j in range(n):
                if st.terms[0, s, j] == q and j != i and not st.terms[2, 0, j]:
                    if st.ints[BOUNDED] and hits == 0:
                        room = (np.int64(1) << st.slot[s, LEVEL]) - weight(st, s)
                    if room < more:
                        break
                    room -= more
                    if apply and hits == 0:
                        lift(st, s)
                    hits += 1
                    st.terms[2, 0, i] = st.terms[2, 0, j] = 1
                    if apply:
                        st.terms[0, s, i] = ((columns + new) << 9) | (p & 511)
                        st.terms[2, 0, i] = 0
                    break
        if hits > 0:
            total += hits
            m = 0
            for i in range(n):
                if apply and not st.terms[2, 0, i]:
                    st.terms[0, s, m] = st.terms[0, s, i]
                    m += 1
                st.terms[2, 0, i] = 0
            if apply:
                st.slot[s, LENGTH] = m
                tally(st, s, 1, True)
    return total


@kernel
def free_slot(st):
    """An empty slot for a definition; -1 if there is none."""
    new = st.ints[ROWS]
    while new < st.slot.shape[0] and st.slot[new, LENGTH] > 0:
        new += 1
    if new == st.slot.shape[0]:
        return -1
    st.ints[TOP] = max(st.ints[TOP], new + 1)
    return new


@kernel
def share(st):
    """Make the pattern of the highest count a definition until none occurs twice."""
    columns = st.ints[COLUMNS]
    while st.ints[HEAP] > 0:
        score, key = pop(st)
        h = place(st, key)
        if st.table[h, KEY] != key or st.table[h, COUNT] < 2:
            continue
        if st.table[h, COUNT] < score >> 24 and st.ints[NOISE] == 0:
            push(st, (np.int64(st.table[h, COUNT]) << 24) | (score & 0xFFFFFF), key)  # its count fell
            continue
        a, b = np.int32(key >> 33), np.int32((key >> 11) & ((1 << 22) - 1))
        level = 0
        if st.ints[BOUNDED]:
            for op in (a, b):
                level = max(level, 1 + (st.slot[op - columns, LEVEL] if op >= columns else 0))
        if replace(st, key, -1, level, False) < 2:
            continue
        new = free_slot(st)
        if new < 0:
            st.ints[HEAP] = 0
            return
        lift(st, new)
        replace(st, key, new, level, True)
        distance, differ = np.int32(((key >> 1) & 1023) - 512), np.int32(key & 1)
        st.terms[0, new, 0] = (a << 9) | (ZERO << 1)
        st.terms[0, new, 1] = (b << 9) | ((ZERO + distance) << 1) | differ
        st.slot[new, LENGTH], st.slot[new, LEVEL], st.form[columns + new, VALUE] = 2, level, 0
        tally(st, new, 1, True)
        if st.ints[TAKEN] * 4 > st.table.shape[0] * 3:
            rebuild(st)


@kernel
def tidy(st):
    """Open definitions of one term and those used once, and drop those unused. False if there was no room."""
    fits = True
    changed = True
    while changed:
        changed = False
        for k in range(st.ints[ROWS], st.ints[TOP]):
            if st.slot[k, LENGTH] > 0 and st.slot[k, USES] == 0:
                lift(st, k)
                st.slot[k, LENGTH] = 0
                changed = True
            elif (st.slot[k, USES] > 0 and st.slot[k, LENGTH] < 2) or (
                st.slot[k, USES] == 1 and st.slot[k, LENGTH] > 0
            ):
                fits &= inline(st, k)
                changed = True
    return fits


@kernel
def settle(st):
    """Share and tidy until nothing is left to do. False if there was no room."""
    fits = True
    while st.ints[HEAP] > 0:
        share(st)
        fits &= tidy(st)
    return fits


@kernel
def redigit(st, times):
    """Write a few pairs of digits another way: a - 4a as -a - 2a, and back."""
    for _ in range(times):
        s = draw(st, st.ints[TOP])
        n = st.slot[s, LENGTH]
        if n < 2:
            continue
        i = draw(st, n)
        p = st.terms[0, s, i]
        for j in range(n):
            q = st.terms[0, s, j]
            if j == i or q >> 9 != p >> 9:
                continue
            apart = ((q >> 1) & 255) - ((p >> 1) & 255)
            opposite = (p ^ q) & 1
            if (apart == 2 and opposite) or (apart == 1 and not opposite):
                lift(st, s)
                st.slot[s, LENGTH] -= 1
                st.terms[0, s, j] = st.terms[0, s, st.slot[s, LENGTH]]
                for k in range(st.slot[s, LENGTH]):
                    if st.terms[0, s, k] == p:
                        st.slot[s, LENGTH] -= 1
                        st.terms[0, s, k] = st.terms[0, s, st.slot[s, LENGTH]]
                        break
                insert(st, s, p ^ 1)
                insert(st, s, q - 2 if opposite else q + 2)
                tally(st, s, 1, True)
                break


@kernel
def turned(value, shift):
    """A value times 2^shift, modulo 2^61 - 1: a rotation of its bits."""
    k = shift % ROTATIONS
    return ((value << k) & MODULUS) | (value >> (ROTATIONS - k)) if k else value


@kernel
def plus(a, b):
    """The sum of two values modulo 2^61 - 1."""
    total = a + b
    return total - MODULUS if total >= MODULUS else total


@kernel
def worth(st, term):
    """The value of a term: a linear form of the columns as one number modulo 2^61 - 1."""
    value = turned(st.form[term >> 9, VALUE], ((term >> 1) & 255) - ZERO)
    return MODULUS - value if term & 1 else value


@kernel
def evaluate(st, s):
    """Give operand columns + s its value and its extent; its own operands first."""
    columns = st.ints[COLUMNS]
    value, low, high, support = np.int64(0), 1000, -1000, np.int64(0)
    for i in range(st.slot[s, LENGTH]):
        term = st.terms[0, s, i]
        op = term >> 9
        if op >= columns and st.form[op, MARK] != st.ints[MARKS]:
            evaluate(st, op - columns)
        shift = ((term >> 1) & 255) - ZERO
        value = plus(value, worth(st, term))
        low, high = min(low, st.form[op, LOW] + shift), max(high, st.form[op, HIGH] + shift)
        support |= st.form[op, SUPPORT]
    op = columns + s
    st.form[op, VALUE], st.form[op, LOW], st.form[op, HIGH], st.form[op, SUPPORT] = value, low, high + 1, support
    st.form[op, MARK] = st.ints[MARKS]


@kernel
def index_place(st, key):
    """The place of a value in the index: where it stands, or where it would."""
    mask = st.index.shape[0] - 1
    h = np.int64((np.uint64(key) * np.uint64(11400714819323198485)) >> np.uint64(34)) & mask
    while st.index[h, KEY] != 0 and st.index[h, KEY] != key:
        h = (h + 1) & mask
    return h


@kernel
def index(st):
    """Value every definition, and note it with all its shifts and signs in the index."""
    columns, rows = st.ints[COLUMNS], st.ints[ROWS]
    st.ints[MARKS] += 1
    for c in range(columns):
        st.form[c, VALUE] = 0
        while st.form[c, VALUE] == 0:
            st.form[c, VALUE] = (draw(st, 1 << 30) << 31) | draw(st, 1 << 30)
        st.form[c, LOW], st.form[c, HIGH], st.form[c, SUPPORT] = 0, 0, np.int64(1) << (c % 62)
    for h in range(st.index.shape[0]):
        st.index[h, KEY] = 0
    for k in range(-columns, st.ints[TOP]):
        if k >= 0 and st.slot[k, LENGTH] < (2 if k < rows else 1):
            continue
        op = columns + k
        if k >= 0 and st.form[op, MARK] != st.ints[MARKS]:
            evaluate(st, k)
        for shift in range(ROTATIONS):
            value = turned(st.form[op, VALUE], shift)
            key = min(value, MODULUS - value)
            h = index_place(st, key)
            st.index[h, KEY] = key
            st.index[h, SLOT] = (op << 6) | shift


@kernel
def looked_up(st, value):
    """The term of a column or definition that has a value; -1 if there is none."""
    if value == 0:
        return np.int32(-1)
    key = min(value, MODULUS - value)
    h = index_place(st, key)
    if st.index[h, KEY] != key:
        return np.int32(-1)
    op, shift = st.index[h, SLOT] >> 6, st.index[h, SLOT] & 63
    columns = st.ints[COLUMNS]
    if op >= columns and (st.slot[op - columns, LENGTH] < 2 or st.form[op, VALUE] == 0):
        return np.int32(-1)
    found = turned(st.form[op, VALUE], shift)
    if min(found, MODULUS - found) != key:
        return np.int32(-1)
    there = ZERO + (shift if shift <= 30 else shift - ROTATIONS)
    return np.int32((op << 9) | (there << 1) | (0 if found == value else 1))


@kernel
def depends(st, op, s):
    """Whether operand op is sum s or reads it, directly or not."""
    k = op - st.ints[COLUMNS]
    if k < 0:
        return False
    if k == s:
        return True
    if st.form[op, MARK] == st.ints[MARKS]:
        return False
    st.form[op, MARK] = st.ints[MARKS]
    for i in range(st.slot[k, LENGTH]):  # noqa: SIM110
        if depends(st, st.terms[0, k, i] >> 9, s):
            return True
    return False


@kernel
def independent(st, op, s):
    """Whether sum s may read operand op without a circle."""
    if s < st.ints[ROWS]:
        return op != st.ints[COLUMNS] + s
    st.ints[MARKS] += 1
    return not depends(st, op, s)


@kernel
def promoted(st, term):
    """The term; if it reads a row, of a definition that takes the row's terms and that the row reads. -1: no room."""
    columns = st.ints[COLUMNS]
    r = (term >> 9) - columns
    if r < 0 or r >= st.ints[ROWS]:
        return term
    if st.slot[r, LENGTH] < 2:  # it was promoted a moment ago
        plain = st.slot[r, LENGTH] == 1 and st.terms[0, r, 0] & 511 == ZERO << 1
        return (st.terms[0, r, 0] - (ZERO << 1)) | (term & 511) if plain else np.int32(-1)
    new = free_slot(st)
    if new < 0:
        return np.int32(-1)
    lift(st, r)
    lift(st, new)
    extra = st.slot[r, EXTRA]
    level = 0
    while np.int64(1) << level < weight(st, r) - extra:
        level += 1
    st.slot[new, LENGTH], st.slot[new, LEVEL] = st.slot[r, LENGTH], level
    st.form[columns + new, VALUE] = 0
    for i in range(st.slot[r, LENGTH]):
        st.terms[0, new, i] = st.terms[0, r, i]
    st.terms[0, r, 0] = ((columns + new) << 9) | (ZERO << 1)
    st.slot[r, LENGTH] = 1
    tally(st, r, 1, False)
    tally(st, new, 1, False)
    if st.ints[BOUNDED] and weight(st, r) > np.int64(1) << st.slot[r, LEVEL]:
        return np.int32(-1)
    return ((columns + new) << 9) | (term & 511)


@kernel
def rewrite(st):
    """Put one or two terms for two or three of a sum, if values allow it. False if that did not fit."""
    columns = st.ints[COLUMNS]
    s = draw(st, st.ints[TOP])
    n = st.slot[s, LENGTH]
    if n < 2:
        return True
    take = min(n, 2 + draw(st, 2))
    lift(st, s)
    for i in range(take):  # the terms that are replaced come first
        j = i + draw(st, n - i)
        if i > 0:
            for _ in range(2):  # those of few columns together rather than others
                other = i + draw(st, n - i)
                have = st.form[st.terms[0, s, 0] >> 9, SUPPORT]
                if popcount(have | st.form[st.terms[0, s, other] >> 9, SUPPORT]) < popcount(
                    have | st.form[st.terms[0, s, j] >> 9, SUPPORT]
                ):
                    j = other
        st.terms[0, s, i], st.terms[0, s, j] = st.terms[0, s, j], st.terms[0, s, i]
    target, low, high = np.int64(0), 1000, -1000
    known = True
    for i in range(take):
        term = st.terms[0, s, i]
        op = term >> 9
        known &= st.form[op, VALUE] != 0
        target = plus(target, worth(st, term))
        shift = ((term >> 1) & 255) - ZERO
        low, high = min(low, st.form[op, LOW] + shift), max(high, st.form[op, HIGH] + shift)
    if not known or target == 0:
        tally(st, s, 1, True)
        return True
    first, second = looked_up(st, target), np.int32(-1)
    if first >= 0 and not independent(st, first >> 9, s):
        first = np.int32(-1)
    if first < 0:
        hits = 0
        operands = columns + st.ints[TOP]
        skip = draw(st, operands)
        for step in range(min(operands, WINDOW)):
            op = (skip + step) % operands
            k = op - columns
            if k == s or (k >= 0 and st.slot[k, LENGTH] < 2) or st.form[op, VALUE] == 0:
                continue
            for shift in range(max(-30, low - st.form[op, LOW] - 3), min(30, high + 2 - st.form[op, HIGH]) + 1):
                value = turned(st.form[op, VALUE], shift)
                for sign in range(2):
                    rest = looked_up(st, plus(target, value if sign else MODULUS - value))
                    if rest < 0:
                        continue
                    mine = np.int32((op << 9) | ((ZERO + shift) << 1) | sign)
                    if take == 2 and (mine == st.terms[0, s, 0] or mine == st.terms[0, s, 1]):
                        continue
                    if not independent(st, op, s) or not independent(st, rest >> 9, s):
                        continue
                    hits += 1
                    if draw(st, hits) == 0:
                        first, second = mine, rest
    fits = True
    if first >= 0:
        one = promoted(st, first)  # before the sum loses its terms: an empty slot would look free
        two = promoted(st, second) if second >= 0 else one
        fits = one >= 0 and two >= 0
        for i in range(take):
            st.slot[s, LENGTH] -= 1
            st.terms[0, s, take - 1 - i] = st.terms[0, s, st.slot[s, LENGTH]]
        fits = fits and insert(st, s, one)
        if second >= 0:
            fits = fits and insert(st, s, two)
    tally(st, s, 1, True)
    if st.ints[BOUNDED] and weight(st, s) > np.int64(1) << st.slot[s, LEVEL]:
        fits = False
    return fits


@kernel
def popcount(x):
    n = 0
    while x:
        x &= x - 1
        n += 1
    return n


@kernel
def begin(st):
    """Count every pattern, put the frequent ones on the heap, and share."""
    rebuild(st)
    for h in range(st.table.shape[0]):
        if st.table[h, KEY] != FREE and st.table[h, COUNT] > 1:
            push(st, (np.int64(st.table[h, COUNT]) << 24) + draw(st, 1 << 20), st.table[h, KEY])
    st.ints[ROUND] += 1
    st.ints[CHANGED] = 0
    fits = tidy(st)
    return settle(st) and fits


@kernel
def search(st, rounds, destroy, digits, rewrites):
    """Large-neighbourhood search: write a few definitions out, share again, keep what is no worse. Gives the cost."""
    rows = st.ints[ROWS]
    for round_ in range(rounds):
        if st.ints[COST] == 0:
            break
        st.ints[ROUND] += 1
        st.ints[CHANGED] = 0
        st.ints[HEAP] = 0
        before = st.ints[COST]
        fits = True
        if rewrites > 0 and round_ % 64 == 0:
            index(st)
        some = draw(st, 100) < rewrites
        if some:
            fits &= rewrite(st)
        for _ in range(draw(st, destroy) if some else 1 + draw(st, destroy)):
            k = rows + draw(st, max(1, st.ints[TOP] - rows))
            if k < st.ints[TOP] and st.slot[k, LENGTH] > 0:
                fits &= inline(st, k)
        if digits > 0:
            redigit(st, draw(st, digits + 1))
        fits &= settle(st)
        if not fits or st.ints[COST] > before:
            undo(st)
        if st.ints[TAKEN] * 2 > st.table.shape[0]:
            rebuild(st)
    return st.ints[COST]


@njit(cache=True)
def transpose(body, length, columns, rows):
    """The transposed network: each edge turned round. Sums in slots: the columns first, then the definitions."""
    fans = np.zeros(columns + body.shape[0], np.int64)
    for s in range(body.shape[0]):
        for i in range(length[s]):
            fans[body[s, i] >> 9] += 1
    new_body = np.zeros((columns + body.shape[0] - rows, fans.max()), np.int32)
    new_length = np.zeros(new_body.shape[0], np.int32)
    for s in range(body.shape[0]):
        source = s if s < rows else s + columns
        for i in range(length[s]):
            op = body[s, i] >> 9
            slot = op if op < columns else op - rows  # columns + definitions, the rows left out
            new_body[slot, new_length[slot]] = (source << 9) | (body[s, i] & 511)
            new_length[slot] += 1
    return new_body, new_length


ROOM = 24  # terms that a sum may hold beyond those of the longest at the start
DESTROYED, DIGITS, REWRITES = 4, 2, 50  # a round: definitions and digits at most, and rewrites in how many of 100
ROUNDS, PER_TERM = 1000, 5  # rounds of one turn at effort 1: so many, and for a small matrix so many a term
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
    rounds = int(effort * min(ROUNDS, PER_TERM * int(length.sum())))
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
