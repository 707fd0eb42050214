"""The timing-belt drive's network on its simulated rig: experts are trained alone, joined and scored (thesis 4)."""

from collections.abc import Callable, Mapping
from functools import lru_cache
from itertools import pairwise
from time import monotonic

import numpy as np

from greygate.machines.belt_drive import plant as rig
from greygate.machines.belt_drive.network import DIRECTIONS, REACH, E, X, belt_machine
from greygate.machines.procedure import Procedure
from greygate.models.accuracy import float_error, rms
from greygate.models.families.blocks import feedforward
from greygate.models.families.radial import rbf as radial_fit
from greygate.models.families.recurrent import elman
from greygate.models.network import Layer, Network, Port
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record
from greygate.progress import Progress, silent

SCENARIOS = ("s1", "s2", "s3", "s4")
THESIS = {  # um RMS, tables 4.3 and 4.4
    "fnn": {"overall": (24.1, 25.4, 30.1, 26.8), "major": (12.7, 16.6, 21.8, 18.4), "minor": (30.6, 27.9, 33.0, 28.8)},
    "rbf": {"overall": (25.9, 25.5, 33.8, 27.3), "major": (12.8, 16.4, 21.6, 19.7), "minor": (32.9, 28.2, 37.6, 30.2)},
    "rnn": {"overall": (24.9, 26.1, 34.2, 25.9), "major": (14.8, 19.9, 22.7, 20.3), "minor": (31.0, 28.0, 37.9, 29.7)},
}
NEURONS = {"e": 12, "d": 16, "sp": 16, "b": 2}
SIGNS = dict(zip(DIRECTIONS, (1, -1), strict=True))
ENGAGED = 0.028  # m after a turn, from which on a carriage counts as on its boundary
CROSSED, NEAR = 0.25e-3, 1e-3  # m after a turn, beyond which the carriage moves again; over which its error is averaged
PITCH = 500  # counts, the pitch of the teeth, over which the tooth wave averages out
TOUCH = 4e-6 / E.scale  # an averaged path this near its boundary has reached it
BEYOND = 0.004 * X.scale / E.scale  # slope with which a path continues across its boundary: 4 um per mm


@lru_cache
def records() -> dict[str, Record]:
    """Every motion of the rig: encoder `x` [m]; target `e` [m] by scale and encoder, including the tooth wave."""
    found = {}
    for name in rig.MOTIONS:
        c = rig.record(name).channels
        found[name] = Record({"x": c["x"]}, {"e": c["e"]})
    return found


def legs(x: np.ndarray) -> list[tuple[int, int, str]]:
    """(first sample, one beyond the last, direction) of every motion between turns; x: encoder, (samples,)."""
    moved = np.flatnonzero(np.diff(x)) + 1
    signs = np.sign(x[moved] - x[moved - 1])
    turns = moved[1:][np.diff(signs) != 0]
    starts, ends = [0, *turns], [*turns, len(x)]
    return [(a, b, DIRECTIONS[int(x[b - 1] < x[a])]) for a, b in zip(starts, ends, strict=True)]


