"""Some stretches of a recording, in which is searched where runs are dear: somebody else's simulator of many joints.

What is found there is fitted to all of the recording, and passes the gates there.
"""

from dataclasses import dataclass

import numpy as np

from greygate.mismatch.places import ANGLES
from greygate.mismatch.runs import Runs
from greygate.mismatch.search import Hypothesis, Search
from greygate.plants.recording import Recording

DEAR = 100_000  # steps of a simulator, in all runs of one linearisation: about half a second of one core
COUNT = 4  # stretches: they shall see what differs along the recording
FEWEST = 3  # windows in a stretch, at least
PHASE = 0.1  # rad: a run that is so far from its reading has lost the phase of what acts several times a turn
MOST = 16  # pieces: the begin of each is fitted, too
SHORTEST = 50  # samples of a piece, at least


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


def pieces(search: Search) -> Runs | None:
    """Pieces of a recording that begin at their readings; None where its free run may be searched.

    An angle that goes round must be followed to a part of a turn to show what acts by it. Pieces are as long as the
    plant follows that, calibrated to all of them. What no sensor shows begins at 0 in each, so all must be shown.
    """
    plant, recording, predict = search.rig.plant, search.final.model.recording, search.rig.predict
    moved = {s: x for s, x in plant.states.items() if s not in plant.shown}
    hidden = moved.keys() - recording.channels.keys() - {x.rate for s, x in moved.items() if s in recording.channels}
    angles = (channel in moved and plant.unit(channel) in ANGLES for channel in predict)
    turning = [i for i, angle in enumerate(angles) if angle and np.ptp(recording[predict[i]]) > 2 * np.pi]
    if search.rig.window or isinstance(recording, Runs) or hidden or not turning:
        return None
    cut, runs, count, length = search, None, 1, recording.samples
    while length >= SHORTEST:
        fit = cut.fit(cut.final, Hypothesis(), {})
        if np.all(np.mean(fit.likelihood.residual(fit.values)[:, turning] ** 2, axis=0) < PHASE**2):
            return runs
        count, length = 2 * count, length // 2
        firsts = np.linspace(0, recording.samples - length, min(count, MOST)).astype(int)
        runs = Runs.of([_part(recording, int(n), length, f" {k}") for k, n in enumerate(firsts)])
        cut = search.over(runs)
    return None


def _part(recording: Recording, first: int, length: int, name: str = "") -> Stretch:
    channels = {name: signal[first : first + length] for name, signal in recording.channels.items()}
    begin = first * recording.dt
    return Stretch(recording.dt, channels, recording.units, recording.source + name, recording.history, begin)
