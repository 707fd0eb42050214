"""Each scenario: the run, the place of the largest error, the cost of quantization, spectra and accuracy."""

import math

import numpy as np
from markupsafe import Markup

from greygate.compiler.study import RUN_BINS
from greygate.pages import figures
from greygate.pages.figures import Curve
from greygate.pages.units import display, labelled
from greygate.pages.zoomable import Trace, curves

KINDS = ("float", "fixed")


def context(study: dict) -> dict:
    """Pictures by scenario and output."""
    steps = {name: s["steps"] for name, s in study["scenarios"].items()}
    drawn = {
        name: {label: pictures(label, o, s["steps"], study["period"]) for label, o in s["outputs"].items()}
        for name, s in study["scenarios"].items()
    }
    names = list(dict.fromkeys(label for outputs in drawn.values() for label in outputs))
    return {"title": study["title"], "scenarios": drawn, "outputs": names, "steps": steps, "drawn": 2 * RUN_BINS}


def pictures(name: str, o: dict, steps: int, period: float) -> dict:
    """Every drawing of one output on one scenario. o: as in a study. period: s."""
    span = (0.0, steps * period)
    return {
        "run": _run(name, o, period),
        "zoom": _zoom(name, o, period),
        "cost": figures.chart(
            [_over_time(o, "cost", "cost", period)],
            x="time [s]",
            y=labelled("fixed − float", _display(o, "cost")[1]),
            x_limits=span,
            height=276,
        ),
        "spectrum": _spectrum(o),
        "frf": figures.accuracy(o["frf"]["frequency"], {kind: o["frf"][kind] for kind in KINDS}, (92, 84, 100)),
    }


def _display(o: dict, trace: str) -> tuple[float, str]:
    """Factor and unit in which a trace of the output is drawn."""
    if trace == "error":
        return display(o["unit"], o["rmse"]["fixed"])
    if trace == "cost":
        return display(o["unit"], o["quantization"]["rms"])
    return display(o["unit"], max(map(abs, o["drawn"]["reference"]["value"])))


def _over_time(o: dict, trace: str, kind: str, period: float) -> Curve:
    points, (factor, _) = o["drawn"][trace], _display(o, trace)
    return Curve([k * period for k in points["step"]], [v * factor for v in points["value"]], kind)


def _run(name: str, o: dict, period: float) -> dict:
    """Reference and fixed point, and the error of fixed point below: what a reader can zoom."""
    factors = {trace: _display(o, trace) for trace in ("reference", "fixed", "error")}
    drawn = {
        trace: Trace(
            np.array(o["drawn"][trace]["value"]) * factor,
            "reference" if trace == "reference" else "fixed",
            width=3.0 if trace == "reference" else 1.0,
            below=trace == "error",
            time=np.array(o["drawn"][trace]["step"]) * period,
        )
        for trace, (factor, _) in factors.items()
    }
    return curves(drawn, period, [labelled(name, factors["reference"][1]), labelled("error", factors["error"][1])])


def _zoom(name: str, o: dict, period: float) -> Markup:
    """Every sample around the largest error."""
    zoom, (factor, unit) = o["zoom"], _display(o, "reference")
    times = [(zoom["start"] + k) * period for k in range(len(zoom["reference"]))]
    return figures.chart(
        [Curve(times, [v * factor for v in zoom[kind]], kind) for kind in ("reference", *KINDS)],
        x="time [s]",
        y=labelled(name, unit),
        marks=[zoom["worst"] * period],
        height=302,
    )


def _spectrum(o: dict) -> Markup:
    """Density of the model's error and of what quantization adds."""
    q, (factor, unit) = o["quantization"], _display(o, "cost")
    return figures.chart(
        [
            Curve(q["frequency"], [math.sqrt(v) * factor for v in psd], kind)
            for psd, kind in ((o["model_psd"], "model"), (q["psd"], "cost"))
        ],
        x="frequency [Hz]",
        y=f"density [{unit or '1'}/√Hz]",
        x_log=True,
        y_log=True,
        height=276,
    )
