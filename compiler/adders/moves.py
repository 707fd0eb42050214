"""What a search does to sums: write a definition out, share a pattern, write digits another way."""

import numpy as np

from greygate.compiler.adders.table import (
    BOUNDED,
    COLUMNS,
    COUNT,
    EXTRA,
    HEAP,
    HIGHEST,
    KEY,
    LENGTH,
    LEVEL,
    LOWEST,
    NOISE,
    ROWS,
    TAKEN,
    TOP,
    USES,
    VALUE,
    ZERO,
    draw,
    kernel,
    lift,
    place,
    pop,
    push,
    rebuild,
    tally,
)


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
