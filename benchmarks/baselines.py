"""The strongest linear model on the measured benchmarks.

It is the one that `greygate train` shows beside a network. RMS by test run; the first
samples of a test give its state, as many as `identify` takes, or as are published where those are more.
"""

from dataclasses import replace
from functools import partial
from time import process_time

from greygate.identify.baseline import linear_rms
from greygate.identify.task import FOLDS, LONGEST, SETTLING
from greygate.machines.measured.study import STUDIES

from .shared import stopwatch

TAKES = "a minute"


def judged(name: str) -> dict:
    training, tests = STUDIES[name].runs()
    settle = min(min(map(len, training.values())) // (FOLDS * SETTLING), LONGEST)
    settled = {n: replace(r, initial={}, skip=max(r.skip, settle)) for n, r in tests.items()}
    watch = stopwatch(process_time)
    found = linear_rms(list(training.values()), settled)
    return {"rms": {n: value for n, by in found.items() for value in by.values()}, "cpu_seconds": watch()}


PARTS = {name: partial(judged, name) for name in ("tanks", "ced", "crane", "emps", "mts")}
