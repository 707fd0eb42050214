"""Pictures of the pages, `python docs/pictures.py [FOLDER]`: what a stored network predicts beside the rig's truth.

Each is one SVG that brings its own colours, light and dark, from the network that is kept in the package.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from greygate.compiler.pipeline import compile_network, fixed_error
from greygate.compiler.quantize import Formats
from greygate.errors import InputError
from greygate.files import replacing
from greygate.machines.belt_drive import plant as belt_rig
from greygate.machines.cable_drum import plant as drum_rig
from greygate.machines.cable_drum import study as cable_drum
from greygate.machines.catalog import entry
from greygate.mismatch.rig import load
from greygate.mismatch.simulation import simulate
from greygate.models.accuracy import float_error
from greygate.models.drawn import envelope
from greygate.models.training.record import Record
from greygate.pages.figures import Curve, chart, span
from greygate.plants import Recording, read_csv
from greygate.reading import read_json

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "pictures"
RESULTS = ROOT / "benchmarks" / "results"
KEPT = RESULTS / "measured_mismatch"
WIDTH, HEIGHT, HEAD, LINE = 440, 230, 26, 16  # px of a panel, of the title above it, of a further line of the title
SHOWN = 900  # points of a curve
DOT = 1.015  # half the length of the stroke that is a point of a logarithmic axis, as a factor
STYLE = """
text { font: 11px system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; fill: #1b2228; }
.page { fill: #fff; } .tick { fill: #5b6770; font-size: 10.5px; } .label { fill: #5b6770; text-anchor: middle; }
.grid { stroke: #e9ecef; fill: none; } .level { stroke: #b3261e; stroke-dasharray: 4 3; fill: none; }
.line { fill: none; stroke-width: 1.2; stroke-linejoin: round; }
.reference { stroke: #b4bcc4; stroke-width: 3.5; } .fixed { stroke: #d55e00; } .cost { stroke: #009e73; }
.dot { stroke-width: 6; stroke-linecap: round; } .mark { stroke: #b3261e; stroke-dasharray: 4 3; fill: none; }
@media (prefers-color-scheme: dark) {
  text { fill: #e6eaed; } .page { fill: #1c2227; } .tick, .label { fill: #9ba7b0; } .grid { stroke: #2a3137; }
  .reference { stroke: #707a83; } .fixed { stroke: #f08a3c; } .cost { stroke: #2fc79b; }
}"""


def picture(
    panels: Sequence[tuple[str, Markup]], keys: Sequence[tuple[str, str]], apart: int = 190, columns: int = 0
) -> str:
    """Panels (title, chart of WIDTH x HEIGHT) and keys (class of a line, what it is) below them.

    A title's first line stands out; further ones are smaller. apart: px between keys. columns: panels in a row; 0: all.
    """
    columns = columns or len(panels)
    head = HEAD + LINE * max(title.count("\n") for title, _ in panels)
    width, below = WIDTH * columns, -(-len(panels) // columns) * (head + HEIGHT)
    height = below + HEAD
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}">',
        f'<style>{STYLE}</style><rect class="page" width="{width}" height="{height}"/>',
    ]
    for n, (title, drawn) in enumerate(panels):
        left, top = n % columns * WIDTH, n // columns * (head + HEIGHT)
        first, *more = title.split("\n")
        placed = f'<svg x="{left}" y="{top + head}" width="{WIDTH}" height="{HEIGHT}"'
        notes = [
            f'<text class="tick" x="{left + 58}" y="{top + 17 + LINE * k}">{t}</text>' for k, t in enumerate(more, 1)
        ]
        title = f'<text x="{left + 58}" y="{top + 17}">{first}</text>'
        parts += [title, *notes, str(drawn).replace("<svg", placed, 1)]
    for n, (kind, text) in enumerate(keys):
        x, y = 58 + apart * n, height - 10
        parts.append(f'<path class="line {kind}" d="M{x} {y - 4}h18"/><text x="{x + 24}" y="{y}">{text}</text>')
    return "".join(parts) + "</svg>\n"


def predicted(name: str, scenario: str, output: str) -> tuple[Record, np.ndarray, np.ndarray]:
    """A scenario of the catalogue, its reference and the free run of the stored network, in the output's unit."""
    chosen = entry(name)
    record = chosen.records()[scenario]
    return record, record.targets[output], record.targets[output] + float_error(chosen.network(), record)[output]


def over_time(values: np.ndarray, part: slice, period: float, kind: str) -> Curve:
    """At most SHOWN points, extremes kept."""
    drawn = envelope(values[part], SHOWN // 2)
    return Curve([period * (part.start + k) for k in drawn["step"]], drawn["value"], kind)


def panel(lines: Sequence[Curve], x: str, y: str, **options) -> Markup:
    return chart(lines, x=x, y=y, width=WIDTH, height=HEIGHT, **options)


def belt_drive() -> str:
    """s3 in the plane of position and error, and its longest cascade."""
    record, truth, told = predicted("belt_drive", "s3", "e")
    x = 1e3 * record.inputs["x"]

    def plane(part: slice, every: int) -> Markup:
        lines = [
            Curve(list(x[part][::every]), list(1e6 * e[part][::every]), kind)
            for e, kind in ((truth, "reference"), (told, "fixed"))
        ]
        return panel(lines, "encoder [mm]", "error [µm]")

    inside = (x > 78) & (x < 112) & (np.arange(len(x)) < np.argmax(x))
    start, stop = np.flatnonzero(inside)[[0, -1]]
    panels = [("s3, out and home", plane(slice(None), 8)), ("a cascade of s3", plane(slice(start, stop), 3))]
    return picture(panels, [("reference", "linear scale less encoder"), ("fixed", "machine of experts")])


def belt_scenarios() -> str:
    """s1 to s4: how the carriage moves, and the error beside what the machine says (figures 4.11 to 4.15, 4.18 ...)."""
    panels = []
    for name in ("s1", "s2", "s3", "s4"):
        record, truth, told = predicted("belt_drive", name, "e")
        whole, period = slice(0, len(truth)), belt_rig.SAMPLE_TIME
        moved = [over_time(1e3 * record.inputs["x"], whole, period, "cost")]
        both = [over_time(1e6 * e, whole, period, kind) for e, kind in ((truth, "reference"), (told, "fixed"))]
        panels += [(name, panel(moved, "time [s]", "encoder [mm]")), ("", panel(both, "time [s]", "error [µm]"))]
    return picture(panels, [("reference", "linear scale less encoder"), ("fixed", "machine of experts")], columns=2)


def belt_elman() -> str:
    """A black box on the belt, in training and beyond it (figures 4.8 and 4.9), as it was stored."""
    found = read_json(RESULTS / "belt_rig.json", "run python -m benchmarks belt_rig elman")["elman"]
    panels = []
    for name, title in (("training", "training, one sample every 0.2 s"), ("s2", "s2")):
        curves = []
        for key, kind in (("true", "reference"), ("told", "fixed")):
            values = np.array(found["um"][name][key])
            curves.append(over_time(values, slice(0, len(values)), found["period"], kind))
        panels.append((title, panel(curves, "time [s]", "error [µm]")))
    return picture(panels, [("reference", "linear scale less encoder"), ("fixed", "Elman network of 10 neurons")])


def drum_black_boxes() -> str:
    """What networks 9 and 10 of table 7.3 leave in training (figures 7.8 and 7.10), as it was stored."""
    found = read_json(RESULTS / "cable_drum.json", "run python -m benchmarks cable_drum drawn")["drawn"]["um"]
    panels = []
    for number, title in (("9", "NOE #9, 10 epochs"), ("10", "NOE #10, 100 epochs more, with the angle")):
        time = [cable_drum.SAMPLE_TIME * step for step in found[number]["step"]]
        panels.append((title, panel([Curve(time, found[number]["left"], "cost")], "time [s]", "left [µm]")))
    return picture(panels, [("cost", "network less scale, in training")])


def drum_trips() -> str:
    """Round trips at three speeds: the drum's error over where it stands, and over time (figure 7.3)."""
    kinds = dict(zip(drum_rig.SPEEDS, ("reference", "fixed", "cost"), strict=True))
    over_place, over_trips = [], []
    for speed, kind in kinds.items():
        record = entry("cable_drum").records()[f"trips_{1e3 * speed:.0f}"]
        x, e = record.inputs["x_pe"], 1e6 * record.targets["e"]
        first = 3 * len(x) // drum_rig.ROUND_TRIPS
        every = max(first // SHOWN, 1)
        over_place.append(Curve(list(1e3 * x[:first:every]), list(e[:first:every]), kind))
        over_trips.append(over_time(e, slice(0, len(e)), cable_drum.SAMPLE_TIME, kind))
    panels = [
        ("the first three of sixteen round trips", panel(over_place, "drum [mm]", "error [µm]")),
        ("all of them in time", panel(over_trips, "time [s]", "error [µm]")),
    ]
    return picture(panels, [(kind, f"{1e3 * speed:.0f} mm/s") for speed, kind in kinds.items()])


def _pressure(
    name: str, views: Sequence[tuple[str, str, str, slice]], unit: str, scale: float, truth: str = "pressure sensor"
) -> str:
    """A chamber's pressure at 1 kHz and what the network says of it; views: (scenario, output, title, samples).

    truth: what the records' pressures are.
    """
    panels = []
    for scenario, output, title, part in views:
        _, pressure, told = predicted(name, scenario, output)
        lines = [over_time(scale * p, part, 1e-3, k) for p, k in ((pressure, "reference"), (told, "fixed"))]
        panels.append((f"{scenario}, {title}", panel(lines, "time [s]", f"{output} [{unit}]")))
    return picture(panels, [("reference", truth), ("fixed", "network, no sensor")])


def pump_cylinder() -> str:
    """Chamber B on the rig's chirp: five seconds of its middle and half a second of its end."""
    spans = (("20 to 25 s", slice(20_000, 25_000)), ("the last 0.5 s", slice(49_500, 50_000)))
    return _pressure("pump_cylinder", [("rig_chirp", "p_b", *span) for span in spans], "MPa", 1e-6)


def first_cylinder() -> str:
    """Chamber A: v1, and v2 under its load."""
    views = [("v1", "p_a", "other excitation", slice(0, 1000)), ("v2", "p_a", "under 3000 N", slice(0, 5000))]
    return _pressure("valve_cylinder", views, "bar", 1e-5, "true pressure")


def second_cylinder() -> str:
    """Chamber B: v4, which rests, and the end of v6."""
    views = [("v4", "p_b", "moving and standing", slice(0, 10_000)), ("v6", "p_b", "end", slice(47_000, 50_000))]
    return _pressure("asymmetric_cylinder", views, "bar", 1e-5)


def drum() -> str:
    """Random motion with the beacon at home: position error and what is left of it."""
    _, truth, told = predicted("cable_drum", "home", "e")
    whole, period = slice(0, len(truth)), cable_drum.SAMPLE_TIME
    both = [over_time(1e6 * e, whole, period, kind) for e, kind in ((truth, "reference"), (told, "fixed"))]
    left = [over_time(1e6 * (told - truth), whole, period, "cost")]
    bounds = [(100.0, ""), (-100.0, "")]
    panels = [
        ("random motion, 250 s, beacon at home", panel(both, "time [s]", "error [µm]")),
        ("what is left, thesis: within ±100 µm", panel(left, "time [s]", "left [µm]", levels=bounds)),
    ]
    return picture(panels, [("reference", "linear scale less drum"), ("fixed", "SNN"), ("cost", "SNN less scale")])


CALIBRATED = {
    "pump": 0.039468941175018715, "upper": 0.043451172178237595, "lower": 0.06612564420813895,
    "inflow": 0.06045808202655453, "h_0": 5.853718202999186, "y_0": 5.189404266400165,
}  # fmt: skip
"""The tanks' parameters when nothing but them is fitted: `diagnose`, its result's `calibrated`."""


def tanks() -> tuple[dict, dict[str, np.ndarray]]:
    """(kept diagnosis of the measured tanks, its recording and the simulations of it: RMS in `fit` of the former)."""
    rig, diagnosis = load(ROOT / "recordings" / "rigs" / "tanks"), read_json(KEPT / "tanks.json", "keep it")
    measured = read_csv(ROOT / "recordings" / "cascaded-tanks" / "cascaded_tanks.csv")
    recording = Recording(rig.dt, {"u": measured["u_train"], "y": measured["y_train"]}, {"u": "V", "y": "V"})
    fitted = diagnosis | {"effects": [], "parameters": {name: {"value": v} for name, v in CALIBRATED.items()}}
    runs = {kind: simulate(rig, recording, told)["y"] for kind, told in (("fixed", fitted), ("cost", diagnosis))}
    return diagnosis, {"reference": recording["y"], **runs}


def greygate() -> str:
    """What greygate is for: the measured tanks with the physics named, a pressure on an FPGA under a load."""
    diagnosis, runs = tanks()
    was, now = (diagnosis["fit"]["holdout"]["y"][kind] for kind in ("calibrated", "corrected"))
    level = _panel_of(runs, slice(100, 550), 4.0, "time [s]", "level [V]")
    chosen = entry("valve_cylinder")
    network, record = chosen.network(), chosen.records()["v2"]
    compiled = compile_network(network, chosen.records(), Formats(16, chosen.finer), ranged_on=chosen.training)
    truth, error = record.targets["p_a"], fixed_error(compiled.program, record)["p_a"]
    rms = np.sqrt(np.mean(error**2))
    pressure = {"reference": 1e-5 * truth, "cost": 1e-5 * (truth + error)}
    stored = read_json(ROOT / "models" / "trained" / "valve_cylinder.resources.json", "keep it")
    used = stored["resources"]["folded, ecp5"]
    panels = [
        (
            "Explain a recording: two tanks, measured\n"
            "named: both tanks spill over, the lower one leaks\n"
            f"error on a second recording, RMS: {was:.2f} V, then {now:.2f} V",
            level,
        ),
        (
            "Network to FPGA: a cylinder's pressure without a pressure sensor\n"
            f"under a load that training never saw; error {1e-5 * rms:.2f} bar RMS\n"
            f"every bit as in the emulator; {used['luts']} LUTs, {used['dsps']} DSPs of an ECP5",
            _panel_of(pressure, slice(1500, 3000), 1e-3, "time [s]", "pressure [bar]"),
        ),
    ]
    keys = [
        ("reference", "recorded level; true pressure"),
        ("fixed", "simulation, its parameters fitted"),
        ("cost", "with the named physics; 16-bit Verilog"),
    ]
    return picture(panels, keys, apart=270)


def _panel_of(curves: Mapping[str, np.ndarray], part: slice, period: float, x: str, y: str) -> Markup:
    return panel([over_time(values, part, period, kind) for kind, values in curves.items()], x, y)


def explore() -> str:
    """Designs worth having on a small FPGA: LUTs over error and over time, the chosen one marked."""
    found = read_json(RESULTS / "exploring.json", "run python -m benchmarks exploring")["up5k"]["explored"]
    front, chosen = found["front"], found["chosen"]
    kinds = {"folded": "fixed", "serial": "cost", "parallel": "reference"}

    def seen(x: str, title: str) -> Markup:
        points = [Curve([p[x] / DOT, p[x] * DOT], [p["luts"]] * 2, f"{kinds[p['architecture']]} dot") for p in front]
        return panel(
            points,
            title,
            "LUTs",
            x_log=True,
            y_log=True,
            x_limits=span([p[x] for p in front], log=True),
            levels=[(chosen["luts"], "chosen")],
            marks=[chosen[x]],
        )

    panels = [
        ("LUTs over error", seen("error", "error, times that of float")),
        ("LUTs over time", seen("microseconds", "a step [µs]")),
    ]
    drawn = [name for name in kinds if any(p["architecture"] == name for p in front)]
    return picture(panels, [(kinds[name], name) for name in drawn])


def control() -> str:
    """A second of the cylinder, alone and under its load: the errors of three controllers, as they were stored."""
    found = read_json(RESULTS / "control.json", "run python -m benchmarks control drawn")["drawn"]
    kinds = {"pi": "reference", "mpc": "fixed", "network": "cost"}
    labels = {"pi": "PI, feed-forward", "mpc": "predictive control", "network": "network, as in RTL"}
    panels = []
    for case, errors in found["errors"].items():
        curves = []
        for method, kind in kinds.items():
            error = np.array(errors[method])
            curves.append(over_time(error, slice(0, len(error)), found["period"], kind))
        panels.append((f"valve cylinder, {case}", panel(curves, "time [s]", "error [µm]")))
    return picture(panels, [(kinds[method], label) for method, label in labels.items()])


def entropies() -> str:
    """Entropies of the neurons of B1 and B2, the largest first, before and after the loop of figure 3.7."""
    found = read_json(RESULTS / "systems.json", "run python -m benchmarks systems entropies")
    panels = []
    for name, title in (("b1_30", "B1"), ("b2", "B2")):
        [row] = found["entropies"]["rows"][name]
        for layer, before in row["before"].items():
            curves = []
            for values, kind in ((before, "reference"), (row["after"][layer], "cost")):
                ranked = sorted(values, reverse=True)
                curves += [Curve([n - 0.2, n + 0.2], [h] * 2, f"{kind} dot") for n, h in enumerate(ranked, 1)]
            words = f"{title}, {layer}: {len(before)} neurons, then {len(row['after'][layer])}"
            panels.append((words, panel(curves, "neuron, by its entropy", "entropy [nats]")))
    return picture(panels, [("reference", "before"), ("cost", "after")])


PICTURES: dict[str, Callable[[], str]] = {
    "greygate": greygate,
    "belt_drive": belt_drive,
    "belt_drive_scenarios": belt_scenarios,
    "belt_drive_elman": belt_elman,
    "valve_cylinder": first_cylinder,
    "asymmetric_cylinder": second_cylinder,
    "pump_cylinder": pump_cylinder,
    "cable_drum": drum,
    "cable_drum_trips": drum_trips,
    "cable_drum_noe": drum_black_boxes,
    "explore": explore,
    "control": control,
    "benchmark_systems": entropies,
}


def draw(folder: Path = FOLDER) -> None:
    """Write every picture, NAME.svg. Raises InputError for a folder that does not exist."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; make it first")
    for name, make in PICTURES.items():
        with replacing(folder / f"{name}.svg") as path:
            path.write_text(make(), encoding="utf-8")


if __name__ == "__main__":
    draw(*map(Path, sys.argv[1:2]))
