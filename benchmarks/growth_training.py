"""How the time of a training step grows with samples and with weights, beside scipy and jax-sysid.

A NOE of one layer learns a lag behind a curve in free run: 10^3 to 10^6 samples at 61 weights, 13 to 9,997 weights at
10^4 samples. A step is one of Levenberg-Marquardt (greygate, scipy), or one evaluation of loss and gradient, by which
first-order methods step (greygate, jax-sysid). CPU seconds of one thread, the mean over SECONDS of steps, compilation
left out; no step within LIMIT seconds: nothing. Draws
docs/pictures/growth_training.svg.
"""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
from pictures import FOLDER, panel, picture

from greygate.files import replacing
from greygate.pages.figures import Curve
from greygate.plants.excitation import prms

from . import shared
from .made import keep, stored
from .shared import scratch
from .training import HERE, ONE_THREAD, OURS

TAKES = "not timed"
SAMPLES, WEIGHTS = (1_000, 10_000, 100_000, 1_000_000), (13, 97, 997, 9_997)
MIDDLE = 10_000  # samples beside growing weights
NEURONS = 10  # beside growing samples
TAPS = (1, 2)  # delays of input and output
OF_NEURON = 2 * len(TAPS) + 2  # weights: its taps, its bias, its part in the sum
TRAINERS = ("greygate", "scipy", "greygate,gradient", "jax-sysid,gradient")
SECONDS, LIMIT = 5.0, 200.0
SEED = 0
TURNS = 0.5  # of a sum's standard deviation: tanh bends, and the free run is stable
NAME = "growth_training"


def case(samples: int, neurons: int) -> dict[str, np.ndarray]:
    """What `trainers.py` reads."""
    rng, u = np.random.default_rng(SEED), prms(samples, -1.0, 1.0, (5, 40), SEED)
    y, last = np.empty(samples), 0.0
    for k, drive in enumerate(np.tanh(2 * u)):
        y[k] = last = 0.95 * last + 0.05 * drive
    sizes = [2 * len(TAPS), neurons, 1]
    theta = [
        part
        for wide, high in pairwise(sizes)
        for part in (TURNS * rng.normal(size=high * wide) / wide**0.5, np.zeros(high))
    ]
    options = {"inputs": TAPS, "feedback": TAPS, "sizes": sizes, "goal": 0.0, "cap": SECONDS}
    return {"u": u, "y": y, "starts": np.concatenate(theta)[None], **{n: np.array(v) for n, v in options.items()}}


def step(trainer: str, given: dict[str, np.ndarray], peers: Path) -> float | None:
    """CPU seconds of a step; None where there was none in time."""
    python = sys.executable if trainer.partition(",")[0] in OURS else peers
    with scratch() as folder:
        path = folder / "case.npz"
        np.savez(path, **given)
        command = [python, str(HERE / "trainers.py"), trainer, str(path)]
        try:
            done = subprocess.run(command, env=os.environ | ONE_THREAD, capture_output=True, text=True, timeout=LIMIT)
        except subprocess.TimeoutExpired:
            return None
    if done.returncode:
        print(f"{trainer}: {done.stderr[-500:]}", file=sys.stderr)
        return None
    found = json.loads(done.stdout.splitlines()[-1])
    return found["cpu"] / found["iterations"] if found["iterations"] else None


def exponent(sizes: Sequence[int], seconds: Sequence[float | None]) -> float | None:
    """The power of the size with which the seconds grow, by least squares over the last three that there are."""
    known = [(n, s) for n, s in zip(sizes, seconds, strict=True) if s is not None][-3:]
    if len(known) < 2:
        return None
    return round(float(np.polyfit(*np.log(np.array(known)).T, 1)[0]), 2)


def draw() -> None:
    """The picture, from what is stored."""
    found = stored(NAME)
    kinds = dict(zip(TRAINERS, ("fixed", "mark", "cost", "reference"), strict=True))
    panels = []
    for part, x, beside in (("samples", "samples", "61 weights"), ("weights", "weights", "10,000 samples")):
        lines = []
        for trainer, kind in kinds.items():
            known = [(n, s) for n, s in zip(found[part]["sizes"], found[part]["seconds"][trainer], strict=True) if s]
            if known:
                lines.append(Curve(*map(list, zip(*known, strict=True)), kind))
        panels.append((f"a step at {beside}", panel(lines, x, "CPU seconds", x_log=True, y_log=True)))
    names = ("greygate, LM", "scipy, LM", "greygate, gradient", "jax-sysid, gradient")
    with replacing(FOLDER / f"{NAME}.svg") as path:
        path.write_text(picture(panels, [(kinds[t], n) for t, n in zip(TRAINERS, names, strict=True)]))


def main(
    *part: Annotated[str, ("samples", "weights")],
    trainers: Sequence[str] = TRAINERS,
    peers: shared.Peers = shared.PEERS,
    only_draw: Annotated[bool, "only draw what is stored"] = False,
) -> None:
    sweeps = {
        "samples": [(n, n, NEURONS) for n in SAMPLES],
        "weights": [(n, MIDDLE, (n - 1) // OF_NEURON) for n in WEIGHTS],
    }
    for name in () if only_draw else part or sweeps:
        points = sweeps[name]
        sizes = [size for size, *_ in points]
        seconds: dict[str, list[float | None]] = {trainer: [] for trainer in trainers}
        for size, samples, neurons in points:
            given = case(samples, neurons)
            for trainer, times in seconds.items():
                # what took too long once takes longer still
                times.append(None if times and times[-1] is None else step(trainer, given, peers))
                print(f"{size} {name}, {trainer}: {times[-1]} s", flush=True)
        before = stored(NAME).get(name, {}).get("seconds", {})
        seconds = {trainer: (before | seconds)[trainer] for trainer in TRAINERS if trainer in before | seconds}
        powers = {trainer: exponent(sizes, times) for trainer, times in seconds.items()}
        keep(NAME, name, {"sizes": sizes, "seconds": seconds, "exponents": powers})
    draw()
