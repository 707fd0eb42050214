"""The rig of the timing belt: what it does at a turn, and what the machine's errors on it are made of.

turn         one turn in time; closing distances by speed and inertia (fig. 4.6)
repeated     12 round trips of one day: how well a boundary repeats, how far apart the two are
shares       the stored machine on s1 to s4 of rigs that lack one effect, nothing trained anew
black_boxes  the networks of table 4.1, trained for the thesis's epochs: half an hour on one core
elman        what Elman 10 says, for the picture
sizes        experts of the sizes of table 4.2, by its methods
"""

from dataclasses import replace

import numpy as np

from greygate.machines.belt_drive import plant as rig
from greygate.machines.belt_drive import study
from greygate.machines.belt_drive.network import DIRECTIONS, E, X, belt_machine
from greygate.machines.belt_drive.study import ENGAGED, SCENARIOS, legs, records
from greygate.machines.catalog import entry
from greygate.models.accuracy import free_run_rms, rms
from greygate.models.families.blocks import feedforward
from greygate.models.families.radial import rbf as radial_fit
from greygate.models.families.recurrent import elman as elman_network
from greygate.models.families.regression import noe
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import Trained, train
from greygate.models.training.record import Record
from greygate.plants.simulator import simulate
from greygate.progress import Progress, silent

from .descent import gradient_descent
from .shared import say, stopwatch
from .thesis.recurrent import frnn

TAKES = "half an hour"

FINE = 1e-3  # s
SPEEDS = (0.02, 0.04, 0.08)  # m/s
MASSES = (4.0, 8.0, 16.0)  # kg, of the carriage

AS_THESIS = {"fnn": {"e": 8, "d": 60}, "rbf": {"e": 25, "d": 235}}  # table 4.2; the radial ones differ by direction
DESCENT_EPOCHS = 225


def thesis_fnn(part: str, inputs: tuple[str, ...], data: Record, seed: int) -> Network:
    """A tanh network of the thesis's size, by gradient descent for its epochs; `sp` and `b` as `fnn`."""
    if part not in AS_THESIS["fnn"]:
        return study.fnn(part, inputs, data, seed)
    network = feedforward(part, inputs, [AS_THESIS["fnn"][part]], seed)
    return gradient_descent(network, [data], epochs=DESCENT_EPOCHS).network


def thesis_rbf(part: str, inputs: tuple[str, ...], data: Record, seed: int) -> Network:
    """A radial network of the thesis's size; `sp` and `b` as `fnn`."""
    if part not in AS_THESIS["rbf"]:
        return study.fnn(part, inputs, data, seed)
    return radial_fit([data], {Port(i): (0,) for i in inputs}, Port("y"), (), AS_THESIS["rbf"][part], seed, name=part)


def driven(speed: float, **values: float) -> dict[str, np.ndarray]:
    """A turn at 150 mm by steps of 1 ms: out to it and 50 mm back, without the tooth wave. values: of the rig."""
    v = rig.velocity(rig.Motion((0.15, 0.1), speed, day=5, by_hand=False))
    v = np.repeat(v, round(rig.SAMPLE_TIME / FINE))
    plant = rig.belt_drive(tooth=0.0, **values)
    found = simulate(plant, {"v": v, "slip": 0 * v}, sample_time=FINE, channels=(*plant.outputs, "x_carriage"))
    return dict(found.channels)


def closing(at: dict[str, np.ndarray]) -> float:
    """Travel from the turn until every group of teeth is on its other flank, m."""
    turn = int(np.argmax(at["x"]))
    there = np.min([at[f"w{n}"] for n in (1, 2, 3)], axis=0)[turn:] >= 1
    return float(at["x"][turn] - at["x"][turn + int(np.argmax(there))])


def turn() -> dict:
    at = driven(rig.TRAINING_SPEED)
    turned = int(np.argmax(at["x"]))
    free = turned + np.flatnonzero(np.abs(at["gap"][turned:]) < 0.99 * rig.PLAY / 2)
    stands = turned + int(np.argmax(np.abs(at["x_carriage"][turned:] - at["x_carriage"][turned]) > 1e-5))
    return {
        "play_ms": 1e3 * FINE * (len(free) + 1),
        "stands_ms": 1e3 * FINE * (stands - turned),
        "stands_um": 1e6 * float(at["x"][turned] - at["x"][stands]),
        "closing_mm": {f"{1e3 * speed:g} mm/s": 1e3 * closing(driven(speed)) for speed in SPEEDS}
        | {f"{m:g} kg": 1e3 * closing(driven(rig.TRAINING_SPEED, m_carriage=m)) for m in MASSES},
    }


def repeated() -> dict:
    """Of places every millimetre where the belt is engaged, in um."""
    recording = rig.record("boundaries")
    x, e = recording["x"], recording["e"]
    at = np.arange(2 * ENGAGED, rig.TRAVEL - 2 * ENGAGED, 1e-3)
    found: dict[str, list[np.ndarray]] = {"forward": [], "backward": []}
    for a, b, way in legs(x):
        order = np.argsort(x[a:b])
        found[way].append(np.interp(at, x[a:b][order], e[a:b][order]))
    trips = {way: np.array(rows[1:]) for way, rows in found.items()}
    apart = np.mean(trips["backward"], axis=0) - np.mean(trips["forward"], axis=0)
    return {
        "deviation_um": 1e6 * float(np.mean([np.std(rows, axis=0) for rows in trips.values()])),
        "apart_um": 1e6 * float(np.mean(apart)),
        "constant_um": {name: 1e6 * rms(rig.record(name)["e"]) for name in SCENARIOS},
    }


