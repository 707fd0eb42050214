"""How many samples at the start of recordings should not count: `--settle auto`."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from greygate.errors import InputError
from greygate.identify.baseline import linear, of_one
from greygate.models.accuracy import float_error, rms
from greygate.models.network import Network
from greygate.models.training.initial import initialised
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record

AUTO = "auto"
FORGOTTEN = 0.01  # share of a start that is left when it counts as forgotten
PART = 10  # at most one in so many samples of the shortest recording is given up
AWAY = 2.0  # times the error of the linear model: nearer to rest, its own error may be what is seen
VISIBLE = 1e-3  # of an output's deviation: a start nearer to rest is at rest


@dataclass(frozen=True)
class Settling:
    """samples: that should not count. why: a sentence."""

    samples: int
    why: str


@dataclass(frozen=True)
class _Start:
    """How a recording begins. away: from rest, in times of a linear model's error. forgets: that start, in samples."""

    name: str
    output: str
    away: float
    forgets: int


def settling(network: Network, records: Mapping[str, Record]) -> Settling:
    """How many first samples only give the initial state, and why.

    None, where every recording begins at rest as far as a linear model can tell. Else until that model's
    free run has forgotten 99 % of the start: at least the longest delay, at most a tenth of the shortest recording.
    Raises InputError as `Objective`.
    """
    depth = Objective(network, list(records.values())).depth
    most = max(min(map(len, records.values())) // PART, 1)
    starts = [
        s for port in network.outputs for column in range(port.size) for s in _starts(port.name, column, records, most)
    ]
    if not starts:
        return Settling(min(depth, most), "the linear model diverges; the longest delay is left to settle")
    furthest = max(starts, key=lambda s: s.away)
    if furthest.away <= AWAY:
        return Settling(0, "every recording begins at rest, as far as a linear model can tell")
    forgets = max(s.forgets for s in starts if s.away > AWAY)
    samples = min(max(forgets, depth, 1), most)
    limit = f"; a tenth of the shortest recording is the limit: the state is fitted to {samples}" * (forgets > most)
    return Settling(
        samples,
        f"{furthest.output} of {furthest.name} begins {furthest.away:.2g} times the error of a linear model away from "
        f"rest, which forgets 99 % of such a start in {forgets} samples; the longest delay is {depth}{limit}",
    )


def _starts(output: str, column: int, records: Mapping[str, Record], most: int) -> list[_Start]:
    """Of each recording, for one column of an output; none where the linear model diverges."""
    known = {name: replace(of_one(r, output, column), skip=most) for name, r in records.items()}
    model = linear(list(known.values()))
    found = []
    for name, record in known.items():
        try:
            rest, own = (float_error(model, r)[output] for r in (record, initialised(model, record)))
        except InputError:
            return []
        seen = max(rms(own, most), VISIBLE * float(np.std(record.targets[output])))
        trace = np.abs(own - rest)
        left = np.flatnonzero(trace > FORGOTTEN * trace.max())
        found.append(_Start(name, output, float(trace.max()) / seen, int(left[-1]) + 1 if left.size else 0))
    return found
