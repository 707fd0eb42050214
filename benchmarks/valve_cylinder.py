"""The valve-controlled cylinder beside the thesis (section 5.3): black boxes, correlation with the load, error map.

python benchmarks/valve_cylinder.py [SEEDS] : the tables of docs/valve_cylinder.md. Black boxes are chosen among SEEDS
starts by their free run over the last fifth of the training run; v1 and v2 choose nothing.
"""

import sys
import time
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from greygate.machines import catalog
from greygate.machines.valve_cylinder.plant import valve_cylinder
from greygate.machines.valve_cylinder.scenarios import SAMPLE_TIME, SAMPLES, measure, scenario
from greygate.models.accuracy import free_run_rms
from greygate.models.families.blocks import nguyen_widrow
from greygate.models.families.regression import noe
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import Outcome, narx_noe, train
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record

BAR = 1e5
TAIL = 0.2
INPUTS = {Port("v_c", "V", 1.0): (0, 1), Port("x", "m", 0.05): (0, 1), Port("v", "m/s", 0.3): (0, 1)}  # (5.14)
CHAMBERS = {"p_a": Port("p_a", "Pa", 50 * BAR, 100 * BAR), "p_b": Port("p_b", "Pa", 50 * BAR, 100 * BAR)}
AMPLITUDES, FREQUENCIES = (500, 1000, 2000, 3000), (0.5, 1, 2, 5, 10)  # N, Hz


def record(name: str, chamber: str) -> Record:
    c = scenario(name).channels
    speed = np.diff(c["x"], prepend=c["x"][0]) / SAMPLE_TIME
    start = {"v_c": float(c["v_c"][0]), "x": float(c["x"][0]), "v": 0.0}
    return Record({"v_c": c["v_c"], "x": c["x"], "v": speed}, {chamber: c[chamber]}, start)


def at_rest(network: Network, runs: dict[str, Record]) -> Network:
    """The network whose feedback starts at the pressure of rest."""
    port = network.outputs[0]
    level = port.normalised(float(runs["training"].targets[port.name][0]))
    modules = {n: replace(m, initial=level) if n == "sum" else m for n, m in network.modules.items()}
    return replace(network, modules=modules)


def free_run(network: Network, run: Record) -> float:
    return free_run_rms(network, run)[network.outputs[0].name] / BAR


def one_step(network: Network, run: Record) -> float:
    objective = Objective(network, [run], teacher=True)
    return network.outputs[0].scale / BAR * float(np.sqrt(objective.squares(objective.theta) / objective.samples))


def black_boxes(seeds: int) -> None:
    """Table 5.2: NARX, and output error from its weights, 10 neurons."""
    print("| chamber | NARX, training | NOE, training | NOE, v1 | NOE, v2 | seconds a start | seed |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for chamber, port in CHAMBERS.items():
        runs = {name: record(name, chamber) for name in SAMPLES}
        training = runs["training"]
        judged = replace(training, skip=int((1 - TAIL) * len(training)))
        best = None
        for seed in range(seeds):
            began = time.perf_counter()
            start = at_rest(nguyen_widrow(noe("black", INPUTS, port, (1, 2), (10,), seed, bypass=False), seed), runs)
            narx = train(start, [training], teacher=True, epochs=300, tail=TAIL, patience=300).network
            fit = narx_noe(narx, [training], narx_epochs=0, epochs=100, tail=TAIL, patience=100)
            found = free_run(fit.network, judged) if fit.outcome is not Outcome.DIVERGED else np.inf
            print(f"{chamber}, seed {seed}: {found:.3g} bar on the tail, {fit.outcome.value}", file=sys.stderr)
            if best is None or found < best[0]:
                best = found, seed, narx, fit.network, time.perf_counter() - began
        _, seed, narx, network, seconds = best
        free = " | ".join(f"{free_run(network, runs[name]):.3f}" for name in ("training", "v1", "v2"))
        print(f"| {chamber} | {one_step(narx, training):.3f} | {free} | {seconds:.1f} | {seed} |", flush=True)


def correlations(network: Network) -> None:
    """(5.18): of the external force with the error, on v2."""
    c = scenario("v2").channels
    answer = network.run({n: c[n] for n in ("v_c", "x")})
    found = {n: np.corrcoef(c["f_ext"], answer[n] - c[n])[0, 1] for n in ("p_a", "p_b")}
    print("\ncorrelation with the force, v2: " + ", ".join(f"{n} {r:.3f}" for n, r in found.items()))


def error_map(network: Network) -> None:
    """Fig. 5.10: RMS error over the amplitude and frequency of a sine of force, v1's voltage, bar."""
    v_c = scenario("v1")["v_c"]
    t = SAMPLE_TIME * np.arange(len(v_c))
    print("\n| N | " + " | ".join(f"{f:g} Hz" for f in FREQUENCIES) + " |")
    print("| --- |" + " --- |" * len(FREQUENCIES))
    for amplitude in AMPLITUDES:
        cells = []
        for frequency in FREQUENCIES:
            c = measure(valve_cylinder(), v_c, amplitude * np.sin(2 * np.pi * frequency * t)).channels
            run = Record({n: c[n] for n in ("v_c", "x")}, {n: c[n] for n in ("p_a", "p_b")})
            cells.append(" / ".join(f"{v / BAR:.2f}" for v in free_run_rms(network, run).values()))
        print(f"| {amplitude} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    with threadpool_limits(1, "blas"):
        srnn = catalog.entry("valve_cylinder").network()
        correlations(srnn)
        error_map(srnn)
        black_boxes(int(sys.argv[1]) if len(sys.argv) > 1 else 4)
