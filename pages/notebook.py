"""How results show themselves in a notebook: a picture and a table, in a frame of their own, without a script."""

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
from markupsafe import Markup

from greygate.emulator.emulation import Emulation, emulate
from greygate.hardware.build import Project
from greygate.mismatch.diagnosis import Diagnosis
from greygate.models.network import Network
from greygate.models.training.record import Record
from greygate.pages import templates
from greygate.pages.diagnosis.residual import Diagnosed
from greygate.pages.diagnosis.sections import channels, facts
from greygate.pages.figures import Curve, chart
from greygate.pages.units import display, labelled

STEPS = 200  # of a step response
WIDTH, HEIGHT = 560, 210  # px of a picture
KINDS = ("model", "fixed", "cost")  # of curves, in the order of the outputs
DRAWN = 1000  # samples of a picture, from the first
WORDS, WORD, ASIDE = 40, 100, 90  # steps of a waveform, px of a port in it, and px left of that for its figures
ROW, ABOVE, FACTS = 31, 90, 170  # px of a table's row, of what stands around it, of a headline
Rows = Sequence[Mapping[str, object]]


def network(found: Network) -> str:
    """Its answer to a step of each input by its scale, and its layers."""
    pictures = [_step_response(found, name) for name in (p.name for p in found.inputs)]
    layers = [
        {
            "layer": name,
            "activation": layer.activation,
            "rows": len(layer.bias),
            "weights": sum(w.size for w in layer.weights.values()),
        }
        for name, layer in found.layers().items()
    ]
    keys = ", ".join(p.name for p in found.outputs)
    return framed(repr(found).strip("<>"), [], [(f"{keys} after a step of an input", p) for p in pictures], layers)


def _step_response(found: Network, name: str) -> Markup:
    inputs = {p.name: np.full((STEPS, p.size) if p.size > 1 else STEPS, p.offset) for p in found.inputs}
    inputs[name] = inputs[name] + found.port(name).scale
    answer = found.run(inputs)
    dt = found.sample_time() or 1.0
    values = [(answer[p.name] if p.size == 1 else answer[p.name][:, 0]) / p.scale for p in found.outputs]
    lines = [Curve(np.arange(STEPS) * dt, y, KINDS[k % len(KINDS)]) for k, y in enumerate(values)]
    over = "time [s]" if found.sample_time() else "step"
    return chart(lines, x=over, y=f"outputs / scale, step of {name}", width=WIDTH, height=HEIGHT)


def diagnosis(found: Diagnosis) -> str:
    """The verdict, where the simulation errs most, and how large the errors are."""
    case = Diagnosed(found)
    rows = [
        {
            "recording": name,
            "channel": channel,
            **{kind: _size(fit[kind], fit["unit"]) for kind in fit if kind != "unit"},
        }
        for name, fits in case.found["fit"].items()
        for channel, fit in fits.items()
    ]
    told = "recorded − calibrated where most is missed; blue: what the correction adds"
    return framed(case.title, facts(case), [(told, row["zoom"]) for row in channels(case)], rows, 2 * HEIGHT)


def _size(value: float, unit: str) -> str:
    factor, label = display(unit, abs(value or 0.0))
    return "–" if value is None else f"{value * factor:.4g} {label}"


def project(found: Project) -> str:
    """The hardware's answer to its first scenario beside what was recorded, its waveform, and its formats."""
    name, record = next(iter(found.records().items()))
    answer = emulate(found.program, {n: x[:DRAWN] for n, x in record.inputs.items()})
    ports = [
        {"port": p.name, "unit": p.unit, "format": str(p.signal.fix), "direction": way}
        for way, found_ports in (("in", found.program.inputs), ("out", found.program.outputs))
        for p in found_ports
    ]
    pictures = []
    for p in found.program.outputs:
        measured, predicted = record.targets[p.name][:DRAWN], answer.outputs[p.name]
        factor, unit = display(p.unit, float(np.abs(measured).max()))
        time = np.arange(len(measured)) * (found.program.period or 1.0)
        lines = [Curve(time, measured * factor, "reference"), Curve(time, predicted * factor, "fixed")]
        pictures.append(
            (
                "recorded, and what the hardware answers",
                chart(lines, x=f"time [s], {name}", y=labelled(p.name, unit), width=WIDTH, height=HEIGHT),
            )
        )
    pictures.append((f"the words on its ports, first {WORDS} steps of {name}", _waveform(found, record, answer)))
    title = f"{found.program.name}: {', '.join(found.facts['architectures'])}, in {found.folder}"
    return framed(title, [], pictures, ports, more=max(0, WORD * len(ports) - HEIGHT))


def _waveform(found: Project, record: Record, answer: Emulation) -> Markup:
    """The integers that stand on each port, step by step; of a vector the first."""
    inputs, outputs = found.program.inputs, found.program.outputs
    values = {**{p.name: record.inputs[p.name] for p in inputs}, **{p.name: answer.outputs[p.name] for p in outputs}}
    drawn = []
    for p in (*inputs, *outputs):
        words = p.codes(values[p.name][:WORDS]).reshape(-1, p.signal.size)[:, 0]
        steps = np.repeat(np.arange(len(words) + 1), 2)[1:-1]
        line = Curve(steps, np.repeat(words, 2), "model" if p in inputs else "fixed")
        drawn.append(chart([line], x="step", y=p.name, left=ASIDE, width=WIDTH, height=WORD))
    return Markup("").join(drawn)


def framed(
    title: str,
    told: Sequence,
    pictures: Sequence[tuple[str, Markup]],
    rows: Rows,
    high: int = HEIGHT + 70,
    more: int = 0,
) -> str:
    """A page within a frame: its style stays its own.

    pictures: (what it shows, drawing), each `high` px, and `more` px in all.
    """
    page = templates.render("notebook.html", title=title, facts=told, pictures=pictures, rows=rows)
    height = ABOVE + FACTS * bool(told) + high * len(pictures) + more + ROW * (len(rows) + 1)
    return f'<iframe srcdoc="{escape(str(page))}" style="width: 100%; height: {height}px; border: 0" sandbox></iframe>'
