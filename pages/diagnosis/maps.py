"""Maps of the mismatch: the residual of a fit over two variables, and over time."""

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from greygate.mismatch.locate import display_unit
from greygate.pages import figures
from greygate.pages.diagnosis.case import Diagnosed
from greygate.pages.diagnosis.residual import FEW, Residual, dependence, edges_of, part_of
from greygate.pages.figures import Curve
from greygate.pages.units import labelled, number

CELLS = {False: (36, 20), True: (16, 12)}  # of a map, by whether its points are few


def context(case: Diagnosed) -> dict:
    """A row of pictures per channel."""
    return {"maps": maps(case.residuals["calibrated"], case.residuals.get("corrected"), case.depends_on)}


def maps(before: Residual, after: Residual | None, told: Sequence[str]) -> list[dict]:
    """For each channel, the residual over the two variables that explain most of it, and over time."""
    rows = []
    for channel, error in before.errors.items():
        shares = {n: dependence(x, error) for n, x in before.variables.items()}
        ranked = [*dict.fromkeys([*told, *sorted(shares, key=lambda n: -shares[n])])]
        one, other = [n for n in ranked if n != "t"][:2] if len(ranked) > 2 else (ranked[0], ranked[-1])
        pairs = [(one, other), ("t", one)]
        reach = max(float(np.percentile(np.abs(cells(before, channel, pair)[0]), 95)) for pair in pairs) or 1.0
        pictures = []
        for pair in pairs:
            for title, residual in (("calibrated", before), ("corrected", after)):
                if residual is not None:
                    pictures.append((title, pair, heat(residual, channel, pair, reach)))
        factor, unit = display_unit(before.units[channel], reach)
        rows.append({"channel": channel, "pictures": pictures, "reach": f"{number(reach * factor)} {unit}"})
    return rows


def cells(residual: Residual, channel: str, pair: tuple[str, str]) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """(mean residual of each cell that holds points, number of that cell, edges of both variables)."""
    error = residual.errors[channel]
    signals = [residual.variables[name] for name in pair]
    columns, rows = CELLS[len(error) < FEW]
    edges = [edges_of(s, n) for s, n in zip(signals, (columns, rows), strict=True)]
    i, j = (part_of(s, e) for s, e in zip(signals, edges, strict=True))
    inside = (i >= 0) & (i < columns) & (j >= 0) & (j < rows)
    cell = (i * rows + j)[inside]
    count = np.bincount(cell, minlength=columns * rows)
    at = np.flatnonzero(count)
    return np.bincount(cell, error[inside], minlength=columns * rows)[at] / count[at], at, edges


def heat(residual: Residual, channel: str, pair: tuple[str, str], reach: float, width: int = 285) -> Markup:
    """Mean residual in cells of two variables: blue above zero, orange below, full colour at `reach`."""
    mean, at, edges = cells(residual, channel, pair)
    columns, rows = (len(e) - 1 for e in edges)
    signals = [residual.variables[name] for name in pair]
    labels = [display_unit(residual.units[n], float(np.abs(s).max())) for n, s in zip(pair, signals, strict=True)]
    frame = figures.chart(
        [Curve([e * labels[0][0] for e in edges[0][[0, -1]]], [e * labels[1][0] for e in edges[1][[0, -1]]], "none")],
        x=labelled(pair[0], labels[0][1]),
        y=labelled(pair[1], labels[1][1]),
        y_limits=tuple(e * labels[1][0] for e in edges[1][[0, -1]]),
        width=width,
        height=190,
    )
    inner = (width - figures.LEFT - figures.RIGHT, 190 - figures.TOP - figures.BOTTOM)
    wide, tall = inner[0] / columns, inner[1] / rows
    parts = []
    for value, k in zip(mean, at, strict=True):
        i, j = divmod(int(k), rows)
        strength = min(abs(value) / reach, 1.0)
        parts.append(
            f'<rect class="{"above" if value > 0 else "below"}" x="{figures.LEFT + i * wide:.1f}" '
            f'y="{figures.TOP + inner[1] - (j + 1) * tall:.1f}" width="{wide + 0.2:.1f}" height="{tall + 0.2:.1f}" '
            f'fill-opacity="{0.1 + 0.9 * strength:.2f}"/>'
        )
    return Markup(str(frame).removesuffix("</svg>") + "".join(parts) + "</svg>")
