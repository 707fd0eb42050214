"""Shows a recording: as rows for a terminal, and as a page that draws every channel."""

from collections.abc import Sequence

import numpy as np

from greygate.pages import templates
from greygate.pages.units import display, figure
from greygate.pages.zoomable import POINTS, Trace, curves, share
from greygate.plants.readers.columns import Channel

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
    """Make one self-contained HTML page, on which each channel can be zoomed."""
    title, plotly = f"greygate look: {source}", templates.plotly()
    return templates.render("recorded.html", title=title, plotly=plotly, **drawings(found))


def drawings(found: Sequence[Channel]) -> dict:
    """The context of `channels.html`: a table of the channels, and a drawing of each."""
    drawn, most = [], share(len(found), POINTS)
    for c in found:
        factor, unit = display(c.unit, float(np.abs(c.values).max()))
        data = curves({c.name: Trace(factor * c.values, "float")}, c.time, [unit or "1"], most)
        drawn.append((c.name, len(c.values), data))
    return {"columns": COLUMNS, "rows": rows(found), "drawn": drawn, "most": most}
