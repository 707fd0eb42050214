"""Poles and frequency response of the linearisation about the means of the first recording."""

import numpy as np
from markupsafe import Markup

from greygate.identify.trained import Evidence
from greygate.pages import figures as drawing
from greygate.pages.figures import Curve
from greygate.pages.units import labelled

WIDTH, HEIGHT = 285, 250  # px
DOT = 1e-3  # half the length of the stroke that is a pole
SHOWN = 12  # poles in the table


def context(figures: dict, evidence: Evidence) -> dict | None:
    """None where the free run diverges, and there is no point to linearise about."""
    if evidence.about is None:
        return None
    poles = evidence.about.poles()
    return {
        "poles": [_row(p, evidence.period) for p in poles[:SHOWN]],
        "more": max(len(poles) - SHOWN, 0),
        "plane": _plane(poles),
        "responses": _responses(evidence),
    }


def _row(pole: complex, period: float) -> dict:
    size = abs(pole)
    rate = np.log(complex(pole)) / period
    return {
        "pole": f"{pole.real:.4f}" + (f" {'+' if pole.imag > 0 else '−'} {abs(pole.imag):.4f}i" if pole.imag else ""),
        "size": size,
        "time": -1 / rate.real if size < 1 else None,
        "hertz": abs(rate.imag) / (2 * np.pi) if pole.imag else None,
        "stable": size < 1,
    }


def _plane(poles: np.ndarray) -> Markup:
    turn = np.linspace(0, 2 * np.pi, 100)
    reach = max(1.1, 1.1 * np.abs(poles).max(initial=0.0))
    lines = [Curve(np.cos(turn), np.sin(turn), "circle")]
    lines += [Curve([p.real - DOT, p.real + DOT], [p.imag, p.imag], "pole") for p in poles]
    limits = (-reach, reach)
    return drawing.chart(lines, x="real", y="imaginary", x_limits=limits, y_limits=limits, width=WIDTH, height=HEIGHT)


def _responses(evidence: Evidence) -> list[tuple[str, Markup, Markup]]:
    """(pair, picture of the magnitude, picture of the phase)."""
    frequency = evidence.frequency
    found = evidence.about.response(frequency, evidence.period) if evidence.about else np.zeros((0, 0, 0))
    pictures = []
    for o, output in enumerate(evidence.after.outputs):
        for u, drive in enumerate(evidence.after.inputs):
            size = np.abs(found[:, o, u])
            phase = np.degrees(np.unwrap(np.angle(found[:, o, u])))
            unit = labelled("magnitude", f"{output.unit}/{drive.unit}" if output.unit != drive.unit else "")
            seen = [float(v) if v > 0 else None for v in size]
            magnitude = drawing.chart(
                [Curve(frequency, seen, "model")], y=unit, x_log=True, y_log=True, width=WIDTH, height=150
            )
            angle = drawing.chart(
                [Curve(frequency, phase, "model")],
                x="frequency [Hz]",
                y="phase [°]",
                x_log=True,
                width=WIDTH,
                height=170,
            )
            pictures.append((f"{output.name} from {drive.name}", magnitude, angle))
    return pictures
