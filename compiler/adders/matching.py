"""Which of many parts of a sum are added to which: always the pair whose sum is the narrowest."""

from collections.abc import Sequence

import numpy as np

from greygate.compiler.adders.table import kernel

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