def normalised(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """x and e as the experts see them."""
    return X.normalised(record.inputs["x"]), E.normalised(record.targets["e"])


def answer(network: Network, **inputs: np.ndarray) -> np.ndarray:
    """An expert's answer to (N,) values by port: (N,), or (N, size); for one with a memory, its steady state."""
    steps = SETTLED if any(c.delay for c in network.connections) else 1
    return network.run({n: np.repeat(v[:, None], steps, axis=1) for n, v in inputs.items()})["y"][:, -1]


def boundary_data(way: str, every: int = 5) -> Record:
    """x -> e on round trips, where the carriage is engaged; every `every`-th sample in the order of travel."""
    record = records()["boundaries"]
    x, e = normalised(record)
    rows = [
        k
        for a, b, found in legs(record.inputs["x"])
        for k in range(a, b, every)
        if found == way and (a == 0 or abs(x[k] - x[a]) > ENGAGED / X.scale)
    ]
    return Record({"x": x[rows]}, {"y": e[rows]})


def turns(way: str) -> list[tuple[int, int]]:
    """(first sample, one beyond the last) of the training record's paths that begin engaged, in that direction."""
    x = records()["training"].inputs["x"]
    found = legs(x)
    return [(a, b) for (c, _, _), (a, b, w) in pairwise(found) if w == way and abs(x[a] - x[c]) > ENGAGED]


def play_data(way: str) -> Record:
    """x -> jump of e at a turn: from its mean over the last millimetre to its mean over the first beyond `CROSSED`."""
    x, e = normalised(records()["training"])
    at, jumps = [], []
    for a, b in turns(way):
        after, before = (np.abs(x[part] - x[a]) * X.scale for part in (slice(a, b), slice(a - 60, a)))
        beyond = (after > CROSSED) & (after < CROSSED + NEAR)
        at.append(x[a])
        jumps.append(np.mean(e[a:b][beyond]) - np.mean(e[a - 60 : a][before < NEAR]))
    return Record({"x": np.array(at)}, {"y": np.array(jumps)})


def start_error(experts: Mapping[str, Network], way: str, x: np.ndarray) -> np.ndarray:
    """Error at the start of a path of that direction: that of the other boundary, plus the play."""
    other = DIRECTIONS[way == "forward"]
    return answer(experts[f"e_{other}"], x=x) + answer(experts[f"b_{way}"], x=x)


def path_data(experts: Mapping[str, Network], way: str, every: int = 3) -> Record:
    """start, away -> error since the start of a path, up to its boundary and, at a slope, across it.

    Every `every`-th sample in the order of travel.
    """
    x, e = normalised(records()["training"])
    parts = []
    for a, b in turns(way):
        start = x[a - 1 : a]
        away = x[a:b] - start
        keep = (np.abs(away) <= REACH) & (np.abs(away) * X.scale > CROSSED)
        away, error = away[keep], e[a:b][keep]
        bound = answer(experts[f"e_{way}"], x=start + away)
        samples = PITCH * rig.ENCODER / rig.TRAINING_SPEED / rig.SAMPLE_TIME
        width = round(samples)
        left = np.convolve(error - bound, np.ones(width) / width, "valid")
        touching = np.flatnonzero(SIGNS[way] * left < TOUCH)
        end = touching[0] + width // 2 if len(touching) else len(error)
        target = error.copy()
        target[end:] = bound[end:] - BEYOND * (away[end:] - away[end - 1])
        parts.append((np.full(len(away), start[0]), away / REACH, target - start_error(experts, way, start)))
    start, away, target = (np.concatenate(p)[::every] for p in zip(*parts, strict=True))
    anywhere = np.linspace(-1, 1, 200)  # a path begins with the error 0 at any position
    start, away, target = (
        np.append(p, q) for p, q in ((start, anywhere), (away, 0 * anywhere), (target, 0 * anywhere))
    )
    return Record({"start": start, "away": away}, {"y": target})


def start_data(experts: Mapping[str, Network], way: str) -> Record:
    """x, e -> start of the path that leads there (minus x, over `REACH`), and its error there, by the other experts."""
    start, away = (a.ravel() for a in np.meshgrid(np.linspace(-0.92, 0.92, 60), SIGNS[way] * np.linspace(0, 0.8, 40)))
    began = start_error(experts, way, start)
    x, e = start + REACH * away, began + answer(experts[f"d_{way}"], start=start, away=away)
    inside = (np.abs(x) <= 1) & (SIGNS[way] * (e - answer(experts[f"e_{way}"], x=x)) > -0.1)
    return Record({"x": x[inside], "e": e[inside]}, {"y": np.stack([-away, began], 1)[inside]})


RADIAL = {"e": 24, "d": 60}
RECURRENT_EPOCHS = 15
FADING = 0.8
SETTLED = 40  # steps with constant inputs after which the answer of an expert with a memory is read
DECAY = {"e": 1e-3, "d": 1e-2, "sp": 1e-4, "b": 1e-2}


def fnn(part: str, inputs: tuple[str, ...], data: Record, seed: int) -> Network:
    """A tanh network with one hidden layer."""
    network = feedforward(part, inputs, [NEURONS[part]], seed)
    size = 1 if data.targets["y"].ndim == 1 else data.targets["y"].shape[1]
    if size > 1:
        weights = np.random.default_rng(seed).normal(size=(size, NEURONS[part])) * 0.3
        network.modules["out"] = Layer({"hidden1": weights}, np.zeros(size))
        network.outputs = [Port("y", size=size)]
    return train(network, [data], epochs=300, decay=DECAY[part]).network


def rbf(part: str, inputs: tuple[str, ...], data: Record, seed: int) -> Network:
    """A radial network: centres by k-means, output by recursive least squares; for the play, a tanh network."""
    if data.targets["y"].ndim > 1 or part == "b":
        return fnn(part, inputs, data, seed)
    taps = {Port(i): (0,) for i in inputs}
    return radial_fit([data], taps, Port("y"), (), RADIAL[part], seed, name=part)


def rnn(part: str, inputs: tuple[str, ...], data: Record, seed: int) -> Network:
    """An Elman network for `e` and `d`, as in table 4.2; `sp` and `b`, used only where motion turns, have no memory.

    It starts as a tanh network of the same neurons without weights on its past. It learns the rows in the order of
    travel and then backwards, because it runs in both directions in the machine. A neuron's weights on the past sum to
    `FADING` at most, so that two runs with the same inputs converge from any start.
    """
    still = fnn(part, inputs, data, seed)
    if part not in ("e", "d"):
        return still
    network = elman(part, {Port(i): (0,) for i in inputs}, [Port("y")], [NEURONS[part]], seed)
    known = {n.replace("out.", "y_layer."): v for n, v in still.parameters().items()}
    known |= {f"hidden1.{i}_z0": known.pop(f"hidden1.{i}") for i in inputs}
    known["hidden1.hidden1_past"] = np.zeros((NEURONS[part], NEURONS[part]))
    fading = {"hidden1.hidden1_past": (-FADING / NEURONS[part], FADING / NEURONS[part])}
    inputs_, targets = ({n: np.append(v, v[::-1]) for n, v in of.items()} for of in (data.inputs, data.targets))
    start, both = network.with_parameters(known), Record(inputs_, targets)
    return train(start, [both], epochs=RECURRENT_EPOCHS, decay=DECAY[part], bounds=fading).network


KINDS = {"fnn": fnn, "rbf": rbf, "rnn": rnn}
INPUTS = {"e": ("x",), "b": ("x",), "d": ("start", "away"), "sp": ("x", "e")}


def experts(kind: Callable = fnn, progress: Progress = silent, seed: int = 0) -> dict[str, Network]:
    """The eight experts, each trained on its part of the training recordings. kind: what builds and trains one."""
    found: dict[str, Network] = {}
    thinning = {"every": 1} if kind is rnn else {}  # a memory counts steps of the machine
    for part in ("e", "b", "d", "sp"):
        for way in DIRECTIONS:
            data = {
                "e": lambda w: boundary_data(w, **thinning),
                "b": lambda w: play_data(w),
                "d": lambda w: path_data(found, w, **thinning),
                "sp": lambda w: start_data(found, w),
            }[part](way)
            network = kind(part, INPUTS[part], data, seed)
            error = answer(network, **data.inputs) - data.targets["y"]
            um = ", ".join(f"{v:.1f}" for v in np.atleast_1d(1e6 * E.scale * np.sqrt(np.mean(error**2, axis=0))))
            progress(f"{part}_{way}: {len(error)} samples, error {um} um")
            found[f"{part}_{way}"] = network
    return found


def scores(network: Network, names: tuple[str, ...] = SCENARIOS) -> dict[str, tuple[float, ...]]:
    """RMS error in um by scenario: over all, `major` on a boundary, `minor` inside the band, and the worst errors.

    Only the rig knows whether the belt is on a boundary or inside the band; the network does not.
    """
    found: dict[str, list[float]] = {"overall": [], "major": [], "minor": [], "max": [], "min": []}
    for name in names:
        error = 1e6 * float_error(network, records()[name])["e"]
        major = np.abs(rig.record(name)["engaged"]) > 0.999
        for label, part in (("overall", error), ("major", error[major]), ("minor", error[~major])):
            found[label].append(rms(part))
        found["max"].append(float(error.max()))
        found["min"].append(float(error.min()))
    return {label: tuple(values) for label, values in found.items()}


def train_machine(progress: Progress = silent) -> tuple[Network, dict]:
    """Train the experts and join them; return the machine and its figures.

    Figures: `scores` by scenario, also of machines with radial and with recurrent experts; seconds; sizes.
    """
    began = monotonic()
    parts = experts(progress=progress)
    seconds = monotonic() - began
    others = {kind: belt_machine(experts(KINDS[kind], progress)) for kind in ("rbf", "rnn")}
    snn = Procedure(records())
    machine = snn.join(belt_machine(parts))
    return machine, {
        "machine": scores(machine),
        "radial machine": scores(others["rbf"]),
        "recurrent machine": scores(others["rnn"]),
        "choice": scores(machine, ("choice",)),
        "training": scores(machine, ("training",)),
        "thesis": THESIS,
        "neurons": {name: NEURONS[name.split("_")[0]] for name in parts},
        "seconds": seconds,
    }
