"""The report: what quantization cost, as one JSON-able dict per plant and one self-contained HTML page.

`study` measures, `page` draws, `write` puts both on disk. SI units in the dict; `display` turns them into what a person
reads. How to read the page: docs/report.md.
"""

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader

from greygate.compiler.pipeline import Compiled, quantize_centred
from greygate.compiler.quantize import Formats
from greygate.emulator.engine import run
from greygate.emulator.program import Affine, Lookup, Program, Terminal
from greygate.errors import InputError
from greygate.files import replacing_all
from greygate.models.accuracy import rms
from greygate.models.network import Network
from greygate.models.spectra import frequency_response, spectrum
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record
from greygate.pages import figures
from greygate.pages.figures import Line

BINS = 400  # of a whole run as it is drawn; each shows its least and its largest value
ZOOM = 200  # steps drawn around the largest error
QUANTILES = (5, 25, 50, 75, 100)  # of |signal|, in per cent
KINDS = ("float", "fixed")
LEFT = ("plant", "scenario", "output", "unit", "design", "target")  # columns of words in tables that stand on top
TRUSTED = 0.8  # coherence below which a frequency response says nothing


def display(unit: str, reach: float = 0.0) -> tuple[float, str]:
    """(factor, label) that turn SI into what a person reads: bar for Pa; um for m, mm where it reaches 1 mm or more."""
    if unit == "Pa":
        return 1e-5, "bar"
    if unit == "m":
        return (1e3, "mm") if reach >= 1e-3 else (1e6, "µm")
    return 1.0, "" if unit == "1" else unit


def study(
    title: str,
    compiled: Compiled,
    records: Mapping[str, Record],
    *,
    ranged_on: Sequence[str],
    period: float,
    called: str = "",
    references: Mapping[str, Mapping] | None = None,
    hardware: Mapping[str, Mapping] | None = None,
    resources: Mapping[str, Mapping] | None = None,
    widths: Iterable[int] = range(8, 25),
    formats: Formats | None = None,
    progress: Callable[[str], None] | None = None,
) -> dict:
    """Everything the report knows of one compiled network, in SI units; numbers are finite, None where there is none.

    records: scenarios; their targets are the reference. ranged_on: those whose ranges set the formats. period: s.
    called: its name where it stands beside others; the program's if not given.
    references: published RMSE by source, scenario and output, {"thesis": {"v1": {"p_a": 55200.0}}}; a value may be a
    pair (low, high). hardware: by architecture, {"parallel": {"clocks_per_step": 40, "scenarios": {"v1": {"steps":
    5000, "differing_bits": 0}}}}. resources: {"parallel, ecp5": {"luts": 9000, ...}}. widths, formats: word widths of
    the curve, and everything else about its formats. progress: called with a line now and then.

    Raises InputError when one of `ranged_on` is no scenario, or the float network diverges on one.
    """
    for name in ranged_on:
        if name not in records:
            raise InputError(f"report {title}: no scenario {name}; there are {', '.join(records)}")
    say = progress or (lambda line: None)
    program, hardware, references = compiled.program, hardware or {}, references or {}
    units = {label: p.unit for p in program.outputs for label in _labels(p)}
    scenarios, saturations = {}, {}
    for name, record in records.items():
        say(f"{title}: {name}")
        reference, floating = _elements(program, record.targets), _float(compiled.network, program, record)
        fixed, saturations[name] = _fixed(program, record)
        outputs = {
            label: {"unit": units[label]}
            | _output(reference[label], floating[label], fixed[label], record.skip, period)
            | {
                "hardware": {
                    a: _hardware(h, name, rms((fixed[label] - reference[label])[record.skip :]))
                    for a, h in hardware.items()
                },
                "references": {s: r[name][label] for s, r in references.items() if label in r.get(name, {})},
            }
            for label in reference
        }
        steps = len(next(iter(reference.values())))
        scenarios[name] = {"steps": steps, "seconds": steps * period, "skip": record.skip, "outputs": outputs}
    return plain(
        {
            "title": title,
            "name": called or program.name,
            "program": program.name,
            "period": period,
            "ranged_on": list(ranged_on),
            "size": size(program),
            "scenarios": scenarios,
            "widths": _curve(compiled, records, scenarios, ranged_on, widths, formats or Formats(), say),
            "signals": _signals(compiled, records[ranged_on[0]], saturations),
            "tables": [
                {
                    "name": t.name,
                    "function": t.function,
                    "points": len(t.points),
                    "interpolated": t.interpolated,
                    "argument": str(t.arg),
                    "result": str(t.out),
                    "worst_error": t.worst_error,
                    "worst_error_lsb": t.worst_error / t.out.lsb,
                    "used_by": [o.out.name for o in program.operations if isinstance(o, Lookup) and o.table == t.name],
                }
                for t in program.tables
            ],
            "passes": [asdict(p) for p in compiled.passes],
            "references": references,
            "hardware": hardware,
            "resources": resources or {},
        }
    )


