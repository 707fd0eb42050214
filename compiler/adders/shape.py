"""From shared sums to an adder graph: trees balanced for depth, signs kept inside, every range exact.

A search gives *sums*: lists of terms (operand, shift, sign). Operands 0 to columns - 1 are the columns, columns + k is
definition k, an earlier one. Values are meant up to a shift: a shift may be negative, and where it is, the bits that it
drops are 0.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from greygate.compiler.adders.graph import CONSTANT, Graph, Node, Output
from greygate.compiler.adders.moves import kernel

SAFE_BITS = 61  # of two magnitudes in an int64 whose sum fits as well
AT_ONCE = 1024  # parts of which every pair is looked at; of more those of like size stand together


def paired(sizes: Sequence[int], shifts: Sequence[int]) -> tuple[list[tuple[int, int]], list[int]]:
    """Pairs of numbers of parts in the order in which they are made, and the part left over if there is one.

    sizes: the greatest magnitude of each part, which counts `shift` places higher.
    """
    low = min(shifts)
    groups = [list(range(len(sizes)))]
    if len(sizes) > AT_ONCE:
        order = sorted(range(len(sizes)), key=lambda i: (sizes[i] << (shifts[i] - low), i))
        groups = [sorted(order[i : i + AT_ONCE]) for i in range(0, len(order), AT_ONCE)]
    pairs, over = [], []
    for group in groups:
        size, shift = [sizes[i] for i in group], [shifts[i] - low for i in group]
        if len(group) > 2 and max(map(int.bit_length, size)) + max(shift) <= SAFE_BITS:
            made = greedy(np.array(size, np.int64), np.array(shift, np.int64)).tolist()
        else:
            made = _plain(size, shift)
        pairs += [(group[a], group[b]) for a, b in made]
        taken = {i for pair in made for i in pair}
        over += [group[i] for i in range(len(group)) if i not in taken]
    if len(over) > 1:  # of several groups
        pairs += zip(over[::2], over[1::2], strict=False)
        over = over[len(over) & ~1 :]
    return pairs, over


def _plain(size: list[int], shift: list[int]) -> list[tuple[int, int]]:
    """As `greedy`, for integers of any size."""
    ways = []
    for a in range(len(size)):
        for b in range(a + 1, len(size)):
            base = min(shift[a], shift[b])
            top = (size[a] << (shift[a] - base)) + (size[b] << (shift[b] - base))
            ways.append((top.bit_length() - abs(shift[a] - shift[b]), a, b))
    found = []
    free = set(range(len(size)))
    for _, a, b in sorted(ways):
        if a in free and b in free:
            found.append((a, b))
            free -= {a, b}
    return found


@kernel
def greedy(size, shift):
    """(pairs, 2): again and again the two free parts whose adder is the narrowest, of equals the first."""
    n = size.shape[0]
    ways = np.zeros(n * (n - 1) // 2, np.int64)
    count = 0
    for a in range(n):
        for b in range(a + 1, n):
            base = min(shift[a], shift[b])
            top = (size[a] << (shift[a] - base)) + (size[b] << (shift[b] - base))
            bits = 64 - abs(shift[a] - shift[b])
            while top > 0:
                top >>= 1
                bits += 1
            ways[count] = (bits * n + a) * n + b
            count += 1
    ways.sort()
    free = np.ones(n, np.bool_)
    found = np.zeros((n // 2, 2), np.int64)
    made = 0
    for i in range(count):
        a, b = ways[i] // n % n, ways[i] % n
        if free[a] and free[b]:
            found[made, 0], found[made, 1] = a, b
            free[a] = free[b] = False
            made += 1
    return found


Term = tuple[int, int, int]  # operand, shift, sign
SAFE = 1 << 62  # a sum of magnitudes below it fits an int64 whatever the signs


class _Value(NamedTuple):
    """A linear form as it is built: an odd vector (columns and the constant), its magnitude and its level."""

    vector: np.ndarray
    size: int  # sum of |coefficient| times the greatest magnitude of the column
    level: int
    place: int  # in the list of what is built


class _Part(NamedTuple):
    """A term of a sum under way: sign * (value << shift)."""

    value: _Value
    shift: int
    sign: int


class _Built(NamedTuple):
    """One adder before its sign is chosen: sum of two parts by their places, and the low bits that it drops."""

    left: int
    left_shift: int
    left_sign: int
    right: int
    right_shift: int
    right_sign: int
    drop: int


def shape(
    columns: int,
    definitions: Sequence[Sequence[Term]],
    rows: Sequence[Sequence[Term]],
    constants: Sequence[int],
    ranges: Sequence[tuple[int, int]],
) -> Graph:
    """Build the graph: of each sum the tree of least depth, of narrow adders where that leaves a choice."""
    return _Shaper(columns, constants, ranges).graph(*inlined(columns, definitions, rows))


def inlined(
    columns: int, definitions: Sequence[Sequence[Term]], rows: Sequence[Sequence[Term]]
) -> tuple[list[list[Term]], list[list[Term]]]:
    """Put every definition that is read once into its reader; leave out what nobody reads; number the rest anew."""
    sums = [list(d) for d in definitions]
    outs = [list(r) for r in rows]
    uses = [0] * len(sums)
    for s in outs:
        for o, _, _ in s:
            if o >= columns:
                uses[o - columns] += 1
    for k in range(len(sums) - 1, -1, -1):
        if not uses[k]:
            continue
        for o, _, _ in sums[k]:
            if o >= columns:
                uses[o - columns] += 1
    number: dict[int, int] = {}
    kept: list[list[Term]] = []

    def open_up(terms: Sequence[Term]) -> list[Term]:
        found: list[Term] = []
        for o, shift, sign in terms:
            k = o - columns
            if k < 0:
                found.append((o, shift, sign))
            elif uses[k] == 1 or len(sums[k]) == 1:
                found += [(p, shift + s, sign * g) for p, s, g in sums[k]]
            else:
                found.append((number[k], shift, sign))
        return found

    for k, terms in enumerate(sums):
        if not uses[k]:
            continue
        sums[k] = open_up(terms)
        if uses[k] > 1 and len(sums[k]) > 1:
            number[k] = columns + len(kept)
            kept.append(sums[k])
    return kept, [open_up(r) for r in outs]


class _Shaper:
    """Builds values one by one: the range `reached[i]` with `adders[i]` (None for a column or a constant)."""

    def __init__(self, columns: int, constants: Sequence[int], ranges: Sequence[tuple[int, int]]):
        self.columns = columns
        self.constants = [int(c) for c in constants]
        self.ranges = [(int(lo), int(hi)) for lo, hi in ranges]
        self.sizes = [max(abs(lo), abs(hi), 1) for lo, hi in self.ranges]
        exact = np.int64 if max(self.sizes, default=0) < SAFE else object
        self.most = np.array([*self.sizes, 1], dtype=exact)  # the last one stands for the constant
        self.lo, self.hi = np.array([*self.ranges, (1, 1)], dtype=exact).T
        self.reached: list[tuple[int, int]] = []  # the least and the greatest number
        self.adders: list[_Built | None] = []
        self.numbers: dict[int, int] = {}  # place -> the number that a constant stands for
        self.defined: list[_Part] = []
        for span in self.ranges:
            self.reached.append(span)
            self.adders.append(None)

    def _keep(self, vector: np.ndarray, size: int, level: int, adder: _Built | None) -> _Value:
        """A value with what will be asked of it; its vector lives as long as something adds to it."""
        self.reached.append(self._range(vector))
        self.adders.append(adder)
        return _Value(vector, size, level, len(self.adders) - 1)

    def graph(self, definitions: list[list[Term]], rows: list[list[Term]]) -> Graph:
        for terms in definitions:
            self.defined.append(self._tree([self._part(*term) for term in terms]))
        outputs: list[_Part | None] = []
        for terms, constant in zip(rows, self.constants, strict=True):
            parts = [self._part(*term) for term in terms]
            if constant and parts:
                parts.append(self._constant(constant))
            outputs.append(self._tree(parts) if parts else None)
        return self._signed(outputs)

    def _part(self, operand: int, shift: int, sign: int) -> _Part:
        if operand >= self.columns:
            part = self.defined[operand - self.columns]
            return _Part(part.value, part.shift + shift, part.sign * sign)
        vector = np.zeros(self.columns + 1, dtype=self.most.dtype)
        vector[operand] = 1
        return _Part(_Value(vector, self.sizes[operand], 0, operand), shift, sign)

    def _constant(self, number: int) -> _Part:
        shift = _trailing(number)
        odd = abs(number) >> shift
        vector = np.zeros(self.columns + 1, dtype=np.int64 if odd < SAFE else object)
        vector[-1] = odd
        value = self._keep(vector, odd, 0, None)
        self.numbers[value.place] = odd
        return _Part(value, shift, 1 if number > 0 else -1)

    def _tree(self, parts: list[_Part]) -> _Part:
        """Sum the parts: always two of the lowest level, of all such pairs that which needs the narrowest adder."""
        parts = list(parts)
        while len(parts) > 1:
            level = min(p.value.level for p in parts)
            low = [p for p in parts if p.value.level == level]
            parts = [p for p in parts if p.value.level != level]
            if len(low) == 1:
                above = min(p.value.level for p in parts)
                others = [i for i, p in enumerate(parts) if p.value.level == above]
                best = min(others, key=lambda i: _bits(low[0], parts[i]))
                parts.append(self._add(low[0], parts.pop(best)))
                continue
            pairs, over = paired([p.value.size for p in low], [p.shift for p in low])
            parts = [low[i] for i in over] + parts + [self._add(low[a], low[b]) for a, b in pairs]
        return parts[0]

    def _add(self, a: _Part, b: _Part) -> _Part:
        base = min(a.shift, b.shift)
        left, right = a.shift - base, b.shift - base
        x, y = a.value.vector, b.value.vector
        if (a.value.size << left) + (b.value.size << right) >= SAFE:
            x, y = x.astype(object), y.astype(object)
        vector = x * (a.sign << left) + y * (b.sign << right)
        drop = _trailing(int(np.bitwise_or.reduce(vector)))
        vector = vector >> drop
        size = int(abs(vector) @ self.most)
        adder = _Built(a.value.place, left, a.sign, b.value.place, right, b.sign, drop)
        level = 1 + max(a.value.level, b.value.level)
        return _Part(self._keep(vector, size, level, adder), base + drop, 1)

    def _signed(self, outputs: list[_Part | None]) -> Graph:
        """Choose the sign of every node so that no adder negates both operands, and no output its node if avoidable."""
        signs = _Signs(self.adders, self.numbers, outputs).chosen()
        number: dict[int, int] = {c: c for c in range(self.columns)}
        nodes: list[Node] = []
        for i, adder in enumerate(self.adders):
            if adder is None:
                continue
            number[i] = self.columns + len(nodes)
            nodes.append(self._node(i, adder, signs, number))
        rows = []
        for part, constant in zip(outputs, self.constants, strict=True):
            if part is None:
                rows.append(Output(CONSTANT, 0, False, constant))
            else:
                i = part.value.place
                rows.append(Output(number[i], part.shift, part.sign * signs[i] < 0, 0))
        return Graph(tuple(self.ranges), tuple(nodes), tuple(rows))

    def _node(self, i: int, adder: _Built, signs: list[int], number: dict[int, int]) -> Node:
        sides = []
        for operand, shift, sign in (adder[:3], adder[3:6]):
            constant = self.numbers.get(operand, 0) * signs[operand]
            sides.append((sign * signs[operand] * signs[i], number.get(operand, CONSTANT), shift, constant << shift))
        sides.sort(key=lambda side: -side[0])  # a negative one goes right
        (positive, a, a_shift, a_constant), (other, b, b_shift, b_constant) = sides
        assert positive > 0, "an adder negates both operands"
        a_shift, b_shift = (0 if a == CONSTANT else a_shift), (0 if b == CONSTANT else b_shift)
        lo, hi = self.reached[i] if signs[i] > 0 else (-self.reached[i][1], -self.reached[i][0])
        return Node(a, a_shift, b, b_shift, other < 0, adder.drop, a_constant or b_constant, lo, hi)

    def _range(self, vector: np.ndarray) -> tuple[int, int]:
        lo, hi = self.lo, self.hi
        return int(np.where(vector < 0, hi, lo) @ vector), int(np.where(vector < 0, lo, hi) @ vector)


class _Signs:
    """Signs of the built values: an adder a*x + b*y must not find both of its terms of the sign opposite to its own."""

    def __init__(self, adders: list[_Built | None], numbers: dict[int, int], outputs: list[_Part | None]):
        self.adders, self.numbers = adders, numbers
        self.signs = [1] * len(adders)
        self.users: list[list[int]] = [[] for _ in adders]
        self.wanted: dict[int, int] = {}  # value -> the sign that its outputs ask for; 0 if they disagree
        for i, adder in enumerate(adders):
            if adder is not None:
                for o in (adder.left, adder.right):
                    self.users[o].append(i)
        for part in outputs:
            if part is not None:
                i = part.value.place
                self.wanted[i] = part.sign if self.wanted.get(i, part.sign) == part.sign else 0

    def chosen(self) -> list[int]:
        for i in range(len(self.adders)):
            self._settle(i)
        for i, wanted in self.wanted.items():
            if wanted and self.signs[i] != wanted:
                trail: list[int] = []
                if not self._flip(i, None, trail):
                    for j in trail:
                        self.signs[j] = -self.signs[j]
        return self.signs

    def _settle(self, i: int) -> None:
        adder = self.adders[i]
        if adder is None:
            return
        x, y = self._terms(adder)
        if x == y and adder.left not in self.numbers and adder.right not in self.numbers:
            self.signs[i] = x
        else:
            self.signs[i] = self.wanted.get(i, 1) or 1
            if x == y:  # the constant takes whatever sign helps
                constant = adder.left if adder.left in self.numbers else adder.right
                self.signs[constant] = self.signs[constant] if self.signs[i] == x else -self.signs[constant]

    def _terms(self, adder: _Built) -> tuple[int, int]:
        return adder.left_sign * self.signs[adder.left], adder.right_sign * self.signs[adder.right]

    def _good(self, i: int) -> bool:
        adder = self.adders[i]
        assert adder is not None
        x, y = self._terms(adder)
        return x != y or x == self.signs[i]

    def _flip(self, i: int, asker: int | None, trail: list[int]) -> bool:
        """Turn the sign of a value, and of values below it where an adder then asks for that; note them in trail."""
        adder = self.adders[i]
        if adder is None and i not in self.numbers:
            return False
        if i in trail or (asker is not None and self.wanted.get(i)):
            return False
        self.signs[i] = -self.signs[i]
        trail.append(i)
        if any(not self._good(u) for u in self.users[i] if u != asker):
            return False
        if adder is None or self._good(i):
            return True
        for operand in (adder.left, adder.right):
            mark = len(trail)
            if self._flip(operand, i, trail) and self._good(i):
                return True
            for j in trail[mark:]:
                self.signs[j] = -self.signs[j]
            del trail[mark:]
        return False


def _bits(a: _Part, b: _Part) -> int:
    """An estimate of the full adders that the sum of two parts needs."""
    base = min(a.shift, b.shift)
    top = (a.value.size << (a.shift - base)) + (b.value.size << (b.shift - base))
    return top.bit_length() - abs(a.shift - b.shift)


def _trailing(number: int) -> int:
    """Zeros at the low end of a number that is not 0."""
    return (number & -number).bit_length() - 1
