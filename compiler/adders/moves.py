"""Sums of terms in flat arrays, and a table that counts the patterns that they have in common.

Everything is integers and one generator of pseudo-random numbers, so every processor finds the same graph. A *term* is
one integer: operand << 9 | (shift + 128) << 1 | (1 if negative). Operands 0 to columns - 1 are columns, columns + k is
the sum in slot k. Slots 0 to rows - 1 are the rows of the matrix, the others definitions (empty ones are free). A
*pattern* is two terms whatever their common shift and sign. A table counts the patterns of all sums; it is kept up to
date whenever a sum changes, and every pattern whose count rises above 1 goes on a heap.

A search writes a definition out, shares a pattern, writes digits another way, or looks a value up: the value of an
operand is its linear form at random columns, modulo 2^61 - 1, where a shift turns the bits. Equal forms have equal
values; unequal ones differ but once in 10^18 looks, or by a factor of 2^61, which numbers of a floating point tell
apart. The solver compares the sums with the matrix all the same.
"""

import math
from collections import namedtuple

import numpy as np
from numba import njit

kernel = njit(cache=True, error_model="numpy")
ZERO = 128  # the shift 0 as a term holds it
LOWEST, HIGHEST = 8, 248  # shifts as a term holds them, beyond which a rewrite is refused
FREE = -1  # a key of a table that holds nothing
ROTATIONS = 61  # values are modulo 2^61 - 1, where a factor of 2 turns the bits
MODULUS = (1 << ROTATIONS) - 1

# terms[0]: the terms of each slot; terms[1]: those of slots that changed in this round, before; terms[2]: marks.
# slot: the fields below of each slot. form: what is known of each operand as a linear form of the columns; real: what
# it is at columns of ordinary numbers.
# table: the patterns with their counts. index: where a linear form stands.
State = namedtuple("State", "terms slot form real table heap index ints")
LENGTH, USES, STAMP, SAVED, SAVED_LENGTH, SAVED_VALUE = range(6)  # of slot
VALUE, LOW, HIGH, SUPPORT, MARK = range(5)  # of form
KEY, COUNT = range(2)  # of table
SCORE = SLOT = 1  # of heap and index, beside KEY
COLUMNS, ROWS, TOP, HEAP, CHANGED, ROUND, TAKEN, COST, MARKS, RANDOM = range(10)  # of ints


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
def seat(table, key):
    """The place of a key in an open table: where it stands, or where it would."""
    mask = table.shape[0] - 1
    h = np.int64((np.uint64(key) * np.uint64(11400714819323198485)) >> np.uint64(34)) & mask
    while table[h, KEY] != FREE and table[h, KEY] != key:
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
            h = seat(st.table, key)
            if st.table[h, KEY] == FREE:
                st.table[h, KEY] = key
                st.table[h, COUNT] = 0
                st.ints[TAKEN] += 1
            st.table[h, COUNT] += by
            if pushing and st.table[h, COUNT] > 1:
                push(st, (np.int64(st.table[h, COUNT]) << 24) + draw(st, 1 << 20), key)
                draw(st, 1)  # so that the sequence of numbers, and with it every graph, stays as it was


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
        st.slot[m, SAVED], st.slot[m, SAVED_LENGTH] = s, st.slot[s, LENGTH]
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
        st.slot[s, LENGTH] = st.slot[m, SAVED_LENGTH]
        st.form[s + st.ints[COLUMNS], VALUE] = st.slot[m, SAVED_VALUE]
        for i in range(st.slot[s, LENGTH]):
            st.terms[0, s, i] = st.terms[1, m, i]
        tally(st, s, 1, False)


