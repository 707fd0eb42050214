"""The section on where the calibrated simulation errs: its residual against each variable."""

from collections.abc import Sequence

import numpy as np

from greygate.mismatch import words
from greygate.mismatch.locate import display_unit
from greygate.pages import figures
from greygate.pages.diagnosis.case import Diagnosed
from greygate.pages.diagnosis.residual import Residual, binned, dependence
from greygate.pages.figures import Curve
from greygate.pages.units import labelled


def context(case: Diagnosed) -> dict:
    """Places in words, and a row of pictures per channel."""
    before, after = case.residuals["calibrated"], case.residuals.get("corrected")
    return {
        "where": words.where(case.found),
        "windowed": case.result.rig.window is not None,
        "changed": case.changed,
        "against": against(before, after, case.depends_on),
    }


def against(before: Residual, after: Residual | None, told: Sequence[str]) -> list[dict]:
    """Median and quartiles of the residual: a row for each channel, a picture for each variable."""
    rows = []
    for channel, error in before.errors.items():
        drawn = {name: binned(x, error) for name, x in before.variables.items()}
        values = np.concatenate([[0.0], *(q.ravel() for _, q in drawn.values())])
        factor, unit = display_unit(before.units[channel], float(np.abs(values).max()) or 1.0)
        pictures = []
        for name, (middle, quartiles) in drawn.items():
            scale, label = display_unit(before.units[name], float(np.abs(before.variables[name]).max()))
            x, q = middle * scale, quartiles * factor
            lines = [Curve([*x, *x[::-1]], [*q[:, 0], *q[::-1, 2]], "quartiles"), Curve(x, q[:, 1], "before")]
            if after is not None:
                at, now = binned(after.variables[name], after.errors[channel])
                lines.append(Curve(at * scale, now[:, 1] * factor, "after"))
            picture = figures.chart(
                lines,
                x=labelled(name, label),
                y=labelled(channel, unit),
                y_limits=figures.span([factor * values.min(), factor * values.max()]),
                levels=[(0.0, "")],
                width=285,
                height=170,
            )
            share = dependence(before.variables[name], error)
            pictures.append({"name": name, "picture": picture, "share": 100 * share, "told": name in told})
        rows.append({"channel": channel, "pictures": pictures})
    return rows
