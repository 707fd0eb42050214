"""The strongest linear model on the measured benchmarks: `python benchmarks/baselines.py [tanks ced emps crane mts]`.

It is the one that `greygate train` shows beside a network. Kept in results/baselines.json, RMS by test run; the first
samples of a test give its state, as many as `identify` takes, or as are published where those are more.
"""

import sys
from dataclasses import replace
from time import process_time

from made import keep

from greygate.identify.baseline import linear_rms
from greygate.identify.task import FOLDS, LONGEST, SETTLING
from greygate.machines.measured.study import STUDIES


def main(name: str) -> None:
    training, tests = STUDIES[name].runs()
    settle = min(min(map(len, training.values())) // (FOLDS * SETTLING), LONGEST)
    judged = {n: replace(r, initial={}, skip=max(r.skip, settle)) for n, r in tests.items()}
    began = process_time()
    found = linear_rms(list(training.values()), judged)
    rms = {n: value for n, by in found.items() for value in by.values()}
    measures = ["identify/baseline.py", "identify", "models/training"]
    keep("baselines", name, {"rms": rms, "cpu_seconds": process_time() - began}, measures)
    print(name, rms, flush=True)


if __name__ == "__main__":
    for part in sys.argv[1:] or ("tanks", "ced", "crane", "emps", "mts"):
        main(part)