WINDOW = 128  # operands that one rewrite tries
DESTROYED, DIGITS = 4, 2  # a round: definitions and digits at most


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
def replace(st, key, new, apply):
    """Replace a pattern by the term of slot new wherever it stands; gives how often.

    It only counts unless `apply`.
    """
    columns = st.ints[COLUMNS]
    a, b = np.int32(key >> 33), np.int32((key >> 11) & ((1 << 22) - 1))
    distance, differ = np.int32(((key >> 1) & 1023) - 512), np.int32(key & 1)
    total = 0
    for s in range(st.ints[TOP]):
        n = st.slot[s, LENGTH]
        if n < 2 or s == new:
            continue
        hits = 0
        for i in range(n):
            p = st.terms[0, s, i]
            if p >> 9 != a or st.terms[2, 0, i]:
                continue
            q = (((b << 9) | (p & 511)) + 2 * distance) ^ differ
            for j in range(n):
                if st.terms[0, s, j] == q and j != i and not st.terms[2, 0, j]:
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
        h = seat(st.table, key)
        if st.table[h, KEY] != key or st.table[h, COUNT] < 2:
            continue
        if st.table[h, COUNT] < score >> 24:
            push(st, (np.int64(st.table[h, COUNT]) << 24) | (score & 0xFFFFFF), key)  # its count fell
            continue
        a, b = np.int32(key >> 33), np.int32((key >> 11) & ((1 << 22) - 1))
        if replace(st, key, -1, False) < 2:
            continue
        new = free_slot(st)
        if new < 0:
            st.ints[HEAP] = 0
            return
        lift(st, new)
        replace(st, key, new, True)
        distance, differ = np.int32(((key >> 1) & 1023) - 512), np.int32(key & 1)
        st.terms[0, new, 0] = (a << 9) | (ZERO << 1)
        st.terms[0, new, 1] = (b << 9) | ((ZERO + distance) << 1) | differ
        st.slot[new, LENGTH], st.form[columns + new, VALUE] = 2, 0
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
    value, about, low, high, support = np.int64(0), 0.0, 1000, -1000, np.int64(0)
    for i in range(st.slot[s, LENGTH]):
        term = st.terms[0, s, i]
        op = term >> 9
        if op >= columns and st.form[op, MARK] != st.ints[MARKS]:
            evaluate(st, op - columns)
        shift = ((term >> 1) & 255) - ZERO
        value = plus(value, worth(st, term))
        about += size(st, term)
        low, high = min(low, st.form[op, LOW] + shift), max(high, st.form[op, HIGH] + shift)
        support |= st.form[op, SUPPORT]
    op = columns + s
    st.form[op, VALUE], st.form[op, LOW], st.form[op, HIGH], st.form[op, SUPPORT] = value, low, high + 1, support
    st.form[op, MARK], st.real[op] = st.ints[MARKS], about


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
        st.real[c] = 1 + st.form[c, VALUE] / MODULUS
    for h in range(st.index.shape[0]):
        st.index[h, KEY] = FREE
    for k in range(-columns, st.ints[TOP]):
        if k >= 0 and st.slot[k, LENGTH] < (2 if k < rows else 1):
            continue
        op = columns + k
        if k >= 0 and st.form[op, MARK] != st.ints[MARKS]:
            evaluate(st, k)
        for shift in range(ROTATIONS):
            value = turned(st.form[op, VALUE], shift)
            key = min(value, MODULUS - value)
            h = seat(st.index, key)
            st.index[h, KEY] = key
            st.index[h, SLOT] = (op << 6) | shift


@kernel
def looked_up(st, value):
    """The term of a column or definition that has a value; -1 if there is none."""
    if value == 0:
        return np.int32(-1)
    key = min(value, MODULUS - value)
    h = seat(st.index, key)
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
def size(st, term):
    """The linear form of a term at columns of ordinary numbers, about."""
    found = math.ldexp(st.real[term >> 9], ((term >> 1) & 255) - ZERO)
    return -found if term & 1 else found


@kernel
def agrees(st, term, wanted):
    """Whether a term is about `wanted`: a look knows its shift only up to 61, a factor that this tells apart."""
    return abs(size(st, term) - wanted) <= 0.5 * abs(wanted)


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
    st.slot[new, LENGTH], st.form[columns + new, VALUE] = st.slot[r, LENGTH], 0
    for i in range(st.slot[r, LENGTH]):
        st.terms[0, new, i] = st.terms[0, r, i]
    st.terms[0, r, 0] = ((columns + new) << 9) | (ZERO << 1)
    st.slot[r, LENGTH] = 1
    tally(st, r, 1, False)
    tally(st, new, 1, False)
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
    target, about, low, high = np.int64(0), 0.0, 1000, -1000
    known = True
    for i in range(take):
        term = st.terms[0, s, i]
        op = term >> 9
        known &= st.form[op, VALUE] != 0
        target = plus(target, worth(st, term))
        about += size(st, term)
        shift = ((term >> 1) & 255) - ZERO
        low, high = min(low, st.form[op, LOW] + shift), max(high, st.form[op, HIGH] + shift)
    if not known or target == 0:
        tally(st, s, 1, True)
        return True
    first, second = looked_up(st, target), np.int32(-1)
    if first >= 0 and not (agrees(st, first, about) and independent(st, first >> 9, s)):
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
                    if not agrees(st, rest, about - size(st, mine)):
                        continue
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
def search(st, rounds, rewrites):
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
        for _ in range(draw(st, DESTROYED) if some else 1 + draw(st, DESTROYED)):
            k = rows + draw(st, max(1, st.ints[TOP] - rows))
            if k < st.ints[TOP] and st.slot[k, LENGTH] > 0:
                fits &= inline(st, k)
        redigit(st, draw(st, DIGITS + 1))
        fits &= settle(st)
        if not fits or st.ints[COST] > before:
            undo(st)
        if st.ints[TAKEN] * 2 > st.table.shape[0]:
            rebuild(st)
    return st.ints[COST]
