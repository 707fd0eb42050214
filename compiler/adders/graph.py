"""A constant matrix times a vector as a graph of two-operand adders: what the solver gives and the RTL reads."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

AT_ONCE = 512  # columns of which every node's coefficients are kept at once
CONSTANT = -1  # as an operand: the number in the field `constant`, not a signal


class Node(NamedTuple):
    """One adder: `((left << left_shift) ± (right << right_shift)) >> drop`.

    left, right: operands: 0 to columns - 1 are the columns, columns + k is node k, an earlier one, CONSTANT the field
    `constant` (whose shift is 0). The shifts are never negative. subtract: right is taken away. drop: that many low
    bits of the sum are 0 for every input, so nothing is lost. lo, hi: the least and the greatest value that the node
    takes (after the drop) over all inputs; both are reached.
    """

    left: int
    left_shift: int
    right: int
    right_shift: int
    subtract: bool
    drop: int
    constant: int
    lo: int
    hi: int

    @property
    def width(self) -> int:
        """Bits of two's complement that hold every value of the node, and no fewer do."""
        return signed_width(self.lo, self.hi)

    @property
    def bits(self) -> int:
        """Full adders that the node needs: its sum's bits, less the low ones that pass from one operand unchanged."""
        trailing = 0
        if CONSTANT in (self.left, self.right) and self.constant:
            trailing = (self.constant & -self.constant).bit_length() - 1
        left = trailing if self.left == CONSTANT else self.left_shift
        right = trailing if self.right == CONSTANT else self.right_shift
        passed = right - left if left < right else 0 if self.subtract else left - right
        return max(1, self.width + self.drop - min(left, right) - passed)


class Output(NamedTuple):
    """One row: `operand << shift`, negated if `negate`; the number `constant` where the operand is CONSTANT."""

    operand: int
    shift: int
    negate: bool
    constant: int


@dataclass(frozen=True)
class Graph:
    """Adders in an order in which every operand stands before its users, over columns of known ranges.

    ranges: (lo, hi) of each column. outputs: one per row. A row is negated at its output only where no choice of signs
    inside the graph avoids it (a row such as -x that nobody adds anything to).
    """

    ranges: tuple[tuple[int, int], ...]
    nodes: tuple[Node, ...]
    outputs: tuple[Output, ...]

    @property
    def columns(self) -> int:
        return len(self.ranges)

    @property
    def adders(self) -> int:
        """Two-operand additions and subtractions."""
        return len(self.nodes)

    @property
    def adder_bits(self) -> int:
        """Full adders of the whole graph: an estimate of its LUTs on a carry chain."""
        return sum(node.bits for node in self.nodes)

    @cached_property
    def levels(self) -> tuple[int, ...]:
        """Adders in a row up to and with each node."""
        found: list[int] = []
        for n in self.nodes:
            found.append(1 + max(found[o - self.columns] if o >= self.columns else 0 for o in (n.left, n.right)))
        return tuple(found)

    def level(self, operand: int) -> int:
        """Adders in a row from the inputs to an operand: 0 for a column and for the constant."""
        return self.levels[operand - self.columns] if operand >= self.columns else 0

    @property
    def depth(self) -> int:
        """Adders in a row on the longest way from a column to an output."""
        return max((self.level(o.operand) for o in self.outputs), default=0)

    def range(self, operand: int) -> tuple[int, int]:
        """The exact (lo, hi) of a column or a node."""
        if operand < self.columns:
            return self.ranges[operand]
        node = self.nodes[operand - self.columns]
        return node.lo, node.hi

    def width(self, operand: int) -> int:
        """Bits that hold a column or a node."""
        return signed_width(*self.range(operand))

    def vectors(self, first: int, last: int) -> np.ndarray:
        """What every operand is of the columns from first to last - 1, (columns + nodes, last - first + 1).

        The last one of a row is its constant; the integers never overflow. It is computed from the adders alone, and
        asserts that no dropped bit was ever anything but 0.
        """
        table: np.ndarray = np.zeros((self.columns + len(self.nodes), last - first + 1), dtype=self._exact())
        for c in range(first, last):
            table[c, c - first] = 1
        one = np.zeros(last - first + 1, dtype=table.dtype)
        one[-1] = 1
        for k, n in enumerate(self.nodes, self.columns):
            left = one * n.constant if n.left == CONSTANT else table[n.left] << n.left_shift
            right = one * n.constant if n.right == CONSTANT else table[n.right] << n.right_shift
            total = left - right if n.subtract else left + right
            assert not int(np.bitwise_or.reduce(total)) & ((1 << n.drop) - 1), f"node {k - self.columns} drops bits"
            table[k] = total >> n.drop
        return table

    def _exact(self) -> type:
        """The type of number that holds every coefficient: a bound of each operand's follows from those it reads."""
        most = [1] * self.columns
        for n in self.nodes:
            left = abs(n.constant) if n.left == CONSTANT else most[n.left] << n.left_shift
            right = abs(n.constant) if n.right == CONSTANT else most[n.right] << n.right_shift
            if left + right > np.iinfo(np.int64).max:
                return object
            most.append((left + right >> n.drop) + 1)
        return np.int64

    def matrix(self) -> np.ndarray:
        """The matrix that the graph computes, (rows, columns), as Python integers in an array of objects."""
        found = np.zeros((len(self.outputs), self.columns), dtype=object)
        for first, last in pairwise([*range(0, self.columns, AT_ONCE), self.columns]):
            table = self.vectors(first, last)[:, :-1]
            for r, o in enumerate(self.outputs):
                if o.operand != CONSTANT:
                    found[r, first:last] = table[o.operand].astype(object) * ((1 << o.shift) * (-1 if o.negate else 1))
        return found


def signed_width(lo: int, hi: int) -> int:
    """Bits of two's complement that hold every integer from lo to hi."""
    return 1 + max((~lo if lo < 0 else lo).bit_length(), (~hi if hi < 0 else hi).bit_length())
