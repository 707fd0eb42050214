"""Measures what quantization cost one compiled network; the result is a JSON-able dict in SI units (docs/report.md)."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import count
from typing import Annotated, Any, Literal, TypedDict

import numpy as np

from greygate.compiler.pipeline import Compiled, Pass, quantize_centred
from greygate.compiler.quantize import Formats
from greygate.compiler.targets import Design
from greygate.emulator.engine import run
from greygate.emulator.numbers import Fix, signed_width
from greygate.emulator.program import Affine, Lookup, Product, Program, Terminal
from greygate.emulator.tables import Lines, Table
from greygate.errors import InputError
from greygate.models.accuracy import float_error, rms
from greygate.models.drawn import envelope, shortened
from greygate.models.network import Network
from greygate.models.spectra import frequency_response, spectrum
from greygate.models.training.record import Record
from greygate.plain import Count, Figure, Json, plain
from greygate.progress import Progress, silent


class Costed(TypedDict):
    """A design of an exploration."""

    error: float
    luts: Count
    dsps: Count
    memories: float
    clocks: Count
    period_ns: float
    microseconds: float
    architecture: str
    design: Design
    width: int
    finer: int
    tables: str
    table_budget: float
    signals: dict[str, str]
    weights: dict[str, int]
    price: float


class Explored(TypedDict):
    """What was tried, and what binds."""

    device: str
    family: str
    error_in: str
    request: Annotated[dict[str, float | None], "The limits; null where none is set."]
    programs: Count
    points: Count
    front: list[Costed]
    chosen: Costed | None
    why: str


RUN_BINS = 2000  # of a whole run, into which a reader can zoom; each has its least and its largest value
ZOOM = 200  # steps drawn around the largest error
QUANTILES = (5, 25, 50, 75, 100)  # of |signal|, in per cent


class ScenarioVerified(TypedDict):
    steps: Count
    differing_bits: Literal[0] | None
    mismatch: str | None


class Verified(TypedDict):
    clocks_per_step: Figure
    seed: Count
    scenarios: dict[str, ScenarioVerified]


class OutputVerified(ScenarioVerified):
    equals_fixed: bool
    rmse: Figure


class Rmse(TypedDict):
    float: Figure
    fixed: Figure


class Quantization(TypedDict):
    rms: Figure
    max: Figure
    frequency: list[float]
    psd: list[Figure]


class Curve(TypedDict):
    step: list[float]
    value: list[Figure]


class Curves(TypedDict):
    reference: Curve
    fixed: Curve
    error: Curve
    cost: Curve


class Zoom(TypedDict):
    start: Count
    worst: Count
    reference: list[Figure]
    fixed: list[Figure]
    float: list[Figure]


class Output(TypedDict):
    unit: str
    spread: Figure
    rmse: Rmse
    ratio: Figure
    quantization: Quantization
    model_psd: list[Figure]
    frf: dict[str, Any]
    drawn: Curves
    zoom: Zoom
    hardware: dict[str, OutputVerified | None]
    references: dict[str, Any]


class Scenario(TypedDict):
    steps: Count
    seconds: float
    skip: Count
    outputs: dict[str, Output]


class Widths(TypedDict):
    width: list[Count]
    ratio: dict[str, dict[str, list[Figure]]]
    word: Count | None
    finer: Count


class Held(TypedDict):
    name: str
    size: Count
    fix: str
    width: Count
    frac: int
    holds: tuple[float, float]
    observed: tuple[float, float]
    sound: tuple[float, float] | None
    quantiles: list[float] | None
    saturations: dict[str, Count]


class HeldSignal(Held):
    kind: Literal["input", "state", "operation"]
    note: str | None


class Lookups(TypedDict):
    name: str
    function: str
    points: Count
    interpolated: bool
    argument: str
    result: str
    worst_error: float
    worst_error_lsb: float
    used_by: list[str]


class Size(TypedDict):
    operations: Count
    multiplications: Count
    state_bits: Count
    table_bits: Count
    accumulator_bits: Count


class Study(TypedDict):
    title: str
    name: str
    program: str
    period: float
    ranged_on: list[str]
    size: Size
    scenarios: dict[str, Scenario]
    widths: Widths
    signals: list[HeldSignal]
    weights: list[Held]
    tables: list[Lookups]
    passes: list[Pass]
    references: dict[str, Any]
    hardware: dict[str, Verified]
    resources: dict[str, dict[str, Figure]]
    explored: Explored | Annotated[dict[str, Any], Json(maxProperties=0)]


Verifications = Annotated[dict[str, Verified], "Architecture -> what the last verification found."]
Studies = Annotated[
    list[Study], "One study for each build: what fixed point costs, in SI units; a figure is finite or null."
]


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
    explored: Mapping | None = None,
    widths: Iterable[int] = range(8, 25),
    formats: Formats | None = None,
    progress: Progress = silent,
) -> dict:
    """Measure everything that the report shows of one compiled network, in SI units; a figure is finite or None.

    records: scenarios, whose targets are the reference. ranged_on: those whose ranges set the formats. period: s.
    called: its name in tables of several networks; the name of the program if not given.
    references: published RMSE by source, scenario and output, {"thesis": {"v1": {"p_a": 55200.0}}}; a value may be a
    pair (low, high). hardware: by architecture, {"parallel": {"clocks_per_step": 40, "scenarios": {"v1": {"steps":
    5000, "differing_bits": 0}}}}. resources: {"parallel, ecp5": {"luts": 9000, ...}}. explored: of
    compile.json. widths: word widths of the curve. formats: all other properties of its formats.

    Raises InputError if one of `ranged_on` is not a scenario, or the float network diverges on one.
    """
    for name in ranged_on:
        if name not in records:
            raise InputError(f"report {title}: no scenario {name}; there are {', '.join(records)}")
    program, hardware, references = compiled.program, hardware or {}, references or {}
    scenarios, saturations = {}, {}
    for name, record in records.items():
        progress(f"{title}: {name}")
        scenarios[name], saturations[name] = _scenario(compiled, record, period)
        for label, output in scenarios[name]["outputs"].items():
            output["hardware"] = {a: _hardware(h, name, output["rmse"]["fixed"]) for a, h in hardware.items()}
            output["references"] = {s: r[name][label] for s, r in references.items() if label in r.get(name, {})}
    return plain(
        {
            "title": title,
            "name": called or program.name,
            "program": program.name,
            "period": period,
            "ranged_on": list(ranged_on),
            "size": size(program),
            "scenarios": scenarios,
            "widths": _curve(compiled, records, scenarios, ranged_on, widths, formats or Formats(), progress),
            "signals": _signals(compiled, records[ranged_on[0]], saturations),
            "weights": [w for o in program.operations if isinstance(o, Affine) for w in _weights(o, program)],
            "tables": [_table(t, program) for t in program.tables],
            "passes": compiled.passes,
            "references": references,
            "hardware": hardware,
            "resources": resources or {},
            "explored": explored or {},
        }
    )


def _scenario(compiled: Compiled, record: Record, period: float) -> tuple[dict, dict[str, int]]:
    """Float and fixed point on one record, by output; and saturations by signal."""
    program = compiled.program
    reference, floating = _elements(program, record.targets), _float(compiled.network, program, record)
    fixed, saturations = _fixed(program, record)
    units = {label: p.unit for p in program.outputs for label in _labels(p)}
    outputs = {
        label: {"unit": units[label]} | _output(reference[label], floating[label], fixed[label], record.skip, period)
        for label in reference
    }
    steps = len(next(iter(reference.values())))
    return {"steps": steps, "seconds": steps * period, "skip": record.skip, "outputs": outputs}, saturations


def _labels(port: Terminal) -> list[str]:
    """Names of a port's elements: the name of the port, or `name[0]`, `name[1]`, ... if there are several."""
    return [port.name] if port.signal.size == 1 else [f"{port.name}[{i}]" for i in range(port.signal.size)]


