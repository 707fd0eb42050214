"""Records to train on and to judge on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from greygate.errors import InputError
from greygate.models.network import Network


@dataclass(frozen=True)
class Record:
    """One sequence to learn: inputs and targets {port: (N,)} in physical units.

    initial: as for `Network.run`, or what `Trained.initial` found. skip: first samples that do not count. weight: of
    this record in the loss. own_offset, own_gain: outputs whose sensor has an offset, a gain, of its own here: those
    that fit best are taken as they come.

    >>> t = np.arange(500) * 1e-3
    >>> inputs = {"u": 2.0 * np.sin(40.0 * t**1.5)}
    >>> record = Record(inputs, lag.run(inputs))
    >>> record
    <Record: u -> y, 500 samples>
    """

    inputs: Mapping[str, np.ndarray]
    targets: Mapping[str, np.ndarray]
    initial: Mapping[str, float | np.ndarray] = field(default_factory=dict)
    skip: int = 0
    weight: float = 1.0
    own_offset: frozenset[str] = frozenset()
    own_gain: frozenset[str] = frozenset()

    def __repr__(self) -> str:
        return f"<Record: {', '.join(self.inputs)} -> {', '.join(self.targets)}, {len(self)} samples>"

    def __len__(self) -> int:
        return len(next(iter(self.targets.values()), ()))

    def cut(self, start: int, stop: int, **changes) -> "Record":
        """The samples start..stop. changes: as for `dataclasses.replace`."""
        parts = ({n: v[start:stop] for n, v in part.items()} for part in (self.inputs, self.targets))
        return replace(self, **(dict(zip(("inputs", "targets"), parts, strict=True)) | changes))


def listed(records: Sequence[Record] | Record) -> Sequence[Record]:
    """One record is a list of one."""
    return (records,) if isinstance(records, Record) else records


def held_out(
    network: Network, records: Sequence[Record], tail: float, held: Sequence[Record]
) -> tuple[list[Record], list[Record]]:
    """(records to train on, held-out records): the last share `tail` of each is held out, and so is `held`.

    A held-out tail is run from the start of its record and judged from its own. Where a record skips more than what
    comes before its tail, nothing of it is left to train on. Raises InputError for a share outside [0, 1), no records,
    or a record that skips all of its samples.
    """
    if not records:
        raise InputError(f"network {network.name}: no records to train on")
    if not 0 <= tail < 1:
        raise InputError(f"tail {tail}: a share from 0 up to 1, without 1")
    check_skips(network, [*records, *held])
    if not tail:
        return list(records), list(held)
    heads = [int((1 - tail) * len(r)) for r in records]
    tails = [replace(r, skip=max(h, r.skip)) for r, h in zip(records, heads, strict=True)]
    return [r.cut(0, h) for r, h in zip(records, heads, strict=True)], tails + list(held)


def check_skips(network: Network, records: Sequence[Record]) -> None:
    """Raises InputError for a record that skips all of its samples."""
    for i, record in enumerate(records):
        if len(record) and not 0 <= record.skip < len(record):
            raise InputError(
                f"network {network.name}: record {i} skips {record.skip} of its {len(record)} samples; skip fewer"
            )
