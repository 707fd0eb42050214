"""Limits of sums: which multiplexers are none but a limit, and which clamps hardware performs with the sum.

The sums of a multiplexer are matrices (neurons, columns + 1): weights on all columns, and the bias.
"""

from typing import NamedTuple

import numpy as np

from greygate.emulator.program import Affine, Clamp, Program

SAME = 1e-12  # of the largest number of a row: what scalings on the way, computed in another order, leave of equality


class Limit(NamedTuple):
    """max(value, end) if `least`, else min(value, end); `value` is 1 for the sum above, 2 for the one below."""

    value: int
    end: float
    least: bool


def factors(one: np.ndarray, other: np.ndarray) -> np.ndarray | None:
    """The number of each row by which `other` is `one`, (neurons,); None if a row is no multiple or `other` has 0."""
    power = (other * other).sum(axis=1)
    if not power.all():
        return None
    found = (one * other).sum(axis=1) / power
    same = np.abs(one - found[:, None] * other).max(axis=1) <= SAME * np.abs(one).max(axis=1)
    return found if same.all() else None


def limit(condition: np.ndarray, above: np.ndarray, below: np.ndarray) -> Limit | None:
    """The limit that the multiplexer is; None if it is something else, or its neurons do not end alike.

    >>> import numpy as np
    >>> v = np.array([[0.5, -2.0, 1.0]])
    >>> limit(v, v, 0 * v)
    Limit(value=1, end=0.0, least=True)
    """
    for value, (sum_, other) in ((1, (above, below)), (2, (below, above))):
        ends = other[:, -1]
        if other[:, :-1].any() or (ends != ends[0]).any():
            continue
        beyond = sum_.copy()
        beyond[:, -1] -= ends
        found = factors(condition, beyond)
        if found is not None and (np.all(found > 0) or np.all(found < 0)):
            return Limit(value, float(ends[0]), bool((found[0] > 0) == (value == 1)))
    return None


def clamps_behind(program: Program) -> dict[str, Clamp]:
    """Sum -> the CLAMP that alone reads it, in the sum's format; one register holds the result of both."""
    shown = {p.signal.name for p in program.outputs} | {s.source for s in program.states}
    readers: dict[str, list] = {o.out.name: [] for o in program.operations if isinstance(o, Affine)}
    for o in program.operations:
        for a in set(o.args) & readers.keys():
            readers[a].append(o)
    return {
        name: found[0]
        for name, found in readers.items()
        if name not in shown and len(found) == 1 and isinstance(found[0], Clamp)
        if found[0].out.fix == program.signals[name].fix
    }
