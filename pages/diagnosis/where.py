"""The section on where the calibrated simulation errs: its residual against each variable."""

from collections.abc import Mapping, Sequence

import numpy as np

from greygate.mismatch import words
from greygate.mismatch.locate import display_unit
from greygate.mismatch.places import unit_of_place
from greygate.pages import figures
from greygate.pages.diagnosis.case import Diagnosed
from greygate.pages.diagnosis.residual import Residual, binned, dependence
from greygate.pages.figures import Curve
from greygate.pages.units import labelled
from greygate.plants import units


def context(case: Diagnosed) -> dict:
    """Places in words, and a row of pictures per channel."""
    before, after = case.residuals["calibrated"], case.residuals.get("corrected")
    return {
        "where": words.where(case.found),
        "windowed": case.result.rig.window is not None,
        "changed": case.changed,
        "missing": [missing(case, place) for place in case.found["where"] if "curve" in place],
        "against": against(before, after, case.depends_on),
    }


def missing(case: Diagnosed, place: Mapping) -> dict:
    """The term that is missing over the signal on which it depends: as a curve with its band, beside the formula."""
    curve, plant = place["curve"], case.result.rig.plant
    unit = plant.unit(curve["of"]) if curve["of"] in plant.symbols else "s"
    scale, label = display_unit(unit, max(map(abs, curve["at"])))
    x = [scale * at for at in curve["at"]]
    band = Curve([*x, *x[::-1]], [*curve["low"], *curve["high"][::-1]], "quartiles")
    power = unit_of_place(plant, place["equation"])
    picture = figures.chart(
        [band, Curve(x, curve["value"], "before")],
        x=labelled(curve["of"], label),
        y=labelled(place["equation"], units.written(power) if power else ""),
        y_limits=figures.span([min(curve["low"]), max(curve["high"])]),
        levels=[(0.0, "")],
        width=480,
        height=260,
    )
    return {"equation": place["equation"], "formula": place["formula"], "picture": picture}


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
