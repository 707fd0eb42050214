"""Rounds of the search for shared sums: a part is undone, shared again, and kept if it is no worse."""

import numpy as np
from numba import njit

from greygate.compiler.adders.moves import inline, redigit, settle, tidy
from greygate.compiler.adders.table import (
    CHANGED,
    COST,
    COUNT,
    FREE,
    HEAP,
    KEY,
    LENGTH,
    ROUND,
    ROWS,
    TAKEN,
    TOP,
    draw,
    kernel,
    push,
    rebuild,
    undo,
)
from greygate.compiler.adders.values import index, rewrite


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
