"""The sections of the page, each named as the template that it fills in; one whose context is None is left out."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup

from greygate.compiler.study import RUN_BINS
from greygate.pages import figures
from greygate.pages.figures import Curve
from greygate.pages.units import differing, display, figure, labelled, number
from greygate.pages.zoomable import Trace, curves


def head(study: dict) -> dict:
    """The study itself beside its headline."""
    return {"s": study, "facts": facts(study)}


def facts(found: dict) -> list[tuple[str, str, bool | None]]:
    """The headline of one study: (value, its meaning, whether it is good, or None)."""
    ratios = [o["ratio"] for s in found["scenarios"].values() for o in s["outputs"].values() if o["ratio"]]
    lines: list[tuple[str, str, bool | None]] = []
    if ratios:
        lines.append((f"× {max(ratios):.3f}", "largest RMSE of fixed point over float", None))
    for name, h in found["hardware"].items():
        steps, bits = ([v[k] for v in h["scenarios"].values()] for k in ("steps", "differing_bits"))
        clocks = f", {figure(h['clocks_per_step'])} clocks each" if h.get("clocks_per_step") else ""
        text = f"{name} Verilog from emulator: {sum(steps):,} steps{clocks}"
        lines.append((differing(None if None in bits else sum(bits)), text, all(b == 0 for b in bits)))
    if found["widths"]["word"]:
        lines.append((f"{found['widths']['word']} bit", "word of signals and weights", None))
    size = found["size"]
    kib = (size["state_bits"] + size["table_bits"]) / 8192
    lines.append((f"{size['multiplications']:,}", "multiplications a step", None))
    lines.append((f"{number(kib)} KiB", f"of tables and states ({size['state_bits']:,} bits of state)", None))
    return lines


def explored(study: dict) -> dict | None:
    """Two pictures and a table of the front; None where nothing was explored."""
    if not study["explored"]:
        return None
    found = study["explored"]
    names = list(dict.fromkeys(p["architecture"] for p in found["front"]))
    return {
        "found": found,
        "names": names,
        "unit": {"x": "times float", "unit": ""}.get(found["error_in"], found["error_in"]),
        "pictures": [
            front(found, names, "error", "luts", "error", "LUTs"),
            front(found, names, "microseconds", "luts", "µs a step", "LUTs"),
        ],
    }


def front(found: Mapping, names: Sequence[str], x: str, y: str, x_title: str, y_title: str) -> Markup:
    """The front in two of its figures, a line of points for each architecture; the chosen design is marked."""
    curves = []
    for n, name in enumerate(names):
        points = sorted((p[x], p[y]) for p in found["front"] if p["architecture"] == name)
        for a, b in points:  # a short line, because points alone have no length
            curves.append(Curve([a, a * 1.03], [b, b], f"series{n % 5} dots wide-dots"))
    chosen = found["chosen"]
    return figures.chart(
        curves,
        x=f"{x_title} [{found['error_in']}]" if x == "error" else x_title,
        y=y_title,
        x_log=True,
        y_log=True,
        x_limits=figures.span([p[x] for p in found["front"]], log=True),
        levels=[(chosen[y], "chosen")] if chosen else [],
        marks=[chosen[x]] if chosen else [],
        width=575,
        height=300,
    )


def widths(study: dict) -> dict | None:
    """A picture per output; None where no other width was tried."""
    if not study["widths"]["width"]:
        return None
    return {"scenarios": study["scenarios"], "widths": study["widths"], "pictures": by_width(study["widths"])}


def by_width(widths: dict) -> dict[str, Markup]:
    """The curve RMSE(fixed)/RMSE(float) over word width, one picture per output, one line per scenario."""
    outputs = list(dict.fromkeys(label for r in widths["ratio"].values() for label in r))
    low, high = figures.span([v for r in widths["ratio"].values() for c in r.values() for v in c], log=True)
    found = {}
    for label in outputs:
        curves = [r[label] for r in widths["ratio"].values()]
        found[label] = figures.chart(
            [Curve(widths["width"], c, f"series{i % 5} dots") for i, c in enumerate(curves)],
            x="word width [bit]",
            y="RMSE fixed / float",
            y_log=True,
            x_limits=(widths["width"][0] - 0.3, widths["width"][-1] + 0.3),
            y_limits=(min(low, 0.8), max(high, 2.0)),
            x_ticks=[w for w in widths["width"] if w % 2 == 0],
            levels=[(1.0, "")],
            marks=[widths["word"]] if widths["word"] else [],
            width={1: 1160, 2: 575}.get(len(outputs), 380),
            height=220,
        )
    return found


def formats(study: dict) -> dict:
    """The pictures of every input and operation, and of the weights; and the notes of the compiler on some signals."""
    signals = [s for s in study["signals"] if s["kind"] != "state"]
    return {
        "ranged_on": study["ranged_on"],
        "picture": figures.formats(signals),
        "noted": noted(study["signals"]),
        "weights": study["weights"],
        "weights_picture": figures.formats(study["weights"], of="|weight|"),
    }


def noted(signals: Sequence[dict]) -> list[tuple[str, str]]:
    """(signals and format, note), equal notes together."""
    found: dict[tuple[str, str], list[str]] = {}
    for s in signals:
        if s["note"]:
            found.setdefault((s["fix"], s["note"]), []).append(s["name"])
    return [(f"{', '.join(names)}, {fix}", note) for (fix, note), names in found.items()]


KINDS = ("float", "fixed")


def runs(study: dict) -> dict:
    """Pictures by scenario and output."""
    steps = {name: s["steps"] for name, s in study["scenarios"].items()}
    drawn = {
        name: {label: drawings(label, o, s["steps"], study["period"]) for label, o in s["outputs"].items()}
        for name, s in study["scenarios"].items()
    }
    names = list(dict.fromkeys(label for outputs in drawn.values() for label in outputs))
    return {"title": study["title"], "scenarios": drawn, "outputs": names, "steps": steps, "drawn": 2 * RUN_BINS}


def drawings(name: str, o: dict, steps: int, period: float) -> dict:
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


def inside(study: dict) -> dict:
    """The study itself beside the columns of its table of resources."""
    names = dict.fromkeys(k for r in study["resources"].values() for k in r)
    return {"s": study, "resource_names": list(names)}
