"""Shows a recording: as rows for a terminal, and as a page that draws every channel as its envelope."""

from collections.abc import Sequence

import numpy as np

from greygate.pages import templates
from greygate.pages.figures import Curve, chart, envelope
from greygate.pages.units import display, figure
from greygate.plants.readers.columns import Channel

WIDTH, HEIGHT = 760, 170  # of a channel's drawing; wider, its numbers could not be read on a telephone
COLUMNS = ("channel", "unit", "in the file", "samples", "step", "jitter", "gaps", "least", "greatest")


def rows(found: Sequence[Channel]) -> list[dict[str, str]]:
    """The columns of `pages.summary.aligned`, in a person's units."""
    return [_row(c) for c in found]


def _row(c: Channel) -> dict[str, str]:
    factor, unit = display(c.unit, float(np.abs(c.values).max()))
    return {
        "channel": c.name,
        "unit": unit or "1",
        "in the file": c.given or "",
        "samples": f"{len(c.values)}",
        "step": f"{c.step:.6g} s",
        "jitter": f"{c.jitter:.2g} s",
        "gaps": f"{c.gaps}",
        "least": figure(factor * float(c.values.min())),
        "greatest": figure(factor * float(c.values.max())),
    }


def page(found: Sequence[Channel], source: str) -> str:
    """Make one self-contained HTML page."""
    drawn = []
    for c in found:
        factor, unit = display(c.unit, float(np.abs(c.values).max()))
        shape = envelope(factor * c.values)
        line = Curve([float(f"{c.time[k]:.6g}") for k in shape["step"]], shape["value"], "recorded")
        drawn.append(chart([line], x="t [s]", y=f"{c.name} [{unit or '1'}]", width=WIDTH, height=HEIGHT))
    return templates.render(
        "recorded.html", title=f"greygate look: {source}", columns=COLUMNS, rows=rows(found), drawn=drawn
    )
