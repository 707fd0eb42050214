"""Sharing of pairs in sums of many terms: as `moves.share` chooses, but each step looks only at what it changes.

Terms stand in *groups*: those of one operand in one sum, made at once, which only lose terms. A pattern's count only
falls once its newer operand stands, so that only patterns which occur at least twice are kept, each in one bucket: the
list of those whose count was so high when it was looked at last. Keys of patterns and terms are as in moves.py.
"""

from collections import namedtuple

import numpy as np

from greygate.compiler.adders.moves import COUNT, FREE, KEY, kernel, pattern, seat

# Groups, sums and operands as ranges in flat arrays; `terms` holds shift and sign of each term, -1 where it is gone.
Groups = namedtuple("Groups", "terms operand sum start length of_sum sum_start sum_length of_operand first count ints")
Counts = namedtuple("Counts", "table link bucket ints")
GROUPS, LISTED, TERMS = range(3)  # of Groups.ints: how much of the arrays is used
TAKEN, TOP = range(2)  # of Counts.ints: places of the table that are taken; no bucket above holds a pattern
NONE = -1
SMALLEST = 1 << 8  # places of a table of patterns


@kernel
def bucketed(counts, h):
    """Put a pattern into the bucket of its count."""
    c = counts.table[h, COUNT]
    counts.link[h] = counts.bucket[c]
    counts.bucket[c] = h
    counts.ints[TOP] = max(counts.ints[TOP], c)


@kernel
def table_of(places, highest):
    """An empty table of patterns."""
    table = np.full((places, 2), FREE, np.int64)
    return Counts(table, np.zeros(places, np.int64), np.full(highest + 1, NONE, np.int64), np.zeros(2, np.int64))


@kernel
def copied(counts, places, least):
    """A table of so many places with the patterns that occur at least so often, each in the bucket of its count."""
    new = table_of(places, counts.bucket.shape[0] - 1)
    for h in range(counts.table.shape[0]):
        if counts.table[h, KEY] != FREE and counts.table[h, COUNT] >= least:
            k = seat(new.table, counts.table[h, KEY])
            new.table[k, KEY], new.table[k, COUNT] = counts.table[h, KEY], counts.table[h, COUNT]
            bucketed(new, k)
            new.ints[TAKEN] += 1
    return new


@kernel
def frequent(counts, room):
    """A table with room for `room` more of those patterns that still occur twice."""
    kept = 0
    for h in range(counts.table.shape[0]):
        kept += counts.table[h, KEY] != FREE and counts.table[h, COUNT] > 1
    places = SMALLEST
    while places < 3 * (kept + room):
        places *= 2
    return copied(counts, places, 2)


@kernel
def counted(groups, sums, terms):
    """The patterns of all sums that occur at least twice."""
    counts = table_of(SMALLEST, terms)
    inside = np.zeros(terms, np.int32)
    for s in range(sums):
        n = 0
        for i in range(groups.sum_start[s], groups.sum_start[s] + groups.sum_length[s]):
            g = groups.of_sum[i]
            for j in range(groups.start[g], groups.start[g] + groups.length[g]):
                inside[n] = (groups.operand[g] << 9) | groups.terms[j]
                n += 1
        for i in range(n):
            for j in range(i):
                key = pattern(inside[j], inside[i])
                h = seat(counts.table, key)
                if counts.table[h, KEY] == FREE:
                    counts.table[h, KEY], counts.table[h, COUNT] = key, 0
                    counts.ints[TAKEN] += 1
                counts.table[h, COUNT] += 1
            if 2 * (counts.ints[TAKEN] + n) > counts.table.shape[0]:
                counts = copied(counts, 2 * counts.table.shape[0], 1)
    return frequent(counts, terms)


@kernel
def forget(groups, counts, g, term):
    """Take a term of group g out of its sum, and out of the counts of its patterns with the others."""
    s, j = groups.sum[g], groups.start[g]
    while groups.terms[j] != term:
        j += 1
    groups.length[g] -= 1
    groups.terms[j] = groups.terms[groups.start[g] + groups.length[g]]
    whole = np.int32((groups.operand[g] << 9) | term)
    i = groups.sum_start[s]
    while i < groups.sum_start[s] + groups.sum_length[s]:
        other = groups.of_sum[i]
        if groups.length[other] == 0:
            groups.sum_length[s] -= 1
            groups.of_sum[i] = groups.of_sum[groups.sum_start[s] + groups.sum_length[s]]
            continue
        op = groups.operand[other] << 9
        for k in range(groups.start[other], groups.start[other] + groups.length[other]):
            h = seat(counts.table, pattern(whole, np.int32(op | groups.terms[k])))
            if counts.table[h, KEY] != FREE:
                counts.table[h, COUNT] -= 1
        i += 1


