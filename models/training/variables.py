"""Which columns of theta move in a training, and which follow others."""

from collections.abc import Mapping, Sequence

import numpy as np

from greygate.errors import InputError
from greygate.models.network import Network


def movable(flat: Network, place: Mapping[str, np.ndarray], free: Mapping) -> np.ndarray:
    """For each column of the weights and biases, whether it may move: it is not frozen, and `free` allows it.

    place: parameter -> its columns. free: as for `Objective`. Raises InputError for another name or shape.
    """
    for name, which in free.items():
        if name not in place:
            raise InputError(f"network {flat.name}: no parameter {name} to leave free")
        if np.size(which) not in (1, len(place[name])):
            raise InputError(f"free: {name} has shape {flat.parameters()[name].shape}, not {np.shape(which)}")
    found, layers = [], flat.layers()
    for name, columns in place.items():
        layer, _, port = name.rpartition(".")
        frozen = port in layers[layer].frozen
        found.append(np.full(len(columns), not frozen) & np.asarray(free.get(name, True), bool).ravel())
    return np.concatenate(found)


def leaders(
    flat: Network, place: Mapping[str, np.ndarray], may_move: np.ndarray, tied: Sequence[Sequence[str]]
) -> np.ndarray:
    """For each column of theta, the column whose value it takes: its own, or in a group that is tied the first one's.

    Raises InputError for a name that the network does not have, members of different shapes, and those that may not
    move.
    """
    like = np.arange(len(may_move))
    for group in tied:
        first, *others = [_columns(flat, place, name) for name in group]
        for name, columns in zip(group[1:], others, strict=True):
            if len(columns) != len(first):
                raise InputError(f"network {flat.name}: {name} and {group[0]} differ in shape; no tie")
            if not (may_move[columns].all() and may_move[first].all()):
                raise InputError(f"network {flat.name}: {name} or {group[0]} may not move; no tie")
            like[columns] = like[first]
    while (like[like] != like).any():  # groups that share a member
        like = like[like]
    return like


def _columns(flat: Network, place: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    found = [c for n, c in place.items() if n == name or n.startswith(name + ".")]
    if not found:
        raise InputError(f"network {flat.name}: no module, layer or parameter {name} to tie")
    return np.concatenate(found)
