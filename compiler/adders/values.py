"""Sums by their value: one or two terms for two or three others, found by looking values up.

The value of an operand is its linear form at random columns, modulo 2^61 - 1, where a shift turns the bits. Equal forms
have equal values; unequal ones differ but once in 10^18 looks, or by a factor of 2^61, which numbers of a floating
point tell apart. The solver compares the sums with the matrix all the same.
"""

import math

import numpy as np

from greygate.compiler.adders.moves import free_slot, insert, weight
from greygate.compiler.adders.table import (
    BOUNDED,
    COLUMNS,
    EXTRA,
    HIGH,
    KEY,
    LENGTH,
    LEVEL,
    LOW,
    MARK,
    MARKS,
    MODULUS,
    ROTATIONS,
    ROWS,
    SLOT,
    SUPPORT,
    TOP,
    VALUE,
    ZERO,
    draw,
    kernel,
    lift,
    tally,
)

WINDOW = 128  # operands that one rewrite tries


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
        st.real[c] = 1 + st.form[c, VALUE] / MODULUS
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