@kernel
def found(groups, key, hits):
    """Where a pattern stands, no term in it twice: (group, term, group, term), in `hits`; gives how often."""
    a, b = key >> 33, (key >> 11) & ((1 << 22) - 1)
    distance, differ = ((key >> 1) & 1023) - 512, key & 1
    i, j, n = groups.first[a], groups.first[b], 0
    while i < groups.first[a] + groups.count[a] and j < groups.first[b] + groups.count[b]:
        g, f = groups.of_operand[i], groups.of_operand[j]
        if groups.sum[g] != groups.sum[f]:
            if groups.sum[g] < groups.sum[f]:
                i += 1
            else:
                j += 1
            continue
        began = n
        for k in range(groups.start[g], groups.start[g] + groups.length[g]):
            p = groups.terms[k]
            q = (p + 2 * distance) ^ differ
            for m in range(groups.start[f], groups.start[f] + groups.length[f]):
                if groups.terms[m] != q:
                    continue
                taken = False
                if g == f:
                    for t in range(began, n):
                        taken |= hits[t, 1] == p or hits[t, 3] == p or hits[t, 1] == q or hits[t, 3] == q
                if not taken and n < hits.shape[0]:
                    hits[n, 0], hits[n, 1], hits[n, 2], hits[n, 3] = g, p, f, q
                    n += 1
                break
        i += 1
        j += 1
    return n


@kernel
def defined(groups, counts, hits, n, op):
    """Put the new operand op where the hits are."""
    first = groups.ints[GROUPS]
    groups.first[op] = groups.ints[LISTED]
    for t in range(n):
        s = groups.sum[hits[t, 0]]
        forget(groups, counts, hits[t, 0], hits[t, 1])
        forget(groups, counts, hits[t, 2], hits[t, 3])
        g = groups.ints[GROUPS] - 1
        if g < first or groups.sum[g] != s:
            g += 1
            groups.ints[GROUPS] += 1
            groups.operand[g], groups.sum[g], groups.start[g], groups.length[g] = op, s, groups.ints[TERMS], 0
            groups.of_operand[groups.ints[LISTED]] = g
            groups.ints[LISTED] += 1
            groups.count[op] += 1
        groups.terms[groups.ints[TERMS]] = hits[t, 1]
        groups.ints[TERMS] += 1
        groups.length[g] += 1
    return first


@kernel
def counted_new(groups, counts, own, touched, first):
    """Count the patterns of the newest operand, whose groups begin at `first`; those that occur twice join `counts`."""
    n = 0
    for g in range(first, groups.ints[GROUPS]):
        s, op = groups.sum[g], groups.operand[g] << 9
        for j in range(groups.start[g], groups.start[g] + groups.length[g]):
            mine = np.int32(op | groups.terms[j])
            for i in range(groups.sum_start[s], groups.sum_start[s] + groups.sum_length[s]):
                other = groups.of_sum[i]
                head = groups.operand[other] << 9
                for k in range(groups.start[other], groups.start[other] + groups.length[other]):
                    n = noted(own, touched, n, pattern(mine, np.int32(head | groups.terms[k])))
            for k in range(groups.start[g], j):
                n = noted(own, touched, n, pattern(mine, np.int32(op | groups.terms[k])))
        groups.of_sum[groups.sum_start[s] + groups.sum_length[s]] = g
        groups.sum_length[s] += 1
    for t in range(n):
        place = touched[t]
        if own[place, COUNT] > 1:
            h = seat(counts.table, own[place, KEY])
            counts.table[h, KEY], counts.table[h, COUNT] = own[place, KEY], own[place, COUNT]
            counts.ints[TAKEN] += 1
            bucketed(counts, h)
        own[place, KEY] = FREE
    return n


@kernel
def noted(own, touched, n, key):
    """Count a pattern in the small table `own`; gives how many it has."""
    h = seat(own, key)
    if own[h, KEY] == FREE:
        own[h, KEY], own[h, COUNT] = key, 0
        touched[n] = h
        n += 1
    own[h, COUNT] += 1
    return n


@kernel
def paired(groups, sums, terms, keys):
    """Make the most frequent pattern an operand until none occurs twice; its keys in `keys`. Gives how many.

    terms: of each sum, how many it has.
    """
    total = terms.sum()
    counts = counted(groups, sums, total)
    hits = np.zeros((total, 4), np.int64)
    own = np.full((SMALLEST, 2), FREE, np.int64)
    touched = np.zeros(SMALLEST, np.int64)
    operands = groups.first.shape[0] - keys.shape[0]
    made = 0
    while counts.ints[TOP] > 1:
        h = counts.bucket[counts.ints[TOP]]
        if h == NONE:
            counts.ints[TOP] -= 1
            continue
        counts.bucket[counts.ints[TOP]] = counts.link[h]
        if counts.table[h, COUNT] < 2:
            continue
        if counts.table[h, COUNT] < counts.ints[TOP]:
            bucketed(counts, h)
            continue
        key = counts.table[h, KEY]
        counts.table[h, COUNT] = 0
        n = found(groups, key, hits)
        if n < 2:
            continue
        room = np.int64(0)
        for t in range(n):
            s = groups.sum[hits[t, 0]]
            terms[s] -= 1
            room += terms[s]
        if 2 * room > own.shape[0]:
            places = own.shape[0]
            while places < 4 * room:
                places *= 2
            own = np.full((places, 2), FREE, np.int64)
            touched = np.zeros(places, np.int64)
        if 2 * (counts.ints[TAKEN] + room) > counts.table.shape[0]:
            counts = frequent(counts, room)
        first = defined(groups, counts, hits, n, operands + made)
        counted_new(groups, counts, own, touched, first)
        keys[made] = key
        made += 1
    return made
