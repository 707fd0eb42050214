"""The last word has the held-out recording: a correction that errs more there than the calibrated plant is not worn.

What passes every gate on identify.csv may go astray in another motion, by a knee that a fast one does not show, or by
parameters that went too far beside a name. Nothing is fitted to the held-out recording; it may only say no.
"""

from collections.abc import Mapping

import numpy as np

from greygate.mismatch.blocks import HALF, MORE, larger, squared
from greygate.mismatch.fit import Fit
from greygate.mismatch.model import Model
from greygate.mismatch.search import Search
from greygate.mismatch.several import by_rule, modelled

WHERE = "in the held-out recording"
MANY = 5  # windows of a recording, of which one may be left out


def no_better(search: Search, plain: Fit, fit: Fit, values: Mapping[str, float]) -> str:
    """Why a correction is not worn in place of the calibrated plant `plain`, in words; empty where it is.

    What does not act there says nothing, and is worn. values: those of `fit` that hold in another recording.
    """
    recording = search.rig.held_out()
    if recording is None:
        return ""
    model = modelled(search.rig, recording, fit.likelihood.model.effects)
    before, after = (_errors(model, each) for each in (plain.values, values))
    if not np.isfinite(before).all():
        return ""
    if why := larger(search.rig.predict, before, after, WHERE, by=HALF):
        return why
    more = float(np.mean(squared(before, after))) > (1.0 + MORE) ** 2
    return f"with it the error is larger {WHERE}" if more else ""


@np.errstate(over="ignore", invalid="ignore")  # a run may diverge
def _errors(model: Model, values: Mapping[str, float]) -> np.ndarray:
    """Recorded less simulated by the rule of the rig, where it counts (samples, channels), in the channels' units.

    Of many windows the first of a recording does not count: what acted before it is not recorded, and what remembers
    that, as a lag does, begins wrongly. Even the true model errs there.
    """
    predicted, counts = by_rule(model, values, model.rig.settle)
    for each, piece in zip(model.each, model.pieces, strict=True):
        if len(each.restarts) >= MANY:
            counts[piece.start : piece.start + each.restarts[1]] = False
    return (model.target - predicted)[counts]
