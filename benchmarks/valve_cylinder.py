"""The valve-controlled cylinder beside the thesis (section 5.3).

    black_boxes   NARX and NOE with the spool position (5.14), and with the valve's voltage in its place; three starts
    axes          the same black boxes on differences and on principal components of the taps
    structured    our network, with the thesis's speed, and with its speed and spool, by the same trainer
    spread        both tasks over 20 scenarios drawn at random: trained on each, and the kept network judged on each
    load          correlation of the external force with the error (5.18), and the error map (fig. 5.10)
    architectures, laps    of flow networks (valve_flow.py)
    linearised    the analysis of (5.19) and (5.20) (valve_linear.py)

A black box is chosen among its starts by its free run over the last fifth of the training run; v1 and v2 choose
nothing.
"""

import time
from dataclasses import replace

import numpy as np

from greygate.machines import catalog
from greygate.machines.valve_cylinder.plant import valve_cylinder
from greygate.machines.valve_cylinder.scenarios import HOLD, LEVEL, SAMPLE_TIME, SAMPLES, measure, scenario
from greygate.machines.valve_cylinder.study import DIVIDER_SEED, FLOW_SEED, assemble, record, tuning
from greygate.models.accuracy import free_run_rms
from greygate.models.families.blocks import fit_divider, fit_flow, nguyen_widrow
from greygate.models.families.regression import noe
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import Outcome, narx_noe, train
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record
from greygate.plants.excitation import prms

from .shared import say
from .thesis.axes import KINDS, on_axes
from .valve_flow import architectures, laps
from .valve_linear import linearised

TAKES = "not timed"
BAR = 1e5
TAIL = 0.2
STARTS = 3
DRAWN = 20  # scenarios
REACH = 0.0495  # m, that the piston may come from the centre: as far as it does in the training run that was picked
DRIVES = {"spool": Port("u", "m", 1.0), "voltage": Port("v_c", "V", 1.0)}
MOTION = {Port("x", "m", 0.05): (0, 1), Port("v", "m/s", 0.3): (0, 1)}
CHAMBERS = {"p_a": Port("p_a", "Pa", 50 * BAR, 100 * BAR), "p_b": Port("p_b", "Pa", 50 * BAR, 100 * BAR)}
INPUTS = {"ours": {}, "one_difference": {"taps": 1}, "thesis": {"taps": 1, "mean": False}}  # of the structured network
AMPLITUDES, FREQUENCIES = (500, 1000, 2000, 3000), (0.5, 1, 2, 5, 10)  # N, Hz


# -- black boxes (table 5.2) ------------------------------------------------------------------------------------------


def regressors(name: str, drive: Port, chamber: str) -> Record:
    """What (5.14) is made of."""
    c = scenario(name).channels
    speed = np.diff(c["x"], prepend=c["x"][0]) / SAMPLE_TIME
    start = {drive.name: float(c[drive.name][0]), "x": float(c["x"][0]), "v": 0.0}
    return Record({drive.name: c[drive.name], "x": c["x"], "v": speed}, {chamber: c[chamber]}, start)


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


def black_boxes() -> dict:
    """NARX, and output error from its weights, 10 neurons; every start."""
    return {what: {chamber: _black_box(drive, chamber) for chamber in CHAMBERS} for what, drive in DRIVES.items()}


def axes() -> dict:
    """The same with the spool position, on differences and on principal components of the taps."""
    spool = DRIVES["spool"]
    return {kind: {chamber: _black_box(spool, chamber, kind) for chamber in CHAMBERS} for kind in KINDS}


def _black_box(drive: Port, chamber: str, kind: str = "") -> dict:
    """kind: of the axes in place of taps."""
    runs = {name: regressors(name, drive, chamber) for name in SAMPLES}
    drive = replace(drive, scale=float(np.abs(runs["training"].inputs[drive.name]).max()))
    training = runs["training"]
    judged = replace(training, skip=int((1 - TAIL) * len(training)))
    starts = []
    for seed in range(STARTS):
        began = time.perf_counter()
        network = noe("black", {drive: (0, 1), **MOTION}, CHAMBERS[chamber], (1, 2), (10,), seed, bypass=False)
        if kind:
            network = on_axes(network, training.cut(0, judged.skip), kind)
        start = at_rest(nguyen_widrow(network, seed), runs)
        narx = train(start, [training], teacher=True, epochs=300, tail=TAIL, patience=300).network
        fit = narx_noe(narx, [training], narx_epochs=0, epochs=100, tail=TAIL, patience=100)
        diverged = fit.outcome is Outcome.DIVERGED
        found = {"narx": one_step(narx, training), "tail": np.inf if diverged else free_run(fit.network, judged)}
        found |= {name: free_run(fit.network, run) for name, run in runs.items()}
        starts.append({k: float(v) for k, v in found.items()} | {"seconds": time.perf_counter() - began})
        say(f"{drive.name} {chamber}, start {seed}: {starts[-1]}")
    return {"chosen": min(starts, key=lambda s: s["tail"]), "starts": starts}


