"""The asymmetric cylinder beside the thesis (section 5.4).

    filters       the kept network behind the thesis's filters and others, looking ahead and causal
    white_box     the equations (5.2), (5.5) with the data sheet's numbers, in the network's place (fig. 5.18)
    black_boxes   NARX with the taps of (5.14), 10 neurons, and output error from its weights (table 5.6); two starts
    changes       how far training moved the weights

A black box is chosen among its starts by its free run over the last fifth of the training run.
"""

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from greygate.machines import catalog
from greygate.machines.asymmetric_cylinder.plant import SAMPLE_TIME, SENSORS, asymmetric_cylinder
from greygate.machines.asymmetric_cylinder.plant import record as read
from greygate.machines.asymmetric_cylinder.study import (
    ADOPTED,
    SCENARIOS,
    assemble,
    first_machine,
    records,
)
from greygate.models.adaptation import adopt, weight_changes
from greygate.models.families.blocks import nguyen_widrow
from greygate.models.families.regression import noe
from greygate.models.network import Port
from greygate.models.training.levenberg import Outcome, narx_noe, train
from greygate.models.training.record import Record
from greygate.plants.preparation import filtered
from greygate.plants.recording import Recording

from .shared import say
from .valve_cylinder import BAR, TAIL, at_rest, free_run, one_step

TAKES = "not timed"

STARTS = 2
SUBSTEPS = 10  # of a sample, in which the equations are integrated
INPUTS = {Port("u", "V", 5.0): (0, 1), Port("x", "m", 0.05): (0, 1), Port("v", "m/s", 0.2): (0, 1)}
CHAMBERS = {"p_a": Port("p_a", "Pa", 30e5, 40e5), "p_b": Port("p_b", "Pa", 60e5, 75e5)}
NARX_EPOCHS, NOE_EPOCHS = 100, 30
THESIS = {name: 20.0 if name == "x" else 100.0 for name in SENSORS}  # Hz (5.4.2)
JUDGED = ("choice", "v3", "v4", "v5", "v6")


# -- filters ----------------------------------------------------------------------------------------------------------


def filters() -> dict:
    """RMS in bar against the sensors behind the same filters, and against the pressures themselves at that moment."""
    network = catalog.entry("asymmetric_cylinder").network()
    raw = {name: read(name, cutoff=None) for name in JUDGED}
    kinds = {"thesis, looking ahead": (THESIS, "zero"), "thesis, causal": (THESIS, "causal")}
    kinds |= {f"all {f:.0f} Hz": (dict.fromkeys(SENSORS, f), "causal") for f in (20.0, 50.0, 100.0, 140.0, 200.0)}
    found = {}
    for kind, (cutoffs, phase) in kinds.items():
        found[kind] = {}
        for name, recording in raw.items():
            c = behind(recording, cutoffs, phase)
            answer = network.run({n: c[n] for n in ("u", "x")})
            found[kind][name] = {
                against: [float(np.sqrt(np.mean((answer[p] - c[p + end]) ** 2))) / BAR for p in CHAMBERS]
                for against, end in (("sensor", ""), ("pressure", "_true"))
            }
    return found


def behind(recording: Recording, cutoffs: Mapping[str, float], phase: str) -> Recording:
    """Each channel behind its filter; cutoffs: Hz."""
    for name, cutoff in cutoffs.items():
        recording = filtered(recording, "low", cutoff, phase=phase, channels=(name,))
    return recording


# -- white box (fig. 5.18) ---------------------------------------------------------------------------------------------


def white_box() -> dict:
    """RMS in bar by scenario, in free run from the network's own inputs."""
    k = {symbol: p.value for symbol, p in asymmetric_cylinder().parameters.items()}
    p_s = float(np.mean(read("training")["p_s"]))
    found = {}
    for name in SCENARIOS:
        run = records()[name]
        answer = equations(k, p_s, run.inputs["u"], run.inputs["x"], [float(run.targets[p][0]) for p in CHAMBERS])
        found[name] = [float(np.sqrt(np.mean((answer[n] - run.targets[p]) ** 2))) / BAR for n, p in enumerate(CHAMBERS)]
    return found


