"""Several recordings of one machine, which are explained together.

They stand one after the other. Whatever looks along time (a rate, a filter, a correlation) looks along one of them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from greygate.plants.recording import Recording


@dataclass(frozen=True)
class Runs(Recording):
    """The recordings `each`, of the same channels and sample time, as one: channels are joined end to end."""

    each: tuple[Recording, ...] = field(default=(), compare=False)

    @classmethod
    def of(cls, each: Sequence[Recording]) -> "Runs":
        """The recordings `each`, in this order."""
        first = each[0]
        channels = {name: np.concatenate([r[name] for r in each]) for name in first.channels}
        source = " + ".join(r.source for r in each)
        return cls(first.dt, channels, first.units, source, tuple(h for r in each for h in r.history), tuple(each))

    @property
    def runs(self) -> tuple[Recording, ...]:
        return self.each

    @property
    def time(self) -> np.ndarray:
        """Seconds from the first sample of the recording in which a sample stands, (samples,)."""
        return np.concatenate([r.time for r in self.each])


def with_channels(recording: Recording, channels: Mapping[str, np.ndarray], units: Mapping[str, str]) -> Recording:
    """The same recordings with these channels (samples,) in the place of theirs."""
    parts = [
        replace(run, channels={name: c[piece] for name, c in channels.items()}, units=units)
        for run, piece in zip(recording.runs, pieces(recording), strict=True)
    ]
    return Runs.of(parts) if isinstance(recording, Runs) else parts[0]


def pieces(recording: Recording) -> list[slice]:
    """The samples of each recording."""
    return cut([r.samples for r in recording.runs])


def cut(lengths: Sequence[int]) -> list[slice]:
    """Slices of these lengths, one after the other."""
    return [slice(a, b) for a, b in pairwise(np.cumsum([0, *lengths]).tolist())]


def along(work: Callable[..., np.ndarray], pieces: Sequence[slice], *signals: np.ndarray) -> np.ndarray:
    """`work` on the signals (samples, ...) of each piece alone, its results joined end to end."""
    if len(pieces) == 1:
        return work(*signals)
    return np.concatenate([work(*(s[piece] for s in signals)) for piece in pieces])


def whole(pieces: Sequence[slice], block: int) -> tuple[int, slice | np.ndarray]:
    """(how many whole blocks of so many samples the pieces hold, the samples in them); each begins with one."""
    if len(pieces) == 1:
        count = (pieces[0].stop - pieces[0].start) // block
        return count, slice(0, count * block)
    counts = [(p.stop - p.start) // block for p in pieces]
    kept = [np.arange(p.start, p.start + n * block) for p, n in zip(pieces, counts, strict=True)]
    return sum(counts), np.concatenate(kept)


def bent(change: np.ndarray, window: int | None) -> np.ndarray:
    """RMS of each channel's change (samples, channels), in windows less a straight line in each."""
    if window:
        count = len(change) // window
        parts = change[: count * window].reshape(count, window, -1).swapaxes(0, 1).reshape(window, -1)
        line = np.vander(np.arange(window), 2)
        change = (parts - line @ np.linalg.lstsq(line, parts)[0]).reshape(window * count, -1)
    return np.sqrt(np.mean(change**2, axis=0))
