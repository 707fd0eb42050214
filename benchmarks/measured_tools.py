"""Beside the diagnoses of measured recordings, what models that name nothing make of the same residual.

Each of `concealed_bench.baselines` learns what the calibrated plant leaves of identify.csv from inputs and simulated
outputs, and corrects the held-out recordings with it. Of greygate the stored diagnoses count (`measured_mismatch`).
"""

import json
from typing import Annotated

import numpy as np

from greygate.mismatch.rig import load
from greygate.mismatch.search import Hypothesis, Search
from greygate.mismatch.several import by_rule, modelled

from .concealed_bench.baselines import MODELS, learned
from .made import keep, place, stored
from .measured_mismatch import MAKERS, make
from .shared import scratch, stopwatch

TAKES = "two minutes"
NEEDS = ("pysindy", "sklearn")
RIGS = tuple(name for name in MAKERS if not name.endswith("-mjcf"))


def signals(model, simulated: np.ndarray) -> np.ndarray:
    """What a residual model reads (samples, signals): inputs, simulated outputs, their rates; time in a window."""
    now = np.column_stack([*(model.recording[name] for name in model.rig.inputs), simulated])
    rates = np.concatenate([np.gradient(now[piece], axis=0) for piece in model.pieces])
    known = np.column_stack([now, rates])
    if not model.rig.window:
        return known
    window = model.rig.window
    since = np.concatenate([np.arange(p.stop - p.start) % window / window for p in model.pieces])[:, None]
    return np.column_stack([known, since, known * since])  # within a window the error grows from 0


def judged(name: str) -> dict:
    """Share of the held-out squared error of the calibrated plant that goes, in the mean over channels, by model."""
    with scratch() as folder:
        rig = load(make(name, folder / name))
        recording, held = rig.to_explain(), rig.held_out()
        search = Search(rig, recording, {})
        values = search.fit(search.final, Hypothesis(), {}).values
        seen, unseen = modelled(rig, recording, {}), modelled(rig, held, {})
    before, after = by_rule(seen, values)[0], by_rule(unseen, values, rig.settle)
    found = {model: held_out(learners, (seen, before), (unseen, *after)) for model, learners in MODELS.items()}
    said = json.loads((place("measured_mismatch") / f"{name}.json").read_text())["fit"]["holdout"]
    ratio = {c: rms["corrected"] / rms["calibrated"] for c, rms in said.items()}
    own = {"removed": 1.0 - float(np.mean([r**2 for r in ratio.values()])), "worse": max(ratio.values()) > 1.0}
    return {"greygate": own, **found}


def held_out(learners, seen: tuple, unseen: tuple) -> dict:
    """removed: as in `judged`. worse: whether a channel is. seconds: to learn and to correct."""
    model, simulated = seen
    other, predicted, counts = unseen
    watch, known, new = stopwatch(), signals(model, simulated), signals(other, predicted)
    centre, spread = known.mean(axis=0), known.std(axis=0)
    spread[spread == 0] = 1.0
    new = (np.clip(new, known.min(axis=0), known.max(axis=0)) - centre) / spread
    ratios = []
    for i in range(simulated.shape[1]):
        error, left = model.target[:, i] - simulated[:, i], other.target[:, i] - predicted[:, i]
        size = float(error.std()) or 1.0
        correct = learned(learners, (known - centre) / spread, error / size)
        better = left - size * correct(new)
        ratios.append(float(np.mean(better[counts] ** 2) / np.mean(left[counts] ** 2)))
    return {"removed": 1.0 - float(np.mean(ratios)), "worse": max(ratios) > 1.0, "seconds": watch(2)}


def main(*names: Annotated[str, RIGS]) -> None:
    for name in names or RIGS:
        keep("measured_tools", name, judged(name))
    kept = {name: row for name, row in stored("measured_tools").items() if name in RIGS}
    tools = ("greygate", *MODELS)
    print(f"{'share removed':14}" + "".join(f"{tool:>11}" for tool in tools))
    for name, row in kept.items():
        print(f"{name:14}" + "".join(f"{row[t]['removed']:10.2f}{'w' if row[t]['worse'] else ' '}" for t in tools))
    for tool in tools:
        part = [row[tool] for row in kept.values()]
        worse = sum(found["worse"] for found in part)
        print(
            f"{tool}: median {np.median([f['removed'] for f in part]):.2f}, a channel worse in {worse} of {len(part)}"
        )
