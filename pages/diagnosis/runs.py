"""Before and after: the errors of a whole recording, and the place of the largest misfit."""

from collections.abc import Mapping

import numpy as np
from markupsafe import Markup

from greygate.mismatch.diagnosis import Diagnosis
from greygate.mismatch.locate import display_unit
from greygate.mismatch.several import by_rule, modelled
from greygate.models.drawn import shortened
from greygate.pages import figures
from greygate.pages.diagnosis.case import Diagnosed
from greygate.pages.diagnosis.residual import near
from greygate.pages.figures import Curve
from greygate.pages.units import labelled
from greygate.pages.zoomable import DRAWN, Trace, curves

ZOOM = 2000  # samples drawn where the misfit is largest; two windows where a rig has them;
ZOOM_PART = 4  # but no more than such a part of a recording
SHORTEST = 150  # samples that are drawn at least
COLOUR = {"calibrated": "fixed", "corrected": "float"}


def context(case: Diagnosed) -> dict:
    """A row of pictures per channel."""
    return {"changed": case.changed, "runs": runs(case), "drawn": DRAWN}


def runs(case: Diagnosed) -> list[dict]:
    """For each channel, the errors over a recording by the rig's rule, and a zoom on the largest misfit.

    The recording is holdout.csv where there is one.
    """
    result, rig = case.result, case.result.rig
    held = rig.held_out()
    name = "holdout" if held else "identify"
    model = modelled(rig, held or rig.to_explain(), result.corrected.likelihood.model.effects)
    skip = rig.settle if held else 0
    values = {kind: fit.values for kind, fit in case.fits.items()}
    if held and "corrected" in values:
        values["corrected"] = result.elsewhere
    predicted = {kind: by_rule(model, there, skip)[0] for kind, there in values.items()}
    rows = []
    for i, channel in enumerate(rig.predict):
        target = model.target[:, i]
        drawn = {kind: near(p[:, i], target) for kind, p in predicted.items()}
        errors = {kind: p - target for kind, p in drawn.items()}
        rows.append(
            {
                "channel": channel,
                "record": name,
                "samples": len(target),
                "run": run_data(errors, result, channel),
                "zoom": zoom_picture(result, target, drawn, channel),
            }
        )
    return rows


def run_data(errors: Mapping[str, np.ndarray], result: Diagnosis, channel: str) -> dict:
    """The errors over the recording, to zoom. A first window far beyond the rest is left out, not to flatten it."""
    opening = result.rig.window or 0
    later = [e[opening:] for e in errors.values()]
    low, high = min(float(e.min()) for e in later), max(float(e.max()) for e in later)
    factor, label = display_unit(result.rig.channels[channel].unit, max(-low, high))
    least, largest = figures.span([low, high], margin=1.0)
    shown = {k: np.where((e >= least) & (e <= largest), e, np.nan) * factor for k, e in errors.items()}
    traces = {kind: Trace(error, COLOUR[kind]) for kind, error in shown.items()}
    return curves(traces, result.rig.dt, [labelled(f"error of {channel}", label)])


def zoom_picture(result: Diagnosis, target: np.ndarray, predicted: Mapping[str, np.ndarray], channel: str) -> Markup:
    """Draw the calibrated simulation's residual where it is largest, and the change by the correction."""
    dt, window = result.rig.dt, result.rig.window
    length = min(2 * window if window else max(min(ZOOM, len(target) // ZOOM_PART), SHORTEST), len(target))
    missed = target - predicted["calibrated"]
    power = np.concatenate(([0.0], np.cumsum(missed**2)))
    starts = np.arange(window or 0, len(target) - length + 1, window or max(length // 4, 1))
    first = int(starts[np.argmax(power[starts + length] - power[starts])]) if len(starts) else 0
    steps = np.arange(first, min(first + length, len(target)), max(length // 500, 1))
    factor, label = display_unit(result.rig.channels[channel].unit, float(np.abs(missed[steps]).max()))
    times = (steps * dt).tolist()
    lines = [Curve(times, shortened(missed[steps] * factor), "reference")]
    if "corrected" in predicted:
        added = predicted["corrected"] - predicted["calibrated"]
        lines.append(Curve(times, shortened(added[steps] * factor), "after"))
    marks = [k * dt for k in range(first, first + length, window)][1:] if window else []
    return figures.chart(
        lines,
        x="time [s]",
        y=labelled(f"{channel} − calibrated", label),
        x_limits=(times[0], times[-1]),
        marks=marks,
        levels=[(0.0, "")],
        height=230,
    )
