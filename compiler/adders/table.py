"""Sums of terms in flat arrays, and a table that counts the patterns that they have in common.

Everything is integers and one generator of pseudo-random numbers, so every processor finds the same graph. A *term* is
one integer: operand << 9 | (shift + 128) << 1 | (1 if negative). Operands 0 to columns - 1 are columns, columns + k is
the sum in slot k. Slots 0 to rows - 1 are the rows of the matrix, the others definitions (empty ones are free). A
*pattern* is two terms whatever their common shift and sign. A table counts the patterns of all sums; it is kept up to
date whenever a sum changes, and every pattern whose count rises above 1 goes on a heap.
"""

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