def shares() -> dict:
    """RMS in um over all and on a boundary (major), of s1 to s4."""
    lacking: dict[str, dict] = {
        "as it is": {},
        "15 µm of tooth wave from peak to peak": {"tooth": 7.5e-6},
        "no tooth wave": {"tooth": 0.0},
        "slip that does not vary": {"varying": 0.0},
        "neither": {"tooth": 0.0, "varying": 0.0},
    }
    found = {what: [scored(name, **values) for name in SCENARIOS] for what, values in lacking.items()}
    found["at training's speed"] = [scored(name, rig.TRAINING_SPEED) for name in SCENARIOS]
    return {"um": found}


def scored(name: str, speed: float | None = None, **values: float) -> dict[str, float]:
    motion = rig.MOTIONS[name]
    recording = rig.measure(replace(motion, speed=speed or motion.speed), **values)
    error = 1e6 * (entry("belt_drive").network().run({"x": recording["x"]})["e"] - recording["e"])
    major = np.abs(recording["engaged"]) > 0.999
    return {"overall": rms(error), "major": rms(error[major]), "minor": rms(error[~major])}


BASELINES = ("elman", "noe", "frnn")
BASELINE_STEP = 40  # a baseline reads every 40th sample of the training recording, about the thesis's 1067 samples


def baseline(kind: str, neurons: int, seed: int = 0, epochs: int = 125, seconds: float = 3600.0) -> Trained:
    """A black box of table 4.1 on x(k), x(k-1), x(k-2), trained for the thesis's epochs on its number of samples.

    seconds: time limit, after which training stops with the weights that it has.
    """
    taps = {X: (0, 1, 2)}
    if kind == "noe":
        network = noe("noe", taps, E, (1,), [neurons], seed, bypass=False)
    else:
        network = {"elman": elman_network, "frnn": frnn}[kind](kind, taps, [E], [neurons], seed)
    sparse = thinned(records()["training"])
    return train(network, [sparse], epochs=epochs, decay=1e-6, seconds=seconds)


def thinned(record: Record) -> Record:
    """Every `BASELINE_STEP`-th sample."""
    inputs, targets = ({n: v[::BASELINE_STEP] for n, v in part.items()} for part in (record.inputs, record.targets))
    return Record(inputs, targets)


def baselines(sizes: tuple[int, ...] = (10, 25, 50), progress: Progress = silent) -> dict[str, dict]:
    """RMS in um of each black box: on the samples it was trained on, and on s1 to s4 at the same rate."""
    found = {}
    for kind in BASELINES:
        for neurons in sizes:
            fit = baseline(kind, neurons)
            names = ("training", *SCENARIOS)
            um = [1e6 * free_run_rms(fit.network, thinned(records()[name]))["e"] for name in names]
            done = {"epochs": len(fit.history) - 1, "seconds": fit.seconds}
            found[f"{kind} {neurons}"] = {"um": dict(zip(names, um, strict=True))} | done
            told = " ".join(f"{v:.1f}" for v in um)
            progress(f"{kind} {neurons}: {told} um, {done['epochs']} epochs, {fit.seconds:.0f} s")
    return found


def black_boxes() -> dict:
    """Table 4.1: RMS in um in training and on s1 to s4, epochs, seconds."""
    return {"found": baselines(progress=say)}


def elman() -> dict:
    """Figures 4.8 and 4.9: the error in um and what an Elman network of 10 neurons says, in training and on s2."""
    network = baseline("elman", 10).network
    found = {}
    for name in ("training", "s2"):
        record = thinned(study.records()[name])
        told = network.run(record.inputs)["e"]
        found[name] = {"true": _um(record.targets["e"]), "told": _um(told)}
    return {"period": BASELINE_STEP * rig.SAMPLE_TIME, "um": found}


def _um(values: np.ndarray) -> list[float]:
    return [round(1e6 * float(v), 1) for v in values]


def sizes() -> dict:
    """Table 4.2: experts of the thesis's sizes, by its methods: errors in training, and on s1 to s4."""
    found = {}
    for name, kind in (("fnn", thesis_fnn), ("rbf", thesis_rbf)):
        watch = stopwatch()
        parts, errors = study.experts(kind, say), {}
        seconds = watch()
        for way in DIRECTIONS:
            data = {"e": study.boundary_data(way), "d": study.path_data(parts, way)}
            for part, record in data.items():
                missed = study.answer(parts[f"{part}_{way}"], **record.inputs) - record.targets["y"]
                errors[f"{part}_{way}"] = 1e6 * E.scale * rms(missed)
        found[name] = {"training": errors, "seconds": seconds}
        found[name]["scores"] = study.scores(belt_machine(parts))
    return {"found": found}


PARTS = {p.__name__: p for p in (turn, repeated, shares, black_boxes, elman, sizes)}