def plain(value):
    """Numpy-free and finite: what `json.dumps(..., allow_nan=False)` takes. NaN and inf become None."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, str | bool) or value is None:
        return value
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, Sequence):
        return [plain(v) for v in value]
    if isinstance(value, int | np.integer):
        return int(value)
    return float(value) if math.isfinite(value) else None


def _labels(port: Terminal) -> list[str]:
    """Names of a port's elements: its own, or `name[0]`, `name[1]`, ... where there are several."""
    return [port.name] if port.signal.size == 1 else [f"{port.name}[{i}]" for i in range(port.signal.size)]


def _elements(program: Program, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Outputs {port: (N,) or (N, size)} by element, {label: (N,)}."""
    found = {}
    for p in program.outputs:
        columns = np.asarray(values[p.name], float).reshape(-1, p.signal.size).T
        found |= dict(zip(_labels(p), columns, strict=True))
    return found


def _float(network: Network, program: Program, record: Record) -> dict[str, np.ndarray]:
    """Free run of the float network, by output element, in physical units."""
    problem = Objective(network, [record])
    errors = problem.errors(problem.theta)
    if errors is None:
        raise InputError(f"network {network.name}: diverges on the record")
    ends = np.cumsum([p.signal.size for p in program.outputs])[:-1]
    parts = zip(program.outputs, np.split(errors[0], ends, axis=1), strict=True)
    return _elements(program, {p.name: np.reshape(record.targets[p.name], e.shape) + e * p.scale for p, e in parts})


def _fixed(program: Program, record: Record) -> tuple[dict[str, np.ndarray], dict[str, int]]:
    """Run of the program, by output element, in physical units; and saturations by signal, clipped inputs too."""
    done = run(program, program.encode(record.inputs), states=False)
    clipped = {}
    for p in program.inputs:
        codes = np.floor((np.asarray(record.inputs[p.name]) - p.offset) / p.scale / p.signal.fix.lsb + 0.5)
        clipped[p.name] = int(np.count_nonzero((codes < p.signal.fix.lo) | (codes > p.signal.fix.hi)))
    return _elements(program, program.decode(done.outputs)), clipped | done.saturations


def _output(reference: np.ndarray, floating: np.ndarray, fixed: np.ndarray, skip: int, period: float) -> dict:
    """Figures, spectra and drawn traces of one output on one scenario."""
    e_float, e_fixed, cost = floating - reference, fixed - reference, fixed - floating
    used = slice(skip, None)
    frequency, psd = spectrum(cost[used], period)
    worst = skip + int(np.argmax(np.abs(e_fixed[used])))
    start = max(0, min(worst - ZOOM // 2, len(reference) - ZOOM))
    window = slice(start, start + ZOOM)
    traces = {"reference": reference, "fixed": fixed, "float": floating}
    return {
        "spread": float(np.std(reference[used])),
        "rmse": {"float": rms(e_float[used]), "fixed": rms(e_fixed[used])},
        "ratio": _ratio(rms(e_fixed[used]), rms(e_float[used])),
        "quantization": {
            "rms": rms(cost[used]),
            "max": float(np.abs(cost[used]).max()),
            "frequency": frequency,
            "psd": psd,
        },
        "model_psd": spectrum(e_float[used], period)[1],
        "frf": frequency_response(reference[used], {"float": floating[used], "fixed": fixed[used]}, period),
        "drawn": {
            name: envelope(values)
            for name, values in [("reference", reference), ("fixed", fixed), ("error", e_fixed), ("cost", cost)]
        },
        "zoom": {"start": start, "worst": worst} | {n: shortened(v[window]) for n, v in traces.items()},
    }


def _ratio(fixed: float, floating: float) -> float | None:
    return fixed / floating if floating > 0 and math.isfinite(fixed) else None


def _hardware(found: Mapping, scenario: str, fixed: float) -> dict | None:
    """What verify found of one architecture on one scenario: with no differing bit its RMSE is that of fixed point."""
    verdict = found.get("scenarios", {}).get(scenario)
    if verdict is None:
        return None
    same = verdict["differing_bits"] == 0
    return {**verdict, "equals_fixed": same, "rmse": fixed if same else None}


def envelope(values: np.ndarray, bins: int = BINS) -> dict[str, list]:
    """Least and largest value of each bin, in the order in which they come: {"step": [...], "value": [...]}."""
    edges = np.unique(np.linspace(0, len(values), min(bins, len(values)) + 1).astype(int))
    steps = []
    for a, b in pairwise(edges):
        part = values[a:b]
        steps += sorted({a + int(np.argmin(part)), a + int(np.argmax(part))})
    return {"step": steps, "value": shortened(values[steps])}


def shortened(values: np.ndarray) -> list[float]:
    """Six significant digits: enough to draw, and half the bytes."""
    return [float(f"{v:.6g}") for v in values]


def _curve(
    compiled: Compiled,
    records: Mapping[str, Record],
    scenarios: dict,
    ranged_on: Sequence[str],
    widths: Iterable[int],
    formats: Formats,
    say: Callable[[str], None],
) -> dict:
    """RMSE(fixed)/RMSE(float) of every output on every scenario, for programs of other word widths.

    Simplification and ranges are those of `compiled`; formats, tables and biases are made anew. `word` is the
    width whose program errs exactly as `compiled` does, if there is one. None: a width that cannot hold the ranges.
    """
    widths, word = list(widths), None
    ratio = {n: {o: [] for o in s["outputs"]} for n, s in scenarios.items()}
    for width in widths:
        say(f"{compiled.program.name}: {width} bits")
        try:
            program = quantize_centred(
                compiled.network,
                compiled.ranges,
                [records[n] for n in ranged_on],
                replace(formats, width=width),
                compiled.program.period,
            )
        except InputError:
            program = None
        same = program is not None
        for name, record in records.items():
            fixed = _fixed(program, record)[0] if program else {}
            reference = _elements(compiled.program, record.targets)
            for label, now in scenarios[name]["outputs"].items():
                error = rms((fixed[label] - reference[label])[record.skip :]) if fixed else math.inf
                ratio[name][label].append(_ratio(error, now["rmse"]["float"]))
                same = same and error == now["rmse"]["fixed"]
        word = width if same else word
    return {"width": widths, "ratio": ratio, "word": word, "finer": formats.finer}


def _signals(compiled: Compiled, record: Record, saturations: Mapping[str, Mapping[str, int]]) -> list[dict]:
    """Every signal of the program: its format, what the format holds, and what the signal does (normalised units).

    observed: (low, high) of the float network on the record; a delayed signal or a view has that of its origin, and a
    signal that only the program knows that of its codes. sound: proved bounds, None where there are none.
    quantiles: of |value| where it is not zero, on the record.
    """
    program = compiled.program
    trace = run(program, program.encode(record.inputs), trace=True, states=False).trace
    inputs, states = {p.signal.name for p in program.inputs}, {s.signal.name for s in program.states}
    found = []
    for name, signal in program.signals.items():
        fix, seen = signal.fix, compiled.ranges.get(re.sub(r"(\.z\d+)?(\.view)?$", "", name))
        values = trace[name] * fix.lsb
        size = np.abs(values[values != 0])
        found.append(
            {
                "name": name,
                "kind": "input" if name in inputs else "state" if name in states else "operation",
                "size": signal.size,
                "fix": str(fix),
                "width": fix.width,
                "frac": fix.frac,
                "holds": (fix.lo * fix.lsb, fix.hi * fix.lsb),
                "observed": (seen.low, seen.high) if seen else (values.min(), values.max()),
                "sound": seen.sound if seen and name not in inputs and np.isfinite(seen.sound).all() else None,
                "quantiles": np.percentile(size, QUANTILES) if size.size else None,
                "saturations": {n: s[name] for n, s in saturations.items() if s.get(name)},
                "note": program.notes.get(name),
            }
        )
    return found


def size(program: Program) -> dict[str, int]:
    """What the program is made of: products of one step, bits of weights, of states and of tables."""
    affine = [o for o in program.operations if isinstance(o, Affine)]
    return {
        "operations": len(program.operations),
        "multiplications": sum(int(np.count_nonzero(o.weights)) for o in affine),
        "state_bits": sum(s.signal.size * s.signal.fix.width for s in program.states),
        "table_bits": sum(len(t.points) * t.out.width for t in program.tables),
        "accumulator_bits": max((program.accumulator_width(o) for o in affine), default=0),
    }


def write(
    studies: Sequence[dict], html_path: Path | str, json_path: Path | str, tables: Sequence[Sequence[dict]] = ()
) -> None:
    """Write `page` and the JSON, each whole or not at all. Raises InputError where a folder cannot be written."""
    html, text = page(studies, tables), json.dumps(list(studies), indent=1, allow_nan=False, ensure_ascii=False)
    text = re.sub(r"\[[^][{}]*\]", lambda found: " ".join(found[0].split()), text)  # a list of numbers on one line
    with replacing_all([html_path, json_path]) as (first, second):
        first.write_text(html, encoding="utf-8")
        second.write_text(text + "\n", encoding="utf-8")


def page(studies: Sequence[dict], tables: Sequence[Sequence[dict]] = ()) -> str:
    """One HTML page that needs nothing else: styles and pictures (SVG) are inside. studies: as `study` gives them.

    tables: of `greygate.pages.summary`, on top.
    """
    environment = templates()
    environment.filters |= {"number": figures.number, "figure": figure}
    environment.globals |= {"differing": differing, "display": display, "shown": shown, "LEFT": LEFT}
    return environment.get_template("report.html").render(studies=[s | _drawn(s) for s in studies], tables=tables)


def templates() -> Environment:
    """The templates of every page. What they show is escaped, whatever it is; only `Markup` is taken as it stands."""
    return Environment(
        loader=PackageLoader("greygate.pages", "."), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )


def _drawn(found: dict) -> dict:
    """What the page needs beside the study itself: pictures, headline facts, columns of the resource table."""
    names = dict.fromkeys(k for r in found["resources"].values() for k in r)
    return {
        "figures": pictures(found),
        "facts": facts(found),
        "resource_names": list(names),
        "noted": noted(found["signals"]),
    }


def facts(found: dict) -> list[tuple[str, str, bool | None]]:
    """The headline of one study: (value, what it is, good or bad or neither)."""
    ratios = [o["ratio"] for s in found["scenarios"].values() for o in s["outputs"].values() if o["ratio"]]
    lines = []
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
    lines.append((f"{figures.number(kib)} KiB", f"of tables and states ({size['state_bits']:,} bits of state)", None))
    return lines


def differing(bits: int | None) -> str:
    """How many bits differ; None: some do, uncounted."""
    return "bits differ" if bits is None else f"{bits:,} bits differ"


def figure(value) -> str:
    """A cell of a table of figures whose kind is not known beforehand."""
    if isinstance(value, str):
        return value
    return f"{value:,.0f}" if value is not None and value == int(value) else figures.number(value, 4)


def shown(value, unit: str, reach: float = 0.0) -> str:
    """An SI figure, or a pair of them, in display units, without the unit."""
    if isinstance(value, Sequence):
        return " to ".join(shown(v, unit, reach) for v in value)
    return figures.number(None if value is None else value * display(unit, reach)[0])


def noted(signals: Sequence[dict]) -> list[tuple[str, str]]:
    """(signals and format, note), equal notes together."""
    found: dict[tuple[str, str], list[str]] = {}
    for s in signals:
        if s["note"]:
            found.setdefault((s["fix"], s["note"]), []).append(s["name"])
    return [(f"{', '.join(names)}, {fix}", note) for (fix, note), names in found.items()]


def _label(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def pictures(found: dict) -> dict:
    """Every drawing of one study, as inline SVG: {"scenarios": {scenario: {output: {...}}}, "widths", "formats"}."""
    drawn = {
        name: {label: _output_pictures(label, o, s["steps"], found["period"]) for label, o in s["outputs"].items()}
        for name, s in found["scenarios"].items()
    }
    signals = [s for s in found["signals"] if s["kind"] != "state"]
    return {"scenarios": drawn, "widths": width_pictures(found["widths"]), "formats": figures.formats(signals)}


def width_pictures(widths: dict) -> dict[str, str]:
    """The curve RMSE(fixed)/RMSE(float) over word width, one picture per output, one line per scenario."""
    if not widths["width"]:
        return {}
    outputs = list(dict.fromkeys(label for r in widths["ratio"].values() for label in r))
    low, high = figures.span([v for r in widths["ratio"].values() for c in r.values() for v in c], log=True)
    found = {}
    for label in outputs:
        curves = [r[label] for r in widths["ratio"].values()]
        found[label] = figures.chart(
            [Line(widths["width"], c, f"series{i % 5} dots") for i, c in enumerate(curves)],
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


def _output_pictures(name: str, o: dict, steps: int, period: float) -> dict[str, str]:
    unit = o["unit"]
    big, big_unit = display(unit, max(map(abs, o["drawn"]["reference"]["value"])))
    small, small_unit = display(unit, o["rmse"]["fixed"])
    fine, fine_unit = display(unit, o["quantization"]["rms"])

    def over_time(trace: str, factor: float, kind: str) -> Line:
        points = o["drawn"][trace]
        return Line([k * period for k in points["step"]], [v * factor for v in points["value"]], kind)

    zoom, q, frf = o["zoom"], o["quantization"], o["frf"]
    times = [(zoom["start"] + k) * period for k in range(len(zoom["reference"]))]
    whole = (0.0, steps * period)
    f_limits = figures.span(frf["frequency"], log=True, margin=0)

    def response(part: str, y: str, low: float, high: float, **options) -> str:
        """One panel; magnitude and phase only where the coherence says that they mean something."""
        sure = [[c is not None and c >= TRUSTED for c in frf[kind]["coherence"]] for kind in KINDS]
        if part == "coherence":
            sure = [[True] * len(s) for s in sure]
        lines = [
            Line(frf["frequency"], [v if ok else None for v, ok in zip(frf[kind][part], s, strict=True)], kind)
            for kind, s in zip(KINDS, sure, strict=True)
        ]
        seen = [v for line in lines for v in line.y if v is not None]
        limits = figures.span([*np.percentile(seen, (2, 98)), low, high]) if seen else (low, high)
        rest = [] if part == "coherence" else [((low + high) / 2, "")]
        return figures.chart(lines, y=y, x_log=True, x_limits=f_limits, y_limits=limits, levels=rest, **options)

    root = f"{fine_unit}/√Hz" if fine_unit else "1/√Hz"
    return {
        "run": figures.chart(
            [over_time("reference", big, "reference"), over_time("fixed", big, "fixed")],
            y=_label(name, big_unit),
            x_limits=whole,
            width=770,
            height=170,
        )
        + figures.chart(
            [over_time("error", small, "fixed")],
            x="time [s]",
            y=_label("error", small_unit),
            x_limits=whole,
            width=770,
            height=120,
        ),
        "zoom": figures.chart(
            [Line(times, [v * big for v in zoom[kind]], kind) for kind in ("reference", "float", "fixed")],
            x="time [s]",
            y=_label(name, big_unit),
            marks=[zoom["worst"] * period],
            height=302,
        ),
        "cost": figures.chart(
            [over_time("cost", fine, "cost")],
            x="time [s]",
            y=_label("fixed − float", fine_unit),
            x_limits=whole,
            height=276,
        ),
        "spectrum": figures.chart(
            [
                Line(q["frequency"], [math.sqrt(v) * fine for v in o["model_psd"]], "model"),
                Line(q["frequency"], [math.sqrt(v) * fine for v in q["psd"]], "cost"),
            ],
            x="frequency [Hz]",
            y=f"density [{root}]",
            x_log=True,
            y_log=True,
            height=276,
        ),
        "frf": response("magnitude", "|Ŷ/Y|", 0.9, 1.1, height=92)
        + response("phase", "phase [°]", -10, 10, height=84)
        + response("coherence", "coherence", 0, 1, x="frequency [Hz]", height=100),
    }