def _elements(program: Program, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Outputs {port: (N,) or (N, size)} by element, {label: (N,)}."""
    found: dict[str, np.ndarray] = {}
    for p in program.outputs:
        columns = np.asarray(values[p.name], float).reshape(-1, p.signal.size).T
        found |= dict(zip(_labels(p), columns, strict=True))
    return found


def _float(network: Network, program: Program, record: Record) -> dict[str, np.ndarray]:
    """Free run of the float network, by output element, in physical units."""
    errors = float_error(network, record)
    return _elements(program, {n: np.reshape(record.targets[n], e.shape) + e for n, e in errors.items()})


def _fixed(program: Program, record: Record) -> tuple[dict[str, np.ndarray], dict[str, int]]:
    """Run of the program, by output element, in physical units; and saturations by signal, clipped inputs too."""
    done = run(program, program.encode(record.inputs), states=False)
    clipped = {name: found.count for name, found in program.clipped(record.inputs).items()}
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
            name: envelope(values, RUN_BINS)
            for name, values in [("reference", reference), ("fixed", fixed), ("error", e_fixed)]
        }
        | {"cost": envelope(cost)},
        "zoom": {"start": start, "worst": worst} | {n: shortened(v[window]) for n, v in traces.items()},
    }


def _ratio(fixed: float, floating: float) -> float | None:
    return fixed / floating if floating > 0 and math.isfinite(fixed) else None


def _hardware(found: Mapping, scenario: str, fixed: float) -> dict | None:
    """The result of verify for one architecture and scenario; if no bit differs, its RMSE is that of fixed point."""
    verdict = found.get("scenarios", {}).get(scenario)
    if verdict is None:
        return None
    same = verdict["differing_bits"] == 0
    return {**verdict, "equals_fixed": same, "rmse": fixed if same else None}


def _curve(
    compiled: Compiled,
    records: Mapping[str, Record],
    scenarios: dict,
    ranged_on: Sequence[str],
    widths: Iterable[int],
    formats: Formats,
    progress: Progress,
) -> dict:
    """RMSE(fixed)/RMSE(float) of every output on every scenario, for programs of other word widths.

    Simplification and ranges are those of `compiled`; formats, tables and biases are made anew. `word` is the width
    whose program has exactly the errors of `compiled`, if there is one. None stands for a width that cannot hold the
    ranges.
    """
    widths, word = list(widths), None
    ratio: dict[str, dict[str, list[float | None]]] = {n: {o: [] for o in s["outputs"]} for n, s in scenarios.items()}
    for width in widths:
        progress(f"{compiled.program.name}: {width} bits")
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
    """Every signal of the program: its format, the range of the format, and that of the signal (normalised units).

    observed: (low, high) of the float network on the record; a delayed signal or a view has that of its origin, and a
    signal that only the program has, that of its codes. sound: proved bounds, or None. quantiles: of |value| on the
    record, where it is not zero.
    """
    program = compiled.program
    trace = run(program, program.encode(record.inputs), trace=True, states=False).trace or {}
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


def _weights(o: Affine, program: Program) -> list[dict]:
    """The weights by which a sum reads each of its arguments, and its biases: the least format that holds all of them.

    An entry has keys of `_signals`; quantiles are those of |weight|, where it is not zero. size: how many those are.
    """
    signals = [program.signals[a] for a in o.args]
    parts = np.split(o.weights, np.cumsum([s.size for s in signals])[:-1], axis=1)
    named = [(s.name, s.fix.frac, part) for s, part in zip(signals, parts, strict=True)]
    found = []
    for name, frac, codes in [*named, ("bias", 0, o.bias[:, None])]:
        values = np.ldexp(codes.astype(float), (frac - o.frac)[:, None])
        size = np.abs(values[values != 0])
        if size.size:
            bits = next(b for b in count(-62) if np.array_equal(scaled := np.ldexp(values, b), np.floor(scaled)))
            fix = Fix(max(2, signed_width(int(np.ldexp(size.max(), bits)))), bits)
            found.append(
                {
                    "name": f"{o.out.name}: {name}",
                    "size": size.size,
                    "fix": str(fix),
                    "width": fix.width,
                    "frac": fix.frac,
                    "holds": (fix.lo * fix.lsb, fix.hi * fix.lsb),
                    "observed": (values.min(), values.max()),
                    "sound": None,
                    "quantiles": np.percentile(size, QUANTILES),
                    "saturations": {},
                }
            )
    return found


def _table(t: Table | Lines, program: Program) -> Lookups:
    """A table of the program: its formats, its worst error, and the operations that look up in it."""
    return {
        "name": t.name,
        "function": t.function,
        "points": t.entries,
        "interpolated": t.interpolated,
        "argument": str(t.arg),
        "result": str(t.out),
        "worst_error": t.worst_error,
        "worst_error_lsb": t.worst_error / t.out.lsb,
        "used_by": [o.out.name for o in program.operations if isinstance(o, Lookup) and o.table == t.name],
    }


def size(program: Program) -> Size:
    """The size of the program: products of one step, and bits of weights, of states and of tables."""
    affine = [o for o in program.operations if isinstance(o, Affine)]
    products = sum(o.out.size for o in program.operations if isinstance(o, Product))
    return {
        "operations": len(program.operations),
        "multiplications": sum(int(np.count_nonzero(o.weights)) for o in affine) + products,
        "state_bits": sum(s.signal.size * s.signal.fix.width for s in program.states),
        "table_bits": sum(t.bits for t in program.tables),
        "accumulator_bits": max((program.accumulator_width(o) for o in affine), default=0),
    }
