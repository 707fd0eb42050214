"""What a network that was built is compared with: the plant's own simulation, and linear models."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from greygate.identify.baseline import linear, of_one
from greygate.identify.expert.task import Task
from greygate.models.accuracy import free_run_rms, rms
from greygate.models.network import Network
from greygate.models.training.record import Record
from greygate.plants.recording import Recording

Rms = dict[str, dict[str, dict[str, float]]]


@dataclass(frozen=True)
class Compared:
    """record: of a recording, by name. nominal: the plant's simulation of each. ends: samples of it that are learnt."""

    task: Task
    record: Callable[[str], Record]
    nominal: Mapping[str, Mapping[str, np.ndarray]]
    recordings: Mapping[str, Recording]
    tests: Mapping[str, Recording]
    ends: Mapping[str, int]


def scores(network: Network, of: Compared) -> Rms:
    """RMS error by who, recording and target, in its unit; of a recording that is learnt in part, its end apart."""
    found: Rms = {"network": {}, "nominal": {}, "linear": {}}
    learnt = [of.record(n).cut(0, end) for n, end in of.ends.items()]
    rivals = {t: linear([of_one(r, t) for r in learnt]) for t in of.task.targets}
    for name, recording in {**of.recordings, **of.tests}.items():
        record = of.record(name)
        spans = {name: (0, of.ends.get(name, len(record)))}
        if name in of.recordings and not of.tests:
            spans[f"{name} end"] = (of.ends[name], len(record))
        for label, (start, stop) in spans.items():
            cut, simulated = record.cut(0, stop, skip=start), of.nominal[name]
            errors = {t: (simulated[t] - recording[t])[start:stop] for t in of.task.targets}
            found["network"][label] = free_run_rms(network, cut)
            found["nominal"][label] = {t: rms(e) for t, e in errors.items()}
            found["linear"][label] = {t: free_run_rms(rival, of_one(cut, t))[t] for t, rival in rivals.items()}
    return found
