"""Some stretches of a recording, in which is searched where runs are dear: somebody else's simulator of many joints.

What is found there is fitted to all of the recording, and passes the gates there.
"""

from dataclasses import dataclass

import numpy as np

from greygate.mismatch.runs import Runs
from greygate.mismatch.search import Hypothesis, Search
from greygate.plants.recording import Recording

DEAR = 100_000  # steps of a simulator, in all runs of one linearisation: about half a second of one core
COUNT = 4  # stretches: they shall see what differs along the recording
FEWEST = 3  # windows in a stretch, at least


@dataclass(frozen=True)
class Stretch(Recording):
    """A part of a recording. begin: s, from the first sample of the whole."""

    begin: float = 0.0

    @property
    def time(self) -> np.ndarray:
        """Seconds from the first sample of the whole (samples,)."""
        return self.begin + np.arange(self.samples) * self.dt


def stretches(search: Search, times: int = 1) -> Runs | None:
    """Evenly spread stretches of the recording of a search, None where all of it may be searched.

    times: how many times what DEAR allows may be searched.
    """
    model = search.final.model
    outside, recording = model.plant.outside, model.recording
    if outside is None or not outside.steps or not model.window or isinstance(recording, Runs):
        return None
    columns = len(search.unknowns(Hypothesis())) + len(model.locals)
    window = max(search.final.block, search.screen.block)
    length = max(int(times * DEAR / (columns * model.steps * COUNT)), FEWEST * window)
    if 2 * COUNT * length > recording.samples:
        return None
    firsts = np.linspace(0, recording.samples - length, COUNT).astype(int)
    return Runs.of([_part(recording, int(first), length) for first in firsts])


def _part(recording: Recording, first: int, length: int) -> Stretch:
    channels = {name: signal[first : first + length] for name, signal in recording.channels.items()}
    begin = first * recording.dt
    return Stretch(recording.dt, channels, recording.units, recording.source, recording.history, begin)