def equations(k: Mapping[str, float], p_s: float, u: np.ndarray, x: np.ndarray, start: list[float]) -> np.ndarray:
    """Pressures (2, samples) in Pa. p_s: Pa. u: V, x: m, both as measured. start: Pa, of both chambers."""
    p, answer, v = np.array(start), np.empty((2, len(u))), np.diff(x, prepend=x[0]) / SAMPLE_TIME
    area = np.array([k["area_a"], -k["area_b"]])
    for n in range(len(u)):
        volume = np.array([k["v_a0"], k["v_b0"]]) + area * x[n]
        into = np.array([u[n], -u[n]])  # V: a chamber is open to the supply where positive, to the tank elsewhere
        for _ in range(SUBSTEPS):
            drop = np.where(into > 0, p_s - p, p)
            flow = k["k_valve"] * into * np.sign(drop) * np.sqrt(np.abs(drop))
            p = np.maximum(p + SAMPLE_TIME / SUBSTEPS * k["bulk_modulus"] / volume * (flow - area * v[n]), 0.0)
        answer[:, n] = p
    return answer


# -- black boxes (table 5.6) ------------------------------------------------------------------------------------------


def regressors(name: str, chamber: str) -> Record:
    """What (5.14) is made of."""
    r = records()[name]
    speed = np.diff(r.inputs["x"], prepend=r.inputs["x"][0]) / SAMPLE_TIME
    start = {"u": float(r.inputs["u"][0]), "x": float(r.inputs["x"][0]), "v": 0.0}
    return Record({**r.inputs, "v": speed}, {chamber: r.targets[chamber]}, start)


def black_boxes() -> dict:
    """NARX one step ahead in training; output error in free run by scenario; seconds of both."""
    return {chamber: _black_box(chamber, port) for chamber, port in CHAMBERS.items()}


def _black_box(chamber: str, port: Port) -> dict:
    runs = {name: regressors(name, chamber) for name in SCENARIOS}
    training = runs["training"]
    judged = replace(training, skip=int((1 - TAIL) * len(training)))
    starts = []
    for seed in range(STARTS):
        began = time.process_time()
        start = at_rest(nguyen_widrow(noe("black", INPUTS, port, (1, 2), (10,), seed, bypass=False), seed), runs)
        narx = train(start, [training], teacher=True, epochs=NARX_EPOCHS, tail=TAIL, patience=NARX_EPOCHS).network
        between = time.process_time()
        fit = narx_noe(narx, [training], narx_epochs=0, epochs=NOE_EPOCHS, tail=TAIL, patience=NOE_EPOCHS)
        seconds = [between - began, time.process_time() - between]
        diverged = fit.outcome is Outcome.DIVERGED
        found = {"narx": one_step(narx, training), "tail": np.inf if diverged else free_run(fit.network, judged)}
        found |= {name: float(free_run(fit.network, run)) for name, run in runs.items()}
        starts.append(found | {"seconds": seconds})
        say(f"{chamber}, start {seed}: {starts[-1]}")
    return {"chosen": min(starts, key=lambda s: s["tail"]), "starts": starts}


# -- how far training moved the weights (figs. 5.14 to 5.16) ----------------------------------------------------------


def changes() -> dict:
    """Of the weights and biases of a module, in %: the median change, and how many changed by less than a tenth."""
    network = catalog.entry("asymmetric_cylinder").network()
    moved = weight_changes(adopt(assemble(), first_machine(), ADOPTED), network)
    found = {}
    for module in ADOPTED:
        each = np.abs(np.concatenate([v.ravel() for name, v in moved.items() if name.startswith(f"{module}.")]))
        found[module] = {"median": float(np.median(each)), "within a tenth": float(100 * np.mean(each < 10))}
    return found


PARTS = {p.__name__: p for p in (filters, white_box, black_boxes, changes)}
