"""Fit compiler/explore/cost.toml: what the parts of a design take on each family, by Yosys, and the error on others.

Every design is synthesized once for each family; results stay in build/calibrate, so a run that was stopped goes on.
The fit minimises relative errors, with no negative size of a part. Designs that are not fitted on judge it. Clock
periods are nextpnr's where it places the family, and ECP5's elsewhere.
"""

import hashlib
import json
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import tomli_w
from scipy.optimize import nnls

from greygate.compiler.emit import emit, emitted
from greygate.compiler.explore.cost import COEFFICIENTS, COUNTS, Parts, coefficients, explored
from greygate.compiler.pipeline import compile_network
from greygate.compiler.quantize import Formats
from greygate.compiler.tables import Form
from greygate.compiler.targets import Design, Memory
from greygate.emulator.program import Program
from greygate.hardware.synthesis import synthesize
from greygate.machines.source import Source

from .flow import flow
from .made import ROOT
from .shared import Limit, scratch

TAKES = "half an hour"
FAMILIES = ("ecp5", "ice40", "xilinx")
PLACED = {"ecp5": "ecp5-85k", "ice40": "up5k"}  # the device that tells the clock period of a family
PLACEABLE = 6_000  # LUTs up to which a design is placed and routed for its clock
CACHE = ROOT / "build" / "calibrate"
FITTED_WIDTHS, JUDGED_WIDTHS = (8, 12, 16), (10, 14)
OCTAVES = (10, 12)  # widths at which tables are kept by octaves
PLANTS = {"valve_cylinder": True, "pump_cylinder": False, "mts": False}  # plant -> whether the fit sees it


@dataclass(frozen=True)
class Case:
    """A design; whether the fit sees it."""

    title: str
    program: Program
    architecture: str
    design: Design
    fitted: bool


def cases() -> Iterator[Case]:
    """Designs of the flow network in several formats, and of plants; some with tables by octaves."""
    network, record = flow()
    for width in sorted(FITTED_WIDTHS + JUDGED_WIDTHS):
        program = compile_network(
            network, {"grid": record}, Formats(width, tables=Form.OCTAVES if width in OCTAVES else Form.POINTS)
        ).program
        judged = width in JUDGED_WIDTHS
        for design in (Design(), Design(dsps=20), Design(memory=Memory.LOGIC)):
            if width < 12 or not judged:
                yield Case(f"flow {width}", program, "parallel", design, not judged)
        for design in (Design(1), Design(4), Design(2, memory=Memory.LOGIC), Design(2, factor=16)):
            yield Case(f"flow {width}", program, "folded", design, not judged)
        yield Case(f"flow {width}", program, "serial", Design(), not judged)
    for name, fitted in PLANTS.items():
        source = Source(name)
        formats = replace(source.formats(), tables=Form.OCTAVES)
        program = compile_network(source.network(), source.records(), formats, ranged_on=source.training).program
        for design in (Design(1), Design(4), Design(1, factor=16), Design(2, factor=16)):
            yield Case(name, program, "folded", design, fitted)
        yield Case(name, program, "parallel", Design(), fitted)
        yield Case(name, program, "serial", Design(), fitted)


def measured(case: Case, family: str, limit: float, clock: bool = False) -> dict:
    """Cells of a case, from the cache or by Yosys; {"stopped_after_s": limit} where it takes longer."""
    texts = emitted(case.program, case.architecture, case.design)
    digest = hashlib.sha256(json.dumps([family, clock, texts]).encode()).hexdigest()[:16]
    kept = CACHE / f"{digest}.json"
    if not kept.exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        with scratch() as folder:
            emit(case.program, folder, case.architecture, case.design)
            found = synthesize(folder, case.program.name, PLACED[family] if clock else family, clock, limit)
        kept.write_text(json.dumps(found))
    return json.loads(kept.read_text())


def parts(case: Case, family: str) -> Parts:
    return COUNTS[case.architecture](case.program, case.design, family)


def fit(rows: list[tuple[Parts, float]]) -> dict[str, float]:
    """LUTs of a part of each kind, by non-negative least squares of relative errors."""
    kinds = list(rows[0][0].luts)
    matrix = np.array([[p.luts[k] / luts for k in kinds] for p, luts in rows])
    scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-12)
    found, _ = nnls(matrix / scale, np.ones(len(rows)))
    return {k: float(f"{v:.3g}") for k, v in zip(kinds, found / scale, strict=True) if v > 0}


def errors(luts: dict[str, float], rows: list[tuple[Parts, float]]) -> dict[str, float]:
    """Relative errors of the LUTs: median, worst, and of how many designs."""
    off = [abs(sum(luts.get(k, 0.0) * n for k, n in p.luts.items()) / true - 1) for p, true in rows]
    if not off:
        return {"judged": 0}
    return {"median": round(statistics.median(off), 3), "worst": round(max(off), 3), "judged": len(off)}


def period(chosen: list[Case], family: str, limit: float) -> float | None:
    """The shortest clock of the slowest of some designs, in ns; None where nextpnr tells none."""
    if family not in PLACED:
        return None
    rates = [measured(case, family, limit, clock=True).get("clock_mhz") for case in chosen]
    known = [1e3 / rate for rate in rates if rate]
    return round(max(known), 1) if known else None


def main(*, families: Sequence[str] = FAMILIES, architectures: Sequence[str] = (), limit: Limit = 300.0) -> None:
    architectures = architectures or explored()
    every = [c for c in cases() if c.architecture in architectures]
    table = {family: dict(rows) for family, rows in coefficients().items()}
    for family in families:
        for name in architectures:
            chosen, rows = [c for c in every if c.architecture == name], []
            for case in chosen:
                cells = measured(case, family, limit)
                if "luts" not in cells:
                    print(f"{family} {name} {case.title}: no answer in {limit:g} s", flush=True)
                    continue
                counted = parts(case, family)
                rows.append((case, counted, cells))
                print(
                    f"{family:7} {name:9} {case.title:18} {case.design.multipliers} {case.design.memory:6} "
                    f"{case.design.dsps:3}: LUTs {cells['luts']:6g}, DSPs {cells['dsps']:g} (counted {counted.dsps}), "
                    f"memories {cells['block_rams']:g} (counted {counted.memories:g})",
                    flush=True,
                )
            if not rows:
                continue
            luts = fit([(p, cells["luts"]) for case, p, cells in rows if case.fitted])
            told = errors(luts, [(p, cells["luts"]) for case, p, cells in rows if not case.fitted])
            told |= {
                f"{what}_off": sum(getattr(p, what) != cells[key] for _, p, cells in rows)
                for what, key in (("dsps", "dsps"), ("memories", "block_rams"))
            }
            small = [case for case, _, cells in rows if case.fitted and cells["luts"] < PLACEABLE]
            clock = period([c for c in small if c.design.memory is Memory.BLOCK], family, limit)
            before = table.get(family, {}).get(name, {}).get("period", 10.0)
            table.setdefault(family, {})[name] = {"period": clock or before, "luts": luts, "error": told}
            print(family, name, luts, told, clock, flush=True)
    head = (
        "# LUTs of a part of each kind (cost.py beside it), shortest clock in ns: by python -m benchmarks calibrate.\n"
    )
    COEFFICIENTS.write_text(f"{head}\n{tomli_w.dumps(table)}", encoding="utf-8")