# -- the structured network -------------------------------------------------------------------------------------------


def errors(network: Network, run: Record) -> list[float]:
    """RMS in bar, chambers A and B."""
    return [value / BAR for value in free_run_rms(network, run).values()]


def parts() -> tuple[Network, Network]:
    return fit_flow(FLOW_SEED).network, fit_divider(DIVIDER_SEED).network


def structured() -> dict:
    """RMS in bar of every scenario, as assembled and as trained."""
    runs = {name: record(scenario(name)) for name in SAMPLES}
    flow, divider = parts()
    found = {}
    for name, inputs in INPUTS.items():
        before = assemble(flow, divider, **inputs)
        after = train(before, [runs["training"]], **tuning()).network
        steps = {"assembled": before, "trained": after}
        found[name] = {step: {n: errors(net, run) for n, run in runs.items()} for step, net in steps.items()}
    return found


def spread() -> dict:
    """Median, worst and the picked one's rank among scenarios drawn at random; each of them."""
    flow, divider = parts()
    kept = catalog.entry("valve_cylinder").network()
    validation = {name: record(scenario(name)) for name in ("v1", "v2")}
    trained = []
    for seed in drawn(SAMPLES["training"]):
        run = scenario("training", seed)
        network = train(assemble(flow, divider, run), [record(run)], **tuning()).network
        every = {"training": record(run), **validation}
        trained.append({"seed": seed} | {name: errors(network, r) for name, r in every.items()})
        say(trained[-1])
    judged = {
        name: [{"seed": s, name: errors(kept, record(scenario(name, s)))} for s in drawn(SAMPLES[name])]
        for name in validation
    }
    picked = {name: errors(kept, record(scenario(name))) for name in SAMPLES}
    return {
        "picked": picked,
        "trained_on": {name: ranked([t[name] for t in trained], picked[name]) for name in SAMPLES} | {"each": trained},
        "judged_on": {n: ranked([e[n] for e in each], picked[n]) for n, each in judged.items()} | {"each": judged},
    }


def ranked(rows: list[list[float]], picked: list[float]) -> dict:
    """Of each column: the median and the worst of the draws, and how many of them are better than the picked."""
    values = np.array(rows)
    return {
        "median": np.median(values, axis=0).tolist(),
        "worst": values.max(axis=0).tolist(),
        "better": (values < np.array(picked)).sum(axis=0).tolist(),
        "of": len(rows),
    }


def drawn(samples: int) -> list[int]:
    """The first seeds whose piston stays off its stops, by the steady gain from voltage to speed."""
    training = scenario("training").channels
    path = np.cumsum(training["v_c"])
    gain = np.polyfit(path, training["x_true"], 1)[0]
    paths = ((seed, gain * np.cumsum(prms(samples, -LEVEL, LEVEL, HOLD, seed))) for seed in range(10 * DRAWN))
    return [seed for seed, x in paths if np.abs(x).max() < REACH][:DRAWN]


# -- load ------------------------------------------------------------------------------------------------------------


def load() -> dict:
    """(5.18), v2: correlation of force and error. Fig. 5.10: RMS in bar under a sine of force, v1's voltage."""
    network, c = catalog.entry("valve_cylinder").network(), scenario("v2").channels
    answer = network.run({n: c[n] for n in ("v_c", "x")})
    off = {n: answer[n] - c[n] for n in ("p_a", "p_b")}
    v_c = scenario("v1")["v_c"]
    t = SAMPLE_TIME * np.arange(len(v_c))

    def under(amplitude: float, frequency: float) -> list[float]:
        return errors(network, record(measure(valve_cylinder(), v_c, amplitude * np.sin(2 * np.pi * frequency * t))))

    return {
        "correlation": [float(np.corrcoef(c["f_ext"], e)[0, 1]) for e in off.values()],
        "of_supply": [float(np.corrcoef(c["p_s"], e)[0, 1]) for e in off.values()],
        "frequencies": FREQUENCIES,
        "map": {str(n): [under(n, f) for f in FREQUENCIES] for n in AMPLITUDES},
    }


PARTS = {p.__name__: p for p in (black_boxes, axes, structured, spread, load, architectures, laps, linearised)}
