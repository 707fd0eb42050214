"""Sums of many terms in two flat arrays: their pairs shared, their definitions tidied, the whole transposed."""

from dataclasses import dataclass

import numpy as np

from greygate.compiler.adders.moves import ZERO, kernel
from greygate.compiler.adders.pairs import GROUPS, NONE, Groups, paired


@dataclass(frozen=True)
class Flat:
    """The terms of all sums (as in moves.py) in any order, beside each the number of its sum.

    Sums 0 to rows - 1 are the rows, the others, of `sums` in all, definitions: operand columns + k is sum k.
    """

    columns: int
    rows: int
    sums: int
    of_sum: np.ndarray
    terms: np.ndarray

    @staticmethod
    def of(body: np.ndarray, length: np.ndarray, columns: int, rows: int) -> "Flat":
        """What `packed` gave."""
        inside = np.arange(body.shape[1]) < length[:, None]
        return Flat(columns, rows, len(body), np.nonzero(inside)[0], body[inside].astype(np.int64))

    @property
    def adders(self) -> int:
        return len(self.terms) - len(np.unique(self.of_sum))

    @property
    def pairs(self) -> int:
        """Pairs of terms in one sum."""
        length = np.bincount(self.of_sum)
        return int((length * (length - 1) // 2).sum())

    @property
    def places(self) -> int:
        """From the lowest shift to the highest."""
        shifts = (self.terms >> 1) & 255
        return int(shifts.max(initial=0) - shifts.min(initial=255)) + 1

    def cut(self, parts: int) -> "Flat":
        """Each row as so many rows, of a block of columns each. There are no definitions yet."""
        block = (self.terms >> 9) * parts // self.columns
        rows = self.rows * parts
        return Flat(self.columns, rows, rows, self.of_sum + self.rows * block, self.terms)

    def joined(self, rows: int) -> "Flat":
        """The rows that were cut in one again."""
        less = self.rows - rows
        of_sum = np.where(self.of_sum < self.rows, self.of_sum % rows, self.of_sum - less)
        terms = np.where(self.terms >> 9 < self.columns, self.terms, self.terms - (less << 9))
        return Flat(self.columns, rows, self.sums - less, of_sum, terms)

    def shared(self) -> "Flat":
        """The most frequent pairs made definitions until no pair occurs twice."""
        found = self
        while True:
            new = found._paired()._tidied()
            if new.sums == found.sums and len(new.terms) == len(found.terms):
                return new
            found = new

    def transposed(self) -> "Flat":
        """The transposed network, with each edge turned round: it has as many adders, but for empty rows."""
        c, r, op = self.columns, self.rows, self.terms >> 9
        source = np.where(self.of_sum < r, self.of_sum, self.of_sum + c)
        return Flat(r, c, c + self.sums - r, np.where(op < c, op, op - r), (source << 9) | (self.terms & 511))

    def packed(self) -> tuple[np.ndarray, np.ndarray]:
        """(sums, longest) terms of each sum from the left, and how many it has."""
        order, start = self._ordered()
        length = np.diff(start)
        body = np.zeros((self.sums, int(length.max(initial=0))), np.int32)
        of_sum = self.of_sum[order]
        body[of_sum, np.arange(len(order)) - start[of_sum]] = self.terms[order]
        return body, length

    def _ordered(self) -> tuple[np.ndarray, np.ndarray]:
        order = np.argsort(self.of_sum, kind="stable")
        return order, np.concatenate([[0], np.cumsum(np.bincount(self.of_sum, minlength=self.sums))])

    def _paired(self) -> "Flat":
        groups, length = grouped(self)
        keys = np.zeros(len(self.terms) // 2 + 1, np.int64)
        keys = keys[: paired(groups, self.sums, length, keys)]
        n = groups.ints[GROUPS]
        size, start = groups.length[:n], groups.start[:n]
        where = np.repeat(start - _before(size), size) + np.arange(size.sum())
        a, b, distance = keys >> 33, (keys >> 11) & ((1 << 22) - 1), ((keys >> 1) & 1023) - 512
        left, right = (a << 9) | (ZERO << 1), (b << 9) | ((ZERO + distance) << 1) | (keys & 1)
        new = self.sums + np.arange(len(keys))
        of_sum = np.concatenate([np.repeat(groups.sum[:n], size), new, new])
        terms = np.concatenate([np.repeat(groups.operand[:n] << 9, size) | groups.terms[where], left, right])
        return Flat(self.columns, self.rows, self.sums + len(keys), of_sum, terms)

    def _tidied(self) -> "Flat":
        order, start = self._ordered()
        of_sum, terms, n, sums = opened(self.columns, self.rows, start, self.terms[order], self.sums)
        return Flat(self.columns, self.rows, sums, of_sum[:n], terms[:n])


def grouped(flat: Flat) -> tuple[Groups, np.ndarray]:
    """The groups of the terms, with room for the definitions to come, and how many terms each sum has."""
    order = np.lexsort((flat.terms, flat.of_sum))
    of_sum, terms, sums = flat.of_sum[order], flat.terms[order], flat.sums
    operand, low = terms >> 9, terms & 511
    new = np.ones(len(terms), bool)
    new[1:] = (of_sum[1:] != of_sum[:-1]) | (operand[1:] != operand[:-1])
    start = np.flatnonzero(new)
    n, most = len(start), len(start) + len(terms)
    length = np.bincount(of_sum, minlength=sums)
    own = np.bincount(of_sum[start], minlength=sums)
    sum_start = _before(own + length)
    listed = np.zeros(most, np.int64)
    listed[np.arange(n) + (sum_start - _before(own))[of_sum[start]]] = np.arange(n)
    operands = flat.columns + sums + len(terms) // 2 + 1
    by_operand = np.argsort(operand[start], kind="stable")
    count = np.bincount(operand[start], minlength=operands)
    groups = Groups(
        _longer(low, 2 * len(terms)),
        _longer(operand[start], most),
        _longer(of_sum[start], most),
        _longer(start, most),
        _longer(np.diff(start, append=len(terms)), most),
        listed,
        sum_start,
        own,
        _longer(by_operand, most),
        _before(count),
        count,
        np.array([n, n, len(terms)]),
    )
    return groups, length


def _longer(values: np.ndarray, size: int) -> np.ndarray:
    found = np.zeros(size, np.int64)
    found[: len(values)] = values
    return found


def _before(sizes: np.ndarray) -> np.ndarray:
    """The sum of all sizes before each."""
    return np.cumsum(sizes) - sizes


@kernel
def opened(columns, rows, start, terms, sums):
    """Open definitions that are read once or have one term, drop those that nobody reads, and add equal terms up.

    start: where the terms of each sum begin. Gives the sum of each term, the terms, and how many sums are left.
    """
    uses = np.zeros(sums, np.int64)
    for s in range(rows):
        uses[s] = 2
    stack = np.zeros(terms.shape[0] + sums + 1, np.int64)
    top = 0
    seen = np.zeros(sums, np.bool_)
    for s in range(rows):
        stack[top] = s
        top += 1
    while top > 0:
        top -= 1
        s = stack[top]
        for i in range(start[s], start[s + 1]):
            k = (terms[i] >> 9) - columns
            if k >= 0:
                uses[k] += 1
                if not seen[k]:
                    seen[k] = True
                    stack[top] = k
                    top += 1
    number = np.zeros(sums, np.int64)
    left = 0
    for s in range(sums):
        if s < rows or (uses[s] > 1 and start[s + 1] - start[s] > 1):
            number[s] = left
            left += 1
        else:
            number[s] = NONE
    of_sum, found = np.zeros(terms.shape[0], np.int64), np.zeros(terms.shape[0], np.int64)
    return of_sum, found, _opened(columns, start, terms, number, stack, of_sum, found), left


@kernel
def _opened(columns, start, terms, number, stack, of_sum, found):
    """Write each sum that has a number, with the terms of those that have none in their place; gives how many terms."""
    n = 0
    for s in range(number.shape[0]):
        if number[s] == NONE:
            continue
        began, top = n, 0
        for i in range(start[s], start[s + 1]):
            stack[top] = terms[i]
            top += 1
        while top > 0:
            top -= 1
            term = stack[top]
            k = (term >> 9) - columns
            if k < 0 or number[k] != NONE:
                op = term >> 9 if k < 0 else columns + number[k]
                found[n] = (op << 9) | (term & 511)
                n += 1
                continue
            for i in range(start[k], start[k + 1]):
                stack[top] = (terms[i] + 2 * (((term >> 1) & 255) - ZERO)) ^ (term & 1)
                top += 1
        n = _added_up(found, began, n)
        for i in range(began, n):
            of_sum[i] = number[s]
    return n


@kernel
def _added_up(found, began, n):
    """Two equal terms become one of twice the weight, opposite ones vanish; gives where the terms now end."""
    again = True
    while again:
        again = False
        found[began:n].sort()
        kept, i = began, began
        while i < n:
            if i + 1 < n and found[i] >> 1 == found[i + 1] >> 1:
                if found[i] == found[i + 1]:
                    found[kept] = found[i] + 2
                    kept += 1
                again = True
                i += 2
            else:
                found[kept] = found[i]
                kept += 1
                i += 1
        n = kept
    return n
