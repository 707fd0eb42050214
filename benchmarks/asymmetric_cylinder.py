"""Black boxes on the second machine beside the thesis (table 5.6): a table of docs/asymmetric_cylinder.md.

python benchmarks/asymmetric_cylinder.py [SEEDS] : NARX with the taps of (5.14) and 10 neurons, output error from its
weights; of SEEDS starts the one with the lowest free run over the last fifth of the training run. RMS error in bar.
"""

import sys
import time
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits
from valve_cylinder import TAIL, at_rest, free_run, one_step

from greygate.machines.asymmetric_cylinder.plant import SAMPLE_TIME
from greygate.machines.asymmetric_cylinder.study import SCENARIOS, records
from greygate.models.families.blocks import nguyen_widrow
from greygate.models.families.regression import noe
from greygate.models.network import Port
from greygate.models.training.levenberg import Outcome, narx_noe, train
from greygate.models.training.record import Record

INPUTS = {Port("u", "V", 5.0): (0, 1), Port("x", "m", 0.05): (0, 1), Port("v", "m/s", 0.2): (0, 1)}
CHAMBERS = {"p_a": Port("p_a", "Pa", 30e5, 40e5), "p_b": Port("p_b", "Pa", 60e5, 75e5)}
NARX_EPOCHS, NOE_EPOCHS = 100, 30


def record(name: str, chamber: str) -> Record:
    r = records()[name]
    speed = np.diff(r.inputs["x"], prepend=r.inputs["x"][0]) / SAMPLE_TIME
    start = {"u": float(r.inputs["u"][0]), "x": float(r.inputs["x"][0]), "v": 0.0}
    return Record({**r.inputs, "v": speed}, {chamber: r.targets[chamber]}, start)


def black_boxes(seeds: int) -> None:
    print(
        "| chamber | NARX, training | " + " | ".join(f"NOE, {name}" for name in SCENARIOS) + " | seconds, NARX, NOE |"
    )
    print("| --- |" + " --- |" * (len(SCENARIOS) + 2), flush=True)
    for chamber, port in CHAMBERS.items():
        runs = {name: record(name, chamber) for name in SCENARIOS}
        training = runs["training"]
        judged, best = replace(training, skip=int((1 - TAIL) * len(training))), None
        for seed in range(seeds):
            began = time.process_time()
            start = at_rest(nguyen_widrow(noe("black", INPUTS, port, (1, 2), (10,), seed, bypass=False), seed), runs)
            narx = train(start, [training], teacher=True, epochs=NARX_EPOCHS, tail=TAIL, patience=NARX_EPOCHS).network
            between = time.process_time()
            fit = narx_noe(narx, [training], narx_epochs=0, epochs=NOE_EPOCHS, tail=TAIL, patience=NOE_EPOCHS)
            seconds = between - began, time.process_time() - between
            found = free_run(fit.network, judged) if fit.outcome is not Outcome.DIVERGED else np.inf
            print(f"{chamber}, seed {seed}: {found:.3g} bar on the tail, {fit.outcome.value}", file=sys.stderr)
            if best is None or found < best[0]:
                best = found, narx, fit.network, seconds
        _, narx, network, seconds = best
        cells = [f"{one_step(narx, training):.3f}"] + [f"{free_run(network, run):.2f}" for run in runs.values()]
        print(f"| {chamber} | " + " | ".join([*cells, ", ".join(f"{s:.0f}" for s in seconds)]) + " |", flush=True)


if __name__ == "__main__":
    with threadpool_limits(1, "blas"):
        black_boxes(int(sys.argv[1]) if len(sys.argv) > 1 else 3)
